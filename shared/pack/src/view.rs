//! A pack's bytes, checked once, then read in place.

use crate::buffer::PackBuffer;
use crate::color::srgb8_to_linear_table;
use crate::error::PackError;
use crate::format::{Head, Layout, Section};
use crate::records::{Ambient, Camera, Environment, Light, Material, SideUv, Texture};
use crate::validate::validate;
use bytemuck::Pod;
use std::fmt;
use std::sync::Arc;
use tessera_geometry::mutation::{Mutation, unless};
use tessera_geometry::{Aabb, LocalFrame, Vec2, Vec3};
use tessera_kdtree::TreeView;
use tessera_quantize::grid::{PAPER_INTERVALS, VOXELS_PER_CELL};
use tessera_quantize::oct::oct_normal;
use tessera_quantize::{NormalCode, NormalTable, Record};

/// BLAKE3 hash of a pack's content.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub struct PackId(pub [u8; 32]);

impl fmt::Display for PackId {
    /// 64 hexadecimal digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

/// A validated pack. Cheap to clone; views borrow from its bytes.
#[derive(Clone, Debug)]
pub struct Pack {
    inner: Arc<Inner>,
}

/// Bytes that somebody else looks after.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

enum Bytes {
    Owned(PackBuffer),
    Shared(SharedBytes),
}

impl Bytes {
    fn as_slice(&self) -> &[u8] {
        match self {
            Self::Owned(buffer) => buffer.as_slice(),
            Self::Shared(bytes) => (**bytes).as_ref(),
        }
    }
}

impl fmt::Debug for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bytes").field("len", &self.as_slice().len()).finish()
    }
}

/// Every thread of a worker reads the same pack.
const fn shared_between_threads<T: Send + Sync + Clone>() {}
const _: () = shared_between_threads::<Pack>();

#[derive(Debug)]
struct Inner {
    bytes: Bytes,
    layout: Layout,
    head: Head,
    id: PackId,
}

