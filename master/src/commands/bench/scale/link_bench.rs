//! `tessera bench link`: what the transport of frames gets out of an emulated link, beside what the link has to give.

use super::link::LinkProfile;
use super::medium::{Direction, Medium};
use super::relay::RelayReport;
use super::relay_process::RelayProcess;
use crate::commands::progress::Progress;
use crate::commands::run::runtime;
use crate::commands::{CommandError, print_text};
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
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
const FRAMES: usize = 9;

/// Between tiles and pictures: longer than a radio's burst.
const PAUSE: Duration = Duration::from_millis(20);

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
        "through     round trip ms     a tile ms         a picture ms      1 peer Mbit/s     16 peers Mbit/s\n",
    );
    for line in lines {
        let _ = write!(text, "{:<11}", line.link);
        let pairs = [line.round_trip_ms, line.tile_ms, line.picture_ms, line.up_mbit_1, line.up_mbit_16];
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
    let join = probe.join_at(address);
    let mut peers = Vec::new();
    for _ in 0..PEERS {
        let own = Identity::new().map_err(|e| e.to_string())?;
        let Connected { pipes, closer } =
            tessera_worker::connect(&join, &own).await.map_err(|e| format!("{}: {e}", profile.name))?;
        peers.push(Peer { pipes, _closer: closer });
    }

    let round_trip = round_trips(&mut peers[0]).await?;
    let mut tiles = Vec::new();
    for _ in 0..TILES {
        sleep(PAUSE).await;
        tiles.push(transfer(&mut peers[..1], TILE_BYTES, &mut probe).await?);
    }
    let mut pictures = Vec::new();
    for _ in 0..FRAMES {
        sleep(PAUSE).await;
        pictures.push(transfer(&mut peers, SHARE_BYTES, &mut probe).await?);
    }
    let bytes = profile.mbit_up.map_or(*TRANSFER_BYTES.end(), |mbit| {
        let bytes = (mbit * 125_000.0 * TRANSFER.as_secs_f64()) as u64;
        bytes.clamp(*TRANSFER_BYTES.start(), *TRANSFER_BYTES.end())
    }) as usize;
    let one = transfer(&mut peers[..1], bytes, &mut probe).await?;
    let all = transfer(&mut peers, bytes / PEERS as usize, &mut probe).await?;

    let is_limited = !profile.is_straight();
    let promise = |value: f64| is_limited.then_some(value);
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let mbit = |time: Duration| bytes as f64 * 8e-6 / time.as_secs_f64();
    let has_rate = |value: f64| profile.mbit_up.map(|_| value);
    Ok(Line {
        link: profile.name.clone(),
        source: profile.source.clone(),
        round_trip_ms: Pair { measured: ms(round_trip), promised: promise(ms(promised_round_trip(profile))) },
        tile_ms: Pair {
            measured: ms(median(&mut tiles)),
            promised: promise(ms(promised(profile, 1, TILE_BYTES))),
        },
        picture_ms: Pair {
            measured: ms(median(&mut pictures)),
            promised: promise(ms(promised(profile, PEERS, SHARE_BYTES))),
        },
        up_mbit_1: Pair { measured: mbit(one), promised: has_rate(mbit(promised(profile, 1, bytes))) },
        up_mbit_16: Pair {
            measured: mbit(all),
            promised: has_rate(mbit(promised(profile, PEERS, bytes / PEERS as usize))),
        },
        relay: match &mut relay {
            Some(relay) => Some(relay.report().map_err(|e| e.to_string())?),
            None => None,
        },
    })
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
        for direction in [Direction::Up, Direction::Down] {
            // What is lost does not count.
            now = medium.send(now, direction, 0, MESSAGE_BYTES).unwrap_or(now);
        }
        times.push(now - begun);
    }
    median(&mut times)
}

/// How long `bytes` of each of `peers` take on the link alone: full packets of all peers in turn, sent again at once if they are lost, and as
/// soon as the queue lets them in.
fn promised(profile: &LinkProfile, peers: u32, bytes: usize) -> Duration {
    /// What a sender waits before it tries a full queue again.
    const AGAIN: Duration = Duration::from_micros(20);
    let mut medium = Medium::new(profile);
    let (mut now, mut last) = (Duration::ZERO, Duration::ZERO);
    for _ in 0..bytes.div_ceil(profile.mtu as usize) {
        for peer in 0..peers {
            let arrives = loop {
                let before = medium.counters(Direction::Up).overflowed;
                match medium.send(now, Direction::Up, peer, profile.mtu as usize) {
                    Some(arrives) => break arrives,
                    None if medium.counters(Direction::Up).overflowed > before => now += AGAIN,
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
