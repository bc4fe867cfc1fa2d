//! The surface-area heuristic: which plane makes a cell cheapest.
//!
//! `C = lambda (K_T + K_I (SA_L / SA n_L + SA_R / SA n_R))`, with `lambda` = the empty factor when a side gets no triangle, else 1; a
//! triangle in the plane goes to the side that is cheaper. A leaf costs `K_I n` (Wald and Havran 2006, equations 4 to 6).
//!
//! One departure: only an empty side that is [`LEAST_EMPTY`] of the cell wide gets the factor. With it for every empty side, thin slices
//! of nothing are cut off one after the other before the triangles are parted: rays that enter pay a step for each.

use super::BuildOptions;
use super::clip::Cell;
use super::events::{Event, Kind, position};

/// The constants of the heuristic.
#[derive(Clone, Copy, Debug)]
pub(super) struct Costs {
    /// `K_T`.
    pub traversal: f64,
    /// `K_I`.
    pub intersection: f64,
    /// `lambda` for a plane between two full halves, and for one that cuts off an empty half.
    factors: [f64; 2],
}

impl Costs {
    pub fn new(options: &BuildOptions) -> Self {
        Self {
            traversal: options.traversal_cost.into(),
            intersection: options.intersection_cost.into(),
            factors: [1.0, options.empty_factor.into()],
        }
    }
}

/// Where a cell is split.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    pub axis: usize,
    /// Strictly inside the cell.
    pub position: f32,
    /// Whether triangles that lie in the plane belong to the low side.
    pub flat_go_low: bool,
}

/// The cheapest plane so far. Of equally cheap ones the first axis, then the lowest position: the two searches below look at
/// planes in different orders and must choose alike.
struct Best {
    cost: f64,
    plane: Option<Plane>,
}

impl Best {
    /// A search that only a plane cheaper than a leaf of `count` triangles ends with a result.
    fn new(count: usize, costs: &Costs) -> Self {
        Self { cost: costs.intersection * count as f64, plane: None }
    }

    #[inline]
    fn offer(&mut self, cost: f64, plane: Plane) {
        let earlier = || self.plane.is_some_and(|p| p.axis == plane.axis && plane.position < p.position);
        if cost < self.cost || (cost == self.cost && earlier()) {
            (self.cost, self.plane) = (cost, Some(plane));
        }
    }
}

/// The cost of planes across one axis of one cell.
struct AxisCost {
    axis: usize,
    /// The cell along the axis.
    min: f32,
    max: f32,
    /// `SA_L / SA = ends + sides (p - min)`: both ends of the axis, and the faces beside it per unit of length.
    ends: f64,
    sides: f64,
    /// An empty low side gets the empty factor up from here, an empty high side down from there.
    empty: [f32; 2],
    costs: Costs,
}

/// Least width of an empty side that gets the empty factor, as a share of the cell's width.
const LEAST_EMPTY: f32 = 0.1;

impl AxisCost {
    fn new(cell: &Cell, axis: usize, costs: &Costs) -> Self {
        let extent = cell.extent();
        let (u, v) = (extent[(axis + 1) % 3], extent[(axis + 2) % 3]);
        let area = cell.area();
        let (min, max) = (cell.min[axis], cell.max[axis]);
        let (ends, sides) = (2.0 * u * v / area, 2.0 * (u + v) / area);
        let least = LEAST_EMPTY * (max - min);
        Self { axis, min, max, ends, sides, empty: [min + least, max - least], costs: *costs }
    }

    /// Whether a plane at `position` would leave both halves a volume.
    #[inline]
    fn is_inside(&self, position: f32) -> bool {
        self.min < position && position < self.max
    }

