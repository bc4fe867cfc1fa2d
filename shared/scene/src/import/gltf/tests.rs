use super::*;
use crate::{AlphaMode, LightKind, Primitive, Wrap};
use glam::DVec3;
use serde_json::{Value, json};

/// A file in the making: attributes are appended to one buffer, the rest is JSON.
struct Draft {
    json: Value,
    bytes: Vec<u8>,
}

const I8: u32 = 5120;
const U8: u32 = 5121;
const I16: u32 = 5122;
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

impl Draft {
    /// One node with one mesh without primitives.
    fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}],
            "accessors": [],
            "bufferViews": [],
        });
        Self { json, bytes: Vec::new() }
    }

    /// A triangle (0,0,0) (1,0,0) (0,1,0) of material 0, if there is one, with coordinates in set 0.
    fn triangle() -> Self {
        let mut draft = Self::new();
        let positions = draft.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let uvs = draft.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        draft.primitive(json!({"attributes": {"POSITION": positions, "TEXCOORD_0": uvs}}));
        draft
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        if self.json.get(list).is_none() {
            self.json[list] = json!([]);
        }
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn primitive(&mut self, primitive: Value) {
        self.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    fn accessor(
        &mut self,
        kind: &str,
        component: u32,
        count: usize,
        normalized: bool,
        bytes: &[u8],
    ) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind, "normalized": normalized}),
        )
    }

    fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let lanes = kind[3..].parse::<usize>().unwrap();
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(kind, F32, values.len() / lanes, false, &bytes)
    }

    fn json_with_buffer(&self) -> Value {
        let mut json = self.json.clone();
        if json.get("buffers").is_none() {
            let text: String = self.bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
            json["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": format!("data:,{text}")}]);
        }
        json
    }

    fn import(&self) -> Result<Scene, String> {
        import_bytes(self.json_with_buffer().to_string().as_bytes())
    }

    /// The first primitive.
    fn part(&self) -> Primitive {
        self.import().unwrap().meshes[0].primitives[0].clone()
    }

    fn error(&self) -> String {
        self.import().unwrap_err()
    }
}

fn import_bytes(bytes: &[u8]) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, bytes).unwrap();
    import(&path).map_err(|error| error.to_string())
}

/// A GLB of chunks.
fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let mut body = Vec::new();
    for (kind, chunk) in chunks {
        let padded = chunk.len().next_multiple_of(4);
        body.extend((padded as u32).to_le_bytes());
        body.extend(*kind);
        body.extend(*chunk);
        body.resize(body.len() + padded - chunk.len(), if *kind == b"JSON" { b' ' } else { 0 });
    }
    [b"glTF".as_slice(), &2_u32.to_le_bytes(), &(body.len() as u32 + 12).to_le_bytes(), &body].concat()
}

