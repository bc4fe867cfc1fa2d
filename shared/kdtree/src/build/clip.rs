//! Cells, and the boxes of triangles cut to them.

use super::plane::Plane;
use tessera_geometry::Vec3;

/// A cell of the tree, or the box of what a cell holds of a triangle. Arrays, because the builder turns about axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cell {
    pub min: [f32; 3],
    pub max: [f32; 3],
}

impl Cell {
    /// The box of a triangle; -0 becomes +0.
    pub fn around(vertices: [Vec3; 3]) -> Self {
        let [a, b, c] = vertices;
        Self { min: (a.min(b).min(c) + 0.0).to_array(), max: (a.max(b).max(c) + 0.0).to_array() }
    }

    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: std::array::from_fn(|k| self.min[k].min(other.min[k])),
            max: std::array::from_fn(|k| self.max[k].max(other.max[k])),
        }
    }

    /// The cell with its faces moved out by `by`, or to the next number where `by` is below the resolution there.
    pub fn enlarged(&self, by: f32) -> Self {
        Self {
            min: self.min.map(|x| (x - by).min(x.next_down())),
            max: self.max.map(|x| (x + by).max(x.next_up())),
        }
    }

    /// The cells on the low and the high side of `plane`.
    pub fn split(&self, plane: &Plane) -> [Self; 2] {
        let (mut low, mut high) = (*self, *self);
        low.max[plane.axis] = plane.position;
        high.min[plane.axis] = plane.position;
        [low, high]
    }

    /// Surface area.
    pub fn area(&self) -> f64 {
        let [x, y, z] = self.extent();
        2.0 * (x * y + y * z + z * x)
    }

    pub fn extent(&self) -> [f64; 3] {
        std::array::from_fn(|k| f64::from(self.max[k]) - f64::from(self.min[k]))
    }
}

/// By how much a cell is enlarged before triangles are cut to it: 2^-30 of the largest coordinate of the scene `root`, which is
/// 2^22 times the rounding error of a crossing point in `f64`. So a part that touches the cell is never lost by rounding; for a grid of
/// 2^20 voxels it is a thousandth of a voxel.
pub(super) fn margin(root: &Cell) -> f64 {
    const SHARE: f64 = 1.0 / (1u64 << 30) as f64;
    let coordinates = root.min.iter().chain(&root.max);
    f64::from(coordinates.fold(0.0f32, |a, x| a.max(x.abs()))) * SHARE
}

/// The boxes of the parts of a triangle in both halves of `cell`, for a triangle whose box in `cell`, `bounds`, straddles
/// `plane`. `None` on a side that the triangle does not reach; never on both.
///
/// Sutherland and Hodgman's clipping in `f64` against the enlarged cell, rounded outward to `f32` and held to `bounds`.
pub(super) fn clip_halves(
    triangle: [Vec3; 3],
    bounds: &Cell,
    cell: &Cell,
    plane: &Plane,
    margin: f64,
) -> [Option<Cell>; 2] {
    let (mut polygon, mut spare) = (Polygon::new(triangle), Polygon::EMPTY);
    for axis in 0..3 {
        // Where the box keeps clear of a face there is nothing to cut, or what there is lies beyond another face.
        if bounds.min[axis] <= cell.min[axis] {
            let bound = f64::from(cell.min[axis]) - margin;
            polygon.cut(&mut spare, |corner| corner[axis] - bound);
        }
        if bounds.max[axis] >= cell.max[axis] {
            let bound = f64::from(cell.max[axis]) + margin;
            polygon.cut(&mut spare, |corner| bound - corner[axis]);
        }
    }
    let at = f64::from(plane.position);
    let low = polygon.bounds_where(|corner| at + margin - corner[plane.axis]);
    let high = polygon.bounds_where(|corner| corner[plane.axis] - (at - margin));

    let halves = bounds.split(plane);
    if low.is_none() && high.is_none() {
        return halves.map(Some);
    }
    [low.map(|b| b.rounded_within(&halves[0])), high.map(|b| b.rounded_within(&halves[1]))]
}

/// A convex polygon: a triangle that at most six planes have cut, each adding a corner at most.
struct Polygon {
    corners: [[f64; 3]; 9],
    len: usize,
}

impl Polygon {
    const EMPTY: Self = Self { corners: [[0.0; 3]; 9], len: 0 };

    fn new(triangle: [Vec3; 3]) -> Self {
        let mut polygon = Self::EMPTY;
        for vertex in triangle {
            polygon.push(vertex.as_dvec3().to_array());
        }
        polygon
    }

    fn corners(&self) -> &[[f64; 3]] {
        &self.corners[..self.len]
    }

    fn push(&mut self, corner: [f64; 3]) {
        // Rounding cannot add more than a corner for each plane; if it did, dropping one would beat a panic.
        if let Some(free) = self.corners.get_mut(self.len) {
            *free = corner;
            self.len += 1;
        }
    }

    /// Keeps what lies where `side` is not negative.
    fn cut(&mut self, spare: &mut Self, side: impl Fn(&[f64; 3]) -> f64) {
        if self.corners().iter().all(|corner| side(corner) >= 0.0) {
            return;
        }
        spare.len = 0;
        walk(self.corners(), side, |corner| spare.push(corner));
        std::mem::swap(self, spare);
    }

    /// The box of what lies where `side` is not negative.
    fn bounds_where(&self, side: impl Fn(&[f64; 3]) -> f64) -> Option<Bounds> {
        let mut bounds = Bounds { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };
        walk(self.corners(), side, |corner| {
            for (k, x) in corner.into_iter().enumerate() {
                bounds.min[k] = bounds.min[k].min(x);
                bounds.max[k] = bounds.max[k].max(x);
            }
        });
        (bounds.min[0] <= bounds.max[0]).then_some(bounds)
    }
}

