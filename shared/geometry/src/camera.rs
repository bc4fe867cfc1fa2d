//! Camera rays.

use crate::{DVec3, LocalFrame, Ray, Vec3};
use std::fmt;

/// A pinhole camera as a user states it, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPose {
    /// Eye position.
    pub eye: DVec3,
    /// A point on the optical axis, different from `eye`.
    pub target: DVec3,
    /// The direction that points up in the image; must not be parallel to the axis.
    pub up: DVec3,
    /// Vertical field of view in degrees, in (0, 180).
    pub fov_degrees: f64,
}

/// A camera as the kernels use it, in local space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalCamera {
    /// Eye position.
    pub origin: Vec3,
    /// Unit vector along the optical axis.
    pub forward: Vec3,
    /// Half the image plane's width at distance 1, pointing right.
    pub right: Vec3,
    /// Half the image plane's height at distance 1, pointing up.
    pub up: Vec3,
}

/// Why a pose cannot be used; every variant is the user's to mend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseError {
    /// A coordinate or the field of view is NaN or infinite.
    NotFinite,
    /// The field of view is not in (0, 180) degrees, or so near to an end that the image plane is boundless or vanishes.
    FieldOfView,
    /// Eye and target coincide.
    NoDirection,
    /// The up vector is zero or parallel to the viewing direction.
    UpParallel,
    /// The eye is more than [`CameraPose::REACH`] voxels from the scene's centre.
    TooFar,
    /// The image has no row or no column.
    NoPixels,
}

impl fmt::Display for PoseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "the camera's eye, target, up vector or field of view is not a finite number",
            Self::FieldOfView => {
                "the camera's vertical field of view must lie between 0 and 180 degrees, both excluded and not \
                 almost reached"
            }
            Self::NoDirection => "the camera's eye and target are the same point: move one of them",
            Self::UpParallel => {
                "the camera's up vector is zero or parallel to the view: choose another one, for example 0,0,1 \
                 when looking straight up or down the y axis"
            }
            Self::TooFar => {
                "the camera's eye is too far from the scene for anything to be seen: move it closer (within \
                 about a million times the scene's size)"
            }
            Self::NoPixels => "the image has no pixels: width and height must be at least 1",
        })
    }
}

impl std::error::Error for PoseError {}

impl CameraPose {
    /// The up vector of a pose that states none.
    pub const DEFAULT_UP: DVec3 = DVec3::Y;

    /// Greatest distance of the eye from the grid's centre along an axis, in voxels.
    ///
    /// The triangle test multiplies three differences of coordinates and adds three such products: differences below
    /// 2^41, edge functions below 2^83 and their products below 2^126 stay finite in `f32`.
    pub const REACH: f64 = (1u64 << 40) as f64;

    /// Least sine of the angle between `up` and the axis. The cross product of two unit vectors is wrong by about
    /// 2^-51 in `f64`; divided by 2^-27, the direction `right` is still right to the 2^-24 of an `f32`.
    const MIN_UP_SINE: f64 = 1.0 / (1u64 << 27) as f64;

    /// Greatest half extent of the image plane at distance 1, so that its square stays finite in `f32`; reached at
    /// 180 - 3e-8 degrees.
    const MAX_HALF_EXTENT: f64 = (1u64 << 32) as f64;

    /// Least half extent of the image plane at distance 1, so that its square is a normal `f32`; reached at 1e-16 degrees.
    const MIN_HALF_EXTENT: f64 = 1.0 / (1u64 << 60) as f64;

    /// The camera in local space for an image of `width` by `height` pixels; `fov_degrees` spans the height.
    pub fn to_local(&self, frame: &LocalFrame, width: u32, height: u32) -> Result<LocalCamera, PoseError> {
        // Refuse what has no meaning.
        if width == 0 || height == 0 {
            return Err(PoseError::NoPixels);
        }
        let finite = self.eye.is_finite() && self.target.is_finite() && self.up.is_finite();
        if !finite || !self.fov_degrees.is_finite() {
            return Err(PoseError::NotFinite);
        }
        if !(self.fov_degrees > 0.0 && self.fov_degrees < 180.0) {
            return Err(PoseError::FieldOfView);
        }

        // Move the eye into local space.
        let eye = (self.eye - frame.anchor) / frame.step - frame.centre;
        if eye.abs().max_element() > Self::REACH {
            return Err(PoseError::TooFar);
        }

        // Span the image plane: right-handed, `right` = forward x up. The map to local space keeps directions.
        let axis = self.target - self.eye;
        if !axis.is_finite() {
            return Err(PoseError::TooFar);
        }
        let forward = unit(axis).ok_or(PoseError::NoDirection)?;
        let side = forward.cross(unit(self.up).ok_or(PoseError::UpParallel)?);
        if side.length() < Self::MIN_UP_SINE {
            return Err(PoseError::UpParallel);
        }
        let right = side.normalize();
        let up = right.cross(forward).normalize();

        // Scale it to the field of view.
        let half_height = libm::tan(self.fov_degrees.to_radians() * 0.5);
        let half_width = half_height * f64::from(width) / f64::from(height);
        if half_height.max(half_width) > Self::MAX_HALF_EXTENT
            || half_height.min(half_width) < Self::MIN_HALF_EXTENT
        {
            return Err(PoseError::FieldOfView);
        }
        Ok(LocalCamera {
            origin: eye.as_vec3(),
            forward: forward.as_vec3(),
            right: (right * half_width).as_vec3(),
            up: (up * half_height).as_vec3(),
        })
    }
}

