//! Master and workers in this process, over memory and over QUIC: one image for every balancing and any
//! number of workers.

use crate::support::Folder;
use std::sync::{Arc, Mutex};
use tessera_geometry::{LocalCamera, Vec3};
use tessera_kdtree::Kernel;
use tessera_master::coordinator::BeginError;
use tessera_master::{
    Balance, Cluster, ClusterConfig, FrameJob, FrameResult, Link, LoadError, LocalWorkers, PixelFormat,
    RenderError, StartError, Workers,
};
use tessera_pack::{Material, Pack, PackInput, PackOptions, build_pack};
use tessera_wire::{
    Adaptive, Coding, FrameError, FrameId, LocalTicket, PackRefusal, Refusal, Sampler, Sampling,
};
use tessera_worker::gpu::probe::cpu_frame;
use tessera_worker::{
    Backend, BackendChoice, BackendConfig, JoinError, NUMERIC_CLASS, PackCache, Stop, WorkerConfig,
    WorkerError, WorkerPipes,
};
use tokio::task::JoinHandle;

pub type Served = JoinHandle<Result<(), WorkerError>>;

/// A tilted square in front of the camera.
pub fn pack() -> Pack {
    let input = PackInput {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, -1.0], [-1.0, 1.0, -1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material_runs: vec![(0, 0)],
        materials: vec![Material::default()],
        ..PackInput::default()
    };
    build_pack(input, &PackOptions::default()).expect("two triangles").0
}

/// A strip of `count` triangles: a pack of more than one chunk.
pub fn strip(count: u32) -> Pack {
    let corner = |i: u32| [f64::from(i), f64::from(i % 2), 0.0];
    let input = PackInput {
        positions: (0..count + 2).map(corner).collect(),
        triangles: (0..count).map(|i| [i, i + 1, i + 2]).collect(),
        material_runs: vec![(0, 0)],
        materials: vec![Material::default()],
        ..PackInput::default()
    };
    build_pack(input, &PackOptions::default()).expect("a strip").0
}

pub fn job(pack: &Pack, balance: Balance) -> FrameJob {
    let frame = pack.frame();
    let origin = frame.to_local(tessera_geometry::DVec3::new(0.2, 0.1, 3.0));
    FrameJob {
        tile: 32,
        depth: 2,
        format: PixelFormat::Layers,
        balance,
        ..FrameJob::new(
            LocalCamera { origin, forward: -Vec3::Z, right: Vec3::X * 0.6, up: Vec3::Y * 0.4 },
            150,
            100,
        )
    }
}

/// The CPU: what is compared bit for bit must not depend on the machine's devices.
pub fn cpu() -> Backend {
    let config = BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() };
    Backend::open(&config).expect("there is a CPU")
}

pub fn config(name: &str, memory: Option<u64>) -> WorkerConfig {
    WorkerConfig { name: name.into(), threads: 1, backend: cpu(), memory, cache: None }
}

/// A worker over memory.
pub fn worker(config: WorkerConfig) -> (Link, Served) {
    let (link, pipes) = Link::in_memory();
    let pipes = WorkerPipes {
        control_in: pipes.control_in,
        control_out: pipes.control_out,
        bulk_in: pipes.bulk_in,
        bulk_out: pipes.bulk_out,
    };
    (link, tokio::spawn(tessera_worker::serve(pipes, config)))
}

/// `count` workers over memory.
pub fn in_memory(count: usize) -> (Workers, Vec<Served>) {
    let (links, served) = (0..count).map(|index| worker(config(&format!("w{index}"), None))).unzip();
    (Workers::Links(links), served)
}

/// A worker that nobody asks to stop.
pub async fn serve_ticket(ticket: LocalTicket) -> Result<(), WorkerError> {
    let (_nobody, stop) = tokio::sync::watch::channel(Stop::No);
    tessera_worker::serve_ticket(ticket, cpu(), stop).await
}

/// `count` workers over QUIC on loopback.
pub fn over_quic(count: u32) -> (Workers, Arc<Mutex<Vec<Served>>>) {
    let served = Arc::new(Mutex::new(Vec::new()));
    let handles = served.clone();
    let runtime = tokio::runtime::Handle::current();
    let hand_out = move |tickets: Vec<LocalTicket>| {
        let serve = |ticket| runtime.spawn(serve_ticket(ticket));
        handles.lock().expect("one thread").extend(tickets.into_iter().map(serve));
    };
    (Workers::Tickets(count, Box::new(hand_out)), served)
}

