//! The tiles of one frame: who has which, and which are in.

use super::{Balance, Deal, row_major_owner};
use std::collections::{BTreeMap, VecDeque};
use tessera_wire::{Attempt, TileGrid, TileId, WorkerId};

/// Tiles that a worker of the dynamic balancing may hold: one is rendered while two wait, which hides a round
/// trip of up to two tile times. Towards the end of a frame it falls to one, so that nobody hoards the last
/// tiles.
const PREFETCH: usize = 3;

/// State of one frame.
///
/// Results are idempotent: the first for a tile wins, whoever sends it; later ones are counted and dropped.
#[derive(Clone, Debug)]
pub struct Dispatch {
    balance: Balance,
    tiles: Vec<Tile>,
    /// Not handed out, or handed out to a worker that was lost; may hold tiles that came in meanwhile.
    pool: VecDeque<TileId>,
    /// Tiles handed out and not yet said to be rendered, by living worker.
    queued: BTreeMap<WorkerId, u32>,
    /// Tiles handed out whose pixels are missing, by living worker.
    missing: BTreeMap<WorkerId, u32>,
    done: u32,
    dropped: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Tile {
    /// Times handed out.
    handed: u32,
    /// Who has it now.
    holder: Option<WorkerId>,
    done: bool,
}

/// Tiles for a worker, to be rendered in this order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// To whom.
    pub worker: WorkerId,
    /// Times that these tiles had been handed out before.
    pub attempt: Attempt,
    /// Which, at least one.
    pub tiles: Vec<TileId>,
}

/// A worker says what cannot be; it must be cut off.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// No tile rendered, or more than it has.
    #[error("{tiles} tiles said to be rendered, {queued} are with the worker")]
    Rendered {
        /// Said.
        tiles: u32,
        /// Held.
        queued: u32,
    },
    /// A tile that it was not given.
    #[error("tile {tile} (attempt {attempt}) was not given to the worker")]
    NotAssigned {
        /// Which.
        tile: u32,
        /// Said to be.
        attempt: u32,
    },
}

impl Dispatch {
    /// A frame that nobody has begun, and the first tiles for each of `workers`.
    pub fn start(grid: &TileGrid, balance: Balance, workers: &[WorkerId]) -> (Self, Vec<Assignment>) {
        let mut this = Self {
            balance,
            tiles: vec![Tile::default(); grid.tiles() as usize],
            pool: (0..grid.tiles()).map(TileId).collect(),
            queued: workers.iter().map(|&worker| (worker, 0)).collect(),
            missing: workers.iter().map(|&worker| (worker, 0)).collect(),
            done: 0,
            dropped: 0,
        };
        let assignments = if workers.is_empty() {
            Vec::new()
        } else {
            match balance {
                Balance::PaperStatic => {
                    this.deal(workers, |tile| row_major_owner(tile, workers.len() as u32))
                }
                Balance::Static => {
                    let deal = Deal::new(grid, workers.len() as u32);
                    this.deal(workers, |tile| deal.owner(tile))
                }
                Balance::PaperDynamic | Balance::Dynamic => this.hand_out(),
            }
        };
        (this, assignments)
    }

    /// `worker` has rendered `tiles` more tiles; what it gets next.
    pub fn rendered(&mut self, worker: WorkerId, tiles: u32) -> Result<Vec<Assignment>, Violation> {
        let Some(queued) = self.queued.get_mut(&worker) else { return Ok(Vec::new()) };
        let wrong = Violation::Rendered { tiles, queued: *queued };
        *queued = queued.checked_sub(tiles).filter(|_| tiles > 0).ok_or(wrong)?;
        Ok(self.hand_out())
    }

    /// Takes a result: `true` if it is the first for its tile, `false` if it must be dropped.
    pub fn accept(&mut self, worker: WorkerId, tile: TileId, attempt: Attempt) -> Result<bool, Violation> {
        let wrong = Violation::NotAssigned { tile: tile.0, attempt: attempt.0 };
        let Some(state) = self.tiles.get_mut(tile.0 as usize) else { return Err(wrong) };
        // The latest attempt belongs to its holder; an earlier one may still come from a worker that left in
        // between.
        let latest = attempt.0 + 1 == state.handed;
        if attempt.0 >= state.handed || (latest && state.holder.is_some_and(|holder| holder != worker)) {
            return Err(wrong);
        }
        if state.done {
            self.dropped += 1;
            return Ok(false);
        }
        state.done = true;
        self.done += 1;
        if let Some(missing) = state.holder.and_then(|holder| self.missing.get_mut(&holder)) {
            *missing -= 1;
        }
        Ok(true)
    }

