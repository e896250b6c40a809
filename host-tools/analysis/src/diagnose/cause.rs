//! A cause, and its description for a person.

use std::f64::consts::TAU;

use inerter_core::Machine;
use inerter_data::{names::description, words::interval_text};

use super::candidate::Kind;

/// One cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cause {
    /// Its kind.
    pub kind: Kind,
    /// Its size in [`unit`](Self::unit).
    pub value: f64,
    /// Half width of its 95 % interval.
    pub u95: f64,
    /// Unit of both, for a linear machine.
    pub unit: &'static str,
    /// F statistic with which it was chosen.
    pub f: f64,
    /// Period \[m\], if it repeats with the revolutions.
    pub period_m: Option<f64>,
    /// The motion covers less than one period, and the period was not given: another period is as likely, and the size
    /// changes with it.
    pub is_part_of_a_turn: bool,
    /// Another kind that explains as much.
    pub rival: Option<Kind>,
}

/// A unit on this machine.
fn unit(machine: Machine, unit: &'static str) -> &'static str {
    match (machine, unit) {
        (Machine::Rotary, "N") => "N m",
        (Machine::Rotary, "m") => "rad",
        (Machine::Rotary, "N s/m") => "N m s/rad",
        (Machine::Rotary, "N s2/m2") => "N m s2/rad2",
        (Machine::Rotary, "N/m") => "N m/rad",
        (Machine::Rotary, "m/N") => "rad/(N m)",
        _ => unit,
    }
}

impl Cause {
    /// The unit of its size.
    pub fn unit(&self, machine: Machine) -> &'static str {
        unit(machine, self.unit)
    }

    /// What it is, how large, and what to do.
    pub fn sentence(&self, machine: Machine) -> String {
        let sized =
            |factor: f64, unit: &str| format!("{} {unit}", interval_text(factor * self.value, factor * self.u95));
        let in_unit = || sized(1.0, self.unit(machine));
        let in_micrometres = || if machine == Machine::Rotary { in_unit() } else { sized(1e6, "um") };
        let period = self.period_m.map(|period| format!("{:.4} {}", period, unit(machine, "m"))).unwrap_or_default();
        let words = match self.kind {
            Kind::LoadDependent => format!(
                "friction grows with the load, by {} of the force: check the alignment, the nut's preload and its lubrication",
                sized(100.0, "%")
            ),
            Kind::PositionPeriodic => format!(
                "force or friction repeats every {period}, by {}: look for a bent screw, a coupling out of line or an uneven flywheel",
                in_unit()
            ),
            Kind::Stribeck => format!(
                "friction is greater at low speed, by {}: move faster; fc applies to fast motion only",
                in_unit()
            ),
            Kind::Presliding => format!(
                "friction reverses gradually, over {} after a reversal, like a spring: use much longer strokes",
                in_micrometres()
            ),
            Kind::Drift => format!(
                "offset or friction changed by {} over the run: warm the machine and the amplifier up, and tare again",
                in_unit()
            ),
            Kind::Skew => format!(
                "force and position are {} apart in time: run `inerter calibrate skew`, or set skew_s",
                sized(1e3, "ms")
            ),
            Kind::EncoderError => format!(
                "the encoder has an error that repeats every {period}, by {}: check how it is centred on its shaft",
                in_micrometres()
            ),
            Kind::Direction => {
                format!("viscous friction differs by direction, by {} either way: see `inerter fit`", in_unit())
            }
            Kind::QuadraticFriction => format!(
                "friction grows with the square of the velocity, by {}: look for air or oil that is moved, or move more slowly",
                in_unit()
            ),
            Kind::Spring => format!(
                "a force varies with the position, by {}: look for a spring, a hose or a cable beside the screw, and for crosstalk in the force's amplifier",
                in_unit()
            ),
            Kind::Compliance => format!(
                "the position yields to the force, by {}: check how stiff the encoder's mount is, and whether the encoder is on the screw",
                in_unit()
            ),
            Kind::ForceNonlinear => format!(
                "the measured force is not proportional to the true one, by {} of the largest: check the load cell's seat and screws, and its amplifier's range",
                sized(100.0, "%")
            ),
            Kind::Structure => format!(
                "a mass on the terminal moves differently from the screw, resonating on the contact at {:.0} Hz: set structure_mass_kg and stiffness_n_per_m, which `inerter calibrate stiffness` finds",
                1.0 / (TAU * self.value.max(f64::MIN_POSITIVE).sqrt())
            ),
        };
        let turn = if self.is_part_of_a_turn {
            "; the motion covers less than one period, so both period and size are uncertain: give the period to `inerter diagnose` as --counts-per-turn"
        } else {
            ""
        };
        let rival = self.rival.map(|rival| format!(" (or, as likely: {})", rival.name())).unwrap_or_default();
        description(machine, &(words + turn + &rival))
    }
}
