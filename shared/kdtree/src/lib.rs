//! SAH kd-tree whose inner nodes carry up to two triangle references.
//!
//! Nodes are 8- and 16-byte slots; see [`node`] for the bits.

pub mod build;
mod kernel;
pub mod node;
mod packet;
pub mod soup;
pub mod traverse;
pub mod validate;
pub mod wgsl;

pub use build::{BuildError, BuildOptions, Tree, TreeStats, build};
pub use kernel::Kernel;
pub use packet::brute_force_closest_hits;
pub use traverse::{TreeView, Triangles, brute_force_closest};
pub use validate::{TreeError, validate};
