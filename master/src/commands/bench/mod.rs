//! `tessera bench`: measurements that anyone can repeat, of rays and trees on meshes without attributes, of packing and GPUs on scenes.

mod build;
pub(super) mod clock;
mod error_time;
mod folder;
mod generate;
pub(super) mod gpu;
mod gpu_lines;
mod hash;
pub(super) mod measure;
mod memory;
mod mesh;
mod obvhs;
mod pack;
mod peer;
mod ray_set;
mod rays;
mod scale;

use super::page::BUGS_FOR_TESTS;
use super::progress::Progress;
use super::{CommandError, print_text};
use clap::Subcommand;
use mesh::{Mesh, MeshSource};
use serde::Serialize;
use std::path::Path;
use tessera_geometry::mutation;
use tessera_scene::LoadOptions;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Rays per CPU second, beside obvhs in the same run
    Rays(rays::RaysArgs),
    /// Time and memory of building trees, beside obvhs
    Build(build::BuildArgs),
    /// Time of packing, stage by stage, and bytes of every section
    Pack(pack::PackArgs),
    /// Error against run time, by every knob that trades one for the other
    ErrorTime(error_time::ErrorTimeArgs),
    /// How frame time falls with workers, by balancing and link
    Scale(scale::command::ScaleArgs),
    /// How frame time depends on the side of a tile
    Tiles(scale::tiles::TilesArgs),
    /// What a measured scene would take another cluster
    WhatIf(scale::what_if::WhatIfArgs),
    /// Seconds of a frame on a GPU and on the CPU, by what the GPU's kernels are made of
    Gpu(gpu::GpuArgs),
    /// What the transport of frames gets out of emulated links, beside what they have to give
    Link(scale::link_bench::LinkArgs),
    /// Emulate a link between workers and their master; started by `bench` itself
    #[command(hide = true)]
    Relay(scale::relay::RelayArgs),
    /// Build one tree; started by `bench build` itself
    #[command(hide = true)]
    BuildOne(build::BuildOneArgs),
}

pub fn run(command: BenchCommand, progress: &Progress) -> Result<(), CommandError> {
    let prints_text = match &command {
        BenchCommand::Rays(args) => !args.json,
        BenchCommand::Build(args) => !args.json,
        BenchCommand::Pack(args) => !args.json,
        BenchCommand::ErrorTime(args) => !args.json,
        BenchCommand::Scale(args) => !args.cluster.json,
        BenchCommand::Tiles(args) => !args.cluster.json,
        BenchCommand::WhatIf(args) => !args.json,
        BenchCommand::Gpu(args) => !args.json,
        BenchCommand::Link(args) => !args.json,
        BenchCommand::BuildOne(_) | BenchCommand::Relay(_) => false,
    };
    super::warn_of_bugs(progress);
    match command {
        BenchCommand::Rays(args) => rays::run(args, progress),
        BenchCommand::Build(args) => build::run(args, progress),
        BenchCommand::Pack(args) => pack::run(args, progress),
        BenchCommand::ErrorTime(args) => error_time::run(&args, progress),
        BenchCommand::Scale(args) => scale::command::run(&args, progress),
        BenchCommand::Tiles(args) => scale::tiles::run(&args, progress),
        BenchCommand::WhatIf(args) => scale::what_if::run(&args),
        BenchCommand::Gpu(args) => gpu::run(&args, progress),
        BenchCommand::BuildOne(args) => build::run_one(&args),
        BenchCommand::Link(args) => scale::link_bench::run(&args, progress),
        BenchCommand::Relay(args) => scale::relay::run(&args),
    }?;
    // What is kept of the text says so too.
    if mutation::ARE_THERE && prints_text {
        print_text(&format!("build      {BUGS_FOR_TESTS}\n"))?;
    }
    Ok(())
}

fn load(source: &MeshSource, progress: &Progress) -> Result<Mesh, CommandError> {
    let _bar = progress.step("reading the mesh");
    let options = LoadOptions { scenes_folder: std::env::var_os("TESSERA_SCENES").map(Into::into) };
    Mesh::load(source, &options)
}

/// A bundle holds what was packed, and the benches want to pack.
pub(super) fn refuse_bundle(path: &Path) -> Result<(), CommandError> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack")) {
        return Err(CommandError::Usage(format!(
            "{}: a bundle holds no exact mesh to measure; name the scene that it was packed from",
            path.display()
        )));
    }
    Ok(())
}

/// What tables call a scene.
fn name_of(scene: &Path) -> String {
    scene.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Prints one JSON object a line to stdout.
fn print_lines<T: Serialize>(lines: &[T]) -> Result<(), CommandError> {
    let lines: Result<Vec<_>, _> = lines.iter().map(serde_json::to_string).collect();
    print_text(&format!("{}\n", lines.map_err(CommandError::failed)?.join("\n")))
}
