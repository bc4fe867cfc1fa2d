// `locate` of triangle.rs for devices without `f64`.
//
// The distance is that of the plane, held to the range of the corners' depths: off by roundoffs of the products behind it, which for a
// triangle that is not seen nearly edge-on is a few roundoffs. (Woop's interpolated distance is off by up to 5e-4 on small far triangles.)
// Hits of planes that lie nearer to each other than that may change places; none is lost.

/// The relative error allowed to a distance compared with another one: 2^-16, so that a cell is not passed over for a distance that is
/// off by rounding.
const MARGIN: f32 = 1.52587891e-5;

fn edge_signs(px: vec3<f32>, py: vec3<f32>, qx: vec3<f32>, qy: vec3<f32>) -> vec3<f32> {
    return ordered_edges(px, py, qx, qy);
}

struct Crossing {
    t: f32,
    b1: f32,
    b2: f32,
}

fn locate(origin: vec3<f32>, direction: vec3<f32>, kz: u32, va: vec3<f32>, vb: vec3<f32>, vc: vec3<f32>) -> Crossing {
    let a = turned(va - origin, kz);
    let b = turned(vb - origin, kz);
    let c = turned(vc - origin, kz);
    let d = turned(direction, kz);

    // Weigh the corners by the areas opposite to them, seen along the ray.
    let s = d.xy / d.z;
    let fa = a.xy - s * a.z;
    let fb = b.xy - s * b.z;
    let fc = c.xy - s * c.z;
    let sides = vec3<f32>(difference(fc, fb), difference(fa, fc), difference(fb, fa));
    let magnitudes = abs(sides);
    let det = magnitudes.x + magnitudes.y + magnitudes.z;
    let has_area = det > 0.0;
    // (Sides that rounding gave another sign are as good as 0; so are all of an edge-on triangle, of which the first corner is taken.)
    let weights = select(vec3<f32>(1.0, 0.0, 0.0), magnitudes / select(1.0, det, has_area), has_area);

    // Measure the distance to the plane, held to the triangle's own range.
    let along = vec3<f32>(a.z, b.z, c.z) / d.z;
    let to_point = weights.x * along.x + weights.y * along.y + weights.z * along.z;
    let near = min(min(along.x, along.y), along.z);
    let far = max(max(along.x, along.y), along.z);
    let normal = plane_normal(b - a, c - a);
    let steepness = dot(normal, d);
    let is_seen = abs(steepness) > LEAST_STEEPNESS * length(normal) * length(d);
    let to_plane = clamp(dot(normal, a) / select(1.0, steepness, is_seen), near, far);

    let b1 = weights.y;
    return Crossing(select(to_point, to_plane, is_seen), b1, min(weights.z, 1.0 - b1));
}

/// Below this cosine between plane and ray the plane's distance is worse than that of the corners' mean: 2^-12, where 2^-24 of the
/// products behind it are 2^-12 of the distance.
const LEAST_STEEPNESS: f32 = 2.44140625e-4;

/// `p.x q.y - p.y q.x`, within two roundoffs of the result where the device fuses (Kahan; Jeannerod, Louvet, Muller 2013).
fn difference(p: vec2<f32>, q: vec2<f32>) -> f32 {
    let w = times(p.y, q.x);
    return fma(p.x, q.y, -w) + fma(-p.y, q.x, w);
}

/// The cross product; its operands are differences of corners that were rounded relative to the origin.
fn plane_normal(e: vec3<f32>, f: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(difference(e.yz, f.yz), difference(e.zx, f.zx), difference(e.xy, f.xy));
}

/// Unit normal of a triangle on the side on which its corners run counter-clockwise; as in surface.rs.
fn geometric_normal(va: vec3<f32>, vb: vec3<f32>, vc: vec3<f32>) -> vec3<f32> {
    let n = plane_normal(vb - va, vc - va);
    let greatest = max_element(abs(n));
    if greatest > 0.0 { return normalize(n / greatest); }
    return vec3<f32>(0.0, 1.0, 0.0);
}
