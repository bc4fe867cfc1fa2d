//! A worker's life on four pipes: join, hold a pack, render what is assigned, go.

use crate::{
    Backend, PackCache, PackFault,
    coding::code_batches,
    free_memory,
    join::JoinError,
    pipes::{PipeError, Reader, Writer, read_message, reason, write_message},
    receive::{Assembly, receive},
    render::{RenderEvent, RenderThread},
    session::{Action, Batch, Ending, RenderedTile, Session, TileName, micros},
};
use std::{io, time::Duration};
use tessera_pack::Pack;
use tessera_wire::{
    Abilities, AbortCode, Hello, PackId, PackRefusal, Refusal, Role, ToMaster, ToWorker, Token, Version,
    plain_text,
};
use tokio::{
    io::AsyncWriteExt,
    sync::{mpsc, watch},
    task::{JoinHandle, JoinSet},
    time::{Instant, sleep_until, timeout},
};

/// The worker's end of a connection: a control and a bulk pipe in each direction.
pub struct WorkerPipes {
    /// Control messages from the master.
    pub control_in: Reader,
    /// Control messages to the master.
    pub control_out: Writer,
    /// Packs from the master.
    pub bulk_in: Reader,
    /// Tiles to the master.
    pub bulk_out: Writer,
}

/// What a worker says of itself, and what it may use.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// For people.
    pub name: String,
    /// Threads that render, >= 1.
    pub threads: u32,
    /// What renders, and how: the picture is the same with each of one numeric class.
    pub backend: Backend,
    /// Bytes that a pack may take; `None`: what the system has free, as far as it says.
    pub memory: Option<u64>,
    /// Where packs are kept for the next time.
    pub cache: Option<PackCache>,
}

/// What is asked of a worker about its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// To go on.
    #[default]
    No,
    /// To finish the tile in hand, return what it has rendered, and leave; others get the rest. The tile has 5 s, then it is as `Now`.
    Drain,
    /// To leave without the tile in hand.
    Now,
}

/// How a worker that is well has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parting {
    /// The master has no more work.
    Dismissed,
    /// It was asked to stop.
    Left,
}

/// Why a worker ended before it was dismissed.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// Standard input does not hold a ticket: the command was not started by a master.
    #[error("no ticket on standard input ({0}): this command is for `tessera` itself to start")]
    Ticket(String),
    /// There is no connection to the master.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// The render threads cannot be started.
    #[error("cannot start the render threads: {0}")]
    Threads(String),
    /// The connection broke.
    #[error("the connection to the master is lost: {0}")]
    Lost(String),
    /// The master does not take this worker.
    #[error("the master refuses this worker: {}", plain_text(&.0.to_string()))]
    Refused(Refusal),
    /// One side cut the connection.
    #[error("the session was cut: {code}: {detail}")]
    Aborted {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
}

impl WorkerError {
    /// Whether the same worker may join again with nothing changed on its side.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Join(error) => error.may_pass(),
            Self::Refused(refusal) => refusal.may_pass(),
            Self::Lost(_) => true,
            Self::Aborted { code, .. } => matches!(code, AbortCode::Timeout | AbortCode::Busy),
            Self::Ticket(_) | Self::Threads(_) => false,
        }
    }
}

/// Serves the master behind `pipes` until it dismisses the worker. Dropping the future ends the worker.
pub async fn serve(pipes: WorkerPipes, config: WorkerConfig) -> Result<(), WorkerError> {
    let (_nobody, stop) = watch::channel(Stop::No);
    serve_until(pipes, config, Token::default(), stop).await.outcome.map(|_| ())
}

/// How it went with one connection.
pub(crate) struct Served {
    /// Whether the master had let the worker in.
    pub(crate) was_welcomed: bool,
    pub(crate) outcome: Result<Parting, WorkerError>,
}

