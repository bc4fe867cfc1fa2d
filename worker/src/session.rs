//! A worker's side of the protocol. Pure: messages, finished work and `now` in, [`Action`]s out.

use std::{
    collections::{BTreeSet, VecDeque},
    time::Duration,
};
use tessera_wire::{
    AbortCode, Attempt, BatchHeader, Frame, FrameId, Hello, PackId, PackRefusal, Rays, Rect, Refusal,
    ReturnMode, TileCoding, TileEntry, TileGrid, TileId, ToMaster, ToWorker, Version, limits,
};

/// State of one connection. Times are counted from its start.
#[derive(Clone, Debug)]
pub struct Session {
    phase: Phase,
    /// Whether the master has let this worker in.
    was_welcomed: bool,
    /// Bytes that a pack may take, as far as known.
    memory: Option<u64>,
    holding: Holding,
    /// In the order of beginning.
    frames: Vec<Active>,
    last_frame: FrameId,
    /// Frames that have ended last, at most [`Session::ENDED_KEPT`].
    ended: VecDeque<FrameId>,
    /// Most tiles that are with the renderer at a time.
    ahead: usize,
    /// Tiles that are with the renderer; those too that nobody waits for any more.
    rendering: Vec<Held>,
    /// Whether the worker leaves once the tiles in hand are returned.
    draining: bool,
    /// Batches handed out and not yet sent.
    in_flight: usize,
    actions: VecDeque<Action>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Greeting { deadline: Duration },
    Joined,
    Over,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holding {
    Nothing,
    Reserving(PackId),
    Receiving(PackId),
    Held(PackId),
}

/// A tile that is with the renderer.
#[derive(Clone, Copy, Debug)]
struct Held {
    tile: TileName,
    /// Whether it counts when it is finished: it is neither cancelled nor of a frame that has ended.
    is_wanted: bool,
}

#[derive(Clone, Debug)]
struct Active {
    frame: Frame,
    grid: TileGrid,
    queue: VecDeque<(TileId, Attempt)>,
    /// Tiles of this frame that are with the renderer and wanted.
    in_hand: usize,
    batch: Batch,
    batch_bytes: u64,
    /// Rendered and not yet said so.
    unsaid: u32,
}

/// What the driver has to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Send a message.
    Send(ToMaster),
    /// Forget any pack. If this one is at hand, call [`Session::pack_found`]; else find room for `length` bytes and call
    /// [`Session::pack_reserved`], and if that went well, take them from the bulk pipe and call [`Session::pack_received`].
    Receive {
        /// Which pack.
        pack: PackId,
        /// Its bytes.
        length: u64,
    },
    /// Render a tile, then call [`Session::rendered`]. As many come before that as [`Session::start`] was told; they may be finished in
    /// any order.
    Render(RenderTask),
    /// Nobody waits for these tiles, which are being rendered: stop them, and for each call [`Session::rendering_stopped`], or
    /// [`Session::rendered`] if it is finished. Others go on.
    StopRendering(Vec<TileName>),
    /// Send a batch, then call [`Session::batch_sent`].
    Return(Batch),
    /// Close the connection once everything before is sent.
    Over(Ending),
}

/// What a tile is named by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TileName {
    /// Its frame.
    pub frame: FrameId,
    /// Which of it.
    pub tile: TileId,
    /// As assigned.
    pub attempt: Attempt,
}

/// A tile to be rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderTask {
    /// Its frame, checked.
    pub frame: Frame,
    /// Which tile.
    pub tile: TileId,
    /// As assigned.
    pub attempt: Attempt,
    /// Its pixels.
    pub rect: Rect,
}

impl RenderTask {
    /// What it is named by.
    pub fn name(&self) -> TileName {
        TileName { frame: self.frame.frame, tile: self.tile, attempt: self.attempt }
    }
}

