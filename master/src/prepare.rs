//! From a file to a pack: import, flatten, select, pack.

use crate::input;
use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tessera_geometry::{CameraPose, DVec3};
use tessera_kdtree::BuildOptions;
use tessera_pack::{
    Ambient, Environment, EnvironmentKind, Forced, ImageInput, Light, LightKind, Material, MaterialFlags,
    NO_TEXTURE, NormalCode, Pack, PackBuffer, PackError, PackInput, PackOptions, PackStage, PackStats, Plain,
    Wrap, build_pack_with,
    format::{HEADER_LEN, check_header},
};
use tessera_scene::{
    AlphaMode, Camera, CameraTrack, FlatMesh, FlatObject, LeftOut, LoadOptions, Scene, SceneError, Selection,
    TextureRef, Without,
};
use tessera_wire::limits;

/// What of a scene is packed, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct PrepareOptions {
    /// Where to look for sources.
    pub load: LoadOptions,
    /// Features to leave out.
    pub without: Without,
    /// Vertex data held as `f32`.
    pub plain: Plain,
    /// kd-tree.
    pub tree: BuildOptions,
    /// Finest grid tried: intervals of the longest side, 32..=8192; see [`PackOptions::max_intervals`].
    pub max_intervals: u32,
    /// Bits of a packed position inside its cell, along an axis, 1..=10; see [`PackOptions::position_bits`].
    pub position_bits: u32,
    /// Code of packed normals.
    pub normal_code: NormalCode,
    /// Bits of a component of packed texture coordinates, 1..=16; see [`PackOptions::uv_bits`].
    pub uv_bits: u32,
    /// A part that is packed though the scene does not need it.
    pub forced: Option<Forced>,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        let PackOptions { plain, tree, max_intervals, position_bits, normal_code, uv_bits, forced } =
            PackOptions::default();
        Self {
            load: LoadOptions::default(),
            without: Without::default(),
            plain,
            tree,
            max_intervals,
            position_bits,
            normal_code,
            uv_bits,
            forced,
        }
    }
}

impl PrepareOptions {
    /// Those of packing.
    pub fn pack(&self) -> PackOptions {
        let Self { plain, tree, max_intervals, position_bits, normal_code, uv_bits, forced, .. } = *self;
        PackOptions { plain, tree, max_intervals, position_bits, normal_code, uv_bits, forced }
    }
}

/// A pack, and everything about the scene that a user may want to know.
pub struct Prepared {
    /// File or generator.
    pub name: String,
    /// What workers hold.
    pub pack: Pack,
    /// Named views, at least one; the first is the default.
    pub cameras: Vec<Camera>,
    /// Cameras among these that move; none of a `.tpack` file.
    pub camera_tracks: Vec<CameraTrack>,
    /// What was in the source; none for a `.tpack` file.
    pub source: Option<Source>,
    /// What was left out of the pack, and why.
    pub left_out: Vec<LeftOut>,
    /// What was read but not understood, or mended.
    pub warnings: Vec<String>,
    /// Defaults that were put in, and where a generated scene comes from.
    pub notes: Vec<String>,
    /// Where the time went.
    pub timings: PrepareTimings,
}

/// What a source holds, before anything is left out.
#[derive(Clone, Debug)]
pub struct Source {
    /// Nodes of the tree.
    pub nodes: usize,
    /// Meshes, each possibly used by several nodes.
    pub meshes: usize,
    /// Names of all materials, those that nothing uses among them.
    pub materials: Vec<String>,
    /// Name, width and height of every image.
    pub images: Vec<(String, u32, u32)>,
    /// Names of all lights.
    pub lights: Vec<String>,
    /// Faulty input that was left out, by kind: while reading, then while packing.
    pub dropped: Vec<(&'static str, u64)>,
    /// How the pack came out.
    pub stats: PackStats,
}

/// Where the time went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PrepareTimings {
    /// Reading, parsing and decoding files.
    pub read: Duration,
    /// Flattening, selecting, quantising, building the tree, hashing.
    pub pack: Duration,
}

