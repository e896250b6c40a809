//! The parts that are removed from the estimator, one at a time: a passage of its source and its replacement. `host.rs`
//! does the same for the host's computations.
//!
//! The source itself has no switch for this. A passage that is not found exactly once has moved; update this list.

use crate::{copy::Edit, table};
use anyhow::{Context, Result};

/// One part of the estimator that could be left out; neighbours of the same name are left out together.
pub struct Heuristic {
    /// What it does, with its section of docs/THEORY.md.
    pub name: &'static str,
    /// A file below firmware/core/src, or below the folder of the host's list, a passage of it, and its replacement.
    pub edit: Edit,
    /// The test that fails without it, if the runs of the ablation do not show what it is for.
    pub test: Option<&'static str>,
}

pub const fn one(name: &'static str, file: &'static str, text: &'static str, instead: &'static str) -> Heuristic {
    Heuristic { name, edit: (file, text, instead), test: None }
}

pub const fn tested(
    test: &'static str,
    name: &'static str,
    file: &'static str,
    text: &'static str,
    instead: &'static str,
) -> Heuristic {
    Heuristic { test: Some(test), ..one(name, file, text, instead) }
}

/// Writes or compares the table of this name, which `command` makes: below its head, what `line` says of each part from
/// what is `measured` with it and without it.
pub fn settle<M>(
    (name, command, head): (&str, &str, &str),
    parts: &[Heuristic],
    update: bool,
    measured: impl Fn(&[Edit]) -> Result<M>,
    line: impl Fn(&str, &M, &M, Option<&str>) -> Result<String>,
) -> Result<()> {
    let whole = measured(&[])?;
    let mut text = head.to_owned();
    for together in parts.chunk_by(|one, next| one.name == next.name) {
        let Heuristic { name, test, .. } = together[0];
        let edits: Vec<Edit> = together.iter().map(|part| part.edit).collect();
        let without = measured(&edits).with_context(|| format!("without \"{name}\""))?;
        let line = line(name, &whole, &without, test)?;
        println!("{line}");
        text += &(line + "\n");
    }
    table::settle_text(name, command, &text, update)
}

/// What a part contributes: what gets worse without it, or else the test that fails.
pub fn contributes(lost: &[&str], test: Option<&str>) -> String {
    match test {
        _ if !lost.is_empty() => lost.join(", "),
        Some(test) => format!("nothing in these runs; the test `{test}` fails without it"),
        None => "**nothing in these runs**".into(),
    }
}

/// Fails if a passage is not found exactly once in its file below `folder`, or a test in none of the files of `tests`.
#[cfg(test)]
pub fn must_be_found(heuristics: &[Heuristic], folder: &str, tests: &[&str]) {
    use std::fs;
    let root = crate::tree::root();
    let files = tests.iter().flat_map(|folder| fs::read_dir(root.join(folder)).unwrap());
    let paths = files.map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let tests: Vec<String> = paths.map(|path| fs::read_to_string(path).unwrap()).collect();
    for Heuristic { name, edit: (file, text, instead), test } in heuristics {
        let source = fs::read_to_string(root.join(folder).join(file)).unwrap();
        assert_eq!(source.matches(text).count(), 1, "{name}: `{text}` in {file}");
        assert_ne!(text, instead, "{name}");
        let is_written = |test: &str| tests.iter().any(|source| source.contains(&format!("fn {test}(")));
        assert!(test.is_none_or(is_written), "{name}: no test {test:?}");
    }
}

