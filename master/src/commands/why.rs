//! `tessera scene info --why`: what leaving out saves, measured part by part against a twin that has the part.

use super::args::Size;
use super::backend::BackendArgs;
use super::bench::clock::Watch;
use super::bench::gpu::whole_frame;
use super::bench::measure::median;
use super::page::BUGS_FOR_TESTS;
use super::progress::Progress;
use super::{CommandError, SceneArgs, bench, run};
use clap::Args;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;
use tessera_geometry::mutation;
use tessera_master::prepare::{PrepareOptions, Prepared, prepare_scene};
use tessera_master::report::bytes;
use tessera_master::{FrameBuffer, PixelFormat};
use tessera_pack::device::DeviceWords;
use tessera_pack::format::Section;
use tessera_pack::{Forced, Pack};
use tessera_scene::{Camera, Scene, Without};
use tessera_whitted::Needs;
use tessera_whitted::variant::{Part, Variant};
use tessera_wire::{Features, Frame};
use tessera_worker::Kernel;
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::{GpuProbe, ProbedScene, cpu_frame_with};

/// Whether to measure what leaving out saves, and how.
#[derive(Clone, Debug, Args)]
pub struct WhyArgs {
    /// Measure what leaving out saves, for every part that the scene does not need
    #[arg(long)]
    pub why: bool,
    /// With --why: size of the frame in pixels [default: 256x256]
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "why")]
    size: Option<Size>,
    /// With --why: pairs of measured frames, without and with the part [default: 9]
    #[arg(long, value_name = "N", requires = "why", value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: Option<u32>,
    #[command(flatten)]
    backend: BackendArgs,
}

impl WhyArgs {
    /// Checks what can be checked before any work.
    pub fn check(&self, scene: &Path) -> Result<(), CommandError> {
        if self.why {
            self.backend.check()?;
            return bench::refuse_bundle(scene);
        }
        if self.backend != BackendArgs::default() {
            let what =
                "--backend, --gpu and --kernel say what is measured with --why: add it, or leave them out";
            return Err(CommandError::Usage(what.into()));
        }
        Ok(())
    }

    /// The GPU to measure, if any.
    fn gpu(&self, progress: &Progress) -> Result<Option<GpuProbe>, CommandError> {
        let BackendArgs { gpu, .. } = &self.backend;
        let is_wanted = self.backend.needs_gpu() || gpu.is_some();
        if !(is_wanted || self.backend.is_auto() && run::has_gpu()) {
            return Ok(None);
        }
        let _bar = progress.step("looking for the GPU");
        GpuProbe::open(gpu.as_deref(), GpuOptions::default()).map(Some).map_err(CommandError::failed)
    }
}

/// What was measured.
#[derive(Debug, Serialize)]
pub struct Why {
    /// A line for every part that the scene does not need.
    pub why: Vec<Line>,
    /// How they were measured.
    pub why_measured: Method,
}

/// How it was measured.
#[derive(Debug, Serialize)]
pub struct Method {
    pub width: u32,
    pub height: u32,
    /// Pairs of frames, behind one of each to warm up.
    pub reps: u32,
    /// What traced rays on the CPU.
    pub kernel: &'static str,
    pub cpu_clock: &'static str,
    /// The GPU, if one was measured.
    pub gpu: Option<String>,
    pub gpu_clock: &'static str,
    /// The image's hash, by pixel format; lines whose pictures are equal have the same.
    pub hashes: BTreeMap<&'static str, String>,
}

/// A part that the scene does not need.
#[derive(Debug, Serialize)]
pub struct Line {
    pub part: &'static str,
    /// Why the scene does not need it.
    pub why: String,
    /// What was left out for it.
    pub left_out: &'static str,
    pub bytes: Bytes,
    /// None where the CPU decides about the part at each hit, so that there is no other kernel.
    pub cpu: Option<Timing>,
    pub gpu: Option<Timing>,
    /// Of the pictures with the part, by backend and pixel format.
    pub hashes: BTreeMap<String, String>,
    /// Whether all pictures are equal to those without it; none where there was no other kernel to render with.
    pub equal: Option<bool>,
}

