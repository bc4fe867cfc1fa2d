//! A scene made ready to be traced.

use crate::bvh::Bvh;
use crate::digest::Digest;
use crate::image::{OracleImage, RayCounts};
use crate::path::Path;
use crate::surface::vector;
use crate::texture::Picture;
use crate::triangle::{Hit, Ray, Start};
use crate::view::{Lens, View, sample};
use crate::{NO_TRIANGLE, VERSION};
use glam::DVec3;
use rayon::prelude::*;
use tessera_scene::{
    AlphaMode, Environment, FlatMesh, Light, LightKind, Material, Scene, SceneError, TextureRef, Without,
    Wrap,
};

/// A scene as the oracle sees it. Make one and render any number of views of it.
pub struct Oracle {
    pub(crate) mesh: FlatMesh,
    /// Of each triangle.
    materials_of: Vec<u32>,
    /// Without what is left out.
    materials: Vec<Material>,
    /// By the scene's index; those that nothing looks at are none.
    pictures: Vec<Option<Picture>>,
    pub(crate) lights: Vec<Light>,
    pub(crate) ambient: DVec3,
    pub(crate) environment: Environment,
    pub(crate) without: Without,
    pub(crate) tree: Bvh,
    /// The largest coordinate of a vertex: bounds of errors are multiples of it.
    pub(crate) size: f64,
    hash: [u8; 32],
}

/// A scene that the oracle cannot trace; each message says what and where.
#[derive(Debug, thiserror::Error)]
pub enum OracleError {
    /// It cannot be laid out.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A material, light, image or the environment is unsound; importers and generators make none such.
    #[error("{scene}: {what}")]
    Unsound {
        /// The scene's name.
        scene: String,
        /// What is wrong with what.
        what: String,
    },
}

impl Oracle {
    /// Flattens `scene` and leaves out what `without` says: as the kernels do, textures with the environment's image, and the
    /// transmission of materials with refraction.
    ///
    /// # Errors
    /// What [`Scene::flatten`] refuses, and materials, lights or images with values out of range.
    pub fn new(scene: &Scene, without: Without) -> Result<Self, OracleError> {
        let mesh = scene.flatten()?;
        let unsound = |what: String| OracleError::Unsound { scene: scene.name.clone(), what };
        let are_surfaces_bare = without.textures || mesh.uvs.is_empty();

        // Leave out of the materials what is asked for, and pictures that have no place on a surface.
        let mut materials = scene.materials.clone();
        for (index, material) in materials.iter_mut().enumerate() {
            if without.refraction {
                material.transmission = 0.0;
            }
            if are_surfaces_bare {
                material.base_texture = None;
                material.metallic_roughness_texture = None;
                material.emissive_texture = None;
                material.transmission_texture = None;
            }
            check_material(material, scene.images.len())
                .map_err(|what| unsound(format!("material {index} ({}): {what}", material.name)))?;
        }
        let mut environment = scene.environment.clone();
        if matches!(environment, Environment::Map { .. }) && without.textures {
            environment = Environment::None;
        }
        check_environment(&environment, scene.images.len()).map_err(|what| unsound(what.to_owned()))?;
        check_radiance(&scene.ambient).map_err(|what| unsound(format!("ambient light: {what}")))?;
        for (index, light) in scene.lights.iter().enumerate() {
            check_light(light).map_err(|what| unsound(format!("light {index} ({}): {what}", light.name)))?;
        }

        // Keep the pictures that are looked at.
        let mut pictures: Vec<Option<Picture>> = scene.images.iter().map(|_| None).collect();
        let of_environment = match environment {
            Environment::Map { image, .. } => Some(image),
            _ => None,
        };
        let of_materials = materials.iter().flat_map(textures).map(|texture| texture.image);
        for index in of_materials.chain(of_environment) {
            if pictures[index].is_none() {
                let image = &scene.images[index];
                let picture = Picture::new(image).ok_or_else(|| {
                    unsound(format!("image {index} ({}): its texels do not fill its size", image.name))
                })?;
                pictures[index] = Some(picture);
            }
        }

        let mut materials_of = vec![0; mesh.triangles.len()];
        for (k, &(first, material)) in mesh.material_runs.iter().enumerate() {
            let end = mesh.material_runs.get(k + 1).map_or(mesh.triangles.len(), |next| next.0 as usize);
            materials_of[first as usize..end].fill(material);
        }
        let mut oracle = Self {
            tree: Bvh::new((0..mesh.triangles.len() as u32).map(|id| corners(&mesh, id))),
            mesh,
            materials_of,
            materials,
            pictures,
            lights: scene.lights.clone(),
            ambient: vector(scene.ambient),
            environment,
            without,
            size: 0.0,
            hash: [0; 32],
        };
        oracle.size = oracle.tree.largest_coordinate();
        oracle.hash = oracle.digest();
        Ok(oracle)
    }

