//! Bits in bytes, the lowest first.

/// Writes.
pub(super) struct BitWriter {
    /// Behind `length` lie zeros, room for what was announced, and 8 bytes more.
    bytes: Vec<u8>,
    length: usize,
    /// Bits that are not in `bytes` yet, fewer than 8 of them.
    waiting: u64,
    count: u32,
    most: usize,
}

impl BitWriter {
    /// A writer that gives up at `most` bytes.
    pub(super) fn new(most: usize) -> Self {
        Self { bytes: Vec::new(), length: 0, waiting: 0, count: 0, most }
    }

    /// Makes room for `bits`, from whole bytes on; `None` if that is too many.
    pub(super) fn announce(&mut self, bits: u64) -> Option<()> {
        let end = self.length as u64 + bits.div_ceil(8);
        if end >= self.most as u64 {
            return None;
        }
        self.bytes.resize(end as usize + 8, 0);
        Some(())
    }

    /// The lowest `count` of `bits`, the others being 0; at most 56, which were announced.
    #[inline]
    pub(super) fn bits(&mut self, bits: u64, count: u32) {
        self.waiting |= bits << self.count;
        self.count += count;
        let whole = self.count / 8;
        // Eight bytes are written faster than as many as are whole.
        self.bytes[self.length..self.length + 8].copy_from_slice(&self.waiting.to_le_bytes());
        self.length += whole as usize;
        self.waiting >>= 8 * whole;
        self.count %= 8;
    }

    /// Fills the last byte up with zeros.
    pub(super) fn align(&mut self) {
        if self.count > 0 {
            self.bits(0, 8 - self.count);
        }
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        self.bytes.truncate(self.length);
        self.bytes
    }
}

/// Reads. Behind the end are zeros; [`BitReader::check`] tells whether any of them was taken.
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Bits taken.
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The next bits, at least 57 of them.
    #[inline]
    pub(super) fn peek(&self) -> u64 {
        let first = self.at / 8;
        let word = match self.bytes.get(first..first + 8) {
            Some(&[a, b, c, d, e, f, g, h]) => u64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => self.last_word(first),
        };
        word >> (self.at % 8)
    }

    #[cold]
    fn last_word(&self, first: usize) -> u64 {
        let rest = self.bytes.get(first..).unwrap_or_default();
        rest.iter().take(8).rev().fold(0, |word, byte| word << 8 | u64::from(*byte))
    }

    /// Takes as many; at most 56.
    #[inline]
    pub(super) fn skip(&mut self, count: u32) {
        self.at += count as usize;
    }

    /// That no more was taken than there is.
    pub(super) fn check(&self) -> Result<(), String> {
        match self.at.div_ceil(8) <= self.bytes.len() {
            true => Ok(()),
            false => Err("a packed tile that is cut off".into()),
        }
    }

    /// Goes on at the next whole byte; what is skipped must be zeros.
    pub(super) fn align(&mut self) -> Result<(), String> {
        let over = self.at % 8;
        if over > 0 {
            let rest = 8 - over as u32;
            if self.peek() & ((1 << rest) - 1) != 0 {
                return Err("a packed plane that does not end with zeros".into());
            }
            self.skip(rest);
        }
        self.check()
    }

    /// That everything was taken.
    pub(super) fn finish(&self) -> Result<(), String> {
        self.check()?;
        match self.bytes.len() - self.at.div_ceil(8) {
            0 => Ok(()),
            left => Err(format!("{left} bytes behind a packed tile")),
        }
    }
}
