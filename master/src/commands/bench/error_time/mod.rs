//! `tessera bench error-time`.

mod knob;
mod lines;
mod measure;
mod page;
mod pareto;

use super::folder::{Folder, command_line};
use crate::commands::args::Size;
use crate::commands::page::{Theme, write_csv};
use crate::commands::progress::Progress;
use crate::commands::reference::{References, Truths};
use crate::commands::{CommandError, PackingArgs, print_json, print_text};
use clap::builder::NonEmptyStringValueParser;
use clap::{Args, ValueEnum};
use knob::{Base, Knob, Look};
use lines::Summary;
use measure::{Studio, Turned};
use page::Facts;
use serde::Serialize;
use std::path::PathBuf;
use tessera_master::prepare::choose_camera;
use tessera_scene::Without;
use tessera_wire::{Features, Sampling, limits};
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::GpuProbe;

/// What to turn, and on which scene.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure error against run time, knob by knob\n\n\
        Renders the scene with every setting of each knob, in turn, so that what else the machine does meets all of them, and compares the \
        linear pictures with that of an f64 tracer over the scene as its file states it (the oracle), which shares no code with what is \
        measured. Says of each setting the median time of a frame with its spread, the error by several measures, bytes, and whether any \
        other setting of the knob beats it; and the shortest time to each error.\n\n\
        True pictures take long and are kept: a second run with the same scene, view and size reads them.",
    after_help = "Examples:\n  tessera bench error-time scenes/hall.toml --out hall\n  \
        tessera bench error-time scenes/sponza.toml --size 1024x1024 --knob packed --out sponza\n  \
        tessera bench error-time scenes/plant.toml --knob spp,adaptive --spp-max 16 --json"
)]
pub struct ErrorTimeArgs {
    /// A file that `tessera render` takes, and no bundle
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// What is varied, separated by commas [default: all]
    #[arg(long, value_name = "KNOBS", value_enum, value_delimiter = ',')]
    knob: Vec<Knob>,
    /// Folder for the page (index.html), plots (SVG, PNG), error-time.csv and error-time.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Image size in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "512x512")]
    size: Size,
    /// A camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Mirrors and glass that a path may meet one after the other
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(0..=i64::from(limits::DEPTH)))]
    depth: u32,
    /// Most samples a pixel that are tried; adaptive sampling may take four times as many
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp_max: u32,
    /// Samples a pixel of the truth that samplers are held to [default: 16 times --spp-max]
    ///
    /// Such a truth takes as long as that many pictures by a tracer that is some ten times slower.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    reference_spp: Option<u32>,
    /// Measured frames of each setting
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: u32,
    /// Which time counts
    #[arg(long, value_name = "CLOCK", value_enum, default_value_t)]
    clock: Clock,
    /// Let a GPU take part in `backend`: its number in `tessera doctor`, or a part of its name
    #[arg(long, value_name = "NAME|INDEX", value_parser = NonEmptyStringValueParser::new())]
    gpu: Option<String>,
    /// Folder of true pictures [default: tessera/references in $XDG_CACHE_HOME or ~/.cache]
    #[arg(long, value_name = "DIR")]
    references: Option<PathBuf>,
    /// Print one JSON object on stdout
    #[arg(long)]
    pub(super) json: bool,
}

/// `--clock`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// What passes
    #[default]
    Wall,
    /// What all threads of this process work
    Cpu,
}

/// `--json`, and error-time.json.
#[derive(Debug, Serialize)]
struct Report<'a> {
    scene: &'a str,
    triangles: usize,
    camera: &'a str,
    size: [u32; 2],
    depth: u32,
    reps: u32,
    clock: Clock,
    reference_spp: u32,
    /// Seconds that taking the time takes.
    clock_s: f64,
    command: &'a str,
    machine: Vec<(String, String)>,
    knobs: Vec<Summary>,
}

