//! What is looked at, and where the samples of a pixel lie.

use crate::triangle::Ray;
use glam::DVec3;
use tessera_geometry::CameraPose;

/// Everything but the scene that a picture depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera, in world space.
    pub pose: CameraPose,
    /// Columns, at least 1.
    pub width: u32,
    /// Rows, at least 1; both together at most [`View::PIXELS_MAX`] pixels.
    pub height: u32,
    /// Samples a pixel, at least 1. One goes through the pixel's centre. More are a rank-1 lattice, the same in every pixel: sample
    /// `i` of `n` lies at `((i + 1/2) / n, frac((i + 1/2) g))` with `g = (sqrt(5) - 1) / 2`, whose discrepancy is O(log n / n); it
    /// has nothing in common with the kernels' samplers but the mean that all of them tend to.
    pub samples: u32,
    /// Mirror and bent rays that a path may take.
    pub depth: u32,
    /// Weight in its sample below which a ray is not traced, at least 0; the kernels' is 1/512. What is left out of a pixel is at
    /// most [`OracleImage::cut_weight`](crate::OracleImage::cut_weight) times the largest radiance in the scene, and that is at most
    /// `depth` (each generation's rays weigh no more than 1 together). 0 cuts off nothing: time then grows as 2^depth behind glass.
    pub min_weight: f64,
}

/// Why a view cannot be rendered; every variant is the user's to mend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewError {
    /// No column or no row.
    #[error("the image has no pixels: width and height must be at least 1")]
    NoPixels,
    /// More than [`View::PIXELS_MAX`].
    #[error("the image has more than {} pixels, the oracle's limit: choose a smaller size", View::PIXELS_MAX)]
    TooManyPixels,
    /// No samples.
    #[error("the number of samples a pixel must be at least 1")]
    NoSamples,
    /// A weight that is negative or no number.
    #[error("the least weight of a ray must be a number of at least 0")]
    Weight,
    /// A coordinate or the field of view is NaN or infinite.
    #[error("the camera's eye, target, up vector or field of view is not a finite number")]
    NotFinite,
    /// The field of view is out of range.
    #[error("the camera's vertical field of view must lie between 0 and 180 degrees, both excluded")]
    FieldOfView,
    /// Eye and target coincide.
    #[error("the camera's eye and target are the same point: move one of them")]
    NoDirection,
    /// The up vector is zero or parallel to the viewing direction.
    #[error("the camera's up vector is zero or parallel to the view: choose another one")]
    UpParallel,
}

impl View {
    /// Most pixels of a picture: 8192 x 8192, which take 5 GiB here.
    pub const PIXELS_MAX: u64 = 1 << 26;

    /// Whether it can be rendered.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn check(&self) -> Result<(), ViewError> {
        if self.width == 0 || self.height == 0 {
            return Err(ViewError::NoPixels);
        }
        if u64::from(self.width) * u64::from(self.height) > Self::PIXELS_MAX {
            return Err(ViewError::TooManyPixels);
        }
        if self.samples == 0 {
            return Err(ViewError::NoSamples);
        }
        if !(self.min_weight >= 0.0 && self.min_weight.is_finite()) {
            return Err(ViewError::Weight);
        }
        Lens::new(self).map(|_| ())
    }
}

/// A camera that makes rays.
pub(crate) struct Lens {
    eye: DVec3,
    forward: DVec3,
    /// Half the image plane at distance 1.
    right: DVec3,
    up: DVec3,
    width: f64,
    height: f64,
}

impl Lens {
    pub(crate) fn new(view: &View) -> Result<Self, ViewError> {
        let CameraPose { eye, target, up, fov_degrees } = view.pose;
        if !(eye.is_finite() && target.is_finite() && up.is_finite() && fov_degrees.is_finite()) {
            return Err(ViewError::NotFinite);
        }
        if !(fov_degrees > 0.0 && fov_degrees < 180.0) {
            return Err(ViewError::FieldOfView);
        }

        // Right-handed: right is forward x up.
        let forward = unit(target - eye).ok_or(ViewError::NoDirection)?;
        let side = forward.cross(unit(up).ok_or(ViewError::UpParallel)?);
        // Both are wrong by 2^-52 or so: below 2^-27 the difference has no direction of 25 bits.
        if side.length() < 1.0 / f64::from(1 << 27) {
            return Err(ViewError::UpParallel);
        }
        let right = side.normalize();
        let up = right.cross(forward);

        // The field of view spans the height.
        let (width, height) = (f64::from(view.width), f64::from(view.height));
        let half_height = libm::tan(fov_degrees.to_radians() / 2.0);
        let half_width = half_height * width / height;
        let in_range = |x: f64| x > 0.0 && x.is_finite();
        if !in_range(half_height) || !in_range(half_width) {
            return Err(ViewError::FieldOfView);
        }
        Ok(Self { eye, forward, right: right * half_width, up: up * half_height, width, height })
    }

