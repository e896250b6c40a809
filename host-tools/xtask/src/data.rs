//! Published recordings of real machines, converted for the tests; docs/DATA.md says where to find them.

use crate::{process, tree, workspace};
use anyhow::{Context, Result};
use std::path::{PathBuf, absolute};

/// Environment variable that names the folder of recordings, relative to the root.
const FOLDER: &str = "INERTER_DATA";

#[derive(clap::Args)]
pub struct Options {
    /// The originals, as they were downloaded
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Folder for the recordings; by default the one in INERTER_DATA, else target/data
    #[arg(short, long)]
    output: Option<PathBuf>,
}

/// The folder that the variable names.
fn named() -> Option<PathBuf> {
    let named = std::env::var_os(FOLDER).filter(|named| !named.is_empty());
    named.map(|named| tree::root().join(named))
}

/// The folder from which the tests take recordings: the one in the variable, else the one beside the project if it
/// exists.
pub fn folder() -> Option<PathBuf> {
    named().or_else(|| Some(tree::root().join("../shared/data")).filter(|folder| folder.is_dir()))
}

/// Runs the converter and says how the tests find what it wrote.
pub fn run(options: &Options) -> Result<()> {
    let folder = match (&options.output, named()) {
        (Some(folder), _) => absolute(folder)?,
        (None, Some(named)) => named,
        (None, None) => workspace::target()?.join("data"),
    };
    // The converter runs from the root.
    let files = options.files.iter().map(absolute).collect::<Result<Vec<_>, _>>()?;
    let run = ["run", "--quiet", "--locked", "--package", "inerter-originals", "--"];
    process::run(process::cargo().args(run).arg(&folder).args(files)).context("the recordings were not converted")?;
    println!("tests that use them: `{FOLDER}={} cargo xtask test`", folder.display());
    Ok(())
}
