//! The mesh of a bench: positions as `f32` and triangles, nothing else.

use super::generate;
use crate::commands::CommandError;
use std::path::Path;
use std::str::FromStr;
use tessera_geometry::{Aabb, Vec3};
use tessera_pack::{Material, PackInput};
use tessera_scene::LoadOptions;

/// Where a mesh comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshSource {
    /// A generator of [`generate`], and about how many triangles it is to make.
    Generated(generate::Kind, u32),
    /// Anything that `tessera render` takes, except bundles.
    File(String),
}

/// Triangles that a generator may be asked for.
const GENERATED_TRIANGLES: std::ops::RangeInclusive<u32> = 100..=50_000_000;

impl FromStr for MeshSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(generated) = text.strip_prefix("gen:") else {
            return Ok(Self::File(text.to_owned()));
        };
        let parse = || {
            let (kind, count) = generated.split_once(':')?;
            let count = count.parse().ok().filter(|count| GENERATED_TRIANGLES.contains(count))?;
            let kind = match kind {
                "sphere" => generate::Kind::Sphere,
                "pipes" => generate::Kind::Pipes,
                _ => return None,
            };
            Some(Self::Generated(kind, count))
        };
        parse().ok_or_else(|| {
            let (least, most) = (GENERATED_TRIANGLES.start(), GENERATED_TRIANGLES.end());
            format!("write gen:sphere:N or gen:pipes:N with {least} to {most} triangles, or name a file")
        })
    }
}

/// Triangles without attributes. Every peer gets the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// The file without folder and extension, or generator and number of triangles.
    pub name: String,
    /// Vertices as read; some may be used by no triangle.
    pub positions: Vec<Vec3>,
    /// Vertex indices, in the order of the source, those without area left out.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Reads or generates the mesh; `scenes_folder` is where scene files look for their sources.
    pub fn load(source: &MeshSource, options: &LoadOptions) -> Result<Self, CommandError> {
        let (name, positions, triangles) = match source {
            MeshSource::Generated(kind, count) => {
                let (positions, triangles) = generate::generate(*kind, *count);
                (format!("{}-{}", kind.name(), triangles.len()), positions, triangles)
            }
            MeshSource::File(path) => {
                let path = Path::new(path);
                super::refuse_bundle(path)?;
                let scene = tessera_scene::load(path, options).map_err(CommandError::failed)?;
                let flat = scene.flatten().map_err(CommandError::failed)?;
                let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                let positions = flat.positions.iter().map(|p| Vec3::from_array(p.map(|x| x as f32)));
                (name, positions.collect(), flat.triangles)
            }
        };
        let mesh = Self::new(name, positions, triangles);
        if mesh.triangles.is_empty() {
            return Err(CommandError::Failed(format!("{}: no triangle has an area", mesh.name)));
        }
        Ok(mesh)
    }

    /// Without the triangles that no ray can hit: those without an area in `f32`.
    pub fn new(name: String, positions: Vec<Vec3>, mut triangles: Vec<[u32; 3]>) -> Self {
        triangles.retain(|t| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            (b - a).cross(c - a).length_squared() > 0.0
        });
        Self { name, positions, triangles }
    }

    /// Corners of triangle `id`.
    pub fn corners(&self, id: u32) -> [Vec3; 3] {
        self.triangles[id as usize].map(|v| self.positions[v as usize])
    }

    /// The box of the vertices in use.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(self.triangles.iter().flatten().map(|&v| self.positions[v as usize]))
    }

    /// The mesh as the packer takes it: positions and triangles of one material.
    pub fn pack_input(&self) -> PackInput {
        PackInput {
            positions: self.positions.iter().map(|p| p.as_dvec3().to_array()).collect(),
            triangles: self.triangles.clone(),
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_files_or_generators_with_a_count() {
        let parse = |text: &str| text.parse::<MeshSource>();
        assert_eq!(parse("gen:sphere:2000"), Ok(MeshSource::Generated(generate::Kind::Sphere, 2000)));
        assert_eq!(parse("gen:pipes:100"), Ok(MeshSource::Generated(generate::Kind::Pipes, 100)));
        assert_eq!(parse("a.ply"), Ok(MeshSource::File("a.ply".into())));
        for bad in ["gen:", "gen:sphere", "gen:sphere:", "gen:sphere:99", "gen:cube:500", "gen:pipes:-1"] {
            assert!(parse(bad).unwrap_err().contains("gen:sphere:N or gen:pipes:N"), "{bad}");
        }
    }

    #[test]
    fn triangles_without_area_are_left_out_and_do_not_count_for_the_box() {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::splat(9.0)];
        let mesh = Mesh::new("a".into(), positions, vec![[0, 0, 3], [0, 1, 2], [0, 1, 1]]);
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        assert_eq!((mesh.bounds().min, mesh.bounds().max), (Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0)));
    }
}
