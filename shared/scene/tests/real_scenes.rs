//! The real scenes against counts that were taken from their files by other means.
//!
//! They lie in the folder that `TESSERA_SCENES` names, else in `../shared/scenes` beside the workspace; without it the test says
//! on stderr that it skips.

use glam::DVec3;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tessera_scene::{AlphaMode, FlatMesh, Scene, Selection, Without, Wrap, import::import};

/// The scene folder, if it is there.
fn scenes() -> Option<PathBuf> {
    let folder = std::env::var_os("TESSERA_SCENES").map(PathBuf::from);
    let folder =
        folder.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"));
    if folder.join("README.md").is_file() {
        return Some(folder);
    }
    // Not by `eprintln!`, which the test harness keeps to itself when a test passes.
    let _ = writeln!(
        std::io::stderr(),
        "SKIPPED: no scenes in {}; set TESSERA_SCENES to their folder",
        folder.display()
    );
    None
}

/// Triangles and vertices after instancing, materials, images in use.
type Counts = (usize, usize, usize, usize);

/// Imports, flattens and compares the counts; `None` without the scene folder.
fn check(file: &str, want: Counts) -> Option<(Scene, FlatMesh, Selection)> {
    let path = scenes()?.join(file);
    let start = Instant::now();
    let scene = import(&path).unwrap_or_else(|error| panic!("{error}"));
    let imported = start.elapsed();
    let flat = scene.flatten().unwrap();
    let selection = Selection::of(&scene, &flat, Without::default());
    eprintln!("{file}: import {imported:.1?}, flatten and select {:.1?}", start.elapsed() - imported);
    let found = (flat.triangles.len(), flat.positions.len(), scene.materials.len(), scene.images.len());
    assert_eq!(found, want, "{file}");
    assert!(flat.triangles.as_flattened().iter().all(|&index| (index as usize) < flat.positions.len()));
    for array in [flat.normals.len(), flat.uvs.len(), flat.colors.len()] {
        assert!(array == 0 || array == flat.positions.len(), "{file}");
    }
    Some((scene, flat, selection))
}

/// The size of the box around all positions.
fn size(flat: &FlatMesh) -> [f64; 3] {
    [0, 1, 2].map(|axis| {
        let values = flat.positions.iter().map(|position| position[axis]);
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        high - low
    })
}

#[test]
fn sponza() {
    let Some((scene, flat, selection)) = check("crytek_sponza/sponza.gltf", (262_205, 175_570, 25, 24))
    else {
        return;
    };
    assert_eq!(size(&flat).map(|side| (side * 10.0).round() / 10.0), [372.1, 155.6, 228.8]);
    let masked = scene.materials.iter().filter(|material| matches!(material.alpha, AlphaMode::Mask(_)));
    let masked: Vec<&str> = masked.map(|material| material.name.as_str()).collect();
    assert_eq!(masked, ["Material__57", "leaf"]);
    assert!(scene.materials.iter().all(|material| material.double_sided));
    assert!(selection.uvs && selection.normals && !selection.colors);
    let corner = |least: bool, axis: usize| {
        let values = flat.uvs.iter().map(|uv| uv[axis]);
        if least { values.fold(f32::INFINITY, f32::min) } else { values.fold(f32::NEG_INFINITY, f32::max) }
    };
    let range = [corner(true, 0), corner(true, 1), corner(false, 0), corner(false, 1)];
    assert_eq!(range.map(|value| (value * 10.0).round() / 10.0), [-27.8, -5.0, 32.3, 7.6]);
    assert_eq!(scene.nodes.len(), 381);
}

#[test]
fn san_miguel() {
    let Some((scene, _, selection)) =
        check("san_miguel_partial/san_miguel.gltf", (9_407_550, 5_992_264, 295, 224))
    else {
        return;
    };
    assert_eq!((scene.nodes.len(), scene.meshes.len(), scene.lights.len()), (49_848, 786, 0));
    let masked =
        scene.materials.iter().filter(|material| matches!(material.alpha, AlphaMode::Mask(_))).count();
    let glass = scene.materials.iter().filter(|material| material.transmission > 0.0);
    assert_eq!((masked, glass.clone().count()), (96, 9));
    assert!(glass.clone().all(|material| !material.thin_walled), "an index of refraction makes glass solid");
    assert!(selection.uvs && selection.normals);
}

#[test]
fn spaceship() {
    let Some((scene, flat, selection)) = check("spaceship/spaceship.glb", (318_558, 279_478, 11, 0)) else {
        return;
    };
    assert!(scene.materials.iter().any(|material| material.transmission > 0.0));
    assert!(scene.materials.iter().any(|material| material.roughness == 0.0));
    assert!(flat.uvs.is_empty() && !selection.uvs, "no material has a texture");
}

#[test]
fn scans() {
    for (file, want) in [
        ("stanford_bunny/bun_zipper.ply", (69_451, 35_947, 1, 0)),
        ("stanford_dragon/dragon_vrip_res2.ply", (202_520, 100_250, 1, 0)),
        ("stanford_dragon/dragon_vrip_res4.ply", (11_102, 5_205, 1, 0)),
        ("stanford_armadillo/armadillo.ply", (86_482, 43_243, 1, 0)),
        ("stanford_lucy/lucy.ply", (100_000, 71_769, 1, 0)),
    ] {
        let Some((scene, _, selection)) = check(file, want) else { return };
        assert_eq!(selection.normals, file.contains("lucy"), "{file}");
        assert!(scene.warnings.is_empty() && scene.dropped.is_empty(), "{file}: {:?}", scene.warnings);
    }
}

