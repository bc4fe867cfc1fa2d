//! Scene files: a small TOML document that names a source or a generator and adds cameras, lights and materials.
//!
//! `scenes/README.md` describes every key with its unit, range and default; `schema.rs` is the same in types. A `source` is looked
//! for beside the scene file, then under [`LoadOptions::scenes_folder`]; it may lie anywhere, since the user names the scene file
//! and the scene file names the source. What a source refers to itself (buffers, images) stays within the source's folder.
//!
//! Whatever is loaded ends up with a camera, some light, and a sky if mirrors or glass would have nothing to show: [`add_defaults`]
//! puts them in where the file states none, and says so in [`Scene::notes`].

mod apply;
mod defaults;
mod ground;
mod schema;
mod smooth;

pub use defaults::add_defaults;

use crate::{Scene, SceneError, generate, import};
use glam::DVec3;
use schema::Document;
use std::path::{Path, PathBuf};

/// Where scenes may be looked for besides the place the user named.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// A folder of sources, tried when a scene file's `source` does not lie beside the scene file.
    pub scenes_folder: Option<PathBuf>,
}

/// Scene files that are part of the program: name and text. They are generated, so they need no other file.
const BUILT_IN: [(&str, &str); 5] = [
    ("cornell", include_str!("../../../../scenes/cornell.toml")),
    ("hall", include_str!("../../../../scenes/hall.toml")),
    ("rooms", include_str!("../../../../scenes/rooms.toml")),
    ("plant", include_str!("../../../../scenes/plant.toml")),
    ("city", include_str!("../../../../scenes/city.toml")),
];

/// Bytes that a scene file may have: far more than one written by hand.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Reads whatever the user named, by its extension: a scene file (`.toml`) or a source file.
///
/// Fails when a file cannot be read, is malformed, or leaves nothing to render.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, SceneError> {
    let is_scene_file = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    if is_scene_file {
        return read_document(path, &read_text(path)?, options);
    }
    let mut scene = import::import(path)?;
    let bounds = bounds_of(path, &scene)?;
    add_defaults(&mut scene, bounds);
    Ok(scene)
}

/// The built-in scene of this name: one of [`builtin_names`].
pub fn builtin(name: &str) -> Result<Scene, SceneError> {
    let path = PathBuf::from(format!("{name} (built in)"));
    let Some((_, text)) = BUILT_IN.iter().find(|(n, _)| *n == name) else {
        let names: Vec<_> = builtin_names().collect();
        return Err(SceneError::Invalid {
            path,
            what: format!("no such scene; there are {}", names.join(", ")),
        });
    };
    read_document(&path, text, &LoadOptions::default())
}

/// Names that [`builtin`] knows.
pub fn builtin_names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// The scene that a scene file describes.
fn read_document(path: &Path, text: &str, options: &LoadOptions) -> Result<Scene, SceneError> {
    let faults = Faults { path, text };
    let document: Document = toml::from_str(text).map_err(|e| faults.at(e.span(), e.message().trim()))?;
    let mut scene = match (&document.source, &document.generate) {
        (Some(source), None) => {
            let found = find_source(&faults, source, options)?;
            import::import(&found)?
        }
        (None, Some(recipe)) => {
            let made = generate::generate(&recipe.get_ref().recipe());
            made.map_err(|e| faults.at(Some(recipe.span()), &format!("[generate]: {e}")))?
        }
        (Some(source), Some(_)) => {
            return Err(faults.at(Some(source.span()), "both `source` and [generate]; keep one of them"));
        }
        (None, None) => {
            return Err(faults.at(None, "neither `source` nor [generate]; name a file or a generator"));
        }
    };
    // A default camera frames what the source shows, not the ground under it.
    let bounds = apply::apply(&mut scene, document, &faults)?;
    add_defaults(&mut scene, bounds);
    Ok(scene)
}

/// The scene's box; an empty scene is refused.
fn bounds_of(path: &Path, scene: &Scene) -> Result<(DVec3, DVec3), SceneError> {
    scene.bounds().ok_or_else(|| {
        let what = "no triangle with finite corners; export the scene with its meshes".to_owned();
        SceneError::Invalid { path: path.to_owned(), what }
    })
}

/// The file that `source` means: beside the scene file, or else under the scenes folder.
fn find_source(
    faults: &Faults,
    source: &toml::Spanned<PathBuf>,
    options: &LoadOptions,
) -> Result<PathBuf, SceneError> {
    let name = source.get_ref();
    if name.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        return Err(faults
            .at(Some(source.span()), "`source` is a scene file itself; name a .gltf, .glb, .obj or .ply"));
    }
    let beside = faults.path.parent().unwrap_or(Path::new("")).join(name);
    let under = options.scenes_folder.as_ref().map(|folder| folder.join(name));
    let mut tried = vec![beside];
    tried.extend(under);
    if let Some(found) = tried.iter().find(|p| p.is_file()) {
        return Ok(found.clone());
    }
    let places: Vec<_> = tried.iter().map(|p| p.display().to_string()).collect();
    let hint = match options.scenes_folder {
        Some(_) => "put it there",
        None => "put it there, or name a folder of scenes (TESSERA_SCENES)",
    };
    let what = format!("`source` not found; looked for {}; {hint}", places.join(" and "));
    Err(faults.at(Some(source.span()), &what))
}

/// The text of a scene file.
fn read_text(path: &Path) -> Result<String, SceneError> {
    let bytes = import::read_file(path, FILE_BYTES_MAX)?;
    String::from_utf8(bytes).map_err(|_| SceneError::Invalid {
        path: path.to_owned(),
        what: "is not UTF-8 text; save it as UTF-8".to_owned(),
    })
}

/// Makes errors that say where in the file they lie.
struct Faults<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Faults<'_> {
    /// An error at a range of bytes of the text.
    fn at(&self, span: Option<std::ops::Range<usize>>, what: &str) -> SceneError {
        let place = span.map_or(String::new(), |span| {
            let before = self.text.get(..span.start).unwrap_or(self.text);
            let line = before.matches('\n').count() + 1;
            let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
            format!("line {line}, column {column}: ")
        });
        let what = import::one_line(what);
        SceneError::Invalid { path: self.path.to_owned(), what: format!("{place}{what}") }
    }
}

#[cfg(test)]
mod tests;
