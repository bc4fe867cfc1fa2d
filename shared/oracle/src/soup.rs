//! Triangles and chance for tests.

use glam::DVec3;

/// A generator of numbers (splitmix64), the same everywhere.
pub(crate) struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// In [-1, 1) along each axis.
    pub(crate) fn vector(&mut self) -> DVec3 {
        DVec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }
}

/// A closed sphere of radius 1: `rings` rings of `2 rings` quads. Shared corners are equal bit for bit.
pub(crate) fn sphere(rings: u32) -> Vec<[DVec3; 3]> {
    let at = |i: u32, j: u32| {
        let turn = std::f64::consts::PI / f64::from(rings);
        if i == 0 || i == rings {
            return if i == 0 { DVec3::Y } else { DVec3::NEG_Y };
        }
        let (polar, around) = (turn * f64::from(i), turn * f64::from(j % (2 * rings)));
        DVec3::new(
            libm::sin(polar) * libm::cos(around),
            libm::cos(polar),
            libm::sin(polar) * libm::sin(around),
        )
    };
    let mut triangles = Vec::new();
    for i in 0..rings {
        for j in 0..2 * rings {
            if i > 0 {
                triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
            }
            if i + 1 < rings {
                triangles.push([at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)]);
            }
        }
    }
    triangles
}

/// `n^3` cubes side by side on whole numbers: planes full of coplanar triangles, and every inner wall twice.
pub(crate) fn cubes(n: u32) -> Vec<[DVec3; 3]> {
    let mut triangles = Vec::new();
    for cell in 0..n * n * n {
        let low = DVec3::new(f64::from(cell % n), f64::from(cell / n % n), f64::from(cell / n / n));
        for axis in 0..3 {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3]);
            for corner in [low, low + DVec3::AXES[axis]] {
                triangles.push([corner, corner + u, corner + u + v]);
                triangles.push([corner, corner + u + v, corner + v]);
            }
        }
    }
    triangles
}
