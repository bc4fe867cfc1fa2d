//! Files that a process leaves when it is interrupted. One test in a process of its own: what it does reaches every file.

use std::io::Write;
use tessera_master::output::{OutputFile, abandon_all};

#[test]
fn an_abandoned_file_leaves_nothing_and_the_old_one_in_place() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.bin");
    let names = || -> Vec<_> {
        let entries = std::fs::read_dir(folder.path()).expect("a folder");
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
    };
    let out = OutputFile::check(&path).expect("it can be written");
    out.write_bytes(b"old").expect("room for three bytes");
    let failed = out.write(|to| {
        to.write_all(&[1; 1 << 16])?;
        assert_eq!(names().len(), 2, "the old file and the unfinished one");
        let abandoned = abandon_all();
        assert_eq!(names(), ["a.bin"]);
        drop(abandoned);
        Ok::<_, std::io::Error>(())
    });
    assert!(failed.is_err(), "what is gone cannot be put in place");
    assert_eq!(names(), ["a.bin"]);
    assert_eq!(std::fs::read(&path).expect("it is there"), b"old");
    out.write_bytes(b"new").expect("nothing is in the way of the next");
    assert_eq!(std::fs::read(&path).expect("it is there"), b"new");
}
