//! Traversal by eight rays at once, for rays that take much the same way.
//!
//! A packet goes where any of its rays goes; each ray has its own interval, and a mask says whose cell it is. A node is read and a
//! triangle decoded once for all of them. The intervals are those of the single ray ([`crate::traverse`]), so every ray meets at
//! least the cells that it would meet alone, and no cell decides about a hit: the answers are the same in every bit.
//!
//! Rays of one packet agree in the signs of their direction, so that all of them pass a node's cells in the same order, and in its
//! largest component. Eight rays that do not are split into such classes. A class is never handed to the single-ray code, however few
//! of its rays are left: one lane of eight takes its steps no slower than that, and tests triangles faster (measured: 1.2 to 1.4
//! times over a fallback below three rays, for coherent and for diffuse rays).

use crate::kernel::{Kernel, dispatch};
use crate::node::{MAX_DEPTH, Node};
use crate::traverse::{MARGIN, THICKNESS, TreeView, Triangles};
use arrayvec::ArrayVec;
use fearless_simd::{Simd, f32x8, mask32x8, prelude::*, u32x8};
use tessera_geometry::mutation::{Mutation, is_on, unless};
use tessera_geometry::wide::{LANES, WideCrossing, WideRays, WideShear, lanes_in, lanes_of};
use tessera_geometry::{Aabb, Hit, Ray, Vec3};

impl TreeView<'_> {
    /// [`TreeView::closest_hit`] of those of eight rays whose bit is set in `lanes`, accepting every hit; `None` for the others.
    /// Fast when the rays take much the same way.
    pub fn closest_hits(
        &self,
        kernel: Kernel,
        triangles: &impl Triangles,
        rays: &[Ray; LANES],
        lanes: u8,
    ) -> [Option<Hit>; LANES] {
        match kernel.level() {
            None => each(lanes, |lane| self.closest_hit(triangles, &rays[lane], |_| true)),
            Some(level) => {
                let accept = &mut Everything;
                dispatch!(level, simd => trace::<_, false>(simd, self, triangles, rays, lanes, accept).hits())
            }
        }
    }

    /// [`TreeView::closest_hits`] among the hits for which `accept` is true, which is given the ray's number too.
    /// It may be called more than once for one triangle, in any order; it must always say the same of one hit.
    pub fn closest_hits_where(
        &self,
        kernel: Kernel,
        triangles: &impl Triangles,
        rays: &[Ray; LANES],
        lanes: u8,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) -> [Option<Hit>; LANES] {
        match kernel.level() {
            None => each(lanes, |lane| self.closest_hit(triangles, &rays[lane], |hit| accept(lane, hit))),
            Some(level) => {
                let accept = &mut Where(accept);
                dispatch!(level, simd => trace::<_, false>(simd, self, triangles, rays, lanes, accept).hits())
            }
        }
    }

    /// [`TreeView::any_hit`] of those of eight rays whose bit is set in `lanes`, accepting every hit: the bits of those that hit.
    pub fn any_hits(&self, kernel: Kernel, triangles: &impl Triangles, rays: &[Ray; LANES], lanes: u8) -> u8 {
        match kernel.level() {
            None => bits(lanes, |lane| self.any_hit(triangles, &rays[lane], |_| true)),
            Some(level) => {
                let accept = &mut Everything;
                dispatch!(level, simd => trace::<_, true>(simd, self, triangles, rays, lanes, accept).found)
            }
        }
    }

    /// [`TreeView::any_hits`] among the hits for which `accept` is true, as in [`TreeView::closest_hits_where`].
    pub fn any_hits_where(
        &self,
        kernel: Kernel,
        triangles: &impl Triangles,
        rays: &[Ray; LANES],
        lanes: u8,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) -> u8 {
        match kernel.level() {
            None => bits(lanes, |lane| self.any_hit(triangles, &rays[lane], |hit| accept(lane, hit))),
            Some(level) => {
                let accept = &mut Where(accept);
                dispatch!(level, simd => trace::<_, true>(simd, self, triangles, rays, lanes, accept).found)
            }
        }
    }
}

