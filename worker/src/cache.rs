//! Packs that outlive a worker: a folder of files named by content, bounded in bytes.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::SystemTime,
};
use tessera_pack::{Pack, PackBuffer, PackError};
use tessera_wire::PackId;

/// A folder of packs. Any number of workers may share it: files appear whole, by renaming, and never change.
///
/// Files are named `HASH.tpack`, and while they are written `HASH.PROCESS-NUMBER.part`; nothing else in the folder is ever touched. The
/// time of a file's last change is that of its last use. When a new one would make the sum larger than the limit, those used longest ago
/// are removed; a worker that has one of them mapped keeps it until it lets go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackCache {
    folder: PathBuf,
    limit: u64,
}

/// One of the cache's own files.
struct Entry {
    path: PathBuf,
    length: u64,
    used: SystemTime,
}

impl PackCache {
    /// Bytes of all packs together that a worker keeps unless it is told otherwise.
    pub const DEFAULT_LIMIT: u64 = 8 << 30;

    /// The cache in `folder`, which is made for this user alone if it is not there; files that a worker was writing when it was killed are
    /// removed.
    /// A pack larger than `limit` bytes is not kept.
    ///
    /// # Errors
    /// The folder cannot be made or read.
    pub fn open(folder: impl Into<PathBuf>, limit: u64) -> io::Result<Self> {
        let folder = folder.into();
        make_folder(&folder)?;
        let this = Self { folder, limit };
        for part in this.entries(is_part)? {
            // Whoever writes one has it locked.
            let is_left = File::open(&part.path).is_ok_and(|file| file.try_lock().is_ok());
            if is_left {
                tracing::debug!("{} was not finished and is removed", part.path.display());
                let _ = fs::remove_file(&part.path);
            }
        }
        Ok(this)
    }

    /// The pack, if it is here: checked like one that has come over the wire. A file that does not hold what its name says is removed.
    pub(crate) fn load(&self, pack: PackId) -> Option<Pack> {
        let path = self.path(pack);
        let damage = match open_file(&path).and_then(|file| read(file, &path)) {
            Ok(found) if found.id().0 == pack.0 => return Some(found),
            Ok(_) => "it holds another pack".to_string(),
            Err(ReadError::Io(e)) if e.kind() == io::ErrorKind::NotFound => return None,
            // That says nothing of what the file holds.
            Err(e @ (ReadError::Io(_) | ReadError::Pack(PackError::OutOfMemory(_)))) => {
                tracing::debug!("{} cannot be read: {e}", path.display());
                return None;
            }
            Err(ReadError::Pack(e)) => e.to_string(),
        };
        tracing::warn!("{} is removed from the cache: {damage}", path.display());
        let _ = fs::remove_file(&path);
        None
    }

    /// Keeps `pack`, unless it is here or larger than the whole cache; whether it was written.
    pub(crate) fn store(&self, pack: &Pack) -> io::Result<bool> {
        let bytes = pack.bytes();
        let id = PackId(pack.id().0);
        let path = self.path(id);
        if bytes.len() as u64 > self.limit || self.has(&path, bytes.len() as u64) {
            return Ok(false);
        }
        self.make_room(bytes.len() as u64, &path)?;
        let part = self.part_path(id);
        let written = write(&part, bytes).and_then(|()| fs::rename(&part, &path));
        if written.is_err() {
            let _ = fs::remove_file(&part);
        }
        written?;
        sync_folder(&self.folder)?;
        // Another worker may have written at the same time.
        self.make_room(0, &path)?;
        Ok(true)
    }

    /// Removes what was used longest ago until `bytes` more fit, but not `keep`.
    fn make_room(&self, bytes: u64, keep: &Path) -> io::Result<()> {
        let parts: u64 = self.entries(is_part)?.iter().map(|entry| entry.length).sum();
        let mut packs = self.entries(is_pack)?;
        packs.sort_by_key(|entry| entry.used);
        let mut sum = packs.iter().map(|entry| entry.length).sum::<u64>() + parts + bytes;
        for entry in packs.iter().filter(|entry| entry.path != keep) {
            if sum <= self.limit {
                break;
            }
            match fs::remove_file(&entry.path) {
                Ok(()) => tracing::debug!("{} made room in the cache", entry.path.display()),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(e),
            }
            sum -= entry.length;
        }
        Ok(())
    }

    /// The cache's own files whose names `is_wanted` knows: files, not links.
    fn entries(&self, is_wanted: fn(&str) -> bool) -> io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            // Another worker may remove a file between two looks.
            let Ok(metadata) = entry.metadata() else { continue };
            if metadata.is_file() && entry.file_name().to_str().is_some_and(is_wanted) {
                let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                entries.push(Entry { path: entry.path(), length: metadata.len(), used });
            }
        }
        Ok(entries)
    }

    fn has(&self, path: &Path, length: u64) -> bool {
        fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file() && metadata.len() == length)
    }

    fn path(&self, pack: PackId) -> PathBuf {
        self.folder.join(format!("{pack}.tpack"))
    }

    fn part_path(&self, pack: PackId) -> PathBuf {
        static WRITTEN: AtomicU32 = AtomicU32::new(0);
        let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
        self.folder.join(format!("{pack}.{}-{number}.part", std::process::id()))
    }
}

