//! The `.tpack` file: header, section table, sections.
//!
//! Everything is little endian; offsets are from the start of the file.
//!
//! | bytes | what |
//! |---|---|
//! | 0..8 | `tpack`, CR LF, ^Z |
//! | 8..12 | [`VERSION`] |
//! | 12..16 | number of sections |
//! | 16..24 | length of the file |
//! | 24..32 | 0 |
//! | 32..64 | BLAKE3 of bytes 0..32 and 64.. : the pack's id |
//! | 64.. | section table: name, offset and length of each (8 bytes, `u64`, `u64`), ascending by section and by offset |
//!
//! Sections begin at multiples of 64 with zero bytes between them; the last one ends the file. A section that a scene does not
//! need is absent, and an empty one is never stored. Two packs with the same content are the same bytes.
//!
//! The normal table is a constant function and not stored. What each section holds is said at [`Section`].
//!
//! How coarsely positions and texture coordinates were rounded before they were packed is not stored either: no reader decodes them
//! differently. Which code normals have is a flag of [`Head`]; a reader that does not know a flag refuses the pack, so that a new flag needs no new
//! version.

use crate::buffer::{ALIGNMENT, PackBuffer};
use crate::error::PackError;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use tessera_quantize::NormalCode;

#[cfg(target_endian = "big")]
compile_error!("packs are read in place and little endian: big-endian targets are not supported");

/// First bytes of a pack; CR LF and ^Z show a transfer that took it for text.
const MAGIC: [u8; 8] = *b"tpack\r\n\x1a";
/// Version of the format. Raise it with every change of a section's meaning.
pub const VERSION: u32 = 1;
/// Bytes before the section table.
pub const HEADER_LEN: usize = 64;

const HASH: Range<usize> = 32..64;

