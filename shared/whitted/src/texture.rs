//! Texture look-ups: wrapping, bilinear interpolation in linear light.

use tessera_geometry::mutation::{Mutation, is_on};
use tessera_geometry::{Vec2, Vec3};
use tessera_pack::color::srgb8_to_linear_table;
use tessera_pack::{Texture, Wrap};

/// How texels code their colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    /// Red, green and blue are sRGB codes.
    Srgb,
    /// They are plain numbers: metal, roughness, transmission.
    Linear,
}

/// How a look-up treats coordinates outside [0, 1) and between texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sampling {
    pub wrap_s: Wrap,
    pub wrap_t: Wrap,
    pub nearest: bool,
}

impl Sampling {
    /// Unpacks [`Texture::sampling`].
    pub(crate) fn of(texture: &Texture) -> Self {
        let wrap = |bits| match bits & 3 {
            0 => Wrap::Repeat,
            1 => Wrap::Mirror,
            _ => Wrap::Clamp,
        };
        Self {
            wrap_s: wrap(texture.sampling),
            wrap_t: wrap(texture.sampling >> 2),
            nearest: texture.sampling & 16 != 0,
        }
    }
}

/// The pictures of a pack.
#[derive(Clone, Copy)]
pub(crate) struct Images<'a> {
    pub textures: &'a [Texture],
    texels: &'a [u32],
    srgb: &'static [f32; 256],
}

/// The four texels around a point, and how far it lies from the upper left one.
struct Footprint {
    texel: [u32; 4],
    across: f32,
    down: f32,
}

impl<'a> Images<'a> {
    pub(crate) fn new(textures: &'a [Texture], texels: &'a [u32]) -> Self {
        Self { textures, texels, srgb: srgb8_to_linear_table() }
    }

    /// Colour and alpha of texture `index` at `uv`: (0, 0) is the image's upper left corner, texel centres lie at +
    /// 0.5.
    pub(crate) fn lookup(&self, index: u32, uv: Vec2, coding: Coding) -> (Vec3, f32) {
        self.lookup_as(index, Sampling::of(&self.textures[index as usize]), uv, coding)
    }

    /// [`Self::lookup`] with another sampling than the texture's own.
    pub(crate) fn lookup_as(&self, index: u32, sampling: Sampling, uv: Vec2, coding: Coding) -> (Vec3, f32) {
        let f = self.footprint(index, sampling, uv);
        let [a, b, c, d] = f.texel.map(|texel| self.color_of(texel, coding));
        let color = lerp(lerp(a, b, f.across), lerp(c, d, f.across), f.down);
        (color, blend_alpha(&f))
    }

    /// The alpha of [`Self::lookup`] alone, bit for bit.
    pub(crate) fn lookup_alpha(&self, index: u32, uv: Vec2) -> f32 {
        blend_alpha(&self.footprint(index, Sampling::of(&self.textures[index as usize]), uv))
    }

    fn footprint(&self, index: u32, sampling: Sampling, uv: Vec2) -> Footprint {
        // Find the neighbours on each axis.
        let texture = &self.textures[index as usize];
        let (x0, x1, across) = neighbours(uv.x, texture.width, sampling.wrap_s, sampling.nearest);
        let (y0, y1, down) = neighbours(uv.y, texture.height, sampling.wrap_t, sampling.nearest);

        // Fetch them; a pack's texel section covers every texture, so the index is in range.
        let fetch = |x: u32, y: u32| {
            self.texels[texture.first_texel as usize + y as usize * texture.width as usize + x as usize]
        };
        Footprint { texel: [fetch(x0, y0), fetch(x1, y0), fetch(x0, y1), fetch(x1, y1)], across, down }
    }

    fn color_of(&self, texel: u32, coding: Coding) -> Vec3 {
        let [r, g, b, _] = texel.to_le_bytes();
        match coding {
            Coding::Srgb => {
                Vec3::new(self.srgb[usize::from(r)], self.srgb[usize::from(g)], self.srgb[usize::from(b)])
            }
            Coding::Linear => Vec3::new(f32::from(r), f32::from(g), f32::from(b)) * (1.0 / 255.0),
        }
    }
}

/// The texels on both sides of `coordinate` on an axis of `size` texels, and the share of the second.
fn neighbours(coordinate: f32, size: u32, wrap: Wrap, nearest: bool) -> (u32, u32, f32) {
    // Bring the coordinate into [0, 1]. Where f32 has no fractions left the difference is 0; an infinite coordinate
    // makes a NaN, which is not above 0.
    let folded = match wrap {
        Wrap::Repeat => coordinate - coordinate.floor(),
        Wrap::Mirror => {
            let two = coordinate - 2.0 * (coordinate * 0.5).floor();
            if two > 1.0 { 2.0 - two } else { two }
        }
        Wrap::Clamp => coordinate,
    };
    let at = if folded > 0.0 { folded.min(1.0) * size as f32 } else { 0.0 };

    // Take the texel that holds the point; 1.0 itself belongs to the last.
    let last = size - 1;
    if nearest {
        let texel = (at as u32).min(last);
        return (texel, texel, 0.0);
    }

    // Or the two whose centres enclose it; beyond the border comes the other end when repeating, else the same texel
    // again.
    let from_centre = at - 0.5;
    let floor = from_centre.floor();
    let first = floor as i64;
    let (before, after) =
        if wrap == Wrap::Repeat && !is_on(Mutation::WrapClamped) { (last, 0) } else { (0, last) };
    let low = if first < 0 { before } else { (first as u32).min(last) };
    let high = if first >= i64::from(last) { after } else { (first + 1) as u32 };
    (low, high, from_centre - floor)
}

