//! Scenes that break careless builders and traversals.

mod common;

use common::{Random, Soup, quad, scenes, tubes, unkind_ray, voxel};
use tessera_geometry::{Ray, Vec3};
use tessera_kdtree::{BuildError, BuildOptions, brute_force_closest, build, validate};

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
}

/// Builds `soup` with 0, 1 and 2 references, validates each tree, holds it to brute force on `rays` unkind rays, and returns the
/// number of bytes for 0 references.
fn check(name: &str, soup: &Soup, rays: usize) -> u64 {
    let mut bytes = 0;
    for max_refs in 0..=2 {
        let tree = soup.build(max_refs);
        validate(&tree.view(), soup.len()).unwrap();
        let planes = common::planes(&tree);
        let mut random = Random(31);
        for i in 0..rays {
            let ray = unkind_ray(i, &mut random, soup, &planes);
            let expected = brute_force_closest(soup.len(), soup, &ray, |_| true);
            let found = tree.view().closest_hit(soup, &ray, |_| true);
            assert_eq!(found, expected, "{name}, {max_refs} references, ray {i}: {ray:?}");
        }
        let stats = tree.stats();
        assert!(stats.depth <= 48, "{name}: depth {}", stats.depth);
        assert_eq!(
            (stats.depth, stats.bytes),
            (tree.depth, tree.slots.len() as u64 * 8 + tree.list.len() as u64 * 4)
        );
        if max_refs == 0 {
            bytes = stats.bytes;
        }
    }
    bytes
}

#[test]
fn an_empty_scene_is_one_empty_leaf_that_nothing_hits() {
    let soup = Soup(Vec::new());
    let tree = soup.build(2);
    assert_eq!(
        (tree.slots.as_slice(), tree.list.as_slice(), tree.depth),
        ([[0, 3]].as_slice(), [].as_slice(), 0)
    );
    validate(&tree.view(), 0).unwrap();
    for direction in [Vec3::X, Vec3::new(0.0, -0.0, -1.0), Vec3::ONE] {
        assert_eq!(tree.view().closest_hit(&soup, &ray(Vec3::ZERO, direction), |_| true), None);
    }
}

#[test]
fn one_triangle_is_hit_inside_and_missed_outside() {
    let soup = Soup(vec![[voxel(Vec3::ZERO), voxel(Vec3::X * 100.0), voxel(Vec3::Y * 100.0)]]);
    assert!(check("one triangle", &soup, 2000) <= 8 * 13, "more than six cuts around one triangle");
    let tree = soup.build(0);
    let down = |x, y| tree.view().closest_hit(&soup, &ray(Vec3::new(x, y, 50.0), Vec3::NEG_Z), |_| true);
    assert_eq!(down(20.0, 20.0).map(|h| (h.triangle, h.t)), Some((0, 49.5)));
    assert_eq!(down(80.0, 80.0), None);
    assert_eq!(down(0.25, 0.25), None);
}

#[test]
fn a_thousand_copies_end_in_one_leaf_and_the_smallest_id_wins() {
    let triangle =
        [voxel(Vec3::ZERO), voxel(Vec3::new(300.0, 20.0, 5.0)), voxel(Vec3::new(10.0, 250.0, 90.0))];
    let soup = Soup(vec![triangle; 1000]);
    check("copies", &soup, 500);
    let tree = soup.build(2);
    let full = tree.stats().leaves - tree.stats().empty_leaves;
    assert!(full <= 4, "{full} leaves share a thousand copies that no plane can part");
    let at = (triangle[0] + triangle[1] + triangle[2]) / 3.0;
    let hit = tree.view().closest_hit(&soup, &ray(at + Vec3::Z * 9.0, Vec3::NEG_Z), |_| true).unwrap();
    assert_eq!(hit.triangle, 0);
    let last =
        tree.view().closest_hit(&soup, &ray(at + Vec3::Z * 9.0, Vec3::NEG_Z), |h| h.triangle > 998).unwrap();
    assert_eq!((last.triangle, last.t), (999, hit.t));
}

