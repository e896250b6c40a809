//! Errata of the chip, each a switch of the model; docs/HARDWARE.md says which concern the board and which test is whose.
//!
//! Numbers are those of the errata sheet ES0430, which could not be had; what stands here is what public programs by
//! ST and others say of it, in the words given at each field. All are on unless a test turns them off.

/// Which errata the model has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Errata {
    /// 2.2.7: "SRAM write error": the first write to each SRAM after a reset at an unlucky moment may be lost (the review
    /// of this firmware against the sheet; ST asks for a dummy access). SRAM1 and SRAM2 here, after every reset.
    pub first_write_lost: bool,
    /// 2.2.3: "FLASH_ECCR may be corrupted upon reset or power-down occurring during flash memory program or erase
    /// operation": bank, address and the flag of system flash are then wrong when the place is read (ST, X-CUBE-EEPROM,
    /// `flash_interface.c`, which therefore goes by an address of its own).
    pub eccr_after_cut: bool,
    /// 2.7.9: "ADC instance may deliver wrong conversion results" at the first conversion more than 1 ms after the one
    /// before (MicroPython, `ports/stm32/adc.c` and `machine_adc.c`, which convert twice).
    pub adc_after_pause: bool,
    /// 2.7.10: "Wrong ADC channel converted": the first conversion after ADSTP may be of channel 0 (ST's motor control
    /// library and QMK's `analog.c`, which convert once for nothing).
    pub adc_after_stop: bool,
    /// 2.18.1: "BSY bit may stay high" after the last frame (ST's HAL, `SPI_EndRxTxTransaction`, bounds each wait for it
    /// by a time). Here it does after every frame, until SPE is cleared.
    pub spi_busy_stays: bool,
    /// 2.3: "Unstable LSI when it clocks RTC": the watchdog runs on it too (Zephyr, ST's HAL release notes). The model
    /// ends the run.
    pub lsi_with_rtc: bool,
}

impl Errata {
    /// The chip as it is.
    pub const ALL: Self = Self {
        first_write_lost: true,
        eccr_after_cut: true,
        adc_after_pause: true,
        adc_after_stop: true,
        spi_busy_stays: true,
        lsi_with_rtc: true,
    };
    /// The chip of the reference manual.
    pub const NONE: Self = Self {
        first_write_lost: false,
        eccr_after_cut: false,
        adc_after_pause: false,
        adc_after_stop: false,
        spi_busy_stays: false,
        lsi_with_rtc: false,
    };
}

impl Default for Errata {
    fn default() -> Self {
        Self::ALL
    }
}
