//! Which numeric class renders a frame.

use std::{cmp::Reverse, collections::BTreeMap};

/// Of `workers`, each a class and the rays a second that it states, the class with the greatest sum; of equal ones the first by name, so
/// that the choice depends on nothing else.
pub fn fastest<'a>(workers: impl IntoIterator<Item = (&'a str, u64)>) -> Option<&'a str> {
    let mut speeds = BTreeMap::<&str, u128>::new();
    for (class, speed) in workers {
        // A peer's number; of fewer than 2^64 workers.
        *speeds.entry(class).or_default() += u128::from(speed);
    }
    speeds.into_iter().max_by_key(|&(class, speed)| (speed, Reverse(class))).map(|(class, _)| class)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_greatest_sum_wins_and_names_break_ties() {
        assert_eq!(fastest([]), None);
        assert_eq!(fastest([("cpu-2", 0)]), Some("cpu-2"));
        assert_eq!(fastest([("cpu-2", 3), ("gpu-1", 5), ("cpu-2", 3)]), Some("cpu-2"), "6 against 5");
        assert_eq!(fastest([("gpu-1", 7), ("cpu-2", 3), ("cpu-2", 3)]), Some("gpu-1"));
        assert_eq!(fastest([("b", 2), ("a", 1), ("a", 1)]), Some("a"), "equal sums");
        assert_eq!(fastest([("b", 0), ("c", 0), ("a", 0)]), Some("a"), "nobody was measured");
        assert_eq!(fastest([("a", u64::MAX), ("b", u64::MAX), ("b", 1)]), Some("b"));
    }
}
