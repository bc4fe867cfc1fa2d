//! Single rays, and the rays behind single pixels, on a GPU: for tests that hold it to the CPU, and for tools.

use super::kernel::{Kernel as GpuKernel, Purpose};
use super::slot::{COUNT_BYTES, make_buffer};
use super::tiles::Tiles;
use super::wavefront::HEAD_BYTES;
use super::{Gpu, GpuError, GpuOptions, GpuScene};
use crate::backend::{Adapter, BackendError, cpu};
use bytemuck::{bytes_of, cast_slice};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use tessera_geometry::{Hit, Ray};
use tessera_kdtree::Kernel;
use tessera_pack::Pack;
use tessera_whitted::device::{FrameInfo, state_quads};
use tessera_whitted::{FrameParams, Needs, Renderer};
use tessera_wire::{FrameError, Rect, TileGrid, TileId};
use wgpu::{BindGroup, Buffer, BufferUsages, MapMode};

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

/// What a path's third word says behind its last step (probe.wgsl).
pub(super) const PATH_ENDED: u32 = 2;

/// Steps between two looks whether all paths have ended.
const STEPS: u32 = 32;

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

    /// Frames of one class are equal bit for bit.
    pub fn numeric_class(&self) -> &str {
        self.gpu.numeric_class()
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
            let info = bytemuck::Zeroable::zeroed();
            let words = rays.len() * 4;
            let run = Run::new(&self.scene, (Purpose::Rays, 0), &info, &input, rays.len(), (words, 0))?;
            let output = run.dispatch(1)?;
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
        let words = 3 + PROBE_WORDS * record as usize;
        let depth = params.max_depth.min(FrameParams::MAX_DEPTH);
        let state_bytes = 16 * state_quads(self.scene.path_stack(depth)) as usize;
        let most = (BYTES_MAX / 4 / words).min(BYTES_MAX / state_bytes).max(1);
        let mut paths = Vec::with_capacity(pixels.len());
        for pixels in pixels.chunks(most) {
            let mut input = vec![pixels.len() as u32, record, sample];
            input.extend(pixels.iter().flat_map(|&(x, y)| [x, y]));
            let info = FrameInfo::of(params);
            let run = Run::new(
                &self.scene,
                (Purpose::Probe, depth),
                &info,
                &input,
                pixels.len(),
                (pixels.len() * words, pixels.len() * state_bytes),
            )?;
            let output = loop {
                let output = run.dispatch(STEPS)?;
                if output.chunks_exact(words).all(|path| path[2] == PATH_ENDED) {
                    break output;
                }
            };
            paths.extend(output.chunks_exact(words).map(|words| {
                ProbedPath {
                    rays: words[0],
                    signature: words[1],
                    recorded: words[3..]
                        .chunks_exact(PROBE_WORDS)
                        .take(words[0] as usize)
                        .map(|words| std::array::from_fn(|i| words[i]))
                        .collect(),
                }
            }));
        }
        Ok(paths)
    }

    /// A whole frame, in its wire format, tile by tile as a worker renders it.
    pub fn frame(&self, frame: &tessera_wire::Frame) -> Result<(Vec<u8>, tessera_wire::Rays), GpuError> {
        let tessera_wire::Frame { width, height, tile: side, .. } = *frame;
        let side = side.max(1);
        let mut tiles = Tiles::new(self.scene.clone())?;
        let corners = (0..height.div_ceil(side)).flat_map(|y| (0..width.div_ceil(side)).map(move |x| (x, y)));
        for ((x, y), number) in corners.zip(0..) {
            let (x, y) = (x * side, y * side);
            let rect = Rect { x, y, width: side.min(width - x), height: side.min(height - y) };
            let (tile, attempt) = (TileId(number), tessera_wire::Attempt(0));
            tiles.push(crate::session::RenderTask { frame: *frame, tile, attempt, rect });
        }
        let mut rays = tessera_wire::Rays::default();
        let mut pixels = Vec::new();
        while !tiles.is_idle() {
            for done in tiles.turn()? {
                rays += done.rays;
                put(&mut pixels, (width, height), done.task.rect, &done.pixels);
            }
        }
        Ok((pixels, rays))
    }

    /// Bytes of the text of the kernels that frames are rendered with.
    pub fn kernel_bytes(&self, depth: u32) -> Result<usize, GpuError> {
        self.scene.text_bytes(depth)
    }
}

/// A kernel over some items, with its buffers.
struct Run<'a> {
    scene: &'a GpuScene,
    kernel: Arc<GpuKernel>,
    bind_group: BindGroup,
    output: Buffer,
    readback: Buffer,
    items: usize,
    words: usize,
}

