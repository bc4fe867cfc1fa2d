//! Hard inputs on the GPU: what the tracer's and the tree's own tests ask of the CPU, asked of it, and the CPU's answer besides. Their numbers are those of
//! `tests/HARD_INPUTS.md`.
//!
//! Rounding decides more pixels of these scenes than of others, which is what they are for: each difference must be explained, however many there are.

use super::rays::check_rays;
use super::{Other, check_hard, with_other};
use crate::kinds::{self, Random, Soup, UNKIND, quad, sphere, split_planes, unkind_ray, voxel};
use crate::stage::stages::*;
use crate::stage::*;
use tessera_geometry::{DVec3, Hit, Ray, Vec3};
use tessera_kdtree::Triangles;
use tessera_pack::{ImageInput, Material, Pack, Plain, Wrap};
use tessera_whitted::PixelFormat;

fn quantized(stage: &Stage) -> Pack {
    stage.clone().pack_with(Plain::default()).expect("a packable scene")
}

/// Both ways to hold a scene.
fn packs(stage: &Stage) -> [Pack; 2] {
    [quantized(stage), stage.clone().pack()]
}

/// What the other sees, which must be what the CPU sees but for explained differences.
fn seen(other: &dyn Other, what: &str, view: &View, pack: &Pack) -> Vec<Layers> {
    let params = view.params(pack, PixelFormat::Layers);
    check_hard(what, pack, &params, other);
    decode(&other.frame(pack, &params))
}

fn bytes(other: &dyn Other, view: &View, pack: &Pack) -> Vec<u8> {
    other.frame(pack, &view.params(pack, PixelFormat::Layers))
}

#[test]
fn h01_h03_h05_gpu_scenes_without_area_are_background() {
    with_other(|other| {
        for (what, stage) in without_area() {
            for pack in packs(&stage) {
                for pixel in seen(other, what, &look([0.3, 0.4, 5.0], [0.0; 3]).sized(33, 21), &pack) {
                    assert_eq!((pixel.alpha, pixel.id, pixel.depth), (0.0, Hit::NO_TRIANGLE, f32::INFINITY));
                    assert_eq!((pixel.color, pixel.normal), ([0.0; 3], [0.0; 3]), "{what}");
                }
            }
        }
    });
}

#[test]
fn h02_gpu_one_triangle_covers_its_projected_area() {
    with_other(|other| {
        let (stage, view, [area, perimeter]) = one_triangle();
        for pack in packs(&stage) {
            let pixels = seen(other, "one triangle", &view, &pack);
            let covered = pixels.iter().filter(|p| p.id == 0).count() as f64;
            assert!((covered - area).abs() <= perimeter / 2.0, "{covered} pixels of {area}");
        }
    });
}

#[test]
fn h04_gpu_a_flat_scene_is_right_from_above_and_nothing_from_its_side() {
    with_other(|other| {
        for pack in packs(&flat()) {
            let view = look([0.31, 0.17, 2.0], [0.0, 0.1, 0.0]).sized(64, 64);
            for pixel in seen(other, "flat, from above", &view, &pack) {
                assert_eq!((pixel.alpha, pixel.normal), (1.0, [0.0, 0.0, 1.0]), "{pixel:?}");
            }
            for view in views_in_plane(&pack) {
                for pixel in seen(other, "flat, from its side", &view, &pack) {
                    assert_eq!((pixel.alpha, pixel.id), (0.0, Hit::NO_TRIANGLE), "{pixel:?}");
                }
            }
        }
    });
}

#[test]
fn h06_gpu_triangles_without_area_change_no_byte() {
    with_other(|other| {
        let view = look([0.4, 1.5, 4.0], [0.0, -0.2, 0.0]).sized(96, 64);
        let [good, faulty] = [false, true].map(|with_faults| quantized(&blocks(with_faults)));
        seen(other, "blocks", &view, &good);
        let picture = |pack| other.frame(pack, &view.params(pack, PixelFormat::Rgba16));
        assert!(picture(&good) == picture(&faulty), "pixels differ");
    });
}

#[test]
fn h10_gpu_coplanar_floors_are_the_first_ones_or_tie() {
    with_other(|other| {
        let view = look([0.4, 2.0, 3.5], [0.1, 0.0, 0.0]).sized(96, 80);
        for pack in packs(&floors()) {
            let pixels = seen(other, "floors", &view, &pack);
            let of_color = |color| pixels.iter().filter(|p| p.color == color).count();
            assert!(FLOOR_COLORS.iter().all(|color| of_color(*color) > 100));
        }
    });
}

