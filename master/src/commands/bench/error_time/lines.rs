//! What `tessera bench error-time` prints and writes: rows, and what follows from them.

use super::Clock;
use super::knob::Knob;
use super::measure::{Bytes, Outcome, Turned};
use super::pareto::{Tradeoff, fastest_within, front};
use crate::commands::bench::measure::median;
use crate::commands::fit::Fit;
use serde::Serialize;
use std::fmt::Write;
use tessera_master::compare::Comparison;

/// A measured setting: an object of `--json` and a line of the CSV file.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub knob: &'static str,
    pub series: String,
    pub value: String,
    pub number: Option<f64>,
    /// Seconds of a frame.
    pub wall_s: Spread,
    /// Of all threads of the process.
    pub cpu_s: Spread,
    pub rays: u64,
    pub samples_mean: f64,
    pub bytes: Bytes,
    /// From the truth.
    pub error: Comparison,
    /// From the frame of plain vertices.
    pub to_plain: Option<Comparison>,
    /// No other setting of the knob is at least as fast and at least as true, and better in one.
    pub on_front: bool,
    pub hash: String,
}

/// Of several measurements.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub median: f64,
    pub min: f64,
    pub max: f64,
}

impl Spread {
    /// Of values in ascending order, at least one.
    fn of(ascending: &[f64]) -> Self {
        Self { median: median(ascending), min: ascending[0], max: ascending[ascending.len() - 1] }
    }
}

/// What a knob has shown.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub knob: &'static str,
    pub what: &'static str,
    pub rows: Vec<Row>,
    pub time_to_error: Vec<TimeToError>,
    /// Of the error against the number of samples, by curve; empty for other knobs.
    pub rates: Vec<(String, Fit)>,
}

/// The headline: the fastest setting with an error of at most so much.
#[derive(Clone, Debug, Serialize)]
pub struct TimeToError {
    /// Root mean squared error of linear red, green and blue.
    pub rmse: f64,
    /// The row, if any is so good.
    pub row: Option<usize>,
    pub seconds: Option<f64>,
}

/// Errors whose times are asked for: half decades.
const ERRORS: [f64; 9] = [0.1, 0.03, 0.01, 0.003, 0.001, 0.000_3, 0.000_1, 0.000_03, 0.000_01];

impl Summary {
    /// Of what was measured, by `clock`.
    pub fn of(turned: &Turned, clock: Clock, truth_spp: u32) -> Self {
        let mut rows: Vec<Row> =
            turned.outcomes.iter().map(|outcome| Row::of(turned.knob, outcome)).collect();
        let all: Vec<Tradeoff> = rows
            .iter()
            .map(|row| Tradeoff { time: row.seconds(clock).median, error: row.error.rmse })
            .collect();
        // Curves that show other things (with mirrors, without) are not to be chosen from.
        let is_rival = |row: &Row, other: &Row| turned.knob != Knob::Packed || row.series == other.series;
        for place in 0..rows.len() {
            let rivals: Vec<_> =
                (0..rows.len()).filter(|&other| is_rival(&rows[place], &rows[other])).collect();
            let front = front(&rivals.iter().map(|&rival| all[rival]).collect::<Vec<_>>());
            rows[place].on_front = rivals.iter().zip(front).any(|(rival, is_on)| *rival == place && is_on);
        }
        let first = rows.iter().take_while(|row| is_rival(&rows[0], row)).count();
        let time_to_error = ERRORS
            .into_iter()
            .map(|rmse| {
                let row = fastest_within(&all[..first], rmse);
                TimeToError { rmse, row, seconds: row.map(|row| all[row].time) }
            })
            .collect();
        let rates = if turned.knob == Knob::Spp { rates(&rows, truth_spp) } else { Vec::new() };
        Self { knob: turned.knob.name(), what: turned.knob.what(), rows, time_to_error, rates }
    }
}

impl Row {
    fn of(knob: Knob, outcome: &Outcome) -> Self {
        let rays = outcome.rays;
        let pixels = f64::from(outcome.error.width) * f64::from(outcome.error.height);
        Self {
            knob: knob.name(),
            series: outcome.setting.series.clone(),
            value: outcome.setting.value.clone(),
            number: outcome.setting.number,
            wall_s: Spread::of(&outcome.wall_s),
            cpu_s: Spread::of(&outcome.cpu_s),
            rays: rays.primary + rays.shadow + rays.reflection + rays.refraction,
            samples_mean: rays.primary as f64 / pixels,
            bytes: outcome.bytes,
            error: outcome.error,
            to_plain: outcome.to_plain,
            on_front: false,
            hash: outcome.hash.clone(),
        }
    }

    /// By the clock that the fronts go by.
    pub fn seconds(&self, clock: Clock) -> Spread {
        match clock {
            Clock::Wall => self.wall_s,
            Clock::Cpu => self.cpu_s,
        }
    }
}

/// What an image's error falls by, as a power of the number of samples: a pixel with an edge in it is crossed by about n^(1/2) of its n
/// cells, each wrong by about 1/n, so that its error is n^(1/4) / n (Mitchell 1996, "Consequences of Stratified Sampling in Graphics").
/// Smooth pixels fall faster and count for nothing beside them.
pub const EDGE_RATE: f64 = -0.75;

