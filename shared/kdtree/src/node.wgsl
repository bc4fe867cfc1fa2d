// Sibling of node.rs: the two words of a slot. `slot_at` is pack's.

fn node_is_leaf(node: vec2<u32>) -> bool { return (node.y & 3u) == 3u; }
fn node_axis(node: vec2<u32>) -> u32 { return node.y & 3u; }
fn node_split(node: vec2<u32>) -> f32 { return bitcast<f32>(node.x); }
fn node_refs(node: vec2<u32>) -> u32 { return (node.y >> 2u) & 3u; }
fn node_right(node: vec2<u32>) -> u32 { return node.y >> 4u; }
fn node_count(node: vec2<u32>) -> u32 { return node.y >> 2u; }

/// Greatest depth of a leaf.
const MAX_DEPTH: u32 = 64u;
