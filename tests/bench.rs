//! The benches, run small: what they print, and that they compute the same each time.

use crate::support::{Folder, PLY, Tessera, gpu};
use std::collections::BTreeMap;

/// Lines of `tessera bench rays --json` on a small image.
fn rays(args: &[&str]) -> Vec<serde_json::Value> {
    let small = ["--size", "32", "--reps", "1", "--json"];
    let out = Tessera::new(["bench", "rays"]).args(args).args(small).run().ok();
    out.lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect()
}

#[test]
fn rays_prints_a_line_for_each_peer_view_kind_and_thread_count() {
    let lines = rays(&["gen:sphere:2000", "--threads", "1,2", "--refs", "0,2", "--plain=too"]);
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for line in &lines {
        let text = |key: &str| line[key].as_str().unwrap_or_else(|| panic!("no {key}: {line}"));
        let number = |key: &str| line[key].as_f64().unwrap_or_else(|| panic!("no {key}: {line}"));
        *counts.entry(text("peer")).or_default() += 1;
        assert_eq!(text("mesh"), "sphere-1848");
        assert!(["orbit0", "orbit1", "orbit2"].contains(&text("view")));
        assert!(["primary", "shadow", "diffuse"].contains(&text("ray_kind")));
        assert!([1.0, 2.0].contains(&number("threads")));
        assert!(number("mrays_per_cpu_s") > 0.0 && number("build_cpu_s_1") > 0.0);
        assert!(number("bytes_per_triangle") > number("accel_bytes_per_triangle"));
        assert!(number("hits") <= number("rays") && number("differs") <= number("rays") / 100.0, "{line}");
    }
    assert!(counts.contains_key("obvhs-0.4/cwbvh-medium/single"), "{counts:?}");
    assert!(counts.contains_key("tessera/kd0-plain/wide8"), "{counts:?}");
    assert!(counts.values().all(|&n| n == 3 * 3 * 2), "{counts:?}");

    // Number of threads and references change nothing about what is hit.
    let mut hashes: BTreeMap<[&str; 3], Vec<&str>> = BTreeMap::new();
    for line in &lines {
        let peer = line["peer"].as_str().unwrap();
        let form = if peer.contains("obvhs") {
            "obvhs"
        } else if peer.contains("plain") {
            "plain"
        } else {
            "quantised"
        };
        let place = [form, line["view"].as_str().unwrap(), line["ray_kind"].as_str().unwrap()];
        hashes.entry(place).or_default().push(line["hash"].as_str().unwrap());
    }
    assert_eq!(hashes.len(), 3 * 3 * 3);
    assert!(hashes.values().all(|all| all.iter().all(|h| h == &all[0])), "{hashes:?}");
}

#[test]
fn rays_takes_files_and_cameras_and_prints_a_table() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let out = Tessera::new(["bench", "rays", "a.ply", "--views", "-1,-1,-1,0,0,0,60", "--plain"])
        .args(["--size", "16", "--reps", "1"])
        .within(folder.path())
        .run()
        .ok();
    for word in ["mesh       a,", "given", "obvhs-0.4", "tessera/kd2-plain/scalar", "primary", "Mrays/CPU s"]
    {
        assert!(out.contains(word), "no {word}: {out}");
    }
}

#[test]
fn rays_refuses_what_cannot_be_measured() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("a.tpack", "");
    let check = |code, args: &[&str], says: &[&str]| {
        Tessera::new(["bench", "rays"]).args(args).within(folder.path()).run().fails(code, says);
    };
    check(2, &["gen:cube:500"], &["gen:sphere:N or gen:pipes:N"]);
    check(2, &["a.ply", "--views", "above"], &["orbit, inside, or ex,ey,ez,tx,ty,tz,fov"]);
    check(2, &["a.ply", "--size", "100"], &["a multiple of 16"]);
    check(2, &["a.ply", "--refs", "3"], &["--refs"]);
    check(2, &["a.tpack"], &["a.tpack", "name the scene that it was packed from"]);
    check(1, &["missing.ply"], &["missing.ply"]);
}

