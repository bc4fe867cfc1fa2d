//! Tiles on their way: cut into submissions, awaited, read back.
//!
//! Two submissions are under way at a time: while the pixels of one are read back and returned, the device computes the next. Nobody waits
//! for the device between tiles.
//!
//! Of a frame with adaptive sampling the device takes the samples of a round and hands back their sums; [`AdaptiveTile`], the CPU's own, decides
//! here which blocks need more, and codes the pixels. With `f64` the sums are the CPU's but for a roundoff here and there, and decisions differ
//! only where an estimate is within that of the threshold; without it more blocks near the threshold may get another round than there.

use super::kernel::{GROUP_SIDE, Kernel, Purpose, SLOT_BINDING};
use super::pass::{Cut, Piece, Together};
use super::slot::{COUNT_BYTES, CUT_LOOPS, FRONT_BYTES, JOBS, Slot, make_buffer};
use super::wavefront::{self, HEAD_BYTES, ROUNDS, ROUNDS_MAX, ROUNDS_MIN, Waves};
use super::{GpuError, GpuScene, TraversalForm};
use crate::backend::cpu;
use crate::session::{RenderTask, RenderedTile, TileName};
use bytemuck::{bytes_of, cast_slice};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tessera_whitted::adaptive::Round;
use tessera_whitted::device::{FrameInfo, Job, device_format, encode_rgba16, words_per_pixel};
use tessera_whitted::{AdaptiveTile, FrameParams, PixelBlock, PixelFormat};
use tessera_wire::{Rays, Rect};
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferUsages, CommandEncoder, MapMode,
    SubmissionIndex,
};

/// Submissions under way at a time.
pub(super) const UNDER_WAY: usize = 2;

/// How long a submission should take: long against the tens of microseconds that it costs, short against the 2 s after which systems
/// take a GPU for hung.
const TARGET: Duration = Duration::from_millis(100);

/// After so long without an answer the device is taken for hung: hundreds of times the target.
const PATIENCE: Duration = Duration::from_secs(60);

/// Words of the pixels of a submission, of which two are under way, each with as much to read back from.
const PIXEL_WORDS_MAX: u64 = 8 << 20;

/// Samples of a submission (pixels, where their paths are taken step by step): bounds, and what to begin with on a real GPU and on a software driver.
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
    /// What the next submission may cost.
    budget: u64,
    /// Rounds of the next submission, where paths are taken step by step.
    rounds: u32,
    /// When the last submission was found done.
    last_done: Instant,
    /// Number of the first tile in `waiting`.
    first: u64,
}

struct Waiting {
    task: RenderTask,
    params: FrameParams,
    together: Together,
    /// What is to be done for now: the whole tile, or with adaptive sampling the pixels of a round.
    regions: Vec<Region>,
    adaptive: Option<AdaptiveTile>,
    pixels: Vec<u8>,
    rays: Rays,
    time: Duration,
    /// Pieces under way.
    pieces: u32,
    /// Whether it is returned when it is finished. One that is not has no regions, and keeps its place until its pieces are in.
    is_wanted: bool,
}

/// Pixels that get the same samples.
struct Region {
    rect: Rect,
    samples: Range<u32>,
    cut: Cut,
}

struct UnderWay {
    slot: Slot,
    run: Run,
    submission: SubmissionIndex,
    begun: Instant,
    /// Time that earlier submissions of the same work have taken.
    spent: Duration,
    /// What it costs the budget.
    work: u64,
    /// Whether the budget ended it, and not the work.
    is_full: bool,
    words: u64,
    parts: Vec<Part>,
}

/// A piece of a tile in a submission.
struct Part {
    tile: u64,
    region: usize,
    piece: Piece,
    at_pixels: u64,
    /// Whether its pixels are made.
    is_last: bool,
}

/// How the paths of a submission are taken.
enum Run {
    /// Each from its beginning to its end, by one kernel in `groups` work-groups for each of `jobs` jobs.
    Whole { kernel: Arc<Kernel>, bind_group: BindGroup, groups: u32, jobs: u32 },
    /// Step by step.
    Waves(Waves),
}

