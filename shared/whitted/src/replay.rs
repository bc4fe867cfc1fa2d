//! Another renderer's path, followed step by step: at each of its rays, what this renderer makes of the answers before, how far rounding may
//! part the two, and whether something that was decided on the way might as well have been decided otherwise.
//!
//! Nothing adds up along a path. Every ray is compared with the one that this renderer makes of the *other's* last hit, so that a bound covers
//! the arithmetic between two rays and no more.
//!
//! **The other's arithmetic** is that of a GPU without `f64`: `f32` with divisions and roots off by 2.5 units in the last place, sums and products
//! in any order and perhaps fused (WGSL, "Floating Point Evaluation"). `u` is the unit roundoff, 2^-24.

use crate::light;
use crate::path::{After, Way, trace_singly};
use crate::probe::{Probe, Tracer, eye_ray};
use crate::scene::{Renderer, hides_its_back};
use crate::shade::View;
use crate::surface::geometric_normal;
use crate::{FrameParams, RayCounts};
use tessera_geometry::rounding::{UNIT_ROUNDOFF, gamma};
use tessera_geometry::triangle::{RayShear, intersect};
use tessera_geometry::{DVec3, Hit, Ray, Vec3};
use tessera_kdtree::Triangles;
use tessera_pack::{Light, LightKind, MaterialFlags};

/// How far from its ray another renderer's hit may lie, in units of the largest component of a corner relative to the ray's origin, along each of the two
/// axes across the direction's main one. As [`tessera_geometry::triangle::LATERAL_ERROR`], with a shear of up to 2.5 units in the
/// last place, 5 roundoffs instead of 1: six roundoffs become ten, times the root of 2.
pub const OTHER_LATERAL_ERROR: f32 = gamma(15);

/// How far alpha may be from what this renderer computes: four bilinear weights of coordinates that are off by [`OTHER_LATERAL_ERROR`], on textures of up to
/// some hundred texels a triangle, and of 8-bit texels.
pub const ALPHA_ERROR: f32 = 1.0 / 65_536.0;

/// By what share a weight may be off: at most 33 generations of some 32 roundings each are 2^-14, and `(1 - x)^5` makes five of one.
const WEIGHT_ERROR: f32 = 1.0 / 2048.0;

/// Of one ray, what rounding may do to it: bounds of the difference of any component, and of the ends of its range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayBound {
    /// Local units.
    pub origin: f64,
    /// Of unit vectors.
    pub direction: f64,
    /// Of `t_min` and `t_max`, local units.
    pub range: f64,
}

impl RayBound {
    /// How far `b` is from `a`, in these bounds: at most 1 when rounding may have made the difference.
    pub fn share(&self, a: &Probe, b: &Probe) -> f64 {
        let apart = |a: [f32; 3], b: [f32; 3]| {
            (Vec3::from_array(a).as_dvec3() - Vec3::from_array(b).as_dvec3()).abs().max_element()
        };
        let range = |a: f32, b: f32| if a == b { 0.0 } else { (f64::from(a) - f64::from(b)).abs() };
        let share = |difference: f64, bound: f64| if difference == 0.0 { 0.0 } else { difference / bound };
        let after = if a.after_triangle == b.after_triangle { 0.0 } else { f64::INFINITY };
        share(apart(a.origin, b.origin), self.origin)
            .max(share(apart(a.direction, b.direction), self.direction))
            .max(share(range(a.t_min, b.t_min).max(range(a.t_max, b.t_max)), self.range))
            .max(after)
    }
}

/// One ray of the other's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The other's ray and answer.
    pub other: Probe,
    /// The ray that this renderer makes of the other's answers before; it has no answer.
    pub own: Probe,
    /// How far the two may be apart.
    pub bound: RayBound,
    /// How near a decision on the way here was to falling otherwise, in units of what rounding may do to it: below 1, another ray may stand here.
    pub margin: f32,
    /// Mirror and bent rays on the way here.
    pub depth: u32,
}

/// A path of the other's.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// Its rays, as far as this renderer would have traced one of that kind there.
    pub steps: Vec<Step>,
    /// Whether these are all of them and this renderer would have traced no more.
    pub is_whole: bool,
    /// [`Step::margin`] where it ends.
    pub margin: f32,
}

/// Whether a triangle on a ray counts for it, by its material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// It does.
    pub counts: bool,
    /// How near that is to being otherwise, in units of what rounding may do; below 1, it may.
    pub margin: f32,
}

