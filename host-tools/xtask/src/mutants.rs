//! Mutation testing: which faults in core, wire and app their own tests would miss.
//!
//! `cargo-mutants` changes the source in one place at a time and runs the package's tests. A change that no test
//! notices is a *survivor*. One that only a golden notices is listed separately: a golden says that something has
//! changed, not that it is wrong. Nothing is left out: a source that hides mutants with `#[mutants::skip]` is refused.
//!
//! The changes are made in a copy of the tree below `target/mutants`, which is kept. So core and third-party packages
//! are compiled once, and only the package and its tests for each change.
//!
//! The work continues file by file: `tests/mutants/PACKAGE.md` has a row for each source file that was tested, with a
//! checksum of its code. A run takes the files that have no row, or have changed since, and writes the table after
//! each, so it can be stopped at any time. Reasons written beside a survivor are kept. For a package that would take
//! days, `--sample` tests every Nth mutant, evenly over all files; `--from` starts at another mutant, which gives
//! another sample.

use crate::{copy, process, source, table, tool, tree, workspace};
use anyhow::{Context, Result, anyhow, ensure};
use proc_macro2::TokenStream;
use sha2::{Digest, Sha256};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    num::NonZeroUsize,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

#[derive(clap::Args)]
pub struct Options {
    /// Test this package alone: core, wire or app
    package: Option<String>,
    /// Start no further file after so many minutes
    #[arg(long, value_name = "N")]
    minutes: Option<u64>,
    /// Test this file alone, changed or not
    #[arg(long, value_name = "FILE", requires = "package")]
    file: Option<String>,
    /// Test every Nth mutant of the package, whatever file it is in
    #[arg(long, value_name = "N", requires = "package", conflicts_with = "file")]
    sample: Option<NonZeroUsize>,
    /// Start the sample with this mutant, counted from 0: another sample than the one that guided the tests
    #[arg(long, value_name = "K", requires = "sample", default_value_t = 0)]
    from: usize,
    /// Print what is left to do, and test nothing
    #[arg(long)]
    status: bool,
}

/// A package and its tests.
struct Package {
    name: &'static str,
    /// Parts of the names of its goldens: tests that compare with committed files.
    goldens: &'static [&'static str],
    /// Parts of the names of its slow tests, which run only on mutants that the others miss.
    slow: &'static [&'static str],
}

const PACKAGES: [Package; 3] = [
    Package { name: "core", goldens: &[], slow: &[] },
    Package {
        name: "wire",
        goldens: &["both_ways", "document_is_up_to_date"],
        slow: &["every_single_byte", "any_damage"],
    },
    Package {
        name: "app",
        goldens: &[],
        slow: &["power_may_fail_again", "power_failure_anywhere", "any_content_is_survived"],
    },
];

/// Parts of the names of the tests that a pass skips.
type Skipped = Vec<&'static str>;

/// CPU time limit of one compiler or test process \[s\]. A test that takes more would never end, and counts as caught;
/// a mutant that the compiler does not finish does not compile, and is left out. CPU time rather than wall-clock time:
/// on a busy machine everything would be too slow, and would count as caught.
const CPU_S: &str = "60";
/// Address space limit of one compiler or test process \[KB\]: some tests that never end allocate all memory.
const SPACE_KB: &str = "8000000";
/// Time limit to compile or to test one mutant \[s\], for those that wait forever.
const WAIT_S: &str = "1200";

/// Share of the mutants that tests should catch \[%\].
const GOAL: f64 = 95.0;
/// Placeholder until somebody writes why a survivor is acceptable.
const NO_REASON: &str = "no reason yet";

/// The mutants of a package that are tested together.
struct Scope {
    /// The file, or the name of the sample in the table.
    name: String,
    /// How `cargo-mutants` selects them.
    arguments: Vec<String>,
}

impl Scope {
    fn file(name: String) -> Self {
        Self { arguments: vec!["--file".into(), name.clone()], name }
    }

    /// Every Nth of all mutants, from a given first one.
    fn sample(every: NonZeroUsize, from: usize) -> Self {
        let start = if from > 0 { format!(" from {from}") } else { String::new() };
        let shard = ["--shard", &format!("{from}/{every}"), "--sharding", "round-robin"].map(str::to_owned);
        Self { name: format!("{SAMPLE}{every}{start}"), arguments: shard.into() }
    }

