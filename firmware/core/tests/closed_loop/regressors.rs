//! The kernels' effect on an analytic motion: each regressor of either bank in SI units, its band, and the gate.

use crate::rig::is_near;
use crate::textbook::{Kernel, Rows};
use inerter_core::{Active, Bank, RawSample, Settings, State};
use std::f64::consts::TAU;

/// Amplitudes \[m\] and frequencies \[Hz\].
type Tones<'a> = &'a [(f64, f64)];

/// Displacement and its first three derivatives.
fn at(tones: Tones, t_s: f64) -> [f64; 4] {
    tones.iter().fold([0.0; 4], |sum, &(size, hz)| {
        let w = TAU * hz;
        let (sin, cos) = (w * t_s).sin_cos();
        let each = [sin, w * cos, -w * w * sin, -w * w * w * cos];
        std::array::from_fn(|i| sum[i] + size * each[i])
    })
}

/// Gain of four boxes of samples for a tone, with the second difference to which all other regressors are matched.
fn gain(kernel: &Kernel, hz: f64, rate_hz: f64) -> f64 {
    let (half, samples) = (TAU * hz / 2.0 / rate_hz, kernel.box_s * rate_hz);
    ((samples * half).sin() / samples / half.sin()).powi(4) * (half.sin() / half).powi(2)
}

/// The smallest number of updates that spans whole periods.
fn updates_in_whole_periods(kernel: &Kernel, hz: f64, rate_hz: f64) -> usize {
    let is_whole = |n: &usize| {
        let turns = *n as f64 * kernel.spacing / rate_hz * hz;
        (turns - turns.round()).abs() < 1e-6
    };
    (1..).find(is_whole).unwrap()
}

struct Seen {
    active: Active,
    state: Box<State>,
    rows: Vec<[f64; 7]>,
}

/// A force that is linear in displacement, velocity and acceleration, with an offset.
fn seen(settings: &Settings, bank: Bank, tones: Tones, duration_s: f64, force: [f64; 4]) -> Seen {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut rows = Rows::new(bank);
    let [k, c, m, offset] = force;
    for index in 0..(duration_s * settings.sample_rate_hz) as u32 {
        let t_s = f64::from(index) / settings.sample_rate_hz;
        let [x, v, a, _] = at(tones, t_s);
        let position = (0..settings.oversampling as u32).map(|_| (x / settings.metres_per_count).round()).sum::<f64>();
        let force = (k * x + c * v + m * a + offset) / settings.newtons_per_code + settings.force_zero_code;
        let sample =
            RawSample { index, position_count: position as i32, force_code: force.round() as i32, terminal_code: 0 };
        active.step(&mut state, &sample);
        rows.follow(&active, &state);
    }
    Seen { active, state, rows: rows.rows }
}

/// Mean product of two regressors.
fn mean(rows: &[[f64; 7]], a: usize, b: usize) -> f64 {
    rows.iter().map(|row| row[a] * row[b]).sum::<f64>() / rows.len() as f64
}

fn fine() -> Settings {
    Settings { metres_per_count: 1e-9, newtons_per_code: 1e-4, full_scale_velocity_m_per_s: 0.5, ..Settings::default() }
}

