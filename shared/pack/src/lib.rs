//! What a worker holds: versioned, checksummed sections with zero-copy views; its id is the hash of the content.
//!
//! [`build_pack`] turns plain arrays ([`PackInput`]) into a [`Pack`]; [`Pack::from_buffer`] checks bytes that came from
//! elsewhere so thoroughly that no content can make a reader fail. The file is described at [`mod@format`].

pub mod buffer;
pub mod build;
mod check;
pub mod color;
pub mod device;
pub mod error;
pub mod format;
pub mod input;
mod mesh;
mod need;
pub mod records;
mod rules;
mod sections;
mod validate;
pub mod view;

pub use buffer::PackBuffer;
pub use build::{PackOptions, PackStage, PackStats, Plain, Unneeded, build_pack, build_pack_with};
pub use error::{BuildError, PackError};
pub use input::{ImageInput, PackInput};
pub use need::Forced;
pub use records::{
    Ambient, Camera, Environment, EnvironmentKind, Light, LightKind, Material, MaterialFlags, NO_TEXTURE,
    SideUv, Texture, Wrap,
};
pub use rules::MAX_TEXTURE_SIDE;
pub use tessera_quantize::NormalCode;
pub use view::{MeshView, Pack, PackId, SharedBytes};
