//! Disturbances of a measurement: discontinuities, saturation, wrapping counters, mirrored wiring, any rate, any bytes.

use crate::rig::{self, four, is_sane};
use inerter_core::{
    Counters, Estimate, Law, LawStatus, Parameter, Published, RawSample, Settings, State, Status, Warning, WarningKind,
};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use proptest::prelude::*;

fn sensors() -> Sensors {
    Sensors { force_noise_n: 1.0, force_offset_n: 5.0, encoder_phase_count: 0.3, seed: 11, ..Sensors::default() }
}

fn samples(sensors: Sensors, motion: &str) -> Vec<RawSample> {
    let excitation = Excitation::parse(motion, 11).unwrap();
    let duration_s = excitation.duration_s();
    Simulation::new(Inerter::paper(), excitation, sensors).unwrap().lasting(duration_s).map(|s| rig::raw(&s)).collect()
}

fn settings(sensors: &Sensors) -> Settings {
    rig::calibrated(&Inerter::paper(), sensors)
}

struct Outcome {
    published: Vec<Estimate>,
    warnings: Vec<Warning>,
    last: Estimate,
    law: Law,
    counters: Counters,
}

fn run(settings: &Settings, samples: &[RawSample]) -> Outcome {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let (mut published, mut warnings) = (Vec::new(), Vec::new());
    for sample in samples {
        let output = active.step(&mut state, sample);
        published.extend(output.estimate());
        warnings.extend(output.warning);
    }
    published.iter().for_each(is_sane);
    let Published { estimate: last, law, .. } = active.publish(&state);
    is_sane(&last);
    Outcome { published, warnings, last, law, counters: state.counters() }
}

/// The whole run's inertance has a value, and its error is within its interval and within `part` of the true value.
#[track_caller]
fn finds_inertance(outcome: &Outcome, part: f64) {
    let found = outcome.last.whole_run.inertance_kg;
    let truth = Inerter::paper().inertance_kg;
    let off = (f64::from(found.fitted().value) - truth).abs();
    assert_eq!(found.status(), Status::Ok);
    assert!(off <= f64::from(found.u95()), "{} kg, off by {off}, with {found:?}", found.fitted().value);
    assert!(off < part * truth, "off by {off} kg");
    // Calibration alone contributes half a percent.
    assert!((0.004..0.1).contains(&(f64::from(found.u95()) / truth)), "{found:?}");
}

#[test]
fn one_percent_of_the_samples_lost() {
    let lossy = Sensors { lost_probability: 0.01, ..sensors() };
    let samples = samples(lossy, "random@20s");
    let outcome = run(&settings(&lossy), &samples);
    finds_inertance(&outcome, 1e-3);
    let Counters { samples: taken, discontinuities, lost_samples, .. } = outcome.counters;
    let span = samples.last().unwrap().index - samples[0].index + 1;
    assert_eq!(taken + lost_samples, u64::from(span));
    assert_eq!(taken, samples.len() as u64);
    assert!((100..=lost_samples).contains(&u64::from(discontinuities)), "{discontinuities} discontinuities");
    let whole = run(&settings(&lossy), &self::samples(sensors(), "random@20s"));
    assert!((0.2..0.8).contains(&(f64::from(outcome.last.updates) / f64::from(whole.last.updates))));
}

