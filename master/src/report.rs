//! What is said about a render: one JSON object, or text for people.

use crate::compare::Comparison;
use crate::{
    ClassDifference, ClassPart, FrameJob, FrameResult, ImageHash, PixelFormat, Prepared, TileRecord,
};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Duration;
use tessera_geometry::CameraPose;
use tessera_scene::LeftOut;
use tessera_wire::Coding;

/// A render, as `--report` and `--json` write it. Times in milliseconds, lengths in bytes.
#[derive(Clone, Debug, Serialize)]
pub struct RenderReport {
    /// What was rendered: a file or a generator.
    pub scene: String,
    /// The file that was written.
    pub out: PathBuf,
    /// BLAKE3 of format name, width, height and rows in the frame's wire format, hexadecimal.
    pub image_hash: String,
    /// The frame's wire format.
    pub format: &'static str,
    /// BLAKE3 of the pack's content, hexadecimal.
    pub pack_id: String,
    /// Frames of one class are equal bit for bit. None for a picture of several: then there are `classes`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub numeric_class: Option<String>,
    /// The classes of a picture of several, those with most tiles first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub classes: Vec<ClassLine>,
    /// How far they differ, by pairs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub differences: Vec<DifferenceLine>,
    /// Whether classes might be mixed.
    pub mix: bool,
    /// Workers that hold the scene and had no part because they are of other classes.
    pub idle_workers: u32,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Side of a tile.
    pub tile: u32,
    /// How tiles got to workers.
    pub balance: &'static str,
    /// Why `auto` has balanced as it has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub balance_why: Option<String>,
    /// Samples a pixel; with adaptive sampling the most that one might get.
    pub spp: u32,
    /// Where they lie: `jittered` or `low-discrepancy`.
    pub sampler: &'static str,
    /// Weight in a pixel below which no ray was traced.
    pub cutoff: f32,
    /// The error at which a block of pixels got no more samples; null when all got `spp`.
    pub adaptive: Option<f32>,
    /// Samples a pixel that were taken, on the average.
    pub mean_samples: f64,
    /// Reflections and refractions a path may take.
    pub depth: u32,
    /// Why local workers render with what they do, where one choice was made for all; each worker has its own word too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend_note: Option<String>,
    /// How local workers trace rays on a CPU: `scalar`, or `8-wide` and the instructions.
    pub kernel: &'static str,
    /// What GPUs rendered with, where one had a part: the parts of the kernel that this scene needs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu_kernel: Option<String>,
    /// The view.
    pub camera: CameraReport,
    /// Every worker, in the order of joining.
    pub workers: Vec<WorkerLine>,
    /// Where the time went.
    pub ms: Milliseconds,
    /// UDP payload in both directions since the workers were started; for a render in this process the bytes of its messages.
    pub bytes_on_wire: u64,
    /// How pixels travelled; null for a frame of a master elsewhere.
    pub pixels: Option<PixelsReport>,
    /// Bytes of the pack.
    pub bytes_pack: u64,
    /// Rays of the image by kind.
    pub rays: Rays,
    /// Rendered tiles that came twice or too late, and were dropped: after a worker was lost,
    /// or was so late that another one was given its tile too.
    pub dropped_tiles: u64,
    /// How far the picture is from a truer one; null unless that was asked for.
    pub error: Option<ErrorReport>,
    /// What was left out, and why.
    pub left_out: Vec<LeftOutLine>,
    /// What was read but not understood, or mended.
    pub warnings: Vec<String>,
    /// Defaults in use, and where a generated scene comes from.
    pub notes: Vec<String>,
}

/// How the pixels of a frame travelled from workers.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PixelsReport {
    /// `raw`, `lossless`, or `rounded`: colours are then up to a code of 8 bits off, and the image hash is that of the rounded picture.
    pub coding: &'static str,
    /// Bytes of pixels, those of tiles that came twice too.
    pub bytes_raw: u64,
    /// What they took, with their headers.
    pub bytes_wire: u64,
    /// The second for each of the first.
    pub ratio: f64,
    /// Time that workers spent coding, all together.
    pub coding_ms: f64,
}

