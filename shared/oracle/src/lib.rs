//! The oracle: a slow `f64` ray tracer over the **original** scene, which judges the fast kernels.
//!
//! It follows the same documented model as `tessera_whitted` and shares no code with it, nor with the packer, the quantiser, the
//! kd-tree and their ray/triangle test: only the scene's types, its flattening and the [`Without`](tessera_scene::Without) of
//! what is left out. Where a picture of a pack differs from the oracle's, one of the two is wrong, or the difference is what
//! quantised vertices, `f32` and the kernels' cut-offs cost.
//!
//! What is different here on purpose:
//! - Vertices, normals, texture coordinates and lights are those of the source, in `f64`. Vertex normals count wherever all three
//!   corners have one, also where a pack leaves them out.
//! - Rays are traced through a bounding volume hierarchy, which is judged by trying every triangle
//!   ([`Oracle::by_brute_force`]); the triangle's test projects along the ray instead of shearing.
//! - A new ray leaves the triangle that it starts on by name and everything else by a bound that comes from roundoff alone (2^-47 of
//!   the scene's size at normal incidence), not by an offset of its origin.
//! - The samples of a pixel are a lattice, the same in each pixel ([`View::samples`]).
//! - The weight below which a ray is not traced is the caller's, and what was cut off is summed up ([`OracleImage::cut_weight`]).
//!
//! **Ties.** Distances along a ray are rounded to 40 bits, 2^-40 = 9e-13 of themselves, before they are compared; of surfaces at one
//! distance that with the smallest triangle id comes first, as in the kernels (which round to 24 bits). On an edge that two
//! triangles share both are met: a ray exactly through an edge of glass or of a veil is dimmed twice, here as there.

mod bvh;
mod digest;
mod image;
mod light;
mod oracle;
mod path;
mod reference;
mod shade;
#[cfg(test)]
mod soup;
mod surface;
mod texture;
mod triangle;
mod view;

pub use image::{LayersError, OracleImage, RayCounts};
pub use oracle::{Oracle, OracleError};
pub use reference::{Key, Reference, ReferenceError};
pub use view::{View, ViewError};

/// Names the arithmetic of the oracle: a stored reference of another version is refused. To be raised with every change of a
/// picture: a test has the hash of one beside it.
pub const VERSION: u32 = 1;

/// The id of no triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;
