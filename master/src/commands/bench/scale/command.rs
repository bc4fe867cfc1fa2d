//! `tessera bench scale`.

use super::case::{Case, Measured, Row, median, ms};
use super::devices;
use super::link::LinkProfile;
use super::page;
use super::real::{Device, RealCluster};
use super::recorded::Recorded;
use super::report::{self, Report};
use super::sim::Costs;
use super::simulated::Simulated;
use crate::commands::args::Size;
use crate::commands::bench::folder::{Folder, command_line};
use crate::commands::page::{Theme, machine, write_csv};
use crate::commands::progress::Progress;
use crate::commands::run::{cores, prepare_scene};
use crate::commands::{CommandError, PackingArgs, print_json, print_text};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tessera_geometry::LocalCamera;
use tessera_master::prepare::{Prepared, choose_camera};
use tessera_master::{Balance, FrameJob, PixelFormat};
use tessera_wire::{Coding, Features, Sampling, limits};

/// Clusters to be measured.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure how frame time falls with workers, by balancing and link\n\n\
        Renders one frame of the scene on one core and records what each place of it costs. Then starts clusters of worker processes that play \
        devices of a stated speed: they send the recorded pixels after the time that they took, so that sixteen of them cost this machine next to nothing; \
        processes, sockets, messages and policies are the real ones. Links are emulated by a relay between the processes with a medium \
        that all workers share. With --device real workers render for themselves, slowed down to the speed stated, and with simulated there \
        are no processes at all: the same state machines run under a virtual clock.",
    after_help = "Examples:\n  tessera bench scale scenes/hall.toml --quick --out hall\n  \
        tessera bench scale scenes/sponza.toml --workers 16 --link wired,phone --balance paper-static,auto\n  \
        tessera bench scale scenes/hall.toml --workers 8 --device-speed 1.0x7,0.25 --link wired"
)]
pub struct ScaleArgs {
    /// A file that `tessera render` takes
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Numbers of workers, separated by commas
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "1,2,4,8,16")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=10_000))]
    workers: Vec<u32>,
    /// Ways of handing out tiles, separated by commas, or all
    #[arg(long, value_name = "MODES", value_delimiter = ',', default_value = "all")]
    #[arg(value_parser = PossibleValuesParser::new(balances()).map(|name| name.to_string()))]
    balance: Vec<String>,
    /// Links, separated by commas, or all: loopback, wired, lan100, wifi-ac, phone, wan, or a file of one
    #[arg(long, value_name = "NAME|FILE,...", value_delimiter = ',', default_value = "all")]
    link: Vec<String>,
    /// Speeds of the devices, SPEED or SPEEDxCOUNT separated by commas, or a file with one a line; one value is that of all
    #[arg(long, value_name = "SPEEDS|FILE", default_value = "1.0")]
    device_speed: String,
    /// What devices are
    #[arg(long, value_name = "KIND", value_enum, default_value_t)]
    device: DeviceKind,
    /// What the frame takes one device of speed 1, in seconds, where devices are played or simulated
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = seconds)]
    one_worker: f64,
    /// What each tile costs a device besides, in microseconds: a launch of a GPU's kernel
    #[arg(long, value_name = "US", default_value_t = 0)]
    launch_us: u32,
    /// Measured frames of each run
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: u32,
    /// Runs of each case; each begins with a cluster that knows nothing
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    runs: u32,
    /// One run of two frames, one frame where a worker is alone
    #[arg(long)]
    quick: bool,
    /// Image size in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1024x1024")]
    size: Size,
    /// Side of a tile in pixels, a multiple of 16 [default: 128, and for auto what it chooses]
    #[arg(long, value_name = "N", value_parser = tile)]
    tile: Option<u32>,
    /// How pixels travel [default: raw with the paper's ways, as there; else as suits link and pixels]
    #[arg(long, value_name = "CODING", value_parser = coding)]
    coding: Option<CodingArg>,
    /// A camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Folder for the page (index.html), plots, scale.csv and scale.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `--device`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceKind {
    /// Processes that play a recording
    #[default]
    Replay,
    /// Processes that render, slowed down
    Real,
    /// No processes: a virtual clock
    Simulated,
}

