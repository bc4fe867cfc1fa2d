//! Materials and the images they use.

use super::accessor::{Buffers, view_bytes};
use super::json::{self, Root};
use super::{checked, get, name_or};
use crate::import::limits::IMAGE_BYTES_MAX;
use crate::import::report::{Report, shown};
use crate::import::resolve::{Resolver, Syntax};
use crate::import::texels::TexelReader;
use crate::{AlphaMode, Image, Material, SceneError, TextureRef, Wrap};

/// The texture coordinates that a material's textures share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSource {
    /// `TEXCOORD_n`.
    pub(super) set: u32,
    /// `KHR_texture_transform` as rows `[a, b, c]`: `u' = a u + b v + c`.
    rows: Option<[[f64; 3]; 2]>,
}

impl UvSource {
    /// The set and transform of a texture slot.
    fn of(info: &json::texture::Info) -> Result<Self, String> {
        let transform = info.extensions.as_ref().and_then(|all| all.texture_transform.as_ref());
        let Some(transform) = transform else {
            return Ok(Self { set: info.tex_coord, rows: None });
        };
        let [[offset_u, offset_v], [scale_u, scale_v]] =
            [transform.offset.0, transform.scale.0].map(|pair| pair.map(f64::from));
        let angle = f64::from(transform.rotation.0);
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        // Scale, then turn counter-clockwise as seen on the image (v points down), then shift.
        let rows = [[cos * scale_u, sin * scale_v, offset_u], [-sin * scale_u, cos * scale_v, offset_v]];
        if rows.as_flattened().iter().any(|value| !value.is_finite()) {
            return Err("has a KHR_texture_transform that is not finite".to_owned());
        }
        Ok(Self { set: transform.tex_coord.unwrap_or(info.tex_coord), rows: Some(rows) })
    }

    /// Texture coordinates as the file has them to those of the image.
    pub(super) fn apply(&self, uv: [f32; 2]) -> [f32; 2] {
        let Some(rows) = &self.rows else { return uv };
        let [u, v] = uv.map(f64::from);
        rows.map(|[a, b, c]| (a * u + b * v + c) as f32)
    }
}

/// Reads materials one after the other, and each image once, when a material first uses it.
pub(super) struct MaterialReader<'a> {
    root: &'a Root,
    buffers: &'a Buffers,
    resolver: Resolver,
    texels: TexelReader,
    /// Index into `images` of each image of the file.
    places: Vec<Option<usize>>,
    /// The images in use.
    pub(super) images: Vec<Image>,
}

impl<'a> MaterialReader<'a> {
    pub(super) fn new(root: &'a Root, buffers: &'a Buffers, resolver: Resolver) -> Self {
        let places = vec![None; root.images.len()];
        Self { root, buffers, resolver, texels: TexelReader::new(), places, images: Vec::new() }
    }

    /// `materials[index]`, and which texture coordinates it wants.
    pub(super) fn read(
        &mut self,
        index: usize,
        report: &mut Report,
    ) -> Result<(Material, Option<UvSource>), SceneError> {
        let invalid = |report: &Report, what: String| report.invalid(format!("materials[{index}] {what}"));
        let source = get(&self.root.materials, index, "materials").map_err(|what| report.invalid(what))?;
        let name = name_or(&source.name, "material", index);
        let (mut material, mut slots) =
            surface(source, &name, report).map_err(|what| invalid(report, what))?;
        material.name = name.clone();

        // One set of coordinates serves all slots: that of the first slot in use.
        let mut uv: Option<UvSource> = None;
        for (slot, info) in slots.iter_mut().enumerate() {
            let Some(texture) = *info else { continue };
            let wanted = UvSource::of(texture).map_err(|what| invalid(report, what))?;
            if *uv.get_or_insert(wanted) != wanted {
                report.warn(format!(
                    "the material \"{}\" has other texture coordinates for its {} texture than for its {} texture; the former is \
                     left out",
                    shown(&name),
                    SLOT_NAMES[slot],
                    slots_first(slot),
                ));
                *info = None;
            }
        }
        let mut refs = [None; 4];
        for (place, info) in refs.iter_mut().zip(slots) {
            if let Some(info) = info {
                *place = self.texture(info.index.value(), report)?;
            }
        }
        [
            material.base_texture,
            material.metallic_roughness_texture,
            material.emissive_texture,
            material.transmission_texture,
        ] = refs;
        Ok((material, uv))
    }

