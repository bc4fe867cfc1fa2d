//! What is left out changes no picture's hash, and `tessera scene info --why` says what that saves.

use crate::support::{Folder, PLY, Tessera};
use std::collections::BTreeSet;
use std::time::Duration;
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_master::{FrameBuffer, FrameJob, PixelFormat};
use tessera_pack::Forced;
use tessera_quantize::NormalTable;
use tessera_scene::Without;
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_whitted::Needs;
use tessera_wire::{FrameId, PackId};
use tessera_worker::Kernel;
use tessera_worker::gpu::probe::cpu_frame_with;

const SIDE: u32 = 48;

/// Hashes of the image in every pixel format.
fn hashes(prepared: &Prepared, kernel: Kernel, forced: Needs) -> [String; 3] {
    let pack = &prepared.pack;
    [PixelFormat::Rgba8, PixelFormat::Rgba16, PixelFormat::Layers].map(|format| {
        let job = FrameJob {
            tile: SIDE,
            format,
            ..FrameJob::new(
                prepared.cameras[0].pose.to_local(&pack.frame(), SIDE, SIDE).expect("a usable pose"),
                SIDE,
                SIDE,
            )
        };
        let (pixels, _) = cpu_frame_with(pack, kernel, forced, &job.to_wire(FrameId(1), PackId(pack.id().0)));
        FrameBuffer::from_rows(SIDE, SIDE, format, pixels).expect("a frame").hash().to_string()
    })
}

/// Every generated scene, and the one with most in it without its images and without glass.
#[test]
fn what_is_forced_in_changes_no_hash_of_a_generated_scene() {
    let all = Without::default();
    let without = [Without { textures: true, ..all }, Without { refraction: true, ..all }];
    let scenes = Kind::ALL.map(|kind| (kind, all)).into_iter().chain(without.map(|w| (Kind::Hall, w)));
    let needs =
        Needs { holes: true, hidden_backs: true, see_through: true, normals: true, uvs: true, colors: true };
    let mut compared = BTreeSet::new();
    for (kind, without) in scenes {
        let prepared = |forced| {
            let scene = generate(&Recipe { kind, triangles: 2000, seed: 1 }).expect("in range");
            let options = PrepareOptions { without, forced, ..PrepareOptions::default() };
            prepare_scene(scene, &options, Duration::ZERO).expect("it packs")
        };
        let lean = prepared(None);
        let expected = hashes(&lean, Kernel::auto(), Needs::default());
        let mut twins = 0;
        for forced in Forced::ALL {
            let full = prepared(Some(forced));
            if full.pack.id() == lean.pack.id() {
                continue;
            }
            compared.insert(forced.name());
            twins += 1;
            let found = hashes(&full, Kernel::auto(), Needs::default());
            assert_eq!(found, expected, "{}, {without:?}: {}", kind.name(), forced.name());
        }
        assert!(twins > 0, "{}, {without:?}: no part was forced in", kind.name());
        for kernel in [Kernel::Scalar, Kernel::wide()] {
            assert_eq!(hashes(&lean, kernel, needs), expected, "{}, {without:?}, {kernel:?}", kind.name());
        }
    }
    // The hall without its images lacks both.
    assert!(compared.contains("uvs") && compared.contains("textures"), "{compared:?}");
}

#[test]
fn why_names_every_part_that_a_scene_does_not_need() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let why = |more: &[&str]| {
        let small = ["scene", "info", "a.ply", "--why", "--size", "24x16", "--reps", "2", "--backend", "cpu"];
        Tessera::new(small).args(more).within(folder.path()).run()
    };
    let report = why(&["--json"]).json();
    let lines = report["why"].as_array().expect("a list");
    let parts: Vec<_> = lines.iter().map(|line| line["part"].as_str().expect("a name")).collect();
    assert_eq!(
        parts,
        [
            "normals",
            "uvs",
            "side-uvs",
            "colors",
            "textures",
            "materials",
            "id-runs",
            "environment",
            "refs",
            "holes",
            "hidden-backs",
            "see-through",
            "mirrors",
            "glass"
        ]
    );
    for line in lines {
        let part = line["part"].as_str().expect("a name");
        for key in ["why", "left_out"] {
            assert!(line[key].as_str().is_some_and(|text| !text.is_empty()), "{line}");
        }
        // Of these the CPU has one kernel, which decides at each hit.
        if ["refs", "mirrors", "glass"].contains(&part) {
            assert!(line["cpu"].is_null() && line["equal"].is_null(), "{line}");
        } else {
            assert_eq!(line["equal"], true, "{line}");
            assert_eq!(line["hashes"]["cpu rgba8"], report["why_measured"]["hashes"]["rgba8"], "{line}");
            let seconds = |which: &str| line["cpu"][which]["median"].as_f64().expect("seconds");
            assert!(seconds("without_s") > 0.0 && seconds("with_s") > 0.0, "{line}");
            assert!(line["cpu"]["saved_percent"]["low"].is_number(), "{line}");
        }
        assert!(line["gpu"].is_null(), "{line}");
    }
    let bytes = |part: &str, of: &str| {
        let line = lines.iter().find(|line| line["part"] == part).expect("a line");
        line["bytes"][of].as_i64().expect("bytes")
    };
    // A word of a record for each of five vertices; a normal takes none of its own, but on a device a table.
    let uvs = &lines[1]["bytes"]["sections"]["records"];
    assert_eq!((uvs.as_i64(), bytes("normals", "pack")), (Some(4 * 5), 0));
    assert_eq!(bytes("normals", "device"), size_of_val(NormalTable::get().entries()) as i64);
    assert!(bytes("colors", "pack") > 0 && bytes("holes", "pack") == 0);

    let text = why(&[]).ok();
    for word in ["Left out, and what that saves", "normals", "see-through", "the same", "image hash"] {
        assert!(text.contains(word), "no {word}: {text}");
    }
    let plain = Tessera::new(["scene", "info", "a.ply", "--json"]).within(folder.path()).run().json();
    assert!(plain.get("why").is_none(), "only with --why");
}

