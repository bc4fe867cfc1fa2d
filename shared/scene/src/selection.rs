//! What of a scene is kept, and why the rest is not.

/// Features that the user asked to leave out (`--without`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Without {
    /// All images (and so texture coordinates).
    pub textures: bool,
    /// Shadow rays.
    pub shadows: bool,
    /// Mirror reflection.
    pub reflection: bool,
    /// Refraction: transmissive surfaces become opaque.
    pub refraction: bool,
}

/// One thing that was left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
    /// Bytes of the source's form that it would have taken.
    pub bytes: u64,
}

/// The part of a scene that is packed: indices into the scene, and what was left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Materials in use, ascending.
    pub materials: Vec<usize>,
    /// Images in use, ascending.
    pub images: Vec<usize>,
    /// Whether any kept material reads texture coordinates.
    pub uvs: bool,
    /// Whether shading normals are kept.
    pub normals: bool,
    /// Whether vertex colours are kept (some are not white).
    pub colors: bool,
    /// The rest.
    pub left_out: Vec<LeftOut>,
}
