//! Pixels of a tile on the wire: rounded if that is wanted, predicted from their neighbours, and what the prediction lacks packed.
//!
//! `PROTOCOL.md` has the bytes. A tile is split into planes of one channel each. A sample is predicted from those to the left, above, and
//! above to the left as LOCO-I does (Weinberger, Seroussi, Sapiro 2000): an edge on one side makes it the other neighbour, else it lies on
//! their plane. How much the three differ is the sample's context; each context of a plane has a prefix code of its own, and where they are equal,
//! runs of exact predictions are counted instead.

mod bits;
mod code;
mod plane;

use crate::{Coding, PixelFormat, limits};
use bits::{BitReader, BitWriter};
use plane::{Plane, Sample, Tables};

/// Format in the lowest two bits; then whether red and blue are differences from green, and whether colours are numbers of a grid's codes.
const GREEN: u8 = 4;
const GRID: u8 = 8;
/// The flags, and the width less one as 16 bits.
const HEADER_BYTES: usize = 3;

/// Intervals between the codes of the grid for 16 bits: `65,535 / 128 < 512`, so that no code is more than 256 from one of the grid's, which
/// is less than a code of 8 bits (257). (For 8 bits the grid is every third code: 255 is one of them, and none is more than 1 off.)
const INTERVALS: u32 = 128;

/// Rounds the colours of `pixels` to the grid of [`Coding::Rounded`]; alpha, and layers, stay. Black and white stay too.
///
/// Of 8 bits, none is off by more than 1, so that the mean square error is at most 1 and PSNR at least `20 log10 255` = 48.1 dB; where codes are
/// equally frequent, two of three are off and it is 49.9 dB. Of 16 bits, none is off by more than 256: at least 48.2 dB.
pub fn round(format: PixelFormat, pixels: &mut [u8]) {
    match format {
        PixelFormat::Rgba8 => {
            for pixel in pixels.as_chunks_mut::<4>().0 {
                let [red, green, blue, alpha] = *pixel;
                let [red, green, blue] = [red, green, blue].map(|code| from_grid_8(to_grid_8(code)));
                *pixel = [red, green, blue, alpha];
            }
        }
        PixelFormat::Rgba16 => {
            for code in pixels.chunks_exact_mut(8).flat_map(|pixel| pixel[..6].chunks_exact_mut(2)) {
                let rounded = from_grid_16(to_grid_16(u16::from_le_bytes([code[0], code[1]])));
                code.copy_from_slice(&rounded.to_le_bytes());
            }
        }
        PixelFormat::Layers => {}
    }
}

fn to_grid_8(code: u8) -> u8 {
    ((u16::from(code) + 1) / 3) as u8
}

fn from_grid_8(number: u8) -> u8 {
    number.wrapping_mul(3)
}

fn to_grid_16(code: u16) -> u16 {
    ((u32::from(code) * 2 * INTERVALS + 65_535) / (2 * 65_535)) as u16
}

fn from_grid_16(number: u16) -> u16 {
    // A peer's number may be any.
    ((u32::from(number) * 65_535 + INTERVALS / 2) / INTERVALS) as u16
}

/// [`Packer::pack`], once.
pub fn encode(format: PixelFormat, width: u32, pixels: &[u8], coding: Coding) -> Option<Vec<u8>> {
    Packer::default().pack(format, width, pixels, coding)
}

/// Packs tiles one after the other, in memory that it keeps.
#[derive(Default)]
pub struct Packer {
    bytes: Plane<u8>,
    words: Plane<u16>,
    longs: Plane<u32>,
}