fn png(texel: [u8; 4]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(1, 1, image::Rgba(texel))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

#[test]
fn glb_carries_buffer_and_image() {
    let mut draft = Draft::triangle();
    let view = draft.view(&png([1, 2, 3, 4]));
    draft.push("images", json!({"bufferView": view, "mimeType": "image/png", "name": "dot"}));
    draft.push("textures", json!({"source": 0}));
    draft.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    draft.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    draft.json["buffers"] = json!([{"byteLength": draft.bytes.len()}]);
    let json = draft.json.to_string();
    let scene =
        import_bytes(&glb(&[(b"JSON", json.as_bytes()), (b"JUNK", b"skipped"), (b"BIN\0", &draft.bytes)]))
            .unwrap();
    assert_eq!(scene.images[0].rgba[..], [1, 2, 3, 4]);
    assert_eq!(scene.images[0].name, "dot");
    assert_eq!(scene.meshes[0].primitives[0].triangles, [[0, 1, 2]]);

    let whole = glb(&[(b"JSON", json.as_bytes()), (b"BIN\0", &draft.bytes)]);
    for length in (0..whole.len()).step_by(7) {
        assert!(import_bytes(&whole[..length]).is_err(), "{length} bytes");
    }
    let mut longer = whole.clone();
    longer[8..12].copy_from_slice(&(whole.len() as u32 + 4).to_le_bytes());
    assert!(import_bytes(&longer).unwrap_err().contains("GLB header"));
    longer[8..12].copy_from_slice(&5_u32.to_le_bytes());
    assert!(import_bytes(&longer).unwrap_err().contains("GLB header"));
    longer[4] = 1;
    assert!(import_bytes(&longer).unwrap_err().contains("GLB version 1"));
    assert!(import_bytes(&glb(&[(b"BIN\0", b"")])).unwrap_err().contains("no JSON chunk"));
}

#[test]
fn every_component_type_reads() {
    let mut draft = Draft::new();
    draft.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    // Each vertex padded to 8 bytes: 3 x i16.
    let i16s: Vec<u8> = [[0_i16, 0, 0, 9], [100, 0, 0, 9], [0, -100, 0, 9]]
        .concat()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let positions = draft.accessor("VEC3", I16, 3, false, &i16s);
    draft.json["bufferViews"][positions]["byteStride"] = json!(8);
    let normals = draft.accessor("VEC3", I8, 3, true, &[0, 0, 127, 0, 0, 129, 127, 128, 0]);
    let u16s: Vec<u8> = [0_u16, 65535, 13107, 0, 1, 2].iter().flat_map(|v| v.to_le_bytes()).collect();
    let uvs = draft.accessor("VEC2", U16, 3, true, &u16s);
    let colors = draft.accessor("VEC4", U8, 3, true, &[255, 0, 55, 128, 0, 0, 0, 0, 1, 2, 3, 4]);
    let indices = draft.accessor("SCALAR", U8, 3, false, &[2, 1, 0]);
    draft.push("textures", json!({"source": 0}));
    draft.push("images", json!({"uri": data_png()}));
    draft.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    draft.primitive(json!({
        "attributes": {"POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs, "COLOR_0": colors},
        "indices": indices, "material": 0,
    }));
    let part = draft.part();
    assert_eq!(part.positions, [DVec3::ZERO, DVec3::X * 100.0, DVec3::Y * -100.0]);
    assert_eq!(part.normals, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1.0, 0.0]]);
    assert_eq!(part.uvs[..2], [[0.0, 1.0], [0.2, 0.0]]);
    // 55 / 255 = 0.2157 linear is code 128 (0.2158); black and the rest are small.
    assert_eq!(part.colors[..2], [[255, 0, 128, 128], [0, 0, 0, 0]]);
    assert_eq!(part.triangles, [[2, 1, 0]]);

    for (component, bytes) in [(U16, vec![0, 0, 2, 0, 1, 0]), (U32, vec![0, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0])]
    {
        let indices = draft.accessor("SCALAR", component, 3, false, &bytes);
        draft.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        assert_eq!(draft.part().triangles, [[0, 2, 1]]);
    }
}

fn data_png() -> String {
    let text: String = png([9, 8, 7, 255]).iter().map(|byte| format!("%{byte:02x}")).collect();
    format!("data:image/png,{text}")
}

#[test]
fn float_colours_are_coded() {
    let mut draft = Draft::triangle();
    let colors = draft.floats("VEC3", &[0.0, 0.5, 1.0, 0.0031308, f32::NAN, -1.0, 2.0, 0.2158605, 0.7304608]);
    draft.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colors);
    // IEC 61966-2-1: 0.5 is 187.5 (code 188), 0.0031308 is 10.3, codes 128 and 222 are near exact.
    assert_eq!(draft.part().colors, [[0, 188, 255, 255], [10, 0, 0, 255], [255, 128, 222, 255]]);
}