/// In the order of the theory.
pub const HEURISTICS: &[Heuristic] = &[
    tested(
        "a_force_that_jumps_gives_each_sample_all_of_its_sign",
        "2: where the force jumps with the friction, each sample gets its full sign instead of an average",
        "line.rs",
        "feedback.jumps_are_clear && self.jump",
        "false && self.jump",
    ),
    one(
        "2: the velocity that gives the sign is corrected for the smoothing of kink and bend",
        "estimator.rs",
        "let lost = if feedback.coulomb_like && near {",
        "let lost = if false && near {",
    ),
    tested(
        "emps_as_recorded",
        "2: reversals are tested for Coulomb friction",
        "estimator.rs",
        "state.feedback.coulomb_like = state.velocity_reversals.coulomb_like();",
        "state.feedback.coulomb_like = true;",
    ),
    tested(
        "a_reversal_that_may_have_stuck_counts_where_there_is_no_other",
        "2: reversals at which friction may hold the screw count in that test only until others occur",
        "sign.rs",
        "may_be_held && self.free > 0",
        "may_be_held && self.free == u16::MAX",
    ),
    one(
        "2: reversals whose kink the force may hide do not count in that test",
        "estimator.rs",
        "if 2 * u64::from(predicted.unsigned_abs()) >= feedback.kink(m).unsigned_abs() {",
        "if true {",
    ),
    one(
        "2: reversals are relocated by force and friction",
        "estimator.rs",
        "if self.feedback.coulomb_like && self.feedback.friction_known {",
        "if false {",
    ),
    one(
        "2: motion that may be creep is left out until friction is known",
        "estimator.rs",
        "middle.bad |= creeps;",
        "let _ = creeps;",
    ),
    one(
        "3: windows of rest are left out",
        "estimator.rs",
        "line.resting = u16::from(signal.delay) + signal.rest_block;",
        "line.resting = 0;",
    ),
    one(
        "3: grazing reversals under a weak force are left out",
        "estimator.rs",
        "if force.unsigned_abs() < self.feedback.weak_force_code {",
        "if false && force.unsigned_abs() < self.feedback.weak_force_code {",
    ),
    one(
        "3: reversals at which the screw may have stuck are left out",
        "estimator.rs",
        "middle.bad |= middle.may_be_held(feedback);",
        "",
    ),
    tested(
        "a_clean_run_is_not_called_broken",
        "3: samples around a stop at which friction may hold the screw are left out",
        "estimator.rs",
        "line.hold(signal.sign_half_width, signal.codes_per_count, &self.feedback);",
        "",
    ),
    one(
        "1: slow motion is fitted in the slow bank",
        "report.rs",
        "const CLEAR_OF_STEPS: f32 = constants::CLEAR_OF_STEPS as f32;",
        "const CLEAR_OF_STEPS: f32 = 0.0;",
    ),
    tested(
        "emps_with_an_encoder_400_times_as_coarse",
        "1: motion in coarse counts that the slow bank would smooth away is fitted in the fast bank",
        "report.rs",
        "(times(among) && smoothed())",
        "(among.is_nan() && smoothed())",
    ),
    one(
        "6: the bias from the encoder's steps is corrected",
        "fit.rs",
        "*value += all * 0.5 * (1.0 + kept);",
        "let _ = (&value, kept);",
    ),
    tested(
        "what_slow_steps_take_is_known_to_a_half",
        "6: the interval includes half of the full correction of that bias",
        "fit.rs",
        "*steps = magnitude(all) * 0.5;",
        "*steps = 0.0;",
    ),
    one(
        "6: the inertance is withheld where steps are most of the acceleration",
        "fit.rs",
        "if of_itself > MOST_STEPS {",
        "if false && of_itself > MOST_STEPS {",
    ),
    one(
        "6: noise is weighted by the kernel at the motion's frequency",
        "systematic.rs",
        "let kernel = 1.0 / square(square(root));",
        "let kernel = 1.0 + 0.0 * root;",
    ),
    one(
        "6: only a quarter of the steps' share in the scatter counts in a parameter",
        "systematic.rs",
        "const STEPS: f32 = 0.25;",
        "const STEPS: f32 = 1.0;",
    ),
    one(
        "6: encoder steps that repeat with the motion widen the interval",
        "systematic.rs",
        "const MOST_REPEATS: f32 = 8.0;",
        "const MOST_REPEATS: f32 = 1.0;",
    ),
    tested(
        "an_exact_fit_has_an_interval_that_holds_the_mirrored_fit",
        "6: the interval of an exact fit includes its rounding errors",
        "fit.rs",
        "if !is_exact {",
        "if !is_exact || true {",
    ),
    one(
        "6: the residual near rest is compared with that away from rest",
        "regime.rs",
        "const RATIO: f32 = 1.5;",
        "const RATIO: f32 = 1e9;",
    ),
    one(
        "6: a shift by friction near rest that exceeds chance widens the interval",
        "regime.rs",
        "const MOVED: f32 = constants::MOVED as f32;",
        "const MOVED: f32 = 0.0;",
    ),
    one(
        "6: friction that a steady tone may hide widens the interval",
        "regime.rs",
        "const HIDDEN: f32 = 6.0;",
        "const HIDDEN: f32 = 1e9;",
    ),
    one(
        "6: presliding widens the interval of the inertance",
        "regime.rs",
        "const SPRING: f32 = 0.6;",
        "const SPRING: f32 = 0.0;",
    ),
    one(
        "6: negative viscous friction is reported as Stribeck friction",
        "regime.rs",
        "if fc > 0.0 && viscous.value + viscous.u95 < 0.0 {",
        "if false && viscous.u95 < 0.0 {",
    ),
    one(
        "6: impacts of the flanks widen the interval",
        "regime.rs",
        "const IMPACTS: f32 = 0.4;",
        "const IMPACTS: f32 = 0.0;",
    ),
    one(
        "6: a broken law widens intervals, and values with too wide an interval are withheld",
        "regime.rs",
        "const REACH: f32 = 3.1;",
        "const REACH: f32 = 0.0;",
    ),
    one(
        "6: the first judgement restarts both memories if the law is broken",
        "trial.rs",
        "const JUDGED_UPDATES: u32 = 200;",
        "const JUDGED_UPDATES: u32 = u32::MAX;",
    ),
    tested(
        "a_tone_in_coarse_counts_has_its_inertance_within_its_interval",
        "6: the interval allows for a tone's amplitude error from its position relative to the counts",
        "systematic.rs",
        "const AMPLITUDE: f32 = 0.01234;",
        "const AMPLITUDE: f32 = 0.0;",
    ),
    tested(
        "a_slow_tone_of_the_same_clock_breaks_no_law_and_is_within_its_intervals",
        "6: the interval allows for recurring reversals that the same counts misplace",
        "systematic.rs",
        "* motion.reversals_again;",
        "* 0.0;",
    ),
    tested(
        "a_slow_tone_of_the_same_clock_breaks_no_law_and_is_within_its_intervals",
        "6: recurring steps increase the chance variation of the residual",
        "report.rs",
        "* (repeats - 1.0) }",
        "* 0.0 * repeats }",
    ),
    tested(
        "a_clean_run_is_not_called_broken",
        "6: the first judgement waits until it is known whether the flanks part",
        "trial.rs",
        "const WAITED_UPDATES: u32 = 800;",
        "const WAITED_UPDATES: u32 = 0;",
    ),
    one(
        "6: samples at slipped counts are left out",
        "plausible.rs",
        "&& self.slips(bent, force)",
        "&& false && self.slips(bent, force)",
    ),
    one(
        "6: samples with a clipped force are left out",
        "plausible.rs",
        "self.resolution > 0 && self.is_clipped_now(force)",
        "false && self.is_clipped_now(force)",
    ),
    one(
        "6: samples with a dead force are left out",
        "plausible.rs",
        "let dead = self.reversals == DEAD_REVERSALS;",
        "let dead = false; self.reversals = 0;",
    ),
    one(
        "6: a negative inertance is reported as a wrong sign of the force, and no values are given",
        "report.rs",
        "value + u95 < 0.0",
        "value.is_nan() && u95 < 0.0",
    ),
    tested(
        "what_no_impact_leaves_breaks_the_law_whatever_the_flanks_do",
        "6: a residual too large for impacts breaks the law even if the flanks may part",
        "regime.rs",
        "const BEYOND_IMPACTS: f32 = 0.1 * 0.1;",
        "const BEYOND_IMPACTS: f32 = 1e9;",
    ),
    tested(
        "a_wide_gap_is_in_the_interval_of_the_inertance",
        "6: the interval of the inertance includes the structure's motion across the backlash",
        "systematic.rs",
        "const GAP: f32 = 0.45;",
        "const GAP: f32 = 0.0;",
    ),
    tested(
        "a_stiffness_as_wrong_as_it_is_stated_breaks_no_law_and_is_in_the_friction",
        "6: a stiffness that is wrong within its interval does not break the law",
        "systematic.rs",
        "if bent.is_finite() {",
        "if bent < 0.0 {",
    ),
    tested(
        "a_stiffness_as_wrong_as_it_is_stated_breaks_no_law_and_is_in_the_friction",
        "6: the uncertainty of the stiffness widens the intervals of viscous and Coulomb friction",
        "systematic.rs",
        "if per_compliance == 0.0 {",
        "if per_compliance < f32::INFINITY {",
    ),
    one(
        "7: a skew is first undone by whole samples",
        "settings.rs",
        "let whole = (samples + half) as i32;",
        "let whole = (0.0 * (samples + half)) as i32;",
    ),
    tested(
        "each_reversal_tells_its_own_backlash_with_the_sensor",
        "8: samples near a change of the flank are left out",
        "backlash/active.rs",
        "const GUARD_S: f32 = 0.004;",
        "const GUARD_S: f32 = 0.0;",
    ),
    one(
        "8: without the sensor, the interval includes encoder steps that recur with the strokes",
        "backlash/report.rs",
        "let share = (repeats - 1.0) / sums.accepted as f32;",
        "let share: f32 = 0.0;",
    ),
    tested(
        "backlash_of_all_widths_is_found_in_all_motions",
        "8: with the sensor, the intervals include the encoder's steps, in at most 8 patterns",
        "backlash/report.rs",
        "let share = greater((repeats - 1.0) / reversals as f32, 1.0 / patterns);",
        "let share = 0.0 * patterns;",
    ),
    one(
        "8: reversals far from the median are left out",
        "backlash/pool.rs",
        "const OUTLIER: u64 = 35;",
        "const OUTLIER: u64 = 35_000_000;",
    ),
    one(
        "8: without the sensor, the interval of the backlash includes 0.4 of a count",
        "backlash/report.rs",
        "const COUNT_PART: f32 = 0.4;",
        "const COUNT_PART: f32 = 0.0;",
    ),
    one(
        "9: a change of the device restarts both memories",
        "change.rs",
        "self.begins_anew = true;",
        "self.begins_anew = false;",
    ),
];
