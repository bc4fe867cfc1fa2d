//! The node tree turned into one list of world-space triangles.

use crate::import::limits::FLAT_MAX;
use crate::{Primitive, Scene, SceneError};
use glam::{DMat3, DMat4, DVec3};
use std::path::PathBuf;

/// World-space arrays; vertex arrays other than `positions` are empty (nothing has them) or as long as `positions`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlatMesh {
    /// World positions.
    pub positions: Vec<[f64; 3]>,
    /// Unit world normals; zero where a vertex has none.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, (0, 0) where a part has none.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex colours, white where a part has none.
    pub colors: Vec<[u8; 4]>,
    /// Triangles, nodes depth first in file order: the place in this list is `id.triangle`.
    pub triangles: Vec<[u32; 3]>,
    /// `(first triangle, material)`, ascending.
    pub material_runs: Vec<(u32, u32)>,
    /// Every use of a mesh that has a triangle, in the order of the triangles.
    pub objects: Vec<FlatObject>,
}

/// A mesh where a node has put it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlatObject {
    /// Its place in [`Scene::meshes`].
    pub mesh: usize,
    /// Longest side of the world-space box around the finite vertices that its triangles use; 0 if there are none.
    pub extent: f64,
}

impl Scene {
    /// Flattens the node tree. Mirrored instances (negative determinant) get their winding turned, so that the geometric
    /// normal points to the same side as in the mesh; normals go through the inverse transpose.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] when the counts exceed [`FLAT_MAX`], the tree is deeper than
    /// [`NODE_DEPTH_MAX`](crate::import::limits::NODE_DEPTH_MAX) (or has a cycle), or an index of the document is out of range.
    pub fn flatten(&self) -> Result<FlatMesh, SceneError> {
        let size = self.flat_size()?;
        if !crate::import::has_room(size.bytes()) {
            return Err(self.invalid(format!(
                "takes {} bytes once its {} triangles are laid out, more than the memory that is left; use a smaller part of it",
                size.bytes(),
                size.triangles
            )));
        }
        let mut flat = FlatMesh::with_room(&size);
        self.walk(|mesh, to_world| {
            let first = flat.triangles.len();
            for primitive in &self.meshes[mesh].primitives {
                flat.append(primitive, to_world);
            }
            if flat.triangles.len() > first {
                let extent = flat.extent(first);
                flat.objects.push(FlatObject { mesh, extent });
            }
            Ok(())
        })
        .map_err(|what| self.invalid(what))?;
        Ok(flat)
    }

    /// What [`Scene::flatten`] would make, counted without making it; its errors are the same.
    pub(crate) fn flat_size(&self) -> Result<FlatSize, SceneError> {
        let mut meshes = Vec::with_capacity(self.meshes.len());
        for mesh in &self.meshes {
            let mut size = FlatSize::default();
            for primitive in mesh.primitives.iter().filter(|primitive| !primitive.triangles.is_empty()) {
                self.check(primitive).map_err(|what| self.invalid(what))?;
                size.add(&FlatSize::of(primitive));
            }
            meshes.push(size);
        }
        let mut size = FlatSize::default();
        self.walk(|mesh, _| {
            size.add(&meshes[mesh]);
            if size.vertices > FLAT_MAX || size.triangles > FLAT_MAX {
                return Err(format!(
                    "has more than {FLAT_MAX} triangles or vertices after instancing, the limit; use a smaller part of it"
                ));
            }
            Ok(())
        })
        .map_err(|what| self.invalid(what))?;
        Ok(size)
    }

    fn invalid(&self, what: String) -> SceneError {
        SceneError::Invalid { path: PathBuf::from(&self.name), what }
    }

    /// The promises of [`Primitive`], which importers and generators keep.
    fn check(&self, primitive: &Primitive) -> Result<(), String> {
        let count = primitive.positions.len();
        let lengths = [primitive.normals.len(), primitive.uvs.len(), primitive.colors.len()];
        if lengths.iter().any(|&length| length != 0 && length != count) {
            return Err(format!(
                "a primitive has vertex arrays of lengths {lengths:?} for {count} positions"
            ));
        }
        if let Some(index) =
            primitive.triangles.as_flattened().iter().max().filter(|&&index| index as usize >= count)
        {
            return Err(format!("a primitive names vertex {index}, but has {count}"));
        }
        if !primitive.triangles.is_empty() && primitive.material >= self.materials.len() {
            return Err(format!("a primitive names material {}, which does not exist", primitive.material));
        }
        Ok(())
    }
}

