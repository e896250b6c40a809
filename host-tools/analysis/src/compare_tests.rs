use inerter_data::{limits::NAMES, settings::SettingsInputError};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;

use super::*;
use crate::{
    results::replayed,
    simulated::{recorded, setup},
};

/// A run of eight seconds, on a rig whose load cell reads 0.4 % too high, close to its stated uncertainty.
fn side(name: &str, motion: &str, seed: u64, device: Inerter) -> Side {
    let sensors = Sensors { seed, force_gain: 1.004, ..bench_sensors() };
    let run = recorded(&setup(device, sensors, motion, 8.0));
    let samples = run.samples.into_iter().map(Ok::<_, SettingsInputError>);
    let replayed = replayed(&run.settings, 0.0, samples, |_, _| Ok(())).unwrap();
    Side { name: name.into(), settings: run.settings, hello: None, calibration: None, told: replayed.told() }
}

fn place(name: &str) -> usize {
    NAMES.iter().position(|known| *known == name).unwrap()
}

/// Compares runs that share a rig, or do not.
fn compared_on(sides: &[Side], rig: Rig) -> Result<Vec<Row>, CompareError> {
    compare(sides, &vec![rig; sides.len()])
}

fn other_rig() -> Rig {
    Rig::Other("as it is".into())
}

fn row<'a>(rows: &'a [Row], name: &str) -> &'a Row {
    rows.iter().find(|row| row.place == place(name)).unwrap()
}

#[test]
fn a_difference_on_one_rig_is_seen_that_whole_intervals_hide() {
    // 0.2 % more inertance, with the force known to 0.5 %.
    let heavier = Inerter { inertance_kg: 300.09, ..Inerter::paper() };
    let sides = [side("a", "random", 1, Inerter::paper()), side("b", "random", 2, heavier)];
    let one = compared_on(&sides, Rig::of(&sides[0], &sides[1])).unwrap();
    let inertance = row(&one, "inertance_kg");
    assert_eq!((inertance.runs[0].difference, inertance.runs[0].verdict), (None, None));
    let difference = inertance.runs[1].difference.unwrap();
    assert_eq!(inertance.runs[1].verdict, Some(Verdict::Differs));
    assert!((difference.value - 0.6).abs() < difference.u95 && difference.u95 < 0.1, "{difference:?}");
    // Everything else is unchanged.
    for name in ["viscous_n_s_per_m", "coulomb_n", "offset_n"] {
        assert_eq!(row(&one, name).runs[1].verdict, Some(Verdict::NotShown), "{name}");
    }
    let several = compared_on(&sides, other_rig()).unwrap();
    let inertance = &row(&several, "inertance_kg").runs[1];
    assert_eq!(inertance.verdict, Some(Verdict::NotShown));
    assert!(inertance.difference.unwrap().u95 > 20.0 * difference.u95, "{inertance:?}");
}

/// The 36 pairs of six runs each of two devices, for each parameter: at most one difference in 20 exceeds its interval,
/// and the intervals of the inertance are not too wide.
#[test]
fn the_interval_of_a_difference_holds_the_truth() {
    let lighter = Inerter { inertance_kg: 250.0, viscous_n_s_per_m: 80.0, coulomb_n: 20.0, ..Inerter::paper() };
    let of = |device: &Inerter, seed| {
        let motions = ["random", "multi", "mid"];
        (0..6).map(|i| side("run", motions[i % 3], seed + i as u64, *device)).collect::<Vec<_>>()
    };
    let (first, other) = (of(&Inerter::paper(), 10), of(&lighter, 30));
    let paper = Inerter::paper();
    let truth = [
        ("inertance_kg", lighter.inertance_kg - paper.inertance_kg),
        ("viscous_n_s_per_m", lighter.viscous_n_s_per_m - paper.viscous_n_s_per_m),
        ("coulomb_n", lighter.coulomb_n - paper.coulomb_n),
        ("offset_n", 0.0),
    ];
    let (mut all, mut beyond, mut squares) = (0, Vec::new(), Vec::new());
    for one in &first {
        for other in &other {
            let rows = compared_on(&[one.clone(), other.clone()], Rig::Same).unwrap();
            for (name, truth) in truth {
                let Some(difference) = row(&rows, name).runs[1].difference else { continue };
                all += 1;
                if name == "inertance_kg" {
                    squares.push(((difference.value - truth) / difference.u95).powi(2));
                }
                if (difference.value - truth).abs() > difference.u95 {
                    beyond.push((name, difference));
                }
            }
        }
    }
    assert!(all > 100, "{all}");
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    println!("{} of {all} beyond; rms of error / U95 of the inertance {rms}", beyond.len());
    // A correct interval gives 0.51. The gain is off by 0.4 % of the stated 0.5 %, and dominates here.
    assert!((0.3..0.95).contains(&rms), "{rms}");
    assert!(beyond.len() * 20 <= all, "{} of {all}: {beyond:?}", beyond.len());
}

