// Quotients and roots that are rounded correctly: through `f64`, whose own error is far below half a digit of `f32`.

fn quotient(a: f32, b: f32) -> f32 {
    return f32(f64(a) / f64(b));
}

fn quotient3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(quotient(a.x, b.x), quotient(a.y, b.y), quotient(a.z, b.z));
}

fn root(v: f32) -> f32 {
    return f32(sqrt(f64(v)));
}
