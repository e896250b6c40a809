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
    /// 2.7.11 (2.7.9 in revision 8). ADC1 and ADC2 in a dual mode "do not impact one another whatever the clock source"; all others
    /// that convert at the same time need one source divided by 1, or else "trigger them with the same timer using the same
    /// clock prescaler division ratio (or its integer multiple) as the ADC prescaler": so a public review of a motor board with
    /// this chip quotes revision 8 (round4_c_mcu.md, R4C-03). Others agree: "must use PLL instead of ADC prescaler to avoid
    /// performance degradation" (a motor controller's board_hw.h); "the same resolution, clock source and prescaler 1"
    /// (Embedbits/Bsp-Mcal-Adc, README); "ADC1/2 results can be corrupted" at some phases of the divided clocks (moteus,
    /// fw/stm32g4_adc.cc). Here: always, 0.4 V too much, where two have not started at the same moment, where their clocks
    /// differ, or where they are divided and the trigger has another phase than the first one had.
    pub adc_concurrent: bool,
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
        adc_concurrent: true,
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
        adc_concurrent: false,
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
