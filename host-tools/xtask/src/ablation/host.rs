//! What each part of the host's diagnosis contributes: which cause violates the law, and how a cause too small to be
//! identified affects the intervals. A copy of the whole tree, without one part at a time, is compared with the tree
//! itself on the same runs.

use super::heuristics::{Heuristic, contributes, one, settle, tested};
use crate::{
    copy::{self, Edit},
    process, workspace,
};
use anyhow::{Context, Result};
use std::{
    cmp::Ordering::{self, Greater, Less},
    collections::BTreeMap,
    path::Path,
    process::Command,
};

/// An interval that grows by this factor shows what the part is for: a choice.
const WIDER: f64 = 1.02;
/// A difference of up to this many runs, or per cent, may be chance: a choice.
const BY_CHANCE: f64 = 1.0;

/// Where the sources of [`PARTS`] lie.
const FOLDER: &str = "host-tools/analysis/src/diagnose";

/// In the order of docs/THEORY.md, 14.
const PARTS: &[Heuristic] = &[
    one(
        "reversals are relocated with the causes found",
        "search.rs",
        "Rows::of(aligned, self.law, &self.found,",
        "Rows::of(aligned, self.law, &[],",
    ),
    one(
        "rows are whitened",
        "filter.rs",
        "Sight::White(widest_s) => {",
        "Sight::White(widest_s) if widest_s < 0.0 => {",
    ),
    one("rows are whitened", "filter.rs", "Sight::Box(_) => vec![1.0],", "_ => vec![1.0],"),
    tested(
        "a_cause_is_named_in_stop_and_go",
        "where too few rows remain or steps are too large, other kernels are used",
        "search.rs",
        "if worse.is_empty() || is_fit() {",
        "if worse.is_empty() || is_fit() || true {",
    ),
    one(
        "repeated samples are not counted as independent",
        "filter.rs",
        "1.0 + share * (self.repeats - 1.0)",
        "1.0 + 0.0 * share",
    ),
    tested(
        "what_breaks_the_law",
        "the two adjacent parts of the run with the most evidence are left out",
        "selection.rs",
        "lasting * strength.min(by_scatter)",
        "lasting.max(1.0) * strength.min(by_scatter)",
    ),
    tested(
        "what_wanders_is_no_cause",
        "scatter between the parts of the run weakens the evidence",
        "selection.rs",
        "lasting * strength.min(by_scatter)",
        "lasting * strength.min(by_scatter.max(strength))",
    ),
    tested(
        "a_distance_is_right_in_slow_motion",
        "of three corrections for the encoder's steps, the one with the least evidence counts",
        "selection.rs",
        "const TAKEN: [f64; 3] = [0.0, 1.0, 1.5];",
        "const TAKEN: [f64; 3] = [0.0, 0.0, 0.0];",
    ),
    tested(
        "noise_of_a_slow_motion_is_no_cause",
        "a regressor that is not clear of its noise is not used",
        "selection.rs",
        "const LEAST_OVER_NOISE: f64 = 25.0;",
        "const LEAST_OVER_NOISE: f64 = 0.0;",
    ),
    one(
        "a cause must have a plausible size",
        "candidate.rs",
        "let coulomb_n = coulomb_n.max(0.0);",
        "let coulomb_n = coulomb_n.max(0.0);\n        if coulomb_n >= 0.0 {\n            return true;\n        }",
    ),
    one(
        "causes with more than half of the greatest evidence are tried too",
        "search.rs",
        "const CLOSE: f64 = 0.5;",
        "const CLOSE: f64 = 2.0;",
    ),
    one(
        "causes with more than half of the greatest evidence are tried too",
        "search.rs",
        "let close: Vec<Found> = close.copied().collect();",
        "let close: Vec<Found> = close.copied().chain([*first]).take(1).collect();",
    ),
    tested(
        "of_causes_that_explain_alike_the_simplest_is_named",
        "of causes that explain about the same, the simplest is taken",
        "search.rs",
        "const WORTH: f64 = 8.0;",
        "const WORTH: f64 = 0.0;",
    ),
    tested(
        "nothing_is_named_beside_the_only_cause",
        "each cause is re-tested beside the others and against its possible replacements",
        "search.rs",
        "if !self.weigh(&rows) {",
        "if true {",
    ),
    one(
        "velocities, distances and shapes are refined beside all other causes",
        "found.rs",
        "if term.scale().is_none() {",
        "if true {",
    ),
    tested(
        "the_distance_is_right_where_all_of_friction_turns",
        "all of Coulomb friction may reverse gradually",
        "found.rs",
        "&[false, true] } else { &[false] }",
        "&[false] } else { &[false] }",
    ),
    tested(
        "what_is_beside_a_skew_is_named_too",
        "after a skew is undone, the search restarts",
        "search.rs",
        "const MOST_UNDONE: usize = 6;",
        "const MOST_UNDONE: usize = 1;",
    ),
    one(
        "a skew that other causes explain as well is dropped",
        "search.rs",
        "cause.kind == Kind::Skew && cause.f < LIMIT;",
        "cause.kind == Kind::Skew && cause.f < 0.0;",
    ),
    one(
        "where flanks may part, only clear causes that explain most of the residual are reported",
        "search.rs",
        "filter(|cause| is_most && is_clear(cause))",
        "filter(|cause| is_most || !is_clear(cause) || true)",
    ),
    one(
        "other possible lengths of a turn widen the intervals",
        "fitted.rs",
        "if encoder.counts_per_turn.is_some() {",
        "if true {",
    ),
    one(
        "a shift by a cause too small to be named widens the interval",
        "hidden.rs",
        "const MOVED: [f64; 2] = [1.6, 1.2];",
        "const MOVED: [f64; 2] = [0.0, 0.0];",
    ),
    tested(
        "the_point_on_the_frontier_is_where_90_percent_are_held",
        "the chance variation of that shift widens the interval too",
        "hidden.rs",
        "const MOVED: [f64; 2] = [1.6, 1.2];",
        "const MOVED: [f64; 2] = [1.6, 0.0];",
    ),
    tested(
        "what_is_too_small_to_be_named_widens_the_interval_by_the_samples",
        "a poorly determined cause widens the interval if its shift exceeds twice its chance variation",
        "hidden.rs",
        "let is_moved = is_far || moves.are_told && moved.abs() > CHANCE * chance;",
        "let is_moved = is_far || moves.are_told && moved.abs() < 0.0;",
    ),
    one(
        "a shift far beyond chance widens the interval even if the law leaves little of the cause",
        "hidden.rs",
        "const FAR: f64 = 7.0;",
        "const FAR: f64 = f64::INFINITY;",
    ),
    one(
        "a poorly determined cause is reported as an assumption, and widens the interval only if its shift exceeds chance",
        "hidden.rs",
        "pub const TOLD: f64 = 1.6;",
        "pub const TOLD: f64 = 1e9;",
    ),
    tested(
        "in_a_tone_inertance_rests_on_a_position_that_does_not_give_way",
        "a position that yields to the force is considered as a hidden cause",
        "candidate.rs",
        "all.push(Self::Bent);",
        "",
    ),
    one(
        "a skew and friction that acts at the reversals widen no interval",
        "hidden.rs",
        "!matches!(kind, Kind::Skew | Kind::Stribeck | Kind::Presliding)",
        "kind != Kind::Structure",
    ),
    one(
        "repeated encoder steps count in full in the chance variation",
        "hidden.rs",
        "f64::from(patterns.next().unwrap_or(1.0)) * steps",
        "f64::from(patterns.next().unwrap_or(1.0).min(1.0)) * steps",
    ),
];

