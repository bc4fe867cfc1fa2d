//! A whole cluster in one thread under a virtual clock: both sides' state machines, late, lost and repeated
//! messages, workers that die, stall, leave and join late. Whatever happens, a frame is complete with every tile
//! once, as long as one worker lives and works, and no tile is with more than two of them.

mod frames;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tessera_geometry::{LocalCamera, Vec3};
use tessera_master::coordinator::{Coordinator, Event, FrameStatus, Outcome, Output};
use tessera_master::{Balance, FrameJob, PixelFormat};
use tessera_wire::{
    Abilities, AbortCode, Attempt, FrameId, Hello, PackId, Rays, Rect, ReturnMode, Role, TileEntry, TileId,
    ToMaster, ToWorker, Token, Version, WorkerId, limits,
};
use tessera_worker::session::{Action, Batch, Ending, RenderTask, RenderedTile, Session, TileName};

const PACKS: [PackId; 2] = [PackId([9; 32]), PackId([8; 32])];
const PACK_BYTES: u64 = 1000;

#[test]
fn every_frame_is_complete_for_every_seed() {
    let (mut lost, mut dropped, mut joined, mut helped, mut ahead) = (0, 0, 0, 0, 0);
    let mut balances = BTreeSet::new();
    for seed in 0..4000 {
        let mut world = World::new(seed, true);
        for pack in [None, None, Some(PACKS[1]), Some(PACKS[0])] {
            // The frame before has just ended: much of it is still under way.
            if let Some(pack) = pack {
                world.load(pack);
            }
            let job = world.random_job();
            balances.insert(job.balance.name());
            let outcome =
                world.render(&job).unwrap_or_else(|status| panic!("seed {seed}: {status:?}, {job:?}"));
            check_frame(seed, &job, &outcome);
            dropped += outcome.dropped_tiles;
        }
        lost += world.lost.len();
        joined += world.took_part_late;
        helped += world.shared_tiles;
        ahead += usize::from(world.most_in_hand == 3);
    }
    // The seeds do what they are for.
    assert_eq!(balances.len(), Balance::ALL.len());
    assert!(lost > 4000, "{lost} workers were lost");
    assert!(dropped > 4000, "{dropped} results came twice or too late");
    assert!(joined > 4000, "{joined} workers took part in a frame that had begun");
    assert!(helped > 4000, "{helped} tiles were with two workers");
    assert!(ahead > 1500, "in {ahead} worlds a worker had three tiles in hand");
}

#[test]
fn workers_that_are_well_render_nothing_twice() {
    for seed in 0..300 {
        let mut world = World::new(seed, false);
        let job = world.random_job();
        let outcome = world.render(&job).expect("all are well");
        let found = (outcome.dropped_tiles, world.shared_tiles);
        if renders_twice(job.balance) {
            // Half of all that is rendered at most.
            assert!(outcome.dropped_tiles <= u64::from(outcome.count), "seed {seed}: {found:?}");
        } else {
            assert_eq!(found, (0, 0), "seed {seed}");
        }
    }
}

/// Whether those that idle render tiles of others that are well, if they are likely to be done with them earlier.
fn renders_twice(balance: Balance) -> bool {
    matches!(balance, Balance::Dynamic | Balance::Steal | Balance::Auto)
}

#[test]
fn a_worker_that_stalls_does_not_hold_the_frame() {
    for balance in Balance::ALL {
        let mut world = World::with_workers(1, 3);
        let job = FrameJob { width: 64, height: 64, tile: 8, balance, ..world.random_job() };
        world.workers[1].stalled_until = Duration::MAX;
        let begun = world.now;
        let outcome = world.render(&job).expect("two workers are enough");
        check_frame(1, &job, &outcome);
        assert_eq!((world.lost.len(), outcome.workers[1].tiles), (0, 0), "{balance}: it is alive");
        let waited = world.now - begun;
        assert!(waited < Duration::from_secs(6), "{balance}: {waited:?}");
        // It is still at that tile when the next frame begins.
        let outcome = world.render(&job).expect("two workers are enough");
        check_frame(2, &job, &outcome);
    }
}

