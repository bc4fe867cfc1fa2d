//! The one change that would help most.

use super::{MASTER_BUSY, Sums};
use crate::{Balance, trace::RunTrace};
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

/// A worker whose tiles take so many times as long as they would others is slow.
const SLOW: f64 = 1.5;

/// A last tile that takes so many times as long as its worker's others is a costly one.
const COSTLY: f64 = 3.0;

/// What half a side makes of the cost of a tile, and twice a side of the number of messages.
const QUARTER: f64 = 0.25;

/// The change that would help most, and the others in the order of what they would bring; each estimate takes the others as they are.
pub(super) fn best(run: &RunTrace, sums: &Sums, frame_ms: f64) -> (Advice, Vec<Advice>) {
    let found = Found { run, sums, frame_ms, balance: run.balance.parse().ok() };
    let mut all = vec![found.link()];
    match found.slow_worker() {
        Some((worker, times)) => all.push(found.without(worker, times)),
        None => all.extend([found.balancing(), found.smaller_tiles()]),
    }
    all.push(if found.is_master_bound() { found.second_master() } else { found.larger_tiles() });
    all.push(found.more_workers());
    all.sort_by(|a, b| b.gain_share.total_cmp(&a.gain_share));
    let first = all.remove(0);
    (first, all)
}

/// What was found, as changes are judged by it.
struct Found<'a> {
    run: &'a RunTrace,
    sums: &'a Sums,
    frame_ms: f64,
    /// None if it is one that this program does not know.
    balance: Option<Balance>,
}

