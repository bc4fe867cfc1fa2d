//! A file of rendered frames: what each tile cost and what its pixels are, for workers that play a device.
//!
//! One line of JSON (sides, format, microseconds of every tile of every frame), then the pixels of all frames, tile after tile, so that a
//! tile is one read. Whoever reads it trusts nothing in it: sides and lengths are checked before any memory is taken for them.

use serde::{Deserialize, Serialize};
use std::{
    fs::File,
    io::{self, BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};
use tessera_wire::{PixelFormat, Rect, TileGrid, TileId, limits};

/// Bytes of the line: that many tiles in all frames, with 10 digits each.
const HEADER_BYTES_MAX: u64 = 64 << 20;

/// Frames of a recording: a minute of 60 a second.
const FRAMES_MAX: usize = 3600;

/// Bytes of one pixel: RGBA8.
const PIXEL_BYTES: u64 = PixelFormat::Rgba8.bytes_per_pixel() as u64;

/// What was recorded, without the pixels.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// Version of the file's format: 1.
    tessera_recording: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Side of a tile.
    pub tile: u32,
    /// Always `rgba8`.
    format: String,
    /// Of each frame, the microseconds that each tile took, in the order of their ids.
    pub tile_us: Vec<Vec<u32>>,
}

/// Why there is no recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It is no recording, or damaged.
    #[error("{}: no recording of frames: {reason}", path.display())]
    Invalid {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

impl Recording {
    /// Frames of these sides, of which there are none yet.
    pub fn new(width: u32, height: u32, tile: u32) -> Self {
        Self { tessera_recording: 1, width, height, tile, format: "rgba8".into(), tile_us: Vec::new() }
    }

    /// Writes a file that holds this and `frames`: of each the rows from the top, RGBA8.
    pub fn write(&self, path: &Path, frames: &[&[u8]]) -> Result<(), RecordingError> {
        let invalid = |reason| RecordingError::Invalid { path: path.into(), reason };
        let grid = self.check().map_err(invalid)?;
        let frame_bytes = self.frame_bytes();
        if frames.len() != self.tile_us.len() || frames.iter().any(|f| f.len() as u64 != frame_bytes) {
            return Err(invalid(format!(
                "pixels of {} frames, times of {}; a frame has {frame_bytes} bytes",
                frames.len(),
                self.tile_us.len()
            )));
        }
        let failed = |source| RecordingError::Io { path: path.into(), source };
        let mut file = BufWriter::new(File::create(path).map_err(failed)?);
        let header = serde_json::to_string(self).map_err(|e| invalid(e.to_string()))?;
        writeln!(file, "{header}").map_err(failed)?;
        for frame in frames {
            for rect in (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile))) {
                let row_bytes = rect.width as usize * PIXEL_BYTES as usize;
                for y in rect.y..rect.y + rect.height {
                    let first = (y as usize * self.width as usize + rect.x as usize) * PIXEL_BYTES as usize;
                    file.write_all(&frame[first..first + row_bytes]).map_err(failed)?;
                }
            }
        }
        file.flush().map_err(failed)
    }

    /// Bytes of one frame's pixels.
    fn frame_bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * PIXEL_BYTES
    }

    /// Checks every number; the tiles that a frame is cut into.
    fn check(&self) -> Result<TileGrid, String> {
        if self.tessera_recording != 1 || self.format != "rgba8" {
            return Err(format!("version {} and format {:?}", self.tessera_recording, self.format));
        }
        let grid = TileGrid::new(self.width, self.height, self.tile).map_err(|e| e.to_string())?;
        let tile_bytes = u64::from(self.tile.min(self.width)) * u64::from(self.tile.min(self.height));
        if tile_bytes * PIXEL_BYTES > limits::TILE_BYTES {
            return Err(format!("a tile of more than {} bytes", limits::TILE_BYTES));
        }
        if self.tile_us.is_empty() || self.tile_us.len() > FRAMES_MAX {
            return Err(format!("{} frames; 1 to {FRAMES_MAX} can be", self.tile_us.len()));
        }
        match self.tile_us.iter().position(|times| times.len() != grid.tiles() as usize) {
            Some(frame) => Err(format!(
                "frame {frame} has times of {} tiles; it is cut into {}",
                self.tile_us[frame].len(),
                grid.tiles()
            )),
            None => Ok(grid),
        }
    }
}

/// An open file of a recording. Pixels are read when they are asked for: of sixteen workers none holds the frames in memory.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    recording: Recording,
    grid: TileGrid,
    file: Mutex<File>,
    /// Where each tile of a frame begins, and where the frame ends.
    offsets: Vec<u64>,
    /// Where the first frame begins.
    first: u64,
}

impl RecordingFile {
    /// Its tiles.
    pub(crate) fn grid(&self) -> TileGrid {
        self.grid
    }

