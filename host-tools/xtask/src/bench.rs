//! Our update compared with other recursive least squares, in one run on the same regressors.

use crate::{
    accuracy, process, python, tree,
    workspace::{self, Part},
};
use anyhow::Result;
use std::path::Path;

/// The packages in the comparison, as Python imports them.
const IMPORTS: &str = "numpy, scipy, padasip, filterpy";

/// Their versions.
const REQUIREMENTS: &str = "tests/python/requirements.txt";

#[derive(clap::Args)]
pub struct Options {
    /// Leave out the Python packages
    #[arg(long)]
    no_python: bool,
    /// Write docs/tables/bench.md
    #[arg(long)]
    update: bool,
}

/// Runs the comparison and writes `docs/tables/bench.md` if asked.
pub fn run(options: &Options) -> Result<()> {
    let folder = workspace::folder("bench")?;
    let regressors = folder.join("regressors.bin");
    let rivals = folder.join("python.json");
    // A file of an earlier run must not be mistaken for this run's.
    let _ = std::fs::remove_file(&rivals);
    let path = |path: &Path| path.to_string_lossy().into_owned();
    accuracy::program(Part::Bench, "bench", ["regressors", &path(&regressors)])?;
    let mut arguments = vec!["compare".to_owned()];
    let compared = if options.no_python {
        Err(anyhow::anyhow!("left out by --no-python"))
    } else {
        python::environment(&folder.join("python"), IMPORTS, REQUIREMENTS, true)
            .and_then(|python| process::run(python::script(&python, "bench_rivals.py").args([&regressors, &rivals])))
    };
    match compared {
        Ok(()) => arguments.extend(["--python".to_owned(), path(&rivals)]),
        Err(reason) => {
            println!("Python packages are not compared: {reason:#}");
            arguments.extend(["--without-python".to_owned(), format!("{reason:#}")]);
        }
    }
    if options.update {
        arguments.extend(["--write".to_owned(), path(&tree::root().join("docs/tables/bench.md"))]);
    }
    accuracy::program(Part::Bench, "bench", &arguments)
}

/// `inerter identify` must be at least this many times faster.
const FASTER: f64 = 20.0;
/// Time limit for scipy \[s\].
const MOST_S: f64 = 600.0;

/// The complete model by our program and by scipy, one after the other on the same samples.
pub fn identify() -> Result<()> {
    let folder = workspace::folder("bench")?;
    let problem = folder.join("identify.json");
    let path = problem.to_string_lossy().into_owned();
    accuracy::program(Part::Main, "measure", ["identify", "--bench", &path])?;
    let python = python::environment(&folder.join("python"), IMPORTS, REQUIREMENTS, true)?;
    process::run(python::script(&python, "identify_scipy.py").arg(&problem).arg(MOST_S.to_string()))?;
    accuracy::program(Part::Main, "measure", ["identify", "--compare", &path, &FASTER.to_string()])
}
