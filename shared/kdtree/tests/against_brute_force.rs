//! The tree finds what a test of every triangle finds, bit for bit.

mod common;

use common::{Random, Soup, planes, scenes, sphere, truth, unkind_ray, voxel};
use fearless_simd::Level;
use tessera_geometry::triangle::{RayShear, intersect};
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_kdtree::{Kernel, Tree, brute_force_closest, brute_force_closest_hits, validate};

/// Holds closest and any hit of `tree` to brute force on `count` rays of the unkind mix.
fn check(name: &str, soup: &Soup, tree: &Tree, count: usize) {
    validate(&tree.view(), soup.len()).unwrap();
    let planes = planes(tree);
    let mut random = Random(5);
    let mut hits = 0;
    for i in 0..count {
        let ray = unkind_ray(i, &mut random, soup, &planes);
        // Odd rays see only odd triangles, as through alpha cut-outs.
        let accept = |hit: &Hit| i % 2 == 0 || hit.triangle % 2 == 1;
        let expected = brute_force_closest(soup.len(), soup, &ray, accept);
        let found = tree.view().closest_hit(soup, &ray, accept);
        let bits =
            |hit: Option<Hit>| hit.map(|h| (h.triangle, h.t.to_bits(), h.b1.to_bits(), h.b2.to_bits()));
        assert_eq!(bits(found), bits(expected), "{name}, ray {i}: {ray:?}: {found:?}, not {expected:?}");
        assert_eq!(
            tree.view().any_hit(soup, &ray, accept),
            expected.is_some(),
            "{name}, any hit, ray {i}: {ray:?}, closest {expected:?}"
        );
        // A range that ends at the hit holds nothing; one that ends just behind it does.
        if let Some(hit) = expected {
            hits += 1;
            let until = Ray { t_max: hit.t, ..ray };
            assert!(!tree.view().any_hit(soup, &until, accept), "{name}, ray {i}: something before {hit:?}");
            let beyond = Ray { t_max: hit.t.next_up(), ..ray };
            assert!(tree.view().any_hit(soup, &beyond, accept), "{name}, ray {i}: {ray:?}: {hit:?} lost");
        }
    }
    assert!(hits > count / 20, "{name}: only {hits} of {count} rays hit anything, so little was tested");
}

#[test]
fn every_scene_and_reference_count_agrees_with_brute_force() {
    for (name, soup) in scenes() {
        for max_refs in 0..=2 {
            let tree = soup.build(max_refs);
            check(&format!("{name}, {max_refs} references"), &soup, &tree, 10_000 / 3 + 1);
        }
    }
}

/// The test that tree and brute force share, held to exact integers: triangles from slivers half a voxel wide to 2^20 voxels, near and
/// far, rays at inner points, edges and vertices.
#[test]
fn the_triangle_test_is_wrong_by_rounding_only() {
    let mut random = Random(61);
    let (mut hits, mut differing) = (0, 0);
    for i in 0..400_000 {
        let mut any = |reach: f32| voxel(random.point(Vec3::splat(-reach), Vec3::splat(reach)));
        let (origin, reach) = (any(500_000.0), [4.0, 60.0, 1000.0, 500_000.0][i % 4]);
        let a = any(500_000.0);
        let [b, c] = [a + any(reach) - 0.5, a + any(reach) - 0.5];
        let c = if i % 5 == 0 { voxel(a.midpoint(b)) + Vec3::Y } else { c };
        let (s, t) = (random.unit(), random.unit());
        let target = match i % 3 {
            0 => a + (b - a) * s + (c - a) * (t * (1.0 - s)),
            1 => a + (b - a) * s,
            _ => c,
        };
        // Whole multiples of 2^-20: what the integers can hold.
        let direction = ((target - origin) / 512.0 * 1_048_576.0).round() / 1_048_576.0;
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        if direction == Vec3::ZERO {
            continue;
        }
        let truth = truth::judge_exactly(&ray, [a, b, c]);
        let found = intersect(&ray, &RayShear::new(&ray), [a, b, c], ray.t_max);
        hits += usize::from(found.is_some());
        if truth.t.is_some() != found.is_some() {
            differing += 1;
            assert!(truth.is_within_rounding(), "{truth:?}, not {found:?}: {ray:?} {a} {b} {c}");
        } else if let (Some(t), Some(found)) = (truth.t, found)
            && !truth.is_within_rounding()
        {
            assert!(
                (t - f64::from(found.t)).abs() <= t * f64::from(f32::EPSILON),
                "{truth:?}, not {found:?}"
            );
        }
    }
    assert!(
        hits > 100_000 && differing > 1000,
        "{hits} hits, {differing} that rounding decides: little was tested"
    );
}

/// A closed mesh seen from inside: every ray aimed at a vertex or an edge must hit something.
fn leaks(soup: &Soup, tree: &Tree, rays: usize) -> usize {
    let mut random = Random(17);
    (0..rays)
        .filter(|&i| {
            let origin = random.point(Vec3::new(-300.0, -300.0, -30.0), Vec3::new(300.0, 300.0, 30.0));
            let triangle = soup.0[random.below(soup.0.len())];
            let target = match i % 3 {
                0 => triangle[random.below(3)],
                1 => triangle[0].midpoint(triangle[1]),
                _ => triangle[1] + (triangle[2] - triangle[1]) * random.unit(),
            };
            let ray = Ray { origin, direction: target - origin, t_min: 0.0, t_max: f32::INFINITY };
            tree.view().closest_hit(soup, &ray, |_| true).is_none()
        })
        .count()
}

