//! Walking the node tree.

use crate::import::limits::NODE_DEPTH_MAX;
use crate::{Mesh, Scene};
use glam::{DMat4, DVec3};

/// [`Scene::walk`] for what cannot fail. Where the tree is unsound the walk ends, with no word of it: importers have walked
/// their trees once and refused such ones, generators make none, and [`Scene::flatten`] says what is wrong.
pub(crate) fn for_each_instance(scene: &Scene, mut f: impl FnMut(&Mesh, &DMat4)) {
    let _ = scene.walk(|mesh, to_world| {
        f(&scene.meshes[mesh], to_world);
        Ok(())
    });
}

impl Scene {
    /// Calls `visit` with every use of a mesh and its transform to world space, nodes depth first in file order, until it
    /// fails.
    ///
    /// # Errors
    /// What `visit` fails with, a node below [`NODE_DEPTH_MAX`] levels (every cycle leads there), and an index out of range.
    pub(crate) fn walk(
        &self,
        mut visit: impl FnMut(usize, &DMat4) -> Result<(), String>,
    ) -> Result<(), String> {
        let mut stack: Vec<(usize, DMat4, usize)> =
            self.roots.iter().rev().map(|&root| (root, DMat4::IDENTITY, 1)).collect();
        while let Some((index, to_parent, depth)) = stack.pop() {
            if depth > NODE_DEPTH_MAX {
                return Err(format!("node {index} lies deeper than {NODE_DEPTH_MAX} levels, or on a cycle"));
            }
            let node = self.nodes.get(index).ok_or_else(|| format!("node {index} does not exist"))?;
            let to_world = to_parent * node.transform;
            if let Some(mesh) = node.mesh {
                if mesh >= self.meshes.len() {
                    return Err(format!("node {index} names mesh {mesh}, which does not exist"));
                }
                visit(mesh, &to_world)?;
            }
            stack.extend(node.children.iter().rev().map(|&child| (child, to_world, depth + 1)));
        }
        Ok(())
    }

    /// The smallest world-space box `(low, high)` around every finite vertex that a triangle uses; `None` when there is none.
    /// What an unsound tree ([`Scene::flatten`] refuses it) holds behind its first fault is left out.
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

        // A fault ends the walk: a missing node, a cycle (of which every round enlarges the box).
        let sound = scene.bounds();
        scene.roots = vec![0, 2];
        assert_eq!(scene.bounds(), sound);
        scene.nodes[1].children = vec![0];
        scene.roots = vec![0];
        assert!(scene.bounds().is_some_and(|(_, high)| high.x > 4.0));
        scene.roots.clear();
        assert_eq!(scene.bounds(), None);
    }
}
