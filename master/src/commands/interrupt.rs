//! Ctrl-C and SIGTERM, for a command that works until it is done and for one that serves until it is asked to stop.

use super::progress::Progress;
use super::{CommandError, say};
use tessera_master::output::abandon_all;

/// From now on Ctrl-C, and SIGTERM as `kill` and service managers send it, end this process whatever it does: with the line and the exit
/// code of every failure, and without unfinished files. Worker processes end when their standard input does, and so with this one.
pub fn listen(progress: &Progress) -> Result<(), CommandError> {
    let failed = |e| CommandError::Failed(format!("cannot listen for Ctrl-C: {e}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(failed)?;
    let asked = {
        let _inside = runtime.enter();
        asked_to_stop()
    };
    let progress = progress.clone();
    let wait = move || {
        runtime.block_on(asked);
        end(&progress)
    };
    std::thread::Builder::new().name("interrupt".into()).spawn(wait).map_err(failed)?;
    Ok(())
}

/// Ready, with its name, when the process is asked to end by SIGINT or SIGTERM; from this call on they do nothing else. For commands
/// that serve until then.
pub fn asked_to_stop() -> impl Future<Output = &'static str> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let (interrupt, terminate) = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()));
        async {
            let (Ok(mut interrupt), Ok(mut terminate)) = (interrupt, terminate) else {
                tracing::warn!("signals are not heard");
                return std::future::pending().await;
            };
            tokio::select! {
                _ = interrupt.recv() => "SIGINT",
                _ = terminate.recv() => "SIGTERM",
            }
        }
    }
    #[cfg(not(unix))]
    async {
        let _ = tokio::signal::ctrl_c().await;
        "Ctrl-C"
    }
}

fn end(progress: &Progress) -> ! {
    // Both are kept to the end: other threads go on until then.
    let _files = abandon_all();
    let _bars = progress.end();
    let error = CommandError::Interrupted;
    say(&error);
    std::process::exit(error.exit_code().into())
}
