//! Files that are written whole or not at all.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tempfile::NamedTempFile;

/// Why a file cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The path cannot name a file that we write.
    #[error("cannot write {path}: {what}", path = path.display())]
    Target {
        /// The path.
        path: PathBuf,
        /// What is wrong with it and what to do.
        what: String,
    },
    /// The system refused.
    #[error("cannot write {path}: {source}", path = path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

/// A file to be written later, its folder checked now.
///
/// Nothing exists under the final name before [`OutputFile::write`] has succeeded: the content goes to a temporary name in the
/// same folder, which is renamed at the end and removed on every failure.
#[derive(Clone, Debug)]
pub struct OutputFile {
    path: PathBuf,
    is_secret: bool,
}

impl OutputFile {
    /// Checks that `path` can be written: its folder exists and takes new files, and nothing but a plain file lies at `path`.
    /// Meant to be called before work of minutes begins.
    pub fn check(path: &Path) -> Result<Self, OutputError> {
        let refuse = |what: &str| OutputError::Target { path: path.to_owned(), what: what.into() };
        if path.file_name().is_none() {
            return Err(refuse("it does not name a file; give a file name"));
        }
        // A link is followed, so that the file it stands for is replaced and not the link.
        let target = match fs::metadata(path) {
            Ok(found) if found.is_dir() => return Err(refuse("it is a folder; give a file name inside it")),
            Ok(found) if !found.is_file() => return Err(refuse("it is not a plain file")),
            Ok(_) => {
                fs::canonicalize(path).map_err(|source| OutputError::Io { path: path.to_owned(), source })?
            }
            // Only found out when the work is done otherwise: the temporary name is shorter.
            Err(source) if source.kind() == io::ErrorKind::InvalidFilename => {
                return Err(OutputError::Io { path: path.to_owned(), source });
            }
            Err(_) => path.to_owned(),
        };
        let folder = folder_of(&target);
        if !folder.is_dir() {
            let what = if folder.exists() {
                "is not a folder; name another"
            } else {
                "does not exist; create it first"
            };
            return Err(refuse(&format!("the folder {} {what}", folder.display())));
        }
        let output = Self { path: target, is_secret: false };
        drop(output.temporary()?);
        Ok(output)
    }

    /// The same, to be readable by its owner alone (on Unix).
    pub fn secret(self) -> Self {
        Self { is_secret: true, ..self }
    }

    /// Where the file will lie.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether `other` names the same file: the same name in the same folder, both with links followed as far as they exist.
    pub fn is_at(&self, other: &Path) -> bool {
        let place = |path: &Path| {
            fs::canonicalize(path)
                .ok()
                .or_else(|| Some(fs::canonicalize(folder_of(path)).ok()?.join(path.file_name()?)))
        };
        place(&self.path).is_some_and(|own| place(other) == Some(own))
    }

    /// Writes the file with `fill` and puts it in place.
    pub fn write<E>(
        &self,
        fill: impl FnOnce(&mut BufWriter<&mut fs::File>) -> Result<(), E>,
    ) -> Result<(), OutputError>
    where
        E: std::fmt::Display,
    {
        let mut temporary = self.temporary()?;
        let io = |source| OutputError::Io { path: self.path.clone(), source };
        let mut writer = BufWriter::new(temporary.file.as_file_mut());
        fill(&mut writer)
            .map_err(|e| OutputError::Target { path: self.path.clone(), what: one_line(&e.to_string()) })?;
        writer.flush().map_err(io)?;
        drop(writer);
        temporary.persist(&self.path).map_err(io)
    }

    /// Writes `bytes` as the whole file.
    pub fn write_bytes(&self, bytes: &[u8]) -> Result<(), OutputError> {
        self.write(|w| w.write_all(bytes))
    }

    fn temporary(&self) -> Result<Temporary, OutputError> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".tessera-").suffix(".part");
        #[cfg(unix)]
        {
            // As any new file: what the umask leaves of read and write for all (the crate's own default is the owner alone).
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(if self.is_secret { 0o600 } else { 0o666 }));
        }
        let mut unfinished = unfinished();
        let file = builder
            .tempfile_in(folder_of(&self.path))
            .map_err(|source| OutputError::Io { path: self.path.clone(), source: plain(source) })?;
        let path = file.path().to_owned();
        unfinished.insert(path.clone());
        Ok(Temporary { file, listed: Listed(path) })
    }
}

