//! Who may join. Pure: what a peer says and `now` go in, a decision comes out.

use std::{collections::VecDeque, time::Duration};
use tessera_wire::{Fingerprint, Hello, Refusal, Role, Token};

/// The tokens of a master, and whom they have let in. Times are counted from the master's start.
#[derive(Debug)]
pub(crate) struct Admission {
    /// Each lets in one local worker, by its index, bound to the certificate that came first.
    tickets: Vec<(Token, Option<Fingerprint>)>,
    open: Option<Open>,
}

/// A token for anyone who has it.
#[derive(Debug)]
struct Open {
    token: Token,
    until: Option<Duration>,
    /// Workers that have come in time, the latest last: they may come back later. Clients have nothing to come back to.
    known: VecDeque<Fingerprint>,
}

/// Who was let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admitted {
    /// The local worker with this index.
    Local(usize),
    /// A worker from anywhere.
    Worker,
    /// A client.
    Client,
}

impl Admission {
    /// Workers that are remembered beyond the token's time; the one that has not come for longest is forgotten first.
    const KNOWN: usize = 4096;

    /// Takes local workers only, each by its own token.
    pub(crate) fn local(tickets: Vec<Token>) -> Self {
        Self { tickets: tickets.into_iter().map(|token| (token, None)).collect(), open: None }
    }

    /// Takes workers and clients that show `token` before `until`; `None`: for ever.
    pub(crate) fn open(token: Token, until: Option<Duration>) -> Self {
        Self { tickets: Vec::new(), open: Some(Open { token, until, known: VecDeque::new() }) }
    }

    /// Decides about a peer with a certificate of this fingerprint, which has proven to be its own.
    pub(crate) fn admit(
        &mut self,
        hello: &Hello,
        identity: Fingerprint,
        now: Duration,
    ) -> Result<Admitted, Refusal> {
        if let Some(open) = self.open.as_mut().filter(|open| open.token == hello.token) {
            let admitted = match hello.role {
                Role::Worker(_) => Admitted::Worker,
                Role::Client => Admitted::Client,
            };
            open.admit(admitted, identity, now)?;
            return Ok(admitted);
        }
        let index = self.tickets.iter().position(|(token, _)| *token == hello.token).ok_or(Refusal::Token)?;
        if hello.role == Role::Client {
            return Err(Refusal::Role);
        }
        // A ticket is good for one.
        if *self.tickets[index].1.get_or_insert(identity) != identity {
            return Err(Refusal::Token);
        }
        Ok(Admitted::Local(index))
    }
}

impl Open {
    fn admit(&mut self, admitted: Admitted, identity: Fingerprint, now: Duration) -> Result<(), Refusal> {
        if admitted == Admitted::Worker
            && let Some(at) = self.known.iter().position(|&known| known == identity)
        {
            self.known.remove(at);
            self.known.push_back(identity);
            return Ok(());
        }
        if self.until.is_some_and(|until| now >= until) {
            return Err(Refusal::Expired);
        }
        if admitted != Admitted::Worker {
            return Ok(());
        }
        if self.known.len() == Admission::KNOWN {
            self.known.pop_front();
        }
        self.known.push_back(identity);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::Abilities;

    const RIGHT: Token = Token([1; 16]);
    const END: Duration = Duration::from_secs(3600);

    fn hello(token: Token) -> Hello {
        let abilities = Abilities {
            memory: 0,
            threads: 1,
            backend: "cpu".into(),
            numeric_class: "cpu-1".into(),
            speed: 0,
            note: String::new(),
        };
        Hello { versions: vec![4], token, name: "w".into(), role: Role::Worker(abilities) }
    }

    fn peer(number: u32) -> Fingerprint {
        let mut bytes = [0; 32];
        bytes[..4].copy_from_slice(&number.to_le_bytes());
        Fingerprint(bytes)
    }

    #[test]
    fn a_token_lets_in_any_number_until_its_end_and_those_back_in_later() {
        let mut door = Admission::open(RIGHT, Some(END));
        let before = END - Duration::from_nanos(1);
        for number in 0..5 {
            assert_eq!(door.admit(&hello(RIGHT), peer(number), before), Ok(Admitted::Worker));
        }
        assert_eq!(door.admit(&hello(RIGHT), peer(9), END), Err(Refusal::Expired));
        assert_eq!(door.admit(&hello(RIGHT), peer(3), END * 9), Ok(Admitted::Worker), "it is known");
        assert_eq!(
            door.admit(&hello(Token([2; 16])), peer(3), END),
            Err(Refusal::Token),
            "by its token only"
        );
        let client = Hello { role: Role::Client, ..hello(RIGHT) };
        assert_eq!(door.admit(&client, peer(7), before), Ok(Admitted::Client));
        assert_eq!(door.admit(&client, peer(7), END), Err(Refusal::Expired), "clients are not remembered");
        let mut for_ever = Admission::open(RIGHT, None);
        assert_eq!(for_ever.admit(&hello(RIGHT), peer(0), END * 1000), Ok(Admitted::Worker));
        assert_eq!(for_ever.admit(&hello(Token::default()), peer(0), END), Err(Refusal::Token));
    }

    #[test]
    fn the_known_are_bounded() {
        let mut door = Admission::open(RIGHT, Some(END));
        let most = Admission::KNOWN as u32;
        for number in 0..most {
            door.admit(&hello(RIGHT), peer(number), Duration::ZERO).unwrap();
        }
        let client = Hello { role: Role::Client, ..hello(RIGHT) };
        for number in 0..2 * most {
            door.admit(&client, peer(most + 1 + number), Duration::ZERO).unwrap();
        }
        // It is back, and was not away for longest any more.
        door.admit(&hello(RIGHT), peer(0), Duration::ZERO).unwrap();
        door.admit(&hello(RIGHT), peer(most), Duration::ZERO).unwrap();
        assert_eq!(door.open.as_ref().map(|open| open.known.len()), Some(Admission::KNOWN));
        assert_eq!(door.admit(&hello(RIGHT), peer(1), END), Err(Refusal::Expired), "it is forgotten");
        for number in [0, 2, most] {
            assert_eq!(door.admit(&hello(RIGHT), peer(number), END), Ok(Admitted::Worker), "{number}");
        }
    }

    #[test]
    fn a_ticket_is_good_for_one_worker() {
        let mut door = Admission::local(vec![RIGHT, Token([2; 16])]);
        assert_eq!(door.admit(&hello(Token([2; 16])), peer(5), END), Ok(Admitted::Local(1)));
        assert_eq!(door.admit(&hello(Token([2; 16])), peer(6), END), Err(Refusal::Token));
        assert_eq!(door.admit(&hello(Token([2; 16])), peer(5), END), Ok(Admitted::Local(1)));
        assert_eq!(door.admit(&hello(Token([3; 16])), peer(5), END), Err(Refusal::Token));
        let client = Hello { role: Role::Client, ..hello(RIGHT) };
        assert_eq!(door.admit(&client, peer(7), END), Err(Refusal::Role));
        assert_eq!(door.admit(&hello(RIGHT), peer(5), END), Ok(Admitted::Local(0)));
    }
}
