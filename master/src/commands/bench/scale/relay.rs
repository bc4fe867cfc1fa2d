//! `tessera bench relay`: a process between workers and their master that treats their packets as a [`Medium`] does.
//!
//! Threads and blocking sockets, not timers of a runtime: those have a grain of a millisecond, and a packet's place on a fast link is a matter
//! of microseconds. One ordered queue a direction, one thread that empties it: tasks of their own would let packets overtake each other.

use super::link::LinkProfile;
use super::medium::{Counters, Direction, Medium};
use crate::commands::CommandError;
use clap::Args;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::io::{self, BufRead, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Workers that it relays for; packets of more are dropped.
const PEERS_MAX: usize = tessera_wire::limits::WORKERS;

/// Bytes that are on their way at a time in each direction, whatever the profile: more are dropped as if the queue were full.
const TRAVELLING_BYTES_MAX: usize = 256 << 20;

/// Kernel buffers of each socket: as many bytes as may come before a thread has its turn on a busy machine.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// A packet that is due so soon is sent now: half of what a thread's sleep is late by.
const EARLY: Duration = Duration::from_micros(50);

/// What to relay; started by `tessera bench` itself.
#[derive(Debug, Args)]
pub struct RelayArgs {
    /// The link, by its name or its file
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "profile", required_unless_present = "profile")]
    link: Option<String>,
    /// The link, as the text of its file
    #[arg(long, value_name = "TOML")]
    profile: Option<String>,
    /// Where the master is
    #[arg(long, value_name = "ADDRESS")]
    upstream: SocketAddr,
}

/// What became of the packets, as the process says it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RelayReport {
    /// From the workers.
    pub up: Counters,
    /// To them.
    pub down: Counters,
    /// Workers that were seen.
    pub peers: u64,
    /// Packets of workers beyond the limit, and those beyond what may be on its way.
    pub refused: u64,
    /// How much later than the link says a packet was sent on: on average, and at most.
    pub late_us_mean: f64,
    /// At most.
    pub late_us_max: f64,
}

/// Prints the address at which it listens, then a report for each line on standard input and one at its end, which ends it.
pub fn run(args: &RelayArgs) -> Result<(), CommandError> {
    let profile = match (&args.profile, &args.link) {
        (Some(text), _) => LinkProfile::parse(text, "--profile"),
        (None, Some(link)) => LinkProfile::find(link),
        (None, None) => Err("no link".into()),
    };
    let profile = profile.map_err(CommandError::Usage)?;
    let relay = Relay::start(&profile, args.upstream)
        .map_err(|e| CommandError::Failed(format!("the relay cannot start: {e}")))?;
    let mut out = io::stdout().lock();
    let mut say = |line: String| writeln!(out, "{line}").and_then(|()| out.flush());
    // Who has gone away is told nothing.
    if say(relay.address.to_string()).is_err() {
        return Ok(());
    }
    for line in io::stdin().lock().lines() {
        let text = serde_json::to_string(&relay.report()).map_err(CommandError::failed)?;
        if line.is_err() || say(text).is_err() {
            return Ok(());
        }
    }
    let text = serde_json::to_string(&relay.report()).map_err(CommandError::failed)?;
    let _ = say(text);
    Ok(())
}

/// A running relay; its threads end with the process.
struct Relay {
    address: SocketAddr,
    shared: Arc<Shared>,
}

struct Shared {
    begun: Instant,
    medium: Mutex<Medium>,
    ways: [Way; 2],
    peers: AtomicU64,
    refused: AtomicU64,
}

/// Packets that travel in one direction.
#[derive(Default)]
struct Way {
    travelling: Mutex<Travelling>,
    /// The next one is due earlier than the one before was.
    earlier: Condvar,
}

#[derive(Default)]
struct Travelling {
    /// The next to arrive first.
    packets: BinaryHeap<Reverse<Packet>>,
    bytes: usize,
    /// Counts packets, to keep the order of those that are due together.
    count: u64,
    delivered: u64,
    late: Duration,
    late_max: Duration,
}

struct Packet {
    due: Duration,
    number: u64,
    bytes: Vec<u8>,
    socket: Arc<UdpSocket>,
    /// `None`: to whom the socket is connected.
    to: Option<SocketAddr>,
}

impl PartialEq for Packet {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Packet {}

impl PartialOrd for Packet {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Packet {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.due, self.number).cmp(&(other.due, other.number))
    }
}

impl Relay {
    /// Listens on loopback and sends on to `upstream`.
    fn start(profile: &LinkProfile, upstream: SocketAddr) -> io::Result<Self> {
        let front = Arc::new(open_socket(upstream)?);
        let address = front.local_addr()?;
        let shared = Arc::new(Shared {
            begun: Instant::now(),
            medium: Mutex::new(Medium::new(profile)),
            ways: Default::default(),
            peers: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        });
        for direction in [Direction::Up, Direction::Down] {
            let shared = shared.clone();
            spawn("deliver", move || shared.deliver(direction))?;
        }
        let mine = shared.clone();
        spawn("up", move || listen(&mine, &front, upstream))?;
        Ok(Self { address, shared })
    }

    fn report(&self) -> RelayReport {
        let medium = lock(&self.shared.medium);
        let (up, down) = (medium.counters(Direction::Up), medium.counters(Direction::Down));
        drop(medium);
        let (mut delivered, mut late, mut late_max) = (0, Duration::ZERO, Duration::ZERO);
        for way in &self.shared.ways {
            let travelling = lock(&way.travelling);
            delivered += travelling.delivered;
            late += travelling.late;
            late_max = late_max.max(travelling.late_max);
        }
        RelayReport {
            up,
            down,
            peers: self.shared.peers.load(Ordering::Relaxed),
            refused: self.shared.refused.load(Ordering::Relaxed),
            late_us_mean: late.as_secs_f64() * 1e6 / (delivered.max(1) as f64),
            late_us_max: late_max.as_secs_f64() * 1e6,
        }
    }
}

