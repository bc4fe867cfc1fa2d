//! `tessera scene info`.

use super::progress::Progress;
use super::why::{self, Why, WhyArgs};
use super::{CommandError, SceneArgs, info_text, run};
use clap::Args;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Instant;
use tessera_kdtree::{BuildOptions, Tree, Triangles, build::TreeStats};
use tessera_master::prepare::{PrepareOptions, Prepared};
use tessera_master::report::LeftOutLine;
use tessera_pack::{NormalCode, Pack, format::Section};
use tessera_quantize::sizes;
use tessera_whitted::variant::Variant;

/// What to look into.
#[derive(Debug, Args)]
#[command(
    long_about = "Report what is in a scene, what is left out and why, and how large it becomes\n\n\
        Packs the scene as a render would, builds its kd-tree without, with one and with two triangle references on an inner node, and \
        reports sizes and counts beside the formulae of Seo, Park, Ihm 2022 (tables 1, 2, 3, 5 and 6).\n\n\
        With --why it also measures what leaving out saves. For every part that the scene does not need a twin is made that has it, with \
        content that changes no picture: a normal that means none at every vertex, white colours, a test for holes that every hit passes. A \
        frame of both is rendered in turn, in changing order, behind one of each to warm up: of the time it says the medians and, of the share \
        saved, the median and the quartiles over all pairs; where these lie on both sides of 0, nothing was saved that this run can tell. The \
        clock is CPU seconds of the whole process for the CPU, wall seconds from submission to readback for a GPU, which is measured too where \
        --backend gpu or --gpu names one, or auto finds a real one. The line of \
        the environment, where there is one, is a control: with its record or without, what renders is the same. The pictures must be equal bit for bit in all three pixel formats, or the \
        command fails. Bytes are those of the pack and of a device's memory.",
    after_help = "Examples:\n  tessera scene info sponza.toml\n  tessera scene info bunny.ply --json\n  \
        tessera scene info bunny.ply --why --backend gpu"
)]
pub struct InfoArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    why: WhyArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Everything that is reported. Lengths in bytes.
#[derive(Debug, Serialize)]
pub struct Info {
    pub scene: String,
    pub pack_id: String,
    /// Of the flattened source; of the pack when that is the source.
    pub triangles: u64,
    pub vertices: u64,
    pub triangles_packed: u64,
    pub vertices_packed: u64,
    /// Vertices a triangle, of the pack: every ratio depends on it.
    pub nv_nf: f64,
    pub materials: usize,
    pub textures: usize,
    pub lights: usize,
    pub nodes_in_tree: usize,
    pub meshes: usize,
    pub material_names: Vec<String>,
    pub images: Vec<ImageLine>,
    pub light_names: Vec<String>,
    pub cameras: Vec<String>,
    pub dropped: BTreeMap<&'static str, u64>,
    pub left_out: Vec<LeftOutLine>,
    pub grid: Grid,
    pub codes: Codes,
    /// What a GPU compiles for this pack.
    pub kernel: KernelLine,
    /// Of the pack's own tree.
    pub nodes: Nodes,
    pub bytes: Bytes,
    /// Without, with one and with two references on an inner node.
    pub trees: [TreeLine; 3],
    /// The paper's formulae for the pack's counts.
    pub formulae: Formulae,
    /// Bytes of every section of the pack.
    pub sections: BTreeMap<&'static str, u64>,
    /// Sections that the pack does not need, and why.
    pub sections_left_out: Vec<SectionLeftOut>,
    /// World area of the triangles that collapsed when quantised.
    pub lost_area: f64,
    /// Vertices added because triangles need different shifts of their texture coordinates.
    pub split_vertices: u64,
    /// Triangles whose texture coordinates do not pack and are kept in a side table.
    pub side_uv_triangles: u64,
    pub ms: InfoMs,
    /// What leaving out saves, part by part; only with `--why`.
    #[serde(skip_serializing_if = "Option::is_none", flatten)]
    pub why: Option<Why>,
    pub warnings: Vec<String>,
    pub notes: Vec<String>,
}

