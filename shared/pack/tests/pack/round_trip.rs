//! What goes into a pack comes out again.

use crate::support::everything;
use tessera_geometry::DVec3;
use tessera_pack::{ImageInput, NO_TEXTURE, Pack, PackInput, PackOptions, Plain, Wrap, build_pack};

const SIDE: u32 = 24;

fn pack(plain: Plain) -> (Pack, tessera_pack::PackStats) {
    build_pack(everything(SIDE), &PackOptions { plain, ..PackOptions::default() }).expect("a sound scene")
}

/// Checks `pack` against `input` triangle by triangle; the errors allowed are those of the packed form.
fn check_geometry(pack: &Pack, input: &PackInput, plain: Plain) {
    let (mesh, frame) = (pack.mesh(), pack.frame());
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
            // Half a voxel, and the rounding of one f64 sum of size 1; plain: one f32 rounding of a local coordinate.
            let bound = if plain.positions {
                frame.step * f64::from(mesh.position(v).abs().max_element() * f32::EPSILON)
            } else {
                frame.step * 0.5 + f64::EPSILON
            };
            assert!(error <= bound, "vertex {v}: {error:e} > {bound:e}");
            let expected = DVec3::from_array(input.normals[source].map(f64::from)).try_normalize();
            assert_eq!(mesh.normal(v).is_some(), expected.is_some());
            if let (Some(n), Some(e)) = (mesh.normal(v), expected) {
                let bound = if plain.normals { 1e-6 } else { 0.009_816_5 };
                assert!(n.as_dvec3().cross(e).length() <= bound);
            }
            if textured {
                let uv = mesh.uv(v).to_array();
                let moved = [0, 1].map(|k| f64::from(input.uvs[source][k]) - f64::from(uv[k]));
                let whole = moved.map(f64::round);
                let bound = if plain.uvs { 0.0 } else { 1.0 / 32_768.0 };
                assert!((0..2).all(|k| (moved[k] - whole[k]).abs() <= bound), "{moved:?}");
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
        check_geometry(&pack, &everything(SIDE), plain);
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
    let (pack, _) = build_pack(input, &PackOptions::default()).expect("a sound scene");
    let places: Vec<u32> = pack.textures().iter().map(|t| t.first_texel).collect();
    assert_eq!(places, [0, 8, 0, 23]);
    assert_eq!(pack.texels().len(), 8 + 15 + 8);
    assert_eq!(pack.textures()[2].sampling, Wrap::Clamp as u32 | 1 << 4);
    assert_eq!(Pack::from_bytes(pack.bytes()).map(|p| p.id()), Ok(pack.id()));
}
