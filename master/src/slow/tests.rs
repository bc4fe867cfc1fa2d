use super::*;
use crate::trace::{TraceFile, TraceTile, TraceWorker};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};

/// A cluster in small: a master that does one thing at a time, links with a latency and a rate, workers of different speeds. In microseconds
/// and bytes.
struct Model {
    speeds: Vec<f64>,
    /// Of each tile, at speed 1.
    costs: Vec<u64>,
    latency: u64,
    tile_bytes: u64,
    bytes_per_us: f64,
    /// Tiles that a worker has before it asks for more.
    ahead: usize,
    master_us: u64,
    /// Whether the trace says that.
    is_master_known: bool,
}

impl Default for Model {
    fn default() -> Self {
        Self {
            speeds: vec![1.0; 4],
            costs: vec![10_000; 64],
            latency: 50,
            tile_bytes: 20_000,
            bytes_per_us: 100.0,
            ahead: 2,
            master_us: 5,
            is_master_known: true,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Happens {
    /// A tile is with a worker.
    Arrived(usize, usize),
    /// A worker has rendered one.
    Rendered(usize, usize),
    /// A worker may go on.
    Sent(usize),
    /// Its word is at the master, or the pixels of a tile.
    Word(usize),
    Pixels(usize, usize),
}

#[derive(Clone, Default)]
struct Worker {
    queue: VecDeque<usize>,
    is_busy: bool,
    last_end: u64,
    sent: Vec<u64>,
    link_free: u64,
}

impl Model {
    fn run(&self) -> RunTrace {
        let mut next = 0;
        let mut order = 0;
        let mut events = BinaryHeap::new();
        let mut push = |events: &mut BinaryHeap<_>, time: u64, what: Happens| {
            order += 1;
            events.push(Reverse((time, order, what)));
        };
        let mut tiles = vec![TraceTile::default(); self.costs.len()];
        let mut workers = vec![Worker::default(); self.speeds.len()];
        let (mut master_free, mut messages, mut done) = (0, 0, Vec::new());
        for worker in (0..self.ahead).flat_map(|_| 0..self.speeds.len()).take(self.costs.len()) {
            tiles[next].assigned_us = master_free;
            master_free += self.master_us;
            push(&mut events, master_free + self.latency, Happens::Arrived(worker, next));
            next += 1;
        }
        while let Some(Reverse((now, _, what))) = events.pop() {
            let worker = match what {
                Happens::Arrived(worker, tile) => {
                    workers[worker].queue.push_back(tile);
                    worker
                }
                Happens::Rendered(worker, tile) => {
                    let state = &mut workers[worker];
                    (state.is_busy, state.last_end) = (false, now);
                    let sent = state.link_free.max(now);
                    state.link_free = sent + (self.tile_bytes as f64 / self.bytes_per_us) as u64;
                    state.sent.push(sent);
                    tiles[tile].waited_us = sent - now;
                    push(&mut events, sent, Happens::Sent(worker));
                    push(&mut events, now + self.latency, Happens::Word(worker));
                    push(&mut events, state.link_free + self.latency, Happens::Pixels(worker, tile));
                    worker
                }
                Happens::Sent(worker) => worker,
                Happens::Word(worker) => {
                    messages += 1;
                    master_free = master_free.max(now) + self.master_us;
                    if next < self.costs.len() {
                        messages += 1;
                        tiles[next].assigned_us = master_free;
                        push(&mut events, master_free + self.latency, Happens::Arrived(worker, next));
                        next += 1;
                    }
                    worker
                }
                Happens::Pixels(worker, tile) => {
                    messages += 1;
                    master_free = master_free.max(now) + self.master_us;
                    tiles[tile].received_us = master_free;
                    done.push(tile);
                    worker
                }
            };
            let state = &mut workers[worker];
            let unsent = state.sent.iter().filter(|sent| **sent > now).count();
            if let Some(tile) = (!state.is_busy && unsent < 2).then(|| state.queue.pop_front()).flatten() {
                state.is_busy = true;
                let time = (self.costs[tile] as f64 / self.speeds[worker]) as u64;
                tiles[tile] = TraceTile {
                    tile: tile as u32,
                    worker,
                    idle_us: now - state.last_end,
                    render_us: time,
                    wire_bytes: self.tile_bytes,
                    pixel_bytes: self.tile_bytes as u32,
                    ..tiles[tile]
                };
                push(&mut events, now + time, Happens::Rendered(worker, tile));
            }
        }
        let tiles: Vec<_> = done.into_iter().map(|tile| tiles[tile]).collect();
        let frame = FrameTrace {
            frame_us: master_free,
            render_us: master_free,
            master_us_per_message: self.is_master_known.then_some(self.master_us as f64),
            messages: Some(messages),
            tiles,
            ..FrameTrace::default()
        };
        RunTrace {
            version: RunTrace::VERSION,
            balance: "dynamic".into(),
            coding: "raw".into(),
            tile: 128,
            workers: (0..self.speeds.len())
                .map(|k| TraceWorker { name: format!("w{k}"), ..TraceWorker::default() })
                .collect(),
            frames: vec![frame],
            ..RunTrace::default()
        }
    }
}

/// What is found, whose shares add up to all there is, and whose events are what a viewer takes.
#[track_caller]
fn check(model: Model, expected: Change) -> SlowReport {
    let run = model.run();
    let report = explain(&run).unwrap();
    let shares = report.shares.each();
    assert!((shares.iter().map(|(_, share)| share).sum::<f64>() - 1.0).abs() < 1e-9, "{shares:?}");
    assert!(shares.iter().all(|(_, share)| *share >= 0.0), "{shares:?}");
    assert_eq!(report.advice.change, expected, "{report:#?}");
    assert!(report.others.windows(2).all(|pair| pair[0].gain_share >= pair[1].gain_share));
    check_events(&run);
    report
}

/// In order, of positive lengths, and no two at a time on a track.
fn check_events(run: &RunTrace) {
    let file = TraceFile::new(run);
    let mut ends = BTreeMap::new();
    let mut last = 0;
    for event in &file.trace_events {
        assert!(event.ts >= last, "{event:?} comes after {last}");
        last = event.ts;
        match (event.ph, event.dur) {
            ("X", Some(dur)) => {
                let end = ends.insert((event.pid, event.tid), event.ts + dur).unwrap_or(0);
                assert!(event.ts >= end, "{event:?} overlaps what ends at {end}");
            }
            ("M", None) => assert!(event.args.is_some()),
            _ => panic!("{event:?}"),
        }
    }
}

#[test]
fn a_slow_link() {
    let report = check(Model { bytes_per_us: 1.0, ..Model::default() }, Change::FasterLink);
    assert!(report.shares.link > 0.4, "{:?}", report.shares);
    assert!(report.advice.what.contains("--coding"), "pixels travel raw: {}", report.advice.what);
}

#[test]
fn a_slow_worker() {
    let model = Model { speeds: vec![1.0, 1.0, 0.1, 1.0], costs: vec![10_000; 40], ..Model::default() };
    let report = check(model, Change::SlowWorker);
    assert!(report.advice.what.contains("w2"), "{}", report.advice.what);
    assert!(report.shares.imbalance + report.shares.tail > 0.3, "{:?}", report.shares);
}

#[test]
fn one_costly_tile() {
    let mut costs = vec![2_000; 64];
    costs[60] = 200_000;
    let report = check(Model { costs, ..Model::default() }, Change::SmallerTiles);
    assert!(report.advice.what.contains("--tile 64") && report.shares.tail > 0.5, "{report:?}");
}

#[test]
fn tiles_that_are_too_small() {
    let model = Model { costs: vec![50; 2000], tile_bytes: 200, latency: 500, ahead: 1, ..Model::default() };
    let report = check(model, Change::LargerTiles);
    assert!(report.advice.what.contains("--tile 256") && report.shares.render < 0.2, "{report:?}");
}

#[test]
fn too_few_workers() {
    let report = check(Model { speeds: vec![1.0; 2], ..Model::default() }, Change::MoreWorkers);
    assert!(report.shares.render > 0.9, "{:?}", report.shares);
}

#[test]
fn a_master_that_is_busy_all_the_time() {
    let model = Model {
        speeds: vec![1.0; 8],
        costs: vec![300; 1000],
        tile_bytes: 1000,
        master_us: 100,
        ..Model::default()
    };
    let report = check(model, Change::SecondMaster);
    assert!(report.shares.master > 0.5 && report.shares.link < 0.1, "{:?}", report.shares);
}

#[test]
fn what_cannot_be_explained_is_refused() {
    let says = |run: &RunTrace, text: &str| {
        let error = explain(run).unwrap_err();
        assert!(error.contains(text), "{error}");
    };
    says(&RunTrace::default(), "version 0");
    says(&RunTrace { version: RunTrace::VERSION, ..RunTrace::default() }, "no frame");
    let mut run = Model::default().run();
    run.workers.pop();
    says(&run, "worker 3, which is not there");
    let mut run = Model::default().run();
    run.frames[0].tiles[0].render_us = u64::MAX;
    says(&run, "more than 30 days");
}

proptest::proptest! {
    /// Times that no honest worker tells: shares add up to all there is, and events can be shown.
    #[test]
    fn any_times_are_explained(
        times in proptest::collection::vec([0_u64..5000, 0_u64..5000, 0_u64..3000, 0_u64..3000, 0_u64..3000], 1..30),
        frame_us in 1_u64..6000,
    ) {
        let tile = |(k, [assigned_us, received_us, idle_us, render_us, waited_us]): (usize, [u64; 5])| TraceTile {
            tile: k as u32, worker: k % 3, assigned_us, received_us, idle_us, render_us, waited_us,
            dropped: k % 7 == 6, ..TraceTile::default()
        };
        let tiles = times.into_iter().enumerate().map(tile).collect();
        let frame = FrameTrace { frame_us, tiles, ..FrameTrace::default() };
        let run = RunTrace {
            version: RunTrace::VERSION,
            workers: vec![TraceWorker::default(); 3],
            frames: vec![frame.clone(), frame],
            ..RunTrace::default()
        };
        let shares = explain(&run).unwrap().shares.each();
        proptest::prop_assert!((shares.iter().map(|(_, share)| share).sum::<f64>() - 1.0).abs() < 1e-9, "{:?}", shares);
        proptest::prop_assert!(shares.iter().all(|(_, share)| *share >= -1e-12), "{:?}", shares);
        check_events(&run);
    }
}
