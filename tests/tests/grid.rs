//! Two runs of each motion compared with the committed table of accuracy: neither worse nor better than it says.

use inerter_core::Status;
use inerter_plant::Inerter;
use inerter_tests::grid::{self, MOTIONS, NAMES, RIGS};

const TABLE: &str = include_str!("../../docs/tables/accuracy.md");

/// Sigma and mean half width of the interval from the table.
fn expected(rig: &str, motion: &str, parameter: &str) -> (f64, f64) {
    let section = TABLE.split("\n## ").find(|section| section.lines().next() == Some(rig)).expect("a section");
    let mut rows = section.lines().map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
    let head = rows.find(|cells| cells.get(1) == Some(&"motion")).expect("a head");
    let row = rows.find(|cells| cells.get(1) == Some(&motion) && cells.get(2) == Some(&parameter)).expect("a row");
    let cell = |name: &str| row[head.iter().position(|head| *head == name).expect("a column")].parse().unwrap();
    (cell("sigma"), cell("U95"))
}

#[test]
fn errors_and_intervals_are_those_of_the_table() {
    let device = Inerter::paper();
    let rig = &RIGS[0];
    let truth = grid::truth(&device);
    let mut squares = Vec::new();
    for motion in &MOTIONS {
        let runs = [101, 102].map(|seed| grid::run(&device, motion, rig, seed).unwrap());
        for (i, name) in NAMES.into_iter().enumerate() {
            let (sigma, u95) = expected(rig.name, motion.name, name);
            let ends = runs.each_ref().map(|run| grid::three(&run.last.whole_run)[i]);
            let errors = ends.map(|end| f64::from(end.fitted().value) - truth[i]);
            let cell = format!("{}, {name}: {errors:?}, sigma {sigma}", motion.name);
            let (bias_goal, _) = motion.goals[i];
            assert!(errors.iter().all(|error| error.abs() < bias_goal.max(sigma) + 4.0 * sigma), "{cell}");
            assert!((errors[0] - errors[1]).abs() > 1e-3 * sigma, "two seeds, one result: {cell}");
            for end in ends {
                let ratio = f64::from(end.u95()) / u95;
                // The model's share depends on the random difference between samples near rest and away from it.
                assert!((0.4..2.5).contains(&ratio), "an interval {ratio} times that of the table: {cell}");
            }
            squares.extend(errors.map(|error| (error / sigma).powi(2)));
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.5..1.6).contains(&rms), "errors {rms} times those of the table");
}

/// At 1 kHz the impacts of worn flanks are not resolved, and a periodic motion repeats their error: with seed 103,
/// viscous friction is off by 20 N s/m. Values reported as ok must still be covered in 95 % of the cases.
#[test]
fn repeated_impacts_leave_no_wrong_friction() {
    let device = Inerter::worn();
    let truth = grid::truth(&device);
    let motion = grid::motion("multi");
    let (mut wrong, mut given, mut all) = ([0; 3], [0; 3], 0);
    for seed in 101..=106 {
        let run = grid::run(&device, motion, &RIGS[0], seed).unwrap();
        let live = run.forgetful.iter().map(|(_, estimate)| &estimate.recent);
        for parameters in live.chain(run.published.iter().map(|(_, estimate)| &estimate.whole_run)) {
            all += 1;
            for (i, found) in grid::three(parameters).into_iter().enumerate() {
                let is_given = found.status() == Status::Ok;
                let (error, u95) = grid::error(found.fitted(), truth[i]);
                given[i] += i32::from(is_given);
                wrong[i] += i32::from(is_given && error.abs() > u95);
            }
        }
        // The inertance is as accurate as ever.
        let inertance = run.last.whole_run.inertance_kg;
        assert!(inertance.status() == Status::Ok && inertance.u95() < 0.3, "{seed}: {inertance:?}");
    }
    let are_covered = wrong.iter().zip(given).all(|(wrong, given)| *wrong < given / 20);
    assert!(all > 2000 && are_covered, "{wrong:?} of {given:?} in {all}");
}

#[test]
fn a_motion_that_cannot_show_a_parameter_says_so() {
    // A motion at rest determines nothing; a short one at 0.053 Hz does not determine the inertance.
    let device = Inerter::paper();
    let slow = grid::Motion { duration_s: 10.0, ..MOTIONS[0] };
    let run = grid::run(&device, &slow, &RIGS[0], 5).unwrap();
    let [inertance, _, coulomb] = grid::three(&run.last.whole_run);
    assert_eq!(coulomb.status(), Status::Ok);
    assert!(inertance.u95() > 10.0 || inertance.status() == Status::NotIdentifiable, "{inertance:?}");
    let still = grid::Motion { name: "hold", duration_s: 5.0, ..MOTIONS[0] };
    let run = grid::run(&device, &still, &RIGS[0], 5).unwrap();
    for parameter in grid::three(&run.last.whole_run).into_iter().chain(grid::three(&run.last.recent)) {
        assert_eq!(parameter.status(), Status::NotIdentifiable);
    }
    assert!(run.published.iter().all(|(_, estimate)| !estimate.moving && estimate.updates == 0));
}
