//! Preparing a scene and rendering frames of it, for every command that does.

mod sequence;

use super::backend::{BackendArgs, BackendFlag};
use super::progress::{Bar, Progress};
use super::{CommandError, LogArgs, PackingArgs, args};
use std::path::Path;
use std::time::{Duration, Instant};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare};
use tessera_master::{
    Client, Cluster, ClusterConfig, FrameBuffer, FrameJob, FrameResult, ImageHash, Link, LocalWorkers,
    OutputFile, Pipes, PngStream, Workers,
};
use tessera_pack::{Pack, Plain};
use tessera_scene::{LoadOptions, Without};
use tessera_trust::Identity;
use tessera_wire::JoinString;
use tessera_worker::{Backend, Closer, Connected, WorkerConfig, WorkerPipes};

pub use sequence::{Asked, Rendered, Source};

impl PackingArgs {
    /// What the library is to do.
    pub fn options(&self) -> PrepareOptions {
        let plain = |part| self.plain.contains(&part);
        let mut options = PrepareOptions {
            load: LoadOptions { scenes_folder: std::env::var_os("TESSERA_SCENES").map(Into::into) },
            without: self.without(),
            plain: Plain {
                positions: plain(args::PlainPart::Positions),
                normals: plain(args::PlainPart::Normals),
                uvs: plain(args::PlainPart::Uv),
            },
            ..PrepareOptions::default()
        };
        let set = |to: &mut u32, asked: Option<u32>| *to = asked.unwrap_or(*to);
        set(&mut options.max_intervals, self.cells);
        set(&mut options.position_bits, self.position_bits);
        set(&mut options.uv_bits, self.uv_bits);
        options.normal_code = self.normals.map_or(options.normal_code, Into::into);
        let tree = &mut options.tree;
        set(&mut tree.max_refs, self.refs);
        if let Some(args::RefsWhen { occupancy, frequency, tests }) = self.refs_when {
            (tree.tau_occupancy, tree.tau_frequency) = (occupancy, frequency);
            tree.tau_tests = tests.unwrap_or(tree.tau_tests);
        }
        tree.least_saving = self.least_saving.unwrap_or(tree.least_saving);
        options
    }

    /// Whether all that is asked for has an effect on the scene at `path`.
    fn check(&self, path: &Path) -> Result<(), CommandError> {
        self.check_alone()?;
        let is_bundle = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack"));
        let asked = [
            (!self.plain.is_empty(), "--plain"),
            (self.cells.is_some(), "--cells"),
            (self.position_bits.is_some(), "--position-bits"),
            (self.normals.is_some(), "--normals"),
            (self.uv_bits.is_some(), "--uv-bits"),
            (self.refs.is_some(), "--refs"),
            (self.refs_when.is_some(), "--refs-when"),
            (self.least_saving.is_some(), "--least-saving"),
            (self.without.contains(&args::Feature::Textures), "--without textures"),
        ];
        match asked.into_iter().find(|(asked, _)| is_bundle && *asked) {
            // A bundle is used as it is: what it holds cannot be asked for any more.
            Some((_, flag)) => Err(CommandError::Usage(format!(
                "{}: a bundle is used as it is, {flag} has no effect on it; pack the scene again with it",
                path.display()
            ))),
            None => Ok(()),
        }
    }

    /// Whether all that is asked for has an effect, whatever the scene.
    pub fn check_alone(&self) -> Result<(), CommandError> {
        let asked = [
            (self.position_bits.is_some(), args::PlainPart::Positions, "--position-bits", "positions"),
            (self.normals.is_some(), args::PlainPart::Normals, "--normals", "normals"),
            (self.uv_bits.is_some(), args::PlainPart::Uv, "--uv-bits", "texture coordinates"),
        ];
        match asked.into_iter().find(|(asked, part, ..)| *asked && self.plain.contains(part)) {
            Some((.., flag, what)) => Err(CommandError::Usage(format!(
                "{flag} has no effect on {what} that --plain holds as f32; leave one of the two out"
            ))),
            None => Ok(()),
        }
    }

