//! The builder: a surface-area-heuristic kd-tree with clipped boxes (Wald and Havran 2006), with up to two triangle
//! references on an inner node.
//!
//! Rooms: [`set`] holds the triangles of a cell with their clipped boxes and sorted events and splits them at a plane,
//! [`plane`] finds the cheapest plane, [`clip`] cuts a triangle to a cell, [`refs`] chooses references, [`emit`] packs nodes.

mod clip;
mod emit;
mod events;
mod plane;
mod refs;
mod set;

use crate::node::{MAX_NODE_REFS, MAX_PATH_REFS, MAX_SLOTS, Node, Slot};
use crate::traverse::TreeView;
use clip::Cell;
use emit::Output;
use plane::{Costs, Plane};
use set::{Set, Workshop};
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
    /// Cost of a step down the tree, > 0; only its ratio to `intersection_cost` matters (Wald and Havran 2006: 15).
    pub traversal_cost: f32,
    /// Cost of a triangle test, > 0 (Wald and Havran 2006: 20).
    pub intersection_cost: f32,
    /// Factor on the cost of a plane that cuts off an empty cell, in (0, 1] (Wald and Havran 2006: 0.8).
    pub empty_factor: f32,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            max_refs: 2,
            tau_occupancy: 0.5,
            tau_frequency: 0.4,
            traversal_cost: 15.0,
            intersection_cost: 20.0,
            empty_factor: 0.8,
        }
    }
}

/// Why there is no tree.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// An option is out of its range.
    #[error("kd-tree option {name} is {value}; it must be {range}")]
    Option {
        /// The field of [`BuildOptions`].
        name: &'static str,
        /// What it holds.
        value: f32,
        /// What it may hold.
        range: &'static str,
    },
    /// The mesh is too large for the 28-bit slots of the format.
    #[error(
        "the kd-tree of {triangles} triangles needs more than {MAX_SLOTS} slots; reduce or divide the mesh"
    )]
    TooLarge {
        /// Triangles of the mesh.
        triangles: u32,
    },
}

/// A finished tree in its packed form.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// Root box: all triangles, enlarged by one voxel on each side; [`Aabb::EMPTY`] without triangles.
    pub bounds: Aabb,
    /// Greatest depth of a leaf; the root has depth 0.
    pub depth: u32,
    /// 8-byte slots, depth first; see [`crate::node`].
    pub slots: Vec<Slot>,
    /// Triangle ids of leaves with two or more.
    pub list: Vec<u32>,
}

/// Builds the tree over `triangle_count` triangles whose decoded vertices `vertices` returns. The result does not depend on the
/// number of threads of the current rayon pool.
///
/// O(N log N) time; at most about 600 bytes a triangle at the peak, the result included. A triangle with a vertex that is not
/// finite is listed nowhere: no ray hits it.
pub fn build(
    triangle_count: u32,
    vertices: impl Fn(u32) -> [Vec3; 3] + Sync,
    options: &BuildOptions,
) -> Result<Tree, BuildError> {
    check(options)?;
    if triangle_count as usize > MAX_SLOTS {
        return Err(BuildError::TooLarge { triangles: triangle_count });
    }
    let set = Set::of_mesh(triangle_count, &vertices);
    if set.is_empty() {
        let slots = vec![Node::leaf(0, 0).0];
        return Ok(Tree { bounds: Aabb::EMPTY, depth: 0, slots, list: Vec::new() });
    }
    let cell = set.bounds().enlarged(1.0);
    let builder = Builder {
        vertices,
        options,
        costs: Costs::new(options),
        max_depth: depth_limit(set.len()),
        margin: clip::margin(&cell),
    };
    let mut output = Output::default();
    builder
        .grow(set, cell, 0)
        .pack_into(&mut output, &builder.costs)
        .map_err(|emit::TooManySlots| BuildError::TooLarge { triangles: triangle_count })?;
    let Output { slots, list, .. } = output;
    let bounds = Aabb { min: Vec3::from_array(cell.min), max: Vec3::from_array(cell.max) };
    let mut tree = Tree { bounds, depth: 0, slots, list };
    tree.depth = tree.stats().depth;
    Ok(tree)
}

fn check(options: &BuildOptions) -> Result<(), BuildError> {
    let refuse = |name, value, range| Err(BuildError::Option { name, value, range });
    let &BuildOptions { max_refs, tau_occupancy, tau_frequency, .. } = options;
    if max_refs > MAX_NODE_REFS {
        return refuse("max_refs", max_refs as f32, "0, 1 or 2");
    }
    for (name, value) in [("tau_occupancy", tau_occupancy), ("tau_frequency", tau_frequency)] {
        if !(0.0..=1.0).contains(&value) {
            return refuse(name, value, "in [0, 1]");
        }
    }
    let &BuildOptions { traversal_cost, intersection_cost, empty_factor, .. } = options;
    for (name, value) in [("traversal_cost", traversal_cost), ("intersection_cost", intersection_cost)] {
        if !(value > 0.0 && value.is_finite()) {
            return refuse(name, value, "finite and above 0");
        }
    }
    if !(empty_factor > 0.0 && empty_factor <= 1.0) {
        return refuse("empty_factor", empty_factor, "in (0, 1]");
    }
    Ok(())
}

