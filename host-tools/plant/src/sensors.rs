//! The instruments: how the rig's encoder, load cell and displacement sensor measure the truth.
//!
//! - position: `floor((x2 + eccentricity) / metres_per_count + encoder_phase_count)`, wrapping like a 32-bit counter.
//! - force: `gain (F + mr x1'')` delayed by `delay_s` `+ offset + drift t + pickup + knock + noise`, rounded to codes,
//!   clipped to the code limits. The pickup is a sine, the knock a half sine.
//! - terminal: `x1 + noise`, rounded to codes.
//!
//! With `oversampling` N, position and force are sums over N evenly spaced sub-samples per sample, as in a device whose
//! timer triggers N conversions; the terminal code is one conversion at the sample's time. White noise is stated per
//! sample: a sub-sample has `sqrt(N)` times as much.

use std::f64::consts::{PI, TAU};

use crate::PlantError;
use crate::table::field_table;

field_table! {
/// Settings of the instruments, and the seed of their noise.
pub struct Sensors {
    /// Samples per second \[Hz\].
    sample_rate_hz, "Hz", 1000.0, 10.0, 64000.0, Real, "Samples per second";
    /// Sub-samples summed into one sample of position and force.
    oversampling, "", 1.0, 1.0, 64.0, Whole, "Sub-samples summed into one sample";
    /// Displacement per encoder count; a negative value reverses the direction \[m\].
    metres_per_count, "m", 2.44140625e-6, -1e-1, 1e-1, Real, "Displacement per encoder count";
    /// Encoder phase at `x2 = 0`, as a fraction of a count.
    encoder_phase_count, "", 0.0, -1e6, 1e6, Real, "Encoder position within a count at the start";
    /// Amplitude of the encoder's once-per-revolution error \[m\].
    encoder_eccentricity_m, "m", 0.0, 0.0, 1e-1, Real, "Amplitude of the once-per-turn error";
    /// Phase of that error at `x2 = 0` \[rad\].
    encoder_eccentricity_phase_rad, "rad", 0.0, -10.0, 10.0, Real, "Phase of the once-per-turn error";
    /// Travel per revolution, for the once-per-revolution error \[m\].
    lead_m, "m", 0.010, 1e-5, 1e2, Real, "Travel per turn";
    /// Force per code of one conversion; a negative value reverses the direction \[N\].
    newtons_per_code, "N", 0.002, -1e3, 1e3, Real, "Force per code";
    /// Code at zero force.
    force_zero_code, "", 0.0, -8388608.0, 8388607.0, Whole, "Code at no force";
    /// Minimum code of the converter.
    force_min_code, "", -8388608.0, -8388608.0, 8388607.0, Whole, "Lowest code of the converter";
    /// Maximum code of the converter.
    force_max_code, "", 8388607.0, -8388608.0, 8388607.0, Whole, "Highest code of the converter";
    /// Gain of the load cell.
    force_gain, "", 1.0, 1e-3, 1e3, Real, "Gain of the load cell";
    /// Offset of the load cell \[N\].
    force_offset_n, "N", 0.0, -1e5, 1e5, Real, "Offset of the load cell";
    /// Drift of the offset \[N/s\].
    force_drift_n_per_s, "N/s", 0.0, -1e3, 1e3, Real, "Drift of the offset";
    /// White noise of one sample, rms \[N\].
    force_noise_n, "N", 0.0, 0.0, 1e4, Real, "White noise of one sample, rms";
    /// Delay of the force relative to the position \[s\].
    delay_s, "s", 0.0, -0.1, 0.1, Real, "Delay of the force behind the position";
    /// Amplitude of mains pickup in the force \[N\].
    pickup_n, "N", 0.0, 0.0, 1e4, Real, "Amplitude of the mains in the force";
    /// Frequency of the mains \[Hz\].
    pickup_hz, "Hz", 50.0, 1.0, 1e4, Real, "Frequency of the mains";
    /// Peak force of a knock on the load cell \[N\].
    knock_n, "N", 0.0, -1e6, 1e6, Real, "Height of a knock on the load cell";
    /// Its start \[s\].
    knock_at_s, "s", 5.0, 0.0, 1e9, Real, "Start of the knock";
    /// Its duration \[s\].
    knock_s, "s", 0.004, 1e-5, 10.0, Real, "Length of the knock, half a sine";
    /// Displacement per code of the terminal sensor; a negative value reverses the direction \[m\].
    metres_per_terminal_code, "m", 1e-7, -1e-1, 1e-1, Real, "Displacement per code of the terminal sensor";
    /// White noise of the terminal sensor, rms \[m\].
    terminal_noise_m, "m", 0.0, 0.0, 1e-1, Real, "White noise of the terminal sensor, rms";
    /// Probability that a sample is lost: its index is skipped.
    lost_probability, "", 0.0, 0.0, 0.99, Real, "Probability that a sample is lost";
}
/// Seed of noise and losses.
seed: u64 = 0 }