    /// Offers the plane at `position`, inside the cell, with `low` and `high` triangles on its sides and `flat` ones in it.
    #[inline]
    fn offer(&self, best: &mut Best, position: f32, low: usize, flat: usize, high: usize) {
        debug_assert!(self.is_inside(position));
        let low_share = self.ends + self.sides * (f64::from(position) - f64::from(self.min));
        let high_share = self.ends + self.sides * (f64::from(self.max) - f64::from(position));
        let cost = |low: usize, high: usize| {
            // A look-up and not a branch: neither outcome is the likely one.
            let [from, to] = self.empty;
            let is_empty = ((low == 0) & (position >= from)) | ((high == 0) & (position <= to));
            let factor = self.costs.factors[usize::from(is_empty)];
            let tests = low_share * low as f64 + high_share * high as f64;
            factor * (self.costs.traversal + self.costs.intersection * tests)
        };
        let if_low = cost(low + flat, high);
        let if_high = if flat == 0 { if_low } else { cost(low, high + flat) };
        let flat_go_low = if_low <= if_high;
        let cost = if flat_go_low { if_low } else { if_high };
        best.offer(cost, Plane { axis: self.axis, position, flat_go_low });
    }
}

/// The cheapest plane by a sweep over the sorted events of `count` triangles.
pub(super) fn sweep(events: &[Vec<Event>; 3], count: usize, cell: &Cell, costs: &Costs) -> Option<Plane> {
    let mut best = Best::new(count, costs);
    for (axis, events) in events.iter().enumerate() {
        let axis_cost = AxisCost::new(cell, axis, costs);
        let (mut low, mut high) = (0, count);
        let mut rest = events.iter().peekable();
        while let Some(first) = rest.peek() {
            let key = first.key();
            let [mut ends, mut flat, mut starts] = [0; 3];
            while let Some(event) = rest.next_if(|e| e.key() == key) {
                ends += usize::from(event.is(Kind::End));
                flat += usize::from(event.is(Kind::Flat));
                starts += usize::from(event.is(Kind::Start));
            }
            high -= ends + flat;
            if axis_cost.is_inside(position(key)) {
                axis_cost.offer(&mut best, position(key), low, flat, high);
            }
            low += starts + flat;
        }
    }
    best.plane
}

/// Most triangles for which [`count`] is used, and faster than sorted events.
pub(super) const COUNTED: usize = 32;

/// The same plane as [`sweep`] finds, by counting both sides of every candidate: no order to keep, and no branches.
pub(super) fn count(boxes: &[Cell], cell: &Cell, costs: &Costs) -> Option<Plane> {
    debug_assert!(boxes.len() <= COUNTED);
    if boxes.is_empty() {
        return None;
    }
    let mut best = Best::new(boxes.len(), costs);
    for axis in 0..3 {
        let axis_cost = AxisCost::new(cell, axis, costs);
        let ends = Ends::new(boxes, axis);
        for b in boxes {
            let (min, max) = (b.min[axis], b.max[axis]);
            let candidates = if min == max { 1 } else { 2 };
            for at in [min, max].into_iter().take(candidates) {
                if axis_cost.is_inside(at) {
                    let [low, flat, high] = ends.count(at);
                    axis_cost.offer(&mut best, at, low, flat, high);
                }
            }
        }
    }
    best.plane
}

/// The ends of up to [`COUNTED`] boxes along an axis, in lanes that compilers turn into vector registers.
struct Ends {
    min: [[f32; LANES]; COUNTED / LANES],
    max: [[f32; LANES]; COUNTED / LANES],
    len: usize,
}

const LANES: usize = 4;

const _: () = assert!(COUNTED.is_multiple_of(LANES));

impl Ends {
    fn new(boxes: &[Cell], axis: usize) -> Self {
        let mut ends = Self {
            // Lanes without a box lie on no side of any plane.
            min: [[f32::INFINITY; LANES]; COUNTED / LANES],
            max: [[f32::NEG_INFINITY; LANES]; COUNTED / LANES],
            len: boxes.len(),
        };
        for (i, b) in boxes.iter().enumerate() {
            ends.min[i / LANES][i % LANES] = b.min[axis];
            ends.max[i / LANES][i % LANES] = b.max[axis];
        }
        ends
    }

