//! Independent watchdog (RM0440 section 42.4), clocked by LSI with nominally 32 kHz.
//!
//! New prescaler, reload and window values take effect five LSI periods after the write, or after the start if that is
//! later.

use super::rcc::LSI_HZ;
use crate::registers::refuse;
use crate::{Cycles, Modelled, Registers, Unknown, Width, chip::clocks::Clocks};

registers! { u32:
    KR 0x00,
    PR 0x04,
    RLR 0x08,
    SR 0x0c,
    WINR 0x10,
}

const ACCESS: u32 = 0x5555;
const RELOAD: u32 = 0xaaaa;
const START: u32 = 0xcccc;

/// LSI periods until a written value takes effect.
const TRANSFER: f64 = 5.0;

/// The watchdog.
#[derive(Clone, Debug)]
pub struct Iwdg {
    open: bool,
    running: bool,
    /// Active prescaler and reload value.
    prescaler: u32,
    reload: u32,
    /// A refresh while the counter is above this value causes a reset.
    window: u32,
    /// A refresh came too early.
    early: bool,
    /// Written values, and when they take effect.
    new_prescaler: Option<(u32, Cycles)>,
    new_reload: Option<(u32, Cycles)>,
    new_window: Option<(u32, Cycles)>,
    /// LSI periods left at the time `since`.
    left: f64,
    since: Cycles,
    hclk_hz: f64,
}

impl Default for Iwdg {
    fn default() -> Self {
        Self {
            open: false,
            running: false,
            prescaler: 0,
            reload: 0xfff,
            window: 0xfff,
            early: false,
            new_prescaler: None,
            new_reload: None,
            new_window: None,
            left: 0.0,
            since: 0,
            hclk_hz: 16e6,
        }
    }
}

impl Iwdg {
    fn divider(&self) -> f64 {
        f64::from(4 << self.prescaler.min(6))
    }

    fn periods(&self, cycles: Cycles) -> f64 {
        cycles as f64 * LSI_HZ / self.hclk_hz
    }

    fn cycles(&self, periods: f64) -> Cycles {
        (periods * self.hclk_hz / LSI_HZ).ceil() as Cycles
    }

    fn refresh(&mut self) {
        self.left = f64::from(self.reload + 1) * self.divider();
    }

    fn in_use_at(&self, now: Cycles) -> Cycles {
        now + self.cycles(TRANSFER)
    }

    /// Time without a refresh until a reset \[s\]; none while the watchdog is off.
    pub fn timeout_s(&self) -> Option<f64> {
        let (prescaler, reload) =
            (self.new_prescaler.map_or(self.prescaler, |new| new.0), self.new_reload.map_or(self.reload, |new| new.0));
        self.running.then(|| f64::from(reload + 1) * f64::from(4 << prescaler.min(6)) / LSI_HZ)
    }

    /// Whether the watchdog has expired, or was refreshed too early, and resets the chip.
    pub fn bites(&self) -> bool {
        self.running && (self.left <= 0.0 || self.early)
    }
}

