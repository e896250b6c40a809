//! `cargo xtask defects`: how often a realistic defect makes a value silently wrong, and how often a clean run is
//! reported as broken.

use inerter_tests::{
    defects::{
        DEVELOPMENT,
        judge::{Said, Verdict, is_harmful, run, verdict},
        kinds::{self, Group, Kind},
        made::MOTIONS,
        tally::Tally,
    },
    grid::{Result, each},
    roc::{Curve, svg},
    sheet::{self, Asked, Measured},
};

/// Runs per kind and motion.
const SEEDS: u64 = 2;
/// Clean runs per motion. Those with the first seeds are the defects' runs without the defect.
const CLEAN: u64 = 200;

/// The runs in the order of seeds and motions, whatever thread computed them.
fn runs(kind: Option<&Kind>, seeds: u64) -> Result<Vec<Said>> {
    let mut all = each(0..MOTIONS.len() * seeds as usize, |place| {
        let (motion, seed) = (place % MOTIONS.len(), DEVELOPMENT + 1 + (place / MOTIONS.len()) as u64);
        Ok((place, run(kind, motion, seed)?))
    })?;
    all.sort_by_key(|(place, _)| *place);
    Ok(all.into_iter().map(|(_, said)| said).collect())
}

pub fn measure(asked: Asked) -> Measured {
    let clean = &runs(None, CLEAN)?;
    eprintln!("clean");
    let mut found = Vec::new();
    for kind in kinds::all() {
        let runs = runs(Some(kind), SEEDS)?;
        let silent = runs.iter().filter(|said| verdict(&said.replay, 1.0) == Verdict::Silent).count();
        eprintln!("{}: {silent} of {} wrong without a message", kind.name, runs.len());
        found.push((kind, runs));
    }
    let of_group = |group: Group| found.iter().filter(move |(kind, _)| kind.group == group);
    // Each run with that of the same motion and seed without the defect, which has the same place.
    let pairs = |group: Group| of_group(group).flat_map(move |(_, runs)| runs.iter().zip(clean));
    let defects: Vec<(&Said, &Said)> = pairs(Group::Defect).collect();
    let of_plant = |second: bool| Tally::of(defects.iter().copied().filter(|(said, _)| said.by_second == second));
    let mut text = head(of_group(Group::Defect).count());
    text += "\n## Together\n\n| runs | n | harmful | wrong: reported | assumed | silent | silent % | device alone: silent % | beyond twice: silent % | device alone % |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n";
    for (name, all) in [
        ("defects", Tally::of(defects.iter().copied())),
        ("defects, first plant", of_plant(false)),
        ("defects, second plant", of_plant(true)),
        ("clean", Tally::of(clean.iter().zip(clean))),
        ("wrong scales", Tally::of(pairs(Group::Scale))),
    ] {
        let counts = [all.runs, all.harmful, all.told, all.assumed, all.silent].map(|count| count.to_string());
        let parts = [all.silent, all.device, all.silent_twice, all.device_twice];
        let percents = parts.map(|part| format!("{:.1}", all.percent(part)));
        text += &sheet::row(&[name], counts.into_iter().chain(percents));
    }
    text += &clean_figures(clean);
    for (group, name) in [(Group::Defect, "Kinds"), (Group::Scale, "Wrong scales")] {
        text += &format!(
            "\n## {name}\n\n| kind | n | harmful | wrong: reported | assumed | silent | beyond twice | {} |\n|---|--:|--:|--:|--:|--:|--:|{}\n",
            MOTIONS.join(" | "),
            "--:|".repeat(MOTIONS.len())
        );
        for (kind, runs) in of_group(group) {
            let all = Tally::of(runs.iter().zip(clean));
            let counts = [all.runs, all.harmful, all.told, all.assumed, all.silent, all.silent_twice];
            let of_both = |motion| of_motion(runs, motion).zip(of_motion(clean, motion));
            let by_motion = (0..MOTIONS.len()).map(|motion| Tally::of(of_both(motion)).silent);
            let cells = counts.into_iter().chain(by_motion).map(|count| count.to_string());
            text += &sheet::row(&[kind.name], cells);
        }
    }
    if asked == Asked::Update {
        let harmful = defects.iter().filter(|(said, clean)| is_harmful(said, clean)).map(|(said, _)| *said);
        let usual: Vec<&Said> = clean.iter().collect();
        let path = sheet::write("roc.svg", &characteristic(&usual, &harmful.collect::<Vec<_>>()))?;
        eprintln!("defects: written {}", path.display());
    }
    Ok((text, true))
}

