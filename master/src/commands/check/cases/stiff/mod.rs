//! Stiff cases: workers, tiles and triangles that differ by orders of magnitude, and frames of the smallest and the largest size.

mod frames;
mod scenes;
#[allow(dead_code, reason = "tests/stiff.rs uses the rest")]
mod world;

use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::run::{runtime, worker_here};
use scenes::{Sight, corner_costs, corner_job, field, glass_corner, look_at};
use std::time::Duration;
use tessera_master::{Balance, Cluster, ClusterConfig, Link, PixelFormat, Workers};
use tessera_pack::Pack;
use tessera_wire::FrameId;
use tessera_worker::gpu::probe::cpu_frame;
use tessera_worker::{Backend, BackendChoice, BackendConfig, Kernel};

pub const CASES: &[Case] = &[
    Case {
        id: "19-field",
        input: "a triangle of 2^22 voxels beside a million of two",
        judge: "C, I, B: no hole, brute force",
        run: Run::Once(sizes),
    },
    Case {
        id: "28-rows",
        input: "frames of 1 x 1 to 16,384 x 16,384, rows streamed",
        judge: "I: the hash of the image, band by band, and of the file",
        run: Run::Once(rows),
    },
    Case {
        id: "43-speeds",
        input: "a worker a thousand times slower than the others",
        judge: "I: each tile once, nobody waits for it",
        run: Run::Once(speeds),
    },
    Case {
        id: "43-costs",
        input: "tiles that cost a hundred thousand times as much",
        judge: "I: each tile once, one picture",
        run: Run::Once(costs),
    },
];

fn speeds(effort: Effort) -> Outcome {
    let (mut trials, mut worst, mut helped) = (0, 0.0_f64, 0);
    for seed in 0..effort.pick(4, 40) {
        for balance in Balance::ALL {
            for (slowness, tiles) in world::UNEQUAL {
                let judged = world::unequal(slowness, tiles, balance, seed)?;
                worst = worst.max(judged.share);
                helped += judged.course.shared;
                trials += 1;
            }
        }
    }
    let got = format!("{trials} frames complete and equal; at most {worst:.3} of the time allowed");
    Ok(Finding::all([
        Finding::holds(
            "every tile once; by a virtual clock no longer than without the slow ones, and until they are late",
            got,
            worst <= 1.0,
        ),
        Finding::at_least("tiles taken over", helped as usize, trials),
    ]))
}

fn costs(effort: Effort) -> Outcome {
    // Under the virtual clock, wherever the dear tile is.
    let (mut worst, mut helped) = (0.0_f64, 0);
    for seed in 0..effort.pick(2, 20) {
        for balance in Balance::ALL {
            for workers in [1, 2, 5, 16] {
                for dear in [0, 100, 255] {
                    let judged = world::dear_tile(dear, workers, balance, seed)?;
                    worst = worst.max(judged.share);
                    helped += judged.course.shared as usize;
                }
            }
        }
    }

    // For real.
    let (lamps, tile, cutoff, least) = effort.pick((8, 4, 1.0 / 8192.0, 1e3), (64, 8, 1.0 / 65_536.0, 1e5));
    let pack = glass_corner(lamps)?;
    let ratio = corner_costs(&pack, tile, cutoff).ratio();
    let (pictures, differ) = in_clusters(&pack, (tile, cutoff), &effort.pick(vec![2], vec![1, 2, 5]))?;
    Ok(Finding::all([
        Finding::within("share of the time allowed by a virtual clock", worst, 1.0),
        Finding::at_least("tiles taken over", helped, 1),
        Finding::holds(
            format!("rays of the dear tile >= {least:.0e} of another"),
            format!("{ratio:.2e}"),
            ratio >= least,
        ),
        Finding::none(differ, pictures, "pictures other than that of one process"),
    ]))
}

/// Pictures in every balancing, with so many workers in this process, and how many of them are not what is rendered without a cluster.
fn in_clusters(pack: &Pack, (tile, cutoff): (u32, f32), crews: &[usize]) -> Result<(usize, usize), String> {
    let job = corner_job(pack, tile, cutoff, Balance::default());
    let (own, _) =
        cpu_frame(pack, Kernel::auto(), &job.to_wire(FrameId(1), tessera_wire::PackId(pack.id().0)));
    let (mut pictures, mut differ) = (0, 0);
    runtime().map_err(|e| e.to_string())?.block_on(async {
        for &crew in crews {
            let mut cluster = start(pack, crew).await?;
            for balance in Balance::ALL {
                let job = corner_job(pack, tile, cutoff, balance);
                pictures += 1;
                differ += usize::from(frames::whole(&mut cluster, &job).await?.data() != own);
            }
            cluster.stop().await;
        }
        Ok((pictures, differ))
    })
}

async fn start(pack: &Pack, crew: usize) -> Result<Cluster, String> {
    let cpu = BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() };
    let backend = Backend::open(&cpu).map_err(|e| e.to_string())?;
    let links: Vec<Link> =
        (0..crew).map(|index| worker_here(&format!("worker {index}"), 1, backend.clone()).0).collect();
    let cluster = Cluster::start(Workers::Links(links), ClusterConfig::default()).await;
    let mut cluster = cluster.map_err(|e| e.to_string())?;
    cluster.load(pack, |_| ()).await.map_err(|e| e.to_string())?;
    Ok(cluster)
}

fn rows(effort: Effort) -> Outcome {
    let pack = frames::slope()?;
    let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
    let largest = effort.pick(1024, 16_384);
    runtime().map_err(|e| e.to_string())?.block_on(async {
        let mut cluster = start(&pack, 2).await?;
        let path = folder.path().join("frame.png");
        let (mut frames_done, mut differ, mut misread) = (0, 0, 0);
        for (size, tile) in frames::SIZES.into_iter().chain([([largest, largest], 128)]) {
            let job = frames::job(&pack, size, tile, PixelFormat::Rgba8);
            let by_rows = frames::by_rows(&mut cluster, &job, &path).await?;
            frames_done += 1;
            differ += usize::from(by_rows != frames::hash_by_bands(&pack, &job));
            misread += usize::from(by_rows != frames::hash_of_png(&path)?);
        }
        cluster.stop().await;
        Ok(Finding::all([
            Finding::none(differ, frames_done, "frames other than those rendered without a cluster"),
            Finding::none(misread, frames_done, "files that hold other pixels"),
        ]))
    })
}

fn sizes(effort: Effort) -> Outcome {
    let (side, rays, judged) = effort.pick((100, 4_000, 64), (707, 200_000, 256));
    let stiff = look_at(field(side, false), rays, judged)?;
    let benign = look_at(field(side, true), rays, judged)?;
    let warned = stiff.prepared.warnings.iter().any(|warning| warning.contains("smaller than 64 voxels"));
    let ratio = |of: fn(&Sight) -> Duration| of(&stiff).div_duration_f64(of(&benign));
    let times = format!(
        "{} triangles; packing takes {:.2} times, rays {:.2} times as long as in a field as large as its scene",
        stiff.prepared.pack.triangle_count(),
        ratio(|sight| sight.prepared.timings.pack),
        ratio(|sight| sight.traced)
    );
    Ok(Finding::all([
        Finding::none(stiff.holes, stiff.rays, "rays pass the field"),
        Finding::none(stiff.differ, stiff.judged, "hits other than brute force's"),
        Finding::holds("objects below 64 voxels are reported", times, warned),
    ]))
}
