//! The map between world space and local space.

use crate::{DVec3, Vec3};

/// Where the voxel grid lies in the world. `local = (world - anchor) / step - centre`.
///
/// A uniform scale and a translation: directions are the same in both spaces and `t_world = t_local * step`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// World position of the grid's low corner.
    pub anchor: DVec3,
    /// Side of a voxel in world units, > 0.
    pub step: f64,
    /// Grid centre in voxels: 512 per cell of each axis, a whole number.
    pub centre: DVec3,
}

impl LocalFrame {
    /// A world position in local units, rounded to `f32` once.
    pub fn to_local(&self, world: DVec3) -> Vec3 {
        ((world - self.anchor) / self.step - self.centre).as_vec3()
    }

    /// A local position in world units.
    pub fn to_world(&self, local: Vec3) -> DVec3 {
        (local.as_dvec3() + self.centre) * self.step + self.anchor
    }
}
