//! Who renders which frame: classes and groups of workers, those that come late, and what is done when the last one is lost.

use super::{Active, BeginError, Coordinator, Event, Group, Output};
use crate::{
    FrameJob, WorkerReport,
    dispatch::{Look, fastest, tile_side},
    session::Session,
};
use std::{collections::BTreeSet, time::Duration};
use tessera_wire::{FrameId, PackId, PackRefusal, ToWorker, WorkerId, limits};

impl Coordinator {
    pub(super) fn begin_as(
        &mut self,
        job: &FrameJob,
        group: Option<Group>,
        gives_rows: bool,
        now: Duration,
    ) -> Result<FrameId, BeginError> {
        let id = FrameId(self.frames_begun + 1);
        let pack = self.pack.map_or(PackId([0; 32]), |offer| offer.pack);
        self.known.look_at(Look::from(&job.to_wire(id, pack)));
        let (holders, mean) = (self.holders().count(), self.known.mean_tile());
        let side = || tile_side(job.width, job.height, holders, mean);
        let job = &FrameJob { tile: if job.tile == 0 { side() } else { job.tile }, ..job.clone() };
        let frame = job.to_wire(id, pack);
        let mut active = Active::new(frame, job, gives_rows, now)?;
        let class = self.fastest_class().filter(|_| !job.mix);
        let crew = self.crew(class.as_deref());
        let workers = group.map_or_else(|| crew.clone(), |group| group.of(&crew));
        let begun = workers.iter().map(|&worker| self.begun_by(worker)).max();
        // (Without workers, memory for their images is what bounds them.)
        if begun.unwrap_or(self.frames.len()) >= Self::FRAMES {
            return Err(BeginError::Full);
        }
        self.frames_begun += 1;
        active.group = group;
        let takes_part = |w: &WorkerId| workers.contains(w) || self.rejection(*w).is_some();
        active.reports = self.joined().filter(takes_part).map(|w| (w, self.report_of(w))).collect();
        if workers.is_empty() {
            active.alone = Some(now + self.patience);
            active.given_up = self.patience.is_zero();
        }
        self.frames.push(active);
        if let Some(class) = class.clone().filter(|_| crew.len() < holders) {
            let (workers, idle) = (crew.len() as u32, (holders - crew.len()) as u32);
            self.outputs.push_back(Output::Event(Event::ClassChosen { class, workers, idle }));
        }
        if !workers.is_empty() {
            self.assemble(self.frames.len() - 1, class, workers, now);
        }
        self.judge(now);
        Ok(id)
    }

    /// Gives a frame to `workers`, from its first tile on.
    fn assemble(&mut self, at: usize, class: Option<String>, workers: Vec<WorkerId>, now: Duration) {
        let active = &mut self.frames[at];
        let assignments = active.assemble(class, &workers, &self.known, now);
        for (&worker, &worn) in &self.worn {
            active.dispatch.wear(worker, worn);
        }
        let frame = active.frame;
        for worker in workers {
            self.outputs.push_back(Output::Send(worker, ToWorker::Frame(frame)));
        }
        self.assign(at, assignments);
    }

    /// Settles which frames are judged: those whose workers have no earlier one to render first. The first that is not complete is one of
    /// them, so that a worker that is dead is found out, whatever else waits for it.
    pub(super) fn judge(&mut self, now: Duration) {
        let mut busy = BTreeSet::<WorkerId>::new();
        for active in &mut self.frames {
            if active.is_settled() {
                if std::mem::take(&mut active.is_judged) {
                    self.worn.extend(active.dispatch.worn(now));
                }
                continue;
            }
            let is_first = active.members.is_disjoint(&busy);
            busy.extend(&active.members);
            if is_first && !active.is_judged {
                active.judge(&self.worn, now);
            }
            active.is_judged = is_first;
        }
    }

    /// Of the classes whose workers hold the pack, the one that is the fastest together.
    fn fastest_class(&self) -> Option<String> {
        let abilities = self.holders().filter_map(|worker| self.sessions.get(&worker)?.abilities());
        fastest(abilities.map(|a| (a.numeric_class.as_str(), a.speed))).map(String::from)
    }

    /// Workers that hold the pack, of `class` if it is one, in the order of joining.
    fn crew(&self, class: Option<&str>) -> Vec<WorkerId> {
        let is_of_class = |worker: &WorkerId| class.is_none_or(|class| self.class_of(*worker) == Some(class));
        self.holders().filter(is_of_class).collect()
    }

    /// Frames that `worker` has begun.
    fn begun_by(&self, worker: WorkerId) -> usize {
        self.frames.iter().filter(|active| active.members.contains(&worker)).count()
    }

    fn report_of(&self, worker: WorkerId) -> WorkerReport {
        let abilities = self.sessions.get(&worker).and_then(Session::abilities);
        let new = WorkerReport::new(self.name(worker).unwrap_or("?"), abilities, self.rejection(worker));
        WorkerReport { round_trip: self.known.shortest_round_trip_of(worker), ..new }
    }

    fn rejection(&self, worker: WorkerId) -> Option<&PackRefusal> {
        self.sessions.get(&worker)?.rejection()
    }

