//! The tree finds what a test of every triangle finds, bit for bit.

mod common;

use common::{Random, Soup, planes, scenes, sphere, unkind_ray};
use tessera_geometry::{Ray, Vec3};
use tessera_kdtree::{Tree, brute_force_closest, validate};

/// Holds closest and any hit of `tree` to brute force on `count` rays of the unkind mix.
fn check(name: &str, soup: &Soup, tree: &Tree, count: usize) {
    validate(&tree.view(), soup.len()).unwrap();
    let planes = planes(tree);
    let mut random = Random(5);
    let mut hits = 0;
    for i in 0..count {
        let ray = unkind_ray(i, &mut random, soup, &planes);
        // Odd rays see only odd triangles, as through alpha cut-outs.
        let accept = |hit: &tessera_geometry::Hit| i % 2 == 0 || hit.triangle % 2 == 1;
        let expected = brute_force_closest(soup.len(), soup, &ray, accept);
        let found = tree.view().closest_hit(soup, &ray, accept);
        let bits = |hit: Option<tessera_geometry::Hit>| {
            hit.map(|h| (h.triangle, h.t.to_bits(), h.b1.to_bits(), h.b2.to_bits()))
        };
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
