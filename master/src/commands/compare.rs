//! `tessera compare`.

use super::CommandError;
use clap::Args;
use std::path::PathBuf;
use tessera_master::compare::{Comparison, compare_files};

/// Two pictures.
#[derive(Debug, Args)]
#[command(
    long_about = "Say how far two pictures differ\n\n\
        Compares red, green and blue of two PNG files (8-bit codes, peak 255; 16-bit codes, peak 65535) or of two EXR files (linear, \
        peak 1) of one size: mean squared error, PSNR, SSIM (Wang et al. 2004: Gaussian 11 x 11 windows, mean over the channels), the \
        largest difference, and the share of pixels that differ. Equal pictures have no PSNR. Exit code 0 whether they differ or not.",
    after_help = "Examples:\n  tessera compare packed.png plain.png\n  tessera compare a.exr b.exr --json"
)]
pub struct CompareArgs {
    /// One picture, .png or .exr
    a: PathBuf,
    /// The other
    b: PathBuf,
    /// Print one JSON object: mse, psnr_db (null when equal), ssim, max_abs, differing_share, peak, width, height
    #[arg(long)]
    json: bool,
}

pub fn run(args: CompareArgs) -> Result<(), CommandError> {
    let found = compare_files(&args.a, &args.b).map_err(CommandError::failed)?;
    if args.json { super::print_json(&found) } else { super::print_text(&text(&found)) }
}

fn text(found: &Comparison) -> String {
    let or_none = |value: Option<f64>, why: &str, unit: &str| match value {
        Some(value) => format!("{value:.4}{unit}"),
        None => why.to_owned(),
    };
    format!(
        "size       {} x {} pixels, peak {}\n\
         MSE        {:.6e}\n\
         PSNR       {}\n\
         SSIM       {}\n\
         largest    {}\n\
         differing  {:.4} % of the pixels\n",
        found.width,
        found.height,
        found.peak,
        found.mse,
        or_none(found.psnr_db, "none, the pictures are equal", " dB"),
        or_none(found.ssim, "none, a side is shorter than a window of 11 pixels", ""),
        found.max_abs,
        found.differing_share * 100.0,
    )
}
