//! Solids and surfaces out of which the generators build.
//!
//! Every closed solid is wound counter-clockwise as seen from outside, with normals that point out.

use crate::Primitive;
use glam::{DMat4, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A growing list of triangles. Normals are always there (zero: none, the face's own is used); texture coordinates are
/// kept when `uv_scale` (repeats per metre) was given.
#[derive(Clone, Debug, Default)]
pub(super) struct Shape {
    pub(super) positions: Vec<DVec3>,
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) uvs: Vec<[f32; 2]>,
    pub(super) triangles: Vec<[u32; 3]>,
    uv_scale: Option<f64>,
}

impl Shape {
    /// Without texture coordinates.
    pub(super) fn new() -> Self {
        Self::default()
    }

    /// With texture coordinates: `scale` repeats of the image a metre, `v` running down.
    pub(super) fn textured(scale: f64) -> Self {
        Self { uv_scale: Some(scale), ..Self::default() }
    }

    /// The document's form. All-zero normals are left out.
    pub(super) fn into_primitive(self, material: usize) -> Primitive {
        let normals = if self.normals.iter().all(|n| *n == [0.0; 3]) { Vec::new() } else { self.normals };
        Primitive {
            positions: self.positions,
            normals,
            uvs: self.uvs,
            colors: Vec::new(),
            triangles: self.triangles,
            material,
        }
    }

    /// One vertex; `uv` in metres, scaled here.
    pub(super) fn vertex(&mut self, position: DVec3, normal: DVec3, uv: DVec2) -> u32 {
        let index = self.positions.len() as u32;
        self.positions.push(position);
        self.normals.push(normal.as_vec3().to_array());
        if let Some(scale) = self.uv_scale {
            self.uvs.push((uv * scale).as_vec2().to_array());
        }
        index
    }

    /// All of `other` again, moved by `transform` (mirrored ones keep facing out). Both have texture coordinates or neither.
    pub(super) fn append(&mut self, other: &Shape, transform: &DMat4) {
        debug_assert_eq!(self.uv_scale.is_some(), other.uv_scale.is_some());
        let first = self.positions.len() as u32;
        let to_normals = transform.inverse().transpose();
        self.positions.extend(other.positions.iter().map(|&p| transform.transform_point3(p)));
        self.normals.extend(other.normals.iter().map(|&n| {
            let n = DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
            to_normals.transform_vector3(n).normalize_or_zero().as_vec3().to_array()
        }));
        self.uvs.extend_from_slice(&other.uvs);
        let mirrored = transform.determinant() < 0.0;
        self.triangles.extend(other.triangles.iter().map(|&[a, b, c]| {
            if mirrored { [first + a, first + c, first + b] } else { [first + a, first + b, first + c] }
        }));
    }

    /// A flat quad with four vertices of its own; `a b c d` counter-clockwise as seen from the front.
    pub(super) fn quad(&mut self, a: DVec3, b: DVec3, c: DVec3, d: DVec3) {
        let normal = (c - a).cross(d - b).normalize_or_zero();
        let [a, b, c, d] = [a, b, c, d].map(|p| self.vertex(p, normal, planar_uv(p, normal)));
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// A quad with the image spread over it once, whatever its size: `d` is the image's upper left corner, `b` its lower right.
    pub(super) fn picture(&mut self, a: DVec3, b: DVec3, c: DVec3, d: DVec3) {
        let normal = (c - a).cross(d - b).normalize_or_zero();
        let whole = 1.0 / self.uv_scale.unwrap_or(1.0);
        let at = [(a, 0.0, 1.0), (b, 1.0, 1.0), (c, 1.0, 0.0), (d, 0.0, 0.0)];
        let [a, b, c, d] = at.map(|(p, u, v)| self.vertex(p, normal, DVec2::new(u, v) * whole));
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// A flat quad cut into `nu` by `nv` quads, each with vertices of its own; `a` to `b` is cut into `nu`.
    pub(super) fn patches(&mut self, [a, b, c, d]: [DVec3; 4], nu: usize, nv: usize) {
        let at = |i: usize, j: usize| {
            let (u, v) = (i as f64 / nu as f64, j as f64 / nv as f64);
            (a + (b - a) * u) * (1.0 - v) + (d + (c - d) * u) * v
        };
        for j in 0..nv {
            for i in 0..nu {
                self.quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            }
        }
    }

    /// A surface over a grid of `nu` by `nv` cells with shared vertices: `point(u, v)` gives position, normal and coordinates
    /// in metres. Its front shows where (d/du) x (d/dv) points.
    pub(super) fn grid(
        &mut self,
        nu: usize,
        nv: usize,
        mut point: impl FnMut(usize, usize) -> (DVec3, DVec3, DVec2),
    ) {
        let first = self.positions.len() as u32;
        for j in 0..=nv {
            for i in 0..=nu {
                let (p, n, uv) = point(i, j);
                self.vertex(p, n, uv);
            }
        }
        let row = nu as u32 + 1;
        for j in 0..nv as u32 {
            for i in 0..nu as u32 {
                let a = first + j * row + i;
                self.triangles.extend([[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]);
            }
        }
    }

    /// A box of six quads of their own: 24 vertices, 12 triangles.
    pub(super) fn cuboid(&mut self, low: DVec3, high: DVec3) {
        self.cuboid_faces(low, high, [true; 6]);
    }

    /// The faces of a box that are asked for, in the order -x, +x, -y, +y, -z, +z.
    pub(super) fn cuboid_faces(&mut self, low: DVec3, high: DVec3, faces: [bool; 6]) {
        let at = |x: u8, y: u8, z: u8| {
            let pick = |k: u8, l: f64, h: f64| if k == 0 { l } else { h };
            DVec3::new(pick(x, low.x, high.x), pick(y, low.y, high.y), pick(z, low.z, high.z))
        };
        let corners = [
            [at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0)],
            [at(1, 0, 1), at(1, 0, 0), at(1, 1, 0), at(1, 1, 1)],
            [at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
            [at(0, 1, 1), at(1, 1, 1), at(1, 1, 0), at(0, 1, 0)],
            [at(1, 0, 0), at(0, 0, 0), at(0, 1, 0), at(1, 1, 0)],
            [at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
        ];
        for ([a, b, c, d], wanted) in corners.into_iter().zip(faces) {
            if wanted {
                self.quad(a, b, c, d);
            }
        }
    }

    /// A box of eight shared vertices and no normals, its image set by the frame `x y z` (half edges, right-handed).
    pub(super) fn beam(&mut self, centre: DVec3, x: DVec3, y: DVec3, z: DVec3) {
        let first = self.positions.len() as u32;
        for k in 0..8_u32 {
            let sign = |bit: u32| if k & bit == 0 { -1.0 } else { 1.0 };
            let p = centre + x * sign(1) + y * sign(2) + z * sign(4);
            self.vertex(p, DVec3::ZERO, DVec2::ZERO);
        }
        const FACES: [[u32; 4]; 6] =
            [[0, 4, 6, 2], [5, 1, 3, 7], [0, 1, 5, 4], [6, 7, 3, 2], [1, 0, 2, 3], [4, 5, 7, 6]];
        for face in FACES {
            let [a, b, c, d] = face.map(|k| first + k);
            self.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }

    /// An open tube along the points of a path (at least two, neighbours apart), smooth around, its rings shared.
    pub(super) fn tube(&mut self, path: &[DVec3], radius: f64, sides: usize) {
        let mut frame = perpendicular(path[1] - path[0]);
        let mut length = 0.0;
        let rings: Vec<(DVec3, DVec3, DVec3, f64)> = (0..path.len())
            .map(|k| {
                let before = path[k.saturating_sub(1)];
                let after = path[(k + 1).min(path.len() - 1)];
                let along = (after - before).normalize();
                // Carry the frame along the path so that it does not twist.
                frame = (frame - along * frame.dot(along)).normalize();
                length += (path[k] - before).length();
                (path[k], frame, along.cross(frame), length)
            })
            .collect();
        self.grid(sides, path.len() - 1, |i, j| {
            let (centre, x, y, length) = rings[j];
            let (sin, cos) = turn(i, sides);
            let normal = x * cos + y * sin;
            (centre + normal * radius, normal, DVec2::new(radius * TAU * i as f64 / sides as f64, length))
        });
    }

    /// A tube whose ring is closed by index, without a seam: `sides` vertices a ring. For models that carry no texture.
    pub(super) fn pipe(&mut self, a: DVec3, b: DVec3, radius: f64, sides: usize) {
        let along = (b - a).normalize();
        let x = perpendicular(along);
        let y = along.cross(x);
        let first = self.positions.len() as u32;
        for end in [a, b] {
            for i in 0..sides {
                let (sin, cos) = turn(i, sides);
                let normal = x * cos + y * sin;
                self.vertex(end + normal * radius, normal, DVec2::ZERO);
            }
        }
        let n = sides as u32;
        for i in 0..n {
            let j = (i + 1) % n;
            let [p, q] = [first + i, first + j];
            self.triangles.extend([[p, q, q + n], [p, q + n, p + n]]);
        }
    }

    /// A flat disc of `sides` triangles around a centre vertex, facing `normal`.
    pub(super) fn disc(&mut self, centre: DVec3, normal: DVec3, radius: f64, sides: usize) {
        let x = perpendicular(normal);
        let y = normal.cross(x);
        let middle = self.vertex(centre, normal, DVec2::ZERO);
        for i in 0..sides {
            let (sin, cos) = turn(i, sides);
            let offset = x * cos + y * sin;
            self.vertex(centre + offset * radius, normal, DVec2::new(cos, sin) * radius);
        }
        let n = sides as u32;
        self.triangles.extend((0..n).map(|i| [middle, middle + 1 + i, middle + 1 + (i + 1) % n]));
    }

    /// A surface of revolution about the y axis through `base`: `profile` holds (radius, height) from bottom to top, outside to
    /// the right of the way up. Points that occur twice make an edge.
    pub(super) fn lathe(&mut self, base: DVec3, profile: &[DVec2], sides: usize) {
        let first = self.positions.len();
        let mut start = 0;
        let mut length = 0.0;
        while start + 1 < profile.len() {
            let mut end = start + 1;
            while end + 1 < profile.len() && profile[end] != profile[end + 1] {
                end += 1;
            }
            let part = &profile[start..=end];
            let widest = part.iter().map(|p| p.x).fold(0.0, f64::max);
            let lengths: Vec<f64> = (0..part.len())
                .map(|k| {
                    length += if k == 0 { 0.0 } else { (part[k] - part[k - 1]).length() };
                    length
                })
                .collect();
            let rows = part.len() - 1;
            // Going up and, seen from outside, to the right.
            self.grid(sides, rows, |i, k| {
                let tangent = part[(k + 1).min(rows)] - part[k.saturating_sub(1)];
                let out = DVec2::new(tangent.y, -tangent.x).normalize_or_zero();
                let (sin, cos) = turn(sides - i, sides);
                let around = |r: f64, y: f64| DVec3::new(r * cos, y, r * sin);
                (
                    base + around(part[k].x, part[k].y),
                    around(out.x, out.y),
                    DVec2::new(widest * TAU * i as f64 / sides as f64, -lengths[k]),
                )
            });
            start = end + 1;
        }
        self.drop_collapsed(first);
    }

    /// A sphere with poles on the y axis, its vertices shared, closed by index: `2 * sides * (rings - 1)` triangles.
    /// `sides >= 3`, `rings >= 2`.
    pub(super) fn sphere(&mut self, centre: DVec3, radius: f64, sides: usize, rings: usize) {
        let put = |shape: &mut Self, n: DVec3| shape.vertex(centre + n * radius, n, DVec2::ZERO);
        let top = put(self, DVec3::Y);
        for j in 1..rings {
            let polar = PI * j as f64 / rings as f64;
            let (y, r) = (libm::cos(polar), libm::sin(polar));
            for i in 0..sides {
                let (sin, cos) = turn(i, sides);
                put(self, DVec3::new(r * cos, y, -r * sin));
            }
        }
        let bottom = put(self, DVec3::NEG_Y);
        let n = sides as u32;
        for i in 0..n {
            let j = (i + 1) % n;
            self.triangles.push([top, top + 1 + i, top + 1 + j]);
            for ring in 0..rings as u32 - 2 {
                let upper = top + 1 + ring * n;
                let lower = upper + n;
                self.triangles.extend([[upper + i, lower + i, lower + j], [upper + i, lower + j, upper + j]]);
            }
            let last = top + 1 + (rings as u32 - 2) * n;
            self.triangles.push([bottom, last + j, last + i]);
        }
    }

    /// Removes what poles and apexes leave behind from the vertex `first` on: triangles with two equal corners, and the
    /// vertices that only they used.
    fn drop_collapsed(&mut self, first: usize) {
        let positions = &self.positions;
        self.triangles.retain(|t| {
            let [a, b, c] = t.map(|k| positions[k as usize]);
            a != b && b != c && c != a
        });
        let mut used = vec![false; self.positions.len() - first];
        for &k in self.triangles.iter().flatten().filter(|&&k| k as usize >= first) {
            used[k as usize - first] = true;
        }
        let mut moved = Vec::with_capacity(used.len());
        let mut to = first;
        for (from, used) in (first..).zip(used) {
            moved.push(to as u32);
            if used {
                self.positions[to] = self.positions[from];
                self.normals[to] = self.normals[from];
                if self.uv_scale.is_some() {
                    self.uvs[to] = self.uvs[from];
                }
                to += 1;
            }
        }
        self.positions.truncate(to);
        self.normals.truncate(to);
        self.uvs.truncate(to);
        for k in self.triangles.iter_mut().flatten().filter(|k| **k as usize >= first) {
            *k = moved[*k as usize - first];
        }
    }
}

/// Texture coordinates of a flat face in metres, taken from the world so that neighbouring faces fit together.
fn planar_uv(p: DVec3, normal: DVec3) -> DVec2 {
    let n = normal.abs();
    if n.y >= n.x && n.y >= n.z {
        DVec2::new(p.x, p.z)
    } else if n.x >= n.z {
        DVec2::new(p.z, -p.y)
    } else {
        DVec2::new(p.x, -p.y)
    }
}

/// Sine and cosine of `k / n` of a turn; whole quarters are exact, and `k == n` gives the numbers of `k == 0`.
pub(super) fn turn(k: usize, n: usize) -> (f64, f64) {
    let k = k % n;
    match (4 * k).checked_rem(n) {
        Some(0) => [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][4 * k / n],
        _ => {
            let angle = TAU * k as f64 / n as f64;
            (libm::sin(angle), libm::cos(angle))
        }
    }
}

/// A unit vector at a right angle to `v`, which is not zero.
pub(super) fn perpendicular(v: DVec3) -> DVec3 {
    let n = v.abs();
    let away = if n.x <= n.y && n.x <= n.z {
        DVec3::X
    } else if n.y <= n.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    v.cross(away).normalize()
}

/// Points of a circular arc from `from` towards `to` (unit, at a right angle), a quarter turn in `steps`.
pub(super) fn quarter(
    centre: DVec3,
    from: DVec3,
    to: DVec3,
    radius: f64,
    steps: usize,
) -> impl Iterator<Item = DVec3> {
    (0..=steps).map(move |k| {
        let angle = FRAC_PI_2 * k as f64 / steps as f64;
        centre + (from * libm::cos(angle) + to * libm::sin(angle)) * radius
    })
}

/// A turn about the y axis by an angle in radians, then a shift. (glam's own rotations use the platform's sine.)
pub(super) fn placed(at: DVec3, angle: f64, scale: DVec3) -> DMat4 {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    DMat4::from_cols(
        (DVec3::new(cos, 0.0, -sin) * scale.x).extend(0.0),
        (DVec3::Y * scale.y).extend(0.0),
        (DVec3::new(sin, 0.0, cos) * scale.z).extend(0.0),
        at.extend(1.0),
    )
}

/// `quarters` quarter turns about the y axis, exactly, then a shift.
pub(super) fn turned(at: DVec3, quarters: usize) -> DMat4 {
    let (sin, cos) = turn(quarters % 4, 4);
    DMat4::from_cols(
        DVec3::new(cos, 0.0, -sin).extend(0.0),
        DVec3::Y.extend(0.0),
        DVec3::new(sin, 0.0, cos).extend(0.0),
        at.extend(1.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Six times the volume that the triangles enclose, and whether every edge is shared by two triangles in opposite directions
    /// (vertices compared by position).
    fn measure(shape: &Shape) -> (f64, bool) {
        let key = |k: u32| shape.positions[k as usize].to_array().map(|x| (x + 0.0).to_bits());
        let mut edges: BTreeMap<_, i32> = BTreeMap::new();
        let mut volume = 0.0;
        for &[a, b, c] in &shape.triangles {
            let [p, q, r] = [a, b, c].map(|k| shape.positions[k as usize]);
            volume += p.dot(q.cross(r));
            for (s, t) in [(a, b), (b, c), (c, a)] {
                *edges.entry((key(s), key(t))).or_default() += 1;
                *edges.entry((key(t), key(s))).or_default() -= 1;
            }
        }
        (volume, edges.values().all(|&n| n == 0))
    }

    fn check_closed(name: &str, shape: &Shape, volume: f64, tolerance: f64) {
        let (six, closed) = measure(shape);
        assert!(closed, "{name} has an open edge");
        assert!((six / 6.0 - volume).abs() <= tolerance * volume, "{name} holds {} not {volume}", six / 6.0);
        for (t, tri) in shape.triangles.iter().enumerate() {
            let [p, q, r] = tri.map(|k| shape.positions[k as usize]);
            let face = (q - p).cross(r - p);
            for &k in tri {
                let n = shape.normals[k as usize].map(f64::from);
                let n = DVec3::from_array(n);
                assert!(n == DVec3::ZERO || n.dot(face) > 0.0, "{name}: triangle {t} faces in");
            }
        }
    }

    #[test]
    fn solids_are_closed_and_face_out() {
        let mut cuboid = Shape::new();
        cuboid.cuboid(DVec3::new(1.0, 2.0, 3.0), DVec3::new(2.0, 4.0, 6.0));
        check_closed("cuboid", &cuboid, 6.0, 1e-12);

        let mut beam = Shape::new();
        beam.beam(DVec3::ONE, DVec3::X * 0.5, DVec3::Y, DVec3::Z * 1.5);
        check_closed("beam", &beam, 6.0, 1e-12);

        let mut ball = Shape::new();
        ball.sphere(DVec3::new(1.0, 2.0, 3.0), 2.0, 64, 32);
        assert_eq!(ball.triangles.len(), 2 * 64 * 31);
        check_closed("sphere", &ball, 4.0 / 3.0 * PI * 8.0, 0.01);

        let mut cone = Shape::new();
        let profile = [(0.0, 0.0), (2.0, 0.0), (2.0, 0.0), (0.0, 3.0)].map(DVec2::from);
        cone.lathe(DVec3::Y, &profile, 64);
        check_closed("lathe", &cone, PI * 4.0, 0.01);

        let mut drum = Shape::new();
        let (a, b) = (DVec3::new(1.0, 0.0, 0.0), DVec3::new(1.0, 2.0, 1.0));
        drum.pipe(a, b, 0.5, 48);
        let rings = drum.positions.len();
        assert_eq!((rings, drum.triangles.len()), (96, 96));

        let mut moved = Shape::new();
        moved.append(&ball, &DMat4::from_scale(DVec3::new(-1.0, 2.0, 1.0)));
        check_closed("mirrored sphere", &moved, 8.0 / 3.0 * PI * 8.0, 0.01);
    }

    #[test]
    fn tubes_face_out() {
        let path: Vec<DVec3> = quarter(DVec3::ZERO, DVec3::X, DVec3::Y, 3.0, 8).collect();
        let mut tube = Shape::new();
        tube.tube(&path, 0.5, 12);
        tube.pipe(DVec3::ZERO, DVec3::ONE, 0.5, 12);
        for tri in &tube.triangles {
            let [p, q, r] = tri.map(|k| tube.positions[k as usize]);
            let n = DVec3::from_array(tube.normals[tri[0] as usize].map(f64::from));
            assert!((q - p).cross(r - p).dot(n) > 0.0);
        }
    }

    #[test]
    fn turns_are_exact_at_quarters() {
        assert_eq!(turn(1, 4), (1.0, 0.0));
        assert_eq!(turn(12, 16), (-1.0, 0.0));
        assert_eq!(turn(7, 7), turn(0, 7));
        assert_eq!(
            turned(DVec3::ZERO, 1).transform_vector3(DVec3::X),
            DVec3::NEG_Z,
            "a quarter turn about y takes x to -z"
        );
    }
}
