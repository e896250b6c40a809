use inerter_data::{replay::Replay, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors, raw};
use proptest::prelude::*;
use std::sync::OnceLock;

use super::*;

/// A run of ten seconds by an inertance \[kg\] under settings of its own.
fn run(motion: &str, seed: u64, inertance_kg: f64, overrides: &Overrides) -> (Settings, Outcome) {
    let device = Inerter { inertance_kg, ..Inerter::paper() };
    let sensors = Sensors { seed, ..bench_sensors() };
    let setup = Setup::new(device, sensors, motion, Some(10.0), overrides).unwrap();
    let mut replay = Replay::new(&setup.settings, 0.0).unwrap();
    setup.samples().unwrap().for_each(|sample| replay.step(&raw(&sample)).for_each(drop));
    (setup.settings, replay.outcome())
}

fn runs_of(name: &str, motion: &str, seed: u64, inertance_kg: f64) -> Runs {
    let (settings, outcome) = run(motion, seed, inertance_kg, &Overrides::default());
    Runs::of(name, &settings, &outcome)
}

/// Nine runs, of which each third is alike.
fn nine() -> &'static [Runs] {
    static NINE: OnceLock<Vec<Runs>> = OnceLock::new();
    NINE.get_or_init(|| {
        let motions = ["random", "sine:2Hz:6mm", "slow"];
        (0..9).map(|i| runs_of(&format!("run {i}"), motions[i % 3], 1 + i as u64, 299.49)).collect()
    })
}

fn shown(runs: &Runs) -> String {
    format!("{:?} {:?}", runs.to_bytes(), runs.merged(Some(0.0)).unwrap())
}

