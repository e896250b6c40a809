//! The release files that this computer can make, below `target/release-files`.
//!
//! | file | what it is |
//! |---|---|
//! | `inerter-VERSION-TRIPLE` | the program with all features |
//! | `inerter-VERSION-TRIPLE.cdx.json` | what is linked into it, in the form of CycloneDX |
//! | `inerter-VERSION-cp310-abi3-PLATFORM.whl` | the Python package |
//! | `inerter-python-VERSION-TRIPLE.cdx.json` | what is linked into it |
//! | `inerter-firmware-VERSION-BOARD.elf`, `.hex`, `.dfu` | a board's image, for `inerter`, for STM32CubeProgrammer, for `dfu-util` |
//! | `inerter-firmware-VERSION.cdx.json` | what is linked into the images |
//! | `inerter-VERSION-TRIPLE-licences.txt` | our licence, and those of everything that is linked into the files |
//! | `SHA256SUMS` | the sums of them all |
//!
//! `.github/workflows/release.yml` calls this on each system and puts the files together.

use crate::{
    firmware::{self, Image},
    images, process,
    tool::CYCLONE_DX,
    tree::{self, FIRMWARE_TARGET},
    wheel,
    workspace::{self, Workspace},
};
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

#[derive(clap::Args)]
pub struct Options {
    /// Fail unless this is the tag of the version, such as v0.1.0
    #[arg(long)]
    pub tag: Option<String>,
    /// Leave out the boards' images: of several computers that make a release together, only one makes them
    #[arg(long)]
    pub program_only: bool,
}

/// Each board's image, by the name that the image reports for its board.
const BOARDS: [(Image, &str); 2] = [(Image::WEACT, "weact-g474"), (Image::BOARD, "nucleo-g474re")];
/// The library that draws the page of `inerter monitor --web`, which is part of the program.
const PLOTS: &str = "host-tools/inerter/assets/uplot";
/// Name of the files that the tool leaves in all packages' folders.
const LEFT: &str = "inerter-release.cdx";

/// Makes all of them again and prints their names and sizes.
pub fn run(options: &Options) -> Result<()> {
    let (version, host) = (env!("CARGO_PKG_VERSION"), process::host_tuple()?);
    if let Some(tag) = options.tag.as_ref().filter(|tag| **tag != format!("v{version}")) {
        bail!("the tag {tag} is not that of version {version} (Cargo.toml), which would be v{version}");
    }
    let workspace = Workspace::read(&tree::root())?;
    let folder = workspace.target.join("release-files");
    tree::remove(&folder)?;
    tree::make(&folder)?;
    let keep = |name: String, bytes: &[u8]| tree::write(folder.join(name), bytes);
    let mut used = BTreeSet::new();
    let mut keep_bill = |name: String, package: &str, target: &str| {
        let linked = linked_into(package, target)?;
        let bill = materials(&workspace, package, target, &linked)?;
        used.extend(linked);
        keep(format!("{name}.cdx.json"), &bill)
    };

    process::run(process::cargo().args(["build", "--release", "--locked", "--package", "inerter", "--all-features"]))?;
    let program = workspace::program("inerter", "release")?;
    let named = folder.join(format!("inerter-{version}-{host}{}", std::env::consts::EXE_SUFFIX));
    fs::copy(&program, &named).with_context(|| format!("cannot copy {}", program.display()))?;
    keep_bill(format!("inerter-{version}-{host}"), "inerter", &host)?;
    let wheel = wheel::released()?;
    let name = wheel.file_name().with_context(|| format!("{} has no name", wheel.display()))?;
    fs::copy(&wheel, folder.join(name)).with_context(|| format!("cannot copy {}", wheel.display()))?;
    keep_bill(format!("inerter-python-{version}-{host}"), "inerter-python", &host)?;
    if !options.program_only {
        for (image, board) in BOARDS {
            let path = firmware::build(image)?;
            let elf = tree::read(&path)?;
            let parts = images::parts(&elf).with_context(|| path.display().to_string())?;
            let name = format!("inerter-firmware-{version}-{board}");
            keep(format!("{name}.elf"), &elf)?;
            keep(format!("{name}.hex"), images::hex(&parts).as_bytes())?;
            keep(format!("{name}.dfu"), &images::dfuse(&parts, board)?)?;
        }
        keep_bill(format!("inerter-firmware-{version}"), "inerter-stm32g474", FIRMWARE_TARGET)?;
    }
    keep(format!("inerter-{version}-{host}-licences.txt"), licences(&used)?.as_bytes())?;
    let sums = sums(&folder)?;
    keep("SHA256SUMS".into(), sums.as_bytes())
}

