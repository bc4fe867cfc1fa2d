//! Checks on a pack that came from outside: after them no content can make a reader fail.

use crate::error::PackError;
use crate::format::{Head, Layout, Section};
use crate::records::{Camera, Environment, Light, Material, SideUv, Texture};
use crate::rules::{
    ambient_fault, camera_fault, environment_fault, is_unit, light_fault, material_fault, texture_fault,
};
use crate::view::{MeshView, cell_bytes, cells_are_wide, narrow_cell, wide_cell};
use bytemuck::Pod;
use rayon::prelude::*;
use tessera_geometry::{Aabb, Vec3};
use tessera_kdtree::TreeView;
use tessera_kdtree::node::MAX_DEPTH;
use tessera_quantize::NO_NORMAL;
use tessera_quantize::grid::{MAX_CELLS, MAX_COORDINATE, MAX_INTERVALS, MIN_EXTENT, VOXELS_PER_CELL};
use tessera_quantize::uv::MAX_UV;

/// Largest local coordinate: half of 8192 cells of 1024 voxels.
const MAX_LOCAL: f32 = (MAX_INTERVALS / 2 * VOXELS_PER_CELL) as f32;
/// The root box of the kd-tree may exceed the mesh by a few voxels.
const MAX_ROOT: f32 = 2.0 * MAX_LOCAL;
/// Range of voxel sides that a grid can have.
const STEP_MIN: f64 = MIN_EXTENT / (MAX_INTERVALS * VOXELS_PER_CELL) as f64;
const STEP_MAX: f64 = MAX_COORDINATE;

/// Checks every section of `bytes` against the format and against the others.
pub(crate) fn validate(bytes: &[u8], layout: &Layout) -> Result<Head, PackError> {
    let file = File { bytes, layout };
    let head = *file.only::<Head>(Section::Head)?;
    check_head(&head)?;
    check_lengths(&file, &head)?;
    check_cells(&file, &head)?;
    let mesh = MeshView::new(&head, &|section| file.section(section));
    check_vertices(&file, &head, &mesh)?;
    check_side_uvs(&file, &head, &mesh)?;
    check_faces(&file, &head)?;
    check_records(&file)?;
    check_runs(&file, &head)?;
    check_tree(&file, &head)?;
    Ok(head)
}

struct File<'a> {
    bytes: &'a [u8],
    layout: &'a Layout,
}

impl<'a> File<'a> {
    fn section(&self, section: Section) -> &'a [u8] {
        &self.bytes[self.layout.range(section)]
    }

    /// The elements of a section; an error when its length is no multiple of theirs.
    fn elements<T: Pod>(&self, section: Section) -> Result<&'a [T], PackError> {
        let bytes = self.section(section);
        bytemuck::try_cast_slice(bytes)
            .map_err(|_| fault(section, 0, format!("{} bytes are no whole number of elements", bytes.len())))
    }

    fn only<T: Pod>(&self, section: Section) -> Result<&'a T, PackError> {
        match self.elements::<T>(section)? {
            [one] => Ok(one),
            all => Err(fault(section, 0, format!("{} elements instead of one", all.len()))),
        }
    }

    /// Checks that a section has exactly `count` elements.
    fn expect<T: Pod>(&self, section: Section, count: usize) -> Result<&'a [T], PackError> {
        let elements = self.elements::<T>(section)?;
        if elements.len() != count {
            return Err(fault(section, 0, format!("{} elements instead of {count}", elements.len())));
        }
        Ok(elements)
    }

    /// Checks that a section is absent or has exactly `count` elements.
    fn optional<T: Pod>(&self, section: Section, count: usize) -> Result<&'a [T], PackError> {
        if self.section(section).is_empty() { Ok(&[]) } else { self.expect(section, count) }
    }
}

fn fault(section: Section, offset: usize, what: impl Into<String>) -> PackError {
    PackError::Malformed { section: section.name(), offset: offset as u64, what: what.into() }
}

/// The first element for which `rule` names a fault.
fn check_each<T: Pod + Sync>(
    section: Section,
    elements: &[T],
    rule: impl Fn(usize, &T) -> Option<&'static str> + Sync,
) -> Result<(), PackError> {
    let first = elements.par_iter().enumerate().find_map_first(|(i, e)| rule(i, e).map(|what| (i, what)));
    first.map_or(Ok(()), |(i, what)| Err(fault(section, i * size_of::<T>(), format!("element {i}: {what}"))))
}

