//! Which kernel a scene needs: everything that it does not use is left out of the text that a GPU compiles.

use crate::scene::Needs;
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

/// A part of a kernel that may be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "each is the field of `Variant` of its name")]
pub enum Part {
    Refs,
    Normals,
    Textures,
    Colors,
    Materials,
    Holes,
    HiddenBacks,
    SeeThrough,
    Mirrors,
    Glass,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Refs,
        Self::Normals,
        Self::Textures,
        Self::Colors,
        Self::Materials,
        Self::Holes,
        Self::HiddenBacks,
        Self::SeeThrough,
        Self::Mirrors,
        Self::Glass,
    ];

    /// For people and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Refs => "refs",
            Self::Normals => "normals",
            Self::Textures => "textures",
            Self::Colors => "colors",
            Self::Materials => "materials",
            Self::Holes => "holes",
            Self::HiddenBacks => "hidden-backs",
            Self::SeeThrough => "see-through",
            Self::Mirrors => "mirrors",
            Self::Glass => "glass",
        }
    }
}

impl Variant {
    /// The least that renders `pack`. O(materials + slots).
    pub fn of(pack: &Pack) -> Self {
        let materials = pack.materials();
        let Needs { holes, hidden_backs, see_through, normals, uvs, colors } = Needs::of(pack);
        let unlit = |m: &Material| m.flags & MaterialFlags::UNLIT != 0;
        Self {
            layout: VertexLayout::of(pack),
            refs: has_refs(pack),
            normals,
            textures: uvs,
            colors,
            materials: pack.material_run_count() > 1,
            holes,
            hidden_backs,
            see_through,
            // Gloss begins below a roughness of one half, which a texture can lower.
            mirrors: materials
                .iter()
                .any(|m| !unlit(m) && (m.roughness < 0.5 || m.metallic_roughness_texture != NO_TEXTURE)),
            glass: materials.iter().any(|m| !unlit(m) && m.transmission > 0.0),
        }
    }

    /// The kernel that leaves nothing out but what the pack has no data for: the twin by which leaving out is measured.
    pub fn everything(pack: &Pack) -> Self {
        Part::ALL.into_iter().fold(Self::of(pack), Self::with)
    }

    /// The same with `part` in it, as far as that needs no data: normals, textures and colours come with a pack that has them (see
    /// [`tessera_pack::Forced`]). The picture is the same.
    #[must_use]
    pub fn with(self, part: Part) -> Self {
        match part {
            Part::Refs => Self { refs: true, ..self },
            Part::Materials => Self { materials: true, ..self },
            Part::Holes => Self { holes: true, ..self },
            Part::HiddenBacks => Self { hidden_backs: true, ..self },
            Part::SeeThrough => Self { see_through: true, ..self },
            Part::Mirrors => Self { mirrors: true, ..self },
            Part::Glass => Self { glass: true, ..self },
            Part::Normals | Part::Textures | Part::Colors => self,
        }
    }

    /// Whether `part` is in it.
    pub fn has(&self, part: Part) -> bool {
        match part {
            Part::Refs => self.refs,
            Part::Normals => self.normals,
            Part::Textures => self.textures,
            Part::Colors => self.colors,
            Part::Materials => self.materials,
            Part::Holes => self.holes,
            Part::HiddenBacks => self.hidden_backs,
            Part::SeeThrough => self.see_through,
            Part::Mirrors => self.mirrors,
            Part::Glass => self.glass,
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
        Part::ALL.map(|part| (part.name(), self.has(part)))
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
