//! A client at the master: its pack is taken and checked, its frames wait their turn, and the image goes back.

use crate::{
    ClassDifference, ClassPart, FrameJob, FrameResult, WorkerReport,
    door::{Guest, turn_away},
    packs::{Kept, PackStore, Room},
    transport::{PipeError, Pipes, read_message, write_message},
};
use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};
use tessera_pack::{Pack, PackBuffer, PackError};
use tessera_wire::{
    AbortCode, Balance, ClassSummary, DifferenceSummary, Frame, FrameFailure, FrameSummary, FromClient,
    Hello, PackChunk, PackId, PackProgress, PackRefusal, Refusal, ToClient, Version, WorkerSummary, limits,
    plain_text,
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    sync::{
        mpsc::{self, error::TrySendError},
        oneshot, watch,
    },
    task::{JoinSet, spawn_blocking},
    time::timeout,
};

/// What all clients share.
pub(crate) struct Reception {
    pub(crate) packs: Arc<PackStore>,
    pub(crate) jobs: mpsc::Sender<Job>,
    /// Frames that wait or are rendered.
    pub(crate) frames: Arc<AtomicU32>,
    /// Becomes true when the master is told to end.
    pub(crate) stopping: watch::Receiver<bool>,
}

/// A frame that waits its turn.
pub(crate) struct Job {
    /// The client's name.
    pub(crate) name: String,
    pub(crate) pack: Arc<Kept>,
    /// Its image's.
    pub(crate) _room: Arc<Room>,
    pub(crate) job: FrameJob,
    /// Progress; what finds no room is dropped.
    pub(crate) tell: mpsc::Sender<ToClient>,
    /// Closed when the client is gone.
    pub(crate) done: oneshot::Sender<Result<FrameResult, FrameFailure>>,
}

/// Takes clients in, as many as there are seats, until the master is told to end, and then waits for those that are being told.
pub(crate) async fn receive(mut guests: mpsc::Receiver<Guest>, reception: Reception) {
    let reception = Arc::new(reception);
    let mut stopping = reception.stopping.clone();
    let (mut clients, mut others) = (JoinSet::new(), JoinSet::new());
    loop {
        tokio::select! {
            // Seats that are free again come before those who want one.
            biased;
            _ = stopping.wait_for(|stopping| *stopping) => break,
            Some(_) = clients.join_next() => {}
            Some(_) = others.join_next() => {}
            guest = guests.recv() => match guest {
                Some(guest) if clients.len() < limits::CLIENTS => {
                    clients.spawn(attend(guest, reception.clone()));
                }
                Some(guest) => {
                    others.spawn(turn_away(guest, Refusal::Full { limit: limits::CLIENTS as u32 }));
                }
                None => break,
            },
        }
    }
    while clients.join_next().await.is_some() || others.join_next().await.is_some() {}
}

/// Serves a client to its end.
async fn attend(guest: Guest, reception: Arc<Reception>) {
    let Guest { hello, link, .. } = guest;
    let name = plain_text(&hello.name);
    tracing::info!("client {name} has come from {}", link.peer);
    let connection = link.connection.clone();
    let mut visit = Visit::start(link.pipes, name.clone());
    let ended = visit.converse(&hello, &reception).await;
    let code = match ended {
        Ok(()) => {
            tracing::info!("client {name} has gone");
            AbortCode::Done
        }
        Err(Cut { code, detail }) => {
            tracing::info!("client {name} was cut off: {code}: {}", plain_text(&detail));
            // One that has gone, or says that it goes, need not be told.
            if code != AbortCode::Done {
                let _ = visit.write(ToClient::Abort { code, detail }).await;
            }
            code
        }
    };
    let _ = visit.pipes.control_out.shutdown().await;
    if let Some(connection) = connection {
        /// How long the client may take to read its last message and close from its side.
        const FAREWELL: Duration = Duration::from_secs(1);
        let _ = timeout(FAREWELL, connection.closed()).await;
        connection.close(quinn::VarInt::from_u32(code.number()), b"");
    }
}

