//! The thread that renders: on the CPU one tile after the other, with a pool of its own; on a GPU several at a time.

use crate::{
    Backend,
    backend::{
        Engine, GpuEngine, cpu,
        gpu::{GpuError, tiles::Tiles},
        pace::{thread_cpu_time, wait_until},
        replay::{Played, Replay},
    },
    session::{RenderTask, RenderedTile, TileName},
};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};
use tessera_pack::Pack;
use tessera_whitted::Renderer;
use tessera_wire::Rays;

/// A running render thread; dropping it ends the thread, and what it is at.
pub(crate) struct RenderThread {
    tasks: mpsc::Sender<Queued>,
    /// What stops each tile that is queued or being rendered, and of some that are finished.
    stops: Vec<(TileName, Arc<AtomicBool>)>,
    /// Woken then, where it sleeps over a tile.
    thread: thread::Thread,
}

/// A tile, the pack that it is of, and what stops it.
type Queued = (RenderTask, Pack, Arc<AtomicBool>);

/// What the thread says.
pub(crate) enum RenderEvent {
    /// A tile is finished.
    Rendered(Box<RenderedTile>),
    /// A tile was stopped before it was finished.
    Stopped(TileName),
    /// The device has failed, with the reason; nothing more will come.
    Failed(String),
    /// The renderer has panicked: a bug; nothing more will come.
    Panicked,
}

impl RenderThread {
    /// Starts the thread, on the CPU with a pool of `threads`; `tell` is called from the thread and may block it.
    pub(crate) fn start(
        threads: u32,
        backend: Backend,
        tell: impl Fn(RenderEvent) + Send + 'static,
    ) -> Result<Self, Box<dyn std::error::Error + Send + Sync>> {
        let (tasks, queue) = mpsc::channel();
        let tell = PanicTeller(tell);
        if backend.pace().is_some() && (threads != 1 || thread_cpu_time().is_none()) {
            // Of several threads none need be the one that the tile waits for.
            return Err(
                "a CPU is made to seem slower for one thread, on systems that count its CPU time".into()
            );
        }
        let pool = match backend.engine() {
            Engine::Cpu => {
                let name = |i| format!("render {i}");
                Some(
                    rayon::ThreadPoolBuilder::new()
                        .num_threads(threads as usize)
                        .thread_name(name)
                        .build()?,
                )
            }
            Engine::Gpu(_) | Engine::Replay(_) => None,
        };
        let thread =
            thread::Builder::new().name("render".into()).spawn(move || match (backend.engine(), pool) {
                (Engine::Gpu(engine), _) => {
                    if let Err(error) = render_on_gpu(engine, &queue, &tell.0) {
                        backend.fail();
                        (tell.0)(RenderEvent::Failed(error.to_string()));
                    }
                }
                (Engine::Cpu, Some(pool)) => render_on_cpu(&backend, &pool, &queue, &tell.0),
                (Engine::Cpu, None) => {}
                (Engine::Replay(device), _) => {
                    if let Err(reason) = replay(device, &queue, &tell.0) {
                        (tell.0)(RenderEvent::Failed(reason));
                    }
                }
            })?;
        Ok(Self { tasks, stops: Vec::new(), thread: thread.thread().clone() })
    }

    /// Queues a tile. After a panic or a failure it is not rendered; that has been told.
    pub(crate) fn render(&mut self, task: RenderTask, pack: Pack) {
        // The thread lets go of what stops a tile when it is done with the tile.
        self.stops.retain(|(_, stop)| Arc::strong_count(stop) > 1);
        let stop = Arc::<AtomicBool>::default();
        self.stops.push((task.name(), stop.clone()));
        let _ = self.tasks.send((task, pack, stop));
    }

    /// Stops those of these tiles that are not finished; each is told.
    pub(crate) fn stop(&self, tiles: &[TileName]) {
        for (_, stop) in self.stops.iter().filter(|(tile, _)| tiles.contains(tile)) {
            stop.store(true, Ordering::Relaxed);
        }
        self.thread.unpark();
    }
}

