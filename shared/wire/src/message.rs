//! Control messages.

use crate::{
    AbortCode, Attempt, Frame, FrameId, PackId, PackRefusal, Refusal, TileId, Token, WorkerId, limits,
};
use bincode::{Decode, Encode};

/// A peer introduces itself: the first message on a connection.
///
/// That it is variant 0 of its enum and begins with the list of versions is frozen: the master reads that much of every peer's, and
/// parts from those of other versions with a reason. A later version may add fields behind the last one; an earlier one skips them.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Hello {
    /// Protocol versions that the peer speaks, at most [`limits::VERSIONS`].
    pub versions: Vec<u16>,
    /// What lets it in, see [`crate::JoinString`].
    pub token: Token,
    /// For people: 1..=[`limits::TEXT_BYTES`] bytes without control characters.
    pub name: String,
    /// What it has come for.
    pub role: Role,
}

/// What a peer has come for.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub enum Role {
    /// To render: [`ToMaster`] and [`ToWorker`] follow.
    Worker(Abilities),
    /// To have frames rendered.
    Client,
}

/// What a worker says of itself.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Abilities {
    /// Bytes that the worker may use for a pack; 0 when it does not know.
    pub memory: u64,
    /// Threads that render.
    pub threads: u32,
    /// What renders, for people: `cpu`, `gpu`.
    pub backend: String,
    /// Workers of one class give equal bytes for equal frames.
    pub numeric_class: String,
    /// Rays a second on the calibration tile, of all threads together; 0 when it was not measured. What the master compares between
    /// classes, and nothing else depends on it.
    pub speed: u64,
    /// Which device renders, and why that one, for people: at most [`limits::TEXT_BYTES`] bytes without control characters.
    pub note: String,
}

impl Hello {
    /// Checks lengths and characters; a peer's name ends up in logs and on terminals.
    pub fn check(&self) -> Result<(), String> {
        if self.versions.len() > limits::VERSIONS {
            return Err(format!(
                "{} versions, at most {} are allowed",
                self.versions.len(),
                limits::VERSIONS
            ));
        }
        check_text("name", &self.name)?;
        if let Role::Worker(abilities) = &self.role {
            check_text("backend", &abilities.backend)?;
            check_text("numeric class", &abilities.numeric_class)?;
            if !abilities.note.is_empty() {
                check_text("note", &abilities.note)?;
            }
            if abilities.threads == 0 {
                return Err("0 threads".into());
            }
        }
        Ok(())
    }
}

fn check_text(what: &str, text: &str) -> Result<(), String> {
    if text.is_empty() || text.len() > limits::TEXT_BYTES || !text.chars().all(crate::error::is_plain) {
        let most = limits::TEXT_BYTES;
        return Err(format!("{what} must have 1 to {most} bytes and no control characters"));
    }
    Ok(())
}

/// Worker to master.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum ToMaster {
    /// First message; answered by `Welcome` or `Refuse`. Its number is frozen.
    Hello(Hello),
    /// Answer to `PackOffer`: whether the worker holds the pack already or wants its bytes.
    PackNeed {
        /// The pack that was offered.
        pack: PackId,
        /// `true`: no bytes are needed, `PackReady` follows.
        have: bool,
    },
    /// The pack is held, checked, and can be rendered.
    PackReady {
        /// Which.
        pack: PackId,
    },
    /// The pack cannot be held; the worker stays in the session without it.
    PackRejected {
        /// Which.
        pack: PackId,
        /// Why.
        reason: PackRefusal,
    },
    /// `tiles` more tiles of `frame` are rendered and queued for return. In the pull balancings each asks for
    /// one more.
    Rendered {
        /// Which frame.
        frame: FrameId,
        /// How many since the last such message, >= 1.
        tiles: u32,
    },
    /// Answer to `Cancel`: so many of its tiles will neither be rendered to the end nor counted in `Rendered`. The others were, before.
    Cancelled {
        /// Which frame.
        frame: FrameId,
        /// How many, perhaps none.
        tiles: u32,
    },
    /// The worker is going away; what it has not returned goes to others. Sent once, nothing follows.
    Leave,
    /// The worker cuts the connection.
    Abort {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
}

/// Master to worker.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum ToWorker {
    /// The worker has joined.
    Welcome {
        /// Protocol version of everything that follows.
        version: u16,
        /// The worker's number in this session.
        worker: WorkerId,
    },
    /// The worker has not joined; the connection ends. Its number and its first variant are frozen.
    Refuse(Refusal),
    /// A pack that frames will ask for. Answered by `PackNeed`, `PackRejected`.
    PackOffer {
        /// Its content hash.
        pack: PackId,
        /// Its bytes.
        length: u64,
    },
    /// A frame begins. Those before it go on until their `EndFrame`; their tiles are rendered first.
    Frame(Frame),
    /// Tiles of a frame that has begun for this worker, to be rendered in this order.
    Assign {
        /// Which frame.
        frame: FrameId,
        /// How often these tiles had been handed out before.
        attempt: Attempt,
        /// Which tiles, at least one.
        tiles: Vec<TileId>,
    },
    /// Nobody waits for these tiles any more: others have rendered them. Those that are not finished are not finished, those that are not
    /// handed to the transport are dropped. Answered by `Cancelled`.
    Cancel {
        /// Which frame.
        frame: FrameId,
        /// Which tiles, at least one.
        tiles: Vec<TileId>,
    },
    /// The frame is over: complete, or given up. Tiles not yet rendered are forgotten.
    EndFrame {
        /// Which frame.
        frame: FrameId,
    },
    /// The session is over; the worker closes.
    Dismiss,
    /// The master cuts the connection.
    Abort {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
}
