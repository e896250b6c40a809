//! The chip's ROM boot loader as a USB device that accepts firmware by DfuSe.
//!
//! It is not machine code: this module runs in place of the program and uses the same chip registers, so the host sees
//! no difference. Its control endpoint supports only what the boot loader needs. The descriptors are ST's, with only
//! one of the five alternate settings, that of flash.
//!
//! Sources: AN2606 and AN3156 (device ID, memory layout), USB 2.0 chapter 9, USB DFU 1.1, RM0440 45 (registers).

mod dfu;

use crate::chip::{Chip, flash, rom};
use crate::usb_host::Setup;
use crate::{Cycles, Width};
use dfu::{BLOCK, Dfu};

const REGISTERS: u32 = 0x4000_5c00;
const ENDPOINT: u32 = REGISTERS;
const CONTROL: u32 = REGISTERS + 0x40;
const INTERRUPTS: u32 = REGISTERS + 0x44;
const ADDRESS: u32 = REGISTERS + 0x4c;
const TABLE: u32 = REGISTERS + 0x50;
const PULL_UP: u32 = REGISTERS + 0x58;
const MEMORY: u32 = 0x4000_6000;
/// Buffers of endpoint 0 in the packet memory, after the descriptor table.
const SEND_AT: u32 = 0x40;
const RECEIVE_AT: u32 = 0x80;
const PACKET: usize = 64;

/// Bits of USB_EP0R: RECEIVED and SENT are cleared by writing 0, CONTROL_TYPE is read-write, the status fields toggle.
const RECEIVED: u32 = 1 << 15;
const SETUP: u32 = 1 << 11;
const CONTROL_TYPE: u32 = 1 << 9;
const SENT: u32 = 1 << 7;
const STALL: u32 = 1;
const NAK: u32 = 2;
const VALID: u32 = 3;

/// Polling interval of the boot loader \[s\].
pub const LOOK_S: f64 = 10e-6;

const DEVICE: [u8; 18] = [18, 1, 0, 1, 0, 0, 0, 64, 0x83, 0x04, 0x11, 0xdf, 0, 0x22, 1, 2, 3, 1];
/// One interface, class DFU in DFU mode; functional descriptor: download, upload, detach; blocks of 2048; DFU 1.1a.
const CONFIGURATION: [u8; 27] = [
    9, 2, 27, 0, 1, 1, 0, 0xc0, 50, //
    9, 4, 0, 0, 0, 0xfe, 1, 2, 4, //
    9, 0x21, 0x0b, 0xff, 0, 0, 8, 0x1a, 1,
];

/// Stage of the control request in progress.
#[derive(Clone, Debug, Default)]
enum Stage {
    #[default]
    None,
    /// Data to the host: the rest of it, and whether an empty packet ends it.
    ToHost { data: Vec<u8>, ends_empty: bool },
    /// Data from the host: the request, and the data received so far.
    FromHost { setup: Setup, data: Vec<u8> },
    /// The status stage of a request to the device, and the address that takes effect after it.
    Status { address: Option<u8> },
}

/// The boot loader while it runs.
#[derive(Debug, Default)]
pub struct BootRom {
    stage: Stage,
    dfu: Dfu,
    begun: bool,
    /// The device has left the bus, and the program must be started.
    pub left: bool,
}