#[test]
fn overlapping_triangles_of_a_plane_tie_and_the_smaller_id_wins() {
    // Differently divided and shifted floors at one height, in planes along the axes and in a tilted one.
    for tilt in [0.0, 0.5] {
        let lift = |t: [Vec3; 3]| t.map(|v| Vec3::new(v.x, v.y, v.z + tilt * (v.x - 0.5)));
        let mut triangles = Vec::new();
        for (low, high) in [(-200.5, 200.5), (-64.5, 100.5), (-128.5, 64.5)] {
            triangles.extend(quad(2, 7.5, [low, low], [high, high]).map(lift));
        }
        let soup = Soup(triangles);
        let tree = soup.build(2);
        let mut random = Random(41);
        for i in 0..20_000 {
            let target = random.point(Vec3::new(-60.0, -60.0, 0.0), Vec3::new(60.0, 60.0, 1.0));
            let target = Vec3::new(target.x, target.y, 7.5 + tilt * (target.x - 0.5));
            let origin = random.point(Vec3::new(-300.0, -300.0, 200.0), Vec3::new(300.0, 300.0, 400.0));
            let hit = tree.view().closest_hit(&soup, &ray(origin, target - origin), |_| true).unwrap();
            assert!(hit.triangle < 2, "tilt {tilt}, ray {i}: {hit:?}");
        }
    }
}

#[test]
fn long_diagonal_slivers_stay_within_the_depth_cap() {
    let mut random = Random(43);
    let soup = Soup(
        (0..10_000)
            .map(|_| {
                let from = voxel(random.point(Vec3::splat(-250_000.0), Vec3::splat(250_000.0)));
                let to = voxel(from * -0.9 + random.point(Vec3::splat(-1e4), Vec3::splat(1e4)));
                [from, to, from + Vec3::new(0.0, 1.0, 0.0)]
            })
            .collect(),
    );
    let bytes = check("slivers", &soup, 40);
    assert!(bytes < 20_000_000, "{bytes} bytes for ten thousand slivers");
}

#[test]
fn shrinking_distances_cannot_make_the_tree_deep() {
    // Triangles at 2^-k of a distance: each plane parts one from the rest.
    let mut triangles = Vec::new();
    for k in 0..120 {
        let at = libm::ldexpf(100_000.0, -k);
        let side = Vec3::new(0.0, at, 0.0);
        triangles.push([Vec3::splat(at), Vec3::splat(at) + side, Vec3::splat(at) + Vec3::new(0.0, 0.0, at)]);
    }
    check("shrinking", &Soup(triangles.clone()), 800);
    let copies: Vec<_> = std::iter::repeat_n(triangles, 30).flatten().collect();
    check("shrinking copies", &Soup(copies), 40);
}

#[test]
fn flat_scenes_are_seen_from_above_and_not_from_the_side() {
    for axis in 0..3 {
        let mut triangles = Vec::new();
        for i in 0..30 {
            let low = voxel(Vec3::splat(i as f32 * 20.0)).x;
            triangles.extend(quad(axis, 0.5, [low, -10.5], [low + 15.0, 50.5]));
        }
        let soup = Soup(triangles);
        check("flat", &soup, 800);
        let tree = soup.build(2);
        let mut along = Vec3::ZERO;
        along[(axis + 1) % 3] = 1.0;
        let mut start = Vec3::splat(0.5) - along * 50.0;
        start[axis] = 0.5;
        assert_eq!(tree.view().closest_hit(&soup, &ray(start, along), |_| true), None, "edge-on");
        let mut down = Vec3::ZERO;
        down[axis] = -1.0;
        let above = Vec3::splat(5.0) - down * 100.0;
        assert!(tree.view().closest_hit(&soup, &ray(above, down), |_| true).is_some(), "from above");
    }
}

#[test]
fn a_quad_in_a_split_plane_stops_rays_from_both_sides() {
    // Balls on both sides make the plane of the wall a split plane.
    let mut triangles = common::sphere(Vec3::new(-500.0, 0.0, 0.0), Vec3::splat(200.0), 6);
    triangles.extend(common::sphere(Vec3::new(500.0, 0.0, 0.0), Vec3::splat(200.0), 6));
    let wall = triangles.len() as u32;
    triangles.extend(quad(0, 0.5, [-900.5, -900.5], [900.5, 900.5]));
    let soup = Soup(triangles);
    for max_refs in 0..=2 {
        let tree = soup.build(max_refs);
        assert!(common::planes(&tree).contains(&(0, 0.5)), "the wall is no split plane: nothing is tested");
        let mut random = Random(47);
        for _ in 0..4000 {
            let target = random.point(Vec3::new(0.5, -900.0, -900.0), Vec3::new(0.5, 900.0, 900.0));
            for side in [-1.0, 1.0] {
                let from =
                    target + Vec3::new(side * (1.0 + 200.0 * random.unit()), random.unit(), random.unit());
                let hit = tree.view().closest_hit(&soup, &ray(from, target - from), |h| h.triangle >= wall);
                assert!(hit.is_some(), "{max_refs} references, from {from} to {target}");
            }
        }
    }
}