#[test]
fn build_measures_every_tree_in_a_process_of_its_own() {
    let build = |more: &[&str]| {
        let out = Tessera::new(["bench", "build", "gen:sphere:2000"]).args(more).run().ok();
        out.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect::<Vec<serde_json::Value>>()
    };
    let lines = build(&["--threads", "1,2", "--json"]);
    let tree_bytes = |tree: &str| {
        let all: Vec<_> = lines.iter().filter(|l| l["tree"] == tree).collect();
        let [one, two] = all[..] else { panic!("{tree}: {} lines", all.len()) };
        assert_eq!((&one["threads"], &two["threads"]), (&1.into(), &2.into()));
        assert!(one["cpu_s"].as_f64().unwrap() > 0.0 && one["wall_s"].as_f64().unwrap() > 0.0);
        if cfg!(target_os = "linux") && !one["peak_bytes"].is_null() {
            assert!(one["peak_bytes"].as_u64() >= one["tree_bytes"].as_u64(), "{one}");
        }
        if tree != "obvhs" {
            assert_eq!(one["hash"], two["hash"], "{tree} depends on the number of threads");
            assert_eq!(one["nodes"], two["nodes"]);
        }
        one["tree_bytes_per_triangle"].as_f64().unwrap()
    };
    assert!(tree_bytes("kd0") > tree_bytes("kd1") && tree_bytes("kd1") > tree_bytes("kd2"));
    assert!(tree_bytes("obvhs") > 0.0);
    let again = build(&["--threads", "1", "--trees", "kd2", "--json"]);
    assert_eq!(again.len(), 1);
    let kd2 = lines.iter().find(|l| l["tree"] == "kd2").unwrap();
    assert_eq!((&again[0]["hash"], &again[0]["tree_bytes"]), (&kd2["hash"], &kd2["tree_bytes"]));

    let table = Tessera::new(["bench", "build", "gen:sphere:2000", "--threads", "1", "--plain"]).run().ok();
    for word in ["sphere-1848", "plain", "kd0", "kd1", "kd2", "obvhs", "peak B/tri"] {
        assert!(table.contains(word), "no {word}: {table}");
    }
    // What the process of one tree says when it is given no pack.
    Tessera::new(["bench", "build-one", "kd2", "1"]).run().fails(1, &["pack"]);
}

#[test]
fn pack_times_every_stage_and_makes_the_pack_of_a_render() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    let tessera = |args: &[&str]| Tessera::new(args).within(folder.path()).run();
    let bench = tessera(&["bench", "pack", "a.ply", "--json", "--threads", "2"]).json();
    let packed = tessera(&["scene", "pack", "a.ply", "--out", "a.tpack", "--json"]).json();
    assert_eq!((&bench["pack_id"], &bench["bytes"]), (&packed["pack_id"], &packed["bytes"]));
    let stages: Vec<_> =
        bench["stages"].as_array().unwrap().iter().map(|s| s["stage"].as_str().unwrap()).collect();
    assert_eq!(stages, ["read", "flatten", "quantise", "build tree", "assemble"]);
    let sections: u64 =
        bench["sections"].as_array().unwrap().iter().map(|s| s["bytes"].as_u64().unwrap()).sum();
    // The rest is header and alignment.
    let bytes = bench["bytes"].as_u64().unwrap();
    assert!(sections > 0 && sections < bytes && bytes - sections < 4096, "{sections} of {bytes}");

    let table = tessera(&["bench", "pack", "gen:pipes:2000", "--refs", "0"]).ok();
    for word in ["pipes-2172, 2172 triangles", "build tree", "kdslot", "pack id"] {
        assert!(table.contains(word), "no {word}: {table}");
    }
    tessera(&["bench", "pack", "a.tpack"]).fails(2, &["a.tpack", "name the scene"]);
}

/// A scene with mirrors and glass, as small as they are made.
const TINY: &str = "[generate]\nkind = \"cornell\"\ntriangles = 1000\n";

