//! Which worker renders which tile: pure, without clock or socket.

mod checks;
mod class;
mod deal;
mod frame;
mod pace;

pub use checks::{Check, Checks, choose};
pub use class::fastest;
pub use deal::{Deal, row_major_owner};
pub use frame::{Assignment, Dispatch, Violation};

pub use tessera_wire::Balance;
