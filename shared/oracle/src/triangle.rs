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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::soup::{Random, sphere};

    #[test]
    fn a_difference_of_products_has_the_sign_of_the_exact_one() {
        let mut random = Random(7);
        for _ in 0..100_000 {
            // Whole numbers, so that i128 knows the truth; c d is next to a b.
            let mut whole = || (random.unit() * libm::exp2(52.0)).floor();
            let (a, b) = (whole(), whole());
            let (c, d) = (a + (whole() % 3.0) - 1.0, b + (whole() % 3.0) - 1.0);
            let exact = a as i128 * b as i128 - c as i128 * d as i128;
            let found = difference_of_products(a, b, c, d);
            assert_eq!(
                found.partial_cmp(&0.0),
                exact.partial_cmp(&0),
                "{a} {b} {c} {d}: {found} for {exact}"
            );
            assert!(
                (found - exact as f64).abs() <= (exact as f64).abs() * libm::exp2(-50.0),
                "{found} for {exact}"
            );
        }
    }

    #[test]
    fn no_ray_leaves_a_closed_surface_at_edges_and_vertices() {
        let mut random = Random(3);
        for scale in [1e-20, 1.0, 1e20] {
            let triangles: Vec<_> = sphere(12).iter().map(|t| t.map(|corner| corner * scale)).collect();
            for k in 0..4000 {
                let origin = random.vector() * (0.3 * scale);
                let corners = triangles[k % triangles.len()];
                let share = if k % 2 == 0 { 0.0 } else { random.unit() };
                let target = corners[0] + (corners[1] - corners[0]) * share;
                let ray = Ray::new(origin, (target - origin).normalize());
                let hits =
                    triangles.iter().filter_map(|corners| ray.crosses(corners, 0)).filter(|hit| hit.t > 0.0);
                let expected = (target - origin).length();
                let nearest = hits.map(|hit| (hit.t - expected).abs()).fold(f64::INFINITY, f64::min);
                // The target is rounded to 2^-52 of the sphere; a slanting triangle is met up to a few times that away.
                assert!(nearest <= expected * ROUNDING, "scale {scale}, ray {k}: {nearest} off {expected}");
            }
        }
    }

    #[test]
    fn a_flat_view_of_a_large_triangle_keeps_its_distance() {
        // A floor at y = -1, seen from the origin at a slope of 1e-5 in a direction that is on no axis.
        let far = 3e5;
        let floor = [[-far, -1.0, -far], [0.0, -1.0, far], [far, -1.0, -far]].map(DVec3::from_array);
        let slope = 1e-5;
        let direction = DVec3::new(0.3, -slope, 0.4).normalize();
        let hit = Ray::new(DVec3::ZERO, direction).crosses(&floor, 4).expect("it is there");
        let expected = 1.0 / -direction.y;
        // The place error at the farthest corner, over the sine.
        let bound = PLACE_ERROR * far * 2.0 / -direction.y + expected * ROUNDING;
        assert!((hit.t - expected).abs() <= bound, "{} for {expected}, bound {bound}", hit.t);
    }

    #[test]
    fn what_cannot_be_met_is_missed() {
        let ray = Ray::new(DVec3::ZERO, DVec3::Z);
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        assert_eq!(
            ray.crosses(&[at(-1.0, 0.0, 1.0), at(1.0, 0.0, 1.0), at(0.0, 0.0, 3.0)], 0),
            None,
            "edge-on"
        );
        assert_eq!(ray.crosses(&[at(0.0, 0.0, 1.0); 3], 0), None, "a point");
        assert_eq!(ray.crosses(&[at(-1.0, -1.0, f64::NAN), at(1.0, -1.0, 1.0), at(0.0, 1.0, 1.0)], 0), None);
        let hit =
            ray.crosses(&[at(-1.0, -1.0, 2.0), at(1.0, -1.0, 2.0), at(0.0, 1.0, 2.0)], 9).expect("a hit");
        assert_eq!((hit.t, hit.id), (2.0, 9));
        assert_eq!(hit.weights, [0.25, 0.25, 0.5]);
    }
}