impl DeviceKind {
    fn name(self) -> &'static str {
        match self {
            Self::Replay => "replay",
            Self::Real => "real",
            Self::Simulated => "simulated",
        }
    }
}

/// Of `--coding`: none leaves it to the cluster.
#[derive(Clone, Copy, Debug)]
pub struct CodingArg(Option<Coding>);

fn coding(text: &str) -> Result<CodingArg, String> {
    let found = Coding::ALL.into_iter().find(|coding| coding.name() == text).map(Some);
    // A rounded frame has other pixels than the recording, which its hash is held to.
    let found = found.filter(|coding| *coding != Some(Coding::Rounded)).or((text == "auto").then_some(None));
    found.map(CodingArg).ok_or_else(|| "write auto, raw or lossless".into())
}

fn balances() -> Vec<&'static str> {
    std::iter::once("all").chain(Balance::ALL.map(Balance::name)).collect()
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: Option<f64> = text.parse().ok();
    seconds.filter(|s| (0.001..=3600.0).contains(s)).ok_or_else(|| "write seconds, 0.001 to 3600".into())
}

fn tile(text: &str) -> Result<u32, String> {
    let side: Option<u32> = text.parse().ok();
    side.filter(|side| *side > 0 && side.is_multiple_of(Recorded::SIDE) && *side <= limits::SIDE)
        .ok_or_else(|| format!("write a multiple of {}", Recorded::SIDE))
}

/// What is measured, settled.
struct Grid {
    links: Vec<LinkProfile>,
    balances: Vec<Balance>,
    /// Speeds of each cluster.
    clusters: Vec<Vec<f64>>,
}

impl Grid {
    fn of(args: &ScaleArgs) -> Result<Self, CommandError> {
        let links = if args.link.iter().any(|link| link == "all") {
            LinkProfile::built_in()
        } else {
            args.link.iter().map(|link| LinkProfile::find(link)).collect()
        };
        let balances = if args.balance.iter().any(|balance| balance == "all") {
            Ok(Balance::ALL.to_vec())
        } else {
            args.balance.iter().map(|balance| balance.parse()).collect::<Result<_, String>>()
        };
        let speeds = |&workers: &u32| {
            let speeds = devices::speeds(&args.device_speed, workers as usize)?;
            if args.device == DeviceKind::Real {
                devices::check_real(&speeds, cores())?;
            }
            if args.device != DeviceKind::Simulated && workers as usize > limits::WORKERS {
                return Err(format!("--workers {workers}: a master takes {} at most", limits::WORKERS));
            }
            Ok(speeds)
        };
        let clusters = args.workers.iter().map(speeds).collect::<Result<_, String>>();
        let usage = CommandError::Usage;
        Ok(Self {
            links: links.map_err(usage)?,
            balances: balances.map_err(usage)?,
            clusters: clusters.map_err(usage)?,
        })
    }
}

/// Frames before the measured ones, in which a balancing learns. Those that learn nothing have one, in which caches are cold.
fn warm_up(balance: Balance, workers: usize) -> usize {
    match balance {
        Balance::Auto if workers > 1 => 6,
        Balance::Weighted | Balance::Staggered | Balance::Steal if workers > 1 => 2,
        _ => usize::from(workers > 1),
    }
}

/// The view of the frame that is measured.
fn job(args: &ScaleArgs, prepared: &Prepared) -> Result<(String, FrameJob), CommandError> {
    let chosen = choose_camera(&prepared.cameras, args.camera.as_deref()).map_err(CommandError::Usage)?;
    let Size { width, height } = args.size;
    let camera: LocalCamera = chosen
        .pose
        .to_local(&prepared.pack.frame(), width, height)
        .map_err(|e| CommandError::Usage(format!("the camera cannot be used: {e}")))?;
    let job = FrameJob {
        camera,
        width,
        height,
        tile: 128,
        samples: 1,
        sampling: Sampling::default(),
        depth: 8,
        seed: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
        balance: Balance::default(),
        mix: false,
        coding: None,
    };
    Ok((chosen.name.clone(), job))
}