    /// How many boxes reach below `at`, lie in it, and reach above it.
    #[inline]
    fn count(&self, at: f32) -> [usize; 3] {
        let [mut low, mut high, mut either] = [[0u32; LANES]; 3];
        for (min, max) in self.min.iter().zip(&self.max).take(self.len.div_ceil(LANES)) {
            for lane in 0..LANES {
                let (below, above) = (u32::from(min[lane] < at), u32::from(max[lane] > at));
                low[lane] += below;
                high[lane] += above;
                either[lane] += below | above;
            }
        }
        let [low, high, either] = [low, high, either].map(|lanes| lanes.iter().sum::<u32>() as usize);
        [low, self.len - either, high]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::events::push_events;

    fn sorted_events(boxes: &[Cell]) -> [Vec<Event>; 3] {
        std::array::from_fn(|axis| {
            let mut events = Vec::new();
            for (b, index) in boxes.iter().zip(0..) {
                push_events(&mut events, b, axis, index);
            }
            events.sort_unstable();
            events
        })
    }

    const CUBE: Cell = Cell { min: [0.0; 3], max: [8.0; 3] };

    fn costs() -> Costs {
        Costs::new(&BuildOptions::default())
    }

    #[test]
    fn counting_and_sweeping_choose_the_same_plane() {
        // Coordinates of a coarse grid, so that planes coincide, cost the same and hold flat boxes.
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let mut found = 0;
        for case in 0..2000 {
            let boxes: Vec<Cell> = (0..case % (COUNTED + 1))
                .map(|_| {
                    let [a, b] = [0, 1].map(|_| [0; 3].map(|_| (next() % 9) as f32));
                    Cell {
                        min: std::array::from_fn(|k| a[k].min(b[k])),
                        max: std::array::from_fn(|k| a[k].max(b[k])),
                    }
                })
                .collect();
            let swept = sweep(&sorted_events(&boxes), boxes.len(), &CUBE, &costs());
            assert_eq!(count(&boxes, &CUBE, &costs()), swept, "case {case}: {boxes:?}");
            found += usize::from(swept.is_some());
        }
        assert!(found > 500, "only {found} cases had a plane worth taking");
    }

    #[test]
    fn a_plane_is_taken_only_when_it_is_cheaper_than_a_leaf() {
        let near = |x: f32| Cell { min: [x, 1.0, 1.0], max: [x + 1.0, 2.0, 2.0] };
        // Two triangles in opposite corners: cutting costs 15 + 20 (SA_L + SA_R) / SA > 40 only for planes that part them badly.
        let plane = count(&[near(0.0), near(7.0)], &CUBE, &costs()).unwrap();
        assert_eq!((plane.axis, plane.position), (1, 2.0), "half of the cell cut off empty is cheapest");
        // Copies of one box that fills the cell cannot be parted.
        assert_eq!(count(&[CUBE; 20], &CUBE, &costs()), None);
        assert_eq!(count(&[], &CUBE, &costs()), None);
    }

    #[test]
    fn only_an_empty_side_that_is_wide_enough_gets_the_empty_factor() {
        // 20 boxes from x on and 40 in the high half. The plane at 4 costs 15 + 20 * 2/3 * (20 + 60) = 1081.7; the one at x, of all
        // 60 on one side, 15 + 20 * 60 (1 - x / 12): more, but less with the factor.
        let plane = |x: f32| {
            let from = |min: f32| Cell { min: [min, 0.0, 0.0], max: [8.0; 3] };
            let boxes = [vec![from(x); 20], vec![from(4.0); 40]].concat();
            sweep(&sorted_events(&boxes), boxes.len(), &CUBE, &costs()).map(|p| (p.axis, p.position))
        };
        assert_eq!(plane(0.7), Some((0, 4.0)));
        assert_eq!(plane(0.9), Some((0, 0.9)));
    }

    #[test]
    fn flat_triangles_go_to_the_cheaper_side() {
        // Eight triangles in the plane x = 2: on the small side they cost less.
        let flat = Cell { min: [2.0, 0.0, 0.0], max: [2.0, 8.0, 8.0] };
        let plane = count(&[flat; 8], &CUBE, &costs()).unwrap();
        assert_eq!(plane, Plane { axis: 0, position: 2.0, flat_go_low: true });
        let flat = Cell { min: [6.0, 0.0, 0.0], max: [6.0, 8.0, 8.0] };
        let plane = count(&[flat; 8], &CUBE, &costs()).unwrap();
        assert_eq!(plane, Plane { axis: 0, position: 6.0, flat_go_low: false });
    }
}
