//! `tessera render`.

use super::against::{self, Against, Subject, Wanted};
use super::args::{Size, Triple, coded_error, field_of_view, weight};
use super::backend::BackendArgs;
use super::page::Overlay;
use super::progress::Progress;
use super::run::{Crew, LocalCrew, Session, Written, prepare_scene};
use super::sequence::{self, SequenceArgs};
use super::{CommandError, PackingArgs, SceneArgs};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::path::{Path, PathBuf};
use std::time::Instant;
use tessera_geometry::{CameraPose, DVec3};
use tessera_master::prepare::{Prepared, choose_camera};
use tessera_master::report::{CameraReport, RenderFacts, RenderReport};
use tessera_master::trace::{RunTrace, TraceFile};
use tessera_master::{Balance, FrameJob, FrameResult, OutputFile, PixelFormat};
use tessera_whitted::variant::Variant;
use tessera_wire::{Adaptive, Coding, Features, FrameError, Sampler, Sampling, TileGrid, limits};

/// What to render, and how.
#[derive(Debug, Args)]
#[command(
    long_about = "Render a scene to a PNG or EXR file\n\n\
        The same scene, size, samples and features give the same picture, bit for bit, whatever the number of workers, threads and tiles, \
        and whatever the balancing: compare the image hash that every render prints. That holds within one numeric class: all CPUs are \
        of one, each kind of GPU with its driver is of another. A picture is of one class unless --mix says otherwise.",
    after_help = "Examples:\n\
        \x20 tessera render bunny.ply --out bunny.png\n\
        \x20 tessera render scenes/sponza.toml --out sponza.png --workers 4 --size 1920x1080 --spp 4\n\
        \x20 tessera render scenes/sponza.toml --out sponza.png --master @join.txt\n\
        \x20 tessera render room.glb --out room.exr --eye -120,20,0 --target 0,45,-5 --fov 70\n\
        \x20 tessera render room.glb --out room.png --sampler low-discrepancy --adaptive 0.004 --spp 1024\n\
        \x20 tessera render room.glb --out flat.png --without textures,shadows --report report.json\n\
        \x20 tessera render walk.glb --out 'frame-%04d.png' --frames 120 --workers 4 --groups 2\n\
        \x20 tessera render room.glb --out 'frame-%d.png' --poses - --newest < poses.jsonl"
)]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The file to write: .png (sRGB) or .exr (linear, with depth, normal and triangle layers)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Local worker processes; 0 renders in this process
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=WORKERS_MAX))]
    workers: u32,
    /// Render on the workers of a master elsewhere: its join string, or @FILE that holds it
    ///
    /// The scene is read and packed here; the pack is sent unless the master has it, and the picture comes back.
    #[arg(long, value_name = "STRING|@FILE", conflicts_with_all = ["workers", "threads", "kernel", "backend", "gpu"])]
    master: Option<String>,
    /// Say how far the picture is from a truer one, beside the time that it took
    ///
    /// FILE is an EXR file, or one of the picture's own kind; plain is the same frame of plain vertices, spp:N the one of so many samples a
    /// pixel and another seed, oracle what an f64 tracer over the scene as its file states it sees (kept for the next time). A PNG picture
    /// is compared with what of a linear one it can show. The frame is rendered with 1, 2, 4, ... samples first, each from its beginning, so
    /// that the error is seen to fall; the last picture is the one that is written.
    #[arg(long, value_name = "FILE|plain|spp:N|oracle[:N]")]
    error_against: Option<Against>,
    #[command(flatten)]
    sequence: SequenceArgs,
    #[command(flatten)]
    frame: FrameArgs,
}

/// Most worker processes on one machine.
pub const WORKERS_MAX: i64 = 256;

