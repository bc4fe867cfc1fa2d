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
    /// Least number of tests of a referenced triangle that a ray through the node expects to make without the reference, which
    /// makes it one: >= 0. Below 1 a reference saves bytes and costs tests.
    pub tau_tests: f32,
    /// Cost of a step down the tree, > 0; only its ratio to `intersection_cost` matters (Wald and Havran 2006: 15).
    pub traversal_cost: f32,
    /// Cost of a triangle test, > 0 (Wald and Havran 2006: 20).
    pub intersection_cost: f32,
    /// Factor on the cost of a plane that cuts off an empty cell, in (0, 1] (Wald and Havran 2006: 0.8).
    pub empty_factor: f32,
    /// What a split must save a ray, >= 0: steps down the tree for all triangles of the split's surroundings together. One that
    /// saves less is undone, because its nodes are not worth their bytes. 0 keeps every split that saves anything.
    ///
    /// The surroundings of a cell are the smallest cell around it with more than 128 triangles. A split of a cell with surface
    /// area `SA` that lowers the cost by `G` saves a ray through surroundings with `SA_0` and `n_0` triangles `G SA / SA_0`; it
    /// stays when that is more than `least_saving K_T / n_0`. Surroundings have about as many splits as triangles, so what is
    /// undone costs a ray through them about `least_saving` steps at most, and a small object in a large scene keeps as
    /// fine a tree as a large one.
    pub least_saving: f32,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            max_refs: 2,
            tau_occupancy: 0.5,
            tau_frequency: 0.4,
            tau_tests: 0.6,
            traversal_cost: 15.0,
            intersection_cost: 20.0,
            empty_factor: 0.8,
            least_saving: 1.0,
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
/// O(N log N) time; about 200 bytes a triangle at the peak, the result included (more where planes cut most triangles), and with
/// references about 20 MB for each thread. A triangle with a vertex that is not finite is listed nowhere: no ray hits it.
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
        .grow(set, Place { cell, depth: 0, least_saving: 0.0 })
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
    let &BuildOptions { max_refs, tau_occupancy, tau_frequency, tau_tests, .. } = options;
    if max_refs > MAX_NODE_REFS {
        return refuse("max_refs", max_refs as f32, "0, 1 or 2");
    }
    for (name, value) in [("tau_occupancy", tau_occupancy), ("tau_frequency", tau_frequency)] {
        if !(0.0..=1.0).contains(&value) {
            return refuse(name, value, "in [0, 1]");
        }
    }
    let &BuildOptions { traversal_cost, intersection_cost, empty_factor, least_saving, .. } = options;
    for (name, value) in [("traversal_cost", traversal_cost), ("intersection_cost", intersection_cost)] {
        if !(value > 0.0 && value.is_finite()) {
            return refuse(name, value, "finite and above 0");
        }
    }
    if !(empty_factor > 0.0 && empty_factor <= 1.0) {
        return refuse("empty_factor", empty_factor, "in (0, 1]");
    }
    for (name, value) in [("tau_tests", tau_tests), ("least_saving", least_saving)] {
        if !(value >= 0.0 && value.is_finite()) {
            return refuse(name, value, "finite and not below 0");
        }
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

/// See [`BuildOptions::least_saving`]: enough triangles that their splits can be weighed against each other, few enough that
/// they are near each other.
const SURROUNDINGS_TRIANGLES: usize = 128;

/// What every step of one build needs.
struct Builder<'a, V> {
    vertices: V,
    options: &'a BuildOptions,
    costs: Costs,
    max_depth: u32,
    /// See [`clip::margin`].
    margin: f64,
}

/// A cell on the way down the tree.
#[derive(Clone, Copy)]
struct Place {
    cell: Cell,
    depth: u32,
    /// What a split of this cell must save, as surface area times cost; see [`BuildOptions::least_saving`].
    least_saving: f64,
}

impl Place {
    /// The places on the low and the high side of `plane`.
    fn split(&self, plane: &Plane) -> [Self; 2] {
        self.cell.split(plane).map(|cell| Self { cell, depth: self.depth + 1, ..*self })
    }

    /// What a split of this cell must save in cost of the cell itself.
    fn least_gain(&self) -> f64 {
        self.least_saving / self.cell.area()
    }
}

/// An unfinished tree: inner nodes above packed pieces.
enum Part {
    Piece(Output),
    Inner { place: Place, plane: Plane, children: Box<[Part; 2]> },
}

impl<V: Fn(u32) -> [Vec3; 3] + Sync> Builder<'_, V> {
    /// Splits large cells down to pieces. One cell is swept by one thread, axis after axis; what runs in parallel are the subtrees
    /// behind a split, so that the first few levels of a large scene keep few threads busy.
    fn grow(&self, set: Set, place: Place) -> Part {
        let mut shop = Workshop::default();
        let place = self.enter(place, set.len());
        if set.len() > PIECE_TRIANGLES
            && let Some(plane) = self.best_plane(&set, &place)
        {
            let (mut left, mut right) = (Set::default(), Set::default());
            set.split_into(self, &place.cell, &plane, [&mut left, &mut right], &mut shop);
            drop((set, shop));
            let [low, high] = place.split(&plane);
            let (left, right) = rayon::join(|| self.grow(left, low), || self.grow(right, high));
            return Part::Inner { place, plane, children: Box::new([left, right]) };
        }
        let mut output = Output::default();
        if self.options.max_refs == 0 || set.len() > PIECE_TRIANGLES {
            self.build_plain(set, place, &mut output, &mut shop);
        } else {
            self.build_with_refs(set, place, MAX_PATH_REFS, &mut output, &mut shop);
        }
        output.shrink();
        Part::Piece(output)
    }

    /// Appends the subtree of `set` without references to `output`.
    fn build_plain(&self, set: Set, place: Place, output: &mut Output, shop: &mut Workshop) {
        let place = self.enter(place, set.len());
        match self.best_plane(&set, &place) {
            None => {
                output.leaf(set.ids());
                shop.give_back(set);
            }
            Some(plane) => {
                let [left, right] = self.split(&set, &place.cell, &plane, shop);
                shop.give_back(set);
                let [low, high] = place.split(&plane);
                let node = output.open_inner(&plane, &[]);
                self.build_plain(left, low, output, shop);
                output.begin_right(node);
                self.build_plain(right, high, output, shop);
                output.close_inner(node, &place, &self.costs);
            }
        }
    }

    /// `place`, found to hold `count` triangles: enough of them are the surroundings of the cells below.
    fn enter(&self, place: Place, count: usize) -> Place {
        if count <= SURROUNDINGS_TRIANGLES {
            return place;
        }
        let steps = f64::from(self.options.least_saving) / count as f64;
        Place { least_saving: steps * self.costs.traversal * place.cell.area(), ..place }
    }

    /// The cheapest plane, or `None` where a leaf is not dearer, no subtree could save enough or the depth is used up.
    fn best_plane(&self, set: &Set, place: &Place) -> Option<Plane> {
        // A subtree costs a step at least. Cells below are smaller and have no more triangles, so every split of them would be
        // undone too: this spares work, and a trial for references does not count leaves that would not stay.
        let leaf = self.costs.intersection * set.len() as f64;
        if place.depth >= self.max_depth || leaf <= self.costs.traversal + place.least_gain() {
            return None;
        }
        set.best_plane(&place.cell, &self.costs)
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
