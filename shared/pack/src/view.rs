//! A pack's bytes, checked once, then read in place.

use crate::records::{Ambient, Environment, Light, Material, Texture};
use tessera_geometry::{LocalFrame, Vec2, Vec3};
use tessera_kdtree::TreeView;

/// BLAKE3 hash of a pack's content.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub struct PackId(pub [u8; 32]);

/// Why bytes are not a pack.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PackError {
    /// The bytes are malformed, with the place.
    #[error("not a valid pack: {0}")]
    Malformed(String),
}

/// A validated pack. Cheap to clone; views borrow from its bytes.
#[derive(Clone)]
pub struct Pack {
    // owned, 64-byte aligned bytes and the section table
}

impl Pack {
    /// Checks `bytes` (header, hash, every index, the tree) and takes them.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PackError> {
        let _ = bytes;
        Err(PackError::Malformed("not built yet".into()))
    }
    /// The whole file.
    pub fn bytes(&self) -> &[u8] {
        unimplemented!("contract")
    }
    /// Content hash.
    pub fn id(&self) -> PackId {
        unimplemented!("contract")
    }
    /// World to local.
    pub fn frame(&self) -> LocalFrame {
        unimplemented!("contract")
    }
    /// Triangles.
    pub fn triangle_count(&self) -> u32 {
        unimplemented!("contract")
    }
    /// The kd-tree.
    pub fn tree(&self) -> TreeView<'_> {
        unimplemented!("contract")
    }
    /// Vertices and triangles.
    pub fn mesh(&self) -> MeshView<'_> {
        unimplemented!("contract")
    }
    /// Materials.
    pub fn materials(&self) -> &[Material] {
        unimplemented!("contract")
    }
    /// Material of packed triangle `id` (binary search in the runs).
    pub fn material_of(&self, id: u32) -> u32 {
        let _ = id;
        unimplemented!("contract")
    }
    /// Original (flattened-scene) id of packed triangle `id`.
    pub fn original_id(&self, id: u32) -> u32 {
        let _ = id;
        unimplemented!("contract")
    }
    /// Texture records.
    pub fn textures(&self) -> &[Texture] {
        unimplemented!("contract")
    }
    /// Texels, RGBA8 each, little endian in a word: red in bits 0..7.
    pub fn texels(&self) -> &[u32] {
        unimplemented!("contract")
    }
    /// Lights in local space.
    pub fn lights(&self) -> &[Light] {
        unimplemented!("contract")
    }
    /// Ambient light.
    pub fn ambient(&self) -> Ambient {
        unimplemented!("contract")
    }
    /// What a miss sees.
    pub fn environment(&self) -> Environment {
        unimplemented!("contract")
    }
}

/// Vertices and triangles of a pack, decoded on access. `Copy`: slices and decode constants only.
#[derive(Clone, Copy)]
pub struct MeshView<'a> {
    _bytes: &'a [u8],
}

impl MeshView<'_> {
    /// Vertex indices of triangle `id`.
    pub fn indices(&self, id: u32) -> [u32; 3] {
        let _ = id;
        unimplemented!("contract")
    }
    /// Decoded local position.
    pub fn position(&self, vertex: u32) -> Vec3 {
        let _ = vertex;
        unimplemented!("contract")
    }
    /// Decoded unit normal, `None` when the vertex (or the scene) has none.
    pub fn normal(&self, vertex: u32) -> Option<Vec3> {
        let _ = vertex;
        unimplemented!("contract")
    }
    /// Decoded texture coordinates, (0,0) when the scene has none.
    pub fn uv(&self, vertex: u32) -> Vec2 {
        let _ = vertex;
        unimplemented!("contract")
    }
    /// Linear vertex colour, white when the scene has none.
    pub fn color(&self, vertex: u32) -> [f32; 4] {
        let _ = vertex;
        unimplemented!("contract")
    }
    /// Whether any vertex may have a normal / uv / colour.
    pub fn has_normals(&self) -> bool {
        unimplemented!("contract")
    }
    /// See `has_normals`.
    pub fn has_uvs(&self) -> bool {
        unimplemented!("contract")
    }
    /// See `has_normals`.
    pub fn has_colors(&self) -> bool {
        unimplemented!("contract")
    }
}

impl tessera_kdtree::Triangles for MeshView<'_> {
    fn vertices(&self, id: u32) -> [Vec3; 3] {
        self.indices(id).map(|v| self.position(v))
    }
}
