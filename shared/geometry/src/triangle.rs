//! The watertight ray/triangle test (Woop, Benthin, Wald 2013).
//!
//! **Why no ray slips between two triangles.** The test moves the ray to the origin, shears it onto +z and asks on which
//! side of each projected edge the origin lies. The sheared endpoints depend on the ray and the vertex position alone, so
//! both triangles of an edge see the same numbers. `a * b - c * d` of rounded products never has the wrong sign, because
//! rounding is monotone: it can only come out as 0. Then the products are taken in `f64`, where products of two `f32` are
//! exact (48 of 53 bits). Nothing is fused, so the edge function of swapped endpoints is the exact negative, and both triangles
//! come to one verdict. (A device that may fuse products with sums must evaluate each edge on its endpoints in lexicographic
//! order of *position*; by index will not do, because vertices that were split or never welded share a
//! position only.) An edge function of 0 counts as inside: two triangles may both report a shared edge, never neither.
//!
//! **How far off it can be.** Moving and shearing in `f32` shifts a vertex, seen from the ray, by at most [`LATERAL_ERROR`] times
//! its largest coordinate relative to the origin. So the ray that is said to hit passes the triangle within that distance,
//! and [`intersect`] reports the distance `t` of a point *of the triangle* that it passes so closely: a traversal that
//! visits every cell within the bound finds every hit, and finds it before it may stop.

use crate::mutation::{Mutation, is_on};
use crate::rounding::{UNIT_ROUNDOFF, gamma};
use crate::{DVec3, Ray, Vec3};

/// The part of the test that depends on the ray alone: a permutation of the axes and a shear that take the ray to +z.
#[derive(Clone, Copy, Debug)]
pub struct RayShear {
    /// Axis permutation `[kx, ky, kz]`, a rotation: `kz` is the direction's largest component.
    k: [usize; 3],
    /// `direction[kx] / direction[kz]`, in [-1, 1].
    x: f32,
    /// `direction[ky] / direction[kz]`, in [-1, 1].
    y: f32,
    /// `1 / direction[kz]`.
    per_depth: f32,
}

impl RayShear {
    /// Prepares `ray`, which must be traceable ([`Ray::is_traceable`]).
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let a = d.map(f32::abs);
        let kz = if a[0] >= a[1] && a[0] >= a[2] {
            0
        } else if a[1] >= a[2] {
            1
        } else {
            2
        };
        // Woop, Benthin and Wald swap the other two axes where the direction points down kz, to keep the winding. Neither
        // verdict nor quotients of edge functions depend on that.
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        Self { k: [kx, ky, kz], x: d[kx] / d[kz], y: d[ky] / d[kz], per_depth: d[kz].recip() }
    }
}

/// How far from the ray the point of a triangle that it is said to hit may lie, in units of the largest component of a vertex
/// relative to the ray's origin, along each of the two axes across the direction's main one.
///
/// With `u` the unit roundoff and `p` the exact difference of vertex and origin, `fl(p_x - fl(s p_z))` is off by
/// `u |p_x|` for each of one difference and the last one, and by `u |s p_z|` for each of the shear, the difference, the product
/// and the last difference; `|s| <= 1` makes that six. Some point of the triangle is that near along both axes, so the
/// nearest one is within `sqrt(2)` times six, less than nine.
pub const LATERAL_ERROR: f32 = gamma(9);

/// Where a ray crosses a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Distance in multiples of the ray's direction, rounded once from `f64`.
    pub t: f32,
    /// Weight of vertex 1, in [0, 1].
    pub b1: f32,
    /// Weight of vertex 2, in [0, 1]; `1 - b1 - b2`, the weight of vertex 0, is in [0, 1] too.
    pub b2: f32,
}

