//! Scale of the position: counts per revolution from turning by hand, metres per count from a measured displacement.

use inerter_core::Settings;
use inerter_data::names::unit;

use super::{
    CalibrateError, Finding, Step,
    finding::Level,
    line::{Line, Point, greatest, sizes},
    statistics::{rounded, rounded_up},
};

/// How accurately a hand stops at a mark \[revolutions\]: 10 degrees.
const MARK: f64 = 10.0 / 360.0;
/// Common numbers of lines per revolution; each line is four counts.
const USUAL_LINES: [f64; 26] = [
    100.0, 125.0, 200.0, 250.0, 256.0, 360.0, 400.0, 500.0, 512.0, 600.0, 720.0, 800.0, 900.0, 1000.0, 1024.0, 1250.0,
    1500.0, 1800.0, 2000.0, 2048.0, 2500.0, 3600.0, 4096.0, 5000.0, 8192.0, 10000.0,
];
/// Advice if there are hardly any counts.
const HALF: &str = "connect both A and B, and check the encoder's supply: with only one of A and B the count merely moves \
                    back and forth";
/// Minimum counts for a scale: one count is then 0.1 %.
const LEAST_COUNTS: f64 = 1000.0;
/// Deviation from the line, relative to the largest displacement, above which it is not a line.
const CROOKED: f64 = 0.02;

/// Whole counts per revolution, from `counts` over `revolutions` by hand; `lines` is the number on the encoder's label.
pub fn counts_per_revolution(counts: f64, revolutions: f64, lines: Option<f64>) -> Result<f64, CalibrateError> {
    let per_revolution = counts.abs() / revolutions.abs();
    let tolerance = (MARK / revolutions.abs() * per_revolution).max(1.0);
    let fits = |candidate: &f64| (candidate - per_revolution).abs() <= tolerance;
    if let Some(lines) = lines {
        let expected = 4.0 * lines;
        // With a label the tolerance is known even if counts are missing.
        let near = MARK / revolutions.abs() * expected;
        if (expected - per_revolution).abs() <= near.max(1.0) {
            return Ok(expected);
        }
        let help = mismatch(per_revolution / expected);
        return Err(CalibrateError::Counts { counts, revolutions, per_revolution, expected, help });
    }
    if per_revolution < 16.0 {
        return Err(CalibrateError::Unchanged {
            what: "encoder's count",
            of: "revolutions",
            change: counts.abs(),
            needed: 16.0 * revolutions.abs(),
            help: HALF,
        });
    }
    let usual: Vec<f64> = USUAL_LINES.iter().map(|lines| 4.0 * lines).filter(fits).collect();
    match usual.as_slice() {
        [one] => Ok(*one),
        [] if tolerance < 2.0 => Ok((per_revolution / 4.0).round() * 4.0),
        _ => Err(CalibrateError::Ambiguous { per_revolution, tolerance }),
    }
}

fn mismatch(ratio: f64) -> &'static str {
    let near = |value: f64| (ratio / value - 1.0).abs() < 0.1;
    match ratio {
        _ if ratio < 0.05 => HALF,
        _ if near(0.25) => "give --lines the number on the label, not four times that: each line is four counts",
        _ if near(4.0) => {
            "give --lines the number on the label, not the pulses after a divider: each line is four \
        counts"
        }
        _ if near(0.5) || near(2.0) => {
            "is there a factor of two in the gear or the belt, or were the revolutions \
        counted twice?"
        }
        _ if ratio < 1.0 => {
            "was every revolution completed, and in one direction? Slow or noisy lines lose \
        counts: check A and B with a scope"
        }
        _ => "were there more revolutions? Noise on A and B also adds counts: check them with a scope",
    }
}