/// Means over whole periods of a tone, each with a known formula.
#[test]
fn regressors_of_a_tone_are_those_of_the_formula() {
    for (sample_rate_hz, oversampling) in [(1000.0, 1.0), (4000.0, 16.0), (500.0, 3.0), (100.0, 1.0)] {
        for (bank, hz) in [(Bank::Fast, 5.0), (Bank::Fast, 12.5), (Bank::Slow, 1.25), (Bank::Slow, 2.5)] {
            for (metres_per_count, newtons_per_code) in [(1e-9, 1e-4), (-2e-9, 3e-4), (3e-9, -1e-4)] {
                let settings = Settings { sample_rate_hz, oversampling, metres_per_count, newtons_per_code, ..fine() };
                let size = 1e-3;
                let (spring, damper, mass, offset) = (700.0, 300.0, 100.0, 20.0);
                let duration_s = 12.0;
                let seen = seen(&settings, bank, &[(size, hz)], duration_s, [spring, damper, mass, offset]);
                let kernel = Kernel::of(&settings, bank);
                let passed = gain(&kernel, hz, sample_rate_hz);
                let w = TAU * hz;
                let what = format!("{sample_rate_hz} Hz, {bank:?}, {hz} Hz, {metres_per_count} m");
                let every = kernel.spacing / sample_rate_hz;
                let period = updates_in_whole_periods(&kernel, hz, sample_rate_hz);
                let whole = seen.rows.len() / period * period;
                let rows = &seen.rows[seen.rows.len() - whole..];
                // Without noise, the mismatch of the gains breaks the law, once.
                assert!(seen.rows.len() as f64 > 0.4 * duration_s / every, "{what}: {}", seen.rows.len());
                let velocity = size * w * passed;
                let reactance = spring - mass * w * w;
                // The corrections leave (w T)^4 / 50 of the gain.
                let part = 3e-4 + (w / sample_rate_hz).powi(4) / 20.0;
                is_near(mean(rows, 0, 0), (velocity * w).powi(2) / 2.0, part, &format!("{what}: a a"));
                is_near(mean(rows, 1, 1), velocity.powi(2) / 2.0, part, &format!("{what}: v v"));
                is_near(mean(rows, 4, 1), damper * velocity.powi(2) / 2.0, 0.01 + part, &format!("{what}: F v"));
                is_near(mean(rows, 4, 0), -reactance * velocity.powi(2) / 2.0, part, &format!("{what}: F a"));
                let force = (damper.powi(2) + (reactance / w).powi(2)) * velocity.powi(2) / 2.0;
                is_near(mean(rows, 4, 4), force + offset * offset, part, &format!("{what}: F F"));
                is_near(mean(rows, 5, 5), force * w * w, part, &format!("{what}: F' F'"));
                is_near(mean(rows, 5, 0), damper * (velocity * w).powi(2) / 2.0, 0.01 + part, &format!("{what}: F' a"));
                is_near(mean(rows, 4, 3), offset, 1e-3, &format!("{what}: F"));
                assert!(rows.iter().all(|row| row[3] == 1.0), "{what}");
                // The fundamental of a sine's sign is 4 / pi of the sine, and the kernel removes the harmonics.
                is_near(
                    mean(rows, 2, 1),
                    4.0 / std::f64::consts::PI * velocity * passed / 2.0,
                    0.01 + (w / sample_rate_hz).powi(2) / 10.0,
                    &format!("{what}: s v"),
                );
                let sums = seen.active.sums(&seen.state, bank);
                assert_eq!((sums.bank, sums.index), (bank, seen.state.last_index()));
            }
        }
    }
}

/// A complex number.
type Phasor = [f64; 2];

fn times([a, b]: Phasor, [c, d]: Phasor) -> Phasor {
    [a * c - b * d, a * d + b * c]
}

fn plus([a, b]: Phasor, [c, d]: Phasor) -> Phasor {
    [a + c, b + d]
}