/// Where `ray` crosses the triangle, if `ray.t_min < t <= t_max` (inclusive above so that the caller can decide ties by id).
///
/// Edges and vertices belong to the triangle; a triangle seen edge-on is missed. `shear` is [`RayShear::new`] of the same
/// ray. Vertices may be anything; those that are not finite are missed.
#[inline]
pub fn intersect(ray: &Ray, shear: &RayShear, vertices: [Vec3; 3], t_max: f32) -> Option<Crossing> {
    let [kx, ky, kz] = shear.k;

    // Move the ray to the origin and shear it onto +z.
    // (Spelt out: `array::map` is not inlined in this innermost loop.)
    let project = |v: Vec3| {
        let p = (v - ray.origin).to_array();
        [p[kx] - shear.x * p[kz], p[ky] - shear.y * p[kz]]
    };
    let [a, b, c] = [project(vertices[0]), project(vertices[1]), project(vertices[2])];

    // Find on which side of each edge the origin lies. An edge function that is not 0 has the right sign.
    let sides = [edge(c, b), edge(a, c), edge(b, a)];
    if !is_inside(sides) {
        return None;
    }

    // Decide exactly when the origin is too close to an edge for f32.
    let is_close = (sides[0] == 0.0) | (sides[1] == 0.0) | (sides[2] == 0.0);
    if is_close && is_on(Mutation::EdgesExclusive) {
        return None;
    }
    if is_close && !is_on(Mutation::NoExactEdges) {
        let sides = [edge_exact(c, b), edge_exact(a, c), edge_exact(b, a)];
        if !is_inside(sides) || sides == [0.0; 3] {
            return None;
        }
    }

    // Leave out a triangle that lies wholly outside the range: the distance is between those of its vertices.
    let depth = |v: Vec3| (v.to_array()[kz] - ray.origin.to_array()[kz]) * shear.per_depth;
    let (p, q, r) = (depth(vertices[0]), depth(vertices[1]), depth(vertices[2]));
    if p.min(q).min(r) * DEPTH_SHORTER > t_max || p.max(q).max(r) * DEPTH_LONGER < ray.t_min {
        return None;
    }

    // Find the point that the ray passes.
    let crossing = locate(ray, shear.k, vertices)?;
    let is_before_end = crossing.t < t_max || (crossing.t == t_max && !is_on(Mutation::RangeExclusive));
    (crossing.t > ray.t_min && is_before_end).then_some(crossing)
}

/// Factors that carry a depth that was computed in `f32` beyond its error: of the difference, the inverse, their product and the
/// rounding of the reported distance. (A product that underflows comes out as 0 or near it, where no range of a scene ends.)
pub(crate) const DEPTH_SHORTER: f32 = 1.0 - 2.0 * gamma(4);
pub(crate) const DEPTH_LONGER: f32 = 1.0 + 2.0 * gamma(4);

/// Whether three edge functions agree on the side; false when one is NaN. Without branches: neither outcome is the likely one.
#[inline]
fn is_inside<T: PartialOrd + Default>([u, v, w]: [T; 3]) -> bool {
    let zero = T::default();
    ((u >= zero) & (v >= zero) & (w >= zero)) | ((u <= zero) & (v <= zero) & (w <= zero))
}

/// Twice the signed area of the triangle (origin, `p`, `q`).
#[inline]
fn edge(p: [f32; 2], q: [f32; 2]) -> f32 {
    p[0] * q[1] - p[1] * q[0]
}

/// [`edge`] with exact products, so that its sign is the exact sign for the given `f32` endpoints.
#[cold]
fn edge_exact(p: [f32; 2], q: [f32; 2]) -> f64 {
    let [p, q] = [p, q].map(|e| e.map(f64::from));
    p[0] * q[1] - p[1] * q[0]
}

