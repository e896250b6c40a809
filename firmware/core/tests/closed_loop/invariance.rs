//! Results must not depend on units, on events before a reset, or on how a number is delivered.

use crate::rig::{Heard, calibrated, four, instruments, listen, listen_on, shaken};
use inerter_core::{Band, Bank, Contact, Interval, Parameter, Parameters, RawSample, Settings, Source, State};
use inerter_plant::{Inerter, Sensors};

/// All uncertainties stated, with the terminal sensor.
fn settings(device: &Inerter, sensors: &Sensors) -> Settings {
    Settings {
        terminal_sensor: true,
        stiffness_u95_n_per_m: 0.02 * device.stiffness_n_per_m,
        structure_mass_u95_kg: 0.1,
        memory_s: 4.0,
        ..calibrated(device, sensors)
    }
}

/// The same device if one metre is `length` units of length and one newton is `force` units of force.
fn in_units(settings: &Settings, length: f64, force: f64) -> Settings {
    let mass = force / length;
    Settings {
        metres_per_count: length * settings.metres_per_count,
        metres_per_terminal_code: length * settings.metres_per_terminal_code,
        stuck_displacement_m: length * settings.stuck_displacement_m,
        full_scale_velocity_m_per_s: length * settings.full_scale_velocity_m_per_s,
        full_scale_acceleration_m_per_s2: length * settings.full_scale_acceleration_m_per_s2,
        newtons_per_code: force * settings.newtons_per_code,
        structure_mass_kg: mass * settings.structure_mass_kg,
        structure_mass_u95_kg: mass * settings.structure_mass_u95_kg,
        stiffness_n_per_m: mass * settings.stiffness_n_per_m,
        stiffness_u95_n_per_m: mass * settings.stiffness_u95_n_per_m,
        contact_damping_n_s_per_m: mass * settings.contact_damping_n_s_per_m,
        ..*settings
    }
}

/// All final numbers of a run, each with its powers of length and force.
fn numbers(heard: &Heard) -> Vec<(String, f64, [i32; 2])> {
    const MASS: [i32; 2] = [-1, 1];
    const FORCE: [i32; 2] = [0, 1];
    const LENGTH: [i32; 2] = [1, 0];
    let mut all = Vec::new();
    let mut add = |name: &str, value: f32, units: [i32; 2]| all.push((name.to_owned(), f64::from(value), units));
    let units = [MASS, MASS, FORCE, FORCE];
    let last = &heard.last;
    let interval = |parameter: &Parameter| parameter.fitted();
    for (name, parameters) in [("recent", &last.estimate.recent), ("whole", &last.estimate.whole_run)] {
        for (i, parameter) in four(parameters).iter().enumerate() {
            let Interval { value, u95 } = interval(parameter);
            add(&format!("{name} {i}"), value, units[i]);
            add(&format!("{name} {i} u95"), u95, units[i]);
        }
    }
    add("residual", last.estimate.residual_rms_n, FORCE);
    for (name, parameter) in [("ks", &last.detail.stiffness_n_per_m), ("cs", &last.detail.contact_damping_n_s_per_m)] {
        add(name, interval(parameter).value, MASS);
        add(name, interval(parameter).u95, MASS);
    }
    if let Some(Interval { value, u95 }) = last.detail.backlash.known() {
        add("backlash", value, LENGTH);
        add("backlash u95", u95, LENGTH);
    }
    add("low", last.detail.band.low_hz, [0, 0]);
    add("high", last.detail.band.high_hz, [0, 0]);
    add("reversals", last.detail.friction.reversal_ratio.unwrap_or(0.0), [0, 0]);
    let misfit = last.law.misfit.unwrap();
    add("ratio", misfit.ratio, [0, 0]);
    add("limit", misfit.limit, [0, 0]);
    let budgets = heard.active.budgets(&heard.state);
    for source in Source::ALL {
        for (i, (recent, whole)) in budgets.recent.iter().zip(&budgets.whole_run).enumerate() {
            add(&format!("recent {i} {source:?}"), recent.given_u95(source), units[i]);
            add(&format!("whole {i} {source:?}"), whole.given_u95(source), units[i]);
        }
        for (name, budget, unit) in [
            ("eps", budgets.contact.backlash_m, LENGTH),
            ("ks", budgets.contact.stiffness_n_per_m, MASS),
            ("cs", budgets.contact.damping_n_s_per_m, MASS),
        ] {
            if let Some(budget) = budget {
                add(&format!("{name} {source:?}"), budget.given_u95(source), unit);
            }
        }
    }
    for (n, reversal) in heard.reversals.iter().enumerate().skip(heard.reversals.len() / 2).step_by(7) {
        add(&format!("reversal {n}"), reversal.value_m, LENGTH);
        add(&format!("reversal {n} error"), reversal.error_m, LENGTH);
    }
    all
}

