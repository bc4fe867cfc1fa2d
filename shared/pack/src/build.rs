//! From plain arrays to a pack.

use crate::check::check_input;
use crate::error::BuildError;
use crate::format::{Head, Section, assemble};
use crate::input::PackInput;
use crate::records::{Environment, EnvironmentKind, Light, Material, NO_TEXTURE, SideUv, Texture, Wrap};
use crate::view::{MeshView, Pack, cells_are_wide};
use rayon::prelude::*;
use tessera_geometry::{DVec3, LocalFrame};
use tessera_kdtree::{BuildOptions, Triangles, build::TreeStats};
use tessera_quantize::grid::MAX_INTERVALS;
use tessera_quantize::uv::{PackedUv, UvPlan, WrapRule};
use tessera_quantize::{Grid, NO_NORMAL, NormalTable, Record, clean, is_collinear};

/// Which vertex sections are held as plain `f32` instead of quantised.
///
/// Grid, triangle order, vertex splits and ids are those of the quantised pack, so that two frames differ by what is held in
/// another form and by nothing else. One thing cannot be the same: triangles that collapse when quantised are dropped from a
/// pack with quantised positions and kept in one with plain positions, which is the full geometry. Whoever measures the error of
/// quantisation compares with the plain pack, and the collapsed triangles count as part of the error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Plain {
    /// `f32` positions in local units.
    pub positions: bool,
    /// `f32` normals.
    pub normals: bool,
    /// `f32` texture coordinates.
    pub uvs: bool,
}

/// How a pack is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackOptions {
    /// Sections held plain.
    pub plain: Plain,
    /// kd-tree options.
    pub tree: BuildOptions,
    /// Finest grid tried: intervals of the longest side, 32..=8192. The paper's limit is 1024; above it only meshes that occupy
    /// few cells can go.
    pub max_intervals: u32,
}

impl Default for PackOptions {
    fn default() -> Self {
        Self { plain: Plain::default(), tree: BuildOptions::default(), max_intervals: MAX_INTERVALS }
    }
}

