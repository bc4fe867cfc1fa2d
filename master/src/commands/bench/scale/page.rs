//! The page of `bench scale`.

use super::case::Row;
use super::paper::{COMPRESSED, TABLE_7, TABLE_9, WORKERS};
use super::report::{Report, Summary, distinct, prediction_error};
use crate::commands::page::{Axis, Line, Page, PageSection, Plot, Point, Scale, Series, Table};

/// The page about `report`.
pub fn page(report: &Report) -> Page {
    let [width, height] = report.size;
    let links = distinct(report.summaries.iter().map(|s| s.link.as_str()));
    let mut sections = Vec::new();
    for link in &links {
        sections.push(times(report, link));
        sections.push(efficiencies(report, link));
    }
    sections.extend(beside_the_paper(report));
    sections.extend(reasons(report));
    sections.extend(compression(report));
    sections.push(bytes_and_idle(report));
    let mut summary = vec![format!(
        "{}, camera {}, {width} x {height} pixels; devices: {}, a frame takes one of speed 1 {:.3} s{}.",
        report.scene,
        report.camera,
        report.device,
        report.one_worker_s,
        if report.launch_us > 0 {
            format!(", and {} us a tile besides", report.launch_us)
        } else {
            String::new()
        }
    )];
    summary.push(
        "Ideal: what all tiles cost over the sum of the workers' speeds, and one worker's share of the bytes on the link with its latency. \
         Efficiency: the time of one worker over the number of workers times the time of all; against the same balancing, as the paper counts, and \
         against the best that one worker does with any."
            .into(),
    );
    if let Some((median, largest, cases)) = prediction_error(&report.summaries) {
        summary.push(format!(
            "The simulator, asked the same, was off by {:.1} % (median of {cases} cases), {:.1} % at most.",
            100.0 * median,
            100.0 * largest
        ));
    }
    Page {
        title: format!("Frame time by workers, balancing and link: {}", report.scene),
        summary,
        sections,
        commands: vec![report.command.clone()],
        machine: report.machine.clone(),
        caveats: caveats(report),
    }
}

fn caveats(report: &Report) -> Vec<String> {
    let mut caveats = vec![
        "Links are emulated: one queue in each direction that all workers share, with rate, latency, jitter, loss and costs by packet and burst as \
         their profiles say; no radio and no switch is exactly that."
            .into(),
        "What is between the processes of this machine is in all times: its loopback, its scheduler, and whatever else it did.".into(),
    ];
    if report.device == "replay" {
        caveats.push(
            "Devices are played: a tile takes what it took one core of this machine, by a common factor and the device's speed; nothing is rendered."
                .into(),
        );
    }
    caveats.extend(report.links.iter().map(|link| format!("Link {}: {}.", link.name, link.source)));
    caveats
}

fn of_link<'a>(report: &'a Report, link: &'a str) -> impl Iterator<Item = &'a Summary> {
    report.summaries.iter().filter(move |s| s.link == link)
}

fn series(report: &Report, link: &str, value: impl Fn(&Summary) -> Option<f64>) -> Vec<Series> {
    let balances = distinct(of_link(report, link).map(|s| s.balance.as_str()));
    let curve = |balance: &str| {
        let point = |s: &Summary| {
            Some(Point { x: s.workers as f64, y: value(s)?, label: String::new(), ..Point::default() })
        };
        let mut points: Vec<_> =
            of_link(report, link).filter(|s| s.balance == balance).filter_map(point).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: balance.to_owned(), points, line: Line::Joined }
    };
    balances.into_iter().map(curve).collect()
}

/// The plot of frame times over workers.
pub fn time_plot(report: &Report, link: &str) -> Plot {
    let mut series = series(report, link, |s| Some(s.median_ms));
    let mut ideal: Vec<Point> = Vec::new();
    for s in of_link(report, link) {
        // Bytes differ by balancing; the least is the bound of all.
        match ideal.iter_mut().find(|point| point.x == s.workers as f64) {
            Some(point) => point.y = point.y.min(s.ideal_ms),
            None => ideal.push(Point { x: s.workers as f64, y: s.ideal_ms, ..Point::default() }),
        }
    }
    ideal.sort_by(|a, b| a.x.total_cmp(&b.x));
    series.push(Series { name: "ideal".into(), points: ideal, line: Line::Dashed });
    Plot {
        title: format!("{link}: time of a frame"),
        x: Axis { label: "workers".into(), scale: Scale::Log },
        y: Axis { label: "median time of a frame, ms".into(), scale: Scale::Log },
        series,
    }
}

