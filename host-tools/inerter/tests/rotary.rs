//! A rotary machine: the numbers of a linear one with its own names and units.

use std::{fs, path::Path};

use crate::common::{done, fails, json_lines, last};

const COUNT: &str = "--metres-per-count=2.44140625e-6";

fn simulate(folder: &Path, file: &str, more: &[&str]) {
    done(
        folder,
        &[&["simulate", "-o", file, "--force", "--duration", "6", "--excite", "hold@1s;random"], more].concat(),
    );
}

fn header(path: &Path) -> String {
    fs::read_to_string(path).unwrap().lines().next().unwrap().into()
}

#[test]
fn a_csv_of_a_rotary_machine_is_known_by_its_columns() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    simulate(folder, "linear.csv", &[]);
    simulate(folder, "rotary.csv", &["--set", "machine=1"]);
    assert_eq!(header(&folder.join("linear.csv")), "t_s,encoder_count,force_n");
    assert_eq!(header(&folder.join("rotary.csv")), "t_s,encoder_count,torque_n_m");

    let [linear, rotary] = ["linear.csv", "rotary.csv"].map(|file| done(folder, &["replay", file, COUNT, "--json"]));
    assert_eq!(json_lines(&linear).len(), json_lines(&rotary).len());
    let (linear, rotary) = (last(&linear), last(&rotary));
    let names = [
        ("/inertance_kg", "/inertia_kg_m2"),
        ("/viscous_n_s_per_m", "/viscous_n_m_s"),
        ("/coulomb_n", "/coulomb_n_m"),
        ("/whole_run/offset_n", "/whole_run/offset_n_m"),
        ("/residual_rms_n", "/residual_rms_n_m"),
        ("/backlash_m", "/backlash_rad"),
        ("/contact", "/contact"),
    ];
    for (of_linear, of_rotary) in names {
        assert!(linear.pointer(of_linear).is_some(), "{of_linear}");
        assert_eq!(linear.pointer(of_linear), rotary.pointer(of_rotary), "{of_rotary}");
        assert!(of_linear == of_rotary || rotary.pointer(of_linear).is_none(), "{of_linear}");
    }

    let words = done(folder, &["replay", "rotary.csv", COUNT]);
    for expected in ["Effective inertia", "kg m²", "N m s", "Torque offset", "Backlash [µrad]", "N m rms"] {
        assert!(words.contains(expected), "{expected}\n{words}");
    }
    assert!(!words.contains("nertance"), "{words}");

    let refused = fails(folder, &["replay", "rotary.csv", COUNT, "--set", "machine=0"], 3);
    assert!(refused.contains("`torque_n_m`") && refused.contains("machine = 0"), "{refused}");
    let refused = fails(folder, &["replay", "linear.csv", COUNT, "--set", "machine=1"], 3);
    assert!(refused.contains("`force_n`") && refused.contains("machine = 1"), "{refused}");
    fs::write(folder.join("mixed.csv"), "t_s,encoder_count,torque_n_m,terminal_m\n0,0,0,0\n").unwrap();
    let refused = fails(folder, &["replay", "mixed.csv", COUNT], 3);
    assert!(refused.contains("`terminal_m`") && refused.contains("`torque_n_m`"), "{refused}");
}

