//! Names of numbered files.

use super::CommandError;
use std::path::{Path, PathBuf};

/// A name with a place for a number: `%d`, or `%04d` for at least four digits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    before: String,
    digits: usize,
    after: String,
}

impl Pattern {
    /// Reads the pattern that `out` is.
    pub fn parse(out: &Path) -> Result<Self, CommandError> {
        let refuse = |what: &str| {
            let out = out.display();
            CommandError::Usage(format!(
                "--out {out}: {what}; write one %d or %04d in the file's name, as in frame-%04d.png"
            ))
        };
        let folder = out.parent().and_then(Path::to_str).unwrap_or("");
        let name = out.to_str().ok_or_else(|| refuse("it is no UTF-8"))?;
        let (before, rest) = name.split_once('%').ok_or_else(|| refuse("many frames need many names"))?;
        let (digits, after) = rest.split_once('d').ok_or_else(|| refuse("`%` is followed by no `d`"))?;
        let digits = match digits.strip_prefix('0') {
            _ if digits.is_empty() => 1,
            Some(width @ ("1" | "2" | "3" | "4" | "5" | "6" | "7" | "8" | "9")) => width.parse().unwrap_or(1),
            _ => return Err(refuse("between `%` and `d` there is no number of 01 to 09")),
        };
        if after.contains('%') {
            return Err(refuse("there is a second `%`"));
        }
        if folder.contains('%') {
            return Err(refuse("the folder has the number, not the file"));
        }
        Ok(Self { before: before.into(), digits, after: after.into() })
    }

    /// The name of frame `number`.
    pub fn file(&self, number: u64) -> PathBuf {
        let Self { before, digits, after } = self;
        format!("{before}{number:0digits$}{after}").into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_place() {
        let file = |out: &str, number| Pattern::parse(Path::new(out)).unwrap().file(number);
        assert_eq!(file("frame-%04d.png", 7), Path::new("frame-0007.png"));
        assert_eq!(file("frame-%04d.png", 123_456), Path::new("frame-123456.png"));
        assert_eq!(file("a/b %d.exr", 0), Path::new("a/b 0.exr"));
        for (out, why) in [
            ("frame.png", "many frames need many names"),
            ("frame-%04x.png", "followed by no `d`"),
            ("frame-%4d.png", "no number of 01 to 09"),
            ("frame-%012d.png", "no number of 01 to 09"),
            ("frame-%sd.png", "no number of 01 to 09"),
            ("%d-%d.png", "a second `%`"),
            ("%d/frame.png", "the folder has the number"),
        ] {
            let error = Pattern::parse(Path::new(out)).unwrap_err().to_string();
            assert!(error.contains(why), "{out}: {error}");
        }
    }
}
