//! Vertex normals for scans that have none.

use crate::{Primitive, Scene};
use glam::DVec3;

/// Gives every part without normals those of its vertices: the sum of the cross products of the triangles around, which
/// weighs each by its area. A vertex that no triangle with an area uses keeps zero.
pub(super) fn smooth(scene: &mut Scene) {
    for part in scene.meshes.iter_mut().flat_map(|m| &mut m.primitives) {
        if part.normals.is_empty() {
            part.normals = normals(part);
        }
    }
}

fn normals(part: &Primitive) -> Vec<[f32; 3]> {
    let mut sums = vec![DVec3::ZERO; part.positions.len()];
    for t in &part.triangles {
        let [a, b, c] = t.map(|k| part.positions[k as usize]);
        let cross = (b - a).cross(c - a);
        if cross.is_finite() {
            for &k in t {
                sums[k as usize] += cross;
            }
        }
    }
    sums.into_iter().map(|n| n.normalize_or_zero().as_vec3().to_array()).collect()
}