impl Renderer<'_> {
    /// Follows `others`, the rays of one sample of the pixel `(x, y)` in the order of [`Renderer::probe`].
    pub fn replay(&self, params: &FrameParams, x: u32, y: u32, sample: u32, others: &[Probe]) -> Replay {
        let eye = eye_ray(params, x, y, sample);
        let mut player = Player {
            others,
            steps: Vec::with_capacity(others.len()),
            is_broken: false,
            waiting: vec![(eye_bound(params, &eye), 0)],
            cutoff: params.sampling.cutoff,
            depth: 0,
            place: Place::default(),
            towards_light: RayBound::default(),
            path_margin: f32::INFINITY,
            margin: f32::INFINITY,
        };
        trace_singly(self, params, &eye, &mut RayCounts::default(), &mut player);
        Replay {
            is_whole: !player.is_broken && player.steps.len() == others.len(),
            margin: player.margin.min(player.path_margin),
            steps: player.steps,
        }
    }

    /// Whether the triangle at `hit` counts for the ray of `probe`.
    pub fn verdict(&self, probe: &Probe, hit: &Hit) -> Verdict {
        let material = self.material(hit.triangle);
        let direction = Vec3::from_array(probe.direction);
        let mut margin = f32::INFINITY;
        if material.flags & MaterialFlags::ALPHA_MASK != 0 {
            margin = (self.mask_alpha(material, hit) - material.alpha_cutoff).abs() / ALPHA_ERROR;
        }
        let counts = match probe.kind {
            Probe::LOOK => {
                if hides_its_back(material) {
                    let corners = self.mesh.vertices(hit.triangle);
                    let cosine = direction.dot(geometric_normal(corners)).abs();
                    margin = margin.min(cosine / normal_error(corners) as f32);
                }
                self.shows_side(hit, direction) && self.is_solid(hit)
            }
            Probe::LAYER => self.is_solid(hit),
            _ => light::is_opaque(self, hit),
        };
        Verdict { counts, margin }
    }
}

/// Bound of a ray from the eye. Its origin is the camera's. Place in the image: a division (5u), a product and a difference of numbers up to 2, times the image's half axes; two
/// sums and a unit length (two more products and sums, a root and a division, 5u each) follow.
fn eye_bound(params: &FrameParams, eye: &Ray) -> RayBound {
    let camera = &params.camera;
    let depth = camera.forward.dot(eye.direction).abs() / camera.forward.length();
    // The direction before it had unit length was |forward| / depth long.
    let width = (camera.right.length() + camera.up.length()) / camera.forward.length() * depth;
    RayBound { origin: 0.0, direction: f64::from(gamma(9) * width + gamma(20)), range: 0.0 }
}

/// How far a unit normal from `f32` may be from the exact one. Differences of corners are exact or off by `u`; the products of a cross product are off
/// by `2u l^2` each for edges of length `l`, against its own length, twice the area; unit length costs as in [`eye_bound`].
fn normal_error(corners: [Vec3; 3]) -> f64 {
    let (longest, area) = sizes(corners.map(Vec3::as_dvec3));
    let u = f64::from(UNIT_ROUNDOFF);
    (f64::from(gamma(16)) + 8.0 * u * longest * longest / area).min(2.0)
}

/// Length of the longest edge, and twice the area.
fn sizes([a, b, c]: [DVec3; 3]) -> (f64, f64) {
    ((b - a).length().max((c - b).length()).max((a - c).length()), (b - a).cross(c - a).length())
}

/// What rounding may do to a hit and to what leaves from it.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    /// To the origin of the rays that leave: any component.
    origin: f64,
    /// To the geometric normal.
    facing: f64,
    /// To the shading normal.
    shading: f64,
    /// To the direction of a bent ray.
    bent: f64,
}

