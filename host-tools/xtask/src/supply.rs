//! Checks what is linked against deny.toml: licences, banned packages, sources of packages, duplicates.
//!
//! Only packages that the lock files name and this machine lacks are fetched. Advisories need a list that changes every
//! day, so they are an option, which `.github/workflows/advisories.yml` uses.

use crate::{
    process, tool, tree,
    workspace::{self, Part},
};
use anyhow::{Result, ensure};
use std::path::Path;

#[derive(clap::Args, Default)]
pub struct Options {
    /// Fetch the list of known vulnerabilities from github.com, and look for each package in it
    #[arg(long)]
    pub advisories: bool,
}

/// What is checked.
const CHECKS: [&str; 3] = ["bans", "licenses", "sources"];

/// Lints for the workspace that ships: a line of deny.toml that no longer applies is an error.
const SHIPS: &[&str] = &[
    "--deny=unmatched-skip",
    "--deny=unnecessary-skip",
    "--deny=license-not-encountered",
    // These are for the twin.
    "--allow=unused-wrapper",
    "--allow=license-exception-not-encountered",
];

/// Each workspace for tests links only part of what deny.toml lists, and duplicates do no harm there.
const TESTS: &[&str] = &[
    "--allow=duplicate",
    "--allow=unmatched-skip",
    "--allow=unnecessary-skip",
    "--allow=license-not-encountered",
    "--allow=unused-wrapper",
    "--allow=license-exception-not-encountered",
    // unicorn-engine declares `GPL-2.0`, a deprecated identifier.
    "--allow=parse-error",
];

/// Checks all workspaces, and continues after a failure.
pub fn run(options: &Options) -> Result<()> {
    let mut failed = Vec::new();
    let parts = Part::ALL.map(|part| (part.folder(), if part == Part::Main { SHIPS } else { TESTS }));
    for (folder, lints) in parts.into_iter().chain([(workspace::foreign(), TESTS)]) {
        let name = if folder == tree::root() { Path::new(".") } else { folder.strip_prefix(tree::root())? }.display();
        println!("{name}:");
        if let Err(error) = check(&folder, lints, options) {
            failed.push(format!("{name} ({error:#})"));
        }
    }
    ensure!(failed.is_empty(), "deny.toml does not hold in {}", failed.join(", "));
    Ok(())
}

/// Checks one of them. Licences are read from the packages, which must therefore be present.
fn check(folder: &Path, lints: &[&str], options: &Options) -> Result<()> {
    process::run(process::cargo().current_dir(folder).args(["fetch", "--locked", "--quiet"]))?;
    process::run(
        tool::DENY
            .command()?
            .current_dir(folder)
            .args(["--locked", "--config"])
            .arg(tree::root().join("deny.toml"))
            .args((!options.advisories).then_some("--offline"))
            .args(["check", "--hide-inclusion-graph"])
            .args(lints)
            .args(CHECKS)
            .args(options.advisories.then_some("advisories")),
    )
}
