//! One entry point for all work on the project: set-up, demo, tests, tables and checks.
//!
//! Each command is one module, and each can be run on its own; `test` runs them in the order of continuous integration.
//! Nothing here calls the estimator: the commands start other programs and read their output.

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
#[cfg(test)]
mod fixture;
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
mod tokens;
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
    /// Shake a simulated inerter, measured by the firmware in QEMU, and print the results
    Demo(demo::Options),
    /// Run every check and test in the order of continuous integration
    Test(suite::Options),
    /// Convert published recordings of real machines for the tests, as docs/DATA.md says
    Data(data::Options),
    /// Build the images for thumbv7em-none-eabihf, QEMU's and the board's, and print their paths
    BuildFirmware,
    /// Make the boot image of the Linux guest, in which a real kernel uses the board's USB
    Guest(guest::Options),
    /// Fail if a crate uses one it must not, if modules import each other in a circle, or if there is a second memory.x
    CheckArrows,
    /// Fail if the shipping image could panic inside the estimator or allocate
    CheckPanics,
    /// Compile the host program for Windows and macOS, and everything with the oldest compiler, without running it
    CheckPlatforms,
    /// Fail if a licence, a package or its source is not one that deny.toml allows
    CheckSupply(supply::Options),
    /// Make the files of a release that this computer can make, in target/release-files
    Release(release::Options),
    /// Cost of compiling each product from an empty folder, its crates and its size, against docs/tables/cost.md; or the
    /// Rust tokens of each crate
    Cost(cost::Options),
    /// Flash, RAM and worst stack of the image, against docs/tables/size.md
    Size(table::Options),
    /// Instructions per sample and per solve on the Cortex-M4F, against docs/tables/icount.md
    Icount(table::Options),
    /// Bias, spread and coverage of the estimates over the grid of motions, against docs/tables/accuracy.md
    Accuracy(accuracy::LongOptions),
    /// How soon a change of the device is detected, and how often falsely, against docs/tables/changes.md
    Changes(accuracy::LongOptions),
    /// Errors and coverage under faults of real rigs, against docs/tables/robustness.md
    Robustness(table::Options),
    /// Width and coverage of the intervals when everything stated is true, against docs/tables/coverage.md
    Coverage(table::Options),
    /// How often the cause that breaks the law is identified and sized right, against docs/tables/diagnose.md
    Diagnose(table::Options),
    /// Whether motions reach the intervals predicted for them, and what designing them is worth, against
    /// docs/tables/plan.md
    Plan(table::Options),
    /// How often the interval of a skew contains it, for machines of any size, against docs/tables/skew.md
    Skew(table::Options),
    /// How fast the Python package replays, compared with the program and numpy
    Rates(table::Options),
    /// Fill a store with simulated runs, replay all of them on Dask, and measure what a run costs; --update writes
    /// docs/tables/scale.md
    Scale(rates::ScaleOptions),
    /// How often the interval of merged runs contains the device's value, against docs/tables/merge.md
    Merge(table::Options),
    /// How often a realistic defect makes a value wrong without a warning, against docs/tables/defects.md
    Defects(table::Options),
    /// What each part of the estimator, or of the host's diagnosis, contributes, against docs/tables/ablation.md
    Ablation(ablation::Options),
    /// Recordings of real machines, and other methods compared with ours, against docs/tables/validation.md
    Validation(table::Options),
    /// Errors and coverage of the complete model on hidden devices, against docs/tables/identify.md
    Identify(table::Options),
    /// Time of `inerter identify` against scipy's least_squares around solve_ivp, on the same data from the same start
    BenchIdentify,
    /// Compare fixed point with the same algorithm in f64 over at least 1e7 updates
    Longrun(accuracy::Arguments),
    /// A thousand million samples: no drift, no overflow, the same result for the same motion
    Endurance(accuracy::Arguments),
    /// Processor, memory and losses of the monitor at 4 kHz, into docs/tables/monitor-load.md
    MonitorLoad(monitor_load::Options),
    /// Campaigns of disturbances: kills, full disks, hostile devices, slow readers, a clock that is changed
    Chaos(chaos::Options),
    /// The virtual device at 4 kHz with recordings, page and bridges, and the image in QEMU, for hours: nothing lost,
    /// nothing grows
    Soak(soak::Options),
    /// Time and errors compared with other recursive least squares, into docs/tables/bench.md
    Bench(bench::Options),
    /// Speed and memory of exporting an hour at 4 kHz, compared with a plain Python reader, into docs/tables/files.md
    BenchFiles(files::Options),
    /// Search for inputs that break an invariant, guided by coverage, from the corpora in tests/fuzz/corpus
    Fuzz(fuzz::Options),
    /// Change core, wire and app in one place at a time, and list in tests/mutants what no test notices
    Mutants(mutants::Options),
    /// Run the snippets of docs/PYTHON.md against a fresh recording
    Python,
    /// Build the Python package as a wheel in target/wheels, and test it against the program
    Wheel(wheel::Options),
}

