//! Several frames at a time, and tiles that are cancelled.

use super::*;
use std::collections::BTreeMap;

const AT_ONCE: ReturnMode = ReturnMode::Batches { min_bytes: 0 };

fn cancel(s: &mut Session, id: u64, tiles: impl IntoIterator<Item = u32>) {
    let tiles = tiles.into_iter().map(TileId).collect();
    s.message(ToWorker::Cancel { frame: FrameId(id), tiles });
}

fn cancelled(id: u64, tiles: u32) -> Action {
    Action::Send(ToMaster::Cancelled { frame: FrameId(id), tiles })
}

/// Frame and tile of each.
fn names(tasks: &[RenderTask]) -> Vec<(u64, u32)> {
    tasks.iter().map(|task| (task.frame.frame.0, task.tile.0)).collect()
}

#[test]
fn tiles_of_earlier_frames_come_first_whenever_they_are_assigned() {
    let mut s = loaded();
    for id in [1, 2, 5] {
        s.message(ToWorker::Frame(frame(id, AT_ONCE)));
    }
    assign(&mut s, 5, [0]);
    assign(&mut s, 2, [3, 1]);
    assign(&mut s, 1, [2]);
    let mut order = Vec::new();
    while let Some(action) = s.poll() {
        match action {
            Action::Render(task) => {
                order.push(names(&[task])[0]);
                finish(&mut s, task);
            }
            Action::Return(_) => s.batch_sent(),
            _ => {}
        }
    }
    // The first was begun before there was another.
    assert_eq!(order, [(5, 0), (1, 2), (2, 3), (2, 1)]);
}

#[test]
fn the_end_of_a_frame_is_that_of_no_other() {
    let mut s = loaded_ahead(3);
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    s.message(ToWorker::Frame(frame(2, ReturnMode::AtEnd)));
    assign(&mut s, 1, 0..2);
    assign(&mut s, 2, 0..3);
    let begun = tasks(&mut s);
    assert_eq!(names(&begun), [(1, 0), (1, 1), (2, 0)]);
    s.message(ToWorker::EndFrame { frame: FrameId(1) });
    assert_eq!(actions(&mut s), [Action::StopRendering(vec![begun[0].name(), begun[1].name()])]);
    s.rendering_stopped(begun[1].name());
    // Finished before it could be stopped: nobody hears of it.
    finish(&mut s, begun[0]);
    let more = tasks(&mut s);
    assert_eq!(names(&more), [(2, 1), (2, 2)]);
    for task in [more[0], begun[2], more[1]] {
        finish(&mut s, task);
    }
    let all = actions(&mut s);
    let [Action::Send(ToMaster::Rendered { frame: FrameId(2), tiles: 3 }), Action::Return(batch)] = &all[..]
    else {
        panic!("{all:?}")
    };
    assert_eq!(tiles_of(batch), [1, 0, 2]);
}

#[test]
fn there_are_not_more_frames_than_the_limit() {
    let mut s = loaded();
    let most = limits::FRAMES as u64;
    for id in 1..=most {
        s.message(ToWorker::Frame(frame(id, AT_ONCE)));
    }
    assert_eq!(actions(&mut s), []);
    s.message(ToWorker::EndFrame { frame: FrameId(3) });
    s.message(ToWorker::Frame(frame(most + 1, AT_ONCE)));
    assert_eq!(actions(&mut s), []);
    s.message(ToWorker::Frame(frame(most + 2, AT_ONCE)));
    check_aborted(&mut s, AbortCode::Unexpected);
}