#[test]
fn a_frame_whose_only_worker_stalls_fails_after_a_deadline() {
    for balance in Balance::ALL {
        let mut world = World::with_workers(1, 1);
        let job = FrameJob { width: 64, height: 64, tile: 8, balance, ..world.random_job() };
        world.workers[0].stalled_until = Duration::MAX;
        world.expected_lost.insert(WorkerId(0));
        let begun = world.now;
        assert_eq!(world.render(&job).err(), Some(FrameStatus::Failed { done: 0, total: 64 }), "{balance}");
        let waited = (world.now - begun).as_secs();
        // A minute and 10 ms a sample of what it says at once: a tile, or with `paper-static` all.
        let samples = if balance.returns() == ReturnMode::AtEnd { 64 * 64 } else { 64 };
        assert_eq!(waited, 60 + samples / 100, "{balance}");
        let reason = world.reasons.last().expect("it was lost");
        assert!(reason.contains("stalled"), "{reason}");
    }
}

#[test]
fn a_frame_without_workers_waits_for_one_if_one_may_come() {
    let patience = Duration::from_secs(30);
    for (delay, is_in_time) in [(29, true), (31, false)] {
        let mut world = World::with_workers(1, 1);
        world.coordinator = std::mem::take(&mut world.coordinator).with_patience(patience);
        let job = FrameJob { width: 64, height: 64, tile: 8, ..world.random_job() };
        let at = world.now + Duration::from_micros(500);
        world.schedule(at, Happening::Die(WorkerId(0)));
        // It is missed 5 s later at most.
        world.schedule(at + Duration::from_secs(delay), Happening::Join);
        let missed = at + Duration::from_micros(1);
        world.expected_lost.insert(WorkerId(0));
        world.schedule(missed, Happening::Missed(WorkerId(0)));
        match world.render(&job) {
            Ok(outcome) => {
                assert!(is_in_time);
                check_frame(1, &job, &outcome);
                assert_eq!(outcome.workers.len(), 2);
            }
            Err(status) => {
                assert!(!is_in_time && matches!(status, FrameStatus::Failed { .. }), "{status:?}");
                assert_eq!(world.now, missed + patience);
            }
        }
    }
}

#[test]
fn a_frame_without_workers_waits_for_one_that_is_taking_the_pack() {
    let patience = Duration::from_secs(20);
    let mut world = World::with_workers(1, 1);
    world.coordinator = std::mem::take(&mut world.coordinator).with_patience(patience);
    // More than twice the patience, less than a pack may take.
    world.pack_time = Duration::from_secs(50);
    let job = FrameJob { width: 64, height: 64, tile: 8, ..world.random_job() };
    let at = world.now + Duration::from_micros(500);
    world.expected_lost.insert(WorkerId(0));
    world.schedule(at, Happening::Die(WorkerId(0)));
    world.schedule(at, Happening::Missed(WorkerId(0)));
    world.schedule(at, Happening::Join);
    let outcome = world.render(&job).expect("it comes in the end");
    check_frame(1, &job, &outcome);
    // One that never takes it does not make the frame wait for ever.
    world.pack_time = Duration::MAX / 4;
    world.expected_lost.insert(WorkerId(1));
    let at = world.now + Duration::from_micros(500);
    world.schedule(at, Happening::Die(WorkerId(1)));
    world.schedule(at, Happening::Missed(WorkerId(1)));
    world.schedule(at, Happening::Join);
    world.expected_lost.insert(WorkerId(2));
    let failed = world.render(&job).expect_err("nobody is left");
    assert!(matches!(failed, FrameStatus::Failed { .. }), "{failed:?}");
    assert!(world.now > limits::pack_timeout(PACK_BYTES) && world.now < Duration::from_secs(200));
}

