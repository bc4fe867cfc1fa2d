//! One sample: the tree of rays behind one ray from the eye.

use crate::image::RayCounts;
use crate::oracle::Oracle;
use crate::shade::{local_light, reflect, terms};
use crate::triangle::{Hit, Ray, Start};
use glam::DVec3;
use tessera_scene::Environment;

/// Surfaces that a path, or a shadow ray, passes straight; behind as many no light arrives.
pub(crate) const LAYERS_MAX: u32 = 64;

/// What one ray from the eye sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Linear radiance, premultiplied by alpha.
    pub color: DVec3,
    /// Coverage.
    pub alpha: f64,
    /// The first surface that covers anything.
    pub first: Option<Hit>,
    /// Weight of what was not traced for weighing too little.
    pub cut: f64,
}

/// What all samples of a row share.
pub(crate) struct Path<'a> {
    oracle: &'a Oracle,
    depth: u32,
    pub min_weight: f64,
    pub rays: RayCounts,
    /// Rays that wait to be traced.
    waiting: Vec<Segment>,
}

#[derive(Clone, Copy)]
struct Segment {
    ray: Ray,
    start: Start,
    weight: DVec3,
    /// Mirror and bent rays before it.
    depth: u32,
    /// Surfaces that the path has passed straight.
    layers: u32,
}

impl<'a> Path<'a> {
    pub(crate) fn new(oracle: &'a Oracle, depth: u32, min_weight: f64) -> Self {
        Self { oracle, depth, min_weight, rays: RayCounts::default(), waiting: Vec::new() }
    }

    /// The first surface along `ray` that covers anything.
    pub(crate) fn first(&mut self, ray: &Ray) -> Option<Hit> {
        self.rays.primary += 1;
        let mut start = Start::EYE;
        for _ in 0..=LAYERS_MAX {
            let hit = self.oracle.look(ray, start)?;
            if self.oracle.paint(&hit).alpha > 0.0 {
                return Some(hit);
            }
            start = Start { t: hit.t, id: hit.id, ..start };
        }
        None
    }

    /// Follows `eye` and everything behind it.
    pub(crate) fn trace(&mut self, eye: Ray) -> Seen {
        self.rays.primary += 1;
        let mut seen = Seen { color: DVec3::ZERO, alpha: 1.0, first: None, cut: 0.0 };
        let weight = DVec3::ONE;
        self.waiting.push(Segment { ray: eye, start: Start::EYE, weight, depth: 0, layers: 0 });
        while let Some(segment) = self.waiting.pop() {
            match self.oracle.look(&segment.ray, segment.start) {
                Some(hit) => self.meet(&segment, &hit, &mut seen),
                None => {
                    seen.color += segment.weight * self.oracle.backdrop(segment.ray.direction);
                    if segment.depth == 0 && self.oracle.environment == Environment::None {
                        seen.alpha = 1.0 - segment.weight.max_element();
                    }
                }
            }
        }
        seen
    }

    fn meet(&mut self, segment: &Segment, hit: &Hit, seen: &mut Seen) {
        let (oracle, direction) = (self.oracle, segment.ray.direction);
        let surface = oracle.surface(hit, direction);
        let paint = oracle.paint(hit);
        let terms = terms(&paint, &surface, direction, !oracle.without.reflection);
        if segment.depth == 0 && seen.first.is_none() && paint.alpha > 0.0 {
            seen.first = Some(*hit);
        }
        let covered = segment.weight * paint.alpha;
        if covered != DVec3::ZERO {
            seen.color += covered * local_light(oracle, self, &surface, &terms, direction);
        }

        // What does not cover lets the ray go on, and so does glass that does not bend it.
        let mut on = segment.weight * (1.0 - paint.alpha);
        if terms.bent.is_none() {
            on += covered * terms.passed;
        }
        if segment.layers < LAYERS_MAX {
            let start = Start { t: hit.t, id: hit.id, ..segment.start };
            let on = Segment { start, weight: on, layers: segment.layers + 1, ..*segment };
            self.rays.refraction += u64::from(self.push(on, seen));
        }
        if segment.depth >= self.depth {
            return;
        }
        let leave = |direction: DVec3, weight: DVec3| {
            let (ray, start) = oracle.leave(&surface, direction);
            Segment { ray, start, weight, depth: segment.depth + 1, layers: segment.layers }
        };
        if let Some(bent) = terms.bent {
            let bent = leave(bent, covered * terms.passed);
            self.rays.refraction += u64::from(self.push(bent, seen));
        }
        if terms.mirror != DVec3::ZERO {
            let mirrored = leave(reflect(direction, &surface), covered * terms.mirror);
            self.rays.reflection += u64::from(self.push(mirrored, seen));
        }
    }

    /// Whether the ray weighs enough to be traced.
    fn push(&mut self, segment: Segment, seen: &mut Seen) -> bool {
        let weight = segment.weight.max_element();
        let counts = weight >= self.min_weight && weight > 0.0;
        if counts {
            self.waiting.push(segment);
        } else {
            seen.cut += weight;
        }
        counts
    }
}