pub fn run(args: &ErrorTimeArgs, progress: &Progress) -> Result<(), CommandError> {
    super::refuse_bundle(&args.scene)?;
    let command = command_line();
    let out = args.out.as_deref().map(Folder::check).transpose()?;
    let references = References::open(args.references.as_deref())?;
    let gpu = args.gpu.as_deref().map(|gpu| GpuProbe::open(Some(gpu), GpuOptions::default())).transpose();
    let gpu = gpu.map_err(CommandError::failed)?;
    let knobs = if args.knob.is_empty() { Knob::value_variants() } else { &args.knob };

    let packing = PackingArgs::default().options();
    let scene = {
        let _bar = progress.step("reading the scene");
        tessera_scene::load(&args.scene, &packing.load).map_err(CommandError::failed)?
    };
    let camera = choose_camera(&scene.cameras, args.camera.as_deref()).map_err(CommandError::Usage)?.clone();
    let look =
        Look { samples: 1, sampling: Sampling::default(), depth: args.depth, features: Features::default() };
    let truth_spp = args.reference_spp.unwrap_or(16 * args.spp_max);
    let mut truths = Vec::new();
    let unbent = Without { reflection: true, refraction: true, ..Without::default() };
    for without in [Without::default(), unbent] {
        if without == Without::default() || knobs.contains(&Knob::Packed) {
            truths.push((without, Truths::new(&scene, without, references.clone(), progress)?));
        }
    }
    let base = Base { packing, look, spp_max: args.spp_max, truth_spp, has_gpu: gpu.is_some() };
    let triangles = truths[0].1.triangles();
    let studio = Studio { args, scene: &scene, pose: camera.pose, base, gpu, truths, progress };

    let name = super::name_of(&args.scene);
    let mut report = Report {
        scene: &name,
        triangles,
        camera: &camera.name,
        size: [args.size.width, args.size.height],
        depth: args.depth,
        reps: args.reps,
        clock: args.clock,
        reference_spp: truth_spp,
        clock_s: measure::seconds_of_the_clock(),
        command: &command,
        machine: crate::commands::page::machine(),
        knobs: Vec::new(),
    };
    let mut turned = Vec::new();
    for &knob in knobs {
        let found = studio.turn(knob)?;
        let summary = Summary::of(&found, args.clock, truth_spp);
        if !args.json {
            print_text(&lines::text(&summary, args.clock))?;
        }
        turned.push(found);
        report.knobs.push(summary);
        // What is done is kept, whatever happens to the next.
        if let Some(out) = &out {
            write_files(out, &report, &look, args, &turned)?;
        }
    }
    if args.json {
        return print_json(&report);
    }
    match &out {
        Some(out) => print_text(&format!("\nwrote      {}\n", out.path("index.html").display())),
        None => Ok(()),
    }
}

/// Writes the page, the plots and the figures.
fn write_files(
    folder: &Folder,
    report: &Report<'_>,
    look: &Look,
    args: &ErrorTimeArgs,
    turned: &[Turned],
) -> Result<(), CommandError> {
    let summaries = &report.knobs;
    let seconds = summaries.iter().flat_map(|summary| &summary.rows).map(|row| row.seconds(args.clock).min);
    let facts = Facts {
        args,
        scene: report.scene,
        triangles: report.triangles,
        camera: report.camera,
        look,
        command: report.command.to_owned(),
        clock_s: report.clock_s,
        fastest_s: seconds.fold(f64::INFINITY, f64::min),
        harness_share: turned.iter().map(|turned| turned.harness_share).fold(0.0, f64::max),
    };
    folder.write("index.html", page::page(&facts, turned, summaries)?.html().as_bytes())?;
    for (turned, summary) in turned.iter().zip(summaries) {
        let plot = page::plot(turned.knob, summary, args.clock);
        folder.write(&format!("{}.svg", turned.knob), plot.svg().as_bytes())?;
        folder.write(&format!("{}.png", turned.knob), &plot.png(Theme::Light))?;
    }
    let (header, rows) = lines::csv(report.scene, summaries);
    let mut table = Vec::new();
    write_csv(&mut table, &header, &rows).map_err(CommandError::failed)?;
    folder.write("error-time.csv", &table)?;
    let json = serde_json::to_vec_pretty(report).map_err(CommandError::failed)?;
    folder.write("error-time.json", &json)
}
