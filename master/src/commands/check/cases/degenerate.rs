//! Scenes with nothing, little or too much of the same in them.

use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::{
    against_brute_force, dropped, lateral_error, pack_of, packed, packs, quantized, soup_of, unkind,
};
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_kdtree::Triangles;
use tessera_kdtree::soup::{Random, Soup, truth, voxel};
use tessera_master::PixelFormat;
use tessera_whitted::stage::stages::{
    FLOOR_COLORS, blocks, flat, floors, one_triangle, views_in_plane, without_area,
};
use tessera_whitted::stage::{Layers, look};

pub const CASES: &[Case] = &[
    Case { id: "1", input: "no triangles", judge: "A: background", run: Run::Each(nothing) },
    Case { id: "2", input: "one triangle", judge: "A: its projected area", run: Run::Each(one) },
    Case {
        id: "3",
        input: "all vertices equal, one vertex three times",
        judge: "C: counts",
        run: Run::Each(point),
    },
    Case {
        id: "4",
        input: "a flat scene, from above and from its side",
        judge: "A: background from its side",
        run: Run::Each(flat_scene),
    },
    Case { id: "5", input: "a line of triangles", judge: "C: counts", run: Run::Each(line) },
    Case {
        id: "6",
        input: "triangles without area among good ones",
        judge: "I: the same picture without them",
        run: Run::Each(faulty),
    },
    Case {
        id: "7",
        input: "slivers of 1,000,000 : 1",
        judge: "B, D: every triangle, f64",
        run: Run::Each(slivers),
    },
    Case {
        id: "8",
        input: "10,000 long diagonal slivers",
        judge: "B, C: every triangle, depth and bytes",
        run: Run::Each(diagonals),
    },
    Case {
        id: "9",
        input: "a triangle a thousand times",
        judge: "B, I: the smallest id",
        run: Run::Each(copies),
    },
    Case {
        id: "10",
        input: "overlapping floors in one plane",
        judge: "A: the first floor's colour",
        run: Run::Each(coplanar),
    },
    Case {
        id: "41",
        input: "triangles at distances of 2^-k",
        judge: "B, C: every triangle, depth",
        run: Run::Each(shrinking),
    },
];

fn nothing(renders: &dyn Renders, _: Effort) -> Outcome {
    background(renders, &["nothing"])
}

fn point(renders: &dyn Renders, _: Effort) -> Outcome {
    background(renders, &["all vertices equal", "one vertex"])
}

fn line(renders: &dyn Renders, _: Effort) -> Outcome {
    background(renders, &["a line of triangles"])
}

/// The scenes of these names hold no triangle, say how many they dropped, and are background in every pixel.
fn background(renders: &dyn Renders, names: &[&str]) -> Outcome {
    let (mut seen, mut pixels, mut kept, mut lost) = (0, 0, 0, 0);
    for (_, stage) in without_area().into_iter().filter(|(name, _)| names.contains(name)) {
        let (_, stats) = packed(stage.input.clone())?;
        lost += usize::from(
            dropped(&stats, "collapsed") + dropped(&stats, "repeated_index") != stats.triangles_in,
        );
        for pack in packs(&stage)? {
            kept += pack.triangle_count() as usize;
            let view = look([0.3, 0.4, 5.0], [0.0; 3]).sized(33, 21);
            let is_background = |p: &Layers| {
                p.alpha == 0.0 && p.id == Hit::NO_TRIANGLE && p.depth == f32::INFINITY && p.color == [0.0; 3]
            };
            let layers = renders.layers(&pack, &view)?;
            pixels += layers.len();
            seen += layers.iter().filter(|p| !is_background(p)).count();
        }
    }
    Ok(Finding::all([
        Finding::none(seen, pixels, "pixels seen"),
        Finding::equal("triangles kept", kept, 0),
        Finding::equal("wrong counts of dropped ones", lost, 0),
    ]))
}

fn one(renders: &dyn Renders, _: Effort) -> Outcome {
    let (stage, view, [area, perimeter]) = one_triangle();
    let (_, stats) = packed(stage.input.clone())?;
    let mut findings = vec![Finding::holds(
        "a grid of 8192 cells, at most 3 occupied",
        format!("{}, {}", stats.grid[0], stats.cells),
        stats.grid[0] == 8192 && stats.cells <= 3,
    )];
    for pack in packs(&stage)? {
        let covered = renders.layers(&pack, &view)?.iter().filter(|p| p.id == 0).count() as f64;
        // A pixel is decided at its centre: those that its outline passes may go either way, and it passes two for each of its length.
        let off = (covered - area).abs();
        findings.push(Finding::within(&format!("pixels off {area:.0}"), off, perimeter / 2.0));
    }
    Ok(Finding::all(findings))
}