/// A tile that was rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderedTile {
    /// What was asked.
    pub task: RenderTask,
    /// Its pixels in the frame's format.
    pub pixels: Vec<u8>,
    /// Wall time that the renderer had nothing to do before it.
    pub idle: Duration,
    /// Wall time of rendering.
    pub time: Duration,
    /// When it was finished, by the session's clock.
    pub finished: Duration,
    /// Rays traced.
    pub rays: Rays,
}

impl RenderedTile {
    /// A tile that took `time`; of idle time and the clock nothing is known.
    pub fn new(task: RenderTask, pixels: Vec<u8>, time: Duration, rays: Rays) -> Self {
        Self { task, pixels, idle: Duration::ZERO, time, finished: Duration::ZERO, rays }
    }
}

/// A header and the pixels that follow it, one piece a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Announces `pixels`.
    pub header: BatchHeader,
    /// In the header's order, as they were rendered: whoever writes the batch codes them, and completes the header.
    pub pixels: Vec<Vec<u8>>,
    /// When each was finished, by the session's clock.
    pub finished: Vec<Duration>,
    /// Of which frame, which says how they are to be coded.
    pub frame: Frame,
}

/// How a session ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The master has no more work.
    Dismissed,
    /// The worker left.
    Left,
    /// The master does not take this worker.
    Refused(Refusal),
    /// Master or worker cut the connection.
    Aborted {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
}

impl Session {
    /// Frames that have ended are remembered so far back: the master may have said `Cancel` of one of them. It has at most
    /// [`limits::FRAMES`] of them under way, and says no more of a frame that it has ended.
    const ENDED_KEPT: usize = 2 * limits::FRAMES;

    /// A new connection: says `Hello`. Up to `ahead` tiles (at least one) are handed to the renderer before it has finished any: with one it does
    /// nothing while a finished tile is looked after, which matters where looking after takes longer than handing over.
    pub fn start(hello: Hello, memory: Option<u64>, ahead: usize, now: Duration) -> Self {
        Self {
            phase: Phase::Greeting { deadline: now + limits::HANDSHAKE_TIMEOUT },
            was_welcomed: false,
            memory,
            holding: Holding::Nothing,
            frames: Vec::new(),
            last_frame: FrameId(0),
            ended: VecDeque::new(),
            ahead: ahead.max(1),
            rendering: Vec::new(),
            draining: false,
            in_flight: 0,
            actions: VecDeque::from([Action::Send(ToMaster::Hello(hello))]),
        }
    }

