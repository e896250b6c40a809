//! Everything that continuous integration runs, in order, with a summary at the end.

use crate::{
    firmware, foreign, process, setup,
    toolchain::Toolchain,
    tree,
    workspace::{self, Part, skipped_list},
};
use anyhow::{Context, Result, bail};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::Command,
    sync::mpsc,
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use Outcome::{Failed, Passed, Skipped};
use When::{Always, Full, NotQuick, Quick};

#[derive(clap::Args, Default)]
pub struct Options {
    /// Only formatting, imports, lints, unit tests and the estimator's closed loop, for use between edits
    #[arg(long)]
    quick: bool,
    /// Also run fuzzing, chaos and soak, and measure whole tables (budget: 80 minutes)
    #[arg(long, conflicts_with = "quick")]
    full: bool,
    /// Stop at the first step that fails
    #[arg(long)]
    fail_fast: bool,
}

impl Options {
    /// Time budget of all steps on two processors in a clean clone, with `--quick` in a warm one \[min\].
    const fn budget_min(&self) -> u64 {
        match (self.quick, self.full) {
            (true, _) => 3,
            (false, false) => 25,
            (false, true) => 80,
        }
    }
}

/// Time that a step took.
#[derive(Debug, PartialEq)]
struct Taken {
    /// Wall-clock time.
    time: Duration,
    /// CPU time of all processors together.
    processor: Duration,
}

/// How a step ended.
#[derive(Debug, PartialEq)]
enum Outcome {
    Passed(Taken),
    Failed(Taken, String),
    Skipped(&'static str),
}

/// In which forms of the suite a step runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum When {
    Always,
    /// Left out by `--quick`.
    NotQuick,
    /// With `--quick` only.
    Quick,
    /// With `--full` only.
    Full,
}

/// One step of the suite.
struct Step {
    name: &'static str,
    /// The command that runs this step alone.
    alone: &'static str,
    /// If it fails, the later steps are pointless.
    needed: bool,
    when: When,
    /// Time budget on two processors in a clean clone, or where it runs with `--quick` only, in a warm one \[s\]; `None`
    /// if it runs in parallel with others.
    budget_s: Option<u64>,
    /// How it runs in this process, if not by its own command.
    run: Option<fn() -> Result<()>>,
}

/// A step that the others wait for; it runs by its own command, in this process.
const fn own(when: When, budget_s: u64, name: &'static str, alone: &'static str) -> Step {
    Step { name, alone, needed: false, when, budget_s: Some(budget_s), run: None }
}

/// The same by a function.
const fn here(when: When, budget_s: u64, name: &'static str, alone: &'static str, run: fn() -> Result<()>) -> Step {
    Step { run: Some(run), ..own(when, budget_s, name, alone) }
}

/// A step that runs by its own command, at the lowest priority, in parallel with the following steps: tests that wait
/// for wall-clock time leave processors idle. Its output is shown at the end.
const fn beside(when: When, name: &'static str, alone: &'static str) -> Step {
    Step { budget_s: None, ..own(when, 0, name, alone) }
}

/// Without this step the later ones are pointless.
const fn needed(step: Step) -> Step {
    Step { needed: true, ..step }
}

const LIBRARIES: &[&str] = &["inerter-core", "inerter-wire", "inerter-app", "ads131m04"];

/// Features of the board's image besides the default ones; each set must compile.
const OTHER_BOARDS: &[&str] = &["board-weact", "board-nucleo,hang"];

