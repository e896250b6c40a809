//! Coverage-guided fuzzing: libFuzzer on the targets of `tests/fuzz`.
//!
//! Terms:
//! - *corpus*: inputs of a target that together reach all edges ever reached, packed into `tests/fuzz/corpus/TARGET`.
//! - *edges*: branches of the compiled code that inputs have taken.
//! - *finding*: an input at which a target panics, hangs or takes too much memory.
//!
//! A packed corpus holds, for each input, its length (u32, little-endian) and its bytes. What a run finds stays in
//! `target/fuzz/TARGET`, where the next one continues.

mod kept;

use crate::{
    commit::commit,
    process, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, bail, ensure};
use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

#[derive(clap::Args)]
pub struct Options {
    /// Run this target alone: wire, estimator, mcap, csv, settings, image, commands, dfuse, requests or flags
    target: Option<String>,
    /// Time for each target, in seconds
    #[arg(long, default_value_t = 30)]
    seconds: u32,
    /// Seed of libFuzzer's random numbers; by default a new one each time, which the printed command shows
    #[arg(long, value_name = "N")]
    seed: Option<u32>,
    /// Do not show comparisons to libFuzzer: more inputs a second, for long runs from a corpus that already has them
    #[arg(long)]
    fast: bool,
    /// Count the edges of our own crates alone, and look for new ones there: no library's edges draw time away
    #[arg(long)]
    ours: bool,
    /// Merge what was found, and the seeds, into the committed corpus, and add the run to docs/tables/fuzz.md. With
    /// `--ours` the row is one of its own, and the corpus stays as it is
    #[arg(long)]
    keep: bool,
    /// Run the target on this input alone, to reproduce a finding
    #[arg(long, value_name = "FILE", requires = "target")]
    input: Option<PathBuf>,
}

