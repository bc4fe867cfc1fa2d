//! A device that is played: its tiles take the time that they took when they were recorded, and have the pixels that they had.
//!
//! It sleeps, so that sixteen of them cost two cores next to nothing, and everything around it (session, batches, transport) is real.

use super::pace::wait_until;
use crate::recording::{RecordingError, RecordingFile};
use crate::session::RenderTask;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use tessera_wire::{Frame, PixelFormat, Rect, TileId};

/// What `Hello` calls this backend, and its numeric class: nothing that computes is of it.
pub(crate) const NAME: &str = "replay";

/// Which device is played.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayConfig {
    /// The recording's file.
    pub file: PathBuf,
    /// Multiplies all recorded times, for all devices alike; more than 0.
    pub scale: f64,
    /// How fast this device is beside the recorded one; more than 0.
    pub speed: f64,
    /// What a tile costs besides, whatever is in it: a stated cost of handing it to the device.
    pub launch: Duration,
}

/// A played device.
#[derive(Debug)]
pub(crate) struct Replay {
    file: RecordingFile,
    config: ReplayConfig,
}

/// How a tile went.
pub(crate) enum Played {
    /// It took its time; the pixels.
    Done(Vec<u8>),
    /// It was stopped meanwhile.
    Stopped,
}

impl Replay {
    pub(crate) fn open(config: &ReplayConfig) -> Result<Self, RecordingError> {
        Ok(Self { file: RecordingFile::open(&config.file)?, config: config.clone() })
    }

    /// One line: what is played.
    pub(crate) fn note(&self) -> String {
        let ReplayConfig { speed, scale, launch, .. } = self.config;
        let name = self.file.path().file_name().unwrap_or_default().to_string_lossy();
        format!(
            "playing a device from {name}: speed {speed}, times x {scale}, {} us a tile besides",
            launch.as_micros()
        )
    }

    /// Takes as long as `task` took; an error if it was not recorded, or cannot be read.
    pub(crate) fn play(&self, task: &RenderTask, stop: &AtomicBool) -> Result<Played, String> {
        let begun = Instant::now();
        self.check(&task.frame)?;
        let entry = entry(&task.frame);
        let time = self.time(entry, task.rect).ok_or("a tile that was not recorded")?;
        let pixels =
            self.pixels(entry, task.rect).map_err(|e| format!("{}: {e}", self.file.path().display()))?;
        Ok(if wait_until(begun + time, stop) { Played::Done(pixels) } else { Played::Stopped })
    }

    /// Whether the recording is of such frames: tiles may be made of several recorded ones.
    fn check(&self, frame: &Frame) -> Result<(), String> {
        let recording = self.file.recording();
        let recorded = (recording.width, recording.height, PixelFormat::Rgba8);
        if (frame.width, frame.height, frame.format) == recorded && frame.tile.is_multiple_of(recording.tile)
        {
            return Ok(());
        }
        Err(format!(
            "the recording is of {}x{} pixels of RGBA8 in tiles of {} or a multiple, and a frame of {}x{} of {:?} in tiles of {} is asked for",
            recording.width,
            recording.height,
            recording.tile,
            frame.width,
            frame.height,
            frame.format,
            frame.tile
        ))
    }

    /// What the tile at `rect` takes: as long as the recorded ones in it, and one launch.
    fn time(&self, entry: usize, rect: Rect) -> Option<Duration> {
        let frames = &self.file.recording().tile_us;
        let times = &frames[entry % frames.len()];
        let times: Option<Vec<_>> = self.recorded(rect).map(|tile| times.get(tile.0 as usize)).collect();
        let recorded: f64 = times?.into_iter().map(|us| f64::from(*us)).sum();
        let seconds = recorded * 1e-6 * self.config.scale / self.config.speed;
        Some(Duration::try_from_secs_f64(seconds).ok()? + self.config.launch)
    }

    /// The pixels of `rect`, put together from the recorded tiles in it.
    fn pixels(&self, entry: usize, rect: Rect) -> io::Result<Vec<u8>> {
        const BYTES: usize = PixelFormat::Rgba8.bytes_per_pixel();
        let grid = self.file.grid();
        let mut pixels = vec![0; rect.width as usize * rect.height as usize * BYTES];
        for tile in self.recorded(rect) {
            let Some(part) = grid.rect(tile) else { continue };
            let row_bytes = part.width as usize * BYTES;
            for (row, bytes) in self.file.tile(entry, tile)?.chunks(row_bytes).enumerate() {
                let (x, y) = ((part.x - rect.x) as usize, (part.y - rect.y) as usize + row);
                let first = (y * rect.width as usize + x) * BYTES;
                pixels[first..first + row_bytes].copy_from_slice(bytes);
            }
        }
        Ok(pixels)
    }

