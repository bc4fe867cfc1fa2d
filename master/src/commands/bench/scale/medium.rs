//! What becomes of a packet on a link: the whole emulation, without a clock or a socket.

use super::link::{Duplex, LinkProfile};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Bytes of the medium's time that a packet takes besides its UDP payload: headers of IPv4 and UDP.
pub const HEADER_BYTES: usize = 28;

/// Which way a packet goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From a worker to the master.
    Up,
    /// From the master to a worker.
    Down,
}

/// A link that all workers of a master share.
///
/// One packet is on the medium at a time (in each direction, with full duplex), in the order in which packets come, whoever sends them:
/// that is a token bucket without depth. A packet waits until it is free, takes its length by the rate, `packet_us`, and `burst_ms` if its
/// peer and direction have had nothing there for `burst_gap_ms`; then it travels for the latency and its jitter, but overtakes none before it of
/// its peer and direction. What is lost has taken its time all the same.
///
/// (A radio's stations contend, and each has a queue of its own; here they stand in one line.)
///
/// The same calls with the same seed have the same outcome, and what is random in one peer's packets does not depend on others'.
#[derive(Clone, Debug)]
pub struct Medium {
    ways: [Way; 2],
    /// When it is free, in each direction; with half duplex the first counts for both.
    free: [Duration; 2],
    is_half: bool,
    latency: Duration,
    jitter: Duration,
    loss: f64,
    packet: Duration,
    burst: Duration,
    burst_gap: Duration,
    queue_bytes: usize,
    mtu: usize,
    seed: u64,
    /// The latest that it was told.
    now: Duration,
}

/// One direction.
#[derive(Clone, Debug, Default)]
struct Way {
    /// Nanoseconds a byte.
    byte_ns: f64,
    /// When each packet that waits will have left, and its bytes.
    waiting: VecDeque<(Duration, usize)>,
    waiting_bytes: usize,
    peers: BTreeMap<u32, Peer>,
    counters: Counters,
}

/// What was of one peer in one direction.
#[derive(Clone, Debug, Default)]
struct Peer {
    packets: u64,
    /// When its last packet leaves, or has left, the medium.
    left: Option<Duration>,
    /// When the last one arrives.
    arrives: Duration,
}

/// What became of the packets of one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// All of them.
    pub packets: u64,
    /// Their UDP payload.
    pub bytes: u64,
    /// Those that paid for a burst.
    pub bursts: u64,
    /// Lost at random.
    pub lost: u64,
    /// Dropped because the queue was full.
    pub overflowed: u64,
    /// Dropped because they were too large.
    pub too_large: u64,
}

impl Medium {
    /// A link of that kind on which nothing was sent yet.
    pub fn new(profile: &LinkProfile) -> Self {
        let ms = |ms: f64| Duration::from_secs_f64(ms * 1e-3);
        let way =
            |mbit: Option<f64>| Way { byte_ns: mbit.map_or(0.0, |mbit| 8000.0 / mbit), ..Way::default() };
        Self {
            ways: [way(profile.mbit_up), way(profile.mbit_down)],
            free: [Duration::ZERO; 2],
            is_half: profile.duplex == Duplex::Half,
            latency: ms(profile.latency_ms),
            jitter: ms(profile.jitter_ms),
            loss: profile.loss,
            packet: ms(profile.packet_us * 1e-3),
            burst: ms(profile.burst_ms),
            burst_gap: ms(profile.burst_gap_ms),
            queue_bytes: profile.queue_kib as usize * 1024,
            mtu: profile.mtu as usize,
            seed: profile.seed,
            now: Duration::ZERO,
        }
    }

