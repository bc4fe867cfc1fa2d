//! Wavefront OBJ with MTL materials (see [`mtl`] for how those become metal/roughness surfaces).
//!
//! Read here by hand: an error names its line, coordinates are kept in f64, and a damaged file neither panics nor reserves more
//! than it holds.
//!
//! | statement | becomes |
//! |---|---|
//! | `v x y z [w] [r g b]` | position; colour in [0, 1], sRGB-coded; a weight `w` is left out |
//! | `vt u [v]` | texture coordinate; v is turned: OBJ counts from below |
//! | `vn x y z` | normal |
//! | `f a/b/c ...` | a fan around the first corner: exact for convex polygons, for concave ones the usual convention |
//! | `o`, `g` | a mesh and a node, in file order; within it one part a material |
//! | `usemtl`, `mtllib` | materials; a material that no library has is light grey; a library that is missing is warned of and counted |
//! | `l`, `p` | left out and counted |
//!
//! Indices count from 1, negative ones back from the last element so far. Smoothing groups are left out: without `vn` a face is
//! flat. All surfaces are double-sided.

mod mtl;

#[cfg(test)]
mod tests;

use super::limits::{DOCUMENT_TRIANGLES_MAX, DOCUMENT_VERTICES_MAX, OBJ_PARTS_MAX, POLYGON_CORNERS_MAX};
use super::report::{Report, clean, shown};
use super::resolve::{Resolver, read_source};
use super::texels::code;
use crate::{Material, Mesh, Node, Primitive, Scene, SceneError};
use glam::{DMat4, DVec3};
use std::collections::HashMap;
use std::path::Path;

/// Reads a `.obj` file and its material libraries.
pub(super) fn import(path: &Path) -> Result<Scene, SceneError> {
    let mut report = Report::new(path);
    let bytes = read_source(path)?;
    let mut libraries = mtl::Libraries::new(Resolver::new(path)?);
    let mut reader = Reader::default();
    for (number, line) in Lines::new(&bytes) {
        let mut words = line.split_whitespace();
        let Some(keyword) = words.next().filter(|word| !word.starts_with('#')) else { continue };
        if keyword == "mtllib" {
            libraries.load(after(&line, keyword), &mut report)?;
        } else {
            let place = |what| report.invalid(format!("line {number}: {what}"));
            reader.statement(keyword, words, &line).map_err(place)?;
        }
    }
    drop(bytes);

    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let mut scene = Scene { name, ..Scene::default() };
    reader.finish(&libraries, &mut scene, &mut report);
    (scene.materials, scene.images) = libraries.finish(scene.materials);
    report.finish(&mut scene);
    Ok(scene)
}

/// Logical lines with the number of their first line: a backslash at the end continues one.
struct Lines<'a> {
    rest: &'a [u8],
    number: u64,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), number: 1 }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (u64, std::borrow::Cow<'a, str>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let first = self.number;
        let mut joined: Option<Vec<u8>> = None;
        loop {
            let end = self.rest.iter().position(|&byte| byte == b'\n').unwrap_or(self.rest.len());
            let line = &self.rest[..end];
            self.rest = self.rest.get(end + 1..).unwrap_or_default();
            self.number += 1;
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            let (line, goes_on) = match line.strip_suffix(b"\\") {
                Some(line) if !self.rest.is_empty() => (line, true),
                _ => (line, false),
            };
            match (&mut joined, goes_on) {
                (None, false) => return Some((first, String::from_utf8_lossy(line))),
                (None, true) => joined = Some([line, b" "].concat()),
                (Some(text), _) => {
                    text.extend_from_slice(line);
                    text.push(b' ');
                }
            }
            if let (Some(text), false) = (&joined, goes_on) {
                return Some((first, String::from_utf8_lossy(text).into_owned().into()));
            }
        }
    }
}

/// What follows the keyword on its line: names may contain spaces.
fn after<'a>(line: &'a str, keyword: &str) -> &'a str {
    line.trim_start().get(keyword.len()..).unwrap_or_default().trim()
}

/// A corner: places of position, texture coordinate and normal; [`NONE`] where it has none.
type Corner = [u32; 3];

/// No texture coordinate, no normal.
const NONE: u32 = u32::MAX;

