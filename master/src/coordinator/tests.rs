use super::*;
use crate::{Balance, PixelFormat};
use std::collections::BTreeSet;
use tessera_geometry::{LocalCamera, Vec3};
use tessera_wire::{Abilities, Attempt, Features, Frame, Hello, Role, TileGrid, TileId, Token, Version};

const PACK: PackId = PackId([1; 32]);

fn hello(class: &str, speed: u64) -> ToMaster {
    let abilities = Abilities {
        memory: 0,
        threads: 1,
        backend: "cpu".into(),
        numeric_class: class.into(),
        speed,
        note: "a test".into(),
    };
    let (versions, token) = (Version::supported_numbers(), Token::default());
    ToMaster::Hello(Hello { versions, token, name: "w".into(), role: Role::Worker(abilities) })
}

#[test]
fn connections_that_are_over_are_forgotten() {
    let mut coordinator = Coordinator::new(Some("cpu-1".into()));
    coordinator.load(PackId([1; 32]), 10, Duration::ZERO);
    for number in 0..1000 {
        let worker = coordinator.connected(Duration::ZERO);
        // Some never join, and some are refused.
        match number % 3 {
            0 => {}
            1 => coordinator.refuse(worker, Refusal::Full { limit: 1 }, Duration::ZERO),
            _ => coordinator.message(worker, hello("cpu-1", 0), Duration::ZERO),
        }
        coordinator.lost(worker, AbortCode::Done, "gone".into(), Duration::ZERO);
        let told = std::iter::from_fn(|| coordinator.poll())
            .filter(|output| matches!(output, Output::Event(Event::Lost(lost, _)) if *lost == worker));
        assert_eq!(told.count(), 1, "{number}");
    }
    assert_eq!((coordinator.sessions.len(), coordinator.deadline()), (0, None));
    assert_eq!(coordinator.worn.len(), 0);
}

/// Workers that hold every pack on offer at once, unless they are of class `small`, and render when they are told to; each class has pixels of its own.
struct Fleet {
    master: Coordinator,
    now: Duration,
    crew: BTreeMap<WorkerId, Hand>,
    events: Vec<Event>,
    /// The frame that was begun last.
    frame: FrameId,
}

/// A worker of the fleet.
#[derive(Default)]
struct Hand {
    class: String,
    frame: Option<Frame>,
    tiles: VecDeque<(TileId, Attempt)>,
}

/// The byte that a class writes everywhere.
fn code(class: &str) -> u8 {
    class.as_bytes()[0]
}

impl Fleet {
    fn new(patience: Duration, workers: &[(&str, u64)]) -> Self {
        let master = Coordinator::new(None).with_patience(patience);
        let mut this = Self {
            master,
            now: Duration::from_secs(100),
            crew: BTreeMap::new(),
            events: Vec::new(),
            frame: FrameId(0),
        };
        for &(class, speed) in workers {
            this.join(class, speed);
        }
        this.master.load(PACK, 10, this.now);
        this.settle();
        this
    }

    fn join(&mut self, class: &str, speed: u64) -> WorkerId {
        let worker = self.master.connected(self.now);
        self.crew.insert(worker, Hand { class: class.into(), ..Hand::default() });
        self.master.message(worker, hello(class, speed), self.now);
        self.settle();
        worker
    }

    fn lose(&mut self, worker: WorkerId) {
        self.crew.remove(&worker);
        self.master.lost(worker, AbortCode::Done, "it died".into(), self.now);
        self.settle();
    }

    fn begin(&mut self, mix: bool, balance: Balance) {
        self.events.clear();
        self.frame = self.master.begin(&job(mix, balance), self.now).expect("a job in range");
        self.settle();
    }

    /// Does what the master wants, but renders nothing.
    fn settle(&mut self) {
        while let Some(output) = self.master.poll() {
            match output {
                Output::Send(worker, message) => self.told(worker, message),
                Output::Event(event) => self.events.push(event),
                Output::SendPack(..) | Output::Close(..) => {}
            }
        }
    }