    /// Sends a packet of `bytes` of UDP payload from or to `peer`, and says when it arrives, if it does. `now` does not go back; an earlier
    /// one counts as the latest.
    pub fn send(&mut self, now: Duration, direction: Direction, peer: u32, bytes: usize) -> Option<Duration> {
        self.now = self.now.max(now);
        let now = self.now;
        let way = &mut self.ways[direction as usize];
        way.counters.packets += 1;
        way.counters.bytes += bytes as u64;

        // Drop what does not fit.
        if bytes > self.mtu {
            way.counters.too_large += 1;
            return None;
        }
        way.let_go(now);
        if way.waiting_bytes > 0 && way.waiting_bytes + bytes > self.queue_bytes {
            way.counters.overflowed += 1;
            return None;
        }

        // Wait for the medium, and take it.
        let state = way.peers.entry(peer).or_default();
        let mut takes =
            self.packet + Duration::from_nanos(((bytes + HEADER_BYTES) as f64 * way.byte_ns) as u64);
        if !self.burst.is_zero() && state.left.is_none_or(|left| now > left + self.burst_gap) {
            takes += self.burst;
            way.counters.bursts += 1;
        }
        let free = &mut self.free[if self.is_half { 0 } else { direction as usize }];
        let leaves = now.max(*free) + takes;
        *free = leaves;
        state.left = Some(leaves);
        way.waiting.push_back((leaves, bytes));
        way.waiting_bytes += bytes;

        // Lose it, or let it travel.
        let (luck, delay) = draws(self.seed, direction, peer, state.packets);
        state.packets += 1;
        if luck < self.loss {
            way.counters.lost += 1;
            return None;
        }
        state.arrives = state.arrives.max(leaves + self.latency + self.jitter.mul_f64(delay));
        Some(state.arrives)
    }

    /// What became of the packets of one direction so far.
    pub fn counters(&self, direction: Direction) -> Counters {
        self.ways[direction as usize].counters
    }
}

impl Way {
    /// Forgets those that have left the queue at `now`.
    fn let_go(&mut self, now: Duration) {
        while let Some(&(leaves, bytes)) = self.waiting.front()
            && leaves <= now
        {
            self.waiting.pop_front();
            self.waiting_bytes -= bytes;
        }
    }
}