/// Two triangles whose corners have a colour each and, if asked for, a normal that is not the face's.
fn fan(has_normals: bool) -> String {
    let normals = if has_normals { "property float nx\nproperty float ny\nproperty float nz\n" } else { "" };
    let colors = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let corners =
        [("-1 -1 0", "-0.6 0 0.8"), ("1 -1 0", "0.6 0 0.8"), ("0 1 0.5", "0 0.6 0.8"), ("-1 1 0", "0 0 1")];
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{normals}{colors}\
         element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    );
    for (k, (corner, normal)) in corners.into_iter().enumerate() {
        let normal = if has_normals { normal } else { "" };
        text += &format!("{corner} {normal} {} 100 200\n", 50 * k);
    }
    text + "3 0 1 2\n3 0 2 3\n"
}

/// Through the command: five scenes, each without one thing that others have. Each names the parts that it does not need, and not those that
/// it has; with any of them forced in the picture is the same.
#[test]
fn why_tells_five_scenes_apart() {
    let folder = Folder::new();
    let generated = |kind: &str, materials: &str| {
        format!("[generate]\nkind = \"{kind}\"\ntriangles = 2000\nseed = 1\n{materials}")
    };
    let scenes: [(&str, String, &[&str], &[&str]); 5] = [
        // No textures.
        (
            "cornell.toml",
            generated("cornell", ""),
            &["uvs", "textures"],
            &["normals", "materials", "mirrors", "glass"],
        ),
        ("flat.ply", fan(false), &["normals", "uvs", "textures"], &["colors"]),
        (
            "no_mirrors.toml",
            generated("hall", "[material.\"*\"]\nroughness = 1.0\n"),
            &["mirrors"],
            &["textures", "uvs", "materials", "glass", "holes"],
        ),
        ("one_material.ply", fan(true), &["materials"], &["normals", "colors"]),
        (
            "opaque.toml",
            generated("hall", "[material.\"*\"]\ntransmission = 0.0\nalpha = \"opaque\"\n"),
            &["holes", "see-through", "glass"],
            &["textures", "uvs", "materials", "mirrors"],
        ),
    ];
    for (name, text, lacks, has) in scenes {
        folder.write(name, text);
        let args =
            ["scene", "info", name, "--why", "--json", "--size", "32x24", "--reps", "1", "--backend", "cpu"];
        let report = Tessera::new(args).within(folder.path()).run().json();
        let lines = report["why"].as_array().expect("a list");
        let parts: BTreeSet<_> = lines.iter().map(|line| line["part"].as_str().expect("a name")).collect();
        println!("{name} leaves out {parts:?}");
        for part in lacks {
            assert!(parts.contains(part), "{name} does not need {part}: {parts:?}");
        }
        for part in has {
            assert!(!parts.contains(part), "{name} needs {part}: {parts:?}");
        }
        for line in lines {
            // On a CPU these are decided at each hit: there is no other picture.
            let has_twin = !["refs", "mirrors", "glass"].contains(&line["part"].as_str().expect("a name"));
            assert_eq!(
                line["equal"],
                if has_twin { true.into() } else { serde_json::Value::Null },
                "{name}: {line}"
            );
            assert!(line["bytes"]["pack"].is_i64() && line["bytes"]["device"].is_i64(), "{name}: {line}");
            assert!(line["cpu"]["saved_percent"]["median"].is_number() == has_twin, "{name}: {line}");
        }
    }
}

#[test]
fn why_refuses_what_cannot_be_measured() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("a.tpack", "");
    let check = |args: &[&str], says: &[&str]| {
        Tessera::new(["scene", "info"]).args(args).within(folder.path()).run().fails(2, says);
    };
    check(&["a.tpack", "--why"], &["a.tpack", "name the scene that it was packed from"]);
    check(&["a.ply", "--size", "8x8"], &["--why"]);
    check(&["a.ply", "--reps", "3"], &["--why"]);
    check(&["a.ply", "--backend", "cpu"], &["--why"]);
    check(&["a.ply", "--why", "--reps", "0"], &["--reps"]);
    check(&["a.ply", "--why", "--size", "8"], &["WIDTHxHEIGHT"]);
    check(&["a.ply", "--why", "--backend", "cpu", "--gpu", "0"], &["--gpu 0"]);
}
