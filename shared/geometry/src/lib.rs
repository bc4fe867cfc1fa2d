//! Vectors, boxes, rays, the camera, the watertight ray/triangle test and the curve of sRGB.
//!
//! Everything here works in **local space**: voxel units relative to the centre of the scene's grid, where every
//! decoded vertex is exact in `f32`. Only [`frame::LocalFrame`] knows how local and world space relate.
//! Arithmetic is plain IEEE `f32`/`f64` without fused operations and without the platform's libm, so that one ray
//! gives one result on every CPU.

mod aabb;
pub mod camera;
pub mod frame;
pub mod mutation;
pub mod ray;
pub mod rounding;
mod srgb;
pub mod triangle;
pub mod wgsl;
pub mod wide;

pub use aabb::Aabb;
pub use camera::{CameraPose, LocalCamera};
pub use frame::LocalFrame;
pub use glam::{DVec3, Vec2, Vec3};
pub use ray::{Hit, Ray};
pub use srgb::{linear_from_srgb, srgb_from_linear};
