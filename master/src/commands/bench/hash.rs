//! What a bench computed, in one short word: the same on every machine.

/// BLAKE3 over words in little-endian order.
#[derive(Default)]
pub struct Hash(blake3::Hasher);

impl Hash {
    /// Takes one word in.
    pub fn add(&mut self, word: u32) {
        self.0.update(&word.to_le_bytes());
    }

    /// The first 64 bits in hexadecimal.
    pub fn finish(&self) -> String {
        self.0.finalize().as_bytes()[..8].iter().map(|b| format!("{b:02x}")).collect()
    }
}