    /// What to do next; to be called until `None` after every input.
    pub fn poll(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// When [`Session::tick`] has to be called at the latest.
    pub fn deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::Greeting { deadline } => Some(deadline),
            Phase::Joined | Phase::Over => None,
        }
    }

    /// Whether `Welcome` has come.
    pub fn was_welcomed(&self) -> bool {
        self.was_welcomed
    }

    /// Time has passed.
    pub fn tick(&mut self, now: Duration) {
        if self.deadline().is_some_and(|deadline| now >= deadline) {
            self.abort(AbortCode::Timeout, "no `Welcome` came in time".into());
        }
    }

    /// A message came.
    pub fn message(&mut self, message: ToWorker) {
        match (self.phase, message) {
            (Phase::Over, _) => {}
            (_, ToWorker::Abort { code, detail }) => self.end(Ending::Aborted { code, detail }),
            (_, ToWorker::Dismiss) => self.end(Ending::Dismissed),
            (Phase::Greeting { .. }, ToWorker::Welcome { version, .. }) => {
                self.phase = Phase::Joined;
                self.was_welcomed = true;
                if Version::from_number(version).is_none() {
                    self.abort(AbortCode::Unexpected, format!("version {version} was not offered"));
                }
            }
            (Phase::Greeting { .. }, ToWorker::Refuse(refusal)) => self.end(Ending::Refused(refusal)),
            (Phase::Joined, ToWorker::PackOffer { pack, length }) => self.offer(pack, length),
            (Phase::Joined, ToWorker::Frame(frame)) => self.begin(frame),
            (Phase::Joined, ToWorker::Assign { frame, attempt, tiles }) => {
                self.assign(frame, attempt, &tiles);
            }
            (Phase::Joined, ToWorker::Cancel { frame, tiles }) => self.cancel(frame, &tiles),
            (Phase::Joined, ToWorker::EndFrame { frame }) => self.end_frame(frame),
            (phase, message) => {
                let what = match message {
                    ToWorker::Welcome { .. } => "a second `Welcome`",
                    ToWorker::Refuse(_) => "`Refuse` after `Welcome`",
                    _ => "work before `Welcome`",
                };
                debug_assert_ne!(phase, Phase::Over);
                self.abort(AbortCode::Unexpected, what.into());
            }
        }
    }

    /// The pack that [`Action::Receive`] announced is at hand, checked.
    pub fn pack_found(&mut self, pack: PackId) {
        if self.phase == Phase::Joined && self.holding == Holding::Reserving(pack) {
            self.holding = Holding::Held(pack);
            self.send(ToMaster::PackNeed { pack, have: true });
            self.send(ToMaster::PackReady { pack });
        }
    }

    /// Whether there is room for the pack that [`Action::Receive`] announced.
    pub fn pack_reserved(&mut self, pack: PackId, result: Result<(), PackRefusal>) {
        if self.phase != Phase::Joined || self.holding != Holding::Reserving(pack) {
            return;
        }
        let answer = match result {
            Ok(()) => {
                self.holding = Holding::Receiving(pack);
                ToMaster::PackNeed { pack, have: false }
            }
            Err(reason) => {
                self.holding = Holding::Nothing;
                ToMaster::PackRejected { pack, reason }
            }
        };
        self.send(answer);
    }

    /// The transfer that [`Action::Receive`] asked for has ended.
    pub fn pack_received(&mut self, pack: PackId, result: Result<(), PackRefusal>) {
        if self.phase != Phase::Joined || self.holding != Holding::Receiving(pack) {
            return;
        }
        let answer = match result {
            Ok(()) => {
                self.holding = Holding::Held(pack);
                ToMaster::PackReady { pack }
            }
            Err(reason) => {
                self.holding = Holding::Nothing;
                ToMaster::PackRejected { pack, reason }
            }
        };
        self.send(answer);
    }

    /// A tile that [`Action::Render`] asked for is rendered. It comes to nothing if it was finished before it could be stopped.
    pub fn rendered(&mut self, done: RenderedTile) {
        let is_wanted = self.take_from_renderer(done.task.name());
        if self.phase != Phase::Joined {
            return;
        }
        let frame = done.task.frame.frame;
        if let Some(active) = self.frames.iter_mut().find(|a| is_wanted && a.frame.frame == frame) {
            let (said, batch) = active.take(done);
            self.hand_over(frame, said, batch);
        }
        self.render_next();
    }

    /// One of the tiles that [`Action::StopRendering`] was about is stopped and will not be finished.
    pub fn rendering_stopped(&mut self, tile: TileName) {
        self.take_from_renderer(tile);
        self.render_next();
    }

    /// The renderer is done with a tile: whether anybody waits for it.
    fn take_from_renderer(&mut self, tile: TileName) -> bool {
        let place = self.rendering.iter().position(|held| held.tile == tile);
        place.is_some_and(|place| self.rendering.remove(place).is_wanted)
    }

    /// A batch has been handed to the transport.
    pub fn batch_sent(&mut self) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.render_next();
    }

    /// Ends the session from this side when the tiles in hand are rendered and handed to the transport; others get the rest.
    pub fn drain(&mut self) {
        if self.phase != Phase::Joined {
            return self.leave();
        }
        self.draining = true;
        for active in &mut self.frames {
            active.queue.clear();
        }
        self.flush(|active| active.in_hand == 0);
        self.render_next();
    }

    /// Ends the session from this side, in peace: what is rendered is returned, others get the rest.
    pub fn leave(&mut self) {
        if self.phase != Phase::Over {
            self.flush(|_| true);
            self.send(ToMaster::Leave);
            self.end(Ending::Left);
        }
    }

    /// Ends the session from this side, because something is wrong.
    pub fn abort(&mut self, code: AbortCode, detail: String) {
        if self.phase != Phase::Over {
            self.send(ToMaster::Abort { code, detail: detail.clone() });
            self.end(Ending::Aborted { code, detail });
        }
    }

    fn send(&mut self, message: ToMaster) {
        self.actions.push_back(Action::Send(message));
    }

    fn end(&mut self, ending: Ending) {
        self.phase = Phase::Over;
        self.frames.clear();
        self.actions.push_back(Action::Over(ending));
    }

    fn offer(&mut self, pack: PackId, length: u64) {
        if self.draining {
            return;
        }
        if !self.frames.is_empty() || matches!(self.holding, Holding::Reserving(_) | Holding::Receiving(_)) {
            return self.abort(AbortCode::Unexpected, "a pack is offered in the middle of work".into());
        }
        if self.holding == Holding::Held(pack) {
            self.send(ToMaster::PackNeed { pack, have: true });
            return self.send(ToMaster::PackReady { pack });
        }
        let most = self.memory.unwrap_or(limits::PACK_BYTES).min(limits::PACK_BYTES);
        if length > most {
            let reason = PackRefusal::OutOfMemory { needs: length, has: most };
            return self.send(ToMaster::PackRejected { pack, reason });
        }
        self.holding = Holding::Reserving(pack);
        self.actions.push_back(Action::Receive { pack, length });
    }

    fn begin(&mut self, frame: Frame) {
        if frame.frame <= self.last_frame {
            let detail = format!("frame {} after {}", frame.frame.0, self.last_frame.0);
            return self.abort(AbortCode::Unexpected, detail);
        }
        if self.holding != Holding::Held(frame.pack) {
            let detail = format!("the pack {} is not held", frame.pack);
            return self.abort(AbortCode::BadFrame, detail);
        }
        if self.frames.len() >= limits::FRAMES {
            let detail = format!("frame {} while {} others have not ended", frame.frame.0, limits::FRAMES);
            return self.abort(AbortCode::Unexpected, detail);
        }
        match frame.check() {
            Ok(grid) => {
                self.last_frame = frame.frame;
                self.frames.push(Active::new(frame, grid));
            }
            Err(e) => self.abort(AbortCode::BadFrame, e.to_string()),
        }
    }

    fn assign(&mut self, frame: FrameId, attempt: Attempt, tiles: &[TileId]) {
        let Some(active) = self.frames.iter_mut().find(|active| active.frame.frame == frame) else {
            return self
                .abort(AbortCode::Unexpected, format!("frame {} has not begun, or has ended", frame.0));
        };
        let total = active.grid.tiles();
        let room = (total as usize).saturating_sub(active.queue.len());
        if tiles.is_empty() || tiles.len() > room || tiles.iter().any(|tile| tile.0 >= total) {
            return self.abort(AbortCode::BadTiles, "an assignment that is not of the frame".into());
        }
        if !self.draining {
            active.queue.extend(tiles.iter().map(|&tile| (tile, attempt)));
            self.render_next();
        }
    }

    /// Takes tiles back. What was said to be rendered stays said, so that each tile is counted by one message: those that are counted here
    /// are with the renderer, which may still finish them, or were rendered and not said.
    fn cancel(&mut self, frame: FrameId, tiles: &[TileId]) {
        let Some(active) = self.frames.iter_mut().find(|active| active.frame.frame == frame) else {
            if !self.ended.contains(&frame) {
                self.abort(AbortCode::Unexpected, format!("frame {} has never begun", frame.0));
            }
            return;
        };
        let total = active.grid.tiles();
        if tiles.is_empty() || tiles.iter().any(|tile| tile.0 >= total) {
            return self.abort(AbortCode::BadTiles, "tiles to cancel that are not of the frame".into());
        }
        let named: BTreeSet<_> = tiles.iter().copied().collect();
        let is_named = |tile: TileId| named.contains(&tile);
        let before = active.queue.len();
        active.queue.retain(|&(tile, _)| !is_named(tile));
        let mut cancelled = (before - active.queue.len()) as u32 + active.drop_unsent(is_named);
        let of_it = self
            .rendering
            .iter_mut()
            .filter(|held| held.is_wanted && held.tile.frame == frame && is_named(held.tile.tile));
        let stopped: Vec<_> = of_it
            .map(|held| {
                held.is_wanted = false;
                held.tile
            })
            .collect();
        active.in_hand -= stopped.len();
        cancelled += stopped.len() as u32;
        let list_is_empty = active.queue.is_empty() && active.in_hand == 0;
        if !stopped.is_empty() {
            self.actions.push_back(Action::StopRendering(stopped));
        }
        self.send(ToMaster::Cancelled { frame, tiles: cancelled });
        if list_is_empty {
            // Nothing is finished any more that would send it off.
            self.flush(|active| active.frame.frame == frame);
        }
        self.render_next();
    }

    /// Forgets a frame, and stops those of its tiles that are being rendered.
    fn end_frame(&mut self, frame: FrameId) {
        let Some(place) = self.frames.iter().position(|active| active.frame.frame == frame) else {
            return self
                .abort(AbortCode::Unexpected, format!("frame {} has not begun, or has ended", frame.0));
        };
        self.frames.remove(place);
        self.ended.push_back(frame);
        if self.ended.len() > Self::ENDED_KEPT {
            self.ended.pop_front();
        }
        let mut stopped = Vec::new();
        for held in self.rendering.iter_mut().filter(|held| held.tile.frame == frame && held.is_wanted) {
            held.is_wanted = false;
            stopped.push(held.tile);
        }
        if !stopped.is_empty() {
            self.actions.push_back(Action::StopRendering(stopped));
        }
        // Those of other frames may have waited behind its.
        self.render_next();
    }

    /// Returns what was kept for later of the frames that are `due`.
    fn flush(&mut self, due: impl Fn(&Active) -> bool) {
        let mut flushed = Vec::new();
        for active in self.frames.iter_mut().filter(|active| due(active)) {
            let (said, batch) = active.flush();
            flushed.push((active.frame.frame, said, batch));
        }
        for (frame, said, batch) in flushed {
            self.hand_over(frame, said, batch);
        }
    }

    /// Says that so many tiles of the frame are rendered, and returns pixels.
    fn hand_over(&mut self, frame: FrameId, said: Option<u32>, batch: Option<Batch>) {
        // The word goes first: the next tile's number travels while this one's pixels do.
        if let Some(tiles) = said {
            self.send(ToMaster::Rendered { frame, tiles });
        }
        if let Some(batch) = batch {
            self.in_flight += 1;
            self.actions.push_back(Action::Return(batch));
        }
    }

    /// Hands the renderer as many tiles as it may have while the transport keeps up, those of earlier frames first; leaves if it has had the
    /// last one. Nothing new is begun with [`limits::BATCHES_IN_FLIGHT`] on their way; each of the tiles begun before may become a batch
    /// more.
    fn render_next(&mut self) {
        if self.draining && self.rendering.is_empty() && self.in_flight == 0 {
            return self.leave();
        }
        for active in &mut self.frames {
            while self.rendering.len() < self.ahead && self.in_flight < limits::BATCHES_IN_FLIGHT {
                let Some((tile, attempt)) = active.queue.pop_front() else { break };
                // `assign` has checked the tile.
                let Some(rect) = active.grid.rect(tile) else { break };
                let task = RenderTask { frame: active.frame, tile, attempt, rect };
                self.rendering.push(Held { tile: task.name(), is_wanted: true });
                active.in_hand += 1;
                self.actions.push_back(Action::Render(task));
            }
        }
    }
}

