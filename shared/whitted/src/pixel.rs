//! Blocks of pixels.

use crate::color::{encode_linear, encode_srgb};
use crate::path::{PathStack, Seen, first_seen, trace};
use crate::sample::{offset_in_pixel, pixel_seed};
use crate::scene::Renderer;
use crate::surface::geometric_normal;
use crate::{FrameParams, PixelFormat, RayCounts};
use tessera_geometry::wide::{LANES, lanes_in};
use tessera_geometry::{Hit, Vec2, Vec3};

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
}

impl Renderer<'_> {
    /// Renders `block` into `out` (`width * height * bytes_per_pixel` bytes). A pixel depends on the pack, the parameters
    /// and its own coordinates alone, never on the block.
    ///
    /// # Panics
    /// When `out` is not [`PixelBlock::byte_len`] long.
    pub fn render_block(&self, params: &FrameParams, block: PixelBlock, out: &mut [u8]) -> RayCounts {
        assert_eq!(out.len(), block.byte_len(params.format), "the buffer does not fit {block:?}");
        let mut counts = RayCounts::default();
        let mut stack = PathStack::new();
        let pixel_bytes = params.format.bytes_per_pixel();
        for packet in packets(block) {
            let seen = packet_of_pixels(self, params, &packet, &mut stack, &mut counts);
            for lane in lanes_in(packet.lanes) {
                let (x, y) = packet.pixel(lane);
                let place = (y - block.y) as usize * block.width as usize + (x - block.x) as usize;
                let bytes = &mut out[place * pixel_bytes..][..pixel_bytes];
                let seen = &seen[lane];
                match params.format {
                    PixelFormat::Rgba8 => {
                        bytes.copy_from_slice(&straight_codes(seen.color, seen.alpha, 255.0).map(|c| c as u8))
                    }
                    PixelFormat::Rgba16 => write_words(
                        bytes,
                        straight_codes(seen.color, seen.alpha, 65535.0).map(u16::to_le_bytes),
                    ),
                    PixelFormat::Layers => write_words(bytes, layers(self, seen)),
                }
            }
        }
        counts
    }
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
    let camera = &params.camera;
    let ray_at = |lane: usize, offset: Vec2| {
        let (x, y) = packet.pixel(lane);
        camera.ray(x as f32 + offset.x, y as f32 + offset.y, params.width, params.height)
    };
    let centres = std::array::from_fn(|lane| ray_at(lane, Vec2::splat(0.5)));
    if params.samples <= 1 {
        return trace(scene, params, &centres, packet.lanes, stack, counts);
    }

    // Or add up many.
    let seeds: [u32; LANES] = std::array::from_fn(|lane| {
        let (x, y) = packet.pixel(lane);
        pixel_seed(params.frame, x, y)
    });
    let mut sums = [Seen { color: Vec3::ZERO, alpha: 0.0, first: None }; LANES];
    for index in 0..params.samples {
        let rays =
            std::array::from_fn(|lane| ray_at(lane, offset_in_pixel(index, params.samples, seeds[lane])));
        let seen = trace(scene, params, &rays, packet.lanes, stack, counts);
        for (sum, seen) in sums.iter_mut().zip(seen) {
            sum.color += seen.color;
            sum.alpha += seen.alpha;
        }
    }
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

/// sRGB codes of the colour behind the premultiplied one, and of alpha.
pub(crate) fn straight_codes(premultiplied: Vec3, alpha: f32, max_code: f64) -> [u16; 4] {
    let color = if alpha > 0.0 { premultiplied / alpha } else { Vec3::ZERO };
    let [r, g, b] = color.to_array().map(|c| encode_srgb(c, max_code));
    [r, g, b, encode_linear(alpha, max_code)]
}

/// The nine words of [`PixelFormat::Layers`]: linear premultiplied colour, alpha, distance from the eye in world
/// units (`+inf` on a miss), the geometric normal on the side on which the triangle winds counter-clockwise (0 on a
/// miss), and the id in the flattened scene.
fn layers(scene: &Renderer<'_>, seen: &Seen) -> [[u8; 4]; 9] {
    let (depth, normal, id) = match &seen.first {
        None => (f32::INFINITY, Vec3::ZERO, Hit::NO_TRIANGLE),
        Some(hit) => {
            let corners = scene.mesh.indices(hit.triangle).map(|v| scene.mesh.position(v));
            let depth = (f64::from(hit.t) * scene.step) as f32;
            (depth, geometric_normal(corners), scene.original_id(hit.triangle))
        }
    };
    let c = seen.color;
    let floats = [c.x, c.y, c.z, seen.alpha, depth, normal.x, normal.y, normal.z];
    let mut words = [[0; 4]; 9];
    for (word, float) in words.iter_mut().zip(floats) {
        *word = float.to_le_bytes();
    }
    words[8] = id.to_le_bytes();
    words
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
