//! What a scene does not need is left out of its pack; or forced in, for those who want to see what that saves.

use crate::build::{PackStats, Unneeded};
use crate::check::distinct_texels;
use crate::input::{ImageInput, PackInput};
use crate::mesh::{Runs, texture_slots};
use crate::records::{
    Camera, EnvironmentKind, Light, LightKind, Material, MaterialFlags, NO_TEXTURE, Texture,
};
use rayon::prelude::*;

/// A part that is packed though the scene does not need it, with content that changes no bit of any picture: the twin by which
/// leaving it out is measured and tested. Of a scene that needs the part it changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Forced {
    /// A normal of every vertex: the code or the vector that means 'none'.
    Normals,
    /// Texture coordinates of every vertex, (0, 0): the record's third word, or the section of plain ones.
    Uvs,
    /// The same, each in the side table with the value that its packed form has.
    SideUvs,
    /// A white and opaque colour of every vertex.
    Colors,
    /// A white texel as the base texture of every material, and the texture coordinates that it takes.
    Textures,
    /// The only material a second time, for the second half of the triangles.
    Materials,
    /// The original id of every triangle by itself.
    IdRuns,
    /// Lights that bring nothing: those of the input, and where there are none a dark one.
    Lights,
    /// The record that says that a miss is black and transparent.
    Environment,
    /// A view.
    Cameras,
    /// Materials of no triangle, images that nothing shows, and flags and texture slots without effect.
    Unused,
}

impl Forced {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Normals,
        Self::Uvs,
        Self::SideUvs,
        Self::Colors,
        Self::Textures,
        Self::Materials,
        Self::IdRuns,
        Self::Lights,
        Self::Environment,
        Self::Cameras,
        Self::Unused,
    ];

    /// For people and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normals => "normals",
            Self::Uvs => "uvs",
            Self::SideUvs => "side-uvs",
            Self::Colors => "colors",
            Self::Textures => "textures",
            Self::Materials => "materials",
            Self::IdRuns => "id-runs",
            Self::Lights => "lights",
            Self::Environment => "environment",
            Self::Cameras => "cameras",
            Self::Unused => "unused",
        }
    }
}

/// Empties what the scene does not need, before anything is done with it.
pub(crate) fn leave_out(input: &mut PackInput, stats: &mut PackStats) {
    if input.uvs.is_empty() {
        stats.leave_out("uv", "the scene has no texture coordinates");
    } else if input.materials.iter().all(|m| texture_slots(m).next().is_none()) {
        stats.leave_out("uv", "no material has a texture");
        input.uvs = Vec::new();
    }
    if input.normals.is_empty() {
        stats.leave_out("normal", "the scene has no shading normals");
    } else if !input.materials.is_empty() && input.materials.iter().all(is_unlit) {
        stats.leave_out("normal", "no material is lit");
        input.normals = Vec::new();
    }
    // What is neither masked nor blended is opaque, whatever its alpha.
    let shows_alpha = input.materials.iter().any(|m| m.flags & ALPHA != 0);
    let is_white = |c: &[u8; 4]| c[..3] == [255; 3] && (c[3] == 255 || !shows_alpha);
    if input.colors.is_empty() {
        stats.leave_out("color", "the scene has no vertex colours");
    } else if input.colors.par_iter().all(is_white) {
        stats.leave_out("color", "every vertex colour is white");
        input.colors = Vec::new();
    }
    if input.textures.is_empty() {
        stats.leave_out("texture", "the scene has no textures");
    }
    if input.lights.is_empty() {
        stats.leave_out("light", "the scene has no lights");
    }
    if input.environment.kind == EnvironmentKind::None as u32 {
        stats.leave_out("environ", "a miss is black and transparent");
    }
}

/// The same once the triangles are known that are packed: also drops materials, texture slots, textures, lights and flags that change
/// no picture of them. `material_runs` ascend by material, each in one run.
pub(crate) fn leave_out_unused(
    input: &mut PackInput,
    material_runs: &mut Runs,
    forced: Option<Forced>,
    stats: &mut PackStats,
) {
    if input.triangles.is_empty() {
        return;
    }
    if forced != Some(Forced::Unused) {
        drop_materials(input, material_runs, stats);
        drop_slots(input, stats);
        drop_textures(input, stats);
        drop_alpha(input, stats);
    }
    if forced != Some(Forced::Lights) {
        drop_lights(input, stats);
    }
    leave_out(input, stats);
}

