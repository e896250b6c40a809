//! Results of each method: the rivals through the cases, the instrument on the raw samples.

use crate::{
    cases::{self, CHANGE, CHANGE_S, CLEAN_TRUTH, Case, DURATION_S, MEMORIES_S, Outcome, Question, SEEDS, SLOW_S},
    methods::{METHODS, UNLIMITED, WALK},
};
use inerter_core::{Change, Detail, Estimate, Published, RawSample, Settings, SettingsError, State};
use inerter_plant::{Inerter, Sample};
use std::error::Error;

/// Results of one method in every case; none if it has no result of its own.
#[derive(Clone, Debug)]
pub struct Answers {
    /// Method.
    pub name: String,
    /// In the order of the cases.
    pub outcomes: Vec<Option<Outcome>>,
}

impl Answers {
    /// Its own results for one question, each with the case.
    pub fn to<'a>(&'a self, cases: &'a [Case], question: Question) -> Vec<(&'a Case, &'a Outcome)> {
        let of_question = cases.iter().zip(&self.outcomes).filter(|(case, _)| case.question == question);
        of_question.filter_map(|(case, outcome)| Some((case, outcome.as_ref()?))).collect()
    }
}

/// Every Rust method through every case.
pub fn rust(cases: &[Case]) -> Vec<Answers> {
    METHODS
        .iter()
        .filter_map(|(.., name, fresh)| {
            let name = (*name)?;
            let own = |case: &&Case| name != WALK || case.forgetting < 1.0;
            let outcomes =
                cases.iter().map(|case| Some(case).filter(own).map(|case| case.drive(fresh(&case.tuning()))));
            Some(Answers { name: name.into(), outcomes: outcomes.collect() })
        })
        .collect()
}

/// Rejects methods that do not find the clean contact law: the fault would be in how they are driven.
pub fn check_driving(cases: &[Case], answers: &[Answers]) -> Result<(), String> {
    for answer in answers.iter().filter(|answer| !limits_itself(&answer.name)) {
        for (_, outcome) in answer.to(cases, Question::Clean) {
            let [stiff, damped, half_backlash, _] = outcome.parameters;
            let near = |value: f64, truth: f64, part: f64| (value / truth - 1.0).abs() <= part;
            let [stiff_truth, damped_truth, half_backlash_truth, _] = CLEAN_TRUTH;
            let knows = near(stiff, stiff_truth, 1e-3) && near(half_backlash, half_backlash_truth, 1e-3);
            if !knows || !near(damped, damped_truth, 0.05) {
                return Err(format!("{} is driven wrongly: {:?} of {CLEAN_TRUTH:?}", answer.name, outcome.parameters));
            }
        }
    }
    Ok(())
}

/// Whether it is the method whose own guard keeps it from learning.
pub fn limits_itself(name: &str) -> bool {
    name != UNLIMITED && name.contains("RlsParallel")
}

/// The instrument's results for one run.
pub struct Heard {
    /// Estimates with their times \[s\].
    pub published: Vec<(f64, Estimate)>,
    /// The first change it announced, and when \[s\].
    pub change: Option<(f64, Change)>,
    /// At the end.
    pub last: Estimate,
    /// At the end.
    pub detail: Detail,
}

