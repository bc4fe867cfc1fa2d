//! What a local worker process is told through its standard input.

use bincode::{Decode, Encode};

/// Address and credentials for one local worker. Written by the master into the child's standard input, which
/// then stays open: when it closes, the worker ends. Neither arguments, environment nor files show the key.
#[derive(Clone, PartialEq, Eq, Encode, Decode)]
pub struct LocalTicket {
    /// The master's address, as text: `127.0.0.1:4433`.
    pub address: String,
    /// The worker's name.
    pub name: String,
    /// Threads that render, >= 1.
    pub threads: u32,
    /// Workers that share the machine's memory, this one included, >= 1.
    pub sharers: u32,
    /// DER of the authority that signed the master's certificate.
    pub authority: Vec<u8>,
    /// DER of the worker's own certificate.
    pub certificate: Vec<u8>,
    /// PKCS#8 DER of its key.
    pub key: Vec<u8>,
}

impl std::fmt::Debug for LocalTicket {
    /// Without the key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LocalTicket")
            .field("address", &self.address)
            .field("name", &self.name)
            .field("threads", &self.threads)
            .finish_non_exhaustive()
    }
}