/// The plot of efficiencies over workers.
pub fn efficiency_plot(report: &Report, link: &str) -> Plot {
    Plot {
        title: format!("{link}: efficiency"),
        x: Axis { label: "workers".into(), scale: Scale::Log },
        y: Axis { label: "efficiency against the best one-worker time".into(), scale: Scale::Linear },
        series: series(report, link, |s| s.efficiency_best),
    }
}

fn times(report: &Report, link: &str) -> PageSection {
    let columns = [
        "balancing",
        "workers",
        "frames",
        "median ms",
        "mean ms",
        "min ms",
        "max ms",
        "ideal ms",
        "over ideal",
        "to paper-static",
        "simulated / measured",
    ];
    let rows = of_link(report, link).map(|s| {
        let or_dash = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
        let ms = |value: f64| format!("{value:.1}");
        vec![
            s.balance.clone(),
            s.workers.to_string(),
            s.frames.to_string(),
            ms(s.median_ms),
            ms(s.mean_ms),
            ms(s.min_ms),
            ms(s.max_ms),
            ms(s.ideal_ms),
            format!("{:.3}", s.over_ideal),
            or_dash(s.to_paper_static),
            or_dash(s.predicted),
        ]
    });
    let source = report.links.iter().find(|l| l.name == link).map(|l| l.source.clone());
    PageSection {
        title: format!("Link {link}"),
        text: source.into_iter().collect(),
        plot: Some(time_plot(report, link)),
        pictures: Vec::new(),
        table: Some(table(&columns, rows.collect(), 1)),
    }
}

fn efficiencies(report: &Report, link: &str) -> PageSection {
    let rows = of_link(report, link).map(|s| {
        let or_dash = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
        vec![s.balance.clone(), s.workers.to_string(), or_dash(s.efficiency), or_dash(s.efficiency_best)]
    });
    let columns = ["balancing", "workers", "against itself", "against the best one-worker time"];
    PageSection {
        title: format!("Efficiency on {link}"),
        text: Vec::new(),
        plot: Some(efficiency_plot(report, link)),
        pictures: Vec::new(),
        table: Some(table(&columns, rows.collect(), 1)),
    }
}

/// The paper's Table 9, and ours on the link that was fitted to it.
fn beside_the_paper(report: &Report) -> Option<PageSection> {
    let ours = |balance: &str| {
        let found = WORKERS.map(|workers| {
            let is_it = |s: &&Summary| s.link == "phone" && s.balance == balance && s.workers == workers;
            report.summaries.iter().find(is_it).map(|s| s.median_ms)
        });
        found.iter().any(Option::is_some).then_some(found)
    };
    let mut rows = Vec::new();
    let mut push = |name: String, times: [Option<f64>; 5]| {
        let efficiency = times[0].zip(times[4]).map(|(one, all)| one / (16.0 * all));
        let cell = |time: &Option<f64>| time.map_or("-".to_owned(), |time| format!("{time:.1}"));
        let cells = times.iter().map(cell).chain([efficiency.map_or("-".into(), |e| format!("{e:.3}"))]);
        rows.push(std::iter::once(name).chain(cells).collect());
    };
    for (balance, name) in [("paper-static", "static"), ("paper-dynamic", "dynamic")] {
        for (scene, fixed, pulled) in &TABLE_9 {
            let times = if name == "static" { fixed } else { pulled };
            push(format!("paper, {scene}, {name}"), times.map(Some));
        }
        if let Some(found) = ours(balance) {
            push(format!("ours, {}, {balance}", report.scene), found);
        }
    }
    for balance in ["weighted", "staggered", "steal", "auto"] {
        if let Some(found) = ours(balance) {
            push(format!("ours, {}, {balance}", report.scene), found);
        }
    }
    ours("paper-static")?;
    let columns = ["ms of a frame", "1", "2", "4", "8", "16", "efficiency at 16"];
    Some(PageSection {
        title: "Beside the paper's Table 9".into(),
        text: vec![
            "The paper's phones and scenes are not ours: times of one worker are set (see above), the link was fitted to the paper's. What is to \
             be compared is the ranking and the shape."
                .into(),
        ],
        plot: None,
        pictures: Vec::new(),
        table: Some(table(&columns, rows, 1)),
    })
}