const ALPHA: u32 = MaterialFlags::ALPHA_MASK | MaterialFlags::ALPHA_BLEND;

fn is_unlit(m: &Material) -> bool {
    m.flags & MaterialFlags::UNLIT != 0
}

/// Drops materials of no triangle.
fn drop_materials(input: &mut PackInput, material_runs: &mut Runs, stats: &mut PackStats) {
    let count = input.materials.len() - material_runs.len();
    let used = material_runs.iter().map(|run| input.materials[run[1] as usize]);
    input.materials = used.collect();
    for (run, place) in material_runs.iter_mut().zip(0..) {
        run[1] = place;
    }
    stats.drop_unneeded("material", "no packed triangle uses them", count, count * size_of::<Material>());
}

/// Drops texture slots that change nothing: all where no texture coordinates are, those that an unlit material does not show, and
/// those that multiply a factor of 0.
fn drop_slots(input: &mut PackInput, stats: &mut PackStats) {
    let has_uvs = !input.uvs.is_empty();
    let mut count = 0;
    for m in &mut input.materials {
        let is_lit = has_uvs && !is_unlit(m);
        let (emits, transmits) = (m.emissive != [0.0; 3], m.transmission > 0.0);
        for (slot, has_effect) in [
            (&mut m.base_texture, has_uvs),
            (&mut m.metallic_roughness_texture, is_lit),
            (&mut m.emissive_texture, is_lit && emits),
            (&mut m.transmission_texture, is_lit && transmits),
        ] {
            count += usize::from(*slot != NO_TEXTURE && !has_effect);
            *slot = if has_effect { *slot } else { NO_TEXTURE };
        }
    }
    stats.drop_unneeded("use of a texture", "it has no effect", count, 0);
}

/// Drops textures that neither a surface nor the sky shows.
fn drop_textures(input: &mut PackInput, stats: &mut PackStats) {
    let mut is_used = vec![false; input.textures.len()];
    let shown = input.materials.iter().flat_map(texture_slots);
    for slot in shown.chain((input.environment.texture != NO_TEXTURE).then_some(input.environment.texture)) {
        is_used[slot as usize] = true;
    }
    let count = is_used.iter().filter(|used| !**used).count();
    if count == 0 {
        return;
    }
    let before = distinct_texels(&input.textures);
    let mut places = vec![NO_TEXTURE; is_used.len()];
    for (place, (to, _)) in (0..).zip(places.iter_mut().zip(&is_used).filter(|(_, used)| **used)) {
        *to = place;
    }
    let mut used = is_used.iter();
    input.textures.retain(|_| used.next() == Some(&true));
    let move_to = |slot: &mut u32| *slot = places.get(*slot as usize).copied().unwrap_or(NO_TEXTURE);
    for m in &mut input.materials {
        let Material {
            base_texture, metallic_roughness_texture, emissive_texture, transmission_texture, ..
        } = m;
        [base_texture, metallic_roughness_texture, emissive_texture, transmission_texture]
            .into_iter()
            .for_each(move_to);
    }
    move_to(&mut input.environment.texture);
    let texels = (before - distinct_texels(&input.textures)) as usize;
    let bytes = count * size_of::<Texture>() + texels * size_of::<u32>();
    stats.drop_unneeded("texture", "neither a surface nor the sky shows them", count, bytes);
    if input.textures.is_empty() {
        stats.leave_out("texture", "neither a surface nor the sky shows one");
    }
}

/// Takes masks and blending off materials that are opaque everywhere: then no hit is tested for a hole, and no ray goes on behind it.
///
/// What is tested is exact: textures of alpha 255 alone, interpolated, give 1, and so do vertex colours; a product with 1 is the
/// factor itself.
fn drop_alpha(input: &mut PackInput, stats: &mut PackStats) {
    let shows_alpha = |m: &&mut Material| m.flags & ALPHA != 0;
    if input.materials.iter_mut().all(|m| !shows_alpha(&m)) || input.colors.par_iter().any(|c| c[3] != 255) {
        return;
    }
    let textures = &input.textures;
    let is_opaque = |t: &ImageInput| t.rgba.par_chunks_exact(4).all(|c| c[3] == 255);
    let mut count = 0;
    for m in input.materials.iter_mut().filter(shows_alpha) {
        let enough = if m.flags & MaterialFlags::ALPHA_MASK != 0 { m.alpha_cutoff } else { 1.0 };
        let texture = textures.get(m.base_texture as usize);
        if m.base_color[3] >= enough && texture.is_none_or(is_opaque) {
            m.flags &= !ALPHA;
            count += 1;
        }
    }
    stats.drop_unneeded("mask or blending", "the material is opaque everywhere", count, 0);
}