/// What was found, dropped and left out while packing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PackStats {
    /// Triangles of the input.
    pub triangles_in: u64,
    /// Vertices of the input.
    pub vertices_in: u64,
    /// Triangles in the pack.
    pub triangles: u64,
    /// Vertices in the pack.
    pub vertices: u64,
    /// Clean-up steps by name, each with its count; zero counts included.
    pub dropped: Vec<(&'static str, u64)>,
    /// Total world area of the triangles that collapsed when quantised.
    pub lost_area: f64,
    /// Cells along each axis.
    pub grid: [u32; 3],
    /// Cells in the table.
    pub cells: u32,
    /// Voxel side in world units.
    pub step: f64,
    /// Spacing of the input's own numbers at its largest coordinate, in voxels: 2^-23 of it when all coordinates are `f32`
    /// values, 2^-52 otherwise. Above 1 the input is coarser than the grid.
    pub input_spacing: f64,
    /// Vertices added because triangles need different shifts of their texture coordinates.
    pub split_vertices: u64,
    /// Triangles whose texture coordinates do not pack and are kept in the side table.
    pub side_uv_triangles: u64,
    /// Section name and bytes.
    pub sections: Vec<(&'static str, u64)>,
    /// Optional sections that this scene did not need: what, why.
    pub left_out: Vec<(&'static str, String)>,
    /// What a user should know about the input: one line each.
    pub warnings: Vec<String>,
    /// The tree.
    pub tree: TreeStats,
}

/// Packs `input`. Deterministic: the same bytes for any number of threads of the current rayon pool.
pub fn build_pack(mut input: PackInput, options: &PackOptions) -> Result<(Pack, PackStats), BuildError> {
    check_input(&input)?;
    let mut stats = PackStats {
        triangles_in: input.triangles.len() as u64,
        vertices_in: input.positions.len() as u64,
        ..PackStats::default()
    };
    leave_out(&mut input, &mut stats);

    // Keep usable triangles, and the vertices that they use.
    let mut ids = drop_unusable(&mut input, &mut stats);
    let grid =
        Grid::lay(&input.positions, options.max_intervals).map_err(|e| BuildError::Input(e.to_string()))?;
    let frame = grid.frame();
    note_grid(&input, &grid, &mut stats);

    // Drop triangles that have no area in the form in which they will be held.
    drop_collapsed(&mut input, &mut ids, &grid, options.plain, &mut stats);
    let (material_runs, id_runs) = sort_by_material(&mut input, &mut ids);

    // Choose texture shifts; from here triangles name packed vertices.
    let plan = plan_vertices(&mut input, &ids, &material_runs, &mut stats)?;
    let mut sections = Sections::new(&input, &grid, &plan, options.plain, &mut stats);
    sections.faces = std::mem::take(&mut input.triangles);
    sections.material_runs = material_runs;
    sections.id_runs = id_runs;
    let PackInput { materials, textures, mut lights, light_positions, ambient, environment, .. } = input;
    sections.materials = materials;
    sections.environment =
        (environment.kind != EnvironmentKind::None as u32).then_some(environment).into_iter().collect();
    place_lights(&mut lights, &light_positions, &frame)?;
    sections.lights = lights;

    // Build the tree on what the pack holds, not on what the input held.
    let mut head = Head {
        anchor: grid.anchor,
        step: grid.step,
        cells: grid.cells,
        record_words: sections.record_words,
        vertices: plan.source.len() as u32,
        triangles: sections.faces.len() as u32,
        source_triangles: stats.triangles_in as u32,
        tree_depth: 0,
        root_min: [0.0; 3],
        root_max: [0.0; 3],
        ambient: ambient.radiance,
        flags: if sections.has_normals { Head::HAS_NORMALS } else { 0 },
    };
    drop((plan, ids, grid));
    let tree = {
        let mesh = MeshView::new(&head, &|section| sections.bytes(section));
        tessera_kdtree::build(head.triangles, |id| mesh.vertices(id), &options.tree)
    };
    stats.tree = tree.stats();
    head.tree_depth = tree.depth;
    head.root_min = tree.bounds.min.to_array();
    head.root_max = tree.bounds.max.to_array();
    sections.slots = tree.slots;
    sections.list = tree.list;
    sections.head = vec![head];
    (sections.textures, sections.texels) = lay_texels(textures)?;

    let all: Vec<_> = Section::ALL.iter().map(|&s| (s, sections.bytes(s))).collect();
    let total = all.iter().map(|(_, b)| b.len() as u64).sum();
    let buffer = assemble(&all).ok_or(BuildError::OutOfMemory(total))?;
    drop(sections);
    // A pack that this function makes passes the same checks as one that comes from outside.
    let pack = Pack::from_buffer(buffer).map_err(|e| BuildError::Input(e.to_string()))?;
    stats.triangles = u64::from(pack.triangle_count());
    stats.vertices = u64::from(pack.vertex_count());
    stats.sections = pack.section_sizes();
    Ok((pack, stats))
}

/// Empties what the scene does not need, before anything is done with it.
fn leave_out(input: &mut PackInput, stats: &mut PackStats) {
    let mut left_out = |what: &'static str, why: &str| stats.left_out.push((what, why.into()));
    if input.uvs.is_empty() {
        left_out("uv", "the scene has no texture coordinates");
    } else if input.materials.iter().all(|m| texture_slots(m).next().is_none()) {
        left_out("uv", "no material has a texture");
        input.uvs = Vec::new();
    }
    if input.normals.is_empty() {
        left_out("normal", "the scene has no shading normals");
    }
    if input.colors.is_empty() {
        left_out("color", "the scene has no vertex colours");
    } else if input.colors.par_iter().all(|&c| c == [255; 4]) {
        left_out("color", "every vertex colour is white");
        input.colors = Vec::new();
    }
    if input.textures.is_empty() {
        left_out("texture", "the scene has no textures");
    }
    if input.lights.is_empty() {
        left_out("light", "the scene has no lights");
    }
    if input.environment.kind == EnvironmentKind::None as u32 {
        left_out("environ", "a miss is black and transparent");
    }
}

/// Drops unusable triangles, then vertices that no triangle uses. Returns the original ids of the triangles that are left.
fn drop_unusable(input: &mut PackInput, stats: &mut PackStats) -> Vec<u32> {
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
    let directionless = |n: &[f32; 3]| NormalTable::get().encode(*n) == NO_NORMAL;
    stats.dropped.push((
        "normals_without_direction",
        input.normals.par_iter().filter(|n| directionless(n)).count() as u64,
    ));
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

/// Records the grid, and warns when the input's numbers are too coarse for the scene's own size.
fn note_grid(input: &PackInput, grid: &Grid, stats: &mut PackStats) {
    stats.grid = grid.cells;
    stats.cells = grid.table.len() as u32;
    stats.step = grid.step;
    let coordinates = || input.positions.par_iter().flatten_iter();
    let largest = coordinates().map(|x| x.abs()).reduce(|| 0.0, f64::max);
    let single = coordinates().all(|&x| f64::from(x as f32) == x);
    let spacing = largest * if single { f64::from(f32::EPSILON) } else { f64::EPSILON };
    stats.input_spacing = spacing / grid.step;
    let extent = grid.step * f64::from(grid.intervals) * 1024.0;
    // A 65,536th of the scene is one pixel when a sixteenth of it fills an image 4096 pixels wide.
    if spacing > extent / 65_536.0 {
        stats.warnings.push(format!(
            "the input's coordinates are spaced {spacing:.3e} apart at {largest:.3e}, a large part of the scene's size \
             {extent:.3e}: move the scene to the origin before it is exported"
        ));
    }
}

/// Drops triangles whose corners lie on one line, counts them and sums up their world area.
///
/// Quantised positions are compared in whole numbers, exactly. Plain ones in `f64`: a triangle that is collinear to 2^-52 of its
/// size cannot be hit by any `f32` ray.
fn drop_collapsed(
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
type Runs = Vec<[u32; 2]>;

/// Sorts triangles and ids by material, otherwise keeping their order; returns the material runs and the id runs.
fn sort_by_material(input: &mut PackInput, ids: &mut Vec<u32>) -> (Runs, Runs) {
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
fn plan_vertices(
    input: &mut PackInput,
    ids: &[u32],
    material_runs: &Runs,
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
    let plan = UvPlan::choose(&input.uvs, &mut input.triangles, rule_of).map_err(|e| {
        BuildError::Input(format!(
            "triangle {}, corner {}: texture coordinate {} is out of range (2^22 at most): it has no fraction left; mend the \
             scene or leave textures out",
            ids[e.triangle], e.corner, e.value
        ))
    })?;
    stats.split_vertices = plan.split_vertices;
    stats.side_uv_triangles = plan.side_triangles;
    if plan.side_triangles == 0 {
        stats.left_out.push(("side-uv", "every texture coordinate packs".into()));
    }
    Ok(plan)
}

fn texture_slots(m: &Material) -> impl Iterator<Item = u32> {
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

/// Moves lights into local space.
fn place_lights(lights: &mut [Light], positions: &[[f64; 3]], frame: &LocalFrame) -> Result<(), BuildError> {
    for (i, light) in lights.iter_mut().enumerate() {
        let world = positions.get(i).copied().unwrap_or(light.position.map(f64::from));
        light.position = frame.to_local(DVec3::from_array(world)).to_array();
        if light.position.iter().any(|x| !x.is_finite()) {
            return Err(BuildError::Input(format!(
                "light {i} at {world:?} is too far from a scene whose finest detail is {:e}: move it nearer",
                frame.step
            )));
        }
    }
    Ok(())
}

/// Lays all images into one run of texels.
fn lay_texels(textures: Vec<crate::ImageInput>) -> Result<(Vec<Texture>, Vec<u32>), BuildError> {
    let total: u64 = textures.iter().map(|t| u64::from(t.width) * u64::from(t.height)).sum();
    let mut texels = Vec::new();
    texels.try_reserve_exact(total as usize).map_err(|_| BuildError::OutOfMemory(total * 4))?;
    let mut records = Vec::with_capacity(textures.len());
    for t in textures {
        records.push(Texture {
            first_texel: texels.len() as u32,
            width: t.width,
            height: t.height,
            sampling: t.wrap_s as u32 | (t.wrap_t as u32) << 2 | u32::from(t.nearest) << 4,
        });
        texels.extend(t.rgba.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])));
    }
    Ok((records, texels))
}

/// The sections while they are being made.
#[derive(Default)]
struct Sections {
    record_words: u32,
    has_normals: bool,
    head: Vec<Head>,
    narrow_cells: Vec<u32>,
    wide_cells: Vec<u64>,
    records: Vec<u32>,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    side_uvs: Vec<SideUv>,
    colors: Vec<[u8; 4]>,
    faces: Vec<[u32; 3]>,
    material_runs: Runs,
    id_runs: Runs,
    slots: Vec<[u32; 2]>,
    list: Vec<u32>,
    materials: Vec<Material>,
    textures: Vec<Texture>,
    texels: Vec<u32>,
    lights: Vec<Light>,
    environment: Vec<Environment>,
}

impl Sections {
    fn bytes(&self, section: Section) -> &[u8] {
        use bytemuck::cast_slice;
        match section {
            Section::Head => cast_slice(&self.head),
            Section::Cells if self.wide_cells.is_empty() => cast_slice(&self.narrow_cells),
            Section::Cells => cast_slice(&self.wide_cells),
            Section::Records => cast_slice(&self.records),
            Section::Positions => cast_slice(&self.positions),
            Section::Normals => cast_slice(&self.normals),
            Section::Uvs => cast_slice(&self.uvs),
            Section::SideUvs => cast_slice(&self.side_uvs),
            Section::Colors => cast_slice(&self.colors),
            Section::Faces => cast_slice(&self.faces),
            Section::MaterialRuns => cast_slice(&self.material_runs),
            Section::IdRuns => cast_slice(&self.id_runs),
            Section::Slots => cast_slice(&self.slots),
            Section::List => cast_slice(&self.list),
            Section::Materials => cast_slice(&self.materials),
            Section::Textures => cast_slice(&self.textures),
            Section::Texels => cast_slice(&self.texels),
            Section::Lights => cast_slice(&self.lights),
            Section::Environment => cast_slice(&self.environment),
        }
    }

    /// The vertex sections.
    fn new(input: &PackInput, grid: &Grid, plan: &UvPlan, plain: Plain, stats: &mut PackStats) -> Self {
        let mut out = Self::default();
        let sources = || plan.source.par_iter().map(|&v| v as usize);
        let table = NormalTable::get();
        let frame = grid.frame();

        // Plain sections.
        if plain.positions {
            out.positions =
                sources().map(|v| frame.to_local(DVec3::from_array(input.positions[v])).to_array()).collect();
        }
        let has_direction = |v: usize| table.encode(input.normals[v]) != NO_NORMAL;
        out.has_normals = !input.normals.is_empty() && sources().any(has_direction);
        if !input.normals.is_empty() && !out.has_normals {
            stats.left_out.push(("normal", "no normal has a direction".into()));
        }
        if out.has_normals && plain.normals {
            out.normals = sources().map(|v| unit_or_zero(input.normals[v])).collect();
        }
        let has_uvs = !plan.uv.is_empty();
        if has_uvs && plain.uvs {
            out.uvs = sources().map(|v| input.uvs[v]).collect();
        }
        if !input.colors.is_empty() {
            out.colors = sources().map(|v| input.colors[v]).collect();
        }

        // Records of what is not plain.
        let packed_normals = out.has_normals && !plain.normals;
        let packed_uvs = has_uvs && !plain.uvs;
        if plain.positions && !packed_normals && !packed_uvs {
            return out;
        }
        out.record_words = if packed_uvs { 3 } else { 2 };
        let record = |i: usize| {
            let v = plan.source[i] as usize;
            let (voxel, cell) = if plain.positions {
                ([0; 3], 0)
            } else {
                let voxel = grid.voxel(input.positions[v]);
                // The cells of all vertices are in the table: it was made from them, by the same function.
                (voxel, grid.cell_index(voxel).unwrap_or_default())
            };
            let normal = if packed_normals { table.encode(input.normals[v]) } else { NO_NORMAL };
            let record = Record::new(voxel, cell, normal);
            match plan.uv.get(i) {
                Some(PackedUv::Units(uv)) if packed_uvs => record.with_uv(*uv),
                Some(PackedUv::Side) if packed_uvs => record.with_side_uv(),
                _ => record,
            }
        };
        let words = out.record_words as usize;
        out.records = vec![0; plan.source.len() * words];
        out.records.par_chunks_exact_mut(words).enumerate().for_each(|(i, to)| {
            to.copy_from_slice(&record(i).0[..words]);
        });
        if packed_uvs {
            out.side_uvs = (0..plan.source.len())
                .filter(|&i| plan.uv[i] == PackedUv::Side)
                .map(|i| SideUv { vertex: i as u32, uv: input.uvs[plan.source[i] as usize] })
                .collect();
        }
        if !plain.positions {
            if cells_are_wide(grid.cells) {
                let key = |&[x, y, z]: &[u32; 3]| u64::from(x) << 32 | u64::from(y) << 16 | u64::from(z);
                out.wide_cells = grid.table.iter().map(key).collect();
            } else {
                out.narrow_cells = grid.table.iter().map(|&[x, y, z]| x << 20 | y << 10 | z).collect();
            }
        }
        out
    }
}

/// A unit vector in `f32`, or zero when there is no direction.
fn unit_or_zero(n: [f32; 3]) -> [f32; 3] {
    if NormalTable::get().encode(n) == NO_NORMAL {
        return [0.0; 3];
    }
    DVec3::from_array(n.map(f64::from)).normalize().as_vec3().to_array()
}
