//! The kernels' text and what is compiled of it.

use super::{Gpu, GpuError};
use std::borrow::Cow;
use std::fmt::Write;
use tessera_geometry::mutation::{Mutation, is_on};
use tessera_geometry::wgsl as geometry;
use tessera_kdtree::wgsl as kdtree;
use tessera_whitted::device as whitted;
use tessera_whitted::variant::{Part, Variant};
use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BufferBindingType,
    ComputePipeline, ComputePipelineDescriptor, PipelineLayoutDescriptor, ShaderModuleDescriptor,
    ShaderRuntimeChecks, ShaderSource, ShaderStages,
};

/// What a traversal remembers of a ray's way. The answers are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TraversalForm {
    /// A stack as deep as a tree may be, for every ray: simple, the oracle of the others.
    PrivateStack,
    /// A few entries and a trail of bits; what was forgotten is found again from the root.
    ShortStack,
    /// The same stack as the first, but paths are taken step by step, all rays of a kind together. Single rays are as with the first.
    #[default]
    Wavefront,
}

impl TraversalForm {
    /// All forms.
    pub const ALL: [Self; 3] = [Self::PrivateStack, Self::ShortStack, Self::Wavefront];

    /// For people and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PrivateStack => "private-stack",
            Self::ShortStack => "short-stack",
            Self::Wavefront => "wavefront",
        }
    }
}

/// How kernels are made; every choice gives the same answers, but for `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GpuOptions {
    /// What a ray remembers of its way.
    pub form: TraversalForm,
    /// Compute in `f64` where the device can: hits are then those of the CPU.
    pub f64: bool,
    /// Leave out what the scene does not need.
    pub lean: bool,
    /// Put this part in though the scene does not need it.
    pub forced: Option<Part>,
    /// Take it that a binding holds no more bytes than these, whatever the device says: so tests have small scenes split over several.
    pub binding_bytes_max: Option<u64>,
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self { form: TraversalForm::default(), f64: true, lean: true, forced: None, binding_bytes_max: None }
    }
}

/// Columns and rows of a work-group (pixel.wgsl): 64 rays that begin beside each other, as in the paper.
pub(super) const GROUP_SIDE: u32 = 8;

/// Everything that decides about a kernel's text.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct KernelKey {
    pub(super) variant: Variant,
    /// Mirror and bent rays that a path may take.
    pub(super) depth: u32,
    pub(super) form: TraversalForm,
    pub(super) f64: bool,
    /// Bindings of slots and of words, and the logarithm of what each of several holds.
    pub(super) chunks: Chunks,
    /// What it is for.
    pub(super) purpose: Purpose,
}

/// How the slots and the words are split over bindings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Chunks {
    pub(super) slot_bindings: u32,
    pub(super) slots_log2: u32,
    pub(super) word_bindings: u32,
    pub(super) words_log2: u32,
}

impl Chunks {
    /// The binding after those of the scene.
    fn end(self) -> u32 {
        SLOT_BINDING + self.slot_bindings + self.word_bindings
    }
}

/// What a kernel does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Purpose {
    /// Pixels of jobs.
    Render,
    /// The rays behind single pixels, and what they hit.
    Probe,
    /// Given rays.
    Rays,
    /// A step of many paths: see wavefront.rs.
    Wave(Stage),
}

/// The kernels of wavefront.wgsl.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    Start,
    Turn,
    Extend,
    Shade,
}

impl Stage {
    /// All of them, in the order in which they run.
    pub(super) const ALL: [Self; 4] = [Self::Start, Self::Turn, Self::Extend, Self::Shade];
}

impl Purpose {
    pub(super) fn entry(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::Probe => "probe",
            Self::Rays => "trace_rays",
            Self::Wave(Stage::Start) => "wave_start",
            Self::Wave(Stage::Turn) => "wave_turn",
            Self::Wave(Stage::Extend) => "wave_extend",
            Self::Wave(Stage::Shade) => "wave_shade",
        }
    }
}

/// First binding of the slots; before it come scene, frame, jobs, pixels, sums and counts.
pub(super) const SLOT_BINDING: u32 = 6;

