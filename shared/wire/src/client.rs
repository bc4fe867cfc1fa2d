//! Messages between a client, which has frames rendered, and the master.

use crate::{AbortCode, Balance, Frame, FrameId, Hello, PackId, PackRefusal, Rays, Refusal, limits};
use bincode::{Decode, Encode};

/// Client to master.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum FromClient {
    /// First message; answered by `Welcome` or `Refuse`. As a worker's.
    Hello(Hello),
    /// A pack that frames will ask for; answered by `PackNeed` or `PackRejected`.
    PackOffer {
        /// Its content hash.
        pack: PackId,
        /// Its bytes.
        length: u64,
    },
    /// A frame of the pack that the master has said ready last; answered by `Finished` or `Failed`. One at a time.
    Render {
        /// What to render. Its number is the client's own; `returns` is left to the master.
        frame: Frame,
        /// How tiles get to workers.
        balance: Balance,
        /// Whether workers of several numeric classes may take part; the summary then says how far the classes differ.
        mix: bool,
    },
    /// The client cuts the connection. To close it says the same, without words.
    Abort {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
}

/// Master to client.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum ToClient {
    /// The client may go on.
    Welcome {
        /// Protocol version of everything that follows.
        version: u16,
    },
    /// It may not; the connection ends. The number and the layout are those of a worker's.
    Refuse(Refusal),
    /// Answer to `PackOffer`: whether the master holds the pack or wants its bytes.
    PackNeed {
        /// The pack that was offered.
        pack: PackId,
        /// `true`: no bytes are needed, `PackReady` follows.
        have: bool,
    },
    /// The pack is held and checked; frames of it may be asked for.
    PackReady {
        /// Which.
        pack: PackId,
    },
    /// The pack cannot be held; another may.
    PackRejected {
        /// Which.
        pack: PackId,
        /// Why.
        reason: PackRefusal,
    },
    /// The frame waits for those of others.
    Waiting {
        /// How many.
        ahead: u32,
    },
    /// The frame waits for a worker: none has joined.
    NoWorkers,
    /// Bytes of the pack on their way to workers.
    Sent {
        /// So far.
        bytes: u64,
        /// To be sent.
        total: u64,
    },
    /// Tiles in the image.
    Tiles {
        /// So far.
        done: u32,
        /// Of the frame.
        total: u32,
    },
    /// A worker was lost; others go on.
    WorkerLost {
        /// Its name.
        name: String,
        /// Why.
        reason: String,
    },
    /// A worker cannot hold the pack; others go on.
    WorkerRejects {
        /// Its name.
        name: String,
        /// Why.
        reason: String,
    },
    /// The frame is complete: a [`FrameSummary`] and the raw pixels follow on the bulk pipe.
    Finished {
        /// Which.
        frame: FrameId,
    },
    /// There will be no such frame.
    Failed {
        /// Which.
        frame: FrameId,
        /// Why.
        reason: FrameFailure,
    },
    /// The master cuts the connection.
    Abort {
        /// Kind.
        code: AbortCode,
        /// For people.
        detail: String,
    },
    /// The last worker of the frame's numeric class was lost, and workers of another begin it again.
    Restarted {
        /// The class before.
        from: String,
        /// The class now.
        to: String,
        /// Tiles that were in the image.
        dropped: u32,
    },
}

/// Why a client gets no frame.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode, thiserror::Error)]
pub enum FrameFailure {
    /// Too many frames wait already.
    #[error("the master is busy: {waiting} frames of others wait already; try again later")]
    Busy {
        /// How many.
        waiting: u32,
    },
    /// A number in it is out of range, or its pack is not the one that the master holds for this client.
    #[error("the master cannot render this frame: {detail}")]
    Invalid {
        /// What is wrong.
        detail: String,
    },
    /// No worker has joined, none can hold the pack, or all were lost.
    #[error("{detail}")]
    Crew {
        /// What happened.
        detail: String,
    },
    /// The master was told to end.
    #[error("the master is being stopped")]
    Stopping,
}

/// Master to client: how a frame came about. `length` raw bytes follow, the image's rows from the top.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct FrameSummary {
    /// Which frame.
    pub frame: FrameId,
    /// Exactly the image in the frame's format.
    pub length: u64,
    /// The arithmetics that rendered it, one unless they may be mixed; at most [`limits::CLASSES`].
    pub classes: Vec<ClassSummary>,
    /// How far they differ, by pairs that were compared.
    pub differences: Vec<DifferenceSummary>,
    /// Workers that hold the pack and had no part, because they are of other classes.
    pub idle: u32,
    /// Who took part, at most [`limits::WORKERS`].
    pub workers: Vec<WorkerSummary>,
    /// Times by the master's clock, in microseconds: sending the pack, rendering, returning, the last two together.
    pub times_us: [u64; 4],
    /// Bytes of messages sent and received by the master to and from workers, and of UDP payload likewise.
    pub traffic: [u64; 4],
    /// Of the image.
    pub rays: Rays,
    /// Results that came twice or too late.
    pub dropped_tiles: u64,
}

/// A worker's part in a frame.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct WorkerSummary {
    /// Its name.
    pub name: String,
    /// What renders there.
    pub backend: String,
    /// Its arithmetic.
    pub numeric_class: String,
    /// Its word on the device.
    pub note: String,
    /// Tiles of the image that came from it.
    pub tiles: u32,
    /// Time that it spent rendering those, in microseconds by its own clock.
    pub render_us: u64,
    /// Bytes that it returned.
    pub bytes_returned: u64,
    /// Why it was lost, if it was.
    pub lost: Option<String>,
    /// Why it could not hold the pack, if it could not.
    pub rejected: Option<String>,
}

/// A numeric class in an image.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct ClassSummary {
    /// Its name.
    pub class: String,
    /// Workers of it that took part.
    pub workers: u32,
    /// Tiles of the image that came from them.
    pub tiles: u32,
}

/// How far two classes differ: over tiles of the image that came from one of them and were rendered by the other too.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct DifferenceSummary {
    /// Their names, in order.
    pub classes: [String; 2],
    /// Tiles that were compared.
    pub tiles: u32,
    /// Pixels of those.
    pub pixels: u64,
    /// Pixels with another byte.
    pub differing: u64,
    /// Largest difference of a red, green or blue value, in codes; in linear light for layers.
    pub max_abs: f64,
    /// Of red, green and blue, in dB; none when they are equal.
    pub psnr_db: Option<f64>,
}

// `limits::HEADER_BYTES` counts on this: six texts a worker, one a class and two a pair of them, and what they take in memory.
const _: () = {
    let worker = size_of::<WorkerSummary>() + 6 * limits::TEXT_BYTES;
    let class = size_of::<ClassSummary>() + limits::TEXT_BYTES;
    let pair = size_of::<DifferenceSummary>() + 2 * limits::TEXT_BYTES;
    let pairs = limits::CLASSES * (limits::CLASSES - 1) / 2;
    let all = worker * limits::WORKERS + class * limits::CLASSES + pair * pairs;
    assert!(all <= limits::HEADER_BYTES - 4096);
};

impl FrameSummary {
    /// Checks that it is of `frame` and announces its pixels; texts and lists are bounded by the message's limit.
    pub fn check(&self, frame: &Frame) -> Result<(), String> {
        let pixels = u64::from(frame.width) * u64::from(frame.height);
        let expected = pixels * frame.format.bytes_per_pixel() as u64;
        if self.frame != frame.frame || self.length != expected {
            return Err(format!(
                "frame {} of {} bytes came instead of frame {} of {expected}",
                self.frame.0, self.length, frame.frame.0
            ));
        }
        Ok(())
    }
}