impl Shared {
    /// Puts a packet that has come on the medium, and on its way if it is not lost.
    fn send(
        &self,
        direction: Direction,
        peer: u32,
        bytes: &[u8],
        socket: &Arc<UdpSocket>,
        to: Option<SocketAddr>,
    ) {
        // The clock is read under the lock: packets come to the medium in the order of their times.
        let mut medium = lock(&self.medium);
        let due = medium.send(self.begun.elapsed(), direction, peer, bytes.len());
        drop(medium);
        let Some(due) = due else { return };
        let way = &self.ways[direction as usize];
        let mut travelling = lock(&way.travelling);
        if travelling.bytes + bytes.len() > TRAVELLING_BYTES_MAX {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        travelling.bytes += bytes.len();
        travelling.count += 1;
        let number = travelling.count;
        let is_next = travelling.packets.peek().is_none_or(|next| due < next.0.due);
        let packet = Packet { due, number, bytes: bytes.to_vec(), socket: socket.clone(), to };
        travelling.packets.push(Reverse(packet));
        if is_next {
            way.earlier.notify_one();
        }
    }

    /// Sends packets on when they are due, for ever.
    fn deliver(&self, direction: Direction) {
        let way = &self.ways[direction as usize];
        let mut due = Vec::new();
        let mut travelling = lock(&way.travelling);
        loop {
            // Take what is due, or wait for it.
            let now = self.begun.elapsed();
            while let Some(next) = travelling.packets.peek()
                && next.0.due <= now + EARLY
                && let Some(Reverse(packet)) = travelling.packets.pop()
            {
                let late = now.saturating_sub(packet.due);
                travelling.bytes -= packet.bytes.len();
                travelling.delivered += 1;
                travelling.late += late;
                travelling.late_max = travelling.late_max.max(late);
                due.push(packet);
            }
            if due.is_empty() {
                travelling = match travelling.packets.peek().map(|next| next.0.due.saturating_sub(now)) {
                    Some(left) => {
                        let waited = way.earlier.wait_timeout(travelling, left);
                        waited.unwrap_or_else(PoisonError::into_inner).0
                    }
                    None => way.earlier.wait(travelling).unwrap_or_else(PoisonError::into_inner),
                };
                continue;
            }
            // Send it without the lock.
            drop(travelling);
            for packet in due.drain(..) {
                // A receiver that is gone, or whose buffer is full, loses it, as on any network.
                let _ = match packet.to {
                    Some(to) => packet.socket.send_to(&packet.bytes, to),
                    None => packet.socket.send(&packet.bytes),
                };
            }
            travelling = lock(&way.travelling);
        }
    }
}

/// Takes packets of workers, for ever. Each worker has a socket of its own towards the master, who so sees as many addresses as workers.
fn listen(shared: &Arc<Shared>, front: &Arc<UdpSocket>, upstream: SocketAddr) {
    let mut peers: HashMap<SocketAddr, (u32, Arc<UdpSocket>)> = HashMap::new();
    let mut bytes = vec![0; 64 << 10];
    loop {
        let Ok((length, from)) = front.recv_from(&mut bytes) else { continue };
        if !peers.contains_key(&from) {
            let number = peers.len() as u32;
            match (peers.len() < PEERS_MAX).then(|| meet(shared, front, from, upstream, number)) {
                Some(Ok(socket)) => {
                    peers.insert(from, (number, socket));
                    shared.peers.fetch_add(1, Ordering::Relaxed);
                }
                Some(Err(_)) | None => {
                    shared.refused.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
            }
        }
        if let Some((number, socket)) = peers.get(&from) {
            shared.send(Direction::Up, *number, &bytes[..length], socket, None);
        }
    }
}

/// A socket for a worker that has come, and a thread that takes what the master sends there.
fn meet(
    shared: &Arc<Shared>,
    front: &Arc<UdpSocket>,
    worker: SocketAddr,
    upstream: SocketAddr,
    number: u32,
) -> io::Result<Arc<UdpSocket>> {
    let socket = Arc::new(open_socket(upstream)?);
    socket.connect(upstream)?;
    let (shared, front, mine) = (shared.clone(), front.clone(), socket.clone());
    spawn("down", move || {
        let mut bytes = vec![0; 64 << 10];
        loop {
            match mine.recv(&mut bytes) {
                Ok(length) => {
                    shared.send(Direction::Down, number, &bytes[..length], &front, Some(worker));
                }
                // Nobody listens there, or not any more; each packet that was sent tells it once.
                Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(_) => return,
            }
        }
    })?;
    Ok(socket)
}

/// A socket on loopback, of the family that `upstream` has, with large buffers where the system gives them.
fn open_socket(upstream: SocketAddr) -> io::Result<UdpSocket> {
    let any: SocketAddr = match upstream {
        SocketAddr::V4(_) => (Ipv4Addr::LOCALHOST, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::LOCALHOST, 0).into(),
    };
    let socket = UdpSocket::bind(any)?;
    let _ = rustix::net::sockopt::set_socket_recv_buffer_size(&socket, SOCKET_BUFFER_BYTES);
    let _ = rustix::net::sockopt::set_socket_send_buffer_size(&socket, SOCKET_BUFFER_BYTES);
    Ok(socket)
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
    thread::Builder::new().name(name.into()).stack_size(256 << 10).spawn(work).map(|_| ())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
