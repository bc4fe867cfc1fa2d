use super::*;

fn import_bytes(bytes: &[u8]) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    std::fs::write(&path, bytes).unwrap();
    import(&path).map_err(|error| error.to_string())
}

/// A quad and a triangle with normals, uvs, colours, a list and an element that nobody knows.
const ASCII: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 5\nproperty double x\nproperty float y\n\
    property float z\nproperty list uchar short extra\nproperty float nx\nproperty float ny\nproperty float nz\n\
    property float s\nproperty float t\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    element thing 2\nproperty int a\nproperty list uint double b\n\
    element face 3\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0  0  0 0 1  0 0  255 0 0\n1 0 0  2 7 8  0 0 1  1 0  0 255 0\n1 1 0  0  0 0 1  1 1  0 0 255\n\
    0 1 0  1 5  0 0 1  0 1  9 9 9\n0.1 0 1e3  0  0 0 1  0.25 0.75  1 2 3\n\
    7 0\n8 2 0.5 0.5\n\
    0 4 0 1 2 3\n1 3 0 1 4\n0 2 0 1\n";

/// The same as [`ASCII`], binary.
fn binary(big: bool) -> Vec<u8> {
    let (head, body) = ASCII.split_once("end_header\n").unwrap();
    let form = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut out = (head.replace("ascii", form) + "end_header\n").into_bytes();
    let mut words = body.split_whitespace();
    let mut put = |out: &mut Vec<u8>, kind: Number| -> f64 {
        let value: f64 = words.next().unwrap().parse().unwrap();
        let mut bytes = match kind {
            Number::U8 => vec![value as u8],
            Number::I16 => (value as i16).to_le_bytes().to_vec(),
            Number::I32 => (value as i32).to_le_bytes().to_vec(),
            Number::U32 => (value as u32).to_le_bytes().to_vec(),
            Number::F32 => (value as f32).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        };
        if big {
            bytes.reverse();
        }
        out.extend(bytes);
        value
    };
    let header = Header::parse(ASCII.as_bytes()).unwrap();
    for element in &header.elements {
        for _ in 0..element.count {
            for property in &element.properties {
                let count = property.length.map_or(1, |length| put(&mut out, length) as usize);
                for _ in 0..count {
                    put(&mut out, property.number);
                }
            }
        }
    }
    out
}

fn check(scene: &Scene) {
    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(primitive.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 4]]);
    assert_eq!(primitive.positions[4], DVec3::new(0.1, 0.0, 1000.0));
    assert_eq!(primitive.normals[2], [0.0, 0.0, 1.0]);
    assert_eq!(primitive.uvs[4], [0.25, 0.25]);
    assert_eq!(primitive.colors[..2], [[255, 0, 0, 255], [0, 255, 0, 255]]);
    assert_eq!(scene.dropped, [("faces with fewer than three corners", 1)]);
    assert_eq!(scene.warnings, ["the elements 'thing' are not read"]);
    assert_eq!(scene.materials[0].base_color, [1.0; 4]);
}

#[test]
fn all_three_encodings_read_alike() {
    check(&import_bytes(ASCII.as_bytes()).unwrap());
    check(&import_bytes(ASCII.replace('\n', "\r\n").as_bytes()).unwrap());
    check(&import_bytes(&binary(false)).unwrap());
    check(&import_bytes(&binary(true)).unwrap());
}

#[test]
fn float_and_deep_colours_become_codes() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        property float red\nproperty ushort green\nproperty float blue\nproperty float alpha\n\
        element face 1\nproperty list uchar int vertex_index\nend_header\n\
        0 0 0 0.5 65535 -1 1\n1 0 0 1.5 257 nan 0.25\n0 1 0 0 0 0 0\n3 0 1 2\n";
    let scene = import_bytes(ply.as_bytes()).unwrap();
    assert_eq!(scene.meshes[0].primitives[0].colors, [[128, 255, 0, 255], [255, 1, 0, 64], [0; 4]]);
}

#[test]
fn not_a_number_stays_for_the_clean_up_to_count() {
    let ply = ASCII.replace("0.1 0 1e3", "nan inf -inf");
    let scene = import_bytes(ply.as_bytes()).unwrap();
    assert!(scene.meshes[0].primitives[0].positions[4].x.is_nan());
}

#[test]
fn faults_are_named_with_their_place() {
    let with = |from: &str, to: &str| ASCII.replace(from, to).into_bytes();
    for (bytes, why) in [
        (with("0 4 0 1 2 3", "0 4 0 1 2 5"), "face 0: vertex index 5, but there are 5 vertices"),
        (with("0 4 0 1 2 3", "0 4 0 1 2 -1"), "face 0: vertex index -1"),
        (with("0 4 0 1 2 3", "0 4 0 1 2 1.5"), "face 0: vertex index 1.5"),
        (with("0 4 0 1 2 3", "0 -4 0 1 2 3"), "face 0: a list of -4 numbers"),
        (with("0 4 0 1 2 3", "0 1e9 0 1 2 3"), "a list of 1000000000 numbers does not fit"),
        (with("1 1 0  0", "1 x 0  0"), "line 26: \"x\" is not a number"),
        (with("vertex 5", "vertex 4000000000"), "claims 4000000000 vertices, more than"),
        (with("vertex 5", "vertex 100000"), "claims 100000 elements 'vertex' of at least 24 bytes"),
        (with("face 3", "face 18446744073709551615"), "claims 18446744073709551615 elements 'face'"),
        (with("face 3", "face many"), "the count is not a number"),
        (with("list uchar int", "list float int"), "unknown property type"),
        (with("property float y\n", ""), "have no x, y and z"),
        (with("vertex_indices", "corners"), "no list 'vertex_indices'"),
        (with("format ascii 1.0\n", ""), "no 'format' line"),
        (with("end_header\n", ""), "unknown header line"),
        (with("ply\n", "plx\n"), "not a PLY file"),
        (Vec::new(), "not a PLY file"),
        (b"ply\nformat ascii 1.0\n".to_vec(), "no 'end_header'"),
        (ASCII.as_bytes()[..ASCII.len() - 8].to_vec(), "truncated"),
        (binary(false)[..binary(false).len() - 30].to_vec(), "truncated"),
    ] {
        let error = import_bytes(&bytes).unwrap_err();
        assert!(error.contains(why), "{error}\nwanted: {why}");
    }
}

#[test]
fn a_million_empty_elements_cost_nothing() {
    let ply = ASCII.replace("element face", "element air 18446744073709551615\nelement face");
    check(&import_bytes(ply.as_bytes()).unwrap());
}

#[test]
fn vertices_without_properties_are_not_passed_over() {
    let empty = ASCII.replace("element vertex 5", "element vertex 3\nelement vertex 5");
    for ply in [empty.clone(), empty.replace("element vertex 5\n", "element vertex 5\nelement vertex 9\n")] {
        let error = import_bytes(ply.as_bytes()).unwrap_err();
        assert!(error.contains("the vertices have no x, y and z"), "{error}");
    }
    let nothing_else = "ply\nformat ascii 1.0\nelement vertex 3\nelement face 1\nproperty list uchar int vertex_indices\n\
        end_header\n3 0 1 2\n";
    assert!(import_bytes(nothing_else.as_bytes()).unwrap_err().contains("no x, y and z"));
    let faces = ASCII.replace("element face 3", "element face 9\nelement face 3");
    assert!(import_bytes(faces.as_bytes()).unwrap_err().contains("no list 'vertex_indices'"));
}
