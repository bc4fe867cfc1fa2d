//! MTL material libraries.
//!
//! MTL describes Phong surfaces with illumination models; here they become metal/roughness surfaces. Colours are taken as
//! linear.
//!
//! | MTL | here |
//! |---|---|
//! | `Kd` (1 with a `map_Kd`, else 0.8 when absent) | base colour |
//! | `Ns` | roughness `(2 / (Ns + 2))^(1/4)`: the exponent of a Blinn-Phong lobe as wide as a microfacet lobe with `alpha^2 = 2 / (Ns + 2)`, `alpha = roughness^2` (Walter et al. 2007); 1 when absent |
//! | `Ks` | specular reflectance at normal incidence; 0 when absent, or under `illum` 0 and 1 |
//! | `illum` 3, 5, 8 | mirror: roughness 0 |
//! | `illum` 4, 6, 7, 9 | glass: roughness 0, `ior = Ni`, specular `((Ni - 1) / (Ni + 1))^2`, transmission `1 - d`, or 1 when `d` is 1 and `Tf` or `Ni` is given (a mirror if neither is); the base goes from `Kd` to `Tf` with the transmission |
//! | `d`, `Tr` (`d = 1 - Tr`) below 1, else | alpha, blended |
//! | `Ke`, `map_Ke` | emission (1 with a map, 0 without, when absent) |
//! | `map_Kd` | base texture; cut out at alpha 1/2 when it has any transparent texel |
//! | `map_d` | its alpha, or its brightness when it has none, becomes the base texture's alpha, cut out at 1/2 |
//! | `-clamp on`, `-s u v`, `-o u v` | clamping; texture coordinates `uv * s + o` |
//!
//! Other maps and options are left out with a warning, and so is a map whose image is missing: the surface is as if the map had
//! not been stated. A reference that leads out of the folder is an error all the same.

use super::{Lines, after};
use crate::import::limits::IMAGE_BYTES_MAX;
use crate::import::report::{Report, clean, shown};
use crate::import::resolve::{Resolver, Syntax};
use crate::import::texels::TexelReader;
use crate::{AlphaMode, Image, Material, SceneError, TextureRef, Wrap};
use std::collections::HashMap;

/// Bytes of a material library.
const LIBRARY_BYTES_MAX: u64 = 64 << 20;

/// `uv * scale + offset`, and v turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvTransform {
    scale: [f64; 2],
    offset: [f64; 2],
}

impl Default for UvTransform {
    fn default() -> Self {
        Self { scale: [1.0; 2], offset: [0.0; 2] }
    }
}

impl UvTransform {
    /// Coordinates of the file to those of the document, (0, 0) upper left.
    pub(super) fn apply(&self, uv: [f64; 2]) -> [f32; 2] {
        let [u, v] = [0, 1].map(|axis| uv[axis] * self.scale[axis] + self.offset[axis]);
        [u as f32, (1.0 - v) as f32]
    }
}

/// The materials of all libraries of a file.
pub(super) struct Libraries {
    resolver: Resolver,
    texels: TexelReader,
    materials: Vec<(Material, UvTransform)>,
    by_name: HashMap<String, usize>,
    images: Vec<Image>,
    /// Places in `images` by the paths of colour and opacity.
    by_path: HashMap<(String, String), usize>,
}

impl Libraries {
    pub(super) fn new(resolver: Resolver) -> Self {
        Self {
            resolver,
            texels: TexelReader::new(),
            materials: Vec::new(),
            by_name: HashMap::new(),
            images: Vec::new(),
            by_path: HashMap::new(),
        }
    }

    /// How many materials there are.
    pub(super) fn count(&self) -> usize {
        self.materials.len()
    }

    /// The material called `name`.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    /// What a material does to texture coordinates.
    pub(super) fn uv_transform(&self, material: usize) -> UvTransform {
        self.materials.get(material).map_or(UvTransform::default(), |entry| entry.1)
    }

    /// All materials, then `more`, and the images.
    pub(super) fn finish(self, more: Vec<Material>) -> (Vec<Material>, Vec<Image>) {
        (self.materials.into_iter().map(|entry| entry.0).chain(more).collect(), self.images)
    }

    /// Loads what a `mtllib` statement names: one file, whose name may hold spaces, or several files.
    pub(super) fn load(&mut self, names: &str, report: &mut Report) -> Result<(), SceneError> {
        if names.contains(char::is_whitespace) && self.resolver.is_missing(names, Syntax::Path)? {
            names.split_whitespace().try_for_each(|name| self.load_one(name, report))
        } else {
            self.load_one(names, report)
        }
    }

