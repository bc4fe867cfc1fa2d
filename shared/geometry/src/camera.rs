//! Camera rays.

use crate::{DVec3, LocalFrame, Ray, Vec3};

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

/// Why a pose cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseError {
    /// A coordinate or the field of view is NaN or infinite.
    NotFinite,
    /// The field of view is not in (0, 180) degrees.
    FieldOfView,
    /// Eye and target coincide.
    NoDirection,
    /// The up vector is zero or parallel to the viewing direction.
    UpParallel,
}

impl CameraPose {
    /// The camera in local space for an image of `width` by `height` pixels.
    pub fn to_local(&self, frame: &LocalFrame, width: u32, height: u32) -> Result<LocalCamera, PoseError> {
        let _ = (frame, width, height);
        Err(PoseError::NotFinite)
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
