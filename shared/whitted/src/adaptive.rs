//! Adaptive sampling: blocks of pixels get samples until their error is small enough.
//!
//! **Blocks** are squares of [`BLOCK_SIDE`] pixels, aligned to the image and cut at its edges. What a pixel becomes depends on its block and
//! on nothing else: not on tiles, threads, kernels, machines. A tile that cuts blocks takes the whole of them, and keeps its part.
//!
//! **Rounds.** A block takes half of its least number of samples, then as many again, and from then on doubles them until it is good
//! enough, or has as many as the frame allows. Samples are added up in their order within a round, and then the rounds in theirs.
//!
//! **Estimate.** Let A be the mean of the samples so far and B that of as many new ones. What the pixel then is, (A + B) / 2, has the
//! estimated squared error `d^2`, `d = (A - B) / 2`. If V(n) is the variance of a mean of n samples, and A and B are alike, then
//! `E d^2 = (V(n) - cov) / 2` and `V(2n) = (V(n) + cov) / 2`, so that
//!
//! ```text
//! E d^2 = V(n) - V(2n)
//! ```
//!
//! whatever the samples have to do with each other. For independent ones that is V(2n) itself. Where the variance falls faster, as it
//! does for both samplers, `d^2` is larger than V(2n), never smaller: by 2^a - 1 where V falls with n^-a; on an edge (a = 3/2) the error is
//! taken for 1.35 times what it is. The usual estimate, the samples' own variance over n, knows nothing of stratification, and would be off by
//! a factor that grows with n.
//!
//! **Space.** A and B are coded as the picture shows them: colour, premultiplied by alpha, clamped to [0, 1] and put on the sRGB curve;
//! alpha clamped. `d` is that of the channel that differs most; the block's error is the root of the mean of `d^2` over its pixels, and is to
//! be at most [`crate::Adaptive::error`]: 1/255 is a step of an 8-bit picture. What is brighter than white is not told apart.
//!
//! **Flat by chance.** No decision rests on less than [`LEAST_DRAWS`] samples of a block: 16 a pixel of a whole one, more where the image's
//! edge cuts it. Of a feature that covers a share p of a block's area, independent samples all miss it with probability
//! `(1 - p)^4096`: below 1 % for p above 0.0011, 0.29 of a pixel (stratified ones miss less). One of contrast c that is missed leaves an
//! error of at most 16 c p = 0.018 c in the block. Over the pixels that differ `d^2` is averaged: with k of them its relative standard
//! deviation is about the root of 2 / k, a third for an edge across a block.
//!
//! Stopping where the estimate happens to be low takes less samples than it should now and then; a picture's error is a little above the
//! threshold in such blocks and well below in others. `tests/tracer/adaptive.rs` measures it.

use crate::color::srgb_from_linear;
use crate::pixel::{PixelBlock, write_codes};
use crate::{FrameParams, PixelFormat};
use std::ops::Range;

/// Columns and rows of a block.
pub const BLOCK_SIDE: u32 = 16;

/// Samples of a block that a decision rests on at least.
pub const LEAST_DRAWS: u32 = 4096;

/// Blocks of a tile that are under way at a time, so that what is kept of them takes at most 8 MiB whatever the tile.
const OPEN_MAX: usize = 1024;

/// A tile on its way: who renders asks what is to be sampled, puts in the sums, and ends the round, until nothing is to be sampled.
#[derive(Clone, Debug)]
pub struct AdaptiveTile {
    rect: PixelBlock,
    format: PixelFormat,
    error: f64,
    samples: u32,
    /// Blocks across, and the first one's column and row, in blocks of the image.
    columns: u32,
    first: [u32; 2],
    blocks: Vec<Block>,
}

/// Samples to be taken of each pixel of a rectangle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Round {
    /// Which pixels; it may reach beyond the tile.
    pub rect: PixelBlock,
    /// Which samples of each.
    pub samples: Range<u32>,
}

#[derive(Clone, Debug)]
struct Block {
    rect: PixelBlock,
    /// Samples of a pixel that are in `total`.
    taken: u32,
    is_done: bool,
    /// Sums of linear colour, premultiplied, and alpha, by pixel; empty before the first round and after the last.
    total: Vec<[f32; 4]>,
    round: Vec<[f32; 4]>,
}

impl AdaptiveTile {
    /// The tile `rect` of a frame; `None` if that is not sampled adaptively.
    pub fn new(params: &FrameParams, rect: PixelBlock) -> Option<Self> {
        let error = f64::from(params.adaptive()?.error);
        let PixelBlock { x, y, width, height } = rect;
        let first = [x / BLOCK_SIDE, y / BLOCK_SIDE];
        let end = [(x + width).div_ceil(BLOCK_SIDE), (y + height).div_ceil(BLOCK_SIDE)];
        let block = |column: u32, row: u32| {
            let (x, y) = (column * BLOCK_SIDE, row * BLOCK_SIDE);
            // (A rectangle beyond the image is nobody's; its blocks are whole.)
            let side =
                |at: u32, length: u32| if at < length { BLOCK_SIDE.min(length - at) } else { BLOCK_SIDE };
            let rect = PixelBlock { x, y, width: side(x, params.width), height: side(y, params.height) };
            Block { rect, taken: 0, is_done: false, total: Vec::new(), round: Vec::new() }
        };
        let rows = if width == 0 { first[1]..first[1] } else { first[1]..end[1] };
        Some(Self {
            rect,
            format: params.format,
            error,
            samples: params.samples,
            columns: end[0] - first[0],
            first,
            blocks: rows
                .flat_map(|row| (first[0]..end[0]).map(move |column| (column, row)))
                .map(|(column, row)| block(column, row))
                .collect(),
        })
    }