#[test]
fn sparse_accessors_with_and_without_a_base() {
    let mut draft = Draft::triangle();
    let indices = draft.view(&[1, 0, 2, 0]);
    let values: Vec<u8> = [7.0_f32, 8.0, 9.0, 4.0, 5.0, 6.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = draft.view(&values);
    draft.json["accessors"][0]["sparse"] = json!({
        "count": 2, "indices": {"bufferView": indices, "componentType": U16}, "values": {"bufferView": values},
    });
    let want = [DVec3::ZERO, DVec3::new(7.0, 8.0, 9.0), DVec3::new(4.0, 5.0, 6.0)];
    assert_eq!(draft.part().positions, want);
    draft.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    assert_eq!(draft.part().positions, want);

    draft.json["accessors"][0]["count"] = json!(3_000_000_000_u64);
    assert!(draft.error().contains("zeros without a buffer"));
    draft.json["accessors"][0]["count"] = json!(1);
    assert!(draft.error().contains("replaces 2 of 1"));
    draft.json["accessors"][0]["count"] = json!(2);
    assert!(draft.error().contains("not below 2"));
    draft.json["accessors"][0].as_object_mut().unwrap().remove("sparse");
    assert!(draft.error().contains("neither a bufferView nor a sparse part"));
}

#[test]
fn modes_become_lists_and_shared_vertices_are_shared_out() {
    let mut draft = Draft::new();
    let line: Vec<f32> = (0..6).flat_map(|i| [i as f32, 0.0, 0.0]).collect();
    let positions = draft.floats("VEC3", &line);
    let attributes = json!({"POSITION": positions});
    for mode in [5, 6, 0, 1, 2, 3, 4] {
        draft.primitive(json!({"attributes": attributes, "mode": mode}));
    }
    let few = draft.accessor("SCALAR", U8, 4, false, &[5, 1, 3, 1]);
    draft.primitive(json!({"attributes": attributes, "indices": few, "mode": 5}));
    let scene = draft.import().unwrap();
    let parts = &scene.meshes[0].primitives;
    assert_eq!(parts[0].triangles, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]);
    assert_eq!(parts[1].triangles, [[1, 2, 0], [2, 3, 0], [3, 4, 0], [4, 5, 0]]);
    assert_eq!(parts[2].triangles, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!(parts[3].positions.iter().map(|p| p.x).collect::<Vec<_>>(), [1.0, 3.0, 5.0]);
    assert_eq!(parts[3].triangles, [[2, 0, 1], [0, 0, 1]]);
    assert_eq!(scene.dropped, [("primitives of points or lines", 4)]);
    assert_eq!(scene.materials[0].metallic, 1.0);
    assert!(!scene.materials[0].double_sided);
}

#[test]
fn materials_follow_the_table() {
    let material = |json: Value| {
        let mut draft = Draft::triangle();
        draft.push("materials", json);
        draft.import().unwrap().materials[0].clone()
    };
    let with = |extensions: Value| material(json!({ "extensions": extensions }));
    let plain = material(json!({}));
    assert_eq!(
        (plain.metallic, plain.roughness, plain.specular, plain.double_sided),
        (1.0, 1.0, [0.04; 3], false)
    );
    let mask =
        material(json!({"alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true, "name": "leaf"}));
    assert_eq!((mask.alpha, mask.double_sided, mask.name.as_str()), (AlphaMode::Mask(0.25), true, "leaf"));
    assert_eq!(material(json!({"alphaMode": "BLEND"})).alpha, AlphaMode::Blend);

    let thin = with(json!({"KHR_materials_transmission": {"transmissionFactor": 0.5}}));
    assert_eq!((thin.transmission, thin.thin_walled, thin.ior), (0.5, true, 1.5));
    let solid = with(
        json!({"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 2}}),
    );
    assert_eq!((solid.thin_walled, solid.ior), (false, 2.0));
    assert!((solid.specular[0] - 1.0 / 9.0).abs() < 1e-7);
    for (thickness, thin) in [(0.0, true), (0.5, false)] {
        let volume = with(json!({
            "KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.3},
            "KHR_materials_volume": {"thicknessFactor": thickness},
        }));
        assert_eq!(volume.thin_walled, thin);
    }
    assert_eq!(with(json!({"KHR_materials_ior": {"ior": 0}})).specular, [1.0; 3]);
    let dull =
        with(json!({"KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0, 50]}}));
    assert_eq!(dull.specular, [0.02, 0.0, 0.5]);
    assert!(with(json!({"KHR_materials_unlit": {}})).unlit);
    let lamp = material(json!({
        "emissiveFactor": [1, 0.5, 0], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 10}},
    }));
    assert_eq!(lamp.emissive, [10.0, 5.0, 0.0]);
    let gloss = with(json!({"KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [0.5, 0.25, 0, 1], "specularFactor": [0.1, 0.2, 0.3], "glossinessFactor": 0.75,
    }}));
    assert_eq!((gloss.base_color, gloss.specular), ([0.5, 0.25, 0.0, 1.0], [0.1, 0.2, 0.3]));
    assert_eq!((gloss.metallic, gloss.roughness), (0.0, 0.25));
}

#[test]
fn one_set_of_coordinates_serves_a_material() {
    let mut draft = Draft::triangle();
    let second = draft.floats("VEC2", &[0.5, 0.5, 0.0, 0.0, 0.25, 1.0]);
    draft.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(second);
    draft.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    draft.push("images", json!({"uri": data_png()}));
    draft.push("samplers", json!({"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}));
    draft.push("textures", json!({"source": 0, "sampler": 0}));
    draft.push("textures", json!({"source": 0}));
    // A quarter turn counter-clockwise on the image, where v points down: (u, v) to (v, -u).
    let turned = json!({"index": 0, "extensions": {"KHR_texture_transform": {
        "rotation": std::f64::consts::FRAC_PI_2, "offset": [0.5, 0.25], "scale": [2, 4], "texCoord": 1,
    }}});
    draft.push(
        "materials",
        json!({
            "pbrMetallicRoughness": {"baseColorTexture": turned, "metallicRoughnessTexture": turned},
            "emissiveTexture": {"index": 1},
        }),
    );
    let scene = draft.import().unwrap();
    let material = &scene.materials[0];
    let base = material.base_texture.unwrap();
    assert_eq!((base.wrap_s, base.wrap_t, base.nearest), (Wrap::Clamp, Wrap::Mirror, true));
    assert_eq!(material.metallic_roughness_texture, Some(base));
    assert_eq!(material.emissive_texture, None);
    assert!(scene.warnings[0].contains("its emissive texture"), "{:?}", scene.warnings);
    assert_eq!(scene.images.len(), 1);
    // (0.5, 0.5) * (2, 4) = (1, 2), turned (2, -1), shifted (2.5, -0.75).
    let uvs = &scene.meshes[0].primitives[0].uvs;
    assert!((uvs[0][0] - 2.5).abs() < 1e-6 && (uvs[0][1] + 0.75).abs() < 1e-6, "{uvs:?}");

    draft.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_1");
    let scene = draft.import().unwrap();
    assert!(
        scene.warnings.iter().any(|warning| warning.contains("lacks TEXCOORD_1")),
        "{:?}",
        scene.warnings
    );
    assert!(scene.meshes[0].primitives[0].uvs.is_empty());
}

#[test]
fn nodes_lights_and_cameras_stand_in_the_world() {
    let mut draft = Draft::triangle();
    draft.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "color": [1, 0.5, 0], "intensity": 10, "range": 5},
        {"type": "directional", "name": "sun"},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
    ]}});
    let light = |index: u32| json!({"KHR_lights_punctual": {"light": index}});
    // Node 1 turns -z to -x (a quarter turn about y) and stands at (10, 0, 0), twice as large.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    draft.json["nodes"] = json!([
        {"mesh": 0, "children": [1], "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 10,0,0,1]},
        {"rotation": [0, half, 0, half], "scale": [2, 2, 2], "children": [3, 2], "extensions": light(2)},
        {"translation": [0, 1, 0], "extensions": light(0), "camera": 0},
        {"extensions": light(1), "camera": 1, "name": "eye"},
        {"mesh": 0, "name": "not in the scene"},
    ]);
    draft.json["cameras"] = json!([
        {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}},
        {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}},
    ]);
    let scene = draft.import().unwrap();
    let names: Vec<&str> = scene.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(names, ["node 0", "node 1", "eye", "node 2"]);
    assert_eq!(
        (scene.roots.as_slice(), scene.nodes[1].children.as_slice()),
        ([0].as_slice(), [2, 3].as_slice())
    );

    let [spot, sun, point] = scene.lights.as_slice() else { panic!("three lights") };
    assert_eq!(spot.kind, LightKind::Spot { inner: 0.1, outer: 0.5 });
    assert!((spot.direction - DVec3::NEG_X).length() < 1e-7 && spot.position == DVec3::X * 10.0);
    assert_eq!((sun.name.as_str(), sun.kind, sun.intensity), ("sun", LightKind::Directional, [1.0; 3]));
    assert_eq!((point.kind, point.range, point.intensity), (LightKind::Point, 5.0, [10.0, 5.0, 0.0]));
    assert!((point.position - DVec3::new(10.0, 2.0, 0.0)).length() < 1e-12);

    assert_eq!((scene.cameras[0].name.as_str(), scene.cameras[1].name.as_str()), ("eye", "camera 0"));
    let pose = scene.cameras[1].pose;
    assert!((pose.fov_degrees - 57.29577951308232).abs() < 1e-6);
    assert!((pose.target - pose.eye - DVec3::NEG_X).length() < 1e-7);
    assert!((pose.up - DVec3::Y).length() < 1e-12);
}

#[test]
fn broken_trees_are_refused() {
    for (nodes, why) in [
        (json!([{"children": [1]}, {"children": [0]}]), "cycle"),
        (json!([{}, {"children": [2]}, {"children": [1]}]), "cycle"),
        (json!([{"children": [0]}]), "cycle"),
        (json!([{"children": [1, 2]}, {"children": [2]}, {}]), "two parents"),
        (json!([{"children": [1, 1]}, {}]), "two parents"),
        (json!([{"children": [7]}]), "names the child 7, but there are 1"),
        (json!([{"mesh": 4}]), "names a mesh beyond the 1"),
        (json!([{"camera": 0}]), "needs cameras[0]"),
        (json!([{"rotation": [0, 0, 0, 0]}]), "rotation without direction"),
        (json!([{"scale": [1e38, 1e39, 1]}]), "not finite"),
        (json!([{"matrix": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1]}]), "last row"),
        (json!([{"extensions": {"KHR_lights_punctual": {"light": 0}}}]), "needs lights[0]"),
    ] {
        let mut draft = Draft::triangle();
        draft.json["nodes"] = nodes;
        let error = draft.error();
        assert!(error.contains(why), "{error}\nwanted: {why}");
    }
    for (scenes, why) in [
        (json!([{"nodes": [9]}]), "names node 9, but there are 2"),
        (json!([{"nodes": [1]}]), "which is a child of nodes[0]"),
        (json!([{"nodes": [0, 0]}]), "names nodes[0] twice"),
        (json!([]), "needs scenes[0], but there are 0"),
    ] {
        let mut draft = Draft::triangle();
        draft.json["nodes"] = json!([{"children": [1]}, {"mesh": 0}]);
        draft.json["scenes"] = scenes;
        assert!(draft.error().contains(why), "{}\nwanted: {why}", draft.error());
    }
    // Without any scene, all nodes that have no parent are shown; a chain of any length is walked without recursion.
    let mut draft = Draft::triangle();
    let depth = crate::import::limits::NODE_DEPTH_MAX;
    draft.json["nodes"] =
        (1..depth).map(|child| json!({"children": [child]})).chain([json!({"mesh": 0})]).collect();
    draft.json.as_object_mut().unwrap().retain(|key, _| key != "scene" && key != "scenes");
    assert_eq!(draft.import().unwrap().nodes.len(), depth);
    draft.json["nodes"][depth - 1]["children"] = json!([depth]);
    draft.push("nodes", json!({}));
    assert!(draft.error().contains("deeper than"));
}