const STEPS: &[Step] = &[
    // `cargo xtask setup` would also print the version of Rust, and that everything is there.
    needed(here(Always, 5, "set-up", "cargo xtask setup", || setup::ensure(setup::ALL, false))),
    needed(here(Always, 5, "lock files", "cargo metadata --locked", || {
        Part::each(|part| workspace::metadata(&part.folder()).map(drop))
    })),
    here(Always, 10, "formatting", "cargo fmt --all --check", || {
        Part::each(|part| process::run(part.cargo().args(["fmt", "--all", "--check"])))
    }),
    own(Always, 15, "arrows", "cargo xtask check-arrows"),
    own(NotQuick, 10, "supply", "cargo xtask check-supply"),
    // No synchronisation is needed: whatever runs an image builds it, and waits for a build in progress.
    beside(NotQuick, "firmware", "cargo xtask build-firmware"),
    here(Always, 200, "lints, host", "cargo clippy --workspace --all-targets -- -D warnings", || {
        Part::each(|part| lint_all(&mut part.whole("clippy")))
    }),
    here(
        Quick,
        90,
        "unit tests, closed loop",
        "cargo test-lean --lib --bins, and `cargo test-lean --test closed_loop`",
        || {
            let chosen = [&["--lib", "--bins"][..], &["--test", "closed_loop"]];
            chosen.into_iter().try_for_each(|chosen| process::run(Part::Main.all("test").args(chosen)))
        },
    ),
    here(
        NotQuick,
        60,
        "lints, firmware",
        "cargo clippy -p inerter-qemu -p inerter-stm32g474 --target thumbv7em-none-eabihf -- -D warnings",
        lint_firmware,
    ),
    here(
        NotQuick,
        60,
        "documentation",
        "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --lib --examples",
        document,
    ),
    needed(here(NotQuick, 420, "tests, compiled", "cargo test-lean --no-run", || {
        Part::each(|part| process::run(part.all("test").arg("--no-run")))
    })),
    own(NotQuick, 15, "Linux guest", "cargo xtask guest"),
    beside(NotQuick, "endurance", "cargo xtask endurance 20000000"),
    beside(NotQuick, "no panic in the estimator", "cargo xtask check-panics"),
    beside(NotQuick, "table of sizes", "cargo xtask size"),
    beside(NotQuick, "table of instructions", "cargo xtask icount"),
    beside(NotQuick, "table of accuracy", "cargo xtask accuracy --short"),
    beside(NotQuick, "table of changes", "cargo xtask changes --short"),
    beside(NotQuick, "table of robustness", "cargo xtask robustness"),
    // Before the tests: these leave a processor to the steps in parallel.
    own(NotQuick, 20, "Python", "cargo xtask python"),
    own(NotQuick, 180, "Python package", "cargo xtask wheel --debug"),
    here(NotQuick, 500, "tests", "cargo test-lean", test),
    here(
        Full,
        480,
        "tests, probe",
        "cargo test -p inerter -p inerter-device, and `cargo test -p inerter --no-default-features --test transcripts`",
        test_probe,
    ),
    here(Full, 420, "tests of the twin, long", "cargo test -- --ignored, in tests/twin", test_twin_long),
    here(
        Full,
        120,
        "properties, other cases",
        "PROPTEST_RNG_SEED=N cargo test-lean --lib --test app --test closed_loop --test robust --test wire",
        test_other_cases,
    ),
    here(
        Full,
        240,
        "lints, other features",
        "cargo clippy -p inerter --no-default-features --features FEATURE",
        lint_other_features,
    ),
    own(Full, 420, "Python package, release", "cargo xtask wheel"),
    beside(Full, "whole table of accuracy", "cargo xtask accuracy"),
    beside(Full, "whole table of changes", "cargo xtask changes"),
    own(Full, 540, "fuzzing", "cargo xtask fuzz"),
    own(Full, 780, "chaos", "cargo xtask chaos"),
    own(Full, 300, "soak", "cargo xtask soak"),
];

/// Runs a command line of this program in this process.
pub type Own = fn(&str) -> Result<()>;

/// Runs the steps and prints one line for each at the end.
pub fn run(options: &Options, run_own: Own) -> Result<()> {
    let list = skipped_list()?;
    // Without what an earlier run skipped.
    tree::write(&list, "")?;
    let start = Instant::now();
    let outcomes = run_steps(STEPS, options, run_own);
    println!("\n{}\n{}", summary(STEPS, &outcomes, start.elapsed(), options.budget_min()), skips(&list)?);
    let failed: Vec<_> = STEPS
        .iter()
        .zip(&outcomes)
        .filter(|(_, outcome)| matches!(outcome, Failed(..)))
        .map(|(step, _)| format!("{} (alone: `{}`)", step.name, step.alone))
        .collect();
    if !failed.is_empty() {
        bail!("failed: {}", failed.join("; "));
    }
    Ok(())
}

