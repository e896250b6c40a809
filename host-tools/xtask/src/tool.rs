//! Third-party subcommands of cargo: found on this machine, or installed below `target/tools`.

use crate::{process, python, toolchain::at_least, tree, workspace};
use anyhow::{Context, Result, ensure};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tool {
    /// Name of its package and of its program.
    pub name: &'static str,
    /// The version that is installed.
    version: &'static str,
    /// The oldest version that is accepted.
    least: &'static str,
}

/// Licences, bans, sources and advisories of packages.
pub const DENY: Tool = Tool { name: "cargo-deny", version: "0.20.2", least: "0.18.4" };
/// A bill of materials in the form of CycloneDX.
pub const CYCLONE_DX: Tool = Tool { name: "cargo-cyclonedx", version: "0.5.9", least: "0.5.7" };
/// Mutation testing.
pub const MUTANTS: Tool = Tool { name: "cargo-mutants", version: "27.1.0", least: "25.0.0" };

impl Tool {
    /// Its name as a subcommand of cargo.
    fn subcommand(self) -> &'static str {
        self.name.trim_start_matches("cargo-")
    }

    /// What to type if it cannot be installed from here.
    pub fn advice(self) -> String {
        format!("`cargo install {} --locked --version {}`", self.name, self.version)
    }

    /// The tool as cargo's own subcommand, ready for arguments; installed where it is missing.
    pub fn command(self) -> Result<Command> {
        let program = match self.found() {
            Ok((program, _)) => program,
            Err(reason) => {
                println!("{}: {reason}", self.name);
                self.install().with_context(|| format!("install it with {}", self.advice()))?;
                self.found().map_err(anyhow::Error::msg)?.0
            }
        };
        let mut command = Command::new(program);
        command.arg(self.subcommand()).current_dir(tree::root());
        Ok(command)
    }

    /// Its program and its version line; or why there is no suitable one.
    pub fn found(self) -> Result<(PathBuf, String), String> {
        let file = format!("{}{}", self.name, std::env::consts::EXE_SUFFIX);
        let folder = folder().map_err(|error| format!("{error:#}"))?;
        let installed = ["bin", "python/bin"].map(|below| folder.join(below).join(&file));
        let mut reason = "not there".to_owned();
        for program in [PathBuf::from(&file)].into_iter().chain(installed) {
            let Some(line) = process::first_line(Command::new(&program).args([self.subcommand(), "--version"])) else {
                continue;
            };
            match at_least(&line, self.least) {
                true => return Ok((program, line)),
                false => reason = format!("{line} is older than {}", self.least),
            }
        }
        Err(reason)
    }

    /// Installs the pinned version below `target/tools`: a compiled one, checked by the sum of its file, if there is
    /// one for this machine; else from its sources.
    pub fn install(self) -> Result<()> {
        let folder = folder()?;
        if self == DENY && cfg!(all(target_os = "linux", target_arch = "x86_64")) {
            match install_compiled(&folder) {
                Ok(()) => return Ok(()),
                Err(error) => println!("  {error:#}; compiling it instead"),
            }
        }
        let mut command = process::cargo();
        command.args(["install", self.name, "--locked", "--version", self.version, "--root"]).arg(&folder);
        println!("  $ {} (takes minutes, once)", process::shown(&command));
        process::run(&mut command)
    }
}

/// Where they are installed.
fn folder() -> Result<PathBuf> {
    Ok(workspace::target()?.join("tools"))
}

/// From the Python Package Index, which also hosts programs; pip checks the file's hash against ours.
fn install_compiled(folder: &Path) -> Result<()> {
    let pip = process::first_line(Command::new("python3").args(["-m", "pip", "--version"]));
    ensure!(pip.is_some(), "no pip on this machine");
    process::run_shown(
        python::pip(Path::new("python3"))
            .args(["--root-user-action", "ignore"])
            .args(["--no-deps", "--only-binary", ":all:", "--require-hashes", "--upgrade", "--target"])
            .arg(folder.join("python"))
            .arg("--requirement")
            .arg(tree::root().join("host-tools/xtask/deny-requirements.txt")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_compiled_tool_has_the_pinned_version() {
        let requirements = include_str!("../deny-requirements.txt");
        assert!(requirements.contains(&format!("cargo-deny=={} --hash=sha256:", DENY.version)));
    }
}