/// `8 + 1.3 log2 N`, rounded (Pharr, Jakob, Humphreys, *Physically Based Rendering*, section 4.4.1), and never more than 48.
fn depth_limit(triangles: usize) -> u32 {
    const HARD_LIMIT: u32 = 48;
    let log2 = usize::BITS - triangles.saturating_sub(1).leading_zeros();
    (8 + (13 * log2).div_ceil(10)).min(HARD_LIMIT)
}

/// Cells with more triangles than this are split in parallel and never carry references; smaller ones are built by one
/// thread into one piece of packed tree. Near the root no triangle reaches a share of the leaves worth a reference, and
/// choosing references takes a trial build of the cell.
const PIECE_TRIANGLES: usize = 4096;

/// What every step of one build needs.
struct Builder<'a, V> {
    vertices: V,
    options: &'a BuildOptions,
    costs: Costs,
    max_depth: u32,
    /// See [`clip::margin`].
    margin: f64,
}

/// An unfinished tree: inner nodes above packed pieces.
enum Part {
    Piece(Output),
    Inner { cell: Cell, plane: Plane, children: Box<[Part; 2]> },
}

impl<V: Fn(u32) -> [Vec3; 3] + Sync> Builder<'_, V> {
    /// Splits large cells down to pieces. One cell is swept by one thread, axis after axis; what runs in parallel are the subtrees
    /// behind a split, so that the first few levels of a large scene keep few threads busy.
    fn grow(&self, set: Set, cell: Cell, depth: u32) -> Part {
        let mut shop = Workshop::default();
        if set.len() > PIECE_TRIANGLES
            && let Some(plane) = self.best_plane(&set, &cell, depth)
        {
            let [left_cell, right_cell] = cell.split(&plane);
            let (mut left, mut right) = (Set::default(), Set::default());
            set.split_into(self, &cell, &plane, [&mut left, &mut right], &mut shop);
            drop((set, shop));
            let (left, right) = rayon::join(
                || self.grow(left, left_cell, depth + 1),
                || self.grow(right, right_cell, depth + 1),
            );
            return Part::Inner { cell, plane, children: Box::new([left, right]) };
        }
        let mut output = Output::default();
        if self.options.max_refs == 0 || set.len() > PIECE_TRIANGLES {
            self.build_plain(set, &cell, depth, &mut output, &mut shop);
        } else {
            self.build_with_refs(set, &cell, depth, MAX_PATH_REFS, &mut output, &mut shop);
        }
        output.shrink();
        Part::Piece(output)
    }

    /// Appends the subtree of `set` without references to `output`.
    fn build_plain(&self, set: Set, cell: &Cell, depth: u32, output: &mut Output, shop: &mut Workshop) {
        match self.best_plane(&set, cell, depth) {
            None => {
                output.leaf(set.ids());
                shop.give_back(set);
            }
            Some(plane) => {
                let [left_cell, right_cell] = cell.split(&plane);
                let [left, right] = self.split(&set, cell, &plane, shop);
                shop.give_back(set);
                let node = output.open_inner(&plane, &[]);
                self.build_plain(left, &left_cell, depth + 1, output, shop);
                output.begin_right(node);
                self.build_plain(right, &right_cell, depth + 1, output, shop);
                output.close_inner(node, cell, &self.costs);
            }
        }
    }

    /// The cheapest plane, or `None` where a leaf is not dearer or the depth is used up.
    fn best_plane(&self, set: &Set, cell: &Cell, depth: u32) -> Option<Plane> {
        if depth >= self.max_depth { None } else { set.best_plane(cell, &self.costs) }
    }

    fn split(&self, set: &Set, cell: &Cell, plane: &Plane, shop: &mut Workshop) -> [Set; 2] {
        let [mut left, mut right] = [shop.take(), shop.take()];
        set.split_into(self, cell, plane, [&mut left, &mut right], shop);
        [left, right]
    }
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
    /// Counts nodes and bytes, in one pass over the slots.
    pub fn stats(&self) -> TreeStats {
        let bytes = size_of_val(self.slots.as_slice()) + size_of_val(self.list.as_slice());
        let mut stats = TreeStats { bytes: bytes as u64, ..TreeStats::default() };
        let (mut slot, mut depth) = (0, 0);
        // Depths of the right children that wait; depth first, the nearest is next.
        let mut waiting = Vec::new();
        while let Some(&first) = self.slots.get(slot) {
            let node = Node(first);
            if node.is_leaf() {
                stats.leaves += 1;
                stats.empty_leaves += u64::from(node.count() == 0);
                stats.leaf_refs += u64::from(node.count());
                stats.depth = stats.depth.max(depth);
                slot += 1;
                depth = waiting.pop().unwrap_or(0);
            } else {
                match node.refs() {
                    0 => stats.inner0 += 1,
                    1 => stats.inner1 += 1,
                    _ => stats.inner2 += 1,
                }
                depth += 1;
                waiting.push(depth);
                slot += node.size() as usize;
            }
        }
        stats
    }

    /// The tree as the traversal takes it.
    pub fn view(&self) -> TreeView<'_> {
        TreeView { bounds: self.bounds, slots: &self.slots, list: &self.list }
    }
}
