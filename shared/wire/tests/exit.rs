//! The way out of bincode, which nobody maintains any more: wincode reads and writes the same bytes. What follows is the messages once
//! more, derived for wincode; every golden line goes through them and comes out as it was.
//!
//! To leave bincode, put these derives in the place of `Encode` and `Decode`, and [`config`] into `codec.rs`.

use std::fmt::Debug;
use wincode::config::{Config, Configuration};
use wincode::{SchemaRead, SchemaWrite};

/// Integers and lengths of variable size, enum variants as such integers: what bincode calls `config::standard()`.
macro_rules! config {
    () => {
        Configuration::default()
            .with_varint_encoding()
            .with_length_encoding::<wincode::len::UseIntLen<u64>>()
            .with_tag_encoding::<u32>()
    };
}

/// Types with the fields and variants of those of the same name in `tessera_wire`; ids are what they hold.
macro_rules! messages {
    ($($item:item)*) => { $(#[derive(Debug, PartialEq, SchemaRead, SchemaWrite)] $item)* };
}

messages! {
    enum ToMaster {
        Hello { versions: Vec<u16>, token: [u8; 16], name: String, role: Role },
        PackNeed { pack: [u8; 32], have: bool },
        PackReady { pack: [u8; 32] },
        PackRejected { pack: [u8; 32], reason: PackRefusal },
        Rendered { frame: u64, tiles: u32 },
        Cancelled { frame: u64, tiles: u32 },
        Leave,
        Abort { code: u8, detail: String },
    }
    enum Role {
        Worker { memory: u64, threads: u32, backend: String, numeric_class: String, speed: u64, note: String },
        Client,
    }
    enum PackRefusal {
        OutOfMemory { needs: u64, has: u64 },
        HashMismatch { got: [u8; 32] },
        Transfer { detail: String },
        Invalid { detail: String },
        CannotHold { needs: u64, has: u64, what: String },
    }
    enum ToWorker {
        Welcome { version: u16, worker: u32 },
        Refuse(Refusal),
        PackOffer { pack: [u8; 32], length: u64 },
        Frame(Frame),
        Assign { frame: u64, attempt: u32, tiles: Vec<u32> },
        Cancel { frame: u64, tiles: Vec<u32> },
        EndFrame { frame: u64 },
        Dismiss,
        Abort { code: u8, detail: String },
    }
    enum Refusal {
        Version { supported: Vec<u16> },
        NumericClass { expected: String },
        Malformed { detail: String },
        Token,
        Expired,
        Role,
        Full { limit: u32 },
    }
    enum FromClient {
        Hello { versions: Vec<u16>, token: [u8; 16], name: String, role: Role },
        PackOffer { pack: [u8; 32], length: u64 },
        /// And the balance.
        Render { frame: Frame, balance: u8, mix: bool },
        Abort { code: u8, detail: String },
    }
    enum ToClient {
        Welcome { version: u16 },
        Refuse(Refusal),
        PackNeed { pack: [u8; 32], have: bool },
        PackReady { pack: [u8; 32] },
        PackRejected { pack: [u8; 32], reason: PackRefusal },
        Waiting { ahead: u32 },
        NoWorkers,
        Sent { bytes: u64, total: u64 },
        Tiles { done: u32, total: u32 },
        WorkerLost { name: String, reason: String },
        WorkerRejects { name: String, reason: String },
        Finished { frame: u64 },
        Failed { frame: u64, reason: FrameFailure },
        Abort { code: u8, detail: String },
        Restarted { from: String, to: String, dropped: u32 },
    }
    enum FrameFailure {
        Busy { waiting: u32 },
        Invalid { detail: String },
        Crew { detail: String },
        Stopping,
    }
    struct FrameSummary {
        frame: u64,
        length: u64,
        classes: Vec<ClassSummary>,
        differences: Vec<DifferenceSummary>,
        idle: u32,
        workers: Vec<WorkerSummary>,
        times_us: [u64; 4],
        traffic: [u64; 4],
        rays: [u64; 4],
        dropped_tiles: u64,
    }
    struct ClassSummary { class: String, workers: u32, tiles: u32 }
    struct DifferenceSummary {
        classes: [String; 2],
        tiles: u32,
        pixels: u64,
        differing: u64,
        max_abs: f64,
        psnr_db: Option<f64>,
    }
    struct WorkerSummary {
        name: String,
        backend: String,
        numeric_class: String,
        note: String,
        tiles: u32,
        render_us: u64,
        bytes_returned: u64,
        lost: Option<String>,
        rejected: Option<String>,
    }
    struct Frame {
        frame: u64,
        pack: [u8; 32],
        /// Origin, forward, right, up.
        camera: [[f32; 3]; 4],
        width: u32,
        height: u32,
        tile: u32,
        samples: u32,
        sampling: Sampling,
        depth: u32,
        seed: u64,
        /// Shadows, reflection, refraction.
        features: [bool; 3],
        format: PixelFormat,
        returns: ReturnMode,
        coding: Coding,
    }
    enum Coding { Raw, Lossless, Rounded }
    struct Sampling { sampler: Sampler, cutoff: f32, adaptive: Option<f32> }
    enum Sampler { Jittered, LowDiscrepancy }
    enum PixelFormat { Rgba8, Rgba16, Layers }
    enum ReturnMode { AtEnd, Batches { min_bytes: u32 }, Every { tiles: u32 } }
    struct PackChunk { pack: [u8; 32], offset: u64, length: u32 }
    struct BatchHeader { frame: u64, tiles: Vec<TileEntry> }
    struct TileEntry {
        tile: u32,
        attempt: u32,
        length: u32,
        coding: TileCoding,
        pixel_bytes: u32,
        /// Idle, rendering, coding, waiting.
        times_us: [u32; 4],
        rays: [u64; 4],
    }
    enum TileCoding { Raw, Packed }
    struct LocalTicket {
        host: String,
        port: u16,
        fingerprint: [u8; 32],
        token: [u8; 16],
        name: String,
        threads: u32,
        sharers: u32,
    }
}

#[test]
fn wincode_reads_and_writes_every_golden_line() {
    let mut lines = 0;
    for line in include_str!("golden_v5.txt").lines() {
        let (name, hex) = line.rsplit_once(": ").expect("a name and its bytes");
        let frame: Vec<u8> = (0..hex.len() / 2)
            .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).expect("hexadecimal digits"))
            .collect();
        let body = &frame[4..];
        match name.split(", ").next() {
            Some("to master") => drop(same::<ToMaster, _>(name, body, config!())),
            Some("to worker") => drop(same::<ToWorker, _>(name, body, config!())),
            Some("from client") => drop(same::<FromClient, _>(name, body, config!())),
            Some("to client") => drop(same::<ToClient, _>(name, body, config!())),
            Some("bulk") if name.ends_with("summary") => drop(same::<FrameSummary, _>(name, body, config!())),
            Some("bulk") if name.ends_with("chunk") => drop(same::<PackChunk, _>(name, body, config!())),
            Some("bulk") => drop(same::<BatchHeader, _>(name, body, config!())),
            Some("stdin") => drop(same::<LocalTicket, _>(name, body, config!())),
            _ => panic!("{name}: a kind of message that is not here; add it"),
        }
        lines += 1;
    }
    assert!(lines > 30, "{lines}");
}

