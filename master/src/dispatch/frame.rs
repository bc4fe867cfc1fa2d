//! The tiles of one frame: who has which, and which are in.

mod endgame;
mod hand;

use super::{
    Balance, Knowledge,
    pace::Pace,
    policy::{Ahead, Endgame, Plan, View, plan},
};
use hand::Hand;
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque},
    time::Duration,
};
use tessera_wire::{Attempt, Camera, TileGrid, TileId, WorkerId};

/// State of one frame.
///
/// Results are idempotent: the first for a tile wins, whoever sends it; later ones are counted and dropped. That lets a tile be with
/// two workers: when nothing is left to hand out, a worker that idles is given the last tile of one that is late, or that would end
/// later. No tile is with more than two, so that at most half of what is rendered is dropped, whatever happens.
#[derive(Clone, Debug)]
pub struct Dispatch {
    /// Without lists and pool: those are in `crew` and `pool`.
    plan: Plan,
    tiles: Vec<Tile>,
    /// Not handed out and in nobody's list, or handed out to a worker that was lost; may hold tiles that came in meanwhile.
    pool: VecDeque<TileId>,
    /// Living workers.
    crew: BTreeMap<WorkerId, Hand>,
    /// Those that have nothing to render and take more.
    idle: BTreeSet<WorkerId>,
    /// Unfinished tiles that two living workers have.
    shared: BTreeSet<TileId>,
    /// Tiles that one living worker has and has not said to be rendered, by when that was expected when it was handed out.
    expected: BTreeSet<(Duration, TileId, WorkerId)>,
    /// When those that idle look for tiles that have become late.
    look_at: Option<Duration>,
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
    /// A frame that nobody has begun, of `samples` a pixel, and the first tiles for each of `workers`, of whom nothing is known.
    pub fn start(
        grid: &TileGrid,
        balance: Balance,
        samples: u32,
        workers: &[WorkerId],
        now: Duration,
    ) -> (Self, Vec<Assignment>) {
        let camera = Camera { origin: [0.0; 3], forward: [0.0; 3], right: [0.0; 3], up: [0.0; 3] };
        let known = Knowledge::default();
        let view = View { grid, camera: &camera, workers, known: &known, in_order: false };
        Self::start_as(grid, plan(balance, &view), samples, workers, now)
    }

    /// The same by a plan for these workers.
    pub fn start_as(
        grid: &TileGrid,
        mut plan: Plan,
        samples: u32,
        workers: &[WorkerId],
        now: Duration,
    ) -> (Self, Vec<Assignment>) {
        let lists = std::mem::take(&mut plan.lists);
        let mut pool: VecDeque<_> = std::mem::take(&mut plan.pool).into();
        // Without workers nobody has a list yet.
        if workers.is_empty() {
            pool = (0..grid.tiles()).map(TileId).collect();
        }
        let pace = Pace::new(
            plan.ahead == Ahead::All,
            plan.returns,
            grid.largest_tile_pixels() * u64::from(samples),
        );
        let mut this = Self {
            plan,
            tiles: vec![Tile::default(); grid.tiles() as usize],
            pool,
            crew: workers.iter().map(|&worker| (worker, Hand::default())).collect(),
            idle: workers.iter().copied().collect(),
            shared: BTreeSet::new(),
            expected: BTreeSet::new(),
            look_at: None,
            pace,
            done: 0,
            dropped: 0,
            first_missing: 0,
            may_wait: u32::MAX,
        };
        for (&worker, list) in workers.iter().zip(lists) {
            let cost = list.iter().map(|&tile| this.list_cost(tile)).sum();
            if let Some(hand) = this.crew.get_mut(&worker) {
                (hand.list, hand.list_cost) = (list.into(), cost);
            }
        }
        let assignments = this.hand_out(now);
        (this, assignments)
    }

    /// How this frame is handed out; without its lists.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Tiles are wanted in order: when more than so many wait for the first that is missing, and who has that one is late, it goes to the next
    /// worker that is handed anything.
    pub fn keep_order(&mut self, may_wait: u32) {
        self.may_wait = may_wait;
    }

