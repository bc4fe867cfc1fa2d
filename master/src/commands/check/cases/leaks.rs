//! Closed meshes, which no ray leaves.

use crate::commands::check::backend::Renders;
use crate::commands::check::case::{Case, Effort, Finding, Outcome, Run};
use crate::commands::check::pack::against_brute_force;
use std::sync::Arc;
use tessera_geometry::{Hit, Ray};
use tessera_kdtree::Triangles;
use tessera_kdtree::soup::Random;
use tessera_kdtree::soup::closed::{Closed, meshes, placed};
use tessera_pack::{ImageInput, Material, Pack, PackInput, PackOptions, Plain, build_pack};
use tessera_whitted::stage::chalk;

pub const CASES: &[Case] = &[
    Case {
        id: "14",
        input: "rays from inside closed meshes at their edges and vertices",
        judge: "A: every ray hits",
        run: Run::Each(closed),
    },
    Case {
        id: "15",
        input: "the same meshes un-welded, or split by texture coordinates",
        judge: "I: the same hits",
        run: Run::Each(split),
    },
    Case {
        id: "19",
        input: "a closed mesh of a 100,000th of its scene",
        judge: "A, B: every ray hits; every triangle",
        run: Run::Each(teapot),
    },
];

/// How triangles share vertices.
#[derive(Clone, Copy, PartialEq)]
enum Sharing {
    Welded,
    Unwelded,
    /// Texture coordinates over eight periods split vertices whose triangles need different shifts.
    SplitByUv,
}

/// A mesh in its place. `far` is a triangle somewhere else that widens the scene.
fn pack(
    mesh: &Closed,
    sharing: Sharing,
    place: (f64, f64),
    positions: bool,
    far: Option<f64>,
) -> Result<Pack, String> {
    let mut input = PackInput {
        positions: mesh.positions.iter().map(|p| placed(*p, place).to_array()).collect(),
        triangles: mesh.triangles.clone(),
        materials: vec![chalk()],
        material_runs: vec![(0, 0)],
        ..PackInput::default()
    };
    if sharing == Sharing::Unwelded {
        input.positions = input.triangles.iter().flatten().map(|&v| input.positions[v as usize]).collect();
        input.triangles = (0..input.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    }
    if sharing == Sharing::SplitByUv {
        input.uvs =
            mesh.positions.iter().map(|p| [(0.3 + 8.0 * p.x) as f32, (0.3 + 8.0 * p.y) as f32]).collect();
        let rgba: Arc<[u8]> = Arc::from([128; 4]);
        input.textures = vec![ImageInput { width: 1, height: 1, rgba, ..ImageInput::default() }];
        input.materials = vec![Material { base_texture: 0, ..chalk() }];
    }
    if let Some(far) = far {
        let first = input.positions.len() as u32;
        input.positions.extend([[far, 0.0, 0.0], [far, far, 0.0], [far, 0.0, far]]);
        input.triangles.push([first, first + 1, first + 2]);
    }
    let triangles = input.triangles.len();
    let options = PackOptions { plain: Plain { positions, ..Plain::default() }, ..PackOptions::default() };
    let (pack, _) = build_pack(input, &options).map_err(|e| e.to_string())?;
    // A face that collapsed would leave a vertex in the middle of a neighbour's edge.
    if pack.triangle_count() as usize == triangles {
        Ok(pack)
    } else {
        Err(format!("{}: {} of {triangles} triangles are left", mesh.name, pack.triangle_count()))
    }
}

/// So many rays from inside at vertices and edges.
fn aimed(mesh: &Closed, place: (f64, f64), pack: &Pack, count: usize) -> Vec<Ray> {
    let (frame, own) = (pack.frame(), pack.mesh());
    let mut random = Random(17);
    let corner = |random: &mut Random| own.vertices(random.below(mesh.triangles.len()) as u32);
    (0..count).map(|i| mesh.aimed(i, &mut random, place, &frame, corner)).collect()
}

const PLACES: [(f64, f64); 4] = [(1.0, 0.0), (1e6, 0.0), (1e-6, 0.0), (1.0, 1e6)];

fn closed(renders: &dyn Renders, effort: Effort) -> Outcome {
    // Of 4 meshes in 4 places, quantised and plain.
    let count = effort.pick(100_000, 1_000_000) / 32;
    let (mut leaks, mut sent) = (0, 0);
    let mut judged = Vec::new();
    for mesh in meshes() {
        for place in PLACES {
            for positions in [false, true] {
                let pack = pack(&mesh, Sharing::Welded, place, positions, None)?;
                let rays = aimed(&mesh, place, &pack, count);
                leaks += renders.hits_of(&pack, &rays)?.iter().filter(|hit| hit.is_none()).count();
                sent += rays.len();
                if place == PLACES[0] {
                    judged.push(against_brute_force(renders, &pack, &rays[..count / 8])?);
                }
            }
        }
    }
    let wrong = judged.iter().filter(|finding| !finding.ok).count();
    Ok(Finding::all([
        Finding::none(leaks, sent, "leaks"),
        Finding::none(wrong, judged.len(), "meshes with hits other than brute force's"),
    ]))
}

fn split(renders: &dyn Renders, effort: Effort) -> Outcome {
    let count = effort.pick(20_000, 200_000) / 8;
    let (mut differ, mut sent) = (0, 0);
    for mesh in meshes() {
        let of = |sharing| -> Result<Vec<Option<Hit>>, String> {
            let pack = pack(&mesh, sharing, PLACES[0], false, None)?;
            renders.hits_of(&pack, &aimed(&mesh, PLACES[0], &pack, count))
        };
        // Triangles keep their order, so hits their ids.
        let welded = of(Sharing::Welded)?;
        for sharing in [Sharing::Unwelded, Sharing::SplitByUv] {
            differ += welded.iter().zip(of(sharing)?).filter(|(a, b)| **a != *b).count();
            sent += count;
        }
    }
    Ok(Finding::none(differ, sent, "hits differ"))
}

fn teapot(renders: &dyn Renders, effort: Effort) -> Outcome {
    let count = effort.pick(2000, 20_000);
    let (mut leaks, mut sent, mut voxels) = (0, 0, f64::INFINITY);
    let mut judged = Vec::new();
    // The torus; where it takes so few voxels, others have faces without area.
    for mesh in meshes().into_iter().skip(1).take(1) {
        let pack = pack(&mesh, Sharing::Welded, PLACES[0], true, Some(1e5))?;
        voxels = voxels.min(1.0 / pack.frame().step);
        let rays = aimed(&mesh, PLACES[0], &pack, count);
        leaks += renders.hits_of(&pack, &rays)?.iter().filter(|hit| hit.is_none()).count();
        sent += rays.len();
        judged.push(against_brute_force(renders, &pack, &rays[..count / 4])?);
    }
    judged.push(Finding::none(leaks, sent, "leaks"));
    judged.push(Finding::at_least("voxels across", voxels as usize, 10));
    Ok(Finding::all(judged))
}
