//! Bytes that no honest peer sends: refused, without a panic and without memory beyond the limits.

mod samples;

use proptest::prelude::*;
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};
use tessera_wire::codec::{self, CodecError, Message};
use tessera_wire::*;

/// The system's allocator, counting each thread's largest request.
struct Counting;

thread_local! {
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

#[expect(unsafe_code, reason = "GlobalAlloc is an unsafe trait; the calls are handed on unchanged")]
// SAFETY: every call goes to the system's allocator as it came; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = LARGEST.try_with(|largest| largest.set(largest.get().max(layout.size())));
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Decodes `body`, and checks that no single reservation went beyond the message's limit.
fn decode_checked<M: Message>(body: &[u8]) -> Result<M, CodecError> {
    LARGEST.set(0);
    let result = codec::decode(body);
    assert!(LARGEST.get() <= M::LIMIT.max(1 << 10), "{} bytes for {} of input", LARGEST.get(), body.len());
    result
}

fn decode_as_everything(body: &[u8]) {
    LARGEST.set(0);
    let _ = codec::decode_hello(body);
    assert!(LARGEST.get() <= limits::HELLO_BYTES, "{} bytes for a `Hello`", LARGEST.get());
    let _ = decode_checked::<ToMaster>(body);
    let _ = decode_checked::<ToWorker>(body);
    let _ = decode_checked::<FromClient>(body);
    let _ = decode_checked::<ToClient>(body);
    let _ = decode_checked::<FrameSummary>(body);
    let _ = decode_checked::<PackChunk>(body);
    let _ = decode_checked::<LocalTicket>(body);
    if let Ok(batch) = decode_checked::<BatchHeader>(body) {
        // What decodes may still be out of range; the check must say so without a panic.
        let _ = batch.check();
    }
}

/// A frame whose numbers are any at all is judged without a panic, and what passes is within its ranges.
#[test]
fn samplings_out_of_range_are_refused() {
    let numbers =
        [f32::NAN, f32::INFINITY, -f32::INFINITY, -1.0, -0.0, f32::MIN_POSITIVE, 0.5, 1.0, 1.0f32.next_up()];
    for (cutoff, error) in numbers.into_iter().flat_map(|a| numbers.map(|b| (a, b))) {
        for (tile, adaptive) in
            [(0, None), (48, Some(Adaptive { error })), (50, Some(Adaptive { error })), (50, None)]
        {
            let sampling = Sampling { cutoff, adaptive, ..Sampling::default() };
            let frame = Frame { tile, sampling, ..samples::frame() };
            let bytes = codec::encode(&ToWorker::Frame(frame)).unwrap();
            let Ok(ToWorker::Frame(read)) = decode_checked(&bytes[codec::PREFIX_BYTES..]) else {
                panic!("it decodes whatever its numbers are");
            };
            // The frame is deeper than what bounds the work without a cut-off.
            let in_range = (Sampling::BOUNDING_CUTOFF..=1.0).contains(&cutoff)
                && adaptive.is_none_or(|a| a.error > 0.0 && a.error <= 1.0 && tile % 16 == 0)
                && tile > 0;
            assert_eq!(read.check().is_ok(), in_range, "{cutoff}, {adaptive:?}, tiles of {tile}");
        }
    }
    // No sampler has the number 2: of the frame's bytes one says which.
    let bytes = |sampler| {
        let sampling = Sampling { sampler, ..Sampling::default() };
        codec::encode(&ToWorker::Frame(Frame { sampling, ..samples::frame() })).unwrap()
    };
    let [jittered, low] = Sampler::ALL.map(bytes);
    let at = jittered.iter().zip(&low).position(|(a, b)| a != b).expect("they differ");
    let unknown = [&low[codec::PREFIX_BYTES..at], &[2], &low[at + 1..]].concat();
    assert!(decode_checked::<ToWorker>(&unknown).is_err());
}

fn all_bodies() -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    frames.extend(samples::to_master().iter().map(|(_, m)| codec::encode(m).unwrap()));
    frames.extend(samples::to_worker().iter().map(|(_, m)| codec::encode(m).unwrap()));
    frames.extend(samples::from_client().iter().map(|(_, m)| codec::encode(m).unwrap()));
    frames.extend(samples::to_client().iter().map(|(_, m)| codec::encode(m).unwrap()));
    frames.push(codec::encode(&samples::summary()).unwrap());
    frames.push(codec::encode(&samples::chunk()).unwrap());
    frames.push(codec::encode(&samples::batch()).unwrap());
    frames.push(codec::encode(&samples::ticket()).unwrap());
    frames.into_iter().map(|frame| frame[codec::PREFIX_BYTES..].to_vec()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_harmless(body in prop::collection::vec(any::<u8>(), 0..300)) {
        decode_as_everything(&body);
    }

    #[test]
    fn damaged_messages_are_harmless(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let bodies = all_bodies();
        let mut body = which.get(&bodies).clone();
        for (at, byte) in changes {
            let at = at.index(body.len());
            body[at] = byte;
        }
        decode_as_everything(&body);
    }

    #[test]
    fn assignments_and_batches_survive_the_journey(
        frame: u64,
        tiles in prop::collection::vec((any::<u32>(), any::<u32>(), any::<u32>(), any::<u64>()), 0..200),
    ) {
        let entry = |&(tile, attempt, length, primary): &(u32, u32, u32, u64)| TileEntry {
            tile: TileId(tile),
            attempt: Attempt(attempt),
            length,
            coding: TileCoding::Packed,
            pixel_bytes: attempt,
            idle_us: tile,
            render_us: length,
            coding_us: attempt,
            waited_us: tile,
            rays: Rays { primary, ..Rays::default() },
        };
        let batch = BatchHeader { frame: FrameId(frame), tiles: tiles.iter().map(entry).collect() };
        let sent = codec::encode(&batch).unwrap();
        prop_assert_eq!(decode_checked::<BatchHeader>(&sent[codec::PREFIX_BYTES..]), Ok(batch));
        let list = tiles.iter().map(|t| TileId(t.0)).collect();
        let assign = ToWorker::Assign { frame: FrameId(frame), attempt: Attempt(0), tiles: list };
        let sent = codec::encode(&assign).unwrap();
        prop_assert_eq!(decode_checked::<ToWorker>(&sent[codec::PREFIX_BYTES..]), Ok(assign));
    }
}

#[test]
fn truncated_and_extended_messages_are_refused() {
    for body in all_bodies() {
        for end in 0..body.len() {
            decode_as_everything(&body[..end]);
        }
    }
    let mut body = codec::encode(&ToMaster::Leave).unwrap()[codec::PREFIX_BYTES..].to_vec();
    assert!(decode_checked::<ToMaster>(&[]).is_err());
    body.push(0);
    assert_eq!(decode_checked::<ToMaster>(&body), Err(CodecError::Trailing(1)));
}

#[test]
fn a_length_is_refused_before_anything_is_reserved() {
    let limit = limits::CONTROL_BYTES;
    let prefix = |length: usize| (length as u32).to_le_bytes();
    assert_eq!(codec::body_length(prefix(limit), limit), Ok(limit));
    assert_eq!(
        codec::body_length(prefix(limit + 1), limit),
        Err(CodecError::TooLong { length: limit + 1, limit })
    );
    let most = u32::MAX as usize;
    assert_eq!(codec::body_length([255; 4], limit), Err(CodecError::TooLong { length: most, limit }));
    let long = vec![0; limit + 1];
    assert!(matches!(decode_checked::<ToWorker>(&long), Err(CodecError::TooLong { .. })));
}

/// A list that claims 2^60 elements in a message of a dozen bytes.
#[test]
fn a_claimed_list_length_is_counted_against_the_limit() {
    // `Assign` is variant 4; frame 1, attempt 0; 253 announces a number of 8 bytes.
    let mut assign = vec![4, 1, 0, 253];
    assign.extend((1u64 << 60).to_le_bytes());
    assert!(matches!(decode_checked::<ToWorker>(&assign), Err(CodecError::Malformed(_))));
    let mut batch = vec![1, 253];
    batch.extend((1u64 << 60).to_le_bytes());
    assert!(matches!(decode_checked::<BatchHeader>(&batch), Err(CodecError::Malformed(_))));
    // A claim just below the limit reserves that much and then runs out of bytes.
    let mut assign = vec![4, 1, 0, 252];
    assign.extend((limits::CONTROL_BYTES as u32 / 4 - 64).to_le_bytes());
    assert!(matches!(decode_checked::<ToWorker>(&assign), Err(CodecError::Malformed(_))));
}

#[test]
fn the_largest_honest_messages_fit() {
    let tiles: Vec<_> = (0..limits::TILES).map(TileId).collect();
    let assign = ToWorker::Assign { frame: FrameId(u64::MAX), attempt: Attempt(u32::MAX), tiles };
    let frame = codec::encode(&assign).unwrap();
    assert_eq!(decode_checked::<ToWorker>(&frame[codec::PREFIX_BYTES..]), Ok(assign));

    let rays = Rays { primary: u64::MAX, shadow: u64::MAX, reflection: u64::MAX, refraction: u64::MAX };
    let entry = |tile| TileEntry {
        tile: TileId(tile),
        attempt: Attempt(u32::MAX),
        length: u32::MAX,
        coding: TileCoding::Packed,
        pixel_bytes: u32::MAX,
        idle_us: u32::MAX,
        render_us: u32::MAX,
        coding_us: u32::MAX,
        waited_us: u32::MAX,
        rays,
    };
    let tiles = (0..limits::TILES).map(entry).collect();
    let batch = BatchHeader { frame: FrameId(u64::MAX), tiles };
    let frame = codec::encode(&batch).unwrap();
    assert_eq!(decode_checked::<BatchHeader>(&frame[codec::PREFIX_BYTES..]), Ok(batch));

    let text = |letter: &str| letter.repeat(limits::TEXT_BYTES);
    let worker = WorkerSummary {
        name: text("n"),
        backend: text("b"),
        numeric_class: text("c"),
        note: text("d"),
        tiles: u32::MAX,
        render_us: u64::MAX,
        bytes_returned: u64::MAX,
        lost: Some(text("l")),
        rejected: Some(text("r")),
    };
    let summary = FrameSummary {
        length: u64::MAX,
        classes: vec![ClassSummary { class: text("c"), workers: u32::MAX, tiles: u32::MAX }; limits::CLASSES],
        differences: vec![
            DifferenceSummary {
                classes: [text("c"), text("d")],
                tiles: u32::MAX,
                pixels: u64::MAX,
                differing: u64::MAX,
                max_abs: f64::MAX,
                psnr_db: Some(f64::MAX),
            };
            limits::CLASSES * (limits::CLASSES - 1) / 2
        ],
        idle: u32::MAX,
        workers: vec![worker; limits::WORKERS],
        times_us: [u64::MAX; 4],
        traffic: [u64::MAX; 4],
        rays,
        ..samples::summary()
    };
    let frame = codec::encode(&summary).unwrap();
    assert_eq!(decode_checked::<FrameSummary>(&frame[codec::PREFIX_BYTES..]), Ok(summary));
    let hello = Hello {
        versions: vec![u16::MAX - 1, 5].into_iter().cycle().take(limits::VERSIONS).collect(),
        token: Token([0xFF; 16]),
        name: text("n"),
        role: Role::Worker(Abilities {
            memory: u64::MAX,
            threads: u32::MAX,
            backend: text("b"),
            numeric_class: text("c"),
            speed: u64::MAX,
            note: text("d"),
        }),
    };
    let frame = codec::encode(&ToMaster::Hello(hello.clone())).unwrap();
    assert_eq!(codec::decode_hello(&frame[codec::PREFIX_BYTES..]), Ok(hello));
    let chunk = PackChunk { pack: samples::PACK, offset: u64::MAX, length: u32::MAX };
    assert!(codec::encode(&chunk).is_ok());
}