    /// `textures[index]`; `None` with a warning where it has no image that we can read.
    fn texture(&mut self, index: usize, report: &mut Report) -> Result<Option<TextureRef>, SceneError> {
        let of = |report: &Report, what: String| report.invalid(format!("textures[{index}] {what}"));
        let texture = get(&self.root.textures, index, "textures").map_err(|what| report.invalid(what))?;
        let image = texture.source.value();
        if image == u32::MAX as usize {
            report.warn(format!(
                "textures[{index}] has no image without an extension that we lack; it is left out"
            ));
            return Ok(None);
        }
        let (mut wrap, mut nearest) = ([Wrap::Repeat; 2], false);
        if let Some(sampler) = texture.sampler {
            let sampler =
                get(&self.root.samplers, sampler.value(), "samplers").map_err(|what| of(report, what))?;
            for (wrap, mode) in wrap.iter_mut().zip([&sampler.wrap_s, &sampler.wrap_t]) {
                *wrap = match checked(mode).map_err(|what| of(report, what))? {
                    json::texture::WrappingMode::Repeat => Wrap::Repeat,
                    json::texture::WrappingMode::MirroredRepeat => Wrap::Mirror,
                    json::texture::WrappingMode::ClampToEdge => Wrap::Clamp,
                };
            }
            nearest = sampler.mag_filter
                == Some(json::validation::Checked::Valid(json::texture::MagFilter::Nearest));
        }
        let image = self.image(image, report)?;
        Ok(Some(TextureRef { image, wrap_s: wrap[0], wrap_t: wrap[1], nearest }))
    }

    /// The place in `self.images` of `images[index]`.
    fn image(&mut self, index: usize, report: &Report) -> Result<usize, SceneError> {
        let source = get(&self.root.images, index, "images").map_err(|what| report.invalid(what))?;
        if let Some(place) = self.places[index] {
            return Ok(place);
        }
        let of = |what: String| report.invalid(format!("images[{index}] {what}"));
        let bytes = match (&source.uri, source.buffer_view) {
            (Some(uri), None) => self.resolver.read(uri, Syntax::Uri, IMAGE_BYTES_MAX)?,
            (None, Some(view)) => {
                let (bytes, _) = view_bytes(self.root, self.buffers, view.value()).map_err(of)?;
                bytes.to_vec()
            }
            _ => return Err(of("must have either a uri or a bufferView".to_owned())),
        };
        let is_file = |uri: &&String| !uri.starts_with("data:");
        let name =
            source.name.as_ref().filter(|name| !name.is_empty()).or(source.uri.as_ref().filter(is_file));
        let name = name_or(&name.cloned(), "image", index);
        let image =
            self.texels.decode(&name, &bytes).map_err(|what| of(format!("(\"{}\") {what}", shown(&name))))?;
        self.places[index] = Some(self.images.len());
        self.images.push(image);
        Ok(self.images.len() - 1)
    }
}

/// Names of the texture slots, in the order in which their coordinates are preferred.
const SLOT_NAMES: [&str; 4] = ["base", "metal and roughness", "emissive", "transmission"];

/// What a message calls the slots before `slot`.
fn slots_first(slot: usize) -> &'static str {
    if slot == 1 { SLOT_NAMES[0] } else { "first" }
}

type Slots<'a> = [Option<&'a json::texture::Info>; 4];

