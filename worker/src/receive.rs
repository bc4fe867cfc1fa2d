//! A pack as it arrives in chunks.

use crate::pipes::{PipeError, Reader, read_message};
use tessera_pack::{Pack, PackBuffer, PackError};
use tessera_wire::{PackChunk, PackId, PackProgress, PackRefusal, plain_text};
use tokio::io::AsyncReadExt;

/// Bytes of one pack, filled from the front.
pub(crate) struct Assembly {
    pack: PackId,
    buffer: PackBuffer,
    progress: PackProgress,
}

impl Assembly {
    /// Room for `length` bytes, reserved at once; the session has checked `length` against the worker's
    /// memory.
    pub(crate) fn new(pack: PackId, length: u64) -> Result<Self, PackRefusal> {
        let out_of_memory = PackRefusal::OutOfMemory { needs: length, has: 0 };
        let buffer = usize::try_from(length).ok().and_then(PackBuffer::with_len).ok_or(out_of_memory)?;
        Ok(Self { pack, buffer, progress: PackProgress::new(pack, length) })
    }

    /// Whether all bytes are in.
    pub(crate) fn is_complete(&self) -> bool {
        self.progress.is_complete()
    }

    /// Where the raw bytes of `chunk` go. It must be the next one of this pack, and fit.
    pub(crate) fn accept(&mut self, chunk: &PackChunk) -> Result<&mut [u8], PackRefusal> {
        let range = self.progress.accept(chunk)?;
        // Within the length of the buffer, which is a `usize`.
        Ok(&mut self.buffer.as_mut_slice()[range.start as usize..range.end as usize])
    }

    /// The pack, checked: its stored hash against the content, and its id against what was offered. Takes
    /// seconds for a large one.
    pub(crate) fn finish(self) -> Result<Pack, PackRefusal> {
        let pack = Pack::from_buffer(self.buffer).map_err(|e| match e {
            PackError::OutOfMemory(needs) => PackRefusal::OutOfMemory { needs, has: 0 },
            other => PackRefusal::Invalid { detail: plain_text(&other.to_string()) },
        })?;
        let got = PackId(pack.id().0);
        if got != self.pack {
            return Err(PackRefusal::HashMismatch { got });
        }
        Ok(pack)
    }
}

/// Reads the chunks of a pack from `pipe`, and checks it. The outer error ends the connection, the inner one
/// only refuses the pack.
pub(crate) async fn receive(
    pipe: &mut Reader,
    mut assembly: Assembly,
) -> Result<Result<Pack, PackRefusal>, PipeError> {
    while !assembly.is_complete() {
        let Some(chunk) = read_message::<PackChunk>(pipe).await? else {
            return Err(std::io::Error::from(std::io::ErrorKind::UnexpectedEof).into());
        };
        match assembly.accept(&chunk) {
            Ok(room) => pipe.read_exact(room).await?,
            Err(refusal) => return Ok(Err(refusal)),
        };
    }
    let checked = tokio::task::spawn_blocking(move || assembly.finish()).await;
    Ok(checked.unwrap_or_else(|e| Err(PackRefusal::Invalid { detail: format!("checking it failed: {e}") })))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACK: PackId = PackId([1; 32]);

    fn chunk(offset: u64, length: u32) -> PackChunk {
        PackChunk { pack: PACK, offset, length }
    }

    #[test]
    fn chunks_come_in_order_and_fit() {
        let mut a = Assembly::new(PACK, 10).unwrap();
        assert_eq!(a.accept(&chunk(0, 4)).unwrap().len(), 4);
        assert!(matches!(a.accept(&chunk(5, 4)), Err(PackRefusal::Transfer { .. })));
        assert!(!a.is_complete());
        assert_eq!(a.accept(&chunk(4, 6)).unwrap().len(), 6);
        assert!(a.is_complete());
        assert!(matches!(a.finish(), Err(PackRefusal::Invalid { .. })), "ten zeros are no pack");
    }

    #[test]
    fn an_impossible_length_is_refused() {
        assert!(matches!(Assembly::new(PACK, u64::MAX / 2), Err(PackRefusal::OutOfMemory { .. })));
    }
}