/// [`crate::brute_force_closest`] for eight rays at once: `lanes` and `accept` as in [`TreeView::closest_hits_where`].
///
/// A judge of every traversal that is several times as fast as the plain one, with which it agrees in every bit. Each triangle is
/// decoded once and tested against all rays, whatever their directions; two or three times when their main axes differ.
pub fn brute_force_closest_hits(
    kernel: Kernel,
    triangle_count: u32,
    triangles: &impl Triangles,
    rays: &[Ray; LANES],
    lanes: u8,
    mut accept: impl FnMut(usize, &Hit) -> bool,
) -> [Option<Hit>; LANES] {
    match kernel.level() {
        None => each(lanes, |lane| {
            crate::brute_force_closest(triangle_count, triangles, &rays[lane], |hit| accept(lane, hit))
        }),
        Some(level) => {
            let accept = &mut Where(accept);
            dispatch!(level, simd => test_all(simd, triangle_count, triangles, rays, lanes, accept))
        }
    }
}

#[inline(always)]
fn each(lanes: u8, mut of: impl FnMut(usize) -> Option<Hit>) -> [Option<Hit>; LANES] {
    std::array::from_fn(|lane| if lanes >> lane & 1 == 1 { of(lane) } else { None })
}

#[inline(always)]
fn bits(lanes: u8, mut of: impl FnMut(usize) -> bool) -> u8 {
    lanes_in(lanes).fold(0, |bits, lane| bits | u8::from(of(lane)) << lane)
}

/// Which hits count.
trait Accept {
    /// Whether all of them do, so that nobody need be asked.
    const ALL: bool;
    fn accept(&mut self, lane: usize, hit: &Hit) -> bool;
}

struct Everything;

impl Accept for Everything {
    const ALL: bool = true;
    #[inline(always)]
    fn accept(&mut self, _: usize, _: &Hit) -> bool {
        true
    }
}

struct Where<F>(F);

impl<F: FnMut(usize, &Hit) -> bool> Accept for Where<F> {
    const ALL: bool = false;
    #[inline(always)]
    fn accept(&mut self, lane: usize, hit: &Hit) -> bool {
        (self.0)(lane, hit)
    }
}

#[inline(always)]
fn test_all<S: Simd>(
    simd: S,
    triangle_count: u32,
    triangles: &impl Triangles,
    rays: &[Ray; LANES],
    lanes: u8,
    accept: &mut impl Accept,
) -> [Option<Hit>; LANES] {
    let rays = WideRays::new(simd, rays);
    let lanes = lanes & rays.traceable();
    let mut best = Best::new(simd, &rays);
    for (axis, along) in rays.main_axes().into_iter().enumerate() {
        let along = along & lanes;
        if along != 0 {
            let shear = WideShear::new(&rays, axis);
            for id in 0..triangle_count {
                best.test(&rays, &shear, id, &triangles.vertices(id), along, accept);
            }
        }
    }
    best.hits()
}

/// Traces those of `rays` whose bit is set in `lanes`; with `ANY` the hits are some, and not the nearest.
#[inline(always)]
fn trace<S: Simd, const ANY: bool>(
    simd: S,
    tree: &TreeView<'_>,
    triangles: &impl Triangles,
    rays: &[Ray; LANES],
    lanes: u8,
    accept: &mut impl Accept,
) -> Best<S> {
    let endless;
    let rays = if ANY && is_on(Mutation::AnyIgnoresEnd) {
        endless = rays.map(|ray| Ray { t_max: f32::INFINITY, ..ray });
        &endless
    } else {
        rays
    };
    let rays = WideRays::new(simd, rays);
    let line = WideLine::new(simd, &rays, &tree.bounds);
    let mut best = Best::new(simd, &rays);

    // Split the rays into classes of equal signs, zeros and main axis.
    let [along_x, along_y, _] = rays.main_axes();
    let [x, y, z] = [line.signs(0), line.signs(1), line.signs(2)];
    let mut rest = lanes & rays.traceable() & line.inside;
    while rest != 0 {
        let first = rest.trailing_zeros();
        let mut class = rest;
        for mark in [along_x, along_y, x.0, x.1, y.0, y.1, z.0, z.1] {
            class &= if mark >> first & 1 == 1 { mark } else { !mark };
        }
        rest &= !class;
        let axis = match () {
            () if along_x >> first & 1 == 1 => 0,
            () if along_y >> first & 1 == 1 => 1,
            () => 2,
        };
        let packet = Packet {
            tree,
            triangles,
            rays: &rays,
            line: &line,
            shear: WideShear::new(&rays, axis),
            parallel: (x.0 >> first & 1) | (y.0 >> first & 1) << 1 | (z.0 >> first & 1) << 2,
            backward: (x.1 >> first & 1) | (y.1 >> first & 1) << 1 | (z.1 >> first & 1) << 2,
        };
        packet.descend::<ANY>(class, &mut best, accept);
    }
    best
}

