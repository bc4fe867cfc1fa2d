//! A master that serves: workers that come and go, clients, and those who may be neither.

use crate::cluster::{config, job, pack, serve_ticket, strip};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use tessera_master::{
    Balance, Client, ClientError, Cluster, ClusterConfig, FrameJob, FrameResult, ListenConfig, Pipes,
    PixelFormat, Progress, Service, ServiceConfig, Workers,
};
use tessera_pack::Pack;
use tessera_trust::Identity;
use tessera_wire::codec::{self, PREFIX_BYTES};
use tessera_wire::{
    AbortCode, FrameFailure, FrameId, FromClient, Hello, JoinString, PackChunk, PackId, PackRefusal, Refusal,
    Role, ToClient, Token, Version, limits,
};
use tessera_worker::{Closer, Connected, NUMERIC_CLASS, Stop, WorkerError, WorkerPipes, connect};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::{Notify, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// No wait here takes a tenth of it; what takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(100);

/// A master in this process.
struct Master {
    join: JoinString,
    stop: Option<oneshot::Sender<()>>,
    served: JoinHandle<()>,
}

fn master(pack_bytes: u64) -> Master {
    let listen = (Ipv4Addr::LOCALHOST, 0).into();
    let at = ListenConfig { listen, advertise: None, token_ttl: Some(PATIENCE) };
    let config = ServiceConfig { pack_bytes, ..ServiceConfig::default() };
    let (service, join) = Service::listen(config, at).expect("a port is free");
    let (stop, stopped) = oneshot::channel::<()>();
    let served = tokio::spawn(service.run(async { _ = stopped.await }));
    Master { join, stop: Some(stop), served }
}

impl Master {
    fn worker(&self, name: &str) -> JoinHandle<Result<(), WorkerError>> {
        let (join, name) = (self.join.clone(), name.to_string());
        tokio::spawn(async move {
            let own = Identity::new().expect("random numbers");
            serve(&join, &own, &name).await
        })
    }

    async fn client(&self) -> (Client, Closer) {
        let (pipes, closer) = pipes(&self.join).await;
        let client = Client::join(pipes, self.join.token, "c".into()).await.expect("it is let in");
        (client, closer)
    }

    async fn end(mut self) {
        drop(self.stop.take());
        timeout(PATIENCE, self.served).await.expect("it ends").expect("no panic");
    }
}

/// A worker with one thread.
async fn serve(join: &JoinString, own: &Identity, name: &str) -> Result<(), WorkerError> {
    let (_nobody, stop) = watch::channel(Stop::No);
    tessera_worker::serve_master(join, own, config(name, None), stop).await.map(drop)
}

async fn pipes(join: &JoinString) -> (Pipes, Closer) {
    let own = Identity::new().expect("random numbers");
    let Connected { pipes, closer } = connect(join, &own).await.expect("the master answers");
    let WorkerPipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    (Pipes { control_in, control_out, bulk_in, bulk_out }, closer)
}

/// What a cluster in this process makes of it.
async fn reference(pack: &Pack, job: &FrameJob) -> FrameResult {
    let (workers, _served) = crate::cluster::in_memory(1);
    let mut alone = Cluster::start(workers, ClusterConfig::default()).await.expect("one joins");
    alone.load(pack, |_| ()).await.expect("it takes the pack");
    let result = alone.render(job, |_| ()).await.expect("a frame");
    alone.stop().await;
    result
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_get_the_image_that_a_local_render_makes_and_send_a_pack_once() {
    let packs = [pack(), strip(3000)];
    let master = master(1 << 30);
    let workers = [master.worker("a"), master.worker("b")];
    for (round, pack) in [&packs[0], &packs[1], &packs[0]].into_iter().enumerate() {
        let (mut client, closer) = master.client().await;
        let mut sent = 0;
        let upload = |progress: Progress<'_>| {
            if let Progress::Sent { bytes, .. } = progress {
                sent = bytes;
            }
        };
        client.load(pack, upload).await.expect("there is room");
        assert_eq!(sent, if round < 2 { pack.bytes().len() as u64 } else { 0 }, "round {round}");
        for (balance, format) in Balance::ALL.into_iter().zip(PixelFormat::ALL.into_iter().cycle()) {
            let job = FrameJob { format, ..job(pack, balance) };
            let mut tiles = (0, 0);
            let watch = |progress: Progress<'_>| {
                if let Progress::Tiles { done, total } = progress {
                    assert!(done > tiles.0, "tiles come one after the other");
                    tiles = (done, total);
                }
            };
            let result = client.render(&job, watch).await.expect("a frame");
            let local = reference(pack, &job).await;
            assert_eq!(result.image.hash(), local.image.hash(), "round {round}, {balance}, {format}");
            assert_eq!((result.rays, result.pack), (local.rays, local.pack));
            assert_eq!(result.workers.iter().map(|w| w.tiles).sum::<u32>(), 20);
            // Pixels may travel packed; QUIC adds to what workers have returned.
            let returned: u64 = result.workers.iter().map(|w| w.bytes_returned).sum();
            assert!(tiles.1 == 20 && returned > 0 && result.traffic.udp_received > returned);
            assert_eq!(result.numeric_class(), Some(NUMERIC_CLASS));
        }
        closer.close(false).await;
    }
    master.end().await;
    for worker in workers {
        worker.await.expect("no panic").expect("dismissed");
    }
}

