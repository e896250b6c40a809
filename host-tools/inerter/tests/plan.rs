//! Designed motions: the reports to people and programs, the files, and the results of a run.

use std::{fs, path::Path};

use crate::common::{done, fails, json_lines, last, run, text};
use serde_json::Value;

/// The paper's device on a rig of moderate strength, perfectly calibrated.
const RIG: [&str; 24] = [
    "plan",
    "--preset",
    "paper",
    "--force-noise-n",
    "1",
    "--stroke-m",
    "0.01",
    "--speed-m-per-s",
    "0.1",
    "--force-n",
    "600",
    "--duration",
    "12",
    "--set",
    "force_gain_u95=0",
    "--set",
    "lead_u95=0",
    "--set",
    "timebase_u95=0",
    "--set",
    "skew_u95_s=0",
    "--set",
    "memory_s=100",
    "--json",
];

fn number(value: &Value, pointer: &str) -> f64 {
    value.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}: {value}"))
}

const NAMES: [&str; 3] = ["inertance_kg", "viscous_n_s_per_m", "coulomb_n"];

#[test]
fn a_designed_motion_tells_what_was_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let plan =
        last(&done(at, &[&RIG[..], &["-o", "motion.csv", "--wav", "motion.wav", "--full-scale-m", "0.02"]].concat()));
    assert_eq!(
        (&plan["kind"], &plan["criterion"], &plan["bank"]),
        (&"plan".into(), &"d_optimal".into(), &"fast".into())
    );
    for (key, most) in [("stroke_m", 0.01), ("speed_m_per_s", 0.1), ("force_n", 600.0)] {
        let peak = number(&plan, &format!("/peaks/{key}"));
        assert!(peak <= most, "{key}: {peak}");
    }
    let parts = plan["parts"].as_array().unwrap();
    let length: f64 = parts.iter().map(|part| number(part, "/duration_s")).sum();
    assert!((length - 12.0).abs() < 1e-6 && !parts.is_empty(), "{plan}");

    // All files contain the same motion.
    let csv = fs::read_to_string(at.join("motion.csv")).unwrap();
    let rows: Vec<Vec<f64>> = csv
        .lines()
        .filter(|line| line.starts_with(|letter: char| letter.is_ascii_digit()))
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 12_001);
    assert!(csv.lines().any(|line| line == "t_s,terminal_m,velocity_m_per_s,acceleration_m_per_s2"), "{csv}");
    let wav = fs::read(at.join("motion.wav")).unwrap();
    assert_eq!((&wav[..4], &wav[8..12]), (&b"RIFF"[..], &b"WAVE"[..]));
    let of_wav = |k: usize| {
        // Three bytes per sample after the header.
        let data = wav.windows(4).position(|part| part == b"data").unwrap() + 8 + 3 * k;
        f64::from(i32::from_le_bytes([0, wav[data], wav[data + 1], wav[data + 2]]) >> 8) / 8_388_607.0 * 0.02
    };
    let peak = rows.iter().map(|row| row[1].abs()).fold(0.0, f64::max);
    assert!((peak - number(&plan, "/peaks/stroke_m")).abs() < 1e-6, "{peak}");
    for k in (0..12_001).step_by(97) {
        assert!((of_wav(k) - rows[k][1]).abs() < 3e-9, "{k}: {} {}", of_wav(k), rows[k][1]);
    }
    // From rest to rest and smooth: the acceleration matches the displacement.
    assert!([0, 12_000].into_iter().all(|k| rows[k][1].abs() < 1e-9 && rows[k][2].abs() < 1e-6), "{:?}", rows[12_000]);
    for k in (1..12_000).step_by(53) {
        let second = (rows[k + 1][1] - 2.0 * rows[k][1] + rows[k - 1][1]) * 1e6;
        assert!((second - rows[k][3]).abs() < 2e-2, "{k}: {second} {}", rows[k][3]);
    }

    // The result of a run with this motion.
    let perfect =
        ["--set", "force_gain_u95=0", "--set", "lead_u95=0", "--set", "timebase_u95=0", "--set", "skew_u95_s=0"];
    let perfect = [&perfect[..], &["--set", "memory_s=100"]].concat();
    done(at, &[&["simulate", "--motion", "motion.csv", "-o", "run.mcap", "--seed", "77"], &perfect[..]].concat());
    let found = last(&done(at, &["replay", "run.mcap", "--json"]));
    for (name, truth) in NAMES.into_iter().zip([299.4906, 31.4, 50.0]) {
        let predicted = &plan["predicted"][name];
        let (u_a, u95) = (number(predicted, "/u_a"), number(predicted, "/u95"));
        let told = &found["uncertainty"][name];
        assert!((number(told, "/u_a") / u_a - 1.0).abs() < 0.3, "{name}: {predicted} {told}");
        let whole = &found["whole_run"][name];
        assert!((number(whole, "/u95") / u95 - 1.0).abs() < 0.5, "{name}: {predicted} {whole}");
        assert!((number(whole, "/value") - truth).abs() < number(whole, "/u95"), "{name}: {whole}");
        assert_eq!(predicted["status"], "ok");
        let square: f64 = predicted["budget"].as_array().unwrap().iter().map(|part| number(part, "/u95").powi(2)).sum();
        assert!((square.sqrt() / u95 - 1.0).abs() < 1e-3, "{name}: {predicted}");
    }
    assert!(found.get("advice").is_none(), "{found}");
}

