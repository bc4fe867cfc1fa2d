//! Small scenes whose pictures are known, and frames of them as numbers: for tests and `tessera check`, which ask the same.

pub mod stages;

use crate::{Features, FrameParams, PixelBlock, PixelFormat, RayCounts, Renderer, Sampling};
use tessera_geometry::{CameraPose, DVec3};
use tessera_pack::{
    BuildError, Environment, EnvironmentKind, ImageInput, Light, LightKind, Material, MaterialFlags, Pack,
    PackInput, PackOptions, Plain, build_pack,
};

/// A scene under construction.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    /// What is on it.
    pub input: PackInput,
}

/// Vertex data besides the position.
#[derive(Clone, Copy, Debug)]
pub struct Extra {
    /// Shading normal; zero for none.
    pub normal: [f32; 3],
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Vertex colour.
    pub color: [u8; 4],
}

/// Nothing but a position.
pub const BARE: Extra = Extra { normal: [0.0; 3], uv: [0.0; 2], color: [255; 4] };

impl Stage {
    /// Adds a triangle, counter-clockwise seen from its front.
    pub fn triangle(&mut self, corners: [(DVec3, Extra); 3], material: Material) {
        let first = self.input.positions.len() as u32;
        let index = self.input.materials.iter().position(|m| *m == material).unwrap_or_else(|| {
            self.input.materials.push(material);
            self.input.materials.len() - 1
        });
        self.input.material_runs.push((self.input.triangles.len() as u32, index as u32));
        self.input.triangles.push([first, first + 1, first + 2]);
        for (position, extra) in corners {
            self.input.positions.push(position.to_array());
            self.input.normals.push(extra.normal);
            self.input.uvs.push(extra.uv);
            self.input.colors.push(extra.color);
        }
    }

    /// Adds a parallelogram from `corner` along `u` and `v`; its front is on the side of `u x v`, its texture
    /// coordinates run from (0, 0) at `corner` to (1, 1).
    pub fn quad(&mut self, corner: [f64; 3], u: [f64; 3], v: [f64; 3], material: Material) {
        let (o, u, v) = (DVec3::from(corner), DVec3::from(u), DVec3::from(v));
        let at = |s: f64, t: f64| (o + u * s + v * t, Extra { uv: [s as f32, t as f32], ..BARE });
        self.triangle([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)], material);
        self.triangle([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)], material);
    }

    /// Adds a box that is seen from outside.
    pub fn cuboid(&mut self, min: [f64; 3], max: [f64; 3], material: Material) {
        let d = [max[0] - min[0], max[1] - min[1], max[2] - min[2]];
        let (x, y, z) = ([d[0], 0.0, 0.0], [0.0, d[1], 0.0], [0.0, 0.0, d[2]]);
        self.quad(min, z, y, material);
        self.quad(min, x, z, material);
        self.quad(min, y, x, material);
        self.quad([max[0], min[1], min[2]], y, z, material);
        self.quad([min[0], max[1], min[2]], z, x, material);
        self.quad([min[0], min[1], max[2]], x, y, material);
    }

    /// Adds a ball of `2 rings^2` quads with smooth normals.
    pub fn ball(&mut self, centre: [f64; 3], radius: f64, rings: u32, material: Material) {
        let centre = DVec3::from(centre);
        let at = |i: u32, j: u32| {
            let polar = std::f64::consts::PI * f64::from(i) / f64::from(rings);
            let around = std::f64::consts::PI * f64::from(j) / f64::from(rings);
            let n = DVec3::new(
                libm::sin(polar) * libm::cos(around),
                libm::cos(polar),
                libm::sin(polar) * libm::sin(around),
            );
            (centre + n * radius, Extra { normal: n.as_vec3().to_array(), ..BARE })
        };
        for i in 0..rings {
            for j in 0..2 * rings {
                if i > 0 {
                    self.triangle([at(i, j), at(i, j + 1), at(i + 1, j)], material);
                }
                if i + 1 < rings {
                    self.triangle([at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)], material);
                }
            }
        }
    }

    /// Adds a light.
    pub fn light(&mut self, light: Light) {
        self.input.lights.push(light);
    }

    /// Surrounds the scene with radiance 1.
    pub fn surround(&mut self) {
        self.input.environment = Environment {
            kind: EnvironmentKind::Gradient as u32,
            zenith: [1.0; 3],
            horizon: [1.0; 3],
            nadir: [1.0; 3],
            ..Environment::default()
        };
        self.input.ambient.radiance = [1.0; 3];
    }

    /// Packs it with exact vertices, so that a picture has analytic values.
    ///
    /// # Panics
    /// When it cannot be packed.
    pub fn pack(self) -> Pack {
        self.pack_with(Plain { positions: true, normals: true, uvs: true }).expect("a packable scene")
    }

    /// Packs it with these sections held plain.
    pub fn pack_with(self, plain: Plain) -> Result<Pack, BuildError> {
        build_pack(self.input, &PackOptions { plain, ..PackOptions::default() }).map(|(pack, _)| pack)
    }
}

/// A rough white surface without highlights: radiance = irradiance / pi.
pub fn chalk() -> Material {
    Material { specular: [0.0; 3], ..Material::default() }
}

/// A metal mirror of reflectance `k`.
pub fn mirror(k: f32) -> Material {
    Material { base_color: [k, k, k, 1.0], metallic: 1.0, roughness: 0.0, ..Material::default() }
}