#[derive(Debug, Serialize)]
pub struct ImageLine {
    pub name: String,
    pub width: u32,
    pub height: u32,
}

#[derive(Debug, Serialize)]
pub struct SectionLeftOut {
    pub section: &'static str,
    pub why: String,
}

/// The kernel that renders the pack on a GPU: the parts that it needs.
#[derive(Debug, Serialize)]
pub struct KernelLine {
    pub name: String,
    /// Every part that may be left out, and whether it is in.
    pub parts: BTreeMap<&'static str, bool>,
    pub left_out: Vec<&'static str>,
}

impl KernelLine {
    fn of(pack: &Pack) -> Self {
        let variant = Variant::of(pack);
        let parts = variant.parts().into_iter().collect();
        Self { name: variant.name(), parts, left_out: variant.left_out() }
    }
}

#[derive(Debug, Serialize)]
pub struct Grid {
    pub nx: u32,
    pub ny: u32,
    pub nz: u32,
    /// Cells that hold a vertex.
    pub cells: u64,
    /// Side of a voxel in world units.
    pub step: f64,
    /// `step` as a share of the grid's longest side.
    pub precision: f64,
}

/// How vertices are coded.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Codes {
    /// `cells` or `f32`.
    pub positions: &'static str,
    /// Of a position inside its cell, along an axis; none where it is `f32`, or in a bundle, which does not say how it was rounded.
    pub position_bits: Option<u32>,
    /// `smith`, `oct` or `f32`; none where there are none.
    pub normals: Option<&'static str>,
    /// Largest angle between a normal and what is decoded, in degrees; none for `f32`.
    pub normals_error: Option<f64>,
    /// Bytes of the table with which normals are decoded; it is in no file.
    pub normal_table: u64,
    /// `fixed` or `f32`; none where there are none.
    pub uv: Option<&'static str>,
    /// Of a component of a texture coordinate, one of them before the point; none as for `position_bits`.
    pub uv_bits: Option<u32>,
}

