//! Where a run's time went, and what would help most. Pure: a [`RunTrace`] goes in.
//!
//! A frame that takes `T` on `n` workers has `n T` of workers' time. Every moment of it is given to one share:
//!
//! - **render**: a tile of the image was rendered.
//! - **link**: the worker had nothing to render because of the way between it and the master. It had tiles, and those rendered before were
//!   not sent yet; or a tile was on its way to it, or its word that it wants one, or pixels before which the master handed out nothing; or all
//!   was rendered, and pixels were waiting or travelling.
//! - **imbalance**: others had tiles that they had not begun, and this one had none; or it rendered what another had rendered already.
//! - **tail**: it waited for the last tile, which another was rendering.
//! - **master**: the rest. The master had not handed out the next tile though it was asked, or was not done with what had come; the worker
//!   was between two tiles though it had both, and could send. Where the master's time for each message is known, and makes four fifths of the frame,
//!   waiting for the link is waiting for it.

mod advice;

pub use advice::{Advice, Change};

use crate::trace::{FrameTrace, Placed, RunTrace, WorkerSpans, place};
use serde::Serialize;
use std::collections::BTreeMap;

/// Where a run's time went.
#[derive(Clone, Debug, Serialize)]
pub struct SlowReport {
    /// What was rendered.
    pub scene: String,
    /// Frames of the run.
    pub frames: usize,
    /// Workers that took part.
    pub workers: usize,
    /// Mean time of a frame.
    pub frame_ms: f64,
    /// Where it went.
    pub shares: Shares,
    /// What would help most.
    pub advice: Advice,
    /// What would help less, the best first.
    pub others: Vec<Advice>,
}

/// Shares of workers' time; they add up to 1. The module says what each is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Shares {
    /// Rendering what is in the image.
    pub render: f64,
    /// Waiting for the link.
    pub link: f64,
    /// Of tiles among workers.
    pub imbalance: f64,
    /// Waiting for the last tile.
    pub tail: f64,
    /// Waiting for the master, and what is none of the others.
    pub master: f64,
}

impl Shares {
    /// Names and values, in order.
    pub fn each(&self) -> [(&'static str, f64); 5] {
        let Self { render, link, imbalance, tail, master } = *self;
        [("render", render), ("link", link), ("imbalance", imbalance), ("tail", tail), ("master", master)]
    }
}

/// Explains a run.
///
/// # Errors
/// What is wrong with it: it cannot be read, or there is nothing in it to explain.
pub fn explain(run: &RunTrace) -> Result<SlowReport, String> {
    run.check()?;
    let mut sums = Sums::default();
    run.frames.iter().for_each(|frame| sums.add(run, frame));
    if sums.all <= 0.0 {
        return Err("no frame with tiles is in it".into());
    }
    let frames = sums.frames as f64;
    let frame_ms = sums.time / frames / 1e3;
    let share = |time: f64| time / sums.all;
    let shares = Shares {
        render: share(sums.render),
        link: share(sums.messages + sums.transfers),
        imbalance: share(sums.imbalance),
        tail: share(sums.tail),
        master: share(sums.master),
    };
    let (advice, others) = advice::best(run, &sums, frame_ms);
    let workers = sums.workers;
    Ok(SlowReport {
        scene: run.scene.clone(),
        frames: sums.frames,
        workers,
        frame_ms,
        shares,
        advice,
        others,
    })
}

/// Times in microseconds of workers, over all frames.
#[derive(Debug, Default)]
struct Sums {
    frames: usize,
    /// Most workers of a frame.
    workers: usize,
    /// Of frames.
    time: f64,
    /// Of frames, times their workers: the sum of those below.
    all: f64,
    render: f64,
    /// Of the link's share, waiting for words and tiles' numbers.
    messages: f64,
    /// Of the link's share, waiting for pixels.
    transfers: f64,
    imbalance: f64,
    tail: f64,
    master: f64,
    /// Of the master's thread, where it is known.
    master_busy: f64,
    /// Of workers by number: tiles rendered, their time, and whether the worker was the last to render, how often.
    of_workers: Vec<OfWorker>,
    /// How many times as long as the mean tile of its worker the last tile of a frame took, at most.
    last_tile: f64,
}

#[derive(Clone, Debug, Default)]
struct OfWorker {
    tiles: u64,
    render: f64,
    was_last: u64,
    /// What its tiles took over what those of others around them took.
    beside: Vec<f64>,
}

impl OfWorker {
    fn mean(&self) -> Option<f64> {
        (self.tiles > 0).then(|| self.render / self.tiles as f64)
    }
}

impl Sums {
    fn add(&mut self, run: &RunTrace, frame: &FrameTrace) {
        let end = frame.frame_us;
        let spans = place(frame, &run.workers);
        let takes_part = |(k, spans): (usize, &WorkerSpans)| {
            !spans.tiles.is_empty() || run.workers.get(k).is_some_and(|worker| worker.lost.is_none())
        };
        if end == 0 || frame.tiles.is_empty() {
            return;
        }
        // Find the tile that was rendered last.
        let ends = spans.iter().enumerate().filter_map(|(k, spans)| Some((k, *spans.tiles.last()?)));
        let Some((last_worker, last)) = ends.max_by_key(|(_, placed)| placed.rendered) else { return };
        let all_received = frame.tiles.iter().map(|tile| tile.received_us).max().unwrap_or(0);
        let received = all_received.clamp(last.rendered.min(end), end);
        // Give every worker's time to the shares.
        let before = (self.messages, self.transfers);
        let mut workers = 0;
        for (_, spans) in spans.iter().enumerate().filter(|worker| takes_part(*worker)) {
            workers += 1;
            let free = self.add_rendering(frame, spans, end);
            let all_rendered = last.rendered.min(end);
            let last_begun = last.begun.clamp(free.min(all_rendered), all_rendered);
            self.imbalance += length(free, last_begun);
            self.tail += length(last_begun.max(free), all_rendered);
            self.transfers += length(all_rendered.max(free), received);
            self.master += length(received.max(free), end);
        }
        // Where the master has no time left, what came to it waited there.
        let messages = frame.messages.unwrap_or(3 * frame.tiles.len() as u64) as f64;
        let busy = frame.master_us_per_message.map_or(0.0, |each| each * messages).min(end as f64);
        if busy >= MASTER_BUSY * end as f64 {
            self.master += self.messages - before.0 + self.transfers - before.1;
            (self.messages, self.transfers) = before;
        }
        self.master_busy += busy;
        self.frames += 1;
        self.workers = self.workers.max(workers);
        self.time += end as f64;
        self.all += end as f64 * workers as f64;
        // Note whose tiles take how long.
        self.of_workers.resize(self.of_workers.len().max(spans.len()), OfWorker::default());
        for tile in &frame.tiles {
            let of = &mut self.of_workers[tile.worker];
            of.tiles += 1;
            of.render += tile.render_us as f64;
        }
        self.compare_neighbours(run, frame);
        self.of_workers[last_worker].was_last += 1;
        let others: Vec<_> =
            spans[last_worker].tiles.iter().filter(|tile| tile.index != last.index).collect();
        let mean = others.iter().map(|tile| frame.tiles[tile.index].render_us as f64).sum::<f64>()
            / others.len().max(1) as f64;
        if mean > 0.0 {
            self.last_tile = self.last_tile.max(frame.tiles[last.index].render_us as f64 / mean);
        }
    }

