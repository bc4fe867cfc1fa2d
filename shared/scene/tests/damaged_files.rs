//! Damaged files: whatever happens to their bytes, an import ends in a scene or an error, and never takes much memory.

use proptest::prelude::*;
use std::path::Path;
use tessera_scene::{Selection, Without, import::import};

/// One change of a file.
#[derive(Clone, Debug)]
enum Change {
    Set(usize, u8),
    Cut(usize),
    Repeat(usize, usize),
    /// A number where one stood, larger than any file.
    Digits(usize),
}

fn changes() -> impl Strategy<Value = Vec<Change>> {
    let change = prop_oneof![
        8 => (any::<usize>(), any::<u8>()).prop_map(|(at, byte)| Change::Set(at, byte)),
        4 => (any::<usize>(), prop::sample::select(b"0123456789-.eE{}[]\",:/% \n".to_vec()))
            .prop_map(|(at, byte)| Change::Set(at, byte)),
        1 => any::<usize>().prop_map(Change::Cut),
        2 => (any::<usize>(), 1..40_usize).prop_map(|(at, length)| Change::Repeat(at, length)),
        3 => any::<usize>().prop_map(Change::Digits),
    ];
    prop::collection::vec(change, 1..6)
}

fn damaged(mut bytes: Vec<u8>, changes: &[Change]) -> Vec<u8> {
    for change in changes {
        if bytes.is_empty() {
            break;
        }
        let length = bytes.len();
        match *change {
            Change::Set(at, byte) => bytes[at % length] = byte,
            Change::Cut(at) => bytes.truncate(at % length),
            Change::Repeat(at, count) => {
                let at = at % length;
                let copy = bytes[at..length.min(at + count)].to_vec();
                bytes.splice(at..at, copy);
            }
            Change::Digits(at) => {
                let digits: Vec<usize> = (0..length).filter(|&i| bytes[i].is_ascii_digit()).collect();
                if !digits.is_empty() {
                    let at = digits[at % digits.len()];
                    bytes.splice(at..=at, *b"4000000000");
                }
            }
        }
    }
    bytes
}

/// Imports the bytes as a file called `name`; goes on with the scene if there is one.
fn survive(name: &str, bytes: &[u8], more: &[(&str, &[u8])]) {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in more {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    match import(&path).and_then(|scene| scene.flatten().map(|flat| (scene, flat))) {
        Ok((scene, flat)) => {
            assert!(
                flat.triangles.as_flattened().iter().all(|&index| (index as usize) < flat.positions.len())
            );
            let selection = Selection::of(&scene, &flat, Without::default());
            assert!(selection.materials.iter().all(|&material| material < scene.materials.len()));
            assert!(selection.images.iter().all(|&image| image < scene.images.len()));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    assert_memory_is_bounded();
}

/// The largest memory that the process ever had; the fixtures have some kilobytes.
fn assert_memory_is_bounded() {
    let Ok(status) = std::fs::read_to_string(Path::new("/proc/self/status")) else { return };
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    let kilobytes: u64 = peak.trim().trim_end_matches("kB").trim().parse().unwrap_or(0);
    assert!(kilobytes < 768 << 10, "the import took {peak}");
}

fn png() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image =
        image::RgbaImage::from_fn(5, 3, |x, y| image::Rgba([x as u8 * 40, y as u8 * 80, 7, 255 - x as u8]));
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Positions, coordinates, indices and an image: the buffer of the glTF fixtures, and where the image begins and ends.
fn buffer() -> (Vec<u8>, usize, usize) {
    let floats = [
        0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0,
        1.0,
    ];
    let mut bytes: Vec<u8> = floats.iter().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend([0, 0, 1, 0, 2, 0, 2, 0, 1, 0, 3, 0]);
    let start = bytes.len();
    bytes.extend(png());
    let end = bytes.len();
    (bytes, start, end)
}

fn json(uri: &str) -> String {
    let (bytes, start, end) = buffer();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"extensionsUsed":["KHR_lights_punctual"],
"nodes":[{{"children":[1,2],"scale":[-1,2,3]}},{{"mesh":0,"rotation":[0,1,0,0]}},{{"camera":0,"mesh":0,
"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"spot","spot":{{"outerConeAngle":0.5}},"range":3}}]}}}},
"cameras":[{{"type":"perspective","perspective":{{"yfov":0.7,"znear":0.1}}}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0,"mode":4}}]}}],
"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"baseColorFactor":[1,0.5,0.25,1]}},
"alphaMode":"MASK","extensions":{{"KHR_materials_transmission":{{"transmissionFactor":0.5}},"KHR_materials_ior":{{"ior":1.4}}}}}}],
"textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071,"magFilter":9728}}],
"images":[{{"bufferView":2,"mimeType":"image/png"}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3",
"sparse":{{"count":1,"indices":{{"bufferView":1,"byteOffset":2,"componentType":5123}},"values":{{"bufferView":0}}}}}},
{{"bufferView":0,"byteOffset":48,"componentType":5126,"count":4,"type":"VEC2"}},
{{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":80}},{{"buffer":0,"byteOffset":80,"byteLength":12}},
{{"buffer":0,"byteOffset":{start},"byteLength":{}}}],
"buffers":[{{"byteLength":{}{uri}}}]}}"#,
        end - start,
        bytes.len()
    )
}

