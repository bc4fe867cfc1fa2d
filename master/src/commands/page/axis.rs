//! Values, places and ticks of one axis.

use super::plot::Scale;

/// Beyond this the difference of two values may not be finite.
const LINEAR_MAX: f64 = 1e300;

/// A number as people read it: four significant digits, and powers of ten where zeros would have to be counted.
pub fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return value.to_string();
    }
    if !(1e-3..1e6).contains(&value.abs()) {
        let text = format!("{value:.3e}");
        let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{exponent}", without_zeros(mantissa));
    }
    let before_point = libm::floor(libm::log10(value.abs())) as i32 + 1;
    let decimals = usize::try_from(4 - before_point).unwrap_or(0);
    without_zeros(&format!("{value:.decimals$}")).into()
}

fn without_zeros(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Whether an axis has a place for `value`.
pub fn has_place(scale: Scale, value: f64) -> bool {
    match scale {
        Scale::Linear => value.abs() <= LINEAR_MAX,
        Scale::Log => value > 0.0 && value.is_finite(),
    }
}

/// What an axis shows.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    scale: Scale,
    /// Ends; logarithms to base 10 on a logarithmic axis.
    low: f64,
    high: f64,
}

/// A line across the plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// From 0 at the low end to 1 at the high one.
    pub part: f64,
    /// None between labelled ones.
    pub label: Option<String>,
}

impl Span {
    /// Shows all `values` that have a place, with some room around them.
    pub fn around(scale: Scale, values: impl IntoIterator<Item = f64>) -> Self {
        let values = values.into_iter().filter(|&value| has_place(scale, value));
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        if low > high {
            // Nothing to show: one unit, or one decade.
            return Self { scale, low: 0.0, high: 1.0 };
        }
        match scale {
            Scale::Log => {
                let (low, high) = (libm::log10(low), libm::log10(high));
                // Equal values stand in the middle of 2/3 of a decade.
                let room = if high - low < 1e-6 { 1.0 / 3.0 } else { (high - low) * 0.05 };
                // There is nothing to label beyond what an f64 can be.
                Self { scale, low: (low - room).max(-324.0), high: (high + room).min(309.0) }
            }
            Scale::Linear => {
                let size = low.abs().max(high.abs());
                let room = match (high - low, size) {
                    (_, 0.0) => 1.0,
                    // Neighbouring labels would need more digits than anyone reads.
                    (length, size) if length < size * 1e-9 => size * 0.05,
                    (length, _) => length * 0.05,
                };
                // Where numbers end there is no 1/20 of them.
                let room = room.max(1e-300);
                // Zero belongs to the picture if it is near.
                let from_zero = low >= 0.0 && low < high * 0.3 && high > low;
                let to_zero = high <= 0.0 && high > low * 0.3 && high > low;
                Self {
                    scale,
                    low: if from_zero { 0.0 } else { low - room },
                    high: if to_zero { 0.0 } else { high + room },
                }
            }
        }
    }

    /// Where a value that has a place is: from 0 at the low end to 1 at the high one, not beyond.
    pub fn part(&self, value: f64) -> f64 {
        let value = if self.scale == Scale::Log { libm::log10(value) } else { value };
        ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
    }

    /// About `wanted` labelled ticks, and finer ones between them.
    pub fn ticks(&self, wanted: usize) -> Vec<Tick> {
        let wanted = wanted.max(2) as f64;
        match self.scale {
            Scale::Linear => linear_ticks(self.low, self.high, wanted, |value| self.part(value)),
            Scale::Log => self.log_ticks(wanted),
        }
    }

    /// Decades; where few are seen 1, 2 and 5 of each; where that gives few too, as on a linear axis.
    fn log_ticks(&self, wanted: f64) -> Vec<Tick> {
        let decades = self.high - self.low;
        let step = libm::ceil(decades / wanted).max(1.0) as i64;
        let is_labelled = |decade: i64, digit: i64| {
            if decades < 3.0 { matches!(digit, 1 | 2 | 5) } else { digit == 1 && decade % step == 0 }
        };
        let digits = if decades <= 8.0 { 9 } else { 1 };
        // More lines than this are a grey area.
        let is_drawn = |decade: i64| decades <= 40.0 || decade % step == 0;
        let mut ticks = Vec::new();
        let decades_seen = libm::floor(self.low) as i64..=libm::floor(self.high) as i64;
        for decade in decades_seen.filter(|&decade| is_drawn(decade)) {
            for digit in 1..=digits {
                let place = decade as f64 + libm::log10(digit as f64);
                let part = (place - self.low) / decades;
                if (0.0..=1.0).contains(&part) {
                    let label = is_labelled(decade, digit).then(|| power(digit, decade));
                    ticks.push(Tick { part, label });
                }
            }
        }
        if ticks.iter().filter(|tick| tick.label.is_some()).count() < 3 {
            let (low, high) = (libm::pow(10.0, self.low), libm::pow(10.0, self.high));
            return linear_ticks(low, high, wanted, |value| self.part(value));
        }
        ticks
    }
}

/// `digit` times 10 to the power `decade`.
fn power(digit: i64, decade: i64) -> String {
    match decade {
        -3..=5 => number(digit as f64 * libm::pow(10.0, decade as f64)),
        _ => format!("{digit}e{decade}"),
    }
}

