//! The STM32G474RE: every peripheral, the memories, and the connections between them.
//!
//! The bus ([`Chip::read`], [`Chip::write`]) selects the peripheral by address (RM0440 table 3), checks that its clock
//! is on, and ends the run at an access that no model handles. Interrupt requests are levels ([`Chip::irq_lines`];
//! numbers from RM0440 table 97). Time passes in [`Chip::advance`], which must be called no later than
//! [`Chip::next_event`].

/// Asserts that constants of a model match metapac's fields: those of the same name, or each by `FIELD = constant`.
#[cfg(test)]
macro_rules! fields_agree {
    ($of:literal, $register:literal, $($name:ident),+) => {
        fields_agree!($of, $register, $($name = $name),+)
    };
    ($of:literal, $register:literal, $($name:ident = $bits:expr),+) => {
        crate::metapac::fields_agree($of, $register, &[$((stringify!($name), $bits)),+])
    };
}

pub mod adc;
pub mod ads131m04;
pub mod clocks;
pub mod crs;
pub mod dac;
pub mod dbgmcu;
pub mod dma;
pub mod dmamux;
pub mod errata;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod iwdg;
pub mod jumpers;
pub mod lpuart;
mod pin;
mod pipeline;
pub mod pwr;
pub mod ram;
pub mod rcc;
pub mod rom;
pub mod rules;
mod run;
pub mod spi;
pub mod syscfg;
pub mod tamp;
pub mod tim;
pub mod tim6;
pub mod usb;

use crate::{Board, Cycles, Modelled, Registers, Storage, Unknown, Width, World};
use clocks::Clocks;
use errata::Errata;
use gpio::{Gpio, Mode};
pub use pin::Pin;
use ram::Ram;
use rcc::{AHB1ENR, AHB2ENR, APB1ENR1, APB1ENR2, APB2ENR, Gate, Reset};
use rules::Rules;
use tim::{Kind, Tim};

/// First address of SRAM1.
pub const RAM_START: u32 = 0x2000_0000;
/// Length of the RAM \[bytes\]: SRAM1, SRAM2 and, after them, the alias of the CCM SRAM.
pub const RAM_LEN: usize = 128 << 10;
/// First address of the CCM SRAM, which is the last 32 KB of the above.
pub const CCM_START: u32 = 0x1000_0000;
/// Length of the CCM SRAM \[bytes\].
pub const CCM_LEN: usize = 32 << 10;

/// An access that no model handles.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} {address:#010x} ({}{} bytes): {what}", access(*value), place(peripheral, *offset), width.bytes())]
pub struct BadAccess {
    /// Address of the access.
    pub address: u32,
    /// Name of the peripheral; empty if there is none at that address.
    pub peripheral: &'static str,
    /// Offset from its base.
    pub offset: u32,
    /// Width of the access.
    pub width: Width,
    /// The value written; none for a read.
    pub value: Option<u32>,
    /// The model's message.
    pub what: &'static str,
}

fn access(value: Option<u32>) -> String {
    value.map_or_else(|| "read of".into(), |value| format!("write of {value:#x} to"))
}

fn place(peripheral: &str, offset: u32) -> String {
    if peripheral.is_empty() { String::new() } else { format!("{peripheral} + {offset:#x}, ") }
}

/// An address range of one peripheral.
struct Block {
    start: u32,
    end: u32,
    name: &'static str,
    gate: Option<Gate>,
    model: fn(&mut Chip) -> &mut dyn Registers,
}

/// Makes the table of blocks from the address, length, name, clock gate and model of each. `next_event` and `advance`,
/// which are asked at each access of the core, are called directly: most models have none.
macro_rules! blocks {
    ($($start:literal $len:literal $name:literal ($gate:expr) $field:ident $([$index:literal])?;)+) => {
        const BLOCKS: &[Block] = &[$(Block {
            start: $start,
            end: $start + $len,
            name: $name,
            gate: $gate,
            model: |chip| &mut chip.$field $([$index])?,
        }),+];

        impl Chip {
            fn next_event_of_models(&self) -> Option<Cycles> {
                [$(self.$field $([$index])?.next_event()),+].into_iter().flatten().min()
            }

            fn advance_models(&mut self, now: Cycles) {
                $(self.$field $([$index])?.advance(now);)+
            }
        }
    };
}

