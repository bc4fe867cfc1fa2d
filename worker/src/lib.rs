//! Holds a pack, renders tiles and returns them in batches.
