//! Who is measured: our kernels over packs of the mesh, and obvhs over the mesh itself.

use super::clock::{Cost, Watch};
use super::mesh::Mesh;
use super::ray_set::{WorldHit, WorldRay};
use crate::commands::CommandError;
use tessera_geometry::wide::LANES;
use tessera_geometry::{Hit, LocalFrame, Ray};
use tessera_kdtree::BuildOptions;
use tessera_pack::{Pack, PackOptions, PackStage, Plain, build_pack_with, format::Section};

/// A structure that answers rays. What it needs to turn a world ray into one of its own, and its hit back, is part of the answer.
pub trait Peer: Sync {
    /// Library or structure, variant, kernel.
    fn name(&self) -> String;
    /// Peers with the same twin hold the same geometry and must answer with the same bits.
    fn twin(&self) -> Option<&'static str>;
    fn build_cost(&self) -> Cost;
    /// Bytes that the search structure keeps.
    fn accel_bytes(&self) -> u64;
    /// The same and the triangles that must stay to answer.
    fn total_bytes(&self) -> u64;
    /// The closest hit of each ray.
    fn closest(&self, rays: &[WorldRay], hits: &mut [WorldHit]);
    /// 1 for each ray that hits anything, else 0.
    fn occluded(&self, rays: &[WorldRay], blocked: &mut [u8]);
}

/// How the rays of a chunk go through our tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kernel {
    /// One ray after the other.
    Scalar,
    /// Eight rays at once, with the best instructions of this machine.
    Wide,
}

impl Kernel {
    pub const ALL: [Self; 2] = [Self::Scalar, Self::Wide];

    fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Wide => "wide8",
        }
    }

    fn of_tree(self) -> tessera_kdtree::Kernel {
        match self {
            Self::Scalar => tessera_kdtree::Kernel::Scalar,
            Self::Wide => tessera_kdtree::Kernel::wide(),
        }
    }
}

/// A pack of the mesh, traced in voxel units.
pub struct Ours {
    pack: Pack,
    frame: LocalFrame,
    voxels_per_unit: f64,
    max_refs: u32,
    is_plain: bool,
    kernel: Kernel,
    build: Cost,
}

impl Ours {
    /// Packs `mesh` and returns a peer for each kernel.
    pub fn build(
        mesh: &Mesh,
        max_refs: u32,
        is_plain: bool,
        kernels: &[Kernel],
    ) -> Result<Vec<Self>, CommandError> {
        let options = PackOptions {
            plain: Plain { positions: is_plain, ..Plain::default() },
            tree: BuildOptions { max_refs, ..BuildOptions::default() },
            ..PackOptions::default()
        };
        let input = mesh.pack_input();
        // The tree's own cost is what others call building: watch it alone.
        let mut watch = Watch::start();
        let mut build = Cost::default();
        let on_stage = |stage| match stage {
            PackStage::Tree => watch = Watch::start(),
            PackStage::Assemble => build = watch.read(),
            _ => {}
        };
        let (packed, _) = Cost::of(1, || build_pack_with(input, &options, on_stage))?;
        let (pack, _) = packed.map_err(|e| CommandError::Failed(format!("{}: {e}", mesh.name)))?;
        let frame = pack.frame();
        let voxels_per_unit = frame.step.recip();
        let peer =
            |&kernel| Self { pack: pack.clone(), frame, voxels_per_unit, max_refs, is_plain, kernel, build };
        Ok(kernels.iter().map(peer).collect())
    }

    fn to_local(&self, ray: &WorldRay) -> Ray {
        let local = |t: f32| (f64::from(t) * self.voxels_per_unit) as f32;
        Ray {
            origin: self.frame.to_local(ray.origin.as_dvec3()),
            direction: ray.direction,
            t_min: local(ray.t_min),
            t_max: local(ray.t_max),
        }
    }

    /// Up to eight rays as a packet, and which of its lanes they are.
    fn packet(&self, rays: &[WorldRay]) -> ([Ray; LANES], u8) {
        let local = std::array::from_fn(|lane| self.to_local(&rays[lane.min(rays.len() - 1)]));
        (local, u8::MAX >> (LANES - rays.len()))
    }

    fn to_world(&self, hit: Option<Hit>) -> WorldHit {
        hit.map_or(WorldHit::MISS, |hit| WorldHit {
            t: (f64::from(hit.t) * self.frame.step) as f32,
            triangle: self.pack.original_id(hit.triangle),
        })
    }
}

impl Peer for Ours {
    fn name(&self) -> String {
        let plain = if self.is_plain { "-plain" } else { "" };
        format!("tessera/kd{}{plain}/{}", self.max_refs, self.kernel.name())
    }

    fn twin(&self) -> Option<&'static str> {
        Some(if self.is_plain { "plain" } else { "quantised" })
    }

    fn build_cost(&self) -> Cost {
        self.build
    }

    fn accel_bytes(&self) -> u64 {
        self.pack.section_bytes(Section::Slots) + self.pack.section_bytes(Section::List)
    }

    fn total_bytes(&self) -> u64 {
        self.pack.bytes().len() as u64
    }

    fn closest(&self, rays: &[WorldRay], hits: &mut [WorldHit]) {
        let (tree, mesh, kernel) = (self.pack.tree(), self.pack.mesh(), self.kernel.of_tree());
        match self.kernel {
            Kernel::Scalar => {
                for (ray, hit) in rays.iter().zip(hits) {
                    *hit = self.to_world(tree.closest_hit(&mesh, &self.to_local(ray), |_| true));
                }
            }
            Kernel::Wide => {
                for (rays, hits) in rays.chunks(LANES).zip(hits.chunks_mut(LANES)) {
                    let (packet, lanes) = self.packet(rays);
                    let found = tree.closest_hits(kernel, &mesh, &packet, lanes);
                    hits.iter_mut().zip(found).for_each(|(hit, found)| *hit = self.to_world(found));
                }
            }
        }
    }

    fn occluded(&self, rays: &[WorldRay], blocked: &mut [u8]) {
        let (tree, mesh, kernel) = (self.pack.tree(), self.pack.mesh(), self.kernel.of_tree());
        match self.kernel {
            Kernel::Scalar => {
                for (ray, blocked) in rays.iter().zip(blocked) {
                    *blocked = tree.any_hit(&mesh, &self.to_local(ray), |_| true).into();
                }
            }
            Kernel::Wide => {
                for (rays, blocked) in rays.chunks(LANES).zip(blocked.chunks_mut(LANES)) {
                    let (packet, lanes) = self.packet(rays);
                    let found = tree.any_hits(kernel, &mesh, &packet, lanes);
                    (0..).zip(blocked).for_each(|(lane, blocked)| *blocked = found >> lane & 1);
                }
            }
        }
    }
}
