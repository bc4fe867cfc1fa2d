//! The buffers of one submission.

use super::wavefront::{HEAD_BYTES, WaveBuffers};
use super::{GpuError, GpuScene};
use tessera_whitted::device::{FrameInfo, Job};
use wgpu::{Buffer, BufferDescriptor, BufferUsages, BufferView};

/// Buffers of one submission.
pub(super) struct Slot {
    pub(super) frame: Buffer,
    pub(super) jobs: Buffer,
    pub(super) counts: Buffer,
    pub(super) pixels: Buffer,
    /// Counts, the head of waves, pixels.
    pub(super) readback: Buffer,
    pub(super) waves: Option<WaveBuffers>,
}

/// Tiles in one submission at most.
pub(super) const JOBS: usize = 256;

/// The word behind the counts of the jobs that is not 0 when the driver has ended loops early (`CUT_LOOPS` in pixel.wgsl).
pub(super) const CUT_LOOPS: usize = JOBS * 4;

/// Bytes of the counts of a submission's jobs with that word, and of what comes before the pixels that are read back.
pub(super) const COUNT_BYTES: u64 = JOBS as u64 * 16 + 16;
pub(super) const FRONT_BYTES: u64 = COUNT_BYTES + HEAD_BYTES;

impl Slot {
    /// With room for no pixels yet.
    pub(super) fn new(scene: &GpuScene) -> Result<Self, GpuError> {
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
                FRONT_BYTES + 4,
                BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            )?,
            waves: None,
        })
    }

    /// With room for so many words of pixels.
    pub(super) fn for_words(mut self, scene: &GpuScene, words: u64) -> Result<Self, GpuError> {
        let bytes = words * 4;
        if bytes > self.pixels.size() {
            let size = bytes.next_power_of_two();
            self.pixels = make_buffer(scene, "pixels", size, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
            let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
            self.readback = make_buffer(scene, "readback", FRONT_BYTES + size, usage)?;
        }
        Ok(self)
    }

    /// Bytes that were read back.
    pub(super) fn mapped(&self, at: u64, bytes: u64) -> Result<BufferView, GpuError> {
        let range = self.readback.get_mapped_range(at..at + bytes);
        range.map_err(|e| GpuError::Lost(format!("its memory cannot be read: {e}")))
    }
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