/// Bytes that the part would take more.
#[derive(Debug, Default, Serialize)]
pub struct Bytes {
    pub pack: i64,
    /// Of each section that differs.
    pub sections: BTreeMap<&'static str, i64>,
    /// In the memory of a device that holds the pack; none if one of the two has a section too large for the indices of a kernel.
    pub device: Option<i64>,
    /// Of the text of a GPU's kernels.
    pub kernel_text: Option<i64>,
}

/// Seconds of a frame.
#[derive(Debug, Serialize)]
pub struct Timing {
    pub without_s: Spread,
    pub with_s: Spread,
    /// Share of the time with the part that leaving it out saves, of all pairs.
    pub saved_percent: Spread,
}

/// Median and quartiles.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    pub low: f64,
    pub median: f64,
    pub high: f64,
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        // Of n values the quartiles are those a quarter of the way in from both ends, rounded outwards.
        let quarter = (values.len() - 1) / 4;
        Self { low: values[quarter], median: median(&values), high: values[values.len() - 1 - quarter] }
    }
}

/// A part, and where it is put in: into the pack, or into the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Packed(Forced),
    Compiled(Part),
}

impl What {
    fn name(self) -> &'static str {
        match self {
            Self::Packed(forced) => forced.name(),
            Self::Compiled(part) => part.name(),
        }
    }

    /// What is left out with it.
    fn left_out(self) -> &'static str {
        match self {
            Self::Packed(Forced::Normals) => {
                "plain normals or the table of packed ones, look-ups, interpolation"
            }
            Self::Packed(Forced::Uvs) => "a word of every vertex record, or the section of plain coordinates",
            Self::Packed(Forced::SideUvs) => "the side table and the search in it",
            Self::Packed(Forced::Colors) => "colours of vertices, look-ups, interpolation",
            Self::Packed(Forced::Textures) => "texture coordinates, images, four look-ups a hit",
            Self::Packed(Forced::Materials) => "other materials, their runs, the search for a hit's run",
            Self::Packed(Forced::IdRuns) => "an original id of every triangle: one run has them all",
            Self::Packed(Forced::Lights) => "lights, and the loop over them at every hit",
            Self::Packed(Forced::Environment) => "the record of what a miss sees",
            Self::Packed(Forced::Cameras) => "views",
            Self::Packed(Forced::Unused) => "materials, images, masks and slots without effect",
            Self::Compiled(Part::Refs) => "tests of references at inner nodes",
            Self::Compiled(Part::Normals) => "interpolation of normals",
            Self::Compiled(Part::Textures) => "look-ups",
            Self::Compiled(Part::Colors) => "interpolation of colours",
            Self::Compiled(Part::Materials) => "the search for a hit's run",
            Self::Compiled(Part::Holes) => "a test of every candidate hit for a hole",
            Self::Compiled(Part::HiddenBacks) => "a test of every candidate hit for its side",
            Self::Compiled(Part::SeeThrough) => "shadow rays from layer to layer, rays straight on",
            Self::Compiled(Part::Mirrors) => "mirror rays and their weights",
            Self::Compiled(Part::Glass) => "bent rays, Fresnel's terms, a deeper stack of waiting rays",
        }
    }

    /// What of the CPU's kernel is put in; none where its kernel is the same, and it is only the pack that may differ.
    fn needs(self) -> Option<Needs> {
        let none = Needs::default();
        match self {
            Self::Packed(_) => Some(none),
            Self::Compiled(Part::Holes) => Some(Needs { holes: true, ..none }),
            Self::Compiled(Part::HiddenBacks) => Some(Needs { hidden_backs: true, ..none }),
            Self::Compiled(Part::SeeThrough) => Some(Needs { see_through: true, ..none }),
            Self::Compiled(_) => None,
        }
    }
}

