//! PLY: ascii, binary little endian and binary big endian (G. Turk, "The PLY Polygon File Format", 1994).
//!
//! Read here by hand: a header may claim any count, so every count is held against the bytes that follow before memory is
//! reserved, and vertices go straight into their arrays.
//!
//! | element | property | becomes |
//! |---|---|---|
//! | `vertex` | `x y z` | position |
//! | | `nx ny nz` | normal |
//! | | `s t`, `u v`, `texture_u texture_v`, `texture_s texture_t` | texture coordinate; v is turned: PLY counts from below |
//! | | `red green blue [alpha]` (also `r g b a`, `diffuse_red` ...) | sRGB-coded colour; floats are in [0, 1] |
//! | `face` | list `vertex_indices` or `vertex_index` | a fan around its first corner (exact for convex polygons) |
//!
//! All else is skipped. The surface is a rough, double-sided, light grey one, white under vertex colours.

use super::limits::{DOCUMENT_TRIANGLES_MAX, DOCUMENT_VERTICES_MAX, POLYGON_CORNERS_MAX};
use super::report::{Report, shown};
use super::resolve::read_source;
use super::texels::code;
use crate::{Material, Mesh, Node, Primitive, Scene, SceneError};
use glam::{DMat4, DVec3};
use std::path::Path;

/// Reads a `.ply` file.
pub(super) fn import(path: &Path) -> Result<Scene, SceneError> {
    let bytes = read_source(path)?;
    let mut report = Report::new(path);
    let header = Header::parse(&bytes).map_err(|what| report.invalid(what))?;
    let primitive = read_body(&bytes, &header, &mut report).map_err(|what| report.invalid(what))?;
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let grey = if primitive.colors.is_empty() { 0.8 } else { 1.0 };
    let mut scene = Scene {
        name: name.clone(),
        materials: vec![Material {
            name: "ply".to_owned(),
            base_color: [grey, grey, grey, 1.0],
            ..Material::default()
        }],
        meshes: vec![Mesh { name: name.clone(), primitives: vec![primitive] }],
        nodes: vec![Node { name, transform: DMat4::IDENTITY, mesh: Some(0), children: Vec::new() }],
        roots: vec![0],
        ..Scene::default()
    };
    report.finish(&mut scene);
    Ok(scene)
}

/// Bytes of a header, and properties in it: far beyond any real one.
const HEADER_BYTES_MAX: usize = 64 << 10;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Clone, Debug)]
struct Property {
    name: String,
    /// The type of a list's length; `None` for a single number.
    length: Option<Number>,
    number: Number,
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes that one of these can take.
    fn bytes_min(&self, encoding: Encoding) -> u64 {
        let of = |property: &Property| match encoding {
            // A digit and a separator; the file's last separator may be missing.
            Encoding::Ascii => 2,
            _ => property.length.unwrap_or(property.number).size() as u64,
        };
        self.properties.iter().map(of).sum()
    }
}