    fn told(&mut self, worker: WorkerId, message: ToWorker) {
        let Some(hand) = self.crew.get_mut(&worker) else { return };
        match message {
            ToWorker::PackOffer { pack, .. } => {
                if hand.class == "small" {
                    let reason = PackRefusal::CannotHold { needs: 10, has: 9, what: "the GPU x".into() };
                    return self.master.message(worker, ToMaster::PackRejected { pack, reason }, self.now);
                }
                let answers = [ToMaster::PackNeed { pack, have: true }, ToMaster::PackReady { pack }];
                answers.into_iter().for_each(|answer| self.master.message(worker, answer, self.now));
            }
            ToWorker::Frame(frame) => {
                hand.frame = Some(frame);
                hand.tiles.clear();
            }
            ToWorker::Assign { frame, attempt, tiles } => {
                assert_eq!(hand.frame.expect("it was announced").frame, frame);
                hand.tiles.extend(tiles.into_iter().map(|tile| (tile, attempt)));
            }
            ToWorker::EndFrame { .. } => (hand.frame, hand.tiles) = (None, VecDeque::new()),
            ToWorker::Abort { detail, .. } => panic!("{worker}: {detail}"),
            _ => {}
        }
    }

    /// `worker` renders one tile and returns it, if it has one.
    fn step(&mut self, worker: WorkerId) -> bool {
        let Some(hand) = self.crew.get_mut(&worker) else { return false };
        let (Some(frame), Some((tile, attempt))) = (hand.frame, hand.tiles.pop_front()) else { return false };
        let grid = TileGrid::new(frame.width, frame.height, frame.tile).expect("in range");
        let rect = grid.rect(tile).expect("a tile of the frame");
        let length = rect.width * rect.height * 4;
        let pixels = vec![code(&hand.class); length as usize];
        let entry = TileEntry { tile, attempt, ..TileEntry::raw(length) };
        self.now += Duration::from_millis(1);
        let rendered = ToMaster::Rendered { frame: frame.frame, tiles: 1 };
        self.master.message(worker, rendered, self.now);
        self.master.tile(worker, frame.frame, &entry, &pixels, length.into(), self.now);
        self.settle();
        true
    }

    /// Everybody renders in turn until nobody has anything.
    fn run(&mut self) {
        let mut is_busy = true;
        while is_busy {
            is_busy = false;
            for worker in self.crew.keys().copied().collect::<Vec<_>>() {
                is_busy |= self.step(worker);
            }
        }
    }

    fn status(&self) -> FrameStatus {
        self.master.status(self.frame)
    }

    fn finish(&mut self) -> Outcome {
        assert_eq!(self.status(), FrameStatus::Done);
        let outcome = self.master.finish(self.frame, self.now).expect("done");
        self.settle();
        let tiles: u32 = outcome.workers.iter().map(|worker| worker.tiles).sum();
        assert_eq!(tiles, outcome.classes.iter().map(|part| part.tiles).sum::<u32>());
        assert_eq!(tiles, 64, "each tile once");
        outcome
    }

    /// The bytes that are anywhere in the picture.
    fn codes(outcome: &Outcome) -> BTreeSet<u8> {
        outcome.image.data().iter().copied().collect()
    }
}

fn job(mix: bool, balance: Balance) -> FrameJob {
    let camera = LocalCamera { origin: Vec3::ZERO, forward: -Vec3::Z, right: Vec3::X, up: Vec3::Y };
    FrameJob {
        camera,
        width: 64,
        height: 64,
        tile: 8,
        samples: 1,
        sampling: Default::default(),
        depth: 1,
        seed: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
        balance,
        mix,
        coding: None,
    }
}