#[test]
fn h23_gpu_a_packed_axis_normal_reflects_without_error() {
    with_other(|other| {
        let [plain, packed] = [false, true].map(|with_normals| quantized(&mirror_floor(with_normals)));
        let view = look([1.0, 1.5, 4.0], [0.0, 0.1, 0.0]).sized(80, 60);
        seen(other, "a mirror floor", &view, &packed);
        assert!(bytes(other, &view, &packed) == bytes(other, &view, &plain), "the mirror image differs");
    });
}

#[test]
fn h24_gpu_normals_that_look_inward_change_nothing() {
    with_other(|other| {
        let view = look([0.2, 0.3, 3.0], [0.0; 3]).sized(64, 64);
        let [outward, inward] = [1.0, -1.0].map(|sign| signed_ball(sign).pack());
        let outward = seen(other, "a ball", &view, &outward);
        assert_eq!(outward, seen(other, "a ball inside out", &view, &inward));
        assert!(outward.iter().filter(|p| p.color[0] > 0.1).count() > 500);
    });
}

#[test]
fn h25_h26_gpu_texture_coordinates_wrap_as_their_modes_say() {
    with_other(|other| {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for span in [[-3.7f32, 12.2], [0.0, 1.0], [1.0f32.next_down(), 2.0]] {
                let mut stage = Stage::default();
                stage.input.textures = vec![ImageInput {
                    width: 8,
                    height: 8,
                    rgba: (0..256).map(|i| (i * 37 % 256) as u8).collect(),
                    wrap_s: wrap,
                    wrap_t: wrap,
                    ..ImageInput::default()
                }];
                let material = Material { base_texture: 0, ..unlit([1.0; 3]) };
                stage.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], material);
                for uv in stage.input.uvs.iter_mut().flatten() {
                    *uv = span[0] + (span[1] - span[0]) * *uv;
                }
                for pack in packs(&stage) {
                    let what = format!("{wrap:?}, {span:?}");
                    let view = look([0.1, 0.2, 2.5], [0.0; 3]).sized(96, 96);
                    let pixels = seen(other, &what, &view, &pack);
                    assert!(pixels.iter().filter(|p| p.id < 2).count() > 3000);
                }
            }
        }
    });
}

