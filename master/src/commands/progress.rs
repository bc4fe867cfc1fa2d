//! Progress on a terminal; nothing anywhere else.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::time::Duration;

/// Says on stderr how far the work is, if that is a terminal and no log is written there.
pub struct Progress {
    quiet: bool,
}

impl Progress {
    /// `quiet` switches it off.
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
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
        let target = if self.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        Bar(ProgressBar::with_draw_target(None, target).with_style(style).with_message(what))
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