#[test]
fn a_frame_is_of_the_class_that_is_the_fastest_together() {
    for (crew, expected, workers) in [
        (&[("cpu", 5), ("gpu", 9), ("cpu", 5)][..], "cpu", 2),
        (&[("cpu", 4), ("gpu", 9), ("cpu", 4)], "gpu", 1),
        (&[("b", 7), ("a", 7)], "a", 1),
        (&[("b", 0), ("a", 0), ("c", 0)], "a", 1),
    ] {
        for balance in Balance::ALL {
            let mut fleet = Fleet::new(Duration::ZERO, crew);
            fleet.begin(false, balance);
            let idle = (crew.len() - workers) as u32;
            let chosen = Event::ClassChosen { class: expected.into(), workers: workers as u32, idle };
            assert!(fleet.events.contains(&chosen), "{crew:?}: {:?}", fleet.events);
            for hand in fleet.crew.values() {
                assert_eq!(hand.frame.is_some(), hand.class == expected, "the others are not told of it");
            }
            // One that joins late takes part if it is of the class.
            let (same, other) = (fleet.join(expected, 1), fleet.join("other", 1000));
            assert!(fleet.crew[&same].frame.is_some() && fleet.crew[&other].frame.is_none());
            fleet.run();
            let outcome = fleet.finish();
            assert_eq!(Fleet::codes(&outcome), BTreeSet::from([code(expected)]));
            assert_eq!((outcome.classes.len(), outcome.differences.len()), (1, 0));
            assert_eq!((&*outcome.classes[0].class, outcome.idle), (expected, idle + 1));
            assert_eq!(outcome.workers.len(), workers + 1);
            // The idle ones are well, and the next frame is chosen anew.
            fleet.begin(false, balance);
            assert!(fleet.crew[&other].frame.is_some(), "it is the fastest now");
            fleet.run();
            assert_eq!(Fleet::codes(&fleet.finish()), BTreeSet::from([code("other")]));
        }
    }
}

#[test]
fn one_class_alone_is_nothing_to_speak_of() {
    let mut fleet = Fleet::new(Duration::ZERO, &[("cpu", 1), ("cpu", 1)]);
    fleet.begin(false, Balance::Dynamic);
    assert!(!fleet.events.iter().any(|event| matches!(event, Event::ClassChosen { .. })));
    fleet.run();
    assert_eq!(fleet.finish().idle, 0);
}

#[test]
fn a_class_that_cannot_hold_the_pack_is_not_chosen_and_says_why() {
    let mut fleet = Fleet::new(Duration::ZERO, &[("small", 1000), ("cpu", 1)]);
    let told = fleet.events.iter().find_map(|event| match event {
        Event::PackRejected(worker, reason) => Some((*worker, reason.to_string())),
        _ => None,
    });
    let says = "the GPU x can hold 9 bytes, the scene needs 10";
    assert!(told.is_some_and(|(worker, reason)| worker == WorkerId(0) && reason.starts_with(says)));
    fleet.begin(false, Balance::Dynamic);
    fleet.run();
    let outcome = fleet.finish();
    assert_eq!((Fleet::codes(&outcome), outcome.idle), (BTreeSet::from([code("cpu")]), 0));
    let rejected: Vec<_> = outcome.workers.iter().filter_map(|w| w.rejected.as_deref()).collect();
    assert!(matches!(rejected[..], [reason] if reason.starts_with(says)), "{rejected:?}");
}

#[test]
fn a_frame_that_loses_its_class_begins_again_with_another() {
    for balance in Balance::ALL {
        for patience in [Duration::ZERO, Duration::from_secs(60)] {
            let mut fleet = Fleet::new(patience, &[("gpu", 9), ("gpu", 9), ("cpu", 1), ("cpu", 1)]);
            let ids: Vec<_> = fleet.crew.keys().copied().collect();
            fleet.begin(false, balance);
            for _ in 0..5 {
                assert!(fleet.step(ids[0]) && fleet.step(ids[1]));
            }
            fleet.lose(ids[0]);
            assert!(fleet.crew[&ids[2]].frame.is_none(), "one of its own is left");
            assert!(fleet.step(ids[1]));
            fleet.lose(ids[1]);
            let again =
                Event::Restarted { frame: fleet.frame, from: "gpu".into(), to: "cpu".into(), dropped: 11 };
            assert!(fleet.events.contains(&again), "{balance}: {:?}", fleet.events);
            // One of the first class that comes back now is too late.
            let back = fleet.join("gpu", 9);
            assert!(fleet.crew[&back].frame.is_none());
            fleet.run();
            let outcome = fleet.finish();
            assert_eq!(
                Fleet::codes(&outcome),
                BTreeSet::from([code("cpu")]),
                "{balance}: no tile of the GPUs"
            );
            assert_eq!((outcome.dropped_tiles, outcome.idle), (11, 1), "{balance}");
            let lost = outcome.workers.iter().filter(|w| w.lost.is_some());
            assert!(lost.clone().count() == 2 && lost.map(|w| w.tiles).sum::<u32>() == 0);
        }
    }
}