/// What the program counts, by name.
type Counts = BTreeMap<String, f64>;

/// A column of the table.
struct Column {
    /// What is counted.
    name: &'static str,
    /// The total of which it is a share [%].
    of: Option<&'static str>,
    /// Whether fewer or more are worse.
    worse: Ordering,
    /// What is lost then.
    lost: &'static str,
}

const COLUMNS: [Column; 8] = [
    Column { name: "first", of: None, worse: Less, lost: "names" },
    Column { name: "sized", of: None, worse: Less, lost: "sizes" },
    Column { name: "right", of: Some("corrected"), worse: Less, lost: "honesty" },
    Column { name: "wrong", of: None, worse: Greater, lost: "no false names" },
    Column { name: "outside", of: Some("given"), worse: Greater, lost: "honesty" },
    Column { name: "unreported", of: Some("given"), worse: Greater, lost: "honesty" },
    Column { name: "assumed", of: Some("given"), worse: Greater, lost: "fewer assumptions" },
    Column { name: WIDTH, of: None, worse: Greater, lost: "sharpness" },
];
/// The one column that is a mean, not a count.
const WIDTH: &str = "width";

/// Builds and runs everything, then writes or compares the table.
pub fn run(update: bool) -> Result<()> {
    let folder = workspace::target()?.join("ablation/host");
    let table = ("ablation-host", "cargo xtask ablation --host", HEAD);
    settle(table, PARTS, update, |edits| measured(&folder, edits), line)
}

/// What the program counts with this host.
fn measured(folder: &Path, edits: &[Edit]) -> Result<Counts> {
    let tree = folder.join("tree");
    copy::tree(&tree, &[])?;
    copy::edit(&tree.join(FOLDER), edits)?;
    let build = folder.join("build");
    process::run(
        process::cargo()
            .current_dir(&tree)
            .env("RUSTFLAGS", "-A warnings")
            .args(["build", "--quiet", "--package", "inerter-tests", "--bin", "measure", "--target-dir"])
            .arg(&build),
    )?;
    counts(&process::output(Command::new(build.join("debug/measure")).arg("ablation_host"))?)
}