/// Command lines of the steps that run by their own.
#[cfg(test)]
pub fn own_commands() -> impl Iterator<Item = &'static str> {
    STEPS.iter().filter(|step| step.run.is_none()).map(|step| step.alone)
}

fn run_steps(steps: &[Step], options: &Options, run_own: Own) -> Vec<Outcome> {
    thread::scope(|scope| {
        let (sender, queue) = mpsc::channel::<(usize, &Step)>();
        let beside = scope.spawn(move || -> Vec<(usize, Outcome)> {
            queue.into_iter().map(|(place, step)| (place, outcome(step, || run_beside(step)))).collect()
        });
        let mut outcomes = Vec::new();
        let mut stopped = false;
        for (place, step) in steps.iter().enumerate() {
            outcomes.push(match step.budget_s {
                _ if stopped => Skipped("an earlier step failed"),
                _ if options.quick && !matches!(step.when, Always | Quick) => Skipped("left out by --quick"),
                _ if !options.quick && step.when == Quick => Skipped("with --quick only"),
                _ if !options.full && step.when == Full => Skipped("with --full only"),
                _ if options.full && step.alone.ends_with(" --short") => Skipped("measured whole, below"),
                None => {
                    // Fails only after a panic, which is passed on below.
                    let _ = sender.send((place, step));
                    Skipped("did not end")
                }
                Some(_) => {
                    process::heading(step.name);
                    let outcome = outcome(step, || step.run.map_or_else(|| run_own(step.alone), |run| run()));
                    stopped = matches!(outcome, Failed(..)) && (step.needed || options.fail_fast);
                    outcome
                }
            });
        }
        drop(sender);
        for (place, outcome) in beside.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)) {
            if let (Some(step), Some(own)) = (steps.get(place), outcomes.get_mut(place)) {
                process::heading(step.name);
                println!("{}", said_beside(step).and_then(tree::text).unwrap_or_default());
                *own = outcome;
            }
        }
        outcomes
    })
}

fn outcome(step: &Step, run: impl FnOnce() -> Result<()>) -> Outcome {
    let (start, spent) = (Instant::now(), process::spent());
    let result = run();
    let taken = Taken { time: start.elapsed(), processor: process::spent() - spent };
    match result {
        Ok(()) => Passed(taken),
        Err(error) => {
            eprintln!("{}: {error:#}", step.name);
            Failed(taken, format!("{error:#}"))
        }
    }
}

/// Runs a step by its own command, a command of this program.
fn run_beside(step: &Step) -> Result<()> {
    let program = std::env::current_exe().context("where this program lies")?;
    let mut command = if cfg!(unix) {
        let mut command = Command::new("nice");
        command.args(["-n", "19"]).arg(program);
        command
    } else {
        Command::new(program)
    };
    let arguments = step.alone.strip_prefix("cargo xtask ").with_context(|| format!("`{}` is not ours", step.alone))?;
    let file = said_beside(step)?;
    println!("{} runs beside what comes next; its output is in {}", step.name, file.display());
    process::run_into(command.args(arguments.split(' ')), &file)
}

fn said_beside(step: &Step) -> Result<PathBuf> {
    let name = step.name.replace(' ', "-");
    Ok(workspace::target()?.join(format!("{name}.txt")))
}

