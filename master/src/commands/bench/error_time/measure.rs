//! Renders the settings of a knob in turn, and says how far each is from the truth.

use super::ErrorTimeArgs;
use super::knob::{ALL_PLAIN, Base, By, Knob, Look, Setting, Truth};
use crate::commands::CommandError;
use crate::commands::bench::clock::{Cost, Watch};
use crate::commands::info::MESH_SECTIONS;
use crate::commands::progress::Progress;
use crate::commands::reference::Truths;
use crate::commands::run::{Crew, LocalCrew, Session};
use std::rc::Rc;
use std::time::Duration;
use tessera_geometry::CameraPose;
use tessera_master::compare::{Comparison, Picture, compare};
use tessera_master::prepare::prepare_scene;
use tessera_master::{FrameBuffer, FrameJob, PixelFormat};
use tessera_oracle::View;
use tessera_pack::format::Section;
use tessera_pack::{Pack, PackId};
use tessera_scene::{Scene, Without};
use tessera_wire::{Frame, FrameId, Rays};
use tessera_worker::Kernel;
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::{GpuProbe, ProbedScene, cpu_frame};

/// What all knobs have in common.
pub struct Studio<'a> {
    pub args: &'a ErrorTimeArgs,
    pub scene: &'a Scene,
    pub pose: CameraPose,
    pub base: Base,
    pub gpu: Option<GpuProbe>,
    /// By what is left out.
    pub truths: Vec<(Without, Truths)>,
    pub progress: &'a Progress,
}

/// A setting, and what came out of it.
pub struct Outcome {
    pub setting: Setting,
    /// Of each measured frame, ascending.
    pub wall_s: Vec<f64>,
    pub cpu_s: Vec<f64>,
    pub rays: Rays,
    pub bytes: Bytes,
    pub pack_id: PackId,
    /// From the truth, of the linear picture.
    pub error: Comparison,
    /// Of the table that the paper has: from the frame of plain vertices, as 8-bit pictures.
    pub to_plain: Option<Comparison>,
    /// Of the 8-bit picture.
    pub hash: String,
}

/// Sizes of a pack.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Bytes {
    pub pack: u64,
    pub mesh: u64,
    pub tree: u64,
}

/// The settings of a knob, measured.
pub struct Turned {
    pub knob: Knob,
    pub outcomes: Vec<Outcome>,
    pub extremes: Extremes,
    /// Wall time between the measured frames, as a share of theirs.
    pub harness_share: f64,
}

/// The best and the worst picture of a knob.
#[derive(Default)]
pub struct Extremes {
    pub best: Option<Extreme>,
    pub worst: Option<Extreme>,
}

/// A picture, and what it was compared with.
#[derive(Clone)]
pub struct Extreme {
    pub setting: String,
    pub rmse: f64,
    pub truth: Rc<Picture>,
    pub picture: Rc<Picture>,
}

impl Extremes {
    fn see(&mut self, setting: &Setting, truth: &Rc<Picture>, rmse: f64, picture: Picture) {
        let is_best = self.best.as_ref().is_none_or(|best| rmse < best.rmse);
        let is_worst = self.worst.as_ref().is_none_or(|worst| rmse > worst.rmse);
        let setting = format!("{} {}", setting.series, setting.value);
        let extreme = Extreme { setting, rmse, truth: truth.clone(), picture: Rc::new(picture) };
        if is_worst {
            self.worst = Some(extreme.clone());
        }
        if is_best {
            self.best = Some(extreme);
        }
    }
}

