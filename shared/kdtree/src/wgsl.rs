//! The traversal's text for GPUs.

use crate::node;
use crate::traverse;
use tessera_geometry::rounding::gamma;
use tessera_geometry::wgsl::LATERAL_ERROR;

/// Text that every device takes.
pub const COMMON: [&str; 2] = [include_str!("node.wgsl"), include_str!("traverse.wgsl")];

/// What a ray remembers of its way: a stack as deep as a tree may be.
pub const PRIVATE_STACK: &str = include_str!("stack_private.wgsl");

/// A few entries, and a trail of bits by which the rest is found again.
pub const SHORT_STACK: &str = include_str!("stack_short.wgsl");

/// Constants of the text, with or without `f64`, and the bits that they must have, by which a test holds it to this crate.
pub const fn constants(f64: bool) -> [(&'static str, u32); 5] {
    // Without `f64` a distance is off by more than its rounding: locate_f32.wgsl.
    let margin = if f64 { traverse::MARGIN } else { 1.0 / 65_536.0 };
    [
        ("MAX_DEPTH", node::MAX_DEPTH),
        ("THICKNESS", THICKNESS.to_bits()),
        ("SHORTEN", (1.0 - 2.0 * gamma(7)).to_bits()),
        ("LENGTHEN", (1.0 + 2.0 * gamma(7)).to_bits()),
        ("MARGIN", margin.to_bits()),
    ]
}

/// Of a device, whose inverse may be off by five roundoffs and not one: see traverse.wgsl.
const THICKNESS: f32 = LATERAL_ERROR + gamma(10);

const _: () = assert!(THICKNESS >= traverse::THICKNESS);
