//! Pictures on surfaces, in `f64`: texel centres lie at whole numbers and a half, (0, 0) is the upper left corner; between centres
//! light is mixed linearly in linear light.

use crate::digest::Digest;
use glam::DVec3;
use std::sync::{Arc, LazyLock};
use tessera_scene::{Image, TextureRef, Wrap};

/// How texels code their colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    /// By the curve of sRGB.
    Srgb,
    /// As plain shares of 255.
    Linear,
}

/// A picture.
pub(crate) struct Picture {
    width: u32,
    height: u32,
    rgba: Arc<[u8]>,
}

/// Linear light of the codes of sRGB (IEC 61966-2-1).
static SRGB: LazyLock<[f64; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        let coded = code as f64 / 255.0;
        if coded <= 0.04045 { coded / 12.92 } else { libm::pow((coded + 0.055) / 1.055, 2.4) }
    })
});

/// Linear light of a code.
pub(crate) fn light_of(code: u8) -> f64 {
    SRGB[usize::from(code)]
}

impl Picture {
    /// `None` when it has no texels, or not those that its size asks for.
    pub(crate) fn new(image: &Image) -> Option<Self> {
        let bytes = u128::from(image.width) * u128::from(image.height) * 4;
        let is_whole = bytes > 0 && image.rgba.len() as u128 == bytes;
        is_whole.then(|| Self { width: image.width, height: image.height, rgba: image.rgba.clone() })
    }

    pub(crate) fn digest(&self, digest: &mut Digest) {
        digest.u64(u64::from(self.width));
        digest.u64(u64::from(self.height));
        digest.bytes(&self.rgba);
    }

    /// Colour and alpha at `uv`.
    pub(crate) fn at(&self, uv: [f64; 2], sampling: &TextureRef, coding: Coding) -> (DVec3, f64) {
        let columns = Span::new(uv[0], self.width, sampling.wrap_s, sampling.nearest);
        let rows = Span::new(uv[1], self.height, sampling.wrap_t, sampling.nearest);
        let mut color = DVec3::ZERO;
        let mut alpha = 0.0;
        for (row, row_share) in rows.texels {
            for (column, column_share) in columns.texels {
                let first = (row as usize * self.width as usize + column as usize) * 4;
                let texel = &self.rgba[first..first + 4];
                let share = row_share * column_share;
                let value = |code: u8| match coding {
                    Coding::Srgb => light_of(code),
                    Coding::Linear => f64::from(code) / 255.0,
                };
                color += DVec3::new(value(texel[0]), value(texel[1]), value(texel[2])) * share;
                alpha += f64::from(texel[3]) / 255.0 * share;
            }
        }
        (color, alpha)
    }
}

/// The two texels of an axis that a point lies between, each with its share.
struct Span {
    texels: [(u32, f64); 2],
}

impl Span {
    fn new(coordinate: f64, size: u32, wrap: Wrap, nearest: bool) -> Self {
        // What repeats is the same a whole number of pictures farther: there small numbers keep their fractions.
        let period = match wrap {
            Wrap::Repeat => 1.0,
            Wrap::Mirror => 2.0,
            Wrap::Clamp => f64::INFINITY,
        };
        let coordinate =
            if wrap == Wrap::Clamp { coordinate.clamp(0.0, 1.0) } else { coordinate.rem_euclid(period) };
        let place = coordinate * f64::from(size);
        if nearest {
            let texel = wrapped(place.floor() as i64, size, wrap);
            return Self { texels: [(texel, 1.0), (texel, 0.0)] };
        }
        let before = (place - 0.5).floor();
        let share = place - 0.5 - before;
        let texel = |step: i64| wrapped(before as i64 + step, size, wrap);
        Self { texels: [(texel(0), 1.0 - share), (texel(1), share)] }
    }
}

