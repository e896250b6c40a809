//! Finds the sample rate, the sample numbers and the missing samples from written times.
//!
//! Written times are rounded (0.000333, 0.000667, 0.001), jitter, drift against a nominal rate and skip lost samples.
//! So the period is first taken from the median interval, then from the whole span divided by the number of periods in
//! it, and each sample's number comes from a grid that follows the times slowly, by a tenth of the deviation per
//! sample.

use super::error::CsvError;

/// Intervals further than this from a whole number of periods count as irregular, in periods.
const TOLERANCE: f64 = 0.2;
/// Share of irregular intervals above which no rate can be found.
const MOST: f64 = 0.5;
/// Periods that may be missing in a row: a larger step of a 32-bit counter looks like a step back.
const LONGEST_GAP: f64 = (1_u32 << 31) as f64;
/// Fraction of the deviation by which the grid follows the times.
const FOLLOW: f64 = 0.1;

/// Rate and sample numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Timebase {
    /// Samples per second.
    pub rate_hz: f64,
    /// Number of each sample, from 0; a jump is a discontinuity.
    pub index: Vec<u64>,
    /// Number of gaps.
    pub discontinuities: u64,
    /// Total number of missing samples.
    pub missing: u64,
    /// Intervals further than 20 % from a whole number of periods.
    pub irregular: u64,
}

/// Finds rate and sample numbers from strictly increasing times, written with `decimals` decimals.
pub fn find(file: &str, t_s: &[f64], decimals: u32) -> Result<Timebase, CsvError> {
    let span = match t_s {
        [first, .., last] if t_s.len() >= 8 => last - first,
        _ => return Err(CsvError::TooFew { file: file.into(), samples: t_s.len() }),
    };
    let intervals: Vec<f64> = t_s.iter().zip(t_s.iter().skip(1)).map(|(before, after)| after - before).collect();
    let median = median(&intervals);
    let irregular_error =
        |share: f64| CsvError::Irregular { file: file.into(), percent: share * 100.0, median_s: median };
    if !(median > 0.0 && span.is_finite()) {
        return Err(irregular_error(1.0));
    }
    let periods = |interval: f64, period: f64| (interval / period).round().max(1.0);
    let irregular = intervals.iter().filter(|d| (**d / median - periods(**d, median)).abs() > TOLERANCE).count();
    let share = irregular as f64 / intervals.len() as f64;
    if share > MOST {
        return Err(irregular_error(share));
    }
    let gap_s = intervals.iter().copied().fold(0.0, f64::max);
    if gap_s / median >= LONGEST_GAP {
        return Err(CsvError::Gap { file: file.into(), gap_s, median_s: median });
    }
    let mut period = span / intervals.iter().map(|d| periods(*d, median)).sum::<f64>();
    let mut index = number(t_s, period);
    if let Some(last) = index.last().filter(|last| **last > 0) {
        period = span / *last as f64;
        index = number(t_s, period);
    }
    let jumps = || index.iter().zip(index.iter().skip(1)).map(|(before, after)| after - before - 1);
    let (discontinuities, missing) = (jumps().filter(|jump| *jump > 0).count() as u64, jumps().sum());
    let resolution = 0.1_f64.powi(i32::try_from(decimals).unwrap_or(18));
    Ok(Timebase {
        rate_hz: snap(1.0 / period, resolution / span),
        index,
        discontinuities,
        missing,
        irregular: irregular as u64,
    })
}

/// Rounds a rate to a whole number if the written times cannot distinguish the two.
fn snap(rate_hz: f64, relative_resolution: f64) -> f64 {
    let whole = rate_hz.round();
    let close = (rate_hz - whole).abs() <= rate_hz * relative_resolution.clamp(1e-12, 1e-3);
    if close { whole } else { rate_hz }
}

