//! Frames on workers, within this process: the same code as between machines, behind in-memory pipes.

use crate::commands::backend::{BackendArgs, BackendFlag};
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::exact;
use crate::commands::run::{runtime, worker_here};
use tessera_geometry::LocalCamera;
use tessera_master::{Balance, Cluster, ClusterConfig, FrameJob, PixelFormat, Progress, Workers};
use tessera_pack::Pack;
use tessera_whitted::stage::look;
use tessera_whitted::stage::stages::bazaar;
use tessera_wire::{Features, FrameId};
use tessera_worker::gpu::probe::cpu_frame;
use tessera_worker::{Backend, Kernel};

pub const CASES: &[Case] = &[
    Case {
        id: "29",
        input: "one worker; more workers than tiles",
        judge: "I: the picture of this process",
        run: Run::Once(crews),
    },
    Case {
        id: "43",
        input: "workers that die in the middle of a frame",
        judge: "I: the picture of this process",
        run: Run::Once(deaths),
    },
];

/// A frame of so many pixels a side in tiles of `tile`.
fn job(camera: LocalCamera, side: u32, tile: u32, balance: Balance) -> FrameJob {
    FrameJob {
        tile,
        features: Features { shadows: true, reflection: true, refraction: true },
        format: PixelFormat::Rgba16,
        balance,
        ..FrameJob::new(camera, side, side)
    }
}

/// Renders `job` on so many workers, and ends `dying` of them when the first tile is in; how many of the bytes differ from those of this
/// process's own picture.
fn differing(
    pack: &Pack,
    job: &FrameJob,
    backend: &Backend,
    (workers, dying): (usize, usize),
) -> Result<usize, String> {
    let frame = job.to_wire(FrameId(1), tessera_wire::PackId(pack.id().0));
    let (own, _) = cpu_frame(pack, Kernel::auto(), &frame);
    let runtime = runtime().map_err(|e| e.to_string())?;
    let pixels = runtime.block_on(async {
        let started = (0..workers).map(|i| worker_here(&format!("worker {i}"), 1, backend.clone()));
        let (links, tasks): (Vec<_>, Vec<_>) = started.unzip();
        let mut cluster = Cluster::start(Workers::Links(links), ClusterConfig::default())
            .await
            .map_err(|e| e.to_string())?;
        cluster.load(pack, |_| ()).await.map_err(|e| e.to_string())?;
        let mut doomed: Vec<_> = tasks.into_iter().take(dying).collect();
        let end = |event: Progress<'_>| {
            if matches!(event, Progress::Tiles { done: 1.., .. }) {
                doomed.drain(..).for_each(|task| task.abort());
            }
        };
        let result = cluster.render(job, end).await.map_err(|e| e.to_string())?;
        cluster.stop().await;
        Ok::<_, String>(result.image.data().to_vec())
    });
    runtime.shutdown_background();
    let pixels = pixels?;
    Ok(own.iter().zip(&pixels).filter(|(a, b)| a != b).count() + own.len().abs_diff(pixels.len()))
}

fn cpu() -> Result<Backend, String> {
    let args = BackendArgs { backend: BackendFlag::Cpu, ..BackendArgs::default() };
    args.open().map_err(|e| e.to_string())
}

fn crews(_: Effort) -> Outcome {
    let (pack, backend) = (exact(&bazaar())?, cpu()?);
    let view = look([0.3, 0.6, 5.0], [0.0; 3]);
    let (mut differ, mut frames) = (0, 0);
    for balance in Balance::ALL {
        for (side, tile, workers) in [(40, 8, 1), (40, 64, 16), (1, 8, 3), (45, 16, 16)] {
            let camera = view.pose.to_local(&pack.frame(), side, side).map_err(|e| e.to_string())?;
            differ += differing(&pack, &job(camera, side, tile, balance), &backend, (workers, 0))?;
            frames += 1;
        }
    }
    Ok(Finding::none(differ, frames, "bytes differ in frames"))
}

fn deaths(_: Effort) -> Outcome {
    let (pack, backend) = (exact(&bazaar())?, cpu()?);
    let camera =
        look([0.3, 0.6, 5.0], [0.0; 3]).pose.to_local(&pack.frame(), 96, 96).map_err(|e| e.to_string())?;
    let (mut differ, mut frames) = (0, 0);
    for balance in Balance::ALL {
        for (workers, dying) in [(2, 1), (6, 5)] {
            differ += differing(&pack, &job(camera, 96, 8, balance), &backend, (workers, dying))?;
            frames += 1;
        }
    }
    Ok(Finding::none(differ, frames, "bytes differ in frames"))
}