#[test]
fn what_is_wanted_decides_how_long_it_lasts_and_what_cannot_be_had_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let plan = last(&done(at, &[&RIG[..], &["--want", "cf to 2 N s/m", "--want", "fc to 1 %"]].concat()));
    let length = number(&plan, "/duration_s");
    assert!((5.0..12.0).contains(&length), "{plan}");
    for want in plan["wants"].as_array().unwrap() {
        assert_eq!(want["is_reached"], true, "{want}");
        assert!(number(want, "/reached") <= number(want, "/wanted"), "{want}");
    }
    // More than the time allows: the best motion is reported and written, with the time that would suffice.
    let output = run(at, &[&RIG[..], &["--want", "cf to 0.3 N s/m", "-o", "best.csv"]].concat());
    assert_eq!(output.status.code(), Some(9));
    let best = last(&text(&output.stdout));
    let want = &best["wants"][0];
    assert_eq!((want["parameter"].as_str(), want["is_reached"].as_bool()), (Some("viscous_n_s_per_m"), Some(false)));
    assert!(number(want, "/reached") > 0.3 && number(want, "/enough_s") > 20.0, "{want}");
    assert!(at.join("best.csv").is_file());
    let words = text(&output.stderr);
    assert!(words.contains("out of reach: cf to ± 0.30 N s/m") && words.contains("would suffice"), "{words}");
    // More than any time allows: the gain of the force alone contributes 0.5 %.
    let gain = [&RIG[..], &["--set", "force_gain_u95=0.005", "--want", "mt to 0.1 %"]].concat();
    let words = fails(at, &gain, 9);
    assert!(words.contains("no duration suffices") && words.contains("inerter calibrate force"), "{words}");
}

