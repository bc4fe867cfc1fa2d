//! Single rays, and the rays behind single pixels, on a GPU: for tests that hold it to the CPU, and for tools.

use super::kernel::Purpose;
use super::tiles::{Tiles, make_buffer};
use super::{Gpu, GpuError, GpuOptions, GpuScene};
use crate::backend::{Adapter, BackendError, cpu};
use bytemuck::{bytes_of, cast_slice};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use tessera_geometry::{Hit, Ray, Vec3};
use tessera_kdtree::Kernel;
use tessera_pack::Pack;
use tessera_whitted::FrameParams;
use tessera_whitted::device::FrameInfo;
use wgpu::{Buffer, BufferUsages, MapMode};

/// An opened GPU that answers for single rays.
#[derive(Clone, Debug)]
pub struct GpuProbe {
    gpu: Gpu,
    options: GpuOptions,
}

/// A pack in its memory.
pub struct ProbedScene {
    scene: Arc<GpuScene>,
}

/// What is known of one pixel's path.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbedPath {
    /// Rays, those included that were not recorded.
    pub rays: u32,
    /// The hash of what they hit.
    pub signature: u32,
    /// The first rays, 12 words each: origin, t_min, direction, t_max, triangle to come after, kind, triangle, t.
    pub recorded: Vec<[u32; 12]>,
}

/// Words of a recorded ray.
pub(super) const PROBE_WORDS: usize = 12;

/// Bytes of one submission's input and output.
const BYTES_MAX: usize = 64 << 20;

/// For a test on a software driver with a submission of thousands of paths.
const PATIENCE: Duration = Duration::from_secs(300);

impl GpuProbe {
    /// Opens a GPU as `--gpu` names it.
    pub fn open(wanted: Option<&str>, options: GpuOptions) -> Result<Self, BackendError> {
        Gpu::open(wanted, options.f64).map(|gpu| Self { gpu, options })
    }

    /// The same GPU with other kernels; `f64` only where it was opened with it.
    pub fn with(&self, options: GpuOptions) -> Self {
        Self { gpu: self.gpu.clone(), options }
    }

    /// Which it is.
    pub fn adapter(&self) -> &Adapter {
        self.gpu.adapter()
    }

    /// Whether its kernels compute in `f64` where it matters.
    pub fn uses_f64(&self) -> bool {
        self.gpu.uses_f64() && self.options.f64
    }

    /// Uploads a pack, and waits until it is there.
    pub fn load(&self, pack: &Pack) -> Result<ProbedScene, GpuError> {
        let scene = Arc::new(GpuScene::load(&self.gpu, pack, self.options)?);
        let submission = self.gpu.queue().submit([]);
        self.gpu.wait(submission, PATIENCE)?;
        Ok(ProbedScene { scene })
    }
}

impl ProbedScene {
    /// What each ray hits first, or with `any` what it happens to hit.
    pub fn hits(&self, rays: &[Ray], any: bool) -> Result<Vec<Option<Hit>>, GpuError> {
        let mut hits = Vec::with_capacity(rays.len());
        for rays in rays.chunks(BYTES_MAX / 32) {
            let mut input = vec![rays.len() as u32, any.into()];
            for ray in rays {
                let [ox, oy, oz] = ray.origin.to_array();
                let [dx, dy, dz] = ray.direction.to_array();
                input.extend([ox, oy, oz, ray.t_min, dx, dy, dz, finite(ray.t_max)].map(f32::to_bits));
            }
            let output = self.run(
                Purpose::Rays,
                0,
                &bytemuck::Zeroable::zeroed(),
                &input,
                rays.len(),
                rays.len() * 4,
            )?;
            hits.extend(output.chunks_exact(4).map(|words| {
                let [t, b1, b2] = [words[0], words[2], words[3]].map(f32::from_bits);
                (words[1] != Hit::NO_TRIANGLE).then_some(Hit { t, triangle: words[1], b1, b2 })
            }));
        }
        Ok(hits)
    }