/// A load cell that carries a structure on a soft contact and is late. After correction, the force is that on the
/// screw, with the structure as if it moved with the screw.
#[test]
fn a_late_force_across_a_soft_contact_is_that_of_the_screw() {
    // Mass of the structure, its natural frequency on the contact, lag of the contact, skew. 0 Hz means that the
    // contact is unknown.
    for (structure_mass_kg, own_hz, lag_s, skew_s) in [
        (0.0, 0.0, 0.0, 0.0047),
        (0.0, 0.0, 0.0, -0.0012),
        (0.0, 0.0, 0.0, 0.00049),
        (30.0, 64.0, 0.0, 0.0),
        (30.0, 64.0, 0.0015, 0.0),
        (30.0, 64.0, 0.0015, 0.00045),
        (30.0, 70.0, 0.0, -0.00045),
    ] {
        for (sample_rate_hz, bank, hz) in
            [(1000.0, Bank::Fast, 12.5), (1000.0, Bank::Slow, 2.5), (100.0, Bank::Fast, 6.25)]
        {
            let w = TAU * hz;
            let (mass, damper, size) = (250.0, 900.0, 3e-4);
            let stiffness_n_per_m = structure_mass_kg * (TAU * own_hz).powi(2);
            let screw = [-mass * w * w, damper * w];
            let bent = if stiffness_n_per_m > 0.0 {
                // F / (ks + cs s)
                let down = 1.0 + (lag_s * w).powi(2);
                times(screw, [1.0 / down / stiffness_n_per_m, -lag_s * w / down / stiffness_n_per_m])
            } else {
                [0.0; 2]
            };
            let terminal = plus([1.0, 0.0], bent);
            let cell = plus(screw, terminal.map(|part| -structure_mass_kg * w * w * part));
            let (sin, cos) = (w * skew_s).sin_cos();
            let [spring, late] = times(cell, [cos, -sin]);
            let settings = Settings {
                sample_rate_hz,
                skew_s,
                structure_mass_kg,
                stiffness_n_per_m,
                contact_damping_n_s_per_m: lag_s * stiffness_n_per_m,
                ..fine()
            };
            let seen = seen(&settings, bank, &[(size, hz)], 12.0, [spring, late / w, 0.0, 0.0]);
            let kernel = Kernel::of(&settings, bank);
            let passed = size * gain(&kernel, hz, sample_rate_hz);
            let period = updates_in_whole_periods(&kernel, hz, sample_rate_hz);
            let whole = seen.rows.len() / period * period;
            let rows = &seen.rows[seen.rows.len() - whole..];
            let [wanted, against] = [screw[0] - structure_mass_kg * w * w, screw[1]];
            let what = format!(
                "{structure_mass_kg} kg, {own_hz} Hz, {lag_s} s, late by {skew_s} s, {hz} at {sample_rate_hz} Hz"
            );
            // The real part corresponds to the acceleration, the imaginary part to the velocity; for the rate of the
            // force it is the other way round.
            let product = |i: usize, k: usize, power: i32| 2.0 * mean(rows, i, k) / (passed * passed * w.powi(power));
            let found = [-product(4, 0, 2), product(4, 1, 1), product(5, 1, 2), product(5, 0, 3)];
            // The series of the force ends with the fourth derivative, the series of its rate with the second.
            let (rest, size) = (w * settings.skew_parts().1.abs(), wanted.hypot(against));
            let own = (hz / own_hz.max(60.0)).powi(2);
            let part = 2e-4 + (w / sample_rate_hz).powi(4) / 45.0;
            let parts = [
                part + rest.powi(5) / 100.0 + 0.3 * own * own,
                part + rest.powi(3) / 3.0 + 2.0 * own * (rest + lag_s * w) + 0.2 * own,
            ];
            for (i, (found, wanted)) in found.into_iter().zip([wanted, against, wanted, against]).enumerate() {
                let part = parts[i / 2];
                assert!((found - wanted).abs() < part * size, "{what}: {found} for {wanted}, within {part} of {size}");
            }
        }
    }
}

/// Harmonic and quadratic mean frequency of two tones after the kernel.
#[test]
fn the_band_is_that_of_the_tones() {
    for sample_rate_hz in [1000.0, 4000.0] {
        for tones in [&[(2e-3, 3.0)][..], &[(2e-3, 1.7), (1e-4, 11.0)], &[(1e-3, 4.0), (5e-4, 9.0)]] {
            let settings = Settings { sample_rate_hz, memory_s: 100.0, ..fine() };
            let seen = seen(&settings, Bank::Fast, tones, 20.0, [0.0, 50.0, 300.0, 0.0]);
            let kernel = Kernel::of(&settings, Bank::Fast);
            let squares = |power: i32| {
                let each = tones
                    .iter()
                    .map(|&(size, hz)| (size * gain(&kernel, hz, sample_rate_hz) * (TAU * hz).powi(power)).powi(2));
                each.sum::<f64>()
            };
            let band = seen.active.publish(&seen.state).detail.band;
            let [low, high] = [1, 2].map(|power| (squares(power + 1) / squares(power)).sqrt() / TAU);
            is_near(f64::from(band.low_hz), low, 4e-3, "low");
            is_near(f64::from(band.high_hz), high, 8e-3, "high");
            let motion = seen.active.motion(&seen.state);
            is_near(f64::from(motion.frequency_squared), (TAU * high).powi(2), 0.016, "high squared");
            is_near(f64::from(motion.low_squared), (TAU * low).powi(2), 8e-3, "low squared");
        }
    }
}

