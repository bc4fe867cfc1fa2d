//! A cluster in one thread under a virtual clock: the same state machines of master and workers, the same policies and the same links as in
//! real runs, with what the rest takes (transport, wake-ups, the master's work) as a model that real runs are held against.

#[cfg(test)]
mod tests;
mod transport;
mod world;

use super::link::LinkProfile;
use std::time::Duration;
use tessera_master::{Balance, FrameJob, MasterWork, TileRecord};
use tessera_wire::{Rect, WorkerId};

/// A cluster that is to be simulated.
pub struct Plot<'a> {
    /// The link between all workers and the master.
    pub link: &'a LinkProfile,
    /// How fast each worker is.
    pub speeds: &'a [f64],
    /// What a piece of the image takes a worker of speed 1, in a frame by its number from 0.
    pub cost: &'a dyn Fn(usize, Rect) -> Duration,
    /// Bytes of a tile on the wire; its pixels' where it is not packed.
    pub coded: &'a dyn Fn(Rect) -> u32,
    /// Size, tiles and balancing; `coding` is what `coded` means.
    pub job: &'a FrameJob,
    /// Frames one after the other.
    pub frames: usize,
    /// What other things take.
    pub costs: Costs,
    /// What goes wrong.
    pub faults: &'a [Fault],
}

/// What is neither rendering nor link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// Of the master's processor for a tile that comes, decoding included.
    pub master_tile: Duration,
    /// And for any other message, either way.
    pub master_message: Duration,
    /// From a packet's arrival, or a timer's end, until the process that waits for it does something.
    pub wake: Duration,
    /// A worker's for coding a byte of pixels, in nanoseconds.
    pub coding_ns: f64,
}

impl Default for Costs {
    /// Measured with `bench scale` on one machine (two cores of an AMD Zen 3, loopback).
    fn default() -> Self {
        Self {
            master_tile: Duration::from_micros(40),
            master_message: Duration::from_micros(15),
            wake: Duration::from_micros(80),
            coding_ns: 2.0,
        }
    }
}

/// Something that goes wrong in the middle of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// From then on a worker is so many times as slow.
    Slows {
        /// Which worker.
        worker: usize,
        /// When, from the first frame's begin.
        at: Duration,
        /// By which factor.
        times: f64,
    },
    /// It ends without a word; the master misses it after `noticed`.
    Dies {
        /// Which worker.
        worker: usize,
        /// When, from the first frame's begin.
        at: Duration,
        /// How much later the master knows.
        noticed: Duration,
    },
    /// It joins only then.
    Joins {
        /// Which worker.
        worker: usize,
        /// When, from the first frame's begin.
        at: Duration,
    },
}

impl Fault {
    /// Whom it befalls.
    pub fn worker(&self) -> usize {
        match *self {
            Self::Slows { worker, .. } | Self::Dies { worker, .. } | Self::Joins { worker, .. } => worker,
        }
    }

    /// The same for another worker.
    pub fn with_worker(mut self, number: usize) -> Self {
        let (Self::Slows { worker, .. } | Self::Dies { worker, .. } | Self::Joins { worker, .. }) = &mut self;
        *worker = number;
        self
    }
}

/// A simulated frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// From its begin to its last tile.
    pub took: Duration,
    /// UDP payload in both directions.
    pub bytes: u64,
    /// Its results.
    pub tiles: Vec<TileRecord>,
    /// What the master did.
    pub master: MasterWork,
    /// Results that were dropped.
    pub dropped: u64,
    /// Side of its tiles, and how many there are.
    pub tile: u32,
    pub count: u32,
    /// Why it was balanced as it was, for `auto`.
    pub why: Option<String>,
}

/// Simulates `plot`.
///
/// # Errors
/// What must not happen, happened: a frame that does not end, a wrong pixel.
pub fn simulate(plot: &Plot<'_>) -> Result<Vec<Frame>, String> {
    world::World::gather(plot)?.render_all()
}

fn id(worker: usize) -> WorkerId {
    WorkerId(worker as u32)
}

/// What names a balancing in errors.
fn name(balance: Balance) -> &'static str {
    balance.name()
}
