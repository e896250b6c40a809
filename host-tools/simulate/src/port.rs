//! The device's end of the link: a TCP port or pseudo-terminal for a simulated device. Never blocks.

use std::io;
#[cfg(unix)]
use std::io::{Read, Write};

use crate::{error::SimulateError, share::Share};

/// The device's end.
pub enum Port {
    /// A TCP port for several hosts.
    Tcp(Box<Share>),
    /// The device's side of a pseudo-terminal.
    #[cfg(unix)]
    Pty {
        /// The device's side.
        master: std::fs::File,
    },
}

impl Port {
    /// Listens on `address`, e.g. `127.0.0.1:7878`; also returns the address with the actual port number.
    pub fn tcp(address: &str) -> Result<(Self, String), SimulateError> {
        let failed = |source| SimulateError::Endpoint { what: format!("the TCP port {address}"), source };
        let share = Share::controlled(address).map_err(failed)?;
        let address = share.address().map_err(failed)?.to_string();
        Ok((Self::Tcp(Box::new(share)), address))
    }

    /// Opens a pseudo-terminal; also returns the name of the host's side.
    #[cfg(unix)]
    pub fn pty() -> Result<(Self, String), SimulateError> {
        let failed = |source: rustix::io::Errno| SimulateError::Endpoint {
            what: "a pseudo-terminal".into(),
            source: source.into(),
        };
        use rustix::{fs, io, pty, termios};
        let master = pty::openpt(pty::OpenptFlags::RDWR | pty::OpenptFlags::NOCTTY).map_err(failed)?;
        // Separately, because macOS has no flag for it.
        io::fcntl_setfd(&master, io::FdFlags::CLOEXEC).map_err(failed)?;
        pty::grantpt(&master).map_err(failed)?;
        pty::unlockpt(&master).map_err(failed)?;
        let name = pty::ptsname(&master, Vec::new()).map_err(failed)?;
        let name = name.to_string_lossy().into_owned();
        // Raw mode, so that nothing is echoed or translated even for a host that sets nothing itself. Opening and
        // closing the host's side once also makes the terminal report from the start that no host is connected.
        let host = fs::open(name.as_str(), fs::OFlags::RDWR | fs::OFlags::NOCTTY, fs::Mode::empty()).map_err(failed)?;
        let mut settings = termios::tcgetattr(&host).map_err(failed)?;
        settings.make_raw();
        termios::tcsetattr(&host, termios::OptionalActions::Now, &settings).map_err(failed)?;
        let before = fs::fcntl_getfl(&master).map_err(failed)?;
        fs::fcntl_setfl(&master, before | fs::OFlags::NONBLOCK).map_err(failed)?;
        Ok((Self::Pty { master: std::fs::File::from(master) }, name))
    }

    /// Reads the available bytes; `WouldBlock` if there are none, `NotConnected` if no host has the pseudo-terminal
    /// open.
    pub fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(share) => match share.requests(into) {
                0 => Err(io::ErrorKind::WouldBlock.into()),
                count => Ok(count),
            },
            #[cfg(unix)]
            Self::Pty { master } => match master.read(into) {
                Err(error) if error.kind() != io::ErrorKind::WouldBlock => Err(io::ErrorKind::NotConnected.into()),
                result => result,
            },
        }
    }

    /// Writes what fits; `WouldBlock` if nothing does, `NotConnected` if no host has the pseudo-terminal open.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(share) if share.is_full() => Err(io::ErrorKind::WouldBlock.into()),
            Self::Tcp(share) => {
                share.relay(bytes);
                Ok(bytes.len())
            }
            #[cfg(unix)]
            Self::Pty { master } => {
                use rustix::event::{PollFd, PollFlags, Timespec, poll};
                let mut fds = [PollFd::new(master, PollFlags::OUT)];
                poll(&mut fds, Some(&Timespec::default()))?;
                let [state] = fds.map(|fd| fd.revents());
                if state.contains(PollFlags::HUP) {
                    Err(io::ErrorKind::NotConnected.into())
                } else {
                    master.write(bytes)
                }
            }
        }
    }

    /// Serves the hosts apart from reads and writes. Must be called often.
    pub fn turn(&mut self) {
        match self {
            Self::Tcp(share) => share.turn(),
            #[cfg(unix)]
            Self::Pty { .. } => {}
        }
    }
}
