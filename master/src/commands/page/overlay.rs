//! Pictures of a frame's tiles over the frame: who has rendered which, and what each has cost.

use super::canvas::Ink;
use super::font::{self, Pen};
use super::plot::Theme;
use tessera_master::{FrameBuffer, FrameResult, PixelFormat};
use tessera_wire::{Rect, TileGrid};
use tiny_skia::{Color, LineCap, LineJoin, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// What is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Overlay {
    /// Who has rendered which tile: a tint and a number for each worker (Seo, Park, Ihm 2022, Figure 8(b)).
    Workers,
    /// What each tile has cost, from dark to light.
    Cost,
}

impl Overlay {
    /// Stands between the picture's name and `.png`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Workers => "workers",
            Self::Cost => "cost",
        }
    }

    /// A PNG file, the frame with a legend below it.
    ///
    /// # Errors
    /// The picture is too large to be drawn on.
    pub fn draw(self, frame: &FrameResult, tile: u32) -> Result<Vec<u8>, String> {
        let image = &frame.image;
        let grid = TileGrid::new(image.width(), image.height(), tile).map_err(|e| e.to_string())?;
        let mut sheet = Sheet::new(image, &self.legend(frame))?;
        match self {
            Self::Workers => sheet.workers(frame, &grid),
            Self::Cost => sheet.cost(frame, &grid),
        }
        sheet.pixels.encode_png().map_err(|e| e.to_string())
    }

    /// Lines of the legend; the first is its heading.
    fn legend(self, frame: &FrameResult) -> Vec<String> {
        match self {
            Self::Workers => {
                let heading = "Who has rendered which tile".to_owned();
                let worker = |(k, worker): (usize, &tessera_master::WorkerReport)| {
                    let s = if worker.tiles == 1 { "" } else { "s" };
                    let ms = worker.render.as_secs_f64() * 1e3;
                    format!("{} {}: {} tile{s}, {ms:.0} ms", k + 1, worker.name, worker.tiles)
                };
                std::iter::once(heading).chain(frame.workers.iter().enumerate().map(worker)).collect()
            }
            Self::Cost => {
                vec!["Time that its worker has taken to render each tile, in ms".to_owned(), String::new()]
            }
        }
    }
}

/// Legends are made for pictures of about this many pixels across, and grow with larger ones.
const USUAL_WIDTH: f32 = 1024.0;

/// A picture with room below.
struct Sheet {
    pixels: Pixmap,
    width: u32,
    height: u32,
    /// Size of the legend's letters.
    size: f64,
    legend: Vec<String>,
    columns: usize,
}

impl Sheet {
    fn new(image: &FrameBuffer, legend: &[String]) -> Result<Self, String> {
        let (width, height) = (image.width(), image.height());
        let size = f64::from((width as f32 / USUAL_WIDTH).clamp(0.5, 4.0)) * 20.0;
        // As many columns as the longest line leaves room for.
        let longest = legend.iter().skip(1).map(|line| font::width(line, size)).fold(0.0, f64::max);
        let columns = (f64::from(width) / (longest + 3.5 * size)).max(1.0) as usize;
        let lines = 1 + legend.len().saturating_sub(1).div_ceil(columns);
        let below = (size * 1.6 * (lines as f64 + 0.6)) as u32;
        let too_large = || format!("a picture of {width} x {height} pixels is too large to be drawn on");
        let mut pixels = Pixmap::new(width, height + below).ok_or_else(too_large)?;
        pixels.fill(colour(Ink::Paper.rgb(Theme::Light)));
        let sheet = pixels.data_mut().as_chunks_mut::<4>().0;
        for (to, from) in sheet.iter_mut().zip(codes(image)) {
            *to = [from[0], from[1], from[2], 255];
        }
        Ok(Self { pixels, width, height, size, legend: legend.to_vec(), columns })
    }