    /// The same without its tree: every ray tries every triangle. The pictures are equal bit for bit; what the tree is judged by.
    pub fn by_brute_force(mut self) -> Self {
        let triangles = (0..self.mesh.triangles.len() as u32).map(|id| corners(&self.mesh, id));
        self.tree = Bvh::flat(triangles);
        self
    }

    /// BLAKE3 of everything but the view that a picture depends on: geometry, materials, texels, lights, what is left out, and
    /// [`VERSION`]. Names do not count.
    pub fn content_hash(&self) -> [u8; 32] {
        self.hash
    }

    /// Triangles of the flattened scene, those that no ray can hit included.
    pub fn triangles(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// What is left out.
    pub fn without(&self) -> Without {
        self.without
    }

    /// Renders `view`, rows side by side on the current rayon pool; the picture does not depend on the number of threads. `on_row` is
    /// called with the number of each row that is done, in no order.
    ///
    /// # Panics
    /// When [`View::check`] fails. Every view must be checked before it comes here; what is wrong with one is the user's to mend, and the
    /// check says it in words.
    pub fn render(&self, view: &View, on_row: impl Fn(u32) + Sync) -> OracleImage {
        view.check().expect("the view was checked");
        let lens = Lens::new(view).expect("the view was checked");
        let rows: Vec<Row> = (0..view.height)
            .into_par_iter()
            .map(|y| {
                let row = self.row(view, &lens, y);
                on_row(y);
                row
            })
            .collect();

        // Lay the rows below each other.
        let pixels = view.width as usize * view.height as usize;
        let mut image = OracleImage {
            width: view.width,
            height: view.height,
            color: Vec::with_capacity(pixels),
            depth: Vec::with_capacity(pixels),
            normal: Vec::with_capacity(pixels),
            id: Vec::with_capacity(pixels),
            rays: RayCounts::default(),
            cut_weight: 0.0,
        };
        for row in rows {
            image.rays += row.rays;
            image.cut_weight = image.cut_weight.max(row.cut_weight);
            for pixel in row.pixels {
                image.color.push(pixel.color);
                image.depth.push(pixel.first.map_or(f64::INFINITY, |hit| hit.t));
                image.normal.push(pixel.first.map_or([0.0; 3], |hit| self.normal(hit.id).to_array()));
                image.id.push(pixel.first.map_or(NO_TRIANGLE, |hit| hit.id));
            }
        }
        image
    }

    fn row(&self, view: &View, lens: &Lens, y: u32) -> Row {
        let mut path = Path::new(self, view.depth, view.min_weight);
        let mut cut_weight = 0.0_f64;
        let pixels = (0..view.width).map(|x| {
            let ray = |[right, down]: [f64; 2]| lens.ray(f64::from(x) + right, f64::from(y) + down);
            let (mut color, mut alpha, mut cut, mut first) = (DVec3::ZERO, 0.0, 0.0, None);
            for index in 0..view.samples {
                let seen = path.trace(ray(sample(index, view.samples)));
                color += seen.color;
                alpha += seen.alpha;
                cut += seen.cut;
                first = seen.first;
            }
            if view.samples > 1 {
                first = path.first(&ray([0.5, 0.5]));
            }
            let count = f64::from(view.samples);
            cut_weight = cut_weight.max(cut / count);
            let [r, g, b] = (color / count).to_array();
            Pixel { color: [r, g, b, alpha / count], first }
        });
        let pixels = pixels.collect();
        Row { pixels, rays: path.rays, cut_weight }
    }

    /// The nearest surface that a looking ray sees behind `start`: holes excepted, and backs that do not show.
    pub(crate) fn look(&self, ray: &Ray, start: Start) -> Option<Hit> {
        self.tree.nearest(ray, start, |hit| !self.is_hidden_back(hit, ray.direction) && !self.is_hole(hit))
    }

    pub(crate) fn material(&self, id: u32) -> &Material {
        &self.materials[self.materials_of[id as usize] as usize]
    }

    pub(crate) fn corners(&self, id: u32) -> [DVec3; 3] {
        corners(&self.mesh, id)
    }

    /// The picture of a texture in use.
    pub(crate) fn picture(&self, texture: &TextureRef) -> &Picture {
        self.pictures[texture.image].as_ref().expect("a picture in use was kept")
    }

    fn digest(&self) -> [u8; 32] {
        let mut digest = Digest::new("tessera oracle");
        digest.u64(u64::from(VERSION));
        let Without { textures: no_textures, shadows, reflection, refraction } = self.without;
        digest.bytes(&[no_textures, shadows, reflection, refraction].map(u8::from));

        // Geometry.
        let FlatMesh { positions, normals, uvs, colors, triangles, material_runs: _, objects: _ } =
            &self.mesh;
        digest.f64s(positions.as_flattened());
        digest.f32s(normals.as_flattened());
        digest.f32s(uvs.as_flattened());
        digest.bytes(colors.as_flattened());
        digest.u32s(triangles.as_flattened());
        digest.u32s(&self.materials_of);

        // Surfaces.
        digest.u64(self.materials.len() as u64);
        for material in &self.materials {
            digest_material(&mut digest, material);
        }
        for picture in &self.pictures {
            match picture {
                Some(picture) => picture.digest(&mut digest),
                None => digest.u64(0),
            }
        }

        // Light.
        digest.u64(self.lights.len() as u64);
        for Light { name: _, kind, position, direction, intensity, range } in &self.lights {
            let kind = match *kind {
                LightKind::Point => [0.0; 3],
                LightKind::Directional => [1.0, 0.0, 0.0],
                LightKind::Spot { inner, outer } => [2.0, inner, outer],
            };
            digest.f64s(&position.to_array());
            digest.f64s(&direction.to_array());
            digest.f32s(&[kind[0], kind[1], kind[2], intensity[0], intensity[1], intensity[2], *range]);
        }
        digest.f64s(&self.ambient.to_array());
        match &self.environment {
            Environment::None => digest.u64(0),
            Environment::Gradient { zenith, horizon, nadir } => {
                digest.u64(1);
                digest.f32s([*zenith, *horizon, *nadir].as_flattened());
            }
            Environment::Map { image, scale } => {
                digest.u64(2);
                digest.u64(*image as u64);
                digest.f32s(&[*scale]);
            }
        }
        digest.finish()
    }
}

struct Row {
    pixels: Vec<Pixel>,
    rays: RayCounts,
    cut_weight: f64,
}

struct Pixel {
    color: [f64; 4],
    first: Option<Hit>,
}

fn corners(mesh: &FlatMesh, id: u32) -> [DVec3; 3] {
    mesh.triangles[id as usize].map(|vertex| DVec3::from_array(mesh.positions[vertex as usize]))
}

fn textures(material: &Material) -> impl Iterator<Item = TextureRef> {
    let all = [
        material.base_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
    ];
    all.into_iter().flatten()
}

fn digest_material(digest: &mut Digest, material: &Material) {
    let Material {
        name: _,
        base_color,
        base_texture,
        specular,
        metallic,
        roughness,
        metallic_roughness_texture,
        emissive,
        emissive_texture,
        transmission,
        transmission_texture,
        ior,
        thin_walled,
        alpha,
        double_sided,
        unlit,
    } = material;
    digest.f32s(base_color);
    digest.f32s(specular);
    digest.f32s(emissive);
    digest.f32s(&[*metallic, *roughness, *transmission, *ior]);
    let (mode, cutoff) = match alpha {
        AlphaMode::Opaque => (0, 0.0),
        AlphaMode::Mask(cutoff) => (1, *cutoff),
        AlphaMode::Blend => (2, 0.0),
    };
    digest.bytes(&[mode, u8::from(*thin_walled), u8::from(*double_sided), u8::from(*unlit)]);
    digest.f32s(&[cutoff]);
    for texture in [base_texture, metallic_roughness_texture, emissive_texture, transmission_texture] {
        match texture {
            None => digest.u64(0),
            Some(TextureRef { image, wrap_s, wrap_t, nearest }) => {
                let mode = |wrap: &Wrap| match wrap {
                    Wrap::Repeat => 0,
                    Wrap::Mirror => 1,
                    Wrap::Clamp => 2,
                };
                digest.u64(*image as u64 + 1);
                digest.bytes(&[mode(wrap_s), mode(wrap_t), u8::from(*nearest)]);
            }
        }
    }
}

fn check_material(material: &Material, images: usize) -> Result<(), &'static str> {
    let in_unit_range = |values: &[f32]| values.iter().all(|value| (0.0..=1.0).contains(value));
    let shares = [material.metallic, material.roughness, material.transmission];
    if !in_unit_range(&material.base_color) || !in_unit_range(&material.specular) || !in_unit_range(&shares) {
        return Err("a colour or share is not in [0, 1]");
    }
    check_radiance(&material.emissive)?;
    if !(material.ior.is_finite() && material.ior > 0.0) {
        return Err("ior is not a finite number above 0");
    }
    if matches!(material.alpha, AlphaMode::Mask(cutoff) if !cutoff.is_finite()) {
        return Err("the cut-off of alpha is not a finite number");
    }
    if textures(material).any(|texture| texture.image >= images) {
        return Err("it names an image that does not exist");
    }
    Ok(())
}