/// A line for each step: its wall-clock time, its CPU time and, for steps that delay the others, its budget; finally
/// the total `time`, with its budget.
fn summary(steps: &[Step], outcomes: &[Outcome], time: Duration, budget_min: u64) -> String {
    let mut lines = vec![format!("{:36} {:>9} {:>9} {:>9}", "", "time", "budget", "processor")];
    let mut processor = Duration::ZERO;
    for (step, outcome) in steps.iter().zip(outcomes) {
        let name = step.name;
        let mut took = |taken: &Taken| {
            processor += taken.processor;
            let budget = step.budget_s.map_or(String::new(), |budget| format!("{budget} s"));
            format!(
                "{name:<26} {:>7.1} s {budget:>9} {:>7.1} s",
                taken.time.as_secs_f64(),
                taken.processor.as_secs_f64()
            )
        };
        lines.push(match outcome {
            Passed(taken) => {
                let over = step.budget_s.is_some_and(|budget| taken.time > Duration::from_secs(budget));
                format!("  passed  {}{}", took(taken), if over { "  over its budget" } else { "" })
            }
            Skipped(reason) => format!("  skipped {name:<26} {reason}"),
            Failed(taken, reason) => {
                format!("  FAILED  {}  {}", took(taken), reason.lines().next().unwrap_or_default())
            }
        });
    }
    let minutes = |time: Duration| time.as_secs_f64() / 60.0;
    let over = if time > Duration::from_secs(60 * budget_min) { ", over its budget" } else { "" };
    lines.push(format!(
        "{:.1} min of {budget_min}{over}; {:.1} min of processor time",
        minutes(time),
        minutes(processor)
    ));
    lines.join("\n")
}

/// With other features: everything with none, the program with none and with each alone, and two libraries as others
/// use them.
fn lint_other_features() -> Result<()> {
    lint_one("inerter", &["--no-default-features"])?;
    let none = ["--no-default-features", "--features", "inerter-device/probe,inerter-stm32g474/board-nucleo"];
    lint_all(Part::Main.whole("clippy").args(none))?;
    for feature in ["probe", "bridges", "reports", "screen", "tables", "s3"] {
        lint_one("inerter", &["--no-default-features", "--features", feature])?;
    }
    lint_one("inerter-core", &["--features", "defmt,serde"])?;
    lint_one("inerter-data", &[])
}

fn lint_all(command: &mut Command) -> Result<()> {
    process::run(command.args(["--all-targets", "--", "--deny", "warnings"]))
}

fn lint_one(package: &str, features: &[&str]) -> Result<()> {
    let clippy = ["clippy", "--locked", "--package", package];
    process::run(process::cargo().args(clippy).args(features).args(["--", "--deny", "warnings"]))
}

fn lint_firmware() -> Result<()> {
    let Some(toolchain) = Toolchain::find() else { bail!("no compiler for the firmware") };
    if !toolchain.is_own() {
        let reason = "the distribution's compiler builds the firmware here, and this clippy belongs to another";
        return inerter_needs::list(&skipped_list()?, "lints, firmware", reason).context("the list of skipped tests");
    }
    let lint = |arguments: &[&str]| process::run(&mut toolchain.clippy(arguments));
    let packages = LIBRARIES.iter().chain(tree::FIRMWARE_PACKAGES);
    lint(&packages.flat_map(|package| ["--package", *package]).collect::<Vec<_>>())?;
    foreign::lint(&toolchain)?;
    // As firmware by others would use core.
    lint(&["--package", "inerter-core", "--example", "firmware"])?;
    OTHER_BOARDS.iter().try_for_each(|features| {
        lint(&["--package", "inerter-stm32g474", "--no-default-features", "--features", features])
    })
}

/// Tests the program as released, whose library for probes takes minutes to compile, and the transcript of the smallest
/// one.
fn test_probe() -> Result<()> {
    for arguments in [
        &["--package", "inerter", "--package", "inerter-device"][..],
        &["--package", "inerter", "--no-default-features", "--test", "transcripts"],
    ] {
        process::run(process::cargo().args(["test", "--locked", "--no-fail-fast"]).args(arguments))?;
    }
    Ok(())
}

/// The property tests with new random cases, while `.cargo/config.toml` fixes the cases for all other runs.
fn test_other_cases() -> Result<()> {
    let seed = SystemTime::now().duration_since(UNIX_EPOCH).context("the clock is before 1970")?.as_secs();
    println!("PROPTEST_RNG_SEED={seed}");
    let programs = ["--lib", "--test", "app", "--test", "closed_loop", "--test", "robust", "--test", "wire"];
    process::run(Part::Main.all("test").args(programs).env("PROPTEST_RNG_SEED", seed.to_string()))
}