/// The bill of materials of a package: what is [`linked_into`] it, and nothing else.
fn materials(workspace: &Workspace, package: &str, target: &str, linked: &BTreeSet<String>) -> Result<Vec<u8>> {
    let member = workspace.member(package).with_context(|| format!("no package {package}"))?;
    let done = process::run(
        CYCLONE_DX
            .command()?
            .args(["--quiet", "--format", "json", "--spec-version", "1.5", "--all-features", "--target", target])
            .args(["--override-filename", LEFT, "--manifest-path"])
            .arg(member.folder.join("Cargo.toml")),
    );
    let left = |folder: &Path| folder.join(format!("{LEFT}.json"));
    let text = fs::read_to_string(left(&member.folder));
    for member in &workspace.members {
        // The tool leaves one in each member that it visits.
        fs::remove_file(left(&member.folder)).ok();
    }
    done?;
    let text = text.with_context(|| format!("{} wrote nothing for {package}", CYCLONE_DX.name))?;
    let root = tree::root().display().to_string().replace('\\', "/");
    let bill = narrowed(&text.replace(root.trim_start_matches('/'), "inerter"), package, linked)?;
    let mut bytes = serde_json::to_vec_pretty(&bill)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// Name and version of all that cargo links into a package or runs to build it.
fn linked_into(package: &str, target: &str) -> Result<BTreeSet<String>> {
    let chosen = ["--all-features", "--package", package, "--target", target];
    workspace::packages(&tree::root(), "normal,build", &chosen)
}

/// The same of what a tool describes.
fn named(value: &Value) -> Option<String> {
    Some(format!("{} {}", value["name"].as_str()?, value["version"].as_str()?))
}

/// The tool lists the lock file, which has more packages than are linked: removes the others. A missing one is an
/// error.
fn narrowed(text: &str, package: &str, linked: &BTreeSet<String>) -> Result<Value> {
    let mut bill: Value = serde_json::from_str(text).context("the bill of materials is not JSON")?;
    let components = bill["components"].as_array_mut().context("the bill of materials has no components")?;
    components.retain(|one| named(one).is_some_and(|one| linked.contains(&one)));
    let listed: BTreeSet<_> = components.iter().filter_map(named).collect();
    let itself = format!("{package} ");
    let missing: Vec<_> = linked.difference(&listed).filter(|one| !one.starts_with(&itself)).cloned().collect();
    ensure!(missing.is_empty(), "the bill of materials of {package} lacks {}", missing.join(", "));
    let known: BTreeSet<String> = [&bill["metadata"]["component"]]
        .into_iter()
        .chain(bill["components"].as_array().into_iter().flatten())
        .filter_map(|one| one["bom-ref"].as_str().map(str::to_owned))
        .collect();
    let is_known = |value: &Value| value.as_str().is_some_and(|name| known.contains(name));
    if let Some(dependencies) = bill["dependencies"].as_array_mut() {
        dependencies.retain(|one| is_known(&one["ref"]));
        let lists = dependencies.iter_mut().filter_map(|one| one.get_mut("dependsOn")?.as_array_mut());
        lists.for_each(|list| list.retain(is_known));
    }
    Ok(bill)
}

/// Our licence, then each other text that must go with the files, below the names of what it belongs to.
fn licences(used: &BTreeSet<String>) -> Result<String> {
    let told = workspace::metadata(&tree::root())?;
    let mut texts: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for package in told["packages"].as_array().context("`cargo metadata` lists no packages")? {
        let (Some(name), Some(manifest)) = (named(package), package["manifest_path"].as_str()) else {
            bail!("`cargo metadata` lists a package without a name, version or place");
        };
        if !used.contains(&name) || package["source"].is_null() {
            continue;
        }
        let folder = Path::new(manifest).parent().with_context(|| format!("{manifest} is in no folder"))?;
        let mut found = licences_in(folder)?;
        if found.is_empty() {
            let terms = package["license"].as_str().unwrap_or("the terms of its source");
            found.push(format!("{terms}. The package has no text of its own.\n"));
        }
        for text in found {
            texts.entry(text).or_default().insert(name.clone());
        }
    }
    for text in licences_in(&tree::root().join(PLOTS))? {
        texts.entry(text).or_default().insert("uPlot".into());
    }
    let ours = tree::text(tree::root().join("LICENSE"))?;
    Ok(format!("inerter\n\n{ours}{}", listed(&texts)))
}

/// The texts in a package's folder that say under which terms it may be used.
fn licences_in(folder: &Path) -> Result<Vec<String>> {
    let paths = tree::files(folder)?;
    let is_licence = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        ["LICENSE", "LICENCE", "UNLICENSE", "COPYING", "COPYRIGHT", "NOTICE"].iter().any(|word| name.starts_with(word))
    };
    let texts = paths.iter().filter(|path| is_licence(path));
    texts.map(|path| Ok(String::from_utf8_lossy(&tree::read(path)?).replace("\r\n", "\n"))).collect()
}

