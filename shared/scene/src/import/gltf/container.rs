//! The container: GLB chunks, the JSON text, and which extensions it asks for.

use super::json::Root;
use crate::SceneError;
use crate::import::limits::{JSON_BYTES_MAX, JSON_OBJECTS_MAX, JSON_VALUES_MAX};
use crate::import::report::{Report, one_line, shown};
use std::path::Path;

/// Extensions that are read, each as the module documentation of the importer says.
const SUPPORTED: [&str; 12] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    // Only words for other programs.
    "KHR_xmp",
    "KHR_xmp_json_ld",
];

/// What the picture lacks when a file uses, but does not require, an extension.
const CONSEQUENCES: [(&str, &str); 14] = [
    ("EXT_mesh_gpu_instancing", "its instances are left out"),
    ("EXT_meshopt_compression", "the uncompressed fallback is read"),
    ("EXT_texture_webp", "the PNG or JPEG fallback is read"),
    ("KHR_draco_mesh_compression", "the uncompressed fallback is read"),
    ("KHR_materials_anisotropy", "highlights have no direction"),
    ("KHR_materials_clearcoat", "coats are left out"),
    ("KHR_materials_diffuse_transmission", "diffuse transmission is left out"),
    ("KHR_materials_dispersion", "all colours bend alike"),
    ("KHR_materials_iridescence", "thin films are left out"),
    ("KHR_materials_sheen", "sheen is left out"),
    ("KHR_materials_variants", "the default materials are used"),
    ("KHR_texture_basisu", "the PNG or JPEG fallback is read"),
    ("MSFT_lod", "the finest level is used"),
    ("MSFT_texture_dds", "the PNG or JPEG fallback is read"),
];

/// JSON text and the embedded buffer of a `.gltf` or `.glb`; which of them it is its first bytes say.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let Some(after_magic) = bytes.strip_prefix(b"glTF") else {
        // A byte order mark is forbidden by the standard, and common.
        return Ok((bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), None));
    };
    let truncated = || "is a truncated GLB file; fetch it again".to_owned();
    let (version, rest) = take_u32(after_magic).ok_or_else(truncated)?;
    if version != 2 {
        return Err(format!("is GLB version {version}; only version 2 is supported"));
    }
    let (length, rest) = take_u32(rest).ok_or_else(truncated)?;
    let mut chunks =
        (length as usize).checked_sub(12).and_then(|length| rest.get(..length)).ok_or_else(|| {
            format!(
                "claims {length} bytes in its GLB header but has {}; it is truncated or damaged",
                bytes.len()
            )
        })?;
    let mut json = None;
    let mut binary = None;
    while !chunks.is_empty() {
        let (length, rest) = take_u32(chunks).ok_or_else(truncated)?;
        let (kind, rest) = take_u32(rest).ok_or_else(truncated)?;
        let (chunk, rest) = rest.split_at_checked(length as usize).ok_or_else(|| {
            format!(
                "has a GLB chunk of {length} bytes where {} are left; it is truncated or damaged",
                rest.len()
            )
        })?;
        match &kind.to_le_bytes() {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            // The standard: unknown chunks are ignored.
            _ => {}
        }
        chunks = rest;
    }
    Ok((json.ok_or("has no JSON chunk; it is not a GLB scene")?, binary))
}

fn take_u32(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (head, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*head), rest))
}

/// The part of the JSON that decides whether the rest can be understood.
#[derive(serde::Deserialize)]
#[serde(expecting = "a glTF object")]
struct Probe {
    asset: ProbeAsset,
    #[serde(default, rename = "extensionsUsed")]
    extensions_used: Vec<String>,
    #[serde(default, rename = "extensionsRequired")]
    extensions_required: Vec<String>,
}

#[derive(serde::Deserialize)]
#[serde(expecting = "an object with the version")]
struct ProbeAsset {
    version: String,
    #[serde(rename = "minVersion")]
    min_version: Option<String>,
}

/// Parses the JSON; extensions are judged before the rest, whose form may depend on them.
pub(super) fn parse(json: &[u8], path: &Path, report: &mut Report) -> Result<Root, SceneError> {
    if json.len() > JSON_BYTES_MAX {
        return Err(report.invalid(format!("has {} bytes of JSON, more than {JSON_BYTES_MAX}", json.len())));
    }
    let objects = json.iter().filter(|&&byte| byte == b'{').count();
    if objects > JSON_OBJECTS_MAX {
        return Err(report.invalid(format!("has {objects} JSON objects, more than {JSON_OBJECTS_MAX}")));
    }
    let values = json.iter().filter(|&&byte| matches!(byte, b',' | b'[')).count();
    if values > JSON_VALUES_MAX {
        return Err(report.invalid(format!("has {values} JSON values, more than {JSON_VALUES_MAX}")));
    }
    let malformed = |error: serde_json::Error| {
        report.invalid(format!("is not valid glTF JSON: {}", one_line(&error.to_string())))
    };
    let probe: Probe = serde_json::from_slice(json).map_err(malformed)?;
    let needed = probe.asset.min_version.as_ref().unwrap_or(&probe.asset.version);
    if !needed.starts_with("2.") {
        return Err(report.invalid(format!("is glTF {}; only glTF 2 is supported", shown(needed))));
    }
    let lacking = |name: &&String| !SUPPORTED.contains(&name.as_str());
    if let Some(extension) = probe.extensions_required.iter().find(lacking) {
        return Err(SceneError::RequiredExtension { path: path.to_owned(), extension: shown(extension) });
    }
    let root = serde_json::from_slice(json).map_err(malformed)?;
    for extension in probe.extensions_used.iter().filter(lacking) {
        let consequence =
            CONSEQUENCES.iter().find(|(name, _)| name == extension).map(|(_, consequence)| *consequence);
        let consequence = consequence.unwrap_or("what it adds is left out");
        report.warn(format!("the extension {} is not supported: {consequence}", shown(extension)));
    }
    Ok(root)
}
