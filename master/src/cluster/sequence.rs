//! Frames one after the other, each begun before those before it are complete: while their last tiles return, workers are at its first.

use super::{Cluster, RenderError};
use crate::{
    FrameJob, FrameResult, Progress,
    coordinator::{BeginError, FrameStatus, Group, Outcome},
};
use std::{collections::VecDeque, sync::atomic::Ordering, time::Duration};
use tessera_wire::{FrameId, PackId, limits};
use tokio::time::Instant;

/// How frames follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SequenceConfig {
    /// Groups of workers that render frames by turns, at least one. With as many groups as workers each renders whole frames, and nobody
    /// waits for the last tile of another; a frame takes longer from its begin to its end.
    pub groups: u32,
    /// Frames of a group that are under way at a time, at least one. With one, workers idle while a frame's last tiles are rendered and
    /// return; with two they are at the next meanwhile.
    pub depth: u32,
    /// What becomes of frames when a newer one is there.
    pub stale: Stale,
}

impl Default for SequenceConfig {
    fn default() -> Self {
        Self { groups: 1, depth: 2, stale: Stale::default() }
    }
}

/// What becomes of frames when a newer one is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stale {
    /// They are rendered: all frames of an animation are wanted.
    #[default]
    Render,
    /// Those that have not begun are skipped: the newest pose wins.
    Skip,
    /// Those under way are given up too, their tiles stopped. After that one frame is seen to its end, whatever comes meanwhile: a viewer
    /// who moves faster than frames are rendered sees some nevertheless.
    GiveUp,
}

/// A frame of a sequence.
#[derive(Clone, Debug)]
pub struct SequenceFrame {
    /// Its place in the order of asking, counted from 0; frames that were skipped or given up have one too.
    pub number: u64,
    /// The frame.
    pub result: FrameResult,
    /// From asking to the complete image.
    pub latency: Duration,
}

/// Frames on their way through a cluster, which come out in the order of asking. Dropping it gives up those that are under way.
pub struct FrameQueue<'a> {
    cluster: &'a mut Cluster,
    pack: PackId,
    config: SequenceConfig,
    /// Not begun.
    waiting: VecDeque<Waiting>,
    /// Begun and not taken.
    under_way: VecDeque<UnderWay>,
    asked: u64,
    begun: u32,
    skipped: u64,
    given_up: u64,
    /// Whether a frame was given up since the last was complete.
    is_owed: bool,
}

struct Waiting {
    number: u64,
    job: FrameJob,
    asked: Instant,
}

struct UnderWay {
    number: u64,
    group: u32,
    frame: FrameId,
    asked: Instant,
    /// Once it is complete: with the time from asking.
    done: Option<(Box<Outcome>, Duration)>,
}

impl Cluster {
    /// Renders frames of the loaded pack one after the other, several of which are under way at a time.
    ///
    /// # Errors
    /// No pack is loaded.
    pub fn frames(&mut self, config: SequenceConfig) -> Result<FrameQueue<'_>, RenderError> {
        let pack = self.pack.ok_or(RenderError::NoPack)?;
        let SequenceConfig { groups, depth, stale } = config;
        Ok(FrameQueue {
            cluster: self,
            pack,
            config: SequenceConfig {
                groups: groups.clamp(1, limits::WORKERS as u32),
                depth: depth.clamp(1, limits::FRAMES as u32),
                stale,
            },
            waiting: VecDeque::new(),
            under_way: VecDeque::new(),
            asked: 0,
            begun: 0,
            skipped: 0,
            given_up: 0,
            is_owed: false,
        })
    }

    /// The same for frames that are known beforehand; each is handed to `take` in order.
    ///
    /// # Errors
    /// Those of [`Cluster::render`]; frames before have been taken.
    pub async fn render_sequence(
        &mut self,
        jobs: impl IntoIterator<Item = FrameJob>,
        config: SequenceConfig,
        mut progress: impl FnMut(Progress<'_>),
        mut take: impl FnMut(SequenceFrame),
    ) -> Result<(), RenderError> {
        let mut jobs = jobs.into_iter().fuse();
        let mut frames = self.frames(SequenceConfig { stale: Stale::Render, ..config })?;
        loop {
            while frames.has_room()
                && let Some(job) = jobs.next()
            {
                frames.push(job);
            }
            match frames.next(&mut progress).await? {
                Some(frame) => take(frame),
                None => return Ok(()),
            }
        }
    }
}

