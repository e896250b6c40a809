//! Why a device cannot be used, and what to do about it.

use inerter_wire::{Refusal, VersionAdvice, WIRE_VERSION};
use miette::Diagnostic;

/// A device that cannot be found, opened, understood, or that went away.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum DeviceError {
    /// Nothing that looks like our device is plugged in.
    #[error("no instrumented inerter{} was found among the serial ports{}", with_serial(serial), seen(stlinks, *in_dfu))]
    #[diagnostic(code(inerter::device::none), help("{}", none_help(stlinks, *in_dfu)))]
    NoneFound { serial: Option<String>, stlinks: Vec<String>, in_dfu: bool },

    /// More than one.
    #[error("several instrumented inerters are plugged in: {ports}")]
    #[diagnostic(code(inerter::device::several), help("choose one with --serial NUMBER"))]
    SeveralFound { ports: String },

    /// No such port.
    #[error("the port {port} does not exist")]
    #[diagnostic(
        code(inerter::port::missing),
        help("`inerter ports` lists the ports that exist; is the cable plugged in?")
    )]
    Missing { port: String },

    /// The user may not open it.
    #[error("the port {port} cannot be opened: permission denied")]
    #[diagnostic(
        code(inerter::port::permission),
        help("add yourself to the group of the port, then log out and in: sudo usermod -a -G dialout $USER")
    )]
    Permission { port: String },

    /// Somebody else has it.
    #[error("the port {port} cannot be opened: another program has it open")]
    #[diagnostic(
        code(inerter::port::busy),
        help("close the other program (another `inerter`, a serial terminal, ModemManager)")
    )]
    Busy { port: String },

    /// Any other reason.
    #[error("the port {port} cannot be opened: {reason}")]
    #[diagnostic(code(inerter::port::open), help("`inerter ports` lists the ports of this machine"))]
    Open { port: String, reason: String },

    /// The TCP connection failed.
    #[error("no connection to {address}: {reason}")]
    #[diagnostic(
        code(inerter::device::connect),
        help("is the other end running? For example: inerter simulate --tcp 127.0.0.1:7878")
    )]
    Connect { address: String, reason: String },

    /// Connected, but closed before any data arrived.
    #[error("{name} closed the connection before it sent anything")]
    #[diagnostic(
        code(inerter::device::turned_away),
        help(
            "other programs may hold all its connections: close one of them, or wait; otherwise check that the address is that of a device"
        )
    )]
    TurnedAway { name: String },

    /// Opened, but no data arrives.
    #[error("{name} does not answer: no valid message came within {seconds} s")]
    #[diagnostic(
        code(inerter::device::silent),
        help(
            "is this the right port (`inerter ports`), and does the board run the firmware? Unplug it and plug it in again"
        )
    )]
    Silent { name: String, seconds: f64 },

    /// Data arrives, but no reply to the request.
    #[error("{name} did not answer the request {what}")]
    #[diagnostic(
        code(inerter::device::no_reply),
        help("try again; if that does not help, restart the device and update its firmware")
    )]
    NoReply { name: String, what: &'static str },

    /// More data than any of our devices sends.
    #[error("{name} sends so fast that it cannot be queried")]
    #[diagnostic(
        code(inerter::device::flood),
        help("is this an instrumented inerter? Restart it, and update its firmware")
    )]
    Flood { name: String },

    /// The caller cancelled the work during a wait.
    #[error("interrupted")]
    #[diagnostic(code(inerter::interrupted), help("the device may need a restart; start again when you like"))]
    Interrupted,

    /// Another wire version.
    #[error("{name} speaks wire version {theirs}; this program speaks {WIRE_VERSION}")]
    #[diagnostic(code(inerter::wire::version), help("{}", VersionAdvice { theirs: *theirs }))]
    WireVersion { name: String, theirs: u16 },

    /// The device went away.
    #[error("{name} went away: {reason}{kept}")]
    #[diagnostic(
        code(inerter::device::vanished),
        help("plug it in again; a longer --wait SECONDS waits for it to come back")
    )]
    Vanished { name: String, reason: String, kept: String },

    /// The device refused a request.
    #[error("{name} refused {what}: {refusal}")]
    #[diagnostic(code(inerter::device::refused), help("{}", refusal_help(refusal)))]
    Refused { name: String, what: &'static str, refusal: Refusal },
}

impl DeviceError {
    /// True when waiting for the device to come back may help.
    pub fn may_come_back(&self) -> bool {
        // A missing permission too: a port that has just come back belongs to root until udev has processed it.
        match self {
            Self::NoneFound { .. }
            | Self::Missing { .. }
            | Self::Permission { .. }
            | Self::Busy { .. }
            | Self::Open { .. }
            | Self::Connect { .. }
            | Self::TurnedAway { .. }
            | Self::Silent { .. }
            | Self::NoReply { .. }
            | Self::Flood { .. }
            | Self::Vanished { .. } => true,
            Self::SeveralFound { .. } | Self::Interrupted | Self::WireVersion { .. } | Self::Refused { .. } => false,
        }
    }
}

pub(crate) fn with_serial(serial: &Option<String>) -> String {
    serial.as_ref().map(|serial| format!(" with serial {serial}")).unwrap_or_default()
}

fn seen(stlinks: &[String], in_dfu: bool) -> String {
    let links = if stlinks.is_empty() { String::new() } else { format!("; an ST-Link is at {}", stlinks.join(", ")) };
    format!("{links}{}", if in_dfu { "; a device is in update mode" } else { "" })
}

fn none_help(stlinks: &[String], in_dfu: bool) -> String {
    if in_dfu {
        return "the device waits for firmware: load it with `inerter update FILE`, or reset the device".into();
    }
    let link = match stlinks.first() {
        Some(port) => format!("the ST-Link carries the board's UART: --port {port}"),
        None => "a board on another port needs --port PORT".into(),
    };
    format!(
        "plug in the board's own USB connector and check `inerter ports`; {link}; a simulated one needs --connect HOST:PORT"
    )
}

fn refusal_help(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Unsupported => "`inerter info` shows a recorded device's capabilities; update its firmware",
        Refusal::Busy => {
            "another program may control the device, if `simulate --tcp` or `monitor --share` serves several: end that \
             program, or send the request from it. Otherwise try again; if that does not help, restart the device"
        }
        Refusal::QueueFull { .. } => "try again; if that does not help, restart the device",
        Refusal::BadSetting { .. } => "change this setting with --set",
        Refusal::BadSamples => "update the firmware of the device, or this program",
        Refusal::Store => "the settings hold until the device restarts; if this recurs, the board is damaged",
        Refusal::NotInjecting | Refusal::NoSamples => "start again from the beginning",
        Refusal::Source => "select the front end that is wired with --set front_end, or check its wiring",
        Refusal::NothingSaved => "`inerter settings backup FILE.toml`, without --saved, writes those in use",
        Refusal::SavedUnreadable => "`inerter settings factory-reset` erases it",
        Refusal::NotPlaying => "close other programs, and start again",
        Refusal::Worn { .. } => "nothing was written; a script should save once, after its last change",
    }
}
