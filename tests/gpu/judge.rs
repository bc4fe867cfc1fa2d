//! Whether two renderers that took different triangles are both right within rounding.
//!
//! A difference is explained ray by ray, along the *other's* path ([`tessera_whitted::replay`]), so that no error adds up:
//!
//! 1. The other's ray must be the one that the CPU makes of the other's hits before, within the rounding of the arithmetic between: else something that was decided on
//!    the way must have been within its own rounding.
//! 2. On that very ray the other must have met what the CPU meets, or what lies between the two answers must be excused: a triangle whose edge passes the
//!    ray within the lateral error of the triangle test, one at the end of the ray's range, or one whose mask or side is decided by rounding. Two hits whose
//!    distances differ by less than the bound of both are one.
//!
//! Whatever else differs is a fault.

use crate::kinds::truth;
use std::fmt;
use tessera_geometry::rounding::UNIT_ROUNDOFF;
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_kdtree::Triangles;
use tessera_pack::Pack;
use tessera_whitted::replay::{OTHER_LATERAL_ERROR, Step, Verdict, weights_near};
use tessera_whitted::{FrameParams, Probe, Renderer};

/// How far a reported distance may be from that of the exact ray and triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TBound {
    /// Share of the distance.
    pub relative: f64,
    /// Whether the point may lie beside the ray by the lateral error, and so farther or nearer where the plane is steep.
    pub is_lateral: bool,
}

impl TBound {
    /// With `f64`: the same operations as on the CPU, whose result is rounded once. Two roundoffs, should an operation be fused.
    pub const DOUBLE: Self = Self { relative: 1.0 / 8_388_608.0, is_lateral: false };

    /// Without: a distance from three weighed depths, each with a shear, two products, a sum and a division of 5 roundoffs; 64 roundoffs together. And
    /// wherever the lateral error takes it, and weights that are off by the rounding of edge functions.
    pub const SINGLE: Self = Self { relative: 1.0 / 262_144.0, is_lateral: true };

    /// For the triangle that `sight` is of.
    pub fn allows(&self, sight: &Sight) -> f64 {
        let rounded = self.relative * sight.t.abs() + sight.rounding;
        // No point of the triangle is before its nearest corner or behind its farthest.
        if self.is_lateral { rounded + sight.slide.min(sight.depth) } else { rounded }
    }
}

/// One triangle, seen along one ray, in `f64`.
pub struct Sight {
    /// Whether the ray crosses it.
    is_inside: bool,
    /// Distance of the ray from its edges, in units of [`truth::Truth::to_edges`].
    to_edges: f64,
    /// Distance of its plane, held to that of its corners.
    pub t: f64,
    /// From its nearest corner to its farthest, as `t`.
    depth: f64,
    /// How far `f64` may be off where the distance comes out of differences of large numbers: at the ray's own origin nothing else is left of it.
    rounding: f64,
    /// How far along the ray the lateral error moves a point of its plane, and the error of weights one of the triangle.
    slide: f64,
}

impl Sight {
    pub fn new(ray: &Ray, vertices: [Vec3; 3]) -> Self {
        // Before the origin too: a surface that rounding puts just behind it may lie just before it.
        let whole = Ray { t_min: f32::NEG_INFINITY, t_max: f32::INFINITY, ..*ray };
        let truth = truth::judge(&whole, vertices);
        let [a, b, c] = vertices.map(|v| v.as_dvec3() - ray.origin.as_dvec3());
        let direction = ray.direction.as_dvec3();
        let length = direction.length();
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        let along = [a, b, c].map(|p| p.dot(direction) / (length * length));
        let near = along.iter().copied().fold(f64::INFINITY, f64::min);
        let far = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let normal = (b - a).cross(c - a);
        let t = normal.dot(a) / normal.dot(direction);
        let slope = normal.dot(direction).abs() / (normal.length() * length);
        // Twice: along two axes, and from a point at equal depth to one of the plane.
        let slide = 2.0 * f64::from(OTHER_LATERAL_ERROR) * reach / (slope * length);
        // Edge functions are off by 6 roundoffs of the longest edge squared, weights by that over the area as the ray sees it; three corners' depths are weighed.
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        let weights = 18.0 * f64::from(UNIT_ROUNDOFF) * longest * longest / (normal.length() * slope);
        let slide = slide + weights * (far - near);
        // The normal is off by 2 roundoffs of two edges' product in each of three components, its product with a corner by 3 more: 16 cover them, twice.
        let rounding = 16.0 * f64::EPSILON * longest * longest * reach / (normal.length() * slope * length);
        Self {
            rounding: if rounding.is_finite() { rounding } else { 0.0 },
            is_inside: truth.t.is_some(),
            to_edges: truth.to_edges,
            t: if t.is_finite() { t.clamp(near, far) } else { near },
            depth: far - near,
            slide: if slide.is_nan() { f64::INFINITY } else { slide },
        }
    }

