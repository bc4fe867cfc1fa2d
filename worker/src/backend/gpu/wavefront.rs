//! Paths step by step, all rays of a kind together: the buffers and dispatches of wavefront.wgsl.
//!
//! How long a submission takes is bounded by its rounds; work that is not finished then goes on in another one. What is left of it is read
//! back with the pixels, so nobody waits for the device between rounds.

use super::kernel::{Kernel, Purpose, SLOT_BINDING, Stage};
use super::slot::make_buffer;
use super::{GpuError, GpuScene};
use bytemuck::{Pod, Zeroable, bytes_of};
use std::sync::Arc;
use tessera_whitted::device::state_quads;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferUsages, CommandEncoder, ComputePass,
};

/// States at most: more than the threads that a large GPU holds at a time; on a software driver those that its caches hold.
const STATES_GPU: u64 = 1 << 18;
const STATES_SOFTWARE: u64 = 1 << 13;

/// Bytes of a submission's states at most: the least that a binding may have on every device.
pub(super) const STATE_BYTES: u64 = 128 << 20;

/// Work-groups along the first axis of a dispatch (wavefront.wgsl).
pub(super) const GROUPS_ACROSS: u32 = 65_535;

/// Rays that a path in flight is advanced in one submission: bounds, and what to begin with.
pub(super) const ROUNDS_MIN: u32 = 1;
pub(super) const ROUNDS_MAX: u32 = 64;
pub(super) const ROUNDS: u32 = 4;

/// What `Waves` in wavefront.wgsl has before its queues.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct Head {
    states: u32,
    blocks: u32,
    jobs: u32,
    turn: u32,
    now: [u32; 2],
    next: [u32; 2],
    begun: u32,
    reserved: [u32; 3],
}

const _: () = assert!(size_of::<Head>() == 48);

/// Bytes of it, and where the rays that are queued are counted.
pub(super) const HEAD_BYTES: u64 = size_of::<Head>() as u64;

/// Buffers of one submission, as large as was needed so far.
pub(super) struct WaveBuffers {
    states: Buffer,
    queues: Buffer,
    groups: Buffer,
}

/// Work under way.
pub(super) struct Waves {
    kernels: [Arc<Kernel>; 4],
    queues: Buffer,
    groups: Buffer,
    own: BindGroup,
    turn: BindGroup,
    states: u32,
    is_begun: bool,
}

impl Waves {
    /// Work on `jobs` jobs of `blocks` blocks in all, in buffers that are `kept` for the next work; `own` are those of a megakernel.
    pub(super) fn new(
        scene: &GpuScene,
        depth: u32,
        own: [&Buffer; 5],
        kept: &mut Option<WaveBuffers>,
        (jobs, blocks): (u32, u32),
    ) -> Result<Self, GpuError> {
        let kernel = |stage| scene.kernel(depth, Purpose::Wave(stage));
        let kernels =
            [kernel(Stage::Start)?, kernel(Stage::Turn)?, kernel(Stage::Extend)?, kernel(Stage::Shade)?];
        let state_bytes = 16 * u64::from(state_quads(scene.path_stack(depth)));
        let most = if scene.gpu.is_software() { STATES_SOFTWARE } else { STATES_GPU };
        let binding = scene.gpu.limits().max_storage_buffer_binding_size.min(STATE_BYTES);
        let states = (u64::from(blocks) * 64).min(most).min(binding / state_bytes).max(64);
        let WaveBuffers { states: state_buffer, queues, groups } =
            WaveBuffers::with(kept, scene, states * state_bytes, HEAD_BYTES + states * 8)?;
        let states = states as u32;
        let head = Head { states, blocks, jobs, begun: states, ..Head::zeroed() };
        scene.gpu.queue().write_buffer(queues, 0, bytes_of(&head));
        let entries = [(1, queues), (2, groups)].map(|(after, buffer)| BindGroupEntry {
            binding: SLOT_BINDING + (scene.slots.len() + scene.words.len()) as u32 + after,
            resource: buffer.as_entire_binding(),
        });
        let turn = scene.gpu.device().create_bind_group(&BindGroupDescriptor {
            label: None,
            layout: &kernels[1].layout,
            entries: &entries,
        });
        let own = scene.bind_group(&kernels[0], own, &[state_buffer, queues]);
        Ok(Self {
            queues: queues.clone(),
            groups: groups.clone(),
            kernels,
            own,
            turn,
            states,
            is_begun: false,
        })
    }

    /// Encodes so many rounds; the first time after every state has been given a pixel.
    pub(super) fn encode(&mut self, encoder: &mut CommandEncoder, rounds: u32) {
        let [start, turn, extend, shade] = &self.kernels;
        let mut pass = encoder.begin_compute_pass(&Default::default());
        let set = |pass: &mut ComputePass<'_>, kernel: &Kernel, group: &BindGroup| {
            pass.set_pipeline(&kernel.pipeline);
            pass.set_bind_group(0, group, &[]);
        };
        if !self.is_begun {
            let groups = self.states.div_ceil(64);
            set(&mut pass, start, &self.own);
            pass.dispatch_workgroups(groups.min(GROUPS_ACROSS), groups.div_ceil(GROUPS_ACROSS), 1);
            self.is_begun = true;
        }
        for _ in 0..rounds {
            set(&mut pass, turn, &self.turn);
            pass.dispatch_workgroups(1, 1, 1);
            for kernel in [extend, shade] {
                set(&mut pass, kernel, &self.own);
                pass.dispatch_workgroups_indirect(&self.groups, 0);
            }
        }
    }

    /// Copies what [`is_done`] reads.
    pub(super) fn copy_head(&self, encoder: &mut CommandEncoder, to: &Buffer, offset: u64) {
        encoder.copy_buffer_to_buffer(&self.queues, 0, to, offset, HEAD_BYTES);
    }
}

/// Whether no ray is queued.
pub(super) fn is_done(head: &[u8]) -> bool {
    bytemuck::pod_read_unaligned::<Head>(head).next == [0; 2]
}

impl WaveBuffers {
    /// Those of `kept`, or larger ones in their place.
    fn with<'a>(
        kept: &'a mut Option<Self>,
        scene: &GpuScene,
        states: u64,
        queues: u64,
    ) -> Result<&'a Self, GpuError> {
        let fits = |b: &Self| b.states.size() >= states && b.queues.size() >= queues;
        let made = match kept.take().filter(fits) {
            Some(buffers) => buffers,
            None => {
                let storage = BufferUsages::STORAGE;
                let both = storage | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
                Self {
                    states: make_buffer(scene, "states", states, storage)?,
                    queues: make_buffer(scene, "queues", queues, both)?,
                    groups: make_buffer(scene, "groups", 12, storage | BufferUsages::INDIRECT)?,
                }
            }
        };
        Ok(kept.insert(made))
    }
}
