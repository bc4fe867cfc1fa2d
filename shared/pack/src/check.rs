//! Checks on the arrays from which a pack is to be made.

use crate::error::BuildError;
use crate::input::{ImageInput, PackInput};
use crate::records::{NO_TEXTURE, Texture};
use crate::rules::{
    MAX_TEXTURE_SIDE, ambient_fault, camera_fault, environment_fault, light_fault, material_fault,
    texture_fault,
};
use std::collections::HashSet;

/// Checks everything that packing relies on; faults of single triangles and vertices are not errors, they are dropped and
/// counted.
pub(crate) fn check_input(input: &PackInput) -> Result<(), BuildError> {
    let vertices = input.positions.len();
    for (what, length) in [
        ("positions", vertices),
        ("triangles", input.triangles.len()),
        ("materials", input.materials.len()),
        ("textures", input.textures.len()),
        ("lights", input.lights.len()),
    ] {
        // The greatest u32 means 'none' in several places.
        if length as u64 >= u64::from(u32::MAX) {
            return fail(format!("{length} {what}: at most 4,294,967,294 fit a pack"));
        }
    }
    for (what, length, expected) in [
        ("normals", input.normals.len(), vertices),
        ("uvs", input.uvs.len(), vertices),
        ("colors", input.colors.len(), vertices),
        ("light_positions", input.light_positions.len(), input.lights.len()),
    ] {
        if length != 0 && length != expected {
            return fail(format!("{length} {what} for {expected} elements: give none or one each"));
        }
    }
    check_runs(input)?;
    check_textures(input)?;
    let textures = input.textures.len();
    first_fault("material", input.materials.iter().map(|m| material_fault(m, textures)))?;
    first_fault("light", input.lights.iter().map(light_fault))?;
    first_fault("camera", input.cameras.iter().map(camera_fault))?;
    if let Some(i) = input.light_positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
        return fail(format!("light {i}: position is not finite"));
    }
    if let Some(what) = environment_fault(&input.environment, textures) {
        return fail(format!("environment: {what}"));
    }
    ambient_fault(&input.ambient.radiance).map_or(Ok(()), fail)
}

fn fail<T>(message: impl Into<String>) -> Result<T, BuildError> {
    Err(BuildError::Input(message.into()))
}

fn first_fault(what: &str, faults: impl Iterator<Item = Option<&'static str>>) -> Result<(), BuildError> {
    for (i, fault) in faults.enumerate() {
        if let Some(fault) = fault {
            return fail(format!("{what} {i}: {fault}"));
        }
    }
    Ok(())
}

fn check_runs(input: &PackInput) -> Result<(), BuildError> {
    let runs = &input.material_runs;
    if !input.triangles.is_empty() && runs.first().is_none_or(|r| r.0 != 0) {
        return fail("material runs do not begin at triangle 0");
    }
    if let Some(i) = runs.windows(2).position(|w| w[0].0 >= w[1].0) {
        return fail(format!("material run {} does not begin behind the one before", i + 1));
    }
    match runs.iter().position(|r| r.1 as usize >= input.materials.len()) {
        Some(i) => fail(format!("material run {i}: material {} does not exist", runs[i].1)),
        None => Ok(()),
    }
}

/// Texels of all images, those of images that share them counted once.
pub(crate) fn distinct_texels(textures: &[ImageInput]) -> u64 {
    let mut seen = HashSet::new();
    textures.iter().filter(|t| seen.insert(t.identity())).map(|t| t.rgba.len() as u64 / 4).sum()
}

fn check_textures(input: &PackInput) -> Result<(), BuildError> {
    for (i, t) in input.textures.iter().enumerate() {
        let name = &t.name;
        let size = u64::from(t.width) * u64::from(t.height);
        let record = Texture { first_texel: 0, width: t.width, height: t.height, sampling: 0 };
        if texture_fault(&record, size).is_some() {
            return fail(format!(
                "texture {i} ({name}): {}x{} texels; sides of 1 to {MAX_TEXTURE_SIDE} fit",
                t.width, t.height
            ));
        }
        if t.rgba.len() as u64 != size * 4 {
            return fail(format!(
                "texture {i} ({name}): {} bytes for {}x{} RGBA texels",
                t.rgba.len(),
                t.width,
                t.height
            ));
        }
    }
    let texels = distinct_texels(&input.textures);
    if texels >= u64::from(NO_TEXTURE) {
        return fail(format!(
            "the textures have {texels} texels; at most 4,294,967,294 fit a pack: make them smaller"
        ));
    }
    Ok(())
}
