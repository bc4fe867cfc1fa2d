//! What the tiles of a frame have cost so far, and how long that lets a silent worker be trusted.

use std::{collections::BTreeMap, time::Duration};
use tessera_wire::{ReturnMode, WorkerId};

/// Costs by the master's clock: from a worker's last sign of progress to its word that it has rendered.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// Whether tiles were dealt in advance.
    is_dealt: bool,
    returns: ReturnMode,
    /// Samples of the largest tile.
    samples: u64,
    /// By worker: whether one is late is for those to show that could help it. One that is a thousand times slower than they are would else
    /// take its own time for the measure, and be left with what it has been dealt.
    shown: BTreeMap<WorkerId, Shown>,
}

/// What a worker's tiles have cost.
#[derive(Clone, Copy, Debug, Default)]
struct Shown {
    tiles: u32,
    sum: Duration,
    slowest: Duration,
}

impl Shown {
    fn mean(&self) -> Duration {
        self.sum / self.tiles.max(1)
    }
}

impl Pace {
    /// An idle worker of a pull balancing renders a tile again when its holder was silent for so many mean tiles of its own: by then it is
    /// slow, or the tile is hard. Less would render tiles twice that are about to come.
    const LATE_MEANS: u32 = 2;

    /// And not before this: a frame that is later by so much is later by an eyelid's blink, and a packet that was lost, or a busy
    /// machine, takes as long.
    const LATE_LEAST: Duration = Duration::from_millis(500);

    /// The static balancings deal once, and a slow worker is the price of that. They ask others only when a worker was silent for so
    /// many of the slowest tiles: tiles of one frame differ by an order of magnitude, but by then most have been seen.
    const DEAL_LATE_SLOWEST: u32 = 4;

    /// And not before this: a machine that is gone is lost after `limits::IDLE_TIMEOUT`, which hands its tiles out exactly once.
    const DEAL_LATE_LEAST: Duration = Duration::from_secs(5);

    /// A worker is given up when it was silent for so many of the slowest tiles,
    const STALLED_SLOWEST: u32 = 10;

    /// but not before a machine that swaps or was suspended had time to recover,
    const STALLED_LEAST: Duration = Duration::from_secs(60);

    /// and, as nothing is known of a frame's first tiles, not before a worker ten times slower than one that is still of use had
    /// rendered the tile: a sample with its secondary rays takes microseconds, in the worst scenes a millisecond. What `Frame::check` lets pass
    /// can take longer, up to `limits::RAYS` rays and their shadows: a tile all of such samples, which takes a scene that was made for it, is given up.
    const STALLED_SAMPLE: Duration = Duration::from_millis(10);

    /// Tiles that are only compared may take a worker so many of the slowest ones each, which others of its class have rendered,
    const COMPARE_SLOWEST: u32 = 4;

    /// and this at least, as on a machine that is busy.
    const COMPARE_LEAST: Duration = Duration::from_secs(5);

    pub(super) fn new(is_dealt: bool, returns: ReturnMode, samples: u64) -> Self {
        Self { is_dealt, returns, samples, shown: BTreeMap::new() }
    }

    /// What a tile has cost `worker` on the average; what it has cost the others while it has shown nothing.
    pub(super) fn mean_of(&self, worker: WorkerId) -> Option<Duration> {
        if let Some(shown) = self.shown.get(&worker) {
            return Some(shown.mean());
        }
        let (sum, tiles) =
            self.shown.values().fold((Duration::ZERO, 0), |(s, n), shown| (s + shown.sum, n + shown.tiles));
        sum.checked_div(tiles)
    }

    /// `worker` took `took` for `tiles` tiles, at least one.
    pub(super) fn note(&mut self, worker: WorkerId, tiles: u32, took: Duration) {
        let shown = self.shown.entry(worker).or_default();
        shown.tiles += tiles;
        shown.sum += took;
        shown.slowest = shown.slowest.max(took / tiles);
    }

    /// How long `worker`, with `queued` tiles, may be silent before `helper` is asked for them as well.
    pub(super) fn late_after(&self, worker: WorkerId, queued: u32, helper: WorkerId) -> Duration {
        // A helper that has shown nothing yet is as fast as the fastest.
        let others = || self.shown.iter().filter(|(other, _)| **other != worker).map(|(_, shown)| shown);
        let shown = self.shown.get(&helper).or_else(|| others().min_by_key(|shown| shown.mean()));
        let shown = shown.copied().unwrap_or_default();
        if self.is_dealt {
            let slowest = shown.slowest.saturating_mul(Self::DEAL_LATE_SLOWEST);
            return slowest.saturating_mul(self.tiles_a_word(queued)).max(Self::DEAL_LATE_LEAST);
        }
        let mean = shown.mean().saturating_mul(self.tiles_a_word(queued));
        mean.saturating_mul(Self::LATE_MEANS).max(Self::LATE_LEAST)
    }

