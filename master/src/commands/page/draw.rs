//! Where everything of a plot stands, once for all canvases.

use super::axis::{Span, Tick, has_place, number};
use super::canvas::{Anchor, Canvas, Ink, Place, Stroke, Text};
use super::font::{shortened, width};
use super::labels::{self, Rect};
use super::plot::{Axis, Line, Plot, Point, Scale, Series};

/// Width of every plot, and the height of one whose legend does not stand below it.
pub const WIDTH: f64 = 960.0;
const HEIGHT: f64 = 600.0;
/// Around the whole.
const MARGIN: f64 = 20.0;
const TITLE_SIZE: f64 = 18.0;
const TEXT_SIZE: f64 = 13.0;
const SMALL_SIZE: f64 = 11.0;
/// Between base lines of a legend, and from the start of a sample to the name.
const LEGEND_LINE: f64 = 21.0;
const LEGEND_INDENT: f64 = 42.0;
/// Names up to this stand at the right of the plot.
const LEGEND_RIGHT_MAX: f64 = 215.0;
/// A legend names no more series than this; it says how many follow.
const LEGEND_ENTRIES_MAX: usize = 48;
const MARKER_RADIUS: f64 = 4.5;
/// Of the points of a front, around markers.
const RING_RADIUS: f64 = 7.5;
/// Labels tried; where so many stand there is no room for more.
const LABELS_MAX: usize = 200;

/// A plot with all its places.
pub struct Layout<'a> {
    plot: &'a Plot,
    pub width: f64,
    pub height: f64,
    /// Left, top, right and bottom of the area of the points.
    area: Rect,
    x: Span,
    y: Span,
    x_ticks: Vec<Tick>,
    y_ticks: Vec<Tick>,
    shown: Vec<Vec<Shown<'a>>>,
    legend: Legend,
    note: Option<String>,
}

/// A point that has a place.
struct Shown<'a> {
    point: &'a Point,
    place: Place,
    /// Ends of the error bars, and whether each is a measured end (with a cap) or the edge of the plot.
    across: Option<[(f64, bool); 2]>,
    along: Option<[(f64, bool); 2]>,
}

/// Names of the series, and what is left for the plot.
struct Legend {
    /// Left end of the sample and base line of the name, and the name.
    entries: Vec<(Place, String)>,
    /// Where the area of the points ends.
    area_right: f64,
    /// Of the whole.
    height: f64,
}

impl<'a> Layout<'a> {
    pub fn new(plot: &'a Plot) -> Self {
        let points = || plot.series.iter().flat_map(|series| &series.points).filter(|p| is_shown(plot, p));
        let ends = |range: Option<(f64, f64)>| range.map(|(a, b)| [a, b]).into_iter().flatten();
        let x = Span::around(plot.x.scale, points().flat_map(|p| ends(p.x_range).chain([p.x])));
        let y = Span::around(plot.y.scale, points().flat_map(|p| ends(p.y_range).chain([p.y])));
        let y_ticks = y.ticks(8);
        let tick_widths = y_ticks.iter().filter_map(|tick| Some(width(tick.label.as_ref()?, TEXT_SIZE)));
        let left = MARGIN + TEXT_SIZE + 14.0 + tick_widths.fold(0.0, f64::max) + 8.0;
        let note = left_out(plot);
        let below_area = 52.0 + if note.is_some() { 20.0 } else { 0.0 };

        let top = MARGIN + if plot.title.is_empty() { 0.0 } else { 34.0 };
        let bottom = HEIGHT - MARGIN - below_area;
        let legend = Legend::new(legend_names(plot), top, bottom);
        let area = Rect { left, top, right: legend.area_right, bottom };

        let x_ticks = x.ticks(((area.right - area.left) / 90.0) as usize);
        let shown = Vec::new();
        let mut layout = Self {
            plot,
            width: WIDTH,
            height: legend.height,
            area,
            x,
            y,
            x_ticks,
            y_ticks,
            shown,
            legend,
            note,
        };
        for series in &plot.series {
            let shown = series.points.iter().filter(|point| is_shown(plot, point));
            layout.shown.push(shown.map(|point| layout.shown(point)).collect());
        }
        layout
    }

    pub fn title(&self) -> &str {
        &self.plot.title
    }

