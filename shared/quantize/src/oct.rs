//! 16-bit normals without a table: octahedral coordinates, two signed bytes (Meyer et al. 2010, "On floating-point normal vectors";
//! oct16P of Cigolle et al. 2014, "A survey of efficient representations for independent unit vectors").
//!
//! A direction is scaled onto the octahedron |x| + |y| + |z| = 1, whose lower half is folded outwards over the edges of the upper
//! one, so that x and y alone name a point of the square [-1, 1]^2; each is kept in units of 1/127. All six axes are exact.
//!
//! Of the four nearest points of that lattice the encoder takes the one whose direction is nearest. The largest error is
//! `atan(sqrt(2) / 127)` = 0.6380 degrees: the lattice cuts every face of the octahedron into equilateral triangles of side
//! `sqrt(2) / 127`; seen from the centre they are largest in the middle of a face, at a distance of `1 / sqrt(3)`; there one lies with its own
//! middle in that of the face, along (1, 1, 1), and a triangle's middle is `side / sqrt(3)` away from its corners. (Samples that miss
//! that direction show less: 0.635 degrees over 4 million random ones.)
//!
//! The bytes are kept with an excess of 127, as 0..=254, and not in two's complement, where (-1/127, -1/127) would be 0xFFFF and so
//! [`NO_NORMAL`]. A byte of 255 thus occurs in no other code than that.

use crate::normal::{NO_NORMAL, direction};

/// The code's text for GPUs.
pub const WGSL: &str = include_str!("oct.wgsl");

/// Units of 1.
const UNITS: i32 = 127;

/// Largest angle between a direction and what its code decodes to: `atan(sqrt(2) / 127)`, rounded up.
pub(crate) const BOUND_RADIANS: f64 = 0.011_135_08;

/// Code of `normal` (any length): of the four lattice points around it, the one with the nearest direction; of equally near ones the
/// smallest code. [`NO_NORMAL`] when `normal` has no [`direction`].
pub fn encode(normal: [f32; 3]) -> u16 {
    let Some(direction) = direction(normal) else {
        return NO_NORMAL;
    };
    let sum = direction.iter().map(|c| c.abs()).sum::<f64>();
    let [x, y, z] = direction.map(|c| c / sum);
    let sign = |c: f64| if c >= 0.0 { 1.0 } else { -1.0 };
    let square = if z >= 0.0 { [x, y] } else { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] };
    let [low_x, low_y] = square.map(|c| (c * f64::from(UNITS)).floor() as i32);
    // Sums of whole numbers and of f64: the f32 of a decoded normal would tell near codes apart by rounding.
    let cosine = |code: u16| {
        let [x, y, z] = oct_point(code).map(f64::from);
        (x * direction[0] + y * direction[1] + z * direction[2]) / (x * x + y * y + z * z).sqrt()
    };
    let mut best = (f64::NEG_INFINITY, 0);
    for y in [low_y, low_y + 1] {
        for x in [low_x, low_x + 1] {
            let [low, high] = [x, y].map(|c| (c.clamp(-UNITS, UNITS) + UNITS) as u16);
            let code = low | high << 8;
            let cosine = cosine(code);
            if cosine > best.0 {
                best = (cosine, code);
            }
        }
    }
    best.1
}

/// Whether an encoder may write `code`.
pub fn is_code(code: u16) -> bool {
    let [x, y] = code.to_le_bytes();
    code == NO_NORMAL || (x != 0xFF && y != 0xFF)
}

/// The point of the octahedron |x| + |y| + |z| = 127 that `code` names: x in its low byte, y in the high one.
pub fn oct_point(code: u16) -> [i32; 3] {
    let [x, y] = code.to_le_bytes().map(|byte| i32::from(byte) - UNITS);
    let z = UNITS - x.abs() - y.abs();
    let sign = |c: i32| if c >= 0 { 1 } else { -1 };
    if z >= 0 { [x, y, z] } else { [(UNITS - y.abs()) * sign(x), (UNITS - x.abs()) * sign(y), z] }
}