/// The instrument's results for the questions put to the rivals.
pub struct Instrument {
    /// Motion, backlash \[m\], with the sensor, by the force alone.
    pub contact: Vec<(&'static str, f64, Heard, Heard)>,
    /// Motion and what was heard.
    pub interval: Vec<(&'static str, Heard)>,
    /// Memory \[s\] and what was heard.
    pub change: Vec<(f64, Heard)>,
    /// The slow runs.
    pub slow: Vec<Heard>,
}

impl Instrument {
    /// Runs it through everything.
    pub fn new() -> Result<Self, Box<dyn Error>> {
        let (mut contact, mut interval, mut change, mut slow) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for motion in ["mid", "random"] {
            for device in [cases::worn(), cases::device()] {
                for seed in 1..=SEEDS {
                    let samples = cases::record(device, Vec::new(), motion, seed, DURATION_S)?;
                    let sensed = listen(&samples, &device, &[("terminal_sensor", 1.0)])?;
                    contact.push((motion, device.backlash_m, sensed, listen(&samples, &device, &[])?));
                }
            }
            for seed in 1..=cases::INTERVAL_SEEDS {
                let samples = cases::record(cases::device(), Vec::new(), motion, seed, DURATION_S)?;
                interval.push((motion, listen(&samples, &cases::device(), &[])?));
            }
        }
        for seed in 1..=SEEDS {
            let samples = cases::changing_record(seed)?;
            for memory_s in MEMORIES_S {
                change.push((memory_s, listen(&samples, &cases::device(), &[("memory_s", memory_s)])?));
            }
            let samples = cases::record(cases::device(), Vec::new(), "slow", seed, SLOW_S[1])?;
            slow.push(listen(&samples, &cases::device(), &[])?);
        }
        Ok(Self { contact, interval, change, slow })
    }
}

/// Settings of a calibration without error, a memory of the whole run.
fn calibrated(device: &Inerter) -> Settings {
    let sensors = cases::sensors(0);
    let conversions = sensors.oversampling;
    let defaults = Settings::default();
    Settings {
        sample_rate_hz: sensors.sample_rate_hz,
        metres_per_count: sensors.metres_per_count,
        oversampling: conversions,
        newtons_per_code: sensors.newtons_per_sample_code(),
        force_zero_code: sensors.force_zero_code * conversions,
        force_min_code: (sensors.force_min_code * conversions).max(defaults.force_min_code),
        force_max_code: (sensors.force_max_code * conversions).min(defaults.force_max_code),
        metres_per_terminal_code: sensors.metres_per_terminal_code,
        structure_mass_kg: device.structure_mass_kg,
        stiffness_n_per_m: device.stiffness_n_per_m,
        contact_damping_n_s_per_m: device.contact_damping_n_s_per_m,
        skew_s: sensors.delay_s,
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        publish_rate_hz: 10.0,
        memory_s: 100.0,
        ..defaults
    }
}

/// The samples through `Active::step`, with the settings of a calibration without error, a memory of the whole run and
/// these further settings.
fn listen(samples: &[Sample], device: &Inerter, set: &[(&str, f64)]) -> Result<Heard, Box<dyn Error>> {
    let mut settings = calibrated(device);
    for (name, value) in set {
        match settings.set_by_name(name, *value) {
            // A core without the terminal's route says that it is not identifiable.
            Ok(()) | Err(SettingsError::Unknown) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let active = settings.validate()?;
    let mut state = Box::new(State::new(&active));
    let (mut published, mut change) = (Vec::new(), None);
    for sample in samples {
        let raw = RawSample {
            index: sample.index,
            position_count: sample.position_count,
            force_code: sample.force_code,
            terminal_code: sample.terminal_code,
        };
        let output = active.step(&mut state, &raw);
        published.extend(output.estimate().map(|estimate| (sample.t_s, estimate)));
        change = change.or(output.change.map(|change| (sample.t_s, change)));
    }
    let Published { estimate: last, detail, .. } = active.publish(&state);
    Ok(Heard { published, change, last, detail })
}

/// Time after the change from which the inertance stays within 1 % of the new one \[s\]; none if it does not.
pub fn settling_s(values: impl DoubleEndedIterator<Item = (f64, f64)>) -> Option<f64> {
    let inertance_kg = CHANGE * cases::device().inertance_kg;
    let mut settled = None;
    for (t_s, value) in values.rev() {
        let error = (value / inertance_kg - 1.0).abs();
        // NaN is not near.
        if error.is_nan() || error > 0.01 || t_s < CHANGE_S {
            break;
        }
        settled = Some(t_s - CHANGE_S);
    }
    settled
}

/// The same of the instrument, which must also give a value.
pub fn heard_settling_s(heard: &Heard) -> Option<f64> {
    settling_s(heard.published.iter().map(|(t_s, estimate)| {
        let inertance = estimate.recent.inertance_kg;
        (*t_s, inertance.value().map_or(f64::NAN, f64::from))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::{WHITE_TRUTH, all};

    /// Each finds the backlash on clean data, and if the noise is as its covariance assumes, its interval holds.
    #[test]
    fn every_rival_is_driven_as_it_should_be() {
        let cases: Vec<Case> = all()
            .unwrap()
            .into_iter()
            .filter(|case| matches!(case.question, Question::Clean | Question::White))
            .collect();
        let answers = rust(&cases);
        check_driving(&cases, &answers).unwrap();
        for answer in answers.iter().filter(|answer| !limits_itself(&answer.name)) {
            let (mut covered, mut all) = (0, 0);
            for (case, outcome) in answer.to(&cases, Question::White) {
                let Some(widths) = case.half_widths(outcome) else { continue };
                for ((value, truth), width) in outcome.parameters.iter().zip(WHITE_TRUTH).zip(widths) {
                    all += 1;
                    covered += u32::from((value - truth).abs() <= width);
                }
            }
            // 95 % of 128, by more than three standard deviations.
            assert!(all == 0 || (all == 128 && (113..=128).contains(&covered)), "{}: {covered} of {all}", answer.name);
        }
    }

    #[test]
    fn a_method_driven_wrongly_is_refused() {
        let cases: Vec<Case> = all().unwrap().into_iter().take(1).collect();
        let mut answers = rust(&cases);
        if let Some(Some(outcome)) = answers[1].outcomes.first_mut() {
            outcome.parameters[2] *= 2.0;
        }
        assert!(check_driving(&cases, &answers).unwrap_err().contains("textbook"));
    }

    #[test]
    fn settling_is_the_last_entry() {
        let new = CHANGE * cases::device().inertance_kg;
        let values = [(9.0, new), (11.0, new), (12.0, 0.9 * new), (13.0, new), (14.0, new)];
        assert_eq!(settling_s(values.into_iter()), Some(3.0));
        assert_eq!(settling_s([(13.0, new), (14.0, f64::NAN)].into_iter()), None);
    }
}
