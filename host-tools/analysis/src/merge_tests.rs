use inerter_data::{replay::Replay, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors};
use proptest::prelude::*;
use std::sync::OnceLock;

use super::*;
use crate::simulated::{recorded, replayed, setup};

/// A run of ten seconds with an inertance \[kg\] and separate settings.
fn run(motion: &str, seed: u64, inertance_kg: f64, overrides: &Overrides) -> (Settings, Outcome) {
    let device = Inerter { inertance_kg, ..Inerter::paper() };
    let sensors = Sensors { seed, ..bench_sensors() };
    let setup = Setup::new(device, sensors, motion, Some(10.0), overrides).unwrap();
    (setup.settings, replayed(&setup))
}

/// The same as a set of one, with the seed as its name.
fn seeded(motion: &str, seed: u64, overrides: &Overrides) -> Runs {
    let (settings, outcome) = run(motion, seed, 299.49, overrides);
    Runs::of(&seed.to_string(), &settings, &outcome)
}

fn runs_of(name: &str, motion: &str, seed: u64, inertance_kg: f64) -> Runs {
    let (settings, outcome) = run(motion, seed, inertance_kg, &Overrides::default());
    Runs::of(name, &settings, &outcome)
}

/// Nine runs, in three groups that are alike.
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
        assert_eq!((merged.names.len(), merged.apart, merged.differs), (1, [None; 4], [false; 4]));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Bytes and fits are the same for any order and grouping, for runs given twice, and after a round trip through
    /// bytes.
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

    /// No input causes a panic.
    #[test]
    fn bytes_of_any_kind_are_survived(place in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = nine()[0].to_bytes();
        let place = place.index(bytes.len());
        if cut { bytes.truncate(place) } else { bytes[place] = byte }
        if let Ok(runs) = Runs::from_bytes(&bytes) {
            prop_assert!(!cut);
            let _ = runs.merged(None).map(|merged| merged.remarks(&runs.settings()));
        }
    }
}

