//! Meshes of any size for the benches: one smooth closed surface, and many long thin overlapping pipes.
//!
//! They are the meshes of a yardstick that other programs implement too, equal to the last bit; so every formula here is written
//! in its order of operations, and none may be rearranged.

use std::f64::consts::PI;
use tessera_geometry::Vec3;

/// A generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A displaced sphere around the origin.
    Sphere,
    /// Pipes along the axes in a box of 40 x 20 x 40, with a few large boxes among them.
    Pipes,
}

impl Kind {
    /// As written on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::Pipes => "pipes",
        }
    }
}

/// Vertices and triangles of a mesh of about `triangles` triangles.
pub fn generate(kind: Kind, triangles: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    match kind {
        Kind::Sphere => sphere(f64::from(triangles)),
        Kind::Pipes => pipes(f64::from(triangles)),
    }
}

/// Rows from pole to pole, twice as many columns, two triangles a quad; a pole's row has one.
fn sphere(triangles: f64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let rows = ((triangles / 4.0).sqrt().round() as u32).max(4);
    let columns = rows * 2;
    let vertex = |row: u32, column: u32| {
        let polar = PI * f64::from(row) / f64::from(rows);
        let azimuth = 2.0 * PI * f64::from(column) / f64::from(columns);
        let radius = 1.0
            + 0.05 * libm::sin(9.0 * polar) * libm::cos(7.0 * azimuth)
            + 0.01 * libm::sin(61.0 * polar) * libm::sin(53.0 * azimuth);
        vertex(
            radius * libm::sin(polar) * libm::cos(azimuth),
            radius * libm::cos(polar),
            radius * libm::sin(polar) * libm::sin(azimuth),
        )
    };
    let positions = (0..=rows).flat_map(|row| (0..columns).map(move |column| vertex(row, column))).collect();

    let index = |row: u32, column: u32| row * columns + column % columns;
    let mut faces = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            if row > 0 {
                faces.push([index(row, column), index(row, column + 1), index(row + 1, column)]);
            }
            if row + 1 < rows {
                faces.push([index(row, column + 1), index(row + 1, column + 1), index(row + 1, column)]);
            }
        }
    }
    (positions, faces)
}

/// Sides and segments of a pipe, and how many pipes pass between two boxes.
const SIDES: u32 = 12;
const SEGMENTS: u32 = 10;
const PIPES_PER_BOX: u32 = 64;

fn pipes(triangles: f64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    let count = (triangles / f64::from(SIDES * SEGMENTS * 2)).ceil() as u32;
    for pipe in 0..count {
        add_pipe(&mut random, &mut positions, &mut faces);
        if pipe % PIPES_PER_BOX == 0 {
            add_box(&mut random, &mut positions, &mut faces);
        }
    }
    (positions, faces)
}

/// An open tube: most are short and thin, a few up to 10 long and 0.035 wide.
fn add_pipe(random: &mut Random, positions: &mut Vec<Vec3>, faces: &mut Vec<[u32; 3]>) {
    let axis = (random.unit() * 3.0) as usize % 3;
    let length = 1.0 + 9.0 * random.unit() * random.unit();
    let radius = 0.005 + 0.03 * random.unit() * random.unit();
    let start = [random.unit() * 40.0, random.unit() * 20.0, random.unit() * 40.0];
    let base = positions.len() as u32;
    for segment in 0..=SEGMENTS {
        for side in 0..SIDES {
            let angle = 2.0 * PI * f64::from(side) / f64::from(SIDES);
            let mut p = start;
            p[axis] += length * f64::from(segment) / f64::from(SEGMENTS);
            p[(axis + 1) % 3] += radius * libm::cos(angle);
            p[(axis + 2) % 3] += radius * libm::sin(angle);
            positions.push(vertex(p[0], p[1], p[2]));
        }
    }
    for segment in 0..SEGMENTS {
        for side in 0..SIDES {
            let a = base + segment * SIDES + side;
            let b = base + segment * SIDES + (side + 1) % SIDES;
            faces.push([a, b, a + SIDES]);
            faces.push([b, b + SIDES, a + SIDES]);
        }
    }
}

/// A box of 0.3 to 2 along each axis, two triangles a face.
fn add_box(random: &mut Random, positions: &mut Vec<Vec3>, faces: &mut Vec<[u32; 3]>) {
    let low = [random.unit() * 38.0, random.unit() * 18.0, random.unit() * 38.0];
    let size = [0.3 + random.unit() * 1.7, 0.3 + random.unit() * 1.7, 0.3 + random.unit() * 1.7];
    let base = positions.len() as u32;
    for corner in 0..8 {
        let axis = |k: usize| low[k] + if corner >> k & 1 != 0 { size[k] } else { 0.0 };
        positions.push(vertex(axis(0), axis(1), axis(2)));
    }
    for [a, b, c, d] in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
        faces.push([base + a, base + b, base + c]);
        faces.push([base + a, base + c, base + d]);
    }
}

fn vertex(x: f64, y: f64, z: f64) -> Vec3 {
    Vec3::new(x as f32, y as f32, z as f32)
}

/// Marsaglia's xorshift (2003) with shifts 13, 7, 17; never 0.
struct Random(u64);

impl Random {
    /// A multiple of 2^-24 in [0, 1).
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f64 / f64::from(1 << 24)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::bench::hash::Hash;

    fn check(kind: Kind, asked: u32, counts: (usize, usize), expected: &str) {
        let (positions, faces) = generate(kind, asked);
        assert_eq!((positions.len(), faces.len()), counts, "{kind:?} {asked}");
        let used = faces.as_flattened().iter().max();
        assert_eq!(
            used.map(|&v| v as usize + 1),
            Some(positions.len()),
            "{kind:?}: vertices beyond the used"
        );
        let mut hash = Hash::default();
        positions.iter().for_each(|p| p.to_array().iter().for_each(|x| hash.add(x.to_bits())));
        faces.as_flattened().iter().for_each(|&v| hash.add(v));
        assert_eq!(hash.finish(), expected, "{kind:?} {asked} is not the mesh that others measure with");
    }

    #[test]
    fn meshes_are_those_of_the_yardstick() {
        check(Kind::Sphere, 2000, (1012, 1848), "ab1d40e9e1d187aa");
        check(Kind::Pipes, 2000, (1196, 2172), "cb1c742951bd3c17");
    }
}
