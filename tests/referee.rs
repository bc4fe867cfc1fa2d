//! Judges from outside, where they are installed: `tests/referee/README.md` says how.

use crate::support::{root, scene_folder, skipped};
use std::process::Command;

/// The Python that the referees are installed for, if it knows `modules`.
fn python(modules: &str) -> Option<String> {
    let python = std::env::var("TESSERA_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let found = Command::new(&python).args(["-c", &format!("import {modules}")]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    skipped(format_args!(
        "{python} cannot import {modules}; tests/referee/README.md says how, TESSERA_PYTHON which"
    ));
    None
}

/// Runs a script of `tests/referee/`, which says by its exit code whether it agrees.
fn agrees(python: &str, script: &str, more: &[&str]) {
    let mut command = Command::new(python);
    command.arg(root().join("tests/referee").join(script));
    command.args(["--tessera", env!("CARGO_BIN_EXE_tessera")]).args(more);
    if let Some(scenes) = scene_folder() {
        command.env("TESSERA_SCENES", scenes);
    }
    let output = command.output().expect("python starts");
    let said = String::from_utf8_lossy(&output.stdout);
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.is_empty(), "{script} does not agree:\n{said}\n{complaint}");
}

#[test]
fn flip_agrees_with_the_program_of_its_authors() {
    if let Some(python) = python("flip_evaluator, numpy") {
        agrees(&python, "flip.py", &[]);
    }
}

#[test]
fn direct_light_agrees_with_mitsuba() {
    if let Some(python) = python("mitsuba, OpenEXR, numpy") {
        agrees(&python, "mitsuba.py", &["--size", "192"]);
    }
}
