//! Where the samples of a pixel lie.
//!
//! One sample goes through the pixel's centre. Of more, [`Sampler`] says where they lie. Shuffles, jitter and scrambling are integer
//! hashes of (frame, pixel, sample), so that a sample never depends on who computes it, or when.
//!
//! # Correlated multi-jittered
//!
//! Kensler 2013, "Correlated Multi-Jittered Sampling", Pixar technical memo 13-01, listing for any number of samples: `n` samples lie one
//! to each of `n` rows of equal height, and one to each cell of a grid of `floor(sqrt n)` columns (when it divides `n`; otherwise at most
//! one a cell). Sample `i` depends on `n`. The first samples of many are a random choice of the cells.
//!
//! # Low discrepancy
//!
//! Sobol's (0,2)-sequence in base 2 (Sobol 1967; Kollig and Keller 2002, "Efficient Multidimensional Sampling"), each dimension of each
//! pixel scrambled as Owen 1995 does by a hash (Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 9(4), after Laine and Karras
//! 2011; constants by Vegdahl 2021, "Building a Better LK Hash"). Of any `2^m` samples that begin at a multiple of `2^m`, one lies in
//! each rectangle of `2^-k` by `2^(k - m)`, `k` in `0..=m`. Sample `i` does not depend on the number of samples.
//!
//! # How fast the error falls
//!
//! Variance of the mean of `n` samples, where that of independent ones is `1 / n`:
//!
//! | in the pixel | multi-jittered | low discrepancy |
//! |---|---|---|
//! | an edge | `n^-3/2` (Mitchell 1996: it passes through `sqrt n` cells) | `n^-3/2` (the same, for the cells of a scrambled net) |
//! | smooth | `n^-3/2` | `n^-3 log n` (Owen 1997) |
//!
//! Multi-jittered samples of smooth functions owe their rate to being correlated: all samples of a row of the grid lie at the same height of
//! their columns' cells, so that their errors add up. With `g(y) = f(1, y) - f(0, y)`, `h` likewise along x, and errors of `sqrt n` rows and
//! as many columns, the variance is `n^-3/2 (Var g + Var h) / 12`. Of a sum of functions of x and of y alone it is `n^-3`.

use tessera_geometry::Vec2;
use tessera_geometry::mutation::{Mutation, is_on, unless};

/// Where the samples of a pixel lie; the head of this file has sources and rates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampler {
    /// Correlated multi-jittered (Kensler).
    #[default]
    Jittered,
    /// Sobol's sequence, scrambled as Owen does.
    LowDiscrepancy,
}

impl Sampler {
    /// Sample `index` of `count` in the unit square of a pixel, `(0, 0)` at its upper left; both coordinates lie in [0, 1].
    pub fn offset_in_pixel(self, index: u32, count: u32, seed: u32) -> Vec2 {
        // Take the centre when there is only one.
        match self {
            _ if count <= 1 => Vec2::splat(0.5),
            Self::Jittered => jittered(index, count, seed),
            Self::LowDiscrepancy => {
                let [x, y] = low_discrepancy(index, seed);
                Vec2::new(unit_float(x), unit_float(y))
            }
        }
    }
}

/// The hash that seeds all samples of the pixel `(x, y)` of `frame`.
pub fn pixel_seed(frame: u64, x: u32, y: u32) -> u32 {
    let seed = pcg(frame as u32 ^ pcg((frame >> 32) as u32));
    pcg(x ^ pcg(y ^ seed))
}