impl PixelsReport {
    /// Of a frame whose tiles are known.
    fn new<I>(result: &FrameResult<I>) -> Option<Self> {
        let sum = |of: fn(&TileRecord) -> u64| result.tiles.iter().map(of).sum::<u64>();
        let (bytes_raw, bytes_wire) = (sum(|tile| tile.pixel_bytes.into()), sum(|tile| tile.wire_bytes));
        (bytes_raw > 0).then(|| Self {
            coding: result.coding.name(),
            bytes_raw,
            bytes_wire,
            ratio: bytes_wire as f64 / bytes_raw as f64,
            coding_ms: ms(result.tiles.iter().map(|tile| tile.coding).sum()),
        })
    }
}

/// A view in world space.
#[derive(Clone, Debug, Serialize)]
pub struct CameraReport {
    /// The scene's name for it; none when it was given by hand.
    pub name: Option<String>,
    /// Eye position.
    pub eye: [f64; 3],
    /// A point on the axis.
    pub target: [f64; 3],
    /// What points up in the image.
    pub up: [f64; 3],
    /// Vertical, in degrees.
    pub fov_degrees: f64,
}

impl CameraReport {
    /// Of a pose.
    pub fn new(name: Option<String>, pose: &CameraPose) -> Self {
        let (eye, target, up) = (pose.eye.to_array(), pose.target.to_array(), pose.up.to_array());
        Self { name, eye, target, up, fov_degrees: pose.fov_degrees }
    }
}

/// A worker's part.
#[derive(Clone, Debug, Serialize)]
pub struct WorkerLine {
    /// Its name.
    pub name: String,
    /// What renders there: `cpu` or `gpu`.
    pub backend: String,
    /// Its arithmetic.
    pub numeric_class: String,
    /// Its own word on the device, and why it was chosen.
    pub backend_note: String,
    /// Tiles of the image that came from it.
    pub tiles: u32,
    /// Wall time that it spent rendering those tiles, by its own clock.
    pub render_ms: f64,
    /// Bytes that it returned: pixels and their headers.
    pub bytes_returned: u64,
    /// Why it was lost, if it was.
    pub lost: Option<String>,
    /// Why it does not hold the scene and had no part, if it has rejected it.
    pub rejected: Option<String>,
}

/// A numeric class's part in a picture of several.
#[derive(Clone, Debug, Serialize)]
pub struct ClassLine {
    /// Its name.
    pub class: String,
    /// Workers of it that took part.
    pub workers: u32,
    /// Tiles of the image that came from them.
    pub tiles: u32,
}

/// How far two classes differ: tiles of the image that came from one of them were rendered by the other too.
#[derive(Clone, Debug, Serialize)]
pub struct DifferenceLine {
    /// Their names.
    pub classes: [String; 2],
    /// Tiles that were compared.
    pub tiles: u32,
    /// Their pixels.
    pub pixels: u64,
    /// Pixels with another byte anywhere, in alpha and layers too.
    pub differing: u64,
    /// The same as a share, [0, 1].
    pub differing_share: f64,
    /// Largest difference of a red, green or blue value: in codes, for layers in linear light.
    pub max_abs: f64,
    /// Of red, green and blue, in dB; null when they are equal.
    pub psnr_db: Option<f64>,
}

/// Where the time went.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Milliseconds {
    /// Reading the scene's files.
    pub read: f64,
    /// Flattening, quantising, building the tree.
    pub pack: f64,
    /// Starting the workers.
    pub start: f64,
    /// From the pack's first offer until every worker held it, checked.
    pub send_scene: f64,
    /// From the frame's announcement until the last tile was rendered.
    pub render: f64,
    /// From then until the last byte of the image had come.
    #[serde(rename = "return")]
    pub return_: f64,
    /// `render` + `return`.
    pub frame: f64,
    /// Writing the image file, as far as rendering has not hidden it: PNG files are written while the frame is rendered.
    pub write: f64,
}

/// Rays by kind.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Rays {
    /// From the eye.
    pub primary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Off mirrors.
    pub reflection: u64,
    /// Through glass and partly covered surfaces.
    pub refraction: u64,
}

/// How far a picture is from a truer one.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorReport {
    /// What it was compared with.
    pub against: String,
    /// With ever more samples a pixel; the last is the picture.
    pub steps: Vec<ErrorStep>,
}

/// A picture of so many samples a pixel, and its error.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorStep {
    /// Samples a pixel.
    pub samples: u32,
    /// Time of its frame.
    pub frame_ms: f64,
    /// Time of its frame and all before it.
    pub total_ms: f64,
    /// From the truer picture.
    pub error: Comparison,
}

impl ErrorStep {
    /// Heads the columns of [`ErrorStep::text`].
    pub const HEAD: &str =
        "samples   frame ms   total ms       RMSE   PSNR dB      SSIM      FLIP  other triangle";

