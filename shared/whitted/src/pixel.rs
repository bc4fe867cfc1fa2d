//! Blocks of pixels.

use crate::color::{encode_linear, encode_srgb};
use crate::path::{PathStack, Seen, first_seen, trace};
use crate::sample::pixel_seed;
use crate::scene::Renderer;
use crate::surface::geometric_normal;
use crate::{AdaptiveTile, FrameParams, PixelFormat, RayCounts};
use std::ops::Range;
use tessera_geometry::wide::{LANES, lanes_in};
use tessera_geometry::{Hit, Ray, Vec2, Vec3};

/// Names the arithmetic: frames of one class are equal bit for bit. Raise the number with every change of a result.
pub const NUMERIC_CLASS: &str = "cpu-3";

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelBlock {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl PixelBlock {
    /// Bytes of the block in `format`.
    pub fn byte_len(&self, format: PixelFormat) -> usize {
        self.width as usize * self.height as usize * format.bytes_per_pixel()
    }

    /// Which of its pixels, row by row, lies at `(x, y)`.
    pub(crate) fn place(&self, x: u32, y: u32) -> usize {
        (y - self.y) as usize * self.width as usize + (x - self.x) as usize
    }
}

impl Renderer<'_> {
    /// Renders `block` into `out` (`width * height * bytes_per_pixel` bytes). A pixel depends on the pack, the parameters
    /// and its own coordinates alone, never on the block.
    ///
    /// # Panics
    /// When `out` is not [`PixelBlock::byte_len`] long.
    pub fn render_block(&self, params: &FrameParams, block: PixelBlock, out: &mut [u8]) -> RayCounts {
        assert_eq!(out.len(), block.byte_len(params.format), "the buffer does not fit {block:?}");
        if let Some(tile) = AdaptiveTile::new(params, block) {
            return self.render_adaptive(params, tile, block, out);
        }
        let mut counts = RayCounts::default();
        let mut stack = PathStack::new();
        let pixel_bytes = params.format.bytes_per_pixel();
        for packet in packets(block) {
            let seen = packet_of_pixels(self, params, &packet, &mut stack, &mut counts);
            for lane in lanes_in(packet.lanes) {
                let (x, y) = packet.pixel(lane);
                let bytes = &mut out[block.place(x, y) * pixel_bytes..][..pixel_bytes];
                let seen = &seen[lane];
                write_codes(seen.color, seen.alpha, params.format, bytes);
                if params.format == PixelFormat::Layers {
                    write_words(&mut bytes[SURFACE..], surface_layers(self, seen.first.as_ref()));
                }
            }
        }
        counts
    }

    /// `tile`, which lies at `block`, round by round.
    fn render_adaptive(
        &self,
        params: &FrameParams,
        mut tile: AdaptiveTile,
        block: PixelBlock,
        out: &mut [u8],
    ) -> RayCounts {
        let mut counts = RayCounts::default();
        loop {
            let work = tile.work();
            if work.is_empty() {
                break;
            }
            for round in work {
                let rays =
                    self.sum_samples(params, round.rect, round.samples, |x, y, sum| tile.put(x, y, sum));
                counts += rays;
            }
            tile.end_round(out);
        }
        if params.format == PixelFormat::Layers {
            counts += self.write_surfaces(params, block, out);
        }
        counts
    }

    /// Takes some samples of each pixel of `block` and hands over their sum, added up in their order: linear colour, premultiplied, and
    /// alpha.
    pub fn sum_samples(
        &self,
        params: &FrameParams,
        block: PixelBlock,
        samples: Range<u32>,
        mut put: impl FnMut(u32, u32, [f32; 4]),
    ) -> RayCounts {
        let mut counts = RayCounts::default();
        let mut stack = PathStack::new();
        for packet in packets(block) {
            let sums = sum_of_packet(self, params, &packet, samples.clone(), &mut stack, &mut counts);
            for lane in lanes_in(packet.lanes) {
                let (x, y) = packet.pixel(lane);
                let Seen { color, alpha, .. } = sums[lane];
                put(x, y, [color.x, color.y, color.z, alpha]);
            }
        }
        counts
    }

    /// Writes the last five words of [`PixelFormat::Layers`] of each pixel of `block` to `out`, where its pixels lie: what is behind their
    /// centres. The colour's words stay as they are.
    pub fn write_surfaces(&self, params: &FrameParams, block: PixelBlock, out: &mut [u8]) -> RayCounts {
        let mut counts = RayCounts::default();
        let pixels = (0..block.height).flat_map(|row| (0..block.width).map(move |column| (column, row)));
        for ((column, row), bytes) in pixels.zip(out.chunks_exact_mut(PixelFormat::Layers.bytes_per_pixel()))
        {
            let ray = ray_through(params, block.x + column, block.y + row, Vec2::splat(0.5));
            counts.primary += 1;
            write_words(&mut bytes[SURFACE..], surface_layers(self, first_seen(self, &ray).as_ref()));
        }
        counts
    }
}

