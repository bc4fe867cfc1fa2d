//! What a plot is.

use super::{draw, raster, svg};

/// Points of several series over two axes.
///
/// Values that an axis cannot show (not finite, or not above zero on a logarithmic one) are left out, and a line under the plot counts them.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Stands above it; shortened where it is too long.
    pub title: String,
    /// Left to right.
    pub x: Axis,
    /// Bottom to top.
    pub y: Axis,
    /// In the order of the legend, which decides colours and markers.
    pub series: Vec<Series>,
}

/// One direction of a plot.
#[derive(Clone, Debug)]
pub struct Axis {
    /// What is measured, with its unit.
    pub label: String,
    /// How values become places.
    pub scale: Scale,
}

/// How values become places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Equal differences are equally far apart.
    Linear,
    /// Equal ratios are equally far apart; only values above zero have a place.
    Log,
}

/// Points that belong together.
#[derive(Clone, Debug)]
pub struct Series {
    /// As the legend says it.
    pub name: String,
    /// In the order in which a line joins them.
    pub points: Vec<Point>,
    /// What joins them.
    pub line: Line,
}

/// What joins the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Nothing.
    None,
    /// Straight lines from each point to the next.
    Joined,
    /// A Pareto front: from left to right, what has been reached so far. Its points are rings, which leave measured points visible.
    Stepped,
    /// A theory, dashed and without markers.
    Dashed,
}

/// One measurement.
#[derive(Clone, Debug, Default)]
pub struct Point {
    /// Its place on the x axis.
    pub x: f64,
    /// Its place on the y axis.
    pub y: f64,
    /// Lowest and highest x, drawn as an error bar.
    pub x_range: Option<(f64, f64)>,
    /// Lowest and highest y, drawn as an error bar.
    pub y_range: Option<(f64, f64)>,
    /// What a pointer that rests on it is told; stands beside the point too if it is short and there is room. May be empty.
    pub label: String,
}

/// Colours for paper or for a dark room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Theme {
    /// Dark on light.
    Light,
    /// Light on dark.
    Dark,
}

impl Plot {
    /// An SVG file of its own, light or dark as the reader's system is.
    pub fn svg(&self) -> String {
        svg::file(&draw::Layout::new(self))
    }

    /// A PNG file, 1600 pixels wide and 1000 high, higher where a legend of long names stands below the plot.
    pub fn png(&self, theme: Theme) -> Vec<u8> {
        raster::file(&draw::Layout::new(self), theme)
    }
}
