//! `tessera bench gpu`.

use super::clock::Watch;
use super::gpu_lines::{Line, text};
use crate::commands::args::Size;
use crate::commands::info_text::kernel;
use crate::commands::progress::Progress;
use crate::commands::{CommandError, PackingArgs, print_text};
use clap::Args;
use clap::builder::NonEmptyStringValueParser;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;
use tessera_master::prepare::{PrepareOptions, choose_camera, prepare_scene};
use tessera_master::{Difference, FrameBuffer, FrameJob, PixelFormat};
use tessera_pack::{Pack, Plain};
use tessera_scene::{Camera, Scene};
use tessera_whitted::variant::Variant;
use tessera_wire::{Features, Frame, FrameId, limits};
use tessera_worker::Kernel;
use tessera_worker::gpu::probe::{GpuProbe, ProbedScene, cpu_frame};
use tessera_worker::gpu::{GpuError, GpuOptions, TraversalForm};

/// What to render, and on which GPU.
#[derive(Debug, Args)]
#[command(
    long_about = "Measure a GPU beside the CPU, by what its kernels are made of\n\n\
        Renders a frame of the scene with all cores and with the GPU: by each form of traversal; with the kernel that the scene needs \
        (lean) and with one from which nothing is left out (full); in f64 and in f32; of quantised and of plain vertices, with 0, 1 and 2 \
        triangle references on an inner node; and its primary rays alone. Whoever takes part alternates inside each repetition, so that \
        what else the machine does meets all of them; what counts is the median. Frames of one precision must be equal bit for bit, or the \
        bench fails; how many pixels differ from the CPU's is printed.\n\n\
        wgpu tells no registers of a kernel: what leaving out saves shows in seconds, in the time to compile, and hardly in the bytes of \
        the text, in which constants switch parts off. The time to compile includes a first frame of 8 x 8 pixels, as some drivers compile \
        then. Drivers keep kernels that they have compiled: run with MESA_SHADER_CACHE_DISABLE=true or __GL_SHADER_DISK_CACHE=0 to see it.\n\n\
        A software driver plays the GPU on the CPU: it takes many seconds for a large frame, and what it says of a real GPU is nothing.",
    after_help = "Examples:\n  tessera bench gpu scenes/hall.toml\n  tessera bench gpu scenes/sponza.toml --gpu 1 --reps 9 --json\n  \
        tessera bench gpu scenes/hall.toml --size 256x256 --reps 3     for a software driver"
)]
pub struct GpuArgs {
    /// A file that `tessera render` takes
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Which GPU: its number in `tessera doctor`, or a part of its name [default: the best]
    #[arg(long, value_name = "NAME|INDEX", value_parser = NonEmptyStringValueParser::new())]
    gpu: Option<String>,
    /// Image size in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1024x1024")]
    size: Size,
    /// Measured frames of each
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: u32,
    /// Mirrors and glass that a path may meet one after the other
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(0..=i64::from(limits::DEPTH)))]
    depth: u32,
    /// Print one JSON object a line: for each backend, form, precision, kernel and packing
    #[arg(long)]
    pub(super) json: bool,
}

/// What of a frame is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// All of it.
    Frame,
    /// Nothing beyond what the eye sees first.
    Primary,
}

impl What {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Primary => "primary",
        }
    }
}

/// How the scene is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packing {
    pub(super) plain: bool,
    pub(super) refs: u32,
}

/// Something to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Task {
    pub(super) what: What,
    pub(super) packing: Packing,
    /// The GPU's kernels, or none for the CPU.
    pub(super) gpu: Option<GpuOptions>,
}

/// What `tessera render` packs unless it is told otherwise.
const USUAL: Packing = Packing { plain: false, refs: 2 };

