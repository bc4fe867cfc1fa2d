//! All workers and the current frame together. Pure: what came in and `now` go in, [`Output`]s come out.
//!
//! A whole cluster runs in one thread under a virtual clock this way; `Cluster` is the same thing with
//! sockets.

use crate::{
    FrameBuffer, FrameJob, Timings, WorkerReport,
    dispatch::{Assignment, Dispatch, Violation},
    image::NoRoom,
    session::{Session, Step},
};
use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};
use tessera_wire::{
    AbortCode, Frame, FrameError, FrameId, PackId, PackRefusal, Rays, Refusal, TileEntry, TileGrid, ToMaster,
    ToWorker, WorkerId, limits,
};

/// What the driver has to do, or to know.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Send a message.
    Send(WorkerId, ToWorker),
    /// Send the bytes of the pack.
    SendPack(WorkerId, PackId),
    /// Close the connection once everything before is sent.
    Close(WorkerId, AbortCode),
    /// Tell.
    Event(Event),
}

/// What has happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A worker has joined.
    Joined(WorkerId),
    /// A connection is over, joined or not; the reason is for people.
    Lost(WorkerId, String),
    /// A worker holds the pack on offer.
    PackHeld(WorkerId),
    /// A worker cannot hold it.
    PackRejected(WorkerId, PackRefusal),
    /// Another tile is in the image.
    Tile {
        /// So far.
        done: u32,
        /// Of the frame.
        total: u32,
    },
}

/// How the current frame stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStatus {
    /// No frame, or not complete.
    Pending,
    /// Every tile is in.
    Done,
    /// No worker is left, and none has come in time; `done` of `total` tiles are in.
    Failed {
        /// Tiles in.
        done: u32,
        /// Tiles of the frame.
        total: u32,
    },
}

/// Why a frame does not begin.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BeginError {
    /// The job is out of range.
    #[error(transparent)]
    Job(#[from] FrameError),
    /// Its image does not fit this machine.
    #[error(transparent)]
    NoRoom(#[from] NoRoom),
}

/// A complete frame; what the driver adds to it becomes a [`crate::FrameResult`].
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The image.
    pub image: FrameBuffer,
    /// Those who took part.
    pub workers: Vec<WorkerReport>,
    /// Without `send_scene`.
    pub timings: Timings,
    /// Of the tiles in the image.
    pub rays: Rays,
    /// Results dropped.
    pub dropped_tiles: u64,
}

/// The master's whole state.
#[derive(Debug, Default)]
pub struct Coordinator {
    numeric_class: Option<String>,
    /// Of connections that are not over.
    sessions: BTreeMap<WorkerId, Session>,
    /// Of the next connection.
    next: u32,
    /// On offer to all.
    pack: Option<Offer>,
    frame: Option<Active>,
    /// What frames before have used up of the time that workers may be silent (see [`Dispatch::worn`]).
    worn: BTreeMap<WorkerId, f64>,
    frames_begun: u64,
    /// How long a frame waits for a worker when it has none.
    patience: Duration,
    outputs: VecDeque<Output>,
}

/// A pack that every worker is asked to take.
#[derive(Clone, Copy, Debug)]
struct Offer {
    pack: PackId,
    length: u64,
    begun: Duration,
    /// Until when those that have not answered are waited for, where one holds it and others may take part later.
    until: Option<Duration>,
    is_settled: bool,
}

#[derive(Debug)]
struct Active {
    frame: Frame,
    grid: TileGrid,
    dispatch: Dispatch,
    image: FrameBuffer,
    rays: Rays,
    reports: Vec<(WorkerId, WorkerReport)>,
    /// Until when the next tile of a worker must be in, for as long as it owes pixels.
    due: BTreeMap<WorkerId, Duration>,
    late: u64,
    /// Until when a frame without workers waits for one.
    alone: Option<Duration>,
    given_up: bool,
    begun: Duration,
    last_rendered: Duration,
    completed: Option<Duration>,
}