    /// How long it may be silent before it is given up.
    pub(super) fn stalled_after(&self, queued: u32) -> Duration {
        let samples = u32::try_from(self.samples).unwrap_or(u32::MAX);
        let unknown = Self::STALLED_SAMPLE.saturating_mul(samples);
        let known = self.slowest().saturating_mul(Self::STALLED_SLOWEST);
        let tile = unknown.max(known);
        tile.saturating_mul(self.tiles_a_word(queued)).saturating_add(Self::STALLED_LEAST)
    }

    /// How long a worker may take for `tiles` that nobody needs for the image.
    pub(super) fn compare_within(&self, tiles: u32) -> Duration {
        let slowest = self.slowest().saturating_mul(Self::COMPARE_SLOWEST);
        slowest.saturating_mul(tiles.max(1)).max(Self::COMPARE_LEAST)
    }

    /// The smaller, the more of a help `worker` is: the fastest come first, those that have shown nothing last.
    pub(super) fn rank(&self, worker: WorkerId) -> Duration {
        self.shown.get(&worker).map_or(Duration::MAX, Shown::mean)
    }

    fn slowest(&self) -> Duration {
        self.shown.values().map(|shown| shown.slowest).max().unwrap_or_default()
    }

    /// Tiles that a worker with `queued` of them renders before its next word.
    fn tiles_a_word(&self, queued: u32) -> u32 {
        match self.returns {
            ReturnMode::AtEnd => queued.max(1),
            ReturnMode::Batches { .. } => 1,
            ReturnMode::Every { tiles } => tiles.min(queued).max(1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Balance;

    const SECOND: Duration = Duration::from_secs(1);
    const ONE: WorkerId = WorkerId(1);
    const OTHER: WorkerId = WorkerId(2);

    fn pace_of(balance: Balance, samples: u64) -> Pace {
        Pace::new(balance.is_dealt(), balance.returns(), samples)
    }

    #[test]
    fn what_tiles_have_cost_the_helper_decides_who_is_late() {
        let mut pull = pace_of(Balance::Dynamic, 1);
        assert_eq!(pull.late_after(ONE, 3, OTHER), Pace::LATE_LEAST, "nothing is known yet");
        pull.note(ONE, 1, 5000 * SECOND);
        assert_eq!(pull.late_after(ONE, 3, OTHER), Pace::LATE_LEAST, "nothing is known of others");
        pull.note(OTHER, 3, 15 * SECOND);
        pull.note(WorkerId(3), 1, 4000 * SECOND);
        assert_eq!(pull.late_after(ONE, 3, OTHER), 2 * 5 * SECOND);
        assert_eq!(pull.late_after(ONE, 3, WorkerId(4)), 2 * 5 * SECOND, "it has just joined");
        assert_eq!(pull.late_after(OTHER, 3, ONE), 2 * 5000 * SECOND, "a slow one is no help");

        let mut deal = pace_of(Balance::Static, 1);
        assert_eq!(deal.late_after(ONE, 3, OTHER), Pace::DEAL_LATE_LEAST);
        deal.note(OTHER, 2, 6 * SECOND);
        deal.note(ONE, 1, 5000 * SECOND);
        assert_eq!(deal.late_after(ONE, 3, OTHER), 4 * 3 * SECOND, "a word a tile");
        let mut paper = pace_of(Balance::PaperStatic, 1);
        paper.note(OTHER, 2, 6 * SECOND);
        assert_eq!(paper.late_after(ONE, 5, OTHER), 5 * 4 * 3 * SECOND, "a word a list");
    }

    #[test]
    fn a_hard_frame_has_time() {
        // 128 x 128 pixels: 164 s, and a minute.
        let mut pace = pace_of(Balance::Dynamic, 128 * 128);
        assert_eq!(pace.stalled_after(1), Duration::from_millis(163_840) + Pace::STALLED_LEAST);
        pace.note(ONE, 1, 100 * SECOND);
        assert_eq!(pace.stalled_after(1), 1000 * SECOND + Pace::STALLED_LEAST);
        // The largest frame there is does not overflow.
        let most = pace_of(Balance::PaperStatic, 1 << 44).stalled_after(1 << 16);
        assert!(most > 1_000_000 * SECOND && std::time::Instant::now().checked_add(most).is_some());
    }
}
