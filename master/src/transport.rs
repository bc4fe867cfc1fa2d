//! A connection to one worker as four byte pipes, whatever carries them.

use tokio::io::{AsyncRead, AsyncWrite};

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
}

impl Link {
    /// Bytes that one in-memory pipe holds before its writer waits.
    const PIPE_BYTES: usize = 256 << 10;

    /// A connection within this process: the master's end, and the pipes to hand to a worker (`--workers 0`, audits, tests).
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
        let here = Self { pipes: pipes(control_here, bulk_here), peer: "in this process".into() };
        (here, pipes(control_there, bulk_there))
    }
}
