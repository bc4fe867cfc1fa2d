//! Closest-hit and any-hit traversal, and the exhaustive search that both must agree with.
//!
//! A traversal never uses a cell's interval to reject a hit, only to order cells and to stop; so rounding in a plane
//! distance can cost a visit, not a hit. References of an inner node are tested on the way down, before its children.
//!
//! **Why it finds what an exhaustive search finds.** The triangle test accepts triangles that the ray misses by a rounding error
//! ([`tessera_geometry::triangle`]); a ray that grazes a cell by less would miss what only that cell lists. So the ray is
//! taken as thick as that error: planes within [`THICKNESS`] of it count as crossed. The point that an accepted hit reports
//! then lies in a cell that is visited, over an interval that holds its `t`.

use crate::node::{MAX_DEPTH, Node, Slot};
use arrayvec::ArrayVec;
use tessera_geometry::mutation::{Mutation, is_on, unless};
use tessera_geometry::rounding::gamma;
use tessera_geometry::triangle::{LATERAL_ERROR, RayShear, intersect};
use tessera_geometry::{Aabb, Hit, Ray, Vec3};

/// The triangles that a tree refers to.
pub trait Triangles {
    /// Decoded vertices of triangle `id` in local units.
    fn vertices(&self, id: u32) -> [Vec3; 3];
}

/// A validated tree ([`crate::validate::validate`]), borrowed from wherever its bytes lie.
#[derive(Clone, Copy, Debug)]
pub struct TreeView<'a> {
    /// Root box.
    pub bounds: Aabb,
    /// Slots; see [`crate::node`].
    pub slots: &'a [Slot],
    /// Leaf lists.
    pub list: &'a [u32],
}

impl TreeView<'_> {
    /// The nearest hit for which `accept` is true; of equally near ones the smallest triangle id.
    /// `accept` may be called more than once for one triangle, in any order; it must always say the same of one hit.
    /// A ray that is not traceable ([`Ray::is_traceable`]) misses.
    pub fn closest_hit(
        &self,
        triangles: &impl Triangles,
        ray: &Ray,
        accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        self.walk::<false>(triangles, ray, accept)
    }

    /// Whether any hit with `t_min < t < t_max` is accepted. A ray that is not traceable misses.
    pub fn any_hit(&self, triangles: &impl Triangles, ray: &Ray, accept: impl FnMut(&Hit) -> bool) -> bool {
        self.walk::<true>(triangles, ray, accept).is_some()
    }

    /// Searches along the whole of `ray`.
    fn walk<const ANY: bool>(
        &self,
        triangles: &impl Triangles,
        ray: &Ray,
        accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        if !ray.is_traceable() {
            return None;
        }
        let endless = Ray { t_max: f32::INFINITY, ..*ray };
        let ray = if ANY && is_on(Mutation::AnyIgnoresEnd) { &endless } else { ray };
        let (line, t0, t1) = Line::enter(ray, &self.bounds)?;
        let mut search = Search::new(triangles, ray, accept);
        self.descend::<ANY>(&line, &mut search, (0, t0, t1));
        search.found.then_some(search.best)
    }

    /// Visits the cells along the ray from near to far, in the subtree and over the interval that `start` names; stops at the
    /// first accepted hit if `ANY`, else when no cell can hold a nearer one. (Havran 2000's traversal, with references as in
    /// Seo, Park and Ihm 2022, section 3.2.)
    fn descend<const ANY: bool>(
        &self,
        line: &Line,
        search: &mut Search<'_, impl Triangles, impl FnMut(&Hit) -> bool>,
        start: (u32, f32, f32),
    ) {
        let mut stack = ArrayVec::<_, { MAX_DEPTH as usize }>::new();
        let (mut at, mut t0, mut t1) = start;
        loop {
            let node = Node(self.slots[at as usize]);
            if node.is_leaf() {
                // Test the triangles of the cell.
                match node.count() {
                    0 => {}
                    1 => search.test(node.payload()),
                    count => {
                        let first = node.payload() as usize;
                        for &id in &self.list[first..first + count as usize] {
                            search.test(id);
                        }
                    }
                }
            } else {
                // Test the references early: a hit outside this cell is still a true hit.
                let left = at + node.size();
                if node.refs() > 0 {
                    let [first, second] = self.slots[at as usize + 1];
                    search.test(first);
                    if node.refs() > 1 && !is_on(Mutation::ReferenceSkipped) {
                        search.test(second);
                    }
                }
                if ANY && search.found {
                    return;
                }
                if !search.is_nearer_than(t0) {
                    t1 = if search.best.t < t1 { search.best.t } else { t1 };

                    let LineAxis { origin, inverse, slack } = line.axes[node.axis()];
                    let split = node.split();
                    if inverse.is_infinite() {
                        // The ray is parallel to the plane: on one side of it, or as thick as it is in it.
                        if (split - origin).abs() <= line.radius && !is_on(Mutation::OneSideOfPlane) {
                            stack.push((node.right(), t0, t1));
                            at = left;
                        } else {
                            at = if origin < split { left } else { node.right() };
                        }
                        continue;
                    }

                    // Find where the ray comes to the plane and leaves it. Along the ray the cells follow each other as its
                    // direction points; a plane behind the origin has negative distances and leaves the cell behind it.
                    let (first, second) = if (inverse < 0.0) != is_on(Mutation::SwappedChildren) {
                        (node.right(), left)
                    } else {
                        (left, node.right())
                    };
                    let to_plane = (split - origin) * inverse;
                    let (enter, leave) = (to_plane - slack, to_plane + slack);

                    // Go on in the cells that the ray passes.
                    if leave < t0 * (1.0 - MARGIN) {
                        at = second;
                    } else if enter > t1 * (1.0 + MARGIN) {
                        at = first;
                    } else {
                        stack.push((second, if enter > t0 { enter } else { t0 }, t1));
                        t1 = if leave < t1 { leave } else { t1 };
                        at = first;
                    }
                    continue;
                }
            }
            if ANY && search.found {
                return;
            }
            // Take up the nearest cell that waits, unless every one of them lies behind the best hit.
            loop {
                let Some(next) = stack.pop() else { return };
                (at, t0, t1) = next;
                if !search.is_nearer_than(t0) {
                    break;
                }
            }
        }
    }
}

