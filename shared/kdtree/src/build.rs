//! The builder.

use tessera_geometry::{Aabb, Vec3};

/// What the builder may choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuildOptions {
    /// References allowed on one inner node, 0..=2.
    pub max_refs: u32,
    /// Least share of the extent of a node that a referenced triangle spans, in [0, 1].
    pub tau_occupancy: f32,
    /// Least share of the non-empty leaves below a node that list a referenced triangle, in [0, 1].
    pub tau_frequency: f32,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { max_refs: 2, tau_occupancy: 0.5, tau_frequency: 0.4 }
    }
}

/// A finished tree in its packed form.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// Root box: all triangles, enlarged by one voxel on each side.
    pub bounds: Aabb,
    /// Greatest depth of a leaf; the root has depth 0.
    pub depth: u32,
    /// 8-byte slots, depth first.
    pub slots: Vec<[u32; 2]>,
    /// Triangle ids of leaves with two or more.
    pub list: Vec<u32>,
}

/// Builds the tree over `triangle_count` triangles whose decoded vertices `vertices` returns. The result does not depend on the
/// number of threads of the current rayon pool.
pub fn build(
    triangle_count: u32,
    vertices: impl Fn(u32) -> [Vec3; 3] + Sync,
    options: &BuildOptions,
) -> Tree {
    let _ = (triangle_count, vertices, options);
    Tree { bounds: Aabb::EMPTY, depth: 0, slots: vec![[0, 3]], list: Vec::new() }
}

/// Counts of a finished tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TreeStats {
    /// Inner nodes without a reference.
    pub inner0: u64,
    /// Inner nodes with one reference.
    pub inner1: u64,
    /// Inner nodes with two references.
    pub inner2: u64,
    /// Leaves, empty ones among them.
    pub leaves: u64,
    /// Leaves that hold nothing.
    pub empty_leaves: u64,
    /// Triangle references of all leaves (inlined ones too).
    pub leaf_refs: u64,
    /// Greatest depth.
    pub depth: u32,
    /// Bytes of slots and list.
    pub bytes: u64,
}

impl Tree {
    /// Counts nodes and bytes.
    pub fn stats(&self) -> TreeStats {
        TreeStats::default()
    }
}
