//! A pack in a GPU's memory, and the kernels that were compiled for it.

use super::kernel::{Chunks, GpuOptions, Kernel, KernelKey, Purpose, Stage, TraversalForm};
use super::wavefront::STATE_BYTES;
use super::{Gpu, GpuError, tiles};
use bytemuck::bytes_of;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tessera_pack::Pack;
use tessera_pack::device::DeviceWords;
use tessera_whitted::FrameParams;
use tessera_whitted::device::{SceneInfo, code_thresholds};
use tessera_whitted::variant::Variant;
use wgpu::{Buffer, BufferDescriptor, BufferUsages};

/// A pack in a GPU's memory.
pub(crate) struct GpuScene {
    pub(super) gpu: Gpu,
    pub(super) pack: Pack,
    pub(super) options: GpuOptions,
    pub(super) info: Buffer,
    /// The kd-tree's slots and all other words, in as many buffers as the device's bindings ask for.
    pub(super) slots: Vec<Buffer>,
    pub(super) words: Vec<Buffer>,
    chunks: Chunks,
    variant: Variant,
}

/// Storage buffers of a kernel that are not of the scene: jobs, pixels, sums, counts, and two for paths that are taken step by step.
const OWN_BINDINGS: u32 = 6;

/// What is kept free beside a scene for pixels and sums, which are bounded by a submission's work.
const WORKING_BYTES: u64 = 192 << 20;

/// Depths of paths for which kernels are compiled: a frame takes the first that is deep enough.
const DEPTHS: [u32; 3] = [8, 16, FrameParams::MAX_DEPTH];

/// Written at once at most; the driver holds as much beside it.
const WRITE_BYTES: usize = 32 << 20;

/// For that.
const PATIENCE: Duration = Duration::from_secs(30);

