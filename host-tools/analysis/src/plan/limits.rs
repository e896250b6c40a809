//! The limits of the rig.

use inerter_core::Settings;
use inerter_data::{names::unit, words::three_digits};
use serde::Serialize;

use super::{error::PlanError, expected::Expected, peaks::Peaks};

/// Shortest and longest planned motion \[s\]: beyond that, information grows only with the square root of time.
const DURATION_S: (f64, f64) = (2.0, 600.0);
/// Lowest frequency \[Hz\].
const LOWEST_HZ: f64 = 0.01;
/// Highest frequency \[Hz\]: the fast bank's kernel still passes a quarter.
const HIGHEST_HZ: f64 = 25.0;
/// Advice about a missing stroke.
const STROKE: &str = "state how far the terminal may move to either side of its middle";
/// Fraction of an instrument's range that a motion may use.
pub(super) const CLEAR: f64 = 0.9;
/// Range of what is more than 0.
const MORE_THAN_0: (f64, f64) = (f64::from_bits(1), f64::INFINITY);
/// Minimum encoder counts of a stroke, end to end.
const FEWEST_COUNTS: f64 = 20.0;

/// The limits of the rig.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Limits {
    /// Displacement to either side of the middle \[m\].
    pub stroke_m: f64,
    /// Speed of the terminal \[m/s\]; infinite if not stated.
    pub speed_m_per_s: f64,
    /// Force on the load cell \[N\]; infinite if not stated. The force channel's rails apply in any case.
    pub force_n: f64,
    /// Length of the motion \[s\].
    pub duration_s: f64,
    /// Lowest frequency \[Hz\].
    pub lowest_hz: f64,
    /// Highest frequency \[Hz\].
    pub highest_hz: f64,
    /// Length of the ramps from rest and to rest \[s\].
    #[serde(skip)]
    pub fade_s: f64,
}

impl Default for Limits {
    /// No limits except time and frequency: 20 s, four periods of the lowest frequency, and the highest one in the grid
    /// of motions (docs/tables/accuracy.md).
    fn default() -> Self {
        Self {
            stroke_m: f64::INFINITY,
            speed_m_per_s: f64::INFINITY,
            force_n: f64::INFINITY,
            duration_s: 20.0,
            lowest_hz: 0.0,
            highest_hz: 16.0,
            fade_s: 0.5,
        }
    }
}

impl Limits {
    /// With the ranges of the instruments, and checked against the expected device.
    pub fn checked(self, expected: &Expected) -> Result<Self, PlanError> {
        let within = |name, value: f64, (min, max): (f64, f64), wanted, help| match (min..=max).contains(&value) {
            true => Ok(()),
            false => Err(PlanError::Limit { name, value, wanted, help }),
        };
        within("--stroke-m", self.stroke_m, MORE_THAN_0, "more than 0", STROKE)?;
        let help = "leave it out where only stroke and force are limited";
        within("--speed-m-per-s", self.speed_m_per_s, MORE_THAN_0, "more than 0", help)?;
        let help = "leave it out where only the load cell's range is a limit";
        within("--force-n", self.force_n, MORE_THAN_0, "more than 0", help)?;
        if self.stroke_m.is_infinite() {
            return Err(PlanError::Unstated { missing: "--stroke-m", help: STROKE });
        }
        let help = "accuracy grows only with the square root of the time";
        within("--duration", self.duration_s, DURATION_S, "from 2 to 600 s", help)?;
        within(
            "--fade-s",
            self.fade_s,
            (0.05, 0.25 * self.duration_s),
            "from 0.05 s to a quarter of the duration",
            help,
        )?;
        let help = "the estimator's band ends at 25 Hz; without it the frequencies go up to 16 Hz";
        within("--highest-hz", self.highest_hz, (LOWEST_HZ, HIGHEST_HZ), "from 0.01 to 25 Hz", help)?;
        let lowest_hz =
            if self.lowest_hz == 0.0 { (4.0 / self.duration_s).min(self.highest_hz) } else { self.lowest_hz };
        within("--lowest-hz", lowest_hz, (LOWEST_HZ, HIGHEST_HZ), "from 0.01 to 25 Hz", "leave it out")?;
        if lowest_hz > self.highest_hz {
            return Err(PlanError::Conflict {
                one: "--lowest-hz",
                other: "--highest-hz",
                why: format!("{lowest_hz} Hz is above {} Hz", self.highest_hz),
                help: "swap them",
            });
        }
        if 2.0 / lowest_hz > self.duration_s {
            return Err(PlanError::Conflict {
                one: "--lowest-hz",
                other: "--duration",
                why: format!("two periods of {lowest_hz} Hz take {} s", 2.0 / lowest_hz),
                help: "allow more time, or a higher lowest frequency",
            });
        }
        let counts = 2.0 * self.stroke_m / expected.settings.metres_per_count.abs();
        if counts < FEWEST_COUNTS {
            return Err(PlanError::Conflict {
                one: "--stroke-m",
                other: "metres_per_count",
                why: format!("the whole stroke is {counts:.1} encoder counts"),
                help: "allow a longer stroke, or measure with a finer encoder",
            });
        }
        let newton = unit(expected.settings.machine, "N");
        let force_n = self.force_n.min(CLEAR * rails_n(&expected.settings));
        let breakaway_n =
            expected.device.coulomb_n * expected.device.stribeck_ratio + expected.device.constant_force_n.abs();
        if force_n <= 1.02 * breakaway_n {
            return Err(PlanError::Conflict {
                one: if force_n < self.force_n { "the force channel's range" } else { "--force-n" },
                other: "--coulomb-n",
                why: format!(
                    "{} {newton} cannot move a screw with {} {newton} of friction",
                    three_digits(force_n),
                    three_digits(breakaway_n)
                ),
                help: "allow a larger force, or expect less friction",
            });
        }
        let speed_m_per_s = self.speed_m_per_s.min(CLEAR * expected.settings.full_scale_velocity_m_per_s);
        Ok(Self { force_n, lowest_hz, speed_m_per_s, ..self })
    }

    /// Factor by which a motion with these peaks may be enlarged; below 1 if it is too large.
    pub fn room(&self, peaks: &Peaks) -> f64 {
        let each =
            [self.stroke_m / peaks.stroke_m, self.speed_m_per_s / peaks.speed_m_per_s, self.force_n / peaks.force_n];
        each.into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Largest force in either direction that the channel can measure \[N\].
fn rails_n(settings: &Settings) -> f64 {
    let up = settings.force_max_code - settings.force_zero_code;
    let down = settings.force_zero_code - settings.force_min_code;
    up.min(down) * settings.newtons_per_code.abs()
}
