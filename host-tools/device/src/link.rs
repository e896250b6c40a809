//! The byte link to the device: a serial port or a TCP connection.

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    path::Path,
    time::Duration,
};

use serialport::SerialPort;

use crate::{error::DeviceError, ports};

/// Baud rate of the board's UART, which an ST-Link's serial port carries; USB and pseudo-terminals ignore it.
pub const DEFAULT_BAUD: u32 = 921_600;
/// A write that takes longer means that the device does not read.
const WRITE_TIME: Duration = Duration::from_secs(2);
/// A read that takes longer returns control to the caller.
const READ_TIME: Duration = Duration::from_millis(20);
/// Time for a TCP connection to be made.
const CONNECT_TIME: Duration = Duration::from_secs(3);

/// Which device to talk to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// The only one that is plugged in, or the one with this serial number.
    Usb {
        /// The serial number, once it is known.
        serial: Option<String>,
    },
    /// A serial port by its name.
    Port {
        /// The name.
        port: String,
        /// Baud rate, for real UARTs.
        baud: u32,
    },
    /// `HOST:PORT`.
    Tcp {
        /// Host and port.
        address: String,
    },
}

impl Target {
    /// How to find a device with this serial number again on whatever port it then has: over USB by that number, even
    /// if it was given by its port.
    pub fn known(self, serial: &str) -> Self {
        match self {
            Self::Usb { serial: None } => Self::Usb { serial: Some(serial.to_string()) },
            Self::Port { port, baud } => match ports::serial_of(&port) {
                Some(serial) => Self::Usb { serial: Some(serial) },
                None => Self::Port { port, baud },
            },
            target => target,
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Usb { .. } => f.write_str("the instrumented inerter"),
            Self::Port { port, .. } => f.write_str(port),
            Self::Tcp { address } => f.write_str(address),
        }
    }
}

/// An open link.
pub enum Link {
    /// A serial port or pseudo-terminal.
    Serial(Box<dyn SerialPort>),
    /// A TCP connection.
    Tcp(TcpStream),
}

impl Link {
    /// Opens the link; also returns its name.
    pub fn open(target: &Target) -> Result<(Self, String), DeviceError> {
        match target {
            Target::Usb { serial } => {
                let port = ports::find(serial.as_deref())?;
                Ok((Self::serial(&port, DEFAULT_BAUD)?, port))
            }
            Target::Port { port, baud } => Ok((Self::serial(port, *baud)?, port.clone())),
            Target::Tcp { address } => Ok((Self::tcp(address)?, address.clone())),
        }
    }

    fn serial(port: &str, baud: u32) -> Result<Self, DeviceError> {
        let mut opened = serialport::new(port, baud).timeout(READ_TIME).open().map_err(|error| reason(port, &error))?;
        // The device takes DTR as a sign of a listening host; pseudo-terminals have no such line.
        opened.write_data_terminal_ready(true).ok();
        opened.clear(serialport::ClearBuffer::Input).ok();
        Ok(Self::Serial(opened))
    }

    fn tcp(address: &str) -> Result<Self, DeviceError> {
        let failed = |reason: String| DeviceError::Connect { address: address.into(), reason };
        let places = address.to_socket_addrs().map_err(|error| match error.kind() {
            io::ErrorKind::InvalidInput => failed("an address has the form HOST:PORT".into()),
            _ => failed(error.to_string()),
        })?;
        let mut last = failed("the name has no address".into());
        for place in places {
            match TcpStream::connect_timeout(&place, CONNECT_TIME) {
                Ok(stream) => {
                    let ready = stream
                        .set_nodelay(true)
                        .and_then(|()| stream.set_read_timeout(Some(READ_TIME)))
                        .and_then(|()| stream.set_write_timeout(Some(WRITE_TIME)));
                    ready.map_err(|error| failed(error.to_string()))?;
                    return Ok(Self::Tcp(stream));
                }
                Err(error) => last = failed(error.to_string()),
            }
        }
        Err(last)
    }

    /// Reads what has arrived, waiting briefly; returns 0 if nothing has.
    pub fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let result = match self {
            Self::Serial(port) => port.read(into),
            Self::Tcp(stream) => stream.read(into),
        };
        match result {
            Ok(0) => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the other end closed the connection")),
            Err(error) if is_wait(&error) => Ok(0),
            result => result,
        }
    }

    /// Writes everything, or fails when that takes too long.
    pub fn write_all(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let started = std::time::Instant::now();
        while !bytes.is_empty() {
            let result = match self {
                Self::Serial(port) => port.write(bytes),
                Self::Tcp(stream) => stream.write(bytes),
            };
            match result {
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(error) if is_wait(&error) && started.elapsed() < WRITE_TIME => {}
                Err(error) if is_wait(&error) => {
                    return Err(io::Error::new(io::ErrorKind::TimedOut, "the device does not accept data"));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

fn is_wait(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

/// The reason behind serialport's error, which distinguishes a busy port from a missing one only by its text.
fn reason(port: &str, error: &serialport::Error) -> DeviceError {
    use serialport::ErrorKind;
    let port = port.to_string();
    match error.kind() {
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => DeviceError::Permission { port },
        ErrorKind::Io(io::ErrorKind::NotFound) => DeviceError::Missing { port },
        ErrorKind::Io(io::ErrorKind::WouldBlock | io::ErrorKind::ResourceBusy) => DeviceError::Busy { port },
        ErrorKind::NoDevice if !cfg!(windows) && !Path::new(&port).exists() => DeviceError::Missing { port },
        ErrorKind::NoDevice => DeviceError::Busy { port },
        _ => {
            // ENOTTY, in the wording of either C library.
            let no_terminal =
                ["Not a typewriter", "Inappropriate ioctl for device"].contains(&error.description.as_str());
            let reason = if no_terminal { "it is not a serial port".into() } else { error.description.clone() };
            DeviceError::Open { port, reason }
        }
    }
}

#[cfg(test)]
mod tests {
    use serialport::{Error, ErrorKind};

    use super::*;

    #[test]
    fn the_reason_that_a_port_cannot_be_opened_is_told_apart() {
        let said = |port: &str, kind| reason(port, &Error::new(kind, "words")).to_string();
        let denied = said("/dev/ttyACM0", ErrorKind::Io(io::ErrorKind::PermissionDenied));
        assert_eq!(denied, "the port /dev/ttyACM0 cannot be opened: permission denied");
        let missing = "the port /dev/not-there does not exist";
        assert_eq!(said("/dev/not-there", ErrorKind::Io(io::ErrorKind::NotFound)), missing);
        let busy = "the port . cannot be opened: another program has it open";
        assert_eq!(said(".", ErrorKind::NoDevice), busy);
        assert_eq!(said(".", ErrorKind::Io(io::ErrorKind::WouldBlock)), busy);
        assert_eq!(said(".", ErrorKind::Unknown), "the port . cannot be opened: words");
    }

    #[test]
    fn a_permission_that_is_missing_is_got_from_the_group_dialout() {
        let help = miette::Diagnostic::help(&DeviceError::Permission { port: "p".into() }).map(|help| help.to_string());
        assert!(help.is_some_and(|help| help.contains("usermod -a -G dialout")));
    }
}
