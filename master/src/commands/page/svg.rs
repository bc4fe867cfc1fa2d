//! Plots as SVG.

use super::canvas::{Anchor, Canvas, DASH, Ink, Place, Stroke, Text};
use super::draw::Layout;
use super::font;
use super::plot::Theme;
use std::fmt::Write;

/// A file of its own, with its own style.
pub fn file(layout: &Layout<'_>) -> String {
    let style = format!("<style>{}</style>", style());
    format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n", element(layout, &style))
}

/// For a page that has the [`style`].
pub fn inline(layout: &Layout<'_>) -> String {
    element(layout, "")
}

/// Colours and fonts of all plots of a page.
pub fn style() -> String {
    let colours = |theme| {
        let rule = |ink: Ink| {
            let (class, rgb) = (ink.class(), ink.rgb(theme));
            format!(".tessera-plot .f{class}{{fill:#{rgb:06x}}}.tessera-plot .k{class}{{stroke:#{rgb:06x}}}")
        };
        Ink::all().map(rule).collect::<String>()
    };
    format!(
        ".tessera-plot text{{font-family:Helvetica,Arial,'Liberation Sans',sans-serif}}.tessera-plot .b{{font-weight:bold}}\
         .tessera-plot *{{stroke-linejoin:round;stroke-linecap:round}}{}@media(prefers-color-scheme:dark){{{}}}",
        colours(Theme::Light),
        colours(Theme::Dark)
    )
}

/// `text` as it must stand in HTML and XML, also inside quotes. What XML cannot hold becomes U+FFFD.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' => out.push(c),
            '\0'..'\u{20}' | '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            _ => out.push(c),
        }
    }
    out
}

fn element(layout: &Layout<'_>, style: &str) -> String {
    let (width, height) = (layout.width, layout.height);
    let mut svg = Svg(String::new());
    layout.draw(&mut svg);
    // No style sheet of a page, and none of a viewer, is asked for the size.
    format!(
        "<svg class=\"tessera-plot\" xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\"><title>{}</title><desc>{}</desc>{style}{}</svg>",
        escape(layout.title()),
        escape(&layout.description()),
        svg.0
    )
}

/// The elements so far.
struct Svg(String);

impl Svg {
    fn put(&mut self, arguments: std::fmt::Arguments<'_>) {
        // Writing to a string does not fail.
        let _ = self.0.write_fmt(arguments);
    }

    fn places(&mut self, places: &[Place]) {
        for (k, (x, y)) in places.iter().enumerate() {
            let space = if k == 0 { "" } else { " " };
            self.put(format_args!("{space}{x:.1},{y:.1}"));
        }
    }

    fn stroke(&mut self, stroke: Stroke) {
        if stroke.is_dashed {
            self.put(format_args!(" stroke-dasharray=\"{} {}\"", DASH[0], DASH[1]));
        }
        self.put(format_args!(" stroke-width=\"{}\"", stroke.width));
    }
}

impl Canvas for Svg {
    fn polyline(&mut self, places: &[Place], stroke: Stroke) {
        self.put(format_args!("<polyline class=\"k{}\" fill=\"none\" points=\"", stroke.ink.class()));
        self.places(places);
        self.put(format_args!("\""));
        self.stroke(stroke);
        self.put(format_args!("/>"));
    }

    fn polygon(&mut self, corners: &[Place], fill: Ink, edge: Stroke) {
        self.put(format_args!("<polygon class=\"f{} k{}\" points=\"", fill.class(), edge.ink.class()));
        self.places(corners);
        self.put(format_args!("\""));
        self.stroke(edge);
        self.put(format_args!("/>"));
    }

    fn circle(&mut self, (x, y): Place, radius: f64, fill: Option<Ink>, edge: Stroke) {
        let class = edge.ink.class();
        match fill {
            Some(fill) => self.put(format_args!("<circle class=\"f{} k{class}\"", fill.class())),
            // Inside a ring a pointer finds what lies behind it.
            None => self.put(format_args!("<circle class=\"k{class}\" fill=\"none\"")),
        }
        self.put(format_args!(" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\""));
        self.stroke(edge);
        self.put(format_args!("/>"));
    }

    fn text(&mut self, text: &Text<'_>) {
        let (x, y) = text.place;
        let anchor = match text.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let bold = if text.is_bold { " b" } else { "" };
        self.put(format_args!("<text class=\"f{}{bold}\" x=\"{x:.1}\" y=\"{y:.1}\"", text.ink.class()));
        self.put(format_args!(" font-size=\"{}\" text-anchor=\"{anchor}\"", text.size));
        // Whatever font there is, the text is as long as the layout has room for.
        self.put(format_args!(
            " textLength=\"{:.1}\" lengthAdjust=\"spacingAndGlyphs\"",
            font::width(text.text, text.size)
        ));
        if text.is_upright {
            self.put(format_args!(" transform=\"rotate(-90 {x:.1} {y:.1})\""));
        }
        self.put(format_args!(">{}</text>", escape(text.text)));
    }

    fn begin(&mut self, title: &str) {
        self.put(format_args!("<g><title>{}</title>", escape(title)));
    }

    fn end(&mut self) {
        self.put(format_args!("</g>"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escape("a<b> & \"c'"), "a&lt;b&gt; &amp; &quot;c&#39;");
        assert_eq!(
            escape("tab\tline\nzero\0escape\u{1b}\u{9b}end\u{ffff}"),
            "tab\tline\nzero\u{fffd}escape\u{fffd}\u{fffd}end\u{fffd}"
        );
        assert_eq!(escape("µ × 世"), "µ × 世");
    }
}
