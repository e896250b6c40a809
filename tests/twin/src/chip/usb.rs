//! USB full-speed device: registers, packet memory and the bus.
//!
//! The firmware's side is [`Registers`]. The host's side has one method per event on the cable. A packet from the host
//! takes no time here; [`crate::usb_host`] accounts for the bus time.
//!
//! - *endpoint register*: one of the eight registers `USB_EPnR`. Its index n need not be the endpoint number on the bus
//!   (`EA`).
//! - *packet memory*: 1 KiB shared by firmware and bus. The buffer descriptor table in it (`USB_BTABLE`) gives the
//!   location of each endpoint register's packets.
//! - *frame*: a millisecond by the host's clock, which starts with a start-of-frame (SOF) packet.
//! - *traffic*: any packet on the bus, SOF included. Three milliseconds without it suspend the device.
//!
//! Source: RM0440 Rev 8, chapter 45; sections named below. Not modelled, and refused when the firmware enables them:
//! isochronous and double-buffered endpoints, remote wake-up, charger detection. Link power management is storage only,
//! as the hosts here send no such token.

use super::clocks::Clocks;
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Unknown, Width};

/// Offset of the packet memory from the registers: 0x4000_6000 from 0x4000_5C00 (RM0440 table 3).
pub const MEMORY_OFFSET: u32 = 0x400;
/// Size of the packet memory \[bytes\] (RM0440 45.2).
pub const MEMORY_BYTES: usize = 1024;
/// Number of endpoint registers.
const ENDPOINTS: usize = 8;

// Registers (RM0440 45.6.1).
registers! { u16:
    // The first of the endpoint registers, which end at 0x1F: a packet was received, or sent (CTR), and the toggle of
    // the next (DTOG). STAT_RX and STAT_TX, the response to it, are defined after this table.
    EPR 0x00 { DTOG_TX 6, CTR_TX 7, EP_KIND 8, SETUP 11, DTOG_RX 14, CTR_RX 15 },
    // The bits from 7 up enable the interrupt of the same bit in `USB_ISTR`. The first four force a reset, switch the
    // transceiver off, select low power, and force suspend.
    CNTR 0x40 { FRES 0, PDWN 1, LPMODE 2, FSUSP 3, RESUME 4, L1RESUME 5, CNTR_RESERVED 6 },
    // The transfer is OUT; a frame is missing; a frame began. CTR: a packet was received or sent.
    ISTR 0x44 { DIR 4, ESOF 8, SOF 9, RESET 10, SUSP 11, WKUP 12, CTR 15 },
    // Frame timer locked, level of D+. The other fields are defined after this table.
    FNR 0x48 { LCK 13, RXDP 15 },
    // The device responds to packets.
    DADDR 0x4C { EF 7 },
    BTABLE 0x50,
    LPMCSR 0x54,
    // The D+ pull-up, by which the host detects a full-speed device.
    BCDR 0x58 { DPPU 15 },
}
const STAT_RX: u16 = 3 << 12;
const EP_TYPE: u16 = 3 << 9;
const STAT_TX: u16 = 3 << 4;
/// The endpoint number on the bus.
const EA: u16 = 0xF;
/// Values of `EP_TYPE`.
const BULK: u16 = 0 << 9;
const CONTROL: u16 = 1 << 9;
const ISOCHRONOUS: u16 = 2 << 9;
/// Writing 1 toggles a bit, writing 0 keeps it.
const FLIPPED: u16 = DTOG_RX | STAT_RX | DTOG_TX | STAT_TX;
/// Writing 0 clears a bit, writing 1 keeps it.
const EVENTS: u16 = CTR_RX | CTR_TX;
/// Plain read-write bits.
const PLAIN: u16 = EP_TYPE | EP_KIND | EA;

/// The two-bit fields `STAT_RX` and `STAT_TX` (RM0440 tables for USB_EPnR).
const DISABLED: u16 = 0;
const STALL: u16 = 1;
const NAK: u16 = 2;
const VALID: u16 = 3;

/// Bits of `USB_ISTR` that the firmware clears by writing 0.
const ISTR_CLEARABLE: u16 = 0x7F80;
/// Bits that can raise the interrupt.
const ISTR_ALL: u16 = 0xFF80;

/// Fields of `USB_FNR`: frames missing, frame number.
const LSOF_SHIFT: u32 = 11;
const LSOF_MOST: u16 = 3;
const FN: u16 = 0x7FF;

/// `USB_BCDR`: charger detection.
const CHARGER: u16 = 0xF;
/// Number of missing SOF packets after which the bus is suspended (RM0440 45.6.1, ESOF).
const FRAMES_TO_SUSPEND: u16 = 3;