/// With a correction to second order only, a force 5 ms late left an error of 2.3 kg at 15.9 Hz.
#[test]
fn a_stated_skew_of_any_size_is_undone() {
    for (sample_rate_hz, motion) in
        [(1000.0, "random@10s"), (1000.0, "fast@10s"), (4000.0, "random@10s"), (4000.0, "fast@10s")]
    {
        let of = |delay_s: f64| {
            let sensors = Sensors { delay_s, sample_rate_hz, force_noise_n: 1.0, ..Sensors::default() };
            run(&settings(&sensors), &samples(sensors, motion))
        };
        let none = of(0.0).last.whole_run;
        for delay_s in [-5e-3, -2.3e-3, -0.4e-3, 0.6e-3, 1e-3, 3.2e-3, 5e-3] {
            let found = of(delay_s);
            assert_eq!(found.law.status, LawStatus::Holds, "{delay_s} s, {motion}: {:?}", found.law);
            let moved = found.last.whole_run.inertance_kg.fitted().value - none.inertance_kg.fitted().value;
            assert!(moved.abs() < 0.05, "{delay_s} s, {motion}: {moved} kg");
            let [with, without] = [found.last.whole_run, none].map(|all| all.viscous_n_s_per_m.fitted());
            let moved = with.value - without.value;
            assert!(moved.abs() < with.u95.hypot(without.u95), "{delay_s} s, {motion}: {moved} N s/m");
        }
    }
}

#[test]
fn a_discontinuity_is_counted_and_never_bridged() {
    let mut samples = samples(sensors(), "random@20s");
    samples.drain(7000..7500);
    // Meanwhile the encoder lost its position.
    for sample in &mut samples[7000..] {
        sample.position_count = sample.position_count.wrapping_add(1_000_000);
    }
    let outcome = run(&settings(&sensors()), &samples);
    finds_inertance(&outcome, 1e-3);
    assert_eq!((outcome.counters.discontinuities, outcome.counters.lost_samples), (1, 500));
    // The same jump without a missing sample is a slip: it is reported, and not bridged either.
    for (n, sample) in samples.iter_mut().enumerate() {
        sample.index = n as u32;
    }
    let bridged = run(&settings(&sensors()), &samples);
    assert_eq!(bridged.counters.discontinuities, 0);
    finds_inertance(&bridged, 1e-3);
    assert_eq!(bridged.warnings, [Warning { index: 7000, kind: WarningKind::CountSlip }]);
}

#[test]
fn an_index_that_goes_back_is_a_restart() {
    let mut samples = samples(sensors(), "random@20s");
    for (n, sample) in samples[9000..].iter_mut().enumerate() {
        sample.index = n as u32;
    }
    let outcome = run(&settings(&sensors()), &samples);
    finds_inertance(&outcome, 1e-3);
    assert_eq!((outcome.counters.discontinuities, outcome.counters.lost_samples), (1, 0));
    assert_eq!(outcome.counters.samples, 20_000);
}

#[test]
fn a_sample_twice_is_a_discontinuity_too() {
    let mut samples = samples(sensors(), "random@20s");
    samples.insert(9000, samples[8999]);
    let outcome = run(&settings(&sensors()), &samples);
    finds_inertance(&outcome, 1e-3);
    assert_eq!((outcome.counters.discontinuities, outcome.counters.lost_samples), (2 - 1, 0));
}

#[test]
fn saturated_peaks_are_left_out() {
    // 400 N in each direction, where the motions need 600 N.
    let limit = 200_000.0;
    let narrow = Sensors { force_min_code: -limit, force_max_code: limit, ..sensors() };
    let samples = samples(narrow, "mid@20s;random@20s");
    let outcome = run(&settings(&narrow), &samples);
    finds_inertance(&outcome, 2e-3);
    let at_limit = samples.iter().filter(|sample| sample.force_code.abs() >= 200_000).count();
    assert!(at_limit > 2000 && outcome.counters.saturated >= at_limit as u32, "{at_limit} {:?}", outcome.counters);
    // If the settings do not state the limits, the estimator finds them.
    let ignorant = run(&settings(&sensors()), &samples);
    finds_inertance(&ignorant, 2e-3);
    assert!(
        ignorant.warnings.iter().all(|warning| warning.kind == WarningKind::ClippedForce),
        "{:?}",
        ignorant.warnings
    );
    assert!(!ignorant.warnings.is_empty());
}

