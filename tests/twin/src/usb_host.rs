//! The USB host, for tests of the device.
//!
//! [`UsbHost`] acts as a host controller and its drivers: it powers the device, sends SOF packets, enumerates the
//! device, and carries out transfers packet by packet while bus time passes. [`Socket`] is the device with its cable.
//! Every method that lets time pass takes the socket, so a test can inspect the device between calls.
//!
//! - *transfer*: a driver's request: a control request, or bytes to or from an endpoint. The host divides it into
//!   packets.
//! - *short packet*: a packet below the endpoint's maximum size, possibly empty. It ends a transfer to the host. If a
//!   multiple of 64 bytes is not followed by one, the data stays in the host and the reader does not get it.
//!
//! All times are device times, in seconds. Source: USB 2.0, chapters 5, 8 and 9; CDC PSTN 1.2, 6.3.

use crate::chip::usb::{Answer, Toggle, Usb};
use std::collections::VecDeque;

mod descriptors;
pub mod serial;

pub use descriptors::{Description, DescriptorError, Endpoint};

/// A device at the end of a cable.
pub trait Socket {
    /// The USB peripheral, advanced to the current time.
    fn usb(&mut self) -> &mut Usb;
    /// Seconds since power-on.
    fn time_s(&mut self) -> f64;
    /// Lets time pass; an error ends the run.
    fn run_for(&mut self, time_s: f64) -> Result<(), String>;
    /// Switches VBUS on or off.
    fn set_supply(&mut self, on: bool);
}

/// Maximum packet size of bulk endpoints at full speed, and upper limit for control endpoints.
const FULL_PACKET: usize = 64;
/// Interval of the SOF packets.
const FRAME_S: f64 = 1e-3;
/// Address that the host assigns.
const ADDRESS: u8 = 9;
/// Time from connection to bus reset (USB 2.0 7.1.7.3).
const DEBOUNCE_S: f64 = 0.1;
/// Duration of a bus reset and the recovery after it (USB 2.0 7.1.7.5).
const RESET_S: f64 = 0.02;
/// Recovery time after SET_ADDRESS (USB 2.0 9.2.6.3).
const SET_ADDRESS_S: f64 = 0.002;
/// Duration of resume signalling and the recovery after it (USB 2.0 7.1.7.7).
const RESUME_S: f64 = 0.03;
/// Idle time that suspends the device (USB 2.0 7.1.7.6: after 3 ms, before 10 ms).
const SUSPEND_S: f64 = 0.01;
/// The host gives up on a device whose pull-up does not appear within this time.
const ATTACH_S: f64 = 1.0;
/// Timeout of a control request (Linux: USB_CTRL_GET_TIMEOUT).
pub const CONTROL_S: f64 = 5.0;
/// Pause after a round without progress; doubled after each further one, up to [`LONGEST_PAUSE_S`].
const PAUSE_S: f64 = 40e-6;
/// Maximum pause, for a host that also has other work.
const LONGEST_PAUSE_S: f64 = 160e-6;
/// Consecutive packets without a response after which a transfer fails (USB 2.0 8.7: three).
const STRIKES: u32 = 3;

/// Why a transfer, or the bus, failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// The endpoint is stalled.
    #[error("the device refused the request (STALL)")]
    Stalled,
    /// No response to three packets.
    #[error("the device does not respond")]
    Silent,
    /// More data than requested.
    #[error("the device sent more data than requested")]
    TooMuch,
    /// Timeout.
    #[error("timed out")]
    Late,
    /// No device is connected.
    #[error("no device is attached")]
    Detached,
    /// The device's descriptors are wrong.
    #[error("{0}")]
    Descriptor(#[from] DescriptorError),
    /// The device's simulation ended.
    #[error("the device stopped: {0}")]
    Stopped(String),
}

/// The result of an action on the bus, or the reason why it failed.
pub type Carried<T = ()> = Result<T, UsbError>;

/// A control request (USB 2.0 9.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// bmRequestType: direction, type, recipient.
    pub kind: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex: interface, endpoint or language.
    pub index: u16,
    /// wLength: bytes of data.
    pub length: u16,
}

impl Setup {
    /// The setup packet.
    pub fn bytes(&self) -> [u8; 8] {
        let ([v0, v1], [i0, i1]) = (self.value.to_le_bytes(), self.index.to_le_bytes());
        let [l0, l1] = self.length.to_le_bytes();
        [self.kind, self.request, v0, v1, i0, i1, l0, l1]
    }

