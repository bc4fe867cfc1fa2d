//! `tessera bench rays`.

use super::measure::{Answers, Measured, measure, median};
use super::mesh::{Mesh, MeshSource};
use super::obvhs::Obvhs;
use super::peer::{Kernel, Ours, Peer};
use super::ray_set::{RayKind, TILE, View, Views, ray_sets};
use crate::commands::progress::Progress;
use crate::commands::{CommandError, print_text};
use clap::Args;
use serde::Serialize;
use std::fmt::Write;

/// What to trace, and who.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure rays per CPU second, beside obvhs in the same run\n\n\
        Packs the positions and triangles of a mesh, and has our kernels and obvhs' compressed wide BVH trace the same rays in the same \
        order: primary rays, shadow rays to a point light, and diffuse rays in random directions. A pass to warm up, then the peers \
        alternate inside each repetition; what counts is the median of the CPU seconds of the tracing threads. Turning world rays into a \
        peer's own and its hits back is in its time. obvhs traces the exact mesh, and makes the rays that start on it; `differs` counts \
        rays that hit or miss otherwise, or whose distance is off by more than 0.1 %.\n\n\
        Ratios between peers of one run can be compared between machines and runs; rays per second cannot.",
    after_help = "Examples:\n  tessera bench rays bunny.ply\n  tessera bench rays gen:pipes:1000000 --views inside --json\n  \
        tessera bench rays sponza.gltf --views inside --refs 0,1,2 --plain=too"
)]
pub struct RaysArgs {
    /// A file that `tessera render` takes, gen:sphere:N or gen:pipes:N with about N triangles
    #[arg(value_name = "MESH")]
    mesh: MeshSource,
    /// orbit, inside, or one camera: ex,ey,ez,tx,ty,tz,fov
    #[arg(long, default_value = "orbit", value_name = "VIEWS", allow_hyphen_values = true)]
    views: Views,
    /// Hold positions as f32 instead of quantised; `too`: measure both
    #[arg(long, value_name = "WHICH", value_enum, num_args = 0..=1, require_equals = true, default_missing_value = "only")]
    plain: Option<PlainMesh>,
    /// Triangle references on an inner node of the kd-tree: 0, 1, 2 or several of them
    #[arg(long, value_name = "K", value_delimiter = ',', default_value = "2", value_parser = clap::value_parser!(u32).range(0..=2))]
    refs: Vec<u32>,
    /// How our tree is traced [default: all]
    #[arg(long, value_name = "KERNELS", value_enum, value_delimiter = ',')]
    kernels: Vec<Kernel>,
    /// Which rays [default: all]
    #[arg(long, value_name = "KINDS", value_enum, value_delimiter = ',')]
    kinds: Vec<RayKind>,
    /// Threads that trace, several numbers for several measurements
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "1", value_parser = clap::value_parser!(u32).range(1..=256))]
    threads: Vec<u32>,
    /// Pixels along a side of the image, a multiple of 16
    #[arg(long, value_name = "PIXELS", default_value = "1024", value_parser = side)]
    size: u32,
    /// Measured passes
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: u32,
    /// Print one JSON object a line: for each peer, view, kind of rays and number of threads
    #[arg(long)]
    pub(super) json: bool,
}

/// What `--plain` asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PlainMesh {
    /// Plain positions.
    Only,
    /// Quantised and plain positions.
    Too,
}

fn side(text: &str) -> Result<u32, String> {
    const SIDE_MAX: u32 = 4096;
    let side = text.parse().ok().filter(|s: &u32| (1..=SIDE_MAX).contains(s) && s.is_multiple_of(TILE));
    side.ok_or_else(|| format!("write a multiple of {TILE} up to {SIDE_MAX}"))
}

pub fn run(args: RaysArgs, progress: &Progress) -> Result<(), CommandError> {
    let mesh = super::load(&args.mesh, progress)?;
    let peers = build_peers(&args, &mesh, progress)?;
    let views = args.views.of(&mesh.bounds());
    let kinds = if args.kinds.is_empty() { RayKind::ALL.to_vec() } else { args.kinds.clone() };
    let mut lines = Vec::new();
    for view in &views {
        let sets = ray_sets(view, &mesh, &*peers[0], args.size);
        for (kind, rays) in sets.iter().filter(|(kind, rays)| kinds.contains(kind) && !rays.is_empty()) {
            let reference = Answers::of(&*peers[0], *kind, rays, 1);
            for &threads in &args.threads {
                let _bar = progress.step(format!("{}, {} rays, {threads} threads", view.name, kind.name()));
                let measured = measure(&peers, *kind, rays, &reference, threads as usize, args.reps as usize)
                    .map_err(|what| CommandError::Failed(format!("{}, {}: {what}", mesh.name, view.name)))?;
                let place = Place { mesh: &mesh, view, kind: *kind, threads, rays: rays.len() };
                lines.extend(peers.iter().zip(measured).map(|(peer, m)| Line::new(&place, &**peer, m)));
            }
        }
    }
    if args.json {
        return super::print_lines(&lines);
    }
    print_text(&text(&mesh, &peers, &views, &lines))
}

/// obvhs first: it is the reference.
fn build_peers(
    args: &RaysArgs,
    mesh: &Mesh,
    progress: &Progress,
) -> Result<Vec<Box<dyn Peer>>, CommandError> {
    let mut peers: Vec<Box<dyn Peer>> = Vec::new();
    {
        let _bar = progress.step("building obvhs' tree");
        peers.push(Box::new(Obvhs::build(mesh)?));
    }
    let forms: &[bool] = match args.plain {
        None => &[false],
        Some(PlainMesh::Only) => &[true],
        Some(PlainMesh::Too) => &[false, true],
    };
    let kernels = if args.kernels.is_empty() { Kernel::ALL.to_vec() } else { args.kernels.clone() };
    for &is_plain in forms {
        for &max_refs in &args.refs {
            let _bar =
                progress.step(format!("building the kd-tree with {max_refs} references on an inner node"));
            for peer in Ours::build(mesh, max_refs, is_plain, &kernels)? {
                peers.push(Box::new(peer));
            }
        }
    }
    Ok(peers)
}