/// Multiples of a round step between `low` and `high`.
fn linear_ticks(low: f64, high: f64, wanted: f64, part: impl Fn(f64) -> f64) -> Vec<Tick> {
    let least = (high - low) / wanted;
    let decade = libm::pow(10.0, libm::floor(libm::log10(least)));
    let (factor, fine) = [(1.0, 5.0), (2.0, 4.0), (5.0, 5.0)]
        .into_iter()
        .find(|f| f.0 * decade >= least)
        .unwrap_or((10.0, 5.0));
    let step = factor * decade;
    if !(step.is_normal() && low.is_finite() && high.is_finite()) {
        return Vec::new();
    }
    // The labels' last digit stands for the step.
    let digit = libm::floor(libm::log10(step) + 1e-9) as i32;
    let size = low.abs().max(high.abs());
    let label = |value: f64| {
        if value == 0.0 {
            "0".to_owned()
        } else if size < 1e6 && digit >= -4 {
            format!("{value:.*}", usize::try_from(-digit).unwrap_or(0))
        } else {
            let digits = libm::floor(libm::log10(value.abs()) + 1e-9) as i32 - digit;
            let text = format!("{value:.*e}", usize::try_from(digits).unwrap_or(0).min(15));
            text.split_once('e')
                .map_or(text.clone(), |(mantissa, e)| format!("{}e{e}", without_zeros(mantissa)))
        }
    };
    let step = step / fine;
    let (first, last) = (libm::ceil(low / step), libm::floor(high / step));
    // Ends are at least 1e-9 of their size apart, and ticks at least 1/50 of that: their numbers are whole and exact.
    (0..=(last - first) as i64)
        .map(|k| {
            let n = first + k as f64;
            let value = n * step;
            Tick { part: part(value), label: (n % fine == 0.0).then(|| label(value)) }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: Scale, values: &[f64]) -> Vec<String> {
        let ticks = Span::around(scale, values.iter().copied()).ticks(8);
        assert!(ticks.iter().all(|tick| (0.0..=1.0).contains(&tick.part)), "{ticks:?}");
        assert!(ticks.is_sorted_by(|a, b| a.part < b.part), "{ticks:?}");
        assert!(ticks.len() <= 100, "{ticks:?}");
        ticks.into_iter().filter_map(|tick| tick.label).collect()
    }

    #[test]
    fn numbers_are_for_people() {
        let cases = [
            (0.0, "0"),
            (-0.0, "0"),
            (1.0, "1"),
            (0.1 + 0.2, "0.3"),
            (42.8049, "42.8"),
            (-33.391, "-33.39"),
            (9999.96, "10000"),
            (131_072.0, "131072"),
            (1e6, "1e6"),
            (1_234_567.0, "1.235e6"),
            (0.001, "0.001"),
            (0.000_999_99, "1e-3"),
            (1.25e-7, "1.25e-7"),
            (5e-324, "4.941e-324"),
            (f64::MAX, "1.798e308"),
            (f64::INFINITY, "inf"),
            (f64::NAN, "NaN"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn linear_ticks_are_round() {
        assert_eq!(labels(Scale::Linear, &[0.0, 1.0]), ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(Scale::Linear, &[33.4, 42.8]), ["34", "36", "38", "40", "42"]);
        assert_eq!(labels(Scale::Linear, &[-3.0, 4.0]), ["-3", "-2", "-1", "0", "1", "2", "3", "4"]);
        assert_eq!(labels(Scale::Linear, &[1e9, 1e9 + 8.0]).first().map(String::as_str), Some("1e9"));
        assert_eq!(labels(Scale::Linear, &[0.0, 4e-9]), ["0", "1e-9", "2e-9", "3e-9", "4e-9"]);
    }

    #[test]
    fn logarithmic_ticks_are_decades_or_finer() {
        assert_eq!(labels(Scale::Log, &[1e-4, 10.0]), ["1e-4", "0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(labels(Scale::Log, &[1.0, 100.0]), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(labels(Scale::Log, &[3.0, 4.5]), ["3.0", "3.5", "4.0", "4.5"]);
        let wide = labels(Scale::Log, &[5e-324, f64::MAX]);
        assert!((5..=10).contains(&wide.len()), "{wide:?}");
    }

    #[test]
    fn values_without_a_place_do_not_move_the_axis() {
        for scale in [Scale::Linear, Scale::Log] {
            let plain = Span::around(scale, [2.0, 8.0]);
            let more = Span::around(scale, [f64::NAN, 2.0, f64::INFINITY, 8.0, f64::NEG_INFINITY]);
            assert_eq!((plain.low, plain.high), (more.low, more.high));
            assert_eq!(Span::around(scale, []).ticks(5).first().map(|tick| tick.part), Some(0.0));
        }
        let (with, without) =
            (Span::around(Scale::Log, [0.0, -1.0, 2.0, 8.0]), Span::around(Scale::Log, [2.0, 8.0]));
        assert_eq!((with.low, with.high), (without.low, without.high));
    }

    #[test]
    fn equal_values_stand_in_the_middle() {
        for (scale, values) in
            [(Scale::Linear, &[0.0, 1.0, -7e12, 1e-300][..]), (Scale::Log, &[1.0, 7e12, 1e-300])]
        {
            for &value in values {
                let span = Span::around(scale, [value, value]);
                // Half, but for the roundings of the ends, of the differences and of the quotient, each of 2^-53 of at most 310.
                assert!((span.part(value) - 0.5).abs() < 1e-12, "{scale:?} {value}");
                assert!(
                    span.ticks(8).iter().filter(|tick| tick.label.is_some()).count() >= 2,
                    "{scale:?} {value}"
                );
            }
        }
    }
}
