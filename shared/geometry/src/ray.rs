//! A ray and what it hits.

use crate::Vec3;

/// A ray in local space; a hit counts when `t_min < t < t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start point, local units.
    pub origin: Vec3,
    /// Direction; unit length for every ray that the tracer makes, but the kernels only need it finite and non-zero.
    pub direction: Vec3,
    /// Exclusive lower bound of `t`, in multiples of `direction`.
    pub t_min: f32,
    /// Exclusive upper bound of `t`.
    pub t_max: f32,
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
    /// Barycentric weight of vertex 2; vertex 0 weighs `1 - b1 - b2`.
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