/// The parts that `prepared` does not need, each with the reason. Plain texture coordinates have no side table.
fn unneeded(prepared: &Prepared, plain_uvs: bool) -> Vec<(What, String)> {
    let pack = &prepared.pack;
    let (mesh, variant) = (pack.mesh(), Variant::of(pack));
    let has = |section| pack.section_bytes(section) > 0;
    let is_many = pack.triangle_count() > 1;
    let stats = prepared.source.as_ref().map(|source| &source.stats);
    // What has been selected from the source says more than what the packer was given.
    let selected = |what: &str| prepared.left_out.iter().find(|l| l.what == what).map(|l| l.why.clone());
    let section = |name: &str| {
        let line = stats.and_then(|stats| stats.left_out.iter().find(|line| line.0 == name));
        line.map(|line| line.1.clone())
    };
    let unused: Vec<_> = prepared
        .left_out
        .iter()
        .filter(|l| l.what.starts_with(|c: char| c.is_ascii_digit()) && !l.what.contains("light"))
        .map(|l| format!("{}: {}", l.what, l.why))
        .collect();
    let no_uvs = || selected("texture coordinates").or_else(|| section("uv"));
    let packed = [
        (Forced::Normals, !mesh.has_normals(), selected("vertex normals").or_else(|| section("normal"))),
        (Forced::Uvs, !mesh.has_uvs(), no_uvs()),
        (Forced::SideUvs, !has(Section::SideUvs) && !plain_uvs, section("side-uv").or_else(no_uvs)),
        (Forced::Colors, !mesh.has_colors(), selected("vertex colours").or_else(|| section("color"))),
        (
            Forced::Textures,
            !variant.textures,
            section("texture").or_else(|| Some("no surface shows a texture".into())),
        ),
        (Forced::Materials, !variant.materials && is_many, Some("all triangles are of one material".into())),
        (
            Forced::IdRuns,
            pack.id_run_count() == 1 && is_many,
            Some("triangles keep the order of the source".into()),
        ),
        (Forced::Lights, !has(Section::Lights), section("light")),
        (Forced::Environment, !has(Section::Environment), section("environ")),
        (Forced::Cameras, !has(Section::Cameras), Some("the scene has no camera".into())),
        (Forced::Unused, !unused.is_empty(), Some(unused.join("; "))),
    ];
    let compiled = [
        (Part::Refs, "no inner node of the tree has a reference"),
        (Part::Holes, "no material has holes"),
        (Part::HiddenBacks, "every material shows its back"),
        (Part::SeeThrough, "no material lets light through"),
        (Part::Mirrors, "no material is smooth enough to mirror"),
        (Part::Glass, "no material refracts"),
    ];
    let packed = packed
        .into_iter()
        .filter(|(_, is_unneeded, _)| *is_unneeded)
        .map(|(forced, _, why)| (What::Packed(forced), why.unwrap_or_else(|| "the scene has none".into())));
    let compiled = compiled
        .into_iter()
        .filter(|(part, _)| !variant.has(*part))
        .map(|(part, why)| (What::Compiled(part), why.to_owned()));
    packed.chain(compiled).collect()
}