impl Coordinator {
    /// No workers yet. `numeric_class`: what all must have; `None` leaves it to the first to join.
    pub fn new(numeric_class: Option<String>) -> Self {
        Self { numeric_class, ..Self::default() }
    }

    /// The same, for a cluster that workers join at any time: a frame whose last worker is lost waits for one so long before it fails.
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// What to do next; to be called until `None` after every input.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Coordinator::tick`] has to be called at the latest.
    pub fn deadline(&self) -> Option<Duration> {
        let frame = self.frame.iter().filter_map(Active::deadline);
        let load = self.pack.filter(|_| self.is_loading()).and_then(|offer| offer.until);
        self.sessions.values().filter_map(Session::deadline).chain(frame).chain(load).min()
    }

    /// The arithmetic of the cluster, once settled.
    pub fn numeric_class(&self) -> Option<&str> {
        self.numeric_class.as_deref()
    }

    /// The name of a worker that has joined and is not gone.
    pub fn name(&self, worker: WorkerId) -> Option<&str> {
        self.sessions.get(&worker)?.name()
    }

    /// Workers that have joined and neither left nor are lost.
    pub fn joined(&self) -> impl Iterator<Item = WorkerId> {
        self.sessions.iter().filter(|(_, session)| session.abilities().is_some()).map(|(&worker, _)| worker)
    }

    /// Workers that hold the pack on offer.
    pub fn holders(&self) -> impl Iterator<Item = WorkerId> {
        let pack = self.pack;
        let holds = move |session: &Session| pack.is_some_and(|offer| session.holds(offer.pack));
        self.sessions.iter().filter(move |(_, session)| holds(session)).map(|(&worker, _)| worker)
    }

    /// Whether a worker may still ask for the bytes of `pack`.
    pub fn is_wanted(&self, pack: PackId) -> bool {
        self.sessions.values().any(|session| session.awaits(pack))
    }

    /// Whether workers that have not yet said if they take the pack on offer are waited for.
    ///
    /// Where workers join at any time, one that holds it is enough: the others have twice the time that the first took, and take part
    /// once they hold it.
    pub fn is_loading(&self) -> bool {
        self.pack.is_some_and(|offer| !offer.is_settled) && self.is_awaited()
    }

    fn is_awaited(&self) -> bool {
        self.sessions.values().any(Session::awaits_pack)
    }

    /// A connection was made, and is safe to talk over.
    pub fn connected(&mut self, now: Duration) -> WorkerId {
        let worker = WorkerId(self.next);
        self.next += 1;
        self.sessions.insert(worker, Session::new(worker, now));
        worker
    }

    /// A message came.
    pub fn message(&mut self, worker: WorkerId, message: ToMaster, now: Duration) {
        let class = self.numeric_class.clone();
        self.with_session(worker, now, |session| session.message(message, class.as_deref(), now));
    }

    /// The pixels of a tile came; they and their share of headers took `wire_bytes`.
    pub fn tile(
        &mut self,
        worker: WorkerId,
        frame: FrameId,
        entry: &TileEntry,
        pixels: &[u8],
        wire_bytes: u64,
        now: Duration,
    ) {
        if self.name(worker).is_none() {
            // Gone, perhaps for good reason; its tiles are with others.
            return;
        }
        let Some(active) = self.frame.as_mut().filter(|active| active.frame.frame == frame) else {
            return self.out_of_frame(worker, frame, now);
        };
        match active.tile(worker, entry, pixels, wire_bytes, now) {
            Ok(true) => {
                let (done, total) = (active.dispatch.done(), active.dispatch.total());
                self.outputs.push_back(Output::Event(Event::Tile { done, total }));
            }
            Ok(false) => {}
            Err(detail) => self.abort(worker, AbortCode::BadTiles, detail, now),
        }
    }

    /// Nothing more comes on the bulk pipe of `worker`.
    pub fn bulk_ended(&mut self, worker: WorkerId, now: Duration) {
        self.with_session(worker, now, Session::bulk_ended);
    }

