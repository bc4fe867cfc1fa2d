//! How tiles get to workers.

use crate::ReturnMode;
use bincode::{Decode, Encode};
use std::{fmt, str::FromStr};

/// How tiles get to workers. All make the same image.
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
    /// Pieces of equally many tiles of a Hilbert curve, one each, so that a worker's rays stay together; returned as with `Static`.
    Hilbert,
    /// Dealt so that all end at the same time, by what tiles have cost and how fast workers were in the frame before.
    Weighted,
    /// `Weighted` for a link that all share: workers end one after the other, each as the link becomes free for what it returns.
    Staggered,
    /// `Weighted`, and who has nothing left takes from the end of the list that would last longest.
    Steal,
    /// The one of the others that fits what was measured of links, workers and tiles, with its numbers tuned.
    Auto,
}

impl Balance {
    /// Every balancing.
    pub const ALL: [Self; 9] = [
        Self::PaperStatic,
        Self::Static,
        Self::Hilbert,
        Self::Weighted,
        Self::Staggered,
        Self::PaperDynamic,
        Self::Dynamic,
        Self::Steal,
        Self::Auto,
    ];

    /// Pixel bytes that make a batch worth its header and its wake-ups: four tiles of 128 x 128 in 8 bits.
    const BATCH_BYTES: u32 = 256 << 10;

    /// When workers return what they have rendered, unless more is known.
    pub const fn returns(self) -> ReturnMode {
        match self {
            Self::PaperStatic | Self::Staggered => ReturnMode::AtEnd,
            Self::PaperDynamic => ReturnMode::Batches { min_bytes: 0 },
            Self::Static | Self::Hilbert | Self::Weighted | Self::Dynamic | Self::Steal | Self::Auto => {
                ReturnMode::Batches { min_bytes: Self::BATCH_BYTES }
            }
        }
    }

    /// Whether tiles are handed out in advance, so that a worker that is slow is late with many.
    pub const fn is_dealt(self) -> bool {
        matches!(self, Self::PaperStatic | Self::Static | Self::Hilbert | Self::Weighted | Self::Staggered)
    }

    /// The name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PaperStatic => "paper-static",
            Self::Static => "static",
            Self::PaperDynamic => "paper-dynamic",
            Self::Dynamic => "dynamic",
            Self::Hilbert => "hilbert",
            Self::Weighted => "weighted",
            Self::Staggered => "staggered",
            Self::Steal => "steal",
            Self::Auto => "auto",
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
            let names = Self::ALL.map(Self::name).join(", ");
            format!("no balancing `{text}`: use one of {names}")
        })
    }
}
