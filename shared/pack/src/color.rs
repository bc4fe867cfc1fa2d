//! sRGB coding.

use std::sync::OnceLock;
use tessera_geometry::linear_from_srgb;

/// Linear values of the 256 codes of sRGB (IEC 61966-2-1), computed in `f64` and rounded once.
pub fn srgb8_to_linear_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|code| linear_from_srgb(code as f64 / 255.0) as f32))
}

#[cfg(test)]
mod tests {
    #[test]
    fn ends_are_exact_and_the_curve_rises() {
        let table = super::srgb8_to_linear_table();
        assert_eq!((table[0], table[255]), (0.0, 1.0));
        assert!(table.windows(2).all(|w| w[0] < w[1]));
        // The code next to middle grey: ((188/255 + 0.055) / 1.055)^2.4 = 0.50289.
        assert!((table[188] - 0.50289).abs() < 1e-5);
    }
}