#[test]
fn contradictions_and_nonsense_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rig = ["plan", "--preset", "paper"];
    let cases: [(&[&str], i32, &str); 26] = [
        (&["--force-noise-n", "1"], 2, "--stroke-m is missing"),
        (&["--stroke-m", "0.01"], 2, "--force-noise-n is missing"),
        (&["--force-noise-n", "1", "--stroke-m", "0"], 4, "--stroke-m: 0 is not more than 0"),
        (&["--force-noise-n", "1", "--stroke-m", "-1"], 4, "--stroke-m: -1 is not more than 0"),
        (&["--force-noise-n", "1", "--stroke-m", "NaN"], 4, "--stroke-m: NaN is not more than 0"),
        (&["--force-noise-n", "1", "--stroke-m", "inf"], 2, "--stroke-m is missing"),
        (&["--force-noise-n", "1", "--stroke-m", "ten"], 2, "invalid float literal"),
        (&["--force-noise-n", "1", "--stroke-m", "1e-6"], 4, "the whole stroke is 0.8 encoder counts"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--speed-m-per-s", "0"], 4, "--speed-m-per-s: 0"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--force-n", "nan"], 4, "--force-n: NaN"),
        (
            &["--force-noise-n", "1", "--stroke-m", "0.01", "--force-n", "40"],
            4,
            "40.0 N cannot move a screw with 50.0 N of friction",
        ),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--duration", "0"], 4, "--duration: 0 is not from 2 to 600 s"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--duration", "1e9"], 4, "is not from 2 to 600 s"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--lowest-hz", "20"], 4, "20 Hz is above 16 Hz"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--lowest-hz", "0.05"], 4, "two periods of 0.05 Hz take 40 s"),
        (
            &["--force-noise-n", "1", "--stroke-m", "0.01", "--highest-hz", "100"],
            4,
            "--highest-hz: 100 is not from 0.01 to 25 Hz",
        ),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--fade-s", "9"], 4, "--fade-s: 9 is not"),
        (&["--force-noise-n", "-1", "--stroke-m", "0.01"], 4, "force_noise_n: -1 is outside"),
        (&["--force-noise-n", "nan", "--stroke-m", "0.01"], 4, "force_noise_n: the value is not a finite number"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--inertance-kg", "-5"], 4, "inertance_kg: -5 is outside"),
        (
            &["--force-noise-n", "1", "--stroke-m", "0.01", "--set", "sample_rate_hz=0"],
            4,
            "sample_rate_hz: 0 is outside",
        ),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--want", "fc"], 4, "it is not NAME to NUMBER UNIT"),
        (&["--force-noise-n", "1", "--stroke-m", "0.01", "--want", "fc to 1 kg"], 4, "the unit is N, not `kg`"),
        (
            &["--force-noise-n", "1", "--stroke-m", "0.01", "--wav", "a.wav", "--rate-hz", "1000.5"],
            4,
            "--rate-hz: 1000.5",
        ),
        (
            &["--force-noise-n", "1", "--stroke-m", "0.01", "--wav", "a.wav", "--full-scale-m", "0"],
            4,
            "--full-scale-m: 0",
        ),
        (&["--force-noise-n", "1", "--stroke-m", "0.0001", "--highest-hz", "0.5"], 9, "no motion within these limits"),
    ];
    for (arguments, code, says) in cases {
        let words = fails(at, &[&rig[..], arguments].concat(), code);
        assert!(words.contains(says), "{arguments:?}: {words}");
    }
    let words = fails(at, &["plan", "--stroke-m", "0.01", "--force-noise-n", "1", "--inertance-kg", "100"], 2);
    assert!(words.contains("--viscous-n-s-per-m is missing"), "{words}");
    assert_eq!(fs::read_dir(at).unwrap().count(), 0, "nothing is written");
}

#[test]
fn no_file_is_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (flag, file) in [("-o", "motion.csv"), ("--wav", "motion.wav")] {
        fs::write(at.join(file), "mine").unwrap();
        let words = fails(at, &[&RIG[..], &[flag, file]].concat(), 8);
        assert!(words.contains("exists already") && words.contains("--force"), "{words}");
        assert_eq!(fs::read(at.join(file)).unwrap(), b"mine");
        done(at, &[&RIG[..], &[flag, file, "--force"]].concat());
        assert!(fs::metadata(at.join(file)).unwrap().len() > 10_000);
    }
    assert!(fails(at, &[&RIG[..], &["-o", "one", "--wav", "one"]].concat(), 8).contains("exists already"));
}