/// Why a scene cannot be prepared; each message says what, where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum PrepareError {
    /// The source cannot be used.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The source cannot be packed.
    #[error("{name}: {source}")]
    Pack {
        /// File or generator.
        name: String,
        /// Why.
        source: tessera_pack::BuildError,
    },
    /// Every triangle was faulty.
    #[error("{name}: no triangle is left to render; all were faulty and dropped ({dropped}); mend the file")]
    Empty {
        /// File or generator.
        name: String,
        /// Kinds and counts of what was dropped.
        dropped: String,
    },
    /// A `.tpack` file cannot be used.
    #[error("{path}: {what}", path = path.display())]
    Bundle {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
}

/// Reads and packs whatever the user named: a source, a scene file, or a `.tpack` file, which is taken as it is.
pub fn prepare(path: &Path, options: &PrepareOptions) -> Result<Prepared, PrepareError> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack")) {
        return read_bundle(path, options.without);
    }
    let start = Instant::now();
    let mut scene = tessera_scene::load(path, &options.load)?;
    scene.name = path.display().to_string();
    prepare_scene(scene, options, start.elapsed())
}

/// Reads and checks a `.tpack` file. What is left out `without` some feature is what no ray will be traced for.
fn read_bundle(path: &Path, without: Without) -> Result<Prepared, PrepareError> {
    let start = Instant::now();
    let pack = read_pack(path).map_err(|what| PrepareError::Bundle { path: path.to_owned(), what })?;
    let mut notes =
        vec!["the bundle is used as it is: what it leaves out was decided when it was packed".into()];
    let mut cameras: Vec<_> = pack.cameras().iter().map(scene_camera).collect();
    if cameras.is_empty() {
        let bounds = pack.tree().bounds;
        let corner = |local| pack.frame().to_world(local);
        // As for a source without cameras: one that frames the box.
        let mut framing = Scene::default();
        tessera_scene::scene_file::add_defaults(&mut framing, (corner(bounds.min), corner(bounds.max)));
        cameras = framing.cameras;
        notes.push("default camera: the bundle has none; one named `default` frames its box".into());
    }
    Ok(Prepared {
        name: path.display().to_string(),
        cameras,
        camera_tracks: Vec::new(),
        source: None,
        left_out: without.rays_left_out(),
        warnings: Vec::new(),
        notes,
        timings: PrepareTimings { read: start.elapsed(), pack: Duration::ZERO },
        pack,
    })
}

fn read_pack(path: &Path) -> Result<Pack, String> {
    let unreadable = |e: std::io::Error| format!("cannot be read: {e}");
    let (mut file, length) = input::open(path, limits::PACK_BYTES)?;
    // The header first: a length is believed only of what begins like a pack.
    let mut header = Vec::with_capacity(HEADER_LEN);
    Read::by_ref(&mut file).take(HEADER_LEN as u64).read_to_end(&mut header).map_err(unreadable)?;
    check_header(&header, length).map_err(|e| e.to_string())?;
    let no_memory = || PackError::OutOfMemory(length).to_string();
    let mut buffer = usize::try_from(length).ok().and_then(PackBuffer::with_len).ok_or_else(no_memory)?;
    // As long as its length says, the file has a whole header.
    let (first, rest) = buffer.as_mut_slice().split_at_mut(HEADER_LEN);
    first.copy_from_slice(&header);
    file.read_exact(rest).map_err(unreadable)?;
    Pack::from_buffer(buffer).map_err(|e| e.to_string())
}

/// Packs a scene that took `read` to load.
pub fn prepare_scene(
    scene: Scene,
    options: &PrepareOptions,
    read: Duration,
) -> Result<Prepared, PrepareError> {
    prepare_scene_with(scene, options, read, |_| {})
}

