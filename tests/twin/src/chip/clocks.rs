//! Clock frequencies of the chip, and the conversion between cycles and seconds.

/// Core cycles since power was first applied. Never decreases, even over a reset or a power cut.
pub type Cycles = u64;

/// Frequencies in use since a given time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clocks {
    /// Time from which they apply \[cycles\].
    pub since: Cycles,
    /// The same time in seconds since power was first applied.
    pub since_s: f64,
    /// Core, AHB and DMA clock \[Hz\]: the unit of [`Cycles`].
    pub hclk_hz: f64,
    /// APB1 peripherals \[Hz\].
    pub pclk1_hz: f64,
    /// APB2 peripherals \[Hz\].
    pub pclk2_hz: f64,
    /// Timers on APB1 \[Hz\].
    pub timer1_hz: f64,
    /// Timers on APB2 \[Hz\].
    pub timer2_hz: f64,
    /// 48 MHz clock of USB \[Hz\], 0 while it is off.
    pub usb_hz: f64,
    /// LPUART1 kernel clock \[Hz\].
    pub lpuart1_hz: f64,
    /// ADC1 and ADC2 kernel clock, used if the ADC clock is not derived from HCLK \[Hz\]; 0 while it is off.
    pub adc12_hz: f64,
    /// The same for ADC3 to ADC5.
    pub adc345_hz: f64,
}

impl Clocks {
    /// After power-on: everything runs from HSI, 16 MHz.
    pub const POWER_ON: Self = Self {
        since: 0,
        since_s: 0.0,
        hclk_hz: 16e6,
        pclk1_hz: 16e6,
        pclk2_hz: 16e6,
        timer1_hz: 16e6,
        timer2_hz: 16e6,
        usb_hz: 0.0,
        lpuart1_hz: 16e6,
        adc12_hz: 0.0,
        adc345_hz: 0.0,
    };

    /// Seconds since power was first applied, at a time not before [`Self::since`].
    pub fn seconds(&self, at: Cycles) -> f64 {
        self.since_s + at.saturating_sub(self.since) as f64 / self.hclk_hz
    }

    /// The first cycle that is not before `time_s`, nor before [`Self::since`]. A wait for a later time thus always
    /// makes progress.
    pub fn cycle_at(&self, time_s: f64) -> Cycles {
        self.since + ((time_s - self.since_s) * self.hclk_hz).max(0.0).ceil() as Cycles
    }

    /// A duration in cycles, rounded to the nearest, at least one.
    pub fn cycles_in(&self, length_s: f64) -> Cycles {
        ((length_s * self.hclk_hz).round() as Cycles).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_and_cycles() {
        let clocks = Clocks { since: 1000, since_s: 0.5, hclk_hz: 168e6, ..Clocks::POWER_ON };
        assert_eq!(clocks.seconds(1000 + 168), 0.5 + 1e-6);
        assert_eq!((clocks.cycle_at(0.5 + 0.9e-6), clocks.cycle_at(0.5 + 1.1e-6)), (1152, 1185));
        assert_eq!(clocks.cycle_at(0.0), 1000);
        assert_eq!(clocks.cycles_in(1e-3), 168_000);
        assert_eq!(clocks.cycles_in(0.0), 1);
    }
}