/// The surface without its textures, and the texture slots in the order of [`SLOT_NAMES`].
fn surface<'a>(
    source: &'a json::Material,
    name: &str,
    report: &mut Report,
) -> Result<(Material, Slots<'a>), String> {
    let pbr = &source.pbr_metallic_roughness;
    let extensions = source.extensions.as_ref();
    let mut material = Material {
        base_color: unit(pbr.base_color_factor.0, "baseColorFactor")?,
        metallic: unit([pbr.metallic_factor.0], "metallicFactor")?[0],
        roughness: unit([pbr.roughness_factor.0], "roughnessFactor")?[0],
        alpha: match checked(&source.alpha_mode)? {
            json::material::AlphaMode::Opaque => AlphaMode::Opaque,
            json::material::AlphaMode::Mask => {
                AlphaMode::Mask(not_negative([source.alpha_cutoff.unwrap_or_default().0], "alphaCutoff")?[0])
            }
            json::material::AlphaMode::Blend => AlphaMode::Blend,
        },
        double_sided: source.double_sided,
        unlit: extensions.is_some_and(|all| all.unlit.is_some()),
        ..Material::default()
    };
    let mut slots: Slots<'a> = [
        pbr.base_color_texture.as_ref(),
        pbr.metallic_roughness_texture.as_ref(),
        source.emissive_texture.as_ref(),
        None,
    ];
    let strength = extensions.and_then(|all| all.emissive_strength.as_ref());
    let strength = strength.map_or(1.0, |strength| strength.emissive_strength.0);
    material.emissive = not_negative(
        source.emissive_factor.0.map(|channel| channel * strength),
        "emissive factor times strength",
    )?;

    if source.normal_texture.is_some() {
        report.warn("normal textures are not supported: surfaces are as smooth as their vertex normals");
    }
    if source.occlusion_texture.is_some() {
        report.warn("occlusion textures are not used: shadows are traced");
    }
    let Some(extensions) = extensions else {
        return Ok((material, slots));
    };

    if let Some(gloss) = &extensions.pbr_specular_glossiness {
        material.base_color = unit(gloss.diffuse_factor.0, "diffuseFactor")?;
        material.specular = unit(gloss.specular_factor.0, "specularFactor")?;
        material.metallic = 0.0;
        material.roughness = 1.0 - unit([gloss.glossiness_factor.0], "glossinessFactor")?[0];
        slots[0] = gloss.diffuse_texture.as_ref();
        slots[1] = None;
        if gloss.specular_glossiness_texture.is_some() {
            report.warn(format!(
                "the material \"{}\" loses its specular-glossiness texture; the factors stay",
                shown(name)
            ));
        }
    }
    if let Some(ior) = &extensions.ior {
        let ior = ior.ior.0;
        if ior == 0.0 {
            // The extension's way to say: reflect everything at normal incidence.
            material.specular = [1.0; 3];
        } else if ior >= 1.0 && ior.is_finite() {
            material.ior = ior;
            material.specular = [((ior - 1.0) / (ior + 1.0)) * ((ior - 1.0) / (ior + 1.0)); 3];
        } else {
            return Err(format!("has the index of refraction {ior}; it must be 0 or at least 1"));
        }
    }
    if let Some(specular) = &extensions.specular {
        let factor = unit([specular.specular_factor.0], "specularFactor")?[0];
        let color = not_negative(specular.specular_color_factor.0, "specularColorFactor")?;
        material.specular = std::array::from_fn(|i| (material.specular[i] * color[i]).min(1.0) * factor);
        if specular.specular_texture.is_some() || specular.specular_color_texture.is_some() {
            report.warn(format!(
                "the material \"{}\" loses its specular textures; the factors stay",
                shown(name)
            ));
        }
    }
    if let Some(transmission) = &extensions.transmission {
        material.transmission = unit([transmission.transmission_factor.0], "transmissionFactor")?[0];
        slots[3] = transmission.transmission_texture.as_ref();
    }
    let mut is_solid = extensions.ior.is_some();
    if let Some(volume) = &extensions.volume {
        is_solid = not_negative([volume.thickness_factor.0], "thicknessFactor")?[0] > 0.0;
        if volume.attenuation_color.0 != [1.0; 3] && volume.attenuation_distance.0.is_finite() {
            report.warn(format!(
                "the material \"{}\" does not tint light on its way through its volume",
                shown(name)
            ));
        }
    }
    material.thin_walled = material.transmission > 0.0 && !is_solid;
    Ok((material, slots))
}

/// Numbers in [0, 1]; what lies outside is clamped, as viewers do.
fn unit<const N: usize>(values: [f32; N], what: &str) -> Result<[f32; N], String> {
    Ok(not_negative(values.map(|value| value.max(0.0)), what)?.map(|value| value.min(1.0)))
}

/// Finite numbers from 0 on.
fn not_negative<const N: usize>(values: [f32; N], what: &str) -> Result<[f32; N], String> {
    match values.iter().find(|value| !value.is_finite() || **value < 0.0) {
        Some(value) => Err(format!("has the {what} {value}; it must be finite and not negative")),
        None => Ok(values),
    }
}