/// The same as [`prepare_scene`]; says when each stage of packing begins to `on_stage`.
pub fn prepare_scene_with(
    mut scene: Scene,
    options: &PrepareOptions,
    read: Duration,
    on_stage: impl FnMut(PackStage),
) -> Result<Prepared, PrepareError> {
    let start = Instant::now();
    let mut flat = scene.flatten()?;
    let mut selection = Selection::of(&scene, &flat, options.without);
    let keeps_unused = options.forced == Some(Forced::Unused);
    if keeps_unused {
        selection.keep_unused(&scene, &flat, options.without);
    }
    let mut source = Source {
        nodes: scene.nodes.len(),
        meshes: scene.meshes.len(),
        materials: scene.materials.iter().map(|m| m.name.clone()).collect(),
        images: scene.images.iter().map(|i| (i.name.clone(), i.width, i.height)).collect(),
        lights: scene.lights.iter().map(|l| l.name.clone()).collect(),
        dropped: std::mem::take(&mut scene.dropped),
        stats: PackStats::default(),
    };
    let objects = std::mem::take(&mut flat.objects);
    let meshes: Vec<_> = scene.meshes.iter_mut().map(|mesh| std::mem::take(&mut mesh.name)).collect();
    // A large scene's own vertices are not needed any more; packing wants the memory.
    scene.meshes = Vec::new();
    let input = pack_input(&scene, flat, &selection, &options.without, keeps_unused);
    let Scene { name, cameras, camera_tracks, mut warnings, notes, .. } = scene;
    let (pack, stats) = build_pack_with(input, &options.pack(), on_stage)
        .map_err(|source| PrepareError::Pack { name: name.clone(), source })?;
    source.dropped.extend_from_slice(&stats.dropped);
    if stats.triangles == 0 {
        let found = |(what, count): &(&'static str, u64)| (*count > 0).then(|| format!("{count} {what}"));
        let dropped: Vec<_> = source.dropped.iter().filter_map(found).collect();
        return Err(PrepareError::Empty { name, dropped: dropped.join(", ") });
    }
    warnings.extend_from_slice(&stats.warnings);
    let mut left_out = selection.left_out;
    left_out.extend(stats.unneeded.iter().map(|u| LeftOut::counted(u.count, u.what, u.why, u.bytes)));
    if !options.plain.positions {
        warnings.extend(too_small(&objects, &meshes, stats.step));
    }
    source.stats = stats;
    let timings = PrepareTimings { read, pack: start.elapsed() };
    let source = Some(source);
    Ok(Prepared { name, pack, cameras, camera_tracks, source, left_out, warnings, notes, timings })
}

/// The camera of this name, or the first.
pub fn choose_camera<'a>(cameras: &'a [Camera], name: Option<&str>) -> Result<&'a Camera, String> {
    let found = match name {
        None => cameras.first(),
        Some(name) => cameras.iter().find(|c| c.name == name),
    };
    found.ok_or_else(|| {
        let known = tessera_scene::import::listed(cameras.iter().map(|c| c.name.as_str()));
        match name {
            Some(name) => format!("no camera `{name}` in the scene; there is {known}"),
            None => "the scene has no camera; give one with --eye, --target and --fov".into(),
        }
    })
}

/// Sides of fewer voxels make an object visibly blocky: its vertices are off by half a voxel, a 128th of it at this size.
const LEAST_VOXELS: f64 = 64.0;

/// A warning if there are objects of fewer than [`LEAST_VOXELS`] voxels of side `step` along their longest side. Those without any extent
/// are dropped, and counted where they are.
fn too_small(objects: &[FlatObject], meshes: &[String], step: f64) -> Option<String> {
    let voxels = |object: &&FlatObject| object.extent / step;
    let is_small = |object: &&FlatObject| object.extent > 0.0 && voxels(object) < LEAST_VOXELS;
    let smallest = objects.iter().filter(is_small).min_by(|a, b| a.extent.total_cmp(&b.extent))?;
    let name = match meshes.get(smallest.mesh).map_or("", String::as_str) {
        "" => format!("mesh {}", smallest.mesh),
        name => format!("mesh {}", tessera_scene::import::listed(std::iter::once(name))),
    };
    Some(format!(
        "{} of {} objects are smaller than {LEAST_VOXELS} voxels, the smallest, {name}, {:.1}: they come out blocky beside so large a scene; \
         keep the vertices with --plain=positions, or leave out what is far away",
        objects.iter().filter(is_small).count(),
        objects.len(),
        voxels(&smallest)
    ))
}

