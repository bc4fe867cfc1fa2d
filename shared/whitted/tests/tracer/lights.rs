//! Lights, shadows, and what a shadow ray passes, against values worked out by hand.

use crate::support::{stages::*, *};
use std::f32::consts::PI;
use tessera_geometry::Vec3;
use tessera_pack::{ImageInput, Light, LightKind, Material, MaterialFlags};

/// A chalk floor of 20 x 20 around the origin, facing +y.
fn floor() -> Stage {
    let mut stage = Stage::default();
    stage.quad([-10.0, 0.0, -10.0], [0.0, 0.0, 20.0], [20.0, 0.0, 0.0], chalk());
    stage
}

/// Adds a horizontal 2 x 2 sheet around `(x, y, z)`, facing +y.
fn add_sheet(stage: &mut Stage, [x, y, z]: [f64; 3], material: Material) {
    stage.quad([x - 1.0, y, z - 1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], material);
}

/// The floor's radiance at `(x, 0, z)`, seen from beside whatever hangs above it.
fn floor_at(stage: &Stage, x: f64, z: f64) -> [f32; 3] {
    look([x, 0.1, z + 3.0], [x, 0.0, z]).pixel(&stage.clone().pack()).color
}

#[test]
fn a_point_light_falls_off_with_the_squared_distance_in_world_units() {
    for scale in [1e-3f64, 1.0, 1e3] {
        let mut stage = Stage::default();
        let s = scale as f32;
        stage.quad(
            [-10.0 * scale, 0.0, -10.0 * scale],
            [0.0, 0.0, 20.0 * scale],
            [20.0 * scale, 0.0, 0.0],
            chalk(),
        );
        stage.light(point_light([0.0, 2.0 * s, 0.0], 12.0 * s * s));
        let pack = stage.pack();
        for (x, z) in [(0.0, 0.0), (1.0, 0.0), (-3.0, 2.0)] {
            let view = look([x * scale, 0.5 * scale, (z + 3.0) * scale], [x * scale, 0.0, z * scale]);
            let d2 = 4.0 + x * x + z * z;
            let wanted = (12.0 / d2 * 2.0 / d2.sqrt()) as f32 / PI;
            assert_color(view.pixel(&pack).color, wanted, 1e-5);
        }
    }
}

#[test]
fn a_range_is_a_smooth_window() {
    let mut stage = floor();
    stage.light(Light { range: 4.0, ..point_light([0.0, 2.0, 0.0], 10.0) });
    // (1 - (2/4)^4) / 4 below; nothing beyond the range.
    assert_color(floor_at(&stage, 0.0, 0.0), 10.0 / 4.0 * (1.0 - 0.0625) / PI, 1e-5);
    assert_color(floor_at(&stage, 5.0, 0.0), 0.0, 0.0);
}

#[test]
fn a_directional_light_shines_everywhere_alike() {
    let mut stage = floor();
    stage.light(directional_light([1.0, -2.0, 2.0], 3.0));
    for (x, z) in [(0.0, 0.0), (7.0, -3.0)] {
        assert_color(floor_at(&stage, x, z), 3.0 * (2.0 / 3.0) / PI, 1e-5);
    }
}

#[test]
fn a_spot_falls_off_between_its_cones() {
    let mut stage = floor();
    let (inner, outer) = (libm::cosf(0.3), libm::cosf(0.6));
    stage.light(Light {
        kind: LightKind::Spot as u32,
        direction: [0.0, -1.0, 0.0],
        cos_inner: inner,
        cos_outer: outer,
        ..point_light([0.0, 2.0, 0.0], 10.0)
    });
    for angle in [0.0f32, 0.2, 0.29, 0.4, 0.5, 0.59, 0.61, 1.2] {
        let x = 2.0 * libm::tan(f64::from(angle));
        let cosine = libm::cosf(angle);
        let share = ((cosine - outer) / (inner - outer)).clamp(0.0, 1.0);
        let d2 = (4.0 + x * x) as f32;
        assert_color(floor_at(&stage, x, 0.0), 10.0 / d2 * cosine * share * share / PI, 1e-5);
    }
}

#[test]
fn a_light_at_on_or_behind_a_surface_makes_no_nan() {
    // (height of the lamp, lit): behind, in the surface, a millionth above it.
    for (height, lit) in [(-1.0, false), (0.0, false), (1.0, true)] {
        let mut stage = floor();
        stage.light(point_light([0.0, height, 0.0], 1.0));
        for x in [0.0, 1e-6, 0.5] {
            let color = floor_at(&stage, x, 0.0);
            assert!(color.iter().all(|c| c.is_finite() && *c >= 0.0), "{height} {x}: {color:?}");
            assert_eq!(color[0] > 0.0, lit, "{height} {x}: {color:?}");
        }
    }
    // A lamp in the ceiling lights the room below it: the ceiling does not put it out.
    let mut stage = floor();
    stage.cuboid([-10.0, 3.0, -10.0], [10.0, 4.0, 10.0], chalk());
    stage.light(point_light([0.3, 3.0, 0.7], 9.0));
    assert_color(floor_at(&stage, 0.3, 0.7), 1.0 / PI, 1e-5);
}

