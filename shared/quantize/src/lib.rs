//! The 12-byte vertex: cell index and offsets, normal code, fixed-point texture coordinates.
//!
//! Follows section 3.1 of Seo, Park, Ihm 2022 ("6 + 2 + 4 bytes a vertex"); each module states where it departs from it.
//!
//! - [`mod@clean`]: which triangles of an input can be used at all.
//! - [`grid`]: cubic cells over the box, as fine as 65,536 vertex-occupied cells allow; positions as cell and offset.
//! - [`normal`]: the 16-bit normal table of Smith, Petrova, Schaefer 2012; [`oct`]: the code without a table.
//! - [`uv`]: 1 + 15 bits a component (or fewer), whole-number shifts, vertex splits.
//! - [`vertex`]: the bits of a record.
//! - [`sizes`]: the paper's size formulas.

pub mod clean;
pub mod grid;
pub mod normal;
pub mod oct;
pub mod sizes;
pub mod uv;
pub mod vertex;

pub use clean::{Cleaned, clean};
pub use grid::{Cell, Grid, GridError, Voxel, is_collinear};
pub use normal::{NO_NORMAL, NormalCode, NormalTable};
pub use uv::{UvBits, UvError, UvPlan, WrapRule};
pub use vertex::{Record, WORDS_MAX};
