//! Workers that have joined, and what they are asked for.

mod sequence;

use crate::{
    FrameJob, FrameResult, Link, MasterWork, OutputError, PngStream, Progress, Timings, Traffic,
    admission::{Admission, Admitted},
    coding::{CodingChoice, Shown},
    coordinator::{BeginError, Coordinator, Event, FrameStatus, Outcome, Output},
    door::{self, Door, Guest},
    line::{Counters, Input, Line, Tile},
    net, spawn,
    spawn::Detour,
    transport::{self, PipeError},
};
use quinn::VarInt;
use std::{
    collections::BTreeMap,
    ffi::OsString,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};
use tessera_pack::Pack;
use tessera_trust::Identity;
use tessera_wire::{
    AbortCode, Fingerprint, FrameId, JoinString, LocalTicket, PackId, Refusal, ToMaster, WorkerId, limits,
};
use tokio::{
    process::{Child, ChildStdin},
    sync::mpsc,
    task::JoinSet,
    time::{Instant, timeout, timeout_at},
};

pub use sequence::{FrameQueue, SequenceConfig, SequenceFrame, Stale};

/// Where workers come from.
pub enum Workers {
    /// Processes on this machine, started and ended with the cluster.
    Local(LocalWorkers),
    /// Connections that exist, see [`Link::in_memory`].
    Links(Vec<Link>),
    /// That many tickets are handed to the function, and whoever gets one (`tessera_worker::serve_ticket`) is
    /// expected to join.
    Tickets(u32, Box<dyn FnOnce(Vec<LocalTicket>) + Send>),
}

/// Processes on this machine.
#[derive(Clone, Debug)]
pub struct LocalWorkers {
    /// The program, usually `std::env::current_exe()`.
    pub program: PathBuf,
    /// Arguments that make it call `tessera_worker::run_local`.
    pub args: Vec<OsString>,
    /// What each is given besides, by its number; nothing for those beyond the end.
    pub args_of: Vec<Vec<OsString>>,
    /// How many, >= 1.
    pub count: u32,
    /// Threads that each renders with; `None`: the machine's cores shared out evenly, at least one each.
    pub threads: Option<u32>,
    /// How they reach the master; `None`: straight.
    pub through: Option<Detour>,
}

/// How a cluster is started.
#[derive(Clone, Debug, Default)]
pub struct ClusterConfig {
    /// The arithmetic that every worker must have (`tessera_worker::NUMERIC_CLASS`); `None`: workers of any may join, and one class
    /// renders each frame unless [`FrameJob::mix`] says otherwise.
    pub numeric_class: Option<String>,
    /// How long a frame whose last worker is lost waits for another to join before it fails. Zero where none can join later.
    pub patience: Duration,
}

/// Where a master waits for workers from anywhere.
#[derive(Clone, Debug)]
pub struct ListenConfig {
    /// The UDP socket's address.
    pub listen: SocketAddr,
    /// Host and port in the join string; `None`, or port 0: what the socket has.
    pub advertise: Option<(String, u16)>,
    /// How long the join string lets strangers in; `None`: as long as the master runs.
    pub token_ttl: Option<Duration>,
}

/// Workers that have joined. Dropping it ends local worker processes.
pub struct Cluster {
    coordinator: Coordinator,
    begun: Instant,
    inputs: mpsc::Receiver<Input>,
    tell: mpsc::Sender<Input>,
    counters: Arc<Counters>,
    /// Of connections that are not over.
    lines: BTreeMap<WorkerId, Line>,
    /// UDP payload sent and received by those that are.
    udp_closed: (u64, u64),
    locals: Vec<Local>,
    /// The workers that are connected from outside this process.
    identities: BTreeMap<Fingerprint, WorkerId>,
    /// Where clients go.
    clients: Option<mpsc::Sender<Guest>>,
    endpoint: Option<quinn::Endpoint>,
    /// Processes and the listener; dropping it kills them.
    tasks: JoinSet<()>,
    /// Connections that are being closed.
    farewells: JoinSet<()>,
    /// The one that is loaded, if it is.
    pack: Option<PackId>,
    /// That one, and earlier ones that a worker is still taking.
    packs: Vec<Pack>,
    send_scene: Duration,
    /// How pixels travel where that is left to us.
    coding: CodingChoice,
    /// What was done since the last result.
    work: MasterWork,
    /// Name and reason of the worker that was lost last.
    last_lost: String,
}