/// Why a client is cut off.
struct Cut {
    code: AbortCode,
    detail: String,
}

impl From<PipeError> for Cut {
    fn from(error: PipeError) -> Self {
        match error {
            PipeError::Io(e) => {
                Self { code: AbortCode::Done, detail: format!("the connection is lost: {e}") }
            }
            PipeError::Malformed(detail) => Self { code: AbortCode::Malformed, detail },
        }
    }
}

/// The client's own words, to be left with.
fn says(code: AbortCode, detail: &str) -> Cut {
    Cut { code: AbortCode::Done, detail: format!("it says: {code}: {detail}") }
}

fn unexpected(what: &str) -> Cut {
    Cut { code: AbortCode::Unexpected, detail: format!("{what} does not belong here") }
}

/// One client's connection.
struct Visit {
    name: String,
    pipes: Pipes,
    messages: mpsc::Receiver<Result<FromClient, PipeError>>,
    /// Ends the reading with the visit.
    _reader: JoinSet<()>,
}

impl Visit {
    fn start(mut pipes: Pipes, name: String) -> Self {
        let mut control = std::mem::replace(&mut pipes.control_in, Box::new(tokio::io::empty()));
        let (tell, messages) = mpsc::channel(1);
        let mut reader = JoinSet::new();
        reader.spawn(async move {
            loop {
                let next = read_message::<FromClient>(&mut control, limits::CONTROL_BYTES).await;
                let message = match next.transpose() {
                    Some(message) => message.map(|(message, _)| message),
                    None => return,
                };
                let is_last = message.is_err();
                if tell.send(message).await.is_err() || is_last {
                    return;
                }
            }
        });
        Self { name, pipes, messages, _reader: reader }
    }

    /// Everything from `Welcome` on; in peace, the client or the master has ended it.
    async fn converse(&mut self, hello: &Hello, reception: &Reception) -> Result<(), Cut> {
        let version = Version::common(&hello.versions).map_or(0, Version::number);
        self.write(ToClient::Welcome { version }).await?;
        let mut stopping = reception.stopping.clone();
        let mut held: Option<Arc<Kept>> = None;
        loop {
            let message = tokio::select! {
                message = within(limits::CLIENT_IDLE, "it has asked for nothing", self.messages.recv()) => message?,
                _ = stopping.wait_for(|stopping| *stopping) => return Ok(()),
            };
            match message.transpose()? {
                None => return Ok(()),
                Some(FromClient::PackOffer { pack, length }) => {
                    // It is not asked for any more, and need not stay for the next.
                    drop(held.take());
                    held = self.take_pack(pack, length, &reception.packs).await?;
                }
                Some(FromClient::Render { frame, balance, mix }) => {
                    self.render(&frame, (balance, mix), held.clone(), reception).await?;
                }
                Some(FromClient::Abort { code, detail }) => return Err(says(code, &detail)),
                Some(FromClient::Hello(_)) => return Err(unexpected("a second `Hello`")),
            }
        }
    }

    async fn write(&mut self, message: ToClient) -> Result<(), Cut> {
        in_time(write_message(&mut self.pipes.control_out, &message)).await?;
        Ok(())
    }

