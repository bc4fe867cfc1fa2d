//! Tiles on their way: cut into submissions, awaited, read back.
//!
//! Two submissions are under way at a time: while the pixels of one are read back and returned, the device computes the next. Nobody waits
//! for the device between tiles.

use super::kernel::{GROUP_SIDE, Purpose, SLOT_BINDING};
use super::pass::{Cut, Piece};
use super::scene::Kernel;
use super::{GpuError, GpuScene};
use crate::backend::cpu;
use crate::session::{RenderTask, RenderedTile};
use bytemuck::{bytes_of, cast_slice};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tessera_whitted::device::{FrameInfo, Job, encode_rgba16, words_per_pixel};
use tessera_whitted::{FrameParams, PixelFormat};
use tessera_wire::Rays;
use wgpu::{
    BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages, MapMode, SubmissionIndex,
};

/// Submissions under way at a time.
const UNDER_WAY: usize = 2;

/// Tiles in one submission at most.
const JOBS: usize = 256;

/// How long a submission should take: long against the tens of microseconds that it costs, short against the 2 s after which systems
/// take a GPU for hung.
const TARGET: Duration = Duration::from_millis(100);

/// After so long without an answer the device is taken for hung: hundreds of times the target.
const PATIENCE: Duration = Duration::from_secs(60);

/// Samples of a submission: bounds, and what to begin with on a real GPU and on a software driver.
const BUDGET_MIN: u64 = 1 << 12;
const BUDGET_MAX: u64 = 1 << 24;
const BUDGET_GPU: u64 = 1 << 20;
const BUDGET_SOFTWARE: u64 = 1 << 14;

/// Renders tiles of one scene.
pub(crate) struct Tiles {
    scene: Arc<GpuScene>,
    /// Tiles that are not finished, in their order.
    waiting: VecDeque<Waiting>,
    under_way: VecDeque<UnderWay>,
    free: Vec<Slot>,
    sums: Buffer,
    /// Samples of the next submission.
    budget: u64,
    /// When the last submission was found done.
    last_done: Instant,
    /// Number of the first tile in `waiting`.
    first: u64,
}

struct Waiting {
    task: RenderTask,
    params: FrameParams,
    cut: Cut,
    pixels: Vec<u8>,
    rays: Rays,
    time: Duration,
    /// Pieces under way.
    pieces: u32,
}

struct UnderWay {
    slot: Slot,
    submission: SubmissionIndex,
    begun: Instant,
    samples: u64,
    /// Whether the budget ended it, and not the work.
    is_full: bool,
    words: u64,
    parts: Vec<Part>,
}

/// A piece of a tile in a submission.
struct Part {
    tile: u64,
    piece: Piece,
    at_pixels: u64,
    /// Whether its pixels are made.
    is_last: bool,
}

/// Buffers of one submission.
struct Slot {
    frame: Buffer,
    jobs: Buffer,
    counts: Buffer,
    pixels: Buffer,
    readback: Buffer,
}

/// Bytes of the counts of a submission's jobs.
const COUNT_BYTES: u64 = JOBS as u64 * 16;

impl Tiles {
    /// No tiles yet.
    pub(crate) fn new(scene: Arc<GpuScene>) -> Result<Self, GpuError> {
        let budget = if scene.gpu.is_software() { BUDGET_SOFTWARE } else { BUDGET_GPU };
        let sums = make_sums(&scene, 1)?;
        let free = (0..UNDER_WAY).map(|_| Slot::new(&scene)).collect::<Result<_, _>>()?;
        Ok(Self {
            scene,
            waiting: VecDeque::new(),
            under_way: VecDeque::new(),
            free,
            sums,
            budget,
            last_done: Instant::now(),
            first: 0,
        })
    }

    /// The scene that is rendered.
    pub(crate) fn scene(&self) -> &GpuScene {
        &self.scene
    }

