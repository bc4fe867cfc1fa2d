use super::canvas::{Anchor, Canvas, Ink, Place, Stroke, Text};
use super::draw::Layout;
use super::*;

fn axis(label: &str, scale: Scale) -> Axis {
    Axis { label: label.into(), scale }
}

fn point(x: f64, y: f64) -> Point {
    Point { x, y, ..Point::default() }
}

/// Error against time as a bench would show it, with everything that a plot may hold.
fn error_time() -> Plot {
    let measured = |name: &str, line, scale: f64, slope: f64| {
        let points = (0..9).map(|k| {
            let spp = f64::from(1 << k);
            let (x, y) = (0.02 * spp * scale, 0.1 * libm::pow(spp, slope) / scale);
            Point {
                x,
                y,
                x_range: Some((x * 0.93, x * 1.12)),
                y_range: (k % 3 == 0).then_some((y * 0.8, y * 1.3)),
                label: format!("{spp} spp"),
            }
        });
        Series { name: name.into(), points: points.collect(), line }
    };
    let front = [(0.02, 0.1), (0.04, 0.0625), (0.09, 0.03), (0.4, 0.011), (2.0, 0.0016), (7.0, 0.0003)];
    let theory = [(0.02, 0.2), (7.0, 0.2 * libm::pow(7.0 / 0.02, -0.5))];
    let plain = |points: &[(f64, f64)]| points.iter().map(|&(x, y)| point(x, y)).collect();
    Plot {
        title: "Error against time, demo hall at 1024 × 1024 <& more>".into(),
        x: axis("time of a frame, s (median of 7, bars: lowest and highest)", Scale::Log),
        y: axis("RMSE, linear, against 4096 spp", Scale::Log),
        series: vec![
            measured("seeded sampler", Line::Joined, 1.0, -0.5),
            measured("low discrepancy", Line::Joined, 1.15, -0.92),
            measured("adaptive, 16 × 16 blocks", Line::None, 0.8, -0.62),
            Series { name: "Pareto front".into(), points: plain(&front), line: Line::Stepped },
            Series { name: "theory, slope −1/2".into(), points: plain(&theory), line: Line::Dashed },
        ],
    }
}

fn of(scale: Scale, points: Vec<Point>) -> Plot {
    let series = vec![Series { name: "a".into(), points, line: Line::Joined }];
    Plot { title: String::new(), x: axis("x", scale), y: axis("y", scale), series }
}

/// Width, height and pixels.
fn decode(png: &[u8]) -> (u32, u32, Vec<u32>) {
    let picture = image::load_from_memory(png).unwrap().to_rgb8();
    let pixels = picture.pixels().map(|p| u32::from_be_bytes([0, p[0], p[1], p[2]])).collect();
    (picture.width(), picture.height(), pixels)
}

/// What is drawn: every place, and each text with its box (left, top, right, bottom).
#[derive(Default)]
struct Drawn {
    places: Vec<Place>,
    lines: Vec<(Vec<Place>, Stroke)>,
    texts: Vec<(String, [f64; 4])>,
}

impl Canvas for Drawn {
    fn polyline(&mut self, places: &[Place], stroke: Stroke) {
        self.places.extend(places);
        self.lines.push((places.to_vec(), stroke));
    }

    fn polygon(&mut self, corners: &[Place], _fill: Ink, _edge: Stroke) {
        self.places.extend(corners);
    }

    fn circle(&mut self, (x, y): Place, radius: f64, _fill: Option<Ink>, _edge: Stroke) {
        self.places.extend([(x - radius, y - radius), (x + radius, y + radius)]);
    }

