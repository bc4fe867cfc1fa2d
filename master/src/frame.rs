//! What a frame is asked for, and what comes back.

use crate::{Balance, FrameBuffer};
use std::{fmt, time::Duration};
use tessera_geometry::{LocalCamera, Vec3};
use tessera_pack::PackId;
use tessera_wire::{Attempt, Camera, Coding, Features, Frame, FrameId, PixelFormat, Rays, Sampling, TileId};

/// One frame of the loaded pack.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameJob {
    /// The view, in the pack's local units.
    pub camera: LocalCamera,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Side of a tile; 0: as suits the workers and what tiles have cost.
    pub tile: u32,
    /// Samples a pixel; with adaptive sampling the most that one gets.
    pub samples: u32,
    /// How they are taken.
    pub sampling: Sampling,
    /// Reflections and refractions a path may take.
    pub depth: u32,
    /// Seed of the sampler.
    pub seed: u64,
    /// What is switched on.
    pub features: Features,
    /// What a pixel holds.
    pub format: PixelFormat,
    /// How tiles get to workers.
    pub balance: Balance,
    /// Whether workers of several numeric classes may take part. If not, those of one do, and a picture is of one class.
    pub mix: bool,
    /// How pixels travel; `None`: without loss, packed where that is faster than sending them raw.
    pub coding: Option<Coding>,
}

impl FrameJob {
    /// Side of a tile unless something else is known: the best in most of the measurements of Seo, Park, Ihm 2022.
    pub const TILE: u32 = 128;

    /// A view with nothing special about it: one sample in the middle of a pixel, 8 reflections and refractions, everything switched on, a
    /// displayable picture, tiles of [`FrameJob::TILE`], the default balancing.
    pub fn new(camera: LocalCamera, width: u32, height: u32) -> Self {
        Self {
            camera,
            width,
            height,
            tile: Self::TILE,
            samples: 1,
            sampling: Sampling::default(),
            depth: 8,
            seed: 0,
            features: Features::default(),
            format: PixelFormat::Rgba8,
            balance: Balance::default(),
            mix: false,
            coding: None,
        }
    }

    /// The job as a message.
    pub fn to_wire(&self, frame: FrameId, pack: tessera_wire::PackId) -> Frame {
        let Self { camera, width, height, tile, samples, sampling, depth, seed, features, format, .. } =
            *self;
        let camera = Camera {
            origin: camera.origin.to_array(),
            forward: camera.forward.to_array(),
            right: camera.right.to_array(),
            up: camera.up.to_array(),
        };
        let returns = self.balance.returns();
        let tile = if tile == 0 { Self::TILE } else { tile };
        Frame {
            frame,
            pack,
            camera,
            width,
            height,
            tile,
            samples,
            sampling,
            depth,
            seed,
            features,
            format,
            returns,
            coding: self.coding.unwrap_or_default(),
        }
    }
}

impl FrameJob {
    /// Of its image; the job is in range.
    pub(crate) fn image_bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * self.format.bytes_per_pixel() as u64
    }

    /// Of its largest tile; the job is in range.
    pub(crate) fn tile_bytes(&self) -> u64 {
        // What is chosen for 0 is smaller.
        let tile = if self.tile == 0 { Self::TILE } else { self.tile };
        let side = |length: u32| u64::from(length.min(tile));
        side(self.width) * side(self.height) * self.format.bytes_per_pixel() as u64
    }

    /// The job of a client.
    pub(crate) fn from_wire(frame: &Frame, balance: Balance, mix: bool) -> Self {
        let Frame { camera, width, height, tile, samples, sampling, depth, seed, features, format, .. } =
            *frame;
        let camera = LocalCamera {
            origin: Vec3::from_array(camera.origin),
            forward: Vec3::from_array(camera.forward),
            right: Vec3::from_array(camera.right),
            up: Vec3::from_array(camera.up),
        };
        // Whether the picture is rounded is the client's business, how its tiles travel here the master's.
        let coding = Some(Coding::Rounded).filter(|rounded| frame.coding == *rounded);
        Self {
            camera,
            width,
            height,
            tile,
            samples,
            sampling,
            depth,
            seed,
            features,
            format,
            balance,
            mix,
            coding,
        }
    }
}

