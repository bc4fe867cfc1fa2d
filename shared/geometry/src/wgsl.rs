//! The kernels' text for GPUs, in the order in which it is read; each file is the sibling of the one in Rust of its name.

use crate::rounding::gamma;
use crate::{Hit, Ray};

/// Text that every device takes.
pub const COMMON: [&str; 4] = [
    include_str!("arithmetic.wgsl"),
    include_str!("ray.wgsl"),
    include_str!("camera.wgsl"),
    include_str!("triangle.wgsl"),
];

/// For devices that compute in `f64`: quotients, roots, and where a ray crosses a triangle, as on the CPU.
pub const F64: [&str; 2] = [include_str!("arithmetic_f64.wgsl"), include_str!("locate_f64.wgsl")];

/// For devices that do not.
pub const F32: [&str; 2] = [include_str!("arithmetic_f32.wgsl"), include_str!("locate_f32.wgsl")];

/// Constants of the text and the bits that they must have, by which a test holds it to this crate.
pub const CONSTANTS: [(&str, u32); 8] = [
    ("FAR", f32::MAX.to_bits()),
    ("NO_TRIANGLE", Hit::NO_TRIANGLE),
    ("DIRECTION_MIN", Ray::DIRECTION_MIN.to_bits()),
    ("DIRECTION_MAX", Ray::DIRECTION_MAX.to_bits()),
    ("DIVISOR_SHARE", Ray::DIVISOR_SHARE.to_bits()),
    ("LATERAL_ERROR", LATERAL_ERROR.to_bits()),
    ("DEPTH_SHORTER", (1.0 - 2.0 * gamma(8)).to_bits()),
    ("DEPTH_LONGER", (1.0 + 2.0 * gamma(8)).to_bits()),
];

/// That of triangle.wgsl: a device may divide with an error of 2.5 units in the last place, five roundoffs and not one.
pub const LATERAL_ERROR: f32 = gamma(15);

const _: () = assert!(LATERAL_ERROR >= crate::triangle::LATERAL_ERROR);
