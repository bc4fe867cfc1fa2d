//! A frame from outside: what is handed out, taken and handed on.

use super::*;

const NOW: Duration = Duration::from_secs(100);
const SECOND: Duration = Duration::from_secs(1);

/// Tiles that a worker holds whose link takes next to no time.
const PREFETCH: usize = 2;

fn workers(count: u32) -> Vec<WorkerId> {
    (0..count).map(WorkerId).collect()
}

/// A frame of `tiles` tiles of one sample each.
fn start(tiles: u32, balance: Balance, count: u32) -> (Dispatch, Vec<Assignment>) {
    Dispatch::start(&TileGrid::new(tiles, 1, 1).unwrap(), balance, 1, &workers(count), NOW)
}

fn given(assignments: &[Assignment], worker: u32) -> Vec<u32> {
    let of = assignments.iter().filter(|a| a.worker == WorkerId(worker));
    of.flat_map(|a| a.tiles.iter().map(|t| t.0)).collect()
}

#[test]
fn each_balancing_hands_out_what_it_promises() {
    let start = |balance| start(64, balance, 4).1;
    let paper = start(Balance::PaperStatic);
    assert_eq!(given(&paper, 1), (0..16).map(|i| 4 * i + 1).collect::<Vec<_>>());
    assert_eq!(start(Balance::Static).iter().map(|a| a.tiles.len()).sum::<usize>(), 64);
    let pull = start(Balance::PaperDynamic);
    assert_eq!((0..4).map(|w| given(&pull, w)).collect::<Vec<_>>(), [[0], [1], [2], [3]]);
    let ahead = start(Balance::Dynamic);
    assert!((0..4).all(|w| given(&ahead, w).len() == PREFETCH));
}

#[test]
fn the_last_tiles_of_the_dynamic_balancing_are_not_hoarded() {
    let (mut d, first) = start(9, Balance::Dynamic, 4);
    // 9 tiles, 4 workers: two each would leave one; the credit falls to one when fewer than 8 are left.
    let held = (0..4).map(|w| given(&first, w).len()).collect::<Vec<_>>();
    assert!(held.iter().all(|&n| n <= 2), "{held:?}");
    while !d.pool.is_empty() {
        for w in workers(4) {
            if d.crew[&w].queued > 0 {
                d.rendered(w, 1, NOW).unwrap();
            }
        }
    }
    assert!(d.crew.values().all(|hand| hand.queued <= 1));
}

#[test]
fn the_first_result_wins_and_duplicates_are_counted() {
    let (mut d, _) = start(2, Balance::PaperStatic, 2);
    assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(true));
    assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(false));
    assert_eq!(d.dropped(), 1);
    assert!(!d.is_done());
    assert_eq!(d.accept(WorkerId(1), TileId(1), Attempt(0), NOW), Ok(true));
    assert!(d.is_done());
}

#[test]
fn what_was_not_given_is_a_violation() {
    let (mut d, _) = start(4, Balance::PaperDynamic, 2);
    let wrong = |tile, attempt| Err(Violation::NotAssigned { tile, attempt });
    assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(0), NOW), wrong(0, 0));
    assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(1), NOW), wrong(0, 1));
    assert_eq!(d.accept(WorkerId(0), TileId(3), Attempt(0), NOW), wrong(3, 0));
    assert_eq!(d.accept(WorkerId(0), TileId(4), Attempt(0), NOW), wrong(4, 0));
    assert_eq!(d.accept(WorkerId(0), TileId(u32::MAX), Attempt(u32::MAX), NOW), wrong(u32::MAX, u32::MAX));
    for tiles in [0, 2] {
        assert_eq!(d.rendered(WorkerId(0), tiles, NOW), Err(Violation::Rendered { tiles, queued: 1 }));
    }
}

#[test]
fn pixels_are_owed_once_everything_is_rendered() {
    let (mut d, _) = start(3, Balance::PaperStatic, 2);
    let first = WorkerId(0);
    d.rendered(first, 1, NOW).unwrap();
    assert!(!d.owes(first), "it renders the other");
    d.rendered(first, 1, NOW).unwrap();
    assert!(d.owes(first) && !d.owes(WorkerId(1)));
    d.accept(first, TileId(0), Attempt(0), NOW).unwrap();
    d.accept(first, TileId(0), Attempt(0), NOW).unwrap();
    assert!(d.owes(first), "one tile twice is not two tiles");
    d.lost(WorkerId(1), NOW);
    assert!(!d.owes(first), "it has the tile of the other");
    d.rendered(first, 1, NOW).unwrap();
    // The other's result still comes.
    d.accept(WorkerId(1), TileId(1), Attempt(0), NOW).unwrap();
    d.accept(first, TileId(2), Attempt(0), NOW).unwrap();
    assert!(!d.owes(first) && !d.owes(WorkerId(1)) && d.is_done());
}

