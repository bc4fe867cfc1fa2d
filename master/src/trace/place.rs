//! Workers' times on the master's clock.

use super::{FrameTrace, TraceWorker};

/// A tile on the master's clock, in microseconds from the frame's begin: each time is at or after the one before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Placed {
    /// Which of [`FrameTrace::tiles`].
    pub index: usize,
    /// Handed out.
    pub assigned: u64,
    /// Rendering began.
    pub begun: u64,
    /// Rendering ended.
    pub rendered: u64,
    /// It was handed to the transport.
    pub sent: u64,
    /// All of it was at the master.
    pub received: u64,
}

/// What a worker did in a frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkerSpans {
    /// Its tiles in the order of rendering; no two are rendered at the same time.
    pub tiles: Vec<Placed>,
    /// The least time of a way to it or back, as far as can be told.
    pub latency: u64,
}

/// Places the tiles of each of `workers` on the master's clock.
///
/// Their clocks have no common zero, and none is needed: a renderer says how long it was idle before each tile, so that its tiles lie fast
/// to each other, and as a whole they can be moved. They cannot be earlier than the first of them would begin before it was handed
/// out, nor later than one of them would come before it was sent. Between these ends lies a message's way to the worker and one back,
/// and the middle makes both equally long: what the Network Time Protocol assumes too. (If a round trip was measured, a way takes half of it at
/// most, and what is longer on the way back is pixels' time.) Where tiles do not lie fast (one was stopped, of which
/// nothing is told, or several are rendered at a time) the same limits are kept tile by tile, and what does not fit between is cut.
pub fn place(frame: &FrameTrace, workers: &[TraceWorker]) -> Vec<WorkerSpans> {
    let mut spans = vec![WorkerSpans::default(); workers.len()];
    for (index, tile) in frame.tiles.iter().enumerate() {
        let placed = Placed { index, assigned: tile.assigned_us, ..Placed::default() };
        // (A trace that was checked names workers that are there.)
        spans.extend((spans.len()..=tile.worker).map(|_| WorkerSpans::default()).collect::<Vec<_>>());
        spans[tile.worker].tiles.push(placed);
    }
    for (number, spans) in spans.iter_mut().enumerate() {
        spans.place(frame, workers.get(number).and_then(|worker| worker.round_trip_us));
    }
    spans
}

impl WorkerSpans {
    fn place(&mut self, frame: &FrameTrace, round_trip_us: Option<u64>) {
        let tile = |placed: &Placed| &frame.tiles[placed.index];
        // Find between which shifts of the whole all fit.
        let (mut now, mut earliest, mut latest) = (0_i64, i64::MIN, i64::MAX);
        for (k, placed) in self.tiles.iter().enumerate() {
            let tile = tile(placed);
            // What was idle before the first tile began in the frame before.
            now += if k == 0 { 0 } else { tile.idle_us as i64 };
            earliest = earliest.max(tile.assigned_us as i64 - now);
            now += tile.render_us as i64;
            latest = latest.min(tile.received_us as i64 - tile.waited_us as i64 - now);
        }
        if self.tiles.is_empty() {
            return;
        }
        let slack = latest.saturating_sub(earliest).max(0) as u64;
        self.latency = (slack / 2).min(round_trip_us.map_or(u64::MAX, |time| time / 2));
        let shift = earliest.saturating_add_unsigned(self.latency);
        // Move it there; where something does not fit, tile by tile.
        let mut free = 0_i64;
        let mut at = shift;
        for (k, placed) in self.tiles.iter_mut().enumerate() {
            let tile = &frame.tiles[placed.index];
            let (assigned, received) = (tile.assigned_us as i64, tile.received_us as i64);
            let received = received.max(assigned);
            let begun = at + if k == 0 { 0 } else { tile.idle_us as i64 };
            let latest_end = received - tile.waited_us as i64;
            let end = (begun.max(assigned).max(free) + tile.render_us as i64).min(latest_end);
            let begun = (end - tile.render_us as i64).max(assigned).max(free);
            let end = end.max(begun);
            let received = received.max(end);
            let sent = (end + tile.waited_us as i64).min(received);
            placed.begun = begun as u64;
            placed.rendered = end as u64;
            placed.sent = sent as u64;
            placed.received = received as u64;
            (free, at) = (end, end);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::TraceTile;

    /// A tile of worker 0.
    fn tile(assigned_us: u64, idle_us: u64, render_us: u64, waited_us: u64, received_us: u64) -> TraceTile {
        TraceTile { assigned_us, idle_us, render_us, waited_us, received_us, ..TraceTile::default() }
    }

    fn placed(tiles: Vec<TraceTile>) -> WorkerSpans {
        place(&FrameTrace { tiles, ..FrameTrace::default() }, &[TraceWorker::default()]).remove(0)
    }

    #[test]
    fn two_equal_ways_are_assumed() {
        // 10 there, 100 of rendering, 5 of waiting, 10 back; then the next, idle for 7.
        let spans = placed(vec![tile(0, 999, 100, 5, 125), tile(0, 7, 50, 5, 182)]);
        assert_eq!(spans.latency, 10);
        let [first, second] = spans.tiles[..] else { panic!("two tiles") };
        assert_eq!((first.begun, first.rendered, first.sent, first.received), (10, 110, 115, 125));
        assert_eq!((second.begun, second.rendered, second.sent, second.received), (117, 167, 172, 182));
    }

    #[test]
    fn beyond_a_measured_round_trip_it_is_pixels_that_take_time() {
        // 10 there, 100 of rendering, 90 back: half of 100 would be wrong.
        let frame = FrameTrace { tiles: vec![tile(0, 0, 100, 0, 200)], ..FrameTrace::default() };
        let worker = TraceWorker { round_trip_us: Some(20), ..TraceWorker::default() };
        let spans = place(&frame, &[worker]).remove(0);
        let tile = spans.tiles[0];
        assert_eq!((spans.latency, tile.begun, tile.sent, tile.received), (10, 10, 110, 200));
    }

    #[test]
    fn what_does_not_fit_is_cut_and_nothing_overlaps() {
        // The second says that it took longer than there was time; the third came before it can have been rendered.
        let spans =
            placed(vec![tile(0, 0, 100, 0, 100), tile(90, 0, 500, 20, 200), tile(150, 0, 10, 5, 160)]);
        let mut free = 0;
        for tile in &spans.tiles {
            assert!(tile.begun >= free && tile.begun >= tile.assigned, "{spans:?}");
            assert!(tile.begun <= tile.rendered && tile.rendered <= tile.sent && tile.sent <= tile.received);
            free = tile.rendered;
        }
    }

    #[test]
    fn a_worker_without_tiles_has_no_spans() {
        let spans = place(&FrameTrace::default(), &vec![TraceWorker::default(); 3]);
        assert!(spans.len() == 3 && spans.iter().all(|worker| worker.tiles.is_empty()));
    }
}
