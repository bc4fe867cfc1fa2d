//! Promises that are kept by the whole: the built binary, the prepared pack, the workspace's own rules.

#[path = "../shared/kdtree/tests/common/mod.rs"]
mod kinds;

#[cfg(target_os = "linux")]
mod backends;
#[path = "../shared/whitted/tests/tracer/support.rs"]
#[allow(dead_code, reason = "the tracer's own tests use the rest")]
mod stage;

mod bad_input;
mod bench;
mod cli;
mod cluster;
mod corpora;
mod deploy;
mod gpu;
#[cfg(target_os = "linux")]
mod joined;
mod kernels;
mod leaks;
#[cfg(target_os = "linux")]
mod machines;
mod processes;
mod rays;
mod referee;
mod scenes;
mod service;
mod simulation;
mod support;
mod tidy;
mod variants;
