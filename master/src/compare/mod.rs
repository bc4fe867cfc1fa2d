//! How far two pictures differ.
//!
//! Red, green and blue are compared, never alpha: 8-bit PNG as codes with peak 255, 16-bit PNG as codes with peak 65,535, EXR as linear
//! values with peak 1. All sums are `f64` over rows in order, so a figure does not depend on the machine or its threads.

mod flip;
mod light;
mod load;
mod map;
mod ssim;

pub use flip::PIXELS_PER_DEGREE;
pub use map::error_picture;

use light::Decoder;
use std::path::PathBuf;

/// Red, green and blue of an image, and what is seen in it.
///
/// [`Picture::load`] and [`Picture::from_frame`] make them. One made by hand is checked when it is compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns, >= 1.
    pub width: u32,
    /// Rows, >= 1.
    pub height: u32,
    /// What the values are.
    pub kind: Kind,
    /// Red, green and blue: `width * height` values each, rows from the top, all finite, codes whole and in range.
    pub channels: [Vec<f32>; 3],
    /// The triangle in each pixel's centre, where it is known: the layer `id.triangle` of an EXR file.
    pub ids: Option<Vec<u32>>,
}

/// What the values of a [`Picture`] are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// sRGB codes 0..=255.
    Codes8,
    /// sRGB codes 0..=65,535.
    Codes16,
    /// Linear light, 1 is white.
    Linear,
}

impl Kind {
    /// The value of white.
    pub const fn peak(self) -> f64 {
        match self {
            Self::Codes8 => 255.0,
            Self::Codes16 => 65_535.0,
            Self::Linear => 1.0,
        }
    }

    /// For messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Codes8 => "8-bit codes",
            Self::Codes16 => "16-bit codes",
            Self::Linear => "linear EXR",
        }
    }
}

/// How two images differ.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// Mean squared difference of all red, green and blue values, in squared codes, for EXR in squared linear light.
    pub mse: f64,
    /// Its root, in codes or linear light.
    pub rmse: f64,
    /// `10 log10(peak^2 / mse)` in dB; none when the images are equal.
    pub psnr_db: Option<f64>,
    /// PSNR of linear light, peak 1: of decoded codes, or of the values of EXR as they are, not clamped.
    pub psnr_linear_db: Option<f64>,
    /// PSNR of sRGB-coded light, peak 1: of codes as they are, or of the values of EXR clamped to [0, 1] and coded without rounding; none
    /// when nothing differs within [0, 1].
    pub psnr_srgb_db: Option<f64>,
    /// Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004) of the codes or linear values, mean over the channels and over all
    /// 11 x 11 windows inside the image; none when a side is shorter than a window.
    pub ssim: Option<f64>,
    /// Mean LDR-FLIP (Andersson et al. 2020) at [`PIXELS_PER_DEGREE`], [0, 1], 0 when nothing can be seen to differ; of EXR values clamped
    /// to [0, 1].
    pub flip: f64,
    /// Largest difference of a red, green or blue value, in codes or linear light.
    pub max_abs: f64,
    /// Share of the pixels with a difference in red, green or blue, [0, 1].
    pub differing_share: f64,
    /// Share of the pixels with another triangle in their centre, [0, 1]; none unless both images have triangles.
    pub wrong_id_share: Option<f64>,
    /// The largest code: 255, 65,535, or 1 for EXR.
    pub peak: f64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why two images cannot be compared.
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
    /// A picture that is none.
    #[error("a picture {0}")]
    Picture(String),
    /// The sizes differ.
    #[error("the images differ in size: {0}x{1} and {2}x{3} pixels; compare images of one size")]
    Size(u32, u32, u32, u32),
    /// The kinds of pixel differ.
    #[error("the images differ in kind: {0} and {1}; compare images of one kind")]
    Kind(&'static str, &'static str),
}