impl Packer {
    /// The packed bytes of `pixels`, whole rows of `width`; `None` where they would not be fewer, with [`Coding::Raw`], and for what is no
    /// tile. With [`Coding::Rounded`] the pixels must have been through [`round`].
    pub fn pack(
        &mut self,
        format: PixelFormat,
        width: u32,
        pixels: &[u8],
        coding: Coding,
    ) -> Option<Vec<u8>> {
        let columns = width as usize;
        let row = columns * format.bytes_per_pixel();
        let is_tile =
            (1..=limits::SIDE).contains(&width) && !pixels.is_empty() && pixels.len().is_multiple_of(row);
        if coding == Coding::Raw || !is_tile || pixels.len() as u64 > limits::TILE_BYTES {
            return None;
        }
        let grid = if coding == Coding::Rounded && format != PixelFormat::Layers { GRID } else { 0 };
        let green = if format != PixelFormat::Layers && green_helps(format, pixels) { GREEN } else { 0 };
        let mut out = BitWriter::new(pixels.len());
        out.announce(8 * HEADER_BYTES as u64)?;
        out.bits(u64::from(format_number(format) | green | grid) | u64::from(width - 1) << 8, 24);
        let has = |flag| flag != 0;
        match format {
            PixelFormat::Rgba8 => {
                for channel in 0..4 {
                    let samples = pixels.as_chunks::<4>().0.iter();
                    // (255 * 171 / 512 is within one of 255 / 3, and so on for all below.)
                    let (times, shift) = if grid != 0 && channel < 3 { (171, 9) } else { (1, 0) };
                    let numbered = |code: u8| ((u16::from(code) * times) >> shift) as u8;
                    let by = if green != 0 && (channel == 0 || channel == 2) { 1 } else { 0 };
                    self.bytes.samples.clear();
                    self.bytes.samples.extend(
                        samples.map(|pixel| numbered(pixel[channel]).wrapping_sub(numbered(pixel[1]) * by)),
                    );
                    self.bytes.pack(columns, &mut out)?;
                }
            }
            PixelFormat::Rgba16 => {
                let code = |at: usize| u16::from_le_bytes([pixels[at], pixels[at + 1]]);
                for channel in 0..4 {
                    let is_colour = channel < 3;
                    let numbered = |code: u16| if has(grid) && is_colour { to_grid_16(code) } else { code };
                    let minus = has(green) && is_colour && channel != 1;
                    self.words.samples.clear();
                    self.words.samples.extend((0..pixels.len()).step_by(8).map(|at| {
                        let base = if minus { numbered(code(at + 2)) } else { 0 };
                        numbered(code(at + 2 * channel)).wrapping_sub(base)
                    }));
                    self.words.pack(columns, &mut out)?;
                }
            }
            PixelFormat::Layers => {
                for word in 0..9 {
                    self.longs.samples.clear();
                    self.longs.samples.extend(pixels.chunks_exact(36).map(|pixel| {
                        let bytes = &pixel[4 * word..4 * word + 4];
                        let bits = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
                        if word < 8 { ordered(bits) } else { bits }
                    }));
                    self.longs.pack(columns, &mut out)?;
                }
            }
        }
        Some(out.finish()).filter(|packed| packed.len() < pixels.len())
    }
}