fn flat_scene(renders: &dyn Renders, _: Effort) -> Outcome {
    let (mut wrong_above, mut wrong_beside, mut above, mut beside) = (0, 0, 0, 0);
    for pack in packs(&flat())? {
        let view = look([0.31, 0.17, 2.0], [0.0, 0.1, 0.0]).sized(64, 64);
        let layers = renders.layers(&pack, &view)?;
        above += layers.len();
        wrong_above += layers.iter().filter(|p| p.color != [0.5; 3] || p.normal != [0.0, 0.0, 1.0]).count();
        for view in views_in_plane(&pack) {
            let layers = renders.layers(&pack, &view)?;
            beside += layers.len();
            wrong_beside += layers.iter().filter(|p| p.id != Hit::NO_TRIANGLE).count();
        }
    }
    Ok(Finding::all([
        Finding::none(wrong_above, above, "pixels wrong from above"),
        Finding::none(wrong_beside, beside, "pixels seen from its side"),
    ]))
}

fn faulty(renders: &dyn Renders, _: Effort) -> Outcome {
    let view = look([0.4, 1.5, 4.0], [0.0, -0.2, 0.0]).sized(96, 64);
    let picture = |faulty| renders.bytes(&quantized(&blocks(faulty))?, &view, PixelFormat::Rgba16);
    let (good, faulty) = (picture(false)?, picture(true)?);
    let differ = good.iter().zip(&faulty).filter(|(a, b)| a != b).count() + good.len().abs_diff(faulty.len());
    let seen = good.chunks_exact(8).filter(|p| p[6..] != [0, 0]).count();
    Ok(Finding::all([
        Finding::none(differ, good.len(), "bytes differ"),
        Finding::at_least("pixels of blocks", seen, 500),
    ]))
}

fn slivers(renders: &dyn Renders, effort: Effort) -> Outcome {
    let mut random = Random(43);
    let soup = Soup((0..500).map(|_| sliver(&mut random, 500_000.0, 0.04, 0.5)).collect());
    let pack = pack_of(&soup, 2)?;
    let mut rays = unkind(&pack, effort.pick(2000, 20_000), 31);
    // Random rays miss a hair: send as many again at points of slivers.
    let own = soup_of(&pack);
    rays.extend((0..effort.pick(2000, 20_000)).map(|_| {
        let [a, b, c] = own.vertices(random.below(500) as u32);
        let (u, v) = (random.unit(), random.unit());
        let target = a + (b - a) * u + (c - a) * (v * (1.0 - u));
        let origin = random.point(Vec3::splat(-5e5), Vec3::splat(5e5));
        Ray { origin, direction: target - origin, t_min: 0.0, t_max: f32::INFINITY }
    }));
    let hits = renders.hits_of(&pack, &rays)?;
    let weights = hits
        .iter()
        .flatten()
        .filter(|h| ![1.0 - h.b1 - h.b2, h.b1, h.b2].iter().all(|b| (0.0..=1.0).contains(b)));
    let bad_weights = weights.count();
    // In f64: what is hit is crossed, or its edge is passed within the lateral error of the test.
    let lateral = lateral_error(renders.rounding());
    let is_wrong = |(ray, hit): (&Ray, &Option<Hit>)| {
        hit.is_some_and(|hit| {
            let verdict = truth::judge(ray, own.vertices(hit.triangle));
            verdict.t.is_none() && verdict.to_edges > lateral
        })
    };
    let wrong = rays.iter().zip(&hits).filter(|&pair| is_wrong(pair)).count();
    Ok(Finding::all([
        against_brute_force(renders, &pack, &rays)?,
        Finding::none(bad_weights, rays.len(), "hits with weights outside [0, 1]"),
        Finding::none(wrong, rays.len(), "hits that f64 denies"),
        Finding::at_least("hits", hits.iter().flatten().count(), 100),
    ]))
}

fn sliver(random: &mut Random, length: f32, spread: f32, width: f32) -> [Vec3; 3] {
    let from = voxel(random.point(Vec3::splat(-length), Vec3::splat(length)));
    let to = voxel(from * -0.9 + random.point(Vec3::splat(-length), Vec3::splat(length)) * spread);
    [from, to, from + Vec3::new(0.0, width, 0.0)]
}

