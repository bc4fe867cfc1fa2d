//! The thread that renders, one tile after the other, with a pool of its own.

use crate::{backend::cpu, session::RenderTask, session::RenderedTile};
use std::{sync::mpsc, thread, time::Instant};
use tessera_pack::Pack;

/// A running render thread; dropping it ends the thread after the tile that it is at.
pub(crate) struct RenderThread {
    tasks: mpsc::Sender<(RenderTask, Pack)>,
}

/// What the thread says.
pub(crate) enum RenderEvent {
    /// A tile is finished.
    Rendered(Box<RenderedTile>),
    /// The renderer has panicked: a bug; nothing more will come.
    Panicked,
}

impl RenderThread {
    /// Starts the thread and a pool of `threads`; `tell` is called from the thread and may block it.
    pub(crate) fn start(
        threads: u32,
        tell: impl Fn(RenderEvent) + Send + 'static,
    ) -> Result<Self, Box<dyn std::error::Error + Send + Sync>> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads as usize)
            .thread_name(|i| format!("render {i}"))
            .build()?;
        let (tasks, queue) = mpsc::channel::<(RenderTask, Pack)>();
        thread::Builder::new().name("render".into()).spawn(move || {
            let tell = PanicTeller(tell);
            while let Ok((task, pack)) = queue.recv() {
                let begun = Instant::now();
                let (pixels, rays) = pool.install(|| cpu::render(&pack, &task.frame, task.rect));
                let time = begun.elapsed();
                let tile = RenderedTile { task, pixels, time, rays };
                (tell.0)(RenderEvent::Rendered(Box::new(tile)));
            }
        })?;
        Ok(Self { tasks })
    }

    /// Queues a tile. After a panic it is not rendered; the panic has been told.
    pub(crate) fn render(&self, task: RenderTask, pack: Pack) {
        let _ = self.tasks.send((task, pack));
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
