//! Blocks of pixels.

use crate::color::{encode_linear, encode_srgb};
use crate::path::{PathStack, Seen, first_seen, trace};
use crate::sample::{offset_in_pixel, pixel_seed};
use crate::scene::Renderer;
use crate::surface::geometric_normal;
use crate::{FrameParams, PixelFormat, RayCounts};
use tessera_geometry::{Hit, Vec3};

/// Names the arithmetic: frames of one class are equal bit for bit. Raise the number with every change of a result.
pub const NUMERIC_CLASS: &str = "cpu-2";

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
        let columns = block.x..block.x + block.width;
        let pixels = (block.y..block.y + block.height).flat_map(|y| columns.clone().map(move |x| (x, y)));
        for ((x, y), bytes) in pixels.zip(out.chunks_exact_mut(params.format.bytes_per_pixel())) {
            let seen = pixel(self, params, x, y, &mut stack, &mut counts);
            match params.format {
                PixelFormat::Rgba8 => bytes.copy_from_slice(&straight_codes(&seen, 255.0).map(|c| c as u8)),
                PixelFormat::Rgba16 => {
                    write_words(bytes, straight_codes(&seen, 65535.0).map(u16::to_le_bytes))
                }
                PixelFormat::Layers => write_words(bytes, layers(self, &seen)),
            }
        }
        counts
    }
}

/// The mean of a pixel's samples, added up in their order. `first` is the surface behind the pixel's centre; it is
/// looked for only where the format shows it.
fn pixel(
    scene: &Renderer<'_>,
    params: &FrameParams,
    x: u32,
    y: u32,
    stack: &mut PathStack,
    counts: &mut RayCounts,
) -> Seen {
    // Send one sample through the centre.
    let (left, top) = (x as f32, y as f32);
    let camera = &params.camera;
    let centre = camera.ray(left + 0.5, top + 0.5, params.width, params.height);
    if params.samples <= 1 {
        return trace(scene, params, &centre, stack, counts);
    }

    // Or add up many.
    let seed = pixel_seed(params.frame, x, y);
    let (mut color, mut alpha) = (Vec3::ZERO, 0.0);
    for index in 0..params.samples {
        let offset = offset_in_pixel(index, params.samples, seed);
        let ray = camera.ray(left + offset.x, top + offset.y, params.width, params.height);
        let seen = trace(scene, params, &ray, stack, counts);
        color += seen.color;
        alpha += seen.alpha;
    }
    let first = if params.format == PixelFormat::Layers {
        counts.primary += 1;
        first_seen(scene, &centre)
    } else {
        None
    };
    let share = 1.0 / params.samples as f32;
    Seen { color: color * share, alpha: alpha * share, first }
}

/// sRGB codes of the colour behind the premultiplied one, and of alpha.
fn straight_codes(seen: &Seen, max_code: f64) -> [u16; 4] {
    let color = if seen.alpha > 0.0 { seen.color / seen.alpha } else { Vec3::ZERO };
    let [r, g, b] = color.to_array().map(|c| encode_srgb(c, max_code));
    [r, g, b, encode_linear(seen.alpha, max_code)]
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
