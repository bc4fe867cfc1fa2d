//! Reasons: why a peer is refused, why it refuses a pack, why a connection is cut.

use crate::{PackId, limits};
use bincode::{Decode, Encode};

/// Why the master does not take a peer. Sent in `Refuse`; what it says is for the peer's side.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode, thiserror::Error)]
pub enum Refusal {
    /// No common protocol version. The number and layout of this reason are frozen.
    #[error(
        "no common protocol version: the master speaks {supported:?}; use the same version of tessera on both sides"
    )]
    Version {
        /// What the master speaks.
        supported: Vec<u16>,
    },
    /// The worker's arithmetic differs from the cluster's: its pixels would not match.
    #[error("numeric class differs: the cluster renders in class `{expected}`")]
    NumericClass {
        /// The class of the cluster.
        expected: String,
    },
    /// The first message does not decode, or something in it is out of range.
    #[error("malformed hello: {detail}")]
    Malformed {
        /// What is wrong.
        detail: String,
    },
    /// The token is none that the master gave.
    #[error("wrong token: use the join string that this master has printed since it was started last")]
    Token,
    /// The token was right once.
    #[error(
        "the join string has expired: start the master again for a new one, or with a longer --token-ttl"
    )]
    Expired,
    /// The master takes no peers of this role.
    #[error("this master takes workers only")]
    Role,
    /// The master has as many peers of this role as it takes. The only reason that passes.
    #[error("the master is full: it takes {limit} of this kind at a time; try again later")]
    Full {
        /// How many it takes.
        limit: u32,
    },
}

impl Refusal {
    /// Whether the same peer may be taken later, without anything being changed on its side.
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Full { .. })
    }
}

/// Why a worker cannot hold a pack.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode, thiserror::Error)]
pub enum PackRefusal {
    /// It does not fit the worker's memory.
    #[error("out of memory: the pack needs {needs} bytes, the worker has {has}")]
    OutOfMemory {
        /// Bytes of the pack.
        needs: u64,
        /// Bytes that the worker may use.
        has: u64,
    },
    /// The bytes that arrived have another hash than was offered.
    #[error("hash mismatch: the bytes that arrived have the id {got}")]
    HashMismatch {
        /// What they hash to.
        got: PackId,
    },
    /// Chunks out of order, too long, or of another pack.
    #[error("bad transfer: {detail}")]
    Transfer {
        /// What is wrong.
        detail: String,
    },
    /// The content is not a valid pack.
    #[error("not a valid pack: {detail}")]
    Invalid {
        /// What is wrong.
        detail: String,
    },
    /// What renders, or one of its limits, is too small for it; another backend of the same worker may do.
    #[error(
        "{what} can hold {has} bytes, the scene needs {needs}; start this worker with --backend cpu to render it"
    )]
    CannotHold {
        /// Bytes that the scene needs there.
        needs: u64,
        /// Bytes that there are.
        has: u64,
        /// What holds them, as the beginning of a sentence: `the GPU NAME`, `one buffer of the GPU NAME`.
        what: String,
    },
}

impl PackRefusal {
    /// The same, as it may go to a log.
    pub fn plain(self) -> Self {
        match self {
            Self::Transfer { detail } => Self::Transfer { detail: plain_text(&detail) },
            Self::Invalid { detail } => Self::Invalid { detail: plain_text(&detail) },
            Self::CannotHold { needs, has, what } => Self::CannotHold { needs, has, what: plain_text(&what) },
            Self::OutOfMemory { .. } | Self::HashMismatch { .. } => self,
        }
    }
}

/// Why a connection is cut; the number is also QUIC's application close code. One line each, numbers are
/// never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode, thiserror::Error)]
#[repr(u32)]
pub enum AbortCode {
    /// 0: nothing is wrong, the work is done.
    #[error("done")]
    Done = 0,
    /// 1: a message that the receiver's state does not allow.
    #[error("unexpected message")]
    Unexpected = 1,
    /// 2: bytes that do not decode, or a length above its limit.
    #[error("malformed message")]
    Malformed = 2,
    /// 3: a frame whose parameters are out of range, or of a pack that the worker does not hold.
    #[error("bad frame")]
    BadFrame = 3,
    /// 4: tiles or pixels that do not belong to the frame.
    #[error("bad tiles")]
    BadTiles = 4,
    /// 5: the peer did not answer in time.
    #[error("timed out")]
    Timeout = 5,
    /// 6: the peer was refused; the reason went ahead in `Refuse`.
    #[error("refused")]
    Refused = 6,
    /// 7: the sender has failed in itself (its message says how).
    #[error("internal failure")]
    Internal = 7,
    /// 8: too many connections are being made; another attempt may succeed.
    #[error("too many connections are being made")]
    Busy = 8,
    /// 9: the same peer, known by its certificate, has connected again; this connection is the old one.
    #[error("replaced by a later connection of the same peer")]
    Replaced = 9,
}

impl AbortCode {
    /// The number on the wire and in QUIC's close frame.
    pub const fn number(self) -> u32 {
        self as u32
    }
}

/// A text that may go to a peer, or that came from one and goes to a log: without characters that forge lines or hide some, and at
/// most [`limits::TEXT_BYTES`] bytes of it.
pub fn plain_text(text: &str) -> String {
    let mut plain: String = text.chars().filter(|&c| is_plain(c)).take(limits::TEXT_BYTES).collect();
    plain.truncate(plain.floor_char_boundary(limits::TEXT_BYTES));
    plain
}

/// Not a control character, a separator of lines or paragraphs, or one that turns the direction of what follows (Unicode 16,
/// `Bidi_Control`'s embeddings, overrides and isolates).
pub(crate) fn is_plain(c: char) -> bool {
    !c.is_control()
        && !matches!(c, '\u{2028}' | '\u{2029}' | '\u{202A}'..='\u{202E}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_become_plain_and_are_cut_at_a_character() {
        assert_eq!(plain_text("short\n\x1b[2J"), "short[2J");
        assert_eq!(plain_text("a\u{2028}b\u{2029}c\u{202a}\u{202e}d\u{2066}\u{2069}é"), "abcdé");
        let refused = PackRefusal::Transfer { detail: "x\nforged".into() }.plain();
        assert_eq!(refused.to_string(), "bad transfer: xforged");
        let refused = PackRefusal::CannotHold { needs: 3, has: 2, what: "the GPU x\n".into() }.plain();
        assert!(refused.to_string().starts_with("the GPU x can hold 2 bytes, the scene needs 3"));
        assert_eq!(plain_text(&"é".repeat(400)), "é".repeat(256));
        assert_eq!(plain_text(&format!("a{}", "é".repeat(400))).len(), limits::TEXT_BYTES - 1);
    }
}
