//! The thread that renders, one tile after the other, with a pool of its own.

use crate::{backend::cpu, session::RenderTask, session::RenderedTile};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Instant,
};
use tessera_kdtree::Kernel;
use tessera_pack::Pack;

/// A running render thread; dropping it ends the thread, and what it is at.
pub(crate) struct RenderThread {
    tasks: mpsc::Sender<(RenderTask, Pack, Arc<AtomicBool>)>,
    /// Set to stop the last tile that was queued.
    stop: Arc<AtomicBool>,
}

/// What the thread says.
pub(crate) enum RenderEvent {
    /// A tile is finished.
    Rendered(Box<RenderedTile>),
    /// A tile was stopped before it was finished.
    Stopped,
    /// The renderer has panicked: a bug; nothing more will come.
    Panicked,
}

impl RenderThread {
    /// Starts the thread and a pool of `threads` that trace with `kernel`; `tell` is called from the thread and may block it.
    pub(crate) fn start(
        threads: u32,
        kernel: Kernel,
        tell: impl Fn(RenderEvent) + Send + 'static,
    ) -> Result<Self, Box<dyn std::error::Error + Send + Sync>> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads as usize)
            .thread_name(|i| format!("render {i}"))
            .build()?;
        let (tasks, queue) = mpsc::channel::<(RenderTask, Pack, Arc<AtomicBool>)>();
        thread::Builder::new().name("render".into()).spawn(move || {
            let tell = PanicTeller(tell);
            while let Ok((task, pack, stop)) = queue.recv() {
                let begun = Instant::now();
                let rendered = pool.install(|| cpu::render(&pack, kernel, &task.frame, task.rect, &stop));
                let time = begun.elapsed();
                (tell.0)(match rendered {
                    Some((pixels, rays)) => {
                        RenderEvent::Rendered(Box::new(RenderedTile { task, pixels, time, rays }))
                    }
                    None => RenderEvent::Stopped,
                });
            }
        })?;
        Ok(Self { tasks, stop: Arc::default() })
    }

    /// Queues a tile; those before have been told. After a panic it is not rendered; the panic has been told.
    pub(crate) fn render(&mut self, task: RenderTask, pack: Pack) {
        self.stop = Arc::default();
        let _ = self.tasks.send((task, pack, self.stop.clone()));
    }

    /// Stops the last tile that was queued, if it is not finished.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Drop for RenderThread {
    fn drop(&mut self) {
        self.stop();
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
    use std::time::Duration;
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
            depth: 1,
            seed: 0,
            features: Features::default(),
            format: PixelFormat::Rgba8,
            returns: ReturnMode::AtEnd,
        };
        let rect = Rect { x: 0, y: 0, width: 512, height: 512 };
        RenderTask { frame, tile: TileId(0), attempt: Attempt(0), rect }
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
        let mut thread =
            RenderThread::start(2, Kernel::auto(), move |event| tell.send(event).unwrap()).unwrap();
        // Seventeen thousand million samples: hours.
        thread.render(task(1 << 16), pack.clone());
        thread.stop();
        let event = || told.recv_timeout(Duration::from_secs(60)).expect("it takes seconds at most");
        assert!(matches!(event(), RenderEvent::Stopped));
        thread.render(task(1), pack.clone());
        assert!(matches!(event(), RenderEvent::Rendered(tile) if tile.rays.primary == 512 * 512));
        thread.stop();
        thread.render(task(1 << 16), pack);
        drop(thread);
        assert!(matches!(event(), RenderEvent::Stopped), "nobody waits when the thread's owner is gone");
    }
}
