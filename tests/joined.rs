//! Workers that join by a join string: they leave in peace, come back, and keep packs on disk.

use crate::cluster::{job, strip};
use crate::support::{Folder, Live, Tessera, signal};
use std::sync::Mutex;
use tessera_master::{Balance, Cluster, ClusterConfig, FrameJob, ListenConfig, Progress};
use tessera_wire::JoinString;
use tessera_worker::NUMERIC_CLASS;
use tokio::sync::Notify;

/// A master in this process, on loopback.
fn listening() -> (Cluster, JoinString) {
    let config = ClusterConfig {
        numeric_class: Some(NUMERIC_CLASS.into()),
        patience: std::time::Duration::from_secs(60),
    };
    let at = ListenConfig { listen: ([127, 0, 0, 1], 0).into(), advertise: None, token_ttl: None };
    Cluster::listen(config, at).expect("loopback can be listened on")
}

/// A worker process, with what is said of its cache.
fn worker(join: &str, name: &str, cache: &[&str]) -> Live {
    let args = ["worker", "--join", join, "--name", name, "--threads", "1", "--backend", "cpu", "-v"];
    Tessera::new(args).args(cache).start()
}

/// A join string that is well formed.
fn join_string() -> JoinString {
    JoinString {
        host: "127.0.0.1".into(),
        port: 1,
        fingerprint: tessera_wire::Fingerprint([1; 32]),
        token: tessera_wire::Token([2; 16]),
    }
}

