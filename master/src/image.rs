//! The frame buffer, its hash, and EXR files.

use crate::output::{OutputError, OutputFile};
use crate::png::write_png;
use std::fmt;
use std::io::{self, Seek, Write};

pub use tessera_wire::PixelFormat;

/// A whole image in the frame's wire format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameBuffer {
    width: u32,
    height: u32,
    format: PixelFormat,
    data: Vec<u8>,
}

/// A tile that does not fit its frame; the sender's fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileError {
    /// The rectangle leaves the image.
    #[error("the tile at {x}, {y} of {width}x{height} pixels leaves the image")]
    Outside {
        /// Left column.
        x: u32,
        /// Top row.
        y: u32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Its rows are complete and away.
    #[error("a second tile came for the place at {x}, {y}, whose rows are written")]
    Twice {
        /// Left column.
        x: u32,
        /// Top row.
        y: u32,
    },
    /// The bytes do not fill the rectangle.
    #[error("a tile of {expected} bytes came with {found}")]
    Length {
        /// Bytes of the rectangle.
        expected: u64,
        /// Bytes that came.
        found: u64,
    },
}

/// An image that does not fit the memory that is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "an image of {width} x {height} takes {bytes} bytes, more than the memory that is left: choose a smaller size"
)]
pub struct NoRoom {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes in the frame's format.
    pub bytes: u64,
}

/// BLAKE3 of an image; equal hashes mean equal pixels within one format and numeric class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ImageHash(pub [u8; 32]);

impl fmt::Display for ImageHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Makes an [`ImageHash`] of rows as they come.
#[derive(Clone, Debug)]
pub struct ImageHasher(blake3::Hasher);

impl ImageHasher {
    /// For an image of this size in pixels.
    pub fn new(width: u32, height: u32, format: PixelFormat) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format.name().as_bytes());
        hasher.update(&width.to_le_bytes());
        hasher.update(&height.to_le_bytes());
        Self(hasher)
    }

    /// The next bytes of the rows, from the top, in the wire format and without padding.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The hash of all rows.
    pub fn finish(&self) -> ImageHash {
        ImageHash(*self.0.finalize().as_bytes())
    }
}

impl FrameBuffer {
    /// An image of zeros. The caller has checked the size against its limits: `width * height * bytes_per_pixel` bytes are taken.
    ///
    /// # Errors
    /// [`NoRoom`], when the machine does not have them.
    pub fn new(width: u32, height: u32, format: PixelFormat) -> Result<Self, NoRoom> {
        let bytes = width as usize * height as usize * format.bytes_per_pixel();
        let mut data = Vec::new();
        data.try_reserve_exact(bytes).map_err(|_| NoRoom { width, height, bytes: bytes as u64 })?;
        data.resize(bytes, 0);
        Ok(Self { width, height, format, data })
    }

    /// An image of these rows, without padding.
    pub fn from_rows(width: u32, height: u32, format: PixelFormat, data: Vec<u8>) -> Result<Self, TileError> {
        let expected = u64::from(width) * u64::from(height) * format.bytes_per_pixel() as u64;
        if data.len() as u64 != expected {
            return Err(TileError::Length { expected, found: data.len() as u64 });
        }
        Ok(Self { width, height, format, data })
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// What a pixel holds.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// All rows from the top, without padding.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// An image without rows.
    pub(crate) fn without_rows(width: u32, format: PixelFormat) -> Self {
        Self { width, height: 0, format, data: Vec::new() }
    }

    /// All rows from the top, without padding.
    pub(crate) fn into_rows(self) -> Vec<u8> {
        self.data
    }

    /// All rows, to be filled.
    pub(crate) fn data_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }

    /// Copies a tile of `width` by `height` pixels to column `x`, row `y`.
    pub fn put(&mut self, x: u32, y: u32, width: u32, height: u32, bytes: &[u8]) -> Result<(), TileError> {
        let fits = |start: u32, length: u32, end: u32| start.checked_add(length).is_some_and(|e| e <= end);
        if !fits(x, width, self.width) || !fits(y, height, self.height) {
            return Err(TileError::Outside { x, y, width, height });
        }
        let pixel = self.format.bytes_per_pixel();
        let row = width as usize * pixel;
        let expected = row * height as usize;
        if bytes.len() != expected {
            return Err(TileError::Length { expected: expected as u64, found: bytes.len() as u64 });
        }
        if row == 0 {
            return Ok(());
        }
        let stride = self.width as usize * pixel;
        let first = y as usize * stride + x as usize * pixel;
        for (source, target) in bytes.chunks_exact(row).zip(self.data[first..].chunks_mut(stride)) {
            target[..row].copy_from_slice(source);
        }
        Ok(())
    }