/// [`serve`], showing `token`, until `stop` asks the worker to leave.
pub(crate) async fn serve_until(
    pipes: WorkerPipes,
    config: WorkerConfig,
    token: Token,
    stop: watch::Receiver<Stop>,
) -> Served {
    let begun = Instant::now();
    let memory = config.memory.or_else(free_memory);
    let hello = Hello {
        versions: Version::supported_numbers(),
        token,
        name: config.name,
        role: Role::Worker(Abilities {
            memory: memory.unwrap_or(0),
            threads: config.threads.max(1),
            backend: config.backend.name().into(),
            // Drivers write part of them.
            numeric_class: plain_text(config.backend.numeric_class()),
            speed: config.backend.speed(),
            note: plain_text(config.backend.note()),
        }),
    };
    let ahead = config.backend.tiles_ahead();
    let driver = match Driver::start(pipes, config.threads.max(1), config.backend, config.cache, begun) {
        Ok(driver) => driver,
        Err(error) => return Served { was_welcomed: false, outcome: Err(error) },
    };
    let mut session = Session::start(hello, memory, ahead, begun.elapsed());
    let outcome = drive(driver, &mut session, begun, stop).await;
    Served { was_welcomed: session.was_welcomed(), outcome }
}

async fn drive(
    mut driver: Driver,
    session: &mut Session,
    begun: Instant,
    mut stop: watch::Receiver<Stop>,
) -> Result<Parting, WorkerError> {
    /// How long a drained worker may take for the tile in hand. Seeing off what it says last takes up to another 5 s over a bad network,
    /// and supervisors kill after ten seconds.
    const DRAIN: Duration = Duration::from_secs(5);
    let mut asked = Stop::No;
    let mut drained = None;
    loop {
        let ask = *stop.borrow_and_update();
        if ask > asked {
            asked = ask;
            match ask {
                Stop::Drain => {
                    drained = Some(Instant::now() + DRAIN);
                    session.drain();
                }
                Stop::No | Stop::Now => session.leave(),
            }
        }
        while let Some(action) = session.poll() {
            if let Some(ending) = driver.act(action, session) {
                driver.close(asked).await;
                return ending_to_result(ending);
            }
        }
        let deadline = session.deadline().map(|deadline| begun + deadline);
        tokio::select! {
            event = driver.events.recv() => match event {
                Some(event) => driver.take(event, session)?,
                None => return Err(WorkerError::Lost("its tasks have ended".into())),
            },
            () = async { sleep_until(deadline.unwrap_or(begun)).await }, if deadline.is_some() => {
                session.tick(begun.elapsed());
            }
            () = async { sleep_until(drained.unwrap_or(begun)).await }, if drained.is_some() => session.leave(),
            Ok(()) = stop.changed() => {}
        }
    }
}

/// The pipes' tasks, the render thread and the pack. Its methods never wait for a peer.
struct Driver {
    events: mpsc::Receiver<Event>,
    control: mpsc::UnboundedSender<ToMaster>,
    control_writer: JoinHandle<()>,
    /// At most as many longer than `limits::BATCHES_IN_FLIGHT` as tiles are rendered ahead: the session sees to it.
    bulk: mpsc::UnboundedSender<Batch>,
    /// When the session was begun.
    begun: Instant,
    bulk_writer: JoinHandle<()>,
    /// At most one long: likewise.
    wanted_packs: mpsc::UnboundedSender<(PackId, u64)>,
    renderer: RenderThread,
    pack: Option<Pack>,
    cache: Option<PackCache>,
    /// Packs on their way to the cache.
    keeping: JoinSet<()>,
    /// Ends the reading tasks with the driver.
    _tasks: JoinSet<()>,
}

enum Event {
    Message(ToWorker),
    Rendered(Box<RenderedTile>),
    RenderingStopped(TileName),
    RenderingFailed(String),
    RendererPanicked,
    BatchSent,
    PackFound(Pack),
    PackReserved(PackId, Result<(), PackRefusal>),
    PackReceived(PackId, Result<Pack, PackRefusal>),
    Broken(PipeError),
    Ended,
}

impl Driver {
    /// Events that wait for the driver; a task that finds the queue full waits itself.
    const EVENTS: usize = 64;

