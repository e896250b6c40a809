//! Samples that no device can cause: each kind is reported with its time, and nothing derived from them is published.

use crate::rig::{MOTIONS, calibrated, raw, three, truth};
use inerter_core::{Estimate, LawStatus, RawSample, Settings, State, Status, Warning, WarningKind};
use inerter_plant::{Excitation, Inerter, Plant, Sensors, Simulation};

const RATE_HZ: f64 = 1000.0;

struct Said {
    warnings: Vec<Warning>,
    last: Estimate,
    law: LawStatus,
}

fn samples(device: Inerter, motion: &str, seed: u64, noise_n: f64) -> (Settings, Vec<RawSample>) {
    let sensors = Sensors { force_noise_n: noise_n, force_offset_n: 3.0, seed, ..Sensors::default() };
    let plant = Plant::new(device, Excitation::parse(motion, seed).unwrap()).unwrap();
    let duration_s = MOTIONS.iter().find(|(name, _)| *name == motion).unwrap().1;
    let samples = Simulation::of(plant, sensors).unwrap().lasting(duration_s).map(|sample| raw(&sample)).collect();
    (calibrated(&device, &sensors), samples)
}

fn run(settings: &Settings, samples: &[RawSample]) -> Said {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let warnings = samples.iter().filter_map(|sample| active.step(&mut state, sample).warning).collect();
    let published = active.publish(&state);
    Said { warnings, last: published.estimate, law: published.law.status }
}

fn kinds(said: &Said) -> Vec<WarningKind> {
    said.warnings.iter().map(|warning| warning.kind).collect()
}

/// Number of parameters of recent memory and whole run that have a value and are wrong by more than their interval.
fn wrong(device: &Inerter, said: &Said) -> usize {
    let of = |parameters| {
        let found = three(parameters).into_iter().zip(truth(device));
        let off = |parameter: inerter_core::Parameter, truth: f64| {
            let fitted = parameter.fitted();
            parameter.status() == Status::Ok && (f64::from(fitted.value) - truth).abs() > f64::from(fitted.u95)
        };
        found.filter(|(parameter, truth)| off(*parameter, *truth)).count()
    };
    of(&said.last.recent) + of(&said.last.whole_run)
}

#[test]
fn a_force_of_the_wrong_sign_is_no_inertance() {
    for motion in MOTIONS.map(|(name, _)| name) {
        let (settings, mut samples) = samples(Inerter::paper(), motion, 32, 1.0);
        samples.iter_mut().for_each(|sample| sample.force_code = -sample.force_code);
        let said = run(&settings, &samples);
        assert_eq!((kinds(&said), said.law), (vec![WarningKind::WrongSign], LawStatus::Broken), "{motion}");
        for parameters in [said.last.recent, said.last.whole_run] {
            assert_eq!(
                three(&parameters).map(|parameter| parameter.status()),
                [Status::NotIdentifiable; 3],
                "{motion}"
            );
        }
    }
}

#[test]
fn a_force_that_is_clipped_below_its_rails_is_left_out() {
    // By the fraction of samples clipped on a side.
    for (motion, part) in [("mid", 0.1), ("mid", 0.3), ("random", 0.05), ("two", 0.1), ("slow", 0.1), ("fast", 0.2)] {
        for sides in [[true, true], [true, false], [false, true]] {
            let (settings, mut samples) = samples(Inerter::paper(), motion, 33, 1.0);
            let mut codes: Vec<i32> = samples.iter().map(|sample| sample.force_code).collect();
            codes.sort_unstable();
            let quantile = |part: f64| codes[(part * codes.len() as f64) as usize];
            let low = if sides[0] { quantile(part) } else { i32::MIN };
            let high = if sides[1] { quantile(1.0 - part) } else { i32::MAX };
            samples.iter_mut().for_each(|sample| sample.force_code = sample.force_code.clamp(low, high));
            let said = run(&settings, &samples);
            let first = said.warnings.first().unwrap_or_else(|| panic!("{motion}, {part}, {sides:?}"));
            assert_eq!(first.kind, WarningKind::ClippedForce, "{motion}, {part}");
            assert_eq!(wrong(&Inerter::paper(), &said), 0, "{motion}, {part}, {sides:?}: {:?}", said.last);
        }
    }
}

#[test]
fn a_force_that_stands_still_is_none() {
    for motion in MOTIONS.map(|(name, _)| name) {
        for from_s in [0.0, 10.0] {
            let (settings, mut samples) = samples(Inerter::paper(), motion, 34, 1.0);
            let from = (from_s * RATE_HZ) as usize;
            let held = samples[from].force_code;
            samples.iter_mut().skip(from).for_each(|sample| sample.force_code = held);
            let said = run(&settings, &samples);
            assert_eq!(kinds(&said).pop(), Some(WarningKind::DeadForce), "{motion} from {from_s} s");
            for parameters in [said.last.recent, said.last.whole_run] {
                let statuses = three(&parameters).map(|parameter| parameter.status());
                assert!(!statuses.contains(&Status::Ok), "{motion} from {from_s} s: {parameters:?}");
            }
        }
    }
}

#[test]
fn counts_that_slip_are_left_out() {
    for motion in ["mid", "random", "two", "slow"] {
        let (settings, mut samples) = samples(Inerter::paper(), motion, 35, 1.0);
        let clean = run(&settings, &samples);
        // A hundred counts, every 3.1 s from the sixth second on.
        let mut slips = Vec::new();
        for at in (6000..samples.len()).step_by(3100) {
            slips.push(samples[at].index);
            samples.iter_mut().skip(at).for_each(|sample| sample.position_count += 100);
        }
        let said = run(&settings, &samples);
        assert!(slips.len() >= 4);
        assert_eq!(
            said.warnings,
            slips.iter().map(|index| Warning { index: *index, kind: WarningKind::CountSlip }).collect::<Vec<_>>(),
            "{motion}"
        );
        let wrong = |said| wrong(&Inerter::paper(), said);
        assert!(wrong(&said) <= wrong(&clean), "{motion}: {:?}", said.last.whole_run);
        let [with, without] = [said, clean].map(|said| said.last.whole_run.inertance_kg.fitted());
        assert!((with.value - without.value).abs() < 0.5 * without.u95, "{motion}: {with:?}, {without:?}");
    }
}

/// A force within one code has no extreme at which codes could accumulate, whichever of them is examined.
#[test]
fn a_force_that_hardly_changes_is_not_clipped() {
    let settings = Settings::default();
    let updates = [0, 1].map(|phase| {
        let samples: Vec<RawSample> = (0..20_000_u32)
            .map(|index| RawSample {
                index,
                // In one direction, faster and slower.
                position_count: (10.0 * f64::from(index) + 300.0 * (f64::from(index) * 0.013).sin()) as i32,
                force_code: ((index + phase) % 2) as i32,
                terminal_code: 0,
            })
            .collect();
        let said = run(&settings, &samples);
        assert_eq!(kinds(&said), [], "{phase}");
        said.last.updates
    });
    assert!(updates.iter().all(|each| *each > 2000), "{updates:?}");
}
