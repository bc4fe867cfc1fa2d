//! `tessera bench link`: what the transport of frames gets out of an emulated link, beside what the link has to give.

use super::link::LinkProfile;
use super::medium::Direction::{self, Down, Up};
use super::medium::Medium;
use super::relay::RelayReport;
use super::relay_process::RelayProcess;
use crate::commands::progress::Progress;
use crate::commands::run::runtime;
use crate::commands::{CommandError, print_text};
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tessera_master::LinkProbe;
use tessera_trust::Identity;
use tessera_worker::{Closer, Connected, WorkerPipes};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{sleep, timeout};

/// Peers that send at once.
const PEERS: u32 = 16;

/// Bytes of a message that goes there and back.
const MESSAGE_BYTES: usize = 64;

/// Messages, of which the median counts.
const MESSAGES: usize = 40;

/// A tile of 128 x 128 pixels, RGBA8.
const TILE_BYTES: usize = 64 << 10;

/// Tiles one after the other, of which the median counts.
const TILES: usize = 20;

/// What each of the peers sends of a picture of 1024 x 1024.
const SHARE_BYTES: usize = 256 << 10;

/// Pictures, of which the median counts.
const PICTURES: usize = 9;

/// Between tiles and pictures: longer than a radio's burst.
const PAUSE: Duration = Duration::from_millis(20);

/// After a connection is made, until it has found out how large packets may be.
const SETTLING: Duration = Duration::from_secs(1);

/// What a long transfer takes on a link that does what it promises.
const TRANSFER: Duration = Duration::from_secs(1);

/// Bytes of a long transfer: at least, and where the link has no limit.
const TRANSFER_BYTES: std::ops::RangeInclusive<u64> = 1 << 20..=64 << 20;

/// A peer that takes so long for one transfer has lost its way.
const PATIENCE: Duration = Duration::from_secs(60);

/// Which links.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  tessera bench link\n  tessera bench link --link lan100\n  tessera bench link --link my.toml --json"
)]
pub struct LinkArgs {
    /// A built-in link, a file of one, or `all` built-in ones
    #[arg(long, value_name = "NAME|FILE|all", default_value = "all")]
    link: String,
    /// Print one JSON object a link
    #[arg(long)]
    pub json: bool,
}

/// What a link was measured to give, and what it has to give: a figure of the link alone, every packet sent as soon as it lets it.
#[derive(Clone, Debug, Serialize)]
struct Line {
    link: String,
    source: String,
    round_trip_ms: Pair,
    /// From an idle link until a tile's 64 KiB have come.
    tile_ms: Pair,
    /// The same for 16 peers' 256 KiB, sent at once.
    picture_ms: Pair,
    /// Megabits of pixels a second in a long transfer of one peer.
    up_mbit_1: Pair,
    /// The same of 16 at once.
    up_mbit_16: Pair,
    /// Of a long transfer from the master to one peer, as of a pack.
    down_mbit: Pair,
    /// What the relay did, unless there was none.
    relay: Option<RelayReport>,
}

/// Measured and promised.
#[derive(Clone, Copy, Debug, Serialize)]
struct Pair {
    measured: f64,
    /// `None`: the link has no limit.
    promised: Option<f64>,
}

pub fn run(args: &LinkArgs, progress: &Progress) -> Result<(), CommandError> {
    let profiles = match args.link.as_str() {
        "all" => LinkProfile::built_in(),
        link => LinkProfile::find(link).map(|profile| vec![profile]),
    };
    let profiles = profiles.map_err(|reason| CommandError::Usage(format!("--link {reason}")))?;
    let mut lines = Vec::new();
    for profile in &profiles {
        let _bar = progress.step(format!("measuring {}", profile.name));
        let runtime = runtime()?;
        lines.push(runtime.block_on(measure(profile)).map_err(CommandError::Failed)?);
    }
    if args.json { super::super::print_lines(&lines) } else { print_text(&table(&lines)) }
}

