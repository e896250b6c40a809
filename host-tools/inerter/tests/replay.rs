//! Files through the program: the JSON contract, and equal results from every route.

use std::{fs, path::Path, sync::OnceLock};

use crate::common::{self, done, fails, frames, json_lines, last, run, text};
use inerter_analysis::diagnose::Kind;
use inerter_core::Settings;
use inerter_data::{
    json::{EstimateJson, json_line},
    replay::replay,
    settings::Overrides,
};
use proptest::prelude::*;
use serde_json::Value;

const PARAMETERS: [&str; 4] = ["inertance_kg", "viscous_n_s_per_m", "coulomb_n", "offset_n"];

fn simulate(folder: &Path, more: &[&str]) {
    let duration: &[&str] = if more.contains(&"--duration") { &[] } else { &["--duration", "6"] };
    done(folder, &[&["simulate", "-o", "run.mcap", "--force"], duration, more].concat());
}

fn check_parameters(of: &Value) {
    for name in PARAMETERS {
        let parameter = of.get(name).unwrap().as_object().unwrap();
        assert_eq!(parameter.keys().collect::<Vec<_>>(), ["value", "u95", "status"], "{name}");
        let status = parameter.get("status").unwrap().as_str().unwrap();
        assert!(["ok", "below_u95", "held", "not_identifiable"].contains(&status));
        assert_eq!(parameter.get("value").unwrap().is_null(), status == "not_identifiable", "{name}");
        assert!(parameter.get("u95").unwrap().is_number() || status == "not_identifiable");
    }
}

fn check_detail(of: &Value) {
    let keys: Vec<&String> = of.get("backlash_m").unwrap().as_object().unwrap().keys().collect();
    assert_eq!(keys, ["value", "u95", "status", "reason", "reversals", "route"]);
    let status = of.pointer("/backlash_m/status").unwrap().as_str().unwrap();
    assert!(["ok", "below_u95", "not_identifiable"].contains(&status));
    assert_eq!(of.pointer("/backlash_m/value").unwrap().is_null(), status == "not_identifiable");
    assert_eq!(of.pointer("/backlash_m/reason").unwrap().is_null(), status != "not_identifiable");
    let contact = of.get("contact").unwrap().as_str().unwrap();
    assert!(["unknown", "one_sided", "closed", "backlash", "bouncing"].contains(&contact));
    let regime = of.pointer("/friction/regime").unwrap().as_str().unwrap();
    assert!(["unknown", "coulomb", "presliding", "stribeck"].contains(&regime));
    assert!(of.get("changes").unwrap().is_u64());
    if let Some(band) = of.get("band_hz").unwrap().as_array() {
        let [low, high] = band.as_slice() else { panic!("{of}") };
        assert!(0.0 < low.as_f64().unwrap() && low.as_f64() <= high.as_f64(), "{of}");
    }
    assert_eq!(of.get("stiffness_n_per_m"), None, "no sensor, no word of it");
}

#[test]
fn what_the_intervals_are_made_of_adds_up() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--excite", "fast", "--duration", "10", "--force-noise-n", "1"]);
    let line = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    let number = |of: &Value, key: &str| of.get(key).and_then(Value::as_f64).unwrap_or_else(|| panic!("{key}: {of}"));
    let names: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
    for name in PARAMETERS {
        let of = line.pointer(&format!("/uncertainty/{name}")).unwrap();
        let whole = line.pointer(&format!("/whole_run/{name}")).unwrap();
        let parts = of.get("budget").unwrap().as_array().unwrap();
        let sum: f64 = parts.iter().map(|part| number(part, "u95").powi(2)).sum();
        assert!((sum.sqrt() / number(of, "u95") - 1.0).abs() < 1e-5, "{name}: {of}");
        // The samples can only widen the device's interval.
        assert!(number(of, "u95") >= number(whole, "u95") * (1.0 - 1e-6), "{name}: {of}, {whole}");
        assert!(number(of, "same_rig_u95") <= number(of, "u95") && number(of, "u_a") > 0.0, "{name}: {of}");
        let assumes = of.get("assumes").unwrap().as_array().unwrap();
        assert!(assumes.iter().all(|one| names.contains(&one.as_str().unwrap())), "{name}: {of}");
    }
    let of_a_tone = line.pointer("/uncertainty/viscous_n_s_per_m/assumes").unwrap().as_array().unwrap();
    assert!(of_a_tone.contains(&"load_dependent".into()), "{of_a_tone:?}");
    for (i, row) in line.pointer("/uncertainty/correlation").unwrap().as_array().unwrap().iter().enumerate() {
        assert!((row.get(i).unwrap().as_f64().unwrap() - 1.0).abs() < 1e-9, "{row}");
    }
}

