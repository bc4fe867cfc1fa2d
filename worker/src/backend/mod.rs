//! What renders: the CPU, a GPU by way of wgpu, or a recording that plays a device.

mod calibrate;
pub(crate) mod cpu;
pub mod gpu;
pub(crate) mod pace;
pub(crate) mod replay;

use crate::recording::RecordingError;
use gpu::{Gpu, GpuError, GpuOptions, GpuScene};
use replay::Replay;
pub use replay::ReplayConfig;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tessera_kdtree::Kernel;
use tessera_pack::Pack;
use tessera_wire::PackRefusal;

/// What a user asks for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BackendConfig {
    /// CPU, GPU, or what is faster.
    pub choice: BackendChoice,
    /// Which GPU: its number in [`adapters`], or a part of its name; `None`: the best.
    pub gpu: Option<String>,
    /// How the CPU traces rays.
    pub kernel: Kernel,
}

/// `--backend`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BackendChoice {
    /// The GPU where there is a real one and it is the faster, else the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU, or an error. A software driver counts if it is named or the only one.
    Gpu,
}

/// A GPU, or a driver that plays one, as `tessera doctor` lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adapter {
    /// Its number for `--gpu`.
    pub index: usize,
    /// As the driver calls it.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// `vulkan`, `metal`, `dx12`.
    pub api: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Bytes of its memory, where the driver says so.
    pub memory: Option<u64>,
    /// Limits that matter to a scene: names and values, bytes or counts.
    pub limits: Vec<(&'static str, u64)>,
    /// Whether it computes in `f64`: then its hits are those of the CPU.
    pub has_f64: bool,
    /// Why it cannot be used, if it cannot.
    pub unusable: Option<String>,
}

/// All adapters of this machine, usable or not.
pub fn adapters() -> Vec<Adapter> {
    gpu::adapter::list()
}

/// Why a backend cannot be had.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BackendError {
    /// There is no GPU.
    #[error(
        "no GPU was found: install its Vulkan driver (on Debian `mesa-vulkan-drivers` has those of AMD and Intel and a software one), \
         look at `tessera doctor`, or use --backend cpu"
    )]
    NoAdapter,
    /// There is none of that name or number.
    #[error("no GPU matches `{wanted}`: there is {found}; see `tessera doctor`")]
    NoSuchAdapter {
        /// What was asked for.
        wanted: String,
        /// What there is.
        found: String,
    },
    /// It is there and does not work.
    #[error("the GPU {name} cannot be used: {reason}")]
    Unusable {
        /// Which.
        name: String,
        /// Why.
        reason: String,
    },
}

/// Why a pack is not held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PackFault {
    /// It is too large.
    Refused(PackRefusal),
    /// The device has failed, with the reason.
    Failed(String),
}

/// What renders, opened once for the life of a worker. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Backend {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    kernel: Kernel,
    engine: Engine,
    speed: u64,
    note: String,
    /// Whether the CPU may take over when the GPU fails.
    is_auto: bool,
    has_failed: AtomicBool,
    /// How fast the CPU is to seem beside what it is.
    pace: Option<f64>,
}

#[derive(Debug)]
pub(crate) enum Engine {
    Cpu,
    Gpu(GpuEngine),
    Replay(Replay),
}

/// A GPU and the scene that it holds.
pub(crate) struct GpuEngine {
    gpu: Gpu,
    scene: Mutex<Option<Arc<GpuScene>>>,
}

impl fmt::Debug for GpuEngine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.gpu.fmt(f)
    }
}

/// Longer than the render thread keeps a scene that nothing is rendered of.
const LETTING_GO: Duration = Duration::from_secs(1);

/// Tiles that a GPU is handed before it has finished any: enough that one submission can be computed while the one before is read back.
const GPU_TILES_AHEAD: usize = 64;

impl Inner {
    fn new(config: &BackendConfig, engine: Engine, speed: u64, note: String) -> Self {
        Self {
            kernel: config.kernel,
            engine,
            speed,
            note,
            is_auto: config.choice == BackendChoice::Auto,
            has_failed: AtomicBool::new(false),
            pace: None,
        }
    }
}

impl Backend {
    /// Opens what `config` asks for and measures it on a calibration tile.
    pub fn open(config: &BackendConfig) -> Result<Self, BackendError> {
        let wanted = config.gpu.as_deref();
        match config.choice {
            BackendChoice::Cpu => Ok(Self::cpu(config, "--backend cpu".into())),
            BackendChoice::Gpu => {
                let (engine, speed) = open_gpu(wanted)?;
                let note = format!("rendering on the GPU {}, {}", described(&engine.gpu), rays(speed));
                Ok(Self::new(config, Engine::Gpu(engine), speed, note))
            }
            BackendChoice::Auto => Self::auto(config, wanted),
        }
    }

