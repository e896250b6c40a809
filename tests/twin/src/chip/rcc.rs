//! Reset and clock control (RM0440 section 7.4).
//!
//! The model derives all frequencies from the registers: a wrong divider gives wrong rates everywhere, and a setting
//! outside the chip's limits ends the run. Oscillators become ready after their typical start-up times (DS12288 section
//! 5.3.7 to 5.3.9).
//!
//! If the crystal fails ([`Rcc::break_crystal`]) while the clock security system (CSS) monitors it, the core falls back
//! to HSI and the NMI is raised. Not modelled: clock output, LSE, clocks in sleep mode.

use crate::registers::{refuse, refuse_if};
use crate::{
    Cycles, Modelled, Registers, Storage, Width,
    chip::{clocks::Clocks, errata::Errata, rules::Rules},
};

registers! { u32:
    // Each ready flag is the bit above its enable bit, except HSI's. The CSS monitors the crystal.
    CR 0x00 { HSION 8, HSIRDY 10, HSEON 16, HSERDY 17, HSEBYP 18, CSSON 19, PLLON 24, PLLRDY 25 },
    ICSCR 0x04,
    // The AHB prescaler divides.
    CFGR 0x08 { AHB_DIVIDES 7 },
    PLLCFGR 0x0c,
    CIER 0x18,
    // The CSS detected a crystal failure; the same bit in CICR.
    CIFR 0x1c { CSSF 8 },
    CICR 0x20,
    pub(super) AHB1ENR 0x48,
    pub(super) AHB2ENR 0x4c,
    pub(super) APB1ENR1 0x58,
    pub(super) APB1ENR2 0x5c,
    pub(super) APB2ENR 0x60,
    CCIPR 0x88,
    BDCR 0x90,
    // Clears the reset flags.
    CSR 0x94 { RMVF 23 },
    CRRCR 0x98,
    CCIPR2 0x9c,
}

/// Implemented gates. The RTC and the window watchdog have no reset bit.
const AHB1_GATES: u32 = 0x111f;
const AHB2_GATES: u32 = 0x050f_607f;
const AHB3_GATES: u32 = 0x101;
const APB1_GATES: u32 = 0xd2fe_cd3f;
const RTCAPB: u32 = 3 << 10;
const APB1_2_GATES: u32 = 0x103;
const APB2_GATES: u32 = 0x0437_f801;

/// When the system clock rises across `STEP_HZ`, HCLK must be half of it for `STEP_S` (RM0440 7.2.7; ST's HAL,
/// `stm32g4xx_hal_rcc.c`, `HAL_RCC_ClockConfig`).
const STEP_HZ: f64 = 80e6;
const STEP_S: f64 = 1e-6;

/// BDCR: RTCEN, and RTCSEL = 2 (LSI).
const RTC_ON_LSI: u32 = 1 << 15 | 2 << 8;

const HSI_HZ: f64 = 16e6;
const HSI48_HZ: f64 = 48e6;
/// Frequency of the low-speed internal oscillator, which clocks the watchdog \[Hz\].
pub const LSI_HZ: f64 = 32e3;

/// Typical start-up times \[s\]: DS12288 tables "HSE oscillator", "PLL" (lock), "HSI48", "LSI".
const HSE_START_S: f64 = 2e-3;
const PLL_LOCK_S: f64 = 15e-6;
const HSI48_START_S: f64 = 2.5e-6;
const LSI_START_S: f64 = 130e-6;

/// The cause of a reset, as flagged in RCC_CSR (RM0440 7.4.28).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Power came up.
    Power,
    /// NRST was pulled low externally.
    Pin,
    /// AIRCR.SYSRESETREQ.
    Software,
    /// The independent watchdog expired.
    Watchdog,
    /// The option bytes were reloaded.
    OptionBytes,
}

impl Reset {
    /// The flags that this cause sets. Every internal reset also pulls NRST low.
    const fn flags(self) -> u32 {
        const PIN: u32 = 1 << 26;
        match self {
            Self::Power => 1 << 27 | PIN,
            Self::Pin => PIN,
            Self::Software => 1 << 28 | PIN,
            Self::Watchdog => 1 << 29 | PIN,
            Self::OptionBytes => 1 << 25 | PIN,
        }
    }
}

/// A peripheral's clock enable: register and bit. Its reset bit has the same number in the register 0x20 below.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gate(pub u32, pub u32);