    fn load_one(&mut self, name: &str, report: &mut Report) -> Result<(), SceneError> {
        if self.resolver.is_missing(name, Syntax::Path)? {
            report.warn(format!(
                "the material library \"{}\" is missing; what uses its materials is light grey",
                shown(name)
            ));
            report.drop("material libraries that are missing", 1);
            return Ok(());
        }
        let text = self.resolver.read(name, Syntax::Path, LIBRARY_BYTES_MAX)?;
        self.parse(name, &text, report)
    }

    fn parse(&mut self, library: &str, text: &[u8], report: &mut Report) -> Result<(), SceneError> {
        let mut drafts: Vec<(String, Draft)> = Vec::new();
        for (number, line) in Lines::new(text) {
            let mut words = line.split_whitespace();
            let Some(keyword) = words.next().filter(|word| !word.starts_with('#')) else { continue };
            let place = |what: String| report.invalid(format!("{}, line {number}: {what}", shown(library)));
            if keyword == "newmtl" {
                drafts.push((after(&line, keyword).to_owned(), Draft::default()));
                continue;
            }
            let Some((name, draft)) = drafts.last_mut() else {
                return Err(place(format!("'{}' stands before the first 'newmtl'", shown(keyword))));
            };
            match draft.statement(keyword, words, &line).map_err(place)? {
                Understood::Yes => {}
                Understood::No(what) => report.warn(format!("the material \"{}\": {what}", shown(name))),
            }
        }
        for (name, draft) in drafts {
            if self.by_name.contains_key(&name) {
                report.warn(format!("the material \"{}\" is defined twice; the first is used", shown(&name)));
                continue;
            }
            let entry = self.build(&name, draft, report)?;
            self.by_name.insert(name, self.materials.len());
            self.materials.push(entry);
        }
        Ok(())
    }

    fn build(
        &mut self,
        name: &str,
        mut draft: Draft,
        report: &mut Report,
    ) -> Result<(Material, UvTransform), SceneError> {
        for map in [&mut draft.map_kd, &mut draft.map_d, &mut draft.map_ke] {
            let Some(Map { path, .. }) = map else { continue };
            if self.resolver.is_missing(path, Syntax::Path)? {
                report.warn(format!(
                    "the material \"{}\": the image \"{}\" is missing; the surface is drawn without it",
                    shown(name),
                    shown(path)
                ));
                report.drop("material maps whose image is missing", 1);
                *map = None;
            }
        }
        let mut material = draft.surface();
        material.name = clean(name);
        let base = match (&draft.map_kd, &draft.map_d) {
            (None, None) => None,
            (color, opacity) => {
                let path = |map: &Option<Map>| map.as_ref().map_or(String::new(), |map| map.path.clone());
                let image = self.image(&path(color), &path(opacity), report)?;
                color.as_ref().or(opacity.as_ref()).map(|map| (map, image))
            }
        };
        let uv = [&draft.map_kd, &draft.map_d, &draft.map_ke].into_iter().flatten().next();
        let uv = uv.map_or(UvTransform::default(), |map| map.uv);
        if let Some((map, image)) = base {
            material.base_texture = Some(map.texture(image));
            if self.images[image].rgba.as_chunks::<4>().0.iter().any(|texel| texel[3] != 255) {
                material.alpha = AlphaMode::Mask(0.5);
            }
        }
        for map in [&draft.map_d, &draft.map_ke].into_iter().flatten().filter(|map| map.uv != uv) {
            report.warn(format!(
                "the material \"{}\" scales or shifts \"{}\" unlike its map_Kd; the map_Kd decides",
                shown(name),
                shown(&map.path)
            ));
        }
        if let Some(map) = &draft.map_ke {
            let image = self.image(&map.path, "", report)?;
            material.emissive_texture = Some(map.texture(image));
        }
        Ok((material, uv))
    }

    /// The image of a colour file whose alpha is that of an opacity file; either may be "" (white, unchanged).
    fn image(&mut self, color: &str, opacity: &str, report: &Report) -> Result<usize, SceneError> {
        let key = (color.to_owned(), opacity.to_owned());
        if let Some(&place) = self.by_path.get(&key) {
            return Ok(place);
        }
        let image = match (color, opacity) {
            (color, "") => self.decode(color, report)?,
            ("", opacity) => {
                let opacity = self.decode(opacity, report)?;
                let white: Vec<u8> = opacity_of(&opacity).flat_map(|alpha| [255, 255, 255, alpha]).collect();
                Image { rgba: white.into(), ..opacity }
            }
            (color, opacity) => {
                let color = self.decode(color, report)?;
                let opacity = self.decode(opacity, report)?;
                with_opacity(&color, &opacity)
            }
        };
        self.by_path.insert(key, self.images.len());
        self.images.push(image);
        Ok(self.images.len() - 1)
    }