#[test]
fn a_frame_by_rows_begins_again_at_the_top_with_another_class() {
    let mut fleet = Fleet::new(Duration::ZERO, &[("cpu", 5), ("gpu", 9)]);
    let [cpu, gpu] = [WorkerId(0), WorkerId(1)];
    fleet.events.clear();
    let job = job(false, Balance::Dynamic);
    fleet.frame = fleet.master.begin_rows(&job, fleet.now).expect("a job in range");
    fleet.settle();
    // One row of tiles and a half.
    for _ in 0..12 {
        assert!(fleet.step(gpu));
    }
    let rows = |fleet: &Fleet| -> Vec<Vec<u8>> {
        let rows = |event: &Event| match event {
            Event::Rows(_, rows) => Some(rows.clone()),
            _ => None,
        };
        fleet.events.iter().filter_map(rows).collect()
    };
    let band = 8 * 64 * 4;
    assert_eq!(rows(&fleet), [vec![code("gpu"); band]]);
    fleet.lose(gpu);
    fleet.run();
    // Whoever takes the rows is told, in between, to begin again.
    let is_restart = |event: &Event| matches!(event, Event::Restarted { dropped: 12, .. });
    let restart = fleet.events.iter().position(is_restart).expect("it is told");
    let before = fleet.events[..restart].iter().filter(|event| matches!(event, Event::Rows(..)));
    assert_eq!(before.count(), 1);
    assert_eq!(rows(&fleet)[1..], vec![vec![code("cpu"); band]; 8]);
    assert!(!fleet.step(cpu));
    let outcome = fleet.finish();
    assert_eq!((outcome.image.height(), outcome.image.data().len()), (0, 0), "all rows are out");

    // A mix is looked at again when it is complete, and so held whole.
    fleet.join("gpu", 9);
    fleet.events.clear();
    fleet.frame = fleet.master.begin_rows(&FrameJob { mix: true, ..job }, fleet.now).expect("a job in range");
    fleet.settle();
    fleet.run();
    assert_eq!(rows(&fleet), Vec::<Vec<u8>>::new());
    assert_eq!(Fleet::codes(&fleet.finish()), BTreeSet::from([code("cpu"), code("gpu")]));
}

#[test]
fn a_frame_without_its_class_waits_for_whoever_comes() {
    let patience = Duration::from_secs(60);
    for (comes, is_restarted) in [("gpu", false), ("cpu", true)] {
        let mut fleet = Fleet::new(patience, &[("gpu", 9)]);
        let first = *fleet.crew.keys().next().expect("one");
        fleet.begin(false, Balance::Dynamic);
        assert!(fleet.step(first));
        fleet.lose(first);
        assert_eq!(fleet.status(), FrameStatus::Pending);
        assert_eq!(fleet.master.deadline(), Some(fleet.now + patience));
        fleet.join(comes, 1);
        let restarted = fleet.events.iter().any(|event| matches!(event, Event::Restarted { .. }));
        assert_eq!(restarted, is_restarted, "{comes}");
        fleet.run();
        assert_eq!(Fleet::codes(&fleet.finish()), BTreeSet::from([code(comes)]));
    }
    // Nobody comes.
    let mut fleet = Fleet::new(patience, &[("gpu", 9)]);
    fleet.begin(false, Balance::Dynamic);
    fleet.lose(WorkerId(0));
    fleet.master.tick(fleet.now + patience);
    assert_eq!(fleet.status(), FrameStatus::Failed { done: 0, total: 64 });
}

#[test]
fn a_frame_that_begins_without_workers_is_of_the_class_that_comes_first() {
    let mut fleet = Fleet::new(Duration::from_secs(60), &[]);
    fleet.begin(false, Balance::Dynamic);
    fleet.join("cpu", 1);
    let late = fleet.join("gpu", 1000);
    assert!(fleet.crew[&late].frame.is_none());
    fleet.run();
    assert_eq!(Fleet::codes(&fleet.finish()), BTreeSet::from([code("cpu")]));
}