fn render_on_cpu(
    backend: &Backend,
    pool: &rayon::ThreadPool,
    queue: &mpsc::Receiver<Queued>,
    tell: &impl Fn(RenderEvent),
) {
    let kernel = backend.kernel();
    loop {
        let waits = Instant::now();
        let Ok((task, pack, stop)) = queue.recv() else { return };
        let (begun, idle) = (Instant::now(), waits.elapsed());
        let renderer = Renderer::with_kernel(&pack, kernel);
        let render = || cpu::render(&renderer, &task.frame, task.rect, &stop);
        let rendered = match backend.pace() {
            None => pool.install(render),
            Some(pace) => {
                let (rendered, cpu) = pool.install(|| {
                    let before = thread_cpu_time();
                    (render(), thread_cpu_time().zip(before).map(|(after, before)| after - before))
                });
                let takes = cpu.unwrap_or_default().div_f64(pace);
                rendered.filter(|_| wait_until(begun + takes, &stop))
            }
        };
        let time = begun.elapsed();
        tell(match rendered {
            Some((pixels, rays)) => RenderEvent::Rendered(Box::new(RenderedTile {
                idle,
                ..RenderedTile::new(task, pixels, time, rays)
            })),
            None => RenderEvent::Stopped(task.name()),
        });
    }
}

/// Plays `device`; the reason, if it cannot.
fn replay(
    device: &Replay,
    queue: &mpsc::Receiver<Queued>,
    tell: &impl Fn(RenderEvent),
) -> Result<(), String> {
    loop {
        let waits = Instant::now();
        let Ok((task, _, stop)) = queue.recv() else { return Ok(()) };
        let (begun, idle) = (Instant::now(), waits.elapsed());
        tell(match device.play(&task, &stop)? {
            Played::Done(pixels) => {
                let (time, rays) = (begun.elapsed(), Rays::default());
                RenderEvent::Rendered(Box::new(RenderedTile {
                    idle,
                    ..RenderedTile::new(task, pixels, time, rays)
                }))
            }
            Played::Stopped => RenderEvent::Stopped(task.name()),
        });
    }
}

/// How long buffers are kept for the next tile: longer than one takes to be assigned.
const IDLE: Duration = Duration::from_millis(100);

/// Takes tiles in as they come, so that the device has the next ones before it has finished the last.
fn render_on_gpu(
    engine: &GpuEngine,
    queue: &mpsc::Receiver<Queued>,
    tell: &impl Fn(RenderEvent),
) -> Result<(), GpuError> {
    let mut tiles: Option<Tiles> = None;
    // What stops those that are with the device.
    let mut stops = Vec::<(TileName, Arc<AtomicBool>)>::new();
    loop {
        // Wait for a tile if there is none, and take all that are there.
        let is_idle = tiles.as_ref().is_none_or(Tiles::is_idle);
        let first = match (is_idle, &tiles) {
            (false, _) => None,
            (true, None) => match queue.recv() {
                Ok(first) => Some(first),
                Err(_) => return Ok(()),
            },
            // Let go of a scene that nothing is rendered of: the next one may need its room.
            (true, Some(_)) => match queue.recv_timeout(IDLE) {
                Ok(first) => Some(first),
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    tiles = None;
                    continue;
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => return Ok(()),
            },
        };
        for (task, pack, stop) in first.into_iter().chain(queue.try_iter()) {
            let is_loaded = tiles.as_ref().is_some_and(|tiles| tiles.scene().pack().id() == pack.id());
            if !is_loaded {
                // (What is under way for another scene is not waited for: frames end before packs change.)
                for task in tiles.iter_mut().flat_map(Tiles::clear) {
                    tell(RenderEvent::Stopped(task.name()));
                }
                stops.clear();
                tiles = None;
            }
            let tiles = match &mut tiles {
                Some(tiles) => tiles,
                none => none.insert(Tiles::new(engine.scene(&pack)?)?),
            };
            stops.push((task.name(), stop));
            tiles.push(task);
        }
        let Some(tiles) = &mut tiles else { continue };
        stops.retain(|(tile, stop)| {
            let is_stopped = stop.load(Ordering::Relaxed);
            if is_stopped && tiles.forget(*tile) {
                tell(RenderEvent::Stopped(*tile));
            }
            !is_stopped
        });
        for tile in tiles.turn()? {
            stops.retain(|(other, _)| *other != tile.task.name());
            tell(RenderEvent::Rendered(Box::new(tile)));
        }
    }
}

