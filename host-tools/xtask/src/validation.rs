//! What a reviewer asks of the intervals: recordings of real machines, and the same data through other methods, which are written in Python.

use crate::{
    accuracy::{self, Options},
    process, python, tree,
    workspace::Workspace,
};
use anyhow::{Context, Result};
use std::process::Command;

/// What the other methods import.
const IMPORTS: &str = "numpy, scipy";

/// Their versions.
const REQUIREMENTS: &str = "tests/python/validation-requirements.txt";

/// The data, the other methods, the table.
pub fn run(options: &Options) -> Result<()> {
    let folder = Workspace::read(&tree::root())?.target.join("validation");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let path = folder.to_string_lossy().into_owned();
    // What an earlier run left must not pass for this one's.
    let _ = std::fs::remove_file(folder.join("rivals.json"));
    accuracy::tested("validation", &["--data", &path])?;
    let python = python::environment(&folder.join("python"), IMPORTS, REQUIREMENTS, false)?;
    process::run(Command::new(python).arg(tree::root().join("tests/python/validation.py")).arg(&folder))?;
    let update = options.update.then_some("--update");
    accuracy::tested("validation", &["--rivals", &path].into_iter().chain(update).collect::<Vec<_>>())
}