    fn decode(&mut self, path: &str, report: &Report) -> Result<Image, SceneError> {
        let bytes = self.resolver.read(path, Syntax::Path, IMAGE_BYTES_MAX)?;
        self.texels
            .decode(path, &bytes)
            .map_err(|what| report.invalid(format!("the image \"{}\" {what}", shown(path))))
    }
}

/// The opacity of every texel: alpha where the image has any, else brightness.
fn opacity_of(image: &Image) -> impl Iterator<Item = u8> {
    let texels = image.rgba.as_chunks::<4>().0;
    let has_alpha = texels.iter().any(|texel| texel[3] != 255);
    texels.iter().map(move |texel| match has_alpha {
        true => texel[3],
        false => (texel[..3].iter().map(|&code| u32::from(code)).sum::<u32>() / 3) as u8,
    })
}

/// `color` with the opacity of another image, which is scaled to its size by the nearest texel.
fn with_opacity(color: &Image, opacity: &Image) -> Image {
    let alpha: Vec<u8> = opacity_of(opacity).collect();
    let scaled = |at: u32, from: u32, to: u32| (u64::from(at) * u64::from(to) / u64::from(from)) as usize;
    let mut rgba = color.rgba.to_vec();
    for (place, texel) in rgba.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        let (x, y) = (place as u32 % color.width, place as u32 / color.width);
        let from = scaled(y, color.height, opacity.height) * opacity.width as usize
            + scaled(x, color.width, opacity.width);
        texel[3] = alpha[from];
    }
    Image { rgba: rgba.into(), ..color.clone() }
}

/// Whether a statement has an effect; if not, what to warn of.
enum Understood {
    Yes,
    No(String),
}

/// A material as its library states it.
#[derive(Default)]
struct Draft {
    kd: Option<[f32; 3]>,
    ks: Option<[f32; 3]>,
    ke: Option<[f32; 3]>,
    tf: Option<[f32; 3]>,
    ns: Option<f32>,
    ni: Option<f32>,
    d: Option<f32>,
    illum: Option<u32>,
    map_kd: Option<Map>,
    map_d: Option<Map>,
    map_ke: Option<Map>,
}

impl Draft {
    fn statement<'a>(
        &mut self,
        keyword: &str,
        words: impl Iterator<Item = &'a str> + Clone,
        line: &str,
    ) -> Result<Understood, String> {
        let lower = keyword.to_ascii_lowercase();
        match lower.as_str() {
            "kd" | "ks" | "ke" | "tf" => {
                if let Some(form) = words.clone().next().filter(|form| matches!(*form, "spectral" | "xyz")) {
                    return Ok(Understood::No(format!("{keyword} in the form '{form}' is not read")));
                }
                let color = Some(color(keyword, words)?);
                match lower.as_str() {
                    "kd" => self.kd = color,
                    "ks" => self.ks = color,
                    "ke" => self.ke = color,
                    _ => self.tf = color,
                }
            }
            "ns" => self.ns = Some(number(keyword, words)?),
            "ni" => self.ni = Some(number(keyword, words)?),
            // `d -halo 0.5` fades towards the silhouette; the number is kept.
            "d" => self.d = Some(number(keyword, words.filter(|word| *word != "-halo"))?.min(1.0)),
            "tr" => self.d = Some(1.0 - number(keyword, words)?.min(1.0)),
            "illum" => self.illum = Some(number(keyword, words)? as u32),
            "map_kd" | "map_d" | "map_ke" => {
                let (map, ignored) = Map::parse(after(line, keyword))?;
                match lower.as_str() {
                    "map_kd" => self.map_kd = Some(map),
                    "map_d" => self.map_d = Some(map),
                    _ => self.map_ke = Some(map),
                }
                if let Some(option) = ignored {
                    return Ok(Understood::No(format!(
                        "the option {} of {keyword} is not read",
                        shown(&option)
                    )));
                }
            }
            // Ambient light is a matter of the scene here; sharpness is one of reflection maps.
            "ka" | "map_ka" | "sharpness" | "map_aat" => {}
            _ => return Ok(Understood::No(format!("'{}' is not read", shown(keyword)))),
        }
        Ok(Understood::Yes)
    }

    /// The surface without its textures.
    fn surface(&self) -> Material {
        let d = self.d.unwrap_or(1.0);
        let kd =
            self.kd.unwrap_or(if self.map_kd.is_some() { [1.0; 3] } else { [0.8; 3] }).map(|c| c.min(1.0));
        let ks = self.ks.unwrap_or([0.0; 3]).map(|c| c.min(1.0));
        let ni = self.ni.filter(|ni| *ni >= 1.0);
        let illum = self.illum.unwrap_or(2);
        let is_glass = matches!(illum, 4 | 6 | 7 | 9);
        let transmission = match is_glass {
            true if d < 1.0 => 1.0 - d,
            true if self.tf.is_some() || ni.is_some_and(|ni| ni > 1.0) => 1.0,
            _ => 0.0,
        };
        let mut material = Material {
            base_color: [kd[0], kd[1], kd[2], 1.0],
            specular: if illum < 2 { [0.0; 3] } else { ks },
            roughness: libm::powf(2.0 / (self.ns.unwrap_or(0.0) + 2.0), 0.25),
            emissive: self.ke.unwrap_or(if self.map_ke.is_some() { [1.0; 3] } else { [0.0; 3] }),
            ..Material::default()
        };
        if is_glass || matches!(illum, 3 | 5 | 8) {
            material.roughness = 0.0;
        }
        if transmission > 0.0 {
            let tf = self.tf.unwrap_or([1.0; 3]).map(|c| c.min(1.0));
            for channel in 0..3 {
                material.base_color[channel] = kd[channel] + (tf[channel] - kd[channel]) * transmission;
            }
            material.transmission = transmission;
            if let Some(ni) = ni {
                material.ior = ni;
            }
            let f0 = (material.ior - 1.0) / (material.ior + 1.0);
            material.specular = [f0 * f0; 3];
        } else if d < 1.0 && !is_glass {
            material.base_color[3] = d;
            material.alpha = AlphaMode::Blend;
        }
        material
    }
}

