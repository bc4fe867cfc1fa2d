//! Hard inputs all the way to the picture. Their numbers are those of `tests/HARD_INPUTS.md`.

use crate::support::{stages::*, *};
use tessera_geometry::Hit;
use tessera_pack::{Pack, Plain};
use tessera_whitted::{PixelBlock, PixelFormat, Renderer};

fn quantized(stage: &Stage) -> Pack {
    stage.clone().pack_with(Plain::default()).expect("a packable scene")
}

/// Both ways to hold a scene.
fn packs(stage: &Stage) -> [Pack; 2] {
    [quantized(stage), stage.clone().pack()]
}

#[track_caller]
fn assert_background(pack: &Pack, what: &str) {
    for (i, pixel) in look([0.3, 0.4, 5.0], [0.0; 3]).sized(33, 21).layers(pack).0.into_iter().enumerate() {
        assert_eq!(
            (pixel.alpha, pixel.id, pixel.depth),
            (0.0, Hit::NO_TRIANGLE, f32::INFINITY),
            "{what}, {i}"
        );
        assert_eq!((pixel.color, pixel.normal), ([0.0; 3], [0.0; 3]), "{what}, {i}");
    }
}

#[test]
fn h01_h03_h05_scenes_without_area_are_background_in_every_pixel() {
    for (what, stage) in without_area() {
        for pack in packs(&stage) {
            assert_background(&pack, what);
        }
    }
}

#[test]
fn h02_one_triangle_covers_its_projected_area() {
    let (stage, view, [area, perimeter]) = one_triangle();
    for pack in packs(&stage) {
        let (pixels, _) = view.layers(&pack);
        let covered = pixels.iter().filter(|p| p.id == 0).count() as f64;
        assert!((covered - area).abs() <= perimeter / 2.0, "{covered} pixels of {area}");
        assert!(pixels.iter().all(|p| (p.id == 0) == (p.alpha == 1.0)));
    }
}

#[test]
fn h04_a_flat_scene_is_right_from_above_and_nothing_from_its_side() {
    let stage = flat();
    for pack in packs(&stage) {
        let view = look([0.31, 0.17, 2.0], [0.0, 0.1, 0.0]).sized(64, 64);
        for (i, pixel) in view.layers(&pack).0.into_iter().enumerate() {
            assert_eq!((pixel.alpha, pixel.color), (1.0, [0.5; 3]), "pixel {i}");
            assert_eq!(pixel.normal, [0.0, 0.0, 1.0], "pixel {i}");
            assert!((2.0..4.0).contains(&pixel.depth), "pixel {i}: {pixel:?}");
        }
        for view in views_in_plane(&pack) {
            for pixel in view.layers(&pack).0 {
                assert_eq!((pixel.alpha, pixel.id), (0.0, Hit::NO_TRIANGLE), "{pixel:?}");
            }
        }
    }
}

#[test]
fn h06_triangles_without_area_change_no_byte_of_the_picture() {
    let view = look([0.4, 1.5, 4.0], [0.0, -0.2, 0.0]).sized(96, 64);
    let picture = |stage: Stage| view.bytes(&quantized(&stage), PixelFormat::Rgba16);
    let (good, counts) = picture(blocks(false));
    assert!((good, counts) == picture(blocks(true)), "pixels or rays differ");
    assert!(counts.shadow > 1000, "the scene is in view");
}

#[test]
fn h10_of_coplanar_triangles_the_first_is_seen_in_every_pixel_and_block() {
    let stage = floors();
    let view = look([0.4, 2.0, 3.5], [0.1, 0.0, 0.0]).sized(96, 80);
    for pack in packs(&stage) {
        let params = view.params(&pack, PixelFormat::Layers);
        let (pixels, _) = view.layers(&pack);
        let mut seen = [0; 3];
        for (i, pixel) in pixels.iter().enumerate().filter(|(_, p)| p.alpha > 0.0) {
            let ray = params.camera.ray((i % 96) as f32 + 0.5, (i / 96) as f32 + 0.5, 96, 80);
            let local =
                ray.origin.as_dvec3() + ray.direction.as_dvec3() * f64::from(pixel.depth) / pack.frame().step;
            let at =
                local * pack.frame().step + pack.frame().centre * pack.frame().step + pack.frame().anchor;
            // Within a ten-thousandth of an outline rounding and quantisation decide.
            let outside = [at.x.abs().max(at.z.abs()) - 1.0, (at.x.abs() - 2.5).max(at.z.abs() - 2.0)];
            if outside.iter().any(|o| o.abs() < 1e-4) {
                continue;
            }
            let wanted = outside.iter().position(|o| *o < 0.0).unwrap_or(2);
            assert_eq!(pixel.color, FLOOR_COLORS[wanted], "pixel {i} at {at}");
            seen[wanted] += 1;
        }
        assert!(seen.iter().all(|n| *n > 100), "{seen:?}");
        // A pixel alone is what it is in the whole.
        let (whole, _) = view.bytes(&pack, PixelFormat::Layers);
        let renderer = Renderer::new(&pack);
        for i in (0..96 * 80).step_by(17) {
            let block = PixelBlock { x: i % 96, y: i / 96, width: 1, height: 1 };
            let mut pixel = [0; 36];
            renderer.render_block(&params, block, &mut pixel);
            assert_eq!(pixel, whole[36 * i as usize..][..36]);
        }
    }
}

