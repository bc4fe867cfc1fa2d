// Sibling of light.rs: what a light brings. `light_at` reads the pack's lights.
//
// The CPU lets infinities come and go; here every step that could leave the range of f32 is told beforehand, with the same
// outcome.

// `tessera_pack::LightKind`.
const LIGHT_POINT: u32 = 0u;
const LIGHT_DIRECTIONAL: u32 = 1u;
const LIGHT_SPOT: u32 = 2u;

/// Light that arrives at a point if nothing is in its way.
struct Incoming {
    /// Unit vector to the light.
    direction: vec3<f32>,
    /// Local distance at which occluders end.
    reach: f32,
    /// On a surface that faces the light.
    irradiance: vec3<f32>,
    /// Whether there is any.
    arrives: bool,
}

/// Bound of an irradiance, so that a light almost at the surface stays finite in all sums: 2^63.
const MAX_IRRADIANCE: f32 = 9.223372036854775808e18;

/// 2^64: the square of this is no number of f32, that of the one before is.
const SQUARE_OVERFLOWS: f32 = 1.8446744073709551616e19;

/// 2^-63: the square of anything below it is less than the least normal number.
const SQUARE_UNDERFLOWS: f32 = 1.084202172485504434e-19;

/// What `light` brings to `origin`. The world length of a local unit is `scene.step_mantissa + scene.step_rest`, a sum of 48
/// bits in [1, 2], times `scene.step_power`, a power of two: 0 where it would be less than 2^-126, and 2^127 where more than
/// that, for either decides by itself.
fn incoming(light: Light, origin: vec3<f32>) -> Incoming {
    let nothing = Incoming(vec3<f32>(0.0), 0.0, vec3<f32>(0.0), false);

    // A directional light is everywhere the same.
    if light.kind == LIGHT_DIRECTIONAL {
        return Incoming(-light.direction, FAR, light.intensity, true);
    }

    // Measure the way. A light exactly at the point has no direction and is left out.
    let way = light.position - origin;
    let distance = length3(way);
    if !(distance > 0.0 && is_number(distance)) {
        return nothing;
    }
    let direction = quotient3(way, vec3<f32>(distance));

    // Find the world distance. Where its square overflows nothing is left of the light.
    let product = exact_product(distance, scene.step_mantissa);
    let steps = product.x + kept(product.y + times(distance, scene.step_rest));
    if scene.step_power >= 1.0 && steps >= SQUARE_OVERFLOWS / scene.step_power {
        return nothing;
    }
    let world = times(steps, scene.step_power);
    if world >= SQUARE_OVERFLOWS {
        return nothing;
    }

    // Let it fall off with the square of the world distance, within its window and cone.
    var part = 1.0;
    if light.kind == LIGHT_SPOT {
        part = cone(-dot3(direction, light.direction), light.cos_inner, light.cos_outer);
    }
    let share = fallen_off(window(world, light.range), world, part);

    // (A share above 1 times an intensity above the bound is above the bound.)
    let intensity = select(light.intensity, min(light.intensity, vec3<f32>(MAX_IRRADIANCE)), share > 1.0);
    let irradiance = min(scaled(intensity, min(share, MAX_IRRADIANCE)), vec3<f32>(MAX_IRRADIANCE));
    return Incoming(direction, reach(distance, light.position), irradiance, share > 0.0);
}

/// `windowed / world^2 * part`. The window is 0 or at least 2^-24, so where the square is no normal number the quotient is
/// above 2^102 and the bound of an irradiance stands for it, as for any cone's part above 2^-39 of it.
fn fallen_off(windowed: f32, world: f32, part: f32) -> f32 {
    if world < SQUARE_UNDERFLOWS {
        return select(0.0, MAX_IRRADIANCE, windowed > 0.0 && part > 0.0);
    }
    return times(quotient(windowed, times(world, world)), part);
}

/// gamma(3) of rounding.rs.
const GAMMA_3: f32 = 1.78813967e-7;

/// Where occluders of a light at `distance` end, so that a lamp in or on a surface is not put out by it.
///
/// Three things may put that surface before the light: packing moves a vertex by up to half a voxel an axis, sqrt(3)
/// / 2 < 1; rounding the light's place, within gamma(3) of its coordinates; and rounding the ray's unit direction,
/// within gamma(6) < 2^-20 of the distance.
fn reach(distance: f32, position: vec3<f32>) -> f32 {
    // (2^100 and above leave nothing of a distance below 2^64, and three of it have a sum.)
    let place = min(abs(position), vec3<f32>(1.2676506e30));
    let margin = kept(1.0 + times(place.x + place.y + place.z, GAMMA_3)) + times(distance, 1.0 / 1048576.0);
    return max(distance - margin, 0.0);
}

/// The smooth end of a light's range (KHR_lights_punctual, "Range Property"): `max(min(1 - (d / range)^4, 1), 0)`.
fn window(distance: f32, range: f32) -> f32 {
    // An endless range is +infinity; beyond its end the quotient may be, too.
    if bitcast<u32>(range) == 0x7f800000u {
        return 1.0;
    }
    if distance >= range {
        return 0.0;
    }
    let x = quotient(distance, range);
    let x2 = times(x, x);
    return clamp(1.0 - times(x2, x2), 0.0, 1.0);
}

/// The fall-off of a spot between its cones (KHR_lights_punctual, "Inner and Outer Cone Angles"), without that text's
/// bound of 0.001 on the difference of the cosines, which would dim narrow spots; 2^-24 only keeps the division
/// defined.
fn cone(cosine: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let x = clamp(quotient(cosine - cos_outer, max(cos_inner - cos_outer, 5.9604645e-8)), 0.0, 1.0);
    return times(x, x);
}