/// What `auto` says of what it has done.
fn reasons(report: &Report) -> Option<PageSection> {
    let last = |s: &&Summary| {
        let is_of = |r: &&Row| (&r.link, &r.balance, r.workers) == (&s.link, &s.balance, s.workers);
        report.rows.iter().rfind(is_of)
    };
    let rows = report.summaries.iter().filter_map(|s| {
        let row = last(&s)?;
        Some(vec![s.link.clone(), s.workers.to_string(), row.tile.to_string(), row.why.clone()?])
    });
    let rows: Vec<_> = rows.collect();
    (!rows.is_empty()).then(|| PageSection {
        title: "What auto has chosen, and why".into(),
        text: vec!["Of the last frame of each case.".into()],
        plot: None,
        pictures: Vec::new(),
        table: Some(table(&["link", "workers", "tile", "why"], rows, 4)),
    })
}

/// The paper's Table 7, and ours.
fn compression(report: &Report) -> Option<PageSection> {
    let cell = |time: Option<f64>| time.map_or("-".to_owned(), |time| format!("{time:.1}"));
    let mut rows = Vec::new();
    for (scene, one, sixteen) in &TABLE_7 {
        let base = one[0];
        for (what, (one, sixteen)) in COMPRESSED.iter().zip(one.iter().zip(sixteen)) {
            let over = one / base;
            rows.push(vec![
                format!("paper, {scene}"),
                (*what).into(),
                cell(Some(*one)),
                format!("{over:.3}"),
                cell(*sixteen),
            ]);
        }
    }
    let base = report.compression.first()?.one_ms;
    for row in &report.compression {
        let over = format!("{:.3}", row.one_ms / base);
        let name = format!("ours, {}", report.scene);
        rows.push(vec![name, row.what.clone(), cell(Some(row.one_ms)), over, cell(Some(row.sixteen_ms))]);
    }
    let columns = ["scene", "compressed", "one worker, ms", "over nothing", "16 workers, ms"];
    Some(PageSection {
        title: "Beside the paper's Table 7: what compression costs".into(),
        text: vec![
            "Ours: one core's time of the frame with plain or packed vertices and with no or up to two references on inner nodes of the tree, scaled so \
             that both take what one device takes here; sixteen simulated on the phone's link with paper-static."
                .into(),
        ],
        plot: None,
        pictures: Vec::new(),
        table: Some(table(&columns, rows, 2)),
    })
}

fn bytes_and_idle(report: &Report) -> PageSection {
    let rows = report.summaries.iter().map(|s| {
        vec![
            s.link.clone(),
            s.balance.clone(),
            s.workers.to_string(),
            format!("{:.1}", s.bytes / 1024.0),
            format!("{:.1}", 100.0 * s.idle_share),
            format!("{:.3}", s.max_ms / s.min_ms),
            format!("{:.1}", s.after_ms),
            format!("{:.1}", s.master_us_per_message),
            format!("{:.1}", s.master_cpu_us_per_tile),
        ]
    });
    PageSection {
        title: "Bytes, idle shares, spread, and the master".into(),
        text: vec![
            "UDP payload of a frame in both directions; the share of the workers' time in which they had nothing to render; the slowest measured \
             frame over the fastest; the time from the last tile's rendering to the complete image; what the master's thread does for a message, a \
             tile's result among them (other threads receive and unpack); CPU time of the master's whole process for a tile."
                .into(),
        ],
        plot: None,
        pictures: Vec::new(),
        table: Some(table(
            &["link", "balancing", "workers", "KiB", "idle %", "max / min", "after the last tile, ms", "master, us a message", "CPU us a tile"],
            rows.collect(),
            2,
        )),
    }
}

/// A table whose first `texts` columns hold text.
fn table(columns: &[&str], rows: Vec<Vec<String>>, texts: usize) -> Table {
    Table {
        columns: columns.iter().map(|&column| column.to_owned()).collect(),
        rows,
        numeric: (0..columns.len()).map(|column| column >= texts).collect(),
    }
}
