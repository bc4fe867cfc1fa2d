//! `tessera bench tiles`: the paper's Table 8.

use super::args::{ClusterArgs, balances, chosen_balances, tile};
use super::case::{Row, median};
use super::link::LinkProfile;
use super::paper::{SIDES, TABLE_8};
use super::report::distinct;
use super::studio::{Studio, Way};
use crate::commands::bench::folder::Folder;
use crate::commands::page::write_csv;
use crate::commands::progress::Progress;
use crate::commands::{CommandError, print_json, print_text};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

/// Tiles to be measured.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure how frame time depends on the side of a tile\n\n\
        As `tessera bench scale`, for one link and several sides of tiles. Small tiles share work out more evenly and cost more messages and \
        launches; what a launch costs a device is stated by --launch-us (the paper's times of one worker fit 3000).",
    after_help = "Examples:\n  tessera bench tiles scenes/sponza.toml --quick --launch-us 3000\n  \
        tessera bench tiles scenes/hall.toml --balance auto --link wired --sides 128,64,32"
)]
pub struct TilesArgs {
    #[command(flatten)]
    pub cluster: ClusterArgs,
    /// Sides of tiles in pixels, multiples of 16
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "256,128,64,32", value_parser = tile)]
    sides: Vec<u32>,
    /// Numbers of workers, separated by commas
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "1,16")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=256))]
    workers: Vec<u32>,
    /// Ways of handing out tiles, separated by commas, or all
    #[arg(long, value_name = "MODES", value_delimiter = ',', default_value = "paper-static")]
    #[arg(value_parser = PossibleValuesParser::new(balances()).map(|name| name.to_string()))]
    balance: Vec<String>,
    /// A link: loopback, wired, lan100, wifi-ac, phone, wan, or a file of one
    #[arg(long, value_name = "NAME|FILE", default_value = "phone")]
    link: String,
}

pub fn run(args: &TilesArgs, progress: &Progress) -> Result<(), CommandError> {
    let link = LinkProfile::find(&args.link).map_err(CommandError::Usage)?;
    let balances = chosen_balances(&args.balance).map_err(CommandError::Usage)?;
    let clusters = args.workers.iter().map(|&n| args.cluster.speeds(n));
    let clusters = clusters.collect::<Result<Vec<_>, _>>().map_err(CommandError::Usage)?;
    let out = args.cluster.out.as_deref().map(Folder::check).transpose()?;
    let studio = Studio::open(&args.cluster, progress)?;
    let of_side = |&side: &u32| balances.iter().map(move |&balance| (balance, Some(side)));
    let ways: Vec<Way> = args.sides.iter().flat_map(of_side).collect();
    let mut rows = Vec::new();
    for speeds in &clusters {
        let _bar = progress.step(format!("{} workers on {}", speeds.len(), link.name));
        studio.measure_cluster(&link, speeds, &ways, None, progress, &mut rows)?;
    }
    if let Some(out) = &out {
        let mut table = Vec::new();
        write_csv(&mut table, Row::COLUMNS, rows.iter().map(Row::cells)).map_err(CommandError::failed)?;
        out.write("tiles.csv", &table)?;
    }
    if args.cluster.json { print_json(&rows) } else { print_text(&text(&rows)) }
}

/// Our times beside those of the paper's Table 8.
fn text(rows: &[Row]) -> String {
    let sides = distinct(rows.iter().map(|row| row.tile));
    let mut out = format!("{:>28}", "ms of a frame, tiles of");
    sides.iter().for_each(|side| out += &format!("{side:>10}"));
    out.push('\n');
    for workers in distinct(rows.iter().map(|row| row.workers)) {
        for balance in distinct(rows.iter().map(|row| row.balance.as_str())) {
            out += &format!("{:>28}", format!("{balance}, {workers} workers"));
            for &side in &sides {
                let is_it = |r: &&Row| r.tile == side && r.workers == workers && r.balance == balance;
                let times: Vec<_> = rows.iter().filter(is_it).map(|row| row.frame_ms).collect();
                out += &median(&times).map_or(format!("{:>10}", "-"), |ms| format!("{ms:>10.1}"));
            }
            out.push('\n');
        }
    }
    for (scene, one, sixteen) in &TABLE_8 {
        for (workers, times) in [(1, one), (16, sixteen)] {
            out += &format!("{:>28}", format!("paper, {scene}, {workers}"));
            for &side in &sides {
                let place = SIDES.iter().position(|other| *other == side);
                out += &place.map_or(format!("{:>10}", "-"), |place| format!("{:>10.1}", times[place]));
            }
            out.push('\n');
        }
    }
    out
}