/// A ray as the traversal sees it: thick, along [`Ray::divisor`].
#[derive(Clone, Copy)]
struct Line {
    /// x, y, z, and one that is never used: so every value of a node's two axis bits is an index.
    axes: [LineAxis; 4],
    /// Half the thickness.
    radius: f32,
}

/// One coordinate of a [`Line`].
#[derive(Clone, Copy, Default)]
struct LineAxis {
    origin: f32,
    /// `1 / direction`; infinite for a ray that is parallel to planes across this axis.
    inverse: f32,
    /// The distance along the ray that [`Line::radius`] makes: `radius * |inverse|`.
    slack: f32,
}

impl Line {
    /// The traceable `ray` and its part inside `bounds`, as thick as it counts.
    fn enter(ray: &Ray, bounds: &Aabb) -> Option<(Self, f32, f32)> {
        let inverse = ray.divisor().to_array().map(f32::recip);
        let Aabb { min, max } = *bounds;
        let thickness = unless(Mutation::ThinRay, THICKNESS, 0.0);
        let radius = thickness * (min - ray.origin).abs().max((max - ray.origin).abs()).max_element();
        // (A built tree's root box is larger than its triangles by a voxel or a digit, which takes up the rounding of these sums.)
        let thick = Aabb { min: min - radius, max: max + radius };
        let (t0, t1) = thick.clip(ray, Vec3::from_array(inverse))?;
        let origin = ray.origin.to_array();
        let mut axes = [LineAxis::default(); 4];
        for k in 0..3 {
            axes[k] = LineAxis { origin: origin[k], inverse: inverse[k], slack: radius * inverse[k].abs() };
        }
        Some((Self { axes, radius }, t0, t1))
    }
}

/// The nearest accepted hit over triangles `0..triangle_count`, found by testing every one with the test that the tree uses:
/// the judge of [`TreeView::closest_hit`], with which it agrees in triangle and in every bit of `t`.
pub fn brute_force_closest(
    triangle_count: u32,
    triangles: &impl Triangles,
    ray: &Ray,
    accept: impl FnMut(&Hit) -> bool,
) -> Option<Hit> {
    if !ray.is_traceable() {
        return None;
    }
    let mut search = Search::new(triangles, ray, accept);
    for id in 0..triangle_count {
        search.test(id);
    }
    search.found.then_some(search.best)
}

/// Half the thickness of the ray, in units of the largest coordinate of the scene relative to its origin: the reported point of
/// a hit is within [`LATERAL_ERROR`] of the exact ray at the exact `t`, rounding `t` moves it by one unit roundoff more, and a
/// plane distance with its slack takes four rounded operations and one inverse.
pub(crate) const THICKNESS: f32 = LATERAL_ERROR + gamma(6);

/// The relative error allowed to a distance compared with another one, over and above [`THICKNESS`]: both were rounded to `f32` and one
/// has been through a sum or two; this is eight roundoffs.
pub(crate) const MARGIN: f32 = 4.0 * f32::EPSILON;

/// The best hit so far, and what is needed to find a better one.
struct Search<'a, T, A> {
    triangles: &'a T,
    ray: &'a Ray,
    shear: RayShear,
    accept: A,
    /// Before the first hit: `t_max` with the smallest id, which no hit at `t_max` itself precedes.
    best: Hit,
    found: bool,
}

impl<'a, T: Triangles, A: FnMut(&Hit) -> bool> Search<'a, T, A> {
    /// A search along `ray`, which is traceable.
    fn new(triangles: &'a T, ray: &'a Ray, accept: A) -> Self {
        let best = Hit { t: ray.t_max, triangle: 0, b1: 0.0, b2: 0.0 };
        Self { triangles, ray, shear: RayShear::new(ray), accept, best, found: false }
    }

    #[inline]
    fn test(&mut self, triangle: u32) {
        let vertices = self.triangles.vertices(triangle);
        if let Some(crossing) = intersect(self.ray, &self.shear, vertices, self.best.t) {
            let hit = Hit { t: crossing.t, triangle, b1: crossing.b1, b2: crossing.b2 };
            if hit.precedes(&self.best) && (self.accept)(&hit) {
                self.best = hit;
                self.found = true;
            }
        }
    }

    /// Whether the best hit lies before `t0` by more than rounding, so that nothing from `t0` on can replace it.
    #[inline]
    fn is_nearer_than(&self, t0: f32) -> bool {
        self.best.t < t0 * (1.0 - unless(Mutation::StopEarly, MARGIN, -1000.0 * MARGIN))
    }
}