    /// Takes a pack that the client offers; the client is told if it cannot be held.
    async fn take_pack(
        &mut self,
        id: PackId,
        length: u64,
        packs: &Arc<PackStore>,
    ) -> Result<Option<Arc<Kept>>, Cut> {
        if let Some(kept) = packs.get(id) {
            self.write(ToClient::PackNeed { pack: id, have: true }).await?;
            self.write(ToClient::PackReady { pack: id }).await?;
            return Ok(Some(kept));
        }
        let rejected = |reason| ToClient::PackRejected { pack: id, reason };
        let room = match packs.make_room(length) {
            Ok(room) => room,
            Err(reason) => return self.write(rejected(reason)).await.map(|()| None),
        };
        // Gigabytes are zeroed here, and checked below.
        let buffer = spawn_blocking(move || PackBuffer::with_len(usize::try_from(length).ok()?)).await;
        let Some(mut buffer) = buffer.ok().flatten() else {
            let reason = PackRefusal::OutOfMemory { needs: length, has: 0 };
            return self.write(rejected(reason)).await.map(|()| None);
        };
        self.write(ToClient::PackNeed { pack: id, have: false }).await?;
        let bulk = &mut self.pipes.bulk_in;
        let transfer = async {
            let mut progress = PackProgress::new(id, length);
            while !progress.is_complete() {
                let chunk = in_time(read_message::<PackChunk>(bulk, limits::CHUNK_HEADER_BYTES)).await?;
                let (chunk, _) =
                    chunk.ok_or_else(|| unexpected("the end of the bulk pipe in the middle of a pack"))?;
                let malformed = |e: PackRefusal| Cut { code: AbortCode::Malformed, detail: e.to_string() };
                let range = progress.accept(&chunk).map_err(malformed)?;
                // Within `length`, which is a `usize`.
                let room = &mut buffer.as_mut_slice()[range.start as usize..range.end as usize];
                in_time(async { Ok(bulk.read_exact(room).await?) }).await?;
            }
            Ok::<_, Cut>(())
        };
        // It has the room of others: a byte a minute is not enough.
        within(limits::pack_timeout(length), "its pack was on its way", transfer).await??;
        let checked = spawn_blocking(move || Pack::from_buffer(buffer)).await;
        let checked = match checked {
            Ok(Ok(pack)) if pack.id().0 == id.0 => Ok(pack),
            Ok(Ok(pack)) => Err(PackRefusal::HashMismatch { got: PackId(pack.id().0) }),
            Ok(Err(PackError::OutOfMemory(needs))) => Err(PackRefusal::OutOfMemory { needs, has: 0 }),
            Ok(Err(e)) => Err(PackRefusal::Invalid { detail: plain_text(&e.to_string()) }),
            Err(e) => Err(PackRefusal::Invalid { detail: format!("checking it failed: {e}") }),
        };
        match checked {
            Ok(pack) => {
                let kept = packs.keep(room, pack);
                self.write(ToClient::PackReady { pack: id }).await?;
                Ok(Some(kept))
            }
            Err(reason) => self.write(rejected(reason)).await.map(|()| None),
        }
    }

    /// Has a frame rendered and sends it back. Returning early, for a client that is gone, ends the frame.
    async fn render(
        &mut self,
        frame: &Frame,
        (balance, mix): (Balance, bool),
        held: Option<Arc<Kept>>,
        reception: &Reception,
    ) -> Result<(), Cut> {
        let id = frame.frame;
        let failed = |reason| ToClient::Failed { frame: id, reason };
        let invalid = |detail: String| failed(FrameFailure::Invalid { detail });
        let Some(pack) = held.filter(|kept| kept.pack.id().0 == frame.pack.0) else {
            return self.write(invalid("its pack was not offered before".into())).await;
        };
        if let Err(e) = frame.check() {
            return self.write(invalid(e.to_string())).await;
        }
        // Until the client has it.
        let room = match reception.packs.make_room(image_bytes(frame)) {
            Ok(room) => Arc::new(room),
            Err(PackRefusal::OutOfMemory { needs, has }) => {
                let detail = format!("its image takes {needs} bytes, the master has {has} left for clients");
                return self.write(invalid(detail)).await;
            }
            Err(other) => return self.write(invalid(other.to_string())).await,
        };
        let (done, mut outcome) = oneshot::channel();
        let (tell, mut news) = mpsc::channel(16);
        let job = FrameJob::from_wire(frame, balance, mix);
        let job = Job { name: self.name.clone(), pack, _room: room.clone(), job, tell, done };
        let ahead = reception.frames.fetch_add(1, Ordering::Relaxed);
        if let Err(e) = reception.jobs.try_send(job) {
            reception.frames.fetch_sub(1, Ordering::Relaxed);
            let reason = match e {
                TrySendError::Full(_) => FrameFailure::Busy { waiting: ahead },
                TrySendError::Closed(_) => FrameFailure::Stopping,
            };
            return self.write(failed(reason)).await;
        }
        if ahead > 0 {
            self.write(ToClient::Waiting { ahead }).await?;
        }
        let outcome = loop {
            tokio::select! {
                outcome = &mut outcome => break outcome.unwrap_or(Err(FrameFailure::Stopping)),
                Some(message) = news.recv() => self.write(message).await?,
                message = self.messages.recv() => match message.transpose()? {
                    None => return Err(PipeError::Io(std::io::ErrorKind::UnexpectedEof.into()).into()),
                    Some(FromClient::Abort { code, detail }) => return Err(says(code, &detail)),
                    Some(_) => return Err(unexpected("a message in the middle of a frame")),
                },
            }
        };
        match outcome {
            Ok(result) => self.send(frame, result).await,
            Err(reason) => self.write(failed(reason)).await,
        }
    }

