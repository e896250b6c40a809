//! Measures the tables of docs/tables, and runs the tests that are too long for the suite: `cargo xtask NAME`.

use inerter_tests::grid::Error;
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

/// A measurement: whether its result is good, or why there is none.
type Measure = fn(&[&str]) -> Result<bool, Error>;

const MEASURES: &[(&str, Measure)] = &[
    ("ablation_host", ablation_host::run),
    ("accuracy", accuracy::run),
    ("changes", changes::run),
    ("coverage", coverage::run),
    ("defects", defects::measure),
    ("diagnose", diagnose::run),
    ("endurance", endurance::run),
    ("fuzz", fuzz::run),
    ("identify", identify::run),
    ("longrun", longrun::run),
    ("merge", merge::run),
    ("plan", plan::run),
    ("robustness", robustness::run),
    ("skew", skew::run),
    ("validation", validation::run),
];

fn main() -> ExitCode {
    match measured() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs the measurement that the first argument names, with the other arguments.
fn measured() -> Result<bool, Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let named =
        words.split_first().and_then(|(name, rest)| Some((MEASURES.iter().find(|each| each.0 == *name)?, rest)));
    let Some(((_, measure), rest)) = named else {
        let names: Vec<&str> = MEASURES.iter().map(|each| each.0).collect();
        return Err(format!("the first argument is one of {}", names.join(", ")).into());
    };
    measure(rest)
}
