//! The service side: preparing a scene, dispatching tiles, assembling the image.

pub mod compare;
pub mod image;
pub mod output;

pub use image::{FrameBuffer, ImageHash, PixelFormat};
pub use output::{OutputError, OutputFile};