impl Pack {
    /// Checks `bytes` (header, hash, every index, the tree) and copies them.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PackError> {
        Self::from_buffer(PackBuffer::copy_of(bytes).ok_or(PackError::OutOfMemory(bytes.len() as u64))?)
    }

    /// Checks `buffer` (header, hash, every index, the tree) and takes it. After that no content can make a reader of the pack
    /// panic or reach beyond an array.
    pub fn from_buffer(buffer: PackBuffer) -> Result<Self, PackError> {
        Self::check(Bytes::Owned(buffer))
    }

    /// Checks `bytes` like [`Pack::from_buffer`] and keeps them where they are, for example in a mapped file; copies them if they are not
    /// aligned to [`crate::buffer::ALIGNMENT`]. They must be the same at every look.
    pub fn from_shared(bytes: SharedBytes) -> Result<Self, PackError> {
        if (*bytes).as_ref().as_ptr().addr().is_multiple_of(crate::buffer::ALIGNMENT) {
            Self::check(Bytes::Shared(bytes))
        } else {
            Self::from_bytes((*bytes).as_ref())
        }
    }

    fn check(bytes: Bytes) -> Result<Self, PackError> {
        let layout = Layout::read(bytes.as_slice())?;
        let head = validate(bytes.as_slice(), &layout)?;
        let id = PackId(crate::format::stored_id(bytes.as_slice()));
        Ok(Self { inner: Arc::new(Inner { bytes, layout, head, id }) })
    }

    /// The whole file.
    pub fn bytes(&self) -> &[u8] {
        self.inner.bytes.as_slice()
    }

    /// Content hash.
    pub fn id(&self) -> PackId {
        self.inner.id
    }

    /// World to local.
    pub fn frame(&self) -> LocalFrame {
        let Head { anchor, step, cells, .. } = self.inner.head;
        LocalFrame::of_grid(anchor, step, cells)
    }

    /// Numbers of the header: grid, counts, root box.
    pub fn head(&self) -> &Head {
        &self.inner.head
    }

    /// Triangles.
    pub fn triangle_count(&self) -> u32 {
        self.inner.head.triangles
    }

    /// Vertices.
    pub fn vertex_count(&self) -> u32 {
        self.inner.head.vertices
    }

    /// The kd-tree.
    pub fn tree(&self) -> TreeView<'_> {
        let Head { root_min, root_max, .. } = self.inner.head;
        TreeView {
            bounds: Aabb { min: Vec3::from_array(root_min), max: Vec3::from_array(root_max) },
            slots: self.slice(Section::Slots),
            list: self.slice(Section::List),
        }
    }

    /// Vertices and triangles.
    pub fn mesh(&self) -> MeshView<'_> {
        MeshView::new(&self.inner.head, &|section| &self.bytes()[self.inner.layout.range(section)])
    }

    /// Materials.
    pub fn materials(&self) -> &[Material] {
        self.slice(Section::Materials)
    }

    /// Material of packed triangle `id` (binary search in the runs).
    pub fn material_of(&self, id: u32) -> u32 {
        run_of(self.slice(Section::MaterialRuns), id)[1]
    }

    /// Original (flattened-scene) id of packed triangle `id` (binary search in the runs).
    pub fn original_id(&self, id: u32) -> u32 {
        let [first, original] = run_of(self.slice(Section::IdRuns), id);
        original + (id - first)
    }

    /// Texture records.
    pub fn textures(&self) -> &[Texture] {
        self.slice(Section::Textures)
    }

    /// Texels, RGBA8 each, little endian in a word: red in bits 0..7.
    pub fn texels(&self) -> &[u32] {
        self.slice(Section::Texels)
    }

    /// Lights in local space.
    pub fn lights(&self) -> &[Light] {
        self.slice(Section::Lights)
    }

    /// Named views in world space; the first is the default. A pack may have none.
    pub fn cameras(&self) -> &[Camera] {
        self.slice(Section::Cameras)
    }

    /// Ambient light.
    pub fn ambient(&self) -> Ambient {
        Ambient { radiance: self.inner.head.ambient }
    }

    /// What a miss sees.
    pub fn environment(&self) -> Environment {
        self.slice(Section::Environment).first().copied().unwrap_or_default()
    }

    /// The code of the normals in the records; `None` when there are none, or plain ones.
    pub fn packed_normals(&self) -> Option<NormalCode> {
        let head = self.head();
        let is_packed = head.flags & Head::HAS_NORMALS != 0 && self.section_bytes(Section::Normals) == 0;
        is_packed.then(|| head.normal_code())
    }

    /// Cells of the table, those that hold a vertex: 0 when positions are plain.
    pub fn cell_count(&self) -> u64 {
        self.section_bytes(Section::Cells) / cell_bytes(self.inner.head.cells) as u64
    }

    /// Bytes of a section; 0 when it is absent.
    pub fn section_bytes(&self, section: Section) -> u64 {
        self.inner.layout.range(section).len() as u64
    }

    /// Bytes of each section that is present, in file order.
    pub fn section_sizes(&self) -> Vec<(&'static str, u64)> {
        let sizes = Section::ALL.iter().map(|&s| (s.name(), self.section_bytes(s)));
        sizes.filter(|&(_, length)| length > 0).collect()
    }

    /// Bytes of a section, none when it is absent; aligned to their elements.
    pub(crate) fn section(&self, section: Section) -> &[u8] {
        &self.bytes()[self.inner.layout.range(section)]
    }

    fn slice<T: Pod>(&self, section: Section) -> &[T] {
        // Sections are aligned to 64 and their lengths were checked: the cast cannot fail.
        bytemuck::cast_slice(self.section(section))
    }
}

/// The last run that begins at or before `id`; runs begin at 0.
fn run_of(runs: &[[u32; 2]], id: u32) -> [u32; 2] {
    runs[runs.partition_point(|r| r[0] <= id) - 1]
}