    /// What the plot shows, in words.
    pub fn description(&self) -> String {
        let Plot { x, y, series, .. } = self.plot;
        let names: Vec<_> = series.iter().map(|series| series.name.as_str()).collect();
        let scale = |axis: &Axis| if axis.scale == Scale::Log { ", logarithmic" } else { "" };
        format!("{}{} against {}{}; series: {}", y.label, scale(y), x.label, scale(x), names.join("; "))
    }

    /// Draws it all: what lies behind first.
    pub fn draw(&self, canvas: &mut dyn Canvas) {
        self.draw_axes(canvas);
        for (k, series) in self.plot.series.iter().enumerate() {
            self.draw_line(canvas, k, series.line);
        }
        // Rings around measured points leave those in view, so theirs come last.
        for is_ring in [false, true] {
            for (k, series) in self.plot.series.iter().enumerate() {
                if (series.line == Line::Stepped) == is_ring {
                    self.draw_points(canvas, k, series);
                }
            }
        }
        self.draw_labels(canvas);
        self.draw_legend(canvas);
        let size = SMALL_SIZE;
        if let Some(note) = &self.note {
            let text = shortened(note, size, WIDTH - 2.0 * MARGIN);
            let place = (MARGIN, HEIGHT - MARGIN + 2.0);
            text_at(canvas, &text, place, size, Ink::Quiet, Anchor::Start);
        }
        if self.shown.iter().all(Vec::is_empty) {
            let middle = ((self.area.left + self.area.right) / 2.0, (self.area.top + self.area.bottom) / 2.0);
            text_at(canvas, "nothing to show", middle, TEXT_SIZE, Ink::Quiet, Anchor::Middle);
        }
    }

    fn draw_axes(&self, canvas: &mut dyn Canvas) {
        let Rect { left, top, right, bottom } = self.area;
        let grid = |tick: &Tick| match tick.label {
            Some(_) => Stroke::plain(Ink::Grid, 1.0),
            None => Stroke::plain(Ink::FineGrid, 1.0),
        };
        // Fine lines lie under the others.
        for is_labelled in [false, true] {
            for tick in self.x_ticks.iter().filter(|tick| tick.label.is_some() == is_labelled) {
                let x = self.x_at(tick.part);
                canvas.polyline(&[(x, top), (x, bottom)], grid(tick));
            }
            for tick in self.y_ticks.iter().filter(|tick| tick.label.is_some() == is_labelled) {
                let y = self.y_at(tick.part);
                canvas.polyline(&[(left, y), (right, y)], grid(tick));
            }
        }
        canvas.polyline(&[(left, top), (left, bottom), (right, bottom)], Stroke::plain(Ink::Quiet, 1.2));
        let mut free_from = f64::NEG_INFINITY;
        for (tick, label) in self.x_ticks.iter().filter_map(|tick| Some((tick, tick.label.as_ref()?))) {
            let (x, half) = (self.x_at(tick.part), width(label, TEXT_SIZE) / 2.0);
            if x - half > free_from {
                text_at(canvas, label, (x, bottom + 19.0), TEXT_SIZE, Ink::Text, Anchor::Middle);
                free_from = x + half + 6.0;
            }
        }
        for (tick, label) in self.y_ticks.iter().filter_map(|tick| Some((tick, tick.label.as_ref()?))) {
            let place = (left - 8.0, self.y_at(tick.part) + 0.36 * TEXT_SIZE);
            text_at(canvas, label, place, TEXT_SIZE, Ink::Text, Anchor::End);
        }
        let title = shortened(&self.plot.title, TITLE_SIZE, WIDTH - 2.0 * MARGIN);
        canvas.text(&Text {
            is_bold: true,
            ..plain_text(&title, (MARGIN, MARGIN + 14.0), TITLE_SIZE, Ink::Text, Anchor::Start)
        });
        let label = shortened(&self.plot.x.label, TEXT_SIZE, WIDTH - 2.0 * MARGIN);
        // In the middle of the axis, unless it is so long that it would leave the picture.
        let half = width(&label, TEXT_SIZE) / 2.0;
        let middle = ((left + right) / 2.0).clamp(MARGIN + half, (WIDTH - MARGIN - half).max(MARGIN + half));
        text_at(canvas, &label, (middle, bottom + 43.0), TEXT_SIZE, Ink::Text, Anchor::Middle);
        // Not up to the title, and not down to what stands below the x label.
        let (upper, lower) = (top, bottom + 30.0);
        let label = shortened(&self.plot.y.label, TEXT_SIZE, lower - upper);
        let half = width(&label, TEXT_SIZE) / 2.0;
        let middle = ((top + bottom) / 2.0).clamp(upper + half, (lower - half).max(upper + half));
        canvas.text(&Text {
            is_upright: true,
            ..plain_text(&label, (MARGIN + 8.0, middle), TEXT_SIZE, Ink::Text, Anchor::Middle)
        });
    }

