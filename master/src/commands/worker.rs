//! `tessera worker`.

use super::args::{byte_size, time};
use super::backend::BackendArgs;
use super::interrupt::asked_to_stop;
use super::run::{cores, runtime};
use super::{CommandError, cache_folder, join};
use clap::Args;
use std::path::PathBuf;
use std::time::Duration;
use tessera_trust::Identity;
use tessera_wire::limits;
use tessera_worker::{Backend, PackCache, ReplayConfig, RetryConfig, Stop, WorkerConfig, WorkerError};
use tokio::sync::watch;

/// Whom to serve, and with what.
#[derive(Debug, Args)]
#[command(
    long_about = "Join a master and render for it\n\n\
        The join string is the line that `tessera master` prints. It holds the master's address, the fingerprint of its certificate and \
        a token; keep it to yourself. Without --join it is taken from the environment variable TESSERA_JOIN.\n\n\
        The worker ends when the master dismisses it (exit code 0), when it is asked to by SIGTERM or Ctrl-C (0: it returns the tile in \
        hand, for which it has 5 s, and others get the rest; a second signal ends it at once), or when it is refused (1). When it loses a \
        master that has taken it, it joins again, slower and slower up to once in half a minute; a join string in a @FILE is read again \
        each time, so that a master that was started again finds its workers.\n\n\
        It renders on a GPU if there is one that is faster than the CPU, else on the CPU, and says which and why when it starts; \
        `tessera doctor` shows what there is. Workers of any kind join one master, which has each picture rendered by one kind of \
        arithmetic, unless it is told to mix them. A scene that the GPU cannot hold is refused with numbers, and the others render it.\n\n\
        Packs are kept on disk by their hash, so that a worker that comes back need not be sent them again. Any number of workers may \
        share the folder; nothing else in it is touched.",
    after_help = "Examples:\n  tessera worker --join @join.txt\n  TESSERA_JOIN=tessera1... tessera worker --threads 8 --name attic\n\
        \x20 tessera worker --join @join.txt --backend gpu --gpu 1"
)]
pub struct WorkerArgs {
    /// The join string, or @FILE that holds it [default: $TESSERA_JOIN]
    #[arg(long, value_name = "STRING|@FILE")]
    join: Option<String>,
    /// Threads that render [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// What the master calls this worker in logs and reports [default: the machine's name and the process's number]
    #[arg(long, value_name = "NAME", value_parser = name)]
    name: Option<String>,
    #[command(flatten)]
    backend: BackendArgs,
    /// How long to try while no master takes this worker, as in 30s or 1h [default: once, and for ever after one has taken it]
    #[arg(long, value_name = "TIME", value_parser = time)]
    retry_for: Option<Duration>,
    /// Where packs are kept [default: tessera/packs in $XDG_CACHE_HOME or ~/.cache]
    #[arg(long, value_name = "DIR", conflicts_with = "no_cache")]
    cache_dir: Option<PathBuf>,
    /// Bytes of all packs that are kept; those used longest ago go first
    #[arg(long, value_name = "SIZE", default_value = "8GiB", value_parser = byte_size)]
    cache_limit: u64,
    /// Keep no packs on disk
    #[arg(long)]
    no_cache: bool,
    /// Join the master that has started this process, by the ticket on standard input
    #[arg(long, hide = true, conflicts_with_all = ["join", "threads", "name", "retry_for", "cache_dir", "cache_limit", "no_cache"])]
    pub ticket: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Playing a device that this machine is not, for `tessera bench`.
#[derive(Debug, Args)]
struct DeviceArgs {
    /// Render nothing: return the pixels of a recording, after the time that they took
    #[arg(long, hide = true, value_name = "FILE", conflicts_with_all = ["backend", "gpu", "kernel"])]
    replay: Option<PathBuf>,
    /// How fast the device is beside the recorded one
    #[arg(long, hide = true, value_name = "S", default_value_t = 1.0, value_parser = factor, requires = "replay")]
    speed: f64,
    /// Multiplies all recorded times
    #[arg(long, hide = true, value_name = "S", default_value_t = 1.0, value_parser = factor, requires = "replay")]
    scale: f64,
    /// Microseconds that each tile takes besides
    #[arg(long, hide = true, value_name = "N", default_value_t = 0, requires = "replay")]
    launch_us: u32,
    /// Render on the CPU as if it were so many times as fast as it is, with one thread
    #[arg(long, hide = true, value_name = "S", value_parser = pace, conflicts_with_all = ["replay", "gpu"])]
    pace: Option<f64>,
}

impl WorkerArgs {
    /// Opens what was asked for.
    fn open(&self) -> Result<Backend, CommandError> {
        let DeviceArgs { replay, speed, scale, launch_us, pace } = &self.device;
        if let Some(file) = replay {
            let launch = Duration::from_micros((*launch_us).into());
            let config = ReplayConfig { file: file.clone(), scale: *scale, speed: *speed, launch };
            return Backend::replay(&config).map_err(CommandError::failed);
        }
        match pace {
            Some(_) if self.backend.needs_gpu() => {
                Err(CommandError::Usage("--pace is for the CPU; leave --backend gpu out".into()))
            }
            Some(pace) => Ok(Backend::paced(self.backend.kernel.kernel(), *pace)),
            None => self.backend.open(),
        }
    }
}

/// A factor between devices or times.
fn factor(text: &str) -> Result<f64, String> {
    let factor: Option<f64> = text.parse().ok();
    factor.filter(|f| (1e-4..=1e4).contains(f)).ok_or_else(|| "write a factor of 0.0001 to 10000".into())
}

/// A share of this machine's speed.
fn pace(text: &str) -> Result<f64, String> {
    let pace: Option<f64> = text.parse().ok();
    pace.filter(|p| (1e-3..=1.0).contains(p)).ok_or_else(|| "write a share of 0.001 to 1".into())
}

pub fn run(args: WorkerArgs) -> Result<(), CommandError> {
    let runtime = runtime()?;
    // What can be wrong at once is said before a device is opened and measured.
    let cache = if args.ticket {
        None
    } else {
        join::find(args.join.as_deref())?;
        cache(&args)?
    };
    let backend = args.open()?;
    tracing::info!("{}", backend.note());
    let result = if args.ticket {
        runtime.block_on(tessera_worker::run_local(backend)).map_err(CommandError::failed)
    } else {
        runtime.block_on(stay(args, backend, cache))
    };
    // Standard input is read by a thread that would keep the runtime until the master closes it; a tile may be in the middle.
    runtime.shutdown_background();
    result
}

/// Serves masters until one dismisses this worker, or it is asked to stop.
async fn stay(args: WorkerArgs, backend: Backend, cache: Option<PackCache>) -> Result<(), CommandError> {
    let own = Identity::new().map_err(CommandError::failed)?;
    let threads = args.threads.unwrap_or_else(cores);
    let name = args.name.unwrap_or_else(own_name);
    let config = WorkerConfig { name, threads, backend, memory: None, cache };
    let retry = RetryConfig {
        at_first: args.retry_for.unwrap_or(Duration::ZERO),
        again: args.retry_for,
        join_may_change: join::is_file(args.join.as_deref()),
    };
    let (ask, asked) = watch::channel(Stop::No);
    let first = asked_to_stop();
    tokio::spawn(async move {
        let signal = first.await;
        tracing::info!("{signal}: leaving after the tile in hand");
        ask.send_replace(Stop::Drain);
        let signal = asked_to_stop().await;
        tracing::info!("{signal}: leaving at once");
        ask.send_replace(Stop::Now);
        // The worker ends, and this task with it.
        ask.closed().await;
    });
    let find = || join::find(args.join.as_deref());
    tessera_worker::stay(find, &own, config, retry, asked).await
}

/// The cache that was asked for. Without the one that nobody has asked for work goes on.
fn cache(args: &WorkerArgs) -> Result<Option<PackCache>, CommandError> {
    if args.no_cache {
        return Ok(None);
    }
    let (folder, is_asked_for) = match &args.cache_dir {
        Some(folder) => (folder.clone(), true),
        None => match cache_folder("packs") {
            Some(folder) => (folder, false),
            None => return Ok(None),
        },
    };
    match PackCache::open(&folder, args.cache_limit) {
        Ok(cache) => Ok(Some(cache)),
        Err(e) if is_asked_for => {
            let folder = folder.display();
            Err(CommandError::Failed(format!("--cache-dir {folder}: {e}; name a folder that can be written")))
        }
        Err(e) => {
            tracing::warn!("packs are not kept: {}: {e}", folder.display());
            Ok(None)
        }
    }
}

impl From<WorkerError> for CommandError {
    fn from(error: WorkerError) -> Self {
        Self::failed(error)
    }
}

/// A name that a log can show.
fn name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.len() > limits::TEXT_BYTES || text.chars().any(char::is_control) {
        return Err(format!("a name has 1 to {} bytes and no control characters", limits::TEXT_BYTES));
    }
    Ok(text.to_owned())
}

/// `HOST-PROCESS`, as far as the system says.
pub fn own_name() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = name(host.trim()).unwrap_or_else(|_| "worker".into());
    format!("{host}-{}", std::process::id())
}
