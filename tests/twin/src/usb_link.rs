//! A board on a USB cable, with the host program at the other end.
//!
//! Most tests use [`UsbLink::connect`], [`UsbLink::open`] and [`UsbLink::request`], and access the machine between
//! calls in [`UsbLink::socket`].

use crate::Registers;
use crate::chip::usb::Usb;
use crate::machine::Machine;
use crate::talk::Talk;
use crate::usb_host::serial::SerialPort;
use crate::usb_host::{Carried, Description, Socket, UsbError, UsbHost};
use inerter_core::Settings;
use inerter_wire::{Command, Refusal, Reply};

/// Timeout for a reply; saving settings may have to erase a page.
const REPLY_S: f64 = 2.0;

/// Why a request failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// The port is not open.
    #[error("the port is not open")]
    Closed,
    /// A USB transfer failed.
    #[error(transparent)]
    Usb(#[from] UsbError),
    /// No reply within the time.
    #[error("no reply within {0} s")]
    NoReply(f64),
    /// The device refused.
    #[error("the device refused: {0:?}")]
    Refused(Refusal),
}

/// Device, cable and host.
pub struct UsbLink<S> {
    /// The device.
    pub socket: S,
    /// The host controller.
    pub host: UsbHost,
    /// The host program's protocol state.
    pub talk: Talk,
    port: Option<SerialPort>,
}

impl Socket for Machine {
    fn usb(&mut self) -> &mut Usb {
        let now = self.now();
        let usb = &mut self.chip_mut().usb;
        usb.advance(now);
        usb
    }

    fn time_s(&mut self) -> f64 {
        Machine::time_s(self)
    }

    fn run_for(&mut self, time_s: f64) -> Result<(), String> {
        Machine::run_for(self, time_s).map_err(|ended| ended.to_string())
    }

    fn set_supply(&mut self, on: bool) {
        let now = self.now();
        let chip = self.chip_mut();
        chip.set_pin(chip.board.vbus, on, now);
    }
}

impl<S: Socket> UsbLink<S> {
    /// A device with its cable disconnected.
    pub fn new(socket: S) -> Self {
        Self { socket, host: UsbHost::default(), talk: Talk::default(), port: None }
    }

    /// Connects and enumerates.
    pub fn connect(&mut self) -> Carried<Description> {
        self.host.connect(&mut self.socket)
    }

    /// Connects, enumerates and opens the port.
    pub fn plug_in(&mut self) -> Carried<Description> {
        let description = self.connect()?;
        self.open()?;
        Ok(description)
    }

    /// Opens the port. The protocol state starts fresh, as in a program that has just been started.
    pub fn open(&mut self) -> Carried {
        self.port = Some(SerialPort::open(&mut self.host, &mut self.socket)?);
        self.talk = Talk::default();
        Ok(())
    }

    /// Closes the port.
    pub fn close(&mut self) -> Carried {
        match self.port.take() {
            Some(port) => port.close(&mut self.host, &mut self.socket),
            None => Ok(()),
        }
    }

    /// Makes the host program stop reading until the port is reopened.
    pub fn stop_reading(&mut self) {
        if let Some(port) = &mut self.port {
            port.stop_reading(&mut self.host);
        }
    }

    /// Disconnects the cable, which closes the port.
    pub fn unplug(&mut self) {
        self.port = None;
        self.host.unplug(&mut self.socket);
    }

    /// Sends bytes to the device; returns how many it accepted within the time.
    pub fn send(&mut self, bytes: &[u8], within_s: f64) -> Result<usize, LinkError> {
        let port = self.port.as_mut().ok_or(LinkError::Closed)?;
        match port.send(&mut self.host, &mut self.socket, bytes, within_s) {
            (moved, Ok(()) | Err(UsbError::Late)) => Ok(moved),
            (_, Err(error)) => Err(error.into()),
        }
    }

    /// The raw bytes that arrive within a time.
    pub fn receive(&mut self, for_s: f64) -> Result<Vec<u8>, LinkError> {
        let port = self.port.as_mut().ok_or(LinkError::Closed)?;
        Ok(port.receive(&mut self.host, &mut self.socket, for_s)?)
    }

    /// Receives for a time; the records go to [`talk`](Self::talk).
    pub fn listen(&mut self, for_s: f64) -> Result<(), LinkError> {
        let bytes = self.receive(for_s)?;
        self.talk.take(&bytes);
        Ok(())
    }

    /// Sends a command and waits for its reply.
    pub fn request(&mut self, command: Command, within_s: f64) -> Result<Reply, LinkError> {
        let end_s = self.socket.time_s() + within_s;
        let (id, bytes) = self.talk.request(command);
        self.send(&bytes, within_s)?;
        loop {
            if let Some(reply) = self.talk.reply(id) {
                return Ok(reply);
            }
            if self.socket.time_s() >= end_s {
                return Err(LinkError::NoReply(within_s));
            }
            self.listen(1e-3)?;
        }
    }

    /// Connects, applies and saves settings, and disconnects, as a user does once with a new board.
    pub fn set_up(&mut self, settings: &Settings) -> Result<(), LinkError> {
        self.plug_in()?;
        for command in [Command::Hello, Command::WriteSettings(settings.into()), Command::SaveSettings] {
            self.request(command, REPLY_S)?.result.map_err(LinkError::Refused)?;
        }
        self.unplug();
        Ok(())
    }
}