/// The RCC registers.
#[derive(Clone, Debug)]
pub struct Rcc {
    storage: Storage,
    hse_hz: f64,
    hclk_hz: f64,
    /// Time at which each oscillator or PLL that is on becomes ready; none while it is off.
    hse_ready: Option<Cycles>,
    pll_ready: Option<Cycles>,
    hsi48_ready: Option<Cycles>,
    lsi_ready: Option<Cycles>,
    causes: u32,
    /// The CSS detected that the crystal failed, which requests the NMI until software clears the flag.
    pub crystal_failed: bool,
    /// When the system clock last rose above [`STEP_HZ`].
    stepped: Cycles,
    /// Errata in force.
    pub errata: Errata,
    /// How strictly the model treats violations.
    pub rules: Rules,
    /// The system clock in use (SWS), if the selected one (SW) is not ready yet.
    still: Option<u32>,
}

impl Rcc {
    /// RCC with a crystal of this frequency, 0 for none.
    pub fn new(hse_hz: f64) -> Self {
        let storage = Storage::shared(&[
            (CR, HSION, HSION | 1 << 9 | HSEON | HSEBYP | CSSON | PLLON),
            (ICSCR, 0x4000_0000, 0x7f00_0000),
            (CFGR, 0x5, 0x3ff3 | 0x7f00_0000),
            (PLLCFGR, 0x1000, 0xff73_7ff3),
            (CIER, 0, 0x63b),
            // AHB1RSTR, AHB2RSTR, AHB3RSTR, APB1RSTR1, APB1RSTR2, APB2RSTR.
            (0x28, 0, AHB1_GATES),
            (0x2c, 0, AHB2_GATES),
            (0x30, 0, AHB3_GATES),
            (0x38, 0, APB1_GATES & !RTCAPB),
            (0x3c, 0, APB1_2_GATES),
            (0x40, 0, APB2_GATES),
            (AHB1ENR, 0x100, AHB1_GATES),
            (AHB2ENR, 0, AHB2_GATES),
            // AHB3ENR.
            (0x50, 0, AHB3_GATES),
            (APB1ENR1, 0x400, APB1_GATES),
            (APB1ENR2, 0, APB1_2_GATES),
            (APB2ENR, 0, APB2_GATES),
            (CCIPR, 0, u32::MAX),
            (BDCR, 0, 0x0301_837d),
            (CSR, 0, 1),
            (CRRCR, 0, 1),
            (CCIPR2, 0, 0x30_0003),
        ]);
        Self {
            storage,
            hse_hz,
            hclk_hz: HSI_HZ,
            hse_ready: None,
            pll_ready: None,
            hsi48_ready: None,
            lsi_ready: None,
            causes: Reset::Power.flags(),
            crystal_failed: false,
            stepped: 0,
            errata: Errata::NONE,
            rules: Rules::Enforced,
            still: None,
        }
    }

    /// The system clock in use (SWS).
    fn in_use(&self) -> u32 {
        self.still.unwrap_or(self.storage[CFGR] & 3)
    }

    /// Time at which a system clock source becomes ready; none while it is off.
    fn ready(&self, source: u32) -> Option<Cycles> {
        match source {
            1 => (self.storage[CR] & HSION != 0).then_some(0),
            2 => self.hse_ready,
            3 => self.pll_ready,
            _ => None,
        }
    }

    /// Switches to the selected system clock once that is ready. If it returns true, the caller must update the
    /// frequencies.
    #[must_use]
    pub fn switches(&mut self, now: Cycles) -> bool {
        let ready = self.still.is_some() && self.ready(self.storage[CFGR] & 3).is_some_and(|at| at <= now);
        if ready {
            self.still = None;
        }
        ready
    }

    /// Removes the supply and the battery, so the backup domain is lost too.
    pub fn lose_power(&mut self, hse_hz: f64) {
        *self = Self { errata: self.errata, rules: self.rules, ..Self::new(hse_hz) };
    }

    /// Whether a peripheral's clock is enabled.
    pub fn is_on(&self, Gate(register, bit): Gate) -> bool {
        self.storage[register] >> bit & 1 != 0
    }

    /// Whether a peripheral is held in reset.
    pub fn is_reset(&self, Gate(register, bit): Gate) -> bool {
        self.storage[register - 0x20] >> bit & 1 != 0
    }

