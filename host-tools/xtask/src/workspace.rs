//! The three workspaces, what `cargo metadata` reports of them, and the programs made from them.

use crate::{process, tree};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::{
    collections::BTreeSet,
    path::{Component, Path, PathBuf},
    process::Command,
};

/// The default features of all members but `inerter/probe`: probe-rs takes as long to compile as all the rest, and only
/// `inerter flash` needs it.
const LEAN: &[&str] = &["--no-default-features", "--features", "inerter/lean,inerter-stm32g474/board-nucleo"];

/// The workspaces. All build into one folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Everything that ships, and most tests; builds on any machine.
    Main,
    /// The comparison with other recursive least squares.
    Bench,
    /// The twin, whose emulator needs CMake and libclang, and the programs that run in its Linux guest.
    Twin,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Main, Self::Bench, Self::Twin];

    /// Its folder.
    pub fn folder(self) -> PathBuf {
        match self {
            Self::Main => tree::root(),
            Self::Bench => tree::root().join("tests/bench"),
            Self::Twin => tree::root().join("tests/twin"),
        }
    }

    /// `cargo`, from its folder.
    pub fn cargo(self) -> Command {
        let mut cargo = process::cargo();
        cargo.current_dir(self.folder());
        cargo
    }

    /// `cargo COMMAND` for all its members, with their default features.
    pub fn whole(self, command: &str) -> Command {
        let mut cargo = self.cargo();
        cargo.args([command, "--workspace", "--locked"]);
        cargo
    }

    /// The same without the library for probes.
    pub fn all(self, command: &str) -> Command {
        let mut cargo = self.whole(command);
        cargo.args(self.features());
        cargo
    }

    /// The features that all of its members are built with.
    pub fn features(self) -> &'static [&'static str] {
        match self {
            Self::Main => LEAN,
            Self::Bench | Self::Twin => &[],
        }
    }

    /// Runs an action for each, and continues after a failure.
    pub fn each(mut action: impl FnMut(Self) -> Result<()>) -> Result<()> {
        let failed = Self::ALL.into_iter().filter_map(|part| action(part).err());
        let failed: Vec<_> = failed.map(|error| format!("{error:#}")).collect();
        ensure!(failed.is_empty(), "{}", failed.join("; "));
        Ok(())
    }
}

/// Folder of one more workspace: foreign programs, which the twin runs.
pub fn foreign() -> PathBuf {
    Part::Twin.folder().join("foreign")
}

/// Cargo's target folder.
pub fn target() -> Result<PathBuf> {
    Ok(Workspace::read(&tree::root())?.target)
}

/// A folder in it, created if it is missing.
pub fn folder(name: &str) -> Result<PathBuf> {
    let folder = target()?.join(name);
    tree::make(&folder)?;
    Ok(folder)
}

/// File in which each test that could not run leaves its name and the reason.
pub fn skipped_list() -> Result<PathBuf> {
    Ok(target()?.join("skipped.txt"))
}

/// What `cargo metadata` reports of the workspace in a folder and of all packages that its lock file names.
pub fn metadata(folder: &Path) -> Result<Value> {
    let mut cargo = process::cargo();
    cargo.current_dir(folder).args(["metadata", "--format-version", "1", "--locked"]);
    parsed(&process::output(&mut cargo)?)
}

fn parsed(json: &str) -> Result<Value> {
    serde_json::from_str(json).context("`cargo metadata` printed no JSON")
}

/// The packages that `cargo tree` lists in a folder, each as `NAME VERSION`.
pub fn packages(folder: &Path, edges: &str, arguments: &[&str]) -> Result<BTreeSet<String>> {
    let mut cargo = process::cargo();
    cargo.current_dir(folder).args(["tree", "--locked", "--edges", edges, "--prefix", "none", "--format", "{p}"]);
    Ok(listed(&process::output(cargo.args(arguments))?))
}

/// Name and version from each line of `cargo tree`; some packages come again.
fn listed(printed: &str) -> BTreeSet<String> {
    let words = printed.lines().map(str::split_whitespace);
    words.filter_map(|mut words| Some(format!("{} {}", words.next()?, words.next()?.strip_prefix('v')?))).collect()
}

/// One member of a workspace.
#[derive(Debug)]
pub struct Member {
    /// Package name.
    pub name: String,
    /// Folder of its manifest.
    pub folder: PathBuf,
    /// Root files of its libraries and programs, if below its folder: others are not ours.
    pub roots: Vec<PathBuf>,
    /// What it depends on.
    pub uses: Vec<Use>,
}

/// One declared dependency.
#[derive(Debug)]
pub struct Use {
    /// Package name, whatever it is renamed to.
    pub name: String,
    /// Only for tests, benches and examples.
    pub dev: bool,
}

/// The workspace as cargo reports it.
#[derive(Debug)]
pub struct Workspace {
    /// All members.
    pub members: Vec<Member>,
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

