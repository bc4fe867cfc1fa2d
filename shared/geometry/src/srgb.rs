//! The curve of sRGB and its inverse, in `f64` with an error below 1e-14.

/// The linear value in [0, 1] of an sRGB-coded one in [0, 1] (IEC 61966-2-1).
pub fn linear_from_srgb(coded: f64) -> f64 {
    if coded <= 0.04045 { coded / 12.92 } else { libm::pow((coded + 0.055) / 1.055, 2.4) }
}

/// The sRGB-coded value in [0, 1] of a linear one in [0, 1] (IEC 61966-2-1).
pub fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 }
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

    #[test]
    fn the_way_back_leads_to_where_it_began() {
        for code in 0..=65_535 {
            let coded = f64::from(code) / 65_535.0;
            let back = srgb_from_linear(linear_from_srgb(coded));
            // The rounded constants let the pieces meet within 1e-7 only; elsewhere some roundings of 2^-53 remain.
            let bound = if (coded - 0.04045).abs() < 1e-5 { 1e-6 } else { 1e-14 };
            assert!((back - coded).abs() < bound, "{code}: {back}");
        }
    }
}
