//! A worker's side of the protocol. Pure: messages, finished work and `now` in, [`Action`]s out.

use std::{collections::VecDeque, time::Duration};
use tessera_wire::{
    AbortCode, Attempt, BatchHeader, Frame, FrameId, Hello, PackId, PackRefusal, Rays, Rect, Refusal,
    ReturnMode, TileEntry, TileGrid, TileId, ToMaster, ToWorker, Version, limits,
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
    frame: Option<Active>,
    last_frame: FrameId,
    /// Whether a tile is being rendered; one at a time, with all threads.
    rendering: bool,
    /// Whether the worker leaves once the tile in hand is returned.
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

#[derive(Clone, Debug)]
struct Active {
    frame: Frame,
    grid: TileGrid,
    queue: VecDeque<(TileId, Attempt)>,
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
    /// Render a tile, then call [`Session::rendered`]. The next comes only after that.
    Render(RenderTask),
    /// Nobody waits for the tile that is being rendered: stop it and call [`Session::rendering_stopped`], unless it is finished.
    StopRendering,
    /// Send a batch, then call [`Session::batch_sent`].
    Return(Batch),
    /// Close the connection once everything before is sent.
    Over(Ending),
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

/// A tile that was rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderedTile {
    /// What was asked.
    pub task: RenderTask,
    /// Its pixels in the frame's format.
    pub pixels: Vec<u8>,
    /// Wall time.
    pub time: Duration,
    /// Rays traced.
    pub rays: Rays,
}

/// A header and the pixels that follow it, one piece a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Announces `pixels`.
    pub header: BatchHeader,
    /// In the header's order.
    pub pixels: Vec<Vec<u8>>,
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
    /// A new connection: says `Hello`.
    pub fn start(hello: Hello, memory: Option<u64>, now: Duration) -> Self {
        Self {
            phase: Phase::Greeting { deadline: now + limits::HANDSHAKE_TIMEOUT },
            was_welcomed: false,
            memory,
            holding: Holding::Nothing,
            frame: None,
            last_frame: FrameId(0),
            rendering: false,
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
            (Phase::Joined, ToWorker::EndFrame { frame }) => {
                if self.frame.as_ref().is_some_and(|active| active.frame.frame == frame) {
                    self.frame = None;
                    if self.rendering {
                        self.actions.push_back(Action::StopRendering);
                    }
                } else {
                    self.abort(AbortCode::Unexpected, format!("frame {} is not the current one", frame.0));
                }
            }
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

    /// The tile that [`Action::Render`] asked for is rendered.
    pub fn rendered(&mut self, done: RenderedTile) {
        self.rendering = false;
        if self.phase != Phase::Joined {
            return;
        }
        if let Some(active) = self.frame.as_mut().filter(|a| a.frame.frame == done.task.frame.frame) {
            let (said, batch) = active.take(done);
            self.hand_over(said, batch);
        }
        self.render_next();
    }

    /// What [`Action::StopRendering`] asked for is done.
    pub fn rendering_stopped(&mut self) {
        self.rendering = false;
        self.render_next();
    }

    /// A batch has been handed to the transport.
    pub fn batch_sent(&mut self) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.render_next();
    }

    /// Ends the session from this side when the tile in hand is rendered and handed to the transport; others get the rest.
    pub fn drain(&mut self) {
        if self.phase != Phase::Joined {
            return self.leave();
        }
        self.draining = true;
        if let Some(active) = &mut self.frame {
            active.queue.clear();
            if !self.rendering {
                self.flush();
            }
        }
        self.render_next();
    }

    /// Ends the session from this side, in peace: what is rendered is returned, others get the rest.
    pub fn leave(&mut self) {
        if self.phase != Phase::Over {
            self.flush();
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
        self.frame = None;
        self.actions.push_back(Action::Over(ending));
    }

    fn offer(&mut self, pack: PackId, length: u64) {
        if self.draining {
            return;
        }
        if self.frame.is_some() || matches!(self.holding, Holding::Reserving(_) | Holding::Receiving(_)) {
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
        match frame.check() {
            Ok(grid) => {
                self.last_frame = frame.frame;
                self.frame = Some(Active::new(frame, grid));
            }
            Err(e) => self.abort(AbortCode::BadFrame, e.to_string()),
        }
    }

    fn assign(&mut self, frame: FrameId, attempt: Attempt, tiles: &[TileId]) {
        let Some(active) = self.frame.as_mut().filter(|active| active.frame.frame == frame) else {
            return self.abort(AbortCode::Unexpected, format!("frame {} is not the current one", frame.0));
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

    /// Returns what was kept for later.
    fn flush(&mut self) {
        if let Some(active) = &mut self.frame {
            let (said, batch) = active.flush();
            self.hand_over(said, batch);
        }
    }

    /// Says that so many tiles of the frame are rendered, and returns pixels.
    fn hand_over(&mut self, said: Option<u32>, batch: Option<Batch>) {
        let Some(frame) = self.frame.as_ref().map(|active| active.frame.frame) else { return };
        // The word goes first: the next tile's number travels while this one's pixels do.
        if let Some(tiles) = said {
            self.send(ToMaster::Rendered { frame, tiles });
        }
        if let Some(batch) = batch {
            self.in_flight += 1;
            self.actions.push_back(Action::Return(batch));
        }
    }

    /// Starts on the next tile if nothing is being rendered and the transport keeps up; leaves if that was the last one.
    fn render_next(&mut self) {
        if self.draining && !self.rendering && self.in_flight == 0 {
            return self.leave();
        }
        if self.rendering || self.in_flight >= limits::BATCHES_IN_FLIGHT {
            return;
        }
        let Some(active) = &mut self.frame else { return };
        let Some((tile, attempt)) = active.queue.pop_front() else { return };
        // `assign` has checked the tile.
        let Some(rect) = active.grid.rect(tile) else { return };
        self.rendering = true;
        self.actions.push_back(Action::Render(RenderTask { frame: active.frame, tile, attempt, rect }));
    }
}

impl Active {
    fn new(frame: Frame, grid: TileGrid) -> Self {
        let batch = Batch::new(frame.frame);
        Self { frame, grid, queue: VecDeque::new(), batch, batch_bytes: 0, unsaid: 0 }
    }

    /// Adds a tile to the batch: how many tiles are now to be said rendered, and the batch if it is to go.
    fn take(&mut self, done: RenderedTile) -> (Option<u32>, Option<Batch>) {
        self.batch_bytes += done.pixels.len() as u64;
        self.batch.header.tiles.push(TileEntry {
            tile: done.task.tile,
            attempt: done.task.attempt,
            // `Frame::check` keeps a tile's bytes far below 2^32.
            length: done.pixels.len() as u32,
            render_us: u32::try_from(done.time.as_micros()).unwrap_or(u32::MAX),
            rays: done.rays,
        });
        self.batch.pixels.push(done.pixels);
        self.unsaid += 1;
        let list_is_empty = self.queue.is_empty();
        let full = self.batch.pixels.len() >= limits::TILES as usize;
        let (say, go) = match self.frame.returns {
            ReturnMode::AtEnd => (list_is_empty, list_is_empty || full),
            ReturnMode::Batches { min_bytes } => {
                (true, list_is_empty || full || self.batch_bytes >= u64::from(min_bytes))
            }
        };
        let said = say.then(|| std::mem::take(&mut self.unsaid));
        (said, go.then(|| self.take_batch()))
    }

    /// What was kept for later: tiles to be said rendered, and pixels.
    fn flush(&mut self) -> (Option<u32>, Option<Batch>) {
        let said = (self.unsaid > 0).then(|| std::mem::take(&mut self.unsaid));
        (said, (!self.batch.pixels.is_empty()).then(|| self.take_batch()))
    }

    fn take_batch(&mut self) -> Batch {
        self.batch_bytes = 0;
        std::mem::replace(&mut self.batch, Batch::new(self.frame.frame))
    }
}

impl Batch {
    fn new(frame: FrameId) -> Self {
        Self { header: BatchHeader { frame, tiles: Vec::new() }, pixels: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::{Abilities, Camera, Features, PixelFormat, Role, Token, WorkerId};

    const PACK: PackId = PackId([7; 32]);

    fn hello() -> Hello {
        Hello {
            versions: Version::supported_numbers(),
            token: Token::default(),
            name: "w".into(),
            role: Role::Worker(Abilities {
                memory: 0,
                threads: 1,
                backend: "cpu".into(),
                numeric_class: "cpu-1".into(),
                speed: 0,
                note: String::new(),
            }),
        }
    }

    fn frame(id: u64, returns: ReturnMode) -> Frame {
        Frame {
            frame: FrameId(id),
            pack: PACK,
            camera: Camera {
                origin: [0.0; 3],
                forward: [0.0, 0.0, -1.0],
                right: [1.0, 0.0, 0.0],
                up: [0.0, 1.0, 0.0],
            },
            width: 4,
            height: 4,
            tile: 2,
            samples: 1,
            depth: 0,
            seed: 0,
            features: Features::default(),
            format: PixelFormat::Rgba8,
            returns,
        }
    }

    fn actions(s: &mut Session) -> Vec<Action> {
        std::iter::from_fn(|| s.poll()).collect()
    }

    fn joined(memory: Option<u64>) -> Session {
        let mut s = Session::start(hello(), memory, Duration::ZERO);
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::Hello(hello()))]);
        s.message(ToWorker::Welcome { version: 3, worker: WorkerId(0) });
        assert_eq!((actions(&mut s), s.deadline()), (vec![], None));
        s
    }

    fn loaded() -> Session {
        let mut s = joined(None);
        s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
        assert_eq!(actions(&mut s), [Action::Receive { pack: PACK, length: 5 }]);
        s.pack_reserved(PACK, Ok(()));
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackNeed { pack: PACK, have: false })]);
        s.pack_received(PACK, Ok(()));
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackReady { pack: PACK })]);
        s
    }

    fn assign(s: &mut Session, id: u64, tiles: impl IntoIterator<Item = u32>) {
        let tiles = tiles.into_iter().map(TileId).collect();
        s.message(ToWorker::Assign { frame: FrameId(id), attempt: Attempt(0), tiles });
    }

    /// Renders everything that is asked for; what was said and returned, in order: `r` for `Rendered`, a
    /// number for a batch of so many tiles.
    fn run(s: &mut Session) -> String {
        let mut log = String::new();
        while let Some(action) = s.poll() {
            match action {
                Action::Render(task) => {
                    let pixels = vec![0; (task.rect.width * task.rect.height * 4) as usize];
                    let time = Duration::from_millis(1);
                    s.rendered(RenderedTile { task, pixels, time, rays: Rays::default() });
                }
                Action::Send(ToMaster::Rendered { .. }) => log.push('r'),
                Action::Return(batch) => {
                    batch.header.check().unwrap();
                    log += &batch.pixels.len().to_string();
                    s.batch_sent();
                }
                other => panic!("{other:?}"),
            }
        }
        log
    }

    fn check_aborted(s: &mut Session, code: AbortCode) {
        let all = actions(s);
        let (over, abort) = (all.last(), &all[all.len() - 2]);
        assert!(matches!(over, Some(Action::Over(Ending::Aborted { code: c, .. })) if *c == code), "{all:?}");
        assert!(matches!(abort, Action::Send(ToMaster::Abort { code: c, .. }) if *c == code), "{all:?}");
        s.message(ToWorker::Dismiss);
        s.leave();
        assert_eq!(actions(s), []);
    }

    #[test]
    fn tiles_return_as_the_frame_asks() {
        let check = |returns, expected| {
            let mut s = loaded();
            s.message(ToWorker::Frame(frame(1, returns)));
            assign(&mut s, 1, 0..4);
            assert_eq!(run(&mut s), expected);
        };
        check(ReturnMode::AtEnd, "r4");
        check(ReturnMode::Batches { min_bytes: 0 }, "r1r1r1r1");
        check(ReturnMode::Batches { min_bytes: 32 }, "rr2rr2");
        check(ReturnMode::Batches { min_bytes: 33 }, "rrr3r1");
    }

    #[test]
    fn rendering_waits_for_a_slow_transport() {
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 0 })));
        assign(&mut s, 1, 0..4);
        let mut renders = 0;
        let mut returns = 0;
        while let Some(action) = s.poll() {
            match action {
                Action::Render(task) => {
                    renders += 1;
                    let rays = Rays::default();
                    s.rendered(RenderedTile { task, pixels: vec![0; 16], time: Duration::ZERO, rays });
                }
                Action::Return(_) => returns += 1,
                _ => {}
            }
        }
        assert_eq!((renders, returns), (2, limits::BATCHES_IN_FLIGHT));
        s.batch_sent();
        assert!(matches!(actions(&mut s)[..], [Action::Render(_)]));
    }

    #[test]
    fn the_end_of_a_frame_drops_what_is_left_of_it() {
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
        assign(&mut s, 1, 0..4);
        let Some(Action::Render(task)) = s.poll() else { panic!("nothing to render") };
        s.message(ToWorker::EndFrame { frame: FrameId(1) });
        s.message(ToWorker::Frame(frame(2, ReturnMode::AtEnd)));
        assign(&mut s, 2, [3]);
        assert_eq!(actions(&mut s), [Action::StopRendering], "the renderer is still busy");
        // It may have been finished before it was stopped.
        let mut finished = s.clone();
        let (time, rays) = (Duration::ZERO, Rays::default());
        finished.rendered(RenderedTile { task, pixels: vec![0; 16], time, rays });
        assert_eq!(run(&mut finished), "r1");
        s.rendering_stopped();
        assert_eq!(run(&mut s), "r1");
        s.message(ToWorker::EndFrame { frame: FrameId(2) });
        assert_eq!(actions(&mut s), [], "nothing is being rendered");
    }

    #[test]
    fn a_drained_worker_returns_the_tile_in_hand_and_what_it_has_kept_and_leaves() {
        let leaves = [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)];
        let finish = |s: &mut Session, task| {
            let (time, rays) = (Duration::ZERO, Rays::default());
            s.rendered(RenderedTile { task, pixels: vec![0; 16], time, rays });
        };
        for returns in [ReturnMode::AtEnd, ReturnMode::Batches { min_bytes: 1000 }] {
            let mut s = loaded();
            s.message(ToWorker::Frame(frame(1, returns)));
            assign(&mut s, 1, 0..4);
            let Some(Action::Render(first)) = s.poll() else { panic!("nothing to render") };
            finish(&mut s, first);
            let mut all = actions(&mut s);
            let Some(Action::Render(second)) = all.pop() else { panic!("nothing to render") };
            s.drain();
            assign(&mut s, 1, [3]);
            assert_eq!(actions(&mut s), [], "it is at a tile");
            finish(&mut s, second);
            let mut all = actions(&mut s);
            let Some(Action::Return(batch)) = all.pop() else { panic!("nothing returned: {all:?}") };
            assert_eq!(batch.header.tiles.iter().map(|t| t.tile.0).collect::<Vec<_>>(), [0, 1]);
            assert!(matches!(all[..], [Action::Send(ToMaster::Rendered { .. })]), "{all:?}");
            s.batch_sent();
            assert_eq!(actions(&mut s), leaves);
        }
        // Nothing is being rendered, as the transport does not keep up; something is kept for the next batch.
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 17 })));
        assign(&mut s, 1, [0]);
        let Some(Action::Render(task)) = s.poll() else { panic!("nothing to render") };
        s.in_flight = limits::BATCHES_IN_FLIGHT;
        assign(&mut s, 1, [1]);
        finish(&mut s, task);
        assert!(matches!(actions(&mut s)[..], [Action::Send(ToMaster::Rendered { tiles: 1, .. })]));
        s.drain();
        assert!(matches!(&actions(&mut s)[..], [Action::Return(batch)] if batch.pixels.len() == 1));
        for _ in 0..limits::BATCHES_IN_FLIGHT {
            s.batch_sent();
            assert_eq!(actions(&mut s), []);
        }
        s.batch_sent();
        assert_eq!(actions(&mut s), leaves);

        let mut s = loaded();
        s.drain();
        assert_eq!(actions(&mut s), leaves, "it has no work");
        let mut s = Session::start(hello(), None, Duration::ZERO);
        actions(&mut s);
        s.drain();
        assert_eq!(actions(&mut s), leaves, "it has not even joined");
    }

    #[test]
    fn packs_are_refused_kept_and_replaced() {
        let mut s = joined(Some(100));
        s.message(ToWorker::PackOffer { pack: PACK, length: 101 });
        let reason = PackRefusal::OutOfMemory { needs: 101, has: 100 };
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
        let mut s = joined(None);
        s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
        actions(&mut s);
        let reason = PackRefusal::OutOfMemory { needs: 5, has: 0 };
        s.pack_reserved(PACK, Err(reason.clone()));
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
        let mut s = joined(None);
        s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
        actions(&mut s);
        s.pack_found(PACK);
        let have = Action::Send(ToMaster::PackNeed { pack: PACK, have: true });
        assert_eq!(actions(&mut s), [have, Action::Send(ToMaster::PackReady { pack: PACK })]);
        let mut s = joined(None);
        s.message(ToWorker::PackOffer { pack: PACK, length: u64::MAX });
        assert!(matches!(actions(&mut s)[..], [Action::Send(ToMaster::PackRejected { .. })]));

        let mut s = loaded();
        s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
        let have = Action::Send(ToMaster::PackNeed { pack: PACK, have: true });
        assert_eq!(actions(&mut s), [have, Action::Send(ToMaster::PackReady { pack: PACK })]);
        let other = PackId([1; 32]);
        s.message(ToWorker::PackOffer { pack: other, length: 5 });
        actions(&mut s);
        s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
        check_aborted(&mut s, AbortCode::BadFrame);

        let mut s = joined(None);
        s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
        s.pack_reserved(PACK, Ok(()));
        actions(&mut s);
        let reason = PackRefusal::HashMismatch { got: other };
        s.pack_received(PACK, Err(reason.clone()));
        assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
    }

    #[test]
    fn what_the_state_does_not_allow_ends_the_session() {
        let end = ToWorker::EndFrame { frame: FrameId(1) };
        let tiles = |list: &[u32]| ToWorker::Assign {
            frame: FrameId(1),
            attempt: Attempt(0),
            tiles: list.iter().copied().map(TileId).collect(),
        };
        let check = |s: Session, messages: &[ToWorker], code| {
            let mut s = s;
            messages.iter().for_each(|m| s.message(m.clone()));
            check_aborted(&mut s, code);
        };
        let first = ToWorker::Frame(frame(1, ReturnMode::AtEnd));
        let welcome = |version| ToWorker::Welcome { version, worker: WorkerId(0) };
        let new = || Session::start(hello(), None, Duration::ZERO);
        check(new(), std::slice::from_ref(&end), AbortCode::Unexpected);
        check(new(), &[welcome(1)], AbortCode::Unexpected);
        check(new(), &[welcome(9)], AbortCode::Unexpected);
        check(joined(None), &[welcome(2)], AbortCode::Unexpected);
        let refusal = Refusal::NumericClass { expected: "gpu-1".into() };
        check(joined(None), &[ToWorker::Refuse(refusal)], AbortCode::Unexpected);
        check(joined(None), std::slice::from_ref(&first), AbortCode::BadFrame);
        check(loaded(), &[end], AbortCode::Unexpected);
        check(loaded(), &[tiles(&[0])], AbortCode::Unexpected);
        check(loaded(), &[first.clone(), first.clone()], AbortCode::Unexpected);
        check(loaded(), &[first.clone(), tiles(&[])], AbortCode::BadTiles);
        check(loaded(), &[first.clone(), tiles(&[4])], AbortCode::BadTiles);
        check(loaded(), &[first.clone(), tiles(&[0, 1, 2, 3, 0])], AbortCode::BadTiles);
        let offer = ToWorker::PackOffer { pack: PACK, length: 1 };
        check(loaded(), &[first, offer], AbortCode::Unexpected);
        let mut wild = frame(1, ReturnMode::AtEnd);
        wild.camera.forward[0] = f32::NAN;
        check(loaded(), &[ToWorker::Frame(wild)], AbortCode::BadFrame);
    }

    #[test]
    fn endings() {
        let mut s = Session::start(hello(), None, Duration::ZERO);
        actions(&mut s);
        s.tick(limits::HANDSHAKE_TIMEOUT - Duration::from_nanos(1));
        assert_eq!(actions(&mut s), []);
        s.tick(limits::HANDSHAKE_TIMEOUT);
        check_aborted(&mut s, AbortCode::Timeout);

        let mut s = Session::start(hello(), None, Duration::ZERO);
        actions(&mut s);
        let refusal = Refusal::Version { supported: vec![9] };
        s.message(ToWorker::Refuse(refusal.clone()));
        assert_eq!(actions(&mut s), [Action::Over(Ending::Refused(refusal))]);

        let mut s = loaded();
        s.message(ToWorker::Dismiss);
        assert_eq!(actions(&mut s), [Action::Over(Ending::Dismissed)]);

        let leaves = [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)];
        let mut s = loaded();
        s.leave();
        assert_eq!(actions(&mut s), leaves);

        // The second tile takes too long: the first is not thrown away.
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
        assign(&mut s, 1, [0, 1]);
        let Some(Action::Render(first)) = s.poll() else { panic!("nothing to render") };
        let (time, rays) = (Duration::ZERO, Rays::default());
        s.rendered(RenderedTile { task: first, pixels: vec![0; 16], time, rays });
        assert!(matches!(actions(&mut s)[..], [Action::Render(_)]));
        s.drain();
        assert_eq!(actions(&mut s), []);
        s.leave();
        let last = actions(&mut s);
        let [Action::Send(ToMaster::Rendered { tiles: 1, .. }), Action::Return(batch), rest @ ..] = &last[..]
        else {
            panic!("{last:?}")
        };
        assert!(batch.header.tiles[0].tile == first.tile && *rest == leaves);
    }
}