impl Studio<'_> {
    /// Measures every setting of `knob`.
    pub fn turn(&self, knob: Knob) -> Result<Turned, CommandError> {
        let settings = knob.settings(&self.base);
        let truths = self.truths_of(&settings)?;
        let packs = self.packs_of(knob, &settings)?;
        let mut peers = settings
            .into_iter()
            .zip(&packs)
            .map(|(setting, pack)| self.peer(setting, pack))
            .collect::<Result<Vec<_>, _>>()?;
        // One picture at a time: of all of them only the best and the worst are shown.
        let mut errors = Vec::with_capacity(peers.len());
        let mut extremes = Extremes::default();
        for (peer, truth) in peers.iter_mut().zip(&truths) {
            let picture = peer.picture()?;
            let error = compare(truth, &picture).map_err(CommandError::failed)?;
            extremes.see(&peer.setting, truth, error.rmse, picture);
            errors.push(error);
        }
        let harness_share = measure(&mut peers, self.args.reps, knob, self.progress)?;
        let shown = peers.iter().map(Peer::shown).collect::<Result<Vec<_>, _>>()?;
        let mut outcomes = Vec::with_capacity(peers.len());
        for (place, (peer, error)) in peers.iter().zip(errors).enumerate() {
            let plain = (knob == Knob::Packed).then(|| plain_twin(&peers, peer)).flatten();
            let to_plain = plain.map(|plain| {
                compare(&Picture::from_frame(&shown[plain]), &Picture::from_frame(&shown[place]))
            });
            outcomes.push(Outcome {
                setting: peer.setting.clone(),
                wall_s: peer.wall_s.clone(),
                cpu_s: peer.cpu_s.clone(),
                rays: peer.rays,
                bytes: Bytes::of(peer.pack),
                pack_id: peer.pack.id(),
                error,
                to_plain: to_plain.transpose().map_err(CommandError::failed)?,
                hash: shown[place].hash().to_string(),
            });
        }
        drop_repeated(&mut outcomes);
        Ok(Turned { knob, outcomes, extremes, harness_share })
    }

    /// What each setting is compared with; equal ones are asked for once.
    fn truths_of(&self, settings: &[Setting]) -> Result<Vec<Rc<Picture>>, CommandError> {
        let mut known: Vec<((Truth, Without), Rc<Picture>)> = Vec::new();
        let mut all = Vec::with_capacity(settings.len());
        for setting in settings {
            let key = (setting.truth, setting.packing.without);
            let found = known.iter().find(|(other, _)| *other == key).map(|(_, picture)| picture.clone());
            let picture = match found {
                Some(picture) => picture,
                None => {
                    let Truth { samples, depth, min_weight } = setting.truth;
                    let (width, height) = (self.args.size.width, self.args.size.height);
                    let view = View { pose: self.pose, width, height, samples, depth, min_weight };
                    let truths = self.truths.iter().find(|(without, _)| *without == setting.packing.without);
                    let (_, truths) =
                        truths.ok_or_else(|| CommandError::Failed("no oracle for it".into()))?;
                    let picture = Rc::new(within_white(truths.picture(&view, self.progress)?));
                    known.push((key, picture.clone()));
                    picture
                }
            };
            all.push(picture);
        }
        Ok(all)
    }

    /// The pack of each setting; equal ones are made once.
    fn packs_of(&self, knob: Knob, settings: &[Setting]) -> Result<Vec<Rc<Pack>>, CommandError> {
        let mut packs: Vec<Rc<Pack>> = Vec::with_capacity(settings.len());
        let bar = self.progress.parts(&format!("{knob}: packing the scene"));
        for (done, setting) in settings.iter().enumerate() {
            bar.set(done as u64, settings.len() as u64);
            let twin = settings[..done].iter().position(|other| other.packing == setting.packing);
            let pack = match twin {
                Some(twin) => packs[twin].clone(),
                None => {
                    let prepared = prepare_scene(self.scene.clone(), &setting.packing, Duration::ZERO);
                    Rc::new(prepared.map_err(CommandError::failed)?.pack)
                }
            };
            packs.push(pack);
        }
        Ok(packs)
    }

    /// A setting ready to render.
    fn peer<'p>(&'p self, setting: Setting, pack: &'p Pack) -> Result<Peer<'p>, CommandError> {
        let (width, height) = (self.args.size.width, self.args.size.height);
        let camera = self.pose.to_local(&pack.frame(), width, height).map_err(CommandError::usage)?;
        let Look { samples, sampling, depth, features } = setting.look;
        let tile = match setting.by {
            By::Tiles(side) => side,
            By::Cpu(_) | By::Gpu => width.max(height),
        };
        let job = FrameJob {
            tile,
            samples,
            sampling,
            depth,
            features,
            format: PixelFormat::Layers,
            ..FrameJob::new(camera, width, height)
        };
        let hands = match (setting.by, &self.gpu) {
            (By::Cpu(kernel), _) => Hands::Cpu(kernel),
            (By::Gpu, Some(gpu)) => Hands::Gpu(
                gpu.with(GpuOptions { f64: gpu.uses_f64(), ..GpuOptions::default() })
                    .load(pack)
                    .map_err(CommandError::failed)?,
            ),
            (By::Gpu, None) => return Err(CommandError::Failed("no GPU was opened".into())),
            (By::Tiles(_), _) => Hands::Worker(Box::new(Session::open(
                pack,
                &Crew::Local(LocalCrew::this_process()),
                self.progress,
            )?)),
        };
        let (shown, wall_s, cpu_s, rays) = Default::default();
        Ok(Peer { setting, pack, job, hands, shown, wall_s, cpu_s, rays })
    }
}

/// A setting that renders.
struct Peer<'p> {
    setting: Setting,
    pack: &'p Pack,
    job: FrameJob,
    hands: Hands<'p>,
    /// The 8-bit frame that is timed.
    shown: Vec<u8>,
    wall_s: Vec<f64>,
    cpu_s: Vec<f64>,
    rays: Rays,
}

/// What renders for a setting.
enum Hands<'p> {
    Cpu(Kernel),
    Gpu(ProbedScene),
    Worker(Box<Session<'p>>),
}