#[test]
fn h23_a_packed_axis_normal_reflects_without_error() {
    // Without a normal the geometric one is used, which is exact here.
    let [plain, packed] = [false, true].map(|with_normals| quantized(&mirror_floor(with_normals)));
    assert!(packed.mesh().has_normals() && !plain.mesh().has_normals());
    let view = look([1.0, 1.5, 4.0], [0.0, 0.1, 0.0]).sized(80, 60);
    let (with, counts) = view.bytes(&packed, PixelFormat::Layers);
    assert!(with == view.bytes(&plain, PixelFormat::Layers).0, "the mirror image differs");
    assert!(counts.reflection > 1000, "the mirror is in view");
}

#[test]
fn h24_normals_that_look_inward_change_nothing() {
    let ball = |sign: f32| look([0.2, 0.3, 3.0], [0.0; 3]).sized(64, 64).layers(&signed_ball(sign).pack()).0;
    let (outward, inward) = (ball(1.0), ball(-1.0));
    for (i, (a, b)) in outward.iter().zip(&inward).enumerate() {
        assert_eq!(a, b, "pixel {i}");
    }
    assert!(outward.iter().filter(|p| p.color[0] > 0.1).count() > 500);
}

#[test]
fn h40_a_long_corridor_has_no_acne_and_no_leak_wider_than_a_voxel() {
    for pack in packs(&corridor()) {
        let voxel = pack.frame().step;
        assert!(1024.0 / voxel > 8e6, "as many voxels as there can be");
        // From a million voxels above: the shadow reaches from its far end to the contact line, but for a voxel.
        let is_lit = |x: f64| {
            let eye = [x, 1e6 * voxel, 0.0];
            let pixel = look(eye, [x, 0.0, 0.0]).pixel(&pack);
            assert!((f64::from(pixel.depth) / voxel - 1e6).abs() <= 2.0, "{pixel:?}");
            pixel.color[0] > 0.0
        };
        // Quantisation moves a vertex by half a voxel, the picture by as much again.
        for voxels in [1.5, 2.0, 3.0, 10.0, 1000.0] {
            assert!(!is_lit(1000.0 - voxels * voxel), "light {voxels} voxels before the contact line");
            assert!(!is_lit(998.0 + voxels * voxel), "light {voxels} voxels inside the shadow");
            assert!(is_lit(998.0 - voxels * voxel), "shadow {voxels} voxels beyond its end");
        }
        // Along it, up to eight million voxels away, the floor is lit without a speck.
        let (pixels, _) = look([0.5, 1.5, 0.0], [1000.0, 0.0, 0.0]).sized(120, 120).layers(&pack);
        let floor: Vec<_> = pixels.iter().filter(|p| p.id < 2 && p.depth < 990.0).collect();
        assert!(floor.len() > 2000 && floor.iter().any(|p| p.depth > 200.0), "{}", floor.len());
        for pixel in floor {
            assert_color(pixel.color, 0.5f32.sqrt(), 1e-5);
        }
    }
}

#[test]
fn h36_a_light_at_the_hit_point_itself_makes_no_nan() {
    // The ray from the eye ends where the light is, on the surface.
    let stage = light_in_surface();
    for pack in packs(&stage) {
        let pixel = look([0.25, 0.5, 2.0], [0.25, 0.5, 0.0]).pixel(&pack);
        assert!(pixel.color.iter().all(|c| c.is_finite() && *c >= 0.0), "{pixel:?}");
    }
}