    /// Holds tiles against those of other workers beside, above and below them. Of the two directions the one counts that makes less of it:
    /// a costly column is not its worker's fault.
    fn compare_neighbours(&mut self, run: &RunTrace, frame: &FrameTrace) {
        let columns = run.size[0].div_ceil(run.tile.max(1)).max(1);
        let in_image = frame.tiles.iter().filter(|tile| !tile.dropped);
        let all: BTreeMap<_, _> = in_image.map(|tile| (tile.tile, tile)).collect();
        for (&number, tile) in &all {
            let time_of = |number: Option<u32>| {
                let other = all.get(&number?).filter(|other| other.worker != tile.worker)?;
                Some(other.render_us.max(1) as f64)
            };
            let mean = |times: [Option<f64>; 2]| match times {
                [Some(a), Some(b)] => Some(0.5 * (a + b)),
                [a, b] => a.or(b),
            };
            let column = number % columns;
            let left = number.checked_sub(1).filter(|_| column > 0);
            let right = number.checked_add(1).filter(|_| column + 1 < columns);
            let row = mean([time_of(left), time_of(right)]);
            let (above, below) = (number.checked_sub(columns), number.checked_add(columns));
            let column = mean([time_of(above), time_of(below)]);
            if let (Some(row), Some(column)) = (row, column) {
                self.of_workers[tile.worker].beside.push(tile.render_us as f64 / row.max(column));
            }
        }
    }

    /// Gives a worker's time until its last tile was rendered to the shares; until when that is, `end` at most.
    fn add_rendering(&mut self, frame: &FrameTrace, spans: &WorkerSpans, end: u64) -> u64 {
        let mut free = 0;
        for (k, placed) in spans.tiles.iter().enumerate() {
            let Placed { index, assigned, begun, rendered, .. } = *placed;
            let (begun, rendered) = (begun.clamp(free, end.max(free)), rendered.clamp(free, end.max(free)));
            if assigned > free {
                // It wanted a tile: its word travels, the master does something else, the tile's number travels. While pixels that the worker
                // has sent before are longer under way than a word takes, the word stands in line behind them, or the master waits for them.
                let handed = assigned.min(begun);
                let asked = length(free, handed).min(if k == 0 { 0.0 } else { spans.latency as f64 });
                let waits = free + asked as u64;
                let behind = spans.tiles[..k].iter().map(|before| before.received.clamp(waits, handed)).max();
                let behind = length(waits, behind.unwrap_or(waits));
                self.messages += asked + length(handed, begun);
                self.transfers += behind;
                self.master += length(free, handed) - asked - behind;
            } else {
                // It had one. Either it may not go on before something is sent, or the tile has just come, or it is slow between two.
                let cannot_send = spans.tiles[..k].iter().any(|before| before.sent > free);
                let arrives = (assigned + spans.latency).clamp(free, begun);
                match cannot_send {
                    true => self.transfers += length(free, begun),
                    false => {
                        self.messages += length(free, arrives);
                        self.master += length(arrives, begun);
                    }
                }
            }
            let rendering = length(begun, rendered);
            if frame.tiles[index].dropped {
                self.imbalance += rendering
            } else {
                self.render += rendering
            }
            free = rendered;
        }
        free
    }
}

/// Share of a frame that the master's thread must be busy to count as what holds it up.
const MASTER_BUSY: f64 = 0.8;

fn length(from: u64, to: u64) -> f64 {
    to.saturating_sub(from) as f64
}

#[cfg(test)]
mod tests;
