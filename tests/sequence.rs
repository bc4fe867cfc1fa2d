//! Many frames of a camera that moves: each the same, bit for bit, as when it is rendered alone.

use crate::cluster::{in_memory, job, pack};
use crate::support::{Folder, PLY, Tessera};
use serde_json::Value;
use std::fs;
use tessera_geometry::Vec3;
use tessera_master::{
    Balance, Cluster, ClusterConfig, FrameJob, ImageHash, LocalWorkers, PixelFormat, SequenceConfig, Stale,
    Workers,
};
use tessera_pack::Pack;

/// Six views of the square.
fn jobs(pack: &Pack, balance: Balance) -> Vec<FrameJob> {
    let job = job(pack, balance);
    let aside = |n: u16| {
        let mut job = FrameJob { format: PixelFormat::Rgba8, tile: 16, ..job.clone() };
        job.camera.origin += Vec3::X * (f32::from(n) * 0.1 * job.camera.origin.z);
        job
    };
    (0..6).map(aside).collect()
}

async fn start(workers: Workers, pack: &Pack) -> Cluster {
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("all join");
    cluster.load(pack, |_| ()).await.expect("they take the pack");
    cluster
}

async fn alone(cluster: &mut Cluster, jobs: &[FrameJob]) -> Vec<ImageHash> {
    let mut hashes = Vec::new();
    for job in jobs {
        hashes.push(cluster.render(job, |_| ()).await.expect("workers are well").image.hash());
    }
    hashes
}

