//! `tessera bench pack`.

use super::clock::{Cost, Watch};
use super::memory::process_peak;
use super::mesh::{Mesh, MeshSource};
use crate::commands::progress::Progress;
use crate::commands::{CommandError, PackingArgs, cores, print_text};
use clap::Args;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;
use tessera_geometry::DVec3;
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene_with};
use tessera_master::report::bytes;
use tessera_pack::PackStage;
use tessera_scene::{Material, Node, Primitive, Scene};

/// What to pack.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure the packing of a scene, stage by stage\n\n\
        Reads the scene and packs all of it, as a render would: reading and decoding files, flattening and selecting, quantising, building \
        the kd-tree, and laying out, hashing and checking the bytes. The memory is the most that the process held at once (Linux only).",
    after_help = "Examples:\n  tessera bench pack sponza.toml\n  tessera bench pack gen:sphere:1000000 --refs 0 --json"
)]
pub struct PackArgs {
    /// A file that `tessera render` takes, gen:sphere:N or gen:pipes:N with about N triangles
    #[arg(value_name = "MESH")]
    mesh: MeshSource,
    /// Threads that pack [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    threads: Option<u32>,
    #[command(flatten)]
    packing: PackingArgs,
    /// Print one JSON object
    #[arg(long)]
    pub(super) json: bool,
}

/// Lengths in bytes.
#[derive(Debug, Serialize)]
struct PackBench {
    mesh: String,
    threads: u32,
    /// Of the flattened source.
    tris: u64,
    vertices: u64,
    tris_packed: u64,
    vertices_packed: u64,
    stages: Vec<Stage>,
    sections: Vec<SectionBytes>,
    bytes: u64,
    bytes_per_triangle: f64,
    /// Of the whole process; none where the system does not tell.
    peak_bytes: Option<u64>,
    /// The result's hash.
    pack_id: String,
}

#[derive(Debug, Serialize)]
struct Stage {
    stage: &'static str,
    #[serde(flatten)]
    cost: Cost,
}

#[derive(Debug, Serialize)]
struct SectionBytes {
    section: &'static str,
    bytes: u64,
}

pub fn run(args: PackArgs, progress: &Progress) -> Result<(), CommandError> {
    let threads = args.threads.unwrap_or_else(cores);
    args.packing.check_alone()?;
    let options = args.packing.options();
    let (packed, _) = {
        let _bar = progress.step("packing");
        Cost::of(threads as usize, || pack(&args.mesh, &options))?
    };
    let (name, prepared, stages) = packed?;
    let pack = &prepared.pack;
    let stats = prepared.source.as_ref().map(|s| s.stats.clone()).unwrap_or_default();
    let length = pack.bytes().len() as u64;
    let bench = PackBench {
        mesh: name,
        threads,
        tris: stats.triangles_in,
        vertices: stats.vertices_in,
        tris_packed: stats.triangles,
        vertices_packed: stats.vertices,
        stages,
        sections: pack
            .section_sizes()
            .into_iter()
            .map(|(section, bytes)| SectionBytes { section, bytes })
            .collect(),
        bytes: length,
        bytes_per_triangle: length as f64 / stats.triangles as f64,
        peak_bytes: process_peak(),
        pack_id: pack.id().to_string(),
    };
    if args.json {
        return super::print_lines(&[bench]);
    }
    print_text(&text(&bench))
}

/// Reads and packs, with a watch on every stage.
fn pack(
    source: &MeshSource,
    options: &PrepareOptions,
) -> Result<(String, Prepared, Vec<Stage>), CommandError> {
    let mut laps = Laps { stage: "read", watch: Watch::start(), done: Vec::new() };
    let (name, scene) = match source {
        MeshSource::Generated(..) => {
            let mesh = Mesh::load(source, &options.load)?;
            (mesh.name.clone(), scene_of(mesh))
        }
        MeshSource::File(path) => {
            let path = Path::new(path);
            super::refuse_bundle(path)?;
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            (name, tessera_scene::load(path, &options.load).map_err(CommandError::failed)?)
        }
    };
    laps.begin("flatten");
    let on_stage = |stage| {
        laps.begin(match stage {
            PackStage::Quantise => "quantise",
            PackStage::Tree => "build tree",
            PackStage::Assemble => "assemble",
        });
    };
    let prepared =
        prepare_scene_with(scene, options, Duration::ZERO, on_stage).map_err(CommandError::failed)?;
    Ok((name, prepared, laps.end()))
}

/// One watch after the other.
struct Laps {
    stage: &'static str,
    watch: Watch,
    done: Vec<Stage>,
}

impl Laps {
    /// Ends the stage under way and begins the next.
    fn begin(&mut self, stage: &'static str) {
        self.done.push(Stage { stage: self.stage, cost: self.watch.read() });
        (self.stage, self.watch) = (stage, Watch::start());
    }

    fn end(mut self) -> Vec<Stage> {
        self.done.push(Stage { stage: self.stage, cost: self.watch.read() });
        self.done
    }
}

/// A scene of nothing but the mesh.
fn scene_of(mesh: Mesh) -> Scene {
    let primitive = Primitive {
        positions: mesh.positions.iter().map(|p| p.as_dvec3()).collect::<Vec<DVec3>>(),
        triangles: mesh.triangles,
        ..Primitive::default()
    };
    let node =
        Node { name: mesh.name.clone(), transform: Default::default(), mesh: Some(0), children: Vec::new() };
    Scene {
        name: mesh.name.clone(),
        meshes: vec![tessera_scene::Mesh { name: mesh.name, primitives: vec![primitive] }],
        nodes: vec![node],
        roots: vec![0],
        materials: vec![Material::default()],
        ..Scene::default()
    }
}

fn text(bench: &PackBench) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, bench);
    out
}

fn write_text(out: &mut String, bench: &PackBench) -> std::fmt::Result {
    writeln!(out, "mesh       {}, {} triangles, {} vertices", bench.mesh, bench.tris, bench.vertices)?;
    writeln!(out, "packed     {} triangles, {} vertices", bench.tris_packed, bench.vertices_packed)?;
    writeln!(out, "threads    {}", bench.threads)?;
    writeln!(out, "\nstage         CPU s   wall s")?;
    for Stage { stage, cost } in &bench.stages {
        writeln!(out, "{stage:10} {:8.3} {:8.3}", cost.cpu_s, cost.wall_s)?;
    }
    let by_triangle = |bytes: u64| bytes as f64 / bench.tris_packed as f64;
    writeln!(out, "\nsection         bytes  B/triangle")?;
    for SectionBytes { section, bytes } in &bench.sections {
        writeln!(out, "{section:10} {bytes:10} {:11.3}", by_triangle(*bytes))?;
    }
    writeln!(out, "{:10} {:10} {:11.3}", "all", bench.bytes, bench.bytes_per_triangle)?;
    if let Some(peak) = bench.peak_bytes {
        writeln!(out, "\npeak       {} of the process, {:.1} B/triangle", bytes(peak), by_triangle(peak))?;
    }
    writeln!(out, "pack id    {}", bench.pack_id)
}