/// `HASH.tpack`.
fn is_pack(name: &str) -> bool {
    name.strip_suffix(".tpack").is_some_and(is_hash)
}

/// `HASH.PROCESS-NUMBER.part`.
fn is_part(name: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    name.strip_suffix(".part")
        .and_then(|name| name.split_once('.'))
        .and_then(|(hash, rest)| Some((hash, rest.split_once('-')?)))
        .is_some_and(|(hash, (process, number))| is_hash(hash) && is_number(process) && is_number(number))
}

/// A pack's id as [`PackId`] writes it.
fn is_hash(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

#[derive(Debug, thiserror::Error)]
enum ReadError {
    #[error("{0}")]
    Io(#[from] io::Error),
    #[error("{0}")]
    Pack(#[from] PackError),
}

/// Opens a file of the cache: a file, not a link to one that others may change, nor what waits for a writer.
fn open_file(path: &Path) -> Result<File, ReadError> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        // The flags of `open(2)` as the system has them.
        options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
    }
    let file = options.open(path)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a plain file").into());
    }
    Ok(file)
}

/// The pack in a file of the cache, mapped where only this user can change the file: workers of one machine then share its memory.
fn read(mut file: File, path: &Path) -> Result<Pack, ReadError> {
    let metadata = file.metadata()?;
    let pack = if is_ours_alone(&metadata) {
        // SAFETY: a map must not change. Nobody but this user may write to the file, and it is one of the cache's own: it was written under
        // another name, is complete since it has this one, and is never written or cut again; it is only ever removed, which leaves the
        // map alone.
        #[expect(
            unsafe_code,
            reason = "mapping a file is unsafe, and saves a copy for each worker of a machine"
        )]
        let map = unsafe { memmap2::Mmap::map(&file) }?;
        Pack::from_shared(Arc::new(map))?
    } else {
        let length = metadata.len();
        let buffer = usize::try_from(length).ok().and_then(PackBuffer::with_len);
        let mut buffer = buffer.ok_or(PackError::OutOfMemory(length))?;
        file.read_exact(buffer.as_mut_slice())?;
        Pack::from_buffer(buffer)?
    };
    // Where its use cannot be noted, it only seems to be older than it is.
    if let Err(e) = file.set_modified(SystemTime::now()) {
        tracing::debug!("{}: its time cannot be set: {e}", path.display());
    }
    Ok(pack)
}

/// Whether a file is this user's, and no other may write to it.
#[cfg(unix)]
fn is_ours_alone(metadata: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    /// `S_IWGRP` and `S_IWOTH`.
    const OTHERS_WRITE: u32 = 0o022;
    metadata.uid() == rustix::process::geteuid().as_raw() && metadata.mode() & OTHERS_WRITE == 0
}

#[cfg(not(unix))]
fn is_ours_alone(_: &fs::Metadata) -> bool {
    false
}

/// Makes a folder, and those around it, for this user alone.
fn make_folder(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// Writes a new file that is on the disk when this returns. It is locked meanwhile.
fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    // Whoever could write to it could change what is mapped, whatever the umask says.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o644);
    let mut file = options.open(path)?;
    // Where files cannot be locked, another worker that starts may remove it: then renaming fails, and nothing is kept.
    let _ = file.try_lock();
    file.write_all(bytes)?;
    file.sync_all()
}

