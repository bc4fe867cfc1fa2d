//! LDR-FLIP: how visible a difference is to somebody who sees two pictures in turn at the same place.
//!
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild 2020, "FLIP: A Difference Evaluator for Alternating Images", with
//! separable filters as in the authors' program. Everything is `f64`, where theirs is `f32`; of two pictures it makes no difference which
//! is the reference.
//!
//! A row of the result takes a window of rows of both pictures, so that a picture of any height needs memory for one window alone.

use super::Picture;
use super::light::Decoder;
use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Pixels in a degree of the viewer's sight: a screen 0.7 m wide, of 3840 pixels, seen from 0.7 m. The authors' default, 67.02.
pub const PIXELS_PER_DEGREE: f64 = 3840.0 * (PI / 180.0);

/// Calls `take` with each row's errors, all in [0, 1], from the top. Both pictures have one size.
pub(super) fn rows(a: &Picture, b: &Picture, mut take: impl FnMut(&[f64])) {
    let filters = Filters::new(PIXELS_PER_DEGREE);
    let greatest = greatest_color_difference();
    let mut sides = [a, b].map(|picture| Side::new(picture, &filters));
    let mut errors = vec![0.0; a.width as usize];
    for y in 0..a.height as usize {
        for side in &mut sides {
            side.filter(y, &filters);
        }
        for (x, error) in errors.iter_mut().enumerate() {
            let [seen_a, seen_b] = [&sides[0], &sides[1]].map(|side| side.seen(x));
            let color = remapped(hyab(seen_a.lab, seen_b.lab), greatest);

            // The stronger of both features makes a difference of colour more visible. Their weights keep it below 1 but for rounding.
            let edge = (seen_a.edge - seen_b.edge).abs();
            let point = (seen_a.point - seen_b.point).abs();
            let feature = (FRAC_1_SQRT_2 * edge.max(point)).sqrt().min(1.0);
            *error = libm::pow(color, 1.0 - feature);
        }
        take(&errors);
    }
}

/// Weights along one axis, all of one length.
struct Filters {
    /// Reach to either side.
    radius: usize,
    /// What the eye resolves of luminance, red-green and, as two parts to be added, blue-yellow.
    color: [Vec<f64>; 4],
    /// A Gaussian as wide as the eye's detectors, and its first and second derivative.
    feature: [Vec<f64>; 3],
}

impl Filters {
    fn new(pixels_per_degree: f64) -> Self {
        // Three standard deviations of the widest Gaussian, blue-yellow; the features' are 0.123 pixels a degree, within that.
        let widest = (0.04 / (2.0 * PI * PI)).sqrt();
        let radius = (3.0 * widest * pixels_per_degree).ceil() as usize;
        let taps = |weight: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..=2 * radius).map(|i| weight(i as f64 - radius as f64)).collect()
        };

        // The sensitivity to contrast of each opponent colour, as Gaussians in space. Blue-yellow is a sum of two, which is no product of
        // an x and a y; each of the two is, with the square root of its factor along either axis, and what is common is scaled so that
        // the sum's weight is 1.
        let gaussian = |scale: f64, b: f64| {
            let degrees = 1.0 / pixels_per_degree;
            taps(&|x| scale * libm::exp(-PI * PI * (x * degrees) * (x * degrees) / b))
        };
        let factor = |a: f64, b: f64| (a * (PI / b).sqrt()).sqrt();
        let sum = |weights: &[f64]| weights.iter().sum::<f64>();
        let unit = |weights: Vec<f64>| {
            let total = sum(&weights);
            weights.into_iter().map(|w| w / total).collect()
        };
        let blue = [gaussian(factor(34.1, 0.04), 0.04), gaussian(factor(13.5, 0.025), 0.025)];
        let total = libm::hypot(sum(&blue[0]), sum(&blue[1]));
        let [blue_wide, blue_narrow] =
            blue.map(|weights| weights.into_iter().map(|w| w / total).collect::<Vec<_>>());
        let color = [unit(gaussian(1.0, 0.0047)), unit(gaussian(1.0, 0.0053)), blue_wide, blue_narrow];

        // Detectors are 0.082 degrees wide and end at three standard deviations. The positive weights of a derivative sum to 1 and the
        // negative ones to -1.
        let deviation = 0.5 * 0.082 * pixels_per_degree;
        let end = (3.0 * deviation).ceil();
        let bell =
            |x: f64| if x.abs() <= end { libm::exp(-x * x / (2.0 * deviation * deviation)) } else { 0.0 };
        let balanced = |weights: Vec<f64>| -> Vec<f64> {
            let positive: f64 = weights.iter().filter(|w| **w > 0.0).sum();
            let negative: f64 = -weights.iter().filter(|w| **w < 0.0).sum::<f64>();
            weights.into_iter().map(|w| if w > 0.0 { w / positive } else { w / negative }).collect()
        };
        let slope = balanced(taps(&|x| -x * bell(x)));
        let bend = balanced(taps(&|x| (x * x / (deviation * deviation) - 1.0) * bell(x)));
        Self { radius, color, feature: [unit(taps(&bell)), slope, bend] }
    }
}

