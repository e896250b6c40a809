//! A board on the serial link (LPUART1 behind the ST-Link's virtual COM port), with the host program at the other end.
//!
//! For tests that are not about USB: no enumeration and no bus schedule, but the same bytes.

use crate::machine::{Ended, Machine};
use crate::talk::Talk;
use inerter_wire::{Command, Refusal, Reply};

/// Polling interval of the host \[s\].
const STEP_S: f64 = 5e-3;

/// Why a request failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SerialError {
    /// The run has ended.
    #[error(transparent)]
    Ended(#[from] Ended),
    /// No reply within the timeout.
    #[error("no reply to {command} within {limit_s} s")]
    NoReply {
        /// The command.
        command: String,
        /// The timeout \[s\].
        limit_s: f64,
    },
    /// The device refused.
    #[error("{command} was refused: {refusal:?}")]
    Refused {
        /// The command.
        command: String,
        /// The reason.
        refusal: Refusal,
    },
}

/// Device, link and host.
pub struct SerialLink {
    /// The device.
    pub machine: Machine,
    /// The host program's protocol state.
    pub talk: Talk,
}

impl SerialLink {
    /// A link with nothing sent yet.
    pub fn new(machine: Machine) -> Self {
        Self { machine, talk: Talk::default() }
    }

    /// Receives until a time in seconds since power-on; the records go to [`talk`](Self::talk).
    pub fn listen_until(&mut self, time_s: f64) -> Result<(), Ended> {
        // A run ends on a whole cycle, which rounding may put just before or after `time_s`.
        while self.machine.time_s() + 1e-9 < time_s {
            self.machine.run_until(time_s.min(self.machine.time_s() + STEP_S))?;
            let bytes = self.machine.serial_take();
            self.talk.take(&bytes);
        }
        Ok(())
    }

    /// Sends a command and waits for its reply.
    pub fn request(&mut self, command: Command, limit_s: f64) -> Result<Reply, SerialError> {
        let (name, end_s) = (format!("{command:?}"), self.machine.time_s() + limit_s);
        let (id, bytes) = self.talk.request(command);
        self.machine.serial_send(&bytes);
        loop {
            if let Some(reply) = self.talk.reply(id) {
                return Ok(reply);
            }
            if self.machine.time_s() >= end_s {
                return Err(SerialError::NoReply { command: name, limit_s });
            }
            self.listen_until(self.machine.time_s() + STEP_S)?;
        }
    }

    /// The same for a command that must succeed.
    pub fn order(&mut self, command: Command, limit_s: f64) -> Result<(), SerialError> {
        let name = format!("{command:?}");
        let reply = self.request(command, limit_s)?;
        reply.result.map(|_| ()).map_err(|refusal| SerialError::Refused { command: name, refusal })
    }
}
