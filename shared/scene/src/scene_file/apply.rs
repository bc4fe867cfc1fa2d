//! What a scene file changes in the scene that its source gave.

use super::Faults;
use super::schema::{
    AlphaName, CameraEntry, Document, EnvironmentEntry, LightEntry, LightName, Lights, MaterialEntry,
    Normals, Up,
};
use super::{ground, smooth};
use crate::import;
use crate::import::limits::COORDINATE_MAX;
use crate::import::listed;
use crate::{AlphaMode, Camera, Environment, Light, LightKind, Material, Scene, SceneError};
use glam::{DMat4, DVec3};
use std::collections::HashSet;
use std::f32::consts::PI;
use tessera_geometry::CameraPose;
use toml::Spanned;

/// Applies everything but the source: first what moves geometry, then what is stated in the scene's own space. Returns the
/// box of the source.
pub(super) fn apply(
    scene: &mut Scene,
    document: Document,
    faults: &Faults,
) -> Result<(DVec3, DVec3), SceneError> {
    if document.up == Up::Z {
        stand_up(scene);
    }
    if document.normals == Normals::Smooth {
        smooth::smooth(scene);
    }
    let bounds = super::bounds_of(faults.path, scene)?;
    if let Some(ground) = &document.ground {
        ground::add(scene, ground.get_ref(), bounds)
            .map_err(|e| faults.at(Some(ground.span()), &format!("[ground]: {e}")))?;
    }
    // What holds for all materials first, whatever the others are called.
    let (all, named): (Vec<_>, Vec<_>) =
        document.material.iter().partition(|(name, _)| name.get_ref() == "*");
    for (name, entry) in all.into_iter().chain(named) {
        let named =
            |e: String| faults.at(Some(name.span()), &format!("[material.\"{}\"]: {e}", name.get_ref()));
        override_materials(scene, name.get_ref(), entry).map_err(named)?;
    }
    if !document.light.is_empty() && document.lights == Lights::Replace {
        scene.lights.clear();
    }
    for entry in &document.light {
        let light = light(entry.get_ref());
        scene.lights.push(light.map_err(|e| faults.at(Some(entry.span()), &format!("[[light]]: {e}")))?);
    }
    if let Some(ambient) = document.ambient {
        let colour = colour("ambient", *ambient.get_ref(), f32::MAX);
        scene.ambient = colour.map_err(|e| faults.at(Some(ambient.span()), &e))?;
    }
    if let Some(entry) = &document.environment {
        scene.environment = environment(scene, entry, faults)?;
    }
    let mut stated: Vec<Camera> = Vec::new();
    let mut taken = HashSet::new();
    for entry in document.camera {
        let named =
            |e: &str| faults.at(Some(entry.span()), &format!("[[camera]] \"{}\": {e}", entry.get_ref().name));
        if !taken.insert(entry.get_ref().name.clone()) {
            return Err(named("the name is taken; give every camera its own"));
        }
        stated.push(camera(entry.get_ref()).map_err(named)?);
    }
    order_cameras(scene, stated, document.default_camera, faults)?;
    Ok(bounds)
}

/// Turns a scene whose +z is up: (x, y, z) goes to (x, z, -y).
fn stand_up(scene: &mut Scene) {
    let turn = DMat4::from_cols_array(&[
        1.0, 0.0, 0.0, 0.0, // x stays
        0.0, 0.0, -1.0, 0.0, // y goes to -z
        0.0, 1.0, 0.0, 0.0, // z goes to y
        0.0, 0.0, 0.0, 1.0,
    ]);
    for root in &mut scene.roots {
        let node = &mut scene.nodes[*root];
        node.transform = turn * node.transform;
    }
    for light in &mut scene.lights {
        light.position = turn.transform_point3(light.position);
        light.direction = turn.transform_vector3(light.direction);
    }
    for track in &mut scene.camera_tracks {
        track.to_world = turn * track.to_world;
    }
    for Camera { pose, .. } in &mut scene.cameras {
        pose.eye = turn.transform_point3(pose.eye);
        pose.target = turn.transform_point3(pose.target);
        pose.up = turn.transform_vector3(pose.up);
    }
}

