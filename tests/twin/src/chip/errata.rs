//! Errata of the chip; a test can turn each one on or off.
//!
//! docs/HARDWARE.md ("Errata") lists which of them concern the board, and which test covers which. The errata sheet
//! ES0430 itself was not available. Numbers are as others cite them (revision 9 unless stated), and only text in
//! quotation marks was read, at the place named. Where an erratum leaves its effect open, the model assumes the worst
//! case. All errata are on unless a test turns them off. For each, a test of the model shows its effect, and that there
//! is none without it.

/// The errata that the model applies, by default none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Errata {
    /// 2.2.7. The first write to each part of SRAM after a reset at an unlucky moment may be lost. A part with parity
    /// must be initialised; for the others a read is enough. The boot loader of public firmware does so (startup_ram.c
    /// with `__wrap_SystemInit`, "ES0430 Rev9 2.2.7", at 0x2000_0000, 0x2000_8000, 0x2001_0000 and 0x2001_4000). In the
    /// model: the first write to each of the four parts is lost after every reset.
    pub first_write_lost: bool,
    /// 2.2.2, "Data cache might be corrupted during Flash memory read-while-write operation" (Zephyr, flash_stm32g4x.c,
    /// of revision 7). In the model: a program or erase that starts with the data cache on ends the run.
    pub data_cache: bool,
    /// 2.2.3, as cited; no public wording found. ECCR may be wrong when a location is read whose program or erase was
    /// interrupted. ST's X-CUBE-EEPROM relies on an address that it stores itself. In the model: bank, address and the
    /// system flash flag are always inverted.
    pub eccr_after_cut: bool,
    /// 2.7.9 (2.7.7 in older revisions): "The result of an ADC conversion done more than 1 ms later than the previous
    /// ADC conversion or ADC calibration might be incorrect", for the families L4, L5 and G4 (efton.sk, STM32 gotchas,
    /// 150). In the model: such a result is 0.4 V too high, and so is always the first after a reset. Only conversions
    /// count, not calibrations.
    pub adc_after_pause: bool,
    /// 2.7.10 (2.7.8 in revision 8; 2.5.8 in the sheet of the STM32G431), "ADC channel 0 converted instead of the
    /// required ADC channel" (ST's motor control library, R3_2_G4XX; QMK, analog.c; NuttX, pull request 3878). In
    /// revision Y of the chip: after ADSTP, after the last transfer of a one-shot DMA, and where injected conversions
    /// meet regular ones (a public review of a motor board, round5_c_mcu.md, R5C-05). In the model: always the first
    /// conversion after each of the first two, and channel 0 gives code 0.
    pub adc_after_stop: bool,
    /// 2.7.11 (2.7.9 in revision 8). ADC1 and ADC2 in a dual mode "do not impact one another whatever the clock
    /// source". All others that convert at the same time need one source divided by 1, or else "trigger them with the
    /// same timer using the same clock prescaler division ratio (or its integer multiple) as the ADC prescaler"
    /// (revision 8, as quoted by a public review of a motor board with this chip, round4_c_mcu.md, R4C-03). Others
    /// agree: "must use PLL instead of ADC prescaler to avoid performance degradation" (a motor controller's
    /// board_hw.h); "the same resolution, clock source and prescaler 1" (Embedbits/Bsp-Mcal-Adc, README); "ADC1/2
    /// results can be corrupted" at some phases of the divided clocks (moteus, fw/stm32g4_adc.cc). In the model:
    /// results are always 0.4 V too high if two conversions did not start at the same moment, if their clocks differ,
    /// or if the clocks are divided and the trigger's phase differs from that of the first trigger.
    pub adc_concurrent: bool,
    /// 2.18.1, "BSY bit may stay high when SPI is disabled" (Embedbits/Bsp-Mcal-Spi, README). ST's sheet of the
    /// STM32F078, whose SPI is of the same kind, has the full text: "The BSY flag may remain high upon disabling the
    /// SPI while operating in: a master transmit mode and the TXE flag is low"; "disable the SPI when TXE=1 and BSY=0".
    /// In the model: BSY stays set if the SPI is disabled with anything left to send, until the peripheral is reset.
    pub spi_busy_stays: bool,
    /// "DMA disable failure and error flag omission upon simultaneous transfer error and global flag clear" (a driver
    /// for the STM32G0, whose DMA is of the same kind; ES0548, 2.4.1). In the model: writing CGIF for an enabled
    /// channel ends the run.
    pub dma_global_clear: bool,
    /// "Unstable LSI when it clocks RTC or CSS on LSE" (ES0431, the sheet of the STM32G431, revision 7, 2.2.3). In the
    /// model: it ends the run.
    pub lsi_with_rtc: bool,
}

impl Errata {
    /// The chip with all its errata.
    pub const ALL: Self = Self::each(true);
    /// The chip as the reference manual describes it.
    pub const NONE: Self = Self::each(false);

    const fn each(on: bool) -> Self {
        Self {
            first_write_lost: on,
            data_cache: on,
            eccr_after_cut: on,
            adc_after_pause: on,
            adc_after_stop: on,
            adc_concurrent: on,
            spi_busy_stays: on,
            dma_global_clear: on,
            lsi_with_rtc: on,
        }
    }
}