/// What [`Line`] is to one ray.
struct WideLine<S: Simd> {
    /// x, y, z, and one that is never used: so every value of a node's two axis bits is an index.
    origin: [f32x8<S>; 4],
    inverse: [f32x8<S>; 4],
    slack: [f32x8<S>; 4],
    radius: f32x8<S>,
    /// The parts of the rays in the root box.
    t0: f32x8<S>,
    t1: f32x8<S>,
    /// The lanes that have such a part.
    inside: u8,
}

impl<S: Simd> WideLine<S> {
    #[inline(always)]
    fn new(simd: S, rays: &WideRays<'_, S>, bounds: &Aabb) -> Self {
        let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
        let zero = f32x8::splat(simd, 0.0);
        let (o, d) = (rays.origin, rays.direction);
        let least = d[0].abs().max(d[1].abs()).max(d[2].abs()) * Ray::DIVISOR_SHARE;
        let inverse = [inverse_of(d[0], least), inverse_of(d[1], least), inverse_of(d[2], least), zero];
        let radius =
            reach(o[0], min[0], max[0]).max(reach(o[1], min[1], max[1])).max(reach(o[2], min[2], max[2]))
                * unless(Mutation::ThinRay, THICKNESS, 0.0);

        // Clip the rays, as thick as they count, to the scene, as `Aabb::clip` does.
        let (mut t0, mut t1) = (rays.t_min, rays.t_max);
        for k in 0..3 {
            let low = ((f32x8::splat(simd, min[k]) - radius) - o[k]) * inverse[k];
            let high = ((f32x8::splat(simd, max[k]) + radius) - o[k]) * inverse[k];
            let backward = inverse[k].simd_lt(0.0);
            let near = backward.select(high, low) * Aabb::SHORTEN;
            let far = backward.select(low, high) * Aabb::LENGTHEN;
            t0 = near.simd_gt(t0).select(near, t0);
            t1 = far.simd_lt(t1).select(far, t1);
        }
        Self {
            origin: [o[0], o[1], o[2], zero],
            inverse,
            slack: [radius * inverse[0].abs(), radius * inverse[1].abs(), radius * inverse[2].abs(), zero],
            radius,
            t0,
            t1,
            inside: lanes_of(t0.simd_le(t1)),
        }
    }

    /// The lanes that are parallel to planes across axis `k`, and those that run against it.
    #[inline(always)]
    fn signs(&self, k: usize) -> (u8, u8) {
        let inverse = self.inverse[k];
        (lanes_of(inverse.is_infinite()), lanes_of(inverse.simd_lt(0.0)))
    }
}

/// The inverses of [`Ray::divisor`], where directions are at least `least`; infinite elsewhere.
#[inline(always)]
fn inverse_of<S: Simd>(direction: f32x8<S>, least: f32x8<S>) -> f32x8<S> {
    let simd = direction.token();
    let useless = direction.abs().simd_lt(least);
    f32x8::splat(simd, 1.0) / useless.select(f32x8::splat(simd, 0.0), direction)
}

/// The larger distance from origins to two coordinates.
#[inline(always)]
fn reach<S: Simd>(origin: f32x8<S>, low: f32, high: f32) -> f32x8<S> {
    let simd = origin.token();
    (f32x8::splat(simd, low) - origin).abs().max((f32x8::splat(simd, high) - origin).abs())
}

/// The best hits so far.
struct Best<S: Simd> {
    /// Before the first hit of a lane: `t_max` with the smallest id, which no hit at `t_max` itself precedes.
    t: f32x8<S>,
    triangle: u32x8<S>,
    b1: f32x8<S>,
    b2: f32x8<S>,
    /// Lanes that have a hit.
    found: u8,
}

impl<S: Simd> Best<S> {
    #[inline(always)]
    fn new(simd: S, rays: &WideRays<'_, S>) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { t: rays.t_max, triangle: u32x8::splat(simd, 0), b1: zero, b2: zero, found: 0 }
    }

