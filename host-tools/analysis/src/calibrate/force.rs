//! Scale of the force from known loads.
//!
//! The code over the load is a line; its inverse slope is `newtons_per_code`, its value at zero load `force_zero_code`.
//! `force_gain_u95` is the root sum of squares of: the slope's scatter (Student), the largest deviation from the line,
//! half the hysteresis, the return to zero, the readings' own intervals (all relative to the largest load), and the
//! uncertainty of the loads themselves: masses and gravity.

use inerter_core::Settings;
use inerter_data::names::unit;

use super::{
    CalibrateError, Finding, Step,
    finding::Level,
    line::{Line, Point, sizes},
    rest,
    statistics::{Straight, rounded, rounded_up, together},
};

/// Standard gravity \[m/s^2\].
pub const STANDARD_GRAVITY: f64 = 9.80665;
/// Its largest relative error anywhere on Earth: 9.780 at the equator, 9.832 at the poles.
const STANDARD_GRAVITY_U95: f64 = 0.0027;
/// Effect of altitude (500 m: 1.6e-4) and of the ground (1e-4).
const LATITUDE_GRAVITY_U95: f64 = 2e-4;
/// Uncertainty of a value that the user gives for the location.
const GIVEN_GRAVITY_U95: f64 = 1e-5;
/// The change must exceed this many intervals of the readings, and this many codes.
const LEAST_CHANGE: (f64, f64) = (20.0, 50.0);
/// Deviation from the line, relative to the largest load, above which it is not a line.
const CROOKED: f64 = 0.02;
/// Uncertainty above which the result is doubtful: a good cell and masses reach 0.2 %.
const DOUBTFUL_U95: f64 = 0.01;

/// Local gravity, with its relative uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// \[m/s^2\].
    pub value: f64,
    /// Relative.
    pub u95: f64,
}

impl Gravity {
    /// Anywhere on Earth.
    pub const ANYWHERE: Self = Self { value: STANDARD_GRAVITY, u95: STANDARD_GRAVITY_U95 };

    /// As given by the user.
    pub const fn given(value: f64) -> Self {
        Self { value, u95: GIVEN_GRAVITY_U95 }
    }

    /// At a latitude \[degrees\], near sea level: the gravity formula of GRS 80.
    pub fn at_latitude(degrees: f64) -> Self {
        let (sine, double) = (degrees.to_radians().sin(), (2.0 * degrees.to_radians()).sin());
        let value = 9.780_327 * (1.0 + 0.005_302_4 * sine * sine - 0.000_005_8 * double * double);
        Self { value, u95: LATITUDE_GRAVITY_U95 }
    }
}

/// An applied load: its force and its name for a person.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// Force; positive in the direction that shall be positive \[N\].
    pub force_n: f64,
    /// For messages.
    pub name: String,
}

impl Load {
    /// From its mass \[kg\], hung so that a positive one pulls in the positive direction.
    pub fn mass(kg: f64, gravity: &Gravity) -> Self {
        Self { force_n: kg * gravity.value, name: format!("{kg} kg") }
    }

    /// From its force \[N\].
    pub fn force(newtons: f64) -> Self {
        Self { force_n: newtons, name: format!("{newtons} N") }
    }
}