    /// The recorded tiles that `rect`, which is one or several of them, is made of.
    fn recorded(&self, rect: Rect) -> impl Iterator<Item = TileId> {
        let (grid, side) = (self.file.grid(), self.file.recording().tile);
        let rows = rect.y / side..(rect.y + rect.height).div_ceil(side);
        let columns = rect.x / side..(rect.x + rect.width).div_ceil(side);
        rows.flat_map(move |row| columns.clone().map(move |column| TileId(row * grid.columns() + column)))
    }
}

/// Which recorded frame is played: a session's frames count from 1, and go round.
fn entry(frame: &Frame) -> usize {
    usize::try_from(frame.frame.0.saturating_sub(1)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::calibrate;
    use crate::recording::Recording;
    use std::sync::atomic::Ordering;

    /// A device that takes `us` a tile: two frames of one tile of 8 x 8 pixels.
    fn device(us: u32, scale: f64, speed: f64, launch: Duration) -> (tempfile::TempDir, Replay) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("r");
        let mut recording = Recording::new(8, 8, 8);
        recording.tile_us = vec![vec![us], vec![us * 2]];
        recording.write(&file, &[&[1; 256], &[2; 256]]).unwrap();
        let replay = Replay::open(&ReplayConfig { file, scale, speed, launch }).unwrap();
        (folder, replay)
    }

    fn task(frame: u64) -> RenderTask {
        let [origin, forward, right, up] = [[0.0; 3]; 4];
        let camera = tessera_wire::Camera { origin, forward, right, up };
        let mut task = calibrate::task_of(tessera_wire::PackId([0; 32]), camera, 8);
        task.frame.frame = tessera_wire::FrameId(frame);
        task
    }

    #[test]
    fn a_tile_takes_what_it_took_by_the_devices_speed_and_its_launch() {
        let (_folder, replay) = device(3000, 2.0, 0.5, Duration::from_micros(500));
        let expected = [12_500, 24_500, 12_500].map(Duration::from_micros);
        for (number, expected) in (1..).zip(expected) {
            assert_eq!(replay.time(entry(&task(number).frame), task(number).rect), Some(expected));
        }
        // It waits at least that long, and has the frame's own pixels.
        let begun = Instant::now();
        let Ok(Played::Done(pixels)) = replay.play(&task(2), &AtomicBool::new(false)) else {
            panic!("it is not stopped")
        };
        assert!(begun.elapsed() >= expected[1]);
        assert_eq!(pixels, [2; 256]);
    }

    #[test]
    fn tiles_of_several_recorded_ones_take_their_times_and_have_their_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("r");
        let mut recording = Recording::new(20, 12, 4);
        recording.tile_us = vec![(1..=15).collect()];
        let picture: Vec<u8> = (0..20 * 12u32).flat_map(|i| i.to_le_bytes()).collect();
        recording.write(&file, &[&picture]).unwrap();
        let device = ReplayConfig { file, scale: 1.0, speed: 1.0, launch: Duration::ZERO };
        let replay = Replay::open(&device).unwrap();
        let grid = tessera_wire::TileGrid::new(20, 12, 8).unwrap();
        let mut sum = Duration::ZERO;
        for rect in (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile))) {
            sum += replay.time(0, rect).unwrap();
            let rows = rect.y..rect.y + rect.height;
            let cut = rows
                .flat_map(|y| (rect.x..rect.x + rect.width).flat_map(move |x| (y * 20 + x).to_le_bytes()));
            assert_eq!(replay.pixels(0, rect).unwrap(), cut.collect::<Vec<_>>(), "{rect:?}");
        }
        assert_eq!(sum, Duration::from_micros((1..=15).sum()));
    }

    #[test]
    fn a_device_that_is_stopped_does_not_take_its_time() {
        let (_folder, replay) = device(u32::MAX / 2, 1.0, 0.001, Duration::ZERO);
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let player = scope.spawn(|| replay.play(&task(1), &stop).map(|p| matches!(p, Played::Stopped)));
            stop.store(true, Ordering::Relaxed);
            player.thread().unpark();
            assert_eq!(player.join().unwrap(), Ok(true));
        });
    }

    #[test]
    fn another_frame_than_the_recorded_one_is_an_error() {
        let (_folder, replay) = device(1, 1.0, 1.0, Duration::ZERO);
        let stop = AtomicBool::new(false);
        let changes: [fn(&mut Frame); 4] =
            [|f| f.width = 9, |f| f.height = 7, |f| f.tile = 4, |f| f.format = PixelFormat::Rgba16];
        for change in changes {
            let mut task = task(1);
            change(&mut task.frame);
            let reason = replay.play(&task, &stop).err().expect("it is not that frame");
            assert!(reason.contains("the recording is of 8x8 pixels"), "{reason}");
        }
    }
}
