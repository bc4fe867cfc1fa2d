//! What renders: flags, machines without a GPU, `tessera doctor`, and workers of several numeric classes at one master.

use crate::cluster::{config, in_memory, job, pack};
use crate::support::{Folder, PLY, Tessera, signal};
use serde_json::Value;
use tessera_master::{Balance, Cluster, ClusterConfig, FrameJob, Link, Progress, Workers};
use tessera_trust::Identity;
use tessera_wire::codec::{self, PREFIX_BYTES};
use tessera_wire::{Abilities, Fingerprint, Hello, JoinString, Role, ToMaster, Token};
use tessera_worker::{Connected, NUMERIC_CLASS, WorkerError, WorkerPipes};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::JoinHandle;

/// Without any Vulkan driver, whatever the machine has.
fn without_gpu(args: &[&str]) -> Tessera {
    let hide = |run: Tessera, name| run.env(name, "/nonexistent/driver.json");
    let hidden = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"].into_iter();
    hidden.fold(Tessera::new(args), hide)
}

#[test]
fn a_gpu_that_is_not_there_is_one_line_that_says_what_to_do() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let (fingerprint, token) = (Fingerprint([1; 32]), Token([2; 16]));
    let join = JoinString { host: "127.0.0.1".into(), port: 1, fingerprint, token }.to_string();
    let says = ["no GPU was found", "install its Vulkan driver", "tessera doctor", "--backend cpu"];
    let commands: [&[&str]; 5] = [
        &["render", "a.ply", "--out", "a.png", "--size", "8x8"],
        &["render", "a.ply", "--out", "a.png", "--size", "8x8", "--workers", "2"],
        // Nothing is prepared in vain.
        &["render", "none.ply", "--out", "a.png", "--workers", "1"],
        &["demo", "--workers", "2"],
        &["worker", "--join", &join, "--no-cache"],
    ];
    for command in commands {
        without_gpu(command).args(["--backend", "gpu"]).within(folder.path()).run().fails(1, &says);
        assert_eq!(folder.names(), ["a.ply"], "{command:?}");
    }
}

#[test]
fn flags_that_contradict_each_other_are_wrong_usage() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let check = |args: &[&str], says: &[&str]| {
        Tessera::new(args).within(folder.path()).run().fails(2, says);
        assert_eq!(folder.names(), ["a.ply"], "{args:?}");
    };
    let render = |args: &[&'static str]| [&["render", "a.ply", "--out", "a.png"], args].concat();
    check(&render(&["--backend", "tpu"]), &["--backend", "auto, gpu, cpu"]);
    check(&render(&["--backend", "cpu", "--gpu", "0"]), &["--gpu 0", "--backend cpu"]);
    check(&render(&["--gpu", ""]), &["--gpu"]);
    check(&render(&["--master", "@none", "--backend", "cpu"]), &["--master", "--backend"]);
    check(&render(&["--master", "@none", "--gpu", "0"]), &["--master", "--gpu"]);
    check(&["demo", "--backend", "cpu", "--gpu", "x"], &["--gpu x"]);
}

#[test]
fn without_a_gpu_the_cpu_renders_and_says_so() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    for workers in ["0", "2"] {
        let args = ["render", "a.ply", "--out", "a.png", "--size", "40x40", "--tile", "8", "--json"];
        let run =
            |more: &[&str]| without_gpu(&args).args(["--workers", workers]).args(more).within(folder.path());
        let report = run(&[]).run().json();
        assert_eq!(report["numeric_class"], NUMERIC_CLASS, "{report}");
        assert_eq!((&report["mix"], &report["idle_workers"]), (&false.into(), &0.into()));
        assert!(report.get("classes").is_none() && report.get("differences").is_none());
        for worker in report["workers"].as_array().expect("workers") {
            assert_eq!(
                (&worker["backend"], &worker["numeric_class"]),
                (&"cpu".into(), &NUMERIC_CLASS.into())
            );
            let note = worker["backend_note"].as_str().expect("a note");
            assert!(note.contains("CPU") && note.contains("no GPU"), "{note}");
        }
        // On purpose it is the same picture.
        let chosen = run(&["--backend", "cpu", "--mix"]).run().json();
        assert_eq!(chosen["image_hash"], report["image_hash"]);
        assert_eq!((&chosen["mix"], &chosen["numeric_class"]), (&true.into(), &NUMERIC_CLASS.into()));
        let log = run(&["-v"]).run();
        let said = log.stderr.lines().filter(|line| line.contains("rendering on the CPU")).count();
        assert_eq!(said, workers.parse::<usize>().expect("a number").max(1), "{log:?}");
    }
    let text =
        without_gpu(&["render", "a.ply", "--out", "a.png", "--size", "8x8", "--mix"]).within(folder.path());
    let text = text.run().ok();
    assert!(text.contains(&format!("\nbackend    {NUMERIC_CLASS}: rendering on the CPU")), "{text}");
    assert!(text.contains("alone took part"), "{text}");
}

