//! `tessera scene pack`.

use super::progress::Progress;
use super::{CommandError, SceneArgs, run};
use clap::Args;
use std::path::PathBuf;
use tessera_master::OutputFile;
use tessera_master::report::{LeftOutLine, bytes, write_lists};

/// What to pack, and where to.
#[derive(Debug, Args)]
#[command(
    long_about = "Write the bundle that workers hold\n\n\
        The bundle (.tpack) holds everything that rendering needs and nothing else, and can be rendered like any scene. It is named by \
        the hash of its content: the same scene and options give the same bytes on every machine.",
    after_help = "Examples:\n  tessera scene pack sponza.toml --out sponza.tpack\n  tessera render sponza.tpack --out sponza.png"
)]
pub struct PackArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The file to write, .tpack
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print one JSON object: scene, out, pack_id, bytes, left_out, warnings, notes
    #[arg(long)]
    json: bool,
}

#[derive(serde::Serialize)]
struct PackReport<'a> {
    scene: &'a str,
    out: &'a std::path::Path,
    pack_id: String,
    bytes: u64,
    left_out: &'a [LeftOutLine],
    warnings: &'a [String],
    notes: &'a [String],
}

pub fn run(args: PackArgs, progress: &Progress) -> Result<(), CommandError> {
    if !args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack")) {
        return Err(CommandError::Usage(format!(
            "--out {}: a bundle is named .tpack, so that the other commands know it",
            args.out.display()
        )));
    }
    let out = OutputFile::check(&args.out).map_err(CommandError::failed)?;
    let prepared = run::prepare_scene(&args.scene.scene, &args.scene.packing, progress)?;
    out.write_bytes(prepared.pack.bytes()).map_err(CommandError::failed)?;
    let left_out: Vec<_> = prepared.left_out.iter().map(LeftOutLine::from).collect();
    let report = PackReport {
        scene: &prepared.name,
        out: &args.out,
        pack_id: prepared.pack.id().to_string(),
        bytes: prepared.pack.bytes().len() as u64,
        left_out: &left_out,
        warnings: &prepared.warnings,
        notes: &prepared.notes,
    };
    if args.json {
        return super::print_json(&report);
    }
    let mut text = format!("scene      {}\n", report.scene);
    // Writing to a string cannot fail.
    let _ = write_lists(&mut text, &left_out, report.warnings, report.notes);
    text += &format!(
        "pack id    {}\nwrote      {}, {}\n",
        report.pack_id,
        report.out.display(),
        bytes(report.bytes)
    );
    super::print_text(&text)
}