/// Arrays for the packer: what the selection keeps, indices counted anew; and all images of the selection, those too that nothing names,
/// if it `keeps_unused` ones.
fn pack_input(
    scene: &Scene,
    flat: FlatMesh,
    selection: &Selection,
    without: &Without,
    keeps_unused: bool,
) -> PackInput {
    let mut textures = Textures { scene, selection, inputs: Vec::new(), places: HashMap::new() };
    let materials: Vec<_> = selection
        .materials
        .iter()
        .map(|&index| pack_material(&scene.materials[index], without, &mut textures))
        .collect();
    let environment = pack_environment(&scene.environment, &mut textures);
    if keeps_unused {
        selection.images.iter().for_each(|&image| textures.place_unused(image));
    }
    let mut places = vec![0; scene.materials.len()];
    for (place, &index) in (0..).zip(&selection.materials) {
        places[index] = place;
    }
    let FlatMesh { positions, normals, uvs, colors, triangles, material_runs, objects: _ } = flat;
    PackInput {
        positions,
        normals: if selection.normals { normals } else { Vec::new() },
        uvs: if selection.uvs { uvs } else { Vec::new() },
        colors: if selection.colors { colors } else { Vec::new() },
        triangles,
        material_runs: material_runs
            .into_iter()
            .map(|(first, material)| (first, places[material as usize]))
            .collect(),
        materials,
        textures: textures.inputs,
        lights: scene.lights.iter().map(pack_light).collect(),
        light_positions: scene.lights.iter().map(|l| l.position.to_array()).collect(),
        cameras: scene.cameras.iter().map(pack_camera).collect(),
        ambient: Ambient { radiance: scene.ambient },
        environment,
    }
}

/// Textures in the order in which they are first asked for; one for each image and way of sampling it.
struct Textures<'a> {
    scene: &'a Scene,
    selection: &'a Selection,
    inputs: Vec<ImageInput>,
    places: HashMap<TextureRef, u32>,
}

impl Textures<'_> {
    /// The texture's place in the pack; none for an image that the selection leaves out.
    fn place(&mut self, texture: Option<TextureRef>) -> u32 {
        let kept = |t: &TextureRef| self.selection.images.binary_search(&t.image).is_ok();
        let Some(texture) = texture.filter(kept) else { return NO_TEXTURE };
        *self.places.entry(texture).or_insert_with(|| {
            let image = &self.scene.images[texture.image];
            self.inputs.push(ImageInput {
                name: image.name.clone(),
                width: image.width,
                height: image.height,
                rgba: image.rgba.clone(),
                wrap_s: pack_wrap(texture.wrap_s),
                wrap_t: pack_wrap(texture.wrap_t),
                nearest: texture.nearest,
            });
            self.inputs.len() as u32 - 1
        })
    }

    /// A place for an image that nothing has asked for.
    fn place_unused(&mut self, image: usize) {
        if self.places.keys().all(|texture| texture.image != image) {
            let wrap = tessera_scene::Wrap::default();
            self.place(Some(TextureRef { image, wrap_s: wrap, wrap_t: wrap, nearest: false }));
        }
    }
}

fn pack_wrap(wrap: tessera_scene::Wrap) -> Wrap {
    match wrap {
        tessera_scene::Wrap::Repeat => Wrap::Repeat,
        tessera_scene::Wrap::Mirror => Wrap::Mirror,
        tessera_scene::Wrap::Clamp => Wrap::Clamp,
    }
}