#[test]
fn h13_rays_along_edges_and_through_corners_of_cells_agree_with_brute_force() {
    for (name, soup) in scenes() {
        for max_refs in 0..=2 {
            let tree = soup.build(max_refs);
            let planes = common::planes(&tree);
            let along = [0, 1, 2].map(|axis| {
                let of_axis: Vec<f32> = planes.iter().filter(|p| p.0 == axis).map(|p| p.1).collect();
                assert!(of_axis.len() > 10, "{name}: hardly any plane across {axis}");
                of_axis
            });
            let mut random = Random(48);
            let mut hits = 0;
            for i in 0..1500 {
                let corner =
                    Vec3::from_array([0, 1, 2].map(|axis| along[axis][random.below(along[axis].len())]));
                let direction = if i % 2 == 0 {
                    // Along the edge of a cell, with zeros of both signs.
                    let mut direction = Vec3::splat(if i % 4 == 0 { 0.0 } else { -0.0 });
                    direction[i % 3] = if i % 8 < 4 { 1.0 } else { -1.0 };
                    direction
                } else {
                    random.direction()
                };
                let ray = ray(corner - direction * 400.0 * random.unit().round(), direction);
                let expected = brute_force_closest(soup.len(), &soup, &ray, |_| true);
                let found = tree.view().closest_hit(&soup, &ray, |_| true);
                assert_eq!(found, expected, "{name}, {max_refs} references, ray {i}: {ray:?}");
                hits += usize::from(found.is_some());
            }
            assert!(hits > 50, "{name}: {hits} hits");
        }
    }
}

#[test]
fn the_nearest_of_triangles_around_a_vertex_is_found_however_close_the_next_one_is() {
    // Found by search, cut down: rays through a shared vertex that lies in split planes; what is nearest by a digit, by the test's own
    // rounding, is listed beyond a plane that an infinitely thin ray does not reach in time.
    let at = |corners: [[f32; 3]; 3]| corners.map(Vec3::from_array);
    for (origin, direction, triangles) in [
        (
            Vec3::new(0.221_316_34, -4.219_932, -5.592_894_6),
            Vec3::new(12.0, 31.0, 4.0),
            [
                [[0.5, -3.5, -5.5], [0.5, -2.5, -7.5], [0.5, -2.5, -7.5]],
                [[1.5, 5.5, -10.5], [2.5, 5.5, -12.5], [-0.5, 5.5, -11.5]],
                [[0.5, -3.5, -5.5], [12.5, 27.5, -1.5], [-11.5, 2.5, -1.5]],
                [[0.5, -3.5, -5.5], [20.5, -31.5, -27.5], [-31.5, 27.5, -12.5]],
            ],
        ),
        (
            Vec3::new(-0.493_194_34, -3.528_923_7, -5.505_104),
            Vec3::new(-4.0, 17.0, 3.0),
            [
                [[-0.5, -3.5, -5.5], [1.5, -1.5, -2.5], [1.5, -3.5, 1.5]],
                [[10.5, 9.5, -10.5], [10.5, 5.5, -4.5], [7.5, 8.5, -13.5]],
                [[-0.5, -3.5, -5.5], [-4.5, 13.5, -2.5], [-6.5, 1.5, -7.5]],
                [[-10.5, -1.5, -10.5], [-11.5, -2.5, -8.5], [-10.5, -3.5, -10.5]],
            ],
        ),
    ] {
        let soup = Soup(triangles.map(at).to_vec());
        let ray = ray(origin, direction);
        let expected = brute_force_closest(soup.len(), &soup, &ray, |_| true);
        assert!(expected.is_some());
        for max_refs in 0..=2 {
            assert_eq!(soup.build(max_refs).view().closest_hit(&soup, &ray, |_| true), expected, "{ray:?}");
        }
    }
}

#[test]
fn rays_that_cannot_be_traced_miss_everything() {
    let soup = tubes();
    let tree = soup.build(2);
    for direction in [Vec3::ZERO, Vec3::NAN, Vec3::splat(1e-40), Vec3::new(f32::INFINITY, 0.0, 0.0)] {
        let ray = ray(Vec3::ZERO, direction);
        assert_eq!(tree.view().closest_hit(&soup, &ray, |_| true), None);
        assert!(!tree.view().any_hit(&soup, &ray, |_| true));
        assert_eq!(brute_force_closest(soup.len(), &soup, &ray, |_| true), None);
    }
}

#[test]
fn subnormal_direction_components_count_as_zero() {
    for (name, soup) in scenes() {
        let tree = soup.build(2);
        let planes = common::planes(&tree);
        let mut random = Random(53);
        for i in 0..400 {
            let mut ray = unkind_ray(1 + common::UNKIND * i, &mut random, &soup, &planes);
            ray.direction[i % 3] = [1e-40, -1e-40, f32::MIN_POSITIVE][i % 3];
            let expected = brute_force_closest(soup.len(), &soup, &ray, |_| true);
            assert_eq!(tree.view().closest_hit(&soup, &ray, |_| true), expected, "{name}, {ray:?}");
        }
    }
}

