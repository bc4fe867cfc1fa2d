//! Pictures from files and frames.

use super::{CompareError, Kind, Picture};
use crate::image::{FrameBuffer, PixelFormat};
use crate::input;
use std::io::{BufReader, Cursor, Read};
use std::path::Path;
use tessera_wire::limits;

/// Longest file that is read: the largest image in the largest pixel format, 36 bytes each, and a little for its tables.
const FILE_BYTES_MAX: u64 = limits::PIXELS * 40;
/// The channel of triangles, as [`FrameBuffer::write`] names it.
const TRIANGLES: &str = "id.triangle";
/// Most channels of an EXR file: several times what renderers write. Decoding needs memory for all channels of some rows at once.
const CHANNELS_MAX: usize = 256;

impl Picture {
    /// Reads a PNG or EXR file; the content decides, not the name. Of an EXR file's layers the first counts that has red, green and blue.
    ///
    /// # Errors
    /// [`CompareError::Image`]: the file cannot be read, is no such picture, is larger than what can be rendered, or holds a value that is
    /// not a finite number.
    pub fn load(path: &Path) -> Result<Self, CompareError> {
        load(path)
    }

    /// What `frame` holds. A frame that is not finite is refused when it is compared.
    pub fn from_frame(frame: &FrameBuffer) -> Self {
        let pixels = frame.data().chunks_exact(frame.format().bytes_per_pixel());
        let word = |pixel: &[u8], at: usize| [pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]];
        let value = |pixel: &[u8], channel: usize| match frame.format() {
            PixelFormat::Rgba8 => pixel[channel].into(),
            PixelFormat::Rgba16 => u16::from_le_bytes([pixel[2 * channel], pixel[2 * channel + 1]]).into(),
            PixelFormat::Layers => f32::from_le_bytes(word(pixel, 4 * channel)),
        };
        let (kind, ids) = match frame.format() {
            PixelFormat::Rgba8 => (Kind::Codes8, None),
            PixelFormat::Rgba16 => (Kind::Codes16, None),
            PixelFormat::Layers => {
                let ids = pixels.clone().map(|pixel| u32::from_le_bytes(word(pixel, 32)));
                (Kind::Linear, Some(ids.collect()))
            }
        };
        let channels =
            std::array::from_fn(|channel| pixels.clone().map(|pixel| value(pixel, channel)).collect());
        Self { width: frame.width(), height: frame.height(), kind, channels, ids }
    }
}

fn load(path: &Path) -> Result<Picture, CompareError> {
    let fail = |what: String| CompareError::Image { path: path.to_owned(), what };
    let bytes = content(path).map_err(fail)?;
    let image = match bytes.get(..4) {
        Some([0x76, 0x2f, 0x31, 0x01]) => load_exr(&bytes),
        Some([0x89, b'P', b'N', b'G']) => load_png(&bytes),
        _ => Err("is neither a PNG nor an EXR file; compare files that `tessera render` writes".into()),
    }
    .map_err(fail)?;
    image.check().map_err(fail)?;
    Ok(image)
}

fn content(path: &Path) -> Result<Vec<u8>, String> {
    let (file, length) = input::open(path, FILE_BYTES_MAX)?;
    let mut bytes = Vec::new();
    let unreadable = |e: std::io::Error| format!("cannot be read: {e}");
    file.take(length).read_to_end(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

fn check_size(width: u64, height: u64) -> Result<(u32, u32), String> {
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(w @ 1..=limits::SIDE), Ok(h @ 1..=limits::SIDE)) if width * height <= limits::PIXELS => {
            Ok((w, h))
        }
        _ => Err(format!(
            "is {width}x{height} pixels large; at most {} a side and {} in all are compared",
            limits::SIDE,
            limits::PIXELS
        )),
    }
}

fn load_png(bytes: &[u8]) -> Result<Picture, String> {
    use image::ImageDecoder;
    let bad = |e: image::ImageError| format!("is not a readable PNG: {e}");
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(limits::SIDE);
    limits.max_image_height = Some(limits::SIDE);
    limits.max_alloc = Some(limits::PIXELS * 8);
    let decoder = image::codecs::png::PngDecoder::with_limits(BufReader::new(Cursor::new(bytes)), limits)
        .map_err(bad)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    let sixteen = decoder.color_type().bytes_per_pixel() / decoder.color_type().channel_count() == 2;
    let decoded = image::DynamicImage::from_decoder(decoder).map_err(bad)?;
    let (kind, channels) = if sixteen {
        let pixels = decoded.into_rgb16();
        (Kind::Codes16, std::array::from_fn(|c| pixels.pixels().map(|p| f32::from(p.0[c])).collect()))
    } else {
        let pixels = decoded.into_rgb8();
        (Kind::Codes8, std::array::from_fn(|c| pixels.pixels().map(|p| f32::from(p.0[c])).collect()))
    };
    Ok(Picture { width, height, kind, channels, ids: None })
}