fn jittered(index: u32, count: u32, seed: u32) -> Vec2 {
    // Lay a grid of columns x rows over the pixel, as square as the count allows.
    let columns = (f64::from(count).sqrt() as u32).max(1);
    let rows = count.div_ceil(columns);

    // Shuffle the order of the samples, and the substrata across columns and rows.
    let s = permute(index, count, seed.wrapping_mul(0x5163_3e2d));
    let sx = permute(s % columns, columns, seed.wrapping_mul(0x68bc_21eb));
    let sy = permute(s / columns, rows, seed.wrapping_mul(0x02e5_be93));

    // Jitter inside the substratum.
    let jx = unit_float(pcg(s ^ seed.wrapping_mul(0x967a_889b)));
    let jy = unit_float(pcg(s ^ seed.wrapping_mul(0x368c_c8b7)));
    if is_on(Mutation::Unstratified) {
        return Vec2::new(jx, jy);
    }
    Vec2::new((sx as f32 + (sy as f32 + jx) / rows as f32) / columns as f32, (s as f32 + jy) / count as f32)
}

/// Sample `index` of the scrambled sequence, in units of 2^-32.
pub fn low_discrepancy(index: u32, seed: u32) -> [u32; 2] {
    let x = scramble(index, pcg(seed ^ 0x68bc_21eb));
    let second = unless(Mutation::SobolFlat, second_dimension(index), index);
    let y = scramble(second, pcg(seed ^ 0x02e5_be93));
    [x.reverse_bits(), y.reverse_bits()]
}

/// The bits of Sobol's second dimension, the highest last; those of the first are the index itself. Bit `j` is the parity of those bits `c`
/// of the index for which the binomial coefficient of `c` and `j` is odd: where `c` has all bits of `j` (Lucas). So bits are handed from
/// places that have a bit to those that do not, for each of the five bits of a place.
fn second_dimension(index: u32) -> u32 {
    let mut bits = index;
    bits ^= (bits >> 16) & 0x0000_ffff;
    bits ^= (bits >> 8) & 0x00ff_00ff;
    bits ^= (bits >> 4) & 0x0f0f_0f0f;
    bits ^= (bits >> 2) & 0x3333_3333;
    bits ^ (bits >> 1) & 0x5555_5555
}

/// Owen's scrambling of a number whose highest bit comes last: each bit is flipped, or not, by a hash of the bits before it.
fn scramble(bits: u32, seed: u32) -> u32 {
    let mut bits = bits;
    bits ^= bits.wrapping_mul(0x3d20_adea);
    bits = bits.wrapping_add(seed);
    bits = bits.wrapping_mul((seed >> 16) | 1);
    bits ^= bits.wrapping_mul(0x0552_6c56);
    bits ^ bits.wrapping_mul(0x53a2_2864)
}