#[test]
fn extensions_are_required_or_merely_used() {
    for extension in
        ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "EXT_unheard_of"]
    {
        let mut draft = Draft::triangle();
        draft.json["extensionsUsed"] = json!([extension]);
        let warnings = draft.import().unwrap().warnings;
        assert!(warnings.len() == 1 && warnings[0].contains(extension), "{warnings:?}");
        draft.json["extensionsRequired"] = json!([extension]);
        // The rest may have any form: the extension is what to name.
        draft.json["accessors"] = json!("compressed");
        assert!(
            draft.error().contains(&format!("requires the extension {extension}, which is not supported"))
        );
    }
    let mut draft = Draft::triangle();
    draft.json["asset"] = json!({"version": "3.1"});
    assert!(draft.error().contains("is glTF 3.1"));
    draft.json["asset"] = json!({"version": "2.1", "minVersion": "2.0"});
    assert!(draft.import().is_ok());
}

/// Changes one value of the triangle and gives the error.
fn error_with(pointer: &str, value: Value) -> String {
    let mut draft = Draft::triangle();
    draft.json["meshes"][0]["primitives"][0]["indices"] = json!(2);
    draft.accessor("SCALAR", U8, 3, false, &[0, 1, 2]);
    draft.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    draft.push("images", json!({"uri": data_png()}));
    draft.push("samplers", json!({}));
    draft.push("textures", json!({"source": 0, "sampler": 0}));
    draft.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    draft.json["buffers"] = draft.json_with_buffer()["buffers"].clone();
    assert!(draft.import().is_ok());
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match draft.json.pointer_mut(pointer) {
        Some(place) => *place = value,
        None => draft.json.pointer_mut(parent).unwrap()[key] = value,
    }
    draft.import().err().unwrap_or_else(|| panic!("{pointer} was accepted"))
}

