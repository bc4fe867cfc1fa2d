//! The grid: cubic cells over the mesh's box, and positions as voxels inside them.
//!
//! A cell is 1024 voxels wide along each axis. A cell is in the table when a vertex lies in it; only vertices are ever looked
//! up, so cells that triangles merely pass through are not needed. (The paper speaks of cells that triangles intersect, but its
//! own table of resolutions rules that reading out: one full floor of its Sponza would take 604,510 cells.)

use tessera_geometry::LocalFrame;

/// Voxels along a cell's side.
pub const VOXELS_PER_CELL: u32 = LocalFrame::VOXELS_PER_CELL;
/// Bits of a voxel's place inside its cell, along an axis.
pub const POSITION_BITS: u32 = VOXELS_PER_CELL.ilog2();
/// Cells that a 16-bit index can name.
pub const MAX_CELLS: usize = 1 << 16;
/// Coarsest grid tried; 32^3 = 32,768 cells always fit the index.
pub const MIN_INTERVALS: u32 = 32;
/// Finest grid of the paper; up to here a cell packs into 10:10:10 bits.
pub const PAPER_INTERVALS: u32 = 1024;
/// Finest grid for meshes that occupy few cells. Voxel coordinates stay below 2^23, so `u + 0.5` is exact in `f32`.
pub const MAX_INTERVALS: u32 = 8192;
/// Largest coordinate and largest extent accepted, in world units. Keeps every derived quantity finite in `f32`.
pub const MAX_COORDINATE: f64 = 1e30;
/// Smallest extent accepted (but for 0: all vertices equal), for the same reason.
pub const MIN_EXTENT: f64 = 1e-24;

/// Integer coordinates of a voxel, counted from the grid's low corner; each below 2^23.
pub type Voxel = [u32; 3];
/// Integer coordinates of a cell, each below 2^13.
pub type Cell = [u32; 3];

/// Why no grid could be laid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GridError {
    /// A coordinate is too large.
    #[error("a vertex has the coordinate {0:e}; coordinates up to 1e30 are supported: scale the scene down")]
    TooLarge(f64),
    /// The mesh is too small.
    #[error("the longest side of the scene is {0:e}; at least 1e-24 is needed: scale the scene up")]
    TooSmall(f64),
    /// More intervals than [`MAX_INTERVALS`] or fewer than [`MIN_INTERVALS`] were asked for.
    #[error("a grid of {0} intervals was asked for; 32 to 8192 are possible")]
    Intervals(u32),
    /// More bits of a place inside a cell than [`POSITION_BITS`], or none, were asked for.
    #[error("positions of {0} bits an axis inside a cell were asked for; 1 to 10 are possible")]
    PositionBits(u32),
}

/// A grid and its cell table.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// World position of the low corner: the smallest coordinates of the mesh.
    pub anchor: [f64; 3],
    /// Side of a voxel in world units.
    pub step: f64,
    /// Intervals of the longest side.
    pub intervals: u32,
    /// Cells along each axis, each in 1..=8192.
    pub cells: Cell,
    /// Occupied cells, ascending by (x, y, z); a vertex names one by its place here.
    pub table: Vec<Cell>,
    /// Bits of a place inside a cell that are used, along an axis, in 1..=10: see [`Grid::voxel`].
    pub position_bits: u32,
}