/// How much a flattened scene, or a part of it, holds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FlatSize {
    pub(crate) vertices: u64,
    pub(crate) triangles: u64,
    has_normals: bool,
    has_uvs: bool,
    has_colors: bool,
}

impl FlatSize {
    fn of(primitive: &Primitive) -> Self {
        Self {
            vertices: primitive.positions.len() as u64,
            triangles: primitive.triangles.len() as u64,
            has_normals: !primitive.normals.is_empty(),
            has_uvs: !primitive.uvs.is_empty(),
            has_colors: !primitive.colors.is_empty(),
        }
    }

    /// Of [`FlatMesh::with_room`].
    fn bytes(&self) -> u64 {
        let part = |has: bool, bytes: u64| if has { bytes } else { 0 };
        let vertex = 24 + part(self.has_normals, 12) + part(self.has_uvs, 8) + part(self.has_colors, 4);
        self.vertices * vertex + self.triangles * 12
    }

    /// Sums saturate: what is beyond 64 bits is beyond every limit.
    fn add(&mut self, other: &Self) {
        self.vertices = self.vertices.saturating_add(other.vertices);
        self.triangles = self.triangles.saturating_add(other.triangles);
        self.has_normals |= other.has_normals;
        self.has_uvs |= other.has_uvs;
        self.has_colors |= other.has_colors;
    }
}

impl FlatMesh {
    /// Empty arrays with room for a size below [`FLAT_MAX`].
    fn with_room(size: &FlatSize) -> Self {
        let room = |has: bool| if has { size.vertices as usize } else { 0 };
        Self {
            positions: Vec::with_capacity(room(true)),
            normals: Vec::with_capacity(room(size.has_normals)),
            uvs: Vec::with_capacity(room(size.has_uvs)),
            colors: Vec::with_capacity(room(size.has_colors)),
            triangles: Vec::with_capacity(size.triangles as usize),
            material_runs: Vec::new(),
            objects: Vec::new(),
        }
    }

