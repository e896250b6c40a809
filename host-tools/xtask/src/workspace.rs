//! What `cargo metadata` says of the workspace, and the program made from it.

use crate::{process, tree};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// One member of the workspace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Package name.
    pub name: String,
    /// Folder of its manifest.
    pub folder: PathBuf,
    /// Root files of its libraries and programs.
    pub roots: Vec<PathBuf>,
    /// What it depends on.
    pub uses: Vec<Use>,
}

/// One declared dependency.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Use {
    /// Package name, whatever it is renamed to.
    pub name: String,
    /// Only for tests, benches and examples.
    pub dev: bool,
}

/// The workspace as cargo sees it.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// All members.
    pub members: Vec<Member>,
    /// Root folder.
    pub root: PathBuf,
    /// Where cargo builds.
    pub target: PathBuf,
}

impl Workspace {
    /// Asks cargo about the workspace in `root`.
    pub fn read(root: &Path) -> Result<Self> {
        let mut command = process::cargo();
        command.current_dir(root).args(["metadata", "--format-version", "1", "--no-deps"]);
        Self::parse(&process::output(&mut command)?)
    }

    /// Reads the JSON of `cargo metadata`.
    pub fn parse(json: &str) -> Result<Self> {
        let value: Value = serde_json::from_str(json).context("`cargo metadata` printed no JSON")?;
        let members = array(&value, "packages")?.iter().map(member).collect::<Result<Vec<_>>>()?;
        Ok(Self {
            members,
            root: text(&value, "workspace_root")?.into(),
            target: text(&value, "target_directory")?.into(),
        })
    }

    /// The member of this name.
    pub fn member(&self, name: &str) -> Option<&Member> {
        self.members.iter().find(|member| member.name == name)
    }
}

fn member(value: &Value) -> Result<Member> {
    let manifest = PathBuf::from(text(value, "manifest_path")?);
    let mut roots = Vec::new();
    for target in array(value, "targets")? {
        let kinds = array(target, "kind")?;
        if kinds.iter().any(|kind| matches!(kind.as_str(), Some("lib" | "bin" | "rlib" | "proc-macro"))) {
            roots.push(text(target, "src_path")?.into());
        }
    }
    let uses = array(value, "dependencies")?
        .iter()
        .map(|one| Ok(Use { name: text(one, "name")?.to_owned(), dev: one["kind"].as_str() == Some("dev") }))
        .collect::<Result<Vec<_>>>()?;
    let Some(folder) = manifest.parent() else { bail!("{}: a manifest without a folder", manifest.display()) };
    Ok(Member { name: text(value, "name")?.to_owned(), folder: folder.into(), roots, uses })
}

fn array<'a>(value: &'a Value, field: &str) -> Result<&'a Vec<Value>> {
    value[field].as_array().with_context(|| format!("`cargo metadata`: no list `{field}`"))
}

fn text<'a>(value: &'a Value, field: &str) -> Result<&'a str> {
    value[field].as_str().with_context(|| format!("`cargo metadata`: no text `{field}`"))
}

/// `cargo COMMAND` for everything that runs on this machine.
pub fn on_host(command: &str) -> Command {
    let mut cargo = process::cargo();
    cargo.args([command, "--workspace", "--locked"]);
    for package in tree::FIRMWARE_PACKAGES {
        cargo.args(["--exclude", package]);
    }
    cargo
}

/// A program of a package with integration tests, as those have it. All tests are built at once: for each other choice of packages
/// cargo would turn other features of the libraries on, and compile them once more.
pub fn tested(name: &str) -> Result<PathBuf> {
    process::run(on_host("test").args(["--quiet", "--no-run"]))?;
    program(name, "debug")
}

/// The host program as a user installs it.
pub fn installed() -> Result<PathBuf> {
    process::run(process::cargo().args(["build", "--quiet", "--package", "inerter", "--bin", "inerter", "--release"]))?;
    program("inerter", "release")
}

/// Where cargo leaves a program.
fn program(name: &str, folder: &str) -> Result<PathBuf> {
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    Ok(Workspace::read(&tree::root())?.target.join(folder).join(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_is_missing_is_named() {
        let error = Workspace::parse(r#"{"packages": [{"name": "a"}]}"#).unwrap_err();
        assert!(error.to_string().contains("manifest_path"));
        assert!(Workspace::parse("not json").is_err());
    }
}
