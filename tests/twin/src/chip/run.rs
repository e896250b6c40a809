//! The chip over time: processing before, at and after each access of the core.

use super::rcc::Reset;
use super::{BLOCKS, BadAccess, Chip, RCC_CFGR};
use crate::{Cycles, Width};

impl Chip {
    /// A read by the core.
    pub fn read(&mut self, address: u32, width: Width, now: Cycles) -> Result<u32, BadAccess> {
        self.access(address, width, None, now)
    }

    /// A write by the core.
    pub fn write(&mut self, address: u32, value: u32, width: Width, now: Cycles) -> Result<(), BadAccess> {
        self.access(address, width, Some(value), now).map(|_| ())
    }

    /// Writes this value for the core or, if there is none, reads. Returns the word read; 0 for a write.
    pub fn access(&mut self, address: u32, width: Width, value: Option<u32>, now: Cycles) -> Result<u32, BadAccess> {
        self.advance(now);
        let word = self.bus(address, width, value, now)?;
        self.serve_dma(now);
        Ok(word)
    }

    /// The latest time at which [`Self::advance`] must be called.
    pub fn next_event(&mut self) -> Option<Cycles> {
        let event = [self.next_event_of_models(), self.pipeline_next_event()].into_iter().flatten().min();
        self.due = event.unwrap_or(Cycles::MAX);
        self.has_moved = false;
        event
    }

    /// Advances everything to `now`, as far as the core can observe it.
    pub fn advance(&mut self, now: Cycles) {
        self.pipeline_advance(now);
        if now < self.due {
            return;
        }
        self.has_moved = true;
        if self.rcc.switches(now)
            && let Err(unknown) = self.change_clocks(now)
        {
            self.fault("RCC", RCC_CFGR, unknown);
        }
        self.advance_models(now);
    }

    /// Resets the chip for this cause. RAM is kept; to lose power, call [`Self::lose_power`] first.
    pub fn reset(&mut self, cause: Reset, now: Cycles) {
        self.advance(now);
        let mem_mode = self.syscfg.mem_mode();
        for block in BLOCKS {
            (block.model)(self).reset(now);
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
