//! `tessera bench build`.

use super::clock::Cost;
use super::hash::Hash;
use super::memory::PeakMeter;
use super::mesh::MeshSource;
use super::obvhs;
use crate::commands::info::Nodes;
use crate::commands::progress::Progress;
use crate::commands::{CommandError, cores, print_text};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::process::{Command, Stdio};
use tessera_kdtree::{BuildOptions, Triangles};
use tessera_master::output::one_line;
use tessera_pack::{Pack, PackOptions, Plain, build_pack};

/// What to build.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure the building of trees, beside obvhs in the same run\n\n\
        Packs the positions and triangles of a mesh; then builds our kd-tree over the packed triangles without, with one and with two \
        references on an inner node, and obvhs' compressed wide BVH over the same triangles. Each tree is built in a process of its own: \
        its memory is the most that the process held at once beyond the triangles themselves, the finished tree included (Linux only).",
    after_help = "Examples:\n  tessera bench build bunny.ply\n  tessera bench build gen:pipes:1000000 --threads 1 --json"
)]
pub struct BuildArgs {
    /// A file that `tessera render` takes, gen:sphere:N or gen:pipes:N with about N triangles
    #[arg(value_name = "MESH")]
    mesh: MeshSource,
    /// Hold positions as f32 instead of quantised
    #[arg(long)]
    plain: bool,
    /// Which trees [default: all]
    #[arg(long, value_name = "TREES", value_enum, value_delimiter = ',')]
    trees: Vec<TreeKind>,
    /// Threads that build, several numbers for several measurements [default: 1 and all cores]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=256))]
    threads: Vec<u32>,
    /// Print one JSON object a line: for each tree and number of threads
    #[arg(long)]
    pub(super) json: bool,
}

/// One tree of a pack that comes in on standard input; started by `bench build` itself.
#[derive(Debug, Args)]
pub struct BuildOneArgs {
    #[arg(value_enum)]
    tree: TreeKind,
    threads: u32,
}

/// What can be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TreeKind {
    /// Our kd-tree without references on inner nodes.
    Kd0,
    /// Our kd-tree with up to one.
    Kd1,
    /// Our kd-tree with up to two.
    Kd2,
    /// obvhs' compressed wide BVH.
    Obvhs,
}

impl TreeKind {
    fn name(self) -> &'static str {
        match self {
            Self::Kd0 => "kd0",
            Self::Kd1 => "kd1",
            Self::Kd2 => "kd2",
            Self::Obvhs => "obvhs",
        }
    }
}

/// What the process of one tree found.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Built {
    #[serde(flatten)]
    cost: Cost,
    /// None where the system does not tell.
    peak_bytes: Option<u64>,
    tree_bytes: u64,
    /// Of our trees.
    nodes: Option<Nodes>,
    hash: String,
}

/// A line of `--json`.
#[derive(Debug, Serialize)]
struct Line {
    tree: TreeKind,
    mesh: String,
    /// Of the pack: those that collapse when quantised are in no tree.
    tris: u32,
    plain: bool,
    threads: u32,
    cpu_s_per_million: f64,
    peak_bytes_per_triangle: Option<f64>,
    tree_bytes_per_triangle: f64,
    #[serde(flatten)]
    built: Built,
}

pub fn run(args: BuildArgs, progress: &Progress) -> Result<(), CommandError> {
    let mesh = super::load(&args.mesh, progress)?;
    let pack = {
        let _bar = progress.step("packing the mesh");
        let options = PackOptions {
            plain: Plain { positions: args.plain, ..Plain::default() },
            tree: BuildOptions { max_refs: 0, ..BuildOptions::default() },
            ..PackOptions::default()
        };
        let failed = |e| CommandError::Failed(format!("{}: {e}", mesh.name));
        build_pack(mesh.pack_input(), &options).map_err(failed)?.0
    };
    let trees = if args.trees.is_empty() { TreeKind::value_variants().to_vec() } else { args.trees };
    let mut threads = args.threads;
    if threads.is_empty() {
        threads = vec![1, cores()];
        threads.dedup();
    }
    let mut lines = Vec::new();
    for &tree in &trees {
        for &threads in &threads {
            let _bar = progress.step(format!("building {} with {threads} threads", tree.name()));
            let built = build_in_a_process(&pack, tree, threads)?;
            let by_triangle = |bytes: u64| bytes as f64 / f64::from(pack.triangle_count());
            lines.push(Line {
                tree,
                mesh: mesh.name.clone(),
                tris: pack.triangle_count(),
                plain: args.plain,
                threads,
                cpu_s_per_million: built.cost.cpu_s * 1e6 / f64::from(pack.triangle_count()),
                peak_bytes_per_triangle: built.peak_bytes.map(by_triangle),
                tree_bytes_per_triangle: by_triangle(built.tree_bytes),
                built,
            });
        }
    }
    if args.json {
        return super::print_lines(&lines);
    }
    print_text(&text(&lines))
}

