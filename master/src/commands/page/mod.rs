//! Pages that report what was measured: text, plots, tables and pictures in one file that needs no other.

mod axis;
mod canvas;
mod csv;
mod draw;
mod font;
mod labels;
mod machine;
mod overlay;
mod plot;
mod raster;
mod svg;

pub use csv::write_csv;
pub use machine::{BUGS_FOR_TESTS, machine};
pub use overlay::Overlay;
pub use plot::{Axis, Line, Plot, Point, Scale, Series, Theme};

use std::fmt::Write;
use svg::escape;

/// A report for people who read it in a browser.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// What it is about.
    pub title: String,
    /// What was found, a paragraph each.
    pub summary: Vec<String>,
    /// Plots with their tables.
    pub sections: Vec<PageSection>,
    /// Commands that measure it again.
    pub commands: Vec<String>,
    /// What it was measured on: names and values, as of [`machine()`].
    pub machine: Vec<(String, String)>,
    /// What a reader must not conclude.
    pub caveats: Vec<String>,
}

/// A part of a page.
#[derive(Clone, Debug, Default)]
pub struct PageSection {
    /// Its heading.
    pub title: String,
    /// A paragraph each.
    pub text: Vec<String>,
    /// Drawn into the page.
    pub plot: Option<Plot>,
    /// Held by the page.
    pub pictures: Vec<Picture>,
    /// The numbers.
    pub table: Option<Table>,
}

/// A picture.
#[derive(Clone, Debug)]
pub struct Picture {
    /// What it shows, for those who cannot see it too.
    pub name: String,
    /// Stands below it.
    pub caption: String,
    /// A PNG file.
    pub png: Vec<u8>,
}

/// Cells in rows.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Heads.
    pub columns: Vec<String>,
    /// Cells of each row, as many as columns.
    pub rows: Vec<Vec<String>>,
    /// Whether a column holds numbers, which stand at the right; a column that is not listed holds text.
    pub numeric: Vec<bool>,
}

impl Page {
    /// The whole page, light or dark as the reader's system is. It loads nothing and runs no script.
    pub fn html(&self) -> String {
        let mut out = String::new();
        // Writing to a string does not fail.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let title = escape(&self.title);
        writeln!(out, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">")?;
        // Nothing of it may come from elsewhere, and no text that becomes markup by mistake may do anything.
        writeln!(
            out,
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">"
        )?;
        writeln!(out, "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">")?;
        writeln!(out, "<meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>")?;
        writeln!(out, "<style>{STYLE}{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>", svg::style())?;
        write_paragraphs(out, &self.summary)?;
        for section in &self.sections {
            section.write(out)?;
        }
        if !self.caveats.is_empty() {
            writeln!(out, "<section>\n<h2>What to keep in mind</h2>\n<ul>")?;
            self.caveats.iter().try_for_each(|text| writeln!(out, "<li>{}</li>", escape(text)))?;
            writeln!(out, "</ul>\n</section>")?;
        }
        if !self.commands.is_empty() {
            let commands = escape(&self.commands.join("\n"));
            writeln!(out, "<section>\n<h2>Measure it again</h2>")?;
            writeln!(out, "<pre tabindex=\"0\"><code>{commands}</code></pre>\n</section>")?;
        }
        if !self.machine.is_empty() {
            writeln!(out, "<section>\n<h2>Measured on</h2>\n<div class=\"wide\" tabindex=\"0\"><table>")?;
            for (name, value) in &self.machine {
                writeln!(out, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escape(name), escape(value))?;
            }
            writeln!(out, "</table></div>\n</section>")?;
        }
        writeln!(out, "</main>\n</body>\n</html>")
    }
}

impl PageSection {
    fn write(&self, out: &mut String) -> std::fmt::Result {
        writeln!(out, "<section>\n<h2>{}</h2>", escape(&self.title))?;
        write_paragraphs(out, &self.text)?;
        // What is wider than the window scrolls, also by keys.
        if let Some(plot) = &self.plot {
            let svg = svg::inline(&draw::Layout::new(plot));
            writeln!(out, "<figure class=\"wide\" tabindex=\"0\">{svg}</figure>")?;
        }
        if !self.pictures.is_empty() {
            writeln!(out, "<div class=\"pictures\">")?;
            for Picture { name, caption, png } in &self.pictures {
                let (name, caption) = (escape(name), escape(caption));
                writeln!(out, "<figure><img alt=\"{name}\" src=\"data:image/png;base64,{}\">", base64(png))?;
                writeln!(out, "<figcaption><b>{name}</b> {caption}</figcaption></figure>")?;
            }
            writeln!(out, "</div>")?;
        }
        if let Some(table) = &self.table {
            table.write(out)?;
        }
        writeln!(out, "</section>")
    }
}

impl Table {
    fn write(&self, out: &mut String) -> std::fmt::Result {
        let class = |column: usize| if self.numeric.get(column) == Some(&true) { " class=\"n\"" } else { "" };
        writeln!(out, "<div class=\"wide\" tabindex=\"0\"><table>\n<thead><tr>")?;
        for (k, column) in self.columns.iter().enumerate() {
            write!(out, "<th scope=\"col\"{}>{}</th>", class(k), escape(column))?;
        }
        writeln!(out, "</tr></thead>\n<tbody>")?;
        for row in &self.rows {
            write!(out, "<tr>")?;
            for (k, cell) in row.iter().enumerate() {
                write!(out, "<td{}>{}</td>", class(k), escape(cell))?;
            }
            writeln!(out, "</tr>")?;
        }
        writeln!(out, "</tbody></table></div>")
    }
}

fn write_paragraphs(out: &mut String, paragraphs: &[String]) -> std::fmt::Result {
    paragraphs.iter().try_for_each(|text| writeln!(out, "<p>{}</p>", escape(text)))
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits =
            group.iter().zip([16, 8, 0]).fold(0, |bits, (byte, shift)| bits | u32::from(*byte) << shift);
        for (k, shift) in [18, 12, 6, 0].into_iter().enumerate() {
            // n bytes fill n + 1 digits.
            let digit = char::from(DIGITS[(bits >> shift & 63) as usize]);
            out.push(if k <= group.len() { digit } else { '=' });
        }
    }
    out
}