pub fn run(args: &ScaleArgs, progress: &Progress) -> Result<(), CommandError> {
    let grid = Grid::of(args)?;
    let out = args.out.as_deref().map(Folder::check).transpose()?;
    let prepared = prepare_scene(&args.scene, &PackingArgs::default(), progress)?;
    let (camera, job) = job(args, &prepared)?;
    let recorded = {
        let _bar = progress.step("recording the frame");
        Recorded::render(&prepared.pack, &job, progress)?
    };
    let scale = match args.device {
        DeviceKind::Real => 1.0,
        DeviceKind::Replay | DeviceKind::Simulated => args.one_worker / recorded.total().as_secs_f64(),
    };
    let folder = tempfile::tempdir().map_err(CommandError::failed)?;
    let file = folder.path().join("recording");
    recorded.write(&file)?;
    let scene = super::super::name_of(&args.scene);
    let bench = Bench {
        args,
        grid,
        prepared: &prepared,
        job,
        recorded: &recorded,
        scale,
        file: &file,
        scene,
        camera,
    };
    let rows = bench.measure(progress)?;
    let report = bench.report(rows);
    if let Some(out) = &out {
        write_files(out, &report)?;
    }
    if args.json {
        return print_json(&report);
    }
    print_text(&report::text(&report.summaries))?;
    match &out {
        Some(out) => print_text(&format!("\nwrote      {}\n", out.path("index.html").display())),
        None => Ok(()),
    }
}

/// Writes the page, the plots and the figures.
fn write_files(folder: &Folder, report: &Report) -> Result<(), CommandError> {
    folder.write("index.html", page::page(report).html().as_bytes())?;
    for link in &report.links {
        let (times, shares) =
            (page::time_plot(report, &link.name), page::efficiency_plot(report, &link.name));
        for (plot, what) in [(times, "time"), (shares, "efficiency")] {
            folder.write(&format!("{}-{what}.svg", link.name), plot.svg().as_bytes())?;
            folder.write(&format!("{}-{what}.png", link.name), &plot.png(Theme::Light))?;
        }
    }
    let mut table = Vec::new();
    write_csv(&mut table, Row::COLUMNS, report.rows.iter().map(Row::cells)).map_err(CommandError::failed)?;
    folder.write("scale.csv", &table)?;
    folder.write("scale.json", &serde_json::to_vec_pretty(report).map_err(CommandError::failed)?)
}

/// Everything that a case needs.
struct Bench<'a> {
    args: &'a ScaleArgs,
    grid: Grid,
    prepared: &'a Prepared,
    job: FrameJob,
    recorded: &'a Recorded,
    scale: f64,
    file: &'a Path,
    scene: String,
    camera: String,
}

