//! The chip's own temperature and voltage reference, by ADC5.
//!
//! Converts twice, because the first conversion more than 1 ms after the previous one may be wrong (ES0430 2.7.9), and
//! between two samples, because starting a converter may disturb another one's conversion (ES0430 2.7.11).
//!
//! Source: RM0440 21.4.32 and 21.4.34; DS12288 tables 5 and 6 (calibration at 30 and 130 degrees, supply of 3.0 V).

use crate::boards::clock::CORE_PER_US;
use crate::{adc, rings};
use core::ptr;
use embassy_stm32::pac::adc::vals::SampleTime;
use embassy_stm32::pac::{ADC5, ADC345_COMMON, RCC};

/// Channels of the sensor and of the reference.
const SENSOR: u8 = 4;
const REFERENCE: u8 = 18;
/// Polls of the converter, of at least 10 cycles each: a conversion takes 1000.
const POLLS: u32 = 1_000;
/// Core clocks per conversion: (247.5 + 12.5) converter clocks, each four of the core's, and two until it starts.
const CONVERSION: u16 = 7 * CORE_PER_US as u16;
const CALIBRATION_30: *const u16 = 0x1FFF_75A8 as *const u16;
const CALIBRATION_130: *const u16 = 0x1FFF_75CA as *const u16;
const CALIBRATION_REFERENCE: *const u16 = 0x1FFF_75AA as *const u16;
/// Supply here divided by supply at the calibration.
const SUPPLY: f32 = 3.3 / 3.0;

/// Polls for a gap between two samples, of at least 10 cycles each: two periods of sampling.
const MOMENTS: u32 = 500;

/// The sensor, switched on.
pub struct Sensor {
    /// Whether its converter is ready.
    ready: bool,
}

impl Sensor {
    /// Switches the sensor on.
    pub fn new() -> Self {
        critical_section::with(|_| RCC.ahb2enr().modify(|w| w.set_adc345en(true)));
        adc::choose_clock(ADC345_COMMON);
        ADC345_COMMON.ccr().modify(|w| {
            w.set_vsenseen(true);
            w.set_vrefen(true);
        });
        let ready = adc::switch_on(ADC5);
        // 5.9 us at 42 MHz; the sensor needs 5, the reference 4.
        ADC5.smpr().write(|w| w.set_smp(usize::from(SENSOR), SampleTime::CYCLES247_5));
        ADC5.smpr2().write(|w| w.set_smp(usize::from(REFERENCE - 10), SampleTime::CYCLES247_5));
        Self { ready }
    }

    /// Temperature in degrees Celsius, to about 5; takes at most 45 us. `None` if the converter does not respond or the
    /// chip has no calibration.
    pub fn read_c(&mut self) -> Option<f32> {
        let code = f32::from(self.read(SENSOR)?) * SUPPLY;
        let [at_30, at_130, _] = factory();
        let (at_30, at_130) = (f32::from(at_30), f32::from(at_130));
        (at_130 > at_30).then(|| 30.0 + (code - at_30) * 100.0 / (at_130 - at_30))
    }

    /// Codes of the sensor and of the reference, as [`read_c`](Self::read_c) gets them.
    pub fn codes(&mut self) -> Option<(u16, u16)> {
        Some((self.read(SENSOR)?, self.read(REFERENCE)?))
    }

    fn read(&mut self, channel: u8) -> Option<u16> {
        ADC5.sqr1().write(|w| w.set_sq(0, channel));
        self.convert()?;
        self.convert()
    }

    fn convert(&mut self) -> Option<u16> {
        let start = || {
            critical_section::with(|_| {
                let starts = self.ready && rings::rest_for(CONVERSION);
                if starts {
                    ADC5.cr().modify(|w| w.set_adstart(true));
                }
                starts
            })
        };
        if !(0..MOMENTS).any(|_| start()) {
            return None;
        }
        // Reading the result clears the flag.
        (0..POLLS).any(|_| ADC5.isr().read().eoc()).then(|| ADC5.dr().read().rdata())
    }
}

/// Factory calibration codes: the sensor at 30 and at 130 degrees, the reference.
pub fn factory() -> [u16; 3] {
    // SAFETY: constants of the chip, in its system memory.
    unsafe { [ptr::read(CALIBRATION_30), ptr::read(CALIBRATION_130), ptr::read(CALIBRATION_REFERENCE)] }
}
