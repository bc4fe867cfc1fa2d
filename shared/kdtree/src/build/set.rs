//! The triangles that meet a cell.

use super::Builder;
use super::clip::{Cell, clip_halves};
use super::events::{Event, push_events};
use super::plane::{self, Plane};
use super::refs::Trials;
use rayon::prelude::*;
use tessera_geometry::Vec3;
use tessera_geometry::mutation::{Mutation, is_on};

/// Triangles with the boxes of their parts inside one cell, and the boxes' ends sorted along each axis.
///
/// Sorted once for the whole scene; a split hands every triangle's events on in order, and only the few triangles that the plane
/// cuts get new ones (Wald and Havran 2006, section 4.3: O(N log N)). Small sets keep no events: counting is faster.
#[derive(Default)]
pub(super) struct Set {
    /// Ascending.
    ids: Vec<u32>,
    /// Of the same triangles.
    boxes: Vec<Cell>,
    /// Empty when there are at most [`plane::COUNTED`] triangles. An event's index is a place in `ids`.
    events: [Vec<Event>; 3],
}

impl Set {
    /// All triangles with finite vertices.
    pub fn of_mesh(count: u32, vertices: &(impl Fn(u32) -> [Vec3; 3] + Sync)) -> Self {
        let (ids, boxes): (Vec<u32>, Vec<Cell>) = (0..count)
            .into_par_iter()
            .filter_map(|id| {
                let triangle = vertices(id);
                triangle.iter().all(|v| v.is_finite()).then(|| (id, Cell::around(triangle)))
            })
            .unzip();
        let mut set = Self { ids, boxes, events: Default::default() };
        if set.len() > plane::COUNTED {
            let boxes = &set.boxes;
            set.events.par_iter_mut().enumerate().for_each(|(axis, events)| {
                list_events(events, boxes, axis);
                events.par_sort_unstable();
            });
        }
        set
    }

