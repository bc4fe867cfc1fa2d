//! No surface sends back more than it gets, and what it must send back arrives.

use crate::support::{stages::*, *};
use tessera_pack::{Material, MaterialFlags};

/// Pixels of a ball of `material` in an environment of radiance 1 with ambient light of 1.
fn furnace(material: Material, max_depth: u32) -> Vec<Layers> {
    let mut stage = Stage::default();
    stage.ball([0.0; 3], 1.0, 24, material);
    stage.surround();
    View { max_depth, ..look([0.3, 0.5, 2.6], [0.0; 3]).sized(24, 24) }.layers(&stage.pack()).0
}

#[test]
fn lossless_materials_vanish_in_the_furnace() {
    for (name, material, loss) in [
        ("chalk", chalk(), 1e-6),
        ("mirror", mirror(1.0), 1e-6),
        ("unlit white", unlit([1.0; 3]), 0.0),
        // Rays below 1/512 are cut: a dozen inner reflections of 4 % and more.
        ("glass", glass(1.5), 0.02),
        ("pane", Material { flags: MaterialFlags::THIN_WALLED, ..glass(1.5) }, 0.02),
        ("air", glass(1.0), 1e-6),
        (
            "veil",
            Material { base_color: [1.0, 1.0, 1.0, 0.3], flags: MaterialFlags::ALPHA_BLEND, ..chalk() },
            1e-6,
        ),
    ] {
        for pixel in furnace(material, 32) {
            let [r, g, b] = pixel.color;
            assert!(r <= 1.0 + 1e-5 && r >= 1.0 - loss - 1e-6 && r == g && g == b, "{name}: {pixel:?}");
            assert_eq!(pixel.alpha, 1.0, "{name}");
        }
    }
}

#[test]
fn no_material_gains_energy() {
    for metallic in [0.0, 0.4, 1.0] {
        for roughness in [0.0, 0.2, 0.5, 1.0] {
            for transmission in [0.0, 0.6, 1.0] {
                let m = Material { metallic, roughness, transmission, ..Material::default() };
                for pixel in furnace(m, 6) {
                    assert!(pixel.color.iter().all(|&c| (0.0..=1.0 + 1e-5).contains(&c)), "{m:?}: {pixel:?}");
                }
            }
        }
    }
}

#[test]
fn facing_mirrors_sum_a_geometric_series() {
    let k = 0.75f32;
    let pack = facing_mirrors(k).pack();
    for max_depth in [0, 1, 2, 7, 15] {
        let view = View { max_depth, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
        let (pixels, counts) = view.layers(&pack);
        let wanted: f32 = (0..=max_depth).scan(0.5, |e, _| Some(std::mem::replace(e, *e * k))).sum();
        assert_color(pixels[0].color, wanted, 1e-5);
        assert_eq!(counts.reflection, u64::from(max_depth), "one image behind the other");
        assert_eq!((counts.primary, counts.shadow, counts.refraction), (1, 0, 0));
    }
    // Without a useful depth limit the weight ends it: 0.75^21 is above 1/512, 0.75^22 below.
    let view = View { max_depth: 32, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
    assert_eq!(view.layers(&pack).1.reflection, 21);
}

#[test]
fn light_caught_in_glass_ends_at_the_depth_limit() {
    // At 45 degrees to the faces, beyond the critical angle of 41.8, the ray runs around inside the cube for ever.
    let pack = glass_cube().pack();
    for max_depth in [0, 1, 5, 32] {
        let view = View { max_depth, ..look([0.1, 0.0, 0.0], [1.1, 1.0, 0.0]) };
        let (pixels, counts) = view.layers(&pack);
        assert_eq!((counts.reflection, counts.refraction), (u64::from(max_depth), 0));
        assert_eq!((pixels[0].color, pixels[0].alpha), ([0.0; 3], 1.0));
    }
    // Steeper it leaves, but for what is reflected inside.
    let view = View { max_depth: 32, ..look([0.1, 0.0, 0.0], [1.1, 0.3, 0.0]) };
    assert_color(view.pixel(&pack).color, 1.0, 0.01);
}

#[test]
fn a_surface_at_the_depth_limit_shows_its_own_light() {
    let mut stage = Stage::default();
    let shining = Material { emissive: [0.25; 3], ..glass(1.5) };
    stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], shining);
    stage.surround();
    let view = View { max_depth: 0, ..look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]) };
    let (pixels, counts) = view.layers(&stage.pack());
    assert_eq!((pixels[0].color, pixels[0].alpha), ([0.25; 3], 1.0));
    assert_eq!((counts.reflection, counts.refraction), (0, 0));
}

#[test]
fn what_is_switched_off_leaves_an_opaque_body() {
    let mut stage = Stage::default();
    stage.quad(
        [-1.0, -1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        Material { specular: [0.0; 3], ..glass(1.0) },
    );
    stage.quad([1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], mirror(0.5));
    stage.input.ambient.radiance = [0.5; 3];
    let pack = stage.pack();
    let mut view = look([0.1, 0.2, 2.0], [0.1, 0.2, 0.0]);
    assert_eq!(view.pixel(&pack).color, [0.0; 3]);
    view.features.refraction = false;
    assert_color(view.pixel(&pack).color, 0.5, 1e-6);
    let mut view = look([2.1, 0.2, 2.0], [2.1, 0.2, 0.0]);
    assert_eq!(view.pixel(&pack).color, [0.0; 3]);
    view.features.reflection = false;
    let (pixels, counts) = view.layers(&pack);
    assert_color(pixels[0].color, 0.25, 1e-6);
    assert_eq!(counts.reflection, 0);
}
