//! Cases in the simulator.

use super::case::{Case, Measured};
use super::recorded::Recorded;
use super::sim::{Costs, Fault, Plot, simulate};
use crate::commands::CommandError;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::time::Duration;
use tessera_master::FrameJob;
use tessera_master::trace::TraceWorker;
use tessera_wire::{Coding, Rect};

/// Devices that are nowhere.
pub struct Simulated<'a> {
    pub recorded: &'a Recorded,
    /// What a second of the recording takes a device of speed 1.
    pub scale: f64,
    /// What a tile costs besides.
    pub launch: Duration,
    pub costs: Costs,
    /// Which row of the recording is the image's first.
    pub first_row: u32,
}

impl Simulated<'_> {
    /// Frames of a case, the first ones too, in which policies learn.
    pub fn run(
        &self,
        case: &Case,
        job: &FrameJob,
        frames: usize,
        faults: &[Fault],
    ) -> Result<Vec<Measured>, CommandError> {
        let there = |rect: Rect| Rect { y: rect.y + self.first_row, ..rect };
        let cost = |_: usize, rect: Rect| self.recorded.cost(there(rect)).mul_f64(self.scale) + self.launch;
        // A tile is coded once: its bytes are the same in every frame.
        let coded = RefCell::new(BTreeMap::<(u32, u32, u32), u32>::new());
        let bytes_of = |rect: Rect| {
            let key = (rect.x, rect.y, rect.width);
            *coded.borrow_mut().entry(key).or_insert_with(|| self.recorded.wire_bytes(there(rect)) as u32)
        };
        // As a cluster of processes begins, before it has measured anything.
        let coding = Some(job.coding.unwrap_or(Coding::Lossless))
            .filter(|_| !case.link.is_straight() || job.coding.is_some());
        let job = FrameJob { balance: case.balance, coding, ..job.clone() };
        let plot = Plot {
            link: &case.link,
            speeds: &case.speeds,
            cost: &cost,
            coded: &bytes_of,
            job: &job,
            frames,
            costs: self.costs,
            faults,
        };
        let frames = simulate(&plot).map_err(CommandError::Failed)?;
        let round_trip_us = Some((2e3 * case.link.latency_ms) as u64);
        let worker = |k| TraceWorker { name: format!("w{k}"), round_trip_us, ..TraceWorker::default() };
        let workers: Vec<_> = (0..case.speeds.len()).map(worker).collect();
        let measured = frames.into_iter().map(|frame| Measured {
            took: frame.took,
            bytes: frame.bytes,
            tile: frame.tile,
            tiles: frame.count,
            records: frame.tiles,
            dropped: frame.dropped,
            workers: workers.clone(),
            coding: coding.unwrap_or_default(),
            master: frame.master,
            master_cpu: frame.master.busy,
            // The simulator has compared every pixel; they are its own.
            hash: self.recorded.hash.clone(),
            why: frame.why,
        });
        Ok(measured.collect())
    }
}
