//! Importers: glTF, OBJ, PLY; all read files through one resolver.

mod gltf;
pub mod limits;
mod obj;
mod ply;
mod report;
mod resolve;
mod texels;

pub use report::listed;
pub(crate) use report::{one_line, without_controls};
pub(crate) use resolve::read_file;

use crate::{Image, Scene, SceneError};
use std::path::Path;

/// Whether this many bytes can be reserved now, in one piece: asked where what follows reserves in ways that end the process.
pub(crate) fn has_room(bytes: u64) -> bool {
    let mut room = Vec::<u8>::new();
    let reserved = usize::try_from(bytes).is_ok_and(|bytes| room.try_reserve_exact(bytes).is_ok());
    // A reservation that nobody looks at would be optimised away as if it had succeeded.
    std::hint::black_box(&mut room);
    reserved
}

/// The image behind `reference`, a plain path in the folder of `source` or below it.
pub(crate) fn read_image(source: &Path, reference: &str) -> Result<Image, SceneError> {
    let bytes =
        resolve::Resolver::new(source)?.read(reference, resolve::Syntax::Path, limits::IMAGE_BYTES_MAX)?;
    texels::TexelReader::new()
        .decode(reference, &bytes)
        .map_err(|e| report::Report::new(source).invalid(format!("image '{}' {e}", report::shown(reference))))
}

/// Reads a `.glb`, `.gltf`, `.obj` or `.ply` file; the extension decides, in upper or lower case.
///
/// Untrusted input: nothing outside the file's folder is read, memory is bounded by [`limits`], every index is
/// checked. Coordinates may still be NaN or infinite: whoever uses the triangles leaves those out and counts them.
///
/// # Errors
/// [`SceneError`]; a file without any triangle, or with more than [`limits::FLAT_MAX`] after instancing, is an error too.
pub fn import(path: &Path) -> Result<Scene, SceneError> {
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    let scene = match extension.as_deref() {
        Some("gltf" | "glb") => gltf::import(path)?,
        Some("obj") => obj::import(path)?,
        Some("ply") => ply::import(path)?,
        _ => return Err(SceneError::UnknownFormat { path: path.to_owned() }),
    };
    // Instances multiply: whoever walks over all of them may rely on there being few enough.
    let in_file = |error| match error {
        SceneError::Invalid { what, .. } => SceneError::Invalid { path: path.to_owned(), what },
        other => other,
    };
    if scene.flat_size().map_err(in_file)?.triangles == 0 {
        let left_out: String =
            scene.dropped.iter().map(|(kind, count)| format!("; left out: {count} {kind}")).collect();
        let what = format!("holds no triangles{left_out}; name a file with surfaces");
        return Err(SceneError::Invalid { path: path.to_owned(), what });
    }
    Ok(scene)
}