/// Colours, sizes and how wide things scroll.
const STYLE: &str = "\
:root{color-scheme:light dark;--paper:#fff;--text:#1b1f24;--quiet:#57606a;--line:#d0d5da;--box:#f5f7f9}\
@media(prefers-color-scheme:dark){:root{--paper:#16191d;--text:#e8eaed;--quiet:#a3acb5;--line:#3a4048;--box:#20252b}}\
*{box-sizing:border-box}\
body{margin:0;background:var(--paper);color:var(--text);font:16px/1.5 system-ui,-apple-system,'Segoe UI',sans-serif}\
main{max-width:1040px;margin:0 auto;padding:24px 20px 64px}\
h1{font-size:1.75rem;line-height:1.25;margin:0 0 16px;overflow-wrap:anywhere}\
h2{font-size:1.25rem;line-height:1.3;margin:40px 0 12px;overflow-wrap:anywhere}\
p,li{max-width:75ch;overflow-wrap:anywhere}\
figure{margin:16px 0}\
.wide{overflow-x:auto;margin:16px 0}\
.wide svg{display:block}\
.pictures{display:flex;flex-wrap:wrap;gap:16px}\
.pictures figure{margin:0;flex:1 1 280px;max-width:100%}\
.pictures img{display:block;max-width:100%;height:auto;border:1px solid var(--line)}\
figcaption{color:var(--quiet);font-size:.875rem;margin-top:6px}\
figcaption b{color:var(--text)}\
table{border-collapse:collapse;font-size:.875rem;font-variant-numeric:tabular-nums}\
th,td{padding:5px 12px;border-bottom:1px solid var(--line);text-align:left;vertical-align:top}\
thead th{border-bottom-width:2px;vertical-align:bottom}\
.n{text-align:right}td.n{white-space:nowrap}\
ul{padding-left:20px}\
pre{background:var(--box);border:1px solid var(--line);border-radius:6px;padding:10px 12px;overflow-x:auto;margin:6px 0}\
code{font:.875rem/1.5 ui-monospace,'DejaVu Sans Mono',Menlo,Consolas,monospace}";

#[cfg(test)]
mod tests;
