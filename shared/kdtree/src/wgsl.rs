//! The traversal's text for GPUs.

/// Text that every device takes.
pub const COMMON: [&str; 2] = [include_str!("node.wgsl"), include_str!("traverse.wgsl")];

/// What a ray remembers of its way: a stack as deep as a tree may be.
pub const PRIVATE_STACK: &str = include_str!("stack_private.wgsl");

/// A few entries, and a trail of bits by which the rest is found again.
pub const SHORT_STACK: &str = include_str!("stack_short.wgsl");
