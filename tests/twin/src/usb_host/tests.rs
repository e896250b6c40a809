//! Tests of the host against the peripheral model. Instead of the firmware, a small driver echoes a serial port.

use super::serial::{SerialPort, line_coding, set_control_lines, set_line_coding};
use super::*;
use crate::chip::clocks::Clocks;
use crate::chip::usb::MEMORY_OFFSET;
use crate::{Cycles, Registers, Width};

const CLOCKS: Clocks = Clocks { hclk_hz: 168e6, usb_hz: 48e6, ..Clocks::POWER_ON };
/// Interval at which the driver polls its interrupts.
const LOOK: Cycles = 1680;

const DEVICE: [u8; 18] = [18, 1, 0, 2, 2, 0, 0, 64, 0x09, 0x12, 1, 0, 0, 1, 0, 1, 0, 1];

fn configuration() -> Vec<u8> {
    let mut bytes = vec![9, 2, 0, 0, 1, 1, 0, 0x80, 50];
    bytes.extend([9, 4, 0, 0, 2, 10, 0, 0, 0]);
    bytes.extend([7, 5, 0x01, 2, 64, 0, 0]);
    bytes.extend([7, 5, 0x81, 2, 64, 0, 0]);
    bytes[2] = bytes.len() as u8;
    bytes
}

/// State of a control request in the driver.
#[derive(Clone, Debug, PartialEq)]
enum Control {
    Idle,
    Sending(Vec<u8>),
    /// Status packet in progress, and the address that takes effect after it.
    Status(Option<u8>),
    Receiving,
}

pub struct Puppet {
    usb: Usb,
    now: Cycles,
    control: Control,
    line_coding: Vec<u8>,
    lines: u16,
    echo: VecDeque<u8>,
    sending: bool,
    /// The driver sends an empty packet after full ones.
    closes: bool,
    /// The last packet was a full one.
    owes_empty: bool,
    /// The driver does not poll its interrupts.
    hangs: bool,
    supply: bool,
    resets: u32,
    /// Number of suspends and of wake-ups.
    naps: (u32, u32),
}

impl Puppet {
    pub fn new() -> Self {
        let mut puppet = Self {
            usb: Usb::default(),
            now: 0,
            control: Control::Idle,
            line_coding: vec![0; 7],
            lines: 0,
            echo: VecDeque::new(),
            sending: false,
            closes: true,
            owes_empty: false,
            hangs: false,
            supply: false,
            resets: 0,
            naps: (0, 0),
        };
        puppet.usb.set_clocks(&CLOCKS);
        puppet.set(0x40, 0x9C00);
        puppet.set(0x44, 0);
        for (at, word) in [(0, 64), (4, 128), (6, 0x8400), (8, 192), (12, 256), (14, 0x8400)] {
            puppet.put(at, word);
        }
        puppet.set(0x58, 0x8000);
        puppet
    }

    pub fn supplied(&self) -> bool {
        self.supply
    }

    fn get(&mut self, offset: u32) -> u16 {
        self.usb.read(offset, Width::Word, self.now).expect("existing register") as u16
    }

    fn set(&mut self, offset: u32, value: u16) {
        self.usb.write(offset, value.into(), Width::Word, self.now).expect("existing register");
    }

    fn put(&mut self, at: u32, word: u16) {
        self.usb.write(MEMORY_OFFSET + at, word.into(), Width::Half, self.now).expect("address in packet memory");
    }

    fn peek(&mut self, at: u32) -> u16 {
        self.usb.read(MEMORY_OFFSET + at, Width::Half, self.now).expect("address in packet memory") as u16
    }

    fn packet(&mut self, endpoint: u32) -> Vec<u8> {
        let start = u32::from(self.peek(endpoint * 8 + 4));
        let count = u32::from(self.peek(endpoint * 8 + 6) & 0x3FF);
        (0..count).map(|at| self.peek(start + (at & !1)).to_le_bytes()[at as usize & 1]).collect()
    }