    /// What is to be sampled now; nothing when the tile is finished. Blocks beside each other that need the same are one rectangle.
    pub fn work(&mut self) -> Vec<Round> {
        let mut rounds: Vec<Round> = Vec::new();
        for block in self.blocks.iter_mut().filter(|block| !block.is_done).take(OPEN_MAX) {
            let pixels = block.rect.width as usize * block.rect.height as usize;
            block.total.resize(pixels, [0.0; 4]);
            block.round.resize(pixels, [0.0; 4]);
            let (rect, samples) = (block.rect, block.taken..block.round_end(self.samples));
            match rounds.last_mut() {
                Some(last)
                    if last.samples == samples
                        && last.rect.y == rect.y
                        && last.rect.x + last.rect.width == rect.x =>
                {
                    last.rect.width += rect.width;
                }
                _ => rounds.push(Round { rect, samples }),
            }
        }
        rounds
    }

    /// Takes the sum of a pixel's samples of this round: linear colour, premultiplied, and alpha. The pixel is one of [`AdaptiveTile::work`].
    pub fn put(&mut self, x: u32, y: u32, sum: [f32; 4]) {
        let [column, row] = [x / BLOCK_SIDE - self.first[0], y / BLOCK_SIDE - self.first[1]];
        let block = &mut self.blocks[(row * self.columns + column) as usize];
        let place = (y - block.rect.y) * block.rect.width + (x - block.rect.x);
        block.round[place as usize] = sum;
    }

    /// Ends a round, of which every sum was put in. Pixels of blocks that are finished are written to `out`, the tile's pixels in the
    /// frame's format; of [`PixelFormat::Layers`] their colour and alpha.
    pub fn end_round(&mut self, out: &mut [u8]) {
        let Self { rect, format, error, samples, .. } = *self;
        for block in self.blocks.iter_mut().filter(|block| !block.is_done && !block.round.is_empty()) {
            let end = block.round_end(samples);
            let is_doubled = end == 2 * block.taken;
            let is_good = is_doubled && block.squared_error() <= error * error;
            for (total, sum) in block.total.iter_mut().zip(&block.round) {
                *total = std::array::from_fn(|i| total[i] + sum[i]);
            }
            block.taken = end;
            if is_good || end == samples {
                block.write(rect, format, out);
                block.is_done = true;
                (block.total, block.round) = Default::default();
            }
        }
    }
}

impl Block {
    /// Samples that a decision rests on at least: a power of two.
    fn least(&self) -> u32 {
        LEAST_DRAWS.div_ceil((self.rect.width * self.rect.height).max(1)).next_power_of_two()
    }

    /// The sample behind the last one of this round.
    fn round_end(&self, samples: u32) -> u32 {
        let least = self.least();
        match self.taken {
            // Nothing could be decided before the last one.
            0 if samples <= least => samples,
            0 => least / 2,
            taken => (2 * taken).min(samples),
        }
    }

    /// The estimate for the mean of the samples taken and as many of this round.
    fn squared_error(&self) -> f64 {
        let share = 1.0 / self.taken as f32;
        let code = |linear: f32| srgb_from_linear(f64::from((linear * share).clamp(0.0, 1.0)));
        let mut sum = 0.0;
        for (&[ar, ag, ab, aa], &[br, bg, bb, ba]) in self.total.iter().zip(&self.round) {
            let alpha = f64::from((aa * share).clamp(0.0, 1.0)) - f64::from((ba * share).clamp(0.0, 1.0));
            let apart = [code(ar) - code(br), code(ag) - code(bg), code(ab) - code(bb), alpha];
            sum += apart.into_iter().map(|d| d * d * 0.25).fold(0.0, f64::max);
        }
        sum / self.total.len() as f64
    }

    /// Writes those pixels that lie in `tile`.
    fn write(&self, tile: PixelBlock, format: PixelFormat, out: &mut [u8]) {
        let share = 1.0 / self.taken as f32;
        let bytes = format.bytes_per_pixel();
        let rows = (self.rect.y..).zip(self.total.chunks_exact(self.rect.width as usize));
        for (y, row) in rows.filter(|(y, _)| (tile.y..tile.y + tile.height).contains(y)) {
            for (x, sum) in
                (self.rect.x..).zip(row).filter(|(x, _)| (tile.x..tile.x + tile.width).contains(x))
            {
                let [r, g, b, alpha] = sum.map(|v| v * share);
                let out = &mut out[tile.place(x, y) * bytes..][..bytes];
                write_codes([r, g, b].into(), alpha, format, out);
            }
        }
    }
}

impl FrameParams {
    /// Adaptive sampling, if there is anything to decide: one sample is all that there is.
    pub fn adaptive(&self) -> Option<crate::Adaptive> {
        self.sampling.adaptive.filter(|_| self.samples > 1)
    }
}
