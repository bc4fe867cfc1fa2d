//! Whether packing tiles is worth its time. Pure: what was measured in frames before goes in, how the next one's pixels travel comes out.

use crate::TileRecord;
use std::time::Duration;
use tessera_wire::Coding;

/// What is known of links, and of packing.
///
/// Of a byte of pixels, packing saves the time that the link needs for what does not travel, and costs the time of packing and unpacking:
///
/// ```text
/// (1 - ratio) / bytes a second   against   packing + unpacking, in seconds a byte
/// ```
///
/// The costs are counted in full, though rendering and other workers may hide them, and so may the link's time be hidden: where neither is, the
/// sums decide; where both are, it does not matter. A link seems faster than it is that has delivered before it was asked, or takes a few small
/// tiles at a time at once, and would not take all of them raw. Only frames that travel raw show that, and cost several times as much where it
/// is so: it is tried when several frames agree, and ever more rarely when it was wrong.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CodingChoice {
    /// Seconds a byte on the wire.
    link: Option<f64>,
    packing: Option<Packing>,
    last: Option<Coding>,
    /// Frames in a row that something else would have suited better.
    agreed: u32,
    /// Frames in a row that have travelled raw.
    raw: u32,
    /// Times that pixels travelled raw, and that was soon found to be wrong.
    mistakes: u32,
}

/// What packing was like when it was last done.
#[derive(Clone, Copy, Debug)]
struct Packing {
    /// Bytes on the wire of each byte of pixels.
    ratio: f64,
    /// Seconds of both sides for each byte of pixels.
    cost: f64,
}

/// What a frame has shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Shown {
    /// Bytes of tiles that came over links, and the time that they were waited for.
    pub(crate) arrival: (u64, Duration),
    /// Bytes of pixels that were unpacked, and the time that it took.
    pub(crate) unpacking: (u64, Duration),
    /// Bytes of pixels that workers have tried to pack, what became of them, and the time that it took.
    pub(crate) packing: (u64, u64, Duration),
}

impl Shown {
    /// What tiles say of packing.
    pub(crate) fn of_tiles(tiles: &[TileRecord]) -> (u64, u64, Duration) {
        let tried = tiles.iter().filter(|tile| !tile.coding.is_zero());
        tried.fold((0, 0, Duration::ZERO), |(pixels, wire, time), tile| {
            (pixels + u64::from(tile.pixel_bytes), wire + tile.wire_bytes, time + tile.coding)
        })
    }
}

impl CodingChoice {
    /// Bytes of less than this say more of the scheduler than of a link.
    const TELLING_BYTES: u64 = 64 << 10;

    /// What is chosen must be better by so much than what was chosen before, or two that are about as good would alternate.
    const BETTER: f64 = 1.25;

    /// So many frames in a row must have been better raw before one is,
    const AGREED: u32 = 2;

    /// and four times as many after each time that that was wrong, up to 2 to this power.
    const RARELY: u32 = 8;

    /// That many raw frames are soon.
    const SOON: u32 = 4;

    /// How the next frame's pixels travel, where that is left to us: raw within this process, packed as long as nothing is known.
    pub(crate) fn choose(&mut self, is_remote: bool) -> Coding {
        if !is_remote {
            return Coding::Raw;
        }
        let coding = match (self.link, self.packing) {
            (Some(link), Some(Packing { ratio, cost })) => {
                let saved = link * (1.0 - ratio).max(0.0);
                let is_raw = self.last == Some(Coding::Raw);
                let is_better =
                    if is_raw { saved > Self::BETTER * cost } else { cost > Self::BETTER * saved };
                self.agreed = if is_better { self.agreed + 1 } else { 0 };
                match (is_raw, is_better) {
                    (true, true) => {
                        // (After more frames it is the link that has changed.)
                        self.mistakes += u32::from(self.raw <= Self::SOON);
                        (self.agreed, self.raw) = (0, 0);
                        Coding::Lossless
                    }
                    (true, false) => Coding::Raw,
                    (false, _) if self.agreed >= Self::AGREED << (2 * self.mistakes).min(Self::RARELY) => {
                        self.agreed = 0;
                        Coding::Raw
                    }
                    (false, _) => Coding::Lossless,
                }
            }
            _ => Coding::Lossless,
        };
        self.raw += u32::from(coding == Coding::Raw);
        self.last = Some(coding);
        coding
    }