/// Renders `jobs` overlapping, in every way, on a cluster of three.
async fn check_sequences(cluster: &mut Cluster, jobs: &[FrameJob]) {
    let expected = alone(cluster, jobs).await;
    assert!(expected.windows(2).all(|pair| pair[0] != pair[1]), "the views differ");
    for groups in 1..=3 {
        for depth in 1..=3 {
            let config = SequenceConfig { groups, depth, stale: Stale::Render };
            let mut frames = Vec::new();
            let rendered = cluster.render_sequence(jobs.iter().cloned(), config, |_| (), |f| frames.push(f));
            rendered.await.expect("workers are well");
            let hashes: Vec<_> = frames.iter().map(|frame| frame.result.image.hash()).collect();
            assert_eq!(hashes, expected, "{groups} groups, {depth} at a time");
            for (number, frame) in (0..).zip(&frames) {
                assert_eq!((frame.number, frame.result.classes.len()), (number, 1));
                let own = (0..3).filter(|worker| worker % groups == number as u32 % groups).count();
                assert_eq!(frame.result.workers.len(), own, "frame {number} of {groups} groups");
                assert!(frame.latency >= frame.result.timings.frame);
            }
        }
    }
    // The same workers render single frames again.
    assert_eq!(alone(cluster, &jobs[..1]).await, expected[..1]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn overlapping_frames_are_those_rendered_alone() {
    let pack = pack();
    let (workers, served) = in_memory(3);
    let mut cluster = start(workers, &pack).await;
    for balance in [Balance::Dynamic, Balance::PaperStatic, Balance::PaperDynamic] {
        check_sequences(&mut cluster, &jobs(&pack, balance)).await;
    }
    cluster.stop().await;
    for handle in served {
        handle.await.expect("no panic").expect("dismissed");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn worker_processes_render_overlapping_frames() {
    let pack = pack();
    let workers = Workers::Local(LocalWorkers {
        args_of: Vec::new(),
        through: None,
        program: env!("CARGO_BIN_EXE_tessera").into(),
        args: ["worker", "--ticket", "--backend", "cpu"].map(Into::into).into(),
        count: 3,
        threads: Some(1),
    });
    let mut cluster = start(workers, &pack).await;
    check_sequences(&mut cluster, &jobs(&pack, Balance::Dynamic)).await;
    cluster.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_newest_pose_wins_where_it_is_asked_for() {
    let pack = pack();
    let (workers, _served) = in_memory(2);
    let mut cluster = start(workers, &pack).await;
    let jobs = jobs(&pack, Balance::Dynamic);
    let expected = alone(&mut cluster, &jobs).await;
    for (stale, skipped) in [(Stale::Render, 0), (Stale::Skip, 5), (Stale::GiveUp, 5)] {
        let mut frames =
            cluster.frames(SequenceConfig { stale, ..SequenceConfig::default() }).expect("a pack");
        jobs.iter().for_each(|job| frames.push(job.clone()));
        let mut came = Vec::new();
        while let Some(frame) = frames.next(|_| ()).await.expect("workers are well") {
            assert_eq!(frame.result.image.hash(), expected[frame.number as usize]);
            came.push(frame.number);
        }
        assert!(frames.is_empty());
        assert_eq!((frames.skipped(), frames.given_up(), came.len()), (skipped, 0, 6 - skipped as usize));
        assert_eq!(came.last(), Some(&5), "the newest comes");
    }

    // One that would take hours is under way when a newer one is there: its tiles are stopped.
    let config = SequenceConfig { stale: Stale::GiveUp, groups: 1, depth: 1 };
    let mut frames = cluster.frames(config).expect("a pack");
    frames.push(FrameJob { samples: 1 << 16, width: 4096, height: 4096, tile: 512, ..jobs[0].clone() });
    tokio::select! {
        biased;
        _ = frames.next(|_| ()) => panic!("it takes hours"),
        () = tokio::task::yield_now() => {}
    }
    frames.push(jobs[1].clone());
    let frame = frames.next(|_| ()).await.expect("workers are well").expect("one is wanted");
    assert_eq!((frame.number, frame.result.image.hash()), (1, expected[1]));
    assert_eq!((frames.skipped(), frames.given_up()), (0, 1));
    // And one whose queue is dropped.
    frames.push(FrameJob { samples: 1 << 16, ..jobs[0].clone() });
    tokio::select! {
        biased;
        _ = frames.next(|_| ()) => panic!("it takes hours"),
        () = tokio::task::yield_now() => {}
    }
    drop(frames);
    assert_eq!(alone(&mut cluster, &jobs[2..3]).await, expected[2..3]);
    cluster.stop().await;
}

/// What each frame's line says, and the last line.
fn lines(stdout: &str) -> (Vec<Value>, Value) {
    let mut lines: Vec<Value> =
        stdout.lines().map(|line| serde_json::from_str(line).expect("a JSON line")).collect();
    let last = lines.pop().expect("a last line");
    (lines, last)
}

const SMALL: [&str; 6] = ["--size", "48x32", "--tile", "16", "--backend", "cpu"];

/// Five poses from the first to the last of the path.
const EYES: [&str; 5] = ["0,0,4", "0.25,0,4", "0.5,0,4", "0.75,0,4", "1,0,4"];

const PATH: &str = "{\"eye\": [0, 0, 4], \"target\": [0.3, 0.3, 0], \"fov\": 40}\n\
    {\"eye\": [1, 0, 4], \"target\": [0.3, 0.3, 0], \"fov\": 40}\n";

/// Hashes and bytes of the frames, each rendered by a command of its own.
fn singles(folder: &Folder) -> Vec<(String, Vec<u8>)> {
    let single = |eye: &str| {
        let view = ["--eye", eye, "--target", "0.3,0.3,0", "--fov", "40", "--json"];
        let report = Tessera::new(["render", "a.ply", "--out", "one.png"]).args(SMALL).args(view);
        let hash =
            report.within(folder.path()).run().json()["image_hash"].as_str().expect("a hash").to_owned();
        (hash, fs::read(folder.file("one.png")).expect("a picture"))
    };
    EYES.map(single).into()
}

#[test]
fn a_path_is_rendered_frame_by_frame() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("path.jsonl", PATH);
    let expected = singles(&folder);
    for crew in
        [&["--workers", "0"][..], &["--workers", "3", "--groups", "3"], &["--workers", "2", "--ahead", "1"]]
    {
        let render =
            ["render", "a.ply", "--out", "f-%03d.png", "--path", "path.jsonl", "--frames", "5", "--json"];
        let run = Tessera::new(render).args(SMALL).args(crew).within(folder.path()).run();
        let (frames, sum) = lines(&run.ok());
        let hashes: Vec<_> = frames.iter().map(|frame| frame["hash"].as_str().expect("a hash")).collect();
        assert_eq!(hashes, expected.iter().map(|(hash, _)| hash).collect::<Vec<_>>(), "{crew:?}");
        for (number, (line, (_, bytes))) in frames.iter().zip(&expected).enumerate() {
            assert_eq!(line["frame"], number);
            assert_eq!(line["file"], format!("f-{number:03}.png"));
            assert!(line["bytes_returned"].as_u64().is_some_and(|bytes| bytes > 0));
            assert_eq!(fs::read(folder.file(&format!("f-{number:03}.png"))).expect("a file"), *bytes);
        }
        assert_eq!((&sum["frames"], &sum["skipped"], &sum["given_up"]), (&5.into(), &0.into(), &0.into()));
        assert!(sum["frames_a_second"].as_f64().is_some_and(|fps| fps > 0.0));
        assert!(sum["latency_ms_max"].as_f64() >= sum["latency_ms_p50"].as_f64());
    }
    // For people.
    let text = Tessera::new(["render", "a.ply", "--out", "g%d.png", "--path", "path.jsonl"]);
    let text = text.args(SMALL).within(folder.path()).run().ok();
    assert!(text.contains(&expected[4].0) && text.contains("2 frames in "), "{text}");
}

#[test]
fn poses_on_stdin_are_rendered_as_they_come() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("poses.jsonl", PATH);
    let expected = singles(&folder);
    let render = ["render", "a.ply", "--out", "f-%d.png", "--poses", "-", "--json"];
    let run = || Tessera::new(render).args(SMALL).within(folder.path()).stdin(&folder.file("poses.jsonl"));
    let (frames, _) = lines(&run().run().ok());
    let hashes: Vec<_> = frames.iter().map(|frame| frame["hash"].as_str().expect("a hash")).collect();
    assert_eq!(hashes, [&expected[0].0, &expected[4].0]);
    // Whatever is skipped, the last one comes.
    folder.write("poses.jsonl", PATH.repeat(20));
    for more in [&["--newest"][..], &["--newest", "--give-up"]] {
        let (frames, sum) = lines(&run().args(more).run().ok());
        let last = frames.last().expect("one at least");
        assert_eq!((&last["frame"], &last["hash"]), (&39.into(), &expected[4].0.as_str().into()));
        let of = |name: &str| sum[name].as_u64().expect("a number");
        assert_eq!(of("frames") + of("skipped") + of("given_up"), 40);
    }
    folder.write("poses.jsonl", "{\"eye\": [0, 0, 4]}\n");
    run().run().fails(1, &["--poses -: line 1: missing field `target`"]);
    folder.write("poses.jsonl", "\n{\"eye\": [0, 0, 4], \"target\": [0, 0, 4]}\n");
    run().run().fails(1, &["--poses -: line 2: ", "the same point"]);
}

#[test]
fn what_is_wrong_with_a_sequence_is_said_in_one_line() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("bad.jsonl", "{\"eye\": [0, 0, 4], \"target\": [0, 0, 0], \"fov\": 400}\n");
    folder.write("bad.toml", "[[pose]]\neye = [0, 0, 4]\n");
    let check = |args: &[&str], says: &[&str]| {
        let run = Tessera::new(["render", "a.ply"]).args(args).within(folder.path()).run();
        run.fails(2, says);
        assert_eq!(folder.names(), ["a.ply", "bad.jsonl", "bad.toml"]);
    };
    check(&["--out", "f.png", "--frames", "5"], &["many frames need many names", "frame-%04d.png"]);
    check(&["--out", "f-%d.png", "--frames", "0"], &["--frames"]);
    check(&["--out", "f-%d.png", "--frames", "5"], &["`default` has no animation", "--path"]);
    check(&["--out", "f-%d.png", "--path", "none.jsonl"], &["none.jsonl: cannot be read"]);
    check(&["--out", "f-%d.png", "--path", "bad.jsonl"], &["bad.jsonl: line 1: fov"]);
    check(&["--out", "f-%d.png", "--path", "bad.toml"], &["bad.toml: line 1: missing field `target`"]);
    check(&["--out", "f-%d.png", "--poses", "x"], &["--poses"]);
    check(&["--out", "f-%d.png", "--path", "a", "--poses", "-"], &["cannot be used with"]);
    check(&["--out", "f-%d.png", "--path", "a", "--report", "r.json"], &["of one picture"]);
    check(&["--out", "f-%d.png", "--path", "a", "--newest"], &["cannot be used with"]);
    check(&["--out", "f-%d.png", "--frames", "2", "--give-up"], &["cannot be used with"]);
    check(&["--out", "f-%d.png", "--newest"], &["--poses"]);
    check(
        &["--out", "f-%d.png", "--path", "a", "--trace", "t.json"],
        &["--trace and --overlay", "one frame's"],
    );
    check(&["--out", "f.png", "--groups", "2"], &["--groups is for many frames"]);
    check(&["--out", "f.png", "--ahead", "1"], &["--ahead is for many frames"]);
    let join = "tessera:127.0.0.1:1";
    check(
        &["--out", "f-%d.png", "--path", "a", "--master", join, "--ahead", "1"],
        &["--ahead", "one after the other"],
    );
    let newest = ["--out", "f-%d.png", "--poses", "-", "--newest", "--give-up", "--master", join];
    check(&newest, &["--give-up", "seen to its end"]);
    check(&["--out", "f-%d.png", "--frames", "2", "--fps", "0"], &["--fps"]);
}

/// A triangle, and a camera that goes from x = 0 to x = 1 in two seconds.
fn walk() -> String {
    let floats: Vec<f32> = [
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].as_slice(),
        &[0.0, 2.0],
        &[0.0, 0.0, 4.0, 1.0, 0.0, 4.0],
    ]
    .concat();
    let text: String =
        floats.iter().flat_map(|f| f.to_le_bytes()).map(|byte| format!("%{byte:02x}")).collect();
    let view = |offset: usize, length: usize| serde_json::json!({"buffer": 0, "byteOffset": offset, "byteLength": length});
    let accessor = |view: usize, count: usize, kind: &str| serde_json::json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
    serde_json::json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"camera": 0, "name": "walker"}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [accessor(0, 3, "VEC3"), accessor(1, 2, "SCALAR"), accessor(2, 2, "VEC3")],
        "bufferViews": [view(0, 36), view(36, 8), view(44, 24)],
        "buffers": [{"byteLength": 68, "uri": format!("data:,{text}")}],
        "animations": [{
            "samplers": [{"input": 1, "output": 2}],
            "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
        }],
    })
    .to_string()
}