#[test]
fn hostile_values_are_named() {
    let part = "/meshes/0/primitives/0";
    for (pointer, value, why) in [
        ("/buffers/0/byteLength".to_owned(), json!(1_000_000), "claims 1000000 bytes but has"),
        ("/buffers/0/uri".to_owned(), json!("%FF"), "not UTF-8"),
        ("/buffers/0/uri".to_owned(), json!("../secret.bin"), "leads out"),
        ("/buffers/0/uri".to_owned(), json!("%2e%2e/secret.bin"), "leads out"),
        ("/buffers/0/uri".to_owned(), json!("file:///etc/passwd"), "scheme 'file:'"),
        ("/buffers/0/uri".to_owned(), json!("https://example.com/a.bin"), "scheme 'https:'"),
        ("/buffers/0/uri".to_owned(), json!("/etc/passwd"), "absolute path"),
        ("/buffers/0/uri".to_owned(), json!("missing.bin"), "cannot be read"),
        ("/buffers/0/uri".to_owned(), Value::Null, "has no uri"),
        ("/buffers/0".to_owned(), json!("x"), "not valid glTF JSON"),
        ("/bufferViews/0/buffer".to_owned(), json!(3), "needs buffers[3]"),
        (
            "/bufferViews/0/byteLength".to_owned(),
            json!(u64::MAX),
            "needs bufferViews[0]: bytes 0 + 18446744073709551615",
        ),
        ("/bufferViews/0/byteOffset".to_owned(), json!(u64::MAX), "needs bufferViews[0]"),
        ("/bufferViews/0/byteStride".to_owned(), json!(4), "elements of 12 bytes every 4"),
        ("/bufferViews/0/byteStride".to_owned(), json!(u64::MAX), "claims 3 elements"),
        ("/accessors/0/bufferView".to_owned(), json!(99), "needs bufferViews[99]"),
        ("/accessors/0/count".to_owned(), json!(4), "claims 4 elements of 12 bytes"),
        ("/accessors/0/count".to_owned(), json!(u64::MAX), "claims 18446744073709551615 elements"),
        ("/accessors/0/count".to_owned(), json!(2), "texture coordinates for 2 positions"),
        ("/accessors/0/byteOffset".to_owned(), json!(u64::MAX - 3), "claims 3 elements"),
        ("/accessors/0/type".to_owned(), json!("VEC7"), "glTF 2.0 does not know"),
        ("/accessors/0/type".to_owned(), json!("VEC2"), "[3] are expected"),
        ("/accessors/0/type".to_owned(), json!("MAT4"), "is a matrix"),
        ("/accessors/0/componentType".to_owned(), json!(1), "glTF 2.0 does not know"),
        ("/accessors/2/componentType".to_owned(), json!(I8), "not single unsigned integers"),
        ("/accessors/2/normalized".to_owned(), json!(true), "not single unsigned integers"),
        ("/accessors/2/count".to_owned(), json!(2), "2 corners, too few"),
        (format!("{part}/attributes/POSITION"), json!(50), "needs accessors[50]"),
        (format!("{part}/indices"), json!(50), "needs accessors[50]"),
        (format!("{part}/material"), json!(50), "names material 50"),
        (format!("{part}/mode"), json!(7), "glTF 2.0 does not know"),
        ("/materials/0/alphaMode".to_owned(), json!("GLOW"), "glTF 2.0 does not know"),
        ("/materials/0/emissiveFactor".to_owned(), json!([1e39, 0, 0]), "must be finite"),
        ("/materials/0/emissiveFactor".to_owned(), json!([-1, 0, 0]), "not negative"),
        (
            "/materials/0/extensions".to_owned(),
            json!({"KHR_materials_ior": {"ior": 0.5}}),
            "index of refraction 0.5",
        ),
        (
            "/materials/0/pbrMetallicRoughness".to_owned(),
            json!({"baseColorTexture": {"index": 9}}),
            "needs textures[9]",
        ),
        ("/textures/0/source".to_owned(), json!(9), "needs images[9]"),
        ("/textures/0/sampler".to_owned(), json!(9), "needs samplers[9]"),
        ("/samplers/0/wrapS".to_owned(), json!(9), "glTF 2.0 does not know"),
        ("/images/0/uri".to_owned(), json!("../x.png"), "leads out"),
        ("/images/0/uri".to_owned(), json!("data:,text"), "neither PNG nor JPEG"),
        ("/images/0/bufferView".to_owned(), json!(0), "either a uri or a bufferView"),
        ("/scene".to_owned(), json!(3), "needs scenes[3]"),
    ] {
        let error = error_with(&pointer, value);
        assert!(error.contains(why), "{pointer}: {error}\nwanted: {why}");
        assert!(error.lines().count() == 1, "{error}");
    }
}