/// Measures every part that `prepared`, made of `scene`, does not need.
pub fn measure(
    scene: &SceneArgs,
    args: &WhyArgs,
    prepared: &Prepared,
    progress: &Progress,
) -> Result<Why, CommandError> {
    let options = scene.packing.options();
    let gpu = args.gpu(progress)?;
    let size = args.size.unwrap_or(Size { width: 256, height: 256 });
    let Prepared { pack, cameras, .. } = prepared;
    let frame = whole_frame(pack, cameras, size, DEPTH, features(options.without))?;
    let mut bench = Bench {
        reps: args.reps.unwrap_or(9),
        kernel: args.backend.kernel.kernel(),
        frame,
        lean: gpu.as_ref().map(|gpu| load(gpu, pack, GpuOptions::default())).transpose()?,
        pack,
        gpu: gpu.as_ref(),
        hashes: BTreeMap::new(),
    };
    bench.hashes = bench.pictures(pack, Some(Needs::default()), bench.lean.as_ref())?;

    // The scene once more, as read: what the pack was made of is gone.
    let source = {
        let _bar = progress.step("reading the scene again");
        let mut source = tessera_scene::load(&scene.scene, &options.load).map_err(CommandError::failed)?;
        source.name = prepared.name.clone();
        source
    };
    let parts = unneeded(prepared, options.plain.uvs);
    let bar = progress.parts("measuring what was left out");
    let mut lines = Vec::new();
    for (done, (what, why)) in (0..).zip(&parts) {
        bar.set(done, parts.len() as u64);
        lines.extend(bench.line(*what, why, &source, &options, cameras)?);
    }
    let hashes = bench.hashes.iter().filter_map(|(picture, hash)| {
        FORMATS
            .iter()
            .find(|format| *picture == format!("cpu {}", format.name()))
            .map(|f| (f.name(), hash.clone()))
    });
    let why_measured = Method {
        width: size.width,
        height: size.height,
        reps: bench.reps,
        kernel: bench.kernel.name(),
        cpu_clock: "CPU seconds of the whole process",
        gpu: gpu.as_ref().map(|gpu| format!("{} ({})", gpu.adapter().name, gpu.adapter().driver)),
        gpu_clock: "wall seconds, from submission to readback",
        hashes: hashes.collect(),
    };
    Ok(Why { why: lines, why_measured })
}

/// Mirrors and glass one after the other, as `tessera render` has it.
const DEPTH: u32 = 8;

const FORMATS: [PixelFormat; 3] = [PixelFormat::Rgba8, PixelFormat::Rgba16, PixelFormat::Layers];

fn features(without: Without) -> Features {
    Features { shadows: !without.shadows, reflection: !without.reflection, refraction: !without.refraction }
}

/// `pack` in the GPU's memory.
fn load(gpu: &GpuProbe, pack: &Pack, options: GpuOptions) -> Result<ProbedScene, CommandError> {
    gpu.with(GpuOptions { f64: gpu.uses_f64(), ..options }).load(pack).map_err(CommandError::failed)
}

/// What renders pairs of frames.
struct Bench<'a> {
    reps: u32,
    kernel: Kernel,
    frame: Frame,
    pack: &'a Pack,
    gpu: Option<&'a GpuProbe>,
    /// The scene on the GPU without the part.
    lean: Option<ProbedScene>,
    /// Of the pictures without any part, by backend and pixel format.
    hashes: BTreeMap<String, String>,
}

