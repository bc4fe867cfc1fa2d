//! Tests of packs through the public interface.

mod bytes;
mod edges;
mod left_out;
mod round_trip;
mod support;
