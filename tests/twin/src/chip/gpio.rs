//! GPIO ports (RM0440 section 9.4).
//!
//! Modelled: mode, pull, input, output, set and reset registers, alternate functions. Output speed and type are
//! storage; locking is refused. A pin that is neither driven nor pulled reads low.

use crate::registers::refuse;
use crate::{Cycles, Modelled, Registers, Storage, Width};

registers! { u32:
    MODER 0x00,
    OTYPER 0x04,
    OSPEEDR 0x08,
    PUPDR 0x0c,
    IDR 0x10,
    ODR 0x14,
    BSRR 0x18,
    AFRL 0x20,
    AFRH 0x24,
    BRR 0x28,
}

/// The mode of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Digital input.
    Input,
    /// Output from ODR.
    Output,
    /// Assigned to the peripheral with this alternate function number (data sheet table).
    Alternate(u8),
    /// Analogue; the digital input is disabled.
    Analog,
}

/// One port of 16 pins.
#[derive(Clone, Debug)]
pub struct Gpio {
    storage: Storage,
    /// Pins that are driven externally, as a bit mask.
    driven: u16,
    /// Levels of those pins.
    levels: u16,
}

impl Gpio {
    /// Reset values of MODER, OSPEEDR and PUPDR; ports A and B have the debug pins.
    const fn reset_values(port: usize) -> (u32, u32, u32) {
        match port {
            0 => (0xabff_ffff, 0x0c00_0000, 0x6400_0000),
            1 => (0xffff_febf, 0x0000_00c0, 0x0000_0100),
            _ => (u32::MAX, 0, 0),
        }
    }

    /// The port with this number; port A is 0.
    pub fn new(port: usize) -> Self {
        let (mode, speed, pull) = Self::reset_values(port);
        // Programs read all of these to change the setting of one pin.
        let storage = Storage::shared(&[
            (MODER, mode, u32::MAX),
            (OTYPER, 0, 0xffff),
            (OSPEEDR, speed, u32::MAX),
            (PUPDR, pull, u32::MAX),
            (ODR, 0, 0xffff),
            (AFRL, 0, u32::MAX),
            (AFRH, 0, u32::MAX),
        ]);
        Self { storage, driven: 0, levels: 0 }
    }

    /// The mode of a pin.
    pub fn mode(&self, pin: usize) -> Mode {
        match self.storage[MODER] >> (2 * pin) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => {
                let register = if pin < 8 { AFRL } else { AFRH };
                Mode::Alternate((self.storage[register] >> (4 * (pin % 8)) & 0xf) as u8)
            }
            _ => Mode::Analog,
        }
    }

    /// Drives a pin externally to a level, or releases it.
    pub fn drive(&mut self, pin: usize, level: Option<bool>) {
        let bit = 1 << pin;
        self.driven = if level.is_some() { self.driven | bit } else { self.driven & !bit };
        self.levels = if level == Some(true) { self.levels | bit } else { self.levels & !bit };
    }

    /// Levels at the pins, as a bit mask.
    pub fn pins(&self) -> u16 {
        let mode = self.storage[MODER];
        let pull = self.storage[PUPDR];
        let output = self.storage[ODR];
        let open_drain = self.storage[OTYPER];
        (0..16).fold(0, |levels, pin| {
            let bit = |word: u32| word >> pin & 1 != 0;
            let pulled = pull >> (2 * pin) & 3 == 1;
            let outside = if bit(u32::from(self.driven)) { bit(u32::from(self.levels)) } else { pulled };
            let level = match mode >> (2 * pin) & 3 {
                1 if bit(open_drain) => bit(output) && outside,
                1 => bit(output),
                _ => outside,
            };
            levels | u16::from(level) << pin
        })
    }

    /// The level that an external circuit with a pull-up sees at a pin.
    pub fn output(&self, pin: usize) -> bool {
        let driven = self.mode(pin) == Mode::Output || self.driven >> pin & 1 != 0;
        !driven || self.pins() >> pin & 1 != 0
    }

    /// Value of IDR: analogue pins read zero.
    fn input(&self) -> u32 {
        let mode = self.storage[MODER];
        let digital = (0..16).filter(|pin| mode >> (2 * pin) & 3 != 3).fold(0, |mask, pin| mask | 1 << pin);
        u32::from(self.pins()) & digital
    }
}

impl Registers for Gpio {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        match register {
            IDR => Ok(self.input()),
            BSRR | BRR => Ok(0),
            _ => self.storage.load(register),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        let word = width.replace(0, offset, value);
        match offset & !3 {
            IDR => return refuse("the input register is read-only"),
            // Set has priority over reset.
            BSRR => self.storage[ODR] = self.storage[ODR] & !(word >> 16) | word & 0xffff,
            BRR => self.storage[ODR] &= !word,
            _ => return self.storage.write(offset, value, width, now),
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        self.storage.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    #[test]
    fn output_is_seen_at_the_pin_and_by_the_input_register() {
        let mut gpio = Gpio::new(2);
        assert!(gpio.output(6), "nobody drives it");
        write(&mut gpio, MODER, !(3 << 12) | 1 << 12, 0);
        assert!(!gpio.output(6));
        write(&mut gpio, BSRR, 1 << 6, 0);
        assert!(gpio.output(6));
        assert_eq!(gpio.read(IDR, Width::Word, 0), Ok(1 << 6));
        write(&mut gpio, BSRR, 1 << 22 | 1 << 6, 0);
        assert!(gpio.output(6), "setting wins over resetting");
        write(&mut gpio, BRR, 1 << 6, 0);
        assert!(!gpio.output(6));
    }

    #[test]
    fn input_pulls_and_analog() {
        let mut gpio = Gpio::new(1);
        gpio.drive(10, Some(true));
        assert_eq!(gpio.read(IDR, Width::Word, 0), Ok(1 << 4), "PB10 is analogue, PB4 pulled up for debugging");
        write(&mut gpio, MODER, 0, 0);
        assert_eq!(gpio.read(IDR, Width::Word, 0), Ok(1 << 10 | 1 << 4));
        assert_eq!(gpio.read(IDR + 1, Width::Byte, 0), Ok(4));
        gpio.drive(10, None);
        write(&mut gpio, PUPDR, 1 << 20, 0);
        assert_eq!(gpio.read(IDR, Width::Word, 0), Ok(1 << 10));
    }

    #[test]
    fn open_drain_only_pulls_down() {
        let mut gpio = Gpio::new(2);
        write(&mut gpio, MODER, 1, 0);
        write(&mut gpio, OTYPER, 1, 0);
        write(&mut gpio, BSRR, 1, 0);
        assert_eq!(gpio.pins() & 1, 0);
        gpio.drive(0, Some(true));
        assert_eq!(gpio.pins() & 1, 1);
        write(&mut gpio, BRR, 1, 0);
        assert_eq!(gpio.pins() & 1, 0);
    }

    #[test]
    fn alternate_functions() {
        let mut gpio = Gpio::new(0);
        write(&mut gpio, MODER, 2 << 30 | 2 << 4, 0);
        write(&mut gpio, AFRH, 1 << 28, 0);
        write(&mut gpio, AFRL, 12 << 8, 0);
        assert_eq!((gpio.mode(15), gpio.mode(2), gpio.mode(3)), (Mode::Alternate(1), Mode::Alternate(12), Mode::Input));
        assert!(refuses(&mut gpio, 0x1c, 0, 0), "locking is unknown");
    }
}
