//! What a ray sees that misses everything.

use crate::texture::{Coding, Images, Sampling};
use std::f32::consts::{FRAC_1_PI, TAU};
use tessera_geometry::{Vec2, Vec3};
use tessera_pack::{Environment, EnvironmentKind, Wrap};

/// An environment ready for look-ups.
pub(crate) enum Backdrop<'a> {
    /// Black and transparent.
    None,
    /// A gradient over the direction's height.
    Gradient { up: Vec3, zenith: Vec3, horizon: Vec3, nadir: Vec3 },
    /// An equirectangular image.
    Map { up: Vec3, ahead: Vec3, right: Vec3, scale: Vec3, texture: u32, images: Images<'a> },
}

impl<'a> Backdrop<'a> {
    pub(crate) fn new(environment: Environment, images: Images<'a>) -> Self {
        let up = Vec3::from(environment.up);
        let (zenith, horizon) = (Vec3::from(environment.zenith), Vec3::from(environment.horizon));
        if environment.kind == EnvironmentKind::Gradient as u32 {
            Self::Gradient { up, zenith, horizon, nadir: environment.nadir.into() }
        } else if environment.kind == EnvironmentKind::Map as u32 {
            let ahead = level_ahead(up);
            Self::Map {
                up,
                ahead,
                right: ahead.cross(up),
                scale: zenith,
                texture: environment.texture,
                images,
            }
        } else {
            Self::None
        }
    }

    /// Whether a miss shows nothing at all.
    pub(crate) fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    /// Linear radiance from the unit vector `direction`.
    pub(crate) fn radiance(&self, direction: Vec3) -> Vec3 {
        match self {
            Self::None => Vec3::ZERO,
            Self::Gradient { up, zenith, horizon, nadir } => {
                let height = direction.dot(*up).clamp(-1.0, 1.0);
                horizon.lerp(if height < 0.0 { *nadir } else { *zenith }, height.abs())
            }
            Self::Map { up, ahead, right, scale, texture, images } => {
                // Longitude runs to the right from the image's centre, latitude down from its top.
                let height = direction.dot(*up).clamp(-1.0, 1.0);
                let longitude = libm::atan2f(direction.dot(*right), direction.dot(*ahead));
                let uv = Vec2::new(0.5 + longitude / TAU, libm::acosf(height) * FRAC_1_PI);

                // The image closes around the horizon and ends at the poles, whatever its own wrap modes say.
                let sampling = Sampling { wrap_s: Wrap::Repeat, wrap_t: Wrap::Clamp, nearest: false };
                images.lookup_as(*texture, sampling, uv, Coding::Srgb).0 * *scale
            }
        }
    }
}

/// The level direction towards the image's centre: `+z` made perpendicular to `up`. When `up` itself is nearly `+z`
/// or `-z` (within 8 degrees: the scene stands on another axis) `-y` takes its place, which is where `+z` goes when
/// `y` is turned up to `z`.
pub(crate) fn level_ahead(up: Vec3) -> Vec3 {
    let wanted = if up.z.abs() > 0.99 { Vec3::NEG_Y } else { Vec3::Z };
    (wanted - up * wanted.dot(up)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_pack::Texture;
    use tessera_pack::color::srgb8_to_linear_table;

    fn assert_near(a: Vec3, b: Vec3) {
        assert!((a - b).abs().max_element() < 1e-5, "{a} is not {b}");
    }

    #[test]
    fn a_gradient_runs_over_height() {
        let environment = Environment {
            kind: EnvironmentKind::Gradient as u32,
            zenith: [0.0, 0.0, 1.0],
            horizon: [1.0; 3],
            nadir: [0.0, 1.0, 0.0],
            up: [0.0, 0.0, 1.0],
            ..Environment::default()
        };
        let backdrop = Backdrop::new(environment, Images::new(&[], &[]));
        assert_near(backdrop.radiance(Vec3::Z), Vec3::Z);
        assert_near(backdrop.radiance(Vec3::NEG_Z), Vec3::Y);
        assert_near(backdrop.radiance(Vec3::X), Vec3::ONE);
        assert_near(backdrop.radiance(Vec3::new(0.6, 0.0, 0.8)), Vec3::new(0.2, 0.2, 1.0));
        assert!(!backdrop.is_none());
    }

    #[test]
    fn a_map_shows_its_centre_ahead_and_its_right_half_to_the_right() {
        // 4 x 2: the columns face back-left, front-left, front-right, back-right; the top row is red, the lower one
        // green.
        let texel = |column: u32, row: u32| if row == 0 { 255 } else { 255 << 8 } | (85 * column) << 16;
        let texels: Vec<u32> = (0..8).map(|i| texel(i % 4, i / 4)).collect();
        let textures = [Texture { first_texel: 0, width: 4, height: 2, sampling: 0 }];
        let blue = |column: usize| srgb8_to_linear_table()[85 * column];
        for (up, ahead) in [(Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::NEG_Y), (Vec3::X, Vec3::Z)] {
            let environment = Environment {
                kind: EnvironmentKind::Map as u32,
                texture: 0,
                zenith: [2.0; 3],
                up: up.into(),
                ..Environment::default()
            };
            let backdrop = Backdrop::new(environment, Images::new(&textures, &texels));
            let right = ahead.cross(up);
            // Texel centres lie at 45 degrees to the axes.
            let level = |a: Vec3, b: Vec3| backdrop.radiance((a + b).normalize()).z;
            assert!((level(-ahead, -right) - 2.0 * blue(0)).abs() < 1e-5);
            assert!((level(ahead, -right) - 2.0 * blue(1)).abs() < 1e-5);
            assert!((level(ahead, right) - 2.0 * blue(2)).abs() < 1e-5);
            assert!((level(-ahead, right) - 2.0 * blue(3)).abs() < 1e-5);
            assert_near(backdrop.radiance(up).with_z(0.0), Vec3::new(2.0, 0.0, 0.0));
            assert_near(backdrop.radiance(-up).with_z(0.0), Vec3::new(0.0, 2.0, 0.0));
        }
    }
}