fn gltf() -> Vec<u8> {
    let text: String = buffer().0.iter().map(|byte| format!("%{byte:02x}")).collect();
    json(&format!(r#","uri":"data:,{text}""#)).into_bytes()
}

fn glb() -> Vec<u8> {
    let (mut json, (mut binary, ..)) = (json("").into_bytes(), buffer());
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let chunk =
        |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes(), kind.as_slice(), bytes].concat();
    let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &binary)].concat();
    [b"glTF".as_slice(), &2_u32.to_le_bytes(), &(chunks.len() as u32 + 12).to_le_bytes(), &chunks].concat()
}

const OBJ: &str = "mtllib m.mtl\no thing\nv 0 0 0\nv 1 0 0 1 0.5 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0.5\nvn 0 0 1\n\
    usemtl m\nf 1/1/1 2/2/1 3//1 4\ng next\nusemtl other\nf -4 -3 -2 \\\n -1\nl 1 2\ns off\nf 1 2\n";
const MTL: &str = "newmtl m\nKd 0.5 0.5 0.5\nKs 0.1\nNs 50\nNi 1.5\nd 0.5\nTr 0.25\nillum 7\nTf 1 1 1\nKe 0 0 0\n\
    map_Kd -s 2 2 -o 0.5 -clamp on a.png\nmap_d a.png\nnewmtl other\nmap_bump x\n";
const PLY: &str = "ply\nformat ascii 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
    property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    element other 1\nproperty list uchar short a\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0 0 0 1 255 0 0\n1 0 0 0 0 1 0 255 0\n1 1 0 0 0 1 0 0 255\n0 1 0 0 0 1 9 9 9\n2 5 6\n4 0 1 2 3\n3 0 2 1\n";

fn binary_ply() -> Vec<u8> {
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar uint vertex_index\nproperty uchar flag\nend_header\n";
    let floats = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut bytes = head.as_bytes().to_vec();
    bytes.extend(floats.iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 1]);
    bytes
}

#[test]
fn the_fixtures_are_sound() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.mtl"), MTL).unwrap();
    std::fs::write(folder.path().join("a.png"), png()).unwrap();
    let files = [
        ("a.gltf", gltf(), 4),
        ("a.GLB", glb(), 4),
        ("a.Obj", OBJ.as_bytes().to_vec(), 4),
        ("a.ply", PLY.as_bytes().to_vec(), 3),
        ("b.PLY", binary_ply(), 1),
    ];
    for (name, bytes, triangles) in files {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let scene = import(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(scene.flatten().unwrap().triangles.len(), triangles, "{name}");
    }
}

#[test]
fn what_is_no_scene_is_said_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    std::fs::create_dir(folder.path().join("folder.ply")).unwrap();
    for (path, why) in [
        (path("a.stl", "solid"), "unknown scene format"),
        (path("noextension", ""), "unknown scene format"),
        (folder.path().join("missing.glb"), "cannot read"),
        (folder.path().join("nowhere/missing.obj"), "cannot read"),
        (folder.path().join("folder.ply"), "is a folder"),
        (path("empty.obj", ""), "holds no triangles"),
        (path("lines.obj", "v 0 0 0\nv 1 1 1\nl 1 2\n"), "holds no triangles; left out: 1 points and lines"),
        (path("empty.gltf", "{\"asset\":{\"version\":\"2.0\"}}"), "holds no triangles"),
        (path("empty.glb", ""), "not valid glTF JSON"),
        (path("empty.ply", ""), "not a PLY file"),
        (
            path(
                "points.ply",
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
            ),
            "holds no triangles",
        ),
    ] {
        let error = import(&path).unwrap_err().to_string();
        assert!(error.contains(why) && error.lines().count() == 1, "{error}\nwanted: {why}");
        assert!(error.contains(folder.path().to_str().unwrap()), "{error} names no file");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn gltf_survives(changes in changes()) {
        survive("a.gltf", &damaged(gltf(), &changes), &[]);
    }

    #[test]
    fn glb_survives(changes in changes()) {
        survive("a.glb", &damaged(glb(), &changes), &[]);
    }

    #[test]
    fn obj_survives(changes in changes()) {
        survive("a.obj", &damaged(OBJ.as_bytes().to_vec(), &changes), &[("m.mtl", MTL.as_bytes()), ("a.png", &png())]);
    }

    #[test]
    fn mtl_survives(changes in changes()) {
        let mtl = damaged(MTL.as_bytes().to_vec(), &changes);
        survive("a.obj", OBJ.as_bytes(), &[("m.mtl", &mtl), ("a.png", &png())]);
    }

    #[test]
    fn images_survive(changes in changes()) {
        let image = damaged(png(), &changes);
        survive("a.obj", OBJ.as_bytes(), &[("m.mtl", MTL.as_bytes()), ("a.png", &image)]);
    }

    #[test]
    fn ply_survives(changes in changes(), binary: bool) {
        let bytes = if binary { binary_ply() } else { PLY.as_bytes().to_vec() };
        survive("a.ply", &damaged(bytes, &changes), &[]);
    }
}