#[test]
fn a_straggler_does_not_hold_the_loading_where_workers_may_join_later() {
    for patience in [Duration::ZERO, Duration::from_secs(60)] {
        let mut world = World::with_workers(1, 3);
        world.coordinator = std::mem::take(&mut world.coordinator).with_patience(patience);
        world.workers[2].is_alive = false;
        world.expected_lost.insert(WorkerId(2));
        let begun = world.now;
        world.coordinator.load(PACKS[1], PACK_BYTES, begun);
        world.run_until(|c| !c.is_loading());
        assert_eq!(world.coordinator.holders().count(), 2);
        let expected =
            if patience.is_zero() { limits::pack_timeout(PACK_BYTES) } else { Duration::from_secs(1) };
        assert_eq!(world.now - begun, expected);
        let job = FrameJob { width: 64, height: 64, tile: 8, ..world.random_job() };
        let outcome = world.render(&job).expect("two workers are enough");
        check_frame(1, &job, &outcome);
    }
}

#[test]
fn short_frames_do_not_hide_a_worker_that_is_dead() {
    for balance in [Balance::PaperDynamic, Balance::Dynamic] {
        let mut world = World::with_workers(1, 3);
        let job = FrameJob { width: 64, height: 64, tile: 8, balance, ..world.random_job() };
        world.workers[1].stalled_until = Duration::MAX;
        world.expected_lost.insert(WorkerId(1));
        let begun = world.now;
        let mut frames = 0;
        while world.lost.is_empty() {
            let outcome = world.render(&job).expect("two workers are enough");
            check_frame(frames, &job, &outcome);
            frames += 1;
            // Time between frames is nobody's fault.
            world.pass(Duration::from_secs(100));
            // (A frame of the dynamic balancing takes as long as its tiles alone: those that idle do not wait for the dead.)
            assert!(frames < 100_000, "{balance}: it is still there");
        }
        let silent = world.now - begun - Duration::from_secs(100) * frames as u32;
        // As in one long frame, but for the time of the last.
        assert!((60..63).contains(&silent.as_secs()), "{balance}: {silent:?} in {frames} frames");
        assert!(frames > 50 && world.reasons[0].contains("stalled"), "{balance}: {frames} frames");
    }
}

#[test]
fn a_frame_without_workers_fails_and_says_how_far_it_got() {
    for seed in 0..300 {
        let mut world = World::new(seed, false);
        let job = world.random_job();
        for worker in 0..world.workers.len() as u32 {
            let at = world.now + world.micros(1, 3000);
            world.schedule(at, Happening::Die(WorkerId(worker)));
        }
        match world.render(&job) {
            // All tiles may have been in before the last one died.
            Ok(outcome) => check_frame(seed, &job, &outcome),
            Err(FrameStatus::Failed { done, total }) => assert!(done < total, "seed {seed}"),
            Err(status) => panic!("seed {seed}: {status:?}"),
        }
    }
}

#[test]
fn a_worker_that_never_says_hello_is_cut_off() {
    let mut coordinator = Coordinator::new(None);
    let worker = coordinator.connected(Duration::ZERO);
    let deadline = coordinator.deadline().expect("one waits for `Hello`");
    coordinator.tick(deadline);
    let outputs: Vec<_> = std::iter::from_fn(|| coordinator.poll()).collect();
    assert!(outputs.contains(&Output::Close(worker, AbortCode::Timeout)), "{outputs:?}");
    assert_eq!(coordinator.deadline(), None);
}

#[test]
fn a_worker_that_returns_nonsense_is_cut_off_and_the_others_finish() {
    /// What worker 0 sends instead of `entry`, its first tile.
    type Trick = fn(&mut World, TileEntry);
    let tricks: [Trick; 4] = [
        // A frame that never was.
        |world, entry| world.tile(FrameId(99), entry, 256),
        // Too few pixels.
        |world, entry| world.tile(FrameId(1), entry, 3),
        // No tile of the frame.
        |world, entry| world.tile(FrameId(1), TileEntry { tile: TileId(1 << 20), ..entry }, 256),
        // A tile that was never given to it.
        |world, entry| world.tile(FrameId(1), TileEntry { attempt: Attempt(5), ..entry }, 256),
    ];
    for trick in tricks {
        let mut world = World::with_workers(1, 3);
        let job = FrameJob { width: 64, height: 64, tile: 8, ..world.random_job() };
        let frame = world.coordinator.begin(&job, world.now).expect("a job in range");
        let first = TileEntry::raw(256);
        trick(&mut world, first);
        world.expected_lost.insert(WorkerId(0));
        let outcome = world.finish(frame, &job).expect("two workers are enough");
        assert!(outcome.workers[0].lost.as_ref().is_some_and(|r| r.starts_with("bad tiles")), "{outcome:?}");
        check_frame(1, &job, &outcome);
    }
}

