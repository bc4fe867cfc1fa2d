//! A session from outside: messages in, actions out.

use super::*;
use tessera_wire::{Abilities, Camera, Features, PixelFormat, Role, Token, WorkerId};

const PACK: PackId = PackId([7; 32]);

fn hello() -> Hello {
    Hello {
        versions: Version::supported_numbers(),
        token: Token::default(),
        name: "w".into(),
        role: Role::Worker(Abilities {
            memory: 0,
            threads: 1,
            backend: "cpu".into(),
            numeric_class: "cpu-1".into(),
            speed: 0,
            note: String::new(),
        }),
    }
}

fn frame(id: u64, returns: ReturnMode) -> Frame {
    Frame {
        frame: FrameId(id),
        pack: PACK,
        camera: Camera {
            origin: [0.0; 3],
            forward: [0.0, 0.0, -1.0],
            right: [1.0, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
        },
        width: 4,
        height: 4,
        tile: 2,
        samples: 1,
        sampling: Default::default(),
        depth: 0,
        seed: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
        returns,
        coding: tessera_wire::Coding::Raw,
    }
}

fn actions(s: &mut Session) -> Vec<Action> {
    std::iter::from_fn(|| s.poll()).collect()
}

fn joined(memory: Option<u64>) -> Session {
    joined_ahead(memory, 1)
}

fn joined_ahead(memory: Option<u64>, ahead: usize) -> Session {
    let mut s = Session::start(hello(), memory, ahead, Duration::ZERO);
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::Hello(hello()))]);
    s.message(ToWorker::Welcome { version: 5, worker: WorkerId(0) });
    assert_eq!((actions(&mut s), s.deadline()), (vec![], None));
    s
}

fn loaded() -> Session {
    loaded_ahead(1)
}

fn loaded_ahead(ahead: usize) -> Session {
    let mut s = joined_ahead(None, ahead);
    s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
    assert_eq!(actions(&mut s), [Action::Receive { pack: PACK, length: 5 }]);
    s.pack_reserved(PACK, Ok(()));
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackNeed { pack: PACK, have: false })]);
    s.pack_received(PACK, Ok(()));
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackReady { pack: PACK })]);
    s
}

fn assign(s: &mut Session, id: u64, tiles: impl IntoIterator<Item = u32>) {
    let tiles = tiles.into_iter().map(TileId).collect();
    s.message(ToWorker::Assign { frame: FrameId(id), attempt: Attempt(0), tiles });
}

/// Renders everything that is asked for; what was said and returned, in order: `r` for `Rendered`, a
/// number for a batch of so many tiles.
fn run(s: &mut Session) -> String {
    let mut log = String::new();
    while let Some(action) = s.poll() {
        match action {
            Action::Render(task) => {
                let pixels = vec![0; (task.rect.width * task.rect.height * 4) as usize];
                let time = Duration::from_millis(1);
                s.rendered(RenderedTile::new(task, pixels, time, Rays::default()));
            }
            Action::Send(ToMaster::Rendered { .. }) => log.push('r'),
            Action::Return(batch) => {
                batch.header.check().unwrap();
                log += &batch.pixels.len().to_string();
                s.batch_sent();
            }
            other => panic!("{other:?}"),
        }
    }
    log
}

fn check_aborted(s: &mut Session, code: AbortCode) {
    let all = actions(s);
    let (over, abort) = (all.last(), &all[all.len() - 2]);
    assert!(matches!(over, Some(Action::Over(Ending::Aborted { code: c, .. })) if *c == code), "{all:?}");
    assert!(matches!(abort, Action::Send(ToMaster::Abort { code: c, .. }) if *c == code), "{all:?}");
    s.message(ToWorker::Dismiss);
    s.leave();
    assert_eq!(actions(s), []);
}

#[test]
fn tiles_return_as_the_frame_asks() {
    let check = |returns, expected| {
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, returns)));
        assign(&mut s, 1, 0..4);
        assert_eq!(run(&mut s), expected);
    };
    check(ReturnMode::AtEnd, "r4");
    check(ReturnMode::Batches { min_bytes: 0 }, "r1r1r1r1");
    check(ReturnMode::Batches { min_bytes: 32 }, "rr2rr2");
    check(ReturnMode::Batches { min_bytes: 33 }, "rrr3r1");
}