/// PID of a data packet. The two alternate, so that the receiver recognises a retransmission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Toggle {
    /// DATA0.
    #[default]
    Data0,
    /// DATA1.
    Data1,
}

impl Toggle {
    /// The other PID.
    pub fn flipped(self) -> Self {
        match self {
            Self::Data0 => Self::Data1,
            Self::Data1 => Self::Data0,
        }
    }

    fn from_bit(set: bool) -> Self {
        if set { Self::Data1 } else { Self::Data0 }
    }
}

/// The device's response to a packet from the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The device accepted the packet.
    Ack,
    /// The device is not ready.
    Nak,
    /// The endpoint is halted or rejects the request.
    Stall,
    /// A data packet for the host.
    Data(Toggle, Vec<u8>),
    /// No response: the packet is for another address or invalid, or the device is off.
    Nothing,
}

/// The host's frames, timed by the host's clock.
#[derive(Clone, Copy, Debug)]
struct Frames {
    start_s: f64,
    period_s: f64,
    /// Number of the next frame.
    next: u64,
}

/// The peripheral, at 0x4000_5C00 to 0x4000_63FF.
pub struct Usb {
    endpoints: [u16; ENDPOINTS],
    control: u16,
    /// The clearable bits of `USB_ISTR`; the others derive from the endpoint registers.
    interrupts: u16,
    frame_number: u16,
    /// SOF packets since the last reset or resume; the count stops once the frame timer has locked.
    frames_seen: u8,
    /// Consecutive missing frames.
    frames_lost: u16,
    address: u16,
    table: u16,
    link_power: u16,
    charger: u16,
    memory: [u8; MEMORY_BYTES],
    now: Cycles,
    clocks: Clocks,
    /// Time of the last traffic, or of the start of the watch for it.
    traffic: Cycles,
    frames: Option<Frames>,
    /// A host is connected, which pulls both lines down.
    cable: bool,
    /// SOF packets not yet returned by [`take_frames`](Self::take_frames).
    frames_begun: u32,
}

impl Default for Usb {
    /// The state after power-on: transceiver off, no pull-up, no cable.
    fn default() -> Self {
        Self {
            endpoints: [0; ENDPOINTS],
            control: FRES | PDWN,
            interrupts: 0,
            frame_number: 0,
            frames_seen: 0,
            frames_lost: 0,
            address: 0,
            table: 0,
            link_power: 0,
            charger: 0,
            memory: [0; MEMORY_BYTES],
            now: 0,
            clocks: Clocks::POWER_ON,
            traffic: 0,
            frames: None,
            cable: false,
            frames_begun: 0,
        }
    }
}

impl Usb {
    /// Level of the interrupt request `USB_LP` (20). Only isochronous and double-buffered endpoints use `USB_HP` (19).
    pub fn irq_low(&self) -> bool {
        self.status() & self.control & ISTR_ALL != 0
    }

    /// Level of the wake-up request, EXTI line 18 (RM0440 table 97).
    pub fn irq_wakeup(&self) -> bool {
        self.interrupts & WKUP != 0
    }

    /// SOF packets since the last call; they synchronise the trimming of the 48 MHz clock.
    pub fn take_frames(&mut self) -> u32 {
        std::mem::take(&mut self.frames_begun)
    }

    // ---- the host's side of the cable

    /// Whether the host detects a full-speed device: pull-up on and transceiver powered.
    pub fn attached(&self) -> bool {
        self.charger & DPPU != 0 && self.control & PDWN == 0
    }

    /// Connects or disconnects a host.
    pub fn set_cable(&mut self, plugged: bool) {
        let low = self.lines_low();
        self.cable = plugged;
        self.watch_lines(low);
    }

    /// Whether the firmware has forced suspend (`USB_CNTR.FSUSP`).
    pub fn sleeps(&self) -> bool {
        self.control & FSUSP != 0
    }

    /// A bus reset by the host.
    ///
    /// It clears the address and the endpoint registers, except for CTR_RX and CTR_TX, so that no packet received
    /// before the reset is lost (RM0440 45.6.1, USB_EPnR, USB_DADDR).
    pub fn bus_reset(&mut self) {
        if !self.listens() {
            return;
        }
        self.activity();
        self.protocol_reset();
    }

    /// Makes the host start a frame every `period_s`, a millisecond by its own clock.
    pub fn start_frames(&mut self, period_s: f64) {
        self.frames = Some(Frames { start_s: self.clocks.seconds(self.now), period_s: period_s.max(1e-4), next: 1 });
    }

