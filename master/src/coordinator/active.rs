//! A frame that is being rendered.

use super::{BeginError, Group, Outcome};
use crate::{
    ClassDifference, ClassPart, FrameJob, TileRecord, Timings, WorkerReport,
    bands::{Canvas, Fault},
    dispatch::{
        Assignment, Check, Checks, Dispatch, Knowledge, Look, Seen, Shown, View, Violation, choose, plan,
    },
    image::NoRoom,
};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::Duration,
};
use tessera_wire::{
    Abilities, Attempt, Frame, FrameId, PackRefusal, Rays, TileEntry, TileGrid, TileId, ToWorker, WorkerId,
    limits,
};

#[derive(Debug)]
pub(super) struct Active {
    /// What the driver names it by. The number that workers know, `frame.frame`, is another one after it has changed hands.
    pub(super) id: FrameId,
    pub(super) frame: Frame,
    pub(super) job: FrameJob,
    /// Who is to render it; `None`: all of its class.
    pub(super) group: Option<Group>,
    /// Living workers that it was announced to.
    pub(super) members: BTreeSet<WorkerId>,
    /// Whether none of these has an earlier frame to render first, so that who is silent is late with this one.
    pub(super) is_judged: bool,
    /// The numeric class that renders it; `None` for a mix, and while nobody has a part.
    pub(super) class: Option<String>,
    pub(super) dispatch: Dispatch,
    pub(super) reports: Vec<(WorkerId, WorkerReport)>,
    /// Until when the next tile of a worker must be in, for as long as it owes pixels.
    pub(super) due: BTreeMap<WorkerId, Duration>,
    pub(super) late: u64,
    /// Until when a frame without workers waits for one.
    pub(super) alone: Option<Duration>,
    pub(super) given_up: bool,
    pub(super) last_rendered: Duration,
    /// Set when rows that must wait do not fit any more.
    pub(super) no_room: Option<NoRoom>,
    grid: TileGrid,
    image: Canvas,
    rays: Rays,
    tiles: Vec<TileRecord>,
    /// Of which tiles and attempts.
    returned: BTreeSet<(TileId, Attempt)>,
    /// Who began it.
    crew: Vec<WorkerId>,
    /// By worker, its last word that tiles are rendered, and bytes that have come since.
    words: BTreeMap<WorkerId, (Duration, u64)>,
    /// From whom each tile of the image is, for a mix.
    origins: BTreeMap<TileId, WorkerId>,
    /// How many tiles each `Cancel` had that has not been answered.
    cancelling: BTreeMap<WorkerId, VecDeque<u32>>,
    checks: Option<Checks>,
    begun: Duration,
    /// Since when its workers have no earlier frame to render.
    first_since: Duration,
    /// When the last tile of the image came, and when it was said to be rendered.
    completed: Option<(Duration, Duration)>,
}

impl Active {
    /// A frame that nobody has a part in yet; [`Active::assemble`] comes next.
    pub(super) fn new(
        frame: Frame,
        job: &FrameJob,
        gives_rows: bool,
        now: Duration,
    ) -> Result<Self, BeginError> {
        let grid = frame.check()?;
        let image =
            if gives_rows { Canvas::bands(grid, job.format) } else { Canvas::whole(&grid, job.format)? };
        let (dispatch, _) = Dispatch::start(&grid, job.balance, job.samples, &[], now);
        Ok(Self {
            id: frame.frame,
            frame,
            job: job.clone(),
            group: None,
            members: BTreeSet::new(),
            is_judged: false,
            class: None,
            dispatch,
            reports: Vec::new(),
            due: BTreeMap::new(),
            late: 0,
            alone: None,
            given_up: false,
            last_rendered: now,
            no_room: None,
            grid,
            image,
            rays: Rays::default(),
            tiles: Vec::new(),
            returned: BTreeSet::new(),
            crew: Vec::new(),
            words: BTreeMap::new(),
            origins: BTreeMap::new(),
            cancelling: BTreeMap::new(),
            checks: None,
            begun: now,
            first_since: now,
            completed: None,
        })
    }

