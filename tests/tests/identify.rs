//! `inerter identify` on simulated devices: hidden ones within goals and intervals (all of them: `cargo xtask
//! identify`), parameters left free, several files, a stated motion, and refusals.

use inerter_analysis::identify::{
    FoundStatus, Identified, IdentifyError, Model, Options, Parameters, identify, predicted,
};
use inerter_core::Settings;
use inerter_data::{
    run::Run,
    series::{Series, Stretch},
};
use inerter_plant::{Excitation, Inerter, Sensors};
use inerter_tests::identify::{DURATION_S, GOALS, errors, hidden, identified, instruments, recorded};

/// A run of a device with a terminal sensor.
fn shaken(device: &Inerter, motion: &str, seed: u64, duration_s: f64) -> Run {
    recorded(device, motion, &instruments(seed), duration_s).unwrap()
}

fn quick() -> Options {
    Options { no_profiles: true, ..Options::default() }
}

/// For each parameter: name, true value, and maximum error.
fn assert_found(found: &Identified, expected: &[(&str, f64, f64)]) {
    for (name, truth, limit) in expected {
        let (_, parameter) = found.parameters.named().into_iter().find(|(other, _)| other == name).unwrap();
        let (value, u95) = parameter.value.zip(parameter.u95).unwrap_or_else(|| panic!("{name}: {parameter:?}"));
        assert!((value - truth).abs() < *limit, "{name}: {value} for {truth}");
        assert!((value - truth).abs() <= u95, "{name}: {value} \u{b1} {u95} for {truth}");
    }
}

#[test]
fn hidden_devices_are_found_within_the_goals_and_the_intervals() {
    for (motion, seed) in [("random", 3), ("two", 3)] {
        let device = hidden(seed);
        let found = identified(recorded(&device, motion, &instruments(seed), DURATION_S).unwrap()).unwrap();
        for (error, (name, goal)) in errors(&device, &found).into_iter().zip(GOALS) {
            let (error, u95) = error.unwrap_or_else(|| panic!("{motion} {seed}: no {name}"));
            assert!(error.abs() < goal, "{motion} {seed}: {name} wrong by {error}");
            assert!(error.abs() <= u95, "{motion} {seed}: {name} wrong by {error}, interval {u95}");
        }
    }
}

/// A device whose flanks separate.
fn loose() -> Inerter {
    Inerter { backlash_m: 4e-5, coulomb_n: 38.0, inertance_kg: 240.0, ..Inerter::paper() }
}

#[test]
fn a_stated_motion_stands_in_for_the_terminal_sensor_and_a_wrong_one_is_told() {
    let mut run = shaken(&loose(), "random", 4, 10.0);
    run.settings.terminal_sensor = false;
    let stated = |seed: u64| Options { excite: Some(Excitation::parse("random", seed).unwrap()), ..quick() };
    let found = identify(&[run.clone()], &stated(4), &mut |_| ()).unwrap();
    assert_eq!(found.model, Model::Complete);
    assert_found(
        &found,
        &[
            ("inertance_kg", 240.0, 0.24),
            ("coulomb_n", 38.0, 0.5),
            ("stiffness_n_per_m", 2.1e6, 1e4),
            ("contact_damping_n_s_per_m", 1200.0, 60.0),
            ("backlash_m", 4e-5, 1e-6),
        ],
    );
    assert!((0.8..1.1).contains(&found.residual_over_noise.unwrap()), "{found:?}");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    // With a wrong motion there is no fit, or one that reports its misfit.
    match identify(&[run], &stated(5), &mut |_| ()) {
        Err(error) => assert!(matches!(error, IdentifyError::Diverged), "{error}"),
        Ok(found) => {
            assert!(found.notes.iter().any(|note| note.contains("sensors' noise explains")), "{:?}", found.notes);
            assert_ne!(found.parameters.stiffness_n_per_m.status, FoundStatus::Ok, "{:?}", found.parameters);
        }
    }
}

#[test]
fn a_structure_mass_that_the_settings_state_wrongly_is_found() {
    let device = Inerter { structure_mass_kg: 1.6, ..loose() };
    let mut run = shaken(&device, "random", 6, 10.0);
    run.settings.structure_mass_kg = 0.8;
    let options = Options { free_structure_mass: true, ..quick() };
    let found = identify(&[run], &options, &mut |_| ()).unwrap();
    assert_found(&found, &[("structure_mass_kg", 1.6, 0.3), ("inertance_kg", 240.0, 0.24)]);
    assert_eq!(found.parameters.structure_mass_kg.status, FoundStatus::Ok);
}

#[test]
fn a_skew_that_the_settings_state_wrongly_is_found() {
    let sensors = Sensors { delay_s: 2e-4, ..instruments(7) };
    let mut run = recorded(&loose(), "random", &sensors, 10.0).unwrap();
    run.settings.skew_s = 0.0;
    let options = Options { free_skew: true, ..quick() };
    let found = identify(&[run], &options, &mut |_| ()).unwrap();
    assert_found(&found, &[("skew_s", 2e-4, 2e-5), ("inertance_kg", 240.0, 0.24), ("stiffness_n_per_m", 2.1e6, 1e4)]);
    assert_eq!(found.parameters.skew_s.status, FoundStatus::Ok);
}

