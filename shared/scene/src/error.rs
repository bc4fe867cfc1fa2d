//! What can go wrong with a user's scene.

use std::path::{Path, PathBuf};

/// A scene that cannot be used; each message says what, where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file could not be read.
    #[error("cannot read {}: {source}", printable(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file is malformed, hostile or beyond a limit.
    #[error("{}: {what}", printable(path))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What, where in it, and what to do.
        what: String,
    },
    /// The file requires an extension that we lack.
    #[error(
        "{}: requires the extension {extension}, which is not supported; export the file without it",
        printable(path)
    )]
    RequiredExtension {
        /// The file.
        path: PathBuf,
        /// Its name.
        extension: String,
    },
    /// A format that we do not read.
    #[error(
        "{}: unknown scene format; use .glb, .gltf, .obj, .ply, .toml (a scene file) or .tpack",
        printable(path)
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
}

/// A path as a message may show it: one line, and nothing that a terminal would obey.
fn printable(path: &Path) -> String {
    crate::import::without_controls(&path.display().to_string())
}