    /// Begins with `workers`, of `class` unless classes may be mixed: their first tiles. What others have rendered before is dropped,
    /// so that no picture mixes classes that may not.
    pub(super) fn assemble(
        &mut self,
        class: Option<String>,
        workers: &[WorkerId],
        known: &Knowledge,
        now: Duration,
    ) -> Vec<Assignment> {
        self.late += self.dispatch.dropped() + u64::from(self.dispatch.done());
        for (_, report) in &mut self.reports {
            (report.tiles, report.render) = (0, Duration::ZERO);
        }
        // The frame is complete only when each tile has come again.
        self.image.restart();
        (self.rays, self.alone) = (Rays::default(), None);
        self.tiles.clear();
        self.returned.clear();
        self.words.clear();
        self.due.clear();
        self.cancelling.clear();
        self.members = workers.iter().copied().collect();
        self.class = class;
        let in_order = self.image.may_wait().is_some() && self.job.image_bytes() > Self::IN_ORDER_BYTES;
        let camera = &self.frame.camera;
        let plan = plan(self.job.balance, &View { grid: &self.grid, camera, workers, known, in_order });
        self.frame.returns = plan.returns;
        self.crew = workers.to_vec();
        let (dispatch, assignments) = Dispatch::start_as(&self.grid, plan, self.job.samples, workers, now);
        self.dispatch = dispatch;
        if let Some(may_wait) = self.image.may_wait() {
            self.dispatch.keep_order(may_wait);
        }
        assignments
    }

    /// What the frame has shown of its workers and tiles.
    pub(super) fn teach(&self, known: &mut Knowledge) {
        let Some((completed, _)) = self.completed.filter(|_| known.is_of(Look::from(&self.frame))) else {
            return;
        };
        let shown = |record: &TileRecord| {
            let &(worker, _) = self.reports.get(record.worker)?;
            Some(Shown { tile: record.tile, worker, render: record.render })
        };
        let shown: Vec<_> = self.tiles.iter().filter_map(shown).collect();
        known.learn(&Seen {
            camera: &self.frame.camera,
            grid: &self.grid,
            shown: &shown,
            crew: &self.crew,
            took: completed.saturating_sub(self.begun.max(self.first_since)),
            wire_bytes: self.tiles.iter().map(|tile| tile.wire_bytes).sum(),
            way: self.dispatch.plan().way(),
        });
    }

    /// Images of more bytes are wanted in order: of others it does not matter which tiles wait for which.
    const IN_ORDER_BYTES: u64 = 256 << 20;

    /// Whether workers of `class` have a part in it.
    pub(super) fn takes(&self, class: &str) -> bool {
        self.job.mix || self.class.as_deref().is_none_or(|own| own == class)
    }

    /// Whether everything is in, comparisons of classes too.
    pub(super) fn is_over(&self) -> bool {
        self.dispatch.is_done() && self.checks.as_ref().is_none_or(Checks::is_over)
    }

    /// Whether nothing that workers do changes it any more.
    pub(super) fn is_settled(&self) -> bool {
        self.is_over() || self.given_up || self.no_room.is_some()
    }

    /// Whether it waits for anybody to render it.
    pub(super) fn is_orphan(&self) -> bool {
        self.dispatch.workers() == 0 && !self.dispatch.is_done() && !self.given_up
    }

    /// Its workers have no earlier frame any more: from `now` on they may be late with this one. `worn`: see [`Dispatch::worn`].
    pub(super) fn judge(&mut self, worn: &BTreeMap<WorkerId, f64>, now: Duration) {
        self.is_judged = true;
        self.first_since = now;
        self.dispatch.restart_clocks(now);
        for (&worker, &worn) in worn {
            self.dispatch.wear(worker, worn);
        }
        for due in self.due.values_mut() {
            *due = now + limits::RETURN_TIMEOUT;
        }
    }

    /// What takes back `tiles` of `worker`, which others have rendered.
    pub(super) fn cancel(&mut self, worker: WorkerId, tiles: Vec<TileId>) -> ToWorker {
        self.cancelling.entry(worker).or_default().push_back(tiles.len() as u32);
        ToWorker::Cancel { frame: self.frame.frame, tiles }
    }

    /// `worker` will not render so many of the tiles that it was told of first; what it gets next.
    pub(super) fn cancelled(
        &mut self,
        worker: WorkerId,
        tiles: u32,
        now: Duration,
    ) -> Result<Vec<Assignment>, String> {
        let asked = self.cancelling.get_mut(&worker).and_then(VecDeque::pop_front);
        match asked {
            Some(asked) if tiles <= asked => {}
            Some(asked) => return Err(format!("{tiles} of {asked} tiles said to be cancelled")),
            None => return Err("tiles said to be cancelled that were not".into()),
        }
        self.due.entry(worker).or_insert(now + limits::RETURN_TIMEOUT);
        self.dispatch.cancelled(worker, tiles, now).map_err(|violation| violation.to_string())
    }

