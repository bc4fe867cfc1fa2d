//! Owned bytes with the alignment that every section needs.

use bytemuck::{Pod, Zeroable};

/// Alignment of the buffer and of every section in it: one cache line, enough for every record type.
pub const ALIGNMENT: usize = 64;

#[repr(C, align(64))]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Block([u8; ALIGNMENT]);

const _: () = assert!(size_of::<Block>() == ALIGNMENT && align_of::<Block>() == ALIGNMENT);

/// Bytes aligned to [`ALIGNMENT`]: filled in place (for example by the chunks that a worker receives), then given to
/// [`crate::Pack::from_buffer`] without a copy.
#[derive(Clone)]
pub struct PackBuffer {
    blocks: Vec<Block>,
    len: usize,
}

impl PackBuffer {
    /// `len` zero bytes; `None` when the memory cannot be had. The caller bounds `len` first: it often comes from outside.
    pub fn with_len(len: usize) -> Option<Self> {
        let count = len.div_ceil(ALIGNMENT);
        let mut blocks = Vec::new();
        blocks.try_reserve_exact(count).ok()?;
        blocks.resize(count, Block::zeroed());
        Some(Self { blocks, len })
    }

    /// A copy of `bytes`; `None` when the memory cannot be had.
    pub fn copy_of(bytes: &[u8]) -> Option<Self> {
        let mut buffer = Self::with_len(bytes.len())?;
        buffer.as_mut_slice().copy_from_slice(bytes);
        Some(buffer)
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.blocks)[..self.len]
    }

    /// The bytes, to be filled.
    pub fn as_mut_slice(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.blocks)[..self.len]
    }
}

impl std::fmt::Debug for PackBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PackBuffer").field("len", &self.len).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aligned_for_every_length_and_refusing_the_impossible() {
        for len in [0, 1, 63, 64, 65, 1000] {
            let bytes: Vec<u8> = (0..len).map(|i| i as u8).collect();
            let buffer = PackBuffer::copy_of(&bytes).expect("small");
            assert_eq!(buffer.as_slice(), bytes);
            assert_eq!(buffer.as_slice().as_ptr() as usize % ALIGNMENT, 0);
        }
        assert!(PackBuffer::with_len(usize::MAX / 2).is_none());
    }
}
