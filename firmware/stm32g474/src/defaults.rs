//! The board's default settings.

use crate::boards::clock::ADC_HZ;
use inerter_app::boxcar::{LOWER_RAIL, UPPER_RAIL, WEIGHT};
use inerter_core::Settings;
use inerter_wire::ClockSource;

/// Time from the event to the converted force, in ns: 2 converter clocks of trigger latency (1.5 to 2.5, uniformly) and
/// 24.5 of sampling (DS12288, table 66; the input is held at the end of sampling).
const FORCE_NS: f64 = (2.0 + 24.5) / (ADC_HZ as f64 * 1e-9);
/// Time from the shaft's position to the event at which it is fetched, in ns: the inputs' filter takes 6 samples at 84
/// MHz, synchronisation and count about 5 clocks of 168 MHz, and the fetch comes about 8 clocks after the event.
const POSITION_NS: f64 = 6.0 / 0.084 + (5.0 - 8.0) / 0.168;

/// Settings of a device that was never configured: the analogue front end at 1 kHz.
///
/// The force is sampled `FORCE_NS` after the event, the position `POSITION_NS` before it: the force is 0.68 us *ahead*.
/// The user must add the delay of the amplifier and its filter.
pub fn settings(clock: ClockSource) -> Settings {
    let mut settings = Settings {
        sample_rate_hz: 1_000.0,
        oversampling: f64::from(WEIGHT),
        // 5.2 kN over the converter's range, 1.3 N per step of a single conversion.
        newtons_per_code: 0.02,
        force_zero_code: f64::from((LOWER_RAIL + UPPER_RAIL) / 2),
        force_min_code: f64::from(LOWER_RAIL),
        force_max_code: f64::from(UPPER_RAIL),
        skew_s: -(FORCE_NS + POSITION_NS) * 1e-9,
        ..Settings::default()
    };
    if clock == ClockSource::Internal {
        // DS12288, table 43: 1 % over temperature.
        settings.timebase_u95 = 0.01;
    }
    settings
}
