//! Inputs at the edge of what can be packed: each ends in a pack or in one clear line.

use crate::support::bare;
use tessera_pack::{Pack, PackInput, PackOptions, PackStats, Plain, build_pack};

fn build(input: PackInput) -> (Pack, PackStats) {
    build_pack(input, &PackOptions::default()).expect("an input that packs")
}

fn dropped(stats: &PackStats, what: &str) -> u64 {
    stats.dropped.iter().find(|d| d.0 == what).unwrap_or_else(|| panic!("no count named {what}: {stats:?}")).1
}

#[test]
fn an_empty_scene_packs() {
    for input in [PackInput::default(), bare(vec![[1.0; 3]], vec![])] {
        let input = PackInput { material_runs: vec![], ..input };
        let (pack, stats) = build(input);
        assert_eq!((pack.triangle_count(), pack.vertex_count(), stats.cells), (0, 0, 0));
        assert_eq!(Pack::from_bytes(pack.bytes()).map(|p| p.id()), Ok(pack.id()));
    }
}

#[test]
fn one_triangle_uses_the_finest_grid_and_at_most_three_cells() {
    let (pack, stats) = build(bare(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]], vec![[0, 1, 2]]));
    assert_eq!((stats.grid, stats.cells), ([8192, 4096, 1], 3));
    assert_eq!(pack.triangle_count(), 1);
    // A flat scene stays flat.
    assert!((0..3).all(|v| pack.mesh().position(v).z == 0.5 - 512.0));
}

#[test]
fn triangles_without_area_are_dropped_and_the_rest_is_as_if_they_had_never_been() {
    let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.25, 0.25, 0.0], [0.5, 0.5, 0.0]];
    let (pack, stats) = build(bare(positions.clone(), vec![[0, 3, 4], [0, 1, 2], [0, 0, 1], [4, 3, 0]]));
    assert_eq!((dropped(&stats, "collapsed"), dropped(&stats, "repeated_index")), (2, 1));
    assert_eq!((pack.triangle_count(), pack.vertex_count(), pack.original_id(0)), (1, 3, 1));
    let (alone, _) = build(bare(positions[..3].to_vec(), vec![[0, 1, 2]]));
    let corners = |p: &Pack| p.mesh().indices(0).map(|v| p.mesh().position(v));
    assert_eq!(corners(&pack), corners(&alone));
}

#[test]
fn all_vertices_equal_and_a_line_of_triangles_pack_as_nothing() {
    for positions in [vec![[7.0; 3]; 3], vec![[0.0; 3], [1.0; 3], [3.0; 3]]] {
        let (pack, stats) = build(bare(positions, vec![[0, 1, 2]]));
        assert_eq!((pack.triangle_count(), dropped(&stats, "collapsed"), stats.lost_area), (0, 1, 0.0));
    }
}

#[test]
fn bad_vertices_and_indices_cost_their_triangles_only() {
    let positions = vec![
        [0.0; 3],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [f64::NAN, 0.0, 0.0],
        [0.0, f64::INFINITY, 0.0],
        [1e300; 3],
    ];
    let (pack, stats) = build(bare(positions, vec![[0, 1, 3], [0, 1, 2], [4, 1, 2], [0, 1, 6]]));
    assert_eq!(pack.triangle_count(), 1);
    let counts = ["vertex_not_finite", "index_out_of_range", "unused_vertices"].map(|w| dropped(&stats, w));
    assert_eq!(counts, [2, 1, 3]);
    // Nothing of them is left in the box.
    assert_eq!(stats.grid, [8192, 8192, 1]);
    assert_eq!(pack.frame().anchor.to_array(), [0.0; 3]);
}

#[test]
fn slivers_that_collapse_are_kept_by_the_plain_twin() {
    // The sliver is a third of a voxel high.
    let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.5, 1e-5, 0.0], [0.0, 1.0, 0.0]];
    let input = bare(positions, vec![[0, 1, 2], [0, 1, 3]]);
    let build = |positions| {
        let plain = Plain { positions, ..Plain::default() };
        let options = PackOptions { plain, max_intervals: 32, ..PackOptions::default() };
        build_pack(input.clone(), &options).expect("a sound scene")
    };
    let (packed, stats) = build(false);
    assert_eq!((packed.triangle_count(), packed.original_id(0), dropped(&stats, "collapsed")), (1, 1, 1));
    assert!((stats.lost_area - 0.5e-5).abs() < 1e-15);
    let (plain, stats) = build(true);
    assert_eq!((plain.triangle_count(), dropped(&stats, "collapsed")), (2, 0));
    assert_eq!((plain.frame(), plain.original_id(1)), (packed.frame(), 1));
}