/// Everything that is measured, and in which order. Each is compared with the CPU's task of the same packing before it.
fn tasks(has_f64: bool) -> Vec<Task> {
    let usual = GpuOptions { f64: has_f64, ..GpuOptions::default() };
    let forms = TraversalForm::ALL.map(|form| GpuOptions { form, ..usual });
    let (cpu, on) = (None, Some);
    let task = |what, packing| move |gpu| Task { what, packing, gpu };

    let frame = task(What::Frame, USUAL);
    let mut all = vec![frame(cpu)];
    all.extend(forms.map(|lean| frame(on(lean))));
    all.extend(forms.map(|lean| frame(on(GpuOptions { lean: false, ..lean }))));
    if has_f64 {
        all.push(frame(on(GpuOptions { f64: false, ..usual })));
    }
    for plain in [false, true] {
        let packings = [0, 1, 2].map(|refs| Packing { plain, refs });
        for packing in packings.into_iter().filter(|packing| *packing != USUAL) {
            all.extend([cpu, on(usual)].map(task(What::Frame, packing)));
        }
    }
    let primary = task(What::Primary, USUAL);
    all.push(primary(cpu));
    all.extend(forms.map(|lean| primary(on(lean))));
    all
}

/// A scene as it is packed, and its frames.
struct Packed {
    packing: Packing,
    pack: Pack,
    whole: Frame,
    primary: Frame,
}

impl Packed {
    fn frame(&self, what: What) -> &Frame {
        match what {
            What::Frame => &self.whole,
            What::Primary => &self.primary,
        }
    }
}

/// A pack in the GPU's memory, and its kernel.
pub(super) struct Loaded {
    options: GpuOptions,
    packing: Packing,
    scene: ProbedScene,
    pub(super) variant: Variant,
    pub(super) kernel_bytes: usize,
    pub(super) compile_s: f64,
    pub(super) upload_s: f64,
}

/// A task, and what has come out of it.
pub(super) struct Peer<'a> {
    pub(super) task: Task,
    packed: &'a Packed,
    pub(super) loaded: Option<Rc<Loaded>>,
    pub(super) pixels: Vec<u8>,
    pub(super) rays: u64,
    /// Of each repetition, ascending when all are done.
    pub(super) wall_s: Vec<f64>,
    pub(super) cpu_s: Vec<f64>,
}

pub fn run(args: &GpuArgs, progress: &Progress) -> Result<(), CommandError> {
    super::refuse_bundle(&args.scene)?;
    // Nothing is prepared in vain.
    let gpu = {
        let _bar = progress.step("looking for the GPU");
        GpuProbe::open(args.gpu.as_deref(), GpuOptions::default()).map_err(CommandError::failed)?
    };
    let tasks = tasks(gpu.uses_f64());
    let packs = prepare(args, &tasks, progress)?;
    let mut peers = {
        let _bar = progress.step("uploading the scene and compiling kernels");
        load(&gpu, &tasks, &packs)?
    };
    measure(&mut peers, args.reps, progress)?;
    let equal = check_equal(&peers);

    let name = super::name_of(&args.scene);
    let lines = peers
        .iter()
        .map(|peer| {
            Line::new(&name, gpu.adapter(), args.reps, peer.packed.frame(peer.task.what), peer, &peers)
        })
        .collect::<Result<Vec<_>, _>>()?;
    // Where frames differ, the lines say which.
    if args.json {
        super::print_lines(&lines)?;
    } else {
        let variant = Variant::of(&packs[0].pack);
        let kernel = kernel(&variant.name(), &variant.left_out());
        print_text(&text(gpu.adapter(), packs[0].pack.triangle_count(), &kernel, equal.is_ok(), &lines))?;
    }
    equal
}

/// Packs the scene in every way that is asked for; the usual one comes first.
fn prepare(args: &GpuArgs, tasks: &[Task], progress: &Progress) -> Result<Vec<Packed>, CommandError> {
    let options = PackingArgs::default().options();
    let scene = {
        let _bar = progress.step("reading the scene");
        let mut scene = tessera_scene::load(&args.scene, &options.load).map_err(CommandError::failed)?;
        scene.name = super::name_of(&args.scene);
        scene
    };
    let mut packs: Vec<Packed> = Vec::new();
    for Task { packing, .. } in tasks {
        if packs.iter().all(|packed| packed.packing != *packing) {
            let Packing { plain, refs } = *packing;
            let form = if plain { "plain" } else { "quantised" };
            let _bar =
                progress.step(format!("packing the scene {form}, with {refs} references on an inner node"));
            packs.push(pack(args, scene.clone(), &options, *packing)?);
        }
    }
    Ok(packs)
}

