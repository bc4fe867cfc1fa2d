//! What a living worker has.

use super::Tile;
use std::{collections::VecDeque, time::Duration};
use tessera_wire::TileId;

#[derive(Clone, Debug, Default)]
pub(super) struct Hand {
    /// Its tiles that the master still has.
    pub(super) list: VecDeque<TileId>,
    /// What they cost, in seconds of a worker of speed 1; their number while nothing is known.
    pub(super) list_cost: f64,
    /// Tiles handed out and not yet said to be rendered.
    pub(super) queued: u32,
    /// Those, in the order of rendering, and by when each was expected.
    pub(super) order: VecDeque<(TileId, Duration)>,
    /// When it should have rendered them all.
    pub(super) free_at: Duration,
    /// Seconds by which its last word was later than expected; negative if it was earlier.
    pub(super) lag: f64,
    /// Tiles handed out that are not in.
    pub(super) missing: u32,
    /// Tiles that no other living worker has, in the order of handing out. The last one is unfinished; others may be finished.
    pub(super) alone_with: Vec<TileId>,
    /// When it last made progress, or was given work while it had none.
    pub(super) since: Duration,
    /// What frames before have used up of the time that it may be silent: 0 none, 1 all of it.
    pub(super) worn: f64,
    /// How much longer than its tiles let it it may be silent since then: what tiles that were taken back let it.
    pub(super) granted: Duration,
    /// Whether another has finished a tile that it had before, and it none since: where its tiles are taken back it idles, and is no help.
    pub(super) overtaken: bool,
    /// Whether it takes no more.
    pub(super) leaving: bool,
}

impl Hand {
    /// Keeps the promise of `alone_with`.
    pub(super) fn trim(&mut self, tiles: &[Tile]) {
        while self.alone_with.pop_if(|tile| tiles[tile.0 as usize].done).is_some() {}
    }

    /// Seconds by which it is late at `now`: by its last word, or because the next is overdue.
    pub(super) fn lag_at(&self, now: Duration) -> f64 {
        let overdue = self.order.front().map(|(_, expected)| now.as_secs_f64() - expected.as_secs_f64());
        overdue.map_or(self.lag, |overdue| overdue.max(self.lag))
    }
}
