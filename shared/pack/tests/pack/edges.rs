//! Inputs at the edge of what can be packed: each ends in a pack or in one clear line.

use crate::support::{bare, everything};
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

/// The file without its hash and the header's anchor and step.
fn all_but_the_place(pack: &Pack) -> Vec<u8> {
    let head = bytemuck::bytes_of(pack.head());
    let at = pack.bytes().windows(head.len()).position(|w| w == head).expect("the head section");
    [&pack.bytes()[..32], &pack.bytes()[64..at], &pack.bytes()[at + 32..]].concat()
}

#[test]
fn a_scene_moved_or_scaled_exactly_packs_to_the_same_bytes() {
    let mut input = everything(12);
    // Multiples of 2^-20 below 4: exact when moved by 1e7 and when scaled by a power of two.
    let grain = 1_048_576.0;
    input.positions.iter_mut().flatten().for_each(|x| *x = (*x * grain).round() / grain);
    input.light_positions = input.lights.iter().map(|l| l.position.map(f64::from)).collect();
    let change = |f: &dyn Fn(f64) -> f64| {
        let mut input = input.clone();
        input.positions.iter_mut().chain(&mut input.light_positions).flatten().for_each(|x| *x = f(*x));
        build(input).0
    };
    let here = change(&|x| x);
    for there in [
        change(&|x| x + 1e7),
        change(&|x| x - 1e7),
        change(&|x| x / grain),
        change(&|x| x * 1_099_511_627_776.0),
    ] {
        assert_ne!(there.frame(), here.frame());
        assert!(all_but_the_place(&there) == all_but_the_place(&here));
    }
}

#[test]
fn coordinates_too_coarse_for_the_scene_are_reported() {
    let quad = |offset: f32| {
        let corner = |x: f32, y: f32| [f64::from(offset + x), f64::from(y), 0.0];
        build(bare(vec![corner(0.0, 0.0), corner(2.0, 0.0), corner(0.0, 2.0)], vec![[0, 1, 2]])).1
    };
    assert_eq!(quad(0.0).warnings, Vec::<String>::new());
    let stats = quad(1e7);
    // f32 numbers near 1e7 are 1 apart, half the scene.
    assert!(stats.input_spacing > 1e6 && stats.warnings.len() == 1, "{stats:?}");
    assert!(stats.warnings[0].contains("move the scene to the origin"), "{}", stats.warnings[0]);
}

#[test]
fn what_a_scene_does_not_need_is_left_out_with_a_reason() {
    let (pack, stats) = build(bare(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]));
    let names: Vec<_> = stats.left_out.iter().map(|l| l.0).collect();
    assert_eq!(names, ["uv", "normal", "color", "texture", "light", "environ"]);
    assert_eq!(pack.head().record_words, 2);
    let present: Vec<_> = stats.sections.iter().map(|s| s.0).collect();
    assert!(names.iter().all(|n| !present.contains(n)), "{present:?}");

    // Present in the input, but of no use: white colours, coordinates without a texture, normals without a direction.
    let mut input = bare(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]);
    input.colors = vec![[255; 4]; 3];
    input.uvs = vec![[0.5; 2]; 3];
    input.normals = vec![[0.0; 3]; 3];
    let (same, stats) = build(input);
    assert_eq!(same.bytes(), pack.bytes());
    assert!(stats.left_out.contains(&("color", "every vertex colour is white".into())), "{stats:?}");
    assert!(stats.left_out.contains(&("uv", "no material has a texture".into())));
    assert!(stats.left_out.contains(&("normal", "no normal has a direction".into())));
    assert_eq!(dropped(&stats, "normals_without_direction"), 3);
}

#[test]
fn faulty_inputs_are_refused_with_the_place() {
    let check = |change: &dyn Fn(&mut PackInput), expected: &str| {
        let mut input = everything(4);
        change(&mut input);
        let message = match build_pack(input, &PackOptions::default()) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("accepted, but expected: {expected}"),
        };
        assert!(message.contains(expected), "{message}");
    };
    check(&|i| i.normals.truncate(24), "24 normals for 25 elements");
    check(&|i| i.uvs.truncate(24), "24 uvs for 25 elements");
    check(&|i| i.material_runs.clear(), "material runs do not begin at triangle 0");
    check(&|i| i.material_runs[1].0 = 0, "material run 1 does not begin behind the one before");
    check(&|i| i.material_runs[1].1 = 3, "material run 1: material 3 does not exist");
    check(&|i| i.materials[1].ior = 0.0, "material 1: ior");
    check(&|i| i.materials[2].base_texture = 2, "material 2: a texture that does not exist");
    check(
        &|i| i.textures[1].rgba = i.textures[1].rgba[..59].into(),
        "texture 1 (3x5): 59 bytes for 3x5 RGBA texels",
    );
    check(&|i| i.textures[0].width = 0, "texture 0 (4x2): 0x2 texels");
    check(&|i| i.lights[2].cos_outer = 1.0, "light 2: cosines");
    check(&|i| i.light_positions = vec![[f64::NAN; 3]; 3], "light 0: position is not finite");
    check(&|i| i.lights[0].position = [3e38; 3], "light 0 at [3.0");
    check(&|i| i.environment.up = [0.0; 3], "environment: up is not a unit vector");
    check(&|i| i.ambient.radiance[0] = -1.0, "ambient radiance is negative");
    check(&|i| i.uvs[0] = [1e7, 0.0], "corner 0: texture coordinate 10000000 is out of range");
    check(&|i| i.positions[0] = [1e31; 3], "coordinates up to 1e30 are supported");
}
