//! Error metrics between two image files.
//!
//! Red, green and blue are compared, never alpha: 8-bit PNG as codes with peak 255, 16-bit PNG as codes with peak 65,535, EXR as linear
//! values with peak 1. All sums are `f64` over rows in order, so a figure does not depend on the machine or its threads.

use crate::input;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use tessera_wire::limits;

/// How two images differ.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// Mean squared difference of all red, green and blue values, in squared codes.
    pub mse: f64,
    /// `10 log10(peak^2 / mse)` in dB; none when the images are equal.
    pub psnr_db: Option<f64>,
    /// Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004), mean over the channels and over all 11 x 11 windows inside the
    /// image; none when a side is shorter than a window.
    pub ssim: Option<f64>,
    /// Largest difference of a red, green or blue value.
    pub max_abs: f64,
    /// Share of the pixels with a difference in red, green or blue, [0, 1].
    pub differing_share: f64,
    /// The largest code: 255, 65,535, or 1 for EXR.
    pub peak: f64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why two files cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// A file could not be read or is not an image that we know.
    #[error("{path}: {what}", path = path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
    /// The sizes differ.
    #[error("the images differ in size: {0}x{1} and {2}x{3} pixels; compare images of one size")]
    Size(u32, u32, u32, u32),
    /// The kinds of pixel differ.
    #[error("the images differ in kind: {0} and {1}; compare images of one kind")]
    Kind(&'static str, &'static str),
}

/// Reads and compares two files.
pub fn compare_files(a: &Path, b: &Path) -> Result<Comparison, CompareError> {
    compare(&load(a)?, &load(b)?)
}

/// Red, green and blue of an image.
#[derive(Clone, Debug, PartialEq)]
struct RgbImage {
    width: u32,
    height: u32,
    kind: Kind,
    /// `width * height` values a channel, rows from the top, all finite.
    channels: [Vec<f32>; 3],
}

/// What the values of an [`RgbImage`] are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Codes 0..=255.
    Codes8,
    /// Codes 0..=65,535.
    Codes16,
    /// Linear light, 1 is white.
    Linear,
}

impl Kind {
    const fn peak(self) -> f64 {
        match self {
            Self::Codes8 => 255.0,
            Self::Codes16 => 65_535.0,
            Self::Linear => 1.0,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Codes8 => "8-bit codes",
            Self::Codes16 => "16-bit codes",
            Self::Linear => "linear EXR",
        }
    }
}

/// Compares two images of one size and kind.
fn compare(a: &RgbImage, b: &RgbImage) -> Result<Comparison, CompareError> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(CompareError::Size(a.width, a.height, b.width, b.height));
    }
    if a.kind != b.kind {
        return Err(CompareError::Kind(a.kind.name(), b.kind.name()));
    }
    let pixels = a.channels[0].len();
    let (mut squares, mut max_abs, mut differing) = (0.0_f64, 0.0_f64, 0_u64);
    for i in 0..pixels {
        let mut differs = false;
        for (ca, cb) in a.channels.iter().zip(&b.channels) {
            let difference = f64::from(ca[i]) - f64::from(cb[i]);
            squares += difference * difference;
            max_abs = max_abs.max(difference.abs());
            differs |= difference != 0.0;
        }
        differing += u64::from(differs);
    }
    let peak = a.kind.peak();
    let mse = squares / (3 * pixels) as f64;
    Ok(Comparison {
        mse,
        psnr_db: (mse > 0.0).then(|| 10.0 * libm::log10(peak * peak / mse)),
        ssim: ssim(a, b, peak),
        max_abs,
        differing_share: differing as f64 / pixels as f64,
        peak,
        width: a.width,
        height: a.height,
    })
}

/// Side of an SSIM window.
const WINDOW: usize = 11;

/// Mean SSIM as in the authors' `ssim.m`: Gaussian weights of sigma 1.5 with sum 1, K1 = 0.01, K2 = 0.03, only windows that lie wholly
/// inside the image.
fn ssim(a: &RgbImage, b: &RgbImage, peak: f64) -> Option<f64> {
    let (width, height) = (a.width as usize, a.height as usize);
    if width < WINDOW || height < WINDOW {
        return None;
    }
    let weights = gaussian();
    let c1 = (0.01 * peak) * (0.01 * peak);
    let c2 = (0.03 * peak) * (0.03 * peak);
    let mut sum = 0.0;
    for (ca, cb) in a.channels.iter().zip(&b.channels) {
        // Weighted window means of a, b, a^2, b^2 and ab: first along the rows, then down the columns as the rows come.
        let columns = width - WINDOW + 1;
        let mut rows: Vec<Vec<[f64; 5]>> = Vec::with_capacity(WINDOW);
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            let means = blur_row(&ca[row.clone()], &cb[row], &weights);
            if rows.len() == WINDOW {
                rows.remove(0);
            }
            rows.push(means);
            if rows.len() < WINDOW {
                continue;
            }
            for x in 0..columns {
                let mut m = [0.0; 5];
                for (weight, row) in weights.iter().zip(&rows) {
                    for (total, value) in m.iter_mut().zip(row[x]) {
                        *total += weight * value;
                    }
                }
                let [ma, mb, maa, mbb, mab] = m;
                let (va, vb, cov) = (maa - ma * ma, mbb - mb * mb, mab - ma * mb);
                sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            }
        }
    }
    Some(sum / (3 * (width - WINDOW + 1) * (height - WINDOW + 1)) as f64)
}

