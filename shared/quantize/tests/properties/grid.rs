use proptest::prelude::*;
use tessera_geometry::DVec3;
use tessera_quantize::grid::{MAX_CELLS, MAX_INTERVALS, PAPER_INTERVALS};
use tessera_quantize::{Grid, GridError, is_collinear};

fn lay(positions: &[[f64; 3]]) -> Grid {
    Grid::lay(positions, MAX_INTERVALS).expect("finite positions of ordinary size")
}

/// Decoded world position.
fn decode(grid: &Grid, position: [f64; 3]) -> [f64; 3] {
    let voxel = grid.voxel(position);
    [0, 1, 2].map(|k| grid.anchor[k] + (f64::from(voxel[k]) + 0.5) * grid.step)
}

fn points() -> impl Strategy<Value = Vec<[f64; 3]>> {
    // Coordinates from a small set as well, so that equal ones and borders are met.
    let coordinate = prop_oneof![-1e3..1e3f64, (-8i32..8).prop_map(f64::from), Just(-0.0)];
    prop::collection::vec(prop::array::uniform3(coordinate), 1..200)
}

proptest! {
    #![proptest_config(crate::config())]

    #[test]
    fn a_position_decodes_within_half_a_voxel(points in points()) {
        let grid = lay(&points);
        for p in &points {
            prop_assert!(grid.cell_index(grid.voxel(*p)).is_some());
            for (x, d) in p.iter().zip(decode(&grid, *p)) {
                // Half a voxel; the quotient is below 2^23 and rounded twice (2^-52 each), the sum below 2^11 once.
                let bound = grid.step * (0.5 + 2.0 * 8_388_608.0 * f64::EPSILON) + 2048.0 * f64::EPSILON;
                prop_assert!((x - d).abs() <= bound, "{x} decodes to {d}");
            }
        }
    }

    #[test]
    fn an_axis_is_coded_by_itself_and_in_order(points in points()) {
        let grid = lay(&points);
        for k in 0..3 {
            let mut codes: Vec<_> = points.iter().map(|p| (p[k], grid.voxel(*p)[k])).collect();
            codes.sort_by(|a, b| a.0.total_cmp(&b.0));
            for w in codes.windows(2) {
                prop_assert!(w[0].1 <= w[1].1);
                prop_assert!(w[0].0 != w[1].0 || w[0].1 == w[1].1);
            }
        }
    }

    #[test]
    fn coarser_places_decode_within_half_of_one_and_keep_order(points in points(), bits in 1u32..=10, finest in 32u32..=8192) {
        let grid = Grid::lay(&points, finest).and_then(|g| g.with_position_bits(bits)).expect("in range");
        let (frame, width) = (grid.frame(), f64::from(1u32 << (10 - bits)));
        for k in 0..3 {
            let mut codes: Vec<_> = points.iter().map(|p| (p[k], grid.voxel(*p)[k])).collect();
            codes.sort_by(|a, b| a.0.total_cmp(&b.0));
            for w in codes.windows(2) {
                prop_assert!(w[0].1 <= w[1].1);
                prop_assert!(w[0].0 != w[1].0 || w[0].1 == w[1].1);
            }
        }
        for p in &points {
            let voxel = grid.voxel(*p);
            prop_assert!(grid.cell_index(voxel).is_some());
            // As many values as the bits have.
            prop_assert!(voxel.iter().all(|u| u % (1 << (10 - bits)) == (1 << (10 - bits)) / 2));
            // A decoder takes the voxel's centre, in the space of the frame; half a place, the roundings of a_position_decodes_within_half_a_voxel
            // and that of an anchor below 2^10.
            let centre = DVec3::from_array(voxel.map(|u| f64::from(u) + 0.5));
            let decoded = frame.anchor + centre * frame.step;
            let bound = grid.step * (0.5 * width + 2.0 * 8_388_608.0 * f64::EPSILON) + 3072.0 * f64::EPSILON;
            prop_assert!((decoded - DVec3::from_array(*p)).abs().max_element() <= bound, "{p:?} decodes to {decoded}");
        }
    }

    #[test]
    fn moving_and_scaling_exactly_changes_no_code(points in points(), exponent in -40i32..40) {
        // Multiples of 2^-20 up to 2^10: sums with 1e7 (< 2^24) need at most 45 bits.
        let points: Vec<_> = points.iter().map(|p| p.map(|x| (x * 1_048_576.0).round() / 1_048_576.0)).collect();
        let scale = libm::exp2(f64::from(exponent));
        let grid = lay(&points);
        for moved in [
            points.iter().map(|p| p.map(|x| x + 1e7)).collect::<Vec<_>>(),
            points.iter().map(|p| p.map(|x| x * scale)).collect(),
        ] {
            let other = lay(&moved);
            prop_assert_eq!((grid.cells, &grid.table), (other.cells, &other.table));
            for (p, q) in points.iter().zip(&moved) {
                // A single point has no size to scale: its extent counts as 1.
                prop_assert_eq!(grid.voxel(*p), other.voxel(*q));
            }
        }
    }

    #[test]
    fn the_order_of_the_vertices_does_not_matter(points in points()) {
        let mut turned = points.clone();
        turned.reverse();
        prop_assert_eq!(lay(&points), lay(&turned));
    }

    #[test]
    fn collinear_means_no_area(a in prop::array::uniform3(0u32..64), b in prop::array::uniform3(0u32..64), t in 0u32..9) {
        // Points on a line with whole coordinates.
        let c = [0, 1, 2].map(|k| a[k] + t * b[k]);
        prop_assert!(is_collinear([a, [0, 1, 2].map(|k| a[k] + b[k]), c]));
        prop_assert!(is_collinear([a, a, b]) && is_collinear([a, b, b]));
        let off = [c[0] + 1, c[1] + 2, c[2] + 4];
        let [p, q, r] = [a, [0, 1, 2].map(|k| a[k] + b[k]), off].map(|v| DVec3::from_array(v.map(f64::from)));
        // Coordinates below 1024: every product is exact in f64.
        let area = (q - p).cross(r - p);
        prop_assert_eq!(is_collinear([a, [0, 1, 2].map(|k| a[k] + b[k]), off]), area == DVec3::ZERO);
    }
}