#[derive(Clone, Debug)]
struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
    /// Where the body begins.
    bytes: usize,
    /// Lines of the header, for messages about an ascii body.
    lines: u64,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let head = &bytes[..bytes.len().min(HEADER_BYTES_MAX)];
        // Files of old Macintoshes end lines with a lone carriage return.
        let line_end: &[u8] = match head.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            Some(at) if head[at..].starts_with(b"\r\n") => b"\r\n",
            Some(at) => &head[at..=at],
            None => return Err("is not a PLY file: its first line must be 'ply'".to_owned()),
        };
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut at = 0;
        for line_number in 1.. {
            let Some(length) = head[at..].windows(line_end.len()).position(|window| window == line_end)
            else {
                return Err("has no 'end_header' line; the file is truncated or not a PLY file".to_owned());
            };
            let line = std::str::from_utf8(&head[at..at + length]).unwrap_or("comment not in UTF-8").trim();
            at += length + line_end.len();
            let fault = |what: &str| Err(format!("line {line_number}: {what}: \"{}\"", shown(line)));
            let words: Vec<&str> = line.split_whitespace().collect();
            match *words.as_slice() {
                ["ply"] if line_number == 1 => {}
                _ if line_number == 1 => {
                    return Err("is not a PLY file: its first line must be 'ply'".to_owned());
                }
                ["format", form, _] => {
                    encoding = Some(match form {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        _ => return fault("unknown format"),
                    });
                }
                ["element", name, count] => match count.parse() {
                    Ok(count) => {
                        elements.push(Element { name: name.to_owned(), count, properties: Vec::new() })
                    }
                    Err(_) => return fault("the count is not a number"),
                },
                ["property", ref rest @ ..] => {
                    let Some(element) = elements.last_mut() else {
                        return fault("a property before any element");
                    };
                    let property = match *rest {
                        ["list", length, number, name] => Number::parse(length)
                            .filter(|length| !matches!(length, Number::F32 | Number::F64))
                            .zip(Number::parse(number))
                            .map(|(length, number)| Property {
                                name: name.to_owned(),
                                length: Some(length),
                                number,
                            }),
                        [number, name] => Number::parse(number).map(|number| Property {
                            name: name.to_owned(),
                            length: None,
                            number,
                        }),
                        _ => None,
                    };
                    match property {
                        Some(property) => element.properties.push(property),
                        None => return fault("unknown property type"),
                    }
                }
                ["end_header"] => {
                    let encoding = encoding.ok_or("has no 'format' line in its header")?;
                    return Ok(Self { encoding, elements, bytes: at, lines: line_number });
                }
                ["comment" | "obj_info", ..] | [] => {}
                _ => return fault("unknown header line"),
            }
        }
        Err("has a header without end".to_owned())
    }
}

/// Reads numbers one after the other.
struct Body<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
    /// Line of the file, for ascii bodies.
    line: u64,
}

impl Body<'_> {
    fn number(&mut self, kind: Number) -> Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            return self.word();
        }
        let Some((raw, rest)) = self.bytes.split_at_checked(kind.size()) else {
            return Err("the file is truncated".to_owned());
        };
        self.bytes = rest;
        let mut little = [0; 8];
        little[..raw.len()].copy_from_slice(raw);
        if self.encoding == Encoding::Big {
            little[..raw.len()].reverse();
        }
        let [a, b, c, d, ..] = little;
        Ok(match kind {
            Number::I8 => f64::from(a.cast_signed()),
            Number::U8 => f64::from(a),
            Number::I16 => f64::from(i16::from_le_bytes([a, b])),
            Number::U16 => f64::from(u16::from_le_bytes([a, b])),
            Number::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Number::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Number::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Number::F64 => f64::from_le_bytes(little),
        })
    }

    /// The next word of an ascii body as a number.
    fn word(&mut self) -> Result<f64, String> {
        let start =
            self.bytes.iter().position(|byte| !byte.is_ascii_whitespace()).unwrap_or(self.bytes.len());
        self.line += self.bytes[..start].iter().filter(|&&byte| byte == b'\n').count() as u64;
        let rest = &self.bytes[start..];
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(length);
        self.bytes = rest;
        if word.is_empty() {
            return Err(format!("line {}: the file is truncated", self.line));
        }
        let text = String::from_utf8_lossy(word);
        text.parse().map_err(|_| format!("line {}: \"{}\" is not a number", self.line, shown(&text)))
    }

    /// The length of a list; what it promises must be there.
    fn length(&mut self, kind: Number, number: Number) -> Result<usize, String> {
        let length = self.number(kind)?;
        let size = if self.encoding == Encoding::Ascii { 2 } else { number.size() };
        let fits = length >= 0.0 && length * size as f64 <= self.bytes.len() as f64 + 1.0;
        if !fits || libm::floor(length) != length {
            return Err(format!(
                "a list of {length} numbers does not fit the file; it is truncated or damaged"
            ));
        }
        Ok(length as usize)
    }

    /// Passes over one property.
    fn skip(&mut self, property: &Property) -> Result<(), String> {
        let count = match property.length {
            Some(length) => self.length(length, property.number)?,
            None => 1,
        };
        (0..count).try_for_each(|_| self.number(property.number).map(|_| ()))
    }
}