    /// Makes the crystal fail, which stops everything that it clocks. If the CSS monitors the crystal, the core
    /// continues on HSI (RM0440 7.2.8). The caller must then update the frequencies.
    pub fn break_crystal(&mut self, now: Cycles) {
        self.hse_hz = 0.0;
        // A crystal that is not ready yet never becomes ready.
        self.hse_ready = self.hse_ready.filter(|at| *at <= now);
        let watched = self.storage[CR] & CSSON != 0 && self.hse_ready.take().is_some();
        if watched {
            self.crystal_failed = true;
            self.storage[CR] = self.storage[CR] & !(HSEON | PLLON | CSSON) | HSION;
            self.pll_ready = None;
            self.still = None;
            self.storage[CFGR] = self.storage[CFGR] & !3 | 1;
        }
    }

    /// Adds the flags of a reset cause; a power-on reset clears earlier flags.
    pub fn set_cause(&mut self, cause: Reset) {
        self.causes = if cause == Reset::Power { 0 } else { self.causes } | cause.flags();
    }

    /// Frequencies of the PLL input, the VCO and the outputs P, Q and R (0 for an output that is off).
    fn pll(&self) -> (f64, f64, [f64; 3]) {
        let pllcfgr = self.storage[PLLCFGR];
        let field = |shift: u32, mask: u32| f64::from(pllcfgr >> shift & mask);
        let on = |bit: u32| pllcfgr >> bit & 1 != 0;
        let source = match pllcfgr & 3 {
            2 => HSI_HZ,
            3 => self.hse_hz,
            _ => 0.0,
        };
        let input = source / (field(4, 0xf) + 1.0);
        let vco = input * field(8, 0x7f);
        let p = match field(27, 0x1f) {
            0.0 if on(17) => 17.0,
            0.0 => 7.0,
            divider => divider,
        };
        let (q, r) = (2.0 * (field(21, 3) + 1.0), 2.0 * (field(25, 3) + 1.0));
        let output = |enable: u32, divider: f64| if on(enable) { vco / divider } else { 0.0 };
        (input, vco, [output(16, p), output(20, q), output(24, r)])
    }

    fn sysclk_hz(&self) -> f64 {
        match self.in_use() {
            1 => HSI_HZ,
            2 => self.hse_hz,
            3 => self.pll().2[2],
            _ => 0.0,
        }
    }

    /// Frequencies set in the registers, from the time `since` on, which is `since_s` seconds after power-on.
    pub fn clocks(&self, since: Cycles, since_s: f64) -> Clocks {
        let cfgr = self.storage[CFGR];
        let sysclk_hz = self.sysclk_hz();
        let ahb = match cfgr >> 4 & 0xf {
            code @ 8..=11 => f64::from(2 << (code - 8)),
            code @ 12..=15 => f64::from(64 << (code - 12)),
            _ => 1.0,
        };
        let hclk_hz = sysclk_hz / ahb;
        // If the APB prescaler divides, the timer clock is twice the bus clock.
        let bus = |shift: u32| match cfgr >> shift & 7 {
            code @ 4..=7 => (hclk_hz / f64::from(2 << (code - 4)), 2.0),
            _ => (hclk_hz, 1.0),
        };
        let ((pclk1_hz, timer1), (pclk2_hz, timer2)) = (bus(8), bus(11));
        let [p, q, _] = self.pll().2;
        let ccipr = self.storage[CCIPR];
        let usb_hz = match ccipr >> 26 & 3 {
            0 if self.storage[CRRCR] & 1 != 0 => HSI48_HZ,
            2 => q,
            _ => 0.0,
        };
        let lpuart1_hz = match ccipr >> 10 & 3 {
            0 => pclk1_hz,
            1 => sysclk_hz,
            2 => HSI_HZ,
            _ => 0.0,
        };
        let adc_hz = |shift: u32| match ccipr >> shift & 3 {
            1 => p,
            2 => sysclk_hz,
            _ => 0.0,
        };
        Clocks {
            since,
            since_s,
            hclk_hz,
            pclk1_hz,
            pclk2_hz,
            timer1_hz: timer1 * pclk1_hz,
            timer2_hz: timer2 * pclk2_hz,
            usb_hz,
            lpuart1_hz,
            adc12_hz: adc_hz(28),
            adc345_hz: adc_hz(30),
        }
    }