/// The scale from displacements, each with the encoder's count there; `gauge_u95_m` is the gauge's uncertainty.
///
/// With `per_revolution` this also gives the lead, and compares it with `lead_m` if that is known.
pub fn displacement(
    points: &[Point],
    gauge_u95_m: f64,
    per_revolution: Option<f64>,
    lead_m: Option<f64>,
    settings: &Settings,
) -> Result<Finding, CalibrateError> {
    let line = Line::through(points).ok_or_else(|| CalibrateError::TooFewPoints {
        what: "displacements",
        count: points.len(),
        different: sizes(points).len(),
        example: "--displacement 0 --displacement 0.010 --displacement 0",
    })?;
    if line.change < LEAST_COUNTS {
        return Err(CalibrateError::Unchanged {
            what: "encoder's count",
            of: "displacements",
            change: line.change,
            needed: LEAST_COUNTS,
            help: "use larger displacements, several turns of the screw; if nothing changes, check A, B and the \
            encoder's supply",
        });
    }
    if line.nonlinearity > CROOKED {
        let worst = format!("displacement {} of {}", line.worst + 1, points.len());
        return Err(CalibrateError::Crooked { what: "displacements", percent: 100.0 * line.nonlinearity, worst });
    }
    let extent = greatest(points);
    // The uncertainty of a count and of the gauge, at either end.
    let count = 2.0 / (line.slope.abs() * extent);
    let u95 = line.u95((gauge_u95_m / extent * std::f64::consts::SQRT_2).hypot(count));
    let metres_per_count = 1.0 / line.slope;
    let mut finding = Finding::new(Step::Encoder);
    scale(&mut finding, rounded(metres_per_count, 7), u95, settings);
    finding.measure_all([
        ("scatter_u95", line.scatter_u95),
        ("nonlinearity", line.nonlinearity),
        ("hysteresis_m", line.hysteresis.map_or(f64::NAN, |part| 2.0 * part * extent)),
        ("zero_return_m", line.zero_return.map_or(f64::NAN, |part| part * extent)),
        ("gauge_u95_m", gauge_u95_m),
    ]);
    if let Some(counts) = per_revolution {
        let found = metres_per_count.abs() * counts;
        finding.measure("lead_m", found);
        finding.say(format!(
            "lead {:.4} mm ± {:.4} mm with {counts:.0} counts per revolution",
            1e3 * found,
            1e3 * found * u95
        ));
        if let Some(lead_m) = lead_m.filter(|lead_m| (found / lead_m - 1.0).abs() > u95 + 1e-3) {
            finding.remark(
                Level::Bad,
                "lead",
                format!(
                    "the stated lead is {:.4} mm: check the gauge's scale, the revolutions, and whether the thread \
                     has several starts",
                    1e3 * lead_m
                ),
            );
        }
    }
    if line.hysteresis.is_some_and(|part| part > 1e-3) {
        finding.remark(
            Level::Doubtful,
            "play",
            "approaching from the other side changes the result by over 0.2 %: the gauge or the screw has play; \
             approach each displacement from one side",
        );
    }
    Ok(finding)
}

/// The scale from the lead and the counts per revolution, with the direction of `forward_counts`.
pub fn by_lead(lead_m: f64, lead_u95: f64, per_revolution: f64, forward_counts: f64, settings: &Settings) -> Finding {
    let mut finding = Finding::new(Step::Encoder);
    let metres_per_count = lead_m / per_revolution * if forward_counts < 0.0 { -1.0 } else { 1.0 };
    finding.measure("lead_m", lead_m);
    scale(&mut finding, metres_per_count, lead_u95, settings);
    finding
}