fn table(lines: &[Line]) -> String {
    let mut text = String::from(
        "through     round trip ms     a tile ms         a picture ms      1 up Mbit/s       16 up Mbit/s      down Mbit/s\n",
    );
    for line in lines {
        let _ = write!(text, "{:<11}", line.link);
        let pairs = [
            line.round_trip_ms,
            line.tile_ms,
            line.picture_ms,
            line.up_mbit_1,
            line.up_mbit_16,
            line.down_mbit,
        ];
        for Pair { measured, promised } in pairs {
            let promised = promised.map_or("-".into(), |promised| format!("{promised:.1}"));
            let _ = write!(text, " {:<17}", format!("{measured:.1} of {promised}"));
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text + "\nEach: measured, of what the link alone would give. A tile is 64 KiB from one peer, a picture 256 KiB from each of 16 at once.\n"
}

/// A peer that has joined the probe.
struct Peer {
    pipes: WorkerPipes,
    _closer: Closer,
}

/// Measures the transport over one link.
async fn measure(profile: &LinkProfile) -> Result<Line, String> {
    let mut probe = LinkProbe::open().map_err(|e| e.to_string())?;
    let mut relay = match profile.is_straight() {
        true => None,
        false => Some(RelayProcess::start(profile, probe.address()).map_err(|e| format!("no relay: {e}"))?),
    };
    let address = relay.as_ref().map_or(probe.address(), RelayProcess::address);
    let mut peers = vec![join(&probe, address).await?];
    sleep(SETTLING).await;
    let round_trip = round_trips(&mut peers[0]).await?;
    let tile = transfers(&mut peers, TILES, TILE_BYTES, &mut probe).await?;
    for _ in 1..PEERS {
        peers.push(join(&probe, address).await?);
    }
    sleep(SETTLING).await;
    let picture = transfers(&mut peers, PICTURES, SHARE_BYTES, &mut probe).await?;
    let (bytes, down_bytes) = (long(profile.mbit_up), long(profile.mbit_down));
    let down = fetch(&mut peers[0], down_bytes, &mut probe).await?;
    let one = transfer(&mut peers[..1], bytes, &mut probe).await?;
    let all = transfer(&mut peers, bytes / PEERS as usize, &mut probe).await?;

    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let mbit = |bytes: usize, time: Duration| bytes as f64 * 8e-6 / time.as_secs_f64();
    let is_straight = profile.is_straight();
    let times =
        |measured, promised| Pair { measured: ms(measured), promised: (!is_straight).then(|| ms(promised)) };
    let rates = |bytes, measured, promised| Pair {
        measured: mbit(bytes, measured),
        promised: (!is_straight).then(|| mbit(bytes, promised)),
    };
    Ok(Line {
        link: profile.name.clone(),
        source: profile.source.clone(),
        round_trip_ms: times(round_trip, promised_round_trip(profile)),
        tile_ms: times(tile, promised(profile, Up, 1, TILE_BYTES)),
        picture_ms: times(picture, promised(profile, Up, PEERS, SHARE_BYTES)),
        up_mbit_1: rates(bytes, one, promised(profile, Up, 1, bytes)),
        up_mbit_16: rates(bytes, all, promised(profile, Up, PEERS, bytes / PEERS as usize)),
        down_mbit: rates(down_bytes, down, promised(profile, Down, 1, down_bytes)),
        relay: match &mut relay {
            Some(relay) => Some(relay.report().map_err(|e| e.to_string())?),
            None => None,
        },
    })
}

/// A peer that has joined at `address`.
async fn join(probe: &LinkProbe, address: SocketAddr) -> Result<Peer, String> {
    let own = Identity::new().map_err(|e| e.to_string())?;
    let connected = tessera_worker::connect(&probe.join_at(address), &own).await;
    let Connected { pipes, closer } = connected.map_err(|e| e.to_string())?;
    Ok(Peer { pipes, _closer: closer })
}

/// The median time of `count` transfers, each of an idle link.
async fn transfers(
    peers: &mut [Peer],
    count: usize,
    bytes: usize,
    probe: &mut LinkProbe,
) -> Result<Duration, String> {
    let mut times = Vec::new();
    for _ in 0..count {
        sleep(PAUSE).await;
        times.push(transfer(peers, bytes, probe).await?);
    }
    Ok(median(&mut times))
}

/// The median time of a small message there and back.
async fn round_trips(peer: &mut Peer) -> Result<Duration, String> {
    let mut times = Vec::new();
    let mut message = [7; MESSAGE_BYTES];
    for _ in 0..MESSAGES {
        let begun = Instant::now();
        let there_and_back = async {
            peer.pipes.control_out.write_all(&message).await?;
            peer.pipes.control_in.read_exact(&mut message).await
        };
        timeout(PATIENCE, there_and_back).await.map_err(|_| late())?.map_err(|e| e.to_string())?;
        times.push(begun.elapsed());
    }
    Ok(median(&mut times))
}

/// How long `bytes` of each of `peers`, sent at once, take until the last has come.
async fn transfer(peers: &mut [Peer], bytes: usize, probe: &mut LinkProbe) -> Result<Duration, String> {
    /// As many as a worker hands over in one piece.
    const PIECE: usize = 1 << 20;
    let expected = probe.received() + (peers.len() * bytes) as u64;
    let begun = Instant::now();
    let pixels = vec![0; PIECE.min(bytes)];
    let send = async {
        let mut writes = Vec::new();
        for peer in peers {
            let pixels = &pixels;
            writes.push(async move {
                let mut left = bytes;
                while left > 0 {
                    let piece = left.min(pixels.len());
                    peer.pipes.bulk_out.write_all(&pixels[..piece]).await?;
                    left -= piece;
                }
                peer.pipes.bulk_out.flush().await
            });
        }
        all(writes).await
    };
    let both = async {
        let (sent, ()) = tokio::join!(send, probe.until_received(expected));
        sent
    };
    timeout(PATIENCE, both).await.map_err(|_| late())?.map_err(|e| e.to_string())?;
    Ok(begun.elapsed())
}

/// How long `bytes` from the master take to come.
async fn fetch(peer: &mut Peer, bytes: usize, probe: &mut LinkProbe) -> Result<Duration, String> {
    let begun = Instant::now();
    probe.send(bytes as u64);
    let mut piece = vec![0; 64 << 10];
    let mut left = bytes;
    while left > 0 {
        let room = left.min(piece.len());
        let read = timeout(PATIENCE, peer.pipes.bulk_in.read(&mut piece[..room])).await;
        match read.map_err(|_| late())?.map_err(|e| e.to_string())? {
            0 => return Err("the probe has ended".into()),
            length => left -= length,
        }
    }
    Ok(begun.elapsed())
}

/// Bytes of a long transfer at that rate.
fn long(mbit: Option<f64>) -> usize {
    let bytes = mbit.map_or(*TRANSFER_BYTES.end(), |mbit| (mbit * 125_000.0 * TRANSFER.as_secs_f64()) as u64);
    bytes.clamp(*TRANSFER_BYTES.start(), *TRANSFER_BYTES.end()) as usize
}

fn late() -> String {
    format!("nothing more came through in {} s", PATIENCE.as_secs())
}

fn median(times: &mut [Duration]) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

/// The median time of a small message there and back, on the link alone: each is answered when it has come.
fn promised_round_trip(profile: &LinkProfile) -> Duration {
    let mut medium = Medium::new(profile);
    let mut now = Duration::ZERO;
    let mut times = Vec::new();
    for _ in 0..MESSAGES {
        let begun = now;
        for direction in [Up, Down] {
            // What is lost does not count.
            now = medium.send(now, direction, 0, MESSAGE_BYTES).unwrap_or(now);
        }
        times.push(now - begun);
    }
    median(&mut times)
}

/// How long `bytes` of each of `peers` take on the link alone: full packets of all peers in turn, sent again at once if they are lost, and as
/// soon as the queue lets them in.
fn promised(profile: &LinkProfile, direction: Direction, peers: u32, bytes: usize) -> Duration {
    /// What a sender waits before it tries a full queue again.
    const AGAIN: Duration = Duration::from_micros(20);
    let mut medium = Medium::new(profile);
    let (mut now, mut last) = (Duration::ZERO, Duration::ZERO);
    for _ in 0..bytes.div_ceil(profile.mtu as usize) {
        for peer in 0..peers {
            let arrives = loop {
                let before = medium.counters(direction).overflowed;
                match medium.send(now, direction, peer, profile.mtu as usize) {
                    Some(arrives) => break arrives,
                    None if medium.counters(direction).overflowed > before => now += AGAIN,
                    None => {}
                }
            };
            last = last.max(arrives);
        }
    }
    last
}

/// Runs `futures` at once to their ends, or to the first error.
async fn all<F: Future<Output = std::io::Result<()>>>(futures: Vec<F>) -> std::io::Result<()> {
    let mut open: Vec<_> = futures.into_iter().map(Box::pin).collect();
    std::future::poll_fn(|context| {
        let mut result = Ok(());
        open.retain_mut(|future| match future.as_mut().poll(context) {
            std::task::Poll::Pending => true,
            std::task::Poll::Ready(done) => {
                if result.is_ok() {
                    result = done;
                }
                false
            }
        });
        match result {
            Ok(()) if !open.is_empty() => std::task::Poll::Pending,
            result => std::task::Poll::Ready(result),
        }
    })
    .await
}
