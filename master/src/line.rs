//! The tasks that carry one worker's four pipes. They wait for the peer, so that the cluster never does.

use crate::{
    door::Guest,
    transport::{Link, PipeError, Reader, Writer, read_message, read_raw, write_message, write_pack},
};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};
use tessera_pack::Pack;
use tessera_wire::{
    AbortCode, BatchHeader, FrameId, TileCoding, TileEntry, ToMaster, ToWorker, WorkerId, limits, pixels,
};
use tokio::{
    io::AsyncWriteExt,
    sync::mpsc,
    task::{JoinHandle, JoinSet, spawn_blocking},
    time::timeout,
};

/// What the tasks tell the cluster.
pub(crate) enum Input {
    /// A peer was let in.
    Guest(Box<Guest>),
    /// A message came.
    Message(WorkerId, ToMaster),
    /// A tile came.
    Tile(WorkerId, Tile),
    /// More bytes of a pack are on their way (see [`Counters::pack`]).
    PackSent,
    /// Nothing more comes on a worker's bulk pipe.
    BulkEnded(WorkerId),
    /// A pipe is at its end.
    Broken(WorkerId, PipeError),
    /// A local process has ended.
    Exited(usize, String),
}

/// A tile as it came.
pub(crate) struct Tile {
    pub(crate) frame: FrameId,
    pub(crate) entry: TileEntry,
    pub(crate) pixels: Vec<u8>,
    /// With its batch's header, if it is the first of it.
    pub(crate) wire_bytes: u64,
}

/// Bytes over all lines.
#[derive(Default)]
pub(crate) struct Counters {
    pub(crate) sent: AtomicU64,
    pub(crate) received: AtomicU64,
    /// Of `sent`, raw bytes of packs.
    pub(crate) pack: AtomicU64,
    /// Of the largest tile that any frame so far has had.
    pub(crate) tile_bytes: AtomicU64,
    /// Of `received`, bytes of tiles, and how long they were waited for once their header was there.
    pub(crate) arrival: Effort,
    /// Pixels of packed tiles, and how long unpacking them took.
    pub(crate) unpacking: Effort,
}

/// Bytes, and the time that they took.
#[derive(Default)]
pub(crate) struct Effort {
    bytes: AtomicU64,
    nanoseconds: AtomicU64,
}

impl Effort {
    fn add(&self, bytes: usize, time: Duration) {
        let nanoseconds = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.nanoseconds.fetch_add(nanoseconds, Ordering::Relaxed);
    }

    /// What has come since this was asked last.
    pub(crate) fn take(&self) -> (u64, Duration) {
        let bytes = self.bytes.swap(0, Ordering::Relaxed);
        (bytes, Duration::from_nanos(self.nanoseconds.swap(0, Ordering::Relaxed)))
    }
}

/// A connected worker.
pub(crate) struct Line {
    /// `None` once closed.
    control: Option<mpsc::UnboundedSender<ToWorker>>,
    packs: mpsc::UnboundedSender<Pack>,
    control_writer: Option<JoinHandle<()>>,
    connection: Option<quinn::Connection>,
    pub(crate) peer: String,
    /// Once it has joined.
    pub(crate) name: Option<String>,
    /// The other tasks.
    tasks: JoinSet<()>,
}

impl Line {
    /// Starts the tasks.
    pub(crate) fn start(
        worker: WorkerId,
        link: Link,
        tell: &mpsc::Sender<Input>,
        counters: &Arc<Counters>,
    ) -> Self {
        let Link { pipes, peer, connection } = link;
        let (control, messages) = mpsc::unbounded_channel();
        let (packs, wanted) = mpsc::unbounded_channel();
        let mut tasks = JoinSet::new();
        tasks.spawn(read_control(worker, pipes.control_in, tell.clone(), counters.clone()));
        tasks.spawn(read_bulk(worker, pipes.bulk_in, tell.clone(), counters.clone()));
        tasks.spawn(write_packs(worker, pipes.bulk_out, wanted, tell.clone(), counters.clone()));
        let writer = write_control(pipes.control_out, messages, counters.clone());
        let control_writer = Some(tokio::spawn(writer));
        Self { control: Some(control), packs, control_writer, connection, peer, name: None, tasks }
    }

    /// Queues a message. A broken line has told so, and loses it.
    pub(crate) fn send(&self, message: ToWorker) {
        if let Some(control) = &self.control {
            let _ = control.send(message);
        }
    }

    /// Queues a pack.
    pub(crate) fn send_pack(&self, pack: Pack) {
        let _ = self.packs.send(pack);
    }

    /// Whether bytes to and from it are more than copied.
    pub(crate) fn is_remote(&self) -> bool {
        self.connection.is_some()
    }