// Sorted by address. The clock of a block without a gate is always on.
blocks! {
    0x4000_0000 0x400 "TIM2" (gate(APB1ENR1, 0)) tim2;
    0x4000_0400 0x400 "TIM3" (gate(APB1ENR1, 1)) tim3;
    0x4000_0800 0x400 "TIM4" (gate(APB1ENR1, 2)) tim4;
    0x4000_0c00 0x400 "TIM5" (gate(APB1ENR1, 3)) tim5;
    0x4000_1000 0x400 "TIM6" (gate(APB1ENR1, 4)) tim6;
    0x4000_1400 0x400 "TIM7" (gate(APB1ENR1, 5)) tim7;
    0x4000_2000 0x400 "CRS" (gate(APB1ENR1, 8)) crs;
    0x4000_2400 0x400 "TAMP" (gate(APB1ENR1, 10)) tamp;
    0x4000_3000 0x400 "IWDG" (None) iwdg;
    0x4000_3800 0x400 "SPI2" (gate(APB1ENR1, 14)) spi2;
    // Registers, then the packet memory at offset 0x400.
    0x4000_5c00 0x800 "USB" (gate(APB1ENR1, 23)) usb;
    0x4000_7000 0x400 "PWR" (gate(APB1ENR1, 28)) pwr;
    0x4000_8000 0x400 "LPUART1" (gate(APB1ENR2, 0)) lpuart1;
    0x4001_0000 0x30 "SYSCFG" (gate(APB2ENR, 0)) syscfg;
    0x4001_0400 0x400 "EXTI" (None) exti;
    0x4001_2c00 0x400 "TIM1" (gate(APB2ENR, 11)) tim1;
    0x4001_3400 0x400 "TIM8" (gate(APB2ENR, 13)) tim8;
    0x4001_4000 0x400 "TIM15" (gate(APB2ENR, 16)) tim15;
    0x4001_4400 0x400 "TIM16" (gate(APB2ENR, 17)) tim16;
    0x4001_4800 0x400 "TIM17" (gate(APB2ENR, 18)) tim17;
    0x4002_0000 0x400 "DMA1" (gate(AHB1ENR, 0)) dma[0];
    0x4002_0400 0x400 "DMA2" (gate(AHB1ENR, 1)) dma[1];
    0x4002_0800 0x400 "DMAMUX" (gate(AHB1ENR, 2)) dmamux;
    0x4002_1000 0x400 "RCC" (None) rcc;
    0x4002_2000 0x400 "FLASH" (gate(AHB1ENR, 8)) flash;
    0x4800_0000 0x400 "GPIOA" (gate(AHB2ENR, 0)) gpio[0];
    0x4800_0400 0x400 "GPIOB" (gate(AHB2ENR, 1)) gpio[1];
    0x4800_0800 0x400 "GPIOC" (gate(AHB2ENR, 2)) gpio[2];
    0x4800_0c00 0x400 "GPIOD" (gate(AHB2ENR, 3)) gpio[3];
    0x4800_1000 0x400 "GPIOE" (gate(AHB2ENR, 4)) gpio[4];
    0x4800_1400 0x400 "GPIOF" (gate(AHB2ENR, 5)) gpio[5];
    0x4800_1800 0x400 "GPIOG" (gate(AHB2ENR, 6)) gpio[6];
    // ADC1, ADC2 and their common registers; ADC3 to ADC5, which follow, have their own gate.
    0x5000_0000 0x800 "ADC" (gate(AHB2ENR, 13)) adc;
    0x5000_0800 0x400 "DAC1" (gate(AHB2ENR, 16)) dac[0];
    0x5000_0c00 0x400 "DAC2" (gate(AHB2ENR, 17)) dac[1];
    0xe004_2000 0x400 "DBGMCU" (None) dbgmcu;
}

const fn gate(register: u32, bit: u32) -> Option<Gate> {
    Some(Gate(register, bit))
}

/// Ports A to G.
const GPIO: std::ops::Range<u32> = 0x4800_0000..0x4800_1c00;
/// ADC3, ADC4, ADC5.
const ADC345: std::ops::Range<u32> = 0x5000_0400..0x5000_0800;
const ADC345_GATE: Gate = Gate(AHB2ENR, 14);

/// Bit-band region: each word is an alias of one bit of the first megabyte of peripherals.
const BIT_BAND: std::ops::Range<u32> = 0x4200_0000..0x4400_0000;

/// RCC_BDCR, which is in the backup domain.
const RCC_BDCR: u32 = 0x4002_1090;
/// RCC_CFGR, which selects the system clock.
const RCC_CFGR: u32 = 0x4002_1008;

/// The clock of the peripheral is off in RCC.
pub const CLOCK_OFF: Unknown = Unknown { what: "the peripheral's clock is off" };
const BACKUP_SHUT: Unknown = Unknown { what: "the backup domain is write-protected (PWR_CR1.DBP)" };
/// No register block at this address.
pub const NOTHING: Unknown = Unknown { what: "no peripheral at this address" };

/// Numbers of the interrupts of the channels 1 to 8 of both DMA controllers (RM0440 table 97).
const DMA_INTERRUPTS: [[u32; 8]; 2] = [[11, 12, 13, 14, 15, 16, 17, 96], [56, 57, 58, 59, 60, 97, 98, 99]];

/// Inputs of TIM2: pin, alternate function, channel (DS12288 table 13).
pub const TIM2_INPUTS: [(Pin, u8, usize); 11] = [
    (Pin::new('A', 0), 1, 1),
    (Pin::new('A', 5), 1, 1),
    (Pin::new('A', 15), 1, 1),
    (Pin::new('A', 1), 1, 2),
    (Pin::new('B', 3), 1, 2),
    (Pin::new('A', 2), 1, 3),
    (Pin::new('B', 10), 1, 3),
    (Pin::new('A', 9), 10, 3),
    (Pin::new('A', 3), 1, 4),
    (Pin::new('B', 11), 1, 4),
    (Pin::new('A', 10), 10, 4),
];
/// PA2 and PA3 as LPUART1 (DS12288 table 13).
const LPUART1_FUNCTION: Mode = Mode::Alternate(12);

