//! The tiles of one frame: who has which, and which are in.

use super::{Balance, Deal, pace::Pace, row_major_owner};
use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};
use tessera_wire::{Attempt, TileGrid, TileId, WorkerId};

/// Tiles that a worker of the dynamic balancing may hold: one is rendered while two wait, which hides a round
/// trip of up to two tile times. Towards the end of a frame it falls to one, so that nobody hoards the last
/// tiles.
const PREFETCH: usize = 3;

/// State of one frame.
///
/// Results are idempotent: the first for a tile wins, whoever sends it; later ones are counted and dropped. That lets a tile be with
/// two workers: when nothing is left to hand out, a worker that idles is given the last tile of one that is late. No tile is with
/// more than two, so that at most half of what is rendered is dropped, whatever happens.
#[derive(Clone, Debug)]
pub struct Dispatch {
    balance: Balance,
    tiles: Vec<Tile>,
    /// Not handed out, or handed out to a worker that was lost; may hold tiles that came in meanwhile.
    pool: VecDeque<TileId>,
    /// Living workers.
    crew: BTreeMap<WorkerId, Hand>,
    /// Unfinished tiles that two living workers have.
    shared: Vec<TileId>,
    pace: Pace,
    done: u32,
    dropped: u64,
    /// Every tile before it is in.
    first_missing: u32,
    /// Tiles that may wait for the first missing one while there are others to hand out; see [`Dispatch::keep_order`].
    may_wait: u32,
}

#[derive(Clone, Debug, Default)]
struct Tile {
    /// Attempt `n` went to the `n`th, then.
    attempts: Vec<(WorkerId, Duration)>,
    done: bool,
}

/// What a living worker has.
#[derive(Clone, Debug, Default)]
struct Hand {
    /// Tiles handed out and not yet said to be rendered.
    queued: u32,
    /// Tiles handed out that are not in.
    missing: u32,
    /// Tiles that no other living worker has, in the order of handing out. The last one is unfinished; others may be finished.
    alone_with: Vec<TileId>,
    /// When it last made progress, or was given work while it had none.
    since: Duration,
    /// What frames before have used up of the time that it may be silent: 0 none, 1 all of it.
    worn: f64,
    /// How much longer than its tiles let it it may be silent since then: what tiles that were taken back let it.
    granted: Duration,
    /// Whether another has finished a tile that it had before, and it none since: where its tiles are taken back it idles, and is no help.
    overtaken: bool,
    /// Whether it takes no more.
    leaving: bool,
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
    /// A frame that nobody has begun, of `samples` a pixel, and the first tiles for each of `workers`.
    pub fn start(
        grid: &TileGrid,
        balance: Balance,
        samples: u32,
        workers: &[WorkerId],
        now: Duration,
    ) -> (Self, Vec<Assignment>) {
        let mut this = Self {
            balance,
            tiles: vec![Tile::default(); grid.tiles() as usize],
            pool: (0..grid.tiles()).map(TileId).collect(),
            crew: workers.iter().map(|&worker| (worker, Hand::default())).collect(),
            shared: Vec::new(),
            pace: Pace::new(balance, grid.largest_tile_pixels() * u64::from(samples)),
            done: 0,
            dropped: 0,
            first_missing: 0,
            may_wait: u32::MAX,
        };
        let count = workers.len() as u32;
        let assignments = match balance {
            Balance::PaperStatic if count > 0 => this.deal(workers, |tile| row_major_owner(tile, count), now),
            balance if balance.is_dealt() && count > 0 => {
                let deal = Deal::new(grid, count);
                this.deal(workers, |tile| deal.owner(tile), now)
            }
            _ => this.hand_out(now),
        };
        (this, assignments)
    }

    /// Tiles are wanted in order: when more than so many wait for the first that is missing, and who has that one is late, it goes to the next
    /// worker that is handed anything.
    pub fn keep_order(&mut self, may_wait: u32) {
        self.may_wait = may_wait;
    }

    /// `worker` takes part from now on: it is given what nobody has, and then what late workers have. In the static balancings the
    /// first is what lost workers had.
    pub fn join(&mut self, worker: WorkerId, now: Duration) -> Vec<Assignment> {
        self.crew.entry(worker).or_default();
        self.hand_out(now)
    }