/// Strokes of a tone on the same clock recur, and the estimator reports this.
#[test]
fn strokes_that_come_again_are_counted() {
    let settings = Settings { metres_per_count: 1e-6, memory_s: 100.0, ..fine() };
    let motion = |hz: f64| {
        let seen = seen(&settings, Bank::Fast, &[(1e-3, hz)], 20.0, [0.0, 50.0, 300.0, 0.0]);
        let strokes = 2.0 * 20.0 * hz;
        (seen.active.motion(&seen.state), strokes)
    };
    let (same, strokes) = motion(4.0);
    // Up and down are two patterns.
    is_near(f64::from(same.repeats), strokes / 2.0, 0.03, "repeats");
    is_near(f64::from(same.reversals_again), strokes * (strokes / 2.0 - 1.0), 0.06, "again");
    assert!(same.steady > 0.97 && same.steady <= 1.0, "{}", same.steady);
    let (other, _) = motion(4.0 * 1.000_618);
    assert!(other.repeats < 0.5 * same.repeats, "{} {}", other.repeats, same.repeats);
    assert!(other.steady > 0.97);
    is_near(f64::from(same.readings), 20_000.0, 0.02, "readings");
}

/// Rest adds no information: the sums stay unchanged, and the last value is held.
#[test]
fn rest_teaches_nothing() {
    for bank in [Bank::Fast, Bank::Slow] {
        let settings = Settings { metres_per_count: 1e-6, ..fine() };
        let active = settings.validate().unwrap();
        let mut state = Box::new(State::new(&active));
        let mut updates = Vec::new();
        let mut held = Vec::new();
        for index in 0..14_000_u32 {
            let t_s = f64::from(index.min(8000)) * 1e-3;
            let [x, v, a, _] = at(&[(3e-3, 2.3), (1e-3, 5.1)], t_s);
            // From then on a brake holds the screw.
            let force = if index < 8000 { 80.0 * a + 300.0 * v + 15.0 * v.signum() } else { 5.0 };
            let position_count = (x / 1e-6).round() as i32 + (index / 7 % 2) as i32;
            let force_code = (force / 1e-4).round() as i32;
            let output = active.step(&mut state, &RawSample { index, position_count, force_code, terminal_code: 0 });
            updates.push(active.sums(&state, bank).updates);
            held.extend(output.estimate().map(|estimate| (index, estimate)));
        }
        // Allow for the kernel's length and the gate's delay.
        let settled = if bank == Bank::Fast { 8050 } else { 8100 };
        assert_eq!(updates[settled], updates[13_999], "{bank:?}");
        assert!(updates[7990] > 0 && updates[settled] - updates[7999] < 10);
        for (index, estimate) in held.iter().filter(|(index, _)| *index > 1500) {
            let rests = *index > 9800;
            assert!(estimate.moving || *index > 8000);
            assert!(!rests || !estimate.moving);
            let status = estimate.recent.inertance_kg.status();
            use inerter_core::Status::{Held, Ok};
            assert_eq!(
                (status, estimate.whole_run.inertance_kg.status()),
                (if estimate.moving { Ok } else { Held }, Ok),
                "{index}"
            );
            assert_eq!(estimate.recent.inertance_kg.ok().is_some(), estimate.moving);
        }
    }
}

