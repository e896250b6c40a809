//! The Python package as a wheel, and its tests against the program.

use crate::{
    data, process, python, tree,
    workspace::{self, Part, Workspace},
};
use anyhow::{Context, Result, bail};
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Folder of the package, and below it what its tests need.
const PACKAGE: &str = "host-tools/python";
const REQUIREMENTS: &str = "host-tools/python/tests/requirements.txt";
const IMPORTS: &str =
    "boto3, distributed, duckdb, ipykernel, maturin, moto, mypy, nbclient, numpy, pandas, polars, pyarrow, pytest";

#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Options {
    /// Build it quickly, as the tests do, not for speed
    #[arg(long)]
    pub debug: bool,
}

/// Builds the wheel and tests it in an environment of its own.
pub fn run(options: &Options) -> Result<()> {
    let target = Workspace::read(&tree::root())?.target;
    let python = python::environment(&target.join("wheel/environment"), IMPORTS, REQUIREMENTS, false)?;
    // The wheel for the tests has a folder of its own.
    let folder = target.join(if options.debug { "wheel/debug" } else { "wheels" });
    let wheel = built(&python, &folder, options)?;
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--force-reinstall", "--no-deps"]);
    process::run(pip.arg(&wheel)).context("the wheel could not be installed")?;
    let package = tree::root().join(PACKAGE);
    let module = |name: &str, arguments: &[&str]| {
        let mut command = Command::new(&python);
        command.current_dir(&package).args(["-m", name]).args(arguments);
        // Nothing is left in the source tree.
        command.env("PYTHONDONTWRITEBYTECODE", "1").env("MYPY_CACHE_DIR", target.join("wheel/types"));
        command
    };
    process::run(&mut module("mypy", &["--strict", "python/inerter"])).context("types of the package")?;
    // The stubs must match the module.
    process::run(&mut module("mypy.stubtest", &["inerter"])).context("stubs of the package")?;
    let mut tests = module("pytest", &["-q", "-p", "no:cacheprovider", "tests"]);
    tests.env("INERTER", workspace::tested(Part::Main, "inerter")?).env("INERTER_CONFIG", "");
    match data::folder() {
        Some(folder) => drop(tests.env("RECORDINGS", folder)),
        None => {
            let reason = "no recordings of real machines; docs/DATA.md says where they come from";
            inerter_needs::list(&workspace::skipped_list()?, "Python package, recordings", reason)?;
        }
    }
    process::run(&mut tests).context("tests of the package")?;
    println!("{}: `pip install` it into Python 3.10 or later", wheel.display());
    Ok(())
}

/// The wheel as it is released.
pub fn released() -> Result<PathBuf> {
    let target = Workspace::read(&tree::root())?.target;
    let python = python::environment(&target.join("wheel/environment"), IMPORTS, REQUIREMENTS, false)?;
    built(&python, &target.join("wheels"), &Options::default())
}

/// The wheel in a folder that holds nothing else.
fn built(python: &Path, folder: &Path, options: &Options) -> Result<PathBuf> {
    if folder.is_dir() {
        fs::remove_dir_all(folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    let mut maturin = Command::new(python);
    maturin.current_dir(tree::root()).args(["-m", "maturin", "build", "--locked", "--quiet"]);
    maturin.args(["--profile", if options.debug { "dev" } else { "release" }]);
    maturin.arg("--manifest-path").arg(Path::new(PACKAGE).join("Cargo.toml")).arg("--out").arg(folder);
    process::run(&mut maturin).context("the wheel could not be built")?;
    let mut wheels = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("no wheel in {}", folder.display()))? {
        wheels.push(entry?.path());
    }
    match wheels.as_slice() {
        [wheel] => Ok(wheel.clone()),
        others => bail!("one wheel is expected in {}, not {}", folder.display(), others.len()),
    }
}
