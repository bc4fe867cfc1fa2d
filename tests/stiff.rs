//! Workers, tiles and triangles that differ by orders of magnitude, and frames of the smallest size and by rows, in small;
//! `tessera check` has them in full.

use crate::cluster::in_memory;
use crate::support::Folder;
#[cfg(target_os = "linux")]
use crate::support::Tessera;
use std::time::Duration;
use tessera_master::{Balance, Cluster, ClusterConfig, PixelFormat};
use tessera_wire::ReturnMode;

#[path = "../master/src/commands/check/cases/stiff/frames.rs"]
#[allow(dead_code, reason = "`tessera check` uses the rest")]
mod frames;
#[path = "../master/src/commands/check/cases/stiff/scenes.rs"]
#[allow(dead_code, reason = "`tessera check` uses the rest")]
mod scenes;
#[path = "../master/src/commands/check/cases/stiff/world.rs"]
#[allow(dead_code, reason = "`tessera check` uses the rest")]
mod world;

/// Tiles that others took over in a frame that did not take longer than is allowed.
fn taken_over_in_time(what: &str, judged: Result<world::Judged, String>) -> u32 {
    let world::Judged { course, share } = judged.unwrap_or_else(|e| panic!("{what}: {e}"));
    assert!(share <= 1.0, "{what}: {share} of the time allowed, {course:?}");
    course.shared
}

#[test]
fn nobody_waits_for_a_worker_a_thousand_times_slower() {
    let mut helped = 0;
    for seed in 0..20 {
        for balance in Balance::ALL {
            for (slowness, tiles) in world::UNEQUAL {
                let what = format!("seed {seed}, {balance}, {slowness:?}, {tiles:?}");
                helped += taken_over_in_time(&what, world::unequal(slowness, tiles, balance, seed));
            }
        }
    }
    assert!(helped > 1000, "{helped} tiles were taken over");
}

#[test]
fn a_worker_too_slow_to_be_of_use_is_cut_off_and_the_frame_is_complete() {
    // A tile in 100 s, where the others take 100 ms: longer than an unknown tile of 16 samples may take.
    let tile = Duration::from_millis(100);
    for balance in Balance::ALL {
        let trial =
            world::Trial { tiles: [64, 64], balance, slowness: &[1, 1000, 1], cost: &|_| tile, seed: 1 };
        let course = world::render(&trial).expect("two workers are enough");
        // A word for all of 1365 tiles has longer, and others have done them before that. The few that it has rendered by then come too.
        let is_at_end = balance.returns() == ReturnMode::AtEnd;
        assert_eq!(course.lost, u32::from(!is_at_end), "{balance}: {course:?}");
        assert!(course.tiles[1] <= if is_at_end { 10 } else { 0 }, "{balance}: {course:?}");
        // The others take as long as without it, and a word's way there and back for each tile.
        let alone = (tile + Duration::from_millis(2)) * 4096 / 2;
        let dynamic = matches!(balance, Balance::Dynamic | Balance::PaperDynamic);
        assert!(!dynamic || course.took < alone + tile * 10, "{balance}: {course:?}");
    }
}

#[test]
fn a_tile_a_hundred_thousand_times_dearer_holds_the_frame_no_longer_than_itself() {
    let mut helped = 0;
    for seed in 0..5 {
        for balance in Balance::ALL {
            for workers in [1, 2, 5, 16] {
                for dear in [0, 100, 255] {
                    let what = format!("seed {seed}, {balance}, {workers} workers, tile {dear}");
                    helped += taken_over_in_time(&what, world::dear_tile(dear, workers, balance, seed));
                }
            }
        }
    }
    assert!(helped > 0, "no tile was taken over");
}

#[test]
fn a_glass_corner_in_a_white_wall_is_one_picture() {
    wait(async {
        let pack = scenes::glass_corner(8).expect("it packs");
        let cutoff = 1.0 / 8192.0;
        let costs = scenes::corner_costs(&pack, 4, cutoff);
        // Eight lamps: a thousand hits of eight shadow rays, to one primary ray.
        assert!(costs.ratio() > 1000.0, "{costs:?}: the corner is not dear");
        let job = scenes::corner_job(&pack, 4, cutoff, Balance::default());
        let frame = job.to_wire(tessera_wire::FrameId(1), tessera_wire::PackId(pack.id().0));
        let (own, _) = tessera_worker::gpu::probe::cpu_frame(&pack, tessera_worker::Kernel::auto(), &frame);
        for crew in [1, 3] {
            let (workers, _served) = in_memory(crew);
            let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
            cluster.load(&pack, |_| ()).await.expect("they take the pack");
            for balance in Balance::ALL {
                let image = frames::whole(&mut cluster, &scenes::corner_job(&pack, 4, cutoff, balance)).await;
                assert!(image.expect("workers are well").data() == own, "{crew} workers, {balance}");
            }
            cluster.stop().await;
        }
    });
}

#[test]
fn one_huge_and_many_tiny_triangles_leave_no_hole_and_the_speck_is_reported() {
    let sight = scenes::look_at(scenes::field(60, false), 2000, 400).expect("it packs");
    assert_eq!(sight.prepared.pack.triangle_count(), 2 * 60 * 60 + 5, "none has collapsed");
    assert_eq!((sight.holes, sight.differ), (0, 0));
    assert!(sight.rays >= 2000 && sight.judged >= 400);
    let warnings = &sight.prepared.warnings;
    assert!(
        warnings.len() == 1 && warnings[0].contains("1 of 3 objects are smaller than 64 voxels"),
        "{warnings:?}"
    );
    let benign = scenes::look_at(scenes::field(60, true), 2000, 400).expect("it packs");
    println!(
        "rays take {:.2} times as long as without the huge one",
        sight.traced.div_duration_f64(benign.traced)
    );
    assert_eq!((benign.holes, benign.differ, benign.prepared.warnings.len()), (0, 0, 0));
}

