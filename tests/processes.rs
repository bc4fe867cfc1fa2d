//! One image from every number of workers, tile size and balancing; no process outlives its master.

#[cfg(unix)]
use crate::support::signal;
use crate::support::{Folder, Tessera};
use serde_json::Value;

const BALANCES: [&str; 4] = ["paper-static", "static", "paper-dynamic", "dynamic"];

/// A folder with `box.tpack`: mirror, glass, shadows, packed once for all runs of a test.
fn packed_box() -> Folder {
    let folder = Folder::new();
    folder.write("box.toml", "[generate]\nkind = \"cornell\"\ntriangles = 2000\n");
    Tessera::new(["scene", "pack", "box.toml", "--out", "box.tpack"]).within(folder.path()).run().ok();
    folder
}

/// A render of the box; `--json` and what is given.
fn render(folder: &Folder, args: &str) -> Tessera {
    Tessera::new(["render", "box.tpack", "--out", "box.png", "--json"])
        .args(args.split(' '))
        .within(folder.path())
}

pub fn hash(report: &Value) -> &str {
    report["image_hash"].as_str().expect("a hash")
}

#[test]
fn every_crew_makes_one_image() {
    let folder = packed_box();
    // Sides that no tile divides.
    let expected = render(&folder, "--size 203x129 --tile 64").run().json();
    let tiles = [32, 48, 128, 256];
    for (i, workers) in [0, 1, 2, 3, 5, 8].into_iter().enumerate() {
        for (j, balance) in BALANCES.into_iter().enumerate() {
            // Every balancing meets every tile size.
            let tile = tiles[(i + j) % tiles.len()];
            let args =
                format!("--size 203x129 --workers {workers} --balance {balance} --tile {tile} --threads 1");
            let report = render(&folder, &args).run().json();
            assert_eq!(hash(&report), hash(&expected), "{args}");
            let crew = report["workers"].as_array().expect("workers");
            assert_eq!(crew.len(), workers.max(1), "{args}");
            let rendered: u64 = crew.iter().map(|w| w["tiles"].as_u64().expect("tiles")).sum();
            assert_eq!(rendered, 203_u64.div_ceil(tile) * 129_u64.div_ceil(tile), "{args}");
            assert_eq!(report["rays"], expected["rays"], "{args}: each tile is counted once");
        }
    }
}

#[test]
fn every_format_and_sample_count_is_one_image_on_every_crew() {
    let folder = packed_box();
    for (out, args) in [
        ("box.exr", "--size 67x45 --spp 3"),
        ("deep.png", "--size 67x45 --bits 16 --spp 2"),
        ("plain.png", "--size 67x45 --without shadows,reflection,refraction"),
    ] {
        let crews = [
            "--workers 0 --threads 2 --kernel scalar",
            "--workers 0 --threads 2 --kernel wide",
            "--workers 3 --threads 1 --tile 16 --kernel auto",
        ];
        let reports = crews.map(|crew| {
            let run = Tessera::new(["render", "box.tpack", "--out", out, "--json"]).within(folder.path());
            run.args(args.split(' ')).args(crew.split(' ')).run().json()
        });
        for report in &reports {
            assert_eq!(hash(report), hash(&reports[0]), "{out} {args}, kernel {}", report["kernel"]);
        }
        assert_eq!(reports[0]["kernel"], "scalar");
        assert!(reports[1]["kernel"].as_str().is_some_and(|name| name.starts_with("8-wide")));
    }
}

#[test]
fn a_bundle_renders_like_its_source() {
    let folder = packed_box();
    let bundle = render(&folder, "--size 64x64").run().json();
    let source = Tessera::new(["render", "box.toml", "--out", "b.png", "--size", "64x64", "--json"])
        .within(folder.path())
        .run()
        .json();
    for key in ["image_hash", "pack_id", "camera"] {
        assert_eq!(bundle[key], source[key], "{key}");
    }
}

