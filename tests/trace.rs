//! What a run records of its tiles: a file that is what trace viewers read, its explanation, and pictures of it.

use crate::support::{Folder, Tessera};
use serde_json::Value;
use std::collections::BTreeMap;
use tessera_wire::{Fingerprint, JoinString, Token};

/// Checks a file against 'Trace Event Format' (Google, 2016), JSON object format: the fields that each kind of event must have, of the right type,
/// in order of time, without negative lengths, and no two complete events at a time on a track. The complete events by name.
fn complete_events(file: &Value) -> BTreeMap<String, usize> {
    let (mut last, mut ends, mut names) = (0, BTreeMap::new(), BTreeMap::new());
    for event in file["traceEvents"].as_array().expect("a list") {
        let number = |field: &str| event[field].as_u64().unwrap_or_else(|| panic!("{field} of {event}"));
        let name = event["name"].as_str().expect("a name");
        let (ts, track) = (number("ts"), (number("pid"), number("tid")));
        assert!(ts >= last, "{event} comes after {last}");
        last = ts;
        match event["ph"].as_str() {
            Some("X") => {
                let end = ends.insert(track, ts + number("dur")).unwrap_or(0);
                assert!(ts >= end, "{event} overlaps what ends at {end}");
                *names.entry(name.to_owned()).or_default() += 1;
            }
            Some("M") => {
                let args = event["args"].as_object().expect("what it says");
                match name {
                    "process_name" | "thread_name" => assert!(args["name"].is_string(), "{event}"),
                    "process_sort_index" | "thread_sort_index" => {
                        assert!(args["sort_index"].is_u64(), "{event}");
                    }
                    _ => panic!("{event} says nothing that is known"),
                }
            }
            kind => panic!("{kind:?} of {event}"),
        }
    }
    names
}

#[test]
fn a_run_is_recorded_explained_and_drawn() {
    let folder = Folder::new();
    let demo = ["demo", "--size", "100x64", "--tile", "16", "--workers", "2", "--trace", "trace.json"];
    let run = Tessera::new(demo).args(["--overlay", "workers,cost", "--json"]).within(folder.path()).run();
    let report = run.json();
    assert_eq!(folder.names(), ["demo.cost.png", "demo.png", "demo.workers.png", "trace.json"]);

    // Every tile is rendered and comes once.
    let text = std::fs::read_to_string(folder.path().join("trace.json")).expect("it was written");
    let trace: Value = serde_json::from_str(&text).expect("JSON");
    let names = complete_events(&trace);
    for tile in 0..7 * 4 {
        assert_eq!(names.get(&format!("tile {tile}")), Some(&1), "{names:?}");
    }
    assert_eq!((names["transfer"] <= 28, names["frame 1"]), (true, 1));
    assert!(trace["otherData"]["clocks"].as_str().expect("a word").contains("clock"));
    let frame = &trace["tessera"]["frames"][0];
    let bytes: u64 =
        frame["tiles"].as_array().expect("tiles").iter().map(|t| t["wire_bytes"].as_u64().unwrap_or(0)).sum();
    assert_eq!(report["pixels"]["bytes_wire"].as_u64(), Some(bytes));

    // It is explained, from the same file and from the run alone.
    let why = Tessera::new(["why-slow", "trace.json", "--json"]).within(folder.path()).run().json();
    let shares: f64 = why["shares"].as_object().expect("shares").values().filter_map(Value::as_f64).sum();
    assert!((shares - 1.0).abs() < 1e-6, "{why}");
    folder.write("run.json", trace["tessera"].to_string().as_bytes());
    let same = Tessera::new(["why-slow", "run.json", "--json"]).within(folder.path()).run().json();
    assert_eq!(why, same);
    let text = Tessera::new(["why-slow", "trace.json"]).within(folder.path()).run().ok();
    assert!(
        ["render ", "link ", "imbalance ", "tail ", "master ", "helps most "]
            .iter()
            .all(|p| text.contains(p)),
        "{text}"
    );

    // The overlays are the picture with a legend below, and differ.
    let open = |name: &str| image::open(folder.path().join(name)).expect("a picture").to_rgb8();
    let (workers, cost) = (open("demo.workers.png"), open("demo.cost.png"));
    assert!(workers.width() == 100 && workers.height() > 64 && cost.width() == 100 && workers != cost);
}

#[test]
fn what_cannot_be_recorded_is_wrong_usage() {
    let folder = Folder::new();
    let (fingerprint, token) = (Fingerprint([1; 32]), Token([2; 16]));
    let join = JoinString { host: "localhost".into(), port: 1, fingerprint, token }.to_string();
    let check = |args: &[&str], says: &[&str]| Tessera::new(args).within(folder.path()).run().fails(2, says);
    check(&["demo", "--trace", "demo.png"], &["--trace", "the picture"]);
    check(&["demo", "--trace", "a.json", "--report", "a.json"], &["--trace", "the report"]);
    check(&["demo", "--overlay", "cost", "--trace", "demo.cost.png"], &["--trace", "an overlay"]);
    check(&["demo", "--overlay", "heat"], &["--overlay", "workers, cost"]);
    for flag in [["--trace", "t.json"], ["--overlay", "cost"]] {
        let args = ["render", "none.ply", "--out", "a.png", "--master", &join];
        check(&[&args[..], &flag].concat(), &[flag[0], "a master elsewhere does not tell"]);
    }
    Tessera::new(["why-slow", "none.json"]).within(folder.path()).run().fails(1, &["none.json"]);
    for bad in ["", "{}", "[]", "{\"tessera\": 3}", "\u{0}"] {
        folder.write("bad.json", bad.as_bytes());
        Tessera::new(["why-slow", "bad.json"]).within(folder.path()).run().fails(1, &["no trace of a run"]);
    }
}