#[test]
fn every_line_of_a_replay_keeps_the_contract_and_the_last_is_final() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--excite", "hold@1s;random@3s;hold"]);
    let output = done(folder.path(), &["replay", "run.mcap", "--json"]);
    assert!(!output.contains("NaN") && !output.contains("inf"));
    let (lines, others): (Vec<Value>, Vec<Value>) =
        json_lines(&output).into_iter().partition(|line| line.get("kind").unwrap() == "estimate");
    for other in others {
        assert!(["reversal", "event"].contains(&other.get("kind").unwrap().as_str().unwrap()), "{other}");
    }
    assert_eq!(lines.len(), 6 * 5 + 1);
    for (number, line) in lines.iter().enumerate() {
        assert_eq!(line.get("kind").unwrap(), "estimate");
        assert_eq!(line.get("final").is_some(), number + 1 == lines.len());
        assert!(line.get("t_s").unwrap().is_f64());
        check_parameters(line);
        check_parameters(line.get("whole_run").unwrap());
        check_detail(line);
    }
    let last = lines.last().unwrap();
    let keys: Vec<&str> = last.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(keys.get(..8).unwrap(), [&["kind", "final", "t_s", "whole_run"][..], &PARAMETERS].concat());
    assert_eq!(last.get("final").unwrap(), true);
    assert_eq!(last.get("t_s").unwrap(), 5.999);
    assert_eq!(last.get("samples").unwrap(), 6000);
    let status = |line: &Value| line.pointer("/inertance_kg/status").unwrap().as_str().unwrap().to_string();
    assert_eq!(status(lines.first().unwrap()), "not_identifiable");
    assert_eq!(status(lines.get(15).unwrap()), "ok");
    assert_eq!(status(last), "held");
    assert!(lines.first().unwrap().get("band_hz").unwrap().is_null(), "nothing has moved yet");
    let low_hz = lines.get(19).unwrap().pointer("/band_hz/0").unwrap().as_f64().unwrap();
    assert!((5.0..16.0).contains(&low_hz), "{low_hz}");
}

#[test]
fn each_reversal_of_a_worn_screw_has_a_line_and_all_of_them_make_the_backlash() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--preset", "worn", "--excite", "two", "--duration", "12"]);
    let output = done(folder.path(), &["replay", "run.mcap", "--json"]);
    let reversals: Vec<Value> =
        json_lines(&output).into_iter().filter(|line| line.get("kind").unwrap() == "reversal").collect();
    let number = |of: &Value, path: &str| of.pointer(path).unwrap().as_f64().unwrap();
    let estimate = last(&output);
    assert_eq!(estimate.pointer("/backlash_m/status").unwrap(), "ok");
    assert_eq!(estimate.get("contact").unwrap(), "backlash");
    let (value, u95) = (number(&estimate, "/backlash_m/value"), number(&estimate, "/backlash_m/u95"));
    assert!((value - 1e-4).abs() < u95 && u95 < 1e-5, "{value} {u95}");
    // An early reversal may be accepted only after others have confirmed it.
    let part = reversals.len() as f64 / number(&estimate, "/backlash_m/reversals");
    assert!((0.8..=1.2).contains(&part) && reversals.len() > 50, "{}", reversals.len());
    let mean = reversals.iter().map(|reversal| number(reversal, "/value_m")).sum::<f64>() / reversals.len() as f64;
    assert!((mean - 1e-4).abs() < 1e-5, "{mean}");
    for reversal in &reversals {
        assert!((number(reversal, "/t_s") - number(reversal, "/index") * 1e-3).abs() < 1e-9, "{reversal}");
    }
}

#[test]
fn a_change_of_the_device_is_told_where_it_happens() {
    let folder = tempfile::tempdir().unwrap();
    let swapped = ["--excite", "mid", "--duration", "14", "--change-at", "8", "--change", "inertance_kg=150"];
    simulate(folder.path(), &swapped);
    let output = run(folder.path(), &["replay", "run.mcap", "--json"]);
    assert_eq!(text(&output.stderr), "", "a replay finds it by itself");
    let lines = json_lines(&text(&output.stdout));
    let event = lines.iter().find(|line| line.get("kind").unwrap() == "event").unwrap();
    let found = (event.get("code").unwrap(), event.get("parameter").unwrap());
    assert_eq!(found, (&"changed".into(), &"inertance_kg".into()));
    let t_s = event.get("t_s").unwrap().as_f64().unwrap();
    assert!((8.0..12.0).contains(&t_s), "{event}");
    assert_eq!(lines.last().unwrap().get("changes").unwrap(), 1);
    let words = done(folder.path(), &["replay", "run.mcap"]);
    assert!(words.contains("the device has changed: effective inertance from 299."), "{words}");
    assert!(words.contains("299.4906, then 150.0"), "{words}");
    let output = run(folder.path(), &["fit", "run.mcap", "--json"]);
    assert!(text(&output.stderr).contains("only the motion since then is fitted"), "{}", text(&output.stderr));
    let inertance = last(&text(&output.stdout)).pointer("/symmetric/inertance_kg/value").unwrap().as_f64().unwrap();
    assert!((inertance - 150.0).abs() < 1.0, "{inertance}");
}