#[test]
fn workers_log_as_their_master_does() {
    let folder = packed_box();
    let run = |args: &str| render(&folder, &format!("--size 64x64 --workers 2 {args}")).run();
    let is_of_worker = |target: &str| target.starts_with("tessera_worker");
    let outcome = run("-v --log-format json");
    let lines: Vec<Value> = outcome
        .stderr
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{line:?} is no JSON: {e}")))
        .collect();
    let connected = lines.iter().filter(|line| {
        line["target"].as_str().is_some_and(is_of_worker)
            && line["fields"]["message"].as_str().is_some_and(|text| text.contains("is connected to"))
    });
    assert_eq!(connected.count(), 2, "{outcome:?}");
    let outcome = run("-v");
    assert_eq!(outcome.stderr.matches("is connected to").count(), 2, "{outcome:?}");
    // `json` takes no line on stderr.
    run("--spp 1").json();
}

#[cfg(unix)]
#[test]
fn a_master_renders_for_clients_on_workers_that_join() {
    use std::os::unix::fs::PermissionsExt;
    let folder = packed_box();
    let run = |args: &str| Tessera::new(args.split(' ')).within(folder.path());
    let mut master = run("master --listen 127.0.0.1:0 --join-file join.txt").start();
    master.wait_for("listening on 127.0.0.1");
    let file = folder.file("join.txt");
    let join = std::fs::read_to_string(&file).expect("the join file");
    let mode = std::fs::metadata(&file).expect("the join file").permissions().mode();
    assert_eq!(mode & 0o777, 0o600, "nobody else's business");
    let mut workers = vec![run("worker --join @join.txt --threads 1 --name first").start()];
    master.wait_for("first has joined");
    workers.push(run("worker --threads 1 --name second").env("TESSERA_JOIN", join.trim()).start());
    master.wait_for("second has joined");

    for args in
        ["--size 203x129 --tile 32", "--size 64x48 --spp 2 --bits 16 --balance paper-static --tile 16"]
    {
        let local = render(&folder, args).run().json();
        let picture = std::fs::read(folder.file("box.png")).expect("the picture");
        let elsewhere = render(&folder, &format!("{args} --master @join.txt")).run().json();
        assert_eq!(hash(&elsewhere), hash(&local), "{args}");
        assert_eq!(std::fs::read(folder.file("box.png")).expect("the picture"), picture, "{args}");
        for key in ["rays", "pack_id", "camera", "numeric_class"] {
            assert_eq!(elsewhere[key], local[key], "{key}");
        }
        assert_eq!(elsewhere["workers"].as_array().map(Vec::len), Some(2), "{elsewhere}");
    }

    // Who may not join: one line, and no second attempt.
    let cut = &join[..join.len() / 2];
    run("worker").env("TESSERA_JOIN", cut).run().fails(2, &["TESSERA_JOIN: the join string is cut off"]);
    run("worker").run().fails(2, &["no join string", "--join"]);
    run("worker --join @none.txt").run().fails(1, &["cannot read none.txt"]);
    let nobody = "render box.tpack --out no.png --master";
    run(&format!("{nobody} tessera1.x")).run().fails(2, &["--master: the join string is cut off"]);
    run(&format!("{nobody} @join.txt --workers 2")).run().fails(2, &["--workers", "--master"]);

    signal("TERM", master.id());
    let outcome = master.finish();
    assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(0), join.as_str()), "{outcome:?}");
    assert_eq!(outcome.stderr.matches("client ").count(), 4, "each client comes and goes: {outcome:?}");
    for worker in workers {
        let outcome = worker.finish();
        assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(0), ""), "{outcome:?}");
    }
    assert!(!folder.names().contains(&"no.png".into()));
}

#[cfg(target_os = "linux")]
mod ends {
    use super::*;
    use crate::support::{signal_group, wait_until_ended};

    /// Much longer than any test waits, unless it is ended.
    const ENDLESS: &str = "--size 512x512 --spp 65536 -v";