/// The unit vector of `code`; `None` for [`NO_NORMAL`]. A root and three quotients, each rounded once, so that a device that rounds
/// them correctly has the same bits; the sum under the root is below 2^16 and exact.
#[inline]
pub fn oct_normal(code: u16) -> Option<[f32; 3]> {
    if code == NO_NORMAL {
        return None;
    }
    let [x, y, z] = oct_point(code);
    let length = ((x * x + y * y + z * z) as f32).sqrt();
    Some([x, y, z].map(|c| c as f32 / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::tests::{angle, spiral};

    #[test]
    fn axes_are_exact() {
        for k in 0..3 {
            for sign in [1.0, -1.0] {
                let mut axis = [0.0f32; 3];
                axis[k] = sign;
                assert_eq!(oct_normal(encode(axis)), Some(axis));
                assert_eq!(oct_normal(encode(axis.map(|c| c * 1e-30))), Some(axis));
            }
        }
    }

    #[test]
    fn every_code_decodes_to_a_unit_vector_that_encodes_to_it_or_its_twin() {
        let mut twins = 0;
        for code in (0..u16::MAX).filter(|&code| is_code(code)) {
            let normal = oct_normal(code).expect("a normal");
            let length: f64 = normal.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
            // The quotients and the root are each within 2^-24 of themselves.
            assert!((length - 1.0).abs() <= f64::from(f32::EPSILON), "{code}: {length}");
            let again = encode(normal);
            assert_eq!(oct_point(again), oct_point(code));
            assert_eq!(oct_point(code).iter().map(|c| c.abs()).sum::<i32>(), UNITS);
            twins += u32::from(again != code);
        }
        // Points of the square's border and their mirror images across its middle are one: 127 pairs a side, and four corners.
        assert_eq!(twins, 4 * 127 - 1);
    }

    #[test]
    fn no_direction_has_no_code_and_no_direction_has_that_of_none() {
        for n in [[0.0; 3], [-0.0; 3], [f32::NAN, 0.0, 1.0], [0.0, f32::INFINITY, 1.0]] {
            assert_eq!(encode(n), NO_NORMAL);
        }
        assert_eq!(oct_normal(NO_NORMAL), None);
        // What is 0xFFFF in two's complement is another code here.
        let code = encode([-1.0, -1.0, 125.0]);
        assert_eq!((code, oct_point(code)), (126 | 126 << 8, [-1, -1, 125]));
        assert!(is_code(NO_NORMAL) && is_code(0xFEFE) && !is_code(0xFFFE) && !is_code(0x00FF));
        assert_ne!(encode([f32::MAX; 3]), NO_NORMAL);
        assert_ne!(encode([f32::from_bits(1), 0.0, 0.0]), NO_NORMAL);
    }

    /// Every direction lies in a spherical triangle between lattice points, none of whose points is farther from its nearest corner than the
    /// middle of the circle through all three: the largest such circle is the bound.
    #[test]
    fn no_triangle_of_the_lattice_is_wider_than_the_bound() {
        let unit = |x: i32, y: i32| {
            let [x, y, z] = oct_point((x + UNITS) as u16 | ((y + UNITS) as u16) << 8).map(f64::from);
            let length = (x * x + y * y + z * z).sqrt();
            [x / length, y / length, z / length]
        };
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let length = |a: [f64; 3]| a.iter().map(|c| c * c).sum::<f64>().sqrt();
        let radius = |[a, b, c]: [[f64; 3]; 3]| {
            let edge = |p: [f64; 3]| [0, 1, 2].map(|k| p[k] - a[k]);
            let normal = cross(edge(b), edge(c));
            let cosine = (0..3).map(|k| normal[k] * a[k]).sum::<f64>().abs();
            libm::atan2(length(cross(normal, a)), cosine)
        };
        let mut widest = 0.0f64;
        // One quarter of the square: the others are its mirror images.
        for (x, y) in (0..UNITS).flat_map(|x| (0..UNITS).map(move |y| (x, y))) {
            let [a, b, c, d] = [unit(x, y), unit(x + 1, y), unit(x, y + 1), unit(x + 1, y + 1)];
            // The diagonal along which the square is folded: each half lies in one face.
            widest = widest.max(radius([a, b, c])).max(radius([d, b, c]));
        }
        let bound = libm::atan2(2.0f64.sqrt(), f64::from(UNITS));
        assert!((widest - bound).abs() < 1e-12, "{} degrees", widest.to_degrees());
        assert!(bound <= BOUND_RADIANS && BOUND_RADIANS - bound < 1e-8, "{bound}");
        // It is reached.
        let farthest = angle([1.0; 3], oct_normal(encode([1.0; 3])).expect("a normal"));
        assert!((farthest - bound).abs() < f64::from(f32::EPSILON), "{farthest}");
    }

    #[test]
    fn directions_decode_within_the_bound() {
        const DIRECTIONS: u32 = 200_000;
        let (mut worst, mut sum) = (0.0f64, 0.0);
        for n in spiral(DIRECTIONS) {
            let angle = angle(n, oct_normal(encode(n)).expect("a direction has a code"));
            worst = worst.max(angle);
            sum += angle;
        }
        // The spiral's directions and the decoded ones are rounded to f32.
        assert!(
            worst <= BOUND_RADIANS + f64::from(f32::EPSILON),
            "largest error {} degrees",
            worst.to_degrees()
        );
        let mean = (sum / f64::from(DIRECTIONS)).to_degrees();
        // Measured over 4 million random directions: 0.3147 degrees.
        assert!((mean - 0.3147).abs() < 0.001, "mean error {mean} degrees");
    }
}
