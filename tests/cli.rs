//! The command line: help, exit codes, JSON, and bad input that ends in one clear line.

use crate::support::{Folder, PLY, Tessera};
use std::fs;

#[test]
fn help_is_a_manual() {
    let commands: [&[&str]; 13] = [
        &[],
        &["demo"],
        &["doctor"],
        &["master"],
        &["worker"],
        &["render"],
        &["scene", "info"],
        &["scene", "pack"],
        &["compare"],
        &["bench", "rays"],
        &["bench", "build"],
        &["bench", "pack"],
        &["bench", "gpu"],
    ];
    for command in commands {
        let help = Tessera::new(command).args(["--help"]).run().ok();
        assert!(help.contains("Usage:") && help.contains("Examples:"), "{command:?}: {help}");
    }
    let version = Tessera::new(["--version"]).run().ok();
    assert_eq!(version, format!("tessera {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn wrong_usage_is_exit_code_2_and_one_line() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let check = |args: &[&str], says: &[&str]| {
        Tessera::new(args).within(folder.path()).run().fails(2, says);
        assert_eq!(folder.names(), ["a.ply"], "{args:?} left something behind");
    };
    check(&["fly"], &["unrecognized subcommand 'fly'"]);
    check(&["render"], &["required arguments", "--out <FILE>", "<SCENE>"]);
    let render = |args: &[&'static str]| [&["render", "a.ply", "--out", "a.png"], args].concat();
    check(&render(&["--wings"]), &["unexpected argument '--wings'"]);
    check(&render(&["--size", "1024"]), &["--size", "WIDTHxHEIGHT"]);
    check(&render(&["--size", "0x5"]), &["WIDTHxHEIGHT"]);
    check(&render(&["--size", "65536x65536"]), &["65536 x 65536"]);
    check(&render(&["--tile", "0"]), &["--tile"]);
    check(&render(&["--tile", "1", "--size", "2000x2000"]), &["tiles", "choose larger tiles"]);
    check(&render(&["--spp", "0"]), &["--spp"]);
    check(&render(&["--depth", "33"]), &["--depth"]);
    check(&render(&["--sampler", "halton"]), &["--sampler", "jittered, low-discrepancy"]);
    for bad in ["-0.5", "1.5", "nan", "1/512"] {
        check(&render(&["--cutoff", bad]), &["--cutoff", "a weight of 0 to 1"]);
    }
    // Before the scene, which does not exist, is looked for.
    for faint in ["0", "0.00001"] {
        let boundless = ["render", "none.ply", "--out", "a.png", "--cutoff", faint];
        let says = ["cut-off 0", "with depth 8", "a cut-off of at least 1/65536", "a depth of at most 3"];
        check(&boundless, &says);
        check(&[&boundless[..], &["--depth", "4"]].concat(), &["with depth 4"]);
        let bounded = [&boundless[..], &["--depth", "3"]].concat();
        Tessera::new(bounded).within(folder.path()).run().fails(1, &["none.ply"]);
    }
    for bad in ["0", "-1", "2", "nan", "fine"] {
        check(&render(&["--adaptive", bad]), &["--adaptive", "more than 0 and at most 1"]);
    }
    check(&render(&["--adaptive", "0.1", "--tile", "100"]), &["tile side 100", "a multiple of 16"]);
    check(&render(&["--bits", "12"]), &["--bits"]);
    check(&render(&["--refs", "3"]), &["--refs"]);
    check(&render(&["--refs-when", "0.5,2"]), &["--refs-when", "two shares of 0 to 1"]);
    check(&render(&["--least-saving", "-1"]), &["--least-saving"]);
    check(&render(&["--cells", "31"]), &["--cells", "32..=8192"]);
    check(&render(&["--position-bits", "11"]), &["--position-bits", "1..=10"]);
    check(&render(&["--uv-bits", "0"]), &["--uv-bits", "1..=16"]);
    check(&render(&["--normals", "octa"]), &["--normals", "smith, oct"]);
    check(&render(&["--normals", "oct", "--plain"]), &["--normals has no effect on normals"]);
    check(&render(&["--position-bits", "8", "--plain=positions"]), &["--position-bits has no effect"]);
    check(&render(&["--uv-bits", "8", "--plain=normals,uv"]), &["--uv-bits has no effect"]);
    check(&render(&["--workers", "257"]), &["--workers"]);
    check(
        &render(&["--balance", "fair"]),
        &[
            "--balance",
            "paper-static, static, hilbert, weighted, staggered, paper-dynamic, dynamic, steal, auto",
        ],
    );
    check(&render(&["--without", "colour"]), &["--without", "textures, shadows, reflection, refraction"]);
    check(&render(&["--plain=colour"]), &["--plain", "positions, normals, uv"]);
    check(&render(&["--eye", "0,0,5"]), &["--target", "--fov"]);
    check(&render(&["--eye", "0,0", "--target", "0,0,0", "--fov", "60"]), &["--eye", "three finite numbers"]);
    check(&render(&["--eye", "0,0,5", "--target", "0,0,0", "--fov", "180"]), &["--fov", "less than 180"]);
    check(&render(&["--camera", "a", "--eye", "0,0,5", "--target", "0,0,0", "--fov", "9"]), &["--camera"]);
    check(&render(&["--eye", "1,1,1", "--target", "1,1,1", "--fov", "60"]), &["camera"]);
    check(&render(&["--eye", "0,5,0", "--target", "0,0,0", "--fov", "60"]), &["camera", "up"]);
    check(&render(&["--camera", "north"]), &["no camera `north`", "default"]);
    check(&render(&["--size", "8192x8192", "--tile", "8192"]), &["tile of", "choose smaller tiles"]);
    check(
        &["render", "a.ply", "--out", "a.exr", "--size", "2048x2048", "--tile", "2048"],
        &["smaller tiles"],
    );
    check(&["render", "a.ply", "--out", "a.exr", "--bits", "16"], &["a.exr", "--bits is for PNG files"]);
    check(&render(&["--report", "a.png"]), &["--report", "a.png", "the picture"]);
    check(&render(&["--report", "./a.ply"]), &["--report", "a.ply", "the scene"]);
    check(&["render", "a.ply", "--out", "a.jpg"], &["a.jpg", ".png or .exr"]);
    check(&["scene", "pack", "a.ply", "--out", "a.zip"], &["a.zip", ".tpack"]);
}

#[test]
fn bad_input_is_exit_code_1_and_one_line_and_no_file() {
    let folder = Folder::new();
    let none = PLY.replace("face 2", "face 0").replace("3 0 1 2\n3 0 3 4\n", "");
    let nan = PLY.replace("-1 -1 0\n1 -1 0\n", "nan nan nan\nnan nan nan\n");
    folder.write("none.ply", none);
    folder.write("nan.ply", nan);
    folder.write("cut.ply", &PLY[..PLY.len() - 12]);
    folder.write("text.ply", "hello");
    folder.write("text.glb", "hello");
    folder.write("text.gltf", "{");
    folder.write("empty.obj", "# nothing\n");
    folder.write("empty.ply", "");
    folder.write("text.tpack", "hello");
    folder.write("scene.toml", "source = \"gone.ply\"\n");
    folder.write("picture.jpg", "hello");
    folder.write("good.ply", PLY);
    fs::create_dir(folder.file("folder.ply")).unwrap();
    let before = folder.names();
    let check = |scene: &str, says: &[&str]| {
        for command in [
            &["render", scene, "--out", "out.png", "--size", "8x8", "--report", "report.json"][..],
            &["render", scene, "--out", "out.exr", "--size", "8x8", "--workers", "1"],
            &["scene", "info", scene],
            &["scene", "pack", scene, "--out", "out.tpack"],
        ] {
            Tessera::new(command).within(folder.path()).run().fails(1, &[&[scene], says].concat());
            assert_eq!(folder.names(), before, "{command:?} left something behind");
        }
    };
    check("gone.ply", &["cannot read", "No such file"]);
    check("folder.ply", &["is a folder"]);
    check("none.ply", &["no triangles"]);
    check("nan.ply", &["no triangle"]);
    check("cut.ply", &[]);
    check("text.ply", &[]);
    check("text.glb", &[]);
    check("text.gltf", &[]);
    check("empty.obj", &["no triangles"]);
    check("empty.ply", &[]);
    check("text.tpack", &["not a pack"]);
    check("scene.toml", &["gone.ply"]);
    check("picture.jpg", &["unknown scene format", ".glb, .gltf, .obj, .ply"]);

    let render = |out: &str, says: &[&str]| {
        Tessera::new(["render", "good.ply", "--out", out, "--size", "8x8"])
            .within(folder.path())
            .run()
            .fails(1, says);
        assert_eq!(folder.names(), before);
    };
    render("no/such/folder/a.png", &["no/such/folder", "does not exist", "create it first"]);
    render("good.ply/a.png", &["good.ply"]);
    fs::create_dir(folder.file("folder.png")).unwrap();
    Tessera::new(["render", "good.ply", "--out", "folder.png"])
        .within(folder.path())
        .run()
        .fails(1, &["folder.png", "is a folder"]);
}

#[test]
fn a_bundle_that_was_touched_is_refused() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    Tessera::new(["scene", "pack", "a.ply", "--out", "a.tpack"]).within(folder.path()).run().ok();
    let bytes = fs::read(folder.file("a.tpack")).unwrap();
    let check = |bytes: &[u8], says: &[&str]| {
        folder.write("b.tpack", bytes);
        Tessera::new(["render", "b.tpack", "--out", "b.png", "--size", "8x8"])
            .within(folder.path())
            .run()
            .fails(1, &[&["b.tpack"], says].concat());
    };
    check(&bytes[..bytes.len() - 1], &["truncated"]);
    check(&bytes[..40], &["truncated"]);
    let mut flipped = bytes.clone();
    *flipped.last_mut().unwrap() ^= 1;
    check(&flipped, &["damaged"]);
    // A length is believed only of what begins like a pack, and only the file's own.
    let sparse = |first: &[u8], says: &[&str]| {
        let path = folder.write("b.tpack", first);
        fs::File::options().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
        let render = ["render", "b.tpack", "--out", "b.png"];
        Tessera::new(render).within(folder.path()).run().fails(1, &[&["b.tpack"], says].concat());
    };
    sparse(b"", &["not a pack"]);
    sparse(&bytes[..64], &["truncated or continued"]);
    for flags in [
        &["--refs", "1"][..],
        &["--plain"],
        &["--without", "textures"],
        &["--cells", "64"],
        &["--position-bits", "5"],
        &["--normals", "oct"],
        &["--uv-bits", "5"],
        &["--refs-when", "0.5,0.5"],
        &["--least-saving", "0"],
    ] {
        Tessera::new(["render", "a.tpack", "--out", "b.png"])
            .args(flags)
            .within(folder.path())
            .run()
            .fails(2, &["a.tpack", flags[0], "pack the scene again"]);
    }
}

/// A square with normals and a texture.
const TEXTURED: &str = "\
mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0.1 0.2 1\nvt 0.01 0.02\nvt 0.91 0.03\nvt 0.92 0.97\nvt 0 0.99\n\
f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n";

#[test]
fn packing_flags_reach_the_pack_and_the_report() {
    let folder = Folder::new();
    folder.write("a.obj", TEXTURED);
    folder.write("a.mtl", "newmtl a\nmap_Kd a.png\n");
    image::RgbaImage::from_pixel(2, 2, image::Rgba([200, 100, 50, 255])).save(folder.file("a.png")).unwrap();
    let info = |flags: &[&str]| {
        let info = Tessera::new(["scene", "info", "a.obj", "--json"]).args(flags).within(folder.path());
        info.run().json()
    };
    let usual = info(&[]);
    let codes = |info: &serde_json::Value, names: &[&str]| -> Vec<serde_json::Value> {
        names.iter().map(|name| info["codes"][name].clone()).collect()
    };
    let all = ["positions", "position_bits", "normals", "normal_table", "uv", "uv_bits"];
    assert_eq!(
        serde_json::Value::from(codes(&usual, &all)),
        serde_json::json!(["cells", 10, "smith", 786_432, "fixed", 16])
    );
    let error = |info: &serde_json::Value| info["codes"]["normals_error"].as_f64().unwrap();
    assert!((error(&usual) - 0.5625).abs() < 1e-3, "{usual}");

    // Each by itself changes the pack, and what defaults say changes nothing.
    let flags = ["--cells", "40", "--position-bits", "3", "--normals", "oct", "--uv-bits", "7"];
    let packs: Vec<_> = flags.chunks_exact(2).map(|flag| info(flag)["pack_id"].clone()).collect();
    assert!(packs.iter().all(|id| *id != usual["pack_id"]), "{packs:?}");
    let stated = ["--cells", "8192", "--position-bits", "10", "--normals", "smith", "--uv-bits", "16"];
    let tree = ["--refs-when", "0.5,0.4,0.6", "--least-saving", "1"];
    assert_eq!(info(&[&stated[..], &tree].concat())["pack_id"], usual["pack_id"]);

    let coarse = info(&flags);
    assert_eq!(
        serde_json::Value::from(codes(&coarse, &all)),
        serde_json::json!(["cells", 3, "oct", 0, "fixed", 7])
    );
    assert!((error(&coarse) - 0.638).abs() < 1e-3, "{coarse}");
    assert_eq!(coarse["grid"]["nx"], 40);
    // The table is what the octahedron saves; the vertices are as long as they were.
    assert_eq!(coarse["bytes"]["tables"], coarse["sections"]["cells"]);
    assert_eq!(coarse["sections"]["records"], usual["sections"]["records"]);
    let text = Tessera::new(["scene", "info", "a.obj"]).args(flags).within(folder.path()).run().ok();
    let line = "codes      positions in cells, 3 bits an axis; normals oct, 16 bits, within 0.638 degrees, no table; \
                texture coordinates 1 + 6 bits";
    assert!(text.contains(line), "{text}");

    // A bundle tells the code, which is in it, and not how it was rounded.
    let pack = Tessera::new(["scene", "pack", "a.obj", "--out", "b.tpack"]).args(flags).within(folder.path());
    pack.run().ok();
    let bundle = Tessera::new(["scene", "info", "b.tpack", "--json"]).within(folder.path()).run().json();
    assert_eq!(bundle["pack_id"], coarse["pack_id"]);
    assert_eq!(
        serde_json::Value::from(codes(&bundle, &all)),
        serde_json::json!(["cells", null, "oct", 0, "fixed", null])
    );
    // Plain vertices have no codes.
    let plain = info(&["--plain"]);
    assert_eq!(
        serde_json::Value::from(codes(&plain, &all)),
        serde_json::json!(["f32", null, "f32", 0, "f32", null])
    );
}

#[test]
fn a_bundle_says_which_rays_are_left_out() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    Tessera::new(["scene", "pack", "a.ply", "--out", "a.tpack"]).within(folder.path()).run().ok();
    for scene in ["a.ply", "a.tpack"] {
        let report = Tessera::new(["render", scene, "--out", "a.png", "--size", "8x8", "--json"])
            .args(["--without", "shadows,refraction"])
            .within(folder.path())
            .run()
            .json();
        let left_out = report["left_out"].as_array().unwrap().iter();
        let rays: Vec<_> =
            left_out.map(|l| &l["what"]).filter(|w| w.as_str().unwrap().contains("rays")).collect();
        assert_eq!(rays, ["shadow rays", "refraction rays"], "{scene}");
    }
}