#[test]
fn the_names_and_units_of_a_rotary_machine_are_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let axis = [
        "plan",
        "--inertance-kg",
        "2e-4",
        "--viscous-n-s-per-m",
        "5e-4",
        "--coulomb-n",
        "0.02",
        "--force-noise-n",
        "0.003",
        "--stroke-m",
        "2",
        "--speed-m-per-s",
        "30",
        "--force-n",
        "0.5",
        "--duration",
        "10",
        "--want",
        "fc to 5 %, mt to 1e-5 kg m2",
        "--set",
        "machine=1",
        "--set",
        "metres_per_count=6.2832e-4",
        "--set",
        "newtons_per_code=1e-5",
        "--set",
        "full_scale_velocity_m_per_s=40",
        "--set",
        "full_scale_acceleration_m_per_s2=3000",
    ];
    let plan = last(&done(at, &[&axis[..], &["--json", "-o", "axis.csv"]].concat()));
    for pointer in [
        "/peaks/stroke_rad",
        "/peaks/speed_rad_per_s",
        "/peaks/torque_n_m",
        "/predicted/inertia_kg_m2/u95",
        "/parts/0/tones/0/amplitude_rad",
    ] {
        number(&plan, pointer);
    }
    let wanted: Vec<_> =
        plan["wants"].as_array().unwrap().iter().map(|want| want["parameter"].as_str().unwrap()).collect();
    assert_eq!(wanted, ["coulomb_n_m", "inertia_kg_m2"]);
    assert!(fs::read_to_string(at.join("axis.csv")).unwrap().contains("\nt_s,terminal_rad,velocity_rad_per_s,"));
    let words = done(at, &axis);
    for part in ["mrad", "rad/s", "N m", "Effective inertia", "kg m²", "the torque"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    done(at, &["simulate", "--motion", "axis.csv", "-o", "run.mcap"]);
}

#[test]
fn a_motion_that_is_given_is_predicted_and_what_it_exceeds_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let given = [
        "plan",
        "--preset",
        "paper",
        "--force-noise-n",
        "1",
        "--excite",
        "mid",
        "--duration",
        "10",
        "--force-n",
        "500",
        "--json",
    ];
    let output = run(at, &given);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("exceeds the limits"), "{}", text(&output.stderr));
    let plan = last(&text(&output.stdout));
    assert_eq!((&plan["criterion"], &plan["motion"]), (&"given".into(), &"mid".into()));
    assert!((number(&plan, "/peaks/stroke_m") / 4.16e-3 - 1.0).abs() < 0.01, "{plan}");
    let words = fails(at, &["plan", "--preset", "paper", "--force-noise-n", "1", "--excite", "wobble"], 4);
    assert!(words.contains("no motion has this name"), "{words}");
}

/// Writes a run at 15.9 Hz whose encoder is too coarse to determine viscous friction.
fn blind(at: &Path) {
    let coarse = ["--metres-per-count", "20e-6", "--duration", "10"];
    done(at, &[&["simulate", "-o", "blind.mcap", "--excite", "sine:15.9Hz:0.5mm"], &coarse[..]].concat());
}

#[test]
fn a_run_that_could_not_show_all_names_a_motion_that_would_have() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    blind(at);
    let advice = last(&done(at, &["replay", "blind.mcap", "--json"]))["advice"].take();
    assert_eq!((&advice["lacking"], &advice["told"]), (&serde_json::json!(["viscous_n_s_per_m"]), &advice["lacking"]));
    let predicted = number(&advice, "/predicted/viscous_n_s_per_m/u95");
    let words = done(at, &["replay", "blind.mcap"]);
    assert!(words.contains("This motion cannot identify cf. Within the same ±"), "{words}");
    assert!(words.trim_end().ends_with("designs and writes such a motion"), "{words}");
    assert_eq!(advice["text"].as_str(), words.lines().last());

    // A run with the advised motion reaches the predicted interval.
    let part = |part: &Value| {
        let tones = part["tones"].as_array().unwrap().iter();
        let tone =
            |tone: &Value| format!("{}Hz:{}mm", number(tone, "/frequency_hz"), 1e3 * number(tone, "/amplitude_m"));
        format!("tones:{}@{}s", tones.map(tone).collect::<Vec<_>>().join(","), number(part, "/duration_s"))
    };
    let excite: Vec<String> = advice["parts"].as_array().unwrap().iter().map(part).collect();
    done(at, &["simulate", "-o", "advised.mcap", "--metres-per-count", "20e-6", "--excite", &excite.join(";")]);
    let found = last(&done(at, &["replay", "advised.mcap", "--json"]));
    let u95 = number(&found, "/whole_run/viscous_n_s_per_m/u95");
    assert!((0.3..3.0).contains(&(u95 / predicted)), "{u95} for {predicted}");

    // The same run as the basis of a plan.
    let plan = last(&done(at, &["plan", "blind.mcap", "--json"]));
    assert!(number(&plan, "/predicted/viscous_n_s_per_m/u95") < number(&plan, "/limits/force_n"), "{plan}");
    assert!((number(&plan, "/expected/inertance_kg") - 299.5).abs() < 3.0, "{plan}");
    let noise = number(&plan, "/force_noise_n");
    assert!((0.5..4.0).contains(&noise), "{noise}");
}

