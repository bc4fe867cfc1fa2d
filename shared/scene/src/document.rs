//! The document's types.

use crate::CameraTrack;
use glam::{DMat4, DVec3};
use std::sync::Arc;
use tessera_geometry::CameraPose;

/// A scene as its file states it. Indices refer to the vectors of this struct.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// File or generator, for messages.
    pub name: String,
    /// Shapes, each possibly used by many nodes.
    pub meshes: Vec<Mesh>,
    /// The node tree; children come after their parents.
    pub nodes: Vec<Node>,
    /// Roots, in file order.
    pub roots: Vec<usize>,
    /// Surfaces; index 0 exists whenever there is a triangle.
    pub materials: Vec<Material>,
    /// Decoded images.
    pub images: Vec<Image>,
    /// Lights in world space (node transforms applied).
    pub lights: Vec<Light>,
    /// Cameras in world space (node transforms applied); the first is the default.
    pub cameras: Vec<Camera>,
    /// Cameras among these that move.
    pub camera_tracks: Vec<CameraTrack>,
    /// What a miss sees.
    pub environment: Environment,
    /// Linear radiance that reaches every surface alike.
    pub ambient: [f32; 3],
    /// What was read but not understood, or mended, one line each: what, where, what it means for the picture.
    pub warnings: Vec<String>,
    /// What a user should know about where the scene came from, one line each: a generator's seed and figures, and every
    /// default that was put in because the source does not state it.
    pub notes: Vec<String>,
    /// Faulty input that was left out, by kind; every kind that occurred is listed with its count.
    pub dropped: Vec<(&'static str, u64)>,
}

/// A shape: one primitive a material.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// For messages.
    pub name: String,
    /// Parts.
    pub primitives: Vec<Primitive>,
}

/// Triangles of one material. Vertex arrays other than `positions` are empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Primitive {
    /// Object-space positions.
    pub positions: Vec<DVec3>,
    /// Object-space normals, not necessarily unit.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates (the set and transform of the material's base texture applied), (0,0) upper left.
    pub uvs: Vec<[f32; 2]>,
    /// sRGB-coded colour and linear alpha.
    pub colors: Vec<[u8; 4]>,
    /// Vertex indices, each below `positions.len()`.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`].
    pub material: usize,
}

/// A place in the node tree.
#[derive(Clone, Debug)]
pub struct Node {
    /// For messages.
    pub name: String,
    /// To the parent's space; affine.
    pub transform: DMat4,
    /// Shape, if any.
    pub mesh: Option<usize>,
    /// Children, in file order.
    pub children: Vec<usize>,
}

/// How alpha is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Ignored.
    #[default]
    Opaque,
    /// A hole below the cut-off.
    Mask(f32),
    /// Coverage.
    Blend,
}

/// A surface in metal/roughness terms, linear colours.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// For messages and overrides.
    pub name: String,
    /// Colour and alpha.
    pub base_color: [f32; 4],
    /// Image of the base colour.
    pub base_texture: Option<TextureRef>,
    /// Reflectance at normal incidence of the non-metal part.
    pub specular: [f32; 3],
    /// Share of metal.
    pub metallic: f32,
    /// Perceptual roughness; 0 is a mirror.
    pub roughness: f32,
    /// Roughness in green, metal in blue.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Emitted radiance.
    pub emissive: [f32; 3],
    /// Image that multiplies `emissive`.
    pub emissive_texture: Option<TextureRef>,
    /// Share of the non-metal part that passes light.
    pub transmission: f32,
    /// Image whose red multiplies `transmission`.
    pub transmission_texture: Option<TextureRef>,
    /// Index of refraction.
    pub ior: f32,
    /// Light passes unbent.
    pub thin_walled: bool,
    /// Alpha.
    pub alpha: AlphaMode,
    /// Seen from behind too. A single-sided surface looks like a hole from behind, unless it transmits light; it casts its
    /// shadow to both sides.
    pub double_sided: bool,
    /// Shown without lights.
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_texture: None,
            specular: [0.04; 3],
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emissive: [0.0; 3],
            emissive_texture: None,
            transmission: 0.0,
            transmission_texture: None,
            ior: 1.5,
            thin_walled: false,
            alpha: AlphaMode::Opaque,
            double_sided: true,
            unlit: false,
        }
    }
}

/// An image and how it is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TextureRef {
    /// Index into [`Scene::images`].
    pub image: usize,
    /// Outside [0, 1) along s.
    pub wrap_s: Wrap,
    /// Outside [0, 1) along t.
    pub wrap_t: Wrap,
    /// Texels as they are.
    pub nearest: bool,
}

/// Behaviour outside [0, 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Repeats.
    #[default]
    Repeat,
    /// Repeats mirrored.
    Mirror,
    /// Border texels go on.
    Clamp,
}

/// A decoded image.
#[derive(Clone, Debug)]
pub struct Image {
    /// For messages.
    pub name: String,
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height * 4` bytes, row 0 on top, straight alpha.
    pub rgba: Arc<[u8]>,
}

/// A light in world space. glTF's units: candela for points and spots, lux for directional lights.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// For messages.
    pub name: String,
    /// Shape.
    pub kind: LightKind,
    /// Position; unused by directional lights.
    pub position: DVec3,
    /// Unit vector in which it shines; unused by points.
    pub direction: DVec3,
    /// Linear colour times intensity.
    pub intensity: [f32; 3],
    /// Reach in world units, `+inf` when unlimited.
    pub range: f32,
}

/// Shapes of [`Light`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// In all directions.
    Point,
    /// From infinity.
    Directional,
    /// In a cone; half angles in radians, `0 <= inner < outer <= pi/2`.
    Spot {
        /// Where it begins to fall off.
        inner: f32,
        /// Where it ends.
        outer: f32,
    },
}

/// A named view.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// What `--camera` takes.
    pub name: String,
    /// The view.
    pub pose: CameraPose,
}

/// What a miss sees; linear radiances.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Environment {
    /// Nothing: black, transparent.
    #[default]
    None,
    /// A gradient over height.
    Gradient {
        /// Straight up.
        zenith: [f32; 3],
        /// Level.
        horizon: [f32; 3],
        /// Straight down.
        nadir: [f32; 3],
    },
    /// An equirectangular image times a scale.
    Map {
        /// Index into [`Scene::images`].
        image: usize,
        /// Multiplier.
        scale: f32,
    },
}