/// Each text below the names of what it belongs to.
fn listed(texts: &BTreeMap<String, BTreeSet<String>>) -> String {
    let rule = "=".repeat(80);
    let names = |names: &BTreeSet<String>| names.iter().cloned().collect::<Vec<_>>().join(", ");
    texts.iter().map(|(text, of)| format!("\n{rule}\n{}\n\n{}\n", names(of), text.trim_end())).collect()
}

/// A line for each file, in the form that `sha256sum --check` reads.
fn sums(folder: &Path) -> Result<String> {
    let mut text = String::new();
    for path in tree::files(folder)? {
        let bytes = tree::read(&path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        println!("  {:>9.1} KB  {name}", bytes.len() as f64 / 1e3);
        text += &format!("{:x}  {name}\n", Sha256::digest(&bytes));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BILL: &str = r#"{
        "metadata": {"component": {"bom-ref": "p", "name": "p", "version": "0.1.0"}},
        "components": [
            {"bom-ref": "a", "name": "a", "version": "1.0.0"}, {"bom-ref": "b", "name": "b", "version": "2.0.0"}
        ],
        "dependencies": [{"ref": "p", "dependsOn": ["a", "b"]}, {"ref": "a"}, {"ref": "b", "dependsOn": ["a"]}]
    }"#;

    #[test]
    fn only_what_is_linked_is_listed() {
        let linked = BTreeSet::from(["p 0.1.0", "a 1.0.0"].map(String::from));
        let bill = narrowed(BILL, "p", &linked).unwrap();
        assert_eq!(bill["components"].as_array().unwrap().len(), 1);
        assert_eq!(bill["dependencies"], serde_json::json!([{"ref": "p", "dependsOn": ["a"]}, {"ref": "a"}]));
    }

    #[test]
    fn all_that_is_linked_into_the_images_has_its_licence() {
        let used = BTreeSet::from(["serde 0.0.0".to_owned()]);
        let of_none = licences(&used).unwrap();
        assert!(of_none.starts_with("inerter\n\nMIT") && !of_none.contains("serde"), "{of_none}");
        let used = linked_into("inerter-stm32g474", FIRMWARE_TARGET).unwrap();
        let text = licences(&used).unwrap();
        for name in used.iter().filter(|name| !name.starts_with("inerter") && !name.starts_with("ads131m04 ")) {
            assert!(text.contains(name), "{name}");
        }
        assert!(text.contains("Leon Sorokin") && !text.contains("inerter-core"));
    }

    #[test]
    fn what_is_linked_and_not_listed_is_named() {
        let linked = BTreeSet::from(["p 0.1.0", "a 1.0.0", "b 3.0.0"].map(String::from));
        let error = narrowed(BILL, "p", &linked).unwrap_err();
        assert!(error.to_string().contains("lacks b 3.0.0"), "{error}");
    }
}
