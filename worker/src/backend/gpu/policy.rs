//! Whether tests need a GPU.

use super::GpuOptions;
use super::probe::GpuProbe;
use crate::backend::BackendError;
use std::io::Write;

/// What `TESSERA_GPU` says to tests that need a GPU: `require`, `allow` or `off`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TestPolicy {
    /// Without one they fail.
    Require,
    /// Without one they are skipped, and that is said.
    #[default]
    Allow,
    /// They are skipped, and that is said.
    Off,
}

impl TestPolicy {
    /// What the environment says; `allow` if it says nothing, an error if it says something else.
    pub fn from_env() -> Result<Self, String> {
        match std::env::var("TESSERA_GPU").as_deref() {
            Err(std::env::VarError::NotPresent) => Ok(Self::default()),
            Ok("require") => Ok(Self::Require),
            Ok("allow") => Ok(Self::Allow),
            Ok("off") => Ok(Self::Off),
            other => Err(format!("TESSERA_GPU is {other:?}: it may be `require`, `allow` or `off`")),
        }
    }

    /// Opens the best GPU for a test. `None`, said on stderr, when the test is to be skipped; an error when it is to fail.
    pub fn open(self, options: GpuOptions) -> Result<Option<GpuProbe>, BackendError> {
        let why = match self {
            Self::Off => "TESSERA_GPU=off".to_owned(),
            Self::Require | Self::Allow => match GpuProbe::open(None, options) {
                Ok(probe) => return Ok(Some(probe)),
                Err(error) if self == Self::Require => return Err(error),
                Err(BackendError::NoAdapter) => "no adapter".to_owned(),
                Err(error) => error.to_string(),
            },
        };
        // Not by `eprintln!`, which the test harness keeps to itself when a test passes. Nothing is lost with a stderr that nobody reads.
        let _ = writeln!(std::io::stderr(), "GPU tests skipped: {why}");
        Ok(None)
    }
}