    /// Whether rounding decides if the ray meets it.
    fn is_grazed(&self) -> bool {
        self.to_edges <= f64::from(OTHER_LATERAL_ERROR)
    }
}

/// What is asked about a ray: by the shading of a scene, or of bare triangles.
pub trait Rules {
    /// The CPU's answer.
    fn answer(&self, probe: &Probe) -> Probe;

    /// Whether a triangle counts.
    fn verdict(&self, probe: &Probe, hit: &Hit) -> Verdict;
}

impl Rules for Renderer<'_> {
    fn answer(&self, probe: &Probe) -> Probe {
        Renderer::answer(self, probe)
    }

    fn verdict(&self, probe: &Probe, hit: &Hit) -> Verdict {
        Renderer::verdict(self, probe, hit)
    }
}

/// Every triangle counts.
pub struct Bare<'a>(pub &'a Pack);

impl Rules for Bare<'_> {
    fn answer(&self, probe: &Probe) -> Probe {
        let after = (probe.t_min, probe.after_triangle);
        // As after a surface, so that the coincident one behind it is met too.
        let start =
            if probe.after_triangle == Hit::NO_TRIANGLE { probe.t_min } else { probe.t_min.next_down() };
        let ray = Ray { t_min: start, ..probe.ray() };
        let is_behind = |hit: &Hit| (hit.t, hit.triangle) > after || after.1 == Hit::NO_TRIANGLE;
        match self.0.tree().closest_hit(&self.0.mesh(), &ray, is_behind) {
            Some(Hit { t, triangle, .. }) => Probe { t, triangle, ..*probe },
            None => Probe { t: 0.0, triangle: Hit::NO_TRIANGLE, ..*probe },
        }
    }

    fn verdict(&self, _: &Probe, _: &Hit) -> Verdict {
        Verdict { counts: true, margin: f32::INFINITY }
    }
}

/// Why two answers differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// The rays differ by rounding; on the other's ray the CPU agrees.
    Ray,
    /// The ray passes an edge within the lateral error of the triangle test.
    Edge,
    /// Two hits at one distance.
    Tie,
    /// A hit at the beginning or the end of the ray's range.
    Range,
    /// A mask's alpha at its cut-off, or a side seen edge-on.
    Material,
    /// Something that was decided before: the side of a light, a weight at the cut-off, glass at total reflection.
    Decision,
    /// A fault: the other's ray is another one.
    WrongRay,
    /// A fault: the other's triangle is not where its ray is.
    NotThere,
    /// A fault: it is there, at another distance.
    WrongDistance,
    /// A fault: it does not count for this ray, or lies outside its range.
    NotAllowed,
    /// A fault: the other passed a triangle.
    Missed,
    /// A fault: there is another number or kind of rays.
    WrongRays,
}

