//! Pictures of the oracle.

use crate::NO_TRIANGLE;

/// A picture. Vectors hold `width * height` pixels, rows from the top; [`OracleImage::to_layers`] says what the kernels call the same.
#[derive(Clone, Debug, PartialEq)]
pub struct OracleImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear red, green, blue, premultiplied by alpha, and alpha in [0, 1]: the mean over the samples.
    pub color: Vec<[f64; 4]>,
    /// Distance from the eye to the first surface behind the pixel's centre that covers anything, in scene units; `+inf` on a miss.
    pub depth: Vec<f64>,
    /// Its unit geometric normal on the side on which it winds counter-clockwise; 0 on a miss.
    pub normal: Vec<[f64; 3]>,
    /// Its place in the flattened scene; [`NO_TRIANGLE`] on a miss.
    pub id: Vec<u32>,
    /// Rays traced; zero of a picture that was read from a file.
    pub rays: RayCounts,
    /// The largest weight, over the pixels, of all the rays together that were left out for weighing less than
    /// [`View::min_weight`](crate::View::min_weight): no pixel is off by more than this times the largest radiance that such a ray
    /// could have seen. 0 of a picture that was read from a file.
    pub cut_weight: f64,
}

/// Rays traced, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// From the eye.
    pub primary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Off mirrors.
    pub reflection: u64,
    /// Through glass, and straight on through partly covered surfaces.
    pub refraction: u64,
}

impl RayCounts {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.primary + self.shadow + self.reflection + self.refraction
    }
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, other: Self) {
        self.primary += other.primary;
        self.shadow += other.shadow;
        self.reflection += other.reflection;
        self.refraction += other.refraction;
    }
}

/// Rows that do not fill their picture; the caller's fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {width} x {height} pixels takes {expected} bytes as layers, and {found} came")]
pub struct LayersError {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes that it takes.
    pub expected: u64,
    /// Bytes that came.
    pub found: u64,
}

/// Words of a pixel.
const WORDS: usize = 9;

impl OracleImage {
    /// The rows in the wire format `layers`: of each pixel `f32` red, green, blue, alpha, depth, normal x, y, z and `u32` id, little
    /// endian, 36 bytes; every number is rounded once.
    pub fn to_layers(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.id.len() * WORDS * 4);
        for (k, id) in self.id.iter().enumerate() {
            let ([r, g, b, a], [x, y, z]) = (self.color[k], self.normal[k]);
            for value in [r, g, b, a, self.depth[k], x, y, z] {
                bytes.extend_from_slice(&(value as f32).to_le_bytes());
            }
            bytes.extend_from_slice(&id.to_le_bytes());
        }
        bytes
    }

    /// The picture whose [`OracleImage::to_layers`] are `bytes`.
    ///
    /// # Errors
    /// [`LayersError`] when the length is another.
    pub fn from_layers(width: u32, height: u32, bytes: &[u8]) -> Result<Self, LayersError> {
        let expected = u64::from(width) * u64::from(height) * (WORDS * 4) as u64;
        if bytes.len() as u64 != expected {
            return Err(LayersError { width, height, expected, found: bytes.len() as u64 });
        }
        let pixels = bytes.len() / (WORDS * 4);
        let mut image = Self {
            width,
            height,
            color: Vec::with_capacity(pixels),
            depth: Vec::with_capacity(pixels),
            normal: Vec::with_capacity(pixels),
            id: Vec::with_capacity(pixels),
            rays: RayCounts::default(),
            cut_weight: 0.0,
        };
        for pixel in bytes.chunks_exact(WORDS * 4) {
            let word = |k: usize| std::array::from_fn(|byte| pixel[k * 4 + byte]);
            let number = |k: usize| f64::from(f32::from_le_bytes(word(k)));
            image.color.push([0, 1, 2, 3].map(number));
            image.depth.push(number(4));
            image.normal.push([5, 6, 7].map(number));
            image.id.push(u32::from_le_bytes(word(8)));
        }
        Ok(image)
    }

    /// Whether pixel `k` shows a surface.
    pub fn is_hit(&self, k: usize) -> bool {
        self.id[k] != NO_TRIANGLE
    }
}