    /// The connection of `worker` broke, its process ended, or what it sent does not decode.
    pub fn lost(&mut self, worker: WorkerId, code: AbortCode, reason: String, now: Duration) {
        self.with_session(worker, now, |session| session.end(code, reason));
    }

    /// What `worker` sends is wrong: it is told so, and cut off.
    pub fn abort(&mut self, worker: WorkerId, code: AbortCode, detail: String, now: Duration) {
        self.with_session(worker, now, |session| session.abort(code, detail));
    }

    /// `worker`, which has not been answered yet, may not join.
    pub fn refuse(&mut self, worker: WorkerId, refusal: Refusal, now: Duration) {
        self.with_session(worker, now, |session| session.refuse(refusal));
    }

    /// Time has passed.
    pub fn tick(&mut self, now: Duration) {
        for worker in self.ids() {
            self.with_session(worker, now, |session| session.tick(now));
        }
        if let Some(offer) = &mut self.pack {
            offer.is_settled |= offer.until.is_some_and(|until| until <= now);
        }
        let is_awaited = self.is_awaited();
        let Some(active) = &mut self.frame else { return };
        if active.alone.is_some_and(|until| until <= now) && !active.given_up {
            // A worker that takes the pack, or says that it does not, has a deadline of its own.
            active.given_up = !is_awaited;
            active.alone = Some(now + self.patience);
        }
        let owing = active.due().filter(|&(_, due)| due <= now).map(|(worker, _)| worker);
        let owing: Vec<_> = owing.collect();
        let stalled: Vec<_> = active.dispatch.stalled(now).collect();
        let assignments = active.dispatch.tick(now);
        self.assign(assignments);
        for worker in owing {
            let detail = "the pixels of rendered tiles did not come in time";
            self.abort(worker, AbortCode::Timeout, detail.into(), now);
        }
        for worker in stalled {
            let detail = "it has stalled: no tile was finished in time";
            self.abort(worker, AbortCode::Timeout, detail.into(), now);
        }
    }

    /// Offers a pack of `length` bytes to every worker, also to those that join later; later frames are of it.
    pub fn load(&mut self, pack: PackId, length: u64, now: Duration) {
        self.pack = Some(Offer { pack, length, begun: now, until: None, is_settled: false });
        for worker in self.ids() {
            self.with_session(worker, now, |session| session.offer(pack, length, now));
        }
    }

    /// Begins a frame of the loaded pack with all workers that hold it; those that hold it later take part from then on.
    ///
    /// # Errors
    /// The job is out of range, or its image too large for this machine. Without a loaded pack or holders the frame begins, and fails
    /// unless a worker comes in time.
    pub fn begin(&mut self, job: &FrameJob, now: Duration) -> Result<FrameId, BeginError> {
        let id = FrameId(self.frames_begun + 1);
        let frame = job.to_wire(id, self.pack.map_or(PackId([0; 32]), |offer| offer.pack));
        let grid = frame.check()?;
        let image = FrameBuffer::new(job.width, job.height, job.format)?;
        self.frames_begun += 1;
        let workers: Vec<_> = self.holders().collect();
        let report =
            |worker| (worker, WorkerReport::new(self.name(worker).unwrap_or("?"), self.rejection(worker)));
        let reports =
            self.joined().filter(|w| workers.contains(w) || self.rejection(*w).is_some()).map(report);
        let reports = reports.collect();
        let (mut dispatch, assignments) = Dispatch::start(&grid, job.balance, job.samples, &workers, now);
        for (&worker, &worn) in &self.worn {
            dispatch.wear(worker, worn);
        }
        self.frame = Some(Active {
            frame,
            grid,
            dispatch,
            image,
            rays: Rays::default(),
            reports,
            due: BTreeMap::new(),
            late: 0,
            alone: workers.is_empty().then_some(now + self.patience),
            given_up: workers.is_empty() && self.patience.is_zero(),
            begun: now,
            last_rendered: now,
            completed: None,
        });
        for worker in workers {
            self.outputs.push_back(Output::Send(worker, ToWorker::Frame(frame)));
        }
        self.assign(assignments);
        Ok(id)
    }