    fn draw_line(&self, canvas: &mut dyn Canvas, k: usize, line: Line) {
        let places = self.line_places(k);
        if places.len() > 1 {
            let width = if line == Line::Stepped { 2.5 } else { 1.6 };
            canvas.polyline(
                &places,
                Stroke { is_dashed: line == Line::Dashed, ..Stroke::plain(Ink::Series(k), width) },
            );
        }
    }

    /// Corners of the line of series `k`.
    fn line_places(&self, k: usize) -> Vec<Place> {
        let mut places: Vec<_> = self.shown[k].iter().map(|shown| shown.place).collect();
        match self.plot.series[k].line {
            Line::None => Vec::new(),
            Line::Joined | Line::Dashed => places,
            Line::Stepped => {
                places.sort_by(|a, b| a.0.total_cmp(&b.0));
                // What is reached at one x holds until the next.
                let steps = places.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
                steps.chain(places.last().copied()).collect()
            }
        }
    }

    fn draw_points(&self, canvas: &mut dyn Canvas, k: usize, series: &Series) {
        let ink = Ink::Series(k);
        for shown in &self.shown[k] {
            canvas.begin(&hover(self.plot, series, shown.point));
            for bar in shown.bars() {
                canvas.polyline(&bar, Stroke::plain(ink, 1.2));
            }
            match series.line {
                // A line needs two points to be seen.
                Line::Dashed if self.shown[k].len() > 1 => {}
                Line::Stepped => canvas.circle(shown.place, RING_RADIUS, None, Stroke::plain(ink, 1.8)),
                _ => draw_marker(canvas, shown.place, k),
            }
            canvas.end();
        }
    }

    /// Labels stand beside their points where they cover nothing.
    fn draw_labels(&self, canvas: &mut dyn Canvas) {
        let points = || self.shown.iter().flatten();
        let mut taken = Vec::new();
        for (series, shown) in self.plot.series.iter().zip(&self.shown) {
            let radius = if series.line == Line::Stepped { RING_RADIUS } else { MARKER_RADIUS } + 1.0;
            taken.extend(shown.iter().map(|shown| Rect::around(shown.place, radius, radius)));
        }
        let bars = points().flat_map(|shown| shown.bars());
        let lines = (0..self.shown.len()).map(|k| self.line_places(k));
        let mut segments = Vec::new();
        for places in bars.map(Vec::from).chain(lines) {
            segments.extend(places.windows(2).map(|pair| [pair[0], pair[1]]));
        }
        let labelled = points().filter(|shown| !shown.point.label.is_empty());
        for shown in labelled.take(LABELS_MAX) {
            let size = (width(&shown.point.label, SMALL_SIZE), 0.75 * SMALL_SIZE);
            // Beside it, or a little further off where its own error bars are in the way.
            let room = [MARKER_RADIUS + 4.0, MARKER_RADIUS + 10.0].into_iter().find_map(|distance| {
                labels::room_for(size, shown.place, distance, &self.area, &taken, &segments)
            });
            if let Some(rect) = room {
                let place = (rect.left, rect.bottom);
                text_at(canvas, &shown.point.label, place, SMALL_SIZE, Ink::Quiet, Anchor::Start);
                taken.push(rect);
            }
        }
    }

    fn draw_legend(&self, canvas: &mut dyn Canvas) {
        for (k, (place, name)) in self.legend.entries.iter().enumerate() {
            let (x, y) = (place.0, place.1 - 0.36 * TEXT_SIZE);
            // The last entry may say how many are not named.
            if let Some(series) = self.plot.series.get(k).filter(|_| k < LEGEND_ENTRIES_MAX) {
                let ink = Ink::Series(k);
                let line = Stroke { is_dashed: series.line == Line::Dashed, ..Stroke::plain(ink, 1.6) };
                if series.line != Line::None {
                    canvas.polyline(&[(x, y), (x + 32.0, y)], line);
                }
                match series.line {
                    Line::Dashed => {}
                    Line::Stepped => canvas.circle(
                        (x + 16.0, y),
                        RING_RADIUS - 1.0,
                        Some(Ink::Paper),
                        Stroke::plain(ink, 1.8),
                    ),
                    _ => draw_marker(canvas, (x + 16.0, y), k),
                }
            }
            text_at(canvas, name, (x + LEGEND_INDENT, place.1), TEXT_SIZE, Ink::Text, Anchor::Start);
        }
    }

