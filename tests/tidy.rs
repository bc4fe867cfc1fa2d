//! The workspace's own rules: doors, what a room must not name, lengths, documents that follow their source.

use crate::support::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use toml::Table;

/// Doors: a crate and the crates that it may depend on. An arrow allows the whole chain behind it.
const DOORS: [(&str, &[&str]); 12] = [
    ("tessera-geometry", &[]),
    ("tessera-wire", &[]),
    ("tessera-trust", &["tessera-wire"]),
    ("tessera-scene", &["tessera-geometry"]),
    ("tessera-oracle", &["tessera-scene"]),
    ("tessera-quantize", &["tessera-geometry"]),
    ("tessera-kdtree", &["tessera-geometry"]),
    ("tessera-pack", &["tessera-kdtree", "tessera-quantize"]),
    ("tessera-whitted", &["tessera-pack"]),
    ("tessera-worker", &["tessera-trust", "tessera-pack", "tessera-whitted"]),
    ("tessera-master", &["tessera-trust", "tessera-pack", "tessera-scene"]),
    ("tessera", &["tessera-master", "tessera-worker", "tessera-oracle"]),
];

/// Crates that may be named by these manifests only.
const RESERVED: [(&str, &[&str]); 7] = [
    ("tokio", &["tessera", "tessera-master", "tessera-worker"]),
    ("quinn", &["tessera-master", "tessera-worker"]),
    ("rcgen", &["tessera-trust"]),
    ("wgpu", &["tessera-worker"]),
    ("naga", &["tessera-worker"]),
    ("pollster", &["tessera-worker"]),
    ("obvhs", &["tessera"]),
];

/// What no source under `shared/` may name: clocks, sockets, threads, the environment. (rayon is let in by the manifests.)
const ABSENT_IN_SHARED: [&str; 7] =
    ["Instant::now", "SystemTime", "std::net", "thread::spawn", "thread::scope", "env::var", "env::args"];

const RUST_LINES_MAX: usize = 900;
const FILE_BYTES_MAX: u64 = 1 << 20;

#[test]
fn dependencies_go_through_doors_only() {
    let doors: BTreeMap<_, _> = DOORS.into_iter().collect();
    for (name, manifest) in manifests() {
        let allowed =
            doors.get(name.as_str()).unwrap_or_else(|| panic!("{name} has no door: add it to DOORS"));
        let allowed = chain(&doors, allowed);
        for dependency in dependencies(&manifest) {
            assert!(
                !doors.contains_key(dependency.as_str()) || allowed.contains(dependency.as_str()),
                "{name} must not depend on {dependency}: it may depend on {allowed:?}"
            );
            if let Some((_, users)) = RESERVED.iter().find(|(reserved, _)| *reserved == dependency) {
                assert!(users.contains(&name.as_str()), "{name} must not depend on {dependency}");
            }
        }
    }
}

#[test]
fn every_crate_keeps_the_lints() {
    for (name, manifest) in manifests() {
        let inherits = manifest.get("lints").and_then(|l| l.get("workspace")).and_then(toml::Value::as_bool);
        assert_eq!(inherits, Some(true), "{name}: add `[lints] workspace = true`");
    }
}

#[test]
fn shared_rooms_read_no_clock_and_open_no_socket() {
    // Tests and examples may do what they need; they stand at the end of a file or in one of their own.
    let is_test =
        |path: &Path| path.iter().any(|part| part == "tests" || part == "tests.rs" || part == "examples");
    for (path, text) in sources() {
        if !path.starts_with("shared") || is_test(&path) {
            continue;
        }
        let code = text.split("#[cfg(test)]").next().unwrap_or("");
        for absent in ABSENT_IN_SHARED {
            assert!(!code.contains(absent), "{}: `{absent}` has no place in shared/", path.display());
        }
    }
}

#[test]
fn files_stay_readable() {
    for (path, text) in sources() {
        let lines = text.lines().count();
        assert!(lines <= RUST_LINES_MAX, "{}: {lines} lines, split it", path.display());
    }
    for path in files() {
        let length = fs::metadata(root().join(&path)).expect("a file").len();
        assert!(length <= FILE_BYTES_MAX, "{}: {length} bytes; keep large files elsewhere", path.display());
    }
}

#[test]
fn no_stubs_and_no_places_of_one_machine() {
    let stubs = ["todo", "unimplemented"].map(|name| format!("{name}!("));
    let places = ["work", "farm", "root", "home", "Users"].map(|name| format!("/{name}/"));
    for path in files() {
        // Cargo.lock and pictures are not written by hand.
        let Ok(text) = fs::read_to_string(root().join(&path)) else { continue };
        for place in &places {
            // A folder of a repository may be called so; an absolute path begins with it.
            let absolute = text.match_indices(place.as_str()).any(|(at, _)| {
                let before = text[..at].chars().next_back();
                !before.is_some_and(|c| c.is_alphanumeric() || matches!(c, '.' | '-' | '_' | '}' | ')'))
            });
            assert!(!absolute, "{} names {place}, a place of one machine", path.display());
        }
        for stub in stubs.iter().filter(|_| path.extension().is_some_and(|e| e == "rs")) {
            assert!(!text.contains(stub.as_str()), "{}: `{stub}` is not done", path.display());
        }
    }
}

