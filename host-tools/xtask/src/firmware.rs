//! The images: how they are compiled on this machine, and how QEMU's is started.

use crate::{
    process, setup,
    workspace::{self, FIRMWARE_TARGET},
};
use anyhow::{Context, Result};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

/// Packages that are built for the target only.
pub const PACKAGES: &[&str] = &["inerter-qemu", "inerter-stm32g474"];

/// Folder of the board's package: its cargo settings (target, profile) count only from within.
const BOARD_FOLDER: &str = "firmware/stm32g474";

/// One program for the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// For QEMU's netduinoplus2.
    Qemu,
    /// The one that ships, for the WeAct board. Cargo gives it the name of the next one, so it is made first and copied.
    Weact,
    /// The one that ships, for the NUCLEO: what `cargo build --release` makes in its folder.
    Board,
    /// The one that ships with a task that hangs, to see the watchdog at work.
    Hang,
}

impl Image {
    /// Everything that the tests run.
    pub const ALL: [Self; 4] = [Self::Qemu, Self::Weact, Self::Board, Self::Hang];

    /// The variable through which tests learn where the image lies.
    pub const fn variable(self) -> &'static str {
        match self {
            Self::Qemu => "INERTER_QEMU_IMAGE",
            Self::Weact => "INERTER_STM32_WEACT_ELF",
            Self::Board => "INERTER_STM32_ELF",
            Self::Hang => "INERTER_STM32_HANG_ELF",
        }
    }

    /// Name of the program.
    const fn program(self) -> &'static str {
        match self {
            Self::Qemu => "inerter-qemu",
            Self::Weact | Self::Board => "inerter-stm32g474",
            Self::Hang => "inerter-stm32g474-hang",
        }
    }

    const fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Qemu => &["--package", "inerter-qemu", "--profile", "firmware"],
            Self::Weact => {
                &["--release", "--no-default-features", "--features", "board-weact", "--bin", "inerter-stm32g474"]
            }
            Self::Board => &["--release", "--bin", "inerter-stm32g474"],
            Self::Hang => &["--release", "--features", "hang", "--bin", "inerter-stm32g474-hang"],
        }
    }
}

/// The distribution's linker that knows ARM, for a compiler that comes without one.
const DISTRIBUTION_LINKER: &str = "/usr/bin/ld.lld";

/// A compiler that can make the image.
#[derive(Debug)]
pub struct Toolchain {
    /// The distribution's own compiler, or the one that started this program.
    distribution: bool,
    /// The core library is compiled from its source, for want of a compiled one.
    build_core: bool,
    /// The compiler's own linker is missing.
    foreign_linker: bool,
}

impl Toolchain {
    /// The first that will do: this compiler with the target, this compiler with the core library's source,
    /// the distribution's compiler with it.
    pub fn find() -> Option<Self> {
        if let Some(sysroot) = sysroot(&mut process::rustc()) {
            let build_core = !has_target(&mut process::rustc());
            if let Some(foreign_linker) = foreign_linker(&sysroot).filter(|_| !build_core || has_source(&sysroot)) {
                return Some(Self { distribution: false, build_core, foreign_linker });
            }
        }
        let distribution = || Command::new("/usr/bin/rustc");
        let sysroot = sysroot(&mut distribution())?;
        let recent = at_least(&process::first_line(distribution().arg("--version"))?, env!("CARGO_PKG_RUST_VERSION"));
        let whole = recent && Path::new("/usr/bin/cargo").is_file() && has_source(&sysroot);
        let foreign_linker = foreign_linker(&sysroot).filter(|_| whole)?;
        Some(Self { distribution: true, build_core: true, foreign_linker })
    }

    /// One line for a person.
    pub fn describe(&self) -> String {
        let which = if self.distribution { "the distribution's Rust" } else { "this Rust" };
        let core = if self.build_core { "core library from its source" } else { "compiled core library" };
        let linker = if self.foreign_linker { ", the distribution's linker" } else { "" };
        format!("{which} for {FIRMWARE_TARGET}, {core}{linker}")
    }

    /// Whether this compiler belongs to the cargo that started this program, so that its clippy does too.
    pub fn is_own(&self) -> bool {
        !self.distribution
    }

    /// `cargo COMMAND` for the firmware's target.
    pub fn cargo(&self, command: &str) -> Command {
        let mut cargo = process::cargo();
        if self.distribution {
            cargo = Command::new("/usr/bin/cargo");
            cargo.current_dir(workspace::root()).env("RUSTC", "/usr/bin/rustc").env_remove("RUSTUP_TOOLCHAIN");
        }
        if self.foreign_linker {
            cargo.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", DISTRIBUTION_LINKER);
        }
        cargo.args([command, "--target", FIRMWARE_TARGET]);
        if self.build_core {
            // The stable compiler builds its own core library only with its unstable options open.
            cargo.arg("-Zbuild-std=core").env("RUSTC_BOOTSTRAP", "1");
        }
        cargo
    }
}

