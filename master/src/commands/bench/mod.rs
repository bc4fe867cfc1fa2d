//! `tessera bench`: measurements that anyone can repeat, on meshes without attributes.

mod clock;
mod generate;
mod hash;
mod measure;
mod mesh;
mod obvhs;
mod peer;
mod ray_set;
mod rays;

use super::CommandError;
use super::progress::Progress;
use clap::Subcommand;
use mesh::{Mesh, MeshSource};
use tessera_scene::LoadOptions;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Rays per CPU second, beside obvhs in the same run
    Rays(rays::RaysArgs),
}

pub fn run(command: BenchCommand, progress: &Progress) -> Result<(), CommandError> {
    match command {
        BenchCommand::Rays(args) => rays::run(args, progress),
    }
}

fn load(source: &MeshSource, progress: &Progress) -> Result<Mesh, CommandError> {
    let _bar = progress.step("reading the mesh");
    let options = LoadOptions { scenes_folder: std::env::var_os("TESSERA_SCENES").map(Into::into) };
    Mesh::load(source, &options)
}