#[test]
fn an_index_out_of_range_is_named_with_its_place() {
    let mut draft = Draft::triangle();
    let indices = draft.accessor("SCALAR", U8, 3, false, &[0, 1, 3]);
    draft.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let error = draft.error();
    assert!(
        error.contains("meshes[0].primitives[0]: indices: number 2 is 3, but there are 3 vertices"),
        "{error}"
    );
}

#[test]
fn not_a_number_stays_for_the_clean_up_to_count() {
    let mut draft = Draft::triangle();
    draft.bytes[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(draft.part().positions[1].x.is_nan());
}

#[test]
fn cameras_get_names_of_their_own() {
    let mut draft = Draft::triangle();
    let names = ["A 3", "A", "A", "A 2", "A"];
    draft.json["nodes"] = names.map(|name| json!({"camera": 0, "name": name, "mesh": 0})).to_vec().into();
    draft.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3, 4]);
    draft.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]);
    let scene = draft.import().unwrap();
    let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["A 3", "A", "A 4", "A 2", "A 5"]);
}

#[test]
fn no_json_brings_the_parser_down() {
    let nested = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let infinite = "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"scale\":[1e999,1,1]}]}";
    for text in ["", "{", "[]", "null", "{\"asset\":{}}", "\u{feff}", &nested, infinite] {
        let error = import_bytes(text.as_bytes()).unwrap_err();
        assert!(error.contains("not valid glTF JSON"), "{error}");
    }
    // What nobody reads is passed over without recursion.
    let deep = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{nested}}}");
    assert!(import_bytes(deep.as_bytes()).unwrap().nodes.is_empty());
    let nodes = vec!["{}"; crate::import::limits::JSON_OBJECTS_MAX].join(",");
    let many = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{nodes}]}}");
    assert!(import_bytes(many.as_bytes()).unwrap_err().contains("JSON objects, more than"));
    let many = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":[{}]}}",
        ",".repeat(crate::import::limits::JSON_VALUES_MAX)
    );
    assert!(import_bytes(many.as_bytes()).unwrap_err().contains("JSON values, more than"));
}

#[test]
fn a_flood_of_instances_is_refused_by_counting() {
    let mut draft = Draft::new();
    let corners = 1 << 14;
    let positions: Vec<f32> = (0..corners).flat_map(|i| [i as f32, (i % 2) as f32, 0.0]).collect();
    let positions = draft.floats("VEC3", &positions);
    draft.primitive(json!({"attributes": {"POSITION": positions}, "mode": 5}));
    let nodes = 1 << 14;
    draft.json["nodes"] = (0..nodes).map(|_| json!({"mesh": 0})).collect();
    draft.json["scenes"][0]["nodes"] = (0..nodes).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flood.gltf");
    std::fs::write(&path, draft.json_with_buffer().to_string()).unwrap();
    let error = crate::import::import(&path).unwrap_err().to_string();
    assert!(
        error.contains("flood.gltf: has more than 134217728 triangles or vertices after instancing"),
        "{error}"
    );
}

mod animation;
