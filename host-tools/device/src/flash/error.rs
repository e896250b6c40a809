//! Why programming through a probe failed, and what to do about it.

use miette::Diagnostic;

use crate::{
    board::{CHIP, FLASH_KB, SET_DBANK, SMALL_FLASH},
    udev::udev_help,
};

/// Programming that failed.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum FlashError {
    /// The program was built without support for probes.
    #[error("this `inerter` was built without its feature `probe`, which `inerter flash` needs")]
    #[diagnostic(
        code(inerter::flash::built_without),
        help(
            "build it with `cargo install --path host-tools/inerter`, or add `--features probe` to your own build command; or use \
             `cargo run --release` in firmware/stm32g474; or, without a probe, `inerter update`"
        )
    )]
    BuiltWithout,

    /// No probe is connected.
    #[error("no debug probe was found")]
    #[diagnostic(
        code(inerter::flash::no_probe),
        help(
            "plug in the NUCLEO's ST-Link connector, or a probe on the SWD pins; without a probe use `inerter update`, \
             which needs only the board's own USB connector"
        )
    )]
    NoProbe,

    /// Several probes are connected.
    #[error("several debug probes are plugged in: {probes}")]
    #[diagnostic(code(inerter::flash::several), help("choose one with --probe VID:PID:SERIAL, as listed"))]
    SeveralProbes { probes: String },

    /// No probe matches the selection.
    #[error("there is no debug probe `{words}`; there are: {probes}")]
    #[diagnostic(code(inerter::flash::no_such_probe), help("give --probe VID:PID:SERIAL, as listed"))]
    NoSuchProbe { words: String, probes: String },

    /// The user may not open the probe.
    #[error("the debug probe {probe} cannot be opened: permission denied")]
    #[diagnostic(code(inerter::flash::permission), help("{}", udev_help(vid, "")))]
    Permission { probe: String, vid: String },

    /// The probe cannot be opened.
    #[error("the debug probe {probe} cannot be opened: {reason}")]
    #[diagnostic(
        code(inerter::flash::open),
        help(
            "close other programs that use it (probe-rs, OpenOCD, STM32CubeProgrammer), and plug it in again; \
             on Windows an ST-Link needs ST's driver"
        )
    )]
    Open { probe: String, reason: String },

    /// Unknown chip.
    #[error("there is no chip `{chip}`: {reason}")]
    #[diagnostic(code(inerter::flash::chip), help("leave --chip out for the board's own, {CHIP}"))]
    Chip { chip: String, reason: String },

    /// The probe cannot connect to the chip.
    #[error("the chip does not answer through {probe}: {reason}")]
    #[diagnostic(
        code(inerter::flash::attach),
        help("is the board powered, and are SWDIO, SWCLK, GND and NRST connected?")
    )]
    Attach { probe: String, reason: String },

    /// Another chip.
    #[error("the chip is not the board's: its device number is 0x{found:03X}, not 0x{wanted:03X} (STM32G474)")]
    #[diagnostic(code(inerter::flash::other_chip), help("is the probe on the right board? Nothing was changed"))]
    OtherChip { found: u32, wanted: u32 },

    /// A smaller member of the family.
    #[error("the chip has {kb} KB of flash; image and settings need {FLASH_KB} KB")]
    #[diagnostic(code(inerter::flash::small), help("{SMALL_FLASH}"))]
    SmallFlash { kb: u16 },

    /// Single-bank mode.
    #[error("the chip's flash is set to a single bank, in which the firmware cannot keep its settings")]
    #[diagnostic(code(inerter::flash::bank), help("{SET_DBANK}"))]
    SingleBank,

    /// The chip would not boot from flash.
    #[error("the chip does not start from flash: its option bytes nSWBOOT0 and nBOOT0 are 0")]
    #[diagnostic(
        code(inerter::flash::boot),
        help("set nBOOT0 to 1, its factory value, with STM32CubeProgrammer; nothing was changed")
    )]
    NoStart,

    /// Erasing, writing or reading back failed.
    #[error("programming failed: {reason}")]
    #[diagnostic(
        code(inerter::flash::program),
        help(
            "run the same command again; if it fails again, remove read and write protection with STM32CubeProgrammer \
             (removing read protection erases everything, settings too)"
        )
    )]
    Program { reason: String },
}
