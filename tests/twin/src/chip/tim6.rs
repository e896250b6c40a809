//! TIM6, the sampling clock (and TIM7): counts up, and at each overflow triggers conversions and requests DMA.
//!
//! The model does not step the counter: it computes its value from the time since it was last zero. Prescaler and
//! auto-reload take effect at an update; without preload, auto-reload takes effect at once.
//! Not modelled, and refused: dithering, one-pulse mode, and an auto-reload value below the counter.
//!
//! Sources: RM0440 chapter 33 (basic timers), registers 33.4.1 to 33.4.9; update events, 33.3.2; trigger output,
//! 33.4.2.

use super::clocks::Clocks;
use crate::registers::refuse_if;
use crate::{Cycles, Modelled, Registers, Unknown, Width};

registers! { u32:
    CR1 0x00 { CEN 0, UDIS 1, URS 2, OPM 3, ARPE 7, UIFREMAP 11, DITHEN 12 },
    CR2 0x04,
    // UIE has the position of UIF in SR.
    DIER 0x0C { UIE 0, UDE 8 },
    SR 0x10,
    EGR 0x14,
    CNT 0x24,
    PSC 0x28,
    ARR 0x2C,
}
const CR1_ALL: u32 = CEN | UDIS | URS | OPM | ARPE | UIFREMAP | DITHEN;

/// MMS in CR2: the update event is the trigger output.
const TRIGGER_UPDATE: u32 = 2;

/// The timer.
#[derive(Clone, Debug)]
pub struct Tim6 {
    cr1: u32,
    cr2: u32,
    dier: u32,
    sr: u32,
    /// Value written; it takes effect at the next update.
    psc: u32,
    arr: u32,
    psc_in_effect: u32,
    arr_in_effect: u32,
    /// While the counter runs: the time at which it was zero, or would have been.
    zero: Cycles,
    /// While the counter is stopped: its value.
    standing: u32,
    /// Core cycles per timer clock.
    divider: u64,
    /// An update requests DMA.
    pub dma_request: bool,
    /// The trigger output has a pulse that the program caused by software.
    software_trigger: bool,
}

impl Default for Tim6 {
    /// The state after power-on.
    fn default() -> Self {
        Self {
            cr1: 0,
            cr2: 0,
            dier: 0,
            sr: 0,
            psc: 0,
            arr: 0xFFFF,
            psc_in_effect: 0,
            arr_in_effect: 0xFFFF,
            zero: 0,
            standing: 0,
            divider: 1,
            dma_request: false,
            software_trigger: false,
        }
    }
}

impl Tim6 {
    fn runs(&self) -> bool {
        // An auto-reload of zero stops the counter (33.3.2).
        self.cr1 & CEN != 0 && self.arr_in_effect != 0
    }

    /// Core cycles per counter step.
    fn step(&self) -> Cycles {
        self.divider * u64::from(self.psc_in_effect + 1)
    }

    fn counter(&self, now: Cycles) -> u32 {
        if self.runs() { ((now - self.zero) / self.step()) as u32 } else { self.standing }
    }

    /// Core cycles between two updates.
    pub fn period(&self) -> Cycles {
        self.step() * u64::from(self.arr_in_effect + 1)
    }

    /// Time of the next overflow.
    pub fn next_update(&self) -> Option<Cycles> {
        self.runs().then(|| self.zero + self.period())
    }

    /// Processes an overflow; must be called at [`next_update`](Self::next_update). Returns whether the trigger output
    /// has a pulse.
    pub fn update(&mut self) -> bool {
        self.zero += self.period();
        if self.cr1 & UDIS != 0 {
            return false;
        }
        self.sr |= UIE;
        self.dma_request |= self.dier & UDE != 0;
        self.load();
        self.cr2 >> 4 & 7 == TRIGGER_UPDATE
    }

    fn load(&mut self) {
        (self.psc_in_effect, self.arr_in_effect) = (self.psc, self.arr);
    }

