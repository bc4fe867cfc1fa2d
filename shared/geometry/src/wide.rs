//! The ray/triangle test of [`crate::triangle`] for eight rays at once.
//!
//! One triangle is decoded once and tested against [`LANES`] rays. Every lane does the operations of the test of a single ray on
//! the same numbers, without fused operations, so the answers are the same in every bit on every instruction set. What is
//! rare and branches (an edge within rounding of a ray, a point on an edge) is left to the test of a single ray itself.

use crate::mutation::{Mutation, is_on};
use crate::rounding::UNIT_ROUNDOFF;
use crate::triangle::{DEPTH_LONGER, DEPTH_SHORTER, RayShear, intersect};
use crate::{Ray, Vec3};
use fearless_simd::{Simd, f32x8, f64x4, mask32x8, prelude::*};

/// Rays of a packet.
pub const LANES: usize = 8;

/// Every lane of a packet; bit `i` stands for ray `i`.
pub const ALL_LANES: u8 = u8::MAX;

/// Three coordinates of eight points.
pub type Wide3<S> = [f32x8<S>; 3];

/// Eight rays by component. Lanes that are not traceable ([`Ray::is_traceable`]) may hold anything and must not be asked about.
#[derive(Clone, Copy)]
pub struct WideRays<'a, S: Simd> {
    /// The rays as they came.
    pub rays: &'a [Ray; LANES],
    /// Start points.
    pub origin: Wide3<S>,
    /// Directions.
    pub direction: Wide3<S>,
    /// [`Ray::t_min`].
    pub t_min: f32x8<S>,
    /// [`Ray::t_max`].
    pub t_max: f32x8<S>,
}

impl<'a, S: Simd> WideRays<'a, S> {
    /// Lays `rays` out by component.
    #[inline(always)]
    pub fn new(simd: S, rays: &'a [Ray; LANES]) -> Self {
        let mut components = [[0.0; LANES]; 8];
        for (lane, ray) in rays.iter().enumerate() {
            let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin.to_array(), ray.direction.to_array());
            for (row, value) in components.iter_mut().zip([ox, oy, oz, dx, dy, dz, ray.t_min, ray.t_max]) {
                row[lane] = value;
            }
        }
        let [ox, oy, oz, dx, dy, dz, t_min, t_max] = components;
        Self {
            rays,
            origin: [ox.simd_into(simd), oy.simd_into(simd), oz.simd_into(simd)],
            direction: [dx.simd_into(simd), dy.simd_into(simd), dz.simd_into(simd)],
            t_min: t_min.simd_into(simd),
            t_max: t_max.simd_into(simd),
        }
    }

    /// The lanes for which [`Ray::is_traceable`] holds.
    #[inline(always)]
    pub fn traceable(&self) -> u8 {
        let ([ox, oy, oz], [dx, dy, dz]) = (self.origin, self.direction);
        let finite = ox.is_finite()
            & oy.is_finite()
            & oz.is_finite()
            & dx.is_finite()
            & dy.is_finite()
            & dz.is_finite();
        let (x, y, z) = (dx.abs(), dy.abs(), dz.abs());
        let length = x.max(y).max(z);
        let usable = length.simd_ge(Ray::DIRECTION_MIN) & length.simd_le(Ray::DIRECTION_MAX);
        let range = self.t_min.simd_ge(0.0) & self.t_min.simd_lt(self.t_max);
        lanes_of(finite & usable & range)
    }

    /// The lanes whose direction is largest along x, along y, along z, as [`RayShear::new`] decides it; each is in one of the three.
    #[inline(always)]
    pub fn main_axes(&self) -> [u8; 3] {
        let [dx, dy, dz] = self.direction;
        let (x, y, z) = (dx.abs(), dy.abs(), dz.abs());
        let along_x = lanes_of(x.simd_ge(y) & x.simd_ge(z));
        let along_y = lanes_of(y.simd_ge(z)) & !along_x;
        [along_x, along_y, !(along_x | along_y)]
    }
}

/// What [`RayShear`] is to one ray: eight rays whose direction is largest along the same axis.
#[derive(Clone, Copy)]
pub struct WideShear<S: Simd> {
    kz: usize,
    x: f32x8<S>,
    y: f32x8<S>,
    /// `1 / direction[kz]`, rounded.
    per_depth: f32x8<S>,
}