/// The point of the triangle that `ray`, which is said to hit it, passes: in `f64` from the exact vertices, rounded once; a function
/// of the ray and the triangle alone. `None` when a vertex is not finite.
///
/// **Which point.** Inside the triangle that of the sides, and `t` is that of the plane: it depends on ray and plane alone, with an
/// error far below that of `f32`, so triangles that overlap in a plane tie and the smaller id wins. (The interpolated `f32` distance of
/// Woop's test is off by up to 5e-4 on small far triangles.) A ray that exactly speaking misses is within [`LATERAL_ERROR`] of
/// the nearest point of the edges, which is the one to report: the plane there may be far from any point of a triangle seen
/// nearly edge-on.
///
/// **When `f64` cannot tell.** Let `e = 2^-52`, `r` the largest coordinate of a corner relative to the origin, `l` the length and `w` the width of
/// the triangle as the ray sees it. The sides are off by `e l^2` of `w l` and the projected corners by `e r`, so the point lies beside the ray
/// by up to `e l^2 / w + e r`. As `l <= 2 sqrt(3) r`, that is more than a roundoff `u r = 2^-24 r` for `w < 2^-26 l` only, where every
/// point inside is within `w < u r` of the edges: then the nearest one of those is taken. The plane of a long triangle that is seen from its end, or edge-on, is steep,
/// and its `t` may be that of another place: it counts if it is within `u r` of the point, else the point's own.
#[inline]
fn locate(ray: &Ray, [kx, ky, kz]: [usize; 3], vertices: [Vec3; 3]) -> Option<Crossing> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let corners = vertices.map(|v| v.as_dvec3() - origin);
    let d = direction.to_array();

    // Project the corners along the ray, scaled by d[kz] to spare a division.
    let flat = corners.map(|p| {
        let p = p.to_array();
        [p[kx] * d[kz] - d[kx] * p[kz], p[ky] * d[kz] - d[ky] * p[kz]]
    });
    let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
    let sides = [cross(flat[2], flat[1]), cross(flat[0], flat[2]), cross(flat[1], flat[0])];
    let det = sides[0] + sides[1] + sides[2];
    if !det.is_finite() {
        return None;
    }

    // Weigh the corners so that their mean lies on the ray, or as near as the triangle comes to it.
    let [a, b, c] = corners;
    let mean = |weights: [f64; 3], of: [f64; 3]| weights[0] * of[0] + weights[1] * of[1] + weights[2] * of[2];
    let roundoff = f64::from(UNIT_ROUNDOFF) * a.abs().max(b.abs()).max(c.abs()).max_element();
    let weights = sides.map(|s| s / det);
    let beside = [0, 1].map(|k| mean(weights, flat.map(|p| p[k])).abs());
    // (NaN when nothing of the triangle is seen: not inside.)
    let is_inside = is_inside(sides) && beside[0].max(beside[1]) <= roundoff * d[kz].abs();
    let weights = if is_inside { weights } else { nearest_of_edges(flat) };

    // Measure the distance: to the plane, held to the triangle's own range, unless that is another place.
    let along = corners.map(|p| p.to_array()[kz] / d[kz]);
    let to_point = mean(weights, along);
    let normal: DVec3 = (b - a).cross(c - a);
    let near = along[0].min(along[1]).min(along[2]);
    let far = along[0].max(along[1]).max(along[2]);
    let to_plane = (normal.dot(a) / normal.dot(direction)).max(near).min(far);
    let is_there = is_inside && ((to_plane - to_point) * d[kz]).abs() <= roundoff;

    let t = if is_there { to_plane } else { to_point };
    let (b1, b2) = (weights[1] as f32, weights[2] as f32);
    // (Spelt out: which zero `min` takes of two is not defined.)
    let rest = 1.0 - b1;
    Some(Crossing { t: t as f32, b1, b2: if b2 < rest { b2 } else { rest } })
}