/// Walks around a polygon and hands out the corners of the part where `side` is not negative.
#[inline]
fn walk(corners: &[[f64; 3]], side: impl Fn(&[f64; 3]) -> f64, mut keep: impl FnMut([f64; 3])) {
    let Some(mut from) = corners.last() else { return };
    let mut from_side = side(from);
    for to in corners {
        let to_side = side(to);
        if (from_side < 0.0) != (to_side < 0.0) {
            // Always from the inner to the outer corner, so that both directions of an edge give the same point.
            let (a, b, sa, sb) =
                if from_side < 0.0 { (to, from, to_side, from_side) } else { (from, to, from_side, to_side) };
            let part = sa / (sa - sb);
            keep(std::array::from_fn(|k| a[k] + (b[k] - a[k]) * part));
        }
        if to_side >= 0.0 {
            keep(*to);
        }
        (from, from_side) = (to, to_side);
    }
}

struct Bounds {
    min: [f64; 3],
    max: [f64; 3],
}

impl Bounds {
    /// The smallest `f32` box around this one, held to `limit`.
    fn rounded_within(&self, limit: &Cell) -> Cell {
        Cell {
            min: std::array::from_fn(|k| round_down(self.min[k]).clamp(limit.min[k], limit.max[k]) + 0.0),
            max: std::array::from_fn(|k| round_up(self.max[k]).clamp(limit.min[k], limit.max[k]) + 0.0),
        }
    }
}

fn round_down(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

fn round_up(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) < x { nearest.next_up() } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: Cell = Cell { min: [0.0; 3], max: [8.0; 3] };

    fn plane(axis: usize, position: f32) -> Plane {
        Plane { axis, position, flat_go_low: true }
    }

    /// Clips a triangle whose box is first cut to the cell.
    fn halves(triangle: [Vec3; 3], cell: &Cell, plane: &Plane) -> [Option<Cell>; 2] {
        let around = Cell::around(triangle);
        let bounds = Cell {
            min: std::array::from_fn(|k| around.min[k].max(cell.min[k])),
            max: std::array::from_fn(|k| around.max[k].min(cell.max[k])),
        };
        clip_halves(triangle, &bounds, cell, plane, margin(&CUBE))
    }

    fn is_close(a: [f32; 3], b: [f32; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-6)
    }

    #[test]
    fn both_parts_of_a_triangle_get_their_own_box() {
        // A right triangle in the plane z = 1 whose long side falls from (0, 4) to (8, 0).
        let triangle = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(8.0, 0.0, 1.0), Vec3::new(0.0, 4.0, 1.0)];
        let [Some(low), Some(high)] = halves(triangle, &CUBE, &plane(0, 4.0)) else {
            panic!("both halves hold a part")
        };
        assert_eq!((low.min, low.max), ([0.0, 0.0, 1.0], [4.0, 4.0, 1.0]));
        assert!(is_close(high.min, [4.0, 0.0, 1.0]) && is_close(high.max, [8.0, 2.0, 1.0]), "{high:?}");
        assert!(high.max[1] >= 2.0, "rounded outward");
    }

    #[test]
    fn a_side_that_the_part_in_the_cell_does_not_reach_gets_nothing() {
        // The triangle reaches beyond x = 6 only where y > 8, outside the cell.
        let triangle = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(0.0, 4.0, 1.0), Vec3::new(12.0, 24.0, 1.0)];
        let [low, high] = halves(triangle, &CUBE, &plane(0, 6.0));
        assert!(low.is_some_and(|b| b.max[0] < 4.1), "{low:?}");
        assert_eq!(high, None);
    }

    #[test]
    fn boxes_hold_every_point_of_their_part() {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let mut inside = 0;
        for case in 0..3000 {
            let triangle = [0; 3].map(|_| Vec3::new(next(), next(), next()) * 24.0 - 8.0);
            let axis = case % 3;
            let at = plane(axis, 1.0 + 6.0 * next());
            let around = Cell::around(triangle);
            if !(around.min[axis] < at.position && at.position < around.max[axis]) {
                continue;
            }
            let limits = CUBE.split(&at);
            let parts = if (0..3).all(|k| around.min[k] < 8.0 && around.max[k] > 0.0) {
                halves(triangle, &CUBE, &at)
            } else {
                continue;
            };
            for _ in 0..40 {
                let (u, v) = (f64::from(next()), f64::from(next()));
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = triangle.map(Vec3::as_dvec3);
                let point = (a * (1.0 - u - v) + b * u + c * v).to_array();
                let holds = |cell: &Cell| {
                    (0..3).all(|k| f64::from(cell.min[k]) <= point[k] && point[k] <= f64::from(cell.max[k]))
                };
                for (limit, part) in limits.iter().zip(&parts) {
                    if holds(limit) {
                        inside += 1;
                        assert!(
                            part.as_ref().is_some_and(holds),
                            "case {case}: {point:?} is not in {part:?}"
                        );
                    }
                }
            }
        }
        assert!(inside > 5000, "only {inside} points lay in the cell");
    }

    #[test]
    fn rounding_goes_outward() {
        let between = 1.0 + f64::from(f32::EPSILON) / 4.0;
        assert_eq!((round_down(between), round_up(between)), (1.0, 1.0f32.next_up()));
        assert_eq!((round_down(-between), round_up(-between)), ((-1.0f32).next_down(), -1.0));
        assert_eq!((round_down(0.5), round_up(0.5)), (0.5, 0.5));
    }
}