    fn x_at(&self, part: f64) -> f64 {
        self.area.left + part * (self.area.right - self.area.left)
    }

    fn y_at(&self, part: f64) -> f64 {
        self.area.bottom - part * (self.area.bottom - self.area.top)
    }

    fn shown(&self, point: &'a Point) -> Shown<'a> {
        let end = |axis: &Axis, span: &Span, value: f64| match has_place(axis.scale, value) {
            true => (span.part(value), true),
            false => (if value > 0.0 { 1.0 } else { 0.0 }, false),
        };
        let bar = |axis: &Axis, span: &Span, range: Option<(f64, f64)>| {
            let (a, b) = range.filter(|(a, b)| !a.is_nan() && !b.is_nan())?;
            Some([end(axis, span, a), end(axis, span, b)])
        };
        let across = bar(&self.plot.x, &self.x, point.x_range);
        let along = bar(&self.plot.y, &self.y, point.y_range);
        Shown {
            point,
            place: (self.x_at(self.x.part(point.x)), self.y_at(self.y.part(point.y))),
            across: across.map(|ends| ends.map(|(part, has_cap)| (self.x_at(part), has_cap))),
            along: along.map(|ends| ends.map(|(part, has_cap)| (self.y_at(part), has_cap))),
        }
    }
}

impl Legend {
    /// At the right of an area from `top` to `bottom` if the names are short and few enough, else in columns below everything.
    fn new(names: Vec<String>, top: f64, bottom: f64) -> Self {
        const GAP: f64 = 18.0;
        const ALL: f64 = WIDTH - 2.0 * MARGIN;
        let widest = names.iter().map(|name| width(name, TEXT_SIZE)).fold(0.0, f64::max);
        let is_at_right = widest <= LEGEND_RIGHT_MAX && names.len() as f64 * LEGEND_LINE <= bottom - top;
        let column = (LEGEND_INDENT + widest + GAP).min(ALL);
        let (area_right, start, columns) = match is_at_right && !names.is_empty() {
            true => (WIDTH - MARGIN - column, (WIDTH - MARGIN - column + GAP, top + 12.0), 1),
            false => (WIDTH - MARGIN - 10.0, (MARGIN, HEIGHT + 4.0), ((ALL / column) as usize).max(1)),
        };
        // Down the columns, as one reads a list.
        let lines = names.len().div_ceil(columns);
        let entry = |(k, name): (usize, String)| {
            let place = (start.0 + (k / lines) as f64 * column, start.1 + (k % lines) as f64 * LEGEND_LINE);
            (place, shortened(&name, TEXT_SIZE, ALL - LEGEND_INDENT))
        };
        let height = if is_at_right { HEIGHT } else { HEIGHT + lines as f64 * LEGEND_LINE };
        Self { entries: names.into_iter().enumerate().map(entry).collect(), area_right, height }
    }
}

impl Shown<'_> {
    /// Lines of the error bars and of their caps.
    fn bars(&self) -> Vec<[Place; 2]> {
        const CAP: f64 = 3.0;
        let (x, y) = self.place;
        let mut lines = Vec::new();
        if let Some(ends) = self.across {
            lines.push([(ends[0].0, y), (ends[1].0, y)]);
            let caps = ends.iter().filter(|(_, has_cap)| *has_cap);
            lines.extend(caps.map(|(at, _)| [(*at, y - CAP), (*at, y + CAP)]));
        }
        if let Some(ends) = self.along {
            lines.push([(x, ends[0].0), (x, ends[1].0)]);
            let caps = ends.iter().filter(|(_, has_cap)| *has_cap);
            lines.extend(caps.map(|(at, _)| [(x - CAP, *at), (x + CAP, *at)]));
        }
        lines
    }
}

fn is_shown(plot: &Plot, point: &Point) -> bool {
    has_place(plot.x.scale, point.x) && has_place(plot.y.scale, point.y)
}

