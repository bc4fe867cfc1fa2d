//! A cluster in one thread under a virtual clock: the state machines of the master and of its workers, with workers and tiles as unequal as
//! one likes, and the pixels of every tile known beforehand.

use std::collections::BTreeMap;
use std::time::Duration;
use tessera_geometry::{LocalCamera, Vec3};
use tessera_master::coordinator::{Coordinator, Event, FrameStatus, Output};
use tessera_master::{Balance, FrameJob};
use tessera_wire::{
    Abilities, FrameId, Hello, PackId, Rays, Rect, Role, TileEntry, TileId, ToMaster, ToWorker, Token,
    Version, WorkerId,
};
use tessera_worker::session::{Action, Batch, RenderTask, RenderedTile, Session, TileName};

/// A frame of small tiles and who renders it.
pub struct Trial<'a> {
    /// Rows and columns of tiles.
    pub tiles: [u32; 2],
    pub balance: Balance,
    /// How many times the cost of a tile each worker takes for it.
    pub slowness: &'a [u32],
    /// What each tile costs a worker of slowness 1.
    pub cost: &'a dyn Fn(TileId) -> Duration,
    /// Of the links' delays.
    pub seed: u64,
}

/// How it went.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// From the frame's begin to its last tile.
    pub took: Duration,
    /// Tiles of the image from each worker.
    pub tiles: Vec<u32>,
    /// Tiles that two workers had at the same time.
    pub shared: u32,
    /// Results that came twice, or too late.
    pub dropped: u64,
    /// Workers that were taken for dead.
    pub lost: u32,
    /// Most tiles that waited for rows above them.
    pub waiting: u32,
}

/// Side of a tile in pixels.
const SIDE: u32 = 4;

/// Renders one frame.
///
/// # Errors
/// What must not happen, happened: a wrong pixel, a tile lost, doubled or with three workers, a frame that does not end.
pub fn render(trial: &Trial<'_>) -> Result<Course, String> {
    let mut world = World::gather(trial)?;
    let begun = world.now;
    let job = job(trial);
    let frame = world.master.begin_rows(&job, begun).map_err(|e| e.to_string())?;
    world.run(|master| master.status(frame) != FrameStatus::Pending)?;
    let outcome = match world.master.status(frame) {
        FrameStatus::Done => {
            world.master.finish(frame, world.now).ok_or("a frame that is done has no outcome")?
        }
        status => return Err(format!("the frame ends as {status:?}")),
    };
    world.settle()?;
    let image = Rect { x: 0, y: 0, width: job.width, height: job.height };
    if world.rows != pixels(image) {
        return Err("the rows are not those of the image".into());
    }
    let tiles: Vec<_> = outcome.workers.iter().map(|worker| worker.tiles).collect();
    let total = trial.tiles[0] * trial.tiles[1];
    if tiles.iter().sum::<u32>() != total || outcome.rays.primary != u64::from(job.width * job.height) {
        return Err(format!("{tiles:?} tiles of {total} were counted, {} rays", outcome.rays.primary));
    }
    Ok(Course {
        took: outcome.timings.frame,
        tiles,
        shared: world.shared,
        dropped: outcome.dropped_tiles,
        lost: world.lost,
        waiting: world.waiting,
    })
}

fn job(trial: &Trial<'_>) -> FrameJob {
    FrameJob {
        tile: SIDE,
        depth: 1,
        balance: trial.balance,
        ..FrameJob::new(
            LocalCamera { origin: Vec3::ZERO, forward: -Vec3::Z, right: Vec3::X, up: Vec3::Y },
            trial.tiles[1] * SIDE,
            trial.tiles[0] * SIDE,
        )
    }
}

/// What the pixels of `rect` are: a colour that depends on the place alone.
fn pixels(rect: Rect) -> Vec<u8> {
    let places =
        (rect.y..rect.y + rect.height).flat_map(|y| (rect.x..rect.x + rect.width).map(move |x| (x, y)));
    places
        .flat_map(|(x, y)| (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)).to_le_bytes())
        .collect()
}

struct World<'a> {
    trial: &'a Trial<'a>,
    master: Coordinator,
    crew: Vec<Worker>,
    /// By time, then by order of scheduling.
    under_way: BTreeMap<(Duration, u64), Happening>,
    scheduled: u64,
    now: Duration,
    random: u64,
    /// Rows that were given out.
    rows: Vec<u8>,
    /// Tiles in the image.
    done: u32,
    /// Workers that were given each tile.
    holders: BTreeMap<TileId, Vec<WorkerId>>,
    shared: u32,
    waiting: u32,
    lost: u32,
}