    /// Ends all traffic: the host or the cable is gone.
    pub fn stop_frames(&mut self) {
        self.frames = None;
    }

    /// The host's resume signalling. A device that is not suspended ignores it.
    pub fn resume(&mut self) {
        if self.listens() {
            self.activity();
        }
    }

    /// A SETUP packet.
    ///
    /// The device accepts it whatever `STAT_RX` is, except for disabled. It does not respond until the firmware has
    /// processed the previous packet (RM0440 45.5.2, control transfers).
    pub fn setup(&mut self, address: u8, packet: &[u8; 8]) -> Answer {
        let Some(index) = self.find(address, 0) else { return Answer::Nothing };
        let register = self.endpoints[index];
        let refused = register & EP_TYPE != CONTROL || register & CTR_RX != 0;
        if refused || receive_status(register) == DISABLED || !self.store(index, packet) {
            return Answer::Nothing;
        }
        let kept = register & !(STAT_RX | STAT_TX);
        self.endpoints[index] = kept | CTR_RX | SETUP | DTOG_RX | DTOG_TX | (NAK << 12) | (NAK << 4);
        Answer::Ack
    }

    /// An OUT transaction: data for the device.
    pub fn send(&mut self, address: u8, number: u8, toggle: Toggle, data: &[u8]) -> Answer {
        let Some(index) = self.find(address, number) else { return Answer::Nothing };
        let register = self.endpoints[index];
        match receive_status(register) {
            VALID => {}
            NAK => return Answer::Nak,
            STALL => return Answer::Stall,
            _ => return Answer::Nothing,
        }
        // STATUS_OUT is set: the data must have zero length (RM0440 45.6.1, EP_KIND).
        let empty = register & (EP_TYPE | EP_KIND) == CONTROL | EP_KIND;
        if empty && !data.is_empty() {
            return Answer::Stall;
        }
        if toggle != Toggle::from_bit(register & DTOG_RX != 0) {
            // A retransmission of a packet already received: the host missed the ACK.
            return Answer::Ack;
        }
        if !self.store(index, data) {
            return Answer::Stall;
        }
        let kept = register & !(STAT_RX | SETUP);
        self.endpoints[index] = (kept ^ DTOG_RX) | (NAK << 12) | CTR_RX;
        Answer::Ack
    }

    /// An IN transaction: requests data from the device. The buffer is freed by [`acknowledge`](Self::acknowledge).
    pub fn ask(&mut self, address: u8, number: u8) -> Answer {
        let Some(index) = self.find(address, number) else { return Answer::Nothing };
        let register = self.endpoints[index];
        match send_status(register) {
            VALID => {}
            NAK => return Answer::Nak,
            STALL => return Answer::Stall,
            _ => return Answer::Nothing,
        }
        let (start, count) = (self.descriptor(index, 0), self.descriptor(index, 1) & 0x3FF);
        let toggle = Toggle::from_bit(register & DTOG_TX != 0);
        match self.memory.get(start..start + count) {
            Some(data) => Answer::Data(toggle, data.to_vec()),
            None => Answer::Nothing,
        }
    }

    /// The host's ACK for the data that [`ask`](Self::ask) returned.
    pub fn acknowledge(&mut self, address: u8, number: u8) {
        let Some(index) = self.find(address, number) else { return };
        let register = self.endpoints[index];
        if send_status(register) == VALID {
            self.endpoints[index] = ((register & !STAT_TX) ^ DTOG_TX) | (NAK << 4) | CTR_TX;
        }
    }

    // ---- internals

    /// Whether the transceiver is on and the peripheral is not in reset.
    fn listens(&self) -> bool {
        self.control & (PDWN | FRES) == 0
    }

    /// Whether both lines are low (SE0): the host's pull-downs with no pull-up on the device. An enabled peripheral
    /// detects that as a bus reset.
    fn lines_low(&self) -> bool {
        self.cable && self.listens() && self.charger & DPPU == 0
    }

    fn watch_lines(&mut self, were_low: bool) {
        if self.lines_low() && !were_low {
            self.protocol_reset();
        }
    }

    fn protocol_reset(&mut self) {
        for register in &mut self.endpoints {
            *register &= EVENTS;
        }
        self.address = 0;
        self.frames_seen = 0;
        self.frames_lost = 0;
        self.traffic = self.now;
        self.interrupts |= RESET;
    }

    /// Traffic on the bus, which wakes a suspended peripheral (RM0440 45.5.5).
    fn activity(&mut self) {
        self.traffic = self.now;
        self.frames_lost = 0;
        if self.sleeps() {
            self.interrupts |= WKUP;
            self.control &= !LPMODE;
            self.frames_seen = 0;
        }
    }