    #[test]
    fn ctrl_c_and_sigterm_leave_no_process_and_no_file() {
        let folder = packed_box();
        let before = folder.names();
        for (name, workers) in [("INT", 0), ("INT", 3), ("TERM", 0), ("TERM", 3)] {
            let mut run = render(&folder, &format!("{ENDLESS} --workers {workers}")).in_own_group().start();
            run.wait_for("all workers hold the scene");
            let children = run.children();
            assert_eq!(children.len(), workers);
            signal_group(name, run.id());
            let outcome = run.finish();
            assert_eq!(outcome.code, Some(130), "{outcome:?}");
            assert!(outcome.stderr.ends_with("tessera: error: interrupted\n"), "{outcome:?}");
            children.into_iter().for_each(wait_until_ended);
            assert_eq!(folder.names(), before);
        }
    }

    #[test]
    fn ctrl_c_is_heard_while_the_scene_is_prepared() {
        let folder = Folder::new();
        folder.write("large.toml", "[generate]\nkind = \"cornell\"\ntriangles = 2000000\n");
        let before = folder.names();
        for (name, args) in
            [("INT", "scene pack large.toml --out a.tpack -v"), ("TERM", "render large.toml --out a.png -v")]
        {
            let mut run = Tessera::new(args.split(' ')).within(folder.path()).start();
            run.wait_for("preparing large.toml");
            signal(name, run.id());
            let outcome = run.finish();
            assert_eq!(outcome.code, Some(130), "{outcome:?}");
            assert!(outcome.stderr.ends_with("tessera: error: interrupted\n"), "{outcome:?}");
            assert_eq!(folder.names(), before);
        }
    }

    #[test]
    fn workers_end_with_a_master_that_is_killed() {
        let folder = packed_box();
        let mut run = render(&folder, &format!("{ENDLESS} --workers 2")).start();
        run.wait_for("all workers hold the scene");
        let children = run.children();
        assert_eq!(children.len(), 2);
        signal("KILL", run.id());
        children.into_iter().for_each(wait_until_ended);
    }

    #[test]
    fn a_worker_killed_in_the_middle_changes_nothing() {
        let folder = packed_box();
        let size = "--size 256x256 --spp 16 --tile 32";
        let expected = render(&folder, size).run().json();
        for balance in BALANCES {
            let args = format!("{size} --workers 3 --threads 1 --balance {balance} -v");
            let mut run = render(&folder, &args).start();
            // The frame, of a million paths, is still to come.
            run.wait_for("all workers hold the scene");
            signal("KILL", run.children()[1]);
            let outcome = run.finish();
            let report: Value = serde_json::from_str(&outcome.ok()).expect("one JSON object");
            assert_eq!(hash(&report), hash(&expected), "{balance}");
            let lost = report["workers"].as_array().expect("workers").iter().filter(|w| !w["lost"].is_null());
            assert_eq!(lost.count(), 1, "{balance}: {report}");
        }
    }

    #[test]
    fn a_worker_that_is_stopped_in_the_middle_changes_nothing() {
        let folder = packed_box();
        let size = "--size 256x256 --spp 16 --tile 32";
        let expected = render(&folder, size).run().json();
        for balance in ["static", "dynamic"] {
            let args = format!("{size} --workers 2 --threads 1 --balance {balance} -v");
            let mut run = render(&folder, &args).start();
            run.wait_for("all workers hold the scene");
            // Its connection is silent from now on, and only that.
            signal("STOP", run.children()[0]);
            let report: Value = serde_json::from_str(&run.finish().ok()).expect("one JSON object");
            assert_eq!(hash(&report), hash(&expected), "{balance}");
        }
    }

    #[test]
    fn a_render_without_any_worker_left_fails() {
        let folder = packed_box();
        let before = folder.names();
        let mut run = render(&folder, &format!("{ENDLESS} --workers 2")).start();
        run.wait_for("all workers hold the scene");
        run.children().into_iter().for_each(|child| signal("KILL", child));
        let outcome = run.finish();
        assert_eq!(outcome.code, Some(1), "{outcome:?}");
        let last = outcome.stderr.lines().last().unwrap_or_default();
        assert!(last.starts_with("tessera: error: all workers were lost"), "{outcome:?}");
        assert_eq!(folder.names(), before);
    }
}