/// A worker that was given a ticket.
struct Local {
    name: String,
    worker: Option<WorkerId>,
    /// A process ends when it closes.
    _stdin: Option<ChildStdin>,
}

impl Cluster {
    /// Inputs that wait for the cluster; a task that finds the queue full waits itself, and so does its
    /// worker.
    const INPUTS: usize = 32;

    /// How long local processes may take to join: loading a program on a busy machine, not work.
    const JOIN_TIMEOUT: Duration = Duration::from_secs(30);

    /// Starts or greets `workers` and returns when all have joined.
    ///
    /// Does not need the scene: call it before or while the pack is made.
    pub async fn start(workers: Workers, config: ClusterConfig) -> Result<Self, StartError> {
        let mut this = Self::new(config);
        let count = match workers {
            Workers::Links(links) => {
                let count = links.len();
                for link in links {
                    this.link(link);
                }
                count
            }
            Workers::Tickets(count, hand_out) => {
                hand_out(this.issue(count, Some(1), None)?);
                count as usize
            }
            Workers::Local(workers) => {
                let tickets = this.issue(workers.count, workers.threads, workers.through.as_ref())?;
                for (index, (child, stdin)) in spawn::spawn(&workers, &tickets).await?.into_iter().enumerate()
                {
                    this.tasks.spawn(watch(index, child, this.tell.clone()));
                    this.locals[index]._stdin = Some(stdin);
                }
                workers.count as usize
            }
        };
        if count == 0 {
            return Err(StartError::NoWorkers);
        }
        this.join(count).await?;
        Ok(this)
    }

    /// Opens the door to workers from anywhere, and returns at once with what they need to join. Needs a tokio runtime with I/O and time.
    pub fn listen(config: ClusterConfig, at: ListenConfig) -> Result<(Self, JoinString), StartError> {
        Self::listen_for_all(config, at, None)
    }

    /// [`Cluster::listen`], and hands clients on; without that they are refused.
    pub(crate) fn listen_for_all(
        config: ClusterConfig,
        at: ListenConfig,
        clients: Option<mpsc::Sender<Guest>>,
    ) -> Result<(Self, JoinString), StartError> {
        let setup = |e: tessera_trust::TrustError| StartError::Endpoint(e.to_string());
        let mut this = Self { clients, ..Self::new(config) };
        let own = Identity::new().map_err(setup)?;
        let token = tessera_trust::new_token().map_err(setup)?;
        let bound = this.open(at.listen, &own, Admission::open(token, at.token_ttl))?;
        let (host, port) = at.advertise.unwrap_or_else(|| (net::reachable(bound.ip()).to_string(), 0));
        let port = if port == 0 { bound.port() } else { port };
        Ok((this, JoinString { host, port, fingerprint: own.fingerprint(), token }))
    }