impl Found<'_> {
    fn advice(&self, change: Change, gain_share: f64, what: impl Into<String>, why: String) -> Advice {
        Advice { change, what: what.into(), why, gain_ms: gain_share * self.frame_ms, gain_share }
    }

    fn share(&self, time: f64) -> f64 {
        time / self.sums.all
    }

    fn percent(&self, time: f64) -> String {
        format!("{:.0} %", 100.0 * self.share(time))
    }

    fn is_dealt(&self) -> bool {
        self.balance.is_some_and(Balance::is_dealt)
    }

    fn link(&self) -> Advice {
        let what = match self.run.coding.as_str() {
            "raw" => "a faster link, or fewer bytes on it: --coding lossless, or rounded",
            "lossless" => "a faster link, or fewer bytes on it: --coding rounded",
            _ => "a faster link",
        };
        let time = self.sums.transfers;
        let why = format!(
            "workers wait for pixels on their way, or all wait for the last of them to come, in {} of their time",
            self.percent(time)
        );
        self.advice(Change::FasterLink, self.share(time), what, why)
    }

    fn without(&self, worker: usize, times: f64) -> Advice {
        let name = self.run.workers.get(worker).map_or("?", |worker| &worker.name);
        let what = match self.is_dealt() {
            true => {
                format!("a balancing that gives {name} what it can do (--balance dynamic), or leave it out")
            }
            false => format!("leave {name} out or replace it, or a balancing that knows how slow it is"),
        };
        let time = self.sums.imbalance + self.sums.tail;
        let why = format!(
            "its tiles take {times:.1} times as long as they take others, and these wait for it in {} of their time",
            self.percent(time)
        );
        self.advice(Change::SlowWorker, self.share(time), what, why)
    }

    fn balancing(&self) -> Advice {
        let what = match self.balance {
            Some(Balance::Auto) => format!("more tiles to share out: --tile {}", self.half_a_side()),
            _ if self.is_dealt() => {
                "a balancing that gives tiles to whoever is free: --balance dynamic".to_owned()
            }
            _ => "a balancing that takes back what others could do earlier: --balance auto".to_owned(),
        };
        let time = self.sums.imbalance;
        let mut why = format!(
            "workers have nothing to do while others have tiles that they have not begun, in {} of their time",
            self.percent(time)
        );
        if let Some((worker, times)) = self.last().filter(|(_, times)| *times >= SLOW) {
            let name = self.run.workers.get(worker).map_or("?", |worker| &worker.name);
            why += &format!("; those of {name} take {times:.1} times as long as others' do on the average");
        }
        self.advice(Change::Balancing, self.share(time), what, why)
    }

    fn smaller_tiles(&self) -> Advice {
        let cost = match self.sums.last_tile {
            times if times >= COSTLY => {
                format!(", which takes {times:.1} times as long as its worker's others")
            }
            _ => String::new(),
        };
        let time = self.sums.tail;
        let why = format!("all wait for the last tile{cost}, in {} of their time", self.percent(time));
        let what = format!("smaller tiles: --tile {}", self.half_a_side());
        self.advice(Change::SmallerTiles, (1.0 - QUARTER) * self.share(time), what, why)
    }

    fn half_a_side(&self) -> u32 {
        (self.run.tile / 2).max(1)
    }

    fn is_master_bound(&self) -> bool {
        self.sums.master_busy >= MASTER_BUSY * self.sums.time
    }

    /// Around tiles.
    fn between(&self) -> f64 {
        self.sums.messages + self.sums.master
    }

    fn second_master(&self) -> Advice {
        let why = format!(
            "the master's thread is busy in {:.0} % of the frame, and workers wait for it in {} of their time",
            100.0 * self.sums.master_busy / self.sums.time,
            self.percent(self.sums.master)
        );
        let gain = self.share(self.between());
        self.advice(Change::SecondMaster, gain, "a second master, or larger tiles", why)
    }

    fn larger_tiles(&self) -> Advice {
        let ahead = match self.balance {
            Some(Balance::PaperDynamic) => ", or tiles ahead of need (--balance dynamic)",
            _ => "",
        };
        let what = format!("larger tiles: --tile {}{ahead}", self.run.tile.saturating_mul(2));
        let tiles: u64 = self.sums.of_workers.iter().map(|worker| worker.tiles).sum();
        let each = |time: f64| time / tiles.max(1) as f64 / 1e3;
        let why = format!(
            "a tile takes {:.2} ms to render, and {:.2} ms pass around it that are not rendering: asking, handing out, beginning",
            each(self.sums.render),
            each(self.between())
        );
        self.advice(Change::LargerTiles, (1.0 - QUARTER) * self.share(self.between()), what, why)
    }

    fn more_workers(&self) -> Advice {
        let workers = self.sums.workers.max(1) as f64;
        let time = self.sums.render;
        let why =
            format!("workers render in {} of their time: there is little else to gain", self.percent(time));
        let gain = self.share(time) / (workers + 1.0);
        self.advice(Change::MoreWorkers, gain, "more workers, or faster ones", why)
    }

    /// The worker that was the last to render as often as any, and its mean tile over that of the middle one of the others.
    fn last(&self) -> Option<(usize, f64)> {
        let workers = &self.sums.of_workers;
        let most = workers.iter().map(|worker| worker.was_last).max()?;
        let (number, last) = workers.iter().enumerate().find(|(_, worker)| worker.was_last == most)?;
        let others = workers.iter().enumerate().filter(|(other, _)| *other != number);
        let middle = median(others.filter_map(|(_, worker)| worker.mean()).collect())?;
        let times = last.mean()? / middle;
        times.is_finite().then_some((number, times))
    }

    /// The worker that was the last to render, if it is slow, and how many times as long its tiles take as they would others.
    ///
    /// A mean tile that takes longer does not say so: with tiles dealt in advance, a worker may have been dealt the costly ones. Its tiles are
    /// held against those of others around them; where it was dealt whole columns or rows, nothing can be said but by speeds that are known
    /// from elsewhere. Who pulls gets tiles from all over the image, and there the mean will do.
    fn slow_worker(&self) -> Option<(usize, f64)> {
        let (number, mean) = self.last()?;
        let by_speed = || {
            let speeds: Vec<_> = self.run.workers.iter().filter_map(|worker| worker.speed).collect();
            Some(median(speeds)? / self.run.workers.get(number)?.speed?)
        };
        // One costly tile among many does not make a worker slow: it hardly moves the median, and decides the mean.
        let beside = &self.sums.of_workers.get(number)?.beside;
        let beside = median(beside.clone()).filter(|_| beside.len() > 1);
        let mean = Some(mean).filter(|_| !self.is_dealt() && self.sums.last_tile < COSTLY);
        let times = beside.or_else(by_speed).or(mean)?;
        (times >= SLOW && times.is_finite()).then_some((number, times))
    }
}

/// The one in the middle, the upper of two.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
