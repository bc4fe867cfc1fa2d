//! How tiles get to workers.

use crate::ReturnMode;
use bincode::{Decode, Encode};
use std::{fmt, str::FromStr};

/// How tiles get to workers. All four make the same image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Encode, Decode)]
pub enum Balance {
    /// Tile `t` to worker `t mod S`, row by row; each worker returns all its tiles at once (Seo, Park, Ihm
    /// 2022, Figure 5).
    PaperStatic,
    /// A deal without vertical or horizontal stripes, returned in batches while rendering goes on.
    Static,
    /// One tile at a time to whoever asks; the next is asked for while the last one travels (ibid., Figure
    /// 4).
    PaperDynamic,
    /// Pulled with a few tiles ahead of need, returned in batches.
    #[default]
    Dynamic,
}

impl Balance {
    /// Every balancing.
    pub const ALL: [Self; 4] = [Self::PaperStatic, Self::Static, Self::PaperDynamic, Self::Dynamic];

    /// Pixel bytes that make a batch worth its header and its wake-ups: four tiles of 128 x 128 in 8 bits.
    const BATCH_BYTES: u32 = 256 << 10;

    /// When workers return what they have rendered.
    pub const fn returns(self) -> ReturnMode {
        match self {
            Self::PaperStatic => ReturnMode::AtEnd,
            Self::PaperDynamic => ReturnMode::Batches { min_bytes: 0 },
            Self::Static | Self::Dynamic => ReturnMode::Batches { min_bytes: Self::BATCH_BYTES },
        }
    }

    /// The name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PaperStatic => "paper-static",
            Self::Static => "static",
            Self::PaperDynamic => "paper-dynamic",
            Self::Dynamic => "dynamic",
        }
    }
}

impl fmt::Display for Balance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Balance {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|b| b.name() == text).ok_or_else(|| {
            format!("no balancing `{text}`: use paper-static, static, paper-dynamic or dynamic")
        })
    }
}
