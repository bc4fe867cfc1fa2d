//! Whitted's terms of a metal/roughness material, by the table that heads `shared/whitted/src/shade.rs`.

use crate::light::incoming;
use crate::oracle::Oracle;
use crate::path::Path;
use crate::surface::{Paint, Surface};
use glam::DVec3;
use std::f64::consts::PI;

/// What leaves a surface towards the viewer, and the rays that ask for the rest. Weights are per channel in [0, 1].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terms {
    /// Diffuse colour, `D`.
    diffuse: DVec3,
    /// Weight of the ambient radiance.
    ambient: DVec3,
    emissive: DVec3,
    f0: DVec3,
    f90: f64,
    /// Of the highlight.
    exponent: f64,
    /// Weight of the mirror ray.
    pub mirror: DVec3,
    /// Weight of the ray that passes the surface.
    pub passed: DVec3,
    /// Its direction; `None` when it goes straight on.
    pub bent: Option<DVec3>,
}

const EXPONENT_MAX: f64 = 1024.0;

/// The terms of `paint` on `surface`, met by a ray along `direction`. With `has_mirrors` off no ideal mirror is left of the material.
pub(crate) fn terms(paint: &Paint, surface: &Surface, direction: DVec3, has_mirrors: bool) -> Terms {
    let none = DVec3::ZERO;
    if paint.unlit {
        return Terms {
            diffuse: none,
            ambient: none,
            emissive: paint.base,
            f0: none,
            f90: 0.0,
            exponent: 0.0,
            mirror: none,
            passed: none,
            bent: None,
        };
    }
    let (c, m, t) = (paint.base, paint.metallic, paint.transmission);
    let gloss = if has_mirrors { (1.0 - 2.0 * paint.roughness).max(0.0) } else { 0.0 };
    let gloss = gloss * gloss;
    let glass = glass_share(paint);

    // Schlick's reflectance of the coat, seen by the viewer.
    let normal_incidence = (paint.ior - 1.0) / (paint.ior + 1.0);
    let dielectric = mix(paint.specular, DVec3::splat(normal_incidence * normal_incidence), t);
    let f0 = mix(dielectric, c, m);
    let f90 = (50.0 * f0.max_element()).min(1.0);
    let seen = schlick(f0, f90, -direction.dot(surface.shading));
    let diffuse = c * ((1.0 - m) * (1.0 - t) + m * (1.0 - gloss));

    // Glass reflects by Fresnel's law and passes the rest.
    let mut mirror = seen * (gloss * (1.0 - glass));
    let (mut passed, mut bent) = (none, None);
    if glass > 0.0 {
        let is_inside = !surface.from_front && !paint.thin_walled;
        match through_glass(paint, surface, direction, is_inside) {
            Some((way, fresnel)) => {
                let fresnel = if has_mirrors { fresnel } else { 0.0 };
                // From inside, what is not passed has nowhere else to go.
                let sharp = if is_inside { 1.0 } else { gloss };
                mirror += DVec3::splat(glass * fresnel * sharp);
                passed = c * (glass * (1.0 - fresnel));
                bent = way;
            }
            None if has_mirrors => mirror += DVec3::splat(glass * if is_inside { 1.0 } else { gloss }),
            None => {}
        }
    }
    let width = paint.roughness * paint.roughness;
    Terms {
        diffuse,
        ambient: diffuse * (DVec3::ONE - seen * gloss),
        emissive: paint.emissive,
        f0,
        f90,
        exponent: (2.0 / (width * width) - 2.0).clamp(0.0, EXPONENT_MAX),
        mirror,
        passed,
        bent,
    }
}

/// The share of a surface that refracts.
pub(crate) fn glass_share(paint: &Paint) -> f64 {
    if paint.unlit { 0.0 } else { paint.transmission * (1.0 - paint.metallic) }
}

/// Where glass bends a ray to (no direction: straight on) and how much of it is reflected instead; `None` when all of it is.
fn through_glass(
    paint: &Paint,
    surface: &Surface,
    direction: DVec3,
    is_inside: bool,
) -> Option<(Option<DVec3>, f64)> {
    if paint.ior == 1.0 {
        return Some((None, 0.0));
    }
    let (here, there) = if is_inside { (paint.ior, 1.0) } else { (1.0, paint.ior) };
    let (bent, fresnel) = refract(direction, surface.shading, here, there)?;
    let way = if paint.thin_walled { None } else { Some(onto_side(bent, -surface.facing)) };
    Some((way, fresnel))
}

/// Direction and unpolarised reflectance of a ray that passes from a medium of index `here` into one of index `there` through a surface
/// whose `normal` faces it; `None` at total reflection.
pub(crate) fn refract(direction: DVec3, normal: DVec3, here: f64, there: f64) -> Option<(DVec3, f64)> {
    // Snell: the part along the surface grows by the ratio of the indices.
    let cosine = (-direction.dot(normal)).clamp(0.0, 1.0);
    let along = (direction + normal * cosine) * (here / there);
    let sine2 = (1.0 - cosine * cosine) * (here / there) * (here / there);
    // A NaN is not at most 1.
    if sine2 <= 1.0 {
        let cosine_there = (1.0 - sine2).sqrt();
        let bent = along - normal * cosine_there;
        let perpendicular = (here * cosine - there * cosine_there) / (here * cosine + there * cosine_there);
        let parallel = (there * cosine - here * cosine_there) / (there * cosine + here * cosine_there);
        let reflectance = (perpendicular * perpendicular + parallel * parallel) / 2.0;
        Some((bent.try_normalize().unwrap_or(direction), if reflectance <= 1.0 { reflectance } else { 1.0 }))
    } else {
        None
    }
}