#[test]
fn the_settings_rate_is_that_of_the_simulated_instruments() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--set", "sample_rate_hz=4000"]);
    let words = done(folder.path(), &["replay", "run.mcap"]);
    assert!(words.contains("24000 samples at 4000 Hz in 6.0 s"), "{words}");
    let both = ["simulate", "-o", "both.mcap", "--sample-rate-hz", "4000", "--set"];
    done(folder.path(), &[&both[..], &["sample_rate_hz=4000", "--duration", "1"]].concat());
    let words = fails(folder.path(), &[&both[..], &["sample_rate_hz=1000"]].concat(), 4);
    assert!(words.contains("sample_rate_hz = 1000 contradicts the 4000 Hz of the simulated instruments"), "{words}");
    assert!(words.contains("leave one of them out"), "{words}");
}

#[test]
fn a_terminal_sensor_brings_its_parameters() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--set", "terminal_sensor=1"]);
    let json = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    for name in ["stiffness_n_per_m", "contact_damping_n_s_per_m"] {
        let keys: Vec<&String> = json.get(name).unwrap().as_object().unwrap().keys().collect();
        assert_eq!(keys, ["value", "u95", "status"], "{name}");
    }
    assert!(done(folder.path(), &["replay", "run.mcap"]).contains("Contact stiffness    N/m"));
    // A CSV with the column has a sensor, unless the sensor is switched off.
    done(folder.path(), &["export", "run.mcap", "--csv", "run.csv"]);
    let plain = ["replay", "run.csv", "--metres-per-count", "1e-6", "--json"];
    assert!(last(&done(folder.path(), &plain)).get("stiffness_n_per_m").is_some());
    let off = run(folder.path(), &[&plain[..], &["--set", "terminal_sensor=0"]].concat());
    assert_eq!(last(&text(&off.stdout)).get("stiffness_n_per_m"), None);
    assert!(text(&off.stderr).contains("the column terminal_m is ignored"), "{}", text(&off.stderr));
    // A simulation or an export writes the column only if its settings enable the sensor.
    let header = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap().lines().next().unwrap().to_string();
    assert_eq!(header("run.csv"), "t_s,encoder_count,force_n,terminal_m");
    done(folder.path(), &["export", "run.mcap", "--csv", "run.csv", "--force", "--set", "terminal_sensor=0"]);
    assert_eq!(header("run.csv"), "t_s,encoder_count,force_n");
    for (sensor, columns) in [("0", "t_s,encoder_count,force_n"), ("1", "t_s,encoder_count,force_n,terminal_m")] {
        let sensor = format!("terminal_sensor={sensor}");
        done(folder.path(), &["simulate", "-o", "new.csv", "--force", "--duration", "1", "--set", &sensor]);
        assert_eq!(header("new.csv"), columns);
    }
}

#[test]
fn a_fit_tells_the_directions_apart_and_needs_the_offset_for_it() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--excite", "random"]);
    let fit = last(&done(folder.path(), &["fit", "run.mcap", "--json"]));
    let number = |fit: &Value, path: &str| fit.pointer(path).unwrap_or_else(|| panic!("{path}: {fit}")).as_f64();
    check_parameters(fit.get("symmetric").unwrap());
    assert!(fit.pointer("/by_direction/coulomb_positive_n").unwrap().is_null());
    let inertance = number(&fit, "/by_direction/inertance_kg/value").unwrap();
    assert!((inertance - 299.4906).abs() < 1.0, "{inertance}");
    let known = last(&done(folder.path(), &["fit", "run.mcap", "--offset-n", "0", "--json"]));
    for side in ["positive", "negative"] {
        let coulomb = number(&known, &format!("/by_direction/coulomb_{side}_n/value")).unwrap();
        assert!((coulomb - 50.0).abs() < 2.0, "{side}: {coulomb}");
    }
    let words = done(folder.path(), &["fit", "run.mcap"]);
    for part in ["alike", "positive", "negative", "fc+ - fc- + 2 F0 is", "--offset-n"] {
        assert!(words.contains(part), "{part} is not in:\n{words}");
    }
    assert!(done(folder.path(), &["fit", "run.mcap", "--offset-n", "-1.5"]).contains("-1.5 (given)"));
}

