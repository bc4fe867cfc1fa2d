//! What a ray has hit: where, which way it faces, and what it is painted with.

use crate::scene::Renderer;
use crate::texture::Coding;
use tessera_geometry::mutation::{Mutation, is_on, unless};
use tessera_geometry::{DVec3, Hit, Vec3, rounding::gamma};
use tessera_pack::{Material, MaterialFlags};

/// Place and orientation of a hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    /// The hit point.
    pub point: Vec3,
    /// Bound of its error along each axis.
    pub error: Vec3,
    /// Unit geometric normal, on the side from which the ray came.
    pub facing: Vec3,
    /// Unit shading normal; within 90 degrees of `facing` and of the direction back to the ray's origin.
    pub shading: Vec3,
    /// Whether the ray came from the side on which the triangle winds counter-clockwise.
    pub from_front: bool,
}

/// A material with its textures and vertex colours applied.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paint {
    pub base: Vec3,
    /// Coverage: 1 unless the material blends.
    pub alpha: f32,
    pub specular: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    pub transmission: f32,
    pub ior: f32,
    pub emissive: Vec3,
    pub unlit: bool,
    pub thin_walled: bool,
}

/// The surface at `hit`, met by a ray along `direction`.
pub(crate) fn surface_at(scene: &Renderer<'_>, hit: &Hit, direction: Vec3) -> Surface {
    // Compute the point from the weights. Products and sums round 3 times, and the weights sum to 1 within 2
    // roundings, which moves the point by 2 roundings of itself: at most gamma(7) * sum |b_i v_i| (Pharr, Jakob,
    // Humphreys, section 6.8.5).
    let indices = scene.mesh.indices(hit.triangle);
    let corners = indices.map(|v| scene.mesh.position(v));
    let weights = [1.0 - hit.b1 - hit.b2, hit.b1, hit.b2];
    let [a, b, c] = [corners[0] * weights[0], corners[1] * weights[1], corners[2] * weights[2]];
    let point = a + b + c;
    let error = (a.abs() + b.abs() + c.abs()) * gamma(7);
    let error = unless(Mutation::PointErrorTimes10, error, error * 10.0);
    let error = unless(Mutation::PointErrorTimes1000, error, error * 1000.0);
    let error = unless(Mutation::PointErrorTenth, error, error * 0.1);

    // Turn the geometric normal towards the ray's origin.
    let normal = geometric_normal(corners);
    let from_front = meets_front(normal, direction);
    let facing = if from_front { normal } else { -normal };

    // Interpolate the shading normal and keep it on the same side.
    let mut shading = facing;
    if scene.needs.normals
        && let [Some(na), Some(nb), Some(nc)] = indices.map(|v| scene.mesh.normal(v))
    {
        let mixed = na * weights[0] + nb * weights[1] + nc * weights[2];
        let sided = if mixed.dot(facing) < 0.0 { -mixed } else { mixed };
        shading = lean_to_viewer(sided.try_normalize().unwrap_or(facing), -direction);
    }
    Surface { point, error, facing, shading, from_front }
}

/// Unit normal of a triangle on the side on which its corners run counter-clockwise. In `f64`, where the differences
/// and products of coordinates below 2^24 are exact, so that slivers keep their direction.
pub(crate) fn geometric_normal(corners: [Vec3; 3]) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    (b - a).cross(c - a).try_normalize().unwrap_or(DVec3::Y).as_vec3()
}

/// Whether a ray along `direction` comes to the side of a triangle where its `normal` is; a ray in its plane counts as one
/// that does.
pub(crate) fn meets_front(normal: Vec3, direction: Vec3) -> bool {
    direction.dot(normal) <= 0.0
}

/// By how much a shading normal is seen at least.
pub(crate) const LEAST_COSINE: f32 = 1.0 / 1024.0;