#[test]
fn doctor_says_what_renders_with_and_without_a_gpu() {
    for run in [Tessera::new, |args: [&str; 2]| without_gpu(&args)] {
        let found = run(["doctor", "--json"]).run().json();
        let keys =
            ["adapters", "auto", "backends", "udp", "memory", "threads", "hints", "can_render", "version"];
        for key in keys {
            assert!(found.get(key).is_some(), "{key} is missing in {found}");
        }
        assert_eq!(found["can_render"], true);
        for key in ["wanted_bytes", "send_bytes", "receive_bytes", "error"] {
            assert!(found["udp"].get(key).is_some(), "{key} is missing in {found}");
        }
        assert!(found["memory"].get("free_bytes").is_some() && found["threads"].as_u64() > Some(0));
        for adapter in found["adapters"].as_array().expect("a list") {
            let keys =
                ["index", "name", "api", "driver", "kind", "memory_bytes", "limits", "f64", "unusable"];
            assert!(keys.iter().all(|key| adapter.get(key).is_some()), "{adapter}");
        }
        let backends = found["backends"].as_array().expect("a list");
        assert_eq!((&backends[0]["asked"], &backends[0]["backend"]), (&"cpu".into(), &"cpu".into()));
        assert_eq!(backends[0]["numeric_class"], NUMERIC_CLASS);
        let lines = backends.iter().chain([&found["auto"]]);
        for line in lines.filter(|line| line["error"].is_null()) {
            assert!(line["rays_per_second"].as_u64() > Some(0) && line["note"].is_string(), "{line}");
        }
        let usable = found["adapters"].as_array().expect("a list").iter().filter(|a| a["unusable"].is_null());
        assert_eq!(backends.len(), 1 + usable.count(), "each is measured: {found}");
    }
    let found = without_gpu(&["doctor", "--json"]).run().json();
    assert_eq!(found["adapters"], Value::Array(Vec::new()));
    assert_eq!(found["auto"]["backend"], "cpu");
    let hints = found["hints"].as_array().expect("a list");
    assert!(
        hints.iter().any(|hint| hint.as_str().is_some_and(|hint| hint.contains("Vulkan driver"))),
        "{hints:?}"
    );
    let text = without_gpu(&["doctor"]).run().ok();
    for part in
        ["GPUs       none was found\n", "\nauto       takes the cpu: ", "\nUDP ", "\nmemory ", "\nhint "]
    {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    Tessera::new(["doctor", "--fix"]).run().fails(2, &["--fix"]);
}

/// A worker of the CPU that says to be of `class`, and as fast as `speed`.
fn disguised(
    mut pipes: WorkerPipes,
    token: Token,
    class: &'static str,
    speed: u64,
) -> JoinHandle<Result<(), WorkerError>> {
    let (inside, mut outside) = tokio::io::duplex(1 << 16);
    let mut to_master = std::mem::replace(&mut pipes.control_out, Box::new(inside));
    tokio::spawn(async move {
        let mut prefix = [0; PREFIX_BYTES];
        outside.read_exact(&mut prefix).await.expect("it says `Hello`");
        let mut body = vec![0; codec::body_length(prefix, 4096).expect("a short one")];
        outside.read_exact(&mut body).await.expect("it says `Hello`");
        let hello = match codec::decode(&body).expect("a message") {
            ToMaster::Hello(Hello { versions, role: Role::Worker(abilities), .. }) => {
                let note = format!("pretending to be {class}");
                let abilities = Abilities { numeric_class: class.into(), speed, note, ..abilities };
                Hello { versions, token, name: class.into(), role: Role::Worker(abilities) }
            }
            other => panic!("{other:?}"),
        };
        let hello = codec::encode(&ToMaster::Hello(hello)).expect("a short one");
        to_master.write_all(&hello).await.expect("the master listens");
        // To the end of either.
        let _ = tokio::io::copy(&mut outside, &mut to_master).await;
        let _ = to_master.shutdown().await;
    });
    tokio::spawn(tessera_worker::serve(pipes, config(class, None)))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_class_renders_a_frame_unless_it_may_be_mixed() {
    let (Workers::Links(mut links), _served) = in_memory(1) else { panic!("links") };
    let (link, pipes) = Link::in_memory();
    let tessera_master::Pipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    let pipes = WorkerPipes { control_in, control_out, bulk_in, bulk_out };
    let _fast = disguised(pipes, Token::default(), "gpu-9", u64::MAX);
    links.push(link);
    let pack = pack();
    let mut cluster =
        Cluster::start(Workers::Links(links), ClusterConfig::default()).await.expect("both classes join");
    cluster.load(&pack, |_| ()).await.expect("both take the pack");
    for balance in Balance::ALL {
        let mut chosen = None;
        let job = FrameJob { width: 256, height: 256, tile: 16, ..job(&pack, balance) };
        let watch = |progress: Progress<'_>| {
            if let Progress::ClassChosen { class, workers, idle } = progress {
                chosen = Some((class.to_owned(), workers, idle));
            }
        };
        let one = cluster.render(&job, watch).await.expect("a frame");
        assert_eq!(chosen, Some(("gpu-9".to_owned(), 1, 1)), "{balance}");
        assert_eq!((one.numeric_class(), one.idle, one.workers.len()), (Some("gpu-9"), 1, 1));

        let both = FrameJob { mix: true, ..job };
        let both = cluster.render(&both, |_| ()).await.expect("a frame");
        assert_eq!((both.numeric_class(), both.idle, both.classes.len()), (None, 0, 2), "{balance}");
        assert_eq!(both.image, one.image, "the same arithmetic under two names");
        let [found] = &both.differences[..] else { panic!("{balance}: {:?}", both.differences) };
        assert_eq!(found.classes, [NUMERIC_CLASS, "gpu-9"]);
        assert_eq!((found.tiles, found.pixels, found.differing), (4, 4 * 256, 0), "{balance}");
        assert_eq!((found.max_abs, found.psnr_db), (0.0, None));
    }
    cluster.stop().await;
}

/// The whole way: the client's flag, the master's log and both reports.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_hear_of_classes_and_of_a_class_that_is_lost() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let run = |args: &str| Tessera::new(args.split(' ')).within(folder.path());
    let mut master = run("master --listen 127.0.0.1:0 --join-file join.txt").start();
    master.wait_for("listening on 127.0.0.1");
    let join = std::fs::read_to_string(folder.file("join.txt")).expect("the join file");
    let join: JoinString = join.trim().parse().expect("a join string");
    let cpu = run("worker --join @join.txt --threads 1 --name slow --backend cpu --no-cache").start();
    master.wait_for("slow has joined");
    let own = Identity::new().expect("random numbers");
    let Connected { pipes, closer } = tessera_worker::connect(&join, &own).await.expect("the master answers");
    let fast = disguised(pipes, join.token, "gpu-9", u64::MAX);
    master.wait_for("gpu-9 has joined");

    // The binary blocks; the worker in this process goes on in the other thread.
    let render = |args: &'static str| {
        let client =
            run("render a.ply --out a.png --size 256x256 --tile 16 --master @join.txt").args(args.split(' '));
        tokio::task::spawn_blocking(move || client.run())
    };
    let report = render("--json").await.expect("no panic").json();
    assert_eq!((&report["numeric_class"], &report["idle_workers"]), (&"gpu-9".into(), &1.into()), "{report}");
    assert_eq!(report["workers"][0]["backend_note"], "pretending to be gpu-9");
    let mixed = render("--json --mix").await.expect("no panic").json();
    assert!(mixed.get("numeric_class").is_none(), "{mixed}");
    let classes: Vec<_> = mixed["classes"].as_array().expect("classes").iter().map(|c| &c["class"]).collect();
    assert!(classes.len() == 2 && classes.contains(&&"gpu-9".into()), "{mixed}");
    let found = &mixed["differences"][0];
    assert_eq!(found["classes"], serde_json::json!([NUMERIC_CLASS, "gpu-9"]), "{mixed}");
    assert_eq!((&found["differing"], &found["psnr_db"]), (&0.into(), &Value::Null), "{mixed}");
    for key in ["tiles", "pixels", "differing_share", "max_abs"] {
        assert!(found[key].is_number(), "{key}: {found}");
    }
    assert_eq!(mixed["image_hash"], report["image_hash"]);
    let text = render("--mix").await.expect("no panic").ok();
    assert!(text.contains("\ndifference cpu-") && text.contains("comparable with no other"), "{text}");

    // The fast one goes in the middle of a frame that it has for itself.
    let client =
        run("render a.ply --out b.png --size 900x900 --tile 8 --spp 16 --master @join.txt --json -vv");
    let mut client = tokio::task::spawn_blocking(move || {
        let mut client = client.start();
        client.wait_for("5 of 12769 tiles");
        client
    })
    .await
    .expect("no panic");
    fast.abort();
    closer.close(false).await;
    client.wait_for("class gpu-9 is lost: class cpu-");
    let outcome = tokio::task::spawn_blocking(move || client.finish()).await.expect("no panic");
    let report: Value = serde_json::from_str(&outcome.ok()).expect("one JSON object");
    assert_eq!(report["numeric_class"], NUMERIC_CLASS);
    assert!(report["dropped_tiles"].as_u64() >= Some(5), "{report}");
    let tiles = |name: &str| {
        let workers = report["workers"].as_array().expect("workers").iter();
        workers.filter(|w| w["name"] == name).map(|w| w["tiles"].as_u64().expect("tiles")).sum::<u64>()
    };
    assert_eq!((tiles("slow"), tiles("gpu-9")), (113 * 113, 0), "{report}");
    master.wait_for("class gpu-9 is lost: class cpu-");
    signal("TERM", master.id());
    let outcome = master.finish();
    assert!(outcome.stderr.contains("rendered in class gpu-9 by 1 of 2 workers"), "{outcome:?}");
    cpu.finish().ok();
}