    /// Features to leave out.
    pub fn without(&self) -> Without {
        let without = |feature| self.without.contains(&feature);
        Without {
            textures: without(args::Feature::Textures),
            shadows: without(args::Feature::Shadows),
            reflection: without(args::Feature::Reflection),
            refraction: without(args::Feature::Refraction),
        }
    }
}

/// Prepares the scene that the user named.
pub fn prepare_scene(
    path: &Path,
    packing: &PackingArgs,
    progress: &Progress,
) -> Result<Prepared, CommandError> {
    packing.check(path)?;
    let _bar = progress.step(format!("preparing {}", path.display()));
    tracing::info!("preparing {}", path.display());
    prepare(path, &packing.options()).map_err(CommandError::failed)
}

/// Where a frame is rendered.
#[derive(Clone, Debug)]
pub enum Crew {
    /// On this machine.
    Local(LocalCrew),
    /// On the workers of a master elsewhere.
    Master(JoinString),
}

/// Workers of this machine.
#[derive(Clone, Debug)]
pub struct LocalCrew {
    /// Worker processes; 0: in this process.
    pub workers: u32,
    /// Threads that each renders with; `None`: the machine's cores shared out evenly.
    pub threads: Option<u32>,
    /// What renders in each of them.
    pub backend: BackendArgs,
    /// That, where it is open in this process already.
    pub opened: Option<Backend>,
    /// Why it was chosen, where this process has chosen for all of them.
    pub note: Option<String>,
    /// Whether the user has left it to us, so that the CPU may take over from a GPU.
    pub is_left_to_us: bool,
}

impl LocalCrew {
    /// All cores of this machine, from within this process.
    pub fn this_process() -> Self {
        let backend = BackendArgs { backend: BackendFlag::Cpu, ..BackendArgs::default() };
        Self { workers: 0, threads: None, backend, opened: None, note: None, is_left_to_us: false }
    }

    /// The same on the CPU.
    fn on_cpu(&self) -> Self {
        let backend = BackendArgs { backend: BackendFlag::Cpu, gpu: None, ..self.backend };
        Self { backend, opened: None, note: None, is_left_to_us: false, ..*self }
    }
}

impl Crew {
    /// Settles what renders, before any work that is in vain without the GPU that was asked for: of many worker processes each would
    /// have to say that there is none, and those that measure at the same time may choose differently, so that some would idle.
    pub fn settle_backend(&mut self, progress: &Progress) -> Result<(), CommandError> {
        let Self::Local(crew) = self else { return Ok(()) };
        crew.backend.check()?;
        crew.is_left_to_us = crew.backend.is_auto();
        let chooses = crew.backend.is_auto() && crew.workers > 1 && has_gpu();
        if !crew.backend.needs_gpu() && !chooses {
            return Ok(());
        }
        let _bar = progress.step("looking for the GPU");
        let opened = crew.backend.open()?;
        if chooses {
            tracing::info!("{}", opened.note());
            crew.note = Some(opened.note().to_owned());
            crew.backend.settle(&opened);
        }
        // Processes open it themselves, and this one leaves them its memory.
        crew.opened = Some(opened).filter(|_| crew.workers == 0);
        Ok(())
    }
}

/// Whether there is a GPU that `auto` might take.
pub fn has_gpu() -> bool {
    tessera_worker::adapters().iter().any(|adapter| adapter.unusable.is_none() && adapter.kind != "software")
}

/// A crew that holds a scene, for as many frames of it as are wanted.
pub struct Session<'a> {
    /// There until the session ends.
    runtime: Option<tokio::runtime::Runtime>,
    held: Option<Held>,
    pack: &'a Pack,
    crew: Crew,
    progress: &'a Progress,
    start: Duration,
    has_failed: bool,
}

/// Who holds the scene.
enum Held {
    /// Workers of this machine.
    Local(Box<Cluster>),
    /// A master elsewhere.
    Elsewhere(Box<Client>, Closer),
}