struct Worker {
    session: Session,
    is_there: bool,
    /// The tile in hand, and its number.
    in_hand: Option<(u64, TileName)>,
    begun: u64,
    /// When the last thing put on each of its pipes arrives: to the worker, control and bulk to the master.
    arrivals: [Duration; 3],
}

enum Happening {
    ToWorker(usize, ToWorker),
    ToMaster(usize, ToMaster),
    PackArrives(usize, PackId),
    Rendered(usize, u64, Box<RenderedTile>),
    Stopped(usize, TileName),
    BatchSent(usize),
    Tile(usize, FrameId, TileEntry, Vec<u8>),
}

impl<'a> World<'a> {
    const PACK: PackId = PackId([5; 32]);

    /// All workers have joined and hold the pack.
    fn gather(trial: &'a Trial<'a>) -> Result<Self, String> {
        let mut world = Self {
            trial,
            master: Coordinator::new(None),
            crew: Vec::new(),
            under_way: BTreeMap::new(),
            scheduled: 0,
            now: Duration::ZERO,
            random: trial.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            rows: Vec::new(),
            done: 0,
            holders: BTreeMap::new(),
            shared: 0,
            waiting: 0,
            lost: 0,
        };
        let count = trial.slowness.len();
        for index in 0..count {
            let hello = Hello {
                versions: Version::supported_numbers(),
                token: Token::default(),
                name: format!("w{index}"),
                role: Role::Worker(Abilities {
                    memory: 0,
                    threads: 1,
                    backend: "cpu".into(),
                    numeric_class: "virtual".into(),
                    speed: 0,
                    note: String::new(),
                }),
            };
            world.master.connected(world.now);
            world.crew.push(Worker {
                session: Session::start(hello, None, 1, world.now),
                is_there: true,
                in_hand: None,
                begun: 0,
                arrivals: [world.now; 3],
            });
        }
        world.run(|master| master.joined().count() == count)?;
        world.master.load(Self::PACK, 1, world.now);
        world.run(|master| master.holders().count() == count)?;
        Ok(world)
    }

    /// Lets time pass until `is_over`.
    fn run(&mut self, is_over: impl Fn(&Coordinator) -> bool) -> Result<(), String> {
        self.settle()?;
        while !is_over(&self.master) {
            let next = self.under_way.first_key_value().map(|(&(at, _), _)| at);
            match (next, self.master.deadline()) {
                (None, None) => {
                    return Err("nothing is under way, and nobody waits: the cluster hangs".into());
                }
                (Some(at), deadline) if deadline.is_none_or(|deadline| at <= deadline) => {
                    if let Some(((at, _), happening)) = self.under_way.pop_first() {
                        self.now = at;
                        self.happen(happening);
                    }
                }
                (_, deadline) => {
                    self.now = deadline.unwrap_or(self.now);
                    self.master.tick(self.now);
                }
            }
            self.settle()?;
        }
        Ok(())
    }

    fn happen(&mut self, happening: Happening) {
        let now = self.now;
        match happening {
            Happening::ToMaster(worker, message) => self.master.message(id(worker), message, now),
            Happening::Tile(worker, frame, entry, pixels) => {
                let bytes = pixels.len() as u64;
                self.master.tile(id(worker), frame, &entry, &pixels, bytes, now);
            }
            Happening::ToWorker(worker, message) => self.session(worker, |s| s.message(message)),
            Happening::PackArrives(worker, pack) => self.session(worker, |s| s.pack_received(pack, Ok(()))),
            Happening::Rendered(worker, number, tile) => {
                if self.crew[worker].in_hand.is_some_and(|(of, _)| of == number) {
                    self.crew[worker].in_hand = None;
                    self.session(worker, |s| s.rendered(*tile));
                }
            }
            Happening::Stopped(worker, tile) => self.session(worker, |s| s.rendering_stopped(tile)),
            Happening::BatchSent(worker) => self.session(worker, Session::batch_sent),
        }
    }

    fn session(&mut self, worker: usize, act: impl FnOnce(&mut Session)) {
        if self.crew[worker].is_there {
            act(&mut self.crew[worker].session);
        }
    }

    /// Does what master and workers want.
    fn settle(&mut self) -> Result<(), String> {
        let mut is_busy = true;
        while is_busy {
            is_busy = false;
            while let Some(output) = self.master.poll() {
                is_busy = true;
                self.master_wants(output)?;
            }
            for worker in 0..self.crew.len() {
                while let Some(action) = self.crew[worker].session.poll() {
                    is_busy = true;
                    if self.crew[worker].is_there {
                        self.worker_wants(worker, action);
                    }
                }
            }
        }
        Ok(())
    }