/// A shading normal that faces away from the viewer, as happens beside the silhouette of a coarse mesh, leans back
/// until it is just seen: by 2^-10, far above the 2^-22 by which the cosine is rounded, and less than a tenth of a
/// degree.
fn lean_to_viewer(normal: Vec3, view: Vec3) -> Vec3 {
    let cosine = normal.dot(view);
    if cosine >= LEAST_COSINE { normal } else { (normal + view * (LEAST_COSINE - cosine)).normalize() }
}

/// A ray's origin at `surface`, moved off it along `side` (the geometric normal or its opposite) by the point's
/// error, so that the ray meets the same plane no more (Pharr, Jakob, Humphreys, section 6.8.6).
pub(crate) fn offset_origin(surface: &Surface, side: Vec3) -> Vec3 {
    // Move by the extent of the error box along the normal.
    let side = unless(Mutation::OffsetWrongSide, side, -side);
    let moved = surface.point + side * side.abs().dot(surface.error);

    // Round away from the surface.
    let away = |at: f32, side: f32| match side {
        s if s > 0.0 => at.next_up(),
        s if s < 0.0 => at.next_down(),
        _ => at,
    };
    Vec3::new(away(moved.x, side.x), away(moved.y, side.y), away(moved.z, side.z))
}

/// Where hits of a ray from `surface` begin. The offset clears the surface itself, not a neighbour at a concave edge:
/// a point on the edge may lie behind the neighbour's plane by its error. The sum of the error over the axes clears
/// neighbours that the ray leaves steeper than about 20 degrees (sine 1/3, for equal errors). It lets light pass
/// under what touches the surface for at most 6e-7 of the scene's side: 0.7 of a voxel at 1024 cells a side.
pub(crate) fn clearance(surface: &Surface) -> f32 {
    if is_on(Mutation::NoClearance) { 0.0 } else { surface.error.x + surface.error.y + surface.error.z }
}

/// The material at `hit`.
pub(crate) fn paint_at(scene: &Renderer<'_>, hit: &Hit) -> Paint {
    // Start from the factors.
    let m: &Material = scene.material(hit.triangle);
    let mut paint = Paint {
        base: Vec3::from_slice(&m.base_color[..3]),
        alpha: m.base_color[3],
        specular: m.specular.into(),
        metallic: m.metallic,
        roughness: m.roughness,
        transmission: m.transmission,
        ior: m.ior,
        emissive: m.emissive.into(),
        unlit: m.flags & MaterialFlags::UNLIT != 0,
        thin_walled: m.flags & MaterialFlags::THIN_WALLED != 0,
    };

    // Multiply by the vertex colour.
    let indices = scene.mesh.indices(hit.triangle);
    if scene.needs.colors {
        let [r, g, b, a] = scene.color_at(indices, hit);
        paint.base *= Vec3::new(r, g, b);
        paint.alpha *= a;
    }

    // Multiply by the textures.
    if scene.needs.uvs {
        let uv = scene.uv_at(indices, hit);
        let (color, alpha) = scene.texture(m.base_texture, uv, Coding::Srgb);
        paint.base *= color;
        paint.alpha *= alpha;
        let (rough_metal, _) = scene.texture(m.metallic_roughness_texture, uv, Coding::Linear);
        paint.roughness *= rough_metal.y;
        paint.metallic *= rough_metal.z;
        paint.emissive *= scene.texture(m.emissive_texture, uv, Coding::Srgb).0;
        paint.transmission *= scene.texture(m.transmission_texture, uv, Coding::Linear).0.x;
    }

    // Alpha covers only where the material blends.
    if m.flags & MaterialFlags::ALPHA_BLEND == 0 {
        paint.alpha = 1.0;
    }
    paint
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_on_triangle_is_met_in_front() {
        assert!(meets_front(Vec3::Y, Vec3::NEG_Y) && !meets_front(Vec3::Y, Vec3::Y));
        assert!(meets_front(Vec3::Y, Vec3::X) && meets_front(Vec3::NEG_Y, Vec3::X));
    }
}