impl Place {
    /// Of `view`, which `ray` has met. `margin` is lowered where the other may be at total reflection and this renderer not.
    fn new(scene: &Renderer<'_>, ray: &Ray, view: &View, margin: &mut f32) -> Self {
        let u = f64::from(UNIT_ROUNDOFF);
        let indices = scene.mesh.indices(view.hit.triangle);
        let corners = indices.map(|v| scene.mesh.position(v));
        let exact = corners.map(Vec3::as_dvec3);
        let (longest, area) = sizes(exact);
        let normal = geometric_normal(corners).as_dvec3();
        let cosine = normal.dot(ray.direction.as_dvec3()).abs() / ray.direction.as_dvec3().length();
        let reach =
            exact.iter().map(|p| (*p - ray.origin.as_dvec3()).abs().max_element()).fold(0.0, f64::max);

        // The other's point lies in the triangle within the lateral error of the ray, seen under `cosine`, and this one's on the ray. Weights from f32 edge
        // functions are off by 6u l^2 over the projected area each, which moves a point by 3 l of that. No two points of a triangle are more than
        // its longest edge apart.
        let across = 2.0 * f64::from(OTHER_LATERAL_ERROR) * reach / cosine;
        let weighed = 32.0 * u * longest * longest * longest / (area * cosine);
        let slid = if cosine > 0.0 { (across + weighed).min(longest) } else { longest };
        // Both points are off by the error box, and both origins are moved by it along normals, and rounded by less.
        let box_error = f64::from(view.surface.error.max_element());
        let facing = normal_error(corners);
        let origin = slid + 6.0 * box_error;

        // Weights move the shading normal by the spread of the corners' normals over the triangle's least height.
        let mut shading = facing;
        if scene.needs.normals
            && let [Some(a), Some(b), Some(c)] = indices.map(|v| scene.mesh.normal(v))
        {
            let spread = (a - b).length().max((b - c).length()).max((c - a).length());
            let Hit { b1, b2, .. } = view.hit;
            let mixed = (a * (1.0 - b1 - b2) + b * b1 + c * b2).length().max(f32::MIN_POSITIVE);
            let weights = (slid * longest / area).min(1.0);
            shading += f64::from(gamma(16)) + 4.0 * weights * f64::from(spread / mixed);
        }

        // Glass: with c the cosine, k = 1 - eta^2 (1 - c^2) is off by 2 eta^2 of what c is off by, and its root by the root of that, or less where it is steep.
        let material = scene.material(view.hit.triangle);
        let mut bent = 0.0;
        if material.transmission > 0.0 {
            let ior = f64::from(material.ior);
            let entering = view.surface.from_front || material.flags & MaterialFlags::THIN_WALLED != 0;
            let eta = if entering { 1.0 / ior } else { ior };
            let c = -f64::from(view.direction.dot(view.surface.shading));
            let k = 1.0 - eta * eta * (1.0 - c * c);
            let k_error =
                2.0 * eta * eta * (shading + f64::from(gamma(6))) + f64::from(gamma(16)) * (1.0 + eta * eta);
            *margin = margin.min((k.abs() / k_error) as f32);
            let root_error = k_error.sqrt().min(k_error / k.max(0.0).sqrt());
            bent = 2.0 * (eta + 1.0) * (shading + f64::from(gamma(16))) + root_error;
        }
        Self { origin, facing, shading, bent }
    }
}

/// Answers with the other's answers.
struct Player<'a> {
    others: &'a [Probe],
    steps: Vec<Step>,
    /// Whether the other would have had to trace another kind of ray than it did.
    is_broken: bool,
    /// Bounds and depths of the rays on the path's stack.
    waiting: Vec<(RayBound, u32)>,
    /// Weight below which a ray is not traced.
    cutoff: f32,
    /// Of the last ray that looks.
    depth: u32,
    place: Place,
    towards_light: RayBound,
    /// Of what was decided anywhere on the path: what is pushed is traced much later.
    path_margin: f32,
    /// Of what was decided since the last ray that looks.
    margin: f32,
}

impl Player<'_> {
    /// The other's next ray, if it is of this kind.
    fn next(&mut self, own: Probe, bound: RayBound) -> Option<Probe> {
        let other = self.others.get(self.steps.len()).copied().filter(|other| other.kind == own.kind);
        if self.is_broken || other.is_none() {
            self.is_broken = true;
            return None;
        }
        let margin = self.margin.min(self.path_margin);
        let other = other?;
        self.steps.push(Step { other, own, bound, margin, depth: self.depth });
        Some(other)
    }

    /// The other's hit.
    fn hit(&mut self, scene: &Renderer<'_>, other: &Probe) -> Option<Hit> {
        if !other.is_hit() {
            return None;
        }
        if other.triangle >= scene.triangle_count() {
            self.is_broken = true;
            return None;
        }
        let (b1, b2) = weights_near(&other.ray(), scene.mesh.vertices(other.triangle));
        Some(Hit { t: other.t, triangle: other.triangle, b1, b2 })
    }
}

