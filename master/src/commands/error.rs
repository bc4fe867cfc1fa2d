//! What a command ends with when it does not succeed.

use std::fmt::Display;
use std::io::Write;
use tessera_master::output::one_line;

/// Says on stderr, in one line, how a command has ended.
pub fn say(error: &CommandError) {
    // With a stderr that cannot be written to, the exit code alone says it.
    let _ = writeln!(std::io::stderr(), "tessera: error: {}", one_line(&error.to_string()));
}

/// A failure, as the user sees it: one line and an exit code.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// The command line asks for something that cannot be: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// The work failed: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// Ctrl-C, or SIGTERM: exit code 130, as shells count a death by SIGINT.
    #[error("interrupted")]
    Interrupted,
}

impl CommandError {
    /// A failure of the work for the reason `error`.
    pub fn failed(error: impl Display) -> Self {
        Self::Failed(error.to_string())
    }

    /// Wrong usage for the reason `error`.
    pub fn usage(error: impl Display) -> Self {
        Self::Usage(error.to_string())
    }

    /// What the process returns.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Failed(_) => 1,
            Self::Usage(_) => 2,
            Self::Interrupted => 130,
        }
    }
}