    /// How the current frame stands.
    pub fn status(&self) -> FrameStatus {
        match &self.frame {
            Some(active) if active.dispatch.is_done() => FrameStatus::Done,
            Some(active) if active.given_up => {
                FrameStatus::Failed { done: active.dispatch.done(), total: active.dispatch.total() }
            }
            _ => FrameStatus::Pending,
        }
    }

    /// Ends the current frame, complete or not; the outcome if it is complete.
    pub fn finish(&mut self, now: Duration) -> Option<Outcome> {
        let active = self.frame.take()?;
        self.worn.extend(active.dispatch.worn(now));
        let frame = active.frame.frame;
        for &(worker, ref report) in &active.reports {
            if self.name(worker).is_some() && report.rejected.is_none() {
                self.outputs.push_back(Output::Send(worker, ToWorker::EndFrame { frame }));
            }
        }
        active.outcome()
    }

    /// Sends every worker home.
    pub fn dismiss(&mut self, now: Duration) {
        for worker in self.ids() {
            self.with_session(worker, now, Session::dismiss);
        }
    }

    fn ids(&self) -> impl Iterator<Item = WorkerId> + use<> {
        self.sessions.keys().copied().collect::<Vec<_>>().into_iter()
    }

    fn assign(&mut self, assignments: Vec<Assignment>) {
        let Some(active) = &self.frame else { return };
        for Assignment { worker, attempt, tiles } in assignments {
            let assign = ToWorker::Assign { frame: active.frame.frame, attempt, tiles };
            self.outputs.push_back(Output::Send(worker, assign));
        }
    }

    /// `worker` lives: what it says may be of an earlier frame.
    fn heard(&mut self, worker: WorkerId) {
        self.worn.remove(&worker);
        if let Some(active) = &mut self.frame {
            active.dispatch.wear(worker, 0.0);
        }
    }

    /// A message about a frame that is not the current one: old ones are late, others never were.
    fn out_of_frame(&mut self, worker: WorkerId, frame: FrameId, now: Duration) {
        self.heard(worker);
        if frame.0 == 0 || frame.0 > self.frames_begun {
            self.abort(worker, AbortCode::BadTiles, format!("there is no frame {}", frame.0), now);
        } else if let Some(active) = &mut self.frame {
            active.late += 1;
        }
    }

    fn with_session(&mut self, worker: WorkerId, now: Duration, act: impl FnOnce(&mut Session) -> Vec<Step>) {
        if let Some(session) = self.sessions.get_mut(&worker) {
            let steps = act(session);
            self.take(worker, steps, now);
        }
    }

    fn take(&mut self, worker: WorkerId, steps: Vec<Step>, now: Duration) {
        for step in steps {
            match step {
                Step::Send(message) => self.outputs.push_back(Output::Send(worker, message)),
                Step::SendPack(pack) => self.outputs.push_back(Output::SendPack(worker, pack)),
                Step::Joined => {
                    if let Some(abilities) = self.sessions.get(&worker).and_then(Session::abilities) {
                        self.numeric_class.get_or_insert_with(|| abilities.numeric_class.clone());
                    }
                    self.outputs.push_back(Output::Event(Event::Joined(worker)));
                    if let (Some(offer), Some(session)) = (self.pack, self.sessions.get_mut(&worker)) {
                        let steps = session.offer(offer.pack, offer.length, now);
                        self.take(worker, steps, now);
                    }
                }
                Step::PackHeld => {
                    self.wait_no_longer(now);
                    self.outputs.push_back(Output::Event(Event::PackHeld(worker)));
                    self.join_frame(worker, now);
                }
                Step::PackRejected(reason) => {
                    self.outputs.push_back(Output::Event(Event::PackRejected(worker, reason)));
                }
                Step::Rendered { frame, tiles } => self.rendered(worker, frame, tiles, now),
                Step::Leaving => {
                    if let Some(active) = &mut self.frame {
                        active.dispatch.leave(worker);
                    }
                }
                Step::Over { code, reason } => {
                    self.sessions.remove(&worker);
                    self.worn.remove(&worker);
                    self.outputs.push_back(Output::Close(worker, code));
                    self.over(worker, reason, now);
                }
            }
        }
    }