    /// The changes, without their positions in the file, which move, and without the file if there is only one.
    fn without_places(&self, lines: &[String]) -> Vec<String> {
        let without = |line: &String| {
            let (place, change) = line.split_once(": ").unwrap_or_default();
            match place.split(':').next() {
                Some(file) if is_sample(&self.name) => format!("{file}: {change}"),
                _ => change.to_owned(),
            }
        };
        lines.iter().map(without).collect()
    }
}

/// Prefix of a sample's name in the table.
const SAMPLE: &str = "one mutant of ";

fn is_sample(name: &str) -> bool {
    name.starts_with(SAMPLE)
}

/// What one pass finds out about its mutants: lines with file, position and change.
struct Outcomes {
    /// Caught by a test that failed or never ended.
    caught: Vec<String>,
    missed: Vec<String>,
}

/// Results for the mutants of one file, or of a sample.
#[derive(Debug, Default, PartialEq)]
struct Tested {
    /// Checksum of the source when it was tested.
    sum: String,
    /// How many were caught by a test that is no golden.
    caught: usize,
    /// Those that only a golden catches.
    golden: Vec<String>,
    /// Each with its reason.
    survivors: Vec<(String, String)>,
}

/// The committed results of a package, by file.
#[derive(Debug, Default, PartialEq)]
struct Record(BTreeMap<String, Tested>);

/// Tests the remaining files, and fails if a finished package misses the goal.
pub fn run(options: &Options) -> Result<()> {
    let is_chosen = |package: &Package| options.package.as_ref().is_none_or(|name| name == package.name);
    let chosen: Vec<Package> = PACKAGES.into_iter().filter(is_chosen).collect();
    ensure!(!chosen.is_empty(), "the packages are {}", PACKAGES.map(|package| package.name).join(", "));
    let started = Instant::now();
    let limit = options.minutes.map(|minutes| Duration::from_secs(60 * minutes));
    let mut missed = Vec::new();
    for package in chosen {
        let mut record = Record::parse(&tree::text_if_there(package.table())?);
        let (files, mut sound) = (package.files()?, BTreeSet::new());
        record.forget_all_but(&files);
        let mut left = package.left(&record, &files, options)?;
        println!("{}: {} of {} files to test", package.name, left.len(), files.len());
        if options.status {
            continue;
        }
        while !left.is_empty() && limit.is_none_or(|limit| started.elapsed() <= limit) {
            package.test(&left.remove(0), &mut record, &mut sound)?;
            tree::make("tests/mutants")?;
            tree::write(package.table(), record.markdown(package.name))?;
        }
        println!("{}: {}", package.name, record.summary().replace('\n', " "));
        let percent = record.caught(options.sample.is_some()).percent();
        if options.file.is_none() && left.is_empty() && percent < GOAL {
            missed.push(format!("{} ({percent:.1} %)", package.name));
        }
    }
    ensure!(missed.is_empty(), "fewer than {GOAL} % are caught: {}", missed.join(", "));
    Ok(())
}

impl Package {
    fn table(&self) -> String {
        format!("tests/mutants/{}.md", self.name)
    }

    /// Folder of its sources, from the root.
    fn sources(&self) -> String {
        format!("firmware/{}/src", self.name)
    }

    /// Its source files with the checksums of their contents; separate test files are left out.
    fn files(&self) -> Result<BTreeMap<String, String>> {
        let mut files = BTreeMap::new();
        for path in tree::files(self.sources())? {
            let name = tree::below(&path, &tree::root());
            if name.ends_with(".rs") && !name.ends_with("tests.rs") {
                let sum = code_sum(&tree::text(&name)?).with_context(|| name.clone())?;
                files.insert(name, sum);
            }
        }
        Ok(files)
    }

    /// What was asked for; else the files whose present contents are untested, short ones first, so that a run that is
    /// stopped early has completed more of them.
    fn left(&self, record: &Record, files: &BTreeMap<String, String>, options: &Options) -> Result<Vec<Scope>> {
        if let Some(every) = options.sample {
            let last = every.get() - 1;
            ensure!(options.from <= last, "a sample of one in {every} begins with a mutant from 0 to {last}");
            return Ok(vec![Scope::sample(every, options.from)]);
        }
        if let Some(only) = &options.file {
            let known = files.keys().find(|file| *file == only || file.ends_with(&format!("/{only}")));
            let file = known.with_context(|| format!("there is no {only} in {}", self.sources()))?;
            return Ok(vec![Scope::file(file.clone())]);
        }
        let is_new = |(file, sum): &(&String, &String)| record.0.get(*file).is_none_or(|tested| tested.sum != **sum);
        let mut left: Vec<_> = files.iter().filter(is_new).map(|(file, _)| file.clone()).collect();
        left.sort_by_cached_key(|file| fs::metadata(tree::root().join(file)).map_or(0, |metadata| metadata.len()));
        Ok(left.into_iter().map(Scope::file).collect())
    }