    /// Decodes a setup packet.
    pub fn from_bytes(bytes: [u8; 8]) -> Self {
        let [kind, request, v0, v1, i0, i1, l0, l1] = bytes;
        let word = |low, high| u16::from_le_bytes([low, high]);
        Self { kind, request, value: word(v0, v1), index: word(i0, i1), length: word(l0, l1) }
    }

    /// Whether its data, if any, goes to the host.
    pub fn to_host(self) -> bool {
        self.kind & 0x80 != 0
    }
}

/// A driver's request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// A control request with the data for the device.
    Control(Setup, Vec<u8>),
    /// At most this many bytes from an endpoint; a short packet ends the transfer.
    In(u8, usize),
    /// Bytes to an endpoint; with `true`, an empty packet follows data that ends with a full packet.
    Out(u8, Vec<u8>, bool),
}

/// A finished transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Done {
    /// The number that [`UsbHost::submit`] gave.
    pub number: u64,
    /// The bytes from the device (empty for a transfer to it), or the error.
    pub result: Carried<Vec<u8>>,
    /// Bytes transferred, in either direction.
    pub moved: usize,
}

/// Part of a transfer. Only a control request has more than data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    Setup,
    #[default]
    Data,
    Status,
}

#[derive(Debug, Default)]
struct Running {
    number: u64,
    /// The control request.
    setup: Option<Setup>,
    stage: Stage,
    /// Whether the data goes to the host, and its maximum length.
    reads: bool,
    most: usize,
    /// Data for the device, and whether an empty packet follows if it ends with a full one.
    data: Vec<u8>,
    close: bool,
    received: Vec<u8>,
    sent: usize,
    strikes: u32,
}

/// Outcome of one packet.
enum Step {
    /// Progress; the transfer continues.
    Moved,
    /// No progress.
    Waits,
    /// The transfer has ended.
    Ends(Carried),
}

/// A queue of transfers: control, or one direction of one endpoint.
#[derive(Debug, Default)]
struct Pipe {
    queue: VecDeque<Running>,
    toggle: Toggle,
}

/// Index of a pipe: 0 control, 1 to 15 OUT, 17 to 31 IN.
const PIPES: usize = 32;
const TO_HOST: usize = 16;

/// The host; by default with nothing connected.
#[derive(Default)]
pub struct UsbHost {
    pipes: [Pipe; PIPES],
    done: VecDeque<Done>,
    next_number: u64,
    address: u8,
    supplied: bool,
    frames: bool,
    /// The descriptors of the last enumeration.
    pub description: Option<Description>,
    pause_s: f64,
    /// Maximum packet size of endpoint 0, once the device descriptor has given it.
    control_packet: Option<usize>,
}

impl UsbHost {
    // ---- cable and bus

    /// Connects the cable, waits for the device, and resets it.
    pub fn plug(&mut self, socket: &mut impl Socket) -> Carried {
        self.supplied = true;
        socket.set_supply(true);
        socket.usb().set_cable(true);
        let end_s = socket.time_s() + ATTACH_S;
        // Time since which the device has been attached; restarts when contact is lost, as in a brief unplug.
        let mut seen_s: Option<f64> = None;
        loop {
            let now_s = socket.time_s();
            seen_s = if socket.usb().attached() { seen_s.or(Some(now_s)) } else { None };
            if seen_s.is_some_and(|seen_s| now_s - seen_s >= DEBOUNCE_S) {
                break;
            }
            if now_s > end_s {
                return Err(UsbError::Detached);
            }
            run(socket, 1e-3)?;
        }
        self.reset(socket)
    }

    /// Disconnects the cable. Transfers in progress end with [`UsbError::Detached`].
    pub fn unplug(&mut self, socket: &mut impl Socket) {
        socket.set_supply(false);
        socket.usb().set_cable(false);
        self.supplied = false;
        self.lose(socket);
    }

    /// Resets the bus. The device then has address 0 and is not configured.
    pub fn reset(&mut self, socket: &mut impl Socket) -> Carried {
        self.fail_all(&UsbError::Silent);
        self.address = 0;
        self.description = None;
        self.check_attached(socket)?;
        socket.usb().bus_reset();
        socket.usb().start_frames(FRAME_S);
        self.frames = true;
        run(socket, RESET_S)
    }

    /// Stops all traffic long enough to suspend the device.
    pub fn suspend(&mut self, socket: &mut impl Socket) -> Carried {
        socket.usb().stop_frames();
        self.frames = false;
        run(socket, SUSPEND_S)
    }

    /// Resumes the device.
    pub fn resume(&mut self, socket: &mut impl Socket) -> Carried {
        self.check_attached(socket)?;
        socket.usb().resume();
        socket.usb().start_frames(FRAME_S);
        self.frames = true;
        run(socket, RESUME_S)
    }

