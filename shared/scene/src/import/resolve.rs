//! Reads what a source refers to, and nothing else.
//!
//! A reference inside a source (buffer, image, material library) names a file in the source's own folder or below it, or
//! carries its bytes as a `data:` URI. Everything else is refused: `..` that climbs out, absolute paths, links that lead out,
//! and every URL (`file:`, `http:`, ..., `C:`): nothing is ever fetched.
//!
//! The check is on the canonical path, after links were followed; between the check and the opening somebody who can already
//! write into that folder could exchange a link. That is outside what this guards against: a hostile *file*.

use super::limits::{SOURCE_BYTES_MAX, TOTAL_BYTES_MAX};
use super::report::shown;
use crate::SceneError;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// How a reference is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Syntax {
    /// A URI reference as in glTF: percent-coded, `data:` allowed.
    Uri,
    /// A plain path as in MTL files.
    Path,
}

/// The folder of one source, and how many bytes may still be read.
#[derive(Debug)]
pub(crate) struct Resolver {
    source: PathBuf,
    folder: PathBuf,
    bytes_left: u64,
}

impl Resolver {
    /// A resolver for references inside `source`.
    pub(crate) fn new(source: &Path) -> Result<Self, SceneError> {
        let parent = match source.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let folder = parent
            .canonicalize()
            .map_err(|error| SceneError::Read { path: parent.to_owned(), source: error })?;
        Ok(Self { source: source.to_owned(), folder, bytes_left: TOTAL_BYTES_MAX })
    }

    /// The bytes behind `reference`, at most `bytes_max` of them.
    pub(crate) fn read(
        &mut self,
        reference: &str,
        syntax: Syntax,
        bytes_max: u64,
    ) -> Result<Vec<u8>, SceneError> {
        let bytes_max = bytes_max.min(self.bytes_left);
        let bytes = match data_uri(reference) {
            Some(data) if syntax == Syntax::Uri => decode_data_uri(data, bytes_max)
                .map_err(|what| self.refuse(reference, &format!("is a data: URI that {what}")))?,
            _ => {
                let path = self
                    .locate(reference, syntax)?
                    .ok_or_else(|| self.refuse(reference, "cannot be read: there is no such file"))?;
                // Messages name the reference: a path decoded from it could steer a terminal.
                read_file(&path, bytes_max).map_err(|error| match error {
                    SceneError::Read { source, .. } => {
                        self.refuse(reference, &format!("cannot be read: {source}"))
                    }
                    SceneError::Invalid { what, .. } => self.refuse(reference, &what),
                    other => other,
                })?
            }
        };
        self.bytes_left -= bytes.len() as u64;
        Ok(bytes)
    }

    /// Whether `reference` is one that may be followed but leads to nothing.
    pub(crate) fn is_missing(&self, reference: &str, syntax: Syntax) -> Result<bool, SceneError> {
        let is_data = syntax == Syntax::Uri && data_uri(reference).is_some();
        Ok(!is_data && self.locate(reference, syntax)?.is_none())
    }

    /// The canonical path of the file behind `reference`, proved to lie in the source's folder; `None` when there is none.
    fn locate(&self, reference: &str, syntax: Syntax) -> Result<Option<PathBuf>, SceneError> {
        if let Some(scheme) = scheme(reference) {
            return Err(self.refuse(
                reference,
                &format!("names the scheme '{}:'; only files beside the source are read", shown(scheme)),
            ));
        }
        let decoded = match syntax {
            Syntax::Uri => percent_decode(reference.as_bytes())
                .and_then(|bytes| {
                    String::from_utf8(bytes).map_err(|_| "is not UTF-8 after percent-decoding".to_owned())
                })
                .map_err(|what| self.refuse(reference, &what))?,
            Syntax::Path => reference.to_owned(),
        };
        if decoded.is_empty() || decoded.contains('\0') {
            return Err(self.refuse(reference, "is not a file name"));
        }
        // Files written on Windows separate with backslashes; taking them as separators everywhere also lets no `..\` through.
        if decoded.starts_with(['/', '\\']) || scheme(&decoded).is_some() {
            return Err(self.refuse(reference, "is an absolute path; put the file into the source's folder"));
        }
        let mut inside: Vec<&str> = Vec::new();
        for part in decoded.split(['/', '\\']) {
            match part {
                "" | "." => {}
                ".." => {
                    if inside.pop().is_none() {
                        return Err(self.leaves(reference));
                    }
                }
                name => inside.push(name),
            }
        }
        let path = inside.iter().fold(self.folder.clone(), |path, part| path.join(part));
        let canonical = match path.canonicalize() {
            Ok(canonical) => canonical,
            Err(error) => match error.kind() {
                ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename => {
                    return Ok(None);
                }
                _ => return Err(self.refuse(reference, &format!("cannot be read: {error}"))),
            },
        };
        if !canonical.starts_with(&self.folder) {
            return Err(self.leaves(reference));
        }
        Ok(Some(canonical))
    }