macro_rules! sections {
    ($($(#[$doc:meta])* $name:ident = $tag:literal,)*) => {
        /// The sections, in file order.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[repr(usize)]
        pub enum Section { $($(#[$doc])* $name,)* }

        impl Section {
            /// All sections, in file order.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// Name in the file (padded with zeros to 8 bytes there) and in messages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$name => $tag,)* }
            }
        }
    };
}

sections! {
    /// One [`Head`].
    Head = "head",
    /// Cell table, ascending. `u32` each when no axis has more than 1024 cells: z in bits 0..=9, y in 10..=19, x in 20..=29.
    /// Otherwise `u64` each: z in bits 0..=15, y in 16..=31, x in 32..=47.
    Cells = "cells",
    /// Vertex records of [`Head::record_words`] words each, see [`tessera_quantize::vertex`]; normals in them have the code
    /// [`Head::normal_code`]. Absent when everything is plain.
    Records = "records",
    /// Plain positions, 3 x `f32` in local units.
    Positions = "position",
    /// Plain normals, 3 x `f32`, unit or zero (none).
    Normals = "normal",
    /// Plain texture coordinates, 2 x `f32`.
    Uvs = "uv",
    /// Texture coordinates that do not pack: [`crate::records::SideUv`], ascending by vertex.
    SideUvs = "side-uv",
    /// Vertex colours, 4 x `u8`: sRGB-coded colour, linear alpha.
    Colors = "color",
    /// Vertex indices, 3 x `u32` a triangle.
    Faces = "face",
    /// `(first triangle, material)`, ascending; a run ends where the next begins.
    MaterialRuns = "matrun",
    /// `(first triangle, original id of it)`, ascending; ids count up within a run.
    IdRuns = "idrun",
    /// kd-tree slots, 2 x `u32`, see [`tessera_kdtree::node`].
    Slots = "kdslot",
    /// Triangle ids of leaves.
    List = "kdlist",
    /// [`crate::Material`] each.
    Materials = "material",
    /// [`crate::Texture`] each.
    Textures = "texture",
    /// RGBA8 words, red in bits 0..=7.
    Texels = "texel",
    /// [`crate::Light`] each, in local space.
    Lights = "light",
    /// One [`crate::Environment`]; absent when a miss is black and transparent.
    Environment = "environ",
    /// [`crate::Camera`] each, in world space; the first is the default.
    Cameras = "camera",
}

/// A line of the section table.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct Entry {
    /// [`Section::name`], padded with zeros.
    tag: [u8; 8],
    /// First byte in the file, a multiple of 64.
    offset: u64,
    /// Bytes, > 0.
    length: u64,
}

const _: () = assert!(size_of::<Entry>() == 24);

/// The numbers that every pack has.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Head {
    /// World position of the grid's low corner.
    pub anchor: [f64; 3],
    /// Side of a voxel in world units. (The paper keeps anchor and cell side in `f32`; at an offset of 1e7 that is useless.)
    pub step: f64,
    /// Cells along each axis.
    pub cells: [u32; 3],
    /// Words of a vertex record: 3, 2 without texture coordinates in it, 0 when there are no records.
    pub record_words: u32,
    /// Vertices.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// Triangles of the flattened scene: original ids are below this.
    pub source_triangles: u32,
    /// Greatest depth of a leaf of the kd-tree.
    pub tree_depth: u32,
    /// Low corner of the kd-tree's root box.
    pub root_min: [f32; 3],
    /// High corner.
    pub root_max: [f32; 3],
    /// Ambient radiance.
    pub ambient: [f32; 3],
    /// [`Head::HAS_NORMALS`], [`Head::OCT_NORMALS`]; the rest 0.
    pub flags: u32,
}

const _: () = assert!(size_of::<Head>() == 104);

impl Head {
    /// Some vertex has a normal.
    pub const HAS_NORMALS: u32 = 1;
    /// Normals in the records have the code [`NormalCode::Oct`] and not [`NormalCode::Smith`]. Only where there are such normals.
    pub const OCT_NORMALS: u32 = 2;

    /// The code of the normals in the records.
    pub const fn normal_code(&self) -> NormalCode {
        if self.flags & Self::OCT_NORMALS != 0 { NormalCode::Oct } else { NormalCode::Smith }
    }
}

/// Checks what the first [`HEADER_LEN`] bytes of a file of `length` bytes claim: signature, version and length. Refuses most of what
/// is not a pack before memory for the whole is reserved.
pub fn check_header(first: &[u8], length: u64) -> Result<(), PackError> {
    if first.get(..8) != Some(MAGIC.as_slice()) {
        return Err(PackError::NotAPack);
    }
    let Some(header) = first.get(..HEADER_LEN) else {
        return Err(PackError::Truncated { expected: HEADER_LEN as u64, found: first.len() as u64 });
    };
    let version = bytemuck::pod_read_unaligned::<u32>(&header[8..12]);
    if version != VERSION {
        return Err(PackError::Version { found: version });
    }
    let expected = bytemuck::pod_read_unaligned::<u64>(&header[16..24]);
    if expected != length {
        return Err(PackError::Truncated { expected, found: length });
    }
    Ok(())
}

/// Where each section lies; an empty range when it is absent.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    ranges: [Range<usize>; Section::ALL.len()],
}

impl Layout {
    pub(crate) fn range(&self, section: Section) -> Range<usize> {
        self.ranges[section as usize].clone()
    }

    /// Reads header and section table and checks everything but what is inside the sections.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, PackError> {
        check_header(bytes, bytes.len() as u64)?;
        let header = &bytes[..HEADER_LEN];
        let word = |at: usize| bytemuck::pod_read_unaligned::<u32>(&header[at..at + 4]);
        let long = |at: usize| bytemuck::pod_read_unaligned::<u64>(&header[at..at + 8]);
        let malformed =
            |offset: u64, what: &str| PackError::Malformed { section: "header", offset, what: what.into() };
        if long(24) != 0 {
            return Err(malformed(24, "reserved bytes are not zero"));
        }
        if id(bytes) != header[HASH] {
            return Err(PackError::HashMismatch);
        }
        let count = word(12) as usize;
        if count > Section::ALL.len() {
            return Err(malformed(12, "more sections than there are kinds"));
        }
        let table_end = HEADER_LEN + count * size_of::<Entry>();
        let Some(table) = bytes.get(HEADER_LEN..table_end) else {
            return Err(malformed(12, "the section table does not fit the file"));
        };
        let mut ranges = [const { 0..0 }; Section::ALL.len()];
        let mut end = table_end;
        let mut kinds = Section::ALL.iter();
        for (line, raw) in table.chunks_exact(size_of::<Entry>()).enumerate() {
            let entry: Entry = bytemuck::pod_read_unaligned(raw);
            let at = (HEADER_LEN + line * size_of::<Entry>()) as u64;
            let malformed =
                |what: &str| PackError::Malformed { section: "section table", offset: at, what: what.into() };
            // Taking kinds from one iterator makes them ascending and unique.
            let Some(&section) = kinds.find(|s| tag(**s) == entry.tag) else {
                return Err(malformed("unknown, repeated or misplaced section"));
            };
            if entry.offset != end.next_multiple_of(ALIGNMENT) as u64 {
                return Err(malformed("the section does not follow the one before"));
            }
            let start = entry.offset as usize;
            if entry.length == 0 || entry.length > bytes.len().saturating_sub(start) as u64 {
                return Err(malformed("the section is empty or does not fit the file"));
            }
            if bytes[end..start].iter().any(|&b| b != 0) {
                return Err(malformed("bytes before the section are not zero"));
            }
            end = start + entry.length as usize;
            ranges[section as usize] = start..end;
        }
        if end != bytes.len() {
            return Err(malformed(16, "there are bytes behind the last section"));
        }
        Ok(Self { ranges })
    }
}

