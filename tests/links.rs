//! Emulated links: what a relay lets through beside what its profile says, and pictures that come through it whole.

use crate::cluster::{job, pack};
use crate::support::{Folder, Tessera};
use serde_json::Value;
use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use tessera_master::{
    Balance, Cluster, ClusterConfig, Detour, FrameBuffer, FrameJob, FrameResult, LocalWorkers, PixelFormat,
    Workers,
};
use tessera_worker::{Recording, RecordingFile};

/// A lossy link, and a fast one otherwise.
const LOSSY: &str = "\
name = \"lossy\"
source = \"a test\"
mbit_up = 400
mbit_down = 400
duplex = \"full\"
latency_ms = 1
jitter_ms = 1
loss = 0.01
queue_kib = 4096
mtu = 1472
";

/// A relay process.
struct Relay(Child, SocketAddr);

impl Relay {
    fn start(link: &str, upstream: SocketAddr) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
        command.args(["bench", "relay", "--link", link, "--upstream", &upstream.to_string()]);
        let mut child =
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the binary starts");
        let mut line = String::new();
        let out = child.stdout.as_mut().expect("piped");
        // It says one line and waits: nothing is lost with the reader.
        BufReader::new(out).read_line(&mut line).expect("a line");
        let address = line.trim().parse().expect("an address");
        Self(child, address)
    }

    /// What it says of its packets when its standard input ends; then it ends too.
    fn end(mut self) -> Value {
        drop(self.0.stdin.take());
        let mut line = String::new();
        BufReader::new(self.0.stdout.as_mut().expect("piped")).read_line(&mut line).expect("a line");
        assert!(self.0.wait().expect("a child").success());
        serde_json::from_str(&line).expect("a report")
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Two frames of `side` pixels in tiles of side `tile`, which take `us` each.
fn recording(folder: &Folder, us: impl Fn(u32) -> u32, side: (u32, u32), tile: u32) -> String {
    let (width, height) = side;
    let mut recording = Recording::new(width, height, tile);
    let tiles = width.div_ceil(tile) * height.div_ceil(tile);
    recording.tile_us = vec![(0..tiles).map(&us).collect(), (0..tiles).map(&us).collect()];
    let rows = |seed: u32| -> Vec<u8> {
        (0..width * height * 4).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8 ^ seed as u8).collect()
    };
    let path = folder.file("frames.recording");
    recording.write(&path, &[&rows(1), &rows(2)]).expect("a folder of its own");
    path.to_str().expect("a plain path").into()
}

fn replay_job(side: (u32, u32), tile: u32, balance: Balance) -> FrameJob {
    let plain = job(&pack(), balance);
    FrameJob { width: side.0, height: side.1, tile, format: PixelFormat::Rgba8, ..plain }
}

/// Workers that play the recording, the `i`-th with the `i`-th arguments besides, behind `link`; and the relay, once they have joined.
fn players(
    count: u32,
    recording: &str,
    args_of: &[&str],
    link: &str,
) -> (Workers, Arc<Mutex<Option<Relay>>>) {
    let relay = Arc::<Mutex<Option<Relay>>>::default();
    let (place, link) = (relay.clone(), link.to_owned());
    let through = Detour::new(move |master| {
        let relay = Relay::start(&link, master);
        let address = relay.1;
        *place.lock().expect("one thread") = Some(relay);
        Ok(address)
    });
    let words = |text: &str| text.split_whitespace().map(OsString::from).collect::<Vec<_>>();
    let workers = Workers::Local(LocalWorkers {
        program: env!("CARGO_BIN_EXE_tessera").into(),
        args: ["worker", "--ticket", "--replay", recording].map(Into::into).into(),
        args_of: args_of.iter().map(|args| words(args)).collect(),
        count,
        threads: Some(1),
        through: Some(through),
    });
    (workers, relay)
}