fn diagonals(renders: &dyn Renders, effort: Effort) -> Outcome {
    let mut random = Random(43);
    let soup = Soup((0..10_000).map(|_| sliver(&mut random, 250_000.0, 0.04, 1.0)).collect());
    let pack = pack_of(&soup, 2)?;
    let rays = unkind(&pack, effort.pick(500, 5000), 31);
    Ok(Finding::all([against_brute_force(renders, &pack, &rays)?, tree_is_bounded(&soup, 20_000_000)?]))
}

fn copies(renders: &dyn Renders, effort: Effort) -> Outcome {
    let triangle = [Vec3::ZERO, Vec3::new(300.0, 20.0, 5.0), Vec3::new(10.0, 250.0, 90.0)].map(voxel);
    let soup = Soup(vec![triangle; 1000]);
    let pack = pack_of(&soup, 2)?;
    let rays = unkind(&pack, effort.pick(2000, 20_000), 31);
    let hits = renders.hits_of(&pack, &rays)?;
    let others = hits.iter().flatten().filter(|hit| hit.triangle != 0).count();
    let stats = soup.build(2).stats();
    Ok(Finding::all([
        Finding::none(others, hits.iter().flatten().count(), "hits of another copy than the first"),
        against_brute_force(renders, &pack, &rays)?,
        Finding::within(
            "leaves with copies",
            f64::from(stats.leaves as u32 - stats.empty_leaves as u32),
            4.0,
        ),
    ]))
}

fn coplanar(renders: &dyn Renders, _: Effort) -> Outcome {
    let view = look([0.4, 2.0, 3.5], [0.1, 0.0, 0.0]).sized(96, 80);
    let (mut wrong, mut judged) = (0, 0);
    for pack in packs(&floors())? {
        let frame = pack.frame();
        let camera = view.pose.to_local(&frame, 96, 80).map_err(|e| e.to_string())?;
        for (i, pixel) in renders.layers(&pack, &view)?.iter().enumerate().filter(|(_, p)| p.alpha > 0.0) {
            let ray = camera.ray((i % 96) as f32 + 0.5, (i / 96) as f32 + 0.5, 96, 80);
            let along = ray.direction.as_dvec3() * f64::from(pixel.depth);
            let at = frame.to_world(ray.origin) + along;
            // Within a ten-thousandth of an outline rounding and quantisation decide.
            let outside = [at.x.abs().max(at.z.abs()) - 1.0, (at.x.abs() - 2.5).max(at.z.abs() - 2.0)];
            if outside.iter().all(|o| o.abs() >= 1e-4) {
                let first = outside.iter().position(|o| *o < 0.0).unwrap_or(2);
                judged += 1;
                // Without f64 floors in one plane tie to its rounding only.
                wrong += usize::from(renders.is_exact() && pixel.color != FLOOR_COLORS[first]);
                wrong += usize::from(!FLOOR_COLORS.contains(&pixel.color));
            }
        }
    }
    Ok(Finding::all([
        Finding::none(wrong, judged, "pixels of another floor than the first"),
        Finding::at_least("pixels judged", judged, 4000),
    ]))
}

fn shrinking(renders: &dyn Renders, effort: Effort) -> Outcome {
    let triangles: Vec<_> = (0..20)
        .map(|k| {
            let at = libm::ldexpf(1_048_576.0, -k);
            [Vec3::splat(at), Vec3::new(at, at + at, at), Vec3::new(at, at, at + at)]
        })
        .collect();
    let copies = Soup(std::iter::repeat_n(triangles, 30).flatten().collect());
    let pack = pack_of(&copies, 2)?;
    let rays = unkind(&pack, effort.pick(2000, 20_000), 31);
    Ok(Finding::all([against_brute_force(renders, &pack, &rays)?, tree_is_bounded(&copies, 1_000_000)?]))
}

/// Depth and bytes of the trees of `soup`, with every number of references, are limited, and their validator lets them in.
fn tree_is_bounded(soup: &Soup, bytes_max: u64) -> Outcome {
    let (mut deepest, mut largest) = (0, 0);
    for max_refs in 0..=2 {
        let tree = soup.build(max_refs);
        tessera_kdtree::validate(&tree.view(), soup.len()).map_err(|e| e.to_string())?;
        deepest = deepest.max(tree.depth);
        largest = largest.max(tree.stats().bytes);
    }
    Ok(Finding::all([
        Finding::within("depth", f64::from(deepest), 48.0),
        Finding::within("bytes", largest as f64, bytes_max as f64),
    ]))
}
