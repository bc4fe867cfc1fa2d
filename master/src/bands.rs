//! What the tiles of a frame are put into: a whole image, or bands of one that is given away from the top.

use crate::image::{FrameBuffer, NoRoom, PixelFormat, TileError};
use std::collections::BTreeMap;
use tessera_wire::{Rect, TileGrid};

/// An image that tiles are put into, each once.
#[derive(Debug)]
pub(crate) enum Canvas {
    /// It is held until the frame ends.
    Whole(FrameBuffer),
    /// Its rows are taken as they become complete.
    Bands(Bands),
}

/// Why a tile is not put into an image.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// It does not fit its place.
    Tile(TileError),
    /// There is no memory for rows that must wait.
    NoRoom(NoRoom),
}

impl Canvas {
    /// The whole image, all zeros.
    pub(crate) fn whole(grid: &TileGrid, format: PixelFormat) -> Result<Self, NoRoom> {
        let (width, height) = grid.size();
        Ok(Self::Whole(FrameBuffer::new(width, height, format)?))
    }

    /// An image of which nothing is held yet.
    pub(crate) fn bands(grid: TileGrid, format: PixelFormat) -> Self {
        Self::Bands(Bands { grid, format, next: 0, held: BTreeMap::new() })
    }

    /// Tiles that may wait for one above them before it is worth rendering that one twice; `None` if it makes no difference: four bands,
    /// beside those that workers are at.
    pub(crate) fn may_wait(&self) -> Option<u32> {
        match self {
            Self::Whole(_) => None,
            Self::Bands(bands) => Some(4 * bands.grid.columns()),
        }
    }

    /// Forgets what was put in. A whole image is written over instead.
    pub(crate) fn restart(&mut self) {
        if let Self::Bands(bands) = self {
            (bands.next, bands.held) = (0, BTreeMap::new());
        }
    }

    /// Puts in the tile whose place is `rect`, which was not there before.
    pub(crate) fn put(&mut self, rect: Rect, pixels: &[u8]) -> Result<(), Fault> {
        match self {
            Self::Whole(image) => {
                image.put(rect.x, rect.y, rect.width, rect.height, pixels).map_err(Fault::Tile)
            }
            Self::Bands(bands) => bands.put(rect, pixels),
        }
    }

    /// The pixels at `rect`; `None` if they leave the image, or it is not held whole.
    pub(crate) fn get(&self, rect: Rect) -> Option<Vec<u8>> {
        match self {
            Self::Whole(image) => image.get(rect.x, rect.y, rect.width, rect.height),
            Self::Bands(_) => None,
        }
    }

    /// The rows that follow those taken before, if they are complete and not held until the end.
    pub(crate) fn due_rows(&mut self) -> Option<Vec<u8>> {
        match self {
            Self::Whole(_) => None,
            Self::Bands(bands) => bands.take(),
        }
    }

    /// The image, or what of it was not taken by rows: nothing, if it is complete.
    pub(crate) fn into_rest(self) -> FrameBuffer {
        match self {
            Self::Whole(image) => image,
            Self::Bands(bands) => FrameBuffer::without_rows(bands.grid.size().0, bands.format),
        }
    }
}

/// The rows of tiles of an image that have begun and are not taken. Tiles that come in order keep few of them: those that workers are at.
/// A tile that does not come keeps all below it, until another worker is given it too.
#[derive(Debug)]
pub(crate) struct Bands {
    grid: TileGrid,
    format: PixelFormat,
    /// The row of tiles that is taken next.
    next: u32,
    held: BTreeMap<u32, Band>,
}

/// A row of tiles.
#[derive(Debug)]
struct Band {
    image: FrameBuffer,
    /// Tiles that have not come.
    missing: u32,
}

impl Bands {
    fn put(&mut self, rect: Rect, pixels: &[u8]) -> Result<(), Fault> {
        let row = rect.y / self.grid.tile();
        if row < self.next {
            return Err(Fault::Tile(TileError::Twice { x: rect.x, y: rect.y }));
        }
        if !self.held.contains_key(&row) {
            let image = self.new_band(rect.height).map_err(Fault::NoRoom)?;
            self.held.insert(row, Band { image, missing: self.grid.columns() });
        }
        if let Some(band) = self.held.get_mut(&row) {
            band.image.put(rect.x, 0, rect.width, rect.height, pixels).map_err(Fault::Tile)?;
            band.missing -= 1;
        }
        Ok(())
    }

