//! `tessera bench scale`.

use super::args::{ClusterArgs, balances, chosen_balances, tile};
use super::case::Row;
use super::link::LinkProfile;
use super::page;
use super::report::{self, Report};
use super::studio::{Studio, Way};
use crate::commands::args::Size;
use crate::commands::bench::folder::{Folder, command_line};
use crate::commands::bench::refuse_bundle;
use crate::commands::page::{Theme, machine, write_csv};
use crate::commands::progress::Progress;
use crate::commands::{CommandError, print_json, print_text};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use tessera_master::Balance;

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
    #[command(flatten)]
    pub cluster: ClusterArgs,
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
    /// Write a trace of the last frame of each case to the folder too, for trace viewers and `tessera why-slow`
    #[arg(long, requires = "out")]
    traces: bool,
    /// Side of a tile in pixels, a multiple of 16 [default: 128, and for auto what it chooses]
    #[arg(long, value_name = "N", value_parser = tile)]
    tile: Option<u32>,
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
        let balances = chosen_balances(&args.balance);
        let clusters = args.workers.iter().map(|&n| args.cluster.speeds(n)).collect::<Result<_, String>>();
        let usage = CommandError::Usage;
        let links = links.map_err(usage)?;
        if let Some(twice) = (1..links.len()).find(|&k| links[..k].iter().any(|l| l.name == links[k].name)) {
            let name = &links[twice].name;
            return Err(usage(format!(
                "--link: two links are named `{name}`; give one another name in its file"
            )));
        }
        Ok(Self { links, balances: balances.map_err(usage)?, clusters: clusters.map_err(usage)? })
    }
}

pub fn run(args: &ScaleArgs, progress: &Progress) -> Result<(), CommandError> {
    let grid = Grid::of(args)?;
    let out = args.cluster.out.as_deref().map(Folder::check).transpose()?;
    if out.is_some() {
        // The page compares packings.
        refuse_bundle(&args.cluster.scene)?;
    }
    let studio = Studio::open(&args.cluster, progress)?;
    let ways: Vec<Way> = grid.balances.iter().map(|&balance| (balance, args.tile)).collect();
    let mut rows = Vec::new();
    for link in &grid.links {
        for speeds in &grid.clusters {
            let _bar = progress.step(format!("{} workers on {}", speeds.len(), link.name));
            let traces = out.as_ref().filter(|_| args.traces);
            studio.measure_cluster(link, speeds, &ways, traces, progress, &mut rows)?;
        }
    }
    let mut report = report_of(&studio, args, grid, rows);
    if let Some(out) = &out {
        // What was measured is kept, whatever happens to the rest.
        write_files(out, &report)?;
        report.compression = studio.compression(progress)?;
        write_files(out, &report)?;
    }
    if args.cluster.json {
        return print_json(&report);
    }
    print_text(&report::text(&report.summaries))?;
    match &out {
        Some(out) => print_text(&format!("\nwrote      {}\n", out.path("index.html").display())),
        None => Ok(()),
    }
}

fn report_of(studio: &Studio<'_>, args: &ScaleArgs, grid: Grid, rows: Vec<Row>) -> Report {
    let speeds = |workers: usize| {
        let of = grid.clusters.iter().find(|speeds| speeds.len() == workers);
        of.map_or(workers as f64, |speeds| speeds.iter().sum())
    };
    let summaries = report::summaries(&rows, speeds);
    let Size { width, height } = args.cluster.size;
    Report {
        tessera_scale: 1,
        scene: studio.scene.clone(),
        camera: studio.camera.clone(),
        size: [width, height],
        device: args.cluster.device.name().into(),
        one_worker_s: studio.one_worker().as_secs_f64(),
        launch_us: args.cluster.launch_us,
        recording: studio.recorded.costs(),
        links: grid.links,
        rows,
        summaries,
        compression: Vec::new(),
        command: command_line(),
        machine: machine(),
    }
}

/// Writes the page, the plots and the figures.
fn write_files(folder: &Folder, report: &Report) -> Result<(), CommandError> {
    let mut table = Vec::new();
    write_csv(&mut table, Row::COLUMNS, report.rows.iter().map(Row::cells)).map_err(CommandError::failed)?;
    folder.write("scale.csv", &table)?;
    folder.write("scale.json", &serde_json::to_vec_pretty(report).map_err(CommandError::failed)?)?;
    folder.write("index.html", page::page(report).html().as_bytes())?;
    for link in &report.links {
        let (times, shares) =
            (page::time_plot(report, &link.name), page::efficiency_plot(report, &link.name));
        for (plot, what) in [(times, "time"), (shares, "efficiency")] {
            folder.write(&format!("{}-{what}.svg", link.name), plot.svg().as_bytes())?;
            folder.write(&format!("{}-{what}.png", link.name), &plot.png(Theme::Light))?;
        }
    }
    Ok(())
}