impl BootRom {
    /// Polls the USB peripheral.
    pub fn look(&mut self, chip: &mut Chip, now: Cycles) {
        let bus = &mut Bus { chip, now };
        if !self.begun {
            self.begun = true;
            bus.begin();
        }
        self.dfu.work(&mut bus.chip.flash, now);
        let interrupts = bus.read(INTERRUPTS);
        if interrupts & 1 << 10 != 0 {
            self.stage = Stage::None;
            bus.after_reset();
            return;
        }
        // Other interrupts are ignored: SOF, suspend.
        bus.write(INTERRUPTS, 0);
        if interrupts & 1 << 15 == 0 {
            return;
        }
        let endpoint = bus.read(ENDPOINT);
        if endpoint & SENT != 0 {
            bus.write(ENDPOINT, CONTROL_TYPE | RECEIVED);
            self.sent(bus);
        }
        if endpoint & RECEIVED != 0 {
            let data = bus.received();
            bus.write(ENDPOINT, CONTROL_TYPE | SENT);
            match data.as_slice().try_into() {
                Ok(setup) if endpoint & SETUP != 0 => self.set_up(bus, Setup::from_bytes(setup)),
                _ => self.take(bus, &data),
            }
        }
    }

    fn set_up(&mut self, bus: &mut Bus, setup: Setup) {
        if !setup.to_host() && setup.length > 0 {
            self.stage = Stage::FromHost { setup, data: Vec::new() };
            return bus.set_status(Some(VALID), None);
        }
        self.answer(bus, setup, &[]);
    }

    /// Processes data for the device, or the empty packet that ends a request to the host.
    fn take(&mut self, bus: &mut Bus, packet: &[u8]) {
        let Stage::FromHost { setup, data } = &mut self.stage else {
            return bus.set_status(Some(VALID), Some(NAK));
        };
        data.extend_from_slice(packet);
        if data.len() < usize::from(setup.length) && packet.len() == PACKET {
            return bus.set_status(Some(VALID), None);
        }
        let (setup, data) = (*setup, std::mem::take(data));
        self.answer(bus, setup, &data);
    }

    /// Executes a request whose data is complete.
    fn answer(&mut self, bus: &mut Bus, setup: Setup, data: &[u8]) {
        let Setup { kind, request, value, .. } = setup;
        let ([value_low, value_high], length) = (value.to_le_bytes(), usize::from(setup.length));
        let answer = match (kind & 0x60, request) {
            (0, 6) => descriptor(value_high, value_low),
            (0, 0) => Some(vec![0, 0]),
            (0, 8) => Some(vec![1]),
            (0, 10) => Some(vec![0]),
            // SET_ADDRESS, SET_CONFIGURATION, and SET_INTERFACE to the only setting.
            (0, 5 | 9) => Some(Vec::new()),
            (0, 11) if value_low == 0 => Some(Vec::new()),
            (0x20, _) => self.dfu.request(request, value, data, length.min(BLOCK), &mut bus.chip.flash, bus.now),
            _ => None,
        };
        match answer {
            None => {
                self.stage = Stage::None;
                bus.set_status(Some(STALL), Some(STALL));
            }
            Some(mut data) if setup.to_host() => {
                let ends_empty = data.len() < length && data.len().is_multiple_of(PACKET);
                data.truncate(length);
                self.stage = Stage::ToHost { data, ends_empty };
                bus.set_status(Some(VALID), None);
                self.sent(bus);
            }
            Some(_) => {
                let address = (kind & 0x60 == 0 && request == 5).then_some(value_low);
                self.stage = Stage::Status { address };
                bus.send(&[]);
            }
        }
    }

    /// Processes the end of a packet to the host: sends the next one, or ends the stage.
    fn sent(&mut self, bus: &mut Bus) {
        match &mut self.stage {
            Stage::ToHost { data, ends_empty } if !data.is_empty() || *ends_empty => {
                *ends_empty &= !data.is_empty();
                let packet: Vec<u8> = data.drain(..data.len().min(PACKET)).collect();
                bus.send(&packet);
            }
            Stage::ToHost { .. } if self.dfu.leaves() => {
                // The status was sent: leave the bus and start the program.
                bus.write(PULL_UP, 0);
                self.left = true;
            }
            Stage::Status { address } => {
                if let Some(address) = address {
                    bus.write(ADDRESS, 0x80 | u32::from(*address));
                }
                self.stage = Stage::None;
                bus.set_status(Some(VALID), None);
            }
            _ => {}
        }
    }
}