    /// Sees to it that frames that have lost their last worker find others, if there are any with room for them.
    pub(super) fn revive(&mut self, now: Duration) {
        let orphans: Vec<_> = self.frames.iter().filter(|a| a.is_orphan()).map(|a| a.id).collect();
        for id in orphans {
            let Some(at) = self.frames.iter().position(|active| active.id == id) else { continue };
            let Active { job, class, .. } = &self.frames[at];
            let (mix, class) = (job.mix, class.clone());
            let has_room = |worker: &WorkerId| self.begun_by(*worker) < limits::FRAMES;
            // Those of its class know nothing of it where it was a group's.
            let same = if mix || class.is_some() { self.crew(class.as_deref()) } else { Vec::new() };
            let same: Vec<_> = same.into_iter().filter(has_room).collect();
            if !same.is_empty() {
                self.adopt(at, same, now);
            } else if !mix && let Some(to) = self.fastest_class().filter(|to| class.as_ref() != Some(to)) {
                let workers: Vec<_> = self.crew(Some(&to)).into_iter().filter(has_room).collect();
                if !workers.is_empty() {
                    self.change_class(at, to, workers, now);
                }
            }
        }
    }

    /// A frame whose group is lost goes on with others of its class.
    fn adopt(&mut self, at: usize, workers: Vec<WorkerId>, now: Duration) {
        let at = self.renumber(at);
        self.frames[at].group = None;
        self.take_on(at, &workers, now);
    }

    /// A frame that has lost the last worker of its class goes to another class: from its first tile on, so that no picture mixes
    /// classes.
    fn change_class(&mut self, at: usize, to: String, workers: Vec<WorkerId>, now: Duration) {
        let reports: Vec<_> = workers.iter().map(|&worker| (worker, self.report_of(worker))).collect();
        let at = self.renumber(at);
        let active = &mut self.frames[at];
        active.reports.extend(reports);
        let (frame, dropped) = (active.id, active.dispatch.done());
        if let Some(from) = active.class.clone() {
            let to = to.clone();
            self.outputs.push_back(Output::Event(Event::Restarted { frame, from, to, dropped }));
        }
        self.assemble(at, Some(to), workers, now);
    }

    /// Gives a frame that nobody has a part in a new number, as workers take frames in the order of these; its place then.
    fn renumber(&mut self, at: usize) -> usize {
        self.frames_begun += 1;
        let mut active = self.frames.remove(at);
        active.frame.frame = FrameId(self.frames_begun);
        active.is_judged = false;
        self.frames.push(active);
        self.frames.len() - 1
    }

    /// `workers` take part in a frame from now on.
    fn take_on(&mut self, at: usize, workers: &[WorkerId], now: Duration) {
        let reports: Vec<_> = workers.iter().map(|&worker| (worker, self.report_of(worker))).collect();
        let active = &mut self.frames[at];
        active.reports.extend(reports);
        active.members.extend(workers);
        active.alone = None;
        for &worker in workers {
            self.outputs.push_back(Output::Send(worker, ToWorker::Frame(active.frame)));
        }
        let assignments = active.dispatch.join(workers, now);
        for &worker in workers {
            active.dispatch.wear(worker, self.worn.get(&worker).copied().unwrap_or(0.0));
        }
        self.assign(at, assignments);
    }

    /// A worker that has just taken the pack takes part in the frames of it that are under way, those of its group where there are any.
    pub(super) fn join_frames(&mut self, worker: WorkerId, now: Duration) {
        let Some(class) = self.class_of(worker).map(String::from) else { return };
        for at in 0..self.frames.len() {
            let active = &self.frames[at];
            let holds = self.sessions.get(&worker).is_some_and(|s| s.holds(active.frame.pack));
            let crew = || self.crew(active.class.as_deref().filter(|_| !active.job.mix));
            let is_of_group = |group: Group| active.is_orphan() || group.takes(worker, &crew());
            let is_wanted = holds
                && !active.dispatch.is_done()
                && active.takes(&class)
                && active.group.is_none_or(is_of_group)
                && !active.members.contains(&worker)
                && self.begun_by(worker) < limits::FRAMES;
            if is_wanted {
                let active = &mut self.frames[at];
                if !active.job.mix {
                    active.class = Some(class.clone());
                }
                self.take_on(at, &[worker], now);
            }
        }
        // Frames of other classes do without it, unless nobody of these is left.
        self.revive(now);
        self.judge(now);
    }

    /// `worker` is gone: others get what it had.
    pub(super) fn over(&mut self, worker: WorkerId, reason: String, now: Duration) {
        self.outputs.push_back(Output::Event(Event::Lost(worker, reason.clone())));
        for at in 0..self.frames.len() {
            let assignments = self.frames[at].lost(worker, &reason, now);
            self.assign(at, assignments);
        }
        self.revive(now);
        for active in &mut self.frames {
            if active.dispatch.workers() == 0 && active.alone.is_none() {
                active.alone = Some(now + self.patience);
                active.given_up = self.patience.is_zero() && !active.dispatch.is_done();
            }
        }
        self.judge(now);
    }
}

impl Group {
    /// Its workers of `crew`, or all where it has none.
    fn of(self, crew: &[WorkerId]) -> Vec<WorkerId> {
        let own: Vec<_> = (0..).zip(crew).filter(|&(place, _)| self.has(place)).map(|(_, &w)| w).collect();
        if own.is_empty() { crew.to_vec() } else { own }
    }

    /// Whether `worker`, one of `crew`, is one of its workers.
    fn takes(self, worker: WorkerId, crew: &[WorkerId]) -> bool {
        crew.iter().position(|&other| other == worker).is_some_and(|place| self.has(place as u32))
    }

    fn has(self, place: u32) -> bool {
        let count = self.count.max(1);
        place % count == self.index % count
    }
}
