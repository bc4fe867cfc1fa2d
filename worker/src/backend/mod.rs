//! What renders: the CPU, or a GPU by way of wgpu.

pub(crate) mod cpu;

use std::fmt;
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
    Vec::new()
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

/// What renders, opened once for the life of a worker. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Backend {
    kernel: Kernel,
    speed: u64,
    note: String,
}

impl Backend {
    /// Opens what `config` asks for and measures it on a calibration tile.
    pub fn open(config: &BackendConfig) -> Result<Self, BackendError> {
        match config.choice {
            BackendChoice::Gpu => Err(BackendError::NoAdapter),
            BackendChoice::Auto | BackendChoice::Cpu => Ok(Self {
                kernel: config.kernel,
                speed: 1_000_000,
                note: "rendering on the CPU: no GPU was found".into(),
            }),
        }
    }

    /// `cpu` or `gpu`, as `Hello` says it.
    pub fn name(&self) -> &'static str {
        cpu::NAME
    }

    /// What names its arithmetic: frames of one class are equal bit for bit. `cpu-N`, or `gpu-N` with adapter and driver.
    pub fn numeric_class(&self) -> &str {
        tessera_whitted::NUMERIC_CLASS
    }

    /// Rays a second on the calibration tile, of all threads together; at least 1.
    pub fn speed(&self) -> u64 {
        self.speed
    }

    /// One line: what renders, and why that was chosen.
    pub fn note(&self) -> &str {
        &self.note
    }

    /// Whether it can hold `pack`.
    pub fn check_pack(&self, _pack: &Pack) -> Result<(), PackRefusal> {
        Ok(())
    }

    /// How many tiles it is handed before it has finished any; at least 1.
    pub fn tiles_ahead(&self) -> usize {
        cpu::TILES_AHEAD
    }

    /// How the CPU traces rays, if that is what renders.
    pub(crate) fn kernel(&self) -> Kernel {
        self.kernel
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
