//! All workers and the frames that they render together. Pure: what came in and `now` go in, [`Output`]s come out.
//!
//! A whole cluster runs in one thread under a virtual clock this way; `Cluster` is the same thing with
//! sockets.

mod active;
mod crew;

use crate::{
    ClassDifference, ClassPart, FrameBuffer, FrameJob, TileRecord, Timings, WorkerReport,
    dispatch::{Assignment, Knowledge},
    image::NoRoom,
    session::{Session, Step},
};
use active::Active;
use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};
use tessera_wire::{
    AbortCode, Coding, FrameError, FrameId, PackId, PackRefusal, Rays, Refusal, TileEntry, TileId, ToMaster,
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
    /// A frame begins with the workers of one numeric class, and others hold the pack too.
    ClassChosen {
        /// The class.
        class: String,
        /// Workers of it.
        workers: u32,
        /// Workers of others, which have no part.
        idle: u32,
    },
    /// The last worker of a frame's class was lost, and another class begins it again.
    Restarted {
        /// The frame.
        frame: FrameId,
        /// The class before.
        from: String,
        /// The class now.
        to: String,
        /// Tiles that were in the image.
        dropped: u32,
    },
    /// The next rows of the image from the top are complete, in a frame that [`Coordinator::begin_rows`] has begun: whole rows without
    /// padding. After [`Event::Restarted`] they begin at the top again.
    Rows(FrameId, Vec<u8>),
    /// Another tile is in the image.
    Tile {
        /// Of this frame.
        frame: FrameId,
        /// So far.
        done: u32,
        /// Of the frame.
        total: u32,
    },
}

/// How a frame stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStatus {
    /// No such frame, or not complete.
    Pending,
    /// Every tile is in, and what classes of a mix are compared by.
    Done,
    /// Rows that wait for those above them do not fit the memory that is left.
    NoRoom(NoRoom),
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
    /// Its workers have begun as many others as they may; it can be begun when one of these is finished.
    #[error("the workers have begun as many frames as they may")]
    Full,
}

/// Workers that render frames of their own: of those that a frame may have, each `count`th in the order of joining.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Group {
    /// Counted from 0; what is `count` or more counts on from 0 again.
    pub index: u32,
    /// Groups, at least one.
    pub count: u32,
}

/// A complete frame; what the driver adds to it becomes a [`crate::FrameResult`].
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The rows that have not been given out by [`Event::Rows`]: all of the image, or none.
    pub image: FrameBuffer,
    /// Classes of its tiles, those with most first.
    pub classes: Vec<ClassPart>,
    /// How far they differ.
    pub differences: Vec<ClassDifference>,
    /// Holders of the pack that are of other classes.
    pub idle: u32,
    /// Those who took part.
    pub workers: Vec<WorkerReport>,
    /// Without `send_scene`.
    pub timings: Timings,
    /// Of the tiles in the image.
    pub rays: Rays,
    /// Results dropped.
    pub dropped_tiles: u64,
    /// How its pixels travelled.
    pub coding: Coding,
    /// Every result; `worker` counts in `workers`.
    pub tiles: Vec<TileRecord>,
    /// Side of its tiles.
    pub tile: u32,
    /// How many there are.
    pub count: u32,
    /// Why it was balanced as it was, for `auto`.
    pub why: Option<String>,
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
    /// In the order of their numbers at the workers, which is that in which these render them.
    frames: Vec<Active>,
    /// What frames before have used up of the time that workers may be silent (see [`Dispatch::worn`]).
    worn: BTreeMap<WorkerId, f64>,
    frames_begun: u64,
    /// What frames before have shown.
    known: Knowledge,
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

impl Coordinator {
    /// Frames that a worker has begun when it is given no more new ones: what others leave behind finds room with it.
    pub const FRAMES: usize = limits::FRAMES - 2;

    /// No workers yet. `numeric_class`: what all must have; `None` takes workers of any class, of which one renders each frame unless
    /// its job says otherwise.
    pub fn new(numeric_class: Option<String>) -> Self {
        Self { numeric_class, ..Self::default() }
    }

    /// The same, for a cluster that workers join at any time: a frame whose last worker is lost waits for one so long before it fails.
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// Forgets what frames have shown of workers, tiles and links.
    pub fn forget(&mut self) {
        self.known = Knowledge::default();
    }

    /// A round trip to `worker` takes so long now.
    pub fn round_trip(&mut self, worker: WorkerId, time: Duration) {
        if self.name(worker).is_some() {
            self.known.round_trip(worker, time);
        }
    }

    /// What to do next; to be called until `None` after every input.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Coordinator::tick`] has to be called at the latest.
    pub fn deadline(&self) -> Option<Duration> {
        let frame = self.frames.iter().filter_map(Active::deadline);
        let load = self.pack.filter(|_| self.is_loading()).and_then(|offer| offer.until);
        self.sessions.values().filter_map(Session::deadline).chain(frame).chain(load).min()
    }