/// A texture statement.
struct Map {
    path: String,
    clamp: bool,
    uv: UvTransform,
}

impl Map {
    /// Options, then a path that may hold spaces; also the last option that has no effect here.
    fn parse(text: &str) -> Result<(Self, Option<String>), String> {
        let mut map = Self { path: String::new(), clamp: false, uv: UvTransform::default() };
        let mut ignored = None;
        let mut rest = text;
        while rest.starts_with('-') {
            let (option, tail) = word(rest);
            rest = tail;
            let values_max = match option {
                "-s" | "-o" | "-t" => 3,
                "-mm" => 2,
                _ => 1,
            };
            let mut values = Vec::new();
            while values.len() < values_max {
                let (value, tail) = word(rest);
                // The second and third numbers of an option may be missing.
                if !values.is_empty() && value.parse::<f64>().is_err() {
                    break;
                }
                values.push(value);
                rest = tail;
            }
            match option {
                "-clamp" => map.clamp = values == ["on"],
                "-s" | "-o" => {
                    let target = if option == "-s" { &mut map.uv.scale } else { &mut map.uv.offset };
                    for (slot, value) in target.iter_mut().zip(values) {
                        *slot =
                            value.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
                                format!("the option {option} has the value \"{}\"", shown(value))
                            })?;
                    }
                }
                // How the file would be filtered or which of its equal channels is read.
                "-blendu" | "-blendv" | "-cc" | "-texres" | "-imfchan" => {}
                _ => ignored = Some(option.to_owned()),
            }
        }
        if rest.is_empty() {
            return Err("a map without a file name".to_owned());
        }
        map.path = rest.to_owned();
        Ok((map, ignored))
    }

    fn texture(&self, image: usize) -> TextureRef {
        let wrap = if self.clamp { Wrap::Clamp } else { Wrap::Repeat };
        TextureRef { image, wrap_s: wrap, wrap_t: wrap, nearest: false }
    }
}

/// The first word and what follows it.
fn word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

fn number<'a>(keyword: &str, mut words: impl Iterator<Item = &'a str>) -> Result<f32, String> {
    let word = words.next().unwrap_or_default();
    let value: Option<f32> = word.parse().ok();
    value
        .filter(|value| value.is_finite() && *value >= 0.0)
        .ok_or_else(|| format!("{keyword} needs a number from 0 on, not \"{}\"", shown(word)))
}

/// One number for all channels, or three.
fn color<'a>(keyword: &str, words: impl Iterator<Item = &'a str>) -> Result<[f32; 3], String> {
    let values: Vec<f32> =
        words.take(3).map(|word| number(keyword, std::iter::once(word))).collect::<Result<_, _>>()?;
    match *values.as_slice() {
        [grey] => Ok([grey; 3]),
        [r, g, b] => Ok([r, g, b]),
        _ => Err(format!("{keyword} needs one number or three")),
    }
}