    /// `worker` has used up this part of the time that it may be silent (see [`Dispatch::worn`]).
    pub fn wear(&mut self, worker: WorkerId, worn: f64) {
        if let Some(hand) = self.crew.get_mut(&worker) {
            hand.worn = worn;
        }
    }

    /// What each living worker has used up of the time that it may be silent, 0 for those that were heard and owe nothing. It goes on
    /// counting in the next frame: many short frames end before a worker that is dead is taken for it in one.
    pub fn worn(&self, now: Duration) -> impl Iterator<Item = (WorkerId, f64)> {
        self.crew.iter().map(move |(&worker, hand)| {
            let silent = if hand.queued > 0 { now.saturating_sub(hand.since) } else { Duration::ZERO };
            (worker, hand.worn + silent.div_duration_f64(self.stalled_after(hand)))
        })
    }

    /// `worker` has rendered `tiles` more tiles; what it gets next.
    pub fn rendered(
        &mut self,
        worker: WorkerId,
        tiles: u32,
        now: Duration,
    ) -> Result<Vec<Assignment>, Violation> {
        let Some(hand) = self.crew.get_mut(&worker) else { return Ok(Vec::new()) };
        let wrong = Violation::Rendered { tiles, queued: hand.queued };
        hand.queued = hand.queued.checked_sub(tiles).filter(|_| tiles > 0).ok_or(wrong)?;
        self.pace.note(worker, tiles, now.saturating_sub(hand.since));
        (hand.since, hand.granted) = (now, Duration::ZERO);
        (hand.worn, hand.overtaken) = (0.0, false);
        Ok(self.hand_out(now))
    }

    /// `worker` has been told that nobody waits for some of its tiles, and will not render `tiles` of them; what it gets next. Nothing is
    /// learnt of its pace, and it is no progress: one that answers and never renders is found out nevertheless.
    pub fn cancelled(
        &mut self,
        worker: WorkerId,
        tiles: u32,
        now: Duration,
    ) -> Result<Vec<Assignment>, Violation> {
        let Some(hand) = self.crew.get_mut(&worker) else { return Ok(Vec::new()) };
        let wrong = Violation::Rendered { tiles, queued: hand.queued };
        let left = hand.queued.checked_sub(tiles).ok_or(wrong)?;
        let allowed = self.pace.stalled_after(hand.queued).saturating_add(hand.granted);
        if left == 0 && hand.queued > 0 {
            hand.worn += now.saturating_sub(hand.since).div_duration_f64(allowed);
        }
        // Where one word stands for a list, it has been silent for all of it.
        hand.granted = allowed.saturating_sub(self.pace.stalled_after(left));
        hand.queued = left;
        Ok(self.hand_out(now))
    }

    /// Living workers but `worker` that were given `tile` and have not said that all of their tiles are rendered: it is to be taken back from
    /// them. Nobody while there are tiles to hand out: who is slow would be given another one in its place, and others wait for that.
    pub fn other_holders(&self, tile: TileId, worker: WorkerId) -> Vec<WorkerId> {
        if !self.pool.is_empty() {
            return Vec::new();
        }
        let attempts = self.tiles.get(tile.0 as usize).map_or(&[][..], |tile| &tile.attempts);
        let holds = |other: &WorkerId| self.crew.get(other).is_some_and(|hand| hand.queued > 0);
        let mut others: Vec<_> = attempts.iter().map(|&(other, _)| other).filter(|&w| w != worker).collect();
        others.sort_unstable();
        others.dedup();
        others.retain(holds);
        others
    }

    /// The workers had other frames to render first: nobody was silent before now.
    pub fn restart_clocks(&mut self, now: Duration) {
        for hand in self.crew.values_mut() {
            hand.since = hand.since.max(now);
        }
    }