#[test]
fn force_at_its_limits_all_the_time_teaches_nothing() {
    for code in [i32::MIN, -8_388_608, 8_388_607, i32::MAX] {
        let mut samples = samples(sensors(), "random@5s");
        for sample in &mut samples {
            sample.force_code = code;
        }
        let outcome = run(&settings(&sensors()), &samples);
        assert_eq!(outcome.counters.saturated, 5000);
        assert_eq!(outcome.last.updates, 0);
        assert!(four(&outcome.last.whole_run).iter().all(|p| p.status() == Status::NotIdentifiable));
    }
}

/// The estimates, without their index.
fn bits(outcome: &Outcome) -> Vec<Estimate> {
    outcome.published.iter().map(|estimate| Estimate { index: 0, ..*estimate }).collect()
}

#[test]
fn counters_that_wrap_change_not_a_bit() {
    let samples = samples(sensors(), "slow@20s;random@20s");
    let plain = run(&settings(&sensors()), &samples);
    assert!(plain.last.recent.inertance_kg.status() == Status::Ok && plain.published.len() == 200);
    for offset in [i32::MAX - 300, i32::MIN + 1, 1 << 30] {
        let wrapped: Vec<RawSample> = samples
            .iter()
            .map(|sample| RawSample {
                index: sample.index.wrapping_sub(5000),
                position_count: sample.position_count.wrapping_add(offset),
                ..*sample
            })
            .collect();
        let found = run(&settings(&sensors()), &wrapped);
        assert_eq!(bits(&found), bits(&plain));
        assert_eq!(found.counters, plain.counters);
    }
}

#[test]
fn a_tare_changes_not_a_bit() {
    let samples = samples(sensors(), "random@10s");
    let plain = run(&settings(&sensors()), &samples);
    let tared: Vec<RawSample> =
        samples.iter().map(|sample| RawSample { force_code: sample.force_code + 12_345, ..*sample }).collect();
    let limits = Settings { force_min_code: -8_000_000.0, force_max_code: 8_000_000.0, ..settings(&sensors()) };
    let found = run(
        &Settings { force_zero_code: 12_345.0, force_min_code: -7_987_655.0, force_max_code: 8_012_345.0, ..limits },
        &tared,
    );
    assert_eq!(bits(&found), bits(&plain));
}

#[test]
fn turned_wiring_is_turned_back_to_the_bit() {
    let samples = samples(sensors(), "slow@20s;random@20s");
    let right = settings(&sensors());
    let plain = run(&right, &samples);
    let mirrored = |position: i32, force: i32| -> Vec<RawSample> {
        let turn = |sample: &RawSample| RawSample {
            position_count: sample.position_count * position,
            force_code: sample.force_code * force,
            ..*sample
        };
        samples.iter().map(turn).collect()
    };
    let encoder = Settings { metres_per_count: -right.metres_per_count, ..right };
    assert_eq!(bits(&run(&encoder, &mirrored(-1, 1))), bits(&plain));
    let force = Settings { newtons_per_code: -right.newtons_per_code, ..right };
    assert_eq!(bits(&run(&force, &mirrored(1, -1))), bits(&plain));
}

#[test]
fn the_other_direction_gives_the_same_device_with_the_offset_turned() {
    let samples = samples(sensors(), "random@20s");
    let right = settings(&sensors());
    let plain = run(&right, &samples).last.whole_run;
    let other =
        Settings { metres_per_count: -right.metres_per_count, newtons_per_code: -right.newtons_per_code, ..right };
    let turned = run(&other, &samples).last.whole_run;
    let difference = |a: Parameter, b: Parameter, sign: f32| (a.fitted().value - sign * b.fitted().value).abs();
    assert!(difference(turned.inertance_kg, plain.inertance_kg, 1.0) < 1e-3);
    assert!(difference(turned.viscous_n_s_per_m, plain.viscous_n_s_per_m, 1.0) < 1e-2);
    assert!(difference(turned.coulomb_n, plain.coulomb_n, 1.0) < 2e-3);
    assert!(difference(turned.offset_n, plain.offset_n, -1.0) < 2e-3);
    assert!((plain.offset_n.fitted().value - 5.0).abs() < 0.5);
}