#[test]
fn largest_voxels_do_not_overflow_the_cross_product() {
    let top = (1 << 23) - 1;
    assert!(!is_collinear([[0, 0, 0], [top, top, 0], [top, top - 1, 0]]));
    assert!(!is_collinear([[top, 0, top], [0, top, 0], [0, top, 1]]));
    assert!(is_collinear([[0, 0, 0], [top, top, top], [top / 7, top / 7, top / 7]]));
}

#[test]
fn borders_belong_to_the_higher_cell() {
    // A box whose side makes cells of exactly 2: 1 / (1 + 2^-19) is taken off beforehand.
    let side = 64.0 / (1.0 + 1.0 / 524_288.0);
    let grid = Grid::lay(&[[0.0; 3], [side; 3]], 32).expect("two points");
    assert_eq!((grid.step * 1024.0, grid.cells), (2.0, [32; 3]));
    assert_eq!(grid.voxel([2.0, 4.0, 1.999]), [1024, 2048, 1023]);
    assert_eq!(grid.voxel([grid.step, 0.0, 0.0]), [1, 0, 0]);
    let below = f64::from_bits(2.0f64.to_bits() - 1);
    assert_eq!(grid.voxel([below, 0.0, 0.0]), [1023, 0, 0]);
    // The far border never occurs; a foreign point is clamped.
    assert_eq!(grid.voxel([1e9, -1e9, 64.0]), [32 * 1024 - 1, 0, 32 * 1024 - 1]);
}

#[test]
fn a_small_mesh_gets_the_finest_grid() {
    let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]];
    assert_eq!(lay(&points).intervals, MAX_INTERVALS);
    assert_eq!(Grid::lay(&points, PAPER_INTERVALS).map(|g| g.intervals), Ok(PAPER_INTERVALS));
    assert_eq!(Grid::lay(&points, 32).map(|g| g.intervals), Ok(32));
    assert_eq!(Grid::lay(&points, 31), Err(GridError::Intervals(31)));
    assert_eq!(Grid::lay(&points, 8193), Err(GridError::Intervals(8193)));
    for bits in [0, 11] {
        assert_eq!(lay(&points).with_position_bits(bits), Err(GridError::PositionBits(bits)));
    }
    assert_eq!(lay(&points).with_position_bits(10), Ok(lay(&points)));
}