#[test]
fn a_worker_that_keeps_its_pixels_is_helped_and_alone_it_is_cut_off() {
    for (crew, tiles) in [(3, 22), (1, 64)] {
        let mut world = World::with_workers(1, crew);
        let job =
            FrameJob { width: 64, height: 64, tile: 8, balance: Balance::PaperStatic, ..world.random_job() };
        let frame = world.coordinator.begin(&job, world.now).expect("a job in range");
        // Its connection stays; it says that its share of 64 tiles is rendered, and nothing else.
        world.workers[0].is_alive = false;
        world.expected_lost.insert(WorkerId(0));
        let begun = world.now;
        world.happen(Happening::ToMaster(WorkerId(0), ToMaster::Rendered { frame: FrameId(1), tiles }));
        match world.finish(frame, &job) {
            Ok(outcome) => {
                assert!(crew == 3 && world.lost.is_empty() && world.now < begun + Duration::from_secs(6));
                check_frame(1, &job, &outcome);
            }
            Err(status) => {
                assert_eq!((crew, status), (1, FrameStatus::Failed { done: 0, total: 64 }));
                assert_eq!((world.now, world.lost), (begun + limits::RETURN_TIMEOUT, vec![WorkerId(0)]));
                assert!(world.reasons[0].contains("did not come in time"), "{:?}", world.reasons);
            }
        }
    }
}

/// The right pixels everywhere, and every tile, ray and worker accounted for once.
fn check_frame(seed: u64, job: &FrameJob, outcome: &Outcome) {
    let image = Rect { x: 0, y: 0, width: job.width, height: job.height };
    assert!(
        outcome.image.data() == pixels(image, job.format, job.seed),
        "seed {seed}: a wrong pixel, {job:?}"
    );
    assert_eq!(outcome.rays.primary, u64::from(job.width) * u64::from(job.height), "seed {seed}");
    let tiles = job.width.div_ceil(job.tile) * job.height.div_ceil(job.tile);
    assert_eq!(outcome.workers.iter().map(|w| w.tiles).sum::<u32>(), tiles, "seed {seed}");
    let times = outcome.timings;
    assert_eq!(times.render + times.return_, times.frame, "seed {seed}");
}

/// What a renderer would make of `rect`: a colour that depends on the place and on the frame's seed alone.
fn pixels(rect: Rect, format: PixelFormat, seed: u64) -> Vec<u8> {
    let places =
        (rect.y..rect.y + rect.height).flat_map(|y| (rect.x..rect.x + rect.width).map(move |x| (x, y)));
    let bytes = |(x, y): (u32, u32)| {
        let word = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed as u32;
        word.to_le_bytes().into_iter().cycle().take(format.bytes_per_pixel())
    };
    places.flat_map(bytes).collect()
}

/// The master, the workers, and everything that is under way between them.
struct World {
    coordinator: Coordinator,
    workers: Vec<Worker>,
    /// By time, then by order of scheduling.
    under_way: BTreeMap<(Duration, u64), Happening>,
    scheduled: u64,
    now: Duration,
    random: u64,
    /// How much longer than a message a pack takes.
    pack_time: Duration,
    /// How many times as long as usual tiles take.
    slowness: u32,
    /// Whether workers die and messages are repeated.
    is_rough: bool,
    /// Most tiles that any worker renders ahead.
    most_ahead: u64,
    expected_lost: BTreeSet<WorkerId>,
    lost: Vec<WorkerId>,
    reasons: Vec<String>,
    /// Who was given each tile of frames that are under way.
    holders: BTreeMap<(FrameId, TileId), Vec<WorkerId>>,
    /// Tiles that were stopped while they were rendered.
    stopped: u32,
    /// Tiles that workers have said they will not render, being told so.
    cancelled: u32,
    /// Tiles that were with two living workers.
    shared_tiles: u32,
    /// Workers of the current frame when it was begun.
    began_with: u32,
    /// Frames that workers took part in that had joined after they were begun.
    took_part_late: u32,
    /// Most tiles that one worker had in hand.
    most_in_hand: usize,
}