/// A fuzz target: a program of `tests/fuzz`, and its maximum input size \[bytes\].
type Target = (&'static str, usize);

const TARGETS: &[Target] = &[
    ("wire", 2_048),
    ("estimator", 256),
    ("mcap", 8_192),
    ("csv", 2_048),
    ("settings", 8_192),
    ("image", 1_024),
    ("commands", 2_048),
    ("dfuse", 512),
    ("requests", 1_024),
    ("flags", 1_024),
];

/// Flags that count coverage for libFuzzer; `cargo fuzz` passes these and [`COMPARES`].
const FLAGS: &[&str] = &[
    "-Cpasses=sancov-module",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "--cfg=fuzzing",
];

/// Reports comparisons to libFuzzer, which takes half to four fifths of a target's time.
const COMPARES: &str = "-Cllvm-args=-sanitizer-coverage-trace-compares";

/// Time limit for one input \[s\], and memory limit \[MB\].
const LIMITS: [&str; 2] = ["-timeout=20", "-rss_limit_mb=2048"];

/// Makes a target write its seeds; `tests/fuzz/src/lib.rs` reads it.
const SEEDS: &str = "INERTER_FUZZ_SEEDS";

/// Runs the targets; fails if one has found something.
pub fn run(options: &Options) -> Result<()> {
    let mut chosen = TARGETS.to_vec();
    if let Some(wanted) = &options.target {
        chosen.retain(|(name, _)| name == wanted);
        let names: Vec<_> = TARGETS.iter().map(|(name, _)| *name).collect();
        ensure!(!chosen.is_empty(), "there is no target `{wanted}`; the targets are {}", names.join(", "));
    }
    let programs = build(&chosen, options)?;
    let folder = workspace::target()?.join("fuzz");
    if let (Some(input), [(name, _)]) = (&options.input, &chosen[..]) {
        return process::run(Command::new(programs.join(name)).args(LIMITS).arg(input));
    }
    // Taken before a corpus is written, which would count as a difference.
    let commit = commit();
    let mut rows = Vec::new();
    for (name, longest) in chosen {
        let place = Place {
            program: programs.join(name),
            longest: format!("-max_len={longest}"),
            packed: folder_of_targets().join("corpus").join(name),
            folder: folder.join(name),
        };
        let session = place.fuzz(options)?;
        if options.keep {
            // Without time nothing is fuzzed.
            if options.seconds > 0 {
                let of = if options.ours { ", our crates" } else { "" };
                kept::add(&format!("{name}{of}"), session.figures(&commit))?;
            }
            // Judged by our edges, inputs that reach those of libraries would be dropped.
            if session.finding.is_none() && !options.ours {
                place.keep()?;
            }
        }
        rows.push((name, session));
    }
    println!("\n{}", table(&rows));
    let findings: Vec<_> = rows.iter().filter_map(|(name, session)| Some((name, session.finding.as_ref()?))).collect();
    let ours = if options.ours { " --ours" } else { "" };
    for (name, finding) in &findings {
        println!("finding in {name}: {}\n  again: cargo xtask fuzz {name}{ours} --input {0}", finding.display());
    }
    ensure!(findings.is_empty(), "{} of {} targets found something", findings.len(), rows.len());
    Ok(())
}

fn folder_of_targets() -> PathBuf {
    tree::root().join("tests/fuzz")
}

/// Compiles the targets with counters and returns their folder. Build scripts get no counters because a target triple
/// is given.
fn build(targets: &[Target], options: &Options) -> Result<PathBuf> {
    let host = process::host_tuple()?;
    let mut command = Part::Main.cargo();
    command.args(["build", "--profile", "fuzz", "--locked", "--target", &host]);
    command.args(["--package", "inerter-fuzz", "--features", "libfuzzer"]);
    command.args(targets.iter().flat_map(|(name, _)| ["--bin", *name]));
    let flags: Vec<&str> = FLAGS.iter().copied().chain((!options.fast).then_some(COMPARES)).collect();
    let mut folder = workspace::target()?;
    if options.ours {
        // Cargo gives flags to some packages only as an unstable option, which this variable allows.
        command.env("RUSTC_BOOTSTRAP", "1").arg("-Zprofile-rustflags");
        command.arg("--config").arg(format!("profile.fuzz.rustflags={flags:?}"));
        command.args(["--config", "profile.fuzz.package.'*'.rustflags=[]"]);
        command.args(["--config", "profile.fuzz.build-override.rustflags=[]"]);
        folder.push("ours");
        process::run(command.env("CARGO_TARGET_DIR", &folder))?;
    } else {
        process::run(command.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f")))?;
    }
    Ok(folder.join(host).join("fuzz"))
}

/// Result of a run.
#[derive(Clone, Debug, Default, PartialEq)]
struct Session {
    inputs: u64,
    seconds: f64,
    /// Edges after half of the time and at the end.
    edges: [u64; 2],
    /// Samples that the target reports to have processed.
    samples: Option<u64>,
    finding: Option<PathBuf>,
}

impl Session {
    /// Processes a line of libFuzzer's output; `half`: half of the time has passed.
    fn take(&mut self, line: &str, half: bool) {
        let number = |after: &str| -> Option<u64> {
            let (_, rest) = line.split_once(after)?;
            rest.split_whitespace().next()?.parse().ok()
        };
        if let Some(edges) = number(" cov: ") {
            self.edges = if half { [self.edges[0], edges] } else { [edges; 2] };
        }
        self.inputs = number("stat::number_of_executed_units:").unwrap_or(self.inputs);
        self.samples = number("samples:").or(self.samples);
        if let Some((_, path)) = line.split_once("Test unit written to ") {
            self.finding = Some(path.trim().into());
        }
    }

    /// For the table of all runs.
    fn figures(&self, commit: &str) -> kept::Figures {
        kept::Figures {
            inputs: self.inputs,
            samples: self.samples,
            seconds: self.seconds.round() as u64,
            edges: self.edges,
            findings: u64::from(self.finding.is_some()),
            commit: commit.to_owned(),
        }
    }
}

/// Where the files of a target are.
struct Place {
    program: PathBuf,
    longest: String,
    /// The committed corpus, packed.
    packed: PathBuf,
    /// Holds a folder for each of the following.
    folder: PathBuf,
}

/// The committed corpus as single files, written again for each run; what the target writes; what was found and stays;
/// what is left of all of them; findings.
const FOLDERS: [&str; 5] = ["corpus", "seeds", "found", "merged", "findings"];

impl Place {
    fn folders(&self) -> [PathBuf; 5] {
        FOLDERS.map(|name| self.folder.join(name))
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.args(LIMITS).arg(&self.longest);
        command
    }

    /// Fuzzes from the committed corpus and what earlier runs found, and from the seeds if these are wanted or there is
    /// no corpus.
    fn fuzz(&self, options: &Options) -> Result<Session> {
        let Options { seconds, seed, keep: with_seeds, .. } = *options;
        let [corpus, seeds, found, merged, findings] = self.folders();
        for folder in [&corpus, &seeds, &merged] {
            empty(folder)?;
        }
        for folder in [&found, &findings] {
            tree::make(folder)?;
        }
        if self.packed.exists() {
            for (number, input) in unpack(&tree::read(&self.packed)?)?.iter().enumerate() {
                fs::write(corpus.join(format!("{number:04}")), input)?;
            }
        }
        if with_seeds || !self.packed.exists() {
            process::run(self.command().env(SEEDS, &seeds).stderr(Stdio::null()))?;
        }
        let mut command = self.command();
        command.args([found, corpus, seeds]);
        // A limit of 0 means no limit to libFuzzer, so run only the corpus.
        command.arg(if seconds == 0 { "-runs=0".into() } else { format!("-max_total_time={seconds}") });
        command
            .arg(format!("-seed={}", seed.unwrap_or_else(new_seed)))
            .arg(format!("-artifact_prefix={}/", findings.display()))
            .args(["-print_final_stats=1", "-report_slow_units=60"]);
        println!("{}", process::shown(&command));
        self.watch(&mut command, Duration::from_secs(seconds.into()))
    }

    /// Runs it to the end, reading its output.
    fn watch(&self, command: &mut Command, time: Duration) -> Result<Session> {
        let start = Instant::now();
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn()?;
        let (mut session, mut said) = (Session::default(), Vec::new());
        for line in lines(child.stderr.take().context("no pipe from the target")?) {
            session.take(&line, 2 * start.elapsed() > time);
            said.push(line);
        }
        let status = child.wait()?;
        session.seconds = start.elapsed().as_secs_f64();
        if !status.success() {
            // From the panic message on.
            let panic =
                said.iter().position(|line| line.contains("panicked at")).unwrap_or(said.len().saturating_sub(20));
            said.iter().skip(panic).take(20).for_each(|line| println!("  {line}"));
            ensure!(session.finding.is_some(), "`{}` failed ({status})", process::shown(command));
        }
        let ran = session.inputs > 0 && session.edges[1] > 0;
        ensure!(ran || session.finding.is_some(), "`{}` ran no input", process::shown(command));
        Ok(session)
    }

    /// Rebuilds the committed corpus: few inputs that reach as much as all of them.
    fn keep(&self) -> Result<()> {
        let [corpus, seeds, found, merged, _] = self.folders();
        let mut command = self.command();
        command.args(["-merge=1", "-use_counters=0"]);
        command.args([&merged, &corpus, &seeds, &found]).stderr(Stdio::null());
        process::run(&mut command)?;
        let mut inputs = tree::files(&merged)?.iter().map(tree::read).collect::<Result<Vec<_>>>()?;
        inputs.sort_by(|one, other| one.len().cmp(&other.len()).then(one.cmp(other)));
        let packed = pack(&inputs);
        fs::create_dir_all(self.packed.parent().context("a folder")?)?;
        tree::write(&self.packed, &packed)?;
        println!("{}: {} inputs, {} bytes", self.packed.display(), inputs.len(), packed.len());
        // Inputs that reach anything new are in the corpus now.
        empty(&found)
    }
}

/// From the clock; not 0, for which libFuzzer silently chooses one.
fn new_seed() -> u32 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |time| time.subsec_nanos().max(1))
}

