//! What every generator promises.

use super::*;
use crate::instances::for_each_instance;
use glam::DVec3;

fn scene(kind: Kind, triangles: u32, seed: u64) -> Scene {
    generate(&Recipe { kind, triangles, seed }).expect("the recipe is in range")
}

#[test]
fn counts_come_within_two_percent() {
    for kind in Kind::ALL {
        for triangles in [1_000, 1_777, 5_000, 20_000, 90_000, 300_000] {
            let row = Row::of(&scene(kind, triangles, 3));
            let off = (row.triangles as f64 - f64::from(triangles)) / f64::from(triangles);
            assert!(off.abs() <= 0.02, "{kind}: {} for {triangles}", row.triangles);
        }
    }
    let few = Recipe { kind: Kind::Rooms, triangles: 999, seed: 0 };
    assert_eq!(generate(&few).map(|_| ()), Err(OutOfRange { asked: 999 }));
}

#[test]
fn stand_ins_have_their_models_proportions() {
    for (kind, model) in [(Kind::Rooms, Reference::SODA_HALL), (Kind::Plant, Reference::POWER_PLANT)] {
        for triangles in [20_000, 100_000, 300_000, 3_000_000] {
            let made = scene(kind, triangles, 5);
            let row = Row::of(&made);
            let off = row.vertices_per_triangle() / model.vertices_per_triangle() - 1.0;
            assert!(off.abs() < 0.015, "{kind}: nv/nf {}", row.vertices_per_triangle());
            for (k, wanted) in model.proportions().into_iter().enumerate() {
                let got = row.extent[k] / row.extent[0];
                assert!((got / wanted - 1.0).abs() < 0.015, "{kind}: edge {k} is {got}, not {wanted}");
            }
            // 9 to 21 % were counted in real architecture; a plant of pipes has far more.
            assert!(row.thin > if kind == Kind::Rooms { 0.09 } else { 0.5 }, "{kind}: thin {}", row.thin);
            assert!(made.images.is_empty(), "{kind} carries no textures");
            let notes = made.notes.join("\n");
            assert!(notes.contains("seed 5") && notes.contains(model.name), "{notes}");
        }
    }
}

#[test]
fn arrays_are_sound() {
    for kind in Kind::ALL {
        for triangles in [1_000, 60_000] {
            let made = scene(kind, triangles, 1);
            check_sound(kind, &made);
        }
    }
}

/// Everything finite, every index in range, every triangle with an area, every unit normal on the triangle's front.
#[track_caller]
fn check_sound(kind: Kind, made: &Scene) {
    assert!(!made.cameras.is_empty() && !made.lights.is_empty(), "{kind} can be seen");
    for_each_instance(made, |mesh, transform| {
        assert!(transform.is_finite(), "{kind}: {}", mesh.name);
    });
    for mesh in &made.meshes {
        for part in &mesh.primitives {
            let name = format!("{kind}: {}", mesh.name);
            let n = part.positions.len();
            assert!(part.positions.iter().all(|p| p.is_finite()), "{name}");
            assert!(part.normals.is_empty() || part.normals.len() == n, "{name}");
            assert!(part.uvs.is_empty() || part.uvs.len() == n, "{name}");
            assert!(part.uvs.iter().flatten().all(|x| x.is_finite()), "{name}");
            let textured = made.materials[part.material].base_texture.is_some();
            assert_eq!(textured, !part.uvs.is_empty(), "{name}: coordinates exactly where there is an image");
            let mut used = vec![false; n];
            for t in &part.triangles {
                let [a, b, c] = t.map(|k| part.positions[k as usize]);
                let cross = (b - a).cross(c - a);
                assert!(cross.length() > 0.0, "{name}: no area at {a} {b} {c}");
                for &k in t {
                    used[k as usize] = true;
                    let Some(normal) = part.normals.get(k as usize) else { continue };
                    let normal = DVec3::from_array(normal.map(f64::from));
                    assert!(
                        normal == DVec3::ZERO || (normal.length() - 1.0).abs() < 1e-5,
                        "{name}: normal {normal}"
                    );
                    let facing = normal.dot(cross) / cross.length();
                    assert!(normal == DVec3::ZERO || facing > 0.0, "{name}: {facing} at {a} {b} {c}");
                }
            }
            assert!(used.iter().all(|&u| u), "{name}: unused vertices");
        }
    }
}

/// FNV-1a of the bits of all positions, normals, coordinates and triangles, where the nodes put them.
fn hash(made: &Scene) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut eat = |word: u64| hash = (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3);
    for_each_instance(made, |mesh, transform| {
        for part in &mesh.primitives {
            for &p in &part.positions {
                for x in transform.transform_point3(p).to_array() {
                    eat(x.to_bits());
                }
            }
            part.normals.iter().flatten().for_each(|x| eat(u64::from(x.to_bits())));
            part.uvs.iter().flatten().for_each(|x| eat(u64::from(x.to_bits())));
            part.triangles.iter().flatten().for_each(|&k| eat(u64::from(k)));
        }
    });
    for image in &made.images {
        image.rgba.iter().for_each(|&b| eat(u64::from(b)));
    }
    hash
}

/// Written down once; another machine, or another year, must come to the same bits.
const KNOWN: [u64; Kind::ALL.len()] = [
    0xf49d_4ae3_c449_4a24,
    0x7d42_d2be_82d9_9f0d,
    0x00df_7147_9f41_11b6,
    0x8f02_1cfb_5649_92b9,
    0x32ea_0c3f_e7ee_af3c,
];

#[test]
fn scenes_are_the_same_everywhere() {
    let hashes = Kind::ALL.map(|kind| hash(&scene(kind, 10_000, 1)));
    assert_eq!(hashes, KNOWN, "{hashes:#018x?}");
    for (kind, known) in Kind::ALL.into_iter().zip(KNOWN) {
        // There is no chance in the box.
        let same = hash(&scene(kind, 10_000, 2)) == known;
        assert_eq!(same, kind == Kind::Cornell, "{kind}: what the seed changes");
    }
}

#[test]
fn balls_are_closed() {
    let made = scene(Kind::Cornell, 5_000, 0);
    let balls: Vec<_> = made.meshes.iter().filter(|m| m.name.ends_with("ball")).collect();
    assert_eq!(balls.len(), 2);
    for ball in balls {
        let part = &ball.primitives[0];
        let mut edges = std::collections::BTreeSet::new();
        for &[a, b, c] in &part.triangles {
            for edge in [(a, b), (b, c), (c, a)] {
                assert!(edges.insert(edge), "an edge is used twice in one direction");
            }
        }
        assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))), "{} has an open edge", ball.name);
    }
}