#[test]
fn directions_of_any_length_find_the_same() {
    for (name, soup) in scenes() {
        let tree = soup.build(2);
        let planes = common::planes(&tree);
        let mut random = Random(54);
        for i in 0..400 {
            let ray = unkind_ray(i, &mut random, &soup, &planes);
            let found = tree.view().closest_hit(&soup, &ray, |_| true);
            // A power of two changes exponents only; a component that is no divisor is none at any length.
            let length = libm::exp2f(libm::log2f(ray.direction.abs().max_element()).floor());
            for scale in [Ray::DIRECTION_MIN / length, Ray::DIRECTION_MAX / length / 2.0] {
                let scaled = Ray { direction: ray.direction * scale, ..ray };
                let expected = found.map(|hit| tessera_geometry::Hit { t: hit.t / scale, ..hit });
                assert_eq!(tree.view().closest_hit(&soup, &scaled, |_| true), expected, "{name}, {ray:?}");
            }
        }
    }
}

#[test]
fn scenes_far_from_the_origin_of_coordinates_agree_with_brute_force() {
    // Coordinates are 1/8 apart there, and the ray is thinner than that.
    for (name, soup) in [("spheres", common::spheres()), ("terrain", common::terrain())] {
        let far = |v: Vec3| (v / 8.0).floor() / 8.0 + Vec3::new(1_048_576.0, -1_572_864.0, 1_310_720.0);
        let soup = Soup(soup.0.into_iter().map(|corners| corners.map(far)).collect());
        check(name, &soup, 2000);
    }
    // A box of which rays see edges and corners from outside: a hit by rounding lies beside the scene's own box.
    for at in [Vec3::ZERO, Vec3::new(1_048_576.0, -1_572_864.0, 1_310_720.0)] {
        let cube = (0..3).flat_map(|axis| [-32.0, 32.0].map(|side| quad(axis, side, [-32.0; 2], [32.0; 2])));
        let soup = Soup(cube.flatten().map(|corners| corners.map(|v| v + at)).collect());
        check("cube", &soup, 20_000);
    }
}

#[test]
fn triangles_that_are_not_finite_are_left_out() {
    let mut soup = tubes();
    let plain = soup.build(2);
    let good = soup.0.len();
    soup.0.push([Vec3::NAN, Vec3::X, Vec3::Y]);
    soup.0.push([Vec3::ZERO, Vec3::X * f32::INFINITY, Vec3::Y]);
    assert_eq!(soup.build(2), plain);
    assert!(good > 1000);
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    // Larger than one piece, so that pieces are built in parallel.
    let mut random = Random(59);
    let soup = Soup(
        (0..20_000)
            .map(|_| {
                let at = random.point(Vec3::splat(-50_000.0), Vec3::splat(50_000.0));
                [0, 1, 2].map(|_| voxel(at + random.direction() * 900.0))
            })
            .collect(),
    );
    let with = |threads, max_refs| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| soup.build(max_refs))
    };
    for max_refs in [0, 2] {
        let one = with(1, max_refs);
        validate(&one.view(), soup.len()).unwrap();
        assert!(one == with(4, max_refs), "{max_refs} references: 1 and 4 threads differ");
    }
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    let refused = |options: BuildOptions| match build(0, |_| [Vec3::ZERO; 3], &options) {
        Err(BuildError::Option { name, .. }) => name,
        other => panic!("{options:?} gave {other:?}"),
    };
    let good = BuildOptions::default();
    assert_eq!(refused(BuildOptions { max_refs: 3, ..good }), "max_refs");
    assert_eq!(refused(BuildOptions { tau_occupancy: f32::NAN, ..good }), "tau_occupancy");
    assert_eq!(refused(BuildOptions { tau_frequency: 1.5, ..good }), "tau_frequency");
    assert_eq!(refused(BuildOptions { least_saving: -0.5, ..good }), "least_saving");
    assert_eq!(refused(BuildOptions { tau_tests: f32::INFINITY, ..good }), "tau_tests");
    assert_eq!(refused(BuildOptions { traversal_cost: 0.0, ..good }), "traversal_cost");
    assert_eq!(refused(BuildOptions { intersection_cost: f32::INFINITY, ..good }), "intersection_cost");
    assert_eq!(refused(BuildOptions { empty_factor: 0.0, ..good }), "empty_factor");
}
