// Sibling of oct.rs: a normal as a point of the octahedron.

/// The point of the octahedron |x| + |y| + |z| = 127 that `code` names. Magnitudes first, then signs: no comparison of negative numbers.
fn oct_point(code: u32) -> vec3<i32> {
    let x = code & 0xffu;
    let y = (code >> 8u) & 0xffu;
    let ax = select(127u - x, x - 127u, x >= 127u);
    let ay = select(127u - y, y - 127u, y >= 127u);
    let is_upper = ax + ay <= 127u;
    let mx = select(127u - ay, ax, is_upper);
    let my = select(127u - ax, ay, is_upper);
    return vec3<i32>(
        i32(select(0u - mx, mx, x >= 127u)), i32(select(0u - my, my, y >= 127u)), i32(127u - ax - ay),
    );
}

/// The unit vector of `code`; 0 when it means none.
fn oct_normal(code: u32) -> vec3<f32> {
    if code == 0xffffu { return vec3<f32>(0.0); }
    let point = vec3<f32>(oct_point(code));
    return quotient3(point, vec3<f32>(length3(point)));
}
