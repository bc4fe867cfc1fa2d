//! Orders of convergence of meshes: how fast tessellated balls become round.

use crate::commands::check::backend::packet;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::{exact, quantized};
use crate::commands::fit::Fit;
use rayon::prelude::*;
use tessera_geometry::wide::{ALL_LANES, LANES};
use tessera_geometry::{DVec3, Ray};
use tessera_kdtree::soup::Random;
use tessera_pack::{Environment, EnvironmentKind, Pack};
use tessera_whitted::stage::stages::{glass_ball, ruler_at};
use tessera_whitted::stage::{Stage, View, chalk, look, mirror};
use tessera_worker::Kernel;

pub const CASES: &[Case] = &[
    Case {
        id: "34-order",
        input: "the focus of glass balls of growing tessellation",
        judge: "A: convergence of order 2",
        run: Run::Once(focus),
    },
    Case {
        id: "35",
        input: "where rays meet balls of 1e3 to 1e6 triangles, packed",
        judge: "A: convergence of order 2",
        run: Run::Once(places),
    },
    Case {
        id: "35-mirror",
        input: "what mirror balls reflect, normals plain and packed",
        judge: "A: convergence of order 2, then 0.5625 degrees",
        run: Run::Once(reflections),
    },
];

/// Rings of a ball of `4 rings (rings - 1)` triangles.
const RINGS: [u32; 10] = [16, 20, 25, 32, 40, 50, 64, 80, 112, 158];

fn triangles(rings: u32) -> u32 {
    4 * rings * (rings - 1)
}

/// Orders of meshes are whole or half numbers.
const APART: f64 = 0.5;

/// The order is 2: the middle of a facet of size `h`, pi over the number of rings, lies `h^2 / 8` inside the ball, and everything else follows from
/// that smoothly. What comes next is a share of `h^2 / 12` of it, seen at up to 53 degrees (0.8 of the radius); 0.3 % at the coarsest mesh.
fn next_share(per_ring: f64) -> f64 {
    let size = std::f64::consts::PI * per_ring;
    size * size / 12.0
}

/// The slope of `points`, of which there must be enough, beside the theory: the errors may be off from it by a share of `left_out` at each, which turns
/// their slope as it turns that of 1.
fn order(points: &[(f64, f64)], left_out: impl Fn(f64, f64) -> f64, what: &str) -> Result<Finding, String> {
    let few = || format!("{what}: {} meshes are too few for a slope", points.len());
    let fit = Fit::of(points).ok_or_else(few)?;
    let off: Vec<_> = points.iter().map(|&(size, error)| (size, 1.0 + left_out(size, error))).collect();
    let allowance = Fit::of(&off).ok_or_else(few)?.slope.abs();
    Ok(Finding::holds(
        format!("{what}: slope 2, {allowance:.4} allowed beside the confidence"),
        format!("{fit} over {} meshes", points.len()),
        fit.tells(2.0, allowance, APART),
    ))
}

