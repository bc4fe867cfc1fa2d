//! What every generator promises.

use super::*;
use crate::instances::for_each_instance;

fn scene(kind: Kind, triangles: u32, seed: u64) -> Scene {
    generate(&Recipe { kind, triangles, seed }).expect("the recipe is in range")
}

#[test]
fn counts_come_within_two_percent() {
    for kind in Kind::ALL {
        for triangles in [1_000, 1_777, 5_000, 20_000, 90_000, 300_000] {
            let row = Row::of(&scene(kind, triangles, 3));
            let off = (row.triangles as f64 - f64::from(triangles)) / f64::from(triangles);
            eprintln!("{kind} {triangles}: {}", row.text());
            assert!(off.abs() <= 0.02, "{kind}: {} for {triangles}", row.triangles);
        }
    }
}
