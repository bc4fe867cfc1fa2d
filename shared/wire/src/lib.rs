//! Messages between master and worker, their codec, limits and versions.
//!
//! `PROTOCOL.md` beside this crate says who sends what to whom and why. Nothing here knows a socket, a clock,
//! or a type of another room: plain numbers and newtype ids only.
//!
//! A connection has a **control** pipe in both directions ([`ToMaster`], [`ToWorker`]) and a **bulk** pipe in
//! both directions ([`PackChunk`] towards the worker, [`BatchHeader`] towards the master), whose frames are
//! followed by raw bytes. A client speaks the same way ([`FromClient`], [`ToClient`]; [`PackChunk`] towards the master,
//! [`FrameSummary`] towards the client).

pub mod codec;
pub mod limits;
pub mod pixels;

mod balance;
mod bulk;
mod client;
mod error;
mod frame;
mod grid;
mod ids;
mod join;
mod message;
mod ticket;
mod version;

pub use balance::Balance;
pub use bulk::{BatchHeader, PackChunk, PackProgress, Rays, TileCoding, TileEntry};
pub use client::{
    ClassSummary, DifferenceSummary, FrameFailure, FrameSummary, FromClient, ToClient, WorkerSummary,
};
pub use error::{AbortCode, PackRefusal, Refusal, plain_text};
pub use frame::{
    Adaptive, Camera, Coding, Features, Frame, FrameError, PixelFormat, ReturnMode, Sampler, Sampling,
};
pub use grid::{Rect, TileGrid};
pub use ids::{Attempt, FrameId, PackId, TileId, WorkerId};
pub use join::{Fingerprint, JoinString, JoinStringError, Token};
pub use message::{Abilities, Hello, Role, ToMaster, ToWorker};
pub use ticket::LocalTicket;
pub use version::Version;
