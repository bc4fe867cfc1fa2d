//! One channel of a tile.

use super::bits::{BitReader, BitWriter};
use super::code::{self, Code, Counts, ENTRIES, Entry, RUNS, SYMBOLS};

/// Kinds of surroundings: how much the three neighbours differ, from not at all on.
const CONTEXTS: usize = 6;

/// As many, so that what is taken modulo their number is quickly taken.
const CONTEXTS_POWER: usize = CONTEXTS.next_power_of_two();

/// A channel's value.
pub(super) trait Sample: Copy + Default {
    /// A difference and its surroundings in one number.
    type Key: Copy + PartialEq;
    /// Of these.
    fn key(context: u8, folded: Self) -> Self::Key;
    /// The context and the difference.
    fn parts(key: Self::Key) -> (usize, u32);
    /// What the neighbours to the left, above, and above to the left make of it; and in which surroundings.
    fn predict(left: Self, above: Self, corner: Self) -> (Self, u8);
    /// The difference from `guess`: small for small ones of either sign.
    fn fold(self, guess: Self) -> Self;
    /// The sample of a difference.
    fn unfold(folded: u32, guess: Self) -> Self;
}

/// Arithmetic of `$unsigned` in `$wide`, and how much differing neighbours are of the next kind.
macro_rules! sample {
    ($unsigned:ty, $signed:ty, $key:ty, $wide:ty, $steps:expr) => {
        impl Sample for $unsigned {
            type Key = $key;

            #[inline]
            fn key(context: u8, folded: Self) -> $key {
                <$key>::from(context) << Self::BITS | <$key>::from(folded)
            }

            #[inline]
            fn parts(key: $key) -> (usize, u32) {
                ((key >> Self::BITS) as usize, (key as Self).into())
            }

            #[inline]
            fn predict(left: Self, above: Self, corner: Self) -> (Self, u8) {
                const STEPS: [$wide; CONTEXTS - 1] = $steps;
                let (left, above, corner) = (left as $wide, above as $wide, corner as $wide);
                let guess = (left + above - corner).max(left.min(above)).min(left.max(above));
                let differ = (left - corner).abs() + (above - corner).abs();
                (guess as Self, STEPS.iter().map(|step| u8::from(differ >= *step)).sum())
            }

            #[inline]
            fn fold(self, guess: Self) -> Self {
                let difference = self.wrapping_sub(guess) as $signed;
                ((difference << 1) ^ (difference >> (Self::BITS - 1))) as Self
            }

            #[inline]
            fn unfold(folded: u32, guess: Self) -> Self {
                let folded = folded as Self;
                guess.wrapping_add((folded >> 1) ^ (folded & 1).wrapping_neg())
            }
        }
    };
}

sample!(u8, i8, u16, i16, [1, 3, 8, 20, 50]);
sample!(u16, i16, u32, i32, [1, 24, 128, 512, 2048]);
sample!(u32, i32, u64, i64, [1, 1 << 10, 1 << 14, 1 << 18, 1 << 22]);

/// Room for planes that are being packed.
#[derive(Default)]
pub(super) struct Plane<S: Sample> {
    /// The samples.
    pub(super) samples: Vec<S>,
    /// Of each, the difference from its prediction, and above that its surroundings.
    keys: Vec<S::Key>,
}

/// What a plane consists of.
enum Part<K> {
    /// As many exact predictions.
    Run(usize),
    /// A difference and its surroundings.
    Difference(K),
}

/// Differences below are counted one by one before they are counted by symbols: all of those of 8 bits.
const SMALL: usize = 256;