/// The part of a group that has one material.
#[derive(Default)]
struct Part {
    /// Place in `Reader::material_names`; 0 is 'none yet'.
    material: usize,
    /// The distinct corners, in order of use, and where each is.
    corners: Vec<Corner>,
    places: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

#[derive(Default)]
struct Group {
    name: String,
    parts: Vec<Part>,
    /// Index into `parts` by material.
    by_material: HashMap<usize, usize>,
}

#[derive(Default)]
struct Reader {
    positions: Vec<DVec3>,
    /// As long as `positions`, or empty while no vertex had a colour.
    colors: Vec<[u8; 4]>,
    uvs: Vec<[f64; 2]>,
    normals: Vec<[f32; 3]>,
    groups: Vec<Group>,
    /// Names that `usemtl` gave; a material is 1 + its place here, 0 before the first `usemtl`.
    material_names: Vec<String>,
    material_places: HashMap<String, usize>,
    material: usize,
    vertices: u64,
    triangles: u64,
    /// Groups, parts and material names.
    parts: usize,
    points_and_lines: u64,
    too_small: u64,
    unknown: Vec<String>,
}

impl Reader {
    fn statement<'a>(
        &mut self,
        keyword: &str,
        words: impl Iterator<Item = &'a str>,
        line: &str,
    ) -> Result<(), String> {
        match keyword {
            "v" => self.vertex(words)?,
            "vt" => {
                let (values, count) = numbers::<3>(words)?;
                if count == 0 {
                    return Err("'vt' needs a number".to_owned());
                }
                check_room(self.uvs.len())?;
                self.uvs.push([values[0], values[1]]);
            }
            "vn" => match numbers::<3>(words)? {
                (values, 3) => {
                    check_room(self.normals.len())?;
                    self.normals.push(values.map(|value| value as f32));
                }
                _ => return Err("'vn' needs three numbers".to_owned()),
            },
            "f" | "fo" => self.face(words)?,
            "l" | "p" => self.points_and_lines += 1,
            "o" | "g" => {
                self.count_part()?;
                self.groups.push(Group { name: clean(after(line, keyword)), ..Group::default() });
            }
            "usemtl" => {
                let name = after(line, keyword);
                self.material = match self.material_places.get(name) {
                    Some(&place) => place,
                    None => {
                        self.count_part()?;
                        self.material_names.push(name.to_owned());
                        self.material_places.insert(name.to_owned(), self.material_names.len());
                        self.material_names.len()
                    }
                };
            }
            // Smoothing and merging groups, level of detail, display attributes: no surface depends on them here.
            "s" | "mg" | "lod" | "usemap" | "maplib" | "bevel" | "c_interp" | "d_interp" | "shadow_obj"
            | "trace_obj" => {}
            _ if self.unknown.iter().all(|known| known != keyword) && self.unknown.len() < 20 => {
                self.unknown.push(keyword.to_owned());
            }
            _ => {}
        }
        Ok(())
    }

    /// Before a group or a material name is added.
    fn count_part(&mut self) -> Result<(), String> {
        self.parts += 1;
        check_parts(self.parts)
    }

