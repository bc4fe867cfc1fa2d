//! Triangle references on inner nodes.
//!
//! A triangle that many leaves below a node list is moved up to the node and vanishes from all of them, *before* the subtree is
//! split (Choi, Chang, Ihm 2013; Seo, Park, Ihm 2022, section 3.2). The papers name two thresholds without defining what they
//! measure in the copies we had, so the definitions are ours. For a node with cell `V` and the tree that the plain builder
//! makes of its triangles:
//!
//! - *frequency* of a triangle: the share of the non-empty leaves below the node that list it;
//! - *occupancy*: the largest extent of its part inside `V` as a share of `V`'s extent, over the three axes.
//!
//! A triangle may be referenced when both reach their threshold and at least two leaves list it. The ones in most leaves are
//! taken first, then the smaller id.

use super::Builder;
use super::clip::Cell;
use super::emit::Output;
use super::plane::Plane;
use super::set::{Set, Workshop};
use tessera_geometry::Vec3;

/// A node of the plain tree that the choice of references is made on. It keeps its triangles: where nothing is referenced
/// the plain tree *is* the result, and where something is, the rest is split anew.
pub(super) struct Trial {
    set: Set,
    /// The plane and the children's places among the trials; `None` for a leaf.
    split: Option<(Plane, [usize; 2])>,
    /// In how many leaves below each triangle of `set` is listed.
    listed: Vec<u32>,
    /// Leaves below that list anything.
    full_leaves: u32,
}

impl<V: Fn(u32) -> [Vec3; 3] + Sync> Builder<'_, V> {
    /// Appends the subtree of `set` to `output`, with at most `budget` references on any path.
    pub(super) fn build_with_refs(
        &self,
        set: Set,
        cell: &Cell,
        depth: u32,
        budget: u32,
        output: &mut Output,
        shop: &mut Workshop,
    ) {
        if budget == 0 {
            return self.build_plain(set, cell, depth, output, shop);
        }
        let before = shop.trials.len();
        let trial = self.try_plain(set, cell, depth, shop);
        self.refine(trial, cell, depth, budget, output, shop);
        // Sets below a reference have not been used up.
        while shop.trials.len() > before
            && let Some(trial) = shop.trials.pop()
        {
            shop.give_back(trial.set);
            shop.spare_counts.push(trial.listed);
        }
    }

    /// Appends the plain tree of `set` to the trials and returns its root's place.
    fn try_plain(&self, set: Set, cell: &Cell, depth: u32, shop: &mut Workshop) -> usize {
        let mut listed = shop.spare_counts.pop().unwrap_or_default();
        listed.clear();
        let trial = match self.best_plane(&set, cell, depth) {
            None => {
                listed.resize(set.len(), 1);
                let full_leaves = u32::from(!set.is_empty());
                Trial { set, split: None, listed, full_leaves }
            }
            Some(plane) => {
                let [low, high] = self.split(&set, cell, &plane, shop);
                let [low_cell, high_cell] = cell.split(&plane);
                let children = [
                    self.try_plain(low, &low_cell, depth + 1, shop),
                    self.try_plain(high, &high_cell, depth + 1, shop),
                ];
                listed.resize(set.len(), 0);
                let mut full_leaves = 0;
                for child in children.map(|child| &shop.trials[child]) {
                    full_leaves += child.full_leaves;
                    // A child's ids are some of ours, in the same order.
                    let mut places = set.ids().iter().zip(&mut listed);
                    for (id, below) in child.set.ids().iter().zip(&child.listed) {
                        if let Some((_, count)) = places.find(|(ours, _)| *ours == id) {
                            *count += below;
                        }
                    }
                }
                Trial { set, split: Some((plane, children)), listed, full_leaves }
            }
        };
        shop.trials.push(trial);
        shop.trials.len() - 1
    }

    /// Appends the result of a trial: its own nodes where nothing is referenced, others below a reference.
    fn refine(
        &self,
        trial: usize,
        cell: &Cell,
        depth: u32,
        budget: u32,
        output: &mut Output,
        shop: &mut Workshop,
    ) {
        let Some((plane, [low, high])) = shop.trials[trial].split else {
            output.leaf(shop.trials[trial].set.ids());
            return;
        };
        let chosen = self.choose(&shop.trials[trial], cell, budget);
        if chosen.is_empty() {
            let [low_cell, high_cell] = cell.split(&plane);
            let node = output.open_inner(&plane, &[]);
            self.refine(low, &low_cell, depth + 1, budget, output, shop);
            output.begin_right(node);
            self.refine(high, &high_cell, depth + 1, budget, output, shop);
            output.close_inner(node, cell, &self.costs);
            return;
        }

        // Split what is left; where that does not pay, the node is a leaf of everything.
        let mut rest = shop.take();
        let set = &shop.trials[trial].set;
        rest.copy_without(set, &chosen);
        match self.best_plane(&rest, cell, depth) {
            None => output.leaf(set.ids()),
            Some(plane) => {
                let refs: Vec<u32> = chosen.iter().map(|&place| set.ids()[place]).collect();
                let budget = budget - refs.len() as u32;
                let [low, high] = self.split(&rest, cell, &plane, shop);
                let [low_cell, high_cell] = cell.split(&plane);
                let node = output.open_inner(&plane, &refs);
                self.build_with_refs(low, &low_cell, depth + 1, budget, output, shop);
                output.begin_right(node);
                self.build_with_refs(high, &high_cell, depth + 1, budget, output, shop);
                output.close_inner(node, cell, &self.costs);
            }
        }
        shop.give_back(rest);
    }

    /// Places of the triangles to reference, ascending.
    fn choose(&self, trial: &Trial, cell: &Cell, budget: u32) -> Vec<usize> {
        let cell_extent = cell.extent();
        let least = (f64::from(self.options.tau_frequency) * f64::from(trial.full_leaves)).max(2.0);
        let occupies = |place: usize| {
            let extent = trial.set.boxes()[place].extent();
            (0..3).any(|k| extent[k] >= f64::from(self.options.tau_occupancy) * cell_extent[k])
        };
        let mut places: Vec<usize> = (0..trial.set.len())
            .filter(|&place| f64::from(trial.listed[place]) >= least && occupies(place))
            .collect();
        places.sort_by_key(|&place| (std::cmp::Reverse(trial.listed[place]), place));
        places.truncate(self.options.max_refs.min(budget) as usize);
        places.sort_unstable();
        places
    }
}
