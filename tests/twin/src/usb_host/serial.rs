//! The serial port that the host's CDC driver provides for the device.
//!
//! As in Linux's `cdc_acm`, sixteen reads of two packets each are queued on the bulk endpoint while the port is open,
//! and none while it is closed. Data that the device sends after a close therefore waits in its endpoint for the next
//! open.

use super::{Carried, Setup, Socket, Transfer, UsbError, UsbHost};
use std::collections::VecDeque;

/// SET_LINE_CODING (CDC PSTN 1.2 6.3.10).
const SET_LINE_CODING: u8 = 0x20;
/// GET_LINE_CODING (CDC PSTN 1.2 6.3.11).
const GET_LINE_CODING: u8 = 0x21;
/// SET_CONTROL_LINE_STATE (CDC PSTN 1.2 6.3.12).
const SET_CONTROL_LINE_STATE: u8 = 0x22;
/// Number of queued reads, and the size of each \[bytes\] (Linux: ACM_NR, `acm->readsize`).
const READS: usize = 16;
const READ_BYTES: usize = 128;

/// An open port. Close it, or its reads stay queued.
#[derive(Debug)]
pub struct SerialPort {
    to_device: u8,
    to_host: u8,
    reads: VecDeque<u64>,
    /// Received, not yet returned.
    received: Vec<u8>,
}

impl SerialPort {
    /// Opens the port of an enumerated device: 115200 baud 8N1, DTR and RTS set.
    pub fn open(host: &mut UsbHost, socket: &mut impl Socket) -> Carried<Self> {
        let (to_device, to_host) = host.description.as_ref().ok_or(UsbError::Detached)?.serial_endpoints()?;
        let reads = (0..READS).map(|_| host.submit(Transfer::In(to_host, READ_BYTES))).collect();
        let port = Self { to_device, to_host, reads, received: Vec::new() };
        set_line_coding(host, socket, 115_200)?;
        set_control_lines(host, socket, true, true)?;
        Ok(port)
    }

    /// Clears DTR and RTS and cancels the reads, in Linux's order.
    pub fn close(mut self, host: &mut UsbHost, socket: &mut impl Socket) -> Carried {
        let result = set_control_lines(host, socket, false, false);
        self.stop_reading(host);
        result
    }

    /// Cancels the reads, as when the program no longer reads. Data that the device then sends waits in its endpoint.
    pub fn stop_reading(&mut self, host: &mut UsbHost) {
        for number in self.reads.drain(..) {
            host.cancel(number);
        }
    }

    /// All bytes that arrive within a time.
    pub fn receive(&mut self, host: &mut UsbHost, socket: &mut impl Socket, for_s: f64) -> Carried<Vec<u8>> {
        let end_s = socket.time_s() + for_s;
        self.collect(host)?;
        while socket.time_s() < end_s {
            host.service(socket)?;
            self.collect(host)?;
        }
        Ok(std::mem::take(&mut self.received))
    }

    /// Sends bytes within a time; returns how many the device accepted. No empty packet follows full ones, as Linux
    /// sends none. Bytes that arrive meanwhile are kept for [`receive`](Self::receive).
    pub fn send(
        &mut self,
        host: &mut UsbHost,
        socket: &mut impl Socket,
        bytes: &[u8],
        within_s: f64,
    ) -> (usize, Carried) {
        let transfer = Transfer::Out(self.to_device, bytes.to_vec(), false);
        let done = host.wait_for(socket, transfer, within_s, |host| self.collect(host));
        (done.moved, done.result.map(|_| ()))
    }

    /// Collects the data of finished reads and queues new ones.
    fn collect(&mut self, host: &mut UsbHost) -> Carried {
        while let Some(done) = self.reads.front().and_then(|first| host.take_done(*first)) {
            self.reads.pop_front();
            self.received.extend(done.result?);
            self.reads.push_back(host.submit(Transfer::In(self.to_host, READ_BYTES)));
        }
        Ok(())
    }
}

/// SET_LINE_CODING with 8 data bits, no parity, one stop bit.
pub fn set_line_coding(host: &mut UsbHost, socket: &mut impl Socket, baud: u32) -> Carried {
    let [b0, b1, b2, b3] = baud.to_le_bytes();
    let setup = Setup { kind: 0x21, request: SET_LINE_CODING, value: 0, index: 0, length: 7 };
    host.control(socket, setup, &[b0, b1, b2, b3, 0, 0, 8]).map(|_| ())
}

/// GET_LINE_CODING; returns the data from the device.
pub fn line_coding(host: &mut UsbHost, socket: &mut impl Socket) -> Carried<Vec<u8>> {
    let setup = Setup { kind: 0xA1, request: GET_LINE_CODING, value: 0, index: 0, length: 7 };
    host.control(socket, setup, &[])
}

/// SET_CONTROL_LINE_STATE.
pub fn set_control_lines(
    host: &mut UsbHost,
    socket: &mut impl Socket,
    terminal_ready: bool,
    request_to_send: bool,
) -> Carried {
    let value = u16::from(terminal_ready) | u16::from(request_to_send) << 1;
    host.order(socket, 0x21, SET_CONTROL_LINE_STATE, value, 0)
}