impl Grid {
    /// Lays the finest grid whose occupied cells fit the 16-bit index, with at most `max_intervals` intervals of the longest
    /// side. All positions must be finite. The same positions give the same grid, in any order.
    ///
    /// The number of occupied cells does not grow steadily with the resolution, so what the bisection guarantees is: the
    /// chosen number of intervals fits, and it is `max_intervals` or the next one does not.
    pub fn lay(positions: &[[f64; 3]], max_intervals: u32) -> Result<Self, GridError> {
        if !(MIN_INTERVALS..=MAX_INTERVALS).contains(&max_intervals) {
            return Err(GridError::Intervals(max_intervals));
        }
        let layout = Layout::around(positions)?;
        // Try the finest grid of the paper first: a feasible one leaves only the range above it, an infeasible one that below.
        let mut low = MIN_INTERVALS;
        let mut high = max_intervals;
        let mut best = None;
        if max_intervals > PAPER_INTERVALS {
            match layout.occupied(positions, PAPER_INTERVALS) {
                Some(keys) => (low, best) = (PAPER_INTERVALS, Some(keys)),
                None => high = PAPER_INTERVALS,
            }
        }
        if high == max_intervals
            && let Some(keys) = layout.occupied(positions, high)
        {
            (low, best) = (high, Some(keys));
        }
        // Halve the range between a feasible and an infeasible resolution.
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            match layout.occupied(positions, middle) {
                Some(keys) => (low, best) = (middle, Some(keys)),
                None => high = middle,
            }
        }
        let keys = match best {
            Some(keys) => keys,
            // Every resolution tried was infeasible; 32 intervals are feasible for any mesh.
            None => layout.occupied(positions, low).unwrap_or_default(),
        };
        let mut table: Vec<Cell> = keys.into_iter().map(cell_of_key).collect();
        table.sort_unstable();
        Ok(Self {
            anchor: layout.anchor,
            step: layout.step(low),
            intervals: low,
            cells: layout.cells(low),
            table,
            position_bits: POSITION_BITS,
        })
    }

    /// The same grid with coarser places inside its cells: `bits` along an axis.
    pub fn with_position_bits(self, bits: u32) -> Result<Self, GridError> {
        if !(1..=POSITION_BITS).contains(&bits) {
            return Err(GridError::PositionBits(bits));
        }
        Ok(Self { position_bits: bits, ..self })
    }

    /// Grid and local space.
    ///
    /// Where places inside cells are coarser than a voxel, the space lies half a voxel below the grid: the middle of an even number of
    /// voxels is the border between two of them, and decoding takes the centre of the upper one.
    pub fn frame(&self) -> LocalFrame {
        let shift = if self.voxels_per_place() > 1 { self.step / 2.0 } else { 0.0 };
        // No pack has an anchor beyond the largest coordinate: a mesh that reaches it is half a voxel off.
        let anchor = self.anchor.map(|x| (x - shift).max(-MAX_COORDINATE));
        LocalFrame::of_grid(anchor, self.step, self.cells)
    }

    /// The voxel that holds `position` (finite). Cells and voxels are half open: a point on an inner border belongs to the
    /// higher one. Along each axis the result depends on that coordinate alone and never decreases with it, so equal
    /// coordinates stay equal and flat walls stay flat; `|decoded - x| <= step / 2` up to one rounding of the quotient.
    ///
    /// With fewer [`Grid::position_bits`] `b` than 10, a place is `2^(10 - b)` voxels wide and the upper of the two voxels in its middle stands for
    /// all of them: the bound is `2^(10 - b) step / 2` in the space of [`Grid::frame`], up to that rounding and one of its anchor.
    pub fn voxel(&self, position: [f64; 3]) -> Voxel {
        let width = self.voxels_per_place();
        // Cells are whole places wide: the cell stays the one that was counted.
        voxel(position, self.anchor, self.step, self.cells).map(|u| u / width * width + width / 2)
    }

    /// Width of a place inside a cell, a power of two.
    fn voxels_per_place(&self) -> u32 {
        VOXELS_PER_CELL >> self.position_bits
    }

    /// Place in the table of the cell that holds `voxel`; `None` when that cell holds no vertex.
    pub fn cell_index(&self, voxel: Voxel) -> Option<u16> {
        let rank = self.table.binary_search(&voxel.map(|u| u / VOXELS_PER_CELL)).ok()?;
        u16::try_from(rank).ok()
    }
}

/// Whether three voxel centres lie on one line: their cross product is zero, in whole numbers. Coordinates below 2^23 keep
/// every product below 2^47.
pub fn is_collinear([a, b, c]: [Voxel; 3]) -> bool {
    let edge = |p: Voxel| [0, 1, 2].map(|k| i64::from(p[k]) - i64::from(a[k]));
    let (e, f) = (edge(b), edge(c));
    (0..3).all(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        e[i] * f[j] == e[j] * f[i]
    })
}

/// The mesh's box, before a resolution is chosen.
struct Layout {
    anchor: [f64; 3],
    extent: [f64; 3],
    /// Longest side, enlarged by 2^-19 of itself so that the largest coordinate lies strictly inside; 1 when it would be 0.
    ///
    /// Only the high side is enlarged: the anchor is then a coordinate of the mesh itself, differences to it do not change
    /// when the mesh is moved (as far as the moved coordinates are exact), and so neither do the voxels.
    length: f64,
}

