//! sRGB codes of linear light (IEC 61966-2-1), by the `libm` crate. The way back is `tessera_pack::color`'s table.

use tessera_geometry::mutation::{Mutation, unless};
use tessera_geometry::srgb_from_linear;

/// The code in `0..=max_code` nearest to `linear`, which is clamped to [0, 1] first; NaN becomes 0.
///
/// The curve is evaluated in `f64` with an error below 1e-14, so that a code is the nearest one unless the exact
/// value lies within 1e-9 of a code from the middle between two: the coding error is at most 0.5 + 1e-9 codes, for 8
/// and 16 bits.
pub(crate) fn encode_srgb(linear: f32, max_code: f64) -> u16 {
    encode_unit(srgb_from_linear(f64::from(linear.clamp(0.0, 1.0))), max_code)
}

/// The same without the curve, for alpha.
pub(crate) fn encode_linear(value: f32, max_code: f64) -> u16 {
    encode_unit(f64::from(value.clamp(0.0, 1.0)), max_code)
}

/// The cast takes NaN to 0.
fn encode_unit(value: f64, max_code: f64) -> u16 {
    (value * max_code + unless(Mutation::CodesTruncated, 0.5, 0.0)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_pack::color::srgb8_to_linear_table;

    fn linear_from_srgb(code: f64) -> f64 {
        if code <= 0.040_45 { code / 12.92 } else { libm::pow((code + 0.055) / 1.055, 2.4) }
    }

    #[test]
    fn every_byte_survives_the_way_to_linear_light_and_back() {
        for (code, &linear) in srgb8_to_linear_table().iter().enumerate() {
            assert_eq!(usize::from(encode_srgb(linear, 255.0)), code);
            assert_eq!(usize::from(encode_srgb(linear, 65535.0)), code * 257);
        }
    }

    #[test]
    fn a_code_is_the_nearest_one() {
        // Just beside the middle between two codes the lower and the upper one are chosen.
        for (bits, max_code) in [(8, 255.0), (16, 65535.0)] {
            for lower in (0..(1u32 << bits) - 1).step_by(1 << (bits - 8)) {
                let middle = linear_from_srgb((f64::from(lower) + 0.5) / max_code) as f32;
                let (below, above) = (middle * (1.0 - 1e-6), middle * (1.0 + 1e-6));
                assert_eq!(u32::from(encode_srgb(below, max_code)), lower);
                assert_eq!(u32::from(encode_srgb(above, max_code)), lower + 1);
            }
        }
    }

    #[test]
    fn what_is_out_of_range_is_clamped() {
        for (value, code) in [(f32::NAN, 0), (-1.0, 0), (f32::INFINITY, 255), (7.0, 255)] {
            assert_eq!(encode_srgb(value, 255.0), code);
            assert_eq!(encode_linear(value, 255.0), code);
        }
        assert_eq!(encode_linear(0.5, 65535.0), 32768);
    }
}