/// Two numbers of [0, 1) for a packet, by its own number, so that no other peer's packets change them.
fn draws(seed: u64, direction: Direction, peer: u32, packet: u64) -> (f64, f64) {
    let stream = mix(seed ^ mix(u64::from(peer) << 1 | direction as u64));
    let first = mix(stream.wrapping_add(packet.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
    let unit = |bits: u64| (bits >> 11) as f64 / (1u64 << 53) as f64;
    (unit(first), unit(mix(first)))
}

/// The finaliser of SplitMix64 (Steele, Lea, Flood 2014), one step on, so that 0 is not mapped to itself.
fn mix(bits: u64) -> u64 {
    let bits = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ bits >> 31
}

#[cfg(test)]
mod tests {
    use super::*;
    use Direction::{Down, Up};

    /// 8 Mbit/s, a microsecond a byte, and nothing else.
    fn plain() -> LinkProfile {
        LinkProfile {
            name: "x".into(),
            source: "a test".into(),
            mbit_up: Some(8.0),
            mbit_down: Some(8.0),
            duplex: Duplex::Full,
            latency_ms: 0.0,
            jitter_ms: 0.0,
            loss: 0.0,
            packet_us: 0.0,
            burst_ms: 0.0,
            burst_gap_ms: 0.0,
            queue_kib: 1024,
            mtu: 1472,
            seed: 7,
        }
    }

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn all_peers_of_a_direction_share_its_rate() {
        let mut medium = Medium::new(&plain());
        let arrivals: Vec<_> = (0..4).map(|peer| medium.send(us(5), Up, peer % 2, 972)).collect();
        assert_eq!(arrivals, [1005, 2005, 3005, 4005].map(|t| Some(us(t))));
        // The other direction is free; this one too, later.
        assert_eq!(medium.send(us(5), Down, 0, 972), Some(us(1005)));
        assert_eq!(medium.send(us(9000), Up, 0, 972), Some(us(10_000)));
    }

    #[test]
    fn half_duplex_is_one_medium_for_both_directions() {
        let mut medium = Medium::new(&LinkProfile { duplex: Duplex::Half, ..plain() });
        assert_eq!(medium.send(us(0), Up, 0, 972), Some(us(1000)));
        assert_eq!(medium.send(us(0), Down, 1, 972), Some(us(2000)));
        assert_eq!(medium.send(us(0), Up, 1, 472), Some(us(2500)));
    }

    #[test]
    fn latency_and_the_cost_of_a_packet_come_on_top() {
        let profile = LinkProfile { latency_ms: 3.0, packet_us: 250.0, mbit_down: None, ..plain() };
        let mut medium = Medium::new(&profile);
        assert_eq!(medium.send(us(0), Up, 0, 972), Some(us(4250)));
        assert_eq!(medium.send(us(0), Down, 0, 972), Some(us(3250)), "no limit of the rate");
        assert_eq!(medium.send(us(0), Down, 0, 1), Some(us(3500)), "packets cost all the same");
    }

    #[test]
    fn the_first_packet_after_a_silence_pays_for_a_burst() {
        let profile = LinkProfile { burst_ms: 2.0, burst_gap_ms: 5.0, ..plain() };
        let mut medium = Medium::new(&profile);
        assert_eq!(medium.send(us(0), Up, 0, 972), Some(us(3000)));
        assert_eq!(medium.send(us(0), Up, 0, 972), Some(us(4000)), "the same burst");
        assert_eq!(medium.send(us(0), Up, 1, 972), Some(us(7000)), "another peer");
        assert_eq!(medium.send(us(0), Down, 0, 972), Some(us(3000)), "another direction");
        // Silence counts from the end of what was sent.
        assert_eq!(medium.send(us(9000), Up, 0, 972), Some(us(10_000)));
        assert_eq!(medium.send(us(15_001), Up, 0, 972), Some(us(18_001)));
        assert_eq!((medium.counters(Up).bursts, medium.counters(Down).bursts), (3, 1));
    }

    #[test]
    fn what_is_too_large_or_finds_the_queue_full_is_dropped() {
        let mut medium = Medium::new(&LinkProfile { queue_kib: 8, ..plain() });
        assert_eq!(medium.send(us(0), Up, 0, 1473), None);
        let sent = (0..20).filter(|_| medium.send(us(0), Up, 0, 1024).is_some()).count();
        assert_eq!(sent, 8);
        // One has left: one has room.
        assert!(medium.send(us(1052), Up, 1, 1024).is_some() && medium.send(us(1052), Up, 1, 1024).is_none());
        assert!(medium.send(us(0), Down, 0, 1024).is_some(), "each direction has its own");
        let counters = medium.counters(Up);
        assert_eq!(
            (counters.packets, counters.too_large, counters.overflowed, counters.lost),
            (23, 1, 13, 0)
        );
    }

    #[test]
    fn jitter_keeps_the_order_of_a_peer_and_stays_within_its_bound() {
        let profile = LinkProfile { jitter_ms: 20.0, latency_ms: 1.0, mbit_up: None, ..plain() };
        let mut medium = Medium::new(&profile);
        let mut last = [Duration::ZERO; 3];
        let mut spread = [Duration::MAX, Duration::ZERO];
        for i in 0..3000u64 {
            let (now, peer) = (us(i * 100), (i % 3) as u32);
            let arrives = medium.send(now, Up, peer, 100).expect("nothing is lost");
            assert!(arrives >= last[peer as usize], "packet {i} overtakes");
            last[peer as usize] = arrives;
            let took = arrives - now;
            assert!(took >= us(1000) && took <= us(21_000), "packet {i} takes {took:?}");
            spread = [spread[0].min(took), spread[1].max(took)];
        }
        assert!(spread[1] - spread[0] > us(5000), "{spread:?}");
    }

    #[test]
    fn losses_have_their_share_and_follow_the_seed_alone() {
        let lost = |seed, others: bool| {
            let mut medium = Medium::new(&LinkProfile { loss: 0.01, mbit_up: None, seed, ..plain() });
            let mut lost = Vec::new();
            for i in 0..20_000u64 {
                if medium.send(us(i), Up, 3, 100).is_none() {
                    lost.push(i);
                }
                if others {
                    medium.send(us(i), Up, 4, 100);
                    medium.send(us(i), Down, 3, 100);
                }
            }
            assert!(medium.counters(Up).lost >= lost.len() as u64);
            lost
        };
        let first = lost(1, false);
        // 200 are expected, and 14 is their standard deviation.
        assert!((130..270).contains(&first.len()), "{}", first.len());
        assert_eq!(first, lost(1, true), "others change nothing");
        assert_ne!(first, lost(2, false));
    }
}
