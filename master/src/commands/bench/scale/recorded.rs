//! A frame that was rendered once, of which devices are played: what each place of it cost, and its pixels.

use super::report::RecordingCosts;
use crate::commands::CommandError;
use crate::commands::progress::Progress;
use crate::commands::run::{Crew, LocalCrew, Session};
use std::path::Path;
use std::time::Duration;
use tessera_master::FrameJob;
use tessera_pack::Pack;
use tessera_wire::{Coding, PixelFormat, Rect, TileGrid, TileId, pixels};
use tessera_worker::Recording;

/// A recorded frame. Tiles of any multiple of its side are as long as the recorded ones in them.
pub struct Recorded {
    grid: TileGrid,
    /// By recorded tile.
    micros: Vec<u32>,
    /// Of the image, RGBA8; empty where only costs are known.
    pixels: Vec<u8>,
    /// Where there are none: bytes on the wire over bytes of pixels, by side of a tile.
    packed: Vec<(u32, f64)>,
    /// Of the image.
    pub hash: String,
}

impl Recorded {
    /// Sides of tiles that are recorded: a frame of devices can have tiles of this side or a multiple.
    pub const SIDE: u32 = 16;

    /// Renders the frame of `job` on one core of this machine.
    pub fn render(pack: &Pack, job: &FrameJob, progress: &Progress) -> Result<Self, CommandError> {
        let crew = Crew::Local(LocalCrew { threads: Some(1), ..LocalCrew::this_process() });
        let mut session = Session::open(pack, &crew, progress)?;
        let job = FrameJob { tile: Self::SIDE, ..job.clone() };
        // The first frame finds caches cold; devices that render all day do not.
        session.render(&job)?;
        let frame = session.render(&job)?;
        session.close();
        let grid = TileGrid::new(job.width, job.height, job.tile).map_err(CommandError::failed)?;
        let mut micros = vec![0; grid.tiles() as usize];
        for tile in frame.tiles.iter().filter(|tile| tile.is_first) {
            // No tile is free: a played one has a render call as well.
            micros[tile.tile.0 as usize] = u32::try_from(tile.render.as_micros()).unwrap_or(u32::MAX).max(1);
        }
        Ok(Self {
            grid,
            micros,
            hash: frame.image.hash().to_string(),
            packed: Vec::new(),
            pixels: frame.image.data().to_vec(),
        })
    }

    /// What a report has kept of one.
    pub fn from_costs([width, height]: [u32; 2], costs: &RecordingCosts) -> Result<Self, String> {
        let grid = TileGrid::new(width, height, costs.side).map_err(|e| e.to_string())?;
        if costs.side != Self::SIDE || costs.micros.len() != grid.tiles() as usize {
            let (have, need) = (costs.micros.len(), grid.tiles());
            return Err(format!(
                "costs of {have} tiles of {} pixels, {need} of {} are needed",
                costs.side,
                Self::SIDE
            ));
        }
        if costs.micros.iter().all(|us| *us == 0)
            || costs.packed.iter().any(|(_, ratio)| !(0.0..=1.0).contains(ratio))
        {
            return Err("costs or ratios that cannot be".into());
        }
        let (micros, packed) = (costs.micros.clone(), costs.packed.clone());
        Ok(Self { grid, micros, pixels: Vec::new(), packed, hash: String::new() })
    }

    /// Writes it for devices to play.
    pub fn write(&self, path: &Path) -> Result<(), CommandError> {
        let (width, height) = self.grid.size();
        let mut recording = Recording::new(width, height, self.grid.tile());
        recording.tile_us = vec![self.micros.clone()];
        recording.write(path, &[&self.pixels]).map_err(CommandError::failed)
    }

    /// What the frame took one core.
    pub fn total(&self) -> Duration {
        Duration::from_micros(self.micros.iter().map(|us| u64::from(*us)).sum())
    }

    /// Seconds of each row of recorded tiles.
    pub fn row_costs(&self) -> Vec<f64> {
        let rows = self.micros.chunks(self.grid.columns() as usize);
        rows.map(|row| row.iter().map(|us| 1e-6 * f64::from(*us)).sum()).collect()
    }

    /// What `rect`, a recorded tile or several, took one core.
    pub fn cost(&self, rect: Rect) -> Duration {
        let side = self.grid.tile();
        let rows = rect.y / side..(rect.y + rect.height).div_ceil(side);
        let columns = rect.x / side..(rect.x + rect.width).div_ceil(side);
        let row = |row| columns.clone().map(move |column| row * self.grid.columns() + column);
        Duration::from_micros(rows.flat_map(row).map(|tile| u64::from(self.micros[tile as usize])).sum())
    }

    /// The pixels of `rect`.
    pub fn pixels(&self, rect: Rect) -> Vec<u8> {
        let width = self.grid.size().0 as usize;
        let row = |y: u32| {
            let first = 4 * (y as usize * width + rect.x as usize);
            &self.pixels[first..first + 4 * rect.width as usize]
        };
        (rect.y..rect.y + rect.height).flat_map(row).copied().collect()
    }

    /// What a report keeps of it.
    pub fn costs(&self) -> RecordingCosts {
        let packed = [16, 32, 64, 128, 256].map(|side| (side, self.packed(side)));
        RecordingCosts { side: self.grid.tile(), micros: self.micros.clone(), packed: packed.into() }
    }

    /// Bytes of the frame on the wire in tiles of `side` over bytes of its pixels.
    fn packed(&self, side: u32) -> f64 {
        let (width, height) = self.grid.size();
        let Ok(grid) = TileGrid::new(width, height, side) else { return 1.0 };
        let rects = (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile)));
        rects.map(|rect| self.wire_bytes(rect) as f64).sum::<f64>() / self.pixels.len() as f64
    }

    /// Bytes of `rect` on the wire where pixels are packed.
    pub fn wire_bytes(&self, rect: Rect) -> usize {
        if self.pixels.is_empty() {
            let bytes = 4.0 * f64::from(rect.width) * f64::from(rect.height);
            let near = self.packed.iter().min_by_key(|(side, _)| side.abs_diff(rect.width));
            return (near.map_or(1.0, |(_, ratio)| *ratio) * bytes).ceil() as usize;
        }
        let pixels = self.pixels(rect);
        let packed = pixels::encode(PixelFormat::Rgba8, rect.width, &pixels, Coding::Lossless);
        packed.map_or(pixels.len(), |packed| packed.len())
    }
}