    /// Whether [`Line::close`] was called.
    pub(crate) fn is_closed(&self) -> bool {
        self.control.is_none()
    }

    /// What a round trip takes, as the transport has measured it; none within this process.
    pub(crate) fn round_trip(&self) -> Duration {
        self.connection.as_ref().map_or(Duration::ZERO, quinn::Connection::rtt)
    }

    /// Bytes of UDP payload sent and received, until it is closed.
    pub(crate) fn udp_bytes(&self) -> (u64, u64) {
        self.connection.as_ref().map_or((0, 0), |connection| {
            let stats = connection.stats();
            (stats.udp_tx.bytes, stats.udp_rx.bytes)
        })
    }

    /// Takes no more messages; the future sees the queued ones off and closes the connection.
    pub(crate) fn close(&mut self, code: AbortCode) -> impl Future<Output = ()> + Send + 'static {
        /// How long the worker may take to read its last messages and close from its side.
        const FAREWELL: Duration = Duration::from_secs(1);
        self.control = None;
        self.tasks.abort_all();
        let (writer, connection) = (self.control_writer.take(), self.connection.take());
        async move {
            let see_off = async {
                if let Some(writer) = writer {
                    let _ = writer.await;
                }
                if let Some(connection) = &connection {
                    connection.closed().await;
                }
            };
            let _ = timeout(FAREWELL, see_off).await;
            if let Some(connection) = connection {
                connection.close(quinn::VarInt::from_u32(code.number()), b"");
            }
        }
    }
}

async fn read_control(
    worker: WorkerId,
    mut pipe: Reader,
    tell: mpsc::Sender<Input>,
    counters: Arc<Counters>,
) {
    // In memory the first message is the `Hello`, and nobody is trusted with more before it is read. The door has read a guest's; its
    // next is as short.
    let mut limit = limits::HELLO_BYTES;
    loop {
        let input = match read_message::<ToMaster>(&mut pipe, limit).await {
            Ok(Some((message, bytes))) => {
                counters.received.fetch_add(bytes, Ordering::Relaxed);
                Input::Message(worker, message)
            }
            Ok(None) => Input::Broken(worker, ended()),
            Err(e) => Input::Broken(worker, e),
        };
        limit = limits::CONTROL_BYTES;
        // Behind `Leave` comes the end of the pipe, and that is no failure.
        let is_last = matches!(input, Input::Broken(..) | Input::Message(_, ToMaster::Leave));
        if tell.send(input).await.is_err() || is_last {
            return;
        }
    }
}

fn ended() -> PipeError {
    PipeError::Io(std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "it has closed the connection"))
}

async fn write_control(
    mut pipe: Writer,
    mut messages: mpsc::UnboundedReceiver<ToWorker>,
    counters: Arc<Counters>,
) {
    while let Some(message) = messages.recv().await {
        match write_message(&mut pipe, &message).await {
            Ok(bytes) => counters.sent.fetch_add(bytes, Ordering::Relaxed),
            // A broken pipe shows in `read_control` as well.
            Err(e) => return tracing::debug!("control pipe: {e}"),
        };
    }
    let _ = pipe.shutdown().await;
}

async fn read_bulk(worker: WorkerId, mut pipe: Reader, tell: mpsc::Sender<Input>, counters: Arc<Counters>) {
    loop {
        match read_batch(worker, &mut pipe, &tell, &counters).await {
            Ok(true) => {}
            // The control pipe tells of a connection that ends; this one alone must not.
            Ok(false) => {
                let _ = tell.send(Input::BulkEnded(worker)).await;
                return;
            }
            Err(e) => {
                let _ = tell.send(Input::Broken(worker, e)).await;
                return;
            }
        }
    }
}

