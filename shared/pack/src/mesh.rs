//! Steps from the input's triangles to the packed ones.

use crate::build::{PackStats, Plain};
use crate::error::BuildError;
use crate::input::PackInput;
use crate::records::{Material, NO_TEXTURE, Wrap};
use rayon::prelude::*;
use tessera_geometry::DVec3;
use tessera_quantize::normal::direction;
use tessera_quantize::uv::{UvBits, UvPlan, WrapRule};
use tessera_quantize::{Grid, clean, is_collinear};

/// Drops unusable triangles, then vertices that no triangle uses. Returns the original ids of the triangles that are left.
pub(crate) fn drop_unusable(input: &mut PackInput, stats: &mut PackStats) -> Vec<u32> {
    let cleaned = clean(&input.positions, &input.triangles);
    stats.dropped.push(("index_out_of_range", cleaned.index_out_of_range));
    stats.dropped.push(("vertex_not_finite", cleaned.not_finite));
    stats.dropped.push(("repeated_index", cleaned.repeated_index));
    let ids = cleaned.kept;
    input.triangles = ids.iter().map(|&id| input.triangles[id as usize]).collect();
    let UvPlan { source, .. } = UvPlan::without_uvs(input.positions.len(), &mut input.triangles);
    stats.dropped.push(("unused_vertices", (input.positions.len() - source.len()) as u64));
    if source.len() < input.positions.len() {
        gather(&mut input.positions, &source);
        gather(&mut input.normals, &source);
        gather(&mut input.uvs, &source);
        gather(&mut input.colors, &source);
    }
    // Normals without a direction mean 'none'; texture coordinates that are no numbers become 0.
    let directionless = input.normals.par_iter().filter(|n| direction(**n).is_none()).count() as u64;
    stats.dropped.push(("normals_without_direction", directionless));
    let not_finite = input.uvs.par_iter().filter(|uv| uv.iter().any(|x| !x.is_finite())).count() as u64;
    stats.dropped.push(("uvs_not_finite", not_finite));
    input.uvs.iter_mut().flatten().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
    ids
}

/// `array[i] = old array[source[i]]`; `source` ascends.
fn gather<T: Copy>(array: &mut Vec<T>, source: &[u32]) {
    if !array.is_empty() {
        for (to, &from) in source.iter().enumerate() {
            array[to] = array[from as usize];
        }
        array.truncate(source.len());
        array.shrink_to_fit();
    }
}

/// Drops triangles whose corners lie on one line, counts them and sums up their world area.
///
/// Quantised positions are compared in whole numbers, exactly. Plain ones in `f64`: a triangle that is collinear to 2^-52 of its
/// size cannot be hit by any `f32` ray.
pub(crate) fn drop_collapsed(
    input: &mut PackInput,
    ids: &mut Vec<u32>,
    grid: &Grid,
    plain: Plain,
    stats: &mut PackStats,
) {
    let frame = grid.frame();
    let positions = &input.positions;
    let voxels: Vec<_> =
        if plain.positions { Vec::new() } else { positions.par_iter().map(|&p| grid.voxel(p)).collect() };
    let collapsed: Vec<bool> = input
        .triangles
        .par_iter()
        .map(|t| {
            if plain.positions {
                let [a, b, c] =
                    t.map(|v| frame.to_local(DVec3::from_array(positions[v as usize])).as_dvec3());
                (b - a).cross(c - a) == DVec3::ZERO
            } else {
                is_collinear(t.map(|v| voxels[v as usize]))
            }
        })
        .collect();
    let mut count = 0;
    let mut kept = 0;
    for (i, _) in collapsed.iter().enumerate().filter(|(_, c)| **c) {
        let [a, b, c] = input.triangles[i].map(|v| DVec3::from_array(positions[v as usize]));
        stats.lost_area += 0.5 * (b - a).cross(c - a).length();
        count += 1;
    }
    for i in (0..collapsed.len()).filter(|&i| !collapsed[i]) {
        input.triangles[kept] = input.triangles[i];
        ids[kept] = ids[i];
        kept += 1;
    }
    input.triangles.truncate(kept);
    ids.truncate(kept);
    stats.dropped.push(("collapsed", count));
}

