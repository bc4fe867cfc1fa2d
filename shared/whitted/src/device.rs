//! What a GPU's kernels are told about the scene, the frame and the pixels to render; the twins of the structures in device.wgsl.

use crate::color::encode_srgb;
use crate::environment::level_ahead;
use crate::pixel::straight_codes;
use crate::sample::Sampler;
use crate::{FrameParams, PixelFormat};
use bytemuck::{Pod, Zeroable};
use tessera_geometry::Vec3;
use tessera_pack::device::{DeviceWords, Places};
use tessera_pack::{EnvironmentKind, Pack};

/// The text of shading, in no particular order.
pub const WGSL: [&str; 11] = [
    include_str!("maths.wgsl"),
    include_str!("color.wgsl"),
    include_str!("device.wgsl"),
    include_str!("environment.wgsl"),
    include_str!("light.wgsl"),
    include_str!("path.wgsl"),
    include_str!("pixel.wgsl"),
    include_str!("sample.wgsl"),
    include_str!("shade.wgsl"),
    include_str!("surface.wgsl"),
    include_str!("texture.wgsl"),
];

/// The text of waiting rays, for kernels that follow a path from its beginning to its end.
pub const WAITING: &str = include_str!("waiting.wgsl");

/// The text, instead of [`WAITING`], of kernels that take paths step by step.
pub const WAVEFRONT: &str = include_str!("wavefront.wgsl");

/// `vec4`s of a path between two steps, of which at most `path_stack` rays wait: `ROW_*` in wavefront.wgsl.
pub const fn state_quads(path_stack: u32) -> u32 {
    24 + 3 * path_stack.saturating_sub(1)
}

/// An environment taken apart; `Backdrop` in environment.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BackdropInfo {
    pub(crate) up: [f32; 3],
    pub(crate) kind: u32,
    pub(crate) zenith: [f32; 3],
    pub(crate) image: u32,
    pub(crate) horizon: [f32; 3],
    pub(crate) gap_a: u32,
    pub(crate) nadir: [f32; 3],
    pub(crate) gap_b: u32,
    pub(crate) ahead: [f32; 3],
    pub(crate) gap_c: u32,
    pub(crate) right: [f32; 3],
    pub(crate) gap_d: u32,
}

const _: () = assert!(size_of::<BackdropInfo>() == 96);

/// The scene; `SceneInfo` in device.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SceneInfo {
    pub(crate) root_min: [f32; 3],
    pub(crate) light_count: u32,
    pub(crate) root_max: [f32; 3],
    pub(crate) material_run_count: u32,
    pub(crate) bias: [f32; 3],
    pub(crate) id_run_count: u32,
    pub(crate) ambient: [f32; 3],
    pub(crate) side_uv_count: u32,
    pub(crate) at_list: u32,
    pub(crate) at_faces: u32,
    pub(crate) at_records: u32,
    pub(crate) at_cells: u32,
    pub(crate) at_positions: u32,
    pub(crate) at_normals: u32,
    pub(crate) at_uvs: u32,
    pub(crate) at_side_uvs: u32,
    pub(crate) at_colors: u32,
    pub(crate) at_material_runs: u32,
    pub(crate) at_id_runs: u32,
    pub(crate) at_materials: u32,
    pub(crate) at_textures: u32,
    pub(crate) at_texels: u32,
    pub(crate) at_lights: u32,
    pub(crate) at_normal_table: u32,
    pub(crate) at_srgb: u32,
    pub(crate) at_thresholds: u32,
    pub(crate) step_mantissa: f32,
    pub(crate) step_rest: f32,
    pub(crate) step_power: f32,
    pub(crate) reserved: [u32; 3],
    pub(crate) backdrop: BackdropInfo,
}

const _: () = assert!(size_of::<SceneInfo>() == 256);