/// The chip with everything connected to it.
pub struct Chip {
    /// SRAM1, SRAM2, CCM SRAM.
    pub ram: Ram,
    /// Flash memory, its controller and the option bytes.
    pub flash: flash::Flash,
    /// Clock frequencies in use.
    pub clocks: Clocks,
    /// The world outside the pins.
    pub world: Box<dyn World>,
    /// The circuit around the chip.
    pub board: Board,
    /// Reset and clock control.
    pub rcc: rcc::Rcc,
    /// Power control.
    pub pwr: pwr::Pwr,
    /// Ports A to G.
    pub gpio: [Gpio; 7],
    /// System configuration.
    pub syscfg: syscfg::Syscfg,
    /// Extended interrupts.
    pub exti: exti::Exti,
    /// Independent watchdog.
    pub iwdg: iwdg::Iwdg,
    /// Clock recovery.
    pub crs: crs::Crs,
    /// Backup registers.
    pub tamp: tamp::Tamp,
    /// Debug support.
    pub dbgmcu: Storage,
    /// Serial link.
    pub lpuart1: lpuart::Lpuart,
    /// Advanced-control timer.
    pub tim1: Tim,
    /// General-purpose timer; counts the encoder.
    pub tim2: Tim,
    /// General-purpose timer.
    pub tim3: Tim,
    /// General-purpose timer.
    pub tim4: Tim,
    /// General-purpose timer of 32 bits.
    pub tim5: Tim,
    /// Advanced-control timer.
    pub tim8: Tim,
    /// General-purpose timer of two channels.
    pub tim15: Tim,
    /// General-purpose timer of one channel.
    pub tim16: Tim,
    /// General-purpose timer of one channel.
    pub tim17: Tim,
    /// DMA1 and DMA2.
    pub dma: [dma::Dma; 2],
    /// DMA request multiplexer.
    pub dmamux: dmamux::Dmamux,
    /// DMA transfers since power-on.
    pub transfers: u64,
    /// ADC1 to ADC5 and their common registers.
    pub adc: adc::Adcs,
    /// The sampling clock.
    pub tim6: tim6::Tim6,
    /// Timer of the player, which drives the DACs.
    pub tim7: tim6::Tim6,
    /// DAC1 and DAC2.
    pub dac: [dac::Dac; 2],
    /// Wires from outputs to inputs; they replace the world.
    pub jumpers: Option<jumpers::Jumpers>,
    /// Injected faults.
    pub planted: jumpers::Planted,
    wired: jumpers::Wired,
    /// Pending delayed ADC triggers: when each is due, and its converter.
    late: std::collections::VecDeque<(Cycles, adc::Unit)>,
    /// SPI bus of the ADS131M04.
    pub spi2: spi::Spi,
    /// The digital front end, if one is connected.
    pub ads131m04: Option<ads131m04::Ads131m04>,
    /// USB full-speed device and its packet memory.
    pub usb: usb::Usb,
    /// Changes of the LED: time, and whether it is on from then.
    pub light: Vec<(Cycles, bool)>,
    /// Errata in force.
    errata: Errata,
    /// How strictly the model treats violations by the program.
    rules: Rules,
    /// Access by the signal path that failed; it stops the path.
    path_fault: Option<BadAccess>,
    /// No event is due before this time.
    due: Cycles,
    /// An event may have come forward since [`Self::next_event`] was last asked, other than by a write of the core.
    pub(crate) has_moved: bool,
}

impl Chip {
    /// A powered chip before its first start.
    pub fn new(board: Board, world: Box<dyn World>) -> Self {
        Self {
            ram: Ram::new(RAM_LEN, 0),
            flash: Default::default(),
            clocks: Clocks::POWER_ON,
            world,
            board,
            rcc: rcc::Rcc::new(board.hse_hz),
            pwr: Default::default(),
            gpio: std::array::from_fn(Gpio::new),
            syscfg: Default::default(),
            exti: Default::default(),
            iwdg: Default::default(),
            crs: Default::default(),
            tamp: Default::default(),
            dbgmcu: dbgmcu::registers(),
            lpuart1: Default::default(),
            tim1: Tim::new(Kind::Advanced),
            tim2: Tim::new(Kind::Wide),
            tim3: Tim::new(Kind::General),
            tim4: Tim::new(Kind::General),
            tim5: Tim::new(Kind::Wide).with_lsi(),
            tim8: Tim::new(Kind::Advanced),
            tim15: Tim::new(Kind::Small),
            tim16: Tim::new(Kind::Single),
            tim17: Tim::new(Kind::Single),
            dma: Default::default(),
            dmamux: Default::default(),
            transfers: 0,
            adc: Default::default(),
            tim6: Default::default(),
            tim7: Default::default(),
            dac: Default::default(),
            jumpers: None,
            planted: Default::default(),
            wired: Default::default(),
            late: Default::default(),
            spi2: Default::default(),
            ads131m04: None,
            usb: Default::default(),
            light: Vec::new(),
            errata: Errata::NONE,
            rules: Rules::Enforced,
            path_fault: None,
            due: 0,
            has_moved: true,
        }
    }

    /// Seconds since power was first applied.
    pub fn seconds(&self, at: Cycles) -> f64 {
        self.clocks.seconds(at)
    }

    /// Bytes of RAM or flash for a DMA read; none if the range is in neither.
    pub fn bytes(&self, address: u32, len: usize) -> Option<&[u8]> {
        let (memory, start) = match ram_offset(address) {
            Some(start) => (self.ram.bytes(), start),
            None => (self.flash.bytes(), address.checked_sub(flash::START)? as usize),
        };
        memory.get(start..start.checked_add(len)?)
    }

