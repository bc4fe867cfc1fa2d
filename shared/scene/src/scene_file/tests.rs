//! What scene files promise.

use super::*;
use crate::{AlphaMode, Environment, LightKind};
use glam::DVec3;
use std::fs;

/// A small scene file around the smallest generated scene.
const CORNELL: &str = "[generate]\nkind = \"cornell\"\ntriangles = 1000\n";

fn read(text: &str) -> Result<Scene, SceneError> {
    read_document(Path::new("test.toml"), text, &LoadOptions::default())
}

/// Expects an error that holds every one of `parts`.
#[track_caller]
fn check_refused(text: &str, parts: &[&str]) {
    let error = read(text).map(|_| ()).expect_err("the file should be refused").to_string();
    for part in parts {
        assert!(error.contains(part), "no `{part}` in: {error}");
    }
    assert!(!error.contains(char::is_control), "not one plain line: {error:?}");
}

#[test]
fn errors_say_where() {
    let table = |text: &str| format!("{CORNELL}{text}");
    check_refused("", &["test.toml", "neither `source` nor [generate]"]);
    check_refused("source = 3", &["line 1, column 10", "string"]);
    check_refused("sauce = \"a.ply\"", &["line 1, column 1", "unknown field `sauce`", "`source`"]);
    check_refused("[generate]\nkind = \"castle\"\ntriangles = 1000", &["line 2", "castle", "`cornell`"]);
    check_refused(
        "[generate]\nkind = \"cornell\"\ntriangles = 10",
        &["[generate]", "triangles = 10", "1000 to"],
    );
    check_refused("[generate]\nkind = \"cornell\"\n", &["missing field `triangles`"]);
    check_refused(&format!("source = \"a.ply\"\n{CORNELL}"), &["line 1", "both"]);
    check_refused("[generate\n", &["line 1"]);

    let camera = |rest: &str| table(&format!("[[camera]]\nname = \"a\"\neye = [0.0, 0.0, 1.0]\n{rest}"));
    check_refused(&camera("target = [0.0, 0.0, 0.0]\nfov = 180.0"), &["line 4", "[[camera]] \"a\"", "fov"]);
    check_refused(&camera("target = [0.0, 0.0, 1.0]\nfov = 40.0"), &["same point"]);
    check_refused(&camera("target = [0.0, 2.0, 1.0]\nfov = 40.0"), &["up"]);
    check_refused(&camera("target = [nan, 2.0, 1.0]\nfov = 40.0"), &["finite"]);
    check_refused(&camera("target = [0.0, 0.0]\nfov = 40.0"), &["line 7"]);
    let steering =
        "[[camera]]\nname = \"a\\u001b[2J\"\neye = [0.0, 0.0, 1.0]\ntarget = [0.0, 0.0, 0.0]\nfov = 40.0\n";
    check_refused(&table(steering), &["control characters"]);
    check_refused(&table("[material.\"a\\u001b[2J\"]\nroughness = 0.5\n"), &["no such material"]);
    let twice = camera("target = [0.0, 0.0, 0.0]\nfov = 40.0\n");
    check_refused(&format!("{twice}{}", &twice[CORNELL.len()..]), &["\"a\"", "taken"]);
    check_refused(
        &format!("default_camera = \"b\"\n{CORNELL}"),
        &["line 1", "\"b\"", "\"front\", \"corner\""],
    );

    let light = |rest: &str| table(&format!("[[light]]\nintensity = 1.0\n{rest}"));
    check_refused(&light("kind = \"point\""), &["[[light]]", "position is missing"]);
    check_refused(&light("kind = \"laser\""), &["line 6", "laser"]);
    check_refused(&light("kind = \"directional\"\ndirection = [0.0, 0.0, 0.0]"), &["not zero"]);
    check_refused(&light("kind = \"point\"\nposition = [0.0, 0.0, 0.0]\nangles = [1.0, 2.0]"), &["angles"]);
    let spot = "kind = \"spot\"\nposition = [0.0, 0.0, 0.0]\ndirection = [0.0, 1.0, 0.0]\n";
    check_refused(&light(&format!("{spot}angles = [40.0, 30.0]")), &["inner < outer"]);
    check_refused(&light(spot), &["angles", "missing"]);
    check_refused(
        &table("[[light]]\nkind = \"point\"\nposition = [0.0, 0.0, 0.0]\nintensity = -1.0"),
        &["intensity"],
    );

    check_refused(&format!("ambient = [-1.0, 0.0, 0.0]\n{CORNELL}"), &["line 1", "ambient"]);
    check_refused(&table("[environment]\nzenith = [0.0, 0.0, 0.0]"), &["[environment]", "horizon"]);
    check_refused(&table("[environment]\nimage = \"../sky.png\""), &["../sky.png", "folder"]);
    check_refused(&table("[ground]\nsize = -1.0"), &["[ground]", "size"]);
    check_refused(&table("[ground]\nchecker = 1e-9"), &["[ground]", "checker"]);
    check_refused(&table("[material.chrome]\nroughness = 0.0"), &["chrome", "\"white\", \"red\""]);
    check_refused(&table("[material.white]\nroughness = 2.0"), &["white", "roughness", "between 0 and 1"]);
    check_refused(&table("[material.white]\nbase_color = [2.0, 0.0, 0.0]"), &["base_color"]);
    check_refused(&table("[material.white]\nior = 0.0"), &["ior"]);
    check_refused(&table("[material.white]\nalpha_cutoff = 0.3"), &["alpha = \"mask\""]);
}

