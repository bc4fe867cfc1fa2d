//! What a run has measured, tile by tile: a file that trace viewers show and `tessera why-slow` explains.

mod events;
mod place;

pub use events::{Event, TraceFile};
pub use place::{Placed, WorkerSpans, place};

use crate::{FrameJob, FrameResult, TileRecord, WorkerReport};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A measured run: one file, whose layout [`RunTrace::VERSION`] names. Times are in microseconds. What a reader does not know it skips, and
/// what is not known is null or left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunTrace {
    /// Of this layout.
    pub version: u32,
    /// What was rendered.
    pub scene: String,
    /// What lay between master and workers, if it has a name.
    #[serde(default)]
    pub link: Option<String>,
    /// How tiles got to workers.
    pub balance: String,
    /// How pixels travelled.
    pub coding: String,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Side of a tile.
    pub tile: u32,
    /// Who took part.
    pub workers: Vec<TraceWorker>,
    /// One after the other.
    pub frames: Vec<FrameTrace>,
}

/// A worker of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TraceWorker {
    /// Its name.
    pub name: String,
    /// How fast it is beside the others, if that is known from elsewhere: of `tessera bench scale`.
    #[serde(default)]
    pub speed: Option<f64>,
    /// The shortest round trip to it, if it was measured.
    #[serde(default)]
    pub round_trip_us: Option<u64>,
    /// Why it was lost, or had no part, if so.
    #[serde(default)]
    pub lost: Option<String>,
}

/// A frame of a run. Times of the master's clock count from its begin.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTrace {
    /// Sending the scene, before the frame.
    #[serde(default)]
    pub send_scene_us: u64,
    /// Until the last word that a tile is rendered.
    pub render_us: u64,
    /// Until the image was complete.
    pub frame_us: u64,
    /// Time of the master's thread for each message, if it was measured.
    #[serde(default)]
    pub master_us_per_message: Option<f64>,
    /// Messages of the frame that it was measured over.
    #[serde(default)]
    pub messages: Option<u64>,
    /// Every result, in the order of coming.
    pub tiles: Vec<TraceTile>,
}

/// A result: see [`TileRecord`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceTile {
    /// Which tile.
    pub tile: u32,
    /// Times that it had been handed out before.
    pub attempt: u32,
    /// Whose: an index into [`RunTrace::workers`].
    pub worker: usize,
    /// When it was handed out, by the master's clock.
    pub assigned_us: u64,
    /// When all of its bytes were there, by the master's clock.
    pub received_us: u64,
    /// How long the worker's renderer had nothing to do before it.
    pub idle_us: u64,
    /// Of rendering.
    pub render_us: u64,
    /// Of coding.
    pub coding_us: u64,
    /// From the end of rendering until it was handed to the transport, coding included.
    pub waited_us: u64,
    /// Bytes on the wire.
    pub wire_bytes: u64,
    /// Bytes of its pixels.
    pub pixel_bytes: u32,
    /// Whether another result is the one in the image.
    #[serde(default)]
    pub dropped: bool,
}

impl RunTrace {
    /// Of this layout.
    pub const VERSION: u32 = 1;

    /// A run of one frame, of `scene`.
    pub fn of_frame<I>(scene: &str, job: &FrameJob, result: &FrameResult<I>) -> Self {
        Self {
            version: Self::VERSION,
            scene: scene.to_owned(),
            link: None,
            balance: job.balance.name().into(),
            coding: result.coding.name().into(),
            size: [job.width, job.height],
            tile: if result.tile > 0 { result.tile } else { job.tile },
            workers: result.workers.iter().map(TraceWorker::from).collect(),
            frames: vec![FrameTrace::of(result)],
        }
    }

    /// Whether it can be read: of a known version, every tile of a worker that is there, no time that overflows others.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        /// Thirty days, of so many tiles and frames: sums stay far from the ends of their types.
        const LONGEST_US: u64 = 30 * 24 * 3_600_000_000;
        const TILES: usize = 1 << 18;
        const FRAMES: usize = 1 << 20;
        if self.version != Self::VERSION {
            return Err(format!("a trace of version {}, this program reads {}", self.version, Self::VERSION));
        }
        if self.frames.len() > FRAMES || self.frames.iter().any(|frame| frame.tiles.len() > TILES) {
            return Err(format!("more than {FRAMES} frames, or than {TILES} results of one"));
        }
        for frame in &self.frames {
            if frame.frame_us.max(frame.render_us).max(frame.send_scene_us) > LONGEST_US {
                return Err("a frame of more than 30 days".into());
            }
            if frame.master_us_per_message.is_some_and(|time| !(time >= 0.0 && time < LONGEST_US as f64)) {
                return Err("a time of a message that is none".into());
            }
            for tile in &frame.tiles {
                let TraceTile { assigned_us, received_us, idle_us, render_us, coding_us, waited_us, .. } =
                    *tile;
                let times = [assigned_us, received_us, idle_us, render_us, coding_us, waited_us];
                if tile.worker >= self.workers.len() {
                    return Err(format!(
                        "tile {} is of worker {}, which is not there",
                        tile.tile, tile.worker
                    ));
                }
                if times.iter().any(|time| *time > LONGEST_US) {
                    return Err(format!("tile {} took more than 30 days", tile.tile));
                }
            }
        }
        Ok(())
    }
}

impl FrameTrace {
    /// Of one frame; to be added to the frames of a run with the same workers. The scene is sent once: of later frames that time is to be left out.
    pub fn of<I>(result: &FrameResult<I>) -> Self {
        let timings = &result.timings;
        Self {
            send_scene_us: micros(timings.send_scene),
            render_us: micros(timings.render),
            frame_us: micros(timings.frame),
            master_us_per_message: result.master.us_per_message(),
            messages: Some(result.master.messages).filter(|messages| *messages > 0),
            tiles: result.tiles.iter().map(TraceTile::from).collect(),
        }
    }

    /// From the moment at which the last tile of the image was rendered until the image was complete; `None` of a frame without tiles.
    pub fn after_rendering_us(&self, workers: &[TraceWorker]) -> Option<u64> {
        let spans = place(self, workers);
        let placed = spans.iter().flat_map(|worker| &worker.tiles);
        let of_image = placed.filter(|placed| !self.tiles[placed.index].dropped);
        of_image.map(|placed| self.frame_us.saturating_sub(placed.rendered)).min()
    }
}

impl From<&WorkerReport> for TraceWorker {
    fn from(report: &WorkerReport) -> Self {
        Self {
            name: report.name.clone(),
            speed: None,
            round_trip_us: report.round_trip.map(micros),
            lost: report.lost.clone().or_else(|| report.rejected.clone()),
        }
    }
}

impl From<&TileRecord> for TraceTile {
    fn from(record: &TileRecord) -> Self {
        Self {
            tile: record.tile.0,
            attempt: record.attempt.0,
            worker: record.worker,
            assigned_us: micros(record.assigned),
            received_us: micros(record.received),
            idle_us: micros(record.idle),
            render_us: micros(record.render),
            coding_us: micros(record.coding),
            waited_us: micros(record.waited),
            wire_bytes: record.wire_bytes,
            pixel_bytes: record.pixel_bytes,
            dropped: !record.is_first,
        }
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}