#[track_caller]
fn scales(heard: &Heard, scaled: &Heard, length: f64, force: f64, part: f64) {
    let (before, after) = (numbers(heard), numbers(scaled));
    assert_eq!(before.len(), after.len());
    for ((name, before, [by_length, by_force]), (_, after, _)) in before.iter().zip(&after) {
        let wanted = before * length.powi(*by_length) * force.powi(*by_force);
        let near = (after - wanted).abs() <= part * wanted.abs() || after == &wanted;
        assert!(near, "{name}: {after} for {wanted}, {length} {force}");
    }
    let said = |heard: &Heard| {
        (heard.last.detail.contact, heard.last.detail.friction.regime, heard.last.law.status, heard.counters())
    };
    assert_eq!(said(heard), said(scaled));
    assert_eq!(heard.reversals.len(), scaled.reversals.len());
}

/// Other units of length and force, from a sixteenth to 16 times, change only the unit. Powers of two change no bit at
/// all.
#[test]
fn results_are_the_same_in_any_unit() {
    for (device, motion) in [
        (Inerter::worn(), "mid@8s;random@8s"),
        (Inerter::paper(), "random@12s"),
        (Inerter { structure_mass_kg: 0.0, ..Inerter::paper() }, "slow@40s"),
    ] {
        let sensors = instruments(7);
        let plain = settings(&device, &sensors);
        let samples = shaken(&device, motion, 60.0, &sensors);
        let heard = listen(&plain, &samples);
        for (length, force) in [(2.0, 1.0), (0.5, 1.0), (1.0, 4.0), (1.0, 0.25), (0.125, 0.5), (2.0, 16.0)] {
            let scaled = listen(&in_units(&plain, length, force), &samples);
            scales(&heard, &scaled, length, force, 0.0);
        }
        // Regressors are rounded differently.
        for (length, force) in [(1.0, 3.0), (0.7, 1.0), (1.3, 0.9)] {
            let scaled = listen(&in_units(&plain, length, force), &samples);
            for (i, (a, b)) in
                four(&heard.last.estimate.whole_run).into_iter().zip(four(&scaled.last.estimate.whole_run)).enumerate()
            {
                let unit = if i < 2 { force / length } else { force };
                let (a, b) = (a.fitted(), b.fitted());
                let apart = f64::from(b.value) - unit * f64::from(a.value);
                assert!(apart.abs() < 0.02 * f64::from(b.u95), "{i}: {a:?} {b:?}");
                assert!((f64::from(b.u95 / a.u95) / unit - 1.0).abs() < 0.01, "{i}: {a:?} {b:?}");
            }
        }
    }
}

/// The sum of several readings of one count gives the same result as that count.
#[test]
fn readings_that_agree_are_one() {
    let device = Inerter::paper();
    let sensors = instruments(3);
    let plain = Settings { terminal_sensor: false, ..settings(&device, &sensors) };
    let samples = shaken(&device, "random", 12.0, &sensors);
    let one = listen(&plain, &samples);
    let many = samples.iter().map(|sample| RawSample { position_count: 4 * sample.position_count, ..*sample });
    let many: Vec<RawSample> = many.collect();
    let four_times = listen(&Settings { oversampling: 4.0, ..plain }, &many);
    // The share attributed to the steps differs, and the value by half of it.
    for (one, many) in four(&one.last.estimate.whole_run).into_iter().zip(four(&four_times.last.estimate.whole_run)) {
        let (one, many) = (one.fitted(), many.fitted());
        assert!((one.value - many.value).abs() < 0.2 * one.u95, "{one:?} {many:?}");
    }
    assert_eq!(one.last.estimate.updates, four_times.last.estimate.updates);
    assert!((one.last.estimate.residual_rms_n / four_times.last.estimate.residual_rms_n - 1.0).abs() < 1e-3);
    let counts = |heard: &Heard| heard.reversals.len();
    assert!(counts(&one) > 100 && counts(&one) == counts(&four_times), "{} {}", counts(&one), counts(&four_times));
    for (one, many) in one.reversals.iter().zip(&four_times.reversals) {
        assert_eq!((one.index, one.rising), (many.index, many.rising));
        assert!((one.value_m - many.value_m).abs() < 0.02 * sensors.metres_per_count as f32, "{one:?} {many:?}");
    }
}