/// One frame, for every command that renders.
#[derive(Clone, Debug, Args)]
pub struct FrameArgs {
    /// Image size in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1024x1024", help_heading = "Image")]
    size: Size,
    /// Samples a pixel; one goes through the pixel's centre
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Image")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=i64::from(limits::SAMPLES)))]
    spp: u32,
    /// Where the samples of a pixel lie
    ///
    /// jittered is correlated multi-jittered (Kensler 2013); low-discrepancy is Sobol's sequence with Owen's scrambling: as good on edges,
    /// better where a pixel is smooth, and for --adaptive.
    #[arg(long, value_name = "NAME", default_value = Sampler::default().name(), help_heading = "Image")]
    #[arg(value_parser = PossibleValuesParser::new(Sampler::ALL.map(Sampler::name)).map(sampler))]
    sampler: Sampler,
    /// Leave out rays whose weight in the pixel is below W, [0, 1]
    ///
    /// The default, 1/512, is below what 8 bits show. Less than 1/65536 goes only with a --depth of at most 3: nothing else would bound the
    /// rays behind a sample.
    #[arg(long, value_name = "W", default_value_t = Sampling::CUTOFF, value_parser = weight, help_heading = "Image")]
    #[arg(allow_hyphen_values = true)]
    cutoff: f32,
    /// Take fewer samples than --spp where the estimated error is at most ERROR
    ///
    /// ERROR is the root mean square over a block of 16x16 pixels, in sRGB-coded values of [0, 1]: 0.004 is a step of 8 bits. A block gets
    /// 16 samples a pixel at least, and twice as many until it is good enough or has --spp. --tile must be a multiple of 16.
    #[arg(long, value_name = "ERROR", value_parser = coded_error, help_heading = "Image")]
    #[arg(allow_hyphen_values = true)]
    adaptive: Option<f32>,
    /// Mirrors and glass that a path may meet one after the other
    #[arg(long, value_name = "N", default_value_t = 8, help_heading = "Image")]
    #[arg(value_parser = clap::value_parser!(u32).range(0..=i64::from(limits::DEPTH)))]
    depth: u32,
    /// Bits a channel of a PNG file [default: 8]
    #[arg(long, value_enum, help_heading = "Image")]
    bits: Option<Bits>,
    /// A camera of the scene [default: its first; if the scene has none, one that frames the scene's box]
    #[arg(long, value_name = "NAME", help_heading = "Camera")]
    #[arg(conflicts_with_all = ["eye", "target", "up", "fov"])]
    camera: Option<String>,
    /// Eye position; needs --target and --fov
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, help_heading = "Camera")]
    #[arg(requires = "target", requires = "fov")]
    eye: Option<Triple>,
    /// The point in the middle of the image
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, help_heading = "Camera")]
    #[arg(requires = "eye", requires = "fov")]
    target: Option<Triple>,
    /// What points up in the image [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "eye", help_heading = "Camera")]
    up: Option<Triple>,
    /// Vertical field of view in degrees
    #[arg(long, value_name = "DEG", value_parser = field_of_view, allow_hyphen_values = true)]
    #[arg(requires = "eye", requires = "target", help_heading = "Camera")]
    fov: Option<f64>,
    /// Side of a tile in pixels [default: 128, and with --balance auto what suits workers and tiles]
    #[arg(long, value_name = "N", help_heading = "Cluster")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..))]
    tile: Option<u32>,
    /// How tiles get to workers; the picture is the same
    ///
    /// paper-static deals them row by row, each worker returns all of its tiles at once; static deals them without stripes and has them
    /// returned in batches; hilbert gives each a piece of a curve; weighted and staggered deal by what tiles have cost and how fast workers were
    /// in the frame before, to end at the same time or one after the other; paper-dynamic gives one tile at a time to whoever asks; dynamic does so
    /// with some ahead of need; steal keeps weighted lists from which those that have nothing left take; auto tries and measures. All but
    /// the paper's help out workers that are late.
    #[arg(long, value_name = "MODE", default_value_t, help_heading = "Cluster")]
    #[arg(value_parser = PossibleValuesParser::new(Balance::ALL.map(Balance::name)).try_map(|s| s.parse::<Balance>()))]
    balance: Balance,
    /// Threads of each worker [default: the cores, shared out among the workers]
    #[arg(long, value_name = "N", help_heading = "Cluster")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
    #[command(flatten)]
    pub backend: BackendArgs,
    /// How pixels travel from workers
    ///
    /// lossless packs them, rounded rounds colours by at most a step of 8 bits first, so that nobody sees it and less travels (the picture is
    /// then another, and its hash too; layers of EXR files are not rounded). auto is raw or lossless, whichever takes less time as measured.
    #[arg(long, value_name = "CODING", default_value = "auto", help_heading = "Cluster")]
    #[arg(value_parser = PossibleValuesParser::new(CODINGS).map(|name| coding(&name)))]
    coding: CodingFlag,
    /// Let workers of different arithmetic (CPUs, kinds of GPU) render one picture
    ///
    /// Without it one class renders a picture, the one that is the fastest together, and others idle. The report of a mixed picture says
    /// which class rendered how much, and how far they differ on a few tiles that both have rendered.
    #[arg(long, help_heading = "Cluster")]
    mix: bool,
    /// Write a JSON report of the render to a file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Record where the time of every tile went, for Perfetto, Chrome's tracing, and `tessera why-slow`
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Draw over the picture who has rendered which tile, or what each has cost: NAME.workers.png, NAME.cost.png
    ///
    /// The whole image is then held in memory until it is complete.
    #[arg(long, value_name = "KINDS", value_enum, value_delimiter = ',')]
    overlay: Vec<Overlay>,
    /// Print the report as one JSON object on stdout, and nothing else
    #[arg(long)]
    pub json: bool,
}

