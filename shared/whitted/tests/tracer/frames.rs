//! Pixels as bytes: formats, blocks, samples, layers.

use crate::support::*;
use tessera_geometry::{DVec3, Hit};
use tessera_pack::{ImageInput, Material, MaterialFlags, Plain, Wrap};
use tessera_whitted::{PixelBlock, PixelFormat, RayCounts, Renderer};

/// A bit of everything: mirror, glass, veil, mask, textures, several lights.
pub fn mixed_scene() -> Stage {
    let mut stage = Stage::default();
    stage.input.textures = vec![ImageInput {
        width: 16,
        height: 16,
        rgba: (0..1024u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect(),
        wrap_s: Wrap::Mirror,
        ..ImageInput::default()
    }];
    let textured = Material { base_texture: 0, ..Material::default() };
    stage.quad([-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0], textured);
    stage.quad(
        [-5.0, -1.0, -5.0],
        [10.0, 0.0, 0.0],
        [0.0, 6.0, 0.0],
        Material { roughness: 0.4, ..mirror(0.8) },
    );
    stage.ball([-1.2, 0.0, 0.0], 1.0, 12, mirror(0.9));
    stage.ball([1.2, 0.0, 0.5], 1.0, 12, glass(1.5));
    let cut = Material { flags: MaterialFlags::ALPHA_MASK, ..textured };
    stage.quad([-1.0, -1.0, 2.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.3], cut);
    let veil = Material { base_color: [0.9, 0.2, 0.1, 0.4], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    stage.quad([0.5, -1.0, 2.5], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0], veil);
    stage.light(point_light([2.0, 4.0, 3.0], 60.0));
    stage.light(directional_light([-1.0, -1.0, -0.5], 1.0));
    stage
}

pub fn mixed_view() -> View {
    look([0.3, 1.0, 7.0], [0.0, 0.0, 0.0]).sized(37, 29)
}

#[test]
fn a_pixel_does_not_depend_on_its_block() {
    let pack = mixed_scene().pack_with(Plain::default()).expect("a packable scene");
    for (samples, format) in
        [(1, PixelFormat::Rgba8), (3, PixelFormat::Rgba8), (2, PixelFormat::Rgba16), (3, PixelFormat::Layers)]
    {
        let view = View { samples, ..mixed_view() };
        let params = view.params(&pack, format);
        let (whole, counts) = view.bytes(&pack, format);
        let size = format.bytes_per_pixel();
        let renderer = Renderer::new(&pack);
        for (width, height) in [(1, 1), (37, 1), (8, 8)] {
            let mut sum = RayCounts::default();
            for (x, y) in
                (0..29).step_by(height).flat_map(|y| (0..37).step_by(width).map(move |x| (x, y as u32)))
            {
                let block = PixelBlock { x, y, width: width as u32, height: height as u32 };
                let block =
                    PixelBlock { width: block.width.min(37 - x), height: block.height.min(29 - y), ..block };
                let mut part = vec![0; block.byte_len(format)];
                sum += renderer.render_block(&params, block, &mut part);
                for (row, bytes) in part.chunks_exact(block.width as usize * size).enumerate() {
                    let at = ((y as usize + row) * 37 + x as usize) * size;
                    assert_eq!(bytes, &whole[at..at + bytes.len()], "{format:?}, row {row} of {block:?}");
                }
            }
            assert_eq!(sum, counts);
        }
    }
}

#[test]
fn an_empty_block_and_the_free_function_work_alike() {
    let pack = mixed_scene().pack();
    let view = mixed_view();
    let params = view.params(&pack, PixelFormat::Rgba8);
    let nothing = PixelBlock { x: 3, y: 4, width: 0, height: 7 };
    let renderer = Renderer::new(&pack);
    assert_eq!(renderer.render_block(&params, nothing, &mut []), RayCounts::default());
    let all = PixelBlock { x: 0, y: 0, width: 37, height: 29 };
    let mut out = vec![0; all.byte_len(PixelFormat::Rgba8)];
    renderer.render_block(&params, all, &mut out);
    assert_eq!(out, view.bytes(&pack, PixelFormat::Rgba8).0);
}

#[test]
fn layers_name_what_the_pixel_centre_sees() {
    let mut stage = Stage::default();
    stage.cuboid([-1.0, -1.0, -9.0], [-0.5, 1.0, -8.0], chalk());
    let first = stage.input.triangles.len() as u32;
    stage.quad([0.0, 0.0, -3.0], [2.0, 0.0, 0.0], [0.0, 2.0, 2.0], unlit([0.25, 0.5, 1.0]));
    let pack = stage.pack();
    for samples in [1, 4] {
        // In world units, along the ray; from behind the normal stays as it winds.
        for (eye, depth) in [([1.5, 0.75, 5.0], 7.25), ([1.5, 0.75, -6.0], 3.75)] {
            let mut view = View { samples, ..look(eye, [1.5, 0.75, -2.25]) };
            view.pose.fov_degrees = 0.01;
            let pixel = view.pixel(&pack);
            assert!((pixel.depth - depth).abs() < 1e-5, "{pixel:?}");
            assert_eq!((pixel.color, pixel.alpha, pixel.id), ([0.25, 0.5, 1.0], 1.0, first));
            let s = 0.5f32.sqrt();
            let error =
                DVec3::new(0.0, -f64::from(s), f64::from(s)) - DVec3::from(pixel.normal.map(f64::from));
            assert!(error.length() < 1e-6, "{pixel:?}");
        }
        let pixel = View { samples, ..look([5.0, 5.0, 5.0], [5.0, 5.0, 0.0]) }.pixel(&pack);
        let miss = Layers {
            color: [0.0; 3],
            alpha: 0.0,
            depth: f32::INFINITY,
            normal: [0.0; 3],
            id: Hit::NO_TRIANGLE,
        };
        assert_eq!(pixel, miss);
    }
}

/// One pixel's bytes of a scene whose middle shows `material`.
fn bytes_of(material: Material, surroundings: bool, format: PixelFormat) -> Vec<u8> {
    let mut stage = Stage::default();
    stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], material);
    if surroundings {
        stage.surround();
    }
    look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]).bytes(&stage.pack(), format).0
}

