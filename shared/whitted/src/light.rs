//! Lights and the shadow rays towards them.

use crate::FrameParams;
use crate::path::{After, MAX_LAYERS, is_cut_off};
use crate::probe::{Direct, Tracer};
use crate::scene::{Renderer, lets_light_through};
use crate::shade::glass_share;
use crate::surface::paint_at;
use tessera_geometry::mutation::{Mutation, is_on, unless};
use tessera_geometry::wide::{LANES, lanes_in};
use tessera_geometry::{Hit, Ray, Vec3, rounding::gamma};
use tessera_pack::{Light, LightKind};

/// Light that arrives at a point if nothing is in its way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incoming {
    /// Unit vector to the light.
    pub direction: Vec3,
    /// On a surface that faces the light.
    pub irradiance: Vec3,
    /// Local distance at which occluders end.
    pub reach: f32,
}

/// Bound of an irradiance, so that a light almost at the surface stays finite in all sums.
pub(crate) const MAX_IRRADIANCE: f32 = (1u64 << 63) as f32;

/// What `light` brings to `origin`; `None` when that is nothing. `step` is the world length of a local unit.
pub(crate) fn incoming(light: &Light, origin: Vec3, step: f64) -> Option<Incoming> {
    // A directional light is everywhere the same.
    let intensity = Vec3::from(light.intensity);
    let shines = Vec3::from(light.direction);
    if light.kind == LightKind::Directional as u32 {
        return Some(Incoming { direction: -shines, irradiance: intensity, reach: f32::INFINITY });
    }

    // Measure the way. A light exactly at the point has no direction and is left out.
    let position = Vec3::from(light.position);
    let way = position - origin;
    let distance = way.length();
    if !(distance > 0.0 && distance < f32::INFINITY) {
        return None;
    }
    let direction = way / distance;

    // Let it fall off with the square of the world distance, within its window and cone.
    let world = (f64::from(distance) * step) as f32;
    let mut share = window(world, light.range) / (world * world);
    if light.kind == LightKind::Spot as u32 {
        share *= cone(-direction.dot(shines), light.cos_inner, light.cos_outer);
    }
    let irradiance = (intensity * share.min(MAX_IRRADIANCE)).min(Vec3::splat(MAX_IRRADIANCE));
    (share > 0.0).then_some(Incoming { direction, irradiance, reach: reach(distance, position) })
}

/// Where occluders of a light at `distance` end, so that a lamp in or on a surface is not put out by it.
///
/// Three things may put that surface before the light: packing moves a vertex by up to half a voxel an axis, sqrt(3)
/// / 2 < 1; rounding the light's place, within gamma(3) of its coordinates; and rounding the ray's unit direction,
/// within gamma(6) < 2^-20 of the distance.
fn reach(distance: f32, position: Vec3) -> f32 {
    let place = position.abs();
    let margin = 1.0 + (place.x + place.y + place.z) * gamma(3) + distance * (1.0 / 1_048_576.0);
    (distance - unless(Mutation::NoLightMargin, margin, 0.0)).max(0.0)
}

/// The smooth end of a light's range (KHR_lights_punctual, "Range Property"): `max(min(1 - (d / range)^4, 1), 0)`.
fn window(distance: f32, range: f32) -> f32 {
    let x = distance / range;
    let x2 = x * x;
    (1.0 - x2 * x2).clamp(0.0, 1.0)
}

/// The fall-off of a spot between its cones (KHR_lights_punctual, "Inner and Outer Cone Angles"), without that text's
/// bound of 0.001 on the difference of the cosines, which would dim narrow spots; 2^-24 only keeps the division
/// defined.
fn cone(cosine: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let x = (cosine - cos_outer) / (cos_inner - cos_outer).max(f32::EPSILON * 0.5);
    let x = x.clamp(0.0, 1.0);
    x * x
}

/// The share of a light that arrives along `ray`: 0 in shadow, 1 in the open, a colour behind glass or a veil.
///
/// Occluders begin at the ray's `t_min`, and any side of them is opaque. Holes pass light. Glass passes it unbent with its share
/// times its colour, and what blends passes `1 - alpha` besides.
pub(crate) fn transmittance(
    scene: &Renderer<'_>,
    params: &FrameParams,
    ray: &Ray,
    tracer: &mut impl Tracer,
) -> Vec3 {
    // Look for anything opaque: in most scenes the whole question.
    if tracer.is_blocked(scene, ray) { Vec3::ZERO } else { filtered(scene, params, ray, tracer) }
}

/// Whether anything opaque is on `ray`.
pub(crate) fn is_blocked(scene: &Renderer<'_>, ray: &Ray) -> bool {
    let (tree, mesh) = (&scene.tree, &scene.mesh);
    match (scene.needs.see_through, scene.needs.holes) {
        (false, false) => tree.any_hit(mesh, ray, |_| true),
        (false, true) => tree.any_hit(mesh, ray, |hit| scene.is_solid(hit)),
        (true, _) => tree.any_hit(mesh, ray, |hit| is_opaque(scene, hit)),
    }
}