    fn workers(&mut self, frame: &FrameResult, grid: &TileGrid) {
        let first = frame.tiles.iter().filter(|tile| tile.is_first);
        for (rect, worker) in first.filter_map(|tile| Some((grid.rect(tile.tile)?, tile.worker))) {
            let tint = tint(worker);
            self.each(rect, |x, y, before| {
                // Colours come again from the ninth worker on, with stripes, then with others.
                let striped = match worker / TINTS {
                    0 => false,
                    1 => (x + y) % 12 < 3,
                    _ => (x + 12 - y % 12) % 12 < 3,
                };
                mixed(grey(before), tint, if striped { 0.85 } else { 0.5 })
            });
            self.border(rect);
            let size = (f64::from(rect.width.min(rect.height)) * 0.3).min(1.4 * self.size);
            let (text, x) = ((worker + 1).to_string(), f64::from(rect.x) + f64::from(rect.width) / 2.0);
            let y = f64::from(rect.y) + f64::from(rect.height) / 2.0 + 0.36 * size;
            let left = x - font::width(&text, size) / 2.0;
            self.text(&text, (left, y), size, 0xffffff, 0.26);
            self.text(&text, (left, y), size, Ink::Text.rgb(Theme::Light), 0.1);
        }
        self.heading();
        for k in 1..self.legend.len() {
            let (x, y) = self.place(k);
            let side = self.size;
            let swatch =
                Rect { x: x as u32, y: (y - 0.85 * side) as u32, width: side as u32, height: side as u32 };
            let tint = tint(k - 1);
            self.each(swatch, |_, _, _| tint);
            let line = self.legend[k].clone();
            self.text(&line, (x + 1.5 * side, y), side, Ink::Text.rgb(Theme::Light), 0.085);
        }
    }

    fn cost(&mut self, frame: &FrameResult, grid: &TileGrid) {
        let first = || frame.tiles.iter().filter(|tile| tile.is_first);
        let most = first().map(|tile| tile.render.as_secs_f64() * 1e3).fold(0.0, f64::max).max(1e-6);
        for tile in first() {
            let Some(rect) = grid.rect(tile.tile) else { continue };
            let heat = heat(tile.render.as_secs_f64() * 1e3 / most);
            self.each(rect, |_, _, before| mixed(grey(before), heat, 0.7));
            self.border(rect);
        }
        self.heading();
        let (left, base) = self.place(1);
        let side = self.size;
        let long = (f64::from(self.width) - 2.0 * left).max(1.0);
        for x in 0..long as u32 {
            let part = Rect {
                x: left as u32 + x,
                y: (base - 0.9 * side) as u32,
                width: 1,
                height: (0.6 * side) as u32,
            };
            let heat = heat(f64::from(x) / long);
            self.each(part, |_, _, _| heat);
        }
        let digits = if most < 10.0 { 2 } else { 0 };
        for (share, anchor) in [(0.0, 0.0), (0.25, 0.5), (0.5, 0.5), (0.75, 0.5), (1.0, 1.0)] {
            let text = format!("{:.digits$}", share * most);
            let x = left + share * long - anchor * font::width(&text, 0.8 * side);
            self.text(&text, (x, base + 0.6 * side), 0.8 * side, Ink::Text.rgb(Theme::Light), 0.085);
        }
    }

    fn heading(&mut self) {
        let (x, y) = self.place(0);
        let line = font::shortened(&self.legend[0], self.size, f64::from(self.width) - 2.0 * x);
        self.text(&line, (x, y), self.size, Ink::Text.rgb(Theme::Light), 0.125);
    }

    /// Where a line of the legend begins, on its base line: the heading, then row by row.
    fn place(&self, line: usize) -> (f64, f64) {
        let (column, row) = match line.checked_sub(1) {
            None => (0, 0),
            Some(k) => (k % self.columns, 1 + k / self.columns),
        };
        let x = 0.7 * self.size + column as f64 * (f64::from(self.width) - self.size) / self.columns as f64;
        (x, f64::from(self.height) + self.size * 1.6 * (row as f64 + 0.9))
    }

    /// Gives each pixel of `rect` that is on the sheet another colour, made of its place and its colour.
    fn each(&mut self, rect: Rect, to: impl Fn(u32, u32, u32) -> u32) {
        let (width, height) = (self.pixels.width(), self.pixels.height());
        let pixels = self.pixels.data_mut().as_chunks_mut::<4>().0;
        for y in rect.y..rect.y.saturating_add(rect.height).min(height) {
            for x in rect.x..rect.x.saturating_add(rect.width).min(width) {
                let pixel = &mut pixels[(y * width + x) as usize];
                let [_, r, g, b] =
                    to(x, y, u32::from_be_bytes([0, pixel[0], pixel[1], pixel[2]])).to_be_bytes();
                *pixel = [r, g, b, 255];
            }
        }
    }

    /// Darkens the upper and the left edge of a tile.
    fn border(&mut self, rect: Rect) {
        for edge in [Rect { width: 1, ..rect }, Rect { height: 1, ..rect }] {
            self.each(edge, |_, _, before| mixed(before, 0, 0.6));
        }
    }

