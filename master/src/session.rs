//! One worker as the master sees it: handshake, pack, leave. Pure: messages and `now` in, steps out.

use std::time::Duration;
use tessera_wire::{
    Abilities, AbortCode, FrameId, Hello, PackId, PackRefusal, Refusal, Role, ToMaster, ToWorker, Version,
    WorkerId, limits, plain_text,
};

/// State of one connection. Times are counted from the cluster's start.
#[derive(Debug)]
pub struct Session {
    worker: WorkerId,
    phase: Phase,
    deadline: Option<Duration>,
    /// Whether all pixels that the worker has ever sent are here.
    bulk_ended: bool,
}

#[derive(Debug)]
enum Phase {
    /// Nothing has come yet.
    Greeting,
    /// `Welcome` is sent.
    Joined { name: String, abilities: Abilities, holding: Holding, next: Option<(PackId, u64)> },
    /// It has said that it leaves; pixels are still under way.
    Leaving { name: String },
    /// Nothing is taken any more.
    Over,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Holding {
    Nothing,
    Rejected(PackRefusal),
    /// Offered; the worker has not said whether it has it.
    Offered(PackId),
    /// Being sent, or checked.
    Awaited(PackId),
    Held(PackId),
}

/// What follows from an input.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// A message for the worker.
    Send(ToWorker),
    /// The bytes of this pack are to be sent.
    SendPack(PackId),
    /// The worker has joined.
    Joined,
    /// It holds the pack.
    PackHeld,
    /// It cannot hold the pack.
    PackRejected(PackRefusal),
    /// It has rendered that many more tiles.
    Rendered {
        /// Of this frame.
        frame: FrameId,
        /// How many.
        tiles: u32,
    },
    /// Of the tiles that it was told to cancel, it will not render that many.
    Cancelled {
        /// Of this frame.
        frame: FrameId,
        /// How many.
        tiles: u32,
    },
    /// It leaves; what it has rendered may still come.
    Leaving,
    /// The session is over; after what was sent before, the connection is to be closed with this code.
    Over {
        /// QUIC's close code.
        code: AbortCode,
        /// For people.
        reason: String,
    },
}

impl Session {
    /// A connection that was made at `now`; the worker must say `Hello` soon.
    pub fn new(worker: WorkerId, now: Duration) -> Self {
        Self {
            worker,
            phase: Phase::Greeting,
            deadline: Some(now + limits::HANDSHAKE_TIMEOUT),
            bulk_ended: false,
        }
    }

    const LEFT: &str = "it left";

    /// When [`Session::tick`] has to be called at the latest.
    pub fn deadline(&self) -> Option<Duration> {
        self.deadline
    }

    /// The worker's name, once it has joined and until it is gone.
    pub fn name(&self) -> Option<&str> {
        match &self.phase {
            Phase::Joined { name, .. } | Phase::Leaving { name } => Some(name),
            Phase::Greeting | Phase::Over => None,
        }
    }

    /// What the worker says of itself, once it has joined and until it is gone.
    pub fn abilities(&self) -> Option<&Abilities> {
        match &self.phase {
            Phase::Joined { abilities, .. } => Some(abilities),
            Phase::Greeting | Phase::Leaving { .. } | Phase::Over => None,
        }
    }

    /// Whether the worker can render frames of `pack`.
    pub fn holds(&self, pack: PackId) -> bool {
        matches!(&self.phase, Phase::Joined { holding: Holding::Held(held), .. } if *held == pack)
    }

    /// Whether a pack is on offer and the worker has neither taken nor rejected it.
    pub fn awaits_pack(&self) -> bool {
        let on_offer = |holding: &Holding| matches!(holding, Holding::Offered(_) | Holding::Awaited(_));
        matches!(&self.phase, Phase::Joined { holding, .. } if on_offer(holding))
    }

    /// Whether the worker may still ask for the bytes of `pack`.
    pub fn awaits(&self, pack: PackId) -> bool {
        matches!(&self.phase, Phase::Joined { holding: Holding::Offered(p) | Holding::Awaited(p), .. } if *p == pack)
    }

    /// Why the worker does not hold the last pack on offer, if it has rejected it.
    pub fn rejection(&self) -> Option<&PackRefusal> {
        match &self.phase {
            Phase::Joined { holding: Holding::Rejected(reason), .. } => Some(reason),
            _ => None,
        }
    }