async fn render(cluster: &mut Cluster, job: &FrameJob) -> FrameResult {
    let mut last = (0, 0);
    let result = cluster.render(job, |p| {
        if let tessera_master::Progress::Tiles { done, total } = p {
            last = (done, total);
        }
    });
    let result = result.await.expect("workers are well");
    let tiles = job.width.div_ceil(job.tile) * job.height.div_ceil(job.tile);
    assert_eq!(last, (tiles, tiles));
    assert_eq!(result.workers.iter().map(|w| w.tiles).sum::<u32>(), tiles);
    assert_eq!(result.numeric_class(), Some(NUMERIC_CLASS));
    assert!(result.differences.is_empty() && result.idle == 0);
    let returned: u64 = result.workers.iter().map(|w| w.bytes_returned).sum();
    let (image, packed) = (result.image.data().len() as u64, result.coding != Coding::Raw);
    assert!((returned > image || packed) && result.traffic.received > returned);
    assert_eq!(result.rays.primary, u64::from(job.width) * u64::from(job.height));
    result
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_image_for_every_balancing_over_memory_and_over_quic() {
    let pack = pack();
    let (workers, served) = in_memory(1);
    let mut alone = Cluster::start(workers, ClusterConfig::default()).await.expect("one joins");
    alone.load(&pack, |_| ()).await.expect("it takes the pack");
    let reference = render(&mut alone, &job(&pack, Balance::Dynamic)).await;
    assert!(reference.image.data().iter().any(|&b| b != 0), "an empty picture proves nothing");
    assert_eq!(reference.traffic.udp_sent, 0);
    alone.stop().await;
    for handle in served {
        handle.await.expect("no panic").expect("dismissed");
    }

    let (workers, served) = over_quic(3);
    let class = ClusterConfig { numeric_class: Some(NUMERIC_CLASS.into()), ..ClusterConfig::default() };
    let mut cluster = Cluster::start(workers, class).await.expect("three join");
    cluster.load(&pack, |_| ()).await.expect("they take the pack");
    for balance in Balance::ALL {
        for tile in [16, 32, 150] {
            let job = FrameJob { tile, ..job(&pack, balance) };
            let result = render(&mut cluster, &job).await;
            assert_eq!(result.image, reference.image, "{balance}, tiles of {tile}");
            assert_eq!(result.workers.len(), 3);
            assert!(result.traffic.udp_sent > result.traffic.sent, "QUIC adds to what it carries");
        }
    }
    cluster.stop().await;
    let handles = std::mem::take(&mut *served.lock().expect("one thread"));
    for handle in handles {
        handle.await.expect("no panic").expect("dismissed");
    }
}

/// The built binary as worker processes.
fn processes(count: u32, args: &[&str]) -> Workers {
    Workers::Local(LocalWorkers {
        program: env!("CARGO_BIN_EXE_tessera").into(),
        args: args.iter().map(Into::into).collect(),
        args_of: Vec::new(),
        count,
        threads: Some(1),
        through: None,
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn worker_processes_join_render_and_end() {
    let pack = pack();
    let workers = processes(3, &["worker", "--ticket", "--backend", "cpu"]);
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack, |_| ()).await.expect("they take the pack");
    let dynamic = render(&mut cluster, &job(&pack, Balance::Dynamic)).await;
    let paper = render(&mut cluster, &job(&pack, Balance::PaperStatic)).await;
    assert_eq!(dynamic.image, paper.image);
    let names: Vec<_> = paper.workers.iter().map(|w| w.name.as_str()).collect();
    assert_eq!(names, ["local-0", "local-1", "local-2"]);
    // Tiles are dealt in the order of joining, which is nobody's to say.
    let mut tiles: Vec<_> = paper.workers.iter().map(|w| w.tiles).collect();
    tiles.sort_unstable();
    assert_eq!(tiles, [6, 7, 7]);
    cluster.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn processes_that_do_not_become_workers_are_named() {
    let ended = Cluster::start(processes(2, &["--version"]), ClusterConfig::default()).await;
    let message = ended.err().expect("it only prints").to_string();
    assert!(message.starts_with("local-") && message.contains("its process has ended"), "{message}");

    let Workers::Local(workers) = processes(1, &[]) else { panic!("processes") };
    let missing = LocalWorkers { program: "no/such/program".into(), ..workers };
    let failed = Cluster::start(Workers::Local(missing), ClusterConfig::default()).await.err();
    let message = failed.expect("there is none").to_string();
    assert!(message.starts_with("cannot start worker process `no/such/program`"), "{message}");
}

/// Blocks of pixels get as many samples as they need, whoever renders them and in whatever tiles: as the plain renderer does with one thread.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn adaptive_pictures_depend_on_neither_tiles_nor_workers() {
    let pack = pack();
    let (workers, _served) = in_memory(3);
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack, |_| ()).await.expect("they take the pack");
    for (sampler, format) in
        [(Sampler::Jittered, PixelFormat::Layers), (Sampler::LowDiscrepancy, PixelFormat::Rgba8)]
    {
        let sampling = Sampling { sampler, adaptive: Some(Adaptive { error: 0.02 }), ..Sampling::default() };
        let whole = FrameJob { samples: 64, sampling, format, tile: 160, ..job(&pack, Balance::Dynamic) };
        let frame = whole.to_wire(FrameId(1), tessera_wire::PackId(pack.id().0));
        let (pixels, rays) = plain(&pack, &frame);
        let (area, layers) = (150 * 100, format == PixelFormat::Layers);
        let taken = rays.primary - if layers { area } else { 0 };
        assert!(taken > 16 * area && taken < 40 * area, "{taken} samples: edges have more than the rest");
        assert_eq!(
            cpu_frame(&pack, Kernel::default(), &frame),
            (pixels.clone(), rays),
            "with several threads"
        );
        for (tile, balance) in [(16, Balance::PaperStatic), (48, Balance::Static), (160, Balance::Dynamic)] {
            let result = cluster
                .render(&FrameJob { tile, balance, ..whole.clone() }, |_| ())
                .await
                .expect("a picture");
            assert!(result.image.data() == pixels, "{balance}, tiles of {tile}");
            assert_eq!(result.rays, rays, "{balance}, tiles of {tile}");
        }
        let cut = cluster.render(&FrameJob { tile: 40, ..whole }, |_| ()).await;
        let refused = FrameError::TileBlocks(40);
        assert!(matches!(cut, Err(RenderError::Job(BeginError::Job(e))) if e == refused));
    }
    cluster.stop().await;
}

/// A frame by one call of the renderer.
fn plain(pack: &Pack, frame: &tessera_wire::Frame) -> (Vec<u8>, tessera_wire::Rays) {
    let sampling = tessera_whitted::Sampling {
        sampler: match frame.sampling.sampler {
            Sampler::Jittered => tessera_whitted::Sampler::Jittered,
            Sampler::LowDiscrepancy => tessera_whitted::Sampler::LowDiscrepancy,
        },
        cutoff: frame.sampling.cutoff,
        adaptive: frame.sampling.adaptive.map(|a| tessera_whitted::Adaptive { error: a.error }),
    };
    let [origin, forward, right, up] =
        [frame.camera.origin, frame.camera.forward, frame.camera.right, frame.camera.up]
            .map(Vec3::from_array);
    let params = tessera_whitted::FrameParams {
        camera: LocalCamera { origin, forward, right, up },
        width: frame.width,
        height: frame.height,
        samples: frame.samples,
        sampling,
        max_depth: frame.depth,
        frame: frame.seed,
        features: tessera_whitted::Features::default(),
        format: match frame.format {
            PixelFormat::Layers => tessera_whitted::PixelFormat::Layers,
            _ => tessera_whitted::PixelFormat::Rgba8,
        },
    };
    let block = tessera_whitted::PixelBlock { x: 0, y: 0, width: frame.width, height: frame.height };
    let mut pixels = vec![0; block.byte_len(params.format)];
    let rays = tessera_whitted::Renderer::new(pack).render_block(&params, block, &mut pixels);
    let tessera_whitted::RayCounts { primary, shadow, reflection, refraction } = rays;
    (pixels, tessera_wire::Rays { primary, shadow, reflection, refraction })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn odd_sizes_and_all_formats() {
    let pack = pack();
    let (workers, _served) = in_memory(2);
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack, |_| ()).await.expect("they take the pack");
    for (width, height, tile) in [(1, 1, 128), (1, 50, 16), (33, 31, 32), (20_000, 1, 64)] {
        for format in PixelFormat::ALL {
            let job = FrameJob { width, height, tile, format, ..job(&pack, Balance::Static) };
            let result = render(&mut cluster, &job).await;
            let bytes = width as usize * height as usize * format.bytes_per_pixel();
            assert_eq!(result.image.data().len(), bytes);
        }
    }
    cluster.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_worker_is_replaced_and_the_last_one_is_not() {
    let pack = pack();
    let (workers, served) = over_quic(2);
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("they join");
    cluster.load(&pack, |_| ()).await.expect("they take the pack");
    let handles = std::mem::take(&mut *served.lock().expect("one thread"));
    let mut reasons = 0;
    let mut handles = handles.into_iter();
    // Its connection dies with it when the first tile is in.
    let mut first = handles.next();
    let job = FrameJob { width: 600, height: 600, tile: 8, ..job(&pack, Balance::PaperDynamic) };
    let result = cluster.render(&job, |progress| match progress {
        tessera_master::Progress::Tiles { .. } => drop(first.take().map(|handle| handle.abort())),
        tessera_master::Progress::WorkerLost { .. } => reasons += 1,
        _ => {}
    });
    let result = result.await.expect("one worker is enough");
    assert_eq!(result.workers.iter().map(|w| w.tiles).sum::<u32>(), 75 * 75);
    assert_eq!(reasons, 1);
    assert_eq!(result.workers.iter().filter(|w| w.lost.is_some()).count(), 1);

    handles.for_each(|handle| handle.abort());
    let failed = cluster.render(&job, |_| ()).await;
    assert!(matches!(failed, Err(RenderError::AllLost { .. })), "{failed:?}");
    cluster.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_done_is_said() {
    let pack = pack();
    let none = Cluster::start(Workers::Links(Vec::new()), ClusterConfig::default()).await;
    assert!(matches!(none.err(), Some(StartError::NoWorkers)));

    let (workers, served) = in_memory(1);
    let other = ClusterConfig { numeric_class: Some("another".into()), ..ClusterConfig::default() };
    let refused = Cluster::start(workers, other).await.err().expect("refused");
    assert!(refused.to_string().contains("numeric class"), "{refused}");
    for handle in served {
        assert!(matches!(handle.await.expect("no panic"), Err(WorkerError::Refused(_))));
    }

    let (link, _served) = worker(config("small", Some(10)));
    let mut small =
        Cluster::start(Workers::Links(vec![link]), ClusterConfig::default()).await.expect("it joins");
    let job = job(&pack, Balance::Dynamic);
    assert!(matches!(small.render(&job, |_| ()).await, Err(RenderError::NoPack)));
    let failed = small.load(&pack, |_| ()).await;
    let needs = pack.bytes().len() as u64;
    let expected = PackRefusal::OutOfMemory { needs, has: 10 };
    match failed {
        Err(LoadError::Rejected { worker, reason }) => {
            assert_eq!((worker.as_str(), reason), ("small", expected))
        }
        other => panic!("{other:?}"),
    }

    let (workers, _served) = in_memory(1);
    let mut cluster = Cluster::start(workers, ClusterConfig::default()).await.expect("it joins");
    cluster.load(&pack, |_| ()).await.expect("it takes the pack");
    let wild = FrameJob { tile: 1, width: 600, height: 600, ..job };
    assert!(matches!(
        cluster.render(&wild, |_| ()).await,
        Err(RenderError::Job(BeginError::Job(FrameError::Tiles { tiles: 360_000 })))
    ));
    let frame = cluster.render(&FrameJob { tile: 64, ..wild }, |_| ()).await;
    assert!(frame.is_ok(), "a refused job does no harm: {frame:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn packs_follow_each_other_also_past_a_worker_without_room() {
    let (pack, larger) = (pack(), strip(3000));
    // Room for the small pack alone in one of them.
    let between = (pack.bytes().len() + larger.bytes().len()) as u64 / 2;
    let (mut links, mut served) = (Vec::new(), Vec::new());
    for (name, memory) in [("a", None), ("small", Some(between)), ("c", None)] {
        let (link, handle) = worker(config(name, memory));
        links.push(link);
        served.push(handle);
    }
    let mut cluster =
        Cluster::start(Workers::Links(links), ClusterConfig::default()).await.expect("they join");
    let reason = PackRefusal::OutOfMemory { needs: larger.bytes().len() as u64, has: between }.to_string();
    for _ in 0..3 {
        let mut said = Vec::new();
        let loaded = cluster.load(&larger, |progress| {
            if let tessera_master::Progress::PackRejected { name, reason } = progress {
                said.push((name.to_string(), reason.to_string()));
            }
        });
        loaded.await.expect("two have room for it");
        assert_eq!(said, [("small".to_string(), reason.clone())]);
        let result = render(&mut cluster, &job(&larger, Balance::Static)).await;
        let part: Vec<_> = result.workers.iter().map(|w| (w.name.as_str(), w.rejected.as_deref())).collect();
        assert_eq!(part, [("a", None), ("small", Some(reason.as_str())), ("c", None)]);
        assert!(result.workers.iter().all(|w| (w.tiles == 0) == w.rejected.is_some() && w.lost.is_none()));

        cluster.load(&pack, |_| ()).await.expect("all have room for it");
        let result = render(&mut cluster, &job(&pack, Balance::Dynamic)).await;
        let is_well = |w: &tessera_master::WorkerReport| w.lost.is_none() && w.rejected.is_none();
        assert!(result.workers.len() == 3 && result.workers.iter().all(is_well), "{result:?}");
    }
    cluster.stop().await;
    for handle in served {
        handle.await.expect("no panic").expect("dismissed");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_comes_back_with_its_cache_is_sent_no_pack() {
    let pack = strip(3000);
    let folder = Folder::new();
    let file = folder.file(&format!("{}.tpack", pack.id()));
    let mut images = Vec::new();
    let damage: [fn(&mut Vec<u8>); 4] =
        [|_| (), |_| (), |bytes| bytes[5000] ^= 1, |bytes| bytes.truncate(5000)];
    for (round, damage) in damage.into_iter().enumerate() {
        if round > 0 {
            let mut bytes = std::fs::read(&file).expect("kept when the worker ended");
            assert_eq!(bytes, pack.bytes());
            damage(&mut bytes);
            std::fs::write(&file, bytes).expect("a temporary file");
        }
        let cache = PackCache::open(folder.path(), 1 << 20).expect("a folder");
        let (link, served) = worker(WorkerConfig { cache: Some(cache), ..config("w", None) });
        let mut cluster =
            Cluster::start(Workers::Links(vec![link]), ClusterConfig::default()).await.expect("it joins");
        cluster.load(&pack, |_| ()).await.expect("it takes the pack");
        let result = render(&mut cluster, &job(&pack, Balance::Dynamic)).await;
        let is_sent = result.traffic.sent > pack.bytes().len() as u64;
        assert_eq!(is_sent, round != 1, "round {round}: {} bytes were sent", result.traffic.sent);
        assert!(is_sent || result.traffic.sent < 2000, "messages alone: {}", result.traffic.sent);
        images.push(result.image);
        cluster.stop().await;
        served.await.expect("no panic").expect("dismissed");
    }
    assert_eq!(folder.names().len(), 1);
    assert!(images.windows(2).all(|pair| pair[0] == pair[1]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_with_a_forged_ticket_is_refused_and_does_not_disturb() {
    let outcome = Arc::new(Mutex::new(None));
    let slot = outcome.clone();
    let runtime = tokio::runtime::Handle::current();
    let hand_out = move |tickets: Vec<LocalTicket>| {
        let ticket = tickets.into_iter().next().expect("one");
        let forged = |change: &dyn Fn(&mut LocalTicket)| {
            let mut forged = ticket.clone();
            change(&mut forged);
            serve_ticket(forged)
        };
        let guessed = forged(&|ticket| ticket.join.token.0[15] ^= 1);
        let elsewhere = forged(&|ticket| ticket.join.fingerprint.0[0] ^= 1);
        let right = forged(&|_| ());
        let copied = forged(&|_| ());
        *slot.lock().expect("one thread") = Some(runtime.spawn(async move {
            let refused = (guessed.await, elsewhere.await);
            // Whoever comes first with a ticket is the one that it was for.
            let served = tokio::spawn(right);
            (refused, served, copied)
        }));
    };
    let cluster = Cluster::start(Workers::Tickets(1, Box::new(hand_out)), ClusterConfig::default());
    let cluster = cluster.await.expect("the right one joins");
    let all = outcome.lock().expect("one thread").take().expect("spawned");
    let ((guessed, elsewhere), served, copied) = all.await.expect("no panic");
    assert!(matches!(guessed, Err(WorkerError::Refused(Refusal::Token))), "{guessed:?}");
    assert!(matches!(elsewhere, Err(WorkerError::Join(JoinError::OtherMaster { .. }))), "{elsewhere:?}");
    let copied = copied.await;
    assert!(matches!(copied, Err(WorkerError::Refused(Refusal::Token))), "{copied:?}");
    cluster.stop().await;
    served.await.expect("no panic").expect("dismissed");
}