    /// What each pass skips; it takes the mutants that the previous one missed. Only the last one runs the goldens.
    fn passes(&self) -> Vec<Skipped> {
        let mut passes = vec![[self.goldens, self.slow].concat(), self.goldens.to_vec(), Vec::new()];
        passes.dedup();
        passes
    }

    /// Tests the mutants of a file, or a sample of all. `sound`: passes that have succeeded on the unchanged source.
    fn test(&self, scope: &Scope, record: &mut Record, sound: &mut BTreeSet<Skipped>) -> Result<()> {
        let folder = workspace::target()?.join("mutants");
        let started = Instant::now();
        // Before the tests: a source that is edited meanwhile no longer matches.
        let sum = if is_sample(&scope.name) {
            sum(self.files()?.into_values().collect::<String>().as_bytes())
        } else {
            code_sum(&tree::text(&scope.name)?).with_context(|| scope.name.clone())?
        };
        tree::make(folder.join(self.name))?;
        copy::tree(&folder.join("tree"), &[])?;
        let (mut tested, mut missed) = (Tested { sum, ..Tested::default() }, None);
        for pass in self.passes() {
            if missed.as_ref().is_none_or(|missed: &Vec<String>| !missed.is_empty()) {
                let outcomes = self.pass(&pass, scope, &folder, missed.as_deref(), sound)?;
                if pass.is_empty() && !self.goldens.is_empty() {
                    tested.golden = scope.without_places(&outcomes.caught);
                } else {
                    tested.caught += outcomes.caught.len();
                }
                missed = Some(outcomes.missed);
            }
        }
        let survived = scope.without_places(&missed.unwrap_or_default());
        println!(
            "{}: {} caught, {} by a golden only, {} survived, in {:.0} s",
            scope.name,
            tested.caught,
            tested.golden.len(),
            survived.len(),
            started.elapsed().as_secs_f64()
        );
        record.take(&scope.name, tested, survived);
        Ok(())
    }

    /// Runs one pass on these mutants, all of them or some.
    fn pass(
        &self,
        skipped: &Skipped,
        scope: &Scope,
        folder: &Path,
        only: Option<&[String]>,
        sound: &mut BTreeSet<Skipped>,
    ) -> Result<Outcomes> {
        let mut command = tool::MUTANTS.command()?;
        command.arg("--in-place");
        command.args(["--package", &format!("inerter-{}", self.name), "--no-shuffle"]);
        command.args(match only {
            None => scope.arguments.clone(),
            Some(only) => only.iter().flat_map(|mutant| ["--re".to_owned(), exactly(mutant)]).collect(),
        });
        command.args(["--timeout", WAIT_S, "--build-timeout", WAIT_S]);
        command.args(["--baseline", if sound.contains(skipped) { "skip" } else { "run" }, "--cap-lints", "true"]);
        command.args(["--no-times", "--output"]).arg(folder.join(self.name));
        command.args(["--", "--locked", "--"]).args(skipped.iter().flat_map(|name| ["--skip", *name]));
        let mut command = with_limits(command);
        command.current_dir(folder.join("tree")).env("CARGO_TARGET_DIR", folder.join("build"));
        let status = process::spawn(&mut command)?.wait()?;
        // 2: some were missed, 3: some took too long.
        ensure!(matches!(status.code(), Some(0 | 2 | 3)), "`{}` failed ({status})", process::shown(&command));
        let mut outcomes = outcomes(&folder.join(self.name).join("mutants.out"))?;
        if let Some(only) = only {
            // No expression can select struct fields that are omitted, so all of those were tried.
            for lines in [&mut outcomes.caught, &mut outcomes.missed] {
                lines.retain(|line| only.contains(line));
            }
        }
        // If there is no mutant, no test has run.
        if !(outcomes.caught.is_empty() && outcomes.missed.is_empty()) {
            sound.insert(skipped.clone());
        }
        Ok(outcomes)
    }
}