#[test]
fn cornell_box() {
    // The file has 76 positions; no face uses eight of them.
    let Some((scene, flat, _)) = check("cornell_box/cornell_box.obj", (34, 68, 5, 0)) else { return };
    assert_eq!(size(&flat)[1].round(), 549.0);
    let names: Vec<&str> = scene.materials.iter().map(|material| material.name.as_str()).collect();
    assert_eq!(names, ["white", "red", "green", "blue", "light"]);
    assert_eq!(scene.materials[1].base_color, [1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn gltf_cases() {
    for (case, want) in [
        ("Box/glTF/Box.gltf", (12, 24, 1, 0)),
        ("BoxInterleaved/glTF/BoxInterleaved.gltf", (12, 24, 1, 0)),
        ("Cameras/glTF/Cameras.gltf", (2, 4, 1, 0)),
        ("GlassVaseFlowers/glTF-Binary/GlassVaseFlowers.glb", (14_036, 8_550, 3, 2)),
        ("MeshPrimitiveModes/glTF/MeshPrimitiveModes.gltf", (16, 20, 1, 0)),
        ("NegativeScaleTest/glTF-Binary/NegativeScaleTest.glb", (7_724, 3_958, 6, 2)),
        ("OrientationTest/glTF-Binary/OrientationTest.glb", (524, 1_048, 7, 0)),
        ("SimpleMeshes/glTF/SimpleMeshes.gltf", (2, 6, 1, 0)),
        ("SimpleSparseAccessor/glTF/SimpleSparseAccessor.gltf", (12, 14, 1, 0)),
        ("TextureCoordinateTest/glTF-Binary/TextureCoordinateTest.glb", (10, 20, 5, 1)),
        ("TextureSettingsTest/glTF/TextureSettingsTest.gltf", (72, 144, 10, 3)),
        ("ToyCar/glTF/ToyCar.gltf", (108_936, 77_429, 3, 4)),
        ("TransmissionTest/glTF-Binary/TransmissionTest.glb", (128_775, 66_902, 14, 9)),
        ("TriangleWithoutIndices/glTF/TriangleWithoutIndices.gltf", (1, 3, 1, 0)),
        ("VertexColorTest/glTF-Binary/VertexColorTest.glb", (36, 72, 2, 2)),
    ] {
        let Some((scene, flat, selection)) = check(&format!("gltf_cases/{case}"), want) else { return };
        let name = case.split('/').next().unwrap_or_default();
        check_case(name, &scene, &flat, &selection);
    }
}

/// What one case is about, beyond its counts.
fn check_case(name: &str, scene: &Scene, flat: &FlatMesh, selection: &Selection) {
    let warned = |text: &str| scene.warnings.iter().any(|warning| warning.contains(text));
    match name {
        // A unit cube about the origin, its attributes strided.
        "Box" | "BoxInterleaved" => {
            assert_eq!(size(flat), [1.0; 3]);
            assert!(!selection.normals, "flat faces need no normals");
        }
        // The perspective camera stays, the orthographic one does not.
        "Cameras" => {
            assert_eq!(scene.cameras.len(), 1);
            let pose = &scene.cameras[0].pose;
            assert!((pose.fov_degrees - 40.107).abs() < 1e-3, "{pose:?}");
            assert_eq!((pose.eye - DVec3::new(0.5, 0.5, 3.0)).length(), 0.0);
            assert!((pose.target - DVec3::new(0.5, 0.5, 2.0)).length() < 1e-12);
            assert!(warned("orthographic"));
        }
        // Its seven modes; one triangle uses three of its four vertices.
        "MeshPrimitiveModes" => {
            assert_eq!(scene.dropped, [("primitives of points or lines", 4)]);
        }
        // Both volumes are solid glass.
        "GlassVaseFlowers" => {
            assert!(
                scene.materials.iter().any(|material| material.transmission > 0.0 && !material.thin_walled)
            );
        }
        // Transmission alone is thin-walled.
        "TransmissionTest" => {
            assert!(scene.materials.iter().any(|material| material.transmission > 0.0));
            assert!(
                scene.materials.iter().all(|material| material.thin_walled == (material.transmission > 0.0))
            );
        }
        // Geometric normals agree with the normals of the file, in mirrored instances too.
        "NegativeScaleTest" => {
            let turned = flat.triangles.iter().filter(|triangle| {
                let [a, b, c] = triangle.map(|index| DVec3::from(flat.positions[index as usize]));
                let given = DVec3::from(flat.normals[triangle[0] as usize].map(f64::from));
                (b - a).cross(c - a).dot(given) < 0.0
            });
            assert_eq!(turned.count(), 0);
        }
        "TextureSettingsTest" => {
            let wraps: Vec<_> = (scene.materials.iter().filter_map(|material| material.base_texture))
                .map(|texture| (texture.wrap_s, texture.wrap_t))
                .collect();
            for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                assert!(
                    wraps.contains(&(wrap, Wrap::Repeat)) || wraps.contains(&(wrap, wrap)),
                    "{wrap:?}: {wraps:?}"
                );
            }
            assert!(scene.materials.iter().any(|material| !material.double_sided));
        }
        "VertexColorTest" => {
            assert!(selection.colors);
        }
        // The fabric's coordinates are scaled by 3; eight cameras look at it.
        "ToyCar" => {
            assert_eq!((scene.cameras.len(), scene.cameras[0].name.as_str()), (8, "Camera001"));
            assert!(warned("KHR_materials_clearcoat") && warned("KHR_materials_sheen"));
            let fabric = scene
                .meshes
                .iter()
                .flat_map(|mesh| &mesh.primitives)
                .find(|part| part.material == 1)
                .unwrap();
            let widest = fabric.uvs.iter().flatten().fold(0.0_f32, |widest, value| widest.max(value.abs()));
            assert!(widest > 2.5 && widest < 3.5, "{widest}");
        }
        _ => {}
    }
}
