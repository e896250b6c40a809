//! The board under test, through any kind of link.

use inerter_wire::{Command, Done, Record, Refusal};

/// A board whose link the caller manages.
pub trait Board {
    /// Sends a command and waits for its reply; records that arrive meanwhile are kept for [`records`](Self::records).
    fn request(&mut self, command: Command) -> Result<Done, JumperError>;

    /// Listens for this long \[s\].
    fn listen(&mut self, for_s: f64) -> Result<(), JumperError>;

    /// Takes the records received since the last call, each with the host's time of arrival \[s\].
    fn records(&mut self) -> Vec<(f64, Record)>;
}

/// Why the test could not be done, as opposed to a failure of the board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JumperError {
    /// The link failed.
    #[error("{0}")]
    Link(String),
    /// The board refused a request.
    #[error("the device refused to {doing}: {why}")]
    Refused {
        /// What was requested.
        doing: &'static str,
        /// Its reason.
        why: Refusal,
    },
    /// The board's player stopped because no knots had arrived in time.
    #[error("this computer was late to send data {0} times: close other programs, and start again")]
    TooLate(u32),
    /// The board released its outputs by itself.
    #[error(
        "a DMA transfer to the board's outputs failed, and the board released them: restart it and start again; \
         if it fails again, please report it"
    )]
    TransferFailed,
    /// No samples arrived.
    #[error("the device sends no samples: check the cable, and start again")]
    NoSamples,
    /// The settings could not be read.
    #[error("the device does not report its settings: update its firmware")]
    NoSettings,
}

impl JumperError {
    pub(crate) fn refused(doing: &'static str) -> impl Fn(Self) -> Self {
        move |error| match error {
            Self::Refused { why, .. } => Self::Refused { doing, why },
            other => other,
        }
    }
}
