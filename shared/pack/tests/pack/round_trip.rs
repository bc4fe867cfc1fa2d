//! What goes into a pack comes out again.

use crate::support::everything;
use tessera_geometry::DVec3;
use tessera_pack::format::{Head, Section};
use tessera_pack::{
    ImageInput, NO_TEXTURE, NormalCode, Pack, PackInput, PackOptions, PackStats, Plain, Wrap, build_pack,
};

const SIDE: u32 = 24;

fn pack(plain: Plain) -> (Pack, PackStats) {
    pack_with(&PackOptions { plain, ..PackOptions::default() })
}

fn pack_with(options: &PackOptions) -> (Pack, PackStats) {
    build_pack(everything(SIDE), options).expect("a sound scene")
}

/// Checks `pack` against `input` triangle by triangle; the errors allowed are those of the packed form.
fn check_geometry(pack: &Pack, input: &PackInput, options: &PackOptions) {
    let PackOptions { plain, position_bits, normal_code, uv_bits, .. } = *options;
    let (mesh, frame) = (pack.mesh(), pack.frame());
    // Voxels to a place inside a cell, and what lies between neighbouring texture coordinates.
    let (place, uv_step) = (f64::from(1024 >> position_bits), libm::exp2(1.0 - f64::from(uv_bits)));
    for id in 0..pack.triangle_count() {
        let original = pack.original_id(id);
        let run = input.material_runs.partition_point(|r| r.0 <= original) - 1;
        let material = input.material_runs[run].1;
        assert_eq!(pack.material_of(id), material);
        let textured = input.materials[material as usize].base_texture != NO_TEXTURE;
        let mut shift = None;
        for (v, source) in mesh.indices(id).into_iter().zip(input.triangles[original as usize]) {
            let source = source as usize;
            let world = DVec3::from_array(input.positions[source]);
            let error = (frame.to_world(mesh.position(v)) - world).abs().max_element();
            // Half a place, and the roundings of two f64 sums of size 1; plain: one f32 rounding of a local coordinate.
            let bound = if plain.positions {
                frame.step * f64::from(mesh.position(v).abs().max_element() * f32::EPSILON)
            } else {
                frame.step * 0.5 * place + 2.0 * f64::EPSILON
            };
            assert!(error <= bound, "vertex {v}: {error:e} > {bound:e}");
            let expected = DVec3::from_array(input.normals[source].map(f64::from)).try_normalize();
            assert_eq!(mesh.normal(v).is_some(), expected.is_some());
            if let (Some(n), Some(e)) = (mesh.normal(v), expected) {
                // The sine of the angle; components are rounded to f32.
                let coded = libm::sin(normal_code.bound_radians()) + f64::from(f32::EPSILON);
                let bound = if plain.normals { 1e-6 } else { coded };
                assert!(n.as_dvec3().cross(e).length() <= bound);
            }
            if textured {
                let uv = mesh.uv(v).to_array();
                let moved = [0, 1].map(|k| f64::from(input.uvs[source][k]) - f64::from(uv[k]));
                // Half a step, and a step for what lies above the largest value, which is a step below 2.
                let bound = |k: usize| {
                    let largest = f64::from(uv[k]) == 2.0 - uv_step;
                    if plain.uvs { 0.0 } else { uv_step * if largest { 1.0 } else { 0.5 } }
                };
                if uv_bits >= 12 {
                    // Steps far below 1 tell the shift.
                    let whole = moved.map(f64::round);
                    assert!((0..2).all(|k| (moved[k] - whole[k]).abs() <= bound(k)), "{moved:?}");
                    assert_eq!(
                        *shift.get_or_insert(whole),
                        whole,
                        "the corners of triangle {id} are shifted alike"
                    );
                    if material == 2 {
                        assert!(
                            whole[0] % 2.0 == 0.0 && whole[1] == 0.0,
                            "mirror shifts are even, clamp has none"
                        );
                    }
                } else {
                    // A coarse step may hide which shift it was: the fraction alone is held.
                    let nearest = |k: usize| (moved[k] - moved[k].round()).abs();
                    assert!((0..2).all(|k| nearest(k) <= bound(k)), "{moved:?}");
                }
            }
            let [r, g, b, a] = mesh.color(v);
            let expected =
                input.colors[source].map(|c| tessera_pack::color::srgb8_to_linear_table()[usize::from(c)]);
            assert_eq!([r, g, b, a], [expected[0], expected[1], expected[2], 1.0]);
        }
    }
}

