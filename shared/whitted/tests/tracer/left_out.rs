//! What is left out changes no picture: each part is forced in that a scene does not need, into its pack and into the CPU's kernel.

use crate::support::*;
use std::collections::BTreeSet;
use tessera_kdtree::Kernel;
use tessera_pack::{Forced, ImageInput, Material, MaterialFlags, Pack, PackOptions, Plain, build_pack};
use tessera_whitted::{Needs, PixelBlock, PixelFormat, RayCounts, Renderer};

/// A picture of 4 x 4 texels with every alpha, or opaque.
fn picture(is_opaque: bool) -> ImageInput {
    let byte = |i: u32| if i % 4 == 3 && is_opaque { 255 } else { (i * 37 % 256) as u8 };
    ImageInput { width: 4, height: 4, rgba: (0..64).map(byte).collect(), ..ImageInput::default() }
}

fn floor(stage: &mut Stage, material: Material) {
    stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], material);
}

/// Scenes that each do without something: no textures, flat, no mirrors, one material, opaque; and one that holds much of no effect.
fn stages() -> [(&'static str, Stage); 6] {
    let base = |textures: &[ImageInput]| {
        let mut stage = Stage::default();
        stage.input.textures = textures.to_vec();
        stage.light(point_light([1.0, 2.5, 2.0], 20.0));
        stage.input.ambient.radiance = [0.1, 0.2, 0.3];
        stage
    };
    let veil = Material {
        base_color: [0.2, 0.5, 0.9, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    let textured = Material { base_texture: 0, ..Material::default() };
    let mask = Material { flags: MaterialFlags::ALPHA_MASK, ..textured };
    let ball = |stage: &mut Stage, x: f64, material| stage.ball([x, 0.0, 0.0], 0.8, 8, material);

    let mut no_textures = base(&[]);
    floor(&mut no_textures, mirror(0.8));
    ball(&mut no_textures, -1.0, glass(1.5));
    ball(&mut no_textures, 1.0, veil);

    let mut flat = base(&[picture(false)]);
    floor(&mut flat, mask);
    flat.cuboid([-1.0, -1.0, -1.0], [0.3, 0.5, 0.5], one_sided(mirror(0.7)));
    flat.surround();

    let mut no_mirrors = base(&[picture(true)]);
    floor(&mut no_mirrors, textured);
    ball(&mut no_mirrors, -1.0, one_sided(chalk()));
    ball(&mut no_mirrors, 1.0, veil);

    let mut one_material = Stage::default();
    one_material.ball([0.0; 3], 1.2, 10, chalk());

    let mut opaque = base(&[picture(true)]);
    opaque.light(directional_light([-0.3, -1.0, -0.2], 2.0));
    floor(&mut opaque, Material { roughness: 0.1, ..textured });
    ball(&mut opaque, -1.0, mirror(0.9));
    ball(&mut opaque, 1.0, unlit([0.3, 0.6, 0.1]));

    // Masks and blending without holes, textures that multiply 0 or are not shown, a dark light.
    let mut clutter = base(&[picture(true), picture(false)]);
    clutter.light(point_light([0.0, 3.0, 0.0], 0.0));
    floor(&mut clutter, Material { flags: MaterialFlags::ALPHA_MASK, emissive_texture: 1, ..textured });
    let flags = MaterialFlags::UNLIT | MaterialFlags::DOUBLE_SIDED;
    let flat_color = Material {
        flags,
        metallic_roughness_texture: 1,
        emissive: [1.0; 3],
        emissive_texture: 1,
        ..textured
    };
    ball(&mut clutter, -1.0, flat_color);
    ball(
        &mut clutter,
        1.0,
        Material { flags: MaterialFlags::ALPHA_BLEND, transmission_texture: 1, ..textured },
    );
    clutter.input.colors.fill([200, 255, 255, 255]);

    [
        ("no textures", no_textures),
        ("flat", flat),
        ("no mirrors", no_mirrors),
        ("one material", one_material),
        ("opaque", opaque),
        ("clutter", clutter),
    ]
}

/// The frame in every pixel format, and its rays.
fn frames(pack: &Pack, kernel: Kernel, forced: Needs) -> Vec<(Vec<u8>, RayCounts)> {
    let view = look([0.3, 0.9, 5.0], [0.0; 3]).sized(32, 24);
    let renderer = Renderer::with_forced(pack, kernel, forced);
    let frame = |format| {
        let block = PixelBlock { x: 0, y: 0, width: view.width, height: view.height };
        let mut out = vec![0; block.byte_len(format)];
        let counts = renderer.render_block(&view.params(pack, format), block, &mut out);
        (out, counts)
    };
    [PixelFormat::Rgba8, PixelFormat::Rgba16, PixelFormat::Layers].map(frame).into()
}

/// Every part of the CPU's kernel by itself, and all together.
fn needs() -> [(&'static str, Needs); 7] {
    let none = Needs::default();
    let all =
        Needs { holes: true, hidden_backs: true, see_through: true, normals: true, uvs: true, colors: true };
    [
        ("holes", Needs { holes: true, ..none }),
        ("hidden-backs", Needs { hidden_backs: true, ..none }),
        ("see-through", Needs { see_through: true, ..none }),
        ("normals", Needs { normals: true, ..none }),
        ("uvs", Needs { uvs: true, ..none }),
        ("colors", Needs { colors: true, ..none }),
        ("all", all),
    ]
}

#[test]
fn a_part_that_is_forced_in_changes_no_bit() {
    let plain = Plain { positions: true, normals: true, uvs: true };
    let mut seen = BTreeSet::new();
    for (name, stage) in stages() {
        for plain in [Plain::default(), plain] {
            let pack = |forced| {
                let options = PackOptions { plain, forced, ..PackOptions::default() };
                build_pack(stage.input.clone(), &options).expect("a packable scene").0
            };
            let lean = pack(None);
            for kernel in [Kernel::Scalar, Kernel::wide()] {
                let expected = frames(&lean, kernel, Needs::default());
                let first = &expected[0].0[..4];
                assert!(expected[0].0.chunks_exact(4).any(|pixel| pixel != first), "{name}: nothing is seen");

                // In the pack.
                for forced in Forced::ALL {
                    let full = pack(Some(forced));
                    if full.id() != lean.id() {
                        seen.insert(forced.name());
                    }
                    let found = frames(&full, kernel, Needs::default());
                    assert!(
                        found == expected,
                        "{name}, {plain:?}, {kernel:?}: {} in the pack",
                        forced.name()
                    );
                }

                // In the kernel.
                for (part, forced) in needs() {
                    let found = frames(&lean, kernel, forced);
                    assert!(found == expected, "{name}, {plain:?}, {kernel:?}: {part} in the kernel");
                }
            }
        }
    }
    let all: BTreeSet<_> = Forced::ALL.map(Forced::name).into();
    assert_eq!(seen, all, "each is unneeded in some scene");
}

#[test]
fn references_in_the_tree_change_no_bit() {
    for (name, stage) in stages() {
        let pack = |max_refs, tau_tests| {
            let mut options = PackOptions::default();
            (options.tree.max_refs, options.tree.tau_tests) = (max_refs, tau_tests);
            build_pack(stage.input.clone(), &options).expect("a packable scene").0
        };
        for kernel in [Kernel::Scalar, Kernel::wide()] {
            let expected = frames(&pack(0, 0.0), kernel, Needs::default());
            for max_refs in [1, 2] {
                let found = frames(&pack(max_refs, 0.0), kernel, Needs::default());
                assert!(found == expected, "{name}, {kernel:?}: {max_refs} references");
            }
        }
    }
}

#[test]
fn a_colour_of_all_corners_is_that_colour_everywhere() {
    // A mask whose cut-off is the very alpha that all corners have: not one pixel is a hole.
    let mut stage = Stage::default();
    let material = Material { flags: MaterialFlags::ALPHA_MASK, alpha_cutoff: 1.0, ..unlit([1.0; 3]) };
    stage.quad(
        [-1.0, -1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        Material { flags: material.flags | 3, ..material },
    );
    stage.quad([-9.0, 5.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], material);
    let last = stage.input.colors.len() - 1;
    stage.input.colors[..last].fill([128, 64, 32, 255]);
    stage.input.colors[last] = [0; 4];
    let pack = stage.pack();
    let (pixels, _) = look([0.0, 0.0, 1.5], [0.0; 3]).sized(64, 64).layers(&pack);
    let first = pixels[0];
    assert!(pixels.iter().all(|p| p.alpha == 1.0 && p.color == first.color), "{first:?}");
}
