//! Every ray of a sample's path tree, written down: how two renderers of one scene are compared where their pictures are not enough.
//!
//! A path tree has one order, that of the code that follows single rays: the ray that looks; where it meets what covers anything, for each
//! light in turn the shadow ray, first for anything opaque and then through its layers; then the next ray from the stack.

use crate::light;
use crate::path::{After, Way, nearest, nearest_seen, trace_singly};
use crate::pixel::ray_through;
use crate::sample::pixel_seed;
use crate::scene::Renderer;
use crate::shade::View;
use crate::{FrameParams, RayCounts};
use bytemuck::{Pod, Zeroable};
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_pack::Light;

/// One ray and its answer, as it lies in a GPU's memory.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Probe {
    /// Start point, local units.
    pub origin: [f32; 3],
    /// Hits come after it in the order (t, triangle), see `after_triangle`.
    pub t_min: f32,
    /// Direction.
    pub direction: [f32; 3],
    /// Hits come before it.
    pub t_max: f32,
    /// The triangle at `t_min` behind which the ray goes on; [`Hit::NO_TRIANGLE`] at a start, where hits at `t_min` are out.
    pub after_triangle: u32,
    /// [`Probe::LOOK`], [`Probe::OPAQUE`] or [`Probe::LAYER`].
    pub kind: u32,
    /// What it met; [`Hit::NO_TRIANGLE`] when nothing. 0 where anything opaque is in the way of a light.
    pub triangle: u32,
    /// Where; 0 on a miss, and towards a light.
    pub t: f32,
}

const _: () = {
    assert!(size_of::<Probe>() == 48 && align_of::<Probe>() == 4);
    assert!(
        std::mem::offset_of!(Probe, direction) == 16 && std::mem::offset_of!(Probe, after_triangle) == 32
    );
};

impl Probe {
    /// [`Probe::kind`]: from the eye, a mirror or glass, or farther along such a ray.
    pub const LOOK: u32 = 0;
    /// [`Probe::kind`]: towards a light, for anything opaque.
    pub const OPAQUE: u32 = 1;
    /// [`Probe::kind`]: towards a light, for the nearest surface that lets light through.
    pub const LAYER: u32 = 2;

    /// What `rays` took, in 32 bits: FNV-1a (Fowler, Noll, Vo) over words instead of bytes. Equal for two renderers when all rays of a
    /// sample met the same triangles.
    ///
    /// Of one ray that missed, `h = (((0x811c9dc5 ^ 0) * 0x01000193) ^ 0xffffffff) * 0x01000193`.
    pub fn signature(rays: &[Self]) -> u32 {
        rays.iter().fold(0x811c_9dc5, |hash, ray| {
            [ray.kind, ray.triangle].iter().fold(hash, |h: u32, word| (h ^ word).wrapping_mul(0x0100_0193))
        })
    }

    /// The ray itself; `t_min` is that of hits at a start.
    pub fn ray(&self) -> Ray {
        let (origin, direction) = (Vec3::from_array(self.origin), Vec3::from_array(self.direction));
        Ray { origin, direction, t_min: self.t_min, t_max: self.t_max }
    }

    /// Whether it met anything.
    pub fn is_hit(&self) -> bool {
        self.triangle != Hit::NO_TRIANGLE
    }

    fn after(&self) -> After {
        After { t: self.t_min, triangle: self.after_triangle }
    }

    /// A ray without its answer.
    pub(crate) fn unanswered(kind: u32, ray: &Ray, after: After) -> Self {
        Self {
            origin: ray.origin.to_array(),
            t_min: after.t,
            direction: ray.direction.to_array(),
            t_max: ray.t_max,
            after_triangle: after.triangle,
            kind,
            triangle: Hit::NO_TRIANGLE,
            t: 0.0,
        }
    }

    fn answered(self, hit: Option<&Hit>) -> Self {
        match hit {
            None => Self { triangle: Hit::NO_TRIANGLE, t: 0.0, ..self },
            Some(_) if self.kind == Self::OPAQUE => Self { triangle: 0, t: 0.0, ..self },
            Some(hit) => Self { triangle: hit.triangle, t: hit.t, ..self },
        }
    }
}