#[test]
fn rendering_waits_for_a_slow_transport() {
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 0 })));
    assign(&mut s, 1, 0..4);
    let mut renders = 0;
    let mut returns = 0;
    while let Some(action) = s.poll() {
        match action {
            Action::Render(task) => {
                renders += 1;
                let rays = Rays::default();
                s.rendered(RenderedTile::new(task, vec![0; 16], Duration::ZERO, rays));
            }
            Action::Return(_) => returns += 1,
            _ => {}
        }
    }
    assert_eq!((renders, returns), (2, limits::BATCHES_IN_FLIGHT));
    s.batch_sent();
    assert!(matches!(actions(&mut s)[..], [Action::Render(_)]));
}

#[test]
fn the_end_of_a_frame_drops_what_is_left_of_it() {
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    assign(&mut s, 1, 0..4);
    let Some(Action::Render(task)) = s.poll() else { panic!("nothing to render") };
    s.message(ToWorker::EndFrame { frame: FrameId(1) });
    s.message(ToWorker::Frame(frame(2, ReturnMode::AtEnd)));
    assign(&mut s, 2, [3]);
    assert_eq!(actions(&mut s), [Action::StopRendering(vec![task.name()])], "the renderer is still busy");
    // It may have been finished before it was stopped.
    let mut finished = s.clone();
    let (time, rays) = (Duration::ZERO, Rays::default());
    finished.rendered(RenderedTile::new(task, vec![0; 16], time, rays));
    assert_eq!(run(&mut finished), "r1");
    s.rendering_stopped(task.name());
    assert_eq!(run(&mut s), "r1");
    s.message(ToWorker::EndFrame { frame: FrameId(2) });
    assert_eq!(actions(&mut s), [], "nothing is being rendered");
}

#[test]
fn a_drained_worker_returns_the_tile_in_hand_and_what_it_has_kept_and_leaves() {
    let leaves = [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)];
    let finish = |s: &mut Session, task| {
        let (time, rays) = (Duration::ZERO, Rays::default());
        s.rendered(RenderedTile::new(task, vec![0; 16], time, rays));
    };
    for returns in [ReturnMode::AtEnd, ReturnMode::Batches { min_bytes: 1000 }] {
        let mut s = loaded();
        s.message(ToWorker::Frame(frame(1, returns)));
        assign(&mut s, 1, 0..4);
        let Some(Action::Render(first)) = s.poll() else { panic!("nothing to render") };
        finish(&mut s, first);
        let mut all = actions(&mut s);
        let Some(Action::Render(second)) = all.pop() else { panic!("nothing to render") };
        s.drain();
        assign(&mut s, 1, [3]);
        assert_eq!(actions(&mut s), [], "it is at a tile");
        finish(&mut s, second);
        let mut all = actions(&mut s);
        let Some(Action::Return(batch)) = all.pop() else { panic!("nothing returned: {all:?}") };
        assert_eq!(batch.header.tiles.iter().map(|t| t.tile.0).collect::<Vec<_>>(), [0, 1]);
        assert!(matches!(all[..], [Action::Send(ToMaster::Rendered { .. })]), "{all:?}");
        s.batch_sent();
        assert_eq!(actions(&mut s), leaves);
    }
    // Nothing is being rendered, as the transport does not keep up; something is kept for the next batch.
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 17 })));
    assign(&mut s, 1, [0]);
    let Some(Action::Render(task)) = s.poll() else { panic!("nothing to render") };
    s.in_flight = limits::BATCHES_IN_FLIGHT;
    assign(&mut s, 1, [1]);
    finish(&mut s, task);
    assert!(matches!(actions(&mut s)[..], [Action::Send(ToMaster::Rendered { tiles: 1, .. })]));
    s.drain();
    assert!(matches!(&actions(&mut s)[..], [Action::Return(batch)] if batch.pixels.len() == 1));
    for _ in 0..limits::BATCHES_IN_FLIGHT {
        s.batch_sent();
        assert_eq!(actions(&mut s), []);
    }
    s.batch_sent();
    assert_eq!(actions(&mut s), leaves);

    let mut s = loaded();
    s.drain();
    assert_eq!(actions(&mut s), leaves, "it has no work");
    let mut s = Session::start(hello(), None, 1, Duration::ZERO);
    actions(&mut s);
    s.drain();
    assert_eq!(actions(&mut s), leaves, "it has not even joined");
}

