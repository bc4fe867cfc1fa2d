//! What a tile id means.

use crate::{FrameError, TileId, limits};

/// An image cut into square tiles, counted row by row from the upper left corner; tiles at the right and
/// lower edge are cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    width: u32,
    height: u32,
    tile: u32,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns, >= 1.
    pub width: u32,
    /// Rows, >= 1.
    pub height: u32,
}

impl TileGrid {
    /// A grid over `width` x `height` pixels; both sides, the area and the number of tiles are checked
    /// against their limits.
    pub fn new(width: u32, height: u32, tile: u32) -> Result<Self, FrameError> {
        let sides = 1..=limits::SIDE;
        let area = u64::from(width) * u64::from(height);
        if !(sides.contains(&width) && sides.contains(&height) && area <= limits::PIXELS) {
            return Err(FrameError::Size { width, height });
        }
        if tile == 0 {
            return Err(FrameError::Tile);
        }
        let grid = Self { width, height, tile };
        let tiles = u64::from(grid.columns()) * u64::from(grid.rows());
        if tiles > u64::from(limits::TILES) {
            return Err(FrameError::Tiles { tiles });
        }
        Ok(grid)
    }

    /// Columns and rows of the image.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Side of a tile that is not cut.
    pub fn tile(&self) -> u32 {
        self.tile
    }

    /// Tiles in a row.
    pub fn columns(&self) -> u32 {
        self.width.div_ceil(self.tile)
    }

    /// Rows of tiles.
    pub fn rows(&self) -> u32 {
        self.height.div_ceil(self.tile)
    }

    /// All tiles; valid ids are below it.
    pub fn tiles(&self) -> u32 {
        self.columns() * self.rows()
    }

    /// The pixels of `tile`, or `None` if there is no such tile.
    pub fn rect(&self, tile: TileId) -> Option<Rect> {
        if tile.0 >= self.tiles() {
            return None;
        }
        // No overflow: both products are below the image's sides.
        let x = tile.0 % self.columns() * self.tile;
        let y = tile.0 / self.columns() * self.tile;
        Some(Rect { x, y, width: self.tile.min(self.width - x), height: self.tile.min(self.height - y) })
    }

    /// Pixels of the largest tile.
    pub fn largest_tile_pixels(&self) -> u64 {
        u64::from(self.tile.min(self.width)) * u64::from(self.tile.min(self.height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_every_pixel_once() {
        let sizes =
            [(1, 1, 1), (1, 1, 128), (1, 70, 32), (70, 1, 32), (100, 60, 32), (64, 64, 32), (65, 63, 64)];
        for (width, height, tile) in sizes {
            let grid = TileGrid::new(width, height, tile).unwrap();
            let mut seen = vec![0; (width * height) as usize];
            for id in 0..grid.tiles() {
                let r = grid.rect(TileId(id)).unwrap();
                assert!(u64::from(r.width) * u64::from(r.height) <= grid.largest_tile_pixels());
                for y in r.y..r.y + r.height {
                    for x in r.x..r.x + r.width {
                        seen[(y * width + x) as usize] += 1;
                    }
                }
            }
            assert!(seen.iter().all(|&n| n == 1), "{width} x {height} in {tile}");
            assert_eq!(grid.rect(TileId(grid.tiles())), None);
            assert_eq!(grid.rect(TileId(u32::MAX)), None);
        }
    }

    #[test]
    fn the_extremes_do_not_overflow() {
        let grid = TileGrid::new(limits::SIDE, 4096, u32::MAX).unwrap();
        assert_eq!(grid.rect(TileId(0)), Some(Rect { x: 0, y: 0, width: limits::SIDE, height: 4096 }));
        let grid = TileGrid::new(20_000, 1, 1).unwrap();
        assert_eq!(grid.rect(TileId(19_999)), Some(Rect { x: 19_999, y: 0, width: 1, height: 1 }));
    }
}
