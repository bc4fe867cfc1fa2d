//! The command line.

mod against;
mod args;
mod backend;
mod bench;
mod check;
mod compare;
mod demo;
mod doctor;
mod error;
mod fit;
mod info;
mod info_text;
mod interrupt;
mod join;
mod master;
mod pack;
mod page;
mod progress;
mod reference;
mod render;
mod run;
mod sequence;
mod why;
mod why_slow;
mod worker;

pub use error::{CommandError, say};
use run::cores;

use clap::{Args, Parser, Subcommand};
use std::ffi::OsString;
use std::path::PathBuf;

/// Renders real scenes on a cluster of workers.
///
/// A master prepares the scene, sends it to the workers once, hands out tiles of the image and puts the picture together. The picture is
/// the same, bit for bit, for every number of workers, tile size and balancing.
#[derive(Debug, Parser)]
#[command(name = "tessera", version, disable_help_subcommand = true, after_help = EXAMPLES)]
pub struct Cli {
    #[command(flatten)]
    pub log: LogArgs,
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  tessera demo                                         a built-in scene on 4 local workers: demo.png
  tessera render scene.glb --out picture.png           in this process, with all cores
  tessera render scene.glb --out picture.exr --workers 4
  tessera scene info scene.glb                         what is in it, what is left out, how large it becomes
  tessera compare a.png b.png                          how far two pictures differ
  tessera why-slow trace.json                          where the time of a run went that --trace has recorded
  tessera doctor                                       what renders on this machine, and what is missing
  tessera check --quick                                hard inputs, judged, on this machine

Exit codes: 0 done, 1 the work failed, 2 wrong usage, 130 interrupted.";

/// Logging, the same for every command.
#[derive(Clone, Debug, Args)]
pub struct LogArgs {
    /// Log what happens to stderr; twice for more. RUST_LOG, if set, decides instead.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// How log lines are written.
    #[arg(long, global = true, value_enum, default_value_t, value_name = "FORMAT")]
    pub log_format: LogFormat,
}

impl LogArgs {
    /// The same as arguments, for a process that logs to the same place.
    pub fn to_args(&self) -> Vec<OsString> {
        let format = match self.log_format {
            LogFormat::Text => "text",
            LogFormat::Json => "json",
        };
        let verbose = std::iter::repeat_n("-v", self.verbose.into());
        verbose.chain(["--log-format", format]).map(Into::into).collect()
    }
}

/// How log lines are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a built-in scene on 4 local workers and write demo.png
    Demo(demo::DemoArgs),
    /// Render a scene to a PNG or EXR file
    Render(render::RenderArgs),
    /// Look into a scene, or pack it for workers
    #[command(subcommand)]
    Scene(SceneCommand),
    /// Say how far two pictures differ
    Compare(compare::CompareArgs),
    /// Measure rays and trees beside obvhs, packing, and a GPU beside the CPU
    #[command(subcommand)]
    Bench(bench::BenchCommand),
    /// Say where the time of a measured run went, and what would help most
    WhySlow(why_slow::WhySlowArgs),
    /// Check that hard inputs come out right on this machine
    Check(check::CheckArgs),
    /// Say what renders here, how fast, and what is missing
    Doctor(doctor::DoctorArgs),
    /// Wait for workers from anywhere, and render for clients
    Master(master::MasterArgs),
    /// Join a master and render for it
    Worker(worker::WorkerArgs),
}

impl Command {
    /// Whether it runs until it is told to end, and says meanwhile what happens.
    pub fn is_service(&self) -> bool {
        match self {
            Self::Master(_) => true,
            Self::Worker(args) => !args.ticket,
            Self::Demo(_) | Self::Render(_) | Self::Scene(_) | Self::Compare(_) | Self::Bench(_) => false,
            Self::Check(_) | Self::Doctor(_) | Self::WhySlow(_) => false,
        }
    }
}

/// What to do with a scene.
#[derive(Debug, Subcommand)]
pub enum SceneCommand {
    /// Report what is in a scene, what is left out and why, and how large it becomes
    Info(info::InfoArgs),
    /// Write the bundle that workers hold
    Pack(pack::PackArgs),
}

/// Which scene, and what of it is packed.
#[derive(Clone, Debug, Args)]
pub struct SceneArgs {
    /// A .glb, .gltf, .obj or .ply file, a scene file (.toml), or a bundle (.tpack)
    ///
    /// What a scene file names is looked for beside it and then in the folder of the environment variable TESSERA_SCENES.
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    #[command(flatten)]
    pub packing: PackingArgs,
}