    /// Tests triangle `id` against the rays of `active`; says which of them it is now the best hit of.
    #[inline(always)]
    fn test(
        &mut self,
        rays: &WideRays<'_, S>,
        shear: &WideShear<S>,
        id: u32,
        vertices: &[Vec3; 3],
        active: u8,
        accept: &mut impl Accept,
    ) -> u8 {
        let WideCrossing { lanes, t, b1, b2 } = shear.intersect(rays, vertices, active, self.t);
        if lanes == 0 {
            return 0;
        }
        let triangle = u32x8::splat(t.token(), id);
        let precedes = t.simd_lt(self.t) | (t.simd_eq(self.t) & triangle.simd_lt(self.triangle));
        let lanes = accepted(lanes & lanes_of(precedes), id, (t, b1, b2), accept);
        let better = mask32x8::from_bitmask(t.token(), u64::from(lanes));
        self.t = better.select(t, self.t);
        self.triangle = better.select(triangle, self.triangle);
        self.b1 = better.select(b1, self.b1);
        self.b2 = better.select(b2, self.b2);
        self.found |= lanes;
        lanes
    }

    /// The lanes whose best hit lies before `t0` by more than rounding.
    #[inline(always)]
    fn nearer_than(&self, t0: f32x8<S>) -> u8 {
        lanes_of(self.t.simd_lt(t0 * (1.0 - unless(Mutation::StopEarly, MARGIN, -1000.0 * MARGIN))))
    }

    #[inline(always)]
    fn hits(&self) -> [Option<Hit>; LANES] {
        let (t, triangle): ([f32; LANES], [u32; LANES]) = (self.t.into(), self.triangle.into());
        let (b1, b2): ([f32; LANES], [f32; LANES]) = (self.b1.into(), self.b2.into());
        each(self.found, |lane| {
            Some(Hit { t: t[lane], triangle: triangle[lane], b1: b1[lane], b2: b2[lane] })
        })
    }
}

/// The lanes of `lanes` whose hits count.
#[inline(always)]
fn accepted<S: Simd, A: Accept>(
    lanes: u8,
    triangle: u32,
    (t, b1, b2): (f32x8<S>, f32x8<S>, f32x8<S>),
    accept: &mut A,
) -> u8 {
    if A::ALL || lanes == 0 {
        return lanes;
    }
    let (t, b1, b2): ([f32; LANES], [f32; LANES], [f32; LANES]) = (t.into(), b1.into(), b2.into());
    lanes_in(lanes)
        .filter(|&lane| accept.accept(lane, &Hit { t: t[lane], triangle, b1: b1[lane], b2: b2[lane] }))
        .fold(0, |kept, lane| kept | 1 << lane)
}

/// Rays of one class on their way through a tree.
struct Packet<'a, S: Simd, T> {
    tree: &'a TreeView<'a>,
    triangles: &'a T,
    rays: &'a WideRays<'a, S>,
    line: &'a WideLine<S>,
    shear: WideShear<S>,
    /// Bits of the axes across which planes are parallel to the rays, and of those against which the rays run.
    parallel: u8,
    backward: u8,
}

/// A subtree that waits, and the rays that will visit it.
#[derive(Clone, Copy)]
struct Waiting<S: Simd> {
    at: u32,
    lanes: u8,
    t0: f32x8<S>,
    t1: f32x8<S>,
}

