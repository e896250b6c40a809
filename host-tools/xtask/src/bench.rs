//! Our update beside other recursive least squares, in one run on the same regressors.

use crate::{
    accuracy, process,
    workspace::{self, Workspace},
};
use anyhow::{Context, Result, bail};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// The packages that join the comparison, as Python imports them.
const IMPORTS: &str = "import numpy, scipy, padasip, filterpy; print('complete')";

/// Their versions.
const REQUIREMENTS: &str = "tests/python/requirements.txt";

#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Options {
    /// Leave out the Python packages
    #[arg(long)]
    pub no_python: bool,
    /// Write docs/tables/bench.md
    #[arg(long)]
    pub update: bool,
}

/// Runs the comparison and writes `docs/tables/bench.md` where that is asked for.
pub fn run(options: &Options) -> Result<()> {
    let folder = folder()?;
    let regressors = folder.join("regressors.bin");
    let rivals = folder.join("python.json");
    // What an earlier run left must not pass for this one's.
    let _ = std::fs::remove_file(&rivals);
    let path = |path: &Path| path.to_string_lossy().into_owned();
    accuracy::program("bench", &["regressors", &path(&regressors)])?;
    let mut arguments = vec!["compare".to_owned()];
    let compared = if options.no_python {
        Err(anyhow::anyhow!("left out by --no-python"))
    } else {
        python(&folder).and_then(|python| {
            let script = workspace::root().join("tests/python/bench_rivals.py");
            process::run(Command::new(python).arg(script).arg(&regressors).arg(&rivals))
        })
    };
    match compared {
        Ok(()) => arguments.extend(["--python".to_owned(), path(&rivals)]),
        Err(reason) => {
            println!("Python packages are not compared: {reason:#}");
            arguments.extend(["--without-python".to_owned(), format!("{reason:#}")]);
        }
    }
    if options.update {
        arguments.extend(["--write".to_owned(), path(&workspace::root().join("docs/tables/bench.md"))]);
    }
    accuracy::program("bench", &arguments.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Where the comparison keeps its files.
fn folder() -> Result<PathBuf> {
    let folder = Workspace::read(&workspace::root())?.target.join("bench");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}

/// A Python with the packages, in an environment of its own.
fn python(folder: &Path) -> Result<PathBuf> {
    let environment = folder.join("python");
    let python = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let complete = |python: &Path| process::first_line(Command::new(python).args(["-c", IMPORTS])).is_some();
    if python.is_file() && complete(&python) {
        return Ok(python);
    }
    let system = ["python3", "python"]
        .into_iter()
        .find(|name| process::first_line(Command::new(name).arg("--version")).is_some());
    let Some(system) = system else { bail!("no python3 on this machine") };
    println!("Python packages for the comparison, by {REQUIREMENTS}, into {}", environment.display());
    process::run(Command::new(system).args(["-m", "venv"]).arg(&environment))
        .context("no virtual environment could be made (on Debian: `apt-get install python3-venv`)")?;
    // filterpy names matplotlib among its requirements and uses it only to plot.
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--no-deps", "--requirement"]);
    process::run(pip.arg(workspace::root().join(REQUIREMENTS))).context("the packages could not be installed")?;
    Ok(python)
}