/// Waits until `count` more workers have joined.
async fn joined(cluster: &mut Cluster, count: usize) {
    let (mut seen, enough) = (0, Notify::new());
    let attend = cluster.attend(|progress| {
        if let Progress::WorkerJoined { .. } = progress {
            seen += 1;
            if seen == count {
                enough.notify_one();
            }
        }
    });
    tokio::select! {
        () = attend => {}
        () = enough.notified() => {}
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_is_asked_to_stop_leaves_in_peace_in_every_balancing() {
    let (mut cluster, join) = listening();
    let join = join.to_string();
    let pack = strip(3000);
    let stays = worker(&join, "stays", &["--no-cache"]);
    joined(&mut cluster, 1).await;
    cluster.load(&pack, |_| ()).await.expect("it takes the pack");
    for balance in Balance::ALL {
        let leaves = worker(&join, "leaves", &["--no-cache"]);
        joined(&mut cluster, 1).await;
        cluster.load(&pack, |_| ()).await.expect("both hold it");
        let job = FrameJob { width: 600, height: 600, tile: 8, samples: 4, ..job(&pack, balance) };
        let id = Mutex::new(Some(leaves.id()));
        // With `paper-static` the first tiles come at the end; the frame is announced before.
        if balance == Balance::PaperStatic {
            signal("TERM", id.lock().expect("one thread").take().expect("not yet"));
        }
        let result = cluster.render(&job, |progress| {
            if let Progress::Tiles { .. } = progress
                && let Some(id) = id.lock().expect("one thread").take()
            {
                signal("TERM", id);
            }
        });
        let result = result.await.expect("one worker stays");
        assert_eq!(result.workers.iter().map(|w| w.tiles).sum::<u32>(), 75 * 75, "{balance}");
        assert_eq!(result.dropped_tiles, 0, "{balance}: nothing was rendered twice");
        let lost: Vec<_> = result.workers.iter().filter_map(|w| w.lost.as_deref()).collect();
        assert!(lost.iter().all(|reason| *reason == "it left"), "{balance}: {lost:?}");
        let outcome = leaves.finish();
        assert_eq!(outcome.code, Some(0), "{balance}: {outcome:?}");
        assert!(outcome.stderr.contains("SIGTERM: leaving after the tile in hand"), "{outcome:?}");
    }
    cluster.stop().await;
    stays.finish().ok();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_was_killed_comes_back_with_its_packs() {
    let (mut cluster, join) = listening();
    let join = join.to_string();
    let pack = strip(3000);
    let folder = Folder::new();
    let cache = folder.path().to_str().expect("a plain path");
    let kept = ["--cache-dir", cache, "--cache-limit", "1GiB"];
    let mut sent = vec![0];
    for args in [&kept[..], &kept[..], &["--no-cache"]] {
        let mut process = worker(&join, "w", args);
        joined(&mut cluster, 1).await;
        cluster.load(&pack, |_| ()).await.expect("it takes the pack");
        if sent.len() == 1 {
            process.wait_for("is kept in the cache");
        }
        // The one that was killed before may not be missed yet: its tiles come from this one.
        let result = cluster.render(&job(&pack, Balance::Dynamic), |_| ()).await.expect("it is well");
        sent.push(result.traffic.sent);
        signal("KILL", process.id());
    }
    let length = pack.bytes().len() as u64;
    let is_sent: Vec<_> = sent.windows(2).map(|pair| pair[1] - pair[0] >= length).collect();
    assert_eq!(is_sent, [true, false, true], "{sent:?}, a pack of {length}");
    assert!(sent[2] - sent[1] < length / 4, "messages alone: {sent:?}");
    assert_eq!(folder.names(), [format!("{}.tpack", pack.id())]);
    cluster.stop().await;
}

/// `tessera master` on this port, and the line that it prints.
fn master(port: u16, join_file: &str) -> (Live, JoinString) {
    let address = format!("127.0.0.1:{port}");
    let mut master = Tessera::new(["master", "--listen", &address, "--join-file", join_file, "-v"]).start();
    let join = master.line().parse().expect("a join string");
    (master, join)
}

#[test]
fn a_worker_finds_a_master_that_was_started_again_by_its_file_and_gives_up_without() {
    let folder = Folder::new();
    let file = folder.file("join.txt");
    let file = file.to_str().expect("a plain path");
    let (first, join) = master(0, file);
    // Their own word: a master that dies before it has told them has not taken them.
    let mut from_file = worker(&format!("@{file}"), "from-file", &["--no-cache"]);
    from_file.wait_for("the master has let this worker in");
    let mut fixed = worker(&join.to_string(), "fixed", &["--no-cache"]);
    fixed.wait_for("the master has let this worker in");
    signal("KILL", first.id());
    first.finish();
    // A new certificate and a new token at the same address.
    let (mut second, _) = master(join.port, file);
    second.wait_for("from-file has joined");
    let outcome = fixed.finish();
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    let last = outcome.stderr.lines().last().unwrap_or_default();
    assert!(
        last.starts_with("tessera: error: ") && last.contains("is not the one that the join string is of")
    );
    signal("TERM", second.id());
    second.finish().ok();
    // Dismissed.
    from_file.finish().ok();
}

#[test]
fn a_worker_that_finds_nobody_gives_up_at_once_or_when_its_time_is_over() {
    // Nobody listens there: the socket is closed again.
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").expect("a port");
    let port = socket.local_addr().expect("bound").port();
    drop(socket);
    let nobody = JoinString { port, ..join_string() };
    let nobody = nobody.to_string();
    let wrong = ["worker", "--join", &nobody, "--no-cache", "--backend", "cpu"];
    let outcome = Tessera::new(wrong).run();
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    let lines: Vec<_> = outcome.stderr.lines().collect();
    // What renders is said when the worker starts; then it fails in one line.
    assert!(lines.len() == 2 && lines[0].contains("rendering on the CPU"), "{outcome:?}");
    assert!(lines[1].starts_with("tessera: error: no master at 127.0.0.1"), "{outcome:?}");
    let outcome = Tessera::new(wrong).args(["--retry-for", "8s"]).run();
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    // Silence is noticed after 5 s.
    assert!(outcome.stderr.contains("joining again in"), "{outcome:?}");
    Tessera::new(wrong).args(["--retry-for", "soon"]).run().fails(2, &["write a time of 1s to 366d"]);
}
