//! The one change that would help most.

use super::{MASTER_BUSY, Sums};
use crate::trace::RunTrace;
use serde::Serialize;

/// What may be changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Change {
    /// A faster link, or fewer bytes on it.
    FasterLink,
    /// A slow worker is left out or replaced, or gets what it can do.
    SlowWorker,
    /// Tiles go to whoever is free.
    Balancing,
    /// Smaller tiles.
    SmallerTiles,
    /// Larger tiles.
    LargerTiles,
    /// One more worker.
    MoreWorkers,
    /// A second master, or larger tiles.
    SecondMaster,
}

/// A change, and what it would bring.
#[derive(Clone, Debug, Serialize)]
pub struct Advice {
    /// Which.
    pub change: Change,
    /// What to do, for people.
    pub what: String,
    /// Why.
    pub why: String,
    /// How much shorter a frame would be, estimated.
    pub gain_ms: f64,
    /// The same as a share of the frame.
    pub gain_share: f64,
}

/// A worker whose tiles take so many times as long as those of the middle one is slow.
const SLOW: f64 = 1.5;

/// A last tile that takes so many times as long as its worker's others is a costly one.
const COSTLY: f64 = 3.0;

/// What half a side makes of the cost of a tile, and twice a side of the number of messages.
const QUARTER: f64 = 0.25;

/// The change that would help most, and the others in the order of what they would bring; each estimate takes the others as they are.
pub(super) fn best(run: &RunTrace, sums: &Sums, frame_ms: f64) -> (Advice, Vec<Advice>) {
    let share = |time: f64| time / sums.all;
    let percent = |time: f64| format!("{:.0} %", 100.0 * share(time));
    let mut all = Vec::new();
    let mut add = |change, gain: f64, what: String, why: String| {
        all.push(Advice { change, what, why, gain_ms: gain * frame_ms, gain_share: gain });
    };
    let tiles: u64 = sums.of_workers.iter().map(|worker| worker.tiles).sum();
    let is_master_bound = sums.master_busy >= MASTER_BUSY * sums.time;

    let what = match run.coding.as_str() {
        "raw" => "a faster link, or fewer bytes on it: --coding lossless, or rounded",
        "lossless" => "a faster link, or fewer bytes on it: --coding rounded",
        _ => "a faster link",
    };
    let why = format!(
        "workers wait for pixels to be sent, or all wait for the last of them to come, in {} of their time",
        percent(sums.transfers)
    );
    add(Change::FasterLink, share(sums.transfers), what.into(), why);

    let held_up = sums.imbalance + sums.tail;
    let slow = slow_worker(sums);
    let is_dealt = ["static", "deal"].iter().any(|part| run.balance.contains(part));
    if let Some((worker, times)) = slow {
        let name = run.workers.get(worker).map_or("?", |worker| &worker.name);
        let what = match is_dealt {
            true => {
                format!("a balancing that gives {name} what it can do (--balance dynamic), or leave it out")
            }
            false => format!("leave {name} out or replace it, or a balancing that knows how slow it is"),
        };
        let why = format!(
            "its tiles take {times:.1} times as long as those of the middle worker, and the others wait for it in {} of their time",
            percent(held_up)
        );
        add(Change::SlowWorker, share(held_up), what, why);
    } else {
        let why = format!(
            "workers have nothing to do while others have tiles that they have not begun, in {} of their time",
            percent(sums.imbalance)
        );
        let what = "a balancing that gives tiles to whoever is free: --balance dynamic";
        add(Change::Balancing, share(sums.imbalance), what.into(), why);
        let cost = match sums.last_tile {
            times if times >= COSTLY => {
                format!(", which takes {times:.1} times as long as its worker's others")
            }
            _ => String::new(),
        };
        let why = format!("all wait for the last tile{cost}, in {} of their time", percent(sums.tail));
        let what = format!("smaller tiles: --tile {}", (run.tile / 2).max(1));
        add(Change::SmallerTiles, (1.0 - QUARTER) * share(sums.tail), what, why);
    }

    let between = sums.messages + sums.master;
    let each = |time: f64| time / tiles.max(1) as f64 / 1e3;
    if is_master_bound {
        let why = format!(
            "the master's thread is busy in {:.0} % of the frame, and workers wait for it in {} of their time",
            100.0 * sums.master_busy / sums.time,
            percent(sums.master)
        );
        add(Change::SecondMaster, share(between), "a second master, or larger tiles".into(), why);
    } else {
        let ahead = match run.balance.as_str() {
            "paper-dynamic" => ", or tiles ahead of need (--balance dynamic)",
            _ => "",
        };
        let what = format!("larger tiles: --tile {}{ahead}", run.tile.saturating_mul(2));
        let why = format!(
            "a tile takes {:.2} ms to render, and {:.2} ms pass around it that are not rendering: asking, handing out, beginning",
            each(sums.render),
            each(between)
        );
        add(Change::LargerTiles, (1.0 - QUARTER) * share(between), what, why);
    }

    let workers = sums.workers.max(1) as f64;
    let why =
        format!("workers render in {} of their time: there is little else to gain", percent(sums.render));
    let what = "more workers, or faster ones".to_owned();
    add(Change::MoreWorkers, share(sums.render) / (workers + 1.0), what, why);

    all.sort_by(|a, b| b.gain_share.total_cmp(&a.gain_share));
    let first = all.remove(0);
    (first, all)
}

/// A worker that was the last to render as often as any, and is slow: its number, and how many times as long its tiles take.
fn slow_worker(sums: &Sums) -> Option<(usize, f64)> {
    let most = sums.of_workers.iter().map(|worker| worker.was_last).max()?;
    let (number, last) = sums.of_workers.iter().enumerate().find(|(_, worker)| worker.was_last == most)?;
    let others = sums.of_workers.iter().enumerate().filter(|(other, _)| *other != number);
    let mut means: Vec<f64> = others.filter_map(|(_, worker)| worker.mean()).collect();
    means.sort_by(f64::total_cmp);
    let middle = *means.get(means.len() / 2)?;
    let times = last.mean()? / middle;
    // One costly tile among many does not make a worker slow; it is slow if the others of its tiles are.
    let is_one_tile = sums.last_tile >= COSTLY;
    (times >= SLOW && times.is_finite() && !is_one_tile).then_some((number, times))
}
