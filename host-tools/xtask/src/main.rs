//! One door for everything done to the project: set-up, demo, tests, tables and checks.
//!
//! Each command is one module, and each can be run by itself; `test` runs them in the order in which continuous
//! integration does. Nothing here reaches into the estimator: other programs are started, and what they print is read.

#![forbid(unsafe_code)]

mod ablation;
mod accuracy;
mod arrows;
mod bench;
mod chaos;
mod commit;
mod copy;
mod cost;
mod data;
mod demo;
mod files;
mod firmware;
mod foreign;
mod fuzz;
mod guest;
mod icount;
mod images;
mod imports;
mod monitor_load;
mod mutants;
mod panics;
mod platforms;
mod process;
mod python;
mod rates;
mod release;
mod setup;
mod size;
mod soak;
mod source;
mod suite;
mod supply;
mod table;
mod tool;
mod toolchain;
mod tree;
mod validation;
mod wheel;
mod workspace;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Set-up, demo, tests, tables and checks of the instrumented inerter.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Find the target, the Rust components and QEMU, and install what is missing
    Setup(setup::Options),
    /// Shake a simulated inerter, measured by the firmware in QEMU, and print what came out
    Demo(demo::Options),
    /// Run every check and test in the order of continuous integration
    Test(suite::Options),
    /// Convert published recordings of real machines for the tests, as docs/DATA.md says
    Data(data::Options),
    /// Build the images for thumbv7em-none-eabihf, QEMU's and the board's, and print their paths
    BuildFirmware,
    /// Make the boot image of the Linux guest in which a real kernel meets the board's USB
    Guest(guest::Options),
    /// Fail when a crate uses one it must not, when modules import each other in a circle, and on what the house
    /// forbids in source
    CheckArrows,
    /// Fail when the shipping image could panic inside the estimator or allocate
    CheckPanics,
    /// Compile the host program for Windows and macOS, without running it
    CheckPlatforms,
    /// Fail where a licence, a package or its source is not one of those that deny.toml allows
    CheckSupply(supply::Options),
    /// Make the files of a release that this computer can make, in target/release-files
    Release(release::Options),
    /// What compiling each product costs from nothing, its crates and its size; with --update into docs/tables/cost.md
    Cost(cost::Options),
    /// Flash, RAM and worst stack of the image, against docs/tables/size.md
    Size(table::Options),
    /// Instructions per sample and per solve on the Cortex-M4F, against docs/tables/icount.md
    Icount(table::Options),
    /// Bias, spread and coverage of the estimates over the grid of motions, against docs/tables/accuracy.md
    Accuracy(accuracy::LongOptions),
    /// How soon a change of the device is found, and how often one that is none, against docs/tables/changes.md
    Changes(accuracy::LongOptions),
    /// Errors and coverage under what goes wrong in real rigs, against docs/tables/robustness.md
    Robustness(accuracy::Options),
    /// How sharp the intervals are where everything stated is true, and how often they hold, against
    /// docs/tables/coverage.md
    Coverage(accuracy::Options),
    /// How often the cause that breaks the law is named and sized right, against docs/tables/diagnose.md
    Diagnose(accuracy::Options),
    /// Whether motions tell what was predicted of them, and what designing them is worth, against docs/tables/plan.md
    Plan(accuracy::Options),
    /// How often the interval of a skew holds it, for machines of any size, against docs/tables/skew.md
    Skew(accuracy::Options),
    /// How fast the Python package replays, beside the program and numpy
    Rates(accuracy::Options),
    /// Fill a store with simulated runs, replay all of them on Dask, and measure what a run costs; with --update into
    /// docs/tables/scale.md
    Scale(rates::ScaleOptions),
    /// How often the interval of merged runs holds the device, against docs/tables/merge.md
    Merge(accuracy::Options),
    /// How often a realistic defect makes a value wrong without a word, against docs/tables/defects.md
    Defects(accuracy::Options),
    /// What each part of the estimator buys, against docs/tables/ablation.md; or of the host's judgement
    Ablation(ablation::Options),
    /// Recordings of real machines and other methods beside ours, against docs/tables/validation.md
    Validation(accuracy::Options),
    /// Errors and coverage of the complete model on hidden devices, against docs/tables/identify.md
    Identify(accuracy::Options),
    /// Time of `inerter identify` beside scipy's least_squares around solve_ivp, on the same data from the same start
    BenchIdentify,
    /// Compare fixed point with the same algorithm in f64 over at least 1e7 updates
    Longrun(accuracy::Arguments),
    /// A thousand million samples: no drift, no overflow, the same result for the same motion
    Endurance(accuracy::Arguments),
    /// Processor, memory and losses of the monitor at 4 kHz, into docs/tables/monitor-load.md
    MonitorLoad(monitor_load::Options),
    /// What must never happen: kills, full disks, hostile devices, slow readers, a clock that is set
    Chaos(chaos::Options),
    /// The virtual device at 4 kHz with recordings, page and bridges, and the image in QEMU, for hours: nothing lost,
    /// nothing grows
    Soak(soak::Options),
    /// Time and errors beside other recursive least squares, into docs/tables/bench.md
    Bench(bench::Options),
    /// Speed and memory of exporting an hour at 4 kHz, beside a plain Python reader, into docs/tables/files.md
    BenchFiles(files::Options),
    /// Search for inputs that break what must hold, guided by coverage, from the corpora in tests/fuzz/corpus
    Fuzz(fuzz::Options),
    /// Change core, wire and app in one place at a time, and list what no test notices in tests/mutants
    Mutants(mutants::Options),
    /// Run the snippets of docs/PYTHON.md against a fresh recording
    Python,
    /// Build the Python package as a wheel in target/wheels, and test it against the program
    Wheel(wheel::Options),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Setup(options) => setup::run(&options),
        Command::Demo(options) => demo::run(&options),
        Command::Test(options) => suite::run(&options),
        Command::Data(options) => data::run(&options),
        Command::BuildFirmware => firmware::run_build(),
        Command::Guest(options) => guest::run(&options),
        Command::CheckArrows => arrows::run(),
        Command::CheckPanics => panics::run(),
        Command::CheckPlatforms => platforms::run(),
        Command::CheckSupply(options) => supply::run(&options),
        Command::Release(options) => release::run(&options),
        Command::Cost(options) => cost::run(&options),
        Command::Size(options) => size::run(&options),
        Command::Icount(options) => icount::run(&options),
        Command::Accuracy(options) => accuracy::long_table("accuracy", &options),
        Command::Changes(options) => accuracy::long_table("changes", &options),
        Command::Robustness(options) => accuracy::table("robustness", &options),
        Command::Coverage(options) => accuracy::table("coverage", &options),
        Command::Diagnose(options) => accuracy::table("diagnose", &options),
        Command::Plan(options) => accuracy::table("plan", &options),
        Command::Skew(options) => accuracy::table("skew", &options),
        Command::Rates(options) => rates::run(&options),
        Command::Scale(options) => rates::scale(&options),
        Command::Merge(options) => accuracy::table("merge", &options),
        Command::Defects(options) => accuracy::table("defects", &options),
        Command::Ablation(options) => ablation::run(&options),
        Command::Validation(options) => validation::run(&options),
        Command::Identify(options) => accuracy::table("identify", &options),
        Command::BenchIdentify => bench::identify(),
        Command::Longrun(arguments) => accuracy::with_arguments("longrun", &arguments),
        Command::Endurance(arguments) => accuracy::tested("endurance", &arguments.as_given()),
        Command::MonitorLoad(options) => monitor_load::run(&options),
        Command::Chaos(options) => chaos::run(&options),
        Command::Soak(options) => soak::run(&options),
        Command::Bench(options) => bench::run(&options),
        Command::BenchFiles(options) => files::run(&options),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Mutants(options) => mutants::run(&options),
        Command::Python => python::run(),
        Command::Wheel(options) => wheel::run(&options),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