    /// A frame has shown this.
    pub(crate) fn learn(&mut self, shown: &Shown) {
        let each = |bytes: u64, time: Duration| {
            (bytes >= Self::TELLING_BYTES).then(|| time.as_secs_f64() / bytes as f64)
        };
        // Links change; half of what is known is the last frame's.
        let mixed = |before: Option<f64>, now: f64| before.map_or(now, |before| 0.5 * (before + now));
        let (bytes, time) = shown.arrival;
        if let Some(link) = each(bytes, time) {
            self.link = Some(mixed(self.link, link));
        }
        let (pixels, wire, time) = shown.packing;
        let unpacking = each(shown.unpacking.0, shown.unpacking.1);
        if let Some(packing) = each(pixels, time) {
            let cost = packing + unpacking.unwrap_or(0.0);
            let before = self.packing;
            self.packing = Some(Packing {
                ratio: mixed(before.map(|b| b.ratio), wire as f64 / pixels as f64),
                cost: mixed(before.map(|b| b.cost), cost),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEGABYTE: u64 = 1 << 20;

    /// A frame of 4 MiB over a link of `rate` MiB a second, packed to a third at 5 ms a MiB on each side where it is packed.
    fn shown(coding: Coding, rate: f64) -> Shown {
        let packed = coding != Coding::Raw;
        let wire = if packed { 4 * MEGABYTE / 3 } else { 4 * MEGABYTE };
        let time = Duration::from_secs_f64(wire as f64 / MEGABYTE as f64 / rate);
        let (pixels, effort) =
            if packed { (4 * MEGABYTE, Duration::from_millis(20)) } else { (0, Duration::ZERO) };
        Shown { arrival: (wire, time), unpacking: (pixels, effort), packing: (pixels, wire, effort) }
    }

    /// What is chosen in the end, over a link of `rate` MiB a second.
    fn settled(choice: &mut CodingChoice, rate: f64) -> Coding {
        for _ in 0..8 {
            let coding = choice.choose(true);
            choice.learn(&shown(coding, rate));
        }
        choice.choose(true)
    }

    #[test]
    fn slow_links_are_worth_packing_and_fast_ones_are_not() {
        assert_eq!(CodingChoice::default().choose(true), Coding::Lossless);
        assert_eq!(CodingChoice::default().choose(false), Coding::Raw);
        // It pays up to (1 - 1/3) / 10 ms = 67 MiB a second.
        for (rate, coding) in
            [(1.0, Coding::Lossless), (40.0, Coding::Lossless), (100.0, Coding::Raw), (1e4, Coding::Raw)]
        {
            assert_eq!(settled(&mut CodingChoice::default(), rate), coding, "{rate}");
        }
    }

    #[test]
    fn a_link_that_changes_is_found_out_and_one_at_the_border_makes_no_difference() {
        let mut choice = CodingChoice::default();
        assert_eq!(settled(&mut choice, 1e3), Coding::Raw);
        assert_eq!(settled(&mut choice, 5.0), Coding::Lossless);
        assert_eq!(settled(&mut choice, 1e3), Coding::Raw);
        for rate in [60.0, 67.0, 75.0] {
            let mut choice = CodingChoice::default();
            let first = settled(&mut choice, rate);
            assert_eq!(settled(&mut choice, rate), first, "{rate}");
        }
    }

    #[test]
    fn a_link_that_seems_fast_until_much_is_sent_is_tried_ever_more_rarely() {
        let mut choice = CodingChoice::default();
        let mut raw = Vec::new();
        for frame in 0..500 {
            let coding = choice.choose(true);
            let rate = if coding == Coding::Raw { 5.0 } else { 1e3 };
            choice.learn(&shown(coding, rate));
            if coding == Coding::Raw {
                raw.push(frame);
            }
        }
        assert!((3..10).contains(&raw.len()), "{raw:?}");
        assert!(raw.last() > Some(&100), "it is tried again some time: {raw:?}");
    }

    #[test]
    fn little_tells_nothing() {
        let mut choice = CodingChoice::default();
        choice.learn(&Shown { arrival: (100, Duration::from_secs(1)), ..Shown::default() });
        assert_eq!(choice.choose(true), Coding::Lossless);
        assert!(choice.link.is_none());
    }
}