#[test]
fn no_ray_leaks_out_of_a_closed_mesh() {
    // A soup is never welded: its triangles share positions only. Flattened, so that many edges are seen under small angles.
    for flatness in [1.0, 0.1] {
        let radius = Vec3::new(1000.0, 1000.0, 1000.0 * flatness);
        let soup = Soup(sphere(Vec3::ZERO, radius, 24));
        for max_refs in 0..=2 {
            let tree = soup.build(max_refs);
            assert_eq!(leaks(&soup, &tree, 60_000), 0, "flatness {flatness}, {max_refs} references");
        }
    }
}

/// What this machine has, and what every machine has.
fn kernels() -> [Kernel; 2] {
    [Kernel::wide(), Kernel::Wide(Level::baseline())]
}

fn all_bits(hits: &[Option<Hit>]) -> Vec<Option<(u32, u32, u32, u32)>> {
    let bits = |h: &Hit| (h.triangle, h.t.to_bits(), h.b1.to_bits(), h.b2.to_bits());
    hits.iter().map(|hit| hit.as_ref().map(bits)).collect()
}

/// Packet `i`: rays of the unkind mix, or one of them eight times with neighbours of its target, so that they stay together.
fn packet(i: usize, random: &mut Random, soup: &Soup, planes: &[(usize, f32)]) -> [Ray; 8] {
    let first = unkind_ray(i, random, soup, planes);
    if i.is_multiple_of(2) {
        let spread = [0.0, 1e-6, 1e-3, 0.05][i / 2 % 4] * first.direction.abs().max_element();
        std::array::from_fn(|_| Ray { direction: first.direction + random.direction() * spread, ..first })
    } else {
        std::array::from_fn(|lane| unkind_ray(8 * i + lane, random, soup, planes))
    }
}

#[test]
fn eight_rays_at_once_find_what_each_finds_alone() {
    for (name, soup) in scenes() {
        let tree = soup.build(2);
        let planes = planes(&tree);
        let mut random = Random(11);
        let mut hits = 0;
        for i in 0..600 {
            let rays = packet(i, &mut random, &soup, &planes);
            let lanes = [0xFF, 0xFF, 0x5B, 0x81][i % 4];
            // In every third packet odd rays see only odd triangles.
            let filtered = i % 3 == 0;
            let accept =
                |lane: usize, hit: &Hit| !filtered || lane.is_multiple_of(2) || hit.triangle % 2 == 1;
            let expected: [Option<Hit>; 8] = std::array::from_fn(|lane| {
                let wanted = lanes >> lane & 1 == 1;
                let judge = || brute_force_closest(soup.len(), &soup, &rays[lane], |hit| accept(lane, hit));
                wanted.then(judge).flatten()
            });
            let blocked: u8 =
                (0..8).filter(|&lane| expected[lane].is_some()).fold(0, |bits, lane| bits | 1 << lane);
            hits += blocked.count_ones();
            for kernel in kernels() {
                let at = format!("{name}, packet {i}, {kernel:?}: {rays:?}");
                let (view, expected) = (tree.view(), all_bits(&expected));
                let judged = brute_force_closest_hits(kernel, soup.len(), &soup, &rays, lanes, accept);
                assert_eq!(all_bits(&judged), expected, "brute force, {at}");
                let found = view.closest_hits_where(kernel, &soup, &rays, lanes, accept);
                assert_eq!(all_bits(&found), expected, "closest hits, {at}");
                assert_eq!(
                    view.any_hits_where(kernel, &soup, &rays, lanes, accept),
                    blocked,
                    "any hits, {at}"
                );
                if !filtered {
                    let found = view.closest_hits(kernel, &soup, &rays, lanes);
                    assert_eq!(all_bits(&found), expected, "all closest hits, {at}");
                    assert_eq!(view.any_hits(kernel, &soup, &rays, lanes), blocked, "all any hits, {at}");
                }
            }
            // Ranges that end at the hits hold nothing; ranges that end just behind them do.
            for (end, behind) in [(0, 0), (1, blocked)] {
                let until: [Ray; 8] = std::array::from_fn(|lane| {
                    let t = |hit: Hit| if end == 0 { hit.t } else { hit.t.next_up() };
                    Ray { t_max: expected[lane].map_or(rays[lane].t_max, t), ..rays[lane] }
                });
                let found = tree.view().any_hits_where(Kernel::wide(), &soup, &until, lanes, accept);
                assert_eq!(found, behind, "{name}, packet {i}, ends {end}: {until:?}");
                if !filtered {
                    let found = tree.view().any_hits(Kernel::wide(), &soup, &until, lanes);
                    assert_eq!(found, behind, "{name}, packet {i}, ends {end}: {until:?}");
                }
            }
        }
        assert!(hits > 200, "{name}: only {hits} of 4800 rays hit anything, so little was tested");
    }
}
