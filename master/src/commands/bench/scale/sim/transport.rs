//! What QUIC does with messages, as far as it matters to their time: packets, windows, acknowledgements, and what is lost sent again.

use crate::commands::bench::scale::link::LinkProfile;
use crate::commands::bench::scale::medium::{Direction, Medium};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Which of a connection's streams in a direction; each is ordered in itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stream {
    Control,
    Bulk,
}

/// A packet under way.
#[derive(Clone, Debug)]
pub struct Packet {
    pub number: u64,
    pub parts: Vec<Part>,
    bytes: usize,
    /// Data packets that came the other way before it was sent.
    acknowledges: u64,
}

/// Bytes of a message in a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    pub stream: Stream,
    /// Which message of the stream.
    pub message: u64,
    pub bytes: usize,
}

/// What is to happen later to a connection, in one direction.
#[derive(Clone, Debug)]
pub enum Later {
    /// A packet arrives.
    Arrives(Packet),
    /// An acknowledgement that waits for company goes.
    Acknowledge(u64),
    /// A packet that was lost is noticed.
    Missed(Packet),
}

/// One direction of a connection.
#[derive(Debug)]
pub struct Way {
    direction: Direction,
    peer: u32,
    /// Messages that wait, by stream: number, bytes left.
    waiting: BTreeMap<Stream, VecDeque<(u64, usize)>>,
    /// Messages of each stream that were put in, and that have come.
    put: BTreeMap<Stream, u64>,
    arriving: BTreeMap<Stream, BTreeMap<u64, (usize, usize)>>,
    come: BTreeMap<Stream, u64>,
    window: f64,
    in_flight: usize,
    sent: BTreeMap<u64, usize>,
    next: u64,
    acked: u64,
    /// Data packets that have come and are not acknowledged.
    unacknowledged: u64,
    received: u64,
    pub bytes: u64,
    round_trip: Duration,
    payload: usize,
}

impl Way {
    /// Header, packet number, tag, and a stream frame's header.
    const OVERHEAD: usize = 40;

    /// A packet that only acknowledges.
    const ACKNOWLEDGEMENT: usize = 45;

    /// Packets that are acknowledged together, and how long one waits for another (RFC 9000, 13.2.1 and 18.2).
    const TOGETHER: u64 = 2;
    pub const ACK_DELAY: Duration = Duration::from_millis(2);

    /// Bytes that may be under way before any was acknowledged: what the transport is set to.
    const FIRST_WINDOW: f64 = 1_048_576.0;

    pub fn new(link: &LinkProfile, direction: Direction, peer: u32) -> Self {
        let round_trip = Duration::from_secs_f64(2e-3 * link.latency_ms);
        Self {
            direction,
            peer,
            waiting: BTreeMap::new(),
            put: BTreeMap::new(),
            arriving: BTreeMap::new(),
            come: BTreeMap::new(),
            window: Self::FIRST_WINDOW,
            in_flight: 0,
            sent: BTreeMap::new(),
            next: 0,
            acked: 0,
            unacknowledged: 0,
            received: 0,
            bytes: 0,
            round_trip,
            payload: (link.mtu as usize).min(usize::from(tessera_wire::limits::UDP_PAYLOAD_BYTES))
                - Self::OVERHEAD,
        }
    }

    /// Puts a message of `bytes` on a stream; its number there.
    pub fn put(&mut self, stream: Stream, bytes: usize) -> u64 {
        let put = self.put.entry(stream).or_default();
        let number = *put;
        *put += 1;
        self.waiting.entry(stream).or_default().push_back((number, bytes.max(1)));
        self.arriving.entry(stream).or_default().insert(number, (0, bytes.max(1)));
        number
    }

    /// Sends what the window lets go; `other` is the other direction of the connection, whose packets it acknowledges along the way.
    pub fn send(&mut self, other: &mut Self, medium: &mut Medium, now: Duration) -> Vec<(Duration, Later)> {
        let mut later = Vec::new();
        while self.waiting.values().any(|queue| !queue.is_empty())
            && (self.in_flight == 0 || (self.in_flight as f64) < self.window)
        {
            let mut parts = Vec::new();
            let mut room = self.payload;
            for (&stream, queue) in &mut self.waiting {
                while room > 0
                    && let Some((number, left)) = queue.front_mut()
                {
                    let bytes = room.min(*left);
                    parts.push(Part { stream, message: *number, bytes });
                    room -= bytes;
                    *left -= bytes;
                    if *left == 0 {
                        queue.pop_front();
                    }
                }
            }
            let bytes = self.payload - room + Self::OVERHEAD;
            let packet = Packet { number: self.next, parts, bytes, acknowledges: other.received };
            self.next += 1;
            other.unacknowledged = 0;
            self.launch(packet, medium, now, &mut later);
        }
        later
    }