/// After a reset, everything equals a new state bit for bit, whatever came before.
#[test]
fn a_state_that_was_reset_is_a_fresh_one() {
    let device = Inerter { backlash_m: 50e-6, ..Inerter::paper() };
    let sensors = instruments(5);
    let samples = shaken(&device, "random@6s;hold@1s;mid@3s;slow@20s", 60.0, &sensors);
    // First everything that leaves a trace, including a change and a warning; its length selects where it ends.
    let heavier = Inerter { inertance_kg: 400.0, backlash_m: 0.0, ..device };
    let mut before = shaken(&device, "random", 8.5, &sensors);
    before.extend(
        shaken(&heavier, "random", 8.613, &sensors)
            .into_iter()
            .map(|sample| RawSample { index: sample.index.wrapping_add(90_000), ..sample }),
    );
    for (n, sample) in before.iter_mut().enumerate() {
        if n > 15_000 {
            sample.force_code = if n % 1000 < 30 { i32::MAX } else { sample.force_code };
            sample.position_count += (n / 900 * 333) as i32;
        }
    }
    let plain = settings(&device, &sensors);
    for skew_s in [0.0, 0.003, -0.0023] {
        for length in [before.len(), before.len() - 17, 9000, 300] {
            let settings = Settings { skew_s, ..plain };
            let used = listen(&settings, &before[..length]);
            let Heard { active, mut state, .. } = used;
            state.reset(&active);
            assert_eq!(state.counters(), State::new(&active).counters());
            let again = listen_on(active, state, &samples);
            let fresh = listen(&settings, &samples);
            assert_eq!(again.published, fresh.published);
            assert_eq!(again.reversals, fresh.reversals);
            assert_eq!((again.warnings, again.changes), (fresh.warnings, fresh.changes));
            assert_eq!(again.last, fresh.last);
            assert_eq!(again.state.counters(), fresh.state.counters());
            assert_eq!(again.active.budgets(&again.state), fresh.active.budgets(&fresh.state));
            assert_eq!(again.active.motion(&again.state), fresh.active.motion(&fresh.state));
            for bank in [Bank::Fast, Bank::Slow] {
                assert_eq!(again.active.sums(&again.state, bank), fresh.active.sums(&fresh.state, bank));
                assert_eq!(again.active.more_sums(&again.state, bank), fresh.active.more_sums(&fresh.state, bank));
            }
        }
    }
    // An empty state can be used after a reset.
    let active = plain.validate().unwrap();
    let mut empty = Box::new(State::empty());
    empty.reset(&active);
    assert_eq!(listen_on(active, empty, &samples).published, listen(&plain, &samples).published);
}

/// A state that is reset before its first sample has no result.
#[test]
fn a_fresh_state_says_nothing() {
    let active = Settings::default().validate().unwrap();
    let state = Box::new(State::new(&active));
    let published = active.publish(&state);
    assert_eq!(published.estimate.recent, Parameters::default());
    assert_eq!(published.estimate.whole_run, Parameters::default());
    assert_eq!((published.estimate.moving, published.estimate.updates), (false, 0));
    assert_eq!((published.detail.contact, published.detail.band), (Contact::Unknown, Band::default()));
    assert_eq!(published.law, inerter_core::Law::default());
    assert_eq!(state.repeats(), 1.0);
    assert_eq!(active.sums(&state, Bank::Slow).sums, [0; 15]);
}
