use inerter_needs::Random;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;

use super::*;
use crate::simulated::{replayed, setup};

/// Flanks in contact, and no repeating stroke.
const BESIDE: Beside = Beside {
    motion: Motion {
        repeats: 1.0,
        apart: 0.0,
        frequency_squared: 0.0,
        low_squared: 0.0,
        acceleration_squared: f32::INFINITY,
        readings: f32::INFINITY,
        steady: 0.0,
        reversals_again: 0.0,
        friction_in_curvature: [0.0; 2],
    },
    model_u95: [0.0; 4],
};

/// Units of the regressors, so fine that rounding does not matter.
const UNITS: [f64; COUNT] = [1e-9, 1e-11, 1e-10, 1e-10, 1e-8, 1e-11, 1e-6];

/// Sums of rows `a, v, s, 1, F, |v|, F'`, as a device would have them.
fn summed(rows: impl IntoIterator<Item = [f64; COUNT]>) -> (Sums, MoreSums) {
    let (mut products, mut updates) = (Vec::from([0_i128; PRODUCTS]), 0);
    for row in rows {
        let codes: [i64; COUNT] = std::array::from_fn(|place| (row[place] / UNITS[place]).round() as i64);
        for (sum, (row, column)) in products.iter_mut().zip(pairs()) {
            *sum += i128::from(codes[row]) * i128::from(codes[column]);
        }
        updates += 1;
    }
    let (index, bank) = (20_000, Bank::Fast);
    let (first, second) = products.split_at(15);
    let [a, v, s, one, force, speed, rate] = UNITS;
    let sums = Sums { index, bank, updates, units: [a, v, s, one, force], sums: first.try_into().unwrap() };
    (sums, MoreSums { index, bank, updates, units: [speed, rate], sums: second.try_into().unwrap() })
}

fn products(rows: impl IntoIterator<Item = [f64; COUNT]>) -> Products {
    let (sums, more) = summed(rows);
    Products::of(&sums, &more).unwrap()
}

/// A perfect bench, finer than any noise: every interval comes from the fit alone.
fn ideal() -> Settings {
    Settings {
        skew_u95_s: 0.0,
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        metres_per_count: 1e-12,
        newtons_per_code: 1e-6,
        ..Settings::default()
    }
}

/// A device of 300 kg driven with tones \[m, rad/s\]: `[law for the velocity's side]`.
fn shaken(tones: &[(f64, f64)], sides: [[f64; 2]; 2], offset_n: f64, noise_n: f64) -> Vec<[f64; COUNT]> {
    let mut noise = Random(7);
    let motion = |t: f64, derivative: u32| {
        let turn = f64::from(derivative) * std::f64::consts::FRAC_PI_2;
        tones.iter().map(|(size, rate)| size * rate.powi(derivative as i32) * (rate * t + turn).sin()).sum::<f64>()
    };
    let row = |t: f64, noise: &mut Random| {
        let (v, a, jerk) = (motion(t, 1), motion(t, 2), motion(t, 3));
        let [viscous, coulomb] = sides[usize::from(v < 0.0)];
        let rate = 300.0 * jerk + viscous * a;
        let force = 300.0 * a + viscous * v + coulomb * v.signum() + offset_n;
        [a, v, v.signum(), 1.0, force + noise_n * noise.normal(), v.abs(), rate]
    };
    (0..2_500).map(|update| row(f64::from(update) * 0.008, &mut noise)).collect()
}

const TWO_TONES: &[(f64, f64)] = &[(8e-3, 5.03), (8e-4, 40.2)];
const ALIKE: [[f64; 2]; 2] = [[30.0, 20.0]; 2];

#[track_caller]
fn near(parameter: Parameter, truth: f64) {
    let value = f64::from(parameter.fitted().value);
    assert!((value - truth).abs() <= 1e-4 * truth.abs().max(1e-3), "{value} against {truth}");
    assert_eq!(parameter.status(), Status::Ok, "{truth}");
}

#[test]
fn friction_by_direction_is_told_apart() {
    let all = products(shaken(TWO_TONES, [[30.0, 40.0], [80.0, 60.0]], 0.0, 1e-3));
    let fit = directions(&all, &ideal(), &BESIDE, Some(0.0)).unwrap();
    near(fit.inertance_kg, 300.0);
    fit.viscous_n_s_per_m.into_iter().zip([30.0, 80.0]).for_each(|(found, truth)| near(found, truth));
    fit.coulomb_by_direction_n.unwrap().into_iter().zip([40.0, 60.0]).for_each(|(found, truth)| near(found, truth));
    near(fit.coulomb_n, 50.0);
    near(fit.difference_n, -20.0);
    assert!(fit.residual_rms_n < 2e-3 && fit.symmetric_residual_rms_n > 0.5);
    // The common value lies between those of the two directions.
    let symmetric = f64::from(fit.symmetric.viscous_n_s_per_m.fitted().value);
    assert!(30.0 < symmetric && symmetric < 80.0);
}