#[test]
fn runs_are_fitted_together_in_any_order_where_their_settings_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    for (seed, friction) in [("1", "50"), ("2", "50"), ("3", "56")] {
        let options = ["--duration", "8", "--seed", seed, "--coulomb-n", friction, "--excite", "random"];
        done(folder.path(), &[&["simulate", "-o", &format!("{seed}.mcap")], &options[..]].concat());
    }
    let line = |files: &[&str]| done(folder.path(), &[&["fit", "--json"], files].concat());
    let all = line(&["1.mcap", "2.mcap", "3.mcap"]);
    let output = run(folder.path(), &["fit", "--json", "3.mcap", "1.mcap", "2.mcap", "1.mcap"]);
    assert_eq!(text(&output.stdout), all);
    assert!(text(&output.stderr).contains("1.mcap: this run was given twice, and counts once"));
    let fit = last(&all);
    assert_eq!(fit.get("files").unwrap(), &serde_json::json!(["1.mcap", "2.mcap", "3.mcap"]));
    assert_eq!(fit.get("differs").unwrap(), &serde_json::json!(["coulomb_n"]));
    let apart = fit.pointer("/apart/coulomb_n").unwrap().as_f64().unwrap();
    assert!((2.0..5.0).contains(&apart) && fit.get("file").is_none(), "{fit}");
    let words = done(folder.path(), &["fit", "1.mcap", "2.mcap", "3.mcap"]);
    let told = words.lines().last().unwrap();
    assert!(words.contains("\n3 runs together\n") && told.starts_with("Coulomb friction differs from run"), "{words}");
    done(folder.path(), &["simulate", "-o", "other.mcap", "--duration", "8", "--set", "structure_mass_kg=3"]);
    let output = run(folder.path(), &["fit", "1.mcap", "other.mcap"]);
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(4), String::new()));
    let told = text(&output.stderr);
    assert!(told.contains("the settings of 1.mcap and other.mcap differ: structure_mass_kg is 1.515 and 3"), "{told}");
}

#[test]
fn a_skew_is_found_from_a_file_and_what_is_printed_takes_it_away() {
    let folder = tempfile::tempdir().unwrap();
    let late = ["--duration", "20", "--excite", "random", "--delay-s", "5e-5", "--set", "skew_s=1e-5"];
    done(folder.path(), &[&["simulate", "-o", "run.mcap", "--force"], &late[..]].concat());
    let found = last(&done(folder.path(), &["calibrate", "skew", "run.mcap", "--json"]));
    let number = |key: &str| found.get(key).unwrap().as_f64().unwrap();
    assert!((number("left_s") - 4e-5).abs() < number("u95_s"), "{found}");
    assert!((number("skew_s") - 5e-5).abs() < number("skew_u95_s") && number("u95_s") < 4e-6, "{found}");
    assert_eq!(found.get("written").unwrap(), false);
    let words = done(folder.path(), &["calibrate", "skew", "run.mcap"]);
    let settings: Vec<&str> =
        words.lines().find_map(|line| line.strip_prefix("use it with: ")).unwrap().split(' ').collect();
    let replayed = |more: &[&str]| last(&done(folder.path(), &[&["replay", "run.mcap", "--json"], more].concat()));
    let viscous = |json: &Value| json.pointer("/whole_run/viscous_n_s_per_m/value").and_then(Value::as_f64);
    let (before, after) = (replayed(&[]), replayed(&settings));
    // A delay of 40 us acts as false damping: 80 N s/m at 13 Hz, and less at the lower frequencies of this motion. The
    // true value is 31.4 N s/m.
    assert!(viscous(&before).is_none_or(|value| value > 60.0), "{before}");
    assert_ne!(before.pointer("/law/status").unwrap(), "holds", "{before}");
    assert!((viscous(&after).unwrap() - 31.4).abs() < 8.0, "{after}");
}