    /// What a frame took, and its error.
    pub fn new(samples: u32, frame: Duration, total: Duration, error: Comparison) -> Self {
        Self { samples, frame_ms: ms(frame), total_ms: ms(total), error }
    }

    /// A line of figures.
    pub fn text(&self) -> String {
        let Comparison { rmse, psnr_db, ssim, flip, wrong_id_share, .. } = self.error;
        let or = |value: Option<f64>, digits: usize, none: &str| {
            value.map_or_else(|| none.to_owned(), |value| format!("{value:.digits$}"))
        };
        format!(
            "{:>7} {:>10.1} {:>10.1} {rmse:>10.3e} {:>9} {:>9} {:>9} {:>15}",
            self.samples,
            self.frame_ms,
            self.total_ms,
            or(psnr_db, 2, "equal"),
            or(ssim, 5, "-"),
            format!("{flip:.5}"),
            or(wrong_id_share.map(|share| 100.0 * share), 4, "-") + " %"
        )
    }
}

/// Something that was left out.
#[derive(Clone, Debug, Serialize)]
pub struct LeftOutLine {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
    /// Bytes that it would have taken in the source's form; 0 when it takes none or nobody knows.
    pub bytes: u64,
}

impl From<&LeftOut> for LeftOutLine {
    fn from(left_out: &LeftOut) -> Self {
        Self { what: left_out.what.clone(), why: left_out.why.clone(), bytes: left_out.bytes }
    }
}

/// What only the caller of a render knows.
pub struct RenderFacts<'a> {
    /// The scene.
    pub prepared: &'a Prepared,
    /// What was asked for.
    pub job: &'a FrameJob,
    /// The view.
    pub camera: CameraReport,
    /// Why what renders was chosen for all local workers.
    pub backend_note: Option<String>,
    /// How local workers traced rays.
    pub kernel: &'static str,
    /// The kernel that GPUs rendered with, if any did.
    pub gpu_kernel: Option<String>,
    /// The file that was written.
    pub out: PathBuf,
    /// Of the image.
    pub hash: ImageHash,
    /// Time that starting the workers took.
    pub start: Duration,
    /// Time that writing the file took beyond the frame's own.
    pub write: Duration,
    /// How far the picture is from a truer one, if that was asked for.
    pub error: Option<ErrorReport>,
}

/// Samples a pixel that so many rays from the eye are. Layers of many samples have one ray more a pixel, through its centre.
fn mean_samples(job: &FrameJob, primary: u64) -> f64 {
    let pixels = u64::from(job.width) * u64::from(job.height);
    let centres = if job.format == PixelFormat::Layers && job.samples > 1 { pixels } else { 0 };
    primary.saturating_sub(centres) as f64 / pixels as f64
}

impl RenderReport {
    /// Puts together what the parts of a render know.
    pub fn new<I>(facts: RenderFacts<'_>, result: &FrameResult<I>) -> Self {
        let RenderFacts {
            prepared,
            job,
            camera,
            backend_note,
            kernel,
            gpu_kernel,
            out,
            hash,
            start,
            write,
            error,
        } = facts;
        let traffic = &result.traffic;
        let udp = traffic.udp_sent + traffic.udp_received;
        Self {
            scene: prepared.name.clone(),
            out,
            image_hash: hash.to_string(),
            format: job.format.name(),
            pack_id: result.pack.to_string(),
            numeric_class: result.numeric_class().map(String::from),
            classes: if result.classes.len() > 1 {
                result.classes.iter().map(class_line).collect()
            } else {
                Vec::new()
            },
            differences: result.differences.iter().map(difference_line).collect(),
            mix: job.mix,
            idle_workers: result.idle,
            size: [job.width, job.height],
            tile: if result.tile > 0 { result.tile } else { job.tile },
            balance: job.balance.name(),
            balance_why: result.why.clone(),
            spp: job.samples,
            sampler: job.sampling.sampler.name(),
            cutoff: job.sampling.cutoff,
            adaptive: job.sampling.adaptive.map(|adaptive| adaptive.error),
            mean_samples: mean_samples(job, result.rays.primary),
            depth: job.depth,
            backend_note,
            kernel,
            gpu_kernel,
            camera,
            workers: result
                .workers
                .iter()
                .map(|worker| WorkerLine {
                    name: worker.name.clone(),
                    backend: worker.backend.clone(),
                    numeric_class: worker.numeric_class.clone(),
                    backend_note: worker.note.clone(),
                    tiles: worker.tiles,
                    render_ms: ms(worker.render),
                    bytes_returned: worker.bytes_returned,
                    lost: worker.lost.clone(),
                    rejected: worker.rejected.clone(),
                })
                .collect(),
            ms: Milliseconds {
                read: ms(prepared.timings.read),
                pack: ms(prepared.timings.pack),
                start: ms(start),
                send_scene: ms(result.timings.send_scene),
                render: ms(result.timings.render),
                return_: ms(result.timings.return_),
                frame: ms(result.timings.frame),
                write: ms(write),
            },
            bytes_on_wire: if udp > 0 { udp } else { traffic.sent + traffic.received },
            pixels: PixelsReport::new(result),
            bytes_pack: prepared.pack.bytes().len() as u64,
            rays: Rays {
                primary: result.rays.primary,
                shadow: result.rays.shadow,
                reflection: result.rays.reflection,
                refraction: result.rays.refraction,
            },
            dropped_tiles: result.dropped_tiles,
            error,
            left_out: prepared.left_out.iter().map(LeftOutLine::from).collect(),
            warnings: prepared.warnings.clone(),
            notes: prepared.notes.clone(),
        }
    }

