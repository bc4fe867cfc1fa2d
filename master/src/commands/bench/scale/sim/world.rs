//! The cluster: what happens when.

use super::transport::{Later, Stream, Way};
use super::{Fault, Frame, Plot, id, name};
use crate::commands::bench::scale::medium::{Direction, Medium};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::time::Duration;
use tessera_master::MasterWork;
use tessera_master::coordinator::{Coordinator, FrameStatus, Output};
use tessera_wire::{
    Abilities, AbortCode, BatchHeader, Coding, FrameId, Hello, PackId, Rays, Rect, Role, TileCoding,
    TileEntry, TileGrid, ToMaster, ToWorker, Token, Version, codec,
};
use tessera_worker::session::{Action, Batch, RenderTask, RenderedTile, Session, TileName};

const PACK: PackId = PackId([5; 32]);

pub struct World<'a> {
    plot: &'a Plot<'a>,
    master: Coordinator,
    crew: Vec<Worker>,
    medium: Medium,
    happenings: BinaryHeap<Reverse<Scheduled>>,
    scheduled: u64,
    now: Duration,
    /// Until when the master is at work, and how long it was in all.
    busy_until: Duration,
    work: MasterWork,
    /// When its deadline was looked at last.
    looked: Duration,
    /// When the first frame began.
    begun: Duration,
    frame: usize,
}

struct Worker {
    session: Session,
    is_there: bool,
    speed: f64,
    up: Way,
    down: Way,
    /// Messages on their way, by stream and number.
    to_worker: BTreeMap<(Stream, u64), ToWorker>,
    to_master: BTreeMap<(Stream, u64), Upward>,
    /// Tiles in hand, by their number.
    in_hand: VecDeque<(u64, RenderTask)>,
    begun: u64,
    idle_since: Duration,
}

enum Upward {
    Message(ToMaster),
    Tile(FrameId, Box<TileEntry>, Vec<u8>, u64),
}

struct Scheduled {
    at: Duration,
    order: u64,
    happening: Happening,
}

enum Happening {
    Link(usize, Direction, Later),
    /// The master is free for what has come.
    Master(usize, Box<Upward>),
    Worker(usize, Box<ToWorker>),
    Rendered(usize, u64, Box<RenderedTile>),
    Stopped(usize, TileName),
    BatchSent(usize),
    Fault(Fault),
    Missed(usize),
}

impl<'a> World<'a> {
    /// Workers have joined and hold the pack, all but those that join later.
    pub fn gather(plot: &'a Plot<'a>) -> Result<Self, String> {
        let worker = |(index, &speed): (usize, &f64)| Worker {
            session: Session::start(hello(index), None, 1, Duration::ZERO),
            is_there: true,
            speed,
            up: Way::new(plot.link, Direction::Up, index as u32),
            down: Way::new(plot.link, Direction::Down, index as u32),
            to_worker: BTreeMap::new(),
            to_master: BTreeMap::new(),
            in_hand: VecDeque::new(),
            begun: 0,
            idle_since: Duration::ZERO,
        };
        let mut world = Self {
            plot,
            master: Coordinator::new(None),
            crew: plot.speeds.iter().enumerate().map(worker).collect(),
            medium: Medium::new(plot.link),
            happenings: BinaryHeap::new(),
            scheduled: 0,
            now: Duration::ZERO,
            busy_until: Duration::ZERO,
            work: MasterWork::default(),
            looked: Duration::ZERO,
            begun: Duration::ZERO,
            frame: 0,
        };
        let late: Vec<_> = plot
            .faults
            .iter()
            .filter_map(|fault| match fault {
                Fault::Joins { worker, .. } => Some(*worker),
                _ => None,
            })
            .collect();
        // Joining and loading are not what is simulated: they are talked through without a link.
        for worker in 0..world.crew.len() {
            let connected = world.master.connected(world.now);
            debug_assert_eq!(connected, id(worker));
            if late.contains(&worker) {
                world.crew[worker].is_there = false;
            } else {
                world.join(worker);
            }
        }
        world.master.load(PACK, 1, world.now);
        world.talk();
        if world.master.holders().count() + late.len() != world.crew.len() {
            return Err("not all workers hold the pack".into());
        }
        Ok(world)
    }