/// Every product in the sums is that of two regressors filtered by the same kernel.
#[test]
fn sums_are_the_products_of_the_regressors() {
    for bank in [Bank::Fast, Bank::Slow] {
        let settings = Settings { skew_s: 0.0003, ..fine() };
        let seen = seen(&settings, bank, &[(2e-3, 1.9), (3e-4, 4.7)], 20.0, [500.0, 300.0, 100.0, 20.0]);
        let (sums, more) = (seen.active.sums(&seen.state, bank), seen.active.more_sums(&seen.state, bank));
        assert_eq!((sums.index, sums.updates), (more.index, more.updates));
        assert_eq!((sums.updates as usize, more.bank), (seen.rows.len(), bank));
        // The sums contain the speed before the rate of the force.
        let order = [0, 1, 2, 3, 4, 6, 5];
        let units: Vec<f64> = sums.units.into_iter().chain(more.units).collect();
        let products: Vec<i128> = sums.sums.into_iter().chain(more.sums).collect();
        let sum = |a: usize, b: usize| mean(&seen.rows, order[a], order[b]) * seen.rows.len() as f64;
        let mut place = 0;
        for row in 0..7 {
            for column in 0..=row {
                let found = products[place] as f64 * units[row] * units[column];
                let size = (sum(row, row) * sum(column, column)).sqrt();
                assert!((found - sum(row, column)).abs() < 1e-6 * size, "{bank:?}, {row} {column}: {found}");
                place += 1;
            }
        }
        // |v| is the velocity without its sign, except for updates across a reversal.
        let differ = seen.rows.iter().filter(|row| (row[6] - row[1].abs()).abs() > 0.02 * row[1].abs()).count();
        assert!(seen.rows.iter().all(|row| row[6] > -1e-6) && 3 * differ < 2 * seen.rows.len(), "{bank:?}: {differ}");
        let (speed, velocity) = (mean(&seen.rows, 6, 6), mean(&seen.rows, 1, 1));
        assert!(speed > velocity && speed < 1.6 * velocity, "{bank:?}: {speed} {velocity}");
    }
}

/// If the encoder's steps dominate, the fast bank still determines the whole run where the slow bank's kernel leaves
/// less than a tenth of its acceleration. At 190 Hz their regressors have different units, because one box is three
/// times the other.
#[test]
fn the_whole_run_is_told_by_the_bank_that_sees_the_motion() {
    let sample_rate_hz = 190.0;
    let mut told = [0, 0];
    for full_scale_acceleration_m_per_s2 in [90.0, 110.0, 130.0, 160.0] {
        for hz in [6.0, 6.3, 6.6, 6.8, 6.9, 7.0, 7.1, 7.3] {
            for clear in [400.0, 1000.0, 1500.0, 2500.0] {
                let settings = Settings { sample_rate_hz, full_scale_acceleration_m_per_s2, ..fine() };
                let fast = Kernel::of(&settings, Bank::Fast);
                let size = 1e-3;
                let square = (size * (TAU * hz).powi(2) * gain(&fast, hz, sample_rate_hz)).powi(2) / 2.0;
                // This ratio to the mean square of the steps.
                let per_square_count = fast.steps / settings.metres_per_count.powi(2);
                let metres_per_count = (square / clear / per_square_count).sqrt();
                let settings = Settings { metres_per_count, ..settings };
                let seen = seen(&settings, Bank::Fast, &[(size, hz)], 15.0, [0.0, 50.0, 300.0, 0.0]);
                let [fast, slow] = [Bank::Fast, Bank::Slow].map(|bank| {
                    let sums = seen.active.sums(&seen.state, bank);
                    let steps = Kernel::of(&settings, bank).steps;
                    (sums.sums[0] as f64 * sums.units[0].powi(2) / f64::from(sums.updates), steps)
                });
                let (seen_clear, smoothed) = (fast.0 / fast.1, slow.0 / fast.0);
                // With so few counts all of the motion may count as creep and add no information.
                let ratios = [seen_clear / 500.0, seen_clear / 2000.0, smoothed / 0.1];
                if !smoothed.is_finite() || ratios.iter().any(|ratio| (ratio - 1.0).abs() < 0.03) {
                    continue;
                }
                let is_fast = seen_clear > 2000.0 || seen_clear > 500.0 && smoothed < 0.1;
                let (square, steps) = if is_fast { fast } else { slow };
                let found = f64::from(seen.active.motion(&seen.state).acceleration_squared);
                let what = format!("{hz} Hz, {seen_clear} times, {smoothed} of {full_scale_acceleration_m_per_s2}");
                is_near(found, square - steps, 1e-3, &what);
                // Close enough that a mean square in other units would give another choice.
                let near = if is_fast { 0.08..0.1 } else { 0.1..0.15 };
                told[usize::from(is_fast)] +=
                    u32::from((500.0..2000.0).contains(&seen_clear) && near.contains(&smoothed));
            }
        }
    }
    assert!(told.iter().all(|count| *count > 2), "{told:?}");
}
