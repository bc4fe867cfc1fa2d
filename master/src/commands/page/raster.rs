//! Plots as PNG.

use super::canvas::{Anchor, Canvas, DASH, Ink, Place, Stroke, Text};
use super::draw::{self, Layout};
use super::font::{self, Pen};
use super::plot::Theme;
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, StrokeDash, Transform,
};

/// Pixels of a unit of the layout: 1600 across.
const SCALE: f64 = 1600.0 / draw::WIDTH;

/// A PNG file.
pub fn file(layout: &Layout<'_>, theme: Theme) -> Vec<u8> {
    let size = |length: f64| libm::ceil(length * SCALE) as u32;
    // A layout has at least its least width and height, and at most a legend of a fixed number of lines more.
    let pixels =
        Pixmap::new(size(layout.width), size(layout.height)).expect("a layout has a size and a limit");
    let mut raster = Raster { pixels, theme };
    raster.pixels.fill(raster.colour(Ink::Paper));
    layout.draw(&mut raster);
    raster.pixels.encode_png().expect("a PNG in memory can always be written")
}

struct Raster {
    pixels: Pixmap,
    theme: Theme,
}

impl Raster {
    fn colour(&self, ink: Ink) -> Color {
        let [_, r, g, b] = ink.rgb(self.theme).to_be_bytes();
        Color::from_rgba8(r, g, b, 255)
    }

    fn paint(&self, ink: Ink) -> Paint<'static> {
        let mut paint = Paint::default();
        paint.set_color(self.colour(ink));
        paint
    }

    fn stroke(&mut self, path: Option<Path>, stroke: Stroke) {
        let Some(path) = path else { return };
        let dash = stroke.is_dashed.then(|| DASH.map(|length| (length * SCALE) as f32).to_vec());
        let style = tiny_skia::Stroke {
            width: (stroke.width * SCALE) as f32,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            dash: dash.and_then(|dash| StrokeDash::new(dash, 0.0)),
            ..Default::default()
        };
        let paint = self.paint(stroke.ink);
        self.pixels.stroke_path(&path, &paint, &style, Transform::identity(), None);
    }

    fn fill(&mut self, path: &Path, ink: Ink) {
        let paint = self.paint(ink);
        self.pixels.fill_path(path, &paint, FillRule::Winding, Transform::identity(), None);
    }
}

impl Canvas for Raster {
    fn polyline(&mut self, places: &[Place], stroke: Stroke) {
        self.stroke(joined(places).finish(), stroke);
    }

    fn polygon(&mut self, corners: &[Place], fill: Ink, edge: Stroke) {
        let mut path = joined(corners);
        path.close();
        if let Some(path) = path.finish() {
            self.fill(&path, fill);
            self.stroke(Some(path), edge);
        }
    }

    fn circle(&mut self, centre: Place, radius: f64, fill: Option<Ink>, edge: Stroke) {
        let (x, y) = pixel(centre);
        if let Some(path) = PathBuilder::from_circle(x, y, (radius * SCALE) as f32) {
            if let Some(ink) = fill {
                self.fill(&path, ink);
            }
            self.stroke(Some(path), edge);
        }
    }

    fn text(&mut self, text: &Text<'_>) {
        let back = font::width(text.text, text.size)
            * match text.anchor {
                Anchor::Start => 0.0,
                Anchor::Middle => 0.5,
                Anchor::End => 1.0,
            };
        let place = |(x, y): Place| {
            let (right, down) = if text.is_upright { (y, back - x) } else { (x - back, y) };
            pixel((text.place.0 + right, text.place.1 + down))
        };
        let mut path = PathBuilder::new();
        for pen in font::strokes(text.text, text.size) {
            match pen {
                Pen::Down(to) => path.move_to(place(to).0, place(to).1),
                Pen::Line(to) => path.line_to(place(to).0, place(to).1),
                Pen::Curve(control, to) => {
                    let (control, to) = (place(control), place(to));
                    path.quad_to(control.0, control.1, to.0, to.1);
                }
            }
        }
        // Stems of sans-serif fonts are about so thick.
        let width = text.size * if text.is_bold { 0.125 } else { 0.085 };
        self.stroke(path.finish(), Stroke::plain(text.ink, width));
    }

    // Nobody points at a picture.
    fn begin(&mut self, _title: &str) {}

    fn end(&mut self) {}
}

fn joined(places: &[Place]) -> PathBuilder {
    let mut path = PathBuilder::new();
    for (k, &place) in places.iter().enumerate() {
        let (x, y) = pixel(place);
        if k == 0 {
            path.move_to(x, y);
        } else {
            path.line_to(x, y);
        }
    }
    path
}

fn pixel((x, y): Place) -> (f32, f32) {
    ((x * SCALE) as f32, (y * SCALE) as f32)
}
