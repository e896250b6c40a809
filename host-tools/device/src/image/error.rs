//! Why a file is not firmware for the board.

use std::io;

use miette::Diagnostic;

use crate::board::{CODE, SETTINGS};

/// How to get the right file.
const BUILD: &str = "give a release's inerter-firmware-VERSION-BOARD.elf, or the ELF that `cargo build --release` \
                     makes in firmware/stm32g474: target/thumbv7em-none-eabihf/release/inerter-stm32g474";

/// Why a file cannot be the board's firmware.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ImageError {
    /// The file cannot be read.
    #[error("{file} cannot be read: {source}")]
    #[diagnostic(code(inerter::image::read), help("check the name and that you may read the file"))]
    Read { file: String, source: io::Error },

    /// The file is something else.
    #[error("{file} is not a firmware image: {what}")]
    #[diagnostic(code(inerter::image::kind), help("{BUILD}"))]
    Kind { file: String, what: &'static str },

    /// The ELF is truncated or inconsistent.
    #[error("{file} is a damaged ELF: {what}")]
    #[diagnostic(code(inerter::image::damaged), help("build or copy it again"))]
    Damaged { file: String, what: String },

    /// The ELF is for another machine.
    #[error("{file} is a program for {machine}, not for the board's Arm Cortex-M4")]
    #[diagnostic(code(inerter::image::machine), help("{BUILD}"))]
    Machine { file: String, machine: String },

    /// Part of it would lie outside the board's code area.
    #[error(
        "{file} has bytes for 0x{start:08X} to 0x{end:08X}; the firmware lies in 0x{:08X} to 0x{:08X} (flash bank 1)",
        CODE.start,
        CODE.end
    )]
    #[diagnostic(
        code(inerter::image::address),
        help("was it built for another chip, or to follow a bootloader? {BUILD}")
    )]
    Outside { file: String, start: u64, end: u64 },

    /// Part of it would overwrite the settings.
    #[error(
        "{file} has bytes for 0x{start:08X} to 0x{end:08X}, over the settings at 0x{:08X} to 0x{:08X}",
        SETTINGS.start,
        SETTINGS.end
    )]
    #[diagnostic(code(inerter::image::settings), help("it would destroy settings and calibration. {BUILD}"))]
    OverSettings { file: String, start: u64, end: u64 },

    /// The chip could not boot it.
    #[error("{file} cannot start on the board: {what}")]
    #[diagnostic(code(inerter::image::vectors), help("{BUILD}"))]
    Vectors { file: String, what: String },

    /// Nothing identifies it as ours.
    #[error("{file} does not name its firmware, commit and board")]
    #[diagnostic(code(inerter::image::identity), help("is it the image for QEMU, or another project's? {BUILD}"))]
    NoIdentity { file: String },

    /// Its identity cannot be read.
    #[error("{file} identifies its firmware in an unknown format: {what}")]
    #[diagnostic(code(inerter::image::identity_form), help("use the `inerter` program of the same release. {BUILD}"))]
    BadIdentity { file: String, what: &'static str },
}
