//! From metal/roughness materials to Whitted's terms, and the light that a surface sends back by itself.
//!
//! # The mapping
//!
//! Whitted (1980) splits what leaves a surface into a local part (lights, seen directly) and two traced parts (an ideal mirror ray and
//! an ideal refracted ray). A metal/roughness material has base colour `c`, metal `m`, perceptual roughness `r`, transmission `t`,
//! specular reflectance `s` and an index of refraction. With `v` the direction to the viewer, `n` the shading normal, `l` the direction to a
//! light and `h` the unit vector halfway between `l` and `v`:
//!
//! | term | value |
//! |---|---|
//! | gloss, the share of a reflection that is an ideal mirror's | `g = max(0, 1 - 2 r)^2` |
//! | glass, the share of the surface that refracts | `T = t (1 - m)` |
//! | reflectance at normal incidence | `F0 = mix(mix(s, ((ior - 1) / (ior + 1))^2, t), c, m)` |
//! | reflectance `F(x)` | Schlick (1994): `F0 + (F90 - F0) (1 - x)^5`, `F90 = min(1, 50 max F0)`, so that a specular of 0 is a plain Lambert surface (Lagarde and de Rousiers 2014, section 3.2) |
//! | reflectance of the glass `Fg` | exact Fresnel for unpolarised light; 1 at total reflection |
//! | diffuse colour | `D = c ((1 - m) (1 - t) + m (1 - g))`: metal too rough to mirror stays visible |
//! | ambient light | `D (1 - g F(n.v))` times its radiance |
//! | a light of irradiance `E` (at normal incidence) | `E max(n.l, 0) (D (1 - F(h.v)) / pi + F(h.v) B(n.h))` |
//! | highlight `B(x)` | Blinn-Phong `x^e (e + 2) (e + 4) / (8 pi (2^(-e/2) + e))`, `e = 2 / r^4 - 2`, at most 1024 |
//! | mirror ray | `(1 - T) g F(n.v) + T g Fg`; from inside the glass `T Fg`, for what is totally reflected has nowhere else to go |
//! | refracted ray | `T (1 - Fg) c` |
//!
//! `E` is intensity over squared distance (candela) or the intensity itself (lux). The exponent follows from matching Blinn-Phong to a Beckmann lobe
//! of width `r^2` (Walter et al. 2007, section 5.2); its bound makes a point light's image in a mirror about as large as a lamp 5 degrees
//! wide, where an ideal mirror would show nothing. The factor of `B` makes its albedo 1 where it is greatest, at normal incidence.
//!
//! **Energy.** `D <= c (1 - T)` and all of `c`, `F`, `Fg`, `g` lie in [0, 1]. Ambient, mirror and refracted weights together are at most
//! `(1 - T) (1 - g F + g F) + T (1 - Fg + Fg) = 1`; what a light brings is weighed by `D (1 - F) + F <= 1`.
//!
//! Emission is added, unscaled. An **unlit** material shows its base colour and sends no rays. With **blending**, alpha weighs all of the above
//! and `1 - alpha` goes straight on. Blended, thin-walled and `ior == 1` surfaces pass a ray on unbent: it is continued, not started anew,
//! so that `ior == 1` glass of white base changes no bit of the picture behind it. Media do not nest: outside any glass is vacuum, and the side is
//! told by the triangle's winding.
//!
//! **Sides.** Both sides of a triangle are shaded alike, double-sided or not: the normal is the one on the viewer's side. A single-sided surface of
//! a closed body is never seen from behind, and elsewhere a wall is better than a hole.
//!
//! Reflection or refraction **switched off** acts on the material: without reflection `g = Fg = 0` (a metal turns diffuse), without refraction `T = 0`
//! (glass turns opaque, `t` counts as 0).

use crate::Features;
use crate::light;
use crate::scene::Renderer;
use crate::surface::{Paint, Surface, offset_origin};
use crate::{RayCounts, path::Passage};
use std::f32::consts::{FRAC_1_PI, PI};
use tessera_geometry::Vec3;