#[test]
fn an_animated_camera_is_followed() {
    let folder = Folder::new();
    folder.write("walk.gltf", walk());
    let render = |out: &str, more: &[&str]| {
        let render = Tessera::new(["render", "walk.gltf", "--out", out, "--json"]).args(SMALL).args(more);
        render.within(folder.path()).run()
    };
    let still = |x: &str, fov: &str| {
        let (eye, target) = (format!("{x},0,4"), format!("{x},0,3"));
        let view = ["--eye", &eye, "--target", &target, "--fov", fov];
        render("one.png", &view).json()["image_hash"].clone()
    };
    let hashes = |frames: &[Value]| frames.iter().map(|frame| frame["hash"].clone()).collect::<Vec<_>>();
    // 0.7 radians, as 32 bits hold them.
    let fov = f64::from(0.7_f32).to_degrees().to_string();
    let expected = ["0", "0.5", "1"].map(|x| still(x, &fov));
    assert!(expected[0] != expected[1] && expected[1] != expected[2]);
    let (frames, _) = lines(&render("f-%d.png", &["--frames", "3"]).ok());
    assert_eq!(hashes(&frames), expected);
    let (frames, _) = lines(&render("f-%d.png", &["--fps", "1", "--workers", "2", "--groups", "2"]).ok());
    assert_eq!(hashes(&frames), expected);
    let (frames, _) = lines(&render("f-%d.png", &["--fps", "1", "--frames", "4", "--camera", "walker"]).ok());
    assert_eq!(hashes(&frames)[2..], [expected[2].clone(), expected[2].clone()], "it stands at the end");
}
