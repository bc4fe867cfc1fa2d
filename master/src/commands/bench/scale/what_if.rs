//! `tessera bench what-if`: what a measured scene would take other clusters.

use super::args::{balances, chosen_balances};
use super::case::{Case, Measured, median, ms};
use super::devices;
use super::link::LinkProfile;
use super::recorded::Recorded;
use super::report::{Report, prediction_error};
use super::sim::{Costs, Fault};
use super::simulated::Simulated;
use super::studio::usual_coding;
use crate::commands::{CommandError, print_json, print_text};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;
use tessera_geometry::{LocalCamera, Vec3};
use tessera_master::{Balance, FrameJob};

/// Clusters that were not measured.
#[derive(Debug, Args)]
#[command(
    long_about = "Predict frame time and efficiency of a cluster from a measured run\n\n\
        Reads scale.json of `tessera bench scale --out DIR` and simulates another cluster with its costs: more workers, another link, other \
        speeds. Says how far the simulator was off in the cases that the report has measured.",
    after_help = "Examples:\n  tessera bench what-if hall/scale.json --workers 64 --link wired\n  \
        tessera bench what-if hall/scale.json --workers 8 --device-speed 1x7,0.25 --balance all"
)]
pub struct WhatIfArgs {
    /// The report
    #[arg(value_name = "REPORT")]
    report: PathBuf,
    /// Numbers of workers, separated by commas
    #[arg(long, value_name = "N,...", value_delimiter = ',', required = true)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=10_000))]
    workers: Vec<u32>,
    /// A link: loopback, wired, lan100, wifi-ac, phone, wan, or a file of one
    #[arg(long, value_name = "NAME|FILE", default_value = "wired")]
    link: String,
    /// Ways of handing out tiles, separated by commas, or all
    #[arg(long, value_name = "MODES", value_delimiter = ',', default_value = "auto")]
    #[arg(value_parser = PossibleValuesParser::new(balances()).map(|name| name.to_string()))]
    balance: Vec<String>,
    /// Speeds of the devices, as for `tessera bench scale`
    #[arg(long, value_name = "SPEEDS|FILE", default_value = "1.0")]
    device_speed: String,
    /// Masters below the first, each with its share of the workers and a band of the image; 1: all workers are the first's own
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "1")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1024))]
    masters: Vec<u32>,
    /// What goes wrong: slows:WORKER:MS:TIMES, dies:WORKER:MS or joins:WORKER:MS, times from the first frame's begin
    #[arg(long, value_name = "FAULT", value_parser = fault)]
    fault: Vec<Fault>,
    /// Print one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// How long a master takes to miss a worker that is gone: the transport's silence.
const NOTICED: Duration = tessera_wire::limits::IDLE_TIMEOUT;

fn fault(text: &str) -> Result<Fault, String> {
    let wrong =
        || "write slows:WORKER:MS:TIMES, dies:WORKER:MS or joins:WORKER:MS, as in slows:3:500:4".to_owned();
    let mut parts = text.split(':');
    let mut next = || parts.next().ok_or_else(wrong);
    let (kind, worker, at) = (next()?, next()?, next()?);
    let worker = worker.parse().map_err(|_| wrong())?;
    let at = Duration::from_millis(at.parse().map_err(|_| wrong())?);
    let times = parts.next().map(str::parse::<f64>);
    match (kind, times) {
        ("slows", Some(Ok(times))) if (1e-3..=1e6).contains(&times) => Ok(Fault::Slows { worker, at, times }),
        ("dies", None) => Ok(Fault::Dies { worker, at, noticed: NOTICED }),
        ("joins", None) => Ok(Fault::Joins { worker, at }),
        _ => Err(wrong()),
    }
}

/// `--json`.
#[derive(Debug, Serialize)]
struct Answer {
    scene: String,
    link: String,
    predictions: Vec<Prediction>,
    /// Of the report's own cases: median and largest error of predictions, and how many there are.
    error_median: Option<f64>,
    error_largest: Option<f64>,
    cases: usize,
}

