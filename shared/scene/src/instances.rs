//! Walking the node tree.

use crate::{Mesh, Scene};
use glam::{DMat4, DVec3};

/// Calls `f` with every instance of a mesh and its transform to the world, depth first in file order. The tree must have no cycle:
/// importers refuse one, generators make none.
pub(crate) fn for_each_instance(scene: &Scene, mut f: impl FnMut(&Mesh, &DMat4)) {
    let mut open: Vec<(usize, DMat4)> = scene.roots.iter().rev().map(|&r| (r, DMat4::IDENTITY)).collect();
    while let Some((index, parent)) = open.pop() {
        let node = &scene.nodes[index];
        let transform = parent * node.transform;
        if let Some(mesh) = node.mesh {
            f(&scene.meshes[mesh], &transform);
        }
        open.extend(node.children.iter().rev().map(|&c| (c, transform)));
    }
}

impl Scene {
    /// The smallest world-space box `(low, high)` around every finite vertex that a triangle uses; `None` when there is none.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for_each_instance(self, |mesh, transform| {
            for part in &mesh.primitives {
                for &k in part.triangles.iter().flatten() {
                    let p = transform.transform_point3(part.positions[k as usize]);
                    if p.is_finite() {
                        low = low.min(p);
                        high = high.max(p);
                    }
                }
            }
        });
        (low.x <= high.x).then_some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Node, Primitive};

    #[test]
    fn bounds_follow_the_nodes_and_pass_over_unused_and_infinite_vertices() {
        let positions =
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [9.0; 3], [f64::NAN; 3]].map(DVec3::from_array);
        let triangles = vec![[0, 1, 2], [0, 1, 4]];
        let part = Primitive { positions: positions.to_vec(), triangles, ..Primitive::default() };
        let node = |transform, mesh, children| Node { name: String::new(), transform, mesh, children };
        let mut scene = Scene {
            meshes: vec![Mesh { name: String::new(), primitives: vec![part] }],
            nodes: vec![
                node(DMat4::from_scale(DVec3::splat(2.0)), None, vec![1]),
                node(DMat4::from_translation(DVec3::X), Some(0), vec![]),
            ],
            roots: vec![0],
            ..Scene::default()
        };
        assert_eq!(scene.bounds(), Some((DVec3::new(2.0, 0.0, 0.0), DVec3::new(4.0, 4.0, 0.0))));
        scene.roots.clear();
        assert_eq!(scene.bounds(), None);
    }
}
