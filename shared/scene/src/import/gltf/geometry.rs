//! Meshes: attributes and indices become triangle lists.

use super::accessor::{Accessor, Buffers};
use super::json::mesh::{Mode, Semantic};
use super::json::validation::Checked;
use super::json::{self, Root};
use super::material::UvSource;
use super::{checked, name_or};
use crate::import::limits::{DOCUMENT_TRIANGLES_MAX, DOCUMENT_VERTICES_MAX};
use crate::import::report::{Report, shown};
use crate::import::texels::code;
use crate::{Mesh, Primitive};
use glam::DVec3;
use std::sync::LazyLock;
use tessera_geometry::linear_from_srgb;

/// Reads meshes and counts what they hold together.
pub(super) struct MeshReader<'a> {
    pub(super) root: &'a Root,
    pub(super) buffers: &'a Buffers,
    /// What each material wants; the last entry is the default material's.
    pub(super) uv_sources: Vec<Option<UvSource>>,
    pub(super) vertices: u64,
    pub(super) triangles: u64,
}

impl MeshReader<'_> {
    /// `meshes[index]`.
    pub(super) fn read(
        &mut self,
        index: usize,
        source: &json::Mesh,
        report: &mut Report,
    ) -> Result<Mesh, String> {
        let mut mesh = Mesh { name: name_or(&source.name, "mesh", index), primitives: Vec::new() };
        for (part, source) in source.primitives.iter().enumerate() {
            let primitive = self.primitive(source, &mesh.name, report);
            let primitive =
                primitive.map_err(|what| format!("meshes[{index}].primitives[{part}]: {what}"))?;
            mesh.primitives.extend(primitive);
        }
        Ok(mesh)
    }

    /// One primitive; `None` when it has no triangles.
    fn primitive(
        &mut self,
        source: &json::mesh::Primitive,
        mesh_name: &str,
        report: &mut Report,
    ) -> Result<Option<Primitive>, String> {
        let mode = *checked(&source.mode)?;
        if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            report.warn("primitives of points and lines have no surface and are left out");
            report.drop("primitives of points or lines", 1);
            return Ok(None);
        }
        if source.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
            report.warn("morph targets are not applied: meshes are shown in their rest pose");
        }
        let default_material = self.uv_sources.len() - 1;
        let material = source.material.map_or(default_material, |material| material.value());
        if source.material.is_some() && material >= default_material {
            return Err(format!("names material {material}, but there are {default_material}"));
        }
        let open = |semantic: Semantic, lanes: &[usize]| -> Result<Option<Accessor<'_>>, String> {
            let Some(index) = source.attributes.get(&Checked::Valid(semantic.clone())) else {
                return Ok(None);
            };
            let of = |what: String| format!("{}: {what}", semantic.to_string());
            let accessor = Accessor::open(self.root, self.buffers, index.value()).map_err(of)?;
            if !lanes.contains(&accessor.lanes()) {
                return Err(of(format!(
                    "has {} numbers an element; {lanes:?} are expected",
                    accessor.lanes()
                )));
            }
            Ok(Some(accessor))
        };
        let Some(positions) = open(Semantic::Positions, &[3])? else {
            report.warn("primitives without positions are left out");
            report.drop("primitives without positions", 1);
            return Ok(None);
        };
        let count = positions.count();
        let normals = open(Semantic::Normals, &[3])?;
        let colors = open(Semantic::Colors(0), &[3, 4])?;
        let uv_source = self.uv_sources[material];
        let uvs = match uv_source {
            Some(uv) => open(Semantic::TexCoords(uv.set), &[2])?,
            None => None,
        };
        if let (Some(uv), None) = (uv_source, &uvs) {
            report.warn(format!(
                "the mesh \"{}\" lacks TEXCOORD_{}, which its material's texture wants; its first texel is shown",
                shown(mesh_name),
                uv.set
            ));
        }
        for (other, what) in [(&normals, "normals"), (&colors, "colours"), (&uvs, "texture coordinates")] {
            if let Some(other) = other.as_ref().map(Accessor::count).filter(|&other| other != count) {
                return Err(format!("has {other} {what} for {count} positions; they must be as many"));
            }
        }
        if colors.as_ref().is_some_and(|colors| !colors.is_float_or_normalized()) {
            return Err("COLOR_0: integers that are not normalised".to_owned());
        }

        let mut corners = self.corners(source, count)?;
        let keep = compact(&mut corners, count);
        let triangles = assemble(&corners, mode)?;
        if triangles.is_empty() {
            report.drop("primitives without triangles", 1);
            return Ok(None);
        }
        let vertices = keep.as_ref().map_or(count, Vec::len);
        self.vertices += vertices as u64;
        self.triangles += triangles.len() as u64;
        if self.vertices > DOCUMENT_VERTICES_MAX || self.triangles > DOCUMENT_TRIANGLES_MAX {
            return Err(format!(
                "brings the file over {DOCUMENT_VERTICES_MAX} vertices or {DOCUMENT_TRIANGLES_MAX} triangles, the limits"
            ));
        }
        let kept = |i: usize| keep.as_ref().map_or(i, |keep| keep[i] as usize);
        let position = |i| DVec3::from(positions.vector::<3>(kept(i), 0.0).map(f64::from));
        Ok(Some(Primitive {
            positions: (0..vertices).map(position).collect(),
            normals: normals
                .map_or(Vec::new(), |normals| (0..vertices).map(|i| normals.vector(kept(i), 0.0)).collect()),
            uvs: uvs.zip(uv_source).map_or(Vec::new(), |(uvs, source)| {
                (0..vertices).map(|i| source.apply(uvs.vector(kept(i), 0.0))).collect()
            }),
            colors: colors.map_or(Vec::new(), |colors| {
                (0..vertices).map(|i| color_code(colors.vector(kept(i), 1.0))).collect()
            }),
            triangles,
            material,
        }))
    }

    /// The vertex of every corner, each below `count`.
    fn corners(&self, source: &json::mesh::Primitive, count: usize) -> Result<Vec<u32>, String> {
        let vertices = u32::try_from(count).ok().filter(|&count| u64::from(count) <= DOCUMENT_VERTICES_MAX);
        let vertices =
            vertices.ok_or_else(|| format!("has {count} vertices, more than {DOCUMENT_VERTICES_MAX}"))?;
        let Some(index) = source.indices else {
            return Ok((0..vertices).collect());
        };
        let of = |what: String| format!("indices: {what}");
        let indices = Accessor::open(self.root, self.buffers, index.value()).map_err(of)?;
        if !indices.is_index() {
            return Err(of("are not single unsigned integers".to_owned()));
        }
        if indices.count() as u64 > 3 * DOCUMENT_TRIANGLES_MAX {
            return Err(of(format!("{} of them, more than {}", indices.count(), 3 * DOCUMENT_TRIANGLES_MAX)));
        }
        let read = |i: usize| match indices.index(i) {
            index if index < vertices => Ok(index),
            index => Err(of(format!("number {i} is {index}, but there are {vertices} vertices"))),
        };
        (0..indices.count()).map(read).collect()
    }
}