#[test]
fn a_lost_worker_s_tiles_go_to_the_others_and_its_late_results_still_count() {
    for balance in Balance::ALL {
        let (mut d, first) = start(12, balance, 3);
        let mine = given(&first, 1);
        assert_eq!(d.accept(WorkerId(1), TileId(mine[0]), Attempt(0), NOW), Ok(true));
        let again = d.lost(WorkerId(1), NOW);
        assert!(again.iter().all(|a| a.worker != WorkerId(1)));
        assert!(!again.iter().any(|a| a.tiles.contains(&TileId(mine[0]))), "{balance}");
        assert_eq!(d.lost(WorkerId(1), NOW), []);
        if let Some(&late) = mine.get(1) {
            // In flight when the worker left: it may win over the next attempt, whose result is then
            // dropped.
            assert_eq!(d.accept(WorkerId(1), TileId(late), Attempt(0), NOW), Ok(true));
        }
        assert_eq!(d.rendered(WorkerId(1), 1, NOW), Ok(Vec::new()), "words of the dead are ignored");
    }
}

#[test]
fn a_late_worker_s_last_tile_goes_to_one_that_idles() {
    let (mut d, first) = start(2, Balance::PaperDynamic, 2);
    assert_eq!((given(&first, 0), given(&first, 1)), (vec![0], vec![1]));
    assert_eq!(d.deadline(), Some(NOW + d.pace.stalled_after(1)), "nobody idles");
    assert_eq!(d.rendered(WorkerId(1), 1, NOW + SECOND), Ok(vec![]), "worker 0 may take as long");
    let late = d.deadline().unwrap();
    assert_eq!(late, NOW + 2 * SECOND, "two means");
    assert_eq!(d.tick(late - Duration::from_nanos(1)), []);
    let again = d.tick(late);
    assert_eq!(again, [Assignment { worker: WorkerId(1), attempt: Attempt(1), tiles: vec![TileId(0)] }]);
    assert_eq!(d.tick(late * 2), [], "a tile is with two workers at most");
    assert_eq!(
        d.accept(WorkerId(0), TileId(0), Attempt(1), NOW),
        Err(Violation::NotAssigned { tile: 0, attempt: 1 })
    );
    assert_eq!(d.accept(WorkerId(1), TileId(1), Attempt(0), NOW), Ok(true));
    assert_eq!(d.accept(WorkerId(0), TileId(0), Attempt(0), NOW), Ok(true), "the first attempt may win");
    assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(1), NOW), Ok(false));
    assert!(d.is_done() && d.dropped() == 1);
    assert!(!d.owes(WorkerId(0)) && !d.owes(WorkerId(1)), "nothing is missing from either");
}

#[test]
fn a_tile_that_holds_up_too_many_goes_to_another_while_there_are_more() {
    for may_wait in [4, u32::MAX] {
        let (mut d, first) = start(100, Balance::Dynamic, 2);
        d.keep_order(may_wait);
        assert_eq!((given(&first, 0), given(&first, 1)), (vec![0, 2], vec![1, 3]));
        let mut now = NOW;
        let mut ours: VecDeque<_> = [1, 3].into();
        // Worker 0 is silent, worker 1 does a tile a second.
        while let Some(tile) = ours.pop_front().filter(|_| now < NOW + 20 * SECOND) {
            now += SECOND;
            let attempt = Attempt(u32::from([0, 2].contains(&tile)));
            assert_eq!(d.accept(WorkerId(1), TileId(tile), attempt, now), Ok(true));
            ours.extend(given(&d.rendered(WorkerId(1), 1, now).unwrap(), 1));
            let waiting = d.done() - d.first_missing;
            // Five, and while each of the three tiles of worker 0 is rendered the two that worker 1 has in hand before it.
            assert!(may_wait == u32::MAX || waiting <= 5 + 3 * 2, "{waiting} wait");
        }
        assert_eq!(d.first_missing > 15, may_wait == 4, "{}", d.first_missing);
        assert_eq!(d.done(), 20);
    }
}