/// In the main workspace including examples: cargo then enables the same features of dependencies as for the lints, and
/// does not check any again. Programs with the same name as their library are left out, because their page is the same.
fn document() -> Result<()> {
    const LIBRARIES: &[&str] = &["--lib", "--examples"];
    const PROGRAMS: &[&str] =
        &["--bins", "--examples", "--exclude", "inerter-originals", "--exclude", "inerter-stm32g474"];
    Part::each(|part| {
        let all: &[&[&str]] = if part == Part::Main { &[LIBRARIES, PROGRAMS] } else { &[&[]] };
        all.iter().try_for_each(|chosen| {
            process::run(part.whole("doc").arg("--no-deps").args(*chosen).env("RUSTDOCFLAGS", "-D warnings"))
        })
    })
}

/// All tests. Everything that this command makes or installs is required; recordings of real machines are required if
/// their folder exists.
///
/// Most of the twin's tests wait for wall-clock time, so they run in parallel with all others.
fn test() -> Result<()> {
    let (images, list) = (firmware::build_all()?, skipped_list()?);
    let tests = |part: Part| tests(part, &images, &list);
    let said = list.with_file_name("twin-tests.txt");
    println!("the twin's tests run beside these; their output comes at the end, until then in {}", said.display());
    thread::scope(|scope| {
        let twin = scope.spawn(|| (process::run_into(&mut tests(Part::Twin), &said), process::spent()));
        let others = Part::each(|part| if part == Part::Twin { Ok(()) } else { process::run(&mut tests(part)) });
        let (twin, spent) = twin.join().map_err(|_| anyhow::anyhow!("the twin's tests could not be started"))?;
        process::count(spent);
        println!("\n{}", tree::text(&said)?);
        match (others, twin) {
            (Err(others), Err(twin)) => bail!("{others:#}; {twin:#}"),
            (others, twin) => others.and(twin),
        }
    })
}

/// The twin's long tests: those that repeat a shorter one with another rate, motion or fault, and updates over a real
/// kernel's USB.
fn test_twin_long() -> Result<()> {
    // Another step leaves the program there with fewer features.
    workspace::tested(Part::Main, "inerter")?;
    process::run(tests(Part::Twin, &firmware::build_all()?, &skipped_list()?).args(["--", "--ignored"]))
}

fn tests(part: Part, images: &[(&str, PathBuf)], list: &Path) -> Command {
    let mut command = part.all("test");
    command.envs(images.iter().map(|(variable, path)| (variable, path)));
    command.arg("--no-fail-fast").env(inerter_needs::REQUIRED, "1").env(inerter_needs::LIST, list);
    command
}

