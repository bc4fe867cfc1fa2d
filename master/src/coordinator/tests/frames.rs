//! Several frames at a time, message by message.

use super::*;

/// Two workers of one class that hold the pack, with what each was told since.
fn two() -> (Coordinator, Duration) {
    let fleet = Fleet::new(Duration::ZERO, &[("cpu", 1), ("cpu", 1)]);
    (fleet.master, fleet.now)
}

fn told(master: &mut Coordinator, worker: u32) -> Vec<ToWorker> {
    let of = |output| match output {
        Output::Send(to, message) if to == WorkerId(worker) => Some(message),
        _ => None,
    };
    std::iter::from_fn(|| master.poll()).filter_map(of).collect()
}

/// A tile of 8 x 8.
fn tile(master: &mut Coordinator, worker: u32, frame: FrameId, tile: u32, attempt: u32, now: Duration) {
    let entry = TileEntry { tile: TileId(tile), attempt: Attempt(attempt), ..TileEntry::raw(256) };
    master.tile(WorkerId(worker), frame, &entry, &[0; 256], 256, now);
}

#[test]
fn who_has_a_tile_as_well_is_told_that_it_is_there() {
    let (mut master, now) = two();
    // One tile: the second worker gets it once the first is late.
    let job = FrameJob { width: 8, height: 8, ..job(false, Balance::Dynamic) };
    let frame = master.begin(&job, now).expect("a job in range");
    told(&mut master, 0);
    let late = master.deadline().expect("somebody waits");
    master.tick(late);
    assert!(matches!(&told(&mut master, 1)[..], [ToWorker::Assign { attempt: Attempt(1), .. }]));
    tile(&mut master, 1, frame, 0, 1, late);
    let cancel = ToWorker::Cancel { frame, tiles: vec![TileId(0)] };
    assert_eq!(told(&mut master, 0), [cancel]);
    // It answers, whatever it has done with it; once.
    let mut rendered = ToMaster::Rendered { frame, tiles: 1 };
    for cancelled in [0, 1] {
        let (mut master, now) = two();
        let frame = master.begin(&job, now).expect("a job in range");
        let late = master.deadline().expect("somebody waits");
        master.tick(late);
        tile(&mut master, 1, frame, 0, 1, late);
        if cancelled == 0 {
            master.message(WorkerId(0), rendered.clone(), late);
        }
        master.message(WorkerId(0), ToMaster::Cancelled { frame, tiles: cancelled }, late);
        assert_eq!((master.joined().count(), master.status(frame)), (2, FrameStatus::Done));
        // It has nothing more to say.
        rendered = ToMaster::Rendered { frame, tiles: 1 };
        master.message(WorkerId(0), rendered.clone(), late);
        assert_eq!(master.joined().count(), 1);
    }
}

#[test]
fn more_than_was_cancelled_is_a_violation() {
    for tiles in [0, 1, 2] {
        let (mut master, now) = two();
        let frame = master.begin(&job(false, Balance::Dynamic), now).expect("a job in range");
        master.message(WorkerId(0), ToMaster::Cancelled { frame, tiles }, now);
        assert_eq!(master.joined().count(), 1, "nothing was");
    }
    let (mut master, now) = two();
    master.message(WorkerId(0), ToMaster::Cancelled { frame: FrameId(1), tiles: 0 }, now);
    assert_eq!(master.joined().count(), 1, "there never was a frame");
}

#[test]
fn each_message_finds_its_frame() {
    let (mut master, now) = two();
    let job = FrameJob { width: 16, height: 8, ..job(false, Balance::PaperStatic) };
    let frames = [0, 1, 2].map(|_| master.begin(&job, now).expect("a job in range"));
    assert_eq!(master.begun().collect::<Vec<_>>(), frames);
    for (worker, frame) in [(1, 2), (0, 2), (0, 0), (1, 1), (1, 0), (0, 1)] {
        master.message(WorkerId(worker), ToMaster::Rendered { frame: frames[frame], tiles: 1 }, now);
        tile(&mut master, worker, frames[frame], worker, 0, now);
        let done: Vec<_> = frames.iter().map(|&f| master.status(f) == FrameStatus::Done).collect();
        let expected = match (worker, frame) {
            (1, 2) => [false; 3],
            (0, 2) | (0, 0) | (1, 1) => [false, false, true],
            (1, 0) => [true, false, true],
            _ => [true; 3],
        };
        assert_eq!(done, expected);
    }
    told(&mut master, 0);
    let outcome = master.finish(frames[1], now).expect("done");
    assert_eq!(outcome.workers.iter().map(|w| w.tiles).collect::<Vec<_>>(), [1, 1]);
    assert_eq!(told(&mut master, 0), [ToWorker::EndFrame { frame: frames[1] }]);
    assert_eq!(master.begun().collect::<Vec<_>>(), [frames[0], frames[2]]);
}