    /// The report for people.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, t: &mut String) -> std::fmt::Result {
        let Milliseconds { read, pack, start, send_scene, render, return_, frame, write } = self.ms;
        let [width, height] = self.size;
        writeln!(t, "scene      {}, pack of {}", self.scene, bytes(self.bytes_pack))?;
        let camera = self.camera.name.as_deref().unwrap_or("given by --eye, --target and --fov");
        writeln!(t, "camera     {camera}")?;
        writeln!(
            t,
            "image      {width} x {height} {}, {} a pixel, depth {}, tiles of {}, {} balancing",
            self.format,
            plural(self.spp.into(), "sample"),
            self.depth,
            self.tile,
            self.balance
        )?;
        write!(t, "sampling   {}, weights down to {}", self.sampler, self.cutoff)?;
        match self.adaptive {
            Some(error) => writeln!(t, ", adaptive to {error}: {:.2} samples a pixel", self.mean_samples)?,
            None => writeln!(t)?,
        }
        writeln!(
            t,
            "time       read {read:.0} ms, pack {pack:.0} ms, start workers {start:.0} ms, send scene {send_scene:.0} ms, \
             render {render:.0} ms, return {return_:.0} ms, write {write:.0} ms"
        )?;
        let rays = self.rays;
        let all = rays.primary + rays.shadow + rays.reflection + rays.refraction;
        writeln!(
            t,
            "rays       {all} ({} primary, {} shadow, {} reflection, {} refraction), {:.2} million a second",
            rays.primary,
            rays.shadow,
            rays.reflection,
            rays.refraction,
            all as f64 / (frame.max(1e-3) * 1e3)
        )?;
        for worker in &self.workers {
            write!(
                t,
                "worker     {}: {}, rendering {:.0} ms, returned {}",
                worker.name,
                plural(worker.tiles.into(), "tile"),
                worker.render_ms,
                bytes(worker.bytes_returned)
            )?;
            match (&worker.lost, &worker.rejected) {
                (Some(why), _) => writeln!(t, ", lost: {why}")?,
                (None, Some(why)) => writeln!(t, ", cannot hold the scene: {why}")?,
                (None, None) => writeln!(t)?,
            }
        }
        self.write_classes(t)?;
        writeln!(t, "wire       {}", bytes(self.bytes_on_wire))?;
        if let Some(PixelsReport { coding, bytes_raw, bytes_wire, ratio, coding_ms }) = self.pixels {
            let (from, to) = (bytes(bytes_raw), bytes(bytes_wire));
            writeln!(t, "pixels     {coding}: {from} as {to} ({ratio:.3}), {coding_ms:.0} ms of coding")?;
            if coding == Coding::Rounded.name() {
                writeln!(
                    t,
                    "           colours are rounded, by at most a code of 8 bits: PSNR 48 dB or more"
                )?;
            }
        }
        if let Some(error) = &self.error {
            writeln!(t, "error      against {}", error.against)?;
            writeln!(t, "           {}", ErrorStep::HEAD)?;
            for step in &error.steps {
                writeln!(t, "           {}", step.text())?;
            }
        }
        write_lists(t, &self.left_out, &self.warnings, &self.notes)?;
        let mixed =
            if self.classes.is_empty() { "" } else { " (of mixed classes: comparable with no other)" };
        writeln!(t, "image hash {}{mixed}", self.image_hash)?;
        writeln!(t, "wrote      {}", self.out.display())
    }

    /// What rendered, in which classes, and how far they differ.
    fn write_classes(&self, t: &mut String) -> std::fmt::Result {
        let with_part = self.workers.iter().filter(|worker| worker.rejected.is_none());
        let notes: BTreeSet<_> = with_part.map(|w| (&w.numeric_class, &w.backend_note)).collect();
        for (class, note) in notes {
            writeln!(t, "backend    {class}: {note}")?;
        }
        if let Some(kernel) = &self.gpu_kernel {
            writeln!(t, "kernel     {kernel}")?;
        }
        for part in &self.classes {
            let (workers, tiles) = (plural(part.workers.into(), "worker"), plural(part.tiles.into(), "tile"));
            writeln!(t, "class      {}: {workers}, {tiles}", part.class)?;
        }
        if let (true, Some(class)) = (self.mix, &self.numeric_class) {
            writeln!(t, "class      {class} alone took part, there is nothing to compare")?;
        }
        for found in &self.differences {
            let [a, b] = &found.classes;
            let tiles = plural(found.tiles.into(), "tile");
            write!(t, "difference {a} and {b}: {} of {} pixels", found.differing, found.pixels)?;
            write!(t, " ({:.3} %) of {tiles}", 100.0 * found.differing_share)?;
            match found.psnr_db {
                Some(psnr) => writeln!(t, ", at most {} a channel, PSNR {psnr:.2} dB", found.max_abs)?,
                None => writeln!(t, ", no colour among them")?,
            }
        }
        if self.idle_workers > 0 {
            let idle = plural(self.idle_workers.into(), "worker");
            writeln!(t, "idle       {idle} of other classes; --mix lets them take part")?;
        }
        Ok(())
    }
}

