//! The real scenes against counts that were taken from their files by other means.
//!
//! They lie in the folder that `TESSERA_SCENES` names, else in `../shared/scenes` beside the workspace; without it the test says
//! on stderr that it skips.

use std::path::{Path, PathBuf};
use tessera_scene::{FlatMesh, Scene, Selection, Without, import::import};

/// The scene folder, if it is there.
fn scenes() -> Option<PathBuf> {
    let folder = std::env::var_os("TESSERA_SCENES").map(PathBuf::from);
    let folder =
        folder.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"));
    if folder.join("README.md").is_file() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no scenes in {}; set TESSERA_SCENES to their folder", folder.display());
    None
}

/// What a file must hold.
struct Want {
    file: &'static str,
    triangles: usize,
    vertices: usize,
    /// Materials and images of the document.
    materials: usize,
    images: usize,
}

fn check(want: &Want) -> Option<(Scene, FlatMesh, Selection)> {
    let path = scenes()?.join(want.file);
    let scene = import(&path).unwrap_or_else(|error| panic!("{error}"));
    let flat = scene.flatten().unwrap();
    let selection = Selection::of(&scene, &flat, Without::default());
    let found = (flat.triangles.len(), flat.positions.len(), scene.materials.len(), scene.images.len());
    assert_eq!(found, (want.triangles, want.vertices, want.materials, want.images), "{}", want.file);
    assert!(flat.triangles.as_flattened().iter().all(|&index| (index as usize) < flat.positions.len()));
    Some((scene, flat, selection))
}

#[test]
fn sponza() {
    let want = Want {
        file: "crytek_sponza/sponza.gltf",
        triangles: 262_205,
        vertices: 175_570,
        materials: 25,
        images: 24,
    };
    let Some((scene, flat, selection)) = check(&want) else { return };
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for position in &flat.positions {
        for axis in 0..3 {
            low[axis] = low[axis].min(position[axis]);
            high[axis] = high[axis].max(position[axis]);
        }
    }
    let size: Vec<f64> = (0..3).map(|axis| ((high[axis] - low[axis]) * 10.0).round() / 10.0).collect();
    assert_eq!(size, [372.1, 155.6, 228.8]);
    let alpha = scene.materials.iter().filter(|material| material.alpha != tessera_scene::AlphaMode::Opaque);
    let alpha: Vec<&str> = alpha.map(|material| material.name.as_str()).collect();
    assert_eq!(alpha, ["Material__57", "leaf"]);
    assert!(scene.materials.iter().all(|material| material.double_sided));
    assert!(selection.uvs && selection.normals && !selection.colors);
}