    /// Bytes of RAM for a DMA write; none if the range is not in RAM.
    pub fn ram_mut(&mut self, address: u32, len: usize) -> Option<&mut [u8]> {
        let start = ram_offset(address)?;
        self.ram.bytes_mut().get_mut(start..start.checked_add(len)?)
    }

    /// Writes this value for the core or for DMA or, if there is none, reads. Returns the word read; 0 for a write.
    pub(crate) fn bus(
        &mut self,
        address: u32,
        width: Width,
        value: Option<u32>,
        now: Cycles,
    ) -> Result<u32, BadAccess> {
        if let Some((word, bit)) = bit_band(address) {
            // The bit-band write reads and writes the whole word, whatever the width of the access (DDI 0439, 3.7).
            let old = self.bus(word, Width::Word, None, now)?;
            let Some(value) = value else { return Ok(old >> bit & 1) };
            let new = old & !(1 << bit) | (value & 1) << bit;
            return self.bus(word, Width::Word, Some(new), now);
        }
        let block = find(address);
        let (peripheral, start) = match block {
            Some(block) => (block.name, block.start),
            None if in_flash(address) => ("flash memory", flash::START),
            None => ("", address),
        };
        let offset = address - start;
        let outcome = match (block, value) {
            (Some(block), None) => self.read_register(block, offset, width, now),
            (Some(block), Some(value)) => self.write_register(block, offset, value, width, now).map(|()| 0),
            (None, _) if !in_flash(address) => Err(NOTHING),
            (None, None) => {
                // Damage that is read raises the NMI later.
                self.has_moved = true;
                self.flash.read_memory(address, width, now)
            }
            (None, Some(value)) => self.flash.write_memory(address, value, width, now).map(|()| 0),
        };
        outcome.map_err(|Unknown { what }| BadAccess { address, peripheral, offset, width, value, what })
    }

    fn is_clocked(&self, block: &Block, offset: u32) -> bool {
        let gate = if ADC345.contains(&(block.start + offset)) { Some(ADC345_GATE) } else { block.gate };
        gate.is_none_or(|gate| self.rcc.is_on(gate) && !self.rcc.is_reset(gate))
    }

    fn read_register(&mut self, block: &Block, offset: u32, width: Width, now: Cycles) -> Modelled<u32> {
        if !self.is_clocked(block, offset) {
            match (self.rules, block.name) {
                (Rules::Enforced, _) => return Err(CLOCK_OFF),
                // The PWR registers are in a domain that is always clocked.
                (Rules::AsOnTheChip, "PWR") => {}
                (Rules::AsOnTheChip, _) => return Ok(0),
            }
        }
        if block.name == "TIM2" {
            self.latch_encoder(now);
        }
        (block.model)(self).read(offset, width, now)
    }

    fn write_register(&mut self, block: &Block, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        let in_backup = block.name == "TAMP" || block.start + offset == RCC_BDCR;
        let refused = match (self.is_clocked(block, offset), in_backup && !self.pwr.backup_is_open()) {
            (false, _) => Some(CLOCK_OFF),
            (true, true) => Some(BACKUP_SHUT),
            (true, false) => None,
        };
        if let Some(what) = refused {
            return if self.rules == Rules::Enforced { Err(what) } else { Ok(()) };
        }
        match block.name {
            "RCC" => {
                self.rcc.write(offset, value, width, now)?;
                self.reset_held(now);
                self.change_clocks(now)
            }
            "PWR" | "FLASH" => {
                (block.model)(self).write(offset, value, width, now)?;
                self.rcc.check(&self.clocks, self.pwr.boost(), self.flash.wait_states())
            }
            _ if GPIO.contains(&block.start) => {
                let port = ((block.start - GPIO.start) / 0x400) as usize;
                let before = self.gpio[port].pins();
                self.gpio[port].write(offset, value, width, now)?;
                self.pins_changed(port, before, now);
                self.follow_jumpers();
                Ok(())
            }
            "TIM2" => {
                self.latch_encoder(now);
                self.tim2.write(offset, value, width, now)
            }
            _ => (block.model)(self).write(offset, value, width, now),
        }
    }

    /// Resets the peripherals that RCC holds in reset.
    fn reset_held(&mut self, now: Cycles) {
        for block in BLOCKS {
            if block.gate.is_some_and(|gate| self.rcc.is_reset(gate)) {
                (block.model)(self).reset(now);
            }
        }
    }

    fn change_clocks(&mut self, now: Cycles) -> Modelled {
        let clocks = self.rcc.clocks(now, self.clocks.seconds(now));
        self.rcc.check(&clocks, self.pwr.boost(), self.flash.wait_states())?;
        let same = Clocks { since: self.clocks.since, since_s: self.clocks.since_s, ..clocks } == self.clocks;
        if !same {
            self.use_clocks(clocks, now);
        }
        Ok(())
    }

    fn use_clocks(&mut self, clocks: Clocks, now: Cycles) {
        self.clocks = clocks;
        for block in BLOCKS {
            let model = (block.model)(self);
            model.advance(now);
            model.set_clocks(&clocks);
        }
    }

    /// Sets the errata that apply from now on; a new chip has none.
    pub fn set_errata(&mut self, errata: Errata) {
        self.errata = errata;
        self.flash.errata = errata;
        self.adc.errata = errata;
        self.rcc.errata = errata;
        self.spi2.errata = errata;
        self.dma.iter_mut().for_each(|dma| dma.errata = errata);
    }

