// Sibling of surface.rs and of the parts of scene.rs that look at one triangle.

struct Surface {
    /// The hit point, and the bound of its error along each axis.
    at: vec3<f32>,
    error: vec3<f32>,
    /// Unit geometric normal, on the side from which the ray came.
    facing: vec3<f32>,
    /// Unit shading normal.
    shading: vec3<f32>,
    from_front: bool,
}

/// A material with its textures and vertex colours applied.
struct Paint {
    base: vec3<f32>,
    alpha: f32,
    specular: vec3<f32>,
    metallic: f32,
    emissive: vec3<f32>,
    roughness: f32,
    transmission: f32,
    ior: f32,
    unlit: bool,
    thin_walled: bool,
}

/// gamma(7), as in surface.rs.
const POINT_ERROR: f32 = 4.1723268e-7;

fn surface_at(hit: Hit, direction: vec3<f32>) -> Surface {
    // Compute the point from the weights.
    let indices = mesh_indices(hit.triangle);
    let corners = Corners(mesh_position(indices.x), mesh_position(indices.y), mesh_position(indices.z));
    let b0 = 1.0 - hit.b1 - hit.b2;
    let a = scaled(corners.a, b0);
    let b = scaled(corners.b, hit.b1);
    let c = scaled(corners.c, hit.b2);
    let at = a + b + c;
    let error = scaled(abs(a) + abs(b) + abs(c), POINT_ERROR);

    // Turn the geometric normal towards the ray's origin.
    let normal = geometric_normal(corners.a, corners.b, corners.c);
    let from_front = meets_front(normal, direction);
    let facing = select(-normal, normal, from_front);

    // Interpolate the shading normal and keep it on the same side.
    var shading = facing;
    if HAS_NORMALS {
        let na = mesh_normal(indices.x);
        let nb = mesh_normal(indices.y);
        let nc = mesh_normal(indices.z);
        let none = vec3<f32>(0.0);
        if any(na != none) && any(nb != none) && any(nc != none) {
            let mix = scaled(na, b0) + scaled(nb, hit.b1) + scaled(nc, hit.b2);
            let sided = select(mix, -mix, dot3(mix, facing) < 0.0);
            shading = lean_to_viewer(normalized_or(sided, facing), -direction);
        }
    }
    return Surface(at, error, facing, shading, from_front);
}

fn meets_front(normal: vec3<f32>, direction: vec3<f32>) -> bool {
    return dot3(direction, normal) <= 0.0;
}

const LEAST_COSINE: f32 = 9.765625e-4;

fn lean_to_viewer(normal: vec3<f32>, view: vec3<f32>) -> vec3<f32> {
    let cosine = dot3(normal, view);
    if cosine >= LEAST_COSINE { return normal; }
    return normalized(normal + scaled(view, LEAST_COSINE - cosine));
}

/// A ray's origin at a surface, moved off it along `side` by the point's error.
fn offset_origin(surface: Surface, side: vec3<f32>) -> vec3<f32> {
    // Move by the extent of the error box along the normal.
    let moved = surface.at + scaled(side, dot3(abs(side), surface.error));

    // Round away from the surface.
    return vec3<f32>(away(moved.x, side.x), away(moved.y, side.y), away(moved.z, side.z));
}

fn away(at: f32, side: f32) -> f32 {
    return select(select(at, below(at), side < 0.0), above(at), side > 0.0);
}

/// Where hits of a ray from a surface begin.
fn clearance(surface: Surface) -> f32 {
    return surface.error.x + surface.error.y + surface.error.z;
}

/// The interpolated texture coordinates.
fn uv_at(indices: vec3<u32>, hit: Hit) -> vec2<f32> {
    let a = mesh_uv(indices.x);
    let b = mesh_uv(indices.y);
    let c = mesh_uv(indices.z);
    let b0 = 1.0 - hit.b1 - hit.b2;
    return vec2<f32>(
        times(a.x, b0) + times(b.x, hit.b1) + times(c.x, hit.b2),
        times(a.y, b0) + times(b.y, hit.b1) + times(c.y, hit.b2),
    );
}

/// The interpolated linear vertex colour.
fn color_at(indices: vec3<u32>, hit: Hit) -> vec4<f32> {
    let a = mesh_color(indices.x);
    let b = mesh_color(indices.y);
    let c = mesh_color(indices.z);
    let color = a.xyz + scaled(b.xyz - a.xyz, hit.b1) + scaled(c.xyz - a.xyz, hit.b2);
    return vec4<f32>(color, a.w + times(b.w - a.w, hit.b1) + times(c.w - a.w, hit.b2));
}