/// Opening a pipe that nobody writes to would block for ever.
#[cfg(unix)]
#[test]
fn a_pipe_is_refused() {
    let folder = Folder::new();
    for name in ["pipe.tpack", "pipe.toml", "pipe.ply", "pipe.png"] {
        let made = std::process::Command::new("mkfifo").arg(folder.file(name)).status();
        assert!(made.expect("mkfifo runs").success());
        let command = if name == "pipe.png" { ["compare", name, name] } else { ["scene", "info", name] };
        Tessera::new(command).within(folder.path()).run().fails(1, &[name, "not a regular file"]);
    }
}

#[test]
fn reports_are_one_json_object_with_the_promised_keys() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let has = |value: &serde_json::Value, keys: &[&str]| {
        for key in keys {
            let found = key.split('.').try_fold(value, |value, key| value.get(key));
            assert!(found.is_some(), "{key} is missing in {value}");
        }
    };
    let render = Tessera::new(["render", "a.ply", "--out", "a.png", "--size", "20x10", "--json"])
        .args(["--report", "report.json"])
        .within(folder.path())
        .run()
        .json();
    has(
        &render,
        &[
            "image_hash",
            "pack_id",
            "numeric_class",
            "mix",
            "idle_workers",
            "size",
            "tile",
            "balance",
            "spp",
            "sampler",
            "cutoff",
            "adaptive",
            "mean_samples",
            "workers",
            "ms.pack",
            "ms.send_scene",
            "ms.render",
            "ms.return",
            "ms.frame",
            "bytes_on_wire",
            "rays.primary",
            "rays.shadow",
            "rays.reflection",
            "rays.refraction",
            "dropped_tiles",
        ],
    );
    has(
        &render["workers"][0],
        &["name", "backend", "numeric_class", "backend_note", "tiles", "render_ms", "bytes_returned"],
    );
    assert_eq!(render["size"], serde_json::json!([20, 10]));
    assert_eq!(render["rays"]["primary"], 200);
    assert_eq!((&render["sampler"], &render["mean_samples"]), (&"jittered".into(), &1.0.into()));
    assert_eq!((&render["cutoff"], &render["adaptive"]), (&0.001_953_125.into(), &serde_json::Value::Null));
    assert_eq!(render["balance"], "dynamic");
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.file("report.json")).unwrap()).unwrap();
    assert_eq!(report, render);

    let info = Tessera::new(["scene", "info", "a.ply", "--json"]).within(folder.path()).run().json();
    has(
        &info,
        &[
            "triangles",
            "vertices",
            "materials",
            "textures",
            "dropped",
            "left_out",
            "grid.nx",
            "grid.ny",
            "grid.nz",
            "grid.cells",
            "grid.step",
            "nodes.inner0",
            "nodes.inner1",
            "nodes.inner2",
            "nodes.leaves",
            "nodes.leaf_refs",
            "bytes.mesh_plain",
            "bytes.mesh_packed",
            "bytes.tables",
            "bytes.textures",
            "bytes.tree_standard",
            "bytes.tree_one_ref",
            "bytes.tree_two_refs",
        ],
    );
    assert_eq!((&info["triangles"], &info["vertices"]), (&2.into(), &5.into()));
    let number = |path: &[&str]| {
        let found = path.iter().fold(&info, |value, key| &value[key]);
        found.as_u64().unwrap_or_else(|| panic!("{path:?} is no number: {found}"))
    };
    // One corner is shared at most: between one cell and one for each vertex.
    assert!((1..=5).contains(&number(&["grid", "cells"])), "{info}");
    let section = |name| number(&["sections", name]);
    assert_eq!(number(&["bytes", "tables"]), section("cells"), "flat: no table of normals");
    // 8 bytes a cell once an axis has more than 1,024 of them.
    let axis = ["nx", "ny", "nz"].map(|n| number(&["grid", n])).into_iter().max().unwrap();
    assert_eq!(section("cells"), if axis > 1024 { 8 } else { 4 } * number(&["grid", "cells"]));
    let mesh = section("records") + section("face") + section("matrun") + section("idrun");
    assert_eq!(number(&["bytes", "mesh_packed"]), mesh);
    // Two triangles: positions of 12 bytes, indices of 12.
    assert_eq!(number(&["bytes", "mesh_plain"]), 5 * 12 + 2 * 12);
    for (i, name) in ["tree_standard", "tree_one_ref", "tree_two_refs"].into_iter().enumerate() {
        assert!(number(&["bytes", name]) > 0, "{name}");
        let tree = &info["trees"][i];
        assert_eq!((&tree["refs"], &tree["bytes"]), (&i.into(), &tree["bytes_formula"]), "{name}");
    }

    Tessera::new(["render", "a.ply", "--out", "b.png", "--size", "20x10", "--without", "shadows"])
        .within(folder.path())
        .run()
        .ok();
    let compare = |a, b| Tessera::new(["compare", a, b, "--json"]).within(folder.path()).run().json();
    let same = compare("a.png", "a.png");
    has(&same, &["mse", "rmse", "psnr_db", "psnr_linear_db", "psnr_srgb_db", "ssim", "flip", "max_abs"]);
    has(&same, &["differing_share", "wrong_id_share", "peak", "width", "height"]);
    assert_eq!((&same["mse"], &same["psnr_db"]), (&0.0.into(), &serde_json::Value::Null));
    assert_eq!((&same["flip"], &same["wrong_id_share"]), (&0.0.into(), &serde_json::Value::Null));
}

