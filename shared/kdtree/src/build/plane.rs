//! The surface-area heuristic: which plane makes a cell cheapest.
//!
//! `C = lambda (K_T + K_I (SA_L / SA n_L + SA_R / SA n_R))`, with `lambda` = the empty factor when a side gets no triangle, else 1; a
//! triangle in the plane goes to the side that is cheaper. A leaf costs `K_I n` (Wald and Havran 2006, equations 4 to 6).

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
    empty_factor: f64,
}

impl Costs {
    pub fn new(options: &BuildOptions) -> Self {
        Self {
            traversal: options.traversal_cost.into(),
            intersection: options.intersection_cost.into(),
            empty_factor: options.empty_factor.into(),
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
    costs: Costs,
}

impl AxisCost {
    fn new(cell: &Cell, axis: usize, costs: &Costs) -> Self {
        let extent = cell.extent();
        let (u, v) = (extent[(axis + 1) % 3], extent[(axis + 2) % 3]);
        let area = cell.area();
        let (min, max) = (cell.min[axis], cell.max[axis]);
        Self { axis, min, max, ends: 2.0 * u * v / area, sides: 2.0 * (u + v) / area, costs: *costs }
    }

    /// Offers the plane at `position` with `low` and `high` triangles on its sides and `flat` ones in it.
    #[inline]
    fn offer(&self, best: &mut Best, position: f32, low: usize, flat: usize, high: usize) {
        if !(self.min < position && position < self.max) {
            return;
        }
        let low_share = self.ends + self.sides * (f64::from(position) - f64::from(self.min));
        let high_share = self.ends + self.sides * (f64::from(self.max) - f64::from(position));
        let cost = |low: usize, high: usize| {
            let factor = if low == 0 || high == 0 { self.costs.empty_factor } else { 1.0 };
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
            axis_cost.offer(&mut best, position(key), low, flat, high);
            low += starts + flat;
        }
    }
    best.plane
}

/// Most triangles for which [`count`] is used, and faster than sorted events.
pub(super) const COUNTED: usize = 32;

/// The same plane as [`sweep`] finds, by counting both sides of every candidate: no order to keep, and no branches.
pub(super) fn count(boxes: &[Cell], cell: &Cell, costs: &Costs) -> Option<Plane> {
    const LANES: usize = 8;
    debug_assert!(boxes.len() <= COUNTED);
    let mut best = Best::new(boxes.len(), costs);
    for axis in 0..3 {
        let axis_cost = AxisCost::new(cell, axis, costs);
        // Boxes that are not there lie on no side of any plane.
        let mut mins = [[f32::INFINITY; LANES]; COUNTED / LANES];
        let mut maxs = [[f32::NEG_INFINITY; LANES]; COUNTED / LANES];
        for (i, b) in boxes.iter().enumerate() {
            mins[i / LANES][i % LANES] = b.min[axis];
            maxs[i / LANES][i % LANES] = b.max[axis];
        }
        let used = boxes.len().div_ceil(LANES);
        let (mins, maxs) = (&mins[..used], &maxs[..used]);
        let mut offer = |at: f32| {
            if !(cell.min[axis] < at && at < cell.max[axis]) {
                return;
            }
            let [mut low, mut flat, mut high] = [[0u32; LANES]; 3];
            for (mins, maxs) in mins.iter().zip(maxs) {
                for lane in 0..LANES {
                    low[lane] += u32::from(mins[lane] < at);
                    high[lane] += u32::from(maxs[lane] > at);
                    flat[lane] += u32::from((mins[lane] == at) & (maxs[lane] == at));
                }
            }
            let [low, flat, high] = [low, flat, high].map(|lanes| lanes.iter().sum::<u32>() as usize);
            axis_cost.offer(&mut best, at, low, flat, high);
        };
        for b in boxes {
            offer(b.min[axis]);
            if b.max[axis] != b.min[axis] {
                offer(b.max[axis]);
            }
        }
    }
    best.plane
}