/// PCG-RXS-M-XS-32, used as a hash (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering").
fn pcg(v: u32) -> u32 {
    let state = v.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// The top 24 bits as a number in [0, 1), exact in `f32`.
fn unit_float(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Where `index` goes in the permutation of `0..length` that `pattern` names: an invertible hash on the next power of
/// two, walked until it falls below `length`, then rotated (Kensler 2013; the listing's sum can wrap around 2^32 and
/// then is no permutation).
fn permute(index: u32, length: u32, pattern: u32) -> u32 {
    let mask = (u64::from(length).next_power_of_two() - 1) as u32;
    let mut i = index;
    loop {
        i ^= pattern;
        i = i.wrapping_mul(0xe170_893d);
        i ^= pattern >> 16;
        i ^= (i & mask) >> 4;
        i ^= pattern >> 8;
        i = i.wrapping_mul(0x0929_eb3f);
        i ^= pattern >> 23;
        i ^= (i & mask) >> 1;
        i = i.wrapping_mul(1 | (pattern >> 27));
        i = i.wrapping_mul(0x6935_fa69);
        i ^= (i & mask) >> 11;
        i = i.wrapping_mul(0x74dc_b303);
        i ^= (i & mask) >> 2;
        i = i.wrapping_mul(0x9e50_1cc3);
        i ^= (i & mask) >> 2;
        i = i.wrapping_mul(0xc860_a3df);
        i &= mask;
        i ^= i >> 5;
        if i < length {
            return ((u64::from(i) + u64::from(pattern)) % u64::from(length)) as u32;
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const SAMPLERS: [Sampler; 2] = [Sampler::Jittered, Sampler::LowDiscrepancy];

    #[test]
    fn one_sample_is_the_centre() {
        for (sampler, seed) in SAMPLERS.into_iter().flat_map(|s| [0, 1, u32::MAX].map(|seed| (s, seed))) {
            assert_eq!(sampler.offset_in_pixel(0, 1, seed), Vec2::splat(0.5));
        }
    }

    #[test]
    fn a_permutation_hits_everything_once() {
        for length in [1, 2, 3, 7, 8, 9, 64, 100, 257] {
            for pattern in [0, 1, 0x5163_3e2d, u32::MAX] {
                let mut seen: Vec<u32> = (0..length).map(|i| permute(i, length, pattern)).collect();
                seen.sort_unstable();
                assert!(seen.iter().copied().eq(0..length), "length {length}, pattern {pattern}");
            }
        }
    }

    #[test]
    fn jittered_samples_are_stratified_in_rows_and_cells() {
        for count in [2u32, 3, 4, 5, 9, 12, 16, 64, 100, 256] {
            for seed in (0..20).map(|i| pixel_seed(7, i, 3 * i)) {
                let at: Vec<Vec2> =
                    (0..count).map(|i| Sampler::Jittered.offset_in_pixel(i, count, seed)).collect();
                let columns = f64::from(count).sqrt() as u32;
                let rows = count.div_ceil(columns);
                let mut in_row = vec![0; count as usize];
                let mut in_cell = vec![0; (columns * rows) as usize];
                for p in &at {
                    assert!((0.0..=1.0).contains(&p.x) && (0.0..=1.0).contains(&p.y), "{p}");
                    let row = |n: u32| ((p.y * n as f32) as u32).min(n - 1);
                    let column = ((p.x * columns as f32) as u32).min(columns - 1);
                    in_row[row(count) as usize] += 1;
                    in_cell[(row(rows) * columns + column) as usize] += 1;
                }
                assert!(in_row.iter().all(|&n| n == 1), "{count} samples, rows {in_row:?}");
                if columns * rows == count {
                    assert!(in_cell.iter().all(|&n| n == 1), "{count} samples, cells {in_cell:?}");
                }
            }
        }
    }

    /// The second dimension by its direction numbers, as Kollig and Keller write it.
    fn sobol_2(index: u32) -> u32 {
        let (mut n, mut v, mut bits) = (index, 1u32 << 31, 0);
        while n != 0 {
            if n & 1 == 1 {
                bits ^= v;
            }
            n >>= 1;
            v ^= v >> 1;
        }
        bits
    }

    #[test]
    fn the_second_dimension_is_that_of_sobol() {
        for index in (0..5000).chain([1 << 16, 0x8000_0000, 0xDEAD_BEEF, u32::MAX]) {
            assert_eq!(second_dimension(index).reverse_bits(), sobol_2(index), "{index}");
        }
    }

    /// Owen's definition: numbers that agree in their first k bits do so after scrambling, and in no more.
    #[test]
    fn scrambling_keeps_common_first_bits() {
        for seed in (0..50).map(|i| pixel_seed(3, i, i)) {
            for (a, b) in
                (0..200u32).map(|i| (pcg(i), pcg(i ^ 0x5555))).chain([(0, 1), (6, 7), (0, u32::MAX)])
            {
                for common in 0..32 {
                    // The first bits lie lowest.
                    let b = (a ^ 1 << common) & ((2u32 << common).wrapping_sub(1))
                        | b & !(2u32 << common).wrapping_sub(1);
                    let apart = scramble(a, seed) ^ scramble(b, seed);
                    assert_eq!(apart.trailing_zeros(), common, "{a:x}, {b:x}");
                }
            }
        }
    }

    #[test]
    fn every_elementary_rectangle_has_its_sample() {
        for seed in (0..10).map(|i| pixel_seed(9, 5 * i, i)) {
            for (m, part) in (1..=10u32).flat_map(|m| [0, 1, 5].map(|part| (m, part))) {
                let points: Vec<[u32; 2]> =
                    (part << m..(part + 1) << m).map(|i| low_discrepancy(i, seed)).collect();
                for k in 0..=m {
                    let mut seen = vec![false; 1 << m];
                    for [x, y] in &points {
                        let column = u64::from(*x) >> (32 - k);
                        let row = u64::from(*y) >> (32 - (m - k));
                        let cell = &mut seen[(row << k | column) as usize];
                        assert!(!std::mem::replace(cell, true), "2^{m} samples from {part}, columns 2^{k}");
                    }
                }
            }
        }
    }

    #[test]
    fn low_discrepancy_samples_do_not_depend_on_their_number() {
        let at = |index, count| Sampler::LowDiscrepancy.offset_in_pixel(index, count, 77);
        for index in 0..16 {
            assert_eq!(at(index, 16), at(index, 1 << 16));
            assert!((0.0..1.0).contains(&at(index, 16).x));
        }
    }

    #[test]
    fn frame_pixel_and_sample_all_matter() {
        for sampler in SAMPLERS {
            let at = |index, frame, x, y| sampler.offset_in_pixel(index, 16, pixel_seed(frame, x, y));
            let base = at(3, 1, 10, 20);
            assert_eq!(base, at(3, 1, 10, 20));
            for other in [
                at(4, 1, 10, 20),
                at(3, 2, 10, 20),
                at(3, 1 << 32 | 1, 10, 20),
                at(3, 1, 11, 20),
                at(3, 1, 20, 10),
            ] {
                assert_ne!(base, other);
            }
        }
    }

    #[test]
    fn the_mean_of_many_samples_is_the_centre() {
        for sampler in SAMPLERS {
            let mut sum = Vec2::ZERO;
            for x in 0..100 {
                for y in 0..100 {
                    sum += sampler.offset_in_pixel(x % 5, 5, pixel_seed(0, x, y)) / 10_000.0;
                }
            }
            // Standard error of 10^4 uniform numbers: 0.29 / 100; five of them.
            assert!((sum - 0.5).abs().max_element() < 0.015, "{sampler:?}: {sum}");
        }
    }

    /// Variances of the mean of each of `counts` samples, over so many pixels.
    fn variances(
        sampler: Sampler,
        f: impl Fn(Vec2, u32) -> f64,
        truth: impl Fn(u32) -> f64,
        counts: &[u32],
        pixels: u32,
    ) -> Vec<f64> {
        let squared_error = |count: u32, pixel: u32| {
            let seed = pixel_seed(u64::from(count), pixel, 1);
            let sum: f64 = (0..count).map(|i| f(sampler.offset_in_pixel(i, count, seed), pixel)).sum();
            let error = sum / f64::from(count) - truth(pixel);
            error * error
        };
        let mean = |&count: &u32| {
            (0..pixels).map(|pixel| squared_error(count, pixel)).sum::<f64>() / f64::from(pixels)
        };
        counts.iter().map(mean).collect()
    }

    /// The slope of log variance over log count by least squares, and its standard error, where each variance comes from so many pixels:
    /// the logarithm of a mean of squares of normal numbers has the variance 2 / pixels.
    fn slope(counts: &[u32], variances: &[f64], pixels: u32) -> (f64, f64) {
        let x: Vec<f64> = counts.iter().map(|&n| libm::log(f64::from(n))).collect();
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        let spread: f64 = x.iter().map(|x| (x - mean) * (x - mean)).sum();
        let slope = x.iter().zip(variances).map(|(x, v)| (x - mean) * libm::log(*v)).sum::<f64>() / spread;
        (slope, (2.0 / f64::from(pixels) / spread).sqrt())
    }

    /// The share of a pixel on one side of a line through it, another one for each pixel: exact by clipping the square.
    pub(crate) fn edge(pixel: u32) -> (Vec2, f32) {
        let angle = f64::from(pcg(pixel)) / f64::from(u32::MAX) * std::f64::consts::TAU;
        let normal = Vec2::new(libm::cos(angle) as f32, libm::sin(angle) as f32);
        (normal, normal.dot(Vec2::splat(0.5)) + 0.3 * (unit_float(pcg(!pixel)) - 0.5))
    }

    pub(crate) fn inside((normal, offset): (Vec2, f32), p: Vec2) -> f64 {
        if normal.dot(p) < offset { 1.0 } else { 0.0 }
    }

    pub(crate) fn area((normal, offset): (Vec2, f32)) -> f64 {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let (n, offset) = ([f64::from(normal.x), f64::from(normal.y)], f64::from(offset));
        let depth = |p: [f64; 2]| offset - n[0] * p[0] - n[1] * p[1];
        let mut clipped: Vec<[f64; 2]> = Vec::new();
        for (a, b) in corners.into_iter().zip(corners.into_iter().cycle().skip(1)) {
            let (da, db) = (depth(a), depth(b));
            if da > 0.0 {
                clipped.push(a);
            }
            if (da > 0.0) != (db > 0.0) {
                let t = da / (da - db);
                clipped.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
            }
        }
        let next = clipped.iter().cycle().skip(1);
        0.5 * clipped.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>()
    }

    /// Says what was measured; the slope must agree with one in `low..=high` within three standard errors.
    fn judge(name: &str, counts: &[u32], variances: &[f64], pixels: u32, low: f64, high: f64) {
        let (slope, error) = slope(counts, variances, pixels);
        println!("{name}: variance ~ n^({slope:.3} +- {error:.3}), theory {low:.3} to {high:.3}");
        assert!(slope >= low - 3.0 * error && slope <= high + 3.0 * error, "{name}: {slope} +- {error}");
    }

    #[test]
    fn errors_fall_as_theory_says() {
        let counts = [64, 256, 1024, 4096];
        let pixels = 1000;
        let edges = |sampler| {
            variances(sampler, |p, pixel| inside(edge(pixel), p), |pixel| area(edge(pixel)), &counts, pixels)
        };
        let product = |p: Vec2, _: u32| f64::from(p.x) * f64::from(p.y);
        let smooth = |sampler| variances(sampler, product, |_| 0.25, &counts, pixels);
        for sampler in SAMPLERS {
            judge(&format!("{sampler:?}, an edge"), &counts, &edges(sampler), pixels, -1.5, -1.5);
        }
        // Exactly, for k columns and rows and g = y, h = x: two permutations of k offsets meet k heights, which is n^-3/2 / 72 but for a
        // factor of 1 + 1 / k.
        let exact = counts.map(|n| {
            let k = f64::from(n).sqrt();
            (k - 1.0) * (k + 1.0) * (k + 1.0) / (72.0 * k * k) / f64::from(n * n)
        });
        let jittered = smooth(Sampler::Jittered);
        judge("Jittered, x y", &counts, &jittered, pixels, slope(&counts, &exact, pixels).0, -1.5);
        for ((n, measured), exact) in counts.into_iter().zip(jittered).zip(exact) {
            // A mean of squares has a standard error of the root of 2 / pixels.
            let off = 3.0 * (2.0 / f64::from(pixels)).sqrt();
            let share = measured / exact;
            assert!((share - 1.0).abs() < off, "{n} samples: {share} of the variance that theory gives");
        }

        // n^-3 log n falls between n^-3 and n^-3 with the slope of log n where that is steepest, at the first count.
        let most = -3.0 + 1.0 / libm::log(f64::from(counts[0]));
        judge("LowDiscrepancy, x y", &counts, &smooth(Sampler::LowDiscrepancy), pixels, -3.0, most);
    }
}
