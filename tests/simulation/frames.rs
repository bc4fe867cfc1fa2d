//! Frames that overlap: several are under way, on the same workers and on groups of their own.

use super::*;
use tessera_master::coordinator::{BeginError, Group};

#[test]
fn frames_that_overlap_are_each_complete_for_every_seed() {
    let (mut lost, mut joined, mut helped, mut cancelled, mut stopped, mut full) = (0, 0, 0, 0, 0, 0);
    for seed in 0..600 {
        let mut world = World::new(seed, true);
        let (groups, depth) = (1 + world.below(3) as u32, 1 + world.below(3) as usize);
        for pack in [None, Some(PACKS[1])] {
            if let Some(pack) = pack {
                world.load(pack);
            }
            let jobs: Vec<_> = (1..=8).map(|seed| FrameJob { seed, ..world.random_job() }).collect();
            let (outcomes, waited) = world.render_all(&jobs, groups, depth);
            for (job, outcome) in jobs.iter().zip(&outcomes) {
                check_frame(seed, job, outcome);
            }
            full += waited;
        }
        lost += world.lost.len();
        joined += world.took_part_late;
        helped += world.shared_tiles;
        cancelled += world.cancelled;
        stopped += world.stopped;
    }
    // The seeds do what they are for.
    assert!(lost > 600 && joined > 600, "{lost} workers were lost, {joined} were late");
    assert!(helped > 1000, "{helped} tiles were with two workers");
    assert!(cancelled > 3000 && stopped > 50, "{cancelled} tiles were cancelled, {stopped} stopped");
    assert!(full > 0, "{full} times there was no room");
}

#[test]
fn overlapping_frames_of_workers_that_are_well_render_nothing_twice() {
    for seed in 0..300 {
        let mut world = World::new(seed, false);
        let (groups, depth) = (1 + world.below(3) as u32, 1 + world.below(3) as usize);
        let jobs: Vec<_> = (1..=5).map(|seed| FrameJob { seed, ..world.random_job() }).collect();
        let (outcomes, _) = world.render_all(&jobs, groups, depth);
        // (What comes of a frame that is over is counted in the next.)
        let mut may_be_dropped = depth > 1;
        for (job, outcome) in jobs.iter().zip(&outcomes) {
            check_frame(seed, job, outcome);
            // Only who idles in a frame while another is at an earlier one may take a tile of it as well.
            may_be_dropped |= renders_twice(job.balance);
            assert!(outcome.dropped_tiles == 0 || may_be_dropped, "seed {seed}: {}", job.balance);
        }
        assert_eq!(world.lost, []);
    }
}

#[test]
fn groups_have_frames_of_their_own() {
    for groups in 1..=4 {
        let mut world = World::with_workers(1, 4);
        let job = |world: &mut World, seed| FrameJob {
            seed,
            width: 64,
            height: 64,
            tile: 8,
            balance: Balance::PaperStatic,
            ..world.random_job()
        };
        let jobs: Vec<_> = (1..=8).map(|seed| job(&mut world, seed)).collect();
        let (outcomes, _) = world.render_all(&jobs, groups, 2);
        for (number, (job, outcome)) in (0..).zip(jobs.iter().zip(&outcomes)) {
            check_frame(number, job, outcome);
            let names: Vec<_> = outcome.workers.iter().map(|w| w.name.clone()).collect();
            let own = (0..4).filter(|w| w % groups == number as u32 % groups).map(|w| format!("w{w}"));
            assert_eq!(names, own.collect::<Vec<_>>(), "frame {number} of {groups} groups");
        }
    }
}

#[test]
fn a_group_that_is_lost_leaves_its_frames_to_the_others() {
    for balance in Balance::ALL {
        let mut world = World::with_workers(1, 2);
        let job = FrameJob { width: 64, height: 64, tile: 8, balance, ..world.random_job() };
        let jobs: Vec<_> = (1..=6).map(|seed| FrameJob { seed, ..job.clone() }).collect();
        let at = world.now + Duration::from_millis(3);
        world.schedule(at, Happening::Die(WorkerId(1)));
        let (outcomes, _) = world.render_all(&jobs, 2, 2);
        for (number, (job, outcome)) in (0..).zip(jobs.iter().zip(&outcomes)) {
            check_frame(number, job, outcome);
        }
        assert_eq!(world.lost, [WorkerId(1)], "{balance}");
        // The second frame was its own.
        let lost: Vec<_> = outcomes[1].workers.iter().map(|w| w.lost.is_some()).collect();
        assert_eq!(lost, [true, false], "{balance}");
    }
}