/// What of a scene is packed, and how.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Packing")]
pub struct PackingArgs {
    /// Hold vertex data as f32 instead of quantised: all of it, or what is listed
    #[arg(
        long,
        value_name = "PARTS",
        value_enum,
        value_delimiter = ',',
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "positions,normals,uv"
    )]
    pub plain: Vec<args::PlainPart>,
    /// The finest grid tried for positions: cells of the longest side, 32 to 8192 [default: 8192]
    ///
    /// The grid becomes the finest one up to this of which vertices lie in at most 65,536 cells.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=8192))]
    pub cells: Option<u32>,
    /// Bits of a position inside its cell along an axis, 1 to 10 [default: 10]
    ///
    /// Positions are rounded to the middle of 2^BITS steps a cell; the size of the pack does not change.
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(1..=10))]
    pub position_bits: Option<u32>,
    /// The 16-bit code of shading normals [default: smith]
    #[arg(long, value_name = "CODE", value_enum)]
    pub normals: Option<args::Normals>,
    /// Bits of a texture coordinate, one before the point and the others behind it, 1 to 16 [default: 16]
    ///
    /// Coordinates are rounded to 2^(1-BITS); the size of the pack does not change. Those of triangles that span more than 2 stay f32.
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(1..=16))]
    pub uv_bits: Option<u32>,
    /// Triangle references on an inner node of the kd-tree [default: 2]
    #[arg(long, value_name = "0|1|2", value_parser = clap::value_parser!(u32).range(0..=2))]
    pub refs: Option<u32>,
    /// When a triangle is worth a reference: OCCUPANCY,FREQUENCY or OCCUPANCY,FREQUENCY,TESTS [default: 0.5,0.4,0.6]
    ///
    /// It must span that share of the node's extent and be listed by that share of the non-empty leaves below, both 0 to 1, and be tested at
    /// least so often by a ray through the node without the reference (0: no matter how often).
    #[arg(long, value_name = "SHARES")]
    pub refs_when: Option<args::RefsWhen>,
    /// What a split of the kd-tree must save a ray, in steps down the tree for all triangles around it together [default: 1]
    ///
    /// 0 keeps every split that saves anything: a larger tree, faster by less than a step.
    #[arg(long, value_name = "STEPS", value_parser = args::at_least_zero, allow_negative_numbers = true)]
    pub least_saving: Option<f32>,
    /// Leave out features, separated by commas
    #[arg(long, value_name = "FEATURES", value_enum, value_delimiter = ',')]
    pub without: Vec<args::Feature>,
}

impl Cli {
    /// Does what was asked.
    pub fn run(self) -> Result<(), CommandError> {
        let progress = progress::Progress::new(self.log);
        // A local worker ends with its master, who hears of Ctrl-C itself; services listen for more than that.
        if !matches!(self.command, Command::Worker(_) | Command::Master(_)) {
            interrupt::listen(&progress)?;
        }
        match self.command {
            Command::Demo(args) => demo::run(args, &progress),
            Command::Render(args) => render::run(args, &progress),
            Command::Scene(SceneCommand::Info(args)) => info::run(args, &progress),
            Command::Scene(SceneCommand::Pack(args)) => pack::run(args, &progress),
            Command::Compare(args) => compare::run(args),
            Command::Bench(command) => bench::run(command, &progress),
            Command::WhySlow(args) => why_slow::run(&args),
            Command::Check(args) => check::run(&args, &progress),
            Command::Doctor(args) => doctor::run(&args, &progress),
            Command::Master(args) => master::run(args),
            Command::Worker(args) => worker::run(args),
        }
    }
}

/// Where a desktop keeps `what` can be had again (XDG Base Directory Specification 0.8: only absolute paths count).
fn cache_folder(what: &str) -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let home = || absolute("HOME").map(|home| home.join(".cache"));
    absolute("XDG_CACHE_HOME").or_else(home).map(|folder| folder.join("tessera").join(what))
}

/// Says on the terminal, before anything is measured, that this build is no release, where it is one for tests.
fn warn_of_bugs(progress: &progress::Progress) {
    if tessera_geometry::mutation::ARE_THERE {
        progress.line(page::BUGS_FOR_TESTS);
    }
}

/// Prints one JSON object to stdout.
fn print_json(value: &impl serde::Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(value).map_err(CommandError::failed)?;
    print_text(&format!("{text}\n"))
}

/// Prints to stdout. A reader that has gone away (`tessera ... | head`) is no failure.
fn print_text(text: &str) -> Result<(), CommandError> {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(CommandError::Failed(format!("cannot write to stdout: {e}")))
        }
        _ => Ok(()),
    }
}