fn has_target(rustc: &mut Command) -> bool {
    let folder = process::first_line(rustc.args(["--print", "target-libdir", "--target", FIRMWARE_TARGET]));
    let Some(entries) = folder.and_then(|folder| fs::read_dir(folder).ok()) else { return false };
    entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with("libcore-"))
}

fn sysroot(rustc: &mut Command) -> Option<PathBuf> {
    process::first_line(rustc.args(["--print", "sysroot"])).map(PathBuf::from)
}

fn has_source(sysroot: &Path) -> bool {
    sysroot.join("lib/rustlib/src/rust/library/core/src/lib.rs").is_file()
}

/// Whether the distribution's linker must stand in for the compiler's own; nothing when there is neither.
fn foreign_linker(sysroot: &Path) -> Option<bool> {
    let hosts = fs::read_dir(sysroot.join("lib/rustlib")).ok()?.flatten();
    let names = ["bin/rust-lld", "bin/rust-lld.exe"];
    let own = hosts.into_iter().any(|host| names.iter().any(|name| host.path().join(name).is_file()));
    if own { Some(false) } else { Path::new(DISTRIBUTION_LINKER).is_file().then_some(true) }
}

/// Whether the version in `rustc 1.95.0 (...)` is at least `least`.
fn at_least(line: &str, least: &str) -> bool {
    let numbers = |text: &str| -> Vec<u32> { text.split(['.', '-']).map_while(|part| part.parse().ok()).collect() };
    let version = line.split_whitespace().nth(1).map(numbers).unwrap_or_default();
    !version.is_empty() && version >= numbers(least)
}

/// Builds the image and returns where it lies.
pub fn build(image: Image) -> Result<PathBuf> {
    let toolchain = match Toolchain::find() {
        Some(toolchain) => toolchain,
        None => {
            setup::ensure(&[setup::Need::Firmware], false)?;
            Toolchain::find().context("no compiler for the firmware")?
        }
    };
    let mut command = toolchain.cargo("build");
    if image != Image::Qemu {
        command.current_dir(workspace::root().join(BOARD_FOLDER));
    }
    command.args(image.arguments()).args(["--locked", "--message-format=json-render-diagnostics"]);
    let messages = process::output(&mut command).context("the firmware did not build")?;
    let program = image.program();
    let built = executable(&messages, program)
        .with_context(|| format!("cargo built no image; is {program} still a program?"))?;
    if image != Image::Weact {
        return Ok(built);
    }
    let own = built.with_file_name(format!("{program}-weact"));
    fs::copy(&built, &own).with_context(|| format!("cannot write {}", own.display()))?;
    Ok(own)
}

/// Builds all images: the variables that name them, and where they lie.
pub fn build_all() -> Result<Vec<(&'static str, PathBuf)>> {
    Image::ALL.into_iter().map(|image| Ok((image.variable(), build(image)?))).collect()
}

/// Builds all images and prints where they lie.
pub fn run_build() -> Result<()> {
    for (_, path) in build_all()? {
        println!("{}", path.display());
    }
    Ok(())
}

/// Path of the program in cargo's messages.
fn executable(messages: &str, name: &str) -> Option<PathBuf> {
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["reason"] == "compiler-artifact" && message["target"]["name"] == name)
        .filter_map(|message| message["executable"].as_str().map(PathBuf::from))
        .next_back()
}

/// Runs the image in QEMU with virtual time counted in instructions, and returns what it wrote by semihosting.
pub fn run(image: &Path, arguments: &[&str], limit: Duration) -> Result<String> {
    if !setup::Need::Qemu.is_there() {
        setup::ensure(&[setup::Need::Qemu], false)?;
    }
    let mut semihosting = String::from("enable=on,target=native,arg=inerter");
    for argument in arguments {
        semihosting.push_str(",arg=");
        semihosting.push_str(argument);
    }
    let mut command = Command::new(setup::QEMU);
    // 64 ns an instruction, so that SysTick, at 168 MHz, tells instructions apart; no real time passes while the image sleeps.
    command.args(["-machine", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"]);
    command.args(["-icount", "shift=6,sleep=off", "-semihosting-config", &semihosting, "-kernel"]).arg(image);
    process::output_within(&mut command, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_compare_by_number() {
        assert!(at_least("rustc 1.95.0 (59807616e 2026-04-14)", "1.90"));
        assert!(at_least("rustc 1.90.0", "1.90"));
        assert!(!at_least("rustc 1.63.0 (Debian)", "1.90"));
        assert!(!at_least("rustc 1.9.0", "1.90"));
        assert!(!at_least("", "1.90"));
    }

    #[test]
    fn the_image_is_found_in_cargos_messages() {
        let messages = concat!(
            "not json\n",
            r#"{"reason":"compiler-artifact","target":{"name":"other"},"executable":"/t/other"}"#,
            "\n",
            r#"{"reason":"compiler-artifact","target":{"name":"inerter-qemu"},"executable":"/t/inerter-qemu"}"#,
            "\n",
            r#"{"reason":"build-finished","success":true}"#,
        );
        assert_eq!(executable(messages, "inerter-qemu"), Some("/t/inerter-qemu".into()));
        assert_eq!(executable("", "inerter-qemu"), None);
    }
}
