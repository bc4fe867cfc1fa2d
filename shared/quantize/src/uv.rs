//! Texture coordinates as 1 + 15 bits a component, whole-number shifts, and the vertex splits that shifts cost.
//!
//! A packed component is `round(32768 x)` for x in [0, 2]: the error is at most 2^-16, and 2^-15 at the upper end, where 2 itself
//! does not fit. With fewer [`UvBits`], `1 + b` of them, it is rounded to a multiple of 2^-b when it is packed; then the error is at most
//! 2^-(b + 1), and 2^-b at the upper end. What is decoded, and how, stays the same. A texture that repeats looks the same when a whole number is taken off all three corners of a triangle, so
//! most triangles can be moved into that range (Seo, Park, Ihm 2022, section 3.1). Which shifts are allowed depends on the
//! triangle's extent and on how its textures go on outside [0, 1): see [`WrapRule`].
//!
//! Neighbours that share a vertex and can agree on a shift share the packed vertex too; where they cannot, the vertex is split:
//! the copies have one position and one normal code, so the mesh stays watertight. A triangle that fits under no shift keeps its
//! corners as `f32` in a side table. Nothing is ever wrapped silently.

use tessera_geometry::mutation::{Mutation, is_on, unless};

/// Largest texture coordinate accepted: beyond it an `f32` keeps only the first bit of the fraction.
pub const MAX_UV: f32 = 4_194_304.0;

/// Bits that a packed component uses: one before the point and up to 15 behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UvBits(u32);

impl UvBits {
    /// All that there are: 16.
    pub const ALL: Self = Self(16);

    /// `bits` in 1..=16, otherwise `None`.
    pub fn new(bits: u32) -> Option<Self> {
        (1..=Self::ALL.0).contains(&bits).then_some(Self(bits))
    }

    /// How many.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Units of 2^-15 between neighbouring values.
    const fn step(self) -> u32 {
        1 << (Self::ALL.0 - self.0)
    }

    /// Largest value that packs with an error of half a step: with all bits 65,535.5 units.
    fn packed_max(self) -> f64 {
        2.0 - f64::from(self.step()) / 65_536.0
    }

    /// `x` in [0, 2], rounded to a step, in units of 2^-15; 2 becomes the largest value, 65,535 with all bits.
    fn pack(self, x: f64) -> u16 {
        let step = self.step();
        // `as` saturates at both ends.
        let steps = x * 32_768.0 / f64::from(step);
        let steps = unless(Mutation::UvTruncated, steps.round(), steps.floor()) as u32;
        (steps.min(65_536 / step - 1) * step) as u16
    }
}

/// Which whole-number shifts keep the look of a texture along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum WrapRule {
    /// The texture repeats: any.
    Any,
    /// It repeats mirrored, with period 2: even ones.
    Even,
    /// Its border goes on: none.
    Fixed,
}

/// A texture coordinate that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvError {
    /// Place of the triangle in the list.
    pub triangle: usize,
    /// Its corner.
    pub corner: usize,
    /// The coordinate beyond [`MAX_UV`].
    pub value: f32,
}

/// How one packed vertex keeps its texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackedUv {
    /// In units of 2^-15, the shift taken off, rounded to the bits that are used.
    Units([u16; 2]),
    /// As they are, in the side table.
    Side,
    /// Not at all: no texture reads them.
    Unread,
}

/// The packed vertices: copies of the input's, in its order, and without those that no triangle uses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UvPlan {
    /// The input vertex of each packed vertex, ascending; equal for the copies of a split vertex.
    pub source: Vec<u32>,
    /// Texture coordinates of each packed vertex; empty when there are none at all.
    pub uv: Vec<PackedUv>,
    /// Vertices added by splitting.
    pub split_vertices: u64,
    /// Triangles that fit under no shift.
    pub side_triangles: u64,
}

impl UvPlan {
    /// Drops unused vertices only; `triangles` then name packed vertices.
    pub fn without_uvs(vertices: usize, triangles: &mut [[u32; 3]]) -> Self {
        let mut packed = vec![0u32; vertices];
        for v in triangles.iter().flatten() {
            packed[*v as usize] = 1;
        }
        let mut source = Vec::new();
        for (v, slot) in packed.iter_mut().enumerate() {
            if *slot != 0 {
                *slot = source.len() as u32;
                source.push(v as u32);
            }
        }
        for v in triangles.iter_mut().flatten() {
            *v = packed[*v as usize];
        }
        Self { source, ..Self::default() }
    }