    /// Whether the core may run at the set frequencies (RM0440 7.2.4 and 3.3.3, DS12288 table "PLL characteristics").
    ///
    /// `boost`: PWR_CR5.R1MODE is 0; `wait_states`: FLASH_ACR.LATENCY.
    pub fn check(&self, clocks: &Clocks, boost: bool, wait_states: u32) -> Modelled {
        let cr = self.storage[CR];
        // Outside its range the PLL may or may not lock, which matters only if it clocks the system.
        if cr & PLLON != 0 && (self.rules == Rules::Enforced || self.in_use() == 3) {
            let (input, vco, outputs) = self.pll();
            refuse_if(!(2.66e6..=16e6).contains(&input), "the PLL input must be between 2.66 and 16 MHz")?;
            refuse_if(!(96e6..=344e6).contains(&vco), "the VCO of the PLL must be between 96 and 344 MHz")?;
            refuse_if(outputs.iter().any(|&hz| hz > 170e6), "a PLL output is above 170 MHz")?;
        }
        let is_ready = |at: Option<Cycles>| at.is_some_and(|at| at <= clocks.since);
        let source = self.in_use();
        let ready = is_ready(self.ready(source)) && (source != 3 || self.pll().2[2] > 0.0);
        refuse_if(!ready, "the selected system clock is off or not ready")?;
        let (limit_hz, step_hz) = if boost { (170e6, 34e6) } else { (150e6, 30e6) };
        refuse_if(clocks.hclk_hz > limit_hz, "the core clock is too fast for the voltage range")?;
        refuse_if(
            clocks.hclk_hz > step_hz * (f64::from(wait_states) + 1.0),
            "too few flash wait states for the core clock",
        )?;
        Ok(())
    }

    fn in_s(&self, now: Cycles, length_s: f64) -> Cycles {
        now + (length_s * self.hclk_hz).ceil() as Cycles
    }
}

/// Ready time of an oscillator: unchanged while it stays on.
fn switched(on: bool, before: Option<Cycles>, ready: Cycles) -> Option<Cycles> {
    on.then(|| before.unwrap_or(ready))
}

