//! What a frame asks of a worker.

use crate::{FrameId, PackId, TileGrid, limits};
use bincode::{Decode, Encode};
use std::fmt;

/// Everything that a worker must know to render any tile of a frame. Master to every worker, once a frame.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct Frame {
    /// Number of the frame in this session.
    pub frame: FrameId,
    /// The pack that is rendered; the worker must hold it.
    pub pack: PackId,
    /// The view, in the pack's local units.
    pub camera: Camera,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Side of a square tile; edge tiles are cut.
    pub tile: u32,
    /// Samples a pixel; with adaptive sampling the most that one gets.
    pub samples: u32,
    /// How they are taken.
    pub sampling: Sampling,
    /// Reflections and refractions a path may take.
    pub depth: u32,
    /// Seed of the sampler.
    pub seed: u64,
    /// What is switched on.
    pub features: Features,
    /// What a pixel holds.
    pub format: PixelFormat,
    /// When rendered tiles are sent back.
    pub returns: ReturnMode,
    /// How their pixels travel.
    pub coding: Coding,
}

/// How pixels travel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Encode, Decode)]
pub enum Coding {
    /// As they are.
    #[default]
    Raw,
    /// Packed without loss; tiles that do not become smaller travel raw.
    Lossless,
    /// Colours are rounded so that none is off by more than one code of 8 bits (16 bits: 257), then as `Lossless`: nobody sees it, and less
    /// travels. It is the rounded picture's hash that counts. Layers are not rounded.
    Rounded,
}

impl Coding {
    /// Every coding.
    pub const ALL: [Self; 3] = [Self::Raw, Self::Lossless, Self::Rounded];

    /// The name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Lossless => "lossless",
            Self::Rounded => "rounded",
        }
    }
}

/// How the samples of a frame are taken.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct Sampling {
    /// Where the samples of a pixel lie.
    pub sampler: Sampler,
    /// Weight in a pixel below which a ray is not traced, [0, 1]; below [`Sampling::BOUNDING_CUTOFF`] only with a depth of at most
    /// [`Sampling::BOUNDING_DEPTH`].
    pub cutoff: f32,
    /// Whether blocks of pixels that are good enough get fewer samples.
    pub adaptive: Option<Adaptive>,
}

impl Default for Sampling {
    fn default() -> Self {
        Self { sampler: Sampler::default(), cutoff: Self::CUTOFF, adaptive: None }
    }
}

/// Where the samples of a pixel lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub enum Sampler {
    /// Correlated multi-jittered.
    #[default]
    Jittered,
    /// Sobol's (0,2)-sequence, scrambled as Owen does.
    LowDiscrepancy,
}

impl Sampler {
    /// Every sampler.
    pub const ALL: [Self; 2] = [Self::Jittered, Self::LowDiscrepancy];

    /// The name in reports and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Jittered => "jittered",
            Self::LowDiscrepancy => "low-discrepancy",
        }
    }
}

/// Adaptive sampling: blocks of [`Adaptive::BLOCK`] pixels square, aligned to the image, get samples until they are good enough.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct Adaptive {
    /// The estimated error that is good enough: root mean square over a block's pixels, in sRGB-coded values of [0, 1]; more than 0, at
    /// most 1.
    pub error: f32,
}

impl Adaptive {
    /// Columns and rows of a block; a tile's side is a multiple of it, so that no block is rendered twice.
    pub const BLOCK: u32 = 16;
}

impl Sampling {
    /// Least weight that is traced unless a frame says otherwise: below half a step of 8-bit linear light.
    pub const CUTOFF: f32 = 1.0 / 512.0;

    /// 2^-16: from here on weights bound the rays behind a sample, at any depth, by [`limits::RAYS`]. The rays that go on from one surface
    /// weigh no more than the one that met it, in each channel; so those of one generation weigh at most 1 in each of three, and at most `3 / w` of
    /// them weigh `w` in some channel. A path has at most `1 + depth + `[`limits::LAYERS`] generations: in all `3 (65 + depth) / w` rays.
    pub const BOUNDING_CUTOFF: f32 = 1.0 / 65_536.0;