/// The texel at place `index` of an endless row.
fn wrapped(index: i64, size: u32, wrap: Wrap) -> u32 {
    let size = i64::from(size);
    let texel = match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Mirror => {
            let index = index.rem_euclid(2 * size);
            if index < size { index } else { 2 * size - 1 - index }
        }
        Wrap::Clamp => index.clamp(0, size - 1),
    };
    // In [0, size).
    texel as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of four texels, red 0, 60, 120, 240, alpha 255, 0, 255, 0.
    fn red(wrap: Wrap, nearest: bool, u: f64) -> (f64, f64) {
        let texel = |red: u8, alpha: u8| [red, 9, 9, alpha];
        let rgba = [texel(0, 255), texel(60, 0), texel(120, 255), texel(240, 0)].concat();
        let image = Image { name: String::new(), width: 4, height: 1, rgba: rgba.into() };
        let sampling = TextureRef { image: 0, wrap_s: wrap, wrap_t: wrap, nearest };
        let (color, alpha) = Picture::new(&image).expect("whole").at([u, 0.3], &sampling, Coding::Linear);
        (color.x * 255.0, alpha)
    }

    #[test]
    fn light_is_mixed_between_centres() {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for (u, wanted, alpha) in
                [(0.125, 0.0, 1.0), (0.25, 30.0, 0.5), (0.4375, 75.0, 0.25), (0.875, 240.0, 0.0)]
            {
                let found = red(wrap, false, u);
                assert!(
                    (found.0 - wanted).abs() < 1e-12 && (found.1 - alpha).abs() < 1e-14,
                    "{wrap:?} {u}: {found:?}"
                );
            }
        }
        // sRGB: the middle between black and white is half the light, not the light of the middle code.
        let image =
            Image { name: String::new(), width: 2, height: 1, rgba: [[0; 4], [255; 4]].concat().into() };
        let sampling = TextureRef { image: 0, wrap_s: Wrap::Clamp, wrap_t: Wrap::Clamp, nearest: false };
        let middle = Picture::new(&image).expect("whole").at([0.5, 0.5], &sampling, Coding::Srgb);
        assert_eq!(middle, (DVec3::splat(0.5), 0.5));
    }

    #[test]
    fn each_way_to_wrap() {
        let cases = [
            // Between the last and the first; one picture on; far out.
            (Wrap::Repeat, [(0.0, 120.0), (1.0, 120.0), (1.25, 30.0), (-0.875, 0.0), (4097.25, 30.0)]),
            // The border texel beside itself; back again.
            (Wrap::Mirror, [(0.0, 0.0), (1.0, 240.0), (1.25, 180.0), (-0.25, 30.0), (4098.25, 30.0)]),
            (Wrap::Clamp, [(0.0, 0.0), (1.0, 240.0), (1.25, 240.0), (-0.25, 0.0), (4097.25, 240.0)]),
        ];
        for (wrap, places) in cases {
            for (u, wanted) in places {
                let (found, _) = red(wrap, false, u);
                assert!((found - wanted).abs() < 1e-9, "{wrap:?} at {u}: {found}, not {wanted}");
            }
        }
        for (wrap, beyond) in [(Wrap::Repeat, 0.0), (Wrap::Mirror, 240.0), (Wrap::Clamp, 240.0)] {
            for (u, wanted) in [(0.0, 0.0), (0.249, 0.0), (0.25, 60.0), (0.999, 240.0), (1.001, beyond)] {
                let (found, _) = red(wrap, true, u);
                assert!((found - wanted).abs() < 1e-12, "{wrap:?} at {u}: {found}, not {wanted}");
            }
        }
    }

    #[test]
    fn a_picture_without_its_texels_is_none() {
        let image = |width, height, bytes: usize| Image {
            name: String::new(),
            width,
            height,
            rgba: vec![0; bytes].into(),
        };
        assert!(Picture::new(&image(2, 2, 16)).is_some());
        for broken in [image(2, 2, 15), image(0, 2, 0), image(u32::MAX, u32::MAX, 4)] {
            assert!(Picture::new(&broken).is_none());
        }
    }
}