/// The scale from loads and levels; `loads_u95` is the relative uncertainty of the loads.
pub fn force(readings: &[(Load, rest::Level)], loads_u95: f64, settings: &Settings) -> Result<Finding, CalibrateError> {
    let points: Vec<Point> =
        readings.iter().map(|(load, level)| Point { applied: load.force_n, reading: level.code }).collect();
    let line = Line::through(&points).ok_or_else(|| CalibrateError::TooFewPoints {
        what: "loads",
        count: points.len(),
        different: sizes(&points).len(),
        example: "--mass 0 --mass 5 --mass 10 --mass 0",
    })?;
    let readings_u95 = readings.iter().map(|(_, level)| level.code.u95).fold(0.0, f64::max);
    let needed = (LEAST_CHANGE.0 * readings_u95).max(LEAST_CHANGE.1);
    if line.change < needed {
        return Err(CalibrateError::Unchanged {
            what: "force code",
            of: "loads",
            change: line.change,
            needed,
            help: "does the load pass through the cell, and is the cell connected? If so, use larger loads or a \
            higher gain",
        });
    }
    refuse_both_ways(&points)?;
    if line.nonlinearity > CROOKED {
        let worst = readings.get(line.worst).map_or_else(String::new, |(load, _)| {
            format!("load {} of {} ({})", line.worst + 1, readings.len(), load.name)
        });
        return Err(CalibrateError::Crooked { what: "loads", percent: 100.0 * line.nonlinearity, worst });
    }
    let mut finding = Finding::new(Step::Force);
    let newtons_per_code = rounded(1.0 / line.slope, 7);
    let u95 = line.u95(loads_u95);
    finding.set_with("newtons_per_code", newtons_per_code, u95 * newtons_per_code.abs());
    finding.set_with("force_zero_code", line.at_zero.round(), together([readings_u95, 0.475]));
    finding.set("force_gain_u95", rounded_up(u95).min(1.0));
    finding.measure_all([
        ("scatter_u95", line.scatter_u95),
        ("nonlinearity", line.nonlinearity),
        ("hysteresis", line.hysteresis.unwrap_or(f64::NAN)),
        ("zero_return", line.zero_return.unwrap_or(f64::NAN)),
        ("reading_u95", line.reading_u95),
        ("loads_u95", loads_u95),
        ("change_of_scale", newtons_per_code / settings.newtons_per_code - 1.0),
    ]);
    finding.say(format!(
        "{newtons_per_code:.6e} {} per code ± {:.2} %, code at no force {:.0}",
        unit(settings.machine, "N"),
        100.0 * u95,
        line.at_zero
    ));
    let percent = |part: Option<f64>| part.map_or_else(|| "not shown".into(), |part| format!("{:.3} %", 100.0 * part));
    finding.say(format!(
        "relative to the largest load: nonlinearity {}, hysteresis {}, return to zero {}; scatter {}, loads {}",
        percent(Some(line.nonlinearity)),
        percent(line.hysteresis),
        percent(line.zero_return),
        percent(Some(line.scatter_u95)),
        percent(Some(loads_u95))
    ));
    remarks(&mut finding, &line, &points, u95, newtons_per_code, settings);
    Ok(finding)
}

/// Rejects a cell whose code moves the same way for loads of either sign.
fn refuse_both_ways(points: &[Point]) -> Result<(), CalibrateError> {
    let side = |sign: f64| {
        let on = points.iter().filter(|point| point.applied * sign >= 0.0);
        Straight::through(&on.map(Point::pair).collect::<Vec<_>>()).map(|line| line.slope)
    };
    let has = |sign: f64| points.iter().any(|point| point.applied * sign > 0.0);
    match (side(1.0), side(-1.0)) {
        (Some(up), Some(down)) if has(1.0) && has(-1.0) && up * down < 0.0 => {
            Err(CalibrateError::BothWays { direction: if up > 0.0 { "rises" } else { "falls" } })
        }
        _ => Ok(()),
    }
}

fn remarks(finding: &mut Finding, line: &Line, points: &[Point], u95: f64, newtons_per_code: f64, settings: &Settings) {
    if newtons_per_code * settings.newtons_per_code < 0.0 {
        finding.remark(
            Level::Note,
            "sign",
            "the sign is opposite to that of the settings in use: the cell's signal wires are swapped, or the other \
             direction is positive now. The sign of the scale corrects it; `inerter calibrate direction` checks it against the encoder",
        );
    } else if newtons_per_code < 0.0 {
        finding.remark(
            Level::Note,
            "sign",
            "the scale is negative: it reverses the force, as swapped signal wires require",
        );
    }
    if !points.iter().any(|point| point.applied > 0.0) || !points.iter().any(|point| point.applied < 0.0) {
        finding.remark(
            Level::Doubtful,
            "one_direction",
            "loads in one direction only: the other direction is assumed to have the same scale",
        );
    }
    match line.zero_return {
        None => finding.remark(
            Level::Doubtful,
            "no_return",
            "no return to zero was measured: end with the empty cell (--mass 0)",
        ),
        Some(back) if back > 1e-3 => {
            finding.remark(
                Level::Doubtful,
                "zero_return",
                format!("zero returns {:.2} % off: something rubs or creeps, or the cell was overloaded", 100.0 * back),
            );
        }
        Some(_) => {}
    }
    if u95 > DOUBTFUL_U95 {
        finding.remark(
            Level::Doubtful,
            "wide",
            "over 1 % of uncertainty enters every inertance: more loads, or better known ones, reduce it",
        );
    }
}

#[cfg(test)]
#[path = "force_tests.rs"]
mod tests;
