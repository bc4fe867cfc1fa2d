use super::*;
use proptest::prelude::*;

/// A picture with smooth, flat, noisy and edged parts; of any bytes.
fn picture(format: PixelFormat, width: u32, height: u32) -> Vec<u8> {
    let mut noise = 1_u32;
    let mut next = move || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        noise >> 16
    };
    let mut pixels = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let shade = match (x / 8 + y / 8) % 4 {
            0 => 90,
            1 => x * 3 + y * 2,
            2 => 60 + x + next() % 16,
            _ => next(),
        };
        match format {
            PixelFormat::Rgba8 => {
                let codes = [shade, shade + 7, shade.wrapping_mul(2), 255].map(|code| code as u8);
                pixels.extend(codes);
            }
            PixelFormat::Rgba16 => {
                let codes = [shade * 200, shade * 201, next(), 65_535].map(|code| code as u16);
                pixels.extend(codes.into_iter().flat_map(u16::to_le_bytes));
            }
            PixelFormat::Layers => {
                let depth = if shade == 90 { f32::INFINITY } else { shade as f32 * 0.1 };
                let floats = [shade as f32 / 255.0, 0.5, -0.0, 1.0, depth, 0.6, -0.8, f32::NAN];
                pixels.extend(floats.into_iter().flat_map(f32::to_le_bytes));
                pixels.extend((shade / 16).to_le_bytes());
            }
        }
    }
    pixels
}

#[test]
fn what_is_packed_comes_back() {
    for (format, size) in PixelFormat::ALL.into_iter().flat_map(|format| {
        [(1, 1), (64, 64), (33, 47), (1, 200), (200, 1), (128, 128)].map(|size| (format, size))
    }) {
        let (width, height) = size;
        let mut pixels = picture(format, width, height);
        for coding in [Coding::Lossless, Coding::Rounded] {
            if coding == Coding::Rounded {
                round(format, &mut pixels);
            }
            match encode(format, width, &pixels, coding) {
                Some(packed) => {
                    assert!(packed.len() < pixels.len());
                    assert_eq!(decode(pixels.len(), &packed).as_ref(), Ok(&pixels), "{format} {size:?}");
                }
                None => {
                    assert!(pixels.len() < 1000, "{format} {size:?}: a picture of this size can be packed")
                }
            }
        }
        assert_eq!(encode(format, width, &pixels, Coding::Raw), None);
    }
}

#[test]
fn a_packer_has_no_memory_of_earlier_tiles() {
    let mut packer = Packer::default();
    for (width, height) in [(64, 64), (8, 100), (64, 64)] {
        for format in PixelFormat::ALL {
            let pixels = picture(format, width, height);
            let again = packer.pack(format, width, &pixels, Coding::Lossless);
            assert_eq!(again, encode(format, width, &pixels, Coding::Lossless));
        }
    }
}

#[test]
fn what_is_no_tile_or_noise_travels_raw() {
    let noise: Vec<u8> = (0..64 * 64 * 4_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let mut hashed = noise.clone();
    // Multiples of a constant follow each other too regularly.
    for k in 1..hashed.len() {
        hashed[k] = hashed[k].wrapping_mul(31).wrapping_add(hashed[k - 1].rotate_left(3) ^ noise[k / 2]);
    }
    assert_eq!(encode(PixelFormat::Rgba8, 64, &hashed, Coding::Lossless), None);
    for (width, length) in [(0, 4), (3, 16), (u32::MAX, 16), (1, 0)] {
        assert_eq!(encode(PixelFormat::Rgba8, width, &vec![0; length], Coding::Lossless), None);
    }
}

/// The bytes of a tile: a change of them is a change of the protocol.
#[test]
fn golden_bytes() {
    let pixels: Vec<u8> =
        (0..64).flat_map(|k: u8| [10 + k % 8, 20 + 2 * (k % 8), 30 + k / 8 * 20, 255]).collect();
    let packed = encode(PixelFormat::Rgba8, 8, &pixels, Coding::Lossless).expect("it is smooth");
    let hex: String = packed.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, GOLDEN);
    assert_eq!(decode(pixels.len(), &packed), Ok(pixels));
}

const GOLDEN: &str = "0007002a00002000000000000000000000100000000000002000000000001310062c00002000000000000000000000001000000000000020000000000023200c2d000200000000000000000000000000000000000000100200001010007343000440000440000440001b000010000000000000000000000100000000d007";