fn blend_alpha(f: &Footprint) -> f32 {
    let [a, b, c, d] = f.texel.map(|texel| (texel >> 24) as f32 * (1.0 / 255.0));
    let top = a + (b - a) * f.across;
    let bottom = c + (d - c) * f.across;
    top + (bottom - top) * f.down
}

fn lerp(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    a + (b - a) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];

    /// A row of four texels with red 0, 60, 120, 240 and alpha 255, 0, 255, 0.
    fn row(sampling: u32) -> (Vec<u32>, Texture) {
        let texels = vec![0xff00_0000, 60, 0xff00_0000 | 120, 240];
        (texels, Texture { first_texel: 0, width: 4, height: 1, sampling })
    }

    fn red(wrap: Wrap, nearest: bool, u: f32) -> f32 {
        let (texels, texture) = row(wrap as u32 | (wrap as u32) << 2 | u32::from(nearest) << 4);
        Images::new(&[texture], &texels).lookup(0, Vec2::new(u, 0.3), Coding::Linear).0.x * 255.0
    }

    #[test]
    fn interpolates_between_texel_centres() {
        for wrap in WRAPS {
            for (u, wanted) in [(0.125, 0.0), (0.25, 30.0), (0.375, 60.0), (0.4375, 75.0), (0.875, 240.0)] {
                assert!((red(wrap, false, u) - wanted).abs() < 1e-4, "{wrap:?} at {u}");
            }
        }
    }

    #[test]
    fn wraps_as_its_mode_says() {
        // (u, repeat, mirror, clamp), worked out by hand.
        for (u, repeat, mirror, clamp) in [
            (0.0, 120.0, 0.0, 0.0),
            (1.0, 120.0, 240.0, 240.0),
            (-0.125, 240.0, 0.0, 0.0),
            (1.125, 0.0, 240.0, 240.0),
            (1.25, 30.0, 180.0, 240.0),
            (-0.25, 180.0, 30.0, 0.0),
            (2.375, 60.0, 60.0, 240.0),
            (-7.625, 60.0, 60.0, 0.0),
        ] {
            for (wrap, wanted) in WRAPS.into_iter().zip([repeat, mirror, clamp]) {
                assert!(
                    (red(wrap, false, u) - wanted).abs() < 1e-4,
                    "{wrap:?} at {u}: {}",
                    red(wrap, false, u)
                );
            }
        }
    }

    #[test]
    fn nearest_takes_the_texel_that_holds_the_point() {
        for (u, repeat, mirror, clamp) in [
            (0.0, 0.0, 0.0, 0.0),
            (0.249, 0.0, 0.0, 0.0),
            (0.25, 60.0, 60.0, 60.0),
            (0.99, 240.0, 240.0, 240.0),
            (1.0, 0.0, 240.0, 240.0),
            (1.3, 60.0, 120.0, 240.0),
            (-0.3, 120.0, 60.0, 0.0),
        ] {
            for (wrap, wanted) in WRAPS.into_iter().zip([repeat, mirror, clamp]) {
                assert!((red(wrap, true, u) - wanted).abs() < 1e-4, "{wrap:?} at {u}");
            }
        }
    }

    #[test]
    fn blends_both_axes_in_linear_light() {
        // 2 x 2: black, white over white, black; the middle is half the light, whatever the codes say.
        let (black, white) = (0xff00_0000, 0xffff_ffff);
        let texture = Texture { first_texel: 1, width: 2, height: 2, sampling: 0 };
        let texels = [7, black, white, white, black];
        let at = |u, v| Images::new(&[texture], &texels).lookup(0, Vec2::new(u, v), Coding::Srgb).0;
        assert_eq!(at(0.5, 0.5), Vec3::splat(0.5));
        assert_eq!(at(0.25, 0.25), Vec3::ZERO);
        assert_eq!(at(0.75, 0.25), Vec3::ONE);
        // A quarter of the way right and three quarters down: 0.25 * 0.25 + 0.75 * 0.75 of white.
        assert!((at(0.375, 0.625) - Vec3::splat(0.625)).abs().max_element() < 1e-6);
    }

    #[test]
    fn alpha_is_linear_and_the_same_alone() {
        let (texels, texture) = row(0);
        let textures = [texture];
        let images = Images::new(&textures, &texels);
        for i in -40..80 {
            let uv = Vec2::new(i as f32 * 0.037, 0.5);
            let both = images.lookup(0, uv, Coding::Srgb).1;
            assert_eq!(both.to_bits(), images.lookup_alpha(0, uv).to_bits());
        }
        assert_eq!(images.lookup_alpha(0, Vec2::new(0.25, 0.5)), 0.5);
    }

    #[test]
    fn no_coordinate_leaves_the_image() {
        let huge = [f32::MAX, 1e30, 16_777_217.0, 1e9, f32::MIN_POSITIVE, 1e-45, 1.0f32.next_down(), 1.0];
        for (width, height) in [(1, 1), (1, 3), (5, 1), (4, 2), (1 << 14, 1)] {
            let texels = vec![0x8040_2010; width * height];
            for wrap in WRAPS {
                for nearest in [false, true] {
                    let texture =
                        Texture { first_texel: 0, width: width as u32, height: height as u32, sampling: 0 };
                    let sampling = Sampling { wrap_s: wrap, wrap_t: wrap, nearest };
                    for u in huge.into_iter().flat_map(|u| [u, -u]).chain([f32::NAN, f32::INFINITY]) {
                        let (color, alpha) = Images::new(&[texture], &texels).lookup_as(
                            0,
                            sampling,
                            Vec2::new(u, -u),
                            Coding::Linear,
                        );
                        assert!(
                            (color.x * 255.0 - 16.0).abs() < 1e-4 && (alpha * 255.0 - 128.0).abs() < 1e-4
                        );
                    }
                }
            }
        }
    }
}
