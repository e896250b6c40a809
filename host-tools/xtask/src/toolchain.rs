//! The compiler of the images: the first suitable one on this machine.

use crate::{
    process,
    tree::{self, FIRMWARE_TARGET},
};
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// The distribution's linker that knows ARM, for a compiler that comes without one.
const DISTRIBUTION_LINKER: &str = "/usr/bin/ld.lld";

/// A compiler that can make the image.
pub struct Toolchain {
    /// Whether it is the distribution's compiler rather than the one that started this program.
    distribution: bool,
    /// The core library is compiled from its source, because there is no compiled one.
    build_core: bool,
    /// The compiler's own linker is missing.
    foreign_linker: bool,
}

impl Toolchain {
    /// The first suitable one: this compiler with the target, this compiler with the core library's source, the
    /// distribution's compiler with it.
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
            cargo.current_dir(tree::root()).env("RUSTC", "/usr/bin/rustc").env_remove("RUSTUP_TOOLCHAIN");
        }
        if self.foreign_linker {
            cargo.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", DISTRIBUTION_LINKER);
        }
        cargo.args([command, "--target", FIRMWARE_TARGET]);
        if self.build_core {
            // The stable compiler builds its own core library only with unstable options enabled.
            cargo.arg("-Zbuild-std=core").env("RUSTC_BOOTSTRAP", "1");
        }
        cargo
    }

    /// Lints of the firmware's target, none of which may warn; unsafe code must say why it is sound.
    pub fn clippy(&self, arguments: &[&str]) -> Command {
        let mut clippy = self.cargo("clippy");
        clippy.arg("--locked").args(arguments);
        clippy.args(["--", "--deny", "warnings", "--deny", "clippy::undocumented_unsafe_blocks"]);
        clippy
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

/// Whether the distribution's linker must replace the compiler's own; `None` if there is neither.
fn foreign_linker(sysroot: &Path) -> Option<bool> {
    let hosts = fs::read_dir(sysroot.join("lib/rustlib")).ok()?.flatten();
    let names = ["bin/rust-lld", "bin/rust-lld.exe"];
    let own = hosts.into_iter().any(|host| names.iter().any(|name| host.path().join(name).is_file()));
    if own { Some(false) } else { Path::new(DISTRIBUTION_LINKER).is_file().then_some(true) }
}

/// Whether the version in a line such as `rustc 1.95.0 (...)`, its first word that begins with a number, is at least
/// `least`.
pub fn at_least(line: &str, least: &str) -> bool {
    let numbers = |text: &str| -> Vec<u32> { text.split(['.', '-']).map_while(|part| part.parse().ok()).collect() };
    let version = line.split_whitespace().map(numbers).find(|version| !version.is_empty());
    version.is_some_and(|version| version >= numbers(least))
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
        let qemu = "QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7)";
        assert!(at_least(qemu, "7") && !at_least(qemu, "8"));
        let qemu = "QEMU emulator version 10.0.2";
        assert!(at_least(qemu, "10") && !at_least(qemu, "11"));
        assert!(!at_least("QEMU emulator version ", "6"));
        assert!(!at_least("something else", "6"));
    }
}