struct Worker {
    session: Session,
    is_alive: bool,
    /// How fast it renders, in percent.
    speed: u64,
    /// Until then it finishes no tile, although it talks.
    stalled_until: Duration,
    /// Tiles that it has begun and neither finished nor stopped, by their place in the order in which it began.
    in_hand: BTreeMap<u64, TileName>,
    begun: u64,
    /// When the last thing put on each of its pipes arrives: to the worker, control and bulk to the master.
    arrivals: [Duration; 3],
}

enum Happening {
    ToWorker(WorkerId, ToWorker),
    ToMaster(WorkerId, ToMaster),
    PackArrives(WorkerId, PackId),
    /// Unless stopped: if it still has this one in hand.
    Rendered(WorkerId, u64, Box<RenderedTile>),
    Stopped(WorkerId, TileName),
    BatchSent(WorkerId),
    Tile(WorkerId, FrameId, TileEntry, Vec<u8>),
    Die(WorkerId),
    Leave(WorkerId),
    Drain(WorkerId),
    BulkEnded(WorkerId),
    Missed(WorkerId),
    Stall(WorkerId, Duration),
    /// A new worker, or one that was lost before: the master cannot tell.
    Join,
}

impl World {
    fn new(seed: u64, is_rough: bool) -> Self {
        let mut world = Self::empty(seed);
        let count = world.below(16) + 1;
        world.is_rough = is_rough;
        world.most_ahead = 3;
        world.gather(count as u32);
        world
    }

    fn with_workers(seed: u64, count: u32) -> Self {
        let mut world = Self::empty(seed);
        world.gather(count);
        world
    }

