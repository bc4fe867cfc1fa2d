//! What `bench scale` and `bench tiles` have in common on the command line.

use super::devices;
use super::recorded::Recorded;
use crate::commands::args::Size;
use crate::commands::run::cores;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use tessera_master::Balance;
use tessera_wire::{Coding, limits};

/// Devices, and the frame that they render.
#[derive(Debug, Args)]
pub struct ClusterArgs {
    /// A file that `tessera render` takes
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// Speeds of the devices, SPEED or SPEEDxCOUNT separated by commas, or a file with one a line; one value is that of all
    #[arg(long, value_name = "SPEEDS|FILE", default_value = "1.0")]
    pub device_speed: String,
    /// What devices are
    #[arg(long, value_name = "KIND", value_enum, default_value_t)]
    pub device: DeviceKind,
    /// What the frame takes one device of speed 1, in seconds, where devices are played or simulated
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = seconds)]
    pub one_worker: f64,
    /// What each tile costs a device besides, in microseconds: a launch of a GPU's kernel
    #[arg(long, value_name = "US", default_value_t = 0)]
    pub launch_us: u32,
    /// Measured frames of each run
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
    /// Runs of each case; each begins with a cluster that knows nothing
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub runs: u32,
    /// One run of two frames, one frame where a worker is alone
    #[arg(long, conflicts_with_all = ["runs", "frames"])]
    pub quick: bool,
    /// Image size in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1024x1024")]
    pub size: Size,
    /// How pixels travel [default: raw with the paper's ways, as there; else as suits link and pixels]
    #[arg(long, value_name = "CODING", value_parser = coding)]
    pub coding: Option<CodingArg>,
    /// A camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Folder for what is measured: a page (index.html) with plots, scale.csv, scale.json and traces, or tiles.csv
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `--device`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceKind {
    /// Processes that play a recording
    #[default]
    Replay,
    /// Processes that render, slowed down
    Real,
    /// No processes: a virtual clock
    Simulated,
}

impl ClusterArgs {
    /// The speeds of a cluster of so many workers, if it can be measured.
    pub fn speeds(&self, workers: u32) -> Result<Vec<f64>, String> {
        let speeds = devices::speeds(&self.device_speed, workers as usize)?;
        if self.device == DeviceKind::Real {
            devices::check_real(&speeds, cores())?;
            if self.launch_us > 0 {
                return Err("--launch-us is for devices that are played or simulated; real ones launch what they launch".into());
            }
        }
        if self.device != DeviceKind::Simulated && workers as usize > limits::WORKERS {
            return Err(format!("--workers {workers}: a master takes {} at most", limits::WORKERS));
        }
        Ok(speeds)
    }
}

impl DeviceKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Replay => "replay",
            Self::Real => "real",
            Self::Simulated => "simulated",
        }
    }
}

/// Of `--coding`: none leaves it to the cluster.
#[derive(Clone, Copy, Debug)]
pub struct CodingArg(pub Option<Coding>);

fn coding(text: &str) -> Result<CodingArg, String> {
    let found = Coding::ALL.into_iter().find(|coding| coding.name() == text).map(Some);
    // A rounded frame has other pixels than the recording, which its hash is held to.
    let found = found.filter(|coding| *coding != Some(Coding::Rounded)).or((text == "auto").then_some(None));
    found.map(CodingArg).ok_or_else(|| "write auto, raw or lossless".into())
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: Option<f64> = text.parse().ok();
    seconds.filter(|s| (0.001..=3600.0).contains(s)).ok_or_else(|| "write seconds, 0.001 to 3600".into())
}

/// A side of a tile that a recording has.
pub fn tile(text: &str) -> Result<u32, String> {
    let side: Option<u32> = text.parse().ok();
    side.filter(|side| *side > 0 && side.is_multiple_of(Recorded::SIDE) && *side <= limits::SIDE)
        .ok_or_else(|| format!("write a multiple of {}", Recorded::SIDE))
}

/// Names of balancings that `--balance` takes.
pub fn balances() -> Vec<&'static str> {
    std::iter::once("all").chain(Balance::ALL.map(Balance::name)).collect()
}

/// Those of that name, of which clap has let only such pass.
pub fn chosen_balances(names: &[String]) -> Result<Vec<Balance>, String> {
    if names.iter().any(|name| name == "all") {
        return Ok(Balance::ALL.to_vec());
    }
    names.iter().map(|name| name.parse()).collect()
}