    fn send(&mut self, endpoint: u32, data: &[u8]) {
        let start = u32::from(self.peek(endpoint * 8));
        for (at, pair) in data.chunks(2).enumerate() {
            self.put(start + 2 * at as u32, u16::from_le_bytes([pair[0], *pair.get(1).unwrap_or(&0)]));
        }
        self.put(endpoint * 8 + 2, data.len() as u16);
        self.status(endpoint, None, Some(3));
    }

    /// Sets STAT_RX and STAT_TX of an endpoint.
    fn status(&mut self, endpoint: u32, receive: Option<u16>, send: Option<u16>) {
        let register = self.get(endpoint * 4);
        let flip = |want: Option<u16>, shift: u32| want.map_or(0, |want| ((register >> shift ^ want) & 3) << shift);
        self.set(endpoint * 4, 0x8080 | register & 0x0F0F | flip(receive, 12) | flip(send, 4));
    }

    fn look(&mut self) {
        while !self.hangs && self.usb.irq_low() {
            let events = self.get(0x44);
            if events & 1 << 10 != 0 {
                self.set(0x44, !(1 << 10));
                self.resets += 1;
                (self.control, self.sending, self.owes_empty) = (Control::Idle, false, false);
                self.echo.clear();
                self.set(0x4C, 0x80);
                self.set(0, 0x0200 | 0x3020);
                self.set(4, 1);
            } else if events & 1 << 11 != 0 {
                self.set(0x44, !(1 << 11));
                self.naps.0 += 1;
                self.set(0x40, 0x9C0C);
            } else if events & 1 << 12 != 0 {
                self.set(0x40, 0x9C00);
                self.set(0x44, !(1 << 12));
                self.naps.1 += 1;
            } else if events & 0x8000 != 0 {
                self.transfer(u32::from(events & 0xF));
            }
        }
        if !self.hangs && !self.sending && (self.owes_empty || !self.echo.is_empty()) && self.get(4) & 0x30 != 0 {
            let packet: Vec<u8> = (0..64).map_while(|_| self.echo.pop_front()).collect();
            self.owes_empty = self.closes && packet.len() == 64;
            self.sending = true;
            self.send(1, &packet);
        }
    }

    fn transfer(&mut self, endpoint: u32) {
        let register = self.get(endpoint * 4);
        // Clears the events that were read and changes nothing else.
        self.set(endpoint * 4, !register & 0x8080 | register & 0x070F);
        match (endpoint, register & 0x8000 != 0) {
            (1, true) => {
                let packet = self.packet(1);
                self.echo.extend(packet);
                self.status(1, Some(3), None);
            }
            (1, false) => self.sending = false,
            (_, true) if register & 0x0800 != 0 => {
                let bytes: [u8; 8] = self.packet(0).try_into().expect("a SETUP packet has eight bytes");
                self.request(Setup::from_bytes(bytes));
            }
            (_, true) => {
                if self.control == Control::Receiving {
                    self.line_coding = self.packet(0);
                    self.control = Control::Status(None);
                    self.send(0, &[]);
                } else {
                    self.control = Control::Idle;
                }
            }
            (_, false) => match std::mem::replace(&mut self.control, Control::Idle) {
                Control::Sending(rest) => self.send_control(rest),
                Control::Status(Some(address)) => self.set(0x4C, 0x80 | u16::from(address)),
                other => self.control = other,
            },
        }
    }

    fn send_control(&mut self, mut data: Vec<u8>) {
        let rest = data.split_off(data.len().min(64));
        self.send(0, &data);
        // The host may now end the data stage at any time.
        self.status(0, Some(3), None);
        self.control = if rest.is_empty() { Control::Idle } else { Control::Sending(rest) };
    }

