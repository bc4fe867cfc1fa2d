//! Closest-hit and any-hit traversal.

use tessera_geometry::{Aabb, Hit, Ray, Vec3};

/// The triangles that a tree refers to.
pub trait Triangles {
    /// Decoded vertices of triangle `id` in local units.
    fn vertices(&self, id: u32) -> [Vec3; 3];
}

/// A validated tree, borrowed from wherever its bytes lie.
#[derive(Clone, Copy, Debug)]
pub struct TreeView<'a> {
    /// Root box.
    pub bounds: Aabb,
    /// Slots.
    pub slots: &'a [[u32; 2]],
    /// Leaf lists.
    pub list: &'a [u32],
}

impl TreeView<'_> {
    /// The nearest hit for which `accept` is true; of equally near ones the smallest triangle id.
    /// `accept` may be called more than once for one triangle, in any order.
    pub fn closest_hit(
        &self,
        triangles: &impl Triangles,
        ray: &Ray,
        accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        let _ = (triangles, ray, accept);
        None
    }

    /// Whether any hit with `t_min < t < t_max` is accepted.
    pub fn any_hit(&self, triangles: &impl Triangles, ray: &Ray, accept: impl FnMut(&Hit) -> bool) -> bool {
        let _ = (triangles, ray, accept);
        false
    }
}
