//! The Python package as a wheel, and its tests against the program.

use crate::{
    data, process, python, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, bail};
use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::Command,
};

/// Folder of the package, and below it what its tests need.
const PACKAGE: &str = "host-tools/python";
const REQUIREMENTS: &str = "host-tools/python/tests/requirements.txt";
const IMPORTS: &str =
    "boto3, distributed, duckdb, ipykernel, maturin, moto, mypy, nbclient, numpy, pandas, polars, pyarrow, pytest";

/// What takes a fifth of the time of all its tests, and runs with the package as released.
const LONG: &str = "tests/test_notebooks.py::test_a_notebook_prints_what_stands_in_it[thousand_runs]";

/// Names the real cargo if maturin was given this program as cargo.
pub const CARGO: &str = "INERTER_CARGO";

#[derive(clap::Args, Default)]
pub struct Options {
    /// Build it quickly, as the tests do, not for speed
    #[arg(long)]
    pub debug: bool,
}

/// Builds the wheel and tests it in a separate environment.
pub fn run(options: &Options) -> Result<()> {
    let target = workspace::target()?;
    let python = environment(&target)?;
    // The wheel for the tests has a separate folder.
    let folder = target.join(if options.debug { "wheel/debug" } else { "wheels" });
    let wheel = built(&python, &folder, options)?;
    python::install(&python, &wheel)?;
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
    if options.debug {
        tests.args(["--deselect", LONG]);
    }
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
    let target = workspace::target()?;
    built(&environment(&target)?, &target.join("wheels"), &Options::default())
}

/// A Python with the packages that build and test the wheel.
fn environment(target: &Path) -> Result<PathBuf> {
    python::environment(&target.join("wheel/environment"), IMPORTS, REQUIREMENTS, false)
}

/// The wheel in a folder that holds nothing else.
fn built(python: &Path, folder: &Path, options: &Options) -> Result<PathBuf> {
    tree::remove(folder)?;
    let mut maturin = Command::new(python);
    maturin.current_dir(tree::root()).args(["-m", "maturin", "build", "--locked", "--quiet"]);
    maturin.args(["--profile", if options.debug { "dev" } else { "release" }]);
    maturin.arg("--manifest-path").arg(Path::new(PACKAGE).join("Cargo.toml")).arg("--out").arg(folder);
    if options.debug {
        let program = env::current_exe().context("where this program lies")?;
        maturin.env(CARGO, process::cargo().get_program()).env("CARGO", program);
    }
    process::run(&mut maturin).context("the wheel could not be built")?;
    let wheels = tree::files(folder).with_context(|| format!("no wheel in {}", folder.display()))?;
    match <[PathBuf; 1]>::try_from(wheels) {
        Ok([wheel]) => Ok(wheel),
        Err(others) => bail!("one wheel is expected in {}, not {}", folder.display(), others.len()),
    }
}

/// Takes the place of `cargo` for maturin, which compiles the package alone: cargo would then enable fewer features of
/// the libraries than for the tests, and compile them again. This enables the features of the tests.
pub fn as_cargo(cargo: &OsStr) -> Result<()> {
    let given: Vec<_> = env::args_os().skip(1).collect();
    let mut command = Command::new(cargo);
    if given.first().is_some_and(|first| first == "rustc") {
        let beside = Part::Main.all("build");
        command.args(beside.get_args()).args(["--lib", "--tests", "--quiet"]).current_dir(tree::root());
        command.arg("--message-format=json-render-diagnostics");
    } else {
        command.args(given);
    }
    process::run(command.env_remove(CARGO).env("CARGO", cargo))
}