/// Clear glass.
pub fn glass(ior: f32) -> Material {
    Material { roughness: 0.0, transmission: 1.0, ior, ..Material::default() }
}

/// `material` without a back.
pub fn one_sided(material: Material) -> Material {
    Material { flags: material.flags & !MaterialFlags::DOUBLE_SIDED, ..material }
}

/// A surface that shows `color` whatever the light.
pub fn unlit(color: [f32; 3]) -> Material {
    let [r, g, b] = color;
    let flags = MaterialFlags::UNLIT | MaterialFlags::DOUBLE_SIDED;
    Material { base_color: [r, g, b, 1.0], flags, ..chalk() }
}

/// A lamp of so many candela.
pub fn point_light(position: [f32; 3], intensity: f32) -> Light {
    Light {
        position,
        kind: LightKind::Point as u32,
        direction: [0.0, 0.0, -1.0],
        range: f32::INFINITY,
        intensity: [intensity; 3],
        cos_inner: 1.0,
        cos_outer: 0.0,
        reserved: [0; 3],
    }
}

/// A light from infinitely far, of so many lux.
pub fn directional_light(direction: [f32; 3], intensity: f32) -> Light {
    let d = tessera_geometry::Vec3::from(direction).normalize();
    Light { kind: LightKind::Directional as u32, direction: d.to_array(), ..point_light([0.0; 3], intensity) }
}

/// A 2 x 1 picture whose red rises from 0 to 1 between the texel centres at u = 1/4 and 3/4 while green is 1: red
/// over green tells the place whatever dims both.
pub fn ruler() -> ImageInput {
    ImageInput {
        name: "ruler".into(),
        width: 2,
        height: 1,
        rgba: [0, 255, 0, 255, 255, 255, 0, 255].into(),
        ..ImageInput::default()
    }
}

/// One pixel of [`PixelFormat::Layers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers {
    /// Linear red, green, blue.
    pub color: [f32; 3],
    /// Coverage.
    pub alpha: f32,
    /// Distance from the eye.
    pub depth: f32,
    /// Geometric normal.
    pub normal: [f32; 3],
    /// Triangle of the input.
    pub id: u32,
}

/// A view of a scene.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Where from and where to.
    pub pose: CameraPose,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Samples a pixel.
    pub samples: u32,
    /// How they are taken.
    pub sampling: Sampling,
    /// Mirror and bent rays of a path.
    pub max_depth: u32,
    /// What is switched on.
    pub features: Features,
}

/// One pixel that looks from `eye` at `target`.
pub fn look(eye: [f64; 3], target: [f64; 3]) -> View {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    let up = if (target - eye).normalize().y.abs() > 0.99 { DVec3::Z } else { CameraPose::DEFAULT_UP };
    View {
        pose: CameraPose { eye, target, up, fov_degrees: 50.0 },
        width: 1,
        height: 1,
        samples: 1,
        sampling: Sampling::default(),
        max_depth: 8,
        features: Features::default(),
    }
}

impl View {
    /// The same with so many pixels.
    pub fn sized(self, width: u32, height: u32) -> Self {
        Self { width, height, ..self }
    }

    /// What a frame of it asks for.
    ///
    /// # Panics
    /// When the pose has no meaning.
    pub fn params(&self, pack: &Pack, format: PixelFormat) -> FrameParams {
        FrameParams {
            camera: self.pose.to_local(&pack.frame(), self.width, self.height).expect("a usable pose"),
            width: self.width,
            height: self.height,
            samples: self.samples,
            sampling: self.sampling,
            max_depth: self.max_depth,
            frame: 0,
            features: self.features,
            format,
        }
    }

    /// The whole image as bytes.
    pub fn bytes(&self, pack: &Pack, format: PixelFormat) -> (Vec<u8>, RayCounts) {
        let params = self.params(pack, format);
        let block = PixelBlock { x: 0, y: 0, width: self.width, height: self.height };
        let mut out = vec![0; block.byte_len(format)];
        let counts = Renderer::new(pack).render_block(&params, block, &mut out);
        (out, counts)
    }

    /// The whole image as numbers.
    pub fn layers(&self, pack: &Pack) -> (Vec<Layers>, RayCounts) {
        let (bytes, counts) = self.bytes(pack, PixelFormat::Layers);
        (decode(&bytes), counts)
    }

    /// The only pixel.
    pub fn pixel(&self, pack: &Pack) -> Layers {
        self.layers(pack).0[0]
    }
}

/// Pixels of [`PixelFormat::Layers`].
pub fn decode(bytes: &[u8]) -> Vec<Layers> {
    let decode_pixel = |bytes: &[u8]| {
        let word = |i: usize| <[u8; 4]>::try_from(&bytes[4 * i..4 * i + 4]).expect("four bytes");
        let float = |i| f32::from_le_bytes(word(i));
        Layers {
            color: [float(0), float(1), float(2)],
            alpha: float(3),
            depth: float(4),
            normal: [float(5), float(6), float(7)],
            id: u32::from_le_bytes(word(8)),
        }
    };
    bytes.chunks_exact(36).map(decode_pixel).collect()
}

/// Checks all channels of `color` against `wanted` within `tolerance`.
///
/// # Panics
/// When one is farther off.
#[track_caller]
pub fn assert_color(color: [f32; 3], wanted: f32, tolerance: f32) {
    assert!(color.iter().all(|c| (c - wanted).abs() <= tolerance), "{color:?} is not {wanted}");
}