    /// A copy of `width` by `height` pixels at column `x`, row `y`, as [`FrameBuffer::put`] takes them; `None` if they leave the image.
    pub fn get(&self, x: u32, y: u32, width: u32, height: u32) -> Option<Vec<u8>> {
        let fits = |start: u32, length: u32, end: u32| start.checked_add(length).is_some_and(|e| e <= end);
        if !fits(x, width, self.width) || !fits(y, height, self.height) {
            return None;
        }
        let pixel = self.format.bytes_per_pixel();
        let (row, stride) = (width as usize * pixel, self.width as usize * pixel);
        let first = y as usize * stride + x as usize * pixel;
        let rows = (0..height as usize).map(|line| &self.data[first + line * stride..][..row]);
        Some(rows.flatten().copied().collect())
    }

    /// BLAKE3 of the format's name, width and height (`u32`, little endian) and the rows.
    pub fn hash(&self) -> ImageHash {
        let mut hasher = ImageHasher::new(self.width, self.height, self.format);
        hasher.update(&self.data);
        hasher.finish()
    }

    /// The image, of 8 or 16 bits, as a PNG file in memory.
    ///
    /// # Errors
    /// It is one of layers, or there is no memory.
    pub fn to_png(&self) -> io::Result<Vec<u8>> {
        if self.format == PixelFormat::Layers {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "PNG files hold no layers"));
        }
        let mut file = Vec::new();
        write_png(self.width, self.height, self.format, std::iter::once(Ok(&self.data)), &mut file)?;
        Ok(file)
    }

    /// Alpha of each pixel, [0, 1], rows from the top.
    pub fn alpha(&self) -> Vec<f32> {
        let pixels = self.data.chunks_exact(self.format.bytes_per_pixel());
        pixels
            .map(|pixel| match self.format {
                PixelFormat::Rgba8 => f32::from(pixel[3]) / 255.0,
                PixelFormat::Rgba16 => f32::from(u16::from_le_bytes([pixel[6], pixel[7]])) / 65_535.0,
                PixelFormat::Layers => f32::from_le_bytes([pixel[12], pixel[13], pixel[14], pixel[15]]),
            })
            .collect()
    }

    /// Writes the image to `file`: EXR for [`PixelFormat::Layers`], else PNG.
    pub fn write(&self, file: &OutputFile) -> Result<(), OutputError> {
        match self.format {
            PixelFormat::Layers => file.write(|w| write_exr(self, w)),
            PixelFormat::Rgba8 | PixelFormat::Rgba16 => {
                let rows = std::iter::once(Ok(&self.data));
                file.write(|w| write_png(self.width, self.height, self.format, rows, w))
            }
        }
    }
}

/// Channel names in the order of the words of [`PixelFormat::Layers`]; the last holds `u32`, the others `f32`.
const CHANNELS: [&str; 9] =
    ["R", "G", "B", "A", "depth.Z", "normal.X", "normal.Y", "normal.Z", "id.triangle"];