/// The pixels, `pixel_bytes` of them, that were packed as `bytes`. The caller has bounded both; nothing else bounds the memory that is taken,
/// which is twice `pixel_bytes`.
pub fn decode(pixel_bytes: usize, bytes: &[u8]) -> Result<Vec<u8>, String> {
    let (&[flags, low, high], _) =
        bytes.split_first_chunk::<HEADER_BYTES>().ok_or("a packed tile without a header")?;
    let format = PixelFormat::ALL.into_iter().find(|format| format_number(*format) == flags & 3);
    let format = format.ok_or("a packed tile of an unknown format")?;
    let allowed = if format == PixelFormat::Layers { 0 } else { GREEN | GRID };
    if flags & !(3 | allowed) != 0 {
        return Err(format!("a packed tile with flags {flags:#04x}"));
    }
    let columns = usize::from(u16::from_le_bytes([low, high])) + 1;
    if pixel_bytes == 0 || !pixel_bytes.is_multiple_of(columns * format.bytes_per_pixel()) {
        return Err(format!("{pixel_bytes} bytes of a packed tile are no rows of {columns} pixels"));
    }
    let mut reader = BitReader::new(&bytes[HEADER_BYTES..]);
    let (has_green, has_grid) = (flags & GREEN != 0, flags & GRID != 0);
    let mut pixels = vec![0; pixel_bytes];
    let count = pixel_bytes / format.bytes_per_pixel();
    match format {
        PixelFormat::Rgba8 => {
            let planes = unpack::<u8>(4, columns, count, &mut reader)?;
            for (k, pixel) in pixels.chunks_exact_mut(4).enumerate() {
                let mut codes: [u8; 4] = std::array::from_fn(|channel| planes[channel * count + k]);
                if has_green {
                    codes[0] = codes[0].wrapping_add(codes[1]);
                    codes[2] = codes[2].wrapping_add(codes[1]);
                }
                if has_grid {
                    codes[..3].iter_mut().for_each(|code| *code = from_grid_8(*code));
                }
                pixel.copy_from_slice(&codes);
            }
        }
        PixelFormat::Rgba16 => {
            let planes = unpack::<u16>(4, columns, count, &mut reader)?;
            for (k, pixel) in pixels.chunks_exact_mut(8).enumerate() {
                let mut codes: [u16; 4] = std::array::from_fn(|channel| planes[channel * count + k]);
                if has_green {
                    codes[0] = codes[0].wrapping_add(codes[1]);
                    codes[2] = codes[2].wrapping_add(codes[1]);
                }
                if has_grid {
                    codes[..3].iter_mut().for_each(|code| *code = from_grid_16(*code));
                }
                pixel.chunks_exact_mut(2).zip(codes).for_each(|(to, code)| {
                    to.copy_from_slice(&code.to_le_bytes());
                });
            }
        }
        PixelFormat::Layers => {
            let planes = unpack::<u32>(9, columns, count, &mut reader)?;
            for (k, pixel) in pixels.chunks_exact_mut(36).enumerate() {
                for (word, to) in pixel.chunks_exact_mut(4).enumerate() {
                    let bits = planes[word * count + k];
                    to.copy_from_slice(&(if word < 8 { disordered(bits) } else { bits }).to_le_bytes());
                }
            }
        }
    }
    reader.finish()?;
    Ok(pixels)
}

/// The samples of `channels` planes, `count` each, one plane after the other.
fn unpack<S: Sample>(
    channels: usize,
    columns: usize,
    count: usize,
    reader: &mut BitReader<'_>,
) -> Result<Vec<S>, String> {
    let mut planes = vec![S::default(); channels * count];
    let mut tables = Tables::new();
    planes.chunks_exact_mut(count).try_for_each(|plane| tables.unpack(plane, columns, reader))?;
    Ok(planes)
}

fn format_number(format: PixelFormat) -> u8 {
    match format {
        PixelFormat::Rgba8 => 0,
        PixelFormat::Rgba16 => 1,
        PixelFormat::Layers => 2,
    }
}

/// Whether red and blue change less from pixel to pixel beside green than by themselves, over every eighth pair of neighbours: lit
/// surfaces become darker in all channels at once.
fn green_helps(format: PixelFormat, pixels: &[u8]) -> bool {
    let bytes = format.bytes_per_pixel();
    // The high byte of a code of 16 bits tells enough.
    let channel = bytes / 4;
    let (mut alone, mut beside) = (0_u64, 0_u64);
    for pair in pixels.chunks_exact(8 * bytes) {
        let change = |k: usize| {
            let at = k * channel + channel - 1;
            i32::from(pair[bytes + at]) - i32::from(pair[at])
        };
        let (red, green, blue) = (change(0), change(1), change(2));
        alone += u64::from(red.unsigned_abs() + blue.unsigned_abs());
        beside += u64::from((red - green).unsigned_abs() + (blue - green).unsigned_abs());
    }
    beside < alone
}

/// Bits of an `f32` as a number that grows with it.
fn ordered(bits: u32) -> u32 {
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// Back from [`ordered`].
fn disordered(number: u32) -> u32 {
    if number >> 31 == 1 { number & !(1 << 31) } else { !number }
}

#[cfg(test)]
mod tests;