#[test]
fn nothing_is_said_of_what_proves_nothing() {
    let broken = Inerter { backlash_m: 2e-3, ..Inerter::paper() };
    let sides = [
        side("a", "random", 1, Inerter::paper()),
        side("b", "hold", 1, Inerter::paper()),
        side("c", "random", 2, broken),
    ];
    let rows = compared_on(&sides, Rig::Same).unwrap();
    let inertance = row(&rows, "inertance_kg");
    assert_eq!(inertance.runs[1].difference, None);
    assert_eq!(inertance.runs[1].verdict, Some(Verdict::Undecided));
    assert_eq!(inertance.runs[1].reason(None).unwrap(), "one of the two motions cannot identify it");
    let doubted = &inertance.runs[2];
    assert_eq!(doubted.verdict, Some(Verdict::Undecided), "{doubted:?}");
    assert_eq!(doubted.reason(None).as_deref(), doubted.doubt);
    assert_eq!(doubted.reason(Some("it is late")).as_deref(), doubted.doubt.or(Some("in the first run, it is late")));
}

#[test]
fn what_belongs_to_no_comparison_is_refused() {
    let linear = side("a", "random", 1, Inerter::paper());
    assert_eq!(compared_on(std::slice::from_ref(&linear), Rig::Same), Err(CompareError::One));
    assert_eq!(compared_on(&[], Rig::Same), Err(CompareError::One));
    let mut rotary = linear.clone();
    rotary.settings.machine = Machine::Rotary;
    rotary.name = "b".into();
    let error = compared_on(&[rotary, linear], Rig::Same).unwrap_err();
    assert_eq!(error, CompareError::Machine { runs: ["a".into(), "b".into()] });
}

#[test]
fn a_rig_is_known_by_its_scales_and_its_board() {
    let one = side("a", "random", 1, Inerter::paper());
    let of = |change: &dyn Fn(&mut Side)| {
        let mut other = one.clone();
        change(&mut other);
        Rig::of(&one, &other).is_shared()
    };
    assert!(of(&|_| ()));
    assert!(!of(&|other| other.settings.metres_per_count *= 2.0));
    assert!(of(&|other| other.settings.metres_per_count *= -1.0), "turned round");
    assert!(of(&|other| other.settings.newtons_per_code *= 2.0), "a matter of the file");
    let calibrated = |day: &str| Calibration::of_texts(&[("date".to_string(), day.to_string())].into()).ok();
    assert!(of(&|other| other.calibration = calibrated("2026-01-31")), "of one nothing is known");
    let (old, new) = (calibrated("2025-01-31"), calibrated("2026-01-31"));
    let [old, new] = [old, new].map(|calibration| Side { calibration, ..one.clone() });
    assert_eq!(Rig::of(&old, &new), Rig::Other("the calibration differs".into()));
    assert!(!of(&|other| other.settings.lead_u95 *= 2.0), "stated otherwise");
    // Without a device nothing is known.
    assert_eq!(Rig::of(&one, &one), Rig::Assumed);
}

/// A difference with given values.
fn compared(p: f64, doubt: Option<&'static str>) -> Compared {
    Compared { found: None, doubt, difference: Some(Difference { value: 1.0, u95: 1.0, p }), verdict: None }
}

