//! Why an update did not start or did not finish, and what to do about it.

use miette::Diagnostic;

use crate::{
    board::{CODE, FLASH_KB, PAGE, SET_DBANK, SMALL_FLASH},
    error::{DeviceError, with_serial},
    udev::install_rule,
};

/// How to put a board into update mode by hand, and the alternatives.
pub const BY_HAND: &str = "a board whose firmware does not run enters update mode by hand: hold BOOT0 (WeAct: the button \
                           B0; NUCLEO: join CN7 pins 5 and 7), press reset, then run the same command again. With a \
                           debug probe `inerter flash` needs none of this";

/// An update that failed.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum UpdateError {
    /// No device to update.
    #[error("no instrumented inerter was found{}, neither running nor in update mode", with_serial(serial))]
    #[diagnostic(
        code(inerter::update::none),
        help("plug in the board's own USB connector and check `inerter ports`; {BY_HAND}")
    )]
    NoDevice { serial: Option<String> },

    /// Several devices in update mode.
    #[error("several devices are in update mode: serial {serials}")]
    #[diagnostic(code(inerter::update::several), help("choose one with --serial"))]
    Several { serials: String },

    /// The firmware cannot enter the update mode.
    #[error("{name} cannot enter update mode by itself: its firmware ({firmware}) does not offer it")]
    #[diagnostic(code(inerter::update::cannot), help("is it a simulated device? Else {BY_HAND}"))]
    CannotEnter { name: String, firmware: String },

    /// Its firmware does not answer.
    #[error("{name} was found, but cannot be asked to enter update mode: {reason}")]
    #[diagnostic(code(inerter::update::cannot_ask), help("{BY_HAND}"))]
    CannotAsk { name: String, reason: String },

    /// It was told to enter update mode and did not reappear.
    #[error("the device (serial {serial}) did not appear in update mode within {seconds} s{}", seen(others))]
    #[diagnostic(code(inerter::update::no_dfu), help("{}", no_dfu_help(others)))]
    DidNotAppear { serial: String, seconds: u64, others: Vec<String> },

    /// USB devices cannot be listed.
    #[error("the USB devices of this machine cannot be listed: {reason}")]
    #[diagnostic(code(inerter::update::usb), help("does this system (container, virtual machine) have access to USB?"))]
    Usb { reason: String },

    /// The device in update mode may not be opened.
    #[error("the device in update mode (serial {serial}) cannot be opened: permission denied")]
    #[diagnostic(code(inerter::update::permission), help("{}", permission_help()))]
    Permission { serial: String },

    /// The device in update mode cannot be opened.
    #[error("the device in update mode (serial {serial}) cannot be opened: {reason}")]
    #[diagnostic(code(inerter::update::open), help("{}", open_help()))]
    Open { serial: String, reason: String },

    /// Its flash does not match our chip's.
    #[error("the device in update mode is not the board's chip: {what}")]
    #[diagnostic(
        code(inerter::update::chip),
        help("is it another STM32 in update mode? Unplug it, or choose the right one with --serial")
    )]
    OtherChip { what: String },

    /// A smaller member of the family.
    #[error("the chip has {kb} KB of flash; image and settings need {FLASH_KB} KB")]
    #[diagnostic(code(inerter::update::small), help("{SMALL_FLASH}"))]
    SmallFlash { kb: u32 },

    /// Single-bank mode.
    #[error("the chip erases {size} bytes at 0x{address:08X} at once, not {PAGE}: its flash is set to a single bank")]
    #[diagnostic(code(inerter::update::bank), help("{SET_DBANK}"))]
    SingleBank { address: u32, size: u32 },

    /// The transfer was cut off.
    #[error("the device went away while {action}: {reason}")]
    #[diagnostic(
        code(inerter::update::lost),
        help("settings are untouched. Plug it in again and run the same command again; {BY_HAND}")
    )]
    Lost { action: String, reason: String },

    /// The ROM refuses an operation.
    #[error("the chip refuses {action}: {status}")]
    #[diagnostic(code(inerter::update::refused), help("{}", refused_help(*protected)))]
    Refused { action: String, status: String, protected: bool },

    /// The ROM takes too long.
    #[error("the chip timed out while {action}: {seconds} s, state {state}")]
    #[diagnostic(code(inerter::update::stuck), help("reset it and run the same command again; {BY_HAND}"))]
    Stuck { action: String, seconds: u64, state: String },

    /// The data read back differ from those written.
    #[error("flash at 0x{address:08X} reads 0x{got:02X} where 0x{wanted:02X} was written")]
    #[diagnostic(
        code(inerter::update::verify),
        help("run the same command again; if it fails again, the chip's flash is worn out")
    )]
    Verify { address: u32, wanted: u8, got: u8 },

    /// The image is for another board.
    #[error("the image is for the board {image}, the device is a {device}")]
    #[diagnostic(
        code(inerter::update::board),
        help(
            "build it for this board (cargo build --release --no-default-features --features board-...); --force writes it anyway"
        )
    )]
    OtherBoard { image: String, device: String },

    /// The image is written but the device does not answer.
    #[error(
        "{written} is written, but the device (serial {serial}) did not come back within {seconds} s{}",
        reason_words(reason)
    )]
    #[diagnostic(
        code(inerter::update::not_back),
        help("unplug it, plug it in again, and check with `inerter monitor`; if it does not come back, {BY_HAND}")
    )]
    NotBack { written: String, serial: String, seconds: u64, reason: String },

    /// The device did not leave update mode, though nothing was written.
    #[error("the device (serial {serial}) may have stayed in update mode: {reason}")]
    #[diagnostic(
        code(inerter::update::stays),
        help(
            "nothing was written: press the board's reset button once, or unplug it and plug it in again; its \
             firmware then runs as before"
        )
    )]
    StaysInDfu { serial: String, reason: String },

    /// It runs other firmware than was written.
    #[error("the device runs {running}, not {written}, which was written")]
    #[diagnostic(
        code(inerter::update::version),
        help("was another device meant? `inerter ports` lists them, --serial chooses one")
    )]
    OtherVersion { running: String, written: String },

    /// Ctrl-C during writing.
    #[error("interrupted; the device has no complete firmware now and stays in update mode")]
    #[diagnostic(code(inerter::update::interrupted), help("run the same command again to complete it; {BY_HAND}"))]
    Interrupted,

    /// The running device cannot be reached.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Device(#[from] DeviceError),
}