/// Lays `sections` (ascending; empty ones are skipped) out as a file. `None` when the memory cannot be had.
pub(crate) fn assemble(sections: &[(Section, &[u8])]) -> Option<PackBuffer> {
    let present: Vec<_> = sections.iter().filter(|(_, bytes)| !bytes.is_empty()).collect();
    let mut end = HEADER_LEN + present.len() * size_of::<Entry>();
    let mut entries = Vec::with_capacity(present.len());
    for (section, bytes) in &present {
        let offset = end.next_multiple_of(ALIGNMENT);
        entries.push(Entry { tag: tag(*section), offset: offset as u64, length: bytes.len() as u64 });
        end = offset + bytes.len();
    }
    let mut buffer = PackBuffer::with_len(end)?;
    let file = buffer.as_mut_slice();
    file[..8].copy_from_slice(&MAGIC);
    file[8..12].copy_from_slice(&VERSION.to_le_bytes());
    file[12..16].copy_from_slice(&(entries.len() as u32).to_le_bytes());
    file[16..24].copy_from_slice(&(end as u64).to_le_bytes());
    let table: &[u8] = bytemuck::cast_slice(&entries);
    file[HEADER_LEN..HEADER_LEN + table.len()].copy_from_slice(table);
    for (entry, (_, bytes)) in entries.iter().zip(present) {
        let start = entry.offset as usize;
        file[start..start + bytes.len()].copy_from_slice(bytes);
    }
    let hash = id(file);
    file[HASH].copy_from_slice(&hash);
    Some(buffer)
}

/// The content hash of a file of at least [`HEADER_LEN`] bytes.
pub(crate) fn id(bytes: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..HASH.start]);
    hasher.update(&bytes[HASH.end..]);
    *hasher.finalize().as_bytes()
}

/// The hash that the header of a checked file gives.
pub(crate) fn stored_id(bytes: &[u8]) -> [u8; 32] {
    let mut id = [0; 32];
    id.copy_from_slice(&bytes[HASH]);
    id
}

fn tag(section: Section) -> [u8; 8] {
    let mut tag = [0; 8];
    let name = section.name().as_bytes();
    tag[..name.len()].copy_from_slice(name);
    tag
}
