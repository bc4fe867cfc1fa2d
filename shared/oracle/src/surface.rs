//! What a ray has hit: where, which way it faces, and what it is painted with.

use crate::oracle::Oracle;
use crate::texture::{Coding, light_of};
use crate::triangle::{Hit, PLACE_ERROR, Ray, Start, normal};
use glam::DVec3;
use tessera_scene::{AlphaMode, Material, TextureRef};

/// Place and orientation of a hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub point: DVec3,
    /// Unit geometric normal, on the side from which the ray came.
    pub facing: DVec3,
    /// Unit shading normal, seen by the viewer and on the same side.
    pub shading: DVec3,
    /// Whether the ray came from the side on which the triangle winds counter-clockwise.
    pub from_front: bool,
    id: u32,
}

/// A material with its textures and vertex colours applied.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paint {
    pub base: DVec3,
    /// Coverage: 1 unless the material blends.
    pub alpha: f64,
    pub specular: DVec3,
    pub metallic: f64,
    pub roughness: f64,
    pub transmission: f64,
    pub ior: f64,
    pub emissive: DVec3,
    pub unlit: bool,
    pub thin_walled: bool,
}

/// By how much a shading normal is seen at least: part of the model, not a bound of an error.
const LEAST_COSINE: f64 = 1.0 / 1024.0;

impl Oracle {
    /// The surface at `hit`, met by a ray along `direction`.
    pub(crate) fn surface(&self, hit: &Hit, direction: DVec3) -> Surface {
        let corners = self.corners(hit.id);
        let point = mix(hit, corners);
        let own = self.normal(hit.id);
        let from_front = is_front(own, direction);
        let facing = if from_front { own } else { -own };

        // Take the vertices' normals where all three have one, on the side of the viewer, and seen by him.
        let shading = self.vertex_normals(hit.id).and_then(|normals| {
            let mixed = mix(hit, normals);
            (if mixed.dot(facing) < 0.0 { -mixed } else { mixed }).try_normalize()
        });
        let shading = shading.unwrap_or(facing);
        let seen = -direction.dot(shading);
        let shading = if seen < LEAST_COSINE {
            (shading - direction * (LEAST_COSINE - seen)).normalize()
        } else {
            shading
        };
        Surface { point, facing, shading, from_front, id: hit.id }
    }

    /// The paint at `hit`.
    pub(crate) fn paint(&self, hit: &Hit) -> Paint {
        let material = self.material(hit.id);
        let [r, g, b, a] = material.base_color.map(f64::from);
        let mut paint = Paint {
            base: DVec3::new(r, g, b),
            alpha: a,
            specular: vector(material.specular),
            metallic: f64::from(material.metallic),
            roughness: f64::from(material.roughness),
            transmission: f64::from(material.transmission),
            ior: f64::from(material.ior),
            emissive: vector(material.emissive),
            unlit: material.unlit,
            thin_walled: material.thin_walled,
        };
        if let Some((color, alpha)) = self.vertex_color(hit) {
            paint.base *= color;
            paint.alpha *= alpha;
        }
        if let Some(uv) = self.uv(hit) {
            let look = |texture: &Option<TextureRef>, coding| match texture {
                Some(texture) => self.picture(texture).at(uv, texture, coding),
                None => (DVec3::ONE, 1.0),
            };
            let (color, alpha) = look(&material.base_texture, Coding::Srgb);
            paint.base *= color;
            paint.alpha *= alpha;
            let rough_metal = look(&material.metallic_roughness_texture, Coding::Linear).0;
            paint.roughness *= rough_metal.y;
            paint.metallic *= rough_metal.z;
            paint.emissive *= look(&material.emissive_texture, Coding::Srgb).0;
            paint.transmission *= look(&material.transmission_texture, Coding::Linear).0.x;
        }
        if material.alpha != AlphaMode::Blend {
            paint.alpha = 1.0;
        }
        paint
    }

    /// Whether a mask cuts a hole at `hit`.
    pub(crate) fn is_hole(&self, hit: &Hit) -> bool {
        let material = self.material(hit.id);
        let AlphaMode::Mask(cutoff) = material.alpha else { return false };
        let mut alpha = f64::from(material.base_color[3]);
        if let Some((_, vertex_alpha)) = self.vertex_color(hit) {
            alpha *= vertex_alpha;
        }
        if let (Some(texture), Some(uv)) = (&material.base_texture, self.uv(hit)) {
            alpha *= self.picture(texture).at(uv, texture, Coding::Linear).1;
        }
        alpha < f64::from(cutoff)
    }