    fn request(&mut self, setup: Setup) {
        let mut answer = match (setup.kind, setup.request, setup.value >> 8) {
            (0x80, 6, 1) => DEVICE.to_vec(),
            (0x80, 6, 2) => configuration(),
            (0x80, 6, 3) if setup.value == 0x300 => vec![4, 3, 9, 4],
            (0x80, 6, 3) => vec![6, 3, b'h', 0, b'i', 0],
            (0xA1, 0x21, _) => self.line_coding.clone(),
            (0, 5 | 9, _) | (0x21, 0x20 | 0x22, _) | (2, 1, _) => Vec::new(),
            _ => return self.status(0, Some(1), Some(1)),
        };
        answer.truncate(setup.length.into());
        match (setup.kind, setup.request) {
            (0, 9) => self.set(4, 0x3020 | 1),
            (0x21, 0x22) => self.lines = setup.value,
            (0x21, 0x20) => {
                self.control = Control::Receiving;
                return self.status(0, Some(3), None);
            }
            _ => {}
        }
        if setup.to_host() && setup.length > 0 {
            self.send_control(answer);
        } else {
            self.control = Control::Status((setup.request == 5).then_some(setup.value as u8));
            self.send(0, &[]);
        }
    }
}

impl Socket for Puppet {
    fn usb(&mut self) -> &mut Usb {
        self.usb.advance(self.now);
        &mut self.usb
    }

    fn time_s(&mut self) -> f64 {
        CLOCKS.seconds(self.now)
    }

    fn run_for(&mut self, time_s: f64) -> Result<(), String> {
        let end = self.now + CLOCKS.cycles_in(time_s);
        while self.now < end {
            self.now = (self.now + LOOK).min(end);
            self.usb.advance(self.now);
            self.look();
        }
        Ok(())
    }

    fn set_supply(&mut self, on: bool) {
        self.supply = on;
    }
}

fn connected() -> (UsbHost, Puppet) {
    let (mut host, mut puppet) = (UsbHost::default(), Puppet::new());
    host.connect(&mut puppet).expect("the device enumerates");
    // Between connection and bus reset there is no traffic, so the device suspends, as a real one does.
    assert_eq!(std::mem::take(&mut puppet.naps), (1, 1));
    (host, puppet)
}

#[test]
fn a_device_is_enumerated() {
    let (mut host, mut puppet) = (UsbHost::default(), Puppet::new());
    let description = host.connect(&mut puppet).expect("the device enumerates");
    assert_eq!((description.vendor, description.product.as_str()), (0x1209, "hi"));
    assert!(puppet.supply);
    assert_eq!(puppet.resets, 2, "one at the plug, one after the first descriptor");
    assert_eq!(description.serial_endpoints(), Ok((1, 1)));
}

#[test]
fn control_requests_go_both_ways_and_are_refused() {
    let (mut host, mut puppet) = connected();
    set_line_coding(&mut host, &mut puppet, 921_600).expect("the device accepts it");
    assert_eq!(line_coding(&mut host, &mut puppet), Ok(vec![0, 0x10, 0x0E, 0, 0, 0, 8]));
    set_control_lines(&mut host, &mut puppet, true, false).expect("the device accepts it");
    assert_eq!(puppet.lines, 1);
    let unknown = Setup { kind: 0xC0, request: 0x33, value: 0, index: 0, length: 4 };
    assert_eq!(host.control(&mut puppet, unknown, &[]), Err(UsbError::Stalled));
    let empty = Setup { length: 0, ..unknown };
    assert_eq!(host.control(&mut puppet, empty, &[]), Err(UsbError::Stalled), "the status stage is an IN packet");
    assert!(host.get_descriptor(&mut puppet, 1, 0, 0, 18).is_ok(), "and the next request is fine");
}

#[test]
fn bytes_go_through_and_back() {
    let (mut host, mut puppet) = connected();
    let mut port = SerialPort::open(&mut host, &mut puppet).expect("the port opens");
    for length in [1, 63, 64, 65, 127, 128, 1000] {
        let bytes: Vec<u8> = (0..length).map(|at| at as u8).collect();
        assert_eq!(port.send(&mut host, &mut puppet, &bytes, 1.0), (length, Ok(())));
        assert_eq!(port.receive(&mut host, &mut puppet, 0.02), Ok(bytes));
    }
    port.close(&mut host, &mut puppet).expect("the port closes");
    assert_eq!(puppet.lines, 0);
    assert!(host.is_idle());
}

