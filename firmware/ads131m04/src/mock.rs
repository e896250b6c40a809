//! The chip's own side of the bus: a register-level model, byte by byte, without heap or clock.
//!
//! Drive it as the wires do: [`Chip::cs`], [`Chip::shift`], [`Chip::sync_reset`] with the time in CLKIN periods, and
//! [`Chip::convert`] whenever [`Chip::period_clkin`] CLKIN periods have passed. Used by this crate's tests and as the
//! twin's ADS131M04. It proves agreement with our reading of the data sheet, not with silicon. What the data sheet
//! leaves open and the model decides: a conversion without free room in the two-deep buffer pushes the oldest out; a
//! frame without a new conversion repeats the last; REG_MAP is set at once; STATUS flags that a STATUS word has
//! reported are cleared once all of it has been shifted out.
//!
//! Source: SBAS890, "Programming" and "Register Map".

use crate::driver::RESET_CLKIN;
use crate::filter::Osr;
use crate::frame::{CHANNELS, FRAME_BYTES, WORD_BYTES, crc, word};
use crate::registers::{Register, Status, cfg, clock, mode};

/// Registers up to and including the CRC of the map.
const REGISTERS: usize = 0x3F;
/// Longest frame taken: a write of every register, with CRC.
const LONGEST: usize = (REGISTERS + 2) * WORD_BYTES;

/// A chip.
#[derive(Clone, Debug)]
pub struct Chip {
    registers: [u16; REGISTERS],
    /// Flags of STATUS that are events.
    events: u16,
    /// Those that the frame on the wire reports.
    told: u16,
    locked: bool,
    standby: bool,
    /// Response that the frame now on the wire, or the next one, begins with; `None` is STATUS.
    response: Option<u16>,
    /// Registers that a read of several requests: address and number.
    listing: Option<(usize, usize)>,
    selected: bool,
    input: [u8; LONGEST],
    shifted: usize,
    output: [u8; LONGEST],
    /// Unread conversions, the oldest first.
    fifo: [[i32; CHANNELS]; 2],
    waiting: usize,
    last: [i32; CHANNELS],
    /// SYNC/RESET went low at this CLKIN period.
    low_since: Option<u64>,
}

impl Default for Chip {
    fn default() -> Self {
        Self::new()
    }
}

impl Chip {
    /// A chip just powered up.
    pub const fn new() -> Self {
        let mut registers = [0; REGISTERS];
        registers[Register::Id.address() as usize] = 0x2401;
        registers[Register::Mode.address() as usize] = mode::RESET | mode::WLENGTH_24 | mode::TIMEOUT;
        registers[Register::Clock.address() as usize] =
            clock::ALL_CHANNELS | (Osr::X1024 as u16) << clock::OSR_SHIFT | 2;
        registers[Register::Cfg.address() as usize] = cfg::GC_DLY_16;
        let mut channel = 0;
        while channel < CHANNELS {
            registers[0x0C + 5 * channel] = 0x8000;
            channel += 1;
        }
        Self {
            registers,
            events: 0,
            told: 0,
            locked: false,
            standby: false,
            response: Some(word::RESET_DONE | CHANNELS as u16),
            listing: None,
            selected: false,
            input: [0; LONGEST],
            shifted: 0,
            output: [0; LONGEST],
            fifo: [[0; CHANNELS]; 2],
            waiting: 0,
            last: [0; CHANNELS],
            low_since: None,
        }
    }

    /// Register by address; 0 for one that does not exist.
    pub fn register(&self, address: u8) -> u16 {
        if address == Register::Status.address() { self.status().0 } else { self.at(address as usize) }
    }

    /// Overwrites a register without a command, as a disturbance would.
    pub fn disturb_register(&mut self, address: u8, value: u16) {
        if let Some(register) = self.registers.get_mut(address as usize) {
            *register = value;
            self.map_changed();
        }
    }

    /// STATUS as it is now.
    pub fn status(&self) -> Status {
        let mode = self.read(Register::Mode);
        let mut status = self.events | mode & (Status::CRC_TYPE | Status::RESET | Status::WLENGTH);
        if self.locked {
            status |= Status::LOCK;
        }
        if self.waiting > 0 {
            status |= self.read(Register::Clock) >> 8 & Status::DRDY;
        }
        Status(status)
    }

    /// Level of DRDY: low while a conversion waits. Each [`convert`](Self::convert) makes a falling edge, whatever the
    /// level was.
    pub fn drdy(&self) -> bool {
        self.waiting == 0
    }