/// A frame that takes far longer than any test.
fn endless(pack: &Pack) -> FrameJob {
    FrameJob { width: 4000, height: 4000, tile: 16, samples: 64, ..job(pack, Balance::Dynamic) }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_goes_takes_its_frame_along() {
    let pack = pack();
    let master = master(1 << 30);
    let _worker = master.worker("a");
    let (mut first, closer) = master.client().await;
    first.load(&pack, |_| ()).await.expect("there is room");
    let (begun, is_begun) = oneshot::channel();
    let mut begun = Some(begun);
    let endless = endless(&pack);
    let frame = tokio::spawn(async move {
        let watch = |progress: Progress<'_>| {
            if matches!(progress, Progress::Tiles { .. }) {
                begun.take().map(|begun| begun.send(()));
            }
        };
        first.render(&endless, watch).await.map(drop)
    });
    timeout(PATIENCE, is_begun).await.expect("in time").expect("a tile comes");

    let (mut second, _closer) = master.client().await;
    second.load(&pack, |_| ()).await.expect("there is room");
    let small = job(&pack, Balance::Static);
    let mut waited = None;
    let (waits, is_waiting) = oneshot::channel();
    let mut waits = Some(waits);
    let render = second.render(&small, |progress| {
        if let Progress::Waiting { ahead } = progress {
            waited = Some(ahead);
            waits.take().map(|waits| waits.send(()));
        }
    });
    let leave = async {
        is_waiting.await.expect("it is told");
        frame.abort();
        closer.close(false).await;
    };
    let (result, ()) = timeout(PATIENCE, async { tokio::join!(render, leave) }).await.expect("in time");
    assert_eq!(result.expect("its turn comes").image, reference(&pack, &small).await.image);
    assert_eq!(waited, Some(1));
    master.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_master_that_is_stopped_or_dies_is_named() {
    let pack = pack();
    for is_stopped in [true, false] {
        let mut master = master(1 << 30);
        let _worker = master.worker("a");
        let (mut client, _closer) = master.client().await;
        client.load(&pack, |_| ()).await.expect("there is room");
        let stop = master.stop.take();
        let mut stop = stop.map(|stop| (stop, master.served.abort_handle()));
        let watch = |progress: Progress<'_>| {
            if let (Progress::Tiles { .. }, Some((stop, task))) = (progress, stop.take()) {
                if is_stopped {
                    drop(stop);
                } else {
                    // Its tasks die with it, and its connections with them.
                    task.abort();
                    std::mem::forget(stop);
                }
            }
        };
        let endless = endless(&pack);
        let render = timeout(PATIENCE, client.render(&endless, watch));
        let error = render.await.expect("it does not hang").expect_err("no frame");
        if is_stopped {
            assert!(matches!(error, ClientError::Failed(FrameFailure::Stopping)), "{error:?}");
        } else {
            // The cluster goes, and with it the frame; or the connection does first.
            let is_told = matches!(&error, ClientError::Failed(FrameFailure::Stopping));
            assert!(is_told || matches!(error, ClientError::Lost(_)), "{error:?}");
        }
        assert_eq!(error.to_string().lines().count(), 1);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_waits_for_the_first_worker() {
    let pack = pack();
    let master = master(1 << 30);
    let (mut client, _closer) = master.client().await;
    client.load(&pack, |_| ()).await.expect("there is room");
    let job = job(&pack, Balance::Dynamic);
    let mut worker = None;
    let result = client.render(&job, |progress| {
        if progress == Progress::NoWorkers {
            worker = Some(master.worker("late"));
        }
    });
    let result = timeout(PATIENCE, result).await.expect("in time").expect("a frame");
    assert_eq!(result.workers[0].name, "late");
    master.end().await;
    worker.expect("it was asked for").await.expect("no panic").expect("dismissed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn packs_and_frames_that_cannot_be_are_refused_and_do_no_harm() {
    let (small, large) = (pack(), strip(60_000));
    let good = job(&small, Balance::Dynamic);
    let image = u64::from(good.width) * u64::from(good.height) * good.format.bytes_per_pixel() as u64;
    let room = small.bytes().len() as u64 + image;
    let master = master(room);
    let _worker = master.worker("a");
    let (mut client, _closer) = master.client().await;
    let refused = client.load(&large, |_| ()).await;
    let needs = large.bytes().len() as u64;
    let expected = PackRefusal::OutOfMemory { needs, has: room };
    assert!(matches!(&refused, Err(ClientError::Rejected(r)) if *r == expected), "{refused:?}");
    client.load(&small, |_| ()).await.expect("there is room");
    let wild = FrameJob { samples: 0, ..good.clone() };
    assert!(matches!(
        client.render(&wild, |_| ()).await,
        Err(ClientError::Failed(FrameFailure::Invalid { .. }))
    ));
    let huge = FrameJob { height: good.height + 1, ..good.clone() };
    match client.render(&huge, |_| ()).await {
        Err(ClientError::Failed(FrameFailure::Invalid { detail })) => {
            assert!(detail.contains(&format!("the master has {image} left")), "{detail}");
        }
        other => panic!("{other:?}"),
    }
    client.render(&good, |_| ()).await.expect("refused frames do no harm");

    // Bytes that are no pack, and a pack under another's name.
    let mut raw = Raw::join(&master.join).await;
    let offer = |pack, length| FromClient::PackOffer { pack, length };
    let id = PackId([9; 32]);
    for bytes in [vec![7; 100], Vec::new(), small.bytes().to_vec()] {
        raw.write(&offer(id, bytes.len() as u64)).await;
        assert_eq!(raw.read().await, ToClient::PackNeed { pack: id, have: false });
        raw.send(id, &bytes).await;
        match raw.read().await {
            ToClient::PackRejected { reason: PackRefusal::Invalid { .. }, .. } => assert!(bytes.len() <= 100),
            ToClient::PackRejected { reason: PackRefusal::HashMismatch { got }, .. } => {
                assert_eq!(got.0, small.id().0);
            }
            other => panic!("{other:?}"),
        }
    }
    // Frames of what was not taken, and out of range.
    let frame = tessera_wire::Frame {
        frame: FrameId(1),
        pack: id,
        camera: tessera_wire::Camera {
            origin: [0.0; 3],
            forward: [0.0, 0.0, -1.0],
            right: [1.0, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
        },
        width: 8,
        height: 8,
        tile: 8,
        samples: 1,
        sampling: Default::default(),
        depth: 0,
        seed: 0,
        features: Default::default(),
        format: PixelFormat::Rgba8,
        returns: tessera_wire::ReturnMode::AtEnd,
        coding: tessera_wire::Coding::Raw,
    };
    let invalid = |answer| {
        let reason = match answer {
            ToClient::Failed { frame: FrameId(1), reason } => reason,
            other => panic!("{other:?}"),
        };
        assert!(matches!(reason, FrameFailure::Invalid { .. }), "{reason:?}");
    };
    raw.write(&FromClient::Render { frame, balance: Balance::Static, mix: false }).await;
    invalid(raw.read().await);
    let own = PackId(small.id().0);
    raw.write(&offer(own, 1)).await;
    assert_eq!(raw.read().await, ToClient::PackNeed { pack: own, have: true });
    assert_eq!(raw.read().await, ToClient::PackReady { pack: own });
    let wild = tessera_wire::Frame { pack: own, tile: 0, ..frame };
    raw.write(&FromClient::Render { frame: wild, balance: Balance::Static, mix: false }).await;
    invalid(raw.read().await);
    client.render(&good, |_| ()).await.expect("nor does a stranger's nonsense");
    master.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_breaks_the_rules_is_cut_off_with_a_reason() {
    let master = master(1 << 20);
    let id = PackId([9; 32]);
    let chunk = |offset, length| codec::encode(&PackChunk { pack: id, offset, length }).expect("small");
    let hello = codec::encode(&FromClient::Hello(hello(master.join.token, Role::Client))).expect("small");
    let too_long = (limits::CONTROL_BYTES as u32 + 1).to_le_bytes().to_vec();
    for (control, code) in [
        (hello, AbortCode::Unexpected),
        (too_long, AbortCode::Malformed),
        (vec![1, 0, 0, 0, 99], AbortCode::Malformed),
    ] {
        let mut raw = Raw::join(&master.join).await;
        raw.pipes.control_out.write_all(&control).await.expect("it listens");
        raw.is_cut(code).await;
    }
    for bulk in [chunk(1, 10), chunk(0, 0), chunk(0, 101), vec![255; 8]] {
        let mut raw = Raw::join(&master.join).await;
        raw.write(&FromClient::PackOffer { pack: id, length: 100 }).await;
        assert_eq!(raw.read().await, ToClient::PackNeed { pack: id, have: false });
        raw.pipes.bulk_out.write_all(&bulk).await.expect("it listens");
        raw.is_cut(AbortCode::Malformed).await;
    }
    master.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_master_takes_so_many_clients_and_no_more() {
    let master = master(1 << 20);
    let mut clients = Vec::new();
    for _ in 0..limits::CLIENTS {
        clients.push(master.client().await);
    }
    let limit = limits::CLIENTS as u32;
    for _ in 0..3 {
        let (pipes, _closer) = pipes(&master.join).await;
        let full = Client::join(pipes, master.join.token, "c".into()).await.err().expect("no seat is free");
        assert!(matches!(full, ClientError::Refused(Refusal::Full { limit: l }) if l == limit), "{full:?}");
    }
    master.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pack_that_a_client_holds_is_not_forgotten_to_make_room_for_another() {
    let (one, other) = (strip(3000), strip(3001));
    let length = one.bytes().len() as u64;
    // For one and a half.
    let room = length + length / 2;
    let master = master(room);
    let (mut first, first_closer) = master.client().await;
    first.load(&one, |_| ()).await.expect("there is room");
    let (mut second, _closer) = master.client().await;
    let needs = other.bytes().len() as u64;
    let expected = PackRefusal::OutOfMemory { needs, has: room - length };
    let refused = second.load(&other, |_| ()).await;
    assert!(matches!(&refused, Err(ClientError::Rejected(r)) if *r == expected), "{refused:?}");
    drop(first);
    first_closer.close(false).await;
    let load = async {
        // The master learns soon that it has gone.
        while let Err(error) = second.load(&other, |_| ()).await {
            assert!(matches!(error, ClientError::Rejected(_)), "{error:?}");
        }
    };
    timeout(PATIENCE, load).await.expect("its room is free");
    second.load(&one, |_| ()).await.expect("what one client has offered before goes for what it offers now");
    master.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_bad_joins_does_not_disturb_a_frame() {
    let pack = pack();
    let master = master(1 << 30);
    let workers = [master.worker("a"), master.worker("b")];
    let (mut client, _closer) = master.client().await;
    client.load(&pack, |_| ()).await.expect("there is room");
    let job = FrameJob { width: 600, height: 600, tile: 32, samples: 4, ..job(&pack, Balance::Dynamic) };
    let (over, refused) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let one_more = Arc::new(Notify::new());
    let flood = |bad: JoinString| {
        let (over, refused, one_more) = (over.clone(), refused.clone(), one_more.clone());
        tokio::spawn(async move {
            while !over.load(Ordering::Relaxed) {
                let own = Identity::new().expect("random numbers");
                let result = serve(&bad, &own, "x").await;
                assert!(matches!(result, Err(WorkerError::Refused(_) | WorkerError::Join(_))), "{result:?}");
                refused.fetch_add(1, Ordering::Relaxed);
                one_more.notify_one();
            }
        })
    };
    let guessed = JoinString { token: Token([1; 16]), ..master.join.clone() };
    let floods: Vec<_> = (0..20).map(|_| flood(guessed.clone())).collect();
    let flooded = async {
        while refused.load(Ordering::Relaxed) < 20 {
            one_more.notified().await;
        }
    };
    timeout(PATIENCE, flooded).await.expect("each is answered");
    let before = refused.load(Ordering::Relaxed);
    let result = timeout(PATIENCE, client.render(&job, |_| ())).await.expect("in time").expect("a frame");
    let during = refused.load(Ordering::Relaxed) - before;
    over.store(true, Ordering::Relaxed);
    assert!(during > 0, "the flood went on");
    assert_eq!(result.image, reference(&pack, &job).await.image);
    assert!(
        result.workers.len() == 2 && result.workers.iter().all(|w| w.lost.is_none()),
        "{:?}",
        result.workers
    );
    for flood in floods {
        timeout(PATIENCE, flood).await.expect("in time").expect("each was refused");
    }
    master.end().await;
    for worker in workers {
        worker.await.expect("no panic").expect("dismissed");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_comes_back_takes_its_own_place() {
    let pack = pack();
    let master = master(1 << 30);
    let own = Arc::new(Identity::new().expect("random numbers"));
    let serve = |name: &'static str| {
        let (join, own) = (master.join.clone(), own.clone());
        tokio::spawn(async move { serve(&join, &own, name).await })
    };
    let (mut client, _closer) = master.client().await;
    client.load(&pack, |_| ()).await.expect("there is room");
    let job = job(&pack, Balance::Dynamic);
    let first = serve("first");
    let names = |result: FrameResult| result.workers.into_iter().map(|w| w.name).collect::<Vec<_>>();
    assert_eq!(names(client.render(&job, |_| ()).await.expect("a frame")), ["first"]);
    let second = serve("second");
    let replaced = timeout(PATIENCE, first).await.expect("in time").expect("no panic");
    let replaced = replaced.expect_err("the master has cut it off");
    assert!(matches!(replaced, WorkerError::Aborted { code: AbortCode::Replaced, .. }), "{replaced:?}");
    assert!(!replaced.may_pass());
    assert_eq!(names(client.render(&job, |_| ()).await.expect("a frame")), ["second"]);
    master.end().await;
    second.await.expect("no panic").expect("dismissed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cluster_of_its_own_workers_takes_no_clients() {
    let hand_out = |tickets: Vec<tessera_wire::LocalTicket>| {
        for ticket in tickets {
            tokio::spawn(async move {
                let (pipes, _closer) = pipes(&ticket.join).await;
                let refused =
                    Client::join(pipes, ticket.join.token, "c".into()).await.err().expect("refused");
                assert!(matches!(refused, ClientError::Refused(Refusal::Role)), "{refused:?}");
                serve_ticket(ticket).await
            });
        }
    };
    let runtime = tokio::runtime::Handle::current();
    let hand_out = move |tickets| {
        let _in = runtime.enter();
        hand_out(tickets);
    };
    let cluster = Cluster::start(Workers::Tickets(1, Box::new(hand_out)), ClusterConfig::default());
    cluster.await.expect("the ticket was not used up").stop().await;
}

fn hello(token: Token, role: Role) -> Hello {
    Hello { versions: Version::supported_numbers(), token, name: "raw".into(), role }
}

/// A client that can say anything.
struct Raw {
    pipes: Pipes,
    _closer: Closer,
}

impl Raw {
    async fn join(join: &JoinString) -> Self {
        let (pipes, _closer) = pipes(join).await;
        let mut raw = Self { pipes, _closer };
        raw.write(&FromClient::Hello(hello(join.token, Role::Client))).await;
        assert!(matches!(raw.read().await, ToClient::Welcome { .. }));
        raw
    }

    async fn write(&mut self, message: &FromClient) {
        let bytes = codec::encode(message).expect("within its limit");
        self.pipes.control_out.write_all(&bytes).await.expect("the master listens");
    }

    async fn send(&mut self, pack: PackId, bytes: &[u8]) {
        for (number, piece) in bytes.chunks(1 << 20).enumerate() {
            let chunk = PackChunk { pack, offset: (number as u64) << 20, length: piece.len() as u32 };
            self.pipes.bulk_out.write_all(&codec::encode(&chunk).expect("small")).await.expect("it listens");
            self.pipes.bulk_out.write_all(piece).await.expect("it listens");
        }
    }

    async fn read(&mut self) -> ToClient {
        let read = async {
            let mut prefix = [0; PREFIX_BYTES];
            self.pipes.control_in.read_exact(&mut prefix).await.expect("an answer");
            let mut body =
                vec![0; codec::body_length(prefix, limits::CONTROL_BYTES).expect("within its limit")];
            self.pipes.control_in.read_exact(&mut body).await.expect("an answer");
            codec::decode(&body).expect("a message")
        };
        timeout(PATIENCE, read).await.expect("the master answers")
    }

    async fn is_cut(&mut self, expected: AbortCode) {
        match self.read().await {
            ToClient::Abort { code, .. } => assert_eq!(code, expected),
            other => panic!("{other:?}"),
        }
        let rest = timeout(PATIENCE, self.pipes.control_in.read(&mut [0])).await.expect("it closes");
        assert!(matches!(rest, Ok(0) | Err(_)), "nothing follows");
    }
}
