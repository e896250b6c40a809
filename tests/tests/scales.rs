//! Machines of any size are measured in the same way: the same counts and codes in other units give the same values in
//! those units.

use inerter_core::{BacklashSize, Interval, Parameter, Published, RawSample, Settings};
use inerter_data::settings::Overrides;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors, raw};
use inerter_tests::grid;

/// The published values if one metre is `metre` units of length and one newton is `newton` units of force.
fn published(samples: &[RawSample], settings: &Settings, metre: f64, newton: f64) -> Published {
    let mass = newton / metre;
    let settings = Settings {
        metres_per_count: settings.metres_per_count * metre,
        metres_per_terminal_code: settings.metres_per_terminal_code * metre,
        newtons_per_code: settings.newtons_per_code * newton,
        structure_mass_kg: settings.structure_mass_kg * mass,
        structure_mass_u95_kg: settings.structure_mass_u95_kg * mass,
        stiffness_n_per_m: settings.stiffness_n_per_m * mass,
        stiffness_u95_n_per_m: settings.stiffness_u95_n_per_m * mass,
        contact_damping_n_s_per_m: settings.contact_damping_n_s_per_m * mass,
        full_scale_velocity_m_per_s: settings.full_scale_velocity_m_per_s * metre,
        full_scale_acceleration_m_per_s2: settings.full_scale_acceleration_m_per_s2 * metre,
        ..*settings
    };
    grid::published(&settings, samples.iter().copied()).unwrap()
}

/// Maximum difference of a value as a fraction of its interval: scales are rounded to powers of two.
const APART: f64 = 0.02;
/// The same for a backlash with up to one reversal in a hundred more in one unit than in the other. A reversal that is
/// off by one standard deviation moves a mean of n by 0.5 / sqrt(n) of its interval, which is 0.03 for n = 288.
const REVERSALS_APART: f64 = 0.1;

#[track_caller]
fn alike(here: Interval, there: Interval, unit: f64, most: f64, what: &str) {
    let scaled = |value: f32| f64::from(value) / unit;
    let apart = (scaled(there.value) - f64::from(here.value)).abs() / f64::from(here.u95);
    let wider = scaled(there.u95) / f64::from(here.u95);
    assert!(apart < most && (wider - 1.0).abs() < APART, "{what}: {here:?} against {there:?}, a unit being {unit:e}");
}

#[test]
fn the_same_counts_and_codes_mean_the_same_whatever_their_units() {
    let structured = Inerter { structure_mass_kg: 5.0, ..Inerter::worn() };
    for (device, motion, duration_s) in
        [(Inerter::paper(), "random", 12.0), (Inerter::paper(), "slow", 45.0), (structured, "mid", 12.0)]
    {
        let sensors = Sensors { terminal_noise_m: 1e-6, ..bench_sensors() };
        let setup = Setup::new(device, sensors, motion, Some(duration_s), &Overrides::default()).unwrap();
        let samples: Vec<RawSample> = setup.samples().unwrap().map(|sample| raw(&sample)).collect();
        for sensor in [false, true] {
            let settings = Settings {
                terminal_sensor: sensor,
                structure_mass_u95_kg: 0.02,
                stiffness_u95_n_per_m: 2e4,
                ..setup.settings
            };
            let here = published(&samples, &settings, 1.0, 1.0);
            // The inertia of a servo and of a watch in kg m^2, and tonnes.
            for (metre, newton) in [(30.0, 2e-5), (300.0, 3e-7), (7e-3, 3.0)] {
                let there = published(&samples, &settings, metre, newton);
                let what = format!("{motion}, a metre being {metre}, a newton {newton}");
                let [a, b] = [&here, &there].map(|published| published.estimate.whole_run);
                let pairs = |found: inerter_core::Parameters| {
                    [found.inertance_kg, found.viscous_n_s_per_m, found.coulomb_n, found.offset_n]
                };
                let mass = newton / metre;
                let units = [mass, mass, newton, newton];
                for ((a, b), unit) in pairs(a).into_iter().zip(pairs(b)).zip(units) {
                    let statuses = [&a, &b].map(Parameter::status);
                    assert_eq!(statuses[0], statuses[1], "{what}: {a:?} {b:?}");
                    alike(a.fitted(), b.fitted(), unit, APART, &what);
                }
                assert_eq!(here.estimate.bank, there.estimate.bank, "{what}");
                assert_eq!(here.law.status, there.law.status, "{what}");
                assert_eq!(here.detail.contact, there.detail.contact, "{what}");
                assert_eq!(here.detail.friction.regime, there.detail.friction.regime, "{what}");
                let [few, many] = {
                    let mut counted = [here, there].map(|published| published.detail.backlash.reversals);
                    counted.sort_unstable();
                    counted
                };
                assert!(100 * (many - few) <= many, "{what}: {few} and {many} reversals");
                let most = if few == many { APART } else { REVERSALS_APART };
                let sizes = [here, there].map(|published| published.detail.backlash.size);
                match sizes {
                    [BacklashSize::Ok(a), BacklashSize::Ok(b)]
                    | [BacklashSize::BelowU95(a), BacklashSize::BelowU95(b)] => alike(a, b, metre, most, &what),
                    [a, b] => assert_eq!(a, b, "{what}"),
                }
                for (a, b) in [
                    (here.detail.stiffness_n_per_m, there.detail.stiffness_n_per_m),
                    (here.detail.contact_damping_n_s_per_m, there.detail.contact_damping_n_s_per_m),
                ] {
                    assert_eq!(a.status(), b.status(), "{what}");
                    if a.known().is_some() {
                        alike(a.fitted(), b.fitted(), mass, APART, &what);
                    }
                }
            }
        }
    }
}