/// The worked example of Holm: 0.01, 0.04, 0.03 and 0.005 at 5 % reject the first and the last.
#[test]
fn the_more_are_looked_at_the_more_unlikely_each_must_be() {
    let first = Compared { difference: None, ..compared(1.0, None) };
    let row = |place, p, doubt| Row { place, runs: vec![first.clone(), compared(p, doubt)] };
    let mut rows = [
        row(0, 0.01, None),
        row(1, 0.04, None),
        row(2, 0.03, None),
        row(3, 0.005, None),
        row(4, 1e-9, Some("not this")),
    ];
    judge(&mut rows);
    let said = rows.map(|row| row.runs[1].verdict.unwrap());
    use Verdict::{Differs, NotShown, Undecided};
    assert_eq!(said, [Differs, NotShown, NotShown, Differs, Undecided]);
}

#[test]
fn what_is_shared_cancels_and_what_is_not_adds_up() {
    let place = place("viscous_n_s_per_m");
    let quantity = |value, budget: Budget| Quantity { value, budget };
    let of = |noise: f32| Budget::of_scatter(noise, 1e9);
    let (one, two) = (quantity(100.0, of(0.3).and(Source::Gain, 1.0)), quantity(200.0, of(0.4).and(Source::Gain, 2.0)));
    let near = |one: f64, two: f64| (one / two - 1.0).abs() < 3e-4;
    // Only proportional to the difference: 1 of 100.
    let on_one = Difference::of(place, &one, &two, &Rig::Same);
    assert!(near(on_one.u95, (0.5 * 1.959964_f64).hypot(1.0)), "{on_one:?}");
    let on_two = Difference::of(place, &one, &two, &other_rig());
    assert!(near(on_two.u95, (0.5 * 1.959964_f64).hypot(5.0_f64.sqrt())), "{on_two:?}");
    // With opposite signs an error of the gain moves them apart.
    let turned = quantity(-200.0, two.budget);
    assert!(near(Difference::of(place, &one, &turned, &Rig::Same).u95, (0.5 * 1.959964_f64).hypot(3.0)));
    // Student's distribution with the combined degrees of freedom: 4 each, of equal weight, give 8, for which tables
    // list 2.306.
    let few = quantity(0.0, Budget::of_scatter(1.0, 4.0));
    let other = quantity(2.306 * 2.0_f32.sqrt(), few.budget);
    let few = Difference::of(place, &few, &other, &Rig::Same);
    assert!(near(few.u95, 2.306 * 2.0_f64.sqrt()) && (few.p - 0.05).abs() < 1e-4, "{few:?}");
    // Without any uncertainty, different values differ and equal values do not.
    let exact = Difference::of(place, &quantity(1.0, of(0.0)), &quantity(1.0, of(0.0)), &Rig::Same);
    assert_eq!((exact.u95, exact.p), (0.0, 1.0));
    assert_eq!(Difference::of(place, &quantity(1.0, of(0.0)), &quantity(2.0, of(0.0)), &Rig::Same).p, 0.0);
    // The inertance with the structure is positive, whatever remains without the structure; the contact's backlash
    // shares no errors.
    let near_none = quantity(-1.0, one.budget);
    let inertance = Difference::of(0, &one, &near_none, &Rig::Same);
    assert!(near(inertance.u95, 0.3 * 2.0_f64.sqrt() * 1.959964), "{inertance:?}");
    let backlash = Difference::of(4, &one, &two, &Rig::Same);
    assert!(near(backlash.u95, on_two.u95), "{backlash:?}");
    let stiffness = |source| {
        let [one, two] = [one, two].map(|one| quantity(one.value, of(0.0).and(source, one.value / 100.0)));
        Difference::of(5, &one, &two, &Rig::Same).u95
    };
    assert!(near(stiffness(Source::Gain), 1.0) && near(stiffness(Source::Lead), 5.0_f64.sqrt()));
    let unknown = Difference::of(place, &one, &quantity(1.0, Budget::UNKNOWN), &Rig::Same);
    assert_eq!((unknown.u95, unknown.p), (f64::INFINITY, 1.0));
}