    fn start(
        pipes: WorkerPipes,
        threads: u32,
        backend: Backend,
        cache: Option<PackCache>,
        begun: Instant,
    ) -> Result<Self, WorkerError> {
        tracing::debug!("rendering on the {backend} with {threads} threads");
        let (tell, events) = mpsc::channel(Self::EVENTS);
        let (control, messages) = mpsc::unbounded_channel();
        let (bulk, batches) = mpsc::unbounded_channel();
        let (wanted_packs, wanted) = mpsc::unbounded_channel();
        let mut tasks = JoinSet::new();
        tasks.spawn(read_control(pipes.control_in, tell.clone()));
        let bulk_writer = tokio::spawn(write_bulk(pipes.bulk_out, batches, begun, tell.clone()));
        tasks.spawn(read_packs(pipes.bulk_in, wanted, (backend.clone(), cache.clone()), tell.clone()));
        let control_writer = tokio::spawn(write_control(pipes.control_out, messages));
        let renderer = RenderThread::start(threads, backend, move |event| {
            // The driver may be gone; the thread then ends with it.
            let _ = tell.blocking_send(match event {
                RenderEvent::Rendered(tile) => Event::Rendered(tile),
                RenderEvent::Stopped(tile) => Event::RenderingStopped(tile),
                RenderEvent::Failed(reason) => Event::RenderingFailed(reason),
                RenderEvent::Panicked => Event::RendererPanicked,
            });
        })
        .map_err(|e| WorkerError::Threads(e.to_string()))?;
        Ok(Self {
            events,
            control,
            control_writer,
            bulk,
            begun,
            bulk_writer,
            wanted_packs,
            renderer,
            pack: None,
            cache,
            keeping: JoinSet::new(),
            _tasks: tasks,
        })
    }

    /// Does what the session wants; the ending, if that is it. A task that has ended has told so in an event:
    /// sends may fail.
    fn act(&mut self, action: Action, session: &mut Session) -> Option<Ending> {
        match action {
            Action::Send(message) => {
                let _ = self.control.send(message);
            }
            Action::Return(batch) => {
                let _ = self.bulk.send(batch);
            }
            Action::Receive { pack, length } => {
                self.pack = None;
                let _ = self.wanted_packs.send((pack, length));
            }
            Action::Render(task) => match &self.pack {
                Some(pack) => self.renderer.render(task, pack.clone()),
                None => session.abort(AbortCode::Internal, "a tile without a pack".into()),
            },
            Action::StopRendering(tiles) => self.renderer.stop(&tiles),
            Action::Over(ending) => return Some(ending),
        }
        None
    }

    fn take(&mut self, event: Event, session: &mut Session) -> Result<(), WorkerError> {
        match event {
            Event::Message(message) => {
                let was_welcomed = session.was_welcomed();
                session.message(message);
                if session.was_welcomed() && !was_welcomed {
                    tracing::info!("the master has let this worker in");
                }
            }
            Event::Rendered(tile) => {
                session.rendered(RenderedTile { finished: self.begun.elapsed(), ..*tile });
            }
            Event::RenderingStopped(tile) => session.rendering_stopped(tile),
            // Others render its tiles; it may come back with another backend.
            Event::RenderingFailed(reason) => session.abort(AbortCode::Internal, reason),
            Event::RendererPanicked => session.abort(AbortCode::Internal, "the renderer has panicked".into()),
            Event::BatchSent => session.batch_sent(),
            Event::PackReserved(pack, result) => session.pack_reserved(pack, result),
            Event::PackFound(pack) => {
                let id = PackId(pack.id().0);
                tracing::info!("pack {id} is in the cache");
                self.pack = Some(pack);
                session.pack_found(id);
            }
            Event::PackReceived(id, result) => {
                let result = result.map(|pack| {
                    self.keep(pack.clone());
                    self.pack = Some(pack);
                });
                session.pack_received(id, result);
            }
            Event::Broken(PipeError::Codec(e)) => session.abort(AbortCode::Malformed, e.to_string()),
            Event::Broken(PipeError::Io(e)) if e.kind() == io::ErrorKind::InvalidData => {
                session.abort(AbortCode::Malformed, reason(&e));
            }
            Event::Broken(PipeError::Io(e)) => return Err(WorkerError::Lost(reason(&e))),
            Event::Ended => return Err(WorkerError::Lost("the master has closed it".into())),
        }
        Ok(())
    }