    /// Renders all frames.
    pub fn render_all(mut self) -> Result<Vec<Frame>, String> {
        self.begun = self.now;
        for &fault in self.plot.faults {
            let at = match fault {
                Fault::Slows { at, .. } | Fault::Dies { at, .. } | Fault::Joins { at, .. } => at,
            };
            self.schedule(self.begun + at, Happening::Fault(fault));
        }
        (0..self.plot.frames).map(|number| self.render(number)).collect()
    }

    fn render(&mut self, number: usize) -> Result<Frame, String> {
        self.frame = number;
        let count =
            |world: &Self| world.crew.iter().flat_map(|w| [&w.up, &w.down]).map(|way| way.bytes).sum::<u64>();
        let before = count(self);
        self.work = MasterWork::default();
        let round_trip = Duration::from_secs_f64(2e-3 * self.plot.link.latency_ms) + 2 * self.plot.costs.wake;
        for worker in 0..self.crew.len() {
            self.master.round_trip(id(worker), round_trip);
        }
        let frame = self.master.begin(self.plot.job, self.now).map_err(|e| e.to_string())?;
        self.carry_out();
        while self.master.status(frame) == FrameStatus::Pending {
            self.step()?;
        }
        let outcome = match self.master.status(frame) {
            FrameStatus::Done => {
                self.master.finish(frame, self.now).ok_or("a frame that is done has no outcome")?
            }
            status => return Err(format!("{}: the frame ends as {status:?}", name(self.plot.job.balance))),
        };
        self.carry_out();
        let job = self.plot.job;
        let whole = Rect { x: 0, y: 0, width: job.width, height: job.height };
        if outcome.image.data() != pixels(whole, number) {
            return Err(format!("{}: frame {number} has wrong pixels", name(job.balance)));
        }
        let after = count(self);
        Ok(Frame {
            took: outcome.timings.frame,
            bytes: after - before,
            tiles: outcome.tiles,
            master: self.work,
            dropped: outcome.dropped_tiles,
            tile: outcome.tile,
            count: outcome.count,
            why: outcome.why,
        })
    }

    /// Lets the next thing happen.
    fn step(&mut self) -> Result<(), String> {
        // A deadline that is late by a millisecond makes no difference to many workers; asking for it each time would.
        let is_due = self.crew.len() <= 512 || self.now >= self.looked + Duration::from_millis(1);
        let deadline = if is_due { self.master.deadline() } else { None };
        if is_due {
            self.looked = self.now;
        }
        let next = self.happenings.peek().map(|Reverse(next)| next.at);
        match (next, deadline.or_else(|| if next.is_none() { self.master.deadline() } else { None })) {
            (None, None) => Err("nothing is under way, and nobody waits: the cluster hangs".into()),
            (Some(at), deadline) if deadline.is_none_or(|deadline| at <= deadline) => {
                if let Some(Reverse(Scheduled { happening, .. })) = self.happenings.pop() {
                    self.now = at;
                    self.happen(happening);
                }
                Ok(())
            }
            (_, deadline) => {
                self.now = self.now.max(deadline.unwrap_or(self.now));
                self.master.tick(self.now);
                self.carry_out();
                Ok(())
            }
        }
    }

