//! One of each message, every variant and every nested enum's variant among them.

use tessera_wire::*;

pub const PACK: PackId = PackId([0xAB; 32]);

pub fn frame() -> Frame {
    Frame {
        frame: FrameId(7),
        pack: PACK,
        camera: Camera {
            origin: [1.0, -2.0, 0.5],
            forward: [0.0, 0.0, -1.0],
            right: [0.75, 0.0, 0.0],
            up: [0.0, 0.5, 0.0],
        },
        width: 1024,
        height: 768,
        tile: 128,
        samples: 4,
        sampling: Sampling::default(),
        depth: 8,
        seed: 300,
        features: Features { shadows: true, reflection: false, refraction: true },
        format: PixelFormat::Rgba8,
        returns: ReturnMode::Batches { min_bytes: 262_144 },
        coding: Coding::Lossless,
    }
}

pub fn to_master() -> Vec<(&'static str, ToMaster)> {
    let detail = || "d".to_string();
    let rejected = |reason| ToMaster::PackRejected { pack: PACK, reason };
    let hello = |role| {
        ToMaster::Hello(Hello { versions: vec![5], token: Token([0x5C; 16]), name: "w0".into(), role })
    };
    let abilities = Abilities {
        memory: 1 << 33,
        threads: 8,
        backend: "cpu".into(),
        numeric_class: "cpu-1".into(),
        speed: 5_000_000,
        note: "n".into(),
    };
    vec![
        ("hello", hello(Role::Worker(abilities))),
        ("hello: client", hello(Role::Client)),
        ("pack need", ToMaster::PackNeed { pack: PACK, have: false }),
        ("pack ready", ToMaster::PackReady { pack: PACK }),
        ("rejected: memory", rejected(PackRefusal::OutOfMemory { needs: 1000, has: 100 })),
        ("rejected: hash", rejected(PackRefusal::HashMismatch { got: PackId([0xCD; 32]) })),
        ("rejected: transfer", rejected(PackRefusal::Transfer { detail: detail() })),
        ("rejected: invalid", rejected(PackRefusal::Invalid { detail: detail() })),
        ("rejected: device", rejected(PackRefusal::CannotHold { needs: 1000, has: 100, what: "w".into() })),
        ("rendered", ToMaster::Rendered { frame: FrameId(7), tiles: 1 }),
        ("cancelled", ToMaster::Cancelled { frame: FrameId(7), tiles: 1 }),
        ("leave", ToMaster::Leave),
        ("abort", ToMaster::Abort { code: AbortCode::Internal, detail: detail() }),
    ]
}

pub fn to_worker() -> Vec<(&'static str, ToWorker)> {
    let abort = |code| ToWorker::Abort { code, detail: String::new() };
    let adaptive =
        Sampling { sampler: Sampler::LowDiscrepancy, cutoff: 0.25, adaptive: Some(Adaptive { error: 0.5 }) };
    let tiles = vec![TileId(0), TileId(250), TileId(251), TileId(65_535)];
    vec![
        ("welcome", ToWorker::Welcome { version: 5, worker: WorkerId(3) }),
        ("refuse: version", ToWorker::Refuse(Refusal::Version { supported: vec![5] })),
        ("refuse: class", ToWorker::Refuse(Refusal::NumericClass { expected: "cpu-1".into() })),
        ("refuse: malformed", ToWorker::Refuse(Refusal::Malformed { detail: "d".into() })),
        ("refuse: token", ToWorker::Refuse(Refusal::Token)),
        ("refuse: expired", ToWorker::Refuse(Refusal::Expired)),
        ("refuse: role", ToWorker::Refuse(Refusal::Role)),
        ("refuse: full", ToWorker::Refuse(Refusal::Full { limit: 256 })),
        ("pack offer", ToWorker::PackOffer { pack: PACK, length: 5_000_000_000 }),
        ("frame", ToWorker::Frame(frame())),
        ("frame: at end", ToWorker::Frame(Frame { returns: ReturnMode::AtEnd, ..frame() })),
        ("frame: every", ToWorker::Frame(Frame { returns: ReturnMode::Every { tiles: 5 }, ..frame() })),
        ("frame: raw", ToWorker::Frame(Frame { coding: Coding::Raw, ..frame() })),
        ("frame: rounded", ToWorker::Frame(Frame { coding: Coding::Rounded, ..frame() })),
        ("frame: adaptive", ToWorker::Frame(Frame { sampling: adaptive, ..frame() })),
        ("assign", ToWorker::Assign { frame: FrameId(7), attempt: Attempt(1), tiles }),
        ("cancel", ToWorker::Cancel { frame: FrameId(7), tiles: vec![TileId(0), TileId(65_535)] }),
        ("end frame", ToWorker::EndFrame { frame: FrameId(7) }),
        ("dismiss", ToWorker::Dismiss),
        ("abort: done", abort(AbortCode::Done)),
        ("abort: unexpected", abort(AbortCode::Unexpected)),
        ("abort: malformed", abort(AbortCode::Malformed)),
        ("abort: bad frame", abort(AbortCode::BadFrame)),
        ("abort: bad tiles", abort(AbortCode::BadTiles)),
        ("abort: timeout", abort(AbortCode::Timeout)),
        ("abort: refused", abort(AbortCode::Refused)),
        ("abort: internal", abort(AbortCode::Internal)),
        ("abort: busy", abort(AbortCode::Busy)),
        ("abort: replaced", abort(AbortCode::Replaced)),
    ]
}