    fn text(&mut self, text: &Text<'_>) {
        let width = font::width(text.text, text.size);
        let back = match text.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => width / 2.0,
            Anchor::End => width,
        };
        let (x, y) = text.place;
        // Capitals are 0.72 of the size high, and descenders 0.21 deep.
        let (above, below) = (0.72 * text.size, 0.21 * text.size);
        let box_of = match text.is_upright {
            false => [x - back, y - above, x - back + width, y + below],
            true => [x - above, y + back - width, x + below, y + back],
        };
        self.places.extend([(box_of[0], box_of[1]), (box_of[2], box_of[3])]);
        self.texts.push((text.text.into(), box_of));
    }

    fn begin(&mut self, _title: &str) {}

    fn end(&mut self) {}
}

/// Draws it everywhere.
fn check(plot: &Plot) -> Drawn {
    let (width, height, _) = decode(&plot.png(Theme::Light));
    assert!(width == 1600 && height >= 1000);
    check_places(plot)
}

/// Looks whether all of it has a place inside the picture and no text covers another.
fn check_places(plot: &Plot) -> Drawn {
    let layout = Layout::new(plot);
    let mut drawn = Drawn::default();
    layout.draw(&mut drawn);
    for &(x, y) in &drawn.places {
        assert!(
            (0.0..=layout.width).contains(&x) && (0.0..=layout.height).contains(&y),
            "{x} {y} in {plot:?}"
        );
    }
    for (k, (text, a)) in drawn.texts.iter().enumerate() {
        for (other, b) in &drawn.texts[..k] {
            let touch = a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
            assert!(!touch, "{text:?} at {a:?} covers {other:?} at {b:?}");
        }
    }
    check_markup(&plot.svg());
    drawn
}

/// Looks whether every element ends, in order, and no bare `&` is left.
fn check_markup(markup: &str) {
    let mut open = Vec::new();
    for part in markup.split('<').skip(1) {
        let (tag, text) = part.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '\n']).next().unwrap_or("");
        if let Some(name) = name.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "{tag}");
        } else if !(tag.starts_with(['?', '!']) || tag.ends_with('/') || matches!(name, "meta" | "img")) {
            open.push(name);
        }
        for text in [tag, text] {
            for entity in text.split('&').skip(1) {
                let name = entity.split(';').next().unwrap_or("");
                assert!(["amp", "lt", "gt", "quot", "#39"].contains(&name), "&{entity}");
            }
        }
    }
    assert_eq!(open, [""; 0]);
}

fn says(drawn: &Drawn, text: &str) -> bool {
    drawn.texts.iter().any(|(drawn, _)| drawn == text)
}

#[test]
fn a_full_plot_is_drawn_alike_everywhere() {
    let plot = error_time();
    let drawn = check(&plot);
    for series in &plot.series {
        assert!(says(&drawn, &series.name), "{}", series.name);
    }
    for text in ["0.001", "0.1", "0.05", &plot.title, &plot.x.label, &plot.y.label] {
        assert!(says(&drawn, text), "{text}");
    }
    // Where there is room, what a point is stands beside it.
    assert!(drawn.texts.iter().any(|(text, _)| text.ends_with(" spp")));

    for theme in [Theme::Light, Theme::Dark] {
        let png = plot.png(theme);
        assert_eq!(png, plot.png(theme));
        let (width, height, pixels) = decode(&png);
        assert_eq!((width, height), (1600, 1000));
        assert_eq!(pixels[0], Ink::Paper.rgb(theme));
        for k in 0..plot.series.len() {
            // A sample in the legend and the points or the line.
            let count = pixels.iter().filter(|&&pixel| pixel == Ink::Series(k).rgb(theme)).count();
            assert!(count > 100, "series {k} has {count} pixels in {theme:?}");
        }
    }
}