/// How many tests were skipped, and each with its reason, once: a test may miss several things.
fn skips(list: &Path) -> Result<String> {
    let text = tree::text(list)?;
    let skipped: BTreeSet<&str> = text.lines().collect();
    let colon = if skipped.is_empty() { "" } else { ":" };
    let lines: String = skipped.iter().map(|line| format!("\n  {line}")).collect();
    Ok(format!("{} skipped{colon}{lines}", skipped.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(name: &'static str, needed: bool, when: When, run: fn() -> Result<()>) -> Step {
        Step { needed, ..here(when, 0, name, "", run) }
    }

    fn run_steps(steps: &[Step], options: &Options) -> Vec<Outcome> {
        super::run_steps(steps, options, |line| bail!("own: {line}"))
    }

    #[test]
    fn a_step_without_a_function_runs_by_its_own_command() {
        let outcomes = run_steps(&[own(Always, 1, "one", "cargo xtask one")], &Options::default());
        assert!(matches!(&outcomes[0], Failed(_, why) if why == "own: cargo xtask one"), "{outcomes:?}");
    }

    #[test]
    fn a_failing_step_is_named_and_the_others_still_run() {
        let steps = [
            step("one", false, Always, || bail!("broken\nin detail")),
            step("two", true, Always, || bail!("needed")),
            step("three", false, Always, || Ok(())),
        ];
        let outcomes = run_steps(&steps, &Options::default());
        assert!(matches!(outcomes[0], Failed(..)) && matches!(outcomes[1], Failed(..)));
        assert_eq!(outcomes[2], Skipped("an earlier step failed"));
        let text = summary(&steps, &outcomes, Duration::ZERO, 25);
        assert!(text.contains("FAILED  one") && text.contains("broken") && !text.contains("in detail"), "{text}");
    }

    #[test]
    fn a_budget_is_shown_and_all_are_25_or_80_minutes() {
        let long = own(Always, 1, "long", "");
        let taken = |time| Passed(Taken { time: Duration::from_secs(time), processor: Duration::from_secs(90) });
        let text = summary(&[long], &[taken(2)], Duration::from_secs(60), 1);
        assert!(text.contains("2.0 s") && text.contains("90.0 s  over its budget"), "{text}");
        assert!(text.ends_with("1.0 min of 1; 1.5 min of processor time"), "{text}");
        let text = summary(&[], &[], Duration::from_secs(61), 1);
        assert!(text.ends_with("1.0 min of 1, over its budget; 0.0 min of processor time"), "{text}");
        for full in [false, true] {
            let run = |step: &&Step| step.when != Quick && (full || step.when != Full);
            let budget_s: u64 = STEPS.iter().filter(run).filter_map(|step| step.budget_s).sum();
            assert_eq!(budget_s, 60 * Options { full, ..Options::default() }.budget_min());
        }
    }

    #[test]
    fn what_is_left_out_is_named() {
        let told = |steps: &[Step], options: Options| summary(steps, &run_steps(steps, &options), Duration::ZERO, 25);
        let long = [step("long one", false, NotQuick, || bail!("must not run"))];
        let text = told(&long, Options { quick: true, ..Options::default() });
        assert!(text.contains("skipped long one                   left out by --quick"), "{text}");
        let campaign = [step("campaign", false, Full, || bail!("lost a sample"))];
        let text = told(&campaign, Options::default());
        assert!(text.contains("skipped campaign                   with --full only"), "{text}");
        let outcomes = run_steps(&campaign, &Options { full: true, ..Options::default() });
        assert!(matches!(outcomes[0], Failed(..)), "{outcomes:?}");
    }

    #[test]
    fn what_was_skipped_is_counted_and_named_once() {
        let list = std::env::temp_dir().join(format!("xtask-skipped-{}", std::process::id()));
        tree::write(&list, "").unwrap();
        assert_eq!(skips(&list).unwrap(), "0 skipped");
        for (name, reason) in [("sums: emps", "no recordings"), ("lodz", "no recordings"), ("lodz", "no recordings")] {
            inerter_needs::list(&list, name, reason).unwrap();
        }
        let text = skips(&list).unwrap();
        assert_eq!(text, "2 skipped:\n  lodz (no recordings)\n  sums: emps (no recordings)");
        std::fs::remove_file(&list).unwrap();
    }

    #[test]
    fn a_step_beside_the_others_counts_as_they_do() {
        let beside = |alone| beside(Always, "a test beside", alone);
        for (alone, reason) in [("cargo fmt", "not ours"), ("cargo xtask --no-such-option", "failed")] {
            let steps = [beside(alone), step("two", false, Always, || Ok(()))];
            let outcomes = run_steps(&steps, &Options::default());
            assert!(matches!(&outcomes[0], Failed(_, why) if why.contains(reason)), "{outcomes:?}");
            assert!(matches!(outcomes[1], Passed(_)), "{outcomes:?}");
        }
        std::fs::remove_file(said_beside(&beside("")).unwrap()).unwrap();
        assert!(STEPS.iter().all(|step| step.budget_s.is_some() || !step.needed));
    }

    #[test]
    fn fail_fast_stops() {
        let steps = [step("one", false, Always, || bail!("broken")), step("two", false, Always, || Ok(()))];
        let outcomes = run_steps(&steps, &Options { fail_fast: true, ..Options::default() });
        assert!(matches!(outcomes[1], Skipped(_)));
    }
}