fn pack_material(
    material: &tessera_scene::Material,
    without: &Without,
    textures: &mut Textures<'_>,
) -> Material {
    let (alpha_flag, alpha_cutoff) = match material.alpha {
        AlphaMode::Opaque => (0, 0.0),
        AlphaMode::Mask(cutoff) => (MaterialFlags::ALPHA_MASK, cutoff),
        AlphaMode::Blend => (MaterialFlags::ALPHA_BLEND, 0.0),
    };
    let flag = |on: bool, bit: u32| if on { bit } else { 0 };
    let transmissive = material.transmission > 0.0 && !without.refraction;
    Material {
        base_color: material.base_color,
        specular: material.specular,
        metallic: material.metallic,
        emissive: material.emissive,
        roughness: material.roughness,
        transmission: if transmissive { material.transmission } else { 0.0 },
        ior: material.ior,
        alpha_cutoff,
        flags: alpha_flag
            | flag(material.double_sided, MaterialFlags::DOUBLE_SIDED)
            | flag(material.unlit, MaterialFlags::UNLIT)
            | flag(material.thin_walled, MaterialFlags::THIN_WALLED),
        base_texture: textures.place(material.base_texture),
        metallic_roughness_texture: textures.place(material.metallic_roughness_texture),
        emissive_texture: textures.place(material.emissive_texture),
        transmission_texture: textures.place(material.transmission_texture.filter(|_| transmissive)),
    }
}

fn pack_light(light: &tessera_scene::Light) -> Light {
    let (kind, cos_inner, cos_outer) = match light.kind {
        tessera_scene::LightKind::Point => (LightKind::Point, 1.0, 0.0),
        tessera_scene::LightKind::Directional => (LightKind::Directional, 1.0, 0.0),
        tessera_scene::LightKind::Spot { inner, outer } => {
            (LightKind::Spot, libm::cosf(inner), libm::cosf(outer))
        }
    };
    Light {
        position: light.position.as_vec3().to_array(),
        kind: kind as u32,
        direction: light.direction.as_vec3().to_array(),
        range: light.range,
        intensity: light.intensity,
        cos_inner,
        cos_outer,
        reserved: [0; 3],
    }
}

fn pack_camera(camera: &Camera) -> tessera_pack::Camera {
    let CameraPose { eye, target, up, fov_degrees } = camera.pose;
    tessera_pack::Camera {
        eye: eye.to_array(),
        target: target.to_array(),
        up: up.to_array(),
        fov_degrees,
        name: tessera_pack::Camera::encode_name(&camera.name),
    }
}

fn scene_camera(camera: &tessera_pack::Camera) -> Camera {
    let [eye, target, up] = [camera.eye, camera.target, camera.up].map(DVec3::from_array);
    let pose = CameraPose { eye, target, up, fov_degrees: camera.fov_degrees };
    Camera { name: camera.name().unwrap_or_default().to_owned(), pose }
}