impl Renderer<'_> {
    /// Every ray of one sample of the pixel `(x, y)`, in order.
    pub fn probe(&self, params: &FrameParams, x: u32, y: u32, sample: u32) -> Vec<Probe> {
        self.probe_with(params, x, y, sample, |ray| self.hit(ray))
    }

    /// [`Renderer::probe`] with another kernel: `hit` says what a ray meets, of a ray for anything opaque whether that is anything.
    pub fn probe_with(
        &self,
        params: &FrameParams,
        x: u32,
        y: u32,
        sample: u32,
        hit: impl FnMut(&Probe) -> Option<Hit>,
    ) -> Vec<Probe> {
        let mut recorder = Recorder { rays: Vec::new(), hit };
        let eye = eye_ray(params, x, y, sample);
        trace_singly(self, params, &eye, &mut RayCounts::default(), &mut recorder);
        recorder.rays
    }

    /// `probe`'s ray with the answer that this renderer gives.
    pub fn answer(&self, probe: &Probe) -> Probe {
        probe.answered(self.hit(probe).as_ref())
    }

    /// What this renderer meets on the ray of `probe`; some hit when that is anything opaque on the way to a light.
    pub fn hit(&self, probe: &Probe) -> Option<Hit> {
        let ray = probe.ray();
        match probe.kind {
            Probe::LOOK => nearest_seen(self, &ray, probe.after()),
            Probe::LAYER => nearest(self, &ray, probe.after()),
            _ => light::is_blocked(self, &ray).then_some(Hit { t: 0.0, triangle: 0, b1: 0.0, b2: 0.0 }),
        }
    }
}

/// The ray from the eye of one sample.
pub(crate) fn eye_ray(params: &FrameParams, x: u32, y: u32, sample: u32) -> Ray {
    let seed = pixel_seed(params.frame, x, y);
    let offset = params.sampling.sampler.offset_in_pixel(sample, params.samples, seed);
    ray_through(params, x, y, offset)
}

/// Who traces the single rays of a path, and hears of what is decided on the way.
pub(crate) trait Tracer {
    /// [`nearest_seen`] along `ray`; whoever answers may put the ray that the path takes in its place.
    fn look(&mut self, scene: &Renderer<'_>, ray: &mut Ray, after: After) -> Option<Hit>;

    /// [`light::is_blocked`].
    fn is_blocked(&mut self, scene: &Renderer<'_>, ray: &Ray) -> bool;

    /// [`nearest`] along a shadow ray.
    fn layer(&mut self, scene: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit>;

    /// `ray` has met `view`, which now sends rays to lights and others.
    #[inline(always)]
    fn met(&mut self, _scene: &Renderer<'_>, _ray: &Ray, _view: &View) {}

    /// Whether `light` sends anything to `view` is about to be decided, from `origin`.
    #[inline(always)]
    fn asked(&mut self, _scene: &Renderer<'_>, _view: &View, _light: &Light, _origin: Vec3) {}

    /// Of the light of a shadow ray so much is left.
    #[inline(always)]
    fn dimmed(&mut self, _left: f32) {}

    /// A ray behind the last surface was put on the stack if its weight allowed it.
    #[inline(always)]
    fn pushed(&mut self, _way: Way, _weight: f32, _is_pushed: bool) {}
}

/// Nothing but tracing.
pub(crate) struct Direct;

impl Tracer for Direct {
    #[inline(always)]
    fn look(&mut self, scene: &Renderer<'_>, ray: &mut Ray, after: After) -> Option<Hit> {
        nearest_seen(scene, ray, after)
    }

    #[inline(always)]
    fn is_blocked(&mut self, scene: &Renderer<'_>, ray: &Ray) -> bool {
        light::is_blocked(scene, ray)
    }

    #[inline(always)]
    fn layer(&mut self, scene: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit> {
        nearest(scene, ray, after)
    }
}

/// Writes down what a kernel answers.
struct Recorder<H> {
    rays: Vec<Probe>,
    hit: H,
}

impl<H: FnMut(&Probe) -> Option<Hit>> Recorder<H> {
    fn ask(&mut self, kind: u32, ray: &Ray, after: After) -> Option<Hit> {
        let asked = Probe::unanswered(kind, ray, after);
        let hit = (self.hit)(&asked);
        self.rays.push(asked.answered(hit.as_ref()));
        hit
    }
}

impl<H: FnMut(&Probe) -> Option<Hit>> Tracer for Recorder<H> {
    fn look(&mut self, _: &Renderer<'_>, ray: &mut Ray, after: After) -> Option<Hit> {
        self.ask(Probe::LOOK, ray, after)
    }

    fn is_blocked(&mut self, _: &Renderer<'_>, ray: &Ray) -> bool {
        self.ask(Probe::OPAQUE, ray, After::start(ray.t_min)).is_some()
    }

    fn layer(&mut self, _: &Renderer<'_>, ray: &Ray, after: After) -> Option<Hit> {
        self.ask(Probe::LAYER, ray, after)
    }
}
