//! Closed meshes that no ray leaves, for hard inputs 14 and 15.

use super::Random;
use std::f64::consts::{PI, TAU};
use tessera_geometry::{DVec3, LocalFrame, Ray, Vec3};

/// A closed mesh of size about 1, and points inside it.
pub struct Closed {
    /// For messages.
    pub name: &'static str,
    /// Vertices.
    pub positions: Vec<DVec3>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    inside: fn(&mut Random) -> DVec3,
}

impl Closed {
    /// Ray number `i` from inside at a vertex or an edge of a triangle whose corners, as they were packed, are `corners`: it must hit. The mesh was
    /// scaled and shifted to its `place`; `frame` is that of its pack.
    pub fn aimed(
        &self,
        i: usize,
        random: &mut Random,
        place: (f64, f64),
        frame: &LocalFrame,
        corners: impl FnOnce(&mut Random) -> [Vec3; 3],
    ) -> Ray {
        let origin = frame.to_local(placed((self.inside)(random), place));
        let [a, b, c] = corners(random);
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

/// A point scaled and shifted to a place.
pub fn placed(point: DVec3, (scale, shift): (f64, f64)) -> DVec3 {
    point * scale + DVec3::new(1.0, -2.0, 0.5) * shift
}

/// A lens, a torus, a star and a needle.
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