/// Vertices and triangles of a pack, decoded on access. `Copy`: slices and decode constants only.
///
/// Ids and indices must be below the pack's counts; beyond them the accessors panic.
#[derive(Clone, Copy)]
pub struct MeshView<'a> {
    faces: &'a [[u32; 3]],
    records: &'a [u32],
    record_words: usize,
    positions: Positions<'a>,
    /// Added to a voxel's coordinates: half a voxel, minus the grid's centre. Exact, as is the sum.
    bias: [f32; 3],
    plain_normals: &'a [[f32; 3]],
    plain_uvs: &'a [[f32; 2]],
    side_uvs: &'a [SideUv],
    colors: &'a [[u8; 4]],
    normal_code: NormalCode,
    /// Of [`NormalCode::Smith`]; otherwise empty.
    normal_table: &'static [[f32; 3]],
    srgb: &'static [f32; 256],
    has_normals: bool,
    has_uvs: bool,
}

/// Where positions come from.
#[derive(Clone, Copy)]
enum Positions<'a> {
    /// Records and a cell table of `u32`.
    Narrow(&'a [u32]),
    /// Records and a cell table of `u64`.
    Wide(&'a [u64]),
    /// Held as they are.
    Plain(&'a [[f32; 3]]),
}

/// The elements of a section; an absent one may have any alignment.
fn elements<T: Pod>(bytes: &[u8]) -> &[T] {
    if bytes.is_empty() { &[] } else { bytemuck::cast_slice(bytes) }
}

/// Whether the cell table has `u64` entries.
pub(crate) fn cells_are_wide(cells: [u32; 3]) -> bool {
    cells.iter().any(|&n| n > PAPER_INTERVALS)
}

/// Bytes of a cell in the table of such a grid.
pub(crate) fn cell_bytes(cells: [u32; 3]) -> usize {
    if cells_are_wide(cells) { size_of::<u64>() } else { size_of::<u32>() }
}

/// What is added to a voxel's coordinates: half a voxel, minus the grid's centre.
pub(crate) fn voxel_bias(cells: [u32; 3]) -> [f32; 3] {
    // n <= 8192: 512 n and the half are exact.
    cells.map(|n| unless(Mutation::DecodeCorner, 0.5, 0.0) - (n * (VOXELS_PER_CELL / 2)) as f32)
}

#[inline(always)]
pub(crate) fn narrow_cell(entry: u32) -> [u32; 3] {
    [entry >> 20, entry >> 10 & 1023, entry & 1023]
}

#[inline]
pub(crate) fn wide_cell(entry: u64) -> [u32; 3] {
    [(entry >> 32) as u32, (entry >> 16) as u32 & 0xFFFF, entry as u32 & 0xFFFF]
}

impl<'a> MeshView<'a> {
    /// A view over sections whose lengths were checked.
    pub(crate) fn new(head: &Head, section: &dyn Fn(Section) -> &'a [u8]) -> Self {
        Self {
            faces: elements(section(Section::Faces)),
            records: elements(section(Section::Records)),
            record_words: head.record_words as usize,
            positions: if !section(Section::Positions).is_empty() {
                Positions::Plain(elements(section(Section::Positions)))
            } else if cells_are_wide(head.cells) {
                Positions::Wide(elements(section(Section::Cells)))
            } else {
                Positions::Narrow(elements(section(Section::Cells)))
            },
            bias: voxel_bias(head.cells),
            plain_normals: elements(section(Section::Normals)),
            plain_uvs: elements(section(Section::Uvs)),
            side_uvs: elements(section(Section::SideUvs)),
            colors: elements(section(Section::Colors)),
            normal_code: head.normal_code(),
            normal_table: match head.normal_code() {
                NormalCode::Smith => NormalTable::get().entries(),
                NormalCode::Oct => &[],
            },
            srgb: srgb8_to_linear_table(),
            has_normals: head.flags & Head::HAS_NORMALS != 0,
            has_uvs: head.record_words == 3 || !section(Section::Uvs).is_empty(),
        }
    }

    /// Vertex indices of triangle `id`.
    #[inline(always)]
    pub fn indices(&self, id: u32) -> [u32; 3] {
        self.faces[id as usize]
    }

    /// Decoded local position, exact: a voxel's centre (or a plain position).
    #[inline(always)]
    pub fn position(&self, vertex: u32) -> Vec3 {
        match self.positions {
            Positions::Narrow(cells) => self.decode(vertex, |index| narrow_cell(cells[index])),
            Positions::Wide(cells) => self.decode(vertex, |index| wide_cell(cells[index])),
            Positions::Plain(positions) => Vec3::from_array(positions[vertex as usize]),
        }
    }

    #[inline(always)]
    fn decode(&self, vertex: u32, cell: impl Fn(usize) -> [u32; 3]) -> Vec3 {
        // Positions need the first two words only.
        let at = vertex as usize * self.record_words;
        let record = Record([self.records[at], self.records[at + 1], 0]);
        let cell = cell(usize::from(record.cell()));
        let offsets = record.offsets();
        // Voxel coordinates are below 2^23 and the result is a half within 2^22: both exact in f32.
        let axis = |k: usize| (cell[k] << 10 | offsets[k]) as f32 + self.bias[k];
        Vec3::new(axis(0), axis(1), axis(2))
    }

    /// Decoded unit normal, `None` when the vertex (or the scene) has none.
    #[inline]
    pub fn normal(&self, vertex: u32) -> Option<Vec3> {
        if !self.has_normals {
            return None;
        }
        if self.plain_normals.is_empty() {
            let code = self.record(vertex).normal();
            let normal = match self.normal_code {
                NormalCode::Smith => self.normal_table.get(usize::from(code)).copied(),
                NormalCode::Oct => oct_normal(code),
            };
            return normal.map(Vec3::from_array);
        }
        let normal = Vec3::from_array(self.plain_normals[vertex as usize]);
        (normal != Vec3::ZERO).then_some(normal)
    }

    /// Decoded texture coordinates, (0,0) when the scene has none. They may differ from the source's by a whole number that the
    /// triangle's corners share.
    #[inline]
    pub fn uv(&self, vertex: u32) -> Vec2 {
        if !self.has_uvs {
            return Vec2::ZERO;
        }
        if !self.plain_uvs.is_empty() {
            return Vec2::from_array(self.plain_uvs[vertex as usize]);
        }
        let record = self.record(vertex);
        if !record.has_side_uv() {
            return Vec2::from_array(record.uv());
        }
        let place = self.side_uvs.binary_search_by_key(&vertex, |s| s.vertex);
        // Every record with the bit has its entry: validated.
        place.map_or(Vec2::ZERO, |i| Vec2::from_array(self.side_uvs[i].uv))
    }

    /// Linear vertex colour, white when the scene has none.
    #[inline]
    pub fn color(&self, vertex: u32) -> [f32; 4] {
        if self.colors.is_empty() {
            return [1.0; 4];
        }
        let [r, g, b, a] = self.colors[vertex as usize];
        let linear = |code: u8| self.srgb[usize::from(code)];
        [linear(r), linear(g), linear(b), f32::from(a) / 255.0]
    }

    /// Whether any vertex has a normal.
    pub fn has_normals(&self) -> bool {
        self.has_normals
    }

    /// Whether vertices have texture coordinates.
    pub fn has_uvs(&self) -> bool {
        self.has_uvs
    }

    /// Whether any vertex has a colour other than white.
    pub fn has_colors(&self) -> bool {
        !self.colors.is_empty()
    }

    /// The record of a vertex; the third word is 0 when there is none.
    #[inline]
    pub(crate) fn record(&self, vertex: u32) -> Record {
        let words = &self.records[vertex as usize * self.record_words..][..self.record_words];
        Record([words[0], words[1], words.get(2).copied().unwrap_or(0)])
    }
}

impl tessera_kdtree::Triangles for MeshView<'_> {
    #[inline(always)]
    fn vertices(&self, id: u32) -> [Vec3; 3] {
        // Spelt out: `array::map` is not inlined here, and this is the kernel's innermost loop.
        let [a, b, c] = self.indices(id);
        [self.position(a), self.position(b), self.position(c)]
    }
}