/// Where rays cross a triangle; lanes outside `lanes` hold anything.
#[derive(Clone, Copy)]
pub struct WideCrossing<S: Simd> {
    /// The lanes that cross it.
    pub lanes: u8,
    /// [`crate::triangle::Crossing::t`].
    pub t: f32x8<S>,
    /// [`crate::triangle::Crossing::b1`].
    pub b1: f32x8<S>,
    /// [`crate::triangle::Crossing::b2`].
    pub b2: f32x8<S>,
}

impl<S: Simd> WideShear<S> {
    /// Prepares the lanes whose main axis ([`WideRays::main_axes`]) is `kz`; the others hold anything.
    ///
    #[inline(always)]
    pub fn new(rays: &WideRays<'_, S>, kz: usize) -> Self {
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let d = &rays.direction;
        let one = f32x8::splat(d[kz].token(), 1.0);
        Self { kz, x: d[kx] / d[kz], y: d[ky] / d[kz], per_depth: one / d[kz] }
    }

    /// A vertex seen from the rays: moved, sheared, and its depth.
    #[inline(always)]
    fn sheared(&self, rays: &WideRays<'_, S>, vertex: Vec3) -> (f32x8<S>, f32x8<S>, f32x8<S>) {
        let (v, simd) = (vertex.to_array(), self.x.token());
        let (kx, ky, kz) = ((self.kz + 1) % 3, (self.kz + 2) % 3, self.kz);
        let z = f32x8::splat(simd, v[kz]) - rays.origin[kz];
        let x = (f32x8::splat(simd, v[kx]) - rays.origin[kx]) - self.x * z;
        let y = (f32x8::splat(simd, v[ky]) - rays.origin[ky]) - self.y * z;
        (x, y, z)
    }

    /// The lanes of `active` whose projection lies in the triangle, and beside them those for which only the exact test can say; the
    /// third is that the whole range of depths of the triangle lies between `t_min` and `t_max`.
    #[inline(always)]
    fn project(
        &self,
        rays: &WideRays<'_, S>,
        vertices: &[Vec3; 3],
        active: u8,
        t_max: f32x8<S>,
    ) -> Candidates {
        // Move the rays to the origin and shear them onto z.
        let a = self.sheared(rays, vertices[0]);
        let b = self.sheared(rays, vertices[1]);
        let c = self.sheared(rays, vertices[2]);

        // Find on which side of each edge the rays pass. The order of the endpoints only negates an edge function exactly; a fused
        // operation would break that, and there is none here.
        let u = c.0 * b.1 - c.1 * b.0;
        let v = a.0 * c.1 - a.1 * c.0;
        let w = b.0 * a.1 - b.1 * a.0;
        let inside = (u.simd_ge(0.0) & v.simd_ge(0.0) & w.simd_ge(0.0))
            | (u.simd_le(0.0) & v.simd_le(0.0) & w.simd_le(0.0));
        let inside_lanes = lanes_of(inside) & active;
        if inside_lanes == 0 {
            return Candidates { clear: 0, close: 0, certain: 0 };
        }
        // An edge function that is not 0 has the right sign: only zeros among equal signs are in doubt.
        let close = lanes_of(u.simd_eq(0.0) | v.simd_eq(0.0) | w.simd_eq(0.0)) & inside_lanes;
        let close = if is_on(Mutation::WideNoExactEdges) { 0 } else { close };

        // Leave out rays whose range the triangle is not in. The reported t lies between the depths of its vertices; each of
        // these here is off by three roundings, to which comes the rounding of t.
        let (p, q, r) = (a.2 * self.per_depth, b.2 * self.per_depth, c.2 * self.per_depth);
        let near = p.min(q).min(r);
        let far = p.max(q).max(r);
        let outside = (near * DEPTH_SHORTER).simd_gt(t_max) | (far * DEPTH_LONGER).simd_lt(rays.t_min);
        let within = (near * DEPTH_SHORTER).simd_gt(rays.t_min)
            & (far * DEPTH_LONGER).simd_lt(t_max)
            & (u.abs() + v.abs() + w.abs()).simd_lt(f32::INFINITY);
        let clear = inside_lanes & !close & !lanes_of(outside);
        Candidates { clear, close, certain: lanes_of(within) & clear }
    }

