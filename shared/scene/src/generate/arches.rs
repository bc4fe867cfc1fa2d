//! Walls with round-headed openings, and vaults.

use super::shapes::Shape;
use glam::{DVec2, DVec3};
use std::f64::consts::PI;

/// Where a wall stands: its lower middle point, the way along it (unit, level) and the way its front faces, `along` x up.
#[derive(Clone, Copy)]
pub(super) struct Stand {
    pub(super) foot: DVec3,
    pub(super) along: DVec3,
    pub(super) front: DVec3,
}

impl Stand {
    fn at(self, s: f64, t: f64, depth: f64) -> DVec3 {
        self.foot + self.along * s + DVec3::Y * t + self.front * depth
    }
}

/// A wall with one opening: straight sides from `sill` to `spring`, a half circle above.
#[derive(Clone, Copy)]
pub(super) struct Opening {
    /// Of the wall, in metres.
    pub(super) width: f64,
    /// Of the wall.
    pub(super) height: f64,
    /// Of the wall.
    pub(super) thickness: f64,
    /// Half the opening's width, the radius of its arch.
    pub(super) half: f64,
    /// Height at which it begins.
    pub(super) sill: f64,
    /// Height at which the arch begins.
    pub(super) spring: f64,
}

impl Opening {
    /// Both faces and the lining of the opening, the arch in `steps`.
    pub(super) fn wall(self, shape: &mut Shape, stand: Stand, steps: usize) {
        let (w, a, d) = (self.width * 0.5, self.half, self.thickness * 0.5);
        for back in [false, true] {
            let mut face = |s0: f64, s1: f64, t0: f64, t1: f64| {
                let p = |s, t| stand.at(s, t, if back { -d } else { d });
                if t1 > t0 && back {
                    shape.quad(p(s1, t0), p(s0, t0), p(s0, t1), p(s1, t1));
                } else if t1 > t0 {
                    shape.quad(p(s0, t0), p(s1, t0), p(s1, t1), p(s0, t1));
                }
            };
            // Beside the opening, cut at the heights of its corners so that no corner lies within an edge.
            for (t0, t1) in [(0.0, self.sill), (self.sill, self.spring), (self.spring, self.height)] {
                face(-w, -a, t0, t1);
                face(a, w, t0, t1);
            }
            face(-a, a, 0.0, self.sill);
            // Above the arch.
            for k in 0..steps {
                let (p0, p1) = (self.arch(k, steps), self.arch(k + 1, steps));
                let p = |q: DVec2| stand.at(q.x, q.y, if back { -d } else { d });
                let (top0, top1) = (DVec2::new(p0.x, self.height), DVec2::new(p1.x, self.height));
                if back {
                    shape.quad(p(p1), p(p0), p(top0), p(top1));
                } else {
                    shape.quad(p(p0), p(p1), p(top1), p(top0));
                }
            }
        }
        // The lining: sides and sill, then the arch from left to right.
        let p = |s, t, depth| stand.at(s, t, depth);
        if self.spring > self.sill {
            let (t0, t1) = (self.sill, self.spring);
            shape.quad(p(-a, t0, d), p(-a, t0, -d), p(-a, t1, -d), p(-a, t1, d));
            shape.quad(p(a, t0, -d), p(a, t0, d), p(a, t1, d), p(a, t1, -d));
        }
        if self.sill > 0.0 {
            let t = self.sill;
            shape.quad(p(-a, t, d), p(a, t, d), p(a, t, -d), p(-a, t, -d));
        }
        shape.grid(steps, 1, |i, j| {
            let q = self.arch(i, steps);
            let depth = if j == 0 { -d } else { d };
            let inward = DVec2::new(-q.x, self.spring - q.y).normalize();
            let normal = stand.along * inward.x + DVec3::Y * inward.y;
            (stand.at(q.x, q.y, depth), normal, DVec2::new(self.half * PI * i as f64 / steps as f64, depth))
        });
    }

    /// Points of the arch's edge, for mouldings that follow it.
    pub(super) fn edge(self, stand: Stand, steps: usize, grow: f64, depth: f64) -> Vec<DVec3> {
        let wider = Self { half: self.half + grow, ..self };
        (0..=steps).map(|k| wider.arch(k, steps)).map(|q| stand.at(q.x, q.y, depth)).collect()
    }

    /// Point `k` of `steps` of the arch, from left to right.
    fn arch(self, k: usize, steps: usize) -> DVec2 {
        let (sin, cos) = half_turn(k, steps);
        DVec2::new(-self.half * cos, self.spring + self.half * sin)
    }
}

/// Sine and cosine of `k / n` of half a turn, exact at both ends.
pub(super) fn half_turn(k: usize, n: usize) -> (f64, f64) {
    super::shapes::turn(k, 2 * n)
}

/// The inside of a barrel vault over the z axis: half a cylinder of `radius` from x = -radius at height `spring`, between two z.
pub(super) fn vault(shape: &mut Shape, spring: f64, radius: f64, z: [f64; 2], cells: [usize; 2]) {
    shape.grid(cells[0], cells[1], |i, j| {
        let (sin, cos) = half_turn(i, cells[0]);
        let along = j as f64 / cells[1] as f64;
        (
            DVec3::new(-radius * cos, spring + radius * sin, z[1] + (z[0] - z[1]) * along),
            DVec3::new(cos, -sin, 0.0),
            DVec2::new(radius * PI * i as f64 / cells[0] as f64, (z[0] - z[1]).abs() * along),
        )
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_look_where_they_should() {
        let opening = Opening { width: 4.0, height: 3.0, thickness: 0.5, half: 1.0, sill: 0.5, spring: 1.5 };
        let stand = Stand { foot: DVec3::new(1.0, 2.0, 3.0), along: DVec3::NEG_Z, front: DVec3::X };
        let mut shape = Shape::new();
        opening.wall(&mut shape, stand, 16);
        vault(&mut shape, 0.0, 2.0, [1.0, -1.0], [12, 2]);
        for t in &shape.triangles {
            let [p, q, r] = t.map(|k| shape.positions[k as usize]);
            let n = DVec3::from_array(shape.normals[t[0] as usize].map(f64::from));
            assert!((q - p).cross(r - p).dot(n) > 0.0, "{p} {q} {r}");
        }
    }
}