impl Run {
    fn encode(&mut self, encoder: &mut CommandEncoder, slot: &Slot, rounds: u32) {
        match self {
            Self::Whole { kernel, bind_group, groups, jobs } => {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&kernel.pipeline);
                pass.set_bind_group(0, &*bind_group, &[]);
                pass.dispatch_workgroups(*groups, *jobs, 1);
            }
            Self::Waves(waves) => {
                waves.encode(encoder, rounds);
                waves.copy_head(encoder, &slot.readback, COUNT_BYTES);
            }
        }
    }
}

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
            rounds: ROUNDS,
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
        let together = match self.scene.options.form {
            TraversalForm::Wavefront => Together::All,
            // Mesa's software drivers end all loops of a kernel after 65,535 turns in all, silently.
            _ if self.scene.gpu.is_software() => Together::One,
            TraversalForm::PrivateStack | TraversalForm::ShortStack => Together::Fitting,
        };
        let RenderTask { rect, .. } = task;
        let Rect { x, y, width, height } = rect;
        let mut waiting = Waiting {
            task,
            params,
            together,
            regions: vec![Region::new(rect, 0..params.samples.max(1), together)],
            adaptive: AdaptiveTile::new(&params, PixelBlock { x, y, width, height }),
            pixels: vec![0; bytes],
            rays: Rays::default(),
            time: Duration::ZERO,
            pieces: 0,
            is_wanted: true,
        };
        if waiting.adaptive.is_some() {
            waiting.begin_round();
        }
        self.waiting.push_back(waiting);
    }

    /// Forgets every tile; those that are being computed come to nothing.
    pub(crate) fn clear(&mut self) -> Vec<RenderTask> {
        self.first += self.waiting.len() as u64;
        self.waiting.drain(..).filter(|waiting| waiting.is_wanted).map(|waiting| waiting.task).collect()
    }

    /// Forgets one tile, if it is there. Nothing more of it is submitted; what has been submitted ([`UNDER_WAY`] submissions at most) the
    /// device computes to its end, where paths are taken step by step until the next look at it, and it comes to nothing.
    pub(crate) fn forget(&mut self, name: TileName) -> bool {
        let Some(tile) = self.waiting.iter_mut().find(|tile| tile.is_wanted && tile.task.name() == name)
        else {
            return false;
        };
        tile.is_wanted = false;
        (tile.regions, tile.adaptive, tile.pixels) = (Vec::new(), None, Vec::new());
        true
    }

    /// Whether a tile of this number is there and not forgotten.
    fn is_wanted(&self, number: u64) -> bool {
        let place = number.checked_sub(self.first).and_then(|place| usize::try_from(place).ok());
        place.and_then(|place| self.waiting.get(place)).is_some_and(|tile| tile.is_wanted)
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
        while self.waiting.front().is_some_and(|tile| tile.is_submitted() && tile.pieces == 0) {
            let Some(Waiting { task, pixels, rays, time, is_wanted, .. }) = self.waiting.pop_front() else {
                break;
            };
            self.first += 1;
            if is_wanted {
                finished.push(RenderedTile::new(task, pixels, time, rays));
            }
        }
        Ok(finished)
    }

    /// Submits as much as is due; false when nothing is left to submit.
    fn submit(&mut self) -> Result<bool, GpuError> {
        // What was begun comes first: `sums` is of it alone.
        let begun = |tile: &Waiting| tile.regions.iter().any(|region| region.cut.is_begun());
        let start = self.waiting.iter().position(begun);
        let start = start.or_else(|| self.waiting.iter().position(|tile| !tile.is_submitted()));
        let Some(start) = start else { return Ok(false) };
        let Some(slot) = self.free.pop() else { return Ok(false) };
        let params = self.waiting[start].params;
        let words_each = u64::from(words_per_pixel(device_format(&params)));
        let (mut jobs, mut parts): (Vec<Job>, Vec<Part>) = Default::default();
        let (mut work, mut words, mut sums, mut is_full) = (0, 0u64, 1, false);
        let (mut blocks, mut groups) = (0, 1);

        // Collect pieces of tiles of one frame until the budget is used up.
        'collect: for (index, tile) in self.waiting.iter_mut().enumerate().skip(start) {
            if tile.params != params {
                break;
            }
            for (at, Region { rect, samples, cut }) in tile.regions.iter_mut().enumerate() {
                if cut.is_done() {
                    continue;
                }
                // (A pixel costs what it costs the budget, and words of its own.)
                let room = (PIXEL_WORDS_MAX - words) / words_each * cut.cost();
                let left = self.budget.saturating_sub(work).min(room);
                if jobs.len() == JOBS || (!jobs.is_empty() && !cut.fits(left)) {
                    is_full = true;
                    break 'collect;
                }
                let Some(piece) = cut.next(left) else { continue };
                let Piece { row, rows, samples: (first_sample, end_sample) } = piece;
                let pixels = u64::from(rect.width) * u64::from(rows);
                let is_last = end_sample == samples.len() as u32;
                let is_whole = is_last && first_sample == 0;
                jobs.push(Job {
                    x: rect.x,
                    y: rect.y + row,
                    width: rect.width,
                    height: rows,
                    first_sample: samples.start + first_sample,
                    end_sample: samples.start + end_sample,
                    round_first: samples.start,
                    round_end: samples.end,
                    at_pixels: words as u32,
                    first_block: blocks,
                });
                let tile_number = self.first + index as u64;
                parts.push(Part { tile: tile_number, region: at, piece, at_pixels: words, is_last });
                tile.pieces += 1;
                work += cost_of(cut, pixels, end_sample - first_sample);
                let of_it = rect.width.div_ceil(GROUP_SIDE).saturating_mul(rows.div_ceil(GROUP_SIDE));
                (blocks, groups) = (blocks + of_it, groups.max(of_it));
                if is_last {
                    words += pixels * words_each;
                }
                if !is_whole {
                    // Its sums are those of this submission alone.
                    sums = pixels;
                }
                if !is_whole || !cut.is_done() {
                    is_full = true;
                    break 'collect;
                }
            }
        }
        if sums * 16 > self.sums.size() {
            self.sums = make_sums(&self.scene, sums)?;
        }
        let mut slot = slot.for_words(&self.scene, words)?;
        let begun = Instant::now();
        let queue = self.scene.gpu.queue();
        queue.write_buffer(&slot.frame, 0, bytes_of(&FrameInfo::of(&params)));
        queue.write_buffer(&slot.jobs, 0, cast_slice(&jobs));
        let mut run = self.run(&mut slot, &params, (jobs.len() as u32, groups, blocks))?;
        let submission = self.encode(&slot, &mut run, words, true);
        self.scene.gpu.check()?;
        let spent = Duration::ZERO;
        self.under_way.push_back(UnderWay {
            slot,
            run,
            submission,
            begun,
            spent,
            work,
            is_full,
            words,
            parts,
        });
        Ok(true)
    }

    /// What takes the paths of `jobs` jobs with `groups` blocks of pixels at most, `blocks` in all.
    fn run(
        &self,
        slot: &mut Slot,
        params: &FrameParams,
        (jobs, groups, blocks): (u32, u32, u32),
    ) -> Result<Run, GpuError> {
        let scene = &*self.scene;
        let depth = params.max_depth.min(FrameParams::MAX_DEPTH);
        let own = [&slot.frame, &slot.jobs, &slot.pixels, &self.sums, &slot.counts];
        if scene.options.form == TraversalForm::Wavefront {
            return Ok(Run::Waves(Waves::new(scene, depth, own, &mut slot.waves, (jobs, blocks))?));
        }
        let kernel = scene.kernel(depth, Purpose::Render)?;
        let bind_group = scene.bind_group(&kernel, own, &[]);
        Ok(Run::Whole { kernel, bind_group, groups, jobs })
    }

    fn encode(&self, slot: &Slot, run: &mut Run, words: u64, is_first: bool) -> SubmissionIndex {
        let gpu = &self.scene.gpu;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        if is_first {
            encoder.clear_buffer(&slot.counts, 0, None);
        }
        run.encode(&mut encoder, slot, self.rounds);
        encoder.copy_buffer_to_buffer(&slot.counts, 0, &slot.readback, 0, COUNT_BYTES);
        if words > 0 {
            encoder.copy_buffer_to_buffer(&slot.pixels, 0, &slot.readback, FRONT_BYTES, words * 4);
        }
        let submission = gpu.queue().submit([encoder.finish()]);
        // Whether it could be mapped shows when the range is asked for.
        slot.readback.map_async(MapMode::Read, ..FRONT_BYTES + words * 4, |_| ());
        submission
    }

    /// Goes on with work that is not finished.
    fn go_on(&mut self, done: UnderWay, took: Duration) -> Result<(), GpuError> {
        let UnderWay { slot, mut run, words, .. } = done;
        self.adapt_rounds(took, true);
        let begun = Instant::now();
        let submission = self.encode(&slot, &mut run, words, false);
        self.scene.gpu.check()?;
        let spent = done.spent + took;
        self.under_way.push_back(UnderWay { slot, run, submission, begun, spent, ..done });
        Ok(())
    }

    /// Takes more or fewer rounds after a submission `took` so long; more only if it had work for all of them.
    fn adapt_rounds(&mut self, took: Duration, had_more: bool) {
        if took > TARGET * 2 {
            self.rounds = (self.rounds / 2).max(ROUNDS_MIN);
        } else if had_more && took < TARGET / 2 {
            self.rounds = (self.rounds * 2).min(ROUNDS_MAX);
        }
    }

    /// Waits for a submission and takes its pixels.
    fn take_in(&mut self, done: UnderWay) -> Result<(), GpuError> {
        self.scene.gpu.wait(done.submission.clone(), PATIENCE)?;
        let now = Instant::now();
        let took = now - done.begun.max(self.last_done);
        self.last_done = now;
        if !done.is_finished()? && done.parts.iter().any(|part| self.is_wanted(part.tile)) {
            done.slot.readback.unmap();
            return self.go_on(done, took);
        }
        let UnderWay { slot, run, spent, work, is_full, words, parts, .. } = done;
        if matches!(run, Run::Waves(_)) {
            // Rounds bound it.
            self.adapt_rounds(took, false);
        } else if took > TARGET * 2 {
            self.budget = (self.budget / 2).max(BUDGET_MIN);
        } else if is_full && took < TARGET / 2 {
            self.budget = (self.budget * 2).min(BUDGET_MAX);
        }
        let took = spent + took;
        {
            let range = slot.mapped(0, FRONT_BYTES + words * 4)?;
            let (front, pixels): (&[u32], &[u32]) = {
                let all: &[u32] = cast_slice(&range);
                all.split_at(FRONT_BYTES as usize / 4)
            };
            if front[CUT_LOOPS] != 0 {
                return Err(GpuError::LoopsCut);
            }
            for (part, counts) in parts.iter().zip(front.chunks_exact(4)) {
                // A tile that was forgotten meanwhile has a number before those that are waiting.
                let Some(index) = part.tile.checked_sub(self.first) else { continue };
                let Some(tile) = self.waiting.get_mut(index as usize) else { continue };
                tile.pieces -= 1;
                if !tile.is_wanted {
                    continue;
                }
                tile.rays.primary += u64::from(counts[0]);
                tile.rays.shadow += u64::from(counts[1]);
                tile.rays.reflection += u64::from(counts[2]);
                tile.rays.refraction += u64::from(counts[3]);
                let Piece { rows, samples: (first, end), .. } = part.piece;
                let region = &tile.regions[part.region];
                let of_it = u64::from(region.rect.width) * u64::from(rows);
                let share = cost_of(&region.cut, of_it, end - first) as f64 / work.max(1) as f64;
                tile.time += took.mul_f64(share);
                if part.is_last {
                    let words = (of_it * u64::from(words_per_pixel(device_format(&tile.params)))) as usize;
                    tile.take(part, &pixels[part.at_pixels as usize..][..words]);
                }
                if tile.pieces == 0 && tile.is_submitted() {
                    tile.end_round();
                }
            }
        }
        slot.readback.unmap();
        self.free.push(slot);
        Ok(())
    }
}

