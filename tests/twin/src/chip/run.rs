//! The chip over time: processing before, at and after each access of the core.

use super::rcc::Reset;
use super::{BLOCKS, BadAccess, Chip, RCC_CFGR};
use crate::{Cycles, Registers, Unknown, Width};

impl Chip {
    /// A read by the core.
    pub fn read(&mut self, address: u32, width: Width, now: Cycles) -> Result<u32, BadAccess> {
        self.advance(now);
        let value = self.bus_read(address, width, now)?;
        self.serve_dma(now);
        Ok(value)
    }

    /// A write by the core.
    pub fn write(&mut self, address: u32, value: u32, width: Width, now: Cycles) -> Result<(), BadAccess> {
        self.advance(now);
        self.bus_write(address, value, width, now)?;
        self.serve_dma(now);
        Ok(())
    }

    /// The latest time at which [`Self::advance`] must be called.
    pub fn next_event(&mut self) -> Option<Cycles> {
        let models: [Option<Cycles>; 6] = [
            self.rcc.next_event(),
            self.pipeline_next_event(),
            self.usb.next_event(),
            self.lpuart1.next_event(),
            self.iwdg.next_event(),
            self.flash.next_event(),
        ];
        let timers = self.timers().into_iter().filter_map(Registers::next_event).min();
        let event = models.into_iter().flatten().chain(timers).min();
        self.due = event.unwrap_or(Cycles::MAX);
        event
    }

    /// Advances everything to `now`, as far as the core can observe it.
    pub fn advance(&mut self, now: Cycles) {
        self.pipeline_advance(now);
        if now < self.due {
            return;
        }
        if self.rcc.switches(now)
            && let Err(Unknown { what }) = self.change_clocks(now)
        {
            let (address, offset) = (RCC_CFGR, RCC_CFGR & 0x3ff);
            let fault = BadAccess { address, peripheral: "RCC", offset, width: Width::Word, value: None, what };
            self.path_fault.get_or_insert(fault);
        }
        let Self { tim1, tim2, tim3, tim4, tim5, tim8, tim15, tim16, tim17, .. } = self;
        for tim in [tim1, tim2, tim3, tim4, tim5, tim8, tim15, tim16, tim17] {
            tim.advance(now);
        }
        self.usb.advance(now);
        self.lpuart1.advance(now);
        self.iwdg.advance(now);
        self.flash.advance(now);
    }

    /// Resets the chip for this cause. RAM is kept; to lose power, call [`Self::lose_power`] first.
    pub fn reset(&mut self, cause: Reset, now: Cycles) {
        self.advance(now);
        let mem_mode = self.syscfg.mem_mode();
        for block in &BLOCKS {
            self.model(block.peripheral).reset(now);
        }
        if cause == Reset::Software {
            self.syscfg.restore(mem_mode);
        }
        self.rcc.set_cause(cause);
        self.path_fault = None;
        let clocks = self.rcc.clocks(now, self.clocks.seconds(now));
        self.use_clocks(clocks, now);
        self.due = 0;
    }

    /// Makes the crystal fail. Without the CSS a core clocked by the crystal would stop; here it continues.
    pub fn break_crystal(&mut self, now: Cycles) {
        self.advance(now);
        self.rcc.break_crystal(now);
        let clocks = self.rcc.clocks(now, self.clocks.seconds(now));
        if clocks.hclk_hz > 0.0 {
            self.use_clocks(clocks, now);
        }
    }
}