    /// The GPU where there is a real one (or `wanted` names one) and it is the faster.
    fn auto(config: &BackendConfig, wanted: Option<&str>) -> Result<Self, BackendError> {
        let adapters = adapters();
        let real = adapters.iter().filter(|a| a.kind != "software" && a.unusable.is_none());
        let candidates: Vec<String> = match wanted {
            Some(wanted) => vec![wanted.to_owned()],
            None => real.map(|adapter| adapter.index.to_string()).collect(),
        };

        // Take the first that works.
        let mut failed = None;
        let mut opened = None;
        for candidate in &candidates {
            match open_gpu(Some(candidate)) {
                Ok(it_works) => {
                    opened = Some(it_works);
                    break;
                }
                Err(BackendError::Unusable { name, reason }) => {
                    failed.get_or_insert(format!("the GPU {name} cannot be used: {reason}"));
                }
                Err(error) => return Err(error),
            }
        }
        let Some((engine, speed)) = opened else {
            let why = failed.unwrap_or_else(|| match adapters.first() {
                None => "no GPU was found".into(),
                Some(adapter) => match &adapter.unusable {
                    Some(reason) => format!("the GPU {} cannot be used: {reason}", adapter.name),
                    None => format!("{} is no GPU but a software driver", adapter.name),
                },
            });
            return Ok(Self::cpu(config, why));
        };
        let cpu_speed = calibrate::cpu(config.kernel);
        let name = described(&engine.gpu);
        if cpu_speed > speed {
            let why = format!("it is faster ({}) than the GPU {name} ({})", rays(cpu_speed), rays(speed));
            return Ok(Self::new(config, Engine::Cpu, cpu_speed, format!("rendering on the CPU: {why}")));
        }
        let note = format!("rendering on the GPU {name}: {}, the CPU {}", rays(speed), rays(cpu_speed));
        Ok(Self::new(config, Engine::Gpu(engine), speed, note))
    }

    fn cpu(config: &BackendConfig, why: String) -> Self {
        let speed = calibrate::cpu(config.kernel);
        let note = format!("rendering on the CPU ({}, {}): {why}", config.kernel.name(), rays(speed));
        Self::new(config, Engine::Cpu, speed, note)
    }

    fn new(config: &BackendConfig, engine: Engine, speed: u64, note: String) -> Self {
        Self { inner: Arc::new(Inner::new(config, engine, speed, note)) }
    }