/// Weights of the point on the edges of a projected triangle that is nearest to the origin.
#[cold]
fn nearest_of_edges(flat: [[f64; 2]; 3]) -> [f64; 3] {
    let mut nearest = (f64::INFINITY, [1.0, 0.0, 0.0]);
    for (from, to) in [(0, 1), (1, 2), (2, 0)] {
        let (p, q) = (flat[from], flat[to]);
        let e = [q[0] - p[0], q[1] - p[1]];
        let length_squared = e[0] * e[0] + e[1] * e[1];
        let part = -(p[0] * e[0] + p[1] * e[1]) / length_squared;
        // An edge without length gives NaN: take its first end.
        let part = if part > 0.0 { part.min(1.0) } else { 0.0 };
        let at = [p[0] + part * e[0], p[1] + part * e[1]];
        let distance_squared = at[0] * at[0] + at[1] * at[1];
        if distance_squared < nearest.0 {
            let mut weights = [0.0; 3];
            weights[from] = 1.0 - part;
            weights[to] = part;
            nearest = (distance_squared, weights);
        }
    }
    nearest.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ray(origin: Vec3, direction: Vec3) -> Ray {
        Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }

    fn hit(ray: &Ray, vertices: [Vec3; 3]) -> Option<Crossing> {
        intersect(ray, &RayShear::new(ray), vertices, ray.t_max)
    }

    const UNIT: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    #[test]
    fn weights_belong_to_their_vertices_on_every_axis_and_side() {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let turn = |v: Vec3| {
                    let p = v.to_array();
                    Vec3::new(p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3])
                };
                let start = turn(Vec3::new(0.25, 0.5, 3.0 * side));
                let along = turn(Vec3::new(0.0, 0.0, -side));
                let crossing = hit(&ray(start, along), UNIT.map(turn));
                assert_eq!(crossing, Some(Crossing { t: 3.0, b1: 0.25, b2: 0.5 }));
            }
        }
    }

    #[test]
    fn the_interval_is_open_below_and_closed_above() {
        let mut down = ray(Vec3::new(0.25, 0.25, 2.0), Vec3::NEG_Z);
        let shear = RayShear::new(&down);
        assert!(intersect(&down, &shear, UNIT, 2.0).is_some());
        assert!(intersect(&down, &shear, UNIT, 2.0_f32.next_down()).is_none());
        down.t_min = 2.0;
        assert!(intersect(&down, &shear, UNIT, 9.0).is_none());
        down.t_min = 2.0_f32.next_down();
        assert!(intersect(&down, &shear, UNIT, 9.0).is_some());
    }

    #[test]
    fn edge_on_degenerate_and_infinite_triangles_are_missed() {
        assert_eq!(hit(&ray(Vec3::new(-1.0, 0.25, 0.0), Vec3::X), UNIT), None, "edge-on");
        let down = ray(Vec3::new(0.5, 0.0, 1.0), Vec3::NEG_Z);
        assert_eq!(hit(&down, [Vec3::ZERO, Vec3::X, Vec3::X * 0.5]), None, "collinear");
        assert_eq!(hit(&down, [Vec3::X * 0.5; 3]), None, "a point");
        for bad in [f32::NAN, f32::INFINITY] {
            for at in 0..3 {
                let mut vertices = UNIT;
                vertices[at] = Vec3::new(bad, 0.0, 0.0);
                let found = hit(&ray(Vec3::new(0.25, 0.25, 1.0), Vec3::NEG_Z), vertices);
                assert_eq!(found, None, "vertex {at} is {bad}");
            }
        }
    }

    /// By how much the reported distance, and the point of the reported weights, miss each other and the ray, in roundoffs of the
    /// largest coordinate of a corner relative to the origin.
    fn roundoffs_off(r: &Ray, vertices: [Vec3; 3], Crossing { t, b1, b2 }: Crossing) -> f64 {
        let corners = vertices.map(|v| v.as_dvec3() - r.origin.as_dvec3());
        let reach = corners.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let (b1, b2) = (f64::from(b1), f64::from(b2));
        let point = corners[0] * (1.0 - b1 - b2) + corners[1] * b1 + corners[2] * b2;
        let away = (point - r.direction.as_dvec3() * f64::from(t)).abs().max_element();
        away / (reach * f64::from(UNIT_ROUNDOFF))
    }

    /// [`LATERAL_ERROR`]; the weights and `t` are rounded to `f32` on top of it, half an ulp each.
    const BOUND_ROUNDOFFS: f64 = (LATERAL_ERROR / UNIT_ROUNDOFF + 4.0) as f64;

    #[test]
    fn a_ray_that_f64_cannot_tell_from_the_plane_is_located_where_it_passes() {
        // Found by search: at a corner of a plane that the ray leaves by 2^-28 of its length.
        let r = ray(
            Vec3::new(-225_424.7, -42_407.875, -1_042_101.8),
            Vec3::new(188_938.2, 139_300.38, 757_039.3),
        );
        let vertices = [
            Vec3::new(3206.5, 82_675.5, -153_904.5),
            Vec3::new(-36_486.5, 96_892.5, -285_062.5),
            Vec3::new(-23_040.5, 14_950.5, -290_092.5),
        ];
        let off = roundoffs_off(&r, vertices, hit(&r, vertices).expect("the test says so"));
        assert!(off <= BOUND_ROUNDOFFS, "{off}");

        // Two edges and a direction that span a volume of 1, made from the unit cube by shears: the direction leaves the plane by
        // 2^-60 of its length, less than f64 resolves.
        let mut random = 1u64;
        let mut next = |n: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % n
        };
        let mut hits = 0;
        for _ in 0..20_000 {
            let mut span = [[1i64, 0, 0], [0, 1, 0], [0, 0, 1]];
            while span.as_flattened().iter().all(|x| x.abs() < 1 << 17) {
                let (to, from) = (next(3) as usize, next(3) as usize);
                let by = next(9) as i64 - 4;
                if to != from {
                    span[to] = [0, 1, 2].map(|k| span[to][k] + by * span[from][k]);
                }
            }
            let [e1, e2, d] = span.map(|v| Vec3::from_array(v.map(|x| x as f32)));
            let corner = Vec3::splat(0.5) - e1 - e2;
            let vertices = [corner, corner + e1 * 4.0, corner + e2 * 4.0];
            let r = ray(Vec3::splat(0.5) - d * (1 + next(3)) as f32, d);
            if let Some(crossing) = hit(&r, vertices) {
                hits += 1;
                let off = roundoffs_off(&r, vertices, crossing);
                assert!(off <= BOUND_ROUNDOFFS, "{off}: {r:?} {vertices:?}");
            }
        }
        assert!(hits > 2000, "{hits}");
    }

    /// Voxel centres as the decoder makes them: whole numbers plus a half, within 2^19.
    fn voxel() -> impl Strategy<Value = Vec3> {
        let coordinate = || prop_oneof![-524_288i32..524_288, -40i32..40].prop_map(|i| i as f32 + 0.5);
        (coordinate(), coordinate(), coordinate()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    /// `p` and `q` as the test of `r` sees them.
    fn sheared(r: &Ray, points: [Vec3; 2]) -> [[f32; 2]; 2] {
        let RayShear { k: [kx, ky, kz], x, y, .. } = RayShear::new(r);
        points.map(|v| {
            let v = (v - r.origin).to_array();
            [v[kx] - x * v[kz], v[ky] - y * v[kz]]
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 4000,
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        #[test]
        fn both_triangles_of_an_edge_see_opposite_sides_and_never_the_wrong_one(
            a in voxel(), b in voxel(), o in voxel(), along in 0.0f32..=1.0,
        ) {
            let r = ray(o, a + (b - a) * along - o);
            prop_assume!(r.is_traceable());
            let [p, q] = sheared(&r, [a, b]);
            let (forth, back) = (edge(p, q), edge(q, p));
            prop_assert_eq!(forth, -back);
            let (exact, exact_back) = (edge_exact(p, q), edge_exact(q, p));
            prop_assert_eq!(exact, -exact_back);
            prop_assert!(forth == 0.0 || f64::from(forth).signum() == exact.signum());
        }

        #[test]
        fn the_reported_point_is_of_the_triangle_and_within_the_bound_of_the_ray(
            a in voxel(), b in voxel(), c in voxel(), o in voxel(),
            (s, t) in (0.0f32..=1.0, 0.0f32..=1.0), (kind, offset) in (0..4, -1e-6f32..1e-6),
        ) {
            // Inside, on an edge, at a vertex, nearly along an edge: rounding decides most of them.
            let target = match kind {
                0 => a + (b - a) * s + (c - a) * (t * (1.0 - s)),
                1 => a + (b - a) * s,
                2 => c,
                _ => b,
            };
            let o = if kind == 3 { a + (a - b) * s + Vec3::splat(offset * 1e5) } else { o };
            let r = ray(o, target - o);
            prop_assume!(r.is_traceable());
            if let Some(crossing) = hit(&r, [a, b, c]) {
                let off = roundoffs_off(&r, [a, b, c], crossing);
                prop_assert!(off <= BOUND_ROUNDOFFS, "{}", off);
            }
        }

        #[test]
        fn weights_stay_inside_and_slivers_give_no_nan(
            a in voxel(), b in voxel(), c in voxel(), o in voxel(),
            (s, t) in (0.0f32..=1.0, 0.0f32..=1.0), thin in any::<bool>(),
        ) {
            // Half of the cases are slivers half a voxel wide.
            let c = if thin { a + (b - a) * 0.5 + Vec3::new(0.0, 0.5, 0.0) } else { c };
            let target = a + (b - a) * s + (c - a) * (t * (1.0 - s));
            let r = ray(o, target - o);
            prop_assume!(r.is_traceable());
            if let Some(Crossing { t, b1, b2 }) = hit(&r, [a, b, c]) {
                let b0 = 1.0 - b1 - b2;
                prop_assert!(t > 0.0 && t.is_finite());
                prop_assert!((0.0..=1.0).contains(&b0) && (0.0..=1.0).contains(&b1) && (0.0..=1.0).contains(&b2));
                prop_assert!((b0 + b1 + b2 - 1.0).abs() <= 4.0 * f32::EPSILON);
            }
        }

        #[test]
        fn swapping_or_turning_the_vertices_changes_neither_verdict_nor_distance(
            a in voxel(), b in voxel(), c in voxel(), o in voxel(), (s, t) in (0.0f32..=1.0, 0.0f32..=1.0),
        ) {
            let r = ray(o, a + (b - a) * s + (c - a) * (t * (1.0 - s)) - o);
            prop_assume!(r.is_traceable());
            let first = hit(&r, [a, b, c]).map(|h| h.t);
            for other in [[b, c, a], [c, a, b], [a, c, b], [c, b, a], [b, a, c]] {
                match (first, hit(&r, other).map(|h| h.t)) {
                    (None, None) => {}
                    // The plane is anchored at another vertex: f64 rounding may cross an f32 boundary, by one ulp.
                    (Some(x), Some(y)) => prop_assert!((x - y).abs() <= x.next_up() - x),
                    (x, y) => prop_assert!(false, "{x:?} against {y:?}"),
                }
            }
        }
    }
}
