//! `tessera bench error-time`, run small: what it prints and writes, and that it keeps its promises.

use crate::support::{Folder, Tessera, names};
use std::fs;

/// A box with mirrors and glass, small enough for a test.
const BOX: &str = "[generate]\nkind = \"cornell\"\ntriangles = 2000\n";

/// The report of a run on [`BOX`] in `folder`, with its true pictures kept there.
fn report(folder: &Folder, args: &[&str]) -> serde_json::Value {
    folder.write("box.toml", BOX);
    let small = ["--size", "48x48", "--reps", "2", "--references", "truths", "--json"];
    let run = Tessera::new(["bench", "error-time", "box.toml"]).args(small).args(args).within(folder.path());
    serde_json::from_str(&run.run().ok()).expect("one JSON object")
}

fn knob<'a>(report: &'a serde_json::Value, name: &str) -> &'a serde_json::Value {
    let knobs = report["knobs"].as_array().expect("knobs");
    knobs.iter().find(|found| found["knob"] == name).unwrap_or_else(|| panic!("no {name}"))
}

fn rows<'a>(report: &'a serde_json::Value, name: &str) -> &'a [serde_json::Value] {
    knob(report, name)["rows"].as_array().expect("rows")
}

fn rmse(row: &serde_json::Value) -> f64 {
    row["error"]["rmse"].as_f64().expect("an error")
}

#[test]
fn more_samples_and_finer_codes_are_nearer_to_the_truth() {
    let folder = Folder::new();
    let report = report(
        &folder,
        &["--knob", "spp,adaptive,positions,depth,cutoff", "--spp-max", "16", "--clock", "cpu"],
    );

    // Errors fall with the samples about as edges let them, by n^-3/4; independent samples would fall by n^-1/2. A picture of 48 x 48 pixels
    // has some hundred edge pixels, whose errors are known to a tenth: over three doublings that leaves the slope 0.1.
    let rates = &knob(&report, "spp")["rates"];
    for (place, sampler) in ["jittered", "low-discrepancy"].into_iter().enumerate() {
        let (name, slope) = (&rates[place][0], rates[place][1]["slope"].as_f64().expect("a slope"));
        assert_eq!(name, sampler);
        assert!((-0.95..-0.6).contains(&slope), "{sampler}: {slope}");
        assert_eq!(
            rows(&report, "spp").iter().filter(|row| row["series"] == sampler).count(),
            5,
            "{sampler}"
        );
    }

    // A lower threshold takes more samples and errs less, and no block gets fewer than 16 samples.
    let adaptive: Vec<_> =
        rows(&report, "adaptive").iter().filter(|row| row["series"] == "adaptive").collect();
    let (first, last) = (adaptive[0], adaptive[adaptive.len() - 1]);
    let samples = |row: &serde_json::Value| row["samples_mean"].as_f64().expect("samples");
    assert!(samples(first) >= 16.0 && samples(last) > 1.5 * samples(first), "{first} {last}");
    assert!(rmse(last) < rmse(first));

    // The headline: a smaller error is not had in less time.
    let seconds = knob(&report, "spp")["time_to_error"].as_array().expect("times").iter();
    let seconds: Vec<_> = seconds.filter_map(|found| found["seconds"].as_f64()).collect();
    assert!(seconds.len() > 1 && seconds.is_sorted(), "{seconds:?}");

    // A grid of 32 intervals is worse than the finest, and that is worse than no grid.
    let positions = rows(&report, "positions");
    let grid: Vec<_> = positions.iter().filter(|row| row["series"] == "grid").map(rmse).collect();
    let plain = positions.iter().find(|row| row["series"] == "plain").map(rmse).expect("plain vertices");
    assert!(grid[0] > *grid.last().unwrap() && grid[0] > 2.0 * plain, "{grid:?}, plain {plain}");

    // The truth of these has more depth, or hardly a cut-off: what is asked for approaches it.
    for knob in ["depth", "cutoff"] {
        let errors: Vec<_> = rows(&report, knob).iter().map(rmse).collect();
        let (first, last) = (errors[0], *errors.last().unwrap());
        assert!(first > 4.0 * last, "{knob}: {errors:?}");
    }
}

#[test]
fn what_does_not_touch_the_picture_moves_time_alone() {
    let folder = Folder::new();
    let report = report(&folder, &["--knob", "refs,backend,tile"]);
    let all: Vec<_> = ["refs", "backend", "tile"].iter().flat_map(|knob| rows(&report, knob)).collect();
    assert!(all.len() >= 12);
    assert!(all.iter().all(|row| row["hash"] == all[0]["hash"] && row["error"] == all[0]["error"]));
    let bytes = |place: usize| rows(&report, "refs")[place]["bytes"]["tree"].as_u64().expect("bytes");
    assert!(bytes(0) > bytes(1) && bytes(1) >= bytes(2), "references make the tree smaller");
}