/// The material at a hit.
fn paint_at(hit: Hit) -> Paint {
    // Start from the factors.
    let m = material_at(material_of(hit.triangle));
    var paint = Paint(
        m.base_color.xyz, m.base_color.w, m.specular, m.metallic, m.emissive, m.roughness, m.transmission, m.ior,
        (m.flags & UNLIT) != 0u, (m.flags & THIN_WALLED) != 0u,
    );

    // Multiply by the vertex colour.
    let indices = mesh_indices(hit.triangle);
    if HAS_COLORS {
        let color = color_at(indices, hit);
        paint.base *= color.xyz;
        paint.alpha *= color.w;
    }

    // Multiply by the textures. (A loop, so that the kernel holds one look-up and not four.)
    if HAS_UVS {
        let uv = uv_at(indices, hit);
        for (var slot = 0u; slot < 4u; slot++) {
            let is_color = slot == 0u || slot == 2u;
            let image = select(
                select(m.base_texture, m.metallic_roughness_texture, slot == 1u),
                select(m.emissive_texture, m.transmission_texture, slot == 3u),
                slot >= 2u,
            );
            if image == NO_TEXTURE { continue; }
            let texel = lookup(image, uv, select(CODING_LINEAR, CODING_SRGB, is_color));
            switch slot {
                case 0u: {
                    paint.base *= texel.xyz;
                    paint.alpha *= texel.w;
                }
                case 1u: {
                    paint.roughness *= texel.y;
                    paint.metallic *= texel.z;
                }
                case 2u: { paint.emissive *= texel.xyz; }
                default: { paint.transmission *= texel.x; }
            }
        }
    }

    // Alpha covers only where the material blends.
    if (m.flags & ALPHA_BLEND) == 0u { paint.alpha = 1.0; }
    return paint;
}

/// Whether the surface is there, and not a hole cut out by a mask.
fn is_solid(hit: Hit) -> bool {
    // Opaque and blended materials have no holes.
    let index = material_of(hit.triangle);
    if (material_flags_at(index) & ALPHA_MASK) == 0u { return true; }

    // Compare alpha with the cut-off.
    let m = material_at(index);
    let indices = mesh_indices(hit.triangle);
    var alpha = m.base_color.w;
    if HAS_COLORS { alpha *= color_at(indices, hit).w; }
    if HAS_UVS && m.base_texture != NO_TEXTURE && alpha > 0.0 {
        alpha *= lookup_alpha(m.base_texture, uv_at(indices, hit));
    }
    return alpha >= m.alpha_cutoff;
}

/// Whether a ray along `direction` meets a hit on a side that is seen.
fn shows_side(hit: Hit, direction: vec3<f32>) -> bool {
    let index = material_of(hit.triangle);
    let hides_its_back = (material_flags_at(index) & DOUBLE_SIDED) == 0u && material_transmission_at(index) == 0.0;
    if !hides_its_back { return true; }
    let corners = corners_of(hit.triangle);
    return meets_front(geometric_normal(corners.a, corners.b, corners.c), direction);
}

/// Whether light may pass a surface of this material other than through a hole.
fn lets_light_through(index: u32) -> bool {
    let flags = material_flags_at(index);
    return (flags & ALPHA_BLEND) != 0u || (material_transmission_at(index) > 0.0 && (flags & UNLIT) == 0u);
}

/// Looks from the eye, a mirror or glass: holes and hidden backs are passed.
const LOOK: u32 = 0u;
/// Looks for anything that no light passes.
const OPAQUE: u32 = 1u;
/// Looks for the next surface that a shadow ray passes: holes excepted.
const LAYER: u32 = 2u;

/// Takes every hit.
const BARE: u32 = 3u;

/// Whether a hit counts for `query`: the closures of path.rs and light.rs.
fn accepts(query: Query, hit: Hit) -> bool {
    if query.after_triangle != NO_TRIANGLE && !precedes(query.after_t, query.after_triangle, hit.t, hit.triangle) { return false; }
    if HIDES_BACKS && query.kind == LOOK && !shows_side(hit, query.ray.direction) { return false; }
    if SEES_THROUGH && query.kind == OPAQUE && lets_light_through(material_of(hit.triangle)) { return false; }
    if HAS_HOLES && query.kind != BARE { return is_solid(hit); }
    return true;
}
