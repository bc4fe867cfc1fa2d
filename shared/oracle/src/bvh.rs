//! The oracle's own tree: a binary bounding volume hierarchy in `f64`, split by the surface area heuristic over 32 bins an axis
//! (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies"), each triangle in one leaf.
//!
//! A box is left out only where no hit of one of its triangles can count, by the bounds of the triangle test. So the tree and the trial
//! of every triangle ([`Bvh::flat`]) come to equal hits, bit for bit.

use crate::triangle::{Hit, PLACE_ERROR, ROUNDING, Ray, Start};
use glam::DVec3;

/// Triangles by the boxes around them.
pub(crate) struct Bvh {
    /// The first is the root; none when every triangle is to be tried.
    nodes: Vec<Node>,
    corners: Vec<[DVec3; 3]>,
    /// Ids of `corners`.
    ids: Vec<u32>,
    bounds: Bounds,
}

/// An inner node (`count` 0) whose children are `first` and `first + 1`, or a leaf with `count` triangles from `first`.
#[derive(Clone, Copy)]
struct Node {
    bounds: Bounds,
    first: u32,
    count: u32,
}

#[derive(Clone, Copy)]
struct Bounds {
    low: DVec3,
    high: DVec3,
}

const BINS: usize = 32;
/// Leaves hold at most so many triangles unless their centres coincide.
const LEAF_MAX: usize = 4;
/// Below so many levels nodes are split in halves.
const SAH_LEVELS: u32 = 64;
/// Nodes that wait: one a level. Halving 2^32 triangles takes 32 levels more than the others.
const STACK: usize = SAH_LEVELS as usize + 34;

impl Bvh {
    /// The tree over `triangles`, whose places are their ids. Those with a coordinate that is no finite number are left out.
    pub(crate) fn new(triangles: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let mut flat = Self::flat(triangles);
        let count = flat.ids.len();
        if count == 0 {
            return flat;
        }

        // Split from the top; `order` is what the leaves hold.
        let boxes: Vec<Bounds> = flat.corners.iter().map(Bounds::of).collect();
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut nodes = vec![Node { bounds: flat.bounds, first: 0, count: count as u32 }];
        let mut open = vec![(0usize, 0u32)];
        while let Some((at, level)) = open.pop() {
            let Node { first, count, .. } = nodes[at];
            let range = first as usize..(first + count) as usize;
            let Some(left) = split(&mut order[range], &boxes, level) else { continue };
            let children = nodes.len();
            for (first, count) in [(first, left as u32), (first + left as u32, count - left as u32)] {
                let held = &order[first as usize..(first + count) as usize];
                let bounds = held.iter().fold(Bounds::EMPTY, |sum, &k| sum.with(&boxes[k as usize]));
                open.push((nodes.len(), level + 1));
                nodes.push(Node { bounds, first, count });
            }
            nodes[at].first = children as u32;
            nodes[at].count = 0;
        }

        // Lay the triangles out as the leaves hold them.
        flat.corners = order.iter().map(|&k| flat.corners[k as usize]).collect();
        flat.ids = order.iter().map(|&k| flat.ids[k as usize]).collect();
        flat.nodes = nodes;
        flat
    }

    /// Without a tree: every ray tries every triangle.
    pub(crate) fn flat(triangles: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let (mut corners, mut ids) = (Vec::new(), Vec::new());
        for (id, triangle) in (0..).zip(triangles) {
            if triangle.iter().all(|corner| corner.is_finite()) {
                corners.push(triangle);
                ids.push(id);
            }
        }
        let bounds = corners.iter().fold(Bounds::EMPTY, |sum, triangle| sum.with(&Bounds::of(triangle)));
        Self { nodes: Vec::new(), corners, ids, bounds }
    }

    /// The largest coordinate of a corner, in size; 0 without triangles.
    pub(crate) fn largest_coordinate(&self) -> f64 {
        if self.ids.is_empty() {
            0.0
        } else {
            self.bounds.low.abs().max(self.bounds.high.abs()).max_element()
        }
    }

    /// The first hit of `ray` behind `from` that `accept` takes.
    pub(crate) fn nearest(&self, ray: &Ray, from: Start, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.walk(ray, from, f64::INFINITY, |hit, until| {
            if best.is_none_or(|best| hit.precedes(&best)) && accept(&hit) {
                best = Some(hit);
                *until = hit.t;
            }
            true
        });
        best
    }

    /// Shows every hit of `ray` behind `from` and not beyond `until` to `meet`, in no order, each once, until it returns false.
    pub(crate) fn each(&self, ray: &Ray, from: Start, until: f64, mut meet: impl FnMut(&Hit) -> bool) {
        self.walk(ray, from, until, |hit, _| meet(&hit));
    }

