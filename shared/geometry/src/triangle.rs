//! The watertight ray/triangle test (Woop, Benthin, Wald 2013), with edges ordered by position.

use crate::{Ray, Vec3};

/// The part of the test that depends on the ray alone: a permutation of the axes and a shear that take the ray to +z.
#[derive(Clone, Copy, Debug)]
pub struct RayShear {
    /// Axis permutation: `kz` is the direction's largest component.
    pub k: [usize; 3],
    /// Shear and scale.
    pub s: Vec3,
}

impl RayShear {
    /// Prepares `ray`; its direction must be finite and non-zero.
    pub fn new(ray: &Ray) -> Self {
        let _ = ray;
        Self { k: [0, 1, 2], s: Vec3::ONE }
    }
}

/// Distance and barycentric weights `(t, b1, b2)` where `ray` meets the triangle, `t_min < t <= t_max` (inclusive
/// above so that ties can be decided by id).
pub fn intersect(ray: &Ray, shear: &RayShear, vertices: [Vec3; 3], t_max: f32) -> Option<(f32, f32, f32)> {
    let _ = (ray, shear, vertices, t_max);
    None
}