/// Hands the pack to a new process of this program and waits for what it found.
fn build_in_a_process(pack: &Pack, tree: TreeKind, threads: u32) -> Result<Built, CommandError> {
    let failed = |what: String| CommandError::Failed(format!("building {}: {what}", tree.name()));
    let program = std::env::current_exe().map_err(|e| failed(format!("cannot find this program: {e}")))?;
    let mut child = Command::new(program)
        .args(["bench", "build-one", tree.name(), &threads.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| failed(format!("cannot start a process: {e}")))?;
    // It reads everything before it writes anything. When it has ended early, its own words say why.
    let sent = child.stdin.take().map(|mut pipe| pipe.write_all(pack.bytes()));
    let output = child.wait_with_output().map_err(|e| failed(e.to_string()))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.trim().trim_start_matches("tessera: error: ");
        return Err(failed(if said.is_empty() { output.status.to_string() } else { one_line(said) }));
    }
    if let Some(Err(e)) = sent {
        return Err(failed(format!("cannot send the triangles: {e}")));
    }
    serde_json::from_slice(&output.stdout).map_err(|e| failed(format!("cannot read what it found: {e}")))
}

/// Reads a pack from standard input and builds one tree over its triangles.
pub fn run_one(args: &BuildOneArgs) -> Result<(), CommandError> {
    let mut bytes = Vec::new();
    std::io::stdin().lock().read_to_end(&mut bytes).map_err(CommandError::failed)?;
    let pack = Pack::from_bytes(&bytes).map_err(CommandError::failed)?;
    drop(bytes);
    let (count, mesh) = (pack.triangle_count(), pack.mesh());
    let built = match args.tree {
        TreeKind::Kd0 | TreeKind::Kd1 | TreeKind::Kd2 => {
            let options = BuildOptions { max_refs: args.tree as u32, ..BuildOptions::default() };
            let meter = PeakMeter::start();
            let (tree, cost) = Cost::of(args.threads as usize, || {
                tessera_kdtree::build(count, |id| mesh.vertices(id), &options)
            })?;
            let peak_bytes = meter.and_then(|m| m.peak());
            let tree = tree.map_err(CommandError::failed)?;
            let stats = tree.stats();
            let mut hash = Hash::default();
            tree.slots.as_flattened().iter().chain(&tree.list).for_each(|&word| hash.add(word));
            let (nodes, hash) = (Some(Nodes::from(stats)), hash.finish());
            Built { cost, peak_bytes, tree_bytes: stats.bytes, nodes, hash }
        }
        TreeKind::Obvhs => {
            let triangles = obvhs::triangles(count, |id| mesh.vertices(id));
            let meter = PeakMeter::start();
            let (bvh, cost) = Cost::of(args.threads as usize, || obvhs::build_cwbvh(&triangles))?;
            let peak_bytes = meter.and_then(|m| m.peak());
            let mut hash = Hash::default();
            bytemuck::cast_slice(&bvh.nodes).iter().chain(&bvh.primitive_indices).for_each(|&w| hash.add(w));
            let tree_bytes = obvhs::tree_bytes(&bvh);
            Built { cost, peak_bytes, tree_bytes, nodes: None, hash: hash.finish() }
        }
    };
    print_text(&serde_json::to_string(&built).map_err(CommandError::failed)?)
}

fn text(lines: &[Line]) -> String {
    let mut out = String::new();
    if let Some(first) = lines.first() {
        let form = if first.plain { "plain" } else { "quantised" };
        out += &format!("mesh       {}, {} triangles, {form}\n\n", first.mesh, first.tris);
    }
    out += "tree   threads  CPU s  CPU s/Mtri  wall s  peak B/tri  tree B/tri    inner0   inner1   inner2    leaves     empty  \
            leaf refs  depth  hash\n";
    for line in lines {
        let Line { tree, threads, built, .. } = line;
        let peak = line.peak_bytes_per_triangle.map_or_else(|| "?".to_owned(), |peak| format!("{peak:.1}"));
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "{:6} {threads:7} {:6.2} {:11.3} {:7.2} {peak:>11} {:11.2}",
            tree.name(),
            built.cost.cpu_s,
            line.cpu_s_per_million,
            built.cost.wall_s,
            line.tree_bytes_per_triangle,
        );
        let _ = match &built.nodes {
            Some(n) => write!(
                out,
                " {:9} {:8} {:8} {:9} {:9} {:10} {:6}",
                n.inner0, n.inner1, n.inner2, n.leaves, n.empty_leaves, n.leaf_refs, n.depth
            ),
            None => write!(out, "{:66}", ""),
        };
        let _ = writeln!(out, "  {}", built.hash);
    }
    out
}