    /// Whether a ray that looks along `direction` passes `hit` for meeting a back that does not show.
    pub(crate) fn is_hidden_back(&self, hit: &Hit, direction: DVec3) -> bool {
        let material = self.material(hit.id);
        let has_back = material.double_sided || material.transmission > 0.0;
        !has_back && !is_front(self.normal(hit.id), direction)
    }

    /// The unit normal of a triangle that was hit, and so has an area; slivers whose cross product vanishes face up.
    pub(crate) fn normal(&self, id: u32) -> DVec3 {
        normal(&self.corners(id)).unwrap_or(DVec3::Y)
    }

    fn vertex_normals(&self, id: u32) -> Option<[DVec3; 3]> {
        let normals = self.mesh.triangles[id as usize]
            .map(|vertex| self.mesh.normals.get(vertex as usize).map_or(DVec3::ZERO, |&n| vector(n)));
        let is_there = |normal: &DVec3| *normal != DVec3::ZERO && normal.is_finite();
        normals.iter().all(is_there).then_some(normals)
    }

    /// Linear colour and alpha of the vertices.
    fn vertex_color(&self, hit: &Hit) -> Option<(DVec3, f64)> {
        if self.mesh.colors.is_empty() {
            return None;
        }
        let [a, b, c] = self.mesh.triangles[hit.id as usize].map(|vertex| self.mesh.colors[vertex as usize]);
        let color = |[r, g, b, _]: [u8; 4]| DVec3::new(light_of(r), light_of(g), light_of(b));
        let alpha = hit.weights[0] * f64::from(a[3])
            + hit.weights[1] * f64::from(b[3])
            + hit.weights[2] * f64::from(c[3]);
        Some((mix(hit, [color(a), color(b), color(c)]), alpha / 255.0))
    }

    /// Texture coordinates; those that are no numbers count as 0.
    fn uv(&self, hit: &Hit) -> Option<[f64; 2]> {
        if self.mesh.uvs.is_empty() {
            return None;
        }
        let uvs = self.mesh.triangles[hit.id as usize].map(|vertex| self.mesh.uvs[vertex as usize]);
        let axis = |k: usize| {
            let place =
                |corner: usize| if uvs[corner][k].is_finite() { f64::from(uvs[corner][k]) } else { 0.0 };
            hit.weights[0] * place(0) + hit.weights[1] * place(1) + hit.weights[2] * place(2)
        };
        Some([axis(0), axis(1)])
    }

    /// A ray that leaves `surface` along the unit vector `direction`, and where its hits begin.
    ///
    /// Its own triangle is left out by name: a straight line that leaves a plane does not come back to it. Of others that
    /// touch there the ray may start on the wrong side: the point lies within [`PLACE_ERROR`] of the scene's size of the true
    /// place, and a distance is off by as much, both across the plane. A ray climbs twice that over a plane, at an angle
    /// whose sine is `s`, within `2 PLACE_ERROR / s`. `s` counts as at least 2^-20: what is seen of a surface that flatly is less than
    /// a millionth of its light.
    pub(crate) fn leave(&self, surface: &Surface, direction: DVec3) -> (Ray, Start) {
        let sine = direction.dot(surface.facing).abs().max(1.0 / f64::from(1 << 20));
        let start = Start { t: 2.0 * PLACE_ERROR * self.size / sine, id: u32::MAX, leaves: surface.id };
        (Ray::new(surface.point, direction), start)
    }
}

/// Whether light passes a surface of this material other than through a hole. Textures only lower a share.
pub(crate) fn lets_light_through(material: &Material) -> bool {
    material.alpha == AlphaMode::Blend || (material.transmission > 0.0 && !material.unlit)
}

fn is_front(normal: DVec3, direction: DVec3) -> bool {
    direction.dot(normal) <= 0.0
}

/// The mean of the corners' values, weighed for the place of `hit`.
fn mix(hit: &Hit, [a, b, c]: [DVec3; 3]) -> DVec3 {
    a * hit.weights[0] + b * hit.weights[1] + c * hit.weights[2]
}

pub(crate) fn vector(values: [f32; 3]) -> DVec3 {
    DVec3::from_array(values.map(f64::from))
}
