//! What a fresh machine needs, found or installed.
//!
//! Everything is printed before it is installed, and installed only by the machine's own means: rustup, apt-get.
//! Where that is not possible the exact command to type is printed and the set-up fails.
//!
//! The firmware's compiler is the first of: this Rust with the target that rustup adds; this Rust with `rust-src`, which
//! compiles the core library itself; Debian's `rustc-web` with `rust-web-src` and `lld`, where there is no rustup.

use crate::{firmware, process, workspace::FIRMWARE_TARGET};
use anyhow::{Context, Result, bail};
use std::{path::Path, process::Command};

/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";

/// Oldest QEMU whose netduinoplus2 runs the image.
const QEMU_LEAST: u32 = 6;

#[derive(clap::Args, Debug, Default)]
pub struct Options {
    /// Say what is missing without installing it
    #[arg(long)]
    pub check: bool,
}

/// One thing that may be missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// A way to compile for the target.
    Firmware,
    /// `cargo fmt`.
    Rustfmt,
    /// `cargo clippy`.
    Clippy,
    /// `qemu-system-arm`.
    Qemu,
}

/// Everything that `cargo xtask test` uses.
pub const ALL: &[Need] = &[Need::Firmware, Need::Rustfmt, Need::Clippy, Need::Qemu];

/// Finds or installs everything.
pub fn run(options: &Options) -> Result<()> {
    if let Some(version) = process::first_line(process::rustc().arg("--version")) {
        println!("  {:<32} {version}", "Rust");
    }
    ensure(ALL, options.check)?;
    println!("setup: everything is there");
    Ok(())
}

/// Finds or, unless `check`, installs what is named; fails with the list of what is still missing.
pub fn ensure(needs: &[Need], check: bool) -> Result<()> {
    let mut missing = Vec::new();
    for need in needs {
        let outcome = match need.found() {
            Ok(found) => Ok(found),
            Err(reason) if check => Err(reason),
            Err(reason) => {
                println!("  {:<32} {reason}", need.name());
                need.install()
                    .and_then(|()| need.found().map_err(anyhow::Error::msg))
                    .map_err(|error| format!("{error:#}"))
            }
        };
        match outcome {
            Ok(found) => println!("  {:<32} {found}", need.name()),
            Err(reason) => {
                println!("  {:<32} missing: {reason}", need.name());
                missing.push(format!("{}: {}", need.name(), need.advice()));
            }
        }
    }
    if !missing.is_empty() {
        bail!("not everything is there; to go on:\n  {}", missing.join("\n  "));
    }
    Ok(())
}

impl Need {
    fn name(self) -> &'static str {
        match self {
            Self::Firmware => "compiler for the firmware",
            Self::Rustfmt => "rustfmt",
            Self::Clippy => "clippy",
            Self::Qemu => QEMU,
        }
    }

    /// Whether it is there and will do.
    pub fn is_there(self) -> bool {
        self.found().is_ok()
    }

    /// What was found, or why it does not do.
    fn found(self) -> Result<String, String> {
        match self {
            Self::Firmware => firmware::Toolchain::find()
                .map(|toolchain| toolchain.describe())
                .ok_or(format!("no compiled core library for {FIRMWARE_TARGET} and no source to compile it from")),
            Self::Rustfmt => process::first_line(process::cargo().args(["fmt", "--version"])).ok_or("not there".into()),
            Self::Clippy => {
                process::first_line(process::cargo().args(["clippy", "--version"])).ok_or("not there".into())
            }
            Self::Qemu => {
                let line = process::first_line(Command::new(QEMU).arg("--version")).ok_or("not there")?;
                match qemu_version(&line) {
                    Some(version) if version >= QEMU_LEAST => Ok(line),
                    Some(version) => Err(format!("version {version} is older than {QEMU_LEAST}")),
                    None => Err(format!("no version in `{line}`")),
                }
            }
        }
    }

    fn install(self) -> Result<()> {
        match self {
            Self::Firmware => install_target(),
            Self::Rustfmt => rustup(&["component", "add", "rustfmt"]),
            Self::Clippy => rustup(&["component", "add", "clippy"]),
            Self::Qemu => apt(&["qemu-system-arm"]),
        }
    }

    /// What a person types where nothing can be installed from here.
    fn advice(self) -> String {
        match self {
            Self::Firmware => format!(
                "with rustup: `rustup target add {FIRMWARE_TARGET}`; without it: install rustup (https://rustup.rs), or on Debian and Ubuntu `apt-get install {}`",
                DISTRIBUTION_RUST.join(" ")
            ),
            Self::Rustfmt => "`rustup component add rustfmt`, or your distribution's rustfmt".into(),
            Self::Clippy => "`rustup component add clippy`, or your distribution's clippy".into(),
            Self::Qemu => qemu_advice(&std::fs::read_to_string("/etc/os-release").unwrap_or_default()),
        }
    }
}

