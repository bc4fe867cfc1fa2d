//! `auto`: finds out which way of handing out tiles fits the cluster.
//!
//! All ways that it tries survive a worker that slows down; they differ in how many messages they need. Where messages cost next to nothing
//! it is best to keep lists at the master, give workers a tile at a time and have each returned at once; where each message costs a shared
//! link as much as several tiles (a radio), to hand over whole lists and have them returned in one piece. Round trips alone do not tell the two
//! apart: 5 ms may be distance, which many tiles can be under way at the same time, or occupancy, which they cannot. So it measures: the
//! time of a frame over the time that its work would take if nothing else did.

use super::{
    Balance,
    policy::{Ahead, Endgame, Plan, View, dealt, even_lists, staggered_lists, stolen, weighted_lists},
};
use std::time::Duration;
use tessera_wire::{ReturnMode, TileGrid};

/// A way of handing out tiles; each has fewer messages than the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Way {
    /// Lists at the master; each tile is returned by itself.
    Single,
    /// The same, returned in four groups a worker.
    Grouped,
    /// Lists at the workers, returned in two halves.
    Halves,
    /// Lists at the workers, which end one after the other; returned in one piece.
    Whole,
}

impl Way {
    const ALL: [Self; 4] = [Self::Single, Self::Grouped, Self::Halves, Self::Whole];

    /// The ways in the order of trying: from one end to the other, then between.
    const ORDER: [Self; 4] = [Self::Single, Self::Whole, Self::Halves, Self::Grouped];
}

/// How frames have gone that were handed out in each way.
#[derive(Clone, Debug, Default)]
pub struct Trials {
    /// For so many workers and tiles.
    of: (usize, u32),
    /// Frame time over the time of its work, smoothed, by way.
    ratios: [Option<f64>; 4],
    /// Frames that each was tried in.
    tried: [u32; 4],
    /// Frames since the best way was last in doubt.
    settled: u32,
}

/// From here on a way is good enough that no other is tried: what is left is the last tiles and a round trip.
const GOOD: f64 = 1.08;

/// A settled cluster is asked again after so many frames whether another way has become better.
const DOUBT_AFTER: u32 = 32;

/// Weight of a new ratio: a frame that something else has disturbed is not the measure of the next thirty.
const GAIN: f64 = 0.4;

/// And it counts as so many times what was known at most: a frame in which something else went wrong says little of its way.
const SURPRISE: f64 = 1.3;

/// Over the number of its trials, the part of a ratio that may be bad luck: a way that was tried once, while little was known of costs and
/// speeds, is tried again if it was not worse than the best by more.
const LUCK: f64 = 0.12;

impl Trials {
    /// A frame of `workers` and `tiles` that was handed out in `way` took `ratio` times what its work takes.
    pub(super) fn note(&mut self, way: usize, workers: usize, tiles: u32, ratio: f64) {
        if self.of != (workers, tiles) {
            *self = Self { of: (workers, tiles), ..Self::default() };
        }
        let known = &mut self.ratios[way];
        *known = Some(known.map_or(ratio, |old| old + GAIN * (ratio.min(SURPRISE * old) - old)));
        self.tried[way] += 1;
        self.settled += 1;
        if self.settled > DOUBT_AFTER && self.best().is_some_and(|(_, ratio)| ratio > GOOD) {
            let best = self.best().map(|(way, _)| way);
            self.settled = 0;
            // The others are forgotten: what was bad then may be good now.
            for way in Way::ALL.into_iter().filter(|way| Some(*way) != best) {
                (self.ratios[way as usize], self.tried[way as usize]) = (None, 0);
            }
        }
    }

    fn best(&self) -> Option<(Way, f64)> {
        let known = Way::ALL.into_iter().filter_map(|way| Some((way, self.ratios[way as usize]?)));
        known.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The one that is the best with as much luck as its trials leave room for.
    fn promising(&self) -> Option<Way> {
        let with_luck = |way: Way| {
            let luck = LUCK / f64::from(self.tried[way as usize].max(1));
            Some((way, self.ratios[way as usize]? * (1.0 - luck)))
        };
        let known = Way::ALL.into_iter().filter_map(with_luck);
        known.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(way, _)| way)
    }