#[test]
fn cancelled_tiles_are_counted_where_they_are_not_said_to_be_rendered() {
    // Waiting, in hand, and rendered but not said.
    let mut s = loaded_ahead(2);
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    assign(&mut s, 1, 0..4);
    let begun = tasks(&mut s);
    finish(&mut s, begun[0]);
    let third = tasks(&mut s)[0];
    cancel(&mut s, 1, [0, 1, 3]);
    assert_eq!(actions(&mut s), [Action::StopRendering(vec![begun[1].name()]), cancelled(1, 3)]);
    s.rendering_stopped(begun[1].name());
    assert_eq!(actions(&mut s), []);
    finish(&mut s, third);
    let all = actions(&mut s);
    let [Action::Send(ToMaster::Rendered { tiles: 1, .. }), Action::Return(batch)] = &all[..] else {
        panic!("{all:?}")
    };
    assert_eq!(tiles_of(batch), [2]);
    batch.header.check().expect("a batch");

    // Said when they were finished: dropped from the batch, and not counted.
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 1000 })));
    assign(&mut s, 1, 0..3);
    for _ in 0..2 {
        let Some(Action::Render(task)) = actions(&mut s).pop() else { panic!("nothing to render") };
        finish(&mut s, task);
    }
    let Some(Action::Render(last)) = actions(&mut s).pop() else { panic!("nothing to render") };
    cancel(&mut s, 1, [0]);
    assert_eq!(actions(&mut s), [cancelled(1, 0)]);
    // Nothing is left to render: what is in the batch does not wait for ever.
    cancel(&mut s, 1, [2]);
    let all = actions(&mut s);
    assert_eq!(all[..2], [Action::StopRendering(vec![last.name()]), cancelled(1, 1)]);
    let [Action::Return(batch)] = &all[2..] else { panic!("{all:?}") };
    assert_eq!(tiles_of(batch), [1]);
    // It is finished nevertheless, and counts once.
    finish(&mut s, last);
    cancel(&mut s, 1, [2]);
    assert_eq!(actions(&mut s), [cancelled(1, 0)]);
}

#[test]
fn what_was_cancelled_may_be_assigned_again() {
    let mut s = loaded_ahead(2);
    s.message(ToWorker::Frame(frame(1, AT_ONCE)));
    assign(&mut s, 1, [0]);
    let first = tasks(&mut s)[0];
    cancel(&mut s, 1, [0]);
    assert_eq!(actions(&mut s), [Action::StopRendering(vec![first.name()]), cancelled(1, 1)]);
    s.message(ToWorker::Assign { frame: FrameId(1), attempt: Attempt(2), tiles: vec![TileId(0)] });
    let again = tasks(&mut s)[0];
    finish(&mut s, first);
    assert_eq!(actions(&mut s), [], "nobody waits for that attempt");
    finish(&mut s, again);
    let all = actions(&mut s);
    assert!(matches!(&all[1], Action::Return(batch) if batch.header.tiles[0].attempt == Attempt(2)));
}

#[test]
fn a_frame_that_has_ended_may_be_named_and_one_that_never_was_not() {
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(3, AT_ONCE)));
    s.message(ToWorker::EndFrame { frame: FrameId(3) });
    cancel(&mut s, 3, [0]);
    assert_eq!(actions(&mut s), []);
    for (id, tiles, code) in [
        (2, vec![0], AbortCode::Unexpected),
        (9, vec![0], AbortCode::Unexpected),
        (4, vec![], AbortCode::BadTiles),
        (4, vec![4], AbortCode::BadTiles),
    ] {
        let mut s = s.clone();
        s.message(ToWorker::Frame(frame(4, AT_ONCE)));
        cancel(&mut s, id, tiles);
        check_aborted(&mut s, code);
    }
}

#[test]
fn a_drained_worker_leaves_when_what_it_was_at_is_cancelled() {
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, AT_ONCE)));
    s.message(ToWorker::Frame(frame(2, AT_ONCE)));
    assign(&mut s, 1, 0..2);
    assign(&mut s, 2, 0..2);
    let begun = tasks(&mut s)[0];
    s.drain();
    cancel(&mut s, 1, [0]);
    assert_eq!(actions(&mut s), [Action::StopRendering(vec![begun.name()]), cancelled(1, 1)]);
    s.rendering_stopped(begun.name());
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)]);
}