impl FrameQueue<'_> {
    /// Asks for a frame. Nothing is sent before [`FrameQueue::next`].
    pub fn push(&mut self, job: FrameJob) {
        if self.config.stale != Stale::Render {
            self.skipped += self.waiting.len() as u64;
            self.waiting.clear();
        }
        if self.config.stale == Stale::GiveUp && !self.is_owed {
            let now = self.cluster.now();
            let before = self.under_way.len();
            self.under_way.retain(|frame| {
                if frame.done.is_none() {
                    self.cluster.coordinator.finish(frame.frame, now);
                }
                frame.done.is_some()
            });
            let given_up = before - self.under_way.len();
            self.given_up += given_up as u64;
            self.is_owed = given_up > 0;
        }
        self.waiting.push_back(Waiting { number: self.asked, job, asked: Instant::now() });
        self.asked += 1;
    }

    /// Whether another frame would begin soon: not more wait than may be under way.
    pub fn has_room(&self) -> bool {
        self.waiting.len() < (self.config.groups * self.config.depth) as usize
    }

    /// Whether all that was asked for has been taken, or will never be there.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty() && self.under_way.is_empty()
    }

    /// Frames that were never begun, as a newer one was there.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Frames that were begun and given up, as a newer one was there.
    pub fn given_up(&self) -> u64 {
        self.given_up
    }

    /// The next frame in the order of asking; `None` when all that was asked for has been taken. Dropping the future does no harm: the
    /// next call goes on.
    ///
    /// # Errors
    /// Those of [`Cluster::render`]; nothing more comes after one.
    pub async fn next(
        &mut self,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<Option<SequenceFrame>, RenderError> {
        loop {
            self.collect()?;
            self.begin()?;
            for event in self.cluster.carry_out() {
                self.cluster.report(event, &mut progress);
            }
            // What was carried out may have completed one.
            self.collect()?;
            match self.under_way.front() {
                Some(UnderWay { done: None, .. }) => self.cluster.wait().await,
                Some(UnderWay { done: Some(_), .. }) => {
                    let Some(UnderWay { number, done: Some((outcome, latency)), .. }) =
                        self.under_way.pop_front()
                    else {
                        continue;
                    };
                    // Its room is another's, and workers are told of it before the caller writes files.
                    self.begin()?;
                    for event in self.cluster.carry_out() {
                        self.cluster.report(event, &mut progress);
                    }
                    let result = self.cluster.result(self.pack, *outcome);
                    return Ok(Some(SequenceFrame { number, result, latency }));
                }
                None if self.waiting.is_empty() => return Ok(None),
                // They are begun in the next turn.
                None => {}
            }
        }
    }

    /// Begins what may be begun.
    fn begin(&mut self) -> Result<(), RenderError> {
        let SequenceConfig { groups, depth, .. } = self.config;
        while let Some(next) = self.waiting.front_mut() {
            let group = self.begun % groups;
            let unfinished = self.under_way.iter().filter(|frame| frame.done.is_none());
            let of_group = unfinished.clone().filter(|frame| frame.group == group).count();
            // (Images that wait for those before them take memory too.)
            if of_group >= depth as usize || self.under_way.len() >= 2 * (groups * depth) as usize {
                return Ok(());
            }
            self.cluster.measure_links();
            // (Chosen once: one that finds no room asks again with every event.)
            next.job = self.cluster.coded(&next.job);
            let job = &next.job;
            let now = self.cluster.now();
            self.cluster.counters.tile_bytes.fetch_max(job.tile_bytes(), Ordering::Relaxed);
            let frame = self.cluster.coordinator.begin_in(job, Group { index: group, count: groups }, now);
            let frame = match frame {
                Err(BeginError::Full) if unfinished.count() > 0 => return Ok(()),
                frame => frame?,
            };
            self.begun = self.begun.wrapping_add(1);
            if let Some(Waiting { number, asked, .. }) = self.waiting.pop_front() {
                self.under_way.push_back(UnderWay { number, group, frame, asked, done: None });
            }
        }
        Ok(())
    }

    /// Takes in what is complete.
    fn collect(&mut self) -> Result<(), RenderError> {
        for frame in self.under_way.iter_mut().filter(|frame| frame.done.is_none()) {
            let coordinator = &mut self.cluster.coordinator;
            let now = self.cluster.begun.elapsed();
            match coordinator.status(frame.frame) {
                FrameStatus::Pending => {}
                FrameStatus::Done => {
                    let latency = frame.asked.elapsed();
                    frame.done = coordinator.finish(frame.frame, now).map(|o| (Box::new(o), latency));
                    self.is_owed = false;
                }
                FrameStatus::NoRoom(no_room) => return Err(BeginError::NoRoom(no_room).into()),
                FrameStatus::Failed { done, total } => {
                    let last = self.cluster.last_lost.clone();
                    return Err(RenderError::AllLost { done, total, last });
                }
            }
        }
        Ok(())
    }
}

impl Drop for FrameQueue<'_> {
    /// The words to the workers go with whatever the cluster does next.
    fn drop(&mut self) {
        let now = self.cluster.now();
        for frame in self.under_way.iter().filter(|frame| frame.done.is_none()) {
            self.cluster.coordinator.finish(frame.frame, now);
        }
    }
}