#[test]
fn integer_formats_hold_straight_srgb_and_linear_alpha() {
    let blended = |alpha| Material {
        flags: MaterialFlags::UNLIT | MaterialFlags::ALPHA_BLEND,
        base_color: [0.25, 1.0, 0.5, alpha],
        ..chalk()
    };
    // 0.21404 linear is code 127.5 / 255: it rounds up, or in 16 bits to the middle.
    let [r, g, b] = [0.214_041_2, 1.0, 0.0];
    assert_eq!(bytes_of(unlit([r, g, b]), false, PixelFormat::Rgba8), [128, 255, 0, 255]);
    let words: Vec<u16> = bytes_of(unlit([r, g, b]), false, PixelFormat::Rgba16)
        .chunks_exact(2)
        .map(|w| u16::from_le_bytes([w[0], w[1]]))
        .collect();
    assert_eq!(words, [32768, 65535, 0, 65535]);
    // A veil over nothing keeps its colour and has its own alpha; over surroundings it is opaque and mixed with them.
    assert_eq!(bytes_of(blended(0.4), false, PixelFormat::Rgba8)[3], 102);
    assert_eq!(bytes_of(blended(0.4), false, PixelFormat::Rgba8)[1], 255);
    assert_eq!(bytes_of(blended(0.4), true, PixelFormat::Rgba8)[3], 255);
    let layers = decode(&bytes_of(blended(0.5), false, PixelFormat::Layers))[0];
    assert_eq!((layers.color[1], layers.alpha), (0.5, 0.5));
}

#[test]
fn a_miss_is_transparent_or_shows_the_surroundings() {
    let mut stage = Stage::default();
    stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], chalk());
    let away = look([0.1, 0.2, 2.0], [0.1, 0.2, 5.0]);
    assert_eq!(away.bytes(&stage.clone().pack(), PixelFormat::Rgba8).0, [0; 4]);
    stage.surround();
    assert_eq!(away.bytes(&stage.pack(), PixelFormat::Rgba8).0, [255; 4]);
}