impl Drop for RenderThread {
    fn drop(&mut self) {
        self.stops.iter().for_each(|(_, stop)| stop.store(true, Ordering::Relaxed));
    }
}

/// Tells when the thread unwinds.
struct PanicTeller<F: Fn(RenderEvent)>(F);

impl<F: Fn(RenderEvent)> Drop for PanicTeller<F> {
    fn drop(&mut self) {
        if thread::panicking() {
            (self.0)(RenderEvent::Panicked);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BackendChoice, BackendConfig};
    use tessera_pack::{Material, PackInput, PackOptions, build_pack};
    use tessera_wire::{
        Attempt, Camera, Features, Frame, FrameId, PackId, PixelFormat, Rect, ReturnMode, TileId,
    };

    /// A tile of `samples` a pixel.
    fn task(samples: u32) -> RenderTask {
        let camera = Camera {
            origin: [0.5, 0.5, 4.0],
            forward: [0.0, 0.0, -1.0],
            right: [0.5, 0.0, 0.0],
            up: [0.0, 0.5, 0.0],
        };
        let frame = Frame {
            frame: FrameId(1),
            pack: PackId([0; 32]),
            camera,
            width: 512,
            height: 512,
            tile: 512,
            samples,
            sampling: Default::default(),
            depth: 1,
            seed: 0,
            features: Features::default(),
            format: PixelFormat::Rgba8,
            returns: ReturnMode::AtEnd,
            coding: tessera_wire::Coding::Raw,
        };
        let rect = Rect { x: 0, y: 0, width: 512, height: 512 };
        RenderTask { frame, tile: TileId(0), attempt: Attempt(0), rect }
    }

    /// The same in its `n`th attempt, so that it has a name of its own.
    fn attempt(n: u32, samples: u32) -> RenderTask {
        RenderTask { attempt: Attempt(n), ..task(samples) }
    }

    #[test]
    fn a_tile_that_nobody_waits_for_is_stopped_and_the_next_one_is_not() {
        let input = PackInput {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        };
        let (pack, _) = build_pack(input, &PackOptions::default()).unwrap();
        let (tell, told) = mpsc::channel();
        let config = BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() };
        let backend = Backend::open(&config).expect("there is a CPU");
        let mut thread = RenderThread::start(2, backend, move |event| tell.send(event).unwrap()).unwrap();
        let event = || told.recv_timeout(Duration::from_secs(60)).expect("it takes seconds at most");
        // Seventeen thousand million samples: hours. Of three the second is stopped before it has begun.
        for n in 0..3 {
            thread.render(attempt(n, 1 << 16), pack.clone());
        }
        thread.stop(&[attempt(1, 1).name(), attempt(9, 1).name()]);
        thread.stop(&[attempt(0, 1).name()]);
        for n in 0..2 {
            assert!(matches!(event(), RenderEvent::Stopped(tile) if tile == attempt(n, 1).name()));
        }
        thread.stop(&[attempt(2, 1).name()]);
        assert!(matches!(event(), RenderEvent::Stopped(tile) if tile == attempt(2, 1).name()));
        thread.render(attempt(3, 1), pack.clone());
        assert!(matches!(event(), RenderEvent::Rendered(tile) if tile.rays.primary == 512 * 512));
        thread.stop(&[attempt(3, 1).name()]);
        thread.render(attempt(4, 1 << 16), pack);
        assert!(thread.stops.len() <= 2, "of those that are finished none is remembered");
        drop(thread);
        assert!(matches!(event(), RenderEvent::Stopped(_)), "nobody waits when the thread's owner is gone");
    }

