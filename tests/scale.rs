//! The benches of clusters, run small: what they print and write, on processes that play, on processes that render, and simulated.

use crate::support::{Folder, Tessera};
use serde_json::Value;

/// A scene with mirrors and glass, as small as they are made.
const TINY: &str = "[generate]\nkind = \"cornell\"\ntriangles = 1000\n";

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("tiny.toml", TINY);
    folder
}

fn bench(folder: &Folder, args: &[&str]) -> Tessera {
    Tessera::new(["bench"]).args(args).within(folder.path())
}

fn number(of: &Value, key: &str) -> f64 {
    of[key].as_f64().unwrap_or_else(|| panic!("no {key}: {of}"))
}

/// Rows of a table whose header names its columns: each has a cell for every name.
fn cells<'a>(table: &'a str, first: &str, columns: usize) -> Vec<Vec<&'a str>> {
    let lines: Vec<_> = table.lines().collect();
    let head = lines.iter().position(|line| line.trim_start().starts_with(first)).expect("a header");
    let rows = lines[head + 1..].iter().map(|line| line.split_whitespace().collect::<Vec<_>>());
    rows.take_while(|row| row.len() == columns).collect()
}

#[test]
fn a_simulated_cluster_is_measured_written_and_asked_about() {
    let folder = folder();
    let args = ["scale", "tiny.toml", "--device", "simulated", "--size", "128x128", "--one-worker", "0.2"];
    let more =
        ["--workers", "1,4", "--quick", "--link", "wired,phone", "--balance", "paper-static,auto,dynamic"];
    let slow = ["--device-speed", "0.5", "--tile", "16", "--out", "out", "--traces", "--json"];
    let report = bench(&folder, &[&args[..], &more, &slow].concat()).run().json();
    let summaries = report["summaries"].as_array().expect("summaries");
    assert_eq!(summaries.len(), 2 * 2 * 3);
    for summary in summaries {
        // Devices of half the speed are as efficient as others, and none is more than that.
        assert!((0.2..=1.01).contains(&number(summary, "efficiency_best")), "{summary}");
        assert!((0.99..5.0).contains(&number(summary, "over_ideal")), "{summary}");
        assert!(number(summary, "master_us_per_message") > 0.0 && number(summary, "after_ms") > 0.0);
    }
    let csv = std::fs::read_to_string(folder.file("out/scale.csv")).expect("a table");
    let columns = "scene,link,balance,workers,device,run,frame,frame_ms,ideal_ms,bytes";
    assert!(csv.starts_with(columns), "{csv}");
    // One frame where a worker is alone, else two.
    assert_eq!(csv.lines().count(), 1 + 2 * 3 * (1 + 2));
    let page = std::fs::read_to_string(folder.file("out/index.html")).expect("a page");
    for part in ["Link phone", "Efficiency on wired", "Table 9", "Table 7", "What auto has chosen"] {
        assert!(page.contains(part), "no {part}");
    }
    let trace = folder.file("out/trace-phone-dynamic-4.json").display().to_string();
    let told = Tessera::new(["why-slow", &trace]).run().ok();
    assert!(told.contains("over phone") && told.contains("helps most"), "{told}");

    let ask = |more: &[&str]| bench(&folder, &[&["what-if", "out/scale.json"][..], more].concat());
    let table = ask(&["--workers", "4,8", "--masters", "1,2,4", "--balance", "all"]).run().ok();
    let rows = cells(&table, "workers", 9);
    assert_eq!(rows.len(), 2 * 3 * 9, "{table}");
    let answer = ask(&["--workers", "64", "--masters", "64", "--fault", "dies:63:10", "--json"]).run().json();
    let prediction = &answer["predictions"][0];
    // 128 rows of 16 make 8 bands.
    assert_eq!(prediction["masters"], 8, "{answer}");
    let without = ask(&["--workers", "64", "--masters", "64", "--json"]).run().json();
    let frame = |of: &Value| number(&of["predictions"][0], "frame_ms");
    assert!(frame(&answer) >= frame(&without), "one of its eight is gone: {answer}, {without}");
    // The simulated cluster was its own prediction.
    let same =
        ask(&["--workers", "4", "--device-speed", "0.5", "--balance", "dynamic", "--json"]).run().json();
    assert!(frame(&same) > 0.0 && same["cases"] == 0, "{same}");
    ask(&["--workers", "4", "--fault", "dies:4:10"]).run().fails(2, &["--fault", "no worker 4 of 4"]);
    ask(&["--workers", "4", "--fault", "sleeps:1:10"]).run().fails(2, &["slows:3:500:4"]);
}