/// What was measured where.
struct Place<'a> {
    mesh: &'a Mesh,
    view: &'a View,
    kind: RayKind,
    threads: u32,
    rays: usize,
}

/// One peer's line of `--json`. Million rays are counted by the second; bytes by triangle of the mesh.
#[derive(Debug, Serialize)]
struct Line {
    peer: String,
    mesh: String,
    tris: usize,
    view: String,
    ray_kind: &'static str,
    threads: u32,
    rays: usize,
    mrays_s: f64,
    mrays_per_cpu_s: f64,
    mrays_s_min: f64,
    mrays_s_max: f64,
    build_s_1: f64,
    build_cpu_s_1: f64,
    accel_bytes_per_triangle: f64,
    bytes_per_triangle: f64,
    hits: usize,
    differs: usize,
    hash: String,
}

impl Line {
    fn new(place: &Place<'_>, peer: &dyn Peer, measured: Measured) -> Self {
        let triangles = place.mesh.triangles.len();
        let rate = |seconds: f64| place.rays as f64 / 1e6 / seconds;
        let by_triangle = |bytes: u64| bytes as f64 / triangles as f64;
        let Measured { hits, differs, hash, wall_s, cpu_s } = measured;
        Self {
            peer: peer.name(),
            mesh: place.mesh.name.clone(),
            tris: triangles,
            view: place.view.name.clone(),
            ray_kind: place.kind.name(),
            threads: place.threads,
            rays: place.rays,
            mrays_s: rate(median(&wall_s)),
            mrays_per_cpu_s: rate(median(&cpu_s)),
            mrays_s_min: rate(wall_s[wall_s.len() - 1]),
            mrays_s_max: rate(wall_s[0]),
            build_s_1: peer.build_cost().wall_s,
            build_cpu_s_1: peer.build_cost().cpu_s,
            accel_bytes_per_triangle: by_triangle(peer.accel_bytes()),
            bytes_per_triangle: by_triangle(peer.total_bytes()),
            hits,
            differs,
            hash,
        }
    }
}

/// The table for people: views of a set are added up.
fn text(mesh: &Mesh, peers: &[Box<dyn Peer>], views: &[View], lines: &[Line]) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, mesh, peers, views, lines);
    out
}

fn write_text(
    out: &mut String,
    mesh: &Mesh,
    peers: &[Box<dyn Peer>],
    views: &[View],
    lines: &[Line],
) -> std::fmt::Result {
    let triangles = mesh.triangles.len();
    writeln!(out, "mesh       {}, {triangles} triangles, {} vertices", mesh.name, mesh.positions.len())?;
    let names: Vec<_> = views.iter().map(|v| v.name.as_str()).collect();
    writeln!(out, "views      {}, added up", names.join(", "))?;
    let width = peers.iter().map(|p| p.name().len()).max().unwrap_or(0);
    writeln!(out, "\n{:width$}  tree B/triangle  with triangles  build CPU s", "peer")?;
    for peer in peers {
        let by_triangle = |bytes: u64| bytes as f64 / triangles as f64;
        writeln!(
            out,
            "{:width$} {:16.2} {:15.2} {:12.3}",
            peer.name(),
            by_triangle(peer.accel_bytes()),
            by_triangle(peer.total_bytes()),
            peer.build_cost().cpu_s,
        )?;
    }
    writeln!(
        out,
        "\nrays     threads  {:width$}  Mrays/CPU s   ratio  Mrays/s      hits   differs  hashes",
        "peer"
    )?;
    let mut seen: Vec<(&str, u32)> = Vec::new();
    for place in lines.iter().map(|line| (line.ray_kind, line.threads)) {
        if seen.contains(&place) {
            continue;
        }
        seen.push(place);
        let of = |peer: &str| Total::of(lines, place, peer);
        let reference = of(&peers[0].name());
        for peer in peers {
            let name = peer.name();
            let total = of(&name);
            writeln!(
                out,
                "{:8} {:7}  {name:width$} {:12.3} {:7.2} {:8.3} {:9} {:9}  {}",
                place.0,
                place.1,
                total.rays / total.cpu_s,
                (total.rays / total.cpu_s) / (reference.rays / reference.cpu_s),
                total.rays / total.wall_s,
                total.hits,
                total.differs,
                total.hashes.join(" "),
            )?;
        }
    }
    Ok(())
}

/// The lines of one peer, added up over the views; rays in millions.
#[derive(Default)]
struct Total<'a> {
    rays: f64,
    cpu_s: f64,
    wall_s: f64,
    hits: usize,
    differs: usize,
    hashes: Vec<&'a str>,
}

impl<'a> Total<'a> {
    fn of(lines: &'a [Line], (kind, threads): (&str, u32), peer: &str) -> Self {
        let mut total = Self::default();
        for line in lines.iter().filter(|l| l.ray_kind == kind && l.threads == threads && l.peer == peer) {
            let rays = line.rays as f64 / 1e6;
            total.rays += rays;
            total.cpu_s += rays / line.mrays_per_cpu_s;
            total.wall_s += rays / line.mrays_s;
            total.hits += line.hits;
            total.differs += line.differs;
            total.hashes.push(&line.hash);
        }
        total
    }
}