    fn empty(seed: u64) -> Self {
        Self {
            coordinator: Coordinator::new(None),
            workers: Vec::new(),
            under_way: BTreeMap::new(),
            scheduled: 0,
            now: Duration::ZERO,
            random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) + 1,
            pack_time: Duration::ZERO,
            slowness: 1,
            is_rough: false,
            most_ahead: 1,
            expected_lost: BTreeSet::new(),
            lost: Vec::new(),
            reasons: Vec::new(),
            holders: BTreeMap::new(),
            stopped: 0,
            cancelled: 0,
            shared_tiles: 0,
            began_with: 0,
            took_part_late: 0,
            most_in_hand: 0,
        }
    }

    /// `count` workers join and take the pack.
    fn gather(&mut self, count: u32) {
        for _ in 0..count {
            self.connect();
        }
        self.run_until(|c| c.joined().count() == count as usize);
        self.load(PACKS[0]);
        assert_eq!(self.coordinator.holders().count(), count as usize);
    }

    fn connect(&mut self) {
        let hello = Hello {
            versions: Version::supported_numbers(),
            token: Token::default(),
            name: format!("w{}", self.workers.len()),
            role: Role::Worker(Abilities {
                memory: 0,
                threads: 1,
                backend: "cpu".into(),
                numeric_class: "sim".into(),
                speed: 0,
                note: String::new(),
            }),
        };
        self.coordinator.connected(self.now);
        let (speed, ahead) = (20 + self.below(200), 1 + self.below(self.most_ahead));
        self.workers.push(Worker {
            session: Session::start(hello, None, ahead as usize, self.now),
            is_alive: true,
            speed,
            stalled_until: Duration::ZERO,
            in_hand: BTreeMap::new(),
            begun: 0,
            arrivals: [self.now; 3],
        });
    }

    /// Everybody who lives takes `pack`.
    fn load(&mut self, pack: PackId) {
        self.coordinator.load(pack, PACK_BYTES, self.now);
        self.run_until(|c| !c.is_loading());
        assert_eq!(self.coordinator.holders().count(), self.coordinator.joined().count());
    }

    /// A few things that go wrong in the next milliseconds, if the world is rough.
    fn disasters(&mut self) {
        if !self.is_rough {
            return;
        }
        let alive: Vec<_> = self.coordinator.joined().collect();
        // One is spared.
        for &worker in &alive[1..] {
            let at = self.now + self.micros(1, 8000);
            match self.below(11) {
                4 => self.schedule(at, Happening::Drain(worker)),
                0 => self.schedule(at, Happening::Die(worker)),
                1 => self.schedule(at, Happening::Leave(worker)),
                2 => {
                    let until = at + self.micros(1, 10_000_000);
                    self.schedule(at, Happening::Stall(worker, until));
                }
                3 => self.schedule(at, Happening::Stall(worker, Duration::MAX)),
                _ => {}
            }
        }
        for _ in 0..self.below(3) {
            let at = self.now + self.micros(1, 20_000);
            self.schedule(at, Happening::Join);
        }
    }

    /// One frame, with a few disasters on the way if the world is rough.
    fn render(&mut self, job: &FrameJob) -> Result<Outcome, FrameStatus> {
        self.disasters();
        self.began_with = self.coordinator.holders().count() as u32;
        let frame = self.coordinator.begin(job, self.now).expect("a job in range");
        self.finish(frame, job)
    }

    fn finish(&mut self, frame: FrameId, job: &FrameJob) -> Result<Outcome, FrameStatus> {
        self.run_until(|c| c.status(frame) != FrameStatus::Pending);
        match self.coordinator.status(frame) {
            FrameStatus::Done => {
                let outcome = self.coordinator.finish(frame, self.now).expect("done");
                self.took_part_late += outcome.workers.len() as u32 - self.began_with;
                self.carry_out();
                assert_eq!(outcome.image.format(), job.format);
                Ok(outcome)
            }
            other => Err(other),
        }
    }

    /// Lets time pass until `is_done`.
    fn run_until(&mut self, is_done: impl Fn(&Coordinator) -> bool) {
        self.carry_out();
        while !is_done(&self.coordinator) {
            let next = self.under_way.first_key_value().map(|(&(at, _), _)| at);
            match (next, self.coordinator.deadline()) {
                (None, None) => panic!("nothing is under way, and nobody waits: the cluster hangs"),
                (Some(at), deadline) if deadline.is_none_or(|d| at <= d) => {
                    let (_, happening) = self.under_way.pop_first().expect("there is one");
                    self.now = at;
                    self.happen(happening);
                }
                (_, deadline) => {
                    // What a frame was to do while it waited for another is due when its turn comes.
                    self.now = self.now.max(deadline.expect("the earlier one"));
                    self.coordinator.tick(self.now);
                }
            }
            self.carry_out();
        }
    }

    /// Lets so much time pass.
    fn pass(&mut self, time: Duration) {
        let end = self.now + time;
        while let Some(next) = self.under_way.first_entry().filter(|next| next.key().0 <= end) {
            let ((at, _), happening) = next.remove_entry();
            self.now = at;
            self.happen(happening);
            self.carry_out();
        }
        self.now = end;
    }

    fn happen(&mut self, happening: Happening) {
        let now = self.now;
        match happening {
            Happening::ToMaster(worker, message) => {
                if let ToMaster::Cancelled { tiles, .. } = message {
                    self.cancelled += tiles;
                }
                self.coordinator.message(worker, message, now);
            }
            Happening::Tile(worker, frame, entry, pixels) => {
                let bytes = pixels.len() as u64;
                self.coordinator.tile(worker, frame, &entry, &pixels, bytes, now);
            }
            Happening::Missed(worker) => {
                self.coordinator.lost(worker, AbortCode::Done, "it died".into(), now);
            }
            Happening::Die(worker) => {
                self.expected_lost.insert(worker);
                self.workers[worker.0 as usize].is_alive = false;
                let at = now + self.micros(100, 5_000_000);
                self.schedule(at, Happening::Missed(worker));
            }
            Happening::Leave(worker) => {
                self.expected_lost.insert(worker);
                self.session(worker, Session::leave);
            }
            Happening::Drain(worker) => {
                self.expected_lost.insert(worker);
                self.session(worker, Session::drain);
            }
            Happening::BulkEnded(worker) => self.coordinator.bulk_ended(worker, now),
            Happening::ToWorker(worker, message) => self.session(worker, |s| s.message(message)),
            Happening::PackArrives(worker, pack) => {
                self.session(worker, |s| s.pack_received(pack, Ok(())));
            }
            Happening::Rendered(worker, number, tile) => {
                let state = &mut self.workers[worker.0 as usize];
                if state.stalled_until > now {
                    if state.stalled_until < Duration::MAX {
                        let at = state.stalled_until;
                        self.schedule(at, Happening::Rendered(worker, number, tile));
                    }
                } else if state.in_hand.remove(&number).is_some() {
                    self.session(worker, |s| s.rendered(*tile));
                }
            }
            Happening::Stopped(worker, tile) => self.session(worker, |s| s.rendering_stopped(tile)),
            Happening::Stall(worker, until) => {
                self.workers[worker.0 as usize].stalled_until = until;
                if until == Duration::MAX {
                    // When two that stall have the same tile.
                    self.expected_lost.insert(worker);
                }
            }
            Happening::Join => self.connect(),
            Happening::BatchSent(worker) => self.session(worker, Session::batch_sent),
        }
    }

    fn session(&mut self, worker: WorkerId, act: impl FnOnce(&mut Session)) {
        if self.workers[worker.0 as usize].is_alive {
            act(&mut self.workers[worker.0 as usize].session);
        }
    }

    /// Does what master and workers want.
    fn carry_out(&mut self) {
        loop {
            let mut is_idle = true;
            while let Some(output) = self.coordinator.poll() {
                is_idle = false;
                self.master_wants(output);
            }
            for index in 0..self.workers.len() {
                while let Some(action) = self.workers[index].session.poll() {
                    is_idle = false;
                    if self.workers[index].is_alive {
                        self.worker_wants(WorkerId(index as u32), action);
                    }
                }
            }
            if is_idle {
                return;
            }
        }
    }

    fn master_wants(&mut self, output: Output) {
        match output {
            Output::Send(worker, message) => {
                if let ToWorker::Assign { frame, tiles, .. } = &message {
                    self.check_holders(worker, *frame, tiles);
                }
                let at = self.arrival(worker, 0);
                self.schedule(at, Happening::ToWorker(worker, message));
            }
            Output::SendPack(worker, pack) => {
                let at = self.arrival(worker, 0) + self.pack_time;
                self.schedule(at, Happening::PackArrives(worker, pack));
            }
            Output::Event(Event::Lost(worker, reason)) => {
                assert!(
                    self.expected_lost.contains(&worker),
                    "{worker} is lost without a disaster: {reason}"
                );
                self.lost.push(worker);
                self.reasons.push(reason);
                if self.is_rough && self.below(2) == 0 {
                    let at = self.now + self.micros(1, 5000);
                    self.schedule(at, Happening::Join);
                }
            }
            Output::Close(..) | Output::Event(_) => {}
        }
    }

    /// A tile is with two living workers at most.
    fn check_holders(&mut self, worker: WorkerId, frame: FrameId, tiles: &[TileId]) {
        for &tile in tiles {
            let holders = self.holders.entry((frame, tile)).or_default();
            holders.push(worker);
            let mut living: Vec<_> =
                holders.iter().filter(|w| self.coordinator.name(**w).is_some()).collect();
            living.dedup();
            assert!(living.len() <= 2, "{tile:?} is with {living:?}");
            self.shared_tiles += u32::from(living.len() == 2);
        }
    }

    fn worker_wants(&mut self, worker: WorkerId, action: Action) {
        match action {
            Action::Send(message) => {
                let at = self.arrival(worker, 1);
                self.schedule(at, Happening::ToMaster(worker, message));
            }
            Action::Receive { pack, length } => {
                assert_eq!(length, PACK_BYTES);
                self.session(worker, |s| s.pack_reserved(pack, Ok(())));
            }
            Action::Render(task) => {
                let time = self.micros(10, 1000) * 100;
                let state = &mut self.workers[worker.0 as usize];
                let time = time / state.speed as u32 * self.slowness;
                state.begun += 1;
                state.in_hand.insert(state.begun, task.name());
                self.most_in_hand = self.most_in_hand.max(state.in_hand.len());
                let rendered = Happening::Rendered(worker, state.begun, Box::new(render(task, time)));
                self.schedule(self.now + time, rendered);
            }
            Action::StopRendering(tiles) => {
                for (number, tile) in self.workers[worker.0 as usize].in_hand.clone() {
                    let at = self.now + self.micros(1, 300);
                    // Half of them are finished before they see that they are not wanted any more.
                    let is_quicker = self.below(2) == 0;
                    let state = &mut self.workers[worker.0 as usize];
                    if tiles.contains(&tile) && is_quicker && state.stalled_until <= at {
                        state.in_hand.remove(&number);
                        self.stopped += 1;
                        self.schedule(at, Happening::Stopped(worker, tile));
                    }
                }
            }
            Action::Return(Batch { header, pixels, .. }) => {
                header.check().expect("a worker's own batch");
                for (entry, pixels) in header.tiles.into_iter().zip(pixels) {
                    let at = self.arrival(worker, 2);
                    if self.is_rough && self.below(8) == 0 {
                        // Long after: perhaps in the next frame.
                        let later = at + self.micros(1, 20_000);
                        self.schedule(later, Happening::Tile(worker, header.frame, entry, pixels.clone()));
                    }
                    self.schedule(at, Happening::Tile(worker, header.frame, entry, pixels));
                }
                let at = self.workers[worker.0 as usize].arrivals[2];
                self.schedule(at, Happening::BatchSent(worker));
            }
            // The master hears of it by the message that went ahead, and by the pipes' ends. One that has left waits for the pixels to
            // be there before it closes.
            Action::Over(ending) => {
                self.workers[worker.0 as usize].is_alive = false;
                let bulk = self.arrival(worker, 2);
                self.schedule(bulk, Happening::BulkEnded(worker));
                let control = self.arrival(worker, 1);
                let closed = if ending == Ending::Left { bulk.max(control) } else { control };
                self.schedule(closed, Happening::Missed(worker));
            }
        }
    }

    /// When something that is put on a pipe now arrives: later than what was put there before.
    fn arrival(&mut self, worker: WorkerId, pipe: usize) -> Duration {
        let at = self.now + self.micros(20, 500);
        let last = &mut self.workers[worker.0 as usize].arrivals[pipe];
        *last = at.max(*last);
        *last
    }

    fn schedule(&mut self, at: Duration, happening: Happening) {
        self.scheduled += 1;
        self.under_way.insert((at, self.scheduled), happening);
    }

    /// A result from worker 0, there at once.
    fn tile(&mut self, frame: FrameId, entry: TileEntry, length: usize) {
        self.happen(Happening::Tile(WorkerId(0), frame, entry, vec![0; length]));
    }

    fn random_job(&mut self) -> FrameJob {
        let side = |world: &mut Self| [1, 7, 32, 33, 64, 100][world.below(6) as usize];
        let camera = LocalCamera { origin: Vec3::ZERO, forward: -Vec3::Z, right: Vec3::X, up: Vec3::Y };
        FrameJob {
            tile: [4, 8, 16, 31, 200][self.below(5) as usize],
            depth: 4,
            balance: Balance::ALL[self.below(Balance::ALL.len() as u64) as usize],
            ..FrameJob::new(camera, side(self), side(self))
        }
    }

    fn micros(&mut self, from: u64, to: u64) -> Duration {
        Duration::from_micros(from + self.below(to - from))
    }

    /// Xorshift (Marsaglia 2003): a few lines that give the same numbers everywhere.
    fn below(&mut self, bound: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) % bound
    }
}

fn render(task: RenderTask, time: Duration) -> RenderedTile {
    let pixels = pixels(task.rect, task.frame.format, task.frame.seed);
    let rays = Rays { primary: u64::from(task.rect.width) * u64::from(task.rect.height), ..Rays::default() };
    RenderedTile::new(task, pixels, time, rays)
}
