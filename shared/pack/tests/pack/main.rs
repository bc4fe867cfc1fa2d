//! Tests of packs through the public interface.

mod edges;
mod round_trip;
mod support;
