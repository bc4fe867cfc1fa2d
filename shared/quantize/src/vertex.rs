//! The bits of a packed vertex.
//!
//! Three little-endian words, two when the mesh has no texture coordinates:
//!
//! | word | bits | meaning |
//! |---|---|---|
//! | `w0` | 0..=9, 10..=19, 20..=29 | voxel offsets x, y, z inside the cell |
//! | | 30 | texture coordinates are in the side table; `w2` is 0 |
//! | | 31 | 0 |
//! | `w1` | 0..=15 | place of the cell in the cell table |
//! | | 16..=31 | normal code of either [`crate::NormalCode`], [`crate::NO_NORMAL`] for none |
//! | `w2` | 0..=15, 16..=31 | texture coordinates s and t, units of 2^-15 |
//!
//! Worked example: cell 5, offsets (1, 2, 1023), normal code 0x1234, (s, t) = (0.5, 1.25) with the shift taken off:
//! `w0 = 1 | 2 << 10 | 1023 << 20 = 0x3FF0_0801`, `w1 = 5 | 0x1234 << 16 = 0x1234_0005`,
//! `w2 = 0x4000 | 0xA000 << 16 = 0xA000_4000`.
//!
//! The paper packs position and cell into six bytes (46 of 48 bits); here they fill the low parts of two words, so that a
//! record is read as aligned words on every device.

use crate::grid::{VOXELS_PER_CELL, Voxel};

/// The record's text for GPUs.
pub const WGSL: &str = include_str!("vertex.wgsl");

/// Words of a record with texture coordinates.
pub const WORDS_MAX: usize = 3;
/// Units of a packed texture coordinate in 1.0.
const UV_UNITS: f32 = 32_768.0;

const SIDE_UV_BIT: u32 = 1 << 30;

/// A packed vertex. All three words are kept here; a mesh without texture coordinates stores the first two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record(pub [u32; WORDS_MAX]);

impl Record {
    /// Packs a vertex; `voxel` is reduced to its offsets inside the cell that `cell` names.
    pub fn new(voxel: Voxel, cell: u16, normal: u16) -> Self {
        let [x, y, z] = voxel.map(|u| u % VOXELS_PER_CELL);
        Self([x | y << 10 | z << 20, u32::from(cell) | u32::from(normal) << 16, 0])
    }

    /// With packed texture coordinates.
    #[must_use]
    pub fn with_uv(self, [s, t]: [u16; 2]) -> Self {
        Self([self.0[0], self.0[1], u32::from(s) | u32::from(t) << 16])
    }

    /// With texture coordinates in the side table.
    #[must_use]
    pub fn with_side_uv(self) -> Self {
        Self([self.0[0] | SIDE_UV_BIT, self.0[1], 0])
    }

    /// Offsets inside the cell, each below 1024.
    #[inline]
    pub fn offsets(self) -> [u32; 3] {
        let w = self.0[0];
        [w & 1023, w >> 10 & 1023, w >> 20 & 1023]
    }

    /// Place in the cell table.
    #[inline]
    pub fn cell(self) -> u16 {
        self.0[1] as u16
    }

    /// Normal code.
    #[inline]
    pub fn normal(self) -> u16 {
        (self.0[1] >> 16) as u16
    }

    /// Whether the texture coordinates are in the side table.
    #[inline]
    pub fn has_side_uv(self) -> bool {
        self.0[0] & SIDE_UV_BIT != 0
    }

    /// Texture coordinates in units of 2^-15, unless they are in the side table.
    #[inline]
    pub fn uv_units(self) -> [u16; 2] {
        [self.0[2] as u16, (self.0[2] >> 16) as u16]
    }

    /// Texture coordinates, each in [0, 2), exact.
    #[inline]
    pub fn uv(self) -> [f32; 2] {
        self.uv_units().map(|q| f32::from(q) / UV_UNITS)
    }

    /// Whether bits that must be 0 are.
    pub fn reserved_bits_are_zero(self) -> bool {
        self.0[0] >> 31 == 0 && (!self.has_side_uv() || self.0[2] == 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worked_example() {
        let r = Record::new([7 * 1024 + 1, 2, 1024 + 1023], 5, 0x1234).with_uv([0x4000, 0xA000]);
        assert_eq!(r.0, [0x3FF0_0801, 0x1234_0005, 0xA000_4000]);
        assert_eq!((r.offsets(), r.cell(), r.normal(), r.uv()), ([1, 2, 1023], 5, 0x1234, [0.5, 1.25]));
        assert!(!r.has_side_uv() && r.reserved_bits_are_zero());
        let side = r.with_side_uv();
        assert!(side.has_side_uv() && side.reserved_bits_are_zero());
        assert_eq!((side.offsets(), side.cell(), side.normal()), (r.offsets(), 5, 0x1234));
        assert!(!Record([1 << 31, 0, 0]).reserved_bits_are_zero());
        assert!(!Record([1 << 30, 0, 1]).reserved_bits_are_zero());
    }

    #[test]
    fn fields_do_not_touch_each_other() {
        let full = Record::new([1023; 3], u16::MAX, u16::MAX).with_uv([u16::MAX; 2]);
        assert_eq!(full.0, [0x3FFF_FFFF, u32::MAX, u32::MAX]);
        for k in 0..3 {
            let mut voxel = [0; 3];
            voxel[k] = 1023;
            assert_eq!(Record::new(voxel, 0, 0).offsets(), voxel);
        }
    }
}
