use proptest::prelude::*;
use tessera_quantize::uv::{MAX_UV, PackedUv, UvBits, UvPlan, WrapRule};

const REPEAT: Option<[WrapRule; 2]> = Some([WrapRule::Any; 2]);
const MIRROR: Option<[WrapRule; 2]> = Some([WrapRule::Even; 2]);
const CLAMP: Option<[WrapRule; 2]> = Some([WrapRule::Fixed; 2]);

fn choose(uvs: &[[f32; 2]], triangles: &[[u32; 3]], rule: Option<[WrapRule; 2]>) -> (UvPlan, Vec<[u32; 3]>) {
    let mut packed = triangles.to_vec();
    let plan = UvPlan::choose(uvs, &mut packed, UvBits::ALL, |_| rule).expect("coordinates in range");
    (plan, packed)
}

fn decoded(plan: &UvPlan, uvs: &[[f32; 2]], v: u32) -> [f64; 2] {
    match plan.uv[v as usize] {
        PackedUv::Units(q) => q.map(|q| f64::from(q) / 32_768.0),
        PackedUv::Unread => [0.0; 2],
        PackedUv::Side => uvs[plan.source[v as usize] as usize].map(f64::from),
    }
}

/// Checks all that a renderer relies on: right sources, one whole-number shift a triangle and axis that the rule allows, bounded
/// error, and nothing unused.
fn check(uvs: &[[f32; 2]], triangles: &[[u32; 3]], rules: &[Option<[WrapRule; 2]>]) -> UvPlan {
    check_bits(uvs, triangles, rules, 16)
}

/// The same with so many bits a component.
fn check_bits(
    uvs: &[[f32; 2]],
    triangles: &[[u32; 3]],
    rules: &[Option<[WrapRule; 2]>],
    bits: u32,
) -> UvPlan {
    let mut packed = triangles.to_vec();
    let kept = UvBits::new(bits).expect("1 to 16 bits");
    let plan = UvPlan::choose(uvs, &mut packed, kept, |i| rules[i]).expect("coordinates in range");
    // All but one bit are behind the point.
    let step = libm::exp2(1.0 - f64::from(bits));
    assert!(plan.source.is_sorted());
    assert_eq!(plan.source.len(), plan.uv.len());
    let mut used = vec![false; plan.source.len()];
    for ((packed, triangle), rule) in packed.iter().zip(triangles).zip(rules) {
        let mut corners = Vec::new();
        for (&v, &source) in packed.iter().zip(triangle) {
            used[v as usize] = true;
            assert_eq!(plan.source[v as usize], source);
            let (is, was) = (decoded(&plan, uvs, v), uvs[source as usize].map(f64::from));
            if rule.is_some() {
                if let PackedUv::Units(units) = plan.uv[v as usize] {
                    assert!(units.iter().all(|&unit| u32::from(unit) % (1 << (16 - bits)) == 0));
                }
                corners.push((was, is));
            }
        }
        // Half a step, and a step for what lies above the largest value, which is a step below 2.
        let fits = |k: usize, shift: f64| {
            corners.iter().all(|(was, is)| {
                let bound = if is[k] == 2.0 - step { step } else { step / 2.0 };
                (was[k] - is[k] - shift).abs() <= bound
            })
        };
        for (k, rule) in rule.iter().flatten().enumerate() {
            // One shift moves all three corners: that of the first, up to its rounding.
            let Some((was, is)) = corners.first() else { continue };
            let near = (was[k] - is[k]).round();
            let shift = [near, near - 1.0, near + 1.0].into_iter().find(|&shift| {
                let is_allowed = match rule {
                    WrapRule::Any => true,
                    WrapRule::Even => shift % 2.0 == 0.0,
                    WrapRule::Fixed => shift == 0.0,
                };
                is_allowed && fits(k, shift)
            });
            assert!(shift.is_some(), "one triangle, one shift that {rule:?} allows: {corners:?}");
        }
    }
    assert!(used.iter().all(|&u| u), "no packed vertex without a triangle");
    let distinct = plan.source.iter().collect::<std::collections::BTreeSet<_>>().len();
    assert_eq!(plan.split_vertices as usize, plan.source.len() - distinct);
    plan
}