#[test]
fn an_offset_is_a_difference_of_coulomb_frictions_unless_it_is_known() {
    // 5 N of offset and no difference, or no offset and 10 N of difference: the same force.
    let offset = products(shaken(TWO_TONES, [[30.0, 50.0]; 2], 5.0, 1e-3));
    let difference = products(shaken(TWO_TONES, [[30.0, 55.0], [30.0, 45.0]], 0.0, 1e-3));
    for (all, offset_n, truth) in
        [(&offset, 5.0, [50.0, 50.0]), (&difference, 0.0, [55.0, 45.0]), (&difference, 5.0, [50.0, 50.0])]
    {
        let unknown = directions(all, &ideal(), &BESIDE, None).unwrap();
        assert!(unknown.coulomb_by_direction_n.is_none());
        near(unknown.difference_n, 10.0);
        let known = directions(all, &ideal(), &BESIDE, Some(offset_n)).unwrap().coulomb_by_direction_n.unwrap();
        known.into_iter().zip(truth).for_each(|(found, truth)| near(found, truth));
    }
}

#[test]
fn errors_are_those_of_updates_that_are_correlated() {
    let mut noise = Random(1);
    let (mut square, mut error_square) = (0.0, 0.0);
    for _ in 0..300 {
        let all = products((0..400).map(|_| {
            let [a, v] = [noise.normal(), 0.1 * noise.normal()];
            [a, v, v.signum(), 1.0, 300.0 * a + 30.0 * v + 50.0 * v.signum() + 2.0 * noise.normal(), v.abs(), 0.0]
        }));
        let found = directions(&all, &ideal(), &BESIDE, None).unwrap().viscous_n_s_per_m[0];
        square += (f64::from(found.fitted().value) - 30.0).powi(2);
        error_square += (f64::from(found.u95() / NORMAL_COVERAGE)).powi(2);
    }
    // These updates are uncorrelated, so the errors are too large by exactly that factor.
    let ratio = error_square / square / UPDATES_PER_OBSERVATION;
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}

#[test]
fn an_exact_fit_has_the_interval_of_what_its_instruments_round() {
    let settings = Settings { newtons_per_code: 0.01, metres_per_count: 1e-8, ..ideal() };
    // The law itself, and a constant force.
    for force in [|row: [f64; COUNT]| row[FORCE], |_: [f64; COUNT]| -30.01] {
        let law = |sign: f64| {
            let rows = shaken(TWO_TONES, ALIKE, 5.0, 0.0);
            let all = products(rows.into_iter().map(|row| {
                let [a, v, s, one, _, speed, rate] = row;
                [sign * a, sign * v, sign * s, one, sign * force(row), speed, sign * rate]
            }));
            (directions(&all, &settings, &BESIDE, None).unwrap().symmetric, all.correlation().unwrap())
        };
        let ((here, correlation), (there, _)) = (law(1.0), law(-1.0));
        for (i, (here, there)) in each(&here).into_iter().zip(each(&there)).enumerate() {
            let sign = if i == 3 { -1.0 } else { 1.0 };
            assert_eq!(here.status(), there.status());
            assert!(
                (here.fitted().value - sign * there.fitted().value).abs() < 1e-2 * here.u95(),
                "{here:?} {there:?}"
            );
        }
        // Half a code, and the steps as an offset.
        assert!((0.005..0.01).contains(&here.offset_n.u95()), "{:?}", here.offset_n);
        assert!(correlation.iter().flatten().all(|part| part.abs() < 1.001), "{correlation:?}");
    }
}

#[test]
fn systematic_parts_are_those_of_the_estimator() {
    // A tone with a period of a whole number of samples has its reversals placed by the same counts.
    ["random", "sine:5Hz:1mm"].into_iter().for_each(systematic_parts_are_those_of_the_estimator_in);
}

fn systematic_parts_are_those_of_the_estimator_in(motion: &str) {
    let setup = setup(Inerter::paper(), Sensors { seed: 1, ..bench_sensors() }, motion, 20.0);
    let outcome = replayed(&setup);
    let (sums, more) = outcome.sums();
    let fit =
        directions(&Products::of(sums, more).unwrap(), &setup.settings, &Beside::of(&outcome), None).unwrap().symmetric;
    for (here, core) in each(&fit).into_iter().zip(each(&outcome.estimate.whole_run)) {
        assert_eq!(here.status(), core.status());
        let (here, core) = (here.fitted(), core.fitted());
        assert!((here.value - core.value).abs() <= 0.02 * core.u95, "{here:?} against {core:?}");
        assert!((here.u95 / core.u95 - 1.0).abs() < 0.01, "{here:?} against {core:?}");
    }
}

#[test]
fn what_cannot_be_fitted_says_why() {
    let rows = shaken(TWO_TONES, ALIKE, 0.0, 1.0);
    let few = products(rows.iter().copied().take(60));
    assert!(matches!(directions(&few, &ideal(), &BESIDE, None), Err(FitError::TooShort { .. })));
    let standing = products((0..500).map(|_| [0.0, 0.0, 0.0, 1.0, 5.0, 0.0, 0.0]));
    assert_eq!(directions(&standing, &ideal(), &BESIDE, None).unwrap_err(), FitError::Motion);
    let one_way = products(rows.iter().copied().filter(|row| row[VELOCITY] > 0.0));
    assert_eq!(directions(&one_way, &ideal(), &BESIDE, None).unwrap_err(), FitError::Motion);
    let (sums, more) = summed(rows);
    assert_eq!(Products::of(&sums, &MoreSums { index: 20_001, ..more }).unwrap_err(), FitError::Torn);
    assert_eq!(Products::of(&sums, &MoreSums { bank: Bank::Slow, ..more }).unwrap_err(), FitError::Torn);
}
