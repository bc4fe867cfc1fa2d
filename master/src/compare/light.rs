//! What a picture's values mean: light, and how bright they look.

use super::Kind;
use tessera_geometry::{linear_from_srgb, srgb_from_linear};

/// Linear light of values of one kind.
pub(super) enum Decoder {
    /// Of each code.
    Codes(Vec<f64>),
    /// The values themselves.
    Linear,
}

impl Decoder {
    pub(super) fn new(kind: Kind) -> Self {
        match kind {
            Kind::Codes8 | Kind::Codes16 => {
                let peak = kind.peak();
                Self::Codes((0..=peak as usize).map(|code| linear_from_srgb(code as f64 / peak)).collect())
            }
            Kind::Linear => Self::Linear,
        }
    }

    /// Linear light, 1 is white; a value of a picture that has been checked.
    pub(super) fn linear(&self, value: f32) -> f64 {
        match self {
            Self::Codes(table) => table[value as usize],
            Self::Linear => value.into(),
        }
    }

    /// The sRGB-coded value in [0, 1], of light beyond [0, 1] that of its end. Codes are not rounded where none are given.
    pub(super) fn coded(&self, value: f32) -> f64 {
        match self {
            Self::Codes(table) => f64::from(value) / (table.len() - 1) as f64,
            Self::Linear => srgb_from_linear(f64::from(value).clamp(0.0, 1.0)),
        }
    }
}
