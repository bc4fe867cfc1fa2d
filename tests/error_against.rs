//! `tessera render --error-against`: how far a picture is from a truer one, beside the time that it took.

use crate::support::{Folder, Tessera};

/// A box with mirrors and glass, small enough for a test.
const BOX: &str = "[generate]\nkind = \"cornell\"\ntriangles = 2000\n";

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("box.toml", BOX);
    folder
}

/// A render of 40 x 40 pixels to be.
fn render(folder: &Folder, args: &[&str]) -> Tessera {
    let small = ["render", "box.toml", "--size", "40x40", "--tile", "16", "--backend", "cpu"];
    let kept = folder.path().join("cache");
    Tessera::new(small).args(args).within(folder.path()).env("XDG_CACHE_HOME", kept)
}

/// The steps of its report.
fn steps(folder: &Folder, args: &[&str]) -> Vec<serde_json::Value> {
    let report: serde_json::Value =
        serde_json::from_str(&render(folder, args).args(["--json"]).run().ok()).unwrap();
    report["error"]["steps"].as_array().unwrap_or_else(|| panic!("no steps: {report}")).clone()
}

fn rmse(step: &serde_json::Value) -> f64 {
    step["error"]["rmse"].as_f64().expect("an error")
}

#[test]
fn plain_vertices_are_no_error_to_themselves() {
    let folder = folder();
    for out in ["a.png", "a.exr"] {
        let own = steps(&folder, &["--out", out, "--plain", "--error-against", "plain"]);
        assert_eq!((own.len(), rmse(&own[0])), (1, 0.0), "{out}");
        let packed = steps(&folder, &["--out", out, "--error-against", "plain"]);
        assert!(rmse(&packed[0]) > 0.0 && packed[0]["error"]["psnr_db"].as_f64().unwrap() > 25.0, "{out}");
    }
}

#[test]
fn the_error_falls_as_samples_are_added_and_the_last_picture_is_the_one_asked_for() {
    let folder = folder();
    let without = render(&folder, &["--out", "a.exr", "--spp", "8", "--json"]).run().ok();
    let without: serde_json::Value = serde_json::from_str(&without).unwrap();
    assert!(without["error"].is_null());

    let with =
        render(&folder, &["--out", "b.exr", "--spp", "8", "--error-against", "spp:128", "--json"]).run().ok();
    let with: serde_json::Value = serde_json::from_str(&with).unwrap();
    assert_eq!(with["image_hash"], without["image_hash"]);
    let steps = with["error"]["steps"].as_array().unwrap();
    let samples: Vec<_> = steps.iter().map(|step| step["samples"].as_u64().unwrap()).collect();
    assert_eq!(samples, [1, 2, 4, 8]);
    assert!(rmse(&steps[3]) < rmse(&steps[1]) && rmse(&steps[3]) < 0.5 * rmse(&steps[0]));
    let total: Vec<_> = steps.iter().map(|step| step["total_ms"].as_f64().unwrap()).collect();
    assert!(total.is_sorted());

    // For people it is a table.
    let text = render(&folder, &["--out", "b.exr", "--spp", "3", "--error-against", "spp:12"]).run().ok();
    assert!(
        text.contains("error      against 12 samples a pixel") && text.contains("other triangle"),
        "{text}"
    );
}

#[test]
fn a_png_picture_is_held_to_what_it_can_show_of_the_oracle_and_of_files() {
    let folder = folder();
    let oracle = steps(&folder, &["--out", "a.png", "--plain", "--error-against", "oracle"]);
    // 8 bits of sRGB are at most 0.0045 of linear light apart near white; edges and f32 add to that.
    assert!(rmse(&oracle[0]) < 0.05, "{}", oracle[0]);
    let layers = steps(&folder, &["--out", "truth.exr", "--plain", "--error-against", "oracle"]);
    assert_eq!(layers[0]["error"]["wrong_id_share"], 0.0);
    // The same picture in 8 bits: what is left is coding, half a step of sRGB at most, for light of at most 1.
    let file = steps(&folder, &["--out", "b.png", "--plain", "--error-against", "truth.exr"]);
    assert!(file[0]["error"]["max_abs"].as_f64().unwrap() < 0.0046, "{}", file[0]);
}

#[test]
fn what_cannot_be_compared_is_refused_before_any_work() {
    let folder = folder();
    render(&folder, &["--out", "small.png"]).run().ok();
    let refused = |args: &[&str], code: i32, words: &str| {
        let run = render(&folder, args).run();
        assert_eq!(run.code, Some(code), "{args:?}: {}", run.stderr);
        assert!(run.stderr.contains(words), "{args:?}: {}", run.stderr);
    };
    refused(&["--out", "a.png", "--error-against", "nothing"], 2, "spp:N");
    refused(&["--out", "a.png", "--error-against", "missing.exr"], 1, "missing.exr");
    refused(&["--out", "a.png", "--spp", "4", "--error-against", "spp:8"], 2, "at least 16");
    refused(&["--out", "./small.png", "--error-against", "small.png"], 2, "replace");
    refused(&["--out", "a.exr", "--error-against", "small.png"], 2, "8-bit codes");
    let args = ["render", "box.toml", "--size", "30x30", "--out", "a.png", "--error-against", "small.png"];
    Tessera::new(args).within(folder.path()).run().fails(2, &["40 x 40"]);
    assert!(!folder.path().join("a.png").exists());
}