    /// [`crate::triangle::intersect`] for the lanes of `active`, which must all have this main axis.
    #[inline(always)]
    pub fn intersect(
        &self,
        rays: &WideRays<'_, S>,
        vertices: &[Vec3; 3],
        active: u8,
        t_max: f32x8<S>,
    ) -> WideCrossing<S> {
        let Candidates { clear, close, .. } = self.project(rays, vertices, active, t_max);
        let simd = t_max.token();
        let none = f32x8::splat(simd, 0.0);
        let mut crossing = WideCrossing { lanes: 0, t: none, b1: none, b2: none };
        let mut doubtful = close;
        if clear != 0 {
            // Find the points that the rays pass, four lanes at a time.
            let low = self.locate(rays, vertices, clear, 0);
            let high = self.locate(rays, vertices, clear, 1);
            let found = clear & (low.0 | high.0 << 4);
            crossing.t = simd.narrow_f64x4(low.1, high.1);
            crossing.b1 = simd.narrow_f64x4(low.2, high.2);
            let b2 = simd.narrow_f64x4(low.3, high.3);
            let rest = f32x8::splat(simd, 1.0) - crossing.b1;
            crossing.b2 = b2.simd_lt(rest).select(b2, rest);
            crossing.lanes = found & lanes_of(crossing.t.simd_gt(rays.t_min) & crossing.t.simd_le(t_max));
            doubtful |= clear & !found;
        }
        if doubtful != 0 {
            self.decide(rays.rays, vertices, doubtful, t_max, &mut crossing);
        }
        crossing
    }

    /// The lanes of `active` that cross the triangle before `t_max`, exclusive; where `certain` the point itself is not computed.
    #[inline(always)]
    pub fn is_crossed(
        &self,
        rays: &WideRays<'_, S>,
        vertices: &[Vec3; 3],
        active: u8,
        t_max: f32x8<S>,
    ) -> u8 {
        let candidates = self.project(rays, vertices, active, t_max);
        let open = (candidates.clear | candidates.close) & !candidates.certain;
        if open == 0 {
            return candidates.certain;
        }
        let crossing = self.intersect(rays, vertices, open, t_max);
        candidates.certain | crossing.lanes & lanes_of(crossing.t.simd_lt(t_max))
    }

    /// `triangle::locate` for half of the lanes, if any of them is active, and which lie inside the triangle in `f64` too.
    #[inline(always)]
    fn locate(
        &self,
        rays: &WideRays<'_, S>,
        vertices: &[Vec3; 3],
        active: u8,
        half: usize,
    ) -> (u8, f64x4<S>, f64x4<S>, f64x4<S>) {
        let simd = rays.t_min.token();
        if active >> (4 * half) & 15 == 0 {
            let none = f64x4::splat(simd, 0.0);
            return (0, none, none, none);
        }
        let kz = self.kz;
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        // Components in the order (kx, ky, kz), a rotation of (x, y, z).
        let o =
            [half_of(rays.origin[kx], half), half_of(rays.origin[ky], half), half_of(rays.origin[kz], half)];
        let d = [
            half_of(rays.direction[kx], half),
            half_of(rays.direction[ky], half),
            half_of(rays.direction[kz], half),
        ];
        let a = corner(vertices[0], o, kz);
        let b = corner(vertices[1], o, kz);
        let c = corner(vertices[2], o, kz);

        // Project the corners along the rays, scaled by d[kz] to spare a division.
        let (fa, fb, fc) = (flat(a, d), flat(b, d), flat(c, d));
        let (u, v, w) = (cross(fc, fb), cross(fa, fc), cross(fb, fa));
        let det = u + v + w;

        // Weigh the corners so that their mean lies on the rays.
        let weights = [u / det, v / det, w / det];
        let reach = magnitude(a).max(magnitude(b)).max(magnitude(c));
        let roundoff = reach * f64::from(UNIT_ROUNDOFF);
        let beside = mean(weights, [fa.0, fb.0, fc.0]).abs().max(mean(weights, [fa.1, fb.1, fc.1]).abs());

        // Intersect with the plane, held to the triangle's own range. Sums run over x, y, z in this order, as for a single ray.
        let e = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
        let f = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
        let normal = [e[1] * f[2] - f[1] * e[2], e[2] * f[0] - f[2] * e[0], e[0] * f[1] - f[0] * e[1]];
        let (x, y, z) = ((3 - kx) % 3, (4 - kx) % 3, (5 - kx) % 3);
        let slope = normal[x] * d[x] + normal[y] * d[y] + normal[z] * d[z];
        let plane = (normal[x] * a[x] + normal[y] * a[y] + normal[z] * a[z]) / slope;
        let (p, q, r) = (a[2] / d[2], b[2] / d[2], c[2] / d[2]);
        let to_plane = plane.max(p.min(q).min(r)).min(p.max(q).max(r));

        // Leave what is no plain case to the test of a single ray: a point on an edge, a plane seen edge-on.
        let inside = (u.simd_ge(0.0) & v.simd_ge(0.0) & w.simd_ge(0.0))
            | (u.simd_le(0.0) & v.simd_le(0.0) & w.simd_le(0.0));
        let to_point = mean(weights, [p, q, r]);
        let plain = inside
            & det.is_finite()
            & !det.simd_eq(0.0)
            & !slope.simd_eq(0.0)
            & beside.simd_le(roundoff * d[2].abs())
            & ((to_plane - to_point) * d[2]).abs().simd_le(roundoff);
        (plain.to_bitmask() as u8, to_plane, weights[1], weights[2])
    }

