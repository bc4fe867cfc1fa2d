//! The yardstick: obvhs' compressed wide BVH (Ylitie, Karras, Laine 2017) over the mesh itself, triangles in leaf order as its
//! documentation asks.

use super::clock::Cost;
use super::mesh::Mesh;
use super::peer::Peer;
use super::ray_set::{WorldHit, WorldRay};
use crate::commands::CommandError;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use tessera_geometry::Vec3;

/// The tree, the triangles in its order, and what it took.
pub struct Obvhs {
    bvh: CwBvh,
    triangles: Vec<RtTriangle>,
    build: Cost,
}

impl Obvhs {
    pub fn build(mesh: &Mesh) -> Result<Self, CommandError> {
        let list = triangles(mesh.triangles.len() as u32, |id| mesh.corners(id));
        let (bvh, build) = Cost::of(1, || build_cwbvh(&list))?;
        let in_order = |&i: &u32| {
            let t = &list[i as usize];
            RtTriangle::new(t.v0, t.v1, t.v2)
        };
        let triangles = bvh.primitive_indices.iter().map(in_order).collect();
        Ok(Self { bvh, triangles, build })
    }
}

/// `count` triangles, whose corners `corners` returns, as obvhs takes them.
pub fn triangles(count: u32, corners: impl Fn(u32) -> [Vec3; 3]) -> Vec<Triangle> {
    let triangle = |[a, b, c]: [Vec3; 3]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() };
    (0..count).map(|id| triangle(corners(id))).collect()
}

/// With the middle one of its presets.
pub fn build_cwbvh(triangles: &[Triangle]) -> CwBvh {
    build_cwbvh_from_tris(triangles, BvhBuildParams::medium_build(), &mut Default::default())
}

/// Bytes that a tree keeps.
pub fn tree_bytes(bvh: &CwBvh) -> u64 {
    (size_of_val(bvh.nodes.as_slice()) + size_of_val(bvh.primitive_indices.as_slice())) as u64
}

fn to_obvhs(ray: &WorldRay) -> Ray {
    Ray::new(ray.origin.into(), ray.direction.into(), ray.t_min, ray.t_max)
}

impl Peer for Obvhs {
    fn name(&self) -> String {
        "obvhs-0.4/cwbvh-medium/single".into()
    }

    fn twin(&self) -> Option<&'static str> {
        None
    }

    fn build_cost(&self) -> Cost {
        self.build
    }

    fn accel_bytes(&self) -> u64 {
        tree_bytes(&self.bvh)
    }

    fn total_bytes(&self) -> u64 {
        self.accel_bytes() + size_of_val(self.triangles.as_slice()) as u64
    }

    fn closest(&self, rays: &[WorldRay], hits: &mut [WorldHit]) {
        for (ray, hit) in rays.iter().zip(hits) {
            let mut found = RayHit::none();
            self.bvh.ray_traverse(to_obvhs(ray), &mut found, |ray, i| self.triangles[i].intersect(ray));
            *hit = if found.t.is_finite() && found.primitive_id != u32::MAX {
                WorldHit { t: found.t, triangle: self.bvh.primitive_indices[found.primitive_id as usize] }
            } else {
                WorldHit::MISS
            };
        }
    }

    fn occluded(&self, rays: &[WorldRay], blocked: &mut [u8]) {
        for (ray, blocked) in rays.iter().zip(blocked) {
            let missed = self.bvh.ray_traverse_miss(to_obvhs(ray), |ray, i| self.triangles[i].intersect(ray));
            *blocked = (!missed).into();
        }
    }
}