#[derive(Debug, Serialize)]
struct Prediction {
    workers: usize,
    balance: &'static str,
    masters: u32,
    frame_ms: f64,
    ideal_ms: f64,
    /// Time of one device of speed 1 over the sum of speeds times this.
    efficiency: f64,
    bytes: u64,
    tile: u32,
    /// Time that the busiest master works over the frame's.
    master_share: f64,
}

/// Frames in which a policy may learn, and those that count.
const WARM_UP: usize = 6;
const COUNTED: usize = 5;

pub fn run(args: &WhatIfArgs) -> Result<(), CommandError> {
    let report = read(&args.report)?;
    let link = LinkProfile::find(&args.link).map_err(CommandError::Usage)?;
    let balances = chosen_balances(&args.balance).map_err(CommandError::Usage)?;
    let invalid = |reason| CommandError::Failed(format!("{}: {reason}", args.report.display()));
    let recorded = Recorded::from_costs(report.size, &report.recording).map_err(invalid)?;
    let scale = report.one_worker_s / recorded.total().as_secs_f64();
    let launch = Duration::from_micros(report.launch_us.into());
    let simulated = Simulated { recorded: &recorded, scale, launch, costs: Costs::default(), first_row: 0 };
    let mut predictions = Vec::new();
    for &workers in &args.workers {
        let speeds = devices::speeds(&args.device_speed, workers as usize).map_err(CommandError::Usage)?;
        for &balance in &balances {
            for &masters in args.masters.iter().filter(|&&masters| masters <= workers) {
                let case = Case { link: link.clone(), balance, speeds: speeds.clone() };
                predictions.push(predict(&simulated, &case, &report, masters, &args.fault)?);
            }
        }
    }
    let error = prediction_error(&report.summaries);
    let answer = Answer {
        scene: report.scene,
        link: link.name,
        predictions,
        error_median: error.map(|(median, ..)| median),
        error_largest: error.map(|(_, largest, _)| largest),
        cases: error.map_or(0, |(.., cases)| cases),
    };
    if args.json { print_json(&answer) } else { print_text(&text(&answer)) }
}

/// The report in a file, checked as far as it is used.
fn read(path: &std::path::Path) -> Result<Report, CommandError> {
    let failed = |reason: String| CommandError::Failed(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| failed(e.to_string()))?;
    let report: Report = serde_json::from_str(&text)
        .map_err(|e| failed(format!("no report of `tessera bench scale`: {e}")))?;
    if report.tessera_scale != 1 {
        return Err(failed(format!(
            "a report of version {}, this program reads version 1",
            report.tessera_scale
        )));
    }
    if !(1e-6..=1e6).contains(&report.one_worker_s) {
        return Err(failed(format!(
            "one_worker_s = {}: it must be 0.000001 to 1000000",
            report.one_worker_s
        )));
    }
    Ok(report)
}