/// Drops lights that bring nothing.
fn drop_lights(input: &mut PackInput, stats: &mut PackStats) {
    let all = input.lights.len();
    let is_dark = |light: &Light| light.intensity == [0.0; 3];
    let nothing_is_lit = input.materials.iter().all(is_unlit);
    let mut kept =
        input.lights.iter().map(|light| !is_dark(light) && !nothing_is_lit).collect::<Vec<_>>().into_iter();
    let mut kept_too = kept.clone();
    input.lights.retain(|_| kept.next() == Some(true));
    input.light_positions.retain(|_| kept_too.next() == Some(true));
    let why = if nothing_is_lit { "no material is lit" } else { "their intensity is 0" };
    let count = all - input.lights.len();
    stats.drop_unneeded("light", why, count, count * size_of::<Light>());
    if count > 0 && input.lights.is_empty() {
        stats.leave_out("light", if nothing_is_lit { why } else { "every light's intensity is 0" });
    }
}

/// Puts `forced` into what is to be packed; `ids` are the triangles' original ids.
pub(crate) fn force_in(
    input: &mut PackInput,
    material_runs: &mut Runs,
    id_runs: &mut Runs,
    ids: &[u32],
    forced: Option<Forced>,
) {
    let vertices = input.positions.len();
    match forced {
        Some(Forced::Normals) if input.normals.is_empty() => input.normals = vec![[0.0; 3]; vertices],
        Some(Forced::Uvs | Forced::SideUvs) if input.uvs.is_empty() => input.uvs = vec![[0.0; 2]; vertices],
        Some(Forced::Colors) if input.colors.is_empty() => input.colors = vec![[255; 4]; vertices],
        Some(Forced::Textures) if input.uvs.is_empty() => {
            input.uvs = vec![[0.0; 2]; vertices];
            // Without texture coordinates no slot is in use.
            let white = input.textures.len() as u32;
            input.materials.iter_mut().for_each(|m| m.base_texture = white);
            let name = "white".into();
            input.textures.push(ImageInput {
                name,
                width: 1,
                height: 1,
                rgba: [255; 4].into(),
                ..Default::default()
            });
        }
        Some(Forced::Materials) => {
            if let ([run], half @ 1..) = (&material_runs[..], ids.len() as u32 / 2) {
                let [_, material] = *run;
                let twin = input.materials.len() as u32;
                input.materials.push(input.materials[material as usize]);
                material_runs.push([half, twin]);
            }
        }
        Some(Forced::IdRuns) => *id_runs = (0..).zip(ids).map(|(place, &id)| [place, id]).collect(),
        Some(Forced::Cameras) if input.cameras.is_empty() => input.cameras.push(Camera {
            eye: [0.0, 0.0, 1.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov_degrees: 45.0,
            name: Camera::encode_name("forced"),
        }),
        _ => {}
    }
}

/// A light that brings nothing.
pub(crate) const DARK: Light = Light {
    position: [0.0; 3],
    kind: LightKind::Directional as u32,
    direction: [0.0, -1.0, 0.0],
    range: f32::INFINITY,
    intensity: [0.0; 3],
    cos_inner: 1.0,
    cos_outer: 0.0,
    reserved: [0; 3],
};

impl PackStats {
    /// Says once why a section is left out: the first reason is the nearest to the input.
    pub(crate) fn leave_out(&mut self, section: &'static str, why: &str) {
        if self.left_out.iter().all(|(known, _)| *known != section) {
            self.left_out.push((section, why.into()));
        }
    }

    fn drop_unneeded(&mut self, what: &'static str, why: &'static str, count: usize, bytes: usize) {
        if count > 0 {
            self.unneeded.push(Unneeded { what, why, count: count as u64, bytes: bytes as u64 });
        }
    }
}
