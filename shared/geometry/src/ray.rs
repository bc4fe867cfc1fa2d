//! A ray and what it hits.

use crate::Vec3;

/// A ray in local space; a hit counts when `t_min < t < t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start point, local units.
    pub origin: Vec3,
    /// Direction; unit length for every ray that the tracer makes, but the kernels only need it finite and non-zero.
    pub direction: Vec3,
    /// Exclusive lower bound of `t`, in multiples of `direction`; at least 0.
    pub t_min: f32,
    /// Exclusive upper bound of `t`.
    pub t_max: f32,
}

impl Ray {
    /// A direction component smaller than this counts as 0 where a kernel divides by it: `1 / 2^-100` times any
    /// coordinate below 2^27 is still finite, and within `t < 2^76` such a component moves the ray by less than 2^-24.
    pub const TINY_COMPONENT: f32 = f32::from_bits((127 - 100) << 23);

    /// Whether the kernels can trace this ray: a finite origin, a finite direction with a component of at least
    /// [`Ray::TINY_COMPONENT`], and `0 <= t_min < t_max`. Every other ray misses everything.
    pub fn is_traceable(&self) -> bool {
        self.origin.is_finite()
            && self.direction.is_finite()
            && self.direction.abs().max_element() >= Self::TINY_COMPONENT
            && self.t_min >= 0.0
            && self.t_min < self.t_max
    }
}

/// The nearest intersection of a ray with a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in multiples of the ray's direction.
    pub t: f32,
    /// Packed triangle id.
    pub triangle: u32,
    /// Barycentric weight of vertex 1.
    pub b1: f32,
    /// Barycentric weight of vertex 2; vertex 0 weighs `1 - b1 - b2`, which is never negative in this order.
    pub b2: f32,
}

impl Hit {
    /// The id that stands for 'no triangle'.
    pub const NO_TRIANGLE: u32 = u32::MAX;

    /// Whether this hit is nearer than `other`; equal distances are decided by the smaller triangle id, so that the
    /// answer does not depend on the order in which triangles are tested.
    pub fn precedes(&self, other: &Hit) -> bool {
        self.t < other.t || (self.t == other.t && self.triangle < other.triangle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(direction: Vec3, t_min: f32, t_max: f32) -> Ray {
        Ray { origin: Vec3::ZERO, direction, t_min, t_max }
    }

    #[test]
    fn rays_without_a_usable_direction_or_range_are_not_traceable() {
        assert!(ray(Vec3::X, 0.0, f32::INFINITY).is_traceable());
        assert!(ray(Vec3::new(1.0, 1e-40, -0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::ZERO, 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::splat(1e-40), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::new(f32::NAN, 1.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::new(f32::INFINITY, 1.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::X, -1.0, 1.0).is_traceable());
        assert!(!ray(Vec3::X, f32::NAN, 1.0).is_traceable());
        assert!(!ray(Vec3::X, 1.0, 1.0).is_traceable());
        assert!(!Ray { origin: Vec3::NAN, ..ray(Vec3::X, 0.0, 1.0) }.is_traceable());
    }

    #[test]
    fn equal_distances_are_decided_by_the_smaller_id() {
        let hit = |t, triangle| Hit { t, triangle, b1: 0.0, b2: 0.0 };
        assert!(hit(1.0, 7).precedes(&hit(2.0, 3)));
        assert!(hit(1.0, 3).precedes(&hit(1.0, 7)));
        assert!(!hit(1.0, 7).precedes(&hit(1.0, 7)));
        assert!(!hit(f32::NAN, 0).precedes(&hit(1.0, 7)));
    }
}