    /// Lets workers come and go, and tells of it. Never ends; dropping the future between two words does no harm.
    pub async fn attend(&mut self, mut progress: impl FnMut(Progress<'_>)) {
        loop {
            for event in self.carry_out() {
                self.report(event, &mut progress);
            }
            self.wait().await;
        }
    }

    /// Whether a worker has joined and is not gone.
    pub fn has_workers(&self) -> bool {
        self.coordinator.joined().next().is_some()
    }

    /// [`Cluster::attend`], until a worker has joined.
    pub async fn until_joined(&mut self, mut progress: impl FnMut(Progress<'_>)) {
        loop {
            for event in self.carry_out() {
                self.report(event, &mut progress);
            }
            if self.has_workers() {
                return;
            }
            self.wait().await;
        }
    }

    /// Ends the frames whose rendering was dropped, if there are any.
    pub fn give_up(&mut self, mut progress: impl FnMut(Progress<'_>)) {
        for frame in self.coordinator.begun().collect::<Vec<_>>() {
            self.coordinator.finish(frame, self.now());
        }
        for event in self.carry_out() {
            self.report(event, &mut progress);
        }
    }

    /// Gives `pack` to every worker and returns when each has answered and at least one holds it, checked; later frames render it. Where
    /// workers join at any time it does not wait for stragglers once one holds it (see [`Coordinator::is_loading`]).
    ///
    /// A worker that rejects it stays in the cluster without a part in those frames; each rejection is told to `progress`. Workers that
    /// join later are given it then.
    ///
    /// The time that this took becomes [`Timings::send_scene`](crate::Timings::send_scene) of later frames.
    pub async fn load(
        &mut self,
        pack: &Pack,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<Duration, LoadError> {
        let begun = Instant::now();
        let id = PackId(pack.id().0);
        let length = pack.bytes().len() as u64;
        self.pack = None;
        self.packs.retain(|old| self.coordinator.is_wanted(PackId(old.id().0)));
        self.packs.push(pack.clone());
        let mut rejected = None;
        self.counters.pack.store(0, Ordering::Relaxed);
        self.coordinator.load(id, length, self.now());
        loop {
            for event in self.carry_out() {
                if let Event::PackRejected(worker, reason) = &event {
                    let worker = self.describe(*worker);
                    rejected.get_or_insert(LoadError::Rejected { worker, reason: reason.clone() });
                }
                self.report(event, &mut progress);
            }
            let joined = self.coordinator.joined().count();
            let bytes = self.counters.pack.load(Ordering::Relaxed);
            progress(Progress::Sent { bytes, total: length * joined as u64 });
            if !self.coordinator.is_loading() {
                break;
            }
            self.wait().await;
        }
        if self.coordinator.holders().next().is_none() {
            return Err(rejected.unwrap_or_else(|| LoadError::AllLost { last: self.last_lost.clone() }));
        }
        self.pack = Some(id);
        self.send_scene = begun.elapsed();
        Ok(self.send_scene)
    }

    /// Renders one frame of the loaded pack. Workers lost on the way are replaced by the others.
    pub async fn render(
        &mut self,
        job: &FrameJob,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult, RenderError> {
        let pack = self.pack.ok_or(RenderError::NoPack)?;
        self.measure_links();
        let job = &self.coded(job);
        self.work = MasterWork::default();
        let frame = self.coordinator.begin(job, self.now())?;
        let outcome = self.run(frame, job, None, &mut progress).await?;
        Ok(self.result(pack, outcome))
    }

    /// The same, with the image's rows going to `stream` as they become complete, for which the caller then calls
    /// [`PngStream::finish`]. Memory is held for rows that wait for those above them alone, a few bands of tiles where workers are about
    /// equally fast and are given tiles one after the other; for the whole image if the job may mix classes.
    pub async fn render_rows(
        &mut self,
        job: &FrameJob,
        stream: &mut PngStream,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult<()>, RenderError> {
        let pack = self.pack.ok_or(RenderError::NoPack)?;
        self.measure_links();
        let job = &self.coded(job);
        self.work = MasterWork::default();
        let frame = self.coordinator.begin_rows(job, self.now())?;
        let outcome = self.run(frame, job, Some(stream), &mut progress).await?;
        let (result, rest) = self.result(pack, outcome).with_image(());
        stream.push(rest.into_rows()).await?;
        Ok(result)
    }

    /// Forgets what frames have shown of workers, tiles and links, as a cluster that has just been started.
    pub fn forget(&mut self) {
        self.coordinator.forget();
        self.coding = CodingChoice::default();
        self.counters.arrival.take();
        self.counters.unpacking.take();
    }

    /// Tells the coordinator what round trips take now.
    fn measure_links(&mut self) {
        for (&worker, line) in &self.lines {
            self.coordinator.round_trip(worker, line.round_trip());
        }
    }

    /// Sees the frame that has begun to its end.
    async fn run(
        &mut self,
        frame: FrameId,
        job: &FrameJob,
        mut stream: Option<&mut PngStream>,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<Outcome, RenderError> {
        self.counters.tile_bytes.fetch_max(job.tile_bytes(), Ordering::Relaxed);
        loop {
            for event in self.carry_out() {
                let written = match (event, &mut stream) {
                    (Event::Rows(_, rows), Some(stream)) => stream.push(rows).await,
                    (event @ Event::Restarted { .. }, Some(stream)) => {
                        self.report(event, progress);
                        stream.restart()
                    }
                    (event, _) => {
                        self.report(event, progress);
                        Ok(())
                    }
                };
                if let Err(error) = written {
                    self.coordinator.finish(frame, self.now());
                    return Err(error.into());
                }
            }
            match self.coordinator.status(frame) {
                FrameStatus::Pending => self.wait().await,
                FrameStatus::NoRoom(no_room) => {
                    self.coordinator.finish(frame, self.now());
                    return Err(BeginError::NoRoom(no_room).into());
                }
                FrameStatus::Failed { done, total } => {
                    self.coordinator.finish(frame, self.now());
                    return Err(RenderError::AllLost { done, total, last: self.last_lost.clone() });
                }
                FrameStatus::Done => {
                    if let Some(outcome) = self.coordinator.finish(frame, self.now()) {
                        self.carry_out();
                        return Ok(outcome);
                    }
                }
            }
        }
    }

    /// Dismisses the workers and waits until local processes have ended (they are killed after two seconds).
    pub async fn stop(mut self) {
        const PATIENCE: Duration = Duration::from_secs(2);
        self.coordinator.dismiss(self.now());
        self.carry_out();
        while self.farewells.join_next().await.is_some() {}
        self.locals.clear();
        if let Some(endpoint) = self.endpoint.take() {
            // Ends the listener's task too; what remains of `tasks` are the processes.
            endpoint.close(VarInt::from_u32(AbortCode::Done.number()), b"");
            let _ = timeout(PATIENCE, endpoint.wait_idle()).await;
        }
        // The processes' tasks must find room to tell.
        self.inputs.close();
        let _ = timeout(PATIENCE, async { while self.tasks.join_next().await.is_some() {} }).await;
        self.tasks.shutdown().await;
    }

    fn new(config: ClusterConfig) -> Self {
        let (tell, inputs) = mpsc::channel(Self::INPUTS);
        Self {
            coordinator: Coordinator::new(config.numeric_class).with_patience(config.patience),
            begun: Instant::now(),
            inputs,
            tell,
            counters: Arc::default(),
            lines: BTreeMap::new(),
            udp_closed: (0, 0),
            locals: Vec::new(),
            identities: BTreeMap::new(),
            clients: None,
            endpoint: None,
            tasks: JoinSet::new(),
            farewells: JoinSet::new(),
            pack: None,
            packs: Vec::new(),
            send_scene: Duration::ZERO,
            coding: CodingChoice::default(),
            work: MasterWork::default(),
            last_lost: String::new(),
        }
    }

    fn now(&self) -> Duration {
        self.begun.elapsed()
    }

    fn link(&mut self, link: Link) -> WorkerId {
        let worker = self.coordinator.connected(self.now());
        self.lines.insert(worker, Line::start(worker, link, &self.tell, &self.counters));
        worker
    }

    /// Opens the door at `address` to those whom `admission` lets in; the address that the socket has.
    fn open(
        &mut self,
        address: SocketAddr,
        own: &Identity,
        admission: Admission,
    ) -> Result<SocketAddr, StartError> {
        let endpoint = net::listen(address, own).map_err(|e| StartError::Endpoint(e.to_string()))?;
        let bound = endpoint.local_addr().map_err(|e| StartError::Endpoint(e.to_string()))?;
        let door = Door {
            endpoint: endpoint.clone(),
            admission: Mutex::new(admission),
            begun: self.begun,
            tell: self.tell.clone(),
        };
        self.tasks.spawn(door::keep(Arc::new(door)));
        self.endpoint = Some(endpoint);
        Ok(bound)
    }

    /// Opens the door on loopback; tickets for `count` workers that may come to it, `through` another address if there is one.
    fn issue(
        &mut self,
        count: u32,
        threads: Option<u32>,
        through: Option<&Detour>,
    ) -> Result<Vec<LocalTicket>, StartError> {
        let setup = |e: tessera_trust::TrustError| StartError::Endpoint(e.to_string());
        let own = Identity::new().map_err(setup)?;
        let tokens: Result<Vec<_>, _> = (0..count).map(|_| tessera_trust::new_token()).collect();
        let tokens = tokens.map_err(setup)?;
        let bound = self.open((Ipv4Addr::LOCALHOST, 0).into(), &own, Admission::local(tokens.clone()))?;
        let at = through.map_or(Ok(bound), |way| way.find(bound)).map_err(StartError::Detour)?;
        let (host, port) = (at.ip().to_string(), at.port());
        let join = |token| JoinString { host: host.clone(), port, fingerprint: own.fingerprint(), token };
        let tickets = spawn::tickets(tokens.into_iter().map(join), threads);
        self.locals.extend(tickets.iter().map(|ticket| Local {
            name: ticket.name.clone(),
            worker: None,
            _stdin: None,
        }));
        Ok(tickets)
    }

    /// Waits until `count` workers have joined.
    async fn join(&mut self, count: usize) -> Result<(), StartError> {
        let deadline = Instant::now() + Self::JOIN_TIMEOUT;
        loop {
            for event in self.carry_out() {
                if let Event::Lost(worker, reason) = event {
                    return Err(StartError::Worker { worker: self.describe(worker), reason });
                }
            }
            if self.coordinator.joined().count() == count {
                return Ok(());
            }
            match timeout_at(deadline, self.inputs.recv()).await {
                Ok(Some(Input::Exited(index, reason))) => {
                    let worker = self.locals[index].name.clone();
                    return Err(StartError::Worker { worker, reason });
                }
                Ok(Some(input)) => self.take(input),
                Ok(None) | Err(_) => {
                    let missing = self.locals.iter().find(|local| local.worker.is_none());
                    let worker = missing.map_or("a worker".into(), |local| local.name.clone());
                    let reason = format!("no word from it in {} s", Self::JOIN_TIMEOUT.as_secs());
                    return Err(StartError::Worker { worker, reason });
                }
            }
            self.coordinator.tick(self.now());
        }
    }

    /// Waits for the next input, or deadline, and takes it.
    async fn wait(&mut self) {
        let next = match self.coordinator.deadline() {
            Some(deadline) => timeout_at(self.begun + deadline, self.inputs.recv()).await.ok().flatten(),
            None => self.inputs.recv().await,
        };
        // Inputs that wait come before a deadline that has passed meanwhile: they may meet it.
        let begun = Instant::now();
        match next {
            Some(input) => {
                self.take(input);
                self.work.messages += 1;
            }
            None => self.coordinator.tick(self.now()),
        }
        self.work.busy += begun.elapsed();
    }

    fn take(&mut self, input: Input) {
        let now = self.now();
        match input {
            Input::Guest(guest) => self.welcome(*guest),
            Input::Message(worker, message) => self.coordinator.message(worker, message, now),
            Input::Tile(worker, Tile { frame, entry, pixels, wire_bytes }) => {
                self.coordinator.tile(worker, frame, &entry, &pixels, wire_bytes, now);
            }
            Input::PackSent => {}
            Input::BulkEnded(worker) => self.coordinator.bulk_ended(worker, now),
            Input::Broken(worker, PipeError::Malformed(detail)) => {
                self.coordinator.abort(worker, AbortCode::Malformed, detail, now);
            }
            Input::Broken(worker, PipeError::Io(e)) => {
                let reason = format!("the connection is lost: {}", transport::reason(&e));
                self.coordinator.lost(worker, AbortCode::Done, reason, now);
            }
            Input::Exited(index, reason) => {
                if let Some(worker) = self.locals[index].worker {
                    self.coordinator.lost(worker, AbortCode::Done, reason, now);
                }
            }
        }
    }

    /// Takes in a worker whose `Hello` the door has read, and hands on a client.
    fn welcome(&mut self, guest: Guest) {
        if guest.admitted == Admitted::Client {
            let limit = limits::CLIENTS as u32;
            let (guest, refusal) = match &self.clients {
                None => (guest, Refusal::Role),
                Some(clients) => match clients.try_send(guest) {
                    Ok(()) => return,
                    Err(e) => (e.into_inner(), Refusal::Full { limit }),
                },
            };
            self.farewells.spawn(door::turn_away(guest, refusal));
            return;
        }
        let now = self.now();
        let Guest { admitted, identity, hello, link } = guest;
        let worker = self.link(link);
        if let Admitted::Local(index) = admitted {
            self.locals[index].worker = Some(worker);
        }
        if let Some(earlier) = self.identities.insert(identity, worker) {
            self.coordinator.abort(earlier, AbortCode::Replaced, "it has connected again".into(), now);
        }
        if self.coordinator.joined().count() >= limits::WORKERS {
            self.coordinator.refuse(worker, Refusal::Full { limit: limits::WORKERS as u32 }, now);
        }
        self.coordinator.message(worker, ToMaster::Hello(hello), now);
    }

    /// Does what the coordinator wants, and hands on its events.
    fn carry_out(&mut self) -> Vec<Event> {
        let begun = Instant::now();
        while self.farewells.try_join_next().is_some() {}
        // Those that were told of in the events before.
        self.lines.retain(|_, line| !line.is_closed());
        let mut events = Vec::new();
        while let Some(output) = self.coordinator.poll() {
            match output {
                Output::Send(worker, message) => {
                    self.work.messages += 1;
                    if let Some(line) = self.lines.get(&worker) {
                        line.send(message);
                    }
                }
                Output::SendPack(worker, id) => {
                    let pack = self.packs.iter().find(|pack| pack.id().0 == id.0);
                    if let (Some(pack), Some(line)) = (pack, self.lines.get(&worker)) {
                        line.send_pack(pack.clone());
                    }
                }
                Output::Close(worker, code) => {
                    if let Some(line) = self.lines.get_mut(&worker) {
                        let (sent, received) = line.udp_bytes();
                        self.udp_closed.0 += sent;
                        self.udp_closed.1 += received;
                        self.farewells.spawn(line.close(code));
                    }
                    self.identities.retain(|_, known| *known != worker);
                }
                Output::Event(event) => {
                    if let Event::Joined(worker) = event
                        && let Some(line) = self.lines.get_mut(&worker)
                    {
                        line.name = self.coordinator.name(worker).map(str::to_string);
                    }
                    events.push(event);
                }
            }
        }
        self.work.busy += begun.elapsed();
        events
    }

    fn report(&mut self, event: Event, progress: &mut impl FnMut(Progress<'_>)) {
        match event {
            Event::Tile { done, total, .. } => progress(Progress::Tiles { done, total }),
            Event::Lost(worker, reason) => {
                let name = self.describe(worker);
                progress(Progress::WorkerLost { name: &name, reason: &reason });
                self.last_lost = format!("{name}: {reason}");
            }
            Event::Joined(worker) => {
                let (name, peer) = (self.describe(worker), self.peer(worker));
                let class = self.coordinator.class_of(worker).unwrap_or("?");
                progress(Progress::WorkerJoined { name: &name, peer, class });
            }
            Event::PackRejected(worker, reason) => {
                let name = self.describe(worker);
                progress(Progress::PackRejected { name: &name, reason: &reason.to_string() });
            }
            Event::ClassChosen { class, workers, idle } => {
                progress(Progress::ClassChosen { class: &class, workers, idle });
            }
            Event::Restarted { from, to, dropped, .. } => {
                progress(Progress::Restarted { from: &from, to: &to, dropped });
            }
            Event::PackHeld(_) | Event::Rows(..) => {}
        }
    }

    /// A worker's name, also when it is gone; that of its process, or where it is, if it has not joined.
    fn describe(&self, worker: WorkerId) -> String {
        let name = self.lines.get(&worker).and_then(|line| line.name.as_deref());
        let local = self.locals.iter().find(|local| local.worker == Some(worker)).map(|l| l.name.as_str());
        name.or(local).map_or_else(|| format!("{worker} ({})", self.peer(worker)), str::to_string)
    }

    /// Where a worker is.
    fn peer(&self, worker: WorkerId) -> &str {
        self.lines.get(&worker).map_or("?", |line| &line.peer)
    }

    /// Bytes on the wire since the cluster was started.
    pub fn traffic(&self) -> Traffic {
        let open = self.lines.values().map(Line::udp_bytes);
        let udp = open.fold(self.udp_closed, |a, b| (a.0 + b.0, a.1 + b.1));
        Traffic {
            sent: self.counters.sent.load(Ordering::Relaxed),
            received: self.counters.received.load(Ordering::Relaxed),
            udp_sent: udp.0,
            udp_received: udp.1,
        }
    }

    /// `job`, with what is left to us about its pixels decided.
    fn coded(&mut self, job: &FrameJob) -> FrameJob {
        let is_remote = self.lines.values().any(Line::is_remote);
        let coding = job.coding.unwrap_or_else(|| self.coding.choose(is_remote));
        FrameJob { coding: Some(coding), ..job.clone() }
    }

    fn result(&mut self, pack: PackId, mut outcome: Outcome) -> FrameResult {
        let Counters { arrival, unpacking, .. } = &*self.counters;
        let packing = Shown::of_tiles(&outcome.tiles);
        self.coding.learn(&Shown { arrival: arrival.take(), unpacking: unpacking.take(), packing });
        // By ticket: processes join in any order.
        let place = |name: &str| self.locals.iter().position(|local| local.name == name);
        let mut order: Vec<_> = (0..outcome.workers.len()).collect();
        order.sort_by_key(|&i| place(&outcome.workers[i].name).unwrap_or(usize::MAX));
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(to, &from)| rank[from] = to);
        outcome.tiles.iter_mut().for_each(|tile| tile.worker = rank[tile.worker]);
        outcome.workers.sort_by_key(|w| place(&w.name).unwrap_or(usize::MAX));
        FrameResult {
            image: outcome.image,
            pack: tessera_pack::PackId(pack.0),
            classes: outcome.classes,
            differences: outcome.differences,
            idle: outcome.idle,
            workers: outcome.workers,
            timings: Timings { send_scene: self.send_scene, ..outcome.timings },
            traffic: self.traffic(),
            master: std::mem::take(&mut self.work),
            rays: outcome.rays,
            dropped_tiles: outcome.dropped_tiles,
            coding: outcome.coding,
            tiles: outcome.tiles,
            tile: outcome.tile,
            why: outcome.why,
        }
    }
}

/// Tells when a process has ended; dropping the future kills it.
async fn watch(index: usize, mut child: Child, tell: mpsc::Sender<Input>) {
    let status = match child.wait().await {
        Ok(status) => format!("its process has ended ({status})"),
        Err(e) => format!("its process cannot be watched ({e})"),
    };
    let _ = tell.send(Input::Exited(index, status)).await;
}

/// Why there is no cluster.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Nobody was asked.
    #[error("a cluster needs at least one worker")]
    NoWorkers,
    /// A worker process could not be started.
    #[error("cannot start worker process `{program}`: {source}")]
    Spawn {
        /// The program.
        program: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The socket, the certificates.
    #[error("cannot open the master's endpoint: {0}")]
    Endpoint(String),
    /// There is no way [`through`](LocalWorkers::through) what was to be there.
    #[error("workers have no way to the master: {0}")]
    Detour(std::io::Error),
    /// A worker ended, or was refused, before it had joined.
    #[error("{worker} did not join: {reason}")]
    Worker {
        /// Which.
        worker: String,
        /// Why.
        reason: String,
    },
}

/// Why a pack is not loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// Every worker said no, or was lost; another pack, or a machine with more memory, may do.
    #[error("no worker can hold the scene; {worker}: {reason}")]
    Rejected {
        /// The first that said no.
        worker: String,
        /// Why.
        reason: tessera_wire::PackRefusal,
    },
    /// No worker is left.
    #[error("all workers were lost while the scene was sent; the last: {last}")]
    AllLost {
        /// Name and reason of the last one.
        last: String,
    },
}

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The job is out of range, or its image too large.
    #[error(transparent)]
    Job(#[from] BeginError),
    /// The file that takes the rows cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// `load` has not succeeded.
    #[error("no scene is loaded")]
    NoPack,
    /// No worker is left.
    #[error("all workers were lost after {done} of {total} tiles; the last: {last}")]
    AllLost {
        /// Tiles in the image.
        done: u32,
        /// Tiles of the frame.
        total: u32,
        /// Name and reason of the last one.
        last: String,
    },
}