/// A list of `(first triangle, value)`.
pub(crate) type Runs = Vec<[u32; 2]>;

/// Sorts triangles and ids by material, otherwise keeping their order; returns the material runs and the id runs.
pub(crate) fn sort_by_material(input: &mut PackInput, ids: &mut Vec<u32>) -> (Runs, Runs) {
    // Materials of the triangles, found by walking the input's runs along the ascending ids.
    let mut run = 0;
    let material_of: Vec<u32> = ids
        .iter()
        .map(|&id| {
            while input.material_runs.get(run + 1).is_some_and(|next| next.0 <= id) {
                run += 1;
            }
            input.material_runs[run].1
        })
        .collect();
    // Counting sort.
    let mut first = vec![0u32; input.materials.len() + 1];
    for &m in &material_of {
        first[m as usize + 1] += 1;
    }
    for m in 0..input.materials.len() {
        first[m + 1] += first[m];
    }
    let material_runs = (0..input.materials.len())
        .filter(|&m| first[m] < first[m + 1])
        .map(|m| [first[m], m as u32])
        .collect();
    let mut triangles = vec![[0; 3]; ids.len()];
    let mut sorted_ids = vec![0; ids.len()];
    for (i, &m) in material_of.iter().enumerate() {
        let to = first[m as usize] as usize;
        first[m as usize] += 1;
        triangles[to] = input.triangles[i];
        sorted_ids[to] = ids[i];
    }
    let mut id_runs = Runs::new();
    for (i, &id) in sorted_ids.iter().enumerate() {
        if i == 0 || sorted_ids[i - 1] + 1 != id {
            id_runs.push([i as u32, id]);
        }
    }
    input.triangles = triangles;
    *ids = sorted_ids;
    (material_runs, id_runs)
}

/// Chooses the packed vertices; the triangles then name them.
pub(crate) fn plan_vertices(
    input: &mut PackInput,
    ids: &[u32],
    material_runs: &Runs,
    bits: UvBits,
    stats: &mut PackStats,
) -> Result<UvPlan, BuildError> {
    if input.uvs.is_empty() {
        return Ok(UvPlan::without_uvs(input.positions.len(), &mut input.triangles));
    }
    let rules: Vec<_> = input.materials.iter().map(|m| wrap_rule(m, input)).collect();
    let rule_of = |id: usize| {
        let run = material_runs.partition_point(|r| r[0] as usize <= id) - 1;
        rules[material_runs[run][1] as usize]
    };
    let plan = UvPlan::choose(&input.uvs, &mut input.triangles, bits, rule_of).map_err(|e| {
        BuildError::Input(format!(
            "triangle {}, corner {}: texture coordinate {} is out of range (2^22 at most): it has no fraction left; mend the \
             scene or leave textures out",
            ids[e.triangle], e.corner, e.value
        ))
    })?;
    stats.split_vertices = plan.split_vertices;
    stats.side_uv_triangles = plan.side_triangles;
    if plan.side_triangles == 0 {
        stats.leave_out("side-uv", "every texture coordinate packs");
    }
    Ok(plan)
}

pub(crate) fn texture_slots(m: &Material) -> impl Iterator<Item = u32> {
    [m.base_texture, m.metallic_roughness_texture, m.emissive_texture, m.transmission_texture]
        .into_iter()
        .filter(|&t| t != NO_TEXTURE)
}

/// The strictest rule of a material's textures along each axis; `None` when it has none.
fn wrap_rule(material: &Material, input: &PackInput) -> Option<[WrapRule; 2]> {
    let rule = |wrap: Wrap| match wrap {
        Wrap::Repeat => WrapRule::Any,
        Wrap::Mirror => WrapRule::Even,
        Wrap::Clamp => WrapRule::Fixed,
    };
    texture_slots(material)
        .map(|t| &input.textures[t as usize])
        .map(|t| [rule(t.wrap_s), rule(t.wrap_t)])
        .reduce(|a, b| [a[0].max(b[0]), a[1].max(b[1])])
}