/// What `--coding` takes.
const CODINGS: [&str; 4] = ["auto", Coding::Raw.name(), Coding::Lossless.name(), Coding::Rounded.name()];

/// Of `--coding`; `None`: by what is measured. (clap takes a bare option for a flag that may be missing.)
#[derive(Clone, Copy, Debug)]
struct CodingFlag(Option<Coding>);

/// The coding of that name, if it is one.
fn coding(name: &str) -> CodingFlag {
    CodingFlag(Coding::ALL.into_iter().find(|coding| coding.name() == name))
}

/// The sampler of that name, which is one.
fn sampler(name: String) -> Sampler {
    Sampler::ALL.into_iter().find(|sampler| sampler.name() == name).unwrap_or_default()
}

/// Bits a channel of a PNG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Bits {
    #[value(name = "8")]
    Eight,
    #[value(name = "16")]
    Sixteen,
}

pub fn run(args: RenderArgs, progress: &Progress) -> Result<(), CommandError> {
    let RenderArgs { scene, out, workers, master, error_against, sequence, frame } = args;
    let is_sequence = sequence.is_asked_for();
    if is_sequence && (error_against.is_some() || frame.report.is_some()) {
        return Err(CommandError::Usage(
            "--report and --error-against are of one picture; leave them out of a sequence, or --frames, --path and --poses".into(),
        ));
    }
    if is_sequence && (frame.trace.is_some() || !frame.overlay.is_empty()) {
        return Err(CommandError::Usage(
            "--trace and --overlay show where one frame's time went, and those of a sequence share it; leave them out, or --frames, --path and \
             --poses"
                .into(),
        ));
    }
    sequence.check(master.is_some()).map_err(CommandError::Usage)?;
    // Names that the pattern has no place for are found out before the scene is read.
    let first = if is_sequence { sequence.first_file(&out)? } else { out.clone() };
    let crew = match master {
        Some(join) => Crew::Master(super::join::parse(&join, "--master")?),
        None => Crew::Local(frame.local_crew(workers)),
    };
    let mut plan = Plan::check(&first, Some(&scene.scene), crew, &frame, &scene.packing)?;
    if let Some(against) = &error_against {
        plan.compare_with(against, &scene)?;
    }
    let plan = plan.with_backend(progress)?;
    let prepared = prepare_scene(&scene.scene, &scene.packing, progress)?;
    if is_sequence {
        return sequence::render(&sequence, &out, &plan, &frame, &prepared, progress);
    }
    plan.render(&prepared, progress)
}

/// A render whose arguments have been checked as far as they can be without the scene.
pub struct Plan<'a> {
    out: OutputFile,
    report: Option<OutputFile>,
    trace: Option<OutputFile>,
    overlays: Vec<(Overlay, OutputFile)>,
    format: PixelFormat,
    features: Features,
    crew: Crew,
    args: &'a FrameArgs,
    /// What the picture is compared with, and of what scene it is.
    against: Option<(&'a Against, Option<against::Truth>, &'a SceneArgs)>,
}

