//! Packing nodes, and undoing splits that turned out not to pay.

use super::plane::{Costs, Plane};
use super::{Part, Place};
use crate::node::{MAX_SLOTS, Node, Slot, reference_slot};

/// A packed (sub)tree under construction, depth first; indices count from its own start.
#[derive(Default)]
pub(super) struct Output {
    pub slots: Vec<Slot>,
    pub list: Vec<u32>,
    /// A buffer.
    union: Vec<u32>,
}

/// The tree does not fit 28-bit slot indices.
#[derive(Debug)]
pub(super) struct TooManySlots;

impl Output {
    /// Appends a leaf of `ids`, ascending.
    pub fn leaf(&mut self, ids: &[u32]) {
        let payload = match *ids {
            [] => 0,
            [id] => id,
            _ => {
                let first = self.list.len() as u32;
                self.list.extend_from_slice(ids);
                first
            }
        };
        self.slots.push(Node::leaf(ids.len() as u32, payload).0);
    }

    /// Appends an inner node with its references, ascending, and returns its slot. The left child follows, then
    /// [`Output::begin_right`], the right child and [`Output::close_inner`].
    pub fn open_inner(&mut self, plane: &Plane, refs: &[u32]) -> usize {
        let slot = self.slots.len();
        self.slots.push(Node::inner(plane.axis, plane.position, refs.len() as u32, 0).0);
        if !refs.is_empty() {
            self.slots.push(reference_slot(refs));
        }
        slot
    }

    /// Enters the next slot as the right child of the inner node at `slot`.
    pub fn begin_right(&mut self, slot: usize) {
        let node = Node(self.slots[slot]);
        let right = self.slots.len() as u32;
        self.slots[slot] = Node::inner(node.axis(), node.split(), node.refs(), right).0;
    }

    /// Finishes the inner node at `slot`, which covers `place`; makes it a leaf when both children are leaves and one leaf of
    /// all their triangles costs no more than what the split must save:
    /// `K_I |union| <= K_T + K_I (|refs| + SA_L / SA |left| + SA_R / SA |right|) + least gain`.
    ///
    /// The split was chosen before its triangles were cut (some lie in one half only), with a bonus for empty halves, or before
    /// further splits below were undone; so even without a least gain this saves bytes and cost.
    pub fn close_inner(&mut self, slot: usize, place: &Place, costs: &Costs) {
        let node = Node(self.slots[slot]);
        let (left, right) = (slot + node.size() as usize, node.right() as usize);
        let [left, right] = [left, right].map(|child| Node(self.slots[child]));
        if !(left.is_leaf() && right.is_leaf()) {
            return;
        }
        let plane = Plane { axis: node.axis(), position: node.split(), flat_go_low: true };
        let cell = &place.cell;
        let [low, high] = cell.split(&plane).map(|half| half.area() / cell.area());
        let tests = f64::from(node.refs()) + low * f64::from(left.count()) + high * f64::from(right.count());

        let worth = costs.traversal + costs.intersection * tests + place.least_gain();
        // References are in neither child, so the union is at least this large.
        let least = node.refs() + left.count().max(right.count());
        if costs.intersection * f64::from(least) > worth {
            return;
        }
        let mut union = std::mem::take(&mut self.union);
        union.clear();
        union.extend_from_slice(self.leaf_ids(&left));
        union.extend_from_slice(self.leaf_ids(&right));
        if node.refs() > 0 {
            union.extend_from_slice(&self.slots[slot + 1][..node.refs() as usize]);
        }
        union.sort_unstable();
        union.dedup();
        if costs.intersection * union.len() as f64 <= worth {
            let listed =
                [left, right].iter().filter(|n| n.count() >= 2).map(|n| n.count() as usize).sum::<usize>();
            self.list.truncate(self.list.len() - listed);
            self.slots.truncate(slot);
            self.leaf(&union);
        }
        self.union = union;
    }

    fn leaf_ids<'a>(&'a self, leaf: &'a Node) -> &'a [u32] {
        match leaf.count() {
            0 => &[],
            1 => &leaf.0[..1],
            count => &self.list[leaf.payload() as usize..][..count as usize],
        }
    }

    pub fn shrink(&mut self) {
        self.union = Vec::new();
        self.slots.shrink_to_fit();
        self.list.shrink_to_fit();
    }