pub fn from_client() -> Vec<(&'static str, FromClient)> {
    let hello = Hello { versions: vec![5], token: Token([0x5C; 16]), name: "c0".into(), role: Role::Client };
    let render = |balance| FromClient::Render { frame: frame(), balance, mix: false };
    vec![
        ("hello", FromClient::Hello(hello)),
        ("pack offer", FromClient::PackOffer { pack: PACK, length: 5_000_000_000 }),
        ("render: paper static", render(Balance::PaperStatic)),
        ("render: static", render(Balance::Static)),
        ("render: paper dynamic", render(Balance::PaperDynamic)),
        ("render: dynamic", render(Balance::Dynamic)),
        ("render: hilbert", render(Balance::Hilbert)),
        ("render: weighted", render(Balance::Weighted)),
        ("render: staggered", render(Balance::Staggered)),
        ("render: steal", render(Balance::Steal)),
        ("render: auto", render(Balance::Auto)),
        ("render: mixed", FromClient::Render { frame: frame(), balance: Balance::Dynamic, mix: true }),
        ("abort", FromClient::Abort { code: AbortCode::Done, detail: "d".into() }),
    ]
}

pub fn to_client() -> Vec<(&'static str, ToClient)> {
    let (name, reason) = (|| "w0".to_string(), || "r".to_string());
    let failed = |reason| ToClient::Failed { frame: FrameId(7), reason };
    let rejected = PackRefusal::OutOfMemory { needs: 1000, has: 100 };
    vec![
        ("welcome", ToClient::Welcome { version: 3 }),
        ("refuse", ToClient::Refuse(Refusal::Token)),
        ("pack need", ToClient::PackNeed { pack: PACK, have: true }),
        ("pack ready", ToClient::PackReady { pack: PACK }),
        ("pack rejected", ToClient::PackRejected { pack: PACK, reason: rejected }),
        ("waiting", ToClient::Waiting { ahead: 3 }),
        ("no workers", ToClient::NoWorkers),
        ("sent", ToClient::Sent { bytes: 1 << 20, total: 1 << 33 }),
        ("tiles", ToClient::Tiles { done: 3, total: 300 }),
        ("worker lost", ToClient::WorkerLost { name: name(), reason: reason() }),
        ("worker rejects", ToClient::WorkerRejects { name: name(), reason: reason() }),
        ("finished", ToClient::Finished { frame: FrameId(7) }),
        ("failed: busy", failed(FrameFailure::Busy { waiting: 32 })),
        ("failed: invalid", failed(FrameFailure::Invalid { detail: reason() })),
        ("failed: crew", failed(FrameFailure::Crew { detail: reason() })),
        ("failed: stopping", failed(FrameFailure::Stopping)),
        ("abort", ToClient::Abort { code: AbortCode::Timeout, detail: reason() }),
        ("restarted", ToClient::Restarted { from: "gpu-1".into(), to: "cpu-1".into(), dropped: 3 }),
    ]
}

pub fn summary() -> FrameSummary {
    let worker = |lost, rejected| WorkerSummary {
        name: "w0".into(),
        backend: "cpu".into(),
        numeric_class: "cpu-1".into(),
        note: "n".into(),
        tiles: 48,
        render_us: 1 << 20,
        bytes_returned: 1 << 33,
        lost,
        rejected,
    };
    FrameSummary {
        frame: FrameId(7),
        length: 1024 * 768 * 4,
        classes: vec![
            ClassSummary { class: "cpu-1".into(), workers: 2, tiles: 40 },
            ClassSummary { class: "gpu-1".into(), workers: 1, tiles: 300 },
        ],
        differences: vec![
            DifferenceSummary { psnr_db: None, ..difference() },
            DifferenceSummary { max_abs: 3.0, psnr_db: Some(60.5), differing: 9, ..difference() },
        ],
        idle: 4,
        workers: vec![worker(None, None), worker(Some("l".into()), Some("r".into()))],
        times_us: [1, 2, 300, 302],
        traffic: [4, 5, 6, 70_000],
        rays: Rays { primary: 16_384, shadow: 16_000, reflection: 100, refraction: 0 },
        dropped_tiles: 9,
    }
}

pub fn difference() -> DifferenceSummary {
    DifferenceSummary {
        classes: ["cpu-1".into(), "gpu-1".into()],
        tiles: 4,
        pixels: 65_536,
        differing: 0,
        max_abs: 0.0,
        psnr_db: None,
    }
}

pub fn chunk() -> PackChunk {
    PackChunk { pack: PACK, offset: 1 << 20, length: 1 << 20 }
}

pub fn batch() -> BatchHeader {
    let rays = Rays { primary: 16_384, shadow: 16_000, reflection: 100, refraction: 0 };
    let entry = |tile, attempt| TileEntry {
        tile: TileId(tile),
        attempt: Attempt(attempt),
        length: 65_536,
        coding: TileCoding::Raw,
        pixel_bytes: 65_536,
        idle_us: 17,
        render_us: 12_345,
        coding_us: 230,
        waited_us: 300,
        rays,
    };
    let packed = TileEntry { coding: TileCoding::Packed, length: 5_000, ..entry(63, 1) };
    BatchHeader { frame: FrameId(7), tiles: vec![entry(0, 0), packed] }
}

pub fn ticket() -> LocalTicket {
    let join = JoinString {
        host: "127.0.0.1".into(),
        port: 4433,
        fingerprint: Fingerprint([0xEF; 32]),
        token: Token([0x5C; 16]),
    };
    LocalTicket { join, name: "local-0".into(), threads: 2, sharers: 3 }
}