impl<'a> Plan<'a> {
    /// Checks what can be checked before the scene, if it is a file, is read.
    pub fn check(
        out: &Path,
        scene: Option<&Path>,
        crew: Crew,
        args: &'a FrameArgs,
        packing: &PackingArgs,
    ) -> Result<Self, CommandError> {
        let format = pixel_format(out, args.bits)?;
        let grid =
            TileGrid::new(args.size.width, args.size.height, args.tile()).map_err(CommandError::usage)?;
        let bytes = grid.largest_tile_pixels() * format.bytes_per_pixel() as u64;
        if bytes > limits::TILE_BYTES {
            return Err(CommandError::usage(FrameError::TileBytes { bytes }));
        }
        args.sampling().check(args.tile(), args.depth).map_err(CommandError::usage)?;
        let without = packing.without();
        let features = Features {
            shadows: !without.shadows,
            reflection: !without.reflection,
            refraction: !without.refraction,
        };
        if let (Crew::Master(_), true) = (&crew, args.trace.is_some() || !args.overlay.is_empty()) {
            let flag = if args.trace.is_some() { "--trace" } else { "--overlay" };
            return Err(CommandError::Usage(format!(
                "{flag}: a master elsewhere does not tell of single tiles; leave it out, or render with --workers"
            )));
        }
        let overlay = |kind: &Overlay| {
            let file = OutputFile::check(&out.with_extension(format!("{}.png", kind.name())));
            file.map(|file| (*kind, file)).map_err(CommandError::failed)
        };
        let overlays = args.overlay.iter().map(overlay).collect::<Result<Vec<_>, _>>()?;
        let trace = args.trace.as_deref().map(OutputFile::check).transpose().map_err(CommandError::failed)?;
        let report = args.report.as_deref().map(OutputFile::check).transpose();
        let report = report.map_err(CommandError::failed)?;
        let out = OutputFile::check(out).map_err(CommandError::failed)?;
        let written = [(&report, "--report"), (&trace, "--trace")];
        for (file, flag) in written.iter().filter_map(|(file, flag)| Some((file.as_ref()?, flag))) {
            let overlays = overlays.iter().map(|(_, overlay)| (Some(overlay.path()), "an overlay"));
            let report = report.as_ref().filter(|_| *flag == "--trace").map(|file| file.path());
            let others = [(Some(out.path()), "the picture"), (scene, "the scene"), (report, "the report")];
            for (other, what) in others.into_iter().chain(overlays) {
                if other.is_some_and(|other| file.is_at(other)) {
                    return Err(CommandError::Usage(format!(
                        "{flag} {}: this is the file of {what}; name another",
                        file.path().display()
                    )));
                }
            }
        }
        Ok(Self { out, report, trace, overlays, format, features, crew, args, against: None })
    }

    /// Has the picture of `scene` compared with another; one in a file is read now.
    fn compare_with(&mut self, against: &'a Against, scene: &'a SceneArgs) -> Result<(), CommandError> {
        let Size { width, height } = self.args.size;
        let (out, report) = (&self.out, self.report.as_ref());
        let (samples, format) = (self.args.spp, self.format);
        let truth = against.check(&Wanted { scene, out, report, width, height, samples, format })?;
        self.against = Some((against, truth, scene));
        Ok(())
    }

    /// Settles what renders (see [`Crew::settle_backend`]).
    pub fn with_backend(mut self, progress: &Progress) -> Result<Self, CommandError> {
        self.crew.settle_backend(progress)?;
        Ok(self)
    }

    /// Renders, writes the files and says what was done.
    pub fn render(mut self, prepared: &Prepared, progress: &Progress) -> Result<(), CommandError> {
        let args = self.args;
        let (name, pose) = args.pose(prepared)?;
        let job = self.job(&pose, prepared)?;
        let mut session = Session::open(&prepared.pack, &self.crew, progress)?;
        let frame = match self.against.take() {
            None => self.render_to_file(&mut session, &job).map(|frame| (frame, None)),
            Some((against, truth, scene)) => {
                let subject = Subject { scene, pose, job: &job };
                let found = against::render(against, truth, &subject, &mut session, progress);
                found.and_then(|(frame, error)| Ok((self.write(frame)?, Some(error))))
            }
        };
        let start = session.start();
        session.close();
        let (frame, error) = frame?;
        let Written { hash, write } = frame.image;
        let facts = RenderFacts {
            prepared,
            job: &job,
            camera: CameraReport::new(name, &pose),
            backend_note: match &self.crew {
                Crew::Local(crew) => crew.note.clone(),
                Crew::Master(_) => None,
            },
            kernel: args.backend.kernel.kernel().name(),
            gpu_kernel: (frame.workers.iter().any(|worker| worker.backend == "gpu" && worker.tiles > 0))
                .then(|| Variant::of(&prepared.pack).name()),
            out: self.out.path().to_owned(),
            hash,
            start,
            write,
            error,
        };
        let report = RenderReport::new(facts, &frame);
        if let Some(file) = &self.report {
            file.write(|to| serde_json::to_writer_pretty(to, &report)).map_err(CommandError::failed)?;
        }
        if let Some(file) = &self.trace {
            let run = RunTrace::of_frame(&prepared.name, &job, &frame);
            file.write(|to| serde_json::to_writer(to, &TraceFile::new(&run)))
                .map_err(CommandError::failed)?;
        }
        if args.json { super::print_json(&report) } else { super::print_text(&report.text()) }
    }