    /// Takes a message. `numeric_class` is the cluster's, if it is settled.
    pub fn message(&mut self, message: ToMaster, numeric_class: Option<&str>, now: Duration) -> Vec<Step> {
        let unexpected = |what: &str| (AbortCode::Unexpected, format!("{what} does not belong here"));
        let (code, detail) = match (&mut self.phase, message) {
            (Phase::Over | Phase::Leaving { .. }, _) => return Vec::new(),
            (Phase::Greeting, ToMaster::Hello(hello)) => return self.greet(hello, numeric_class),
            (_, ToMaster::Abort { code, detail }) => {
                return self.end(code, format!("it says: {code}: {}", plain_text(&detail)));
            }
            (Phase::Joined { name, .. }, ToMaster::Leave) if !self.bulk_ended => {
                self.phase = Phase::Leaving { name: std::mem::take(name) };
                self.deadline = Some(now + limits::IDLE_TIMEOUT);
                return vec![Step::Leaving];
            }
            (_, ToMaster::Leave) => return self.end(AbortCode::Done, Self::LEFT.into()),
            (Phase::Greeting, _) => unexpected("anything but `Hello`"),
            (Phase::Joined { holding, next, .. }, message) => match (&*holding, message) {
                (Holding::Offered(offered), ToMaster::PackNeed { pack, have }) if *offered == pack => {
                    *holding = Holding::Awaited(pack);
                    return if have { Vec::new() } else { vec![Step::SendPack(pack)] };
                }
                (Holding::Awaited(awaited), ToMaster::PackReady { pack }) if *awaited == pack => {
                    *holding = Holding::Held(pack);
                    let next = next.take();
                    return self.answered(Step::PackHeld, next, now);
                }
                (
                    Holding::Offered(awaited) | Holding::Awaited(awaited),
                    ToMaster::PackRejected { pack, reason },
                ) if *awaited == pack => {
                    let reason = reason.plain();
                    *holding = Holding::Rejected(reason.clone());
                    let next = next.take();
                    return self.answered(Step::PackRejected(reason), next, now);
                }
                // Pixels may overtake it, and the next pack may be on offer before it comes. The coordinator knows
                // which frames there were.
                (_, ToMaster::Rendered { frame, tiles }) => return vec![Step::Rendered { frame, tiles }],
                (_, ToMaster::Cancelled { frame, tiles }) => return vec![Step::Cancelled { frame, tiles }],
                (_, ToMaster::Hello(_)) => unexpected("a second `Hello`"),
                (_, _) => unexpected("an answer about a pack that is not on offer"),
            },
        };
        self.abort(code, detail)
    }

    /// Offers a pack of `length` bytes. Nothing happens if the worker has not joined, or holds it already. A worker in the middle of
    /// taking another one is offered it after that; one that has said that it has no room for it is not asked.
    pub fn offer(&mut self, pack: PackId, length: u64, now: Duration) -> Vec<Step> {
        let Phase::Joined { holding, next, abilities, .. } = &mut self.phase else { return Vec::new() };
        match holding {
            Holding::Held(held) if *held == pack => return vec![Step::PackHeld],
            Holding::Offered(other) | Holding::Awaited(other) => {
                *next = (*other != pack).then_some((pack, length));
                return Vec::new();
            }
            _ => {}
        }
        if abilities.memory > 0 && length > abilities.memory {
            let reason = PackRefusal::OutOfMemory { needs: length, has: abilities.memory };
            *holding = Holding::Rejected(reason.clone());
            return vec![Step::PackRejected(reason)];
        }
        *holding = Holding::Offered(pack);
        self.deadline = Some(now + limits::pack_timeout(length));
        vec![Step::Send(ToWorker::PackOffer { pack, length })]
    }

    /// Ends the session if a deadline has passed.
    pub fn tick(&mut self, now: Duration) -> Vec<Step> {
        if self.deadline.is_none_or(|deadline| now < deadline) {
            return Vec::new();
        }
        let what = match self.phase {
            Phase::Greeting => "no `Hello` came in time",
            Phase::Joined { .. } => "the pack was not taken in time",
            Phase::Leaving { .. } => return self.end(AbortCode::Done, Self::LEFT.into()),
            Phase::Over => return Vec::new(),
        };
        self.abort(AbortCode::Timeout, what.into())
    }