#[test]
fn coverage_is_the_share_of_samples_that_hit() {
    // The edge of a sheet runs through the pixel's middle.
    let mut stage = Stage::default();
    stage.quad([0.0, -9.0, 0.0], [9.0, 0.0, 0.0], [0.0, 18.0, 0.0], unlit([1.0; 3]));
    let pack = stage.pack();
    let view = View { samples: 64, ..look([0.0, 0.0, 2.0], [0.0; 3]) };
    let pixel = view.pixel(&pack);
    assert_eq!((pixel.alpha, pixel.color), (0.5, [0.5; 3]), "stratified in columns: exactly half");
    assert_eq!(view.bytes(&pack, PixelFormat::Rgba8).0, [255, 255, 255, 128], "straight colour");
    assert_eq!(view.bytes(&pack, PixelFormat::Rgba8).1.primary, 64);
    assert_eq!(view.layers(&pack).1.primary, 65, "one more for the layers");
}

#[test]
fn frames_differ_by_their_number_only_where_samples_are_many() {
    let pack = mixed_scene().pack();
    let render = |samples: u32, frame: u64| {
        let view = View { samples, ..mixed_view() };
        let params = tessera_whitted::FrameParams { frame, ..view.params(&pack, PixelFormat::Rgba8) };
        let block = PixelBlock { x: 0, y: 0, width: 37, height: 29 };
        let mut out = vec![0; block.byte_len(PixelFormat::Rgba8)];
        Renderer::new(&pack).render_block(&params, block, &mut out);
        out
    };
    assert_eq!(render(1, 0), render(1, 7));
    assert_eq!(render(4, 3), render(4, 3));
    assert_ne!(render(4, 3), render(4, 4));
}

#[test]
fn vertex_colours_multiply_the_base_colour() {
    let mut stage = Stage::default();
    let grey = Material { base_color: [0.5, 0.5, 0.5, 1.0], ..unlit([0.5; 3]) };
    let corner = |x: f64, y: f64, color| (DVec3::new(x, y, 0.0), Extra { color, ..BARE });
    stage.triangle(
        [
            corner(-1.0, -1.0, [255, 0, 0, 255]),
            corner(1.0, -1.0, [0, 255, 0, 255]),
            corner(0.0, 1.0, [0, 0, 255, 255]),
        ],
        grey,
    );
    // The centroid mixes them evenly, in linear light.
    let pixel = look([0.0, -1.0 / 3.0, 2.0], [0.0, -1.0 / 3.0, 0.0]).pixel(&stage.pack());
    assert_color(pixel.color, 0.5 / 3.0, 1e-5);
}

#[test]
fn an_empty_scene_is_background() {
    let pack = Stage::default().pack_with(Plain::default()).expect("an empty scene packs");
    assert_eq!(mixed_view().layers(&pack).0[0].alpha, 0.0);
}

#[test]
fn what_covers_nothing_is_neither_seen_nor_lit() {
    let air = Material { base_color: [1.0, 1.0, 1.0, 0.0], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    let mut stage = Stage::default();
    stage.quad([-8.0, -8.0, 1.0], [16.0, 0.0, 0.0], [0.0, 16.0, 0.0], air);
    stage.quad([-8.0, -8.0, 0.0], [16.0, 0.0, 0.0], [0.0, 16.0, 0.0], unlit([0.5; 3]));
    stage.input.lights = vec![point_light([0.0, 0.0, 3.0], 1.0)];
    let pack = stage.pack();
    for samples in [1, 4] {
        let (pixels, counts) = View { samples, ..look([0.25, 0.5, 4.0], [0.25, 0.5, 0.0]) }.layers(&pack);
        assert!((pixels[0].depth - 4.0).abs() < 1e-5 && pixels[0].id >= 2, "{:?}", pixels[0]);
        assert_eq!((pixels[0].alpha, counts.shadow), (1.0, 0));
        assert_color(pixels[0].color, 0.5, 1e-6);
    }
}
