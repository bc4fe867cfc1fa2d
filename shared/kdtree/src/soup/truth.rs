//! An independent judge of hits: triple products in exact integers or in `f64`, nothing in common with the test under judgement.

use tessera_geometry::{DVec3, Ray, Vec3, triangle::LATERAL_ERROR};

/// What one triangle is to a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Distance to the plane, when the ray crosses the closed triangle.
    pub t: Option<f64>,
    /// Distance of the ray from the triangle's edges, across the main axis of its direction and at equal depth, in units of the
    /// largest coordinate of a corner relative to the origin.
    pub to_edges: f64,
}

impl Truth {
    /// Whether the test under judgement may say otherwise: its bound is [`LATERAL_ERROR`].
    pub fn is_within_rounding(&self) -> bool {
        self.to_edges <= f64::from(LATERAL_ERROR)
    }
}

/// Judges in `f64`; right but for triangles that the ray passes, or sees edge-on, within about 2^-50.
pub fn judge(ray: &Ray, vertices: [Vec3; 3]) -> Truth {
    let [a, b, c] = vertices.map(|v| v.as_dvec3() - ray.origin.as_dvec3());
    let d: DVec3 = ray.direction.as_dvec3();
    let sides = [d.dot(b.cross(c)), d.dot(c.cross(a)), d.dot(a.cross(b))];
    let is_inside = sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0);
    let normal: DVec3 = (b - a).cross(c - a);
    let t = normal.dot(a) / normal.dot(d);
    let is_hit = is_inside && t > f64::from(ray.t_min) && t < f64::from(ray.t_max);
    Truth { t: is_hit.then_some(t), to_edges: to_edges(ray, vertices) }
}

/// Judges exactly a ray and a triangle whose coordinates are multiples of a half below 2^23, with a direction of multiples of
/// 2^-20 below 2^24.
///
/// # Panics
/// When they are not.
pub fn judge_exactly(ray: &Ray, vertices: [Vec3; 3]) -> Truth {
    let whole = |v: DVec3, scale: f64| {
        v.to_array().map(|x| {
            let x = x * scale;
            assert_eq!(x, x.trunc(), "{x} is no whole number");
            x as i128
        })
    };
    let origin = whole(ray.origin.as_dvec3(), 2.0);
    let [a, b, c] = vertices.map(|v| minus(whole(v.as_dvec3(), 2.0), origin));
    // 2^24 a coordinate and 2^44 a component: triple products stay below 2^96.
    let d = whole(ray.direction.as_dvec3(), 1_048_576.0);
    let sides = [dot(d, cross(b, c)), dot(d, cross(c, a)), dot(d, cross(a, b))];
    let is_inside = sides.iter().all(|s| *s >= 0) || sides.iter().all(|s| *s <= 0);
    let normal = cross(minus(b, a), minus(c, a));
    let (height, slope) = (dot(normal, a), dot(normal, d));
    // Corners were doubled, the direction scaled by 2^20.
    let t = height as f64 / slope as f64 * 524_288.0;
    let is_hit = is_inside && slope != 0 && t > f64::from(ray.t_min) && t < f64::from(ray.t_max);
    Truth { t: is_hit.then_some(t), to_edges: to_edges(ray, vertices) }
}

fn minus(a: [i128; 3], b: [i128; 3]) -> [i128; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [i128; 3], b: [i128; 3]) -> [i128; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [i128; 3], b: [i128; 3]) -> i128 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// See [`Truth::to_edges`].
fn to_edges(ray: &Ray, vertices: [Vec3; 3]) -> f64 {
    let corners = vertices.map(|v| v.as_dvec3() - ray.origin.as_dvec3());
    let d = ray.direction.as_dvec3();
    let main = d.abs().max_position();
    // Slide each corner along the ray to the origin's depth: what is left lies across.
    let across = corners.map(|p| p - d * (p[main] / d[main]));
    let reach = corners.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let to_edge = |p: DVec3, q: DVec3| {
        let edge: DVec3 = q - p;
        let part = (-p.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        // NaN for an edge without length.
        (if part.is_nan() { p } else { p + edge * part }).length()
    };
    let [a, b, c] = across;
    to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a)) / reach
}
