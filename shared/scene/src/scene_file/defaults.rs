//! What a scene gets when its file does not state it.

use crate::{Camera, Environment, Light, LightKind, Material, Scene};
use glam::DVec3;
use std::f32::consts::PI;
use tessera_geometry::CameraPose;

/// From the middle of the box towards the eye: front (+z), a little to the right, above.
const TOWARDS_EYE: DVec3 = DVec3::new(0.55, 0.45, 1.0);
/// Of the default camera, in degrees.
const FOV: f64 = 45.0;
/// sin(FOV / 2) = sqrt((1 - cos 45 degrees) / 2).
const SIN_HALF_FOV: f64 = 0.382_683_432_365_089_8;
/// Where the default light comes from: over the left shoulder of the default camera.
const TOWARDS_LIGHT: DVec3 = DVec3::new(-0.35, 1.0, 0.9);
/// Share of white that the ambient light makes up; the key light has the rest, so that a white surface that faces it is
/// just white: `ambient + lux / pi = 1`.
const AMBIENT: f32 = 0.22;
/// What mirrors and glass show when nothing is stated: a pale sky above brownish ground, no part of it brighter than a
/// white surface in the default light.
const SKY: Environment = Environment::Gradient {
    zenith: [0.35, 0.5, 0.75],
    horizon: [0.85, 0.88, 0.9],
    nadir: [0.26, 0.24, 0.22],
};

/// Gives a scene without cameras one named `default`, and a scene without any light a key light and an ambient one. Mirrors
/// and glass are dark where there is nothing to see, so such a scene gets a sky too when it has any of them and states no
/// environment. Each is recorded in [`Scene::notes`]. `bounds` is the scene's box, low and high corner.
pub fn add_defaults(scene: &mut Scene, bounds: (DVec3, DVec3)) {
    if scene.cameras.is_empty() {
        scene.cameras.push(Camera { name: "default".to_owned(), pose: framing(bounds) });
        scene.notes.push(
            "default camera: the source states none; one named `default` looks at the box from the front, right and above, \
             45 degrees"
                .to_owned(),
        );
    }
    let unlit = !scene.materials.is_empty() && scene.materials.iter().all(|m| m.unlit);
    if scene.lights.is_empty() && scene.ambient == [0.0; 3] && !unlit {
        let lux = (1.0 - AMBIENT) * PI;
        scene.lights.push(Light {
            name: "default".to_owned(),
            kind: LightKind::Directional,
            position: DVec3::ZERO,
            direction: -TOWARDS_LIGHT.normalize(),
            intensity: [lux; 3],
            range: f32::INFINITY,
        });
        scene.ambient = [AMBIENT; 3];
        scene.notes.push(format!(
            "default lights: the source states none; a directional light of {lux:.2} lux from the upper left and {AMBIENT} ambient"
        ));
        if scene.environment == Environment::None && scene.materials.iter().any(shows_surroundings) {
            scene.environment = SKY;
            scene.notes.push(
                "default environment: the source states neither lights nor an environment and has mirrors or glass; they show \
                 a pale sky above brownish ground"
                    .to_owned(),
            );
        }
    }
}

/// Whether the looks of a material are chiefly what lies around or behind it: smooth metal, smooth surfaces with
/// a specular reflectance above any plain dielectric's (how MTL states mirrors), and what transmits light. Images, which may make parts of it so, are not asked.
fn shows_surroundings(material: &Material) -> bool {
    // 0.2 is the reflectance of a refractive index of 2.6; diamond's is 0.17.
    let reflects = material.metallic > 0.5 || material.specular.iter().any(|&channel| channel > 0.2);
    !material.unlit && (material.transmission > 0.0 || (reflects && material.roughness < 0.25))
}

