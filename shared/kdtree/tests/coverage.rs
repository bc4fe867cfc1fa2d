//! What holds for every finished tree: whatever meets a leaf's cell is in that leaf or a reference on the path to it, and not
//! both; and every split saves enough.

mod common;

use common::{Random, Soup, scenes};
use std::collections::BTreeSet;
use tessera_geometry::{Aabb, Vec3};
use tessera_kdtree::{BuildOptions, Tree, node::Node};

/// Calls `visit(cell, path references, leaf triangles)` for every leaf.
fn leaves(tree: &Tree, mut visit: impl FnMut(&Aabb, &[u32], &[u32])) {
    let mut waiting = vec![(0usize, tree.bounds, Vec::new())];
    while let Some((slot, cell, mut path)) = waiting.pop() {
        let node = Node(tree.slots[slot]);
        if node.is_leaf() {
            let payload = node.payload();
            match node.count() {
                0 => visit(&cell, &path, &[]),
                1 => visit(&cell, &path, &[payload]),
                n => visit(&cell, &path, &tree.list[payload as usize..][..n as usize]),
            }
            continue;
        }
        if node.refs() > 0 {
            path.extend_from_slice(&tree.slots[slot + 1][..node.refs() as usize]);
        }
        let (mut low, mut high) = (cell, cell);
        low.max[node.axis()] = node.split();
        high.min[node.axis()] = node.split();
        waiting.push((node.right() as usize, high, path.clone()));
        waiting.push((slot + node.size() as usize, low, path));
    }
}

/// Whether the interior of `cell` meets the triangle: the separating-axis test over 13 axes (Akenine-Moller 2001), in `f64`.
/// What merely touches the cell, within 2^-30 of the coordinates, does not count.
fn meets(cell: &Aabb, triangle: [Vec3; 3]) -> bool {
    let centre = (cell.min.as_dvec3() + cell.max.as_dvec3()) * 0.5;
    let half: glam::DVec3 = (cell.max.as_dvec3() - cell.min.as_dvec3()) * 0.5;
    let v: [glam::DVec3; 3] = triangle.map(|p| p.as_dvec3() - centre);
    let edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2]];
    let units = [glam::DVec3::X, glam::DVec3::Y, glam::DVec3::Z];
    let mut axes = vec![edges[0].cross(edges[1])];
    axes.extend(units);
    axes.extend(edges.iter().flat_map(|e| units.map(|u| u.cross(*e))));
    axes.into_iter().filter(|axis| axis.length_squared() > 0.0).all(|axis| {
        let reach = half.dot(axis.abs());
        let along = v.map(|p| p.dot(axis));
        let low = along.iter().copied().fold(f64::INFINITY, f64::min);
        let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let slack = (reach + low.abs().max(high.abs())) / (1u64 << 30) as f64;
        low < reach - slack && high > -reach + slack
    })
}

fn check(name: &str, soup: &Soup, tree: &Tree) {
    let (mut seen, mut count) = (BTreeSet::<u32>::new(), 0);
    let mut random = Random(3);
    leaves(tree, |cell, path, leaf| {
        count += 1;
        let path_set: BTreeSet<u32> = path.iter().copied().collect();
        assert_eq!(path_set.len(), path.len(), "{name}: a triangle twice on one path");
        assert!(path.len() <= 8, "{name}: {} references on one path", path.len());
        assert!(leaf.is_sorted_by(|a, b| a < b), "{name}: ids out of order");
        assert!(leaf.iter().all(|id| !path_set.contains(id)), "{name}: in a leaf and on its path");
        seen.extend(path.iter().chain(leaf));
        // Every triangle against every twentieth cell or so: all against all takes too long.
        if random.below(20) == 0 {
            for id in 0..soup.len() {
                let covered = path_set.contains(&id) || leaf.binary_search(&id).is_ok();
                assert!(
                    covered || !meets(cell, soup.0[id as usize]),
                    "{name}: triangle {id} meets {cell:?} but is neither there nor above"
                );
            }
        }
    });
    assert_eq!(seen.len(), soup.0.len(), "{name}: some triangle is nowhere");
    let stats = tree.stats();
    assert_eq!(count, stats.leaves);
    assert_eq!(stats.leaves, stats.inner0 + stats.inner1 + stats.inner2 + 1, "{name}");
}

