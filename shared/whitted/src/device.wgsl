// Sibling of device.rs: what the kernels are told about the scene, the frame and the pixels to render.

/// `at_*` are places of words: see sections.wgsl.
struct SceneInfo {
    root_min: vec3<f32>,
    light_count: u32,
    root_max: vec3<f32>,
    material_run_count: u32,
    bias: vec3<f32>,
    id_run_count: u32,
    ambient: vec3<f32>,
    side_uv_count: u32,
    at_list: u32,
    at_faces: u32,
    at_records: u32,
    at_cells: u32,
    at_positions: u32,
    at_normals: u32,
    at_uvs: u32,
    at_side_uvs: u32,
    at_colors: u32,
    at_material_runs: u32,
    at_id_runs: u32,
    at_materials: u32,
    at_textures: u32,
    at_texels: u32,
    at_lights: u32,
    at_normal_table: u32,
    at_srgb: u32,
    at_thresholds: u32,
    /// `(step_mantissa + step_rest) * step_power` is the world's length of a local unit: the sum lies in [1, 2] and has 48 bits.
    step_mantissa: f32,
    step_rest: f32,
    step_power: f32,
    reserved_a: u32,
    reserved_b: u32,
    reserved_c: u32,
    backdrop: Backdrop,
}

struct FrameInfo {
    eye: vec3<f32>,
    width: u32,
    forward: vec3<f32>,
    height: u32,
    right: vec3<f32>,
    samples: u32,
    up: vec3<f32>,
    max_depth: u32,
    seed_low: u32,
    seed_high: u32,
    /// FEATURE_* bits.
    features: u32,
    /// FORMAT_*.
    format: u32,
    /// 0; see arithmetic.wgsl.
    zero: u32,
    /// SAMPLER_*.
    sampler: u32,
    /// Weight below which a ray is not traced.
    cutoff: f32,
    /// 1 where the host divides the samples of a pixel into rounds, and is given the sum of each round.
    is_adaptive: u32,
}

/// Pixels to render, and where they go.
struct Job {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    /// The samples to take now, of those of the round: its first pass begins where it does, and its last one ends there.
    first_sample: u32,
    end_sample: u32,
    /// The samples whose sum is wanted: from 0 to `frame.samples` where there is one round.
    round_first: u32,
    round_end: u32,
    /// The first word of its pixels.
    at_pixels: u32,
    /// The first of its blocks of 8 x 8 pixels, those of the jobs before it counted: see wavefront.wgsl.
    first_block: u32,
}

const FEATURE_SHADOWS: u32 = 1u;
const FEATURE_REFLECTION: u32 = 2u;
const FEATURE_REFRACTION: u32 = 4u;

const SAMPLER_JITTERED: u32 = 0u;
const SAMPLER_LOW_DISCREPANCY: u32 = 1u;

const FORMAT_RGBA8: u32 = 0u;
const FORMAT_RGBA16: u32 = 1u;
const FORMAT_LAYERS: u32 = 2u;

fn has_feature(feature: u32) -> bool {
    return (frame.features & feature) != 0u;
}

/// A local length in world units.
fn world_length(local: f32) -> f32 {
    let product = exact_product(local, scene.step_mantissa);
    return times(product.x + kept(product.y + times(local, scene.step_rest)), scene.step_power);
}