/// The picture that was recorded.
fn recorded(file: &str, frame: usize) -> FrameBuffer {
    let file = RecordingFile::open(Path::new(file)).expect("it was written");
    let (width, height) = (file.recording().width, file.recording().height);
    let rows = file.image(frame).expect("it is whole");
    FrameBuffer::from_rows(width, height, PixelFormat::Rgba8, rows).expect("it fits")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn played_frames_come_whole_through_a_link_that_loses_packets() {
    let folder = Folder::new();
    let side = (256, 180);
    let file = recording(&folder, |tile| 500 + 100 * (tile % 5), side, 64);
    let link = folder.write("lossy.toml", LOSSY);
    let (workers, relay) =
        players(3, &file, &["--speed 2", "--speed 0.5 --launch-us 300"], link.to_str().unwrap());
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack(), |_| ()).await.expect("they take the pack");
    // Entries of the recording go round with the session's frames.
    for (number, balance) in (0..).zip(Balance::ALL) {
        let result = cluster.render(&replay_job(side, 64, balance), |_| ()).await.expect("they are well");
        assert_eq!(result.image.hash(), recorded(&file, number).hash(), "{balance}");
        assert_eq!(result.numeric_class(), Some("replay"));
        let names: Vec<_> = result.workers.iter().map(|w| w.name.as_str()).collect();
        assert_eq!(names, ["local-0", "local-1", "local-2"]);
    }
    cluster.stop().await;
    let relay = relay.lock().expect("one thread").take().expect("it was asked for");
    let report = relay.end();
    assert_eq!(report["peers"], 3, "{report}");
    let lost = |way: &str| report[way]["lost"].as_u64().expect("a count");
    assert!(lost("up") > 0 && report["up"]["too_large"].as_u64() > Some(0), "{report}");
    assert!(report["up"]["packets"].as_u64() > Some(20 * lost("up")), "one of a hundred: {report}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_that_was_not_recorded_is_refused_with_its_reason() {
    let folder = Folder::new();
    let file = recording(&folder, |_| 1, (64, 64), 32);
    let (workers, _relay) = players(1, &file, &[], "wired");
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("it joins");
    cluster.load(&pack(), |_| ()).await.expect("it takes the pack");
    let error = cluster.render(&replay_job((64, 64), 16, Balance::Dynamic), |_| ()).await.err();
    let reason = error.expect("other tiles").to_string();
    assert!(reason.contains("the recording is of 64x64 pixels of RGBA8 in tiles of 32"), "{reason}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cpu_that_is_made_to_seem_slower_makes_the_same_picture() {
    let workers = |args: &[&str]| {
        Workers::Local(LocalWorkers {
            program: env!("CARGO_BIN_EXE_tessera").into(),
            args: ["worker", "--ticket"].iter().chain(args).map(Into::into).collect(),
            args_of: Vec::new(),
            count: 1,
            threads: Some(1),
            through: None,
        })
    };
    let mut results: Vec<FrameResult> = Vec::new();
    // Of the unhindered one the fastest of several counts: on a busy machine wall time is more than CPU time.
    for (args, frames) in [(&["--backend", "cpu"][..], 6), (&["--pace", "0.05"], 1)] {
        let mut cluster = Cluster::start(workers(args), ClusterConfig::default()).await.expect("it joins");
        cluster.load(&pack(), |_| ()).await.expect("it takes the pack");
        let job = FrameJob { samples: 16, ..job(&pack(), Balance::Dynamic) };
        let mut all = Vec::new();
        for _ in 0..frames {
            all.push(cluster.render(&job, |_| ()).await.expect("it is well"));
        }
        results.extend(all.into_iter().min_by_key(|result| result.workers[0].render));
        cluster.stop().await;
    }
    assert_eq!(results[0].image, results[1].image);
    let render = |i: usize| results[i].workers.iter().map(|w| w.render).sum::<std::time::Duration>();
    // 20 times the CPU time.
    assert!(render(1) > 8 * render(0), "{:?} and {:?}", render(1), render(0));
}

/// One run: figures of the relay beside those of its link, with room for a busy machine below and none above.
#[test]
fn a_link_gives_what_it_says_and_no_more() {
    let folder = Folder::new();
    folder.write(
        "narrow.toml",
        "name = \"narrow\"\nsource = \"a test\"\nmbit_up = 40\nmbit_down = 40\nduplex = \"full\"\nlatency_ms = 4\nqueue_kib = 512\nmtu = 1472\n",
    );
    let args = ["bench", "link", "--link", "narrow.toml", "--json"];
    let line = Tessera::new(args).within(folder.path()).run().json();
    let ratio = |key: &str| {
        let figure = |of: &str| line[key][of].as_f64().unwrap_or_else(|| panic!("{key} in {line}"));
        figure("measured") / figure("promised")
    };
    for rate in ["up_mbit_1", "up_mbit_16"] {
        assert!((0.4..=1.02).contains(&ratio(rate)), "{rate}: {line}");
    }
    for time in ["round_trip_ms", "tile_ms", "picture_ms"] {
        // Packets may be sent on 50 us early.
        assert!((0.97..=4.0).contains(&ratio(time)), "{time}: {line}");
    }
}

#[test]
fn links_that_cannot_be_are_refused() {
    let folder = Folder::new();
    folder.write(
        "bad.toml",
        "name = \"x\"\nsource = \"y\"\nduplex = \"half\"\nlatency_ms = 1\nqueue_kib = 8\nmtu = 9\n",
    );
    let run = |link: &str| Tessera::new(["bench", "link", "--link", link]).within(folder.path()).run();
    run("nowhere").fails(2, &["nowhere", "lan100, wifi-ac"]);
    run("bad.toml").fails(2, &["bad.toml", "mtu = 9", "1200 to 65507"]);
    let relay = |more: &[&str]| Tessera::new(["bench", "relay"]).args(more).run();
    relay(&["--upstream", "127.0.0.1:1"]).fails(2, &["--link"]);
    relay(&["--link", "phone", "--upstream", "nowhere"]).fails(2, &["nowhere"]);
    let worker = |more: &[&str]| Tessera::new(["worker", "--ticket"]).args(more).within(folder.path()).run();
    worker(&["--replay", "none"]).fails(1, &["none"]);
    worker(&["--replay", "bad.toml"]).fails(1, &["bad.toml", "no recording"]);
    worker(&["--speed", "2"]).fails(2, &["--replay"]);
    worker(&["--replay", "none", "--backend", "cpu"]).fails(2, &["--backend", "--replay"]);
    worker(&["--replay", "none", "--speed", "0"]).fails(2, &["0.0001 to 10000"]);
    worker(&["--pace", "1.5"]).fails(2, &["0.001 to 1"]);
    worker(&["--pace", "0.5", "--backend", "gpu"]).fails(2, &["--pace"]);
}

/// Prints what the phone's link, or the one in `TESSERA_LINK`, makes of the times of Seo, Park, Ihm 2022 (Table 9, Sponza): `links/phone.toml`
/// is fitted by it. By hand: `cargo test --release --test tests phones_beside -- --ignored --nocapture`; the ranking that the fit is for is tested
/// in the simulator.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "prints figures"]
async fn phones_beside_the_papers_times() {
    let folder = Folder::new();
    let side = (1024, 1024);
    let link = std::env::var("TESSERA_LINK").unwrap_or_else(|_| "phone".into());
    // 2,740 ms in all, tiles between 0.6 and 1.4 of their mean.
    let file = recording(&folder, |tile| 42_800 / 100 * (60 + tile * 37 % 81), side, 128);
    let paper =
        [(1, 2905.4, 2763.2), (2, 1680.9, 1526.9), (4, 896.4, 892.9), (8, 546.5, 682.4), (16, 380.6, 621.7)];
    for (count, of_static, of_dynamic) in paper {
        let (workers, relay) = players(count, &file, &[], &link);
        let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
        cluster.load(&pack(), |_| ()).await.expect("they take the pack");
        for (balance, paper) in [
            (Balance::PaperStatic, of_static),
            (Balance::PaperDynamic, of_dynamic),
            (Balance::Static, 0.0),
            (Balance::Dynamic, 0.0),
        ] {
            let mut times = Vec::new();
            for _ in 0..5 {
                let begun = std::time::Instant::now();
                cluster.render(&replay_job(side, 128, balance), |_| ()).await.expect("they are well");
                times.push(begun.elapsed().as_secs_f64() * 1e3);
            }
            times.sort_by(f64::total_cmp);
            println!(
                "{count:3} {balance:14} {:8.1} ms of {paper:8.1}  ({:.1} to {:.1})",
                times[2], times[0], times[4]
            );
        }
        cluster.stop().await;
        let relay = relay.lock().expect("one thread").take().expect("it was asked for");
        println!("{}", relay.end());
    }
}