    /// Puts a pack into the cache while work goes on.
    fn keep(&mut self, pack: Pack) {
        let Some(cache) = self.cache.clone() else { return };
        self.keeping.spawn_blocking(move || match cache.store(&pack) {
            Ok(true) => tracing::info!("pack {} is kept in the cache", PackId(pack.id().0)),
            Ok(false) => {}
            Err(e) => tracing::warn!("the cache cannot keep a pack: {e}"),
        });
    }

    /// Sees the last messages off, and packs that are being kept unless the worker was `asked` to end: a pack can be had again.
    async fn close(mut self, asked: Stop) {
        /// A peer that does not read is not waited for.
        const FAREWELL: Duration = Duration::from_secs(1);
        /// Gigabytes on a disk.
        const KEEPING: Duration = Duration::from_secs(5);
        drop((self.control, self.bulk));
        let _ = timeout(FAREWELL, async { (self.control_writer.await, self.bulk_writer.await) }).await;
        if asked == Stop::No {
            let _ = timeout(KEEPING, async { while self.keeping.join_next().await.is_some() {} }).await;
        }
    }
}

async fn read_control(mut pipe: Reader, tell: mpsc::Sender<Event>) {
    loop {
        let event = match read_message(&mut pipe).await {
            Ok(Some(message)) => Event::Message(message),
            Ok(None) => Event::Ended,
            Err(e) => Event::Broken(e),
        };
        let is_last = !matches!(event, Event::Message(_));
        if tell.send(event).await.is_err() || is_last {
            return;
        }
    }
}

async fn write_control(mut pipe: Writer, mut messages: mpsc::UnboundedReceiver<ToMaster>) {
    while let Some(message) = messages.recv().await {
        // A broken pipe shows in `read_control` as well.
        if let Err(e) = write_message(&mut pipe, &message).await {
            tracing::debug!("control pipe: {e}");
            return;
        }
    }
    let _ = pipe.shutdown().await;
}

async fn write_bulk(
    mut pipe: Writer,
    batches: mpsc::UnboundedReceiver<Batch>,
    begun: Instant,
    tell: mpsc::Sender<Event>,
) {
    let (coded, mut ready) = mpsc::channel(1);
    let coder = tokio::spawn(code_batches(batches, coded));
    while let Some(batch) = ready.recv().await {
        let event = match write_batch(&mut pipe, batch, begun).await {
            Ok(()) => Event::BatchSent,
            // A master that cuts the connection stops reading first. Its control pipe tells why, and this one must not be before it.
            Err(PipeError::Io(e)) => return tracing::debug!("bulk pipe: {}", reason(&e)),
            Err(e) => Event::Broken(e),
        };
        if tell.send(event).await.is_err() {
            return;
        }
    }
    if let Ok(Err(e)) | Err(e) = coder.await {
        let _ = tell.send(Event::RenderingFailed(format!("coding tiles failed: {e}"))).await;
    }
    let _ = pipe.shutdown().await;
}

async fn write_batch(pipe: &mut Writer, mut batch: Batch, begun: Instant) -> Result<(), PipeError> {
    let now = begun.elapsed();
    for (entry, &finished) in batch.header.tiles.iter_mut().zip(&batch.finished) {
        entry.waited_us = micros(now.saturating_sub(finished));
    }
    write_message(pipe, &batch.header).await?;
    for pixels in &batch.pixels {
        pipe.write_all(pixels).await?;
    }
    Ok(pipe.flush().await?)
}

