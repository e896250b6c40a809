//! Every accepted input is simulated without NaN, without a stall, and without forcing the time forward.

use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use proptest::prelude::*;

/// Log-uniform between two values, or zero.
fn decades(low: f64, high: f64) -> impl Strategy<Value = f64> {
    prop_oneof![4 => (low.ln()..high.ln()).prop_map(f64::exp), 1 => Just(0.0)]
}

fn device() -> impl Strategy<Value = Inerter> {
    (
        (-2.0f64..5.0),
        decades(1e-2, 1e5),
        decades(1e-2, 1e4),
        (2.0f64..10.0),
        decades(1e-2, 1e6),
        decades(1e-6, 1e-2),
        decades(1e-2, 1e2),
        (-1.0f64..1.0, -1.0f64..1.0, decades(1e-6, 1e-3), any::<bool>(), -100.0f64..100.0, any::<u8>()),
        (1.0f64..2.0, 1e-4f64..0.1),
    )
        .prop_map(|(inertance, viscous, coulomb, stiffness, damping, backlash, structure, more, stribeck)| {
            // Each of the rarer features occurs in a quarter of the cases.
            let (fc_asymmetry, cf_asymmetry, presliding, unilateral, weight, chosen) = more;
            let given = |bits: u8, value: f64| if chosen >> (2 * bits) & 3 == 0 { value } else { 0.0 };
            Inerter {
                inertance_kg: 10f64.powf(inertance),
                viscous_n_s_per_m: viscous,
                coulomb_n: coulomb,
                stiffness_n_per_m: 10f64.powf(stiffness),
                contact_damping_n_s_per_m: damping,
                backlash_m: backlash,
                structure_mass_kg: structure,
                coulomb_asymmetry: given(0, fc_asymmetry),
                viscous_asymmetry: given(0, cf_asymmetry),
                presliding_m: given(1, presliding),
                stribeck_ratio: 1.0 + given(2, stribeck.0 - 1.0),
                stribeck_velocity_m_per_s: stribeck.1,
                unilateral: f64::from(u8::from(unilateral)),
                constant_force_n: given(3, weight),
            }
        })
        .prop_filter("slow enough to be followed", |device| device.validate().is_ok())
}

fn motion() -> impl Strategy<Value = Excitation> {
    let frequency = || (-1.0f64..2.0).prop_map(|f| 10f64.powf(f));
    prop_oneof![
        (frequency(), decades(1e-6, 1e-1)).prop_map(|(f, a)| Excitation::sine(f, a)),
        any::<u64>().prop_map(|seed| Excitation::random(0.5, 15.0, 20e-3, seed)),
        any::<u64>().prop_map(|seed| Excitation::multisine(0.5, 30.0, 20e-3, seed)),
        frequency().prop_map(|f| Excitation::chirp(f, 2.0 * f, 5e-3, 0.1)),
        (frequency(), 0.02f64..0.2, 2e-3f64..0.1).prop_map(|(f, t, ramp)| Excitation::sequence([
            Excitation::sine(f, 1e-3).lasting(t),
            Excitation::hold().lasting(0.05),
            Excitation::sine(2.0 * f, 1e-3),
        ])
        .with_ramp(ramp)),
        Just(Excitation::hold()),
    ]
}

fn cases() -> ProptestConfig {
    let cases = std::env::var("INERTER_PLANT_CASES").ok().and_then(|text| text.parse().ok()).unwrap_or(300);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(cases())]
    #[test]
    fn every_valid_device_runs(device in device(), motion in motion(), oversampling in 1u8..4, delay_s in -5e-3f64..5e-3) {
        let sensors = Sensors { oversampling: f64::from(oversampling), delay_s, force_noise_n: 1.0, ..Sensors::default() };
        let mut simulation = Simulation::new(device, motion, sensors).unwrap();
        for sample in simulation.by_ref().take(300) {
            let t = sample.truth;
            let sum = t.x1_m + t.v1_m_per_s + t.a1_m_per_s2 + t.x2_m + t.v2_m_per_s + t.a2_m_per_s2 + t.force_n;
            prop_assert!(sum.is_finite(), "{t:?}");
        }
        prop_assert_eq!(simulation.plant().forced_steps(), 0);
    }
}