fn pack(
    args: &GpuArgs,
    scene: Scene,
    options: &PrepareOptions,
    packing: Packing,
) -> Result<Packed, CommandError> {
    let Packing { plain, refs } = packing;
    let mut options =
        PrepareOptions { plain: Plain { positions: plain, normals: plain, uvs: plain }, ..options.clone() };
    options.tree.max_refs = refs;
    let prepared = prepare_scene(scene, &options, Duration::ZERO).map_err(CommandError::failed)?;
    let pack = prepared.pack;
    let whole = whole_frame(&pack, &prepared.cameras, args.size, args.depth, Features::default())?;
    let nothing = Features { shadows: false, reflection: false, refraction: false };
    let primary = Frame { depth: 0, features: nothing, ..whole };
    Ok(Packed { packing, pack, whole, primary })
}

/// A frame of `pack` that is rendered in one tile: one sample a pixel, from the first of `cameras`.
pub(in crate::commands) fn whole_frame(
    pack: &Pack,
    cameras: &[Camera],
    Size { width, height }: Size,
    depth: u32,
    features: Features,
) -> Result<Frame, CommandError> {
    let pose = choose_camera(cameras, None).map_err(CommandError::Usage)?.pose;
    let job = FrameJob {
        tile: width.max(height),
        depth,
        features,
        ..FrameJob::new(
            pose.to_local(&pack.frame(), width, height).map_err(CommandError::usage)?,
            width,
            height,
        )
    };
    let whole = job.to_wire(FrameId(1), tessera_wire::PackId(pack.id().0));
    whole.check().map_err(CommandError::usage)?;
    Ok(whole)
}

/// Uploads each pack for each kernel that it is rendered with, and compiles that.
fn load<'a>(gpu: &GpuProbe, tasks: &[Task], packs: &'a [Packed]) -> Result<Vec<Peer<'a>>, CommandError> {
    let mut all: Vec<Rc<Loaded>> = Vec::new();
    let mut peers = Vec::new();
    for &task in tasks {
        let Some(packed) = packs.iter().find(|packed| packed.packing == task.packing) else { continue };
        let loaded = match task.gpu {
            None => None,
            Some(options) => {
                let is_it = |l: &&Rc<Loaded>| (l.options, l.packing) == (options, task.packing);
                let known = all.iter().find(is_it).cloned();
                Some(match known {
                    Some(loaded) => loaded,
                    None => {
                        let loaded = Rc::new(Loaded::new(&gpu.with(options), options, packed)?);
                        all.push(loaded.clone());
                        loaded
                    }
                })
            }
        };
        let (pixels, rays, wall_s, cpu_s) = Default::default();
        peers.push(Peer { task, packed, loaded, pixels, rays, wall_s, cpu_s });
    }
    Ok(peers)
}

impl Loaded {
    fn new(gpu: &GpuProbe, options: GpuOptions, packed: &Packed) -> Result<Self, CommandError> {
        let watch = Watch::start();
        let scene = gpu.load(&packed.pack).map_err(CommandError::failed)?;
        let upload_s = watch.read().wall_s;
        let watch = Watch::start();
        // Kernels are compiled for the whole frame's depth, drivers that put it off do so now.
        let first = Frame { width: 8, height: 8, ..packed.whole };
        scene.frame(&first).map_err(CommandError::failed)?;
        let compile_s = watch.read().wall_s;
        let variant =
            if options.lean { Variant::of(&packed.pack) } else { Variant::everything(&packed.pack) };
        let kernel_bytes = scene.kernel_bytes(packed.whole.depth).map_err(CommandError::failed)?;
        Ok(Self { options, packing: packed.packing, scene, variant, kernel_bytes, compile_s, upload_s })
    }
}