/// What happens, as it happens; for progress bars and logs.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress<'a> {
    /// At a master elsewhere: frames of others come first.
    Waiting {
        /// How many.
        ahead: u32,
    },
    /// No worker has joined; the frame waits for one.
    NoWorkers,
    /// Pack bytes handed to the transport, over all workers.
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
    /// A worker cannot hold the scene; it stays, and the others go on.
    PackRejected {
        /// Its name.
        name: &'a str,
        /// Why.
        reason: &'a str,
    },
    /// A worker has joined.
    WorkerJoined {
        /// Its name.
        name: &'a str,
        /// From where.
        peer: &'a str,
        /// Its arithmetic.
        class: &'a str,
    },
    /// The frame is rendered by workers of one numeric class, and there are others.
    ClassChosen {
        /// The class.
        class: &'a str,
        /// Workers of it.
        workers: u32,
        /// Workers of other classes, which hold the scene and have no part.
        idle: u32,
    },
    /// The last worker of the frame's class was lost, and workers of another class begin it again.
    Restarted {
        /// The class before.
        from: &'a str,
        /// The class now.
        to: &'a str,
        /// Tiles that were in the image.
        dropped: u32,
    },
    /// A worker is gone; the others go on.
    WorkerLost {
        /// Its name.
        name: &'a str,
        /// Why.
        reason: &'a str,
    },
}

impl fmt::Display for Progress<'_> {
    /// One line for a log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Waiting { ahead } => {
                write!(f, "waiting: the master renders for others first ({ahead} before this frame)")
            }
            Self::NoWorkers => write!(f, "waiting: no worker has joined the master yet"),
            Self::Sent { bytes, total } => write!(f, "{bytes} of {total} bytes of the scene are sent"),
            Self::Tiles { done, total } => write!(f, "{done} of {total} tiles"),
            Self::PackRejected { name, reason } => write!(f, "{name} cannot hold the scene: {reason}"),
            Self::WorkerJoined { name, peer, class } => {
                write!(f, "{name} has joined from {peer}, numeric class {class}")
            }
            Self::ClassChosen { class, workers, idle } => {
                let holders = u64::from(workers) + u64::from(idle);
                write!(f, "the frame is rendered in class {class} by {workers} of {holders} workers; ")?;
                write!(f, "the others are of other classes and idle, --mix lets them take part")
            }
            Self::Restarted { from, to, dropped } => {
                write!(
                    f,
                    "the last worker of class {from} is lost: class {to} begins the frame again, and "
                )?;
                write!(f, "{dropped} finished tiles are dropped, so that the picture does not mix classes")
            }
            Self::WorkerLost { name, reason } => write!(f, "{name} is lost: {reason}"),
        }
    }
}

/// A frame and how it came about.
#[derive(Clone, Debug)]
pub struct FrameResult<I = FrameBuffer> {
    /// The image, or what is known of one whose rows have gone elsewhere.
    pub image: I,
    /// The pack that was rendered.
    pub pack: PackId,
    /// The arithmetics that rendered it, those with most tiles first: one, unless the job lets them be mixed.
    pub classes: Vec<ClassPart>,
    /// How far they differ, by pairs; empty with one class.
    pub differences: Vec<ClassDifference>,
    /// Workers that hold the pack and had no part because they are of other classes.
    pub idle: u32,
    /// Every worker that took part or has rejected the scene: those that were started with the cluster, in that order, then those
    /// that joined, likewise. One that was lost and came back is there twice.
    pub workers: Vec<WorkerReport>,
    /// Where the time went.
    pub timings: Timings,
    /// Bytes on the wire since the cluster started, or for a client since its frame's turn came: handshake, pack, frames.
    pub traffic: Traffic,
    /// What the master's thread did for it: since the result before, if frames overlap. Nothing is known of a master elsewhere.
    pub master: MasterWork,
    /// Rays of the image: each tile counted once, however often it was rendered.
    pub rays: Rays,
    /// Results that came twice or too late, or of a class that was lost, and were dropped.
    pub dropped_tiles: u64,
    /// How its pixels travelled; for a frame of a master elsewhere, whether they were rounded is all that is known.
    pub coding: Coding,
    /// Every result that came for this frame, in the order of coming, dropped ones too; empty for a frame of a master elsewhere.
    pub tiles: Vec<TileRecord>,
    /// Side of its tiles; 0 for a frame of a master elsewhere.
    pub tile: u32,
    /// Why it was balanced as it was; of `auto`, and not of a master elsewhere.
    pub why: Option<String>,
}

/// What the thread that leads the cluster has done. Others beside it receive, decrypt and unpack.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MasterWork {
    /// How long it was at work, by the clock on the wall, without planning the frame.
    pub busy: Duration,
    /// Messages that it took and sent; a tile's result is one.
    pub messages: u64,
}

