//! Bounds on accumulated rounding error.

/// Half a unit in the last place of 1.0 in `f32`: the largest relative error of one rounded operation.
pub const UNIT_ROUNDOFF: f32 = f32::EPSILON * 0.5;

/// `n u / (1 - n u)`: the relative error of `n` consecutive rounded `f32` operations is at most this
/// (Higham 2002, lemma 3.1; used as in Pharr, Jakob, Humphreys, *Physically Based Rendering*, section 6.8).
pub const fn gamma(n: u32) -> f32 {
    let nu = n as f32 * UNIT_ROUNDOFF;
    nu / (1.0 - nu)
}