/// In both runs Coulomb friction is smaller than its interval. In one it turns over the whole stroke, and a plan based
/// on the law would promise a result that no motion can give.
#[test]
fn a_run_whose_residual_is_beyond_its_limit_names_no_motion() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (device, is_lawful) in [(["--presliding-m", "1e-3"], false), (["--coulomb-n", "0.02"], true)] {
        let file = format!("{is_lawful}.mcap");
        let motion = ["--excite", "sine:6Hz:1mm", "--duration", "10", "--force-noise-n", "2"];
        done(at, &[&["simulate", "-o", &file], &device[..], &motion].concat());
        let found = last(&done(at, &["replay", &file, "--json", "--set", "stiffness_n_per_m=0"]));
        let friction = &found["whole_run"]["coulomb_n"];
        assert!(number(friction, "/value").abs() < number(friction, "/u95"), "{found}");
        let is_within = number(&found, "/law/ratio") <= number(&found, "/law/limit");
        assert_eq!((is_within, found.get("advice").is_some()), (is_lawful, is_lawful), "{found}");
    }
}

#[test]
fn a_run_that_shows_all_or_nothing_is_told_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    done(at, &["simulate", "-o", "good.mcap", "--excite", "random@8s"]);
    let lines = json_lines(&done(at, &["replay", "good.mcap", "--json"]));
    assert!(lines.iter().all(|line| line.get("advice").is_none()));
    assert!(!done(at, &["replay", "good.mcap"]).contains("cannot identify"));
    done(at, &["simulate", "-o", "rest.mcap", "--excite", "hold@5s"]);
    let advice = last(&done(at, &["replay", "rest.mcap", "--json"]))["advice"].take();
    assert_eq!((&advice["parts"], &advice["duration_s"]), (&serde_json::json!([]), &Value::Null));
    assert!(done(at, &["replay", "rest.mcap"]).contains("It does not describe the device well enough"));
    assert!(fails(at, &["plan", "rest.mcap"], 9).contains("its inertance is not known"));
}

#[test]
fn a_motion_that_cannot_be_read_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rows = |last: f64| -> String {
        let row =
            |k: u32| format!("{},{}\n", f64::from(k) / 100.0, if k == 20 { last } else { 0.001 * f64::from(k % 3) });
        (0..=20).map(row).collect()
    };
    for (name, content, code, says) in [
        ("empty.csv", String::new(), 3, "is empty"),
        ("names.csv", format!("t_s,x\n{}", rows(0.0)), 3, "the column `terminal_m` is missing"),
        ("jump.csv", format!("t_s,terminal_m\n{}", rows(0.5)), 4, "they must be the same"),
        ("nan.csv", format!("t_s,terminal_m\n{}0.3,nan\n", rows(0.0)), 3, "line 23"),
        ("far.csv", format!("t_s,terminal_m\n{}", rows(0.0).replace("0.002", "2000")), 4, "displacement_m"),
    ] {
        fs::write(at.join(name), content).unwrap();
        let words = fails(at, &["simulate", "--motion", name, "-o", "run.mcap"], code);
        assert!(words.contains(says), "{name}: {words}");
    }
    fails(at, &["simulate", "--motion", "nothing.csv", "-o", "run.mcap"], 3);
    fails(at, &["simulate", "--motion", "jump.csv", "--excite", "mid", "-o", "run.mcap"], 2);
    assert!(!at.join("run.mcap").exists());
}
