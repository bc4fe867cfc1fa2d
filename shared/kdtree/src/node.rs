//! Slot layout of a packed tree.
//!
//! A tree is an array of 8-byte slots `[w0, w1]` (two little-endian `u32`) in depth-first order and a list of triangle ids.
//! The root is slot 0. Every inner node has two children, so there is one leaf more than inner nodes.
//!
//! ```text
//! inner node, no reference    1 slot    w0        split plane: bits of a finite f32, strictly inside the node's cell
//!                                       w1  0..2  axis: 0 x, 1 y, 2 z
//!                                           2..4  number of references: 0
//!                                           4..32 slot of the right child
//! inner node, one reference   2 slots   as above with number 1; second slot: w0 = triangle id, w1 = 0xFFFF_FFFF
//! inner node, two references  2 slots   as above with number 2; second slot: w0 < w1, two triangle ids
//! leaf                        1 slot    w1  0..2  3
//!                                           2..32 number of triangles
//!                                       w0        0 for none; the triangle's id for one;
//!                                                 the first of consecutive entries of the list for two or more
//! ```
//!
//! The left child lies right behind its parent (slot + 1, or + 2 after a slot of references), the right child right behind
//! the left child's subtree. The left cell is `coordinate <= plane`, the right cell `coordinate >= plane`. Leaves take
//! their stretches of the list in depth-first order, without gaps, each with ascending ids.
//!
//! # Example
//!
//! Five triangles: 4 spans the scene and is a reference of the root, split at x = 2.5; 0 lies on the left; 1, 2 and 3 lie on
//! the right.
//!
//! ```text
//! slot 0  [0x4020_0000, 0x0000_0034]   2.5; axis 0, 1 reference (1 << 2), right child 3 (3 << 4)
//! slot 1  [4,           0xFFFF_FFFF]   the reference
//! slot 2  [0,           0x0000_0007]   left: leaf (3) with 1 triangle (1 << 2), id 0
//! slot 3  [0,           0x0000_000F]   right: leaf (3) with 3 triangles (3 << 2), from list entry 0
//! list    [1, 2, 3]
//! ```
//!
//! The layout follows the slot counts of Seo, Park and Ihm 2022, table 5: 8 bytes for a node, 16 for an inner node with one or two
//! references, 4 for each entry of the list. The single triangle of a leaf stands in the leaf itself, which saves its 4
//! bytes. Three references are reserved.

/// Two little-endian words; the unit in which trees are stored, sent and uploaded.
pub type Slot = [u32; 2];

/// Greatest depth of a leaf in a valid tree (the root has depth 0), hence the size of a traversal stack.
pub const MAX_DEPTH: u32 = 64;

/// Most references on a path from the root to a leaf.
pub const MAX_PATH_REFS: u32 = 8;

/// Most references on one inner node.
pub const MAX_NODE_REFS: u32 = 2;

/// Slots that the 28 bits of a child's index can address: 2 GiB of them.
pub const MAX_SLOTS: usize = 1 << 28;

/// Triangles that the 30 bits of a leaf's count can state.
pub(crate) const MAX_LEAF_TRIANGLES: u32 = (1 << 30) - 1;

const KIND_MASK: u32 = 3;
const LEAF: u32 = 3;
const REFS_SHIFT: u32 = 2;
const RIGHT_SHIFT: u32 = 4;
const COUNT_SHIFT: u32 = 2;

/// The second word of a reference slot that holds one triangle.
const NO_SECOND: u32 = u32::MAX;

const _: () = assert!(size_of::<Slot>() == 8 && align_of::<Slot>() == 4);
const _: () = assert!(MAX_SLOTS as u64 == 1 << (32 - RIGHT_SHIFT));
const _: () = assert!(MAX_LEAF_TRIANGLES as u64 + 1 == 1 << (32 - COUNT_SHIFT));

/// The first slot of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Node(pub Slot);

impl Node {
    /// An inner node; `right` < [`MAX_SLOTS`], `axis` < 3, `refs` <= [`MAX_NODE_REFS`].
    pub fn inner(axis: usize, split: f32, refs: u32, right: u32) -> Self {
        debug_assert!(axis < 3 && refs <= MAX_NODE_REFS && (right as usize) < MAX_SLOTS);
        Self([split.to_bits(), axis as u32 | refs << REFS_SHIFT | right << RIGHT_SHIFT])
    }

    /// A leaf of `count` triangles; `payload` is 0, the only triangle's id or the first list entry.
    pub fn leaf(count: u32, payload: u32) -> Self {
        debug_assert!(count <= MAX_LEAF_TRIANGLES);
        Self([payload, LEAF | count << COUNT_SHIFT])
    }

