//! Messages between master and worker, their codec, limits and versions.
