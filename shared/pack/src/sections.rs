//! The sections of a pack while they are being made.

use crate::build::{PackOptions, PackStats};
use crate::format::{Head, Section};
use crate::input::PackInput;
use crate::mesh::Runs;
use crate::need::Forced;
use crate::records::{Camera, Environment, Light, Material, SideUv, Texture};
use crate::view::cells_are_wide;
use rayon::prelude::*;
use tessera_geometry::DVec3;
use tessera_quantize::normal::direction;
use tessera_quantize::uv::{PackedUv, UvPlan};
use tessera_quantize::{Grid, NO_NORMAL, NormalCode, Record};

/// The sections while they are being made.
#[derive(Default)]
pub(crate) struct Sections {
    pub(crate) record_words: u32,
    pub(crate) has_normals: bool,
    /// Of the normals in the records, if any.
    pub(crate) normal_code: Option<NormalCode>,
    pub(crate) head: Vec<Head>,
    pub(crate) narrow_cells: Vec<u32>,
    pub(crate) wide_cells: Vec<u64>,
    pub(crate) records: Vec<u32>,
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) normals: Vec<[f32; 3]>,
    pub(crate) uvs: Vec<[f32; 2]>,
    pub(crate) side_uvs: Vec<SideUv>,
    pub(crate) colors: Vec<[u8; 4]>,
    pub(crate) faces: Vec<[u32; 3]>,
    pub(crate) material_runs: Runs,
    pub(crate) id_runs: Runs,
    pub(crate) slots: Vec<[u32; 2]>,
    pub(crate) list: Vec<u32>,
    pub(crate) materials: Vec<Material>,
    pub(crate) textures: Vec<Texture>,
    pub(crate) texels: Vec<u32>,
    pub(crate) lights: Vec<Light>,
    pub(crate) environment: Vec<Environment>,
    pub(crate) cameras: Vec<Camera>,
}

impl Sections {
    /// The bytes of one section; empty when it is absent.
    pub(crate) fn bytes(&self, section: Section) -> &[u8] {
        use bytemuck::cast_slice;
        match section {
            Section::Head => cast_slice(&self.head),
            Section::Cells if self.wide_cells.is_empty() => cast_slice(&self.narrow_cells),
            Section::Cells => cast_slice(&self.wide_cells),
            Section::Records => cast_slice(&self.records),
            Section::Positions => cast_slice(&self.positions),
            Section::Normals => cast_slice(&self.normals),
            Section::Uvs => cast_slice(&self.uvs),
            Section::SideUvs => cast_slice(&self.side_uvs),
            Section::Colors => cast_slice(&self.colors),
            Section::Faces => cast_slice(&self.faces),
            Section::MaterialRuns => cast_slice(&self.material_runs),
            Section::IdRuns => cast_slice(&self.id_runs),
            Section::Slots => cast_slice(&self.slots),
            Section::List => cast_slice(&self.list),
            Section::Materials => cast_slice(&self.materials),
            Section::Textures => cast_slice(&self.textures),
            Section::Texels => cast_slice(&self.texels),
            Section::Lights => cast_slice(&self.lights),
            Section::Environment => cast_slice(&self.environment),
            Section::Cameras => cast_slice(&self.cameras),
        }
    }

    /// [`Head::flags`].
    pub(crate) fn flags(&self) -> u32 {
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        flag(self.has_normals, Head::HAS_NORMALS)
            | flag(self.normal_code == Some(NormalCode::Oct), Head::OCT_NORMALS)
    }