impl LocalCamera {
    /// The ray through `(x, y)` in pixels from the image's upper left corner; a pixel's centre is at + 0.5.
    pub fn ray(&self, x: f32, y: f32, width: u32, height: u32) -> Ray {
        let u = 2.0 * x / width as f32 - 1.0;
        let v = 1.0 - 2.0 * y / height as f32;
        let direction = (self.forward + self.right * u + self.up * v).normalize();
        Ray { origin: self.origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// `v` at unit length, `None` for zero; scaled first, so that squares neither overflow nor vanish.
fn unit(v: DVec3) -> Option<DVec3> {
    let scale = v.abs().max_element();
    (scale > 0.0).then(|| (v / scale).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FRAME: LocalFrame =
        LocalFrame { anchor: DVec3::ZERO, step: 0.5, centre: DVec3::new(8.0, 8.0, 8.0) };

    fn pose() -> CameraPose {
        CameraPose {
            eye: DVec3::new(1.0, 2.0, 3.0),
            target: DVec3::new(1.0, 2.0, -7.0),
            up: CameraPose::DEFAULT_UP,
            fov_degrees: 90.0,
        }
    }

    fn assert_near(a: Vec3, b: Vec3) {
        assert!((a - b).abs().max_element() <= 4.0 * f32::EPSILON, "{a} is not {b}");
    }

    #[test]
    fn looks_along_the_axis_with_row_0_on_top_and_x_to_the_right() {
        let camera = pose().to_local(&FRAME, 200, 100).expect("a usable pose");
        assert_eq!(camera.origin, Vec3::new(2.0, 4.0, 6.0) - 8.0);
        assert_near(camera.ray(100.0, 50.0, 200, 100).direction, Vec3::NEG_Z);
        // 90 degrees span the height: the top edge's middle rises by 45 degrees; the width is twice as far.
        let s = 0.5f32.sqrt();
        assert_near(camera.ray(100.0, 0.0, 200, 100).direction, Vec3::new(0.0, s, -s));
        assert_near(camera.ray(100.0, 100.0, 200, 100).direction, Vec3::new(0.0, -s, -s));
        assert_near(camera.ray(200.0, 50.0, 200, 100).direction, Vec3::new(2.0, 0.0, -1.0) / 5f32.sqrt());
        assert_near(camera.ray(0.0, 50.0, 200, 100).direction, Vec3::new(-2.0, 0.0, -1.0) / 5f32.sqrt());
    }

    #[test]
    fn refuses_what_has_no_meaning_and_says_what_to_do() {
        let check = |pose: CameraPose, width: u32, wanted: PoseError, hint: &str| {
            let error = pose.to_local(&FRAME, width, 100).expect_err("an unusable pose");
            assert_eq!(error, wanted);
            assert!(error.to_string().contains(hint), "{error}");
        };
        let p = pose();
        let along_y = p.eye - DVec3::Y;
        check(CameraPose { eye: DVec3::NAN, ..p }, 100, PoseError::NotFinite, "finite");
        check(CameraPose { fov_degrees: f64::INFINITY, ..p }, 100, PoseError::NotFinite, "finite");
        check(CameraPose { fov_degrees: 0.0, ..p }, 100, PoseError::FieldOfView, "180");
        check(CameraPose { fov_degrees: 180.0, ..p }, 100, PoseError::FieldOfView, "180");
        check(CameraPose { fov_degrees: 1e-17, ..p }, 100, PoseError::FieldOfView, "180");
        check(CameraPose { fov_degrees: 180.0f64.next_down(), ..p }, 100, PoseError::FieldOfView, "180");
        check(CameraPose { target: p.eye, ..p }, 100, PoseError::NoDirection, "same point");
        check(CameraPose { target: along_y, ..p }, 100, PoseError::UpParallel, "0,0,1");
        check(CameraPose { up: DVec3::ZERO, ..p }, 100, PoseError::UpParallel, "0,0,1");
        check(CameraPose { eye: DVec3::splat(1e200), ..p }, 100, PoseError::TooFar, "closer");
        check(CameraPose { target: DVec3::splat(-f64::MAX), eye: p.eye, ..p }, 0, PoseError::NoPixels, "1");
    }

    #[test]
    fn the_greatest_coordinates_and_the_smallest_distances_still_have_a_direction() {
        for scale in [1e-200, 1e-12, 1.0, 1e12, 1e300] {
            let p = CameraPose {
                eye: DVec3::ZERO,
                target: DVec3::new(0.0, 0.0, -scale),
                up: DVec3::Y * scale,
                ..pose()
            };
            let camera = p.to_local(&FRAME, 1, 1).expect("a usable pose");
            assert_eq!(camera.ray(0.5, 0.5, 1, 1).direction, Vec3::NEG_Z, "scale {scale}");
        }
    }

    proptest! {
        #[test]
        fn every_ray_is_finite_and_of_unit_length(
            eye in prop::array::uniform3(-1e7..1e7f64),
            target in prop::array::uniform3(-1e7..1e7f64),
            fov in prop::sample::select(vec![1e-4, 1.0, 60.0, 179.9]),
            at in (0.0..1.0f32, 0.0..1.0f32),
        ) {
            let p = CameraPose { eye: eye.into(), target: target.into(), up: DVec3::Y, fov_degrees: fov };
            let camera = p.to_local(&FRAME, 1920, 1080).expect("a usable pose");
            let direction = camera.ray(at.0 * 1920.0, at.1 * 1080.0, 1920, 1080).direction;
            prop_assert!((direction.length() - 1.0).abs() <= 4.0 * f32::EPSILON);
        }
    }
}
