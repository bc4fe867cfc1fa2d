//! The kernels' text for GPUs, in the order in which it is read; each file is the sibling of the one in Rust of its name.

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