/// Whitted's terms of one hit. Weights are per channel in [0, 1].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terms {
    /// Diffuse colour, `D`.
    pub diffuse: Vec3,
    /// Weight of the ambient radiance.
    pub ambient: Vec3,
    /// Light that leaves by itself.
    pub emissive: Vec3,
    /// Schlick's `F0` and `F90` of highlights.
    pub f0: Vec3,
    pub f90: f32,
    /// Exponent of the highlight.
    pub exponent: f32,
    /// Weight of the mirror ray.
    pub mirror: Vec3,
    /// Weight of the ray that passes the surface.
    pub passed: Vec3,
    /// How it passes.
    pub passage: Passage,
}

/// Greatest exponent of a highlight.
const MAX_EXPONENT: f32 = 1024.0;

/// The terms of `paint` on `surface`, met by a ray along `direction`.
pub(crate) fn terms(paint: &Paint, surface: &Surface, direction: Vec3, features: Features) -> Terms {
    // Show an unlit colour as it is.
    if paint.unlit {
        return Terms {
            diffuse: Vec3::ZERO,
            ambient: Vec3::ZERO,
            emissive: paint.base,
            f0: Vec3::ZERO,
            f90: 0.0,
            exponent: 0.0,
            mirror: Vec3::ZERO,
            passed: Vec3::ZERO,
            passage: Passage::Straight,
        };
    }

    // Split the surface into glass and body, and the reflection into mirror and lobe.
    let transmission = if features.refraction { paint.transmission } else { 0.0 };
    let glass = glass_share(paint, features);
    let smooth = (1.0 - 2.0 * paint.roughness).max(0.0);
    let gloss = if features.reflection { smooth * smooth } else { 0.0 };
    let body_color = (1.0 - paint.metallic) * (1.0 - transmission) + paint.metallic * (1.0 - gloss);
    let diffuse = paint.base * body_color;

    // Find the reflectance.
    let r = (paint.ior - 1.0) / (paint.ior + 1.0);
    let dielectric = paint.specular.lerp(Vec3::splat(r * r), transmission);
    let f0 = dielectric.lerp(paint.base, paint.metallic);
    let f90 = (50.0 * f0.max_element()).min(1.0);
    let fresnel = schlick(f0, f90, -direction.dot(surface.shading));

    // Weigh the traced rays.
    let mut mirror = fresnel * ((1.0 - glass) * gloss);
    let mut passed = Vec3::ZERO;
    let mut passage = Passage::Straight;
    if glass > 0.0 {
        let (through, reflectance) = pass(paint, surface, direction);
        let sharp = if surface.from_front || !features.reflection { gloss } else { 1.0 };
        mirror += Vec3::splat(glass * reflectance * sharp);
        passed = paint.base * (glass * (1.0 - reflectance));
        passage = through;
    }
    Terms {
        diffuse,
        ambient: diffuse * (Vec3::ONE - fresnel * gloss),
        emissive: paint.emissive,
        f0,
        f90,
        exponent: highlight_exponent(paint.roughness),
        mirror,
        passed,
        passage,
    }
}

/// The share of a surface that refracts.
pub(crate) fn glass_share(paint: &Paint, features: Features) -> f32 {
    if features.refraction && !paint.unlit { paint.transmission * (1.0 - paint.metallic) } else { 0.0 }
}

/// How glass passes a ray, and how much it reflects instead.
fn pass(paint: &Paint, surface: &Surface, direction: Vec3) -> (Passage, f32) {
    // Equal media neither bend nor reflect.
    if paint.ior == 1.0 {
        return (Passage::Straight, 0.0);
    }

    // A thin wall reflects like the outside of a body and does not bend.
    let entering = surface.from_front || paint.thin_walled;
    let eta = if entering { 1.0 / paint.ior } else { paint.ior };
    match refract(direction, surface.shading, eta) {
        None => (Passage::Straight, 1.0),
        Some((_, reflectance)) if paint.thin_walled => (Passage::Straight, reflectance),
        Some((bent, reflectance)) => (Passage::Bent(onto_side(bent, -surface.facing)), reflectance),
    }
}

