//! Plain arrays from which a pack is made.

use crate::records::{Ambient, Camera, Environment, Light, Material, Wrap};
use std::sync::Arc;

/// A flattened scene: world-space triangles and everything they refer to.
///
/// Vertex arrays other than `positions` are either empty (the scene has none) or exactly as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct PackInput {
    /// World positions.
    pub positions: Vec<[f64; 3]>,
    /// Shading normals; zero or non-finite means 'none at this vertex'.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, (0,0) at the image's upper left corner as in glTF.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex colours: sRGB-coded red, green, blue and linear alpha.
    pub colors: Vec<[u8; 4]>,
    /// Vertex indices; a triangle's place in this list is its original id (`id.triangle`).
    pub triangles: Vec<[u32; 3]>,
    /// `(first triangle, material)`, ascending, the first at triangle 0; a run ends where the next begins.
    pub material_runs: Vec<(u32, u32)>,
    /// Materials, at least one when there are triangles.
    pub materials: Vec<Material>,
    /// Images, referred to by materials and the environment.
    pub textures: Vec<ImageInput>,
    /// Lights in **world** space; the pack stores them in local space.
    pub lights: Vec<Light>,
    /// World positions of the lights in full precision; when empty, those in `lights` are used. At large offsets from the
    /// origin an `f32` position is too coarse.
    pub light_positions: Vec<[f64; 3]>,
    /// Named views in world space; the first is the default.
    pub cameras: Vec<Camera>,
    /// Light that reaches every surface alike.
    pub ambient: Ambient,
    /// What a ray sees that misses everything.
    pub environment: Environment,
}

/// An image as 8-bit RGBA, sRGB-coded colour with linear alpha (for metal/roughness textures: plain numbers).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageInput {
    /// For messages.
    pub name: String,
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height * 4` bytes, row 0 on top. Images that share them (the same `Arc`, as when one picture is sampled in several
    /// ways) share their texels in the pack.
    pub rgba: Arc<[u8]>,
    /// Behaviour outside [0, 1) along s.
    pub wrap_s: Wrap,
    /// Behaviour outside [0, 1) along t.
    pub wrap_t: Wrap,
    /// Whether texels are taken as they are instead of interpolated (glTF's NEAREST).
    pub nearest: bool,
}

impl ImageInput {
    /// Equal for images that share their texels, different for others that live at the same time.
    pub(crate) fn identity(&self) -> *const [u8] {
        Arc::as_ptr(&self.rgba)
    }
}
