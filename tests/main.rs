//! Promises that are kept by the whole: the built binary, the prepared pack, the workspace's own rules.

use tessera_kdtree::soup as kinds;
use tessera_whitted::stage;

#[cfg(target_os = "linux")]
mod backends;
mod bad_input;
mod bench;
mod check;
mod cli;
mod cluster;
mod corpora;
mod deploy;
mod error_against;
mod error_time;
mod gpu;
#[cfg(target_os = "linux")]
mod joined;
mod kernels;
mod leaks;
mod links;
#[cfg(target_os = "linux")]
mod machines;
mod oracle;
mod pixels;
mod processes;
mod rays;
mod referee;
mod scale;
mod scenes;
mod sequence;
mod service;
mod simulation;
mod stiff;
mod support;
mod tidy;
mod trace;
mod variants;
mod why;