#[test]
fn a_recording_of_a_rotary_machine_keeps_its_kind() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    simulate(folder, "run.mcap", &["--set", "machine=1", "--set", "terminal_sensor=1"]);
    let info = last(&done(folder, &["info", "run.mcap", "--json"]));
    assert_eq!(info.pointer("/settings/machine"), Some(&1.0.into()));
    assert!(info.pointer("/estimate/inertia_kg_m2/value").is_some(), "{info}");
    assert!(info.pointer("/settings/stiffness_n_per_m").is_some(), "settings have one name for both");

    // The data for viewers, uncompressed in the file.
    let bytes = fs::read(folder.join("run.mcap")).unwrap();
    let holds = |text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
    for text in [r#""inertia_kg_m2":{"value":"#, r#""torque_min_n_m":"#, r#""angle_rad":"#, "[N m]"] {
        assert!(holds(text), "{text}");
    }
    assert!(!holds(r#""inertance_kg":{"value":"#));

    let targets = ["--csv", "out.csv", "--parquet", "out.parquet", "--mat", "out.mat", "--mcap", "out.mcap"];
    done(folder, &[&["export", "run.mcap", "--estimates"], &targets[..]].concat());
    assert_eq!(header(&folder.join("out.csv")), "t_s,encoder_count,torque_n_m,terminal_rad");
    let columns = header(&folder.join("out.estimates.csv"));
    for name in
        ["inertia_kg_m2", "inertia_u95_kg_m2", "whole_run_viscous_u95_n_m_s", "residual_rms_n_m", "backlash_u95_rad"]
    {
        assert!(columns.split(',').any(|column| column == name), "{name}: {columns}");
    }
    let chosen = done(folder, &["export", "run.mcap", "--csv", "-", "--columns", "t_s,angle_rad", "--to", "0.01"]);
    assert!(chosen.starts_with("t_s,angle_rad\n"), "{chosen}");

    done(folder, &["report", "run.mcap", "-o", "page.html"]);
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    for text in ["Effective inertia", "kg m²", "Torque [N m]", "µrad"] {
        assert!(page.contains(text), "{text}");
    }
    // Except for the settings, whose names are the same for both.
    let (head, tail) = page.split_once("<section id=\"settings\">").unwrap();
    let words = format!("{head}{}", tail.split_once("</section>").unwrap().1).replace("id=\"force\"", "");
    for text in ["[N]", "[mm]", "µm", "nertance", "N rms", "orce", "isplacement", " mass"] {
        let place = words.find(text).map(|place| words.get(place.saturating_sub(60)..place + 60));
        assert_eq!(place, None, "{text}");
    }
    let refused = fails(folder, &["export", "run.mcap", "--csv", "-", "--columns", "nothing"], 2);
    assert!(refused.contains("force_n") && refused.contains("of a rotary machine angle_rad, torque_n_m"), "{refused}");
}

#[test]
fn fit_and_identify_of_a_rotary_machine_have_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let machine = ["--set", "machine=1", "--set", "terminal_sensor=1", "--terminal-noise-m", "1e-6"];
    simulate(folder, "run.mcap", &machine);
    let fit = last(&done(folder, &["fit", "run.mcap", "--json"]));
    assert!(fit["symmetric"]["inertia_kg_m2"].is_object() && fit["by_direction"]["coulomb_n_m"].is_object(), "{fit}");
    let words = done(folder, &["fit", "run.mcap"]);
    for text in ["Effective inertia", "kg m²", "Torque offset", "N m s"] {
        assert!(words.contains(text), "{text}\n{words}");
    }
    simulate(folder, "other.mcap", &[&machine[..], &["--coulomb-n", "60", "--seed", "2"]].concat());
    let both = last(&done(folder, &["fit", "run.mcap", "other.mcap", "--json"]));
    assert!(both["apart"]["coulomb_n_m"].as_f64().is_some_and(|apart| (6.0..8.0).contains(&apart)), "{both}");
    assert_eq!(both["differs"], serde_json::json!(["coulomb_n_m"]));
    let found = last(&done(folder, &["identify", "run.mcap", "--no-profiles", "--json"]));
    let of = |name: &str| found["parameters"][name]["value"].as_f64();
    let inertia = of("inertia_kg_m2").unwrap();
    assert!((inertia - 299.49).abs() < 3.0 && of("stiffness_n_m_per_rad").is_some(), "{found}");
    assert_eq!(of("inertance_kg"), None);
    let words = done(folder, &["identify", "run.mcap", "--no-profiles", "--response"]);
    for text in
        ["Effective inertia", "kg m²", "Structure inertia", "Torque offset", "torque over the angle of the terminal"]
    {
        assert!(words.contains(text), "{text}\n{words}");
    }
    for text in ["nertance", "orce", " N  ", "isplacement"] {
        assert!(!words.contains(text), "{text}\n{words}");
    }
}