fn main() -> ExitCode {
    let result = match std::env::var_os(wheel::CARGO) {
        Some(cargo) => wheel::as_cargo(&cargo),
        None => run(Arguments::parse().command),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Runs a command line of this program, such as `cargo xtask size`.
fn own(line: &str) -> anyhow::Result<()> {
    run(Arguments::try_parse_from(line.split(' ').skip(1))?.command)
}

fn run(command: Command) -> anyhow::Result<()> {
    use Command::*;
    match command {
        Setup(options) => setup::run(&options),
        Demo(options) => demo::run(&options),
        Test(options) => suite::run(&options, own),
        Data(options) => data::run(&options),
        BuildFirmware => firmware::run_build(),
        Guest(options) => guest::run(&options),
        CheckArrows => arrows::run(),
        CheckPanics => panics::run(),
        CheckPlatforms => platforms::run(),
        CheckSupply(options) => supply::run(&options),
        Release(options) => release::run(&options),
        Cost(options) => cost::run(&options),
        Size(options) => size::run(&options),
        Icount(options) => icount::run(&options),
        Accuracy(options) => accuracy::long_table("accuracy", &options),
        Changes(options) => accuracy::long_table("changes", &options),
        Robustness(options) => accuracy::table("robustness", &options),
        Coverage(options) => accuracy::table("coverage", &options),
        Diagnose(options) => accuracy::table("diagnose", &options),
        Plan(options) => accuracy::table("plan", &options),
        Skew(options) => accuracy::table("skew", &options),
        Rates(options) => rates::run(&options),
        Scale(options) => rates::scale(&options),
        Merge(options) => accuracy::table("merge", &options),
        Defects(options) => accuracy::table("defects", &options),
        Ablation(options) => ablation::run(&options),
        Validation(options) => validation::run(&options),
        Identify(options) => accuracy::table("identify", &options),
        BenchIdentify => bench::identify(),
        Longrun(arguments) => accuracy::with_arguments("longrun", &arguments),
        Endurance(arguments) => accuracy::tested("endurance", &arguments.arguments),
        MonitorLoad(options) => monitor_load::run(&options),
        Chaos(options) => chaos::run(&options),
        Soak(options) => soak::run(&options),
        Bench(options) => bench::run(&options),
        BenchFiles(options) => files::run(&options),
        Fuzz(options) => fuzz::run(&options),
        Mutants(options) => mutants::run(&options),
        Python => python::run(),
        Wheel(options) => wheel::run(&options),
    }
}

#[cfg(test)]
mod tests {
    use super::Arguments;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn each_step_of_the_suite_is_a_command() {
        for line in super::suite::own_commands() {
            assert!(Arguments::try_parse_from(line.split(' ').skip(1)).is_ok(), "{line}");
        }
    }
}