/// `PROTOCOL.md` states the hash of the source that it describes, so that neither changes without the other being read again.
#[test]
fn the_protocol_document_follows_its_source() {
    let wire = root().join("shared/wire");
    let mut hasher = blake3::Hasher::new();
    for (path, text) in sources().into_iter().filter(|(path, _)| path.starts_with("shared/wire/src")) {
        hasher.update(path.to_string_lossy().as_bytes());
        // Tests say nothing to a peer.
        hasher.update(text.split("#[cfg(test)]").next().unwrap_or("").as_bytes());
    }
    let expected = format!("Source hash: `{}`", hasher.finalize().to_hex());
    let document = fs::read_to_string(wire.join("PROTOCOL.md")).expect("shared/wire/PROTOCOL.md");
    assert!(
        document.contains(&expected),
        "shared/wire/src has changed: read PROTOCOL.md again, mend it (and `Version`, if a message changed), and have it say\n{expected}"
    );
}

/// `HARD_INPUTS.md` names tests that exist, and has a line for each case that is within what is built so far.
#[test]
fn hard_inputs_have_their_tests() {
    let document = fs::read_to_string(root().join("tests/HARD_INPUTS.md")).expect("tests/HARD_INPUTS.md");
    // Of each room, the names of functions under `#[test]`, whatever other attributes stand between.
    let mut tests = BTreeMap::<String, BTreeSet<String>>::new();
    for (path, text) in sources() {
        let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
        let room = if parts[0] == "shared" { &parts[1] } else { &parts[0] };
        for test in text.split("#[test]").skip(1) {
            let name = test.split("fn ").nth(1).and_then(|rest| rest.split('(').next()).unwrap_or("");
            tests.entry(room.to_string()).or_default().insert(name.to_owned());
        }
    }
    let mut cases = BTreeSet::new();
    for line in document.lines() {
        let Some(case) = line.split('|').nth(1).and_then(|number| number.trim().parse::<u32>().ok()) else {
            continue;
        };
        cases.insert(case);
        let named: Vec<_> = line.split('`').filter_map(|part| part.split_once("::")).collect();
        assert!(!named.is_empty(), "hard input {case} has no test");
        for (room, test) in named {
            let is_there = tests.get(room).is_some_and(|tests| tests.contains(test));
            assert!(is_there, "hard input {case}: {room} has no test {test}");
        }
    }
    let missing: Vec<_> = (1..=43).filter(|case| !cases.contains(case)).collect();
    assert!(missing.is_empty(), "tests/HARD_INPUTS.md has no line for {missing:?}");
}

#[test]
fn rooms_are_on_the_map() {
    let map = fs::read_to_string(root().join("shared/README.md")).expect("shared/README.md");
    for entry in fs::read_dir(root().join("shared")).expect("shared/") {
        let entry = entry.expect("an entry");
        let name = entry.file_name().to_string_lossy().into_owned();
        assert!(
            !entry.path().is_dir() || map.contains(&format!("`{name}/`")),
            "shared/README.md has no line for {name}/"
        );
    }
}

/// Everything that `open` leads to.
fn chain<'a>(doors: &BTreeMap<&'a str, &'a [&'a str]>, open: &[&'a str]) -> BTreeSet<&'a str> {
    let mut open = open.to_vec();
    let mut found = BTreeSet::new();
    while let Some(name) = open.pop() {
        if found.insert(name) {
            open.extend(doors[name]);
        }
    }
    found
}

/// Name and manifest of every crate of the workspace, the root package too.
fn manifests() -> Vec<(String, Table)> {
    let read = |folder: &Path| -> Table {
        let path = folder.join("Cargo.toml");
        let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()))
    };
    let workspace = read(root());
    let members = workspace["workspace"]["members"].as_array().expect("members").clone();
    let mut all = vec![workspace];
    all.extend(members.iter().map(|member| read(&root().join(member.as_str().expect("a path")))));
    let name = |manifest: &Table| manifest["package"]["name"].as_str().expect("a name").to_owned();
    all.into_iter().map(|manifest| (name(&manifest), manifest)).collect()
}

/// Names of all dependencies, of tests and of build scripts too, of every target.
fn dependencies(manifest: &Table) -> Vec<String> {
    let mut tables = vec![manifest];
    if let Some(targets) = manifest.get("target").and_then(toml::Value::as_table) {
        tables.extend(targets.values().filter_map(toml::Value::as_table));
    }
    let kinds = ["dependencies", "dev-dependencies", "build-dependencies"];
    tables
        .into_iter()
        .flat_map(|table| kinds.map(|kind| table.get(kind).and_then(toml::Value::as_table)))
        .flatten()
        .flat_map(|table| table.keys().cloned())
        .collect()
}

/// Rust and shader sources, as paths from the root, in order.
pub fn sources() -> Vec<(PathBuf, String)> {
    let is_source = |path: &PathBuf| path.extension().is_some_and(|e| e == "rs" || e == "wgsl");
    let read = |path: PathBuf| {
        let text = fs::read_to_string(root().join(&path)).expect("a source file");
        (path, text)
    };
    files().into_iter().filter(is_source).map(read).collect()
}

/// All files of the repository, as paths from the root, in order; what is built and hidden folders are none of it.
fn files() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![PathBuf::new()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(root().join(&folder)).expect("a folder") {
            let entry = entry.expect("an entry");
            let path = folder.join(entry.file_name());
            let name = entry.file_name().to_string_lossy().into_owned();
            let kind = entry.file_type().expect("a type");
            if kind.is_dir() && name != "target" && (!name.starts_with('.') || name == ".ci") {
                open.push(path);
            } else if kind.is_file() && name != "Cargo.lock" && name != "demo.png" {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