#[test]
fn h30_gpu_facing_mirrors_sum_a_geometric_series() {
    with_other(|other| {
        let k = 0.75f32;
        let pack = facing_mirrors(k).pack();
        for max_depth in [0, 1, 2, 7, 15, 32] {
            let view = View { max_depth, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
            let pixels = seen(other, "facing mirrors", &view, &pack);
            // 0.75^21 is above 1/512, 0.75^22 below.
            let images = max_depth.min(21);
            let wanted: f32 = (0..=images).scan(0.5, |e, _| Some(std::mem::replace(e, *e * k))).sum();
            assert_color(pixels[0].color, wanted, 1e-5);
        }
    });
}

#[test]
fn h31_gpu_light_caught_in_glass_ends_at_the_depth_limit() {
    with_other(|other| {
        let pack = glass_cube().pack();
        for max_depth in [0, 1, 5, 32] {
            let view = View { max_depth, ..look([0.1, 0.0, 0.0], [1.1, 1.0, 0.0]) };
            let pixels = seen(other, "a glass cube", &view, &pack);
            assert_eq!((pixels[0].color, pixels[0].alpha), ([0.0; 3], 1.0));
        }
        let view = look([0.1, 0.0, 0.0], [1.1, 0.7, 0.1]).sized(48, 48);
        let pixels = seen(other, "the critical angle", &view, &pack);
        assert!(pixels.iter().all(|p| p.color.iter().all(|c| (0.0..1.001).contains(c))));
    });
}

#[test]
fn h32_gpu_glass_of_index_1_changes_no_bit() {
    with_other(|other| {
        let view = look([0.0, 0.0, 6.0], [0.0; 3]).sized(48, 48);
        let [with, without] =
            [true, false].map(|with_glass| seen(other, "index 1", &view, &index_1(with_glass).pack()));
        for (i, (a, b)) in with.iter().zip(&without).enumerate() {
            assert_eq!((a.color, a.alpha), (b.color, b.alpha), "pixel {i}");
        }
    });
}

#[test]
fn h33_gpu_a_plate_shifts_a_ray_sideways() {
    with_other(|other| {
        let (thickness, n) = (0.4, 1.5);
        for degrees in [0.0f64, 20.0, 60.0, 70.0] {
            let i = degrees.to_radians();
            let read = |ior: f32| {
                let (stage, view) = plate(thickness, ior, i);
                ruler_at(&seen(other, "a plate", &view, &stage.pack())[0])
            };
            let sine = libm::sin(i);
            let shift = thickness * sine * (1.0 - libm::cos(i) / (n * n - sine * sine).sqrt());
            let measured = (read(1.0) - read(1.5)) * libm::cos(i);
            assert!((measured - shift).abs() < 1e-5, "{degrees} degrees: {measured} instead of {shift}");
        }
    });
}

#[test]
fn h34_gpu_a_glass_ball_focuses_half_a_radius_behind_itself() {
    with_other(|other| {
        let pack = glass_ball(60).pack();
        for h in [0.02, 0.05, 0.11] {
            let view = View { max_depth: 2, ..look([h, 0.003, 3.0], [h, 0.003, 0.0]) };
            let at = ruler_at(&seen(other, "a glass ball", &view, &pack)[0]);
            // Spherical aberration is of the third order.
            assert!(at.abs() < 2e-3 + h * h * h, "{h}: {at}");
        }
        seen(other, "a glass ball", &look([0.3, 0.4, 3.5], [0.0; 3]).sized(64, 64), &pack);
    });
}

#[test]
fn h36_gpu_a_light_at_the_hit_point_makes_no_nan() {
    with_other(|other| {
        for pack in packs(&light_in_surface()) {
            for view in
                [look([0.25, 0.5, 2.0], [0.25, 0.5, 0.0]), look([0.0, 0.4, 3.0], [0.0; 3]).sized(40, 40)]
            {
                for pixel in decode(&bytes(other, &view, &pack)) {
                    assert!(pixel.color.iter().all(|c| c.is_finite() && *c >= 0.0), "{pixel:?}");
                }
            }
        }
    });
}

#[test]
fn h37_gpu_every_pixel_of_a_closed_box_is_hit_and_lit() {
    with_other(|other| {
        let pack = closed_box().pack();
        for view in views_in_box() {
            for pixel in seen(other, "a closed box", &view, &pack) {
                assert!(pixel.alpha == 1.0 && pixel.depth.is_finite() && pixel.color[0] > 0.0, "{pixel:?}");
            }
        }
        // On a wall it looks into the room; inside glass, out through it.
        let wall = seen(other, "on a wall", &look([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]), &pack)[0];
        assert!((wall.depth - 5.0).abs() < 1e-5, "{wall:?}");
        let mut stage = Stage::default();
        add_ruler(&mut stage, -3.0);
        stage.cuboid([-1.0; 3], [1.0; 3], glass(1.5));
        let sine = libm::asin(0.3);
        let eye = [-0.2, 0.05, 0.0];
        let target = [eye[0] + libm::sin(sine), eye[1], -libm::cos(sine)];
        let view = View { max_depth: 1, ..look(eye, target) };
        let wanted = eye[0] + libm::tan(sine) + 2.0 * libm::tan(libm::asin(0.45));
        let at = ruler_at(&seen(other, "inside glass", &view, &stage.pack())[0]);
        assert!((at - wanted).abs() < 1e-5, "{at} instead of {wanted}");
    });
}

#[test]
fn h38_gpu_needles_and_fisheyes() {
    with_other(|other| {
        let pack = bazaar().pack();
        for fov_degrees in [0.0001, 1.0, 120.0, 179.9] {
            let mut view = look([0.3, 0.6, 5.0], [0.0; 3]).sized(48, 48);
            view.pose.fov_degrees = fov_degrees;
            let pixels = seen(other, &format!("{fov_degrees} degrees"), &view, &pack);
            assert!(pixels.iter().all(|p| p.color.iter().all(|c| c.is_finite())));
        }
        seen(other, "everything", &look([0.3, 0.6, 5.0], [0.0; 3]).sized(128, 128), &pack);
    });
}

#[test]
fn h40_gpu_a_long_corridor_has_no_acne_and_no_wide_leak() {
    with_other(|other| {
        for pack in packs(&corridor()) {
            let voxel = pack.frame().step;
            let is_lit = |x: f64| {
                let view = look([x, 1e6 * voxel, 0.0], [x, 0.0, 0.0]);
                decode(&bytes(other, &view, &pack))[0].color[0] > 0.0
            };
            for voxels in [2.0, 3.0, 10.0, 1000.0] {
                assert!(!is_lit(1000.0 - voxels * voxel), "light {voxels} voxels before the contact line");
                assert!(!is_lit(998.0 + voxels * voxel), "light {voxels} voxels inside the shadow");
                assert!(is_lit(998.0 - voxels * voxel), "shadow {voxels} voxels beyond its end");
            }
            let view = look([0.5, 1.5, 0.0], [1000.0, 0.0, 0.0]).sized(120, 120);
            let pixels = seen(other, "a corridor", &view, &pack);
            let floor: Vec<_> = pixels.iter().filter(|p| p.id < 2 && p.depth < 990.0).collect();
            assert!(floor.len() > 2000 && floor.iter().any(|p| p.depth > 200.0), "{}", floor.len());
            for pixel in floor {
                assert_color(pixel.color, 0.5f32.sqrt(), 1e-5);
            }
        }
    });
}

/// A pack of bare triangles, with their own coordinates but for the place and size of the whole.
fn pack_of(soup: &Soup) -> Pack {
    let mut stage = Stage::default();
    for corners in &soup.0 {
        stage.triangle(corners.map(|v| (v.as_dvec3(), BARE)), chalk());
    }
    stage.pack()
}

/// Holds unkind rays of `soup` to the CPU's answers, and those of its packed triangles that `more` makes.
fn check_soup(
    name: &str,
    soup: &Soup,
    other: &dyn Other,
    more: impl Fn(&Soup, &[(usize, f32)]) -> Vec<Ray>,
) -> Pack {
    let pack = pack_of(soup);
    assert_eq!(pack.triangle_count(), soup.len(), "{name}: all are packed");
    let mesh = pack.mesh();
    let packed = Soup((0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect());
    let planes = split_planes(pack.tree().slots);
    let mut random = Random(31);
    let mut rays: Vec<_> = (0..RAYS_OF_SOUP).map(|i| unkind_ray(i, &mut random, &packed, &planes)).collect();
    rays.extend(more(&packed, &planes));
    check_rays(name, &pack, &rays, other);
    pack
}

const RAYS_OF_SOUP: usize = 4000;

fn none(_: &Soup, _: &[(usize, f32)]) -> Vec<Ray> {
    Vec::new()
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
}

#[test]
fn h07_h08_gpu_slivers() {
    with_other(|other| {
        let mut random = Random(43);
        let mut sliver = |length: f32, width: f32| {
            let from = voxel(random.point(Vec3::splat(-length), Vec3::splat(length)));
            let to = voxel(from * -0.9 + random.point(Vec3::splat(-length), Vec3::splat(length)) * 0.04);
            [from, to, from + Vec3::new(0.0, width, 0.0)]
        };
        let soup = Soup((0..500).map(|_| sliver(500_000.0, 0.5)).collect());
        check_soup("slivers of a millionth", &soup, other, none);
        let soup = Soup((0..10_000).map(|_| sliver(250_000.0, 1.0)).collect());
        check_soup("diagonal slivers", &soup, other, none);
    });
}

#[test]
fn h09_gpu_of_a_thousand_copies_the_first_is_hit() {
    with_other(|other| {
        let triangle = [Vec3::ZERO, Vec3::new(300.0, 20.0, 5.0), Vec3::new(10.0, 250.0, 90.0)].map(voxel);
        let pack = check_soup("copies", &Soup(vec![triangle; 1000]), other, none);
        let [a, b, c] = pack.mesh().vertices(0);
        let mut random = Random(3);
        let rays: Vec<_> = (0..2000)
            .map(|_| {
                let (u, v) = (0.05 + 0.4 * random.unit(), 0.05 + 0.4 * random.unit());
                let target = a + (b - a) * u + (c - a) * v;
                // From where the plane is seen under a fair angle.
                let away = (b - a).cross(c - a).normalize() + random.direction() * 0.5;
                ray(target + away * (b - a).length(), Vec3::ZERO).towards(target)
            })
            .collect();
        for hit in other.hits(&pack, &rays) {
            assert_eq!(hit.map(|hit| hit.triangle), Some(0), "equal distances, so the smallest id");
        }
    });
}

trait Towards {
    fn towards(self, target: Vec3) -> Self;
}

impl Towards for Ray {
    fn towards(self, target: Vec3) -> Self {
        Self { direction: target - self.origin, ..self }
    }
}

#[test]
fn h11_h12_gpu_quads_in_split_planes_and_rays_along_them() {
    with_other(|other| {
        let mut triangles = sphere(Vec3::new(-500.0, 0.0, 0.0), Vec3::splat(200.0), 6);
        triangles.extend(sphere(Vec3::new(500.0, 0.0, 0.0), Vec3::splat(200.0), 6));
        triangles.extend(quad(0, 0.5, [-900.5, -900.5], [900.5, 900.5]));
        let soup = Soup(triangles);
        let pack = check_soup("a wall in a split plane", &soup, other, none);
        let wall = pack.mesh().vertices(soup.len() - 1);
        let mut random = Random(47);
        let rays: Vec<_> = (0..4000)
            .map(|i| {
                let (u, v) = (random.unit(), random.unit());
                let target = wall[0] + (wall[1] - wall[0]) * u + (wall[2] - wall[0]) * (v * (1.0 - u));
                let side = if i % 2 == 0 { 1.0 } else { -1.0 };
                let away = Vec3::new(side * (1.0 + 200.0 * random.unit()), random.unit(), random.unit());
                ray(target + away, Vec3::ZERO).towards(target)
            })
            .collect();
        check_rays("through a wall", &pack, &rays, other);
        assert!(other.hits(&pack, &rays).iter().all(Option::is_some), "a ray passes the wall");
        for (name, soup) in kinds::scenes() {
            check_soup(name, &soup, other, none);
        }
    });
}

#[test]
fn h13_gpu_rays_along_edges_and_through_corners_of_cells() {
    with_other(|other| {
        for (name, soup) in kinds::scenes() {
            check_soup(name, &soup, other, |_, planes| {
                let along = [0, 1, 2].map(|axis| -> Vec<f32> {
                    planes.iter().filter(|plane| plane.0 == axis).map(|plane| plane.1).collect()
                });
                let mut random = Random(48);
                let corner_ray = |i: usize| {
                    let corner = [0, 1, 2].map(|axis| along[axis][random.below(along[axis].len())]);
                    let mut direction = random.direction();
                    if i.is_multiple_of(2) {
                        direction = Vec3::splat(if i.is_multiple_of(4) { 0.0 } else { -0.0 });
                        direction[i % 3] = if i % 8 < 4 { 1.0 } else { -1.0 };
                    }
                    let origin = Vec3::from_array(corner) - direction * 400.0 * random.unit().round();
                    ray(origin, direction)
                };
                (0..3000).map(corner_ray).collect()
            });
        }
    });
}

#[test]
fn h39_gpu_directions_that_are_subnormal_zero_or_not_finite() {
    with_other(|other| {
        for (name, soup) in kinds::scenes() {
            let pack = check_soup(name, &soup, other, |soup, planes| {
                let mut random = Random(53);
                let subnormal = |i: usize| {
                    let mut ray = unkind_ray(1 + UNKIND * i, &mut random, soup, planes);
                    ray.direction[i % 3] = [1e-40, -1e-40, f32::MIN_POSITIVE][i % 3];
                    ray
                };
                (0..1000).map(subnormal).collect()
            });
            let far = Ray::DIRECTION_MAX * 2.0;
            let wild = [Vec3::ZERO, Vec3::NAN, Vec3::splat(1e-40), Vec3::INFINITY, Vec3::splat(far)];
            let mut rays: Vec<_> = wild.map(|direction| ray(Vec3::ZERO, direction)).to_vec();
            rays.push(ray(Vec3::NAN, Vec3::X));
            rays.push(Ray { t_min: 2.0, t_max: 1.0, ..ray(Vec3::ZERO, Vec3::X) });
            assert_eq!(other.hits(&pack, &rays), vec![None; rays.len()], "{name}");
        }
    });
}

#[test]
fn h41_gpu_triangles_at_shrinking_distances() {
    with_other(|other| {
        let mut triangles = Vec::new();
        for k in 0..20 {
            let at = libm::ldexpf(100_000.0, -k);
            let shifted = |y: f32, z: f32| Vec3::splat(at) + Vec3::new(0.0, y, z);
            triangles.push([shifted(0.0, 0.0), shifted(at, 0.0), shifted(0.0, at)]);
        }
        check_soup("shrinking", &Soup(triangles.clone()), other, none);
        let copies: Vec<_> = std::iter::repeat_n(triangles, 30).flatten().collect();
        check_soup("shrinking copies", &Soup(copies), other, none);
    });
}

/// A light at every corner and on every edge: what asks for shadows grazes.
#[test]
fn h14_gpu_shadow_rays_along_edges() {
    with_other(|other| {
        let mut stage = Stage::default();
        stage.cuboid([-1.0; 3], [1.0; 3], chalk());
        stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], chalk());
        for corner in [DVec3::ONE, DVec3::new(3.0, 1.0, 1.0), DVec3::new(1.0, 3.0, 1.0)] {
            stage.light(point_light(corner.as_vec3().to_array(), 9.0));
        }
        for pack in packs(&stage) {
            seen(other, "lights at edges", &look([3.0, 2.5, 4.0], [0.0; 3]).sized(96, 96), &pack);
        }
    });
}
