//! The page of `tessera bench error-time`: plots, the tables behind them, and what to know about them.

use super::knob::{Knob, Look};
use super::lines::{COLUMNS, EDGE_RATE, Row, Summary, cells};
use super::measure::{Extreme, Extremes, Turned};
use super::{Clock, ErrorTimeArgs};
use crate::commands::CommandError;
use crate::commands::page::{
    Axis, Line, Page, PageSection, Picture, Plot, Point, Scale, Series, Table, machine,
};
use tessera_geometry::srgb_from_linear;
use tessera_master::compare::{Picture as Pixels, error_picture};
use tessera_master::{FrameBuffer, PixelFormat};

/// What a page is about.
pub struct Facts<'a> {
    pub args: &'a ErrorTimeArgs,
    pub scene: &'a str,
    pub triangles: usize,
    pub camera: &'a str,
    pub look: &'a Look,
    pub command: String,
    /// Seconds that taking the time takes.
    pub clock_s: f64,
    /// Seconds of the fastest frame.
    pub fastest_s: f64,
    /// The largest of [`Turned::harness_share`].
    pub harness_share: f64,
}

/// The page of all knobs that were turned.
pub fn page(facts: &Facts<'_>, turned: &[Turned], summaries: &[Summary]) -> Result<Page, CommandError> {
    let size = facts.args.size;
    let sections = turned.iter().zip(summaries).map(|(turned, summary)| section(turned, summary, facts));
    let mut sections = sections.collect::<Result<Vec<_>, _>>()?;
    let first = turned.first().and_then(|turned| turned.extremes.best.as_ref());
    if let (Some(section), Some(first)) = (sections.first_mut(), first) {
        let caption = "what the oracle sees: the truth of the first knob".into();
        let png = png(&first.truth, codes(&first.truth))?;
        section.pictures.insert(0, Picture { name: "truth".into(), caption, png });
    }
    Ok(Page {
        title: format!("Error against run time: {}", facts.scene),
        summary: vec![
            format!(
                "{} triangles, camera {}, {} x {} pixels, depth {}, frames measured of each setting: {}, after one to warm up, all settings of a \
                 knob in turn.",
                facts.triangles, facts.camera, size.width, size.height, facts.look.depth, facts.args.reps
            ),
            "Errors are root mean squared differences of linear red, green and blue, clamped to [0, 1] as they are shown, from the picture of an f64 tracer over the scene as \
             its file states it. A star marks settings that no other of the knob beats in both time and error."
                .into(),
        ],
        sections,
        commands: vec![facts.command.clone()],
        machine: machine(),
        caveats: caveats(facts),
    })
}

fn caveats(facts: &Facts<'_>) -> Vec<String> {
    let share = 100.0 * facts.clock_s / facts.fastest_s.max(f64::MIN_POSITIVE);
    let clock = match facts.args.clock {
        Clock::Wall => "Times are wall time; what else the machine does is in them, and shows in the spread.",
        Clock::Cpu => "Times are CPU time of all threads of this process; what waits is not in them.",
    };
    vec![
        clock.into(),
        "The clock runs from a packed scene in memory to an 8-bit frame in memory: not reading, packing, uploading, compiling and writing. \
         For tiles it also holds the protocol and the worker that answers to it."
            .into(),
        format!(
            "Taking the time takes {:.2} us, {share:.4} % of the fastest frame; between the measured frames the harness took {:.2} % of \
             their time.",
            facts.clock_s * 1e6,
            100.0 * facts.harness_share
        ),
        "\"to plain\" is the PSNR of 8-bit pictures to the frame of plain vertices, as the paper's Table 4 compares; its view and light are others."
            .into(),
        "All samples are of one seed, all of one view.".into(),
        "Errors are of linear light clamped to [0, 1], before it is coded in 8 bits; PSNR in sRGB is of the same values coded, unrounded."
            .into(),
        "The truth takes its own samples, not those of the frame; with one sample both take the pixel's centre.".into(),
        "Figures hold for this scene, view and machine; only ratios carry over.".into(),
    ]
}

