//! A pack made ready for rendering.

use crate::environment::Backdrop;
use crate::surface::{geometric_normal, meets_front};
use crate::texture::{Coding, Images};
use tessera_geometry::{Hit, Vec2, Vec3};
use tessera_kdtree::{Kernel, TreeView};
use tessera_pack::{Light, Material, MaterialFlags, MeshView, NO_TEXTURE, Pack};

/// A pack's views and what its content asks of the kernel, found once: O(materials), nothing per triangle.
///
/// Make one per pack and share it between threads; a worker renders all its tiles through one.
pub struct Renderer<'a> {
    pub(crate) tree: TreeView<'a>,
    pub(crate) mesh: MeshView<'a>,
    pub(crate) lights: &'a [Light],
    pub(crate) ambient: Vec3,
    pub(crate) backdrop: Backdrop<'a>,
    /// World units in a local unit.
    pub(crate) step: f64,
    pub(crate) needs: Needs,
    pub(crate) kernel: Kernel,
    pack: &'a Pack,
    materials: &'a [Material],
    images: Images<'a>,
}

/// Parts of the CPU's kernel that a scene without them skips. (Mirrors and glass are decided about at each hit.)
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// Some material has holes: every candidate hit is tested for one.
    pub holes: bool,
    /// Some material does not show from behind: every candidate hit of a ray that looks is tested for its side.
    pub hidden_backs: bool,
    /// Some material lets light through: a shadow ray steps from surface to surface.
    pub see_through: bool,
    /// There are vertex normals.
    pub normals: bool,
    /// There are texture coordinates, and a material that has a use for them.
    pub uvs: bool,
    /// There are vertex colours.
    pub colors: bool,
}

impl Needs {
    /// What `pack` asks for. O(materials).
    pub fn of(pack: &Pack) -> Self {
        let (mesh, materials) = (pack.mesh(), pack.materials());
        Self {
            holes: materials.iter().any(|m| m.flags & MaterialFlags::ALPHA_MASK != 0),
            hidden_backs: materials.iter().any(hides_its_back),
            see_through: materials.iter().any(lets_light_through),
            normals: mesh.has_normals(),
            uvs: mesh.has_uvs() && materials.iter().any(is_textured),
            colors: mesh.has_colors(),
        }
    }

    /// The same and `forced` besides. Whatever a pack holds, what it does not need changes no pixel: tests that every hit passes, normals
    /// that are not there, coordinates that no texture reads, a colour that is white.
    fn with(self, forced: Self, pack: &Pack) -> Self {
        // A texture without coordinates is not shown; with them it would be.
        let may_look_up = pack.mesh().has_uvs() || !pack.materials().iter().any(is_textured);
        Self {
            holes: self.holes || forced.holes,
            hidden_backs: self.hidden_backs || forced.hidden_backs,
            see_through: self.see_through || forced.see_through,
            normals: self.normals || forced.normals,
            uvs: self.uvs || (forced.uvs && may_look_up),
            colors: self.colors || forced.colors,
        }
    }
}

impl<'a> Renderer<'a> {
    /// Prepares `pack`, to be traced by the best kernel of this machine.
    pub fn new(pack: &'a Pack) -> Self {
        Self::with_kernel(pack, Kernel::auto())
    }

    /// Prepares `pack`, to be traced by `kernel`; the pixels are the same with each.
    pub fn with_kernel(pack: &'a Pack, kernel: Kernel) -> Self {
        Self::with_forced(pack, kernel, Needs::default())
    }

    /// The same with parts of the kernel forced in that `pack` may not need: the twin by which leaving them out is measured and tested. The
    /// pixels are the same.
    pub fn with_forced(pack: &'a Pack, kernel: Kernel, forced: Needs) -> Self {
        let (mesh, materials) = (pack.mesh(), pack.materials());
        let images = Images::new(pack.textures(), pack.texels());
        Self {
            tree: pack.tree(),
            mesh,
            lights: pack.lights(),
            ambient: pack.ambient().radiance.into(),
            backdrop: Backdrop::new(pack.environment(), images),
            step: pack.frame().step,
            needs: Needs::of(pack).with(forced, pack),
            kernel,
            pack,
            materials,
            images,
        }
    }

