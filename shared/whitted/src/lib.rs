//! Whitted shading over a pack: shadows, reflection, refraction, textures.
//!
//! [`Renderer`] takes a [`tessera_pack::Pack`] and turns [`FrameParams`] and a [`PixelBlock`] into pixels. Everything
//! about a pixel follows from these; threads, blocks and machines only decide who computes it.
//!
//! | file | holds |
//! |---|---|
//! | `frame.rs` | what a frame asks for |
//! | `pixel.rs` | blocks, averages, pixel formats |
//! | [`sample`] | where the samples of a pixel lie |
//! | [`adaptive`] | how many a pixel gets, where that is left open |
//! | `path.rs` | the tree of rays behind a sample |
//! | [`probe`] | every ray of such a tree, written down |
//! | [`replay`] | another renderer's rays, followed step by step |
//! | [`shade`] | the material model and a surface's own light |
//! | `light.rs` | lights and shadow rays |
//! | `surface.rs` | what a ray has hit |
//! | `environment.rs`, `texture.rs`, `color.rs` | misses, look-ups, sRGB |
//! | `scene.rs` | a pack made ready |
//! | [`device`], [`variant`] | the same for GPUs: what kernels are told, and which kernel a scene needs |
//! | [`stage`] | small scenes whose pictures are known, for tests and `tessera check` |
//! | [`twins`] | what the kernels' text must agree with |

pub mod adaptive;
mod color;
pub mod device;
mod environment;
pub mod frame;
mod light;
mod path;
pub mod pixel;
pub mod probe;
pub mod replay;
pub mod sample;
mod scene;
pub mod shade;
pub mod stage;
mod surface;
mod texture;
pub mod twins;
pub mod variant;

pub use adaptive::AdaptiveTile;
pub use frame::{Adaptive, Features, FrameParams, PixelFormat, RayCounts, Sampling};
pub use path::MAX_LAYERS;
pub use pixel::{NUMERIC_CLASS, PixelBlock};
pub use probe::Probe;
pub use sample::Sampler;
pub use scene::{Needs, Renderer};