#[test]
fn what_calibrate_finds_of_a_rotary_machine_has_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let machine = ["--set", "machine=1", "--set", "terminal_sensor=1", "--terminal-noise-m", "1e-6"];
    simulate(folder, "run.mcap", &machine);
    let skew = last(&done(folder, &["calibrate", "skew", "run.mcap", "--json"]));
    assert!(skew["viscous_after_n_m_s"].is_object() && skew["skew_s"].is_number(), "{skew}");
    let stiffness = last(&done(folder, &["calibrate", "stiffness", "run.mcap", "--json"]));
    assert!(stiffness["backlash_rad"].is_object(), "{stiffness}");
    assert!(stiffness["found_stiffness_n_m_per_rad"].is_object(), "{stiffness}");
    assert!(stiffness["stiffness_n_m_per_rad"].is_number(), "{stiffness}");
    let direction = last(&done(folder, &["calibrate", "direction", "run.mcap", "--json"]));
    assert!(direction["measured"]["inertia_kg_m2"].is_number(), "{direction}");
}

/// 2e-4 kg m^2, torques below 0.3 N m, 30 rad/s, the torque 1.75 ms late.
fn axis(folder: &Path, file: &str, more: &[&str]) {
    let device = [
        "--set=machine=1",
        "--set=terminal_sensor=1",
        "--inertance-kg=2e-4",
        "--viscous-n-s-per-m=1e-4",
        "--coulomb-n=0.01",
        "--stiffness-n-per-m=200",
        "--contact-damping-n-s-per-m=0.01",
        "--structure-mass-kg=0",
        "--metres-per-count=5.99211e-6",
        "--newtons-per-code=1e-6",
        "--force-noise-n=2e-4",
        "--terminal-noise-m=1e-5",
        "--delay-s=1.75e-3",
    ];
    done(folder, &[&["simulate", "-o", file, "--force", "--duration", "12"], &device[..], more].concat());
}