fn number(t_s: &[f64], period: f64) -> Vec<u64> {
    let mut grid: Option<(f64, u64)> = None;
    t_s.iter()
        .map(|t| {
            let (time, index) = match grid {
                None => (*t, 0),
                Some((time, index)) => {
                    let steps = ((t - time) / period).round().max(1.0);
                    let expected = time + steps * period;
                    (expected + FOLLOW * (t - expected), index.saturating_add(steps as u64))
                }
            };
            grid = Some((time, index));
            index
        })
        .collect()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return 0.0;
    }
    *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(times: impl Iterator<Item = f64>, decimals: i32) -> Vec<f64> {
        let scale = 10f64.powi(decimals);
        times.map(|t| (t * scale).round() / scale).collect()
    }

    #[test]
    fn a_rate_that_the_decimals_hide_is_found() {
        for (rate, decimals) in
            [(1000.0, 3), (1000.0, 6), (2000.0, 4), (3000.0, 4), (3000.0, 6), (4096.0, 5), (51200.0, 7)]
        {
            let t = rounded((0..20_000).map(|i| 12.5 + f64::from(i) / rate), decimals);
            let found = find("f", &t, decimals as u32).unwrap();
            assert_eq!(found.rate_hz, rate, "{rate} Hz with {decimals} decimals");
            assert_eq!((found.discontinuities, found.missing), (0, 0));
            assert_eq!(found.index.last(), Some(&19_999));
        }
    }

    #[test]
    fn missing_samples_are_discontinuities() {
        let kept = (0..5000).filter(|i| !(1000..1003).contains(i) && *i != 4000);
        let t = rounded(kept.map(|i| f64::from(i) / 1000.0), 3);
        let found = find("f", &t, 3).unwrap();
        assert_eq!((found.rate_hz, found.discontinuities, found.missing), (1000.0, 2, 4));
        assert_eq!(found.index.get(999..1001), Some(&[999, 1003][..]));
    }

    #[test]
    fn jitter_makes_no_discontinuity() {
        // A fifth of a period either way, uniformly distributed.
        let jitter = |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 16) / 65536.0 - 0.5;
        let t: Vec<f64> = (0..5000).map(|i| (f64::from(i) + 0.4 * jitter(i)) / 1000.0).collect();
        let found = find("f", &t, 6).unwrap();
        assert_eq!((found.discontinuities, found.missing), (0, 0));
        assert!((found.rate_hz - 1000.0).abs() < 0.2);
    }

    #[test]
    fn times_without_a_common_spacing_are_refused() {
        let t: Vec<f64> = (0..1000).map(|i| f64::from(i * i) * 1e-4 + f64::from(i) * 1e-3).collect();
        assert!(matches!(find("f", &t, 6), Err(CsvError::Irregular { .. })));
        assert!(matches!(find("f", &[0.0, 1.0], 6), Err(CsvError::TooFew { .. })));
        let huge = [-1e308, -1e307, 0.0, 1e3, 1e4, 1e5, 1e307, 1e308];
        assert!(matches!(find("f", &huge, 6), Err(CsvError::Irregular { .. })));
    }

    /// Their sample numbers would exceed 64 bits, so that two samples would get the same number.
    #[test]
    fn a_gap_beyond_any_sample_counter_is_refused() {
        let with = |gap_s: f64| (0..8).map(f64::from).chain([7.0 + gap_s, 7.0 + 2.0 * gap_s]).collect::<Vec<_>>();
        for gap_s in [1e30, 2_147_483_648.0] {
            let error = find("f", &with(gap_s), 0).unwrap_err();
            assert!(matches!(error, CsvError::Gap { gap_s: told, .. } if told == gap_s), "{error}");
        }
        assert_eq!(find("f", &with(1e9), 0).unwrap().missing, 2 * (1_000_000_000 - 1));
    }

    proptest::proptest! {
        #[test]
        fn no_times_panic(mut t in proptest::collection::vec(proptest::num::f64::NORMAL, 0..40), decimals in 0u32..19) {
            t.sort_by(f64::total_cmp);
            t.dedup();
            let _ = find("f", &t, decimals);
        }
    }
}
