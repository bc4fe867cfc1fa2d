//! `tessera check` on the CPU, and the bugs that it must notice: `tests/MUTATIONS.md` names the cases that do.

use crate::support::{self, Tessera, root, skipped};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use tessera_geometry::mutation::{self, Mutation};

/// Bugs that one of the CPU's two kernels has.
const ONE_KERNEL: [Mutation; 4] =
    [Mutation::NoExactEdges, Mutation::WideNoExactEdges, Mutation::RangeExclusive, Mutation::LargestId];

/// How many cases one run is asked for: so that none takes long enough to be taken for hung.
const GROUP: usize = 6;

/// The ids of all cases, from what the command says where it knows one not.
fn ids() -> Vec<String> {
    let outcome = Tessera::new(["check", "--case", "none"]).run();
    assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(2), ""), "{outcome:?}");
    let (_, list) = outcome.stderr.split_once("there are ").expect("a list of cases");
    list.trim().split(", ").map(String::from).collect()
}

/// What a quick check of these cases prints, and its exit code.
fn check(cases: &[String], backend: &str, mutation: Option<&str>) -> (Option<i32>, serde_json::Value) {
    let cases = cases.join(",");
    let planted = mutation.into_iter().flat_map(|name| ["--mutation", name]);
    let args =
        ["check", "--quick", "--json", "--backend", backend, "--case", &cases].into_iter().chain(planted);
    let outcome = Tessera::new(args).run();
    let report = serde_json::from_str(&outcome.stdout);
    (outcome.code, report.unwrap_or_else(|e| panic!("{e}: {outcome:?}")))
}

#[test]
fn hard_inputs_come_out_right_on_the_cpu() {
    let ids = ids();
    assert!(ids.len() > 50, "{ids:?}");
    for group in ids.chunks(GROUP) {
        let (code, report) = check(group, "cpu", None);
        let cases = report["cases"].as_array().expect("cases");
        let said: Vec<_> = cases.iter().map(|case| case["id"].as_str().expect("an id")).collect();
        assert_eq!(said, *group);
        for case in cases {
            println!("{}: {}: {}", case["id"], case["expected"], case["got"]);
            assert_eq!(case["ok"], true, "{case:#}");
            assert!(
                ["expected", "got", "input", "judge"].iter().all(|key| case[key].is_string()),
                "{case:#}"
            );
        }
        assert_eq!((code, &report["ok"]), (Some(0), &true.into()));
        assert_eq!(report["backends"].as_array().map(Vec::len), Some(2), "ray by ray and eight at once");
    }
}

/// Rows of `MUTATIONS.md`: a bug, and the cases that must notice it.
fn listed() -> BTreeMap<String, Vec<String>> {
    let document = fs::read_to_string(root().join("tests/MUTATIONS.md")).expect("tests/MUTATIONS.md");
    let row = |line: &str| {
        let mut cells = line.split('|').skip(1);
        let name = cells.next()?.trim().strip_prefix('`')?.strip_suffix('`')?.to_owned();
        let cases = cells.nth(1)?.split(',').map(|id| id.trim().to_owned()).collect();
        Some((name, cases))
    };
    document.lines().filter_map(row).collect()
}

#[test]
fn the_list_of_planted_bugs_is_complete() {
    let listed = listed();
    let names: BTreeSet<_> = listed.keys().map(String::as_str).collect();
    assert_eq!(names, Mutation::ALL.iter().map(|m| m.name()).collect(), "tests/MUTATIONS.md");
    let document = fs::read_to_string(root().join("tests/MUTATIONS.md")).expect("tests/MUTATIONS.md");
    for mutation in Mutation::ALL {
        let row = format!("| `{}` | {} |", mutation.name(), mutation.what());
        assert!(document.contains(&row), "tests/MUTATIONS.md has no row that begins with {row}");
    }
}

#[test]
fn every_planted_bug_is_noticed() {
    const { assert!(mutation::ARE_THERE, "the root package's dev-dependencies switch them on") };
    let has_gpu = support::gpu().is_some();
    for (name, cases) in listed() {
        let backend = if name.starts_with("gpu-") { "gpu" } else { "cpu" };
        if backend == "gpu" && !has_gpu {
            skipped(format_args!("{name}: there is no GPU"));
            continue;
        }
        let (code, report) = check(&cases, backend, Some(&name));
        let noticed: Vec<_> =
            report["cases"].as_array().expect("cases").iter().filter(|case| case["ok"] == false).collect();
        println!(
            "{name}: {}",
            noticed.iter().map(|case| case["id"].to_string()).collect::<Vec<_>>().join(", ")
        );
        assert_eq!(
            (code, noticed.len()),
            (Some(1), cases.len()),
            "{name} is not noticed by all of {cases:?}: {report:#}"
        );
        let wrong = |line: &serde_json::Value| line["ok"] == false && is_an_answer(line);
        for case in &noticed {
            assert!(is_an_answer(case), "{name} is noticed by no wrong answer: {case:#}");
        }
        // A bug that both kernels have is noticed in each: by one case at least, of those that ask them one by one.
        let asks_each = noticed.iter().any(|case| case["backends"].get(0).is_some());
        if backend == "cpu" && asks_each && is_in_both(&name) {
            for (kernel, which) in [("ray by ray", 0usize), ("eight at once", 1)] {
                let mut lines = noticed.iter().filter_map(|case| case["backends"].get(which));
                assert!(lines.any(wrong), "{name} is not noticed {kernel}: {report:#}");
            }
        }
    }
}

/// Whether a case or a backend's part of it came to an answer: no panic, and no error before there was anything to judge.
fn is_an_answer(line: &serde_json::Value) -> bool {
    let came_to_one = |line: &serde_json::Value| {
        let got = line["got"].as_str().expect("what came out");
        !got.starts_with("panic") && !line["expected"].is_null() && line["expected"] != "an answer"
    };
    let lines = line["backends"].as_array().into_iter().flatten();
    came_to_one(line) && lines.filter(|line| line["ok"] == false).all(came_to_one)
}

fn is_in_both(name: &str) -> bool {
    let mutation = Mutation::ALL.iter().find(|mutation| mutation.name() == name).expect("a bug");
    !ONE_KERNEL.contains(mutation)
}

#[test]
fn what_is_not_there_is_a_wrong_usage() {
    for args in [["--mutation", "none"], ["--case", "1,none"], ["--gpu", "0"]] {
        let outcome = Tessera::new(["check", "--backend", "cpu"].into_iter().chain(args)).run();
        outcome.fails(2, &[args[0]]);
    }
}

/// Only the tests of the root package can plant bugs.
#[test]
fn a_plain_build_knows_no_bugs() {
    let manifest = |path: &str| -> toml::Table {
        fs::read_to_string(root().join(path)).expect("a manifest").parse().expect("TOML")
    };
    let root_manifest = manifest("Cargo.toml");
    let features = |kind: &str| root_manifest[kind]["tessera-geometry"].get("features").cloned();
    assert_eq!(features("dependencies"), None);
    assert_eq!(features("dev-dependencies"), Some(toml::Value::Array(vec!["mutations".into()])));
    for member in root_manifest["workspace"]["members"].as_array().expect("members") {
        let member = member.as_str().expect("a path");
        let text = fs::read_to_string(root().join(member).join("Cargo.toml")).expect("a manifest");
        assert!(member == "shared/geometry" || !text.contains("mutations"), "{member} switches bugs on");
    }
    let default = manifest("shared/geometry/Cargo.toml")["features"].as_table().expect("features").clone();
    assert!(!default.contains_key("default"), "bugs are no default: {default:?}");
}
