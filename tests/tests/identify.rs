//! Hidden devices are found by `inerter identify`, within its intervals; all of them: `cargo xtask identify`.

use inerter_tests::identify::{GOALS, errors, hidden, identified, recorded};

#[test]
fn hidden_devices_are_found_within_the_goals_and_the_intervals() {
    for (motion, seed) in [("random", 3), ("two", 3)] {
        let device = hidden(seed);
        let found = identified(recorded(&device, motion, seed).unwrap()).unwrap();
        for (error, (name, goal, _)) in errors(&device, &found).into_iter().zip(GOALS) {
            let (error, u95) = error.unwrap_or_else(|| panic!("{motion} {seed}: no {name}"));
            assert!(error.abs() < goal, "{motion} {seed}: {name} wrong by {error}");
            assert!(error.abs() <= u95, "{motion} {seed}: {name} wrong by {error}, interval {u95}");
        }
    }
}
