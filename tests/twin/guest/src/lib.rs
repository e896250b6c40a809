//! Protocol between a test and the Linux guest that it started.
//!
//! The guest has a network, and its init program connects to the test ([`serve`]). The test then sends shell commands
//! one at a time and receives the exit code and the output of each ([`Guest`]).
//!
//! A request is a length and a command line. A reply is an exit code, then standard output and standard error, each
//! with its length. Numbers are four bytes, big-endian.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Limit on a length, above that of any command or output.
const MOST_BYTES: u32 = 64 << 20;
/// Polling interval while waiting for the guest to connect.
const LOOK: Duration = Duration::from_millis(20);

/// Result of a command.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ended {
    /// Exit code; 128 plus the signal number if a signal killed the command.
    pub code: i32,
    /// Standard output.
    pub output: Vec<u8>,
    /// Standard error.
    pub errors: String,
}

impl Ended {
    /// Standard output as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.output).into_owned()
    }
}

/// The test's end of the connection.
pub struct Guest {
    stream: TcpStream,
}

impl Guest {
    /// Waits for the guest to connect. Gives up when `alive` returns false, or after `within`.
    pub fn accept(listener: &TcpListener, within: Duration, mut alive: impl FnMut() -> bool) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let start = Instant::now();
        loop {
            match listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(false)?;
                    stream.set_nodelay(true)?;
                    return Ok(Self { stream });
                }
                Err(error) if error.kind() != ErrorKind::WouldBlock => return Err(error),
                Err(_) if !alive() => {
                    return Err(io::Error::new(ErrorKind::BrokenPipe, "the guest exited before it connected"));
                }
                Err(_) if start.elapsed() > within => {
                    return Err(io::Error::new(ErrorKind::TimedOut, "the guest did not connect in time"));
                }
                Err(_) => std::thread::sleep(LOOK),
            }
        }
    }

    /// Runs a command line in the guest's shell; `within` is the timeout.
    pub fn run(&mut self, command: &str, within: Duration) -> io::Result<Ended> {
        self.stream.set_read_timeout(Some(within))?;
        write_bytes(&mut self.stream, command.as_bytes())?;
        let code = read_number(&mut self.stream)? as i32;
        let output = read_bytes(&mut self.stream)?;
        let errors = String::from_utf8_lossy(&read_bytes(&mut self.stream)?).into_owned();
        Ok(Ended { code, output, errors })
    }
}

/// The guest's end: runs the commands that the test sends until the test disconnects.
pub fn serve(test: SocketAddr) -> io::Result<()> {
    let mut stream = TcpStream::connect(test)?;
    stream.set_nodelay(true)?;
    loop {
        let command = match read_bytes(&mut stream) {
            Ok(command) => command,
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            Err(error) => return Err(error),
        };
        let ended = shell(&String::from_utf8_lossy(&command));
        stream.write_all(&ended.code.to_be_bytes())?;
        write_bytes(&mut stream, &ended.output)?;
        write_bytes(&mut stream, ended.errors.as_bytes())?;
    }
}

fn shell(command: &str) -> Ended {
    match Command::new("/bin/sh").args(["-c", command]).stdin(Stdio::null()).output() {
        Ok(done) => {
            #[cfg(unix)]
            let signal = std::os::unix::process::ExitStatusExt::signal(&done.status);
            #[cfg(not(unix))]
            let signal: Option<i32> = None;
            Ended {
                code: done.status.code().unwrap_or(128 + signal.unwrap_or(0)),
                output: done.stdout,
                errors: String::from_utf8_lossy(&done.stderr).into_owned(),
            }
        }
        Err(error) => Ended { code: 127, output: Vec::new(), errors: error.to_string() },
    }
}

fn write_bytes(stream: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
    stream.write_all(&(bytes.len() as u32).to_be_bytes())?;
    stream.write_all(bytes)
}

fn read_number(stream: &mut impl Read) -> io::Result<u32> {
    let mut number = [0; 4];
    stream.read_exact(&mut number)?;
    Ok(u32::from_be_bytes(number))
}

