//! `[ground]`: a level square under a scan.

use super::schema::Ground;
use crate::{Image, Material, Mesh, Node, Primitive, Scene, TextureRef, Wrap};
use glam::{DMat4, DVec3};

/// Side of the square as a multiple of the scene's largest horizontal extent, when not stated.
const SIZE_FACTOR: f64 = 6.0;
/// sRGB codes of the two squares of the checker.
const CHECKER: [[u8; 4]; 2] = [[214, 209, 200, 255], [122, 118, 112, 255]];

/// Adds the square, with a material named `ground`, to a scene of this box. Fails with what is wrong.
pub(super) fn add(scene: &mut Scene, ground: &Ground, (low, high): (DVec3, DVec3)) -> Result<(), String> {
    let middle = low + (high - low) * 0.5;
    let height = ground.height.unwrap_or(low.y);
    let size = ground.size.unwrap_or(SIZE_FACTOR * (high.x - low.x).max(high.z - low.z));
    if !height.is_finite() {
        return Err("height must be a finite number".to_owned());
    }
    if !(size.is_finite() && size > 0.0) {
        return Err("size must be above 0".to_owned());
    }
    if ground.checker.is_some_and(|side| !(side >= size / 4096.0 && side <= size)) {
        return Err("checker must be at most `size` and at least 1/4096 of it".to_owned());
    }
    let half = size * 0.5;
    let corner = |x: f64, z: f64| DVec3::new(middle.x + x * half, height, middle.z + z * half);
    let texture = ground.checker.map(|_| {
        scene.images.push(checker());
        TextureRef {
            image: scene.images.len() - 1,
            wrap_s: Wrap::Repeat,
            wrap_t: Wrap::Repeat,
            nearest: true,
        }
    });
    // The image holds two squares a side.
    let repeats = ground.checker.map_or(0.0, |side| size / (2.0 * side)) as f32;
    let uvs = [[0.0, repeats], [repeats, repeats], [repeats, 0.0], [0.0, 0.0]];
    scene.materials.push(Material {
        name: "ground".to_owned(),
        base_color: [0.8, 0.8, 0.8, 1.0],
        base_texture: texture,
        specular: [0.0; 3],
        ..Material::default()
    });
    scene.meshes.push(Mesh {
        name: "ground".to_owned(),
        primitives: vec![Primitive {
            positions: vec![corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)],
            uvs: if texture.is_some() { uvs.to_vec() } else { Vec::new() },
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: scene.materials.len() - 1,
            ..Primitive::default()
        }],
    });
    scene.roots.push(scene.nodes.len());
    scene.nodes.push(Node {
        name: "ground".to_owned(),
        transform: DMat4::IDENTITY,
        mesh: Some(scene.meshes.len() - 1),
        children: Vec::new(),
    });
    Ok(())
}

/// Two by two texels.
fn checker() -> Image {
    let [light, dark] = CHECKER;
    let rgba = [light, dark, dark, light].concat().into();
    Image { name: "checker".to_owned(), width: 2, height: 2, rgba }
}
