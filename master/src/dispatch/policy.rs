//! Policies: how the tiles of a frame are to be handed out, from what is known when it begins. Each is a pure function of [`View`];
//! [`super::Dispatch`] carries out what it says.

use super::{
    Balance, Deal, Knowledge, auto,
    hilbert::hilbert_order,
    lists::{deal_by_cost, pieces, staggered},
    row_major_owner,
};
use std::{collections::BTreeMap, time::Duration};
use tessera_wire::{Camera, ReturnMode, TileGrid, TileId, WorkerId};

/// What a policy sees.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The frame's tiles.
    pub grid: &'a TileGrid,
    /// From where they are seen.
    pub camera: &'a Camera,
    /// Those that take part.
    pub workers: &'a [WorkerId],
    /// What frames before have shown.
    pub known: &'a Knowledge,
    /// Whether rows are wanted from the top, because the image does not fit memory otherwise: then lists are not dealt.
    pub in_order: bool,
}

/// How a frame's tiles are handed out.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Tiles of each worker, in the order of rendering; may be empty, and then all tiles are in `pool`.
    pub lists: Vec<Vec<TileId>>,
    /// Tiles for whoever asks first, in this order.
    pub pool: Vec<TileId>,
    /// How many tiles a worker holds at a time.
    pub ahead: Ahead,
    /// Whether who has nothing left takes from the end of another's list.
    pub steals: bool,
    /// When a tile goes to a second worker.
    pub endgame: Endgame,
    /// When workers return what they have rendered.
    pub returns: ReturnMode,
    /// Seconds that each tile costs a worker of speed 1; empty while nothing is known.
    pub costs: Vec<f32>,
    /// Speeds of workers; 1 for those that are not there.
    pub speeds: BTreeMap<WorkerId, f64>,
    /// Round trips to workers; 0 for those that are not there.
    pub round_trips: BTreeMap<WorkerId, Duration>,
    /// Why, for people; of `auto`.
    pub why: Option<String>,
    /// Which of its ways `auto` has taken.
    pub(super) way: Option<usize>,
}

impl Plan {
    /// Which of its ways `auto` has taken, for [`Seen::way`](super::Seen::way).
    pub fn way(&self) -> Option<usize> {
        self.way
    }
}

/// How many tiles a worker holds at a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ahead {
    /// Its whole list.
    All,
    /// One.
    One,
    /// One that it renders, and as many as it renders within a round trip, so that the next is there when it needs it; at least so many in
    /// all. Towards the end, when there are fewer tiles than that for each, it falls to one.
    RoundTrip {
        /// At least.
        least: u32,
    },
}

/// When a tile goes to a second worker, that idles. The first result wins; the other is cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endgame {
    /// When its holder was silent for much longer than a tile takes.
    Late,
    /// As soon as it is likely to be finished earlier that way, by so much at least: what the messages for it are worth.
    Soonest(Duration),
}

impl Endgame {
    /// A message there and another back, and a wake-up of each process.
    pub(super) const LEAST: Self = Self::Soonest(Duration::from_millis(2));
}

/// Tiles that a worker holds at least where they are pulled: one that it renders, and the next, so that it need not wait for a word.
const AHEAD: u32 = 2;

/// How `balance` hands out the tiles that `view` shows.
pub fn plan(balance: Balance, view: &View<'_>) -> Plan {
    if view.workers.is_empty() {
        let ahead = if balance.is_dealt() { Ahead::All } else { Ahead::RoundTrip { least: AHEAD } };
        return Plan { ahead, ..pulled(balance, view) };
    }
    match balance {
        Balance::PaperStatic => dealt(balance, view, paper_lists(view)),
        Balance::Static => dealt(balance, view, even_lists(view)),
        Balance::Hilbert => dealt(balance, view, pieces(&hilbert_order(view.grid), view.workers.len())),
        Balance::Weighted => match weighted_lists(view, &[]) {
            Some(lists) => dealt(balance, view, lists),
            None => dealt(balance, view, even_lists(view)),
        },
        Balance::Staggered => match staggered_lists(view) {
            Some(lists) => dealt(balance, view, lists),
            None => dealt(balance, view, even_lists(view)),
        },
        Balance::PaperDynamic => Plan { ahead: Ahead::One, ..pulled(balance, view) },
        Balance::Dynamic => Plan { endgame: Endgame::LEAST, ..pulled(balance, view) },
        Balance::Steal => stolen(balance, view),
        Balance::Auto => auto::plan(view),
    }
}

/// Lists, each handed over at once.
pub(super) fn dealt(balance: Balance, view: &View<'_>, lists: Vec<Vec<TileId>>) -> Plan {
    Plan { lists, pool: Vec::new(), ahead: Ahead::All, ..pulled(balance, view) }
}

/// Lists that the master keeps and workers take from, their own first.
pub(super) fn stolen(balance: Balance, view: &View<'_>) -> Plan {
    let plan = Plan { steals: true, endgame: Endgame::LEAST, ..pulled(balance, view) };
    if view.in_order {
        return plan;
    }
    let lists = weighted_lists(view, &[]).unwrap_or_else(|| even_lists(view));
    Plan { lists, pool: Vec::new(), ..plan }
}