/// Those of the runs that are of this motion.
fn of_motion(runs: &[Said], motion: usize) -> impl Iterator<Item = &Said> {
    runs.iter().skip(motion).step_by(MOTIONS.len())
}

fn head(kinds: usize) -> String {
    format!(
        "# Defects

`cargo xtask defects --update` writes this table and [roc.svg](../roc.svg). They cover {kinds} kinds
of realistic defects of device, force, encoder and sampling, in {} motions with {SEEDS} seeds each
(from {} on). Device, motion, rig and the size of the defect are drawn anew in each run. Of the
runs that both plants can simulate, half come from the second one (`tests/src/defects`). The
settings state no uncertainty of the rig and do not mention the defect.

Clean runs of other seeds set three rules about reversals and stops. What `replay` looks for in the
samples has the shapes of these kinds, and their sizes were looked at on seed 1
([THEORY](../THEORY.md), 17). Nothing else here has set a constant of the estimator. Seeds 1 to {DEVELOPMENT}
were looked at while the defects and the code that judges them were written.

- *wrong*: `inerter replay` gives a value of mt, cf or fc over the whole run whose interval does not
  contain the true value. If the defect changes a parameter during the run, every value that the
  parameter takes counts as true.
- *reported*: each wrong parameter has a message that concerns it: the law is called broken; a cause
  or a friction regime (presliding, Stribeck) is named that moves this parameter; a warning names
  the defect (`clipped_force` for a force that is not clipped does not count); or `moved_by` names
  the defect.
- *assumed*: for at least one wrong parameter the only message is that it assumes the absence of
  this defect (`assumes`). Any run of such a motion has that message.
- *silent*: at least one wrong parameter has no message that concerns it
  (`tests/src/defects/judge.rs`). The tables by kind end with the silent runs of each motion.
  *device alone*: silent by the device's own intervals and messages.
- *harmful*: a fitted value, given or not, is off by more than twice the interval that the same run
  has without the defect.
- *beyond twice*: silent, but only values count that are off by more than twice their interval. By
  chance, 5 % of right values lie outside their interval, so up to 14 % of the runs have one among
  three parameters. Beyond twice the interval it is 1 in 10 000. The row of clean runs therefore
  shows what chance alone contributes to each column.
- *wrong scales* are a separate group. Their samples are exactly those of another device, so they
  cannot reveal the error. Only a stated uncertainty (such as `force_gain_u95`) covers it.
",
        MOTIONS.len(),
        DEVELOPMENT + 1,
    )
}

/// Verdicts on the clean runs.
fn clean_figures(clean: &[Said]) -> String {
    let broken = clean.iter().filter(|said| said.broken).count();
    let words = clean.iter().filter(|said| !said.words.is_empty()).count();
    let by_motion = MOTIONS.iter().enumerate().map(|(motion, name)| {
        let broken = of_motion(clean, motion).filter(|said| said.broken).count();
        format!("{name} {broken}")
    });
    format!(
        "
## Clean runs

| clean runs | called broken | other message |
|---|--:|--:|
| {} | {broken} | {words} |

*other message*: a warning, a cause, a change, or friction called presliding or Stribeck.

Called broken, by motion: {}.
",
        clean.len(),
        by_motion.collect::<Vec<_>>().join(", ")
    )
}

/// The receiver operating characteristic of the law's test, and of all warnings together.
fn characteristic(clean: &[&Said], harmful: &[&Said]) -> String {
    let scores = |all: &[&Said], score: &dyn Fn(&Said) -> f64| all.iter().map(|said| score(said)).collect::<Vec<_>>();
    // A wrong sign breaks the law regardless of the residual.
    let law = |said: &Said| match (said.broken && said.misfit <= 1.0, said.closed) {
        (true, _) => f64::INFINITY,
        (false, true) => said.misfit,
        (false, false) => 0.0,
    };
    let any = |said: &Said| match said.replay.iter().map(|value| value.word).min() {
        Some(Verdict::Told) => f64::INFINITY,
        _ if said.words.is_empty() => said.misfit.min(1.0),
        _ => f64::INFINITY,
    };
    let curve = |name, colour, score: &dyn Fn(&Said) -> f64| {
        Curve::of(name, colour, &scores(clean, score), &scores(harmful, score))
    };
    svg(&[
        curve("law: broken", "#1b6ca8", &law),
        curve("residual alone, even where flanks may part", "#999", &|said| said.misfit),
        curve("any message", "#c0392b", &any),
    ])
}