#[test]
fn everything_that_is_stated_arrives() {
    let text = format!(
        "ambient = [0.1, 0.2, 0.3]\ndefault_camera = \"corner\"\nlights = \"add\"\n{CORNELL}\
         [[camera]]\nname = \"mine\"\neye = [0.0, 0.0, 1.0]\ntarget = [0.0, 0.0, 0.0]\nfov = 40.0\n\
         [[camera]]\nname = \"front\"\neye = [0.0, 0.0, 9.0]\ntarget = [0.0, 0.0, 0.0]\nfov = 30.0\n\
         [[light]]\nkind = \"spot\"\nposition = [1.0, 2.0, 3.0]\ndirection = [0.0, -2.0, 0.0]\nangles = [0.0, 90.0]\n\
         intensity = 2.0\ncolor = [1.0, 0.5, 0.0]\nrange = 7.0\n\
         [environment]\nzenith = [1.0, 0.0, 0.0]\nhorizon = [0.0, 1.0, 0.0]\nnadir = [0.0, 0.0, 1.0]\n\
         [ground]\nsize = 8.0\nheight = -1.0\nchecker = 0.5\n\
         [material.\"*\"]\nroughness = 0.25\nunlit = true\n\
         [material.\"white\"]\nroughness = 0.75\nbase_color = [0.1, 0.2, 0.3]\nopacity = 0.5\nalpha = \"mask\"\nalpha_cutoff = 0.3\n"
    );
    let scene = read(&text).unwrap();
    let names: Vec<_> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["corner", "mine", "front"]);
    assert_eq!(scene.cameras[2].pose.fov_degrees, 30.0, "the file's camera replaces the source's");
    assert_eq!(scene.ambient, [0.1, 0.2, 0.3]);

    assert_eq!(scene.lights.len(), 2);
    let light = &scene.lights[1];
    assert_eq!((light.position, light.direction), (DVec3::new(1.0, 2.0, 3.0), DVec3::NEG_Y));
    assert_eq!((light.intensity, light.range), ([2.0, 1.0, 0.0], 7.0));
    assert_eq!(light.kind, LightKind::Spot { inner: 0.0, outer: std::f32::consts::FRAC_PI_2 });

    let Environment::Gradient { zenith, horizon, nadir } = scene.environment else { panic!("no gradient") };
    assert_eq!([zenith, horizon, nadir], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!(scene.bounds().unwrap().0, DVec3::new(-4.0, -1.0, -4.0), "the ground reaches farthest");

    assert!(scene.materials.iter().all(|m| m.unlit));
    let white = scene.materials.iter().find(|m| m.name == "white").unwrap();
    assert_eq!((white.roughness, white.base_color), (0.75, [0.1, 0.2, 0.3, 0.5]), "the name goes before `*`");
    assert_eq!(white.alpha, AlphaMode::Mask(0.3));
    // Also before names that sort before it.
    let first = format!(
        "{CORNELL}[ground]\n[material.\"*\"]\nroughness = 0.25\n[material.\"#1\"]\nroughness = 0.75\n"
    );
    let document: Document = toml::from_str(&first).unwrap();
    let mut named = read(CORNELL).unwrap();
    named.materials[0].name = "#1".to_owned();
    let faults = Faults { path: Path::new("test.toml"), text: &first };
    apply::apply(&mut named, document, &faults).unwrap();
    assert_eq!((named.materials[0].roughness, named.materials[1].roughness), (0.75, 0.25));
    let ground = scene.materials.iter().find(|m| m.name == "ground").unwrap();
    assert_eq!(ground.roughness, 0.25, "overrides see the ground");
}