fn counts(output: &str) -> Result<Counts> {
    let each = output.lines().map(|line| {
        let (name, count) = line.split_once('\t').with_context(|| format!("`{line}` is not a line of output"))?;
        Ok((name.to_owned(), count.parse()?))
    });
    each.collect()
}

fn line(name: &str, whole: &Counts, without: &Counts, test: Option<&str>) -> Result<String> {
    let (mut cells, mut lost) = (Vec::new(), Vec::new());
    for Column { name: column, of, worse, lost: what } in COLUMNS {
        let value = |counts: &Counts| -> Result<f64> {
            let count =
                |name: &str| counts.get(name).copied().with_context(|| format!("the program counts no `{name}`"));
            match of {
                Some(of) => Ok(100.0 * count(column)? / count(of)?.max(1.0)),
                None => count(column),
            }
        };
        let [before, after] = [value(whole)?, value(without)?];
        // Smaller differences are ignored.
        let chance = if column == WIDTH { (WIDER - 1.0) * before } else { BY_CHANCE };
        let bound = if worse == Less { before - chance } else { before + chance };
        if after.partial_cmp(&bound) == Some(worse) && !lost.contains(&what) {
            lost.push(what);
        }
        cells.push(match of {
            _ if column == WIDTH => format!("{:.2}", after / before),
            Some(_) => format!("{before:.1} to {after:.1}"),
            None => format!("{before} to {after}"),
        });
    }
    Ok(format!("| {name} | {} | {} |", cells.join(" | "), contributes(&lost, test)))
}

const HEAD: &str = "# Ablation of the host's diagnosis

Written by `cargo xtask ablation --host --update`. Each row compares `diagnose`, and the intervals
of `replay`, without one part with the complete program, on the same runs
(`tests/src/measure/ablation_host.rs`: four motions, a seed that no other table uses). For each row
a copy of the tree is edited and built (`host-tools/xtask/src/ablation/host.rs`). Where a column has
two figures, the first is with the part, the second without it.

- *first*: runs whose fault is named before any other cause. *sized*: those of them whose size is
  right to 10 %. *right*: of the parameters that the *first* runs give with the causes included,
  those within their intervals [%].
- *wrong*: runs whose first named cause is not present, with or without a fault.
- *outside*, *unreported*, *assumed* and *width* are of runs with a true or nearly true law in which
  no cause and no broken law is reported. *outside*: parameters whose true value is outside the
  interval from the samples [%]. *unreported*: those for which the absence of the fault is not
  listed as an assumption either [% of all]. *assumed*: parameters for which any assumption is
  listed [%]. *width*: the intervals from the samples without the part over those with it, geometric
  mean.
- *contributes*: what gets worse without the part. *names*: fewer faults are named first. *sizes*:
  fewer sizes are right. *honesty*: fewer parameters are within their intervals, or more are outside
  or unreported. *no false names*: more causes are wrong. *fewer assumptions*: more parameters have
  one. *sharpness*: wider intervals. Small changes may be chance and do not count (`WIDER` and
  `BY_CHANCE` in `host.rs`). *nothing in these runs*: the part may be superfluous, or these runs
  lack the case that it is for: slow motion, other rates and rotary machines are not among them.

| without this part | first | sized | right % | wrong | outside % | unreported % | assumed % | width | contributes |
|---|--:|--:|--:|--:|--:|--:|--:|--:|---|
";

#[cfg(test)]
mod tests {
    use super::{super::heuristics::must_be_found, *};

    #[test]
    fn each_text_is_found_once() {
        must_be_found(PARTS, FOLDER, &["tests/tests", "tests/src/measure"]);
    }

    #[test]
    fn what_is_lost_is_named_once() {
        let counted = |first: u32, right: u32, wrong: u32, outside: u32, width: f64| {
            let text = format!(
                "first\t{first}\nsized\t30\ncorrected\t90\nright\t{right}\nwrong\t{wrong}\ngiven\t100\n\
                 outside\t{outside}\nunreported\t{outside}\nassumed\t50\nwidth\t{width}\n"
            );
            counts(&text).unwrap()
        };
        let whole = counted(40, 80, 1, 5, 1.2);
        let told = |without| line("x", &whole, &without, None).unwrap();
        assert!(told(counted(39, 80, 2, 6, 1.21)).ends_with("| **nothing in these runs** |"));
        let worse = told(counted(30, 60, 4, 20, 1.5));
        assert!(worse.ends_with("| names, honesty, no false names, sharpness |"), "{worse}");
        assert!(worse.contains("| 40 to 30 |") && worse.contains("| 5.0 to 20.0 |") && worse.contains("| 1.25 |"));
        assert!(line("x", &whole, &Counts::new(), None).is_err() && counts("first 3\n").is_err());
    }
}
