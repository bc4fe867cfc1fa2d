//! Many frames of one scene, on whoever holds it.

use super::{CommandError, Held, Session, ended, show};
use crate::commands::progress::Bar;
use std::time::{Duration, Instant};
use tessera_master::{Client, Cluster, FrameJob, Progress, SequenceConfig, SequenceFrame, Stale};
use tokio::sync::mpsc;

/// A frame that is asked for, or why none is any more.
pub type Asked = Result<FrameJob, CommandError>;

/// What frames are rendered.
pub enum Source {
    /// They are known.
    List(std::vec::IntoIter<FrameJob>),
    /// They are asked for as time goes on.
    Stream(mpsc::Receiver<Asked>),
}

impl Source {
    /// The next one; `None` at the end.
    async fn next(&mut self) -> Option<Asked> {
        match self {
            Self::List(jobs) => jobs.next().map(Ok),
            Self::Stream(asked) => asked.recv().await,
        }
    }
}

/// How it went.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rendered {
    /// From the first frame that was asked for to the last image.
    pub took: Duration,
    /// Frames that were never begun, as a newer one was there.
    pub skipped: u64,
    /// Frames that were begun and given up.
    pub given_up: u64,
}

impl Session<'_> {
    /// Renders frames, several at a time on workers of this machine, one after the other at a master elsewhere; `images` takes them in
    /// order. It ends early, and well, when nobody takes them any more.
    pub fn sequence(
        &mut self,
        source: Source,
        config: SequenceConfig,
        images: mpsc::Sender<SequenceFrame>,
    ) -> Result<Rendered, CommandError> {
        let (Some(runtime), Some(held)) = (&self.runtime, &mut self.held) else { return Err(ended()) };
        let bar = self.progress.parts("rendering frames");
        let rendered = runtime.block_on(async {
            match held {
                Held::Local(cluster) => on_cluster(cluster, source, config, images, &bar).await,
                Held::Elsewhere(client, _) => at_master(client, source, config, images, &bar).await,
            }
        });
        self.has_failed = rendered.is_err();
        rendered
    }
}

async fn on_cluster(
    cluster: &mut Cluster,
    mut source: Source,
    config: SequenceConfig,
    images: mpsc::Sender<SequenceFrame>,
    bar: &Bar,
) -> Result<Rendered, CommandError> {
    let mut frames = cluster.frames(config).map_err(CommandError::failed)?;
    let mut begun = None;
    let (mut took, mut is_open, mut asked) = (Duration::ZERO, true, 0);
    while is_open || !frames.is_empty() {
        // Where the newest wins, none waits outside.
        let wants_more = is_open && (config.stale != Stale::Render || frames.has_room());
        let is_empty = frames.is_empty();
        tokio::select! {
            biased;
            job = source.next(), if wants_more => match job {
                Some(job) => {
                    begun.get_or_insert_with(Instant::now);
                    frames.push(job?);
                    asked += 1;
                }
                None => is_open = false,
            },
            frame = frames.next(|event| show_others(bar, &event)), if !is_empty => {
                if let Some(frame) = frame.map_err(CommandError::failed)? {
                    bar.set(frame.number + 1, asked);
                    took = begun.map_or(Duration::ZERO, |begun| begun.elapsed());
                    if images.send(frame).await.is_err() {
                        break;
                    }
                }
            }
        }
    }
    Ok(Rendered { took, skipped: frames.skipped(), given_up: frames.given_up() })
}

/// What happens, but for tiles: those of several frames come mixed.
fn show_others(bar: &Bar, event: &Progress<'_>) {
    if !matches!(event, Progress::Tiles { .. }) {
        show(bar, event);
    }
}

async fn at_master(
    client: &mut Client,
    mut source: Source,
    config: SequenceConfig,
    images: mpsc::Sender<SequenceFrame>,
    bar: &Bar,
) -> Result<Rendered, CommandError> {
    let mut begun = None;
    let mut rendered = Rendered::default();
    let mut number = 0;
    while let Some(asked) = source.next().await {
        let (mut job, mut at) = (asked?, Instant::now());
        let begun = *begun.get_or_insert(at);
        if let (Source::Stream(more), true) = (&mut source, config.stale != Stale::Render) {
            while let Ok(newer) = more.try_recv() {
                (job, at) = (newer?, Instant::now());
                number += 1;
                rendered.skipped += 1;
            }
        }
        let result =
            client.render(&job, |event| show_others(bar, &event)).await.map_err(CommandError::failed)?;
        rendered.took = begun.elapsed();
        if images.send(SequenceFrame { number, result, latency: at.elapsed() }).await.is_err() {
            break;
        }
        number += 1;
    }
    Ok(rendered)
}
