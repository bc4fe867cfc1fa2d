//! Importers: glTF, OBJ, PLY; all go through [`resolve`].

mod gltf;
pub mod limits;
mod obj;
mod ply;
mod report;
mod resolve;
mod texels;

use crate::{Scene, SceneError};
use std::path::Path;

/// Reads a `.glb`, `.gltf`, `.obj` or `.ply` file; the extension decides, in upper or lower case.
///
/// Untrusted input: nothing outside the file's folder is read ([`resolve`]), memory is bounded by [`limits`], every index is
/// checked. Coordinates may still be NaN or infinite: whoever uses the triangles leaves those out and counts them.
///
/// # Errors
/// [`SceneError`]; a file without any triangle is an error too.
pub fn import(path: &Path) -> Result<Scene, SceneError> {
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    let scene = match extension.as_deref() {
        Some("gltf" | "glb") => gltf::import(path)?,
        Some("obj") => obj::import(path)?,
        Some("ply") => ply::import(path)?,
        _ => return Err(SceneError::UnknownFormat { path: path.to_owned() }),
    };
    let has_triangles =
        |mesh: usize| scene.meshes[mesh].primitives.iter().any(|part| !part.triangles.is_empty());
    if !scene.nodes.iter().filter_map(|node| node.mesh).any(has_triangles) {
        let left_out: String =
            scene.dropped.iter().map(|(kind, count)| format!("; left out: {count} {kind}")).collect();
        let what = format!("holds no triangles{left_out}; name a file with surfaces");
        return Err(SceneError::Invalid { path: path.to_owned(), what });
    }
    Ok(scene)
}