#[test]
fn packed_and_plain_scenes_come_back_within_their_bounds() {
    let on = [false, true];
    for (positions, normals, uvs) in
        on.iter().flat_map(|&p| on.iter().flat_map(move |&n| on.map(|u| (p, n, u))))
    {
        let plain = Plain { positions, normals, uvs };
        let (pack, stats) = pack(plain);
        check_geometry(&pack, &everything(SIDE), &PackOptions { plain, ..PackOptions::default() });
        assert_eq!(stats.triangles, u64::from(SIDE * SIDE * 2));
        assert!(
            stats.split_vertices > 0 && stats.side_uv_triangles > 0,
            "the scene exercises both: {stats:?}"
        );
        assert_eq!(stats.vertices, u64::from((SIDE + 1) * (SIDE + 1)) + stats.split_vertices);
        let again = Pack::from_bytes(pack.bytes()).expect("its own bytes");
        assert_eq!((again.id(), again.bytes()), (pack.id(), pack.bytes()));
    }
}

#[test]
fn coarser_packs_come_back_within_their_bounds() {
    let normal = PackOptions::default();
    for options in [
        PackOptions { max_intervals: 32, ..normal },
        PackOptions { position_bits: 9, ..normal },
        PackOptions { position_bits: 3, max_intervals: 64, ..normal },
        PackOptions { normal_code: NormalCode::Oct, ..normal },
        PackOptions { uv_bits: 12, ..normal },
        PackOptions { uv_bits: 2, ..normal },
        PackOptions { position_bits: 6, normal_code: NormalCode::Oct, uv_bits: 9, ..normal },
    ] {
        let (pack, stats) = pack_with(&options);
        check_geometry(&pack, &everything(SIDE), &options);
        assert_eq!(stats.triangles, u64::from(SIDE * SIDE * 2));
        let again = Pack::from_bytes(pack.bytes()).expect("its own bytes");
        assert_eq!((again.id(), again.bytes()), (pack.id(), pack.bytes()));
        // Rounding costs and saves no byte of a vertex.
        let records = |pack: &Pack| pack.section_bytes(Section::Records) / u64::from(pack.vertex_count());
        assert_eq!(records(&pack), 12);
    }
}

#[test]
fn the_code_of_normals_is_a_flag_where_there_are_some_in_the_records() {
    let normal = PackOptions::default();
    let oct = PackOptions { normal_code: NormalCode::Oct, ..normal };
    let (smith_pack, _) = pack_with(&normal);
    let (oct_pack, _) = pack_with(&oct);
    assert_eq!(smith_pack.packed_normals(), Some(NormalCode::Smith));
    assert_eq!(oct_pack.packed_normals(), Some(NormalCode::Oct));
    assert_eq!(smith_pack.head().flags, Head::HAS_NORMALS);
    assert_eq!(oct_pack.head().flags, Head::HAS_NORMALS | Head::OCT_NORMALS);
    // Without such normals the code makes no difference.
    let plain = Plain { normals: true, ..Plain::default() };
    let bytes = |options: &PackOptions| pack_with(options).0.bytes().to_vec();
    assert!(bytes(&PackOptions { plain, ..normal }) == bytes(&PackOptions { plain, ..oct }));
    let mut bare = everything(SIDE);
    bare.normals.clear();
    let pack = |options: &PackOptions| build_pack(bare.clone(), options).expect("a sound scene").0;
    assert_eq!((pack(&oct).id(), pack(&oct).packed_normals()), (pack(&normal).id(), None));
}

