//! Tiles on all cores.

use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use tessera_geometry::{LocalCamera, Vec3};
use tessera_whitted::adaptive::{AdaptiveTile, BLOCK_SIDE, Round};
use tessera_whitted::{self as whitted, FrameParams, PixelBlock, RayCounts, Renderer};
use tessera_wire::{Adaptive, Frame, PixelFormat, Rays, Rect, Sampler};

/// What `Hello` calls this backend.
pub(crate) const NAME: &str = "cpu";

/// Tiles that the render thread is handed before it has finished any. All threads are at one tile, and the next is handed over in microseconds.
pub(crate) const TILES_AHEAD: usize = 1;

/// Pixels that one task renders: about a quarter of a millisecond of work in the cheapest scene, against a
/// microsecond to hand it out, and 64 tasks in a tile of 128 x 128, so that threads finish within 1/64 of
/// each other's work.
const BLOCK_PIXELS: u32 = 256;

/// Pixels that one task renders at least, however many samples they have: as many as the tracer takes together. A thread looks only
/// between blocks whether its work is still wanted. With 65,536 samples a pixel a block has half a million: where one takes a
/// microsecond it stops within a second, in the worst scenes (a millisecond) within nine minutes. `Frame::check` bounds the rays behind a
/// sample by `limits::RAYS`, so that any block ends.
const LEAST_BLOCK_PIXELS: u32 = 8;

/// Renders `rect` of `frame`, which is of the renderer's pack, with the threads of the current rayon pool: pixels in the frame's format, and
/// the rays traced. `None` when `stop` was set meanwhile.
pub(crate) fn render(
    renderer: &Renderer<'_>,
    frame: &Frame,
    rect: Rect,
    stop: &AtomicBool,
) -> Option<(Vec<u8>, Rays)> {
    let params = params(frame);
    let pixel_bytes = params.format.bytes_per_pixel();
    // `Frame::check` bounds a tile's bytes by `limits::TILE_BYTES`.
    let mut pixels = vec![0; rect.width as usize * rect.height as usize * pixel_bytes];
    let block_pixels = (BLOCK_PIXELS / frame.samples.max(1)).max(LEAST_BLOCK_PIXELS);
    let Rect { x, y, width, height } = rect;
    let counts = match AdaptiveTile::new(&params, PixelBlock { x, y, width, height }) {
        Some(tile) => render_adaptive(renderer, &params, tile, rect, &mut pixels, stop),
        None => in_parallel(split(rect, block_pixels, pixel_bytes, &mut pixels), stop, |(block, out)| {
            ((), renderer.render_block(&params, block, out))
        })
        .map(|(_, counts)| counts),
    };
    let RayCounts { primary, shadow, reflection, refraction } = counts?;
    Some((pixels, Rays { primary, shadow, reflection, refraction }))
}

/// Renders `tile`, which is `rect`, round by round: the twin of what [`Renderer::render_block`] does with one thread.
fn render_adaptive(
    renderer: &Renderer<'_>,
    params: &FrameParams,
    mut tile: AdaptiveTile,
    rect: Rect,
    pixels: &mut [u8],
    stop: &AtomicBool,
) -> Option<RayCounts> {
    let mut counts = RayCounts::default();
    loop {
        let work: Vec<_> = tile.work().iter().flat_map(pieces).collect();
        if work.is_empty() {
            break;
        }
        let (sums, rays) = in_parallel(work, stop, |(block, samples)| {
            let mut sums = Vec::with_capacity((block.width * block.height) as usize);
            let rays = renderer.sum_samples(params, block, samples, |x, y, sum| sums.push((x, y, sum)));
            (sums, rays)
        })?;
        counts += rays;
        for (x, y, sum) in sums.into_iter().flatten() {
            tile.put(x, y, sum);
        }
        tile.end_round(pixels);
    }
    if params.format == whitted::PixelFormat::Layers {
        let blocks = split(rect, BLOCK_PIXELS, params.format.bytes_per_pixel(), pixels);
        let (_, rays) =
            in_parallel(blocks, stop, |(block, out)| ((), renderer.write_surfaces(params, block, out)))?;
        counts += rays;
    }
    Some(counts)
}

/// Does `work` with the threads of the current rayon pool; what comes of it, in order, and all rays. `None` when `stop` was set meanwhile.
fn in_parallel<W: Send, R: Send>(
    work: Vec<W>,
    stop: &AtomicBool,
    task: impl Fn(W) -> (R, RayCounts) + Sync,
) -> Option<(Vec<R>, RayCounts)> {
    let done: Option<Vec<_>> =
        work.into_par_iter().map(|work| (!stop.load(Ordering::Relaxed)).then(|| task(work))).collect();
    let (results, rays): (Vec<R>, Vec<RayCounts>) = done?.into_iter().unzip();
    let mut counts = RayCounts::default();
    rays.into_iter().for_each(|rays| counts += rays);
    Some((results, counts))
}

/// Samples of a round that one task takes at most, in whole blocks: about as much work as [`BLOCK_PIXELS`] in the cheapest scene with as
/// many samples as the first rounds have.
const BLOCK_SAMPLES: usize = 16;