impl<S: Sample> Plane<S> {
    /// Packs the samples, whole rows of `columns`; `None` if the writer has no room.
    pub(super) fn pack(&mut self, columns: usize, out: &mut BitWriter) -> Option<()> {
        self.predict(columns);
        // Count the symbols of each context, and the bits that follow them.
        let mut counts = [[0; SYMBOLS]; CONTEXTS];
        let mut small = [[0_u32; SMALL]; CONTEXTS_POWER];
        let mut extra = 0;
        let mut count = |context: usize, symbol: usize, bits: u32, times: u32| {
            counts[context][symbol] += times;
            extra += u64::from(bits) * u64::from(times);
        };
        self.walk(|part| match part {
            Part::Run(run) => count(0, run.ilog2() as usize, run.ilog2(), 1),
            Part::Difference(key) => {
                let (context, folded) = S::parts(key);
                match small[context % CONTEXTS_POWER].get_mut(folded as usize) {
                    Some(small) => *small += 1,
                    None => {
                        let (symbol, bits) = code::split(folded);
                        count(context, first_of(context) + symbol, bits, 1);
                    }
                }
            }
        });
        for (context, small) in small.iter().enumerate() {
            for (folded, times) in small.iter().enumerate().filter(|(_, times)| **times > 0) {
                let (symbol, bits) = code::split(folded as u32);
                count(context, first_of(context) + symbol, bits, *times);
            }
        }
        // Make the codes, and see that it all fits.
        let codes = counts.map(|counts: Counts| Code::best(&counts));
        let header: u64 = codes.iter().map(Code::header_bits).sum();
        let used: u64 = codes.iter().zip(&counts).map(|(code, counts)| code.bits_for(counts)).sum();
        out.announce(header + extra + used)?;
        // Write the codes, then what they stand for.
        codes.iter().for_each(|code| code.write(out));
        let word = |context: usize, folded: u32| {
            let (symbol, bits) = code::split(folded);
            let (word, length) = codes[context].words[first_of(context) + symbol];
            let low = folded & ((1 << bits) - 1);
            (u64::from(word) | u64::from(low) << length, u32::from(length) + bits)
        };
        // (With at most 6 bits behind the code, and how many there are in the lowest 8.)
        let mut words = [[0_u32; SMALL]; CONTEXTS_POWER];
        for (context, words) in words.iter_mut().enumerate() {
            let used = words.iter_mut().zip(small[context]).enumerate().filter(|(_, (_, times))| *times > 0);
            used.for_each(|(folded, (to, _))| {
                let (word, length) = word(context, folded as u32);
                *to = (word as u32) << 8 | length;
            });
        }
        self.walk(|part| match part {
            Part::Run(run) => {
                let bits = run.ilog2();
                let (word, length) = codes[0].words[bits as usize];
                let low = run as u64 - (1 << bits);
                out.bits(u64::from(word) | low << length, u32::from(length) + bits);
            }
            Part::Difference(key) => {
                let (context, folded) = S::parts(key);
                match words[context % CONTEXTS_POWER].get(folded as usize) {
                    Some(word) => out.bits(u64::from(word >> 8), word & 0xff),
                    None => {
                        let (word, length) = word(context, folded);
                        out.bits(word, length);
                    }
                }
            }
        });
        out.align();
        Some(())
    }

    /// Finds each sample's surroundings, and how far it is from what they make of it.
    fn predict(&mut self, columns: usize) {
        self.keys.resize(self.samples.len(), S::key(0, S::default()));
        let mut before: Option<&[S]> = None;
        for (row, keys) in self.samples.chunks_exact(columns).zip(self.keys.chunks_exact_mut(columns)) {
            // Outside the tile, the nearest neighbour inside stands in; before all of them, 0.
            let first = before.map_or(S::default(), |before| before[0]);
            keys[0] = S::key(0, row[0].fold(first));
            // (One loop on slices of one length: the compiler makes vectors of it.)
            let count = columns - 1;
            let (left, here, keys) = (&row[..count], &row[1..][..count], &mut keys[1..][..count]);
            let (corner, above) =
                before.map_or((left, left), |before| (&before[..count], &before[1..][..count]));
            for k in 0..count {
                let (guess, context) = S::predict(left[k], above[k], corner[k]);
                keys[k] = S::key(context, here[k].fold(guess));
            }
            before = Some(row);
        }
    }