async fn read_packs(
    mut pipe: Reader,
    mut wanted: mpsc::UnboundedReceiver<(PackId, u64)>,
    (backend, cache): (Backend, Option<PackCache>),
    tell: mpsc::Sender<Event>,
) {
    while let Some((pack, length)) = wanted.recv().await {
        if let Some(cache) = cache.clone() {
            let found = tokio::task::spawn_blocking(move || cache.load(pack)).await;
            if let Ok(Some(found)) = found {
                let event = match hold(&backend, found).await {
                    Ok(found) => Event::PackFound(found),
                    Err(PackFault::Refused(refusal)) => Event::PackReserved(pack, Err(refusal)),
                    Err(PackFault::Failed(reason)) => Event::RenderingFailed(reason),
                };
                if tell.send(event).await.is_err() {
                    return;
                }
                continue;
            }
        }
        // Gigabytes are zeroed here.
        let assembly = tokio::task::spawn_blocking(move || Assembly::new(pack, length)).await;
        let assembly = assembly.unwrap_or_else(|e| {
            Err(PackRefusal::Transfer { detail: format!("making room for it failed: {e}") })
        });
        let reserved = assembly.as_ref().map(|_| ()).map_err(Clone::clone);
        if tell.send(Event::PackReserved(pack, reserved)).await.is_err() {
            return;
        }
        let Ok(assembly) = assembly else { continue };
        let event = match receive(&mut pipe, assembly).await {
            // What it takes beside the worker's memory shows in the pack alone.
            Ok(Ok(received)) => match hold(&backend, received).await {
                Ok(held) => Event::PackReceived(pack, Ok(held)),
                Err(PackFault::Refused(refusal)) => Event::PackReceived(pack, Err(refusal)),
                Err(PackFault::Failed(reason)) => Event::RenderingFailed(reason),
            },
            Ok(Err(refusal)) => Event::PackReceived(pack, Err(refusal)),
            // As in `write_bulk`; what is no pipe of packs at all is the master's fault.
            Err(PipeError::Io(e)) if e.kind() != io::ErrorKind::InvalidData => {
                return tracing::debug!("bulk pipe: {}", reason(&e));
            }
            Err(e) => Event::Broken(e),
        };
        if tell.send(event).await.is_err() {
            return;
        }
    }
}

/// Has the backend hold a pack, beside what else goes on.
async fn hold(backend: &Backend, pack: Pack) -> Result<Pack, PackFault> {
    let backend = backend.clone();
    let held = tokio::task::spawn_blocking(move || backend.check_pack(&pack).map(|()| pack)).await;
    held.unwrap_or_else(|e| Err(PackFault::Failed(format!("taking the pack in failed: {e}"))))
}

fn ending_to_result(ending: Ending) -> Result<Parting, WorkerError> {
    match ending {
        Ending::Dismissed => Ok(Parting::Dismissed),
        Ending::Left => Ok(Parting::Left),
        Ending::Refused(refusal) => Err(WorkerError::Refused(refusal)),
        Ending::Aborted { code, detail } => Err(WorkerError::Aborted { code, detail: plain_text(&detail) }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BackendChoice, BackendConfig};
    use tessera_wire::{BatchHeader, Camera, Coding, Frame, FrameId, PixelFormat, ReturnMode};

    /// The master stops reading and writing its bulk pipe before its `Abort` arrives: the worker waits for that.
    #[tokio::test]
    async fn a_bulk_pipe_that_breaks_is_not_a_lost_connection() {
        let (here, there) = tokio::io::duplex(64);
        drop(there);
        let (pipe_in, pipe_out) = tokio::io::split(here);
        let (tell, mut told) = mpsc::channel(8);

        let (wanted_packs, wanted) = mpsc::unbounded_channel();
        wanted_packs.send((PackId([1; 32]), 100)).unwrap();
        let backend =
            Backend::open(&BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() });
        let backend = backend.expect("there is a CPU");
        read_packs(Box::new(pipe_in), wanted, (backend, None), tell.clone()).await;
        assert!(matches!(told.recv().await, Some(Event::PackReserved(_, Ok(())))));
        assert!(told.try_recv().is_err());

        let (bulk, batches) = mpsc::unbounded_channel();
        let frame = Frame {
            frame: FrameId(1),
            pack: PackId([1; 32]),
            camera: Camera { origin: [0.0; 3], forward: [1.0; 3], right: [1.0; 3], up: [1.0; 3] },
            width: 5,
            height: 5,
            tile: 5,
            samples: 1,
            sampling: Default::default(),
            depth: 1,
            seed: 0,
            features: Default::default(),
            format: PixelFormat::Rgba8,
            returns: ReturnMode::AtEnd,
            coding: Coding::Raw,
        };
        let header = BatchHeader { frame: FrameId(1), tiles: Vec::new() };
        bulk.send(Batch { header, pixels: vec![vec![0; 100]], finished: vec![Duration::ZERO], frame })
            .unwrap();
        write_bulk(Box::new(pipe_out), batches, Instant::now(), tell).await;
        assert!(told.recv().await.is_none());
    }
}