fn write_exr(image: &FrameBuffer, to: &mut (impl Write + Seek)) -> exr::error::UnitResult {
    use exr::prelude::*;
    let words = |channel: usize| {
        image.data.chunks_exact(36).map(move |pixel| {
            let at = channel * 4;
            u32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]])
        })
    };
    let channels = CHANNELS.iter().enumerate().map(|(index, &name)| {
        let samples = if name == "id.triangle" {
            FlatSamples::U32(words(index).collect())
        } else {
            FlatSamples::F32(words(index).map(f32::from_bits).collect())
        };
        // Only colours may be coded by how they look; the rest is plain data.
        let quantize_linearly = !matches!(name, "R" | "G" | "B");
        AnyChannel { name: Text::from(name), sample_data: samples, quantize_linearly, sampling: Vec2(1, 1) }
    });
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let size = Vec2(image.width as usize, image.height as usize);
    let attributes =
        LayerAttributes { software_name: Some(Text::from("tessera")), ..LayerAttributes::default() };
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels.collect()));
    Image::from_layer(layer).write().non_parallel().to_buffered(to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gradient(width: u32, height: u32, format: PixelFormat) -> FrameBuffer {
        let mut image = FrameBuffer::new(width, height, format).unwrap();
        for (i, byte) in image.data.iter_mut().enumerate() {
            *byte = (i * 31 % 251) as u8;
        }
        image
    }

    fn write(image: &FrameBuffer, name: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        image.write(&OutputFile::check(&path).unwrap()).unwrap();
        (folder, path)
    }

    #[test]
    fn the_hash_is_what_the_readme_says() {
        let image = gradient(3, 2, PixelFormat::Rgba8);
        let mut bytes = b"rgba8\x03\0\0\0\x02\0\0\0".to_vec();
        bytes.extend_from_slice(&image.data);
        assert_eq!(image.hash().0, *blake3::hash(&bytes).as_bytes());
        assert_eq!(image.hash().to_string(), blake3::hash(&bytes).to_hex().to_string());
    }

    #[test]
    fn png_keeps_every_code() {
        let image = gradient(7, 5, PixelFormat::Rgba8);
        let (_folder, path) = write(&image, "a.png");
        assert_eq!(image::open(path).unwrap().as_rgba8().unwrap().as_raw(), &image.data);

        let image = gradient(7, 5, PixelFormat::Rgba16);
        let (_folder, path) = write(&image, "a.png");
        let back: Vec<u8> = image::open(path)
            .unwrap()
            .as_rgba16()
            .unwrap()
            .as_raw()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        assert_eq!(back, image.data);
    }

    #[test]
    fn exr_keeps_every_bit_of_every_layer() {
        use exr::prelude::*;
        let mut image = gradient(19, 35, PixelFormat::Layers);
        // A miss: infinite depth, no triangle.
        image.data[16..20].copy_from_slice(&f32::INFINITY.to_le_bytes());
        image.data[32..36].copy_from_slice(&u32::MAX.to_le_bytes());
        let (_folder, path) = write(&image, "a.exr");
        let file = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .all_layers()
            .all_attributes()
            .from_file(path)
            .unwrap();
        assert_eq!(file.layer_data.len(), 1);
        let layer = &file.layer_data[0];
        assert_eq!((layer.size.0, layer.size.1), (19, 35));
        assert_eq!(layer.channel_data.list.len(), 9);
        for (index, name) in CHANNELS.iter().enumerate() {
            let found = layer.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
            let bits: Vec<u32> = match &found.sample_data {
                FlatSamples::F32(v) => v.iter().map(|x| x.to_bits()).collect(),
                FlatSamples::U32(v) => v.clone(),
                FlatSamples::F16(_) => panic!("{name} must not be half precision"),
            };
            assert_eq!(matches!(found.sample_data, FlatSamples::U32(_)), index == 8, "{name}");
            let expected: Vec<u32> = image
                .data
                .chunks_exact(36)
                .map(|p| u32::from_le_bytes(p[index * 4..index * 4 + 4].try_into().unwrap()))
                .collect();
            assert_eq!(bits, expected, "{name}");
        }
    }

    #[test]
    fn a_tile_must_fit() {
        let mut image = FrameBuffer::new(4, 4, PixelFormat::Rgba8).unwrap();
        let outside = |x, y, w, h| TileError::Outside { x, y, width: w, height: h };
        assert_eq!(image.put(3, 0, 2, 1, &[0; 8]), Err(outside(3, 0, 2, 1)));
        assert_eq!(image.put(0, 4, 1, 1, &[0; 4]), Err(outside(0, 4, 1, 1)));
        assert_eq!(image.put(u32::MAX, 0, 2, 1, &[0; 8]), Err(outside(u32::MAX, 0, 2, 1)));
        assert_eq!(image.put(0, 0, 2, 2, &[0; 15]), Err(TileError::Length { expected: 16, found: 15 }));
        assert_eq!(image.put(4, 4, 0, 0, &[]), Ok(()));
    }

    proptest! {
        #[test]
        fn tiles_in_any_order_make_the_image(width in 1u32..40, height in 1u32..40, tile in 1u32..17, reverse: bool) {
            let whole = gradient(width, height, PixelFormat::Rgba16);
            let mut made = FrameBuffer::new(width, height, PixelFormat::Rgba16).unwrap();
            let mut corners: Vec<_> = (0..height)
                .step_by(tile as usize)
                .flat_map(|y| (0..width).step_by(tile as usize).map(move |x| (x, y)))
                .collect();
            if reverse {
                corners.reverse();
            }
            for (x, y) in corners {
                let (w, h) = (tile.min(width - x), tile.min(height - y));
                let bytes: Vec<u8> = (y..y + h)
                    .flat_map(|row| {
                        let first = (row * width + x) as usize * 8;
                        whole.data[first..first + w as usize * 8].to_vec()
                    })
                    .collect();
                made.put(x, y, w, h, &bytes).unwrap();
                prop_assert_eq!(made.get(x, y, w, h), Some(bytes));
                prop_assert_eq!(made.get(x, y, width, h + 1).is_some(), x == 0 && y + h < height);
            }
            prop_assert_eq!(made.hash(), whole.hash());
        }
    }
}