impl<S: Simd, T: Triangles> Packet<'_, S, T> {
    /// `TreeView::descend` for the rays of `class`.
    #[inline(always)]
    fn descend<const ANY: bool>(&self, class: u8, best: &mut Best<S>, accept: &mut impl Accept) {
        let mut stack = ArrayVec::<Waiting<S>, { MAX_DEPTH as usize }>::new();
        let WideLine { mut t0, mut t1, .. } = *self.line;
        let (mut at, mut lanes) = (0u32, class);
        loop {
            let node = Node(self.tree.slots[at as usize]);
            if node.is_leaf() {
                // Test the triangles of the cell.
                match node.count() {
                    0 => {}
                    1 => _ = self.test::<ANY>(node.payload(), lanes, best, accept),
                    count => {
                        let first = node.payload() as usize;
                        for &id in &self.tree.list[first..first + count as usize] {
                            self.test::<ANY>(id, lanes, best, accept);
                        }
                    }
                }
            } else {
                // Test the references early, and stop rays that need not enter.
                let left = at + node.size();
                if node.refs() > 0 {
                    let [first, second] = self.tree.slots[at as usize + 1];
                    let mut found = self.test::<ANY>(first, lanes, best, accept);
                    if node.refs() > 1 && !is_on(Mutation::ReferenceSkipped) {
                        found |= self.test::<ANY>(second, lanes, best, accept);
                    }
                    if found != 0 {
                        lanes &= if ANY { !best.found } else { !best.nearer_than(t0) };
                        t1 = best.t.simd_lt(t1).select(best.t, t1);
                    }
                }
                if lanes != 0 {
                    let axis = node.axis();
                    let split = f32x8::splat(t0.token(), node.split());
                    let offset = split - self.line.origin[axis];
                    let right = node.right();
                    if self.parallel >> axis & 1 == 1 {
                        // The rays are parallel to the plane: each on one side of it, or as thick as it is in it.
                        let radius = self.line.radius;
                        let (to_left, to_right) = if is_on(Mutation::OneSideOfPlane) {
                            let left = lanes_of(offset.simd_gt(0.0));
                            (lanes & left, lanes & !left)
                        } else {
                            (
                                lanes & lanes_of(offset.simd_ge(-radius)),
                                lanes & lanes_of(offset.simd_le(radius)),
                            )
                        };
                        if to_left == 0 {
                            (at, lanes) = (right, to_right);
                        } else {
                            if to_right != 0 {
                                stack.push(Waiting { at: right, lanes: to_right, t0, t1 });
                            }
                            (at, lanes) = (left, to_left);
                        }
                        continue;
                    }

                    // Find where the rays come to the plane and leave it.
                    let runs_down = self.backward >> axis & 1 == 1;
                    let (first, second) = if runs_down != is_on(Mutation::SwappedChildren) {
                        (right, left)
                    } else {
                        (left, right)
                    };
                    let to_plane = offset * self.line.inverse[axis];
                    let slack = self.line.slack[axis];
                    let (enter, leave) = (to_plane - slack, to_plane + slack);

                    // Go on in the cells that any of them passes.
                    let in_first = lanes & lanes_of(leave.simd_ge(t0 * (1.0 - MARGIN)));
                    let in_second = lanes & lanes_of(enter.simd_le(t1 * (1.0 + MARGIN)));
                    if in_second == 0 {
                        at = first;
                    } else if in_first == 0 {
                        at = second;
                    } else {
                        let entered = enter.simd_gt(t0).select(enter, t0);
                        stack.push(Waiting { at: second, lanes: in_second, t0: entered, t1 });
                        t1 = leave.simd_lt(t1).select(leave, t1);
                        (at, lanes) = (first, in_first);
                    }
                    continue;
                }
            }
            // Take up the nearest cell that waits for a ray that may still find something there.
            loop {
                let Some(next) = stack.pop() else { return };
                (at, t0, t1) = (next.at, next.t0, next.t1);
                lanes = next.lanes & if ANY { !best.found } else { !best.nearer_than(t0) };
                if lanes != 0 {
                    t1 = best.t.simd_lt(t1).select(best.t, t1);
                    break;
                }
            }
        }
    }

    /// Tests triangle `id` against the rays of `lanes`; says which of them hit it.
    #[inline(always)]
    fn test<const ANY: bool>(&self, id: u32, lanes: u8, best: &mut Best<S>, accept: &mut impl Accept) -> u8 {
        let vertices = self.triangles.vertices(id);
        test_hit::<S, ANY, _>(self.rays, &self.shear, id, &vertices, lanes, best, accept)
    }
}

/// Tests a triangle for [`Packet::test`]. Where any hit does, its place on the ray is not computed unless somebody asks.
#[inline(always)]
fn test_hit<S: Simd, const ANY: bool, A: Accept>(
    rays: &WideRays<'_, S>,
    shear: &WideShear<S>,
    id: u32,
    vertices: &[Vec3; 3],
    lanes: u8,
    best: &mut Best<S>,
    accept: &mut A,
) -> u8 {
    if ANY && A::ALL {
        let crossed = shear.is_crossed(rays, vertices, lanes & !best.found, best.t);
        best.found |= crossed;
        crossed
    } else {
        best.test(rays, shear, id, vertices, lanes, accept)
    }
}