/// The tiles that are to be rendered now, which must be all there is to do.
fn tasks(s: &mut Session) -> Vec<RenderTask> {
    let task = |action| match action {
        Action::Render(task) => task,
        other => panic!("{other:?}"),
    };
    actions(s).into_iter().map(task).collect()
}

fn finish(s: &mut Session, task: RenderTask) {
    let (time, rays) = (Duration::ZERO, Rays::default());
    s.rendered(RenderedTile::new(task, vec![0; 16], time, rays));
}

fn tiles_of(batch: &Batch) -> Vec<u32> {
    batch.header.tiles.iter().map(|entry| entry.tile.0).collect()
}

#[test]
fn tiles_rendered_ahead_return_once_each_in_whatever_order_they_are_finished() {
    for returns in [ReturnMode::AtEnd, ReturnMode::Batches { min_bytes: 1000 }] {
        let mut s = loaded_ahead(3);
        s.message(ToWorker::Frame(frame(1, returns)));
        assign(&mut s, 1, 0..4);
        let first = tasks(&mut s);
        assert_eq!(first.iter().map(|t| t.tile.0).collect::<Vec<_>>(), [0, 1, 2], "three at once");
        // The last one begun is the first one finished; then the fourth begins.
        finish(&mut s, first[2]);
        let mut all = actions(&mut s);
        let Some(Action::Render(fourth)) = all.pop() else { panic!("{all:?}") };
        assert_eq!(fourth.tile, TileId(3));
        // Nothing waits in the list, yet the list has not ended: nothing goes.
        finish(&mut s, first[0]);
        finish(&mut s, fourth);
        assert!(!actions(&mut s).iter().any(|a| matches!(a, Action::Return(_) | Action::Render(_))));
        finish(&mut s, first[1]);
        let mut all = actions(&mut s);
        let Some(Action::Return(batch)) = all.pop() else { panic!("{all:?}") };
        assert_eq!(tiles_of(&batch), [2, 0, 3, 1]);
        batch.header.check().expect("a batch");
    }
    // At once, one by one.
    let mut s = loaded_ahead(3);
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 0 })));
    assign(&mut s, 1, 0..4);
    assert_eq!(run(&mut s), "r1r1r1r1");
}

#[test]
fn a_slow_transport_holds_what_is_not_begun() {
    let mut s = loaded_ahead(2);
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 0 })));
    assign(&mut s, 1, 0..4);
    let begun = tasks(&mut s);
    assert_eq!(begun.len(), 2);
    finish(&mut s, begun[0]);
    // One on its way: another may begin.
    let Some(Action::Render(third)) = actions(&mut s).pop() else { panic!("it keeps up") };
    finish(&mut s, begun[1]);
    finish(&mut s, third);
    let all = actions(&mut s);
    assert_eq!(all.iter().filter(|a| matches!(a, Action::Return(_))).count(), 2);
    assert!(!all.iter().any(|a| matches!(a, Action::Render(_))), "three are on their way: {all:?}");
    s.batch_sent();
    assert_eq!(actions(&mut s), [], "two are");
    s.batch_sent();
    assert_eq!(tasks(&mut s).len(), 1);
}