/// Removes every file that is being written, and lets none be begun or finished while the result lives: for a process that is about
/// to exit while its other threads still work.
pub fn abandon_all() -> Abandoned {
    let unfinished = unfinished();
    for path in &*unfinished {
        // Nobody is left to be told; the file may be gone already.
        let _ = fs::remove_file(path);
    }
    Abandoned { _unfinished: unfinished }
}

/// See [`abandon_all`].
#[must_use = "files may be begun again once it is dropped"]
pub struct Abandoned {
    _unfinished: MutexGuard<'static, BTreeSet<PathBuf>>,
}

/// The temporary files that exist.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that is removed when it is dropped.
struct Temporary {
    file: NamedTempFile,
    listed: Listed,
}

impl Temporary {
    fn persist(self, path: &Path) -> io::Result<()> {
        let Self { file, listed } = self;
        let abandoning = unfinished();
        let done = file.persist(path).map(drop).map_err(|e| e.error);
        drop(abandoning);
        drop(listed);
        done
    }
}

/// An entry of [`UNFINISHED`].
struct Listed(PathBuf);

impl Drop for Listed {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// The folder of a file name; a bare name lies in the current one.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The system's reason without the temporary name that the `tempfile` crate wraps around it.
fn plain(error: io::Error) -> io::Error {
    let inner = error.get_ref().and_then(|wrapper| wrapper.source()?.downcast_ref::<io::Error>());
    match inner.unwrap_or(&error).raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        None => io::Error::from(error.kind()),
    }
}

/// Text on one line and without what a terminal would obey, so that an error is one line whatever it is made of.
pub fn one_line(text: &str) -> String {
    let words = text.split(|c: char| c.is_whitespace() || c.is_control()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn one_line_is_one_line_that_no_terminal_obeys() {
        assert_eq!(one_line(" a\n\tb\x1b]0;title\x07 c\u{9b}2J\u{2028}d\n"), "a b ]0;title c 2J d");
    }

    #[test]
    fn a_file_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let out = OutputFile::check(&folder.path().join("a.bin")).unwrap();
        assert!(names(folder.path()).is_empty(), "checking must leave nothing behind");
        out.write_bytes(b"first").unwrap();
        out.write_bytes(b"second").unwrap();
        assert_eq!(fs::read(folder.path().join("a.bin")).unwrap(), b"second");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn a_failed_write_keeps_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let out = OutputFile::check(&folder.path().join("a.bin")).unwrap();
        out.write_bytes(b"old").unwrap();
        let failed = out.write(|w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk\nfull"))
        });
        assert_eq!(failed.unwrap_err().to_string().lines().count(), 1);
        assert_eq!(fs::read(folder.path().join("a.bin")).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn bad_targets_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let check = |path: &Path, says: &str| {
            let error = OutputFile::check(path).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        };
        check(&folder.path().join("none/a.png"), "does not exist; create it first");
        fs::write(folder.path().join("file"), b"").unwrap();
        check(&folder.path().join("file/a.png"), "file is not a folder; name another");
        let long = "x".repeat(300);
        check(&folder.path().join(&long), "(os error ");
        check(folder.path(), "is a folder");
        check(Path::new("/"), "does not name a file");
        #[cfg(unix)]
        check(Path::new("/dev/null"), "not a plain file");
    }

    #[test]
    fn one_place_has_many_names() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("b")).unwrap();
        let out = OutputFile::check(&folder.path().join("a.png")).unwrap();
        for exists in [false, true] {
            assert!(out.is_at(&folder.path().join("b/../a.png")), "{exists}");
            assert!(!out.is_at(&folder.path().join("b/a.png")), "{exists}");
            assert!(!out.is_at(&folder.path().join("none/a.png")), "{exists}");
            out.write_bytes(b"now it does").unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_secret_is_its_owner_s_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        // One that everybody could read lay there before.
        fs::write(&path, b"old").unwrap();
        OutputFile::check(&path).unwrap().secret().write_bytes(b"new").unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, b"old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        OutputFile::check(&link).unwrap().write_bytes(b"new").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }
}
