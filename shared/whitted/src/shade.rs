//! From metal/roughness materials to Whitted's terms, and the light that a surface sends back by itself.
//!
//! # The mapping
//!
//! Whitted (1980) splits what leaves a surface into a local part (lights, seen directly) and two traced parts (an
//! ideal mirror ray and an ideal refracted ray). A metal/roughness material has base colour `c`, metal `m`,
//! perceptual roughness `r`, transmission `t`, specular reflectance `s` and an index of refraction. With `v` the
//! direction to the viewer, `n` the shading normal, `l` the direction to a light and `h` the unit vector halfway
//! between `l` and `v`:
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
//! | mirror ray | `(1 - T) g F(n.v) + T g Fg`; from inside a body of glass `(1 - T) g F(n.v) + T Fg`, for what is totally reflected has nowhere else to go |
//! | refracted ray | `T (1 - Fg) c` |
//!
//! `E` is intensity over squared distance (candela) or the intensity itself (lux). The exponent follows from matching
//! Blinn-Phong to a Beckmann lobe of width `r^2` (Walter et al. 2007, section 5.2); its bound makes a point light's
//! image in a mirror about as large as a lamp 5 degrees wide, where an ideal mirror would show nothing. The factor of
//! `B` makes its albedo 1 where it is greatest, at normal incidence.
//!
//! **Energy.** `D <= c (1 - T)` and all of `c`, `F`, `Fg`, `g` lie in [0, 1]. Ambient, mirror and refracted weights
//! together are at most `(1 - T) (1 - g F + g F) + T (1 - Fg + Fg) = 1`, from inside glass too; what a light brings is weighed by at most
//! `D (1 - F) + F <= 1`.
//!
//! Emission is added, unscaled. An **unlit** material shows its base colour and sends no rays. With **blending**,
//! alpha weighs all of the above and `1 - alpha` goes straight on. Blended, thin-walled and `ior == 1` surfaces pass
//! a ray on unbent: it is continued, not started anew, so that `ior == 1` glass of white base changes no bit of the
//! picture behind it. Media do not nest: outside any glass is vacuum, and the side is told by the triangle's winding.
//!
//! **Sides.** The normal is the one on the viewer's side, and a double-sided surface is shaded alike on both. A
//! single-sided one has no back: rays from the eye, a mirror or glass pass it there as they pass a hole (glTF 2.0,
//! section 3.9.7, calls it back-face culling). Shadow rays know no sides, so that a one-sided wall, open to the
//! viewer behind it, still keeps the light out. What transmits light is met on both sides whatever its material says,
//! for the inside of a glass body is the back of its surface.
//!
//! Reflection or refraction **switched off** acts on the material: without reflection `g = Fg = 0` (a metal turns
//! diffuse, glass passes all of `T c`, and what is totally reflected is lost), without refraction `T = 0` (glass turns opaque, `t` counts
//! as 0). Weights only lose by it: the mirror's is 0, and that of the refracted ray at most `T`.

use crate::light;
use crate::probe::Tracer;
use crate::scene::Renderer;
use crate::surface::{Paint, Surface, clearance, offset_origin, paint_at, surface_at};
use crate::{Features, FrameParams, RayCounts, path::Passage};
use std::f32::consts::{FRAC_1_PI, PI};
use tessera_geometry::mutation::{Mutation, is_on, unless};
use tessera_geometry::wide::{LANES, lanes_in};
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_pack::Light;

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
pub(crate) const MAX_EXPONENT: f32 = 1024.0;