    /// Whether this is a leaf.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.0[1] & KIND_MASK == LEAF
    }

    /// Inner node: the axis that the plane is perpendicular to, 0..3.
    #[inline]
    pub fn axis(self) -> usize {
        (self.0[1] & KIND_MASK) as usize
    }

    /// Inner node: where the plane cuts the axis.
    #[inline]
    pub fn split(self) -> f32 {
        f32::from_bits(self.0[0])
    }

    /// Inner node: how many references follow in the next slot; 3 is invalid.
    #[inline]
    pub fn refs(self) -> u32 {
        (self.0[1] >> REFS_SHIFT) & 3
    }

    /// Inner node: slots from this one to the left child.
    #[inline]
    pub fn size(self) -> u32 {
        1 + u32::from(self.refs() != 0)
    }

    /// Inner node: slot of the right child.
    #[inline]
    pub fn right(self) -> u32 {
        self.0[1] >> RIGHT_SHIFT
    }

    /// Leaf: how many triangles it holds.
    #[inline]
    pub fn count(self) -> u32 {
        self.0[1] >> COUNT_SHIFT
    }

    /// Leaf: the only triangle's id (count 1) or the first list entry (count >= 2).
    #[inline]
    pub fn payload(self) -> u32 {
        self.0[0]
    }

    /// The same node `slots` further on: an inner node's right child, or a leaf's list entries by `entries`, move along.
    pub(crate) fn moved(self, slots: u32, entries: u32) -> Self {
        if !self.is_leaf() {
            Self::inner(self.axis(), self.split(), self.refs(), self.right() + slots)
        } else if self.count() >= 2 {
            Self::leaf(self.count(), self.payload() + entries)
        } else {
            self
        }
    }
}

/// The slot of `refs`, one or two ascending triangle ids.
pub(crate) fn reference_slot(refs: &[u32]) -> Slot {
    match *refs {
        [first] => [first, NO_SECOND],
        [first, second] if first < second => [first, second],
        _ => unreachable!("a node has one or two ascending references"),
    }
}

/// Whether `slot` is well-formed for a node with `refs` references (1 or 2), and its ids are below `triangle_count`.
pub(crate) fn reference_slot_is_valid(slot: Slot, refs: u32, triangle_count: u32) -> bool {
    let [first, second] = slot;
    match refs {
        1 => first < triangle_count && second == NO_SECOND,
        _ => first < second && second < triangle_count,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worked_example_reads_as_documented() {
        let slots: [Slot; 4] =
            [[0x4020_0000, 0x0000_0034], [4, 0xFFFF_FFFF], [0, 0x0000_0007], [0, 0x0000_000F]];
        assert_eq!(Node::inner(0, 2.5, 1, 3), Node(slots[0]));
        assert_eq!(reference_slot(&[4]), slots[1]);
        assert_eq!(Node::leaf(1, 0), Node(slots[2]));
        assert_eq!(Node::leaf(3, 0), Node(slots[3]));

        let root = Node(slots[0]);
        assert_eq!(
            (root.is_leaf(), root.axis(), root.split(), root.refs(), root.size(), root.right()),
            (false, 0, 2.5, 1, 2, 3)
        );
        let right = Node(slots[3]);
        assert_eq!((right.is_leaf(), right.count(), right.payload()), (true, 3, 0));
    }

    #[test]
    fn the_widest_values_fit_their_fields() {
        let node = Node::inner(2, f32::MIN, 2, MAX_SLOTS as u32 - 1);
        assert_eq!(
            (node.axis(), node.split(), node.refs(), node.right()),
            (2, f32::MIN, 2, MAX_SLOTS as u32 - 1)
        );
        let leaf = Node::leaf(MAX_LEAF_TRIANGLES, u32::MAX);
        assert_eq!((leaf.is_leaf(), leaf.count(), leaf.payload()), (true, MAX_LEAF_TRIANGLES, u32::MAX));
    }

    #[test]
    fn a_moved_node_keeps_everything_but_its_targets() {
        assert_eq!(Node::inner(1, -3.0, 2, 7).moved(10, 99), Node::inner(1, -3.0, 2, 17));
        assert_eq!(Node::leaf(5, 3).moved(10, 99), Node::leaf(5, 102));
        assert_eq!(Node::leaf(1, 3).moved(10, 99), Node::leaf(1, 3));
        assert_eq!(Node::leaf(0, 0).moved(10, 99), Node::leaf(0, 0));
    }

    #[test]
    fn reference_slots_are_checked_against_their_number_and_the_mesh() {
        assert!(reference_slot_is_valid([4, u32::MAX], 1, 5));
        assert!(!reference_slot_is_valid([5, u32::MAX], 1, 5));
        assert!(!reference_slot_is_valid([4, 0], 1, 5));
        assert!(reference_slot_is_valid([3, 4], 2, 5));
        assert!(!reference_slot_is_valid([4, 4], 2, 5));
        assert!(!reference_slot_is_valid([4, 3], 2, 5));
        assert!(!reference_slot_is_valid([3, u32::MAX], 2, 5));
    }
}
