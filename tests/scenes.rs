//! Every file of the scene folder renders, or is refused with a line that names the reason.

use crate::support::{Folder, Tessera, root, scene_folder, skipped};
use std::path::{Path, PathBuf};

/// Too large for a test that runs with every change.
pub const LARGE: &str = "san_miguel_partial";

/// Source files below `folder`, in order.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| ["gltf", "glb", "obj", "ply"].iter().any(|x| e == *x))
            {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

#[test]
fn every_source_renders() {
    let Some(scenes) = scene_folder() else { return };
    let folder = Folder::new();
    let mut rendered = 0;
    for source in sources(&scenes) {
        if source.components().any(|part| part.as_os_str() == LARGE) {
            skipped(format_args!("{}: it is large", source.display()));
            continue;
        }
        let outcome = Tessera::new(["render"])
            .args([&source])
            .args(["--out", "a.png", "--size", "48x48", "--refs", "0"])
            .within(folder.path())
            .run();
        let text = outcome.ok();
        assert!(text.contains("image hash "), "{}: {text}", source.display());
        let picture = image::open(folder.file("a.png")).expect("a picture");
        let pixels = picture.as_rgba8().expect("8 bits");
        let first = pixels.get_pixel(0, 0);
        assert!(pixels.pixels().any(|p| p != first), "{}: the picture is empty", source.display());
        rendered += 1;
    }
    assert!(rendered >= 20, "only {rendered} sources in {}", scenes.display());
}

/// The scene files of the repository that need nothing else: generators, made small.
#[test]
fn every_generator_renders() {
    let folder = Folder::new();
    let mut tested = 0;
    for entry in std::fs::read_dir(root().join("scenes")).expect("scenes/") {
        let path = entry.expect("an entry").path();
        let is_scene = path.extension().is_some_and(|e| e == "toml");
        let text = if is_scene { std::fs::read_to_string(&path).expect("a scene file") } else { continue };
        // The others need the scene folder: see below.
        if !text.contains("[generate]") {
            continue;
        }
        let small: String = text
            .lines()
            .map(|line| if line.starts_with("triangles") { "triangles = 3000" } else { line })
            .flat_map(|line| [line, "\n"])
            .collect();
        folder.write("small.toml", small);
        let info = Tessera::new(["scene", "info", "small.toml", "--json"]).within(folder.path()).run().json();
        for camera in info["cameras"].as_array().expect("cameras") {
            Tessera::new(["render", "small.toml", "--out", "a.png", "--size", "32x32"])
                .args(["--camera", camera.as_str().expect("a name")])
                .within(folder.path())
                .run()
                .ok();
            tested += 1;
        }
    }
    assert!(tested >= 5, "only {tested} cameras");
}

/// The scene files of the repository whose sources lie in the scene folder.
#[test]
fn every_scene_file_with_a_source_renders() {
    let Some(scenes) = scene_folder() else { return };
    let folder = Folder::new();
    for entry in std::fs::read_dir(root().join("scenes")).expect("scenes/") {
        let path = entry.expect("an entry").path();
        let is_scene = path.extension().is_some_and(|e| e == "toml");
        let text = if is_scene { std::fs::read_to_string(&path).expect("a scene file") } else { continue };
        let document: toml::Table = text.parse().expect("TOML");
        let Some(source) = document.get("source").and_then(toml::Value::as_str) else { continue };
        if source.starts_with(LARGE) || !scenes.join(source).is_file() {
            let why = if source.starts_with(LARGE) { "is large" } else { "is not in the scene folder" };
            skipped(format_args!("{}: its source {why}", path.display()));
            continue;
        }
        let picture = folder.file("a.png");
        Tessera::new(["render", "--size", "48x48", "--out"])
            .args([&picture, &path])
            .env("TESSERA_SCENES", &scenes)
            .within(folder.path())
            .run()
            .ok();
        let picture = image::open(&picture).expect("a picture");
        let pixels = picture.as_rgba8().expect("8 bits");
        let first = pixels.get_pixel(0, 0);
        assert!(pixels.pixels().any(|p| p != first), "{}: the picture is empty", path.display());
    }
}

/// Real geometry, textures, cut-outs: one image from every number of workers, balancing and tile size.
#[test]
fn sponza_is_one_image_on_every_crew() {
    let Some(scenes) = scene_folder() else { return };
    let folder = Folder::new();
    Tessera::new(["scene", "pack", "--out", "sponza.tpack"])
        .args([root().join("scenes/sponza.toml")])
        .env("TESSERA_SCENES", &scenes)
        .within(folder.path())
        .run()
        .ok();
    let render = |args: &str| {
        Tessera::new(["render", "sponza.tpack", "--out", "a.png", "--size", "96x64", "--json"])
            .args(args.split(' '))
            .within(folder.path())
            .run()
            .json()
    };
    let expected = render("--workers 0 --tile 48");
    for (i, workers) in [0, 1, 2, 3, 5, 8].into_iter().enumerate() {
        // Two balancings for each, in turn: the whole product is tested with a small scene.
        for j in [i % 4, (i + 2) % 4] {
            let balance = ["paper-static", "static", "paper-dynamic", "dynamic"][j];
            let tile = [32, 64, 128, 256][(i / 2 + j) % 4];
            let args = format!("--workers {workers} --balance {balance} --tile {tile} --threads 1");
            let report = render(&args);
            assert_eq!(report["image_hash"], expected["image_hash"], "{args}");
            assert_eq!(report["rays"], expected["rays"], "{args}: each tile is counted once");
        }
    }
}