    /// The vertex sections.
    pub(crate) fn new(
        input: &PackInput,
        grid: &Grid,
        plan: &UvPlan,
        options: &PackOptions,
        stats: &mut PackStats,
    ) -> Self {
        let PackOptions { plain, normal_code, forced, .. } = *options;
        let mut out = Self::default();
        let sources = || plan.source.par_iter().map(|&v| v as usize);
        let frame = grid.frame();

        // Plain sections.
        if plain.positions {
            out.positions =
                sources().map(|v| frame.to_local(DVec3::from_array(input.positions[v])).to_array()).collect();
        }
        out.has_normals = !input.normals.is_empty()
            && (forced == Some(Forced::Normals) || sources().any(|v| direction(input.normals[v]).is_some()));
        if !input.normals.is_empty() && !out.has_normals {
            stats.leave_out("normal", "no normal has a direction");
        }
        if out.has_normals && plain.normals {
            out.normals = sources().map(|v| unit_or_zero(input.normals[v])).collect();
        }
        let has_uvs = !plan.uv.is_empty();
        if has_uvs && plain.uvs {
            let held = |(uv, &v): (&PackedUv, &u32)| match uv {
                PackedUv::Unread => [0.0; 2],
                _ => input.uvs[v as usize],
            };
            out.uvs = plan.uv.par_iter().zip(&plan.source).map(held).collect();
        }
        if !input.colors.is_empty() {
            out.colors = sources().map(|v| input.colors[v]).collect();
        }

        // Records of what is not plain.
        let packed_normals = out.has_normals && !plain.normals;
        let packed_uvs = has_uvs && !plain.uvs;
        out.normal_code = packed_normals.then_some(normal_code);
        // Where some are in the side table anyway, it is needed.
        let all_aside = packed_uvs && forced == Some(Forced::SideUvs) && !plan.uv.contains(&PackedUv::Side);
        if plain.positions && !packed_normals && !packed_uvs {
            return out;
        }
        out.record_words = if packed_uvs { 3 } else { 2 };
        let record = |i: usize| {
            let v = plan.source[i] as usize;
            let (voxel, cell) = if plain.positions {
                ([0; 3], 0)
            } else {
                let voxel = grid.voxel(input.positions[v]);
                // The cells of all vertices are in the table: it was made from them, by the same function.
                (voxel, grid.cell_index(voxel).unwrap_or_default())
            };
            let normal = if packed_normals { normal_code.encode(input.normals[v]) } else { NO_NORMAL };
            let record = Record::new(voxel, cell, normal);
            match plan.uv.get(i) {
                Some(_) if all_aside => record.with_side_uv(),
                Some(PackedUv::Units(uv)) if packed_uvs => record.with_uv(*uv),
                Some(PackedUv::Side) if packed_uvs => record.with_side_uv(),
                _ => record,
            }
        };
        let words = out.record_words as usize;
        out.records = vec![0; plan.source.len() * words];
        out.records.par_chunks_exact_mut(words).enumerate().for_each(|(i, to)| {
            to.copy_from_slice(&record(i).0[..words]);
        });
        if all_aside {
            // As they would be decoded.
            let decoded = |uv: &PackedUv| match uv {
                PackedUv::Units(units) => Record::default().with_uv(*units).uv(),
                PackedUv::Side | PackedUv::Unread => [0.0; 2],
            };
            out.side_uvs =
                (0..).zip(&plan.uv).map(|(vertex, uv)| SideUv { vertex, uv: decoded(uv) }).collect();
        } else if packed_uvs {
            out.side_uvs = (0..plan.source.len())
                .filter(|&i| plan.uv[i] == PackedUv::Side)
                .map(|i| SideUv { vertex: i as u32, uv: input.uvs[plan.source[i] as usize] })
                .collect();
        }
        if !plain.positions {
            if cells_are_wide(grid.cells) {
                let key = |&[x, y, z]: &[u32; 3]| u64::from(x) << 32 | u64::from(y) << 16 | u64::from(z);
                out.wide_cells = grid.table.iter().map(key).collect();
            } else {
                out.narrow_cells = grid.table.iter().map(|&[x, y, z]| x << 20 | y << 10 | z).collect();
            }
        }
        out
    }
}

/// A unit vector in `f32`, or zero when there is no direction.
fn unit_or_zero(normal: [f32; 3]) -> [f32; 3] {
    direction(normal).map_or([0.0; 3], |n| n.map(|c| c as f32))
}
