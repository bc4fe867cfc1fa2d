//! What `bench scale` found: a file that `bench what-if` reads again.

use super::case::{Row, median};
use super::link::LinkProfile;
use super::studio::Compression;
use serde::{Deserialize, Serialize};

/// `scale.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Version of this file: 1.
    pub tessera_scale: u32,
    pub scene: String,
    pub camera: String,
    /// Columns and rows.
    pub size: [u32; 2],
    /// `replay`, `real` or `simulated`.
    pub device: String,
    /// Seconds that the frame takes one device of speed 1.
    pub one_worker_s: f64,
    /// What each tile costs a device besides, in microseconds.
    pub launch_us: u32,
    /// What the frame costs where.
    pub recording: RecordingCosts,
    pub links: Vec<LinkProfile>,
    pub rows: Vec<Row>,
    pub summaries: Vec<Summary>,
    /// The paper's Table 7, where a page was asked for.
    #[serde(default)]
    pub compression: Vec<Compression>,
    pub command: String,
    pub machine: Vec<(String, String)>,
}

/// Costs of a recorded frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RecordingCosts {
    /// Side of a recorded tile.
    pub side: u32,
    /// Microseconds of each on one core of the machine that recorded.
    pub micros: Vec<u32>,
    /// Bytes on the wire over bytes of pixels, by side of a tile.
    pub packed: Vec<(u32, f64)>,
}

/// All frames of a case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Summary {
    pub link: String,
    pub balance: String,
    pub workers: usize,
    pub frames: usize,
    /// Of the time of a frame, in milliseconds.
    pub median_ms: f64,
    pub mean_ms: f64,
    pub min_ms: f64,
    pub max_ms: f64,
    /// The shortest that there can be.
    pub ideal_ms: f64,
    /// Median over ideal.
    pub over_ideal: f64,
    /// Time of one worker with the same balancing, over the workers' number (sum of speeds) times this: as the paper counts.
    pub efficiency: Option<f64>,
    /// The same against the best time that any balancing has with one worker.
    pub efficiency_best: Option<f64>,
    /// Median over that of `paper-static`.
    pub to_paper_static: Option<f64>,
    /// Bytes of a frame.
    pub bytes: f64,
    /// Time that workers had nothing to render.
    pub idle_share: f64,
    /// From the last tile's rendering to the complete image, in milliseconds.
    pub after_ms: f64,
    /// Of the master's thread, in microseconds for each message.
    pub master_us_per_message: f64,
    /// CPU time of the master's process, in microseconds for each tile.
    pub master_cpu_us_per_tile: f64,
    /// What the simulator said over what was measured.
    pub predicted: Option<f64>,
}

/// Summaries of all cases, in the order of the rows.
pub fn summaries(rows: &[Row], speeds: impl Fn(usize) -> f64) -> Vec<Summary> {
    let mut found: Vec<Summary> = Vec::new();
    for row in rows {
        let is_of = |s: &Summary| (&s.link, &s.balance, s.workers) == (&row.link, &row.balance, row.workers);
        if !found.iter().any(is_of) {
            found.push(summary(rows, row));
        }
    }
    let ones: Vec<_> = found.iter().filter(|s| s.workers == 1).cloned().collect();
    let static_ones: Vec<_> = found.iter().filter(|s| s.balance == "paper-static").cloned().collect();
    for summary in &mut found {
        let of_link = || ones.iter().filter(|one| one.link == summary.link);
        // (The one of one worker has a speed too.)
        let of = |one: f64| one * speeds(1) / (speeds(summary.workers) * summary.median_ms);
        let own = of_link().find(|one| one.balance == summary.balance).map(|one| one.median_ms);
        let best = of_link().map(|one| one.median_ms).min_by(f64::total_cmp);
        (summary.efficiency, summary.efficiency_best) = (own.map(of), best.map(of));
        let paper = static_ones.iter().find(|s| (&s.link, s.workers) == (&summary.link, summary.workers));
        summary.to_paper_static = paper.map(|paper| summary.median_ms / paper.median_ms);
    }
    found
}

