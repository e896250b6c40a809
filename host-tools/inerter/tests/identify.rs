//! `inerter identify` through the program: its JSON, its text, its exit codes.

use crate::common::{done, fails, json_lines, last};

#[test]
fn a_recording_with_a_terminal_sensor_is_identified() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rig = ["--terminal-noise-m", "1e-6", "--set", "terminal_sensor=1", "--duration", "10"];
    done(at, &[&["simulate", "--force", "-o", "run.mcap", "--excite", "random"][..], &rig].concat());
    let output = done(at, &["identify", "run.mcap", "--no-profiles", "--segments", "5", "--json"]);
    assert!(!output.contains("NaN") && !output.contains("inf"));
    let lines = json_lines(&output);
    let [found] = lines.as_slice() else { panic!("{output}") };
    assert_eq!(found.get("kind").unwrap(), "identify");
    assert_eq!(found.get("model").unwrap(), "complete");
    let parameter = |name: &str| found.pointer(&format!("/parameters/{name}")).unwrap().clone();
    for (name, truth) in [("inertance_kg", 299.4906), ("coulomb_n", 50.0), ("stiffness_n_per_m", 2.1e6)] {
        let (value, u95) = (parameter(name)["value"].as_f64().unwrap(), parameter(name)["u95"].as_f64().unwrap());
        assert!((value - truth).abs() <= u95 && u95 < 0.05 * truth, "{name}: {value} within {u95}");
    }
    assert_eq!(parameter("backlash_m")["status"], "below_u95");
    assert_eq!(found.pointer("/segments/0").unwrap().as_array().unwrap().len(), 2);
    let points = found.pointer("/responses/0/points").unwrap().as_array().unwrap();
    let strong: Vec<_> = points.iter().filter(|point| point["coherence"].as_f64().unwrap() > 0.95).collect();
    assert!(strong.len() > 3, "{points:?}");
    for point in strong {
        let magnitude = |name: &str| point[name]["magnitude_n_per_m"].as_f64().unwrap();
        let apart = magnitude("measured") / magnitude("complete") - 1.0;
        assert!(apart.abs() < 0.02 + 1.5 * point["magnitude_u95"].as_f64().unwrap(), "{point}");
    }
    let text = done(at, &["identify", "run.mcap", "--no-profiles", "--response"]);
    assert!(text.contains("Contact stiffness") && text.contains("Validation"), "{text}");
    assert!(text.contains("force over the displacement of the terminal, by"), "{text}");
    fails(at, &["identify", "run.mcap", "--staged"], 2);
    fails(at, &["identify", "run.mcap", "--segments", "-1"], 2);
}

#[test]
fn a_stated_motion_is_taken_from_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    done(at, &["simulate", "--force", "-o", "run.csv", "--excite", "random", "--seed", "4", "--duration", "6"]);
    let stated = |seed: &str| {
        let settings = ["--settings", "run.settings.toml", "--no-profiles", "--json"];
        last(&done(at, &[&["identify", "run.csv", "--excite", "random", "--seed", seed][..], &settings].concat()))
    };
    let found = stated("4");
    assert_eq!(found["model"], "complete");
    let inertance = &found["parameters"]["inertance_kg"];
    let (value, u95) = (inertance["value"].as_f64().unwrap(), inertance["u95"].as_f64().unwrap());
    // The interval includes the uncertainty of the load cell's gain; the simulated cell has no such error.
    assert!((value - 299.4906).abs() < 0.3 && u95 < 3.0, "{value} within {u95}");
    let words = fails(at, &["identify", "run.csv", "--settings", "run.settings.toml", "--excite", "sine:fast"], 4);
    assert!(words.contains("sine:fast"), "{words}");
    fails(at, &["identify", "run.csv", "--seed", "4"], 2);
}

#[test]
fn stages_take_the_slowest_file_for_the_friction_and_the_fastest_to_validate() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rig = ["--terminal-noise-m", "1e-6", "--set", "terminal_sensor=1"];
    for (file, motion, duration) in
        [("fast.mcap", "random", "8"), ("slow.csv", "sine:0.5Hz:10mm", "10"), ("middle.mcap", "mid", "8")]
    {
        done(
            at,
            &[&["simulate", "--force", "-o", file, "--excite", motion, "--duration", duration][..], &rig].concat(),
        );
    }
    let files = ["identify", "--staged", "fast.mcap", "slow.csv", "middle.mcap"];
    let settings = ["--settings", "slow.settings.toml", "--no-profiles", "--json"];
    let found = last(&done(at, &[&files[..], &settings].concat()));
    let parameter = |name: &str| found["parameters"][name].clone();
    for (name, truth, most) in
        [("inertance_kg", 299.4906, 0.6), ("coulomb_n", 50.0, 1.0), ("stiffness_n_per_m", 2.1e6, 2e4)]
    {
        let (value, u95) = (parameter(name)["value"].as_f64().unwrap(), parameter(name)["u95"].as_f64().unwrap());
        assert!((value - truth).abs() <= u95.min(most), "{name}: {value} within {u95}");
    }
    assert_eq!(found["validation"]["fitted"], 0.0);
    assert!(found["validation"]["explained"].as_f64().unwrap() > 0.999, "{}", found["validation"]);
    // Only the middle file is left for the second stage.
    assert_eq!(found["offsets_n"].as_array().unwrap().len(), 1);
}