fn load_exr(bytes: &[u8]) -> Result<Picture, String> {
    use exr::{meta::header::Header, prelude::*};
    let bad = |e: Error| format!("is not a readable EXR: {e}");
    // Sizes are checked in the headers, before anything is reserved for the pixels.
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    for header in &meta.headers {
        check_size(header.layer_size.0 as u64, header.layer_size.1 as u64)?;
        let channels = header.channels.list.len();
        if channels > CHANNELS_MAX {
            return Err(format!("has {channels} channels; at most {CHANNELS_MAX} are taken"));
        }
    }
    let has = |header: &Header, name: &str| header.channels.list.iter().any(|c| c.name.eq(name));
    // The layer that the reader below takes: the first that has what it asks for.
    let is_rgb = |header: &&Header| !header.deep && ["R", "G", "B"].iter().all(|name| has(header, name));
    let Some(header) = meta.headers.iter().find(is_rgb) else {
        return Err("has no layer with the channels R, G and B, which are compared".into());
    };
    if header.channels.list.iter().any(|c| c.sampling != Vec2(1, 1)) {
        return Err("holds a channel at a lower resolution, which is not supported".into());
    }
    let is_id = |c: &ChannelDescription| c.name.eq(TRIANGLES) && c.sample_type == SampleType::U32;
    let has_ids = header.channels.list.iter().any(is_id);
    let empty = |size: Vec2<usize>, _: &_| Pixels {
        width: size.width(),
        channels: [(); 3].map(|()| vec![0.0_f32; size.area()]),
        ids: has_ids.then(|| vec![0_u32; size.area()]),
    };
    let set = |pixels: &mut Pixels, at: Vec2<usize>, (r, g, b, id): (f32, f32, f32, u32)| {
        let at = at.y() * pixels.width + at.x();
        for (channel, value) in pixels.channels.iter_mut().zip([r, g, b]) {
            channel[at] = value;
        }
        if let Some(ids) = &mut pixels.ids {
            ids[at] = id;
        }
    };
    let file = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required("R")
        .required("G")
        .required("B")
        .optional(TRIANGLES, 0_u32)
        .collect_pixels(empty, set)
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    let layer = file.layer_data;
    let (width, height) = check_size(layer.size.0 as u64, layer.size.1 as u64)?;
    let Pixels { channels, ids, .. } = layer.channel_data.pixels;
    Ok(Picture { width, height, kind: Kind::Linear, channels, ids })
}

/// What is read of an EXR file.
struct Pixels {
    width: usize,
    channels: [Vec<f32>; 3],
    ids: Option<Vec<u32>>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::{Comparison, compare};
    use crate::output::OutputFile;

    #[test]
    fn what_we_write_we_read() {
        let folder = tempfile::tempdir().unwrap();
        let save = |name: &str, format: PixelFormat, pixel: &[u8]| {
            let mut image = FrameBuffer::new(2, 1, format).unwrap();
            image.put(1, 0, 1, 1, pixel).unwrap();
            let path = folder.path().join(name);
            image.write(&OutputFile::check(&path).unwrap()).unwrap();
            path
        };
        let png = save("8.png", PixelFormat::Rgba8, &[1, 2, 3, 4]);
        assert_eq!(load(&png).unwrap().channels, [vec![0.0, 1.0], vec![0.0, 2.0], vec![0.0, 3.0]]);
        let deep = save("16.png", PixelFormat::Rgba16, &[0, 1, 2, 0, 3, 0, 255, 255]);
        assert_eq!(load(&deep).unwrap().channels, [vec![0.0, 256.0], vec![0.0, 2.0], vec![0.0, 3.0]]);
        let mut words = [0_u8; 36];
        for (i, value) in [0.5_f32, 2.0, 0.25].into_iter().enumerate() {
            words[i * 4..i * 4 + 4].copy_from_slice(&value.to_le_bytes());
        }
        words[16..20].copy_from_slice(&f32::INFINITY.to_le_bytes());
        let exr = save("a.exr", PixelFormat::Layers, &words);
        assert_eq!(load(&exr).unwrap().channels, [vec![0.0, 0.5], vec![0.0, 2.0], vec![0.0, 0.25]]);

        let compare_files =
            |a: &Path, b: &Path| -> Result<Comparison, CompareError> { compare(&load(a)?, &load(b)?) };
        let fails = |a: &Path, b: &Path, says: &str| {
            let error = compare_files(a, b).unwrap_err().to_string();
            assert!(error.contains(says) && error.lines().count() == 1, "{error}");
        };
        fails(&png, &exr, "differ in kind: 8-bit codes and linear EXR");
        fails(&png, &deep, "differ in kind: 8-bit codes and 16-bit codes");
        fails(&png, &folder.path().join("none.png"), "cannot be read");
        words[0..4].copy_from_slice(&f32::NAN.to_le_bytes());
        fails(&exr, &save("nan.exr", PixelFormat::Layers, &words), "column 1, row 0 that is not a finite");
        let text = folder.path().join("text.png");
        std::fs::write(&text, "hello").unwrap();
        fails(&text, &png, "neither a PNG nor an EXR");
        for (name, whole) in [("cut.png", &png), ("cut.exr", &exr)] {
            let bytes = std::fs::read(whole).unwrap();
            let cut = folder.path().join(name);
            std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
            fails(&cut, whole, "is not a readable");
        }
    }