#[test]
fn one_run_is_fitted_as_it_is_alone() {
    for motion in ["random", "sine:5Hz:1mm", "slow"] {
        let (settings, outcome) = run(motion, 1, 299.49, &Overrides::default());
        let (sums, more) = outcome.sums();
        let alone = directions(&Products::of(sums, more).unwrap(), &settings, &Beside::of(&outcome), None).unwrap();
        let merged = Runs::of("run", &settings, &outcome).merged(None).unwrap();
        assert_eq!(format!("{alone:?}"), format!("{:?}", merged.fit), "{motion}");
        assert_eq!((merged.names.len(), merged.apart, merged.differs), (1, None, [false; 4]));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Bytes and fits are the same for any order, any grouping, runs that are given twice, and a way through bytes.
    #[test]
    fn any_order_and_grouping_gives_the_same_bits(
        order in Just((0..9).chain(0..9).collect::<Vec<usize>>()).prop_shuffle(),
        joins in prop::collection::vec((0_usize..64, 0_usize..64, any::<bool>()), 17),
    ) {
        let mut heap: Vec<Runs> = order.into_iter().map(|i| nine()[i].clone()).collect();
        for (one, other, by_bytes) in joins {
            let one = heap.swap_remove(one % heap.len());
            let other = heap.swap_remove(other % heap.len());
            let both = one.and(other).unwrap();
            heap.push(if by_bytes { Runs::from_bytes(&both.to_bytes()).unwrap() } else { both });
        }
        let [all] = heap.as_slice() else { panic!("{}", heap.len()) };
        static EXPECTED: OnceLock<String> = OnceLock::new();
        prop_assert_eq!(shown(all), EXPECTED.get_or_init(|| shown(&Runs::all(nine().iter().cloned()).unwrap())).clone());
    }

    /// Nothing that is read panics, whatever it is.
    #[test]
    fn bytes_of_any_kind_are_survived(place in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = nine()[0].to_bytes();
        let place = place.index(bytes.len());
        if cut { bytes.truncate(place) } else { bytes[place] = byte }
        if let Ok(runs) = Runs::from_bytes(&bytes) {
            prop_assert!(!cut);
            let _ = runs.merged(None).map(|merged| merged.remarks(runs.settings()));
        }
    }
}

#[test]
fn runs_together_tell_more_than_one() {
    // A rig without an uncertainty of its own but the stiffness', which friction hardly feels: what is left scatters.
    let mut perfect = Overrides::default();
    for name in ["skew_u95_s", "force_gain_u95", "lead_u95", "timebase_u95", "structure_mass_u95_kg"] {
        perfect.set(name, 0.0, "test").unwrap();
    }
    let u95 = |seeds: std::ops::Range<u64>| {
        let runs = seeds.map(|seed| {
            let (settings, outcome) = run("random", seed, 299.49, &perfect);
            Runs::of(&seed.to_string(), &settings, &outcome)
        });
        let fit = Runs::all(runs).unwrap().merged(None).unwrap().fit.symmetric;
        [fit.viscous_n_s_per_m, fit.coulomb_n].map(|parameter| parameter.u95())
    };
    let (one, four) = (u95(1..2), u95(1..5));
    assert!(one.iter().zip(four).all(|(one, four)| four < 0.65 * one), "{one:?} {four:?}");
    let merged = Runs::all(nine().iter().cloned()).unwrap().merged(None).unwrap();
    let law = merged.fit.symmetric;
    for (parameter, truth) in [(law.inertance_kg, 299.49), (law.viscous_n_s_per_m, 31.4), (law.coulomb_n, 50.0)] {
        let found = parameter.known().unwrap();
        assert!((f64::from(found.value) - truth).abs() <= f64::from(found.u95), "{found:?} of {truth}");
    }
    assert_eq!((merged.differs, merged.names.len()), ([false; 4], 9));
}

#[test]
fn a_device_that_is_another_from_run_to_run_is_told() {
    let runs = (0..6).map(|i| runs_of(&format!("{i}"), "random", 20 + i, if i < 3 { 290.0 } else { 310.0 }));
    let runs = Runs::all(runs).unwrap();
    let merged = runs.merged(None).unwrap();
    let [inertance_kg, ..] = merged.apart.unwrap();
    // Half of them 10 kg under the mean and half above it.
    assert!((9.0..13.0).contains(&inertance_kg), "{merged:?}");
    assert_eq!(merged.differs, [true, false, false, false], "{merged:?}");
    let found = merged.fit.symmetric.inertance_kg.known().unwrap();
    assert!((found.value - 300.0).abs() < found.u95 && (9.0..14.0).contains(&found.u95), "{found:?}");
    let [remark] = merged.remarks(runs.settings()).try_into().unwrap();
    assert!(remark.starts_with("Effective inertance differs from run to run"), "{remark}");
}

#[test]
fn a_motion_that_is_played_again_does_not_average_the_encoder_out() {
    // Counts of a twentieth of the stroke, and hardly any noise.
    let mut coarse = Overrides::default();
    coarse.set("metres_per_count", 1e-4, "test").unwrap();
    let (settings, outcome) = run("sine:2Hz:2mm", 1, 299.49, &coarse);
    let again = Runs::all((1..9).map(|seed| {
        let (settings, outcome) = run("sine:2Hz:2mm", seed, 299.49, &coarse);
        Runs::of(&seed.to_string(), &settings, &outcome)
    }));
    let one = Runs::of("1", &settings, &outcome).merged(None).unwrap().fit.symmetric.inertance_kg.fitted();
    let eight = again.unwrap().merged(None).unwrap();
    assert_eq!(eight.names.len(), 8);
    let eight = eight.fit.symmetric.inertance_kg.fitted();
    assert!(eight.u95 > 0.9 * one.u95, "{one:?} {eight:?}");
}

#[test]
fn what_does_not_belong_together_is_refused() {
    assert_eq!(Runs::all([]).unwrap_err(), MergeError::Empty);
    let mut heavier = Overrides::default();
    heavier.set("structure_mass_kg", 3.0, "test").unwrap();
    let (settings, outcome) = run("random", 1, 299.49, &heavier);
    let other = Runs::of("other.mcap", &settings, &outcome);
    let error = nine()[0].clone().and(other).unwrap_err();
    assert_eq!(error.to_string(), "structure_mass_kg is 1.515 in run 0 and 3 in other.mcap");
    // A tare, and how much is remembered and published, change no sum.
    let mut tared = Overrides::default();
    [("force_zero_code", 12.0), ("memory_s", 5.0), ("publish_rate_hz", 2.0)]
        .into_iter()
        .for_each(|(name, value)| tared.set(name, value, "test").unwrap());
    let (settings, outcome) = run("random", 1, 299.49, &tared);
    nine()[0].clone().and(Runs::of("tared.mcap", &settings, &outcome)).unwrap();
    for bytes in [&b""[..], b"inerter sums 2\n", MAGIC] {
        assert_eq!(Runs::from_bytes(bytes), Err(MergeError::Bytes));
    }
}

#[test]
fn differences_from_run_to_run_are_those_of_the_literature() {
    // By hand: Q = 2 / (0.5 + t) = 2 at t = 0.5; and exp(-2) of chance.
    let found = Spread::of(&[(-1.0, 0.5), (0.0, 0.5), (1.0, 0.5)]).unwrap();
    assert!((found.deviation.powi(2) - 0.5).abs() < 1e-12 && !found.is_unlikely && found.freedom == 2, "{found:?}");
    assert!(Spread::of(&[(-4.0, 0.5), (0.0, 0.5), (4.0, 0.5)]).unwrap().is_unlikely);
    assert_eq!(Spread::of(&[(-1.0, 1.0), (0.0, 1.0), (1.0, 1.0)]).unwrap().deviation, 0.0);
    assert!(Spread::of(&[(1.0, 2.0)]).is_none() && Spread::of(&[]).is_none());
}
