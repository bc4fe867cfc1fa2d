//! Single rays: those of [`crate::rays`], kind and unkind, and those of [`crate::leaks`], which must not slip through.

use super::judge::{Bare, Finding, Sight, TBound, differ};
use super::{Other, with_every};
use crate::kinds::{Random, Soup, split_planes, unkind_ray};
use crate::leaks::{Sharing, aimed, meshes, prepare};
use crate::rays::Subject;
use crate::support::scene_folder;
use std::time::Duration;
use tessera_geometry::rounding::UNIT_ROUNDOFF;
use tessera_geometry::{CameraPose, Hit, Ray};
use tessera_kdtree::Triangles;
use tessera_master::prepare::{PrepareOptions, prepare_scene};
use tessera_pack::Pack;
use tessera_scene::generate::{Kind, Recipe, generate};
use tessera_scene::{LoadOptions, Scene};
use tessera_whitted::{FrameParams, Probe};

/// Rays a scene.
const RAYS: usize = 100_000;

/// Rays at edges and vertices, in all.
const AIMED: usize = 1_000_000;

/// `ray` as one that looks, answered with `hit`.
pub fn probe_of(ray: &Ray, hit: Option<&Hit>) -> Probe {
    Probe {
        origin: ray.origin.to_array(),
        t_min: ray.t_min,
        direction: ray.direction.to_array(),
        t_max: ray.t_max,
        after_triangle: Hit::NO_TRIANGLE,
        kind: Probe::LOOK,
        triangle: hit.map_or(Hit::NO_TRIANGLE, |hit| hit.triangle),
        t: hit.map_or(0.0, |hit| hit.t),
    }
}

/// How many distances differ by so many roundoffs: 0, 1, 2, up to 4, 8 and so on.
#[derive(Default)]
struct Histogram([usize; 20]);

impl Histogram {
    fn add(&mut self, a: f32, b: f32) {
        let off = (f64::from(a) - f64::from(b)).abs() / (f64::from(a.abs()) * f64::from(UNIT_ROUNDOFF));
        let class = if a == b { 0 } else { 1 + libm::log2(off.max(1.0)).ceil() as usize };
        self.0[class.min(19)] += 1;
    }
}

impl std::fmt::Display for Histogram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "distances off by roundoffs:")?;
        for (class, count) in self.0.iter().enumerate().filter(|(_, count)| **count > 0) {
            match class {
                0 => write!(f, " none {count}")?,
                19 => write!(f, ", more {count}")?,
                class => write!(f, ", up to {} {count}", 1 << (class - 1))?,
            }
        }
        Ok(())
    }
}

/// Holds the hits of `rays` to the CPU's: equal, or explained.
pub fn check_rays(name: &str, pack: &Pack, rays: &[Ray], other: &dyn Other) {
    let (tree, mesh) = (pack.tree(), pack.mesh());
    let hits = other.hits(pack, rays);
    assert_eq!(hits.len(), rays.len(), "{name}: an answer a ray");
    let mut histogram = Histogram::default();
    let mut findings = Vec::new();
    let mut met = 0;
    for (i, (ray, hit)) in rays.iter().zip(&hits).enumerate() {
        let own = tree.closest_hit(&mesh, ray, |_| true);
        met += usize::from(own.is_some());
        if let Some(Hit { b1, b2, .. }) = *hit {
            let b0 = 1.0 - b1 - b2;
            let are_weights = [b0, b1, b2].iter().all(|b| (0.0..=1.0).contains(b));
            assert!(are_weights, "{name}: weights {b0}, {b1}, {b2} of {hit:?}, {ray:?}");
        }
        if let (Some(own), Some(hit)) = (&own, hit)
            && own.triangle == hit.triangle
        {
            histogram.add(own.t, hit.t);
        }
        let (asked, answer) = (probe_of(ray, hit.as_ref()), probe_of(ray, own.as_ref()));
        if let Some((why, bound)) = differ((&Bare(pack), pack), &asked, &answer, other.t_bound()) {
            findings.push(Finding {
                pixel: (i as u32, 0),
                step: 0,
                kind: asked.kind,
                own: (answer.triangle, answer.t),
                other: (asked.triangle, asked.t),
                bound,
                ray: 0.0,
                why,
                is_deep: false,
            });
        }
    }
    println!("{name}: {} rays, {met} hit, {} others; {histogram}", rays.len(), findings.len());
    let faults: Vec<_> = findings.iter().filter(|finding| !finding.why.is_explained()).collect();
    let table: String =
        faults.iter().take(20).map(|f| format!("\n{f}\n  {:?}", rays[f.pixel.0 as usize])).collect();
    assert!(faults.is_empty(), "{name}: {} faults\n{}{table}", faults.len(), Finding::HEAD);
}

