//! Tests of packs through the public interface.

mod bytes;
mod edges;
mod round_trip;
mod support;