    /// Tells of the plane part by part.
    #[inline(always)]
    fn walk(&self, mut tell: impl FnMut(Part<S::Key>)) {
        /// Keys that are looked at together.
        const BLOCK: usize = 32;
        let exact = S::key(0, S::default());
        let mut at = 0;
        while let Some(&key) = self.keys.get(at) {
            if key != exact {
                tell(Part::Difference(key));
                at += 1;
                continue;
            }
            let begin = at;
            let is_exact = |key: &S::Key| S::parts(*key).1 == 0;
            let rest = &self.keys[at..];
            // Most runs are short; long ones are looked at block by block.
            at += rest.iter().take(BLOCK).position(|key| !is_exact(key)).unwrap_or(BLOCK.min(rest.len()));
            if at - begin == BLOCK {
                let blocks = self.keys[at..].chunks_exact(BLOCK);
                let is_whole = |block: &&[S::Key]| block.iter().fold(true, |all, key| all & is_exact(key));
                at += BLOCK * blocks.take_while(is_whole).count();
                let rest = &self.keys[at..];
                at += rest.iter().position(|key| !is_exact(key)).unwrap_or(rest.len());
            }
            tell(Part::Run(at - begin));
        }
    }
}

/// The symbol of difference 0.
fn first_of(context: usize) -> usize {
    if context == 0 { RUNS } else { 0 }
}

/// Room for the codes of a plane that is read.
pub(super) struct Tables([[Entry; ENTRIES]; CONTEXTS_POWER]);

impl Tables {
    pub(super) fn new() -> Box<Self> {
        Box::new(Self([[Entry::default(); ENTRIES]; CONTEXTS_POWER]))
    }

    /// Fills `plane`, whole rows of `columns`, with what was packed.
    pub(super) fn unpack<S: Sample>(
        &mut self,
        plane: &mut [S],
        columns: usize,
        reader: &mut BitReader<'_>,
    ) -> Result<(), String> {
        for (context, table) in self.0[..CONTEXTS].iter_mut().enumerate() {
            code::read(reader, context == 0, table)?;
        }
        // Exact predictions that were announced and have not come.
        let mut run = 0;
        let (first, mut rest) = plane.split_at_mut(columns.min(plane.len()));
        // Nothing is above the first row but what is to the left.
        let mut left = S::default();
        for to in &mut *first {
            *to = self.sample(left, left, left, &mut run, reader)?;
            left = *to;
        }
        let mut before = &*first;
        while !rest.is_empty() {
            let (row, below) = rest.split_at_mut(columns.min(rest.len()));
            let mut left = before[0];
            let mut corner = left;
            for (to, &above) in row.iter_mut().zip(before) {
                *to = self.sample(left, above, corner, &mut run, reader)?;
                (left, corner) = (*to, above);
            }
            reader.check()?;
            (before, rest) = (row, below);
        }
        if run > 0 {
            return Err(format!("a packed plane with {run} samples too many"));
        }
        reader.align()
    }

    /// The next sample.
    #[inline(always)]
    fn sample<S: Sample>(
        &self,
        left: S,
        above: S,
        corner: S,
        run: &mut u32,
        reader: &mut BitReader<'_>,
    ) -> Result<S, String> {
        let (guess, context) = S::predict(left, above, corner);
        if *run > 0 {
            *run -= 1;
            return Ok(guess);
        }
        let bits = reader.peek();
        let entry = self.0[usize::from(context) % CONTEXTS_POWER][bits as usize % ENTRIES];
        if entry.length() == 0 {
            return Err("a packed plane with bits that are no code".into());
        }
        let number = entry.number(bits >> entry.length());
        reader.skip(entry.length() + entry.bits());
        if entry.is_run() {
            *run = number - 1;
            return Ok(guess);
        }
        Ok(S::unfold(number, guess))
    }
}