/// Makes a rename last.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tessera_pack::{Material, PackInput, PackOptions, build_pack};

    /// A triangle of another height for each number: packs of one length.
    fn pack(number: u32) -> Pack {
        let input = PackInput {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, f64::from(number) + 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        };
        build_pack(input, &PackOptions::default()).unwrap().0
    }

    fn id(pack: &Pack) -> PackId {
        PackId(pack.id().0)
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Makes a pack's last use `seconds` after the epoch.
    fn used(cache: &PackCache, pack: &Pack, seconds: u64) {
        let file = File::open(cache.path(id(pack))).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)).unwrap();
    }

    #[test]
    fn what_is_stored_is_found_by_another_worker() {
        let folder = tempfile::tempdir().unwrap();
        let made = folder.path().join("deep/down");
        let (one, two) = (PackCache::open(&made, 1 << 20).unwrap(), PackCache::open(&made, 1 << 20).unwrap());
        let pack = pack(0);
        assert!(one.load(id(&pack)).is_none());
        assert!(one.store(&pack).unwrap());
        assert!(!two.store(&pack).unwrap(), "it is there");
        assert_eq!(two.load(id(&pack)).unwrap().bytes(), pack.bytes());
        assert_eq!(names(&made), [format!("{}.tpack", id(&pack))]);
    }

    #[test]
    fn damaged_files_are_removed_and_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let cache = PackCache::open(folder.path(), 1 << 20).unwrap();
        let (pack, other) = (pack(0), pack(1));
        let path = cache.path(id(&pack));
        let mut flipped = pack.bytes().to_vec();
        *flipped.last_mut().unwrap() ^= 1;
        let cut = &pack.bytes()[..pack.bytes().len() - 64];
        for damaged in [&flipped[..], cut, b"", b"hello", other.bytes()] {
            fs::write(&path, damaged).unwrap();
            assert!(cache.load(id(&pack)).is_none());
            assert!(!path.exists());
            assert!(cache.store(&pack).unwrap());
            assert_eq!(cache.load(id(&pack)).unwrap().bytes(), pack.bytes());
        }
    }

    #[test]
    fn the_least_recently_used_make_room_and_strangers_stay() {
        let folder = tempfile::tempdir().unwrap();
        let packs: Vec<_> = (0..4).map(pack).collect();
        let length = packs[0].bytes().len() as u64;
        assert!(packs.iter().all(|pack| pack.bytes().len() as u64 == length));
        // Room for three.
        let cache = PackCache::open(folder.path(), 4 * length - 1).unwrap();
        let strangers = ["a.tpack", "notes.txt", &format!("{}.tpack.bak", id(&packs[0]))];
        for name in strangers {
            fs::write(folder.path().join(name), vec![0; 10 * length as usize]).unwrap();
        }
        for (pack, seconds) in packs[..3].iter().zip([30, 10, 20]) {
            assert!(cache.store(pack).unwrap());
            used(&cache, pack, seconds);
        }
        assert!(cache.load(id(&packs[1])).is_some(), "which is a use");
        assert!(cache.store(&packs[3]).unwrap());
        let is_here = |pack: &Pack| cache.path(id(pack)).exists();
        assert_eq!(packs.iter().map(is_here).collect::<Vec<_>>(), [true, true, false, true]);
        assert!(strangers.iter().all(|name| folder.path().join(name).exists()));
        // Nothing goes for one that does not fit at all.
        let small = PackCache::open(folder.path(), length - 1).unwrap();
        assert!(!small.store(&packs[2]).unwrap());
        assert_eq!(packs.iter().map(is_here).collect::<Vec<_>>(), [true, true, false, true]);
    }

    #[cfg(unix)]
    #[test]
    fn files_that_others_may_change_are_copied_and_ours_are_mapped() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let made = folder.path().join("made");
        let cache = PackCache::open(&made, 1 << 20).unwrap();
        assert_eq!(fs::metadata(&made).unwrap().permissions().mode() & 0o777, 0o700);
        let pack = pack(0);
        cache.store(&pack).unwrap();
        let path = cache.path(id(&pack));
        // Whether a change of the file shows in what was loaded.
        let is_mapped = |mode| {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let loaded = cache.load(id(&pack)).unwrap();
            assert_eq!(loaded.bytes(), pack.bytes());
            let mut changed = pack.bytes().to_vec();
            changed[0] ^= 1;
            OpenOptions::new().write(true).open(&path).unwrap().write_all(&changed).unwrap();
            let is_mapped = loaded.bytes() == changed;
            OpenOptions::new().write(true).open(&path).unwrap().write_all(pack.bytes()).unwrap();
            is_mapped
        };
        assert_eq!([0o644, 0o600, 0o664, 0o646].map(is_mapped), [true, true, false, false]);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed_and_not_removed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = PackCache::open(folder.path().join("cache"), 1).unwrap();
        let pack = pack(0);
        let mine = folder.path().join("mine.tpack");
        fs::write(&mine, pack.bytes()).unwrap();
        std::os::unix::fs::symlink(&mine, cache.path(id(&pack))).unwrap();
        assert!(cache.load(id(&pack)).is_none());
        cache.make_room(1 << 20, Path::new("")).unwrap();
        assert!(cache.path(id(&pack)).is_symlink() && mine.exists());
    }

    #[test]
    fn a_file_that_is_being_written_is_left_alone_and_one_that_was_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let cache = PackCache::open(folder.path(), 1 << 20).unwrap();
        let (left, written) = (cache.part_path(PackId([1; 32])), cache.part_path(PackId([2; 32])));
        write(&left, b"half").unwrap();
        write(&written, b"half").unwrap();
        let writer = File::open(&written).unwrap();
        writer.lock().unwrap();
        fs::write(folder.path().join("x.1-2.part"), b"").unwrap();
        PackCache::open(folder.path(), 1 << 20).unwrap();
        assert!(!left.exists() && written.exists() && folder.path().join("x.1-2.part").exists());
    }
}