impl Bench<'_> {
    /// Measures `what`; none if the pack with it is the pack without.
    fn line(
        &self,
        what: What,
        why: &str,
        source: &Scene,
        options: &PrepareOptions,
        cameras: &[Camera],
    ) -> Result<Option<Line>, CommandError> {
        // Make the twin.
        let twin = match what {
            What::Compiled(_) => self.pack.clone(),
            What::Packed(forced) => {
                let options = PrepareOptions { forced: Some(forced), ..options.clone() };
                let twin =
                    prepare_scene(source.clone(), &options, Duration::ZERO).map_err(CommandError::failed)?;
                if twin.pack.id() == self.pack.id() {
                    return Ok(None);
                }
                twin.pack
            }
        };
        let forced = match what {
            What::Compiled(part) => Some(part),
            What::Packed(_) => None,
        };
        let full = self
            .gpu
            .map(|gpu| load(gpu, &twin, GpuOptions { forced, ..GpuOptions::default() }))
            .transpose()?;
        let size = Size { width: self.frame.width, height: self.frame.height };
        let of_twin = whole_frame(&twin, cameras, size, DEPTH, self.frame.features)?;

        // Compare pictures, which warms up, and measure.
        let needs = what.needs();
        let hashes = self.pictures(&twin, needs, full.as_ref())?;
        let is_same = |(picture, hash): (&String, &String)| self.hashes.get(picture) == Some(hash);
        let equal = (!hashes.is_empty()).then(|| hashes.iter().all(is_same));
        let cpu = needs.map(|needs| {
            self.timing(
                |watch| {
                    cpu_frame_with(self.pack, self.kernel, Needs::default(), &self.frame);
                    Ok(watch.read().cpu_s)
                },
                |watch| {
                    cpu_frame_with(&twin, self.kernel, needs, &of_twin);
                    Ok(watch.read().cpu_s)
                },
            )
        });
        let gpu = self.lean.as_ref().zip(full.as_ref()).map(|(lean, full)| {
            let wall = |scene: &ProbedScene, frame: &Frame, watch: Watch| -> Result<f64, CommandError> {
                scene.frame(frame).map_err(CommandError::failed)?;
                Ok(watch.read().wall_s)
            };
            self.timing(|watch| wall(lean, &self.frame, watch), |watch| wall(full, &of_twin, watch))
        });
        let text = |scene: &ProbedScene| scene.kernel_bytes(DEPTH).map_err(CommandError::failed);
        let kernel_text = match (&self.lean, &full) {
            (Some(lean), Some(full)) => Some(text(full)? as i64 - text(lean)? as i64),
            _ => None,
        };
        let bytes = Bytes { kernel_text, ..Bytes::more(self.pack, &twin) };
        let (cpu, gpu) = (cpu.transpose()?, gpu.transpose()?);
        let left_out = what.left_out();
        Ok(Some(Line { part: what.name(), why: why.to_owned(), left_out, bytes, cpu, gpu, hashes, equal }))
    }

    /// Times pairs of frames, in changing order, so that neither comes always behind the other.
    fn timing(
        &self,
        mut without: impl FnMut(Watch) -> Result<f64, CommandError>,
        mut with: impl FnMut(Watch) -> Result<f64, CommandError>,
    ) -> Result<Timing, CommandError> {
        let (mut without_s, mut with_s) = (Vec::new(), Vec::new());
        for rep in 0..self.reps {
            if rep % 2 == 0 {
                without_s.push(without(Watch::start())?);
                with_s.push(with(Watch::start())?);
            } else {
                with_s.push(with(Watch::start())?);
                without_s.push(without(Watch::start())?);
            }
        }
        // No frame takes less than the clock's step, 1 ns.
        let saved = |(without, with): (&f64, &f64)| 100.0 * (with - without) / with.max(1e-9);
        let saved_percent = Spread::of(without_s.iter().zip(&with_s).map(saved).collect());
        Ok(Timing { without_s: Spread::of(without_s), with_s: Spread::of(with_s), saved_percent })
    }

    /// Hashes of the frame of `pack` in every pixel format: of the CPU with its kernel's `needs`, of the GPU.
    fn pictures(
        &self,
        pack: &Pack,
        needs: Option<Needs>,
        gpu: Option<&ProbedScene>,
    ) -> Result<BTreeMap<String, String>, CommandError> {
        let mut hashes = BTreeMap::new();
        for format in FORMATS {
            let frame = Frame { format, pack: tessera_wire::PackId(pack.id().0), ..self.frame };
            let hash = |pixels| {
                let image = FrameBuffer::from_rows(frame.width, frame.height, format, pixels);
                image.map(|image| image.hash().to_string()).map_err(CommandError::failed)
            };
            if let Some(needs) = needs {
                let (pixels, _) = cpu_frame_with(pack, self.kernel, needs, &frame);
                hashes.insert(format!("cpu {}", format.name()), hash(pixels)?);
            }
            if let Some(gpu) = gpu {
                let (pixels, _) = gpu.frame(&frame).map_err(CommandError::failed)?;
                hashes.insert(format!("gpu {}", format.name()), hash(pixels)?);
            }
        }
        Ok(hashes)
    }
}

