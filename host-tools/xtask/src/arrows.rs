//! Which crate may use which, and which modules import each other.
//!
//! Arrow: a dependency of one workspace member on another. The table below lists all that are allowed. A member that is
//! not in it is rejected, so a new crate must be added there first. Within a crate no module may import itself,
//! directly or through others ([`imports`]).

use crate::{
    imports, tree,
    workspace::{self, Member, Workspace},
};
use anyhow::{Context, Result, bail};
use std::{collections::BTreeSet, path::Path};

/// What one member may depend on. Names stand in one text, with blanks between them.
struct Law {
    member: &'static str,
    /// Other members it may use.
    may_use: &'static str,
    /// Further members that only its tests may use.
    tests_may_use: &'static str,
    /// Packages that must not be among its direct or indirect dependencies, with its default features; `dfu-*` means
    /// all names that begin with `dfu-`.
    never: &'static [&'static [&'static str]],
}

const fn law(
    member: &'static str,
    may_use: &'static str,
    tests_may_use: &'static str,
    never: &'static [&'static [&'static str]],
) -> Law {
    Law { member, may_use, tests_may_use, never }
}

/// Packages that parse a command line.
const COMMAND_LINE: &[&str] = &["clap"];
/// Packages that use USB or a serial port.
const USB: &[&str] = &["nusb", "serialport", "dfu-*", "probe-rs"];
/// Packages that display on a terminal or in a browser.
const SCREEN: &[&str] = &["ratatui", "crossterm", "axum", "indicatif"];
/// Packages that write Parquet and MATLAB files.
const TABLES: &[&str] = &["parquet", "hdf5-pure"];

/// The law. Nothing may use a program: the images, the host's, `xtask`, `inerter-bench`, `inerter-twin` and the foreign
/// programs are on no right-hand side. This matters most for the twin, as its emulator is GPL. Only `inerter-fuzz` may
/// use `inerter-tests`.
const LAWS: &[Law] = &[
    law("inerter-core", "", "inerter-needs inerter-plant", &[]),
    law("inerter-wire", "inerter-core", "inerter-needs", &[]),
    law("inerter-app", "inerter-core inerter-wire", "inerter-needs", &[]),
    law("ads131m04", "", "inerter-needs", &[]),
    law("inerter-qemu", "inerter-core inerter-wire inerter-app", "", &[]),
    law("inerter-stm32g474", "inerter-core inerter-wire inerter-app ads131m04", "", &[]),
    law("inerter-plant", "", "", &[]),
    law("inerter-serve", "", "", &[COMMAND_LINE, USB, SCREEN, TABLES]),
    law("inerter-flags", "inerter-core inerter-wire inerter-data", "", &[USB, SCREEN, TABLES]),
    law(
        "inerter-jumpers",
        "inerter-core inerter-wire inerter-app inerter-plant",
        "",
        &[COMMAND_LINE, USB, SCREEN, TABLES],
    ),
    law(
        "inerter-data",
        "inerter-core inerter-wire",
        "inerter-needs inerter-plant inerter-simulate",
        &[COMMAND_LINE, USB, SCREEN, &["plotters"]],
    ),
    law(
        "inerter-analysis",
        "inerter-core inerter-wire inerter-data inerter-plant",
        "inerter-needs inerter-simulate",
        &[COMMAND_LINE, USB, SCREEN, TABLES],
    ),
    law("inerter-device", "inerter-core inerter-wire", "", &[COMMAND_LINE, SCREEN, TABLES]),
    law(
        "inerter-simulate",
        "inerter-core inerter-wire inerter-app inerter-plant inerter-data",
        "",
        &[COMMAND_LINE, SCREEN],
    ),
    law("inerter-store", "inerter-core inerter-wire inerter-data inerter-analysis", "", &[COMMAND_LINE, USB, SCREEN]),
    law(
        "inerter-view",
        "inerter-core inerter-wire inerter-data inerter-analysis",
        "inerter-plant inerter-simulate",
        &[COMMAND_LINE, USB],
    ),
    law(
        "inerter-demo",
        "inerter-core inerter-wire inerter-plant inerter-data inerter-device inerter-simulate inerter-view",
        "",
        &[COMMAND_LINE, SCREEN],
    ),
    law(
        "inerter",
        "inerter-core inerter-wire inerter-app inerter-plant inerter-jumpers inerter-data inerter-analysis \
         inerter-device inerter-simulate inerter-store inerter-view inerter-serve inerter-flags",
        "inerter-needs",
        &[],
    ),
    law(
        "inerter-python",
        "inerter-core inerter-wire inerter-data inerter-analysis inerter-device inerter-simulate \
         inerter-store inerter-view",
        "",
        &[COMMAND_LINE, SCREEN],
    ),
    law("inerter-needs", "", "", &[]),
    law("inerter-originals", "", "", &[]),
    law("xtask", "inerter-needs", "", &[]),
    law(
        "inerter-tests",
        "inerter-needs inerter-core inerter-wire inerter-app inerter-plant inerter-data inerter-analysis \
         inerter-device inerter-simulate inerter-view",
        "",
        &[COMMAND_LINE, SCREEN],
    ),
    law("inerter-bench", "inerter-core inerter-plant", "", &[]),
    law(
        "inerter-fuzz",
        "inerter-core inerter-wire inerter-plant inerter-data inerter-device inerter-serve inerter-flags inerter-tests",
        "",
        &[&["ratatui", "crossterm", "indicatif"]],
    ),
    law("inerter-guest", "", "", &[]),
    law(
        "inerter-twin",
        "inerter-needs inerter-guest inerter-core inerter-wire inerter-app inerter-plant inerter-jumpers ads131m04",
        "",
        &[],
    ),
    law("inerter-foreign", "", "", &[]),
    law("inerter-published", "", "", &[]),
];

/// Checks the whole tree.
pub fn run() -> Result<()> {
    let root = tree::root();
    let workspace = Workspace::with_all_members()?;
    let mut faults = arrow_faults(&workspace);
    faults.extend(missing_faults(&workspace));
    for member in &workspace.members {
        faults.extend(never_faults(member)?);
        faults.extend(circle_faults(member, &root).unwrap_or_else(|error| vec![format!("{}: {error:#}", member.name)]));
    }
    faults.extend(memory_faults(&root, &workspace.target)?);
    if !faults.is_empty() {
        for fault in &faults {
            eprintln!("  {fault}");
        }
        bail!("{} of the project's rules broken (see above; the rules: host-tools/xtask/src/arrows.rs)", faults.len());
    }
    println!("arrows: {} members keep to the rules", workspace.members.len());
    Ok(())
}

/// Dependencies that the law does not allow.
fn arrow_faults(workspace: &Workspace) -> Vec<String> {
    let mut faults = Vec::new();
    for member in &workspace.members {
        let Some(law) = law_of(member) else {
            faults.push(format!(
                "{}: this crate has no entry in the table of allowed dependencies; add one",
                member.name
            ));
            continue;
        };
        for used in &member.uses {
            let name = used.name.as_str();
            let may = has(law.may_use, name) || (used.dev && has(law.tests_may_use, name));
            if !may && workspace.member(name).is_some() {
                let how = if used.dev { "uses in its tests" } else { "uses" };
                let listed =
                    if law.may_use.is_empty() { "none of ours".into() } else { law.may_use.replace(' ', ", ") };
                faults.push(format!("{} {how} {name}; it may use: {listed}", member.name));
            }
        }
    }
    faults
}

fn has(names: &str, name: &str) -> bool {
    names.split(' ').any(|one| one == name)
}

fn law_of(member: &Member) -> Option<&'static Law> {
    LAWS.iter().find(|law| law.member == member.name)
}

/// Laws whose member is gone.
fn missing_faults(workspace: &Workspace) -> Vec<String> {
    let gone = LAWS.iter().filter(|law| workspace.member(law.member).is_none());
    gone.map(|law| format!("{}: this entry names no crate; remove it", law.member)).collect()
}

/// Packages that a member must not pull in, on any system.
fn never_faults(member: &Member) -> Result<Vec<String>> {
    let Some(law) = law_of(member).filter(|law| !law.never.is_empty()) else { return Ok(Vec::new()) };
    let packages = workspace::packages(&member.folder, "normal", &["--package", law.member, "--target", "all"])?;
    let found = forbidden(&law.never.concat(), &packages);
    Ok(found
        .into_iter()
        .map(|name| format!("{0} pulls in {name}; `cargo tree -p {0} -e normal -i {name}` shows how", law.member))
        .collect())
}

/// The names of those packages that the law forbids.
fn forbidden<'a>(never: &[&str], packages: &'a BTreeSet<String>) -> BTreeSet<&'a str> {
    let names = packages.iter().filter_map(|package| package.split(' ').next());
    names
        .filter(|name| {
            never.iter().any(|one| match one.strip_suffix('*') {
                Some(start) => name.starts_with(start),
                None => one == name,
            })
        })
        .collect()
}