#[test]
fn the_fastest_that_idles_helps() {
    let (mut d, first) = start(4, Balance::PaperDynamic, 4);
    assert_eq!(given(&first, 3), [3]);
    // Workers 0 and 3 are silent.
    d.rendered(WorkerId(2), 1, NOW + SECOND).unwrap();
    d.rendered(WorkerId(1), 1, NOW + SECOND / 2).unwrap();
    let late = d.deadline().unwrap();
    assert_eq!(late, NOW + SECOND, "two means of worker 1");
    let again = d.tick(late);
    assert_eq!((given(&again, 1), given(&again, 2)), (vec![0], vec![]));
    let again = d.rendered(WorkerId(1), 1, late + SECOND / 2).unwrap();
    assert_eq!(given(&again, 1), [3], "worker 2 would wait for a second more");
}

#[test]
fn the_static_balancings_wait_longer_and_take_from_the_end() {
    let (mut d, first) = start(8, Balance::PaperStatic, 2);
    assert_eq!(given(&first, 0), [0, 2, 4, 6]);
    d.rendered(WorkerId(1), 4, NOW + 8 * SECOND).unwrap();
    // Four times two seconds a tile, for a list of four.
    assert_eq!(d.tick(NOW + 31 * SECOND), []);
    assert_eq!(given(&d.tick(NOW + 32 * SECOND), 1), [6]);
    assert_eq!(given(&d.rendered(WorkerId(1), 1, NOW + 33 * SECOND).unwrap(), 1), [4]);
    // Worker 0 is not dead, only slow.
    assert_eq!(d.rendered(WorkerId(0), 4, NOW + 34 * SECOND), Ok(vec![]));
    assert!(d.owes(WorkerId(0)));
}

#[test]
fn the_second_holder_of_a_tile_keeps_it_when_the_first_is_lost_and_the_other_way_round() {
    for gone in [0, 1] {
        let (mut d, _) = start(1, Balance::Dynamic, 3);
        assert_eq!(given(&d.tick(NOW + SECOND), 1), [0], "worker 1 has no tile");
        // The other still has it: worker 2 gets it once that one is late too, which worker 0 is.
        let third = d.lost(WorkerId(gone), NOW + SECOND);
        assert_eq!(third.is_empty(), gone == 0);
        let third = [third, d.tick(NOW + 10 * SECOND)].concat();
        assert_eq!(third, [Assignment { worker: WorkerId(2), attempt: Attempt(2), tiles: vec![TileId(0)] }]);
        d.lost(WorkerId(1 - gone), NOW);
        assert_eq!(d.lost(WorkerId(2), NOW), []);
        assert_eq!(given(&d.join(&[WorkerId(7)], NOW), 7), [0], "nobody else has it");
        assert_eq!(d.accept(WorkerId(7), TileId(0), Attempt(3), NOW), Ok(true));
    }
}

#[test]
fn those_that_join_late_get_what_is_there() {
    let (mut d, _) = start(64, Balance::Dynamic, 1);
    assert_eq!(given(&d.join(&[WorkerId(5)], NOW), 5).len(), PREFETCH);
    let (mut d, _) = start(64, Balance::Static, 2);
    assert_eq!(d.join(&[WorkerId(5)], NOW), [], "all is dealt");
    let mine = d.crew[&WorkerId(0)].alone_with.clone();
    assert_eq!(given(&d.lost(WorkerId(0), NOW), 5).len(), mine.len(), "it had nothing to do");
    // Nobody was there at the start.
    let (mut d, _) = start(64, Balance::Static, 0);
    assert_eq!(given(&d.join(&[WorkerId(5)], NOW), 5).len(), 64);
}

#[test]
fn a_worker_that_never_finishes_is_named_in_the_end() {
    let (mut d, _) = start(1, Balance::Dynamic, 1);
    let deadline = d.deadline().unwrap();
    assert_eq!(deadline, NOW + d.pace.stalled_after(1), "nobody could help it");
    assert_eq!(d.stalled(deadline - Duration::from_nanos(1)).count(), 0);
    assert_eq!(d.stalled(deadline).collect::<Vec<_>>(), [WorkerId(0)]);
    d.accept(WorkerId(0), TileId(0), Attempt(0), NOW).unwrap();
    d.rendered(WorkerId(0), 1, NOW).unwrap();
    assert_eq!(d.deadline(), None);
}

