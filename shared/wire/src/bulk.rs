//! Headers on the bulk pipes; raw bytes follow each.

use crate::{Attempt, FrameId, PackId, PackRefusal, TileId, limits};
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

/// How far a pack has come whose chunks arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackProgress {
    pack: PackId,
    length: u64,
    filled: u64,
}

impl PackProgress {
    /// Nothing of `pack`, which has `length` bytes.
    pub fn new(pack: PackId, length: u64) -> Self {
        Self { pack, length, filled: 0 }
    }

    /// Whether all bytes are in.
    pub fn is_complete(&self) -> bool {
        self.filled == self.length
    }

    /// Where in the pack the raw bytes of `chunk` go. It must be the next one of this pack, and fit.
    pub fn accept(&mut self, chunk: &PackChunk) -> Result<std::ops::Range<u64>, PackRefusal> {
        let wrong = |detail: String| Err(PackRefusal::Transfer { detail });
        let (filled, missing) = (self.filled, self.length - self.filled);
        if chunk.pack != self.pack {
            return wrong(format!("a chunk of pack {} instead of {}", chunk.pack, self.pack));
        }
        if chunk.offset != filled {
            return wrong(format!("a chunk at {} instead of {filled}", chunk.offset));
        }
        if chunk.length == 0 || chunk.length > limits::CHUNK_BYTES || u64::from(chunk.length) > missing {
            return wrong(format!("a chunk of {} bytes, {missing} are missing", chunk.length));
        }
        self.filled += u64::from(chunk.length);
        Ok(filled..self.filled)
    }
}

/// Worker to master: the pixels of `tiles` follow as each entry says, one tile after the other.
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
    /// Bytes that follow for it, 1..=[`limits::TILE_BYTES`].
    pub length: u32,
    /// What they are: with `Raw`, `length` pixel bytes.
    pub coding: TileCoding,
    /// Bytes of the tile's pixels in the frame's format, once decoded: at most [`limits::TILE_BYTES`].
    pub pixel_bytes: u32,
    /// From when it could have been begun, all before it rendered, to its beginning: time without work is not the device's. In microseconds,
    /// as all that follow, at most `u32::MAX` (71 minutes).
    pub idle_us: u32,
    /// Wall time of rendering.
    pub render_us: u32,
    /// Of coding.
    pub coding_us: u32,
    /// From the end of rendering until it was handed to the transport, coding included.
    pub waited_us: u32,
    /// Rays traced for it.
    pub rays: Rays,
}

impl TileEntry {
    /// A first attempt at tile 0, of `length` raw bytes; nothing else is known of it.
    pub fn raw(length: u32) -> Self {
        Self {
            tile: TileId(0),
            attempt: Attempt(0),
            length,
            coding: TileCoding::Raw,
            pixel_bytes: length,
            idle_us: 0,
            render_us: 0,
            coding_us: 0,
            waited_us: 0,
            rays: Rays::default(),
        }
    }
}

/// What the bytes of a tile on the wire are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub enum TileCoding {
    /// The pixels themselves.
    #[default]
    Raw,
    /// Differences of neighbours, packed; see `crate::pixels`.
    Packed,
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
        let is_out = |bytes: u32| bytes == 0 || u64::from(bytes) > limits::TILE_BYTES;
        if let Some(t) = self.tiles.iter().find(|t| is_out(t.length) || is_out(t.pixel_bytes)) {
            let (most, bytes) = (limits::TILE_BYTES, t.length.max(t.pixel_bytes));
            return Err(format!("tile {} of {bytes} bytes: must be in 1..={most}", t.tile.0));
        }
        let is_wrong = |t: &&TileEntry| match t.coding {
            TileCoding::Raw => t.length != t.pixel_bytes,
            TileCoding::Packed => t.length >= t.pixel_bytes,
        };
        match self.tiles.iter().find(is_wrong) {
            Some(TileEntry { tile, pixel_bytes, length, coding, .. }) => {
                Err(format!("{coding:?} tile {} of {pixel_bytes} bytes has {length}", tile.0))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_come_in_order_and_fit() {
        let pack = PackId([1; 32]);
        let chunk = |offset, length| PackChunk { pack, offset, length };
        let mut progress = PackProgress::new(pack, 10);
        assert_eq!(progress.accept(&chunk(0, 4)), Ok(0..4));
        let wrong = [
            chunk(0, 4),
            chunk(5, 4),
            chunk(4, 7),
            chunk(4, 0),
            chunk(4, u32::MAX),
            chunk(u64::MAX, 4),
            PackChunk { pack: PackId([2; 32]), ..chunk(4, 6) },
        ];
        for chunk in wrong {
            let refused = progress.accept(&chunk);
            assert!(matches!(refused, Err(PackRefusal::Transfer { .. })), "{refused:?}");
        }
        assert!(!progress.is_complete());
        assert_eq!(progress.accept(&chunk(4, 6)), Ok(4..10));
        assert!(progress.is_complete());
        let mut large = PackProgress::new(pack, 1 << 40);
        assert!(large.accept(&chunk(0, limits::CHUNK_BYTES + 1)).is_err());
    }
}