    /// Returns and clears a trigger pulse that a register write caused.
    pub fn take_trigger(&mut self) -> bool {
        std::mem::take(&mut self.software_trigger)
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.sr & self.dier & UIE != 0
    }

    fn set_counter(&mut self, value: u32, now: Cycles) {
        self.standing = value;
        self.zero = now.saturating_sub(u64::from(value) * self.step());
    }

    fn write_control(&mut self, value: u32, now: Cycles) -> Modelled {
        refuse_if(value & (OPM | DITHEN) != 0, "TIM6_CR1: one-pulse mode and dithering are not modelled")?;
        let counter = self.counter(now);
        self.cr1 = value & CR1_ALL;
        self.set_counter(counter, now);
        Ok(())
    }
}

impl Registers for Tim6 {
    fn word(&mut self, register: u32, now: Cycles) -> Modelled<u32> {
        Ok(match register {
            CR1 => self.cr1,
            CR2 => self.cr2,
            DIER => self.dier,
            SR => self.sr,
            EGR => 0,
            CNT if self.cr1 & UIFREMAP != 0 => self.counter(now) | (self.sr & 1) << 31,
            CNT => self.counter(now),
            PSC => self.psc,
            ARR => self.arr,
            _ => return Err(Unknown::REGISTER),
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        refuse_if(width == Width::Byte || offset & 3 != 0, "TIM6 accepts only word and aligned half-word accesses")?;
        match offset {
            CR1 => self.write_control(value, now)?,
            CR2 => self.cr2 = value & 0x70,
            DIER => {
                self.dier = value & (UIE | UDE);
                self.dma_request &= self.dier & UDE != 0;
            }
            // Writing 0 clears a flag.
            SR => self.sr &= value,
            EGR if value & 1 == 0 => {}
            EGR => {
                // A software update. URS suppresses the flag and the DMA request, but not the trigger output.
                if self.cr1 & UDIS == 0 {
                    if self.cr1 & URS == 0 {
                        self.sr |= UIE;
                        self.dma_request |= self.dier & UDE != 0;
                    }
                    self.software_trigger |= self.cr2 >> 4 & 7 == TRIGGER_UPDATE;
                    self.load();
                }
                self.set_counter(0, now);
            }
            CNT => self.set_counter(value & 0xFFFF, now),
            PSC => self.psc = value & 0xFFFF,
            ARR => {
                self.arr = value & 0xFFFF;
                if self.cr1 & ARPE == 0 {
                    let counter = self.counter(now);
                    refuse_if(counter > self.arr, "TIM6_ARR set below the counter")?;
                    self.arr_in_effect = self.arr;
                    if self.runs() {
                        // This starts a counter that an auto-reload of zero had stopped.
                        self.set_counter(counter, now);
                    }
                }
            }
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    /// The next update, if it may raise the interrupt request.
    fn next_event(&self) -> Option<Cycles> {
        self.next_update().filter(|_| self.dier & UIE != 0)
    }

    fn reset(&mut self, _: Cycles) {
        *self = Self { divider: self.divider, ..Self::default() };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        let counter = self.counter(clocks.since);
        self.divider = ((clocks.hclk_hz / clocks.timer1_hz).round() as u64).max(1);
        self.set_counter(counter, clocks.since);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    /// 2625 cycles at 168 MHz: 64 kHz.
    fn sampling_clock() -> Tim6 {
        let mut timer = Tim6::default();
        write(&mut timer, 0x2C, 2624, 0);
        write(&mut timer, 0x04, TRIGGER_UPDATE << 4, 0);
        write(&mut timer, 0x0C, UDE, 0);
        write(&mut timer, 0x00, CEN | ARPE, 100);
        timer
    }

    #[test]
    fn updates_come_once_per_period_and_bring_a_trigger_and_a_request() {
        let mut timer = sampling_clock();
        for n in 1..5 {
            assert_eq!(timer.next_update(), Some(100 + 2625 * n));
            assert!(timer.update());
            assert!(timer.dma_request && !timer.irq());
            timer.dma_request = false;
        }
        assert_eq!(timer.read(0x24, Width::Word, 100 + 2625 * 4 + 7), Ok(7));
        assert_eq!(timer.read(0x10, Width::Word, 0), Ok(1));
        write(&mut timer, 0x10, 0, 0);
        assert_eq!(timer.read(0x10, Width::Word, 0), Ok(0));
    }

    #[test]
    fn a_stopped_counter_stands_and_goes_on() {
        let mut timer = sampling_clock();
        write(&mut timer, 0x00, 0, 110);
        assert_eq!((timer.next_update(), timer.read(0x24, Width::Word, 500)), (None, Ok(10)));
        write(&mut timer, 0x00, CEN, 1000);
        assert_eq!(timer.next_update(), Some(1000 + 2615));
        write(&mut timer, 0x24, 0, 1500);
        assert_eq!(timer.next_update(), Some(1500 + 2625));
    }

    #[test]
    fn preloaded_values_wait_for_the_update() {
        let mut timer = sampling_clock();
        write(&mut timer, 0x2C, 99, 200);
        write(&mut timer, 0x28, 1, 200);
        assert_eq!(timer.next_update(), Some(100 + 2625));
        timer.update();
        assert_eq!((timer.next_update(), timer.period()), (Some(100 + 2625 + 200), 200));
        // Without preload, auto-reload changes at once; the prescaler never does.
        write(&mut timer, 0x00, CEN, 2725);
        write(&mut timer, 0x2C, 49, 2725);
        write(&mut timer, 0x28, 0, 2725);
        assert_eq!(timer.period(), 100);
        assert!(refuses(&mut timer, 0x2C, 4, 2725 + 20));
    }

    #[test]
    fn an_update_by_software_triggers_even_where_urs_keeps_the_flag_back() {
        let mut timer = sampling_clock();
        write(&mut timer, 0x00, CEN | URS, 100);
        write(&mut timer, 0x14, 1, 150);
        assert!(timer.take_trigger() && !timer.take_trigger());
        assert!(!timer.dma_request);
        assert_eq!((timer.sr, timer.next_update()), (0, Some(150 + 2625)));
        write(&mut timer, 0x00, CEN, 150);
        write(&mut timer, 0x14, 1, 160);
        assert!(timer.dma_request && timer.sr == 1);
    }

    #[test]
    fn updates_that_are_disabled_do_nothing() {
        let mut timer = sampling_clock();
        write(&mut timer, 0x0C, UDE | UIE, 100);
        write(&mut timer, 0x00, CEN | UDIS, 100);
        assert!(!timer.update());
        assert!(!timer.dma_request && !timer.irq());
        assert_eq!(timer.next_update(), Some(100 + 2 * 2625));
        write(&mut timer, 0x00, CEN, 100 + 2625);
        timer.update();
        assert!(timer.irq());
    }

    #[test]
    fn a_slower_timer_clock_takes_longer() {
        let mut timer = sampling_clock();
        timer.set_clocks(&Clocks { since: 100, hclk_hz: 168e6, timer1_hz: 84e6, ..Clocks::POWER_ON });
        assert_eq!(timer.next_update(), Some(100 + 2 * 2625));
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut timer = Tim6::default();
        for bit in [OPM, DITHEN] {
            assert!(refuses(&mut timer, 0x00, bit, 0));
        }
        assert!(timer.read(0x30, Width::Word, 0).is_err());
        assert!(refuses(&mut timer, 0x08, 0, 0));
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("TIM6", "CR1", CEN, UDIS, URS, OPM, ARPE, UIFREMAP, DITHEN);
        fields_agree!("TIM6", "DIER", UIE, UDE);
    }
}