    fn new_band(&self, rows: u32) -> Result<FrameBuffer, NoRoom> {
        let (width, height) = self.grid.size();
        FrameBuffer::new(width, rows, self.format).map_err(|no_room| {
            let held: u64 = self.held.values().map(|band| band.image.data().len() as u64).sum();
            NoRoom { width, height, bytes: held + no_room.bytes }
        })
    }

    fn take(&mut self) -> Option<Vec<u8>> {
        let first = self.held.first_entry()?;
        if *first.key() != self.next || first.get().missing > 0 {
            return None;
        }
        self.next += 1;
        Some(first.remove().image.into_rows())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tessera_wire::TileId;

    /// The image that tiles are cut from.
    fn whole(width: u32, height: u32, format: PixelFormat) -> FrameBuffer {
        let bytes = width as usize * height as usize * format.bytes_per_pixel();
        let data = (0..bytes).map(|i| (i * 31 % 251) as u8).collect();
        FrameBuffer::from_rows(width, height, format, data).unwrap()
    }

    proptest! {
        #[test]
        fn rows_come_in_order_whatever_the_order_of_the_tiles(
            width in 1u32..40,
            height in 1u32..40,
            tile in prop::sample::select(vec![1u32, 3, 7, 8, 16, 64]),
            wide: bool,
            order in prop::collection::vec(any::<u32>(), 1600),
        ) {
            let format = if wide { PixelFormat::Rgba16 } else { PixelFormat::Rgba8 };
            let image = whole(width, height, format);
            let grid = TileGrid::new(width, height, tile).unwrap();
            let mut ids: Vec<_> = (0..grid.tiles()).collect();
            ids.sort_by_key(|&id| order[id as usize]);
            let mut canvas = Canvas::bands(grid, format);
            let mut rows = Vec::new();
            for (come, &id) in ids.iter().enumerate() {
                let rect = grid.rect(TileId(id)).unwrap();
                let pixels = image.get(rect.x, rect.y, rect.width, rect.height).unwrap();
                prop_assert_eq!(canvas.put(rect, &pixels), Ok(()));
                while let Some(more) = canvas.due_rows() {
                    rows.extend(more);
                }
                // Exactly the bands above the first one that lacks a tile are out.
                let lacking = ids[come + 1..].iter().map(|id| id / grid.columns()).min();
                let out = lacking.map_or(height, |row| (row * tile).min(height));
                prop_assert_eq!(rows.len(), (out * width) as usize * format.bytes_per_pixel());
            }
            prop_assert!(rows == image.data());
            prop_assert_eq!(canvas.into_rest().data().len(), 0);
        }
    }

    #[test]
    fn tiles_in_order_keep_one_band() {
        let grid = TileGrid::new(100, 1000, 10).unwrap();
        let mut canvas = Canvas::bands(grid, PixelFormat::Rgba8);
        for id in 0..grid.tiles() {
            canvas.put(grid.rect(TileId(id)).unwrap(), &[7; 400]).unwrap();
            let Canvas::Bands(bands) = &mut canvas else { panic!("it is by bands") };
            assert_eq!(bands.held.len(), 1);
            assert_eq!(bands.take().is_some(), id % 10 == 9);
        }
    }

    #[test]
    fn a_second_tile_for_rows_that_are_out_is_refused_and_a_restart_takes_it() {
        let grid = TileGrid::new(1, 2, 1).unwrap();
        let mut canvas = Canvas::bands(grid, PixelFormat::Rgba8);
        let first = grid.rect(TileId(0)).unwrap();
        canvas.put(first, &[1; 4]).unwrap();
        assert_eq!(canvas.due_rows(), Some(vec![1; 4]));
        assert!(matches!(canvas.put(first, &[2; 4]), Err(Fault::Tile(_))));
        canvas.restart();
        canvas.put(first, &[3; 4]).unwrap();
        assert_eq!(canvas.due_rows(), Some(vec![3; 4]));
    }
}
