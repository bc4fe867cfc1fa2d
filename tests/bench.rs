//! The benches, run small: what they print, and that they compute the same each time.

use crate::support::{Folder, PLY, Tessera};
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