/// Cuts a round into tasks: by blocks while they have few samples, else by as many pixels as the tracer takes together.
fn pieces(round: &Round) -> impl Iterator<Item = (PixelBlock, Range<u32>)> + use<> {
    let Round { rect, samples } = round.clone();
    let (columns, rows) = if samples.len() <= BLOCK_SAMPLES { (BLOCK_SIDE, BLOCK_SIDE) } else { (4, 2) };
    (0..rect.height).step_by(rows as usize).flat_map(move |y| {
        let samples = samples.clone();
        (0..rect.width).step_by(columns as usize).map(move |x| {
            let (width, height) = (columns.min(rect.width - x), rows.min(rect.height - y));
            (PixelBlock { x: rect.x + x, y: rect.y + y, width, height }, samples.clone())
        })
    })
}

/// Cuts `rect` into blocks of at most `block_pixels` that lie together in `pixels`: whole rows where they are short, pieces of
/// rows where they are long.
fn split(
    rect: Rect,
    block_pixels: u32,
    pixel_bytes: usize,
    mut pixels: &mut [u8],
) -> Vec<(PixelBlock, &mut [u8])> {
    let columns = rect.width.min(block_pixels);
    let rows = if columns < rect.width { 1 } else { (block_pixels / columns).max(1) };
    let mut blocks = Vec::new();
    for y in (0..rect.height).step_by(rows as usize) {
        for x in (0..rect.width).step_by(columns as usize) {
            let block = PixelBlock {
                x: rect.x + x,
                y: rect.y + y,
                width: columns.min(rect.width - x),
                height: rows.min(rect.height - y),
            };
            let bytes = block.width as usize * block.height as usize * pixel_bytes;
            let (head, tail) = pixels.split_at_mut(bytes);
            blocks.push((block, head));
            pixels = tail;
        }
    }
    blocks
}

/// What the tracer is to do.
pub(crate) fn params(frame: &Frame) -> FrameParams {
    let camera = frame.camera;
    FrameParams {
        camera: LocalCamera {
            origin: Vec3::from_array(camera.origin),
            forward: Vec3::from_array(camera.forward),
            right: Vec3::from_array(camera.right),
            up: Vec3::from_array(camera.up),
        },
        width: frame.width,
        height: frame.height,
        samples: frame.samples,
        sampling: whitted::Sampling {
            sampler: match frame.sampling.sampler {
                Sampler::Jittered => whitted::Sampler::Jittered,
                Sampler::LowDiscrepancy => whitted::Sampler::LowDiscrepancy,
            },
            cutoff: frame.sampling.cutoff,
            adaptive: frame.sampling.adaptive.map(|Adaptive { error }| whitted::Adaptive { error }),
        },
        max_depth: frame.depth,
        frame: frame.seed,
        features: whitted::Features {
            shadows: frame.features.shadows,
            reflection: frame.features.reflection,
            refraction: frame.features.refraction,
        },
        format: match frame.format {
            PixelFormat::Rgba8 => whitted::PixelFormat::Rgba8,
            PixelFormat::Rgba16 => whitted::PixelFormat::Rgba16,
            PixelFormat::Layers => whitted::PixelFormat::Layers,
        },
    }
}

// The wire's bounds are the tracer's.
const _: () = {
    assert!(tessera_wire::limits::DEPTH == FrameParams::MAX_DEPTH);
    assert!(tessera_wire::limits::LAYERS == whitted::MAX_LAYERS);
    assert!(Adaptive::BLOCK == BLOCK_SIDE);
    assert!(tessera_wire::Sampling::CUTOFF == whitted::Sampling::CUTOFF);
    assert!(PixelFormat::Rgba8.bytes_per_pixel() == whitted::PixelFormat::Rgba8.bytes_per_pixel());
    assert!(PixelFormat::Rgba16.bytes_per_pixel() == whitted::PixelFormat::Rgba16.bytes_per_pixel());
    assert!(PixelFormat::Layers.bytes_per_pixel() == whitted::PixelFormat::Layers.bytes_per_pixel());
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_a_tile_in_the_order_of_its_bytes() {
        let sizes = [(1, 1), (128, 128), (100, 7), (1000, 3), (256, 2), (257, 2), (1, 1000)];
        for ((width, height), most) in sizes.into_iter().flat_map(|size| [(size, BLOCK_PIXELS), (size, 8)]) {
            let rect = Rect { x: 5, y: 9, width, height };
            let mut pixels = vec![0u8; (width * height) as usize];
            let mut next = 0;
            for (block, bytes) in split(rect, most, 1, &mut pixels) {
                assert!(block.width * block.height <= most);
                // Whole rows, or a piece of one row: contiguous in a row-major tile.
                assert!(block.width == width || block.height == 1);
                let first = (block.y - rect.y) * width + (block.x - rect.x);
                assert_eq!((first, bytes.len() as u32), (next, block.width * block.height));
                next += block.width * block.height;
            }
            assert_eq!(next, width * height);
        }
    }

    #[test]
    fn a_round_is_cut_into_tasks_that_cover_it_once() {
        for (width, height, samples) in [(48, 16, 0..8), (37, 11, 8..16), (37, 11, 16..64), (16, 16, 64..100)]
        {
            let round = Round { rect: PixelBlock { x: 32, y: 16, width, height }, samples };
            let mut seen = std::collections::BTreeSet::new();
            for (block, samples) in pieces(&round) {
                assert_eq!(samples, round.samples);
                for (x, y) in
                    (0..block.height).flat_map(|y| (0..block.width).map(move |x| (block.x + x, block.y + y)))
                {
                    assert!(seen.insert((x, y)), "{x}, {y} twice");
                }
            }
            assert_eq!(seen.len() as u32, width * height);
            assert!(seen.iter().all(|&(x, y)| x - 32 < width && y - 16 < height));
        }
    }
}