#[test]
fn the_hash_is_of_the_pixels_in_the_file() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let render = |out: &str, more: &[&str]| {
        Tessera::new(["render", "a.ply", "--out", out, "--size", "33x21", "--json"])
            .args(more)
            .within(folder.path())
            .run()
            .json()["image_hash"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    let hash = |format: &str, rows: &[u8]| {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format.as_bytes());
        hasher.update(&33_u32.to_le_bytes()).update(&21_u32.to_le_bytes()).update(rows);
        hasher.finalize().to_hex().to_string()
    };
    let eight = render("a.png", &[]);
    let picture = image::open(folder.file("a.png")).unwrap();
    let pixels = picture.as_rgba8().unwrap();
    assert_eq!(eight, hash("rgba8", pixels.as_raw()));
    assert!(pixels.pixels().any(|p| p.0[3] == 255), "the triangles are in the picture");
    assert!(pixels.pixels().any(|p| p.0[3] == 0), "and what they do not cover is transparent");

    let sixteen = render("b.png", &["--bits", "16"]);
    let picture = image::open(folder.file("b.png")).unwrap();
    let rows: Vec<u8> = picture.as_rgba16().unwrap().as_raw().iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(sixteen, hash("rgba16", &rows));
}

#[test]
fn the_environment_names_the_scene_folder_and_the_log_filter() {
    let (here, elsewhere) = (Folder::new(), Folder::new());
    elsewhere.write("a.ply", PLY);
    here.write("scene.toml", "source = \"a.ply\"\n");
    let render = || {
        Tessera::new(["render", "scene.toml", "--out", "a.png", "--size", "8x8", "--json"])
            .within(here.path())
    };
    render().run().fails(1, &["a.ply"]);
    render().env("TESSERA_SCENES", elsewhere.path()).run().json();

    let log = render().env("TESSERA_SCENES", elsewhere.path()).env("RUST_LOG", "tessera=debug");
    let outcome = log.args(["--log-format", "json"]).run();
    assert_eq!(outcome.code, Some(0), "{outcome:?}");
    assert!(outcome.stderr.contains("tiles"), "{outcome:?}");
    for line in outcome.stderr.lines() {
        let line: serde_json::Value = serde_json::from_str(line).expect("a JSON object a line");
        assert!(line["level"].is_string());
    }
    render().env("RUST_LOG", "tessera=loud").run().fails(2, &["RUST_LOG"]);
}