fn check_light(light: &Light) -> Result<(), &'static str> {
    check_radiance(&light.intensity)?;
    let is_unit = (light.direction.length() - 1.0).abs() <= 1e-3;
    match light.kind {
        LightKind::Point | LightKind::Spot { .. } if !light.position.is_finite() => {
            Err("its position is not finite")
        }
        LightKind::Directional | LightKind::Spot { .. } if !is_unit => {
            Err("its direction is not a unit vector")
        }
        LightKind::Spot { inner, outer } if !(0.0 <= inner && inner < outer && outer <= 3.2) => {
            Err("its angles are not 0 <= inner < outer")
        }
        _ if light.range.is_nan() || light.range <= 0.0 => Err("its range is not above 0"),
        _ => Ok(()),
    }
}

fn check_environment(environment: &Environment, images: usize) -> Result<(), &'static str> {
    match environment {
        Environment::None => Ok(()),
        Environment::Gradient { zenith, horizon, nadir } => {
            check_radiance([*zenith, *horizon, *nadir].as_flattened())
        }
        Environment::Map { image, .. } if *image >= images => {
            Err("the environment names an image that does not exist")
        }
        Environment::Map { scale, .. } => check_radiance(&[*scale]),
    }
}

fn check_radiance(values: &[f32]) -> Result<(), &'static str> {
    let is_fine = values.iter().all(|value| value.is_finite() && *value >= 0.0);
    if is_fine { Ok(()) } else { Err("a radiance or intensity is negative or not finite") }
}
