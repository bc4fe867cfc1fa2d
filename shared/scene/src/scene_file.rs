//! Scene files: a small TOML document with a source or generator, cameras, lights and material overrides.

use crate::{Scene, SceneError};
use std::path::{Path, PathBuf};

/// Where scenes may be looked for besides the place the user named.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// A folder of sources, tried when a scene file's `source` does not lie beside the scene file.
    pub scenes_folder: Option<PathBuf>,
}

/// Reads whatever the user named: a scene file (`.toml`) or a source file.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, SceneError> {
    let _ = options;
    crate::import::import(path)
}