impl Codes {
    /// Those of `pack`, which was made with `options` unless it came as it is.
    fn of(pack: &Pack, options: Option<&PrepareOptions>) -> Self {
        let mesh = pack.mesh();
        let is_plain = |section| pack.section_bytes(section) > 0;
        let [positions, uvs] = [Section::Positions, Section::Uvs].map(is_plain);
        let normals = pack.packed_normals();
        Self {
            positions: if positions { "f32" } else { "cells" },
            position_bits: options.filter(|_| !positions).map(|o| o.position_bits),
            normals: mesh.has_normals().then(|| normals.map_or("f32", NormalCode::name)),
            normals_error: normals.map(|code| code.bound_radians().to_degrees()),
            normal_table: if normals == Some(NormalCode::Smith) { NORMAL_TABLE } else { 0 },
            uv: mesh.has_uvs().then_some(if uvs { "f32" } else { "fixed" }),
            uv_bits: options.filter(|_| mesh.has_uvs() && !uvs).map(|o| o.uv_bits),
        }
    }
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Nodes {
    pub inner0: u64,
    pub inner1: u64,
    pub inner2: u64,
    pub leaves: u64,
    pub empty_leaves: u64,
    pub leaf_refs: u64,
    pub depth: u32,
}

#[derive(Debug, Serialize)]
pub struct Bytes {
    /// What the pack's mesh would take with `f32` positions, normals and texture coordinates, those that it has.
    pub mesh_plain: u64,
    /// What it takes: vertices, faces, material and id runs.
    pub mesh_packed: u64,
    /// Cell table and normal table.
    pub tables: u64,
    pub textures: u64,
    pub tree_standard: u64,
    pub tree_one_ref: u64,
    pub tree_two_refs: u64,
    /// The pack as a file.
    pub pack: u64,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct TreeLine {
    pub refs: u32,
    #[serde(flatten)]
    pub nodes: Nodes,
    pub bytes: u64,
    /// 8 bytes a slot and 4 a leaf reference, single ones too, as the paper counts.
    pub bytes_formula: u64,
    pub build_ms: f64,
}

#[derive(Debug, Serialize)]
pub struct Formulae {
    /// `32 nv + 12 nf + 8`.
    pub mesh_plain: u64,
    /// `12 nv + 12 nf`, as table 3 prints it.
    pub mesh_packed: u64,
    /// `12 nv + 12 nf + 18 * 2^16 + 24`.
    pub mesh_packed_with_tables: u64,
}

#[derive(Debug, Serialize)]
pub struct InfoMs {
    pub read: f64,
    pub pack: f64,
}

pub fn run(args: InfoArgs, progress: &Progress) -> Result<(), CommandError> {
    args.why.check(&args.scene.scene)?;
    let prepared = run::prepare_scene(&args.scene.scene, &args.scene.packing, progress)?;
    if args.why.why {
        super::warn_of_bugs(progress);
    }
    let why =
        if args.why.why { Some(why::measure(&args.scene, &args.why, &prepared, progress)?) } else { None };
    let options = args.scene.packing.options();
    let build = |refs| {
        let _bar = progress.step(format!("building the kd-tree with {refs} references on an inner node"));
        tree(&prepared.pack, BuildOptions { max_refs: refs, ..options.tree })
    };
    let trees = [build(0)?, build(1)?, build(2)?];
    let changed = why.as_ref().map_or(Ok(()), Why::check_equal);
    let info = Info { why, ..Info::new(prepared, &options, trees) };
    if args.json {
        super::print_json(&info)?;
    } else {
        super::print_text(&info_text::text(&info))?;
    }
    // Where a picture differs, the lines say which.
    changed
}

fn tree(pack: &Pack, options: BuildOptions) -> Result<TreeLine, CommandError> {
    let start = Instant::now();
    let mesh = pack.mesh();
    let tree = tessera_kdtree::build(pack.triangle_count(), |id| mesh.vertices(id), &options)
        .map_err(CommandError::failed)?;
    let build_ms = start.elapsed().as_secs_f64() * 1e3;
    let stats = tree.stats();
    let nodes = Nodes::from(stats);
    let slots = nodes.inner0 + nodes.leaves + 2 * (nodes.inner1 + nodes.inner2);
    Ok(TreeLine {
        refs: options.max_refs,
        nodes,
        bytes: stats.bytes,
        bytes_formula: 8 * slots + 4 * nodes.leaf_refs,
        build_ms,
    })
}

/// Of a pack that came as it is.
fn nodes_of(pack: &Pack) -> Nodes {
    let view = pack.tree();
    let depth = pack.head().tree_depth;
    let (slots, list) = (view.slots.to_vec(), view.list.to_vec());
    Nodes::from(Tree { bounds: view.bounds, depth, slots, list }.stats())
}

impl From<TreeStats> for Nodes {
    fn from(s: TreeStats) -> Self {
        Self {
            inner0: s.inner0,
            inner1: s.inner1,
            inner2: s.inner2,
            leaves: s.leaves,
            empty_leaves: s.empty_leaves,
            leaf_refs: s.leaf_refs,
            depth: s.depth,
        }
    }
}

/// Sections that make up the mesh; the cell table is counted with the tables.
pub const MESH_SECTIONS: [Section; 9] = [
    Section::Records,
    Section::Positions,
    Section::Normals,
    Section::Uvs,
    Section::SideUvs,
    Section::Colors,
    Section::Faces,
    Section::MaterialRuns,
    Section::IdRuns,
];
const TEXTURE_SECTIONS: [Section; 2] = [Section::Textures, Section::Texels];
/// 65,536 unit vectors of 3 x `f32`: a constant, computed by whoever decodes normals, so it is in no file.
const NORMAL_TABLE: u64 = 12 << 16;

impl Info {
    fn new(prepared: Prepared, options: &PrepareOptions, trees: [TreeLine; 3]) -> Self {
        let Prepared { name, pack, cameras, source, left_out, warnings, notes, timings, camera_tracks: _ } =
            prepared;
        let bytes_of = |sections: &[Section]| sections.iter().map(|&s| pack.section_bytes(s)).sum::<u64>();
        let (nv, nf) = (u64::from(pack.vertex_count()), u64::from(pack.triangle_count()));
        let mesh = pack.mesh();
        let has = |part: bool, bytes: u64| if part { bytes } else { 0 };
        let vertex_bytes =
            12 + has(mesh.has_normals(), 12) + has(mesh.has_uvs(), 8) + has(mesh.has_colors(), 4);
        let codes = Codes::of(&pack, source.as_ref().map(|_| options));
        let head = pack.head();
        let [nx, ny, nz] = head.cells;
        let mut dropped = BTreeMap::new();
        for (what, count) in source.iter().flat_map(|s| s.dropped.iter().copied()) {
            *dropped.entry(what).or_default() += count;
        }
        let stats = source.as_ref().map(|s| s.stats.clone()).unwrap_or_default();
        let own = match &source {
            Some(source) => Nodes::from(source.stats.tree),
            None => nodes_of(&pack),
        };
        Self {
            scene: name,
            pack_id: pack.id().to_string(),
            triangles: source.as_ref().map_or(nf, |s| s.stats.triangles_in),
            vertices: source.as_ref().map_or(nv, |s| s.stats.vertices_in),
            triangles_packed: nf,
            vertices_packed: nv,
            nv_nf: nv as f64 / nf as f64,
            materials: source.as_ref().map_or(pack.materials().len(), |s| s.materials.len()),
            textures: source.as_ref().map_or(pack.textures().len(), |s| s.images.len()),
            lights: source.as_ref().map_or(pack.lights().len(), |s| s.lights.len()),
            nodes_in_tree: source.as_ref().map_or(0, |s| s.nodes),
            meshes: source.as_ref().map_or(0, |s| s.meshes),
            cameras: cameras.into_iter().map(|c| c.name).collect(),
            dropped,
            left_out: left_out.iter().map(LeftOutLine::from).collect(),
            grid: Grid {
                nx,
                ny,
                nz,
                cells: pack.cell_count(),
                step: head.step,
                precision: 1.0 / (1024.0 * f64::from(nx.max(ny).max(nz))),
            },
            codes,
            kernel: KernelLine::of(&pack),
            nodes: own,
            bytes: Bytes {
                mesh_plain: vertex_bytes * nv + 12 * nf,
                mesh_packed: bytes_of(&MESH_SECTIONS),
                tables: pack.section_bytes(Section::Cells) + codes.normal_table,
                textures: bytes_of(&TEXTURE_SECTIONS),
                tree_standard: trees[0].bytes,
                tree_one_ref: trees[1].bytes,
                tree_two_refs: trees[2].bytes,
                pack: pack.bytes().len() as u64,
            },
            trees,
            formulae: Formulae {
                mesh_plain: sizes::plain_mesh(nv, nf),
                mesh_packed: sizes::quantised_mesh_without_tables(nv, nf),
                mesh_packed_with_tables: sizes::quantised_mesh(nv, nf),
            },
            sections: pack.section_sizes().into_iter().collect(),
            sections_left_out: stats
                .left_out
                .iter()
                .map(|(section, why)| SectionLeftOut { section, why: why.clone() })
                .collect(),
            lost_area: stats.lost_area,
            split_vertices: stats.split_vertices,
            side_uv_triangles: stats.side_uv_triangles,
            why: None,
            ms: InfoMs { read: timings.read.as_secs_f64() * 1e3, pack: timings.pack.as_secs_f64() * 1e3 },
            material_names: source.as_ref().map_or_else(Vec::new, |s| s.materials.clone()),
            images: source.as_ref().map_or_else(Vec::new, |s| {
                s.images
                    .iter()
                    .map(|(name, width, height)| ImageLine {
                        name: name.clone(),
                        width: *width,
                        height: *height,
                    })
                    .collect()
            }),
            light_names: source.map_or_else(Vec::new, |s| s.lights),
            warnings,
            notes,
        }
    }
}
