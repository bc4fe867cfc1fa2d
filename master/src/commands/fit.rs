//! Orders of convergence: the slope of errors in a log-log plot, with its confidence.

/// A fitted power law, `error = scale * size^slope`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Fit {
    pub slope: f64,
    /// Half the width of the interval that holds the slope with 95 %.
    pub confidence: f64,
}

impl Fit {
    /// Least squares through the logarithms of `(size, error)`, all above 0, of which there are at least 3: the standard error of
    /// the slope is that of the residuals, `sqrt(sum r^2 / (n - 2) / sum (x - mean)^2)`, and its quantile Student's with `n - 2`
    /// degrees of freedom (Draper and Smith, *Applied Regression Analysis*, section 1.4). `None` for fewer.
    pub fn of(points: &[(f64, f64)]) -> Option<Self> {
        let quantile = STUDENT_975.get(points.len().checked_sub(3)?).or(STUDENT_975.last()).copied()?;
        let logs: Vec<_> = points.iter().map(|&(x, y)| (libm::log(x), libm::log(y))).collect();
        let n = logs.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n;
        let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
        let spread: f64 = logs.iter().map(|(x, _)| (x - mx) * (x - mx)).sum();
        let slope = logs.iter().map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / spread;
        let left = |&(x, y): &(f64, f64)| y - my - slope * (x - mx);
        let rest: f64 = logs.iter().map(|p| left(p) * left(p)).sum();
        let confidence = quantile * (rest / (n - 2.0) / spread).sqrt();
        (slope.is_finite() && confidence.is_finite()).then_some(Self { slope, confidence })
    }

    /// Whether the interval, widened by the `allowance` for what a theory itself leaves out, holds the order `theory`, and is too narrow
    /// to hold another one: orders lie `apart` from each other.
    pub fn tells(&self, theory: f64, allowance: f64, apart: f64) -> bool {
        let half = self.confidence + allowance;
        (self.slope - theory).abs() <= half && half < apart / 2.0
    }
}

impl std::fmt::Display for Fit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} +- {:.3}", self.slope, self.confidence)
    }
}

/// 97.5 % quantiles of Student's distribution with 1 to 30 degrees of freedom.
#[rustfmt::skip]
const STUDENT_975: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
    2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_exactly_and_noise_widens_the_interval() {
        let law = |noise: f64| {
            let points: Vec<_> = (1..8)
                .map(|i| {
                    (
                        f64::from(i),
                        3.0 * libm::pow(f64::from(i), -1.5) * if i % 2 == 0 { 1.0 + noise } else { 1.0 },
                    )
                })
                .collect();
            Fit::of(&points).expect("enough points")
        };
        let (exact, noisy) = (law(0.0), law(0.1));
        assert!((exact.slope + 1.5).abs() < 1e-12 && exact.confidence < 1e-12, "{exact}");
        assert!(noisy.confidence > 0.01 && noisy.tells(-1.5, 0.0, 0.5), "{noisy}");
        assert!(!noisy.tells(-2.0, 0.0, 0.5) && !noisy.tells(-1.5, 0.25, 0.5), "{noisy}: too wide to tell");
        assert!(Fit::of(&[(1.0, 1.0), (2.0, 1.0)]).is_none());
    }

    #[test]
    fn the_interval_is_that_of_a_worked_example() {
        // x = 0, 1, 2, 3 and y = 0, 1, 1, 2: slope 0.6, residuals -0.1, 0.3, -0.3, 0.1; sqrt(0.2 / 2 / 5) times 4.303.
        let points =
            [(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 2.0)].map(|(x, y)| (libm::exp(x), libm::exp(y)));
        let fit = Fit::of(&points).expect("four points");
        assert!((fit.slope - 0.6).abs() < 1e-12, "{fit}");
        assert!((fit.confidence - 4.303 * (0.02f64).sqrt()).abs() < 1e-3, "{fit}");
    }
}
