//! Trees from outside: whatever the bytes, validation answers, and what it accepts can be traversed.

mod common;

use common::{Random, Soup, fans, scenes, unkind_ray};
use proptest::prelude::*;
use tessera_geometry::Aabb;
use tessera_kdtree::node::{MAX_DEPTH, Node};
use tessera_kdtree::{TreeView, validate};

/// Validates; if that succeeds traverses too, which must end without a panic. Says which it was.
fn survives(view: &TreeView<'_>, soup: &Soup) -> bool {
    let accepted = validate(view, soup.len()).is_ok();
    if accepted {
        let mut random = Random(61);
        for i in 0..40 {
            let ray = unkind_ray(i, &mut random, soup, &[]);
            let nearest = view.closest_hit(soup, &ray, |_| true);
            assert_eq!(view.any_hit(soup, &ray, |_| true), nearest.is_some());
        }
    }
    accepted
}

#[test]
fn every_built_tree_is_accepted() {
    for (name, soup) in scenes() {
        for max_refs in 0..=2 {
            let tree = soup.build(max_refs);
            assert!(survives(&tree.view(), &soup), "{name}, {max_refs} references");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 24,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn flipped_and_cut_trees_are_refused_or_harmless(seed in any::<u64>(), max_refs in 0u32..=2) {
        let soup = fans();
        let tree = soup.build(max_refs);
        let mut random = Random(seed);
        let mut refused = 0;
        for _ in 0..40 {
            let (mut slots, mut list) = (tree.slots.clone(), tree.list.clone());
            for _ in 0..1 + random.below(3) {
                match random.below(8) {
                    0 => slots.truncate(random.below(slots.len() + 1)),
                    1 => list.truncate(random.below(list.len() + 1)),
                    2 if !list.is_empty() => {
                        let at = random.below(list.len());
                        list[at] ^= 1 << random.below(32);
                    }
                    3 if slots.len() > 1 => {
                        let (a, b) = (random.below(slots.len()), random.below(slots.len()));
                        slots.swap(a, b);
                    }
                    _ if !slots.is_empty() => {
                        let at = random.below(slots.len());
                        slots[at][random.below(2)] ^= 1 << random.below(32);
                    }
                    _ => {}
                }
            }
            refused += usize::from(!survives(&TreeView { bounds: tree.bounds, slots: &slots, list: &list }, &soup));
        }
        prop_assert!(refused > 10, "only {} of 40 damaged trees were refused", refused);
    }

    #[test]
    fn random_words_are_refused_or_harmless(words in prop::collection::vec(any::<[u32; 2]>(), 0..64)) {
        let soup = fans();
        let (min, max) = soup.bounds();
        survives(&TreeView { bounds: Aabb { min, max }, slots: &words, list: &[] }, &soup);
    }
}

/// What validation says of a damaged tree of two triangles: `[inner, refs?, leaf, leaf]` as given.
fn verdict(slots: &[[u32; 2]], list: &[u32]) -> &'static str {
    let bounds = Aabb { min: glam::Vec3::ZERO, max: glam::Vec3::splat(8.0) };
    match validate(&TreeView { bounds, slots, list }, 4) {
        Ok(()) => "good",
        Err(error) => error.what,
    }
}

#[test]
fn each_rule_of_the_layout_is_kept() {
    let [one, none] = [Node::leaf(1, 3).0, Node::leaf(0, 0).0];
    let inner = |refs, right| Node::inner(0, 4.0, refs, right).0;
    assert_eq!(verdict(&[inner(0, 2), one, none], &[]), "good");
    assert_eq!(verdict(&[inner(1, 3), [2, u32::MAX], one, none], &[]), "good");
    assert_eq!(verdict(&[inner(2, 3), [0, 1], one, Node::leaf(2, 0).0], &[1, 3]), "good");

    assert_eq!(verdict(&[], &[]), "the tree ends before its last leaf");
    assert_eq!(
        verdict(&[inner(0, 2), one], &[]),
        "a right child that is not behind the left one inside the tree"
    );
    assert_eq!(
        verdict(&[inner(0, 1), one, none], &[]),
        "a right child that is not behind the left one inside the tree"
    );
    assert_eq!(
        verdict(&[inner(0, 3), one, none, none], &[]),
        "a subtree that does not end where its sibling begins"
    );
    assert_eq!(verdict(&[inner(0, 2), one, none, none], &[]), "slots behind the last leaf");
    for split in [0.0, 8.0, 9.0, -1.0, f32::NAN, f32::INFINITY] {
        let root = Node::inner(1, split, 0, 2).0;
        assert_eq!(verdict(&[root, one, none], &[]), "a split plane that is not inside its cell", "{split}");
    }
    let outside = Node::inner(0, 5.0, 0, 3).0;
    assert_eq!(
        verdict(&[inner(0, 4), outside, one, none, none], &[]),
        "a split plane that is not inside its cell"
    );
    assert_eq!(
        verdict(&[[4.0f32.to_bits(), 3 << 2 | 3 << 4], [0, 1], one, none], &[]),
        "a reserved number of references"
    );
    for references in [[4, u32::MAX], [1, 2], [u32::MAX, u32::MAX]] {
        let slots = [inner(1, 3), references, one, none];
        assert_eq!(verdict(&slots, &[]), "references out of order or beyond the last triangle");
    }
    assert_eq!(verdict(&[Node::leaf(1, 4).0], &[]), "a triangle beyond the last one");
    assert_eq!(verdict(&[Node::leaf(0, 1).0], &[]), "an empty leaf with a triangle");
    assert_eq!(verdict(&[Node::leaf(2, 1).0], &[0, 1, 2]), "a leaf that does not continue the list");
    assert_eq!(verdict(&[Node::leaf(4, 0).0], &[0, 1, 2]), "a leaf that reaches beyond the list");
    let unsorted = "a leaf whose ids are out of order or beyond the last triangle";
    assert_eq!(verdict(&[Node::leaf(2, 0).0], &[1, 1]), unsorted);
    assert_eq!(verdict(&[Node::leaf(2, 0).0], &[1, 4]), unsorted);
    assert_eq!(verdict(&[Node::leaf(2, 0).0], &[0, 1, 2]), "list entries behind those of the last leaf");
}

/// A chain of `depth` inner nodes, each with its empty left leaf and `refs` references.
fn chain(depth: u32, refs: u32) -> Vec<[u32; 2]> {
    let mut slots = Vec::new();
    for level in 0..depth {
        // Halving the cell would run out of numbers: take planes a hundredth apart.
        let right = slots.len() as u32 + 2 + u32::from(refs > 0);
        slots.push(Node::inner(0, (level + 1) as f32 * 0.01, refs, right).0);
        if refs > 0 {
            slots.push([0, if refs == 1 { u32::MAX } else { 1 }]);
        }
        slots.push(Node::leaf(0, 0).0);
    }
    slots.push(Node::leaf(0, 0).0);
    slots
}

#[test]
fn depth_and_references_on_a_path_are_limited() {
    assert_eq!(verdict(&chain(MAX_DEPTH, 0), &[]), "good");
    assert_eq!(verdict(&chain(MAX_DEPTH + 1, 0), &[]), "an inner node deeper than a traversal stack");
    assert_eq!(verdict(&chain(8, 1), &[]), "good");
    assert_eq!(verdict(&chain(9, 1), &[]), "too many references on one path");
    assert_eq!(verdict(&chain(4, 2), &[]), "good");
    assert_eq!(verdict(&chain(5, 2), &[]), "too many references on one path");

    // The deepest tree that is accepted fills the stack and no more: every plane is crossed.
    let slots = chain(MAX_DEPTH, 0);
    let bounds = Aabb { min: glam::Vec3::ZERO, max: glam::Vec3::splat(8.0) };
    let view = TreeView { bounds, slots: &slots, list: &[] };
    for x in [1.0, -1.0] {
        let origin = glam::Vec3::new(4.0 - 5.0 * x, 1.0, 1.0);
        let ray = tessera_geometry::Ray { origin, direction: glam::Vec3::X * x, t_min: 0.0, t_max: 100.0 };
        assert_eq!(view.closest_hit(&fans(), &ray, |_| true), None);
    }
}