/// [`transmittance`] along those of eight rays whose bit is set in `lanes`.
pub(crate) fn transmittances(
    scene: &Renderer<'_>,
    params: &FrameParams,
    rays: &[Ray; LANES],
    lanes: u8,
) -> [Vec3; LANES] {
    let (tree, mesh, kernel) = (&scene.tree, &scene.mesh, scene.kernel);
    let blocked = match (scene.needs.see_through, scene.needs.holes) {
        (false, false) => tree.any_hits(kernel, mesh, rays, lanes),
        (false, true) => tree.any_hits_where(kernel, mesh, rays, lanes, |_, hit| scene.is_solid(hit)),
        (true, _) => tree.any_hits_where(kernel, mesh, rays, lanes, |_, hit| is_opaque(scene, hit)),
    };
    let mut shares = [Vec3::ZERO; LANES];
    for lane in lanes_in(lanes & !blocked) {
        shares[lane] = filtered(scene, params, &rays[lane], &mut Direct);
    }
    shares
}

/// Whether no light passes at `hit`.
pub(crate) fn is_opaque(scene: &Renderer<'_>, hit: &Hit) -> bool {
    let is_see_through =
        lets_light_through(scene.material(hit.triangle)) && !is_on(Mutation::ShadowsIgnoreAlpha);
    !is_see_through && scene.is_solid(hit)
}

/// The share of a light along `ray`, which meets nothing opaque.
fn filtered(scene: &Renderer<'_>, params: &FrameParams, ray: &Ray, tracer: &mut impl Tracer) -> Vec3 {
    // Filter the light surface by surface, each once: a traversal may meet a triangle in several leaves, but (t, id) orders
    // the hits whatever the tree.
    let mut passed = Vec3::ONE;
    if !scene.needs.see_through {
        return passed;
    }
    let mut after = After::start(ray.t_min);
    for _ in 0..MAX_LAYERS {
        let Some(hit) = tracer.layer(scene, ray, after) else { return passed };
        let paint = paint_at(scene, &hit);
        let through = paint.base * (glass_share(&paint, params.features) * paint.alpha);
        passed *= through + Vec3::splat(1.0 - paint.alpha);
        tracer.dimmed(passed.max_element());
        if is_cut_off(passed, params.sampling.cutoff) {
            return Vec3::ZERO;
        }
        after = After::hit(&hit);
    }

    // Behind as many layers as a path may pass there is no light.
    Vec3::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp(kind: LightKind) -> Light {
        Light {
            position: [0.0, 0.0, 10.0],
            kind: kind as u32,
            direction: [0.0, 0.0, -1.0],
            range: f32::INFINITY,
            intensity: [8.0, 4.0, 2.0],
            cos_inner: 0.9,
            cos_outer: 0.5,
            reserved: [0; 3],
        }
    }

    #[test]
    fn distance_counts_in_world_units() {
        // 8 local units of half a metre each: 4 metres.
        let seen = incoming(&lamp(LightKind::Point), Vec3::new(0.0, 0.0, 2.0), 0.5).expect("lit");
        assert_eq!((seen.direction, seen.irradiance), (Vec3::Z, Vec3::new(0.5, 0.25, 0.125)));
        assert!(seen.reach < 7.0 && seen.reach > 6.99, "the last voxel is the lamp's own: {}", seen.reach);
    }

    #[test]
    fn a_spot_shines_into_its_cone() {
        let spot = lamp(LightKind::Spot);
        // On the axis all of it; where the cosine is 0.7, ((0.7 - 0.5) / 0.4)^2 of it; outside nothing.
        assert_eq!(incoming(&spot, Vec3::ZERO, 1.0).map(|i| i.irradiance.x), Some(0.08));
        let tangent = (1.0f32 / 0.49 - 1.0).sqrt();
        let inside = incoming(&spot, Vec3::new(10.0 * tangent, 0.0, 0.0), 1.0).expect("in the cone");
        assert!((inside.irradiance.x - 0.25 * 8.0 * 0.49 / 100.0).abs() < 1e-6);
        assert!(incoming(&spot, Vec3::new(30.0, 0.0, 0.0), 1.0).is_none());
        assert!(incoming(&spot, Vec3::new(0.0, 0.0, 20.0), 1.0).is_none());
    }

    #[test]
    fn a_window_ends_at_the_range() {
        assert_eq!((window(0.0, 2.0), window(2.0, 2.0), window(3.0, 2.0)), (1.0, 0.0, 0.0));
        assert_eq!((window(1.0, 2.0), window(1e30, f32::INFINITY)), (1.0 - 1.0 / 16.0, 1.0));
    }

    #[test]
    fn no_place_makes_a_nan() {
        let point = lamp(LightKind::Point);
        for at in [10.0, 10.0f32.next_up(), 1e-30, 1e18, 1e38, f32::MAX] {
            for step in [1e-300, 1e-20, 1.0, 1e300] {
                if let Some(seen) = incoming(&point, Vec3::new(0.0, 0.0, at), step) {
                    assert!(seen.irradiance.is_finite() && seen.direction.is_finite() && seen.reach >= 0.0);
                    assert!((seen.direction.length() - 1.0).abs() < 1e-6);
                }
            }
        }
        assert!(incoming(&point, Vec3::new(0.0, 0.0, 10.0), 1.0).is_none(), "the lamp's own place");
    }
}
