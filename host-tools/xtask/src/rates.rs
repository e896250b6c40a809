//! How fast the package replays, beside the program and numpy: `docs/tables/rates.md`.

use crate::{
    accuracy::Options,
    process, python, tree, wheel,
    workspace::{Part, Workspace},
};
use anyhow::{Context, Result};
use std::{fs, process::Command};

/// What the script imports beside the package.
const IMPORTS: &str = "numpy, pyarrow";
const REQUIREMENTS: &str = "tests/python/files-requirements.txt";
/// Length of the runs.
const DURATION_S: &str = "600";

/// Measures program and package as they are released, and prints or writes the table.
pub fn run(options: &Options) -> Result<()> {
    let workspace = Workspace::read(&tree::root())?;
    let folder = workspace.target.join("rates");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let python = python::environment(&folder.join("environment"), IMPORTS, REQUIREMENTS, false)?;
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--force-reinstall", "--no-deps"]);
    process::run(pip.arg(wheel::released()?)).context("the wheel could not be installed")?;
    process::run(Part::Main.cargo().args(["build", "--release", "--locked", "--package", "inerter"]).args([
        "--no-default-features",
        "--features",
        "bridges",
    ]))?;
    let program = workspace.target.join("release").join(format!("inerter{}", std::env::consts::EXE_SUFFIX));
    let mut paths = Vec::new();
    for seed in ["1", "2"] {
        let path = folder.join(format!("{seed}.mcap"));
        let mut simulate = Command::new(&program);
        simulate.args(["simulate", "--duration", DURATION_S, "--excite", "random", "--seed", seed, "--force"]);
        // numpy does not undo its motion.
        simulate.args(["--structure-mass-kg", "0", "-o"]);
        process::run(simulate.arg(&path))?;
        paths.push(path);
    }
    let script = tree::root().join("tests/python/rates.py");
    let table = process::output(Command::new(&python).arg(script).arg(&program).args(&paths))?;
    print!("{table}");
    if options.update {
        let path = tree::root().join("docs/tables/rates.md");
        fs::write(&path, table).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
