//! `tessera why-slow`.

use super::CommandError;
use clap::Args;
use serde::Deserialize;
use std::fmt::Write;
use std::path::PathBuf;
use tessera_master::slow::{Advice, SlowReport, explain};
use tessera_master::trace::RunTrace;

/// What to explain.
#[derive(Debug, Args)]
#[command(
    long_about = "Say where the time of a measured run went, and the one change that would help most\n\n\
        Reads what render and demo write with --trace, and bench scale with --traces. Every moment of every worker is given to one of five: render (a tile of the image \
        was rendered), link (it waited for words or pixels on their way), imbalance (others had tiles that they had not begun), tail (it waited \
        for the last tile), master (the rest: handing out, putting together, what lies between two tiles). What a change would bring is estimated as if \
        nothing else changed.",
    after_help = "Examples:\n\
        \x20 tessera demo --trace trace.json && tessera why-slow trace.json\n\
        \x20 tessera why-slow trace.json --json"
)]
pub struct WhySlowArgs {
    /// A file that --trace or --traces has written
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

/// A file for trace viewers, which holds a run; or a run alone.
#[derive(Deserialize)]
#[serde(untagged)]
enum File {
    Trace { tessera: RunTrace },
    Run(RunTrace),
}

/// A trace of some ten million tiles; what is larger is none of ours.
const BYTES_MAX: u64 = 4 << 30;

pub fn run(args: &WhySlowArgs) -> Result<(), CommandError> {
    let of_file = |what: String| CommandError::Failed(format!("{}: {what}", args.file.display()));
    let length = std::fs::metadata(&args.file).map_err(|e| of_file(e.to_string()))?.len();
    if length > BYTES_MAX {
        return Err(of_file(format!("{length} bytes are too many for a trace")));
    }
    let bytes = std::fs::read(&args.file).map_err(|e| of_file(e.to_string()))?;
    let file: File = serde_json::from_slice(&bytes).map_err(|_| {
        of_file("this is no trace of a run; write one with `tessera render --trace FILE`".into())
    })?;
    let run = match file {
        File::Trace { tessera } => tessera,
        File::Run(run) => run,
    };
    let report = explain(&run).map_err(of_file)?;
    if args.json { super::print_json(&report) } else { super::print_text(&text(&run, &report)) }
}

fn text(run: &RunTrace, report: &SlowReport) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut text, run, report);
    text
}

fn write_text(t: &mut String, run: &RunTrace, report: &SlowReport) -> std::fmt::Result {
    let SlowReport { scene, frames, workers, frame_ms, shares, advice, others } = report;
    let [width, height] = run.size;
    writeln!(
        t,
        "run        {scene}: {frames} x {width} x {height}, tiles of {}, {workers} workers",
        run.tile
    )?;
    write!(t, "           {} balancing, {} pixels", run.balance, run.coding)?;
    match &run.link {
        Some(link) => writeln!(t, ", over {link}")?,
        None => writeln!(t)?,
    }
    writeln!(t, "frame      {frame_ms:.1} ms")?;
    for (name, share) in shares.each() {
        let bar = "#".repeat((40.0 * share).round() as usize);
        let line = format!("{name:<10} {:>5.1} %  {:>8.1} ms  {bar}", 100.0 * share, share * frame_ms);
        writeln!(t, "{}", line.trim_end())?;
    }
    let Advice { what, why, gain_ms, gain_share, .. } = advice;
    writeln!(t, "helps most {what}")?;
    writeln!(t, "           {why}")?;
    writeln!(t, "           a frame would take about {gain_ms:.1} ms less ({:.0} %)", 100.0 * gain_share)?;
    for other in others.iter().filter(|other| other.gain_share >= 0.05) {
        writeln!(t, "then       {}: about {:.1} ms", other.what, other.gain_ms)?;
    }
    Ok(())
}
