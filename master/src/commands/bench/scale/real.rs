//! Cases with real processes, sockets and messages.

use super::case::{Case, Measured};
use super::link::LinkProfile;
use super::relay_process::{Waiting, through};
use crate::commands::CommandError;
use crate::commands::LogArgs;
use crate::commands::bench::clock::Watch;
use crate::commands::run::runtime;
use std::ffi::OsString;
use std::path::Path;
use std::time::Duration;
use tessera_master::trace::TraceWorker;
use tessera_master::{Cluster, ClusterConfig, FrameJob, LocalWorkers, Workers};
use tessera_pack::{Material, Pack, PackInput, PackOptions, build_pack};

/// What renders in each process.
#[derive(Clone, Copy, Debug)]
pub enum Device<'a> {
    /// A recording, whose times are multiplied, and which has a cost a tile besides.
    Replay { recording: &'a Path, scale: f64, launch_us: u32 },
    /// This machine, as if it were slower; of this pack.
    Real(&'a Pack),
}

/// Workers behind a link, for as many frames as are wanted.
pub struct RealCluster {
    runtime: tokio::runtime::Runtime,
    cluster: Option<Cluster>,
    /// Ended with the cluster.
    _relay: Waiting,
}

impl RealCluster {
    /// Starts a worker for each of `speeds`, and has them take a pack.
    pub fn start(
        link: &LinkProfile,
        speeds: &[f64],
        device: Device<'_>,
        log: &LogArgs,
    ) -> Result<Self, CommandError> {
        let program = std::env::current_exe().map_err(|e| {
            CommandError::Failed(format!("cannot find this program to start workers with: {e}"))
        })?;
        let (detour, relay) = through(link);
        let workers = LocalWorkers {
            program,
            args: ["worker", "--ticket"].map(Into::into).into_iter().chain(log.to_args()).collect(),
            args_of: speeds.iter().map(|&speed| device.args(speed)).collect(),
            count: speeds.len() as u32,
            threads: Some(1),
            through: detour,
        };
        let runtime = runtime()?;
        let played;
        let pack = match device {
            Device::Real(pack) => pack,
            // Devices that are played render nothing: any scene does, and the least of all is soon with them over a slow link.
            Device::Replay { .. } => {
                played = least_pack()?;
                &played
            }
        };
        let cluster = runtime.block_on(async {
            let config = ClusterConfig::default();
            let mut cluster =
                Cluster::start(Workers::Local(workers), config).await.map_err(CommandError::failed)?;
            cluster.load(pack, |_| ()).await.map_err(CommandError::failed)?;
            Ok::<_, CommandError>(cluster)
        })?;
        Ok(Self { runtime, cluster: Some(cluster), _relay: relay })
    }

    /// Frames of a case, the first ones too, in which policies learn; nothing is known of frames before.
    pub fn run(&mut self, case: &Case, job: &FrameJob, frames: usize) -> Result<Vec<Measured>, CommandError> {
        let Some(cluster) = &mut self.cluster else { return Ok(Vec::new()) };
        cluster.forget();
        let job = FrameJob { balance: case.balance, ..job.clone() };
        self.runtime.block_on(async {
            let mut measured = Vec::new();
            let mut before = cluster.traffic();
            for _ in 0..frames {
                let watch = Watch::start();
                let frame = cluster.render(&job, |_| ()).await.map_err(CommandError::failed)?;
                let cpu = Duration::from_secs_f64(watch.read().cpu_s);
                let traffic = cluster.traffic().since(&before);
                before = cluster.traffic();
                measured.push(Measured {
                    took: frame.timings.frame,
                    bytes: traffic.udp_sent + traffic.udp_received,
                    tile: frame.tile,
                    tiles: frame.tiles.iter().filter(|tile| tile.is_first).count() as u32,
                    hash: frame.image.hash().to_string(),
                    dropped: frame.dropped_tiles,
                    workers: frame.workers.iter().map(TraceWorker::from).collect(),
                    coding: frame.coding,
                    master: frame.master,
                    master_cpu: cpu,
                    why: frame.why,
                    records: frame.tiles,
                });
            }
            Ok(measured)
        })
    }

    /// Sends the workers home.
    pub fn stop(mut self) {
        if let Some(cluster) = self.cluster.take() {
            self.runtime.block_on(cluster.stop());
        }
    }
}

impl Drop for RealCluster {
    fn drop(&mut self) {
        // Within the runtime: what is left of connections and processes is ended by it.
        let _context = self.runtime.enter();
        self.cluster = None;
    }
}

impl Device<'_> {
    fn args(&self, speed: f64) -> Vec<OsString> {
        let text = |value: String| OsString::from(value);
        match self {
            Self::Replay { recording, scale, launch_us } => vec![
                "--replay".into(),
                recording.as_os_str().to_owned(),
                "--speed".into(),
                text(speed.to_string()),
                "--scale".into(),
                text(scale.to_string()),
                "--launch-us".into(),
                text(launch_us.to_string()),
            ],
            Self::Real(_) => {
                vec!["--backend".into(), "cpu".into(), "--pace".into(), text(speed.to_string())]
            }
        }
    }
}

/// A scene of one triangle.
fn least_pack() -> Result<Pack, CommandError> {
    let input = PackInput {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        material_runs: vec![(0, 0)],
        materials: vec![Material::default()],
        ..PackInput::default()
    };
    Ok(build_pack(input, &PackOptions::default()).map_err(CommandError::failed)?.0)
}