#[test]
fn a_comparison_draws_where_pictures_differ_and_counts_wrong_triangles() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let render = |out: &str, fov: &str| {
        Tessera::new([
            "render",
            "a.ply",
            "--out",
            out,
            "--size",
            "32x32",
            "--eye",
            "0.3,0.3,3",
            "--target",
            "0.3,0.3,0",
        ])
        .args(["--fov", fov])
        .within(folder.path())
        .run()
        .ok();
    };
    render("near.exr", "30");
    render("far.exr", "50");
    let compare =
        |a, b, map| Tessera::new(["compare", a, b, "--json", "--map", map]).within(folder.path()).run();
    let differ = compare("near.exr", "far.exr", "map.png").json();
    let share = |name: &str| differ[name].as_f64().expect("a number");
    assert!(share("flip") > 0.0 && share("wrong_id_share") > 0.0, "{differ}");
    // Another triangle behind a pixel's centre is another colour here: one of them is missed.
    assert!(share("wrong_id_share") <= share("differing_share"), "{differ}");
    let map = image::open(folder.file("map.png")).expect("a picture").into_rgb8();
    let black = map.pixels().filter(|pixel| pixel.0 == [0, 0, 4]).count();
    assert!(map.dimensions() == (32, 32) && (1..32 * 32).contains(&black), "{black}");

    let same = compare("near.exr", "near.exr", "map.png").json();
    assert_eq!((&same["wrong_id_share"], &same["flip"]), (&0.0.into(), &0.0.into()));
    let names = folder.names();
    compare("near.exr", "far.exr", "map.exr").fails(2, &["--map map.exr: name a .png file"]);
    fs::copy(folder.file("map.png"), folder.file("a.png")).expect("a copy");
    compare("a.png", "map.png", "a.png").fails(2, &["would replace a picture"]);
    compare("near.exr", "far.exr", "none/map.png").fails(1, &["does not exist; create it first"]);
    assert_eq!(folder.names().len(), names.len() + 1);
}