impl SceneInfo {
    /// That of `pack`, whose words lie as `words` says with [`code_thresholds`] at the end.
    pub fn of(pack: &Pack, words: &DeviceWords<'_>) -> Self {
        let head = pack.head();
        let Places { list, faces, records, cells, positions, normals, uvs, side_uvs, colors, .. } =
            words.places;
        let Places {
            material_runs,
            id_runs,
            materials,
            textures,
            texels,
            lights,
            normal_table,
            srgb,
            extra,
            ..
        } = words.places;
        let [step_mantissa, step_rest, step_power] = step_parts(head.step);
        let environment = pack.environment();
        let up = Vec3::from(environment.up);
        let ahead =
            if environment.kind == EnvironmentKind::Map as u32 { level_ahead(up) } else { Vec3::ZERO };
        Self {
            root_min: head.root_min,
            light_count: pack.lights().len() as u32,
            root_max: head.root_max,
            material_run_count: pack.material_run_count(),
            bias: pack.voxel_bias(),
            id_run_count: pack.id_run_count(),
            ambient: head.ambient,
            side_uv_count: pack.side_uv_count(),
            at_list: list,
            at_faces: faces,
            at_records: records,
            at_cells: cells,
            at_positions: positions,
            at_normals: normals,
            at_uvs: uvs,
            at_side_uvs: side_uvs,
            at_colors: colors,
            at_material_runs: material_runs,
            at_id_runs: id_runs,
            at_materials: materials,
            at_textures: textures,
            at_texels: texels,
            at_lights: lights,
            at_normal_table: normal_table,
            at_srgb: srgb,
            at_thresholds: extra,
            step_mantissa,
            step_rest,
            step_power,
            reserved: [0; 3],
            backdrop: BackdropInfo {
                up: environment.up,
                kind: environment.kind,
                zenith: environment.zenith,
                image: environment.texture,
                horizon: environment.horizon,
                nadir: environment.nadir,
                ahead: ahead.into(),
                right: ahead.cross(up).into(),
                ..BackdropInfo::zeroed()
            },
        }
    }
}

/// `step` as `(mantissa + rest) * power`: the sum in [1, 2] with 48 bits, the power held to the normal numbers of `f32`.
fn step_parts(step: f64) -> [f32; 3] {
    let exponent = (step.to_bits() >> 52) as i32 - 1023;
    let held = exponent.clamp(-126, 127);
    let power = f32::from_bits(((held + 127) as u32) << 23);
    // (A scene whose voxel has no normal f32 for a side has no distances in f32 either.)
    let mantissa = f64::from_bits(step.to_bits() & ((1 << 52) - 1) | 1023 << 52);
    let first = mantissa as f32;
    [first, (mantissa - f64::from(first)) as f32, power]
}

/// The least linear value whose 8-bit sRGB code is at least `i`, for each `i`: by these a GPU codes colours as the CPU does.
pub fn code_thresholds() -> [f32; 256] {
    std::array::from_fn(|code| {
        // Codes ascend with the value, and values of one sign with their bits.
        let (mut low, mut high) = (0.0f32.to_bits(), 1.0f32.to_bits());
        while low < high {
            let middle = low.midpoint(high);
            if usize::from(encode_srgb(f32::from_bits(middle), 255.0)) >= code {
                high = middle
            } else {
                low = middle + 1
            }
        }
        f32::from_bits(low)
    })
}

/// The frame; `FrameInfo` in device.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FrameInfo {
    pub(crate) eye: [f32; 3],
    pub(crate) width: u32,
    pub(crate) forward: [f32; 3],
    pub(crate) height: u32,
    pub(crate) right: [f32; 3],
    pub(crate) samples: u32,
    pub(crate) up: [f32; 3],
    pub(crate) max_depth: u32,
    pub(crate) seed_low: u32,
    pub(crate) seed_high: u32,
    pub(crate) features: u32,
    pub(crate) format: u32,
    pub(crate) zero: u32,
    pub(crate) sampler: u32,
    pub(crate) cutoff: f32,
    pub(crate) is_adaptive: u32,
}

const _: () = assert!(size_of::<FrameInfo>() == 96);

