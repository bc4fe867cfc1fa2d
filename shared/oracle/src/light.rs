//! Lights, what is in their way, and what a ray sees that misses everything.

use crate::oracle::Oracle;
use crate::path::LAYERS_MAX;
use crate::shade::glass_share;
use crate::surface::{lets_light_through, vector};
use crate::texture::Coding;
use crate::triangle::{Ray, Start};
use glam::DVec3;
use std::f64::consts::{PI, TAU};
use tessera_scene::{Environment, Light, LightKind, TextureRef, Wrap};

/// Light that arrives at a point if nothing is in its way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incoming {
    /// Unit vector to the light.
    pub direction: DVec3,
    /// On a surface that faces the light.
    pub irradiance: DVec3,
    /// Distance at which occluders end.
    pub reach: f64,
}

/// Bound of an irradiance, part of the model: a light almost at the surface stays finite.
const IRRADIANCE_MAX: f64 = (1u64 << 63) as f64;

/// What `light` brings to `point`; `None` when that is nothing.
pub(crate) fn incoming(light: &Light, point: DVec3) -> Option<Incoming> {
    let intensity = vector(light.intensity);
    if light.kind == LightKind::Directional {
        return Some(Incoming { direction: -light.direction, irradiance: intensity, reach: f64::INFINITY });
    }
    let way = light.position - point;
    let distance = way.length();
    if distance == 0.0 {
        return None;
    }
    let direction = way / distance;

    // Let it fall off with the square of the distance, and smoothly to the end of its range (KHR_lights_punctual).
    let outside = distance / f64::from(light.range);
    let window = (1.0 - outside * outside * outside * outside).clamp(0.0, 1.0);
    let mut share = window / (distance * distance);

    // And between a spot's cones.
    if let LightKind::Spot { inner, outer } = light.kind {
        let (inner, outer) = (libm::cos(f64::from(inner)), libm::cos(f64::from(outer)));
        let inside = ((light.direction.dot(-direction) - outer) / (inner - outer)).clamp(0.0, 1.0);
        share *= inside * inside;
    }
    let irradiance = (intensity * share.min(IRRADIANCE_MAX)).min(DVec3::splat(IRRADIANCE_MAX));
    let reach = reach(light.position, distance);
    (share > 0.0).then_some(Incoming { direction, irradiance, reach })
}

/// Where occluders of a light end, so that a lamp in or on a surface is not put out by it. Sources state places in `f32`: lamp and
/// surface may each be 2^-24 of their coordinates off along each axis, and a lamp's surface is met within that of the lamp.
fn reach(position: DVec3, distance: f64) -> f64 {
    let place = position.abs();
    let margin = 2.0 * (place.x + place.y + place.z) * f64::from(f32::EPSILON) / 2.0;
    (distance - margin).max(0.0)
}

impl Oracle {
    /// The share of a light that arrives along `ray`: 0 in shadow, 1 in the open, a colour behind glass or a veil. All sides of
    /// occluders count; glass passes light unbent.
    pub(crate) fn transmittance(&self, ray: &Ray, start: Start, reach: f64, min_weight: f64) -> DVec3 {
        let mut passed = DVec3::ONE;
        let mut layers = 0;
        self.tree.each(ray, start, reach, |hit| {
            if self.is_hole(hit) {
                return true;
            }
            if lets_light_through(self.material(hit.id)) {
                let paint = self.paint(hit);
                passed *= paint.base * (glass_share(&paint) * paint.alpha) + DVec3::splat(1.0 - paint.alpha);
                layers += 1;
            } else {
                passed = DVec3::ZERO;
            }
            // Shares only fall, so that the order of the layers says nothing.
            let is_dark = passed == DVec3::ZERO || passed.max_element() < min_weight || layers >= LAYERS_MAX;
            if is_dark {
                passed = DVec3::ZERO;
            }
            !is_dark
        });
        passed
    }

    /// Linear radiance from the unit vector `direction`, where nothing is.
    pub(crate) fn backdrop(&self, direction: DVec3) -> DVec3 {
        match self.environment {
            Environment::None => DVec3::ZERO,
            Environment::Gradient { zenith, horizon, nadir } => {
                let end = if direction.y < 0.0 { nadir } else { zenith };
                let share = direction.y.abs().min(1.0);
                vector(horizon) * (1.0 - share) + vector(end) * share
            }
            Environment::Map { image, scale } => {
                // The image's centre lies towards +z; seen from there, -x is to the right.
                let right = libm::atan2(-direction.x, direction.z) / TAU;
                let down = libm::acos(direction.y.clamp(-1.0, 1.0)) / PI;
                let sampling =
                    TextureRef { image, wrap_s: Wrap::Repeat, wrap_t: Wrap::Clamp, nearest: false };
                let (color, _) = self.picture(&sampling).at([0.5 + right, down], &sampling, Coding::Srgb);
                color * f64::from(scale)
            }
        }
    }
}