    fn happen(&mut self, happening: Happening) {
        match happening {
            Happening::Link(worker, direction, later) => self.on_link(worker, direction, later),
            Happening::Master(worker, input) => {
                match *input {
                    Upward::Message(message) => self.master.message(id(worker), message, self.now),
                    Upward::Tile(frame, entry, pixels, bytes) => {
                        self.master.tile(id(worker), frame, &entry, &pixels, bytes, self.now);
                    }
                }
                self.carry_out();
            }
            Happening::Worker(worker, message) => {
                self.session(worker, |s| s.message(*message));
            }
            Happening::Rendered(worker, number, tile) => {
                let hand = &mut self.crew[worker].in_hand;
                let Some(place) = hand.iter().position(|(other, _)| *other == number) else { return };
                hand.remove(place);
                self.crew[worker].idle_since = self.now;
                let finished = self.now;
                self.session(worker, |s| s.rendered(RenderedTile { finished, ..*tile }));
            }
            Happening::Stopped(worker, tile) => {
                self.crew[worker].idle_since = self.now;
                self.session(worker, |s| s.rendering_stopped(tile));
            }
            Happening::BatchSent(worker) => self.session(worker, Session::batch_sent),
            Happening::Fault(Fault::Slows { worker, times, .. }) => self.crew[worker].speed /= times,
            Happening::Fault(Fault::Dies { worker, noticed, .. }) => {
                self.crew[worker].is_there = false;
                self.schedule(self.now + noticed, Happening::Missed(worker));
            }
            Happening::Fault(Fault::Joins { worker, .. }) => {
                self.crew[worker].is_there = true;
                self.join(worker);
                self.talk();
            }
            Happening::Missed(worker) => {
                self.master.lost(id(worker), AbortCode::Done, "it is gone".into(), self.now);
                self.carry_out();
            }
        }
    }

    fn on_link(&mut self, worker: usize, direction: Direction, later: Later) {
        let (now, medium) = (self.now, &mut self.medium);
        let state = &mut self.crew[worker];
        let (way, back) = match direction {
            Direction::Up => (&mut state.up, &mut state.down),
            Direction::Down => (&mut state.down, &mut state.up),
        };
        let (mut complete, mut more, mut answers) = (Vec::new(), Vec::new(), Vec::new());
        match later {
            Later::Arrives(packet) => {
                complete = way.arrive(&packet, back);
                // What it acknowledges may open the other direction's window.
                answers = back.send(way, medium, now);
                answers.extend(back.acknowledge(way, medium, now));
            }
            Later::Acknowledge(received) => {
                // Of packets of the other direction.
                more = way.acknowledge_late(back, received, medium, now);
            }
            Later::Missed(packet) => more = way.resend(packet, medium, now),
        }
        let opposite = if direction == Direction::Up { Direction::Down } else { Direction::Up };
        for (at, later) in more {
            self.schedule(at, Happening::Link(worker, direction, later));
        }
        for (at, later) in answers {
            self.schedule(at, Happening::Link(worker, opposite, later));
        }
        for key in complete {
            let state = &mut self.crew[worker];
            match direction {
                Direction::Up => {
                    let Some(input) = state.to_master.remove(&key) else { continue };
                    let costs = self.plot.costs;
                    let takes = match &input {
                        Upward::Tile(..) => costs.master_tile,
                        Upward::Message(_) => costs.master_message,
                    };
                    self.busy_until = self.busy_until.max(self.now + costs.wake) + takes;
                    self.work.busy += takes;
                    self.work.messages += 1;
                    self.schedule(self.busy_until, Happening::Master(worker, Box::new(input)));
                }
                Direction::Down => {
                    let Some(message) = state.to_worker.remove(&key) else { continue };
                    let at = self.now + self.plot.costs.wake;
                    self.schedule(at, Happening::Worker(worker, Box::new(message)));
                }
            }
        }
    }

    fn session(&mut self, worker: usize, act: impl FnOnce(&mut Session)) {
        if self.crew[worker].is_there {
            act(&mut self.crew[worker].session);
            self.carry_out_of(worker);
        }
    }

    /// Does what the master wants; each message takes it some time.
    fn carry_out(&mut self) {
        let mut at = self.now;
        while let Some(output) = self.master.poll() {
            match output {
                Output::Send(worker, message) => {
                    at += self.plot.costs.master_message;
                    self.work.busy += self.plot.costs.master_message;
                    self.work.messages += 1;
                    self.busy_until = self.busy_until.max(at);
                    let bytes = codec::encode(&message).map_or(0, |bytes| bytes.len());
                    let worker = worker.0 as usize;
                    let state = &mut self.crew[worker];
                    let number = state.down.put(Stream::Control, bytes);
                    state.to_worker.insert((Stream::Control, number), message);
                    let sent = state.down.send(&mut state.up, &mut self.medium, at);
                    for (at, later) in sent {
                        self.schedule(at, Happening::Link(worker, Direction::Down, later));
                    }
                }
                Output::SendPack(..) | Output::Event(_) => {}
                Output::Close(worker, _) => self.crew[worker.0 as usize].is_there = false,
            }
        }
    }