#[test]
fn a_full_packet_without_an_empty_one_stays_in_the_hosts_hands() {
    let (mut host, mut puppet) = connected();
    puppet.closes = false;
    let mut port = SerialPort::open(&mut host, &mut puppet).expect("the port opens");
    port.send(&mut host, &mut puppet, &[1; 64], 1.0).1.expect("the device accepts it");
    assert_eq!(port.receive(&mut host, &mut puppet, 0.5), Ok(vec![]));
    port.send(&mut host, &mut puppet, &[2], 1.0).1.expect("the device accepts it");
    assert_eq!(port.receive(&mut host, &mut puppet, 0.5).map(|bytes| bytes.len()), Ok(65));
}

#[test]
fn what_was_not_read_waits_for_the_next_opening() {
    let (mut host, mut puppet) = connected();
    let port = SerialPort::open(&mut host, &mut puppet).expect("the port opens");
    port.close(&mut host, &mut puppet).expect("the port closes");
    assert_eq!(host.write(&mut puppet, 1, b"stale", 1.0), (5, Ok(())));
    host.read(&mut puppet, 2, 64, 0.1).expect_err("nobody reads the endpoint");
    let mut port = SerialPort::open(&mut host, &mut puppet).expect("the port opens");
    assert_eq!(port.receive(&mut host, &mut puppet, 0.01), Ok(b"stale".to_vec()));
}

#[test]
fn a_device_that_hangs_is_given_up() {
    let (mut host, mut puppet) = connected();
    puppet.hangs = true;
    let before = puppet.time_s();
    let (moved, result) = host.write(&mut puppet, 1, &[0; 200], 0.1);
    assert_eq!((moved, result), (64, Err(UsbError::Late)), "one packet fits, the next is refused for ever");
    assert!((0.1..0.101).contains(&(puppet.time_s() - before)));
    assert_eq!(host.get_descriptor(&mut puppet, 1, 0, 0, 18), Err(UsbError::Late));
    assert_eq!(
        host.get_descriptor(&mut puppet, 1, 0, 0, 18),
        Err(UsbError::Silent),
        "the first SETUP was not looked at"
    );
}

#[test]
fn an_unplugged_device_ends_what_was_under_way_and_comes_back() {
    let (mut host, mut puppet) = connected();
    let number = host.submit(Transfer::In(1, 64));
    host.service(&mut puppet).expect("the device runs");
    host.unplug(&mut puppet);
    let done = host.take_done(number).expect("the transfer has ended");
    assert_eq!(done.result, Err(UsbError::Detached));
    assert!(!puppet.supply);
    puppet.run_for(0.1).expect("the device runs");
    assert_eq!(puppet.naps.0, 1, "without traffic the device takes it for a suspend");
    assert_eq!(host.reset(&mut puppet), Err(UsbError::Detached));
    host.connect(&mut puppet).expect("the device enumerates again");
    assert_eq!(puppet.naps.1, 1);
}

#[test]
fn a_suspended_device_wakes_and_goes_on() {
    let (mut host, mut puppet) = connected();
    host.write(&mut puppet, 1, b"before", 1.0).1.expect("the device accepts it");
    host.suspend(&mut puppet).expect("the device runs");
    assert_eq!(puppet.naps, (1, 0));
    assert_eq!(host.read(&mut puppet, 1, 64, 0.1), Err(UsbError::Late), "nothing moves meanwhile");
    host.resume(&mut puppet).expect("the device wakes");
    assert_eq!(puppet.naps, (1, 1));
    assert_eq!(host.read(&mut puppet, 1, 64, 0.1), Ok(b"before".to_vec()));
}

#[test]
fn a_full_speed_wire_carries_a_little_over_a_megabyte_a_second() {
    // USB 2.0's table allows 19 packets of 64 bytes per frame; this host and driver come close to it.
    let (mut host, mut puppet) = connected();
    let before = puppet.time_s();
    host.write(&mut puppet, 1, &[0; 10_000], 1.0).1.expect("the device accepts it");
    let rate = 10_000.0 / (puppet.time_s() - before);
    assert!((400e3..1216e3).contains(&rate), "{rate} bytes a second");
}