#[test]
fn options_out_of_range_are_refused() {
    let normal = PackOptions::default();
    for (options, expected) in [
        (PackOptions { max_intervals: 31, ..normal }, "a grid of 31 intervals"),
        (PackOptions { max_intervals: 8193, ..normal }, "32 to 8192 are possible"),
        (PackOptions { position_bits: 0, ..normal }, "positions of 0 bits"),
        (PackOptions { position_bits: 11, ..normal }, "1 to 10 are possible"),
        (PackOptions { uv_bits: 0, ..normal }, "texture coordinates of 0 bits"),
        (PackOptions { uv_bits: u32::MAX, ..normal }, "1 to 16 are possible"),
    ] {
        let error = build_pack(everything(2), &options).expect_err("refused").to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn the_plain_twin_has_the_same_triangles_splits_and_ids() {
    let (packed, _) = pack(Plain::default());
    let (plain, _) = pack(Plain { positions: true, normals: true, uvs: true });
    assert_eq!(packed.frame(), plain.frame());
    assert_eq!(
        (packed.triangle_count(), packed.vertex_count()),
        (plain.triangle_count(), plain.vertex_count())
    );
    for id in 0..packed.triangle_count() {
        assert_eq!(packed.mesh().indices(id), plain.mesh().indices(id));
        assert_eq!(packed.original_id(id), plain.original_id(id));
        assert_eq!(packed.material_of(id), plain.material_of(id));
    }
}

#[test]
fn everything_else_is_kept_as_it_was() {
    let input = everything(SIDE);
    let (pack, _) = pack(Plain::default());
    assert_eq!(pack.materials(), input.materials);
    assert_eq!(pack.cameras(), input.cameras);
    assert_eq!(pack.ambient(), input.ambient);
    assert_eq!(pack.environment(), input.environment);
    for (texture, image) in pack.textures().iter().zip(&input.textures) {
        let texels = &pack.texels()[texture.first_texel as usize..][..image.rgba.len() / 4];
        assert_eq!(bytemuck::cast_slice::<u32, u8>(texels), &*image.rgba);
        assert_eq!((texture.width, texture.height), (image.width, image.height));
        assert_eq!(texture.sampling, image.wrap_s as u32 | (image.wrap_t as u32) << 2);
    }
    for (light, source) in pack.lights().iter().zip(&input.lights) {
        let world = pack.frame().to_world(tessera_geometry::Vec3::from_array(light.position));
        let error = (world - DVec3::from_array(source.position.map(f64::from))).abs().max_element();
        // One f32 rounding of a local coordinate; the light is within 4 units of the grid's centre.
        assert!(error <= 4.0 * f64::from(f32::EPSILON), "{error:e}");
        assert_eq!(
            (light.kind, light.direction, light.intensity),
            (source.kind, source.direction, source.intensity)
        );
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let with_threads = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a thread pool");
        pool.install(|| build_pack(everything(SIDE), &PackOptions::default()).expect("a sound scene"))
    };
    let ((one, one_stats), (four, four_stats)) = (with_threads(1), with_threads(4));
    assert!(one.bytes() == four.bytes());
    assert_eq!(one_stats, four_stats);
}

#[test]
fn one_picture_sampled_in_two_ways_is_held_once() {
    let mut input = everything(SIDE);
    let other = ImageInput { wrap_s: Wrap::Clamp, nearest: true, ..input.textures[0].clone() };
    // The same texels again, but a picture of its own.
    let copy = ImageInput { rgba: input.textures[0].rgba.to_vec().into(), ..other.clone() };
    input.textures.extend([other, copy]);
    // All are in use.
    (input.materials[1].base_texture, input.materials[0].metallic_roughness_texture) = (2, 3);
    let (pack, _) = build_pack(input, &PackOptions::default()).expect("a sound scene");
    let places: Vec<u32> = pack.textures().iter().map(|t| t.first_texel).collect();
    assert_eq!(places, [0, 8, 0, 23]);
    assert_eq!(pack.texels().len(), 8 + 15 + 8);
    assert_eq!(pack.textures()[2].sampling, Wrap::Clamp as u32 | 1 << 4);
    assert_eq!(Pack::from_bytes(pack.bytes()).map(|p| p.id()), Ok(pack.id()));
}