/// How many points are not drawn, and why.
fn left_out(plot: &Plot) -> Option<String> {
    let (mut not_finite, mut not_positive) = (0, 0);
    let points = plot.series.iter().flat_map(|series| &series.points);
    for point in points.filter(|point| !is_shown(plot, point)) {
        if has_place(Scale::Linear, point.x) && has_place(Scale::Linear, point.y) {
            not_positive += 1;
        } else {
            not_finite += 1;
        }
    }
    let why = [(not_finite, "not finite"), (not_positive, "zero or less on a logarithmic axis")];
    let why: Vec<_> = why.iter().filter(|(n, _)| *n > 0).map(|(n, why)| format!("{n} {why}")).collect();
    let plural = if not_finite + not_positive == 1 { "" } else { "s" };
    (!why.is_empty()).then(|| format!("Point{plural} not drawn: {}.", why.join(", ")))
}

/// Names as the legend says them.
fn legend_names(plot: &Plot) -> Vec<String> {
    let name = |series: &Series| {
        let is_seen = series.points.iter().any(|point| is_shown(plot, point));
        format!("{}{}", series.name, if is_seen { "" } else { " (no points)" })
    };
    let mut names: Vec<_> = plot.series.iter().take(LEGEND_ENTRIES_MAX).map(name).collect();
    if plot.series.len() > LEGEND_ENTRIES_MAX {
        names.push(format!("and {} more", plot.series.len() - LEGEND_ENTRIES_MAX));
    }
    names
}

/// What a pointer on a point is told.
fn hover(plot: &Plot, series: &Series, point: &Point) -> String {
    let value = |axis: &Axis, value: f64, range: Option<(f64, f64)>| {
        let range = range.map(|(a, b)| format!(" ({} to {})", number(a), number(b)));
        format!("{}: {}{}", axis.label, number(value), range.unwrap_or_default())
    };
    let x = value(&plot.x, point.x, point.x_range);
    let y = value(&plot.y, point.y, point.y_range);
    let names = [series.name.as_str(), point.label.as_str(), &x, &y];
    names.into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join("\n")
}

/// The marker of series `k`. Seven shapes and eight colours meet in 56 pairs.
fn draw_marker(canvas: &mut dyn Canvas, (x, y): Place, k: usize) {
    // Of about the same area each, in radii.
    const SQUARE: &[Place] = &[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)];
    const UP: &[Place] = &[(0.0, -1.3), (1.2, 0.9), (-1.2, 0.9)];
    const DIAMOND: &[Place] = &[(0.0, -1.35), (1.35, 0.0), (0.0, 1.35), (-1.35, 0.0)];
    const DOWN: &[Place] = &[(0.0, 1.3), (1.2, -0.9), (-1.2, -0.9)];
    const PLUS: &[Place] = &[
        (-0.45, -1.3),
        (0.45, -1.3),
        (0.45, -0.45),
        (1.3, -0.45),
        (1.3, 0.45),
        (0.45, 0.45),
        (0.45, 1.3),
        (-0.45, 1.3),
        (-0.45, 0.45),
        (-1.3, 0.45),
        (-1.3, -0.45),
        (-0.45, -0.45),
    ];
    const LYING: &[Place] = &[(-1.3, 0.0), (0.9, -1.2), (0.9, 1.2)];
    let shapes = [&[], SQUARE, UP, DIAMOND, DOWN, PLUS, LYING];
    // A rim of paper tells markers apart that overlap.
    let (ink, rim) = (Ink::Series(k), Stroke::plain(Ink::Paper, 0.8));
    match shapes[k % shapes.len()] {
        [] => canvas.circle((x, y), MARKER_RADIUS, Some(ink), rim),
        shape => {
            let corners =
                shape.iter().map(|corner| (x + corner.0 * MARKER_RADIUS, y + corner.1 * MARKER_RADIUS));
            canvas.polygon(&corners.collect::<Vec<_>>(), ink, rim);
        }
    }
}

fn text_at(canvas: &mut dyn Canvas, text: &str, place: Place, size: f64, ink: Ink, anchor: Anchor) {
    canvas.text(&plain_text(text, place, size, ink, anchor));
}

fn plain_text(text: &str, place: Place, size: f64, ink: Ink, anchor: Anchor) -> Text<'_> {
    Text { text, place, size, ink, anchor, is_bold: false, is_upright: false }
}
