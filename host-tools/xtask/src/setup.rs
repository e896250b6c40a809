//! Finds or installs everything that a fresh machine needs.
//!
//! It prints every step before it installs anything, and uses only the machine's own tools: rustup, cargo, pip,
//! apt-get. If that is not possible, it prints the exact command to type and fails.
//!
//! The firmware's compiler is the first of: this Rust with the target that rustup adds; this Rust with `rust-src`,
//! which compiles the core library itself; without rustup, Debian's `rustc-web` with `rust-web-src` and `lld`.

use crate::{
    process,
    tool::DENY,
    toolchain::{Toolchain, at_least},
    tree::FIRMWARE_TARGET,
};
use anyhow::{Context, Result, bail, ensure};
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";

/// The program that runs the Linux guest.
const GUEST_QEMU: &str = "qemu-system-x86_64";

/// Oldest QEMU whose netduinoplus2 runs the image.
const QEMU_LEAST: &str = "6";

#[derive(clap::Args)]
pub struct Options {
    /// Say what is missing without installing it
    #[arg(long)]
    pub check: bool,
}

/// One thing that may be missing.
#[derive(Clone, Copy)]
pub enum Need {
    /// A way to compile for the target.
    Firmware,
    /// `rustfmt` or `clippy`. Without rustup, cargo suggests installing a crate of that name instead.
    Component(&'static str),
    /// `cargo deny`, which checks licences and sources.
    Deny,
    /// What packages of the system provide.
    System(&'static System),
}

/// Everything that `cargo xtask test` uses.
pub const ALL: &[Need] = &[
    Need::Firmware,
    Need::Component("rustfmt"),
    Need::Component("clippy"),
    Need::Deny,
    Need::System(&ARM_QEMU),
    Need::System(&TWIN),
    Need::System(&CXX),
];

/// Finds or installs everything.
pub fn run(options: &Options) -> Result<()> {
    if let Some(version) = process::first_line(process::rustc().arg("--version")) {
        println!("  {:<32} {version}", "Rust");
    }
    ensure(ALL, options.check)?;
    println!("setup: everything is there");
    Ok(())
}

/// Finds these or, unless `check` is set, installs them; fails with the list of what is still missing.
pub fn ensure(needs: &[Need], check: bool) -> Result<()> {
    let mut missing = Vec::new();
    for need in needs {
        let mut outcome = need.found();
        if let Err(reason) = &outcome
            && !check
        {
            println!("  {:<32} {reason}", need.name());
            outcome = need.install().map_err(|error| format!("{error:#}")).and_then(|()| need.found());
        }
        match outcome {
            Ok(found) => println!("  {:<32} {found}", need.name()),
            Err(reason) => {
                println!("  {:<32} missing: {reason}", need.name());
                missing.push(format!("{}: {}", need.name(), need.advice()));
            }
        }
    }
    ensure!(missing.is_empty(), "something is missing; to continue:\n  {}", missing.join("\n  "));
    Ok(())
}

impl Need {
    fn name(self) -> &'static str {
        match self {
            Self::Firmware => "compiler for the firmware",
            Self::Component(name) => name,
            Self::Deny => DENY.name,
            Self::System(system) => system.name,
        }
    }

    /// What was found, or why it is not suitable.
    fn found(self) -> Result<String, String> {
        match self {
            Self::Firmware => Toolchain::find()
                .map(|toolchain| toolchain.describe())
                .ok_or(format!("no compiled core library for {FIRMWARE_TARGET} and no source to compile it from")),
            // The command of `rustfmt` is `cargo fmt`.
            Self::Component(name) => {
                let command = name.trim_start_matches("rust");
                process::first_line(process::cargo().args([command, "--version"])).ok_or("not there".into())
            }
            Self::Deny => DENY.found().map(|(_, version)| version),
            Self::System(system) => (system.found)(),
        }
    }

    fn install(self) -> Result<()> {
        match self {
            Self::Firmware => install_target(),
            Self::Component(name) => rustup(&["component", "add", name]),
            Self::Deny => DENY.install(),
            Self::System(system) => apt(system.linux[0]),
        }
    }

    /// What to type if nothing can be installed from here.
    fn advice(self) -> String {
        match self {
            Self::Firmware => format!(
                "with rustup: `rustup target add {FIRMWARE_TARGET}`; without it: install rustup (https://rustup.rs), or on Debian and Ubuntu `apt-get install {DISTRIBUTION_RUST}`"
            ),
            Self::Component(name) => format!("`rustup component add {name}`, or your distribution's {name}"),
            Self::Deny => DENY.advice(),
            Self::System(system) => advice(system, &fs::read_to_string("/etc/os-release").unwrap_or_default()),
        }
    }
}

/// Debian's compiler, recent even in its stable release, with the source of the core library and a linker for ARM.
const DISTRIBUTION_RUST: &str = "rustc-web cargo-web rust-web-src lld";

fn install_target() -> Result<()> {
    let attempts: [fn() -> Result<()>; 3] = [
        || rustup(&["target", "add", FIRMWARE_TARGET]),
        // The core library's source, to compile it here.
        || rustup(&["component", "add", "rust-src"]),
        // Debian's packages and its own rustup exclude each other, and apt says so.
        || apt(DISTRIBUTION_RUST),
    ];
    for attempt in attempts {
        if let Err(error) = attempt() {
            println!("  {error:#}");
        }
        if Toolchain::find().is_some() {
            return Ok(());
        }
    }
    bail!("neither rustup nor the distribution could provide it")
}

/// Runs rustup, if there is one.
pub fn rustup(arguments: &[&str]) -> Result<()> {
    ensure!(process::version("rustup").is_some(), "there is no rustup on this machine");
    process::run_shown(Command::new("rustup").args(arguments))
}

/// Installs packages, with blanks between their names.
fn apt(packages: &str) -> Result<()> {
    ensure!(Path::new("/usr/bin/apt-get").is_file(), "no apt-get on this machine");
    let root = process::first_line(Command::new("id").arg("-u")).is_some_and(|id| id == "0");
    ensure!(
        root || Command::new("sudo").args(["-n", "true"]).status().is_ok_and(|status| status.success()),
        "installing needs root, and `sudo -n` asks for a password"
    );
    let apt_get = |arguments: &[&str]| {
        let mut command = Command::new(if root { "env" } else { "sudo" });
        if !root {
            command.args(["-n", "env"]);
        }
        command.args(["DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]).args(arguments);
        process::run_shown(&mut command)
    };
    if let Err(error) = apt_get(&["update"]) {
        println!("  {error:#}; trying with the present package list");
    }
    let mut install = vec!["install", "-y", "--no-install-recommends"];
    install.extend(packages.split(' '));
    apt_get(&install).context("the package manager could not install it")
}

/// A QEMU that is recent enough, or why there is none.
fn qemu_found(program: &str) -> Result<String, String> {
    let line = process::version(program).ok_or_else(|| format!("no version {QEMU_LEAST} or newer"))?;
    if at_least(&line, QEMU_LEAST) { Ok(line) } else { Err(format!("`{line}` is not version {QEMU_LEAST} or newer")) }
}

/// CMake and a libclang where `bindgen` looks for it, or what is missing.
fn twin_tools() -> Result<String, String> {
    let cmake = process::version("cmake").ok_or("no cmake")?;
    let given = std::env::var_os("LIBCLANG_PATH").map(PathBuf::from);
    let told = process::first_line(Command::new("llvm-config").arg("--libdir")).map(PathBuf::from);
    let versions = fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    let versions =
        versions.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("llvm")));
    let usual = ["/usr/lib", "/usr/lib64", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/local/lib"];
    let folders = given.into_iter().chain(told).chain(versions.map(|path| path.join("lib")));
    let folder = folders.chain(usual.map(PathBuf::from)).find(|folder| {
        fs::read_dir(folder).is_ok_and(|entries| entries.flatten().any(|entry| is_libclang(&entry.path())))
    });
    Ok(format!("{cmake}, libclang in {}", folder.ok_or("no libclang")?.display()))
}

/// Whether this is libclang and not a related library (`libclang-cpp`, static libraries).
fn is_libclang(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let rest = name.strip_prefix("libclang").unwrap_or("x");
    rest.starts_with(".so")
        || rest == ".dylib"
        || (rest.starts_with("-") && !rest.starts_with("-cpp") && rest.contains(".so"))
}

/// What packages of the system provide, and their names by package manager.
pub struct System {
    name: &'static str,
    /// What was found, or why it is not suitable.
    found: fn() -> Result<String, String>,
    /// In the order of [`LINUX`].
    linux: [&'static str; LINUX.len()],
    brew: &'static str,
    winget: &'static str,
    /// In words, for a system without any of them.
    otherwise: &'static str,
}

/// Distributions by their names in `/etc/os-release`, and how each installs packages.
const LINUX: [(&[&str], &str); 5] = [
    (&["debian", "ubuntu"], "sudo apt-get update && sudo apt-get install -y --no-install-recommends"),
    (&["fedora", "rhel"], "sudo dnf install -y"),
    (&["arch"], "sudo pacman -S --needed"),
    (&["alpine"], "sudo apk add"),
    (&["suse", "opensuse"], "sudo zypper install"),
];

/// Runs the image.
pub const ARM_QEMU: System = System {
    name: QEMU,
    found: || qemu_found(QEMU),
    linux: ["qemu-system-arm", "qemu-system-arm-core", "qemu-system-arm", "qemu-system-arm", "qemu-arm"],
    brew: "qemu",
    winget: "SoftwareFreedomConservancy.QEMU",
    otherwise: "install QEMU with its ARM system emulator, so that `qemu-system-arm` is on PATH",
};

/// Runs a real Linux kernel, which uses the device.
pub const GUEST: System = System {
    name: GUEST_QEMU,
    found: || qemu_found(GUEST_QEMU),
    linux: ["qemu-system-x86", "qemu-system-x86-core", "qemu-system-x86", "qemu-system-x86_64", "qemu-x86"],
    otherwise: "install QEMU with its x86 system emulator, so that `qemu-system-x86_64` is on PATH",
    ..ARM_QEMU
};

/// For libFuzzer.
pub const CXX: System = System {
    name: "C++",
    found: || process::version("c++").ok_or_else(|| "no c++".into()),
    linux: ["g++", "gcc-c++", "gcc", "g++", "gcc-c++"],
    brew: "gcc",
    winget: "LLVM.LLVM",
    otherwise: "install a C++ compiler, so that `c++` is on PATH",
};

/// Compiles the twin's emulator.
pub const TWIN: System = System {
    name: "CMake and libclang",
    found: twin_tools,
    linux: [
        "cmake make gcc libc6-dev libclang-dev",
        "cmake make gcc clang-devel",
        "cmake make gcc clang",
        "cmake make gcc musl-dev clang-dev",
        "cmake make gcc clang-devel",
    ],
    brew: "cmake llvm",
    winget: "Kitware.CMake LLVM.LLVM",
    otherwise: "install CMake, a C compiler and libclang, and point LIBCLANG_PATH to the folder of libclang",
};

/// How to install the packages on the system with this `/etc/os-release`.
fn advice(system: &System, os_release: &str) -> String {
    let names: Vec<&str> = os_release
        .lines()
        .filter_map(|line| line.strip_prefix("ID=").or(line.strip_prefix("ID_LIKE=")))
        .flat_map(|value| value.trim_matches('"').split(' '))
        .collect();
    let mut linux = LINUX.iter().zip(system.linux);
    if let Some(((_, install), packages)) = linux.find(|((ids, _), _)| ids.iter().any(|id| names.contains(id))) {
        format!("`{install} {packages}`")
    } else if cfg!(target_os = "macos") {
        format!("`brew install {}`", system.brew)
    } else if cfg!(windows) {
        format!("`winget install {}`, then put its folder on PATH", system.winget)
    } else {
        system.otherwise.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_system_has_its_own_advice() {
        let advice = |os_release| advice(&ARM_QEMU, os_release);
        assert!(advice("ID=debian\n").contains("apt-get"));
        assert!(advice("ID=linuxmint\nID_LIKE=\"ubuntu debian\"\n").contains("apt-get"));
        assert!(advice("NAME=Fedora\nID=fedora\n").contains("dnf"));
        assert!(advice("ID=arch\n").contains("pacman"));
        assert!(advice("").contains("QEMU") || advice("").contains("brew"));
    }

    #[test]
    fn libclang_is_told_from_its_sisters() {
        for (path, is_it) in [
            ("/usr/lib/llvm-14/lib/libclang.so.1", true),
            ("/usr/lib/x86_64-linux-gnu/libclang-14.so.14", true),
            ("/opt/homebrew/opt/llvm/lib/libclang.dylib", true),
            ("/usr/lib/x86_64-linux-gnu/libclang-cpp.so.14", false),
            ("/usr/lib/llvm-14/lib/libclangAST.a", false),
        ] {
            assert_eq!(is_libclang(Path::new(path)), is_it, "{path}");
        }
    }
}