    /// Whether there is nothing to do.
    pub(crate) fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.under_way.is_empty()
    }

    /// Takes a tile on.
    pub(crate) fn push(&mut self, task: RenderTask) {
        let params = cpu::params(&task.frame);
        // `Frame::check` bounds a tile's bytes by `limits::TILE_BYTES`.
        let bytes = task.rect.width as usize * task.rect.height as usize * params.format.bytes_per_pixel();
        self.waiting.push_back(Waiting {
            task,
            params,
            cut: Cut::new(task.rect, params.samples),
            pixels: vec![0; bytes],
            rays: Rays::default(),
            time: Duration::ZERO,
            pieces: 0,
        });
    }

    /// Forgets every tile; those that are being computed come to nothing.
    pub(crate) fn clear(&mut self) -> Vec<RenderTask> {
        self.first += self.waiting.len() as u64;
        self.waiting.drain(..).map(|waiting| waiting.task).collect()
    }

    /// Keeps the device busy, and returns tiles that are finished; waits for the oldest submission if nothing else is to be done.
    pub(crate) fn turn(&mut self) -> Result<Vec<RenderedTile>, GpuError> {
        while !self.free.is_empty() && self.submit()? {}
        if let Some(done) = self.under_way.pop_front() {
            self.take_in(done)?;
        }
        // While the tiles that this has finished are returned, the device goes on.
        while !self.free.is_empty() && self.submit()? {}
        let mut finished = Vec::new();
        while self.waiting.front().is_some_and(|tile| tile.cut.is_done() && tile.pieces == 0) {
            let Some(Waiting { task, pixels, rays, time, .. }) = self.waiting.pop_front() else { break };
            self.first += 1;
            finished.push(RenderedTile { task, pixels, time, rays });
        }
        Ok(finished)
    }

    /// Submits as much as is due; false when nothing is left to submit.
    fn submit(&mut self) -> Result<bool, GpuError> {
        let Some(start) = self.waiting.iter().position(|tile| !tile.cut.is_done()) else { return Ok(false) };
        let Some(slot) = self.free.pop() else { return Ok(false) };
        let params = self.waiting[start].params;
        let words_each = u64::from(words_per_pixel(params.format));
        let (mut jobs, mut parts): (Vec<Job>, Vec<Part>) = Default::default();
        let (mut samples, mut words, mut sums, mut groups, mut is_full) = (0, 0, 1, 1, false);

        // Collect pieces of tiles of one frame until the budget is used up.
        for (index, tile) in self.waiting.iter_mut().enumerate().skip(start) {
            let Waiting { task, cut, params: tile_params, pieces, .. } = tile;
            if *tile_params != params || jobs.len() == JOBS {
                break;
            }
            let left = self.budget.saturating_sub(samples);
            if !jobs.is_empty() && !cut.fits(left) {
                is_full = true;
                break;
            }
            let Some(piece) = cut.next(left) else { continue };
            let Piece { row, rows, samples: (first_sample, end_sample) } = piece;
            let (rect, pixels) = (task.rect, u64::from(task.rect.width) * u64::from(rows));
            let is_last = end_sample == params.samples.max(1);
            let is_whole = is_last && first_sample == 0;
            jobs.push(Job {
                x: rect.x,
                y: rect.y + row,
                width: rect.width,
                height: rows,
                first_sample,
                end_sample,
                at_pixels: words as u32,
                at_sums: 0,
            });
            parts.push(Part { tile: self.first + index as u64, piece, at_pixels: words, is_last });
            *pieces += 1;
            samples += pixels * u64::from(end_sample - first_sample);
            groups = rect.width.div_ceil(GROUP_SIDE).saturating_mul(rows.div_ceil(GROUP_SIDE)).max(groups);
            if is_last {
                words += pixels * words_each;
            }
            if !is_whole {
                // Its sums are those of this submission alone.
                sums = pixels;
                is_full = true;
                break;
            }
            if !cut.is_done() {
                is_full = true;
                break;
            }
        }
        let depth = params.max_depth.min(FrameParams::MAX_DEPTH);
        let kernel = self.scene.kernel(depth, Purpose::Render)?;
        if sums * 16 > self.sums.size() {
            self.sums = make_sums(&self.scene, sums)?;
        }
        let slot = slot.for_words(&self.scene, words)?;
        let begun = Instant::now();
        let submission = self.encode(&slot, &kernel, &params, &jobs, groups, words);
        self.scene.gpu.check()?;
        self.under_way.push_back(UnderWay { slot, submission, begun, samples, is_full, words, parts });
        Ok(true)
    }

    fn encode(
        &self,
        slot: &Slot,
        kernel: &Kernel,
        params: &FrameParams,
        jobs: &[Job],
        groups: u32,
        words: u64,
    ) -> SubmissionIndex {
        let GpuScene { gpu, .. } = &*self.scene;
        gpu.queue().write_buffer(&slot.frame, 0, bytes_of(&FrameInfo::of(params)));
        gpu.queue().write_buffer(&slot.jobs, 0, cast_slice(jobs));
        let own = [&slot.frame, &slot.jobs, &slot.pixels, &self.sums, &slot.counts];
        let bind_group = self.scene.bind_group(kernel, own, &[]);
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        encoder.clear_buffer(&slot.counts, 0, None);
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&kernel.pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups(groups, jobs.len() as u32, 1);
        }
        encoder.copy_buffer_to_buffer(&slot.counts, 0, &slot.readback, 0, COUNT_BYTES);
        if words > 0 {
            encoder.copy_buffer_to_buffer(&slot.pixels, 0, &slot.readback, COUNT_BYTES, words * 4);
        }
        let submission = gpu.queue().submit([encoder.finish()]);
        // Whether it could be mapped shows when the range is asked for.
        slot.readback.map_async(MapMode::Read, ..COUNT_BYTES + words * 4, |_| ());
        submission
    }

    /// Waits for a submission and takes its pixels.
    fn take_in(&mut self, done: UnderWay) -> Result<(), GpuError> {
        let UnderWay { slot, submission, begun, samples, is_full, words, parts } = done;
        self.scene.gpu.wait(submission, PATIENCE)?;
        let now = Instant::now();
        let took = now - begun.max(self.last_done);
        self.last_done = now;
        if took > TARGET * 2 {
            self.budget = (self.budget / 2).max(BUDGET_MIN);
        } else if is_full && took < TARGET / 2 {
            self.budget = (self.budget * 2).min(BUDGET_MAX);
        }
        {
            let range = slot.readback.get_mapped_range(..COUNT_BYTES + words * 4);
            let range = range.map_err(|e| GpuError::Lost(format!("its memory cannot be read: {e}")))?;
            let (counts, pixels): (&[u32], &[u32]) = {
                let all: &[u32] = cast_slice(&range);
                all.split_at(COUNT_BYTES as usize / 4)
            };
            for (part, counts) in parts.iter().zip(counts.chunks_exact(4)) {
                // A tile that was forgotten meanwhile has a number before those that are waiting.
                let Some(index) = part.tile.checked_sub(self.first) else { continue };
                let Some(tile) = self.waiting.get_mut(index as usize) else { continue };
                tile.pieces -= 1;
                tile.rays.primary += u64::from(counts[0]);
                tile.rays.shadow += u64::from(counts[1]);
                tile.rays.reflection += u64::from(counts[2]);
                tile.rays.refraction += u64::from(counts[3]);
                let Piece { row, rows, samples: (first, end) } = part.piece;
                let of_it = u64::from(tile.task.rect.width) * u64::from(rows);
                let share = of_it as f64 * f64::from(end - first) / samples.max(1) as f64;
                tile.time += took.mul_f64(share);
                if part.is_last {
                    let format = tile.params.format;
                    let words = (of_it * u64::from(words_per_pixel(format))) as usize;
                    let from = &pixels[part.at_pixels as usize..][..words];
                    let bytes = format.bytes_per_pixel();
                    let start = row as usize * tile.task.rect.width as usize * bytes;
                    write_pixels(format, from, &mut tile.pixels[start..][..of_it as usize * bytes]);
                }
            }
        }
        slot.readback.unmap();
        self.free.push(slot);
        Ok(())
    }
}

