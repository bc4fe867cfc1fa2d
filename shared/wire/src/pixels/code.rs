//! Symbols, and prefix codes for them: canonical, of at most [`LONGEST`] bits.

use super::bits::{BitReader, BitWriter};

/// Where all neighbours are equal, symbol `s` below this says that 2^s and as many as the next `s` bits say are predicted exactly, those that
/// follow included whatever their surroundings. A tile has at most 2^24 samples of a channel.
pub(super) const RUNS: usize = 25;

/// Then, and in other surroundings from 0 on, come differences from the prediction: below 16 each has a symbol; above, the symbol says the
/// two highest bits and where they are, and the lower ones follow.
pub(super) const DIRECT: u32 = 16;

/// Symbols of a code; differences have up to 32 bits.
pub(super) const SYMBOLS: usize = RUNS + DIRECT as usize + 2 * (32 - 4);

/// The symbol of a difference, without [`RUNS`], and how many bits follow it: its lowest.
#[inline]
pub(super) fn split(folded: u32) -> (usize, u32) {
    if folded < DIRECT {
        return (folded as usize, 0);
    }
    let bits = folded.ilog2() - 1;
    ((DIRECT + 2 * (bits - 3) + (folded >> bits & 1)) as usize, bits)
}

/// The highest bits of what [`split`] was given, and how many bits follow them.
fn join(symbol: usize) -> (u32, u32) {
    match (symbol as u32).checked_sub(DIRECT) {
        None => (symbol as u32, 0),
        Some(above) => (2 + above % 2, 3 + above / 2),
    }
}

/// Bits of the longest code. Half a byte tells a length, and a table of 2^11 entries decodes.
pub(super) const LONGEST: u32 = 11;

/// How often each symbol comes.
pub(super) type Counts = [u32; SYMBOLS];

/// A code for writing.
#[derive(Clone, Copy)]
pub(super) struct Code {
    /// Bits of each symbol, the first to be written lowest, and how many they are; 0 for a symbol that does not come.
    pub(super) words: [(u16, u8); SYMBOLS],
}

impl Code {
    /// The best code for `counts`, but for codes that would be longer than [`LONGEST`].
    pub(super) fn best(counts: &Counts) -> Self {
        let mut counts = *counts;
        loop {
            let lengths = lengths(&counts);
            if lengths.iter().all(|length| u32::from(*length) <= LONGEST) {
                return Self { words: words(&lengths) };
            }
            // Rare symbols become more frequent beside the others; 97 equal ones need 7 bits.
            counts.iter_mut().filter(|count| **count > 0).for_each(|count| *count = *count / 2 + 1);
        }
    }

    /// Symbols up to the last one that comes.
    fn symbols(&self) -> usize {
        self.words.iter().rposition(|word| word.1 > 0).map_or(0, |last| last + 1)
    }

    /// Bits that symbols take which come so often, without those that follow them.
    pub(super) fn bits_for(&self, counts: &Counts) -> u64 {
        self.words.iter().zip(counts).map(|(word, count)| u64::from(word.1) * u64::from(*count)).sum()
    }

    /// Bits that the lengths take.
    pub(super) fn header_bits(&self) -> u64 {
        8 + 4 * self.symbols() as u64
    }

    /// How many symbols, and the length of each.
    pub(super) fn write(&self, out: &mut BitWriter) {
        let symbols = self.symbols();
        out.bits(symbols as u64, 8);
        self.words[..symbols].iter().for_each(|word| out.bits(word.1.into(), 4));
    }
}

/// Lengths of Huffman's code: the two rarest nodes become one until one is left. Of equal counts the first symbol is the rarer, and leaves
/// are rarer than nodes, so that every machine has the same code.
fn lengths(counts: &Counts) -> [u8; SYMBOLS] {
    let mut order = [0_u8; SYMBOLS];
    let mut leaves = 0;
    for symbol in (0..SYMBOLS).filter(|symbol| counts[*symbol] > 0) {
        order[leaves] = symbol as u8;
        leaves += 1;
    }
    let order = &mut order[..leaves];
    order.sort_unstable_by_key(|symbol| (counts[usize::from(*symbol)], *symbol));
    let mut lengths = [0; SYMBOLS];
    match *order {
        [] => return lengths,
        [only] => {
            lengths[usize::from(only)] = 1;
            return lengths;
        }
        _ => {}
    }
    // Leaves in order, then nodes in order of being made, which is that of their counts.
    let mut weights = [0_u64; 2 * SYMBOLS];
    order.iter().zip(&mut weights).for_each(|(symbol, weight)| *weight = counts[usize::from(*symbol)].into());
    let mut parents = [0_u8; 2 * SYMBOLS];
    let (mut leaf, mut node) = (0, leaves);
    let all = 2 * leaves - 1;
    for made in leaves..all {
        for _ in 0..2 {
            let takes_leaf = leaf < leaves && (node >= made || weights[leaf] <= weights[node]);
            let next = if takes_leaf { &mut leaf } else { &mut node };
            weights[made] += weights[*next];
            parents[*next] = made as u8;
            *next += 1;
        }
    }
    let mut depths = [0_u8; 2 * SYMBOLS];
    for place in (0..all - 1).rev() {
        depths[place] = depths[usize::from(parents[place])] + 1;
    }
    order.iter().zip(depths).for_each(|(symbol, depth)| lengths[usize::from(*symbol)] = depth);
    lengths
}

