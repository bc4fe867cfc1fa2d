//! Which surfaces are seen from behind: what the file says, or all.

use std::path::Path;
use tessera_scene::{LoadOptions, Scene, builtin, load, scene_file::builtin_names};

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                   element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const OBJ: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl red\nf 1 2 3\n";
/// Three triangles, with a material that says nothing, with one that has two sides, and without a material.
const GLTF: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "materials": [{"name": "silent"}, {"name": "both", "doubleSided": true}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}, {"attributes": {"POSITION": 0},
        "material": 1}, {"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "a.bin", "byteLength": 36}]}"#;

#[track_caller]
fn check(scene: &Scene, wanted: &[bool]) {
    let sides: Vec<_> = scene.materials.iter().map(|m| m.double_sided).collect();
    assert_eq!(sides, wanted, "{}", scene.name);
}

#[test]
fn files_and_scene_files_state_the_sides() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    let read = |name: &str| load(&folder.path().join(Path::new(name)), &LoadOptions::default()).unwrap();
    write("a.ply", PLY.as_bytes());
    write("a.mtl", b"newmtl red\nKd 1 0 0\n");
    write("a.obj", OBJ.as_bytes());
    write("a.gltf", GLTF.as_bytes());
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    write("a.bin", &corners.map(f32::to_le_bytes).concat());
    check(&read("a.ply"), &[true]);
    check(&read("a.obj"), &[true, true]);
    check(&read("a.gltf"), &[false, true, false]);

    write("a.toml", b"source = \"a.gltf\"\n[material.silent]\ndouble_sided = true\n[material.both]\ndouble_sided = false\n");
    check(&read("a.toml"), &[true, false, false]);
}

#[test]
fn generated_surfaces_have_two_sides() {
    for name in builtin_names() {
        let scene = builtin(name).unwrap();
        check(&scene, &vec![true; scene.materials.len()]);
    }
}