    /// Takes a result: `true` if it is the first for its tile, `false` if it must be dropped.
    pub fn accept(
        &mut self,
        worker: WorkerId,
        tile: TileId,
        attempt: Attempt,
        now: Duration,
    ) -> Result<bool, Violation> {
        let state = self.tiles.get_mut(tile.0 as usize);
        let Some(state) = state.filter(|state| {
            state.attempts.get(attempt.0 as usize).is_some_and(|&(holder, _)| holder == worker)
        }) else {
            return Err(Violation::NotAssigned { tile: tile.0, attempt: attempt.0 });
        };
        if let Some(hand) = self.crew.get_mut(&worker) {
            hand.worn = 0.0;
        }
        if state.done {
            self.dropped += 1;
            return Ok(false);
        }
        state.done = true;
        self.done += 1;
        while self.tiles.get(self.first_missing as usize).is_some_and(|tile| tile.done) {
            self.first_missing += 1;
        }
        if let Some(hand) = self.crew.get_mut(&worker) {
            (hand.since, hand.granted) = (now, Duration::ZERO);
        }
        for (before, (holder, _)) in (0..).zip(self.tiles[tile.0 as usize].attempts.clone()) {
            if let Some(hand) = self.crew.get_mut(&holder) {
                hand.overtaken |= before < attempt.0 && holder != worker;
                hand.missing -= 1;
                hand.trim(&self.tiles);
            }
        }
        self.shared.retain(|&other| other != tile);
        Ok(true)
    }

    /// Has `worker` render `tile`, which is in, once more; what comes of it is told by [`Dispatch::compared`], not [`Dispatch::accept`].
    /// `None` if it takes no more.
    pub fn compare(&mut self, worker: WorkerId, tile: TileId, now: Duration) -> Option<Assignment> {
        let attempts = &mut self.tiles.get_mut(tile.0 as usize).filter(|tile| tile.done)?.attempts;
        let hand = self.crew.get_mut(&worker).filter(|hand| !hand.leaving)?;
        if hand.queued == 0 {
            hand.since = now;
        }
        hand.queued += 1;
        attempts.push((worker, now));
        Some(Assignment { worker, attempt: Attempt(attempts.len() as u32 - 1), tiles: vec![tile] })
    }

    /// What [`Dispatch::compare`] asked of `worker` is in.
    pub fn compared(&mut self, worker: WorkerId, now: Duration) {
        if let Some(hand) = self.crew.get_mut(&worker) {
            (hand.since, hand.worn) = (now, 0.0);
        }
    }

    /// How long so many tiles a worker may take that are only compared.
    pub fn compare_within(&self, tiles: u32) -> Duration {
        self.pace.compare_within(tiles)
    }

    /// `worker` takes no more tiles; those that it has rendered may still come. To be followed by [`Dispatch::lost`].
    pub fn leave(&mut self, worker: WorkerId) {
        if let Some(hand) = self.crew.get_mut(&worker) {
            hand.leaving = true;
        }
    }

    /// `worker` is gone; who gets its unfinished tiles. With no worker left they wait (see
    /// [`Dispatch::workers`]).
    pub fn lost(&mut self, worker: WorkerId, now: Duration) -> Vec<Assignment> {
        let Some(hand) = self.crew.remove(&worker) else { return Vec::new() };
        for tile in hand.alone_with.into_iter().rev() {
            if !self.tiles[tile.0 as usize].done {
                self.pool.push_front(tile);
            }
        }
        for tile in std::mem::take(&mut self.shared) {
            let attempts = &self.tiles[tile.0 as usize].attempts;
            let holders: Vec<_> = attempts
                .iter()
                .map(|(holder, _)| holder)
                .filter(|holder| self.crew.contains_key(holder))
                .collect();
            match holders[..] {
                [&left] => self.crew.entry(left).or_default().alone_with.push(tile),
                _ => self.shared.push(tile),
            }
        }
        self.hand_out(now)
    }

    /// When [`Dispatch::tick`] has something to hand out, or [`Dispatch::stalled`] a worker to name, if nothing comes before.
    pub fn deadline(&self) -> Option<Duration> {
        let late = self.late().map(|(at, ..)| at);
        late.chain(self.stalls().map(|(_, at)| at)).min()
    }

    /// Time has passed: tiles of workers that are late now, for those that idle.
    pub fn tick(&mut self, now: Duration) -> Vec<Assignment> {
        self.hand_out(now)
    }

    /// Workers that are silent for so long that they must be taken for dead, alive or not.
    pub fn stalled(&self, now: Duration) -> impl Iterator<Item = WorkerId> {
        self.stalls().filter(move |&(_, at)| at <= now).map(|(worker, _)| worker)
    }