    /// Sends a frame.
    async fn send(&mut self, frame: &Frame, result: FrameResult) -> Result<(), Cut> {
        self.write(ToClient::Finished { frame: frame.frame }).await?;
        let bulk = &mut self.pipes.bulk_out;
        in_time(write_message(bulk, &summary(frame, &result))).await?;
        for bytes in result.image.data().chunks(limits::CHUNK_BYTES as usize) {
            in_time(async { Ok(bulk.write_all(bytes).await?) }).await?;
        }
        in_time(async { Ok(bulk.flush().await?) }).await
    }
}

/// Waits for a client, but not for ever.
async fn in_time<T>(work: impl Future<Output = Result<T, PipeError>>) -> Result<T, Cut> {
    Ok(within(limits::CLIENT_TIMEOUT, "nothing has moved", work).await??)
}

/// Waits so long at most; `what` says what did not happen.
async fn within<T>(limit: Duration, what: &str, work: impl Future<Output = T>) -> Result<T, Cut> {
    let late = |_| Cut { code: AbortCode::Timeout, detail: format!("{what} for {} s", limit.as_secs()) };
    timeout(limit, work).await.map_err(late)
}

/// Of a frame in range.
fn image_bytes(frame: &Frame) -> u64 {
    u64::from(frame.width) * u64::from(frame.height) * frame.format.bytes_per_pixel() as u64
}

fn summary(frame: &Frame, result: &FrameResult) -> FrameSummary {
    let us = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
    let worker = |worker: &WorkerReport| WorkerSummary {
        name: plain_text(&worker.name),
        backend: plain_text(&worker.backend),
        numeric_class: plain_text(&worker.numeric_class),
        note: plain_text(&worker.note),
        tiles: worker.tiles,
        render_us: us(worker.render),
        bytes_returned: worker.bytes_returned,
        lost: worker.lost.as_deref().map(plain_text),
        rejected: worker.rejected.as_deref().map(plain_text),
    };
    let class = |part: &ClassPart| ClassSummary {
        class: plain_text(&part.class),
        workers: part.workers,
        tiles: part.tiles,
    };
    let difference = |found: &ClassDifference| DifferenceSummary {
        classes: found.classes.each_ref().map(|class| plain_text(class)),
        tiles: found.tiles,
        pixels: found.pixels,
        differing: found.differing,
        max_abs: found.max_abs,
        psnr_db: found.psnr_db,
    };
    let (timings, traffic) = (&result.timings, &result.traffic);
    FrameSummary {
        frame: frame.frame,
        length: result.image.data().len() as u64,
        classes: result.classes.iter().map(class).collect(),
        differences: result.differences.iter().map(difference).collect(),
        idle: result.idle,
        // Who came and went many times in one frame may be listed in part.
        workers: result.workers.iter().take(limits::WORKERS).map(worker).collect(),
        times_us: [timings.send_scene, timings.render, timings.return_, timings.frame].map(us),
        traffic: [traffic.sent, traffic.received, traffic.udp_sent, traffic.udp_received],
        rays: result.rays,
        dropped_tiles: result.dropped_tiles,
    }
}
