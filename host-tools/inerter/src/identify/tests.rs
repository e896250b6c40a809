use inerter_plant::{Excitation, Parameters as Device, Sensors, Simulation};

use super::*;
use crate::simulate::{calibrated, raw};

/// A run of a device with a terminal sensor, its structure mass and skew known as on a bench.
fn shaken(device: &Device, motion: &str, seed: u64, duration_s: f64) -> Run {
    let sensors = Sensors {
        force_noise_n: 1.0,
        force_offset_n: 3.0,
        terminal_noise_m: 1e-6,
        encoder_phase_count: (seed as f64 * 0.618) % 1.0,
        seed,
        ..Sensors::default()
    };
    let simulation = Simulation::new(*device, Excitation::parse(motion, seed).unwrap(), sensors).unwrap();
    let settings = Settings {
        terminal_sensor: 1.0,
        stiffness_n_per_m: 0.0,
        contact_damping_n_s_per_m: 0.0,
        structure_mass_u95_kg: 0.01,
        ..calibrated(device, &sensors).unwrap()
    };
    let samples = simulation.lasting(duration_s).map(|sample| raw(&sample)).collect();
    Run { name: motion.into(), settings, samples, ..Run::default() }
}

fn quick() -> Options {
    Options { no_profiles: true, ..Options::default() }
}

/// Name, truth, and the greatest error allowed.
fn assert_found(found: &Identified, expected: &[(&str, f64, f64)]) {
    for (name, truth, limit) in expected {
        let (_, parameter) = found.parameters.named().into_iter().find(|(other, _)| other == name).unwrap();
        let (value, u95) = parameter.value.zip(parameter.u95).unwrap_or_else(|| panic!("{name}: {parameter:?}"));
        assert!((value - truth).abs() < *limit, "{name}: {value} for {truth}");
        assert!((value - truth).abs() <= u95, "{name}: {value} \u{b1} {u95} for {truth}");
    }
}

#[test]
fn a_device_is_recovered_and_its_force_predicted() {
    let device = Device { backlash_m: 4e-5, coulomb_n: 38.0, inertance_kg: 240.0, ..Device::paper() };
    let run = shaken(&device, "multi", 5, 12.0);
    let series = Series::of(&run);
    let mut heard = Vec::new();
    let found = identify(&[run], &quick(), &mut |done| heard.push(done)).unwrap();
    assert_eq!(found.route, Route::Complete);
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
    let found = identify(&[shaken(&Device::paper(), "random", 3, 12.0)], &quick(), &mut |_| ()).unwrap();
    assert!((0.9..1.1).contains(&found.residual_over_noise.unwrap()), "{found:?}");
    assert!(found.whiteness.unwrap().p > 1e-3, "{:?}", found.whiteness);
    assert_eq!(found.parameters.backlash_m.status, Standing::BelowU95);
    assert_found(&found, &[("inertance_kg", 299.4906, 0.1), ("coulomb_n", 50.0, 0.3)]);
}

#[test]
fn without_the_terminal_the_law_is_fitted_and_the_rest_said_to_be_unknown() {
    let mut run = shaken(&Device::paper(), "random", 2, 12.0);
    run.settings.terminal_sensor = 0.0;
    let options = Options { segment_s: Some(4.0), ..quick() };
    let found = identify(&[run.clone(), run.clone()], &options, &mut |_| ()).unwrap();
    assert_eq!(found.route, Route::Linear);
    assert_found(&found, &[("inertance_kg", 299.4906, 2.0), ("coulomb_n", 50.0, 1.0)]);
    assert_eq!(found.parameters.stiffness_n_per_m.status, Standing::NotIdentifiable);
    assert!(found.parameters.stiffness_n_per_m.reason.as_ref().unwrap().contains("terminal"));
    assert_eq!(found.segments.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3]);
    let staged = Options { staged: true, ..Options::default() };
    assert!(matches!(identify(&[run.clone()], &staged, &mut |_| ()), Err(IdentifyError::Terminal)));
    // The law predicts as well, from the encoder alone.
    let series = Series::of(&run);
    let force = predicted(&found.model(), &series);
    let left: f64 = series.stretches[0].force_n.iter().zip(&force).map(|(a, b)| (a - b).powi(2)).sum();
    let all: f64 = series.stretches[0].force_n.iter().map(|force| force * force).sum();
    assert!(left < 0.05 * all, "{left} of {all}");
}

#[test]
fn rest_and_haste_are_refused_with_a_reason() {
    let rest = shaken(&Device::paper(), "hold", 1, 5.0);
    assert_eq!(identify(&[rest], &quick(), &mut |_| ()).unwrap_err().exit_code(), 9);
    let mut short = shaken(&Device::paper(), "mid", 1, 6.0);
    // A gap every second.
    short.samples.retain(|sample| sample.index % 1000 != 0);
    let refused = identify(&[short], &quick(), &mut |_| ()).unwrap_err();
    assert!(matches!(refused, IdentifyError::TooShort { .. }), "{refused}");
    assert_eq!(refused.exit_code(), 3);
    assert!(identify(&[], &quick(), &mut |_| ()).is_err());
    let series = Series { period_s: 1e-3, stretches: vec![Stretch::default()] };
    assert!(predicted(&Parameters::default(), &series).is_empty());
}
