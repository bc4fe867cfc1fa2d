//! Bad input of every kind, through the built binary: one line that says what and where, exit code 1, no file left behind, in bounded
//! time (`support` ends what hangs) and bounded memory (the system's own limit).

#![cfg(unix)]

use crate::support::{Folder, Outcome, PLY, Tessera, skipped};
use std::fs;
use std::os::unix::fs::symlink;

/// What a case may reserve: address space, of which threads and libraries take the most. Everything small renders within it.
const MEMORY: &str = "ulimit -v 1048576";

/// A run with few threads, each of which would reserve address space of its own.
fn bounded<'a>(prelude: &str, args: impl IntoIterator<Item = &'a str>) -> Tessera {
    let calm = |run: Tessera, name| run.env(name, "1");
    ["MALLOC_ARENA_MAX", "RAYON_NUM_THREADS", "TOKIO_WORKER_THREADS"]
        .into_iter()
        .fold(Tessera::behind(prelude, args), calm)
}

/// Renders each file and expects its words on the one line; nothing may be left in the folder that was not there before.
#[track_caller]
fn check(folder: &Folder, cases: &[(&str, &[&str])]) {
    let before = folder.names();
    for (file, says) in cases {
        let outcome = render(folder, file).run();
        let words = outcome.stderr.clone();
        outcome.fails(1, &[&[*file], *says].concat());
        assert!(words.len() < 700, "{file}: an error is a line, not a page: {words}");
        assert_eq!(folder.names(), before, "{file}: something was left behind");
    }
}

fn render(folder: &Folder, scene: &str) -> Tessera {
    bounded(MEMORY, ["render", scene, "--out", "out.png", "--size", "8x8"]).within(folder.path())
}

/// A file, changes of the sound one, and what the error says.
type Case<'a> = (&'a str, &'a [(&'a str, &'a str)], &'a [&'a str]);

/// A glTF triangle; `changes` replace parts of its text.
fn gltf(changes: &[(&str, &str)]) -> String {
    const SOUND: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],
"buffers":[{"byteLength":42,"uri":"data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA"}]}"#;
    changes.iter().fold(SOUND.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from} is not in the fixture");
        text.replacen(from, to, 1)
    })
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

/// An OBJ file whose material has a texture.
fn textured(folder: &Folder, name: &str, image: &[u8]) {
    folder.write(&format!("{name}.png"), image);
    folder.write(&format!("{name}.mtl"), format!("newmtl m\nmap_Kd {name}.png\n"));
    folder.write(
        &format!("{name}.obj"),
        format!("mtllib {name}.mtl\nusemtl m\n{TRIANGLE}vt 0 0\nf 1/1 2/1 3/1\n"),
    );
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height).write_to(&mut bytes, image::ImageFormat::Png).expect("a PNG");
    bytes.into_inner()
}

/// A small PNG file whose header claims another size, its checksum made right.
fn bomb(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = png(1, 1);
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    let crc = !bytes[12..29].iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| crc >> 1 ^ (0xEDB8_8320 & 0_u32.wrapping_sub(crc & 1)))
    });
    bytes[29..33].copy_from_slice(&crc.to_be_bytes());
    bytes
}

#[test]
fn the_fixtures_are_sound() {
    let folder = Folder::new();
    folder.write("a.gltf", gltf(&[]));
    folder.write("a.ply", PLY);
    textured(&folder, "a", &png(3, 2));
    for scene in ["a.gltf", "a.ply", "a.obj"] {
        render(&folder, scene).run().ok();
    }
}