    /// `workers` take part from now on: they are given what nobody has, and then what late workers have. Where tiles are dealt in advance the
    /// first is what lost workers had, which is shared out among all that join at once.
    pub fn join(&mut self, workers: &[WorkerId], now: Duration) -> Vec<Assignment> {
        for &worker in workers {
            self.crew.entry(worker).or_default();
            self.idle.insert(worker);
        }
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

    /// The workers of this frame were busy with others until now: none of them is late with it.
    pub fn restart_clocks(&mut self, now: Duration) {
        self.expected.clear();
        for worker in self.crew.keys().copied().collect::<Vec<_>>() {
            let Some(hand) = self.crew.get_mut(&worker) else { continue };
            (hand.since, hand.free_at, hand.lag) = (hand.since.max(now), now, 0.0);
            for (tile, _) in std::mem::take(&mut hand.order) {
                self.expect(worker, tile, now);
            }
        }
    }

    /// `worker` has rendered `tiles` more tiles; what it and others get next.
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
        for _ in 0..tiles {
            let Some((tile, expected)) = hand.order.pop_front() else { break };
            hand.lag = now.as_secs_f64() - expected.as_secs_f64();
            self.expected.remove(&(expected, tile, worker));
        }
        Ok(self.hand_out_to(worker, now))
    }

