//! A master that runs until it is told to end: workers come and go, clients' frames are rendered one after the other.

use crate::{
    Cluster, ClusterConfig, FrameResult, ListenConfig, Progress, RenderError, StartError,
    clients::{self, Job, Reception},
    packs::PackStore,
};
use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};
use tessera_wire::{FrameFailure, JoinString, ToClient, limits, plain_text};
use tokio::{
    sync::{mpsc, watch},
    task::JoinHandle,
    time::timeout,
};

/// How a master serves.
#[derive(Clone, Debug, Default)]
pub struct ServiceConfig {
    /// As in [`ClusterConfig`].
    pub numeric_class: Option<String>,
    /// Whether every frame may mix numeric classes, also those of clients that do not ask for it.
    pub mix: bool,
    /// Bytes that packs of clients and the images that they wait for may take.
    pub pack_bytes: u64,
}

/// A cluster behind a door, with clients.
pub struct Service {
    cluster: Cluster,
    mix: bool,
    jobs: mpsc::Receiver<Job>,
    /// Frames that wait or are rendered.
    frames: Arc<AtomicU32>,
    stopping: watch::Sender<bool>,
    reception: JoinHandle<()>,
}

impl Service {
    /// How long a frame without workers waits for one: a crew that restarts needs seconds, a person who starts one a minute.
    const PATIENCE: Duration = Duration::from_secs(60);

    /// Opens the door, and returns at once with what workers and clients need. Needs a tokio runtime with I/O and time.
    pub fn listen(config: ServiceConfig, at: ListenConfig) -> Result<(Self, JoinString), StartError> {
        let ServiceConfig { numeric_class, mix, pack_bytes } = config;
        let config = ClusterConfig { numeric_class, patience: Self::PATIENCE };
        let (come, guests) = mpsc::channel(limits::CLIENTS);
        let (cluster, join) = Cluster::listen_for_all(config, at, Some(come))?;
        let (queue, jobs) = mpsc::channel(limits::CLIENTS);
        let (stopping, is_stopping) = watch::channel(false);
        let frames = Arc::<AtomicU32>::default();
        let reception = Reception {
            packs: PackStore::new(pack_bytes),
            jobs: queue,
            frames: frames.clone(),
            stopping: is_stopping,
        };
        let reception = tokio::spawn(clients::receive(guests, reception));
        Ok((Self { cluster, mix, jobs, frames, stopping, reception }, join))
    }

    /// Serves until `stop` is ready, then sends everybody home.
    pub async fn run(mut self, stop: impl Future<Output = ()>) {
        /// How long clients may take to read that they get no frame.
        const FAREWELL: Duration = Duration::from_secs(2);
        tokio::pin!(stop);
        loop {
            let mut job = tokio::select! {
                biased;
                () = &mut stop => break,
                Some(job) = self.jobs.recv() => job,
                () = self.cluster.attend(|progress| log(&progress)) => continue,
            };
            job.job.mix |= self.mix;
            let outcome = tokio::select! {
                biased;
                () = &mut stop => Err(FrameFailure::Stopping),
                outcome = perform(&mut self.cluster, &mut job) => outcome,
            };
            let is_stopping = matches!(outcome, Err(FrameFailure::Stopping));
            self.cluster.give_up(|progress| log(&progress));
            self.frames.fetch_sub(1, Ordering::Relaxed);
            // A client that is gone needs no answer.
            let _ = job.done.send(outcome);
            if is_stopping {
                break;
            }
        }
        let _ = self.stopping.send(true);
        self.jobs.close();
        while let Some(job) = self.jobs.recv().await {
            let _ = job.done.send(Err(FrameFailure::Stopping));
        }
        let _ = timeout(FAREWELL, self.reception).await;
        self.cluster.stop().await;
    }
}

/// Renders a client's frame, unless the client goes away.
async fn perform(cluster: &mut Cluster, job: &mut Job) -> Result<FrameResult, FrameFailure> {
    let Job { name, pack, job: frame, tell, done, .. } = job;
    let begun = Instant::now();
    let before = cluster.traffic();
    let tell = |progress: Progress<'_>| {
        log(&progress);
        // What a slow client misses is told by what comes next.
        let _ = message(&progress).map(|message| tell.try_send(message));
    };
    let work = async {
        if !cluster.has_workers() {
            tell(Progress::NoWorkers);
        }
        if timeout(Service::PATIENCE, cluster.until_joined(tell)).await.is_err() {
            let seconds = Service::PATIENCE.as_secs();
            let detail = format!(
                "no worker has joined the master in {seconds} s; start one with `tessera worker --join`"
            );
            return Err(FrameFailure::Crew { detail });
        }
        let crew = |detail: String| FrameFailure::Crew { detail: plain_text(&detail) };
        cluster.load(&pack.pack, tell).await.map_err(|e| crew(e.to_string()))?;
        let result = cluster.render(frame, tell).await.map_err(|e| match e {
            RenderError::Job(e) => FrameFailure::Invalid { detail: e.to_string() },
            RenderError::NoPack | RenderError::AllLost { .. } | RenderError::Output(_) => crew(e.to_string()),
        })?;
        let traffic = result.traffic.since(&before);
        Ok(FrameResult { traffic, ..result })
    };
    let result = tokio::select! {
        // First: a client that went while it waited costs nothing.
        biased;
        () = done.closed() => Err(FrameFailure::Crew { detail: "the client has gone".into() }),
        result = work => result,
    };
    match &result {
        Ok(_) => tracing::info!(
            "rendered {} x {} for {name} in {:.1?}",
            frame.width,
            frame.height,
            begun.elapsed()
        ),
        Err(e) => tracing::info!("no frame for {name} after {:.1?}: {e}", begun.elapsed()),
    }
    result
}

/// One line for each worker that comes, goes, or has no room.
fn log(progress: &Progress<'_>) {
    match progress {
        Progress::WorkerLost { name, reason } => tracing::info!("{name} is gone: {reason}"),
        Progress::PackRejected { name, reason } => tracing::info!("{name} cannot hold the scene: {reason}"),
        Progress::WorkerJoined { .. } | Progress::ClassChosen { .. } => tracing::info!("{progress}"),
        Progress::Restarted { .. } => tracing::warn!("{progress}"),
        Progress::Waiting { .. } | Progress::NoWorkers | Progress::Sent { .. } | Progress::Tiles { .. } => {}
    }
}

fn message(progress: &Progress<'_>) -> Option<ToClient> {
    let texts = |name: &str, reason: &str| (plain_text(name), plain_text(reason));
    Some(match *progress {
        Progress::Waiting { ahead } => ToClient::Waiting { ahead },
        Progress::NoWorkers => ToClient::NoWorkers,
        Progress::Sent { bytes, total } => ToClient::Sent { bytes, total },
        Progress::Tiles { done, total } => ToClient::Tiles { done, total },
        Progress::WorkerLost { name, reason } => {
            let (name, reason) = texts(name, reason);
            ToClient::WorkerLost { name, reason }
        }
        Progress::PackRejected { name, reason } => {
            let (name, reason) = texts(name, reason);
            ToClient::WorkerRejects { name, reason }
        }
        Progress::Restarted { from, to, dropped } => {
            let (from, to) = texts(from, to);
            ToClient::Restarted { from, to, dropped }
        }
        // The summary tells of those that were idle.
        Progress::WorkerJoined { .. } | Progress::ClassChosen { .. } => return None,
    })
}