    /// `worker` is gone; who gets its unfinished tiles. With no worker left they wait (see
    /// [`Dispatch::workers`]).
    pub fn lost(&mut self, worker: WorkerId) -> Vec<Assignment> {
        if self.queued.remove(&worker).is_none() {
            return Vec::new();
        }
        self.missing.remove(&worker);
        for (id, tile) in self.tiles.iter_mut().enumerate().rev() {
            if tile.holder == Some(worker) {
                tile.holder = None;
                if !tile.done {
                    self.pool.push_front(TileId(id as u32));
                }
            }
        }
        self.hand_out()
    }

    /// Whether `worker` has nothing left to render and pixels to return.
    pub fn owes(&self, worker: WorkerId) -> bool {
        self.queued.get(&worker) == Some(&0) && self.missing.get(&worker).is_some_and(|&n| n > 0)
    }

    /// Whether the frame is complete.
    pub fn is_done(&self) -> bool {
        self.done as usize == self.tiles.len()
    }

    /// Tiles that are in.
    pub fn done(&self) -> u32 {
        self.done
    }

    /// Tiles of the frame.
    pub fn total(&self) -> u32 {
        self.tiles.len() as u32
    }

    /// Living workers.
    pub fn workers(&self) -> usize {
        self.queued.len()
    }

    /// Whether every tile that is with a living worker is said to be rendered.
    pub fn all_rendered(&self) -> bool {
        self.pool.is_empty() && self.queued.values().all(|&n| n == 0)
    }

    /// Results that came twice and were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Gives every tile of the pool to its owner, an index into `workers`.
    fn deal(&mut self, workers: &[WorkerId], owner: impl Fn(TileId) -> u32) -> Vec<Assignment> {
        let mut lists = vec![Vec::new(); workers.len()];
        while let Some(tile) = self.pool.pop_front() {
            lists[owner(tile) as usize].push(tile);
        }
        let pairs = workers.iter().zip(lists).flat_map(|(&w, list)| list.into_iter().map(move |t| (w, t)));
        self.record(pairs.collect())
    }

    /// Gives tiles of the pool to whoever has fewest, as far as the balancing lets workers hold them.
    fn hand_out(&mut self) -> Vec<Assignment> {
        let mut pairs = Vec::new();
        let mut queued = self.queued.clone();
        while let Some(&tile) = self.pool.front() {
            if self.tiles[tile.0 as usize].done {
                self.pool.pop_front();
                continue;
            }
            let Some((&worker, count)) = queued.iter_mut().min_by_key(|(_, count)| **count) else { break };
            if *count as usize >= self.credit() {
                break;
            }
            *count += 1;
            self.pool.pop_front();
            pairs.push((worker, tile));
        }
        self.record(pairs)
    }

    /// Tiles that a worker may hold now.
    fn credit(&self) -> usize {
        match self.balance {
            Balance::PaperStatic | Balance::Static => usize::MAX,
            Balance::PaperDynamic => 1,
            Balance::Dynamic => (self.pool.len() / self.queued.len().max(1)).clamp(1, PREFETCH),
        }
    }

