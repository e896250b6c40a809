//! The ADS131M04 on SPI2: the digital front end.
//!
//! The driver crate's mock provides registers and frames; this module provides modulators, filter and clock. A
//! conversion is the filter's output from the voltages before it: a sinc3 over N modulator samples, then the mean of M
//! of its outputs (SBAS890, "SINC3 and SINC3 + SINC1 Filter"). The filter is computed on a grid of N/16 modulator
//! samples. This omits three boxes of one grid step; their delay is added, and their droop is 3e-6 at 50 Hz. A
//! modulator sample represents the middle of its period. A conversion therefore lags by `3 N / 2` periods, less half a
//! period for each box, plus that half: [`Filter::delay_clkin`].
//!
//! Channel 0 is the bridge, 1 its excitation, 2 the terminal displacement; 3 is open.
//!
//! Connections: CS PB12, SYNC/RESET PB11, DRDY PB10, CLKIN PA8 from TIM1_CH1. Without CLKIN nothing is converted and no
//! reset takes effect. A change of CLKIN restarts the conversion.

use std::collections::VecDeque;

use ads131m04::mock;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};

use super::pin::Pin;
use crate::registers::refuse_if;
use crate::{Cycles, Modelled, World};

/// Chip select, active low.
pub const CS: Pin = Pin::new('B', 12);
/// Data ready, active low.
pub const DRDY: Pin = Pin::new('B', 10);
/// Reset, active low.
pub const RESET: Pin = Pin::new('B', 11);
/// Clock.
pub const CLKIN: Pin = Pin::new('A', 8);

/// Maximum SPI clock \[Hz\] (SBAS890, timing requirements, 2.7 to 3.6 V).
const GREATEST_RATE_HZ: f64 = 25e6;
/// Range of CLKIN in high-resolution mode \[Hz\] (SBAS890, recommended operating conditions).
const CLKIN_HZ: std::ops::RangeInclusive<f64> = 0.3e6..=8.4e6;
/// Grid steps in the length N of a box.
const GRID: u32 = 16;
/// CLKIN periods per modulator sample.
const CLKIN_PER_SAMPLE: u32 = 2;
const CHANNELS: usize = 4;
/// Address of the CLOCK register; a write to it restarts the conversion.
const CLOCK: u8 = 0x03;

/// Decimation filter, computed on the grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Filter {
    /// Weight of each step, the latest first; the sum is 1.
    weights: Vec<f64>,
    /// Modulator samples per step.
    step_samples: u32,
    /// CLKIN periods from one conversion to the next.
    pub period_clkin: u32,
}

impl Filter {
    /// The filter for N and M.
    pub fn new((n, m): (u32, u32)) -> Self {
        let convolve = |a: &[f64], b: &[f64]| {
            let mut sum = vec![0.0; a.len() + b.len() - 1];
            for (i, x) in a.iter().enumerate() {
                for (j, y) in b.iter().enumerate() {
                    sum[i + j] += x * y;
                }
            }
            sum
        };
        let grid = GRID as usize;
        let once = vec![1.0 / f64::from(GRID); grid];
        let mut mean = vec![0.0; (m as usize - 1) * grid + 1];
        mean.iter_mut().step_by(grid).for_each(|weight| *weight = 1.0 / f64::from(m));
        let weights = convolve(&convolve(&convolve(&once, &once), &once), &mean);
        Self { weights, step_samples: n / GRID, period_clkin: CLKIN_PER_SAMPLE * n * m }
    }

    /// CLKIN periods from the middle of the latest step to the end of the conversion.
    fn latest_clkin(&self) -> u32 {
        // Three boxes of c = `step_samples`, and half a sample: 3 (c - 1) / 2 + 1/2 samples of two periods each.
        3 * (self.step_samples - 1) + 1
    }

    /// Group delay \[CLKIN periods\].
    pub fn delay_clkin(&self) -> f64 {
        let step = f64::from(CLKIN_PER_SAMPLE * self.step_samples);
        f64::from(self.latest_clkin()) + 0.5 * (self.weights.len() - 1) as f64 * step
    }

    fn steps_per_conversion(&self) -> u32 {
        self.period_clkin / (CLKIN_PER_SAMPLE * self.step_samples)
    }
}

/// The signals at the device's input pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inputs {
    /// Level of CS.
    pub cs: bool,
    /// Level of SYNC/RESET.
    pub reset: bool,
    /// Core cycles per period of CLKIN, while it runs (at 168 MHz: 21 for 8 MHz).
    pub clkin_cycles: Option<Cycles>,
}

/// The clock at CLKIN.
#[derive(Clone, Copy, Debug, Default)]
struct Clkin {
    cycles: Option<Cycles>,
    /// Periods up to the last change of CLKIN, and the time of that change.
    periods: u64,
    since: Cycles,
}