    /// [`Bvh::each`]; `meet` may bring `until` nearer.
    fn walk(&self, ray: &Ray, from: Start, mut until: f64, mut meet: impl FnMut(Hit, &mut f64) -> bool) {
        let mut try_some = |range: std::ops::Range<usize>, until: &mut f64| {
            range.into_iter().all(|k| match ray.crosses(&self.corners[k], self.ids[k]) {
                Some(hit) if from.admits(&hit) && hit.t <= *until => meet(hit, until),
                _ => true,
            })
        };
        if self.nodes.is_empty() {
            try_some(0..self.ids.len(), &mut until);
            return;
        }

        // The nearer child first; the other waits with the place at which the ray enters it.
        let slabs = Slabs::new(ray, &self.bounds);
        let mut waiting = [(0u32, 0.0); STACK];
        let mut height = 0;
        let mut next = slabs.enters(&self.nodes[0].bounds, from.t, until).map(|t| (0, t));
        loop {
            let Some((at, t)) = next.take().or_else(|| {
                height = usize::checked_sub(height, 1)?;
                Some(waiting[height])
            }) else {
                return;
            };
            if t > until {
                continue;
            }
            let Node { first, count, .. } = self.nodes[at as usize];
            if count > 0 {
                if !try_some(first as usize..(first + count) as usize, &mut until) {
                    return;
                }
                continue;
            }
            let enters = |child: u32| {
                slabs.enters(&self.nodes[child as usize].bounds, from.t, until).map(|t| (child, t))
            };
            next = match (enters(first), enters(first + 1)) {
                (Some(left), Some(right)) => {
                    let (near, far) = if left.1 <= right.1 { (left, right) } else { (right, left) };
                    waiting[height] = far;
                    height += 1;
                    Some(near)
                }
                (one, other) => one.or(other),
            };
        }
    }
}

/// Where to part `order`: by the heuristic, in halves, or not at all.
fn split(order: &mut [u32], boxes: &[Bounds], level: u32) -> Option<usize> {
    if order.len() <= LEAF_MAX {
        return None;
    }
    let centre = |k: u32| boxes[k as usize].centre();
    let spread = order.iter().fold(Bounds::EMPTY, |sum, &k| sum.with_point(centre(k)));
    let size = spread.high - spread.low;
    let halves = |order: &mut [u32]| {
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |&p, &q| {
            centre(p)[axis].total_cmp(&centre(q)[axis]).then(p.cmp(&q))
        });
        Some(middle)
    };
    if level >= SAH_LEVELS {
        return halves(order);
    }

    // Count and enclose what lies in each bin, and find the cheapest border between two.
    let bin_of = |k: u32, axis: usize| {
        let share = (centre(k)[axis] - spread.low[axis]) / size[axis];
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    let mut best = (f64::INFINITY, 0, 0);
    for axis in 0..3 {
        if size[axis] > 0.0 {
            let mut bins = [(0usize, Bounds::EMPTY); BINS];
            for &k in order.iter() {
                let bin = &mut bins[bin_of(k, axis)];
                *bin = (bin.0 + 1, bin.1.with(&boxes[k as usize]));
            }
            let mut right_cost = [0.0; BINS];
            let mut right = (0, Bounds::EMPTY);
            for bin in (1..BINS).rev() {
                right = (right.0 + bins[bin].0, right.1.with(&bins[bin].1));
                right_cost[bin] = right.0 as f64 * right.1.area();
            }
            let mut left = (0, Bounds::EMPTY);
            for border in 1..BINS {
                left = (left.0 + bins[border - 1].0, left.1.with(&bins[border - 1].1));
                let cost = left.0 as f64 * left.1.area() + right_cost[border];
                if left.0 > 0 && left.0 < order.len() && cost < best.0 {
                    best = (cost, axis, border);
                }
            }
        }
    }
    if best.0 == f64::INFINITY {
        // Centres coincide, or areas overflow.
        return halves(order);
    }

    // Part in place.
    let (_, axis, border) = best;
    let mut left = 0;
    for k in 0..order.len() {
        if bin_of(order[k], axis) < border {
            order.swap(left, k);
            left += 1;
        }
    }
    Some(left)
}

impl Bounds {
    const EMPTY: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    fn of(corners: &[DVec3; 3]) -> Self {
        corners.iter().fold(Self::EMPTY, |sum, &corner| sum.with_point(corner))
    }