proptest! {
    #![proptest_config(crate::config())]

    #[test]
    fn every_mesh_keeps_its_coordinates(
        uvs in prop::collection::vec(prop::array::uniform2(prop_oneof![
            -3.0..3.0f32, -40.0..40.0f32, -1e6..1e6f32, (-4i32..5).prop_map(|i| i as f32), Just(-1e-9f32), Just(-0.0f32)
        ]), 3..20),
        corners in prop::collection::vec((0usize..1000, 0usize..1000, 0usize..1000, 0usize..4), 1..40),
        bits in 1u32..=16,
    ) {
        let pick = |i: usize| (i % uvs.len()) as u32;
        let triangles: Vec<_> = corners.iter().map(|&(a, b, c, _)| [pick(a), pick(b), pick(c)]).collect();
        let rules: Vec<_> = corners.iter().map(|c| [REPEAT, MIRROR, CLAMP, None][c.3]).collect();
        check(&uvs, &triangles, &rules);
        check_bits(&uvs, &triangles, &rules, bits);
    }
}

#[test]
fn a_mesh_inside_the_range_is_neither_shifted_nor_split() {
    let uvs = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.5, 1.9]];
    for rule in [REPEAT, MIRROR, CLAMP] {
        let (plan, packed) = choose(&uvs, &[[0, 1, 2], [2, 1, 3], [3, 4, 1]], rule);
        assert_eq!((plan.split_vertices, plan.side_triangles), (0, 0));
        assert_eq!(packed, [[0, 1, 2], [2, 1, 3], [3, 4, 1]]);
        assert_eq!(plan.uv[4], PackedUv::Units([49_152, 62_259]));
    }
}

#[test]
fn ends_of_the_range() {
    // 0, 1, 2 and the number below 1.
    let below = f32::from_bits(1.0f32.to_bits() - 1);
    let (plan, _) = choose(&[[0.0, 2.0], [1.0, below], [2.0, 0.0]], &[[0, 1, 2]], REPEAT);
    assert_eq!(
        plan.uv,
        [PackedUv::Units([0, 65_535]), PackedUv::Units([32_768; 2]), PackedUv::Units([65_535, 0])]
    );
    // A hair below 0 under a clamped texture does not pack and is not rounded either.
    let (plan, _) = choose(&[[-1e-9, 0.0], [1.0, 0.0], [0.0, 1.0]], &[[0, 1, 2]], CLAMP);
    assert_eq!((plan.side_triangles, plan.uv[0]), (1, PackedUv::Side));
    // The same under a repeating one packs as the end of the period before.
    let (plan, _) = choose(&[[-1e-9, 0.0], [0.5, 0.0], [0.0, 1.0]], &[[0, 1, 2]], REPEAT);
    assert_eq!(plan.uv[0], PackedUv::Units([32_768, 0]));
}

#[test]
fn neighbours_agree_on_a_shift_when_they_can() {
    // A strip from -3.7 to 12.2 in steps of 0.3: each quad fits alone, two neighbours nearly always share a shift.
    let steps = 54;
    let uvs: Vec<_> =
        (0..steps).flat_map(|i| [[-3.7 + 0.3 * i as f32, 0.0], [-3.7 + 0.3 * i as f32, 1.0]]).collect();
    let triangles: Vec<_> = (0..steps - 1)
        .flat_map(|i| [[2 * i, 2 * i + 1, 2 * i + 2], [2 * i + 2, 2 * i + 1, 2 * i + 3]])
        .collect();
    let plan = check(&uvs, &triangles, &vec![REPEAT; triangles.len()]);
    assert_eq!(plan.side_triangles, 0);
    // 15.9 long, at most 2 a component: 8 components, so at least 7 seams of two vertices; the greedy choice may cut sooner, but
    // a component never ends before it is 1 long.
    assert!((14..=32).contains(&plan.split_vertices), "{}", plan.split_vertices);
    // With even shifts a component covers [2k, 2k + 2): seams at -2, 0, .. 12, some between two vertices.
    let plan = check(&uvs, &triangles, &vec![MIRROR; triangles.len()]);
    assert!(plan.side_triangles <= 16, "only quads across an even number: {}", plan.side_triangles);
}