    fn rendered(&mut self, worker: WorkerId, frame: FrameId, tiles: u32, now: Duration) {
        let current = self.frame.as_mut().filter(|active| active.frame.frame == frame);
        let Some(active) = current else {
            self.heard(worker);
            if frame.0 == 0 || frame.0 > self.frames_begun {
                self.abort(worker, AbortCode::Unexpected, format!("there is no frame {}", frame.0), now);
            }
            return;
        };
        match active.dispatch.rendered(worker, tiles, now) {
            Ok(assignments) => {
                active.last_rendered = now;
                active.due.insert(worker, now + limits::RETURN_TIMEOUT);
                self.assign(assignments);
            }
            Err(violation) => self.abort(worker, AbortCode::Unexpected, violation.to_string(), now),
        }
    }

    /// Settles until when the others are waited for, once one holds the pack.
    fn wait_no_longer(&mut self, now: Duration) {
        /// The others have this at least: one that finds the pack on its disk first does not leave behind those that are sent it.
        const LEAST: Duration = Duration::from_secs(1);
        if let Some(offer) = self.pack.as_mut().filter(|_| !self.patience.is_zero()) {
            let took = now.saturating_sub(offer.begun);
            offer.until.get_or_insert(offer.begun + LEAST.max(2 * took));
        }
    }

    /// A worker that has just taken the pack takes part in the frame of it that is under way.
    fn join_frame(&mut self, worker: WorkerId, now: Duration) {
        let name = self.name(worker).unwrap_or("?").to_string();
        let holds = |active: &&mut Active| {
            let session = self.sessions.get(&worker);
            session.is_some_and(|s| s.holds(active.frame.pack)) && !active.dispatch.is_done()
        };
        let Some(active) = self.frame.as_mut().filter(holds) else { return };
        active.reports.push((worker, WorkerReport::new(&name, None)));
        active.alone = None;
        self.outputs.push_back(Output::Send(worker, ToWorker::Frame(active.frame)));
        let assignments = active.dispatch.join(worker, now);
        active.dispatch.wear(worker, self.worn.get(&worker).copied().unwrap_or(0.0));
        self.assign(assignments);
    }

    fn rejection(&self, worker: WorkerId) -> Option<&PackRefusal> {
        self.sessions.get(&worker)?.rejection()
    }

    fn over(&mut self, worker: WorkerId, reason: String, now: Duration) {
        if let Some(active) = &mut self.frame {
            if let Some((_, report)) = active.reports.iter_mut().find(|(w, _)| *w == worker) {
                report.lost = Some(reason.clone());
            }
            let assignments = active.dispatch.lost(worker, now);
            if active.dispatch.workers() == 0 && active.alone.is_none() {
                active.alone = Some(now + self.patience);
                active.given_up = self.patience.is_zero() && !active.dispatch.is_done();
            }
            self.assign(assignments);
        }
        self.outputs.push_back(Output::Event(Event::Lost(worker, reason)));
    }
}

