//! The fixed-size records of a pack, as they lie in its bytes.

use bytemuck::{Pod, Zeroable};

/// Texture slot value for 'no texture'.
pub const NO_TEXTURE: u32 = u32::MAX;

/// A surface. Colours are linear. The Whitted terms that follow from it are defined in `whitted`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Material {
    /// Diffuse or metal colour, and alpha, each in [0, 1].
    pub base_color: [f32; 4],
    /// Reflectance at normal incidence of the non-metal part, each in [0, 1].
    pub specular: [f32; 3],
    /// Share of metal, [0, 1].
    pub metallic: f32,
    /// Emitted radiance, >= 0.
    pub emissive: [f32; 3],
    /// Perceptual roughness, [0, 1]; 0 is a mirror.
    pub roughness: f32,
    /// Share of the non-metal part that passes light through, [0, 1].
    pub transmission: f32,
    /// Index of refraction, finite and > 0.
    pub ior: f32,
    /// Alpha below this is a hole ([`MaterialFlags::ALPHA_MASK`]).
    pub alpha_cutoff: f32,
    /// [`MaterialFlags`].
    pub flags: u32,
    /// Texture index or [`NO_TEXTURE`]: base colour (with alpha).
    pub base_texture: u32,
    /// Texture with roughness in green and metal in blue, linear.
    pub metallic_roughness_texture: u32,
    /// Texture that multiplies `emissive`.
    pub emissive_texture: u32,
    /// Texture whose red multiplies `transmission`, linear.
    pub transmission_texture: u32,
}

const _: () = assert!(size_of::<Material>() == 80);

impl Default for Material {
    /// White, rough, opaque plastic, seen from both sides (glTF's default is a metal, seen from the front).
    fn default() -> Self {
        Self {
            base_color: [1.0; 4],
            specular: [0.04; 3],
            metallic: 0.0,
            emissive: [0.0; 3],
            roughness: 1.0,
            transmission: 0.0,
            ior: 1.5,
            alpha_cutoff: 0.5,
            flags: MaterialFlags::DOUBLE_SIDED,
            base_texture: NO_TEXTURE,
            metallic_roughness_texture: NO_TEXTURE,
            emissive_texture: NO_TEXTURE,
            transmission_texture: NO_TEXTURE,
        }
    }
}

/// Bits of [`Material::flags`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaterialFlags;

impl MaterialFlags {
    /// Both sides are seen. Without it a ray that looks at the back passes it as a hole, unless the material transmits
    /// light; a shadow ray meets both sides always.
    pub const DOUBLE_SIDED: u32 = 1 << 0;
    /// The base colour is shown as it is, without lights.
    pub const UNLIT: u32 = 1 << 1;
    /// Alpha below the cut-off is a hole, above it the surface is solid.
    pub const ALPHA_MASK: u32 = 1 << 2;
    /// Alpha is coverage; what lies behind shows through.
    pub const ALPHA_BLEND: u32 = 1 << 3;
    /// A transmissive surface without a volume behind it: light passes unbent.
    pub const THIN_WALLED: u32 = 1 << 4;
    /// All bits that are defined.
    pub const ALL: u32 = (1 << 5) - 1;
}

/// What a texture does outside [0, 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Wrap {
    /// The picture repeats.
    #[default]
    Repeat = 0,
    /// It repeats, mirrored every second time.
    Mirror = 1,
    /// Its border texels go on.
    Clamp = 2,
}

/// An image in the texel section.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Texture {
    /// Index of the first texel (4 bytes each) in the texel section.
    pub first_texel: u32,
    /// Texels a row, >= 1.
    pub width: u32,
    /// Rows, >= 1.
    pub height: u32,
    /// Bits 0..1 [`Wrap`] along s, 2..3 along t, bit 4 nearest; the rest 0.
    pub sampling: u32,
}

const _: () = assert!(size_of::<Texture>() == 16);

/// Kinds of [`Light`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum LightKind {
    /// `intensity` in candela, falls with the square of the distance in world units.
    Point = 0,
    /// `intensity` in lux, from `-direction`, at infinity.
    Directional = 1,
    /// A point light inside a cone around `direction`.
    Spot = 2,
}

/// A light.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Light {
    /// Local position (in [`crate::PackInput`]: world position); unused by directional lights.
    pub position: [f32; 3],
    /// [`LightKind`].
    pub kind: u32,
    /// Unit vector in which the light shines; unused by point lights.
    pub direction: [f32; 3],
    /// World units beyond which it does not reach, `+inf` when unlimited.
    pub range: f32,
    /// Linear colour times intensity, >= 0.
    pub intensity: [f32; 3],
    /// Cosine of the angle at which a spot begins to fall off.
    pub cos_inner: f32,
    /// Cosine of the angle at which a spot ends, < `cos_inner`.
    pub cos_outer: f32,
    /// Zero.
    pub reserved: [u32; 3],
}