/// Puts the stated cameras first, replacing the source's of the same name, and the default one before all.
fn order_cameras(
    scene: &mut Scene,
    mut stated: Vec<Camera>,
    default: Option<Spanned<String>>,
    faults: &Faults,
) -> Result<(), SceneError> {
    let names: HashSet<&str> = stated.iter().map(|c| c.name.as_str()).collect();
    scene.cameras.retain(|c| !names.contains(c.name.as_str()));
    scene.camera_tracks.retain(|track| !names.contains(track.camera.as_str()));
    stated.append(&mut scene.cameras);
    if let Some(default) = default {
        let Some(place) = stated.iter().position(|c| c.name == *default.get_ref()) else {
            let what = format!(
                "default_camera = \"{}\": no such camera; there is {}",
                default.get_ref(),
                listed(stated.iter().map(|c| c.name.as_str()))
            );
            return Err(faults.at(Some(default.span()), &what));
        };
        stated[..=place].rotate_right(1);
    }
    scene.cameras = stated;
    Ok(())
}

fn camera(entry: &CameraEntry) -> Result<Camera, &'static str> {
    if entry.name.contains(char::is_control) {
        return Err("the name has control characters");
    }
    let [eye, target, up] = [entry.eye, entry.target, entry.up].map(DVec3::from_array);
    if !(eye.is_finite() && target.is_finite() && up.is_finite()) {
        return Err("eye, target and up must be finite numbers");
    }
    if !(entry.fov > 0.0 && entry.fov < 180.0) {
        return Err("fov must lie between 0 and 180 degrees");
    }
    if eye == target {
        return Err("eye and target are the same point");
    }
    if up.normalize_or_zero().cross((target - eye).normalize_or_zero()).length() < 1e-9 {
        // 1e-9: the sine below which the horizon would be made of rounding errors (2^-53 a coordinate).
        return Err("up is zero or points along the view");
    }
    Ok(Camera { name: entry.name.clone(), pose: CameraPose { eye, target, up, fov_degrees: entry.fov } })
}

fn light(entry: &LightEntry) -> Result<Light, String> {
    let color = colour("color", entry.color, f32::MAX)?;
    if !(entry.intensity.is_finite() && entry.intensity >= 0.0) {
        return Err("intensity must be 0 or more".to_owned());
    }
    let range = entry.range.unwrap_or(f32::INFINITY);
    if range.is_nan() || range <= 0.0 {
        return Err("range must be above 0".to_owned());
    }
    let position = || match entry.position.map(DVec3::from_array) {
        // NaN compares false.
        Some(p) if p.abs().cmple(DVec3::splat(COORDINATE_MAX)).all() => Ok(p),
        Some(_) => Err(format!("position must be numbers up to {COORDINATE_MAX:e}")),
        None => Err("position is missing".to_owned()),
    };
    let direction = || match entry.direction.map(|d| DVec3::from_array(d).try_normalize()) {
        Some(Some(d)) => Ok(d),
        Some(None) => Err("direction must be finite and not zero".to_owned()),
        None => Err("direction is missing".to_owned()),
    };
    let unused = |key: &str, stated: bool| match stated {
        true => Err(format!("{key} means nothing for this kind of light; leave it out")),
        false => Ok(()),
    };
    let (kind, position, direction) = match entry.kind {
        LightName::Point => {
            unused("direction", entry.direction.is_some())?;
            unused("angles", entry.angles.is_some())?;
            (LightKind::Point, position()?, DVec3::NEG_Y)
        }
        LightName::Directional => {
            unused("position", entry.position.is_some())?;
            unused("angles", entry.angles.is_some())?;
            unused("range", entry.range.is_some())?;
            (LightKind::Directional, DVec3::ZERO, direction()?)
        }
        LightName::Spot => {
            let [inner, outer] = entry.angles.ok_or("angles = [inner, outer] is missing")?;
            if !(inner >= 0.0 && inner < outer && outer <= 90.0) {
                return Err("angles = [inner, outer] must be 0 <= inner < outer <= 90 degrees".to_owned());
            }
            let radians = |degrees: f32| degrees * (PI / 180.0);
            (LightKind::Spot { inner: radians(inner), outer: radians(outer) }, position()?, direction()?)
        }
    };
    let intensity = color.map(|c| c * entry.intensity);
    if !intensity.iter().all(|c| c.is_finite()) {
        return Err("color times intensity is too large".to_owned());
    }
    Ok(Light { name: String::new(), kind, position, direction, intensity, range })
}

