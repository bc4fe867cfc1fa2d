//! 16-bit normals: [`NormalCode`], and the optimised spherical grid of Smith, Petrova, Schaefer 2012 ("Encoding normal vectors using
//! optimized spherical coordinates", Computers & Graphics 36). The other code is in [`crate::oct`].
//!
//! 227 rings at equal polar steps around the z axis, each with its own number of equally spaced azimuths, chosen so that no
//! direction is farther than `BOUND_RADIANS` = 0.0098165 from an entry. Two departures from the paper:
//! - the budget is 65,535 entries instead of 65,536, so that [`NO_NORMAL`] can mean 'none';
//! - the equator ring has 456 entries instead of 454, a multiple of 4, so that all six axes are entries, and they are stored
//!   exactly. Without it +y and -y would be 0.396 degrees off, which tilts every mirror floor of a y-up scene.
//!
//! 65,534 entries, 786,408 bytes, a constant function of nothing: the table is built once per process and never stored.

use crate::oct;
use std::f64::consts::PI;
use std::sync::OnceLock;
use tessera_geometry::mutation::{Mutation, unless};

/// The code that means 'no normal here'.
pub const NO_NORMAL: u16 = 0xFFFF;
/// Entries of the table; codes are below this, or [`NO_NORMAL`].
pub const ENTRIES: usize = 65_534;
/// Largest angle between a unit vector and the entry that encodes it: 0.56245 degrees.
///
/// The smallest bound whose entries fit the budget is 0.009816308 rad; this value lies in the middle of the range that gives
/// the same counts, so that no entry count hangs on the last bit of an arc cosine.
pub(crate) const BOUND_RADIANS: f64 = 0.009_816_5;

const RINGS: usize = 227;
const EQUATOR: usize = RINGS / 2;
const EQUATOR_ENTRIES: usize = 456;
/// Polar step between rings.
const RING_STEP: f64 = PI / (RINGS - 1) as f64;

/// How a shading normal is kept in 16 bits. Under both [`NO_NORMAL`] means that there is none, and the six axes are exact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum NormalCode {
    /// [`NormalTable`]: 65,534 directions spread evenly; whoever decodes needs a table of 768 KiB.
    #[default]
    Smith,
    /// [`crate::oct`]: an octahedral lattice of 255 x 255; decoded by a root and three quotients.
    Oct,
}

impl NormalCode {
    /// For people and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Smith => "smith",
            Self::Oct => "oct",
        }
    }

    /// Largest angle in radians between a direction and what its code decodes to: 0.5625 degrees (Smith), 0.6380 degrees (Oct).
    pub const fn bound_radians(self) -> f64 {
        match self {
            Self::Smith => BOUND_RADIANS,
            Self::Oct => oct::BOUND_RADIANS,
        }
    }

    /// Code of `normal` (any length); [`NO_NORMAL`] when it has no [`direction`].
    pub fn encode(self, normal: [f32; 3]) -> u16 {
        match self {
            Self::Smith => NormalTable::get().encode(normal),
            Self::Oct => oct::encode(normal),
        }
    }

    /// Whether an encoder may write `code`.
    pub fn is_code(self, code: u16) -> bool {
        match self {
            Self::Smith => code == NO_NORMAL || usize::from(code) < ENTRIES,
            Self::Oct => oct::is_code(code),
        }
    }
}

/// The table of unit vectors.
#[derive(Debug)]
pub struct NormalTable {
    entries: Vec<[f32; 3]>,
    /// First code of each ring, and the number of entries at the end.
    first: [usize; RINGS + 1],
}

