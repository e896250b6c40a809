//! `cargo xtask identify`: the complete model of hidden devices; `cargo xtask bench-identify`: the time that this
//! takes.

use std::{fmt::Write, path::Path, time::Instant};

use inerter_analysis::identify::{Parameters, known_skew_s, known_structure_mass_kg};
use inerter_data::series::Series;
use inerter_tests::{
    grid::Result,
    identify::{DURATION_S, GOALS, MOTIONS, errors, hidden, identified, instruments, recorded},
    sheet::{self, significant},
};
use serde_json::{Value, json};

/// Devices per motion.
const DEVICES: u64 = 8;
/// The first of them were inspected while the interval factors were tuned.
const TUNED: u64 = 3;

pub fn run(words: &[&str]) -> Result<bool> {
    match words {
        ["--bench", path] => bench(Path::new(path), DURATION_S),
        ["--bench", path, seconds] => bench(Path::new(path), seconds.parse()?),
        ["--compare", path, faster] => compare(Path::new(path), faster),
        _ => table(words),
    }
}

fn table(words: &[&str]) -> Result<bool> {
    let asked = sheet::asked("identify", words, false)?;
    let mut text = format!(
        "# Identification of hidden devices

`inerter identify` finds the complete model from {DURATION_S} s at 1 kHz, with 1 N of force noise, 2.44 um
per count and a terminal sensor with 1 um of noise. A seed draws each device: half to twice the
paper's parameters, and up to 0.1 mm of backlash. The search starts without knowing the device.

Each cell gives the error and, in brackets, the half width of the 95 % interval. `*`: the error
exceeds the goal. `!`: it exceeds the interval. Devices 1 to {TUNED} were looked at while the factors in
the intervals were set, the others were not.

Written by `cargo xtask identify --update`; checked by `cargo xtask identify`.

"
    );
    let heads = GOALS.map(|(name, _)| name);
    writeln!(
        text,
        "| motion | device | {} | residual/noise |\n|---|---|{}---|",
        heads.join(" | "),
        "---|".repeat(heads.len())
    )?;
    let (mut covered, mut all, mut missed) = ([0, 0], [0, 0], [0, 0]);
    for motion in MOTIONS {
        for seed in 1..=DEVICES {
            let fresh = usize::from(seed > TUNED);
            let device = hidden(seed);
            let found = identified(recorded(&device, motion, &instruments(seed), DURATION_S)?)?;
            let mut cells = Vec::new();
            for (error, (name, goal)) in errors(&device, &found).into_iter().zip(GOALS) {
                let Some((error, u95)) = error else {
                    cells.push("-".to_owned());
                    missed[fresh] += 1;
                    continue;
                };
                all[fresh] += 1;
                let (is_missed, is_covered) = (error.abs() > goal, error.abs() <= u95);
                covered[fresh] += u32::from(is_covered);
                missed[fresh] += u32::from(is_missed);
                let marks = [if is_missed { "*" } else { "" }, if is_covered { "" } else { "!" }].concat();
                let [error, u95] = [error, u95].map(|value| significant(value * unit(name)));
                cells.push(format!("{error} ({u95}){marks}"));
            }
            let ratio = found.residual_over_noise.unwrap_or(f64::NAN);
            writeln!(text, "| {motion} | {seed} | {} | {} |", cells.join(" | "), significant(ratio))?;
            eprintln!("{}", text.lines().last().unwrap_or_default());
        }
    }
    let goals = GOALS.map(|(name, goal)| format!("{name} {}", goal * unit(name)));
    writeln!(text, "\nGoals: {}.\n", goals.join(", "))?;
    for (fresh, first, last) in [(0, 1, TUNED), (1, TUNED + 1, DEVICES)] {
        writeln!(
            text,
            "- devices {first} to {last}: {} of {} goals missed; {} of {} intervals contain the true value.",
            missed[fresh],
            MOTIONS.len() * (last + 1 - first) as usize * GOALS.len(),
            covered[fresh],
            all[fresh],
        )?;
    }
    sheet::conclude("identify", &text, 2, asked)
}

/// Units per SI unit, by the unit in a column's name.
fn unit(name: &str) -> f64 {
    match name.rsplit(' ').next() {
        Some("%") => 100.0,
        Some("um") => 1e6,
        _ => 1.0,
    }
}

/// Writes the problem for scipy and solves it, with the same samples, parameters, start values and prior knowledge.
fn bench(path: &Path, duration_s: f64) -> Result<bool> {
    let device = hidden(3);
    let rig = instruments(3);
    let run = recorded(&device, "random", &rig, duration_s)?;
    let settings = run.settings;
    let series = Series::of(&run);
    let stretch = series.stretches.first().ok_or("no samples")?;
    let started = Instant::now();
    let found = identified(run)?;
    let time_s = started.elapsed().as_secs_f64();
    let problem = json!({
        "period_s": series.period_s,
        "terminal_m": stretch.terminal_m,
        "position_m": stretch.position_m,
        "force_n": stretch.force_n,
        "force_noise_n": rig.force_noise_n,
        "position_noise_m": rig.metres_per_count / 12f64.sqrt(),
        "known": {
            "structure_mass_kg": known_structure_mass_kg(&settings),
            "skew_s": known_skew_s(&settings),
        },
        "start": found.start,
        "truth": Parameters { offset_n: rig.force_offset_n, skew_s: rig.delay_s, ..Parameters::from(&device) },
        "inerter": found.model(),
        "inerter_s": time_s,
    });
    std::fs::write(path, problem.to_string())?;
    println!("inerter identify: {time_s:.2} s, with validation and intervals");
    Ok(true)
}

/// Whether scipy takes at least this many times longer.
fn compare(path: &Path, faster: &str) -> Result<bool> {
    let read = |path: &Path| -> Result<Value> { Ok(serde_json::from_str(&std::fs::read_to_string(path)?)?) };
    let (problem, scipy) = (read(path)?, read(&path.with_extension("scipy.json"))?);
    let number = |value: &Value, key: &str| value.get(key).and_then(Value::as_f64).ok_or(format!("no {key}"));
    let (ours, theirs) = (number(&problem, "inerter_s")?, number(&scipy, "scipy_s")?);
    let ratio = theirs / ours;
    let least = if scipy["stopped"] == json!(true) { "stopped before its end, so at least " } else { "" };
    println!(
        "inerter: {ours:.2} s; scipy: {theirs:.1} s for {} simulations; {least}{ratio:.0} times",
        scipy["simulations"]
    );
    println!("{:<28} {:>14} {:>14} {:>14} {:>14}", "", "truth", "start", "inerter", "scipy");
    let truths = problem["truth"].as_object().ok_or("no truth")?;
    for (name, truth) in truths {
        let of = |value: &Value| format!("{:.4e}", value.as_f64().unwrap_or(f64::NAN));
        let [start, ours] = ["start", "inerter"].map(|key| of(&problem[key][name]));
        println!("{name:<28} {:>14} {start:>14} {ours:>14} {:>14}", of(truth), of(&scipy["values"][name]));
    }
    Ok(ratio >= faster.parse::<f64>()?)
}