impl<'a> Run<'a> {
    /// A kernel over `items` with `input`, `words` of output and so many bytes of states.
    fn new(
        scene: &'a GpuScene,
        (purpose, depth): (Purpose, u32),
        info: &FrameInfo,
        input: &[u32],
        items: usize,
        (words, state_bytes): (usize, usize),
    ) -> Result<Self, GpuError> {
        let kernel = scene.kernel(depth, purpose)?;
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let make = |label, bytes: usize, usage| make_buffer(scene, label, bytes.max(32) as u64, usage);
        let frame = make("frame", size_of::<FrameInfo>(), BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let [jobs, pixels, sums]: [Result<Buffer, GpuError>; 3] =
            std::array::from_fn(|_| make("unused", 32, storage));
        let counts = make("counts", COUNT_BYTES as usize, storage)?;
        let from = make("input", input.len() * 4, storage)?;
        // One word more, which says that loops were cut.
        let bytes = words * 4 + 4;
        let output = make_buffer(scene, "output", bytes as u64, storage)?;
        let readback = make("readback", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let states = make("states", state_bytes, storage)?;
        let waves = make("waves", HEAD_BYTES as usize + 16, storage)?;
        scene.gpu.queue().write_buffer(&frame, 0, bytes_of(info));
        scene.gpu.queue().write_buffer(&from, 0, cast_slice(input));
        scene.gpu.queue().write_buffer(&waves, 0, bytes_of(&(items as u32)));
        let own = [&frame, &jobs?, &pixels?, &sums?, &counts];
        let extra = [&from, &output, &states, &waves];
        let extra = if purpose == Purpose::Probe { &extra[..] } else { &extra[..2] };
        let bind_group = scene.bind_group(&kernel, own, extra);
        Ok(Self { scene, kernel, bind_group, output, readback, items, words })
    }

    /// Runs it so many times, and returns the output.
    fn dispatch(&self, times: u32) -> Result<Vec<u32>, GpuError> {
        let gpu = &self.scene.gpu;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.kernel.pipeline);
            pass.set_bind_group(0, &self.bind_group, &[]);
            for _ in 0..times {
                pass.dispatch_workgroups(self.items.div_ceil(64) as u32, 1, 1);
            }
        }
        let bytes = self.words as u64 * 4 + 4;
        encoder.copy_buffer_to_buffer(&self.output, 0, &self.readback, 0, bytes);
        let submission = gpu.queue().submit([encoder.finish()]);
        self.readback.map_async(MapMode::Read, ..bytes, |_| ());
        gpu.wait(submission, PATIENCE)?;
        let mut words: Vec<u32> = {
            let range = self.readback.get_mapped_range(..bytes);
            let range = range.map_err(|e| GpuError::Lost(format!("its memory cannot be read: {e}")))?;
            cast_slice(&range).to_vec()
        };
        self.readback.unmap();
        match words.pop() {
            Some(0) => Ok(words),
            _ => Err(GpuError::LoopsCut),
        }
    }
}

/// The same as [`ProbedScene::frame`] on the CPU, by the threads of the current rayon pool.
pub fn cpu_frame(pack: &Pack, kernel: Kernel, frame: &tessera_wire::Frame) -> (Vec<u8>, tessera_wire::Rays) {
    cpu_frame_with(pack, kernel, Needs::default(), frame)
}

/// [`cpu_frame`] with parts of the kernel forced in that `pack` may not need; the pixels are the same.
pub fn cpu_frame_with(
    pack: &Pack,
    kernel: Kernel,
    forced: Needs,
    frame: &tessera_wire::Frame,
) -> (Vec<u8>, tessera_wire::Rays) {
    let rect = Rect { x: 0, y: 0, width: frame.width, height: frame.height };
    // It is never stopped.
    let renderer = Renderer::with_forced(pack, kernel, forced);
    cpu::render(&renderer, frame, rect, &AtomicBool::new(false)).unwrap_or_default()
}

/// The pixels of `rect`, which lies within the frame: what a worker makes of it as one tile.
pub fn cpu_rect(
    pack: &Pack,
    kernel: Kernel,
    frame: &tessera_wire::Frame,
    rect: Rect,
) -> (Vec<u8>, tessera_wire::Rays) {
    let renderer = Renderer::with_kernel(pack, kernel);
    cpu::render(&renderer, frame, rect, &AtomicBool::new(false)).unwrap_or_default()
}

/// [`cpu_frame`] tile by tile, over the grid that the frame asks for.
///
/// # Errors
/// The frame has no such grid.
pub fn cpu_frame_by_tiles(
    pack: &Pack,
    kernel: Kernel,
    frame: &tessera_wire::Frame,
) -> Result<(Vec<u8>, tessera_wire::Rays), FrameError> {
    let grid = TileGrid::new(frame.width, frame.height, frame.tile)?;
    let (mut image, mut rays) = (Vec::new(), tessera_wire::Rays::default());
    for rect in (0..grid.tiles()).filter_map(|tile| grid.rect(TileId(tile))) {
        let (pixels, traced) = cpu_rect(pack, kernel, frame, rect);
        put(&mut image, grid.size(), rect, &pixels);
        rays += traced;
    }
    Ok((image, rays))
}

/// Copies a tile to its place in an image of this size, for which it makes room.
fn put(image: &mut Vec<u8>, (width, height): (u32, u32), rect: Rect, pixels: &[u8]) {
    let row_bytes = pixels.len() / rect.height as usize;
    let pixel_bytes = row_bytes / rect.width as usize;
    image.resize(width as usize * height as usize * pixel_bytes, 0);
    for (row, from) in (rect.y as usize..).zip(pixels.chunks_exact(row_bytes)) {
        let at = (row * width as usize + rect.x as usize) * pixel_bytes;
        image[at..][..row_bytes].copy_from_slice(from);
    }
}

/// An end of a ray as kernels take it: 'without end' is the largest number; before what is no number, nothing is hit.
fn finite(t: f32) -> f32 {
    if t.is_nan() { 0.0 } else { t.min(f32::MAX) }
}