    /// Does what a worker wants.
    fn carry_out_of(&mut self, worker: usize) {
        while let Some(action) = self.crew[worker].session.poll() {
            match action {
                Action::Send(message) => self.up(worker, Stream::Control, Upward::Message(message), 0),
                Action::Receive { pack, .. } => self.crew[worker].session.pack_reserved(pack, Ok(())),
                Action::Render(task) => self.begin(worker, task),
                Action::StopRendering(tiles) => {
                    for tile in tiles {
                        let hand = &mut self.crew[worker].in_hand;
                        let Some(place) = hand.iter().position(|(_, task)| task.name() == tile) else {
                            continue;
                        };
                        hand.remove(place);
                        self.schedule(self.now + self.plot.costs.wake, Happening::Stopped(worker, tile));
                    }
                }
                Action::Return(batch) => self.give_back(worker, batch),
                Action::Over(_) => self.crew[worker].is_there = false,
            }
        }
    }

    fn begin(&mut self, worker: usize, task: RenderTask) {
        let time =
            (self.plot.cost)(self.frame, task.rect).div_f64(self.crew[worker].speed) + self.plot.costs.wake;
        let state = &mut self.crew[worker];
        state.begun += 1;
        state.in_hand.push_back((state.begun, task));
        let idle = self.now.saturating_sub(state.idle_since);
        let pixels = pixels(task.rect, self.frame);
        let tile = RenderedTile { idle, ..RenderedTile::new(task, pixels, time, Rays::default()) };
        let begun = state.begun;
        self.schedule(self.now + time, Happening::Rendered(worker, begun, Box::new(tile)));
    }

    fn give_back(&mut self, worker: usize, batch: Batch) {
        let Batch { header, pixels, frame, .. } = batch;
        let is_packed = frame.coding != Coding::Raw;
        let mut entries = Vec::with_capacity(header.tiles.len());
        let grid = TileGrid::new(frame.width, frame.height, frame.tile);
        let mut coding = 0.0;
        for entry in &header.tiles {
            let rect = grid.as_ref().ok().and_then(|grid| grid.rect(entry.tile));
            let length = rect.filter(|_| is_packed).map_or(entry.pixel_bytes, |rect| (self.plot.coded)(rect));
            let ns = if is_packed { self.plot.costs.coding_ns * f64::from(entry.pixel_bytes) } else { 0.0 };
            coding += ns;
            let form = if length < entry.pixel_bytes { TileCoding::Packed } else { TileCoding::Raw };
            let us = (ns * 1e-3) as u32;
            entries.push(TileEntry { length, coding: form, coding_us: us, waited_us: us, ..*entry });
        }
        let sent = BatchHeader { frame: header.frame, tiles: entries };
        let mut header_bytes = codec::encode(&sent).map_or(0, |bytes| bytes.len());
        // Coding takes the worker's other threads; what it delays is the bytes.
        let at = self.now + Duration::from_secs_f64(coding * 1e-9);
        let frame = sent.frame;
        for (entry, pixels) in sent.tiles.into_iter().zip(pixels) {
            let bytes = std::mem::take(&mut header_bytes) + entry.length as usize;
            let tile = Upward::Tile(frame, Box::new(entry), pixels, bytes as u64);
            self.put_up(worker, Stream::Bulk, tile, bytes);
        }
        self.flush_up(worker, at);
        self.schedule(at, Happening::BatchSent(worker));
    }

    fn up(&mut self, worker: usize, stream: Stream, input: Upward, more: usize) {
        let bytes = match &input {
            Upward::Message(message) => codec::encode(message).map_or(0, |bytes| bytes.len()),
            Upward::Tile(..) => more,
        };
        self.put_up(worker, stream, input, bytes);
        self.flush_up(worker, self.now);
    }