fn pack_environment(environment: &tessera_scene::Environment, textures: &mut Textures<'_>) -> Environment {
    match *environment {
        tessera_scene::Environment::None => Environment::default(),
        tessera_scene::Environment::Gradient { zenith, horizon, nadir } => Environment {
            kind: EnvironmentKind::Gradient as u32,
            zenith,
            horizon,
            nadir,
            ..Environment::default()
        },
        tessera_scene::Environment::Map { image, scale } => {
            let sampling = TextureRef {
                image,
                wrap_s: tessera_scene::Wrap::Repeat,
                wrap_t: tessera_scene::Wrap::Clamp,
                nearest: false,
            };
            match textures.place(Some(sampling)) {
                NO_TEXTURE => Environment::default(),
                texture => Environment {
                    kind: EnvironmentKind::Map as u32,
                    zenith: [scale; 3],
                    texture,
                    ..Environment::default()
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_scene::{Image, Mesh, Node, Primitive};

    /// Two triangles of different materials; both share one image, the second material is glass with a texture of its own.
    fn scene() -> Scene {
        let texture = |image, nearest| {
            let wrap = tessera_scene::Wrap::Repeat;
            Some(TextureRef { image, wrap_s: wrap, wrap_t: tessera_scene::Wrap::Clamp, nearest })
        };
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let part = |triangle, material| Primitive {
            positions: positions.map(DVec3::from_array).to_vec(),
            uvs: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]],
            triangles: vec![triangle],
            material,
            ..Primitive::default()
        };
        let image = |name: &str, alpha| Image {
            name: name.into(),
            width: 1,
            height: 1,
            rgba: vec![10, 20, 30, alpha].into(),
        };
        Scene {
            name: "test".into(),
            meshes: vec![Mesh {
                name: String::new(),
                primitives: vec![part([0, 1, 2], 0), part([0, 2, 3], 2)],
            }],
            nodes: vec![Node {
                name: String::new(),
                transform: glam::DMat4::IDENTITY,
                mesh: Some(0),
                children: Vec::new(),
            }],
            roots: vec![0],
            materials: vec![
                tessera_scene::Material { base_texture: texture(0, false), ..Default::default() },
                tessera_scene::Material { base_texture: texture(2, false), ..Default::default() },
                tessera_scene::Material {
                    base_texture: texture(0, false),
                    emissive_texture: texture(0, true),
                    emissive: [1.0; 3],
                    transmission: 0.5,
                    transmission_texture: texture(1, false),
                    alpha: AlphaMode::Mask(0.25),
                    double_sided: false,
                    ..Default::default()
                },
            ],
            // The shared one is a hole to the mask.
            images: vec![image("shared", 40), image("glass", 255), image("unused", 255)],
            cameras: ["north", "south"]
                .map(|name| {
                    let pose = CameraPose {
                        eye: DVec3::new(0.0, 0.0, 5.0),
                        target: DVec3::ZERO,
                        up: DVec3::Y,
                        fov_degrees: 40.0,
                    };
                    Camera { name: name.into(), pose }
                })
                .to_vec(),
            ..Scene::default()
        }
    }

    fn prepared(without: Without) -> Prepared {
        let options = PrepareOptions { without, ..PrepareOptions::default() };
        prepare_scene(scene(), &options, Duration::ZERO).unwrap()
    }

    #[test]
    fn only_what_is_used_is_packed_and_only_once() {
        let prepared = prepared(Without::default());
        let pack = &prepared.pack;
        assert_eq!((pack.triangle_count(), pack.materials().len()), (2, 2));
        // The shared image interpolated, the same not interpolated, and the glass's own.
        assert_eq!(pack.textures().len(), 3);
        let [opaque, glass] = [0, 1].map(|m| pack.materials()[m]);
        assert_eq!(opaque.base_texture, glass.base_texture);
        assert_ne!(glass.base_texture, glass.emissive_texture);
        assert_eq!((glass.transmission, glass.alpha_cutoff), (0.5, 0.25));
        assert_eq!(opaque.flags, MaterialFlags::DOUBLE_SIDED);
        assert_eq!(glass.flags, MaterialFlags::ALPHA_MASK);
        assert_eq!(prepared.source.unwrap().images.len(), 3);
        assert!(prepared.left_out.iter().any(|l| l.what.contains("image")), "{:?}", prepared.left_out);
    }

    #[test]
    fn objects_below_64_voxels_are_reported() {
        // Beside a shape of size 1 the finest grid has voxels of 2^-23.
        let beside = |voxels: f64, plain: bool| {
            let mut scene = scene();
            scene.meshes.push(scene.meshes[0].clone());
            scene.meshes[1].name = "teapot".into();
            for part in &mut scene.meshes[1].primitives {
                part.positions.iter_mut().for_each(|p| *p *= voxels / 8_388_608.0);
            }
            let transform = glam::DMat4::from_translation(DVec3::splat(0.25));
            let node = Node { name: String::new(), transform, mesh: Some(1), children: Vec::new() };
            scene.nodes.push(node);
            scene.roots.push(1);
            let plain = Plain { positions: plain, ..Plain::default() };
            let options = PrepareOptions { plain, ..PrepareOptions::default() };
            prepare_scene(scene, &options, Duration::ZERO).unwrap().warnings
        };
        let warnings = beside(10.0, false);
        assert_eq!(warnings.len(), 1);
        let says = "1 of 2 objects are smaller than 64 voxels, the smallest, mesh \"teapot\", 10.0:";
        assert!(warnings[0].starts_with(says), "{}", warnings[0]);
        assert_eq!(beside(63.0, false).len(), 1);
        assert_eq!(beside(65.0, false), Vec::<String>::new());
        assert_eq!(beside(10.0, true), Vec::<String>::new(), "they are kept as they are");
        assert_eq!(prepared(Without::default()).warnings, Vec::<String>::new());
    }

    #[test]
    fn what_is_left_out_is_not_packed() {
        let refraction = prepared(Without { refraction: true, ..Without::default() });
        let glass = refraction.pack.materials()[1];
        assert_eq!((glass.transmission, glass.transmission_texture), (0.0, NO_TEXTURE));
        assert_eq!(refraction.pack.textures().len(), 2);

        let textures = prepared(Without { textures: true, ..Without::default() });
        assert!(textures.pack.textures().is_empty() && !textures.pack.mesh().has_uvs());
        assert_eq!(textures.pack.materials()[1].base_texture, NO_TEXTURE);
        assert!(textures.left_out.len() > 1, "{:?}", textures.left_out);
    }

    #[test]
    fn options_of_packing_reach_the_pack() {
        assert_eq!(PrepareOptions::default().pack(), PackOptions::default());
        let options = PrepareOptions {
            plain: Plain { uvs: true, ..Plain::default() },
            tree: BuildOptions { max_refs: 1, ..BuildOptions::default() },
            max_intervals: 33,
            position_bits: 4,
            normal_code: NormalCode::Oct,
            uv_bits: 5,
            ..PrepareOptions::default()
        };
        let PackOptions { plain, tree, max_intervals, position_bits, normal_code, uv_bits, forced: _ } =
            options.pack();
        assert_eq!((plain, tree), (options.plain, options.tree));
        assert_eq!((max_intervals, position_bits, normal_code, uv_bits), (33, 4, NormalCode::Oct, 5));
        let pack = prepare_scene(scene(), &options, Duration::ZERO).unwrap().pack;
        assert_eq!(pack.head().cells.iter().max(), Some(&33));
        let faulty = PrepareOptions { position_bits: 0, ..options };
        let error = prepare_scene(scene(), &faulty, Duration::ZERO).err().unwrap().to_string();
        assert_eq!(
            error,
            "test: positions of 0 bits an axis inside a cell were asked for; 1 to 10 are possible"
        );
    }

    #[test]
    fn a_bundle_keeps_its_cameras() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tpack");
        let first = prepared(Without::default());
        std::fs::write(&path, first.pack.bytes()).unwrap();
        let second = prepare(&path, &PrepareOptions::default()).unwrap();
        assert_eq!(second.pack.id(), first.pack.id());
        assert_eq!(second.cameras, first.cameras);
    }

    #[test]
    fn cameras_are_found_by_name_or_the_known_ones_are_listed() {
        let cameras = scene().cameras;
        assert_eq!(choose_camera(&cameras, None).unwrap().name, "north");
        assert_eq!(choose_camera(&cameras, Some("south")).unwrap().name, "south");
        assert_eq!(
            choose_camera(&cameras, Some("west")).unwrap_err(),
            "no camera `west` in the scene; there is \"north\", \"south\""
        );
        assert!(choose_camera(&[], None).unwrap_err().contains("--eye"));
    }

    #[test]
    fn a_scene_of_faulty_triangles_is_refused() {
        let mut scene = scene();
        for part in &mut scene.meshes[0].primitives {
            part.positions.iter_mut().for_each(|p| p.x = f64::NAN);
        }
        let error = prepare_scene(scene, &PrepareOptions::default(), Duration::ZERO).err().unwrap();
        let text = error.to_string();
        assert!(text.starts_with("test: ") && text.contains("2 vertex_not_finite"), "{text}");
    }
}
