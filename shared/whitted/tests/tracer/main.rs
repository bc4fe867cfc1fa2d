//! The tracer against optics, photometry and its own promises: small packs, exact numbers.

mod adaptive;
mod energy;
mod frames;
mod hard;
mod left_out;
mod lights;
mod probes;
mod refraction;
mod sides;
mod variants;

use tessera_whitted::stage as support;