fn scale(finding: &mut Finding, metres_per_count: f64, u95: f64, settings: &Settings) {
    finding.set_with("metres_per_count", metres_per_count, u95 * metres_per_count.abs());
    finding.set("lead_u95", rounded_up(u95).min(1.0));
    finding.measure("change_of_scale", metres_per_count / settings.metres_per_count - 1.0);
    finding.say(format!("{metres_per_count:.6e} {} per count ± {:.3} %", unit(settings.machine, "m"), 100.0 * u95));
    if metres_per_count * settings.metres_per_count < 0.0 {
        finding.remark(
            Level::Note,
            "sign",
            "the direction is opposite to that of the settings in use: A and B are swapped, or the other \
             direction is positive now; the sign of the scale corrects it",
        );
    }
    if u95 > 5e-3 {
        finding.remark(
            Level::Doubtful,
            "wide",
            "the uncertainty is over 0.5 %: a larger displacement or a better gauge reduces it",
        );
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Mean, *};

    #[test]
    fn turns_by_hand_give_whole_counts_of_an_encoder_that_is_sold() {
        assert_eq!(counts_per_revolution(-40_900.0, 10.0, None), Ok(4096.0));
        assert_eq!(counts_per_revolution(40_900.0, 10.0, Some(1024.0)), Ok(4096.0));
        assert_eq!(counts_per_revolution(40_000.0, 10.0, None), Ok(4000.0));
        // Not a common number, but turned often enough.
        assert_eq!(counts_per_revolution(120_003.0, 100.0, None), Ok(1200.0));
        let refused = |counts, revolutions, lines| counts_per_revolution(counts, revolutions, lines).unwrap_err();
        assert!(matches!(refused(4040.0, 1.0, None), CalibrateError::Ambiguous { .. }));
        assert!(matches!(refused(3.0, 10.0, None), CalibrateError::Unchanged { .. }));
        assert!(matches!(refused(0.0, 10.0, Some(1024.0)), CalibrateError::Counts { .. }));
        for (counts, word) in
            [(3.0, "connect both"), (10_240.0, "four times"), (20_500.0, "factor of two"), (33_000.0, "lose counts")]
        {
            let help = miette::Diagnostic::help(&refused(counts, 10.0, Some(1024.0))).map(|help| help.to_string());
            assert!(help.as_ref().is_some_and(|help| help.contains(word)), "{help:?}");
        }
    }

    #[test]
    fn a_lead_that_is_off_is_found_within_its_interval_over_many_seeds() {
        let settings = Settings::default();
        let mut within = 0;
        for seed in 0..40u32 {
            // A gauge with errors of up to 5 um at each reading, and of up to 2 % in its scale.
            let random = |place: u32| (f64::from(seed * 17 + place * 7) * 0.754_877_666).fract() * 2.0 - 1.0;
            let truth = 2.44140625e-6 * (1.0 + 0.02 * random(99)) * if seed % 2 == 0 { 1.0 } else { -1.0 };
            let points: Vec<Point> = [0.0, 0.02, 0.04, 0.02, 0.0]
                .iter()
                .enumerate()
                .map(|(place, &metres)| {
                    let count = ((metres + 5e-6 * random(place as u32)) / truth).floor();
                    Point { applied: metres, reading: Mean { value: count, u95: 0.0 } }
                })
                .collect();
            let finding = displacement(&points, 5e-6, Some(4096.0), None, &settings).unwrap();
            let found = finding.values["metres_per_count"].as_f64().unwrap();
            let u95 = finding.values["lead_u95"].as_f64().unwrap();
            assert!(u95 < 2e-3, "{u95}");
            within += u32::from((found / truth - 1.0).abs() <= u95);
            assert_eq!(finding.remarks.iter().any(|remark| remark.code == "sign"), seed % 2 == 1);
        }
        assert!(within >= 38, "{within}");
    }

    #[test]
    fn a_lead_that_was_said_otherwise_is_bad_and_no_change_is_refused() {
        let points = |per_metre: f64| -> Vec<Point> {
            [0.0, 0.01, 0.0]
                .iter()
                .map(|&m| Point { applied: m, reading: Mean { value: m * per_metre, u95: 0.0 } })
                .collect()
        };
        let settings = Settings::default();
        let finding = displacement(&points(409_600.0), 1e-5, Some(4096.0), Some(0.005), &settings).unwrap();
        assert!(!finding.is_good());
        let finding = displacement(&points(409_600.0), 1e-5, Some(4096.0), Some(0.01), &settings).unwrap();
        assert!(finding.is_good() && (finding.measured["lead_m"].as_f64().unwrap() - 0.01).abs() < 1e-6);
        assert!(matches!(
            displacement(&points(100.0), 1e-5, None, None, &settings),
            Err(CalibrateError::Unchanged { .. })
        ));
        let finding = by_lead(0.01, 1e-3, 4096.0, -5.0, &settings);
        assert_eq!(finding.values["metres_per_count"].as_f64(), Some(-0.01 / 4096.0));
    }
}