    /// Chooses shifts and splits for `triangles` over vertices with the (finite) coordinates `uvs`, of which `bits` are kept; `triangles` then
    /// name packed vertices. `rule` gives the rule along s and t of a triangle, or `None` when its surface reads no texture.
    ///
    /// Panics when a triangle names a vertex beyond `uvs`.
    pub fn choose(
        uvs: &[[f32; 2]],
        triangles: &mut [[u32; 3]],
        bits: UvBits,
        rule: impl Fn(usize) -> Option<[WrapRule; 2]>,
    ) -> Result<Self, UvError> {
        let mut variants = Variants::new(uvs.len());
        let mut side_triangles = 0;
        // Triangles that fit under no shift first: their neighbours can then use the same wide vertices.
        let mut narrow = vec![false; triangles.len()];
        for (id, triangle) in triangles.iter_mut().enumerate() {
            let Some(rule) = rule(id) else { continue };
            let corners = triangle.map(|v| uvs[v as usize]);
            if let Some((corner, value)) = out_of_range(&corners) {
                return Err(UvError { triangle: id, corner, value });
            }
            if allowed_shifts(&corners, rule, bits).is_some() {
                narrow[id] = true;
            } else {
                *triangle = triangle.map(|v| variants.side(v));
                side_triangles += 1;
            }
        }
        // Join each of the others to the vertices that its neighbours made, as far as they can agree.
        for (id, triangle) in triangles.iter_mut().enumerate() {
            if !narrow[id] {
                continue;
            }
            if let [Some(a), Some(b), Some(c)] = triangle.map(|v| variants.existing_side(v)) {
                *triangle = [a, b, c];
                continue;
            }
            let corners = triangle.map(|v| uvs[v as usize]);
            let shifts = rule(id).and_then(|r| allowed_shifts(&corners, r, bits));
            // Always there: `narrow` was set by the same call.
            let Some(shifts) = shifts else { continue };
            *triangle = variants.join(*triangle, shifts);
        }
        // Surfaces without a texture take whatever is there.
        for (id, triangle) in triangles.iter_mut().enumerate() {
            if rule(id).is_none() {
                *triangle = triangle.map(|v| variants.any(v));
            }
        }
        Ok(variants.finish(uvs, triangles, bits, side_triangles))
    }
}

fn out_of_range(corners: &[[f32; 2]; 3]) -> Option<(usize, f32)> {
    let beyond = |x: &&f32| x.abs() > MAX_UV;
    corners.iter().enumerate().find_map(|(k, uv)| uv.iter().find(beyond).map(|&x| (k, x)))
}

/// Shifts along s and t under which a triangle packs; `None` when there are none.
fn allowed_shifts(corners: &[[f32; 2]; 3], rule: [WrapRule; 2], bits: UvBits) -> Option<[Shifts; 2]> {
    let axis = |k: usize| {
        let [a, b, c] = corners.map(|uv| uv[k]);
        Shifts::allowed(f64::from(a.min(b).min(c)), f64::from(a.max(b).max(c)), rule[k], bits)
    };
    Some([axis(0)?, axis(1)?])
}

/// A range of whole-number shifts, never empty; its ends are even when only even ones count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shifts {
    low: i32,
    high: i32,
    even: bool,
}

impl Shifts {
    /// Shifts h with `low - h >= 0` and `high - h` no more than packs within half a step; when there is none, the one shift for which
    /// `high - h <= 2` packs within a step. `|low|, |high| <= MAX_UV`.
    fn allowed(low: f64, high: f64, rule: WrapRule, bits: UvBits) -> Option<Self> {
        if rule == WrapRule::Fixed {
            return (low >= 0.0 && high <= 2.0).then_some(Self { low: 0, high: 0, even: false });
        }
        let even = rule == WrapRule::Even && !is_on(Mutation::MirrorShift);
        let greatest = low.floor() as i32;
        let greatest = if even { greatest & !1 } else { greatest };
        let least = (high - bits.packed_max()).ceil() as i32;
        match Self::new(least, greatest, even) {
            None if high - f64::from(greatest) <= 2.0 => Some(Self { low: greatest, high: greatest, even }),
            shifts => shifts,
        }
    }

    fn new(low: i32, high: i32, even: bool) -> Option<Self> {
        // & !1 rounds down to even for negative numbers too.
        let (low, high) = if even { ((low + 1) & !1, high & !1) } else { (low, high) };
        (low <= high).then_some(Self { low, high, even })
    }

    fn intersection(self, other: Self) -> Option<Self> {
        Self::new(self.low.max(other.low), self.high.min(other.high), self.even || other.even)
    }

    /// 0 where it is allowed, otherwise the greatest.
    fn choice(self) -> i32 {
        if self.low <= 0 && 0 <= self.high { 0 } else { self.high }
    }
}

fn both(a: [Shifts; 2], b: [Shifts; 2]) -> Option<[Shifts; 2]> {
    Some([a[0].intersection(b[0])?, a[1].intersection(b[1])?])
}

const NONE: u32 = u32::MAX;
/// In place of a parent: the vertex keeps its coordinates in the side table.
const SIDE: u32 = u32::MAX - 1;
/// Any shift at all: no texture has asked for anything.
const UNBOUND: [Shifts; 2] = [Shifts { low: i32::MIN / 2, high: i32::MAX / 2, even: false }; 2];