#[test]
fn several_files_are_one_device_each_with_its_own_offset() {
    let rig = |seed: u64, offset: f64| Sensors { force_offset_n: offset, ..instruments(seed) };
    let run = |motion: &str, rig: Sensors| recorded(&loose(), motion, &rig, 8.0).unwrap();
    let runs = [run("mid", rig(8, 3.0)), run("random", rig(9, -7.0))];
    let both = identify(&runs, &quick(), &mut |_| ()).unwrap();
    assert_found(&both, &[("inertance_kg", 240.0, 0.24), ("coulomb_n", 38.0, 0.5), ("backlash_m", 4e-5, 1e-6)]);
    let [Some(first), Some(second)] = both.offsets_n.as_slice() else { panic!("{:?}", both.offsets_n) };
    assert!((first - 3.0).abs() < 0.3 && (second + 7.0).abs() < 0.3, "{:?}", both.offsets_n);
    for run in runs {
        let one = identify(&[run], &quick(), &mut |_| ()).unwrap();
        for ((name, both), (_, one)) in both.parameters.named().into_iter().zip(one.parameters.named()).take(6) {
            let (both, one) = (both.u95.unwrap(), one.u95.unwrap_or(f64::INFINITY));
            assert!(both < 1.1 * one, "{name}: {both} by both, {one} by one");
        }
    }
}

#[test]
fn a_device_is_recovered_and_its_force_predicted() {
    let run = shaken(&loose(), "multi", 5, 12.0);
    let series = Series::of(&run);
    let mut heard = Vec::new();
    let found = identify(&[run], &quick(), &mut |done| heard.push(done)).unwrap();
    assert_eq!(found.model, Model::Complete);
    assert_found(
        &found,
        &[
            ("inertance_kg", 240.0, 0.24),
            ("coulomb_n", 38.0, 0.5),
            ("viscous_n_s_per_m", 31.4, 5.0),
            ("stiffness_n_per_m", 2.1e6, 1e4),
            ("contact_damping_n_s_per_m", 1200.0, 60.0),
            ("backlash_m", 4e-5, 1e-6),
            ("offset_n", 3.0, 0.2),
        ],
    );
    assert!(heard.is_sorted() && heard.last() == Some(&1.0), "{heard:?}");
    let validation = found.validation.unwrap();
    assert!(validation.explained > 0.99 && validation.explained < 1.0, "{validation:?}");
    let force = predicted(&found.model(), &series);
    assert_eq!(force.len(), series.len());
    let measured = &series.stretches[0].force_n;
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
    let left = square(&mut measured.iter().zip(&force).map(|(a, b)| a - b));
    assert!(left < 1e-3 * square(&mut measured.iter().copied()));
}

#[test]
fn without_backlash_the_residual_is_white() {
    let found = identify(&[shaken(&Inerter::paper(), "random", 3, 12.0)], &quick(), &mut |_| ()).unwrap();
    assert!((0.9..1.1).contains(&found.residual_over_noise.unwrap()), "{found:?}");
    assert!(found.whiteness.unwrap().p > 1e-3, "{:?}", found.whiteness);
    assert_eq!(found.parameters.backlash_m.status, FoundStatus::BelowU95);
    assert_found(&found, &[("inertance_kg", 299.4906, 0.1), ("coulomb_n", 50.0, 0.3)]);
}

#[test]
fn without_the_terminal_the_law_is_fitted_and_the_rest_said_to_be_unknown() {
    let mut run = shaken(&Inerter::paper(), "random", 2, 12.0);
    // With realistic calibration uncertainties: the law neglects the contact's deflection.
    let usual = Settings::default();
    run.settings = Settings {
        terminal_sensor: false,
        force_gain_u95: usual.force_gain_u95,
        lead_u95: usual.lead_u95,
        timebase_u95: usual.timebase_u95,
        ..run.settings
    };
    let options = Options { segment_s: Some(4.0), ..quick() };
    let found = identify(&[run.clone(), run.clone()], &options, &mut |_| ()).unwrap();
    assert_eq!(found.model, Model::Linear);
    assert_found(&found, &[("inertance_kg", 299.4906, 2.0), ("coulomb_n", 50.0, 1.0)]);
    assert_eq!(found.parameters.stiffness_n_per_m.status, FoundStatus::NotIdentifiable);
    assert!(found.parameters.stiffness_n_per_m.reason.as_ref().unwrap().contains("terminal"));
    assert_eq!(found.segments.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3]);
    let staged = Options { staged: true, ..Options::default() };
    assert!(matches!(identify(&[run.clone()], &staged, &mut |_| ()), Err(IdentifyError::Terminal)));
    // The law also predicts the force, from the encoder alone.
    let series = Series::of(&run);
    let force = predicted(&found.model(), &series);
    let left: f64 = series.stretches[0].force_n.iter().zip(&force).map(|(a, b)| (a - b).powi(2)).sum();
    let all: f64 = series.stretches[0].force_n.iter().map(|force| force * force).sum();
    assert!(left < 0.05 * all, "{left} of {all}");
}

#[test]
fn rest_and_haste_are_refused_with_a_reason() {
    let rest = shaken(&Inerter::paper(), "hold", 1, 5.0);
    let refused = identify(&[rest], &quick(), &mut |_| ()).unwrap_err();
    assert!(matches!(refused, IdentifyError::Fit(_) | IdentifyError::Diverged), "{refused}");
    let mut short = shaken(&Inerter::paper(), "mid", 1, 6.0);
    // A sample lost every second.
    short.samples.retain(|sample| sample.index % 1000 != 0);
    let refused = identify(&[short], &quick(), &mut |_| ()).unwrap_err();
    assert!(matches!(refused, IdentifyError::TooShort { .. }), "{refused}");
    assert!(identify(&[], &quick(), &mut |_| ()).is_err());
    let series = Series { period_s: 1e-3, stretches: vec![Stretch::default()] };
    assert!(predicted(&Parameters::default(), &series).is_empty());
}