#[test]
fn files_that_are_none() {
    let folder = Folder::new();
    fs::create_dir(folder.file("folder.obj")).expect("a folder");
    for (link, target) in [
        ("zero.ply", "/dev/zero"),
        ("random.glb", "/dev/urandom"),
        ("zero.tpack", "/dev/zero"),
        ("zero.toml", "/dev/zero"),
        ("dangling.obj", "nowhere.obj"),
        ("loop.obj", "loop.obj"),
    ] {
        symlink(target, folder.file(link)).expect("a link");
    }
    check(
        &folder,
        &[
            ("gone.gltf", &["cannot read", "No such file"]),
            ("folder.obj", &["is a folder; name a file"]),
            ("zero.ply", &["not a regular file; name a file"]),
            ("random.glb", &["not a regular file"]),
            ("zero.tpack", &["not a regular file"]),
            ("zero.toml", &["not a regular file"]),
            ("dangling.obj", &["cannot read", "No such file"]),
            ("loop.obj", &["cannot read", "symbolic links"]),
        ],
    );

    let closed = folder.write("closed.obj", TRIANGLE);
    let permissions = std::os::unix::fs::PermissionsExt::from_mode(0o000);
    fs::set_permissions(&closed, permissions).expect("a file of ours");
    if fs::File::open(&closed).is_ok() {
        return skipped("this user may read every file, so no file is unreadable");
    }
    check(&folder, &[("closed.obj", &["cannot read", "Permission denied"])]);
}

#[test]
fn names_that_are_no_text_are_shown_plain() {
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::new();
    for name in [&b"bad\xff.obj"[..], b"two\nlines\x1b[2J.obj"] {
        let name = std::ffi::OsStr::from_bytes(name);
        fs::write(folder.path().join(name), "f 1 2 3\n").expect("a file");
        let run = Tessera::new([std::ffi::OsStr::new("render"), name]).args(["--out", "a.png"]);
        let outcome = run.within(folder.path()).run();
        let plain = !outcome.stderr.trim_end().contains(char::is_control);
        assert!(plain, "{outcome:?}");
        outcome.fails(1, &["line 1: position 1 does not exist"]);
    }
}

#[test]
fn hostile_obj_files() {
    let folder = Folder::new();
    let obj = |name: &str, text: &str| folder.write(name, format!("{TRIANGLE}{text}"));
    obj("huge.obj", "f 1 2 1000000000\n");
    obj("negative.obj", "f 1 2 -9\n");
    obj("zero.obj", "f 0 1 2\n");
    obj("word.obj", "f a b c\n");
    obj("long.obj", &format!("f {}\n", "1 2 3 ".repeat(400_000)));
    obj("same.obj", "f 1 1 1\nf 1 1 2\n");
    obj("parts.obj", &"g\nf 1 2 3\n".repeat(600_000));
    obj("escape.obj", "v \x1b[2J 0 0\n");
    folder.write("nan.obj", "v nan 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n");
    folder.write("far.obj", "v 1e300 0 0\nv -1e300 0 0\nv 0 1 0\nf 1 2 3\n");
    folder.write("tiny.obj", "v 1e-300 0 0\nv -1e-300 0 0\nv 0 1e-300 0\nf 1 2 3\n");
    folder.write("bytes.obj", (0..=255).collect::<Vec<u8>>().repeat(100));
    check(
        &folder,
        &[
            ("huge.obj", &["line 4: position 1000000000 does not exist; 3 are defined"]),
            ("negative.obj", &["line 4: position -9 does not exist"]),
            ("zero.obj", &["line 4: position 0 does not exist"]),
            ("word.obj", &["line 4: \"a\" is not a corner"]),
            ("long.obj", &["line 4: a face of more than 1048576 corners"]),
            ("same.obj", &["no triangle is left", "2 repeated_index", "mend the file"]),
            ("parts.obj", &["more than 1048576 groups, materials and parts; merge some"]),
            ("escape.obj", &["line 4: \"\\u{1b}[2J\" is not a number"]),
            ("nan.obj", &["no triangle is left", "1 vertex_not_finite"]),
            ("far.obj", &["coordinates up to 1e30 are supported: scale the scene down"]),
            ("tiny.obj", &["scale the scene up"]),
            ("bytes.obj", &["holds no triangles; name a file with surfaces"]),
        ],
    );
}