#[test]
fn what_spans_too_much_goes_to_the_side_table_and_is_shared() {
    let uvs = [[0.0, 0.0], [5.0, 0.0], [0.0, 5.0], [5.0, 5.0], [0.5, 0.5]];
    let plan = check(&uvs, &[[0, 1, 2], [2, 1, 3], [0, 4, 2]], &[REPEAT; 3]);
    assert_eq!((plan.side_triangles, plan.split_vertices), (3, 0));
    assert!(plan.uv.iter().all(|uv| *uv == PackedUv::Side));
    // A neighbour that packs and has a corner of its own splits the two others.
    let uvs = [[0.0, 0.0], [5.0, 0.0], [0.0, 1.0], [0.5, 0.5]];
    let plan = check(&uvs, &[[0, 1, 2], [0, 3, 2]], &[REPEAT; 2]);
    assert_eq!((plan.side_triangles, plan.split_vertices, plan.source.len()), (1, 2, 6));
}

#[test]
fn surfaces_without_a_texture_split_nothing() {
    let uvs = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [70.0, 1e9]];
    let plan = check(&uvs, &[[0, 1, 2], [2, 1, 3]], &[REPEAT, None]);
    assert_eq!((plan.source.len(), plan.split_vertices, plan.side_triangles), (4, 0, 0));
    assert_eq!(plan.uv[3], PackedUv::Unread);
}

#[test]
fn a_vertex_never_has_more_than_nine_copies_that_pack() {
    // Triangles around one vertex in all directions and sizes; along an axis its shift can take three values.
    let mut uvs = vec![[0.5f32, 0.5]];
    for i in 0..400u32 {
        let at = |salt: u32| (i.wrapping_mul(2_654_435_761).wrapping_add(salt) % 1000) as f32 / 280.0 - 1.3;
        uvs.push([at(17), at(91_811)]);
    }
    let triangles: Vec<_> = (1..400).map(|i| [0, i, i + 1]).collect();
    let plan = check(&uvs, &triangles, &vec![REPEAT; triangles.len()]);
    assert!(plan.source.iter().filter(|&&v| v == 0).count() <= 10);
}

#[test]
fn coordinates_without_a_fraction_are_refused() {
    let uvs = [[0.0, 0.0], [1.0, MAX_UV * 2.0], [0.0, 1.0]];
    let error = UvPlan::choose(&uvs, &mut [[2, 0, 2], [0, 1, 2]], UvBits::ALL, |_| REPEAT)
        .expect_err("2^23 is too much");
    assert_eq!((error.triangle, error.corner, error.value), (1, 1, MAX_UV * 2.0));
    let (plan, _) = choose(&[[MAX_UV, -MAX_UV], [MAX_UV, -MAX_UV], [MAX_UV, -MAX_UV]], &[[0, 1, 2]], REPEAT);
    assert_eq!(plan.uv[0], PackedUv::Units([0, 0]));
}

#[test]
fn without_coordinates_unused_vertices_go() {
    let mut triangles = [[7, 2, 4], [4, 2, 7]];
    let plan = UvPlan::without_uvs(9, &mut triangles);
    assert_eq!((plan.source, plan.uv, triangles), (vec![2, 4, 7], vec![], [[2, 0, 1], [1, 0, 2]]));
}

#[test]
fn fewer_bits_are_coarser_steps() {
    assert_eq!((UvBits::new(0), UvBits::new(17), UvBits::new(16)), (None, None, Some(UvBits::ALL)));
    let uvs = [[0.0, 0.24], [0.26, 1.0], [1.9, 2.0]];
    let units = |bits: u32| -> Vec<u16> {
        let kept = UvBits::new(bits).expect("1 to 16 bits");
        let plan = UvPlan::choose(&uvs, &mut [[0, 1, 2]], kept, |_| CLAMP).expect("in range");
        plan.uv
            .iter()
            .flat_map(|uv| if let PackedUv::Units(q) = uv { *q } else { panic!("{uv:?}") })
            .collect()
    };
    let scaled = |values: [f64; 6]| -> Vec<u16> { values.map(|v| (v * 32_768.0) as u16).into() };
    // Halves, and whole numbers alone; the largest value is one step below 2.
    assert_eq!(units(2), scaled([0.0, 0.0, 0.5, 1.0, 1.5, 1.5]));
    assert_eq!(units(1), scaled([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]));
    assert_eq!(units(3), scaled([0.0, 0.25, 0.25, 1.0, 1.75, 1.75]));
}