    /// Oversampling ratio set.
    pub fn osr(&self) -> Osr {
        Osr::ALL[(self.read(Register::Clock) >> clock::OSR_SHIFT & 7) as usize]
    }

    /// Full scale of a channel \[V\].
    pub fn full_scale_v(&self, channel: usize) -> f64 {
        let gain = self.read(Register::Gain) >> (4 * channel) & 7;
        1.2 / f64::from(1_u16 << gain)
    }

    /// Code of a voltage between the inputs of a channel, rounded, clamped to the range.
    pub fn code(&self, channel: usize, volts: f64) -> i32 {
        let code = volts / self.full_scale_v(channel) * 8_388_608.0;
        // `as` saturates and converts NaN to 0.
        ((code + if code < 0.0 { -0.5 } else { 0.5 }) as i32).clamp(-0x80_0000, 0x7F_FFFF)
    }

    /// CLKIN periods from one conversion to the next; `None` in standby and while SYNC/RESET is low.
    pub fn period_clkin(&self) -> Option<u32> {
        (!self.standby && self.low_since.is_none()).then(|| self.osr().period_clkin())
    }

    /// Moves SYNC/RESET, `now` being the CLKIN periods since power was applied. A stopped clock resets nothing.
    pub fn sync_reset(&mut self, high: bool, now: u64) {
        if !high {
            self.low_since.get_or_insert(now);
            return;
        }
        match self.low_since.take().map(|since| now.saturating_sub(since)) {
            Some(periods) if periods >= RESET_CLKIN as u64 => *self = Self::new(),
            Some(1..) => self.resynchronise(),
            _ => {}
        }
    }

    /// Power fails and returns.
    pub fn power_cycle(&mut self) {
        *self = Self::new();
    }

    /// A conversion is done: codes of the channels before offset and trim.
    pub fn convert(&mut self, codes: [i32; CHANNELS]) {
        if self.standby || self.low_since.is_some() {
            return;
        }
        let enabled = self.read(Register::Clock) >> 8;
        for (channel, code) in codes.into_iter().enumerate() {
            let wide = |high: usize| {
                let base = high + 5 * channel;
                i64::from(u32::from(self.at(base)) << 8 | u32::from(self.at(base + 1)) >> 8)
            };
            let offset = (wide(0x0A) ^ 0x80_0000) - 0x80_0000;
            let trimmed = ((i64::from(code) - offset) * wide(0x0C)) >> 23;
            self.last[channel] =
                if enabled >> channel & 1 == 1 { trimmed.clamp(-0x80_0000, 0x7F_FFFF) as i32 } else { 0 };
        }
        if self.waiting == self.fifo.len() {
            self.fifo.rotate_left(1);
            self.waiting -= 1;
        }
        self.fifo[self.waiting] = self.last;
        self.waiting += 1;
    }

    /// Chip select moves; `true` is low, selected.
    pub fn cs(&mut self, low: bool) {
        if low == self.selected {
            return;
        }
        self.selected = low;
        if low { self.begin() } else { self.end() }
    }

    /// One byte each way. When not selected, the chip does not drive the line: 0xFF, from a pull-up.
    pub fn shift(&mut self, mosi: u8) -> u8 {
        if !self.selected {
            return 0xFF;
        }
        let miso = self.output.get(self.shifted).copied().unwrap_or(0);
        if let Some(byte) = self.input.get_mut(self.shifted) {
            *byte = mosi;
        }
        self.shifted = self.shifted.saturating_add(1);
        miso
    }

    fn at(&self, address: usize) -> u16 {
        self.registers.get(address).copied().unwrap_or(0)
    }

    fn read(&self, register: Register) -> u16 {
        self.at(register.address() as usize)
    }

    fn map_changed(&mut self) {
        if self.read(Register::Mode) & mode::REGCRC_EN != 0 {
            self.events |= Status::REG_MAP;
        }
    }

    fn resynchronise(&mut self) {
        self.waiting = 0;
        self.events |= Status::F_RESYNC;
    }