fn check_head(head: &Head) -> Result<(), PackError> {
    let bad = |what: &str| Err(fault(Section::Head, 0, what));
    // NaN fails every comparison.
    if !head.anchor.iter().all(|x| x.abs() <= MAX_COORDINATE) {
        return bad("the anchor is out of range");
    }
    if !(STEP_MIN..=STEP_MAX).contains(&head.step) {
        return bad("the voxel side is out of range");
    }
    if !head.cells.iter().all(|n| (1..=MAX_INTERVALS).contains(n)) {
        return bad("a number of cells is not in 1..=8192");
    }
    if head.vertices == u32::MAX || head.triangles == u32::MAX {
        return bad("too many vertices or triangles");
    }
    if head.triangles > head.source_triangles {
        return bad("more triangles than the scene had");
    }
    if head.tree_depth > MAX_DEPTH {
        return bad("the kd-tree is deeper than a traversal stack");
    }
    if head.flags & !(Head::HAS_NORMALS | Head::OCT_NORMALS) != 0 {
        return bad("unknown flags");
    }
    ambient_fault(&head.ambient).map_or(Ok(()), bad)
}

/// Lengths of everything that is per vertex or per triangle.
fn check_lengths(file: &File<'_>, head: &Head) -> Result<(), PackError> {
    let vertices = head.vertices as usize;
    let triangles = head.triangles as usize;
    let bad = |what: &str| Err(fault(Section::Head, 0, what));
    file.expect::<[u32; 3]>(Section::Faces, triangles)?;
    let positions = file.optional::<[f32; 3]>(Section::Positions, vertices)?;
    let normals = file.optional::<[f32; 3]>(Section::Normals, vertices)?;
    let uvs = file.optional::<[f32; 2]>(Section::Uvs, vertices)?;
    file.optional::<[u8; 4]>(Section::Colors, vertices)?;
    match head.record_words {
        0 if vertices > 0 && positions.is_empty() => return bad("vertices without positions"),
        0 | 2 => {}
        3 if uvs.is_empty() => {}
        3 => return bad("texture coordinates twice"),
        _ => return bad("a vertex record has 0, 2 or 3 words"),
    }
    if !normals.is_empty() && head.flags & Head::HAS_NORMALS == 0 {
        return bad("normals in a mesh that is marked as having none");
    }
    if head.flags & Head::OCT_NORMALS != 0 && (head.flags & Head::HAS_NORMALS == 0 || !normals.is_empty()) {
        return bad("a code for normals without normals in the records");
    }
    file.expect::<u32>(Section::Records, vertices * head.record_words as usize)?;
    Ok(())
}

fn check_cells(file: &File<'_>, head: &Head) -> Result<(), PackError> {
    fn check<T: Pod + Sync + PartialOrd>(
        cells: &[T],
        limit: [u32; 3],
        split: fn(T) -> [u32; 3],
    ) -> Result<(), PackError> {
        if cells.len() > MAX_CELLS {
            return Err(fault(Section::Cells, 0, "more than 65,536 cells"));
        }
        check_each(Section::Cells, cells, |i, &cell| {
            if i > 0 && cells[i - 1] >= cell {
                Some("cells do not ascend")
            } else if split(cell).iter().zip(limit).any(|(&c, n)| c >= n) {
                Some("a cell outside the grid")
            } else {
                None
            }
        })
    }
    if cells_are_wide(head.cells) {
        check(file.elements(Section::Cells)?, head.cells, wide_cell)
    } else {
        check(file.elements(Section::Cells)?, head.cells, narrow_cell)
    }
}

fn check_vertices(file: &File<'_>, head: &Head, mesh: &MeshView<'_>) -> Result<(), PackError> {
    let positions: &[[f32; 3]] = file.elements(Section::Positions)?;
    let cells = file.section(Section::Cells).len() / cell_bytes(head.cells);
    let plain_normals = !file.section(Section::Normals).is_empty();
    if head.record_words > 0 {
        let rule = |vertex: u32| {
            let record = mesh.record(vertex);
            let code = record.normal();
            if !record.reserved_bits_are_zero() || (head.record_words < 3 && record.has_side_uv()) {
                Some("reserved bits are not zero")
            } else if positions.is_empty() && usize::from(record.cell()) >= cells {
                Some("a cell beyond the table")
            } else if !positions.is_empty() && (record.offsets() != [0; 3] || record.cell() != 0) {
                Some("a position in the record beside a plain one")
            } else if !head.normal_code().is_code(code) {
                Some("a normal code that no encoder writes")
            } else if code != NO_NORMAL && (plain_normals || !mesh.has_normals()) {
                Some("a normal in the record where there must be none")
            } else {
                None
            }
        };
        let first = (0..head.vertices).into_par_iter().find_map_first(|v| rule(v).map(|what| (v, what)));
        if let Some((vertex, what)) = first {
            let offset = vertex as usize * head.record_words as usize * 4;
            return Err(fault(Section::Records, offset, format!("vertex {vertex}: {what}")));
        }
    } else if mesh.has_normals() && !plain_normals && head.vertices > 0 {
        return Err(fault(Section::Head, 0, "marked as having normals, but there are none"));
    }
    check_each(Section::Positions, positions, |_, p| {
        (!p.iter().all(|x| x.abs() <= MAX_LOCAL)).then_some("a coordinate out of range")
    })?;
    check_each(Section::Normals, file.elements::<[f32; 3]>(Section::Normals)?, |_, &n| {
        (n != [0.0; 3] && !is_unit(n)).then_some("neither zero nor a unit vector")
    })?;
    check_each(Section::Uvs, file.elements::<[f32; 2]>(Section::Uvs)?, |_, uv| uv_fault(uv))
}