#[test]
fn the_end_of_a_frame_stops_all_that_is_rendered_ahead() {
    let mut s = loaded_ahead(3);
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    assign(&mut s, 1, 0..4);
    let old = tasks(&mut s);
    s.message(ToWorker::EndFrame { frame: FrameId(1) });
    assert_eq!(actions(&mut s), [Action::StopRendering(old.iter().map(RenderTask::name).collect())]);
    s.message(ToWorker::Frame(frame(2, ReturnMode::AtEnd)));
    assign(&mut s, 2, 0..4);
    assert_eq!(actions(&mut s), [], "the renderer has as many as it may");
    // One is stopped, one was finished before it was, and each makes room for one of the new frame.
    s.rendering_stopped(old[0].name());
    let first = tasks(&mut s);
    finish(&mut s, old[2]);
    let second = tasks(&mut s);
    assert_eq!([first[0].tile, second[0].tile], [TileId(0), TileId(1)]);
    // The old frame's last one does not keep the new frame from ending.
    finish(&mut s, first[0]);
    let third = tasks(&mut s);
    finish(&mut s, second[0]);
    let fourth = tasks(&mut s);
    finish(&mut s, third[0]);
    finish(&mut s, fourth[0]);
    let mut all = actions(&mut s);
    assert!(matches!(all.pop(), Some(Action::Return(batch)) if tiles_of(&batch) == [0, 1, 2, 3]));
    s.rendering_stopped(old[1].name());
    s.batch_sent();
    assert_eq!(actions(&mut s), []);
    s.message(ToWorker::EndFrame { frame: FrameId(2) });
    assert_eq!(actions(&mut s), [], "nothing is being rendered");
}

#[test]
fn a_drained_worker_returns_all_tiles_in_hand() {
    let mut s = loaded_ahead(2);
    s.message(ToWorker::Frame(frame(1, ReturnMode::Batches { min_bytes: 0 })));
    assign(&mut s, 1, 0..4);
    let begun = tasks(&mut s);
    s.drain();
    assert_eq!(actions(&mut s), [], "it is at two tiles");
    finish(&mut s, begun[1]);
    finish(&mut s, begun[0]);
    // Said and returned together: the list has ended with the last tile in hand.
    let returned: Vec<_> = actions(&mut s)
        .iter()
        .filter_map(|a| if let Action::Return(batch) = a { Some(tiles_of(batch)) } else { None })
        .collect();
    assert_eq!(returned, [[1], [0]]);
    s.batch_sent();
    assert_eq!(actions(&mut s), [], "one is on its way");
    s.batch_sent();
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)]);
}

#[test]
fn packs_are_refused_kept_and_replaced() {
    let mut s = joined(Some(100));
    s.message(ToWorker::PackOffer { pack: PACK, length: 101 });
    let reason = PackRefusal::OutOfMemory { needs: 101, has: 100 };
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
    let mut s = joined(None);
    s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
    actions(&mut s);
    let reason = PackRefusal::OutOfMemory { needs: 5, has: 0 };
    s.pack_reserved(PACK, Err(reason.clone()));
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
    let mut s = joined(None);
    s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
    actions(&mut s);
    s.pack_found(PACK);
    let have = Action::Send(ToMaster::PackNeed { pack: PACK, have: true });
    assert_eq!(actions(&mut s), [have, Action::Send(ToMaster::PackReady { pack: PACK })]);
    let mut s = joined(None);
    s.message(ToWorker::PackOffer { pack: PACK, length: u64::MAX });
    assert!(matches!(actions(&mut s)[..], [Action::Send(ToMaster::PackRejected { .. })]));

    let mut s = loaded();
    s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
    let have = Action::Send(ToMaster::PackNeed { pack: PACK, have: true });
    assert_eq!(actions(&mut s), [have, Action::Send(ToMaster::PackReady { pack: PACK })]);
    let other = PackId([1; 32]);
    s.message(ToWorker::PackOffer { pack: other, length: 5 });
    actions(&mut s);
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    check_aborted(&mut s, AbortCode::BadFrame);

    let mut s = joined(None);
    s.message(ToWorker::PackOffer { pack: PACK, length: 5 });
    s.pack_reserved(PACK, Ok(()));
    actions(&mut s);
    let reason = PackRefusal::HashMismatch { got: other };
    s.pack_received(PACK, Err(reason.clone()));
    assert_eq!(actions(&mut s), [Action::Send(ToMaster::PackRejected { pack: PACK, reason })]);
}