/// A camera that has the whole box in view, whatever the shape of the image down to a square.
fn framing((low, high): (DVec3, DVec3)) -> CameraPose {
    // Far beyond what can be packed, and squares of what is larger would overflow.
    let limit = DVec3::splat(1e150);
    let (low, high) = (low.clamp(-limit, limit), high.clamp(-limit, limit));
    let target = low + (high - low) * 0.5;
    let radius = ((high - low) * 0.5).length();
    // A single point still needs an eye that is not on it, at any magnitude of its coordinates.
    let radius = radius.max(target.abs().max_element() * 1e-6).max(f64::MIN_POSITIVE * 1e30);
    let eye = target + TOWARDS_EYE.normalize() * (radius / SIN_HALF_FOV);
    CameraPose { eye, target, up: DVec3::Y, fov_degrees: FOV }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_in_view() {
        for scale in [1e-6, 1.0, 1e7] {
            let (low, high) = (DVec3::new(-1.0, 2.0, 3.0) * scale, DVec3::new(4.0, 2.5, 9.0) * scale);
            let pose = framing((low, high));
            let axis = (pose.target - pose.eye).normalize();
            for k in 0..8 {
                let pick = |bit: u32, l: f64, h: f64| if k & bit == 0 { l } else { h };
                let corner =
                    DVec3::new(pick(1, low.x, high.x), pick(2, low.y, high.y), pick(4, low.z, high.z));
                // Within the cone of half the field of view: cos(22.5 degrees) = 0.92388.
                assert!((corner - pose.eye).normalize().dot(axis) > 0.923_87);
            }
        }
        let point = framing((DVec3::splat(1e7), DVec3::splat(1e7)));
        assert!(point.eye != point.target);
        for (low, high) in [(-f64::MAX, f64::MAX), (1e308, 1.1e308), (-1e308, 1.0)] {
            let pose = framing((DVec3::splat(low), DVec3::splat(high)));
            assert!(pose.eye.is_finite() && pose.target.is_finite() && pose.eye != pose.target);
        }
    }

    #[test]
    fn only_what_is_missing_is_added() {
        let bounds = (DVec3::ZERO, DVec3::ONE);
        let mut scene = Scene { materials: vec![Material::default()], ..Scene::default() };
        add_defaults(&mut scene, bounds);
        assert_eq!((scene.cameras.len(), scene.lights.len(), scene.notes.len()), (1, 1, 2));
        let white = scene.ambient[0] + scene.lights[0].intensity[0] / PI;
        assert!((white - 1.0).abs() < 1e-6, "a white surface shows {white}");

        add_defaults(&mut scene, bounds);
        assert_eq!((scene.cameras.len(), scene.lights.len(), scene.notes.len()), (1, 1, 2));

        let mut lit = Scene { ambient: [0.1; 3], ..Scene::default() };
        add_defaults(&mut lit, bounds);
        assert!(lit.lights.is_empty(), "an ambient light is light enough");
    }

    #[test]
    fn mirrors_and_glass_without_lights_get_a_sky() {
        let mirror = || Material { metallic: 1.0, roughness: 0.2, ..Material::default() };
        let glass = || Material { transmission: 0.1, ..Material::default() };
        let with = |scene: Scene| {
            let mut scene = scene;
            add_defaults(&mut scene, (DVec3::ZERO, DVec3::ONE));
            let noted = scene.notes.iter().any(|note| note.starts_with("default environment: "));
            assert_eq!(noted, scene.environment == SKY);
            scene.environment
        };
        let of = |material| Scene { materials: vec![Material::default(), material], ..Scene::default() };
        let painted = || Material { roughness: 0.0, specular: [0.9; 3], ..Material::default() };
        assert_eq!([with(of(mirror())), with(of(glass())), with(of(painted()))], [SKY; 3]);

        // Nothing that shows it, or something stated.
        let dull = [
            Material { roughness: 0.25, ..mirror() },
            Material { metallic: 0.5, ..mirror() },
            Material { unlit: true, ..glass() },
            Material { roughness: 0.25, ..painted() },
            Material { specular: [0.2; 3], ..painted() },
        ];
        for material in dull {
            assert_eq!(with(of(material)), Environment::None);
        }
        assert_eq!(with(Scene { ambient: [0.1; 3], ..of(mirror()) }), Environment::None);
        let mut lit = of(glass());
        add_defaults(&mut lit, (DVec3::ZERO, DVec3::ONE));
        assert_eq!(
            with(Scene { environment: Environment::None, notes: Vec::new(), ..lit }),
            Environment::None
        );
        let stated = Environment::Gradient { zenith: [1.0; 3], horizon: [0.0; 3], nadir: [0.0; 3] };
        assert_eq!(with(Scene { environment: stated.clone(), ..of(mirror()) }), stated);
    }
}