#[test]
fn gpu_measures_each_kernel_and_all_make_one_picture() {
    if gpu().is_none() {
        return;
    }
    let folder = Folder::new();
    folder.write("tiny.toml", TINY);
    let bench = |more: &[&str]| {
        let args = ["bench", "gpu", "tiny.toml", "--size", "32x32", "--reps", "1"];
        Tessera::new(args).args(more).within(folder.path()).run().ok()
    };
    let out = bench(&["--json"]);
    let lines: Vec<serde_json::Value> =
        out.lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect();
    let keys = "scene adapter adapter_kind driver what variant form f64 lean plain refs size depth reps backend seconds_median \
                seconds_min seconds_max cpu_seconds rays mrays_s ratio_to_cpu cpu_seconds_ratio kernel_bytes compile_s upload_s \
                differing_pixels psnr_db hash";
    let mut hashes: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for line in &lines {
        assert!(keys.split_whitespace().all(|key| line.get(key).is_some()), "{line}");
        assert_eq!((&line["scene"], &line["size"]), (&"tiny".into(), &serde_json::json!([32, 32])));
        let number = |key: &str| line[key].as_f64().unwrap_or_else(|| panic!("no {key}: {line}"));
        assert!(number("seconds_min") <= number("seconds_median") && number("mrays_s") > 0.0, "{line}");
        if line["what"] == "primary" {
            assert_eq!(line["rays"], 32 * 32);
        } else {
            assert!(number("rays") > 2000.0, "{line}");
        }
        if line["backend"] == "cpu" {
            assert!(line["adapter"].is_null() && line["form"].is_null() && line["differing_pixels"] == 0);
        } else {
            assert!(number("kernel_bytes") > 1000.0 && number("compile_s") > 0.0 && number("upload_s") > 0.0);
            assert!(number("differing_pixels") < 32.0 * 32.0 / 10.0, "{line}");
        }
        let picture = format!("{} {} {} {}", line["what"], line["plain"], line["refs"], line["f64"]);
        hashes.entry(picture).or_default().push(line["hash"].as_str().expect("a hash"));
    }
    assert!(hashes.values().all(|all| all.iter().all(|hash| hash == &all[0])), "{hashes:?}");
    let forms = |lean: bool| {
        let usual = |l: &&serde_json::Value| l["what"] == "frame" && l["plain"] == false && l["refs"] == 2;
        let of = lines.iter().filter(usual).filter(|l| l["lean"] == lean && l["f64"] != false);
        of.map(|l| l["form"].as_str().expect("a form")).collect::<Vec<_>>()
    };
    assert_eq!(forms(true), forms(false));
    assert!(lines.iter().any(|l| l["plain"] == true && l["refs"] == 0 && l["backend"] == "gpu"));
    // What a render of the same scene prints.
    let render = ["render", "tiny.toml", "--out", "a.png", "--size", "32x32", "--backend", "cpu", "--json"];
    let render = Tessera::new(render).within(folder.path()).run().json();
    assert_eq!(lines[0]["hash"], render["image_hash"]);
    assert!(render.get("gpu_kernel").is_none());
}

#[test]
fn gpu_refuses_what_cannot_be_measured() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("a.tpack", "");
    let check = |code, args: &[&str], says: &[&str]| {
        let hide = |run: Tessera, name| run.env(name, "/nonexistent/driver.json");
        let hidden = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"].into_iter();
        let run = hidden.fold(Tessera::new(["bench", "gpu"]), hide);
        run.args(args).within(folder.path()).run().fails(code, says);
    };
    check(1, &["a.ply"], &["no GPU was found", "install its Vulkan driver"]);
    check(1, &["none.ply"], &["no GPU was found"]);
    check(2, &["a.tpack"], &["a.tpack", "name the scene"]);
    check(2, &["a.ply", "--size", "9"], &["WIDTHxHEIGHT"]);
    check(2, &["a.ply", "--reps", "0"], &["--reps"]);
    check(2, &["a.ply", "--gpu", ""], &["--gpu"]);
}

/// `scene info` names the kernel, and a render on a GPU does.
#[test]
fn a_scene_says_which_kernel_it_needs() {
    let folder = Folder::new();
    folder.write("a.ply", PLY);
    folder.write("tiny.toml", TINY);
    let info = |args: &[&str]| Tessera::new(["scene", "info"]).args(args).within(folder.path()).run();
    // A scan: flat, opaque, rough, of one material, without textures.
    let kernel = info(&["a.ply", "--json"]).json()["kernel"].clone();
    for (part, is_in) in kernel["parts"].as_object().expect("parts") {
        let is_left_out =
            kernel["left_out"].as_array().expect("a list").iter().any(|left_out| left_out == part.as_str());
        assert_eq!(is_in.as_bool(), Some(!is_left_out), "{kernel}");
        let is_named = kernel["name"].as_str().expect("a name").split('+').any(|named| named == part);
        assert_eq!(is_in.as_bool(), Some(is_named), "{kernel}");
    }
    for part in
        ["refs", "normals", "textures", "colors", "materials", "holes", "see-through", "mirrors", "glass"]
    {
        assert_eq!(kernel["parts"][part], false, "{part}: {kernel}");
    }
    let tiny = info(&["tiny.toml", "--json"]).json()["kernel"].clone();
    for part in ["normals", "materials", "see-through", "mirrors", "glass"] {
        assert_eq!(tiny["parts"][part], true, "{part}: {tiny}");
    }
    let name = tiny["name"].as_str().expect("a name");
    let text = info(&["tiny.toml"]).ok();
    assert!(text.contains(&format!("\nkernel     {name}, left out: ")), "{text}");

    if gpu().is_none() {
        return;
    }
    let render = |more: &[&str]| {
        let args = ["render", "tiny.toml", "--out", "a.png", "--size", "16x16", "--backend", "gpu"];
        Tessera::new(args).args(more).within(folder.path()).run()
    };
    let out = render(&["--json"]).ok();
    let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(report["gpu_kernel"], tiny["name"]);
    let text = render(&[]).ok();
    assert!(text.contains(&format!("\nkernel     {name}\n")), "{text}");
}