/// The ray from the eye through a place in the pixel `(x, y)`.
pub(crate) fn ray_through(params: &FrameParams, x: u32, y: u32, offset: Vec2) -> Ray {
    params.camera.ray(x as f32 + offset.x, y as f32 + offset.y, params.width, params.height)
}

/// Pixels whose rays are traced together: two rows of four, or in a block of one row eight beside each other.
struct PixelPacket {
    x: u32,
    y: u32,
    columns: u32,
    /// Those that lie in the block.
    lanes: u8,
}

impl PixelPacket {
    fn pixel(&self, lane: usize) -> (u32, u32) {
        (self.x + lane as u32 % self.columns, self.y + lane as u32 / self.columns)
    }
}

/// Packets that cover `block`, every pixel once.
fn packets(block: PixelBlock) -> impl Iterator<Item = PixelPacket> {
    let columns = if block.height == 1 { LANES as u32 } else { LANES as u32 / 2 };
    let rows = (0..block.height).step_by(LANES / columns as usize);
    rows.flat_map(move |y| {
        (0..block.width).step_by(columns as usize).map(move |x| {
            let row = u8::MAX >> (LANES as u32 - columns.min(block.width - x));
            let has_second = columns < LANES as u32 && y + 1 < block.height;
            let lanes = if has_second { row | row << columns } else { row };
            PixelPacket { x: block.x + x, y: block.y + y, columns, lanes }
        })
    })
}

/// The mean of each pixel's samples, added up in their order. `first` is the surface behind a pixel's centre; it is
/// looked for only where the format shows it.
fn packet_of_pixels(
    scene: &Renderer<'_>,
    params: &FrameParams,
    packet: &PixelPacket,
    stack: &mut PathStack,
    counts: &mut RayCounts,
) -> [Seen; LANES] {
    // Send one sample through the centres.
    let centres = std::array::from_fn(|lane| {
        let (x, y) = packet.pixel(lane);
        ray_through(params, x, y, Vec2::splat(0.5))
    });
    if params.samples <= 1 {
        return trace(scene, params, &centres, packet.lanes, stack, counts);
    }

    // Or add up many.
    let mut sums = sum_of_packet(scene, params, packet, 0..params.samples, stack, counts);
    let share = 1.0 / params.samples as f32;
    for lane in lanes_in(packet.lanes) {
        let sum = &mut sums[lane];
        if params.format == PixelFormat::Layers {
            counts.primary += 1;
            sum.first = first_seen(scene, &centres[lane]);
        }
        sum.color *= share;
        sum.alpha *= share;
    }
    sums
}

