//! Links and devices that this machine has not: emulated, measured, and stated.

#[allow(dead_code, reason = "for the command that puts devices behind links")]
pub mod devices;
pub mod link;
pub mod link_bench;
pub mod medium;
pub mod relay;
#[allow(dead_code, reason = "for the command that puts devices behind links")]
pub mod relay_process;
