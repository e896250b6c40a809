//! What can go wrong, and what to do next.

use crate::config::ConfigError;
use crate::registers::{Register, Status};

/// Why an operation failed. `S` is the SPI's error, `P` the reset pin's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<S, P> {
    /// The SPI peripheral failed.
    Spi(S),
    /// The reset pin failed.
    Pin(P),
    /// The configuration is impossible.
    Config(ConfigError),
    /// Every bit of the frame is the same: nothing drives the line.
    NoChip {
        /// The level that DOUT stays at.
        high: bool,
    },
    /// Another chip answers: its reset acknowledge or ID.
    WrongChip {
        /// Its answer; 0xFF24 or 0x24xx was expected.
        response: u16,
    },
    /// The pin did not reset the chip.
    NotReset {
        /// The chip's answer in place of 0xFF24 or a status with RESET.
        response: u16,
    },
    /// The frame from the chip was damaged on the way; its conversion is lost.
    FrameCrc {
        /// Last word received.
        received: u32,
        /// Last word computed from the others.
        computed: u32,
    },
    /// The chip reports that our frame was damaged on the way.
    CommandCrc,
    /// A command was not acknowledged.
    Refused {
        /// The command's word.
        command: u16,
        /// What came back.
        response: u16,
    },
    /// A register does not read back as written.
    NotKept {
        /// The register.
        register: Register,
        /// What was written.
        wrote: u16,
        /// What it reads.
        read: u16,
    },
    /// The chip was reset unexpectedly: it runs with its defaults.
    WasReset {
        /// The chip's STATUS register.
        status: Status,
    },
    /// The register map changed, or the interface is no longer locked.
    SetupChanged {
        /// The chip's STATUS register.
        status: Status,
    },
    /// The conversions were restarted: their instants have moved.
    Resynchronised {
        /// The chip's STATUS register.
        status: Status,
    },
    /// No new conversion, though DRDY was waited for.
    NotReady {
        /// The chip's STATUS register.
        status: Status,
    },
    /// Conversions come faster than they are read.
    TooSlow,
    /// Requested before `init` succeeded, or while in standby.
    NotRunning,
}

/// What to do about an [`Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recovery {
    /// Leave this conversion out and continue.
    Continue,
    /// `resynchronise`, and treat what lies between as missing.
    Resynchronise,
    /// `init`, and treat what lies between as missing.
    Initialise,
    /// Wiring, supply, clock or configuration must change first. Until then `init` may be tried from time to time.
    Person,
}

impl<S, P> Error<S, P> {
    /// What to do next.
    pub const fn recovery(&self) -> Recovery {
        match self {
            Self::CommandCrc => Recovery::Continue,
            Self::FrameCrc { .. } | Self::Resynchronised { .. } | Self::NotReady { .. } => Recovery::Resynchronise,
            Self::Spi(_)
            | Self::Refused { .. }
            | Self::WasReset { .. }
            | Self::SetupChanged { .. }
            | Self::NotRunning => Recovery::Initialise,
            Self::Pin(_)
            | Self::Config(_)
            | Self::NoChip { .. }
            | Self::WrongChip { .. }
            | Self::NotReset { .. }
            | Self::NotKept { .. }
            | Self::TooSlow => Recovery::Person,
        }
    }
}

impl<S: core::fmt::Debug, P: core::fmt::Debug> core::fmt::Display for Error<S, P> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Spi(error) => write!(f, "SPI: {error:?}"),
            Self::Pin(error) => write!(f, "reset pin: {error:?}"),
            Self::Config(error) => write!(f, "configuration: {error}"),
            Self::NoChip { high: false } => {
                write!(f, "no ADS131M04: DOUT stays low; check AVDD, DVDD, CS and that DOUT goes to MISO")
            }
            Self::NoChip { high: true } => {
                write!(
                    f,
                    "no ADS131M04: DOUT stays high; check that CS and SCLK reach the chip and that it is soldered"
                )
            }
            Self::WrongChip { response } => {
                write!(f, "not an ADS131M04: it answers {response:#06X}; check the part number on the package")
            }
            Self::NotReset { response } => {
                write!(f, "the chip answers {response:#06X} after reset; check SYNC/RESET and the clock at CLKIN")
            }
            Self::FrameCrc { received, computed } => {
                write!(
                    f,
                    "frame damaged: CRC {received:#08X}, computed {computed:#08X}; if often, shorten SCLK and DOUT"
                )
            }
            Self::CommandCrc => write!(f, "the chip received a damaged frame; if often, shorten SCLK and DIN"),
            Self::Refused { command, response } => {
                write!(f, "command {command:#06X} was answered by {response:#06X}; initialise again")
            }
            Self::NotKept { register, wrote, read } => {
                write!(f, "{register:?} reads {read:#06X} where {wrote:#06X} was written; check DIN and the supply")
            }
            Self::WasReset { status } => {
                write!(f, "the chip was reset (status {:#06X}); check its supply, then initialise again", status.0)
            }
            Self::SetupChanged { status } => {
                write!(f, "the chip's set-up changed (status {:#06X}); initialise again", status.0)
            }
            Self::Resynchronised { status } => {
                write!(
                    f,
                    "conversions restarted (status {:#06X}); resynchronise, check for noise on SYNC/RESET",
                    status.0
                )
            }
            Self::NotReady { status } => {
                write!(f, "no new conversion (status {:#06X}); check DRDY and the clock at CLKIN", status.0)
            }
            Self::TooSlow => {
                write!(f, "conversions come faster than frames are read; choose a larger OSR or a faster SCLK")
            }
            Self::NotRunning => write!(f, "not converting; initialise or wake up first"),
        }
    }
}

impl<S: core::fmt::Debug, P: core::fmt::Debug> core::error::Error for Error<S, P> {}
