//! What of a scene is kept, and why the rest is not.

use crate::{Environment, FlatMesh, Material, Scene, TextureRef};
use glam::DVec3;

/// Features that the user asked to leave out (`--without`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Without {
    /// All images (and so texture coordinates).
    pub textures: bool,
    /// Shadow rays.
    pub shadows: bool,
    /// Mirror reflection.
    pub reflection: bool,
    /// Refraction: transmissive surfaces become opaque.
    pub refraction: bool,
}

impl Without {
    /// The kinds of rays that are not traced: nothing of them is in a pack.
    pub fn rays_left_out(self) -> Vec<LeftOut> {
        let kinds = [
            (self.shadows, "shadow rays"),
            (self.reflection, "reflection rays"),
            (self.refraction, "refraction rays"),
        ];
        let left_out = kinds.into_iter().filter(|(is_left_out, _)| *is_left_out);
        left_out.map(|(_, what)| LeftOut { what: what.into(), why: ASKED.into(), bytes: 0 }).collect()
    }
}

/// Why something that the user asked to leave out is left out.
const ASKED: &str = "asked for with --without";

/// One thing that was left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
    /// Bytes of the source's form that it would have taken.
    pub bytes: u64,
}

impl LeftOut {
    /// "1 image", "2 images".
    pub fn counted(count: u64, what: &str, why: &str, bytes: u64) -> Self {
        // Of several words the first is the thing.
        let (thing, more) = what.split_once(' ').map_or((what, String::new()), |(a, b)| (a, format!(" {b}")));
        let plural = if count == 1 { "" } else { "s" };
        Self { what: format!("{count} {thing}{plural}{more}"), why: why.to_owned(), bytes }
    }
}

/// The part of a scene that is packed: indices into the scene, and what was left out.
///
/// A kept material may still name an image that is not kept (a texture that has no effect, or all of them under
/// [`Without::textures`]); such a name is to be dropped with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Materials in use, ascending.
    pub materials: Vec<usize>,
    /// Images in use, ascending.
    pub images: Vec<usize>,
    /// Whether any kept material reads texture coordinates.
    pub uvs: bool,
    /// Whether shading normals are kept.
    pub normals: bool,
    /// Whether vertex colours are kept (some are not white).
    pub colors: bool,
    /// The rest.
    pub left_out: Vec<LeftOut>,
}

/// The cosine of 0.5624 degrees, the largest error of a 16-bit normal code: a vertex normal that is nearer than this to its
/// triangles' own normals says no more than the code could keep. Rounded up, so that nothing beyond the bound is left out.
const COS_NORMAL_CODE_ERROR: f64 = 0.999_951_9;

impl Selection {
    /// What `scene`, flattened as `flat`, needs.
    ///
    /// - Materials: those of triangles.
    /// - Images: those that a kept material samples with effect (an emissive texture without emission has none), and the
    ///   environment's.
    /// - Texture coordinates: when a kept image lies on a surface.
    /// - Normals: when some triangle's corner has one more than the error of a 16-bit normal code (0.5624 degrees) from the
    ///   triangle's own. A scene of flat faces needs none.
    /// - Colours: when one is not white.
    pub fn of(scene: &Scene, flat: &FlatMesh, without: Without) -> Self {
        let mut selection = Self { materials: used_materials(flat), ..Self::default() };
        selection.left_out_materials(scene);
        selection.select_images(scene, flat, without);
        selection.select_arrays(flat, without);
        selection.left_out.extend(without.rays_left_out());
        selection
    }

    /// Keeps every material and image, and the texture coordinates that go with them: the twin by which leaving unused ones out is measured.
    /// No picture changes; what was asked for `without` stays away.
    pub fn keep_unused(&mut self, scene: &Scene, flat: &FlatMesh, without: Without) {
        self.materials = (0..scene.materials.len()).collect();
        if !without.textures {
            self.images = (0..scene.images.len()).collect();
            self.uvs = !flat.uvs.is_empty();
        }
    }

    fn leave_out(&mut self, what: impl Into<String>, why: &str, bytes: u64) {
        self.left_out.push(LeftOut { what: what.into(), why: why.to_owned(), bytes });
    }

