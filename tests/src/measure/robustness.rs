//! `cargo xtask robustness`: one imperfection of rig or device at a time, the estimates, and the faults that the device
//! reports, as a committed table.
//!
//! Without arguments it compares the measured table with `docs/tables/robustness.md`, lists the differences and fails
//! if there are any. `--update` writes the table instead.

use inerter_core::{Published, Regime, Settings};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    coverage,
    grid::{
        self, Column, Estimator, Motion, NAMES, Result, calibrated, each, error, errors, motion, raw, seeded,
        sensors as rig, shaken, three, truth,
    },
    sheet::{Asked, Measured, TOLERANCE, line, list, mean, percent, significant},
};
use std::array::from_fn;

/// Runs per row.
const SEEDS: u64 = 8;
/// Rate of the published estimates \[Hz\].
const PUBLISHED_HZ: f64 = 10.0;
/// Fraction of the peak force at which the converter saturates.
const CLIPPED: f64 = 0.8;
/// Ratio of the residual to that of the undisturbed row from which a person would take a closer look.
const LOUD: f64 = 2.0;

pub fn measure(_: Asked) -> Measured {
    let mut rows: Vec<Row> = Vec::new();
    for case in cases() {
        eprintln!("{}", case.name);
        for name in case.motions {
            let usual_n = rows.iter().find(|row| row.motion == *name).map(|row| row.residual_n);
            rows.push(case.row(motion(name), usual_n)?);
        }
    }
    Ok((markdown(&rows), true))
}

/// One imperfection.
struct Case {
    name: &'static str,
    /// Motions to run it with.
    motions: &'static [&'static str],
    device: Inerter,
    sensors: Sensors,
    /// Whether the converter saturates below the force's peak.
    clipped: bool,
    /// Relative uncertainty of the force's gain that the settings state.
    force_gain_u95: f64,
}

const FASTER: &[&str] = &["random", "mid"];
const WITH_SLOW: &[&str] = &["random", "mid", "slow"];
const WITH_FAST: &[&str] = &["random", "mid", "slow", "fast"];

