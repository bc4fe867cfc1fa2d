use super::*;
use crate::{AlphaMode, Wrap};

/// Writes `scene.obj` and other files into a folder and imports it.
fn import_files(obj: &str, files: &[(&str, &[u8])]) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.obj"), obj).unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    import(&folder.path().join("scene.obj")).map_err(|error| error.to_string())
}

fn import_mtl(mtl: &str) -> Result<Scene, String> {
    import_files("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n", &[("m.mtl", mtl.as_bytes())])
}

fn png(width: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let image = image::RgbaImage::from_raw(width, texels.len() as u32 / width, texels.concat()).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn polygons_groups_and_all_kinds_of_indices() {
    let scene = import_files(
        "\u{feff}# comment\nv 0 0 0\nv 1 0 0 1\nv 1 1 0\nv 0.1 1 0\nvt 0.25\nvt 0.5 0.75 0\nvn 0 0 1\n\
         f 1 2 3 4\no second thing\nusemtl a\nf -4/-2/-1 -3//1 \\\n 3/2\nusemtl b\nf 1/1 2/2/1 3\nusemtl a\nf 2 3 4\n\
         g empty\ng last\nf 1 2\nl 1 2\np 1\ns off\nf 4 3 2 \r\ncurv 0 1\n",
        &[],
    )
    .unwrap();
    let names: Vec<&str> = scene.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["", "second thing", "last"]);
    let first = &scene.meshes[0].primitives[0];
    assert_eq!(first.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(first.positions[3], DVec3::new(0.1, 1.0, 0.0));
    assert!(first.normals.is_empty() && first.uvs.is_empty() && first.colors.is_empty());

    let [a, b] = scene.meshes[1].primitives.as_slice() else { panic!("two parts") };
    assert_eq!(a.triangles, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!(a.positions[..3], [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0)]);
    // v counts from below in the file; a missing v is 0.
    assert_eq!(a.uvs[..3], [[0.25, 1.0], [0.0, 1.0], [0.5, 0.25]]);
    assert_eq!(a.normals[..3], [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0; 3]]);
    assert_eq!(b.normals, [[0.0; 3], [0.0, 0.0, 1.0], [0.0; 3]]);

    assert_eq!(scene.dropped, [("points and lines", 2), ("faces with fewer than three corners", 1)]);
    assert_eq!(scene.warnings[0], "statements 'curv' are not read");
    assert!(scene.warnings[1].contains("no material library has \"a\""));
    assert_eq!(scene.materials.len(), 1);
    assert_eq!(scene.materials[0].base_color, [0.8, 0.8, 0.8, 1.0]);
}

#[test]
fn vertex_colours() {
    let scene = import_files("v 0 0 0\nv 1 0 0 1 0.5 nan\nv 0 1 0 1 0 0 2\nf 1 2 3\n", &[]).unwrap();
    assert_eq!(scene.meshes[0].primitives[0].colors, [[255; 4], [255, 128, 0, 255], [0, 0, 255, 255]]);
}

#[test]
fn faults_are_named_with_their_line() {
    for (obj, why) in [
        ("v 0 0\n", "line 1: 'v' needs three numbers"),
        ("v 0 0 x\n", "line 1: \"x\" is not a number"),
        ("\nvn 0 0\n", "line 2: 'vn' needs three"),
        ("vt\n", "'vt' needs a number"),
        ("v 0 0 0\nf 1 1 2\n", "line 2: position 2 does not exist; 1 are defined"),
        ("v 0 0 0\nf 1 1 -2\n", "position -2 does not exist"),
        ("v 0 0 0\nf 1 1 0\n", "position 0 does not exist"),
        ("v 0 0 0\nf 1 1 -9223372036854775808\n", "does not exist"),
        ("v 0 0 0\nf 1 1 9223372036854775807\n", "does not exist"),
        ("v 0 0 0\nf 1 1 4294967296\n", "does not exist"),
        ("v 0 0 0\nf 1 1 99999999999999999999\n", "is not a corner"),
        ("v 0 0 0\nf 1/1 1 1\n", "texture coordinate 1 does not exist; 0 are"),
        ("v 0 0 0\nf 1//1 1 1\n", "normal 1 does not exist"),
        ("v 0 0 0\nf 1/// 1 1\n", "is not a corner"),
        ("v 0 0 0\nf 1///1 1 1\n", "is not a corner"),
        ("v 0 0 0\nf /1 1 1\n", "is not a corner"),
        ("mtllib ../m.mtl\n", "leads out of the source's folder"),
        ("mtllib ..\\m.mtl\n", "leads out of the source's folder"),
        ("mtllib file:///etc/passwd\n", "scheme 'file:'"),
        ("mtllib C:\\m.mtl\n", "scheme 'C:'"),
        ("mtllib\n", "not a file name"),
    ] {
        let error = import_files(obj, &[]).unwrap_err();
        assert!(error.contains(why), "{error}\nwanted: {why}");
    }
}