#[test]
fn a_motion_that_shows_no_skew_is_refused_with_its_own_code() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--excite", "fast"]);
    let words = fails(folder.path(), &["calibrate", "skew", "run.mcap"], 9);
    assert!(words.contains("as in a single tone, where a delay and viscous friction are indistinguishable"), "{words}");
    assert!(words.contains("several frequencies at once"), "{words}");
    simulate(folder.path(), &["--excite", "hold"]);
    for command in ["fit", "calibrate skew"] {
        let words = fails(folder.path(), &[&command.split(' ').collect::<Vec<_>>()[..], &["run.mcap"]].concat(), 9);
        assert!(words.contains("too little motion") && words.contains("the encoder shows no motion"), "{words}");
    }
    // A force at its limits must not be reported as a lack of motion.
    simulate(folder.path(), &["--force-min-code", "-300000", "--force-max-code", "300000"]);
    for command in ["fit", "calibrate skew", "calibrate stiffness"] {
        let words = fails(folder.path(), &[&command.split(' ').collect::<Vec<_>>()[..], &["run.mcap"]].concat(), 9);
        assert!(words.contains("% of the samples are saturated") && words.contains("shake less hard"), "{words}");
    }
}

#[test]
fn a_stiffness_found_with_the_sensor_lets_the_force_find_the_backlash_without() {
    let folder = tempfile::tempdir().unwrap();
    let worn = ["--preset", "worn", "--excite", "random", "--duration", "20"];
    simulate(folder.path(), &[&worn[..], &["--set", "terminal_sensor=1", "--set", "stiffness_n_per_m=0"]].concat());
    let calibrate = ["calibrate", "stiffness", "run.mcap"];
    let found = last(&done(folder.path(), &[&calibrate[..], &["--json"]].concat()));
    let number = |key: &str| found.pointer(key).unwrap().as_f64().unwrap();
    assert!((number("/stiffness_n_per_m") - 2.1e6).abs() < number("/stiffness_u95_n_per_m"), "{found}");
    assert!(number("/stiffness_u95_n_per_m") < 5e4, "{found}");
    let damping = number("/contact_damping_n_s_per_m") - 1200.0;
    assert!(damping.abs() < number("/found_contact_damping_n_s_per_m/u95"), "{found}");
    assert_eq!([found.get("better").unwrap(), found.get("written").unwrap()], [true, false]);
    let words = done(folder.path(), &calibrate);
    let settings: Vec<&str> =
        words.lines().find_map(|line| line.strip_prefix("use it with: ")).unwrap().split(' ').collect();
    let without = ["replay", "run.mcap", "--json", "--set", "terminal_sensor=0"];
    let backlash = |more: &[&str]| last(&done(folder.path(), &[&without[..], more].concat()));
    assert_eq!(backlash(&[]).pointer("/backlash_m/reason").unwrap(), "stiffness_unknown");
    let by_force = backlash(&settings);
    let [value, u95] = ["value", "u95"].map(|key| by_force.pointer(&format!("/backlash_m/{key}")).unwrap().as_f64());
    assert!((value.unwrap() - 1e-4).abs() < u95.unwrap() && u95.unwrap() < 1e-5, "{by_force}");
    // The command also knows the settings in use.
    let again = done(folder.path(), &[&calibrate[..], &settings].concat());
    assert!(again.contains("nothing to change"), "{again}");
}

#[test]
fn a_stiffness_that_is_not_shown_is_refused_with_its_own_code() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let words = fails(folder.path(), &["calibrate", "stiffness", "run.mcap"], 9);
    assert!(words.contains("terminal_sensor=1"), "{words}");
    let hold = ["--excite", "hold", "--set", "terminal_sensor=1", "--set", "stiffness_n_per_m=0"];
    simulate(folder.path(), &hold);
    let words = fails(folder.path(), &["calibrate", "stiffness", "run.mcap"], 9);
    assert!(words.contains("neither flank is touched for long enough"), "{words}");
}

#[test]
fn without_json_a_table_for_a_person_is_printed() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let output = done(folder.path(), &["replay", "run.mcap"]);
    for words in [
        "Effective inertance  kg",
        "last 30 s",
        "whole run",
        "truth",
        "299.4906",
        "Backlash             µm",
        "inertance observed",
        "contact: ",
        "friction: ",
        "6000 samples at 1000 Hz",
        "none lost",
    ] {
        assert!(output.contains(words), "{words} is not in:\n{output}");
    }
}

#[test]
fn an_exported_csv_replays_to_the_same_digits() {
    let folder = tempfile::tempdir().unwrap();
    for more in [
        &["--lost-probability", "0.001", "--force-offset-n", "7"][..],
        &["--oversampling", "16", "--sample-rate-hz", "4000", "--set", "force_zero_code=-250"],
        &["--sample-rate-hz", "1234.5", "--metres-per-count", "-1e-6"],
    ] {
        simulate(folder.path(), more);
        let from_recording = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
        done(folder.path(), &["export", "run.mcap", "--csv", "run.csv", "--force"]);
        let again = ["replay", "run.csv", "--settings", "run.settings.toml", "--json"];
        assert_eq!(last(&done(folder.path(), &again)), from_recording, "{more:?}");

        // As exported by a European Excel.
        let csv = fs::read_to_string(folder.path().join("run.csv")).unwrap();
        let european = format!("\u{feff}{}", csv.replace(',', ";").replace('.', ",").replace('\n', "\r\n"));
        fs::write(folder.path().join("run.csv"), european).unwrap();
        assert_eq!(last(&done(folder.path(), &again)), from_recording, "{more:?}");
    }
}

