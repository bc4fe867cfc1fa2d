//! What a frame asks for.

use crate::sample::Sampler;
use tessera_geometry::LocalCamera;

/// Everything but the scene that a pixel depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameParams {
    /// The view.
    pub camera: LocalCamera,
    /// Image size in pixels.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Samples a pixel, >= 1; one sample goes through the pixel's centre. With adaptive sampling the most that a pixel gets.
    pub samples: u32,
    /// How they are taken.
    pub sampling: Sampling,
    /// Reflections and refractions a path may take, 0..=[`FrameParams::MAX_DEPTH`].
    pub max_depth: u32,
    /// Seed of the sampler: the frame's number.
    pub frame: u64,
    /// What is switched on.
    pub features: Features,
    /// What a pixel holds.
    pub format: PixelFormat,
}

impl FrameParams {
    /// Greatest `max_depth`: the path stack's bound.
    pub const MAX_DEPTH: u32 = 32;
}

/// How the samples of a frame are taken: where they lie, how far their paths are followed, and how many a part of the image gets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Where the samples of a pixel lie.
    pub sampler: Sampler,
    /// Weight in a pixel below which a ray is not traced, [0, 1]; `path.rs` says what it bounds. With 0 only depth and layers end a path:
    /// up to 2^depth rays behind a sample that meets mirroring glass, more where it passes panes. What comes from others is to be bounded
    /// before: the wire's frames have a cut-off of at least 2^-16, or a depth of at most 3.
    pub cutoff: f32,
    /// Whether parts of the image that are good enough get fewer samples; `None`: all get the same.
    pub adaptive: Option<Adaptive>,
}

impl Sampling {
    /// Least weight that is traced unless a frame says otherwise: half a step of 8-bit linear light is 1/510.
    pub const CUTOFF: f32 = 1.0 / 512.0;
}

impl Default for Sampling {
    fn default() -> Self {
        Self { sampler: Sampler::default(), cutoff: Self::CUTOFF, adaptive: None }
    }
}

/// Adaptive sampling; `adaptive.rs` says how the error is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// A block of pixels gets samples until its estimated error is at most this: root mean square over its pixels, in sRGB-coded values
    /// of [0, 1]; (0, 1].
    pub error: f32,
}

/// Parts of the tracer that a frame may switch off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Features {
    /// Shadow rays.
    pub shadows: bool,
    /// Mirror reflection.
    pub reflection: bool,
    /// Refraction.
    pub refraction: bool,
}

impl Default for Features {
    fn default() -> Self {
        Self { shadows: true, reflection: true, refraction: true }
    }
}

/// A pixel's bytes on the wire, little endian, rows from the top, no padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// sRGB-coded red, green, blue and linear straight alpha, 8 bits each.
    Rgba8,
    /// The same in 16 bits each.
    Rgba16,
    /// Nine words: `f32` linear R, G, B (premultiplied), A, depth, normal x, y, z; `u32` triangle id.
    Layers,
}

impl PixelFormat {
    /// Bytes of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Rgba8 => 4,
            Self::Rgba16 => 8,
            Self::Layers => 36,
        }
    }
}

/// Rays traced, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// From the eye.
    pub primary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Off mirrors.
    pub reflection: u64,
    /// Through glass, and straight on through partly covered surfaces.
    pub refraction: u64,
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, o: Self) {
        self.primary += o.primary;
        self.shadow += o.shadow;
        self.reflection += o.reflection;
        self.refraction += o.refraction;
    }
}