fn root_mean_square(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0), |(sum, count), e| (sum + e * e, count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

fn places(effort: Effort) -> Outcome {
    let finer: &[u32] = effort.pick(&[], &[250, 360, 500]);
    let mut errors = Vec::new();
    for &rings in RINGS.iter().chain(finer) {
        let mut stage = Stage::default();
        stage.ball([0.0; 3], 1.0, rings, chalk());
        let pack = quantized(&stage)?;
        errors.push((rings, distance_error(&pack)?, pack.frame().step));
    }
    // Where a vertex is off by half a voxel at most, the root of a third of that along the ray: a share of a hundredth of the squares is
    // half a percent of their root.
    let floor = |step: f64| 0.5 * step / 3f64.sqrt();
    let is_before = |&&(_, error, step): &&(u32, f64, f64)| error > 10.0 * floor(step);
    let points: Vec<_> =
        errors.iter().filter(is_before).map(|(rings, e, _)| (1.0 / f64::from(*rings), *e)).collect();
    let voxel = errors[0].2;
    // Packing is the other share: squares add up.
    let left_out =
        |size: f64, error: f64| next_share(size) + 0.5 * (floor(voxel) / error) * (floor(voxel) / error);
    let slope = order(&points, left_out, "distance")?;
    let flat = errors.iter().find(|e| !is_before(e)).map_or("not yet flat".into(), |(rings, error, step)| {
        let voxels = error / step;
        format!("flat from {} triangles on, at {error:.1e} ({voxels:.1} voxels)", triangles(*rings))
    });
    let (rings, last, step) = errors[errors.len() - 1];
    // Mesh and packing together: a facet's share of the first error, and half a voxel: 0.29 of one across the surface, met at 53 degrees at most. 8000
    // rays find a root mean square within half a percent, so two of them differ by 3 %, four standard errors, and by the next term.
    let coarser = f64::from(errors[0].0) / f64::from(rings);
    let mesh = errors[0].1 * coarser * coarser;
    let bound = 1.04 * mesh + 0.5 * step;
    Ok(Finding::all([
        slope,
        Finding::holds(
            format!("error at {} triangles <= {bound:.2e}", triangles(rings)),
            format!("{last:.2e}, {flat}"),
            last <= bound,
        ),
    ]))
}

/// By how much rays from everywhere, within 0.8 of the middle, meet a unit ball too late.
fn distance_error(pack: &Pack) -> Result<f64, String> {
    const RAYS: usize = 8000;
    let frame = pack.frame();
    let mut random = Random(19);
    let rays: Vec<Ray> = (0..RAYS)
        .map(|_| {
            let from = random.direction().as_dvec3().normalize() * 3.0;
            let across = random.direction().as_dvec3();
            let aside = (across - from * (across.dot(from) / 9.0)).normalize();
            let target = aside * (0.8 * f64::from(random.unit()).sqrt());
            let direction = (target - from).normalize().as_vec3();
            Ray { origin: frame.to_local(from), direction, t_min: 0.0, t_max: f32::INFINITY }
        })
        .collect();
    let (tree, mesh) = (pack.tree(), pack.mesh());
    let hits: Vec<_> = rays
        .par_chunks(LANES)
        .flat_map_iter(|some| tree.closest_hits(Kernel::wide(), &mesh, &packet(some), ALL_LANES))
        .collect();
    let mut errors = Vec::new();
    for (ray, hit) in rays.iter().zip(hits) {
        let t = f64::from(hit.ok_or("a ray passes the ball")?.t) * frame.step;
        // The ray itself, as it was rounded.
        let (o, d) = (frame.to_world(ray.origin), ray.direction.as_dvec3());
        errors.push(t - to_ball(o, d).ok_or("a ray beside the ball")?);
    }
    Ok(root_mean_square(errors.into_iter()))
}

/// The distance at which a ray enters the unit ball, in lengths of its direction.
fn to_ball(o: DVec3, d: DVec3) -> Option<f64> {
    let (a, b, c) = (d.dot(d), o.dot(d), o.dot(o) - 1.0);
    let root = (b * b - a * c).sqrt();
    (!root.is_nan()).then_some((-b - root) / a)
}

fn reflections(effort: Effort) -> Outcome {
    let meshes = effort.pick(8, RINGS.len());
    let (mut plain, mut packed) = (Vec::new(), Vec::new());
    for &rings in RINGS.iter().take(meshes) {
        let mut stage = Stage::default();
        stage.ball([0.0; 3], 1.0, rings, mirror(1.0));
        // A sky whose light is 0.5 + 0.5 y: what a pixel shows is the height of the mirror ray's direction.
        stage.input.environment = Environment {
            kind: EnvironmentKind::Gradient as u32,
            zenith: [1.0; 3],
            horizon: [0.5; 3],
            nadir: [0.0; 3],
            ..Environment::default()
        };
        plain.push((rings, mirror_error(&exact(&stage)?)?));
        packed.push((rings, mirror_error(&quantized(&stage)?)?));
    }
    let points: Vec<_> = plain.iter().map(|(rings, (error, _))| (1.0 / f64::from(*rings), *error)).collect();
    let slope = order(&points, |size, _| next_share(size), "height of the mirror ray, plain normals")?;
    // A mirror turns twice as far as the normal; what the facets add is what they do with plain normals, at worst.
    let bound = 2.0 * 0.5625f64.to_radians();
    let (_, (mean, worst)) = packed[packed.len() - 1];
    let (_, (_, facets)) = plain[plain.len() - 1];
    let flat = packed.iter().zip(&plain).find(|((_, (packed, _)), (_, (plain, _)))| *packed > 2.0 * plain);
    let flat = flat.map_or("not yet flat".into(), |((rings, _), _)| {
        format!("flat from {} triangles on", triangles(*rings))
    });
    Ok(Finding::all([
        slope,
        Finding::holds(
            format!("packed normals: worst <= {:.2e}", bound + facets),
            format!("{worst:.2e}, mean {mean:.2e}, {flat}"),
            worst <= bound + facets,
        ),
    ]))
}

/// Root mean square and largest error of the heights of mirror rays, over the inner 0.8 of the ball.
fn mirror_error(pack: &Pack) -> Result<(f64, f64), String> {
    const SIDE: u32 = 96;
    let mut view = look([0.3, 0.4, 4.0], [0.0; 3]).sized(SIDE, SIDE);
    view.pose.fov_degrees = 26.0;
    let camera = view.pose.to_local(&pack.frame(), SIDE, SIDE).map_err(|e| e.to_string())?;
    let mut errors = Vec::new();
    for (i, pixel) in (0..SIDE * SIDE).zip(view.layers(pack).0) {
        let ray = camera.ray((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5, SIDE, SIDE);
        let (o, d) = (pack.frame().to_world(ray.origin), ray.direction.as_dvec3());
        let beside = (o - d * (o.dot(d) / d.dot(d))).length();
        let Some(t) = to_ball(o, d).filter(|_| beside < 0.8) else { continue };
        let n = (o + d * t).normalize();
        let reflected = (d - n * (2.0 * d.dot(n))).normalize();
        errors.push(2.0 * f64::from(pixel.color[1]) - 1.0 - reflected.y);
    }
    let worst = errors.iter().fold(0.0f64, |worst, e| worst.max(e.abs()));
    Ok((root_mean_square(errors.into_iter()), worst))
}

fn focus(effort: Effort) -> Outcome {
    let meshes = effort.pick(8, RINGS.len());
    let mut points = Vec::new();
    for &rings in RINGS.iter().take(meshes) {
        let pack = exact(&glass_ball(rings))?;
        let mut errors = Vec::new();
        let mut random = Random(23);
        for _ in 0..200 {
            // Beyond 0.3 of the radius aberration carries rays off the ruler.
            let at = [0.02 + 0.28 * f64::from(random.unit()), 0.2 * f64::from(random.unit()) - 0.1];
            let view = View { max_depth: 2, ..look([at[0], at[1], 3.0], [at[0], at[1], 0.0]) };
            errors.push(ruler_at(&view.pixel(&pack)) - through_ball(at)?);
        }
        points.push((1.0 / f64::from(rings), root_mean_square(errors.into_iter())));
    }
    let slope = order(&points, |size, _| next_share(size), "place in the focal plane")?;
    let ((first_size, first), (last_size, last)) = (points[0], points[points.len() - 1]);
    // The first one's share. 200 rays find a root mean square within 7 %: two of them differ by 30 %, three standard errors.
    let finer = last_size / first_size;
    let bound = 1.3 * first * finer * finer;
    Ok(Finding::all([slope, Finding::within("error of the finest", last, bound)]))
}

/// Where a ray parallel to the axis crosses the focal plane, 1.5 behind the centre of a glass ball of radius 1, in `f64`.
pub(super) fn through_ball([x, y]: [f64; 2]) -> Result<f64, String> {
    let bend = |d: DVec3, n: DVec3, eta: f64| {
        let c = -d.dot(n);
        d * eta + n * (eta * c - (1.0 - eta * eta * (1.0 - c * c)).sqrt())
    };
    let entry = DVec3::new(x, y, (1.0 - x * x - y * y).sqrt());
    let inside = bend(DVec3::NEG_Z, entry, 1.0 / 1.5);
    let exit = entry - inside * (2.0 * inside.dot(entry));
    let out = bend(inside, -exit, 1.5);
    let at = exit.x + out.x * (-1.5 - exit.z) / out.z;
    if at.is_finite() { Ok(at) } else { Err("a ray beside the ball".into()) }
}