fn seen(others: &[String]) -> String {
    if others.is_empty() { String::new() } else { format!("; another one did: serial {}", others.join(", ")) }
}

fn reason_words(reason: &str) -> String {
    if reason.is_empty() { String::new() } else { format!(": {reason}") }
}

fn no_dfu_help(others: &[String]) -> String {
    let other = match others {
        [one] => format!("if that is the one: --serial {one}. "),
        _ => String::new(),
    };
    let driver = if cfg!(windows) {
        "Windows needs the WinUSB driver for `STM32 BOOTLOADER` once: install it with STM32CubeProgrammer or Zadig"
    } else {
        "`lsusb -d 0483:df11` shows whether the system sees it"
    };
    format!(
        "{other}the update goes over the board's own USB connector, not over an ST-Link: is it plugged in? {driver}. \
         Nothing was changed; a reset restarts the firmware"
    )
}

fn permission_help() -> String {
    if cfg!(target_os = "linux") {
        format!("allow it once: {}; then run the same command again", install_rule())
    } else {
        "run it as a user who may use USB devices; nothing was changed, a reset restarts the firmware".into()
    }
}

fn open_help() -> String {
    if cfg!(windows) {
        "Windows needs the WinUSB driver for `STM32 BOOTLOADER` once: install it with STM32CubeProgrammer or Zadig"
            .into()
    } else {
        "close other programs that use it (dfu-util, STM32CubeProgrammer), then run the same command again".into()
    }
}

fn refused_help(protected: bool) -> String {
    if protected {
        format!(
            "the flash from 0x{:08X} is protected: remove read and write protection with STM32CubeProgrammer \
             (removing read protection erases everything, settings too)",
            CODE.start
        )
    } else {
        format!("run the same command again; {BY_HAND}")
    }
}