    /// Puts a tile into the image: whether it was the first for its place, or what is wrong with it.
    pub(super) fn tile(
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
            u64::from(rect.width) * u64::from(rect.height) * self.job.format.bytes_per_pixel() as u64;
        if pixels.len() as u64 != expected {
            return Err(format!("tile {} has {} bytes instead of {expected}", entry.tile.0, pixels.len()));
        }
        let place = self.reports.iter().rposition(|(w, _)| *w == worker);
        let report = place.map(|place| &mut self.reports[place].1);
        let checks = self.checks.as_mut();
        if let Some(difference) = checks.and_then(|c| c.take(worker, entry.tile, entry.attempt)) {
            let in_image = self.image.get(rect);
            difference.add(self.job.format, &in_image.unwrap_or_default(), pixels);
            self.dispatch.compared(worker, now);
            if let Some(report) = report {
                report.bytes_returned += wire_bytes;
            }
            return Ok(false);
        }
        let first = self
            .dispatch
            .accept(worker, entry.tile, entry.attempt, now)
            .map_err(|violation| violation.to_string())?;
        let since_begin = |time: Duration| time.saturating_sub(self.begun);
        let assigned = self.dispatch.assigned_at(entry.tile, entry.attempt);
        // A worker that sends one again and again does not fill the report.
        let is_new = self.returned.insert((entry.tile, entry.attempt));
        self.tiles.extend(place.filter(|_| is_new).map(|worker| TileRecord {
            tile: entry.tile,
            attempt: entry.attempt,
            worker,
            assigned: assigned.map_or(Duration::ZERO, since_begin),
            received: since_begin(now),
            idle: micros(entry.idle_us),
            render: micros(entry.render_us),
            coding: micros(entry.coding_us),
            waited: micros(entry.waited_us),
            wire_bytes,
            pixel_bytes: entry.pixel_bytes,
            is_first: first,
        }));
        if let Some(report) = report {
            report.bytes_returned += wire_bytes;
            if first {
                report.tiles += 1;
                report.render += micros(entry.render_us);
            }
        }
        if first {
            match self.image.put(rect, pixels) {
                Ok(()) => {}
                Err(Fault::Tile(e)) => return Err(e.to_string()),
                Err(Fault::NoRoom(no_room)) => self.no_room = Some(no_room),
            }
            self.rays += entry.rays;
            self.due.insert(worker, now + limits::RETURN_TIMEOUT);
            if self.job.mix {
                self.origins.insert(entry.tile, worker);
            }
            if self.dispatch.is_done() {
                // Pixels may overtake the word that they are rendered: then rendering has hidden the return entirely.
                let rendered = if self.dispatch.all_rendered() { self.last_rendered } else { now };
                self.completed = Some((now, rendered));
            }
        }
        Ok(first)
    }

    /// `worker` has said that tiles are rendered; their pixels follow.
    pub(super) fn word(&mut self, worker: WorkerId, now: Duration) {
        self.words.insert(worker, (now, 0));
    }

    /// `bytes` more have come of `worker`: all since its last word, and within what time.
    pub(super) fn came(&mut self, worker: WorkerId, bytes: u64, now: Duration) -> Option<(u64, Duration)> {
        let (said, sum) = self.words.get_mut(&worker)?;
        *sum += bytes;
        Some((*sum, now.saturating_sub(*said)))
    }

    /// The next rows of the image that are complete, if it is given out by rows.
    pub(super) fn due_rows(&mut self) -> Option<Vec<u8>> {
        self.image.due_rows()
    }

    /// The image is complete: what other classes render of it once more, so that the report can say how far they differ.
    pub(super) fn compare_classes(&mut self, now: Duration) -> Vec<Assignment> {
        let parts = self.parts();
        if !self.job.mix || parts.len() < 2 {
            return Vec::new();
        }
        let classes: BTreeSet<&str> = parts.iter().map(|part| part.class.as_str()).collect();
        let class_of = self.reports.iter().map(|(worker, report)| (*worker, report.numeric_class.as_str()));
        let class_of: BTreeMap<_, _> = class_of.filter(|(_, class)| classes.contains(class)).collect();
        let mut tiles = BTreeMap::<&str, Vec<TileId>>::new();
        for (&tile, &worker) in &self.origins {
            if let Some(&class) = class_of.get(&worker) {
                tiles.entry(class).or_default().push(tile);
            }
        }
        let mut crews = BTreeMap::<&str, Vec<WorkerId>>::new();
        for worker in self.dispatch.staying() {
            if let Some(&class) = class_of.get(&worker) {
                crews.entry(class).or_default().push(worker);
            }
        }
        // Who renders what, by turns within a class.
        let mut wanted = Vec::new();
        for (turn, (class, tile)) in choose(&self.grid, &tiles).into_iter().enumerate() {
            for (&other, crew) in crews.iter().filter(|(other, _)| **other != class) {
                let pair = [class.min(other), class.max(other)].map(String::from);
                wanted.push((crew[turn % crew.len()], tile, pair));
            }
        }
        let (mut awaited, mut assignments) = (Vec::new(), Vec::new());
        for (worker, tile, classes) in wanted {
            if let Some(assignment) = self.dispatch.compare(worker, tile, now) {
                awaited.push(Check { worker, tile, attempt: assignment.attempt, classes });
                assignments.push(assignment);
            }
        }
        let within = self.dispatch.compare_within(awaited.len() as u32);
        self.checks = Some(Checks::new(awaited, now + within));
        assignments
    }