/// The text of a kernel: constants, bindings, and the rooms' files in the order of their doors.
pub(super) fn text(key: &KernelKey) -> String {
    let mut text = key.variant.constants(key.depth);
    text += "@group(0) @binding(0) var<uniform> scene: SceneInfo;\n\
             @group(0) @binding(1) var<uniform> frame: FrameInfo;\n\
             @group(0) @binding(2) var<storage, read> jobs: array<Job>;\n\
             @group(0) @binding(3) var<storage, read_write> pixels: array<u32>;\n\
             @group(0) @binding(4) var<storage, read_write> sums: array<vec4<f32>>;\n\
             @group(0) @binding(5) var<storage, read_write> ray_counts: array<atomic<u32>>;\n";
    let Chunks { slot_bindings, slots_log2, word_bindings, words_log2 } = key.chunks;
    split(&mut text, ("slot", "vec2<u32>"), SLOT_BINDING, slot_bindings, slots_log2);
    split(&mut text, ("word", "u32"), SLOT_BINDING + slot_bindings, word_bindings, words_log2);
    text = text.replace("fn slot(", "fn slot_at(");
    text += match key.purpose {
        Purpose::Render | Purpose::Wave(_) => "fn record(query: Query, hit: Hit) {}\n",
        Purpose::Probe | Purpose::Rays => include_str!("probe.wgsl"),
    };
    let precision = if key.f64 { geometry::F64 } else { geometry::F32 };
    let stack = match key.form {
        TraversalForm::PrivateStack | TraversalForm::Wavefront => kdtree::PRIVATE_STACK,
        TraversalForm::ShortStack => kdtree::SHORT_STACK,
    };
    let waiting = match key.purpose {
        Purpose::Wave(_) | Purpose::Probe | Purpose::Rays => whitted::WAVEFRONT,
        Purpose::Render => whitted::WAITING,
    };
    let rooms = geometry::COMMON.iter().chain(&precision).chain(&kdtree::COMMON).chain([&stack, &waiting]);
    for file in rooms.chain(&tessera_pack::device::WGSL).chain(&whitted::WGSL) {
        text += file;
    }
    // What a purpose has of its own comes after the scene.
    let waves = ["WAVE_STATES", "WAVE_QUEUES", "WAVE_GROUPS"];
    let probes = ["PROBE_INPUT", "PROBE_OUTPUT"];
    let own: Vec<&str> = match key.purpose {
        Purpose::Wave(_) => waves.to_vec(),
        Purpose::Render | Purpose::Probe | Purpose::Rays => probes.into_iter().chain(waves).collect(),
    };
    for (name, binding) in own.iter().zip(key.chunks.end()..) {
        text = text.replace(name, &binding.to_string());
    }
    mutated(text)
}

/// The bugs that can be planted in a text ([`tessera_geometry::mutation`]): what each replaces, and by what.
pub(super) const BUGS: [(Mutation, &str, &str); 4] = [
    (
        Mutation::GpuEdgesExclusive,
        "all(sides >= vec3<f32>(0.0)) || all(sides <= vec3<f32>(0.0))",
        "all(sides > vec3<f32>(0.0)) || all(sides < vec3<f32>(0.0))",
    ),
    (
        Mutation::GpuSwappedChildren,
        "let near = select(left, right, goes_down);",
        "let near = select(right, left, goes_down);",
    ),
    (
        Mutation::GpuNoClearance,
        "fn clearance(surface: Surface) -> f32 {",
        "fn clearance(surface: Surface) -> f32 { if true { return 0.0; }",
    ),
    (
        Mutation::GpuIorInverted,
        "let eta = select(paint.ior, quotient(1.0, paint.ior), entering);",
        "let eta = select(quotient(1.0, paint.ior), paint.ior, entering);",
    ),
];

/// `text` with the bug that is planted in it, if any.
fn mutated(text: String) -> String {
    match BUGS.into_iter().find(|&(mutation, ..)| is_on(mutation)) {
        Some((_, right, wrong)) => text.replace(right, wrong),
        None => text,
    }
}