    fn master_wants(&mut self, output: Output) -> Result<(), String> {
        match output {
            Output::Send(worker, message) => {
                if let ToWorker::Assign { tiles, .. } = &message {
                    self.note_holders(worker, tiles)?;
                }
                let worker = worker.0 as usize;
                let at = self.arrival(worker, 0);
                self.schedule(at, Happening::ToWorker(worker, message));
            }
            Output::SendPack(worker, pack) => {
                let worker = worker.0 as usize;
                let at = self.arrival(worker, 0);
                self.schedule(at, Happening::PackArrives(worker, pack));
            }
            Output::Close(worker, _) => self.crew[worker.0 as usize].is_there = false,
            Output::Event(Event::Lost(..)) => self.lost += 1,
            Output::Event(Event::Rows(_, rows)) => self.rows.extend(rows),
            Output::Event(Event::Tile { done, .. }) => {
                if done != self.done + 1 {
                    return Err(format!("tile {done} follows tile {}", self.done));
                }
                self.done = done;
                let out = self.rows.len() / (SIDE * SIDE * 4) as usize;
                self.waiting = self.waiting.max(done - out as u32);
            }
            Output::Event(_) => {}
        }
        Ok(())
    }

    /// A tile is with two workers that are there at most.
    fn note_holders(&mut self, worker: WorkerId, tiles: &[TileId]) -> Result<(), String> {
        for &tile in tiles {
            let holders = self.holders.entry(tile).or_default();
            holders.push(worker);
            let there = holders.iter().filter(|holder| self.crew[holder.0 as usize].is_there).count();
            if there > 2 {
                return Err(format!("{tile:?} is with {there} workers"));
            }
            self.shared += u32::from(there == 2);
        }
        Ok(())
    }

    fn worker_wants(&mut self, worker: usize, action: Action) {
        match action {
            Action::Send(message) => {
                let at = self.arrival(worker, 1);
                self.schedule(at, Happening::ToMaster(worker, message));
            }
            Action::Receive { pack, .. } => self.session(worker, |s| s.pack_reserved(pack, Ok(()))),
            Action::Render(task) => {
                let time = (self.trial.cost)(task.tile) * self.trial.slowness[worker];
                let state = &mut self.crew[worker];
                state.begun += 1;
                state.in_hand = Some((state.begun, task.name()));
                let rendered = Happening::Rendered(worker, state.begun, Box::new(rendered(task, time)));
                self.schedule(self.now + time, rendered);
            }
            Action::StopRendering(tiles) => {
                let in_hand = &mut self.crew[worker].in_hand;
                if let Some((_, tile)) = in_hand.take_if(|(_, tile)| tiles.contains(tile)) {
                    self.schedule(self.now + Duration::from_micros(100), Happening::Stopped(worker, tile));
                }
            }
            Action::Return(Batch { header, pixels, .. }) => {
                for (entry, pixels) in header.tiles.into_iter().zip(pixels) {
                    let at = self.arrival(worker, 2);
                    self.schedule(at, Happening::Tile(worker, header.frame, entry, pixels));
                }
                let at = self.crew[worker].arrivals[2];
                self.schedule(at, Happening::BatchSent(worker));
            }
            Action::Over(_) => self.crew[worker].is_there = false,
        }
    }

    /// When something that is put on a pipe now arrives: later than what was put there before.
    fn arrival(&mut self, worker: usize, pipe: usize) -> Duration {
        let at = self.now + Duration::from_micros(20 + self.below(480));
        let last = &mut self.crew[worker].arrivals[pipe];
        *last = at.max(*last);
        *last
    }

    fn schedule(&mut self, at: Duration, happening: Happening) {
        self.scheduled += 1;
        self.under_way.insert((at, self.scheduled), happening);
    }

    /// Xorshift (Marsaglia 2003).
    fn below(&mut self, bound: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) % bound
    }
}

fn id(worker: usize) -> WorkerId {
    WorkerId(worker as u32)
}

fn rendered(task: RenderTask, time: Duration) -> RenderedTile {
    let pixels = pixels(task.rect);
    let rays = Rays { primary: u64::from(task.rect.width) * u64::from(task.rect.height), ..Rays::default() };
    RenderedTile::new(task, pixels, time, rays)
}

/// Crews with one or two workers that are a thousand times slower, and rows and columns of tiles: frames that are over before a slow worker
/// has finished its first tile, and one in which it finishes some.
pub const UNEQUAL: [(&[u32], [u32; 2]); 4] = [
    (&[1000, 1, 1, 1, 1], [16, 16]),
    (&[1, 1000, 1, 1000], [16, 16]),
    (&[1, 1000], [10, 30]),
    (&[1, 1, 1000, 1, 1], [64, 64]),
];

