//! What a worker holds: versioned, checksummed sections with zero-copy views; its id is the hash of the content.

pub mod build;
pub mod input;
pub mod records;
pub mod view;

pub use build::{BuildError, PackOptions, PackStats, Plain, build_pack};
pub use input::{ImageInput, PackInput};
pub use records::{
    Ambient, Environment, EnvironmentKind, Light, LightKind, Material, MaterialFlags, NO_TEXTURE, Texture,
    Wrap,
};
pub use view::{Pack, PackError, PackId};
