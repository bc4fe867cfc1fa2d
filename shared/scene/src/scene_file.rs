//! Scene files: a small TOML document with a source or generator, cameras, lights and material overrides.

use crate::{Scene, SceneError};
use std::path::Path;

/// Reads whatever the user named: a scene file (`.toml`) or a source file.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    crate::import::import(path)
}