#[test]
fn only_one_channel_turned_shows() {
    let samples = samples(sensors(), "random@20s");
    let right = settings(&sensors());
    let wrong = Settings { structure_mass_kg: 0.0, newtons_per_code: -right.newtons_per_code, ..right };
    let found = run(&wrong, &samples).last.whole_run;
    assert!(
        (found.inertance_kg.fitted().value + 301.0).abs() < 2.0 && found.coulomb_n.fitted().value < -45.0,
        "{found:?}"
    );
}

#[test]
fn oversampling_16_at_4_khz() {
    let over = Sensors { sample_rate_hz: 4000.0, oversampling: 16.0, ..sensors() };
    let outcome = run(&settings(&over), &samples(over, "mid@10s"));
    finds_inertance(&outcome, 2e-4);
    let plain = Sensors { sample_rate_hz: 4000.0, ..sensors() };
    let coarse = run(&settings(&plain), &samples(plain, "mid@10s"));
    finds_inertance(&coarse, 2e-4);
}

#[test]
fn every_rate_from_50_hz_to_5_khz() {
    for rate in [50.0, 75.0, 100.0, 250.0, 333.0, 500.0, 1000.0, 1999.5, 4000.0, 5000.0] {
        let rated = Sensors { sample_rate_hz: rate, ..sensors() };
        let outcome = run(&settings(&rated), &samples(rated, "mid@20s"));
        let found = outcome.last.whole_run.inertance_kg;
        let off = (f64::from(found.fitted().value) / Inerter::paper().inertance_kg - 1.0).abs();
        assert!(found.status() == Status::Ok && off < 0.005, "{rate} Hz: off by {:.3} %, {found:?}", off * 100.0);
        assert!(outcome.published.len() as f64 > 20.0 * 5.0 - 5.0 && outcome.published.len() <= 110, "{rate} Hz");
    }
}

/// A value that is valid for the setting by itself, including the ends of its range.
fn any_setting(number: usize) -> impl Strategy<Value = f64> {
    let info = Settings::TABLE[number];
    let whole = info.kind == inerter_core::Kind::Whole;
    let (min, max, default) = (info.min, info.max, info.default);
    let end = move |value: f64| if value == 0.0 && info.kind == inerter_core::Kind::NonZero { max } else { value };
    prop_oneof![
        4 => Just(default),
        1 => Just(end(min)),
        1 => Just(end(max)),
        2 => (0.0..1.0_f64).prop_map(move |part| {
            let value = min + part * (max - min);
            end(if whole { value.round() } else { value })
        }),
        1 => (-12.0..0.0_f64).prop_map(move |exponent| {
            let value = max * 10_f64.powf(exponent);
            end(if whole { value.round().clamp(min, max) } else { value.clamp(min, max) })
        }),
    ]
}

/// Valid settings; a setting that contradicts the others returns to its default.
fn any_settings() -> impl Strategy<Value = Settings> {
    (0..Settings::COUNT).map(any_setting).collect::<Vec<_>>().prop_map(|values| {
        let mut settings = Settings::default();
        for (number, value) in values.into_iter().enumerate() {
            let before = settings;
            if settings.set(number, value).and_then(|()| settings.validate()).is_err() {
                settings = before;
            }
        }
        settings
    })
}