fn read_bytes(stream: &mut impl Read) -> io::Result<Vec<u8>> {
    let length = read_number(stream)?;
    if length > MOST_BYTES {
        return Err(io::Error::new(ErrorKind::InvalidData, "more bytes than allowed"));
    }
    let mut bytes = vec![0; length as usize];
    stream.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// USB/IP client in the guest: attaches a server's device to this kernel.
pub mod usbip {
    use std::io::{self, ErrorKind, Read, Write};
    use std::net::{SocketAddr, TcpStream};

    /// `OP_REQ_IMPORT` of USB/IP 1.1.1 for the device "1-1".
    const IMPORT: [u8; 11] = *b"\x01\x11\x80\x03\0\0\0\x001-1";
    /// Length of the request, and of the two parts of the reply \[bytes\].
    const QUESTION: usize = 40;
    const HEAD: usize = 8;
    const DEVICE: usize = 312;
    /// Offset of bus, device number and speed in the second part of the reply.
    const NUMBERS: usize = 256 + 32;
    /// Number of full-speed ports of Linux's virtual host controller.
    const PORTS: u32 = 8;

    fn number(bytes: &[u8], at: usize) -> u32 {
        bytes.get(at..at + 4).and_then(|four| four.try_into().ok()).map_or(0, u32::from_be_bytes)
    }

    /// Imports a server's device; returns the connection, and the device's bus, number and speed.
    pub fn import(server: SocketAddr) -> io::Result<(TcpStream, [u32; 3])> {
        let mut stream = TcpStream::connect(server)?;
        stream.set_nodelay(true)?;
        let mut question = IMPORT.to_vec();
        question.resize(QUESTION, 0);
        stream.write_all(&question)?;
        let mut head = [0; HEAD];
        stream.read_exact(&mut head)?;
        match number(&head, 4) {
            0 => {}
            2 => return Err(io::Error::new(ErrorKind::ResourceBusy, "another client has the device")),
            status => return Err(io::Error::other(format!("the server refused: status {status}"))),
        }
        let mut device = [0; DEVICE];
        stream.read_exact(&mut device)?;
        Ok((stream, [0, 4, 8].map(|at| number(&device, NUMBERS + at))))
    }

    /// Passes the connection to the kernel, on the first free port; returns the port.
    #[cfg(unix)]
    pub fn attach(server: SocketAddr) -> io::Result<u32> {
        use std::os::fd::AsRawFd;
        let (stream, [bus, device, speed]) = import(server)?;
        let mut last = io::Error::other("no port of the virtual host controller is free");
        for port in 0..PORTS {
            let line = format!("{port} {} {} {speed}", stream.as_raw_fd(), bus << 16 | device);
            match std::fs::write("/sys/devices/platform/vhci_hcd.0/attach", line) {
                Ok(()) => return Ok(port),
                Err(error) => last = error,
            }
        }
        Err(last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guest_that_ends_before_it_calls_is_not_waited_for() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let error = Guest::accept(&listener, Duration::from_secs(60), || false).err().expect("no guest connects");
        assert_eq!(error.kind(), ErrorKind::BrokenPipe);
    }

    #[test]
    fn a_server_that_is_busy_says_so() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = listener.local_addr().expect("bound");
        let server = std::thread::spawn(move || -> io::Result<Vec<u8>> {
            let (mut stream, _) = listener.accept()?;
            let mut question = vec![0; 40];
            stream.read_exact(&mut question)?;
            stream.write_all(b"\x01\x11\0\x03\0\0\0\x02")?;
            Ok(question)
        });
        let error = usbip::import(address).expect_err("the server is busy");
        assert_eq!(error.kind(), ErrorKind::ResourceBusy);
        let question = server.join().expect("no panic").expect("a request");
        assert_eq!(question[..12], *b"\x01\x11\x80\x03\0\0\0\x001-1\0");
    }
}