/// Compares two images of one size and kind: a CPU second at most for 1024 x 1024 pixels.
///
/// # Errors
/// [`CompareError::Picture`], [`CompareError::Size`], [`CompareError::Kind`].
pub fn compare(a: &Picture, b: &Picture) -> Result<Comparison, CompareError> {
    check_pair(a, b)?;
    let decoder = Decoder::new(a.kind);
    let pixels = a.channels[0].len();
    let (mut codes, mut linear, mut coded) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut max_abs, mut differing) = (0.0_f64, 0_u64);
    for i in 0..pixels {
        let mut differs = false;
        for (ca, cb) in a.channels.iter().zip(&b.channels) {
            let (va, vb) = (ca[i], cb[i]);
            if va == vb {
                continue;
            }
            let difference = f64::from(va) - f64::from(vb);
            codes += square(difference);
            linear += square(decoder.linear(va) - decoder.linear(vb));
            coded += square(decoder.coded(va) - decoder.coded(vb));
            max_abs = max_abs.max(difference.abs());
            differs = true;
        }
        differing += u64::from(differs);
    }
    let peak = a.kind.peak();
    let share = |count: u64| count as f64 / pixels as f64;
    let mean = |squares: f64| squares / (3 * pixels) as f64;
    let mse = mean(codes);
    let wrong_ids =
        a.ids.as_ref().zip(b.ids.as_ref()).map(|(a, b)| a.iter().zip(b).filter(|(a, b)| a != b).count());
    Ok(Comparison {
        mse,
        rmse: mse.sqrt(),
        psnr_db: psnr_db(mse, peak),
        psnr_linear_db: psnr_db(mean(linear), 1.0),
        psnr_srgb_db: psnr_db(mean(coded), 1.0),
        ssim: ssim::ssim(a, b, peak),
        flip: mean_flip(a, b),
        max_abs,
        differing_share: share(differing),
        wrong_id_share: wrong_ids.map(|count| share(count as u64)),
        peak,
        width: a.width,
        height: a.height,
    })
}

fn square(value: f64) -> f64 {
    value * value
}

fn psnr_db(mse: f64, peak: f64) -> Option<f64> {
    (mse > 0.0).then(|| 10.0 * libm::log10(peak * peak / mse))
}

fn mean_flip(a: &Picture, b: &Picture) -> f64 {
    let mut sum = 0.0;
    flip::rows(a, b, |errors| sum += errors.iter().sum::<f64>());
    sum / a.channels[0].len() as f64
}

/// Whether both are pictures, and alike enough to be compared.
fn check_pair(a: &Picture, b: &Picture) -> Result<(), CompareError> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(CompareError::Size(a.width, a.height, b.width, b.height));
    }
    if a.kind != b.kind {
        return Err(CompareError::Kind(a.kind.name(), b.kind.name()));
    }
    for picture in [a, b] {
        picture.check().map_err(CompareError::Picture)?;
    }
    Ok(())
}

