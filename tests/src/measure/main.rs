//! Measures the tables of docs/tables, and runs the tests that are too long for the suite: `cargo xtask NAME`.

use inerter_tests::{
    grid::Result,
    sheet::{Asked, Measured, measured},
};
use std::process::ExitCode;

mod ablation_host;
mod accuracy;
mod changes;
mod coverage;
mod defects;
mod diagnose;
mod endurance;
mod fuzz;
mod identify;
mod longrun;
mod merge;
mod plan;
mod robustness;
mod skew;
mod validation;

/// What a measurement runs.
enum Measure {
    /// Anything, with arguments of its own: whether its result is good, or why there is none.
    Own(fn(&[&str]) -> Result<bool>),
    /// A table: how many cells name a row, and whether it can be measured in part.
    Table(usize, bool, fn(Asked) -> Measured),
}

use Measure::{Own, Table};

const MEASURES: &[(&str, Measure)] = &[
    ("ablation_host", Own(ablation_host::run)),
    ("accuracy", Table(2, true, accuracy::measure)),
    ("changes", Table(1, true, changes::measure)),
    ("coverage", Table(2, false, coverage::measure)),
    ("defects", Table(1, false, defects::measure)),
    ("diagnose", Table(2, false, diagnose::measure)),
    ("endurance", Own(endurance::run)),
    ("fuzz", Own(fuzz::run)),
    ("identify", Own(identify::run)),
    ("longrun", Own(longrun::run)),
    ("merge", Table(2, false, merge::measure)),
    ("plan", Table(2, false, plan::measure)),
    ("robustness", Table(3, false, robustness::measure)),
    ("skew", Table(1, false, skew::measure)),
    ("validation", Own(validation::run)),
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match run(&words) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs the measurement that the first word names, with the other words.
fn run(words: &[&str]) -> Result<bool> {
    let named =
        words.split_first().and_then(|(name, rest)| Some((MEASURES.iter().find(|each| each.0 == *name)?, rest)));
    match named {
        Some(((_, Own(run)), rest)) => run(rest),
        Some(((name, Table(keys, can_be_short, table)), rest)) => measured(name, rest, *keys, *can_be_short, *table),
        None => {
            let names: Vec<&str> = MEASURES.iter().map(|each| each.0).collect();
            Err(format!("the first argument is one of {}", names.join(", ")).into())
        }
    }
}
