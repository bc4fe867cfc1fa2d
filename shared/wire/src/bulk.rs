//! Headers on the bulk pipes; raw bytes follow each.

use crate::{Attempt, FrameId, PackId, TileId, limits};
use bincode::{Decode, Encode};

/// Master to worker: `length` raw bytes of a pack follow. Chunks come in order, without gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct PackChunk {
    /// Which pack.
    pub pack: PackId,
    /// Bytes of the pack before this chunk.
    pub offset: u64,
    /// Raw bytes that follow, 1..=[`limits::CHUNK_BYTES`].
    pub length: u32,
}

/// Worker to master: the raw pixels of `tiles` follow, one tile after the other.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct BatchHeader {
    /// Of which frame.
    pub frame: FrameId,
    /// Its tiles, 1..=[`limits::TILES`].
    pub tiles: Vec<TileEntry>,
}

/// A rendered tile in a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct TileEntry {
    /// Which tile.
    pub tile: TileId,
    /// As it was assigned.
    pub attempt: Attempt,
    /// Raw bytes, exactly the tile's pixels in the frame's format, at most [`limits::TILE_BYTES`].
    pub length: u32,
    /// Wall time of rendering, in microseconds, at most `u32::MAX` (71 minutes).
    pub render_us: u32,
    /// Rays traced for it.
    pub rays: Rays,
}

// `limits::HEADER_BYTES` counts on this.
const _: () = assert!(size_of::<TileEntry>() * limits::TILES as usize <= limits::HEADER_BYTES - 64);

/// Rays traced, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub struct Rays {
    /// From the eye.
    pub primary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Off mirrors.
    pub reflection: u64,
    /// Through glass, and straight on through partly covered surfaces.
    pub refraction: u64,
}

impl std::ops::AddAssign for Rays {
    /// Saturates: the numbers come from a peer.
    fn add_assign(&mut self, o: Self) {
        self.primary = self.primary.saturating_add(o.primary);
        self.shadow = self.shadow.saturating_add(o.shadow);
        self.reflection = self.reflection.saturating_add(o.reflection);
        self.refraction = self.refraction.saturating_add(o.refraction);
    }
}

impl BatchHeader {
    /// Checks the list's length and each tile's; the receiver then reads tile by tile and never reserves for
    /// the whole batch.
    pub fn check(&self) -> Result<(), String> {
        if self.tiles.is_empty() || self.tiles.len() > limits::TILES as usize {
            return Err(format!("a batch of {} tiles: must be in 1..={}", self.tiles.len(), limits::TILES));
        }
        match self.tiles.iter().find(|t| t.length == 0 || u64::from(t.length) > limits::TILE_BYTES) {
            Some(t) => {
                let most = limits::TILE_BYTES;
                Err(format!("tile {} of {} bytes: must be in 1..={most}", t.tile.0, t.length))
            }
            None => Ok(()),
        }
    }
}