    fn put_up(&mut self, worker: usize, stream: Stream, input: Upward, bytes: usize) {
        let state = &mut self.crew[worker];
        let number = state.up.put(stream, bytes);
        state.to_master.insert((stream, number), input);
    }

    fn flush_up(&mut self, worker: usize, at: Duration) {
        let state = &mut self.crew[worker];
        let sent = state.up.send(&mut state.down, &mut self.medium, at);
        for (at, later) in sent {
            self.schedule(at, Happening::Link(worker, Direction::Up, later));
        }
    }

    /// Says `Hello` for a worker.
    fn join(&mut self, worker: usize) {
        self.master.message(id(worker), ToMaster::Hello(hello(worker)), self.now);
    }

    /// Master and workers say what they have to say at once, until nobody has anything to say; of frames nothing is lost, as that is sent over
    /// the link again.
    fn talk(&mut self) {
        let mut is_busy = true;
        while is_busy {
            is_busy = false;
            while let Some(output) = self.master.poll() {
                is_busy = true;
                match output {
                    Output::Send(worker, message @ (ToWorker::Frame(_) | ToWorker::Assign { .. })) => {
                        let worker = worker.0 as usize;
                        let at = self.now + self.plot.costs.wake;
                        self.schedule(at, Happening::Worker(worker, Box::new(message)));
                    }
                    Output::Send(worker, message) => self.crew[worker.0 as usize].session.message(message),
                    Output::SendPack(worker, pack) => {
                        self.crew[worker.0 as usize].session.pack_received(pack, Ok(()))
                    }
                    Output::Close(worker, _) => self.crew[worker.0 as usize].is_there = false,
                    Output::Event(_) => {}
                }
            }
            for worker in 0..self.crew.len() {
                if !self.crew[worker].is_there {
                    continue;
                }
                while let Some(action) = self.crew[worker].session.poll() {
                    is_busy = true;
                    match action {
                        // It has said that when it joined.
                        Action::Send(ToMaster::Hello(_)) => {}
                        Action::Send(message) => self.master.message(id(worker), message, self.now),
                        Action::Receive { pack, .. } => self.crew[worker].session.pack_reserved(pack, Ok(())),
                        Action::Render(task) => self.begin(worker, task),
                        Action::Return(batch) => self.give_back(worker, batch),
                        Action::StopRendering(_) | Action::Over(_) => {}
                    }
                }
            }
        }
    }

    fn schedule(&mut self, at: Duration, happening: Happening) {
        self.scheduled += 1;
        self.happenings.push(Reverse(Scheduled { at, order: self.scheduled, happening }));
    }
}

impl PartialEq for Scheduled {
    fn eq(&self, other: &Self) -> bool {
        (self.at, self.order) == (other.at, other.order)
    }
}

impl Eq for Scheduled {}

impl PartialOrd for Scheduled {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Scheduled {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.order).cmp(&(other.at, other.order))
    }
}

fn hello(index: usize) -> Hello {
    Hello {
        versions: Version::supported_numbers(),
        token: Token::default(),
        name: format!("virtual-{index}"),
        role: Role::Worker(Abilities {
            memory: 0,
            threads: 1,
            backend: "simulated".into(),
            numeric_class: "simulated".into(),
            speed: 0,
            note: String::new(),
        }),
    }
}

/// What the pixels of `rect` are in a frame: colours that depend on frame and place alone.
fn pixels(rect: Rect, frame: usize) -> Vec<u8> {
    let mut pixels = Vec::with_capacity(rect.width as usize * rect.height as usize * 4);
    for y in rect.y..rect.y + rect.height {
        let row = y.wrapping_mul(0x85EB_CA77) ^ (frame as u32).wrapping_mul(0xC2B2_AE3D);
        for x in rect.x..rect.x + rect.width {
            pixels.extend((x.wrapping_mul(0x9E37_79B1) ^ row).to_le_bytes());
        }
    }
    pixels
}