/// Hands on the next batch, tile by tile; `false` at the end of the pipe, or when nobody listens.
async fn read_batch(
    worker: WorkerId,
    pipe: &mut Reader,
    tell: &mpsc::Sender<Input>,
    counters: &Counters,
) -> Result<bool, PipeError> {
    let Some((header, header_bytes)) = read_message::<BatchHeader>(pipe, limits::HEADER_BYTES).await? else {
        return Ok(false);
    };
    header.check().map_err(PipeError::Malformed)?;
    counters.received.fetch_add(header_bytes, Ordering::Relaxed);
    let mut header_share = header_bytes;
    for entry in header.tiles {
        let most = counters.tile_bytes.load(Ordering::Relaxed);
        let bytes = entry.length.max(entry.pixel_bytes);
        if u64::from(bytes) > most {
            let detail = format!("a tile of {bytes} bytes, no frame had one of more than {most}");
            return Err(PipeError::Malformed(detail));
        }
        let begin = Instant::now();
        let bytes = read_raw(pipe, entry.length as usize).await?;
        counters.arrival.add(bytes.len(), begin.elapsed());
        counters.received.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let wire_bytes = std::mem::take(&mut header_share) + bytes.len() as u64;
        let pixels = match entry.coding {
            TileCoding::Raw => bytes,
            TileCoding::Packed => {
                let begin = Instant::now();
                let pixels = unpack(entry.pixel_bytes as usize, bytes).await?;
                counters.unpacking.add(pixels.len(), begin.elapsed());
                pixels
            }
        };
        let tile = Tile { frame: header.frame, entry, pixels, wire_bytes };
        if tell.send(Input::Tile(worker, tile)).await.is_err() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The pixels of a packed tile, whose length was held against the frames' tiles.
async fn unpack(pixel_bytes: usize, bytes: Vec<u8>) -> Result<Vec<u8>, PipeError> {
    // Milliseconds of work, more for large tiles: too long for a thread that other workers' pipes wait for.
    let work = spawn_blocking(move || pixels::decode(pixel_bytes, &bytes));
    let unpacked = work.await.map_err(|e| PipeError::Io(std::io::Error::other(e)))?;
    unpacked.map_err(PipeError::Malformed)
}

async fn write_packs(
    worker: WorkerId,
    mut pipe: Writer,
    mut wanted: mpsc::UnboundedReceiver<Pack>,
    tell: mpsc::Sender<Input>,
    counters: Arc<Counters>,
) {
    while let Some(pack) = wanted.recv().await {
        let sent = |header_bytes, bytes| {
            counters.sent.fetch_add(header_bytes + bytes, Ordering::Relaxed);
            counters.pack.fetch_add(bytes, Ordering::Relaxed);
            // Only a progress bar misses it if the queue is full.
            let _ = tell.try_send(Input::PackSent);
        };
        match write_pack(&mut pipe, &pack, sent).await {
            Ok(()) => {}
            // A worker that cuts the connection stops reading first. Its control pipe tells why, and this one must not be before it.
            Err(e @ PipeError::Io(_)) => return tracing::debug!("bulk pipe: {e}"),
            Err(e) => {
                let _ = tell.send(Input::Broken(worker, e)).await;
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_tile_longer_than_any_frame_has_had_is_not_read() {
        let (link, mut there) = Link::in_memory();
        let (tell, mut inputs) = mpsc::channel(8);
        let counters = Arc::<Counters>::default();
        counters.tile_bytes.store(100, Ordering::Relaxed);
        let _line = Line::start(WorkerId(0), link, &tell, &counters);
        let header = BatchHeader { frame: FrameId(1), tiles: vec![TileEntry::raw(100), TileEntry::raw(101)] };
        write_message(&mut there.bulk_out, &header).await.unwrap();
        // Enough for the first alone: the second is not waited for.
        there.bulk_out.write_all(&[7; 100]).await.unwrap();
        assert!(matches!(inputs.recv().await, Some(Input::Tile(_, tile)) if tile.pixels == [7; 100]));
        let next = inputs.recv().await;
        assert!(
            matches!(&next, Some(Input::Broken(_, PipeError::Malformed(detail))) if detail.contains("101"))
        );
    }

    #[tokio::test]
    async fn packed_tiles_are_unpacked_and_what_is_none_breaks_the_pipe() {
        let (link, mut there) = Link::in_memory();
        let (tell, mut inputs) = mpsc::channel(8);
        let counters = Arc::<Counters>::default();
        counters.tile_bytes.store(1024, Ordering::Relaxed);
        let _line = Line::start(WorkerId(0), link, &tell, &counters);
        let pixels = [7; 1024];
        let coding = tessera_wire::Coding::Lossless;
        let format = tessera_wire::PixelFormat::Rgba8;
        let packed = pixels::encode(format, 16, &pixels, coding).expect("nothing is smoother");
        let raw = TileEntry::raw(packed.len() as u32);
        let entry = TileEntry { coding: TileCoding::Packed, pixel_bytes: 1024, ..raw };
        let header = BatchHeader { frame: FrameId(1), tiles: vec![entry; 2] };
        write_message(&mut there.bulk_out, &header).await.unwrap();
        there.bulk_out.write_all(&packed).await.unwrap();
        there.bulk_out.write_all(&vec![0xff; packed.len()]).await.unwrap();
        let Some(Input::Tile(_, tile)) = inputs.recv().await else { panic!("the first is well") };
        assert!(tile.pixels == pixels && tile.wire_bytes < 1024, "{} bytes", tile.wire_bytes);
        assert!(matches!(inputs.recv().await, Some(Input::Broken(_, PipeError::Malformed(_)))));
    }
}
