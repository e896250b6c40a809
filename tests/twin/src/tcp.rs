//! A board's serial port over TCP, as the host's programs reach it with `--connect ADDRESS`.
//!
//! The board is connected by USB, and its port is forwarded to one client at a time. A connection plugs the board in
//! and opens its port; its end unplugs the board. A restart closes the connection, as it would remove a port.

use crate::usb_host::{Carried, Socket, UsbError};
use crate::usb_link::UsbLink;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Step of the device's time \[s\].
const STEP_S: f64 = 1e-3;
/// What the device does not take within this time is dropped, as by a driver that gives up \[s\].
const SEND_S: f64 = 0.1;

/// A free loopback port on which [`serve`] can listen.
pub fn listener() -> io::Result<TcpListener> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves a device, unplugged so far, until `over` returns true, and unplugs it.
///
/// While a client is connected, the device's time runs at wall-clock speed, or slower on a slow computer, but never
/// faster: the client would have less time than with a real device. Time that is lost is not caught up. The device's
/// time stands still once a client that reads nothing has filled its buffers. Without a client it runs as fast as it
/// can.
///
/// # Errors
///
/// The device's simulation ended.
pub fn serve<S: Socket>(link: &mut UsbLink<S>, listener: &TcpListener, mut over: impl FnMut() -> bool) -> Carried {
    let mut client: Option<TcpStream> = None;
    while !over() {
        let (begun, begun_s) = (Instant::now(), link.socket.time_s());
        client = match client.take() {
            Some(stream) => turn(link, stream, &mut over),
            None => accept(link, listener),
        };
        if client.is_none() {
            link.unplug();
            link.socket.run_for(STEP_S).map_err(UsbError::Stopped)?;
            continue;
        }
        let lived = Duration::from_secs_f64(link.socket.time_s() - begun_s);
        std::thread::sleep(lived.saturating_sub(begun.elapsed()));
    }
    link.unplug();
    Ok(())
}

/// Connects the device's port for a new client.
fn accept<S: Socket>(link: &mut UsbLink<S>, listener: &TcpListener) -> Option<TcpStream> {
    let (stream, _) = listener.accept().ok()?;
    stream.set_nonblocking(true).ok()?;
    link.plug_in().ok()?;
    Some(stream)
}

/// Forwards both directions for a moment. `None` if either end has gone.
fn turn<S: Socket>(link: &mut UsbLink<S>, mut stream: TcpStream, over: &mut impl FnMut() -> bool) -> Option<TcpStream> {
    let mut portion = [0; 4096];
    match stream.read(&mut portion) {
        Ok(0) => return None,
        Ok(count) => {
            link.send(&portion[..count], SEND_S).ok()?;
        }
        Err(error) if error.kind() == ErrorKind::WouldBlock => {}
        Err(_) => return None,
    }
    let bytes = link.receive(STEP_S).ok()?;
    let mut rest = &bytes[..];
    while !rest.is_empty() {
        match stream.write(rest) {
            Ok(count) => rest = &rest[count..],
            Err(error) if error.kind() == ErrorKind::WouldBlock && !over() => {
                std::thread::sleep(Duration::from_millis(1));
            }
            Err(_) => return None,
        }
    }
    Some(stream)
}
