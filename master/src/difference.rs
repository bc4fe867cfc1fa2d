//! How far two renders of the same tiles differ, as raw pixels of a frame's format.

use tessera_wire::PixelFormat;

/// Sums over tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// Tiles compared.
    pub tiles: u32,
    /// Their pixels.
    pub pixels: u64,
    /// Pixels with another byte anywhere: in alpha, depth, normal or triangle too.
    pub differing: u64,
    /// Largest difference of a red, green or blue value: in codes, for layers in linear light.
    pub max_abs: f64,
    squares: f64,
}

impl Difference {
    /// Adds a tile, rendered twice. Both have the bytes of whole pixels of `format`, and as many.
    pub fn add(&mut self, format: PixelFormat, a: &[u8], b: &[u8]) {
        let size = format.bytes_per_pixel();
        self.tiles += 1;
        for (a, b) in a.chunks_exact(size).zip(b.chunks_exact(size)) {
            self.pixels += 1;
            if a == b {
                continue;
            }
            self.differing += 1;
            for (a, b) in colour(format, a).into_iter().zip(colour(format, b)) {
                // What is not finite is far off, and must not hide behind a comparison with NaN.
                let difference = Some((a - b).abs()).filter(|d| d.is_finite()).unwrap_or(f32::MAX.into());
                self.max_abs = self.max_abs.max(difference);
                self.squares += difference * difference;
            }
        }
    }

    /// Of red, green and blue, as `tessera compare` counts it; `None` if they are equal.
    pub fn psnr_db(&self, format: PixelFormat) -> Option<f64> {
        let peak = match format {
            PixelFormat::Rgba8 => 255.0,
            PixelFormat::Rgba16 => 65_535.0,
            PixelFormat::Layers => 1.0,
        };
        let mse = self.squares / (3 * self.pixels.max(1)) as f64;
        (mse > 0.0).then(|| 10.0 * libm::log10(peak * peak / mse))
    }
}

/// Red, green and blue of a pixel.
fn colour(format: PixelFormat, pixel: &[u8]) -> [f64; 3] {
    std::array::from_fn(|channel| match format {
        PixelFormat::Rgba8 => pixel[channel].into(),
        PixelFormat::Rgba16 => u16::from_le_bytes([pixel[2 * channel], pixel[2 * channel + 1]]).into(),
        PixelFormat::Layers => {
            let at = 4 * channel;
            f32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]]).into()
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_tiles_do_not_differ() {
        for format in PixelFormat::ALL {
            let tile = vec![7; 10 * format.bytes_per_pixel()];
            let mut d = Difference::default();
            d.add(format, &tile, &tile);
            assert_eq!(d, Difference { tiles: 1, pixels: 10, ..Difference::default() });
            assert_eq!(d.psnr_db(format), None);
        }
    }

    #[test]
    fn one_code_everywhere_is_48_db_and_alpha_counts_as_a_pixel() {
        let mut d = Difference::default();
        d.add(PixelFormat::Rgba8, &[10, 20, 30, 40], &[11, 19, 31, 40]);
        assert!((d.psnr_db(PixelFormat::Rgba8).unwrap() - 48.130_803_608_679_1).abs() < 1e-9);
        d.add(PixelFormat::Rgba8, &[1, 2, 3, 4, 1, 2, 3, 4], &[1, 2, 3, 5, 1, 2, 3, 4]);
        assert_eq!((d.tiles, d.pixels, d.differing, d.max_abs), (2, 3, 2, 1.0));
    }

    #[test]
    fn sixteen_bits_and_layers_are_read_as_they_are_written() {
        let mut d = Difference::default();
        d.add(PixelFormat::Rgba16, &[0, 1, 0, 0, 0, 0, 9, 9], &[1, 3, 0, 0, 0, 0, 9, 9]);
        assert_eq!(d.max_abs, 513.0);
        let pixel = |green: f32| {
            let mut bytes = vec![0; 36];
            bytes[4..8].copy_from_slice(&green.to_le_bytes());
            bytes
        };
        let mut d = Difference::default();
        d.add(PixelFormat::Layers, &pixel(0.25), &pixel(0.5));
        assert_eq!(d.max_abs, 0.25);
        // 10 log10(3 / 0.0625).
        assert!((d.psnr_db(PixelFormat::Layers).unwrap() - 16.812_412_373_755_872).abs() < 1e-9);
        d.add(PixelFormat::Layers, &pixel(0.25), &pixel(f32::NAN));
        assert!(d.max_abs == f64::from(f32::MAX) && d.psnr_db(PixelFormat::Layers).unwrap() < 0.0);
    }
}