#[test]
fn an_opaque_sheet_casts_a_sharp_shadow() {
    let mut stage = floor();
    add_sheet(&mut stage, [0.0, 1.0, 0.0], chalk());
    stage.light(point_light([0.0, 2.0, 0.0], PI));
    // The shadow of [-1, 1] reaches to 2.
    for (x, lit) in [(0.0, false), (1.99, false), (2.01, true)] {
        let color = floor_at(&stage, x, 0.0);
        assert_eq!(color[0] > 0.0, lit, "at {x}: {color:?}");
    }
    // Without shadows it is lit there too.
    let mut view = look([0.0, 0.1, 3.0], [0.0; 3]);
    view.features.shadows = false;
    let (pixels, counts) = view.layers(&stage.pack());
    assert_color(pixels[0].color, 0.25, 1e-6);
    assert_eq!(counts.shadow, 0);
}

#[test]
fn shadows_pass_holes_veils_and_glass() {
    let masked = |alpha| Material {
        base_color: [1.0, 1.0, 1.0, alpha],
        flags: MaterialFlags::ALPHA_MASK,
        alpha_cutoff: 0.5,
        ..chalk()
    };
    let veil =
        |alpha| Material { base_color: [0.2, 0.2, 0.2, alpha], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    let tinted = |t| Material { base_color: [0.5, 0.5, 0.5, 1.0], transmission: t, ..glass(1.5) };
    let leaded = Material { metallic: 1.0, ..tinted(1.0) };
    for (name, sheets, passed) in [
        ("nothing", vec![], 1.0),
        ("a hole", vec![masked(0.49)], 1.0),
        ("at the cut-off", vec![masked(0.5)], 0.0),
        ("a veil", vec![veil(0.3)], 0.7),
        ("two veils", vec![veil(0.3), veil(0.5)], 0.35),
        ("clear glass", vec![glass(1.5)], 1.0),
        ("grey glass", vec![tinted(1.0)], 0.5),
        ("half glass", vec![tinted(0.5)], 0.25),
        ("metal", vec![leaded], 0.0),
        ("glass over veil over a hole", vec![tinted(1.0), veil(0.3), masked(0.1)], 0.35),
        ("chalk behind glass", vec![tinted(1.0), chalk()], 0.0),
    ] {
        let mut stage = floor();
        for (i, sheet) in sheets.into_iter().enumerate() {
            add_sheet(&mut stage, [0.0, 0.5 + 0.25 * i as f64, 0.0], sheet);
        }
        stage.light(directional_light([0.0, -1.0, 0.0], PI));
        let color = floor_at(&stage, 0.3, 0.2);
        assert!((color[0] - passed).abs() < 1e-5, "{name}: {color:?} instead of {passed}");
    }
}

#[test]
fn each_surface_dims_a_shadow_ray_once_however_many_leaves_list_it() {
    // One great veil among thousands of small triangles: many leaves list the veil.
    let veil = Material { base_color: [0.0, 0.0, 0.0, 0.5], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    let mut stage = floor();
    stage.quad([-9.0, 1.0, -9.0], [0.0, 0.4, 18.0], [18.0, 0.3, 0.0], veil);
    for i in 0..2000 {
        let (x, z) = (f64::from(i % 50) * 0.36 - 9.0, f64::from(i / 50) * 0.45 - 9.0);
        stage.quad([x, 0.9 + 0.2 * libm::sin(x * z), z], [0.02, 0.0, 0.0], [0.0, 0.02, 0.01], chalk());
    }
    stage.light(directional_light([0.01, -1.0, 0.02], PI));
    let pack = stage.pack();
    let (pixels, _) = look([0.0, 0.3, 9.0], [0.0, 0.0, 0.0]).sized(40, 40).layers(&pack);
    let dimmed = 0.5 / Vec3::new(0.01, 1.0, 0.02).length();
    let floor: Vec<_> = pixels.iter().filter(|p| p.id < 2).collect();
    assert!(floor.len() > 400);
    for pixel in floor {
        let c = pixel.color[0];
        assert!((c - dimmed).abs() < 1e-5 || c == 0.0, "{pixel:?}");
    }
}

#[test]
fn coincident_veils_both_count() {
    let veil = Material { base_color: [0.0, 0.0, 0.0, 0.5], flags: MaterialFlags::ALPHA_BLEND, ..chalk() };
    let mut stage = floor();
    for _ in 0..3 {
        add_sheet(&mut stage, [0.0, 1.0, 0.0], veil);
    }
    stage.light(directional_light([0.0, -1.0, 0.0], PI));
    assert_color(floor_at(&stage, 0.3, 0.2), 0.125, 1e-5);
    // Seen from above, the three cover all but an eighth of the (shadowed) floor.
    let pixel = look([0.3, 3.0, 0.2], [0.3, 0.0, 0.2]).pixel(&stage.pack());
    assert_color(pixel.color, 0.125 * 0.125, 1e-6);
    assert_eq!(pixel.alpha, 1.0);
}

#[test]
fn a_mask_texture_cuts_holes_for_eyes_and_shadows() {
    // Left half there, right half cut out.
    let mut stage = floor();
    stage.input.textures = vec![ImageInput {
        width: 2,
        height: 1,
        rgba: [255, 255, 255, 255, 255, 255, 255, 0].into(),
        nearest: true,
        ..ImageInput::default()
    }];
    let masked = Material { base_texture: 0, flags: MaterialFlags::ALPHA_MASK, ..chalk() };
    // Texture coordinate u runs along +z here (the sheet's first edge).
    add_sheet(&mut stage, [0.0, 1.0, 0.0], masked);
    stage.light(directional_light([0.0, -1.0, 0.0], PI));
    for (z, hole) in [(-0.9, false), (-0.01, false), (0.01, true), (0.9, true)] {
        assert_eq!(floor_at(&stage, 0.0, z)[0] > 0.0, hole, "shadow at z = {z}");
        let pixel = look([0.0, 3.0, z], [0.0, 0.0, z]).pixel(&stage.clone().pack());
        assert_eq!(pixel.id < 2, hole, "seen at z = {z}");
    }
}

#[test]
fn a_plane_in_grazing_light_has_no_acne() {
    // Tilted, so that no coordinate of it is exact; lit at 0.6 degrees.
    let mut stage = Stage::default();
    let (u, v) = (Vec3::new(0.31, 0.83, -0.46).normalize(), Vec3::new(0.77, -0.12, 0.3));
    let v = (v - u * v.dot(u)).normalize();
    let normal = u.cross(v);
    let to_f64 = |v: Vec3| v.as_dvec3().to_array();
    stage.quad([100.0, 200.0, -50.0], to_f64(u * 1000.0), to_f64(v * 1000.0), chalk());
    let towards = (u + v * 0.2).normalize() + normal * 0.01;
    stage.light(directional_light((-towards).to_array(), 100.0));
    let pack = stage.pack();
    let middle = Vec3::new(100.0, 200.0, -50.0) + (u + v) * 500.0;
    let mut view = look(to_f64(middle + normal * 300.0), to_f64(middle)).sized(150, 150);
    view.pose.up = u.as_dvec3();
    let wanted = 100.0 * towards.normalize().dot(normal) / PI;
    for (i, pixel) in view.layers(&pack).0.into_iter().enumerate() {
        let c = pixel.color[0];
        assert!((c - wanted).abs() < 1e-3 * wanted, "pixel {i}: {c} instead of {wanted}");
    }
}

#[test]
fn every_pixel_of_a_closed_box_is_hit_and_lit() {
    let pack = closed_box().pack();
    for view in views_in_box() {
        for (i, pixel) in view.layers(&pack).0.into_iter().enumerate() {
            assert!(
                pixel.alpha == 1.0 && pixel.depth.is_finite() && pixel.color[0] > 0.0,
                "{:?} {i}: {pixel:?}",
                view.pose.target
            );
        }
    }
    // The camera on a wall looks into the room, not at the wall.
    let view = look([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    assert!((view.pixel(&pack).depth - 5.0).abs() < 1e-5);
}

#[test]
fn light_does_not_leak_under_a_touching_block() {
    // The block's shadow starts at its contact line, a thousandth of its size outside and inside.
    let mut stage = floor();
    stage.cuboid([0.0, 0.0, -1.0], [2.0, 2.0, 1.0], chalk());
    stage.light(directional_light([-1.0, -1.0, 0.0], PI));
    let lit = |x: f64| look([x - 1.0, 3.0, 0.0], [x, 0.0, 0.0]).pixel(&stage.clone().pack()).color[0] > 0.0;
    assert!(!lit(-0.001) && !lit(-1.0) && !lit(-1.999) && lit(-2.001));
}

#[test]
fn highlights_lie_where_the_mirror_image_of_the_lamp_is() {
    let shiny = Material { base_color: [0.0, 0.0, 0.0, 1.0], roughness: 0.25, ..Material::default() };
    let mut stage = Stage::default();
    stage.quad([-10.0, 0.0, -10.0], [0.0, 0.0, 20.0], [20.0, 0.0, 0.0], shiny);
    stage.light(point_light([0.0, 1.0, -1.0], 1.0));
    let pack = stage.pack();
    let at = |z: f64| look([0.0, 1.0, 1.0], [0.0, 0.0, z]).pixel(&pack).color[0];
    // F0 = 0.04 at 45 degrees, lobe at its top, e = 2 / r^4 - 2.
    let e = 2.0 / libm::powf(0.25, 4.0) - 2.0;
    let fresnel = 0.04 + 0.96 * libm::powf(1.0 - 0.5f32.sqrt(), 5.0);
    let wanted = fresnel * (e + 2.0) * (e + 4.0) / (8.0 * PI * e) * 0.5f32.sqrt() / 2.0;
    assert!((at(0.0) - wanted).abs() < 1e-4 * wanted, "{} instead of {wanted}", at(0.0));
    assert!(at(0.1) < at(0.0) && at(-0.1) < at(0.0) && at(0.5) < 0.01 * at(0.0));
}
