// Sibling of environment.rs. The host takes an environment apart (`Backdrop::new`, `level_ahead`): `scene.backdrop` is the
// outcome.

// `tessera_pack::EnvironmentKind`.
const ENVIRONMENT_NONE: u32 = 0u;
const ENVIRONMENT_GRADIENT: u32 = 1u;
const ENVIRONMENT_MAP: u32 = 2u;

/// An environment ready for look-ups; 96 bytes.
struct Backdrop {
    up: vec3<f32>,
    kind: u32,
    /// Of a map: what its colours are multiplied by.
    zenith: vec3<f32>,
    /// Of a map: its texture.
    image: u32,
    /// Of a gradient, these two.
    horizon: vec3<f32>,
    nadir: vec3<f32>,
    /// Of a map, these two: level, towards the image's centre and to the right of it.
    ahead: vec3<f32>,
    right: vec3<f32>,
}

/// Whether a miss shows nothing at all.
fn backdrop_is_none() -> bool {
    return scene.backdrop.kind == ENVIRONMENT_NONE;
}

/// Linear radiance from the unit vector `direction`.
fn radiance(direction: vec3<f32>) -> vec3<f32> {
    if scene.backdrop.kind == ENVIRONMENT_GRADIENT {
        let height = clamp(dot3(direction, scene.backdrop.up), -1.0, 1.0);
        let pole = select(scene.backdrop.zenith, scene.backdrop.nadir, height < 0.0);
        return mixed(scene.backdrop.horizon, pole, abs(height));
    }
    if scene.backdrop.kind == ENVIRONMENT_MAP {
        // Longitude runs to the right from the image's centre, latitude down from its top.
        let height = clamp(dot3(direction, scene.backdrop.up), -1.0, 1.0);
        let longitude = atan2f(dot3(direction, scene.backdrop.right), dot3(direction, scene.backdrop.ahead));
        let uv = vec2<f32>(0.5 + kept(quotient(longitude, TAU)), times(acosf(height), FRAC_1_PI));

        // The image closes around the horizon and ends at the poles, whatever its own wrap modes say.
        let sampling = Sampling(WRAP_REPEAT, WRAP_CLAMP, false);
        return times3(lookup_as(scene.backdrop.image, sampling, uv, CODING_SRGB).xyz, scene.backdrop.zenith);
    }
    return vec3<f32>(0.0);
}
