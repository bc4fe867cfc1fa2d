// Arithmetic that comes out the same on every device: no sibling in Rust, whose products are never fused.
//
// A shader compiler may turn a product and a sum into one operation that rounds once. `times` keeps it from that: the product goes
// through an exclusive or with `zero`, of which only the host knows that it is 0. So sums of products round as on the CPU, where the
// device rounds sums and products correctly (as Vulkan, Metal and DirectX 12 do), and what is made of these alone is equal bit for bit.

/// Set from the frame's parameters before anything else.
var<private> zero: u32;

/// The largest finite number: what stands for 'without end', since a compiler may assume that no infinity occurs.
const FAR: f32 = 3.40282347e38;

/// A product that is never fused with a sum.
fn times(a: f32, b: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a * b) ^ zero);
}

fn times3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(a * b) ^ vec3<u32>(zero));
}

fn scaled(a: vec3<f32>, s: f32) -> vec3<f32> {
    return times3(a, vec3<f32>(s));
}

fn dot3(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let p = times3(a, b);
    return p.x + p.y + p.z;
}

fn cross3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return times3(a.yzx, b.zxy) - times3(b.yzx, a.zxy);
}

fn length3(v: vec3<f32>) -> f32 {
    return root(dot3(v, v));
}

/// `v` at unit length; `v` has one.
fn normalized(v: vec3<f32>) -> vec3<f32> {
    return scaled(v, quotient(1.0, length3(v)));
}

/// `v` at unit length, or `otherwise` where it has none.
fn normalized_or(v: vec3<f32>, otherwise: vec3<f32>) -> vec3<f32> {
    let length = length3(v);
    // (The inverse of a length below 2^-128 is no number of f32.)
    return select(otherwise, scaled(v, quotient(1.0, length)), length > 2.938736e-39 && length < FAR);
}

/// `a (1 - s) + b s`.
fn mixed(a: vec3<f32>, b: vec3<f32>, s: f32) -> vec3<f32> {
    return scaled(a, 1.0 - s) + scaled(b, s);
}

fn max_element(v: vec3<f32>) -> f32 {
    return max(max(v.x, v.y), v.z);
}

fn above(v: f32) -> f32 {
    // The next number upwards; v is finite.
    let bits = bitcast<u32>(v);
    if (bits & 0x7fffffffu) == 0u { return bitcast<f32>(1u | zero); }
    return bitcast<f32>(select(bits - 1u, bits + 1u, bits < 0x80000000u));
}

fn below(v: f32) -> f32 {
    return -above(-v);
}
