//! Hashing plain values.

/// BLAKE3 over little-endian values, each list behind its length, so that no two inputs run into each other.
pub(crate) struct Digest {
    hasher: blake3::Hasher,
    waiting: Vec<u8>,
}

/// Bytes that are hashed at once.
const BATCH: usize = 1 << 16;

impl Digest {
    pub(crate) fn new(what: &str) -> Self {
        let mut digest = Self { hasher: blake3::Hasher::new(), waiting: Vec::with_capacity(BATCH) };
        digest.bytes(what.as_bytes());
        digest
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.u64(bytes.len() as u64);
        self.push(bytes);
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.push(&value.to_le_bytes());
    }

    pub(crate) fn f32s(&mut self, values: &[f32]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|value| self.push(&value.to_le_bytes()));
    }

    pub(crate) fn f64s(&mut self, values: &[f64]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|value| self.push(&value.to_le_bytes()));
    }

    pub(crate) fn u32s(&mut self, values: &[u32]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|value| self.push(&value.to_le_bytes()));
    }

    fn push(&mut self, bytes: &[u8]) {
        if self.waiting.len() + bytes.len() > BATCH {
            self.hasher.update(&self.waiting);
            self.waiting.clear();
        }
        if bytes.len() > BATCH {
            self.hasher.update(bytes);
        } else {
            self.waiting.extend_from_slice(bytes);
        }
    }

    pub(crate) fn finish(mut self) -> [u8; 32] {
        self.hasher.update(&self.waiting);
        *self.hasher.finalize().as_bytes()
    }
}
