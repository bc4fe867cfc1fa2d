//! What a command ends with when it does not succeed.

use std::fmt::Display;
pub use tessera_master::output::one_line;

/// A failure, as the user sees it: one line and an exit code.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// The command line asks for something that cannot be: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// The work failed: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// The user pressed Ctrl-C: exit code 130, as shells count a death by SIGINT.
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
