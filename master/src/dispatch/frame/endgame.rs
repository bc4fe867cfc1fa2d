//! Tiles that go to a second worker, and workers that are given up.

use super::{Dispatch, Hand, Handed};
use crate::dispatch::policy::Endgame;
use std::time::Duration;
use tessera_wire::{TileId, WorkerId};

/// A tile that a second worker should have.
#[derive(Clone, Copy, Debug)]
struct Rescue {
    tile: TileId,
    holder: WorkerId,
    helper: WorkerId,
    /// Seconds by which it should be earlier.
    gain: f64,
}

impl Dispatch {
    /// Tiles of each end of the order of expectation that are looked at: those overdue for longest, and those expected last.
    const LOOKED_AT: usize = 8;

    /// A second worker must need less than so much of the time that the first is still expected to take: estimates are off by as much, and what
    /// is rendered twice has to be cancelled.
    const MARGIN: f64 = 1.25;

    /// How soon those that idle look again when nothing was worth it.
    const LOOK_AGAIN: Duration = Duration::from_millis(1);

    /// Gives the tiles of others to workers that have nothing.
    pub(super) fn help(&mut self, now: Duration, handed: &mut Handed) {
        if let Endgame::Soonest(least) = self.plan.endgame {
            let least = least.as_secs_f64();
            while let Some(rescue) = self.rescue(least, now) {
                self.share(rescue.holder, rescue.tile);
                self.give(rescue.helper, rescue.tile, now, handed);
            }
            self.look_at = self.next_rescue(least).map(|at| at.max(now + Self::LOOK_AGAIN));
        }
        while let Some((_, late, idle)) = self.late().filter(|&(at, ..)| at <= now).min() {
            // Its last, and not the one that it is at: if it is only slow, the two meet in the middle.
            let last = self.crew.get(&late).and_then(|hand| hand.alone_with.last().copied());
            let Some(tile) = last else { break };
            self.share(late, tile);
            self.give(idle, tile, now, handed);
        }
    }

    /// The tile that gains most by going to a second worker as well, `least` seconds or more.
    fn rescue(&self, least: f64, now: Duration) -> Option<Rescue> {
        let helper = self.helper()?;
        let ends = self
            .expected
            .iter()
            .take(Self::LOOKED_AT)
            .chain(self.expected.iter().rev().take(Self::LOOKED_AT));
        let worth = |&(expected, tile, holder): &(Duration, TileId, WorkerId)| {
            let hand = self.crew.get(&holder).filter(|_| holder != helper)?;
            let left = expected.as_secs_f64() + hand.lag_at(now).max(0.0) - now.as_secs_f64();
            // Of one that is overdue nothing better is known than that it takes as long again.
            let overdue = now.as_secs_f64() - expected.as_secs_f64();
            let left = left.max(overdue);
            let mine = self.seconds(helper, tile)? + self.round_trip(helper);
            let gain = left - mine;
            (left > Self::MARGIN * mine && gain > least).then_some(Rescue { tile, holder, helper, gain })
        };
        ends.filter_map(worth).max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// When the tile that should be finished first becomes worth it, at the earliest.
    fn next_rescue(&self, least: f64) -> Option<Duration> {
        let helper = self.helper()?;
        let &(expected, tile, _) = self.expected.iter().find(|(.., holder)| *holder != helper)?;
        let mine = self.seconds(helper, tile)? + self.round_trip(helper);
        let after = Duration::try_from_secs_f64(Self::MARGIN * mine + least).ok()?;
        expected.checked_add(after)
    }

    /// Of those that idle, the one that is the fastest, as far as is known.
    fn helper(&self) -> Option<WorkerId> {
        self.helpers().min_by_key(|&worker| (self.pace.rank(worker), worker))
    }

    /// Those that idle, and are no slower than whom they would help.
    fn helpers(&self) -> impl Iterator<Item = WorkerId> {
        let is_help = |worker: &WorkerId| self.crew.get(worker).is_some_and(|hand| !hand.overtaken);
        self.idle.iter().copied().filter(is_help)
    }

    /// How long a worker may be silent before it is taken for dead.
    pub(super) fn stalled_after(&self, hand: &Hand) -> Duration {
        self.pace.stalled_after(hand.queued).saturating_add(hand.granted)
    }

    fn round_trip(&self, worker: WorkerId) -> f64 {
        self.plan.round_trips.get(&worker).map_or(0.0, Duration::as_secs_f64)
    }

    /// Who has the first missing tile alone and is late with it, if too many wait for it and `helper` is another.
    pub(super) fn holds_up(&self, helper: WorkerId, now: Duration) -> Option<WorkerId> {
        if self.done - self.first_missing <= self.may_wait {
            return None;
        }
        let first = TileId(self.first_missing);
        let (&late, hand) = self.crew.iter().find(|(_, hand)| hand.alone_with.contains(&first))?;
        let is_late = hand.since + self.pace.late_after(late, hand.queued, helper) <= now;
        (late != helper && is_late).then_some(late)
    }

    /// Workers with unfinished tiles that another one could render as well: from when on they are late, and who that is.
    pub(super) fn late(&self) -> impl Iterator<Item = (Duration, WorkerId, WorkerId)> {
        // Nobody idles while there are tiles for it. The two that are the fastest are enough to find one that is another.
        let mut idle = [None, None];
        for worker in self.helpers().filter(|_| self.pool.is_empty()) {
            let mut next = Some((self.pace.rank(worker), worker));
            for place in &mut idle {
                if place.is_none_or(|held| next.is_some_and(|next| next < held)) {
                    std::mem::swap(place, &mut next);
                }
            }
        }
        let is_any = idle[0].is_some();
        let idle = idle.map(|place| place.map(|(_, worker)| worker));
        let crew = self.crew.iter().take(if is_any { usize::MAX } else { 0 });
        crew.filter(|(_, hand)| !hand.alone_with.is_empty()).filter_map(move |(&worker, hand)| {
            let other = idle.into_iter().flatten().find(|&other| other != worker)?;
            Some((hand.since + self.pace.late_after(worker, hand.queued, other), worker, other))
        })
    }

    /// Workers that have tiles to render, and when each must be taken for dead.
    pub(super) fn stalls(&self) -> impl Iterator<Item = (WorkerId, Duration)> {
        let busy = self.crew.iter().filter(|(_, hand)| hand.queued > 0);
        busy.map(|(&worker, hand)| {
            let after = self.stalled_after(hand);
            (worker, hand.since + after.saturating_sub(after.mul_f64(hand.worn)))
        })
    }
}