    /// Lays out what will be shifted out.
    fn begin(&mut self) {
        let mut output = [0; LONGEST];
        let mut end = 0;
        let mut put = |bytes: [u8; WORD_BYTES]| {
            if let Some(place) = output.get_mut(end..end + WORD_BYTES) {
                place.copy_from_slice(&bytes);
                end += WORD_BYTES;
            }
        };
        self.told = if self.response.is_none() { self.events } else { 0 };
        put(padded(self.response.unwrap_or(self.status().0)));
        if let Some((address, number)) = self.listing {
            for offset in 0..number {
                put(padded(self.register((address + offset) as u8)));
            }
        } else {
            for code in if self.waiting > 0 { self.fifo[0] } else { self.last } {
                let [_, high, middle, low] = code.to_be_bytes();
                put([high, middle, low]);
            }
        }
        if let Some((body, rest)) = output.split_at_mut_checked(end)
            && let Some(place) = rest.first_chunk_mut()
        {
            *place = padded(crc(body));
        }
        self.shifted = 0;
        self.input = [0; LONGEST];
        self.output = output;
    }

    /// Executes what was shifted in.
    fn end(&mut self) {
        if self.shifted < WORD_BYTES {
            return;
        }
        self.events &= !self.told;
        if self.listing.is_none() && self.shifted >= FRAME_BYTES && self.waiting > 0 {
            self.fifo.rotate_left(1);
            self.waiting -= 1;
        }
        self.response = None;
        self.listing = None;

        let command = u16::from_be_bytes([self.input[0], self.input[1]]);
        let (address, number) = ((command >> 7 & 0x3F) as usize, (command & 0x7F) as usize + 1);
        let is_write = command & 0xE000 == word::WRITE;
        let body = if is_write { (1 + number) * WORD_BYTES } else { WORD_BYTES };
        let checked = self.read(Register::Mode) & mode::RX_CRC_EN != 0;
        let sound = match self.input.get(body..body + 2) {
            Some(check) => u16::from_be_bytes([check[0], check[1]]) == crc(&self.input[..body]),
            None => false,
        };
        let accepted = !checked || (sound && self.shifted >= body + WORD_BYTES);
        if !accepted {
            self.events |= Status::CRC_ERR;
        }
        if is_write {
            // Registers are written as they come in, before the CRC is known.
            let written = if self.locked { 0 } else { self.write(address, number) };
            if accepted && !self.locked {
                self.response =
                    Some(word::WRITTEN | (address as u16) << 7 | u16::try_from(written).unwrap_or(0).saturating_sub(1));
            }
            return;
        }
        if !accepted {
            return;
        }
        match command {
            word::UNLOCK => self.locked = false,
            _ if command & 0xE000 == word::READ => {
                if number == 1 {
                    self.response = Some(self.register(address as u8));
                } else {
                    self.response = Some(command | 0x4000);
                    self.listing = Some((address, number));
                }
                return;
            }
            _ if self.locked => return,
            word::RESET if self.shifted >= FRAME_BYTES => {
                *self = Self::new();
                return;
            }
            word::STANDBY => {
                self.standby = true;
                self.waiting = 0;
            }
            word::WAKEUP => self.standby = false,
            word::LOCK => self.locked = true,
            _ => return,
        }
        self.response = Some(command);
    }

    fn write(&mut self, address: usize, number: usize) -> usize {
        let mut written = 0;
        for offset in 0..number {
            let place = (1 + offset) * WORD_BYTES;
            let whole = self.shifted >= place + WORD_BYTES;
            let (true, Some(bytes)) = (whole, self.input.get(place..place + 2)) else { break };
            let value = u16::from_be_bytes([bytes[0], bytes[1]]);
            let target = address + offset;
            // Read-only, reserved or nonexistent: accepted and counted, without effect.
            let mask = match target {
                0x02 => 0x3F1F,
                0x03 => 0x0F3F,
                0x04 => 0x7777,
                0x06 => 0x1FFF,
                0x07 => 0xFFFF,
                0x08 => 0xFF0F,
                0x09..=0x1C => match (target - 0x09) % 5 {
                    0 => 0xFFC7,
                    1 | 3 => 0xFFFF,
                    _ => 0xFF00,
                },
                _ => 0,
            };
            if mask != 0 {
                let changed = self.registers[target] != value & mask;
                self.registers[target] = value & mask;
                if changed {
                    self.map_changed();
                }
                if changed && target == Register::Clock.address() as usize {
                    self.resynchronise();
                }
            }
            written += 1;
        }
        written
    }
}

/// A word of 16 bits.
fn padded(value: u16) -> [u8; WORD_BYTES] {
    let [high, low] = value.to_be_bytes();
    [high, low, 0]
}