#[test]
fn a_simulation_gives_the_same_run_as_recording_and_as_csv() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    done(folder.path(), &["simulate", "-o", "run.csv", "--force", "--duration", "6"]);
    let from_csv = done(folder.path(), &["replay", "run.csv", "--settings", "run.settings.toml", "--json"]);
    assert_eq!(from_csv, done(folder.path(), &["replay", "run.mcap", "--json"]));
    let same = fs::read(folder.path().join("run.mcap")).unwrap();
    simulate(folder.path(), &[]);
    assert!(same == fs::read(folder.path().join("run.mcap")).unwrap(), "the same seeds give the same bytes");
}

#[test]
fn missing_samples_are_counted_and_told() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let csv = done(folder.path(), &["export", "run.mcap", "--csv", "-"]);
    let kept: Vec<&str> =
        csv.lines().enumerate().filter(|(line, _)| !(3000..3010).contains(line)).map(|(_, line)| line).collect();
    fs::write(folder.path().join("holes.csv"), kept.join("\n")).unwrap();
    done(folder.path(), &["simulate", "-o", "same.csv", "--duration", "1"]);
    let arguments = ["replay", "holes.csv", "--settings", "same.settings.toml"];
    let output = run(folder.path(), &[&arguments[..], &["--json"]].concat());
    assert!(text(&output.stderr).contains("10 samples missing in 1 place; the estimator assumes nothing about them"));
    let last = last(&text(&output.stdout));
    assert_eq!((last.get("discontinuities").unwrap(), last.get("lost_samples").unwrap()), (&1.into(), &10.into()));
    let inertance = last.pointer("/inertance_kg/value").unwrap().as_f64().unwrap();
    assert!((inertance - 299.4906).abs() < 1.0, "{inertance}");
}

#[test]
fn later_settings_win() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--set", "memory_s=11"]);
    fs::write(folder.path().join("s.toml"), "memory_s = 12\n").unwrap();
    for (more, memory) in [
        (&[][..], "last 11 s"),
        (&["--settings", "s.toml"], "last 12 s"),
        (&["--settings", "s.toml", "--set", "memory_s=13"], "last 13 s"),
        (&["--set", "memory_s=14", "--set", "memory_s=15"], "last 15 s"),
    ] {
        assert!(done(folder.path(), &[&["replay", "run.mcap"], more].concat()).contains(memory));
    }
}

#[test]
fn a_recording_that_is_cut_off_or_damaged_replays_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let whole = fs::read(folder.path().join("run.mcap")).unwrap();
    let cut = whole.get(..whole.len() / 2).unwrap();
    fs::write(folder.path().join("cut.mcap"), cut).unwrap();
    let output = run(folder.path(), &["replay", "cut.mcap", "--json"]);
    assert!(text(&output.stderr).contains("note: cut.mcap: the file is cut off; everything before the cut is used"));
    let samples = last(&text(&output.stdout)).get("samples").unwrap().as_u64().unwrap();
    assert!((2500..3500).contains(&samples), "{samples}");
    let info = last(&done(folder.path(), &["info", "cut.mcap", "--json"]));
    assert_eq!((info.get("ending").unwrap(), info.get("samples").unwrap()), (&"cut_off".into(), &samples.into()));

    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    // Far enough apart that not all of them hit an index, where damage is harmless.
    damaged.iter_mut().skip(middle).step_by(1500).take(3).for_each(|byte| *byte ^= 0x5A);
    fs::write(folder.path().join("damaged.mcap"), damaged).unwrap();
    let output = run(folder.path(), &["replay", "damaged.mcap", "--json"]);
    assert!(output.status.success());
    assert!(text(&output.stderr).contains("damaged"), "{}", text(&output.stderr));
    assert!(last(&text(&output.stdout)).get("samples").unwrap().as_u64().unwrap() > 2500);
}