#[test]
fn a_folder_gets_the_page_the_plots_and_the_figures() {
    let folder = Folder::new();
    let report = report(&folder, &["--knob", "packed,uv", "--out", "page"]);
    let page = folder.path().join("page");
    let expected =
        ["error-time.csv", "error-time.json", "index.html", "packed.png", "packed.svg", "uv.png", "uv.svg"];
    assert_eq!(names(&page), expected);

    let kept: serde_json::Value =
        serde_json::from_slice(&fs::read(page.join("error-time.json")).unwrap()).unwrap();
    assert_eq!(kept, report);
    let csv = fs::read_to_string(page.join("error-time.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + rows(&report, "packed").len() + rows(&report, "uv").len());
    let html = fs::read_to_string(page.join("index.html")).unwrap();
    for word in ["POS/NORM/TEX", "<svg", "tessera bench error-time box.toml", "data:image/png;base64,"] {
        assert!(html.contains(word), "{word}");
    }
    // Nothing is fetched: the one address is the name of a language.
    let html = html.replace("http://www.w3.org/2000/svg", "");
    for word in ["http:", "https:", "url(", "<script", "@import"] {
        assert!(!html.contains(word), "{word}");
    }

    // Table 4 compares with plain vertices: its first row is that picture.
    let packed = rows(&report, "packed");
    // The box has no textures: with texture coordinates it comes to the same.
    assert_eq!(packed.len(), 6);
    assert!(packed[0]["to_plain"]["psnr_db"].is_null() && packed[0]["to_plain"]["mse"] == 0.0);
    for row in [&packed[1], &packed[2]] {
        // So small a picture may show no difference in 8 bits.
        assert!(row["to_plain"]["psnr_db"].as_f64().is_none_or(|db| db > 30.0), "{row}");
    }
    // Nothing of a knob is at least as fast and as true as what is on its front.
    let time = |row: &serde_json::Value| row["wall_s"]["median"].as_f64().unwrap();
    for row in packed.iter().filter(|row| row["on_front"] == true) {
        let beats = |other: &&serde_json::Value| {
            other["series"] == row["series"] && time(other) < time(row) && rmse(other) < rmse(row)
        };
        assert!(packed.iter().find(beats).is_none(), "{row}");
    }
}

#[test]
fn truths_are_kept_and_damaged_ones_made_again() {
    let folder = Folder::new();
    let first = report(&folder, &["--knob", "normals"]);
    let kept = folder.path().join("truths");
    let kept_names = names(&kept);
    assert_eq!(kept_names.len(), 1, "{kept_names:?}");
    let file = kept.join(&kept_names[0]);
    let made = fs::metadata(&file).unwrap().modified().unwrap();

    let again = report(&folder, &["--knob", "normals"]);
    assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), made, "it is read, not made again");
    let errors = |report: &serde_json::Value| rows(report, "normals").iter().map(rmse).collect::<Vec<_>>();
    assert_eq!(errors(&first), errors(&again));

    let whole = fs::read(&file).unwrap();
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(errors(&report(&folder, &["--knob", "normals"])), errors(&first));
    assert_eq!(fs::read(&file).unwrap(), whole, "made again, the same");
}

#[test]
fn what_cannot_be_measured_is_refused_at_once() {
    let folder = Folder::new();
    folder.write("box.toml", BOX);
    let refused = |args: &[&str], code: i32, words: &str| {
        let run = Tessera::new(["bench", "error-time"]).args(args).within(folder.path()).run();
        assert_eq!(run.code, Some(code), "{args:?}: {}", run.stderr);
        assert!(run.stderr.contains(words), "{args:?}: {}", run.stderr);
        assert_eq!(run.stderr.trim_end().lines().count(), 1);
    };
    refused(&["a.tpack"], 2, "a bundle holds no exact mesh");
    refused(&["missing.toml"], 1, "missing.toml");
    refused(&["box.toml", "--knob", "colour"], 2, "colour");
    refused(&["box.toml", "--camera", "nowhere"], 2, "nowhere");
    refused(&["box.toml", "--out", "box.toml"], 1, "--out box.toml");
    refused(&["box.toml", "--references", "box.toml"], 1, "--references box.toml");
}