/// So many rays of every kind.
pub fn rays_of(pack: &Pack, pose: &CameraPose, count: usize) -> Vec<Ray> {
    let subject = Subject::of(pack, pose);
    let mut random = Random(7);
    (0..count / 8).flat_map(|i| subject.packet(i, &mut random)).collect()
}

fn check_scene(scene: Scene, other: &dyn Other) {
    let name = scene.name.clone();
    let prepared = prepare_scene(scene, &PrepareOptions::default(), Duration::ZERO).expect("it packs");
    if prepared.pack.triangle_count() <= other.triangles_max() {
        let rays = rays_of(&prepared.pack, &prepared.cameras[0].pose, RAYS);
        check_rays(&name, &prepared.pack, &rays, other);
    }
}

#[test]
fn rays_of_generated_scenes() {
    with_every(|other| {
        for kind in [Kind::Hall, Kind::Plant, Kind::City] {
            check_scene(generate(&Recipe { kind, triangles: 20_000, seed: 1 }).expect("in range"), other);
        }
    });
}

#[test]
fn rays_of_real_scenes() {
    with_every(|other| {
        let Some(folder) = scene_folder() else { return };
        for file in ["stanford_bunny/bun_zipper.ply", "crytek_sponza/sponza.gltf"] {
            let options = LoadOptions { scenes_folder: Some(folder.clone()) };
            check_scene(tessera_scene::load(&folder.join(file), &options).expect("it loads"), other);
        }
    });
}

#[test]
fn h14_h15_no_ray_leaks_on_the_gpu() {
    with_every(|other| {
        for closed in meshes() {
            for sharing in [Sharing::Welded, Sharing::Unwelded, Sharing::SplitByUv] {
                let place = (1.0, 0.0);
                let pack = prepare(&closed, sharing, place, false, 2).pack;
                let count = AIMED / 12 + 1;
                let rays: Vec<Ray> = (0..count).map(aimed(&closed, place, &pack)).collect();
                let hits = other.hits(&pack, &rays);
                let leaks: Vec<_> = rays.iter().zip(&hits).filter(|(_, hit)| hit.is_none()).collect();
                let what = format!("{}, {sharing:?}", closed.name);
                assert!(
                    hits.len() == count && leaks.is_empty(),
                    "{what}: {} leaks, {:?}",
                    leaks.len(),
                    leaks.first()
                );
                check_rays(&what, &pack, &rays[..count / 10], other);
            }
        }
    });
}

/// A renderer that knows `f32` alone finds the distance of a steep plane where it may.
#[test]
fn bounds_of_single_precision_hold_where_it_is_simulated() {
    let mut random = Random(5);
    let (mut worst, mut seen) = (0.0f64, 0);
    for _ in 0..20_000 {
        let (low, high) = (tessera_geometry::Vec3::splat(-5e5), tessera_geometry::Vec3::splat(5e5));
        let at = random.point(low, high);
        let size = 3.0 * libm::exp2f(10.0 * random.unit());
        let vertices = [0, 1, 2].map(|_| crate::kinds::voxel(at + random.direction() * size));
        let origin = random.point(low, high);
        let (u, v) = (random.unit(), random.unit());
        let target =
            vertices[0] + (vertices[1] - vertices[0]) * u + (vertices[2] - vertices[0]) * (v * (1.0 - u));
        let ray = Ray { origin, direction: (target - origin).normalize(), t_min: 0.0, t_max: f32::INFINITY };
        let Some((t, ..)) = single_precision(&ray, vertices) else { continue };
        let sight = Sight::new(&ray, vertices);
        worst = worst.max((f64::from(t) - sight.t).abs() / TBound::SINGLE.allows(&sight));
        seen += 1;
    }
    assert!(seen > 8000 && worst <= 1.0, "{worst} of the bound, {seen} hits");
    println!("{worst} of the bound at most, {seen} hits");
}