fn environment(
    scene: &mut Scene,
    entry: &Spanned<EnvironmentEntry>,
    faults: &Faults,
) -> Result<Environment, SceneError> {
    let wrong = |what: &str| faults.at(Some(entry.span()), &format!("[environment]: {what}"));
    let entry = entry.get_ref();
    match (&entry.image, [entry.zenith, entry.horizon, entry.nadir]) {
        (Some(image), [None, None, None]) => {
            let scale = entry.scale.unwrap_or(1.0);
            if !(scale.is_finite() && scale >= 0.0) {
                return Err(wrong("scale must be 0 or more"));
            }
            scene.images.push(import::read_image(faults.path, image)?);
            Ok(Environment::Map { image: scene.images.len() - 1, scale })
        }
        (Some(_), _) => Err(wrong("either image or zenith, horizon and nadir")),
        (None, [Some(zenith), Some(horizon), Some(nadir)]) => {
            if entry.scale.is_some() {
                return Err(wrong("scale belongs to an image"));
            }
            let part = |key: &str, value| colour(key, value, f32::MAX).map_err(|e| wrong(&e));
            Ok(Environment::Gradient {
                zenith: part("zenith", zenith)?,
                horizon: part("horizon", horizon)?,
                nadir: part("nadir", nadir)?,
            })
        }
        (None, _) => Err(wrong("needs zenith, horizon and nadir, or an image")),
    }
}

/// Changes the material of this name, or every material for `*`.
fn override_materials(scene: &mut Scene, name: &str, entry: &MaterialEntry) -> Result<(), String> {
    let mut found = false;
    for material in scene.materials.iter_mut().filter(|m| name == "*" || m.name == name) {
        override_material(material, entry)?;
        found = true;
    }
    if !found {
        let names = listed(scene.materials.iter().map(|m| m.name.as_str()));
        return Err(format!("the source has no such material; it has {names}"));
    }
    Ok(())
}

fn override_material(m: &mut Material, entry: &MaterialEntry) -> Result<(), String> {
    if let Some([r, g, b]) = entry.base_color {
        let [r, g, b] = colour("base_color", [r, g, b], 1.0)?;
        m.base_color = [r, g, b, m.base_color[3]];
    }
    let share = |key: &str, value: Option<f32>, old: f32| match value {
        None => Ok(old),
        Some(x) if (0.0..=1.0).contains(&x) => Ok(x),
        Some(_) => Err(format!("{key} must lie between 0 and 1")),
    };
    m.base_color[3] = share("opacity", entry.opacity, m.base_color[3])?;
    m.metallic = share("metallic", entry.metallic, m.metallic)?;
    m.roughness = share("roughness", entry.roughness, m.roughness)?;
    m.transmission = share("transmission", entry.transmission, m.transmission)?;
    if let Some(specular) = entry.specular {
        m.specular = colour("specular", specular, 1.0)?;
    }
    if let Some(emissive) = entry.emissive {
        m.emissive = colour("emissive", emissive, f32::MAX)?;
    }
    if let Some(ior) = entry.ior {
        if !(ior.is_finite() && ior > 0.0) {
            return Err("ior must be above 0".to_owned());
        }
        m.ior = ior;
    }
    let cutoff = share("alpha_cutoff", entry.alpha_cutoff, 0.5)?;
    match entry.alpha {
        Some(AlphaName::Opaque) => m.alpha = AlphaMode::Opaque,
        Some(AlphaName::Mask) => m.alpha = AlphaMode::Mask(cutoff),
        Some(AlphaName::Blend) => m.alpha = AlphaMode::Blend,
        None => {}
    }
    if entry.alpha_cutoff.is_some() && entry.alpha != Some(AlphaName::Mask) {
        return Err("alpha_cutoff needs alpha = \"mask\"".to_owned());
    }
    m.thin_walled = entry.thin_walled.unwrap_or(m.thin_walled);
    m.double_sided = entry.double_sided.unwrap_or(m.double_sided);
    m.unlit = entry.unlit.unwrap_or(m.unlit);
    if !entry.textures {
        m.base_texture = None;
        m.metallic_roughness_texture = None;
        m.emissive_texture = None;
        m.transmission_texture = None;
    }
    Ok(())
}

/// A colour whose parts are finite, not negative and at most `max`.
fn colour(key: &str, value: [f32; 3], max: f32) -> Result<[f32; 3], String> {
    if value.iter().all(|&c| c >= 0.0 && c <= max) {
        Ok(value)
    } else if max == f32::MAX {
        Err(format!("{key} must be finite numbers of 0 or more"))
    } else {
        Err(format!("{key} must be numbers between 0 and {max}"))
    }
}
