//! The snippets of docs/PYTHON.md, run as written against a fresh recording; and Python environments with packages.

use crate::{
    process, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, bail, ensure};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// What the snippets and the check of the MATLAB file import.
const IMPORTS: &str = "h5py, mcap, pandas, pyarrow";

/// Their versions.
pub const REQUIREMENTS: &str = "tests/python/files-requirements.txt";

/// The page with the snippets.
const PAGE: &str = "docs/PYTHON.md";

/// Runs them with the program of the tests.
pub fn run() -> Result<()> {
    let folder = workspace::folder("python")?;
    let python = files_environment()?;
    let inerter = workspace::tested(Part::Main, "inerter")?;
    let page = tree::text(PAGE)?;
    let snippets = snippets(&page)?;
    for line in commands(&page) {
        let mut words = line.split_whitespace();
        ensure!(words.next() == Some("inerter"), "{PAGE}: `{line}` is not an inerter command");
        process::run(Command::new(&inerter).args(words).arg("--force").current_dir(&folder))?;
    }
    for (number, (code, expected)) in snippets.iter().enumerate() {
        let printed = process::output(Command::new(&python).args(["-c", code]).current_dir(&folder))?;
        ensure!(
            printed.trim() == expected.trim(),
            "{PAGE}, snippet {}: it printed\n{printed}and the page says\n{expected}",
            number + 1
        );
    }
    process::run(script(&python, "check_mat.py").args(["run.mat", "run.parquet"]).current_dir(&folder))?;
    println!("{} snippets of {PAGE} print what it says", snippets.len());
    Ok(())
}

/// The blocks of code of a page, each with its language in the first line.
fn blocks(page: &str) -> impl Iterator<Item = &str> {
    page.split("```").skip(1).step_by(2)
}

/// Snippets with what they print: each block of Python is followed by a block of text.
fn snippets(page: &str) -> Result<Vec<(&str, &str)>> {
    let mut snippets = Vec::new();
    let mut blocks = blocks(page);
    while let Some(block) = blocks.next() {
        let Some(code) = block.strip_prefix("python\n") else { continue };
        let Some(text) = blocks.next().and_then(|block| block.strip_prefix("text\n")) else {
            bail!("{PAGE}: the snippet `{}` is not followed by what it prints", code.trim());
        };
        snippets.push((code, text));
    }
    ensure!(!snippets.is_empty(), "{PAGE} has no snippets");
    Ok(snippets)
}

/// The commands that create the files.
fn commands(page: &str) -> impl Iterator<Item = &str> {
    blocks(page).find_map(|block| block.strip_prefix("sh\n")).unwrap_or_default().lines()
}

/// A Python with the packages that read our files.
pub fn files_environment() -> Result<PathBuf> {
    environment(&workspace::target()?.join("python/environment"), IMPORTS, REQUIREMENTS, false)
}

/// A Python with packages, in a separate environment: an existing one, or one made from the Python Package Index. It is
/// made again if the requirements have changed since.
pub fn environment(folder: &Path, imports: &str, requirements: &str, alone: bool) -> Result<PathBuf> {
    let python = folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let test = format!("import {imports}; print('complete')");
    let complete = |python: &Path| process::first_line(Command::new(python).args(["-c", &test])).is_some();
    let wanted = tree::text(requirements)?;
    // The requirements it was made from: otherwise a raised version, or a package that nothing imports, would go
    // unnoticed.
    let made_for = folder.join("requirements.txt");
    let is_current = tree::text_if_there(&made_for)? == wanted;
    if is_current && python.is_file() && complete(&python) {
        return Ok(python);
    }
    let system = ["python3", "python"].into_iter().find(|name| process::version(name).is_some());
    let system = system.context("no python3 on this machine")?;
    println!("installing {imports} ({requirements}) from PyPI into {}", folder.display());
    process::run(Command::new(system).args(["-m", "venv", "--clear"]).arg(folder))
        .context("no virtual environment could be made (on Debian: `apt-get install python3-venv`)")?;
    // Leave out packages that a package declares but never uses.
    let alone = alone.then_some("--no-deps");
    process::run(pip(&python).args(alone).arg("--requirement").arg(tree::root().join(requirements)))
        .context("the packages could not be installed")?;
    tree::write(&made_for, wanted)?;
    Ok(python)
}

/// One of the scripts in tests/python, ready for arguments.
pub fn script(python: &Path, name: &str) -> Command {
    let mut command = Command::new(python);
    command.arg(tree::root().join("tests/python").join(name));
    command
}

/// `pip install`, ready for arguments.
pub fn pip(python: &Path) -> Command {
    let mut pip = Command::new(python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]);
    pip
}

/// Installs the wheel in place of an earlier one.
pub fn install(python: &Path, wheel: &Path) -> Result<()> {
    process::run(pip(python).args(["--force-reinstall", "--no-deps"]).arg(wheel))
        .context("the wheel could not be installed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_snippet_is_the_block_of_python_with_the_text_after_it() {
        let page = "a\n```python\nprint(1)\n```\nwords\n```text\n1\n```\n```python\nprint(2)\n```\n\n```text\n2\n```\n";
        assert_eq!(snippets(page).unwrap(), [("print(1)\n", "1\n"), ("print(2)\n", "2\n")]);
        assert!(snippets("```python\nprint(1)\n```\n```python\nprint(2)\n```\n```text\n2\n```").is_err());
        assert!(snippets("no code").is_err());
    }

    #[test]
    fn the_page_has_commands_and_snippets() {
        let page = tree::text(PAGE).unwrap();
        assert!(snippets(&page).unwrap().len() >= 3);
        assert!(commands(&page).all(|line| line.starts_with("inerter ")) && commands(&page).count() >= 2);
    }
}
