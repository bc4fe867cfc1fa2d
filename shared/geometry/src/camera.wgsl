// Sibling of camera.rs.

/// Half the image plane's width and height at distance 1 are the lengths of `right` and `up`.
struct LocalCamera {
    origin: vec3<f32>,
    forward: vec3<f32>,
    right: vec3<f32>,
    up: vec3<f32>,
}

/// The ray through `at` in pixels from the image's upper left corner; a pixel's centre is at + 0.5.
fn camera_ray(camera: LocalCamera, at: vec2<f32>, size: vec2<f32>) -> Ray {
    let u = quotient(2.0 * at.x, size.x) - 1.0;
    let v = 1.0 - quotient(2.0 * at.y, size.y);
    let direction = normalized(camera.forward + scaled(camera.right, u) + scaled(camera.up, v));
    return Ray(camera.origin, 0.0, direction, FAR);
}
