//! No ray leaves a closed mesh: hard inputs 14 and 15 on the whole way of a scene, from its vertices through quantisation, packing and the
//! tree to the ray, alone and with seven others.
//!
//! Two million rays in all; `TESSERA_RAYS=100000` makes it twenty, see [`crate::rays`].

use crate::kinds::Random;
pub use crate::kinds::closed::{Closed, meshes, placed};
use crate::rays::{ray_count, search};
use std::time::Duration;
use tessera_geometry::wide::LANES;
use tessera_geometry::{DVec3, Hit, Ray};
use tessera_kdtree::{BuildOptions, Triangles};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_pack::{Pack, Plain};
use tessera_scene::{Image, Material, Mesh, Node, Primitive, Scene, TextureRef, Wrap};

/// How triangles share vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sharing {
    Welded,
    /// Every triangle has vertices of its own.
    Unwelded,
    /// Texture coordinates over eight periods split vertices whose triangles need different shifts.
    SplitByUv,
}

fn scene(closed: &Closed, sharing: Sharing, scale: f64, shift: f64) -> Scene {
    let place = |p: &DVec3| placed(*p, (scale, shift));
    let mut part = Primitive {
        positions: closed.positions.iter().map(place).collect(),
        triangles: closed.triangles.clone(),
        ..Primitive::default()
    };
    if sharing == Sharing::Unwelded {
        part.positions = part.triangles.iter().flatten().map(|&v| part.positions[v as usize]).collect();
        part.triangles = (0..part.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    }
    let mut material = Material::default();
    let mut images = Vec::new();
    if sharing == Sharing::SplitByUv {
        let uv = |p: &DVec3| [(0.3 + 8.0 * p.x) as f32, (0.3 + 8.0 * p.y) as f32];
        part.uvs = closed.positions.iter().map(uv).collect();
        images.push(Image { name: "grey".into(), width: 1, height: 1, rgba: vec![128; 4].into() });
        let wrap = Wrap::Repeat;
        material.base_texture = Some(TextureRef { image: 0, wrap_s: wrap, wrap_t: wrap, nearest: false });
    }
    Scene {
        name: closed.name.into(),
        meshes: vec![Mesh { name: String::new(), primitives: vec![part] }],
        nodes: vec![Node {
            name: String::new(),
            transform: glam::DMat4::IDENTITY,
            mesh: Some(0),
            children: Vec::new(),
        }],
        roots: vec![0],
        materials: vec![material],
        images,
        ..Scene::default()
    }
}

pub fn prepare(
    closed: &Closed,
    sharing: Sharing,
    (scale, shift): (f64, f64),
    positions: bool,
    max_refs: u32,
) -> Prepared {
    let options = PrepareOptions {
        plain: Plain { positions, ..Plain::default() },
        tree: BuildOptions { max_refs, ..BuildOptions::default() },
        ..PrepareOptions::default()
    };
    let prepared =
        prepare_scene(scene(closed, sharing, scale, shift), &options, Duration::ZERO).expect("it packs");
    let stats = &prepared.source.as_ref().expect("a source").stats;
    // A face that collapsed would leave a vertex in the middle of a neighbour's edge.
    assert_eq!(
        stats.triangles as usize,
        closed.triangles.len(),
        "{}, {sharing:?}: {:?}",
        closed.name,
        stats.dropped
    );
    match sharing {
        Sharing::Welded => assert_eq!(stats.vertices as usize, closed.positions.len()),
        Sharing::Unwelded => assert_eq!(stats.vertices as usize, 3 * closed.triangles.len()),
        Sharing::SplitByUv => {
            assert!(stats.vertices as usize > closed.positions.len() + 50, "little was split")
        }
    }
    prepared
}

/// Rays from inside at vertices and edges of `pack`, by their number: all of them must hit.
pub fn aimed<'a>(closed: &'a Closed, place: (f64, f64), pack: &'a Pack) -> impl FnMut(usize) -> Ray + 'a {
    let (mesh, frame) = (pack.mesh(), pack.frame());
    let mut random = Random(17);
    move |i: usize| {
        closed.aimed(i, &mut random, place, &frame, |random| {
            mesh.vertices(random.below(pack.triangle_count() as usize) as u32)
        })
    }
}

/// Sends [`aimed`] rays and returns what they hit.
fn shoot(closed: &Closed, place: (f64, f64), prepared: &Prepared, rays: usize, what: &str) -> Vec<Hit> {
    let pack = &prepared.pack;
    let mesh = pack.mesh();
    let mut ray = aimed(closed, place, pack);
    let mut hits = Vec::with_capacity(rays);
    for first in (0..rays).step_by(LANES) {
        let rays = std::array::from_fn(|lane| ray(first + lane));
        for (ray, hit) in rays.iter().zip(search(pack.tree(), &mesh, &rays)) {
            hits.push(hit.unwrap_or_else(|| panic!("{what}: a ray leaks: {ray:?}")));
        }
    }
    hits
}

/// Every way to share vertices, scale and place of one mesh, quantised and plain.
fn check(closed: &Closed) {
    let rays = ray_count() * 2;
    for place in [(1.0, 0.0), (1e6, 0.0), (1e-6, 0.0), (1.0, 1e6)] {
        for positions in [false, true] {
            let shoot = |sharing, max_refs| {
                let what =
                    format!("{}, {sharing:?}, {place:?}, plain {positions}, {max_refs} refs", closed.name);
                shoot(closed, place, &prepare(closed, sharing, place, positions, max_refs), rays, &what)
            };
            let welded = shoot(Sharing::Welded, 2);
            // Triangles keep their order, so hits their ids.
            assert!(welded == shoot(Sharing::Unwelded, 0), "{}, {place:?}: un-welded differs", closed.name);
            assert!(welded == shoot(Sharing::SplitByUv, 1), "{}, {place:?}: split differs", closed.name);
        }
    }
}

#[test]
fn h14_h15_lens() {
    check(&meshes()[0]);
}

#[test]
fn h14_h15_torus() {
    check(&meshes()[1]);
}

#[test]
fn h14_h15_star() {
    check(&meshes()[2]);
}

#[test]
fn h14_h15_needle() {
    check(&meshes()[3]);
}
