//! What `tessera bench gpu` prints.

use super::gpu::{Packing, Peer, Task};
use super::measure::median;
use crate::commands::CommandError;
use serde::Serialize;
use std::fmt::Write;
use tessera_master::Difference;
use tessera_wire::Frame;
use tessera_worker::Adapter;

/// A line of `--json`. What only a GPU has is null for the CPU.
#[derive(Debug, Serialize)]
pub(super) struct Line {
    scene: String,
    /// `cpu` or `gpu`.
    backend: &'static str,
    adapter: Option<String>,
    adapter_kind: Option<&'static str>,
    driver: Option<String>,
    /// `frame`, or `primary`: nothing beyond the eye's rays.
    what: &'static str,
    /// The kernel's parts.
    variant: Option<String>,
    form: Option<&'static str>,
    f64: Option<bool>,
    lean: Option<bool>,
    plain: bool,
    refs: u32,
    size: [u32; 2],
    depth: u32,
    reps: u32,
    seconds_median: f64,
    seconds_min: f64,
    seconds_max: f64,
    /// Of all threads of this process: what a software driver computes with is in it. The median.
    cpu_seconds: f64,
    rays: u64,
    mrays_s: f64,
    /// Rays a second to those of the CPU on the same frame: more than 1 is faster.
    ratio_to_cpu: f64,
    /// CPU seconds to those of the CPU on the same frame.
    cpu_seconds_ratio: f64,
    kernel_bytes: Option<usize>,
    compile_s: Option<f64>,
    upload_s: Option<f64>,
    /// From the CPU's frame.
    differing_pixels: u64,
    /// Null when equal.
    psnr_db: Option<f64>,
    hash: String,
}

impl Line {
    /// Of `peer`, which `all` holds with those that it is compared with.
    pub(super) fn new(
        scene: &str,
        adapter: &Adapter,
        reps: u32,
        frame: &Frame,
        peer: &Peer<'_>,
        all: &[Peer<'_>],
    ) -> Result<Self, CommandError> {
        let Task { what, packing: Packing { plain, refs }, gpu } = peer.task;
        // (`tasks` has one for each; it is its own otherwise.)
        let cpu = all.iter().find(|other| other.task == Task { gpu: None, ..peer.task }).unwrap_or(peer);
        let seconds = median(&peer.wall_s);
        let mut difference = Difference::default();
        difference.add(frame.format, &cpu.pixels, &peer.pixels);
        let loaded = peer.loaded.as_deref();
        let rate = |peer: &Peer<'_>| peer.rays as f64 / 1e6 / median(&peer.wall_s);
        Ok(Self {
            scene: scene.into(),
            backend: if gpu.is_some() { "gpu" } else { "cpu" },
            adapter: gpu.map(|_| adapter.name.clone()),
            adapter_kind: gpu.map(|_| adapter.kind),
            driver: gpu.map(|_| adapter.driver.clone()),
            what: what.name(),
            variant: loaded.map(|loaded| loaded.variant.name()),
            form: gpu.map(|gpu| gpu.form.name()),
            f64: gpu.map(|gpu| gpu.f64),
            lean: gpu.map(|gpu| gpu.lean),
            plain,
            refs,
            size: [frame.width, frame.height],
            depth: frame.depth,
            reps,
            seconds_median: seconds,
            seconds_min: peer.wall_s[0],
            seconds_max: peer.wall_s[peer.wall_s.len() - 1],
            cpu_seconds: median(&peer.cpu_s),
            rays: peer.rays,
            mrays_s: rate(peer),
            ratio_to_cpu: rate(peer) / rate(cpu),
            cpu_seconds_ratio: median(&peer.cpu_s) / median(&cpu.cpu_s),
            kernel_bytes: loaded.map(|loaded| loaded.kernel_bytes),
            compile_s: loaded.map(|loaded| loaded.compile_s),
            upload_s: loaded.map(|loaded| loaded.upload_s),
            differing_pixels: difference.differing,
            psnr_db: difference.psnr_db(frame.format),
            hash: peer.hash()?,
        })
    }
}

/// The table for people.
pub(super) fn text(
    adapter: &Adapter,
    triangles: u32,
    kernel: &str,
    are_equal: bool,
    lines: &[Line],
) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, adapter, triangles, kernel, are_equal, lines);
    out
}

fn write_text(
    t: &mut String,
    adapter: &Adapter,
    triangles: u32,
    kernel: &str,
    are_equal: bool,
    lines: &[Line],
) -> std::fmt::Result {
    let Some(first) = lines.first() else { return Ok(()) };
    let Adapter { name, driver, api, kind, .. } = adapter;
    let [width, height] = first.size;
    writeln!(t, "scene      {}, {triangles} triangles", first.scene)?;
    writeln!(t, "GPU        {name}: {kind}, {api}, driver {driver}")?;
    if *kind == "software" {
        writeln!(t, "           it plays a GPU on the CPU, and says nothing about a real one")?;
    }
    writeln!(t, "kernel     {kernel}")?;
    writeln!(
        t,
        "image      {width} x {height}, 1 sample a pixel, depth {}; medians of {} frames, seconds from min to max",
        first.depth, first.reps
    )?;
    writeln!(
        t,
        "\nwhat     backend  form           precision  kernel  vertices   refs  seconds  {:>17}  CPU s  Mrays/s  \
         to CPU  CPU s to CPU  differ    PSNR  hash",
        "min..max"
    )?;
    for line in lines {
        let range = format!("{:.3}..{:.3}", line.seconds_min, line.seconds_max);
        let psnr = line.psnr_db.map_or("equal".into(), |psnr| format!("{psnr:.1}"));
        let precision = line.f64.map_or("", |f64| if f64 { "f64" } else { "f32" });
        writeln!(
            t,
            "{:8} {:8} {:14} {precision:10} {:7} {:10} {:4} {:8.3}  {range:>17} {:6.3} {:8.3} {:7.2} {:13.2} {:7} \
             {psnr:>7}  {}",
            line.what,
            line.backend,
            line.form.unwrap_or(""),
            line.lean.map_or("", |lean| if lean { "lean" } else { "full" }),
            if line.plain { "plain" } else { "quantised" },
            line.refs,
            line.seconds_median,
            line.cpu_seconds,
            line.mrays_s,
            line.ratio_to_cpu,
            line.cpu_seconds_ratio,
            line.differing_pixels,
            &line.hash[..16.min(line.hash.len())],
        )?;
    }

    writeln!(t, "\nkernel                          vertices   refs    bytes  compile s  upload s")?;
    for line in lines.iter().filter(|line| line.what == "frame") {
        let (Some(form), Some(bytes), Some(compile), Some(upload)) =
            (line.form, line.kernel_bytes, line.compile_s, line.upload_s)
        else {
            continue;
        };
        let precision = if line.f64 == Some(true) { "f64" } else { "f32" };
        let kernel = if line.lean == Some(true) { "lean" } else { "full" };
        let vertices = if line.plain { "plain" } else { "quantised" };
        let name = format!("{form} {precision} {kernel}");
        writeln!(t, "{name:31} {vertices:10} {:4} {bytes:8} {compile:10.3} {upload:9.3}", line.refs)?;
    }
    let equal = if are_equal { "equal" } else { "NOT equal" };
    writeln!(t, "\nhashes     {equal} within one precision, across forms of traversal, lean and full")
}
