//! The service side: preparing a scene, dispatching tiles, assembling the image.
//!
//! A render is four calls: [`Cluster::start`] gets workers to join, [`Cluster::load`] gives them a pack, [`Cluster::render`] makes a
//! frame (or [`Cluster::frames`] many, several at a time), [`Cluster::stop`] sends them home. [`Service`] does that for clients, one of which is [`Client`].

mod admission;
mod bands;
mod client;
mod clients;
mod cluster;
mod coding;
pub mod compare;
pub mod coordinator;
mod difference;
mod dispatch;
mod door;
mod frame;
pub mod image;
mod input;
mod line;
mod net;
pub mod output;
mod packs;
mod png;
pub mod prepare;
mod probe;
pub mod report;
mod service;
mod session;
pub mod slow;
mod spawn;
pub mod trace;
mod transport;

pub use client::{Client, ClientError};
pub use cluster::{
    Cluster, ClusterConfig, FrameQueue, ListenConfig, LoadError, LocalWorkers, RenderError, SequenceConfig,
    SequenceFrame, Stale, StartError, Workers,
};
pub use difference::Difference;
pub use dispatch::Balance;
pub use frame::{
    ClassDifference, ClassPart, FrameJob, FrameResult, MasterWork, Progress, TileRecord, Timings, Traffic,
    WorkerReport,
};
pub use image::{FrameBuffer, ImageHash, ImageHasher, PixelFormat};
pub use net::UdpBuffers;
pub use output::{OutputError, OutputFile};
pub use png::PngStream;
pub use prepare::{PrepareError, PrepareOptions, Prepared};
pub use probe::{LinkProbe, ProbeError};
pub use service::{Service, ServiceConfig};
pub use spawn::Detour;
pub use transport::{Link, Pipes, Reader, Writer};