impl NormalTable {
    /// The table; built on first use (a few milliseconds).
    pub fn get() -> &'static Self {
        static TABLE: OnceLock<NormalTable> = OnceLock::new();
        TABLE.get_or_init(Self::build)
    }

    /// Unit vectors by code.
    pub fn entries(&self) -> &[[f32; 3]] {
        &self.entries
    }

    /// Code of the entry nearest to `normal` (any length); of equally near ones the smallest. [`NO_NORMAL`] when `normal` has
    /// no [`direction`].
    pub fn encode(&self, normal: [f32; 3]) -> u16 {
        let Some([x, y, z]) = direction(normal) else {
            return NO_NORMAL;
        };
        // atan2 instead of acos(z): acos loses accuracy at the poles.
        let polar = libm::atan2((x * x + y * y).sqrt(), z);
        let azimuth = libm::atan2(y, x);
        let turns = if azimuth < 0.0 { azimuth / (2.0 * PI) + 1.0 } else { azimuth / (2.0 * PI) };
        let ring = ((polar / RING_STEP).round() as usize).min(RINGS - 1);
        // Rounding alone picks the wrong ring for 4 % of all directions: compare the nearest entries of three rings.
        let mut best = (f64::NEG_INFINITY, 0);
        for j in ring.saturating_sub(1)..=(ring + 1).min(RINGS - 1) {
            let count = self.first[j + 1] - self.first[j];
            let code = self.first[j] + (turns * count as f64).round() as usize % count;
            let [ex, ey, ez] = self.entries[code].map(f64::from);
            let cosine = x * ex + y * ey + z * ez;
            if cosine > best.0 {
                best = (cosine, code);
            }
        }
        unless(Mutation::NormalNext, best.1, best.1 + 1) as u16
    }

    /// The unit vector of `code`; `None` for [`NO_NORMAL`] (and for 0xFFFE, which no encoder writes).
    pub fn decode(&self, code: u16) -> Option<[f32; 3]> {
        self.entries.get(usize::from(code)).copied()
    }

    fn build() -> Self {
        let mut entries = Vec::with_capacity(ENTRIES);
        let mut first = [0; RINGS + 1];
        for ring in 0..RINGS {
            let count = ring_entries(ring);
            let polar = ring as f64 * RING_STEP;
            let (sin_polar, cos_polar) =
                if ring == EQUATOR { (1.0, 0.0) } else { (libm::sin(polar), libm::cos(polar)) };
            for k in 0..count {
                entries.push(match (ring, k * 4 / count, k * 4 % count) {
                    (0, ..) => [0.0, 0.0, 1.0],
                    (r, ..) if r == RINGS - 1 => [0.0, 0.0, -1.0],
                    (EQUATOR, quarter, 0) => {
                        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]][quarter]
                    }
                    _ => {
                        let azimuth = 2.0 * PI * k as f64 / count as f64;
                        [sin_polar * libm::cos(azimuth), sin_polar * libm::sin(azimuth), cos_polar]
                            .map(|c| c as f32)
                    }
                });
            }
            first[ring + 1] = entries.len();
        }
        Self { entries, first }
    }
}

/// The unit vector along `normal`; `None` when it has no direction: zero, NaN or infinite.
pub fn direction(normal: [f32; 3]) -> Option<[f64; 3]> {
    let n = normal.map(f64::from);
    // f64 holds the squares of every f32: no overflow, and zero only for a zero vector.
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    (length > 0.0 && length.is_finite()).then(|| n.map(|c| c / length))
}

