//! One sample: the tree of rays behind one ray from the eye, walked with an explicit stack.
//!
//! # How a path ends
//!
//! * **Depth.** A surface met after `max_depth` mirror and bent rays shows its local light (lights, ambient,
//!   emission); what its mirror or glass would have brought is black. Between two facing mirrors of reflectance `k`
//!   and emission `e` the picture is `e (1 + k + ... + k^max_depth)`.
//! * **Weight.** A ray whose weight in the pixel is below the frame's cut-off `w` in every channel is not traced, and none of weight 0 is.
//!   Whatever it would have seen changes a pixel by less than `w` times that radiance: with [`Sampling::CUTOFF`](crate::Sampling::CUTOFF)
//!   = 1/512 by less than half a step, 1/510, of 8-bit linear light. The weights of the rays behind one surface sum to at most that
//!   surface's own, so at most `3 / w` rays (`1 / w` a channel, 1536 in all) of one generation are alive: `3 (1 + max_depth + MAX_LAYERS) / w`
//!   in all. With `w = 0` only depth and layers end a path.
//! * **Layers.** Straight continuations (blending, thin walls, `ior == 1`) do not count as depth, but a path passes
//!   at most [`MAX_LAYERS`] of them; behind the last one it is black and opaque.

use crate::probe::{Direct, Tracer};
use crate::scene::Renderer;
use crate::shade::{View, local_light, local_lights, reflect};
use crate::surface::{clearance, offset_origin, paint_at};
use crate::{FrameParams, RayCounts};
use tessera_geometry::mutation::{Mutation, is_on};
use tessera_geometry::wide::{LANES, lanes_in};
use tessera_geometry::{Hit, Ray, Vec3};

/// Surfaces that a path, or a shadow ray, passes straight.
pub const MAX_LAYERS: u32 = 64;

/// Whether a ray, or a light, of this weight is not followed.
pub(crate) fn is_cut_off(weight: Vec3, cutoff: f32) -> bool {
    let most = weight.max_element();
    most < cutoff || most == 0.0
}

/// How a ray goes on behind a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Passage {
    /// As if nothing were there.
    Straight,
    /// In another direction.
    Bent(Vec3),
}

/// Which of the rays behind a surface it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// The same ray, farther on.
    On,
    /// Into or out of glass.
    Bent,
    /// Off a mirror.
    Mirror,
}

/// A place on a ray: hits count when they come after it in the order (t, triangle). No triangle comes after
/// [`Hit::NO_TRIANGLE`], so with it hits at that very `t` are out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct After {
    pub(crate) t: f32,
    pub(crate) triangle: u32,
}

impl After {
    /// The start of a ray from the eye.
    pub(crate) const EYE: Self = Self::start(0.0);

    /// The start of a ray whose hits begin behind `t_min`.
    pub(crate) const fn start(t_min: f32) -> Self {
        Self { t: t_min, triangle: Hit::NO_TRIANGLE }
    }

    /// The place of `hit`.
    pub(crate) fn hit(hit: &Hit) -> Self {
        Self { t: hit.t, triangle: hit.triangle }
    }

    fn precedes(self, hit: &Hit) -> bool {
        self.t < hit.t || (self.t == hit.t && self.triangle < hit.triangle)
    }
}

/// A ray that waits to be traced.
#[derive(Clone, Copy, Debug)]
struct Segment {
    origin: Vec3,
    direction: Vec3,
    /// Where it goes on, when it is a continuation.
    after: After,
    /// Its share in the pixel.
    weight: Vec3,
    /// Mirror and bent rays before it.
    depth: u32,
    /// Layers that the path has passed straight.
    layers: u32,
}

/// The waiting rays of one path. A surface replaces its ray by up to three and so adds up to two, once for each unit
/// of depth and each layer at most; the bound follows, whatever the rays weigh.
pub(crate) struct PathStack {
    segments: [Segment; PathStack::CAPACITY],
    len: usize,
}

impl PathStack {
    const CAPACITY: usize = 1 + 2 * (FrameParams::MAX_DEPTH + MAX_LAYERS) as usize;