#[test]
fn an_svg_file_stands_alone() {
    let svg = error_time().svg();
    assert!(svg.starts_with("<?xml") && svg.contains("xmlns=\"http://www.w3.org/2000/svg\""));
    assert!(
        svg.contains("role=\"img\"")
            && svg.contains("<title>Error against time, demo hall at 1024 × 1024 &lt;&amp; more&gt;</title>")
    );
    assert!(svg.contains("@media(prefers-color-scheme:dark)"));
    for theme in [Theme::Light, Theme::Dark] {
        for k in 0..5 {
            assert!(svg.contains(&format!("#{:06x}", Ink::Series(k).rgb(theme))));
        }
    }
    assert!(svg.contains("<title>seeded sampler\n1 spp\n"), "points say what they are");
    assert!(svg.contains("s (median of 7, bars: lowest and highest): 0.02 (0.0186 to 0.0224)"));
    // Nothing is loaded.
    assert_eq!(svg.matches("http").count(), 1);
    assert!(!svg.contains("url(") && !svg.contains("href") && !svg.contains("<script"));
}

#[test]
fn long_names_stand_below() {
    let mut plot = error_time();
    plot.title = "A title ".repeat(40);
    plot.x.label = "an x label ".repeat(40);
    plot.y.label = "a y label ".repeat(40);
    for series in &mut plot.series {
        series.name += " with positions of 16 bits, normals of 16 bits and uv of 12 bits";
    }
    plot.series[0].name = "a name ".repeat(100);
    plot.series[1].points[0].label = "a label ".repeat(100);
    plot.series.push(Series { name: "nothing".into(), points: vec![point(1.0, 0.0)], line: Line::Joined });
    let drawn = check(&plot);
    let y_of =
        |start: &str| drawn.texts.iter().find(|(text, _)| text.starts_with(start)).map(|(_, at)| at[1]);
    let label = y_of("an x label").expect("an x label");
    assert!(
        ["a name", "low discrepancy", "nothing (no points)"]
            .iter()
            .all(|name| y_of(name).is_some_and(|y| y > label))
    );
    assert_eq!(plot.png(Theme::Dark), plot.png(Theme::Dark));
}

#[test]
fn many_series_are_told_by_colour_and_marker() {
    let mut plot = of(Scale::Linear, Vec::new());
    plot.series = (0..60)
        .map(|k| Series {
            name: format!("series {k}"),
            points: vec![point(f64::from(k), 1.0)],
            line: Line::None,
        })
        .collect();
    let drawn = check(&plot);
    assert!(says(&drawn, "series 47") && !says(&drawn, "series 48") && says(&drawn, "and 12 more"));
}

#[test]
fn values_without_a_place_are_counted() {
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX];
    for (scale, note) in [
        (Scale::Log, "Points not drawn: 7 not finite, 2 zero or less on a logarithmic axis."),
        (Scale::Linear, "Points not drawn: 8 not finite."),
    ] {
        let mut points: Vec<_> = bad.into_iter().flat_map(|v| [point(v, 1.0), point(1.0, v)]).collect();
        points.extend([point(2.0, 3.0), point(4.0, 5.0)]);
        if scale == Scale::Log {
            points.extend([point(0.0, 1.0), point(1.0, -1.0)]);
            // The largest number has a place on a logarithmic axis.
            points.retain(|p| p.x != f64::MAX || p.y != 1.0);
            points.retain(|p| p.y != f64::MAX || p.x != 1.0);
            points.push(point(f64::NAN, 0.0));
        }
        for line in [Line::None, Line::Joined, Line::Stepped, Line::Dashed] {
            let mut plot = of(scale, points.clone());
            plot.series[0].line = line;
            assert!(says(&check(&plot), note), "{scale:?} {line:?}");
        }
    }
    let one = of(Scale::Log, vec![point(1.0, 0.0), point(1.0, 1.0)]);
    assert!(says(&check(&one), "Point not drawn: 1 zero or less on a logarithmic axis."));
}

#[test]
fn hard_plots_have_places_for_everything() {
    let extremes = [f64::MIN_POSITIVE, 5e-324, 1e-300, 1.0, 1.0 + f64::EPSILON, 1e15, 1e299, 1e300];
    for scale in [Scale::Linear, Scale::Log] {
        assert!(says(&check(&of(scale, Vec::new())), "nothing to show"));
        check(&Plot { series: Vec::new(), ..of(scale, Vec::new()) });
        for a in extremes {
            check(&of(scale, vec![point(a, a)]));
            for b in extremes.into_iter().filter(|&b| b > a) {
                check_places(&of(scale, vec![point(a, b), point(b, -a), point(b, a)]));
            }
        }
    }
}