impl GpuScene {
    /// Uploads `pack`, or says why it cannot be held, before anything is uploaded if the numbers tell.
    pub(crate) fn load(gpu: &Gpu, pack: &Pack, options: GpuOptions) -> Result<Self, GpuError> {
        let begun = Instant::now();
        let thresholds = code_thresholds();
        let needs = pack.bytes().len() as u64;
        let Some(words) = DeviceWords::of(pack, &thresholds) else {
            let has = u64::from(u32::MAX) * 4;
            return Err(GpuError::CannotHold { needs, has, what: "places of 32 bits" });
        };
        let (slot_bytes, word_bytes) = (words.slots.len() as u64, words.length * 4);
        let working = match options.form {
            TraversalForm::Wavefront => WORKING_BYTES + tiles::UNDER_WAY as u64 * STATE_BYTES,
            TraversalForm::PrivateStack | TraversalForm::ShortStack => WORKING_BYTES,
        };
        let chunks = check(gpu, slot_bytes, word_bytes, working, options.binding_bytes_max)?;

        let slots = upload(gpu, &[words.slots], 8 << chunks.slots_log2, slot_bytes, chunks.slot_bindings)?;
        let rows = upload(gpu, &words.pieces, 4 << chunks.words_log2, word_bytes, chunks.word_bindings)?;
        let info = gpu.try_make(|| {
            let descriptor = BufferDescriptor {
                label: Some("scene"),
                size: size_of::<SceneInfo>() as u64,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            gpu.device().create_buffer(&descriptor)
        })?;
        gpu.queue().write_buffer(&info, 0, bytes_of(&SceneInfo::of(pack, &words)));
        let least = if options.lean { Variant::of(pack) } else { Variant::everything(pack) };
        let variant = options.forced.map_or(least, |part| least.with(part));
        tracing::debug!(
            "the GPU holds {} bytes of the scene after {:.1?}, kernel {}",
            slot_bytes + word_bytes,
            begun.elapsed(),
            variant.name()
        );
        Ok(Self { gpu: gpu.clone(), pack: pack.clone(), options, info, slots, words: rows, chunks, variant })
    }

    /// Compiles the kernels that most frames use.
    pub(crate) fn warm_up(&self) -> Result<(), GpuError> {
        self.purposes().iter().try_for_each(|&purpose| self.kernel(DEPTHS[0], purpose).map(|_| ()))
    }

    /// What its kernels do.
    fn purposes(&self) -> Vec<Purpose> {
        match self.options.form {
            TraversalForm::Wavefront => Stage::ALL.map(Purpose::Wave).to_vec(),
            TraversalForm::PrivateStack | TraversalForm::ShortStack => vec![Purpose::Render],
        }
    }

    /// Which scene it is.
    pub(crate) fn pack(&self) -> &Pack {
        &self.pack
    }

    /// Greatest number of waiting rays of a path.
    pub(super) fn path_stack(&self, depth: u32) -> u32 {
        self.variant.path_stack(depth)
    }

    /// Bytes of the text of the kernels that render paths of `depth` mirror and bent rays.
    pub(super) fn text_bytes(&self, depth: u32) -> Result<usize, GpuError> {
        self.purposes().iter().map(|&purpose| Ok(self.kernel(depth, purpose)?.text_bytes)).sum()
    }

    /// The kernel for paths of `depth` mirror and bent rays, compiled the first time.
    pub(super) fn kernel(&self, depth: u32, purpose: Purpose) -> Result<Arc<Kernel>, GpuError> {
        // A path that needs no stack is the same at any depth; others have room for a few depths.
        let room = DEPTHS.into_iter().find(|&room| room >= depth).unwrap_or(FrameParams::MAX_DEPTH);
        let depth = if self.variant.path_stack(room) == 1 { 0 } else { room };
        let key = KernelKey {
            variant: self.variant,
            depth,
            form: self.options.form,
            f64: self.gpu.uses_f64() && self.options.f64,
            chunks: self.chunks,
            purpose,
        };
        self.gpu.kernel(key)
    }
}

/// How a scene is split over bindings; an error when it is too large.
fn check(
    gpu: &Gpu,
    slot_bytes: u64,
    word_bytes: u64,
    working: u64,
    binding_bytes_max: Option<u64>,
) -> Result<Chunks, GpuError> {
    let limits = gpu.limits();
    let binding = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    let binding = binding_bytes_max.map_or(binding, |max| max.min(binding));
    let bindings = limits.max_storage_buffers_per_shader_stage.saturating_sub(OWN_BINDINGS);
    let needs = slot_bytes + word_bytes;
    if let Some(memory) = gpu.adapter().memory
        && needs + working > memory
    {
        return Err(GpuError::CannotHold { needs: needs + working, has: memory, what: "memory" });
    }
    chunks(slot_bytes, word_bytes, binding, bindings).ok_or(GpuError::CannotHold {
        needs,
        has: binding.saturating_mul(bindings.into()),
        what: "bindings",
    })
}

/// Bindings of at most `binding` bytes each, `bindings` in all: one where everything fits in it, else equal powers of two.
fn chunks(slot_bytes: u64, word_bytes: u64, binding: u64, bindings: u32) -> Option<Chunks> {
    let split = |bytes: u64, element: u64| {
        if bytes <= binding {
            return Some((1, 31));
        }
        let log2 = (binding / element).checked_ilog2()?.min(31);
        let count = (bytes / element).div_ceil(1 << log2);
        Some((u32::try_from(count).ok()?, log2))
    };
    let (slot_bindings, slots_log2) = split(slot_bytes, 8)?;
    let (word_bindings, words_log2) = split(word_bytes, 4)?;
    (slot_bindings.checked_add(word_bindings)? <= bindings).then_some(Chunks {
        slot_bindings,
        slots_log2,
        word_bindings,
        words_log2,
    })
}

/// Writes `pieces` one after the other into `count` buffers of `chunk` bytes each, the last one shorter.
fn upload(gpu: &Gpu, pieces: &[&[u8]], chunk: u64, total: u64, count: u32) -> Result<Vec<Buffer>, GpuError> {
    let made = gpu.try_make(|| {
        let sizes = (0..u64::from(count)).map(|i| total.saturating_sub(i * chunk).min(chunk));
        let descriptors = sizes.map(|size| BufferDescriptor {
            label: Some("pack"),
            // An empty section has a binding too.
            size: size.max(8),
            usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        descriptors.map(|descriptor| gpu.device().create_buffer(&descriptor)).collect::<Vec<_>>()
    });
    let buffers = made?;
    let mut at = 0;
    for piece in pieces {
        let mut rest = *piece;
        while !rest.is_empty() {
            let (buffer, offset) = ((at / chunk) as usize, at % chunk);
            let length = rest.len().min(WRITE_BYTES).min((chunk - offset) as usize);
            let (now, later) = rest.split_at(length);
            gpu.queue().write_buffer(&buffers[buffer], offset, now);
            // What is on its way is held twice until it is there.
            let sent = gpu.queue().submit([]);
            gpu.wait(sent, PATIENCE)?;
            at += length as u64;
            rest = later;
        }
    }
    gpu.check()?;
    Ok(buffers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_a_binding_is_split_and_what_does_not_fit_them_all_is_refused() {
        let one = Chunks { slot_bindings: 1, slots_log2: 31, word_bindings: 1, words_log2: 31 };
        assert_eq!(chunks(100, 1000, 1000, 2), Some(one));
        assert_eq!(chunks(0, 0, 1000, 2), Some(one), "an empty scene");
        // 1004 bytes of words in pieces of 128 words of 4: 251 words, two bindings.
        let two = Chunks { word_bindings: 2, words_log2: 7, ..one };
        assert_eq!(chunks(100, 1004, 1000, 3), Some(two));
        assert_eq!(chunks(100, 1004, 1000, 2), None);
        let slots = Chunks { slot_bindings: 3, slots_log2: 6, ..one };
        assert_eq!(chunks(8 * 129, 8, 1000, 4), Some(slots));
        assert_eq!(chunks(u64::MAX / 2, 8, 1 << 27, 26), None);
    }
}