#[test]
fn a_small_axis_is_served_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let multi = "--excite=multi:0.5-15Hz:30rad/s";
    axis(folder, "late.csv", &[multi, "--set=skew_s=0"]);

    // With only the encoder's scale: the motion exceeds an inerter's full scale 15 times.
    let count = "--metres-per-count=5.99211e-6";
    let skew = last(&done(folder, &["calibrate", "skew", "late.csv", count, "--json"]));
    let of = |object: &serde_json::Value, path: &str| object.pointer(path).and_then(serde_json::Value::as_f64).unwrap();
    let (skew_s, u95_s) = (of(&skew, "/skew_s"), of(&skew, "/skew_u95_s"));
    assert!((skew_s - 1.75e-3).abs() <= 1.5 * u95_s && u95_s < 1e-5, "{skew}");
    let [torque, before, after] =
        ["/torque_rms_n_m", "/residual_before_rms_n_m", "/residual_after_rms_n_m"].map(|path| of(&skew, path));
    assert!(before > 0.05 * torque && after < 1e-3 * torque, "{skew}");
    let words = done(folder, &["calibrate", "skew", "late.csv", count]);
    assert!(words.contains("the torque has a remaining delay of 17") && words.contains("e-4 N m s without"), "{words}");
    assert!(words.contains("of a torque of 0.2") && !words.contains("force"), "{words}");

    let undone = [format!("--set=skew_s={skew_s}"), format!("--set=skew_u95_s={u95_s}")];
    let with = |arguments: &[&'static str]| -> String {
        let mut all = arguments.to_vec();
        all.extend(undone.iter().map(String::as_str));
        all.extend(["--settings", "late.settings.toml"]);
        done(folder, &all)
    };
    let found = last(&with(&["replay", "late.csv", "--json"]));
    let near = |object: &serde_json::Value, path: &str, truth: f64, widest: f64| {
        let (value, u95) = (of(object, &format!("{path}/value")), of(object, &format!("{path}/u95")));
        assert!((value - truth).abs() <= u95 && u95 < widest * truth, "{path}: {value} +- {u95}");
    };
    near(&found, "/whole_run/inertia_kg_m2", 2e-4, 0.01);
    near(&found, "/whole_run/viscous_n_m_s", 1e-4, 0.1);
    near(&found, "/whole_run/coulomb_n_m", 0.01, 0.03);
    assert_eq!(found["law"]["status"], "holds", "{found}");
    let words = with(&["replay", "late.csv"]);
    for text in ["e-4 ", "none saturated", "residual 0.0000", " N m rms"] {
        assert!(words.contains(text), "{text}\n{words}");
    }
    assert!(!words.contains(" 0.0000 ±") && !words.contains("0.00 N m rms"), "{words}");
    let fit = with(&["fit", "late.csv"]);
    assert!(fit.contains("(2.00") && fit.contains("Residual, rms        N m    0.0000"), "{fit}");
    let diagnosis = with(&["diagnose", "late.csv"]);
    assert!(diagnosis.contains("The law holds"), "{diagnosis}");
    let identified = last(&with(&["identify", "late.csv", "--no-profiles", "--json"]));
    near(&identified, "/parameters/inertia_kg_m2", 2e-4, 0.02);
    let direction = with(&["calibrate", "direction", "late.csv"]);
    assert!(direction.contains("inertia by this motion (2.00") && direction.contains("e-4 kg m²"), "{direction}");
    let stiffness = with(&["calibrate", "stiffness", "late.csv"]);
    assert!(stiffness.contains("N m/rad, contact damping"), "{stiffness}");
    with(&["report", "late.csv", "-o", "page.html"]);
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(page.contains("e-4") && page.contains("N m rms, ") && !page.contains(">0.00 N m rms"), "page");

    axis(folder, "rest.mcap", &["--excite=hold"]);
    let cell = done(folder, &["calibrate", "load-cell", "rest.mcap"]);
    assert!(cell.contains("noise 0.00020 N m rms") && cell.contains("N m/s, range ±8.4 N m"), "{cell}");
    let zero = done(folder, &["calibrate", "zero", "rest.mcap"]);
    assert!(zero.contains("code at no torque") && zero.contains("e-6 N m from the zero in use"), "{zero}");
}

#[test]
fn a_motion_beyond_full_scale_is_said_to_be_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let narrow =
        ["--set=full_scale_velocity_m_per_s=2", "--set=full_scale_acceleration_m_per_s2=200", "--set=skew_s=0"];
    axis(folder, "fast.csv", &[&["--excite=multi:0.5-15Hz:30rad/s"], &narrow[..]].concat());
    let file = ["fast.csv", "--settings", "fast.settings.toml"];
    let found = last(&done(folder, &[&["replay"], &file[..], &["--json"]].concat()));
    let warning = found["warnings"].as_array().unwrap().iter().find(|one| one["code"] == "full_scale").unwrap();
    let words = warning["text"].as_str().unwrap();
    assert!(words.contains("rad/s and") && words.contains("--set full_scale_velocity_m_per_s=128"), "{words}");
    let refused = fails(folder, &[&["calibrate", "skew"], &file[..]].concat(), 9);
    assert!(refused.contains("are left out: the motion reaches"), "{refused}");
    let words = done(folder, &[&["replay"], &file[..], &["--set", "full_scale_velocity_m_per_s=128"]].concat());
    assert!(
        words.contains("--set full_scale_acceleration_m_per_s2=") && !words.contains("velocity_m_per_s="),
        "{words}"
    );
}