#[test]
fn what_wincode_reads_is_what_was_meant() {
    let golden = |name: &str| {
        let line = include_str!("golden_v5.txt")
            .lines()
            .find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
        let hex = line.expect("a golden line").to_owned();
        (4..hex.len() / 2)
            .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).expect("hexadecimal digits"))
            .collect::<Vec<_>>()
    };
    let role = Role::Worker {
        memory: 1 << 33,
        threads: 8,
        backend: "cpu".into(),
        numeric_class: "cpu-1".into(),
        speed: 5_000_000,
        note: "n".into(),
    };
    assert_eq!(
        same::<ToMaster, _>("hello", &golden("to master, hello"), config!()),
        ToMaster::Hello { versions: vec![5], token: [0x5C; 16], name: "w0".into(), role }
    );
    assert_eq!(
        same::<ToWorker, _>("assign", &golden("to worker, assign"), config!()),
        ToWorker::Assign { frame: 7, attempt: 1, tiles: vec![0, 250, 251, 65_535] }
    );
    assert_eq!(
        same::<PackChunk, _>("chunk", &golden("bulk, pack chunk"), config!()),
        PackChunk { pack: [0xAB; 32], offset: 1 << 20, length: 1 << 20 }
    );
}

/// Reads `body` to its last byte and writes it again.
fn same<T, C: Config + Copy>(name: &str, body: &[u8], config: C) -> T
where
    T: SchemaWrite<C, Src = T> + for<'de> SchemaRead<'de, C, Dst = T> + Debug,
{
    let message: T =
        wincode::config::deserialize_exact(body, config).unwrap_or_else(|e| panic!("{name}: {e}"));
    let written = wincode::config::serialize(&message, config).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!(written, body, "{name}: {message:?}");
    message
}
