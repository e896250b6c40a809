//! A USB/IP server for Linux's `vhci_hcd`, which makes the device available over the network.
//!
//! [`Server::turn`] advances everything by one step: connections, packets, device time. [`Server::run`] keeps device
//! time in step with wall-clock time, because the client's kernel uses the latter. A kernel in an emulator may be too
//! slow for that: while it has no read pending on an endpoint that it reads, device time stands still, for a second at
//! most.
//!
//! The client's kernel acts as the host's drivers, [`UsbHost`] as its host controller. An import connects the cable;
//! the end of the connection disconnects it. Linux does not forward its bus reset and SET_ADDRESS to the server, which
//! therefore does both before the first command. Suspend and resume stay with the client.

mod protocol;

use crate::usb_host::{Carried, Description, Socket, Transfer, UsbError, UsbHost};
use protocol::{Foreign, Refusal, Request};
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Maximum lead of device time over wall-clock time.
const AHEAD: Duration = Duration::from_millis(1);
/// A lag above this is not caught up.
const BEHIND: Duration = Duration::from_millis(50);
/// Pause while device time leads.
const NAP: Duration = Duration::from_micros(300);
/// A client without a pending read for this long has stopped reading. Until then its other transfers wait, too.
const READ_TIME: Duration = Duration::from_secs(1);
/// A client that accepts no data for this long is disconnected.
const WRITE_TIME: Duration = Duration::from_secs(5);

/// Linux error numbers, as sent in replies.
mod errno {
    pub const BROKEN_PIPE: i32 = -32;
    pub const PROTOCOL: i32 = -71;
    pub const OVERFLOW: i32 = -75;
    pub const RESET: i32 = -104;
    pub const SHUT_DOWN: i32 = -108;
}

/// A connection.
struct Client {
    stream: TcpStream,
    bytes: Vec<u8>,
    /// Whether it has imported the device.
    owner: bool,
}

/// A client's transfer.
struct Pending {
    /// The client's number for it.
    sequence: u32,
    /// Whether the device sends.
    to_host: bool,
    /// The endpoint that is read; none for control transfers, which come one at a time, and for writes.
    reads: Option<u8>,
}

/// Reason for the end of a connection.
enum Over {
    /// The client closed the connection, or it broke.
    Gone,
    /// The data does not follow the protocol.
    Foreign,
    /// The device's simulation ended.
    Device(UsbError),
}

impl From<io::Error> for Over {
    fn from(_: io::Error) -> Self {
        Self::Gone
    }
}

impl From<Foreign> for Over {
    fn from(_: Foreign) -> Self {
        Self::Foreign
    }
}

/// Counters of the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Imports granted.
    pub imports: u32,
    /// Imports refused because another client had the device.
    pub busy: u32,
    /// Completed transfers.
    pub transfers: u64,
    /// Cancelled transfers.
    pub unlinked: u64,
    /// Connections closed because of data that does not follow the protocol.
    pub foreign: u32,
}

/// A server of one device, for one client at a time.
pub struct Server<S> {
    /// The device.
    pub socket: S,
    /// Counters since the start.
    pub counts: Counts,
    host: UsbHost,
    listener: TcpListener,
    clients: Vec<Client>,
    /// The host's transfers by number.
    transfers: BTreeMap<u64, Pending>,
    /// Endpoints that the client reads, without a pending read since then.
    starved: BTreeMap<u8, Instant>,
    description: Option<Description>,
}