/// The packed vertices while they are being made: copies of input vertices, and a union-find forest over them whose trees are
/// sets of copies with one shift.
struct Variants {
    /// First copy of each input vertex.
    head: Vec<u32>,
    /// Next copy of the same input vertex.
    next: Vec<u32>,
    parent: Vec<u32>,
    /// Shifts allowed to a whole tree, kept at its root.
    shifts: Vec<[Shifts; 2]>,
}

impl Variants {
    fn new(vertices: usize) -> Self {
        Self { head: vec![NONE; vertices], next: Vec::new(), parent: Vec::new(), shifts: Vec::new() }
    }

    /// First copy of `vertex` that `pick` takes.
    fn find_copy(&mut self, vertex: u32, mut pick: impl FnMut(&mut Self, u32) -> bool) -> Option<u32> {
        let mut copy = self.head[vertex as usize];
        while copy != NONE {
            if pick(self, copy) {
                return Some(copy);
            }
            copy = self.next[copy as usize];
        }
        None
    }

    /// Adds a copy of `vertex` behind the others: a tree of its own, or a side-table copy.
    fn add(&mut self, vertex: u32, parent: Option<u32>, shifts: [Shifts; 2]) -> u32 {
        let copy = self.parent.len() as u32;
        self.next.push(NONE);
        self.parent.push(parent.unwrap_or(copy));
        self.shifts.push(shifts);
        let mut last = NONE;
        self.find_copy(vertex, |_, c| {
            last = c;
            false
        });
        match last {
            NONE => self.head[vertex as usize] = copy,
            last => self.next[last as usize] = copy,
        }
        copy
    }

    fn existing_side(&mut self, vertex: u32) -> Option<u32> {
        self.find_copy(vertex, |v, copy| v.parent[copy as usize] == SIDE)
    }

    fn side(&mut self, vertex: u32) -> u32 {
        match self.existing_side(vertex) {
            Some(copy) => copy,
            None => self.add(vertex, Some(SIDE), UNBOUND),
        }
    }

    fn any(&mut self, vertex: u32) -> u32 {
        match self.head[vertex as usize] {
            NONE => self.add(vertex, None, UNBOUND),
            copy => copy,
        }
    }

    fn root(&mut self, mut copy: u32) -> u32 {
        // Path halving.
        while self.parent[copy as usize] != copy {
            let grandparent = self.parent[self.parent[copy as usize] as usize];
            self.parent[copy as usize] = grandparent;
            copy = grandparent;
        }
        copy
    }

    /// Copies of the three corners that share a shift in `shifts`: existing ones where they agree, new ones elsewhere.
    fn join(&mut self, corners: [u32; 3], mut shifts: [Shifts; 2]) -> [u32; 3] {
        let copies = corners.map(|vertex| {
            let found = self.find_copy(vertex, |v, copy| {
                if v.parent[copy as usize] == SIDE {
                    return false;
                }
                let root = v.root(copy);
                match both(shifts, v.shifts[root as usize]) {
                    Some(common) => {
                        shifts = common;
                        true
                    }
                    None => false,
                }
            });
            match found {
                Some(copy) => copy,
                None => self.add(vertex, None, shifts),
            }
        });
        // The smallest root becomes the root of all: no order but that of the triangles decides.
        let roots = copies.map(|c| self.root(c));
        let root = roots[0].min(roots[1]).min(roots[2]);
        for r in roots {
            self.parent[r as usize] = root;
        }
        self.shifts[root as usize] = shifts;
        copies
    }

    /// Numbers the copies by input vertex, then by age, and fixes their shifts.
    fn finish(
        mut self,
        uvs: &[[f32; 2]],
        triangles: &mut [[u32; 3]],
        bits: UvBits,
        side_triangles: u64,
    ) -> UvPlan {
        let count = self.parent.len();
        let mut plan = UvPlan {
            source: Vec::with_capacity(count),
            uv: Vec::with_capacity(count),
            split_vertices: 0,
            side_triangles,
        };
        let mut number = vec![0u32; count];
        for (vertex, uv) in uvs.iter().enumerate() {
            let mut copies = 0;
            let mut copy = self.head[vertex];
            while copy != NONE {
                number[copy as usize] = plan.source.len() as u32;
                plan.source.push(vertex as u32);
                let packed = if self.parent[copy as usize] == SIDE {
                    PackedUv::Side
                } else {
                    let root = self.root(copy);
                    match self.shifts[root as usize] {
                        UNBOUND => PackedUv::Unread,
                        shifts => PackedUv::Units(
                            [0, 1].map(|k| bits.pack(f64::from(uv[k]) - f64::from(shifts[k].choice()))),
                        ),
                    }
                };
                plan.uv.push(packed);
                copies += 1;
                copy = self.next[copy as usize];
            }
            plan.split_vertices += u64::from(u32::saturating_sub(copies, 1));
        }
        for v in triangles.iter_mut().flatten() {
            *v = number[*v as usize];
        }
        plan
    }
}
