//! What references do to a tree: which triangles they take, and what they save.

mod common;

use common::{Soup, fans, quad, spheres, tubes};
use tessera_geometry::{Aabb, Vec3};
use tessera_kdtree::{BuildOptions, Tree, node::Node};

/// Every reference of `tree`, by node.
fn references(tree: &Tree) -> Vec<Vec<u32>> {
    let mut all = Vec::new();
    let mut slot = 0;
    while slot < tree.slots.len() {
        let node = Node(tree.slots[slot]);
        if node.is_leaf() {
            slot += 1;
            continue;
        }
        if node.refs() > 0 {
            all.push(tree.slots[slot + 1][..node.refs() as usize].to_vec());
        }
        slot += node.size() as usize;
    }
    all
}

/// A row of small triangles in front of one that spans them all and leans, so that no plane parts it from them.
fn row_under_a_roof() -> Soup {
    let mut triangles =
        vec![[Vec3::new(-900.5, -40.5, -3.5), Vec3::new(900.5, -40.5, 5.5), Vec3::new(0.5, 80.5, 1.5)]];
    for i in 0..40 {
        let at = Vec3::new(i as f32 * 40.0 - 799.5, 0.5, 0.5);
        triangles.push([at, at + Vec3::new(9.0, 0.0, 1.0), at + Vec3::new(0.0, 9.0, 2.0)]);
    }
    Soup(triangles)
}

#[test]
fn the_triangle_that_most_leaves_list_moves_to_a_node_above_them() {
    let soup = row_under_a_roof();
    let [standard, one] = [soup.build(0), soup.build(1)];
    assert!(references(&standard).is_empty());
    assert_eq!(references(&one)[0], [0], "the first reference on the way down is the spanning triangle");
    let [standard, one] = [standard.stats(), one.stats()];
    assert!(one.bytes < standard.bytes, "{} bytes, {} without references", one.bytes, standard.bytes);
    assert!(one.leaf_refs * 4 < standard.leaf_refs * 3, "{one:?}, without references {standard:?}");
}

#[test]
fn thresholds_decide_who_is_taken() {
    let soup = fans();
    let with = |tau_occupancy, tau_frequency, tau_tests| {
        let options = BuildOptions { tau_occupancy, tau_frequency, tau_tests, ..BuildOptions::default() };
        references(&soup.build_with(&options)).len()
    };
    let usual = with(0.5, 0.4, 0.6);
    assert!(usual > 0);
    assert!(with(1.0, 0.4, 0.6) < usual, "only triangles that span their node whole");
    assert!(with(0.5, 1.0, 0.6) < usual, "only triangles that every leaf lists");
    assert!(with(0.5, 0.4, 1.0) < usual, "only triangles that rays test no more often");
    assert!(with(0.5, 0.4, 0.0) > usual, "triangles that rays test far more often, too");
}

/// Expected steps and tests of a ray that meets the root of `tree`.
fn expected(tree: &Tree) -> [f64; 2] {
    let area = |cell: &Aabb| {
        let [x, y, z] = (cell.max.as_dvec3() - cell.min.as_dvec3()).to_array();
        x * y + y * z + z * x
    };
    let (mut steps, mut tests) = (0.0, 0.0);
    let mut waiting = vec![(0usize, tree.bounds)];
    while let Some((slot, cell)) = waiting.pop() {
        let node = Node(tree.slots[slot]);
        let share = area(&cell) / area(&tree.bounds);
        if node.is_leaf() {
            tests += share * f64::from(node.count());
            continue;
        }
        steps += share;
        tests += share * f64::from(node.refs());
        let (mut low, mut high) = (cell, cell);
        low.max[node.axis()] = node.split();
        high.min[node.axis()] = node.split();
        waiting.extend([(slot + node.size() as usize, low), (node.right() as usize, high)]);
    }
    [steps, tests]
}

#[test]
fn references_that_save_tests_make_no_ray_dearer() {
    for (name, soup) in [("spheres", spheres()), ("fans", fans()), ("tubes", tubes())] {
        let options = BuildOptions::default();
        let cost = |max_refs, tau_tests| {
            let tree = soup.build_with(&BuildOptions { max_refs, tau_tests, ..options });
            let [steps, tests] = expected(&tree);
            f64::from(options.traversal_cost) * steps + f64::from(options.intersection_cost) * tests
        };
        let costs = [cost(0, 0.0), cost(2, 1.0), cost(2, 0.0)];
        assert!(costs[1] < costs[0] * 1.01 && costs[1] < costs[2], "{name}: {costs:?}");
    }
}

#[test]
fn each_reference_count_keeps_its_limit_and_two_save_more_than_one() {
    for (name, soup) in [("spheres", spheres()), ("fans", fans()), ("tubes", tubes())] {
        // Whatever it costs rays: else hardly a reference is made among the tubes.
        let options = |max_refs| BuildOptions { max_refs, tau_tests: 0.0, ..BuildOptions::default() };
        let [standard, one, two] = [0, 1, 2].map(|max_refs| soup.build_with(&options(max_refs)).stats());
        assert_eq!((standard.inner1, standard.inner2, one.inner2), (0, 0, 0), "{name}");
        assert!(one.inner1 > 0 && two.inner2 > 0, "{name}");
        assert!(one.bytes < standard.bytes && two.bytes < one.bytes, "{name}: {standard:?} {one:?} {two:?}");
    }
}

#[test]
fn a_scene_of_two_triangles_needs_no_reference() {
    let soup = Soup(quad(1, 0.5, [-10.5, -10.5], [10.5, 10.5]).to_vec());
    assert_eq!(references(&soup.build(2)), Vec::<Vec<u32>>::new());
}
