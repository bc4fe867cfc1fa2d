//! Checks on a tree that came from outside.

use crate::node::{self, MAX_DEPTH, MAX_PATH_REFS, MAX_SLOTS, Node};
use crate::traverse::TreeView;
use tessera_geometry::Aabb;

/// What is wrong with a tree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("kd-tree slot {slot}: {what}")]
pub struct TreeError {
    /// Slot at which the fault was found.
    pub slot: u32,
    /// The fault.
    pub what: &'static str,
}

/// Checks that `tree` is safe to traverse over `triangle_count` triangles: O(slots + list), bounded memory, no recursion.
///
/// Accepted are exactly the trees of [`crate::node`]: legal fields; every slot reached exactly once, depth first; planes
/// strictly inside their cells; leaves that share out the list in order, with ascending ids below `triangle_count`; at
/// most [`MAX_PATH_REFS`] references on a path and a depth of at most [`MAX_DEPTH`]. Whether a leaf lists every
/// triangle that meets its cell is not checked: a tree that lies about that gives a wrong picture, not a crash.
pub fn validate(tree: &TreeView<'_>, triangle_count: u32) -> Result<(), TreeError> {
    let fault = |slot: usize, what| Err(TreeError { slot: u32::try_from(slot).unwrap_or(u32::MAX), what });
    if tree.slots.len() > MAX_SLOTS {
        return fault(MAX_SLOTS, "more slots than 28 bits can address");
    }
    let Aabb { min, max } = tree.bounds;
    let has_room = min.is_finite() && max.is_finite() && !tree.bounds.is_empty();
    if !has_room && tree.slots != [Node::leaf(0, 0).0] {
        return fault(0, "the root box is empty or not finite, but the tree is not a single empty leaf");
    }

    // The right children that wait, nearest last: as many as there are inner nodes above, so at most MAX_DEPTH.
    let mut waiting: Vec<Waiting> = Vec::with_capacity(MAX_DEPTH as usize);
    let mut here = Place { cell: tree.bounds, depth: 0, refs: 0 };
    let (mut slot, mut listed) = (0, 0);
    loop {
        let Some(&first) = tree.slots.get(slot) else {
            return fault(slot, "the tree ends before its last leaf");
        };
        let node = Node(first);
        if !node.is_leaf() {
            let (axis, split, right) = (node.axis(), node.split(), node.right() as usize);
            if here.depth == MAX_DEPTH {
                return fault(slot, "an inner node deeper than a traversal stack");
            }
            if !(here.cell.min[axis] < split && split < here.cell.max[axis]) {
                return fault(slot, "a split plane that is not inside its cell");
            }
            if node.refs() > node::MAX_NODE_REFS {
                return fault(slot, "a reserved number of references");
            }
            if node.refs() > 0 {
                let Some(&references) = tree.slots.get(slot + 1) else {
                    return fault(slot, "the tree ends before a node's references");
                };
                if !node::reference_slot_is_valid(references, node.refs(), triangle_count) {
                    return fault(slot + 1, "references out of order or beyond the last triangle");
                }
            }
            here.refs += node.refs();
            if here.refs > MAX_PATH_REFS {
                return fault(slot, "too many references on one path");
            }
            let left = slot + node.size() as usize;
            if right <= left || right >= tree.slots.len() {
                return fault(slot, "a right child that is not behind the left one inside the tree");
            }
            here.depth += 1;
            let mut beyond = here;
            beyond.cell.min[axis] = split;
            here.cell.max[axis] = split;
            waiting.push(Waiting { slot: right, place: beyond });
            slot = left;
            continue;
        }

        // A leaf: its triangles must exist, and its list entries follow those of the leaf before.
        match node.count() {
            0 if node.payload() != 0 => return fault(slot, "an empty leaf with a triangle"),
            1 if node.payload() >= triangle_count => return fault(slot, "a triangle beyond the last one"),
            0 | 1 => {}
            count => {
                if node.payload() as usize != listed {
                    return fault(slot, "a leaf that does not continue the list");
                }
                let Some(ids) = tree.list.get(listed..listed + count as usize) else {
                    return fault(slot, "a leaf that reaches beyond the list");
                };
                if !ids.is_sorted_by(|a, b| a < b) || ids.last().is_some_and(|&id| id >= triangle_count) {
                    return fault(slot, "a leaf whose ids are out of order or beyond the last triangle");
                }
                listed += ids.len();
            }
        }
        slot += 1;

        // Depth first, the subtree behind this leaf is the nearest right child that waits.
        let Some(next) = waiting.pop() else { break };
        if next.slot != slot {
            return fault(slot, "a subtree that does not end where its sibling begins");
        }
        here = next.place;
    }
    if slot != tree.slots.len() {
        return fault(slot, "slots behind the last leaf");
    }
    if listed != tree.list.len() {
        return fault(slot - 1, "list entries behind those of the last leaf");
    }
    Ok(())
}

/// Where in the tree a node stands.
#[derive(Clone, Copy)]
struct Place {
    cell: Aabb,
    depth: u32,
    /// References on the inner nodes above.
    refs: u32,
}

/// A right child that has not been reached yet.
struct Waiting {
    slot: usize,
    place: Place,
}