    /// The ray through `(x, y)` pixels from the upper left corner of the image.
    pub(crate) fn ray(&self, x: f64, y: f64) -> Ray {
        let across = self.right * (2.0 * x / self.width - 1.0);
        let upward = self.up * (1.0 - 2.0 * y / self.height);
        Ray::new(self.eye, (self.forward + across + upward).normalize())
    }
}

/// Sample `index` of `count` in a pixel.
pub(crate) fn sample(index: u32, count: u32) -> [f64; 2] {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    if count <= 1 {
        return [0.5, 0.5];
    }
    let place = f64::from(index) + 0.5;
    [place / f64::from(count), (place * GOLDEN).fract()]
}

/// The direction of a vector of any finite size.
fn unit(vector: DVec3) -> Option<DVec3> {
    let largest = vector.abs().max_element();
    (largest > 0.0 && largest.is_finite()).then(|| (vector / largest).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let pose = CameraPose { eye: DVec3::ZERO, target: DVec3::NEG_Z, up: DVec3::Y, fov_degrees: 90.0 };
        View { pose, width: 4, height: 2, samples: 1, depth: 3, min_weight: 0.0 }
    }

    #[test]
    fn rays_fill_the_field_of_view_from_the_upper_left() {
        let lens = Lens::new(&view()).expect("usable");
        for (x, y, expected) in [(0.0, 0.0, [-2.0, 1.0]), (4.0, 2.0, [2.0, -1.0]), (2.0, 1.0, [0.0, 0.0])] {
            let expected = DVec3::new(expected[0], expected[1], -1.0).normalize();
            assert!((lens.ray(x, y).direction - expected).length() < 1e-15, "{x} {y}");
        }
    }

    #[test]
    fn samples_are_spread_evenly() {
        assert_eq!(sample(0, 1), [0.5, 0.5]);
        for count in [2u32, 5, 16, 89, 256] {
            let mut at: Vec<[f64; 2]> = (0..count).map(|index| sample(index, count)).collect();
            // One a column; and rows that are nowhere emptier than a golden lattice is (its gaps are at most g^-2 < 2.62 / count).
            assert!((0..count).all(|k| (at[k as usize][0] * f64::from(count)) as u32 == k));
            at.sort_by(|p, q| p[1].total_cmp(&q[1]));
            let gaps = at
                .windows(2)
                .map(|pair| pair[1][1] - pair[0][1])
                .chain([at[0][1] + 1.0 - at[count as usize - 1][1]]);
            let widest = gaps.fold(0.0, f64::max);
            assert!(widest <= 2.62 / f64::from(count), "{count}: {widest}");
        }
    }

    #[test]
    fn what_cannot_be_seen_is_refused() {
        assert_eq!(view().check(), Ok(()));
        let broken = |change: &dyn Fn(&mut View)| {
            let mut view = view();
            change(&mut view);
            view.check().expect_err("it cannot be used")
        };
        assert_eq!(broken(&|v| v.width = 0), ViewError::NoPixels);
        assert_eq!(broken(&|v| (v.width, v.height) = (u32::MAX, u32::MAX)), ViewError::TooManyPixels);
        assert_eq!(broken(&|v| v.samples = 0), ViewError::NoSamples);
        assert_eq!(broken(&|v| v.min_weight = f64::NAN), ViewError::Weight);
        assert_eq!(broken(&|v| v.min_weight = -1.0), ViewError::Weight);
        assert_eq!(broken(&|v| v.pose.eye.x = f64::INFINITY), ViewError::NotFinite);
        assert_eq!(broken(&|v| v.pose.fov_degrees = 180.0), ViewError::FieldOfView);
        assert_eq!(broken(&|v| v.pose.target = DVec3::ZERO), ViewError::NoDirection);
        assert_eq!(broken(&|v| v.pose.up = DVec3::Z), ViewError::UpParallel);
        assert_eq!(broken(&|v| v.pose.up = DVec3::ZERO), ViewError::UpParallel);
    }
}
