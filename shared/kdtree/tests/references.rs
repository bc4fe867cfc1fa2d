//! What references do to a tree: which triangles they take, and what they save.

mod common;

use common::{Soup, fans, quad, spheres, tubes};
use tessera_geometry::Vec3;
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
    let with = |tau_occupancy, tau_frequency| {
        let options = BuildOptions { tau_occupancy, tau_frequency, ..BuildOptions::default() };
        references(&soup.build_with(&options)).len()
    };
    let usual = with(0.5, 0.4);
    assert!(usual > 0);
    assert!(with(1.0, 0.4) < usual, "only triangles that span their node whole");
    assert!(with(0.5, 1.0) < usual, "only triangles that every leaf lists");
}

#[test]
fn each_reference_count_keeps_its_limit_and_two_save_more_than_one() {
    for (name, soup) in [("spheres", spheres()), ("fans", fans()), ("tubes", tubes())] {
        let [standard, one, two] = [0, 1, 2].map(|max_refs| soup.build(max_refs).stats());
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