fn read_body(bytes: &[u8], header: &Header, report: &mut Report) -> Result<Primitive, String> {
    let mut primitive = Primitive::default();
    let vertices =
        header.elements.iter().find(|element| element.name == "vertex").map_or(0, |element| element.count);
    if vertices > DOCUMENT_VERTICES_MAX {
        return Err(format!(
            "claims {vertices} vertices, more than the {DOCUMENT_VERTICES_MAX} that are allowed"
        ));
    }
    let mut body = Body { bytes: &bytes[header.bytes..], encoding: header.encoding, line: header.lines + 1 };
    for (index, element) in header.elements.iter().enumerate() {
        let bytes_min = element.bytes_min(header.encoding);
        // Without properties there is nothing to read, however many there are. Of vertices and faces that is a fault: triangles
        // count on the vertices that the header claims.
        if bytes_min == 0 && !matches!(element.name.as_str(), "vertex" | "face") {
            continue;
        }
        if element.count.checked_mul(bytes_min).is_none_or(|need| need > body.bytes.len() as u64 + 1) {
            return Err(format!(
                "claims {} elements '{}' of at least {bytes_min} bytes, but only {} bytes follow; the file is truncated",
                element.count,
                shown(&element.name),
                body.bytes.len()
            ));
        }
        let is_first = header.elements[..index].iter().all(|earlier| earlier.name != element.name);
        match element.name.as_str() {
            "vertex" if is_first => read_vertices(&mut body, element, &mut primitive)?,
            "face" if is_first => read_faces(&mut body, element, vertices, &mut primitive, report)?,
            name => {
                report.warn(format!("the elements '{}' are not read", shown(name)));
                for row in 0..element.count {
                    for property in &element.properties {
                        body.skip(property).map_err(|what| format!("{} {row}: {what}", shown(name)))?;
                    }
                }
            }
        }
    }
    Ok(primitive)
}

/// Places of the numbers that are kept of a vertex.
const POSITION: usize = 0;
const NORMAL: usize = 3;
const UV: usize = 6;
const COLOR: usize = 8;
const ALPHA: usize = 11;
const PLACES: usize = 12;

fn place(property: &Property) -> Option<usize> {
    let at = match property.name.as_str() {
        "x" => POSITION,
        "y" => POSITION + 1,
        "z" => POSITION + 2,
        "nx" => NORMAL,
        "ny" => NORMAL + 1,
        "nz" => NORMAL + 2,
        "s" | "u" | "texture_u" | "texture_s" => UV,
        "t" | "v" | "texture_v" | "texture_t" => UV + 1,
        "red" | "r" | "diffuse_red" => COLOR,
        "green" | "g" | "diffuse_green" => COLOR + 1,
        "blue" | "b" | "diffuse_blue" => COLOR + 2,
        "alpha" | "a" => ALPHA,
        _ => return None,
    };
    property.length.is_none().then_some(at)
}

