//! Links and devices that this machine has not: emulated, measured, and stated.

pub mod devices;
pub mod link;
pub mod link_bench;
pub mod medium;
pub mod relay;
pub mod relay_process;
