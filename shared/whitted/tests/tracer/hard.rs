//! Hard inputs all the way to the picture. Their numbers are those of `tests/HARD_INPUTS.md`.

use crate::support::*;
use std::f32::consts::PI;
use tessera_geometry::{DVec3, Hit};
use tessera_pack::{Material, Pack, Plain};
use tessera_whitted::{PixelBlock, PixelFormat, Renderer};

fn point(x: f64, y: f64, z: f64) -> (DVec3, Extra) {
    (DVec3::new(x, y, z), BARE)
}

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
    let degenerate = |corners: [[f64; 3]; 3], times: usize| {
        let mut stage = Stage::default();
        for i in 0..times {
            let shift = DVec3::splat(i as f64);
            stage.triangle(corners.map(|c| (DVec3::from(c) + shift, BARE)), chalk());
        }
        stage.light(point_light([0.0, 2.0, 2.0], 9.0));
        stage
    };
    for (what, stage) in [
        ("nothing", Stage::default()),
        ("all vertices equal", degenerate([[0.0; 3]; 3], 1)),
        ("a line of triangles", degenerate([[0.0; 3], [0.25; 3], [1.0; 3]], 9)),
    ] {
        assert_background(&quantized(&stage), what);
    }
    // One vertex used three times.
    let mut stage = degenerate([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 1);
    stage.input.triangles = vec![[1, 1, 1]];
    for pack in packs(&stage) {
        assert_background(&pack, "one vertex");
    }
}

#[test]
fn h02_one_triangle_covers_its_projected_area() {
    let corners = [[-0.9, -0.7], [1.1, -0.2], [0.1, 0.8]];
    let mut stage = Stage::default();
    stage.triangle(corners.map(|[x, y]| point(x, y, 0.0)), chalk());
    // 320 pixels look at 2 x 3 x tan 25 degrees.
    let scale = 160.0 / (3.0 * libm::tan(25f64.to_radians()));
    let [a, b, c] = corners.map(|[x, y]| DVec3::new(x, y, 0.0) * scale);
    let area = (b - a).cross(c - a).length() / 2.0;
    let perimeter = a.distance(b) + b.distance(c) + c.distance(a);
    for pack in packs(&stage) {
        let (pixels, _) = look([0.0, 0.0, 3.0], [0.0; 3]).sized(320, 320).layers(&pack);
        let covered = pixels.iter().filter(|p| p.id == 0).count() as f64;
        assert!((covered - area).abs() <= perimeter / 2.0, "{covered} pixels of {area}");
        assert!(pixels.iter().all(|p| (p.id == 0) == (p.alpha == 1.0)));
    }
}

#[test]
fn h04_a_flat_scene_is_right_from_above_and_nothing_from_its_side() {
    let mut stage = Stage::default();
    for i in 0..64 {
        let (x, y) = (f64::from(i % 8) - 4.0, f64::from(i / 8) - 4.0);
        stage.quad([x, y, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], unlit([0.5; 3]));
    }
    for pack in packs(&stage) {
        let view = look([0.31, 0.17, 2.0], [0.0, 0.1, 0.0]).sized(64, 64);
        for (i, pixel) in view.layers(&pack).0.into_iter().enumerate() {
            assert_eq!((pixel.alpha, pixel.color), (1.0, [0.5; 3]), "pixel {i}");
            assert_eq!(pixel.normal, [0.0, 0.0, 1.0], "pixel {i}");
            assert!((2.0..4.0).contains(&pixel.depth), "pixel {i}: {pixel:?}");
        }
        // In its plane: a voxel's centre in a quantised scene, so that no ray crosses it.
        let height = pack.frame().to_world(pack.mesh().position(0)).z;
        for eye in [[-9.0, 0.5, height], [0.25, 0.5, height]] {
            let mut view = look(eye, [9.0, 0.7, height]).sized(65, 65);
            view.pose.up = DVec3::Z;
            for pixel in view.layers(&pack).0 {
                assert_eq!((pixel.alpha, pixel.id), (0.0, Hit::NO_TRIANGLE), "{eye:?}: {pixel:?}");
            }
        }
    }
}