/// One queue for all, row by row.
fn pulled(balance: Balance, view: &View<'_>) -> Plan {
    let speeds = view.workers.iter().map(|&worker| (worker, view.known.speed_of(worker)));
    let round_trips = view.workers.iter().map(|&worker| (worker, view.known.round_trip_of(worker)));
    Plan {
        lists: Vec::new(),
        pool: (0..view.grid.tiles()).map(TileId).collect(),
        ahead: Ahead::RoundTrip { least: AHEAD },
        steals: false,
        endgame: Endgame::Late,
        returns: balance.returns(),
        costs: view.known.costs(view.camera, view.grid).unwrap_or_default(),
        speeds: speeds.collect(),
        round_trips: round_trips.collect(),
        why: None,
        way: None,
    }
}

fn paper_lists(view: &View<'_>) -> Vec<Vec<TileId>> {
    lists_by_owner(view, |tile| row_major_owner(tile, view.workers.len() as u32))
}

pub(super) fn even_lists(view: &View<'_>) -> Vec<Vec<TileId>> {
    let deal = Deal::new(view.grid, view.workers.len() as u32);
    lists_by_owner(view, |tile| deal.owner(tile))
}

fn lists_by_owner(view: &View<'_>, owner: impl Fn(TileId) -> u32) -> Vec<Vec<TileId>> {
    let mut lists = vec![Vec::new(); view.workers.len()];
    for tile in (0..view.grid.tiles()).map(TileId) {
        lists[owner(tile) as usize].push(tile);
    }
    lists
}

/// By cost and speed, once they are known.
pub(super) fn weighted_lists(view: &View<'_>, later: &[f64]) -> Option<Vec<Vec<TileId>>> {
    let costs = view.known.costs(view.camera, view.grid)?;
    let speeds: Vec<_> = view.workers.iter().map(|&worker| view.known.speed_of(worker)).collect();
    Some(deal_by_cost(&costs, &speeds, later))
}

/// The same with ends one after the other, as far as the link takes long for what a worker returns.
pub(super) fn staggered_lists(view: &View<'_>) -> Option<Vec<Vec<TileId>>> {
    let costs = view.known.costs(view.camera, view.grid)?;
    let speeds: f64 = view.workers.iter().map(|&worker| view.known.speed_of(worker)).sum();
    let ideal = costs.iter().map(|cost| f64::from(*cost)).sum::<f64>() / speeds;
    let workers = view.workers.len();
    // The first must have something to do: none is later than the first by more than the time that each has on the average.
    let later = staggered(workers, view.known.batch_time(workers).as_secs_f64(), ideal);
    weighted_lists(view, &later)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dispatch::{Seen, Shown};

    const CAMERA: Camera =
        Camera { origin: [0.0; 3], forward: [0.0, 0.0, -1.0], right: [1.0, 0.0, 0.0], up: [0.0, 1.0, 0.0] };

    /// What `balance` plans for 64 tiles, of which those of the right half cost ten times as much, after a frame has shown that.
    fn planned(balance: Balance, speeds: &[f64], has_shown: bool) -> Plan {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let workers: Vec<_> = (0..speeds.len() as u32).map(WorkerId).collect();
        let mut known = Knowledge::default();
        let shown = |tile: u32| {
            let worker = (tile / 8) as usize % speeds.len();
            let cost = if tile % 8 >= 4 { 0.010 } else { 0.001 };
            let render = Duration::from_secs_f64(cost / speeds[worker]);
            Shown { tile: TileId(tile), worker: WorkerId(worker as u32), render }
        };
        if has_shown {
            let shown: Vec<_> = (0..64).map(shown).collect();
            known.learn(&Seen {
                camera: &CAMERA,
                grid: &grid,
                shown: &shown,
                crew: &workers,
                took: Duration::from_secs(1),
                wire_bytes: 0,
                way: None,
            });
        }
        plan(
            balance,
            &View { grid: &grid, camera: &CAMERA, workers: &workers, known: &known, in_order: false },
        )
    }

    #[test]
    fn every_policy_hands_out_each_tile_once() {
        for balance in Balance::ALL {
            for has_shown in [false, true] {
                for workers in [1, 3, 16, 100] {
                    let plan = planned(balance, &vec![1.0; workers], has_shown);
                    let mut all = [plan.lists.concat(), plan.pool.clone()].concat();
                    all.sort_unstable();
                    assert!(all.into_iter().eq((0..64).map(TileId)), "{balance} to {workers}");
                    assert!(plan.lists.len() == workers || plan.lists.is_empty());
                    assert_eq!(plan.ahead == Ahead::All, balance.is_dealt(), "{balance}");
                }
            }
        }
    }

    #[test]
    fn weighted_lists_follow_costs_and_speeds() {
        let loads = |balance, speeds: &[f64]| {
            let cost = |tile: &TileId| if tile.0 % 8 >= 4 { 0.010 } else { 0.001 };
            let plan = planned(balance, speeds, true);
            let sums = plan.lists.iter().map(|list| list.iter().map(cost).sum::<f64>());
            sums.zip(speeds).map(|(sum, speed)| sum / speed).collect::<Vec<_>>()
        };
        let spread = |loads: &[f64]| {
            loads.iter().copied().fold(0.0, f64::max) / (loads.iter().sum::<f64>() / loads.len() as f64)
        };
        // The paper's columns: half of the workers have all that is hard.
        assert!(spread(&loads(Balance::PaperStatic, &[1.0; 8])) > 1.8);
        assert!(spread(&loads(Balance::Weighted, &[1.0; 8])) < 1.03);
        assert!(spread(&loads(Balance::Weighted, &[0.5, 1.0, 2.0, 1.0])) < 1.06);
        assert!(spread(&loads(Balance::Static, &[0.5, 1.0, 2.0, 1.0])) > 1.5);
    }
}