    /// Lowest endpoint register with this endpoint number; none if the device has another address, is suspended, or has
    /// a bus reset pending.
    fn find(&mut self, address: u8, number: u8) -> Option<usize> {
        if !self.listens() {
            return None;
        }
        let sleeps = self.sleeps();
        self.activity();
        let addressed = self.address == EF | u16::from(address);
        // Reception and transmission stay disabled until the firmware clears the bit (RM0440 45.6.1, RESET).
        if sleeps || !addressed || self.interrupts & RESET != 0 {
            return None;
        }
        self.endpoints.iter().position(|register| {
            let in_use = receive_status(*register) != DISABLED || send_status(*register) != DISABLED;
            in_use && register & EA == u16::from(number)
        })
    }

    /// Byte offset of a word of the buffer descriptor of `index`: ADDR_TX, COUNT_TX, ADDR_RX, COUNT_RX.
    fn descriptor_place(&self, index: usize, word: usize) -> usize {
        usize::from(self.table) + index * 8 + word * 2
    }

    fn descriptor(&self, index: usize, word: usize) -> usize {
        let place = self.descriptor_place(index, word);
        match self.memory.get(place..place + 2) {
            Some(&[low, high]) => usize::from(u16::from_le_bytes([low, high])),
            _ => 0,
        }
    }

    /// Stores a received packet in its buffer; `false` if it is longer than the buffer (RM0440 45.6.2, COUNTn_RX:
    /// blocks of 2 or 32 bytes).
    fn store(&mut self, index: usize, data: &[u8]) -> bool {
        let (start, count) = (self.descriptor(index, 2), self.descriptor(index, 3));
        let blocks = count >> 10 & 0x1F;
        let room = if count & 0x8000 != 0 { (blocks + 1) * 32 } else { blocks * 2 };
        if data.len() > room {
            return false;
        }
        let Some(place) = self.memory.get_mut(start..start + data.len()) else { return false };
        place.copy_from_slice(data);
        let place = self.descriptor_place(index, 3);
        let word = (count & 0xFC00 | data.len()) as u16;
        if let Some(place) = self.memory.get_mut(place..place + 2) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        true
    }

    /// `USB_ISTR`: EP_ID and DIR come from the lowest endpoint register with an event.
    fn status(&self) -> u16 {
        let event = self.endpoints.iter().position(|register| register & EVENTS != 0);
        let of_event = event.map_or(0, |index| {
            let out = self.endpoints[index] & CTR_RX != 0;
            CTR | if out { DIR } else { 0 } | index as u16
        });
        self.interrupts | of_event
    }

    /// `USB_FNR`: LCK is set from the second frame on; the bus of an attached full-speed device idles with D+ high.
    fn frame_register(&self) -> u16 {
        let line = if self.attached() { RXDP } else { 0 };
        let locked = if self.frames_seen >= 2 { LCK } else { 0 };
        line | locked | self.frames_lost.min(LSOF_MOST) << LSOF_SHIFT | self.frame_number
    }

    fn next_frame(&self) -> Option<Cycles> {
        let frames = self.frames?;
        Some(self.clocks.cycle_at(frames.start_s + frames.period_s * frames.next as f64))
    }

    /// Core cycles per millisecond of the device's own 48 MHz clock.
    fn millisecond(&self) -> Cycles {
        let fast = if self.clocks.usb_hz > 0.0 { self.clocks.usb_hz / 48e6 } else { 1.0 };
        self.clocks.cycles_in(1e-3 / fast)
    }

    /// Time at which the device detects the next frame as missing (ESOF); `None` while it does not expect any.
    ///
    /// The device allows each frame to be a quarter of a millisecond late, so that a slow host does not count as
    /// missing.
    fn next_missed(&self) -> Option<Cycles> {
        let watches = self.attached() && self.listens() && !self.sleeps();
        let counts = watches && self.frames_lost < FRAMES_TO_SUSPEND;
        let millisecond = self.millisecond();
        counts.then_some(self.traffic + u64::from(self.frames_lost + 1) * millisecond + millisecond / 4)
    }

    fn begin_frame(&mut self) {
        let Some(frames) = &mut self.frames else { return };
        frames.next += 1;
        if !self.listens() {
            return;
        }
        let sleeps = self.sleeps();
        self.activity();
        if !sleeps {
            self.frame_number = (self.frame_number + 1) & FN;
            self.frames_seen = (self.frames_seen + 1).min(2);
            self.interrupts |= SOF;
            self.frames_begun += 1;
        }
    }

