//! One frame of each scene: the demo, every generator, the scene files and the sample scenes whose sources are there.

use super::{Other, check, with_every, with_other};
use crate::scenes::LARGE;
use crate::support::{root, scene_folder, skipped};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tessera_master::prepare::{PrepareOptions, Prepared, prepare, prepare_scene};
use tessera_pack::NormalCode;
use tessera_scene::LoadOptions;
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_whitted::{Features, FrameParams, PixelFormat};

/// Pixels a side.
const SIZE: u32 = 256;

/// Triangles of generated scenes.
const TRIANGLES: u32 = 60_000;

fn check_prepared(name: &str, prepared: &Prepared, other: &dyn Other) {
    let pack = &prepared.pack;
    if pack.triangle_count() > other.triangles_max() {
        return skipped(format_args!(
            "{name}: {} triangles are many for {}",
            pack.triangle_count(),
            other.name()
        ));
    }
    let params = FrameParams {
        camera: prepared.cameras[0].pose.to_local(&pack.frame(), SIZE, SIZE).expect("a usable pose"),
        width: SIZE,
        height: SIZE,
        samples: 1,
        sampling: Default::default(),
        max_depth: 8,
        frame: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
    };
    check(name, pack, &params, other);
}

fn check_generated(kind: Kind) {
    with_other(|other| {
        let mut scene = generate(&Recipe { kind, triangles: TRIANGLES, seed: 1 }).expect("in range");
        scene.name = kind.name().into();
        let prepared = prepare_scene(scene, &PrepareOptions::default(), Duration::ZERO).expect("it packs");
        check_prepared(kind.name(), &prepared, other);
    });
}

fn check_file(path: &Path, folder: Option<PathBuf>, other: &dyn Other) {
    let load = LoadOptions { scenes_folder: folder };
    let options = PrepareOptions { load, ..PrepareOptions::default() };
    let prepared = prepare(path, &options).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let name = path.file_stem().unwrap_or(OsStr::new("?")).to_string_lossy();
    check_prepared(&name, &prepared, other);
}

#[test]
fn demo() {
    with_every(|other| check_file(&root().join("scenes/hall.toml"), None, other));
}

#[test]
fn cornell() {
    check_generated(Kind::Cornell);
}

#[test]
fn hall() {
    check_generated(Kind::Hall);
}

#[test]
fn rooms() {
    check_generated(Kind::Rooms);
}

#[test]
fn plant() {
    check_generated(Kind::Plant);
}

#[test]
fn city() {
    check_generated(Kind::City);
}

/// Normals on the octahedron, positions and texture coordinates rounded further.
#[test]
fn other_codes() {
    with_every(|other| {
        let mut scene =
            generate(&Recipe { kind: Kind::Hall, triangles: TRIANGLES, seed: 1 }).expect("in range");
        scene.name = "hall".into();
        let options = PrepareOptions {
            normal_code: NormalCode::Oct,
            position_bits: 7,
            uv_bits: 9,
            max_intervals: 256,
            ..PrepareOptions::default()
        };
        let prepared = prepare_scene(scene, &options, Duration::ZERO).expect("it packs");
        assert_eq!(prepared.pack.packed_normals(), Some(NormalCode::Oct));
        assert!(prepared.pack.mesh().has_uvs());
        check_prepared("hall, other codes", &prepared, other);
    });
}

#[test]
fn every_generator_is_tested() {
    assert_eq!(Kind::ALL.len(), 5, "give the new generator a test above");
}

/// Sponza and the others.
#[test]
fn scene_files() {
    with_other(|other| {
        let Some(folder) = scene_folder() else { return };
        let mut paths: Vec<_> = std::fs::read_dir(root().join("scenes"))
            .expect("scenes/")
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.extension().is_some_and(|e| e == "toml"))
            .collect();
        paths.sort();
        for path in paths {
            let text = std::fs::read_to_string(&path).expect("a scene file");
            let document: toml::Table = text.parse().expect("TOML");
            // Generated scenes have a test each.
            let Some(source) = document.get("source").and_then(toml::Value::as_str) else { continue };
            if source.starts_with(LARGE) || !folder.join(source).is_file() {
                skipped(format_args!("{}: its source is large, or not there", path.display()));
                continue;
            }
            check_file(&path, Some(folder.clone()), other);
        }
    });
}

/// Every model of the scene folder as it is, with the lights and the view that it brings or that are put in.
#[test]
fn samples() {
    with_other(|other| {
        let Some(folder) = scene_folder() else { return };
        let mut models = Vec::new();
        let mut open = vec![folder];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(&folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                let is_model = path
                    .extension()
                    .is_some_and(|e| ["gltf", "glb", "ply", "obj"].iter().any(|model| e == *model));
                if path.is_dir() && path.file_name().is_none_or(|name| name != LARGE) {
                    open.push(path);
                } else if is_model {
                    models.push(path);
                }
            }
        }
        models.sort();
        assert!(models.len() >= 15, "only {} models", models.len());
        for model in models {
            check_file(&model, None, other);
        }
    });
}