/// What some samples of each pixel see together, added up in their order.
fn sum_of_packet(
    scene: &Renderer<'_>,
    params: &FrameParams,
    packet: &PixelPacket,
    samples: Range<u32>,
    stack: &mut PathStack,
    counts: &mut RayCounts,
) -> [Seen; LANES] {
    let seeds: [u32; LANES] = std::array::from_fn(|lane| {
        let (x, y) = packet.pixel(lane);
        pixel_seed(params.frame, x, y)
    });
    let mut sums = [Seen { color: Vec3::ZERO, alpha: 0.0, first: None }; LANES];
    for index in samples {
        let rays = std::array::from_fn(|lane| {
            let (x, y) = packet.pixel(lane);
            ray_through(
                params,
                x,
                y,
                params.sampling.sampler.offset_in_pixel(index, params.samples, seeds[lane]),
            )
        });
        let seen = trace(scene, params, &rays, packet.lanes, stack, counts);
        for (sum, seen) in sums.iter_mut().zip(seen) {
            sum.color += seen.color;
            sum.alpha += seen.alpha;
        }
    }
    sums
}

/// Writes linear colour, premultiplied, and alpha as a pixel's bytes begin.
pub(crate) fn write_codes(color: Vec3, alpha: f32, format: PixelFormat, bytes: &mut [u8]) {
    match format {
        PixelFormat::Rgba8 => bytes.copy_from_slice(&straight_codes(color, alpha, 255.0).map(|c| c as u8)),
        PixelFormat::Rgba16 => {
            write_words(bytes, straight_codes(color, alpha, 65535.0).map(u16::to_le_bytes));
        }
        PixelFormat::Layers => write_words(bytes, [color.x, color.y, color.z, alpha].map(f32::to_le_bytes)),
    }
}

/// sRGB codes of the colour behind the premultiplied one, and of alpha.
pub(crate) fn straight_codes(premultiplied: Vec3, alpha: f32, max_code: f64) -> [u16; 4] {
    let color = if alpha > 0.0 { premultiplied / alpha } else { Vec3::ZERO };
    let [r, g, b] = color.to_array().map(|c| encode_srgb(c, max_code));
    [r, g, b, encode_linear(alpha, max_code)]
}

/// Where the words of [`surface_layers`] begin among the nine of [`PixelFormat::Layers`], which begin with linear premultiplied colour and
/// alpha.
const SURFACE: usize = 16;

/// Distance from the eye in world units (`+inf` on a miss), the geometric normal on the side on which the triangle winds counter-clockwise
/// (0 on a miss), and the id in the flattened scene.
fn surface_layers(scene: &Renderer<'_>, first: Option<&Hit>) -> [[u8; 4]; 5] {
    let (depth, normal, id) = match first {
        None => (f32::INFINITY, Vec3::ZERO, Hit::NO_TRIANGLE),
        Some(hit) => {
            let corners = scene.mesh.indices(hit.triangle).map(|v| scene.mesh.position(v));
            let depth = (f64::from(hit.t) * scene.step) as f32;
            (depth, geometric_normal(corners), scene.original_id(hit.triangle))
        }
    };
    let [depth, x, y, z] = [depth, normal.x, normal.y, normal.z].map(f32::to_le_bytes);
    [depth, x, y, z, id.to_le_bytes()]
}

fn write_words<const N: usize>(bytes: &mut [u8], words: impl IntoIterator<Item = [u8; N]>) {
    for (to, word) in bytes.chunks_exact_mut(N).zip(words) {
        to.copy_from_slice(&word);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_hold_every_pixel_of_a_block_once() {
        for (width, height) in [(1, 1), (4, 2), (8, 1), (9, 1), (5, 3), (128, 2), (3, 7), (0, 2), (2, 0)] {
            let block = PixelBlock { x: 3, y: 5, width, height };
            let mut seen: Vec<_> = packets(block)
                .flat_map(|packet| lanes_in(packet.lanes).map(|lane| packet.pixel(lane)).collect::<Vec<_>>())
                .collect();
            seen.sort_unstable();
            let mut all: Vec<_> = (3..3 + width).flat_map(|x| (5..5 + height).map(move |y| (x, y))).collect();
            all.sort_unstable();
            assert_eq!(seen, all, "{width} x {height}");
        }
    }
}
