// `locate` of triangle.rs in `f64`, and exact signs of edge functions.

/// The relative error allowed to a distance compared with another one (traverse.rs).
const MARGIN: f32 = 4.76837158e-7;

/// Numbers with the signs of the edge functions.
fn edge_signs(px: vec3<f32>, py: vec3<f32>, qx: vec3<f32>, qy: vec3<f32>) -> vec3<f32> {
    let area = ordered_edges(px, py, qx, qy);

    // Two products of f32 and their difference, fused or not, are off by less than 2^-23 of the products' sum: beyond that the sign is right.
    let doubt = abs(area) <= (abs(px * qy) + abs(py * qx)) * 1.1920929e-7;
    if !any(doubt) { return area; }

    // Products of two f32 are exact in f64, so their difference has the exact sign, fused or not.
    return vec3<f32>(
        select(area.x, exact_sign(px.x, py.x, qx.x, qy.x), doubt.x),
        select(area.y, exact_sign(px.y, py.y, qx.y, qy.y), doubt.y),
        select(area.z, exact_sign(px.z, py.z, qx.z, qy.z), doubt.z),
    );
}

fn exact_sign(px: f32, py: f32, qx: f32, qy: f32) -> f32 {
    let left = f64(px) * f64(qy);
    let right = f64(py) * f64(qx);
    return select(select(0.0, -1.0, left < right), 1.0, left > right);
}

/// Where the ray, which meets it, crosses the triangle: `t`, `b1` and `b2`.
struct Crossing {
    t: f32,
    b1: f32,
    b2: f32,
}

fn locate(origin: vec3<f32>, direction: vec3<f32>, kz: u32, va: vec3<f32>, vb: vec3<f32>, vc: vec3<f32>) -> Crossing {
    // Turn the main axis to z, which permutes terms of products and sums only.
    let a = vec3<f64>(turned(va, kz)) - vec3<f64>(turned(origin, kz));
    let b = vec3<f64>(turned(vb, kz)) - vec3<f64>(turned(origin, kz));
    let c = vec3<f64>(turned(vc, kz)) - vec3<f64>(turned(origin, kz));
    let d = vec3<f64>(turned(direction, kz));

    // Project the corners along the ray, scaled by d.z to spare a division.
    let fa = a.xy * d.z - d.xy * a.z;
    let fb = b.xy * d.z - d.xy * b.z;
    let fc = c.xy * d.z - d.xy * c.z;
    let sides = vec3<f64>(cross2(fc, fb), cross2(fa, fc), cross2(fb, fa));
    let det = sides.x + sides.y + sides.z;

    // Weigh the corners so that their mean lies on the ray, or as near as the triangle comes to it.
    let reach = max(max(largest(a), largest(b)), largest(c));
    let roundoff = reach * f64(5.96046448e-8);
    let zero64 = f64(0.0);
    let has_area = det != zero64;
    let inverse = f64(1.0) / select(f64(1.0), det, has_area);
    var weights = sides * inverse;
    let beside = abs(weights.x * fa + weights.y * fb + weights.z * fc);
    let agree = (sides.x >= zero64 && sides.y >= zero64 && sides.z >= zero64)
        || (sides.x <= zero64 && sides.y <= zero64 && sides.z <= zero64);
    let is_inside = has_area && agree && max(beside.x, beside.y) <= roundoff * abs(d.z);
    if !is_inside { weights = nearest_of_edges(fa, fb, fc); }

    // Measure the distance: to the plane, held to the triangle's own range, unless that is another place.
    let along = vec3<f64>(a.z, b.z, c.z) / d.z;
    let to_point = weights.x * along.x + weights.y * along.y + weights.z * along.z;
    let e = b - a;
    let f = c - a;
    let normal = vec3<f64>(e.y * f.z - f.y * e.z, e.z * f.x - f.z * e.x, e.x * f.y - f.x * e.y);
    let near = min(min(along.x, along.y), along.z);
    let far = max(max(along.x, along.y), along.z);
    let steepness = dot64(normal, d);
    let is_seen = steepness != zero64;
    let to_plane = min(max(dot64(normal, a) / select(f64(1.0), steepness, is_seen), near), far);
    let is_there = is_inside && is_seen && abs((to_plane - to_point) * d.z) <= roundoff;

    let b1 = f32(weights.y);
    return Crossing(f32(select(to_point, to_plane, is_there)), b1, min(f32(weights.z), 1.0 - b1));
}

fn cross2(p: vec2<f64>, q: vec2<f64>) -> f64 {
    return p.x * q.y - p.y * q.x;
}

fn dot64(p: vec3<f64>, q: vec3<f64>) -> f64 {
    return p.x * q.x + p.y * q.y + p.z * q.z;
}

fn largest(p: vec3<f64>) -> f64 {
    let q = abs(p);
    return max(max(q.x, q.y), q.z);
}

/// Weights of the point on the edges of a projected triangle that is nearest to the origin.
fn nearest_of_edges(a: vec2<f64>, b: vec2<f64>, c: vec2<f64>) -> vec3<f64> {
    let ab = nearest_of_edge(a, b);
    let bc = nearest_of_edge(b, c);
    let ca = nearest_of_edge(c, a);
    let one = f64(1.0);
    let zero64 = f64(0.0);
    var nearest = ab.y;
    var weights = vec3<f64>(one - ab.x, ab.x, zero64);
    if bc.y < nearest {
        nearest = bc.y;
        weights = vec3<f64>(zero64, one - bc.x, bc.x);
    }
    if ca.y < nearest {
        weights = vec3<f64>(ca.x, zero64, one - ca.x);
    }
    return weights;
}

/// The share of `q` in the point of the edge that is nearest to the origin, and its squared distance.
fn nearest_of_edge(p: vec2<f64>, q: vec2<f64>) -> vec2<f64> {
    let e = q - p;
    let length_squared = e.x * e.x + e.y * e.y;
    let has_length = length_squared > f64(0.0);
    // An edge without length: take its first end.
    let along = -(p.x * e.x + p.y * e.y) / select(f64(1.0), length_squared, has_length);
    let part = select(f64(0.0), min(along, f64(1.0)), has_length && along > f64(0.0));
    let at = p + e * part;
    return vec2<f64>(part, at.x * at.x + at.y * at.y);
}

/// Unit normal of a triangle on the side on which its corners run counter-clockwise; as in surface.rs.
fn geometric_normal(va: vec3<f32>, vb: vec3<f32>, vc: vec3<f32>) -> vec3<f32> {
    let e = vec3<f64>(vb) - vec3<f64>(va);
    let f = vec3<f64>(vc) - vec3<f64>(va);
    let n = vec3<f64>(e.y * f.z - f.y * e.z, e.z * f.x - f.z * e.x, e.x * f.y - f.x * e.y);
    let squared = dot64(n, n);
    if squared > f64(0.0) { return vec3<f32>(n * (f64(1.0) / sqrt(squared))); }
    return vec3<f32>(0.0, 1.0, 0.0);
}