impl Layout {
    fn around(positions: &[[f64; 3]]) -> Result<Self, GridError> {
        let mut min = [f64::INFINITY; 3];
        let mut max = [f64::NEG_INFINITY; 3];
        for p in positions {
            for k in 0..3 {
                min[k] = min[k].min(p[k]);
                max[k] = max[k].max(p[k]);
            }
        }
        if positions.is_empty() {
            (min, max) = ([0.0; 3], [0.0; 3]);
        }
        if let Some(&x) = min.iter().chain(&max).find(|x| x.abs() > MAX_COORDINATE) {
            return Err(GridError::TooLarge(x));
        }
        // + 0.0 turns -0.0 into 0.0: equal meshes have equal headers.
        let anchor = min.map(|x| x + 0.0);
        let extent = [0, 1, 2].map(|k| max[k] - min[k]);
        let longest = extent[0].max(extent[1]).max(extent[2]);
        if longest > 0.0 && longest < MIN_EXTENT {
            return Err(GridError::TooSmall(longest));
        }
        let length = if longest > 0.0 { longest * (1.0 + 1.0 / f64::from(1 << 19)) } else { 1.0 };
        Ok(Self { anchor, extent, length })
    }

    fn step(&self, intervals: u32) -> f64 {
        self.length / f64::from(VOXELS_PER_CELL * intervals)
    }

    /// Cells along each axis: as many as the largest coordinate needs.
    fn cells(&self, intervals: u32) -> Cell {
        let step = self.step(intervals);
        // The longest side spans 1024 N / (1 + 2^-19) < 1024 N voxels, the others no more: at most N cells.
        self.extent.map(|e| (e / step) as u32 / VOXELS_PER_CELL + 1)
    }

    /// Keys of the cells that hold a vertex, in no particular order; `None` when they are more than [`MAX_CELLS`].
    fn occupied(&self, positions: &[[f64; 3]], intervals: u32) -> Option<Vec<u64>> {
        let (step, cells) = (self.step(intervals), self.cells(intervals));
        let mut set = KeySet::new();
        for &p in positions {
            let [x, y, z] = voxel(p, self.anchor, step, cells).map(|u| u64::from(u / VOXELS_PER_CELL));
            if !set.insert(x << 32 | y << 16 | z) {
                return None;
            }
        }
        Some(set.keys)
    }
}

fn cell_of_key(key: u64) -> Cell {
    [(key >> 32) as u32, (key >> 16) as u32 & 0xFFFF, key as u32 & 0xFFFF]
}

/// The one place where a coordinate becomes a voxel; choosing a grid and encoding against it must agree to the last bit.
fn voxel(position: [f64; 3], anchor: [f64; 3], step: f64, cells: Cell) -> Voxel {
    [0, 1, 2].map(|k| {
        let u = ((position[k] - anchor[k]) / step).floor();
        // `as` saturates; the clamp only guards against positions that are not the grid's own.
        (u as u32).min(cells[k] * VOXELS_PER_CELL - 1)
    })
}

/// A set of at most [`MAX_CELLS`] keys: open addressing, a quarter full at most.
struct KeySet {
    /// Place in `keys` plus 1; 0 is free.
    slots: Vec<u32>,
    keys: Vec<u64>,
}

impl KeySet {
    const SLOT_BITS: u32 = 18;

    fn new() -> Self {
        Self { slots: vec![0; 1 << Self::SLOT_BITS], keys: Vec::new() }
    }

    /// Adds `key`; false when the set was full.
    fn insert(&mut self, key: u64) -> bool {
        // Fibonacci hashing: the top bits of the product with 2^64 / golden ratio (Knuth 6.4).
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> (64 - Self::SLOT_BITS)) as usize;
        loop {
            match self.slots[slot] {
                0 if self.keys.len() == MAX_CELLS => return false,
                0 => {
                    self.keys.push(key);
                    self.slots[slot] = self.keys.len() as u32;
                    return true;
                }
                place if self.keys[place as usize - 1] == key => return true,
                _ => slot = (slot + 1) & (self.slots.len() - 1),
            }
        }
    }
}
