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
    /// Voxels along the side of a cell.
    pub const VOXELS_PER_CELL: u32 = 1024;

    /// The frame of a grid whose low corner is `anchor`, of voxels of side `step` and so many `cells` an axis.
    pub fn of_grid(anchor: [f64; 3], step: f64, cells: [u32; 3]) -> Self {
        let centre = DVec3::from_array(cells.map(|n| f64::from(n) * f64::from(Self::VOXELS_PER_CELL / 2)));
        Self { anchor: DVec3::from_array(anchor), step, centre }
    }

    /// A world position in local units, rounded to `f32` once.
    pub fn to_local(&self, world: DVec3) -> Vec3 {
        ((world - self.anchor) / self.step - self.centre).as_vec3()
    }

    /// A local position in world units.
    pub fn to_world(&self, local: Vec3) -> DVec3 {
        (local.as_dvec3() + self.centre) * self.step + self.anchor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 991 x 610 x 415 cells, as the paper's Sponza.
    fn frame(anchor: DVec3, step: f64) -> LocalFrame {
        let frame = LocalFrame::of_grid(anchor.to_array(), step, [991, 610, 415]);
        assert_eq!(frame.centre, DVec3::new(991.0, 610.0, 415.0) * 512.0);
        frame
    }

    #[test]
    fn the_grid_centre_is_the_local_origin_and_voxel_centres_are_exact() {
        let f = frame(DVec3::new(-3.0, 1e7, 0.125), 0.25);
        assert_eq!(f.to_local(f.anchor + f.centre * 0.25), Vec3::ZERO);
        // Everything here is a multiple of 2^-3 below 2^31: no rounding.
        for voxel in
            [DVec3::ZERO, DVec3::new(1_014_783.0, 624_639.0, 424_959.0), DVec3::new(1.0, 1023.0, 1024.0)]
        {
            let centre = voxel + 0.5;
            let local = f.to_local(f.anchor + centre * 0.25);
            assert_eq!(local.as_dvec3(), centre - f.centre);
            assert_eq!(f.to_world(local), f.anchor + centre * 0.25);
        }
    }

    #[test]
    fn distances_scale_by_the_step_and_directions_stay() {
        let f = frame(DVec3::new(1e6, -2e6, 3.0), 1.0 / 1024.0);
        let (a, b) = (DVec3::new(1e6 + 1.0, -2e6 + 2.0, 4.0), DVec3::new(1e6 + 4.0, -2e6 + 6.0, 16.0));
        // Local coordinates are whole numbers below 2^24 here.
        let local = f.to_local(b) - f.to_local(a);
        assert_eq!(local, Vec3::new(3.0, 4.0, 12.0) * 1024.0);
        assert_eq!(f64::from(local.length()) * f.step, (b - a).length());
    }
}