    fn text(&mut self, text: &str, (left, base): (f64, f64), size: f64, rgb: u32, thickness: f64) {
        let mut path = PathBuilder::new();
        let place = |(x, y): (f64, f64)| ((left + x) as f32, (base + y) as f32);
        for pen in font::strokes(text, size) {
            match pen {
                Pen::Down(to) => path.move_to(place(to).0, place(to).1),
                Pen::Line(to) => path.line_to(place(to).0, place(to).1),
                Pen::Curve(control, to) => {
                    let (control, to) = (place(control), place(to));
                    path.quad_to(control.0, control.1, to.0, to.1);
                }
            }
        }
        let Some(path) = path.finish() else { return };
        let mut paint = Paint::default();
        paint.set_color(colour(rgb));
        let stroke = Stroke {
            width: (size * thickness) as f32,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        self.pixels.stroke_path(&path, &paint, &stroke, Transform::identity(), None);
    }
}

/// Colours of series, which differ for people with each kind of colour blindness too (see `canvas.rs`).
const TINTS: usize = 8;

fn tint(worker: usize) -> u32 {
    // Those made for dark paper: a picture shows through.
    Ink::Series(worker % TINTS).rgb(Theme::Dark)
}

/// From dark to light with every step: ten of viridis (N. Smith, S. van der Walt 2015), which is in this order for the colour-blind, and in
/// grey, too.
const HEAT: [u32; 10] =
    [0x440154, 0x482878, 0x3e4a89, 0x31688e, 0x26828e, 0x1f9e89, 0x35b779, 0x6dcd59, 0xb4de2c, 0xfde725];

/// The colour of a share, [0, 1].
fn heat(share: f64) -> u32 {
    let at = share.clamp(0.0, 1.0) * (HEAT.len() - 1) as f64;
    let below = (at as usize).min(HEAT.len() - 2);
    mixed(HEAT[below], HEAT[below + 1], (at - below as f64) as f32)
}

/// Its shade. Of the picture no more is kept below what is drawn: its colours would be taken for those of the legend.
fn grey(rgb: u32) -> u32 {
    let [_, r, g, b] = rgb.to_be_bytes().map(u32::from);
    let grey = (54 * r + 183 * g + 19 * b) >> 8;
    grey << 16 | grey << 8 | grey
}

/// `share` of `b`, the rest of `a`.
fn mixed(a: u32, b: u32, share: f32) -> u32 {
    let (a, b) = (a.to_be_bytes(), b.to_be_bytes());
    u32::from_be_bytes(std::array::from_fn(|k| {
        (f32::from(a[k]) * (1.0 - share) + f32::from(b[k]) * share + 0.5) as u8
    }))
}

fn colour(rgb: u32) -> Color {
    let [_, r, g, b] = rgb.to_be_bytes();
    Color::from_rgba8(r, g, b, 255)
}

/// What 8 bits show of each pixel, on black where it is not covered.
fn codes(image: &FrameBuffer) -> impl Iterator<Item = [u8; 3]> + '_ {
    let format = image.format();
    image.data().chunks_exact(format.bytes_per_pixel()).map(move |pixel| match format {
        PixelFormat::Rgba8 => [pixel[0], pixel[1], pixel[2]],
        PixelFormat::Rgba16 => [pixel[1], pixel[3], pixel[5]],
        PixelFormat::Layers => [0, 4, 8].map(|at| {
            let linear = f32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]]);
            let linear = f64::from(linear).clamp(0.0, 1.0);
            let coded = if linear <= 0.0031308 {
                12.92 * linear
            } else {
                1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
            };
            (255.0 * coded + 0.5) as u8
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_becomes_lighter_with_every_step() {
        let lightness = |rgb: u32| {
            let [_, r, g, b] = rgb.to_be_bytes().map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f64> = (0..=100).map(|k| lightness(heat(f64::from(k) / 100.0))).collect();
        assert!(steps.windows(2).all(|pair| pair[1] > pair[0] - 0.6), "{steps:?}");
        assert_eq!((heat(-1.0), heat(2.0)), (HEAT[0], HEAT[9]));
        assert_eq!(mixed(0x000000, 0xffffff, 0.5), 0x808080);
    }

    #[test]
    fn eight_workers_have_eight_tints() {
        let tints: std::collections::BTreeSet<_> = (0..TINTS).map(tint).collect();
        assert_eq!((tints.len(), tint(8)), (TINTS, tint(0)));
    }
}
