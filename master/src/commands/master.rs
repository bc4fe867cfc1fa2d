//! `tessera master`.

use super::CommandError;
use super::args::{byte_size, time};
use super::interrupt::asked_to_stop;
use super::run::runtime;
use clap::Args;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;
use tessera_master::{ListenConfig, OutputFile, Service, ServiceConfig};
use tessera_wire::JoinString;

/// Where to listen, and whom to let in.
#[derive(Debug, Args)]
#[command(
    long_about = "Wait for workers from anywhere and render for clients\n\n\
        Prints one line on stdout, the join string: the master's address, the fingerprint of its certificate and a token. Workers join \
        with it (`tessera worker --join`). Whoever has it can join: keep it to yourself, and give --join-file rather than copying it \
        through a log. Workers of any kind, CPUs and GPUs, may join; a picture is rendered by those of one numeric class, so that its \
        hash means something, unless --mix or the client says otherwise. Logs go to stderr. Ends on SIGTERM or Ctrl-C, with exit code 0.",
    after_help = "Examples:\n\
        \x20 tessera master --listen 0.0.0.0:7411 --join-file join.txt\n\
        \x20 tessera master --listen 0.0.0.0:7411 --advertise render.example.org --token-ttl 8h\n\
        \x20 tessera master --listen [::1]:0"
)]
pub struct MasterArgs {
    /// The address to listen on (UDP); port 0 takes any
    #[arg(long, value_name = "HOST:PORT")]
    listen: String,
    /// The address in the join string, where workers reach this master [default: as it listens]
    #[arg(long, value_name = "HOST[:PORT]", value_parser = advertised)]
    advertise: Option<(String, u16)>,
    /// Also write the join string to a file that only this user can read
    #[arg(long, value_name = "FILE")]
    join_file: Option<PathBuf>,
    /// How long the join string lets in strangers: a number with s, m, h or d, or `never` for no end
    #[arg(long, value_name = "TIME", default_value = "1h", value_parser = time_to_live)]
    token_ttl: Ttl,
    /// Memory for scenes that clients send and images that they wait for, as in 8GiB [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = byte_size)]
    pack_memory: Option<u64>,
    /// Let workers of different arithmetic (CPUs, kinds of GPU) render one picture, also for clients that do not ask for it
    ///
    /// Without it one class renders a picture, the one that is the fastest together, and others idle until it has no worker left.
    #[arg(long)]
    mix: bool,
}

/// A token's time; `None`: no end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ttl(Option<Duration>);

pub fn run(args: MasterArgs) -> Result<(), CommandError> {
    let runtime = runtime()?;
    let result = runtime.block_on(serve(args));
    runtime.shutdown_background();
    result
}

async fn serve(args: MasterArgs) -> Result<(), CommandError> {
    let listen = address(&args.listen)?;
    let ttl = args.token_ttl.0;
    let at = ListenConfig { listen, advertise: args.advertise.clone(), token_ttl: ttl };
    let join_file = args.join_file.as_deref().map(OutputFile::check).transpose();
    let join_file = join_file.map_err(CommandError::failed)?.map(OutputFile::secret);
    // From here on a signal ends it in peace.
    let stop = asked_to_stop();
    let pack_bytes = args.pack_memory.unwrap_or_else(half_of_free_memory);
    let config = ServiceConfig { mix: args.mix, pack_bytes, ..ServiceConfig::default() };
    let (service, join) = Service::listen(config, at).map_err(CommandError::failed)?;
    if let Some(file) = join_file {
        file.write_bytes(format!("{join}\n").as_bytes()).map_err(CommandError::failed)?;
    }
    announce(&join, &args, listen)?;
    service.run(async { tracing::info!("{}: sending everybody home", stop.await) }).await;
    Ok(())
}

/// Gives the join string to whoever starts workers, and says what it is good for.
fn announce(join: &JoinString, args: &MasterArgs, listen: SocketAddr) -> Result<(), CommandError> {
    super::print_text(&format!("{join}\n"))?;
    if listen.ip().is_unspecified() && args.advertise.is_none() {
        tracing::info!(
            "listening on all addresses; the join string says {}, give --advertise if others reach this machine by another one",
            join.address()
        );
    }
    match args.token_ttl.0 {
        Some(ttl) => {
            tracing::info!("listening on {}; the join string is good for {} s", join.address(), ttl.as_secs())
        }
        None => {
            tracing::info!("listening on {}; the join string is good until this master ends", join.address())
        }
    }
    Ok(())
}

/// The address to bind.
fn address(text: &str) -> Result<SocketAddr, CommandError> {
    let usage = |why: String| CommandError::Usage(format!("--listen {text}: {why}"));
    let found =
        text.to_socket_addrs().map_err(|e| usage(format!("{e}; write HOST:PORT, as in 0.0.0.0:7411")))?;
    found.into_iter().next().ok_or_else(|| usage("the name has no address".into()))
}

/// Host, and port if there is one, else 0.
fn advertised(text: &str) -> Result<(String, u16), String> {
    let bare_v6 = text.parse::<std::net::Ipv6Addr>().is_ok() || text.ends_with(']');
    if text.contains(':') && !bare_v6 {
        return JoinString::split_address(text).map_err(|e| e.to_string());
    }
    let host =
        JoinString::check_host(text).ok_or("write HOST or HOST:PORT, as in render.example.org:7411")?;
    Ok((host, 0))
}

fn time_to_live(text: &str) -> Result<Ttl, String> {
    if text == "never" {
        return Ok(Ttl(None));
    }
    time(text).map(|ttl| Ttl(Some(ttl))).map_err(|e| format!("{e}, or never"))
}

/// What a master that knows no better lets clients fill.
fn half_of_free_memory() -> u64 {
    /// Where the system does not say what is free.
    const UNKNOWN: u64 = 4 << 30;
    tessera_worker::free_memory().unwrap_or(UNKNOWN) / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times() {
        for (text, seconds) in [("1s", 1), ("90m", 5400), ("1h", 3600), ("366d", 366 * 86400)] {
            assert_eq!(time_to_live(text), Ok(Ttl(Some(Duration::from_secs(seconds)))));
        }
        assert_eq!(time_to_live("never"), Ok(Ttl(None)));
        for bad in [
            "",
            "h",
            "1",
            "0s",
            "-1h",
            "1.5h",
            "367d",
            "99999999999999999999d",
            "18446744073709551615d",
            "1é",
        ] {
            assert!(time_to_live(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn advertised_addresses() {
        let name = |host: &str, port| Ok((host.to_string(), port));
        assert_eq!(advertised("master"), name("master", 0));
        assert_eq!(advertised("master:7411"), name("master", 7411));
        assert_eq!(advertised("::1"), name("::1", 0));
        assert_eq!(advertised("[::1]"), name("::1", 0));
        assert_eq!(advertised("[::1]:80"), name("::1", 80));
        assert_eq!(advertised("10.0.0.1:80"), name("10.0.0.1", 80));
        for bad in ["", "a b", "a/b", "master:", "master:x", "master:0"] {
            assert!(advertised(bad).is_err(), "{bad}");
        }
    }
}