/// 2^-64: what a light sends back below it is nothing, and its shadow is not asked for. No pixel shows it; and a far highlight that a
/// device without subnormal numbers takes for 0 (below 2^-126, before a factor of at most 42 and an irradiance of less than 2^50) is below it
/// too, so that CPU and GPU ask the same lights.
pub(crate) const LEAST_SENT: f32 = 1.0 / (1u128 << 64) as f32;

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
        let inside = !surface.from_front && !paint.thin_walled;
        let sharp = if inside && features.reflection { 1.0 } else { gloss };
        mirror += Vec3::splat(glass * reflectance * sharp);

        // Without reflection all of it passes, but for what can't: total reflection bends no ray.
        let kept = if features.reflection || reflectance == 1.0 { reflectance } else { 0.0 };
        passed = paint.base * (glass * (1.0 - kept));
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
    let eta = if entering != is_on(Mutation::IorInverted) { 1.0 / paint.ior } else { paint.ior };
    match refract(direction, surface.shading, eta) {
        None => (Passage::Straight, unless(Mutation::NoTotalReflection, 1.0, 0.0)),
        Some((_, reflectance)) if paint.thin_walled => (Passage::Straight, reflectance),
        Some((bent, reflectance)) => (Passage::Bent(onto_side(bent, -surface.facing)), reflectance),
    }
}