impl<'a> Session<'a> {
    /// Starts the crew, or connects to it, and gives it `pack`.
    pub fn open(pack: &'a Pack, crew: &Crew, progress: &'a Progress) -> Result<Self, CommandError> {
        let (crew, start) = (crew.clone(), Duration::ZERO);
        let (runtime, held) = (Some(runtime()?), None);
        let mut session = Self { runtime, held, pack, crew, progress, start, has_failed: false };
        let held = session.hold();
        session.or_on_cpu(held, Self::hold)?;
        Ok(session)
    }

    /// From the first process started to the last worker joined, or until a master elsewhere has let this client in.
    pub fn start(&self) -> Duration {
        self.start
    }

    /// Who renders.
    pub fn crew(&self) -> &Crew {
        &self.crew
    }

    /// Renders a frame and keeps its image.
    pub fn render(&mut self, job: &FrameJob) -> Result<FrameResult, CommandError> {
        self.render_with(job, &Keep)
    }

    /// Renders a frame of 8 or 16 bits to a PNG file whose rows are written as they become complete.
    pub fn render_to_png(
        &mut self,
        job: &FrameJob,
        file: &OutputFile,
    ) -> Result<FrameResult<Written>, CommandError> {
        self.render_with(job, &ToPng(file))
    }

    fn render_with<T: Target>(
        &mut self,
        job: &FrameJob,
        target: &T,
    ) -> Result<FrameResult<T::Image>, CommandError> {
        let frame = self.frame(job, target);
        // The picture begins anew, all of one class.
        let frame = self.or_on_cpu(frame, |session| session.hold().and_then(|()| session.frame(job, target)));
        self.has_failed = frame.is_err();
        frame
    }

    /// Sends the crew home. After a failure nobody waits for local workers; they are killed.
    pub fn close(mut self) {
        let (Some(runtime), Some(held)) = (&self.runtime, self.held.take()) else { return };
        let has_failed = self.has_failed;
        runtime.block_on(async {
            match held {
                Held::Local(cluster) if !has_failed => cluster.stop().await,
                Held::Local(_) => (),
                Held::Elsewhere(_, closer) => closer.close(false).await,
            }
        });
    }

    fn hold(&mut self) -> Result<(), CommandError> {
        let Some(runtime) = &self.runtime else { return Err(ended()) };
        // Those before must not hold a device meanwhile.
        {
            let _context = runtime.enter();
            self.held = None;
        }
        let (held, start) = runtime.block_on(hold(self.pack, &self.crew, self.progress))?;
        (self.held, self.start) = (Some(held), start);
        Ok(())
    }

    fn frame<T: Target>(
        &mut self,
        job: &FrameJob,
        target: &T,
    ) -> Result<FrameResult<T::Image>, CommandError> {
        let (Some(runtime), Some(held)) = (&self.runtime, &mut self.held) else { return Err(ended()) };
        let bar = self.progress.parts("rendering tiles");
        runtime.block_on(async {
            match held {
                Held::Local(cluster) => target.ask_cluster(cluster, job, &bar).await,
                Held::Elsewhere(client, _) => target.ask_master(client, job, &bar).await,
            }
        })
    }

    /// `result`, or where a GPU that nobody has insisted on is too small, is lost or cannot do it, that of `again` on the CPU.
    fn or_on_cpu<T>(
        &mut self,
        result: Result<T, CommandError>,
        again: impl FnOnce(&mut Self) -> Result<T, CommandError>,
    ) -> Result<T, CommandError> {
        match (result, &self.crew) {
            (Err(error), Crew::Local(crew)) if crew.is_left_to_us && has_gpu() => {
                tracing::warn!("{error}; beginning again on the CPU");
                self.crew = Crew::Local(crew.on_cpu());
                again(self)
            }
            (result, _) => result,
        }
    }
}

impl Drop for Session<'_> {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            {
                let _context = runtime.enter();
                self.held = None;
            }
            // An in-process worker may still be in the middle of a tile that nobody waits for.
            runtime.shutdown_background();
        }
    }
}

fn ended() -> CommandError {
    CommandError::Failed("the session has ended".into())
}