#[test]
fn hostile_ply_files() {
    let folder = Folder::new();
    let head =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let list = "element face 1\nproperty list uint int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n";
    let ply = |name: &str, body: &str| folder.write(name, format!("{head}{list}{body}"));
    ply("index.ply", "3 0 1 3\n");
    ply("fraction.ply", "3 0 1 1.5\n");
    ply("negative.ply", "-3 0 1 2\n");
    ply("many.ply", "1e18 0 1 2\n");
    ply("nan.ply", "nan 0 1 2\n");
    ply("cut.ply", "3 0 1\n");
    folder.write("count.ply", PLY.replace("vertex 5", "vertex 1152921504606846976"));
    folder.write("faces.ply", PLY.replace("face 2", "face 18446744073709551615"));
    folder.write("number.ply", PLY.replace("vertex 5", "vertex 18446744073709551616"));
    folder.write("float.ply", head.replace("property float x", "property list float float x"));
    folder.write("empty.ply", PLY.replace("vertex 5", "vertex 0").replace("face 2", "face 0"));
    folder.write("head.ply", format!("ply\nformat ascii 1.0\n{}", "comment\n".repeat(1 << 20)));
    check(
        &folder,
        &[
            ("index.ply", &["face 0: vertex index 3, but there are 3 vertices"]),
            ("fraction.ply", &["vertex index 1.5"]),
            ("negative.ply", &["a list of -3 numbers does not fit"]),
            ("many.ply", &["a list of 1000000000000000000 numbers does not fit", "truncated or damaged"]),
            ("nan.ply", &["a list of NaN numbers does not fit"]),
            ("cut.ply", &["truncated"]),
            ("count.ply", &["claims 1152921504606846976 vertices, more than the 134217728"]),
            ("faces.ply", &["claims 18446744073709551615 elements 'face'", "truncated"]),
            ("number.ply", &["line 3: the count is not a number"]),
            ("float.ply", &["line 4: unknown property type"]),
            ("empty.ply", &["holds no triangles"]),
            ("head.ply", &["has no 'end_header' line"]),
        ],
    );
}

