//! Which worker renders which tile: pure, without clock or socket.
//!
//! [`plan`] says how a frame is handed out, from what frames before have shown ([`Knowledge`]); [`Dispatch`] carries it out.

mod auto;
mod checks;
mod class;
mod deal;
mod frame;
mod hilbert;
mod knowledge;
mod lists;
mod pace;
mod policy;

pub use auto::tile_side;
pub use checks::{Check, Checks, choose};
pub use class::fastest;
pub use deal::{Deal, row_major_owner};
pub use frame::{Assignment, Dispatch, Violation};
pub use knowledge::{Knowledge, Look, Seen, Shown};
pub use policy::{View, plan};

pub use tessera_wire::Balance;