impl<S: Socket> Server<S> {
    /// Serves a device on a free loopback port. The device is powered, with its cable disconnected.
    pub fn new(socket: S) -> io::Result<Self> {
        let listener = TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0))?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            socket,
            counts: Counts::default(),
            host: UsbHost::default(),
            listener,
            clients: Vec::new(),
            transfers: BTreeMap::new(),
            starved: BTreeMap::new(),
            description: None,
        })
    }

    /// The address of its listening socket.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Whether a client has imported the device.
    pub fn is_imported(&self) -> bool {
        self.clients.iter().any(|client| client.owner)
    }

    /// Disconnects the cable and the client that has imported the device.
    pub fn unplug(&mut self) {
        self.clients.retain(|client| !client.owner);
        self.release();
    }

    /// Serves until `over` returns true, with device time in step with wall-clock time.
    pub fn run(&mut self, mut over: impl FnMut(&mut Self) -> bool) -> Carried {
        let mut start = (Instant::now(), self.socket.time_s());
        while !over(self) {
            self.hear_all()?;
            if self.stands_still(Instant::now()) {
                std::thread::sleep(NAP);
                continue;
            }
            self.serve()?;
            let lived = Duration::from_secs_f64((self.socket.time_s() - start.1).max(0.0));
            let passed = start.0.elapsed();
            if lived > passed + AHEAD {
                std::thread::sleep(NAP);
            } else if passed > lived + BEHIND {
                start = (Instant::now(), self.socket.time_s());
            }
        }
        Ok(())
    }

    fn stands_still(&self, now: Instant) -> bool {
        self.starved.values().any(|&since| now.duration_since(since) < READ_TIME)
    }

    /// One step: new connections, their data, one packet of each transfer, completed transfers.
    pub fn turn(&mut self) -> Carried {
        self.hear_all()?;
        self.serve()
    }

    fn hear_all(&mut self) -> Carried {
        self.accept();
        let mut index = 0;
        while index < self.clients.len() {
            let Some(over) = self.hear(index).err() else {
                index += 1;
                continue;
            };
            let client = self.clients.remove(index);
            match over {
                Over::Gone => {}
                Over::Foreign => self.counts.foreign += 1,
                Over::Device(error) => return Err(error),
            }
            if client.owner {
                self.release();
            }
        }
        Ok(())
    }

    fn serve(&mut self) -> Carried {
        self.host.service(&mut self.socket)?;
        self.return_done();
        // A device that disables its pull-up looks unplugged to the hub.
        if self.is_imported() && !self.socket.usb().attached() {
            self.unplug();
        }
        Ok(())
    }

    fn accept(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            let ready = stream
                .set_nodelay(true)
                .and_then(|()| stream.set_nonblocking(true))
                .and_then(|()| stream.set_write_timeout(Some(WRITE_TIME)));
            if ready.is_ok() {
                self.clients.push(Client { stream, bytes: Vec::new(), owner: false });
            }
        }
    }

    /// Reads data from a client and executes its requests.
    fn hear(&mut self, index: usize) -> Result<(), Over> {
        self.clients[index].read()?;
        loop {
            let Client { bytes, owner, .. } = &mut self.clients[index];
            let request = if *owner { protocol::take_command(bytes) } else { protocol::take_question(bytes) };
            let Some(request) = request? else { return Ok(()) };
            self.answer(index, request)?;
        }
    }

    fn answer(&mut self, index: usize, request: Request) -> Result<(), Over> {
        let reply = match request {
            Request::List => {
                if self.description.is_none() {
                    self.plug().map_err(Over::Device)?;
                    self.release();
                }
                protocol::list(self.description.as_ref())
            }
            Request::Import(name) if name != protocol::BUS_NAME => return self.refuse(index, Refusal::NoDevice),
            Request::Import(_) if self.is_imported() => {
                self.counts.busy += 1;
                return self.refuse(index, Refusal::Busy);
            }
            Request::Import(_) => {
                self.plug().map_err(Over::Device)?;
                let Some(description) = self.description.as_ref() else {
                    return self.refuse(index, Refusal::NoDevice);
                };
                self.clients[index].owner = true;
                self.counts.imports += 1;
                protocol::imported(Ok(description))
            }
            Request::Submit { sequence, to_host, transfer } => {
                let reads = if let Transfer::In(endpoint, _) = transfer { Some(endpoint) } else { None };
                if let Some(endpoint) = reads {
                    self.starved.remove(&endpoint);
                }
                let number = self.host.submit(transfer);
                self.transfers.insert(number, Pending { sequence, to_host, reads });
                return Ok(());
            }
            Request::Unlink { sequence, other } => {
                let number = self.transfers.iter().find(|(_, pending)| pending.sequence == other);
                let number = number.map(|(number, _)| *number);
                let cancelled = number.and_then(|number| {
                    self.transfers.remove(&number);
                    self.host.cancel(number)
                });
                self.counts.unlinked += u64::from(cancelled.is_some());
                // The reply to a completed transfer has already been sent.
                let status = if cancelled.is_some() { errno::RESET } else { 0 };
                protocol::unlinked(sequence, status)
            }
        };
        self.clients[index].write(&reply)
    }

    fn refuse(&mut self, index: usize, refusal: Refusal) -> Result<(), Over> {
        self.clients[index].write(&protocol::imported(Err(refusal)))?;
        Err(Over::Gone)
    }

    /// Connects and enumerates the device, then resets it and sets only its address. `description` is none if that
    /// fails.
    fn plug(&mut self) -> Carried {
        let host = &mut self.host;
        let ready = host.connect(&mut self.socket).and_then(|description| {
            host.reset(&mut self.socket)?;
            host.set_address(&mut self.socket)?;
            Ok(description)
        });
        match ready {
            Ok(description) => self.description = Some(description),
            Err(error @ UsbError::Stopped(_)) => return Err(error),
            Err(_) => self.description = None,
        }
        Ok(())
    }

    fn release(&mut self) {
        self.host.unplug(&mut self.socket);
        while self.host.next_done().is_some() {}
        self.transfers.clear();
        self.starved.clear();
    }

    /// Sends the replies to completed transfers. A broken connection is detected at the next read.
    fn return_done(&mut self) {
        while let Some(done) = self.host.next_done() {
            let Some(Pending { sequence, to_host, reads }) = self.transfers.remove(&done.number) else { continue };
            self.counts.transfers += 1;
            let was_last = !self.transfers.values().any(|pending| pending.reads == reads);
            if let Some(endpoint) = reads.filter(|_| was_last && done.result.is_ok()) {
                self.starved.insert(endpoint, Instant::now());
            }
            let answer = match done.result {
                Ok(data) if to_host => protocol::submitted(sequence, 0, data.len(), &data),
                Ok(_) => protocol::submitted(sequence, 0, done.moved, &[]),
                Err(error) => protocol::submitted(sequence, status(&error), if to_host { 0 } else { done.moved }, &[]),
            };
            if let Some(client) = self.clients.iter_mut().find(|client| client.owner)
                && client.write(&answer).is_err()
            {
                let _ = client.stream.shutdown(std::net::Shutdown::Both);
            }
        }
    }
}

impl Client {
    fn read(&mut self) -> Result<(), Over> {
        let mut portion = [0; 4096];
        loop {
            match self.stream.read(&mut portion) {
                Ok(0) => return Err(Over::Gone),
                Ok(count) => self.bytes.extend_from_slice(&portion[..count]),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Over> {
        self.stream.set_nonblocking(false)?;
        self.stream.write_all(bytes)?;
        self.stream.set_nonblocking(true)?;
        Ok(())
    }
}

/// Linux's error number.
fn status(error: &UsbError) -> i32 {
    match error {
        UsbError::Stalled => errno::BROKEN_PIPE,
        UsbError::TooMuch => errno::OVERFLOW,
        UsbError::Detached => errno::SHUT_DOWN,
        _ => errno::PROTOCOL,
    }
}

#[cfg(test)]
mod tests;
