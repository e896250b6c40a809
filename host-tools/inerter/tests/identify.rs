//! `inerter identify` through the program: its JSON, its words, its exit codes.

mod common;

use common::{done, fails, json_lines};

#[test]
fn a_recording_with_a_terminal_sensor_is_identified() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rig = ["--terminal-noise-m", "1e-6", "--set", "terminal_sensor=1", "--duration", "10"];
    done(at, &[&["simulate", "-o", "run.mcap", "--excite", "random"][..], &rig].concat());
    let output = done(at, &["identify", "run.mcap", "--no-profiles", "--segments", "5", "--json"]);
    assert!(!output.contains("NaN") && !output.contains("inf"));
    let lines = json_lines(&output);
    let [found] = lines.as_slice() else { panic!("{output}") };
    assert_eq!(found.get("kind").unwrap(), "identify");
    assert_eq!(found.get("route").unwrap(), "complete");
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
