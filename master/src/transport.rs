//! A connection to one peer as four byte pipes, whatever carries them. The worker has the same few lines
//! for reading and writing: the rooms under `shared/` know no runtime.

use std::io;
use tessera_pack::Pack;
use tessera_wire::{
    PackChunk, PackId,
    codec::{self, CodecError, Message, PREFIX_BYTES},
    limits, plain_text,
};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// A pipe that is read.
pub type Reader = Box<dyn AsyncRead + Send + Unpin>;
/// A pipe that is written.
pub type Writer = Box<dyn AsyncWrite + Send + Unpin>;

/// One end of a connection: a control and a bulk pipe in each direction.
pub struct Pipes {
    /// Control messages to this end.
    pub control_in: Reader,
    /// Control messages from this end.
    pub control_out: Writer,
    /// Raw bytes to this end (on the master's: tiles; on the worker's: the pack).
    pub bulk_in: Reader,
    /// Raw bytes from this end.
    pub bulk_out: Writer,
}

/// The master's end of a connection to a worker that nobody has greeted yet.
pub struct Link {
    pub(crate) pipes: Pipes,
    /// For messages: an address, or `in this process`.
    pub(crate) peer: String,
    /// What carries the pipes, to be closed and asked for its figures.
    pub(crate) connection: Option<quinn::Connection>,
}

impl Link {
    /// Bytes that one in-memory pipe holds before its writer waits.
    const PIPE_BYTES: usize = 256 << 10;

    /// A connection within this process: the master's end, and the pipes to hand to a worker (`--workers 0`,
    /// audits, tests).
    pub fn in_memory() -> (Self, Pipes) {
        let (control_here, control_there) = tokio::io::duplex(Self::PIPE_BYTES);
        let (bulk_here, bulk_there) = tokio::io::duplex(Self::PIPE_BYTES);
        let pipes = |control, bulk| {
            let (control_in, control_out) = tokio::io::split(control);
            let (bulk_in, bulk_out) = tokio::io::split(bulk);
            Pipes {
                control_in: Box::new(control_in),
                control_out: Box::new(control_out),
                bulk_in: Box::new(bulk_in),
                bulk_out: Box::new(bulk_out),
            }
        };
        let here = pipes(control_here, bulk_here);
        (
            Self { pipes: here, peer: "in this process".into(), connection: None },
            pipes(control_there, bulk_there),
        )
    }
}

/// Why nothing more can be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PipeError {
    /// The connection broke, or ended in the middle of something.
    #[error("{}", reason(.0))]
    Io(#[from] io::Error),
    /// The peer sent what is not a message, or one with a number out of range.
    #[error("{0}")]
    Malformed(String),
}

impl From<CodecError> for PipeError {
    fn from(e: CodecError) -> Self {
        Self::Malformed(e.to_string())
    }
}

/// Why a pipe broke, for people. QUIC's streams say only that the connection is lost; why is behind that, and part of it is the peer's.
pub(crate) fn reason(error: &io::Error) -> String {
    let behind = error.get_ref().and_then(|inner| inner.source());
    plain_text(&behind.map_or_else(|| error.to_string(), ToString::to_string))
}

/// Writes the chunks of a pack; `sent` is told of each how many bytes its header and its raw bytes took.
pub(crate) async fn write_pack(
    pipe: &mut Writer,
    pack: &Pack,
    mut sent: impl FnMut(u64, u64),
) -> Result<(), PipeError> {
    let mut offset = 0;
    for bytes in pack.bytes().chunks(limits::CHUNK_BYTES as usize) {
        let chunk = PackChunk { pack: PackId(pack.id().0), offset, length: bytes.len() as u32 };
        let header_bytes = write_message(pipe, &chunk).await?;
        pipe.write_all(bytes).await?;
        offset += bytes.len() as u64;
        sent(header_bytes, bytes.len() as u64);
    }
    Ok(pipe.flush().await?)
}

/// The next message of at most `limit` bytes, and the bytes it took; `None` at the end of the pipe.
pub(crate) async fn read_message<M: Message>(
    pipe: &mut Reader,
    limit: usize,
) -> Result<Option<(M, u64)>, PipeError> {
    let mut prefix = [0; PREFIX_BYTES];
    // An end before the first byte of a prefix is the end of the pipe; later it is an error.
    if pipe.read(&mut prefix[..1]).await? == 0 {
        return Ok(None);
    }
    pipe.read_exact(&mut prefix[1..]).await?;
    let body = read_raw(pipe, codec::body_length(prefix, limit)?).await?;
    Ok(Some((codec::decode(&body)?, (PREFIX_BYTES + body.len()) as u64)))
}

/// `length` raw bytes. Memory is taken as they come, so that a length alone costs nothing.
pub(crate) async fn read_raw(pipe: &mut Reader, length: usize) -> io::Result<Vec<u8>> {
    const STEP: usize = 1 << 20;
    let mut bytes = Vec::new();
    while bytes.len() < length {
        let filled = bytes.len();
        bytes.resize(length.min(filled + STEP), 0);
        pipe.read_exact(&mut bytes[filled..]).await?;
    }
    Ok(bytes)
}

/// Writes a message; the bytes it took.
pub(crate) async fn write_message<M: Message>(pipe: &mut Writer, message: &M) -> Result<u64, PipeError> {
    let bytes = codec::encode(message)?;
    pipe.write_all(&bytes).await?;
    Ok(bytes.len() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::ToMaster;

    #[tokio::test]
    async fn what_is_written_is_read_and_an_oversized_frame_is_not() {
        let (link, mut there) = Link::in_memory();
        let mut here = link.pipes.control_in;
        let sent = write_message(&mut there.control_out, &ToMaster::Leave).await.unwrap();
        let read = read_message::<ToMaster>(&mut here, limits::HELLO_BYTES).await.unwrap();
        assert_eq!(read, Some((ToMaster::Leave, sent)));

        there.control_out.write_all(&(limits::HELLO_BYTES as u32 + 1).to_le_bytes()).await.unwrap();
        let refused = read_message::<ToMaster>(&mut here, limits::HELLO_BYTES).await;
        assert!(matches!(refused, Err(PipeError::Malformed(_))), "{refused:?}");
    }

    #[tokio::test]
    async fn an_end_between_messages_is_none_and_within_one_an_error() {
        let (link, there) = Link::in_memory();
        let mut here = link.pipes.control_in;
        drop(there);
        assert!(matches!(read_message::<ToMaster>(&mut here, 100).await, Ok(None)));

        let (link, mut there) = Link::in_memory();
        let mut here = link.pipes.control_in;
        there.control_out.write_all(&[5, 0, 0, 0, 1]).await.unwrap();
        drop(there);
        assert!(matches!(read_message::<ToMaster>(&mut here, 100).await, Err(PipeError::Io(_))));
    }

    #[tokio::test]
    async fn raw_bytes_longer_than_a_step_arrive_whole() {
        let (link, mut there) = Link::in_memory();
        let bytes: Vec<u8> = (0..3_000_000u32).map(|i| i as u8).collect();
        let expected = bytes.clone();
        let write = tokio::spawn(async move { there.bulk_out.write_all(&bytes).await });
        let mut here = link.pipes.bulk_in;
        assert_eq!(read_raw(&mut here, expected.len()).await.unwrap(), expected);
        write.await.unwrap().unwrap();
    }
}