    /// The main workspace with the members of all others.
    pub fn with_all_members() -> Result<Self> {
        let mut workspace = Self::read(&tree::root())?;
        for folder in [Part::Bench.folder(), Part::Twin.folder(), foreign()] {
            workspace.members.extend(Self::read(&folder)?.members);
        }
        Ok(workspace)
    }

    /// Reads the JSON of `cargo metadata`.
    pub fn parse(json: &str) -> Result<Self> {
        let value = parsed(json)?;
        let members = array(&value, "packages")?.iter().map(member).collect::<Result<Vec<_>>>()?;
        Ok(Self { members, target: text(&value, "target_directory")?.into() })
    }

    /// The member of this name.
    pub fn member(&self, name: &str) -> Option<&Member> {
        self.members.iter().find(|member| member.name == name)
    }
}

fn member(value: &Value) -> Result<Member> {
    let manifest = PathBuf::from(text(value, "manifest_path")?);
    let folder = manifest.parent().with_context(|| format!("{}: a manifest without a folder", manifest.display()))?;
    let mut roots = Vec::new();
    for target in array(value, "targets")? {
        let kinds = array(target, "kind")?;
        let root = PathBuf::from(text(target, "src_path")?);
        if kinds.iter().any(|kind| matches!(kind.as_str(), Some("lib" | "bin" | "rlib" | "proc-macro")))
            && root.strip_prefix(folder).is_ok_and(|below| below.components().all(|one| one != Component::ParentDir))
        {
            roots.push(root);
        }
    }
    let uses = array(value, "dependencies")?
        .iter()
        .map(|one| Ok(Use { name: text(one, "name")?.to_owned(), dev: one["kind"].as_str() == Some("dev") }))
        .collect::<Result<Vec<_>>>()?;
    Ok(Member { name: text(value, "name")?.to_owned(), folder: folder.into(), roots, uses })
}

fn array<'a>(value: &'a Value, field: &str) -> Result<&'a Vec<Value>> {
    value[field].as_array().with_context(|| format!("`cargo metadata`: no list `{field}`"))
}

fn text<'a>(value: &'a Value, field: &str) -> Result<&'a str> {
    value[field].as_str().with_context(|| format!("`cargo metadata`: no text `{field}`"))
}

/// A program of a workspace, as built for its integration tests. All tests are built at once: for another selection of
/// packages cargo would enable other features of the libraries, and compile them again.
pub fn tested(part: Part, name: &str) -> Result<PathBuf> {
    process::run(part.all("test").args(["--quiet", "--no-run"]))?;
    program(name, "debug")
}

/// The host program as a user installs it, except for the feature `probe`.
pub fn installed() -> Result<PathBuf> {
    let lean = ["build", "--package", "inerter", "--no-default-features", "--features", "inerter/lean"];
    process::run(process::cargo().args(lean).args(["--quiet", "--bin", "inerter", "--release"]))?;
    program("inerter", "release")
}

/// Where cargo leaves a program.
pub fn program(name: &str, folder: &str) -> Result<PathBuf> {
    Ok(target()?.join(folder).join(format!("{name}{}", std::env::consts::EXE_SUFFIX)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_has_the_same_features_by_an_alias() {
        let config = std::fs::read_to_string(tree::root().join(".cargo/config.toml")).unwrap();
        for command in ["build", "test"] {
            let alias = format!("{command}-lean = \"{command} --workspace {}\"\n", LEAN.join(" "));
            assert!(config.contains(&alias), "{alias}");
        }
    }

    #[test]
    fn a_field_that_is_missing_is_named() {
        let error = Workspace::parse(r#"{"packages": [{"name": "a"}]}"#).unwrap_err();
        assert!(error.to_string().contains("manifest_path"));
        assert!(Workspace::parse("not json").is_err());
    }

    #[test]
    fn a_package_counts_once() {
        let printed = "a v1.0.0\nb v1.0.0 (proc-macro)\na v1.0.0 (*)\na v2.0.0\n\nb v1.0.0 (proc-macro) (*)\n\
                       p v0.1.0 (/w/p)\np v0.1.0 (/w/p) (*)\n";
        let packages = ["a 1.0.0", "a 2.0.0", "b 1.0.0", "p 0.1.0"].map(String::from);
        assert_eq!(listed(printed), BTreeSet::from(packages));
    }

    /// A published example is in another folder, and does not exist before it is fetched.
    #[test]
    fn a_root_outside_of_the_folder_is_not_ours() {
        let json = r#"{
            "packages": [{
                "name": "a", "manifest_path": "/w/a/Cargo.toml", "dependencies": [],
                "targets": [
                    {"kind": ["bin"], "src_path": "/w/a/src/main.rs"},
                    {"kind": ["bin"], "src_path": "/w/a/../target/other.rs"},
                    {"kind": ["bin"], "src_path": "/w/b/main.rs"}
                ]
            }],
            "workspace_root": "/w", "target_directory": "/w/target"
        }"#;
        let workspace = Workspace::parse(json).unwrap();
        assert_eq!(workspace.members[0].roots, [PathBuf::from("/w/a/src/main.rs")]);
    }
}