fn case(name: &'static str, motions: &'static [&'static str]) -> Case {
    Case { name, motions, device: Inerter::paper(), sensors: rig(), clipped: false, force_gain_u95: 0.0 }
}

/// The rows of the sheet. The first one is undisturbed.
fn cases() -> Vec<Case> {
    let sensors = |name, motions, sensors| Case { sensors, ..case(name, motions) };
    let device = |name, motions, device| Case { device, ..case(name, motions) };
    let paper = Inerter::paper();
    let presliding = |um: f64| Inerter { presliding_m: um * 1e-6, ..paper };
    let stribeck = |mm_per_s: f64| Inerter { stribeck_velocity_m_per_s: mm_per_s * 1e-3, ..Inerter::stribeck() };
    let gain = Sensors { force_gain: 1.01, ..rig() };
    let uneven = Inerter { coulomb_asymmetry: 0.4, viscous_asymmetry: 0.4, ..paper };
    vec![
        case("none", WITH_FAST),
        sensors("force noise 0.1 N", FASTER, Sensors { force_noise_n: 0.1, ..rig() }),
        sensors("force noise 5 N", WITH_SLOW, Sensors { force_noise_n: 5.0, ..rig() }),
        sensors("force noise 20 N", FASTER, Sensors { force_noise_n: 20.0, ..rig() }),
        sensors("encoder 0.05 um", FASTER, Sensors { metres_per_count: 0.05e-6, ..rig() }),
        sensors("encoder 0.5 um", FASTER, Sensors { metres_per_count: 0.5e-6, ..rig() }),
        sensors("encoder 20 um", WITH_SLOW, Sensors { metres_per_count: 20e-6, ..rig() }),
        sensors("eccentricity 10 um", FASTER, Sensors { encoder_eccentricity_m: 10e-6, ..rig() }),
        sensors("drift 0.05 N/s", WITH_SLOW, Sensors { force_drift_n_per_s: 0.05, ..rig() }),
        sensors("gain 1 %, not stated", FASTER, gain),
        Case { force_gain_u95: 0.012, ..sensors("gain 1 %, stated as 1.2 %", FASTER, gain) },
        sensors("1 % of samples lost", FASTER, Sensors { lost_probability: 0.01, ..rig() }),
        Case { clipped: true, ..case("force clipped at 80 %", FASTER) },
        sensors("pickup 5 N, 50 Hz", WITH_SLOW, Sensors { pickup_n: 5.0, ..rig() }),
        sensors("knock 200 N, 4 ms", WITH_SLOW, Sensors { knock_n: 200.0, ..rig() }),
        device("friction +-40 % by direction", WITH_SLOW, uneven),
        device("weight of 200 N", FASTER, Inerter { constant_force_n: -200.0, ..paper }),
        device("backlash 0.1 mm", FASTER, Inerter::worn()),
        device("the same, flanks only push", FASTER, Inerter { unilateral: 1.0, ..Inerter::worn() }),
        device("presliding 20 um", WITH_FAST, presliding(20.0)),
        device("presliding 50 um", WITH_FAST, presliding(50.0)),
        device("presliding 200 um", WITH_FAST, presliding(200.0)),
        device("Stribeck 1.3, 2 mm/s", WITH_FAST, stribeck(2.0)),
        device("Stribeck 1.3, 5 mm/s", WITH_FAST, stribeck(5.0)),
        device("Stribeck 1.3, 10 mm/s", WITH_FAST, stribeck(10.0)),
    ]
}

/// What the device itself can report.
const FLAGS: [&str; 5] = ["discontinuities", "saturated", "presliding", "Stribeck", "friction unknown"];

/// One run.
struct Run {
    /// Errors and half widths of inertance, viscous and Coulomb friction at the end, if given.
    last: [Option<(f64, f64)>; 3],
    /// The same of all published values with status ok.
    published: [Vec<(f64, f64)>; 3],
    /// Which of the flags the device raises.
    flags: [bool; FLAGS.len()],
    /// Residual at the end \[N\].
    residual_n: f64,
}

impl Case {
    /// The instruments of one run.
    fn sensors(&self, motion: &Motion, seed: u64) -> Result<Sensors> {
        let sensors = seeded(self.sensors, seed);
        if !self.clipped {
            return Ok(sensors);
        }
        let whole = shaken(&self.device, motion.name, sensors)?.lasting(motion.duration_s);
        let peak = whole.map(|sample| sample.force_code.unsigned_abs()).max().unwrap_or(0);
        let limit = (CLIPPED * f64::from(peak)).round();
        Ok(Sensors { force_min_code: -limit, force_max_code: limit, ..sensors })
    }

    /// Simulates the device and records its estimates, with settings that ignore the imperfection.
    fn run(&self, motion: &Motion, seed: u64) -> Result<Run> {
        let sensors = self.sensors(motion, seed)?;
        let mut estimator = Estimator::new(&Settings {
            force_gain_u95: self.force_gain_u95,
            lead_u95: 0.0,
            timebase_u95: 0.0,
            publish_rate_hz: PUBLISHED_HZ,
            ..calibrated(&self.device, &sensors)
        })?;
        let truth = truth(&self.device);
        let mut published: [Vec<_>; 3] = Default::default();
        for sample in shaken(&self.device, motion.name, sensors)?.lasting(motion.duration_s) {
            let Some(estimate) = estimator.step(&raw(&sample)).estimate() else { continue };
            for parameters in [&estimate.recent, &estimate.whole_run] {
                for (i, found) in three(parameters).into_iter().enumerate() {
                    published[i].extend(found.ok().map(|found| error(found, truth[i])));
                }
            }
        }
        let Published { estimate: last, detail, .. } = estimator.publish();
        let (counters, regime) = (estimator.state.counters(), detail.friction.regime);
        Ok(Run {
            last: errors(&last.whole_run, &self.device),
            published,
            flags: [
                counters.discontinuities > 0,
                counters.saturated > 0,
                regime == Regime::Presliding,
                regime == Regime::Stribeck,
                regime == Regime::Unknown,
            ],
            residual_n: f64::from(last.residual_rms_n),
        })
    }

    /// Statistics over the seeds; `usual_n` is the residual of the undisturbed rig with this motion \[N\].
    fn row(&self, motion: &'static Motion, usual_n: Option<f64>) -> Result<Row> {
        let runs = each(1..=SEEDS, |seed| self.run(motion, seed))?;
        let residual_n = grid::mean(runs.iter().map(|run| run.residual_n));
        let is_raised = |i: &usize| 2 * runs.iter().filter(|run| run.flags[*i]).count() >= runs.len();
        let mut flags: Vec<_> = (0..FLAGS.len()).filter(is_raised).map(|i| FLAGS[i]).collect();
        if usual_n.is_some_and(|usual_n| residual_n > LOUD * usual_n) {
            flags.push("residual");
        }
        Ok(Row {
            case: self.name,
            motion: motion.name,
            last: from_fn(|i| Column::of(runs.iter().filter_map(|run| run.last[i]))),
            coverage: from_fn(|i| Column::of(runs.iter().flat_map(|run| run.published[i].iter().copied())).coverage()),
            residual_n,
            flags,
        })
    }
}

/// One case with one motion over its seeds.
struct Row {
    case: &'static str,
    motion: &'static str,
    /// Errors of the final values.
    last: [Column; 3],
    /// Fraction of all published values whose interval covers the true value; `None` if none was published.
    coverage: [Option<f64>; 3],
    /// Mean residual \[N\].
    residual_n: f64,
    /// Faults that the device itself reports in at least half of the runs.
    flags: Vec<&'static str>,
}

impl Row {
    fn flags(&self, i: usize) -> String {
        let mut flags = self.flags.clone();
        if 2 * self.last[i].given <= SEEDS as usize {
            flags.push("not identifiable");
        }
        if flags.is_empty() { "-".into() } else { flags.join(", ") }
    }

    fn is_wrong(&self, i: usize) -> bool {
        self.coverage[i].is_some_and(|part| coverage::is_low(part, SEEDS))
    }

    fn cells(&self, i: usize) -> Vec<String> {
        let Column { bias, sigma, u95, given, .. } = self.last[i];
        let coverage = percent(self.coverage[i]);
        vec![
            self.case.into(),
            self.motion.into(),
            NAMES[i].into(),
            mean(bias, sigma.max(0.01 * bias.abs())),
            significant(sigma),
            // With a single run there is no scatter to compare its interval with.
            if given < 2 { "-".into() } else { significant(u95) },
            if self.is_wrong(i) { format!("**{coverage}**") } else { coverage },
            given.to_string(),
            significant(self.residual_n),
            self.flags(i),
        ]
    }
}

/// The whole document.
fn markdown(rows: &[Row]) -> String {
    let mut text = format!(
        "# Robustness

How one imperfection of rig or device at a time affects the estimates. Device, rig and motions are
those of [accuracy](accuracy.md) (1 kHz, 1 N, 2.44 um per count). Each row has {SEEDS} runs of 20 s, in
`slow` of 80 s. The settings state the encoder's count and the limits of a clipped force, and
what a row's name says is stated, but no other imperfection. *fc* is the sliding friction, the mean
of both directions.

Written by `cargo xtask robustness --update`. `cargo xtask robustness` measures again. It fails if a
figure differs from the table by more than {} %, or if the flags differ.

- *bias*, *sigma*: mean and standard deviation of the error of the whole run's value at the end of
  the run. *U95*: mean half width of its interval.
- *covered*: percentage of all published values, ten a second, live and of the whole run, whose
  interval contains the true value. It is bold where it is below 95 % by more than chance explains.
  In the first second of motion the behaviour of friction is not yet known.
- *runs*: how many ended with a value. *residual*: rms of the force that the law does not explain
  \\[N\\].
- *flagged by*: what the device itself reports in at least half of the runs: its counters of
  discontinuities and saturated samples, the friction regime, or a parameter that is not
  identifiable. *residual* is added if it exceeds {LOUD} times that of the undisturbed rig (`none`).

| imperfection | motion | parameter | bias | sigma | U95 | covered | runs | residual | flagged by |
|---|---|---|--:|--:|--:|--:|--:|--:|---|
",
        TOLERANCE * 100.0
    );
    let mut wrong = Vec::new();
    for row in rows {
        for (i, name) in NAMES.iter().enumerate() {
            text += &line(row.cells(i));
            if row.is_wrong(i) && row.flags(i) == "-" {
                let [bias, u95] = [row.last[i].bias, row.last[i].u95].map(significant);
                wrong.push(format!("{}, {}, {}: bias {bias}, U95 {u95}", row.case, row.motion, name));
            }
        }
    }
    text + "\n## Wrong and not flagged\n\n" + &list(&wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_tests::sheet;

    fn differences(committed: &str, now: &str) -> Vec<String> {
        sheet::differences(committed, now, 3)
    }

    fn row(bias: f64, coverage: f64, flags: &[&'static str]) -> Row {
        Row {
            case: "gain 1 %",
            motion: "mid",
            last: [Column { bias, sigma: 0.02, u95: 0.09, given: 8, ..Column::default() }; 3],
            coverage: [Some(coverage), Some(1.0), None],
            residual_n: 0.39,
            flags: flags.to_vec(),
        }
    }

    #[test]
    fn a_figure_or_a_flag_that_moves_is_named() {
        let table = |bias, flags: &[&'static str]| markdown(&[row(bias, 1.0, flags)]);
        assert!(differences(&table(0.5, &["discontinuities"]), &table(0.505, &["discontinuities"])).is_empty());
        let found = differences(&table(0.5, &["discontinuities"]), &table(0.6, &["discontinuities"]));
        assert_eq!(found[0], "gain 1 %, mid, mt kg: bias 0.6000, the table says 0.5000");
        assert_eq!(differences(&table(0.5, &["discontinuities"]), &table(0.5, &[])).len(), 3);
        assert_eq!(differences(&table(0.5, &[]), "").len(), 3);
        assert_eq!(differences("", &table(0.5, &[])).len(), 3);
    }

    #[test]
    fn what_is_wrong_without_a_flag_is_listed() {
        let text = markdown(&[row(0.5, 0.2, &[])]);
        assert!(text.contains("| **20.0** |") && text.contains("- gain 1 %, mid, mt kg: bias 0.500, U95 0.0900."));
        assert!(markdown(&[row(0.5, 0.2, &["discontinuities"])]).contains("None."));
        assert!(markdown(&[row(0.0, 1.0, &[])]).contains("None."));
    }
}