#[test]
fn frames_by_rows_are_those_held_whole() {
    wait(async {
        let pack = frames::slope().expect("it packs");
        let folder = Folder::new();
        let path = folder.file("frame.png");
        let (workers, _served) = in_memory(3);
        let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
        cluster.load(&pack, |_| ()).await.expect("they take the pack");
        for (size, tile) in frames::SIZES {
            for format in [PixelFormat::Rgba8, PixelFormat::Rgba16] {
                for balance in Balance::ALL {
                    let what = format!("{size:?}, tiles of {tile}, {format}, {balance}");
                    let job = tessera_master::FrameJob { balance, ..frames::job(&pack, size, tile, format) };
                    let whole = frames::whole(&mut cluster, &job).await.expect("workers are well");
                    let hash = frames::by_rows(&mut cluster, &job, &path).await.expect("workers are well");
                    assert_eq!(hash, whole.hash(), "{what}");
                    assert_eq!(hash, frames::hash_by_bands(&pack, &job), "{what}");
                    if format == PixelFormat::Rgba8 {
                        assert_eq!(frames::hash_of_png(&path), Ok(hash), "{what}");
                    }
                    let read: Vec<u8> = match image::open(&path).expect("a picture") {
                        image::DynamicImage::ImageRgba8(image) => image.into_raw(),
                        image::DynamicImage::ImageRgba16(image) => {
                            image.into_raw().into_iter().flat_map(u16::to_le_bytes).collect()
                        }
                        other => panic!("{:?}", other.color()),
                    };
                    assert!(read == whole.data(), "{what}: the file holds other pixels");
                }
            }
        }
        // A frame of several classes is held whole, and goes to the file in the end.
        let job = frames::job(&pack, [70, 50], 16, PixelFormat::Rgba8);
        let mixed = tessera_master::FrameJob { mix: true, ..job.clone() };
        let whole = frames::whole(&mut cluster, &job).await.expect("workers are well");
        assert_eq!(
            frames::by_rows(&mut cluster, &mixed, &path).await.expect("workers are well"),
            whole.hash()
        );
        cluster.stop().await;
        assert_eq!(folder.names(), ["frame.png"]);
    });
}

/// Runs what needs sockets and timers.
fn wait(work: impl Future<Output = ()>) {
    tokio::runtime::Runtime::new().expect("threads").block_on(work);
}

/// One of three worker processes is stopped most of the time, as `kill -STOP` stops it.
#[cfg(target_os = "linux")]
#[test]
fn a_process_that_is_slowed_down_for_real_changes_nothing() {
    let folder = Folder::new();
    folder.write("box.toml", "[generate]\nkind = \"cornell\"\ntriangles = 2000\n");
    let args =
        "render box.toml --out box.png --json --size 512x512 --spp 36 --tile 32 --threads 1 --backend cpu";
    let render =
        |more: &str| Tessera::new(args.split(' ')).args(more.split_whitespace()).within(folder.path());
    let expected = render("").run().json();
    for balance in ["static", "dynamic"] {
        let mut run = render(&format!("--workers 3 --balance {balance} -v")).start();
        run.wait_for("all workers hold the scene");
        let crew = run.children();
        let begun: Vec<_> = crew.iter().map(|&process| ticks(process).unwrap_or_default()).collect();
        // Two seconds in three milliseconds, the time that two signals take.
        let (slow, end) = (crew[1], std::sync::mpsc::channel::<()>());
        let (tell, end) = end;
        let throttle = std::thread::spawn(move || {
            let mut last = Vec::new();
            loop {
                signal_if_there("STOP", slow);
                let ended = end.recv_timeout(Duration::from_secs(2)).is_ok();
                last.extend(ticks(slow));
                signal_if_there("CONT", slow);
                if ended || ticks(slow).is_none() {
                    return last;
                }
            }
        });
        let report: serde_json::Value = serde_json::from_str(&run.finish().ok()).expect("one JSON object");
        // It may be over before this is heard.
        let _ = tell.send(());
        let stops = throttle.join().expect("no panic");
        let slow_ticks = stops.last().copied().unwrap_or_default().saturating_sub(begun[1]);
        assert_eq!(report["image_hash"], expected["image_hash"], "{balance}");
        let workers = report["workers"].as_array().expect("workers");
        let tiles: Vec<_> = workers.iter().map(|worker| worker["tiles"].as_u64().expect("tiles")).collect();
        assert_eq!(tiles.iter().sum::<u64>(), 256, "{balance}: {tiles:?}");
        let render_ms: Vec<_> =
            workers.iter().map(|worker| worker["render_ms"].as_f64().expect("a time")).collect();
        println!(
            "{balance}: {tiles:?} tiles in {render_ms:.0?} ms; the slow one had {slow_ticks} ticks of CPU time in {} stops",
            stops.len()
        );
        // How much it did in between is the machine's affair.
        assert!(!stops.is_empty(), "{balance}: {tiles:?}: nobody was slowed down");
    }
}

/// CPU time of a process so far, in hundredths of a second.
#[cfg(target_os = "linux")]
fn ticks(process: u32) -> Option<u64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // Behind the name, which is in parentheses, user and system time are the 12th and 13th.
    let fields: Vec<_> = stat.rsplit_once(") ")?.1.split(' ').collect();
    Some(fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?)
}

/// As [`crate::support::signal`], to a process that may have ended.
#[cfg(target_os = "linux")]
fn signal_if_there(name: &str, process: u32) {
    let kill = std::process::Command::new("kill").args([&format!("-{name}"), &process.to_string()]).output();
    assert!(kill.is_ok(), "kill runs");
}
