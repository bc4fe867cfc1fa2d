//! Messages and raw bytes on pipes. The master has the same few lines: the rooms under `shared/` know no
//! runtime.

use std::io;
use tessera_wire::{
    codec::{self, CodecError, Message, PREFIX_BYTES},
    plain_text,
};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// A pipe that is read.
pub(crate) type Reader = Box<dyn AsyncRead + Send + Unpin>;
/// A pipe that is written.
pub(crate) type Writer = Box<dyn AsyncWrite + Send + Unpin>;

/// Why nothing more can be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PipeError {
    /// The connection broke, or ended in the middle of something.
    #[error("{}", reason(.0))]
    Io(#[from] io::Error),
    /// The peer sent what is not a message.
    #[error("{0}")]
    Codec(#[from] CodecError),
}

/// Why a pipe broke, for people. QUIC's streams say only that the connection is lost; why is behind that, and part of it is the peer's.
pub(crate) fn reason(error: &io::Error) -> String {
    let behind = error.get_ref().and_then(|inner| inner.source());
    plain_text(&behind.map_or_else(|| error.to_string(), ToString::to_string))
}

/// The next message, `None` at the end of the pipe.
pub(crate) async fn read_message<M: Message>(pipe: &mut Reader) -> Result<Option<M>, PipeError> {
    let mut prefix = [0; PREFIX_BYTES];
    // An end before the first byte of a prefix is the end of the pipe; later it is an error.
    if pipe.read(&mut prefix[..1]).await? == 0 {
        return Ok(None);
    }
    pipe.read_exact(&mut prefix[1..]).await?;
    let mut body = vec![0; codec::body_length(prefix, M::LIMIT)?];
    pipe.read_exact(&mut body).await?;
    Ok(Some(codec::decode(&body)?))
}

/// Writes a message.
pub(crate) async fn write_message<M: Message>(pipe: &mut Writer, message: &M) -> Result<(), PipeError> {
    pipe.write_all(&codec::encode(message)?).await?;
    Ok(())
}