    /// Sets how strictly the model treats violations from now on; a new chip enforces the rules.
    pub fn set_rules(&mut self, rules: Rules) {
        self.rules = rules;
        self.rcc.rules = rules;
        self.flash.rules = rules;
        self.adc.rules = rules;
    }

    /// The errata in force.
    pub fn errata(&self) -> Errata {
        self.errata
    }

    /// Removes supply and battery. RAM content is undefined when power returns: here a pattern from the seed.
    pub fn lose_power(&mut self, seed: u64) {
        self.flash.lose_power();
        self.tamp.lose_power();
        self.rcc.lose_power(self.board.hse_hz);
        let mut state = seed | 1;
        for bytes in self.ram.bytes_mut().chunks_exact_mut(8) {
            bytes.copy_from_slice(&ram::xorshift(&mut state).to_le_bytes());
        }
    }

    /// The reset that the chip itself requests, if any.
    pub fn reset_wanted(&self) -> Option<Reset> {
        if self.iwdg.bites() { Some(Reset::Watchdog) } else { self.flash.launch.then_some(Reset::OptionBytes) }
    }

    /// Whether a peripheral requests the NMI.
    pub fn nmi(&self) -> bool {
        self.flash.nmi() || self.rcc.crystal_failed
    }

    /// Sets the external level at a pin.
    pub fn set_pin(&mut self, pin: Pin, level: bool, now: Cycles) {
        let before = self.gpio[pin.port].pins();
        self.gpio[pin.port].drive(pin.number, Some(level));
        self.pins_changed(pin.port, before, now);
    }

    /// The level that an external circuit with a pull-up sees at a pin.
    pub fn pin_output(&self, pin: Pin) -> bool {
        self.gpio[pin.port].output(pin.number)
    }

    /// The mode of a pin.
    pub fn pin_mode(&self, pin: Pin) -> Mode {
        self.gpio[pin.port].mode(pin.number)
    }

    fn pins_changed(&mut self, port: usize, before: u16, now: Cycles) {
        let after = self.gpio[port].pins();
        let mut changed = before ^ after;
        while changed != 0 {
            let number = changed.trailing_zeros() as usize;
            changed &= changed - 1;
            let rising = after >> number & 1 != 0;
            if self.syscfg.exti_port(number) == port {
                self.exti.edge(number, rising);
            }
            let pin = Pin { port, number };
            let mode = self.gpio[port].mode(number);
            for (_, _, channel) in TIM2_INPUTS.iter().filter(|input| input.0 == pin && mode == Mode::Alternate(input.1))
            {
                self.latch_encoder(now);
                self.tim2.edge(*channel, rising);
            }
            if pin == self.board.led {
                self.light.push((now, rising));
            }
        }
    }

    /// Whether the encoder's pins are connected to TIM2.
    pub(crate) fn encoder_is_wired(&self) -> bool {
        let leads_to = |pin: Pin, channel: usize| {
            let mode = self.pin_mode(pin);
            TIM2_INPUTS.iter().any(|input| input.0 == pin && input.2 == channel && mode == Mode::Alternate(input.1))
        };
        leads_to(self.board.encoder_a, 1) && leads_to(self.board.encoder_b, 2)
    }

    /// Passes the output levels through the wires to the encoder's inputs.
    fn follow_jumpers(&mut self) {
        let Some(jumpers) = self.jumpers else { return };
        // The inputs have pull-ups.
        let level = |pin: Option<Pin>| pin.is_none_or(|pin| self.pin_mode(pin) != Mode::Output || self.pin_output(pin));
        let levels = (level(jumpers.a), level(jumpers.b));
        self.wired.follow(levels);
        if self.planted.lost_edge.take_if(|count| *count == self.wired.count).is_some() {
            self.wired.count = self.wired.count.wrapping_sub(1);
        }
    }

    /// The encoder's position, from the wires if there are any, else from the world.
    fn encoder_count(&mut self, time_s: f64) -> u32 {
        let count = if self.jumpers.is_some() { self.wired.count } else { self.world.encoder(time_s) };
        if self.planted.half_counts { (count as i32 >> 1) as u32 } else { count }
    }

    /// Sets TIM2's counter to the encoder's position, if its pins are connected.
    fn latch_encoder(&mut self, now: Cycles) {
        if self.encoder_is_wired() {
            let time_s = self.seconds(now);
            let count = self.encoder_count(time_s);
            self.tim2.set_encoder(count);
        }
    }

    /// Sends bytes from the computer on the serial link. Nothing arrives if the pin is not assigned to LPUART1.
    pub fn serial_send(&mut self, bytes: &[u8], now: Cycles) {
        self.lpuart1.advance(now);
        if self.pin_mode(self.board.serial_rx) == LPUART1_FUNCTION {
            self.lpuart1.send(bytes, now);
        }
    }

    /// Bytes that the computer on the serial link received since the last call.
    pub fn serial_take(&mut self, now: Cycles) -> Vec<u8> {
        self.lpuart1.advance(now);
        let sent = self.lpuart1.take_sent();
        if self.pin_mode(self.board.serial_tx) == LPUART1_FUNCTION { sent } else { Vec::new() }
    }