    #[test]
    fn a_frame_is_the_picture_that_its_file_holds() {
        let folder = tempfile::tempdir().unwrap();
        for (format, name) in
            [(PixelFormat::Rgba8, "8.png"), (PixelFormat::Rgba16, "16.png"), (PixelFormat::Layers, "a.exr")]
        {
            let bytes = 7 * 5 * format.bytes_per_pixel();
            // Patterns of bits that are finite numbers, and other ones than zero.
            let data = (0..bytes).map(|i| if i % 4 == 3 { 63 } else { (i * 37 % 251) as u8 }).collect();
            let frame = FrameBuffer::from_rows(7, 5, format, data).unwrap();
            let path = folder.path().join(name);
            frame.write(&OutputFile::check(&path).unwrap()).unwrap();
            let picture = Picture::load(&path).unwrap();
            assert_eq!(picture, Picture::from_frame(&frame), "{name}");
            assert_eq!(picture.ids.is_some(), format == PixelFormat::Layers);
        }
    }

    #[test]
    fn an_exr_without_colours_or_with_too_many_channels_is_refused() {
        use exr::prelude::*;
        let file = |names: &[String]| {
            let channels =
                names.iter().map(|name| AnyChannel::new(name.as_str(), FlatSamples::F32(vec![0.5; 2])));
            let mut bytes = Cursor::new(Vec::new());
            let channels = AnyChannels::sort(channels.collect());
            Image::from_channels((2, 1), channels).write().to_buffered(&mut bytes).unwrap();
            bytes.into_inner()
        };
        let names = |count: usize| -> Vec<String> {
            ["R", "G", "B"].map(String::from).into_iter().chain((3..count).map(|i| format!("x{i}"))).collect()
        };
        assert_eq!(load_exr(&file(&names(CHANNELS_MAX))).unwrap().channels, [(); 3].map(|()| vec![0.5; 2]));
        let refused = |names: &[String], says: &str| {
            let error = load_exr(&file(names)).unwrap_err();
            assert!(error.contains(says), "{error}");
        };
        refused(&names(CHANNELS_MAX + 1), "257 channels");
        refused(&names(3)[..2], "no layer with the channels R, G and B");
    }

    #[test]
    fn what_is_not_a_plain_file_is_not_opened() {
        let folder = tempfile::tempdir().unwrap();
        assert!(load(folder.path()).unwrap_err().to_string().contains("is a folder"));
        #[cfg(unix)]
        assert!(load(Path::new("/dev/zero")).unwrap_err().to_string().contains("not a regular file"));
    }

    #[test]
    fn hostile_sizes_are_refused_in_the_header() {
        // A PNG whose header claims 2^31 - 1 columns and rows.
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        png.extend([0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 8, 2, 0, 0, 0]);
        assert!(load_png(&png).is_err());
        assert_eq!(check_size(65_536, 4096), Ok((65_536, 4096)), "what can be rendered can be compared");
        for (width, height) in [(0, 1), (65_537, 1), (1 << 32, 1), (65_536, 4097)] {
            assert!(check_size(width, height).is_err(), "{width} x {height}");
        }
    }
}
