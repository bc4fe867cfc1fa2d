//! A ray and what it hits.

use crate::Vec3;
use crate::mutation::{Mutation, is_on};

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
    /// Least largest component of a direction, 2^-60.
    pub const DIRECTION_MIN: f32 = f32::from_bits((127 - 60) << 23);

    /// Greatest largest component of a direction, 2^60. Between the two no distance to a coordinate from 2^-60 to 2^60 overflows, or loses
    /// digits by underflow.
    pub const DIRECTION_MAX: f32 = f32::from_bits((127 + 60) << 23);

    /// The least share of the largest component of a direction that is a divisor ([`Ray::divisor`]), 2^-40.
    pub const DIVISOR_SHARE: f32 = f32::from_bits((127 - 40) << 23);

    /// Whether the kernels can trace this ray: a finite origin, a finite direction whose largest component is from
    /// [`Ray::DIRECTION_MIN`] to [`Ray::DIRECTION_MAX`], and `0 <= t_min < t_max`. Every other ray misses everything.
    pub fn is_traceable(&self) -> bool {
        let length = self.direction.abs().max_element();
        self.origin.is_finite()
            && self.direction.is_finite()
            && (Self::DIRECTION_MIN..=Self::DIRECTION_MAX).contains(&length)
            && self.t_min >= 0.0
            && self.t_min < self.t_max
    }

    /// The direction for kernels that divide by its components: those below 2^-40 of the largest are 0, which moves no point of the ray by more
    /// than a 2^16th of a roundoff of its distance from the origin; of the others the inverse is at most 2^100.
    #[inline]
    pub fn divisor(&self) -> Vec3 {
        let least = self.direction.abs().max_element() * Self::DIVISOR_SHARE;
        Vec3::from_array(self.direction.to_array().map(|d| if d.abs() < least { 0.0 } else { d }))
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
        let is_first = (self.triangle < other.triangle) != is_on(Mutation::LargestId);
        self.t < other.t || (self.t == other.t && is_first)
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
        assert!(!ray(Vec3::new(1e-20, 0.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::new(1e20, 0.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::new(f32::NAN, 1.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::new(f32::INFINITY, 1.0, 0.0), 0.0, 1.0).is_traceable());
        assert!(!ray(Vec3::X, -1.0, 1.0).is_traceable());
        assert!(!ray(Vec3::X, f32::NAN, 1.0).is_traceable());
        assert!(!ray(Vec3::X, 1.0, 1.0).is_traceable());
        assert!(!Ray { origin: Vec3::NAN, ..ray(Vec3::X, 0.0, 1.0) }.is_traceable());
    }

    #[test]
    fn components_that_do_not_move_the_ray_are_no_divisors() {
        for scale in [Ray::DIRECTION_MIN, 1.0, Ray::DIRECTION_MAX] {
            let divisor = ray(Vec3::new(-1e-13, 1.0, 1e-12) * scale, 0.0, 1.0).divisor();
            assert_eq!(divisor, Vec3::new(0.0, 1.0, 1e-12) * scale);
            assert!(divisor.z.recip().is_finite() && divisor.y.recip().is_normal());
        }
        assert_eq!(ray(Vec3::new(1e-40, 1.0, f32::MIN_POSITIVE), 0.0, 1.0).divisor(), Vec3::Y);
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