#[cfg(unix)]
#[test]
fn a_disk_that_is_full_keeps_no_part_of_a_simulation() {
    let folder = tempfile::tempdir().unwrap();
    // A limit on the file size simulates a full disk. Without its signal, the write fails.
    let script = r#"trap "" XFSZ; ulimit -f 300; exec "$0" simulate -o run.mcap --duration 600"#;
    let mut command = std::process::Command::new("bash");
    let output =
        command.args(["-c", script, env!("CARGO_BIN_EXE_inerter")]).current_dir(folder.path()).output().unwrap();
    let words = text(&output.stderr);
    assert_eq!(output.status.code(), Some(8), "{words}");
    assert!(words.contains("run.mcap cannot be written: ") && words.contains("no larger file is allowed"), "{words}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    simulate(folder.path(), &[]);
    for arguments in [&["simulate", "-o", "/dev/full"][..], &["export", "run.mcap", "--csv", "/dev/full"]] {
        assert!(fails(folder.path(), arguments, 8).contains("the disk is full"));
    }
}

#[cfg(unix)]
#[test]
fn a_full_disk_behind_standard_output_is_noticed_and_a_closed_pipe_is_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = common::inerter(folder.path(), &["replay", "run.mcap", "--json"]).stdout(full).output().unwrap();
    assert_eq!(output.status.code(), Some(8));
    assert!(text(&output.stderr).contains("standard output cannot be written"));
    let script = r#""$0" replay run.mcap --json | head -n 1; exit ${PIPESTATUS[0]}"#;
    let mut command = std::process::Command::new("bash");
    let output =
        command.args(["-c", script, env!("CARGO_BIN_EXE_inerter")]).current_dir(folder.path()).output().unwrap();
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
}

#[test]
fn a_recording_of_another_wire_version_is_refused_with_the_versions() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("future.mcap");
    let mut recorder = inerter_data::recording::Recorder::create(&path, false).unwrap();
    recorder.frame(0, &frames::foreign_hello()).unwrap();
    recorder.close(&inerter_data::recording::End { reason: "finished".into(), lost_frames: 0 }).unwrap();
    let words = fails(folder.path(), &["replay", "future.mcap"], 7);
    assert!(words.contains("was recorded from a device that speaks wire version 7; this program speaks 1"), "{words}");
    assert!(words.contains("use a newer `inerter` program"), "{words}");
    // A store rejects the file, and is not created for it.
    let words = fails(folder.path(), &["store", "add", "s", "future.mcap"], 7);
    assert!(words.contains("speaks wire version 7; this program speaks 1"), "{words}");
    assert!(!folder.path().join("s").exists());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn whatever_is_damaged_a_replay_gives_numbers_or_an_error(
        damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..60),
    ) {
        let folder = tempfile::tempdir().unwrap();
        static WHOLE: OnceLock<Vec<u8>> = OnceLock::new();
        let mut bytes = WHOLE
            .get_or_init(|| {
                simulate(folder.path(), &[]);
                fs::read(folder.path().join("run.mcap")).unwrap()
            })
            .clone();
        for (place, value) in damage {
            let place = place.index(bytes.len());
            if let Some(byte) = bytes.get_mut(place) {
                *byte = value;
            }
        }
        let path = folder.path().join("damaged.mcap");
        fs::write(&path, bytes).unwrap();
        // Damaged settings may be refused, with a message.
        let replayed = inerter_data::open(&path, &Overrides::default()).and_then(|run| replay(&run, |_, _| Ok(())));
        if let Ok(outcome) = replayed {
            let line = json_line(&EstimateJson::last(
                outcome.t_s,
                &outcome.estimated(),
                &Settings::default(),
                Some(outcome.counters),
            ));
            check_parameters(&last(&line));
        }
    }
}

