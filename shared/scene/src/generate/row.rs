//! The figures by which a stand-in is judged beside the model it stands in for.

use crate::Scene;
use crate::instances::for_each_instance;
use glam::DVec3;

/// What a scene's flattened triangles add up to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Triangles, instances counted each time.
    pub triangles: u64,
    /// Vertices, instances counted each time.
    pub vertices: u64,
    /// Edge lengths of the box, longest first.
    pub extent: [f64; 3],
    /// Share of triangles whose longest edge is over ten times their height upon it.
    pub thin: f64,
}

impl Row {
    /// Vertices a triangle.
    pub fn vertices_per_triangle(&self) -> f64 {
        self.vertices as f64 / self.triangles as f64
    }

    /// Measures every triangle where its nodes put it.
    pub fn of(scene: &Scene) -> Self {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (mut triangles, mut vertices, mut thin) = (0_u64, 0_u64, 0_u64);
        let mut world = Vec::new();
        for_each_instance(scene, |mesh, transform| {
            for part in &mesh.primitives {
                world.clear();
                world.extend(part.positions.iter().map(|&p| transform.transform_point3(p)));
                for &p in &world {
                    low = low.min(p);
                    high = high.max(p);
                }
                vertices += part.positions.len() as u64;
                triangles += part.triangles.len() as u64;
                thin += part
                    .triangles
                    .iter()
                    .filter(|t| {
                        let [a, b, c] = t.map(|k| world[k as usize]);
                        is_thin(a, b, c)
                    })
                    .count() as u64;
            }
        });
        let mut extent = if triangles == 0 { [0.0; 3] } else { (high - low).to_array() };
        extent.sort_by(|a, b| b.total_cmp(a));
        Self { triangles, vertices, extent, thin: thin as f64 / triangles.max(1) as f64 }
    }

    /// The row as text: `triangles vertices nv/nf box thin`.
    pub(super) fn text(&self) -> String {
        let [x, y, z] = self.extent;
        format!(
            "{} triangles, {} vertices, nv/nf {:.3}, box 1 : {:.3} : {:.3}, thin {:.1} %",
            self.triangles,
            self.vertices,
            self.vertices_per_triangle(),
            y / x,
            z / x,
            100.0 * self.thin
        )
    }
}

/// Longest edge over ten times the height: `L > 10 h` with `h = |cross| / L`.
fn is_thin(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    longest > 10.0 * (b - a).cross(c - a).length()
}

/// What the paper prints for a model (Seo, Park, Ihm 2022: Table 1, and Table 2's grid for the box).
pub(super) struct Reference {
    /// The model's name.
    pub(super) name: &'static str,
    triangles: u64,
    vertices: u64,
    grid: [f64; 3],
}

impl Reference {
    pub(super) const SODA_HALL: Self =
        Self { name: "Soda Hall", triangles: 2_167_474, vertices: 4_192_793, grid: [358.0, 317.0, 203.0] };
    pub(super) const POWER_PLANT: Self = Self {
        name: "Power Plant",
        triangles: 12_748_510,
        vertices: 10_960_555,
        grid: [616.0, 250.0, 187.0],
    };

    /// Vertices a triangle.
    pub(super) fn vertices_per_triangle(&self) -> f64 {
        self.vertices as f64 / self.triangles as f64
    }

    /// Edges of the box relative to the longest, longest first.
    #[cfg(test)]
    pub(super) fn proportions(&self) -> [f64; 3] {
        self.grid.map(|n| n / self.grid[0])
    }

    /// The row as text, in the order of [`Row::text`]; the paper does not count thin triangles.
    pub(super) fn text(&self) -> String {
        format!(
            "{} triangles, {} vertices, nv/nf {:.3}, box 1 : {:.3} : {:.3}",
            self.triangles,
            self.vertices,
            self.vertices_per_triangle(),
            self.grid[1] / self.grid[0],
            self.grid[2] / self.grid[0]
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thin_is_ten_to_one() {
        let (a, b) = (DVec3::ZERO, DVec3::X * 10.0);
        assert!(!is_thin(a, b, DVec3::new(5.0, 1.001, 0.0)));
        assert!(is_thin(a, b, DVec3::new(5.0, 0.999, 0.0)));
        assert!(is_thin(a, a, a + DVec3::X), "a triangle without area is thin");
    }
}