    /// Assigns an address, reads the descriptors and configures the device, in Linux's order.
    pub fn enumerate(&mut self, socket: &mut impl Socket) -> Carried<Description> {
        // Byte 7 of the device descriptor is the maximum packet size. It is in the first packet, whatever the size.
        self.control_packet = None;
        let head = self.get_descriptor(socket, 1, 0, 0, 64)?;
        self.control_packet = Some(descriptors::control_packet(&head)?);
        self.reset(socket)?;
        self.set_address(socket)?;
        let device = self.get_descriptor(socket, 1, 0, 0, 18)?;
        // A USB 2.0 host asks for the device qualifier. A full-speed-only device stalls.
        match self.get_descriptor(socket, 6, 0, 0, 10) {
            Ok(_) | Err(UsbError::Stalled) => {}
            Err(error) => return Err(error),
        }
        let head = self.get_descriptor(socket, 2, 0, 0, 9)?;
        let configuration = self.get_descriptor(socket, 2, 0, 0, descriptors::total_length(&head)?)?;
        let mut description = Description::parse(&device, &configuration)?;
        let languages = self.get_descriptor(socket, 3, 0, 0, 255)?;
        let language = descriptors::first_language(&languages)?;
        let strings = [&mut description.manufacturer, &mut description.product, &mut description.serial];
        for (string, &index) in strings.into_iter().zip(&device[14..]) {
            if index != 0 {
                *string = descriptors::string(&self.get_descriptor(socket, 3, index, language, 255)?)?;
            }
        }
        self.configure(socket, description.configuration)?;
        self.description = Some(description.clone());
        Ok(description)
    }

    /// Connects and enumerates.
    pub fn connect(&mut self, socket: &mut impl Socket) -> Carried<Description> {
        self.plug(socket)?;
        self.enumerate(socket)
    }

    /// SET_ADDRESS.
    pub fn set_address(&mut self, socket: &mut impl Socket) -> Carried {
        self.order(socket, 0, 5, ADDRESS.into(), 0)?;
        self.address = ADDRESS;
        run(socket, SET_ADDRESS_S)
    }

    /// SET_CONFIGURATION.
    pub fn configure(&mut self, socket: &mut impl Socket, configuration: u8) -> Carried {
        self.order(socket, 0, 9, configuration.into(), 0)
    }

    /// CLEAR_FEATURE(ENDPOINT_HALT). The top bit of `endpoint` is set for an IN endpoint.
    pub fn clear_halt(&mut self, socket: &mut impl Socket, endpoint: u8) -> Carried {
        self.order(socket, 2, 1, 0, endpoint.into())
    }

    /// A control request without data.
    fn order(&mut self, socket: &mut impl Socket, kind: u8, request: u8, value: u16, index: u16) -> Carried {
        self.control(socket, Setup { kind, request, value, index, length: 0 }, &[]).map(|_| ())
    }

    /// GET_DESCRIPTOR.
    pub fn get_descriptor(
        &mut self,
        socket: &mut impl Socket,
        kind: u8,
        index: u8,
        language: u16,
        length: u16,
    ) -> Carried<Vec<u8>> {
        let value = u16::from_be_bytes([kind, index]);
        self.control(socket, Setup { kind: 0x80, request: 6, value, index: language, length }, &[])
    }

    // ---- blocking transfers

    /// A control request with its data; returns the data from the device.
    pub fn control(&mut self, socket: &mut impl Socket, setup: Setup, data: &[u8]) -> Carried<Vec<u8>> {
        self.wait_for(socket, Transfer::Control(setup, data.to_vec()), CONTROL_S, |_| Ok(())).result
    }

    /// Reads from an endpoint within a time: up to a short packet, at most `most` bytes.
    ///
    /// The caller loses bytes that arrive without a short packet, as with a real host.
    pub fn read(&mut self, socket: &mut impl Socket, endpoint: u8, most: usize, within_s: f64) -> Carried<Vec<u8>> {
        self.wait_for(socket, Transfer::In(endpoint, most), within_s, |_| Ok(())).result
    }

    /// Writes bytes to an endpoint within a time; returns how many the device accepted.
    pub fn write(&mut self, socket: &mut impl Socket, endpoint: u8, bytes: &[u8], within_s: f64) -> (usize, Carried) {
        let done = self.wait_for(socket, Transfer::Out(endpoint, bytes.to_vec(), false), within_s, |_| Ok(()));
        (done.moved, done.result.map(|_| ()))
    }