/// The mirror ray's direction, which never goes under the surface.
pub(crate) fn reflect(direction: DVec3, surface: &Surface) -> DVec3 {
    let normal = surface.shading;
    onto_side((direction - normal * (2.0 * direction.dot(normal))).normalize(), surface.facing)
}

/// `direction`, mirrored in the surface when it points to the other side of it than `side`.
fn onto_side(direction: DVec3, side: DVec3) -> DVec3 {
    let height = direction.dot(side);
    if height < 0.0 { direction - side * (2.0 * height) } else { direction }
}

fn mix(a: DVec3, b: DVec3, share: f64) -> DVec3 {
    a * (1.0 - share) + b * share
}

fn schlick(f0: DVec3, f90: f64, cosine: f64) -> DVec3 {
    let x = (1.0 - cosine).clamp(0.0, 1.0);
    mix(f0, DVec3::splat(f90), x * x * x * x * x)
}

/// Blinn-Phong's lobe, its albedo at most 1.
fn highlight(cosine: f64, exponent: f64) -> f64 {
    let scale = (exponent + 2.0) * (exponent + 4.0) / (8.0 * PI * (libm::exp2(-exponent / 2.0) + exponent));
    scale * libm::pow(cosine.max(0.0), exponent)
}

/// What the surface sends back by itself: emission, ambient light, and each light that reaches it.
pub(crate) fn local_light(
    oracle: &Oracle,
    path: &mut Path<'_>,
    surface: &Surface,
    terms: &Terms,
    direction: DVec3,
) -> DVec3 {
    let mut sum = terms.emissive + terms.ambient * oracle.ambient;
    if terms.diffuse == DVec3::ZERO && terms.f90 == 0.0 {
        return sum;
    }
    for light in &oracle.lights {
        // The light must shine on the viewer's side of both normals.
        let Some(incoming) = incoming(light, surface.point) else { continue };
        let cosine = incoming.direction.dot(surface.shading);
        if cosine <= 0.0 || incoming.direction.dot(surface.facing) <= 0.0 {
            continue;
        }

        // Diffuse under a reflecting coat, and the coat's highlight.
        let halfway = (incoming.direction - direction).try_normalize().unwrap_or(surface.shading);
        let fresnel = schlick(terms.f0, terms.f90, -halfway.dot(direction));
        let lobe = highlight(halfway.dot(surface.shading), terms.exponent);
        let reflected = terms.diffuse * (DVec3::ONE - fresnel) / PI + fresnel * lobe;
        let sent = incoming.irradiance * reflected * cosine;
        if sent == DVec3::ZERO {
            continue;
        }
        let mut share = DVec3::ONE;
        if !oracle.without.shadows {
            path.rays.shadow += 1;
            let (ray, start) = oracle.leave(surface, incoming.direction);
            share = oracle.transmittance(&ray, start, incoming.reach, path.min_weight);
        }
        sum += sent * share;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refraction_follows_snell_and_fresnel() {
        let normal = DVec3::Y;
        // Straight on: ((n - 1) / (n + 1))^2.
        let (bent, reflectance) = refract(DVec3::NEG_Y, normal, 1.0, 1.5).expect("it passes");
        assert_eq!(bent, DVec3::NEG_Y);
        assert!((reflectance - 0.04).abs() < 1e-15);

        // Slanting: the sines are as the indices, in the plane of incidence; and the way back is the same.
        for degrees in [1.0_f64, 20.0, 45.0, 70.0, 89.9] {
            let angle = degrees.to_radians();
            let direction = DVec3::new(libm::sin(angle), -libm::cos(angle), 0.0);
            let (bent, there) = refract(direction, normal, 1.0, 1.5).expect("it passes");
            assert!((bent.x - direction.x / 1.5).abs() < 1e-15 && bent.z == 0.0 && bent.y < 0.0);
            let (back, here) = refract(-bent, -normal, 1.5, 1.0).expect("it comes back");
            assert!((back + direction).length() < 1e-12 && (there - here).abs() < 1e-12, "{degrees}");
        }

        // Brewster's angle: one polarisation alone is reflected, half of ((n^2 - 1) / (n^2 + 1))^2.
        let direction = DVec3::new(1.5, -1.0, 0.0).normalize();
        let (_, reflectance) = refract(direction, normal, 1.0, 1.5).expect("it passes");
        let expected: f64 = (1.5 * 1.5 - 1.0) / (1.5 * 1.5 + 1.0);
        assert!((reflectance - expected * expected / 2.0).abs() < 1e-15);

        // Total reflection begins where the sine is the ratio of the indices.
        let towards = |sine: f64| DVec3::new(sine, -(1.0 - sine * sine).sqrt(), 0.0);
        assert!(refract(towards(1.0 / 1.5 - 1e-9), normal, 1.5, 1.0).is_some());
        assert!(refract(towards(1.0 / 1.5 + 1e-9), normal, 1.5, 1.0).is_none());
    }

    #[test]
    fn the_lobe_reflects_all_light_at_most() {
        // Of light from straight above: the integral over the hemisphere of B(n.h) cos(theta), h halfway to the viewer.
        for exponent in [0.0, 1.0, 30.0, 1024.0] {
            let steps = 200_000;
            let sum: f64 = (0..steps)
                .map(|k| {
                    let theta = (f64::from(k) + 0.5) / f64::from(steps) * PI / 2.0;
                    highlight(libm::cos(theta / 2.0), exponent) * libm::cos(theta) * libm::sin(theta)
                })
                .sum();
            let albedo = sum * 2.0 * PI * (PI / 2.0) / f64::from(steps);
            assert!((albedo - 1.0).abs() < 1e-6, "exponent {exponent}: {albedo}");
        }
    }
}
