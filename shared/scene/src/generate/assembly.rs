//! A scene while it is being generated, with its running counts.

use super::shapes::Shape;
use crate::{AlphaMode, Camera, Image, Light, LightKind, Material, Mesh, Node, Scene, TextureRef, Wrap};
use glam::{DMat4, DVec3};
use tessera_geometry::CameraPose;

/// Triangles and vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) triangles: u64,
    pub(super) vertices: u64,
}

impl std::ops::AddAssign for Count {
    fn add_assign(&mut self, o: Self) {
        self.triangles += o.triangles;
        self.vertices += o.vertices;
    }
}

/// A mesh that can be placed any number of times.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeshId(usize);

/// A scene and what its nodes add up to.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    scene: Scene,
    mesh_counts: Vec<Count>,
    total: Count,
}

impl Assembly {
    /// An empty scene.
    pub(super) fn new(name: &str) -> Self {
        Self { scene: Scene { name: name.to_owned(), ..Scene::default() }, ..Self::default() }
    }

    /// What has been placed so far, instances counted each time.
    pub(super) fn total(&self) -> Count {
        self.total
    }

    /// What one instance of a mesh adds.
    pub(super) fn count(&self, mesh: MeshId) -> Count {
        self.mesh_counts[mesh.0]
    }

    /// The material's index.
    pub(super) fn material(&mut self, material: Material) -> usize {
        self.scene.materials.push(material);
        self.scene.materials.len() - 1
    }

    /// An image that repeats.
    pub(super) fn image(&mut self, image: Image) -> TextureRef {
        self.scene.images.push(image);
        let image = self.scene.images.len() - 1;
        TextureRef { image, wrap_s: Wrap::Repeat, wrap_t: Wrap::Repeat, nearest: false }
    }

    /// A mesh of parts, each with its material; empty parts are left out.
    pub(super) fn mesh(&mut self, name: &str, parts: impl IntoIterator<Item = (Shape, usize)>) -> MeshId {
        let mut count = Count::default();
        let mut mesh = Mesh { name: name.to_owned(), primitives: Vec::new() };
        for (shape, material) in parts {
            if shape.triangles.is_empty() {
                continue;
            }
            count +=
                Count { triangles: shape.triangles.len() as u64, vertices: shape.positions.len() as u64 };
            mesh.primitives.push(shape.into_primitive(material));
        }
        self.scene.meshes.push(mesh);
        self.mesh_counts.push(count);
        MeshId(self.scene.meshes.len() - 1)
    }

    /// An instance at the root of the scene.
    pub(super) fn place(&mut self, mesh: MeshId, transform: DMat4) {
        let name = self.scene.meshes[mesh.0].name.clone();
        self.scene.roots.push(self.scene.nodes.len());
        self.scene.nodes.push(Node { name, transform, mesh: Some(mesh.0), children: Vec::new() });
        self.total += self.mesh_counts[mesh.0];
    }

    /// A mesh that is used once, where it lies.
    pub(super) fn add(&mut self, name: &str, parts: impl IntoIterator<Item = (Shape, usize)>) {
        let mesh = self.mesh(name, parts);
        self.place(mesh, DMat4::IDENTITY);
    }

    /// A camera that looks level with the horizon.
    pub(super) fn camera(&mut self, name: &str, eye: [f64; 3], target: [f64; 3], fov_degrees: f64) {
        let pose = CameraPose { eye: eye.into(), target: target.into(), up: DVec3::Y, fov_degrees };
        self.scene.cameras.push(Camera { name: name.to_owned(), pose });
    }

    /// A point light, `intensity` in candela.
    pub(super) fn point_light(&mut self, name: &str, position: DVec3, intensity: [f32; 3]) {
        self.scene.lights.push(Light {
            name: name.to_owned(),
            kind: LightKind::Point,
            position,
            direction: DVec3::NEG_Y,
            intensity,
            range: f32::INFINITY,
        });
    }

    /// A light in a cone of the given inner and outer half angles, in radians; `intensity` in candela.
    pub(super) fn spot_light(
        &mut self,
        name: &str,
        position: DVec3,
        direction: DVec3,
        [inner, outer]: [f32; 2],
        intensity: [f32; 3],
    ) {
        self.scene.lights.push(Light {
            name: name.to_owned(),
            kind: LightKind::Spot { inner, outer },
            position,
            direction,
            intensity,
            range: f32::INFINITY,
        });
    }

    /// A light at infinity that shines along `direction`, `intensity` in lux.
    pub(super) fn sun(&mut self, direction: [f64; 3], intensity: [f32; 3]) {
        self.scene.lights.push(Light {
            name: "sun".to_owned(),
            kind: LightKind::Directional,
            position: DVec3::ZERO,
            direction: DVec3::from_array(direction).normalize(),
            intensity,
            range: f32::INFINITY,
        });
    }

    /// The rest of the document, for what has no method here.
    pub(super) fn scene(&mut self) -> &mut Scene {
        &mut self.scene
    }

    /// The finished document.
    pub(super) fn finish(self) -> Scene {
        self.scene
    }
}

/// A rough surface of one colour.
pub(super) fn matte(name: &str, color: [f32; 3]) -> Material {
    Material {
        name: name.to_owned(),
        base_color: [color[0], color[1], color[2], 1.0],
        specular: [0.0; 3],
        ..Material::default()
    }
}

/// A rough surface with an image.
pub(super) fn textured(name: &str, texture: TextureRef) -> Material {
    Material { base_texture: Some(texture), ..matte(name, [1.0; 3]) }
}

/// A coat that reflects like a mirror over a diffuse ground; `specular` is the share reflected at normal incidence.
pub(super) fn polished(material: Material, specular: f32) -> Material {
    Material { specular: [specular; 3], roughness: 0.0, ..material }
}

/// A metal mirror.
pub(super) fn mirror(name: &str, color: [f32; 3]) -> Material {
    Material { metallic: 1.0, roughness: 0.0, ..matte(name, color) }
}

/// Clear or tinted glass with an inside.
pub(super) fn glass(name: &str, color: [f32; 3], ior: f32) -> Material {
    let f0 = (ior - 1.0) / (ior + 1.0);
    Material { transmission: 1.0, ior, specular: [f0 * f0; 3], roughness: 0.0, ..matte(name, color) }
}

/// A pane without an inside: light passes unbent.
pub(super) fn pane(name: &str, color: [f32; 3]) -> Material {
    Material { thin_walled: true, ..glass(name, color, 1.5) }
}

/// A surface that shines by itself, besides the lights.
pub(super) fn glowing(name: &str, radiance: [f32; 3]) -> Material {
    Material { emissive: radiance, ..matte(name, [0.0; 3]) }
}

/// A card whose image cuts holes.
pub(super) fn cut_out(name: &str, texture: TextureRef) -> Material {
    Material { alpha: AlphaMode::Mask(0.5), ..textured(name, texture) }
}