#[test]
fn one_that_is_at_an_earlier_frame_is_not_late_with_a_later_one() {
    let mut world = World::with_workers(1, 2);
    // A tile takes up to 40 s, and a frame several times as long as a worker may be silent in one.
    world.slowness = 40_000;
    world.most_ahead = 1;
    let job = FrameJob { width: 64, height: 64, tile: 8, balance: Balance::Static, ..world.random_job() };
    let jobs: Vec<_> = (1..=3).map(|seed| FrameJob { seed, ..job.clone() }).collect();
    let begun = world.now;
    let (outcomes, _) = world.render_all(&jobs, 1, 3);
    for (number, (job, outcome)) in (0..).zip(jobs.iter().zip(&outcomes)) {
        check_frame(number, job, outcome);
    }
    assert!(world.now - begun > Duration::from_secs(1000));
    assert_eq!(world.lost, []);
}

#[test]
fn overlapping_frames_do_not_hide_a_worker_that_is_dead() {
    let mut world = World::with_workers(1, 3);
    let balance = Balance::Dynamic;
    let job = FrameJob { width: 64, height: 64, tile: 8, balance, ..world.random_job() };
    world.workers[1].stalled_until = Duration::MAX;
    world.expected_lost.insert(WorkerId(1));
    let mut frames = 0;
    while world.lost.is_empty() {
        let jobs = vec![job.clone(); 4];
        let (outcomes, _) = world.render_all(&jobs, 1, 2);
        for outcome in &outcomes {
            check_frame(frames, &job, outcome);
        }
        frames += 4;
        assert!(frames < 100_000, "it is still there");
    }
    assert!(world.reasons[0].contains("stalled"), "{:?}", world.reasons);
}

#[test]
fn a_frame_that_is_given_up_leaves_the_others_alone() {
    for seed in 0..200 {
        let mut world = World::new(seed, false);
        let jobs: Vec<_> = (1..=3).map(|seed| FrameJob { seed, ..world.random_job() }).collect();
        let begin = |world: &mut World, job| world.coordinator.begin(job, world.now).expect("a job in range");
        let frames: Vec<_> = jobs.iter().map(|job| begin(&mut world, job)).collect();
        let time = world.micros(1, 3000);
        world.pass(time);
        let given_up = world.below(3) as usize;
        let was_done = world.coordinator.status(frames[given_up]) == FrameStatus::Done;
        assert_eq!(world.coordinator.finish(frames[given_up], world.now).is_some(), was_done);
        assert_eq!(world.coordinator.status(frames[given_up]), FrameStatus::Pending, "nobody knows it");
        for (number, (&frame, job)) in frames.iter().zip(&jobs).enumerate() {
            if number != given_up {
                let outcome = world.finish(frame, job).expect("all are well");
                check_frame(seed, job, &outcome);
            }
        }
        assert_eq!(world.lost, []);
    }
}

#[test]
fn there_is_an_end_to_how_many_may_begin() {
    let mut world = World::with_workers(1, 2);
    let job = world.random_job();
    for _ in 0..Coordinator::FRAMES {
        world.coordinator.begin(&job, world.now).expect("there is room");
    }
    assert_eq!(world.coordinator.begin(&job, world.now), Err(BeginError::Full));
    let first = world.coordinator.begun().next().expect("many");
    world.coordinator.finish(first, world.now);
    assert!(world.coordinator.begin(&job, world.now).is_ok());
}

impl World {
    /// Frames one after the other in groups by turns, of each group up to `depth` at a time; and how often there was no room for more.
    fn render_all(&mut self, jobs: &[FrameJob], groups: u32, depth: usize) -> (Vec<Outcome>, u32) {
        let mut outcomes = BTreeMap::new();
        let mut under_way = Vec::<(usize, FrameId)>::new();
        let (mut next, mut waited) = (0, 0);
        while outcomes.len() < jobs.len() {
            while next < jobs.len() && under_way.len() < depth * groups as usize {
                let group = Group { index: next as u32, count: groups };
                self.began_with = self.coordinator.holders().count() as u32;
                match self.coordinator.begin_in(&jobs[next], group, self.now) {
                    Ok(frame) => under_way.push((next, frame)),
                    Err(BeginError::Full) if !under_way.is_empty() => {
                        waited += 1;
                        break;
                    }
                    Err(error) => panic!("{error}"),
                }
                self.disasters();
                next += 1;
            }
            let frames: Vec<_> = under_way.iter().map(|&(_, frame)| frame).collect();
            self.run_until(|c| frames.iter().any(|&frame| c.status(frame) != FrameStatus::Pending));
            under_way.retain(|&(number, frame)| match self.coordinator.status(frame) {
                FrameStatus::Pending => true,
                FrameStatus::Done => {
                    let outcome = self.coordinator.finish(frame, self.now).expect("done");
                    self.took_part_late += (outcome.workers.len() as u32).saturating_sub(self.began_with);
                    outcomes.insert(number, outcome);
                    false
                }
                status => panic!("frame {number}: {status:?}"),
            });
            self.carry_out();
        }
        (outcomes.into_values().collect(), waited)
    }
}
