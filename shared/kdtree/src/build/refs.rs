//! Triangle references on inner nodes.
//!
//! A triangle that many leaves below a node list is moved up to the node and vanishes from all of them, *before* the subtree is
//! split (Choi, Chang, Ihm 2013; Seo, Park, Ihm 2022, section 3.2). The papers name two thresholds without defining what they
//! measure in the copies we had, so the definitions are ours. For a node with cell `V` and the tree that the plain builder
//! makes of its triangles:
//!
//! - *frequency* of a triangle: the share of the non-empty leaves below the node that list it;
//! - *occupancy*: the largest extent of its part inside `V` as a share of `V`'s extent, over the three axes;
//! - *tests*: the sum of `SA(leaf) / SA(V)` over the leaves below that list it, which is how often a ray through `V` expects to
//!   test it there. A reference makes that once. (Not in the papers: without it a reference may save bytes and cost rays dearly.)
//!
//! A triangle may be referenced when all three reach their threshold and at least two leaves list it. The ones in most leaves are
//! taken first, then the smaller id.

use super::clip::Cell;
use super::emit::Output;
use super::plane::Plane;
use super::set::{Set, Workshop};
use super::{BuildOptions, Builder, Place};
use std::ops::Range;
use tessera_geometry::Vec3;

/// Plain trees that the choice of references is made on, one behind the other in the same arrays. Their nodes keep their triangles:
/// where nothing is referenced the plain tree *is* the result, and where something is, the rest is split anew.
#[derive(Default)]
pub(super) struct Trials {
    nodes: Vec<Trial>,
    /// Triangles of the nodes, ascending within one.
    ids: Vec<u32>,
    /// Of the same triangles: the box of the part in the node's cell.
    boxes: Vec<Cell>,
    /// Of the same triangles: the leaves below the node that list it.
    listed: Vec<Listed>,
}

/// Leaves that list one triangle.
#[derive(Clone, Copy, Default)]
struct Listed {
    leaves: u32,
    /// Sum of their surface areas.
    area: f32,
}

/// A node of a trial tree.
struct Trial {
    /// Its triangles in the arrays.
    triangles: Range<usize>,
    /// The plane and the children's places among the trials; `None` for a leaf.
    split: Option<(Plane, [usize; 2])>,
    /// Leaves below that list anything.
    full_leaves: u32,
}

impl Trials {
    /// Appends the triangles of a node, each `listed` so far.
    fn push_triangles(&mut self, set: &Set, listed: Listed) -> Range<usize> {
        let first = self.ids.len();
        self.ids.extend_from_slice(set.ids());
        self.boxes.extend_from_slice(set.boxes());
        self.listed.resize(self.ids.len(), listed);
        first..self.ids.len()
    }

    fn push(&mut self, trial: Trial) -> usize {
        self.nodes.push(trial);
        self.nodes.len() - 1
    }

    /// Adds to each of `triangles` the leaves below `child` that list it.
    fn add_listed(&mut self, triangles: &Range<usize>, child: usize) {
        // A child's ids are some of ours, in the same order.
        let mut ours = triangles.clone();
        for below in self.nodes[child].triangles.clone() {
            if let Some(at) = ours.find(|&at| self.ids[at] == self.ids[below]) {
                self.listed[at].leaves += self.listed[below].leaves;
                self.listed[at].area += self.listed[below].area;
            }
        }
    }

    fn ids(&self, trial: usize) -> &[u32] {
        &self.ids[self.nodes[trial].triangles.clone()]
    }

    fn boxes(&self, trial: usize) -> &[Cell] {
        &self.boxes[self.nodes[trial].triangles.clone()]
    }

    /// Drops nodes and triangles behind the first `nodes` and `triangles`.
    fn truncate(&mut self, nodes: usize, triangles: usize) {
        self.nodes.truncate(nodes);
        self.ids.truncate(triangles);
        self.boxes.truncate(triangles);
        self.listed.truncate(triangles);
    }
}

