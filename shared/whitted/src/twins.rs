//! What the kernels' text for GPUs must agree with, as tables: a test parses the text and compares.

use crate::device::{BackdropInfo, FrameInfo, Job, SceneInfo};
use crate::{FrameParams, light, path, shade, surface};
use std::any::type_name;
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, PI, TAU};
use tessera_geometry::rounding::gamma;

/// Where the members of a struct lie.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The struct's name in the text.
    pub twin: &'static str,
    /// Its bytes.
    pub size: usize,
    /// In their order: name, first byte, type as Rust writes it. What is reserved, or a gap, is no member.
    pub members: Vec<(&'static str, usize, &'static str)>,
}

/// All structs that are written here and read there.
pub fn layouts() -> [Layout; 4] {
    fn type_of<S, T>(_: fn(&S) -> &T) -> &'static str {
        type_name::<T>()
    }
    macro_rules! layout {
        ($name:ident, $twin:literal, $($member:ident)*, gaps $($gap:ident)*) => {{
            // None is forgotten.
            let _ = |$name { $($member: _,)* $($gap: _,)* }: $name| ();
            let members = [$((
                stringify!($member),
                std::mem::offset_of!($name, $member),
                type_of(|s: &$name| &s.$member),
            )),*];
            Layout { twin: $twin, size: size_of::<$name>(), members: members.to_vec() }
        }};
    }
    [
        layout!(BackdropInfo, "Backdrop",
            up kind zenith image horizon nadir ahead right, gaps gap_a gap_b gap_c gap_d),
        layout!(SceneInfo, "SceneInfo",
            root_min light_count root_max material_run_count bias id_run_count ambient side_uv_count
            at_list at_faces at_records at_cells at_positions at_normals at_uvs at_side_uvs at_colors
            at_material_runs at_id_runs at_materials at_textures at_texels at_lights at_normal_table
            at_srgb at_thresholds step_mantissa step_rest step_power backdrop, gaps reserved),
        layout!(FrameInfo, "FrameInfo",
            eye width forward height right samples up max_depth seed_low seed_high features format zero
            sampler cutoff is_adaptive, gaps),
        layout!(Job, "Job",
            x y width height first_sample end_sample round_first round_end at_pixels first_block, gaps),
    ]
}

/// Constants of the text and the bits that they must have.
pub fn constants() -> [(&'static str, u32); 12] {
    [
        ("MAX_LAYERS", path::MAX_LAYERS),
        ("LEAST_SENT", shade::LEAST_SENT.to_bits()),
        ("MAX_IRRADIANCE", light::MAX_IRRADIANCE.to_bits()),
        ("GAMMA_3", gamma(3).to_bits()),
        ("POINT_ERROR", gamma(7).to_bits()),
        ("LEAST_COSINE", surface::LEAST_COSINE.to_bits()),
        ("MAX_EXPONENT", shade::MAX_EXPONENT.to_bits()),
        ("EIGHT_PI", (8.0 * PI).to_bits()),
        ("PI", PI.to_bits()),
        ("TAU", TAU.to_bits()),
        ("FRAC_1_PI", FRAC_1_PI.to_bits()),
        ("FRAC_PI_2", FRAC_PI_2.to_bits()),
    ]
}

/// The word of [`FrameInfo`] that is called `member`, of `params`.
pub fn frame_word(params: &FrameParams, member: &str) -> Option<u32> {
    let [_, _, frame, _] = layouts();
    let (_, offset, _) = frame.members.into_iter().find(|(name, ..)| *name == member)?;
    bytemuck::cast_slice(bytemuck::bytes_of(&FrameInfo::of(params))).get(offset / 4).copied()
}