    /// The name of a worker that has joined and is not gone.
    pub fn name(&self, worker: WorkerId) -> Option<&str> {
        self.sessions.get(&worker)?.name()
    }

    /// The numeric class of a worker that has joined and neither left nor is lost.
    pub fn class_of(&self, worker: WorkerId) -> Option<&str> {
        Some(&self.sessions.get(&worker)?.abilities()?.numeric_class)
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
        let Some(at) = self.numbered(frame) else { return self.out_of_frame(worker, frame, now) };
        self.heard(worker);
        let active = &mut self.frames[at];
        if let Some((bytes, time)) = active.came(worker, wire_bytes, now) {
            self.known.transfer(bytes, time);
        }
        match active.tile(worker, entry, pixels, wire_bytes, now) {
            Ok(true) => {
                let id = active.id;
                while let Some(rows) = active.due_rows() {
                    self.outputs.push_back(Output::Event(Event::Rows(id, rows)));
                }
                let others = active.dispatch.other_holders(entry.tile, worker);
                let (done, total) = (active.dispatch.done(), active.dispatch.total());
                self.outputs.push_back(Output::Event(Event::Tile { frame: id, done, total }));
                self.cancel(at, others.into_iter().map(|other| (other, vec![entry.tile])));
                if done == total {
                    let comparisons = self.frames[at].compare_classes(now);
                    self.assign(at, comparisons);
                }
            }
            Ok(false) => {}
            Err(detail) => return self.abort(worker, AbortCode::BadTiles, detail, now),
        }
        if self.frames[at].is_settled() {
            self.judge(now);
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
        let (mut owing, mut stalled) = (Vec::new(), Vec::new());
        for at in 0..self.frames.len() {
            let active = &mut self.frames[at];
            active.tick(now);
            if active.alone.is_some_and(|until| until <= now) && !active.given_up {
                // A worker that takes the pack, or says that it does not, has a deadline of its own.
                active.given_up = !is_awaited;
                active.alone = Some(now + self.patience);
            }
            if active.is_judged {
                owing.extend(active.due().filter(|&(_, due)| due <= now).map(|(worker, _)| worker));
                stalled.extend(active.dispatch.stalled(now));
                let assignments = active.dispatch.tick(now);
                self.assign(at, assignments);
            }
        }
        self.judge(now);
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

    /// Begins a frame of the loaded pack with the workers that hold it, of the numeric class that is the fastest together, or of all
    /// classes if the job may mix them; those of them that hold it later take part from then on. When the last of the class is lost,
    /// another class begins the frame again.
    ///
    /// Others that have begun go on, and their tiles are rendered first.
    ///
    /// # Errors
    /// The job is out of range, or its image too large for this machine, or too many others have begun. Without a loaded pack or holders the
    /// frame begins, and fails unless a worker comes in time.
    pub fn begin(&mut self, job: &FrameJob, now: Duration) -> Result<FrameId, BeginError> {
        self.begin_as(job, None, false, now)
    }

    /// The same with the workers of `group` alone, or with all while there is none in it. When the last of them is lost, the others of the
    /// class go on with the frame.
    ///
    /// # Errors
    /// Those of [`Coordinator::begin`].
    pub fn begin_in(&mut self, job: &FrameJob, group: Group, now: Duration) -> Result<FrameId, BeginError> {
        self.begin_as(job, Some(group), false, now)
    }

    /// The same as [`Coordinator::begin`], but rows are given out by [`Event::Rows`] as soon as they and all above them are complete, and
    /// are held no longer. A frame that may mix classes is held whole nevertheless: its tiles are looked at again when classes are
    /// compared.
    ///
    /// # Errors
    /// Those of [`Coordinator::begin`].
    pub fn begin_rows(&mut self, job: &FrameJob, now: Duration) -> Result<FrameId, BeginError> {
        self.begin_as(job, None, !job.mix, now)
    }

    /// How a frame stands.
    pub fn status(&self, frame: FrameId) -> FrameStatus {
        match self.frames.iter().find(|active| active.id == frame) {
            Some(Active { no_room: Some(no_room), .. }) => FrameStatus::NoRoom(*no_room),
            Some(active) if active.is_over() => FrameStatus::Done,
            Some(active) if active.given_up => {
                FrameStatus::Failed { done: active.dispatch.done(), total: active.dispatch.total() }
            }
            _ => FrameStatus::Pending,
        }
    }

    /// Frames that have begun and are not finished.
    pub fn begun(&self) -> impl Iterator<Item = FrameId> {
        self.frames.iter().map(|active| active.id)
    }

    /// Ends a frame, complete or not: workers stop what they render of it. The outcome if it is complete.
    pub fn finish(&mut self, frame: FrameId, now: Duration) -> Option<Outcome> {
        let place = self.frames.iter().position(|active| active.id == frame)?;
        let active = self.frames.remove(place);
        if active.is_judged {
            self.worn.extend(active.dispatch.worn(now));
        }
        active.teach(&mut self.known);
        let number = active.frame.frame;
        for &worker in &active.members {
            if self.name(worker).is_some() {
                self.outputs.push_back(Output::Send(worker, ToWorker::EndFrame { frame: number }));
            }
        }
        let idle = self.holders().filter(|&w| self.class_of(w).is_some_and(|class| !active.takes(class)));
        let idle = idle.count() as u32;
        // A frame that nobody had room for may go on.
        self.revive(now);
        self.judge(now);
        active.outcome(idle)
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

    fn assign(&mut self, at: usize, assignments: Vec<Assignment>) {
        let frame = self.frames[at].frame.frame;
        for Assignment { worker, attempt, tiles } in assignments {
            let assign = ToWorker::Assign { frame, attempt, tiles };
            self.outputs.push_back(Output::Send(worker, assign));
        }
    }

    /// Takes back tiles that others have rendered.
    fn cancel(&mut self, at: usize, tiles: impl IntoIterator<Item = (WorkerId, Vec<TileId>)>) {
        for (worker, tiles) in tiles {
            let cancel = self.frames[at].cancel(worker, tiles);
            self.outputs.push_back(Output::Send(worker, cancel));
        }
    }

    /// The place of the frame that workers know by this number.
    fn numbered(&self, frame: FrameId) -> Option<usize> {
        self.frames.iter().position(|active| active.frame.frame == frame)
    }

    /// `worker` lives: what it says may be of any frame.
    fn heard(&mut self, worker: WorkerId) {
        self.worn.remove(&worker);
        for active in &mut self.frames {
            active.dispatch.wear(worker, 0.0);
        }
    }

    /// Pixels of a frame that is not under way: old ones are late, others never were.
    fn out_of_frame(&mut self, worker: WorkerId, frame: FrameId, now: Duration) {
        self.heard(worker);
        if frame.0 == 0 || frame.0 > self.frames_begun {
            self.abort(worker, AbortCode::BadTiles, format!("there is no frame {}", frame.0), now);
        } else if let Some(active) = self.frames.first_mut() {
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
                    self.outputs.push_back(Output::Event(Event::Joined(worker)));
                    if let (Some(offer), Some(session)) = (self.pack, self.sessions.get_mut(&worker)) {
                        let steps = session.offer(offer.pack, offer.length, now);
                        self.take(worker, steps, now);
                    }
                }
                Step::PackHeld => {
                    self.wait_no_longer(now);
                    self.outputs.push_back(Output::Event(Event::PackHeld(worker)));
                    self.join_frames(worker, now);
                }
                Step::PackRejected(reason) => {
                    self.outputs.push_back(Output::Event(Event::PackRejected(worker, reason)));
                }
                Step::Rendered { frame, tiles } => self.rendered(worker, frame, tiles, now),
                Step::Cancelled { frame, tiles } => self.cancelled(worker, frame, tiles, now),
                Step::Leaving => {
                    for active in &mut self.frames {
                        active.dispatch.leave(worker);
                    }
                }
                Step::Over { code, reason } => {
                    self.sessions.remove(&worker);
                    self.worn.remove(&worker);
                    self.known.forget(worker);
                    self.outputs.push_back(Output::Close(worker, code));
                    self.over(worker, reason, now);
                }
            }
        }
    }

    fn rendered(&mut self, worker: WorkerId, frame: FrameId, tiles: u32, now: Duration) {
        self.heard(worker);
        let Some(at) = self.said_of(worker, frame, now) else { return };
        let active = &mut self.frames[at];
        match active.dispatch.rendered(worker, tiles, now) {
            Ok(assignments) => {
                active.last_rendered = now;
                active.word(worker, now);
                active.due.insert(worker, now + limits::RETURN_TIMEOUT);
                self.assign(at, assignments);
            }
            Err(violation) => self.abort(worker, AbortCode::Unexpected, violation.to_string(), now),
        }
    }

    fn cancelled(&mut self, worker: WorkerId, frame: FrameId, tiles: u32, now: Duration) {
        let Some(at) = self.said_of(worker, frame, now) else { return };
        match self.frames[at].cancelled(worker, tiles, now) {
            Ok(assignments) => self.assign(at, assignments),
            Err(detail) => self.abort(worker, AbortCode::Unexpected, detail, now),
        }
    }

    /// The place of the frame of which `worker` has said something, if it is under way; one that never was is the worker's fault.
    fn said_of(&mut self, worker: WorkerId, frame: FrameId, now: Duration) -> Option<usize> {
        let at = self.numbered(frame);
        if at.is_none() && (frame.0 == 0 || frame.0 > self.frames_begun) {
            self.abort(worker, AbortCode::Unexpected, format!("there is no frame {}", frame.0), now);
        }
        at
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
}

#[cfg(test)]
mod tests;