/// Import cycles within a member's library and programs.
fn circle_faults(member: &Member, root: &Path) -> Result<Vec<String>> {
    let mut faults = Vec::new();
    for file in &member.roots {
        let circles = imports::circles(file, root).with_context(|| tree::below(file, root))?;
        faults.extend(circles.into_iter().map(|circle| format!("{}: {circle}", member.name)));
    }
    Ok(faults)
}

/// The linker takes the root `memory.x` for every member, so a second one would misstate what is linked.
fn memory_faults(root: &Path, target: &Path) -> Result<Vec<String>> {
    let left_out = |folder: &Path| folder == target || folder.ends_with(".git") || folder.ends_with("target");
    let mut found = tree::files_except(root, left_out)?;
    found.retain(|path| path.ends_with("memory.x"));
    if found == [root.join("memory.x")] {
        return Ok(Vec::new());
    }
    let list: Vec<_> = found.iter().map(|path| tree::below(path, root)).collect();
    Ok(vec![format!("memory.x: exactly one is allowed, at the root; found: {}", list.join(", "))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;

    fn manifest(name: &str, rest: &str) -> String {
        format!("[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\n{rest}\n")
    }

    #[test]
    fn a_core_that_uses_the_plant_is_refused() {
        let fixture = Fixture::new(&[
            ("Cargo.toml", "[workspace]\nresolver = \"2\"\nmembers = [\"core\", \"plant\", \"stray\"]\n"),
            (
                "core/Cargo.toml",
                &manifest(
                    "inerter-core",
                    "[dependencies]\nrenamed = { package = \"inerter-plant\", path = \"../plant\" }",
                ),
            ),
            ("core/src/lib.rs", ""),
            ("plant/Cargo.toml", &manifest("inerter-plant", "")),
            ("plant/src/lib.rs", ""),
            ("stray/Cargo.toml", &manifest("stray", "[dev-dependencies]\nserde = \"1\"")),
            ("stray/src/lib.rs", ""),
            ("memory.x", ""),
            ("core/memory.x", ""),
        ]);
        let workspace = Workspace::read(&fixture.0).unwrap();
        let faults = arrow_faults(&workspace);
        assert_eq!(faults.len(), 2, "{faults:?}");
        assert!(faults.iter().any(|fault| fault == "inerter-core uses inerter-plant; it may use: none of ours"));
        assert!(faults.iter().any(|fault| fault.starts_with("stray: this crate has no entry")));

        let faults = memory_faults(&fixture.0, &fixture.0.join("target")).unwrap();
        assert_eq!(faults.len(), 1);
        assert!(faults[0].contains("core/memory.x"));
    }

    #[test]
    fn tests_may_not_use_a_program() {
        let json = r#"{"workspace_root": "/w", "target_directory": "/w/target", "packages": [
            {"name": "inerter-tests", "manifest_path": "/w/tests/Cargo.toml", "targets": [],
             "dependencies": [{"name": "inerter-qemu", "kind": "dev"}, {"name": "inerter-core", "kind": null}]},
            {"name": "inerter-qemu", "manifest_path": "/w/qemu/Cargo.toml", "targets": [], "dependencies": []},
            {"name": "inerter-core", "manifest_path": "/w/core/Cargo.toml", "targets": [],
             "dependencies": [{"name": "anyhow", "kind": null}]}]}"#;
        let workspace = Workspace::parse(json).unwrap();
        let faults = arrow_faults(&workspace);
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert!(faults[0].starts_with("inerter-tests uses in its tests inerter-qemu"));
        let missing = missing_faults(&workspace);
        assert_eq!(missing.len(), LAWS.len() - 3);
        assert!(missing[0].starts_with("inerter-wire: this entry names no crate"));
    }

    #[test]
    fn what_a_member_must_never_bring_along_is_found_by_name_and_by_beginning() {
        let packages = ["inerter-data 0.1.0", "clap_lex 1.0.0", "clap 4.5.0", "dfu-core 0.11.0", "clap 3.2.0"];
        let packages = BTreeSet::from(packages.map(String::from));
        assert_eq!(forbidden(&["clap", "dfu-*", "nusb"], &packages), BTreeSet::from(["clap", "dfu-core"]));
    }

    #[test]
    fn a_circle_is_told_by_file_and_line() {
        let fixture = Fixture::new(&[
            ("src/lib.rs", "mod a;\nmod b;\n"),
            ("src/a.rs", "\nuse crate::b::B;\npub struct A;\n"),
            ("src/b.rs", "pub struct B(crate::a::A);\n"),
        ]);
        let roots = vec![fixture.0.join("src/lib.rs")];
        let member = Member { name: "it".into(), folder: fixture.0.clone(), roots, uses: Vec::new() };
        let told = "it: 2 modules import each other in a circle:\n    src/a.rs:2 imports crate::b::B from src/b.rs\n    \
                    src/b.rs:1 imports crate::a::A from src/a.rs";
        assert_eq!(circle_faults(&member, &fixture.0).unwrap(), [told]);
    }

    #[test]
    fn nobody_is_allowed_a_program() {
        for law in LAWS {
            for program in [
                "inerter-qemu",
                "inerter",
                "inerter-demo",
                "xtask",
                "inerter-tests",
                "inerter-bench",
                "inerter-fuzz",
                "inerter-twin",
            ] {
                let uses = has(law.may_use, program) || has(law.tests_may_use, program);
                assert!(!uses || (law.member, program) == ("inerter-fuzz", "inerter-tests"), "{}", law.member);
            }
        }
    }
}
