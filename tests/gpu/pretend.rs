//! The CPU in the place of a GPU, faithful or with an error that is built in; and the harness held to both.

use super::judge::{TBound, Why};
use super::rays::single_precision;
use super::{Other, check, compare, whole};
use crate::stage::{Stage, View, chalk, directional_light, glass, look, mirror, point_light};
use rayon::prelude::*;
use tessera_geometry::{Hit, LocalCamera, Ray, Vec3};
use tessera_kdtree::Triangles;
use tessera_pack::{Material, MaterialFlags, Pack};
use tessera_whitted::{FrameParams, PixelBlock, PixelFormat, Probe, Renderer};

/// The CPU.
pub struct Cpu {
    /// By so much of its length the view is turned.
    turned: f32,
}

impl Cpu {
    /// As it is.
    pub fn faithful() -> Self {
        Self { turned: 0.0 }
    }

    /// Every ray from the eye turned by `turned`.
    pub fn nudged(turned: f32) -> Self {
        Self { turned }
    }

    fn turn(&self, direction: Vec3) -> Vec3 {
        Vec3::new(direction.x, direction.y, direction.z * (1.0 + self.turned))
    }

    fn params(&self, params: &FrameParams) -> FrameParams {
        let LocalCamera { origin, forward, right, up } = params.camera;
        let [forward, right, up] = [forward, right, up].map(|axis| self.turn(axis));
        FrameParams { camera: LocalCamera { origin, forward, right, up }, ..*params }
    }
}

impl Other for Cpu {
    fn name(&self) -> String {
        format!("CPU, turned by {:e}", self.turned)
    }

    fn t_bound(&self) -> TBound {
        TBound::DOUBLE
    }

    fn triangles_max(&self) -> u32 {
        300_000
    }

    fn frame(&self, pack: &Pack, params: &FrameParams) -> Vec<u8> {
        frame(pack, &self.params(params))
    }

    fn signatures(&self, pack: &Pack, params: &FrameParams) -> Vec<u32> {
        let (renderer, params) = (Renderer::new(pack), self.params(params));
        let count = params.width * params.height;
        let signature =
            |i: u32| Probe::signature(&renderer.probe(&params, i % params.width, i / params.width, 0));
        (0..count).into_par_iter().map(signature).collect()
    }

    fn probes(&self, pack: &Pack, params: &FrameParams, pixels: &[(u32, u32)]) -> Vec<Vec<Probe>> {
        let (renderer, params) = (Renderer::new(pack), self.params(params));
        pixels.iter().map(|&(x, y)| renderer.probe(&params, x, y, 0)).collect()
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Vec<Option<Hit>> {
        let (tree, mesh) = (pack.tree(), pack.mesh());
        rays.par_iter().map(|ray| tree.closest_hit(&mesh, ray, |_| true)).collect()
    }
}

/// What the CPU renders, row by row on all cores.
pub fn frame(pack: &Pack, params: &FrameParams) -> Vec<u8> {
    let renderer = Renderer::new(pack);
    let mut bytes = vec![0; whole(params).byte_len(params.format)];
    let row_bytes = params.width as usize * params.format.bytes_per_pixel();
    // Two rows are a packet's height.
    bytes.par_chunks_mut(2 * row_bytes).enumerate().for_each(|(i, out)| {
        let height = (out.len() / row_bytes) as u32;
        renderer.render_block(params, PixelBlock { y: 2 * i as u32, height, ..whole(params) }, out);
    });
    bytes
}

/// A mirror, glass, a veil, two lights.
pub fn small() -> (Pack, FrameParams) {
    let mut stage = Stage::default();
    let veil = Material {
        base_color: [0.2, 0.5, 0.9, 0.5],
        flags: MaterialFlags::ALPHA_BLEND | MaterialFlags::DOUBLE_SIDED,
        ..chalk()
    };
    stage.quad([-4.0, -1.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], mirror(0.7));
    stage.ball([-1.0, 0.0, 0.0], 0.9, 16, glass(1.5));
    stage.quad([0.6, -0.5, 0.9], [1.0, 0.0, -0.2], [0.0, 1.5, 0.0], veil);
    stage.cuboid([-3.5, -1.0, -3.0], [3.5, 1.0, -2.5], chalk());
    stage.light(point_light([1.0, 2.5, 2.0], 20.0));
    stage.light(directional_light([0.2, -1.0, -0.3], 1.0));
    stage.surround();
    let pack = stage.pack();
    let view: View = look([0.3, 0.6, 5.0], [0.0; 3]).sized(128, 96);
    let params = view.params(&pack, PixelFormat::Rgba8);
    (pack, params)
}

#[test]
fn a_faithful_renderer_differs_nowhere() {
    let (pack, params) = small();
    let report = compare("faithful", &pack, &params, &Cpu::faithful());
    assert_eq!((report.findings.len(), report.psnr, report.linear), (0, [None; 2], [0.0; 2]));
    check("faithful", &pack, &params, &Cpu::faithful());
}

#[test]
fn a_digit_is_explained_and_ten_thousandths_are_not() {
    let (pack, params) = small();
    check("a digit", &pack, &params, &Cpu::nudged(f32::EPSILON));

    let report = compare("a ten-thousandth", &pack, &params, &Cpu::nudged(1e-4));
    assert!(report.findings.len() > 20, "{report}");
    assert!(report.findings.iter().all(|finding| finding.why == Why::WrongRay), "{report}");
    // Also where it took the same triangles: the ray is another one.
    assert!(report.faults().len() >= 2, "{:?}", report.faults());
}

/// The CPU with the hits of a kernel that computes distances and weights in `f32`.
pub struct Single;

impl Single {
    /// `params` and rays are the CPU's; what they meet is where `f32` has it.
    fn rays(renderer: &Renderer<'_>, pack: &Pack, params: &FrameParams, (x, y): (u32, u32)) -> Vec<Probe> {
        let mesh = pack.mesh();
        renderer.probe_with(params, x, y, 0, |probe| {
            let mut hit = renderer.hit(probe)?;
            if probe.kind == Probe::OPAQUE {
                return Some(hit);
            }
            // It began where f32 had the last surface, which may be before it.
            if hit.triangle == probe.after_triangle {
                hit = renderer.hit(&Probe { t_min: hit.t, ..*probe })?;
            }
            let located = single_precision(&probe.ray(), mesh.vertices(hit.triangle));
            // Continuations go on behind the distance that was said before.
            let (t, b1, b2) = located.filter(|(t, ..)| *t > probe.t_min).unwrap_or((hit.t, hit.b1, hit.b2));
            Some(Hit { t, b1, b2, ..hit })
        })
    }
}

impl Other for Single {
    fn name(&self) -> String {
        "CPU in single precision".into()
    }

