//! A device that changes into another one while it moves, and one that does not change.

use crate::rig;
use inerter_core::{Changed, Published, RawSample, Settings, State};
use inerter_plant::{Excitation, Inerter, Plant, Sensors, Simulation};

/// The changes reported for these samples, each with its time \[s\].
fn changes(settings: &Settings, samples: impl IntoIterator<Item = RawSample>) -> Vec<(f64, inerter_core::Change)> {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut found = Vec::new();
    for (n, sample) in samples.into_iter().enumerate() {
        let output = active.step(&mut state, &sample);
        found.extend(output.change.map(|change| (n as f64 / settings.sample_rate_hz, change)));
    }
    found
}

/// Samples of a simulated device that changes into another one at `at_s`.
fn shaken(motion: &str, at_s: f64, after: Inerter, sensors: Sensors, duration_s: f64) -> Vec<RawSample> {
    let excitation = Excitation::parse(motion, 3).unwrap();
    let plant = Plant::changing(Inerter::paper(), vec![(at_s, after)], excitation).unwrap();
    Simulation::of(plant, sensors).unwrap().lasting(duration_s).map(|sample| rig::raw(&sample)).collect()
}

const SENSORS: fn() -> Sensors = || Sensors { force_noise_n: 1.0, force_offset_n: 3.0, seed: 3, ..Sensors::default() };

fn settings() -> Settings {
    rig::calibrated(&Inerter::paper(), &SENSORS())
}

#[test]
fn a_step_at_3_hz_is_found_within_two_seconds_and_the_memory_begins_anew() {
    let paper = Inerter::paper();
    let lighter = Inerter { inertance_kg: 0.95 * paper.inertance_kg, ..paper };
    let drier = Inerter { coulomb_n: 1.3 * paper.coulomb_n, ..paper };
    let stickier = Inerter { viscous_n_s_per_m: 3.0 * paper.viscous_n_s_per_m, ..paper };
    for (after, parameter, value) in [
        (lighter, Changed::Inertance, lighter.inertance_kg),
        (drier, Changed::Coulomb, drier.coulomb_n),
        (stickier, Changed::Viscous, stickier.viscous_n_s_per_m),
    ] {
        let samples = shaken("mid", 8.0, after, SENSORS(), 14.0);
        let found = changes(&settings(), samples.iter().copied());
        let [(t_s, change)] = found.as_slice() else { panic!("{parameter:?}: {found:?}") };
        assert_eq!(change.parameter, parameter);
        assert!((8.0..10.0).contains(t_s), "{parameter:?} at {t_s} s");
        assert!((f64::from(change.after) / value - 1.0).abs() < 0.1, "{change:?} for {value}");
        assert_eq!(change.index, (t_s * 1000.0) as u32);
        // Neither memory contains anything of the old device.
        let active = settings().validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for sample in &samples {
            active.step(&mut state, sample);
        }
        let Published { estimate, detail, .. } = active.publish(&state);
        for parameters in [estimate.recent, estimate.whole_run] {
            let found = parameters.inertance_kg;
            assert!((f64::from(found.fitted().value) - after.inertance_kg).abs() < 0.3, "{found:?}");
        }
        assert_eq!(detail.changes, 1);
    }
}

/// Modifies a sample, given its number; `None` drops it.
type Alteration<'a> = dyn Fn(usize, RawSample) -> Option<RawSample> + 'a;

#[test]
fn what_is_no_change_is_none() {
    let samples = shaken("mid", 8.0, Inerter::paper(), SENSORS(), 20.0);
    let newton = |force_n: f64| (force_n / SENSORS().newtons_per_code) as i32;
    let within = |n: usize, from_s: f64, to_s: f64| (from_s..to_s).contains(&(n as f64 / 1000.0));
    // A blow of 500 N for 5 ms, a second with a saturated load cell, a second of pickup, a second of lost samples.
    let altered: [(&str, &Alteration); 5] = [
        ("nothing", &|_, sample| Some(sample)),
        ("a blow", &|n, sample| {
            let blow = if within(n, 10.0, 10.005) { newton(500.0) } else { 0 };
            Some(RawSample { force_code: sample.force_code + blow, ..sample })
        }),
        ("saturation", &|n, sample| {
            Some(RawSample { force_code: if within(n, 10.0, 11.0) { i32::MAX } else { sample.force_code }, ..sample })
        }),
        ("pickup", &|n, sample| {
            let pickup = if within(n, 10.0, 11.0) { 20.0 * (0.314_159 * n as f64).sin() } else { 0.0 };
            Some(RawSample { force_code: sample.force_code + newton(pickup), ..sample })
        }),
        ("lost samples", &|n, sample| (!within(n, 10.0, 11.0)).then_some(sample)),
    ];
    for (name, alter) in altered {
        let samples = samples.iter().enumerate().filter_map(|(n, sample)| alter(n, *sample));
        assert_eq!(changes(&settings(), samples), [], "{name}");
    }
}