    /// A triangle in front of the camera.
    fn triangle() -> Pack {
        let input = PackInput {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        };
        build_pack(input, &PackOptions::default()).unwrap().0
    }

    /// A GPU, unless there is none and none is required.
    fn gpu_backend() -> Option<Backend> {
        use crate::gpu::{GpuOptions, TestPolicy};
        let policy = TestPolicy::from_env().expect("a known policy");
        policy.open(GpuOptions::default()).expect("a GPU is required")?;
        let config = BackendConfig { choice: BackendChoice::Gpu, ..BackendConfig::default() };
        Some(Backend::open(&config).expect("it can be opened"))
    }

    #[test]
    fn a_gpu_takes_several_tiles_and_stops_those_that_nobody_waits_for() {
        let Some(backend) = gpu_backend() else { return };
        let (tell, told) = mpsc::channel();
        let mut thread = RenderThread::start(1, backend, move |event| tell.send(event).unwrap()).unwrap();
        let event = || told.recv_timeout(Duration::from_secs(120)).expect("it takes seconds at most");
        for n in 0..3 {
            thread.render(attempt(n, 1), triangle());
        }
        for _ in 0..3 {
            assert!(matches!(event(), RenderEvent::Rendered(tile) if tile.rays.primary == 512 * 512));
        }
        // Hours of work, twice, and a tile behind each: those come although what is before them is stopped.
        for (n, samples) in [(3, 1 << 16), (4, 1), (5, 1 << 16), (6, 1)] {
            thread.render(attempt(n, samples), triangle());
        }
        thread.stop(&[attempt(3, 1).name(), attempt(5, 1).name()]);
        let (mut stopped, mut rendered) = (Vec::new(), Vec::new());
        for _ in 0..4 {
            match event() {
                RenderEvent::Stopped(tile) => stopped.push(tile.attempt.0),
                RenderEvent::Rendered(tile) => rendered.push(tile.task.attempt.0),
                RenderEvent::Failed(_) | RenderEvent::Panicked => panic!("the GPU is well"),
            }
        }
        assert_eq!((stopped, rendered), (vec![3, 5], vec![4, 6]));
    }

    #[test]
    fn a_gpu_that_is_lost_is_told_and_the_cpu_takes_over_where_it_may() {
        let Some(insisted_on) = gpu_backend() else { return };
        lose(insisted_on, "gpu");
        let left_to_us = gpu_backend().expect("it was there a moment ago").left_to_us();
        lose(left_to_us, "cpu");
    }

    /// Loses the GPU in the middle of work, and goes on with `fallback`.
    fn lose(backend: Backend, fallback: &str) {
        let Engine::Gpu(engine) = backend.engine() else { panic!("it was asked for") };
        assert_eq!(backend.check_pack(&triangle()), Ok(()));
        engine.lose();
        let (tell, told) = mpsc::channel();
        let mut thread =
            RenderThread::start(1, backend.clone(), move |event| tell.send(event).unwrap()).unwrap();
        thread.render(task(1), triangle());
        let event = told.recv_timeout(Duration::from_secs(120)).expect("it is noticed");
        assert!(matches!(&event, RenderEvent::Failed(reason) if reason.contains("the GPU is lost")));
        assert_eq!((backend.or_fallback().name(), backend.has_fallback()), (fallback, fallback == "cpu"));
        assert!(fallback == "gpu" || backend.or_fallback().note().contains("the GPU has failed"));
    }
}
