//! The only place that knows bincode: frames of `u32` length (little endian) and an encoded message.
//!
//! A length is checked against the caller's limit before anything is reserved, bincode counts what it would
//! reserve for lists and texts against the same limit, and bytes left over after a message are an error.

use crate::{
    BatchHeader, FrameSummary, FromClient, Hello, LocalTicket, PackChunk, Refusal, ToClient, ToMaster,
    ToWorker, Version, limits,
};
use bincode::{Decode, Encode, config};

/// Bytes before each encoded message.
pub const PREFIX_BYTES: usize = 4;

/// TLS protocol name: versions are negotiated in `Hello`, this only tells Tessera from anything else.
pub const ALPN: &[u8] = b"tessera";

/// The name in every certificate; peers are known by their certificates' fingerprints, not by a host's name.
pub const SERVER_NAME: &str = "tessera-master";

/// First bytes on a bulk pipe over QUIC, where a stream exists for the peer only once something was written
/// to it.
pub const BULK_TAG: [u8; 8] = *b"tessblk\0";

/// A type that travels in a frame.
pub trait Message: Encode + Decode<()> {
    /// Greatest encoded length, and greatest size of what decoding reserves.
    const LIMIT: usize;
}

impl Message for ToMaster {
    const LIMIT: usize = limits::CONTROL_BYTES;
}
impl Message for ToWorker {
    const LIMIT: usize = limits::CONTROL_BYTES;
}
impl Message for FromClient {
    const LIMIT: usize = limits::CONTROL_BYTES;
}
impl Message for ToClient {
    const LIMIT: usize = limits::CONTROL_BYTES;
}
impl Message for FrameSummary {
    const LIMIT: usize = limits::HEADER_BYTES;
}
impl Message for PackChunk {
    const LIMIT: usize = limits::CHUNK_HEADER_BYTES;
}
impl Message for BatchHeader {
    const LIMIT: usize = limits::HEADER_BYTES;
}
impl Message for LocalTicket {
    const LIMIT: usize = limits::CONTROL_BYTES;
}

/// Why bytes are not a message. The sender is at fault; the connection cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// A length above its limit.
    #[error("a message of {length} bytes: at most {limit} are allowed here")]
    TooLong {
        /// Announced.
        length: usize,
        /// Allowed.
        limit: usize,
    },
    /// Bytes that do not decode.
    #[error("malformed message: {0}")]
    Malformed(String),
    /// Bytes behind the message.
    #[error("{0} bytes left over behind a message")]
    Trailing(usize),
}

/// The frame of `message`: prefix and encoded bytes.
///
/// Fails only with [`CodecError::TooLong`], for a message beyond its own limit.
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, CodecError> {
    let mut frame = vec![0; PREFIX_BYTES];
    let length = bincode::encode_into_std_write(message, &mut frame, config::standard())
        .map_err(|e| CodecError::Malformed(e.to_string()))?;
    if length > M::LIMIT {
        return Err(CodecError::TooLong { length, limit: M::LIMIT });
    }
    // Every limit is below 2^32 (checked below).
    frame[..PREFIX_BYTES].copy_from_slice(&(length as u32).to_le_bytes());
    Ok(frame)
}

const _: () =
    assert!(limits::CONTROL_BYTES <= limits::HEADER_BYTES && limits::HEADER_BYTES < u32::MAX as usize);

/// The length that a prefix announces, checked against `limit` (a message's own limit, or a tighter one).
pub fn body_length(prefix: [u8; PREFIX_BYTES], limit: usize) -> Result<usize, CodecError> {
    let length = u32::from_le_bytes(prefix) as usize;
    if length > limit { Err(CodecError::TooLong { length, limit }) } else { Ok(length) }
}

/// The `Hello` in `body`, a peer's first frame without its prefix, or why the peer is refused. Reads the frozen beginning first: a peer
/// of another version is told so, whatever else its `Hello` holds. What a later version adds at the end is skipped.
pub fn decode_hello(body: &[u8]) -> Result<Hello, Refusal> {
    let malformed = |detail: String| Refusal::Malformed { detail };
    let config = config::standard().with_limit::<{ limits::HELLO_BYTES }>();
    if body.len() > limits::HELLO_BYTES {
        return Err(malformed(
            CodecError::TooLong { length: body.len(), limit: limits::HELLO_BYTES }.to_string(),
        ));
    }
    let (variant, used): (u32, _) =
        bincode::decode_from_slice(body, config).map_err(|e| malformed(e.to_string()))?;
    if variant != 0 {
        return Err(malformed("the first message is not `Hello`".into()));
    }
    let body = &body[used..];
    let (versions, _): (Vec<u16>, _) =
        bincode::decode_from_slice(body, config).map_err(|e| malformed(e.to_string()))?;
    if versions.len() <= limits::VERSIONS && Version::common(&versions).is_none() {
        return Err(Refusal::Version { supported: Version::supported_numbers() });
    }
    let (hello, _): (Hello, _) =
        bincode::decode_from_slice(body, config).map_err(|e| malformed(e.to_string()))?;
    hello.check().map_err(malformed)?;
    Ok(hello)
}

/// The message in `body`, a frame without its prefix.
pub fn decode<M: Message>(body: &[u8]) -> Result<M, CodecError> {
    // bincode's limit is a type: the two sizes that occur are spelled out, and the smallest that serves is
    // taken.
    let decoded = if body.len() > M::LIMIT {
        return Err(CodecError::TooLong { length: body.len(), limit: M::LIMIT });
    } else if M::LIMIT <= limits::CONTROL_BYTES {
        bincode::decode_from_slice(body, config::standard().with_limit::<{ limits::CONTROL_BYTES }>())
    } else {
        bincode::decode_from_slice(body, config::standard().with_limit::<{ limits::HEADER_BYTES }>())
    };
    let (message, used) = decoded.map_err(|e| CodecError::Malformed(e.to_string()))?;
    match body.len() - used {
        0 => Ok(message),
        left => Err(CodecError::Trailing(left)),
    }
}