fn empty(folder: &Path) -> Result<()> {
    tree::remove(folder)?;
    tree::make(folder)
}

/// Lines of arbitrary bytes: a panic may print something that is not text.
fn lines(source: impl Read) -> impl Iterator<Item = String> {
    let bytes = BufReader::new(source).split(b'\n').map_while(|line| line.ok());
    bytes.map(|line| String::from_utf8_lossy(&line).into_owned())
}

fn pack(inputs: &[Vec<u8>]) -> Vec<u8> {
    let mut packed = Vec::new();
    for input in inputs {
        packed.extend((input.len() as u32).to_le_bytes());
        packed.extend(input);
    }
    packed
}

fn unpack(packed: &[u8]) -> Result<Vec<&[u8]>> {
    let (mut inputs, mut rest) = (Vec::new(), packed);
    while let Some((length, behind)) = rest.split_first_chunk() {
        let Some((input, next)) = behind.split_at_checked(u32::from_le_bytes(*length) as usize) else {
            bail!("the packed corpus is truncated after {} inputs", inputs.len());
        };
        inputs.push(input);
        rest = next;
    }
    ensure!(rest.is_empty(), "the packed corpus is truncated after {} inputs", inputs.len());
    Ok(inputs)
}

fn table(rows: &[(&str, Session)]) -> String {
    let mut lines = vec![
        "| target | inputs | inputs/s | edges at half time | at the end | new | findings |".to_string(),
        "|---|--:|--:|--:|--:|--:|--:|".to_string(),
    ];
    for (name, session) in rows {
        let Session { inputs, seconds, edges: [half, end], samples, finding } = session;
        let (rate, new, findings) = (*inputs as f64 / seconds.max(1e-3), end - half, u8::from(finding.is_some()));
        let samples = samples.map(|samples| format!(", {samples} samples")).unwrap_or_default();
        lines.push(format!("| {name} | {inputs}{samples} | {rate:.0} | {half} | {end} | {new} | {findings} |"));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packed_corpus_is_unpacked_to_the_same() {
        let inputs = [vec![], vec![1, 2, 3], vec![0; 300]];
        let packed = pack(&inputs);
        assert_eq!(unpack(&packed).unwrap(), inputs);
        assert!(unpack(&packed[..packed.len() - 1]).unwrap_err().to_string().contains("after 2 inputs"));
        assert!(unpack(&[1, 0]).is_err() && unpack(&[]).unwrap().is_empty());
    }

    #[test]
    fn what_libfuzzer_says_becomes_a_row() {
        let mut session = Session::default();
        session.take("#2\tINITED cov: 100 ft: 101 corp: 1/1b exec/s: 0 rss: 30Mb", false);
        session.take("#900\tNEW    cov: 120 ft: 140 corp: 3/9b lim: 4 exec/s: 300 rss: 31Mb L: 4/4 MS: 1", true);
        session.take("samples: 1048600", true);
        session.take("stat::number_of_executed_units: 5000", true);
        session.take("artifact_prefix='f/'; Test unit written to f/crash-00", true);
        session.seconds = 2.0;
        let found = Some("f/crash-00".into());
        let expected =
            Session { inputs: 5000, seconds: 2.0, edges: [100, 120], samples: Some(1_048_600), finding: found };
        assert_eq!(session, expected);
        let table = table(&[("wire", session)]);
        assert!(table.ends_with("| wire | 5000, 1048600 samples | 2500 | 100 | 120 | 20 | 1 |"), "{table}");
    }

    #[test]
    fn each_target_is_a_program_with_a_corpus_and_a_row() {
        let table = tree::text("docs/tables/fuzz.md").unwrap();
        for (name, longest) in TARGETS {
            assert!(table.contains(&format!("\n| {name} |")), "{name}");
            let folder = folder_of_targets();
            assert!(folder.join("src/bin").join(name).with_extension("rs").is_file(), "{name}");
            let packed = fs::read(folder.join("corpus").join(name)).unwrap();
            let inputs = unpack(&packed).unwrap();
            assert!(!inputs.is_empty() && inputs.iter().all(|input| input.len() <= *longest), "{name}");
        }
    }
}
