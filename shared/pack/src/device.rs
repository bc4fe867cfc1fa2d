//! A pack in compute memory: the kd-tree's slots by themselves, and everything else as one row of words.

use crate::color::srgb8_to_linear_table;
use crate::format::Section;
use crate::view::{Pack, cells_are_wide, voxel_bias};
use bytemuck::cast_slice;
use tessera_quantize::{NormalCode, NormalTable};

/// The text for GPUs of sections and of the records in them.
pub const WGSL: [&str; 3] =
    [tessera_quantize::vertex::WGSL, tessera_quantize::oct::WGSL, include_str!("sections.wgsl")];

/// Places in the row of words, by section; that of an absent section is where it would begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs, reason = "each is the section of its name")]
pub struct Places {
    pub list: u32,
    pub faces: u32,
    pub records: u32,
    pub cells: u32,
    pub positions: u32,
    pub normals: u32,
    pub uvs: u32,
    pub side_uvs: u32,
    pub colors: u32,
    pub material_runs: u32,
    pub id_runs: u32,
    pub materials: u32,
    pub textures: u32,
    pub texels: u32,
    pub lights: u32,
    /// The decoded normals by code, 3 words each; only where normals of [`NormalCode::Smith`] are used.
    pub normal_table: u32,
    /// The linear values of 256 sRGB codes.
    pub srgb: u32,
    /// What the caller has added.
    pub extra: u32,
}

/// What is to be uploaded of a pack.
#[derive(Debug)]
pub struct DeviceWords<'a> {
    /// Slots of the kd-tree, 8 bytes each.
    pub slots: &'a [u8],
    /// Pieces of the row of words, one after the other without gaps, each a whole number of words.
    pub pieces: Vec<&'a [u8]>,
    /// Where each begins.
    pub places: Places,
    /// Words in all.
    pub length: u64,
}

impl<'a> DeviceWords<'a> {
    /// Lays out `pack`, with `extra` at the end. `None` when it has more words than a 32-bit place can name.
    pub fn of(pack: &'a Pack, extra: &'a [f32]) -> Option<Self> {
        let mut words = Self {
            slots: pack.section(Section::Slots),
            pieces: Vec::new(),
            places: Places::default(),
            length: 0,
        };
        let needs_table = pack.packed_normals() == Some(NormalCode::Smith);
        let normals: &[[f32; 3]] = if needs_table { NormalTable::get().entries() } else { &[] };
        let place = &mut words.places;
        for (to, bytes) in [
            (&mut place.list, pack.section(Section::List)),
            (&mut place.faces, pack.section(Section::Faces)),
            (&mut place.records, pack.section(Section::Records)),
            (&mut place.cells, pack.section(Section::Cells)),
            (&mut place.positions, pack.section(Section::Positions)),
            (&mut place.normals, pack.section(Section::Normals)),
            (&mut place.uvs, pack.section(Section::Uvs)),
            (&mut place.side_uvs, pack.section(Section::SideUvs)),
            (&mut place.colors, pack.section(Section::Colors)),
            (&mut place.material_runs, pack.section(Section::MaterialRuns)),
            (&mut place.id_runs, pack.section(Section::IdRuns)),
            (&mut place.materials, pack.section(Section::Materials)),
            (&mut place.textures, pack.section(Section::Textures)),
            (&mut place.texels, pack.section(Section::Texels)),
            (&mut place.lights, pack.section(Section::Lights)),
            (&mut place.normal_table, cast_slice(normals)),
            (&mut place.srgb, cast_slice(srgb8_to_linear_table())),
            (&mut place.extra, cast_slice(extra)),
        ] {
            *to = u32::try_from(words.length).ok()?;
            words.length += bytes.len() as u64 / 4;
            words.pieces.push(bytes);
        }
        (words.length <= u64::from(u32::MAX)).then_some(words)
    }
}

/// How vertices are laid out, which decides how a kernel reads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct VertexLayout {
    /// Positions are `f32` and not cells and offsets.
    pub plain_positions: bool,
    /// The cell table has 64-bit entries.
    pub wide_cells: bool,
    /// Words of a record; 0 without any.
    pub record_words: u32,
    /// Normals are `f32` and not codes.
    pub plain_normals: bool,
    /// Codes of normals are [`NormalCode::Oct`], which needs no table.
    pub oct_normals: bool,
    /// Texture coordinates are `f32`.
    pub plain_uvs: bool,
    /// Some are in the side table.
    pub has_side_uvs: bool,
}

impl VertexLayout {
    /// That of `pack`.
    pub fn of(pack: &Pack) -> Self {
        let head = pack.head();
        Self {
            plain_positions: pack.section_bytes(Section::Positions) > 0,
            wide_cells: cells_are_wide(head.cells),
            record_words: head.record_words,
            plain_normals: pack.section_bytes(Section::Normals) > 0,
            oct_normals: head.normal_code() == NormalCode::Oct,
            plain_uvs: pack.section_bytes(Section::Uvs) > 0,
            has_side_uvs: pack.section_bytes(Section::SideUvs) > 0,
        }
    }
}

impl Pack {
    /// What is added to a voxel's coordinates: half a voxel, minus the grid's centre.
    pub fn voxel_bias(&self) -> [f32; 3] {
        voxel_bias(self.head().cells)
    }

    /// Runs of triangles of one material.
    pub fn material_run_count(&self) -> u32 {
        (self.section_bytes(Section::MaterialRuns) / 8) as u32
    }

    /// Runs of triangles whose original ids follow each other.
    pub fn id_run_count(&self) -> u32 {
        (self.section_bytes(Section::IdRuns) / 8) as u32
    }

    /// Vertices whose texture coordinates are in the side table.
    pub fn side_uv_count(&self) -> u32 {
        (self.section_bytes(Section::SideUvs) / size_of::<crate::SideUv>() as u64) as u32
    }
}