/// Codes in the order of length and symbol, as in RFC 1951, 3.2.2.
fn words(lengths: &[u8; SYMBOLS]) -> [(u16, u8); SYMBOLS] {
    let mut next = [0_u16; LONGEST as usize + 1];
    let used = || lengths.iter().enumerate().filter(|(_, length)| **length > 0);
    used().for_each(|(_, length)| next[usize::from(*length)] += 1);
    let mut first = 0;
    for next in &mut next[1..] {
        (first, *next) = ((first + *next) << 1, first);
    }
    let mut words = [(0, 0); SYMBOLS];
    for (symbol, &length) in used() {
        let next = &mut next[usize::from(length)];
        words[symbol] = (next.reverse_bits() >> (16 - length), length);
        *next += 1;
    }
    words
}

/// Entries of a table for reading a code.
pub(super) const ENTRIES: usize = 1 << LONGEST;

/// What bits begin with: in the lowest four bits how many of them are a code, 0 for none; above these how many follow it, in five bits; whether a
/// run is meant; and what stands above the bits that follow, in four.
#[derive(Clone, Copy, Default)]
pub(super) struct Entry(u16);

impl Entry {
    fn new(length: u8, symbol: usize, has_runs: bool) -> Self {
        let is_run = has_runs && symbol < RUNS;
        let (high, bits) = match is_run {
            true => (1, symbol as u32),
            false => join(symbol - if has_runs { RUNS } else { 0 }),
        };
        Self((high << 10 | u32::from(is_run) << 9 | bits << 4) as u16 | u16::from(length))
    }

    /// Bits of the code.
    #[inline]
    pub(super) fn length(self) -> u32 {
        u32::from(self.0 & 15)
    }

    /// Bits that follow the code.
    #[inline]
    pub(super) fn bits(self) -> u32 {
        u32::from(self.0 >> 4 & 31)
    }

    #[inline]
    pub(super) fn is_run(self) -> bool {
        self.0 >> 9 & 1 == 1
    }

    /// The whole number, where `low` begins with the bits that follow.
    #[inline]
    pub(super) fn number(self, low: u64) -> u32 {
        u32::from(self.0 >> 10) << self.bits() | (low as u32 & ((1 << self.bits()) - 1))
    }
}

/// Reads the lengths of a code and fills `table` by the next [`LONGEST`] bits. They must leave no bits without a meaning, unless there is one
/// symbol or none.
pub(super) fn read(
    reader: &mut BitReader<'_>,
    has_runs: bool,
    table: &mut [Entry; ENTRIES],
) -> Result<(), String> {
    table.fill(Entry::default());
    let count = (reader.peek() & 0xff) as usize;
    reader.skip(8);
    if count > SYMBOLS - if has_runs { 0 } else { RUNS } {
        return Err(format!("a packed plane with a code of {count} symbols"));
    }
    let mut lengths = [0; SYMBOLS];
    for length in &mut lengths[..count] {
        *length = (reader.peek() & 15) as u8;
        reader.skip(4);
    }
    reader.check()?;
    let used = || lengths.iter().filter(|length| **length > 0);
    let taken: usize = used().map(|length| ENTRIES >> length).sum();
    let is_code = match used().count() {
        0 => count == 0,
        1 => taken == ENTRIES / 2,
        _ => taken == ENTRIES,
    };
    if !is_code || used().any(|length| u32::from(*length) > LONGEST) {
        return Err("a packed plane with lengths that are no code".into());
    }
    for (symbol, (word, length)) in words(&lengths).into_iter().enumerate().filter(|(_, word)| word.1 > 0) {
        let entry = Entry::new(length, symbol, has_runs);
        table[usize::from(word)..].iter_mut().step_by(1 << length).for_each(|to| *to = entry);
    }
    Ok(())
}
