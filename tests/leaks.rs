//! No ray leaves a closed mesh: hard inputs 14 and 15 on the whole way of a scene, from its vertices through quantisation, packing and the
//! tree to the ray, alone and with seven others.
//!
//! Two million rays in all; `TESSERA_RAYS=100000` makes it twenty, see [`crate::rays`].

use crate::kinds::Random;
use crate::rays::{ray_count, search};
use std::f64::consts::{PI, TAU};
use std::time::Duration;
use tessera_geometry::wide::LANES;
use tessera_geometry::{DVec3, Hit, Ray, Vec3};
use tessera_kdtree::{BuildOptions, Triangles};
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_pack::{Pack, Plain};
use tessera_scene::{Image, Material, Mesh, Node, Primitive, Scene, TextureRef, Wrap};

/// A closed mesh of size about 1, and points inside it.
pub struct Closed {
    pub name: &'static str,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    inside: fn(&mut Random) -> DVec3,
}

/// A surface over a grid that closes in both directions: `at(i, j)` for `i` below `rows` and `j` below `columns`.
fn ring(rows: u32, columns: u32, at: impl Fn(f64, f64) -> DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let share = |i: u32, n: u32| TAU * f64::from(i) / f64::from(n);
    let positions =
        (0..rows * columns).map(|v| at(share(v / columns, rows), share(v % columns, columns))).collect();
    let triangles = (0..rows * columns).flat_map(|v| {
        let (i, j) = (v / columns, v % columns);
        let vertex = |i: u32, j: u32| i % rows * columns + j % columns;
        let [a, b, c, d] = [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j), vertex(i + 1, j + 1)];
        [[a, b, c], [c, b, d]]
    });
    (positions, triangles.collect())
}

/// A surface over latitude and longitude with `radius(polar, azimuth)`, pointed at both poles.
fn globe(rings: u32, columns: u32, radius: impl Fn(f64, f64) -> DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = vec![radius(0.0, 0.0) * DVec3::Z];
    for i in 1..rings {
        for j in 0..columns {
            let (polar, azimuth) =
                (PI * f64::from(i) / f64::from(rings), TAU * f64::from(j) / f64::from(columns));
            let r = libm::sin(polar);
            let unit = DVec3::new(r * libm::cos(azimuth), r * libm::sin(azimuth), libm::cos(polar));
            positions.push(unit * radius(polar, azimuth));
        }
    }
    positions.push(radius(PI, 0.0) * DVec3::NEG_Z);
    let last = positions.len() as u32 - 1;
    let vertex = |i: u32, j: u32| match i {
        0 => 0,
        i if i == rings => last,
        i => 1 + (i - 1) * columns + j % columns,
    };
    let mut triangles = Vec::new();
    for (i, j) in (0..rings).flat_map(|i| (0..columns).map(move |j| (i, j))) {
        let [a, b, c, d] = [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j), vertex(i + 1, j + 1)];
        triangles.extend([[a, c, b], [b, c, d]].into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
    }
    (positions, triangles)
}

/// A point of the ball around `centre`.
fn near(centre: DVec3, radius: f32, random: &mut Random) -> DVec3 {
    centre + (random.point(Vec3::NEG_ONE, Vec3::ONE) * radius / 3f32.sqrt()).as_dvec3()
}

pub fn meshes() -> [Closed; 4] {
    let mesh = |name, (positions, triangles), inside| Closed { name, positions, triangles, inside };
    [
        // So flat that many edges are seen under small angles.
        mesh("lens", globe(24, 48, |_, _| DVec3::new(0.5, 0.5, 0.05)), |random| {
            near(DVec3::ZERO, 0.02, random)
        }),
        mesh(
            "torus",
            ring(48, 24, |u, v| {
                let r = 0.35 + 0.15 * libm::cos(v);
                DVec3::new(r * libm::cos(u), r * libm::sin(u), 0.15 * libm::sin(v))
            }),
            |random| {
                let u = TAU * f64::from(random.unit());
                near(DVec3::new(0.35 * libm::cos(u), 0.35 * libm::sin(u), 0.0), 0.1, random)
            },
        ),
        // Spikes between deep notches.
        mesh(
            "star",
            globe(20, 40, |polar, azimuth| {
                DVec3::splat(0.3 + 0.2 * libm::sin(5.0 * polar) * libm::cos(8.0 * azimuth))
            }),
            |random| near(DVec3::ZERO, 0.05, random),
        ),
        // A needle all of whose faces are slivers, a thousand times longer than wide, in no plane of the axes.
        mesh(
            "needle",
            globe(
                3,
                300,
                |polar, _| if polar == 0.0 || polar == PI { DVec3::splat(0.5) } else { DVec3::splat(0.05) },
            )
            .turned(),
            |random| near(DVec3::ZERO, 0.01, random),
        ),
    ]
}

trait Turned {
    fn turned(self) -> Self;
}

impl Turned for (Vec<DVec3>, Vec<[u32; 3]>) {
    /// Turned by the matrix of a (2, 3, 6) / 7 frame.
    fn turned(mut self) -> Self {
        for p in &mut self.0 {
            let (x, y, z) =
                (DVec3::new(6.0, 2.0, -3.0), DVec3::new(-3.0, 6.0, -2.0), DVec3::new(2.0, 3.0, 6.0));
            *p = (x * p.x + y * p.y + z * p.z) / 7.0;
        }
        self
    }
}

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
    let place = |p: &DVec3| *p * scale + DVec3::new(1.0, -2.0, 0.5) * shift;
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
        let world = (closed.inside)(&mut random) * place.0 + DVec3::new(1.0, -2.0, 0.5) * place.1;
        let origin = frame.to_local(world);
        let [a, b, c] = mesh.vertices(random.below(pack.triangle_count() as usize) as u32);
        let target = match i % 4 {
            0 => a,
            1 => b.midpoint(c),
            2 => b + (c - b) * random.unit(),
            _ => a + (b - a) * random.unit(),
        };
        let direction = if i.is_multiple_of(3) { target - origin } else { (target - origin).normalize() };
        Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
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
