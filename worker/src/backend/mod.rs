//! What renders.

pub(crate) mod cpu;