fn class_line(part: &ClassPart) -> ClassLine {
    ClassLine { class: part.class.clone(), workers: part.workers, tiles: part.tiles }
}

fn difference_line(found: &ClassDifference) -> DifferenceLine {
    DifferenceLine {
        classes: found.classes.clone(),
        tiles: found.tiles,
        pixels: found.pixels,
        differing: found.differing,
        differing_share: found.differing as f64 / found.pixels.max(1) as f64,
        max_abs: found.max_abs,
        psnr_db: found.psnr_db,
    }
}

/// Lines for what was left out, for warnings and for notes.
pub fn write_lists(
    t: &mut String,
    left_out: &[LeftOutLine],
    warnings: &[String],
    notes: &[String],
) -> std::fmt::Result {
    for line in left_out {
        match line.bytes {
            0 => writeln!(t, "left out   {}: {}", line.what, line.why)?,
            n => writeln!(t, "left out   {} ({}): {}", line.what, bytes(n), line.why)?,
        }
    }
    for line in warnings {
        writeln!(t, "warning    {line}")?;
    }
    for line in notes {
        writeln!(t, "note       {line}")?;
    }
    Ok(())
}

/// A length for people: bytes, KiB, MiB or GiB.
pub fn bytes(n: u64) -> String {
    match n {
        0..1024 => format!("{n} B"),
        1024..1_048_576 => format!("{:.1} KiB", n as f64 / 1024.0),
        1_048_576..1_073_741_824 => format!("{:.2} MiB", n as f64 / 1_048_576.0),
        _ => format!("{:.2} GiB", n as f64 / 1_073_741_824.0),
    }
}

fn plural(n: u64, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_for_people() {
        let cases =
            [(0, "0 B"), (1023, "1023 B"), (1024, "1.0 KiB"), (1 << 20, "1.00 MiB"), (3 << 29, "1.50 GiB")];
        for (n, text) in cases {
            assert_eq!(bytes(n), text);
        }
    }

    #[test]
    fn lists_give_each_thing_a_line() {
        let left_out = [
            LeftOutLine { what: "normals".into(), why: "flat".into(), bytes: 2048 },
            LeftOutLine { what: "shadows".into(), why: "asked".into(), bytes: 0 },
        ];
        let mut text = String::new();
        write_lists(&mut text, &left_out, &["odd".into()], &["default".into()]).unwrap();
        assert_eq!(
            text,
            "left out   normals (2.0 KiB): flat\nleft out   shadows: asked\nwarning    odd\nnote       default\n"
        );
    }
}
