//! Which settings are worth their time.

/// A setting as the front sees it: less is better of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tradeoff {
    /// Seconds.
    pub time: f64,
    /// Any error, >= 0.
    pub error: f64,
}

impl Tradeoff {
    /// Whether this one is at least as good in both and better in one.
    fn beats(&self, other: &Self) -> bool {
        self.time <= other.time
            && self.error <= other.error
            && (self.time < other.time || self.error < other.error)
    }
}

/// For each of `all`, whether nothing beats it: the Pareto front.
pub fn front(all: &[Tradeoff]) -> Vec<bool> {
    all.iter().map(|one| !all.iter().any(|other| other.beats(one))).collect()
}

/// The fastest of `all` with an error of at most `most`, the better one of equally fast ones.
pub fn fastest_within(all: &[Tradeoff], most: f64) -> Option<usize> {
    let good = (0..all.len()).filter(|&i| all[i].error <= most);
    good.min_by(|&i, &j| all[i].time.total_cmp(&all[j].time).then(all[i].error.total_cmp(&all[j].error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(pairs: &[(f64, f64)]) -> Vec<Tradeoff> {
        pairs.iter().map(|&(time, error)| Tradeoff { time, error }).collect()
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let all = all(&[(1.0, 9.0), (2.0, 4.0), (3.0, 4.0), (4.0, 5.0), (5.0, 1.0), (5.0, 1.0)]);
        assert_eq!(front(&all), [true, true, false, false, true, true]);
        assert!(front(&[]).is_empty());
    }

    #[test]
    fn the_fastest_within_an_error() {
        let all = all(&[(3.0, 1.0), (2.0, 4.0), (2.0, 3.0), (1.0, 9.0)]);
        assert_eq!(fastest_within(&all, 10.0), Some(3));
        assert_eq!(fastest_within(&all, 4.0), Some(2));
        assert_eq!(fastest_within(&all, 1.0), Some(0));
        assert_eq!(fastest_within(&all, 0.5), None);
    }
}
