//! How fast a backend is: a small scene of our own, so that backends and machines can be compared before there is any other.
//!
//! Hills under a lamp, of a material that reflects a little: a ray from the eye, one to the lamp and, for most pixels, one or two more off
//! the hills. What a real scene makes of a machine differs; which of two backends is the faster seldom does.

use super::cpu;
use super::gpu::tiles::Tiles;
use super::gpu::{Gpu, GpuError, GpuOptions, GpuScene};
use crate::session::RenderTask;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use tessera_geometry::{CameraPose, DVec3};
use tessera_kdtree::Kernel;
use tessera_pack::{Light, LightKind, Material, Pack, PackInput, PackOptions, build_pack};
use tessera_whitted::Renderer;
use tessera_wire::{
    Attempt, Camera, Coding, Features, Frame, FrameId, PackId, PixelFormat, Rays, Rect, ReturnMode, TileId,
};

/// Quads along each side of the hills.
const QUADS: u32 = 48;

/// Sides of the tile: at first, and for devices that take too short a time for that.
const SIDES: [u32; 3] = [64, 256, 1024];

/// Long enough for the clock and for the start of threads.
const LONG_ENOUGH: Duration = Duration::from_millis(3);

/// Long enough for the latency of some tens of dispatches and of a readback.
const LONG_ENOUGH_GPU: Duration = Duration::from_millis(20);

fn scene() -> Option<Pack> {
    let at = |i: u32, j: u32| {
        let [x, z] = [i, j].map(|k| f64::from(k) / f64::from(QUADS) * 4.0 - 2.0);
        [x, 0.25 * (libm::sin(3.0 * x) * libm::cos(2.5 * z) + 0.5 * libm::sin(7.0 * x + 5.0 * z)), z]
    };
    let row = QUADS + 1;
    let positions = (0..row * row).map(|v| at(v / row, v % row)).collect();
    let quads = (0..QUADS).flat_map(|i| (0..QUADS).map(move |j| i * row + j));
    let triangles = quads.flat_map(|v| [[v, v + 1, v + row], [v + row, v + 1, v + row + 1]]).collect();
    let lamp = Light {
        position: [1.0, 3.0, 1.5],
        kind: LightKind::Point as u32,
        direction: [0.0, -1.0, 0.0],
        range: f32::INFINITY,
        intensity: [20.0; 3],
        cos_inner: 1.0,
        cos_outer: 0.0,
        reserved: [0; 3],
    };
    let input = PackInput {
        positions,
        triangles,
        material_runs: vec![(0, 0)],
        materials: vec![Material { roughness: 0.2, ..Material::default() }],
        lights: vec![lamp],
        ..PackInput::default()
    };
    build_pack(input, &PackOptions::default()).ok().map(|(pack, _)| pack)
}

/// A square tile of `side` pixels.
fn task(pack: &Pack, side: u32) -> Option<RenderTask> {
    let pose = CameraPose {
        eye: DVec3::new(-1.2, 1.6, 2.6),
        target: DVec3::new(0.0, -0.1, 0.0),
        up: CameraPose::DEFAULT_UP,
        fov_degrees: 50.0,
    };
    let local = pose.to_local(&pack.frame(), side, side).ok()?;
    let camera = Camera {
        origin: local.origin.into(),
        forward: local.forward.into(),
        right: local.right.into(),
        up: local.up.into(),
    };
    Some(task_of(PackId(pack.id().0), camera, side))
}

/// A frame of one square tile of `side` pixels.
pub(super) fn task_of(pack: PackId, camera: Camera, side: u32) -> RenderTask {
    let frame = Frame {
        frame: FrameId(1),
        pack,
        camera,
        width: side,
        height: side,
        tile: side,
        samples: 1,
        sampling: Default::default(),
        depth: 3,
        seed: 0,
        features: Features::default(),
        format: PixelFormat::Rgba8,
        returns: ReturnMode::AtEnd,
        coding: Coding::Raw,
    };
    let rect = Rect { x: 0, y: 0, width: side, height: side };
    RenderTask { frame, tile: TileId(0), attempt: Attempt(0), rect }
}

/// Rays a second by `render`, which takes a tile and says how many rays it had; the first size that takes long enough counts, the
/// better of two runs. At least 1.
fn speed<E>(
    pack: &Pack,
    long_enough: Duration,
    mut render: impl FnMut(RenderTask) -> Result<u64, E>,
) -> Result<u64, E> {
    let mut best = 1.0f64;
    for side in SIDES {
        let Some(task) = task(pack, side) else { break };
        let mut shortest = Duration::MAX;
        for _ in 0..2 {
            let begun = Instant::now();
            let rays = render(task)?;
            let took = begun.elapsed();
            shortest = shortest.min(took);
            best = best.max(rays as f64 / took.as_secs_f64().max(1e-9));
        }
        if shortest >= long_enough {
            break;
        }
    }
    Ok(best as u64)
}

fn count(rays: &Rays) -> u64 {
    rays.primary + rays.shadow + rays.reflection + rays.refraction
}

/// Rays a second of all cores.
pub(super) fn cpu(kernel: Kernel) -> u64 {
    let Some(pack) = scene() else { return 1 };
    let renderer = Renderer::with_kernel(&pack, kernel);
    let measured = speed(&pack, LONG_ENOUGH, |task| {
        let rendered = cpu::render(&renderer, &task.frame, task.rect, &AtomicBool::new(false));
        Ok::<_, std::convert::Infallible>(rendered.map_or(0, |(_, rays)| count(&rays)))
    });
    match measured {
        Ok(speed) => speed,
    }
}

/// Rays a second of a GPU, its kernels compiled before. Also a proof that it works at all.
///
/// Every worker takes the same form, the wavefront: on a device that fuses products and sums at its compiler's pleasure two forms might differ
/// in a last bit, and a class is one arithmetic.
pub(super) fn gpu(gpu: &Gpu) -> Result<u64, GpuError> {
    let Some(pack) = scene() else { return Ok(1) };
    let scene = Arc::new(GpuScene::load(gpu, &pack, GpuOptions::default())?);
    let mut tiles = Tiles::new(scene)?;
    let mut render = |task| {
        tiles.push(task);
        loop {
            if let Some(done) = tiles.turn()?.pop() {
                return Ok(count(&done.rays));
            }
        }
    };
    if let Some(first) = task(&pack, 8) {
        render(first)?;
    }
    speed(&pack, LONG_ENOUGH_GPU, render)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_has_every_kind_of_ray_but_refraction() {
        let pack = scene().expect("it packs");
        let task = task(&pack, 64).expect("a usable pose");
        let (pixels, rays) =
            cpu::render(&Renderer::new(&pack), &task.frame, task.rect, &AtomicBool::new(false))
                .expect("not stopped");
        assert_eq!((pixels.len(), rays.primary), (64 * 64 * 4, 64 * 64));
        assert!(rays.shadow > 1000 && rays.reflection > 500, "{rays:?}");
        assert!(cpu(Kernel::auto()) > 1);
    }
}