fn descriptor(kind: u8, index: u8) -> Option<Vec<u8>> {
    let uid = rom::UID;
    let text = match (kind, index) {
        (1, _) => return Some(DEVICE.to_vec()),
        (2, _) => return Some(CONFIGURATION.to_vec()),
        (3, 0) => return Some(vec![4, 3, 9, 4]),
        (3, 1) => "STMicroelectronics".into(),
        (3, 2) => "STM32  BOOTLOADER".into(),
        (3, 3) => format!("{:08X}{:04X}", uid[0].wrapping_add(uid[2]), uid[1] >> 16),
        (3, 4) => format!("@Internal Flash   /0x08000000/{}*02Kg", flash::LEN / flash::PAGE),
        _ => return None,
    };
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    Some([&[units.len() as u8 + 2, 3], units.as_slice()].concat())
}

/// The chip's registers at one time.
struct Bus<'a> {
    chip: &'a mut Chip,
    now: Cycles,
}

impl Bus<'_> {
    /// Enables HSI48, the USB clock, the transceiver and the pull-up.
    fn begin(&mut self) {
        self.write(0x4002_1098, 1);
        let clocks = self.read(0x4002_1058);
        self.write(0x4002_1058, clocks | 1 << 23);
        self.write(CONTROL, 1);
        self.write(CONTROL, 0);
        self.write(INTERRUPTS, 0);
        self.write(TABLE, 0);
        self.write(PULL_UP, 1 << 15);
    }

    fn after_reset(&mut self) {
        self.write(INTERRUPTS, 0);
        for (place, half) in [(0, SEND_AT), (2, 0), (4, RECEIVE_AT), (6, 0x8400)] {
            self.write_half(MEMORY + place, half);
        }
        self.write(ENDPOINT, CONTROL_TYPE);
        self.set_status(Some(VALID), Some(NAK));
        self.write(ADDRESS, 0x80);
    }

    /// Sets STAT_RX and STAT_TX of the endpoint.
    fn set_status(&mut self, receive: Option<u32>, send: Option<u32>) {
        let register = self.read(ENDPOINT);
        let flip =
            |wanted: Option<u32>, shift: u32| wanted.map_or(0, |wanted| (register >> shift & 3 ^ wanted) << shift);
        self.write(ENDPOINT, CONTROL_TYPE | RECEIVED | SENT | flip(receive, 12) | flip(send, 4));
    }

    fn send(&mut self, packet: &[u8]) {
        for (place, pair) in (MEMORY + SEND_AT..).step_by(2).zip(packet.chunks(2)) {
            let half = u32::from(pair[0]) | pair.get(1).map_or(0, |high| u32::from(*high) << 8);
            self.write_half(place, half);
        }
        self.write_half(MEMORY + 2, packet.len() as u32);
        self.set_status(None, Some(VALID));
    }

    fn received(&mut self) -> Vec<u8> {
        let count = usize::from(self.half(MEMORY + 6) & 0x3ff).min(PACKET);
        let mut bytes: Vec<u8> = Vec::new();
        for place in (MEMORY + RECEIVE_AT..).step_by(2).take(count.div_ceil(2)) {
            bytes.extend(self.half(place).to_le_bytes());
        }
        bytes.truncate(count);
        bytes
    }

    fn read(&mut self, address: u32) -> u32 {
        self.chip.read(address, Width::Word, self.now).expect("existing register")
    }

    fn write(&mut self, address: u32, value: u32) {
        self.chip.write(address, value, Width::Word, self.now).expect("existing register");
    }

    fn half(&mut self, address: u32) -> u16 {
        self.chip.read(address, Width::Half, self.now).expect("address in packet memory") as u16
    }

    fn write_half(&mut self, address: u32, value: u32) {
        self.chip.write(address, value, Width::Half, self.now).expect("address in packet memory");
    }
}