#[test]
fn runs_together_tell_more_than_one() {
    // A rig with no uncertainty except that of the stiffness, to which friction is hardly sensitive: only scatter
    // remains.
    let mut perfect = Overrides::default();
    for name in ["skew_u95_s", "force_gain_u95", "lead_u95", "timebase_u95", "structure_mass_u95_kg"] {
        perfect.set(name, 0.0, "test").unwrap();
    }
    let u95 = |seeds: std::ops::Range<u64>| {
        let runs = seeds.map(|seed| seeded("random", seed, &perfect));
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
    let inertance_kg = merged.apart[0].unwrap();
    // Half of them 10 kg below the mean and half above it.
    assert!((9.0..13.0).contains(&inertance_kg), "{merged:?}");
    assert_eq!(merged.differs, [true, false, false, false], "{merged:?}");
    let found = merged.fit.symmetric.inertance_kg.known().unwrap();
    assert!((found.value - 300.0).abs() < found.u95 && (9.0..14.0).contains(&found.u95), "{found:?}");
    let [remark] = merged.remarks(&runs.settings()).try_into().unwrap();
    assert!(remark.starts_with("Effective inertance differs from run to run"), "{remark}");
}

#[test]
fn a_motion_that_is_played_again_does_not_average_the_encoder_out() {
    // Counts as large as a twentieth of the stroke, and hardly any noise.
    let mut coarse = Overrides::default();
    coarse.set("metres_per_count", 1e-4, "test").unwrap();
    let of = |seed| seeded("sine:2Hz:2mm", seed, &coarse);
    let one = of(1).merged(None).unwrap().fit.symmetric.inertance_kg.fitted();
    let eight = Runs::all((1..9).map(of)).unwrap().merged(None).unwrap();
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
    assert_eq!(error.to_string(), "the settings of run 0 and other.mcap differ: structure_mass_kg is 1.515 and 3");
    assert!(error.help().unwrap().to_string().ends_with("--set structure_mass_kg=3"));
    for bytes in [&b""[..], b"inerter sums 2\n", MAGIC] {
        assert_eq!(Runs::from_bytes(bytes), Err(MergeError::Bytes));
    }
}

/// The samples of a run with a force offset by this many codes, for a board tared accordingly.
fn tared(name: &str, seed: u64, tare: i32) -> Runs {
    let mut board = Overrides::default();
    // As for the analogue front end.
    for (name, value) in [("force_min_code", 0.0), ("force_max_code", 262_080.0), ("newtons_per_code", 0.1)] {
        board.set(name, value, "test").unwrap();
    }
    board.set("force_zero_code", f64::from(tare), "test").unwrap();
    let sensors = Sensors { seed, ..bench_sensors() };
    let run = recorded(&setup(Inerter::paper(), sensors, "random", 10.0));
    let mut settings = run.settings;
    board.apply(&mut settings).unwrap();
    let mut replay = Replay::new(&settings, 0.0).unwrap();
    for mut sample in run.samples {
        let force_n = f64::from(sample.force_code) * run.settings.newtons_per_code;
        sample.force_code = (force_n / settings.newtons_per_code).round() as i32 + tare;
        replay.step(&sample).for_each(drop);
    }
    Runs::of(name, &settings, &replay.outcome())
}

#[test]
fn a_tare_of_its_own_spoils_no_sum() {
    let near = |runs: &Runs| {
        let law = runs.merged(None).unwrap().fit.symmetric;
        let [inertance, coulomb] = [law.inertance_kg, law.coulomb_n].map(|found| found.known().unwrap().value);
        assert!((inertance - 299.49).abs() < 0.1 && (coulomb - 50.0).abs() < 0.2, "{law:?}");
    };
    let runs: Vec<_> = [131_040, 131_100, 70_000, 200_000]
        .into_iter()
        .enumerate()
        .map(|(number, tare)| tared(&number.to_string(), 1 + number as u64, tare))
        .collect();
    let unit = |runs: &Runs| runs.parts.values().next().unwrap().units(Bank::Fast)[4];
    assert!(unit(&runs[2]) > unit(&runs[0]), "the force's unit must not be the same in all");
    runs.iter().for_each(near);
    let all = Runs::all(runs.clone()).unwrap();
    near(&all);
    assert_eq!(Runs::from_bytes(&all.to_bytes()).unwrap(), all);
    let backwards = Runs::all(runs.into_iter().rev()).unwrap();
    assert_eq!(shown(&backwards), shown(&all));
}

#[test]
fn what_no_estimator_could_have_given_is_refused() {
    let runs = nine()[0].clone();
    let read = |change: &dyn Fn(&mut Part)| {
        let mut part = runs.parts.values().next().unwrap().clone();
        change(&mut part);
        Runs::from_bytes(&[MAGIC, &stored(&vec![part])].concat())
    };
    let with = |change: &dyn Fn(&mut Part)| read(change).is_err();
    assert!(!with(&|_| {}));
    assert!(with(&|part| part.banks[0].0.units[4] *= 2.0) && with(&|part| part.banks[1].1.units[0] = f64::NAN));
    assert!(with(&|part| part.banks[0].1.updates += 1) && with(&|part| part.banks[0].0.bank = Bank::Slow));
    assert!(with(&|part| part.settings.sample_rate_hz = f64::NAN) && with(&|part| part.settings.memory_s = -1.0));
    // Sums of any size are handled.
    for sum in [i128::MAX, i128::MIN, 0] {
        let _ = read(&|part| part.banks[0].0.sums.fill(sum)).unwrap().and(nine()[1].clone()).unwrap().merged(None);
    }
}

#[test]
fn runs_of_which_nothing_was_summed_stay_apart() {
    let empty = |name: &str| {
        let settings = nine()[0].settings();
        Runs::of(name, &settings, &Replay::new(&settings, 0.0).unwrap().outcome())
    };
    let runs = Runs::all([empty("a"), nine()[0].clone(), empty("b"), empty("a")]).unwrap();
    assert_eq!(runs.names(), ["a", "b", "run 0"]);
    assert_eq!(format!("{:?}", runs.merged(None).unwrap().fit), format!("{:?}", nine()[0].merged(None).unwrap().fit));
    assert!(empty("a").merged(None).is_err());
}

#[test]
fn differences_from_run_to_run_are_those_of_the_literature() {
    // By hand: Q = 2 / (0.5 + t) = 2 at t = 0.5; the probability is exp(-2).
    let found = Spread::of(&[(-1.0, 0.5), (0.0, 0.5), (1.0, 0.5)]).unwrap();
    assert!((found.deviation.powi(2) - 0.5).abs() < 1e-12 && !found.is_unlikely && found.freedom == 2, "{found:?}");
    assert!(Spread::of(&[(-4.0, 0.5), (0.0, 0.5), (4.0, 0.5)]).unwrap().is_unlikely);
    assert_eq!(Spread::of(&[(-1.0, 1.0), (0.0, 1.0), (1.0, 1.0)]).unwrap().deviation, 0.0);
    assert!(Spread::of(&[(1.0, 2.0)]).is_none() && Spread::of(&[]).is_none());
}