    /// Opens the file and checks all of it but the pixels' values.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::Io { path: path.into(), source };
        let invalid = |reason| RecordingError::Invalid { path: path.into(), reason };
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        let mut line = Vec::new();
        let mut reader = BufReader::new(&file).take(HEADER_BYTES_MAX);
        reader.read_until(b'\n', &mut line).map_err(failed)?;
        if line.pop() != Some(b'\n') {
            return Err(invalid("it has no first line, or one that is too long".into()));
        }
        let first = line.len() as u64 + 1;
        let recording: Recording = serde_json::from_slice(&line).map_err(|e| invalid(e.to_string()))?;
        let grid = recording.check().map_err(invalid)?;
        let expected = first + recording.frame_bytes() * recording.tile_us.len() as u64;
        if length != expected {
            return Err(invalid(format!("it has {length} bytes and should have {expected}")));
        }
        let mut offsets = vec![0];
        for rect in (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile))) {
            let begin = offsets.last().copied().unwrap_or(0);
            offsets.push(begin + bytes_of(rect) as u64);
        }
        Ok(Self { path: path.into(), recording, grid, file: Mutex::new(file), offsets, first })
    }

    /// What was recorded.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The pixels of a tile of entry `frame mod frames`; nothing for a tile that is none.
    pub fn tile(&self, frame: usize, tile: TileId) -> io::Result<Vec<u8>> {
        let Some(rect) = self.grid.rect(tile) else { return Ok(Vec::new()) };
        let frame = (frame % self.recording.tile_us.len()) as u64;
        let offset = self.first + frame * self.recording.frame_bytes() + self.offsets[tile.0 as usize];
        let mut pixels = vec![0; bytes_of(rect)];
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(&mut pixels)?;
        Ok(pixels)
    }

    /// The rows of entry `frame mod frames`, from the top.
    pub fn image(&self, frame: usize) -> io::Result<Vec<u8>> {
        let mut rows = vec![0; self.recording.frame_bytes() as usize];
        for tile in (0..self.grid.tiles()).map(TileId) {
            let (Some(rect), pixels) = (self.grid.rect(tile), self.tile(frame, tile)?) else { continue };
            let row_bytes = rect.width as usize * PIXEL_BYTES as usize;
            for (y, row) in (rect.y..).zip(pixels.chunks(row_bytes)) {
                let first =
                    (y as usize * self.recording.width as usize + rect.x as usize) * PIXEL_BYTES as usize;
                rows[first..first + row_bytes].copy_from_slice(row);
            }
        }
        Ok(rows)
    }
}

/// Bytes of a tile's pixels.
fn bytes_of(rect: Rect) -> usize {
    rect.width as usize * rect.height as usize * PIXEL_BYTES as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two frames of 5 x 3 pixels in tiles of 2, and their rows.
    fn sample() -> (Recording, [Vec<u8>; 2]) {
        let mut recording = Recording::new(5, 3, 2);
        recording.tile_us = vec![vec![1, 2, 3, 4, 5, 6], vec![7, 8, 9, 10, 11, 12]];
        (recording, [0, 100].map(|from| (from..from + 60).collect()))
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r");
        let (recording, frames) = sample();
        recording.write(&path, &[&frames[0], &frames[1]]).unwrap();
        let file = RecordingFile::open(&path).unwrap();
        assert_eq!(file.recording(), &recording);
        for (entry, rows) in [(0, &frames[0]), (1, &frames[1]), (2, &frames[0])] {
            assert_eq!(&file.image(entry).unwrap(), rows);
        }
        // The corner that is cut: one pixel.
        assert_eq!(file.tile(1, TileId(5)).unwrap(), frames[1][56..]);
    }

    #[test]
    fn what_is_damaged_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r");
        let (recording, frames) = sample();
        let pixels = [&frames[0][..], &frames[1]];
        recording.write(&path, &pixels).unwrap();
        let good = std::fs::read(&path).unwrap();
        let end = good.iter().position(|&b| b == b'\n').unwrap();
        let text = String::from_utf8(good[..end].to_vec()).unwrap();
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            RecordingFile::open(&path).unwrap_err().to_string()
        };
        for (from, to) in [
            ("\"width\":5", "\"width\":6"),
            ("\"width\":5", "\"width\":4000000000"),
            ("\"tile\":2", "\"tile\":0"),
            ("rgba8", "rgba9"),
            ("[1,2,", "[1,"),
            ("\"tile_us\":[", "\"tile_us\":[["),
            ("\"tessera_recording\":1", "\"tessera_recording\":2"),
            ("\"tile\":2", "\"tile\":2,\"more\":1"),
        ] {
            assert!(text.contains(from));
            let bytes = [text.replacen(from, to, 1).as_bytes(), &good[end..]].concat();
            let reason = refused(&bytes);
            assert!(reason.contains("no recording of frames"), "{to}: {reason}");
        }
        assert!(refused(&good[..good.len() - 1]).contains("should have"));
        assert!(refused(b"").contains("first line"));
        assert!(recording.write(&path, &pixels[..1]).is_err(), "one frame is missing");
        assert!(Recording::new(5, 3, 2).write(&path, &[]).is_err(), "there is no frame");
    }
}