impl Bench<'_> {
    fn measure(&self, progress: &Progress) -> Result<Vec<Row>, CommandError> {
        let mut rows = Vec::new();
        for link in &self.grid.links {
            for speeds in &self.grid.clusters {
                let _bar = progress.step(format!("{} workers on {}", speeds.len(), link.name));
                self.measure_cluster(link, speeds, progress, &mut rows)?;
            }
        }
        Ok(rows)
    }

    fn measure_cluster(
        &self,
        link: &LinkProfile,
        speeds: &[f64],
        progress: &Progress,
        rows: &mut Vec<Row>,
    ) -> Result<(), CommandError> {
        let device = match self.args.device {
            DeviceKind::Real => Some(Device::Real(&self.prepared.pack)),
            DeviceKind::Replay => Some(Device::Replay {
                recording: self.file,
                scale: self.scale,
                launch_us: self.args.launch_us,
            }),
            DeviceKind::Simulated => None,
        };
        let cluster =
            device.map(|device| RealCluster::start(link, speeds, device, progress.log())).transpose();
        let mut cluster = cluster?;
        let (runs, frames) = match (self.args.quick, speeds.len()) {
            (false, _) => (self.args.runs, self.args.frames),
            (true, 1) => (1, 1),
            (true, _) => (1, 2),
        };
        for run in 0..runs {
            for &balance in &self.grid.balances {
                let case = Case { link: link.clone(), balance, speeds: speeds.to_vec() };
                let tile = self.args.tile.unwrap_or(if balance == Balance::Auto { 0 } else { 128 });
                let job = FrameJob { tile, coding: self.coding(balance), ..self.job.clone() };
                let warm = warm_up(balance, speeds.len());
                let all = warm + frames as usize;
                let predicted = self.simulator().run(&case, &job, all, &[])?;
                let measured = match &mut cluster {
                    Some(cluster) => cluster.run(&case, &job, all)?,
                    None => predicted.clone(),
                };
                if let Some(wrong) = measured.iter().find(|frame| frame.hash != self.recorded.hash) {
                    return Err(CommandError::Failed(format!(
                        "{balance} on {}: the image is {}, not {}",
                        link.name, wrong.hash, self.recorded.hash
                    )));
                }
                let took: Vec<_> = predicted[warm..].iter().map(|frame| ms(frame.took)).collect();
                let predicted = median(&took).filter(|_| cluster.is_some());
                for (number, frame) in (0..).zip(&measured[warm..]) {
                    rows.push(self.row(&case, run, number, frame, predicted));
                }
            }
        }
        if let Some(cluster) = cluster {
            cluster.stop();
        }
        Ok(())
    }

    fn report(self, rows: Vec<Row>) -> Report {
        let speeds = |workers: usize| {
            let of = self.grid.clusters.iter().find(|speeds| speeds.len() == workers);
            of.map_or(workers as f64, |speeds| speeds.iter().sum())
        };
        let summaries = report::summaries(&rows, speeds);
        let Size { width, height } = self.args.size;
        Report {
            tessera_scale: 1,
            scene: self.scene,
            camera: self.camera,
            size: [width, height],
            device: self.args.device.name().into(),
            one_worker_s: self.scale * self.recorded.total().as_secs_f64(),
            launch_us: self.args.launch_us,
            recording: self.recorded.costs(),
            links: self.grid.links,
            rows,
            summaries,
            command: command_line(),
            machine: machine(),
        }
    }

    /// How pixels travel: as is asked for; the paper's ways send them raw, as the paper did.
    fn coding(&self, balance: Balance) -> Option<Coding> {
        match self.args.coding {
            Some(coding) => coding.0,
            None if matches!(balance, Balance::PaperStatic | Balance::PaperDynamic) => Some(Coding::Raw),
            None => None,
        }
    }

    fn simulator(&self) -> Simulated<'_> {
        let launch = Duration::from_micros(self.args.launch_us.into());
        Simulated { recorded: self.recorded, scale: self.scale, launch, costs: Costs::default() }
    }

    fn row(&self, case: &Case, run: u32, frame: u32, measured: &Measured, predicted_ms: Option<f64>) -> Row {
        let launches = Duration::from_micros(self.args.launch_us.into()) * measured.tiles;
        let work = self.recorded.total().mul_f64(self.scale) + launches;
        Row {
            scene: self.scene.clone(),
            link: case.link.name.clone(),
            balance: case.balance.name().into(),
            workers: case.speeds.len(),
            device: self.args.device.name().into(),
            run,
            frame,
            frame_ms: ms(measured.took),
            ideal_ms: ms(case.ideal(work, measured.bytes)),
            bytes: measured.bytes,
            tile: measured.tile,
            busy_share: measured.busy_share(case.speeds.len()),
            dropped: measured.dropped,
            predicted_ms,
        }
    }
}