    fn with(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn with_point(&self, point: DVec3) -> Self {
        Self { low: self.low.min(point), high: self.high.max(point) }
    }

    fn centre(&self) -> DVec3 {
        self.low * 0.5 + self.high * 0.5
    }

    /// Half the surface; 0 of an empty box.
    fn area(&self) -> f64 {
        let size = (self.high - self.low).max(DVec3::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }
}

/// What the test of boxes needs of a ray.
struct Slabs {
    origin: DVec3,
    direction: DVec3,
    /// By how much every box is widened, and by how much what is entered comes before what is hit: [`PLACE_ERROR`] of the largest
    /// distance of a corner from the origin.
    pad: f64,
}

impl Slabs {
    fn new(ray: &Ray, all: &Bounds) -> Self {
        let farthest = (all.low - ray.origin).abs().max((all.high - ray.origin).abs());
        Self { origin: ray.origin, direction: ray.direction, pad: PLACE_ERROR * farthest.length() }
    }

    /// Where the ray enters the box, if it does between `from` and `until`, or a place before.
    ///
    /// Quotients are off by 2 roundoffs, far below [`ROUNDING`], which also carries them past the rounding of distances.
    fn enters(&self, bounds: &Bounds, from: f64, until: f64) -> Option<f64> {
        let (mut first, mut last) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            let (origin, direction) = (self.origin[axis], self.direction[axis]);
            let low = bounds.low[axis] - origin - self.pad;
            let high = bounds.high[axis] - origin + self.pad;
            if direction == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return None;
                }
            } else {
                let (p, q) = (low / direction, high / direction);
                first = first.max(p.min(q));
                last = last.min(p.max(q));
            }
        }
        let entry = first - first.abs() * ROUNDING;
        let exit = last + last.abs() * ROUNDING;
        (entry <= exit && entry <= until && exit >= from).then_some(entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::soup::{Random, cubes, sphere};

    /// Everything about the hits of a ray, first the nearest.
    fn all_hits(tree: &Bvh, ray: &Ray, from: Start, until: f64) -> (Option<Hit>, Vec<Hit>) {
        let mut hits = Vec::new();
        tree.each(ray, from, until, |hit| {
            hits.push(*hit);
            true
        });
        hits.sort_by(|p, q| p.t.total_cmp(&q.t).then(p.id.cmp(&q.id)));
        (tree.nearest(ray, from, |_| true), hits)
    }

    /// Holds the tree to the trial of every triangle; says how many rays hit.
    fn check(what: &str, triangles: &[[DVec3; 3]], rays: impl Iterator<Item = Ray>) -> usize {
        let tree = Bvh::new(triangles.iter().copied());
        let flat = Bvh::flat(triangles.iter().copied());
        let mut met = 0;
        for (k, ray) in rays.enumerate() {
            let expected = all_hits(&flat, &ray, Start::EYE, f64::INFINITY);
            assert_eq!(
                all_hits(&tree, &ray, Start::EYE, f64::INFINITY),
                expected,
                "{what}, ray {k}: {ray:?}"
            );
            let Some(first) = expected.0 else { continue };
            met += 1;
            assert_eq!(Some(first), expected.1.first().copied());

            // From the nearest hit on, and up to it.
            let from = Start { t: first.t, id: first.id, leaves: first.id };
            assert_eq!(
                all_hits(&tree, &ray, from, f64::INFINITY),
                all_hits(&flat, &ray, from, f64::INFINITY),
                "{what}, ray {k} behind {first:?}"
            );
            let up_to = all_hits(&tree, &ray, Start::EYE, first.t).1;
            assert_eq!(up_to, all_hits(&flat, &ray, Start::EYE, first.t).1, "{what}, ray {k}");
            assert!(up_to.iter().all(|hit| hit.t == first.t));
        }
        met
    }

    #[test]
    fn the_tree_finds_what_every_triangle_finds() {
        let mut random = Random(1);
        let mut soup = |count: usize, size: f64| -> Vec<[DVec3; 3]> {
            let corners = |_| {
                let at = random.vector();
                [0; 3].map(|_| at + random.vector() * size)
            };
            (0..count).map(corners).collect()
        };
        let scenes = [
            ("a few", soup(3, 1.0)),
            ("large ones", soup(200, 1.0)),
            ("small ones", soup(2000, 0.05)),
            ("a sphere", sphere(20)),
            ("cubes", cubes(5)),
            ("cubes far away", cubes(3).iter().map(|t| t.map(|p| p + DVec3::splat(1e7))).collect()),
            ("tiny", sphere(8).iter().map(|t| t.map(|p| p * 1e-20)).collect()),
            ("huge", sphere(8).iter().map(|t| t.map(|p| p * 1e20)).collect()),
        ];
        for (what, triangles) in scenes {
            let all = Bvh::flat(triangles.iter().copied()).bounds;
            let size = (all.high - all.low).max_element();
            let rays = (0..600).map(|_| {
                let origin = all.centre() + random.vector() * size;
                let target = triangles[(random.unit() * triangles.len() as f64) as usize][0];
                let aim = target + random.vector() * (size * random.unit() * 0.1);
                Ray::new(origin, (aim - origin).normalize())
            });
            assert!(check(what, &triangles, rays) > 10, "{what}: hardly a ray hits");
        }
    }

    #[test]
    fn rays_along_axes_and_in_the_planes_of_boxes_find_all() {
        let triangles = cubes(4);
        let mut rays = Vec::new();
        for k in 0..9 * 9 {
            // Origins on corners, edges and middles of the grid, before and in it.
            let (p, q) = (f64::from(k % 9) * 0.5, f64::from(k / 9) * 0.5);
            for axis in 0..3 {
                for start in [-1.0, 2.0, 2.25] {
                    let mut origin = DVec3::ZERO;
                    (origin[axis], origin[(axis + 1) % 3], origin[(axis + 2) % 3]) = (start, p, q);
                    rays.push(Ray::new(origin, DVec3::AXES[axis]));
                    rays.push(Ray::new(origin, -DVec3::AXES[axis]));
                    // Diagonal in a plane of walls, through corners.
                    let diagonal = DVec3::AXES[axis] + DVec3::AXES[(axis + 1) % 3];
                    rays.push(Ray::new(origin, diagonal.normalize()));
                }
            }
        }
        assert!(check("cubes", &triangles, rays.into_iter()) > 500);
    }

    #[test]
    fn of_coincident_triangles_the_smallest_id_comes_first_and_each_comes_once() {
        // The same triangle many times, its corners in any order, between others.
        let base = [DVec3::new(-1.0, -1.0, 0.3), DVec3::new(1.1, -0.9, 0.1), DVec3::new(0.1, 1.2, 0.7)];
        let mut triangles: Vec<[DVec3; 3]> = (0..40)
            .map(|k| {
                let mut corners = base;
                corners.rotate_left(k % 3);
                if k % 2 == 1 {
                    corners.swap(0, 1);
                }
                corners
            })
            .collect();
        triangles.extend(sphere(6).iter().map(|t| t.map(|p| p * 5.0)));
        let mut random = Random(5);
        let tree = Bvh::new(triangles.iter().copied());
        let mut ties = 0;
        for _ in 0..500 {
            let origin = DVec3::new(0.0, 0.0, -2.0) + random.vector();
            let inside = base[0] * 0.4 + base[1] * 0.3 + base[2] * 0.3 + random.vector() * 0.1;
            let ray = Ray::new(origin, (inside - origin).normalize());
            let (first, hits) = all_hits(&tree, &ray, Start::EYE, f64::INFINITY);
            let first = first.expect("it is in the middle of them");
            // All forty lie within roundoff; the rounding of distances makes them one unless a border of 2^-40 runs between.
            let same = hits.iter().filter(|hit| hit.t == first.t && hit.id < 40).count();
            ties += usize::from(same == 40 && first.id == 0);
            let mut ids: Vec<u32> = hits.iter().map(|hit| hit.id).collect();
            ids.sort_unstable();
            assert!(ids.windows(2).all(|pair| pair[0] < pair[1]), "each once");
        }
        // The forty differ by a few roundoffs, 2^-9 of a step or so: about one ray in 500 meets a border.
        assert!(ties >= 495, "only {ties} of 500");
        let rays = (0..200).map(|k| {
            Ray::new(
                DVec3::new(0.0, 0.0, -2.0),
                (DVec3::Z + random.vector() * (f64::from(k) * 1e-3)).normalize(),
            )
        });
        check("coincident", &triangles, rays);
    }

    #[test]
    fn nothing_and_what_is_no_number_is_met_by_no_ray() {
        let nan = [DVec3::NAN, DVec3::X, DVec3::Y];
        let whole = [DVec3::new(-1.0, -1.0, 1.0), DVec3::new(1.0, -1.0, 1.0), DVec3::new(0.0, 1.0, 1.0)];
        let ray = Ray::new(DVec3::ZERO, DVec3::Z);
        assert_eq!(Bvh::new(std::iter::empty()).nearest(&ray, Start::EYE, |_| true), None);
        let tree = Bvh::new([nan, whole, nan].into_iter());
        assert_eq!(tree.nearest(&ray, Start::EYE, |_| true).map(|hit| (hit.t, hit.id)), Some((1.0, 1)));
        assert_eq!(tree.largest_coordinate(), 1.0);
    }

    #[test]
    fn a_stack_of_equal_triangles_is_halved() {
        // Equal centres: no border parts them.
        let triangles = vec![[DVec3::ZERO, DVec3::X, DVec3::Y]; 1000];
        let ray = Ray::new(DVec3::new(0.2, 0.2, -1.0), DVec3::Z);
        assert_eq!(check("equal", &triangles, std::iter::once(ray)), 1);
    }
}
