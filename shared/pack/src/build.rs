//! From plain arrays to a pack.

use crate::{PackInput, view::Pack};
use tessera_kdtree::{BuildOptions, build::TreeStats};

/// Which vertex sections are held as plain `f32` instead of quantised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Plain {
    /// `f32` positions in local units.
    pub positions: bool,
    /// `f32` normals.
    pub normals: bool,
    /// `f32` texture coordinates.
    pub uvs: bool,
}

/// How a pack is made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PackOptions {
    /// Sections held plain.
    pub plain: Plain,
    /// kd-tree options.
    pub tree: BuildOptions,
}

/// What was found, dropped and left out while packing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PackStats {
    /// Triangles and vertices of the input.
    pub triangles_in: u64,
    /// Vertices of the input.
    pub vertices_in: u64,
    /// Triangles in the pack.
    pub triangles: u64,
    /// Vertices in the pack.
    pub vertices: u64,
    /// Clean-up steps (algorithms A.1) by name, each with its count; zero counts included.
    pub dropped: Vec<(&'static str, u64)>,
    /// Total world area of the triangles that collapsed when quantised.
    pub lost_area: f64,
    /// Cells along each axis.
    pub grid: [u32; 3],
    /// Cells in the table.
    pub cells: u32,
    /// Voxel side in world units.
    pub step: f64,
    /// Section name and bytes.
    pub sections: Vec<(&'static str, u64)>,
    /// Optional sections that this scene did not need: what, why.
    pub left_out: Vec<(&'static str, String)>,
    /// The tree.
    pub tree: TreeStats,
}

/// Why a pack could not be made; every variant is the input's fault.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// A message that says what, where and what to do.
    #[error("{0}")]
    Input(String),
}

/// Packs `input`. Deterministic: the same bytes for any number of threads of the current rayon pool.
pub fn build_pack(input: PackInput, options: &PackOptions) -> Result<(Pack, PackStats), BuildError> {
    let _ = (input, options);
    Err(BuildError::Input("not built yet".into()))
}
