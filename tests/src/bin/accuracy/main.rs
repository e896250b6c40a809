//! `cargo xtask accuracy`: the grid as a committed table.
//!
//! Without arguments the table is compared with `docs/tables/accuracy.md`; what differs is listed and the program
//! ends with a failure. `--update` writes the table instead.
#![forbid(unsafe_code)]

mod table;

use inerter_plant::Parameters as Device;
use inerter_tests::grid::{self, Cell, Error, MOTIONS, Motion, RIGS, Rig, Run};
use std::{path::PathBuf, process::ExitCode, thread};
use table::{Row, Section};

/// Runs of each cell.
const SEEDS: u64 = 32;
/// Least part of the published values that must lie within their interval.
const LEAST_COVERAGE: f64 = 0.95;
/// On the worn device.
const WORN: &str = "\
No goals. The structure mass is taken out by `a1 = a2 + F''/ks`, which does not hold while the flanks do not touch: that is
the bias of mt, about 4 % of the structure mass of 1.5 kg, for which the interval holds 5 %. At 1 kHz the impacts of the
flanks are shorter than a sample, and in `multi`, which repeats itself every 2 s, the error repeats as well: ten periods
are worth one, and cf scatters beyond its interval. At 4 kHz it does not.

";

fn main() -> ExitCode {
    inerter_tests::exit_code(run())
}

fn run() -> Result<bool, Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let update = match arguments.as_slice() {
        [] => false,
        [word] if word == "--update" => true,
        _ => return Err("usage: cargo xtask accuracy [--update]".into()),
    };
    let mut sections = Vec::new();
    for rig in &RIGS {
        sections.push(section(&Device::paper(), rig, rig.name, "")?);
    }
    for (rig, words) in RIGS.iter().filter(|rig| rig.force_noise_n == 1.0).zip([WORN, "No goals.\n\n"]) {
        sections.push(section(&Device::worn(), rig, &format!("{}, worn: 0.1 mm of backlash", rig.name), words)?);
    }
    let text = table::markdown(&sections, SEEDS);
    print!("{text}");
    let uncovered: Vec<String> = sections
        .iter()
        .filter(|section| section.has_goals())
        .flat_map(|section| section.under(LEAST_COVERAGE))
        .collect();
    for line in &uncovered {
        eprintln!("{line}");
    }
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/tables/accuracy.md");
    if update {
        std::fs::create_dir_all(path.parent().unwrap_or(&path))?;
        std::fs::write(&path, text).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        println!("accuracy: written {}", path.display());
        return Ok(uncovered.is_empty());
    }
    let committed = std::fs::read_to_string(&path).map_err(|error| {
        format!("cannot read {}: {error}; make it by `cargo xtask accuracy --update`", path.display())
    })?;
    let differences = table::differences(&committed, &text);
    for line in &differences {
        eprintln!("{line}");
    }
    if differences.is_empty() {
        println!("accuracy: as in docs/tables/accuracy.md");
    } else {
        eprintln!(
            "accuracy: {} figures left docs/tables/accuracy.md; when the change is meant, run \
             `cargo xtask accuracy --update` and commit the table",
            differences.len()
        );
    }
    Ok(differences.is_empty() && uncovered.is_empty())
}

fn section(device: &Device, rig: &Rig, name: &str, note: &'static str) -> Result<Section, Error> {
    // What is not understood to the end has no goals.
    let with_goals = note.is_empty();
    let mut rows = Vec::new();
    for motion in &MOTIONS {
        eprintln!("{name}: {}", motion.name);
        let Cell { bias, sigma, u95, given, coverage, whole_run_coverage, settling_s } =
            grid::cell(device, &runs(device, motion, rig)?);
        let least_sigma = grid::least_sigma(device, motion, rig, 1, 0.0)?;
        let kept_sigma = grid::least_sigma(device, motion, rig, 1, motion.kernel_s())?;
        for (i, parameter) in grid::NAMES.into_iter().enumerate() {
            rows.push(Row {
                motion: motion.name,
                parameter,
                bias: bias[i],
                sigma: sigma[i],
                goal: with_goals.then_some(motion.goals[i]),
                least_sigma: least_sigma.map_or(f64::NAN, |least| least[i]),
                kept_sigma: kept_sigma.map_or(f64::NAN, |least| least[i]),
                u95: u95[i],
                coverage: coverage[i],
                whole_run_coverage: whole_run_coverage[i],
                given: given[i],
                settling_s: settling_s[i],
                settling_goal_s: with_goals.then_some(motion.settling_goals_s[i]),
            });
        }
    }
    Ok(Section { name: name.to_owned(), note, rows })
}

/// All runs of one cell, on two threads.
fn runs(device: &Device, motion: &Motion, rig: &Rig) -> Result<Vec<Run>, Error> {
    let part = |from: u64| -> Result<Vec<Run>, Error> {
        (from..=SEEDS).step_by(2).map(|seed| grid::run(device, motion, rig, seed)).collect()
    };
    thread::scope(|scope| {
        let other = scope.spawn(|| part(2));
        let mut runs = part(1)?;
        runs.extend(other.join().map_err(|_| "a run panicked")??);
        Ok(runs)
    })
}
