//! Join strings on the command line.

use super::CommandError;
use std::fs::File;
use std::io::Read;
use tessera_wire::JoinString;

/// Where a join string is looked for when none is given.
const VARIABLE: &str = "TESSERA_JOIN";

/// The join string that was given: itself, `@FILE`, or nothing, which leaves it to [`VARIABLE`].
pub fn find(given: Option<&str>) -> Result<JoinString, CommandError> {
    let variable = || std::env::var(VARIABLE).ok().filter(|text| !text.is_empty());
    let (text, place) = match given {
        Some(given) => (given.to_owned(), "--join"),
        None => match variable() {
            Some(text) => (text, VARIABLE),
            None => {
                let hint = "give --join STRING or --join @FILE, as `tessera master` prints it";
                return Err(CommandError::Usage(format!("no join string: {hint}, or set {VARIABLE}")));
            }
        },
    };
    parse(&text, place)
}

/// Whether [`find`] would read a file, which may hold another join string next time.
pub fn is_file(given: Option<&str>) -> bool {
    match given {
        Some(given) => given.starts_with('@'),
        None => std::env::var(VARIABLE).is_ok_and(|text| text.starts_with('@')),
    }
}

/// A join string, or `@FILE` that holds one; `place` is where it was given.
pub fn parse(text: &str, place: &str) -> Result<JoinString, CommandError> {
    match text.strip_prefix('@') {
        Some(path) => {
            let text =
                read(path).map_err(|e| CommandError::Failed(format!("{place}: cannot read {path}: {e}")))?;
            text.parse().map_err(|e| CommandError::Failed(format!("{place}: {path}: {e}")))
        }
        None => text.parse().map_err(|e| CommandError::Usage(format!("{place}: {e}"))),
    }
}

/// A short text file.
fn read(path: &str) -> std::io::Result<String> {
    /// Far more than a join string has.
    const BYTES_MAX: u64 = 4096;
    // Before opening: opening a pipe without a writer blocks for ever.
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("not a regular file; name the file that --join-file has written"));
    }
    let mut text = String::new();
    File::open(path)?.take(BYTES_MAX).read_to_string(&mut text)?;
    Ok(text)
}
