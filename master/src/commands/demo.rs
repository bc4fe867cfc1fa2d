//! `tessera demo`.

use super::progress::Progress;
use super::render::{FrameArgs, Plan, WORKERS_MAX};
use super::run::Crew;
use super::{CommandError, PackingArgs};
use clap::Args;
use std::path::PathBuf;
use std::time::Instant;
use tessera_master::prepare::prepare_scene;

/// The built-in scene that the demo renders.
const SCENE: &str = "hall";

/// How to render the demo.
#[derive(Debug, Args)]
#[command(
    long_about = "Render a built-in scene on 4 local workers and write demo.png\n\n\
        The scene is a generated hall with textures, columns, a mirror floor and glass; it needs no file. This process is the master: it \
        packs the scene, starts the workers, sends the scene to each of them once, hands out tiles and puts the picture together.",
    after_help = "Examples:\n  tessera demo\n  tessera demo --workers 2 --size 512x512 --balance paper-static"
)]
pub struct DemoArgs {
    /// The file to write, .png or .exr
    #[arg(long, value_name = "FILE", default_value = "demo.png")]
    out: PathBuf,
    /// Local worker processes; 0 renders in this process
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(0..=WORKERS_MAX))]
    workers: u32,
    #[command(flatten)]
    packing: PackingArgs,
    #[command(flatten)]
    frame: FrameArgs,
}

pub fn run(args: DemoArgs, progress: &Progress) -> Result<(), CommandError> {
    args.packing.check_alone()?;
    let crew = Crew::Local(args.frame.local_crew(args.workers));
    let plan = Plan::check(&args.out, None, crew, &args.frame, &args.packing)?;
    let plan = plan.with_backend(progress)?;
    let prepared = {
        let _bar = progress.step("preparing the built-in scene");
        let start = Instant::now();
        let scene = tessera_scene::builtin(SCENE).map_err(CommandError::failed)?;
        prepare_scene(scene, &args.packing.options(), start.elapsed()).map_err(CommandError::failed)?
    };
    plan.render(&prepared, progress)
}