impl Peer<'_> {
    /// Renders a frame whose pixels are in `format`, and says what that took.
    fn render(&mut self, format: PixelFormat) -> Result<(Vec<u8>, Rays, Cost), CommandError> {
        let job = FrameJob { format, ..self.job.clone() };
        let frame: Frame = job.to_wire(FrameId(1), tessera_wire::PackId(self.pack.id().0));
        let watch = Watch::start();
        let (pixels, rays, cost) = match &mut self.hands {
            Hands::Cpu(kernel) => {
                let (pixels, rays) = cpu_frame(self.pack, *kernel, &frame);
                (pixels, rays, watch.read())
            }
            Hands::Gpu(scene) => {
                let (pixels, rays) = scene.frame(&frame).map_err(CommandError::failed)?;
                (pixels, rays, watch.read())
            }
            Hands::Worker(session) => {
                let frame = session.render(&job)?;
                let cost = watch.read();
                (frame.image.data().to_vec(), frame.rays, cost)
            }
        };
        Ok((pixels, rays, cost))
    }

    /// The linear picture: what its error is measured on. Also warms up.
    fn picture(&mut self) -> Result<Picture, CommandError> {
        let (pixels, ..) = self.render(PixelFormat::Layers)?;
        Ok(within_white(Picture::from_frame(&self.buffer(PixelFormat::Layers, pixels)?)))
    }

    /// The 8-bit frame.
    fn shown(&self) -> Result<FrameBuffer, CommandError> {
        self.buffer(PixelFormat::Rgba8, self.shown.clone())
    }

    fn buffer(&self, format: PixelFormat, pixels: Vec<u8>) -> Result<FrameBuffer, CommandError> {
        FrameBuffer::from_rows(self.job.width, self.job.height, format, pixels).map_err(CommandError::failed)
    }
}

/// Lets everybody render once to warm up, and then so often in turn, so that what else the machine does meets all of them. Says how much
/// time passed between the measured frames, as a share of theirs.
fn measure(peers: &mut [Peer<'_>], reps: u32, knob: Knob, progress: &Progress) -> Result<f64, CommandError> {
    let bar = progress.parts(&format!("{knob}: rendering frames"));
    let count = peers.len() as u64;
    for peer in &mut *peers {
        let (pixels, rays, _) = peer.render(PixelFormat::Rgba8)?;
        (peer.shown, peer.rays) = (pixels, rays);
    }
    let watch = Watch::start();
    let mut in_frames = 0.0;
    for pass in 0..u64::from(reps) {
        for (done, peer) in (pass * count..).zip(&mut *peers) {
            bar.set(done, count * u64::from(reps));
            let (pixels, _, cost) = peer.render(PixelFormat::Rgba8)?;
            if pixels != peer.shown {
                let Setting { series, value, .. } = &peer.setting;
                return Err(CommandError::Failed(format!(
                    "{knob}, {series} {value}: it does not render the same frame twice"
                )));
            }
            in_frames += cost.wall_s;
            peer.wall_s.push(cost.wall_s);
            peer.cpu_s.push(cost.cpu_s);
        }
    }
    let between = watch.read().wall_s - in_frames;
    for peer in peers {
        peer.wall_s.sort_by(f64::total_cmp);
        peer.cpu_s.sort_by(f64::total_cmp);
    }
    Ok(between / in_frames.max(f64::MIN_POSITIVE))
}

/// The place of the frame that differs from `peer`'s by its plain vertices alone.
fn plain_twin(peers: &[Peer<'_>], peer: &Peer<'_>) -> Option<usize> {
    let is_twin = |other: &Peer<'_>| {
        other.setting.look == peer.setting.look && other.setting.packing.plain == ALL_PLAIN
    };
    peers.iter().position(is_twin)
}

/// Where two settings of a curve come to the same (a grid that is as fine as it gets), the first stays.
fn drop_repeated(outcomes: &mut Vec<Outcome>) {
    let is_same = |a: &Outcome, b: &Outcome| {
        a.pack_id == b.pack_id
            && a.setting.series == b.setting.series
            && a.setting.look == b.setting.look
            && a.setting.by == b.setting.by
    };
    let mut kept: Vec<Outcome> = Vec::with_capacity(outcomes.len());
    for outcome in outcomes.drain(..) {
        if !kept.iter().any(|other| is_same(other, &outcome)) {
            kept.push(outcome);
        }
    }
    *outcomes = kept;
}

/// A linear picture as it is shown, clamped to [0, 1]: a highlight a thousand times brighter than white, off by a pixel, would otherwise be all
/// of the error.
fn within_white(mut picture: Picture) -> Picture {
    let values = picture.channels.iter_mut().flatten();
    values.for_each(|value| *value = value.clamp(0.0, 1.0));
    picture
}

/// The seconds that taking the time takes by itself.
pub fn seconds_of_the_clock() -> f64 {
    let reads = 1000;
    let watch = Watch::start();
    for _ in 0..reads {
        std::hint::black_box(Watch::start().read());
    }
    watch.read().wall_s / f64::from(reads)
}

impl Bytes {
    fn of(pack: &Pack) -> Self {
        let sum = |sections: &[Section]| sections.iter().map(|&section| pack.section_bytes(section)).sum();
        Self {
            pack: pack.bytes().len() as u64,
            mesh: sum(&MESH_SECTIONS) + pack.section_bytes(Section::Cells),
            tree: sum(&[Section::Slots, Section::List]),
        }
    }
}