impl Tracer for Player<'_> {
    fn look(&mut self, scene: &Renderer<'_>, ray: &mut Ray, after: After) -> Option<Hit> {
        let (bound, depth) = self.waiting.pop().unwrap_or_default();
        self.depth = depth;
        let other = self.next(Probe::unanswered(Probe::LOOK, ray, after), bound)?;
        (ray.origin, ray.direction) = (other.origin.into(), other.direction.into());
        self.margin = f32::INFINITY;
        self.hit(scene, &other)
    }

    fn is_blocked(&mut self, _: &Renderer<'_>, ray: &Ray) -> bool {
        let own = Probe::unanswered(Probe::OPAQUE, ray, After::start(ray.t_min));
        self.next(own, self.towards_light).is_none_or(|other| other.is_hit())
    }

    fn layer(&mut self, scene: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit> {
        let other = self.next(Probe::unanswered(Probe::LAYER, ray, after), self.towards_light)?;
        self.hit(scene, &other)
    }

    fn met(&mut self, scene: &Renderer<'_>, ray: &Ray, view: &View) {
        self.place = Place::new(scene, ray, view, &mut self.path_margin);
        // What covers less than rounding may or may not be lit.
        self.margin = view.alpha / ALPHA_ERROR;
    }

    fn asked(&mut self, scene: &Renderer<'_>, view: &View, light: &Light, origin: Vec3) {
        // A directional light's ray has its direction as it is. Towards a point, the origin's error is seen from the light's distance; a root and divisions follow.
        let place = &self.place;
        let shines = Vec3::from(light.direction).as_dvec3();
        let is_directional = light.kind == LightKind::Directional as u32;
        let way = Vec3::from(light.position).as_dvec3() - origin.as_dvec3();
        let distance = way.length();
        let (towards, direction) = if is_directional {
            (-shines, 0.0)
        } else {
            (way / distance, (2.0 * place.origin / distance + f64::from(gamma(16))).min(2.0))
        };
        // Its end is some differences of the distance and the light's place away.
        let far = f64::from(Vec3::from(light.position).abs().max_element()) + distance;
        let end = if is_directional { 0.0 } else { 2.0 * place.origin + f64::from(gamma(16)) * far };
        self.towards_light = RayBound { origin: place.origin, direction, range: end.max(place.origin) };

        // It is asked where it shines on the viewer's side of both normals, in its cone and its range.
        let mut nearest = f64::INFINITY;
        for (normal, error) in [(view.surface.shading, place.shading), (view.surface.facing, place.facing)] {
            let cosine = towards.dot(normal.as_dvec3()).abs();
            nearest = nearest.min(cosine / (error + direction + f64::from(gamma(6))));
        }
        if light.kind == LightKind::Spot as u32 {
            let inside = (-towards.dot(shines) - f64::from(light.cos_outer)).abs();
            nearest = nearest.min(inside / (direction + f64::from(gamma(6))));
        }
        if !is_directional && light.range.is_finite() {
            let range = f64::from(light.range);
            let left = (distance * scene.step - range).abs();
            nearest = nearest.min(left / (2.0 * place.origin * scene.step + f64::from(gamma(32)) * range));
        }
        // (NaN for a light at the point itself, which may be seen or not.)
        self.margin = if nearest.is_nan() { 0.0 } else { self.margin.min(nearest as f32) };
    }

    fn dimmed(&mut self, left: f32) {
        self.margin = self.margin.min(cut_off_margin(left, self.cutoff));
    }

    fn pushed(&mut self, way: Way, weight: f32, is_pushed: bool) {
        self.path_margin = self.path_margin.min(cut_off_margin(weight, self.cutoff));
        if !is_pushed {
            return;
        }
        let Place { origin, shading, bent, .. } = self.place;
        let bound = match way {
            // The other's own ray and hit.
            Way::On => RayBound::default(),
            Way::Bent => RayBound { origin, direction: bent, range: origin },
            // d - 2 (d n) n moves by up to four times what n does, and once more when it is turned to its side.
            Way::Mirror => {
                RayBound { origin, direction: 8.0 * shading + f64::from(gamma(20)), range: origin }
            }
        };
        self.waiting.push((bound, self.depth + u32::from(way != Way::On)));
    }
}

/// How near a weight is to the least that is traced. With a cut-off of 0 only a weight of 0 is not, which is 0 for both.
fn cut_off_margin(weight: f32, cutoff: f32) -> f32 {
    if cutoff > 0.0 { (weight / cutoff - 1.0).abs() / WEIGHT_ERROR } else { f32::INFINITY }
}

/// Weights of corners 1 and 2 where `ray` passes a triangle, or of a point of it near there if it misses by rounding.
pub fn weights_near(ray: &Ray, vertices: [Vec3; 3]) -> (f32, f32) {
    let whole = Ray { t_min: 0.0, t_max: f32::INFINITY, ..*ray };
    if whole.is_traceable()
        && let Some(crossing) = intersect(&whole, &RayShear::new(&whole), vertices, f32::INFINITY)
    {
        return (crossing.b1, crossing.b2);
    }
    let [a, b, c] = vertices.map(|v| v.as_dvec3() - ray.origin.as_dvec3());
    let d = ray.direction.as_dvec3();
    let sides = [d.dot(b.cross(c)), d.dot(c.cross(a)), d.dot(a.cross(b))];
    let sum = sides[0] + sides[1] + sides[2];
    let [w0, w1, w2] = sides.map(|s| if sum == 0.0 { 1.0 / 3.0 } else { (s / sum).clamp(0.0, 1.0) });
    let total = (w0 + w1 + w2).max(f64::MIN_POSITIVE);
    let b1 = (w1 / total) as f32;
    (b1, ((w2 / total) as f32).min(1.0 - b1))
}