    /// Up to here the depth bounds them by itself, whatever they weigh. Of `d` mirror and bent rays, one of two each, and `l` straight
    /// continuations there are `2^d C(d + l, l)` orders: `2^d C(d + 65, d + 1)` rays with up to 64 of these, for each `d` up to the depth. That is 6.7
    /// million for a depth of 3 and 187 million for 4: many panes behind each other make a large part of it come true.
    pub const BOUNDING_DEPTH: u32 = 3;

    /// Checks every number against its range, for a frame in tiles of side `tile` whose paths are `depth` deep.
    pub fn check(&self, tile: u32, depth: u32) -> Result<(), FrameError> {
        if !(0.0..=1.0).contains(&self.cutoff) {
            return Err(FrameError::Cutoff(self.cutoff));
        }
        if self.cutoff < Self::BOUNDING_CUTOFF && depth > Self::BOUNDING_DEPTH {
            return Err(FrameError::Unbounded { cutoff: self.cutoff, depth });
        }
        match self.adaptive {
            Some(Adaptive { error }) if !(error > 0.0 && error <= 1.0) => {
                Err(FrameError::AdaptiveError(error))
            }
            Some(_) if !tile.is_multiple_of(Adaptive::BLOCK) => Err(FrameError::TileBlocks(tile)),
            _ => Ok(()),
        }
    }
}

/// A pinhole camera in local units: the ray through (u, v) in [-1, 1]^2 is `origin + t normalize(forward + u
/// right + v up)`.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct Camera {
    /// Eye.
    pub origin: [f32; 3],
    /// Unit vector along the axis.
    pub forward: [f32; 3],
    /// Half the image plane's width at distance 1.
    pub right: [f32; 3],
    /// Half the image plane's height at distance 1.
    pub up: [f32; 3],
}

/// Parts of the tracer that are switched on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
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

/// A pixel's bytes, little endian, rows from the top, no padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub enum PixelFormat {
    /// sRGB-coded red, green, blue and linear straight alpha, 8 bits each.
    Rgba8,
    /// The same in 16 bits each.
    Rgba16,
    /// Nine words: `f32` linear R, G, B (premultiplied), A, depth, normal x, y, z; `u32` triangle id.
    Layers,
}

impl PixelFormat {
    /// Every format.
    pub const ALL: [Self; 3] = [Self::Rgba8, Self::Rgba16, Self::Layers];

    /// Bytes of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Rgba8 => 4,
            Self::Rgba16 => 8,
            Self::Layers => 36,
        }
    }

    /// The name in reports and in the image hash.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rgba8 => "rgba8",
            Self::Rgba16 => "rgba16",
            Self::Layers => "layers",
        }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// When a worker sends what it has rendered, and how often it says how far it is (`Rendered`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub enum ReturnMode {
    /// One batch when its list is empty, one `Rendered` just before it (Seo, Park, Ihm 2022, Figure 5).
    AtEnd,
    /// A batch as soon as it holds `min_bytes` of pixels or the list is empty, and a `Rendered` after each
    /// tile. 0 sends every tile by itself (ibid., Figure 4).
    Batches {
        /// Pixel bytes that make a batch worth sending.
        min_bytes: u32,
    },
    /// A `Rendered` and a batch after each so many tiles, and when the list is empty: few messages where each costs a link as much as many
    /// tiles, and still some before the end.
    Every {
        /// How many, >= 1; 0 counts as 1.
        tiles: u32,
    },
}