impl Registers for Rcc {
    fn word(&mut self, register: u32, now: Cycles) -> Modelled<u32> {
        let ready = |moment: Option<Cycles>, flag: u32| if moment.is_some_and(|at| at <= now) { flag } else { 0 };
        let value = match register {
            CIFR if self.crystal_failed => CSSF,
            CIFR | CICR => 0,
            _ => self.storage.load(register)?,
        };
        Ok(match register {
            CR => {
                value
                    | if value & HSION != 0 { HSIRDY } else { 0 }
                    | ready(self.hse_ready, HSERDY)
                    | ready(self.pll_ready, PLLRDY)
            }
            CFGR => value & !0xc | self.in_use() << 2,
            CSR => value | self.causes | ready(self.lsi_ready, 2),
            CRRCR => value | ready(self.hsi48_ready, 2),
            _ => value,
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        let register = offset & !3;
        if register == CICR {
            self.crystal_failed &= width.replace(0, offset, value) & CSSF == 0;
            return Ok(());
        }
        let old = self.storage.load(register)?;
        let word = width.replace(old, offset, value);
        match register {
            CR if word & PLLON != 0 && self.storage[PLLCFGR] & 3 == 3 && self.hse_ready.is_none_or(|at| at > now) => {
                return refuse("PLL enabled before its source is ready");
            }
            BDCR if self.errata.lsi_with_rtc && word & RTC_ON_LSI == RTC_ON_LSI => {
                return refuse("LSI is unstable when it clocks the RTC (ES0430)");
            }
            BDCR if word & 1 != 0 => return refuse("LSE is not modelled"),
            PLLCFGR if self.pll_ready.is_some() && (word ^ old) & 0x7fff != 0 => {
                return refuse("RCC_PLLCFGR changed while the PLL is enabled");
            }
            _ => {}
        }
        let slow = self.sysclk_hz() <= STEP_HZ;
        let in_use = self.in_use();
        self.storage.store(offset, value, width)?;
        if register == CFGR && self.rules == Rules::AsOnTheChip {
            self.still = self.ready(word & 3).is_none_or(|at| at > now).then_some(in_use);
        }
        if self.sysclk_hz() > STEP_HZ && self.rules == Rules::Enforced {
            if slow {
                self.stepped = now;
            }
            refuse_if(
                word & AHB_DIVIDES == 0 && (slow || old & AHB_DIVIDES != 0 && now < self.in_s(self.stepped, STEP_S)),
                "system clock raised above 80 MHz without 1 us at AHB / 2",
            )?;
        }
        match register {
            CR => {
                // A crystal does not start in bypass mode, which expects an external clock. Without a crystal HSE never
                // becomes ready.
                let crystal = word & HSEON != 0 && word & HSEBYP == 0 && self.hse_hz > 0.0;
                self.hse_ready = switched(crystal, self.hse_ready, self.in_s(now, HSE_START_S));
                self.pll_ready = switched(word & PLLON != 0, self.pll_ready, self.in_s(now, PLL_LOCK_S));
            }
            CRRCR => self.hsi48_ready = switched(word & 1 != 0, self.hsi48_ready, self.in_s(now, HSI48_START_S)),
            CSR => {
                self.lsi_ready = switched(word & 1 != 0, self.lsi_ready, self.in_s(now, LSI_START_S));
                if word & RMVF != 0 {
                    self.causes = 0;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        // A system reset does not affect RCC_BDCR.
        let bdcr = self.storage[BDCR];
        self.storage.reset();
        self.storage[BDCR] = bdcr;
        (self.hse_ready, self.pll_ready, self.hsi48_ready, self.lsi_ready) = (None, None, None, None);
        self.hclk_hz = HSI_HZ;
        self.crystal_failed = false;
        self.still = None;
    }

    fn next_event(&self) -> Option<Cycles> {
        self.still.and(self.ready(self.storage[CFGR] & 3))
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.hclk_hz = clocks.hclk_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{read, refuses, write};

    /// HSE 24 MHz / 2 * 28 / 2; PLL selected at cycle 40000.
    fn at_168_mhz() -> Rcc {
        let mut rcc = Rcc::new(24e6);
        write(&mut rcc, CR, HSION | HSEON, 0);
        write(&mut rcc, PLLCFGR, 3 | 1 << 4 | 28 << 8 | 1 << 24, 33_000);
        write(&mut rcc, CR, HSION | HSEON | PLLON, 33_000);
        write(&mut rcc, CFGR, 3 | 8 << 4, 39_000);
        write(&mut rcc, CFGR, 3, 40_000);
        rcc
    }

    #[test]
    fn the_core_does_not_jump_over_80_mhz() {
        let mut rcc = at_168_mhz();
        write(&mut rcc, CFGR, 1, 50_000);
        assert!(refuses(&mut rcc.clone(), CFGR, 3, 50_000), "at once");
        write(&mut rcc, CFGR, 3 | 8 << 4, 50_000);
        assert!(refuses(&mut rcc.clone(), CFGR, 3, 50_015), "too soon");
        write(&mut rcc, CFGR, 3, 50_016);
    }

    #[test]
    fn frequencies_follow_from_the_registers() {
        let mut rcc = at_168_mhz();
        assert_eq!(read(&mut rcc, CFGR, 40_000) & 0xf, 0xf);
        let clocks = rcc.clocks(40_000, 0.0025);
        assert_eq!((clocks.hclk_hz, clocks.timer1_hz, clocks.usb_hz), (168e6, 168e6, 0.0));
        assert_eq!(rcc.check(&clocks, true, 4), Ok(()));
        // APB1 prescaler 4, AHB prescaler 2.
        write(&mut rcc, CFGR, 3 | 8 << 4 | 5 << 8, 40_000);
        write(&mut rcc, CRRCR, 1, 40_000);
        let clocks = rcc.clocks(40_000, 0.0025);
        assert_eq!((clocks.hclk_hz, clocks.pclk1_hz, clocks.timer1_hz), (84e6, 21e6, 42e6));
        assert_eq!((clocks.pclk2_hz, clocks.usb_hz), (84e6, 48e6));
    }

    #[test]
    fn settings_over_the_limits_are_refused() {
        let mut rcc = at_168_mhz();
        let clocks = rcc.clocks(40_000, 0.0025);
        assert!(rcc.check(&clocks, false, 8).is_err(), "without boost");
        assert!(rcc.check(&clocks, true, 3).is_err(), "wait states");
        assert!(refuses(&mut rcc, PLLCFGR, 3 | 1 << 4 | 29 << 8 | 1 << 24, 41_000), "changed while enabled");
        // The same multiplication with another board's crystal.
        let mut other = Rcc::new(8e6);
        write(&mut other, CR, HSION | HSEON, 0);
        write(&mut other, PLLCFGR, 3 | 3 << 4 | 28 << 8 | 1 << 24, 33_000);
        write(&mut other, CR, HSION | HSEON | PLLON, 33_000);
        assert!(other.check(&other.clocks(40_000, 0.0), true, 4).is_err(), "PLL input of 2 MHz");
    }

    #[test]
    fn oscillators_take_their_time() {
        let mut rcc = Rcc::new(24e6);
        write(&mut rcc, CR, HSION | HSEON, 100);
        assert_eq!(read(&mut rcc, CR, 32_099) & HSERDY, 0);
        assert_eq!(read(&mut rcc, CR, 32_100) & HSERDY, HSERDY);
        write(&mut rcc, PLLCFGR, 3 | 1 << 4 | 28 << 8, 200);
        assert!(refuses(&mut rcc, CR, HSION | HSEON | PLLON, 300), "the PLL needs its source");
        write(&mut rcc, CR, HSION | HSEON | HSEBYP, 40_000);
        assert_eq!(read(&mut rcc, CR, 1_000_000) & HSERDY, 0, "a crystal is no clock from outside");
        let mut without = Rcc::new(0.0);
        write(&mut without, CR, HSION | HSEON, 100);
        assert_eq!(read(&mut without, CR, 1_000_000) & HSERDY, 0, "no crystal");
    }

    #[test]
    fn a_crystal_that_breaks_leaves_the_internal_clock_and_an_interrupt() {
        let mut rcc = at_168_mhz();
        write(&mut rcc, CR, HSION | HSEON | CSSON | PLLON, 40_000);
        rcc.break_crystal(45_000);
        assert!(rcc.crystal_failed);
        assert_eq!((read(&mut rcc, CIFR, 50_000), read(&mut rcc, CR, 50_000) & (HSERDY | PLLRDY)), (CSSF, 0));
        assert_eq!(rcc.clocks(50_000, 0.003).hclk_hz, 16e6);
        write(&mut rcc, CICR, CSSF, 50_000);
        assert!(!rcc.crystal_failed);
    }

    #[test]
    fn the_rtc_takes_the_lsi_from_the_watchdog_by_an_erratum_only() {
        for (errata, is_refused) in [(Errata { lsi_with_rtc: true, ..Errata::NONE }, true), (Errata::NONE, false)] {
            let mut rcc = Rcc::new(24e6);
            rcc.errata = errata;
            assert_eq!(refuses(&mut rcc, BDCR, RTC_ON_LSI, 0), is_refused);
            assert_eq!(rcc.write(BDCR, 2 << 8, Width::Word, 0), Ok(()), "chosen, and off");
        }
    }

    #[test]
    fn causes_of_reset_gather_until_they_are_cleared() {
        let mut rcc = Rcc::new(24e6);
        assert_eq!(read(&mut rcc, CSR, 0), 0x0c00_0000);
        rcc.set_cause(Reset::Watchdog);
        assert_eq!(read(&mut rcc, CSR, 0), 0x2c00_0000);
        write(&mut rcc, CSR, RMVF, 0);
        assert_eq!(read(&mut rcc, CSR, 0), 0);
        rcc.set_cause(Reset::Software);
        rcc.set_cause(Reset::Power);
        assert_eq!(read(&mut rcc, CSR, 0), 0x0c00_0000);
    }

    #[test]
    fn gates_open_and_close() {
        let mut rcc = Rcc::new(24e6);
        let spi2 = Gate(APB1ENR1, 14);
        assert!(!rcc.is_on(spi2));
        write(&mut rcc, APB1ENR1, 1 << 14, 0);
        write(&mut rcc, 0x38, 1 << 14, 0);
        assert!(rcc.is_on(spi2) && rcc.is_reset(spi2));
        assert!(rcc.is_on(Gate(AHB1ENR, 8)), "flash is clocked after reset");
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("RCC", "CR", HSION, HSIRDY, HSEON, HSERDY, HSEBYP, CSSON, PLLON, PLLRDY);
        fields_agree!("RCC", "CIFR", CSSF);
        fields_agree!("RCC", "BDCR", RTCEN = RTC_ON_LSI & 1 << 15);
        fields_agree!("RCC", "CSR", RMVF);
        fields_agree!(
            "RCC",
            "CSR",
            OBLRSTF = Reset::OptionBytes.flags() & !Reset::Pin.flags(),
            PINRSTF = Reset::Pin.flags(),
            BORRSTF = Reset::Power.flags() & !Reset::Pin.flags(),
            SFTRSTF = Reset::Software.flags() & !Reset::Pin.flags(),
            IWDGRSTF = Reset::Watchdog.flags() & !Reset::Pin.flags()
        );
    }
}