    /// Tells name, number and level of each interrupt request (RM0440 table 97), except those of DMA.
    fn interrupts(&self, mut tell: impl FnMut(&'static str, u32, bool)) {
        use adc::Unit;
        tell("FLASH", 4, self.flash.irq());
        tell("EXTI0", 6, self.exti.requests(1 << 0));
        tell("EXTI1", 7, self.exti.requests(1 << 1));
        tell("EXTI2", 8, self.exti.requests(1 << 2));
        tell("EXTI3", 9, self.exti.requests(1 << 3));
        tell("EXTI4", 10, self.exti.requests(1 << 4));
        tell("ADC1_2", 18, self.adc.irq(Unit::One) || self.adc.irq(Unit::Two));
        tell("USB_LP", 20, self.usb.irq_low());
        tell("EXTI9_5", 23, self.exti.requests(0x3e0));
        tell("TIM1_BRK_TIM15", 24, self.tim15.irq());
        tell("TIM1_UP_TIM16", 25, self.tim16.irq() || self.tim1.irq_update());
        tell("TIM1_TRG_COM_TIM17", 26, self.tim17.irq());
        tell("TIM1_CC", 27, self.tim1.irq_compare());
        tell("TIM2", 28, self.tim2.irq());
        tell("TIM3", 29, self.tim3.irq());
        tell("TIM4", 30, self.tim4.irq());
        tell("SPI2", 36, self.spi2.irq());
        tell("EXTI15_10", 40, self.exti.requests(0xfc00));
        tell("USBWAKEUP", 42, self.usb.irq_wakeup() && self.exti.unmasked(18));
        tell("TIM8_UP", 44, self.tim8.irq_update());
        tell("TIM8_CC", 46, self.tim8.irq_compare());
        tell("TIM5", 50, self.tim5.irq());
        tell("TIM6_DAC", 54, self.tim6.irq() || self.dac[0].irq());
        tell("TIM7_DAC", 55, self.tim7.irq() || self.dac[1].irq());
        tell("ADC3", 47, self.adc.irq(Unit::Three));
        tell("ADC4", 61, self.adc.irq(Unit::Four));
        tell("ADC5", 62, self.adc.irq(Unit::Five));
        tell("CRS", 75, self.crs.irq());
        tell("LPUART1", 91, self.lpuart1.irq());
    }

    /// Levels of the interrupt requests: bit n for interrupt n.
    pub fn irq_lines(&self) -> u128 {
        let channels = self.dma.iter().flat_map(|dma| &dma.channels);
        let raised = DMA_INTERRUPTS.into_iter().flatten().zip(channels).filter(|(_, channel)| channel.irq());
        let mut levels = raised.fold(0, |levels, (number, _)| levels | 1 << number);
        self.interrupts(|_, number, level| levels |= u128::from(level) << number);
        levels
    }

    /// Names of the storage registers that were read but never written.
    pub fn unwritten_reads(&mut self) -> Vec<String> {
        let mut list = Vec::new();
        for block in BLOCKS {
            let offsets = (block.model)(self).unwritten_reads();
            list.extend(offsets.into_iter().map(|offset| format!("{} + {offset:#x}", block.name)));
        }
        list
    }
}

fn find(address: u32) -> Option<&'static Block> {
    let behind = BLOCKS.partition_point(|block| block.start <= address);
    BLOCKS[..behind].last().filter(|block| address < block.end)
}

/// Address of the word and number of the bit for a peripheral bit-band alias address (RM0440 2.3); none for others.
fn bit_band(address: u32) -> Option<(u32, u32)> {
    let offset = address.checked_sub(BIT_BAND.start).filter(|_| address < BIT_BAND.end)?;
    Some((0x4000_0000 + ((offset / 32) & !3), offset / 4 % 32))
}

fn in_flash(address: u32) -> bool {
    (flash::START..flash::START + flash::LEN as u32).contains(&address)
}

fn ram_offset(address: u32) -> Option<usize> {
    const RAM_END: u32 = RAM_START + RAM_LEN as u32;
    const CCM_END: u32 = CCM_START + CCM_LEN as u32;
    match address {
        RAM_START..RAM_END => Some((address - RAM_START) as usize),
        CCM_START..CCM_END => Some((address - CCM_START) as usize + RAM_LEN - CCM_LEN),
        _ => None,
    }
}

/// Word accesses of the models' tests.
#[cfg(test)]
mod testing {
    use crate::{Cycles, Registers, Width};

    pub fn write(model: &mut impl Registers, offset: u32, value: u32, now: Cycles) {
        model.write(offset, value, Width::Word, now).expect("modelled access");
    }

    pub fn read(model: &mut impl Registers, offset: u32, now: Cycles) -> u32 {
        model.read(offset, Width::Word, now).expect("modelled access")
    }

