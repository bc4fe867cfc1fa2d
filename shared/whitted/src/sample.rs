//! Where the samples of a pixel lie.
//!
//! One sample goes through the pixel's centre. More are **correlated multi-jittered** (Kensler 2013, "Correlated
//! Multi-Jittered Sampling", Pixar technical memo 13-01, listing for any number of samples): `n` samples lie one to
//! each of `n` rows of equal height, and one to each cell of a grid of `floor(sqrt n)` columns (when it divides `n`;
//! otherwise at most one a cell). The shuffles and the jitter are integer hashes of (frame, pixel, sample), so that a
//! sample never depends on who computes it, or when.

use tessera_geometry::Vec2;

/// The hash that seeds all samples of the pixel `(x, y)` of `frame`.
pub(crate) fn pixel_seed(frame: u64, x: u32, y: u32) -> u32 {
    let seed = pcg(frame as u32 ^ pcg((frame >> 32) as u32));
    pcg(x ^ pcg(y ^ seed))
}

/// Sample `index` of `count` in the unit square of a pixel, `(0, 0)` at its upper left; both coordinates lie in [0,
/// 1].
pub(crate) fn offset_in_pixel(index: u32, count: u32, seed: u32) -> Vec2 {
    // Take the centre when there is only one.
    if count <= 1 {
        return Vec2::splat(0.5);
    }

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
    Vec2::new((sx as f32 + (sy as f32 + jx) / rows as f32) / columns as f32, (s as f32 + jy) / count as f32)
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
mod tests {
    use super::*;

    #[test]
    fn one_sample_is_the_centre() {
        for seed in [0, 1, u32::MAX] {
            assert_eq!(offset_in_pixel(0, 1, seed), Vec2::splat(0.5));
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
    fn samples_are_stratified_in_rows_and_cells() {
        for count in [2u32, 3, 4, 5, 9, 12, 16, 64, 100, 256] {
            for seed in (0..20).map(|i| pixel_seed(7, i, 3 * i)) {
                let at: Vec<Vec2> = (0..count).map(|i| offset_in_pixel(i, count, seed)).collect();
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

    #[test]
    fn frame_pixel_and_sample_all_matter() {
        let base = offset_in_pixel(3, 16, pixel_seed(1, 10, 20));
        assert_eq!(base, offset_in_pixel(3, 16, pixel_seed(1, 10, 20)));
        for other in [
            offset_in_pixel(4, 16, pixel_seed(1, 10, 20)),
            offset_in_pixel(3, 16, pixel_seed(2, 10, 20)),
            offset_in_pixel(3, 16, pixel_seed(1 << 32 | 1, 10, 20)),
            offset_in_pixel(3, 16, pixel_seed(1, 11, 20)),
            offset_in_pixel(3, 16, pixel_seed(1, 20, 10)),
        ] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn the_mean_of_many_samples_is_the_centre() {
        let mut sum = Vec2::ZERO;
        for x in 0..100 {
            for y in 0..100 {
                sum += offset_in_pixel(x % 5, 5, pixel_seed(0, x, y)) / 10_000.0;
            }
        }
        // Standard error of 10^4 uniform numbers: 0.29 / 100; five of them.
        assert!((sum - 0.5).abs().max_element() < 0.015, "{sum}");
    }
}