    /// Appends a finished subtree.
    fn append(&mut self, piece: Self) -> Result<(), TooManySlots> {
        if self.slots.len() + piece.slots.len() > MAX_SLOTS
            || self.list.len() + piece.list.len() > u32::MAX as usize
        {
            return Err(TooManySlots);
        }
        let (slots, entries) = (self.slots.len() as u32, self.list.len() as u32);
        let mut rest = piece.slots.as_slice();
        while let Some(&first) = rest.first() {
            let node = Node(first);
            self.slots.push(node.moved(slots, entries).0);
            let size = if node.is_leaf() { 1 } else { node.size() as usize };
            self.slots.extend_from_slice(&rest[1..size]);
            rest = &rest[size..];
        }
        self.list.extend_from_slice(&piece.list);
        Ok(())
    }
}

impl Part {
    /// Appends the tree under this part to `output`. Recursion is as deep as the tree, at most 48.
    pub fn pack_into(self, output: &mut Output, costs: &Costs) -> Result<(), TooManySlots> {
        match self {
            Self::Piece(piece) => output.append(piece),
            Self::Inner { place, plane, children } => {
                let [left, right] = *children;
                let node = output.open_inner(&plane, &[]);
                left.pack_into(output, costs)?;
                if output.slots.len() >= MAX_SLOTS {
                    return Err(TooManySlots);
                }
                output.begin_right(node);
                right.pack_into(output, costs)?;
                output.close_inner(node, &place, costs);
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::BuildOptions;
    use crate::build::clip::Cell;

    /// A node split in the middle with the given references and leaves.
    fn packed(refs: &[u32], left: &[u32], right: &[u32]) -> Output {
        packed_if_it_saves(0.0, refs, left, right)
    }

    /// The same where a split must lower the cost of the node by more than `gain`.
    fn packed_if_it_saves(gain: f64, refs: &[u32], left: &[u32], right: &[u32]) -> Output {
        let cell = Cell { min: [0.0; 3], max: [8.0; 3] };
        let place = Place { cell, depth: 0, least_saving: gain * cell.area() };
        let mut output = Output::default();
        let node = output.open_inner(&Plane { axis: 0, position: 4.0, flat_go_low: true }, refs);
        output.leaf(left);
        output.begin_right(node);
        output.leaf(right);
        output.close_inner(node, &place, &Costs::new(&BuildOptions::default()));
        output
    }

    #[test]
    fn a_split_that_does_not_pay_becomes_one_leaf_of_all_its_triangles() {
        // Each half has two thirds of the surface: 15 + 20 (2/3 * 2 + 2/3 * 2) = 68.3 against 20 for each of the union.
        let output = packed(&[], &[1, 2], &[2, 3]);
        assert_eq!((output.slots, output.list), (vec![Node::leaf(3, 0).0], vec![1, 2, 3]));
        let output = packed(&[9], &[1], &[]);
        assert_eq!((output.slots, output.list), (vec![Node::leaf(2, 0).0], vec![1, 9]));
    }

    #[test]
    fn a_split_that_pays_stays() {
        // 15 + 20 (2/3 * 3 + 2/3 * 3) = 95 against 120.
        let output = packed(&[], &[1, 2, 3], &[4, 5, 6]);
        let slots = vec![Node::inner(0, 4.0, 0, 2).0, Node::leaf(3, 0).0, Node::leaf(3, 3).0];
        assert_eq!((output.slots, output.list), (slots, vec![1, 2, 3, 4, 5, 6]));
    }

    #[test]
    fn a_split_stays_only_when_it_saves_enough() {
        // It saves 25, see above.
        let kept = packed(&[], &[1, 2, 3], &[4, 5, 6]);
        assert_eq!(packed_if_it_saves(24.9, &[], &[1, 2, 3], &[4, 5, 6]).slots, kept.slots);
        let output = packed_if_it_saves(25.1, &[], &[1, 2, 3], &[4, 5, 6]);
        assert_eq!((output.slots, output.list), (vec![Node::leaf(6, 0).0], vec![1, 2, 3, 4, 5, 6]));
    }

    #[test]
    fn appended_pieces_keep_their_structure() {
        let whole = packed(&[7], &[1, 2, 3], &[4, 5, 6]);
        let mut output = Output::default();
        output.leaf(&[10, 11]);
        output.append(packed(&[7], &[1, 2, 3], &[4, 5, 6])).unwrap();
        assert_eq!(whole.slots[0], Node::inner(0, 4.0, 1, 3).0);
        let moved = [Node::inner(0, 4.0, 1, 4).0, [7, u32::MAX], Node::leaf(3, 2).0, Node::leaf(3, 5).0];
        assert_eq!(output.slots[1..], moved);
        assert_eq!(output.list, [10, 11, 1, 2, 3, 4, 5, 6]);
    }
}