/// One picture on its way through the filters.
struct Side<'a> {
    picture: &'a Picture,
    decoder: Decoder,
    /// Rows of the picture that are in `window`.
    ready: usize,
    /// The last rows, filtered along x: four of colour, three of features. Row y lies at y modulo their number.
    window: Vec<[Vec<f64>; 7]>,
    /// A row of Y, Cx, Cz and Y in [0, 1], its ends repeated as far as the filters reach.
    padded: [Vec<f64>; 4],
    /// A row filtered along both axes: luminance, red-green, blue-yellow, first derivatives by x and y, second derivatives.
    filtered: [Vec<f64>; 7],
}

/// A filtered pixel.
struct Seen {
    /// L*a*b* with Hunt's adjustment.
    lab: [f64; 3],
    /// Length of the first derivative.
    edge: f64,
    /// Length of the second.
    point: f64,
}

impl<'a> Side<'a> {
    fn new(picture: &'a Picture, filters: &Filters) -> Self {
        let width = picture.width as usize;
        let row = |length: usize| vec![0.0; length];
        Self {
            picture,
            decoder: Decoder::new(picture.kind),
            ready: 0,
            window: (0..=2 * filters.radius).map(|_| std::array::from_fn(|_| row(width))).collect(),
            padded: std::array::from_fn(|_| row(width + 2 * filters.radius)),
            filtered: std::array::from_fn(|_| row(width)),
        }
    }

    /// Filters row `y`; rows come in order.
    fn filter(&mut self, y: usize, filters: &Filters) {
        let last = self.picture.height as usize - 1;
        while self.ready <= (y + filters.radius).min(last) {
            self.filter_along_x(filters);
        }
        let [luminance, red_green, blue_wide, blue_narrow] = &filters.color;
        let [bell, slope, bend] = &filters.feature;
        // Where each result comes from: a row of the window, and what runs down its column.
        let passes = [
            (0, 0, luminance),
            (1, 1, red_green),
            (2, 2, blue_wide),
            (2, 3, blue_narrow),
            (3, 5, bell),
            (4, 4, slope),
            (5, 6, bell),
            (6, 4, bend),
        ];
        self.filtered.iter_mut().for_each(|row| row.fill(0.0));
        for (to, from, weights) in passes {
            for (offset, &weight) in weights.iter().enumerate() {
                let row = (y + offset).saturating_sub(filters.radius).min(last) % self.window.len();
                add(&mut self.filtered[to], &self.window[row][from], weight);
            }
        }
    }

    fn filter_along_x(&mut self, filters: &Filters) {
        let (width, radius) = (self.picture.width as usize, filters.radius);
        let start = self.ready * width;
        for x in 0..width {
            let linear =
                self.picture.channels.each_ref().map(|c| self.decoder.linear(c[start + x]).clamp(0.0, 1.0));
            let [y, cx, cz] = ycxcz_from_linear(linear);
            for (row, value) in self.padded.iter_mut().zip([y, cx, cz, (y + 16.0) / 116.0]) {
                row[radius + x] = value;
            }
        }
        for row in &mut self.padded {
            let (first, last) = (row[radius], row[radius + width - 1]);
            row[..radius].fill(first);
            row[radius + width..].fill(last);
        }
        let slot = self.ready % self.window.len();
        let weights = filters.color.iter().chain(&filters.feature);
        for ((to, from), weights) in self.window[slot].iter_mut().zip([0, 1, 2, 2, 3, 3, 3]).zip(weights) {
            to.fill(0.0);
            for (offset, &weight) in weights.iter().enumerate() {
                add(to, &self.padded[from][offset..offset + width], weight);
            }
        }
        self.ready += 1;
    }

