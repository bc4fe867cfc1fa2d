//! What a local worker process is told through its standard input.

use crate::JoinString;
use bincode::{Decode, Encode};

/// What one local worker needs to join. Written by the master into the child's standard input, which then stays open: when it closes,
/// the worker ends. Neither arguments, environment nor files show the token, which is good for this worker alone.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct LocalTicket {
    /// Where, to whom, and what lets it in.
    pub join: JoinString,
    /// The worker's name.
    pub name: String,
    /// Threads that render, >= 1.
    pub threads: u32,
    /// Workers that share the machine's memory, this one included, >= 1.
    pub sharers: u32,
}
