//! `tessera bench what-if`: what a measured scene would take other clusters.

use super::args::{balances, chosen_balances};
use super::case::{Case, median, ms};
use super::devices;
use super::link::LinkProfile;
use super::recorded::Recorded;
use super::report::{Report, prediction_error};
use super::sim::Costs;
use super::simulated::Simulated;
use crate::commands::{CommandError, print_json, print_text};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;
use tessera_geometry::{LocalCamera, Vec3};
use tessera_master::{Balance, FrameJob, PixelFormat};
use tessera_wire::{Features, Sampling};

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
    /// Print one JSON object on stdout
    #[arg(long)]
    pub json: bool,
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
    frame_ms: f64,
    ideal_ms: f64,
    /// Time of one device of speed 1 over the sum of speeds times this.
    efficiency: f64,
    bytes: u64,
    tile: u32,
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
    let simulated = Simulated { recorded: &recorded, scale, launch, costs: Costs::default() };
    let mut predictions = Vec::new();
    for &workers in &args.workers {
        let speeds = devices::speeds(&args.device_speed, workers as usize).map_err(CommandError::Usage)?;
        for &balance in &balances {
            let case = Case { link: link.clone(), balance, speeds: speeds.clone() };
            predictions.push(predict(&simulated, &case, report.size, report.one_worker_s)?);
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

fn predict(
    simulated: &Simulated<'_>,
    case: &Case,
    [width, height]: [u32; 2],
    one_worker_s: f64,
) -> Result<Prediction, CommandError> {
    let job = FrameJob {
        camera: LocalCamera { origin: Vec3::ZERO, forward: -Vec3::Z, right: Vec3::X, up: Vec3::Y },
        width,
        height,
        tile: if case.balance == Balance::Auto { 0 } else { 128 },
        samples: 1,
        sampling: Sampling::default(),
        depth: 8,
        seed: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
        balance: case.balance,
        mix: false,
        coding: None,
    };
    let frames = simulated.run(case, &job, WARM_UP + COUNTED, &[])?;
    let counted = &frames[WARM_UP..];
    let mid = |values: Vec<f64>| median(&values).unwrap_or(f64::NAN);
    let frame_ms = mid(counted.iter().map(|frame| ms(frame.took)).collect());
    let bytes = counted.last().map_or(0, |frame| frame.bytes);
    let work = Duration::from_secs_f64(one_worker_s);
    Ok(Prediction {
        workers: case.speeds.len(),
        balance: case.balance.name(),
        frame_ms,
        ideal_ms: ms(case.ideal(work, bytes)),
        efficiency: 1e3 * one_worker_s / (case.speeds.iter().sum::<f64>() * frame_ms),
        bytes,
        tile: counted.last().map_or(0, |frame| frame.tile),
    })
}

fn text(answer: &Answer) -> String {
    let mut out = format!(
        "{} on {}, simulated\n{:>8} {:>14} {:>12} {:>12} {:>11} {:>6} {:>12}\n",
        answer.scene,
        answer.link,
        "workers",
        "balancing",
        "ms a frame",
        "ideal ms",
        "efficiency",
        "tile",
        "bytes"
    );
    for p in &answer.predictions {
        out += &format!(
            "{:>8} {:>14} {:>12.2} {:>12.2} {:>11.3} {:>6} {:>12}\n",
            p.workers, p.balance, p.frame_ms, p.ideal_ms, p.efficiency, p.tile, p.bytes
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
