// Sibling of ray.rs.

struct Ray {
    origin: vec3<f32>,
    t_min: f32,
    direction: vec3<f32>,
    t_max: f32,
}

/// `triangle` is NO_TRIANGLE when nothing was hit.
struct Hit {
    t: f32,
    triangle: u32,
    b1: f32,
    b2: f32,
}

const NO_TRIANGLE: u32 = 0xffffffffu;

/// 2^-60 and 2^60: between them lies the largest component of a direction that can be traced.
const DIRECTION_MIN: f32 = 8.67361738e-19;
const DIRECTION_MAX: f32 = 1.15292150e18;

/// 2^-40: the least share of the largest component that is a divisor.
const DIVISOR_SHARE: f32 = 9.09494702e-13;

fn is_number(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}

fn is_traceable(ray: Ray) -> bool {
    let length = max_element(abs(ray.direction));
    let o = ray.origin;
    let d = ray.direction;
    // Compare bits: a compiler may take it that no number is infinite or none.
    return is_number(o.x) && is_number(o.y) && is_number(o.z)
        && is_number(d.x) && is_number(d.y) && is_number(d.z)
        && length >= DIRECTION_MIN && length <= DIRECTION_MAX
        && is_number(ray.t_min) && ray.t_min >= 0.0 && ray.t_min < ray.t_max;
}

/// The direction for kernels that divide by its components: those below 2^-40 of the largest are 0.
fn divisor(direction: vec3<f32>) -> vec3<f32> {
    let least = max_element(abs(direction)) * DIVISOR_SHARE;
    return select(direction, vec3<f32>(0.0), abs(direction) < vec3<f32>(least));
}

/// Whether a hit is nearer than another; equal distances are decided by the smaller triangle id.
fn precedes(t: f32, triangle: u32, other_t: f32, other_triangle: u32) -> bool {
    return t < other_t || (t == other_t && triangle < other_triangle);
}