    /// An empty stack; make one per block of pixels, not per path.
    pub(crate) fn new() -> Self {
        let unused = Segment {
            origin: Vec3::ZERO,
            direction: Vec3::ZERO,
            after: After::EYE,
            weight: Vec3::ZERO,
            depth: 0,
            layers: 0,
        };
        Self { segments: [unused; Self::CAPACITY], len: 0 }
    }

    /// Adds a ray unless its weight is nothing, or below `cutoff`; says how many were added.
    fn push(&mut self, segment: Segment, cutoff: f32) -> u64 {
        if is_cut_off(segment.weight, cutoff) {
            return 0;
        }
        self.segments[self.len] = segment;
        self.len += 1;
        1
    }

    fn pop(&mut self) -> Option<Segment> {
        self.len = self.len.checked_sub(1)?;
        Some(self.segments[self.len])
    }
}

/// What one ray from the eye sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Linear radiance, premultiplied by alpha.
    pub color: Vec3,
    /// Coverage, [0, 1].
    pub alpha: f32,
    /// The first surface that covers anything.
    pub first: Option<Hit>,
}

/// The nearest surface that is seen along `ray` behind `after`, which replaces its `t_min`: holes excepted, and backs
/// that do not show.
pub(crate) fn nearest_seen(scene: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit> {
    if scene.needs.hidden_backs {
        let shows = |hit: &Hit| scene.shows_side(hit, ray.direction) && scene.is_solid(hit);
        nearest_accepted(scene, ray, after, shows)
    } else {
        nearest(scene, ray, after)
    }
}

/// The nearest surface that is seen along `ray` and covers anything: what [`trace`] calls the first.
pub(crate) fn first_seen(scene: &Renderer<'_>, ray: &Ray) -> Option<Hit> {
    let mut after = After::EYE;
    for _ in 0..=MAX_LAYERS {
        let hit = nearest_seen(scene, ray, after)?;
        if paint_at(scene, &hit).alpha > 0.0 {
            return Some(hit);
        }
        after = After::hit(&hit);
    }
    None
}

/// The nearest surface along `ray` behind `after`, which replaces its `t_min`; holes excepted.
pub(crate) fn nearest(scene: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit> {
    if scene.needs.holes {
        nearest_accepted(scene, ray, after, |hit| scene.is_solid(hit))
    } else {
        nearest_accepted(scene, ray, after, |_| true)
    }
}

fn nearest_accepted(
    scene: &Renderer<'_>,
    ray: &Ray,
    after: After,
    accept: impl Fn(&Hit) -> bool,
) -> Option<Hit> {
    if after.triangle == Hit::NO_TRIANGLE {
        let ray = Ray { t_min: after.t, ..*ray };
        scene.tree.closest_hit(&scene.mesh, &ray, accept)
    } else {
        // Let t begin just before the last hit, so that a coincident surface is met too.
        let rest = Ray { t_min: after.t.next_down(), ..*ray };
        scene.tree.closest_hit(&scene.mesh, &rest, |hit| after.precedes(hit) && accept(hit))
    }
}

/// Follows those of eight rays from the eye whose bit is set in `lanes`, and everything behind them. The first surfaces of all
/// rays are looked for together, and so are their shadows; paths part there.
pub(crate) fn trace(
    scene: &Renderer<'_>,
    params: &FrameParams,
    eyes: &[Ray; LANES],
    lanes: u8,
    stack: &mut PathStack,
    counts: &mut RayCounts,
) -> [Seen; LANES] {
    // Find what the rays meet first, and shade it by itself.
    counts.primary += u64::from(lanes.count_ones());
    let hits = first_hits(scene, eyes, lanes);
    let mut views = [const { None }; LANES];
    for lane in lanes_in(lanes) {
        let direction = eyes[lane].direction;
        views[lane] = hits[lane].map(|hit| View::new(scene, params.features, hit, direction));
    }
    let lights = local_lights(scene, params, &views, counts);

    // Follow each path from there.
    let mut seen = [Seen { color: Vec3::ZERO, alpha: 1.0, first: None }; LANES];
    for lane in lanes_in(lanes) {
        let Ray { origin, direction, .. } = eyes[lane];
        let (after, weight) = (After::EYE, Vec3::ONE);
        let mut path = Path { scene, params, seen: &mut seen[lane], stack, counts, tracer: &mut Direct };
        path.stack.len = 0;
        let segment = Segment { origin, direction, after, weight, depth: 0, layers: 0 };
        match &views[lane] {
            None => path.leave(&segment),
            Some(view) => path.meet(&segment, view, lights[lane]),
        }
        path.follow();
    }
    seen
}

/// Follows `eye` and everything behind it ray by ray, with `tracer`: what [`trace`] sees along that ray, and the same rays in one order.
pub(crate) fn trace_singly(
    scene: &Renderer<'_>,
    params: &FrameParams,
    eye: &Ray,
    counts: &mut RayCounts,
    tracer: &mut impl Tracer,
) -> Seen {
    counts.primary += 1;
    let mut seen = Seen { color: Vec3::ZERO, alpha: 1.0, first: None };
    let mut stack = PathStack::new();
    let Ray { origin, direction, .. } = *eye;
    let (after, weight) = (After::EYE, Vec3::ONE);
    stack.push(Segment { origin, direction, after, weight, depth: 0, layers: 0 }, params.sampling.cutoff);
    Path { scene, params, seen: &mut seen, stack: &mut stack, counts, tracer }.follow();
    seen
}

/// [`nearest_seen`] along rays from the eye.
fn first_hits(scene: &Renderer<'_>, eyes: &[Ray; LANES], lanes: u8) -> [Option<Hit>; LANES] {
    let (tree, mesh, kernel) = (&scene.tree, &scene.mesh, scene.kernel);
    if scene.needs.hidden_backs {
        let shows =
            |lane: usize, hit: &Hit| scene.shows_side(hit, eyes[lane].direction) && scene.is_solid(hit);
        tree.closest_hits_where(kernel, mesh, eyes, lanes, shows)
    } else if scene.needs.holes {
        tree.closest_hits_where(kernel, mesh, eyes, lanes, |_, hit| scene.is_solid(hit))
    } else {
        tree.closest_hits(kernel, mesh, eyes, lanes)
    }
}

/// One path on its way.
struct Path<'a, 'p, T> {
    scene: &'a Renderer<'p>,
    params: &'a FrameParams,
    seen: &'a mut Seen,
    stack: &'a mut PathStack,
    counts: &'a mut RayCounts,
    tracer: &'a mut T,
}

impl<T: Tracer> Path<'_, '_, T> {
    /// Traces the rays that wait, and those behind them.
    fn follow(&mut self) {
        let (scene, params) = (self.scene, self.params);
        while let Some(mut segment) = self.stack.pop() {
            let Segment { origin, direction, after, weight, .. } = segment;
            let mut ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
            let hit = self.tracer.look(scene, &mut ray, after);
            let direction = ray.direction;
            (segment.origin, segment.direction) = (ray.origin, direction);
            let Some(hit) = hit else {
                self.leave(&segment);
                continue;
            };
            let view = View::new(scene, params.features, hit, direction);
            self.tracer.met(scene, &ray, &view);
            let is_covered = weight * view.alpha != Vec3::ZERO;
            let light = if is_covered {
                local_light(scene, params, &view, self.counts, self.tracer)
            } else {
                Vec3::ZERO
            };
            self.meet(&segment, &view, light);
        }
    }

    /// The ray of `segment` meets nothing: it sees what lies behind everything. Where nothing bent it, nothing covers the pixel.
    fn leave(&mut self, &Segment { direction, weight, depth, .. }: &Segment) {
        self.seen.color += weight * self.scene.backdrop.radiance(direction);
        if depth == 0 && self.scene.backdrop.is_none() {
            self.seen.alpha = 1.0 - weight.max_element();
        }
    }

    /// The ray of `segment` meets a surface whose own light is `light`.
    fn meet(&mut self, &segment: &Segment, view: &View, light: Vec3) {
        // What covers nothing is not the surface that is seen.
        let Segment { direction, weight, depth, layers, .. } = segment;
        let View { hit, surface, alpha, terms, .. } = view;
        if depth == 0 && self.seen.first.is_none() && *alpha > 0.0 {
            self.seen.first = Some(*hit);
        }
        let covered = weight * *alpha;
        if covered != Vec3::ZERO {
            self.seen.color += covered * light;
        }

        // Go straight on past the uncovered part and through unbent glass.
        let mut straight = weight * (1.0 - alpha);
        if terms.passage == Passage::Straight {
            straight += covered * terms.passed;
        }
        if layers < MAX_LAYERS {
            let after = After::hit(hit);
            let on = Segment { after, weight: straight, layers: layers + 1, ..segment };
            self.counts.refraction += self.push(on, Way::On);
        }
        let depth_met = if is_on(Mutation::DepthOffByOne) { depth.saturating_sub(1) } else { depth };
        if depth_met >= self.params.max_depth.min(FrameParams::MAX_DEPTH) {
            return;
        }

        // Go through bent glass.
        let after = After::start(clearance(surface));
        let ray = Segment { after, depth: depth + 1, ..segment };
        if let Passage::Bent(bent) = terms.passage {
            let origin = offset_origin(surface, -surface.facing);
            let weight = covered * terms.passed;
            let bent = Segment { origin, direction: bent, weight, ..ray };
            self.counts.refraction += self.push(bent, Way::Bent);
        }

        // Follow the mirror.
        if terms.mirror != Vec3::ZERO {
            let origin = offset_origin(surface, surface.facing);
            let direction = reflect(direction, surface);
            let weight = covered * terms.mirror;
            let mirrored = Segment { origin, direction, weight, ..ray };
            self.counts.reflection += self.push(mirrored, Way::Mirror);
        }
    }

    /// [`PathStack::push`].
    fn push(&mut self, segment: Segment, way: Way) -> u64 {
        let pushed = self.stack.push(segment, self.params.sampling.cutoff);
        self.tracer.pushed(way, segment.weight.max_element(), pushed > 0);
        pushed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::{Stage, glass, look};
    use crate::variant::Variant;
    use crate::{PixelFormat, Sampling};
    use tessera_pack::{Material, MaterialFlags};

    /// Two veils of glass face each other, and the ray from the eye runs between them: every surface that it meets has three rays behind it.
    /// Those that leave the gap see nothing, so that the whole tree is followed, and the mirrored one, which is taken up first, leaves two
    /// waiting at every unit of depth. No path has more, for a straight ray is taken up last, with nothing of its surface beside it.
    #[test]
    fn the_stack_holds_all_that_waits_when_nothing_is_cut_off() {
        // An index of 20 reflects (19 / 21)^2 = 82 %: half of that is left of the weight, 2^-41 after 32 mirrors.
        let veil = Material {
            base_color: [1.0, 1.0, 1.0, 0.5],
            flags: glass(20.0).flags | MaterialFlags::ALPHA_BLEND,
            ..glass(20.0)
        };
        let mut stage = Stage::default();
        stage.quad([-5.0, -5.0, -1.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], veil);
        stage.quad([-5.0, -5.0, 1.0], [0.0, 10.0, 0.0], [10.0, 0.0, 0.0], veil);
        let pack = stage.pack();
        let scene = Renderer::new(&pack);
        for max_depth in [0, 1, 8, FrameParams::MAX_DEPTH] {
            let sampling = Sampling { cutoff: 0.0, ..Sampling::default() };
            let view = crate::stage::View { sampling, max_depth, ..look([0.1, 0.2, 0.0], [0.1, 0.2, -1.0]) };
            let params = view.params(&pack, PixelFormat::Rgba8);
            let (origin, direction) = (params.camera.origin, params.camera.forward);
            let eye = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
            let (mut stack, mut counts) = (PathStack::new(), RayCounts::default());
            trace(&scene, &params, &[eye; LANES], 1, &mut stack, &mut counts);
            assert_eq!(
                (counts.reflection, counts.refraction),
                (u64::from(max_depth), u64::from(2 * max_depth + 1)),
                "one mirrored ray and one through glass a surface; a straight one, at the last too"
            );

            // A place that was never taken has the weight of an empty stack, 0. The first surface's own ray never waits.
            let peak = stack.segments.iter().filter(|segment| segment.weight != Vec3::ZERO).count();
            assert_eq!(peak, (2 * max_depth + 1) as usize, "depth {max_depth}");
            assert_eq!(peak, Variant::of(&pack).path_stack(max_depth) as usize, "what a GPU reserves");
            assert!(peak <= PathStack::CAPACITY);
        }
    }
}