#[test]
fn rounding_is_within_its_bound_and_keeps_black_white_and_alpha() {
    let mut codes: Vec<u8> = (0..=255).flat_map(|code| [code, code, code, code]).collect();
    round(PixelFormat::Rgba8, &mut codes);
    for (code, pixel) in codes.chunks_exact(4).enumerate() {
        assert!(pixel[..3].iter().all(|rounded| usize::from(*rounded).abs_diff(code) <= 1), "{code}");
        assert!(pixel[0] % 3 == 0 && usize::from(pixel[3]) == code);
    }
    assert_eq!((&codes[..4], &codes[1020..]), (&[0; 4][..], &[255; 4][..]));

    let mut codes: Vec<u8> = (0..=u16::MAX).flat_map(|c| [c, c, c, c]).flat_map(u16::to_le_bytes).collect();
    round(PixelFormat::Rgba16, &mut codes);
    let (mut values, mut worst) = (std::collections::BTreeSet::new(), 0);
    for (code, pixel) in codes.chunks_exact(8).enumerate() {
        let [red, alpha] = [0, 6].map(|at| u16::from_le_bytes([pixel[at], pixel[at + 1]]));
        values.insert(red);
        worst = worst.max(usize::from(red).abs_diff(code));
        assert_eq!(usize::from(alpha), code);
    }
    assert_eq!((worst, values.len()), (256, 129));
    assert!(values.contains(&0) && values.contains(&65_535));

    // What is on the grid stays there, so that it does not matter how often a tile is rounded.
    let before = codes.clone();
    round(PixelFormat::Rgba16, &mut codes);
    assert!(codes == before);
    let mut layers = picture(PixelFormat::Layers, 8, 8);
    let before = layers.clone();
    round(PixelFormat::Layers, &mut layers);
    assert_eq!(layers, before);
}

#[test]
fn bytes_that_are_cut_off_or_too_many_are_refused() {
    for format in PixelFormat::ALL {
        let pixels = picture(format, 24, 24);
        let packed = encode(format, 24, &pixels, Coding::Lossless).expect("it is smooth in parts");
        for length in 0..packed.len() {
            assert!(
                decode(pixels.len(), &packed[..length]).is_err(),
                "{format}: {length} of {}",
                packed.len()
            );
        }
        assert!(decode(pixels.len(), &[&packed[..], &[0]].concat()).is_err());
        // As many pixels as there are, in whole rows.
        let row = 24 * format.bytes_per_pixel();
        for bytes in [0, 1, row - 1, pixels.len() - 1, pixels.len() - row, pixels.len() + row] {
            assert!(decode(bytes, &packed).is_err(), "{format}: {bytes}");
        }
    }
}

#[test]
fn a_flag_that_nobody_knows_is_refused() {
    let pixels = picture(PixelFormat::Rgba8, 24, 24);
    let mut packed =
        encode(PixelFormat::Rgba8, 24, &pixels, Coding::Lossless).expect("it is smooth in parts");
    for flags in [3, 16, 32, 64, 128, 2 | GREEN, 2 | GRID] {
        packed[0] = flags;
        assert!(decode(pixels.len(), &packed).is_err(), "{flags}");
    }
}

proptest! {
    /// Any bytes behind a valid header, and a valid tile with some of its bytes changed: pixels or an error, and no panic.
    #[test]
    fn hostile_bytes_do_no_harm(
        flags in 0_u8..16,
        noise in prop::collection::vec(any::<u8>(), 0..400),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        format in prop::sample::select(&PixelFormat::ALL[..]),
    ) {
        let bytes = [&[flags, 7, 0], &noise[..]].concat();
        for bytes_per_pixel in [4, 8, 36] {
            if let Ok(pixels) = decode(64 * bytes_per_pixel, &bytes) {
                prop_assert_eq!(pixels.len(), 64 * bytes_per_pixel);
            }
        }
        let pixels = picture(format, 16, 16);
        if let Some(mut packed) = encode(format, 16, &pixels, Coding::Lossless) {
            for (at, byte) in changes {
                let at = at.index(packed.len());
                packed[at] = byte;
            }
            if let Ok(decoded) = decode(pixels.len(), &packed) {
                prop_assert_eq!(decoded.len(), pixels.len());
            }
        }
    }

    /// Any bytes as pixels.
    #[test]
    fn any_pixels_come_back(
        width in 1_u32..20,
        rows in 1_usize..10,
        mask in any::<u8>(),
        seed in prop::collection::vec(any::<u8>(), 36 * 200),
        format in prop::sample::select(&PixelFormat::ALL[..]),
    ) {
        let length = rows * width as usize * format.bytes_per_pixel();
        let mut pixels: Vec<u8> = seed[..length].iter().map(|byte| byte & mask).collect();
        for coding in [Coding::Lossless, Coding::Rounded] {
            if coding == Coding::Rounded {
                round(format, &mut pixels);
            }
            if let Some(packed) = encode(format, width, &pixels, coding) {
                prop_assert_eq!(decode(length, &packed), Ok(pixels.clone()));
            }
        }
    }
}