    /// The worker's bulk pipe is at its end: no more pixels come from it.
    pub fn bulk_ended(&mut self) -> Vec<Step> {
        self.bulk_ended = true;
        match self.phase {
            Phase::Leaving { .. } => self.end(AbortCode::Done, Self::LEFT.into()),
            _ => Vec::new(),
        }
    }

    /// Cuts the worker off.
    pub fn abort(&mut self, code: AbortCode, detail: String) -> Vec<Step> {
        if matches!(self.phase, Phase::Over) {
            return Vec::new();
        }
        let mut steps = vec![Step::Send(ToWorker::Abort { code, detail: detail.clone() })];
        steps.extend(self.end(code, format!("{code}: {detail}")));
        steps
    }

    /// Does not let the worker join.
    pub fn refuse(&mut self, refusal: Refusal) -> Vec<Step> {
        if !matches!(self.phase, Phase::Greeting) {
            return Vec::new();
        }
        let reason = refusal.to_string();
        let mut steps = vec![Step::Send(ToWorker::Refuse(refusal))];
        steps.extend(self.end(AbortCode::Refused, reason));
        steps
    }

    /// Sends the worker home.
    pub fn dismiss(&mut self) -> Vec<Step> {
        if matches!(self.phase, Phase::Over) {
            return Vec::new();
        }
        let mut steps = vec![Step::Send(ToWorker::Dismiss)];
        steps.extend(self.end(AbortCode::Done, "dismissed".into()));
        steps
    }

    /// The connection is gone, or must go; nothing can be said any more.
    pub fn end(&mut self, code: AbortCode, reason: String) -> Vec<Step> {
        if matches!(self.phase, Phase::Over) {
            return Vec::new();
        }
        let is_leaving = matches!(self.phase, Phase::Leaving { .. });
        self.phase = Phase::Over;
        self.deadline = None;
        let reason = if is_leaving { Self::LEFT.into() } else { reason };
        vec![Step::Over { code, reason }]
    }

    /// The worker has said what it does with a pack: the step for that, unless it is of yesterday and `next` is on offer.
    fn answered(&mut self, step: Step, next: Option<(PackId, u64)>, now: Duration) -> Vec<Step> {
        self.deadline = None;
        match next {
            Some((pack, length)) => self.offer(pack, length, now),
            None => vec![step],
        }
    }