    /// Notes that tiles are handed out, and joins those of one worker and attempt.
    fn record(&mut self, pairs: Vec<(WorkerId, TileId)>) -> Vec<Assignment> {
        let mut joined: BTreeMap<(WorkerId, u32), Vec<TileId>> = BTreeMap::new();
        for (worker, id) in pairs {
            let tile = &mut self.tiles[id.0 as usize];
            joined.entry((worker, tile.handed)).or_default().push(id);
            tile.handed += 1;
            tile.holder = Some(worker);
            *self.queued.entry(worker).or_default() += 1;
            *self.missing.entry(worker).or_default() += 1;
        }
        let assignment = |((worker, attempt), tiles)| Assignment { worker, attempt: Attempt(attempt), tiles };
        joined.into_iter().map(assignment).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workers(count: u32) -> Vec<WorkerId> {
        (0..count).map(WorkerId).collect()
    }

    fn grid(tiles: u32) -> TileGrid {
        TileGrid::new(tiles, 1, 1).unwrap()
    }

    fn given(assignments: &[Assignment], worker: u32) -> Vec<u32> {
        let of = assignments.iter().filter(|a| a.worker == WorkerId(worker));
        of.flat_map(|a| a.tiles.iter().map(|t| t.0)).collect()
    }

    #[test]
    fn each_balancing_hands_out_what_it_promises() {
        let start = |balance| Dispatch::start(&grid(64), balance, &workers(4)).1;
        let paper = start(Balance::PaperStatic);
        assert_eq!(given(&paper, 1), (0..16).map(|i| 4 * i + 1).collect::<Vec<_>>());
        assert_eq!(start(Balance::Static).iter().map(|a| a.tiles.len()).sum::<usize>(), 64);
        let pull = start(Balance::PaperDynamic);
        assert_eq!((0..4).map(|w| given(&pull, w)).collect::<Vec<_>>(), [[0], [1], [2], [3]]);
        let ahead = start(Balance::Dynamic);
        assert!((0..4).all(|w| given(&ahead, w).len() == PREFETCH));
    }

    #[test]
    fn the_last_tiles_of_the_dynamic_balancing_are_not_hoarded() {
        let (mut d, first) = Dispatch::start(&grid(9), Balance::Dynamic, &workers(4));
        // 9 tiles, 4 workers: two each would leave one; the credit falls to one when fewer than 8 are left.
        let held = (0..4).map(|w| given(&first, w).len()).collect::<Vec<_>>();
        assert!(held.iter().all(|&n| n <= 2), "{held:?}");
        while !d.pool.is_empty() {
            for w in workers(4) {
                if d.queued[&w] > 0 {
                    d.rendered(w, 1).unwrap();
                }
            }
        }
        assert!(d.queued.values().all(|&n| n <= 1));
    }

    #[test]
    fn the_first_result_wins_and_duplicates_are_counted() {
        let (mut d, _) = Dispatch::start(&grid(2), Balance::PaperStatic, &workers(2));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0)), Ok(true));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0)), Ok(false));
        assert_eq!(d.dropped(), 1);
        assert!(!d.is_done());
        assert_eq!(d.accept(WorkerId(1), TileId(1), Attempt(0)), Ok(true));
        assert!(d.is_done());
    }

    #[test]
    fn what_was_not_given_is_a_violation() {
        let (mut d, _) = Dispatch::start(&grid(4), Balance::PaperDynamic, &workers(2));
        let wrong = |tile, attempt| Err(Violation::NotAssigned { tile, attempt });
        assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(0)), wrong(0, 0));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(1)), wrong(0, 1));
        assert_eq!(d.accept(WorkerId(0), TileId(3), Attempt(0)), wrong(3, 0));
        assert_eq!(d.accept(WorkerId(0), TileId(4), Attempt(0)), wrong(4, 0));
        assert_eq!(d.accept(WorkerId(0), TileId(u32::MAX), Attempt(u32::MAX)), wrong(u32::MAX, u32::MAX));
        for tiles in [0, 2] {
            assert_eq!(d.rendered(WorkerId(0), tiles), Err(Violation::Rendered { tiles, queued: 1 }));
        }
    }

    #[test]
    fn pixels_are_owed_once_everything_is_rendered() {
        let (mut d, _) = Dispatch::start(&grid(3), Balance::PaperStatic, &workers(2));
        let first = WorkerId(0);
        d.rendered(first, 1).unwrap();
        assert!(!d.owes(first), "it renders the other");
        d.rendered(first, 1).unwrap();
        assert!(d.owes(first) && !d.owes(WorkerId(1)));
        d.accept(first, TileId(0), Attempt(0)).unwrap();
        d.accept(first, TileId(0), Attempt(0)).unwrap();
        assert!(d.owes(first), "one tile twice is not two tiles");
        d.lost(WorkerId(1));
        assert!(!d.owes(first), "it has the tile of the other");
        d.rendered(first, 1).unwrap();
        // The other's result still comes.
        d.accept(WorkerId(1), TileId(1), Attempt(0)).unwrap();
        d.accept(first, TileId(2), Attempt(0)).unwrap();
        assert!(!d.owes(first) && !d.owes(WorkerId(1)) && d.is_done());
    }

    #[test]
    fn a_lost_worker_s_tiles_go_to_the_others_and_its_late_results_still_count() {
        for balance in Balance::ALL {
            let (mut d, first) = Dispatch::start(&grid(12), balance, &workers(3));
            let mine = given(&first, 1);
            assert_eq!(d.accept(WorkerId(1), TileId(mine[0]), Attempt(0)), Ok(true));
            let again = d.lost(WorkerId(1));
            assert!(again.iter().all(|a| a.worker != WorkerId(1)));
            assert!(!again.iter().any(|a| a.tiles.contains(&TileId(mine[0]))), "{balance}");
            assert_eq!(d.lost(WorkerId(1)), []);
            if let Some(&late) = mine.get(1) {
                // In flight when the worker left: it may win over the next attempt, whose result is then
                // dropped.
                assert_eq!(d.accept(WorkerId(1), TileId(late), Attempt(0)), Ok(true));
            }
            assert_eq!(d.rendered(WorkerId(1), 1), Ok(Vec::new()), "words of the dead are ignored");
        }
    }

    #[test]
    fn all_lost_leaves_the_tiles_waiting() {
        let (mut d, _) = Dispatch::start(&grid(3), Balance::Static, &workers(2));
        assert!(!d.lost(WorkerId(0)).is_empty());
        assert_eq!(d.lost(WorkerId(1)), []);
        assert_eq!((d.workers(), d.is_done(), d.done()), (0, false, 0));
    }

    #[test]
    fn more_workers_than_tiles() {
        for balance in Balance::ALL {
            let (mut d, first) = Dispatch::start(&grid(1), balance, &workers(16));
            assert_eq!(first.len(), 1, "{balance}");
            assert_eq!(d.accept(first[0].worker, TileId(0), Attempt(0)), Ok(true));
            assert!(d.is_done());
        }
    }
}