    /// The way of the next frame, and why.
    fn next(&self, workers: usize, tiles: u32) -> (Way, String) {
        if self.of != (workers, tiles) {
            return (Way::Single, "nothing is known of such frames: single tiles, which suit most".into());
        }
        match self.best() {
            Some((best, ratio)) if ratio > GOOD => {
                match Way::ORDER.into_iter().find(|way| self.ratios[*way as usize].is_none()) {
                    Some(untried) => {
                        let why = format!(
                            "{} took {ratio:.2} of its work's time, so {} is tried",
                            best.name(),
                            untried.name()
                        );
                        (untried, why)
                    }
                    None => match self.promising().filter(|way| *way != best) {
                        Some(again) => {
                            let why = format!(
                                "{} is the best of all that were tried, {ratio:.2} of its work's time; {} is tried again",
                                best.name(),
                                again.name()
                            );
                            (again, why)
                        }
                        None => {
                            let why = format!(
                                "{} is the best of all that were tried, {ratio:.2} of its work's time",
                                best.name()
                            );
                            (best, why)
                        }
                    },
                }
            }
            Some((best, ratio)) => (best, format!("{} takes {ratio:.2} of its work's time", best.name())),
            None => (Way::Single, "nothing is known yet".into()),
        }
    }
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Single => "single tiles from lists at the master",
            Self::Grouped => "groups of tiles from lists at the master",
            Self::Halves => "lists at the workers, returned in halves,",
            Self::Whole => "lists at the workers, returned whole one after the other,",
        }
    }
}

/// The plan, in the way that fits what was measured.
pub(super) fn plan(view: &View<'_>) -> Plan {
    let workers = view.workers.len();
    let (way, why) = if view.in_order {
        (Way::Single, "single tiles, as the image is wanted from its first row on".into())
    } else if view.known.has_costs() {
        view.known.trials.next(workers, view.grid.tiles())
    } else {
        (Way::Single, "nothing is known of what tiles cost: single tiles, which suit most".into())
    };
    let list = view.grid.tiles().div_ceil(workers.max(1) as u32);
    let single = || stolen(Balance::Auto, view);
    let plan = match way {
        Way::Single => Plan { returns: ReturnMode::Batches { min_bytes: 0 }, ..single() },
        Way::Grouped => {
            let group = list.div_ceil(4).max(1);
            Plan {
                returns: ReturnMode::Every { tiles: group },
                ahead: Ahead::RoundTrip { least: 2 * group },
                ..single()
            }
        }
        Way::Halves => {
            let lists = weighted_lists(view, &[]).unwrap_or_else(|| even_lists(view));
            let returns = ReturnMode::Every { tiles: list.div_ceil(2).max(1) };
            Plan { returns, endgame: rarely(view), ..dealt(Balance::Auto, view, lists) }
        }
        Way::Whole => {
            let lists = staggered_lists(view).unwrap_or_else(|| even_lists(view));
            Plan { returns: ReturnMode::AtEnd, endgame: rarely(view), ..dealt(Balance::Auto, view, lists) }
        }
    };
    Plan { why: Some(why), way: Some(way as usize), ..plan }
}

/// Where messages are dear, a tile goes to a second worker only if that saves a good part of the frame: a worker that has slowed down.
fn rarely(view: &View<'_>) -> Endgame {
    const PART: f64 = 0.2;
    let work: f64 = view.known.costs(view.camera, view.grid).into_iter().flatten().map(f64::from).sum();
    let speeds: f64 = view.workers.iter().map(|&worker| view.known.speed_of(worker)).sum();
    Endgame::Soonest(Duration::try_from_secs_f64(PART * work / speeds).unwrap_or_default())
}

/// Side of a tile for `workers`: a fine enough grid that the last tiles do not matter, coarse enough that messages and launches do not.
/// `mean` is what a tile of `before` pixels square has cost on the average, if that is known.
pub fn tile_side(width: u32, height: u32, workers: usize, mean: Option<(u32, Duration)>) -> u32 {
    /// Tiles of a worker: the last of them, which others wait for, is then a sixteenth of its share.
    const TILES_A_WORKER: u64 = 16;
    /// A tile costs its message and launches tens of microseconds; this is worth it.
    const LEAST: Duration = Duration::from_millis(1);
    let sides = [128, 64, 32, 16];
    let tiles = |side: u32| TileGrid::new(width, height, side).map_or(0, |grid| u64::from(grid.tiles()));
    let is_worth_it = |side: u32| {
        mean.is_none_or(|(before, cost)| {
            let shrunk = f64::from(side) / f64::from(before.max(1));
            cost.mul_f64((shrunk * shrunk).min(1e6)) >= LEAST
        })
    };
    let is_enough = |side: &u32| tiles(*side) >= TILES_A_WORKER * workers.max(1) as u64;
    let mut chosen = sides[0];
    for side in sides.into_iter().skip(1) {
        // A grid beyond the limits has no tiles.
        if is_enough(&chosen) || !is_worth_it(side) || tiles(side) == 0 {
            break;
        }
        chosen = side;
    }
    chosen
}
