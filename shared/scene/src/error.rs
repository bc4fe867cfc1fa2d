//! What can go wrong with a user's scene.

use std::path::PathBuf;

/// A scene that cannot be used; each message says what, where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file could not be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file is malformed, hostile or beyond a limit.
    #[error("{path}: {what}")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What, where in it, and what to do.
        what: String,
    },
    /// The file requires an extension that we lack.
    #[error("{path}: requires the extension {extension}, which is not supported; export the file without it")]
    RequiredExtension {
        /// The file.
        path: PathBuf,
        /// Its name.
        extension: String,
    },
    /// A format that we do not read.
    #[error("{path}: unknown scene format; use .glb, .gltf, .obj, .ply, .toml (a scene file) or .tpack")]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
}
