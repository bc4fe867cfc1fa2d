//! Properties that the tracer relies on, over many inputs.

mod grid;
mod uv;

/// The same cases in every run.
fn config() -> proptest::test_runner::Config {
    proptest::test_runner::Config {
        rng_seed: proptest::test_runner::RngSeed::Fixed(0x7E55_E7A0),
        failure_persistence: None,
        ..Default::default()
    }
}
