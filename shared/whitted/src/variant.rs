//! Which kernel a scene needs: everything that it does not use is left out of the text that a GPU compiles.

use crate::scene::{hides_its_back, is_textured, lets_light_through};
use std::fmt::Write;
use tessera_kdtree::node::{Node, Slot};
use tessera_pack::device::VertexLayout;
use tessera_pack::{Material, MaterialFlags, NO_TEXTURE, Pack};

/// A kernel: what is in it. Names in capitals in the kernels' text are its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    /// How vertices are read.
    pub layout: VertexLayout,
    /// Inner nodes may have references.
    pub refs: bool,
    /// Vertices have normals.
    pub normals: bool,
    /// Some material has a texture.
    pub textures: bool,
    /// Vertices have colours.
    pub colors: bool,
    /// There is more than one material.
    pub materials: bool,
    /// Masks cut holes.
    pub holes: bool,
    /// Some backs are not seen.
    pub hidden_backs: bool,
    /// Light passes some surfaces.
    pub see_through: bool,
    /// Some surface reflects.
    pub mirrors: bool,
    /// Some surface refracts.
    pub glass: bool,
}

impl Variant {
    /// The least that renders `pack`. O(materials + slots).
    pub fn of(pack: &Pack) -> Self {
        let (mesh, materials) = (pack.mesh(), pack.materials());
        let unlit = |m: &Material| m.flags & MaterialFlags::UNLIT != 0;
        Self {
            layout: VertexLayout::of(pack),
            refs: has_refs(pack),
            normals: mesh.has_normals(),
            textures: mesh.has_uvs() && materials.iter().any(is_textured),
            colors: mesh.has_colors(),
            materials: pack.material_run_count() > 1,
            holes: materials.iter().any(|m| m.flags & MaterialFlags::ALPHA_MASK != 0),
            hidden_backs: materials.iter().any(hides_its_back),
            see_through: materials.iter().any(lets_light_through),
            // Gloss begins below a roughness of one half, which a texture can lower.
            mirrors: materials
                .iter()
                .any(|m| !unlit(m) && (m.roughness < 0.5 || m.metallic_roughness_texture != NO_TEXTURE)),
            glass: materials.iter().any(|m| !unlit(m) && m.transmission > 0.0),
        }
    }

    /// The kernel that leaves nothing out but what the pack has no data for: the twin by which leaving out is measured.
    pub fn everything(pack: &Pack) -> Self {
        let least = Self::of(pack);
        Self {
            refs: true,
            materials: true,
            holes: true,
            hidden_backs: true,
            see_through: true,
            mirrors: true,
            glass: true,
            ..least
        }
    }

    /// Greatest number of waiting rays of a path of `depth` mirror and bent rays. A straight continuation is put off first and taken up
    /// last, with nothing beside it, so only mirrors (behind which bent and straight rays wait) and bent rays add to them, whatever they weigh.
    pub fn path_stack(&self, depth: u32) -> u32 {
        match (self.glass, self.mirrors && self.see_through) {
            (true, _) => 2 * depth + 1,
            (false, true) => depth + 1,
            (false, false) => 1,
        }
    }

    /// The constants that the kernels' text names.
    pub fn constants(&self, depth: u32) -> String {
        let VertexLayout {
            plain_positions,
            wide_cells,
            record_words,
            plain_normals,
            oct_normals,
            plain_uvs,
            has_side_uvs,
        } = self.layout;
        let mut text = String::new();
        for (name, value) in [
            ("PLAIN_POSITIONS", plain_positions),
            ("WIDE_CELLS", wide_cells),
            ("PLAIN_NORMALS", plain_normals),
            ("OCT_NORMALS", oct_normals),
            ("PLAIN_UVS", plain_uvs),
            ("HAS_SIDE_UVS", has_side_uvs),
            ("HAS_REFS", self.refs),
            ("HAS_NORMALS", self.normals),
            ("HAS_UVS", self.textures),
            ("HAS_COLORS", self.colors),
            ("ONE_MATERIAL", !self.materials),
            ("HAS_HOLES", self.holes),
            ("HIDES_BACKS", self.hidden_backs),
            ("SEES_THROUGH", self.see_through),
            ("HAS_MIRRORS", self.mirrors),
            ("HAS_GLASS", self.glass),
        ] {
            let _ = writeln!(text, "const {name}: bool = {value};");
        }
        let _ = writeln!(text, "const RECORD_WORDS: u32 = {record_words}u;");
        let _ = writeln!(text, "const PATH_STACK: u32 = {}u;", self.path_stack(depth));
        text
    }

    /// Every part that may be left out, and whether it is in.
    pub fn parts(&self) -> [(&'static str, bool); 10] {
        [
            ("refs", self.refs),
            ("normals", self.normals),
            ("textures", self.textures),
            ("colors", self.colors),
            ("materials", self.materials),
            ("holes", self.holes),
            ("hidden-backs", self.hidden_backs),
            ("see-through", self.see_through),
            ("mirrors", self.mirrors),
            ("glass", self.glass),
        ]
    }

    /// The parts that are left out.
    pub fn left_out(&self) -> Vec<&'static str> {
        self.parts().into_iter().filter(|part| !part.1).map(|part| part.0).collect()
    }

    /// For people: the parts that are in, as `refs+normals+mirrors`, or `bare`.
    pub fn name(&self) -> String {
        let parts: Vec<_> = self.parts().into_iter().filter(|part| part.1).map(|part| part.0).collect();
        if parts.is_empty() { "bare".into() } else { parts.join("+") }
    }
}

/// Whether some inner node of the tree has references.
fn has_refs(pack: &Pack) -> bool {
    // Until the first references every slot is a node.
    let with_refs = |&slot: &Slot| !Node(slot).is_leaf() && Node(slot).refs() > 0;
    pack.tree().slots.iter().any(with_refs)
}