    /// A packet of the other direction has come: what this one does about it.
    pub fn acknowledge(
        &mut self,
        other: &mut Self,
        medium: &mut Medium,
        now: Duration,
    ) -> Vec<(Duration, Later)> {
        let mut later = Vec::new();
        if other.unacknowledged >= Self::TOGETHER {
            other.unacknowledged = 0;
            let bytes = Self::ACKNOWLEDGEMENT;
            let packet = Packet { number: u64::MAX, parts: Vec::new(), bytes, acknowledges: other.received };
            self.launch(packet, medium, now, &mut later);
        } else if other.unacknowledged > 0 {
            later.push((now + Self::ACK_DELAY, Later::Acknowledge(other.received)));
        }
        later
    }

    /// The time of an acknowledgement that waited is over; it goes unless something has taken it along.
    pub fn acknowledge_late(
        &mut self,
        other: &mut Self,
        received: u64,
        medium: &mut Medium,
        now: Duration,
    ) -> Vec<(Duration, Later)> {
        let mut later = Vec::new();
        if other.unacknowledged > 0 && other.received == received {
            other.unacknowledged = 0;
            let bytes = Self::ACKNOWLEDGEMENT;
            let packet = Packet { number: u64::MAX, parts: Vec::new(), bytes, acknowledges: received };
            self.launch(packet, medium, now, &mut later);
        }
        later
    }

    /// Takes a packet of this direction in: the messages that are complete now, in order, and what it acknowledges in the `other`.
    pub fn arrive(&mut self, packet: &Packet, other: &mut Self) -> Vec<(Stream, u64)> {
        if packet.number != u64::MAX {
            self.unacknowledged += 1;
            self.received += 1;
        }
        other.acknowledged(packet.acknowledges);
        let mut complete = Vec::new();
        for part in &packet.parts {
            let arriving = self.arriving.entry(part.stream).or_default();
            if let Some((come, _)) = arriving.get_mut(&part.message) {
                *come += part.bytes;
            }
            let next = self.come.entry(part.stream).or_default();
            while arriving.get(next).is_some_and(|(come, bytes)| come >= bytes) {
                arriving.remove(next);
                complete.push((part.stream, *next));
                *next += 1;
            }
        }
        complete
    }

    /// What was lost is sent again, and the window is halved (as far as any controller does).
    pub fn resend(&mut self, packet: Packet, medium: &mut Medium, now: Duration) -> Vec<(Duration, Later)> {
        let mut later = Vec::new();
        if let Some(bytes) = self.sent.remove(&packet.number) {
            self.in_flight -= bytes;
        }
        self.window = (0.7 * self.window).max(10.0 * self.payload as f64);
        let packet = Packet { number: self.next, ..packet };
        self.next += 1;
        self.launch(packet, medium, now, &mut later);
        later
    }

    /// So many packets of this direction have come in all: those sent first are taken for them.
    fn acknowledged(&mut self, received: u64) {
        while self.acked < received {
            self.acked += 1;
            let Some((_, bytes)) = self.sent.pop_first() else { break };
            self.in_flight -= bytes;
            self.window =
                (self.window + bytes as f64).min(f64::from(tessera_wire::limits::CONNECTION_WINDOW_BYTES));
        }
    }

    fn launch(
        &mut self,
        packet: Packet,
        medium: &mut Medium,
        now: Duration,
        later: &mut Vec<(Duration, Later)>,
    ) {
        self.bytes += packet.bytes as u64;
        let is_data = packet.number != u64::MAX;
        if is_data {
            self.in_flight += packet.bytes;
            self.sent.insert(packet.number, packet.bytes);
        }
        match medium.send(now, self.direction, self.peer, packet.bytes) {
            Some(at) => later.push((at, Later::Arrives(packet))),
            // Noticed by what comes after it, a round trip and an eighth later (RFC 9002, 6.1.2), or by nothing for as long again.
            None if is_data => {
                let after = self.round_trip.mul_f64(2.0).max(Duration::from_millis(2));
                later.push((now + after, Later::Missed(packet)));
            }
            None => {}
        }
    }
}
