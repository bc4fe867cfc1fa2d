//! Links and devices that this machine has not: emulated, measured, and stated; clusters of them, real and simulated.

mod args;
mod case;
pub mod command;
mod devices;
mod link;
pub mod link_bench;
mod medium;
mod page;
mod paper;
mod real;
mod recorded;
pub mod relay;
mod relay_process;
mod report;
mod sim;
mod simulated;
mod studio;
pub mod tiles;
pub mod what_if;