impl Picture {
    /// Whether it is what its documentation says; what is wrong with it if not.
    fn check(&self) -> Result<(), String> {
        let pixels = self.width as usize * self.height as usize;
        let lengths = self.channels.iter().map(Vec::len).chain(self.ids.as_ref().map(Vec::len));
        if pixels == 0 || lengths.into_iter().any(|length| length != pixels) {
            return Err(format!("does not hold {}x{} pixels, one at least", self.width, self.height));
        }
        let is_value = |value: f32| match self.kind {
            Kind::Codes8 | Kind::Codes16 => {
                (0.0..=self.kind.peak()).contains(&f64::from(value)) && value.fract() == 0.0
            }
            Kind::Linear => value.is_finite(),
        };
        let values = self.channels.iter().flat_map(|c| c.iter().enumerate());
        let Some((at, _)) = values.into_iter().find(|(_, value)| !is_value(**value)) else { return Ok(()) };
        let (x, y) = (at as u32 % self.width, at as u32 / self.width);
        let what = if self.kind == Kind::Linear { "a finite number" } else { "a code" };
        Err(format!("holds a value at column {x}, row {y} that is not {what}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(width: u32, height: u32, value: impl Fn(u32, u32, u32) -> i64) -> Picture {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let channels = std::array::from_fn(|c| {
            pixels.clone().map(|(x, y)| value(x, y, c as u32).clamp(0, 255) as f32).collect()
        });
        Picture { width, height, kind: Kind::Codes8, channels, ids: None }
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
        close(found.rmse, libm::sqrt(53.331_469_400_434_92));
        close(found.psnr_srgb_db.unwrap(), 30.860_968_112_426_14);
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
    fn sizes_must_agree() {
        let error = compare(&codes(3, 2, |_, _, _| 0), &codes(2, 3, |_, _, _| 0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the images differ in size: 3x2 and 2x3 pixels; compare images of one size"
        );
    }

    /// 96 x 64 pixels, and the same pair as light.
    fn pair(a: impl Fn(i64, i64, i64) -> i64, b: impl Fn(i64, i64, i64) -> i64) -> [[Picture; 2]; 2] {
        let codes = [codes_of(96, 64, a), codes_of(96, 64, b)];
        let light = codes.clone().map(|mut picture| {
            let decoder = Decoder::new(picture.kind);
            picture.kind = Kind::Linear;
            picture.channels.iter_mut().flatten().for_each(|value| *value = decoder.linear(*value) as f32);
            picture
        });
        [codes, light]
    }

    fn codes_of(width: u32, height: u32, value: impl Fn(i64, i64, i64) -> i64) -> Picture {
        codes(width, height, |x, y, c| value(x.into(), y.into(), c.into()))
    }

    fn ramp(x: i64, y: i64, c: i64) -> i64 {
        (x * 7 + y * 13 + c * 50) % 256
    }

    fn bent_ramp(x: i64, y: i64, c: i64) -> i64 {
        ramp(x, y, c) + (c + 1) * (x * y % 11 - 5)
    }

    /// Greatest difference of two means of FLIP where one was rounded to `f32` on the way: derived in `tests/referee/flip.py`.
    const FLIP_BOUND: f64 = 1.1e-4;

    #[test]
    fn flip_is_that_of_its_authors() {
        // Means of the maps that flip-evaluator 1.7 makes, in f32 (`tests/referee/flip.py` repeats them), and of the same formulas in numpy
        // and f64.
        let squares =
            |shift: i64| move |x: i64, y: i64, c: i64| ((x + shift) / 8 + y / 8) % 2 * (255 - 60 * c);
        let smooth = |x: i64, y: i64, c: i64| 40 + (3 * x + 2 * y + 40 * c) / 4;
        let noise = move |x: i64, y: i64, c: i64| {
            smooth(x, y, c) + (x * x * 31 + y * y * 17 + x * y * 7 + c * 101) % 23 - 11
        };
        let primary = |of: i64| move |_, _, c: i64| if c == of { 255 } else { 0 };
        let cases = [
            ("ramps", pair(ramp, bent_ramp), 0.068_831_153_743_834_26, 0.068_831_136_207_140_2),
            ("squares", pair(squares(0), squares(1)), 0.331_328_031_130_402_66, 0.331_322_741_508_473_13),
            ("noise", pair(smooth, noise), 0.061_209_558_945_544_51, 0.061_209_552_768_428_1),
            ("primaries", pair(primary(1), primary(2)), 1.0, 0.999_999_999_446_043_7),
        ];
        for (name, [codes, light], theirs, expected) in cases {
            for [a, b] in [&codes, &light] {
                let found = compare(a, b).unwrap().flip;
                assert!((found - theirs).abs() < FLIP_BOUND, "{name}: {found} is not {theirs}");
                // Codes are exact, light has been rounded to f32. The bound of f64 follows as that of f32 does, from 2^-52.
                let bound = if a.kind == Kind::Linear { FLIP_BOUND } else { 5e-9 };
                assert!((found - expected).abs() < bound, "{name}: {found} is not {expected}");
                assert_eq!(compare(b, a).unwrap().flip, found, "{name}: neither is the reference");
            }
        }
        // Smaller than the filters.
        let (a, b) = (codes_of(5, 3, ramp), codes_of(5, 3, bent_ramp));
        let found = compare(&a, &b).unwrap().flip;
        assert!((found - 0.164_994_103_213_151_3).abs() < FLIP_BOUND, "{found}");
    }

    #[test]
    fn light_and_codes_have_a_psnr_each() {
        // numpy's figures for the first pair above.
        let [[a, b], [light_a, light_b]] = pair(ramp, bent_ramp);
        let found = compare(&a, &b).unwrap();
        close(found.psnr_linear_db.unwrap(), 29.499_219_646_584_983);
        close(found.psnr_srgb_db.unwrap(), 30.982_862_508_044_803);
        // The same from light: rounded to f32, which moves a difference of a code by 2^-24 of 255 codes at most.
        let light = compare(&light_a, &light_b).unwrap();
        assert!((light.psnr_linear_db.unwrap() - found.psnr_linear_db.unwrap()).abs() < 1e-4);
        assert!((light.psnr_srgb_db.unwrap() - found.psnr_srgb_db.unwrap()).abs() < 1e-4);
        assert_eq!(light.psnr_db, light.psnr_linear_db, "light is compared as light");
    }

    #[test]
    fn what_is_beyond_white_differs_in_light_alone() {
        let light = |value: f32| Picture {
            width: 11,
            height: 11,
            kind: Kind::Linear,
            channels: [(); 3].map(|()| vec![value; 121]),
            ids: None,
        };
        let found = compare(&light(3.0), &light(1.0)).unwrap();
        // 10 log10(1 / 4).
        close(found.psnr_linear_db.unwrap(), -6.020_599_913_279_624);
        assert_eq!((found.psnr_srgb_db, found.flip, found.max_abs), (None, 0.0, 2.0));
        let found = compare(&light(-1.0), &light(0.0)).unwrap();
        assert_eq!((found.psnr_srgb_db, found.flip, found.rmse), (None, 0.0, 1.0));
    }

    #[test]
    fn wrong_triangles_are_counted_where_both_know_theirs() {
        let with = |ids: Option<Vec<u32>>| Picture { ids, ..codes(4, 1, |_, _, _| 0) };
        let share = |a, b| compare(&with(a), &with(b)).unwrap().wrong_id_share;
        let ids = vec![0, 1, 2, u32::MAX];
        assert_eq!(share(Some(ids.clone()), Some(vec![0, 3, 2, 9])), Some(0.5));
        assert_eq!(share(Some(ids.clone()), Some(ids.clone())), Some(0.0));
        assert_eq!((share(Some(ids), None), share(None, None)), (None, None));
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        let good = codes(4, 2, |x, _, _| i64::from(x));
        let refused = |bad: Picture, says: &str| {
            for (a, b) in [(&good, &bad), (&bad, &good)] {
                let error = compare(a, b).unwrap_err().to_string();
                assert!(error.contains(says), "{error}");
                assert!(error_picture(a, b).is_err());
            }
        };
        let mut short = good.clone();
        short.channels[1].pop();
        refused(short, "does not hold 4x2 pixels");
        refused(Picture { ids: Some(vec![1; 7]), ..good.clone() }, "does not hold 4x2 pixels");
        for value in [f32::NAN, -1.0, 256.0, 0.5] {
            let mut bad = good.clone();
            bad.channels[2][5] = value;
            refused(bad, "column 1, row 1 that is not a code");
        }
        let none = Picture { width: 0, height: 0, channels: [vec![], vec![], vec![]], ..good.clone() };
        assert!(compare(&none, &none).is_err());
    }

    #[test]
    fn the_map_is_black_where_nothing_differs_and_bright_where_all_does() {
        // Left equal, right green against blue; in between reach the filters.
        let half = |of: u32| codes(64, 8, move |x, _, c| if c == of && x >= 32 { 255 } else { 0 });
        let map = error_picture(&half(1), &half(2)).unwrap();
        assert_eq!(map.len(), 64 * 8 * 3);
        for row in map.chunks_exact(64 * 3) {
            assert_eq!((&row[..3], &row[63 * 3..]), (&[0, 0, 4][..], &[252, 253, 191][..]));
        }
    }
}
