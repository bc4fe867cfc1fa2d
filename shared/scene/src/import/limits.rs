//! Every limit on untrusted input, in one place, each with its reason. They bound memory before it is reserved; none is
//! reached by the scenes that this project is measured on (at most 69 MB of source, 9.4 million triangles).

/// Bytes of a source file (`.glb`, `.gltf`, `.obj`, `.ply`, `.mtl`) or of one buffer: a `.glb` cannot be longer, its length
/// field has 32 bits.
pub const SOURCE_BYTES_MAX: u64 = u32::MAX as u64;

/// Bytes that one import may read from all files that its source refers to together: half of the 16 GiB that a master is expected to have.
pub const TOTAL_BYTES_MAX: u64 = 8 << 30;

/// Bytes of glTF's JSON: thirty times San Miguel's.
pub const JSON_BYTES_MAX: usize = 256 << 20;

/// Objects in glTF's JSON, counted as opening braces. `{}` in an array of nodes costs 3 bytes in the file and a few hundred in
/// memory, so a limit on bytes alone would let 256 MiB become tens of GiB. San Miguel has about 60,000.
pub const JSON_OBJECTS_MAX: usize = 4 << 20;

/// Values in glTF's JSON, counted as commas and opening brackets: an empty string or list costs 3 bytes in the file and 24 or more
/// in memory. San Miguel has about a million.
pub const JSON_VALUES_MAX: usize = 16 << 20;

/// Bytes of one image file.
pub const IMAGE_BYTES_MAX: u64 = 256 << 20;

/// Texels along a side: what GPUs of today take at most.
pub const IMAGE_SIDE_MAX: u32 = 16_384;

/// Texels of one image: 8192 x 8192, which is 256 MiB as RGBA.
pub const IMAGE_TEXELS_MAX: u64 = 64 << 20;

/// Texels of all images together: 2 GiB as RGBA.
pub const TOTAL_TEXELS_MAX: u64 = 512 << 20;

/// Vertices, and triangles, in a document's meshes: a vertex takes up to 48 bytes, so both together stay below 8 GiB.
pub const DOCUMENT_VERTICES_MAX: u64 = 1 << 27;

/// Groups, parts and material names of an OBJ file together: each may cost few bytes in the file and a few hundred in memory.
pub const OBJ_PARTS_MAX: usize = 1 << 20;

/// See [`DOCUMENT_VERTICES_MAX`].
pub const DOCUMENT_TRIANGLES_MAX: u64 = 1 << 27;

/// Elements of an accessor that names no bytes (all zeros but for its sparse part): its size is not bounded by any file.
pub const ZERO_FILLED_MAX: u64 = 1 << 22;

/// Triangles, and vertices, of a flattened scene: instances multiply, so a small file can ask for any number. Ten times the
/// largest scene that this project names; far below the 32 bits of an index.
pub const FLAT_MAX: u64 = 1 << 27;

/// Greatest magnitude of a coordinate, in scene units: what a pack can be made of (`tessera_pack` refuses vertices beyond it).
pub const COORDINATE_MAX: f64 = 1e30;

/// Levels of the node tree. Traversal is iterative, so this bounds time and rounding, not the stack.
pub const NODE_DEPTH_MAX: usize = 4096;

/// Nodes on the ways from roots to cameras together, where there are animations: every camera keeps its own.
pub const CAMERA_CHAINS_MAX: usize = 1 << 22;

/// Values of keys that move cameras together: 32 bytes each, and a node that many cameras hang from counts for each of them.
pub const CAMERA_KEYS_MAX: usize = 1 << 22;

/// Corners of one polygon. Fans are made without storing it, so this only catches nonsense early.
pub const POLYGON_CORNERS_MAX: usize = 1 << 20;

/// Lines of warnings that are kept; what follows is counted.
pub const WARNINGS_MAX: usize = 100;

/// Characters of a name from a file that a message repeats.
pub const NAME_SHOWN_MAX: usize = 100;

/// Characters of a name that the document keeps.
pub const NAME_KEPT_MAX: usize = 256;