fn read_vertices(body: &mut Body<'_>, element: &Element, primitive: &mut Primitive) -> Result<(), String> {
    let places: Vec<Option<usize>> = element.properties.iter().map(place).collect();
    let has = |range: std::ops::Range<usize>| range.clone().all(|at| places.contains(&Some(at)));
    if !has(POSITION..POSITION + 3) {
        return Err("the vertices have no x, y and z".to_owned());
    }
    let (normals, uvs, colors) = (has(NORMAL..NORMAL + 3), has(UV..UV + 2), has(COLOR..COLOR + 3));
    // The caller has held the count against the file's length and the limit.
    let count = element.count as usize;
    primitive.positions.reserve_exact(count);
    primitive.normals.reserve_exact(if normals { count } else { 0 });
    primitive.uvs.reserve_exact(if uvs { count } else { 0 });
    primitive.colors.reserve_exact(if colors { count } else { 0 });
    let kind =
        |at| places.iter().position(|place| *place == Some(at)).map(|found| element.properties[found].number);
    let kinds = [0, 1, 2, 3].map(|lane| kind(COLOR + lane).unwrap_or(Number::U8));
    let mut value = [0.0; PLACES];
    // Opaque where the file has no alpha.
    value[ALPHA] = 255.0;
    for vertex in 0..count {
        for (property, place) in element.properties.iter().zip(&places) {
            let result = match *place {
                Some(at) => body.number(property.number).map(|number| value[at] = number),
                None => body.skip(property),
            };
            result.map_err(|what| format!("vertex {vertex}: {what}"))?;
        }
        primitive.positions.push(DVec3::new(value[POSITION], value[POSITION + 1], value[POSITION + 2]));
        if normals {
            primitive.normals.push([
                value[NORMAL] as f32,
                value[NORMAL + 1] as f32,
                value[NORMAL + 2] as f32,
            ]);
        }
        if uvs {
            primitive.uvs.push([value[UV] as f32, (1.0 - value[UV + 1]) as f32]);
        }
        if colors {
            primitive.colors.push([0, 1, 2, 3].map(|lane| color_code(value[COLOR + lane], kinds[lane])));
        }
    }
    Ok(())
}

/// A colour component as an 8-bit code: floats are in [0, 1], 16-bit numbers in [0, 65535], others are codes already.
fn color_code(value: f64, kind: Number) -> u8 {
    code(match kind {
        Number::F32 | Number::F64 => value,
        Number::I16 | Number::U16 => value / 65_535.0,
        _ => value / 255.0,
    })
}

fn read_faces(
    body: &mut Body<'_>,
    element: &Element,
    vertices: u64,
    primitive: &mut Primitive,
    report: &mut Report,
) -> Result<(), String> {
    let is_corners = |property: &Property| {
        property.length.is_some() && matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
    };
    if !element.properties.iter().any(is_corners) {
        return Err("the faces have no list 'vertex_indices'".to_owned());
    }
    if element.properties.iter().any(|property| property.name == "texcoord") {
        report.warn("texture coordinates of face corners ('texcoord') are not read");
    }
    // As many triangles as faces if all are triangles; the caller has held the count against the file's length.
    primitive.triangles.reserve(element.count.min(DOCUMENT_TRIANGLES_MAX) as usize);
    let mut too_small = 0;
    for face in 0..element.count {
        for property in &element.properties {
            let result = match property.length {
                Some(length) if is_corners(property) => {
                    read_fan(body, length, property.number, vertices, &mut primitive.triangles)
                        .map(|is_polygon| too_small += u64::from(!is_polygon))
                }
                _ => body.skip(property),
            };
            result.map_err(|what| format!("face {face}: {what}"))?;
        }
        if primitive.triangles.len() as u64 > DOCUMENT_TRIANGLES_MAX {
            return Err(format!("face {face}: more than {DOCUMENT_TRIANGLES_MAX} triangles"));
        }
    }
    report.drop("faces with fewer than three corners", too_small);
    Ok(())
}

/// Reads one polygon as a fan; `false` when it has fewer than three corners.
fn read_fan(
    body: &mut Body<'_>,
    length: Number,
    number: Number,
    vertices: u64,
    triangles: &mut Vec<[u32; 3]>,
) -> Result<bool, String> {
    let corners = body.length(length, number)?;
    if corners > POLYGON_CORNERS_MAX {
        return Err(format!("{corners} corners, more than the {POLYGON_CORNERS_MAX} that are allowed"));
    }
    let mut first = 0;
    let mut previous = 0;
    for corner in 0..corners {
        let index = body.number(number)?;
        if !(index >= 0.0 && index < vertices as f64) || libm::floor(index) != index {
            return Err(format!("vertex index {index}, but there are {vertices} vertices"));
        }
        let index = index as u32;
        match corner {
            0 => first = index,
            1 => {}
            _ => triangles.push([first, previous, index]),
        }
        previous = index;
    }
    Ok(corners >= 3)
}

#[cfg(test)]
mod tests;
