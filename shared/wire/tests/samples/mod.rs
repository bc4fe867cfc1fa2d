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
        depth: 8,
        seed: 300,
        features: Features { shadows: true, reflection: false, refraction: true },
        format: PixelFormat::Rgba8,
        returns: ReturnMode::Batches { min_bytes: 262_144 },
    }
}

pub fn to_master() -> Vec<(&'static str, ToMaster)> {
    let detail = || "d".to_string();
    let rejected = |reason| ToMaster::PackRejected { pack: PACK, reason };
    let hello = |role| {
        ToMaster::Hello(Hello { versions: vec![2], token: Token([0x5C; 16]), name: "w0".into(), role })
    };
    let abilities =
        Abilities { memory: 1 << 33, threads: 8, backend: "cpu".into(), numeric_class: "cpu-1".into() };
    vec![
        ("hello", hello(Role::Worker(abilities))),
        ("hello: client", hello(Role::Client)),
        ("pack need", ToMaster::PackNeed { pack: PACK, have: false }),
        ("pack ready", ToMaster::PackReady { pack: PACK }),
        ("rejected: memory", rejected(PackRefusal::OutOfMemory { needs: 1000, has: 100 })),
        ("rejected: hash", rejected(PackRefusal::HashMismatch { got: PackId([0xCD; 32]) })),
        ("rejected: transfer", rejected(PackRefusal::Transfer { detail: detail() })),
        ("rejected: invalid", rejected(PackRefusal::Invalid { detail: detail() })),
        ("rendered", ToMaster::Rendered { frame: FrameId(7), tiles: 1 }),
        ("leave", ToMaster::Leave),
        ("abort", ToMaster::Abort { code: AbortCode::Internal, detail: detail() }),
    ]
}

pub fn to_worker() -> Vec<(&'static str, ToWorker)> {
    let abort = |code| ToWorker::Abort { code, detail: String::new() };
    let tiles = vec![TileId(0), TileId(250), TileId(251), TileId(65_535)];
    vec![
        ("welcome", ToWorker::Welcome { version: 2, worker: WorkerId(3) }),
        ("refuse: version", ToWorker::Refuse(Refusal::Version { supported: vec![2] })),
        ("refuse: class", ToWorker::Refuse(Refusal::NumericClass { expected: "cpu-1".into() })),
        ("refuse: malformed", ToWorker::Refuse(Refusal::Malformed { detail: "d".into() })),
        ("refuse: token", ToWorker::Refuse(Refusal::Token)),
        ("refuse: expired", ToWorker::Refuse(Refusal::Expired)),
        ("refuse: role", ToWorker::Refuse(Refusal::Role)),
        ("refuse: full", ToWorker::Refuse(Refusal::Full { limit: 256 })),
        ("pack offer", ToWorker::PackOffer { pack: PACK, length: 5_000_000_000 }),
        ("frame", ToWorker::Frame(frame())),
        ("frame: at end", ToWorker::Frame(Frame { returns: ReturnMode::AtEnd, ..frame() })),
        ("assign", ToWorker::Assign { frame: FrameId(7), attempt: Attempt(1), tiles }),
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

pub fn chunk() -> PackChunk {
    PackChunk { pack: PACK, offset: 1 << 20, length: 1 << 20 }
}

pub fn batch() -> BatchHeader {
    let rays = Rays { primary: 16_384, shadow: 16_000, reflection: 100, refraction: 0 };
    let entry = |tile, attempt| TileEntry {
        tile: TileId(tile),
        attempt: Attempt(attempt),
        length: 65_536,
        render_us: 12_345,
        rays,
    };
    BatchHeader { frame: FrameId(7), tiles: vec![entry(0, 0), entry(63, 1)] }
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