    /// Lets the test of a single ray decide `lanes`.
    #[cold]
    #[inline(never)]
    fn decide(
        &self,
        rays: &[Ray; LANES],
        vertices: &[Vec3; 3],
        lanes: u8,
        t_max: f32x8<S>,
        crossing: &mut WideCrossing<S>,
    ) {
        let simd = t_max.token();
        let t_max: [f32; LANES] = t_max.into();
        let (mut t, mut b1, mut b2): ([f32; LANES], [f32; LANES], [f32; LANES]) =
            (crossing.t.into(), crossing.b1.into(), crossing.b2.into());
        for lane in lanes_in(lanes) {
            let ray = &rays[lane];
            if let Some(found) = intersect(ray, &RayShear::new(ray), *vertices, t_max[lane]) {
                crossing.lanes |= 1 << lane;
                (t[lane], b1[lane], b2[lane]) = (found.t, found.b1, found.b2);
            }
        }
        (crossing.t, crossing.b1, crossing.b2) = (t.simd_into(simd), b1.simd_into(simd), b2.simd_into(simd));
    }
}

/// Four lanes in `f64`.
#[inline(always)]
fn half_of<S: Simd>(lanes: f32x8<S>, half: usize) -> f64x4<S> {
    let (low, high) = lanes.token().widen_f32x8(lanes);
    if half == 0 { low } else { high }
}

/// A vertex relative to origins, components from the one behind `kz` on.
#[inline(always)]
fn corner<S: Simd>(vertex: Vec3, origin: [f64x4<S>; 3], kz: usize) -> [f64x4<S>; 3] {
    let (v, simd) = (vertex.to_array(), origin[0].token());
    [
        f64x4::splat(simd, f64::from(v[(kz + 1) % 3])) - origin[0],
        f64x4::splat(simd, f64::from(v[(kz + 2) % 3])) - origin[1],
        f64x4::splat(simd, f64::from(v[kz])) - origin[2],
    ]
}

/// A point projected along directions, scaled by their third component.
#[inline(always)]
fn flat<S: Simd>(p: [f64x4<S>; 3], d: [f64x4<S>; 3]) -> (f64x4<S>, f64x4<S>) {
    (p[0] * d[2] - d[0] * p[2], p[1] * d[2] - d[1] * p[2])
}

#[inline(always)]
fn cross<S: Simd>(p: (f64x4<S>, f64x4<S>), q: (f64x4<S>, f64x4<S>)) -> f64x4<S> {
    p.0 * q.1 - p.1 * q.0
}

/// The largest component.
#[inline(always)]
fn magnitude<S: Simd>(p: [f64x4<S>; 3]) -> f64x4<S> {
    p[0].abs().max(p[1].abs()).max(p[2].abs())
}

#[inline(always)]
fn mean<S: Simd>(weights: [f64x4<S>; 3], of: [f64x4<S>; 3]) -> f64x4<S> {
    weights[0] * of[0] + weights[1] * of[1] + weights[2] * of[2]
}

/// What the projection of a triangle says.
struct Candidates {
    /// Lanes that pass it clear of every edge, somewhere in their range.
    clear: u8,
    /// Lanes within rounding of an edge.
    close: u8,
    /// Lanes of `clear` that cross it strictly inside their range, wherever in the triangle.
    certain: u8,
}

/// The lanes of a mask.
#[inline(always)]
pub fn lanes_of<S: Simd>(mask: mask32x8<S>) -> u8 {
    mask.to_bitmask() as u8
}

/// The numbers of the lanes in `lanes`, ascending.
#[inline(always)]
pub fn lanes_in(mut lanes: u8) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes.wrapping_sub(1);
        (lane < LANES).then_some(lane)
    })
}
