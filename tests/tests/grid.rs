//! Two runs of each motion, against the committed table of accuracy: no worse than it says, and no better.

use inerter_plant::Parameters as Device;
use inerter_tests::grid::{self, MOTIONS, NAMES, RIGS};

const TABLE: &str = include_str!("../../docs/tables/accuracy.md");

/// Sigma and mean half width of the interval by the table.
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
    let device = Device::paper();
    let rig = &RIGS[0];
    let truth = grid::truth(&device);
    let mut squares = Vec::new();
    for motion in &MOTIONS {
        let runs = [101, 102].map(|seed| grid::run(&device, motion, rig, seed).unwrap());
        for (i, name) in NAMES.into_iter().enumerate() {
            let (sigma, u95) = expected(rig.name, motion.name, name);
            let ends = runs.each_ref().map(|run| grid::three(&run.last.whole_run)[i]);
            let errors = ends.map(|end| f64::from(end.value) - truth[i]);
            let cell = format!("{}, {name}: {errors:?}, sigma {sigma}", motion.name);
            let (bias_goal, _) = motion.goals[i];
            assert!(errors.iter().all(|error| error.abs() < bias_goal.max(sigma) + 4.0 * sigma), "{cell}");
            assert!((errors[0] - errors[1]).abs() > 1e-3 * sigma, "two seeds, one result: {cell}");
            for end in ends {
                let ratio = f64::from(end.u95) / u95;
                assert!((0.7..1.4).contains(&ratio), "an interval {ratio} times that of the table: {cell}");
            }
            squares.extend(errors.map(|error| (error / sigma).powi(2)));
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.5..1.6).contains(&rms), "errors {rms} times those of the table");
}

#[test]
fn a_motion_that_cannot_show_a_parameter_says_so() {
    // At rest, nothing; for a moment at 0.053 Hz, no inertance.
    let device = Device::paper();
    let slow = grid::Motion { duration_s: 10.0, ..MOTIONS[0] };
    let run = grid::run(&device, &slow, &RIGS[0], 5).unwrap();
    let [inertance, _, coulomb] = grid::three(&run.last.whole_run);
    assert_eq!(coulomb.status, inerter_core::Status::Ok);
    assert!(inertance.u95 > 10.0 || inertance.status == inerter_core::Status::NotIdentifiable, "{inertance:?}");
    let still = grid::Motion { name: "hold", duration_s: 5.0, ..MOTIONS[0] };
    let run = grid::run(&device, &still, &RIGS[0], 5).unwrap();
    for parameter in grid::three(&run.last.whole_run).into_iter().chain(grid::three(&run.last.recent)) {
        assert_eq!(parameter.status, inerter_core::Status::NotIdentifiable);
    }
    assert!(run.published.iter().all(|(_, estimate)| !estimate.moving && estimate.updates == 0));
}
