//! A GPU by way of wgpu: the only room that names it.
//!
//! | file | holds |
//! |---|---|
//! | `adapter.rs` | what GPUs there are, and which one is meant |
//! | `device.rs` | an opened one: its limits, its errors, how it is lost |
//! | `kernel.rs` | the kernels' text and what is compiled of it |
//! | `scene.rs` | a pack in its memory |
//! | `pass.rs` | tiles cut into pieces of bounded work; pure |
//! | `slot.rs` | the buffers of one submission |
//! | `tiles.rs`, `slot.rs` | tiles on their way: submitted, awaited, read back |
//! | `wavefront.rs` | paths taken step by step |
//! | `wavefront.rs` | the same paths step by step, all rays of a kind together |
//! | `probe.rs`, `policy.rs` | single rays and paths, for tests and tools; whether tests need a GPU |
//! | `policy.rs` | whether tests need a GPU |
//!
//! The work goes in submissions of bounded length, two of them under way: while one is computed, the pixels of the one before are read back.

pub(crate) mod adapter;
mod device;
mod kernel;
#[cfg(test)]
mod kernel_tests;
mod pass;
mod policy;
pub mod probe;
mod scene;
mod slot;
pub(crate) mod tiles;
mod wavefront;

pub(crate) use device::Gpu;
pub use kernel::{GpuOptions, TraversalForm};
pub use policy::TestPolicy;
pub(crate) use scene::GpuScene;

/// Version of the kernels, part of the numeric class: raise it with every change of a result.
pub(crate) const KERNEL_VERSION: u32 = 2;

/// Why a GPU did not do what was asked.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// The scene does not fit.
    #[error("the GPU's {what} can hold {has} bytes, the scene needs {needs}")]
    CannotHold {
        /// Bytes of the scene.
        needs: u64,
        /// Bytes that there are.
        has: u64,
        /// What has so many: `memory`, `bindings`.
        what: &'static str,
    },
    /// The driver gave up: reset, unplugged, crashed.
    #[error("the GPU is lost: {0}")]
    Lost(String),
    /// A submission did not end in time.
    #[error("the GPU has not answered for {seconds} s: it is taken for hung")]
    Hung {
        /// So long.
        seconds: u64,
    },
    /// The driver has no memory left, whatever the numbers say.
    #[error("the GPU has no memory left")]
    NoMemory,
    /// The driver has ended loops of a kernel early.
    #[error(
        "the GPU's driver ends long loops early, so that pictures would be wrong: Mesa's software drivers let a kernel's loops take 65,535 \
         turns; use --backend cpu"
    )]
    LoopsCut,
    /// The driver refused something that should work.
    #[error("the GPU's driver refuses: {0}")]
    Refused(String),
}
