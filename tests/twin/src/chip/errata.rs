//! Errata of the chip, each a switch of the model.
//!
//! docs/HARDWARE.md ("Errata") says which concern the board, and which test is whose. The errata sheet ES0430 itself was
//! not at hand: numbers are as others cite them, and only what stands in quotation marks was read, at the place named.
//! How an erratum shows itself here is the model's choice, at its worst. All are on unless a test turns them off.

/// Which errata the model has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Errata {
    /// 2.2.7, as cited; no public words found. The first write to each SRAM after a reset at an unlucky moment may be
    /// lost. Here: to SRAM1 and SRAM2, after every reset.
    pub first_write_lost: bool,
    /// 2.2.3, as cited; no public words found. ECCR may be wrong when a place is read whose write or erase was cut short;
    /// ST's X-CUBE-EEPROM goes by an address of its own. Here: bank, address and the flag of system flash, always.
    pub eccr_after_cut: bool,
    /// 2.7.9 (2.7.7 in older revisions): "The result of an ADC conversion done more than 1 ms later than the previous ADC
    /// conversion or ADC calibration might be incorrect", of the families L4, L5 and G4 (efton.sk, STM32 gotchas, 150).
    /// Here: 0.4 V too much.
    pub adc_after_pause: bool,
    /// 2.7.10, as cited; no public words found. The first conversion after ADSTP may be of channel 0; ST's motor control
    /// library and QMK convert once for nothing. Here: always, and channel 0 gives code 0.
    pub adc_after_stop: bool,
    /// 2.7.11, as cited; no public words found. The start of a converter may disturb a conversion of another one. Here:
    /// always, 0.4 V too much, where the two have not started at the same moment.
    pub adc_start_disturbs: bool,
    /// 2.18.1, as cited; no public words found. The busy flag may stay set. Here: after every frame, until SPE is cleared.
    pub spi_busy_stays: bool,
    /// Of the DMA, as cited without its number; no public words found. An error that comes as CGIF is written does not stop
    /// the channel. Here: CGIF to an enabled channel ends the run.
    pub dma_global_clear: bool,
    /// "Unstable LSI when it clocks RTC or CSS on LSE" (ES0431, the sheet of the STM32G431, revision 7, 2.2.3). Here: ends
    /// the run.
    pub lsi_with_rtc: bool,
}

impl Errata {
    /// The chip as it is.
    pub const ALL: Self = Self {
        first_write_lost: true,
        eccr_after_cut: true,
        adc_after_pause: true,
        adc_after_stop: true,
        adc_start_disturbs: true,
        spi_busy_stays: true,
        dma_global_clear: true,
        lsi_with_rtc: true,
    };
    /// The chip of the reference manual.
    pub const NONE: Self = Self {
        first_write_lost: false,
        eccr_after_cut: false,
        adc_after_pause: false,
        adc_after_stop: false,
        adc_start_disturbs: false,
        spi_busy_stays: false,
        dma_global_clear: false,
        lsi_with_rtc: false,
    };
}

impl Default for Errata {
    fn default() -> Self {
        Self::ALL
    }
}
