//! Why bytes are not a pack, and why a pack could not be made.

/// Why bytes are not a pack that this version can read. Nothing of them is used; a sender may be asked again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PackError {
    /// They do not begin like one.
    #[error("not a pack: the file does not begin with the .tpack signature")]
    NotAPack,
    /// A pack of another version.
    #[error(
        "a pack of format version {found}; this program reads version {}: pack the scene again",
        crate::format::VERSION
    )]
    Version {
        /// Its version.
        found: u32,
    },
    /// Bytes are missing (or follow).
    #[error("the pack is truncated or continued: {found} bytes instead of {expected}")]
    Truncated {
        /// Length that the header gives.
        expected: u64,
        /// Length at hand.
        found: u64,
    },
    /// The content is not what was hashed.
    #[error("the pack is damaged: its content does not match its hash")]
    HashMismatch,
    /// A section breaks a rule of the format.
    #[error("not a valid pack: section '{section}', byte {offset}: {what}")]
    Malformed {
        /// Section.
        section: &'static str,
        /// Place: of the header and the table from the start of the file, otherwise from the start of the section.
        offset: u64,
        /// The rule.
        what: String,
    },
    /// The memory cannot be had.
    #[error("{0} bytes of memory for the pack could not be had")]
    OutOfMemory(u64),
}

/// Why a pack could not be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// The input is at fault; the message says what, where and what to do.
    #[error("{0}")]
    Input(String),
    /// The pack did not pass its own check: a fault of this program, not of the input.
    #[error("the pack that was made is not sound; please report this: {0}")]
    Unsound(PackError),
    /// The memory cannot be had.
    #[error("{0} bytes of memory for the pack could not be had")]
    OutOfMemory(u64),
}