#[test]
fn what_the_state_does_not_allow_ends_the_session() {
    let end = ToWorker::EndFrame { frame: FrameId(1) };
    let tiles = |list: &[u32]| ToWorker::Assign {
        frame: FrameId(1),
        attempt: Attempt(0),
        tiles: list.iter().copied().map(TileId).collect(),
    };
    let check = |s: Session, messages: &[ToWorker], code| {
        let mut s = s;
        messages.iter().for_each(|m| s.message(m.clone()));
        check_aborted(&mut s, code);
    };
    let first = ToWorker::Frame(frame(1, ReturnMode::AtEnd));
    let welcome = |version| ToWorker::Welcome { version, worker: WorkerId(0) };
    let new = || Session::start(hello(), None, 1, Duration::ZERO);
    check(new(), std::slice::from_ref(&end), AbortCode::Unexpected);
    check(new(), &[welcome(1)], AbortCode::Unexpected);
    check(new(), &[welcome(9)], AbortCode::Unexpected);
    check(joined(None), &[welcome(2)], AbortCode::Unexpected);
    let refusal = Refusal::NumericClass { expected: "gpu-1".into() };
    check(joined(None), &[ToWorker::Refuse(refusal)], AbortCode::Unexpected);
    check(joined(None), std::slice::from_ref(&first), AbortCode::BadFrame);
    check(loaded(), &[end], AbortCode::Unexpected);
    check(loaded(), &[tiles(&[0])], AbortCode::Unexpected);
    check(loaded(), &[first.clone(), first.clone()], AbortCode::Unexpected);
    check(loaded(), &[first.clone(), tiles(&[])], AbortCode::BadTiles);
    check(loaded(), &[first.clone(), tiles(&[4])], AbortCode::BadTiles);
    check(loaded(), &[first.clone(), tiles(&[0, 1, 2, 3, 0])], AbortCode::BadTiles);
    let offer = ToWorker::PackOffer { pack: PACK, length: 1 };
    check(loaded(), &[first, offer], AbortCode::Unexpected);
    let mut wild = frame(1, ReturnMode::AtEnd);
    wild.camera.forward[0] = f32::NAN;
    check(loaded(), &[ToWorker::Frame(wild)], AbortCode::BadFrame);
}

#[test]
fn endings() {
    let mut s = Session::start(hello(), None, 1, Duration::ZERO);
    actions(&mut s);
    s.tick(limits::HANDSHAKE_TIMEOUT - Duration::from_nanos(1));
    assert_eq!(actions(&mut s), []);
    s.tick(limits::HANDSHAKE_TIMEOUT);
    check_aborted(&mut s, AbortCode::Timeout);

    let mut s = Session::start(hello(), None, 1, Duration::ZERO);
    actions(&mut s);
    let refusal = Refusal::Version { supported: vec![9] };
    s.message(ToWorker::Refuse(refusal.clone()));
    assert_eq!(actions(&mut s), [Action::Over(Ending::Refused(refusal))]);

    let mut s = loaded();
    s.message(ToWorker::Dismiss);
    assert_eq!(actions(&mut s), [Action::Over(Ending::Dismissed)]);

    let leaves = [Action::Send(ToMaster::Leave), Action::Over(Ending::Left)];
    let mut s = loaded();
    s.leave();
    assert_eq!(actions(&mut s), leaves);

    // The second tile takes too long: the first is not thrown away.
    let mut s = loaded();
    s.message(ToWorker::Frame(frame(1, ReturnMode::AtEnd)));
    assign(&mut s, 1, [0, 1]);
    let Some(Action::Render(first)) = s.poll() else { panic!("nothing to render") };
    let (time, rays) = (Duration::ZERO, Rays::default());
    s.rendered(RenderedTile::new(first, vec![0; 16], time, rays));
    assert!(matches!(actions(&mut s)[..], [Action::Render(_)]));
    s.drain();
    assert_eq!(actions(&mut s), []);
    s.leave();
    let last = actions(&mut s);
    let [Action::Send(ToMaster::Rendered { tiles: 1, .. }), Action::Return(batch), rest @ ..] = &last[..]
    else {
        panic!("{last:?}")
    };
    assert!(batch.header.tiles[0].tile == first.tile && *rest == leaves);
}

mod frames;