    /// Longest side of the box around the triangles from `first` on.
    fn extent(&self, first: usize) -> f64 {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &index in self.triangles[first..].as_flattened() {
            let p = DVec3::from(self.positions[index as usize]);
            if p.is_finite() {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        (high - low).max_element().max(0.0)
    }

    /// Appends one instance; room was reserved, and what has capacity is filled.
    fn append(&mut self, primitive: &Primitive, to_world: &DMat4) {
        if primitive.triangles.is_empty() {
            return;
        }
        // The limits on the counts keep everything below 2^32.
        let first_vertex = self.positions.len() as u32;
        let first_triangle = self.triangles.len() as u32;
        let material = primitive.material as u32;
        let (to_normal, is_mirrored) = normal_matrix(to_world);

        self.positions.extend(primitive.positions.iter().map(|&p| to_world.transform_point3(p).to_array()));
        if self.normals.capacity() > 0 {
            self.normals.extend(primitive.normals.iter().map(|&normal| unit_normal(&to_normal, normal)));
            self.normals.resize(self.positions.len(), [0.0; 3]);
        }
        if self.uvs.capacity() > 0 {
            self.uvs.extend_from_slice(&primitive.uvs);
            self.uvs.resize(self.positions.len(), [0.0; 2]);
        }
        if self.colors.capacity() > 0 {
            self.colors.extend_from_slice(&primitive.colors);
            self.colors.resize(self.positions.len(), [255; 4]);
        }
        let turn = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
        let shift = |triangle: &[u32; 3]| turn(*triangle).map(|index| first_vertex + index);
        self.triangles.extend(primitive.triangles.iter().map(shift));
        if self.material_runs.last().is_none_or(|&(_, last)| last != material) {
            self.material_runs.push((first_triangle, material));
        }
    }
}

/// The matrix that takes normals along, up to a positive factor, and whether the transform mirrors.
///
/// With M the linear part, `cof(M) = det(M) M^-T`; its columns are cross products of M's, so that it exists for a singular M too.
/// A turned winding makes the geometric normal `|det| M^-T n`, hence the sign.
fn normal_matrix(to_world: &DMat4) -> (DMat3, bool) {
    let linear = DMat3::from_mat4(*to_world);
    // Scaled to 1, so that the products of tiny or huge scales neither vanish nor overflow.
    let largest = linear.to_cols_array().iter().fold(0.0_f64, |largest, &value| largest.max(value.abs()));
    let linear = if largest > 0.0 { linear * (1.0 / largest) } else { linear };
    let DMat3 { x_axis: x, y_axis: y, z_axis: z } = linear;
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    let is_mirrored = x.dot(y.cross(z)) < 0.0;
    (if is_mirrored { cofactors * -1.0 } else { cofactors }, is_mirrored)
}

/// A unit world normal, or zero where there is none.
fn unit_normal(to_normal: &DMat3, normal: [f32; 3]) -> [f32; 3] {
    let world = *to_normal * DVec3::from(normal.map(f64::from));
    world.try_normalize().map_or([0.0; 3], |unit| unit.to_array().map(|component| component as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::limits::NODE_DEPTH_MAX;
    use crate::{Material, Mesh, Node};

    fn triangle() -> Primitive {
        Primitive {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            normals: vec![[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [f32::NAN, 0.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Primitive::default()
        }
    }

    fn scene(transforms: &[DMat4]) -> Scene {
        Scene {
            meshes: vec![Mesh { name: String::new(), primitives: vec![triangle()] }],
            nodes: transforms
                .iter()
                .map(|&transform| Node {
                    name: String::new(),
                    transform,
                    mesh: Some(0),
                    children: Vec::new(),
                })
                .collect(),
            roots: (0..transforms.len()).collect(),
            materials: vec![Material::default(), Material::default()],
            ..Scene::default()
        }
    }

    /// The geometric normal of a triangle.
    fn geometric(flat: &FlatMesh, triangle: usize) -> DVec3 {
        let [a, b, c] = flat.triangles[triangle].map(|index| DVec3::from(flat.positions[index as usize]));
        // Unit edges first: the squares of tiny ones would vanish.
        (b - a).normalize().cross((c - a).normalize()).normalize()
    }

    #[test]
    fn normals_and_winding_stay_on_one_side() {
        let shear = DMat4::from_mat3(DMat3::from_cols(
            DVec3::X,
            DVec3::new(2.0, 1.0, 0.5),
            DVec3::new(0.0, -3.0, 1.0),
        ));
        for transform in [
            DMat4::IDENTITY,
            DMat4::from_scale(DVec3::new(2.0, 0.5, 3.0)),
            DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)),
            DMat4::from_scale(DVec3::splat(-1e-150)),
            DMat4::from_scale(DVec3::splat(1e150)),
            shear,
            DMat4::from_scale(DVec3::new(1.0, 1.0, -4.0)) * shear,
        ] {
            let flat = scene(&[transform]).flatten().unwrap();
            let normal = DVec3::from(flat.normals[0].map(f64::from));
            assert!(normal.dot(geometric(&flat, 0)) > 1.0 - 1e-7, "{transform}");
            // A normal is perpendicular to the image of every tangent: (1, 0, 1) to that of (1, 0, -1).
            let tangent = transform.transform_vector3(DVec3::new(1.0, 0.0, -1.0)).normalize();
            let tilted = DVec3::from(flat.normals[1].map(f64::from));
            assert!(tilted.dot(tangent).abs() < 1e-6, "{transform}");
            assert_eq!(flat.normals[2], [0.0; 3]);
        }
    }

    #[test]
    fn nodes_come_depth_first_in_file_order() {
        let mut scene = scene(&[1.0, 2.0, 3.0, 4.0].map(|x| DMat4::from_translation(DVec3::X * x)));
        scene.roots = vec![2, 0];
        scene.nodes[2].children = vec![3, 1];
        let flat = scene.flatten().unwrap();
        let starts: Vec<f64> =
            flat.triangles.iter().map(|triangle| flat.positions[triangle[0] as usize][0]).collect();
        assert_eq!(starts, [3.0, 7.0, 5.0, 1.0]);
        assert_eq!(flat.material_runs, [(0, 0)]);
    }

    #[test]
    fn objects_are_as_large_as_where_they_stand() {
        let mut scene = scene(&[2.0, 0.5].map(|size| DMat4::from_scale(DVec3::splat(size))));
        let extents = |scene: &Scene| -> Vec<f64> {
            scene.flatten().unwrap().objects.iter().map(|object| object.extent).collect()
        };
        assert_eq!(extents(&scene), [2.0, 0.5]);
        // Vertices that no triangle uses do not count, nor do those that are not finite.
        scene.meshes[0].primitives[0].positions.push(DVec3::splat(9.0));
        scene.meshes[0].primitives[0].normals.clear();
        assert_eq!(extents(&scene), [2.0, 0.5]);
        scene.meshes[0].primitives[0].positions[0] = DVec3::NAN;
        scene.meshes[0].primitives[0].positions[1] = DVec3::NAN;
        assert_eq!(extents(&scene), [0.0, 0.0]);
        scene.meshes[0].primitives[0].triangles.clear();
        assert_eq!(extents(&scene), [0.0; 0]);
    }

    #[test]
    fn parts_without_an_array_are_filled() {
        let mut scene = scene(&[DMat4::IDENTITY]);
        let mut other = triangle();
        other.normals = Vec::new();
        other.uvs = vec![[0.5, 0.25]; 3];
        other.colors = vec![[1, 2, 3, 4]; 3];
        other.material = 1;
        scene.meshes[0].primitives = vec![triangle(), other, triangle()];
        let flat = scene.flatten().unwrap();
        assert_eq!(flat.normals[3..6], [[0.0; 3]; 3]);
        assert_eq!((flat.uvs[2], flat.uvs[3], flat.uvs.len()), ([0.0; 2], [0.5, 0.25], 9));
        assert_eq!((flat.colors[2], flat.colors[3], flat.colors[8]), ([255; 4], [1, 2, 3, 4], [255; 4]));
        assert_eq!(flat.material_runs, [(0, 0), (1, 1), (2, 0)]);
        assert_eq!(flat.triangles[2], [6, 7, 8]);
    }

    #[test]
    fn deep_trees_cycles_and_floods_end_in_an_error() {
        let mut deep = scene(&vec![DMat4::IDENTITY; NODE_DEPTH_MAX + 1]);
        for index in 0..NODE_DEPTH_MAX {
            deep.nodes[index].children = vec![index + 1];
        }
        deep.roots = vec![0];
        assert!(deep.flatten().unwrap_err().to_string().contains("deeper than"));
        deep.nodes[NODE_DEPTH_MAX - 1].children.clear();
        assert_eq!(deep.flatten().unwrap().triangles.len(), NODE_DEPTH_MAX);
        deep.nodes[3].children = vec![0];
        assert!(deep.flatten().unwrap_err().to_string().contains("cycle"));

        // 2^12 nodes times 2^16 triangles: refused by counting, before anything is made.
        let mut flood = scene(&vec![DMat4::IDENTITY; 1 << 12]);
        flood.meshes[0].primitives[0].triangles = vec![[0, 1, 2]; 1 << 16];
        assert!(flood.flatten().unwrap_err().to_string().contains("after instancing"));

        let mut broken = scene(&[DMat4::IDENTITY]);
        broken.meshes[0].primitives[0].material = 7;
        assert!(broken.flatten().unwrap_err().to_string().contains("material 7"));

        let mut broken = scene(&[DMat4::IDENTITY]);
        broken.meshes[0].primitives[0].triangles.push([0, 3, 1]);
        assert!(broken.flatten().unwrap_err().to_string().contains("vertex 3, but has 3"));
    }
}