fn uv_fault(uv: &[f32; 2]) -> Option<&'static str> {
    (!uv.iter().all(|x| x.abs() <= MAX_UV)).then_some("a texture coordinate out of range")
}

fn check_side_uvs(file: &File<'_>, head: &Head, mesh: &MeshView<'_>) -> Result<(), PackError> {
    let side: &[SideUv] = file.elements(Section::SideUvs)?;
    if head.record_words < 3 && !side.is_empty() {
        return Err(fault(Section::SideUvs, 0, "there are no texture coordinates in the records"));
    }
    check_each(Section::SideUvs, side, |i, entry| {
        if i > 0 && side[i - 1].vertex >= entry.vertex {
            Some("vertices do not ascend")
        } else if entry.vertex >= head.vertices || !mesh.record(entry.vertex).has_side_uv() {
            Some("a vertex that does not refer to the table")
        } else {
            uv_fault(&entry.uv)
        }
    })?;
    if head.record_words == 3 {
        // Entries name distinct vertices with the bit; equal numbers mean that every such vertex has its entry.
        let marked = (0..head.vertices).into_par_iter().filter(|&v| mesh.record(v).has_side_uv()).count();
        if marked != side.len() {
            return Err(fault(Section::SideUvs, 0, format!("{} entries for {marked} vertices", side.len())));
        }
    }
    Ok(())
}

fn check_faces(file: &File<'_>, head: &Head) -> Result<(), PackError> {
    check_each(Section::Faces, file.elements::<[u32; 3]>(Section::Faces)?, |_, face| {
        face.iter().any(|&v| v >= head.vertices).then_some("a vertex that does not exist")
    })
}

fn check_records(file: &File<'_>) -> Result<(), PackError> {
    let texels = file.elements::<u32>(Section::Texels)?.len() as u64;
    let textures: &[Texture] = file.elements(Section::Textures)?;
    check_each(Section::Textures, textures, |_, t| texture_fault(t, texels))?;
    let materials: &[Material] = file.elements(Section::Materials)?;
    check_each(Section::Materials, materials, |_, m| material_fault(m, textures.len()))?;
    check_each(Section::Lights, file.elements::<Light>(Section::Lights)?, |_, l| light_fault(l))?;
    check_each(Section::Cameras, file.elements::<Camera>(Section::Cameras)?, |_, c| camera_fault(c))?;
    if file.section(Section::Environment).is_empty() {
        return Ok(());
    }
    let environment: &Environment = file.only(Section::Environment)?;
    environment_fault(environment, textures.len())
        .map_or(Ok(()), |what| Err(fault(Section::Environment, 0, what)))
}

fn check_runs(file: &File<'_>, head: &Head) -> Result<(), PackError> {
    let materials = file.elements::<Material>(Section::Materials)?.len();
    let check = |section: Section, rule: &(dyn Fn(u32, u32) -> Option<&'static str> + Sync)| {
        let runs: &[[u32; 2]] = file.elements(section)?;
        if runs.is_empty() != (head.triangles == 0) {
            return Err(fault(section, 0, "runs without triangles, or triangles without runs"));
        }
        check_each(section, runs, |i, &[first, value]| {
            let end = runs.get(i + 1).map_or(head.triangles, |next| next[0]);
            if i == 0 && first != 0 {
                Some("the first run does not begin at triangle 0")
            } else if first >= end || end > head.triangles {
                Some("runs do not ascend within the triangles")
            } else {
                rule(value, end - first)
            }
        })
    };
    check(Section::MaterialRuns, &|material, _| {
        (material as usize >= materials).then_some("a material that does not exist")
    })?;
    check(Section::IdRuns, &|original, length| {
        (u64::from(original) + u64::from(length) > u64::from(head.source_triangles))
            .then_some("an original id beyond the scene")
    })
}

fn check_tree(file: &File<'_>, head: &Head) -> Result<(), PackError> {
    let bounds = Aabb { min: Vec3::from_array(head.root_min), max: Vec3::from_array(head.root_max) };
    let finite = [bounds.min, bounds.max].iter().all(|p| p.to_array().iter().all(|x| x.abs() <= MAX_ROOT));
    if bounds != Aabb::EMPTY && (!finite || bounds.is_empty()) {
        return Err(fault(Section::Head, 0, "the root box of the kd-tree is out of range"));
    }
    let tree =
        TreeView { bounds, slots: file.elements(Section::Slots)?, list: file.elements(Section::List)? };
    tessera_kdtree::validate::validate(&tree, head.triangles)
        .map_err(|e| fault(Section::Slots, e.slot as usize * size_of::<[u32; 2]>(), e.to_string()))
}
