//! Tiles cut into pieces of bounded work. Pure.
//!
//! A submission that takes too long looks like a hang to the system, keeps others from the GPU and cannot be stopped. So a tile of many
//! samples is rendered in several passes: some rows at a time, and some samples of them at a time, whose sums are kept in between. How it
//! is cut changes no pixel: samples are added up in their order.
//!
//! Where paths are taken step by step the steps of a submission are bounded, and all samples of a row stay together.

use tessera_wire::Rect;

/// A piece of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    /// First row, counted from the tile's.
    pub(super) row: u32,
    /// Rows.
    pub(super) rows: u32,
    /// Samples to take now.
    pub(super) samples: (u32, u32),
}

/// What is left of a tile.
#[derive(Clone, Debug)]
pub(super) struct Cut {
    width: u32,
    height: u32,
    samples: u32,
    row: u32,
    /// Rows whose samples are being taken, and how many of them have been.
    rows: u32,
    taken: u32,
    /// Samples of a pixel in a piece.
    together: Together,
}

/// How many samples of a pixel a piece takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Together {
    /// As many as the budget allows.
    Fitting,
    /// One.
    One,
    /// All: paths are taken step by step, so their number bounds no submission, and a pixel costs the budget 1.
    All,
}

/// Greatest number of pixels in a piece: 32,768 work-groups of 64, half of what every device takes along one axis.
const PIXELS_MAX: u64 = 32_768 * 64;

impl Cut {
    /// The whole of `rect`.
    pub(super) fn new(rect: Rect, samples: u32, together: Together) -> Self {
        Self {
            width: rect.width,
            height: rect.height,
            samples: samples.max(1),
            row: 0,
            rows: 0,
            taken: 0,
            together,
        }
    }

    /// Whether nothing is left.
    pub(super) fn is_done(&self) -> bool {
        self.row >= self.height || self.width == 0
    }

    /// Whether some samples of its rows are taken and others are not.
    pub(super) fn is_begun(&self) -> bool {
        self.taken > 0
    }

    /// Whether the next piece within `budget` takes all samples of its rows.
    pub(super) fn fits(&self, budget: u64) -> bool {
        let is_whole = self.together != Together::One || self.samples == 1;
        is_whole && self.taken == 0 && budget >= u64::from(self.width) * self.cost()
    }

    /// What a pixel costs of the budget.
    pub(super) fn cost(&self) -> u64 {
        if self.together == Together::All { 1 } else { self.samples.into() }
    }

    /// The next piece of about `budget` samples (pixels, where all samples stay together), at least one row and one sample of it.
    pub(super) fn next(&mut self, budget: u64) -> Option<Piece> {
        if self.is_done() {
            return None;
        }
        let width = u64::from(self.width);
        if self.taken == 0 {
            // As many rows as can be finished now, or else as can have one sample each.
            let whole = budget / (width * self.cost());
            let rows = match self.together {
                Together::Fitting if whole > 0 => whole,
                Together::All => whole,
                Together::Fitting | Together::One => budget / width,
            };
            let left = u64::from(self.height - self.row);
            self.rows = rows.min(PIXELS_MAX / width).clamp(1, left) as u32;
        }
        let pixels = width * u64::from(self.rows);
        let left = u64::from(self.samples - self.taken);
        let samples = match self.together {
            Together::Fitting => (budget / pixels).clamp(1, left),
            Together::One => 1,
            Together::All => left,
        } as u32;
        let piece = Piece { row: self.row, rows: self.rows, samples: (self.taken, self.taken + samples) };
        self.taken += samples;
        if self.taken == self.samples {
            (self.row, self.taken) = (self.row + self.rows, 0);
        }
        Some(piece)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_of_every_row_is_taken_once_and_in_order() {
        for (width, height, samples, budget) in [
            (128, 128, 1, 1 << 20),
            (128, 128, 1, 1000),
            (128, 128, 64, 100_000),
            (100, 7, 65_536, 4096),
            (65_536, 3, 2, 1000),
            (1, 1, 1, 1),
            (65_536, 64, 1, u64::MAX / 2),
        ] {
            let mut cut = Cut::new(Rect { x: 3, y: 4, width, height }, samples, Together::Fitting);
            let mut taken = vec![0; height as usize];
            let mut pieces = 0;
            while let Some(Piece { row, rows, samples: (first, end) }) = cut.next(budget) {
                assert!(rows >= 1 && first < end && end <= samples);
                for count in &mut taken[row as usize..(row + rows) as usize] {
                    assert_eq!(*count, first);
                    *count = end;
                }
                let work = u64::from(width) * u64::from(rows) * u64::from(end - first);
                assert!(work <= budget.max(u64::from(width)), "{work} of {budget}");
                pieces += 1;
            }
            assert!(taken.iter().all(|&count| count == samples) && pieces > 0);
        }
        let rect = Rect { x: 0, y: 0, width: 100, height: 3 };
        let mut cut = Cut::new(rect, 50, Together::All);
        assert_eq!(cut.next(200), Some(Piece { row: 0, rows: 2, samples: (0, 50) }), "a pixel costs 1");
        assert_eq!(cut.next(1), Some(Piece { row: 2, rows: 1, samples: (0, 50) }));
        assert!(cut.is_done());
        let mut cut = Cut::new(rect, 2, Together::One);
        assert_eq!(cut.next(10_000), Some(Piece { row: 0, rows: 3, samples: (0, 1) }));
        assert_eq!(cut.next(10_000), Some(Piece { row: 0, rows: 3, samples: (1, 2) }));
        assert!(cut.is_done());
        assert_eq!(Cut::new(Rect { x: 0, y: 0, width: 0, height: 5 }, 1, Together::Fitting).next(9), None);
    }
}
