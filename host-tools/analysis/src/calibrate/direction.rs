//! Whether force and position have the same positive direction: a positive force must accelerate to the positive side.
//!
//! If one of them is reversed, the inertance comes out negative, which nothing else causes.

use inerter_core::Interval;
use inerter_data::{full_scale::Peaks, names::unit, replay::Outcome, run::Run, series::Series, words::interval_text};

use super::{CalibrateError, Finding, Step, finding::Level};

/// What was just calibrated in a known direction, and can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known {
    /// The force, from loads.
    pub force: bool,
    /// The position, from a displacement.
    pub position: bool,
}

/// Share of saturated samples above which a motion shows nothing: each one spoils its surroundings.
const MOST_SATURATED: f64 = 0.1;

/// Rejects a motion during which the force was often at its limit, or that was often beyond full scale.
pub fn refuse_saturated(outcome: &Outcome, run: &Run) -> Result<(), CalibrateError> {
    let share = f64::from(outcome.counters.saturated) / run.samples.len().max(1) as f64;
    if share <= MOST_SATURATED {
        return Ok(());
    }
    let (share, peaks) = (100.0 * share, Peaks::of(&Series::of(run)));
    Err(match peaks.beyond(&run.settings, &outcome.counters) {
        Some(words) => CalibrateError::FullScale { share, words },
        None => CalibrateError::Saturated { at: " during this motion".into(), share },
    })
}

/// Evaluates a short motion and the estimator's result for it.
pub fn direction(run: &Run, outcome: &Outcome, known: Known) -> Result<Finding, CalibrateError> {
    refuse_saturated(outcome, run)?;
    let inertance = outcome.estimate.whole_run.inertance_kg;
    // Regardless of its status: the estimator rejects negative values.
    let clear = |found: &Interval| found.value.is_finite() && found.value.abs() > 2.0 * found.u95;
    let Some(Interval { value, u95 }) = Some(inertance.fitted()).filter(clear) else {
        return Err(CalibrateError::NoMotion);
    };
    let (value, u95) = (f64::from(value), f64::from(u95));
    let mut finding = Finding::new(Step::Direction);
    finding.measure("inertance_kg", value);
    finding.measure("inertance_u95_kg", u95);
    let unit = unit(run.settings.machine, "kg");
    finding.say(format!("inertance by this motion {} {unit}", interval_text(value, u95)));
    if value > 0.0 {
        finding.say("force and position have the same positive direction");
        return Ok(finding);
    }
    let settings = &run.settings;
    let (which, value, other) = match known {
        Known { force: true, position: true } => {
            let text = "force and position have opposite positive directions, though both were calibrated: the positive \
                        direction of the loads or of the displacement was stated wrongly. Repeat one of the two";
            finding.remark(Level::Bad, "reversed", text);
            return Ok(finding);
        }
        Known { force: true, position: false } => ("metres_per_count", -settings.metres_per_count, "newtons_per_code"),
        _ => ("newtons_per_code", -settings.newtons_per_code, "metres_per_count"),
    };
    finding.set(which, value);
    let text = format!(
        "force and position have opposite positive directions: {which} changes sign, to {value:?}{}",
        if known == Known::default() {
            format!("; if the displacement has the wrong sign, change the sign of {other} instead")
        } else {
            String::new()
        }
    );
    finding.remark(Level::Note, "reversed", text);
    Ok(finding)
}

#[cfg(test)]
mod tests {
    use inerter_core::Settings;
    use inerter_data::{replay::replay, settings::SettingsInputError};
    use inerter_plant::Inerter;
    use inerter_simulate::bench_sensors;

    use super::*;
    use crate::simulated::{recorded, setup};

    fn run(motion: &str, turned: fn(Settings) -> Settings) -> Run {
        let run = recorded(&setup(Inerter::paper(), bench_sensors(), motion, 6.0));
        Run { settings: turned(run.settings), ..run }
    }

    fn found(run: &Run, known: Known) -> Result<Finding, CalibrateError> {
        direction(run, &replay(run, |_, _| Ok::<(), SettingsInputError>(())).unwrap(), known)
    }

    #[test]
    fn a_direction_that_is_reversed_is_found_and_turned() {
        for motion in ["random", "mid", "two"] {
            let right = found(&run(motion, |settings| settings), Known::default()).unwrap();
            assert!(right.is_good() && !right.has_settings(), "{motion}");
            for turned in [
                (|settings| Settings { newtons_per_code: -0.002, ..settings }) as fn(Settings) -> Settings,
                |settings| Settings { metres_per_count: -settings.metres_per_count, ..settings },
            ] {
                let run = run(motion, turned);
                let finding = found(&run, Known { force: true, position: false }).unwrap();
                assert_eq!(finding.values["metres_per_count"].as_f64(), Some(-run.settings.metres_per_count));
                let adopted = finding.adopted_by(&run.settings).unwrap();
                let after = found(&Run { settings: adopted, ..run.clone() }, Known::default()).unwrap();
                assert!(!after.has_settings(), "{motion}");
                let finding = found(&run, Known { force: false, position: true }).unwrap();
                assert_eq!(finding.values["newtons_per_code"].as_f64(), Some(-run.settings.newtons_per_code));
                let both = found(&run, Known { force: true, position: true }).unwrap();
                assert!(!both.is_good() && !both.has_settings());
            }
        }
    }

    #[test]
    fn a_device_at_rest_shows_no_direction() {
        let error = found(&run("hold", |settings| settings), Known::default()).unwrap_err();
        assert!(matches!(error, CalibrateError::NoMotion), "{error:?}");
        let narrow = |settings| Settings { force_min_code: -1e5, force_max_code: 1e5, ..settings };
        let error = found(&run("random", narrow), Known::default()).unwrap_err();
        assert!(matches!(error, CalibrateError::Saturated { .. }), "{error:?}");
    }
}
