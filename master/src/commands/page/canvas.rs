//! What plots are drawn on, and their colours.

use super::plot::Theme;

/// A place, right and down from the upper left corner, in units of the layout.
pub type Place = (f64, f64);

/// Takes what a plot consists of. What comes later covers what came before.
pub trait Canvas {
    /// A line through `places`, with round corners and ends.
    fn polyline(&mut self, places: &[Place], stroke: Stroke);
    /// A filled area with an edge.
    fn polygon(&mut self, corners: &[Place], fill: Ink, edge: Stroke);
    /// A disc with an edge, or without `fill` a ring.
    fn circle(&mut self, centre: Place, radius: f64, fill: Option<Ink>, edge: Stroke);
    /// One line of text.
    fn text(&mut self, text: &Text<'_>);
    /// A pointer on anything that is drawn until [`Canvas::end`] is told `title`.
    fn begin(&mut self, title: &str);
    /// See [`Canvas::begin`].
    fn end(&mut self);
}

/// How a line looks.
#[derive(Clone, Copy, Debug)]
pub struct Stroke {
    pub ink: Ink,
    pub width: f64,
    pub is_dashed: bool,
}

impl Stroke {
    pub fn plain(ink: Ink, width: f64) -> Self {
        Self { ink, width, is_dashed: false }
    }
}

/// Lengths of dashes and of what is between them.
pub const DASH: [f64; 2] = [7.0, 5.0];

/// One line of text.
#[derive(Clone, Copy, Debug)]
pub struct Text<'a> {
    pub text: &'a str,
    /// Of the base line, as `anchor` says.
    pub place: Place,
    /// What fonts call their size: capitals are about 0.72 of it high.
    pub size: f64,
    pub ink: Ink,
    pub anchor: Anchor,
    pub is_bold: bool,
    /// Reads from bottom to top.
    pub is_upright: bool,
}

/// Which end of a text is at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// What something is painted with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    Paper,
    Text,
    /// Text that says less.
    Quiet,
    /// Lines at labelled values.
    Grid,
    /// Lines between them.
    FineGrid,
    /// Of a series, modulo their number.
    Series(usize),
}

/// Colours of series, on light paper and in the dark: blue, vermilion, green, purple, orange, grey, a second blue, red. The hues are those
/// of M. Okabe and K. Ito (Color Universal Design, 2008); lightness and chroma were searched so that any two differ for people with each
/// kind of colour blindness too, the first five most, and all differ from the paper (the tests say how much).
const SERIES: [[u32; 2]; 8] = [
    [0x2e70a5, 0x71b2fc],
    [0xb0470e, 0xe4681b],
    [0x42a28f, 0x9bf7d8],
    [0x622f4a, 0xb2799b],
    [0xcb8300, 0xf6c258],
    [0x636362, 0xb8b8b8],
    [0x25547d, 0x8cd1fa],
    [0x84281b, 0xfe9174],
];

impl Ink {
    /// All of them.
    pub fn all() -> impl Iterator<Item = Self> {
        let plain = [Self::Paper, Self::Text, Self::Quiet, Self::Grid, Self::FineGrid];
        plain.into_iter().chain((0..SERIES.len()).map(Self::Series))
    }

    /// Its name in a style sheet.
    pub fn class(self) -> &'static str {
        match self {
            Self::Paper => "p",
            Self::Text => "t",
            Self::Quiet => "q",
            Self::Grid => "g",
            Self::FineGrid => "h",
            Self::Series(n) => ["s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7"][n % SERIES.len()],
        }
    }

    /// 0xRRGGBB.
    pub fn rgb(self, theme: Theme) -> u32 {
        let both = match self {
            Self::Paper => [0xffffff, 0x16191d],
            Self::Text => [0x1b1f24, 0xe8eaed],
            Self::Quiet => [0x57606a, 0xa3acb5],
            Self::Grid => [0xd0d5da, 0x3a4048],
            Self::FineGrid => [0xeceff1, 0x24292f],
            Self::Series(n) => SERIES[n % SERIES.len()],
        };
        both[usize::from(theme == Theme::Dark)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What complete protanopia, deuteranopia and tritanopia make of linear sRGB: Machado, Oliveira and Fernandes, A Physiologically-based
    /// Model for Simulation of Color Vision Deficiency (2009), table of severity 1.0.
    const VISIONS: [[[f64; 3]; 3]; 4] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ];

    fn linear(rgb: u32) -> [f64; 3] {
        let [_, r, g, b] = rgb.to_be_bytes();
        [r, g, b].map(|code| {
            let s = f64::from(code) / 255.0;
            if s <= 0.04045 { s / 12.92 } else { libm::pow((s + 0.055) / 1.055, 2.4) }
        })
    }

    fn times(matrix: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
        matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// B. Ottosson's perceptual space (2020), where 0.02 is a difference that is just seen.
    fn oklab(linear: [f64; 3]) -> [f64; 3] {
        let cones = times(
            [
                [0.4122214708, 0.5363325363, 0.0514459929],
                [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005],
            ],
            linear.map(|v| v.max(0.0)),
        );
        times(
            [
                [0.2104542553, 0.7936177850, -0.0040720468],
                [1.9779984951, -2.4285922050, 0.4505937099],
                [0.0259040371, 0.7827717662, -0.8086757660],
            ],
            cones.map(libm::cbrt),
        )
    }

    #[test]
    fn series_differ_for_everyone() {
        for (theme, vision) in [Theme::Light, Theme::Dark].into_iter().flat_map(|t| VISIONS.map(|v| (t, v))) {
            let seen = |k| oklab(times(vision, linear(Ink::Series(k).rgb(theme))));
            for (a, b) in (0..SERIES.len()).flat_map(|b| (0..b).map(move |a| (a, b))) {
                let (p, q) = (seen(a), seen(b));
                let distance = libm::sqrt((0..3).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum());
                let least = if b < 5 { 0.11 } else { 0.08 };
                assert!(distance > least, "{theme:?}: {a} and {b} differ by {distance}");
            }
        }
    }

    #[test]
    fn everything_can_be_read() {
        let luminance = |ink: Ink, theme| {
            let [r, g, b] = linear(ink.rgb(theme));
            0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05
        };
        for theme in [Theme::Light, Theme::Dark] {
            for ink in Ink::all() {
                let (a, b) = (luminance(ink, theme), luminance(Ink::Paper, theme));
                // WCAG 2.2, 1.4.3 (text) and 1.4.11 (graphics).
                let least = match ink {
                    Ink::Text | Ink::Quiet => 4.5,
                    Ink::Series(_) => 3.0,
                    Ink::Paper | Ink::Grid | Ink::FineGrid => 1.0,
                };
                assert!(a.max(b) / a.min(b) >= least, "{ink:?} in {theme:?}");
            }
        }
    }
}