    /// Whether the model refuses a write.
    pub fn refuses(model: &mut impl Registers, offset: u32, value: u32, now: Cycles) -> bool {
        model.write(offset, value, Width::Word, now).is_err()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Width::{Byte, Word};
    use crate::world::{Still, World};

    fn chip() -> Chip {
        Chip::new(Board::NUCLEO, Box::new(Still))
    }

    fn write(chip: &mut Chip, address: u32, value: u32) {
        chip.write(address, value, Word, 0).expect("modelled access");
    }

    /// AHB2ENR, APB1ENR1, APB2ENR.
    const ENABLES: [u32; 3] = [0x4002_104c, 0x4002_1058, 0x4002_1060];

    fn clocked() -> Chip {
        let mut chip = chip();
        for register in ENABLES {
            write(&mut chip, register, u32::MAX);
        }
        chip
    }

    #[test]
    fn blocks_are_in_order_and_apart() {
        for pair in BLOCKS.windows(2) {
            assert!(pair[0].end <= pair[1].start, "{} and {}", pair[0].name, pair[1].name);
        }
        assert_eq!(find(0x4000_0000).map(|block| block.name), Some("TIM2"));
        assert_eq!(find(0x4001_0030).map(|block| block.name), None);
        assert_eq!(find(0xe004_23ff).map(|block| block.name), Some("DBGMCU"));
    }

    #[test]
    fn an_access_that_nobody_knows_is_named() {
        let mut chip = clocked();
        let error = chip.write(0x4000_0070, 5, Word, 0).expect_err("access that is not modelled");
        assert_eq!(
            error.to_string(),
            "write of 0x5 to 0x40000070 (TIM2 + 0x70, 4 bytes): no such register in the model"
        );
        let error = chip.read(0x4002_0c00, Byte, 0).expect_err("access that is not modelled");
        assert_eq!(error.to_string(), "read of 0x40020c00 (1 bytes): no peripheral at this address");
    }

    #[test]
    fn a_peripheral_without_clock_does_not_answer() {
        let mut chip = chip();
        assert_eq!(chip.read(0x4000_0024, Word, 0).map_err(|bad| bad.what), Err(CLOCK_OFF.what));
        write(&mut chip, ENABLES[1], 1);
        assert_eq!(chip.read(0x4000_0024, Word, 0), Ok(0));
        // TIM2 held in reset.
        write(&mut chip, ENABLES[1] - 0x20, 1);
        assert!(chip.read(0x4000_0024, Word, 0).is_err());
    }

    #[test]
    fn a_program_of_others_finds_the_chips_answer_where_ours_would_end() {
        let mut chip = chip();
        chip.set_rules(Rules::AsOnTheChip);
        // TIM2_ARR, whose reset value is all ones.
        write(&mut chip, 0x4000_002c, 7);
        assert_eq!(chip.read(0x4000_002c, Word, 0), Ok(0));
        write(&mut chip, ENABLES[1], 1);
        assert_eq!(chip.read(0x4000_002c, Word, 0), Ok(u32::MAX), "the write was ignored");
        // PWR_CR1 while its clock is off.
        write(&mut chip, 0x4000_7000, 0x300);
        assert_eq!(chip.read(0x4000_7000, Word, 0), Ok(0x200));
        // RCC_BDCR while the backup domain is write-protected.
        write(&mut chip, RCC_BDCR, 1 << 15);
        assert_eq!(chip.read(RCC_BDCR, Word, 0), Ok(0));
    }

    #[test]
    fn a_word_of_the_bit_band_alias_is_one_bit() {
        let mut chip = chip();
        // Bit 5 of RCC_AHB2ENR: GPIOF clock enable.
        let alias = 0x4200_0000 + (ENABLES[0] - 0x4000_0000) * 32 + 4 * 5;
        write(&mut chip, ENABLES[0], 1);
        write(&mut chip, alias, 0xffff_ffff);
        assert_eq!(chip.read(ENABLES[0], Word, 0), Ok(1 << 5 | 1));
        assert_eq!((chip.read(alias, Word, 0), chip.read(alias - 4, Word, 0)), (Ok(1), Ok(0)));
        write(&mut chip, alias, 2);
        assert_eq!(chip.read(ENABLES[0], Word, 0), Ok(1));
    }

    #[test]
    fn a_clock_that_is_not_ready_is_waited_for() {
        let mut chip = clocked();
        chip.set_rules(Rules::AsOnTheChip);
        write(&mut chip, 0x4002_1008, 2);
        assert_eq!(chip.clocks.hclk_hz, 16e6, "HSE is off");
        write(&mut chip, 0x4002_1000, 0x1_0100);
        assert_eq!(chip.next_event(), Some(32_000));
        chip.advance(32_000);
        assert_eq!(chip.clocks.hclk_hz, 24e6);
        assert_eq!(chip.read(0x4002_1008, Word, 32_000), Ok(2 << 2 | 2));
    }

    #[test]
    fn a_pin_raises_its_external_interrupt() {
        let mut chip = clocked();
        let pin = Pin::new('B', 10);
        write(&mut chip, 0x4001_0010, 1 << 8);
        write(&mut chip, 0x4001_0400, 1 << 10);
        write(&mut chip, 0x4001_0408, 1 << 10);
        chip.set_pin(pin, true, 0);
        assert_eq!(chip.irq_lines(), 1 << 40);
        write(&mut chip, 0x4001_0414, 1 << 10);
        chip.set_pin(pin, false, 0);
        assert_eq!(chip.irq_lines(), 0);
        chip.set_pin(Pin::new('A', 10), true, 0);
        assert_eq!(chip.irq_lines(), 0, "another port");
    }

    struct Moving;

    impl World for Moving {
        fn encoder(&mut self, time_s: f64) -> u32 {
            (time_s * 1e6) as u32
        }

        fn force_volts(&mut self, _: f64) -> f64 {
            0.0
        }

        fn terminal_volts(&mut self, _: f64) -> f64 {
            0.0
        }
    }

    #[test]
    fn the_encoder_reaches_its_counter_through_the_right_pins_only() {
        let mut chip = Chip::new(Board::NUCLEO, Box::new(Moving));
        for register in ENABLES {
            write(&mut chip, register, u32::MAX);
        }
        write(&mut chip, 0x4000_0008, 3);
        write(&mut chip, 0x4000_0000, 1);
        assert_eq!(chip.read(0x4000_0024, Word, 16_000), Ok(0));
        // PA15 and PB3 to alternate function 1.
        let mut at_16_000 = |address, value| chip.write(address, value, Word, 16_000).expect("modelled access");
        at_16_000(0x4800_0000, 0xabff_ffff);
        at_16_000(0x4800_0024, 1 << 28);
        at_16_000(0x4800_0400, 0xffff_febf);
        at_16_000(0x4800_0420, 1 << 12);
        let start = chip.read(0x4000_0024, Word, 32_000).expect("modelled access");
        assert_eq!(chip.read(0x4000_0024, Word, 48_000), Ok(start + 1000));
    }

    #[test]
    fn the_backup_domain_has_a_key() {
        let mut chip = clocked();
        assert!(chip.write(0x4000_2500, 1, Word, 0).is_err());
        write(&mut chip, 0x4000_7000, 0x300);
        write(&mut chip, 0x4000_2500, 1);
        chip.reset(Reset::Software, 0);
        write(&mut chip, ENABLES[1], u32::MAX);
        assert_eq!(chip.read(0x4000_2500, Word, 0), Ok(1));
    }

    #[test]
    fn memory_outlives_a_reset_and_not_the_supply() {
        let mut chip = chip();
        chip.ram_mut(0x2000_0100, 1).expect("address in RAM")[0] = 7;
        chip.reset(Reset::Pin, 10);
        assert_eq!(chip.bytes(0x2000_0100, 1), Some(&[7][..]));
        chip.lose_power(1);
        let first = chip.bytes(0x2000_0100, 8).map(<[u8]>::to_vec);
        chip.lose_power(2);
        assert_ne!(chip.bytes(0x2000_0100, 8).map(<[u8]>::to_vec), first);
        chip.ram_mut(0x1000_0000, 1).expect("address in RAM")[0] = 9;
        assert_eq!(chip.bytes(0x2001_8000, 1), Some(&[9][..]), "the same memory at its second address");
        assert_eq!(chip.bytes(0x2002_0000, 1), None);
        assert_eq!(chip.bytes(flash::START, 2), Some(&[0xff, 0xff][..]));
    }

    #[test]
    fn the_watchdog_and_the_option_bytes_ask_for_a_reset() {
        let mut chip = chip();
        assert_eq!(chip.reset_wanted(), None);
        write(&mut chip, 0x4000_3000, 0xcccc);
        // 4096 counts of 4 LSI periods: 0.512 s.
        assert_eq!(chip.next_event(), Some(8_192_000));
        chip.advance(8_192_000);
        assert_eq!(chip.reset_wanted(), Some(Reset::Watchdog));
        chip.reset(Reset::Watchdog, 8_192_000);
        assert_eq!(chip.reset_wanted(), None);
        assert_eq!(chip.read(0x4002_1094, Word, 8_192_000), Ok(0x2c00_0000));
    }

    #[test]
    fn a_clock_that_flash_cannot_follow_ends_the_run() {
        let mut chip = clocked();
        write(&mut chip, 0x4002_1000, 0x1_0100);
        let mut at = |address, value, now| chip.write(address, value, Word, now).map_err(|bad| bad.what);
        assert_eq!(at(0x4002_100c, 3 | 1 << 4 | 28 << 8 | 1 << 24, 40_000), Ok(()));
        assert_eq!(at(0x4002_1000, 0x101_0100, 40_000), Ok(()));
        assert!(at(0x4002_1008, 3, 50_000).is_err());
    }

    #[test]
    fn interrupts_have_metapacs_numbers() {
        let metapac = stm32_metapac::metadata::METADATA.interrupts;
        let number = |name: &str| metapac.iter().find(|one| one.name == name).map(|one| one.number);
        chip().interrupts(|name, ours, _| assert_eq!(Some(ours), number(name), "{name}"));
        for channel in 0..8 {
            for (dma, ours) in ["DMA1", "DMA2"].into_iter().zip(DMA_INTERRUPTS) {
                let name = format!("{dma}_CHANNEL{}", channel + 1);
                assert_eq!(Some(ours[channel]), number(&name), "{name}");
            }
        }
    }

    #[test]
    fn pins_of_the_serial_link_and_of_the_converters_are_metapacs() {
        use crate::metapac::peripheral;
        let has = |of: &str, pin: Pin, signal: &str, function: Option<u8>| {
            let name = format!("P{}{}", char::from(b'A' + pin.port as u8), pin.number);
            peripheral(of).pins.iter().any(|one| one.pin == name && one.signal == signal && one.af == function)
        };
        let Mode::Alternate(function) = LPUART1_FUNCTION else {
            panic!("LPUART1_FUNCTION is not an alternate function")
        };
        assert!(has("LPUART1", Board::NUCLEO.serial_tx, "TX", Some(function)));
        assert!(has("LPUART1", Board::NUCLEO.serial_rx, "RX", Some(function)));
        let mut inputs = 0;
        for (name, unit) in ["ADC1", "ADC2", "ADC3", "ADC4", "ADC5"].into_iter().zip(adc::Unit::ALL) {
            for (channel, pin) in unit.pins() {
                assert!(has(name, pin, &format!("IN{channel}"), None), "{name} {channel}");
                inputs += 1;
            }
        }
        assert_eq!(inputs, 4, "force and terminal at ADC1 and ADC2");
    }
}
