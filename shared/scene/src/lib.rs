//! The full-precision scene document, its importers and its generators.
//!
//! A [`Scene`] keeps what a file says: a node tree over meshes, materials, textures, lights and cameras. Nothing here knows
//! how a scene is packed or rendered. Untrusted files are parsed here and nowhere else.

pub mod document;
pub mod error;
pub mod flatten;
pub mod generate;
pub mod import;
mod instances;
pub mod scene_file;
pub mod selection;
mod track;

pub use document::*;
pub use error::SceneError;
pub use flatten::{FlatMesh, FlatObject};
pub use scene_file::{LoadOptions, builtin, load};
pub use selection::{LeftOut, Selection, Without};
pub use track::CameraTrack;
