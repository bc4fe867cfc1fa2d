//! Packs of small scenes, and the judges of their hits.

use super::backend::{Renders, Rounding, packet};
use super::case::Finding;
use rayon::prelude::*;
use tessera_geometry::wide::{ALL_LANES, LANES};
use tessera_geometry::{Hit, Ray, triangle, wgsl};
use tessera_kdtree::soup::{Random, Soup, split_planes, truth, unkind_ray};
use tessera_kdtree::{Triangles, brute_force_closest_hits};
use tessera_pack::{Pack, PackInput, PackOptions, PackStats, Plain, build_pack};
use tessera_whitted::stage::{BARE, Stage, chalk};
use tessera_worker::Kernel;

/// The quantised pack of a stage.
pub fn quantized(stage: &Stage) -> Result<Pack, String> {
    stage.clone().pack_with(Plain::default()).map_err(|e| e.to_string())
}

/// Both ways to hold a stage: quantised, and as it is.
pub fn packs(stage: &Stage) -> Result<[Pack; 2], String> {
    Ok([quantized(stage)?, exact(stage)?])
}

/// The pack of a stage with its own vertices.
pub fn exact(stage: &Stage) -> Result<Pack, String> {
    let plain = Plain { positions: true, normals: true, uvs: true };
    stage.clone().pack_with(plain).map_err(|e| e.to_string())
}

/// A pack and what was found on the way.
pub fn packed(input: PackInput) -> Result<(Pack, PackStats), String> {
    build_pack(input, &PackOptions::default()).map_err(|e| e.to_string())
}

/// How many triangles or vertices were dropped for this reason.
pub fn dropped(stats: &PackStats, what: &str) -> u64 {
    stats.dropped.iter().find(|d| d.0 == what).map_or(u64::MAX, |d| d.1)
}

/// A pack of bare triangles, with their own coordinates but for the place and size of the whole, and with so many references on an
/// inner node.
pub fn pack_of(soup: &Soup, max_refs: u32) -> Result<Pack, String> {
    let mut stage = Stage::default();
    for corners in &soup.0 {
        stage.triangle(corners.map(|v| (v.as_dvec3(), BARE)), chalk());
    }
    let mut options =
        PackOptions { plain: Plain { positions: true, ..Plain::default() }, ..PackOptions::default() };
    options.tree.max_refs = max_refs;
    let (pack, _) = build_pack(stage.input, &options).map_err(|e| e.to_string())?;
    if pack.triangle_count() == soup.len() { Ok(pack) } else { Err("not all triangles were packed".into()) }
}

/// A pack's triangles as they are traced.
pub fn soup_of(pack: &Pack) -> Soup {
    let mesh = pack.mesh();
    Soup((0..pack.triangle_count()).map(|id| mesh.vertices(id)).collect())
}

/// So many rays that are unkind to the tree of `pack`.
pub fn unkind(pack: &Pack, count: usize, seed: u64) -> Vec<Ray> {
    let (soup, planes) = (soup_of(pack), split_planes(pack.tree().slots));
    let mut random = Random(seed);
    (0..count).map(|i| unkind_ray(i, &mut random, &soup, &planes)).collect()
}

/// Two roundoffs: what a fused operation may add to a distance that is rounded once (`TBound::DOUBLE` of the tests of GPUs).
const DOUBLE_DISTANCE: f64 = 2.0 / 16_777_216.0;

/// Without `f64`, a GPU's distances are off by 64 roundoffs: a distance from three weighed depths, each with a shear, two products, a sum and a
/// division of 5 roundoffs.
const SINGLE_DISTANCE: f64 = 64.0 / 16_777_216.0;

/// The share of the largest coordinate by which projections are off.
pub fn lateral_error(rounding: Rounding) -> f64 {
    f64::from(match rounding {
        Rounding::Exact | Rounding::Double => triangle::LATERAL_ERROR,
        Rounding::Single => wgsl::LATERAL_ERROR,
    })
}

/// Holds the hits of `rays` to a test of every triangle: in triangle, distance and weights bit for bit. A GPU may take the other of two
/// triangles at one distance, and miss or meet one at the end of a ray's range, as far as its rounding goes; without `f64` also where a ray grazes an edge.
pub fn against_brute_force(renders: &dyn Renders, pack: &Pack, rays: &[Ray]) -> Result<Finding, String> {
    let hits = renders.hits_of(pack, rays)?;
    let soup = soup_of(pack);
    let judged: Vec<Option<Hit>> = rays
        .par_chunks(LANES)
        .flat_map_iter(|some| {
            let all = |_: usize, _: &Hit| true;
            let hits =
                brute_force_closest_hits(Kernel::wide(), soup.len(), &soup, &packet(some), ALL_LANES, all);
            hits.into_iter().take(some.len())
        })
        .collect();
    let is_fault = |((ray, hit), judged): ((&Ray, &Option<Hit>), &Option<Hit>)| {
        hit != judged && !is_excused(renders.rounding(), &soup, ray, hit, judged)
    };
    let faults = rays.iter().zip(&hits).zip(&judged).filter(|&pair| is_fault(pair)).count();
    Ok(Finding::none(faults, rays.len(), "hits other than brute force's"))
}

fn is_excused(rounding: Rounding, soup: &Soup, ray: &Ray, hit: &Option<Hit>, judged: &Option<Hit>) -> bool {
    let share = match rounding {
        Rounding::Exact => return false,
        Rounding::Double => DOUBLE_DISTANCE,
        Rounding::Single => SINGLE_DISTANCE,
    };
    let grazes = |hit: &Hit| {
        rounding == Rounding::Single
            && truth::judge(ray, soup.vertices(hit.triangle)).to_edges <= 2.0 * lateral_error(rounding)
    };
    let are_one = |a: f32, b: f32| (f64::from(a) - f64::from(b)).abs() <= 2.0 * share * f64::from(a.max(b));
    let at_an_end = |hit: &Hit| are_one(hit.t, ray.t_min) || are_one(hit.t, ray.t_max);
    match (hit, judged) {
        (None, None) => true,
        (Some(a), Some(b)) => {
            are_one(a.t, b.t) || [a, b].into_iter().any(|hit| grazes(hit) || at_an_end(hit))
        }
        (Some(one), None) | (None, Some(one)) => grazes(one) || at_an_end(one),
    }
}

/// Any hit is said where the nearest one is, and nowhere else.
pub fn any_as_nearest(renders: &dyn Renders, pack: &Pack, rays: &[Ray]) -> Result<Finding, String> {
    let (nearest, any) = (renders.hits_of(pack, rays)?, renders.any_hits(pack, rays)?);
    let faults = nearest.iter().zip(&any).filter(|(nearest, any)| nearest.is_some() != **any).count();
    Ok(Finding::none(faults, rays.len(), "any hits where there is no nearest one"))
}