/// What is wrong with a frame.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Image size.
    #[error(
        "image of {width} x {height}: each side must be in 1..={side} and the area at most {pixels} pixels",
        side = limits::SIDE,
        pixels = limits::PIXELS
    )]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Tile side.
    #[error("tile side 0: it must be at least 1")]
    Tile,
    /// Too many tiles.
    #[error("{tiles} tiles: at most {limit} are allowed, choose larger tiles", limit = limits::TILES)]
    Tiles {
        /// Tiles that the grid would have.
        tiles: u64,
    },
    /// Too many bytes in a tile.
    #[error("a tile of {bytes} bytes: at most {limit} are allowed, choose smaller tiles", limit = limits::TILE_BYTES)]
    TileBytes {
        /// Bytes of the largest tile.
        bytes: u64,
    },
    /// Samples a pixel.
    #[error("{0} samples a pixel: must be in 1..={limit}", limit = limits::SAMPLES)]
    Samples(u32),
    /// Weight cut-off.
    #[error("cut-off {0}: a weight must be in 0..=1")]
    Cutoff(f32),
    /// Neither weight nor depth bounds the work.
    #[error(
        "cut-off {cutoff} with depth {depth}: a sample could take more than {rays} rays; choose a cut-off of at least 1/65536 = 0.0000153, \
         or a depth of at most {limit}",
        rays = limits::RAYS,
        limit = Sampling::BOUNDING_DEPTH
    )]
    Unbounded {
        /// Least weight that would be traced.
        cutoff: f32,
        /// Mirror and bent rays of a path.
        depth: u32,
    },
    /// Adaptive sampling's threshold.
    #[error("adaptive sampling to an error of {0}: it must be more than 0 and at most 1")]
    AdaptiveError(f32),
    /// Tiles that cut blocks of adaptive sampling.
    #[error("tile side {0}: with adaptive sampling it must be a multiple of {block}", block = Adaptive::BLOCK)]
    TileBlocks(u32),
    /// Depth.
    #[error("depth {0}: must be at most {limit}", limit = limits::DEPTH)]
    Depth(u32),
    /// Camera.
    #[error("camera: {0} is not finite, or zero")]
    Camera(&'static str),
}

impl Frame {
    /// Checks every number against its range; the master before it sends, the worker before it obeys.
    pub fn check(&self) -> Result<TileGrid, FrameError> {
        let grid = TileGrid::new(self.width, self.height, self.tile)?;
        let bytes = grid.largest_tile_pixels() * self.format.bytes_per_pixel() as u64;
        if bytes > limits::TILE_BYTES {
            return Err(FrameError::TileBytes { bytes });
        }
        if !(1..=limits::SAMPLES).contains(&self.samples) {
            return Err(FrameError::Samples(self.samples));
        }
        if self.depth > limits::DEPTH {
            return Err(FrameError::Depth(self.depth));
        }
        self.sampling.check(self.tile, self.depth)?;
        self.camera.check()?;
        Ok(grid)
    }
}