    /// Whether `worker` has nothing left to render and pixels to return.
    pub fn owes(&self, worker: WorkerId) -> bool {
        self.crew.get(&worker).is_some_and(|hand| hand.queued == 0 && hand.missing > 0)
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

    /// Living workers that take more tiles.
    pub fn staying(&self) -> impl Iterator<Item = WorkerId> {
        self.crew.iter().filter(|(_, hand)| !hand.leaving).map(|(&worker, _)| worker)
    }

    /// Living workers.
    pub fn workers(&self) -> usize {
        self.crew.len()
    }

    /// Whether every tile that is with a living worker is said to be rendered.
    pub fn all_rendered(&self) -> bool {
        self.pool.is_empty() && self.crew.values().all(|hand| hand.queued == 0)
    }

    /// When a tile was handed out for the time `attempt`.
    pub fn assigned_at(&self, tile: TileId, attempt: Attempt) -> Option<Duration> {
        self.tiles.get(tile.0 as usize)?.attempts.get(attempt.0 as usize).map(|&(_, at)| at)
    }

    /// Results that came twice and were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Gives every tile of the pool to its owner, an index into `workers`.
    fn deal(
        &mut self,
        workers: &[WorkerId],
        owner: impl Fn(TileId) -> u32,
        now: Duration,
    ) -> Vec<Assignment> {
        let mut handed = Handed::default();
        while let Some(tile) = self.pool.pop_front() {
            self.give(workers[owner(tile) as usize], tile, now, &mut handed);
        }
        handed.into_assignments()
    }

    /// Gives tiles of the pool to whoever has fewest, as far as the balancing lets workers hold them; when it is empty, the last tiles
    /// of late workers to those that have none.
    fn hand_out(&mut self, now: Duration) -> Vec<Assignment> {
        let mut handed = Handed::default();
        while let Some(&tile) = self.pool.front() {
            if self.tiles[tile.0 as usize].done {
                self.pool.pop_front();
                continue;
            }
            let staying = self.crew.iter().filter(|(_, hand)| !hand.leaving);
            let Some((&worker, hand)) = staying.min_by_key(|(_, hand)| hand.queued) else { break };
            if hand.queued as usize >= self.credit() {
                break;
            }
            if let Some(late) = self.holds_up(worker, now) {
                self.share(late, TileId(self.first_missing));
                self.give(worker, TileId(self.first_missing), now, &mut handed);
                continue;
            }
            self.pool.pop_front();
            self.give(worker, tile, now, &mut handed);
        }
        while let Some((_, late, idle)) = self.late().filter(|&(at, ..)| at <= now).min() {
            // Its last, and not the one that it is at: if it is only slow, the two meet in the middle.
            let last = self.crew.get(&late).and_then(|hand| hand.alone_with.last().copied());
            let Some(tile) = last else { break };
            self.share(late, tile);
            self.give(idle, tile, now, &mut handed);
        }
        handed.into_assignments()
    }

    /// Who has the first missing tile alone and is late with it, if too many wait for it and `helper` is another.
    fn holds_up(&self, helper: WorkerId, now: Duration) -> Option<WorkerId> {
        if self.done - self.first_missing <= self.may_wait {
            return None;
        }
        let first = TileId(self.first_missing);
        let (&late, hand) = self.crew.iter().find(|(_, hand)| hand.alone_with.contains(&first))?;
        let is_late = hand.since + self.pace.late_after(late, hand.queued, helper) <= now;
        let is_help = late != helper && self.crew.get(&helper).is_none_or(|hand| !hand.overtaken);
        (is_help && is_late).then_some(late)
    }

    /// `tile`, which `late` has alone, is about to go to another as well.
    fn share(&mut self, late: WorkerId, tile: TileId) {
        if let Some(hand) = self.crew.get_mut(&late) {
            hand.alone_with.retain(|&other| other != tile);
            hand.trim(&self.tiles);
        }
        self.shared.push(tile);
    }

    /// Tiles that a worker may hold now.
    fn credit(&self) -> usize {
        match self.balance {
            Balance::PaperDynamic => 1,
            balance if balance.is_dealt() => usize::MAX,
            _ => (self.pool.len() / self.crew.len().max(1)).clamp(1, PREFETCH),
        }
    }

    /// Workers with unfinished tiles that another one could render as well: from when on they are late, and who that is.
    fn late(&self) -> impl Iterator<Item = (Duration, WorkerId, WorkerId)> {
        // Nobody idles while the pool has tiles. The two that are the fastest are enough to find one that is another.
        let is_idle =
            |hand: &Hand| hand.queued == 0 && !hand.leaving && !hand.overtaken && self.pool.is_empty();
        let mut idle = [None, None];
        for (&worker, _) in self.crew.iter().filter(|(_, hand)| is_idle(hand)) {
            let mut next = Some((self.pace.rank(worker), worker));
            for place in &mut idle {
                if place.is_none_or(|held| next.is_some_and(|next| next < held)) {
                    std::mem::swap(place, &mut next);
                }
            }
        }
        let idle = idle.map(|place| place.map(|(_, worker)| worker));
        self.crew.iter().filter(|(_, hand)| !hand.alone_with.is_empty()).filter_map(move |(&worker, hand)| {
            let other = idle.into_iter().flatten().find(|&other| other != worker)?;
            Some((hand.since + self.pace.late_after(worker, hand.queued, other), worker, other))
        })
    }

    /// Workers that have tiles to render, and when each must be taken for dead.
    fn stalls(&self) -> impl Iterator<Item = (WorkerId, Duration)> {
        let busy = self.crew.iter().filter(|(_, hand)| hand.queued > 0);
        busy.map(|(&worker, hand)| {
            let after = self.stalled_after(hand);
            (worker, hand.since + after.saturating_sub(after.mul_f64(hand.worn)))
        })
    }

    /// How long a worker may be silent before it is taken for dead.
    fn stalled_after(&self, hand: &Hand) -> Duration {
        self.pace.stalled_after(hand.queued).saturating_add(hand.granted)
    }

    /// Notes that a tile is handed out.
    fn give(&mut self, worker: WorkerId, id: TileId, now: Duration, handed: &mut Handed) {
        let tile = &mut self.tiles[id.0 as usize];
        handed.0.entry((worker, tile.attempts.len() as u32)).or_default().push(id);
        tile.attempts.push((worker, now));
        let hand = self.crew.entry(worker).or_default();
        if hand.queued == 0 {
            (hand.since, hand.granted) = (now, Duration::ZERO);
        }
        hand.queued += 1;
        hand.missing += 1;
        if !self.shared.contains(&id) {
            hand.alone_with.push(id);
        }
    }
}

impl Hand {
    /// Keeps the promise of `alone_with`.
    fn trim(&mut self, tiles: &[Tile]) {
        while self.alone_with.pop_if(|tile| tiles[tile.0 as usize].done).is_some() {}
    }
}

/// Tiles handed out at once, by worker and attempt.
#[derive(Default)]
struct Handed(BTreeMap<(WorkerId, u32), Vec<TileId>>);

impl Handed {
    fn into_assignments(self) -> Vec<Assignment> {
        let assignment = |((worker, attempt), tiles)| Assignment { worker, attempt: Attempt(attempt), tiles };
        self.0.into_iter().map(assignment).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(100);
    const SECOND: Duration = Duration::from_secs(1);

    fn workers(count: u32) -> Vec<WorkerId> {
        (0..count).map(WorkerId).collect()
    }

    /// A frame of `tiles` tiles of one sample each.
    fn start(tiles: u32, balance: Balance, count: u32) -> (Dispatch, Vec<Assignment>) {
        Dispatch::start(&TileGrid::new(tiles, 1, 1).unwrap(), balance, 1, &workers(count), NOW)
    }

    fn given(assignments: &[Assignment], worker: u32) -> Vec<u32> {
        let of = assignments.iter().filter(|a| a.worker == WorkerId(worker));
        of.flat_map(|a| a.tiles.iter().map(|t| t.0)).collect()
    }

    #[test]
    fn each_balancing_hands_out_what_it_promises() {
        let start = |balance| start(64, balance, 4).1;
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
        let (mut d, first) = start(9, Balance::Dynamic, 4);
        // 9 tiles, 4 workers: two each would leave one; the credit falls to one when fewer than 8 are left.
        let held = (0..4).map(|w| given(&first, w).len()).collect::<Vec<_>>();
        assert!(held.iter().all(|&n| n <= 2), "{held:?}");
        while !d.pool.is_empty() {
            for w in workers(4) {
                if d.crew[&w].queued > 0 {
                    d.rendered(w, 1, NOW).unwrap();
                }
            }
        }
        assert!(d.crew.values().all(|hand| hand.queued <= 1));
    }

    #[test]
    fn the_first_result_wins_and_duplicates_are_counted() {
        let (mut d, _) = start(2, Balance::PaperStatic, 2);
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(true));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(false));
        assert_eq!(d.dropped(), 1);
        assert!(!d.is_done());
        assert_eq!(d.accept(WorkerId(1), TileId(1), Attempt(0), NOW), Ok(true));
        assert!(d.is_done());
    }