/// A device's words as a frame's pixels.
pub(super) fn write_pixels(format: PixelFormat, words: &[u32], pixels: &mut [u8]) {
    match format {
        PixelFormat::Rgba8 | PixelFormat::Layers => pixels.copy_from_slice(cast_slice(words)),
        PixelFormat::Rgba16 => {
            for (words, pixel) in words.chunks_exact(4).zip(pixels.chunks_exact_mut(8)) {
                let [r, g, b, a] = [words[0], words[1], words[2], words[3]].map(f32::from_bits);
                pixel.copy_from_slice(&encode_rgba16([r, g, b], a));
            }
        }
    }
}

fn make_sums(scene: &GpuScene, pixels: u64) -> Result<Buffer, GpuError> {
    make_buffer(scene, "sums", pixels * 16, BufferUsages::STORAGE)
}

pub(super) fn make_buffer(
    scene: &GpuScene,
    label: &'static str,
    size: u64,
    usage: BufferUsages,
) -> Result<Buffer, GpuError> {
    scene.gpu.try_make(|| {
        scene.gpu.device().create_buffer(&BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    })
}

impl Slot {
    fn new(scene: &GpuScene) -> Result<Self, GpuError> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        Ok(Self {
            frame: make_buffer(
                scene,
                "frame",
                size_of::<FrameInfo>() as u64,
                BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            )?,
            jobs: make_buffer(scene, "jobs", (JOBS * size_of::<Job>()) as u64, storage)?,
            counts: make_buffer(scene, "counts", COUNT_BYTES, storage | BufferUsages::COPY_SRC)?,
            pixels: make_buffer(scene, "pixels", 4, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?,
            readback: make_buffer(
                scene,
                "readback",
                COUNT_BYTES,
                BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            )?,
        })
    }

    /// With room for so many words of pixels.
    fn for_words(mut self, scene: &GpuScene, words: u64) -> Result<Self, GpuError> {
        let bytes = words * 4;
        if bytes > self.pixels.size() {
            let size = bytes.next_power_of_two();
            self.pixels = make_buffer(scene, "pixels", size, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
            let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
            self.readback = make_buffer(scene, "readback", COUNT_BYTES + size, usage)?;
        }
        Ok(self)
    }
}

impl GpuScene {
    /// The bind group of a kernel: the scene, `own` (frame, jobs, pixels, sums, counts), and what comes after the scene's words.
    pub(super) fn bind_group(
        &self,
        kernel: &Kernel,
        own: [&Buffer; 5],
        extra: &[&Buffer],
    ) -> wgpu::BindGroup {
        let scene = self.slots.iter().chain(&self.words);
        let buffers = [&self.info].into_iter().chain(own).chain(scene).chain(extra.iter().copied());
        let entries: Vec<_> = buffers
            .zip(0..)
            .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        debug_assert!(entries.len() >= SLOT_BINDING as usize + 2);
        self.gpu.device().create_bind_group(&BindGroupDescriptor {
            label: None,
            layout: &kernel.layout,
            entries: &entries,
        })
    }
}