/// The same command, with limits on the processor time and memory of each of its processes, where the system can set
/// them.
fn with_limits(command: Command) -> Command {
    if !cfg!(unix) {
        return command;
    }
    let mut limited = Command::new("sh");
    limited.args(["-c", r#"ulimit -t "$0" && ulimit -v "$1" && shift && exec "$@""#, CPU_S, SPACE_KB]);
    limited.arg(command.get_program()).args(command.get_args());
    limited
}

/// What `cargo-mutants` left in this folder.
fn outcomes(folder: &Path) -> Result<Outcomes> {
    let lines =
        |name: &str| -> Result<Vec<String>> { Ok(tree::text(folder.join(name))?.lines().map(str::to_owned).collect()) };
    // Mutants that do not compile are left out. A link failure means that a compiler was killed during an incremental
    // build.
    for path in tree::files(folder.join("log"))? {
        let is_broken = tree::text(&path)?.contains("error: linking with");
        ensure!(!is_broken, "linking failed ({}): delete target/mutants/build and start again", path.display());
    }
    let caught = [lines("caught.txt")?, lines("timeout.txt")?].concat();
    Ok(Outcomes { caught, missed: lines("missed.txt")? })
}

/// A regular expression for exactly this text.
fn exactly(text: &str) -> String {
    let escaped = |letter: char| (r"\.+*?()|[]{}^$".contains(letter)).then_some('\\').into_iter().chain([letter]);
    format!("^{}$", text.chars().flat_map(escaped).collect::<String>())
}

/// Checksum of the code in a source: comments have no mutants. An error where code is hidden from the mutants.
fn code_sum(source: &str) -> Result<String> {
    let tokens = source.parse::<TokenStream>().map_err(|error| anyhow!("{error}"))?;
    let code: String = source::code(tokens).into_iter().map(|token| token + " ").collect();
    ensure!(!code.contains("mutants : : skip "), "`mutants::skip` hides mutants: remove it");
    Ok(sum(code.as_bytes()))
}

fn sum(bytes: &[u8]) -> String {
    let mut digits = format!("{:x}", Sha256::digest(bytes));
    digits.truncate(12);
    digits
}

impl Record {
    /// Reads what [`markdown`](Self::markdown) writes.
    fn parse(text: &str) -> Self {
        let mut record = Self::default();
        let (mut survivors, mut file) = (true, "");
        for line in text.lines() {
            if let Some(title) = line.strip_prefix("## ") {
                survivors = title == SURVIVORS;
            } else if let Some(name) = line.strip_prefix("### ") {
                file = name.trim_matches('`');
            } else if let Some(change) = line.strip_prefix("- `") {
                let (change, _) = change.split_once('`').unwrap_or((change, ""));
                let tested = record.0.entry(file.to_owned()).or_default();
                if survivors {
                    tested.survivors.push((change.to_owned(), NO_REASON.to_owned()));
                } else {
                    tested.golden.push(change.to_owned());
                }
            } else if let Some(reason) = line.strip_prefix("  ")
                && let Some((_, written)) = record.0.get_mut(file).and_then(|tested| tested.survivors.last_mut())
            {
                *written = if written == NO_REASON { reason.to_owned() } else { format!("{written}\n  {reason}") };
            } else if let Some([name, caught, _, _, sum]) = table::cells::<5>(line)
                && let Ok(caught) = caught.parse()
            {
                let tested = Tested { sum: sum.to_owned(), caught, ..Tested::default() };
                record.0.insert(name.trim_matches('`').to_owned(), tested);
            }
        }
        record
    }

    fn markdown(&self, package: &str) -> String {
        let mut text = format!(
            "# Mutants of inerter-{package}\n\n\
             Written by `cargo xtask mutants {package}`, which continues with the files that have no row here or\n\
             have changed since.\n{}\n\n\
             | file | caught | by a golden only | survived | sum |\n|---|--:|--:|--:|---|\n",
            self.summary()
        );
        for (file, Tested { sum, caught, golden, survivors }) in &self.0 {
            text += &format!("| `{file}` | {caught} | {} | {} | {sum} |\n", golden.len(), survivors.len());
        }
        let survivors = self.lists(|tested| {
            let line = |(change, reason): &(String, String)| format!("- `{change}`:\n  {reason}\n");
            tested.survivors.iter().map(line).collect()
        });
        text += &format!("\n## {SURVIVORS}\n{survivors}");
        let golden = self.lists(|tested| tested.golden.iter().map(|change| format!("- `{change}`\n")).collect());
        if golden.is_empty() { text } else { format!("{text}\n## {GOLDEN}\n{golden}") }
    }

    /// A list for each file, of the lines that this gives for it.
    fn lists(&self, lines: impl Fn(&Tested) -> String) -> String {
        let lists = self.0.iter().map(|(file, tested)| (file, lines(tested))).filter(|(_, lines)| !lines.is_empty());
        lists.map(|(file, lines)| format!("\n### `{file}`\n\n{lines}")).collect()
    }

    /// Adds the results for a file's mutants. A reason stays with the same change.
    fn take(&mut self, file: &str, tested: Tested, survived: Vec<String>) {
        let mut known = self.0.remove(file).unwrap_or_default().survivors;
        let survivors = survived.into_iter().map(|change| match known.iter().position(|(other, _)| *other == change) {
            Some(place) => known.remove(place),
            None => (change, NO_REASON.to_owned()),
        });
        let survivors = survivors.collect();
        self.0.insert(file.to_owned(), Tested { survivors, ..tested });
    }

    /// Removes the results of files that are gone.
    fn forget_all_but(&mut self, files: &BTreeMap<String, String>) {
        self.0.retain(|name, _| files.contains_key(name) || is_sample(name));
    }

    /// Mutants caught in all files, or in samples.
    fn caught(&self, in_samples: bool) -> Caught {
        let rows = self.0.iter().filter(|(name, _)| is_sample(name) == in_samples);
        rows.fold(Caught::default(), |sum, (_, Tested { caught, golden, survivors, .. })| Caught {
            rows: sum.rows + 1,
            caught: sum.caught + caught + golden.len(),
            golden: sum.golden + golden.len(),
            all: sum.all + caught + golden.len() + survivors.len(),
        })
    }

    /// One sentence to a line.
    fn summary(&self) -> String {
        let (files, samples) = (self.caught(false), self.caught(true));
        let listed = self.0.values().flat_map(|tested| &tested.survivors);
        let reasons = listed.filter(|(_, reason)| reason != NO_REASON).count();
        let survivors = files.all + samples.all - files.caught - samples.caught;
        let mut text = String::new();
        if files.rows > 0 {
            text +=
                &format!("In {} files, {}, {} of them by a golden only.\n", files.rows, files.words(), files.golden);
        }
        if samples.rows > 0 {
            let [low, high] = samples.interval_percent();
            text += &format!(
                "In a sample, {}.\nOf all mutants, {low:.1} to {high:.1} % are caught, with 95 % confidence.\n",
                samples.words()
            );
        }
        format!("{text}Survivors with a reason: {reasons} of {survivors}.")
    }
}

/// Number of mutants that compile, and of those that tests catch.
#[derive(Default)]
struct Caught {
    rows: usize,
    caught: usize,
    golden: usize,
    all: usize,
}

impl Caught {
    fn percent(&self) -> f64 {
        if self.all > 0 { 100.0 * self.caught as f64 / self.all as f64 } else { 100.0 }
    }

    /// Share of all mutants that this sample represents \[%\], by Wilson's interval.
    fn interval_percent(&self) -> [f64; 2] {
        let (n, share, z) = (self.all as f64, self.percent() / 100.0, 1.96);
        let middle = share + z * z / (2.0 * n);
        let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
        [middle - half, middle + half].map(|bound| 100.0 * bound / (1.0 + z * z / n))
    }

    fn words(&self) -> String {
        format!("{} of {} mutants are caught ({:.1} %, goal {GOAL} %)", self.caught, self.all, self.percent())
    }
}

const SURVIVORS: &str = "Survivors";
const GOLDEN: &str = "Caught by a golden only";

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        let mut record = Record::default();
        let tested = |sum: &str, caught, golden| Tested { sum: sum.into(), caught, golden, ..Tested::default() };
        let change = "replace < with <= in Crc::table";
        let golden = vec!["replace f -> u8 with 0".into()];
        record.take("a/src/crc.rs", tested("0123", 7, golden), vec![change.into(), change.into()]);
        record.take("a/src/lib.rs", tested("4567", 8, Vec::new()), Vec::new());
        record.0.get_mut("a/src/crc.rs").unwrap().survivors[0].1 = "the table ends there:\n  nothing differs".into();
        record
    }

    #[test]
    fn a_comment_changes_no_sum() {
        let plain = code_sum("fn f(a: u8) -> u8 { a + 1 }").unwrap();
        let same =
            ["//! F.\n/// One more.\nfn f(a: u8) -> u8 {\n    // a\n    a + 1\n}\n", "fn f(a:u8)->u8{a+1/* . */}"];
        assert_eq!(same.map(|text| code_sum(text).unwrap()), [plain.clone(), plain.clone()]);
        for other in
            ["fn f(a: u8) -> u8 { a + 2 }", "#[inline] fn f(a: u8) -> u8 { a + 1 }", "fn f(a: u8) -> u8 {} a + 1"]
        {
            assert_ne!(code_sum(other).unwrap(), plain, "{other}");
        }
        assert!(code_sum("fn f() {").is_err());
        for hidden in ["#[mutants::skip] fn f() {}", "#[cfg_attr(test, mutants :: skip)] fn f() {}"] {
            assert!(code_sum(hidden).unwrap_err().to_string().contains("hides mutants"), "{hidden}");
        }
    }

    #[test]
    fn what_is_written_is_read_back() {
        assert_eq!(Record::parse(&record().markdown("wire")), record());
        for Package { name, .. } in PACKAGES {
            let text = tree::text(format!("tests/mutants/{name}.md")).unwrap();
            assert_eq!(Record::parse(&text).markdown(name), text);
        }
    }

    #[test]
    fn each_pass_skips_fewer_tests() {
        let [core, wire, app] = PACKAGES.map(|package| package.passes().iter().map(Vec::len).collect::<Vec<_>>());
        assert_eq!((core, wire, app), (vec![0], vec![4, 2, 0], vec![3, 0]));
    }

    #[test]
    fn reasons_stay_with_their_mutants_and_files_that_are_gone_go() {
        let mut record = record();
        let changes = vec!["replace a with b in new".to_owned(), "replace < with <= in Crc::table".to_owned()];
        record.take("a/src/crc.rs", Tested::default(), changes);
        let survivors = &record.0["a/src/crc.rs"].survivors;
        let reasons: Vec<&str> = survivors.iter().map(|(_, reason)| reason.as_str()).collect();
        assert_eq!(reasons, [NO_REASON, "the table ends there:\n  nothing differs"]);
        record.forget_all_but(&[("a/src/lib.rs".to_owned(), String::new())].into());
        assert_eq!(record.0.into_keys().collect::<Vec<_>>(), ["a/src/lib.rs"]);
    }

    #[test]
    fn the_summary_counts_what_survives() {
        let summary = record().summary();
        assert!(summary.contains("16 of 18 mutants are caught (88.9 %"), "{summary}");
        assert!(summary.contains("Survivors with a reason: 1 of 2."), "{summary}");
    }

    /// The ends of the interval solve `(0.93 - p)^2 = 1.96^2 p (1 - p)/100`: 0.8625 and 0.9657 by bisection.
    #[test]
    fn a_sample_stands_apart_and_tells_of_all() {
        let mut record = record();
        let every = NonZeroUsize::new(40).unwrap();
        let sample = Scope::sample(every, 0);
        assert_eq!(sample.arguments, ["--shard", "0/40", "--sharding", "round-robin"]);
        let other = Scope::sample(every, 7);
        assert_eq!(other.arguments, ["--shard", "7/40", "--sharding", "round-robin"]);
        assert_ne!(other.name, sample.name);
        let place = "firmware/core/src/ldl.rs:3:4: replace < with == in solve".to_owned();
        let survived = sample.without_places(&vec![place; 7]);
        assert_eq!(survived[6], "firmware/core/src/ldl.rs: replace < with == in solve");
        record.take(&sample.name, Tested { caught: 93, ..Tested::default() }, survived);
        record.forget_all_but(&[].into());
        let summary = record.summary();
        assert!(summary.contains("In a sample, 93 of 100 mutants are caught (93.0 %"), "{summary}");
        assert!(summary.contains("86.3 to 96.6 % are caught, with 95 %"), "{summary}");
        assert_eq!((record.caught(true).all, record.caught(false).all), (100, 0));
        assert_eq!(Record::parse(&record.markdown("core")), record);
    }

    #[test]
    fn a_mutant_is_selected_by_all_of_its_line() {
        assert_eq!(exactly("a.rs:1: f -> Vec<u8> with [1]"), r"^a\.rs:1: f -> Vec<u8> with \[1\]$");
    }

    #[test]
    fn places_move_and_are_left_out() {
        let place = "firmware/wire/src/crc.rs:14:17: replace < with == in table".to_owned();
        let scope = Scope::file("firmware/wire/src/crc.rs".into());
        assert_eq!(scope.without_places(&[place]), ["replace < with == in table"]);
    }
}
