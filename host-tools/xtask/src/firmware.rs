//! The images: how they are compiled on this machine, and how QEMU's is started.

use crate::{foreign, process, setup, toolchain::Toolchain, tree, workspace};
use anyhow::{Context, Result};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

/// One program for the target.
pub struct Image {
    /// The variable that tells tests where it is.
    pub variable: &'static str,
    /// Folder from which it is built: the cargo settings of a package (target, profile) apply only from within its own.
    folder: &'static str,
    /// Arguments of `cargo build`.
    arguments: &'static [&'static str],
    /// Name of the program that cargo makes.
    program: &'static str,
    /// The file name of an image that cargo builds under the shipping image's name.
    file: Option<&'static str>,
}

impl Image {
    /// For QEMU's netduinoplus2.
    pub const QEMU: Self = Self {
        variable: "INERTER_QEMU_IMAGE",
        folder: "",
        arguments: &["--package", "inerter-qemu", "--profile", "firmware"],
        program: "inerter-qemu",
        file: None,
    };

    /// The shipping image, for the NUCLEO: what `cargo build --release` makes in its folder.
    pub const BOARD: Self = Self {
        variable: "INERTER_STM32_ELF",
        folder: "firmware/stm32g474",
        arguments: &["--release"],
        program: "inerter-stm32g474",
        file: None,
    };

    /// The shipping image, for the WeAct board.
    pub const WEACT: Self = Self {
        variable: "INERTER_STM32_WEACT_ELF",
        arguments: &["--release", "--no-default-features", "--features", "board-weact"],
        file: Some("inerter-stm32g474-weact"),
        ..Self::BOARD
    };

    /// The shipping image with a task that hangs, to test the watchdog.
    const HANG: Self = Self {
        variable: "INERTER_STM32_HANG_ELF",
        arguments: &["--release", "--features", "hang"],
        file: Some("inerter-stm32g474-hang"),
        ..Self::BOARD
    };

    /// Everything that the tests run. The shipping image comes last: cargo gives its file name to the board's other
    /// images too.
    const ALL: [Self; 4] = [Self::QEMU, Self::WEACT, Self::HANG, Self::BOARD];
}

/// The compiler of the images, installed if there is none.
fn compiler() -> Result<Toolchain> {
    if let Some(toolchain) = Toolchain::find() {
        return Ok(toolchain);
    }
    setup::ensure(&[setup::Need::Firmware], false)?;
    Toolchain::find().context("no compiler for the firmware")
}

/// Builds the image and returns its path.
pub fn build(image: Image) -> Result<PathBuf> {
    let mut command = compiler()?.cargo("build");
    // Cargo releases its own lock before the image is renamed.
    let lock = workspace::target()?.join("images.lock");
    let lock = fs::File::create(&lock).with_context(|| format!("cannot write {}", lock.display()))?;
    lock.lock().context("the lock of the images")?;
    command.current_dir(tree::root().join(image.folder)).args(image.arguments);
    command.args(["--locked", "--message-format=json-render-diagnostics"]);
    let messages = process::output(&mut command).context("the firmware did not build")?;
    let built = executable(&messages, image.program)
        .with_context(|| format!("cargo built no image; is {} still a program?", image.program))?;
    let Some(file) = image.file else { return Ok(built) };
    // Renamed, so that it is never mistaken for the shipping image.
    let own = built.with_file_name(file);
    fs::rename(&built, &own).with_context(|| format!("cannot write {}", own.display()))?;
    Ok(own)
}

/// Builds all images and the foreign programs; returns the variables for them, and their paths.
pub fn build_all() -> Result<Vec<(&'static str, PathBuf)>> {
    let foreign = (foreign::VARIABLE, foreign::build(&compiler()?)?);
    let images = Image::ALL.into_iter().map(|image| Ok((image.variable, build(image)?)));
    images.chain([Ok(foreign)]).collect()
}

/// Builds all images and prints their paths.
pub fn run_build() -> Result<()> {
    for (_, path) in build_all()? {
        println!("{}", path.display());
    }
    Ok(())
}

/// Path of the program in cargo's messages.
fn executable(messages: &str, name: &str) -> Option<PathBuf> {
    let mut messages = messages.lines().rev().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    messages.find_map(|message| {
        let is_it = message["reason"] == "compiler-artifact" && message["target"]["name"] == name;
        message["executable"].as_str().filter(|_| is_it).map(PathBuf::from)
    })
}

/// Runs the image in QEMU with virtual time counted in instructions, and returns what it wrote by semihosting.
pub fn run(image: &Path, arguments: &[&str], limit: Duration) -> Result<String> {
    setup::ensure(&[setup::Need::System(&setup::ARM_QEMU)], false)?;
    let semihosting = format!("enable=on,target=native,arg={}", [&["inerter"][..], arguments].concat().join(",arg="));
    process::output_within(
        Command::new(setup::QEMU)
            .args(["-machine", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"])
            // 64 ns per instruction, so that SysTick, at 168 MHz, resolves single instructions; no real time passes
            // while the image sleeps.
            .args(["-icount", "shift=6,sleep=off", "-semihosting-config", &semihosting, "-kernel"])
            .arg(image),
        limit,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

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