    /// Who renders.
    pub fn crew(&self) -> &Crew {
        &self.crew
    }

    /// What workers are asked for, for a view of the scene.
    pub fn job(&self, pose: &CameraPose, prepared: &Prepared) -> Result<FrameJob, CommandError> {
        let args = self.args;
        let Size { width, height } = args.size;
        let camera = pose
            .to_local(&prepared.pack.frame(), width, height)
            .map_err(|e| CommandError::Usage(format!("the camera cannot be used: {e}")))?;
        Ok(FrameJob {
            camera,
            width,
            height,
            // Left to `auto` unless the user has chosen.
            tile: if args.balance == Balance::Auto { args.tile.unwrap_or(0) } else { args.tile() },
            samples: args.spp,
            sampling: args.sampling(),
            depth: args.depth,
            seed: 0,
            features: self.features,
            format: self.format,
            balance: args.balance,
            mix: args.mix,
            coding: args.coding.0,
        })
    }

    /// PNG files take rows as they become complete, EXR files and overlays the whole image.
    fn render_to_file(
        &self,
        session: &mut Session<'_>,
        job: &FrameJob,
    ) -> Result<FrameResult<Written>, CommandError> {
        if self.format != PixelFormat::Layers && self.overlays.is_empty() {
            return session.render_to_png(job, &self.out);
        }
        self.write(session.render(job)?)
    }

    fn write(&self, frame: FrameResult) -> Result<FrameResult<Written>, CommandError> {
        let begin = Instant::now();
        frame.image.write(&self.out).map_err(CommandError::failed)?;
        let write = begin.elapsed();
        let hash = frame.image.hash();
        for (overlay, file) in &self.overlays {
            let png = overlay.draw(&frame, frame.tile).map_err(CommandError::Failed)?;
            file.write_bytes(&png).map_err(CommandError::failed)?;
        }
        Ok(frame.with_image(Written { hash, write }).0)
    }
}

impl FrameArgs {
    /// `workers` processes of this machine, or none and this one.
    pub fn local_crew(&self, workers: u32) -> LocalCrew {
        LocalCrew {
            workers,
            threads: self.threads,
            backend: self.backend.clone(),
            opened: None,
            note: None,
            is_left_to_us: false,
        }
    }

    /// Side of a tile, as far as the user has a word in it.
    fn tile(&self) -> u32 {
        self.tile.unwrap_or(FrameJob::TILE)
    }

    fn sampling(&self) -> Sampling {
        let adaptive = self.adaptive.map(|error| Adaptive { error });
        Sampling { sampler: self.sampler, cutoff: self.cutoff, adaptive }
    }

    /// The view that was asked for, and its name in the scene if it has one.
    pub fn pose(&self, prepared: &Prepared) -> Result<(Option<String>, CameraPose), CommandError> {
        if let (Some(eye), Some(target), Some(fov_degrees)) = (self.eye, self.target, self.fov) {
            let up = self.up.unwrap_or(Triple([0.0, 1.0, 0.0]));
            let vector = |t: Triple| DVec3::from_array(t.0);
            let pose = CameraPose { eye: vector(eye), target: vector(target), up: vector(up), fov_degrees };
            return Ok((None, pose));
        }
        let camera = choose_camera(&prepared.cameras, self.camera.as_deref()).map_err(CommandError::Usage)?;
        Ok((Some(camera.name.clone()), camera.pose))
    }
}

fn pixel_format(out: &Path, bits: Option<Bits>) -> Result<PixelFormat, CommandError> {
    let extension = out.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match (extension.as_str(), bits) {
        ("png", None | Some(Bits::Eight)) => Ok(PixelFormat::Rgba8),
        ("png", Some(Bits::Sixteen)) => Ok(PixelFormat::Rgba16),
        ("exr", None) => Ok(PixelFormat::Layers),
        ("exr", Some(_)) => Err(CommandError::Usage(format!(
            "--out {}: --bits is for PNG files, an EXR file holds 32 bits a channel; leave it out",
            out.display()
        ))),
        _ => Err(CommandError::Usage(format!(
            "--out {}: unknown picture format; name the file .png or .exr",
            out.display()
        ))),
    }
}