impl Bytes {
    /// Those that `twin` has more than `pack`.
    fn more(pack: &Pack, twin: &Pack) -> Self {
        let more = |of: &dyn Fn(&Pack) -> u64| of(twin) as i64 - of(pack) as i64;
        let sections = Section::ALL.iter().map(|&s| (s.name(), more(&|pack| pack.section_bytes(s))));
        let device = |pack: &Pack| {
            DeviceWords::of(pack, &[]).map(|words| words.slots.len() as i64 + 4 * words.length as i64)
        };
        Self {
            pack: more(&|pack| pack.bytes().len() as u64),
            sections: sections.filter(|(_, bytes)| *bytes != 0).collect(),
            device: device(twin).zip(device(pack)).map(|(twin, pack)| twin - pack),
            kernel_text: None,
        }
    }
}

impl Why {
    /// A failure if a picture changes with a part.
    pub fn check_equal(&self) -> Result<(), CommandError> {
        let changed: Vec<_> =
            self.why.iter().filter(|line| line.equal == Some(false)).map(|line| line.part).collect();
        if changed.is_empty() {
            return Ok(());
        }
        Err(CommandError::Failed(format!(
            "the picture is another one with {} in: please report it",
            changed.join(", ")
        )))
    }

    /// Adds a table for people.
    pub fn write(&self, t: &mut impl std::fmt::Write) -> std::fmt::Result {
        let Method { width, height, reps, kernel, cpu_clock, gpu, gpu_clock, hashes } = &self.why_measured;
        writeln!(
            t,
            "\nLeft out, and what that saves: a frame of {width} x {height}, {reps} pairs without and with each part in turn"
        )?;
        if mutation::ARE_THERE {
            writeln!(t, "  build      {BUGS_FOR_TESTS}")?;
        }
        writeln!(t, "  CPU        {kernel}, {cpu_clock}")?;
        if let Some(gpu) = gpu {
            writeln!(t, "  GPU        {gpu}, {gpu_clock}")?;
        }
        if let Some(hash) = hashes.get(PixelFormat::Rgba8.name()) {
            writeln!(t, "  image hash {hash}")?;
        }
        writeln!(
            t,
            "  part           pack      device      on    without         with     saved, median (quartiles)   picture"
        )?;
        for line in &self.why {
            let picture = if line.equal == Some(false) { "ANOTHER" } else { "the same" };
            let pack = signed(line.bytes.pack);
            let device = line.bytes.device.map_or_else(|| "too large".into(), signed);
            write!(t, "  {:<12} {pack:>10} {device:>11}", line.part)?;
            let timings = [("CPU", &line.cpu), ("GPU", &line.gpu)];
            let timings: Vec<_> =
                timings.iter().filter_map(|(on, timing)| Some((on, timing.as_ref()?))).collect();
            for (k, (on, timing)) in timings.iter().enumerate() {
                let indent = if k > 0 { "\n                                     " } else { "" };
                let Timing { without_s, with_s, saved_percent: saved } = timing;
                let share = format!("{:.1} % ({:.1} to {:.1})", saved.median, saved.low, saved.high);
                write!(
                    t,
                    "{indent}     {on}  {:>7.4} s    {:>7.4} s   {share:>26}   {picture}",
                    without_s.median, with_s.median
                )?;
            }
            if timings.is_empty() {
                write!(t, "     the CPU decides about it at each hit: no other kernel")?;
            }
            writeln!(t, "\n                {}; left out: {}", line.why, line.left_out)?;
        }
        Ok(())
    }
}

/// Bytes with a sign when there are fewer.
fn signed(n: i64) -> String {
    let sign = if n < 0 { "-" } else { "" };
    format!("{sign}{}", bytes(n.unsigned_abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_enclose_the_median() {
        let spread = |n: u32| {
            let Spread { low, median, high } = Spread::of((0..n).rev().map(f64::from).collect());
            [low, median, high]
        };
        assert_eq!(spread(1), [0.0; 3]);
        assert_eq!(spread(3), [0.0, 1.0, 2.0]);
        assert_eq!(spread(9), [2.0, 4.0, 6.0]);
        assert_eq!(signed(-2048), "-2.0 KiB");
    }
}