fn summary(rows: &[Row], like: &Row) -> Summary {
    let is_like = |r: &&Row| (&r.link, &r.balance, r.workers) == (&like.link, &like.balance, like.workers);
    let of = |value: fn(&Row) -> f64| rows.iter().filter(is_like).map(value).collect::<Vec<_>>();
    let times = of(|row| row.frame_ms);
    let mid = |values: Vec<f64>| median(&values).unwrap_or(f64::NAN);
    let median_ms = mid(times.clone());
    let ideal_ms = mid(of(|row| row.ideal_ms));
    Summary {
        link: like.link.clone(),
        balance: like.balance.clone(),
        workers: like.workers,
        frames: times.len(),
        median_ms,
        mean_ms: times.iter().sum::<f64>() / times.len() as f64,
        min_ms: times.iter().copied().fold(f64::INFINITY, f64::min),
        max_ms: times.iter().copied().fold(0.0, f64::max),
        ideal_ms,
        over_ideal: median_ms / ideal_ms,
        efficiency: None,
        efficiency_best: None,
        to_paper_static: None,
        bytes: mid(of(|row| row.bytes as f64)),
        idle_share: 1.0 - mid(of(|row| row.busy_share)),
        after_ms: mid(of(|row| row.after_ms)),
        master_cpu_us_per_tile: mid(of(|row| 1e3 * row.master_cpu_ms / f64::from(row.tiles.max(1)))),
        master_us_per_message: mid(of(|row| 1e3 * row.master_ms / row.messages.max(1) as f64)),
        predicted: like.predicted_ms.map(|predicted| predicted / median_ms),
    }
}

/// How far the simulator was off: the median and the largest of |predicted / measured - 1|, and of how many cases.
pub fn prediction_error(summaries: &[Summary]) -> Option<(f64, f64, usize)> {
    let off: Vec<_> = summaries.iter().filter_map(|s| Some((s.predicted? - 1.0).abs())).collect();
    Some((median(&off)?, off.iter().copied().fold(0.0, f64::max), off.len()))
}

/// Summaries as tables for people, a link each.
pub fn text(summaries: &[Summary]) -> String {
    let mut out = String::new();
    let links = distinct(summaries.iter().map(|s| s.link.as_str()));
    let balances = distinct(summaries.iter().map(|s| s.balance.as_str()));
    let mut workers = distinct(summaries.iter().map(|s| s.workers));
    workers.sort_unstable();
    for link in links {
        out += &format!(
            "\n{link}: ms of a frame (median), over the ideal, to paper-static, simulated over measured\n{:>14}",
            "workers"
        );
        workers.iter().for_each(|n| out += &format!("{n:>28}"));
        out.push('\n');
        for balance in &balances {
            out += &format!("{balance:>14}");
            for &n in &workers {
                let is_it = |s: &&Summary| s.link == link && s.workers == n && s.balance == *balance;
                out += &summaries.iter().find(is_it).map_or(format!("{:>28}", ""), |s| {
                    let or_dash =
                        |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
                    let (paper, sim) = (or_dash(s.to_paper_static), or_dash(s.predicted));
                    format!("{:>12.1}{:>6.2}{paper:>5}{sim:>5}", s.median_ms, s.over_ideal)
                });
            }
            out.push('\n');
        }
    }
    if let Some((median, largest, cases)) = prediction_error(summaries) {
        out += &format!(
            "\nThe simulator was off by {:.1} % (median of {cases} cases), {:.1} % at most.\n",
            100.0 * median,
            100.0 * largest
        );
    }
    out
}

/// Each of `values` once, in the order of coming.
pub fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(balance: &str, workers: usize, frame_ms: f64) -> Row {
        Row {
            scene: "s".into(),
            link: "l".into(),
            balance: balance.into(),
            workers,
            device: "replay".into(),
            run: 0,
            frame: 0,
            frame_ms,
            ideal_ms: 100.0,
            bytes: 1000,
            tile: 128,
            busy_share: 0.5,
            after_ms: 1.0,
            messages: 100,
            master_ms: 2.0,
            master_cpu_ms: 4.0,
            tiles: 64,
            dropped: 0,
            predicted_ms: Some(110.0),
            why: None,
        }
    }

    #[test]
    fn efficiency_is_counted_as_the_paper_counts_and_against_the_best() {
        let rows = [
            row("paper-static", 1, 1000.0),
            row("auto", 1, 900.0),
            row("paper-static", 4, 500.0),
            row("paper-static", 4, 300.0),
            row("auto", 4, 250.0),
        ];
        let found = summaries(&rows, |workers| workers as f64);
        assert_eq!(found.len(), 4);
        let paper = &found[2];
        assert_eq!((paper.median_ms, paper.frames, paper.efficiency), (400.0, 2, Some(0.625)));
        assert_eq!(paper.efficiency_best, Some(900.0 / 1600.0));
        let auto = &found[3];
        assert_eq!((auto.to_paper_static, auto.efficiency, auto.over_ideal), (Some(0.625), Some(0.9), 2.5));
        let (median, largest, cases) = prediction_error(&found).unwrap();
        assert!((largest - 0.89).abs() < 1e-9 && cases == 4 && median > 0.5);
        assert!(text(&found).contains("paper-static"));
        // Devices of a tenth of the speed are as efficient.
        let slow = summaries(&rows, |workers| 0.1 * workers as f64);
        let pairs = slow.iter().zip(&found).filter_map(|(a, b)| Some(a.efficiency? / b.efficiency?));
        assert!(pairs.into_iter().all(|ratio| (ratio - 1.0).abs() < 1e-9));
    }
}