/// A frame of `case` as its last frames are, of as many masters.
///
/// Each of several masters has a band of the image that costs about as much as the others', and its own link to its workers. It sends what is
/// finished on to the first while the rest is rendered; the first is done when the last of it has come: not before all bytes have been over its
/// link, and not before it has taken in all tiles.
fn predict(
    simulated: &Simulated<'_>,
    case: &Case,
    report: &Report,
    masters: u32,
    faults: &[Fault],
) -> Result<Prediction, CommandError> {
    if let Some(worker) = faults.iter().map(|fault| fault.worker()).find(|w| *w >= case.speeds.len()) {
        return Err(CommandError::Usage(format!(
            "--fault: there is no worker {worker} of {}",
            case.speeds.len()
        )));
    }
    let bands = bands(simulated.recorded, report.size[1], masters);
    let mut parts = Vec::new();
    for (number, &(first_row, height)) in bands.iter().enumerate() {
        let share = |i: usize| i * case.speeds.len() / bands.len();
        let own = share(number)..share(number + 1);
        let speeds = case.speeds[own.clone()].to_vec();
        let band = Case { speeds, ..case.clone() };
        let job = job([report.size[0], height], case.balance);
        let faults = faults.iter().filter(|fault| own.contains(&fault.worker()));
        let faults: Vec<_> = faults.map(|fault| fault.with_worker(fault.worker() - own.start)).collect();
        let frames = Simulated { first_row, ..*simulated }.run(&band, &job, WARM_UP + COUNTED, &faults)?;
        parts.push(frames[WARM_UP..].to_vec());
    }
    let mid = |values: Vec<f64>| median(&values).unwrap_or(f64::NAN);
    let of = |part: &Vec<Measured>| mid(part.iter().map(|frame| ms(frame.took)).collect());
    let slowest = parts.iter().map(of).fold(0.0, f64::max);
    let last = || parts.iter().filter_map(|part| part.last());
    let bytes: u64 = last().map(|frame| frame.bytes).sum();
    let tiles: u32 = last().map(|frame| frame.tiles).sum();
    let busiest = last().map(|frame| ms(frame.master.busy)).fold(0.0, f64::max);
    let (frame_ms, busiest) = if masters == 1 {
        (slowest, busiest)
    } else {
        let link_ms = case.link.mbit_up.map_or(0.0, |mbit| bytes as f64 * 8e-3 / mbit);
        let first_ms = f64::from(tiles) * ms(simulated.costs.master_tile);
        (slowest.max(link_ms).max(first_ms) + case.link.latency_ms, busiest.max(first_ms))
    };
    let work = Duration::from_secs_f64(report.one_worker_s) + simulated.launch * tiles;
    Ok(Prediction {
        workers: case.speeds.len(),
        balance: case.balance.name(),
        // Where rows do not suffice there are fewer.
        masters: bands.len() as u32,
        frame_ms,
        ideal_ms: ms(case.ideal(work, bytes)),
        efficiency: ms(work) / (case.speeds.iter().sum::<f64>() * frame_ms),
        bytes,
        tile: last().next().map_or(0, |frame| frame.tile),
        master_share: busiest / frame_ms,
    })
}

/// First row and height of `count` bands of the image that cost about the same; fewer where rows do not suffice.
fn bands(recorded: &Recorded, height: u32, count: u32) -> Vec<(u32, u32)> {
    let costs = recorded.row_costs();
    let total: f64 = costs.iter().sum();
    let (mut bands, mut first, mut sum) = (Vec::new(), 0, 0.0);
    for (row, cost) in (1..).zip(&costs) {
        sum += cost;
        let end = (row * Recorded::SIDE).min(height);
        if sum >= total * f64::from(bands.len() as u32 + 1) / f64::from(count) || end == height {
            bands.push((first, end - first));
            first = end;
        }
    }
    bands
}

fn job([width, height]: [u32; 2], balance: Balance) -> FrameJob {
    FrameJob {
        tile: if balance == Balance::Auto { 0 } else { FrameJob::TILE },
        coding: usual_coding(balance),
        balance,
        ..FrameJob::new(
            LocalCamera { origin: Vec3::ZERO, forward: -Vec3::Z, right: Vec3::X, up: Vec3::Y },
            width,
            height,
        )
    }
}

fn text(answer: &Answer) -> String {
    let mut out = format!(
        "{} on {}, simulated\n{:>8} {:>8} {:>14} {:>12} {:>12} {:>11} {:>9} {:>6} {:>12}\n",
        answer.scene,
        answer.link,
        "workers",
        "masters",
        "balancing",
        "ms a frame",
        "ideal ms",
        "efficiency",
        "master %",
        "tile",
        "bytes"
    );
    for p in &answer.predictions {
        out += &format!(
            "{:>8} {:>8} {:>14} {:>12.2} {:>12.2} {:>11.3} {:>9.1} {:>6} {:>12}\n",
            p.workers,
            p.masters,
            p.balance,
            p.frame_ms,
            p.ideal_ms,
            p.efficiency,
            100.0 * p.master_share,
            p.tile,
            p.bytes
        );
    }
    out += &match (answer.error_median, answer.error_largest) {
        (Some(median), Some(largest)) => format!(
            "In the {} cases that the report has measured, the simulator was off by {:.1} % (median), {:.1} % at most.\n",
            answer.cases,
            100.0 * median,
            100.0 * largest
        ),
        _ => "The report has measured nothing that the simulator could be held against.\n".to_owned(),
    };
    out
}