impl Active {
    /// Puts a tile into the image: whether it was the first for its place, or what is wrong with it.
    fn tile(
        &mut self,
        worker: WorkerId,
        entry: &TileEntry,
        pixels: &[u8],
        wire_bytes: u64,
        now: Duration,
    ) -> Result<bool, String> {
        let not_there = Violation::NotAssigned { tile: entry.tile.0, attempt: entry.attempt.0 };
        let rect = self.grid.rect(entry.tile).ok_or_else(|| not_there.to_string())?;
        let expected =
            u64::from(rect.width) * u64::from(rect.height) * self.image.format().bytes_per_pixel() as u64;
        if pixels.len() as u64 != expected {
            return Err(format!("tile {} has {} bytes instead of {expected}", entry.tile.0, pixels.len()));
        }
        let first = self
            .dispatch
            .accept(worker, entry.tile, entry.attempt, now)
            .map_err(|violation| violation.to_string())?;
        let report = self.reports.iter_mut().find(|(w, _)| *w == worker).map(|(_, report)| report);
        if let Some(report) = report {
            report.bytes_returned += wire_bytes;
            if first {
                report.tiles += 1;
                report.render += Duration::from_micros(entry.render_us.into());
            }
        }
        if first {
            self.image.put(rect.x, rect.y, rect.width, rect.height, pixels).map_err(|e| e.to_string())?;
            self.rays += entry.rays;
            self.due.insert(worker, now + limits::RETURN_TIMEOUT);
            if self.dispatch.is_done() {
                self.completed = Some(now);
            }
        }
        Ok(first)
    }

    fn deadline(&self) -> Option<Duration> {
        if self.dispatch.is_done() || self.given_up {
            return None;
        }
        let returns = self.due().map(|(_, due)| due);
        returns.chain(self.dispatch.deadline()).chain(self.alone).min()
    }

    /// Workers that owe pixels, and until when the next tile of each must be in.
    fn due(&self) -> impl Iterator<Item = (WorkerId, Duration)> {
        self.due.iter().map(|(&worker, &due)| (worker, due)).filter(|&(worker, _)| self.dispatch.owes(worker))
    }

    fn outcome(self) -> Option<Outcome> {
        let completed = self.completed?;
        // Pixels may overtake the word that they are rendered: then rendering has hidden the return entirely.
        let rendered = if self.dispatch.all_rendered() { self.last_rendered } else { completed };
        let since_begin = |time: Duration| time.saturating_sub(self.begun);
        let timings = Timings {
            send_scene: Duration::ZERO,
            render: since_begin(rendered),
            return_: completed.saturating_sub(rendered),
            frame: since_begin(completed),
        };
        Some(Outcome {
            image: self.image,
            workers: self.reports.into_iter().map(|(_, report)| report).collect(),
            timings,
            rays: self.rays,
            dropped_tiles: self.dispatch.dropped() + self.late,
        })
    }
}

impl WorkerReport {
    fn new(name: &str, rejected: Option<&PackRefusal>) -> Self {
        let rejected = rejected.map(ToString::to_string);
        Self { name: name.into(), tiles: 0, render: Duration::ZERO, bytes_returned: 0, lost: None, rejected }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::{Abilities, Hello, Role, Token, Version};

    fn hello() -> ToMaster {
        let abilities =
            Abilities { memory: 0, threads: 1, backend: "cpu".into(), numeric_class: "cpu-1".into() };
        let versions = Version::supported_numbers();
        ToMaster::Hello(Hello {
            versions,
            token: Token::default(),
            name: "w".into(),
            role: Role::Worker(abilities),
        })
    }

    #[test]
    fn connections_that_are_over_are_forgotten() {
        let mut coordinator = Coordinator::new(Some("cpu-1".into()));
        coordinator.load(PackId([1; 32]), 10, Duration::ZERO);
        for number in 0..1000 {
            let worker = coordinator.connected(Duration::ZERO);
            // Some never join, and some are refused.
            match number % 3 {
                0 => {}
                1 => coordinator.refuse(worker, Refusal::Full { limit: 1 }, Duration::ZERO),
                _ => coordinator.message(worker, hello(), Duration::ZERO),
            }
            coordinator.lost(worker, AbortCode::Done, "gone".into(), Duration::ZERO);
            let told = std::iter::from_fn(|| coordinator.poll())
                .filter(|output| matches!(output, Output::Event(Event::Lost(lost, _)) if *lost == worker));
            assert_eq!(told.count(), 1, "{number}");
        }
        assert_eq!((coordinator.sessions.len(), coordinator.deadline()), (0, None));
        assert_eq!(coordinator.worn.len(), 0);
    }
}
