//! Preparing a scene and rendering one frame of it, for every command that does.

use super::backend::{BackendArgs, BackendFlag};
use super::progress::Progress;
use super::{CommandError, LogArgs, PackingArgs, args};
use std::path::Path;
use std::time::{Duration, Instant};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare};
use tessera_master::{
    Client, Cluster, ClusterConfig, FrameJob, FrameResult, Link, LocalWorkers, Pipes, Workers,
};
use tessera_pack::{Pack, Plain};
use tessera_scene::{LoadOptions, Without};
use tessera_trust::Identity;
use tessera_wire::JoinString;
use tessera_worker::{Backend, Connected, WorkerConfig, WorkerPipes};

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
fn has_gpu() -> bool {
    tessera_worker::adapters().iter().any(|adapter| adapter.unusable.is_none() && adapter.kind != "software")
}

/// A frame, and the time that starting the workers took.
pub struct Rendered {
    /// The frame.
    pub frame: FrameResult,
    /// From the first process started to the last worker joined, or until a master elsewhere has let this client in.
    pub start: Duration,
}

/// Renders one frame of `pack`.
pub fn render_frame(
    pack: &Pack,
    job: &FrameJob,
    crew: &Crew,
    progress: &Progress,
) -> Result<Rendered, CommandError> {
    let runtime = runtime()?;
    let result = runtime.block_on(async {
        match crew {
            Crew::Local(crew) => match frame(pack, job, crew, progress).await {
                // A GPU that is too small, is lost or cannot do it; the picture begins anew, all of one class.
                Err(error) if crew.is_left_to_us && has_gpu() => {
                    tracing::warn!("{error}; beginning again on the CPU");
                    frame(pack, job, &crew.on_cpu(), progress).await
                }
                result => result,
            },
            Crew::Master(join) => frame_elsewhere(pack, job, join, progress).await,
        }
    });
    // An in-process worker may still be in the middle of a tile that nobody waits for.
    runtime.shutdown_background();
    result
}

/// As [`frame`], by a master elsewhere.
async fn frame_elsewhere(
    pack: &Pack,
    job: &FrameJob,
    join: &JoinString,
    progress: &Progress,
) -> Result<Rendered, CommandError> {
    let begin = Instant::now();
    let own = Identity::new().map_err(CommandError::failed)?;
    let Connected { pipes, closer } = {
        let _bar = progress.step(format!("connecting to {}", join.address()));
        tessera_worker::connect(join, &own).await.map_err(CommandError::failed)?
    };
    let WorkerPipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    let pipes = Pipes { control_in, control_out, bulk_in, bulk_out };
    let rendered = frame_over(pipes, pack, job, join, progress, begin).await;
    closer.close(false).await;
    rendered
}

/// As [`frame`], by the master behind `pipes`, which were asked for at `begin`.
async fn frame_over(
    pipes: Pipes,
    pack: &Pack,
    job: &FrameJob,
    join: &JoinString,
    progress: &Progress,
    begin: Instant,
) -> Result<Rendered, CommandError> {
    let mut client =
        Client::join(pipes, join.token, super::worker::own_name()).await.map_err(CommandError::failed)?;
    let start = begin.elapsed();
    tracing::info!("the master at {} has let this client in after {start:.1?}", join.address());
    {
        let bar = progress.bytes("sending the scene");
        let took = client.load(pack, |event| show(&bar, &event)).await.map_err(CommandError::failed)?;
        tracing::info!("the master holds the scene after {took:.1?}");
    }
    let frame = {
        let bar = progress.parts("rendering tiles");
        client.render(job, |event| show(&bar, &event)).await.map_err(CommandError::failed)?
    };
    Ok(Rendered { frame, start })
}

async fn frame(
    pack: &Pack,
    job: &FrameJob,
    crew: &LocalCrew,
    progress: &Progress,
) -> Result<Rendered, CommandError> {
    let begin = Instant::now();
    let mut cluster = {
        let _bar = progress.step("starting workers");
        Cluster::start(workers(crew, progress.log())?, ClusterConfig::default())
            .await
            .map_err(CommandError::failed)?
    };
    let start = begin.elapsed();
    tracing::info!("all workers have joined after {start:.1?}");
    {
        let bar = progress.bytes("sending the scene");
        let took = cluster.load(pack, |event| show(&bar, &event)).await.map_err(CommandError::failed)?;
        tracing::info!("all workers hold the scene after {took:.1?}");
    }
    let frame = {
        let bar = progress.parts("rendering tiles");
        cluster.render(job, |event| show(&bar, &event)).await.map_err(CommandError::failed)?
    };
    cluster.stop().await;
    Ok(Rendered { frame, start })
}

fn show(bar: &super::progress::Bar, event: &tessera_master::Progress<'_>) {
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
        return Ok(Workers::Links(vec![worker_here(crew.threads.unwrap_or_else(cores), backend)]));
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
        count: crew.workers,
        threads: crew.threads,
    }))
}

/// A worker within this process: the same code as in a process of its own, behind in-memory pipes.
fn worker_here(threads: u32, backend: Backend) -> Link {
    let (link, pipes) = Link::in_memory();
    let Pipes { control_in, control_out, bulk_in, bulk_out } = pipes;
    let pipes = WorkerPipes { control_in, control_out, bulk_in, bulk_out };
    let config = WorkerConfig { name: "this process".into(), threads, backend, memory: None, cache: None };
    tokio::spawn(async move {
        if let Err(error) = tessera_worker::serve(pipes, config).await {
            tracing::debug!("the worker in this process ended: {error}");
        }
    });
    link
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