impl Clkin {
    fn periods(&self, now: Cycles) -> u64 {
        self.periods + self.cycles.map_or(0, |cycles| (now - self.since) / cycles)
    }
}

/// The device and the levels at its inputs.
#[derive(Clone, Debug)]
pub struct Ads131m04 {
    /// Registers, frames, buffer. Public, so that tests can disturb them.
    pub chip: mock::Chip,
    clkin: Clkin,
    /// The decimation filter in use.
    pub filter: Filter,
    /// Voltages of the channels at the grid steps, the latest first.
    history: VecDeque<[f64; CHANNELS]>,
    /// End of the next conversion; [`convert`](Self::convert) must be called then.
    pub due: Option<Cycles>,
    selected: bool,
    in_reset: bool,
    noise: [f64; CHANNELS],
    rng: ChaCha8Rng,
}

impl Ads131m04 {
    /// A device just powered on. `noise_v` is the rms noise of a conversion of each channel \[V\], `seed` its seed.
    pub fn new(noise_v: [f64; CHANNELS], seed: u64) -> Self {
        let chip = mock::Chip::new();
        let filter = Filter::new(chip.osr().stages());
        Self {
            chip,
            clkin: Clkin::default(),
            filter,
            history: VecDeque::new(),
            due: None,
            selected: false,
            in_reset: false,
            noise: noise_v,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// Removes power and restores it at `now`.
    pub fn power_cycle(&mut self, now: Cycles) {
        self.chip.power_cycle();
        self.selected = false;
        self.restart(now);
    }

    /// Applies the pin levels and the registers written over SPI. Call it after anything that may have changed them.
    pub fn follow(&mut self, inputs: Inputs, now: Cycles) {
        let Inputs { cs, reset, clkin_cycles } = inputs;
        let mut restart = false;
        if clkin_cycles != self.clkin.cycles {
            self.clkin = Clkin { cycles: clkin_cycles, periods: self.clkin.periods(now), since: now };
            restart = true;
        }
        if reset == self.in_reset {
            self.in_reset = !reset;
            self.chip.sync_reset(reset, self.clkin.periods(now));
            restart = true;
        }
        if cs == self.selected {
            let clock = self.chip.register(CLOCK);
            self.selected = !cs;
            self.chip.cs(!cs);
            // A write to CLOCK, the end of standby and the end of reset each restart the conversion.
            restart |= self.chip.register(CLOCK) != clock;
            restart |= self.due.is_some() != self.chip.period_clkin().is_some() && clkin_cycles.is_some();
        }
        if restart {
            self.restart(now);
        }
    }

    /// Restarts conversions.
    fn restart(&mut self, now: Cycles) {
        self.filter = Filter::new(self.chip.osr().stages());
        self.history.clear();
        self.due = self.after(now);
    }

    /// End of a conversion that starts now.
    fn after(&self, now: Cycles) -> Option<Cycles> {
        Some(now + Cycles::from(self.chip.period_clkin()?) * self.clkin.cycles?)
    }

    /// Ends the conversion in progress, which is due at `now`; `seconds` converts cycles to time.
    pub fn convert(&mut self, now: Cycles, seconds: impl Fn(Cycles) -> f64, world: &mut dyn World) {
        let clkin_cycles = self.clkin.cycles.unwrap_or(0);
        let step = Cycles::from(CLKIN_PER_SAMPLE * self.filter.step_samples) * clkin_cycles;
        let latest = now.saturating_sub(Cycles::from(self.filter.latest_clkin()) * clkin_cycles);
        let wanted = self.filter.weights.len();
        // After a restart, voltages over the filter's whole length are read, as the modulators were running before it.
        let fresh = if self.history.is_empty() { wanted } else { self.filter.steps_per_conversion() as usize };
        for back in (0..fresh as u64).rev() {
            let time_s = seconds(latest.saturating_sub(back * step));
            self.history.push_front([
                world.bridge_volts(time_s),
                world.excitation_volts(time_s),
                world.digital_terminal_volts(time_s),
                0.0,
            ]);
        }
        self.history.truncate(wanted);
        let mut codes = [0; CHANNELS];
        for (channel, code) in codes.iter_mut().enumerate() {
            let sum: f64 = self.history.iter().zip(&self.filter.weights).map(|(volts, w)| w * volts[channel]).sum();
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            *code = self.chip.code(channel, sum + self.noise[channel] * normal);
        }
        self.chip.convert(codes);
        self.due = self.after(now);
    }

    /// Exchanges a byte over SPI; `mode` is (CPOL, CPHA).
    pub fn exchange(&mut self, byte: u8, mode: (bool, bool), rate_hz: f64) -> Modelled<u8> {
        refuse_if(self.selected && mode != (false, true), "the ADS131M04 requires SPI mode 1 (CPOL 0, CPHA 1)")?;
        refuse_if(self.selected && rate_hz > GREATEST_RATE_HZ, "SCLK of the ADS131M04 is above 25 MHz")?;
        Ok(self.chip.shift(byte))
    }

    /// Refuses a CLKIN outside the device's range; `hclk_hz` is the core clock \[Hz\].
    pub fn check_clock(&self, hclk_hz: f64) -> Modelled {
        let outside = |cycles: Cycles| !CLKIN_HZ.contains(&(hclk_hz / cycles as f64));
        refuse_if(self.clkin.cycles.is_some_and(outside), "the ADS131M04's CLKIN is outside 0.3 to 8.4 MHz")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const CLKIN_CYCLES: Cycles = 21;
    const HCLK_HZ: f64 = 168e6;
    const CLKIN: f64 = HCLK_HZ / CLKIN_CYCLES as f64;

    /// A bridge voltage given as a function of time.
    struct Bridge<F>(F);

    impl<F: Fn(f64) -> f64> World for Bridge<F> {
        fn encoder(&mut self, _: f64) -> u32 {
            0
        }
        fn force_volts(&mut self, _: f64) -> f64 {
            0.0
        }
        fn terminal_volts(&mut self, _: f64) -> f64 {
            0.0
        }
        fn bridge_volts(&mut self, time_s: f64) -> f64 {
            (self.0)(time_s)
        }
    }

    const RUNNING: Inputs = Inputs { cs: true, reset: true, clkin_cycles: Some(CLKIN_CYCLES) };
    const SELECTED: Inputs = Inputs { cs: false, ..RUNNING };
    const RESET: Inputs = Inputs { reset: false, ..RUNNING };

    fn converter() -> Ads131m04 {
        let mut ads = Ads131m04::new([0.0; 4], 0);
        ads.follow(RUNNING, 0);
        ads
    }

    /// Reads channel 0 of the oldest conversion.
    fn read(ads: &mut Ads131m04) -> i32 {
        ads.follow(SELECTED, 0);
        let bytes: Vec<u8> = (0..18).map(|_| ads.exchange(0, (false, true), 10.5e6).unwrap()).collect();
        ads.follow(RUNNING, 0);
        i32::from_be_bytes([bytes[3], bytes[4], bytes[5], 0]) >> 8
    }

    #[test]
    fn the_weights_are_those_of_sinc3_and_sinc1() {
        for (stages, delay) in [((1024, 1), 1.5), ((1024, 2), 1.0), ((1024, 4), 0.75), ((256, 1), 1.5)] {
            let filter = Filter::new(stages);
            assert!((filter.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            // Each of the three boxes ends half a modulator sample before the continuous one, and half a sample is
            // added: in all one sample less, which is two CLKIN periods.
            let period = f64::from(filter.period_clkin);
            assert_eq!(filter.delay_clkin(), delay * period - 2.0, "{stages:?}");
            // Sinc3 has zeros at multiples of its output rate.
            let n = f64::from(stages.0);
            let gain = |cycles_per_n: f64| {
                let turn = TAU * cycles_per_n / f64::from(GRID);
                let part = |f: fn(f64) -> f64| -> f64 {
                    (0..).zip(&filter.weights).map(|(k, weight)| weight * f(turn * f64::from(k))).sum()
                };
                part(f64::cos).hypot(part(f64::sin))
            };
            assert!(gain(1.0) < 1e-12 && gain(2.0) < 1e-12);
            assert!(
                (gain(0.02) - (1.0 - f64::from(3 + stages.1.pow(2) - 1) * (TAU * 0.01).powi(2) / 6.0)).abs() < 1e-4
            );
            assert_eq!(period, 2.0 * n * f64::from(stages.1));
            // Error of the grid at 50 Hz, with frequency in units of CLKIN / (2 N): three boxes of a sixteenth of the
            // length.
            let exact = |cycles_per_n: f64| {
                let (x, m) = (0.5 * TAU * cycles_per_n, f64::from(stages.1));
                (x.sin() / x).powi(3) * ((m * x).sin() / (m * x.sin()))
            };
            let cycles = 50.0 * 2.0 * n / CLKIN;
            assert!((gain(cycles) / exact(cycles) - 1.0).abs() < 3.5e-6, "{stages:?}");
        }
    }

    #[test]
    fn conversions_come_at_the_data_rate_and_lag_by_the_group_delay() {
        let mut ads = converter();
        let slope = 1.0; // V/s
        let mut world = Bridge(|t: f64| slope * t);
        let period = 2048 * CLKIN_CYCLES;
        for n in 1..20 {
            assert_eq!(ads.due, Some(n * period));
            ads.convert(n * period, |cycles| cycles as f64 / HCLK_HZ, &mut world);
            assert!(!ads.chip.drdy());
            let volts = f64::from(read(&mut ads)) / 8_388_608.0 * 1.2;
            assert!(ads.chip.drdy());
            let expected = (n * period) as f64 / HCLK_HZ - ads.filter.delay_clkin() / CLKIN;
            if n > 3 {
                assert!((volts - slope * expected).abs() < 2e-7, "{n}: {volts} {expected}");
            }
        }
    }

    #[test]
    fn a_step_takes_three_conversions() {
        let mut ads = converter();
        let period = 2048 * CLKIN_CYCLES;
        let at_s = 10.0 * period as f64 / HCLK_HZ;
        let mut world = Bridge(move |t: f64| if t < at_s { 0.0 } else { 0.6 });
        let codes: Vec<i32> = (1..16)
            .map(|n| {
                ads.convert(n * period, |cycles| cycles as f64 / HCLK_HZ, &mut world);
                read(&mut ads)
            })
            .collect();
        assert!(codes[..10].iter().all(|code| *code == 0));
        // 1/6, 5/6 and 6/6 of half the full scale.
        let sixths: Vec<f64> = codes[10..].iter().map(|code| f64::from(*code) / 4_194_304.0 * 6.0).collect();
        assert!((sixths[0] - 1.0).abs() < 0.15 && (sixths[1] - 5.0).abs() < 0.15, "{sixths:?}");
        assert_eq!(codes[12..], [4_194_304; 3]);
    }

    #[test]
    fn reset_holds_conversions_back_and_they_begin_anew_after_it() {
        let mut ads = converter();
        ads.chip.disturb_register(0x04, 0x5555);
        ads.follow(RESET, 1000);
        assert_eq!(ads.due, None);
        // A reset pulse below 2048 periods only synchronises the conversion.
        ads.follow(RUNNING, 1000 + 2000 * CLKIN_CYCLES);
        assert_eq!(ads.due, Some(1000 + 2000 * CLKIN_CYCLES + 2048 * CLKIN_CYCLES));
        assert_eq!(ads.chip.register(0x04), 0x5555);
        ads.follow(RESET, 200_000);
        ads.follow(RUNNING, 200_000 + 3000 * CLKIN_CYCLES);
        assert_eq!(ads.chip.register(0x04), 0);
    }

    #[test]
    fn without_its_clock_it_neither_converts_nor_resets() {
        let mut ads = Ads131m04::new([0.0; 4], 0);
        let stopped = Inputs { clkin_cycles: None, ..RUNNING };
        ads.follow(stopped, 0);
        assert_eq!(ads.due, None);
        ads.chip.disturb_register(0x04, 0x5555);
        ads.follow(Inputs { reset: false, ..stopped }, 0);
        ads.follow(stopped, 1_000_000);
        assert_eq!(ads.chip.register(0x04), 0x5555);
        ads.follow(RUNNING, 2_000_000);
        assert_eq!(ads.due, Some(2_000_000 + 2048 * CLKIN_CYCLES));
        ads.follow(stopped, 2_000_100);
        assert_eq!(ads.due, None);
    }

    #[test]
    fn the_bus_must_be_one_that_the_chip_takes() {
        let mut ads = converter();
        assert_eq!(ads.exchange(0, (true, true), 50e6), Ok(0xFF), "not selected, it does not care");
        ads.follow(SELECTED, 0);
        assert!(ads.exchange(0, (true, true), 10e6).is_err());
        assert!(ads.exchange(0, (false, true), 42e6).is_err());
        assert!(ads.check_clock(HCLK_HZ).is_ok() && ads.check_clock(200e6).is_err());
    }

    #[test]
    fn noise_is_as_told() {
        let mut ads = Ads131m04::new([1e-6, 0.0, 0.0, 0.0], 5);
        ads.follow(RUNNING, 0);
        let mut world = Bridge(|_| 0.0);
        let lsb = 1.2 / 8_388_608.0;
        let count = 4000;
        let squares: f64 = (1..=count)
            .map(|n| {
                ads.convert(n * 2048 * CLKIN_CYCLES, |cycles| cycles as f64 / HCLK_HZ, &mut world);
                (f64::from(read(&mut ads)) * lsb).powi(2)
            })
            .sum();
        let rms = (squares / count as f64).sqrt();
        assert!((rms / 1e-6 - 1.0).abs() < 0.05, "{rms}");
    }
}