/// One triangle in the plane y = 0, facing down, so z up in a file whose third axis is up.
const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                   element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 2\n3 0 1 2\n";

#[test]
fn sources_are_found_beside_the_file_or_in_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("files")).unwrap();
    fs::create_dir_all(at("store/deep")).unwrap();
    fs::write(at("store/deep/a.ply"), PLY).unwrap();
    fs::write(at("files/a.toml"), "source = \"deep/a.ply\"\nup = \"z\"\nnormals = \"smooth\"\n").unwrap();

    let nowhere = LoadOptions::default();
    let error = load(&at("files/a.toml"), &nowhere).unwrap_err().to_string();
    assert!(error.contains("line 1, column 10") && error.contains("TESSERA_SCENES"), "{error}");

    let store = LoadOptions { scenes_folder: Some(at("store")) };
    let scene = load(&at("files/a.toml"), &store).unwrap();
    assert_eq!(scene.bounds(), Some((DVec3::ZERO, DVec3::new(1.0, 2.0, 0.0))), "z became y");
    assert_eq!(scene.meshes[0].primitives[0].normals, [[0.0, -1.0, 0.0]; 3]);
    assert_eq!(scene.cameras[0].name, "default");
    assert_eq!(scene.lights.len(), 1);
    assert_eq!(scene.notes.len(), 2, "both defaults are stated: {:?}", scene.notes);

    // The default camera frames the source, with or without a ground.
    fs::write(at("files/g.toml"), "source = \"deep/a.ply\"\nup = \"z\"\n[ground]\n").unwrap();
    let grounded = load(&at("files/g.toml"), &store).unwrap();
    assert_eq!(grounded.cameras, scene.cameras);
    assert!(grounded.bounds() != scene.bounds());

    fs::write(at("files/b.toml"), "source = \"a.toml\"").unwrap();
    let error = load(&at("files/b.toml"), &store).unwrap_err().to_string();
    assert!(error.contains("scene file itself"), "{error}");

    let error = load(&at("files/none.toml"), &store).unwrap_err().to_string();
    assert!(error.contains("none.toml"), "{error}");
    fs::write(at("files/bytes.toml"), [0xff, 0xfe, 0x00]).unwrap();
    let error = load(&at("files/bytes.toml"), &store).unwrap_err().to_string();
    assert!(error.contains("UTF-8"), "{error}");
    fs::create_dir(at("files/folder.toml")).unwrap();
    let error = load(&at("files/folder.toml"), &store).unwrap_err().to_string();
    assert!(error.contains("is a folder"), "{error}");
    #[cfg(unix)]
    {
        // A file without end.
        std::os::unix::fs::symlink("/dev/zero", at("files/zero.toml")).unwrap();
        let error = load(&at("files/zero.toml"), &store).unwrap_err().to_string();
        assert!(error.contains("not a regular file"), "{error}");
    }
}

#[test]
fn built_in_scenes_load_and_others_are_named() {
    for name in ["cornell", "rooms"] {
        let scene = builtin(name).unwrap();
        assert!(!scene.cameras.is_empty() && !scene.lights.is_empty(), "{name}");
    }
    let error = builtin("castle").unwrap_err().to_string();
    assert!(error.contains("cornell, hall, rooms, plant, city"), "{error}");
}

#[test]
fn every_scene_file_parses_and_loads_when_its_source_is_at_hand() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder =
        std::env::var_os("TESSERA_SCENES").map_or_else(|| root.join("../shared/scenes"), PathBuf::from);
    let options = LoadOptions { scenes_folder: Some(folder) };
    let mut files: Vec<_> = fs::read_dir(root.join("scenes")).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|p| p.extension().is_some_and(|e| e == "toml"));
    files.sort();
    assert!(files.len() >= 12, "{} scene files", files.len());
    for path in files {
        let text = read_text(&path).unwrap();
        let document: Document = toml::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let faults = Faults { path: &path, text: &text };
        let Some(source) = &document.source else {
            assert!(document.generate.is_some(), "{}", path.display());
            continue;
        };
        if find_source(&faults, source, &options).is_err() {
            skipped(&path, "its source is not at hand");
            continue;
        }
        // 223 images and nine million triangles take too long in a test's profile.
        if path.ends_with("san_miguel.toml") {
            skipped(&path, "large");
            continue;
        }
        let scene = load(&path, &options).unwrap_or_else(|e| panic!("{e}"));
        assert!(!scene.lights.is_empty(), "{}", path.display());
    }
}

/// Not by `eprintln!`, which the test harness keeps to itself when a test passes.
fn skipped(path: &Path, why: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {}: {why}", path.display());
}
