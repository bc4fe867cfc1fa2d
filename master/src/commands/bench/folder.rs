//! Where the files of a bench go.

use crate::commands::CommandError;
use std::path::{Path, PathBuf};
use tessera_master::OutputFile;

/// The folder that a page goes to.
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes it if it is not there, and checks that files can be written to it, before minutes of work.
    pub fn check(path: &Path) -> Result<Self, CommandError> {
        std::fs::create_dir_all(path).map_err(|e| {
            CommandError::Failed(format!(
                "--out {}: {e}; name a folder that can be made or written",
                path.display()
            ))
        })?;
        OutputFile::check(&path.join("index.html")).map_err(CommandError::failed)?;
        Ok(Self { path: path.to_owned() })
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file in it.
    pub fn write(&self, name: &str, content: &[u8]) -> Result<(), CommandError> {
        let file = OutputFile::check(&self.path.join(name)).map_err(CommandError::failed)?;
        file.write_bytes(content).map_err(CommandError::failed)
    }
}

/// The words that this process was started with, so that a reader can start it again.
pub fn command_line() -> String {
    let words = std::env::args_os().skip(1).map(|word| {
        let word = word.to_string_lossy().into_owned();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=@%+".contains(c);
        if !word.is_empty() && word.chars().all(is_plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    });
    std::iter::once("tessera".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}