impl Registers for Iwdg {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        Ok(match register {
            KR => 0,
            PR => self.prescaler,
            RLR => self.reload,
            SR => {
                let new = [self.new_prescaler, self.new_reload, self.new_window];
                (0..).zip(new).map(|(bit, new)| u32::from(new.is_some()) << bit).sum()
            }
            WINR => self.window,
            _ => return Err(Unknown::REGISTER),
        })
    }

    fn write(&mut self, offset: u32, value: u32, _: Width, now: Cycles) -> Modelled {
        self.advance(now);
        match offset {
            KR => {
                self.open = value == ACCESS;
                match value {
                    RELOAD => {
                        self.early |= self.running && (self.left / self.divider()).ceil() > f64::from(self.window + 1);
                        self.refresh();
                    }
                    START if !self.running => {
                        self.running = true;
                        self.refresh();
                        let in_use = self.in_use_at(now);
                        let new = [&mut self.new_prescaler, &mut self.new_reload, &mut self.new_window];
                        new.into_iter().flatten().for_each(|new| new.1 = in_use);
                    }
                    _ => {}
                }
            }
            PR | RLR | WINR if !self.open => return refuse("written without the access key 0x5555"),
            PR => self.new_prescaler = Some((value & 7, self.in_use_at(now))),
            RLR => self.new_reload = Some((value & 0xfff, self.in_use_at(now))),
            // A write to WINR includes a refresh (RM0440 42.3.4).
            WINR => {
                self.new_window = Some((value & 0xfff, self.in_use_at(now)));
                self.refresh();
            }
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    fn next_event(&self) -> Option<Cycles> {
        if !self.running {
            return None;
        }
        let new = [self.new_prescaler, self.new_reload, self.new_window].into_iter().flatten().map(|(_, at)| at).min();
        let end = self.since + self.cycles(self.left.max(0.0));
        Some(new.map_or(end, |at| at.min(end)))
    }

    fn advance(&mut self, now: Cycles) {
        if !self.running {
            self.since = now;
            return;
        }
        let arrived = |new: Option<(u32, Cycles)>| new.filter(|&(_, at)| at <= now);
        for at in [arrived(self.new_prescaler), arrived(self.new_reload)].into_iter().flatten().map(|(_, at)| at) {
            self.left -= self.periods(at.saturating_sub(self.since));
            self.since = self.since.max(at);
        }
        if let Some((prescaler, _)) = arrived(self.new_prescaler) {
            let counts = self.left / self.divider();
            self.prescaler = prescaler;
            self.left = counts * self.divider();
            self.new_prescaler = None;
        }
        if let Some((reload, _)) = arrived(self.new_reload) {
            self.reload = reload;
            self.new_reload = None;
        }
        if let Some((window, _)) = arrived(self.new_window) {
            self.window = window;
            self.new_window = None;
        }
        self.left -= self.periods(now - self.since);
        self.since = now;
        // Rounding error of the last period.
        if self.left < 1e-6 {
            self.left = 0.0;
        }
    }

    fn reset(&mut self, now: Cycles) {
        *self = Self { since: now, ..Self::default() };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.hclk_hz = clocks.hclk_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    /// One second: prescaler 16, 2000 counts. An LSI period is 500 cycles.
    fn started() -> Iwdg {
        let mut iwdg = Iwdg::default();
        for (offset, value) in [(KR, ACCESS), (PR, 2), (RLR, 1999), (KR, START)] {
            write(&mut iwdg, offset, value, 0);
        }
        iwdg.advance(2500);
        write(&mut iwdg, KR, RELOAD, 2500);
        iwdg
    }

    #[test]
    fn bites_when_it_is_not_fed() {
        let mut iwdg = started();
        assert_eq!(iwdg.timeout_s(), Some(1.0));
        let end = 2500 + 16_000_000;
        assert_eq!(iwdg.next_event(), Some(end));
        iwdg.advance(end - 500);
        assert!(!iwdg.bites());
        iwdg.advance(end);
        assert!(iwdg.bites());
    }

    #[test]
    fn feeding_gives_the_whole_time_again() {
        let mut iwdg = started();
        write(&mut iwdg, KR, RELOAD, 10_000_000);
        assert_eq!(iwdg.next_event(), Some(26_000_000));
        write(&mut iwdg, KR, START, 20_000_000);
        assert_eq!(iwdg.next_event(), Some(26_000_000), "it is started once");
    }

    #[test]
    fn feeding_before_the_window_bites() {
        let mut iwdg = started();
        write(&mut iwdg, KR, ACCESS, 2500);
        write(&mut iwdg, WINR, 999, 2500);
        assert_eq!(iwdg.read(SR, Width::Word, 2500), Ok(4));
        iwdg.advance(5000);
        let mut late = iwdg.clone();
        write(&mut late, KR, RELOAD, 2500 + 8_000_000);
        assert!(!late.bites());
        write(&mut iwdg, KR, RELOAD, 2500 + 7_990_000);
        assert!(iwdg.bites());
    }

    #[test]
    fn values_need_the_key_and_some_time() {
        let mut iwdg = Iwdg::default();
        assert!(refuses(&mut iwdg, RLR, 1, 0));
        write(&mut iwdg, KR, ACCESS, 0);
        write(&mut iwdg, RLR, 1, 0);
        assert_eq!(iwdg.read(SR, Width::Word, 0), Ok(2));
        write(&mut iwdg, KR, START, 1000);
        assert_eq!(iwdg.next_event(), Some(3500), "the transfer ends");
        assert_eq!(iwdg.read(SR, Width::Word, 3500), Ok(0));
        assert_eq!(iwdg.read(RLR, Width::Word, 3500), Ok(1));
    }
}