#[test]
fn error_bars_end_at_the_plot_where_a_range_has_no_end() {
    let ranged = |range| Point { y_range: Some(range), ..point(2.0, 2.0) };
    // Of the lines at the middle of the plot: the bar, and a cap at each end that was measured.
    let lines = |range| {
        let drawn = check(&of(Scale::Log, vec![point(1.0, 1.0), ranged(range), point(4.0, 4.0)]));
        drawn.lines.iter().filter(|(_, stroke)| stroke.width == 1.2 && stroke.ink == Ink::Series(0)).count()
    };
    assert_eq!(lines((1.5, 3.0)), 3);
    assert_eq!(lines((3.0, 1.5)), 3);
    assert_eq!(lines((0.0, 3.0)), 2);
    assert_eq!(lines((f64::NEG_INFINITY, f64::INFINITY)), 1);
    assert_eq!(lines((f64::NAN, 3.0)), 0);
}

#[test]
fn a_front_holds_what_is_reached_until_more_is() {
    let mut plot = of(Scale::Linear, vec![point(3.0, 1.0), point(1.0, 5.0), point(2.0, 4.0)]);
    plot.series[0].line = Line::Stepped;
    let drawn = check(&plot);
    let (front, _) = drawn.lines.iter().find(|(_, stroke)| stroke.width == 2.5).expect("a front");
    assert_eq!(front.len(), 5);
    for (k, pair) in front.windows(2).enumerate() {
        // Right, down, right, down.
        let (right, down) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        assert!(if k % 2 == 0 { right > 0.0 && down == 0.0 } else { right == 0.0 && down > 0.0 });
    }
}

#[test]
fn a_page_holds_everything_and_loads_nothing() {
    let hostile = "<script>alert('&\"')</script>\u{1b}[2J";
    let text = || vec![hostile.to_owned(), "plain".to_owned()];
    let png = error_time().png(Theme::Light);
    let mut plot = error_time();
    plot.title = hostile.into();
    plot.series[0].name = hostile.into();
    plot.series[0].points[0].label = hostile.into();
    let page = Page {
        title: hostile.into(),
        summary: text(),
        sections: vec![PageSection {
            title: hostile.into(),
            text: text(),
            plot: Some(plot),
            pictures: vec![Picture { name: hostile.into(), caption: hostile.into(), png: png.clone() }],
            table: Some(Table { columns: text(), rows: vec![text(), text()], numeric: vec![false, true] }),
        }],
        commands: text(),
        machine: vec![(hostile.into(), hostile.into())],
        caveats: text(),
    };
    let html = page.html();
    assert_eq!(html, page.html());
    check_markup(&html);
    assert!(!html.contains("<script") && !html.contains("\u{1b}"));
    assert!(html.contains("&lt;script&gt;alert(&#39;&amp;&quot;&#39;)&lt;/script&gt;\u{fffd}[2J"));
    assert_eq!(html.matches("http").count(), 2, "the name of SVG, and http-equiv");
    assert_eq!(html.matches("<th scope=\"col\"").count(), 2);
    assert_eq!(html.matches("<th scope=\"row\"").count(), 1);
    assert_eq!(html.matches("<td class=\"n\">").count(), 2);
    assert!(html.contains(&format!("src=\"data:image/png;base64,{}\"", base64(&png))));
    check_markup(&Page::default().html());
}

#[test]
fn base64_is_that_of_rfc_4648() {
    let cases = [
        ("", ""),
        ("f", "Zg=="),
        ("fo", "Zm8="),
        ("foo", "Zm9v"),
        ("foob", "Zm9vYg=="),
        ("foobar", "Zm9vYmFy"),
    ];
    for (plain, code) in cases {
        assert_eq!(base64(plain.as_bytes()), code);
    }
    assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
}
