//! What a record must keep, whether it comes from a scene or from a file.

use crate::records::{
    Camera, Environment, EnvironmentKind, Light, LightKind, Material, MaterialFlags, NO_TEXTURE, Texture,
    Wrap,
};

/// Largest side of a texture: texel coordinates then have 8 bits of `f32` left for interpolation.
pub const MAX_TEXTURE_SIDE: u32 = 1 << 16;

/// How far from 1 the squared length of a stored unit vector may be. Rounding three components to `f32` moves it by less than
/// 2^-22; this leaves room for vectors that were normalised in lower precision, and none for vectors that never were.
const UNIT_TOLERANCE: f32 = 1e-3;

/// The first rule that a record breaks.
pub(crate) type Fault = Option<&'static str>;

pub(crate) fn material_fault(m: &Material, textures: usize) -> Fault {
    let slots = [m.base_texture, m.metallic_roughness_texture, m.emissive_texture, m.transmission_texture];
    let shares = [m.metallic, m.roughness, m.transmission];
    if !all_in_unit_range(&m.base_color) {
        Some("base_color is not in [0, 1]")
    } else if !all_in_unit_range(&m.specular) {
        Some("specular is not in [0, 1]")
    } else if !all_in_unit_range(&shares) {
        Some("metallic, roughness or transmission is not in [0, 1]")
    } else if !all_finite_and_positive(&m.emissive) {
        Some("emissive is negative or not finite")
    } else if !(m.ior.is_finite() && m.ior > 0.0) {
        Some("ior is not finite and positive")
    } else if !m.alpha_cutoff.is_finite() {
        Some("alpha_cutoff is not finite")
    } else if m.flags & !MaterialFlags::ALL != 0 {
        Some("unknown flags")
    } else if m.flags & MaterialFlags::ALPHA_MASK != 0 && m.flags & MaterialFlags::ALPHA_BLEND != 0 {
        Some("alpha is both masked and blended")
    } else if slots.iter().any(|&t| t != NO_TEXTURE && t as usize >= textures) {
        Some("a texture that does not exist")
    } else {
        None
    }
}

/// `texels` is the length of the texel section.
pub(crate) fn texture_fault(t: &Texture, texels: u64) -> Fault {
    if !(1..=MAX_TEXTURE_SIDE).contains(&t.width) || !(1..=MAX_TEXTURE_SIDE).contains(&t.height) {
        Some("width or height is not in 1..=65536")
    } else if u64::from(t.first_texel) + u64::from(t.width) * u64::from(t.height) > texels {
        Some("texels beyond the texel section")
    } else if t.sampling >> 5 != 0 || wrap_of(t.sampling).is_none() || wrap_of(t.sampling >> 2).is_none() {
        Some("unknown sampling bits")
    } else {
        None
    }
}

fn wrap_of(bits: u32) -> Option<Wrap> {
    match bits & 3 {
        0 => Some(Wrap::Repeat),
        1 => Some(Wrap::Mirror),
        2 => Some(Wrap::Clamp),
        _ => None,
    }
}

pub(crate) fn light_fault(l: &Light) -> Fault {
    let spot = l.kind == LightKind::Spot as u32;
    let directional = l.kind == LightKind::Directional as u32;
    if !spot && !directional && l.kind != LightKind::Point as u32 {
        Some("unknown kind")
    } else if l.position.iter().chain(&l.direction).any(|x| !x.is_finite()) {
        Some("position or direction is not finite")
    } else if (spot || directional) && !is_unit(l.direction) {
        Some("direction is not a unit vector")
    } else if l.range.is_nan() || l.range <= 0.0 {
        Some("range is not positive")
    } else if !all_finite_and_positive(&l.intensity) {
        Some("intensity is negative or not finite")
    } else if !(l.cos_inner.is_finite() && l.cos_outer.is_finite()) {
        Some("a cosine is not finite")
    } else if spot && !(-1.0 <= l.cos_outer && l.cos_outer < l.cos_inner && l.cos_inner <= 1.0) {
        Some("cosines are not -1 <= cos_outer < cos_inner <= 1")
    } else if l.reserved != [0; 3] {
        Some("reserved words are not zero")
    } else {
        None
    }
}

pub(crate) fn environment_fault(e: &Environment, textures: usize) -> Fault {
    let map = e.kind == EnvironmentKind::Map as u32;
    if !map && e.kind != EnvironmentKind::None as u32 && e.kind != EnvironmentKind::Gradient as u32 {
        Some("unknown kind")
    } else if !(all_finite_and_positive(&e.zenith)
        && all_finite_and_positive(&e.horizon)
        && all_finite_and_positive(&e.nadir))
    {
        Some("radiance is negative or not finite")
    } else if !is_unit(e.up) {
        Some("up is not a unit vector")
    } else if map && e.texture as usize >= textures {
        Some("a map without an existing texture")
    } else if !map && e.texture != NO_TEXTURE {
        Some("a texture that is not used")
    } else if e.reserved != 0 || e.reserved2 != 0 {
        Some("reserved words are not zero")
    } else {
        None
    }
}

pub(crate) fn camera_fault(c: &Camera) -> Fault {
    if c.eye.iter().chain(&c.target).chain(&c.up).any(|x| !x.is_finite()) {
        Some("eye, target or up is not finite")
    } else if !(c.fov_degrees > 0.0 && c.fov_degrees < 180.0) {
        Some("fov_degrees is not in (0, 180)")
    } else if c.name().is_none() {
        Some("name is not UTF-8 padded with zeros, or has control characters")
    } else {
        None
    }
}

pub(crate) fn ambient_fault(radiance: &[f32; 3]) -> Fault {
    (!all_finite_and_positive(radiance)).then_some("ambient radiance is negative or not finite")
}

pub(crate) fn is_unit(v: [f32; 3]) -> bool {
    // NaN compares false.
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0).abs() <= UNIT_TOLERANCE
}

fn all_in_unit_range(values: &[f32]) -> bool {
    values.iter().all(|v| (0.0..=1.0).contains(v))
}

fn all_finite_and_positive(values: &[f32]) -> bool {
    values.iter().all(|v| v.is_finite() && *v >= 0.0)
}
