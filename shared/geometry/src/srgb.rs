//! The curve of sRGB.

/// The linear value in [0, 1] of an sRGB-coded one in [0, 1] (IEC 61966-2-1).
pub fn linear_from_srgb(coded: f64) -> f64 {
    if coded <= 0.04045 { coded / 12.92 } else { libm::pow((coded + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_exact_and_the_pieces_meet() {
        assert_eq!((linear_from_srgb(0.0), linear_from_srgb(1.0)), (0.0, 1.0));
        // The standard's constants are rounded: its pieces meet within 1e-7.
        let step = linear_from_srgb(0.04045_f64.next_up()) - linear_from_srgb(0.04045);
        assert!(step.abs() < 1e-7, "{step}");
        assert!((linear_from_srgb(0.5) - 0.214_041_14).abs() < 1e-8);
    }
}