    fn vertex<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let (v, count) = numbers::<7>(words)?;
        if count < 3 {
            return Err("'v' needs three numbers".to_owned());
        }
        // Six numbers: position and colour; seven: with a weight between them.
        let color = match count {
            6 => Some([v[3], v[4], v[5]]),
            7 => Some([v[4], v[5], v[6]]),
            _ => None,
        };
        if color.is_some() && self.colors.is_empty() {
            self.colors.resize(self.positions.len(), [255; 4]);
        }
        check_room(self.positions.len())?;
        self.positions.push(DVec3::new(v[0], v[1], v[2]));
        if color.is_some() || !self.colors.is_empty() {
            let [r, g, b] = color.map_or([255; 3], |color| color.map(code));
            self.colors.push([r, g, b, 255]);
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Result<(), String> {
        if self.groups.is_empty() {
            self.groups.push(Group::default());
        }
        let lengths = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let material = self.material;
        let Some(group) = self.groups.last_mut() else { return Ok(()) };
        let part = *group.by_material.entry(material).or_insert(group.parts.len());
        if part == group.parts.len() {
            self.parts += 1;
            group.parts.push(Part { material, ..Part::default() });
        }
        let part = &mut group.parts[part];
        let corners_before = part.corners.len();
        let (mut first, mut previous, mut count) = (0, 0, 0_usize);
        for word in words {
            let corner = corner(word, lengths)?;
            // Below 2^27 by the limit below.
            let next = part.corners.len() as u32;
            let place = *part.places.entry(corner).or_insert(next);
            if place == next {
                part.corners.push(corner);
            }
            match count {
                0 => first = place,
                1 => {}
                _ => {
                    part.triangles.push([first, previous, place]);
                    self.triangles += 1;
                }
            }
            previous = place;
            count += 1;
            if count > POLYGON_CORNERS_MAX {
                return Err(format!("a face of more than {POLYGON_CORNERS_MAX} corners"));
            }
        }
        self.too_small += u64::from(count < 3);
        check_parts(self.parts)?;
        self.vertices += (part.corners.len() - corners_before) as u64;
        if self.vertices > DOCUMENT_VERTICES_MAX || self.triangles > DOCUMENT_TRIANGLES_MAX {
            return Err(format!(
                "more than {DOCUMENT_VERTICES_MAX} vertices or {DOCUMENT_TRIANGLES_MAX} triangles"
            ));
        }
        Ok(())
    }

    /// Turns groups into meshes and nodes. `scene.materials` receives the grey material if anything needs it.
    fn finish(self, libraries: &mtl::Libraries, scene: &mut Scene, report: &mut Report) {
        report.drop("points and lines", self.points_and_lines);
        report.drop("faces with fewer than three corners", self.too_small);
        for keyword in &self.unknown {
            report.warn(format!("statements '{}' are not read", shown(keyword)));
        }
        let grey = libraries.count();
        let found: Vec<Option<usize>> = self.material_names.iter().map(|name| libraries.find(name)).collect();
        for (name, _) in self.material_names.iter().zip(&found).filter(|(_, found)| found.is_none()) {
            report.warn(format!("no material library has \"{}\"; what uses it is light grey", shown(name)));
        }
        for group in &self.groups {
            let primitives: Vec<Primitive> = (group.parts.iter().filter(|part| !part.triangles.is_empty()))
                .map(|part| {
                    let material = part.material.checked_sub(1).and_then(|name| found[name]).unwrap_or(grey);
                    self.primitive(part, material, libraries.uv_transform(material))
                })
                .collect();
            if primitives.is_empty() {
                continue;
            }
            if primitives.iter().any(|primitive| primitive.material == grey) && scene.materials.is_empty() {
                let base_color = [0.8, 0.8, 0.8, 1.0];
                scene.materials.push(Material {
                    name: "default".to_owned(),
                    base_color,
                    ..Material::default()
                });
            }
            let place = scene.nodes.len();
            scene.roots.push(place);
            scene.nodes.push(Node {
                name: group.name.clone(),
                transform: DMat4::IDENTITY,
                mesh: Some(place),
                children: Vec::new(),
            });
            scene.meshes.push(Mesh { name: group.name.clone(), primitives });
        }
    }

    fn primitive(&self, part: &Part, material: usize, uv_transform: mtl::UvTransform) -> Primitive {
        let corners = &part.corners;
        let has = |lane: usize| corners.iter().any(|corner| corner[lane] != NONE);
        let normal = |corner: &Corner| self.normals.get(corner[2] as usize).copied().unwrap_or_default();
        let uv = |corner: &Corner| {
            uv_transform.apply(self.uvs.get(corner[1] as usize).copied().unwrap_or_default())
        };
        let color = |corner: &Corner| self.colors[corner[0] as usize];
        Primitive {
            positions: corners.iter().map(|corner| self.positions[corner[0] as usize]).collect(),
            normals: if has(2) { corners.iter().map(normal).collect() } else { Vec::new() },
            uvs: if has(1) { corners.iter().map(uv).collect() } else { Vec::new() },
            colors: if self.colors.is_empty() { Vec::new() } else { corners.iter().map(color).collect() },
            triangles: part.triangles.clone(),
            material,
        }
    }
}

/// Whether a list of positions, texture coordinates or normals may grow: it is held whether faces use it or not.
fn check_room(length: usize) -> Result<(), String> {
    match (length as u64) < DOCUMENT_VERTICES_MAX {
        true => Ok(()),
        false => Err(format!("more than {DOCUMENT_VERTICES_MAX} positions, texture coordinates or normals")),
    }
}

fn check_parts(parts: usize) -> Result<(), String> {
    match parts <= OBJ_PARTS_MAX {
        true => Ok(()),
        false => Err(format!("more than {OBJ_PARTS_MAX} groups, materials and parts; merge some")),
    }
}

/// `v`, `v/vt`, `v//vn` or `v/vt/vn`, each index checked against what has been read so far.
fn corner(word: &str, lengths: [usize; 3]) -> Result<Corner, String> {
    let mut corner = [NONE; 3];
    let mut fields = 0;
    for (field, text) in word.split('/').enumerate() {
        fields = field + 1;
        if (field == 1 || field == 2) && text.is_empty() {
            continue;
        }
        let fault = || format!("\"{}\" is not a corner of a face", shown(word));
        let (slot, &length) = corner.get_mut(field).zip(lengths.get(field)).ok_or_else(fault)?;
        let index: i64 = text.parse().map_err(|_| fault())?;
        let place = match index {
            1.. => index - 1,
            // i64::MIN has no absolute value, and is far out of range.
            ..=-1 => (length as i64).checked_add(index).unwrap_or(-1),
            0 => -1,
        };
        let inside = u32::try_from(place).ok().filter(|&place| (place as usize) < length && place != NONE);
        let kind = ["position", "texture coordinate", "normal"][field];
        *slot =
            inside.ok_or_else(|| format!("{kind} {index} does not exist; {length} are defined so far"))?;
    }
    if fields == 0 || corner[0] == NONE {
        return Err(format!("\"{}\" names no position", shown(word)));
    }
    Ok(corner)
}

/// Up to `N` numbers, and how many there were.
fn numbers<'a, const N: usize>(words: impl Iterator<Item = &'a str>) -> Result<([f64; N], usize), String> {
    let mut values = [0.0; N];
    let mut count = 0;
    for (value, word) in values.iter_mut().zip(words) {
        *value = word.parse().map_err(|_| format!("\"{}\" is not a number", shown(word)))?;
        count += 1;
    }
    Ok((values, count))
}