/// An image that was written to a file.
#[derive(Clone, Copy, Debug)]
pub struct Written {
    /// Of the image.
    pub hash: ImageHash,
    /// From the last tile to the file in place.
    pub write: Duration,
}

/// What becomes of an image.
trait Target {
    /// What is left of it.
    type Image;

    /// Has workers of this machine render it.
    async fn ask_cluster(
        &self,
        cluster: &mut Cluster,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult<Self::Image>, CommandError>;

    /// Has a master elsewhere render it.
    async fn ask_master(
        &self,
        client: &mut Client,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult<Self::Image>, CommandError>;
}

/// It is kept.
struct Keep;

impl Target for Keep {
    type Image = FrameBuffer;

    async fn ask_cluster(
        &self,
        cluster: &mut Cluster,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult, CommandError> {
        cluster.render(job, |event| show(bar, &event)).await.map_err(CommandError::failed)
    }

    async fn ask_master(
        &self,
        client: &mut Client,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult, CommandError> {
        client.render(job, |event| show(bar, &event)).await.map_err(CommandError::failed)
    }
}

/// Its rows go to a file.
struct ToPng<'a>(&'a OutputFile);

impl ToPng<'_> {
    fn begin(&self, job: &FrameJob) -> Result<PngStream, CommandError> {
        PngStream::begin(self.0, job.width, job.height, job.format).map_err(CommandError::failed)
    }

    async fn finish(stream: PngStream, frame: FrameResult<()>) -> Result<FrameResult<Written>, CommandError> {
        let begin = Instant::now();
        let hash = stream.finish().await.map_err(CommandError::failed)?;
        Ok(frame.with_image(Written { hash, write: begin.elapsed() }).0)
    }
}

impl Target for ToPng<'_> {
    type Image = Written;

    async fn ask_cluster(
        &self,
        cluster: &mut Cluster,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult<Written>, CommandError> {
        let mut stream = self.begin(job)?;
        let frame = cluster.render_rows(job, &mut stream, |event| show(bar, &event)).await;
        Self::finish(stream, frame.map_err(CommandError::failed)?).await
    }

    async fn ask_master(
        &self,
        client: &mut Client,
        job: &FrameJob,
        bar: &Bar,
    ) -> Result<FrameResult<Written>, CommandError> {
        let mut stream = self.begin(job)?;
        let frame = client.render_rows(job, &mut stream, |event| show(bar, &event)).await;
        Self::finish(stream, frame.map_err(CommandError::failed)?).await
    }
}

/// Gets `crew` to hold `pack`, and says how long it took to start.
async fn hold(pack: &Pack, crew: &Crew, progress: &Progress) -> Result<(Held, Duration), CommandError> {
    match crew {
        Crew::Local(crew) => hold_here(pack, crew, progress).await,
        Crew::Master(join) => hold_elsewhere(pack, join, progress).await,
    }
}

async fn hold_elsewhere(
    pack: &Pack,
    join: &JoinString,
    progress: &Progress,
) -> Result<(Held, Duration), CommandError> {
    let begin = Instant::now();
    let own = Identity::new().map_err(CommandError::failed)?;
    let Connected { pipes, closer } = {
        let _bar = progress.step(format!("connecting to {}", join.address()));
        tessera_worker::connect(join, &own).await.map_err(CommandError::failed)?
    };
    let WorkerPipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    let pipes = Pipes { control_in, control_out, bulk_in, bulk_out };
    match give(pipes, pack, join, progress, begin).await {
        Ok((client, start)) => Ok((Held::Elsewhere(Box::new(client), closer), start)),
        Err(error) => {
            closer.close(false).await;
            Err(error)
        }
    }
}

/// Makes the master behind `pipes`, which were asked for at `begin`, hold `pack`.
async fn give(
    pipes: Pipes,
    pack: &Pack,
    join: &JoinString,
    progress: &Progress,
    begin: Instant,
) -> Result<(Client, Duration), CommandError> {
    let mut client =
        Client::join(pipes, join.token, super::worker::own_name()).await.map_err(CommandError::failed)?;
    let start = begin.elapsed();
    tracing::info!("the master at {} has let this client in after {start:.1?}", join.address());
    let bar = progress.bytes("sending the scene");
    let took = client.load(pack, |event| show(&bar, &event)).await.map_err(CommandError::failed)?;
    tracing::info!("the master holds the scene after {took:.1?}");
    Ok((client, start))
}

async fn hold_here(
    pack: &Pack,
    crew: &LocalCrew,
    progress: &Progress,
) -> Result<(Held, Duration), CommandError> {
    let begin = Instant::now();
    let mut cluster = {
        let _bar = progress.step("starting workers");
        Cluster::start(workers(crew, progress.log())?, ClusterConfig::default())
            .await
            .map_err(CommandError::failed)?
    };
    let start = begin.elapsed();
    tracing::info!("all workers have joined after {start:.1?}");
    let bar = progress.bytes("sending the scene");
    let took = cluster.load(pack, |event| show(&bar, &event)).await.map_err(CommandError::failed)?;
    tracing::info!("all workers hold the scene after {took:.1?}");
    Ok((Held::Local(Box::new(cluster)), start))
}

fn show(bar: &Bar, event: &tessera_master::Progress<'_>) {
    match *event {
        tessera_master::Progress::Sent { bytes, total } => bar.set(bytes, total),
        tessera_master::Progress::Tiles { done, total } => {
            tracing::debug!("{done} of {total} tiles");
            bar.set(done.into(), total.into());
        }
        tessera_master::Progress::PackRejected { name, reason } => {
            tracing::warn!("{name} cannot hold the scene: {reason}; the others render it");
        }
        tessera_master::Progress::WorkerLost { name, reason } => {
            tracing::warn!("{name} is lost: {reason}; the others go on");
        }
        tessera_master::Progress::Waiting { .. }
        | tessera_master::Progress::NoWorkers
        | tessera_master::Progress::Restarted { .. } => tracing::warn!("{event}"),
        tessera_master::Progress::ClassChosen { .. } => tracing::info!("{event}"),
        tessera_master::Progress::WorkerJoined { .. } => tracing::debug!("{event}"),
    }
}

fn workers(crew: &LocalCrew, log: &LogArgs) -> Result<Workers, CommandError> {
    if crew.workers == 0 {
        let backend = match &crew.opened {
            Some(opened) => opened.clone(),
            None => crew.backend.open()?,
        };
        tracing::info!("{}", backend.note());
        let (link, _) = worker_here("this process", crew.threads.unwrap_or_else(cores), backend);
        return Ok(Workers::Links(vec![link]));
    }
    let program = std::env::current_exe()
        .map_err(|e| CommandError::Failed(format!("cannot find this program to start workers with: {e}")))?;
    Ok(Workers::Local(LocalWorkers {
        program,
        args: ["worker", "--ticket"]
            .map(Into::into)
            .into_iter()
            .chain(crew.backend.to_args())
            .chain(log.to_args())
            .collect(),
        args_of: Vec::new(),
        count: crew.workers,
        threads: crew.threads,
        through: None,
    }))
}

/// A worker within this process, and its task: the same code as in a process of its own, behind in-memory pipes.
pub fn worker_here(name: &str, threads: u32, backend: Backend) -> (Link, tokio::task::JoinHandle<()>) {
    let (link, pipes) = Link::in_memory();
    let Pipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    let pipes = WorkerPipes { control_in, control_out, bulk_in, bulk_out };
    let config = WorkerConfig { name: name.into(), threads, backend, memory: None, cache: None };
    let task = tokio::spawn(async move {
        if let Err(error) = tessera_worker::serve(pipes, config).await {
            tracing::debug!("a worker in this process ended: {error}");
        }
    });
    (link, task)
}

/// What carries sockets and timers.
pub fn runtime() -> Result<tokio::runtime::Runtime, CommandError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| CommandError::Failed(format!("cannot start the network threads: {e}")))
}

/// Threads that run at the same time here.
pub fn cores() -> u32 {
    std::thread::available_parallelism().map_or(1, |n| u32::try_from(n.get()).unwrap_or(u32::MAX))
}