#[test]
fn what_meets_a_cell_is_in_it_or_above_it_and_never_both() {
    for (name, soup) in scenes() {
        for max_refs in 0..=2 {
            check(&format!("{name}, {max_refs} references"), &soup, &soup.build(max_refs));
        }
    }
}

#[test]
fn random_large_triangles_are_covered_too() {
    // Cells far smaller than the triangles: clipping decides nearly everything.
    let mut random = Random(23);
    let mut corner = || common::voxel(random.point(Vec3::splat(-500.0), Vec3::splat(500.0)));
    let soup = Soup((0..300).map(|_| [corner(), corner(), corner()]).collect());
    for max_refs in 0..=2 {
        check(&format!("large triangles, {max_refs} references"), &soup, &soup.build(max_refs));
    }
}

fn area(cell: &Aabb) -> f64 {
    let [x, y, z] = (cell.max.as_dvec3() - cell.min.as_dvec3()).to_array();
    2.0 * (x * y + y * z + z * x)
}

/// A subtree without references, seen from its root.
struct Seen {
    triangles: BTreeSet<u32>,
    is_leaf: bool,
    /// Expected cost of a ray through the cell, and the cell's surface area.
    cost: f64,
    area: f64,
    /// What the parent of two leaves must be shown to save: cells whose surroundings are not known yet, as
    /// (surface area, cost that the split saves).
    open: Vec<(f64, f64)>,
}

/// Walks the subtree at `slot` and asserts that what its splits save is more than the options demand.
fn savings(tree: &Tree, slot: usize, cell: Aabb, options: &BuildOptions) -> Seen {
    let (traversal, intersection) = (f64::from(options.traversal_cost), f64::from(options.intersection_cost));
    let node = Node(tree.slots[slot]);
    let area = area(&cell);
    if node.is_leaf() {
        let triangles = match node.count() {
            0 => BTreeSet::new(),
            1 => BTreeSet::from([node.payload()]),
            n => tree.list[node.payload() as usize..][..n as usize].iter().copied().collect(),
        };
        let cost = intersection * triangles.len() as f64;
        return Seen { triangles, is_leaf: true, cost, area, open: Vec::new() };
    }
    let (mut low, mut high) = (cell, cell);
    low.max[node.axis()] = node.split();
    high.min[node.axis()] = node.split();
    let [low, high] = [(slot + 1, low), (node.right() as usize, high)]
        .map(|(slot, cell)| savings(tree, slot, cell, options));
    let cost = traversal + (low.cost * low.area + high.cost * high.area) / area;
    let triangles: BTreeSet<u32> = low.triangles.union(&high.triangles).copied().collect();
    let mut open = [low.open, high.open].concat();
    if low.is_leaf && high.is_leaf {
        open.push((area, intersection * triangles.len() as f64 - cost));
    }
    if triangles.len() > 128 {
        let least = f64::from(options.least_saving) * traversal * area / triangles.len() as f64;
        for (area, saved) in open.drain(..) {
            assert!(saved * area > least * (1.0 - 1e-9), "{saved} over {area} saves less than {least}");
        }
    }
    Seen { triangles, is_leaf: false, cost, area, open }
}

#[test]
fn every_split_saves_what_the_options_demand_and_no_split_that_matters_is_undone() {
    for (name, soup) in scenes() {
        let mut bytes = Vec::new();
        let mut costs = Vec::new();
        for least_saving in [0.0, 0.25, 1.0] {
            let options = BuildOptions { max_refs: 0, least_saving, ..BuildOptions::default() };
            let tree = soup.build_with(&options);
            costs.push(savings(&tree, 0, tree.bounds, &options).cost);
            bytes.push(tree.stats().bytes);
        }
        assert!(bytes.is_sorted_by(|a, b| a > b), "{name}: {bytes:?}");
        // A ray through some surroundings pays a step at most for all that was undone there, of the many steps it takes.
        assert!(costs[2] <= costs[0] * 1.03, "{name}: {costs:?}");
    }
}