/// Where the time of a tile went. Times of the master's clock count from the frame's begin, those of the worker's are lengths alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRecord {
    /// Which tile.
    pub tile: TileId,
    /// Times that it had been handed out before.
    pub attempt: Attempt,
    /// Whose: an index into [`FrameResult::workers`].
    pub worker: usize,
    /// When it was handed out.
    pub assigned: Duration,
    /// When all of its bytes were here.
    pub received: Duration,
    /// How long the worker's renderer had nothing to do before it.
    pub idle: Duration,
    /// Of rendering.
    pub render: Duration,
    /// Of coding.
    pub coding: Duration,
    /// From the end of rendering until it was handed to the transport, coding included.
    pub waited: Duration,
    /// Bytes on the wire, with its batch's header if it is the first of it.
    pub wire_bytes: u64,
    /// Bytes of its pixels.
    pub pixel_bytes: u32,
    /// Whether it is the one in the image.
    pub is_first: bool,
}

impl<I> FrameResult<I> {
    /// The same with another account of the image, and this one.
    pub fn with_image<J>(self, image: J) -> (FrameResult<J>, I) {
        let Self {
            image: before,
            pack,
            classes,
            differences,
            idle,
            workers,
            timings,
            traffic,
            master,
            rays,
            dropped_tiles,
            coding,
            tiles,
            tile,
            why,
        } = self;
        let after = FrameResult {
            image,
            pack,
            classes,
            differences,
            idle,
            workers,
            timings,
            traffic,
            master,
            rays,
            dropped_tiles,
            coding,
            tiles,
            tile,
            why,
        };
        (after, before)
    }

    /// The arithmetic that rendered it, if it is one.
    pub fn numeric_class(&self) -> Option<&str> {
        match &self.classes[..] {
            [one] => Some(&one.class),
            _ => None,
        }
    }
}

/// A numeric class's part in a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClassPart {
    /// Its name.
    pub class: String,
    /// Workers of it that took part.
    pub workers: u32,
    /// Tiles of the image that came from them.
    pub tiles: u32,
}

/// How far two classes differ, over tiles of the image that came from one of them and were rendered by the other too.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassDifference {
    /// Their names, in order.
    pub classes: [String; 2],
    /// Tiles that were compared.
    pub tiles: u32,
    /// Their pixels.
    pub pixels: u64,
    /// Pixels with another byte anywhere, in alpha and layers too.
    pub differing: u64,
    /// Largest difference of a red, green or blue value: in codes, for layers in linear light.
    pub max_abs: f64,
    /// Of red, green and blue, in dB; `None` if they are equal.
    pub psnr_db: Option<f64>,
}

/// A worker's part in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerReport {
    /// Its name.
    pub name: String,
    /// What renders there: `cpu` or `gpu`.
    pub backend: String,
    /// Its arithmetic.
    pub numeric_class: String,
    /// Its own word on the device and why it was chosen.
    pub note: String,
    /// The shortest round trip to it, if the transport has measured one.
    pub round_trip: Option<Duration>,
    /// Tiles of the image that came from it.
    pub tiles: u32,
    /// Wall time that it spent rendering those tiles, by its own clock.
    pub render: Duration,
    /// Bytes that it returned for this frame: pixels and their headers, dropped ones included.
    pub bytes_returned: u64,
    /// Why it was lost, if it was.
    pub lost: Option<String>,
    /// Why it does not hold the scene and had no part, if it has rejected it.
    pub rejected: Option<String>,
}

/// Where a frame's time went, by the master's clock. `frame` is `render` + `return_`; `send_scene` lies
/// before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timings {
    /// From the pack's first offer to the last worker's word that it holds it.
    pub send_scene: Duration,
    /// From the frame's announcement to the last worker's word that its last tile is rendered.
    pub render: Duration,
    /// From then to the last byte of the image: what the network adds when rendering no longer hides it.
    pub return_: Duration,
    /// From the frame's announcement to the complete image.
    pub frame: Duration,
}

impl MasterWork {
    /// Microseconds for each message; `None` where there was none.
    pub fn us_per_message(&self) -> Option<f64> {
        (self.messages > 0).then(|| 1e6 * self.busy.as_secs_f64() / self.messages as f64)
    }
}

impl Traffic {
    /// What has come to `earlier` since then.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            sent: self.sent.saturating_sub(earlier.sent),
            received: self.received.saturating_sub(earlier.received),
            udp_sent: self.udp_sent.saturating_sub(earlier.udp_sent),
            udp_received: self.udp_received.saturating_sub(earlier.udp_received),
        }
    }
}

/// Bytes on the wire, both directions seen from the master.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Sent: messages with their prefixes, and raw bytes.
    pub sent: u64,
    /// Received, likewise.
    pub received: u64,
    /// UDP payload sent: with QUIC's headers, acknowledgements and repeats; 0 on in-memory links.
    pub udp_sent: u64,
    /// UDP payload received.
    pub udp_received: u64,
}