/// Direction and exact Fresnel reflectance of a ray that goes from a medium of index `n1` into one of `n2`, `eta` =
/// `n1 / n2`, through a surface whose unit `normal` faces it; `None` when it is totally reflected.
pub(crate) fn refract(direction: Vec3, normal: Vec3, eta: f32) -> Option<(Vec3, f32)> {
    // Find the cosine on the other side by Snell's law; 0 at the critical angle itself. A NaN (infinite eta) is no
    // number >= 0.
    let cos_in = (-direction.dot(normal)).clamp(0.0, 1.0);
    let k = 1.0 - eta * eta * (1.0 - cos_in * cos_in);
    if k >= 0.0 {
        let cos_out = k.sqrt();

        // Average the reflectances of both polarisations.
        let across = (eta * cos_in - cos_out) / (eta * cos_in + cos_out);
        let along = (cos_in - eta * cos_out) / (cos_in + eta * cos_out);
        let along = unless(Mutation::FresnelOneSided, along, across);
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

/// A surface as a ray sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub hit: Hit,
    /// Of the ray.
    pub direction: Vec3,
    pub surface: Surface,
    /// [`Paint::alpha`].
    pub alpha: f32,
    pub terms: Terms,
}

impl View {
    /// What a ray along `direction` sees at `hit`.
    pub(crate) fn new(scene: &Renderer<'_>, features: Features, hit: Hit, direction: Vec3) -> Self {
        let surface = surface_at(scene, &hit, direction);
        let paint = paint_at(scene, &hit);
        let terms = terms(&paint, &surface, direction, features);
        Self { hit, direction, surface, alpha: paint.alpha, terms }
    }

    /// What needs no light, and whether lights matter.
    fn unlit_part(&self, scene: &Renderer<'_>) -> (Vec3, bool) {
        let terms = &self.terms;
        let sum = terms.emissive + terms.ambient * scene.ambient;
        (sum, terms.diffuse != Vec3::ZERO || terms.f90 != 0.0)
    }

    /// What `light` sends from here towards the viewer if nothing is in its way, and the ray that asks; `None` when that is nothing.
    fn sent_back(&self, scene: &Renderer<'_>, light: &Light, origin: Vec3) -> Option<(Vec3, Ray)> {
        // The light must shine on the viewer's side of both normals.
        let (terms, surface) = (&self.terms, &self.surface);
        let incoming = light::incoming(light, origin, scene.step)?;
        let cosine = incoming.direction.dot(surface.shading);
        if cosine <= 0.0 || incoming.direction.dot(surface.facing) <= 0.0 {
            return None;
        }

        // Ask for its shadow only if it would be seen.
        let reflected = reflected(terms, surface, incoming.direction, self.direction);
        let sent_back = incoming.irradiance * (reflected * cosine);
        let t_min = clearance(surface);
        let ray = Ray { origin, direction: incoming.direction, t_min, t_max: incoming.reach };
        (sent_back.max_element() >= LEAST_SENT).then_some((sent_back, ray))
    }
}

/// What the surface sends back along `-direction` without further mirror or refracted rays: emission, ambient light,
/// and each light in turn unless it is in shadow.
pub(crate) fn local_light(
    scene: &Renderer<'_>,
    params: &FrameParams,
    view: &View,
    counts: &mut RayCounts,
    tracer: &mut impl Tracer,
) -> Vec3 {
    let (mut sum, is_lit) = view.unlit_part(scene);
    if !is_lit {
        return sum;
    }
    let origin = offset_origin(&view.surface, view.surface.facing);
    for light in scene.lights {
        tracer.asked(scene, view, light, origin);
        let Some((sent_back, ray)) = view.sent_back(scene, light, origin) else { continue };
        if params.features.shadows {
            counts.shadow += 1;
            sum += sent_back * light::transmittance(scene, params, &ray, tracer);
        } else {
            sum += sent_back;
        }
    }
    sum
}

/// [`local_light`] of the views of a packet that cover anything, with their shadow rays towards each light traced together.
pub(crate) fn local_lights(
    scene: &Renderer<'_>,
    params: &FrameParams,
    views: &[Option<View>; LANES],
    counts: &mut RayCounts,
) -> [Vec3; LANES] {
    let mut sums = [Vec3::ZERO; LANES];
    let mut origins = [Vec3::ZERO; LANES];
    let mut lit = 0;
    for (lane, view) in views.iter().enumerate() {
        let Some(view) = view.as_ref().filter(|view| view.alpha != 0.0) else { continue };
        let (sum, is_lit) = view.unlit_part(scene);
        sums[lane] = sum;
        origins[lane] = offset_origin(&view.surface, view.surface.facing);
        lit |= u8::from(is_lit) << lane;
    }
    for light in scene.lights {
        // Collect the rays that ask for this light.
        let idle = Ray { origin: Vec3::ZERO, direction: Vec3::ZERO, t_min: 0.0, t_max: 0.0 };
        let (mut sent, mut rays, mut asked) = ([Vec3::ZERO; LANES], [idle; LANES], 0u8);
        for lane in lanes_in(lit) {
            let Some(view) = &views[lane] else { continue };
            if let Some((sent_back, ray)) = view.sent_back(scene, light, origins[lane]) {
                (sent[lane], rays[lane]) = (sent_back, ray);
                asked |= 1 << lane;
            }
        }

        // Add what arrives.
        if params.features.shadows {
            counts.shadow += u64::from(asked.count_ones());
            let shares = light::transmittances(scene, params, &rays, asked);
            for lane in lanes_in(asked) {
                sums[lane] += sent[lane] * shares[lane];
            }
        } else {
            for lane in lanes_in(asked) {
                sums[lane] += sent[lane];
            }
        }
    }
    sums
}

/// Share of the light from `to_light` that goes to the viewer: diffuse under a reflecting coat, and the coat's
/// highlight.
fn reflected(terms: &Terms, surface: &Surface, to_light: Vec3, direction: Vec3) -> Vec3 {
    let halfway = (to_light - direction).normalize_or(surface.shading);
    let fresnel = schlick(terms.f0, terms.f90, -halfway.dot(direction));
    let lobe = if terms.f90 > 0.0 { highlight(halfway.dot(surface.shading), terms.exponent) } else { 0.0 };
    terms.diffuse * (Vec3::ONE - fresnel) * FRAC_1_PI + fresnel * lobe
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn surface(facing: Vec3, shading: Vec3, from_front: bool) -> Surface {
        Surface { point: Vec3::ZERO, error: Vec3::ZERO, facing, shading, from_front }
    }

    fn paint(base: Vec3, metallic: f32, roughness: f32, transmission: f32, ior: f32) -> Paint {
        Paint {
            base,
            alpha: 1.0,
            specular: Vec3::splat(0.04),
            metallic,
            roughness,
            transmission,
            ior,
            emissive: Vec3::ZERO,
            unlit: false,
            thin_walled: false,
        }
    }

    /// A unit vector in the x-z plane that comes down on the plane z = 0 at `angle` from its normal.
    fn incident(angle: f64) -> Vec3 {
        Vec3::new(libm::sin(angle) as f32, 0.0, -libm::cos(angle) as f32)
    }

    #[test]
    fn refraction_follows_snell_and_fresnel() {
        for degrees in [0.0f64, 30.0, 60.0, 89.0] {
            for n in [1.5f64, 2.4, 1.0 / 1.2] {
                let sin_in = libm::sin(degrees.to_radians());
                let sin_out = sin_in / n;
                let refracted = refract(incident(degrees.to_radians()), Vec3::Z, (1.0 / n) as f32);
                if sin_out > 1.0 {
                    assert_eq!(refracted, None);
                    continue;
                }
                let (bent, reflectance) = refracted.expect("no total reflection");
                let (cos_in, cos_out) = ((1.0 - sin_in * sin_in).sqrt(), (1.0 - sin_out * sin_out).sqrt());
                assert!((f64::from(bent.x) - sin_out).abs() < 1e-6 && bent.y == 0.0 && bent.z < 0.0);
                let across = (cos_in - n * cos_out) / (cos_in + n * cos_out);
                let along = (n * cos_in - cos_out) / (n * cos_in + cos_out);
                let wanted = 0.5 * (across * across + along * along);
                assert!((f64::from(reflectance) - wanted).abs() < 1e-5, "{degrees} degrees, n {n}");
            }
        }
        // Known values: 4 % at normal incidence on glass.
        let (_, reflectance) = refract(Vec3::NEG_Z, Vec3::Z, 1.0 / 1.5).expect("no total reflection");
        assert!((reflectance - 0.04).abs() < 1e-7);
    }

    #[test]
    fn the_critical_angle_itself_is_finite() {
        // eta = 2 and a sine of one half: k is 0 or as near to it as f32 comes, on either side.
        for i in -20..=20 {
            let angle = libm::asin(0.5) + f64::from(i) * 1e-8;
            match refract(incident(angle), Vec3::Z, 2.0) {
                Some((bent, reflectance)) => {
                    assert!((bent.length() - 1.0).abs() < 1e-6 && (0.0..=1.0).contains(&reflectance));
                }
                None => assert!(i > -20, "well below the angle it passes"),
            }
        }
        let exact = Vec3::new(0.6, 0.0, -0.8);
        let (bent, reflectance) = refract(exact, Vec3::Z, 1.0).expect("k = c^2 > 0");
        assert!((bent - exact).length() < 1e-6 && reflectance < 1e-12);
        // A ray along the surface (c = 0) into the same medium: k = 0.
        assert!(refract(Vec3::X, Vec3::Z, 1.0).is_some_and(|(d, f)| d.is_finite() && f.is_finite()));
        // Beyond all measure, but not NaN.
        for eta in [f32::MAX, f32::INFINITY, 1e-30] {
            for direction in [Vec3::NEG_Z, incident(0.5)] {
                if let Some((bent, reflectance)) = refract(direction, Vec3::Z, eta) {
                    assert!(bent.is_finite() && (0.0..=1.0).contains(&reflectance), "{eta}");
                }
            }
        }
    }

    #[test]
    fn highlights_send_back_at_most_what_they_get() {
        // The lobe's albedo, integrated over half vectors (a solid angle of lights is 4 (v.h) times that of its half
        // vectors) whose cosines are spread as the lobe is: c = u^(1 / (e + 2)), dc = c / ((e + 2) u) du.
        for exponent in [0.0, 1.0, 6.0, 30.0, 200.0, MAX_EXPONENT] {
            for view_angle in [0.0, 0.3, 0.8, 1.2, 1.5] {
                let view = -incident(view_angle);
                let steps = 300;
                let mut albedo = 0.0;
                for i in 0..steps {
                    let u = (f64::from(i) + 0.5) / f64::from(steps);
                    let e = f64::from(exponent);
                    let cosine = libm::pow(u, 1.0 / (e + 2.0));
                    let sine = (1.0 - cosine * cosine).sqrt();
                    for j in 0..steps {
                        let around = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(steps);
                        let (x, y) = (sine * libm::cos(around), sine * libm::sin(around));
                        let halfway = Vec3::new(x as f32, y as f32, cosine as f32);
                        let light = halfway * (2.0 * halfway.dot(view)) - view;
                        if light.z > 0.0 && halfway.dot(view) > 0.0 {
                            let weight =
                                f64::from(light.z * 4.0 * halfway.dot(view)) * cosine / ((e + 2.0) * u);
                            albedo += f64::from(highlight(halfway.z, exponent)) * weight;
                        }
                    }
                }
                albedo *= std::f64::consts::TAU / f64::from(steps * steps);
                assert!(albedo < 1.003, "{albedo} at exponent {exponent}, {view_angle}");
                if view_angle == 0.0 {
                    assert!(albedo > 0.997, "{albedo} at exponent {exponent}: the norm is exact here");
                }
            }
        }
    }

    #[test]
    fn roughness_sets_gloss_and_exponent() {
        let seen = |roughness: f32| {
            let p = paint(Vec3::ONE, 1.0, roughness, 0.0, 1.5);
            terms(&p, &surface(Vec3::Z, Vec3::Z, true), Vec3::NEG_Z, Features::default())
        };
        assert_eq!(
            (seen(0.0).mirror, seen(0.0).diffuse, seen(0.0).exponent),
            (Vec3::ONE, Vec3::ZERO, 1024.0)
        );
        assert_eq!((seen(0.25).mirror, seen(0.25).diffuse), (Vec3::splat(0.25), Vec3::splat(0.75)));
        assert!((seen(0.25).exponent - 510.0).abs() < 0.01);
        assert_eq!((seen(0.5).mirror, seen(0.5).diffuse, seen(0.5).exponent), (Vec3::ZERO, Vec3::ONE, 30.0));
        assert_eq!((seen(1.0).mirror, seen(1.0).diffuse, seen(1.0).exponent), (Vec3::ZERO, Vec3::ONE, 0.0));
    }

    proptest! {
        #[test]
        fn the_weights_of_a_hit_sum_to_at_most_one(
            base in prop::array::uniform3(0.0..=1.0f32),
            share in prop::array::uniform3(0.0..=1.0f32),
            ior in 0.2..4.0f32,
            angle in 0.0..1.57f64,
            (from_front, thin_walled) in (any::<bool>(), any::<bool>()),
        ) {
            let [metallic, roughness, transmission] = share;
            let p = Paint { thin_walled, ..paint(base.into(), metallic, roughness, transmission, ior) };
            let t = terms(&p, &surface(Vec3::Z, Vec3::Z, from_front), incident(angle), Features::default());
            let traced = t.ambient + t.mirror + t.passed;
            prop_assert!(traced.max_element() <= 1.0 + 1e-6 && traced.min_element() >= 0.0, "{:?}", t);
            for cosine in [0.0, 0.5, 1.0] {
                let fresnel = schlick(t.f0, t.f90, cosine);
                let lit = t.diffuse * (Vec3::ONE - fresnel) + fresnel;
                prop_assert!(lit.max_element() <= 1.0 + 1e-6 && lit.min_element() >= 0.0, "{:?}", t);
            }
        }

        #[test]
        fn rays_leave_on_their_side_of_the_surface(
            normal in prop::array::uniform3(-1.0..1.0f32),
            direction in prop::array::uniform3(-1.0..1.0f32),
            ior in 0.5..2.5f32,
        ) {
            let direction = Vec3::from(direction).normalize_or(Vec3::NEG_Z);
            prop_assume!(direction.z < -1e-3);
            let normal = Vec3::from(normal).normalize_or(Vec3::Z);
            let shading = if normal.dot(-direction) > 1e-3 && normal.z > 0.0 { normal } else { Vec3::Z };
            let s = surface(Vec3::Z, shading, true);
            let mirrored = reflect(direction, &s);
            prop_assert!(mirrored.z >= 0.0 && (mirrored.length() - 1.0).abs() < 1e-5);
            if let (Passage::Bent(bent), _) = pass(&paint(Vec3::ONE, 0.0, 0.0, 1.0, ior), &s, direction) {
                prop_assert!(bent.z <= 0.0 && (bent.length() - 1.0).abs() < 1e-5);
            }
        }
    }
}
