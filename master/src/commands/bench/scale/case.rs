//! What is measured, and what comes of it.

use super::link::LinkProfile;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tessera_master::trace::{FrameTrace, RunTrace, TraceTile, TraceWorker};
use tessera_master::{Balance, MasterWork, TileRecord};
use tessera_wire::Coding;

/// One cluster and one way of balancing.
#[derive(Clone, Debug)]
pub struct Case {
    pub link: LinkProfile,
    pub balance: Balance,
    /// Of each worker.
    pub speeds: Vec<f64>,
}

/// A frame of a case.
#[derive(Clone, Debug)]
pub struct Measured {
    pub took: Duration,
    /// UDP payload in both directions.
    pub bytes: u64,
    /// Side of its tiles, and how many there are.
    pub tile: u32,
    pub tiles: u32,
    pub records: Vec<TileRecord>,
    pub dropped: u64,
    /// What the records count workers by.
    pub workers: Vec<TraceWorker>,
    pub coding: Coding,
    /// What the master did, and CPU time of its process: all threads, those that receive, decrypt and unpack too.
    pub master: MasterWork,
    pub master_cpu: Duration,
    /// Of the image.
    pub hash: String,
    /// Why it was balanced as it was, for `auto`.
    pub why: Option<String>,
}

/// A line of the CSV file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub link: String,
    pub balance: String,
    pub workers: usize,
    /// `replay`, `real` or `simulated`.
    pub device: String,
    pub run: u32,
    pub frame: u32,
    pub frame_ms: f64,
    /// Sum of tile costs over sum of speeds, and one worker's share of the bytes on the link.
    pub ideal_ms: f64,
    pub bytes: u64,
    /// Side of a tile.
    pub tile: u32,
    /// Time of a tile, all together, over the sum of the workers' time.
    pub busy_share: f64,
    /// From the last tile's rendering to the complete image.
    pub after_ms: f64,
    /// Messages that the master's thread took and sent, and how long it was at work.
    pub messages: u64,
    pub master_ms: f64,
    /// CPU time of the master's process.
    pub master_cpu_ms: f64,
    /// How many tiles there are.
    pub tiles: u32,
    /// Results that were dropped.
    pub dropped: u64,
    /// What the simulator says that the frame takes, where it was asked.
    pub predicted_ms: Option<f64>,
    /// Why `auto` has handed tiles out as it has.
    pub why: Option<String>,
}

impl Row {
    pub const COLUMNS: [&str; 20] = [
        "scene",
        "link",
        "balance",
        "workers",
        "device",
        "run",
        "frame",
        "frame_ms",
        "ideal_ms",
        "bytes",
        "tile",
        "busy_share",
        "after_ms",
        "messages",
        "master_ms",
        "master_cpu_ms",
        "tiles",
        "dropped",
        "predicted_ms",
        "why",
    ];

    /// As [`Row::COLUMNS`] says.
    pub fn cells(&self) -> [String; 20] {
        [
            self.scene.clone(),
            self.link.clone(),
            self.balance.clone(),
            self.workers.to_string(),
            self.device.clone(),
            self.run.to_string(),
            self.frame.to_string(),
            format!("{:.3}", self.frame_ms),
            format!("{:.3}", self.ideal_ms),
            self.bytes.to_string(),
            self.tile.to_string(),
            format!("{:.4}", self.busy_share),
            format!("{:.3}", self.after_ms),
            self.messages.to_string(),
            format!("{:.3}", self.master_ms),
            format!("{:.3}", self.master_cpu_ms),
            self.tiles.to_string(),
            self.dropped.to_string(),
            self.predicted_ms.map_or(String::new(), |ms| format!("{ms:.3}")),
            self.why.clone().unwrap_or_default(),
        ]
    }
}

impl Case {
    /// The shortest time that a frame can take that costs one worker of speed 1 `work` and has `bytes` on the wire.
    pub fn ideal(&self, work: Duration, bytes: u64) -> Duration {
        let speeds: f64 = self.speeds.iter().sum();
        let share = bytes as f64 / self.speeds.len() as f64;
        let rate = self.link.mbit_up.map_or(f64::INFINITY, |mbit| mbit * 125_000.0);
        work.div_f64(speeds)
            + Duration::from_secs_f64(share / rate)
            + Duration::from_secs_f64(1e-3 * self.link.latency_ms)
    }
}

impl Measured {
    /// What `tessera why-slow` and trace viewers read.
    pub fn trace(&self, case: &Case, scene: &str, size: [u32; 2]) -> RunTrace {
        let workers = self.workers.iter().zip(&case.speeds);
        RunTrace {
            version: RunTrace::VERSION,
            scene: scene.into(),
            link: Some(case.link.name.clone()),
            balance: case.balance.name().into(),
            coding: self.coding.name().into(),
            size,
            tile: self.tile,
            workers: workers.map(|(w, &speed)| TraceWorker { speed: Some(speed), ..w.clone() }).collect(),
            frames: vec![self.frame_trace()],
        }
    }

    fn frame_trace(&self) -> FrameTrace {
        let us = self.took.as_micros() as u64;
        FrameTrace {
            render_us: us,
            frame_us: us,
            master_us_per_message: self.master.us_per_message(),
            messages: Some(self.master.messages).filter(|messages| *messages > 0),
            tiles: self.records.iter().map(TraceTile::from).collect(),
            ..FrameTrace::default()
        }
    }

    /// From the last tile's rendering to the complete image, in milliseconds.
    pub fn after_ms(&self) -> f64 {
        let after = self.frame_trace().after_rendering_us(&self.workers);
        after.map_or(f64::NAN, |us| 1e-3 * us as f64)
    }

    /// Time that tiles took, all together, over that of `workers`.
    pub fn busy_share(&self, workers: usize) -> f64 {
        let busy: Duration = self.records.iter().map(|tile| tile.render).sum();
        busy.as_secs_f64() / (workers as f64 * self.took.as_secs_f64())
    }
}

/// Milliseconds.
pub fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

/// Of the middle; the mean of the two in the middle.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        n if n % 2 == 1 => Some(values[middle]),
        _ => Some(0.5 * (values[middle - 1] + values[middle])),
    }
}