    fn greet(&mut self, hello: Hello, numeric_class: Option<&str>) -> Vec<Step> {
        let refusal = match (hello.check(), Version::common(&hello.versions), hello.role) {
            (Err(detail), ..) => Refusal::Malformed { detail },
            (_, None, _) => Refusal::Version { supported: Version::supported_numbers() },
            (.., Role::Client) => Refusal::Role,
            (_, Some(version), Role::Worker(abilities)) => match numeric_class {
                Some(expected) if expected != abilities.numeric_class => {
                    Refusal::NumericClass { expected: expected.into() }
                }
                _ => {
                    let (name, holding) = (hello.name, Holding::Nothing);
                    self.phase = Phase::Joined { name, abilities, holding, next: None };
                    self.deadline = None;
                    let welcome = ToWorker::Welcome { version: version.number(), worker: self.worker };
                    return vec![Step::Send(welcome), Step::Joined];
                }
            },
        };
        self.refuse(refusal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::Token;

    const NOW: Duration = Duration::from_secs(100);
    const PACK: PackId = PackId([7; 32]);

    fn hello() -> Hello {
        hello_with(|_| ())
    }

    fn hello_with(change: impl FnOnce(&mut Abilities)) -> Hello {
        let mut abilities = Abilities {
            memory: 1 << 30,
            threads: 1,
            backend: "cpu".into(),
            numeric_class: "cpu-1".into(),
            speed: 0,
            note: String::new(),
        };
        change(&mut abilities);
        let role = Role::Worker(abilities);
        Hello { versions: vec![5], token: Token::default(), name: "w".into(), role }
    }

    fn joined() -> Session {
        let mut s = Session::new(WorkerId(3), NOW);
        let welcome = ToWorker::Welcome { version: 5, worker: WorkerId(3) };
        assert_eq!(
            s.message(ToMaster::Hello(hello()), Some("cpu-1"), NOW),
            [Step::Send(welcome), Step::Joined]
        );
        s
    }

    /// The session is over for `code`, and takes nothing any more.
    fn check_over(s: &mut Session, steps: &[Step], code: AbortCode) {
        assert!(matches!(steps.last(), Some(Step::Over { code: c, .. }) if *c == code), "{steps:?}");
        assert!(s.name().is_none() && s.abilities().is_none() && s.deadline().is_none());
        assert_eq!(s.message(ToMaster::Leave, None, NOW), []);
        assert_eq!(s.tick(NOW * 100), []);
        assert_eq!(s.dismiss(), []);
    }

    #[test]
    fn a_worker_joins_takes_a_pack_and_renders() {
        let mut s = joined();
        assert_eq!(s.offer(PACK, 10, NOW), [Step::Send(ToWorker::PackOffer { pack: PACK, length: 10 })]);
        assert_eq!(
            s.message(ToMaster::PackNeed { pack: PACK, have: false }, None, NOW),
            [Step::SendPack(PACK)]
        );
        assert!(!s.holds(PACK));
        assert_eq!(s.message(ToMaster::PackReady { pack: PACK }, None, NOW), [Step::PackHeld]);
        assert!(s.holds(PACK));
        assert_eq!(s.offer(PACK, 10, NOW), [Step::PackHeld], "no second transfer");
        let rendered = ToMaster::Rendered { frame: FrameId(1), tiles: 2 };
        assert_eq!(s.message(rendered.clone(), None, NOW), [Step::Rendered { frame: FrameId(1), tiles: 2 }]);
        // Its pixels have come before it, and the next pack is on offer.
        s.offer(PackId([8; 32]), 10, NOW);
        assert_eq!(s.message(rendered, None, NOW), [Step::Rendered { frame: FrameId(1), tiles: 2 }]);
        assert!(s.awaits_pack());
        let steps = s.dismiss();
        assert_eq!(steps[0], Step::Send(ToWorker::Dismiss));
        check_over(&mut s, &steps, AbortCode::Done);
    }

    #[test]
    fn refusals_have_their_reasons() {
        let check = |change: &dyn Fn(&mut Hello), class, refusal: Refusal| {
            let mut s = Session::new(WorkerId(0), NOW);
            let mut h = hello();
            change(&mut h);
            let steps = s.message(ToMaster::Hello(h), class, NOW);
            assert_eq!(steps[0], Step::Send(ToWorker::Refuse(refusal)));
            check_over(&mut s, &steps, AbortCode::Refused);
        };
        for other in [1, 2, 3, 4, 9] {
            check(&|h| h.versions = vec![other], None, Refusal::Version { supported: vec![5] });
        }
        check(&|h| h.role = Role::Client, None, Refusal::Role);
        check(&|_| (), Some("gpu-1"), Refusal::NumericClass { expected: "gpu-1".into() });
        check(
            &|h| *h = hello_with(|a| a.threads = 0),
            None,
            Refusal::Malformed { detail: "0 threads".into() },
        );
        let texts = "name must have 1 to 512 bytes and no control characters";
        check(&|h| h.name = "\x1b[2J".into(), None, Refusal::Malformed { detail: texts.into() });
        check(&|h| h.name = String::new(), None, Refusal::Malformed { detail: texts.into() });
        let texts = "note must have 1 to 512 bytes and no control characters";
        let noted = |note: &str| hello_with(|a| a.note = note.into());
        check(&|h| *h = noted("x\ny"), None, Refusal::Malformed { detail: texts.into() });
        let many = "17 versions, at most 16 are allowed";
        check(&|h| h.versions = vec![5; 17], None, Refusal::Malformed { detail: many.into() });
    }

    #[test]
    fn silence_has_a_deadline() {
        let mut s = Session::new(WorkerId(0), NOW);
        assert_eq!(s.tick(NOW), []);
        let steps = s.tick(s.deadline().unwrap());
        check_over(&mut s, &steps, AbortCode::Timeout);

        let mut s = joined();
        assert_eq!(s.deadline(), None, "a quiet worker between packs is nobody's business but QUIC's");
        assert_eq!(s.offer(PACK, 1 << 30, NOW).len(), 1);
        assert!(s.deadline().unwrap() > NOW + Duration::from_secs(1000), "a large pack takes its time");
        let steps = s.tick(s.deadline().unwrap());
        check_over(&mut s, &steps, AbortCode::Timeout);
    }

    #[test]
    fn what_the_state_does_not_allow_ends_the_session() {
        let other = PackId([8; 32]);
        let wrong = [
            ToMaster::Hello(hello()),
            ToMaster::PackReady { pack: PACK },
            ToMaster::PackNeed { pack: other, have: true },
            ToMaster::PackRejected { pack: other, reason: PackRefusal::Transfer { detail: "x".into() } },
        ];
        for message in wrong {
            let mut s = joined();
            s.offer(PACK, 10, NOW);
            let steps = s.message(message, None, NOW);
            assert!(matches!(steps[0], Step::Send(ToWorker::Abort { code: AbortCode::Unexpected, .. })));
            check_over(&mut s, &steps, AbortCode::Unexpected);
        }
        let mut s = Session::new(WorkerId(0), NOW);
        let steps = s.message(ToMaster::Rendered { frame: FrameId(1), tiles: 1 }, None, NOW);
        check_over(&mut s, &steps, AbortCode::Unexpected);
    }

    #[test]
    fn a_rejected_pack_leaves_the_worker_in_the_session() {
        let mut s = joined();
        s.offer(PACK, 10, NOW);
        let reason = PackRefusal::OutOfMemory { needs: 10, has: 5 };
        assert_eq!(
            s.message(ToMaster::PackRejected { pack: PACK, reason: reason.clone() }, None, NOW),
            [Step::PackRejected(reason)]
        );
        assert!(s.name().is_some() && !s.holds(PACK) && !s.awaits_pack() && s.deadline().is_none());
        // Its words go to logs and to clients.
        let mut forger = joined();
        forger.offer(PACK, 10, NOW);
        let reason = |detail: &str| PackRefusal::Invalid { detail: detail.into() };
        let forged = ToMaster::PackRejected { pack: PACK, reason: reason("x\nforged\u{2028}\u{202e}") };
        assert_eq!(forger.message(forged, None, NOW), [Step::PackRejected(reason("xforged"))]);
        assert!(matches!(s.offer(PackId([1; 32]), 4, NOW)[..], [Step::Send(ToWorker::PackOffer { .. })]));
    }

    #[test]
    fn a_pack_that_cannot_fit_is_not_offered() {
        let mut s = joined();
        let (needs, has) = ((1 << 30) + 1, 1 << 30);
        let rejected = Step::PackRejected(PackRefusal::OutOfMemory { needs, has });
        assert_eq!(s.offer(PACK, needs, NOW), [rejected]);
        assert_eq!(s.rejection(), Some(&PackRefusal::OutOfMemory { needs, has }));
        assert!(s.name().is_some() && !s.awaits_pack() && s.deadline().is_none());
        let mut s = Session::new(WorkerId(0), NOW);
        s.message(ToMaster::Hello(hello_with(|a| a.memory = 0)), None, NOW);
        let offer = ToWorker::PackOffer { pack: PACK, length: 1 << 40 };
        assert_eq!(s.offer(PACK, 1 << 40, NOW), [Step::Send(offer)], "one that does not know is asked");
    }

    #[test]
    fn a_worker_that_leaves_is_there_until_its_pixels_are() {
        let left = [Step::Over { code: AbortCode::Done, reason: "it left".into() }];
        let leaving = || {
            let mut s = joined();
            assert_eq!(s.message(ToMaster::Leave, None, NOW), [Step::Leaving]);
            assert!(s.name().is_some() && s.abilities().is_none() && !s.holds(PACK));
            assert_eq!(s.offer(PACK, 10, NOW), []);
            s
        };
        let mut s = leaving();
        assert_eq!(s.bulk_ended(), left);
        check_over(&mut s, &left, AbortCode::Done);
        let mut s = leaving();
        assert_eq!(s.tick(NOW + limits::IDLE_TIMEOUT), left, "they do not come");
        let mut s = leaving();
        assert_eq!(s.end(AbortCode::Done, "the connection is lost".into()), left);
        // The pipes are not ordered among each other.
        let mut s = joined();
        assert_eq!(s.bulk_ended(), []);
        assert_eq!(s.message(ToMaster::Leave, None, NOW), left);
        let mut s = Session::new(WorkerId(0), NOW);
        assert_eq!(s.message(ToMaster::Leave, None, NOW), left, "nothing can come from it");
    }

    #[test]
    fn a_worker_s_own_abort_ends_the_session_with_its_words() {
        let mut s = joined();
        let abort = ToMaster::Abort { code: AbortCode::Internal, detail: "render\n\x07panic".into() };
        let steps = s.message(abort, None, NOW);
        let reason = "it says: internal failure: renderpanic".into();
        assert_eq!(steps, [Step::Over { code: AbortCode::Internal, reason }]);
    }
}