#[test]
fn a_device_is_held_against_limits() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    simulate(folder.path(), &["--excite", "random", "--seed", "4"]);
    let limits = |text: &str| std::fs::write(path("limits.toml"), text).unwrap();
    let judged =
        |more: &[&str]| run(folder.path(), &[&["replay", "run.mcap", "--limits", "limits.toml"], more].concat());
    limits("[inertance_kg]\nmin = 290\nmax = 310\n[coulomb_n]\nmax = 60\n");
    let output = judged(&["--junit", "r.xml", "--verdicts", "r.csv"]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    assert!(text(&output.stdout).contains("pass       Effective inertance: 299.5 ± 1.5 kg, wanted 290 to 310 kg"));
    let rows = std::fs::read_to_string(path("r.csv")).unwrap();
    assert!(rows.starts_with("run,parameter,value,u95,min,max,verdict,needed_u95,reason\n"), "{rows}");
    assert_eq!(rows.lines().filter(|row| row.contains(",pass,")).count(), 2);

    // An existing output file is reported before any work.
    let output = judged(&["--junit", "r.xml"]);
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(8), String::new()));
    limits("[inertance_kg]\nmax = 299.6\n[coulomb_n]\nmax = 45\n[backlash_m]\nmax = 1e-4\n");
    let output = judged(&["--junit", "r.xml", "--verdicts", "r.csv", "--force", "--json"]);
    assert_eq!(output.status.code(), Some(10));
    let told = text(&output.stderr);
    assert!(told.contains("1 of 3 fail, 1 undecided") && told.contains("plan run.mcap --want \"mt to 0.1"), "{told}");
    let line = last(&text(&output.stdout));
    assert_eq!(line.pointer("/limits/verdict").unwrap(), "fail");
    let parameters = line.pointer("/limits/parameters").unwrap().as_array().unwrap();
    let of = |name: &str| parameters.iter().find(|one| one["parameter"] == name).unwrap();
    assert_eq!((&of("inertance_kg")["verdict"], &of("backlash_m")["verdict"]), (&"undecided".into(), &"pass".into()));
    let needed = of("inertance_kg")["needed_u95"].as_f64().unwrap();
    assert!((0.05..0.2).contains(&needed), "{needed}");
    assert_eq!(of("coulomb_n")["u95"], line["uncertainty"]["coulomb_n"]["u95"]);
    let xml = std::fs::read_to_string(path("r.xml")).unwrap();
    assert!(
        xml.contains("tests=\"3\" skipped=\"0\" failures=\"1\" errors=\"1\"")
            && xml.contains("<failure message=\"Coulomb friction: "),
        "{xml}"
    );

    // It does not matter whether anybody reads the output.
    let words = ["replay", "run.mcap", "--limits", "limits.toml", "--verdicts", "p.csv"];
    let mut child = common::inerter(folder.path(), &words).stderr(std::process::Stdio::null()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(10));
    assert!(path("p.csv").is_file());
    for files in [["--junit", "x", "--verdicts", "x"], ["--junit", "run.mcap", "--verdicts", "y"]] {
        let output = judged(&[&files[..], &["--force"]].concat());
        assert_eq!(output.status.code(), Some(8), "{files:?}");
    }

    // A run with a broken law is no evidence, nor is one in which the device changed.
    let change = ["--duration", "20", "--excite", "random", "--change-at", "8", "--change", "inertance_kg=150"];
    done(folder.path(), &[&["simulate", "-o", "changed.mcap"], &change[..]].concat());
    let output = run(folder.path(), &["replay", "changed.mcap", "--limits", "limits.toml", "--json"]);
    assert_eq!(output.status.code(), Some(10));
    assert!(text(&output.stdout).contains("\"reason\":\"the device changed during the run\""));
    let output = judged(&["--set", "skew_s=0.004", "--json"]);
    let line = last(&text(&output.stdout));
    assert_eq!((&line["law"]["status"], &line["limits"]["verdict"]), (&"broken".into(), &"undecided".into()), "{line}");
    assert_eq!(output.status.code(), Some(10));

    // The printed command designs a motion, and a run with that motion gives a verdict.
    limits("[viscous_n_s_per_m]\nmax = 33\n[backlash_m]\nmax = 1e-4\n");
    let told = text(&judged(&[]).stderr);
    let line = told.split('`').find(|part| part.starts_with("inerter plan run.mcap --want ")).unwrap();
    let (command, want) = line.trim_end_matches('"').split_once(" \"").unwrap();
    let words: Vec<&str> = command.split(' ').skip(1).chain([want, "-o", "motion.csv"]).collect();
    assert!(done(folder.path(), &words).contains(": reached, "), "{words:?}");
    done(folder.path(), &["simulate", "--motion", "motion.csv", "--seed", "5", "-o", "planned.mcap"]);
    let planned = done(folder.path(), &["replay", "planned.mcap", "--limits", "limits.toml"]);
    assert_eq!(planned.lines().filter(|line| line.starts_with("pass ")).count(), 2, "{planned}");
    // No motion can be designed for the backlash, and the program does not suggest one.
    limits("[backlash_m]\nmax = 1.5e-6\n");
    let told = text(&judged(&[]).stderr);
    assert!(told.contains("1 undecided") && !told.contains("--want"), "{told}");

    limits("[coulomb]\nmax = 1\n");
    let output = judged(&[]);
    assert_eq!(output.status.code(), Some(4));
    assert!(text(&output.stderr).contains("did you mean `coulomb_n`?"), "{}", text(&output.stderr));
    assert_eq!(run(folder.path(), &["replay", "run.mcap", "--limits", "none.toml"]).status.code(), Some(3));
}