#[test]
fn a_grid_at_the_end_of_the_world_stays_in_it() {
    let grid = Grid::lay(&[[-1e30; 3], [1e30, 0.0, 0.0]], 32)
        .and_then(|g| g.with_position_bits(4))
        .expect("in range");
    assert_eq!(grid.frame().anchor, DVec3::splat(-1e30));
}

/// `count` points with whole coordinates, 64 x 32 to a layer: 65,536 of them fill 32 layers.
fn lattice(count: usize) -> Vec<[f64; 3]> {
    (0..count).map(|i| [i % 64, i / 64 % 32, i / 2048].map(|c| c as f64)).collect()
}

#[test]
fn exactly_as_many_cells_as_the_index_can_name() {
    // A lattice this coarse keeps its points in cells of their own at every finer grid.
    let full = lay(&lattice(MAX_CELLS));
    assert_eq!((full.intervals, full.table.len()), (MAX_INTERVALS, MAX_CELLS));
    let last = full.table.last().copied().expect("65,536 cells");
    assert_eq!(full.cell_index(last.map(|c| c * 1024)), Some(u16::MAX));
    // One point more: the finest grids have one cell too many, so some neighbours must share one.
    let points = lattice(MAX_CELLS + 1);
    let over = lay(&points);
    assert!(over.intervals < 64 && over.table.len() <= MAX_CELLS, "{} {}", over.intervals, over.table.len());
    assert!(points.iter().all(|&p| over.cell_index(over.voxel(p)).is_some()));
}

#[test]
fn the_bisection_ends_between_a_grid_that_fits_and_one_that_does_not() {
    // 200,000 points of a rank-1 lattice (golden ratio and its powers) over a flat box.
    let points: Vec<[f64; 3]> = (0..200_000u32)
        .map(|i| [0.618_033_988_75, 0.754_877_666_25, 0.569_840_290_998].map(|a| (f64::from(i) * a).fract()))
        .map(|[x, y, z]| [x, 0.6 * y, 0.1 * z])
        .collect();
    let grid = lay(&points);
    assert!((32..PAPER_INTERVALS).contains(&grid.intervals));
    assert!(grid.table.len() <= MAX_CELLS && grid.table.len() > MAX_CELLS / 2);
    assert!(grid.table.is_sorted_by(|a, b| a < b));
    // A limit just above forces the next resolution to be looked at: it must come out the same.
    assert_eq!(Grid::lay(&points, grid.intervals + 1), Ok(grid));
}

#[test]
fn degenerate_boxes() {
    // Nothing, one point, a flat mesh.
    assert_eq!((lay(&[]).cells, lay(&[]).table.len()), ([1; 3], 0));
    let point = lay(&[[5.0, -3.0, 1e9]; 4]);
    assert_eq!((point.cells, point.table.len(), point.voxel([5.0, -3.0, 1e9])), ([1; 3], 1, [0; 3]));
    let flat = lay(&[[0.0, 0.0, 2.5], [1.0, 3.0, 2.5], [2.0, 1.0, 2.5]]);
    assert_eq!(flat.cells[2], 1);
    assert_eq!(flat.voxel([2.0, 1.0, 2.5])[2], 0);
    // -0.0 and 0.0 are one place, and one header.
    let zero = |x: f64| lay(&[[x, 0.0, 0.0], [1.0, 0.0, 0.0]]).anchor[0].to_bits();
    assert_eq!(zero(-0.0), zero(0.0));
    // Too large, too small.
    assert_eq!(Grid::lay(&[[0.0; 3], [1e31, 0.0, 0.0]], 1024), Err(GridError::TooLarge(1e31)));
    assert!(matches!(Grid::lay(&[[0.0; 3], [1e-30, 0.0, 0.0]], 1024), Err(GridError::TooSmall(_))));
}