    #[test]
    fn what_was_not_given_is_a_violation() {
        let (mut d, _) = start(4, Balance::PaperDynamic, 2);
        let wrong = |tile, attempt| Err(Violation::NotAssigned { tile, attempt });
        assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(0), NOW), wrong(0, 0));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(1), NOW), wrong(0, 1));
        assert_eq!(d.accept(WorkerId(0), TileId(3), Attempt(0), NOW), wrong(3, 0));
        assert_eq!(d.accept(WorkerId(0), TileId(4), Attempt(0), NOW), wrong(4, 0));
        assert_eq!(
            d.accept(WorkerId(0), TileId(u32::MAX), Attempt(u32::MAX), NOW),
            wrong(u32::MAX, u32::MAX)
        );
        for tiles in [0, 2] {
            assert_eq!(d.rendered(WorkerId(0), tiles, NOW), Err(Violation::Rendered { tiles, queued: 1 }));
        }
    }

    #[test]
    fn pixels_are_owed_once_everything_is_rendered() {
        let (mut d, _) = start(3, Balance::PaperStatic, 2);
        let first = WorkerId(0);
        d.rendered(first, 1, NOW).unwrap();
        assert!(!d.owes(first), "it renders the other");
        d.rendered(first, 1, NOW).unwrap();
        assert!(d.owes(first) && !d.owes(WorkerId(1)));
        d.accept(first, TileId(0), Attempt(0), NOW).unwrap();
        d.accept(first, TileId(0), Attempt(0), NOW).unwrap();
        assert!(d.owes(first), "one tile twice is not two tiles");
        d.lost(WorkerId(1), NOW);
        assert!(!d.owes(first), "it has the tile of the other");
        d.rendered(first, 1, NOW).unwrap();
        // The other's result still comes.
        d.accept(WorkerId(1), TileId(1), Attempt(0), NOW).unwrap();
        d.accept(first, TileId(2), Attempt(0), NOW).unwrap();
        assert!(!d.owes(first) && !d.owes(WorkerId(1)) && d.is_done());
    }

    #[test]
    fn a_lost_worker_s_tiles_go_to_the_others_and_its_late_results_still_count() {
        for balance in Balance::ALL {
            let (mut d, first) = start(12, balance, 3);
            let mine = given(&first, 1);
            assert_eq!(d.accept(WorkerId(1), TileId(mine[0]), Attempt(0), NOW), Ok(true));
            let again = d.lost(WorkerId(1), NOW);
            assert!(again.iter().all(|a| a.worker != WorkerId(1)));
            assert!(!again.iter().any(|a| a.tiles.contains(&TileId(mine[0]))), "{balance}");
            assert_eq!(d.lost(WorkerId(1), NOW), []);
            if let Some(&late) = mine.get(1) {
                // In flight when the worker left: it may win over the next attempt, whose result is then
                // dropped.
                assert_eq!(d.accept(WorkerId(1), TileId(late), Attempt(0), NOW), Ok(true));
            }
            assert_eq!(d.rendered(WorkerId(1), 1, NOW), Ok(Vec::new()), "words of the dead are ignored");
        }
    }

    #[test]
    fn a_late_worker_s_last_tile_goes_to_one_that_idles() {
        let (mut d, first) = start(2, Balance::PaperDynamic, 2);
        assert_eq!((given(&first, 0), given(&first, 1)), (vec![0], vec![1]));
        assert_eq!(d.deadline(), Some(NOW + d.pace.stalled_after(1)), "nobody idles");
        assert_eq!(d.rendered(WorkerId(1), 1, NOW + SECOND), Ok(vec![]), "worker 0 may take as long");
        let late = d.deadline().unwrap();
        assert_eq!(late, NOW + 2 * SECOND, "two means");
        assert_eq!(d.tick(late - Duration::from_nanos(1)), []);
        let again = d.tick(late);
        assert_eq!(again, [Assignment { worker: WorkerId(1), attempt: Attempt(1), tiles: vec![TileId(0)] }]);
        assert_eq!(d.tick(late * 2), [], "a tile is with two workers at most");
        assert_eq!(
            d.accept(WorkerId(0), TileId(0), Attempt(1), NOW),
            Err(Violation::NotAssigned { tile: 0, attempt: 1 })
        );
        assert_eq!(d.accept(WorkerId(1), TileId(1), Attempt(0), NOW), Ok(true));
        assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(true), "the first attempt may win");
        assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(1), NOW), Ok(false));
        assert!(d.is_done() && d.dropped() == 1);
        assert!(!d.owes(WorkerId(0)) && !d.owes(WorkerId(1)), "nothing is missing from either");
    }

    #[test]
    fn a_tile_that_holds_up_too_many_goes_to_another_while_there_are_more() {
        for may_wait in [4, u32::MAX] {
            let (mut d, first) = start(100, Balance::Dynamic, 2);
            d.keep_order(may_wait);
            assert_eq!((given(&first, 0), given(&first, 1)), (vec![0, 2, 4], vec![1, 3, 5]));
            let mut now = NOW;
            let mut ours: VecDeque<_> = [1, 3, 5].into();
            // Worker 0 is silent, worker 1 does a tile a second.
            while let Some(tile) = ours.pop_front().filter(|_| now < NOW + 20 * SECOND) {
                now += SECOND;
                let attempt = Attempt(u32::from([0, 2, 4].contains(&tile)));
                assert_eq!(d.accept(WorkerId(1), TileId(tile), attempt, now), Ok(true));
                ours.extend(given(&d.rendered(WorkerId(1), 1, now).unwrap(), 1));
                let waiting = d.done() - d.first_missing;
                // Five, and while each of the three tiles of worker 0 is rendered the two that worker 1 has in hand before it.
                assert!(may_wait == u32::MAX || waiting <= 5 + 3 * 2, "{waiting} wait");
            }
            assert_eq!(d.first_missing > 15, may_wait == 4, "{}", d.first_missing);
            assert_eq!(d.done(), 20);
        }
    }

    #[test]
    fn the_fastest_that_idles_helps() {
        let (mut d, first) = start(4, Balance::PaperDynamic, 4);
        assert_eq!(given(&first, 3), [3]);
        // Workers 0 and 3 are silent.
        d.rendered(WorkerId(2), 1, NOW + SECOND).unwrap();
        d.rendered(WorkerId(1), 1, NOW + SECOND / 2).unwrap();
        let late = d.deadline().unwrap();
        assert_eq!(late, NOW + SECOND, "two means of worker 1");
        let again = d.tick(late);
        assert_eq!((given(&again, 1), given(&again, 2)), (vec![0], vec![]));
        let again = d.rendered(WorkerId(1), 1, late + SECOND / 2).unwrap();
        assert_eq!(given(&again, 1), [3], "worker 2 would wait for a second more");
    }

    #[test]
    fn the_static_balancings_wait_longer_and_take_from_the_end() {
        let (mut d, first) = start(8, Balance::PaperStatic, 2);
        assert_eq!(given(&first, 0), [0, 2, 4, 6]);
        d.rendered(WorkerId(1), 4, NOW + 8 * SECOND).unwrap();
        // Four times two seconds a tile, for a list of four.
        assert_eq!(d.tick(NOW + 31 * SECOND), []);
        assert_eq!(given(&d.tick(NOW + 32 * SECOND), 1), [6]);
        assert_eq!(given(&d.rendered(WorkerId(1), 1, NOW + 33 * SECOND).unwrap(), 1), [4]);
        // Worker 0 is not dead, only slow.
        assert_eq!(d.rendered(WorkerId(0), 4, NOW + 34 * SECOND), Ok(vec![]));
        assert!(d.owes(WorkerId(0)));
    }

    #[test]
    fn the_second_holder_of_a_tile_keeps_it_when_the_first_is_lost_and_the_other_way_round() {
        for gone in [0, 1] {
            let (mut d, _) = start(1, Balance::Dynamic, 3);
            assert_eq!(given(&d.tick(NOW + SECOND), 1), [0], "worker 1 has no tile");
            // The other still has it: worker 2 gets it once that one is late too, which worker 0 is.
            let third = d.lost(WorkerId(gone), NOW + SECOND);
            assert_eq!(third.is_empty(), gone == 0);
            let third = [third, d.tick(NOW + 10 * SECOND)].concat();
            assert_eq!(
                third,
                [Assignment { worker: WorkerId(2), attempt: Attempt(2), tiles: vec![TileId(0)] }]
            );
            d.lost(WorkerId(1 - gone), NOW);
            assert_eq!(d.lost(WorkerId(2), NOW), []);
            assert_eq!(given(&d.join(WorkerId(7), NOW), 7), [0], "nobody else has it");
            assert_eq!(d.accept(WorkerId(7), TileId(0), Attempt(3), NOW), Ok(true));
        }
    }

    #[test]
    fn those_that_join_late_get_what_is_there() {
        let (mut d, _) = start(64, Balance::Dynamic, 1);
        assert_eq!(given(&d.join(WorkerId(5), NOW), 5).len(), PREFETCH);
        let (mut d, _) = start(64, Balance::Static, 2);
        assert_eq!(d.join(WorkerId(5), NOW), [], "all is dealt");
        let mine = d.crew[&WorkerId(0)].alone_with.clone();
        assert_eq!(given(&d.lost(WorkerId(0), NOW), 5).len(), mine.len(), "it had nothing to do");
        // Nobody was there at the start.
        let (mut d, _) = start(64, Balance::Static, 0);
        assert_eq!(given(&d.join(WorkerId(5), NOW), 5).len(), 64);
    }

    #[test]
    fn a_worker_that_never_finishes_is_named_in_the_end() {
        let (mut d, _) = start(1, Balance::Dynamic, 1);
        let deadline = d.deadline().unwrap();
        assert_eq!(deadline, NOW + d.pace.stalled_after(1), "nobody could help it");
        assert_eq!(d.stalled(deadline - Duration::from_nanos(1)).count(), 0);
        assert_eq!(d.stalled(deadline).collect::<Vec<_>>(), [WorkerId(0)]);
        d.accept(WorkerId(0), TileId(0), Attempt(0), NOW).unwrap();
        d.rendered(WorkerId(0), 1, NOW).unwrap();
        assert_eq!(d.deadline(), None);
    }

    #[test]
    fn a_finished_tile_can_be_compared_and_does_not_count() {
        let (mut d, _) = start(2, Balance::PaperStatic, 2);
        assert_eq!(d.compare(WorkerId(0), TileId(1), NOW), None, "it is not in");
        for w in [0, 1] {
            assert_eq!(d.accept(WorkerId(w), TileId(w), Attempt(0), NOW), Ok(true));
            d.rendered(WorkerId(w), 1, NOW).unwrap();
        }
        let again = d.compare(WorkerId(0), TileId(1), NOW);
        let expected = Assignment { worker: WorkerId(0), attempt: Attempt(1), tiles: vec![TileId(1)] };
        assert_eq!(again, Some(expected));
        assert!(!d.owes(WorkerId(0)), "nothing is missing from the image");
        assert!(d.deadline().is_some(), "it may stall");
        assert_eq!(d.rendered(WorkerId(0), 1, NOW + SECOND), Ok(vec![]));
        d.compared(WorkerId(0), NOW + SECOND);
        assert!(d.is_done() && d.dropped() == 0 && d.deadline().is_none());
        d.leave(WorkerId(0));
        assert_eq!(d.compare(WorkerId(0), TileId(1), NOW), None, "it takes no more");
        assert_eq!(d.compare(WorkerId(7), TileId(1), NOW), None, "nobody");
        assert_eq!(d.staying().collect::<Vec<_>>(), [WorkerId(1)]);
    }

    #[test]
    fn all_lost_leaves_the_tiles_waiting() {
        let (mut d, _) = start(3, Balance::Static, 2);
        assert!(!d.lost(WorkerId(0), NOW).is_empty());
        assert_eq!(d.lost(WorkerId(1), NOW), []);
        assert_eq!((d.workers(), d.is_done(), d.done()), (0, false, 0));
    }

    #[test]
    fn more_workers_than_tiles() {
        for balance in Balance::ALL {
            let (mut d, first) = start(1, balance, 16);
            assert_eq!(first.len(), 1, "{balance}");
            assert_eq!(d.accept(first[0].worker, TileId(0), Attempt(0), NOW), Ok(true));
            assert!(d.is_done());
        }
    }
}