    /// The material of packed triangle `id`.
    pub(crate) fn material(&self, id: u32) -> &'a Material {
        &self.materials[self.pack.material_of(id) as usize]
    }

    pub(crate) fn triangle_count(&self) -> u32 {
        self.pack.triangle_count()
    }

    /// The flattened scene's id of packed triangle `id`.
    pub(crate) fn original_id(&self, id: u32) -> u32 {
        self.pack.original_id(id)
    }

    /// Colour and alpha of texture slot `slot` at `uv`, white where there is no texture.
    pub(crate) fn texture(&self, slot: u32, uv: Vec2, coding: Coding) -> (Vec3, f32) {
        if slot == NO_TEXTURE {
            return (Vec3::ONE, 1.0);
        }
        self.images.lookup(slot, uv, coding)
    }

    /// Whether the surface is there at `hit`, and not a hole cut out by a mask.
    pub(crate) fn is_solid(&self, hit: &Hit) -> bool {
        // Opaque and blended materials have no holes.
        let material = self.material(hit.triangle);
        if material.flags & MaterialFlags::ALPHA_MASK == 0 {
            return true;
        }

        // Compare alpha with the cut-off.
        self.mask_alpha(material, hit) >= material.alpha_cutoff
    }

    /// What [`Renderer::is_solid`] compares with the cut-off of `material`, which is that of `hit`.
    pub(crate) fn mask_alpha(&self, material: &Material, hit: &Hit) -> f32 {
        let indices = self.mesh.indices(hit.triangle);
        let mut alpha = material.base_color[3];
        if self.needs.colors {
            alpha *= self.color_at(indices, hit)[3];
        }
        if self.needs.uvs && material.base_texture != NO_TEXTURE && alpha > 0.0 {
            alpha *= self.images.lookup_alpha(material.base_texture, self.uv_at(indices, hit));
        }
        alpha
    }

    /// Whether a ray along `direction` meets `hit` on a side that is seen.
    pub(crate) fn shows_side(&self, hit: &Hit, direction: Vec3) -> bool {
        if !hides_its_back(self.material(hit.triangle)) {
            return true;
        }
        let corners = self.mesh.indices(hit.triangle).map(|v| self.mesh.position(v));
        meets_front(geometric_normal(corners), direction)
    }

    /// The interpolated texture coordinates, (0, 0) when nothing uses them.
    pub(crate) fn uv_at(&self, indices: [u32; 3], hit: &Hit) -> Vec2 {
        if !self.needs.uvs {
            return Vec2::ZERO;
        }
        let [a, b, c] = indices.map(|v| self.mesh.uv(v));
        a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2
    }

    /// The interpolated linear vertex colour; by differences, so that one colour at all corners is that colour everywhere, exactly: white
    /// changes nothing, and opaque stays opaque for a mask whose cut-off is 1.
    pub(crate) fn color_at(&self, indices: [u32; 3], hit: &Hit) -> [f32; 4] {
        let [a, b, c] = indices.map(|v| self.mesh.color(v));
        std::array::from_fn(|k| a[k] + (b[k] - a[k]) * hit.b1 + (c[k] - a[k]) * hit.b2)
    }
}

/// Whether light may pass a surface of this material other than through a hole. Textures can only lower a share, so
/// the factors decide.
pub(crate) fn lets_light_through(material: &Material) -> bool {
    let unlit = material.flags & MaterialFlags::UNLIT != 0;
    material.flags & MaterialFlags::ALPHA_BLEND != 0 || (material.transmission > 0.0 && !unlit)
}

/// Whether a surface of this material is not there for a ray that looks at its back. What transmits light keeps its
/// back, single-sided or not: a ray must meet the far side of a glass body from within.
pub(crate) fn hides_its_back(material: &Material) -> bool {
    material.flags & MaterialFlags::DOUBLE_SIDED == 0 && material.transmission == 0.0
}

pub(crate) fn is_textured(material: &Material) -> bool {
    [
        material.base_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
    ]
    .iter()
    .any(|&slot| slot != NO_TEXTURE)
}