impl Why {
    /// Whether rounding may do it.
    pub fn is_explained(self) -> bool {
        matches!(self, Self::Ray | Self::Edge | Self::Tie | Self::Range | Self::Material | Self::Decision)
    }
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ray => "the ray, within rounding",
            Self::Edge => "an edge",
            Self::Tie => "one distance",
            Self::Range => "an end of the range",
            Self::Material => "a mask or side",
            Self::Decision => "a decision before",
            Self::WrongRay => "UNEXPLAINED: another ray",
            Self::NotThere => "UNEXPLAINED: not there",
            Self::WrongDistance => "UNEXPLAINED: wrong distance",
            Self::NotAllowed => "UNEXPLAINED: does not count",
            Self::Missed => "UNEXPLAINED: missed a triangle",
            Self::WrongRays => "UNEXPLAINED: other rays",
        })
    }
}

/// One difference, as a line of a table ([`Finding::HEAD`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Column and row, or the number of a ray and 0.
    pub pixel: (u32, u32),
    /// Place in the path where it comes from.
    pub step: usize,
    /// [`Probe::kind`] there.
    pub kind: u32,
    /// What the CPU meets on the other's ray.
    pub own: (u32, f32),
    /// What the other met.
    pub other: (u32, f32),
    /// How far the distances may be apart: the sum of both bounds.
    pub bound: f64,
    /// How far the rays are apart, in their bounds.
    pub ray: f64,
    /// Why.
    pub why: Why,
    /// Whether all is the same but behind two or more mirrors and bent rays: what parts a path by a digit grows with each of them.
    pub is_deep: bool,
}

impl Finding {
    /// Names of the columns.
    pub const HEAD: &str =
        "     pixel  step kind         own at                other at                bound    ray  why";
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pixel: (x, y), step, own, other, bound, ray, why, is_deep, .. } = self;
        let deep = if *is_deep { ", deep" } else { "" };
        let kind = ["look", "dark", "veil"].get(self.kind as usize).unwrap_or(&"?");
        let id = |id: u32| if id == Hit::NO_TRIANGLE { "-".to_owned() } else { id.to_string() };
        write!(
            f,
            "{x:>5},{y:>4} {step:>5} {kind} {:>8} {:<14} {:>8} {:<14} {bound:>9.3e} {ray:>6.2}  {why}{deep}",
            id(own.0),
            own.1,
            id(other.0),
            other.1
        )
    }
}