    fn left_out_materials(&mut self, scene: &Scene) {
        let unused = scene.materials.len() - self.materials.len();
        if unused > 0 {
            let bytes = (unused * size_of::<Material>()) as u64;
            self.left_out.push(LeftOut::counted(unused as u64, "material", "no triangle uses them", bytes));
        }
    }

    fn select_images(&mut self, scene: &Scene, flat: &FlatMesh, without: Without) {
        let mut is_used = vec![false; scene.images.len()];
        for &material in &self.materials {
            for texture in effective_textures(&scene.materials[material], without) {
                is_used[texture.image] = true;
            }
        }
        let is_on_a_surface = is_used.contains(&true);
        let mut why = "no kept material samples them with effect";
        if without.textures {
            why = ASKED;
            is_used.fill(false);
        } else if is_on_a_surface && flat.uvs.is_empty() {
            why = "no vertex has texture coordinates";
            is_used.fill(false);
        } else {
            self.uvs = is_on_a_surface;
        }
        if let (Environment::Map { image, .. }, false) = (&scene.environment, without.textures)
            && let Some(used) = is_used.get_mut(*image)
        {
            *used = true;
        }
        self.images = (0..is_used.len()).filter(|&image| is_used[image]).collect();
        let unused = is_used.len() - self.images.len();
        if unused > 0 {
            let sizes = scene.images.iter().zip(&is_used).filter(|(_, is_used)| !**is_used);
            let bytes = sizes.map(|(image, _)| image.rgba.len() as u64).sum();
            self.left_out.push(LeftOut::counted(unused as u64, "image", why, bytes));
        }
    }

    fn select_arrays(&mut self, flat: &FlatMesh, without: Without) {
        if !flat.uvs.is_empty() && !self.uvs {
            let why = if without.textures { ASKED } else { "no kept material has a texture" };
            self.leave_out("texture coordinates", why, size_of_val(flat.uvs.as_slice()) as u64);
        }
        self.normals = has_smooth_normals(flat);
        if !flat.normals.is_empty() && !self.normals {
            let why =
                "each equals its triangle's own normal within 0.5624 degrees, the error of a normal code";
            self.leave_out("vertex normals", why, size_of_val(flat.normals.as_slice()) as u64);
        }
        self.colors = flat.colors.iter().any(|&color| color != [255; 4]);
        if !flat.colors.is_empty() && !self.colors {
            self.leave_out("vertex colours", "all are white", size_of_val(flat.colors.as_slice()) as u64);
        }
    }
}

fn used_materials(flat: &FlatMesh) -> Vec<usize> {
    let mut materials: Vec<usize> =
        flat.material_runs.iter().map(|&(_, material)| material as usize).collect();
    materials.sort_unstable();
    materials.dedup();
    materials
}

/// The textures that change what a material looks like.
fn effective_textures(material: &Material, without: Without) -> impl Iterator<Item = TextureRef> {
    // An unlit surface shows its base colour alone.
    let is_lit = !material.unlit;
    let emits = is_lit && material.emissive != [0.0; 3];
    let transmits = is_lit && material.transmission > 0.0 && !without.refraction;
    [
        material.base_texture,
        material.metallic_roughness_texture.filter(|_| is_lit),
        material.emissive_texture.filter(|_| emits),
        material.transmission_texture.filter(|_| transmits),
    ]
    .into_iter()
    .flatten()
}