impl<V: Fn(u32) -> [Vec3; 3] + Sync> Builder<'_, V> {
    /// Appends the subtree of `set` to `output`, with at most `budget` references on any path.
    pub(super) fn build_with_refs(
        &self,
        set: Set,
        place: Place,
        budget: u32,
        output: &mut Output,
        shop: &mut Workshop,
    ) {
        if budget == 0 {
            return self.build_plain(set, place, output, shop);
        }
        let (nodes, triangles) = (shop.trials.nodes.len(), shop.trials.ids.len());
        let trial = self.try_plain(set, place, shop);
        self.refine(trial, place, budget, output, shop);
        shop.trials.truncate(nodes, triangles);
    }

    /// Appends the plain tree of `set` to the trials and returns its root's place.
    fn try_plain(&self, set: Set, place: Place, shop: &mut Workshop) -> usize {
        let place = self.enter(place, set.len());
        let Some(plane) = self.best_plane(&set, &place) else {
            let triangles =
                shop.trials.push_triangles(&set, Listed { leaves: 1, area: place.cell.area() as f32 });
            let full_leaves = u32::from(!set.is_empty());
            shop.give_back(set);
            return shop.trials.push(Trial { triangles, split: None, full_leaves });
        };
        let triangles = shop.trials.push_triangles(&set, Listed::default());
        let [low, high] = self.split(&set, &place.cell, &plane, shop);
        shop.give_back(set);
        let [low_place, high_place] = place.split(&plane);
        let children = [self.try_plain(low, low_place, shop), self.try_plain(high, high_place, shop)];
        let mut full_leaves = 0;
        for child in children {
            full_leaves += shop.trials.nodes[child].full_leaves;
            shop.trials.add_listed(&triangles, child);
        }
        shop.trials.push(Trial { triangles, split: Some((plane, children)), full_leaves })
    }

    /// Appends the result of a trial: its own nodes where nothing is referenced, others below a reference.
    fn refine(&self, trial: usize, place: Place, budget: u32, output: &mut Output, shop: &mut Workshop) {
        let Some((plane, [low, high])) = shop.trials.nodes[trial].split else {
            output.leaf(shop.trials.ids(trial));
            return;
        };
        let place = self.enter(place, shop.trials.ids(trial).len());
        let chosen = self.choose(&shop.trials, trial, &place.cell, budget);
        if chosen.is_empty() {
            let [low_place, high_place] = place.split(&plane);
            let node = output.open_inner(&plane, &[]);
            self.refine(low, low_place, budget, output, shop);
            output.begin_right(node);
            self.refine(high, high_place, budget, output, shop);
            output.close_inner(node, &place, &self.costs);
            return;
        }

        // Split what is left; where that does not pay, the node is a leaf of everything.
        let mut rest = shop.take();
        let ids = shop.trials.ids(trial);
        rest.fill_without(ids, shop.trials.boxes(trial), &chosen);
        match self.best_plane(&rest, &place) {
            None => output.leaf(ids),
            Some(plane) => {
                let refs: Vec<u32> = chosen.iter().map(|&at| ids[at]).collect();
                let budget = budget - refs.len() as u32;
                let [low, high] = self.split(&rest, &place.cell, &plane, shop);
                let [low_place, high_place] = place.split(&plane);
                let node = output.open_inner(&plane, &refs);
                self.build_with_refs(low, low_place, budget, output, shop);
                output.begin_right(node);
                self.build_with_refs(high, high_place, budget, output, shop);
                output.close_inner(node, &place, &self.costs);
            }
        }
        shop.give_back(rest);
    }

    /// Places among a trial's triangles of those to reference, ascending.
    fn choose(&self, trials: &Trials, trial: usize, cell: &Cell, budget: u32) -> Vec<usize> {
        let Trial { triangles, full_leaves, .. } = &trials.nodes[trial];
        let (listed, boxes) = (&trials.listed[triangles.clone()], &trials.boxes[triangles.clone()]);
        let (cell_extent, area) = (cell.extent(), cell.area());
        let &BuildOptions { tau_occupancy, tau_frequency, tau_tests, .. } = self.options;
        let least_leaves = (f64::from(tau_frequency) * f64::from(*full_leaves)).max(2.0);
        let is_frequent = |at: usize| f64::from(listed[at].leaves) >= least_leaves;
        let is_tested = |at: usize| f64::from(listed[at].area) >= f64::from(tau_tests) * area;
        let occupies = |at: usize| {
            let extent = boxes[at].extent();
            (0..3).any(|k| extent[k] >= f64::from(tau_occupancy) * cell_extent[k])
        };
        let mut places: Vec<usize> =
            (0..listed.len()).filter(|&at| is_frequent(at) && is_tested(at) && occupies(at)).collect();
        places.sort_by_key(|&at| (std::cmp::Reverse(listed[at].leaves), at));
        places.truncate(self.options.max_refs.min(budget) as usize);
        places.sort_unstable();
        places
    }
}