/// Direction and exact Fresnel reflectance of a ray that goes from a medium of index `n1` into one of `n2`, `eta` = `n1 / n2`,
/// through a surface whose unit `normal` faces it; `None` when it is totally reflected.
pub(crate) fn refract(direction: Vec3, normal: Vec3, eta: f32) -> Option<(Vec3, f32)> {
    // Find the cosine on the other side by Snell's law; 0 at the critical angle itself. A NaN (infinite eta) is no number >= 0.
    let cos_in = (-direction.dot(normal)).clamp(0.0, 1.0);
    let k = 1.0 - eta * eta * (1.0 - cos_in * cos_in);
    if k >= 0.0 {
        let cos_out = k.sqrt();

        // Average the reflectances of both polarisations.
        let across = (eta * cos_in - cos_out) / (eta * cos_in + cos_out);
        let along = (cos_in - eta * cos_out) / (cos_in + eta * cos_out);
        let reflectance = 0.5 * (across * across + along * along);
        let bent = direction * eta + normal * (eta * cos_in - cos_out);
        Some((bent.normalize_or(direction), if reflectance <= 1.0 { reflectance } else { 1.0 }))
    } else {
        None
    }
}

/// The mirror ray's direction: never under the surface, even where the shading normal would send it there.
pub(crate) fn reflect(direction: Vec3, surface: &Surface) -> Vec3 {
    let mirrored = direction - surface.shading * (2.0 * direction.dot(surface.shading));
    onto_side(mirrored.normalize(), surface.facing)
}

/// `direction`, mirrored in the surface when it points to the other side of it than the normal `side`.
fn onto_side(direction: Vec3, side: Vec3) -> Vec3 {
    let height = direction.dot(side);
    if height < 0.0 { direction - side * (2.0 * height) } else { direction }
}

/// Schlick's reflectance at the angle whose cosine is `cosine`.
fn schlick(f0: Vec3, f90: f32, cosine: f32) -> Vec3 {
    let x = (1.0 - cosine).clamp(0.0, 1.0);
    let x2 = x * x;
    f0 + (Vec3::splat(f90) - f0) * (x2 * x2 * x)
}

fn highlight_exponent(roughness: f32) -> f32 {
    let width = roughness * roughness;
    (2.0 / (width * width) - 2.0).clamp(0.0, MAX_EXPONENT)
}

/// Normalised Blinn-Phong.
fn highlight(cosine: f32, exponent: f32) -> f32 {
    let scale = (exponent + 2.0) * (exponent + 4.0) / (8.0 * PI * (libm::exp2f(-0.5 * exponent) + exponent));
    scale * libm::powf(cosine.max(0.0), exponent)
}

/// What the surface sends back along `-direction` without further mirror or refracted rays: emission, ambient light, and each light
/// in turn unless it is in shadow.
pub(crate) fn local_light(
    scene: &Renderer<'_>,
    features: Features,
    surface: &Surface,
    terms: &Terms,
    direction: Vec3,
    counts: &mut RayCounts,
) -> Vec3 {
    // Start with what needs no light.
    let mut sum = terms.emissive + terms.ambient * scene.ambient;
    if terms.diffuse == Vec3::ZERO && terms.f90 == 0.0 {
        return sum;
    }

    // Add every light that shines on the viewer's side of both normals.
    let origin = offset_origin(surface, surface.facing);
    for light in scene.lights {
        let Some(incoming) = light::incoming(light, origin, scene.step) else { continue };
        let cosine = incoming.direction.dot(surface.shading);
        if cosine <= 0.0 || incoming.direction.dot(surface.facing) <= 0.0 {
            continue;
        }

        // Ask for its shadow only if it would be seen.
        let sent_back =
            incoming.irradiance * (reflected(terms, surface, incoming.direction, direction) * cosine);
        if sent_back == Vec3::ZERO {
            continue;
        }
        if features.shadows {
            counts.shadow += 1;
            sum += sent_back * light::transmittance(scene, features, origin, &incoming);
        } else {
            sum += sent_back;
        }
    }
    sum
}

/// Share of the light from `to_light` that goes to the viewer: diffuse under a reflecting coat, and the coat's highlight.
fn reflected(terms: &Terms, surface: &Surface, to_light: Vec3, direction: Vec3) -> Vec3 {
    let halfway = (to_light - direction).normalize_or(surface.shading);
    let fresnel = schlick(terms.f0, terms.f90, -halfway.dot(direction));
    let lobe = if terms.f90 > 0.0 { highlight(halfway.dot(surface.shading), terms.exponent) } else { 0.0 };
    terms.diffuse * (Vec3::ONE - fresnel) * FRAC_1_PI + fresnel * lobe
}
