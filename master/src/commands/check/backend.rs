//! Everything that renders here, behind one trait: the CPU ray by ray and eight at once, and a GPU.

use rayon::prelude::*;
use std::cell::RefCell;
use std::rc::Rc;
use tessera_geometry::wide::{ALL_LANES, LANES};
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_master::{FrameJob, PixelFormat};
use tessera_pack::{Pack, PackId};
use tessera_whitted::stage::{Layers, View, decode};
use tessera_wire::{Features, Frame, FrameId};
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::{GpuProbe, ProbedScene, cpu_frame_by_tiles};
use tessera_worker::{Kernel, NUMERIC_CLASS};

/// How arithmetic rounds, beside that of the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rounding {
    /// The same operations on the same numbers.
    Exact,
    /// A GPU that decides in `f64`, whose compiler may fuse operations: the same triangles, at distances that may be two roundoffs off.
    Double,
    /// A GPU without `f64`.
    Single,
}

/// Something that traces rays and renders frames.
pub trait Renders {
    /// For people.
    fn name(&self) -> String;

    /// For programs.
    fn numeric_class(&self) -> String;

    /// How its arithmetic rounds.
    fn rounding(&self) -> Rounding;

    /// Whether its pictures are the CPU's in every bit.
    fn is_exact(&self) -> bool {
        self.rounding() == Rounding::Exact
    }

    /// Whether it is a GPU played by the CPU.
    fn is_software(&self) -> bool {
        false
    }

    /// The nearest hit of each ray.
    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<Option<Hit>>, String>;

    /// Whether each ray hits anything before its end.
    fn any_hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<bool>, String>;

    /// A frame in its wire format, tile by tile.
    fn frame(&self, pack: &Pack, frame: &Frame) -> Result<Vec<u8>, String>;
}

impl dyn Renders + '_ {
    /// What a view of a scene looks like, as numbers.
    pub fn layers(&self, pack: &Pack, view: &View) -> Result<Vec<Layers>, String> {
        self.bytes(pack, view, PixelFormat::Layers).map(|bytes| decode(&bytes))
    }

    /// The only pixel of a view.
    pub fn pixel(&self, pack: &Pack, view: &View) -> Result<Layers, String> {
        self.layers(pack, view)?.first().copied().ok_or_else(|| "an empty frame".into())
    }

    /// What a view of a scene looks like, in a wire format.
    pub fn bytes(&self, pack: &Pack, view: &View, format: PixelFormat) -> Result<Vec<u8>, String> {
        self.frame(pack, &frame_of(pack, view, format, 0)?)
    }

    /// The nearest hit of each ray; an error where there is not one answer a ray.
    pub fn hits_of(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<Option<Hit>>, String> {
        let hits = self.hits(pack, rays)?;
        if hits.len() == rays.len() {
            Ok(hits)
        } else {
            Err(format!("{} answers for {} rays", hits.len(), rays.len()))
        }
    }
}

/// What a view asks for, of the samples of this `seed`.
pub fn frame_of(pack: &Pack, view: &View, format: PixelFormat, seed: u64) -> Result<Frame, String> {
    let View { pose, width, height, samples, max_depth, features, .. } = *view;
    let job = FrameJob {
        tile: width.max(height),
        samples,
        depth: max_depth,
        seed,
        features: Features {
            shadows: features.shadows,
            reflection: features.reflection,
            refraction: features.refraction,
        },
        format,
        ..FrameJob::new(
            pose.to_local(&pack.frame(), width, height).map_err(|e| e.to_string())?,
            width,
            height,
        )
    };
    let frame = job.to_wire(FrameId(1), tessera_wire::PackId(pack.id().0));
    frame.check().map_err(|e| e.to_string())?;
    Ok(frame)
}

/// The CPU's kernels.
pub fn cpus() -> Vec<Box<dyn Renders>> {
    vec![Box::new(Cpu(Kernel::Scalar)), Box::new(Cpu(Kernel::wide()))]
}