    /// Carries out a transfer within a time; calls `meanwhile` after each round of packets.
    fn wait_for(
        &mut self,
        socket: &mut impl Socket,
        transfer: Transfer,
        within_s: f64,
        mut meanwhile: impl FnMut(&mut Self) -> Carried,
    ) -> Done {
        let number = self.submit(transfer);
        let end_s = socket.time_s() + within_s;
        loop {
            if let Some(done) = self.take_done(number) {
                return done;
            }
            let late = if socket.time_s() < end_s { Ok(()) } else { Err(UsbError::Late) };
            if let Err(error) = late.and_then(|()| self.service(socket)).and_then(|()| meanwhile(self)) {
                let moved = self.cancel(number).unwrap_or(0);
                return Done { number, result: Err(error), moved };
            }
        }
    }

    // ---- queued transfers

    /// Queues a transfer. [`Done`] has the returned number.
    pub fn submit(&mut self, transfer: Transfer) -> u64 {
        let number = self.next_number;
        self.next_number += 1;
        let (pipe, running) = match transfer {
            Transfer::Control(setup, mut data) => {
                let most = usize::from(setup.length);
                // Without a data stage the status stage is IN, whatever direction the request gives (USB 2.0 8.5.3).
                let reads = setup.to_host() && most > 0;
                data.truncate(if reads { 0 } else { most });
                (0, Running { setup: Some(setup), stage: Stage::Setup, reads, most, data, ..Running::default() })
            }
            Transfer::In(endpoint, most) => {
                (TO_HOST + usize::from(endpoint & 0xF), Running { reads: true, most, ..Running::default() })
            }
            Transfer::Out(endpoint, data, close) => {
                (usize::from(endpoint & 0xF), Running { most: data.len(), data, close, ..Running::default() })
            }
        };
        self.pipes[pipe].queue.push_back(Running { number, ..running });
        number
    }

    /// Cancels a transfer that has not ended; returns the number of bytes that it transferred.
    pub fn cancel(&mut self, number: u64) -> Option<usize> {
        self.pipes.iter_mut().find_map(|pipe| {
            let place = pipe.queue.iter().position(|running| running.number == number)?;
            pipe.queue.remove(place).map(|running| running.received.len() + running.sent)
        })
    }

    /// The next finished transfer.
    pub fn next_done(&mut self) -> Option<Done> {
        self.done.pop_front()
    }

    /// The transfer with this number, if it has finished.
    pub fn take_done(&mut self, number: u64) -> Option<Done> {
        self.done.remove(self.done.iter().position(|done| done.number == number)?)
    }

    /// Whether no transfer is queued.
    pub fn is_idle(&self) -> bool {
        self.pipes.iter().all(|pipe| pipe.queue.is_empty())
    }

    /// Processes one packet for each pipe with a queued transfer, and lets its bus time pass.
    pub fn service(&mut self, socket: &mut impl Socket) -> Carried {
        if self.supplied && !socket.usb().attached() {
            self.lose(socket);
        }
        let mut moved = false;
        // Bus time of packets without progress, which passes in one step at the end.
        let mut idle_s = 0.0;
        for index in 0..PIPES {
            if !self.frames || self.pipes[index].queue.is_empty() {
                continue;
            }
            let (step, time_s) = self.step(index, socket.usb());
            match step {
                Step::Waits => {
                    idle_s += time_s;
                    continue;
                }
                Step::Moved => {}
                Step::Ends(result) => self.finish(index, result),
            }
            moved = true;
            run(socket, time_s)?;
        }
        self.pause_s = if moved { 0.0 } else { (2.0 * self.pause_s).clamp(PAUSE_S, LONGEST_PAUSE_S) };
        run(socket, idle_s + self.pause_s)
    }

    fn finish(&mut self, index: usize, result: Carried) {
        if let Some(running) = self.pipes[index].queue.pop_front() {
            let moved = running.received.len() + running.sent;
            if let (Ok(()), Some(setup)) = (&result, running.setup) {
                self.restart_toggles(setup);
            }
            self.done.push_back(Done { number: running.number, result: result.map(|()| running.received), moved });
        }
    }

    /// After SET_CONFIGURATION or a cleared halt, endpoints restart with DATA0 (USB 2.0 9.1.1.5, 9.4.5).
    fn restart_toggles(&mut self, setup: Setup) {
        match (setup.kind, setup.request, setup.value) {
            (0, 9, _) => self.pipes.iter_mut().for_each(|pipe| pipe.toggle = Toggle::Data0),
            (2, 1, 0) => {
                let pipe = usize::from(setup.index & 0xF) + if setup.index & 0x80 != 0 { TO_HOST } else { 0 };
                self.pipes[pipe].toggle = Toggle::Data0;
            }
            _ => {}
        }
    }