/// Entries of a ring: as few as keep the corner of a cell (half a ring step towards the equator, half an azimuth step aside)
/// within [`BOUND_RADIANS`] of its entry. Smith et al. 2012, equation for `N_theta`.
fn ring_entries(ring: usize) -> usize {
    let ring = ring.min(RINGS - 1 - ring);
    if ring == 0 {
        return 1;
    }
    if ring == EQUATOR {
        return EQUATOR_ENTRIES;
    }
    let polar = ring as f64 * RING_STEP;
    let corner = polar + RING_STEP / 2.0;
    let cosine = (libm::cos(BOUND_RADIANS) - libm::cos(polar) * libm::cos(corner))
        / (libm::sin(polar) * libm::sin(corner));
    if cosine < -1.0 { 1 } else { (PI / libm::acos(cosine)).ceil() as usize }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    #[test]
    fn ring_counts_are_the_papers_but_for_the_equator() {
        let counts: Vec<usize> = (0..RINGS).map(ring_entries).collect();
        assert_eq!(counts[..8], [1, 8, 15, 21, 27, 33, 40, 46]);
        assert_eq!((counts[EQUATOR - 1], counts[EQUATOR], counts[EQUATOR + 1]), (454, 456, 454));
        assert!((0..RINGS).all(|j| counts[j] == counts[RINGS - 1 - j]));
        assert_eq!(counts.iter().sum::<usize>(), ENTRIES);
        assert_eq!(NormalTable::get().entries().len(), ENTRIES);
    }

    #[test]
    fn every_entry_encodes_to_itself_and_is_of_unit_length() {
        let table = NormalTable::get();
        for (code, &n) in table.entries().iter().enumerate() {
            assert_eq!(usize::from(table.encode(n)), code);
            let length: f64 = n.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
            // Each component is within half an ulp (2^-25 for values in [0.5, 1)) of the exact one.
            assert!(
                (length - 1.0).abs() < 3.0f64.sqrt() * 2.0f64.recip() * f64::from(f32::EPSILON),
                "{code}: {length}"
            );
        }
    }

    #[test]
    fn axes_are_exact() {
        let table = NormalTable::get();
        for k in 0..3 {
            for sign in [1.0, -1.0] {
                let mut axis = [0.0f32; 3];
                axis[k] = sign;
                assert_eq!(table.decode(table.encode(axis)), Some(axis));
                assert_eq!(table.decode(table.encode(axis.map(|c| c * 1e-30))), Some(axis));
            }
        }
    }

    #[test]
    fn directions_decode_within_the_bound_and_to_the_nearest_entry() {
        let table = NormalTable::get();
        let mut worst = 0.0f64;
        let mut sum = 0.0;
        const DIRECTIONS: u32 = 200_000;
        for (i, n) in spiral(DIRECTIONS).enumerate() {
            let angle = angle(n, table.decode(table.encode(n)).expect("a direction has a code"));
            worst = worst.max(angle);
            sum += angle;
            if i % 2003 == 0 {
                let nearest = table.entries().iter().map(|&e| dot(n, e)).fold(f64::MIN, f64::max);
                assert_eq!(dot(n, table.entries()[usize::from(table.encode(n))]), nearest, "{n:?}");
            }
        }
        assert!(worst <= BOUND_RADIANS, "largest error {} degrees", worst.to_degrees());
        let mean = (sum / f64::from(DIRECTIONS)).to_degrees();
        // Measured for this table over 4 million random directions: 0.3018 degrees.
        assert!((mean - 0.3018).abs() < 0.001, "mean error {mean} degrees");
    }

    #[test]
    fn no_direction_has_no_code() {
        let table = NormalTable::get();
        for n in [[0.0; 3], [-0.0; 3], [f32::NAN, 0.0, 1.0], [0.0, f32::INFINITY, 1.0]] {
            assert_eq!(table.encode(n), NO_NORMAL);
        }
        assert_eq!(table.decode(NO_NORMAL), None);
        assert_eq!(table.decode(0xFFFE), None);
        assert_ne!(table.encode([f32::MAX; 3]), NO_NORMAL);
        assert_ne!(table.encode([f32::from_bits(1), 0.0, 0.0]), NO_NORMAL);
    }

    /// Directions that cover the sphere evenly: a Fibonacci spiral, whose golden angle never repeats an azimuth.
    pub(crate) fn spiral(count: u32) -> impl Iterator<Item = [f32; 3]> {
        (0..count).map(move |i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let azimuth = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            [r * libm::cos(azimuth), r * libm::sin(azimuth), z].map(|c| c as f32)
        })
    }

    fn dot(a: [f32; 3], b: [f32; 3]) -> f64 {
        (0..3).map(|k| f64::from(a[k]) * f64::from(b[k])).sum()
    }

    /// Angle from the cross product: an arc cosine near 1 would lose half the digits.
    pub(crate) fn angle(a: [f32; 3], b: [f32; 3]) -> f64 {
        let [a, b] = [a, b].map(|v| v.map(f64::from));
        let c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let sine = (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]).sqrt();
        libm::atan2(sine, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    }
}
