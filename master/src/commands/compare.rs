//! `tessera compare`.

use super::CommandError;
use clap::Args;
use std::path::{Path, PathBuf};
use tessera_master::compare::{Comparison, Picture, compare, error_picture};
use tessera_master::{FrameBuffer, OutputFile, PixelFormat};

/// Two pictures.
#[derive(Debug, Args)]
#[command(
    long_about = "Say how far two pictures differ\n\n\
        Compares red, green and blue of two PNG files (8-bit codes, peak 255; 16-bit codes, peak 65535) or of two EXR files (linear, \
        peak 1) of one size: mean squared error and its root; PSNR of the values, of linear light (decoded codes; EXR not clamped) and \
        of sRGB-coded light (EXR clamped to [0, 1] and coded, not rounded); SSIM (Wang et al. 2004: Gaussian 11 x 11 windows, mean over \
        the channels); mean LDR-FLIP (Andersson et al. 2020: what can be seen, 0 to 1, for 67 pixels a degree, EXR clamped to [0, 1]); \
        the largest difference; the share of pixels that differ; and, of two EXR files with the layer id.triangle, the share of pixels \
        that show another triangle. Equal pictures have no PSNR. Exit code 0 whether they differ or not.",
    after_help = "Examples:\n  tessera compare packed.png plain.png\n  tessera compare a.exr b.exr --json\n  \
        tessera compare packed.png plain.png --map where.png"
)]
pub struct CompareArgs {
    /// One picture, .png or .exr
    a: PathBuf,
    /// The other
    b: PathBuf,
    /// Write where they differ: FLIP of each pixel as a PNG, black where nothing can be seen, pale yellow where all differs
    #[arg(long, value_name = "FILE.png")]
    map: Option<PathBuf>,
    /// Print one JSON object: mse, rmse, psnr_db, psnr_linear_db, psnr_srgb_db (null when equal), ssim (null below 11 pixels), flip,
    /// max_abs, differing_share, wrong_id_share (null without triangles), peak, width, height
    #[arg(long)]
    json: bool,
}

pub fn run(args: CompareArgs) -> Result<(), CommandError> {
    let target = args.map.as_deref().map(|map| map_file(&args, map)).transpose()?;
    let load = |path| Picture::load(path).map_err(CommandError::failed);
    let (a, b) = (load(&args.a)?, load(&args.b)?);
    let found = compare(&a, &b).map_err(CommandError::failed)?;
    if let Some(target) = target {
        let rgb = error_picture(&a, &b).map_err(CommandError::failed)?;
        let rgba = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        let map = FrameBuffer::from_rows(a.width, a.height, PixelFormat::Rgba8, rgba);
        map.map_err(CommandError::failed)?.write(&target).map_err(CommandError::failed)?;
    }
    if args.json { super::print_json(&found) } else { super::print_text(&text(&found)) }
}

/// The file for the map: a PNG, and neither of the pictures.
fn map_file(args: &CompareArgs, map: &Path) -> Result<OutputFile, CommandError> {
    if !map.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        return Err(CommandError::Usage(format!("--map {}: name a .png file", map.display())));
    }
    let target = OutputFile::check(map).map_err(CommandError::failed)?;
    match [&args.a, &args.b].into_iter().find(|picture| target.is_at(picture)) {
        Some(picture) => Err(CommandError::Usage(format!(
            "--map {} would replace a picture; name another file",
            picture.display()
        ))),
        None => Ok(target),
    }
}

fn text(found: &Comparison) -> String {
    let or_none = |value: Option<f64>, why: &str, unit: &str| match value {
        Some(value) => format!("{value:.4}{unit}"),
        None => why.to_owned(),
    };
    let psnr = |value| or_none(value, "none, the pictures are equal", " dB");
    let ids = found.wrong_id_share.map_or_else(
        || "not known, a picture holds none".to_owned(),
        |share| format!("another in {:.4} % of the pixels", share * 100.0),
    );
    format!(
        "size       {} x {} pixels, peak {}\n\
         MSE        {:.6e}, its root {:.6e}\n\
         PSNR       {}\n\
         in light   {}\n\
         sRGB-coded {}\n\
         SSIM       {}\n\
         FLIP       {}\n\
         largest    {}\n\
         differing  {:.4} % of the pixels\n\
         triangles  {ids}\n",
        found.width,
        found.height,
        found.peak,
        found.mse,
        found.rmse,
        psnr(found.psnr_db),
        psnr(found.psnr_linear_db),
        or_none(found.psnr_srgb_db, "none, nothing differs between black and white", " dB"),
        or_none(found.ssim, "none, a side is shorter than a window of 11 pixels", ""),
        format_args!("{:.4}", found.flip),
        found.max_abs,
        found.differing_share * 100.0,
    )
}
