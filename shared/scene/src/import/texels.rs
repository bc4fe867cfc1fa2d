//! Decodes images within limits.

use super::has_room;
use super::limits::{IMAGE_SIDE_MAX, IMAGE_TEXELS_MAX, TOTAL_TEXELS_MAX};
use super::report::{clean, one_line};
use crate::Image;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// Decodes the images of one import and counts their texels.
#[derive(Debug)]
pub(crate) struct TexelReader {
    texels_left: u64,
}

impl TexelReader {
    pub(crate) fn new() -> Self {
        Self { texels_left: TOTAL_TEXELS_MAX }
    }

    /// Decodes PNG or JPEG; the size is checked before texels are decoded. The error continues a sentence on the image.
    pub(crate) fn decode(&mut self, name: &str, bytes: &[u8]) -> Result<Image, String> {
        let format = match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            _ => return Err(format!("is {}; convert it to PNG or JPEG", foreign_format(bytes))),
        };
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::no_limits();
        limits.max_image_width = Some(IMAGE_SIDE_MAX);
        limits.max_image_height = Some(IMAGE_SIDE_MAX);
        // A decoder holds the image once, with at most 8 bytes a texel (16-bit RGBA); as much again for its own buffers.
        limits.max_alloc = Some(IMAGE_TEXELS_MAX * 16);
        reader.limits(limits);
        let broken = |error: image::ImageError| match error {
            image::ImageError::Limits(_) => too_large("has"),
            error => {
                let said = one_line(&error.to_string());
                format!("cannot be decoded: {said}; it is truncated or damaged: export it again")
            }
        };
        let decoder = reader.into_decoder().map_err(broken)?;
        let (width, height) = decoder.dimensions();
        let texels = u64::from(width) * u64::from(height);
        if width > IMAGE_SIDE_MAX || height > IMAGE_SIDE_MAX || texels > IMAGE_TEXELS_MAX {
            return Err(too_large(&format!("has {width} x {height} texels,")));
        }
        if texels > self.texels_left {
            return Err(format!(
                "brings all images over {TOTAL_TEXELS_MAX} texels, the limit of a scene; scale them down"
            ));
        }
        // The decoder and the conversions behind it reserve in ways that end the process when memory is short.
        let room = decoder.total_bytes().saturating_add(8 * texels);
        if !has_room(room) {
            return Err(format!(
                "takes {room} bytes to decode, more than the memory that is left; scale it down"
            ));
        }
        let rgba = DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgba8();
        self.texels_left -= texels;
        Ok(Image { name: clean(name), width, height, rgba: rgba.into_raw().into() })
    }
}

fn too_large(has: &str) -> String {
    format!(
        "{has} more than the {IMAGE_SIDE_MAX} texels a side or {IMAGE_TEXELS_MAX} in all that are allowed; scale it down"
    )
}

/// A number in [0, 1] as the nearest 8-bit code; `as` cuts what lies outside to the ends, and NaN to 0.
pub(crate) fn code(unit: f64) -> u8 {
    (unit * 255.0 + 0.5) as u8
}

/// Names what the bytes are, where that helps.
fn foreign_format(bytes: &[u8]) -> &'static str {
    match bytes {
        [0xAB, b'K', b'T', b'X', b' ', b'2', b'0', ..] => "a KTX2 image, which is not supported",
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => {
            "a WebP image, which is not supported"
        }
        [b'D', b'D', b'S', b' ', ..] => "a DDS image, which is not supported",
        [] => "empty",
        _ => "neither PNG nor JPEG",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    /// A PNG whose header claims a size; `crc` of IHDR is right, so that only the size is wrong.
    fn bomb(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = png(&DynamicImage::new_rgba8(1, 1));
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        bytes
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(
                crc ^ u32::from(byte),
                |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 },
            )
        })
    }

    #[test]
    fn codes_are_nearest_and_never_wrap() {
        let units = [0.0, 0.5, 1.0, 254.4 / 255.0, -3.0, 7.0, f64::NAN, f64::INFINITY];
        assert_eq!(units.map(code), [0, 128, 255, 254, 0, 255, 0, 255]);
    }

    #[test]
    fn every_kind_becomes_rgba() {
        let mut reader = TexelReader::new();
        let gray = DynamicImage::ImageLuma8(image::GrayImage::from_raw(2, 1, vec![0, 200]).unwrap());
        assert_eq!(*reader.decode("gray", &png(&gray)).unwrap().rgba, [0, 0, 0, 255, 200, 200, 200, 255]);
        let deep = DynamicImage::ImageRgba16(
            image::ImageBuffer::from_raw(1, 1, vec![65535, 0, 32896, 257]).unwrap(),
        );
        assert_eq!(*reader.decode("deep", &png(&deep)).unwrap().rgba, [255, 0, 128, 1]);
    }

    #[test]
    fn refuses_bombs_and_strangers() {
        let mut reader = TexelReader::new();
        for (bytes, why) in [
            (bomb(60_000, 60_000), "more than the 16384 texels a side"),
            (bomb(16_000, 16_000), "16000 x 16000 texels"),
            (bomb(4000, 4000), "cannot be decoded"),
            (bomb(0, 1), "cannot be decoded"),
            (b"\xABKTX 20\xBB\r\n\x1a\n".to_vec(), "KTX2"),
            (b"RIFF\0\0\0\0WEBPVP8 ".to_vec(), "WebP"),
            (b"GIF89a".to_vec(), "neither PNG nor JPEG"),
            (Vec::new(), "empty"),
            // The decoder's own words for it end with a new line.
            (
                b"\xff\xd8\xff\xe0\x00\x10JFIF\x00\x01\x01\x00\x00\x01\x00\x01\x00\x00\xff\xdb".to_vec(),
                "cannot be decoded",
            ),
            (png(&DynamicImage::new_rgba8(4, 4))[..40].to_vec(), "cannot be decoded"),
        ] {
            let error = reader.decode("x", &bytes).unwrap_err();
            assert!(error.contains(why) && !error.contains(char::is_control), "{error:?}");
        }
        reader.texels_left = 3;
        assert!(
            reader
                .decode("x", &png(&DynamicImage::new_rgba8(2, 2)))
                .unwrap_err()
                .contains("limit of a scene")
        );
    }
}