/// Lets everyone render once to warm up, and then so often in turn.
fn measure(peers: &mut Vec<Peer<'_>>, reps: u32, progress: &Progress) -> Result<(), CommandError> {
    let bar = progress.parts("rendering frames");
    for pass in 0..=u64::from(reps) {
        let count = peers.len() as u64;
        let mut cut = Vec::new();
        for (done, peer) in (pass * count..).zip(&mut *peers) {
            bar.set(done, count * (u64::from(reps) + 1));
            let frame = peer.packed.frame(peer.task.what);
            let watch = Watch::start();
            let (pixels, rays) = match &peer.loaded {
                Some(loaded) => match loaded.scene.frame(frame) {
                    // Software drivers cannot do everything; what they can is still worth a line.
                    Err(GpuError::LoopsCut) => {
                        tracing::warn!(
                            "left out: {}: the driver ends long loops early",
                            described(&peer.task)
                        );
                        cut.push(peer.task);
                        continue;
                    }
                    rendered => rendered.map_err(CommandError::failed)?,
                },
                None => cpu_frame(&peer.packed.pack, Kernel::auto(), frame),
            };
            let cost = watch.read();
            if pass == 0 {
                peer.rays = rays.primary + rays.shadow + rays.reflection + rays.refraction;
                peer.pixels = pixels;
                continue;
            }
            if pixels != peer.pixels {
                let what = format!("{} does not render the same frame twice", described(&peer.task));
                return Err(CommandError::Failed(what));
            }
            peer.wall_s.push(cost.wall_s);
            peer.cpu_s.push(cost.cpu_s);
        }
        peers.retain(|peer| !cut.contains(&peer.task));
    }
    for peer in peers {
        peer.wall_s.sort_by(f64::total_cmp);
        peer.cpu_s.sort_by(f64::total_cmp);
    }
    Ok(())
}

/// All kernels of one precision make one picture of a pack.
fn check_equal(peers: &[Peer<'_>]) -> Result<(), CommandError> {
    for (i, peer) in peers.iter().enumerate() {
        let picture = |task: &Task| (task.what, task.packing, task.gpu.map(|gpu| gpu.f64));
        let twin = peers[..i].iter().find(|twin| picture(&twin.task) == picture(&peer.task));
        if let Some(twin) = twin.filter(|twin| twin.pixels != peer.pixels) {
            let mut difference = Difference::default();
            difference.add(PixelFormat::Rgba8, &twin.pixels, &peer.pixels);
            return Err(CommandError::Failed(format!(
                "{} and {} do not render the same frame: {} of {} pixels differ, by {} codes at most",
                described(&twin.task),
                described(&peer.task),
                difference.differing,
                difference.pixels,
                difference.max_abs
            )));
        }
    }
    Ok(())
}

impl Peer<'_> {
    /// The image's hash, as a render prints it.
    pub(super) fn hash(&self) -> Result<String, CommandError> {
        let Frame { width, height, format, .. } = self.packed.whole;
        let image = FrameBuffer::from_rows(width, height, format, self.pixels.clone());
        image.map(|image| image.hash().to_string()).map_err(CommandError::failed)
    }
}

fn described(task: &Task) -> String {
    let Task { what, packing: Packing { plain, refs }, gpu } = task;
    let vertices = if *plain { "plain" } else { "quantised" };
    let who = gpu.map_or("the CPU".into(), |GpuOptions { form, f64, lean, .. }| {
        let (precision, kernel) = (if f64 { "f64" } else { "f32" }, if lean { "lean" } else { "full" });
        format!("the GPU ({}, {precision}, {kernel})", form.name())
    });
    format!("{who}, {}, {vertices} vertices, {refs} references", what.name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_is_measured_once_and_after_the_cpu() {
        for has_f64 in [false, true] {
            let all = tasks(has_f64);
            let forms = TraversalForm::ALL.len();
            assert_eq!(all.len(), 1 + 2 * forms + usize::from(has_f64) + 2 * 5 + 1 + forms);
            assert_eq!(all[0].packing, USUAL, "the first pack is that of a render");
            for (i, task) in all.iter().enumerate() {
                assert!(!all[..i].contains(task), "{task:?}");
                let cpu = Task { gpu: None, ..*task };
                assert!(task.gpu.is_none() || all[..i].contains(&cpu), "{task:?}");
                assert!(has_f64 || task.gpu.is_none_or(|gpu| !gpu.f64));
            }
        }
    }
}