/// Whether a corner's normal differs from its triangle's own by more than a code's error.
fn has_smooth_normals(flat: &FlatMesh) -> bool {
    !flat.normals.is_empty()
        && flat.triangles.iter().any(|triangle| {
            let [a, b, c] = triangle.map(|index| DVec3::from(flat.positions[index as usize]));
            // Degenerate triangles have no normal of their own, and are never seen.
            (b - a).cross(c - a).try_normalize().is_some_and(|own| {
                triangle.iter().any(|&index| {
                    let normal = DVec3::from(flat.normals[index as usize].map(f64::from));
                    normal != DVec3::ZERO && normal.dot(own) < COS_NORMAL_CODE_ERROR
                })
            })
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;

    fn image(bytes: usize) -> Image {
        Image { name: String::new(), width: bytes as u32 / 4, height: 1, rgba: vec![0; bytes].into() }
    }

    fn texture(image: usize) -> Option<TextureRef> {
        Some(TextureRef { image, wrap_s: Default::default(), wrap_t: Default::default(), nearest: false })
    }

    /// Three materials, the last unused; images: base, emissive without emission, unused material's, environment's.
    fn scene() -> Scene {
        Scene {
            materials: vec![
                Material { base_texture: texture(0), emissive_texture: texture(1), ..Material::default() },
                Material::default(),
                Material { base_texture: texture(2), ..Material::default() },
            ],
            images: vec![image(4), image(8), image(16), image(32)],
            environment: Environment::Map { image: 3, scale: 1.0 },
            ..Scene::default()
        }
    }

    fn flat(normal: [f32; 3]) -> FlatMesh {
        FlatMesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            normals: vec![[0.0, 0.0, 1.0], normal, [0.0; 3]],
            uvs: vec![[0.0; 2]; 3],
            colors: vec![[255; 4]; 3],
            triangles: vec![[0, 1, 2], [0, 1, 1]],
            material_runs: vec![(0, 1), (1, 0)],
            objects: Vec::new(),
        }
    }

    #[test]
    fn keeps_what_has_an_effect_and_says_what_has_none() {
        let selection = Selection::of(&scene(), &flat([0.0, 0.0, 1.0]), Without::default());
        assert_eq!((selection.materials, selection.images), (vec![0, 1], vec![0, 3]));
        assert_eq!((selection.uvs, selection.normals, selection.colors), (true, false, false));
        let left_out: Vec<_> =
            selection.left_out.iter().map(|entry| (entry.what.as_str(), entry.bytes)).collect();
        let material = size_of::<Material>() as u64;
        assert_eq!(
            left_out,
            [("1 material", material), ("2 images", 24), ("vertex normals", 36), ("vertex colours", 12)]
        );
    }

    #[test]
    fn without_textures_goes_without_images_and_coordinates() {
        let without = Without { textures: true, shadows: true, ..Without::default() };
        let selection = Selection::of(&scene(), &flat([0.0, 0.0, 1.0]), without);
        assert_eq!((selection.images.len(), selection.uvs), (0, false));
        let left_out: Vec<_> = selection.left_out.iter().map(|entry| entry.what.as_str()).collect();
        assert_eq!(
            left_out,
            [
                "1 material",
                "4 images",
                "texture coordinates",
                "vertex normals",
                "vertex colours",
                "shadow rays"
            ]
        );
    }

    #[test]
    fn normals_stay_when_they_say_more_than_a_code() {
        let tilted = |degrees: f64| {
            [libm::sin(degrees.to_radians()) as f32, 0.0, libm::cos(degrees.to_radians()) as f32]
        };
        for (degrees, kept) in [(0.0, false), (0.5, false), (0.57, true), (90.0, true), (180.0, true)] {
            assert_eq!(
                Selection::of(&scene(), &flat(tilted(degrees)), Without::default()).normals,
                kept,
                "{degrees}"
            );
        }
    }

    #[test]
    fn transmission_texture_needs_refraction() {
        let mut scene = scene();
        scene.materials[1].transmission = 1.0;
        scene.materials[1].transmission_texture = texture(1);
        let flat = flat([0.0, 0.0, 1.0]);
        assert_eq!(Selection::of(&scene, &flat, Without::default()).images, [0, 1, 3]);
        let without = Without { refraction: true, ..Without::default() };
        assert_eq!(Selection::of(&scene, &flat, without).images, [0, 3]);
    }

    #[test]
    fn textures_need_coordinates() {
        let mut flat = flat([0.0, 0.0, 1.0]);
        flat.uvs.clear();
        let selection = Selection::of(&scene(), &flat, Without::default());
        assert_eq!((selection.images, selection.uvs), (vec![3], false));
    }
}