    fn t_bound(&self) -> TBound {
        TBound::SINGLE
    }

    fn triangles_max(&self) -> u32 {
        300_000
    }

    /// As the CPU's: its pictures say nothing of hits.
    fn frame(&self, pack: &Pack, params: &FrameParams) -> Vec<u8> {
        frame(pack, params)
    }

    fn signatures(&self, pack: &Pack, params: &FrameParams) -> Vec<u32> {
        let renderer = Renderer::new(pack);
        let signature = |i: u32| {
            let pixel = (i % params.width, i / params.width);
            Probe::signature(&Self::rays(&renderer, pack, params, pixel))
        };
        (0..params.width * params.height).into_par_iter().map(signature).collect()
    }

    fn probes(&self, pack: &Pack, params: &FrameParams, pixels: &[(u32, u32)]) -> Vec<Vec<Probe>> {
        let renderer = Renderer::new(pack);
        pixels.iter().map(|&pixel| Self::rays(&renderer, pack, params, pixel)).collect()
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Vec<Option<Hit>> {
        Cpu::faithful().hits(pack, rays)
    }
}

/// Origins, normals and directions that follow from single-precision hits stay within their bounds, ray by ray.
#[test]
fn paths_of_single_precision_are_explained() {
    let (pack, params) = small();
    check("single precision", &pack, &params, &Single);
}

/// Swaps the triangles of two rays of every hundredth path.
struct Confused;

impl Confused {
    fn confuse((x, y): (u32, u32), rays: &mut [Probe]) {
        if (x + 7 * y).is_multiple_of(100)
            && let Some(ray) = rays.iter_mut().find(|ray| ray.kind == Probe::LOOK && ray.is_hit())
        {
            ray.triangle ^= 1;
        }
    }
}

impl Other for Confused {
    fn name(&self) -> String {
        "confused".into()
    }

    fn t_bound(&self) -> TBound {
        TBound::SINGLE
    }

    fn triangles_max(&self) -> u32 {
        300_000
    }

    fn frame(&self, pack: &Pack, params: &FrameParams) -> Vec<u8> {
        frame(pack, params)
    }

    fn signatures(&self, pack: &Pack, params: &FrameParams) -> Vec<u32> {
        let pixels: Vec<_> =
            (0..params.height).flat_map(|y| (0..params.width).map(move |x| (x, y))).collect();
        self.probes(pack, params, &pixels).iter().map(|rays| Probe::signature(rays)).collect()
    }

    fn probes(&self, pack: &Pack, params: &FrameParams, pixels: &[(u32, u32)]) -> Vec<Vec<Probe>> {
        let mut probes = Cpu::faithful().probes(pack, params, pixels);
        probes.iter_mut().zip(pixels).for_each(|(rays, &pixel)| Self::confuse(pixel, rays));
        probes
    }

    fn hits(&self, _: &Pack, rays: &[Ray]) -> Vec<Option<Hit>> {
        vec![None; rays.len()]
    }
}

#[test]
fn a_wrong_triangle_is_a_fault() {
    let (pack, params) = small();
    let report = compare("confused", &pack, &params, &Confused);
    assert!(report.findings.len() > 60, "{report}");
    let unexplained = report.findings.iter().filter(|finding| !finding.why.is_explained()).count();
    // But for rays at the very edge of the two.
    assert!(unexplained * 100 >= report.findings.len() * 98, "{report}");
    assert!(report.findings.iter().any(|finding| finding.why == Why::NotThere), "{report}");
}