/// The rig of the accuracy grid, without noise: 1 kHz, 2.44 um per count (4096 counts on a 10 mm lead), 2 mN per code.
impl Default for Sensors {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Sensors {
    /// Checks every single value, and the conditions between them.
    pub fn validate(&self) -> Result<(), PlantError> {
        self.check_fields()?;
        let scales = [
            ("metres_per_count", self.metres_per_count),
            ("newtons_per_code", self.newtons_per_code),
            ("metres_per_terminal_code", self.metres_per_terminal_code),
        ];
        for (field, value) in scales {
            if value.abs() < 1e-12 {
                return Err(PlantError::OutOfRange { field, value, min: 1e-12, max: 1e3 });
            }
        }
        let within = (self.force_min_code..=self.force_max_code).contains(&self.force_zero_code);
        if self.force_min_code >= self.force_max_code || !within {
            return Err(PlantError::Conflict {
                field: "force_min_code",
                other: "force_max_code",
                rule: "the least code must be below the greatest, and force_zero_code between them",
            });
        }
        Ok(())
    }

    /// Force per unit of [`force_code`](crate::Sample::force_code), which is a sum over the sub-samples \[N\].
    pub fn newtons_per_sample_code(&self) -> f64 {
        self.newtons_per_code / self.oversampling
    }

    /// Displacement per unit of [`position_count`](crate::Sample::position_count), a sum over the sub-samples \[m\].
    pub fn metres_per_sample_count(&self) -> f64 {
        self.metres_per_count / self.oversampling
    }

    /// Unwrapped count of the encoder.
    pub(crate) fn count(&self, x2_m: f64) -> i64 {
        let turn = TAU * x2_m / self.lead_m + self.encoder_eccentricity_phase_rad;
        let wobble = if self.encoder_eccentricity_m == 0.0 { 0.0 } else { self.encoder_eccentricity_m * turn.sin() };
        ((x2_m + wobble) / self.metres_per_count + self.encoder_phase_count).floor() as i64
    }

    /// Code of one conversion of a force that already includes its noise, and whether the converter was at a limit.
    pub(crate) fn code(&self, cell_n: f64, t_s: f64, noise_n: f64) -> (i32, bool) {
        let mut measured = self.force_gain * cell_n + self.force_offset_n + self.force_drift_n_per_s * t_s + noise_n;
        if self.pickup_n != 0.0 {
            measured += self.pickup_n * (TAU * self.pickup_hz * t_s).sin();
        }
        let since_knock_s = t_s - self.knock_at_s;
        if self.knock_n != 0.0 && (0.0..self.knock_s).contains(&since_knock_s) {
            measured += self.knock_n * (PI * since_knock_s / self.knock_s).sin();
        }
        let (least, greatest) = (self.force_min_code, self.force_max_code);
        let code = (measured / self.newtons_per_code + self.force_zero_code).round().clamp(least, greatest);
        (code as i32, code == least || code == greatest)
    }

    /// Code of the terminal sensor.
    pub(crate) fn terminal_code(&self, x1_m: f64, noise_m: f64) -> i32 {
        ((x1_m + noise_m) / self.metres_per_terminal_code).round() as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_name_the_field() {
        let usual = Sensors::default();
        for (sensors, words) in [
            (Sensors { metres_per_count: 0.0, ..usual }, "metres_per_count"),
            (Sensors { oversampling: 1.5, ..usual }, "oversampling: 1.5 is not a whole"),
            (Sensors { force_min_code: 5.0, ..usual }, "force_min_code"),
            (Sensors { lost_probability: f64::NAN, ..usual }, "lost_probability"),
        ] {
            assert!(sensors.validate().unwrap_err().to_string().contains(words), "{words}");
        }
    }

    #[test]
    fn the_encoder_floors_with_its_phase_and_error() {
        let sensors = Sensors { metres_per_count: 1e-6, encoder_phase_count: 0.25, ..Sensors::default() };
        assert_eq!(sensors.count(0.0), 0);
        assert_eq!(sensors.count(0.74e-6), 0);
        assert_eq!(sensors.count(0.76e-6), 1);
        assert_eq!(sensors.count(-0.26e-6), -1);
        let sensors = Sensors { encoder_eccentricity_m: 5e-6, ..sensors };
        assert_eq!(sensors.count(0.0025), 2505);
        assert_eq!(sensors.count(0.0075), 7495);
    }

    #[test]
    fn the_converter_holds_to_its_limits() {
        let sensors = Sensors {
            newtons_per_code: 0.5,
            force_zero_code: 2048.0,
            force_min_code: 0.0,
            force_max_code: 4095.0,
            force_gain: 2.0,
            force_offset_n: 3.0,
            force_drift_n_per_s: 0.5,
            ..Sensors::default()
        };
        assert_eq!(sensors.code(10.0, 4.0, 1.0), (2048 + 52, false));
        assert_eq!(sensors.code(1e6, 0.0, 0.0), (4095, true));
        assert_eq!(sensors.code(-1e6, 0.0, 0.0), (0, true));
    }
}