/// An accessor `name(i)` over `count` bindings from `first` on, of 2^`log2` elements each.
fn split(text: &mut String, (name, element): (&str, &str), first: u32, count: u32, log2: u32) {
    for i in 0..count {
        let _ = writeln!(
            text,
            "@group(0) @binding({}) var<storage, read> {name}s_{i}: array<{element}>;",
            first + i
        );
    }
    let _ = writeln!(text, "fn {name}(i: u32) -> {element} {{");
    if count > 1 {
        let mask = (1u64 << log2) - 1;
        let _ = writeln!(text, "switch i >> {log2}u {{");
        for i in 1..count {
            let _ = writeln!(text, "case {i}u: {{ return {name}s_{i}[i & {mask}u]; }}");
        }
        let _ = writeln!(text, "default: {{ return {name}s_0[i & {mask}u]; }}\n}}");
    } else {
        let _ = writeln!(text, "return {name}s_0[i];");
    }
    let _ = writeln!(text, "}}");
}

/// What each binding is, by number.
pub(super) fn binding_types(chunks: Chunks, purpose: Purpose) -> Vec<(u32, BufferBindingType)> {
    let uniform = BufferBindingType::Uniform;
    let read = BufferBindingType::Storage { read_only: true };
    let write = BufferBindingType::Storage { read_only: false };
    let end = chunks.end();
    // A binding that a dispatch takes its size from cannot be written by a kernel that has it bound: only this one has.
    if purpose == Purpose::Wave(Stage::Turn) {
        return vec![(end + 1, write), (end + 2, write)];
    }
    let mut types = vec![uniform, uniform, read, write, write, write];
    types.extend((SLOT_BINDING..end).map(|_| read));
    match purpose {
        Purpose::Render => {}
        Purpose::Probe => types.extend([read, write, write, write]),
        Purpose::Rays => types.extend([read, write]),
        Purpose::Wave(_) => types.extend([write, write]),
    }
    (0..).zip(types).collect()
}

/// The layout of the one bind group.
pub(super) fn bind_group_layout(gpu: &Gpu, chunks: Chunks, purpose: Purpose) -> BindGroupLayout {
    let entry = |(binding, ty)| BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::COMPUTE,
        ty: BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let entries: Vec<_> = binding_types(chunks, purpose).into_iter().map(entry).collect();
    let descriptor = BindGroupLayoutDescriptor { label: None, entries: &entries };
    gpu.device().create_bind_group_layout(&descriptor)
}

/// A compiled kernel and the layout of what it reads.
pub(super) struct Kernel {
    pub(super) pipeline: ComputePipeline,
    pub(super) layout: BindGroupLayout,
    /// Bytes of its text.
    pub(super) text_bytes: usize,
}

/// Compiles a kernel.
pub(super) fn compile(gpu: &Gpu, key: &KernelKey) -> Result<Kernel, GpuError> {
    let text = text(key);
    let text_bytes = text.len();
    let layout = gpu.try_make(|| bind_group_layout(gpu, key.chunks, key.purpose))?;
    let pipeline = gpu.try_make(|| {
        let source = ShaderSource::Wgsl(Cow::Owned(text));
        let module = shader_module(gpu, ShaderModuleDescriptor { label: Some(key.purpose.entry()), source });
        let layouts = [Some(&layout)];
        let layout = gpu.device().create_pipeline_layout(&PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &layouts,
            immediate_size: 0,
        });
        gpu.device().create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(key.purpose.entry()),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(key.purpose.entry()),
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    })?;
    Ok(Kernel { pipeline, layout, text_bytes })
}

/// A module without checks at run time. On a software device they cost a few hundredths of a frame; on a GPU that was not measured.
#[expect(unsafe_code, reason = "every index was checked when the pack was taken in, and every loop ends")]
fn shader_module(gpu: &Gpu, descriptor: ShaderModuleDescriptor<'_>) -> wgpu::ShaderModule {
    // SAFETY: the kernels read a pack's sections at places that come from the pack alone, which was validated when it was taken in
    // (validate.rs of pack and of kdtree: every index lies in its section, the tree is a tree of at most `MAX_DEPTH`); write pixels, sums,
    // counts and states at places that `tiles.rs`, `wavefront.rs` and `probe.rs` have sized their buffers for; and keep no more waiting rays
    // than `Variant::path_stack` of a depth that `FrameParams::MAX_DEPTH` bounds, and for which the kernel was chosen. Loops run over lists,
    // levels, layers and waiting rays, each of which is bounded; a search ends whatever its numbers are, for each turn leaves a cell of the
    // tree behind. No divisor of an integer is 0.
    unsafe { gpu.device().create_shader_module_trusted(descriptor, ShaderRuntimeChecks::unchecked()) }
}
