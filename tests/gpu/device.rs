//! The GPU itself.

use super::Other;
use super::judge::TBound;
use std::sync::{Arc, Mutex};
use tessera_geometry::{Hit, Ray};
use tessera_pack::{Pack, PackId};
use tessera_whitted::{FrameParams, PixelFormat, Probe};
use tessera_wire::{Camera, Features, Frame, FrameId, ReturnMode};
use tessera_worker::gpu::GpuOptions;
use tessera_worker::gpu::probe::{GpuProbe, ProbedPath, ProbedScene};

/// An adapter with a way to compute, and the scene that it holds.
pub struct Device {
    probe: GpuProbe,
    held: Mutex<Option<(PackId, Arc<ProbedScene>)>>,
}

impl Device {
    /// The best adapter; with `f64` as far as it has it, or without.
    pub fn open(f64: bool) -> Result<Self, String> {
        let options = GpuOptions { f64, ..GpuOptions::default() };
        let probe = GpuProbe::open(None, options).map_err(|e| e.to_string())?;
        Ok(Self { probe, held: Mutex::new(None) })
    }

    fn scene(&self, pack: &Pack) -> Arc<ProbedScene> {
        let mut held = self.held.lock().expect("no test panics in here");
        match &*held {
            Some((id, scene)) if *id == pack.id() => scene.clone(),
            _ => {
                let scene = Arc::new(self.probe.load(pack).expect("the GPU holds the scene"));
                *held = Some((pack.id(), scene.clone()));
                scene
            }
        }
    }

    fn paths(
        &self,
        pack: &Pack,
        params: &FrameParams,
        pixels: &[(u32, u32)],
        record: u32,
    ) -> Vec<ProbedPath> {
        self.scene(pack).paths(params, pixels, 0, record).expect("the GPU works")
    }
}

impl Other for Device {
    fn name(&self) -> String {
        let precision = if self.probe.uses_f64() { "f64" } else { "f32" };
        format!("{} ({}), {precision}", self.probe.adapter().name, self.probe.adapter().driver)
    }

    fn t_bound(&self) -> TBound {
        if self.probe.uses_f64() { TBound::DOUBLE } else { TBound::SINGLE }
    }

    fn is_device(&self) -> bool {
        true
    }

    fn is_exact(&self) -> bool {
        self.probe.uses_f64()
    }

    fn triangles_max(&self) -> u32 {
        if self.probe.adapter().kind == "software" { 300_000 } else { u32::MAX }
    }

    fn frame(&self, pack: &Pack, params: &FrameParams) -> Vec<u8> {
        let frame = wire_frame(pack, params);
        self.scene(pack).frame(&frame).expect("the GPU works").0
    }

    fn signatures(&self, pack: &Pack, params: &FrameParams) -> Vec<u32> {
        let pixels: Vec<_> =
            (0..params.height).flat_map(|y| (0..params.width).map(move |x| (x, y))).collect();
        self.paths(pack, params, &pixels, 0).into_iter().map(|path| path.signature).collect()
    }

    fn probes(&self, pack: &Pack, params: &FrameParams, pixels: &[(u32, u32)]) -> Vec<Vec<Probe>> {
        let most = self.paths(pack, params, pixels, 0).iter().map(|path| path.rays).max().unwrap_or(0);
        let paths = self.paths(pack, params, pixels, most);
        paths
            .into_iter()
            .map(|path| {
                path.recorded
                    .iter()
                    .map(|words| {
                        let probe: Probe = bytemuck::cast(*words);
                        // What a kernel takes for 'without end'.
                        let t_max = if probe.t_max == f32::MAX { f32::INFINITY } else { probe.t_max };
                        Probe { t_max, ..probe }
                    })
                    .collect()
            })
            .collect()
    }

    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Vec<Option<Hit>> {
        self.scene(pack).hits(rays, false).expect("the GPU works")
    }
}

fn wire_sampling(sampling: tessera_whitted::Sampling) -> tessera_wire::Sampling {
    tessera_wire::Sampling {
        sampler: match sampling.sampler {
            tessera_whitted::Sampler::Jittered => tessera_wire::Sampler::Jittered,
            tessera_whitted::Sampler::LowDiscrepancy => tessera_wire::Sampler::LowDiscrepancy,
        },
        cutoff: sampling.cutoff,
        adaptive: sampling.adaptive.map(|a| tessera_wire::Adaptive { error: a.error }),
    }
}

/// `params` as a master would ask for them.
pub fn wire_frame(pack: &Pack, params: &FrameParams) -> Frame {
    let FrameParams { camera, features, .. } = params;
    Frame {
        frame: FrameId(1),
        pack: tessera_wire::PackId(pack.id().0),
        camera: Camera {
            origin: camera.origin.into(),
            forward: camera.forward.into(),
            right: camera.right.into(),
            up: camera.up.into(),
        },
        width: params.width,
        height: params.height,
        tile: params.width.max(params.height),
        samples: params.samples,
        sampling: wire_sampling(params.sampling),
        depth: params.max_depth,
        seed: params.frame,
        features: Features {
            shadows: features.shadows,
            reflection: features.reflection,
            refraction: features.refraction,
        },
        format: match params.format {
            PixelFormat::Rgba8 => tessera_wire::PixelFormat::Rgba8,
            PixelFormat::Rgba16 => tessera_wire::PixelFormat::Rgba16,
            PixelFormat::Layers => tessera_wire::PixelFormat::Layers,
        },
        returns: ReturnMode::AtEnd,
        coding: tessera_wire::Coding::Raw,
    }
}
