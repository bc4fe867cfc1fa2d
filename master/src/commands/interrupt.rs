//! Ctrl-C, for a whole command; signals, for a service.

use super::progress::Progress;
use super::{CommandError, one_line};
use std::future::poll_fn;
use std::task::Poll;
use tessera_master::output::abandon_all;

/// From now on Ctrl-C ends this process whatever it does: with the line and the exit code of every failure, and without
/// unfinished files. Worker processes end when their standard input does, and so with this one.
pub fn listen(progress: &Progress) -> Result<(), CommandError> {
    let failed = |e| CommandError::Failed(format!("cannot listen for Ctrl-C: {e}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(failed)?;
    let mut pressed = Box::pin(tokio::signal::ctrl_c());
    // Polling it once registers it, so that a signal counts from here on and not from when the thread has started.
    match runtime.block_on(poll_fn(|cx| Poll::Ready(pressed.as_mut().poll(cx)))) {
        Poll::Pending => {}
        Poll::Ready(Ok(())) => end(progress),
        Poll::Ready(Err(e)) => return Err(failed(e)),
    }
    let progress = progress.clone();
    let wait = move || match runtime.block_on(pressed) {
        Ok(()) => end(&progress),
        Err(e) => tracing::warn!("Ctrl-C is not heard any more: {e}"),
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
    eprintln!("tessera: error: {}", one_line(&error.to_string()));
    std::process::exit(error.exit_code().into())
}