    fn leaves(&self, reference: &str) -> SceneError {
        self.refuse(reference, "leads out of the source's folder; put the file into that folder")
    }

    fn refuse(&self, reference: &str, why: &str) -> SceneError {
        SceneError::Invalid {
            path: self.source.clone(),
            what: format!("reference \"{}\" {why}", shown(reference)),
        }
    }
}

/// The bytes of a source file that the user named.
pub(crate) fn read_source(path: &Path) -> Result<Vec<u8>, SceneError> {
    read_file(path, SOURCE_BYTES_MAX)
}

/// Reads a regular file of at most `bytes_max` bytes. A pipe or a device could block for ever or never end.
pub(crate) fn read_file(path: &Path, bytes_max: u64) -> Result<Vec<u8>, SceneError> {
    let unreadable = |source| SceneError::Read { path: path.to_owned(), source };
    let invalid = |what: String| SceneError::Invalid { path: path.to_owned(), what };
    // Before opening: opening a pipe without a writer blocks.
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() {
        let what = if metadata.is_dir() { "a folder" } else { "not a regular file" };
        return Err(invalid(format!("is {what}; name a file")));
    }
    let too_long =
        |bytes: u64| invalid(format!("has {bytes} bytes, more than the {bytes_max} that are allowed here"));
    if metadata.len() > bytes_max {
        return Err(too_long(metadata.len()));
    }
    // One byte more than allowed, so that a file that grows meanwhile is noticed.
    let mut bytes = Vec::new();
    bytes
        .try_reserve_exact(usize::try_from(metadata.len()).unwrap_or(usize::MAX))
        .map_err(|_| unreadable(ErrorKind::OutOfMemory.into()))?;
    let file = File::open(path).map_err(unreadable)?;
    file.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > bytes_max {
        return Err(too_long(bytes.len() as u64));
    }
    Ok(bytes)
}

/// The scheme of a URI (RFC 3986, section 3.1): letters, digits, `+ - .` before a colon. A drive letter looks the same.
fn scheme(reference: &str) -> Option<&str> {
    let (scheme, _) = reference.split_once(':')?;
    let mut bytes = scheme.bytes();
    let first_is_letter = bytes.next().is_some_and(|byte| byte.is_ascii_alphabetic());
    let rest_fits = bytes.all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.'));
    (first_is_letter && rest_fits).then_some(scheme)
}

/// What follows `data:`, if the reference starts so.
fn data_uri(reference: &str) -> Option<&str> {
    let prefix = reference.get(..5)?;
    prefix.eq_ignore_ascii_case("data:").then(|| &reference[5..])
}

/// Decodes `[type][;parameters][;base64],data` (RFC 2397).
fn decode_data_uri(data: &str, bytes_max: u64) -> Result<Vec<u8>, String> {
    let (head, body) = data.split_once(',').ok_or("has no comma")?;
    let is_base64 = head.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64"));
    // Of four base64 characters at most the last two are padding; three characters code a byte in percents.
    let bytes_at_least =
        if is_base64 { (body.len() as u64 / 4 * 3).saturating_sub(2) } else { body.len() as u64 / 3 };
    if bytes_at_least > bytes_max {
        return Err(format!(
            "holds {bytes_at_least} bytes or more, more than the {bytes_max} that are allowed here"
        ));
    }
    let bytes = if is_base64 { decode_base64(body.as_bytes()) } else { percent_decode(body.as_bytes()) }?;
    if bytes.len() as u64 > bytes_max {
        return Err(format!("holds {} bytes, more than the {bytes_max} that are allowed here", bytes.len()));
    }
    Ok(bytes)
}

