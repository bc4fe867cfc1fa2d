//! The corpora of the fuzz targets as plain tests: seeds, and what once made a target fail.

#[path = "fuzz/bodies.rs"]
mod bodies;

use crate::support::root;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};

#[test]
fn every_corpus_passes() {
    let folder = root().join("tests/fuzz");
    let mut bytes = 0;
    for (target, body) in bodies::TARGETS {
        assert!(folder.join(format!("fuzz_targets/{target}.rs")).is_file(), "{target} has no fuzz target");
        let corpus = fs::read_dir(folder.join("corpus").join(target)).expect("a corpus");
        let mut files: Vec<_> = corpus.map(|entry| entry.expect("an entry").path()).collect();
        files.sort();
        assert!(!files.is_empty(), "{target} has an empty corpus");
        for file in files {
            let input = fs::read(&file).expect("a seed");
            bytes += input.len();
            let passed = catch_unwind(AssertUnwindSafe(|| body(&input)));
            assert!(passed.is_ok(), "{target} fails with {}", file.display());
        }
    }
    assert!(bytes < 200 << 10, "the corpora have {bytes} bytes; minimise them (cargo fuzz cmin)");
}
