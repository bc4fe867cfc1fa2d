//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The `gltf` crate gives the types of the JSON. Its importer, its validation and its readers are not used: they leave the
//! source's folder, index out of bounds on hostile files, and reserve what a file claims. Everything is checked here instead:
//! each index where it is followed, each range of bytes before it is read.
//!
//! | glTF | here |
//! |---|---|
//! | `baseColorFactor`, `-Texture`, metallic, roughness, `emissive` (times `KHR_materials_emissive_strength`) | the same |
//! | `KHR_materials_ior` | `ior`, and specular `((ior - 1) / (ior + 1))^2`, 0.04 without it; `ior = 0` means specular 1 |
//! | `KHR_materials_specular` | specular `min(specular * color, 1) * factor` |
//! | `KHR_materials_transmission` | `transmission`; thin-walled when neither of the next holds |
//! | `KHR_materials_volume` | solid when the thickness is above 0; absorption is left out |
//! | `KHR_materials_ior` without `_volume` | solid, so that what states an index of refraction bends light |
//! | `KHR_materials_pbrSpecularGlossiness` | diffuse as base, metallic 0, roughness `1 - glossiness`, specular as it is |
//! | `COLOR_0` | turned from linear to 8-bit sRGB codes; alpha stays linear |
//! | `KHR_texture_transform` | applied to the vertices' coordinates; a slot that wants other ones than the base is left out |
//! | strips, fans, no indices | triangle lists; points and lines are left out and counted |
//! | minification filter, mipmaps | left out; `NEAREST` magnification is kept |
//! | skins, morph targets | rest pose |
//! | animations | of a camera's node and of those above it: translation, rotation, scale; of all else rest pose |
//! | perspective camera | vertical field of view in degrees; orthographic cameras are left out |
//!
//! An extension that a file requires and that is not read is an error which names it; one it merely uses is a warning.

mod accessor;
mod animation;
mod container;
mod geometry;
mod material;
mod tree;

#[cfg(test)]
mod tests;

use super::limits::SOURCE_BYTES_MAX;
use super::report::{Report, clean};
use super::resolve::{Resolver, Syntax, read_source};
use crate::{Material, Scene, SceneError};
use ::gltf::json;
use json::Root;
use json::validation::Checked;
use std::path::Path;

/// Reads a `.gltf` or `.glb` file.
pub(super) fn import(path: &Path) -> Result<Scene, SceneError> {
    let mut report = Report::new(path);
    let mut resolver = Resolver::new(path)?;
    let bytes = read_source(path)?;
    let (json, embedded) = container::split(&bytes).map_err(|what| report.invalid(what))?;
    let root = container::parse(json, path, &mut report)?;
    let embedded = embedded.map(<[u8]>::to_vec);
    drop(bytes);
    let buffers = read_buffers(&root, embedded, &mut resolver, &report)?;

    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let mut scene = Scene { name, ..Scene::default() };
    let mut reader = material::MaterialReader::new(&root, &buffers, resolver);
    let mut uv_sources = Vec::with_capacity(root.materials.len() + 1);
    for index in 0..root.materials.len() {
        let (material, uv) = reader.read(index, &mut report)?;
        scene.materials.push(material);
        uv_sources.push(uv);
    }
    scene.images = reader.images;
    uv_sources.push(None);

    let mut reader =
        geometry::MeshReader { root: &root, buffers: &buffers, uv_sources, vertices: 0, triangles: 0 };
    for (index, mesh) in root.meshes.iter().enumerate() {
        let mesh = reader.read(index, mesh, &mut report).map_err(|what| report.invalid(what))?;
        scene.meshes.push(mesh);
    }
    let mut primitives = scene.meshes.iter().flat_map(|mesh| &mesh.primitives);
    if primitives.any(|primitive| primitive.material == scene.materials.len()) {
        // The standard's default material: white, metal, rough, and shown from the front.
        let name = "default".to_owned();
        scene.materials.push(Material { name, metallic: 1.0, double_sided: false, ..Material::default() });
    }
    let placed = tree::read(&root, &mut scene, &mut report).map_err(|what| report.invalid(what))?;
    let tracks = animation::read(&root, &buffers, &placed, &mut report);
    scene.camera_tracks = tracks.map_err(|what| report.invalid(what))?;
    report.finish(&mut scene);
    Ok(scene)
}

/// The bytes of every buffer; a buffer without uri is the embedded one (the first) or has none.
fn read_buffers(
    root: &Root,
    mut embedded: Option<Vec<u8>>,
    resolver: &mut Resolver,
    report: &Report,
) -> Result<Vec<Option<Vec<u8>>>, SceneError> {
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (index, buffer) in root.buffers.iter().enumerate() {
        let bytes = match &buffer.uri {
            Some(uri) => Some(resolver.read(uri, Syntax::Uri, SOURCE_BYTES_MAX)?),
            None if index == 0 => embedded.take(),
            None => None,
        };
        let claimed = buffer.byte_length.0;
        if let Some(bytes) = &bytes
            && (bytes.len() as u64) < claimed
        {
            return Err(report.invalid(format!(
                "buffers[{index}] claims {claimed} bytes but has {}; it is truncated or belongs to another file",
                bytes.len()
            )));
        }
        // What lies behind the claimed length (a GLB chunk is padded) belongs to nobody.
        let cut = |mut bytes: Vec<u8>| {
            bytes.truncate(usize::try_from(claimed).unwrap_or(usize::MAX));
            bytes
        };
        buffers.push(bytes.map(cut));
    }
    Ok(buffers)
}

/// `list[index]`, or a sentence that says what is missing.
fn get<'a, T>(list: &'a [T], index: usize, what: &str) -> Result<&'a T, String> {
    list.get(index).ok_or_else(|| format!("needs {what}[{index}], but there are {} {what}", list.len()))
}

/// The value of an enumeration that the JSON's types accept unchecked.
fn checked<T>(value: &Checked<T>) -> Result<&T, String> {
    match value {
        Checked::Valid(value) => Ok(value),
        Checked::Invalid => Err("has a value that glTF 2.0 does not know".to_owned()),
    }
}

/// A given name, or `what index`.
fn name_or(name: &Option<String>, what: &str, index: usize) -> String {
    match name {
        Some(name) if !name.is_empty() => clean(name),
        _ => format!("{what} {index}"),
    }
}