    fn miss_frame(&mut self) {
        self.frames_lost += 1;
        self.interrupts |= ESOF;
        if self.frames_lost == FRAMES_TO_SUSPEND {
            self.frames_seen = 0;
            self.interrupts |= SUSP;
        }
    }

    fn read_register(&self, offset: u32) -> Modelled<u16> {
        Ok(match offset {
            EPR..=0x1F => self.endpoints[(offset / 4) as usize],
            CNTR => self.control,
            ISTR => self.status(),
            FNR => self.frame_register(),
            DADDR => self.address,
            BTABLE => self.table,
            LPMCSR => self.link_power,
            BCDR => self.charger,
            _ => return Err(Unknown::REGISTER),
        })
    }

    fn write_register(&mut self, offset: u32, value: u16) -> Modelled {
        match offset {
            EPR..=0x1F => return self.write_endpoint((offset / 4) as usize, value),
            CNTR => return self.write_control(value),
            ISTR => self.interrupts &= value | !ISTR_CLEARABLE,
            DADDR => self.address = value & 0xFF,
            BTABLE => self.table = value & 0xFFF8,
            // Only the enable and acknowledge bits are writable (RM0440 45.6.1, USB_LPMCSR).
            LPMCSR => self.link_power = value & 3,
            BCDR if value & CHARGER != 0 => return refuse("USB_BCDR: charger detection is not modelled"),
            BCDR => {
                let low = self.lines_low();
                self.charger = value & DPPU;
                self.watch_lines(low);
            }
            FNR => return refuse("USB_FNR is read-only"),
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    fn write_endpoint(&mut self, index: usize, value: u16) -> Modelled {
        let of_type = value & EP_TYPE;
        refuse_if(of_type == ISOCHRONOUS, "USB_EPnR: isochronous endpoints are not modelled")?;
        refuse_if(of_type == BULK && value & EP_KIND != 0, "USB_EPnR: double-buffered endpoints are not modelled")?;
        let register = &mut self.endpoints[index];
        *register = (*register ^ value) & FLIPPED | *register & value & EVENTS | *register & SETUP | value & PLAIN;
        Ok(())
    }

    fn write_control(&mut self, value: u16) -> Modelled {
        refuse_if(value & (RESUME | L1RESUME) != 0, "USB_CNTR: remote wake-up is not modelled")?;
        let low = self.lines_low();
        let woken = self.sleeps() && value & FSUSP == 0;
        let released = !self.listens() && value & (PDWN | FRES) == 0;
        self.control = value & !CNTR_RESERVED;
        if value & FRES != 0 {
            // The same effect as a bus reset, including the interrupt (RM0440 45.6.1, FRES).
            self.protocol_reset();
        }
        self.watch_lines(low);
        if woken || released {
            self.traffic = self.now;
            self.frames_lost = 0;
        }
        Ok(())
    }
}

fn receive_status(register: u16) -> u16 {
    (register & STAT_RX) >> 12
}

fn send_status(register: u16) -> u16 {
    (register & STAT_TX) >> 4
}

impl Registers for Usb {
    fn read(&mut self, offset: u32, width: Width, now: Cycles) -> Modelled<u32> {
        self.advance(now);
        if let Some(place) = offset.checked_sub(MEMORY_OFFSET) {
            let place = place as usize;
            return match (width, self.memory.get(place..)) {
                (Width::Byte, Some([byte, ..])) => Ok(u32::from(*byte)),
                (Width::Half, Some([low, high, ..])) => Ok(u32::from(u16::from_le_bytes([*low, *high]))),
                (Width::Word, _) => refuse("USB packet memory: word read"),
                _ => refuse("USB packet memory: address out of range"),
            };
        }
        self.read_register(offset & !3).map(|word| width.part(word.into(), offset))
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        self.advance(now);
        if let Some(place) = offset.checked_sub(MEMORY_OFFSET) {
            let place = place as usize;
            return match (width, self.memory.get_mut(place..)) {
                (Width::Half, Some([low, high, ..])) => {
                    [*low, *high] = (value as u16).to_le_bytes();
                    Ok(())
                }
                // Half-words only: the memory is 16 bits wide, and chips of this family have been observed to write a
                // byte twice.
                (Width::Byte | Width::Word, _) => refuse("USB packet memory: byte or word write"),
                _ => refuse("USB packet memory: address out of range"),
            };
        }
        refuse_if(
            width == Width::Byte || offset & 3 != 0,
            "USB registers accept only aligned half-word or word writes",
        )?;
        self.write_register(offset, value as u16)
    }

    fn next_event(&self) -> Option<Cycles> {
        [self.next_frame(), self.next_missed()].into_iter().flatten().min()
    }

    fn advance(&mut self, now: Cycles) {
        while let Some(event) = self.next_event().filter(|event| *event <= now) {
            self.now = self.now.max(event);
            if self.next_frame() == Some(event) {
                self.begin_frame();
            } else {
                self.miss_frame();
            }
        }
        self.now = self.now.max(now);
    }

    /// The packet memory and the cable stay unchanged.
    fn reset(&mut self, now: Cycles) {
        *self = Self {
            now,
            clocks: self.clocks,
            frames: self.frames,
            cable: self.cable,
            memory: self.memory,
            ..Self::default()
        };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.clocks = *clocks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Width::{Byte, Half, Word};

    const CLOCKS: Clocks = Clocks { hclk_hz: 168e6, usb_hz: 48e6, ..Clocks::POWER_ON };
    const MILLISECOND: Cycles = 168_000;

    fn read(usb: &mut Usb, offset: u32) -> u16 {
        let now = usb.now;
        usb.read(offset, Word, now).expect("existing register") as u16
    }

    fn write(usb: &mut Usb, offset: u32, value: u16) {
        let now = usb.now;
        usb.write(offset, value.into(), Word, now).expect("existing register");
    }

    fn put(usb: &mut Usb, offset: usize, value: u16) {
        let now = usb.now;
        usb.write(MEMORY_OFFSET + offset as u32, value.into(), Half, now).expect("address in packet memory");
    }

    /// Endpoint 0 is a control endpoint and endpoint 1 a bulk endpoint, both ready to receive 64 bytes, at address 5.
    fn configured() -> Usb {
        let mut usb = Usb::default();
        usb.set_clocks(&CLOCKS);
        write(&mut usb, CNTR, 0);
        write(&mut usb, ISTR, 0);
        write(&mut usb, BCDR, DPPU);
        for (index, (to_host, from_host)) in [(0x40, 0x80), (0xC0, 0x100)].into_iter().enumerate() {
            put(&mut usb, index * 8, to_host);
            put(&mut usb, index * 8 + 4, from_host);
            put(&mut usb, index * 8 + 6, 0x8400);
        }
        write(&mut usb, DADDR, EF | 5);
        write(&mut usb, 0, CONTROL | (NAK << 12) | (NAK << 4));
        write(&mut usb, 4, BULK | (VALID << 12) | (NAK << 4) | 1);
        usb
    }

    #[test]
    fn an_endpoint_register_flips_clears_and_keeps_as_the_manual_says() {
        let mut usb = configured();
        usb.endpoints[2] = EVENTS | SETUP | (NAK << 12);
        // Writing 1 toggles a status bit, 0 keeps it. Writing 0 clears an event, 1 keeps it. SETUP is read-only.
        write(&mut usb, 8, CTR_RX | (1 << 12) | DTOG_TX | 3);
        let expected = CTR_RX | SETUP | (VALID << 12) | DTOG_TX | 3;
        assert_eq!(read(&mut usb, 8), expected);
    }

    #[test]
    fn a_setup_packet_is_taken_while_not_ready_but_not_before_the_one_before_it_was_seen() {
        let mut usb = configured();
        assert_eq!(usb.setup(5, b"12345678"), Answer::Ack);
        let register = read(&mut usb, 0);
        assert_eq!(register & (SETUP | CTR_RX), SETUP | CTR_RX);
        assert_eq!((receive_status(register), send_status(register)), (NAK, NAK));
        let toggles = DTOG_TX | DTOG_RX;
        assert_eq!(register & toggles, toggles, "the data stage begins with DATA1 either way");
        assert_eq!(&usb.memory[0x80..0x88], b"12345678");
        assert_eq!(usb.descriptor(0, 3), 0x8408);
        assert_eq!(usb.setup(5, b"abcdefgh"), Answer::Nothing);
        assert_eq!(&usb.memory[0x80..0x88], b"12345678");
        write(&mut usb, 0, CONTROL);
        assert_eq!(usb.setup(5, b"abcdefgh"), Answer::Ack);
    }

    #[test]
    fn data_out_is_taken_once_and_a_repetition_is_acknowledged_unread() {
        let mut usb = configured();
        write(&mut usb, CNTR, CTR);
        assert_eq!(usb.send(5, 1, Toggle::Data0, b"hello"), Answer::Ack);
        assert!(usb.irq_low());
        assert_eq!(read(&mut usb, ISTR) & 0x801F, CTR | DIR | 1);
        assert_eq!(
            usb.send(5, 1, Toggle::Data1, b"more"),
            Answer::Nak,
            "nothing is taken before the firmware is ready"
        );
        // Receive again: toggle NAK to VALID, clear the event.
        write(&mut usb, 4, CTR_TX | (1 << 12) | 1);
        assert!(!usb.irq_low());
        assert_eq!(usb.send(5, 1, Toggle::Data0, b"hello"), Answer::Ack);
        assert!(!usb.irq_low(), "a packet with the old toggle is a repetition");
        assert_eq!(usb.send(5, 1, Toggle::Data1, b"more"), Answer::Ack);
        assert!(usb.irq_low());
        assert_eq!(&usb.memory[0x100..0x105], b"moreo");
    }

    #[test]
    fn a_packet_longer_than_its_place_is_refused_and_leaves_no_event() {
        let mut usb = configured();
        put(&mut usb, 8 + 6, 10 << 10);
        assert_eq!(usb.send(5, 1, Toggle::Data0, &[7; 21]), Answer::Stall);
        assert_eq!(read(&mut usb, 4) & CTR_RX, 0);
        assert_eq!(usb.send(5, 1, Toggle::Data0, &[7; 20]), Answer::Ack);
    }

    #[test]
    fn data_in_stays_until_the_host_acknowledges() {
        let mut usb = configured();
        assert_eq!(usb.ask(5, 1), Answer::Nak);
        for (at, pair) in [(0xC0, *b"ab"), (0xC2, *b"c\0")] {
            put(&mut usb, at, u16::from_le_bytes(pair));
        }
        put(&mut usb, 8 + 2, 3);
        write(&mut usb, 4, EVENTS | (1 << 4) | 1);
        assert_eq!(usb.ask(5, 1), Answer::Data(Toggle::Data0, b"abc".to_vec()));
        assert_eq!(usb.ask(5, 1), Answer::Data(Toggle::Data0, b"abc".to_vec()), "not acknowledged: again");
        usb.acknowledge(5, 1);
        assert_eq!(usb.ask(5, 1), Answer::Nak);
        assert_eq!(read(&mut usb, 4) & (CTR_TX | DTOG_TX), CTR_TX | DTOG_TX);
        assert_eq!(read(&mut usb, ISTR) & 0x801F, CTR | 1);
    }

    #[test]
    fn other_addresses_and_endpoints_are_silent() {
        let mut usb = configured();
        assert_eq!(usb.send(6, 1, Toggle::Data0, b"x"), Answer::Nothing);
        assert_eq!(usb.send(5, 2, Toggle::Data0, b"x"), Answer::Nothing);
        write(&mut usb, DADDR, 5);
        assert_eq!(usb.send(5, 1, Toggle::Data0, b"x"), Answer::Nothing, "not enabled");
    }

    #[test]
    fn an_empty_status_stage_refuses_data() {
        let mut usb = configured();
        write(&mut usb, 0, CONTROL | EP_KIND | (1 << 12));
        assert_eq!(usb.send(5, 0, Toggle::Data0, b"x"), Answer::Stall);
        assert_eq!(usb.send(5, 0, Toggle::Data0, b""), Answer::Ack);
    }

    #[test]
    fn a_bus_reset_clears_all_but_the_events_and_silences_until_it_is_seen() {
        let mut usb = configured();
        write(&mut usb, CNTR, RESET);
        usb.send(5, 1, Toggle::Data0, b"x");
        usb.bus_reset();
        assert!(usb.irq_low());
        assert_eq!(read(&mut usb, 4), CTR_RX);
        assert_eq!(read(&mut usb, DADDR), 0);
        write(&mut usb, DADDR, EF);
        write(&mut usb, 0, CONTROL | (NAK << 12));
        assert_eq!(usb.setup(0, b"12345678"), Answer::Nothing);
        write(&mut usb, ISTR, !RESET);
        assert!(!usb.irq_low());
        assert_eq!(usb.setup(0, b"12345678"), Answer::Ack);
    }

    #[test]
    fn forcing_a_reset_is_a_reset() {
        let mut usb = configured();
        write(&mut usb, CNTR, FRES);
        assert_eq!(read(&mut usb, 4), 0);
        assert_eq!(read(&mut usb, ISTR) & RESET, RESET);
    }

    #[test]
    fn frames_count_at_the_hosts_pace_and_their_absence_suspends() {
        let mut usb = configured();
        write(&mut usb, CNTR, SUSP | WKUP);
        // A host clock 1000 ppm slow: 1998 frames start in just under two seconds.
        usb.start_frames(1.001e-3);
        usb.advance(2000 * MILLISECOND);
        assert_eq!(read(&mut usb, FNR) & 0x3FFF, LCK | 1998);
        assert!(!usb.irq_low(), "traffic keeps the device awake");
        assert_eq!((usb.take_frames(), usb.take_frames()), (1998, 0));
        usb.stop_frames();
        let last = usb.traffic;
        usb.advance(last + 3 * MILLISECOND);
        assert!(!usb.irq_low());
        assert_eq!(read(&mut usb, FNR) >> 11 & 3, 2, "lost frames");
        usb.advance(last + 3 * MILLISECOND + MILLISECOND / 4);
        assert_eq!(read(&mut usb, ISTR) & SUSP, SUSP);
        assert!(usb.irq_low());
        assert_eq!(usb.next_event(), None, "one suspend is enough");
    }

    #[test]
    fn a_sleeping_device_wakes_at_the_resume_signal_or_a_reset() {
        for wake in [Usb::resume, Usb::bus_reset] {
            let mut usb = configured();
            usb.advance(10 * MILLISECOND);
            assert_eq!(read(&mut usb, ISTR) & SUSP, SUSP);
            write(&mut usb, ISTR, 0);
            write(&mut usb, CNTR, FSUSP | LPMODE | WKUP);
            usb.advance(1000 * MILLISECOND);
            assert!(!usb.irq_low());
            wake(&mut usb);
            assert!(usb.irq_low() && usb.irq_wakeup());
            assert_eq!(read(&mut usb, CNTR) & LPMODE, 0);
            assert!(usb.sleeps(), "leaving the suspend state is the firmware's");
        }
    }

    #[test]
    fn a_device_that_was_woken_watches_for_frames_again() {
        let mut usb = configured();
        usb.advance(10 * MILLISECOND);
        write(&mut usb, ISTR, 0);
        write(&mut usb, CNTR, FSUSP);
        usb.resume();
        write(&mut usb, CNTR, 0);
        let woken = usb.now;
        usb.advance(woken + 4 * MILLISECOND);
        assert_eq!(read(&mut usb, ISTR) & SUSP, SUSP);
    }

    #[test]
    fn a_host_without_a_pull_up_against_it_is_a_reset() {
        let mut usb = configured();
        usb.set_cable(true);
        assert_eq!(read(&mut usb, ISTR) & RESET, 0);
        write(&mut usb, BCDR, 0);
        assert_eq!(read(&mut usb, ISTR) & RESET, RESET);
        write(&mut usb, ISTR, 0);
        write(&mut usb, BCDR, DPPU);
        assert_eq!(read(&mut usb, ISTR) & RESET, 0);
    }

    #[test]
    fn nothing_is_heard_while_switched_off() {
        let mut usb = Usb::default();
        usb.start_frames(1e-3);
        usb.bus_reset();
        usb.advance(10 * MILLISECOND);
        assert_eq!(read(&mut usb, ISTR), 0);
        assert!(!usb.attached());
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut usb = configured();
        let mut refused = |offset, value, width| usb.write(offset, value, width, 0).is_err();
        assert!(refused(0, ISOCHRONOUS.into(), Word));
        assert!(refused(4, (BULK | EP_KIND).into(), Word));
        assert!(refused(CNTR, RESUME.into(), Word));
        assert!(refused(BCDR, 1, Word));
        assert!(refused(0x20, 0, Word));
        assert!(refused(FNR, 0, Word));
        assert!(refused(MEMORY_OFFSET, 0, Word));
        assert!(refused(MEMORY_OFFSET, 0, Byte));
        assert!(refused(MEMORY_OFFSET + 1024, 0, Half));
        assert!(usb.read(MEMORY_OFFSET + 1024, Half, 0).is_err());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("USB", "EPR", CTR_RX, DTOG_RX, STAT_RX, SETUP, EP_TYPE, EP_KIND, CTR_TX, DTOG_TX, STAT_TX, EA);
        fields_agree!("USB", "CNTR", FRES, PDWN, LPMODE, FSUSP, RESUME, L1RESUME);
        fields_agree!("USB", "CNTR", SOFM = SOF, RESETM = RESET, CTRM = CTR);
        fields_agree!("USB", "ISTR", DIR, ESOF, SOF, RESET, SUSP, WKUP, CTR);
        fields_agree!("USB", "FNR", RXDP, LCK, FN);
        fields_agree!("USB", "DADDR", EF);
        fields_agree!("USB", "BCDR", DPPU);
    }
}
