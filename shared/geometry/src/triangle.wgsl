// Sibling of triangle.rs, in two halves: `may_cross` decides whether the ray meets the triangle and turns away what lies wholly outside
// its range; `locate` (locate_f64.wgsl, locate_f32.wgsl) says where. A traversal does the second for few of its triangles, later and
// for all rays of a group together.
//
// The projections use `times`, so both triangles of an edge see the same numbers, which are those of the CPU if the device divides
// exactly. What is left to the compiler are the edge functions: fused, `a b - c d` may have the wrong sign and is not the negative of
// `c d - a b`. So each is taken on its ends in lexicographic order of their projections, which both triangles of the edge share whatever
// their indices, and negated for one of the two: they come to one verdict. Where `f64` is at hand, a sign that rounding could have turned
// is decided exactly (`edge_sign`), and the verdict is that of the CPU.

struct RayShear {
    kz: u32,
    x: f32,
    y: f32,
    per_depth: f32,
}

/// gamma(15): as in triangle.rs, but for the shear's division, which may be off by 2.5 units in the last place (5 roundoffs):
/// 1 + 1 + 5 + 1 + 1 + 1 along each axis, times sqrt(2).
const LATERAL_ERROR: f32 = 8.9407047e-7;

/// As in triangle.rs, with 2.5 units in the last place for the inverse: 1 -+ 2 gamma(8).
const DEPTH_SHORTER: f32 = 0.99999905;
const DEPTH_LONGER: f32 = 1.000001;

/// The components of `v` with the main axis last: (kx, ky, kz).
fn turned(v: vec3<f32>, kz: u32) -> vec3<f32> {
    return select(select(v, v.zxy, kz == 1u), v.yzx, kz == 0u);
}

fn ray_shear(direction: vec3<f32>) -> RayShear {
    let a = abs(direction);
    let kz = select(select(2u, 1u, a.y >= a.z), 0u, a.x >= a.y && a.x >= a.z);
    let d = turned(direction, kz);
    return RayShear(kz, quotient(d.x, d.z), quotient(d.y, d.z), quotient(1.0, d.z));
}

/// Whether the ray meets the triangle with corners `a`, `b`, `c`, perhaps between `t_min` and `t_max`.
fn may_cross(origin: vec3<f32>, shear: RayShear, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, t_min: f32, t_max: f32) -> bool {
    // Move the ray to the origin and shear it onto +z.
    let p = turned(a - origin, shear.kz);
    let q = turned(b - origin, shear.kz);
    let r = turned(c - origin, shear.kz);
    let depth = vec3<f32>(p.z, q.z, r.z);
    let x = vec3<f32>(p.x, q.x, r.x) - times3(vec3<f32>(shear.x), depth);
    let y = vec3<f32>(p.y, q.y, r.y) - times3(vec3<f32>(shear.y), depth);

    // Find on which side of each edge the origin lies: of c b, a c and b a.
    let sides = edge_signs(x.zxy, y.zxy, x.yzx, y.yzx);
    let is_inside = all(sides >= vec3<f32>(0.0)) || all(sides <= vec3<f32>(0.0));
    let is_edge_on = all(sides == vec3<f32>(0.0));

    // Leave out a triangle that lies wholly outside the range: the distance is between those of its vertices.
    let along = depth * shear.per_depth;
    let near = min(min(along.x, along.y), along.z);
    let far = max(max(along.x, along.y), along.z);
    return is_inside && !is_edge_on && near * DEPTH_SHORTER <= t_max && far * DEPTH_LONGER >= t_min;
}

/// Twice the signed areas of the triangles (origin, p, q), three at once; the same numbers, negated, when p and q change places.
fn ordered_edges(px: vec3<f32>, py: vec3<f32>, qx: vec3<f32>, qy: vec3<f32>) -> vec3<f32> {
    let in_order = (px < qx) | ((px == qx) & (py < qy));
    let ax = select(qx, px, in_order);
    let ay = select(qy, py, in_order);
    let bx = select(px, qx, in_order);
    let by = select(py, qy, in_order);
    let area = ax * by - ay * bx;
    // The ends of an edge that is seen from its end are one point.
    let is_point = (px == qx) & (py == qy);
    return select(select(-area, area, in_order), vec3<f32>(0.0), is_point);
}