#[test]
fn mixed_frames_say_how_far_the_classes_differ() {
    for balance in Balance::ALL {
        let mut fleet = Fleet::new(Duration::ZERO, &[("cpu", 1), ("gpu", 9), ("gpu", 9)]);
        fleet.begin(true, balance);
        assert!(fleet.crew.values().all(|hand| hand.frame.is_some()), "all take part");
        fleet.run();
        let outcome = fleet.finish();
        assert_eq!(Fleet::codes(&outcome), BTreeSet::from([code("cpu"), code("gpu")]));
        let parts: Vec<_> = outcome.classes.iter().map(|part| (&*part.class, part.workers)).collect();
        assert_eq!(parts, [("gpu", 2), ("cpu", 1)], "{balance}");
        assert_eq!((outcome.dropped_tiles, outcome.idle), (0, 0), "comparing is no loss");
        let [found] = &outcome.differences[..] else { panic!("{balance}: {:?}", outcome.differences) };
        assert_eq!(found.classes, ["cpu", "gpu"]);
        assert_eq!((found.tiles, found.pixels, found.differing), (4, 256, 256), "{balance}");
        assert_eq!(found.max_abs, f64::from(code("gpu") - code("cpu")));
        assert!(found.psnr_db.is_some_and(|psnr| (36.0..37.0).contains(&psnr)), "20 log10(255 / 4)");
        // Every worker is free for the next frame.
        fleet.begin(true, balance);
        fleet.run();
        assert_eq!(fleet.finish().differences.len(), 1);
    }
}

#[test]
fn every_pair_of_classes_in_a_mix_is_compared() {
    let mut fleet = Fleet::new(Duration::ZERO, &[("a", 1), ("b", 1), ("c", 1)]);
    fleet.begin(true, Balance::Static);
    fleet.run();
    let outcome = fleet.finish();
    let pairs: Vec<_> =
        outcome.differences.iter().map(|found| found.classes.each_ref().map(|c| &**c)).collect();
    assert_eq!(pairs, [["a", "b"], ["a", "c"], ["b", "c"]]);
    assert_eq!(outcome.differences[1].max_abs, 2.0);
}

#[test]
fn a_mix_of_one_class_compares_nothing() {
    let mut fleet = Fleet::new(Duration::ZERO, &[("cpu", 1), ("cpu", 9)]);
    fleet.begin(true, Balance::Dynamic);
    fleet.run();
    let outcome = fleet.finish();
    assert_eq!((outcome.classes.len(), outcome.differences.len()), (1, 0));
}

#[test]
fn nobody_waits_for_a_comparison_that_does_not_come() {
    // The CPU renders its tiles and then no more, or dies.
    for dies in [false, true] {
        let mut fleet = Fleet::new(Duration::ZERO, &[("cpu", 1), ("gpu", 9)]);
        let (cpu, gpu) = (WorkerId(0), WorkerId(1));
        fleet.begin(true, Balance::PaperStatic);
        let mut events = 0;
        while events < 64 {
            fleet.step(cpu);
            fleet.step(gpu);
            events = fleet.events.iter().filter(|event| matches!(event, Event::Tile { .. })).count();
        }
        assert_eq!(fleet.status(), FrameStatus::Pending, "tiles are compared");
        while fleet.step(gpu) {}
        assert_eq!(fleet.status(), FrameStatus::Pending, "two come from the CPU");
        if dies {
            fleet.lose(cpu);
        } else {
            let late = fleet.master.deadline().expect("somebody waits");
            assert!(late <= fleet.now + Duration::from_secs(6), "not for long");
            fleet.now = late;
            fleet.master.tick(late);
        }
        let outcome = fleet.finish();
        assert_eq!(outcome.differences[0].tiles, 2, "what the GPU has rendered of the CPU's");
        assert!(outcome.timings.frame < Duration::from_secs(1), "the footnote does not count");
    }
}

mod frames;