    pub fn len(&self) -> usize {
        self.ids.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Triangle ids, ascending.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Boxes of the triangles' parts inside the cell, in the order of [`Set::ids`].
    pub fn boxes(&self) -> &[Cell] {
        &self.boxes
    }

    /// The box of all triangles; the set must not be empty.
    pub fn bounds(&self) -> Cell {
        self.boxes[1..].iter().fold(self.boxes[0], |all, b| all.union(b))
    }

    /// The cheapest plane, or `None` where a leaf is not dearer.
    pub fn best_plane(&self, cell: &Cell, costs: &plane::Costs) -> Option<Plane> {
        if self.len() > plane::COUNTED {
            plane::sweep(&self.events, self.len(), cell, costs)
        } else {
            plane::count(&self.boxes, cell, costs)
        }
    }

    /// Hands the triangles of `cell` on to the (empty) sets of its halves.
    pub fn split_into<V: Fn(u32) -> [Vec3; 3] + Sync>(
        &self,
        builder: &Builder<'_, V>,
        cell: &Cell,
        plane: &Plane,
        halves: [&mut Self; 2],
        shop: &mut Workshop,
    ) {
        let Workshop { routes, cut, fresh, .. } = shop;
        routes.clear();
        cut.iter_mut().for_each(Vec::clear);
        let [low, high] = halves;
        let has_events = self.len() > plane::COUNTED;

        // Send each triangle to its side, or cut it in two. Both sides keep the order, so ids stay ascending.
        for (&id, bounds) in self.ids.iter().zip(&self.boxes) {
            let (min, max) = (bounds.min[plane.axis], bounds.max[plane.axis]);
            let goes_low = if min == plane.position && max == plane.position {
                Some(plane.flat_go_low)
            } else if max <= plane.position {
                Some(true)
            } else if min >= plane.position {
                Some(false)
            } else {
                None
            };
            let route = match goes_low {
                Some(true) => Route::low(low.push(id, bounds)),
                Some(false) => Route::high(high.push(id, bounds)),
                None => {
                    let parts = clip_halves((builder.vertices)(id), bounds, cell, plane, builder.margin);
                    let parts =
                        if is_on(Mutation::CutGoesLow) { [parts[0].or(parts[1]), None] } else { parts };
                    for ((side, part), cut) in [&mut *low, &mut *high].into_iter().zip(parts).zip(&mut *cut) {
                        if let Some(part) = part {
                            cut.push(side.push(id, &part));
                        }
                    }
                    Route::CUT
                }
            };
            if has_events {
                routes.push(route);
            }
        }
        if !has_events {
            return;
        }

        // Hand the events of whole triangles on in order, with those of the cut ones merged in.
        let keeps = [&*low, &*high].map(|side| side.len() > plane::COUNTED);
        for axis in 0..3 {
            for ((side, keeps), (cut, fresh)) in
                [&*low, &*high].into_iter().zip(keeps).zip(cut.iter().zip(&mut *fresh))
            {
                fresh.clear();
                if keeps {
                    for &index in cut {
                        push_events(fresh, &side.boxes[index as usize], axis, index);
                    }
                    fresh.sort_unstable();
                }
            }
            let [fresh_low, fresh_high] = fresh;
            let mut low = keeps[0].then(|| Merge::new(&mut low.events[axis], 2 * low.ids.len(), fresh_low));
            let mut high =
                keeps[1].then(|| Merge::new(&mut high.events[axis], 2 * high.ids.len(), fresh_high));
            for event in &self.events[axis] {
                let route = routes[event.index()];
                if let (Some(low), true) = (&mut low, route.is_low()) {
                    low.push(event.with_index(route.index()));
                } else if let (Some(high), true) = (&mut high, route.is_high()) {
                    high.push(event.with_index(route.index()));
                }
            }
            low.into_iter().chain(high).for_each(Merge::finish);
        }
    }

    /// Adds a triangle and returns its place.
    fn push(&mut self, id: u32, bounds: &Cell) -> u32 {
        self.ids.push(id);
        self.boxes.push(*bounds);
        self.ids.len() as u32 - 1
    }

    /// Makes this (empty) set the triangles `ids` (ascending) with their `boxes`, but for those at `places`.
    pub fn fill_without(&mut self, ids: &[u32], boxes: &[Cell], places: &[usize]) {
        for (place, (&id, bounds)) in ids.iter().zip(boxes).enumerate() {
            if !places.contains(&place) {
                self.push(id, bounds);
            }
        }
        if self.len() > plane::COUNTED {
            for (axis, events) in self.events.iter_mut().enumerate() {
                list_events(events, &self.boxes, axis);
                events.sort_unstable();
            }
        }
    }

    fn clear(&mut self) {
        self.ids.clear();
        self.boxes.clear();
        self.events.iter_mut().for_each(Vec::clear);
    }
}

/// Appends the events of all `boxes` along `axis`, in their order.
fn list_events(events: &mut Vec<Event>, boxes: &[Cell], axis: usize) {
    events.reserve_exact(2 * boxes.len());
    for (b, index) in boxes.iter().zip(0..) {
        push_events(events, b, axis, index);
    }
}

/// Where a split sends a triangle: bits 30..32 the side (0 cut, 1 low, 2 high), 0..30 its place in that side's set.
#[derive(Clone, Copy)]
struct Route(u32);

impl Route {
    /// The triangle is cut: its events are made anew.
    const CUT: Self = Self(0);

    fn low(index: u32) -> Self {
        Self(1 << 30 | index)
    }

    fn high(index: u32) -> Self {
        Self(2 << 30 | index)
    }

    fn is_low(self) -> bool {
        self.0 >> 30 == 1
    }

    fn is_high(self) -> bool {
        self.0 >> 30 == 2
    }

    fn index(self) -> u32 {
        self.0 & ((1 << 30) - 1)
    }
}

/// Merges sorted events that come one by one with a sorted slice.
struct Merge<'a> {
    events: &'a mut Vec<Event>,
    fresh: &'a [Event],
}

impl<'a> Merge<'a> {
    fn new(events: &'a mut Vec<Event>, capacity: usize, fresh: &'a [Event]) -> Self {
        events.reserve(capacity);
        Self { events, fresh }
    }

    #[inline]
    fn push(&mut self, event: Event) {
        while let Some((&first, rest)) = self.fresh.split_first()
            && first < event
        {
            self.events.push(first);
            self.fresh = rest;
        }
        self.events.push(event);
    }

    fn finish(self) {
        self.events.extend_from_slice(self.fresh);
    }
}

/// Buffers that one thread uses over and over, so that a node costs no allocation.
#[derive(Default)]
pub(super) struct Workshop {
    spare: Vec<Set>,
    routes: Vec<Route>,
    /// Places of cut triangles in the low and the high set.
    cut: [Vec<u32>; 2],
    /// Their events along one axis.
    fresh: [Vec<Event>; 2],
    /// Trial trees that are being refined, the innermost last.
    pub trials: Trials,
}

impl Workshop {
    /// An empty set.
    pub fn take(&mut self) -> Set {
        self.spare.pop().unwrap_or_default()
    }

    /// Takes a set back that is no longer needed.
    pub fn give_back(&mut self, mut set: Set) {
        set.clear();
        self.spare.push(set);
    }
}