impl Region {
    fn new(rect: Rect, samples: Range<u32>, together: Together) -> Self {
        let cut = Cut::new(rect, samples.len() as u32, together);
        Self { rect, samples, cut }
    }
}

impl Waiting {
    /// Whether nothing of it is left to submit for now.
    fn is_submitted(&self) -> bool {
        self.regions.iter().all(|region| region.cut.is_done())
    }

    /// Asks for the samples that are to be taken now: none when the tile is finished.
    fn begin_round(&mut self) {
        let Some(adaptive) = &mut self.adaptive else { return };
        let region = |Round { rect: PixelBlock { x, y, width, height }, samples }| {
            Region::new(Rect { x, y, width, height }, samples, self.together)
        };
        self.regions = adaptive.work().into_iter().map(region).collect();
    }

    /// Ends a round whose samples are all taken, and begins the next one.
    fn end_round(&mut self) {
        if let Some(adaptive) = &mut self.adaptive {
            adaptive.end_round(&mut self.pixels);
            self.begin_round();
        }
    }

    /// Takes in the pixels of a part, or the sums of a round's samples.
    fn take(&mut self, part: &Part, words: &[u32]) {
        let Self { task: RenderTask { rect: tile, .. }, params, .. } = *self;
        let Region { rect, ref samples, .. } = self.regions[part.region];
        let bytes = params.format.bytes_per_pixel();
        let Some(adaptive) = &mut self.adaptive else {
            let start = part.piece.row as usize * tile.width as usize * bytes;
            let length = rect.width as usize * part.piece.rows as usize * bytes;
            return write_pixels(params.format, words, &mut self.pixels[start..][..length]);
        };
        let words_each = words_per_pixel(device_format(&params)) as usize;
        let pixels = words.chunks_exact(words_each * rect.width as usize);
        for (y, row) in (rect.y + part.piece.row..).zip(pixels) {
            for (x, words) in (rect.x..).zip(row.chunks_exact(words_each)) {
                let (sum, surface) = words.split_at(4);
                adaptive.put(x, y, std::array::from_fn(|i| f32::from_bits(sum[i])));
                // With layers, the first round brings what the pixel's centre shows.
                let (column, row) = (x.wrapping_sub(tile.x), y.wrapping_sub(tile.y));
                if samples.start == 0 && !surface.is_empty() && column < tile.width && row < tile.height {
                    let place = row as usize * tile.width as usize + column as usize;
                    self.pixels[place * bytes + 16..][..bytes - 16].copy_from_slice(cast_slice(surface));
                }
            }
        }
    }
}

impl UnderWay {
    /// Whether every path has ended, of a submission that is done.
    fn is_finished(&self) -> Result<bool, GpuError> {
        match self.run {
            Run::Whole { .. } => Ok(true),
            Run::Waves(_) => Ok(wavefront::is_done(&self.slot.mapped(COUNT_BYTES, HEAD_BYTES)?)),
        }
    }
}

/// What so many pixels of a tile cost the budget.
fn cost_of(cut: &Cut, pixels: u64, samples: u32) -> u64 {
    pixels * cut.cost().min(samples.into())
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

impl GpuScene {
    /// The bind group of a kernel: the scene, `own` (frame, jobs, pixels, sums, counts), and what comes after the scene's words.
    pub(super) fn bind_group(&self, kernel: &Kernel, own: [&Buffer; 5], extra: &[&Buffer]) -> BindGroup {
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