#[test]
fn a_finished_tile_can_be_compared_and_does_not_count() {
    let (mut d, _) = start(2, Balance::PaperStatic, 2);
    assert_eq!(d.compare(WorkerId(0), TileId(1), NOW), None, "it is not in");
    for w in [0, 1] {
        assert_eq!(d.accept(WorkerId(w), TileId(w), Attempt(0), NOW), Ok(true));
        d.rendered(WorkerId(w), 1, NOW).unwrap();
    }
    let again = d.compare(WorkerId(0), TileId(1), NOW);
    let expected = Assignment { worker: WorkerId(0), attempt: Attempt(1), tiles: vec![TileId(1)] };
    assert_eq!(again, Some(expected));
    assert!(!d.owes(WorkerId(0)), "nothing is missing from the image");
    assert!(d.deadline().is_some(), "it may stall");
    assert_eq!(d.rendered(WorkerId(0), 1, NOW + SECOND), Ok(vec![]));
    d.compared(WorkerId(0), NOW + SECOND);
    assert!(d.is_done() && d.dropped() == 0 && d.deadline().is_none());
    d.leave(WorkerId(0));
    assert_eq!(d.compare(WorkerId(0), TileId(1), NOW), None, "it takes no more");
    assert_eq!(d.compare(WorkerId(7), TileId(1), NOW), None, "nobody");
    assert_eq!(d.staying().collect::<Vec<_>>(), [WorkerId(1)]);
}

#[test]
fn all_lost_leaves_the_tiles_waiting() {
    let (mut d, _) = start(3, Balance::Static, 2);
    assert!(!d.lost(WorkerId(0), NOW).is_empty());
    assert_eq!(d.lost(WorkerId(1), NOW), []);
    assert_eq!((d.workers(), d.is_done(), d.done()), (0, false, 0));
}

#[test]
fn more_workers_than_tiles() {
    for balance in Balance::ALL {
        let (mut d, first) = start(1, balance, 16);
        assert_eq!(first.len(), 1, "{balance}");
        assert_eq!(d.accept(first[0].worker, TileId(0), Attempt(0), NOW), Ok(true));
        assert!(d.is_done());
    }
}

#[test]
fn lists_that_nobody_has_are_shared_out_among_all_that_join_at_once() {
    let (mut d, _) = start(64, Balance::Static, 2);
    let left: Vec<_> = workers(2).into_iter().flat_map(|worker| d.lost(worker, NOW)).collect();
    assert!(given(&left, 1).len() == 32, "the other has them first: {left:?}");
    let handed = d.join(&[WorkerId(4), WorkerId(5), WorkerId(6), WorkerId(7)], NOW);
    for worker in 4..8 {
        assert_eq!(given(&handed, worker).len(), 16, "{handed:?}");
    }
}

/// A tile that a second worker has finished is the first one's until that says that it was cancelled. That the clocks are restarted meanwhile,
/// as for a frame that waited for another, must not make it a tile that is missing.
#[test]
fn a_tile_that_is_being_taken_back_is_not_expected() {
    let grid = TileGrid::new(4, 1, 1).unwrap();
    let plan = Plan {
        costs: vec![1.0; 4],
        endgame: Endgame::Soonest(Duration::ZERO),
        ..plan_of(&grid, Balance::Dynamic, 2)
    };
    let (mut d, handed) = Dispatch::start_as(&grid, plan, 1, &workers(2), NOW);
    assert_eq!((given(&handed, 0), given(&handed, 1)), (vec![0], vec![1]));
    // The second does all others, and helps.
    let mut now = NOW;
    for tile in [1, 2, 3] {
        now += SECOND / 10;
        d.rendered(WorkerId(1), 1, now).unwrap();
        d.accept(WorkerId(1), TileId(tile), Attempt(0), now).unwrap();
    }
    now += 10 * SECOND;
    assert_eq!(given(&d.tick(now), 1), [0]);
    now += SECOND / 10;
    d.rendered(WorkerId(1), 1, now).unwrap();
    assert_eq!(d.accept(WorkerId(1), TileId(0), Attempt(1), now), Ok(true));
    assert_eq!(d.other_holders(TileId(0), WorkerId(1)), [WorkerId(0)]);
    d.restart_clocks(now);
    assert!(d.expected.is_empty(), "{:?}", d.expected);
    d.cancelled(WorkerId(0), 1, now).unwrap();
    assert_eq!(d.tick(now + 100 * SECOND), [], "all is in");
}

/// How frames of `count` workers are handed out while nothing is known.
fn plan_of(grid: &TileGrid, balance: Balance, count: u32) -> Plan {
    let camera = Camera { origin: [0.0; 3], forward: [0.0; 3], right: [0.0; 3], up: [0.0; 3] };
    let (workers, known) = (workers(count), Knowledge::default());
    plan(balance, &View { grid, camera: &camera, workers: &workers, known: &known, in_order: false })
}