/// Where corners are fewer than vertices (files that share one large vertex list among many primitives): renumbers the corners
/// and gives the vertices to keep, ascending. It bounds the work by the corners.
fn compact(corners: &mut [u32], count: usize) -> Option<Vec<u32>> {
    if corners.len() >= count {
        return None;
    }
    let mut keep = corners.to_vec();
    keep.sort_unstable();
    keep.dedup();
    for corner in corners {
        // Every corner is among those kept; at most 2^27 of them.
        *corner = keep.partition_point(|vertex| vertex < corner) as u32;
    }
    Some(keep)
}

/// Triangles of a list, strip or fan (glTF 2.0, section 3.7.2.1).
fn assemble(corners: &[u32], mode: Mode) -> Result<Vec<[u32; 3]>, String> {
    let needs_none = corners.is_empty();
    if !needs_none && corners.len() < 3 {
        return Err(format!("has {} corners, too few for a triangle", corners.len()));
    }
    Ok(match mode {
        Mode::TriangleStrip => {
            // Every second triangle of a strip is turned, so that all face the same side.
            let turned =
                |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            corners.windows(3).enumerate().map(turned).collect()
        }
        Mode::TriangleFan => match corners {
            [first, rest @ ..] => rest.windows(2).map(|w| [w[0], w[1], *first]).collect(),
            [] => Vec::new(),
        },
        _ => {
            let (triangles, rest) = corners.as_chunks::<3>();
            if !rest.is_empty() {
                return Err(format!("has {} corners, which is not a multiple of 3", corners.len()));
            }
            triangles.to_vec()
        }
    })
}

/// A linear colour and alpha as sRGB codes and linear alpha; outside [0, 1] is clamped, NaN is 0.
fn color_code(color: [f32; 4]) -> [u8; 4] {
    let [r, g, b] = [color[0], color[1], color[2]].map(srgb_code);
    [r, g, b, code(f64::from(color[3]))]
}

/// The sRGB code nearest to a linear value: the number of thresholds, halfway between codes, that it reaches.
fn srgb_code(linear: f32) -> u8 {
    /// Linear values of the codes 0.5, 1.5, ... 254.5 (IEC 61966-2-1).
    static THRESHOLDS: LazyLock<[f32; 255]> =
        LazyLock::new(|| std::array::from_fn(|code| linear_from_srgb((code as f64 + 0.5) / 255.0) as f32));
    THRESHOLDS.partition_point(|&threshold| threshold <= linear) as u8
}