impl Active {
    fn new(frame: Frame, grid: TileGrid) -> Self {
        let batch = Batch::new(&frame);
        Self { frame, grid, queue: VecDeque::new(), in_hand: 0, batch, batch_bytes: 0, unsaid: 0 }
    }

    /// Adds a tile to the batch: how many tiles are now to be said rendered, and the batch if it is to go.
    fn take(&mut self, done: RenderedTile) -> (Option<u32>, Option<Batch>) {
        self.batch_bytes += done.pixels.len() as u64;
        self.batch.header.tiles.push(TileEntry {
            tile: done.task.tile,
            attempt: done.task.attempt,
            // `Frame::check` keeps a tile's bytes far below 2^32.
            length: done.pixels.len() as u32,
            coding: TileCoding::Raw,
            pixel_bytes: done.pixels.len() as u32,
            idle_us: micros(done.idle),
            render_us: micros(done.time),
            coding_us: 0,
            waited_us: 0,
            rays: done.rays,
        });
        self.batch.pixels.push(done.pixels);
        self.batch.finished.push(done.finished);
        self.unsaid += 1;
        self.in_hand = self.in_hand.saturating_sub(1);
        let list_is_empty = self.queue.is_empty() && self.in_hand == 0;
        let full = self.batch.pixels.len() >= limits::TILES as usize;
        let (say, go) = match self.frame.returns {
            ReturnMode::AtEnd => (list_is_empty, list_is_empty || full),
            ReturnMode::Every { tiles } => {
                let is_due = list_is_empty || full || self.batch.pixels.len() >= tiles as usize;
                (is_due, is_due)
            }
            ReturnMode::Batches { min_bytes } => {
                (true, list_is_empty || full || self.batch_bytes >= u64::from(min_bytes))
            }
        };
        let said = say.then(|| std::mem::take(&mut self.unsaid));
        (said, go.then(|| self.take_batch()))
    }