    /// The paths of `sample` through `pixels`, with at most `record` rays of each.
    pub fn paths(
        &self,
        params: &FrameParams,
        pixels: &[(u32, u32)],
        sample: u32,
        record: u32,
    ) -> Result<Vec<ProbedPath>, GpuError> {
        let words = 2 + PROBE_WORDS * record as usize;
        let mut paths = Vec::with_capacity(pixels.len());
        for pixels in pixels.chunks((BYTES_MAX / 4 / words).max(1)) {
            let mut input = vec![pixels.len() as u32, record, sample];
            input.extend(pixels.iter().flat_map(|&(x, y)| [x, y]));
            let info = FrameInfo::of(params);
            let depth = params.max_depth.min(FrameParams::MAX_DEPTH);
            let output =
                self.run(Purpose::Probe, depth, &info, &input, pixels.len(), pixels.len() * words)?;
            paths.extend(output.chunks_exact(words).map(|words| {
                ProbedPath {
                    rays: words[0],
                    signature: words[1],
                    recorded: words[2..]
                        .chunks_exact(PROBE_WORDS)
                        .take(words[0] as usize)
                        .map(|words| std::array::from_fn(|i| words[i]))
                        .collect(),
                }
            }));
        }
        Ok(paths)
    }

    /// A whole frame, in its wire format, as a worker renders it.
    pub fn frame(&self, frame: &tessera_wire::Frame) -> Result<(Vec<u8>, tessera_wire::Rays), GpuError> {
        let rect = tessera_wire::Rect { x: 0, y: 0, width: frame.width, height: frame.height };
        let (tile, attempt) = (tessera_wire::TileId(0), tessera_wire::Attempt(0));
        let mut tiles = Tiles::new(self.scene.clone())?;
        tiles.push(crate::session::RenderTask { frame: *frame, tile, attempt, rect });
        loop {
            if let Some(done) = tiles.turn()?.pop() {
                return Ok((done.pixels, done.rays));
            }
        }
    }

    /// Bytes of the text of the kernels that its work so far has needed.
    pub fn kernel_bytes(&self) -> usize {
        self.scene.text_bytes()
    }

    /// Runs a kernel over `count` items with `input`, and returns `words` of output.
    fn run(
        &self,
        purpose: Purpose,
        depth: u32,
        info: &FrameInfo,
        input: &[u32],
        count: usize,
        words: usize,
    ) -> Result<Vec<u32>, GpuError> {
        let GpuScene { gpu, .. } = &*self.scene;
        let kernel = self.scene.kernel(depth, purpose)?;
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let make = |label, bytes: usize, usage| make_buffer(&self.scene, label, bytes.max(32) as u64, usage);
        let frame = make("frame", size_of::<FrameInfo>(), BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let [jobs, pixels, sums, counts]: [Result<Buffer, GpuError>; 4] =
            std::array::from_fn(|_| make("unused", 32, storage));
        let from = make("input", input.len() * 4, storage)?;
        let to = make("output", words * 4, storage)?;
        let readback = make("readback", words * 4, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        gpu.queue().write_buffer(&frame, 0, bytes_of(info));
        gpu.queue().write_buffer(&from, 0, cast_slice(input));
        let own = [&frame, &jobs?, &pixels?, &sums?, &counts?];
        let bind_group = self.scene.bind_group(&kernel, own, &[&from, &to]);
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&kernel.pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups(count.div_ceil(64) as u32, 1, 1);
        }
        let bytes = words as u64 * 4;
        encoder.copy_buffer_to_buffer(&to, 0, &readback, 0, bytes);
        let submission = gpu.queue().submit([encoder.finish()]);
        readback.map_async(MapMode::Read, ..bytes, |_| ());
        gpu.wait(submission, PATIENCE)?;
        let range = readback.get_mapped_range(..bytes);
        let range = range.map_err(|e| GpuError::Lost(format!("its memory cannot be read: {e}")))?;
        Ok(cast_slice(&range).to_vec())
    }
}

/// The same as [`ProbedScene::frame`] on the CPU, by the threads of the current rayon pool.
pub fn cpu_frame(pack: &Pack, kernel: Kernel, frame: &tessera_wire::Frame) -> (Vec<u8>, tessera_wire::Rays) {
    let rect = tessera_wire::Rect { x: 0, y: 0, width: frame.width, height: frame.height };
    // It is never stopped.
    cpu::render(pack, kernel, frame, rect, &AtomicBool::new(false)).unwrap_or_default()
}

/// An end of a ray as kernels take it: 'without end' is the largest number; before what is no number, nothing is hit.
fn finite(t: f32) -> f32 {
    if t.is_nan() { 0.0 } else { t.min(f32::MAX) }
}

/// A recorded ray's origin and direction.
pub fn ray_of(words: &[u32; 12]) -> Ray {
    let [ox, oy, oz, t_min, dx, dy, dz, t_max] = std::array::from_fn(|i| f32::from_bits(words[i]));
    let t_max = if t_max == f32::MAX { f32::INFINITY } else { t_max };
    Ray { origin: Vec3::new(ox, oy, oz), direction: Vec3::new(dx, dy, dz), t_min, t_max }
}