    fn seen(&self, x: usize) -> Seen {
        let [y, cx, cz, dx, dy, ddx, ddy] = self.filtered.each_ref().map(|row| row[x]);
        let linear = linear_from_ycxcz([y, cx, cz]).map(|value| value.clamp(0.0, 1.0));
        let length = |x: f64, y: f64| (x * x + y * y).sqrt();
        Seen { lab: hunt(lab_from_linear(linear)), edge: length(dx, dy), point: length(ddx, ddy) }
    }
}

/// `to += from * weight`.
fn add(to: &mut [f64], from: &[f64], weight: f64) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from * weight;
    }
}

/// XYZ of linear sRGB, by the primaries and the white of IEC 61966-2-1 as ratios of whole numbers.
const XYZ_FROM_LINEAR: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

/// Its inverse, to 9 decimals.
const LINEAR_FROM_XYZ: [[f64; 3]; 3] = [
    [3.241_003_275, -1.537_398_934, -0.498_615_861],
    [-0.969_224_334, 1.875_930_071, 0.041_554_224],
    [0.055_639_423, -0.204_011_202, 1.057_148_933],
];

fn times(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// XYZ of white: the sums of the rows.
const WHITE: [f64; 3] = [sum(XYZ_FROM_LINEAR[0]), sum(XYZ_FROM_LINEAR[1]), sum(XYZ_FROM_LINEAR[2])];

const fn sum([a, b, c]: [f64; 3]) -> f64 {
    a + b + c
}

/// XYZ, white being 1, 1, 1.
fn relative_xyz(linear: [f64; 3]) -> [f64; 3] {
    let xyz = times(&XYZ_FROM_LINEAR, linear);
    std::array::from_fn(|i| xyz[i] / WHITE[i])
}

/// A space of opponent colours that is linear in light, for the filters.
fn ycxcz_from_linear(linear: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = relative_xyz(linear);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn linear_from_ycxcz([luminance, cx, cz]: [f64; 3]) -> [f64; 3] {
    let y = (luminance + 16.0) / 116.0;
    let relative = [y + cx / 500.0, y, y - cz / 200.0];
    times(&LINEAR_FROM_XYZ, std::array::from_fn(|i| relative[i] * WHITE[i]))
}

/// CIE 1976 L*a*b*.
fn lab_from_linear(linear: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let [x, y, z] = relative_xyz(linear).map(|t| {
        if t > DELTA * DELTA * DELTA { libm::cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Colours look paler in the dark (Hunt 1952).
fn hunt([l, a, b]: [f64; 3]) -> [f64; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// The HyAB distance, for large differences of colour (Abasi, Amani Tehran, Fairchild 2020).
fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [l, red_green, blue_yellow]: [f64; 3] = std::array::from_fn(|i| a[i] - b[i]);
    l.abs() + (red_green * red_green + blue_yellow * blue_yellow).sqrt()
}

/// Exponent of a colour difference.
const COLOR_EXPONENT: f64 = 0.7;

/// The greatest difference of two colours: green and blue, to the exponent.
fn greatest_color_difference() -> f64 {
    let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|linear| hunt(lab_from_linear(linear)));
    libm::pow(hyab(green, blue), COLOR_EXPONENT)
}

/// A colour difference in [0, 1]: the lowest 0.4 of the scale take 0.95 of it.
fn remapped(distance: f64, greatest: f64) -> f64 {
    let (difference, knee) = (libm::pow(distance, COLOR_EXPONENT), 0.4 * greatest);
    if difference < knee {
        0.95 / knee * difference
    } else {
        (0.95 + 0.05 * (difference - knee) / (greatest - knee)).min(1.0)
    }
}
