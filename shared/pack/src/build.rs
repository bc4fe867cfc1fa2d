//! From plain arrays to a pack.

use crate::check::{check_input, distinct_texels};
use crate::error::BuildError;
use crate::format::{Head, Section, assemble};
use crate::input::{ImageInput, PackInput};
use crate::mesh::{drop_collapsed, drop_unusable, plan_vertices, sort_by_material};
use crate::need::{DARK, Forced, force_in, leave_out, leave_out_unused};
use crate::records::{EnvironmentKind, Light, Texture};
use crate::sections::Sections;
use crate::view::{MeshView, Pack};
use rayon::prelude::*;
use std::collections::HashMap;
use tessera_geometry::{DVec3, LocalFrame};
use tessera_kdtree::{BuildOptions, Triangles, build::TreeStats};
use tessera_quantize::grid::{MAX_INTERVALS, POSITION_BITS, VOXELS_PER_CELL};
use tessera_quantize::{Grid, NormalCode, UvBits};

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
    /// Bits of a packed position inside its cell, along an axis, 1..=10; places inside a cell are 2^-bits of its side apart. All 10 are held
    /// and decoded in any case: fewer are rounded to when packing, and cost nothing less.
    pub position_bits: u32,
    /// Code of packed normals.
    pub normal_code: NormalCode,
    /// Bits of a component of packed texture coordinates, 1..=16: one before the point, the others behind it. As for `position_bits`, fewer
    /// than 16 are rounded to when packing. Coordinates in the side table stay `f32`.
    pub uv_bits: u32,
    /// A part that is packed though the scene does not need it.
    pub forced: Option<Forced>,
}

impl Default for PackOptions {
    fn default() -> Self {
        Self {
            plain: Plain::default(),
            tree: BuildOptions::default(),
            max_intervals: MAX_INTERVALS,
            position_bits: POSITION_BITS,
            normal_code: NormalCode::default(),
            uv_bits: UvBits::ALL.bits(),
            forced: None,
        }
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
    /// What the input held and no picture shows.
    pub unneeded: Vec<Unneeded>,
    /// What a user should know about the input: one line each.
    pub warnings: Vec<String>,
    /// The tree.
    pub tree: TreeStats,
}

/// Something of the input that changes no picture and is not packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unneeded {
    /// What, in the singular.
    pub what: &'static str,
    /// Why.
    pub why: &'static str,
    /// How many, > 0.
    pub count: u64,
    /// Bytes that they would take in the pack.
    pub bytes: u64,
}

/// A part of the work of [`build_pack_with`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackStage {
    /// Dropping what is unusable, laying the grid, encoding the vertices.
    Quantise,
    /// Building the kd-tree.
    Tree,
    /// Laying out, hashing and checking the bytes.
    Assemble,
}

/// Packs `input`. Deterministic: the same bytes for any number of threads of the current rayon pool.
pub fn build_pack(input: PackInput, options: &PackOptions) -> Result<(Pack, PackStats), BuildError> {
    build_pack_with(input, options, |_| {})
}