    /// Time has passed: nobody waits longer for comparisons than they are worth.
    pub(super) fn tick(&mut self, now: Duration) {
        if let Some(checks) = &mut self.checks {
            checks.tick(now);
        }
    }

    /// `worker` is gone; who gets its tiles.
    pub(super) fn lost(&mut self, worker: WorkerId, reason: &str, now: Duration) -> Vec<Assignment> {
        if let Some((_, report)) = self.reports.iter_mut().find(|(w, _)| *w == worker) {
            report.lost = Some(reason.into());
        }
        if let Some(checks) = &mut self.checks {
            checks.lost(worker);
        }
        self.members.remove(&worker);
        self.cancelling.remove(&worker);
        self.dispatch.lost(worker, now)
    }

    pub(super) fn deadline(&self) -> Option<Duration> {
        if self.is_settled() {
            return None;
        }
        let checks = self.checks.iter().filter_map(Checks::deadline);
        let returns = self.due().map(|(_, due)| due).chain(self.dispatch.deadline());
        returns.filter(|_| self.is_judged).chain(self.alone).chain(checks).min()
    }

    /// Workers that owe pixels, and until when the next tile of each must be in.
    pub(super) fn due(&self) -> impl Iterator<Item = (WorkerId, Duration)> {
        self.due.iter().map(|(&worker, &due)| (worker, due)).filter(|&(worker, _)| self.dispatch.owes(worker))
    }

    /// The classes of the tiles in the image, those with most tiles first, as many as are told of.
    fn parts(&self) -> Vec<ClassPart> {
        let mut parts = BTreeMap::<&str, ClassPart>::new();
        for (_, report) in self.reports.iter().filter(|(_, report)| report.rejected.is_none()) {
            let class = report.numeric_class.as_str();
            let new = || ClassPart { class: class.into(), workers: 0, tiles: 0 };
            let part = parts.entry(class).or_insert_with(new);
            part.workers += 1;
            part.tiles += report.tiles;
        }
        let mut parts: Vec<_> = parts.into_values().filter(|part| part.tiles > 0).collect();
        parts.sort_by_key(|part| Reverse(part.tiles));
        parts.truncate(limits::CLASSES);
        parts
    }

    /// `idle`: workers that had no part because of their class.
    pub(super) fn outcome(self, idle: u32) -> Option<Outcome> {
        let (completed, rendered) = self.completed?;
        let since_begin = |time: Duration| time.saturating_sub(self.begun);
        let timings = Timings {
            send_scene: Duration::ZERO,
            render: since_begin(rendered),
            return_: completed.saturating_sub(rendered),
            frame: since_begin(completed),
        };
        let classes = self.parts();
        let format = self.job.format;
        let found = self.checks.into_iter().flat_map(Checks::into_found);
        let differences = found.map(|(classes, found)| ClassDifference {
            classes,
            tiles: found.tiles,
            pixels: found.pixels,
            differing: found.differing,
            max_abs: found.max_abs,
            psnr_db: found.psnr_db(format),
        });
        Some(Outcome {
            image: self.image.into_rest(),
            classes,
            differences: differences.collect(),
            idle,
            workers: self.reports.into_iter().map(|(_, report)| report).collect(),
            timings,
            rays: self.rays,
            dropped_tiles: self.dispatch.dropped() + self.late,
            coding: self.job.coding.unwrap_or_default(),
            tiles: self.tiles,
            tile: self.frame.tile,
            count: self.dispatch.total(),
            why: self.dispatch.plan().why.clone(),
        })
    }
}

fn micros(time: u32) -> Duration {
    Duration::from_micros(time.into())
}

impl WorkerReport {
    /// Of a worker that takes part from now on, or has `rejected` the pack.
    pub(super) fn new(name: &str, abilities: Option<&Abilities>, rejected: Option<&PackRefusal>) -> Self {
        let text = |of: fn(&Abilities) -> &String| abilities.map_or("?".into(), |a| of(a).clone());
        Self {
            name: name.into(),
            backend: text(|a| &a.backend),
            numeric_class: text(|a| &a.numeric_class),
            note: text(|a| &a.note),
            round_trip: None,
            tiles: 0,
            render: Duration::ZERO,
            bytes_returned: 0,
            lost: None,
            rejected: rejected.map(ToString::to_string),
        }
    }
}
