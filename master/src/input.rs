//! Opening files that the user named.

use std::fs::{self, File};
use std::path::Path;

/// Opens a regular file of at most `bytes_max` bytes: the file and its length. The error says what is wrong, but not where.
pub(crate) fn open(path: &Path, bytes_max: u64) -> Result<(File, u64), String> {
    let unreadable = |e: std::io::Error| format!("cannot be read: {e}");
    // Before opening: opening a pipe without a writer blocks, and a device may never end.
    let metadata = fs::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() {
        return Err(format!(
            "is {}; name a file",
            if metadata.is_dir() { "a folder" } else { "not a regular file" }
        ));
    }
    let file = File::open(path).map_err(unreadable)?;
    match metadata.len() {
        length if length > bytes_max => {
            Err(format!("has {length} bytes, more than the {bytes_max} that are allowed here"))
        }
        length => Ok((file, length)),
    }
}
