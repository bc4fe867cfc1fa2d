//! `tessera worker`.

use super::interrupt::asked_to_stop;
use super::run::{KernelChoice, cores, runtime};
use super::{CommandError, join};
use clap::Args;
use tessera_trust::Identity;
use tessera_wire::limits;
use tessera_worker::WorkerConfig;

/// Whom to serve, and with what.
#[derive(Debug, Args)]
#[command(
    long_about = "Join a master and render for it\n\n\
        The join string is the line that `tessera master` prints. It holds the master's address, the fingerprint of its certificate and \
        a token; keep it to yourself. Without --join it is taken from the environment variable TESSERA_JOIN.\n\n\
        The worker ends when the master dismisses it (exit code 0), when it is asked to by SIGTERM or Ctrl-C (0; its unfinished tiles go \
        to others), or when it is refused (1).",
    after_help = "Examples:\n  tessera worker --join @join.txt\n  TESSERA_JOIN=tessera1... tessera worker --threads 8 --name attic"
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
    /// How rays are traced; the picture is the same
    #[arg(long, value_name = "KERNEL", value_enum, default_value_t)]
    kernel: KernelChoice,
    /// Join the master that has started this process, by the ticket on standard input
    #[arg(long, hide = true, conflicts_with_all = ["join", "threads", "name"])]
    pub ticket: bool,
}

pub fn run(args: WorkerArgs) -> Result<(), CommandError> {
    let runtime = runtime()?;
    let kernel = args.kernel.kernel();
    let result = if args.ticket {
        runtime.block_on(tessera_worker::run_local(kernel)).map_err(CommandError::failed)
    } else {
        let join = join::find(args.join.as_deref())?;
        let own = Identity::new().map_err(CommandError::failed)?;
        let name = args.name.unwrap_or_else(own_name);
        let config = WorkerConfig {
            name,
            threads: args.threads.unwrap_or_else(cores),
            kernel,
            memory: None,
            cache: None,
        };
        let stop = async { _ = asked_to_stop().await };
        let served = runtime.block_on(tessera_worker::serve_master(&join, &own, config, stop));
        served.map_err(CommandError::failed)
    };
    // Standard input is read by a thread that would keep the runtime until the master closes it; a tile may be in the middle.
    runtime.shutdown_background();
    result
}

/// A name that a log can show.
fn name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.len() > limits::TEXT_BYTES || text.chars().any(char::is_control) {
        return Err(format!("a name has 1 to {} bytes and no control characters", limits::TEXT_BYTES));
    }
    Ok(text.to_owned())
}

/// `HOST-PROCESS`, as far as the system says.
fn own_name() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = name(host.trim()).unwrap_or_else(|_| "worker".into());
    format!("{host}-{}", std::process::id())
}