#[test]
fn processes_that_play_and_that_render_make_the_recorded_frame() {
    let folder = folder();
    let small = ["tiny.toml", "--size", "64x64", "--quick", "--link", "loopback", "--json"];
    let played = ["scale", "--workers", "2", "--balance", "dynamic,auto", "--one-worker", "0.05"];
    let rendered =
        ["scale", "--workers", "2", "--balance", "dynamic", "--device", "real", "--device-speed", "0.3"];
    for (args, device) in [(&played[..], "replay"), (&rendered, "real")] {
        // (A frame of another hash is an error.)
        let report = bench(&folder, &[args, &small].concat()).run().json();
        assert_eq!(report["device"], device);
        for row in report["rows"].as_array().expect("rows") {
            assert!(
                number(row, "messages") >= number(row, "tiles") && number(row, "master_ms") > 0.0,
                "{row}"
            );
            assert!(number(row, "master_cpu_ms") > 0.0 && number(row, "frame_ms") > 0.0, "{row}");
        }
    }
    let sides = ["tiles", "--sides", "32,16", "--workers", "1,2", "--one-worker", "0.05", "--link", "wired"];
    let out =
        bench(&folder, &[&sides[..], &["tiny.toml", "--size", "64x64", "--quick", "--out", "out"]].concat());
    let table = out.run().ok();
    let ours: Vec<_> = table.lines().filter(|line| line.trim_start().starts_with("paper-static, ")).collect();
    assert!(ours.len() == 2 && ours.iter().all(|line| line.split_whitespace().count() == 5), "{table}");
    assert!(std::fs::read_to_string(folder.file("out/tiles.csv")).expect("a table").lines().count() > 4);
}

#[test]
fn what_cannot_be_measured_is_refused_before_it_is_tried() {
    let folder = folder();
    let link = "name = \"wired\"\nsource = \"a test\"\nduplex = \"half\"\nlatency_ms = 1\nqueue_kib = 64\nmtu = 1472\n";
    folder.write("mine.toml", link);
    folder.write("bad.toml", link.replace("wired", "a/b"));
    folder.write("a.tpack", "no pack");
    let refuse = |args: &[&str], says: &[&str]| bench(&folder, args).run().fails(2, says);
    refuse(&["scale", "tiny.toml", "--link", "wired,mine.toml"], &["--link", "two links are named `wired`"]);
    refuse(&["scale", "tiny.toml", "--link", "bad.toml"], &["bad.toml", "name: write letters"]);
    refuse(&["scale", "a.tpack", "--out", "out"], &["a.tpack", "name the scene"]);
    refuse(&["scale", "tiny.toml", "--quick", "--runs", "3"], &["--quick", "--runs"]);
    refuse(&["scale", "tiny.toml", "--traces"], &["--out"]);
    refuse(&["scale", "tiny.toml", "--workers", "2000"], &["--workers 2000", "at most"]);
    refuse(&["scale", "tiny.toml", "--workers", "4", "--device-speed", "1,0.5"], &["2 devices", "4 workers"]);
    for bench in ["scale", "tiles"] {
        let real = [bench, "tiny.toml", "--device", "real", "--workers", "256"];
        refuse(&real, &["256", "play a recording"]);
        let launch = [bench, "tiny.toml", "--device", "real", "--workers", "1", "--launch-us", "5"];
        refuse(&[&launch[..], &["--device-speed", "0.1"]].concat(), &["--launch-us"]);
    }
    folder.write("other.json", "{\"tessera_scale\": 1}");
    let what_if = ["what-if", "other.json", "--workers", "4"];
    bench(&folder, &what_if).run().fails(1, &["other.json", "no report of `tessera bench scale`"]);
}