    /// A device that is played from a recording.
    pub fn replay(config: &ReplayConfig) -> Result<Self, RecordingError> {
        let replay = Replay::open(config)?;
        let note = replay.note();
        // Beside other played devices; beside real ones it means nothing.
        let speed = (1e6 * config.speed / config.scale).max(1.0) as u64;
        let cpu = BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() };
        Ok(Self::new(&cpu, Engine::Replay(replay), speed, note))
    }

    /// The CPU by `kernel`, made to seem `pace` times as fast as it is, (0, 1]: each tile is returned when the CPU time that it took, divided
    /// by `pace`, has passed. A worker that renders with more than one thread does not start with it.
    pub fn paced(kernel: Kernel, pace: f64) -> Self {
        let speed = ((calibrate::cpu(kernel) as f64 * pace) as u64).max(1);
        let note = format!("rendering on the CPU ({}) as if it were {pace} times as fast", kernel.name());
        let cpu = BackendConfig { choice: BackendChoice::Cpu, gpu: None, kernel };
        let inner = Inner { pace: Some(pace), ..Inner::new(&cpu, Engine::Cpu, speed, note) };
        Self { inner: Arc::new(inner) }
    }

    /// `cpu`, `gpu` or `replay`, as `Hello` says it.
    pub fn name(&self) -> &'static str {
        match self.inner.engine {
            Engine::Cpu => cpu::NAME,
            Engine::Gpu(_) => "gpu",
            Engine::Replay(_) => replay::NAME,
        }
    }

    /// What names its arithmetic: frames of one class are equal bit for bit. `cpu-N`, `gpu-N` with adapter and driver, or
    /// `replay`.
    pub fn numeric_class(&self) -> &str {
        match &self.inner.engine {
            Engine::Cpu => tessera_whitted::NUMERIC_CLASS,
            Engine::Gpu(engine) => engine.gpu.numeric_class(),
            Engine::Replay(_) => replay::NAME,
        }
    }

    /// Rays a second on the calibration tile, of all cores together; at least 1.
    pub fn speed(&self) -> u64 {
        self.inner.speed
    }

    /// One line: what renders, and why that was chosen.
    pub fn note(&self) -> &str {
        &self.inner.note
    }

    /// Whether it can hold `pack`; a GPU takes it into its memory here, which may take a second.
    pub fn check_pack(&self, pack: &Pack) -> Result<(), PackFault> {
        let Engine::Gpu(engine) = &self.inner.engine else { return Ok(()) };
        let Err(error) = engine.scene(pack) else { return Ok(()) };
        let name = &engine.gpu.adapter().name;
        let refusal = match error {
            GpuError::CannotHold { needs, has, what } => {
                PackRefusal::CannotHold { needs, has, what: format!("the {what} of the GPU {name}") }
            }
            GpuError::NoMemory => PackRefusal::CannotHold {
                needs: pack.bytes().len() as u64,
                has: 0,
                what: format!("what is free of the memory of the GPU {name}"),
            },
            error => {
                self.fail();
                return Err(PackFault::Failed(error.to_string()));
            }
        };
        // Who has insisted on the GPU is told; else the CPU can have it.
        if !self.inner.is_auto {
            return Err(PackFault::Refused(refusal));
        }
        self.fail();
        Err(PackFault::Failed(refusal.to_string()))
    }

    /// How many tiles it is handed before it has finished any; at least 1.
    pub fn tiles_ahead(&self) -> usize {
        match self.inner.engine {
            Engine::Cpu | Engine::Replay(_) => cpu::TILES_AHEAD,
            Engine::Gpu(_) => GPU_TILES_AHEAD,
        }
    }

    /// Notes that the GPU has failed in the middle of work, or at a scene.
    pub(crate) fn fail(&self) {
        self.inner.has_failed.store(true, Ordering::Relaxed);
    }

    /// What to go on with: the same, or the CPU after a GPU has failed that nobody had insisted on. A picture is never finished by
    /// another backend than it was begun with: the worker leaves first, and joins again as another class.
    pub fn or_fallback(&self) -> Self {
        if !(self.inner.has_failed.load(Ordering::Relaxed) && self.inner.is_auto) {
            return self.clone();
        }
        let config = BackendConfig { choice: BackendChoice::Cpu, gpu: None, kernel: self.inner.kernel };
        Self::cpu(&config, "the GPU has failed, or cannot hold the scene".into())
    }

    /// Whether [`Backend::or_fallback`] has something else to offer.
    pub(crate) fn has_fallback(&self) -> bool {
        self.inner.has_failed.load(Ordering::Relaxed) && self.inner.is_auto
    }

    /// As if the user had left the choice to us.
    #[cfg(test)]
    pub(crate) fn left_to_us(self) -> Self {
        let inner = Arc::into_inner(self.inner).expect("nobody else has it yet");
        Self { inner: Arc::new(Inner { is_auto: true, ..inner }) }
    }

    /// How the CPU traces rays, if that is what renders.
    pub(crate) fn kernel(&self) -> Kernel {
        self.inner.kernel
    }

    /// How fast the CPU is to seem beside what it is, if not so fast.
    pub(crate) fn pace(&self) -> Option<f64> {
        self.inner.pace
    }

    pub(crate) fn engine(&self) -> &Engine {
        &self.inner.engine
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl GpuEngine {
    /// Takes the device away, as a driver that resets does.
    #[cfg(test)]
    pub(crate) fn lose(&self) {
        self.gpu.device().destroy();
    }

    /// `pack` in the GPU's memory, where it stays until another one is asked for.
    pub(crate) fn scene(&self, pack: &Pack) -> Result<Arc<GpuScene>, GpuError> {
        let mut held = self.scene.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(scene) = held.as_ref().filter(|scene| scene.pack().id() == pack.id()) {
            return Ok(scene.clone());
        }
        // What was held makes room first, as soon as the render thread has let go of it.
        if let Some(old) = held.take().as_ref().map(Arc::downgrade) {
            let begun = Instant::now();
            while old.strong_count() > 0 && begun.elapsed() < LETTING_GO {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        let scene = Arc::new(GpuScene::load(&self.gpu, pack, GpuOptions::default())?);
        // Now, and not while the first tile is waited for.
        scene.warm_up()?;
        *held = Some(scene.clone());
        Ok(scene)
    }
}

fn open_gpu(wanted: Option<&str>) -> Result<(GpuEngine, u64), BackendError> {
    let gpu = Gpu::open(wanted, GpuOptions::default().f64)?;
    let speed = calibrate::gpu(&gpu).map_err(|error| BackendError::Unusable {
        name: gpu.adapter().name.clone(),
        reason: error.to_string(),
    })?;
    Ok((GpuEngine { gpu, scene: Mutex::new(None) }, speed))
}

fn described(gpu: &Gpu) -> String {
    format!("{} ({})", gpu.adapter().name, gpu.adapter().driver)
}

fn rays(a_second: u64) -> String {
    format!("{:.3} million rays a second", a_second as f64 / 1e6)
}