/// Decodes base64 (RFC 4648, section 4); the padding may be missing.
fn decode_base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let text = match text {
        [rest @ .., b'=', b'='] | [rest @ .., b'='] => rest,
        all => all,
    };
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for chunk in text.chunks(4) {
        let mut bits = 0_u32;
        for &byte in chunk {
            let six = match byte {
                b'A'..=b'Z' => byte - b'A',
                b'a'..=b'z' => byte - b'a' + 26,
                b'0'..=b'9' => byte - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return Err(format!("has the byte {byte:#04x} in its base64 text")),
            };
            bits = bits << 6 | u32::from(six);
        }
        bits <<= 6 * (4 - chunk.len());
        let whole = match chunk.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return Err("ends in the middle of a base64 group".to_owned()),
        };
        bytes.extend_from_slice(&bits.to_be_bytes()[1..=whole]);
    }
    Ok(bytes)
}

/// Decodes `%41` to `A` (RFC 3986, section 2.1).
fn percent_decode(text: &[u8]) -> Result<Vec<u8>, String> {
    let digit = |byte: Option<&u8>| byte.and_then(|&byte| char::from(byte).to_digit(16));
    let mut bytes = Vec::with_capacity(text.len());
    let mut at = 0;
    while let Some(&byte) = text.get(at) {
        if byte == b'%' {
            match (digit(text.get(at + 1)), digit(text.get(at + 2))) {
                (Some(high), Some(low)) => bytes.push((high * 16 + low) as u8),
                _ => {
                    return Err(
                        "has a '%' without two hexadecimal digits; write a percent sign as %25".to_owned()
                    );
                }
            }
            at += 3;
        } else {
            bytes.push(byte);
            at += 1;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `outside.bin` beside, `scene/a b.bin` and `scene/sub/c.bin` inside.
    fn folder() -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        let scene = root.path().join("scene");
        std::fs::create_dir_all(scene.join("sub")).unwrap();
        std::fs::write(root.path().join("outside.bin"), b"outside").unwrap();
        std::fs::write(scene.join("a b.bin"), b"inside").unwrap();
        std::fs::write(scene.join("sub/c.bin"), b"below").unwrap();
        root
    }

    fn read(root: &Path, reference: &str, syntax: Syntax) -> Result<Vec<u8>, String> {
        let mut resolver = Resolver::new(&root.join("scene/s.gltf")).unwrap();
        resolver.read(reference, syntax, 1000).map_err(|error| error.to_string())
    }

    #[test]
    fn reads_what_lies_inside() {
        let root = folder();
        for (reference, syntax, want) in [
            ("a%20b.bin", Syntax::Uri, "inside"),
            ("a b.bin", Syntax::Uri, "inside"),
            ("a b.bin", Syntax::Path, "inside"),
            ("./sub//c.bin", Syntax::Uri, "below"),
            ("sub\\c.bin", Syntax::Path, "below"),
            ("sub/../sub/c.bin", Syntax::Uri, "below"),
            ("data:application/octet-stream;base64,aGVsbG8=", Syntax::Uri, "hello"),
            ("DATA:;base64,aGVsbG8", Syntax::Uri, "hello"),
            ("data:,a%41b", Syntax::Uri, "aAb"),
        ] {
            assert_eq!(read(root.path(), reference, syntax).unwrap(), want.as_bytes(), "{reference}");
        }
    }

    #[test]
    fn refuses_what_leaves_the_folder() {
        let root = folder();
        let absolute = root.path().join("scene/a b.bin").display().to_string();
        for (reference, why) in [
            ("../outside.bin", "leads out"),
            ("%2e%2e/outside.bin", "leads out"),
            ("%2E%2E%2Foutside.bin", "leads out"),
            ("..\\outside.bin", "leads out"),
            ("sub/../../outside.bin", "leads out"),
            ("..", "leads out"),
            (absolute.as_str(), "absolute path"),
            ("%2fetc/passwd", "absolute path"),
            ("\\\\server\\share", "absolute path"),
            ("file:///etc/passwd", "scheme 'file:'"),
            ("FILE:a%20b.bin", "scheme 'FILE:'"),
            ("http://example.com/x.bin", "scheme 'http:'"),
            ("C:\\x.bin", "scheme 'C:'"),
            ("C%3A/x.bin", "absolute path"),
            ("%FF", "not UTF-8"),
            ("%F", "two hexadecimal digits"),
            ("100%", "two hexadecimal digits"),
            ("a%00b", "not a file name"),
            ("", "not a file name"),
            ("missing.bin", "\"missing.bin\" cannot be read"),
            ("mis%0asing%1b[2J.bin", "\"mis%0asing%1b[2J.bin\" cannot be read"),
            ("a%20b.bin/c", "cannot be read"),
            ("sub", "\"sub\" is a folder"),
            ("data:;base64,a", "middle of a base64 group"),
            ("data:;base64,a?==", "byte 0x3f"),
            ("data:nothing", "no comma"),
        ] {
            let error = read(root.path(), reference, Syntax::Uri).unwrap_err();
            assert!(error.contains(why), "{reference}: {error}");
            assert!(!error.contains(char::is_control), "{reference}: {error:?}");
        }
        let error = read(root.path(), "data:,x", Syntax::Path).unwrap_err();
        assert!(error.contains("scheme 'data:'"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn follows_links_and_checks_where_they_lead() {
        let root = folder();
        let scene = root.path().join("scene");
        std::os::unix::fs::symlink(root.path().join("outside.bin"), scene.join("out")).unwrap();
        std::os::unix::fs::symlink(root.path(), scene.join("up")).unwrap();
        std::os::unix::fs::symlink("sub/c.bin", scene.join("in")).unwrap();
        assert!(read(root.path(), "out", Syntax::Uri).unwrap_err().contains("leads out"));
        assert!(read(root.path(), "up/outside.bin", Syntax::Uri).unwrap_err().contains("leads out"));
        assert_eq!(read(root.path(), "in", Syntax::Uri).unwrap(), b"below");
    }

    #[test]
    fn limits_hold_for_one_and_for_all() {
        let root = folder();
        let mut resolver = Resolver::new(&root.path().join("scene/s.gltf")).unwrap();
        let error = resolver.read("a%20b.bin", Syntax::Uri, 5).unwrap_err().to_string();
        assert!(error.contains("6 bytes, more than the 5"), "{error}");
        let long = format!("data:;base64,{}", "A".repeat(4000));
        assert!(
            resolver.read(&long, Syntax::Uri, 1000).unwrap_err().to_string().contains("more than the 1000")
        );
        resolver.bytes_left = 8;
        resolver.read("a%20b.bin", Syntax::Uri, 1000).unwrap();
        let error = resolver.read("a%20b.bin", Syntax::Uri, 1000).unwrap_err().to_string();
        assert!(error.contains("more than the 2"), "{error}");
        resolver.read("data:;base64,aGk=", Syntax::Uri, 1000).unwrap();
        for uri in ["data:;base64,aA==", "data:;base64,aA", "data:,a", "data:,abc"] {
            let error = resolver.read(uri, Syntax::Uri, 1000).unwrap_err().to_string();
            assert!(error.contains("more than the 0"), "{error}");
        }
        resolver.read("data:,", Syntax::Uri, 1000).unwrap();
    }

    proptest::proptest! {
        #[test]
        fn no_reference_panics(reference in "[a-z%./\\\\:0-9A-F,;=\u{0}é]{0,24}") {
            let root = folder();
            let _ = read(root.path(), &reference, Syntax::Uri);
        }

        #[test]
        fn base64_turns_back(bytes: Vec<u8>) {
            const CODE: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
            let mut text = Vec::new();
            for chunk in bytes.chunks(3) {
                let mut word = [0; 4];
                word[1..=chunk.len()].copy_from_slice(chunk);
                let word = u32::from_be_bytes(word);
                text.extend((0..=chunk.len()).map(|i| CODE[(word >> (18 - 6 * i) & 63) as usize]));
            }
            proptest::prop_assert_eq!(decode_base64(&text).unwrap(), bytes);
        }
    }
}