    /// `worker` has been told that nobody waits for some of its tiles, and will not render `tiles` of them; what it and others get next. Nothing
    /// is learnt of its pace, and it is no progress: one that answers and never renders is found out nevertheless.
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
        let mut gone = tiles;
        let (states, all_expected) = (&self.tiles, &mut self.expected);
        hand.order.retain(|&(tile, expected)| {
            let goes = gone > 0 && states[tile.0 as usize].done;
            gone -= u32::from(goes);
            if goes {
                all_expected.remove(&(expected, tile, worker));
            }
            !goes
        });
        Ok(self.hand_out_to(worker, now))
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
        let is_holder = |state: &&mut Tile| {
            state.attempts.get(attempt.0 as usize).is_some_and(|&(holder, _)| holder == worker)
        };
        let Some(state) = state.filter(is_holder) else {
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
                if let Some(&(_, expected)) = hand.order.iter().find(|(other, _)| *other == tile) {
                    self.expected.remove(&(expected, tile, holder));
                }
            }
        }
        self.shared.remove(&tile);
        Ok(true)
    }

    /// Living workers beside `worker` that have `tile` and have not said that it is rendered: it is to be taken back from them. Nobody while
    /// there are tiles for all to be handed out: who is slow would be given another one in its place, and others wait for that.
    pub fn other_holders(&self, tile: TileId, worker: WorkerId) -> Vec<WorkerId> {
        if !self.pool.is_empty() {
            return Vec::new();
        }
        let attempts = self.tiles.get(tile.0 as usize).map_or(&[][..], |tile| &tile.attempts);
        let holders = attempts.iter().map(|&(holder, _)| holder).filter(|&holder| holder != worker);
        let has = |holder: &WorkerId| {
            self.crew.get(holder).is_some_and(|hand| hand.order.iter().any(|(other, _)| *other == tile))
        };
        holders.filter(has).collect()
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
        self.idle.remove(&worker);
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
            self.idle.remove(&worker);
        }
    }

    /// `worker` is gone; who gets its unfinished tiles. With no worker left they wait (see
    /// [`Dispatch::workers`]).
    pub fn lost(&mut self, worker: WorkerId, now: Duration) -> Vec<Assignment> {
        let Some(hand) = self.crew.remove(&worker) else { return Vec::new() };
        self.idle.remove(&worker);
        for (tile, expected) in &hand.order {
            self.expected.remove(&(*expected, *tile, worker));
        }
        for tile in hand.alone_with.into_iter().chain(hand.list).rev() {
            if !self.tiles[tile.0 as usize].done {
                self.pool.push_front(tile);
            }
        }
        for tile in std::mem::take(&mut self.shared) {
            let attempts = &self.tiles[tile.0 as usize].attempts;
            let holders = attempts.iter().map(|(holder, _)| holder);
            let holders: Vec<_> = holders.filter(|holder| self.crew.contains_key(holder)).collect();
            match holders[..] {
                [&left] => self.crew.entry(left).or_default().alone_with.push(tile),
                _ => {
                    self.shared.insert(tile);
                }
            }
        }
        self.hand_out(now)
    }

    /// When [`Dispatch::tick`] has something to hand out, or [`Dispatch::stalled`] a worker to name, if nothing comes before.
    pub fn deadline(&self) -> Option<Duration> {
        let late = self.late().map(|(at, ..)| at);
        let soonest = self.look_at.filter(|_| !self.idle.is_empty() && !self.expected.is_empty());
        late.chain(soonest).chain(self.stalls().map(|(_, at)| at)).min()
    }

    /// Time has passed: tiles of workers that are late now, for those that idle.
    pub fn tick(&mut self, now: Duration) -> Vec<Assignment> {
        let mut handed = Handed::default();
        self.help(now, &mut handed);
        handed.into_assignments()
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

    /// Whether every tile is with a worker, or in.
    pub fn all_handed_out(&self) -> bool {
        self.pool.is_empty() && self.crew.values().all(|hand| hand.list.is_empty())
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
        self.all_handed_out() && self.crew.values().all(|hand| hand.queued == 0)
    }

    /// When a tile was handed out for the time `attempt`.
    pub fn assigned_at(&self, tile: TileId, attempt: Attempt) -> Option<Duration> {
        self.tiles.get(tile.0 as usize)?.attempts.get(attempt.0 as usize).map(|&(_, at)| at)
    }

    /// Results that came twice and were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Gives tiles to whoever has fewest, as far as the plan lets workers hold them; when there are none, those of others to those that
    /// have nothing.
    fn hand_out(&mut self, now: Duration) -> Vec<Assignment> {
        let mut handed = Handed::default();
        let queue = self.crew.iter().map(|(&worker, hand)| Reverse((hand.queued, worker)));
        let mut queue: BinaryHeap<_> = queue.collect();
        while let Some(Reverse((_, worker))) = queue.pop() {
            if self.give_next(worker, now, &mut handed) {
                queue.push(Reverse((self.crew[&worker].queued, worker)));
            }
        }
        self.help(now, &mut handed);
        handed.into_assignments()
    }

    /// The same when something has changed for one worker alone.
    fn hand_out_to(&mut self, worker: WorkerId, now: Duration) -> Vec<Assignment> {
        let mut handed = Handed::default();
        while self.give_next(worker, now, &mut handed) {}
        let is_idle = self.crew.get(&worker).is_some_and(|hand| hand.queued == 0 && !hand.leaving);
        if is_idle {
            self.idle.insert(worker);
        }
        if !self.idle.is_empty() {
            self.help(now, &mut handed);
        }
        handed.into_assignments()
    }

    /// Gives `worker` one more tile if it may have one.
    fn give_next(&mut self, worker: WorkerId, now: Duration, handed: &mut Handed) -> bool {
        let Some(hand) = self.crew.get(&worker).filter(|hand| !hand.leaving) else { return false };
        let (queued, ahead) = (hand.queued as usize, self.ahead_of(worker));
        if queued < ahead
            && let Some(tile) = self.crew.get_mut(&worker).and_then(|hand| hand.list.pop_front())
        {
            let cost = self.list_cost(tile);
            if let Some(hand) = self.crew.get_mut(&worker) {
                hand.list_cost -= cost;
            }
            self.give(worker, tile, now, handed);
            return true;
        }
        while self.pool.front().is_some_and(|tile| self.tiles[tile.0 as usize].done) {
            self.pool.pop_front();
        }
        // Towards the end nobody hoards the last tiles.
        let share = (self.pool.len() / self.crew.len().max(1)).max(1);
        if queued < ahead.min(if self.plan.ahead == Ahead::All { usize::MAX } else { share })
            && let Some(&tile) = self.pool.front()
        {
            if let Some(late) = self.holds_up(worker, now) {
                self.share(late, TileId(self.first_missing));
                self.give(worker, TileId(self.first_missing), now, handed);
                return true;
            }
            self.pool.pop_front();
            self.give(worker, tile, now, handed);
            return true;
        }
        if self.plan.steals
            && queued < self.ahead_to_steal(worker)
            && let Some(tile) = self.steal_for(worker, now)
        {
            self.give(worker, tile, now, handed);
            return true;
        }
        false
    }

    /// Tiles that `worker` may hold.
    fn ahead_of(&self, worker: WorkerId) -> usize {
        match self.plan.ahead {
            Ahead::All => usize::MAX,
            Ahead::One => 1,
            Ahead::RoundTrip { least } => {
                let more = self.round_trip_in_tiles(worker).ceil() as usize;
                more.saturating_add(1).max(least as usize).min(Self::AHEAD_MOST)
            }
        }
    }

    /// A worker that would hold more than so many has tiles that are too small for its link.
    const AHEAD_MOST: usize = 256;

    /// Tiles that a worker may hold when it gets one of another's list: one less than of its own, as what it does not hold yet others can
    /// still take; a second one only where the way there takes a good part of a tile.
    fn ahead_to_steal(&self, worker: WorkerId) -> usize {
        1 + (self.round_trip_in_tiles(worker) - 0.25).ceil().max(0.0) as usize
    }

    /// Tiles that `worker` renders in the time of a round trip.
    fn round_trip_in_tiles(&self, worker: WorkerId) -> f64 {
        let round_trip = self.plan.round_trips.get(&worker).copied().unwrap_or_default();
        let known = || {
            let mean = self.plan.costs.iter().sum::<f32>() / self.plan.costs.len().max(1) as f32;
            (mean > 0.0).then(|| f64::from(mean) / self.speed_of(worker))
        };
        let tile = self.pace.mean_of(worker).map(|mean| mean.as_secs_f64()).or_else(known);
        match tile {
            Some(tile) if tile > 0.0 => round_trip.as_secs_f64() / tile,
            _ => 0.0,
        }
    }

    fn speed_of(&self, worker: WorkerId) -> f64 {
        self.plan.speeds.get(&worker).copied().unwrap_or(1.0)
    }

    /// What a tile takes a worker, as far as anything is known of it.
    fn seconds(&self, worker: WorkerId, tile: TileId) -> Option<f64> {
        match self.plan.costs.get(tile.0 as usize) {
            Some(&cost) => Some(f64::from(cost) / self.speed_of(worker)),
            None => self.pace.mean_of(worker).map(|mean| mean.as_secs_f64()),
        }
    }

    /// What a tile is in a list's sum: its cost, or one of many while nothing is known.
    fn list_cost(&self, tile: TileId) -> f64 {
        self.plan.costs.get(tile.0 as usize).map_or(1.0, |&cost| f64::from(cost))
    }

    /// When `worker` would end with what it has and its list.
    fn ends(&self, worker: WorkerId, hand: &Hand, now: Duration) -> f64 {
        let unit = if self.plan.costs.is_empty() {
            self.pace.mean_of(worker).map_or(1.0, |mean| mean.as_secs_f64())
        } else {
            1.0 / self.speed_of(worker)
        };
        let ready = hand.free_at.as_secs_f64() + hand.lag_at(now).max(0.0);
        ready.max(now.as_secs_f64()) + hand.list_cost * unit
    }

    /// Takes the last tile of the list that would last longest, if `worker` is likely to end earlier with it.
    fn steal_for(&mut self, worker: WorkerId, now: Duration) -> Option<TileId> {
        let longest = self.crew.iter().filter(|(_, hand)| !hand.list.is_empty());
        let ends = longest.map(|(&other, hand)| (self.ends(other, hand, now), other));
        let (ends, other) = ends.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let &tile = self.crew.get(&other)?.list.back()?;
        let begins = self.crew.get(&worker)?.free_at.max(now).as_secs_f64();
        if let Some(mine) = self.seconds(worker, tile)
            && other != worker
            && begins + mine > ends
        {
            return None;
        }
        let cost = self.list_cost(tile);
        let hand = self.crew.get_mut(&other)?;
        hand.list_cost -= cost;
        hand.list.pop_back()
    }

    /// Notes that a tile is handed out.
    fn give(&mut self, worker: WorkerId, id: TileId, now: Duration, handed: &mut Handed) {
        let tile = &mut self.tiles[id.0 as usize];
        handed.0.entry((worker, tile.attempts.len() as u32)).or_default().push(id);
        tile.attempts.push((worker, now));
        self.idle.remove(&worker);
        let hand = self.crew.entry(worker).or_default();
        if hand.queued == 0 {
            (hand.since, hand.granted, hand.lag) = (now, Duration::ZERO, 0.0);
        }
        hand.queued += 1;
        hand.missing += 1;
        if !self.shared.contains(&id) {
            hand.alone_with.push(id);
        }
        self.expect(worker, id, now);
    }

    /// Notes by when `worker`, which has just got it, should have rendered `tile`.
    fn expect(&mut self, worker: WorkerId, tile: TileId, now: Duration) {
        // One that is in is being taken back: nobody waits for it.
        let seconds = self.seconds(worker, tile).filter(|_| !self.tiles[tile.0 as usize].done);
        let Some(hand) = self.crew.get_mut(&worker) else { return };
        let took = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        hand.free_at = hand.free_at.max(now).saturating_add(took.unwrap_or_default());
        hand.order.push_back((tile, hand.free_at));
        if took.is_some() && !self.shared.contains(&tile) && self.plan.endgame != Endgame::Late {
            self.expected.insert((hand.free_at, tile, worker));
        }
    }

    /// `tile`, which `holder` has alone, is about to go to another as well.
    fn share(&mut self, holder: WorkerId, tile: TileId) {
        self.shared.insert(tile);
        if let Some(hand) = self.crew.get_mut(&holder) {
            hand.alone_with.retain(|other| *other != tile);
            hand.trim(&self.tiles);
            if let Some(&(_, expected)) = hand.order.iter().find(|(other, _)| *other == tile) {
                self.expected.remove(&(expected, tile, holder));
            }
        }
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
mod tests;
