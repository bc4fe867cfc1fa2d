//! What an importer says while it reads: errors with their place, warnings, counts.

use super::limits::{NAME_KEPT_MAX, NAME_SHOWN_MAX, WARNINGS_MAX};
use crate::{Scene, SceneError};
use std::path::{Path, PathBuf};

/// Collects what is to be said about one source file.
#[derive(Debug)]
pub(crate) struct Report {
    path: PathBuf,
    warnings: Vec<String>,
    unsaid: u64,
    dropped: Vec<(&'static str, u64)>,
}

impl Report {
    pub(crate) fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), warnings: Vec::new(), unsaid: 0, dropped: Vec::new() }
    }

    /// An error about this file; `what` names the place in it and what to do.
    pub(crate) fn invalid(&self, what: impl Into<String>) -> SceneError {
        SceneError::Invalid { path: self.path.clone(), what: what.into() }
    }

    /// Adds a warning once: what, where, what it means for the picture.
    pub(crate) fn warn(&mut self, what: impl Into<String>) {
        let what = what.into();
        if self.warnings.contains(&what) {
            return;
        }
        if self.warnings.len() < WARNINGS_MAX {
            self.warnings.push(what);
        } else {
            self.unsaid += 1;
        }
    }

    /// Counts input that is left out.
    pub(crate) fn drop(&mut self, kind: &'static str, count: u64) {
        if count == 0 {
            return;
        }
        match self.dropped.iter_mut().find(|entry| entry.0 == kind) {
            Some(entry) => entry.1 += count,
            None => self.dropped.push((kind, count)),
        }
    }

    /// Hands everything to the scene.
    pub(crate) fn finish(mut self, scene: &mut Scene) {
        if self.unsaid > 0 {
            self.warnings.push(format!("{} further warnings are not listed", self.unsaid));
        }
        scene.warnings.append(&mut self.warnings);
        scene.dropped.append(&mut self.dropped);
    }
}

/// A name from a file as a message may show it: control characters escaped (a terminal would obey them), cut when long.
pub(crate) fn shown(name: &str) -> String {
    let mut out: String = name.chars().take(NAME_SHOWN_MAX).flat_map(char::escape_debug).collect();
    if name.chars().nth(NAME_SHOWN_MAX).is_some() {
        out.push_str("...");
    }
    out
}

/// What there is to choose from: some of the names in quotes, and how many there are besides.
pub fn listed<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    const SHOWN: usize = 12;
    let more = names.len().saturating_sub(SHOWN);
    let mut shown: Vec<_> = names.take(SHOWN).map(|name| format!("\"{}\"", shown(name))).collect();
    if more > 0 {
        shown.push(format!("and {more} more"));
    }
    if shown.is_empty() { "none".to_owned() } else { shown.join(", ") }
}

/// A name from a file as the scene keeps it: no control characters (it will be printed), and not without end.
pub(crate) fn clean(name: &str) -> String {
    let end = name.char_indices().nth(NAME_KEPT_MAX).map_or(name.len(), |(at, _)| at);
    without_controls(&name[..end])
}

/// What a library says of a file, on one line; names in it come from the file and must not steer a terminal.
pub(crate) fn one_line(text: &str) -> String {
    without_controls(&text.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// `text` with control characters replaced.
pub(crate) fn without_controls(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_said_once_and_not_without_end() {
        let mut report = Report::new(Path::new("a.obj"));
        for i in 0..WARNINGS_MAX + 10 {
            report.warn(format!("line {i}"));
            report.warn(format!("line {i}"));
        }
        report.drop("faces", 2);
        report.drop("faces", 3);
        report.drop("nothing", 0);
        let mut scene = Scene::default();
        report.finish(&mut scene);
        assert_eq!(scene.warnings.len(), WARNINGS_MAX + 1);
        assert_eq!(scene.warnings[WARNINGS_MAX], "20 further warnings are not listed");
        assert_eq!(scene.dropped, [("faces", 5)]);
    }

    #[test]
    fn lists_are_short() {
        let names: Vec<String> = (0..14).map(|i| format!("n{i}")).collect();
        let list = |count| listed(names[..count].iter().map(String::as_str));
        assert_eq!(list(0), "none");
        assert_eq!(list(2), "\"n0\", \"n1\"");
        assert!(list(12).ends_with("\"n11\""));
        assert!(list(14).ends_with("\"n11\", and 2 more"));
    }

    #[test]
    fn names_cannot_steer_a_terminal() {
        assert_eq!(shown("a\u{1b}[2Jb"), "a\\u{1b}[2Jb");
        assert_eq!(one_line(" a\n  b\u{1b}[2J\n"), "a b\u{fffd}[2J");
        assert_eq!(clean("a\u{1b}[2J\nb c"), "a\u{fffd}[2J\u{fffd}b c");
        assert_eq!(clean(&"é".repeat(300)).chars().count(), NAME_KEPT_MAX);
        assert_eq!(shown(&"x".repeat(200)).len(), NAME_SHOWN_MAX + 3);
    }
}