fn blur_row(a: &[f32], b: &[f32], weights: &[f64; WINDOW]) -> Vec<[f64; 5]> {
    a.windows(WINDOW)
        .zip(b.windows(WINDOW))
        .map(|(a, b)| {
            let mut m = [0.0; 5];
            for ((&a, &b), weight) in a.iter().zip(b).zip(weights) {
                let (a, b) = (f64::from(a), f64::from(b));
                for (total, value) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                    *total += weight * value;
                }
            }
            m
        })
        .collect()
}

fn gaussian() -> [f64; WINDOW] {
    let raw: [f64; WINDOW] = std::array::from_fn(|i| {
        let x = i as f64 - (WINDOW / 2) as f64;
        libm::exp(-x * x / (2.0 * 1.5 * 1.5))
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// Longest file that is read: the largest image in the largest pixel format, 36 bytes each, and a little for its tables.
const FILE_BYTES_MAX: u64 = limits::PIXELS * 40;
/// Most channels of an EXR file: several times what renderers write. Decoding needs memory for all channels of some rows at once.
const CHANNELS_MAX: usize = 256;

/// Reads a PNG or EXR file; the content decides, not the name.
fn load(path: &Path) -> Result<RgbImage, CompareError> {
    let fail = |what: String| CompareError::Image { path: path.to_owned(), what };
    let bytes = content(path).map_err(fail)?;
    let image = match bytes.get(..4) {
        Some([0x76, 0x2f, 0x31, 0x01]) => load_exr(&bytes),
        Some([0x89, b'P', b'N', b'G']) => load_png(&bytes),
        _ => Err("is neither a PNG nor an EXR file; compare files that `tessera render` writes".into()),
    }
    .map_err(fail)?;
    let values = image.channels.iter().flat_map(|c| c.iter().enumerate());
    if let Some((at, _)) = values.clone().find(|(_, v)| !v.is_finite()) {
        let (x, y) = (at as u32 % image.width, at as u32 / image.width);
        return Err(fail(format!("holds a value at column {x}, row {y} that is not a finite number")));
    }
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

fn load_png(bytes: &[u8]) -> Result<RgbImage, String> {
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
    Ok(RgbImage { width, height, kind, channels })
}

fn load_exr(bytes: &[u8]) -> Result<RgbImage, String> {
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
    let empty = |size: Vec2<usize>, _: &_| (size.width(), [(); 3].map(|()| vec![0.0_f32; size.area()]));
    let set =
        |(width, channels): &mut (usize, [Vec<f32>; 3]), at: Vec2<usize>, (r, g, b): (f32, f32, f32)| {
            for (channel, value) in channels.iter_mut().zip([r, g, b]) {
                channel[at.y() * *width + at.x()] = value;
            }
        };
    let file = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required("R")
        .required("G")
        .required("B")
        .collect_pixels(empty, set)
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    let layer = file.layer_data;
    let (width, height) = check_size(layer.size.0 as u64, layer.size.1 as u64)?;
    let (_, channels) = layer.channel_data.pixels;
    Ok(RgbImage { width, height, kind: Kind::Linear, channels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{FrameBuffer, PixelFormat};
    use crate::output::OutputFile;

    fn codes(width: u32, height: u32, value: impl Fn(u32, u32, u32) -> i64) -> RgbImage {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let channels = std::array::from_fn(|c| {
            pixels.clone().map(|(x, y)| value(x, y, c as u32).clamp(0, 255) as f32).collect()
        });
        RgbImage { width, height, kind: Kind::Codes8, channels }
    }

    fn close(found: f64, expected: f64) {
        // The reference sums in another order: a few hundred roundings of 2^-53 each.
        assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found} is not {expected}");
    }

    #[test]
    fn known_answers() {
        // The expected figures are scikit-image's (0.26: mean_squared_error, peak_signal_noise_ratio and structural_similarity with
        // gaussian_weights, sigma 1.5, population covariance and data_range 255) for the same two pictures.
        let pattern = |x: u32, y: u32, c: u32| i64::from((x * 7 + y * 13 + c * 50) % 256);
        let a = codes(37, 29, pattern);
        let b = codes(37, 29, |x, y, c| pattern(x, y, c) + i64::from(c + 1) * (i64::from(x * y % 11) - 5));
        let found = compare(&a, &b).unwrap();
        close(found.mse, 53.331_469_400_434_92);
        close(found.psnr_db.unwrap(), 30.860_968_112_426_14);
        close(found.ssim.unwrap(), 0.970_822_660_618_393_4);
        assert_eq!(found.max_abs, 15.0);
        close(found.differing_share, 0.920_782_851_817_334_5);
    }

    #[test]
    fn equal_images_have_no_psnr_and_full_similarity() {
        let a = codes(16, 16, |x, y, _| i64::from(x * y));
        let found = compare(&a, &a).unwrap();
        assert_eq!((found.mse, found.psnr_db, found.max_abs, found.differing_share), (0.0, None, 0.0, 0.0));
        close(found.ssim.unwrap(), 1.0);
    }

    #[test]
    fn a_step_of_one_everywhere() {
        // PSNR of an error of one code: 20 log10 255.
        let a = codes(12, 4, |x, _, _| i64::from(x));
        let b = codes(12, 4, |x, _, _| i64::from(x) + 1);
        let found = compare(&a, &b).unwrap();
        close(found.psnr_db.unwrap(), 48.130_803_608_679_1);
        assert_eq!(found.ssim, None, "no window fits into four rows");
        assert_eq!((found.max_abs, found.differing_share), (1.0, 1.0));
    }

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
    fn sizes_must_agree() {
        let error = compare(&codes(3, 2, |_, _, _| 0), &codes(2, 3, |_, _, _| 0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the images differ in size: 3x2 and 2x3 pixels; compare images of one size"
        );
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
