//! The 12-byte vertex: cell index and offsets, normal code, fixed-point texture coordinates.