#[test]
fn libraries_may_come_late_be_several_and_have_spaces() {
    let obj =
        "usemtl two words\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nmtllib sub\\a b.mtl\nmtllib c.mtl d.mtl\n";
    let files: [(&str, &[u8]); 3] = [
        ("sub/a b.mtl", b"newmtl two words\nKd 1 0 0\n"),
        ("c.mtl", b"newmtl c\nnewmtl two words\n"),
        ("d.mtl", b"newmtl d\n"),
    ];
    let scene = import_files(obj, &files).unwrap();
    let names: Vec<&str> = scene.materials.iter().map(|material| material.name.as_str()).collect();
    assert_eq!(names, ["two words", "c", "d"]);
    assert_eq!(scene.materials[0].base_color, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(scene.meshes[0].primitives[0].material, 0);
    assert!(scene.warnings[0].contains("defined twice"));
}

#[test]
fn surfaces_follow_the_table() {
    let material = |mtl: &str| import_mtl(&format!("newmtl m\n{mtl}")).unwrap().materials[0].clone();
    let plain = material("Kd 0.5\nKa 1 1 1\nNs 30\nKs 0.1 0.2 0.3\nKe 4 5 6\n");
    assert_eq!((plain.base_color, plain.specular), ([0.5, 0.5, 0.5, 1.0], [0.1, 0.2, 0.3]));
    assert_eq!((plain.roughness, plain.emissive), (0.5, [4.0, 5.0, 6.0]));
    assert_eq!(material("Ks 1 1 1\nillum 1\n").specular, [0.0; 3]);
    assert_eq!(material("").base_color, [0.8, 0.8, 0.8, 1.0]);

    let mirror = material("Ks 0.9 0.9 0.9\nillum 3\n");
    assert_eq!((mirror.roughness, mirror.specular, mirror.transmission), (0.0, [0.9; 3], 0.0));

    let glass = material("Kd 0 0 0\nNi 1.5\nd 0.25\nTf 1 0.5 0\nillum 7\n");
    assert_eq!((glass.transmission, glass.ior, glass.alpha), (0.75, 1.5, AlphaMode::Opaque));
    assert_eq!((glass.base_color, glass.specular), ([0.75, 0.375, 0.0, 1.0], [0.040000003; 3]));
    assert!(!glass.thin_walled);
    assert_eq!(material("illum 4\nTf 1 1 1\n").transmission, 1.0);
    assert_eq!(material("illum 4\nNi 1.3\n").transmission, 1.0);
    assert_eq!(material("illum 4\nNi 1\n").transmission, 0.0);

    for half in ["d 0.5\n", "Tr 0.5\n", "d -halo 0.5\n"] {
        let faint = material(half);
        assert_eq!((faint.alpha, faint.base_color[3]), (AlphaMode::Blend, 0.5));
    }
}

#[test]
fn maps_with_options_alpha_and_opacity() {
    let solid = png(1, &[[10, 20, 30, 255]]);
    let cut = png(2, &[[1, 2, 3, 255], [4, 5, 6, 0]]);
    let grey = png(2, &[[0, 0, 0, 255], [90, 90, 90, 255], [255, 255, 255, 255], [30, 60, 90, 255]]);
    let obj = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.25\nusemtl a\nf 1/1 2/1 3/1\n";
    let mtl = "newmtl a\nmap_Kd -s 2 4 -clamp on -o 0.5 0.125 0 -mm 0 1 my solid.png\n\
        newmtl b\nKd 0.5 0.5 0.5\nmap_Kd cut.png\nmap_bump x.png\n\
        newmtl c\nmap_d grey.png\n\
        newmtl d\nmap_Kd my solid.png\nmap_d grey.png\nmap_Ke my solid.png\n";
    let files: [(&str, &[u8]); 4] =
        [("m.mtl", mtl.as_bytes()), ("my solid.png", &solid), ("cut.png", &cut), ("grey.png", &grey)];
    let scene = import_files(obj, &files).unwrap();
    let [a, b, c, d] = scene.materials.as_slice() else { panic!("four materials") };
    assert_eq!((a.alpha, a.base_color), (AlphaMode::Opaque, [1.0; 4]));
    assert_eq!(
        a.base_texture.map(|texture| (texture.wrap_s, texture.wrap_t)),
        Some((Wrap::Clamp, Wrap::Clamp))
    );
    // (0.5, 0.25) * (2, 4) + (0.5, 0.125), then turned.
    assert_eq!(scene.meshes[0].primitives[0].uvs[0], [1.5, -0.125]);
    assert_eq!((b.alpha, b.base_color[0]), (AlphaMode::Mask(0.5), 0.5));
    let texels = |material: &Material| scene.images[material.base_texture.unwrap().image].rgba.to_vec();
    assert_eq!(c.alpha, AlphaMode::Mask(0.5));
    assert_eq!(texels(c)[..8], [255, 255, 255, 0, 255, 255, 255, 90]);
    assert_eq!(texels(c)[12..], [255, 255, 255, 60]);
    assert_eq!(texels(d), [10, 20, 30, 0]);
    assert_eq!((d.emissive, d.emissive_texture.unwrap().image), ([1.0; 3], a.base_texture.unwrap().image));
    assert_eq!(scene.images.len(), 4);
    assert_eq!(
        scene.warnings,
        [
            "the material \"a\": the option -mm of map_Kd is not read",
            "the material \"b\": 'map_bump' is not read"
        ]
    );
}

#[test]
fn faults_in_a_library_are_named_with_their_line() {
    for (mtl, why) in [
        ("Kd 1 1 1\n", "m.mtl, line 1: 'Kd' stands before"),
        ("newmtl m\nKd 0.5 0.5\n", "m.mtl, line 2: Kd needs one number or three"),
        ("newmtl m\nKd\n", "Kd needs one number or three"),
        ("newmtl m\nKd 1 nan 1\n", "not \"nan\""),
        ("newmtl m\nKd 1 -1 1\n", "not \"-1\""),
        ("newmtl m\nNs\n", "Ns needs a number"),
        ("newmtl m\nmap_Kd\n", "a map without a file name"),
        ("newmtl m\nmap_Kd -s 2 2 2\n", "a map without a file name"),
        ("newmtl m\nmap_Kd -s x y.png\n", "the option -s has the value \"x\""),
        ("newmtl m\nmap_Kd -s\n", "the option -s has the value \"\""),
        ("newmtl m\nmap_Kd ../x.png\n", "leads out"),
        ("newmtl m\nmap_Kd m.mtl\n", "neither PNG nor JPEG"),
    ] {
        let error = import_mtl(mtl).unwrap_err();
        assert!(error.contains(why), "{error}\nwanted: {why}");
    }
    let warnings = import_mtl("newmtl m\nKd spectral file.rfl\n").unwrap().warnings;
    assert_eq!(warnings, ["the material \"m\": Kd in the form 'spectral' is not read"]);
}

#[test]
fn missing_libraries_and_images_are_warned_of_and_counted() {
    let obj = "mtllib none.mtl\nmtllib m.mtl gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
    let mtl = "newmtl m\nmap_Kd no.png\nmap_Ke no.png\nnewmtl n\nKd 1 0 0\nmap_d there.png\nmap_Kd no.png\n";
    let image = png(1, &[[9, 9, 9, 255]]);
    let scene = import_files(obj, &[("m.mtl", mtl.as_bytes()), ("there.png", &image)]).unwrap();
    // As if the maps had not been stated: light grey, no glow.
    let [m, n] = scene.materials.as_slice() else { panic!("two materials") };
    assert_eq!((m.base_color, m.base_texture), ([0.8, 0.8, 0.8, 1.0], None));
    assert_eq!((m.emissive, m.emissive_texture), ([0.0; 3], None));
    assert_eq!((n.base_color, scene.images.len()), ([1.0, 0.0, 0.0, 1.0], 1));
    assert_eq!(scene.images[0].rgba[..], [255, 255, 255, 9]);
    assert_eq!(
        scene.warnings,
        [
            "the material library \"none.mtl\" is missing; what uses its materials is light grey",
            "the material \"m\": the image \"no.png\" is missing; the surface is drawn without it",
            "the material \"n\": the image \"no.png\" is missing; the surface is drawn without it",
            "the material library \"gone.mtl\" is missing; what uses its materials is light grey",
        ]
    );
    assert_eq!(
        scene.dropped,
        [("material libraries that are missing", 2), ("material maps whose image is missing", 3)]
    );
    let out = import_files(obj, &[("m.mtl", b"newmtl m\nmap_Kd ../no.png\n")]).unwrap_err();
    assert!(out.contains("leads out"), "{out}");
}

#[test]
fn groups_without_end_are_refused() {
    let error = import_files(&"g\n".repeat(OBJ_PARTS_MAX + 1), &[]).unwrap_err();
    assert!(error.contains("line 1048577: more than 1048576 groups"), "{error}");
}