/// Tests every triangle in `f32`.
struct Single;

impl Other for Single {
    fn name(&self) -> String {
        "single precision".into()
    }

    fn t_bound(&self) -> TBound {
        TBound::SINGLE
    }

    fn triangles_max(&self) -> u32 {
        3000
    }

    fn frame(&self, _: &Pack, _: &FrameParams) -> Vec<u8> {
        Vec::new()
    }

    fn signatures(&self, _: &Pack, _: &FrameParams) -> Vec<u32> {
        Vec::new()
    }

    fn probes(&self, _: &Pack, _: &FrameParams, _: &[(u32, u32)]) -> Vec<Vec<Probe>> {
        Vec::new()
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Vec<Option<Hit>> {
        let mesh = pack.mesh();
        let soup: Vec<_> = (0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect();
        let nearest = |ray: &Ray| {
            let mut best: Option<Hit> = None;
            for (triangle, vertices) in (0..).zip(&soup) {
                let Some((t, b1, b2)) = single_precision(ray, *vertices) else { continue };
                let hit = Hit { t, triangle, b1, b2 };
                if best.as_ref().is_none_or(|best| hit.precedes(best)) {
                    best = Some(hit);
                }
            }
            best
        };
        rays.iter().map(|ray| if ray.is_traceable() { nearest(ray) } else { None }).collect()
    }
}

/// What a GPU without `f64` will say is explained; what it says of another mesh is not.
#[test]
fn hits_in_single_precision_are_explained() {
    for closed in meshes() {
        let place = (1.0, 0.0);
        let pack = prepare(&closed, Sharing::Welded, place, false, 2).pack;
        let mut rays: Vec<Ray> = (0..3000).map(aimed(&closed, place, &pack)).collect();
        rays.extend(unkind(&pack, 3000));
        check_rays(closed.name, &pack, &rays, &Single);
    }
}

/// So many unkind rays.
fn unkind(pack: &Pack, count: usize) -> Vec<Ray> {
    let mesh = pack.mesh();
    let soup = Soup((0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect());
    let planes = split_planes(pack.tree().slots);
    let mut random = Random(9);
    (0..count).map(|i| unkind_ray(i, &mut random, &soup, &planes)).collect()
}

/// Woop's test with its interpolated distance, and weights.
pub fn single_precision(ray: &Ray, vertices: [tessera_geometry::Vec3; 3]) -> Option<(f32, f32, f32)> {
    let d = ray.direction.to_array();
    let kz = ray.direction.abs().max_position();
    let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
    let (sx, sy, sz) = (d[kx] / d[kz], d[ky] / d[kz], 1.0 / d[kz]);
    let p = vertices.map(|v| (v - ray.origin).to_array());
    let flat = p.map(|p| [p[kx] - sx * p[kz], p[ky] - sy * p[kz]]);
    let cross = |p: [f32; 2], q: [f32; 2]| p[0] * q[1] - p[1] * q[0];
    let w = [cross(flat[2], flat[1]), cross(flat[0], flat[2]), cross(flat[1], flat[0])];
    let sum = w[0] + w[1] + w[2];
    let is_hit = w.iter().all(|w| *w >= 0.0) || w.iter().all(|w| *w <= 0.0);
    let t = (w[0] * (sz * p[0][kz]) + w[1] * (sz * p[1][kz]) + w[2] * (sz * p[2][kz])) / sum;
    let b1 = (w[1] / sum).clamp(0.0, 1.0);
    (is_hit && t > ray.t_min && t <= ray.t_max).then(|| (t, b1, (w[2] / sum).clamp(0.0, 1.0).min(1.0 - b1)))
}
