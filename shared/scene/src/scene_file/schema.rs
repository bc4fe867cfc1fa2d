//! The keys of a scene file.

use crate::generate::{Kind, Recipe};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use toml::Spanned;

/// A whole scene file. Lengths are in the source's units, colours linear.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Document {
    pub(super) source: Option<Spanned<PathBuf>>,
    pub(super) generate: Option<Spanned<Generate>>,
    #[serde(default)]
    pub(super) up: Up,
    #[serde(default)]
    pub(super) normals: Normals,
    #[serde(default)]
    pub(super) lights: Lights,
    pub(super) default_camera: Option<Spanned<String>>,
    pub(super) ambient: Option<Spanned<[f32; 3]>>,
    #[serde(default)]
    pub(super) camera: Vec<Spanned<CameraEntry>>,
    #[serde(default)]
    pub(super) light: Vec<Spanned<LightEntry>>,
    pub(super) environment: Option<Spanned<EnvironmentEntry>>,
    pub(super) ground: Option<Spanned<Ground>>,
    #[serde(default)]
    pub(super) material: BTreeMap<Spanned<String>, MaterialEntry>,
}

/// `[generate]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Generate {
    kind: Kind,
    triangles: u32,
    #[serde(default)]
    seed: u64,
}

impl Generate {
    pub(super) fn recipe(&self) -> Recipe {
        Recipe { kind: self.kind, triangles: self.triangles, seed: self.seed }
    }
}

/// The source's upward axis; the scene is turned so that +y is up.
#[derive(Clone, Copy, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Up {
    #[default]
    Y,
    Z,
}

/// Vertex normals of parts that have none.
#[derive(Clone, Copy, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Normals {
    /// Every triangle keeps its own.
    #[default]
    Flat,
    /// The mean of the triangles around a vertex, by area.
    Smooth,
}

/// What `[[light]]` entries do to the source's lights.
#[derive(Clone, Copy, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Lights {
    #[default]
    Replace,
    Add,
}

/// `[[camera]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraEntry {
    pub(super) name: String,
    pub(super) eye: [f64; 3],
    pub(super) target: [f64; 3],
    #[serde(default = "up")]
    pub(super) up: [f64; 3],
    pub(super) fov: f64,
}

/// `[[light]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LightEntry {
    pub(super) kind: LightName,
    pub(super) position: Option<[f64; 3]>,
    pub(super) direction: Option<[f64; 3]>,
    pub(super) intensity: f32,
    #[serde(default = "white")]
    pub(super) color: [f32; 3],
    /// Inner and outer half angle in degrees.
    pub(super) angles: Option<[f32; 2]>,
    pub(super) range: Option<f32>,
}

/// Kinds of light by name.
#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum LightName {
    Point,
    Directional,
    Spot,
}

/// `[environment]`: a gradient or an image.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvironmentEntry {
    pub(super) zenith: Option<[f32; 3]>,
    pub(super) horizon: Option<[f32; 3]>,
    pub(super) nadir: Option<[f32; 3]>,
    pub(super) image: Option<String>,
    pub(super) scale: Option<f32>,
}

/// `[ground]`: a level square under the scene.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Ground {
    pub(super) height: Option<f64>,
    pub(super) size: Option<f64>,
    pub(super) checker: Option<f64>,
}

/// `[material."name"]`: what is stated replaces what the source says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialEntry {
    pub(super) base_color: Option<[f32; 3]>,
    pub(super) opacity: Option<f32>,
    pub(super) specular: Option<[f32; 3]>,
    pub(super) metallic: Option<f32>,
    pub(super) roughness: Option<f32>,
    pub(super) emissive: Option<[f32; 3]>,
    pub(super) transmission: Option<f32>,
    pub(super) ior: Option<f32>,
    pub(super) thin_walled: Option<bool>,
    pub(super) alpha: Option<AlphaName>,
    pub(super) alpha_cutoff: Option<f32>,
    pub(super) double_sided: Option<bool>,
    pub(super) unlit: Option<bool>,
    /// `false` leaves out every image of the material.
    #[serde(default = "yes")]
    pub(super) textures: bool,
}

/// Alpha modes by name.
#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum AlphaName {
    Opaque,
    Mask,
    Blend,
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn yes() -> bool {
    true
}