const _: () = assert!(size_of::<Light>() == 64);

/// Light that reaches every surface alike.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ambient {
    /// Linear radiance, >= 0; adds `diffuse colour * radiance`.
    pub radiance: [f32; 3],
}

/// Kinds of [`Environment`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum EnvironmentKind {
    /// A miss is black and transparent.
    #[default]
    None = 0,
    /// A gradient over the direction's height: `nadir`, `horizon`, `zenith`.
    Gradient = 1,
    /// An equirectangular image, its centre row on the horizon, its centre column towards `+z` (scaled by `zenith`).
    Map = 2,
}

/// What a ray sees that misses everything.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Environment {
    /// Linear radiance straight up (also the scale of a map).
    pub zenith: [f32; 3],
    /// [`EnvironmentKind`].
    pub kind: u32,
    /// Linear radiance at the horizon.
    pub horizon: [f32; 3],
    /// Texture of a map, or [`NO_TEXTURE`].
    pub texture: u32,
    /// Linear radiance straight down.
    pub nadir: [f32; 3],
    /// Zero.
    pub reserved: u32,
    /// Unit vector that points up.
    pub up: [f32; 3],
    /// Zero.
    pub reserved2: u32,
}

const _: () = assert!(size_of::<Environment>() == 64);

impl Default for Environment {
    fn default() -> Self {
        Self { texture: NO_TEXTURE, up: [0.0, 1.0, 0.0], ..Zeroable::zeroed() }
    }
}

/// Texture coordinates of one vertex that do not pack.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SideUv {
    /// Vertex; its record has the side-table bit.
    pub vertex: u32,
    /// Texture coordinates, at most 2^22 in size.
    pub uv: [f32; 2],
}

const _: () = assert!(size_of::<SideUv>() == 12);

/// A named view in world space. Workers make no use of it; it lets a pack be rendered without the scene that it came from.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Camera {
    /// Eye position.
    pub eye: [f64; 3],
    /// A point on the optical axis.
    pub target: [f64; 3],
    /// What points up in the image.
    pub up: [f64; 3],
    /// Vertical field of view in degrees, in (0, 180).
    pub fov_degrees: f64,
    /// UTF-8 without control characters, at least one character, padded with zeros; see [`Camera::name`].
    pub name: [u8; 48],
}

const _: () = assert!(size_of::<Camera>() == 128);

impl Camera {
    /// The name; `None` when the bytes are none.
    pub fn name(&self) -> Option<&str> {
        let length = self.name.iter().position(|&b| b == 0).unwrap_or(self.name.len());
        let (name, padding) = self.name.split_at(length);
        let name = std::str::from_utf8(name).ok()?;
        let usable =
            !name.is_empty() && !name.chars().any(char::is_control) && padding.iter().all(|&b| b == 0);
        usable.then_some(name)
    }

    /// `name` as it is stored: without control characters, cut behind the last whole character that fits, `camera` when nothing
    /// is left.
    pub fn encode_name(name: &str) -> [u8; 48] {
        let mut bytes = [0; 48];
        let mut length = 0;
        let mut put = |character: char| {
            let end = length + character.len_utf8();
            let Some(place) = bytes.get_mut(length..end) else { return false };
            character.encode_utf8(place);
            length = end;
            true
        };
        let mut characters = name.chars().filter(|c| !c.is_control()).peekable();
        match characters.peek() {
            Some(_) => characters.all(&mut put),
            None => "camera".chars().all(&mut put),
        };
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_names_survive_or_are_cut_between_characters() {
        let stored = |name: &str| {
            let camera = Camera { name: Camera::encode_name(name), ..Zeroable::zeroed() };
            camera.name().map(str::to_owned)
        };
        assert_eq!(stored("north").as_deref(), Some("north"));
        assert_eq!(stored("a\u{7}b\n").as_deref(), Some("ab"));
        assert_eq!(stored("").as_deref(), Some("camera"));
        assert_eq!(stored(&"x".repeat(48)), Some("x".repeat(48)));
        assert_eq!(stored(&format!("{}\u{e4}", "x".repeat(47))), Some("x".repeat(47)));
        let broken = |change: &dyn Fn(&mut [u8; 48])| {
            let mut camera = Camera { name: Camera::encode_name("abc"), ..Zeroable::zeroed() };
            change(&mut camera.name);
            camera.name().is_none()
        };
        assert!(!broken(&|_| ()));
        assert!(broken(&|name| name[0] = 0xff));
        assert!(broken(&|name| name[0] = 0));
        assert!(broken(&|name| name[1] = b'\n'));
        assert!(broken(&|name| name[40] = b'x'));
    }
}
