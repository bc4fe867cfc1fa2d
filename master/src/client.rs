//! A client of a master elsewhere: what [`crate::Cluster`] is to workers of its own.

use crate::{
    ClassDifference, ClassPart, FrameBuffer, FrameJob, FrameResult, MasterWork, OutputError, PngStream,
    Progress, Timings, Traffic, WorkerReport,
    image::NoRoom,
    transport::{PipeError, Pipes, read_message, reason, write_message, write_pack},
};
use std::time::{Duration, Instant};
use tessera_pack::Pack;
use tessera_wire::{
    AbortCode, Coding, FrameFailure, FrameId, FrameSummary, FromClient, Hello, PackId, PackRefusal, Refusal,
    Role, ToClient, Token, Version, limits, plain_text,
};
use tokio::{io::AsyncReadExt, time::timeout};

/// A connection to a master that has let this client in. Dropping it ends what the master does for it.
pub struct Client {
    pipes: Pipes,
    frames: u64,
    pack: Option<PackId>,
}

/// Why a master elsewhere gives no frame.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// It does not take this client.
    #[error("the master refuses this client: {}", plain_text(&.0.to_string()))]
    Refused(Refusal),
    /// It cannot hold the pack.
    #[error("the master cannot hold the scene: {}", plain_text(&.0.to_string()))]
    Rejected(PackRefusal),
    /// It has the pack, and no frame of it.
    #[error("{}", plain_text(&.0.to_string()))]
    Failed(FrameFailure),
    /// This side has no memory for the image.
    #[error(transparent)]
    NoRoom(#[from] NoRoom),
    /// The file that takes the rows cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// It has cut the connection, and says why.
    #[error("the master has cut the connection: {code}: {detail}")]
    Cut {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
    /// The connection is gone.
    #[error("the connection to the master is lost: {0}")]
    Lost(String),
    /// It sends what does not belong here.
    #[error("the master does not keep to the protocol: {0}")]
    Protocol(String),
}

impl From<PipeError> for ClientError {
    fn from(error: PipeError) -> Self {
        match error {
            PipeError::Io(e) => Self::Lost(reason(&e)),
            PipeError::Malformed(detail) => Self::Protocol(detail),
        }
    }
}

impl Client {
    /// Introduces itself to the master behind `pipes` as `name`.
    pub async fn join(pipes: Pipes, token: Token, name: String) -> Result<Self, ClientError> {
        let mut this = Self { pipes, frames: 0, pack: None };
        let versions = Version::supported_numbers();
        this.write(FromClient::Hello(Hello { versions, token, name, role: Role::Client })).await?;
        match timeout(limits::HANDSHAKE_TIMEOUT, this.read()).await {
            Ok(answer) => match answer? {
                ToClient::Welcome { version } if Version::from_number(version).is_some() => Ok(this),
                ToClient::Refuse(refusal) => Err(ClientError::Refused(refusal)),
                other => Err(unexpected(&other)),
            },
            Err(_) => Err(ClientError::Lost("no answer in time".into())),
        }
    }

    /// Gives `pack` to the master, unless it holds it already; later frames render it.
    pub async fn load(
        &mut self,
        pack: &Pack,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<Duration, ClientError> {
        let begun = Instant::now();
        let id = PackId(pack.id().0);
        let total = pack.bytes().len() as u64;
        self.pack = None;
        self.write(FromClient::PackOffer { pack: id, length: total }).await?;
        let have = match self.read().await? {
            ToClient::PackNeed { pack, have } if pack == id => have,
            ToClient::PackRejected { reason, .. } => return Err(ClientError::Rejected(reason)),
            other => return Err(unexpected(&other)),
        };
        if !have {
            let mut bytes = 0;
            let sent = write_pack(&mut self.pipes.bulk_out, pack, |_, more| {
                bytes += more;
                progress(Progress::Sent { bytes, total });
            });
            if let Err(error) = sent.await {
                return Err(self.last_words(error).await);
            }
        }
        match self.read().await? {
            ToClient::PackReady { pack } if pack == id => {
                self.pack = Some(id);
                Ok(begun.elapsed())
            }
            ToClient::PackRejected { reason, .. } => Err(ClientError::Rejected(reason)),
            other => Err(unexpected(&other)),
        }
    }

    /// Has one frame of the loaded pack rendered.
    pub async fn render(
        &mut self,
        job: &FrameJob,
        progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult, ClientError> {
        let result = self.run(job, progress).await?;
        // As long as the master has announced.
        let mut image = FrameBuffer::new(job.width, job.height, job.format)?;
        self.pipes.bulk_in.read_exact(image.data_mut()).await.map_err(PipeError::Io)?;
        Ok(result.with_image(image).0)
    }

    /// The same, with the image's rows going to `stream` as they come, for which the caller then calls [`PngStream::finish`]. The master
    /// sends them when the frame is complete, and holds it until then; here only some are held at a time.
    pub async fn render_rows(
        &mut self,
        job: &FrameJob,
        stream: &mut PngStream,
        progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult<()>, ClientError> {
        let result = self.run(job, progress).await?;
        let row = job.width as usize * job.format.bytes_per_pixel();
        // At most 65,536 pixels of 8 bytes in a row.
        let rows = (limits::CHUNK_BYTES as usize / row).max(1);
        let mut left = job.height as usize;
        while left > 0 {
            let mut bytes = vec![0; rows.min(left) * row];
            self.pipes.bulk_in.read_exact(&mut bytes).await.map_err(PipeError::Io)?;
            stream.push(bytes).await?;
            left -= rows.min(left);
        }
        Ok(result)
    }

    /// A frame but for its pixels, which are what comes next.
    async fn run(
        &mut self,
        job: &FrameJob,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult<()>, ClientError> {
        let pack = self.pack.ok_or_else(|| ClientError::Protocol("no scene is loaded".into()))?;
        self.frames += 1;
        let frame = job.to_wire(FrameId(self.frames), pack);
        let grid = frame
            .check()
            .map_err(|e| ClientError::Failed(FrameFailure::Invalid { detail: e.to_string() }))?;
        self.write(FromClient::Render { frame, balance: job.balance, mix: job.mix }).await?;
        loop {
            match self.read().await? {
                ToClient::Waiting { ahead } => progress(Progress::Waiting { ahead }),
                ToClient::NoWorkers => progress(Progress::NoWorkers),
                ToClient::Sent { bytes, total } => progress(Progress::Sent { bytes, total }),
                ToClient::Tiles { done, total } if total == grid.tiles() && done <= total => {
                    progress(Progress::Tiles { done, total });
                }
                ToClient::WorkerLost { name, reason } => {
                    let (name, reason) = (plain_text(&name), plain_text(&reason));
                    progress(Progress::WorkerLost { name: &name, reason: &reason });
                }
                ToClient::WorkerRejects { name, reason } => {
                    let (name, reason) = (plain_text(&name), plain_text(&reason));
                    progress(Progress::PackRejected { name: &name, reason: &reason });
                }
                ToClient::Restarted { from, to, dropped } => {
                    let (from, to) = (plain_text(&from), plain_text(&to));
                    progress(Progress::Restarted { from: &from, to: &to, dropped });
                }
                ToClient::Finished { frame: finished } if finished == frame.frame => break,
                ToClient::Failed { frame: failed, reason } if failed == frame.frame => {
                    return Err(ClientError::Failed(reason));
                }
                other => return Err(unexpected(&other)),
            }
        }
        let summary = read_message::<FrameSummary>(&mut self.pipes.bulk_in, limits::HEADER_BYTES).await?;
        let (summary, _) = summary.ok_or_else(|| ClientError::Lost("it ends before the image".into()))?;
        summary.check(&frame).map_err(ClientError::Protocol)?;
        Ok(FrameResult { coding: frame.coding, ..result(summary, pack) })
    }

    async fn write(&mut self, message: FromClient) -> Result<(), ClientError> {
        match write_message(&mut self.pipes.control_out, &message).await {
            Ok(_) => Ok(()),
            Err(error) => Err(self.last_words(error).await),
        }
    }

    async fn read(&mut self) -> Result<ToClient, ClientError> {
        match read_message(&mut self.pipes.control_in, limits::CONTROL_BYTES).await? {
            Some((ToClient::Abort { code, detail }, _)) => {
                Err(ClientError::Cut { code, detail: plain_text(&detail) })
            }
            Some((message, _)) => Ok(message),
            None => Err(ClientError::Lost("the master has closed it".into())),
        }
    }

    /// Why writing has failed with `error`: what the master has said before it stopped reading, if it has.
    async fn last_words(&mut self, error: PipeError) -> ClientError {
        /// What was said before has come, or comes with what tells that writing is over.
        const PATIENCE: Duration = Duration::from_secs(1);
        match timeout(PATIENCE, self.read()).await {
            Ok(Ok(ToClient::PackRejected { reason, .. })) => ClientError::Rejected(reason),
            Ok(Ok(ToClient::Refuse(refusal))) => ClientError::Refused(refusal),
            Ok(Err(cut @ ClientError::Cut { .. })) => cut,
            _ => error.into(),
        }
    }
}

fn unexpected(message: &ToClient) -> ClientError {
    let text = format!("{message:?}");
    let name = text.split([' ', '(']).next().unwrap_or_default();
    ClientError::Protocol(format!("`{name}` does not belong here"))
}

fn result(summary: FrameSummary, pack: PackId) -> FrameResult<()> {
    let [send_scene, render, return_, frame] = summary.times_us.map(Duration::from_micros);
    let [sent, received, udp_sent, udp_received] = summary.traffic;
    let worker = |worker: tessera_wire::WorkerSummary| WorkerReport {
        name: plain_text(&worker.name),
        backend: plain_text(&worker.backend),
        numeric_class: plain_text(&worker.numeric_class),
        note: plain_text(&worker.note),
        round_trip: None,
        tiles: worker.tiles,
        render: Duration::from_micros(worker.render_us),
        bytes_returned: worker.bytes_returned,
        lost: worker.lost.as_deref().map(plain_text),
        rejected: worker.rejected.as_deref().map(plain_text),
    };
    let class = |part: tessera_wire::ClassSummary| ClassPart {
        class: plain_text(&part.class),
        workers: part.workers,
        tiles: part.tiles,
    };
    let difference = |found: tessera_wire::DifferenceSummary| ClassDifference {
        classes: found.classes.map(|class| plain_text(&class)),
        tiles: found.tiles,
        pixels: found.pixels,
        differing: found.differing,
        max_abs: found.max_abs,
        psnr_db: found.psnr_db,
    };
    FrameResult {
        image: (),
        pack: tessera_pack::PackId(pack.0),
        classes: summary.classes.into_iter().map(class).collect(),
        differences: summary.differences.into_iter().map(difference).collect(),
        idle: summary.idle,
        workers: summary.workers.into_iter().map(worker).collect(),
        timings: Timings { send_scene, render, return_, frame },
        traffic: Traffic { sent, received, udp_sent, udp_received },
        master: MasterWork::default(),
        rays: summary.rays,
        dropped_tiles: summary.dropped_tiles,
        coding: Coding::Raw,
        tiles: Vec::new(),
        tile: 0,
        why: None,
    }
}