    /// Drops tiles that are rendered and not handed to the transport; how many of them were not said to be rendered.
    fn drop_unsent(&mut self, is_named: impl Fn(TileId) -> bool) -> u32 {
        let mut dropped = 0;
        let mut place = 0;
        while let Some(entry) = self.batch.header.tiles.get(place) {
            if !is_named(entry.tile) {
                place += 1;
                continue;
            }
            self.batch_bytes -= u64::from(entry.length);
            self.batch.header.tiles.remove(place);
            self.batch.pixels.remove(place);
            self.batch.finished.remove(place);
            dropped += 1;
        }
        match self.frame.returns {
            // All of the batch's are unsaid, but for those of batches that were full.
            ReturnMode::AtEnd | ReturnMode::Every { .. } => {
                self.unsaid -= dropped;
                dropped
            }
            // Each was said when it was finished.
            ReturnMode::Batches { .. } => 0,
        }
    }

    /// What was kept for later: tiles to be said rendered, and pixels.
    fn flush(&mut self) -> (Option<u32>, Option<Batch>) {
        let said = (self.unsaid > 0).then(|| std::mem::take(&mut self.unsaid));
        (said, (!self.batch.pixels.is_empty()).then(|| self.take_batch()))
    }

    fn take_batch(&mut self) -> Batch {
        self.batch_bytes = 0;
        std::mem::replace(&mut self.batch, Batch::new(&self.frame))
    }
}

impl Batch {
    fn new(frame: &Frame) -> Self {
        let header = BatchHeader { frame: frame.frame, tiles: Vec::new() };
        Self { header, pixels: Vec::new(), finished: Vec::new(), frame: *frame }
    }
}

/// As [`TileEntry`] has times.
pub(crate) fn micros(time: Duration) -> u32 {
    u32::try_from(time.as_micros()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests;