/// Sixteen arbitrary bytes, or a step from the previous sample.
fn any_samples(most: usize) -> impl Strategy<Value = Vec<RawSample>> {
    let step = prop_oneof![
        6 => (Just(1_u32), -40..40_i32, -3000..3000_i32),
        1 => any::<(u32, i32, i32)>(),
        1 => (0..3_u32, Just(0), Just(0)),
        1 => (Just(1_u32), any::<i32>(), -3000..3000_i32),
    ];
    prop::collection::vec((step, 1..200_u32), 1..most).prop_map(|steps| {
        let mut sample = RawSample::default();
        let mut samples = Vec::new();
        for ((index, position, force), times) in steps {
            for _ in 0..times {
                sample.index = sample.index.wrapping_add(index);
                sample.position_count = sample.position_count.wrapping_add(position);
                sample.force_code = sample.force_code.wrapping_add(force);
                samples.push(sample);
            }
        }
        samples
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_samples_under_no_settings_panic_or_give_what_is_no_number(settings in any_settings(), samples in any_samples(60)) {
        let active = settings.validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for sample in &samples {
            active.step(&mut state, sample).estimate().iter().for_each(is_sane);
        }
        is_sane(&active.publish(&state).estimate);
        prop_assert_eq!(state.counters().samples, samples.len() as u64);
        // The state can be used again.
        state.reset(&active);
        let mut fresh = Box::new(State::new(&active));
        for sample in &samples {
            prop_assert_eq!(active.step(&mut state, sample), active.step(&mut fresh, sample));
        }
    }

    #[test]
    fn no_bytes_panic(bytes in prop::collection::vec(any::<[u8; 16]>(), 1..2000)) {
        let active = Settings::default().validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for bytes in bytes {
            let word = |place: usize| i32::from_le_bytes(std::array::from_fn(|i| bytes[4 * place + i]));
            let sample = RawSample {
                index: word(0) as u32, position_count: word(1), force_code: word(2), terminal_code: word(3),
            };
            active.step(&mut state, &sample).estimate().iter().for_each(is_sane);
        }
        is_sane(&active.publish(&state).estimate);
    }
}

#[test]
fn a_structure_without_a_stiffness_widens_the_interval() {
    let truth = Inerter::paper().inertance_kg;
    let exact = Settings { force_gain_u95: 0.0, lead_u95: 0.0, timebase_u95: 0.0, ..settings(&sensors()) };
    let without = Settings { stiffness_n_per_m: 0.0, ..exact };
    for (motion, least_kg) in [("random@10s", 1.0), ("mid@10s", 0.0), ("fast@10s", 1.8)] {
        let samples = samples(sensors(), motion);
        let found = run(&without, &samples).last.whole_run.inertance_kg;
        let off = (f64::from(found.fitted().value) - truth).abs();
        assert_eq!(found.status(), Status::Ok, "{motion}");
        assert!((least_kg..=f64::from(found.u95())).contains(&off), "{motion}: {off} beyond {}", found.u95());
        let known = run(&exact, &samples).last.whole_run.inertance_kg;
        assert!(known.u95() < 0.2 * found.u95(), "{motion}: {known:?}");
        // Friction absorbs a share of the structure's motion, and still has a value.
        let Estimate { whole_run, .. } = run(&without, &samples).last;
        let Inerter { viscous_n_s_per_m, coulomb_n, .. } = Inerter::paper();
        for (found, truth) in [(whole_run.viscous_n_s_per_m, viscous_n_s_per_m), (whole_run.coulomb_n, coulomb_n)] {
            let found = found.known().unwrap();
            assert!((f64::from(found.value) - truth).abs() < f64::from(found.u95), "{motion}: {found:?}");
        }
        assert!(whole_run.coulomb_n.u95() < 10.0, "{motion}: {whole_run:?}");
    }
}

/// With a stiffness stated to 20 %, its effect on the residual does not break the law, and its effect on friction is
/// within the interval.
#[test]
fn a_stiffness_as_wrong_as_it_is_stated_breaks_no_law_and_is_in_the_friction() {
    let sensors = Sensors { force_noise_n: 0.3, metres_per_count: 0.5e-6, ..sensors() };
    let stated = settings(&sensors);
    for part in [-0.18, 0.18] {
        let wrong = Settings {
            stiffness_n_per_m: (1.0 + part) * stated.stiffness_n_per_m,
            stiffness_u95_n_per_m: 0.2 * stated.stiffness_n_per_m,
            ..stated
        };
        for motion in ["random@20s", "fast@20s"] {
            let samples = samples(sensors, motion);
            let Outcome { last, law, .. } = run(&wrong, &samples);
            assert_eq!(law.status, LawStatus::Holds, "{motion} {part}: {law:?}");
            let Inerter { viscous_n_s_per_m, coulomb_n, .. } = Inerter::paper();
            let friction =
                [(last.whole_run.viscous_n_s_per_m, viscous_n_s_per_m), (last.whole_run.coulomb_n, coulomb_n)];
            for (found, truth) in friction {
                let found = found.known().unwrap();
                assert!((f64::from(found.value) - truth).abs() < f64::from(found.u95), "{motion} {part}: {found:?}");
            }
        }
    }
}

/// Instruments without any uncertainty of their own.
fn perfect() -> Settings {
    Settings {
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        skew_u95_s: 0.0,
        structure_mass_kg: 0.0,
        structure_mass_u95_kg: 0.0,
        ..settings(&sensors())
    }
}

/// Counts and codes with an exact dependence, unlike those of any instrument.
fn exact(amplitude: f64, frequency_hz: f64, force: impl Fn(i32, i32, i32) -> i32) -> Vec<RawSample> {
    let position = |n: i32| {
        let t_s = f64::from(n) * 1e-3;
        let tone = |frequency_hz: f64| (t_s * frequency_hz * std::f64::consts::TAU).sin();
        (amplitude * (tone(frequency_hz) + 0.3 * tone(2.7 * frequency_hz + 0.1))).round() as i32
    };
    (0..20_000)
        .map(|n| {
            let [before, here, after] = [position(n - 1), position(n), position(n + 1)];
            RawSample {
                index: n as u32,
                position_count: here,
                force_code: force(here, after - before, after - 2 * here + before),
                ..RawSample::default()
            }
        })
        .collect()
}

#[test]
fn an_exact_fit_has_an_interval_that_holds_the_mirrored_fit() {
    let settings = perfect();
    for (amplitude, frequency_hz) in [(3e3, 3.2), (3e5, 3.2), (3e4, 0.5), (2e3, 15.9)] {
        for (what, force) in [
            ("nothing", (|_, _, _| 0) as fn(i32, i32, i32) -> i32),
            ("one code", |_, _, _| 1),
            ("a weight", |_, _, _| -30_001),
            ("inertia", |_, _, bend| 7 * bend),
            ("inertia under a weight", |_, _, bend| 7 * bend + 1001),
            ("viscous friction", |_, slope, _| 3 * slope),
            ("dry friction", |_, slope, _| 1000 * slope.signum()),
        ] {
            let samples = exact(amplitude, frequency_hz, force);
            let turn = |sample: &RawSample| RawSample {
                position_count: -sample.position_count,
                force_code: -sample.force_code,
                ..*sample
            };
            let turned: Vec<RawSample> = samples.iter().map(turn).collect();
            let [here, there] = [&samples, &turned].map(|samples| run(&settings, samples).last);
            for (here, there) in [(here.recent, there.recent), (here.whole_run, there.whole_run)] {
                for (i, sign) in [1.0, 1.0, 1.0, -1.0].into_iter().enumerate() {
                    let (here, there) = (four(&here)[i], four(&there)[i]);
                    assert_eq!(here.status(), there.status(), "{what} at {frequency_hz} Hz, {i}");
                    if here.status() == Status::Ok {
                        let difference = (here.fitted().value - sign * there.fitted().value).abs();
                        // This also excludes NaN.
                        assert!(difference < 1e-3 * here.u95(), "{what} at {frequency_hz} Hz, {i}: {here:?} {there:?}");
                    }
                }
                // A constant force determines its own value to within a code, and nothing of the device.
                if ["nothing", "one code", "a weight"].contains(&what) {
                    let [found @ .., offset] = four(&here);
                    assert!(found.iter().all(|found| found.status() == Status::NotIdentifiable), "{what}: {found:?}");
                    let code = settings.newtons_per_code.abs() as f32;
                    assert!(
                        offset.status() != Status::Ok || (0.5 * code..code).contains(&offset.u95()),
                        "{what}: {offset:?}"
                    );
                }
            }
        }
    }
}