fn section(turned: &Turned, summary: &Summary, facts: &Facts<'_>) -> Result<PageSection, CommandError> {
    let clock = facts.args.clock;
    let mut text = vec![summary.what.to_owned()];
    text.extend(summary.rates.iter().map(|(name, rate)| {
        format!(
            "{name}: the error falls as the samples to the power of {rate} (95 % confidence from the scatter of the points about their line); \
             theory says {EDGE_RATE} where edges decide."
        )
    }));
    let headline: Vec<_> = summary
        .time_to_error
        .iter()
        .filter_map(|found| {
            let row = &summary.rows[found.row?];
            Some(format!(
                "RMSE <= {} in {:.1} ms ({} {})",
                found.rmse,
                found.seconds? * 1e3,
                row.series,
                row.value
            ))
        })
        .collect();
    if !headline.is_empty() {
        text.push(format!("Time to error: {}.", headline.join("; ")));
    }
    Ok(PageSection {
        title: turned.knob.title().into(),
        text,
        plot: Some(plot(turned.knob, summary, clock)),
        pictures: pictures(turned)?,
        table: Some(table(summary, clock)),
    })
}

/// Error over time, each curve and the front.
pub fn plot(knob: Knob, summary: &Summary, clock: Clock) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    for row in &summary.rows {
        if series.iter().all(|curve| curve.name != row.series) {
            series.push(Series { name: row.series.clone(), points: Vec::new(), line: Line::Joined });
        }
        if let Some(curve) = series.iter_mut().find(|curve| curve.name == row.series) {
            curve.points.push(point(row, clock));
        }
    }
    let chosen_from =
        |row: &&Row| row.on_front && (knob != Knob::Packed || row.series == summary.rows[0].series);
    let mut front: Vec<_> = summary.rows.iter().filter(chosen_from).map(|row| point(row, clock)).collect();
    front.sort_by(|a, b| a.x.total_cmp(&b.x));
    for point in &mut front {
        (point.x_range, point.label) = (None, String::new());
    }
    series.push(Series { name: "Pareto front".into(), points: front, line: Line::Stepped });
    let time = match clock {
        Clock::Wall => "wall time of a frame, ms",
        Clock::Cpu => "CPU time of a frame, ms",
    };
    Plot {
        title: format!("{}: error against run time", knob.title()),
        x: Axis { label: time.into(), scale: Scale::Log },
        y: Axis { label: "RMSE of linear red, green, blue".into(), scale: Scale::Log },
        series,
    }
}

fn point(row: &Row, clock: Clock) -> Point {
    let time = row.seconds(clock);
    Point {
        x: time.median * 1e3,
        y: row.error.rmse,
        x_range: Some((time.min * 1e3, time.max * 1e3)),
        y_range: None,
        label: row.value.clone(),
    }
}

fn table(summary: &Summary, clock: Clock) -> Table {
    let columns: Vec<String> = COLUMNS.map(str::to_owned).into();
    let numeric = (0..columns.len()).map(|column| column >= 2).collect();
    Table { columns, rows: summary.rows.iter().map(|row| cells(row, clock).into()).collect(), numeric }
}

/// Where the worst and the best setting are wrong.
fn pictures(turned: &Turned) -> Result<Vec<Picture>, CommandError> {
    let Extremes { best, worst } = &turned.extremes;
    let differs = |best: &&Extreme| worst.as_ref().is_some_and(|worst| worst.rmse > best.rmse);
    let of = |(what, extreme): (&str, &Extreme)| {
        let caption = format!(
            "where {}, the {what} setting, can be seen to be wrong: FLIP, black for nowhere, pale yellow for all",
            extreme.setting
        );
        let map = error_picture(&extreme.truth, &extreme.picture).map_err(CommandError::failed)?;
        Ok(Picture { name: format!("{} {what}", turned.knob), caption, png: png(&extreme.truth, map)? })
    };
    let worst = worst.as_ref().map(|worst| ("worst", worst));
    let best = best.as_ref().filter(differs).map(|best| ("best", best));
    worst.into_iter().chain(best).map(of).collect()
}

/// A linear picture in 8-bit sRGB codes: red, green and blue.
fn codes(picture: &Pixels) -> Vec<u8> {
    let [red, green, blue] = &picture.channels;
    let code = |light: &f32| (srgb_from_linear(f64::from(*light).clamp(0.0, 1.0)) * 255.0).round() as u8;
    red.iter().zip(green).zip(blue).flat_map(|((r, g), b)| [code(r), code(g), code(b)]).collect()
}

/// A PNG file of red, green and blue codes, as large as `picture`.
fn png(picture: &Pixels, rgb: Vec<u8>) -> Result<Vec<u8>, CommandError> {
    let rgba = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
    let buffer = FrameBuffer::from_rows(picture.width, picture.height, PixelFormat::Rgba8, rgba);
    buffer.map_err(CommandError::failed)?.to_png().map_err(CommandError::failed)
}
