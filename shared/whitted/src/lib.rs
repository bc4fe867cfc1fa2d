//! Whitted shading over a pack: shadows, reflection, refraction, textures.

pub mod frame;
pub mod pixel;
pub mod sample;
pub mod shade;
pub mod texture;

pub use frame::{Features, FrameParams, PixelFormat, RayCounts};
pub use pixel::{NUMERIC_CLASS, PixelBlock, render_block};
