//! Rays, and where they cross triangles.
//!
//! **The test.** Vertices are taken relative to the ray's origin and projected along the ray onto two axes across it. The ray
//! crosses the triangle where the origin lies on one side of all three projected edges. A projected vertex depends on the ray and
//! the vertex alone, so that all triangles around it see the same two numbers. Of `p_x q_y - q_x p_y` the sign is exact: rounding is
//! monotone, so that the difference of rounded products can only come out as 0 where it should not, and what is not on both sides by
//! it is computed again with the products' errors. Edges belong to their triangles. So between triangles that share their
//! vertices' positions no ray passes, at edges and at vertices.
//!
//! **How far off.** With `u` = 2^-53, a difference is off by `u`, an axis by at most 6 `u` a component and a product of three terms by
//! 3 `u`: a projected vertex by at most `sqrt(3) (1 + 6 + 3) u < 18 u` of its distance from the origin, along each of the three axes.
//! The weights are right to a few `u` for the projected vertices, however thin the triangle looks from here, and the distance is a
//! mean of those of the vertices. [`PLACE_ERROR`] bounds all of it: the hit is a point of the triangle that near to the ray.

use glam::DVec3;

/// 2^-48: how far from a ray, in units of the vertices' distance from its origin, a triangle may pass that it is said to cross, and by
/// how much the place along the ray of a triangle that it meets head on may be wrong before it is rounded.
pub(crate) const PLACE_ERROR: f64 = 1.0 / (1u64 << 48) as f64;

/// 2^-39: more than a distance is changed by [`rounded`], 2^-41 of it either way.
pub(crate) const ROUNDING: f64 = 1.0 / (1u64 << 39) as f64;

/// A ray with the axes that its test projects onto.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub origin: DVec3,
    /// Unit.
    pub direction: DVec3,
    across: DVec3,
    down: DVec3,
}

/// Where a ray crosses a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Distance from the ray's origin, rounded to 40 bits.
    pub t: f64,
    /// Place in the flattened scene.
    pub id: u32,
    /// Weights of the corners; they sum to 1.
    pub weights: [f64; 3],
}

/// Where the hits of a ray begin: behind `(t, id)` in the order of distances and ids, without the triangle that the ray leaves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub t: f64,
    pub id: u32,
    pub leaves: u32,
}

impl Ray {
    /// `direction` must be a unit vector.
    pub(crate) fn new(origin: DVec3, direction: DVec3) -> Self {
        // The axis of the smallest component is at least 54 degrees away: the cross product is at least sqrt(2/3) long.
        let [x, y, z] = direction.abs().to_array();
        let axis = if x <= y && x <= z {
            DVec3::X
        } else if y <= z {
            DVec3::Y
        } else {
            DVec3::Z
        };
        let across = direction.cross(axis).normalize();
        Self { origin, direction, across, down: direction.cross(across) }
    }

    /// The crossing with the triangle of these corners, wherever on the ray's line it lies. A triangle that is seen edge-on, has no
    /// area or a coordinate that is no number is missed.
    pub(crate) fn crosses(&self, corners: &[DVec3; 3], id: u32) -> Option<Hit> {
        // Project the corners along the ray.
        let place = |corner: DVec3| {
            let from_origin = corner - self.origin;
            [self.across.dot(from_origin), self.down.dot(from_origin), self.direction.dot(from_origin)]
        };
        let [a, b, c] = [place(corners[0]), place(corners[1]), place(corners[2])];

        // Find on which side of each edge the ray passes, exactly where it is not clear.
        let are_on_both_sides =
            |areas: &[f64; 3]| areas.iter().any(|&area| area < 0.0) && areas.iter().any(|&area| area > 0.0);
        let side = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - q[0] * p[1];
        if are_on_both_sides(&[side(b, c), side(c, a), side(a, b)]) {
            return None;
        }
        let side = |p: [f64; 3], q: [f64; 3]| difference_of_products(p[0], q[1], q[0], p[1]);
        let areas = [side(b, c), side(c, a), side(a, b)];
        let sum = areas[0] + areas[1] + areas[2];
        if are_on_both_sides(&areas) || sum == 0.0 || !sum.is_finite() {
            return None;
        }

        // Weigh the corners' places along the ray.
        let weights = areas.map(|area| area / sum);
        let t = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2];
        t.is_finite().then(|| Hit { t: rounded(t), id, weights })
    }
}

impl Hit {
    /// Whether it comes before `other` in the order of distances and ids.
    pub(crate) fn precedes(&self, other: &Self) -> bool {
        self.t < other.t || (self.t == other.t && self.id < other.id)
    }
}

impl Start {
    /// The eye of a camera.
    pub(crate) const EYE: Self = Self { t: 0.0, id: u32::MAX, leaves: u32::MAX };

    /// Whether `hit` lies behind it.
    pub(crate) fn admits(&self, hit: &Hit) -> bool {
        hit.id != self.leaves && (self.t < hit.t || (self.t == hit.t && self.id < hit.id))
    }
}

/// `a b - c d` to 2 `u` of itself, with the right sign: the products' errors are exact (Dekker 1971), and a difference of products that
/// are within a factor of two of each other is exact too (Sterbenz).
fn difference_of_products(a: f64, b: f64, c: f64, d: f64) -> f64 {
    let (first, first_error) = product(a, b);
    let (second, second_error) = product(c, d);
    (first - second) + (first_error - second_error)
}

/// `a b` rounded, and what was rounded off.
fn product(a: f64, b: f64) -> (f64, f64) {
    // Halves of 26 bits (Veltkamp), whose products are exact.
    let halves = |x: f64| {
        let shifted = x * f64::from((1 << 27) + 1);
        let high = shifted - (shifted - x);
        (high, x - high)
    };
    let ((a_high, a_low), (b_high, b_low)) = (halves(a), halves(b));
    let rounded = a * b;
    (rounded, ((a_high * b_high - rounded) + a_high * b_low + a_low * b_high) + a_low * b_low)
}

/// `t` to the nearest number of 40 bits behind its first.
fn rounded(t: f64) -> f64 {
    const DROPPED: u32 = 52 - 40;
    f64::from_bits((t.to_bits() + (1 << (DROPPED - 1))) >> DROPPED << DROPPED)
}

/// The side on which the corners run counter-clockwise, a unit vector; none for a triangle without area.
pub(crate) fn normal(corners: &[DVec3; 3]) -> Option<DVec3> {
    (corners[1] - corners[0]).cross(corners[2] - corners[0]).try_normalize()
}