/// A frame, and its time as a share of what is allowed.
pub struct Judged {
    pub course: Course,
    pub share: f64,
}

/// Longest delay of a link.
const DELAY: Duration = Duration::from_micros(500);

/// How long a worker is silent before others are asked for its tiles, when each of their tiles takes `tile` and one is dealt `dealt`:
/// `master/src/dispatch/pace.rs` says why.
fn patience(balance: Balance, tile: Duration, dealt: u32) -> Duration {
    match balance {
        balance if !balance.is_dealt() => (2 * tile).max(Duration::from_millis(500)),
        Balance::PaperStatic | Balance::Staggered => (4 * tile * dealt).max(Duration::from_secs(5)),
        _ => (4 * tile).max(Duration::from_secs(5)),
    }
}

/// Renders tiles of 50 ms with workers of this slowness. Allowed is the time that the fast ones take alone, and the patience for those that
/// are not, plus what they were dealt, all of it, shared among the fast: from then on no tile waits for a slow worker.
///
/// # Errors
/// Those of [`render`], and a worker that was lost although each tile takes it less than a minute.
pub fn unequal(slowness: &[u32], tiles: [u32; 2], balance: Balance, seed: u64) -> Result<Judged, String> {
    let tile = Duration::from_millis(50);
    let cost = |_: TileId| tile;
    let fast: Vec<_> = slowness.iter().copied().filter(|&times| times == 1).collect();
    let trial = |slowness| Trial { tiles, balance, slowness, cost: &cost, seed };
    let alone = render(&trial(&fast))?;
    let course = render(&trial(slowness))?;
    if course.lost > 0 {
        return Err(format!("{} workers were taken for dead", course.lost));
    }
    let (total, count) = (tiles[0] * tiles[1], slowness.len() as u32);
    let slow = count - fast.len() as u32;
    // The dynamic balancings let a worker hold three tiles; the others deal all. A dealt share is off the even one by a row at most.
    let held = match balance {
        balance if !balance.is_dealt() => 3,
        _ => total.div_ceil(count) + tiles[1],
    };
    // A tile that is taken over costs its word's way there and back besides, and the last ones come one by one.
    let again = (tile + 4 * DELAY) * (held * slow).div_ceil(fast.len() as u32) + 2 * tile;
    // Lists that the master keeps are taken from a tile at a time: of a slow worker's share each tile has its word's ways.
    let taken = match balance {
        Balance::Steal | Balance::Auto => total.div_ceil(count) + tiles[1],
        _ => 0,
    };
    let words = 4 * DELAY * (taken * slow).div_ceil(fast.len() as u32);
    let allowed = alone.took + patience(balance, tile, held) + again + words;
    // The dynamic balancing returns tiles as small as these in batches of many. Of the one that returns each by itself four rows may wait. Then a
    // slow worker's patience runs, and its tiles are rendered one after the other, each behind three that
    // a fast one has in hand; meanwhile all fast ones go on.
    if balance == Balance::PaperDynamic {
        let meanwhile = patience(balance, tile, held).div_duration_f64(tile) as u32 + 4 * held * slow;
        let may_wait = 4 * tiles[1] + meanwhile * fast.len() as u32;
        if course.waiting > may_wait {
            return Err(format!("{} tiles wait for rows above them, at most {may_wait} may", course.waiting));
        }
    }
    Ok(Judged { share: course.took.div_duration_f64(allowed), course })
}

/// Renders 256 tiles of 20 microseconds of which one takes two seconds. Allowed is that tile and all the others one after the other, each with
/// the way of its word there and back; and where the dear tile's worker was dealt others, the patience until they are taken over.
///
/// # Errors
/// Those of [`render`].
pub fn dear_tile(dear: u32, workers: usize, balance: Balance, seed: u64) -> Result<Judged, String> {
    let (little, much) = (Duration::from_micros(20), Duration::from_secs(2));
    let cost = |tile: TileId| if tile.0 == dear { much } else { little };
    let slowness = vec![1; workers];
    let course = render(&Trial { tiles: [16, 16], balance, slowness: &slowness, cost: &cost, seed })?;
    if course.lost > 0 {
        return Err(format!("{} workers were taken for dead", course.lost));
    }
    let allowed = much + 255 * (little + 4 * DELAY);
    Ok(Judged { share: course.took.div_duration_f64(allowed), course })
}
