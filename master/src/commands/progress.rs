//! Progress on a terminal; nothing anywhere else.

use super::LogArgs;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Says on stderr how far the work is, if that is a terminal and no log is written there.
#[derive(Clone)]
pub struct Progress {
    log: LogArgs,
    /// The bar that was begun last.
    current: Arc<Mutex<Option<ProgressBar>>>,
}

impl Progress {
    /// For a command that logs as `log` says.
    pub fn new(log: LogArgs) -> Self {
        Self { log, current: Arc::default() }
    }

    /// How the command logs.
    pub fn log(&self) -> &LogArgs {
        &self.log
    }

    /// Clears the terminal; no bar is begun while the result lives.
    pub fn end(&self) -> impl Drop + '_ {
        let current = self.current();
        if let Some(bar) = &*current {
            bar.finish_and_clear();
        }
        current
    }

    /// A line that stays.
    pub fn line(&self, text: &str) {
        let bar = self.bar(String::new(), "{msg}");
        bar.0.println(text);
    }

    /// A step of unknown length.
    pub fn step(&self, what: impl Into<String>) -> Bar {
        let bar = self.bar(what.into(), "{spinner} {msg} {elapsed}");
        bar.0.enable_steady_tick(Duration::from_millis(100));
        bar
    }

    /// A step that is counted.
    pub fn parts(&self, what: &str) -> Bar {
        self.bar(what.into(), "{msg} [{bar:40}] {pos}/{len}, {eta} left")
    }

    /// A step that is counted in bytes.
    pub fn bytes(&self, what: &str) -> Bar {
        self.bar(what.into(), "{msg} [{bar:40}] {bytes}/{total_bytes}, {eta} left")
    }

    fn bar(&self, what: String, template: &str) -> Bar {
        // `stderr` draws on a terminal only.
        let logs = self.log.verbose > 0 || std::env::var_os("RUST_LOG").is_some();
        let target = if logs { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let mut current = self.current();
        let bar = ProgressBar::with_draw_target(None, target).with_style(style).with_message(what);
        *current = Some(bar.clone());
        Bar(bar)
    }

    fn current(&self) -> MutexGuard<'_, Option<ProgressBar>> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A line on the terminal, cleared when dropped.
pub struct Bar(ProgressBar);

impl Bar {
    /// `done` of `total` parts.
    pub fn set(&self, done: u64, total: u64) {
        self.0.set_length(total);
        self.0.set_position(done);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
