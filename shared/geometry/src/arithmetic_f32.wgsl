// Quotients and roots as the device computes them: within 2.5 units in the last place (WGSL, section 15.7.4).

fn quotient(a: f32, b: f32) -> f32 {
    return a / b;
}

fn quotient3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return a / b;
}

fn root(v: f32) -> f32 {
    return sqrt(v);
}
