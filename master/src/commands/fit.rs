//! Rates: straight lines through logarithms.

/// A power law `y = c x^slope`, fitted to points by least squares of their logarithms.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Rate {
    /// The exponent.
    pub slope: f64,
    /// Half the width of its 95 % confidence interval (Student's t with two degrees of freedom less than points): what the scatter of the
    /// points about the line says, and nothing of an error that all of them share.
    pub confidence: f64,
    /// Points that it was fitted to.
    pub points: usize,
}

impl Rate {
    /// Through points with both coordinates above 0, the others left out; `None` of fewer than three, or where they all have one `x`.
    pub fn of(points: &[(f64, f64)]) -> Option<Self> {
        let logs: Vec<_> = points
            .iter()
            .filter(|(x, y)| *x > 0.0 && *y > 0.0 && x.is_finite() && y.is_finite())
            .map(|(x, y)| (libm::log(*x), libm::log(*y)))
            .collect();
        if logs.len() < 3 {
            return None;
        }
        let count = logs.len() as f64;
        let (sum_x, sum_y) = logs.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
        let (mean_x, mean_y) = (sum_x / count, sum_y / count);
        let spread: f64 = logs.iter().map(|(x, _)| (x - mean_x) * (x - mean_x)).sum();
        if spread <= 0.0 {
            return None;
        }
        let slope = logs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / spread;
        let rest: f64 = logs
            .iter()
            .map(|(x, y)| {
                let off = y - mean_y - slope * (x - mean_x);
                off * off
            })
            .sum();
        let standard_error = (rest / (count - 2.0) / spread).sqrt();
        Some(Self { slope, confidence: t_quantile(logs.len() - 2) * standard_error, points: logs.len() })
    }

    /// Whether `theory` lies within the confidence interval.
    pub fn agrees_with(&self, theory: f64) -> bool {
        (self.slope - theory).abs() <= self.confidence
    }
}

impl std::fmt::Display for Rate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} +- {:.3}", self.slope, self.confidence)
    }
}

/// The 97.5 % quantile of Student's t with so many degrees of freedom, > 0; beyond 30 that of 30, which is too wide by 4 % at most.
fn t_quantile(freedom: usize) -> f64 {
    const TABLE: [f64; 30] = [
        12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145,
        2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048,
        2.045, 2.042,
    ];
    TABLE[freedom.clamp(1, TABLE.len()) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_exactly() {
        let points: Vec<_> = [1.0, 2.0, 4.0, 8.0, 16.0].map(|x: f64| (x, 3.0 / (x * x))).into();
        let rate = Rate::of(&points).unwrap();
        assert!((rate.slope + 2.0).abs() < 1e-12 && rate.confidence < 1e-10, "{rate}");
        assert!(rate.agrees_with(-2.0 + 1e-14) || rate.confidence < 1e-14);
    }

    #[test]
    fn scatter_widens_the_interval() {
        // By hand: logs (0, 0), (1, 2), (2, 1) have slope 0.5, rest 1.5, spread 2, so the error is sqrt(1.5 / 1 / 2).
        let e = std::f64::consts::E;
        let rate = Rate::of(&[(1.0, 1.0), (e, e * e), (e * e, e)]).unwrap();
        assert!((rate.slope - 0.5).abs() < 1e-12);
        assert!((rate.confidence - 12.706 * 0.75_f64.sqrt()).abs() < 1e-9);
        assert!(rate.agrees_with(0.0) && !rate.agrees_with(20.0));
    }

    #[test]
    fn too_few_points_have_no_rate() {
        assert_eq!(Rate::of(&[(1.0, 1.0), (2.0, 2.0)]), None);
        assert_eq!(Rate::of(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(Rate::of(&[(1.0, 0.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, 1.0)]), None);
    }
}