    fn fail_all(&mut self, error: &UsbError) {
        for index in 0..PIPES {
            while !self.pipes[index].queue.is_empty() {
                self.finish(index, Err(error.clone()));
            }
            self.pipes[index].toggle = Toggle::Data0;
        }
    }

    fn lose(&mut self, socket: &mut impl Socket) {
        self.fail_all(&UsbError::Detached);
        socket.usb().stop_frames();
        self.frames = false;
        self.description = None;
    }

    fn check_attached(&self, socket: &mut impl Socket) -> Carried {
        if self.supplied && socket.usb().attached() { Ok(()) } else { Err(UsbError::Detached) }
    }

    /// Processes one packet of the first transfer of a pipe; returns the outcome and the bus time.
    fn step(&mut self, index: usize, usb: &mut Usb) -> (Step, f64) {
        let (address, number) = (self.address, (index % TO_HOST) as u8);
        let full = self.control_packet.filter(|_| index == 0).unwrap_or(FULL_PACKET);
        let Pipe { queue, toggle } = &mut self.pipes[index];
        let Some(running) = queue.front_mut() else { return (Step::Waits, 0.0) };
        let rest = running.data.get(running.sent..).unwrap_or_default();
        let packet = rest.get(..full).unwrap_or(rest);
        // The status stage is an empty packet against the direction of the data.
        let (answer, sent, asked) = match (running.stage, running.setup) {
            (Stage::Setup, Some(setup)) => (usb.setup(address, &setup.bytes()), 8, false),
            (stage, _) if running.reads == (stage == Stage::Data) => (usb.ask(address, number), 0, true),
            _ => (usb.send(address, number, *toggle, packet), packet.len(), false),
        };
        let mut bytes = sent;
        if let Answer::Data(_, data) = &answer {
            usb.acknowledge(address, number);
            bytes += data.len();
        }
        let time_s = packet_time_s(bytes, !matches!(answer, Answer::Nak | Answer::Stall));
        (running.take(answer, sent, asked, full, toggle), time_s)
    }
}

impl Running {
    /// Processes the device's response to a packet of this transfer, or to a request for one.
    fn take(&mut self, answer: Answer, sent: usize, asked: bool, full: usize, toggle: &mut Toggle) -> Step {
        let data = match answer {
            Answer::Nak => return Step::Waits,
            Answer::Stall => return Step::Ends(Err(UsbError::Stalled)),
            Answer::Data(theirs, _) if asked && theirs != *toggle => {
                // A retransmission: the host acknowledges and discards it (USB 2.0 8.6.4).
                self.strikes = 0;
                return Step::Moved;
            }
            Answer::Data(_, data) if asked => data,
            Answer::Ack if !asked => Vec::new(),
            Answer::Nothing | Answer::Ack | Answer::Data(..) => {
                self.strikes += 1;
                return if self.strikes < STRIKES { Step::Waits } else { Step::Ends(Err(UsbError::Silent)) };
            }
        };
        self.strikes = 0;
        self.stage = match self.stage {
            Stage::Setup if self.most > 0 => Stage::Data,
            Stage::Setup => Stage::Status,
            Stage::Data => {
                *toggle = toggle.flipped();
                let short = self.reads && data.len() < full;
                self.sent += sent;
                self.received.extend(data);
                let moved = self.received.len() + self.sent;
                if self.received.len() > self.most {
                    return Step::Ends(Err(UsbError::TooMuch));
                }
                if !short && (moved < self.most || self.close && sent == full) {
                    return Step::Moved;
                }
                if self.setup.is_none() {
                    return Step::Ends(Ok(()));
                }
                Stage::Status
            }
            Stage::Status => return Step::Ends(if data.is_empty() { Ok(()) } else { Err(UsbError::TooMuch) }),
        };
        // The data stage and the status stage of a control request begin with DATA1 (USB 2.0 8.5.3).
        *toggle = Toggle::Data1;
        Step::Moved
    }
}

/// Bus time of a transaction with token and handshake at 12 Mbit/s, plus a sixth of the data for bit stuffing (USB 2.0
/// 5.11.3).
fn packet_time_s(bytes: usize, with_data: bool) -> f64 {
    if with_data { 9.1e-6 + bytes as f64 * 8.0 * (7.0 / 6.0) / 12e6 } else { 5e-6 }
}

fn run(socket: &mut impl Socket, time_s: f64) -> Carried {
    socket.run_for(time_s).map_err(UsbError::Stopped)
}

#[cfg(test)]
pub(crate) mod tests;
