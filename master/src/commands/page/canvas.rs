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

/// Colours of series. Eight that people with each kind of colour blindness tell apart, after M. Okabe and K. Ito (Color Universal Design,
/// 2008), darker on light paper and lighter in the dark so that each differs from the paper by a contrast of 3:1 or more.
const SERIES: [[u32; 2]; 8] = [
    [0x0072b2, 0x4aa8e0],
    [0xd55e00, 0xf0803c],
    [0x008a64, 0x1fc79a],
    [0xb0508f, 0xdf92c2],
    [0x9a7400, 0xe6b422],
    [0x5a5a5a, 0xb8b8b8],
    [0x2b3a9b, 0x8f9bff],
    [0x8c1d18, 0xff6b6b],
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
