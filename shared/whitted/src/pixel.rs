//! Blocks of pixels.

use crate::{FrameParams, RayCounts};
use tessera_pack::Pack;

/// Names the arithmetic: frames of one class are equal bit for bit. Raise the number with every change of a result.
pub const NUMERIC_CLASS: &str = "cpu-1";

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

/// Renders `block` into `out` (`width * height * bytes_per_pixel` bytes). A pixel depends on the pack, the parameters and its own
/// coordinates alone, never on the block.
pub fn render_block(pack: &Pack, params: &FrameParams, block: PixelBlock, out: &mut [u8]) -> RayCounts {
    let _ = (pack, params, block, out);
    RayCounts::default()
}