/// How the error falls with the number of samples, curve by curve: from two samples, for one lies in the centre and is of no sampler, to an
/// eighth of the truth's, whose own error at that rate is then a fifth of what is measured and adds 2 % to it.
fn rates(rows: &[Row], truth_spp: u32) -> Vec<(String, Fit)> {
    let mut names: Vec<&str> = rows.iter().map(|row| row.series.as_str()).collect();
    names.dedup();
    let samples = 2.0..=f64::from(truth_spp / 8);
    let of = |name: &str| {
        let curve = rows.iter().filter(|row| row.series == name);
        let points = curve.filter_map(|row| Some((row.number?, row.error.rmse)));
        let is_of_it = |(n, error): &(f64, f64)| samples.contains(n) && *error > 0.0;
        Fit::of(&points.filter(is_of_it).collect::<Vec<_>>())
    };
    names.into_iter().filter_map(|name| Some((name.to_owned(), of(name)?))).collect()
}

/// The tables for people.
pub fn text(summary: &Summary, clock: Clock) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, summary, clock);
    out
}

/// Columns of tables, on stdout and on the page.
pub const COLUMNS: [&str; 13] = [
    "curve",
    "setting",
    "ms",
    "from",
    "to",
    "RMSE",
    "PSNR linear",
    "PSNR sRGB",
    "SSIM",
    "FLIP",
    "other triangle",
    "KiB",
    "to plain",
];

/// A row of tables.
pub fn cells(row: &Row, clock: Clock) -> [String; 13] {
    let ms = |seconds: f64| format!("{:.1}", seconds * 1e3);
    let time = row.seconds(clock);
    let db = |value: Option<f64>| value.map_or_else(|| "equal".into(), |db| format!("{db:.2}"));
    let or_dash =
        |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    let error = &row.error;
    [
        row.series.clone(),
        if row.on_front { format!("{} *", row.value) } else { row.value.clone() },
        ms(time.median),
        ms(time.min),
        ms(time.max),
        format!("{:.3e}", error.rmse),
        db(error.psnr_linear_db),
        db(error.psnr_srgb_db),
        or_dash(error.ssim, 5),
        format!("{:.5}", error.flip),
        error.wrong_id_share.map_or_else(|| "-".into(), |share| format!("{:.3} %", share * 100.0)),
        format!("{:.0}", row.bytes.pack as f64 / 1024.0),
        row.to_plain.map_or_else(|| "-".into(), |to_plain| db(to_plain.psnr_db)),
    ]
}

fn write_text(t: &mut String, summary: &Summary, clock: Clock) -> std::fmt::Result {
    writeln!(t, "\n{}: {}", summary.knob, summary.what)?;
    let rows: Vec<_> = summary.rows.iter().map(|row| cells(row, clock)).collect();
    let widths: Vec<usize> = (0..COLUMNS.len())
        .map(|column| {
            let cells = rows.iter().map(|row| row[column].chars().count());
            cells.chain([COLUMNS[column].len()]).max().unwrap_or(0)
        })
        .collect();
    let mut line = |cells: &[&str]| {
        let padded: Vec<_> = cells
            .iter()
            .zip(&widths)
            .enumerate()
            .map(
                |(column, (cell, width))| {
                    if column < 2 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
                },
            )
            .collect();
        writeln!(t, "  {}", padded.join("  ").trim_end())
    };
    line(&COLUMNS)?;
    for row in &rows {
        line(&row.each_ref().map(String::as_str))?;
    }
    for (name, rate) in &summary.rates {
        writeln!(
            t,
            "  RMSE falls as samples to the power of {rate} (95 %), in theory {EDGE_RATE} at edges: {name}"
        )?;
    }
    for found in summary.time_to_error.iter().filter(|found| found.row.is_some()) {
        if let (Some(row), Some(seconds)) = (found.row, found.seconds) {
            let row = &summary.rows[row];
            writeln!(
                t,
                "  RMSE <= {:<7} in {:>9.1} ms: {} {}",
                found.rmse,
                seconds * 1e3,
                row.series,
                row.value
            )?;
        }
    }
    Ok(())
}

/// The header and the rows of the CSV file.
pub fn csv(scene: &str, summaries: &[Summary]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let header = vec![
        "scene",
        "knob",
        "series",
        "value",
        "number",
        "wall_s_median",
        "wall_s_min",
        "wall_s_max",
        "cpu_s_median",
        "cpu_s_min",
        "cpu_s_max",
        "rays",
        "samples_mean",
        "bytes_pack",
        "bytes_mesh",
        "bytes_tree",
        "rmse",
        "mse",
        "psnr_linear_db",
        "psnr_srgb_db",
        "ssim",
        "flip",
        "max_abs",
        "differing_share",
        "wrong_id_share",
        "psnr_to_plain_db",
        "on_front",
        "hash",
    ];
    let rows = summaries.iter().flat_map(|summary| &summary.rows).map(|row| {
        let or_empty = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let error = &row.error;
        vec![
            scene.to_owned(),
            row.knob.into(),
            row.series.clone(),
            row.value.clone(),
            or_empty(row.number),
            row.wall_s.median.to_string(),
            row.wall_s.min.to_string(),
            row.wall_s.max.to_string(),
            row.cpu_s.median.to_string(),
            row.cpu_s.min.to_string(),
            row.cpu_s.max.to_string(),
            row.rays.to_string(),
            row.samples_mean.to_string(),
            row.bytes.pack.to_string(),
            row.bytes.mesh.to_string(),
            row.bytes.tree.to_string(),
            error.rmse.to_string(),
            error.mse.to_string(),
            or_empty(error.psnr_linear_db),
            or_empty(error.psnr_srgb_db),
            or_empty(error.ssim),
            error.flip.to_string(),
            error.max_abs.to_string(),
            error.differing_share.to_string(),
            or_empty(error.wrong_id_share),
            or_empty(row.to_plain.and_then(|to_plain| to_plain.psnr_db)),
            row.on_front.to_string(),
            row.hash.clone(),
        ]
    });
    let rows = rows.collect();
    (header, rows)
}
