//! The service side: preparing a scene, dispatching tiles, assembling the image.
//!
//! A render is four calls: [`Cluster::start`] gets workers to join, [`Cluster::load`] gives them a pack, [`Cluster::render`] makes a
//! frame, [`Cluster::stop`] sends them home.

mod cluster;
pub mod compare;
pub mod dispatch;
pub mod image;
pub mod output;
mod transport;

pub use cluster::{
    Cluster, ClusterConfig, FrameJob, FrameResult, LoadError, LocalWorkers, Progress, RenderError,
    StartError, Timings, Traffic, WorkerReport, Workers,
};
pub use dispatch::Balance;
pub use image::{FrameBuffer, ImageHash, PixelFormat};
pub use output::{OutputError, OutputFile};
pub use transport::{Link, Pipes, Reader, Writer};