#[test]
fn h06_triangles_without_area_change_no_byte_of_the_picture() {
    let scene = |with_faults: bool| {
        let mut stage = Stage::default();
        for i in 0..12 {
            let x = f64::from(i) * 0.25 - 1.5;
            stage.cuboid([x, -1.0, -0.5], [x + 0.2, 0.1 * f64::from(i), 0.5], chalk());
            if with_faults {
                stage.triangle(
                    [point(x, 0.0, 0.0), point(x + 0.125, 0.0, 0.0), point(x + 0.2, 0.0, 0.0)],
                    chalk(),
                );
                stage.triangle([point(x, -1.0, 0.5); 3], chalk());
            }
        }
        stage.light(point_light([1.0, 3.0, 2.0], 20.0));
        stage
    };
    let view = look([0.4, 1.5, 4.0], [0.0, -0.2, 0.0]).sized(96, 64);
    let picture = |stage: Stage| view.bytes(&quantized(&stage), PixelFormat::Rgba16);
    let (good, counts) = picture(scene(false));
    assert!((good, counts) == picture(scene(true)), "pixels or rays differ");
    assert!(counts.shadow > 1000, "the scene is in view");
}

#[test]
fn h10_of_coplanar_triangles_the_first_is_seen_in_every_pixel_and_block() {
    // Three floors in one plane, cut differently; each later one is larger.
    let colors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut stage = Stage::default();
    stage.quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], unlit(colors[0]));
    for i in 0..5 {
        let x = f64::from(i) - 2.5;
        stage.quad([x, 0.0, -2.0], [0.0, 0.0, 4.0], [1.0, 0.0, 0.0], unlit(colors[1]));
    }
    stage.quad([3.0, 0.0, -3.0], [-6.0, 0.0, 0.0], [0.0, 0.0, 6.0], unlit(colors[2]));
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
            assert_eq!(pixel.color, colors[wanted], "pixel {i} at {at}");
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
    let mut stage = Stage::default();
    stage.quad([-4.0, 0.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], mirror(0.9));
    let floor = stage.input.normals.len();
    stage.cuboid([-0.5, 0.25, -0.5], [0.5, 1.0, 0.5], chalk());
    stage.light(point_light([2.0, 3.0, 2.0], 30.0));
    // Without a normal the geometric one is used, which is exact here.
    let plain = quantized(&stage);
    stage.input.normals[..floor].fill([0.0, 1.0, 0.0]);
    let packed = quantized(&stage);
    assert!(packed.mesh().has_normals() && !plain.mesh().has_normals());
    let view = look([1.0, 1.5, 4.0], [0.0, 0.1, 0.0]).sized(80, 60);
    let (with, counts) = view.bytes(&packed, PixelFormat::Layers);
    assert!(with == view.bytes(&plain, PixelFormat::Layers).0, "the mirror image differs");
    assert!(counts.reflection > 1000, "the mirror is in view");
}

#[test]
fn h24_normals_that_look_inward_change_nothing() {
    let ball = |sign: f32| {
        let mut stage = Stage::default();
        stage.ball([0.0; 3], 1.0, 16, chalk());
        stage.input.normals.iter_mut().flatten().for_each(|x| *x *= sign);
        stage.light(point_light([1.0, 2.0, 4.0], 40.0));
        look([0.2, 0.3, 3.0], [0.0; 3]).sized(64, 64).layers(&stage.pack()).0
    };
    let (outward, inward) = (ball(1.0), ball(-1.0));
    for (i, (a, b)) in outward.iter().zip(&inward).enumerate() {
        assert_eq!(a, b, "pixel {i}");
    }
    assert!(outward.iter().filter(|p| p.color[0] > 0.1).count() > 500);
}

/// A corridor 1024 long along x with a block across it, on its floor, at 1000.
fn corridor() -> Stage {
    let mut stage = Stage::default();
    stage.quad([0.0, 0.0, -2.0], [0.0, 0.0, 4.0], [1024.0, 0.0, 0.0], chalk());
    stage.quad([0.0, 0.0, -2.0], [1024.0, 0.0, 0.0], [0.0, 3.0, 0.0], chalk());
    stage.quad([0.0, 0.0, 2.0], [0.0, 3.0, 0.0], [1024.0, 0.0, 0.0], chalk());
    stage.cuboid([1000.0, 0.0, -1.0], [1002.0, 2.0, 1.0], chalk());
    stage.light(directional_light([-1.0, -1.0, 0.0], PI));
    stage
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
    let mut stage = Stage::default();
    stage.quad(
        [-1.0, -1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        Material { roughness: 0.2, ..Material::default() },
    );
    stage.light(point_light([0.25, 0.5, 0.0], 1.0));
    for pack in packs(&stage) {
        let pixel = look([0.25, 0.5, 2.0], [0.25, 0.5, 0.0]).pixel(&pack);
        assert!(pixel.color.iter().all(|c| c.is_finite() && *c >= 0.0), "{pixel:?}");
    }
}