impl Camera {
    /// Every component finite; no axis zero, or of a length whose square leaves `f32`.
    pub fn check(&self) -> Result<(), FrameError> {
        if !self.origin.iter().all(|v| v.is_finite()) {
            return Err(FrameError::Camera("origin"));
        }
        for (name, axis) in [("forward", self.forward), ("right", self.right), ("up", self.up)] {
            let square: f32 = axis.iter().map(|v| v * v).sum();
            if !(square.is_finite() && square > 0.0) {
                return Err(FrameError::Camera(name));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        Frame {
            frame: FrameId(1),
            pack: PackId([0; 32]),
            camera: Camera {
                origin: [0.0; 3],
                forward: [0.0, 0.0, -1.0],
                right: [1.0, 0.0, 0.0],
                up: [0.0, 1.0, 0.0],
            },
            width: 1024,
            height: 1024,
            tile: 128,
            samples: 1,
            sampling: Sampling::default(),
            depth: 8,
            seed: 0,
            features: Features::default(),
            format: PixelFormat::Rgba8,
            returns: ReturnMode::AtEnd,
            coding: Coding::Raw,
        }
    }

    #[test]
    fn every_field_has_a_range() {
        let check = |change: &dyn Fn(&mut Frame)| {
            let mut f = frame();
            change(&mut f);
            f.check().map(|grid| grid.tiles())
        };
        assert_eq!(check(&|_| ()), Ok(64));
        assert_eq!(check(&|f| f.tile = u32::MAX), Ok(1));
        assert_eq!(check(&|f| (f.width, f.height) = (20_000, 1)), Ok(157));
        assert_eq!(check(&|f| f.width = 0), Err(FrameError::Size { width: 0, height: 1024 }));
        assert_eq!(
            check(&|f| (f.width, f.height) = (65_536, 65_536)),
            Err(FrameError::Size { width: 65_536, height: 65_536 })
        );
        assert_eq!(check(&|f| f.tile = 0), Err(FrameError::Tile));
        assert_eq!(check(&|f| f.tile = 1), Err(FrameError::Tiles { tiles: 1 << 20 }));
        assert_eq!(
            check(&|f| (f.width, f.height, f.tile) = (8192, 8192, 8192)),
            Err(FrameError::TileBytes { bytes: 1 << 28 })
        );
        assert_eq!(check(&|f| f.samples = 0), Err(FrameError::Samples(0)));
        let weighing = |cutoff, depth| move |f: &mut Frame| (f.sampling.cutoff, f.depth) = (cutoff, depth);
        for cutoff in [Sampling::BOUNDING_CUTOFF, 0.5, 1.0] {
            assert_eq!(check(&weighing(cutoff, limits::DEPTH)), Ok(64));
        }
        for cutoff in [0.0, f32::MIN_POSITIVE, Sampling::BOUNDING_CUTOFF.next_down()] {
            assert_eq!(check(&weighing(cutoff, Sampling::BOUNDING_DEPTH)), Ok(64));
            for depth in [Sampling::BOUNDING_DEPTH + 1, 8, limits::DEPTH] {
                assert_eq!(check(&weighing(cutoff, depth)), Err(FrameError::Unbounded { cutoff, depth }));
            }
        }
        assert_eq!(check(&weighing(0.0, 33)), Err(FrameError::Depth(33)));
        assert_eq!(check(&|f| f.sampling.cutoff = 1.5), Err(FrameError::Cutoff(1.5)));
        assert_eq!(check(&|f| f.sampling.cutoff = -0.001), Err(FrameError::Cutoff(-0.001)));
        assert!(matches!(check(&|f| f.sampling.cutoff = f32::NAN), Err(FrameError::Cutoff(_))));
        let adaptive = |error| move |f: &mut Frame| f.sampling.adaptive = Some(Adaptive { error });
        assert_eq!(check(&adaptive(1.0)), Ok(64));
        assert_eq!(check(&adaptive(f32::MIN_POSITIVE)), Ok(64));
        for error in [0.0, -1.0, 1.5, f32::INFINITY] {
            assert_eq!(check(&adaptive(error)), Err(FrameError::AdaptiveError(error)));
        }
        assert!(matches!(check(&adaptive(f32::NAN)), Err(FrameError::AdaptiveError(_))));
        for tile in [100, 24, 2008] {
            let cutting = |f: &mut Frame| {
                adaptive(0.1)(f);
                f.tile = tile;
            };
            assert_eq!(check(&cutting), Err(FrameError::TileBlocks(tile)));
        }
        assert_eq!(check(&|f| f.depth = 33), Err(FrameError::Depth(33)));
        assert_eq!(check(&|f| f.camera.origin[1] = f32::NAN), Err(FrameError::Camera("origin")));
        assert_eq!(check(&|f| f.camera.forward = [0.0; 3]), Err(FrameError::Camera("forward")));
        assert_eq!(check(&|f| f.camera.right[0] = f32::INFINITY), Err(FrameError::Camera("right")));
        assert_eq!(check(&|f| f.camera.up[2] = 1e30), Err(FrameError::Camera("up")));
    }

    #[test]
    fn what_passes_has_boundedly_many_rays_behind_a_sample() {
        let by_weight =
            |cutoff: f32, depth: u32| 3.0 * f64::from(1 + depth + limits::LAYERS) / f64::from(cutoff);
        let most = limits::RAYS as f64;
        assert!(by_weight(Sampling::BOUNDING_CUTOFF, limits::DEPTH) <= most);
        assert!(
            by_weight(Sampling::BOUNDING_CUTOFF / 2.0, limits::DEPTH) > most,
            "the bound is no wider than need be"
        );

        // Rays that have gone on straight `l` times and otherwise `d` times, counted generation by generation.
        let by_depth = |depth: usize| {
            let mut rays = vec![[0u64; limits::LAYERS as usize + 1]; depth + 1];
            rays[0][0] = 1;
            for d in 0..=depth {
                for l in 0..rays[0].len() {
                    let straight = if l > 0 { rays[d][l - 1] } else { 0 };
                    let deeper = if d > 0 { 2 * rays[d - 1][l] } else { 0 };
                    rays[d][l] += straight + deeper;
                }
            }
            rays.into_iter().flatten().sum::<u64>()
        };
        assert_eq!((by_depth(0), by_depth(1)), (65, 65 + 2 * 65 * 66 / 2));
        assert!(by_depth(Sampling::BOUNDING_DEPTH as usize) <= limits::RAYS);
        assert!(by_depth(Sampling::BOUNDING_DEPTH as usize + 1) > limits::RAYS);
    }
}