impl FrameInfo {
    /// That of a frame.
    pub fn of(params: &FrameParams) -> Self {
        let FrameParams { camera, features, sampling, .. } = params;
        Self {
            eye: camera.origin.into(),
            width: params.width,
            forward: camera.forward.into(),
            height: params.height,
            right: camera.right.into(),
            samples: params.samples.max(1),
            up: camera.up.into(),
            max_depth: params.max_depth.min(FrameParams::MAX_DEPTH),
            seed_low: params.frame as u32,
            seed_high: (params.frame >> 32) as u32,
            features: u32::from(features.shadows)
                | u32::from(features.reflection) << 1
                | u32::from(features.refraction) << 2,
            format: match device_format(params) {
                PixelFormat::Rgba8 => 0,
                PixelFormat::Rgba16 => 1,
                PixelFormat::Layers => 2,
            },
            zero: 0,
            sampler: match sampling.sampler {
                Sampler::Jittered => 0,
                Sampler::LowDiscrepancy => 1,
            },
            cutoff: sampling.cutoff,
            is_adaptive: params.adaptive().is_some().into(),
        }
    }
}

/// Pixels to render; `Job` in device.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Job {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// First sample of this pass.
    pub first_sample: u32,
    /// The sample after its last one.
    pub end_sample: u32,
    /// First sample of the round: that of its first pass.
    pub round_first: u32,
    /// The sample after its last one, with which its last pass ends. Without adaptive sampling the frame's samples are one round.
    pub round_end: u32,
    /// First word of its pixels in the buffer of pixels.
    pub at_pixels: u32,
    /// First of its blocks of 8 x 8 pixels, those of the jobs before it counted.
    pub first_block: u32,
}

const _: () = assert!(size_of::<Job>() == 40);

/// What the pixels of a frame are in a GPU's buffer. With adaptive sampling the host codes colours, of the sums of all rounds.
pub fn device_format(params: &FrameParams) -> PixelFormat {
    match params.format {
        PixelFormat::Rgba8 if params.adaptive().is_some() => PixelFormat::Rgba16,
        format => format,
    }
}

/// Words of a pixel in a GPU's buffer: 8-bit codes; or linear colour, premultiplied, and alpha as `f32`; or the layers as they are.
pub const fn words_per_pixel(format: PixelFormat) -> u32 {
    match format {
        PixelFormat::Rgba8 => 1,
        PixelFormat::Rgba16 => 4,
        PixelFormat::Layers => 9,
    }
}

/// The codes of [`PixelFormat::Rgba16`] for a linear colour, premultiplied, and its alpha.
pub fn encode_rgba16(color: [f32; 3], alpha: f32) -> [u8; 8] {
    let codes = straight_codes(color.into(), alpha, 65535.0);
    let mut bytes = [0; 8];
    for (to, code) in bytes.chunks_exact_mut(2).zip(codes) {
        to.copy_from_slice(&code.to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_where_codes_begin() {
        let thresholds = code_thresholds();
        assert_eq!((thresholds[0], encode_srgb(1.0, 255.0)), (0.0, 255));
        for (code, &least) in thresholds.iter().enumerate().skip(1) {
            assert_eq!(usize::from(encode_srgb(least, 255.0)), code);
            assert_eq!(usize::from(encode_srgb(least.next_down(), 255.0)), code - 1);
        }
    }

    #[test]
    fn states_have_room_for_the_rays_that_wait() {
        assert!(WAVEFRONT.contains(&format!("const ROW_WAITING: u32 = {}u;", state_quads(1))));
        assert_eq!(state_quads(4), state_quads(1) + 3 * 3);
    }

    #[test]
    fn steps_come_back() {
        for step in [1.0, 0.1, 1.5e-7, 3e12, 1.0 - f64::EPSILON, 1e-36, 1e38] {
            let [mantissa, rest, power] = step_parts(step).map(f64::from);
            let back = (mantissa + rest) * power;
            assert!((back - step).abs() <= step / 281_474_976_710_656.0, "{step}: {back}");
            assert!((1.0..=2.0).contains(&mantissa));
        }
        assert_eq!(step_parts(1e-300)[2], f32::MIN_POSITIVE);
    }
}