/// The same as [`build_pack`]; says when each stage begins to `on_stage`, which may hold a clock.
pub fn build_pack_with(
    mut input: PackInput,
    options: &PackOptions,
    mut on_stage: impl FnMut(PackStage),
) -> Result<(Pack, PackStats), BuildError> {
    on_stage(PackStage::Quantise);
    let uv_bits = UvBits::new(options.uv_bits).ok_or_else(|| {
        let asked = options.uv_bits;
        BuildError::Input(format!("texture coordinates of {asked} bits were asked for; 1 to 16 are possible"))
    })?;
    check_input(&input)?;
    let mut stats = PackStats {
        triangles_in: input.triangles.len() as u64,
        vertices_in: input.positions.len() as u64,
        ..PackStats::default()
    };
    leave_out(&mut input, &mut stats);

    // Keep usable triangles, and the vertices that they use.
    let mut ids = drop_unusable(&mut input, &mut stats);
    let grid = Grid::lay(&input.positions, options.max_intervals)
        .and_then(|grid| grid.with_position_bits(options.position_bits))
        .map_err(|e| BuildError::Input(e.to_string()))?;
    let frame = grid.frame();
    note_grid(&input, &grid, &mut stats);

    // Drop triangles that have no area in the form in which they will be held.
    drop_collapsed(&mut input, &mut ids, &grid, options.plain, &mut stats);
    let (mut material_runs, mut id_runs) = sort_by_material(&mut input, &mut ids);
    leave_out_unused(&mut input, &mut material_runs, options.forced, &mut stats);
    force_in(&mut input, &mut material_runs, &mut id_runs, &ids, options.forced);

    // Choose texture shifts; from here triangles name packed vertices.
    let plan = plan_vertices(&mut input, &ids, &material_runs, uv_bits, &mut stats)?;
    let mut sections = Sections::new(&input, &grid, &plan, options, &mut stats);
    // The full-precision arrays have done their part: free them before the tree is built.
    (input.positions, input.normals, input.uvs, input.colors) = Default::default();
    sections.faces = std::mem::take(&mut input.triangles);
    sections.material_runs = material_runs;
    sections.id_runs = id_runs;
    let PackInput { materials, textures, mut lights, light_positions, ambient, environment, cameras, .. } =
        input;
    sections.materials = materials;
    let has_environment = environment.kind != EnvironmentKind::None as u32;
    if has_environment || options.forced == Some(Forced::Environment) {
        sections.environment = vec![environment];
    }
    place_lights(&mut lights, &light_positions, &frame)?;
    if lights.is_empty() && options.forced == Some(Forced::Lights) {
        lights.push(DARK);
    }
    sections.lights = lights;
    sections.cameras = cameras;

    // Build the tree on what the pack holds, not on what the input held.
    let mut head = Head {
        anchor: frame.anchor.to_array(),
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
        flags: sections.flags(),
    };
    drop((plan, ids, grid));
    on_stage(PackStage::Tree);
    let tree = {
        let mesh = MeshView::new(&head, &|section| sections.bytes(section));
        tessera_kdtree::build(head.triangles, |id| mesh.vertices(id), &options.tree)
            .map_err(|e| BuildError::Input(e.to_string()))?
    };
    on_stage(PackStage::Assemble);
    stats.tree = tree.stats();
    head.tree_depth = tree.depth;
    head.root_min = tree.bounds.min.to_array();
    head.root_max = tree.bounds.max.to_array();
    sections.slots = tree.slots;
    sections.list = tree.list;
    sections.head = vec![head];
    (sections.textures, sections.texels) = lay_texels(&textures)?;

    let all: Vec<_> = Section::ALL.iter().map(|&s| (s, sections.bytes(s))).collect();
    let bytes = all.iter().map(|(_, b)| b.len() as u64).sum();
    let buffer = assemble(&all).ok_or(BuildError::OutOfMemory(bytes))?;
    drop(sections);
    // A pack that this function makes passes the same checks as one that comes from outside.
    let pack = Pack::from_buffer(buffer).map_err(BuildError::Unsound)?;
    stats.triangles = u64::from(pack.triangle_count());
    stats.vertices = u64::from(pack.vertex_count());
    stats.sections = pack.section_sizes();
    Ok((pack, stats))
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
    let extent = grid.step * f64::from(grid.intervals * VOXELS_PER_CELL);
    // A 65,536th of the scene is one pixel when a sixteenth of it fills an image 4096 pixels wide.
    if spacing > extent / 65_536.0 {
        stats.warnings.push(format!(
            "the input's coordinates are spaced {spacing:.3e} apart at {largest:.3e}, a large part of the scene's size \
             {extent:.3e}: move the scene to the origin before it is exported"
        ));
    }
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

/// Lays all images into one run of texels, each once.
fn lay_texels(textures: &[ImageInput]) -> Result<(Vec<Texture>, Vec<u32>), BuildError> {
    let total = distinct_texels(textures);
    let mut texels = Vec::new();
    let mut laid: HashMap<*const [u8], u32> = HashMap::new();
    texels.try_reserve_exact(total as usize).map_err(|_| BuildError::OutOfMemory(total * 4))?;
    let mut records = Vec::with_capacity(textures.len());
    for t in textures {
        // Below 2^32: the input was checked.
        let next = texels.len() as u32;
        let first_texel = *laid.entry(t.identity()).or_insert(next);
        if first_texel == next {
            texels.extend(t.rgba.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])));
        }
        records.push(Texture {
            first_texel,
            width: t.width,
            height: t.height,
            sampling: t.wrap_s as u32 | (t.wrap_t as u32) << 2 | u32::from(t.nearest) << 4,
        });
    }
    Ok((records, texels))
}
