// Sibling of view.rs and records.rs: a pack's sections as they lie in compute memory.
//
// The kd-tree's slots are read through `slot_at`, all other sections through `word`, one after the other from the places that `scene`
// states; both are made by the worker, which may have to split them over several bindings. What a section holds is said in format.rs.
// The constants in capitals are the kernel's variant (variant.rs).

fn float_at(i: u32) -> f32 {
    return bitcast<f32>(word(i));
}

fn vec3_at(i: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(vec3<u32>(word(i), word(i + 1u), word(i + 2u)));
}

fn list_at(i: u32) -> u32 {
    return word(scene.at_list + i);
}

/// Vertex indices of triangle `id`.
fn mesh_indices(id: u32) -> vec3<u32> {
    let at = scene.at_faces + 3u * id;
    return vec3<u32>(word(at), word(at + 1u), word(at + 2u));
}

/// Decoded local position, exact: a voxel's centre (or a plain position).
fn mesh_position(vertex: u32) -> vec3<f32> {
    if PLAIN_POSITIONS { return vec3_at(scene.at_positions + 3u * vertex); }
    let at = scene.at_records + RECORD_WORDS * vertex;
    let offsets = record_offsets(word(at));
    let place = record_cell(word(at + 1u));
    var cell: vec3<u32>;
    if WIDE_CELLS {
        let low = word(scene.at_cells + 2u * place);
        let high = word(scene.at_cells + 2u * place + 1u);
        cell = vec3<u32>(high, low >> 16u, low & 0xffffu);
    } else {
        let entry = word(scene.at_cells + place);
        cell = vec3<u32>(entry >> 20u, (entry >> 10u) & 1023u, entry & 1023u);
    }
    // Voxel coordinates are below 2^23 and the result is a half within 2^22: both exact in f32.
    return vec3<f32>((cell << vec3<u32>(10u)) | offsets) + scene.bias;
}

struct Corners {
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
}

fn corners_of(id: u32) -> Corners {
    let indices = mesh_indices(id);
    return Corners(mesh_position(indices.x), mesh_position(indices.y), mesh_position(indices.z));
}

/// Decoded unit normal; 0 when the vertex has none.
fn mesh_normal(vertex: u32) -> vec3<f32> {
    if PLAIN_NORMALS { return vec3_at(scene.at_normals + 3u * vertex); }
    let code = record_normal(word(scene.at_records + RECORD_WORDS * vertex + 1u));
    if OCT_NORMALS { return oct_normal(code); }
    if code >= NORMAL_ENTRIES { return vec3<f32>(0.0); }
    return vec3_at(scene.at_normal_table + 3u * code);
}

/// Decoded texture coordinates.
fn mesh_uv(vertex: u32) -> vec2<f32> {
    if PLAIN_UVS { return bitcast<vec2<f32>>(vec2<u32>(word(scene.at_uvs + 2u * vertex), word(scene.at_uvs + 2u * vertex + 1u))); }
    let at = scene.at_records + RECORD_WORDS * vertex;
    if !HAS_SIDE_UVS || !record_has_side_uv(word(at)) { return record_uv(word(at + 2u)); }

    // Look the vertex up in the side table, which ascends.
    var low = 0u;
    var high = scene.side_uv_count;
    loop {
        if high - low <= 1u { break; }
        let middle = (low + high) / 2u;
        if word(scene.at_side_uvs + 3u * middle) <= vertex { low = middle; } else { high = middle; }
    }
    let entry = scene.at_side_uvs + 3u * low;
    return bitcast<vec2<f32>>(vec2<u32>(word(entry + 1u), word(entry + 2u)));
}

/// Linear vertex colour and alpha.
fn mesh_color(vertex: u32) -> vec4<f32> {
    let code = word(scene.at_colors + vertex);
    return vec4<f32>(
        srgb_linear(code & 255u), srgb_linear((code >> 8u) & 255u), srgb_linear((code >> 16u) & 255u),
        quotient(f32(code >> 24u), 255.0),
    );
}

/// The linear value of an 8-bit sRGB code.
fn srgb_linear(code: u32) -> f32 {
    return float_at(scene.at_srgb + code);
}

/// The least linear value whose 8-bit sRGB code is at least `code`, 1 to 255.
fn srgb_threshold(code: u32) -> f32 {
    return float_at(scene.at_thresholds + code);
}

/// The last of `count` runs at `at` that begins at or before `id`: its beginning and its value.
fn run_of(at: u32, count: u32, id: u32) -> vec2<u32> {
    var low = 0u;
    var high = count;
    loop {
        if high - low <= 1u { break; }
        let middle = (low + high) / 2u;
        if word(at + 2u * middle) <= id { low = middle; } else { high = middle; }
    }
    return vec2<u32>(word(at + 2u * low), word(at + 2u * low + 1u));
}

fn material_of(id: u32) -> u32 {
    if ONE_MATERIAL { return word(scene.at_material_runs + 1u); }
    return run_of(scene.at_material_runs, scene.material_run_count, id).y;
}

/// The id of a packed triangle in the flattened scene.
fn original_id(id: u32) -> u32 {
    let run = run_of(scene.at_id_runs, scene.id_run_count, id);
    return run.y + (id - run.x);
}

struct Material {
    base_color: vec4<f32>,
    specular: vec3<f32>,
    metallic: f32,
    emissive: vec3<f32>,
    roughness: f32,
    transmission: f32,
    ior: f32,
    alpha_cutoff: f32,
    flags: u32,
    base_texture: u32,
    metallic_roughness_texture: u32,
    emissive_texture: u32,
    transmission_texture: u32,
}

const MATERIAL_WORDS: u32 = 20u;

fn material_at(i: u32) -> Material {
    let at = scene.at_materials + MATERIAL_WORDS * i;
    return Material(
        vec4<f32>(vec3_at(at), float_at(at + 3u)), vec3_at(at + 4u), float_at(at + 7u), vec3_at(at + 8u), float_at(at + 11u),
        float_at(at + 12u), float_at(at + 13u), float_at(at + 14u), word(at + 15u), word(at + 16u), word(at + 17u), word(at + 18u),
        word(at + 19u),
    );
}

fn material_flags_at(i: u32) -> u32 {
    return word(scene.at_materials + MATERIAL_WORDS * i + 15u);
}

fn material_transmission_at(i: u32) -> f32 {
    return float_at(scene.at_materials + MATERIAL_WORDS * i + 12u);
}

const DOUBLE_SIDED: u32 = 1u;
const UNLIT: u32 = 2u;
const ALPHA_MASK: u32 = 4u;
const ALPHA_BLEND: u32 = 8u;
const THIN_WALLED: u32 = 16u;

const NO_TEXTURE: u32 = 0xffffffffu;

struct Texture {
    first_texel: u32,
    width: u32,
    height: u32,
    sampling: u32,
}

fn texture_at(i: u32) -> Texture {
    let at = scene.at_textures + 4u * i;
    return Texture(word(at), word(at + 1u), word(at + 2u), word(at + 3u));
}

/// RGBA8, red in bits 0..=7.
fn texel_word(i: u32) -> u32 {
    return word(scene.at_texels + i);
}

struct Light {
    position: vec3<f32>,
    kind: u32,
    direction: vec3<f32>,
    range: f32,
    intensity: vec3<f32>,
    cos_inner: f32,
    cos_outer: f32,
}

fn light_at(i: u32) -> Light {
    let at = scene.at_lights + 16u * i;
    return Light(
        vec3_at(at), word(at + 3u), vec3_at(at + 4u), float_at(at + 7u), vec3_at(at + 8u), float_at(at + 11u), float_at(at + 12u),
    );
}