#[test]
fn hostile_gltf_files() {
    let folder = Folder::new();
    let count = r#""count":3,"type":"VEC3""#;
    let view = r#""buffer":0,"byteLength":36"#;
    let sparse = r#""count":3,"type":"VEC3","sparse":{"count":2305843009213693952,"indices":{"bufferView":1,"componentType":5123},"values":{"bufferView":0}}"#;
    let cases: [Case<'_>; 17] = [
        (
            "count.gltf",
            &[(count, r#""count":4611686018427387904,"type":"VEC3""#)],
            &["accessors[0] claims 4611686018427387904"],
        ),
        ("sparse.gltf", &[(count, sparse)], &["accessors[0] (sparse) replaces 2305843009213693952 of 3"]),
        (
            "stride0.gltf",
            &[(view, r#""buffer":0,"byteLength":36,"byteStride":0"#)],
            &["accessors[0] has elements of 12 bytes every 0"],
        ),
        (
            "stride.gltf",
            &[(view, r#""buffer":0,"byteLength":36,"byteStride":9223372036854775807"#)],
            &["accessors[0] claims 3 elements"],
        ),
        (
            "view.gltf",
            &[(view, r#""buffer":0,"byteLength":36,"byteOffset":18446744073709551615"#)],
            &["needs bufferViews[0]"],
        ),
        ("buffer.gltf", &[(view, r#""buffer":9,"byteLength":36"#)], &["needs buffers[9], but there are 1"]),
        (
            "short.gltf",
            &[(r#""byteLength":42"#, r#""byteLength":43"#)],
            &["buffers[0] claims 43 bytes but has 42"],
        ),
        (
            "index.gltf",
            &[("AAABAAIA", "AAABAP//")],
            &["indices: number 2 is 65535, but there are 3 vertices"],
        ),
        (
            "nan.gltf",
            &[("AAAAAAAAAAAAAAAAAACAPw", "AADAfwAAAAAAAAAAAACAPw")],
            &["no triangle is left", "vertex_not_finite"],
        ),
        (
            "own.gltf",
            &[(r#""mesh":0"#, r#""mesh":0,"children":[0]"#)],
            &["nodes[0]", "the node tree has a cycle"],
        ),
        (
            "ring.gltf",
            &[(r#"{"mesh":0}"#, r#"{"mesh":0},{"children":[2]},{"children":[1]}"#)],
            &["nodes[1]", "cycle"],
        ),
        ("node.gltf", &[(r#""nodes":[0]"#, r#""nodes":[7]"#)], &["scenes[0] names node 7"]),
        (
            "material.gltf",
            &[(r#""indices":1"#, r#""indices":1,"material":3"#)],
            &["names material 3, but there are 0"],
        ),
        (
            "required.gltf",
            &[(r#""scene":0"#, r#""scene":0,"extensionsRequired":["KHR_draco_mesh_compression"]"#)],
            &["KHR_draco_mesh_compression", "export the file without it"],
        ),
        ("base64.gltf", &[("base64,AAAA", "base64,?AAA")], &["has the byte 0x3f in its base64 text"]),
        (
            "matrix.gltf",
            &[(r#""mesh":0"#, r#""mesh":0,"scale":[1e39,1,1]"#)],
            &["nodes[0] has a transform that is not finite"],
        ),
        (
            "flat.gltf",
            &[(r#""mesh":0"#, r#""mesh":0,"scale":[0,0,0]"#)],
            &["no triangle is left", "1 collapsed"],
        ),
    ];
    for (name, changes, says) in cases {
        folder.write(name, gltf(changes));
        check(&folder, &[(name, says)]);
    }

    let nodes = |nodes: String, roots: String| {
        gltf(&[
            (r#"[{"mesh":0}]"#, &format!("[{nodes}]")),
            (r#""nodes":[0]"#, &format!("\"nodes\":[{roots}]")),
        ])
    };
    let list =
        |count: usize, item: &dyn Fn(usize) -> String| (0..count).map(item).collect::<Vec<_>>().join(",");
    folder.write(
        "deep.gltf",
        nodes(list(100_000, &|i| format!(r#"{{"children":[{}]}}"#, i + 1)) + r#",{"mesh":0}"#, "0".into()),
    );
    // 60,000 uses of a list of 30,000 corners: a small file that asks for 600 million triangles.
    let corners = "AAABAAIA".repeat(10_000);
    let flood = nodes(list(60_000, &|_| r#"{"mesh":0}"#.into()), list(60_000, &|i| i.to_string()))
        .replace(r#""count":3,"type":"SCALAR""#, r#""count":30000,"type":"SCALAR""#)
        .replace(r#"{"buffer":0,"byteOffset":36,"byteLength":6}"#, r#"{"buffer":1,"byteLength":60000}"#)
        .replace(r#""buffers":["#, &format!(r#""buffers":[{{"byteLength":36,"uri":"data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}},{{"byteLength":60000,"uri":"data:;base64,{corners}"}},"#));
    folder.write("flood.gltf", flood);
    folder.write("nested.gltf", format!(r#"{{"asset":{{"version":"2.0"}},"extras":{}"#, "[".repeat(1 << 20)));
    folder.write("array.gltf", "[]");
    folder.write("cut.gltf", &gltf(&[])[..300]);
    let glb = |length: u32, chunk: u32| {
        let json = gltf(&[]).into_bytes();
        [b"glTF\x02\0\0\0".as_slice(), &length.to_le_bytes(), &chunk.to_le_bytes(), b"JSON", &json].concat()
    };
    folder.write("header.glb", glb(u32::MAX, 8));
    folder.write("chunk.glb", glb(20 + gltf(&[]).len() as u32, u32::MAX));
    check(
        &folder,
        &[
            ("deep.gltf", &["lies deeper than 4096 levels; flatten the node tree"]),
            ("flood.gltf", &["more than 134217728 triangles or vertices after instancing"]),
            ("nested.gltf", &["not valid glTF JSON"]),
            ("array.gltf", &["not valid glTF JSON", "expected a glTF object"]),
            ("cut.gltf", &["not valid glTF JSON", "EOF"]),
            ("header.glb", &["claims 4294967295 bytes in its GLB header"]),
            ("chunk.glb", &["has a GLB chunk of 4294967295 bytes"]),
        ],
    );
}

/// A hundred thousand cameras of one name are a second of work, not the square of it.
#[test]
fn names_in_great_number_take_no_time() {
    let folder = Folder::new();
    let cameras = r#"{"camera":0,"name":"a"},"#.repeat(100_000);
    let roots: String = (0..=100_000).map(|i| format!("{i},")).collect();
    let text = gltf(&[
        (
            r#"[{"mesh":0}]"#,
            &format!(
                r#"[{cameras}{{"mesh":0}}],"cameras":[{{"type":"perspective","perspective":{{"yfov":0.7,"znear":0.1}}}}]"#
            ),
        ),
        (r#""nodes":[0]"#, &format!("\"nodes\":[{}]", roots.trim_end_matches(','))),
    ]);
    folder.write("cameras.gltf", text);
    let run = render(&folder, "cameras.gltf").args(["--camera", "b"]).run();
    let words = run.stderr.clone();
    run.fails(2, &["no camera `b`", "\"a\", \"a 2\"", "and 99988 more"]);
    assert!(words.len() < 700, "{words}");
    render(&folder, "cameras.gltf").args(["--camera", "a 100000"]).run().ok();
}

#[test]
fn references_that_lead_out() {
    let outer = Folder::new();
    let folder = Folder::new();
    outer.write("secret.bin", [0; 64]);
    symlink(outer.file("secret.bin"), folder.file("link.bin")).expect("a link");
    symlink("/dev/zero", folder.file("zero.bin")).expect("a link");
    let absolute = outer.file("secret.bin").display().to_string();
    let uris: [(&str, &str); 12] = [
        ("../secret.bin", "leads out of the source's folder; put the file into that folder"),
        ("%2e%2e/secret.bin", "leads out"),
        ("%2E%2E%2Fsecret.bin", "leads out"),
        ("..\\\\secret.bin", "leads out"),
        ("link.bin", "leads out"),
        ("zero.bin", "leads out"),
        ("file:///etc/passwd", "names the scheme 'file:'"),
        ("http://127.0.0.1:1/a.bin", "names the scheme 'http:'"),
        (&absolute, "is an absolute path"),
        ("%2Fetc%2Fpasswd", "is an absolute path"),
        (".", "is a folder"),
        ("gone.bin", "cannot be read: there is no such file"),
    ];
    let data = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA";
    for (uri, says) in uris {
        folder.write("a.gltf", gltf(&[(data, uri)]));
        check(&folder, &[("a.gltf", &["reference \"", says])]);
    }
    // The same through an OBJ file's library, a library's image and a scene file's sky.
    folder.write("library.obj", format!("mtllib ../a.mtl\n{TRIANGLE}f 1 2 3\n"));
    folder.write("a.mtl", "newmtl m\nmap_Kd ../a.png\n");
    folder.write("image.obj", format!("mtllib a.mtl\nusemtl m\n{TRIANGLE}f 1 2 3\n"));
    folder.write("a.ply", PLY);
    folder.write("sky.toml", "source = \"a.ply\"\n[environment]\nimage = \"/etc/passwd\"\n");
    check(
        &folder,
        &[
            ("library.obj", &["reference \"../a.mtl\" leads out"]),
            ("image.obj", &["reference \"../a.png\" leads out"]),
            ("sky.toml", &["reference \"/etc/passwd\" is an absolute path"]),
        ],
    );
}

#[test]
fn hostile_images() {
    let folder = Folder::new();
    textured(&folder, "wide", &bomb(50_000, 50_000));
    textured(&folder, "large", &bomb(16_384, 16_384));
    textured(&folder, "none", &bomb(0, 1));
    textured(&folder, "cut", &png(64, 64)[..60]);
    textured(&folder, "text", b"hello");
    textured(&folder, "empty", b"");
    textured(&folder, "chunk", &[&png(1, 1)[..8], &[0xff; 64]].concat());
    // Within every limit, and more than this run may take.
    textured(&folder, "room", &bomb(8192, 8192));
    let image = |name: &str| format!("the image \"{name}.png\"");
    check(
        &folder,
        &[
            ("wide.obj", &[&image("wide"), "more than the 16384 texels a side", "scale it down"]),
            ("large.obj", &[&image("large"), "has 16384 x 16384 texels", "scale it down"]),
            ("none.obj", &[&image("none"), "cannot be decoded", "export it again"]),
            ("cut.obj", &[&image("cut"), "cannot be decoded", "truncated or damaged: export it again"]),
            ("text.obj", &[&image("text"), "neither PNG nor JPEG; convert it"]),
            ("empty.obj", &[&image("empty"), "is empty"]),
            ("chunk.obj", &[&image("chunk"), "cannot be decoded"]),
        ],
    );
    let args = ["render", "room.obj", "--out", "a.png"];
    bounded("ulimit -v 500000", args)
        .within(folder.path())
        .run()
        .fails(1, &[&image("room"), "bytes to decode, more than the memory that is left; scale it down"]);
}

#[test]
fn hostile_scene_files() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let toml = |name: &str, text: &str| folder.write(name, text);
    let with = |name: &str, text: &str| folder.write(name, format!("source = \"a.ply\"\n{text}"));
    toml("self.toml", "source = \"self.toml\"\n");
    toml("nothing.toml", "");
    toml("device.toml", "source = \"/dev/zero\"\n");
    toml("gone.toml", "source = \"gone.ply\"\n");
    toml("trillion.toml", "[generate]\nkind = \"city\"\ntriangles = 1000000000000\n");
    toml("billions.toml", "[generate]\nkind = \"city\"\ntriangles = 4000000000\n");
    toml("nested.toml", &format!("a = {}", "[".repeat(100_000)));
    toml("dotted.toml", &format!("{}b = 1", "a.".repeat(100_000)));
    toml("long.toml", &"#".repeat((1 << 20) + 1));
    with("key.toml", "colour = 1\n");
    with("eye.toml", "[[camera]]\nname = \"a\"\neye = [nan, 0, 0]\ntarget = [0, 0, 0]\nfov = 60\n");
    with("view.toml", "[[camera]]\nname = \"a\"\neye = [0, 0, 0]\ntarget = [0, 0, 0]\nfov = 60\n");
    with("fov.toml", "[[camera]]\nname = \"a\"\neye = [0, 0, 5]\ntarget = [0, 0, 0]\nfov = 180\n");
    with("light.toml", "[[light]]\nkind = \"point\"\nposition = [1e308, 0, 0]\nintensity = 1\n");
    with("ground.toml", "[ground]\nsize = 1e308\n");
    with("checker.toml", "[ground]\nsize = 100\nchecker = 0.0001\n");
    with("camera.toml", "default_camera = \"north\"\n");
    check(
        &folder,
        &[
            ("self.toml", &["line 1, column 10", "`source` is a scene file itself"]),
            ("nothing.toml", &["neither `source` nor [generate]"]),
            ("device.toml", &["line 1, column 10", "`source` not found"]),
            ("gone.toml", &["gone.ply", "TESSERA_SCENES"]),
            ("trillion.toml", &["line 3, column 13", "1000000000000"]),
            ("billions.toml", &["triangles = 4000000000 is out of range; ask for 1000 to"]),
            ("nested.toml", &["recurs"]),
            ("dotted.toml", &["recurs"]),
            ("long.toml", &["1048577 bytes, more than the 1048576"]),
            ("key.toml", &["line 2, column 1", "unknown field `colour`"]),
            ("eye.toml", &["line 2, column 1", "must be finite numbers"]),
            ("view.toml", &["eye and target are the same point"]),
            ("fov.toml", &["between 0 and 180"]),
            ("light.toml", &["line 2, column 1", "[[light]]: position must be numbers up to 1e30"]),
            ("ground.toml", &["coordinates up to 1e30 are supported"]),
            ("checker.toml", &["[ground]: checker must be at most"]),
            ("camera.toml", &["\"north\": no such camera; there is none"]),
        ],
    );
}

/// Packs whose hash is right and whose content is not.
#[test]
fn hostile_bundles() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    Tessera::new(["scene", "pack", "a.ply", "--out", "a.tpack"]).within(folder.path()).run().ok();
    let sound = fs::read(folder.file("a.tpack")).expect("it was written");
    let long = |at: usize| u64::from_le_bytes(sound[at..at + 8].try_into().expect("8 bytes")) as usize;
    let sections = u32::from_le_bytes(sound[12..16].try_into().expect("4 bytes")) as usize;
    let start = |name: &str| {
        let entry = (0..sections).map(|i| 64 + 24 * i).find(|&at| sound[at..].starts_with(name.as_bytes()));
        long(entry.expect("the section is there") + 8)
    };
    let changed = |at: usize, bytes: &[u8]| {
        let mut pack = sound.clone();
        pack[at..at + bytes.len()].copy_from_slice(bytes);
        let mut hasher = blake3::Hasher::new();
        hasher.update(&pack[..32]).update(&pack[64..]);
        let hash = hasher.finalize();
        pack[32..64].copy_from_slice(hash.as_bytes());
        pack
    };
    // The second entry of the section table: 8 bytes of name, then offset and length.
    let second = 64 + 24;
    for (name, bytes, says) in [
        ("version.tpack", changed(8, &[9]), "version 9"),
        ("sections.tpack", changed(12, &[255; 4]), "section"),
        ("offset.tpack", changed(second + 8, &[255; 8]), "section"),
        ("length.tpack", changed(second + 16, &[255; 8]), "section"),
        ("face.tpack", changed(start("face"), &[255; 4]), "face"),
        ("tree.tpack", changed(start("kdslot"), &[0xaa; 8]), "kd"),
        ("head.tpack", changed(start("head"), &[255; 8]), "head"),
        ("hash.tpack", [&sound[..40], &[0; 8], &sound[48..]].concat(), "damaged"),
        ("cut.tpack", sound[..sound.len() - 1].to_vec(), "truncated"),
    ] {
        folder.write(name, bytes);
        check(&folder, &[(name, &[says])]);
    }
}

#[test]
fn places_that_cannot_be_written() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    symlink("/dev/full", folder.file("full.png")).expect("a link");
    fs::create_dir(folder.file("folder.png")).expect("a folder");
    let before = folder.names();
    let write = |out: &str, says: &[&str]| {
        let run =
            Tessera::new(["render", "a.ply", "--out", out, "--size", "8x8"]).within(folder.path()).run();
        run.fails(1, says);
        assert_eq!(folder.names(), before, "{out}");
    };
    write("no/a.png", &["the folder no does not exist; create it first"]);
    write("a.ply/a.png", &["the folder a.ply is not a folder; name another"]);
    write("folder.png", &["is a folder; give a file name inside it"]);
    write("full.png", &["not a plain file"]);
    write(&format!("{}.png", "a".repeat(300)), &["cannot write", "os error"]);

    // A limit on the size of files stands in for a disk that fills up while a file is written.
    let full = "trap '' XFSZ; ulimit -f 1";
    for args in [
        ["render", "a.ply", "--out", "a.exr", "--size", "256x256"].as_slice(),
        &["scene", "pack", "large.toml", "--out", "a.tpack"],
        &["render", "a.ply", "--out", "a.png", "--size", "2048x2048"],
    ] {
        folder.write("large.toml", "[generate]\nkind = \"cornell\"\ntriangles = 2000\n");
        let before = folder.names();
        Tessera::behind(full, args)
            .within(folder.path())
            .run()
            .fails(1, &["cannot write a.", "File too large"]);
        assert_eq!(folder.names(), before, "{args:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    fs::create_dir(folder.file("disk")).expect("a folder");
    // A file system of its own, seen by this process alone.
    let mount = "mount -t tmpfs -o size=64k none disk";
    let mut probe = std::process::Command::new("unshare");
    probe.args(["-rm", "sh", "-c", mount]).current_dir(folder.path()).stderr(std::process::Stdio::null());
    if !probe.status().is_ok_and(|status| status.success()) {
        return skipped("no file system can be mounted here (unshare -rm), so no disk is full");
    }
    let run = |fill: &str, size: &str| -> Outcome {
        // The shell lives on, to say what is left on the disk before it goes.
        let script = format!(
            "unshare -rm sh -c '{mount} && {{ head -c {fill} /dev/zero > disk/fill; \
             \"$0\" render a.ply --out disk/a.exr --size {size}; code=$?; ls -A disk > left; exit $code; }}' \"$0\"; exit $?; true"
        );
        Tessera::behind(&script, [""; 0]).within(folder.path()).run()
    };
    let left = || fs::read_to_string(folder.file("left")).expect("it was listed");
    // Room for the temporary file, and not for the picture; no room at all.
    run("60k", "256x256").fails(1, &["cannot write disk/a.exr", "No space left"]);
    assert_eq!(left(), "fill\n");
    run("64k", "256x256").fails(1, &["cannot write disk/a.exr", "No space left"]);
    assert_eq!(left(), "fill\n");
    assert_eq!(run("1k", "8x8").code, Some(0), "there is room for a small one");
    assert_eq!(left(), "a.exr\nfill\n");
}

#[test]
fn join_strings_that_are_none() {
    let folder = Folder::new();
    folder.write("text.txt", "hello\n");
    folder.write("empty.txt", "");
    folder.write("bytes.txt", [0xff; 8]);
    folder.write("a.ply", PLY);
    symlink("/dev/zero", folder.file("zero.txt")).expect("a link");
    let pipe = std::process::Command::new("mkfifo").arg(folder.file("pipe.txt")).status();
    assert!(pipe.expect("mkfifo runs").success());
    let before = folder.names();
    for (join, code, says) in [
        ("hello", 2, "this is no join string"),
        ("tessera1.127.0.0.1:1", 2, "cut off"),
        ("@gone.txt", 1, "cannot read gone.txt: No such file"),
        ("@text.txt", 1, "text.txt: this is no join string"),
        ("@empty.txt", 1, "empty.txt: "),
        ("@bytes.txt", 1, "cannot read bytes.txt"),
        ("@zero.txt", 1, "cannot read zero.txt: not a regular file"),
        ("@pipe.txt", 1, "cannot read pipe.txt: not a regular file"),
    ] {
        let run = |args: &[&str]| Tessera::new(args).within(folder.path()).run();
        run(&["worker", "--no-cache", "--join", join]).fails(code, &[says]);
        run(&["render", "a.ply", "--out", "a.png", "--size", "8x8", "--master", join]).fails(code, &[says]);
        assert_eq!(folder.names(), before, "{join}");
    }
}

#[test]
fn sizes_at_the_ends_of_their_ranges() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let run = |args: &str| {
        bounded(MEMORY, ["render", "a.ply", "--out"].into_iter().chain(args.split(' ')))
            .within(folder.path())
            .run()
    };
    for (args, size) in [
        ("a.png --size 1x1", (1, 1)),
        ("a.png --size 20000x1", (20_000, 1)),
        ("a.png --size 1x20000 --workers 2", (1, 20_000)),
        ("a.png --size 5x3 --tile 4294967295", (5, 3)),
        ("a.png --size 65536x1 --tile 65536", (65_536, 1)),
    ] {
        run(args).ok();
        assert_eq!(image::image_dimensions(folder.file("a.png")).expect("a PNG"), size, "{args}");
    }
    run("b.exr --size 16384x16384").fails(1, &["16384 x 16384", "9663676416 bytes", "choose a smaller size"]);
    let view = "b.png --size 8x8 --eye 0,0,5 --target 0,0,0 --fov";
    run(&format!("{view} 1e-300")).fails(2, &["the camera cannot be used", "field of view"]);
    run(&format!("{view} nan")).fails(2, &["--fov"]);
    run(&format!("{view} 180")).fails(2, &["--fov"]);
    assert_eq!(folder.names(), ["a.ply", "a.png"]);
}

#[test]
fn a_stderr_that_cannot_be_written_to_is_no_panic() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    for (redirect, scene, code) in [
        ("exec 2>/dev/full", "gone.ply", 1),
        ("exec 2>&-", "gone.ply", 1),
        ("exec 2>/dev/full", "a.ply", 0),
        ("exec 2>&-", "a.ply", 0),
    ] {
        for more in [[].as_slice(), &["-v"], &["--workers", "1", "-vv"]] {
            let args = ["render", scene, "--out", "a.png", "--size", "8x8", "--report", "report.json"];
            let outcome = Tessera::behind(redirect, args).args(more).within(folder.path()).run();
            assert_eq!(outcome.code, Some(code), "{redirect}, {scene}, {more:?}: {outcome:?}");
        }
    }
    let full = Tessera::behind("exec >/dev/full", ["scene", "info", "a.ply"]).within(folder.path()).run();
    full.fails(1, &["cannot write to stdout", "No space left"]);
}
