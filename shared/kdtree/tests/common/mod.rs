//! Scenes and rays that the tests share.

pub use tessera_kdtree::soup::*;
