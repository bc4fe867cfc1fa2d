//! Promises that are kept by the whole: the built binary, the workspace's own rules.

mod cli;
mod cluster;
mod simulation;
mod support;
mod tidy;
