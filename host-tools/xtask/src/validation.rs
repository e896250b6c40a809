//! Evidence for the intervals: recordings of real machines, the same data through other methods, and another plant;
//! methods and plant are written in Python.

use crate::{
    accuracy, process, python,
    table::Options,
    workspace::{self, Part},
};
use anyhow::Result;

/// What the other methods import.
const IMPORTS: &str = "numpy, scipy";

/// Their versions.
const REQUIREMENTS: &str = "tests/python/validation-requirements.txt";

/// The data, the other methods, the table.
pub fn run(options: &Options) -> Result<()> {
    let folder = workspace::folder("validation")?;
    let path = folder.to_string_lossy().into_owned();
    // Files of an earlier run must not be mistaken for this run's.
    for left in ["rivals.json", "plant.json"] {
        let _ = std::fs::remove_file(folder.join(left));
    }
    accuracy::tested("validation", ["--data", &path])?;
    let python = python::environment(&folder.join("python"), IMPORTS, REQUIREMENTS, false)?;
    process::run(python::script(&python, "validation.py").arg(&folder))?;
    let inerter = workspace::tested(Part::Main, "inerter")?;
    process::run(python::script(&python, "plant.py").args([&folder, &inerter]))?;
    let update = options.update.then_some("--update");
    accuracy::tested("validation", ["--rivals", &path].into_iter().chain(update))
}