/// Follows the `other` renderer's rays of a sample and says why they are not `own`, the CPU's; `None` when both took the same triangles
/// on rays that are within rounding of each other.
pub fn judge(
    (renderer, pack): (&Renderer<'_>, &Pack),
    params: &FrameParams,
    ((x, y), sample): ((u32, u32), u32),
    (own, other): (&[Probe], &[Probe]),
    bound: TBound,
) -> Option<Finding> {
    let replay = renderer.replay(params, x, y, sample, other);
    let mut first = None;
    let is_deep = replay.is_whole && {
        let shallow = |steps: &[Step]| -> Vec<_> {
            steps.iter().filter(|step| step.depth < 2).map(|s| (s.other.kind, s.other.triangle)).collect()
        };
        shallow(&replay.steps) == shallow(&renderer.replay(params, x, y, sample, own).steps)
    };
    for (at, step) in replay.steps.iter().enumerate() {
        let ray = step.bound.share(&step.own, &step.other);
        let answer = renderer.answer(&step.other);
        let finding = |why, bound| Finding {
            pixel: (x, y),
            step: at,
            kind: step.other.kind,
            own: (answer.triangle, answer.t),
            other: (step.other.triangle, step.other.t),
            bound,
            ray,
            why,
            is_deep,
        };
        // Nothing can be followed behind another ray.
        if ray.is_nan() || ray > 1.0 {
            let why = if step.margin <= 1.0 { Why::Decision } else { Why::WrongRay };
            return Some(finding(why, 0.0));
        }
        if let Some((why, bound)) = differ((renderer, pack), &step.other, &answer, bound) {
            let finding = finding(why, bound);
            if !why.is_explained() {
                return Some(finding);
            }
            first.get_or_insert(finding);
        }
    }

    // Name the place of the first difference.
    let kinds = |rays: &[Probe]| rays.iter().map(|ray| (ray.kind, ray.triangle)).collect::<Vec<_>>();
    let (own_took, other_took) = (kinds(own), kinds(other));
    if replay.is_whole && own_took == other_took {
        return None;
    }
    let nothing = Probe { triangle: Hit::NO_TRIANGLE, ..bytemuck::Zeroable::zeroed() };
    let place = |at: usize| {
        let [a, b] = [own, other].map(|rays| rays.get(at).copied().unwrap_or(nothing));
        let ray = replay.steps.get(at).map_or(f64::NAN, |step| step.bound.share(&step.own, &step.other));
        let (own, other) = ((a.triangle, a.t), (b.triangle, b.t));
        let (pixel, kind, bound, why) = ((x, y), b.kind, 0.0, Why::Ray);
        Finding { pixel, step: at, kind, own, other, bound, ray, why, is_deep }
    };
    if !replay.is_whole {
        let why = if replay.margin <= 1.0 { Why::Decision } else { Why::WrongRays };
        return Some(Finding { why, ..place(replay.steps.len()) });
    }
    let at = own_took.iter().zip(&other_took).take_while(|(a, b)| a == b).count();
    Some(first.unwrap_or_else(|| place(at)))
}

/// Why the other's answer to its own ray is not the CPU's `answer` to it, and the bound of their distance; `None` when it is.
pub fn differ(
    (rules, triangles): (&impl Rules, &Pack),
    other: &Probe,
    answer: &Probe,
    bound: TBound,
) -> Option<(Why, f64)> {
    let mesh = triangles.mesh();
    let ray = other.ray();
    if other.kind == Probe::OPAQUE {
        if other.is_hit() == answer.is_hit() {
            return None;
        }
        let why = if answer.is_hit() {
            all_blockers_excused((rules, triangles), other, bound)
        } else {
            some_blocker_excused((rules, triangles), other, bound)
        };
        return Some((why, 0.0));
    }

    // The other's hit must be one.
    let sight_of = |probe: &Probe| Sight::new(&ray, mesh.vertices(probe.triangle));
    if other.is_hit() && other.triangle >= triangles.triangle_count() {
        return Some((Why::NotThere, 0.0));
    }
    let others = other.is_hit().then(|| sight_of(other));
    let others_bound = others.as_ref().map_or(0.0, |sight| bound.allows(sight));
    if let Some(sight) = &others {
        let is_same = answer.triangle == other.triangle;
        if !is_same && !sight.is_inside && !sight.is_grazed() {
            return Some((Why::NotThere, others_bound));
        }
        // (The CPU's distance of a grazed triangle is that of its edge, the plane may be elsewhere.)
        let exact = if is_same { f64::from(answer.t) } else { sight.t };
        let off = (f64::from(other.t) - exact).abs();
        if off.is_nan() || off > others_bound {
            return Some((Why::WrongDistance, others_bound));
        }
        if is_same {
            return None;
        }
        let verdict = rules.verdict(other, &hit_of(other, &ray, &mesh));
        let is_behind = (other.t, other.triangle) > (other.t_min, other.after_triangle)
            || (other.after_triangle == Hit::NO_TRIANGLE && other.t > other.t_min);
        if !(verdict.counts || verdict.margin <= 1.0) || !is_behind || other.t > other.t_max {
            return Some((Why::NotAllowed, others_bound));
        }
    } else if !answer.is_hit() {
        return None;
    }

    // Pass what the CPU meets before it, each with an excuse.
    let mut at = *answer;
    let mut excuse = None;
    for _ in 0..1000 {
        if at.is_hit() {
            let sight = sight_of(&at);
            let both = others_bound + bound.allows(&sight);
            if at.triangle == other.triangle {
                return Some((excuse.unwrap_or(Why::Tie), both));
            }
            let ahead = f64::from(other.t) - f64::from(at.t);
            if other.is_hit() && ahead.abs() <= both {
                return Some((excuse.unwrap_or(Why::Tie), both));
            }
            if !other.is_hit() || ahead > 0.0 {
                match excused(rules, other, &at, &sight, &hit_of(&at, &ray, &mesh), bound) {
                    Some(why) => excuse = excuse.or(Some(why)),
                    None => return Some((Why::Missed, both)),
                }
                at = rules.answer(&Probe { t_min: at.t, after_triangle: at.triangle, ..*other });
                continue;
            }
        }
        // Nothing more comes before the other's hit, which the CPU does not have.
        return Some(match &others {
            None => (excuse.unwrap_or(Why::Missed), 0.0),
            Some(sight) => {
                let hit = hit_of(other, &ray, &mesh);
                let why = excused(rules, other, other, sight, &hit, bound);
                (why.unwrap_or(Why::NotThere), others_bound)
            }
        });
    }
    Some((Why::Missed, others_bound))
}

/// Why one may meet `hit` on the ray of `probe` and the other not.
fn excused(
    rules: &impl Rules,
    probe: &Probe,
    at: &Probe,
    sight: &Sight,
    hit: &Hit,
    bound: TBound,
) -> Option<Why> {
    let verdict = rules.verdict(probe, hit);
    let (t, allowed) = (f64::from(at.t), bound.allows(sight));
    let ends = [probe.t_min, probe.t_max].map(f64::from);
    if sight.is_grazed() {
        Some(Why::Edge)
    } else if verdict.margin <= 1.0 {
        Some(Why::Material)
    } else if ends.iter().any(|end| (end - t).abs() <= allowed) {
        Some(Why::Range)
    } else {
        None
    }
}

fn hit_of(probe: &Probe, ray: &Ray, mesh: &impl Triangles) -> Hit {
    let (b1, b2) = weights_near(ray, mesh.vertices(probe.triangle));
    Hit { t: probe.t, triangle: probe.triangle, b1, b2 }
}

/// The CPU finds a light blocked and the other does not: everything opaque on the way must be excused.
fn all_blockers_excused((rules, pack): (&impl Rules, &Pack), probe: &Probe, bound: TBound) -> Why {
    let (mesh, ray) = (pack.mesh(), probe.ray());
    let mut layer = Probe { kind: Probe::LAYER, ..*probe };
    let mut why = None;
    for _ in 0..1000 {
        let at = rules.answer(&layer);
        if !at.is_hit() {
            return why.unwrap_or(Why::Missed);
        }
        let hit = hit_of(&at, &ray, &mesh);
        if rules.verdict(probe, &hit).counts {
            let sight = Sight::new(&ray, mesh.vertices(at.triangle));
            match excused(rules, probe, &at, &sight, &hit, bound) {
                Some(excuse) => why = why.or(Some(excuse)),
                None => return Why::Missed,
            }
        }
        (layer.t_min, layer.after_triangle) = (at.t, at.triangle);
    }
    Why::Missed
}

/// The other finds a light blocked and the CPU does not: there must be something opaque that rounding may put there. Every triangle is looked at.
fn some_blocker_excused((rules, pack): (&impl Rules, &Pack), probe: &Probe, bound: TBound) -> Why {
    let (mesh, ray) = (pack.mesh(), probe.ray());
    (0..pack.triangle_count())
        .find_map(|id| {
            let sight = Sight::new(&ray, mesh.vertices(id));
            let allowed = bound.allows(&sight);
            let is_on_ray = sight.is_inside || sight.is_grazed();
            let range = f64::from(probe.t_min) - allowed..=f64::from(probe.t_max) + allowed;
            if !is_on_ray || !range.contains(&sight.t) {
                return None;
            }
            let at = Probe { triangle: id, t: sight.t as f32, ..*probe };
            let hit = hit_of(&at, &ray, &mesh);
            let verdict = rules.verdict(probe, &hit);
            if verdict.counts || verdict.margin <= 1.0 {
                excused(rules, probe, &at, &sight, &hit, bound)
            } else {
                None
            }
        })
        .unwrap_or(Why::NotThere)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::{Stage, View, chalk, look, point_light};
    use tessera_pack::{Material, MaterialFlags};
    use tessera_whitted::PixelFormat;

    /// Whatever `wrong` makes of the rays of the only pixel of `view`.
    fn finding(stage: &Stage, view: View, wrong: impl FnOnce(&mut Vec<Probe>)) -> Option<Finding> {
        let pack = stage.clone().pack();
        let renderer = Renderer::new(&pack);
        let params = view.params(&pack, PixelFormat::Layers);
        let own = renderer.probe(&params, 0, 0, 0);
        let mut other = own.clone();
        wrong(&mut other);
        judge((&renderer, &pack), &params, ((0, 0), 0), (&own, &other), TBound::SINGLE)
    }

    fn why(stage: &Stage, view: View, wrong: impl FnOnce(&mut Vec<Probe>)) -> Why {
        finding(stage, view, wrong).expect("a difference").why
    }

    /// A square of two triangles in z = 0 with a corner at the origin, and one behind it.
    fn squares() -> Stage {
        let mut stage = Stage::default();
        stage.quad([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], chalk());
        stage.quad([-4.0, -4.0, -1.0], [8.0, 0.0, 0.0], [0.0, 8.0, 0.0], chalk());
        stage
    }

    /// A ray along -z.
    fn down(x: f64, y: f64) -> View {
        look([x, y, 2.0], [x, y, 0.0])
    }

    #[test]
    fn what_is_wrong_is_not_explained() {
        let stage = squares();
        let (inside, behind) = (down(0.7, 0.2), down(-1.0, 0.3));
        assert_eq!(finding(&stage, inside, |_| {}), None);
        // Another triangle than the one there, at its distance; the one behind at its own.
        assert_eq!(why(&stage, inside, |rays| rays[0].triangle ^= 1), Why::NotThere);
        let seen_behind = finding(&stage, behind, |rays| rays[0].triangle ^= 1).expect("a difference");
        assert_eq!(seen_behind.why, Why::NotThere);
        let pack = stage.clone().pack();
        let params = behind.params(&pack, PixelFormat::Layers);
        let far = Renderer::new(&pack).probe(&params, 0, 0, 0)[0];
        let passes = |rays: &mut Vec<Probe>| {
            // The square behind, whose distance is half as far again.
            (rays[0].triangle, rays[0].t) = (if far.triangle == 2 { 3 } else { 2 }, far.t);
        };
        assert!(!why(&stage, inside, passes).is_explained());
        assert_eq!(
            why(&stage, inside, |rays| (rays[0].triangle, rays[0].t) = (Hit::NO_TRIANGLE, 0.0)),
            Why::Missed
        );
        let nearer = |rays: &mut Vec<Probe>| rays[0].t *= 1.0 - 1e-4;
        assert_eq!(why(&stage, inside, nearer), Why::WrongDistance);
        let turned = |rays: &mut Vec<Probe>| rays[0].direction[0] += 1e-4;
        assert_eq!(why(&stage, inside, turned), Why::WrongRay);
        let no_triangle = |rays: &mut Vec<Probe>| rays[0].triangle = 1000;
        assert!(!why(&stage, inside, no_triangle).is_explained());
        let once_more = |rays: &mut Vec<Probe>| rays.push(rays[0]);
        assert_eq!(why(&stage, inside, once_more), Why::WrongRays);
    }

    #[test]
    fn at_an_edge_either_side_is_explained_and_beside_it_none() {
        let stage = squares();
        // On the outline: seen or not. A ten-thousandth inside: seen.
        for (x, explained) in [(1.0, true), (1.0 - 1e-8, true), (1.0 - 1e-4, false)] {
            let view = down(x, 0.25);
            let pack = stage.clone().pack();
            let params = view.params(&pack, PixelFormat::Layers);
            let renderer = Renderer::new(&pack);
            let own = renderer.probe(&params, 0, 0, 0);
            // The other way about: behind what is hit, or before what is missed.
            let behind = Probe { t_min: own[0].t, after_triangle: own[0].triangle, ..own[0] };
            let mut other = own.clone();
            if own[0].triangle < 2 {
                other[0] = Probe { t_min: 0.0, after_triangle: Hit::NO_TRIANGLE, ..renderer.answer(&behind) };
            } else {
                (other[0].triangle, other[0].t) = (0, own[0].t * 2.0 / 3.0);
            }
            let found = judge((&renderer, &pack), &params, ((0, 0), 0), (&own, &other), TBound::SINGLE)
                .expect("a difference");
            assert_eq!(found.why, if explained { Why::Edge } else { Why::Missed }, "{x}: {found}");
        }
        // On the diagonal the neighbour is as good.
        assert!(why(&stage, down(0.5, 0.5), |rays| rays[0].triangle ^= 1).is_explained());
        assert!(!why(&stage, down(0.5, 0.4999), |rays| rays[0].triangle ^= 1).is_explained());
    }

    #[test]
    fn coplanar_copies_tie() {
        let mut stage = squares();
        stage.quad([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], chalk());
        let copy = |rays: &mut Vec<Probe>| rays[0].triangle += 4;
        assert_eq!(why(&stage, down(0.7, 0.2), copy), Why::Tie);
    }

    #[test]
    fn masks_and_sides_and_lights_are_explained_at_their_edges_only() {
        // Alpha falls from 1 to 0 between the texels' centres at 1/4 and 3/4; cut off at 1/2.
        let mut stage = squares();
        stage.input.textures = vec![tessera_pack::ImageInput {
            width: 2,
            height: 1,
            rgba: [255, 255, 255, 255, 255, 255, 255, 0].into(),
            ..tessera_pack::ImageInput::default()
        }];
        let masked = Material { base_texture: 0, flags: MaterialFlags::ALPHA_MASK, ..chalk() };
        stage.quad([0.0, 0.0, 0.5], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], masked);
        let hole = |rays: &mut Vec<Probe>| (rays[0].triangle, rays[0].t) = (0, rays[0].t * 4.0 / 3.0);
        assert_eq!(why(&stage, down(0.5 - 1e-6, 0.25), hole), Why::Material);
        assert_eq!(why(&stage, down(0.4, 0.25), hole), Why::Missed);

        // A light that is seen from a floor it stands in, and from one that it stands over.
        let mut stage = Stage::default();
        stage.quad([-4.0, -4.0, 0.0], [8.0, 0.0, 0.0], [0.0, 8.0, 0.0], chalk());
        for (height, explained) in [(0.0f32, true), (1.0, false)] {
            let mut stage = stage.clone();
            stage.light(point_light([3.0, 0.0, height], 9.0));
            let asks_otherwise = |rays: &mut Vec<Probe>| {
                if rays.len() > 1 {
                    rays.truncate(1);
                } else {
                    let shadow = Probe { kind: Probe::OPAQUE, t_max: 1.0, ..rays[0] };
                    rays.push(Probe { triangle: 0, t: 0.0, ..shadow });
                }
            };
            assert_eq!(why(&stage, down(0.3, 0.2), asks_otherwise).is_explained(), explained, "{height}");
        }
    }

    #[test]
    fn a_blocked_light_is_explained_where_the_blocker_is_grazed() {
        // A lamp straight above its floor; a wall whose edge the ray to it passes.
        for (x, explained) in [(0.0, true), (-0.01, false)] {
            let mut stage = Stage::default();
            stage.quad([-4.0, 0.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], chalk());
            stage.quad([x, 1.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], chalk());
            stage.light(point_light([0.0, 2.0, 0.0], 9.0));
            let view = look([1.0, 0.5, 2.0], [0.0, 0.0, 0.0]);
            let turn_over = |rays: &mut Vec<Probe>| {
                let shadow = rays.iter_mut().find(|ray| ray.kind == Probe::OPAQUE).expect("it is asked");
                shadow.triangle = if shadow.is_hit() { Hit::NO_TRIANGLE } else { 0 };
            };
            let why = why(&stage, view, turn_over);
            assert_eq!(why.is_explained(), explained, "{x}: {why}");
        }
    }
}