/// A GPU as `--gpu` names it.
pub fn gpu(wanted: Option<&str>) -> Result<Box<dyn Renders>, String> {
    let probe = GpuProbe::open(wanted, GpuOptions::default()).map_err(|e| e.to_string())?;
    Ok(Box::new(Gpu { probe, held: RefCell::new(None) }))
}

/// The CPU with one of its kernels.
struct Cpu(Kernel);

impl Renders for Cpu {
    fn name(&self) -> String {
        format!("CPU, {}", self.0.name())
    }

    fn numeric_class(&self) -> String {
        NUMERIC_CLASS.into()
    }

    fn rounding(&self) -> Rounding {
        Rounding::Exact
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<Option<Hit>>, String> {
        let (tree, mesh) = (pack.tree(), pack.mesh());
        let packets = rays.par_chunks(LANES).flat_map_iter(|some| {
            let packet = packet(some);
            tree.closest_hits(self.0, &mesh, &packet, ALL_LANES).into_iter().take(some.len())
        });
        Ok(packets.collect())
    }

    fn any_hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<bool>, String> {
        let (tree, mesh) = (pack.tree(), pack.mesh());
        let packets = rays.par_chunks(LANES).flat_map_iter(|some| {
            let hit = tree.any_hits(self.0, &mesh, &packet(some), ALL_LANES);
            (0..some.len()).map(move |lane| hit >> lane & 1 == 1)
        });
        Ok(packets.collect())
    }

    fn frame(&self, pack: &Pack, frame: &Frame) -> Result<Vec<u8>, String> {
        cpu_frame_by_tiles(pack, self.0, frame).map(|(pixels, _)| pixels).map_err(|e| e.to_string())
    }
}

/// Eight of up to eight rays; those that are missing hit nothing.
pub fn packet(rays: &[Ray]) -> [Ray; LANES] {
    let idle = Ray { origin: Vec3::ZERO, direction: Vec3::ZERO, t_min: 0.0, t_max: 0.0 };
    std::array::from_fn(|lane| rays.get(lane).copied().unwrap_or(idle))
}

/// A GPU, and the scene that it holds.
struct Gpu {
    probe: GpuProbe,
    held: RefCell<Option<(PackId, Rc<ProbedScene>)>>,
}

impl Gpu {
    fn scene(&self, pack: &Pack) -> Result<Rc<ProbedScene>, String> {
        let held =
            self.held.borrow().as_ref().filter(|(id, _)| *id == pack.id()).map(|(_, scene)| scene.clone());
        if let Some(scene) = held {
            return Ok(scene);
        }
        // The one before makes room first.
        *self.held.borrow_mut() = None;
        let scene = Rc::new(self.probe.load(pack).map_err(|e| e.to_string())?);
        *self.held.borrow_mut() = Some((pack.id(), scene.clone()));
        Ok(scene)
    }
}

impl Renders for Gpu {
    fn name(&self) -> String {
        let precision = if self.probe.uses_f64() { "f64" } else { "f32" };
        let adapter = self.probe.adapter();
        format!("GPU {}, {} ({}), {precision}", adapter.index, adapter.name, adapter.driver)
    }

    fn numeric_class(&self) -> String {
        self.probe.numeric_class().into()
    }

    fn rounding(&self) -> Rounding {
        if self.probe.uses_f64() { Rounding::Double } else { Rounding::Single }
    }

    fn is_software(&self) -> bool {
        self.probe.adapter().kind == "software"
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<Option<Hit>>, String> {
        self.scene(pack)?.hits(rays, false).map_err(|e| e.to_string())
    }

    fn any_hits(&self, pack: &Pack, rays: &[Ray]) -> Result<Vec<bool>, String> {
        let hits = self.scene(pack)?.hits(rays, true).map_err(|e| e.to_string())?;
        Ok(hits.iter().map(Option::is_some).collect())
    }

    fn frame(&self, pack: &Pack, frame: &Frame) -> Result<Vec<u8>, String> {
        self.scene(pack)?.frame(frame).map(|(pixels, _)| pixels).map_err(|e| e.to_string())
    }
}