/// Debian's compiler, recent also in its stable release, with the source of the core library and a linker for ARM.
const DISTRIBUTION_RUST: &[&str] = &["rustc-web", "cargo-web", "rust-web-src", "lld"];

fn install_target() -> Result<()> {
    let attempts: [&dyn Fn() -> Result<()>; 3] = [
        &|| rustup(&["target", "add", FIRMWARE_TARGET]),
        // The core library's source, to compile it here.
        &|| rustup(&["component", "add", "rust-src"]),
        // Debian keeps these packages and its own rustup apart, and says so.
        &|| apt(DISTRIBUTION_RUST),
    ];
    for attempt in attempts {
        if let Err(error) = attempt() {
            println!("  {error:#}");
        }
        if firmware::Toolchain::find().is_some() {
            return Ok(());
        }
    }
    bail!("neither rustup nor the distribution could provide it")
}

fn rustup(arguments: &[&str]) -> Result<()> {
    if process::first_line(Command::new("rustup").arg("--version")).is_none() {
        bail!("there is no rustup on this machine");
    }
    let mut command = Command::new("rustup");
    command.args(arguments);
    println!("  $ {}", process::shown(&command));
    process::run(&mut command)
}

fn apt(packages: &[&str]) -> Result<()> {
    if !Path::new("/usr/bin/apt-get").is_file() {
        bail!("no apt-get on this machine");
    }
    let root = process::first_line(Command::new("id").arg("-u")).is_some_and(|id| id == "0");
    if !root && !Command::new("sudo").args(["-n", "true"]).status().is_ok_and(|status| status.success()) {
        bail!("installing needs root, and `sudo -n` asks for a password");
    }
    let apt_get = |arguments: &[&str]| {
        let mut command = Command::new(if root { "env" } else { "sudo" });
        if !root {
            command.args(["-n", "env"]);
        }
        command.args(["DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]).args(arguments);
        println!("  $ {}", process::shown(&command));
        process::run(&mut command)
    };
    if let Err(error) = apt_get(&["update"]) {
        println!("  {error:#}; trying with the list of packages that is there");
    }
    let mut install = vec!["install", "-y", "--no-install-recommends"];
    install.extend(packages);
    apt_get(&install).context("the package manager could not install it")
}

/// Major version in the first line that QEMU prints.
fn qemu_version(line: &str) -> Option<u32> {
    let version = line.split("version ").nth(1)?;
    version.split(|letter: char| !letter.is_ascii_digit()).next()?.parse().ok()
}

/// How QEMU is installed on the system whose `/etc/os-release` this is.
fn qemu_advice(os_release: &str) -> String {
    let ids: Vec<&str> = os_release
        .lines()
        .filter_map(|line| line.strip_prefix("ID=").or(line.strip_prefix("ID_LIKE=")))
        .flat_map(|value| value.trim_matches('"').split(' '))
        .collect();
    let has = |id: &str| ids.contains(&id);
    let command = if has("debian") || has("ubuntu") {
        "sudo apt-get update && sudo apt-get install -y --no-install-recommends qemu-system-arm"
    } else if has("fedora") || has("rhel") {
        "sudo dnf install -y qemu-system-arm-core"
    } else if has("arch") {
        "sudo pacman -S --needed qemu-system-arm"
    } else if has("alpine") {
        "sudo apk add qemu-system-arm"
    } else if has("suse") || has("opensuse") {
        "sudo zypper install qemu-arm"
    } else if cfg!(target_os = "macos") {
        "brew install qemu"
    } else if cfg!(windows) {
        "winget install SoftwareFreedomConservancy.QEMU, then put its folder on PATH"
    } else {
        return format!("install QEMU {QEMU_LEAST} or newer with its ARM system emulator, so that `{QEMU}` is on PATH");
    };
    format!("`{command}` (version {QEMU_LEAST} or newer)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn qemu_versions_are_read() {
        assert_eq!(qemu_version("QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7)"), Some(7));
        assert_eq!(qemu_version("QEMU emulator version 10.0.2"), Some(10));
        assert_eq!(qemu_version("QEMU emulator version "), None);
        assert_eq!(qemu_version("something else"), None);
    }

    #[test]
    fn each_system_has_its_own_advice() {
        assert!(qemu_advice("ID=debian\n").contains("apt-get"));
        assert!(qemu_advice("ID=linuxmint\nID_LIKE=\"ubuntu debian\"\n").contains("apt-get"));
        assert!(qemu_advice("NAME=Fedora\nID=fedora\n").contains("dnf"));
        assert!(qemu_advice("ID=arch\n").contains("pacman"));
        assert!(qemu_advice("").contains("QEMU") || qemu_advice("").contains("brew"));
    }
}
