//! Foreign programs that the twin runs (`tests/twin/foreign`), among them examples of a published crate.

use crate::{
    copy, process,
    toolchain::Toolchain,
    tree::{self, FIRMWARE_TARGET},
    workspace,
};
use anyhow::{Context, Result};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// The variable that tells tests where the programs are.
pub const VARIABLE: &str = "INERTER_FOREIGN";
/// The crate whose examples are run as they were published.
const PUBLISHED: &str = "stm32g4xx-hal";
/// The programs that we wrote.
const OWN: &str = "inerter-foreign";

/// A command for this workspace.
fn at(mut command: Command) -> Command {
    command.current_dir(workspace::foreign());
    command
}

/// Builds them all and returns their folder.
pub fn build(toolchain: &Toolchain) -> Result<PathBuf> {
    let metadata = workspace::metadata(&workspace::foreign())?;
    let target = Path::new(metadata["target_directory"].as_str().context("`cargo metadata`: no target folder")?);
    let examples = package(&metadata, PUBLISHED).context("the published examples are not among the dependencies")?;
    let (from, to) = (examples.join("examples"), target.join("foreign").join(PUBLISHED));
    for file in tree::files(&from)? {
        // A file that has not changed stays untouched, so that cargo does not rebuild it.
        copy::written(&to.join(file.strip_prefix(&from)?), &tree::read(&file)?)?;
    }
    process::run(at(toolchain.cargo("build")).args(["--workspace", "--release", "--locked", "--quiet"]))
        .context("foreign programs")?;
    Ok(target.join(FIRMWARE_TARGET).join("release"))
}

/// Checks format and lints of the programs that we wrote.
pub fn lint(toolchain: &Toolchain) -> Result<()> {
    process::run(at(process::cargo()).args(["fmt", "--package", OWN, "--check"]))?;
    process::run(&mut at(toolchain.clippy(&["--release", "--package", OWN])))
}

/// The folder of a package.
fn package(metadata: &Value, name: &str) -> Option<PathBuf> {
    let package = metadata["packages"].as_array()?.iter().find(|package| package["name"] == name)?;
    Some(Path::new(package["manifest_path"].as_str()?).parent()?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_package_lies_where_its_manifest_does() {
        let metadata = serde_json::json!({ "packages": [
            { "name": "other", "manifest_path": "/o/Cargo.toml" },
            { "name": PUBLISHED, "manifest_path": "/registry/it/Cargo.toml" },
        ]});
        assert_eq!(package(&metadata, PUBLISHED), Some("/registry/it".into()));
        assert_eq!(package(&metadata, "none"), None);
    }
}