/// Whatever comes in whatever order, each tile of a frame that goes to its end is in one `Rendered` or in one `Cancelled`, and those
/// in a `Rendered` come back unless they were cancelled after.
#[test]
fn every_tile_is_counted_once_for_every_seed() {
    let (mut stopped, mut too_late, mut dropped) = (0, 0, 0);
    for seed in 1..3000_u64 {
        let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        // Xorshift (Marsaglia 2003).
        let mut below = |bound: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            (random >> 11) % bound
        };
        let mut s = loaded_ahead(1 + below(3) as usize);
        let frames = 1 + below(3);
        for id in 1..=frames {
            let returns = [ReturnMode::AtEnd, AT_ONCE, ReturnMode::Batches { min_bytes: 40 }];
            s.message(ToWorker::Frame(frame(id, returns[below(3) as usize])));
        }
        let mut to_assign: Vec<_> = (1..=frames).flat_map(|id| (0..4).map(move |tile| (id, tile))).collect();
        let mut assigned = Vec::new();
        let (mut in_hand, mut to_stop) = (Vec::new(), Vec::new());
        let mut on_the_way = 0;
        let mut counted = BTreeMap::<u64, [u32; 2]>::new();
        let mut returned = Vec::new();
        loop {
            while let Some(action) = s.poll() {
                match action {
                    Action::Render(task) => in_hand.push(task),
                    Action::StopRendering(tiles) => to_stop.extend(tiles),
                    Action::Return(batch) => {
                        batch.header.check().expect("a batch");
                        returned.extend(tiles_of(&batch).into_iter().map(|t| (batch.header.frame.0, t)));
                        on_the_way += 1;
                    }
                    Action::Send(ToMaster::Rendered { frame, tiles }) => {
                        assert!(tiles > 0);
                        counted.entry(frame.0).or_default()[0] += tiles;
                    }
                    Action::Send(ToMaster::Cancelled { frame, tiles }) => {
                        counted.entry(frame.0).or_default()[1] += tiles;
                    }
                    other => panic!("seed {seed}: {other:?}"),
                }
            }
            let is_over = to_assign.is_empty() && in_hand.is_empty() && on_the_way == 0;
            if is_over {
                break;
            }
            match below(5) {
                0 if !to_assign.is_empty() => {
                    let (id, tile) = to_assign.swap_remove(below(to_assign.len() as u64) as usize);
                    assign(&mut s, id, [tile]);
                    assigned.push((id, tile));
                }
                1 if !in_hand.is_empty() => {
                    let task = in_hand.swap_remove(below(in_hand.len() as u64) as usize);
                    match to_stop.iter().position(|tile| *tile == task.name()) {
                        Some(place) if below(2) == 0 => {
                            s.rendering_stopped(to_stop.swap_remove(place));
                            stopped += 1;
                        }
                        place => {
                            too_late += u32::from(place.is_some());
                            finish(&mut s, task);
                        }
                    }
                }
                2 if on_the_way > 0 => {
                    on_the_way -= 1;
                    s.batch_sent();
                }
                3 if below(4) == 0 && !assigned.is_empty() => {
                    let (id, tile) = assigned[below(assigned.len() as u64) as usize];
                    cancel(&mut s, id, [tile]);
                }
                _ => {}
            }
        }
        for id in 1..=frames {
            let [rendered, cancelled] = counted[&id];
            assert_eq!(rendered + cancelled, 4, "seed {seed}: frame {id}");
            let mut back: Vec<_> = returned.iter().filter(|(of, _)| *of == id).collect();
            back.sort_unstable();
            back.dedup();
            assert!(back.len() as u32 <= rendered, "seed {seed}: frame {id}");
            dropped += rendered - back.len() as u32;
        }
        assert_eq!(s.rendering.len() + s.in_flight, 0);
    }
    assert!(stopped > 500 && too_late > 500 && dropped > 100, "{stopped}, {too_late}, {dropped}");
}
