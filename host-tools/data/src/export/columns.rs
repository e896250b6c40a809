//! The columns that a file for other tools can have, and their values.

use inerter_core::{Machine, RawSample};
use inerter_wire::catalogue::{self, Group};
use serde::Serialize;

use super::{Row, Source};
use crate::series::Point;

/// A column of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// Time \[s\].
    Time,
    /// Unwrapped encoder count.
    EncoderCount,
    /// Displacement of the screw \[m\].
    Position,
    /// Force, less the code at zero force \[N\].
    Force,
    /// Displacement of the terminal \[m\]; not a number without such a sensor.
    Terminal,
    /// Sample counter of the device.
    Index,
    /// Whether the force is at or beyond a rail.
    Saturated,
}

/// The type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Floating-point numbers.
    Float,
    /// Integers.
    Whole,
    /// Booleans.
    Flag,
    /// Texts; no column of samples has them.
    Text,
}

impl Column {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Time, Self::EncoderCount, Self::Position, Self::Force, Self::Terminal, Self::Index, Self::Saturated];

    /// Name in a file of this machine, with its unit at the end, if any.
    pub fn name(self, machine: Machine) -> &'static str {
        let (linear, _) = self.name_and_kind();
        catalogue::find(machine, Group::Signal, linear).map_or(linear, |field| field.path)
    }

    /// Name for a linear machine, and type.
    fn name_and_kind(self) -> (&'static str, Kind) {
        match self {
            Self::Time => ("t_s", Kind::Float),
            Self::EncoderCount => ("encoder_count", Kind::Whole),
            Self::Position => ("position_m", Kind::Float),
            Self::Force => ("force_n", Kind::Float),
            Self::Terminal => ("terminal_m", Kind::Float),
            Self::Index => ("index", Kind::Whole),
            Self::Saturated => ("saturated", Kind::Flag),
        }
    }

    /// Unit; empty for a plain number.
    pub fn unit(self, machine: Machine) -> &'static str {
        catalogue::find(machine, Group::Signal, self.name_and_kind().0).map_or("", |field| field.unit)
    }

    /// The column with this name, for either kind of machine.
    pub fn find(name: &str) -> Option<Self> {
        let named =
            |column: &Self| [Machine::Linear, Machine::Rotary].map(|machine| column.name(machine)).contains(&name);
        Self::ALL.into_iter().find(named)
    }

    /// Its type.
    pub fn kind(self) -> Kind {
        self.name_and_kind().1
    }

    /// Its value as a number; exact for integers and flags.
    pub fn value(self, source: &Source, sample: &RawSample, point: &Point) -> f64 {
        match self.cell(source, sample, point) {
            Cell::Float(value) => value,
            Cell::Whole(value) => value as f64,
            Cell::Flag(value) => value.into(),
        }
    }

    /// Its value in a row.
    pub(super) fn cell(self, source: &Source, sample: &RawSample, point: &Point) -> Cell {
        match self {
            Self::Time => Cell::Float(source.time_s(point.elapsed)),
            Self::EncoderCount => Cell::Whole(point.count),
            Self::Position => Cell::Float(point.position_m),
            Self::Force => Cell::Float(point.force_n),
            Self::Terminal => Cell::Float(point.terminal_m.unwrap_or(f64::NAN)),
            Self::Index => Cell::Whole(sample.index.into()),
            Self::Saturated => Cell::Flag(point.saturated.into()),
        }
    }

    /// Its values in these rows.
    pub fn values(self, source: &Source, rows: &[Row]) -> Values {
        match self {
            Self::EncoderCount => Values::Whole(rows.iter().map(|(_, point)| point.count).collect()),
            Self::Index => Values::Whole(rows.iter().map(|(sample, _)| sample.index.into()).collect()),
            Self::Saturated => Values::Flag(rows.iter().map(|(_, point)| point.saturated).collect()),
            _ => Values::Float(rows.iter().map(|(sample, point)| self.value(source, sample, point)).collect()),
        }
    }
}

/// Values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Floating-point numbers.
    Float(Vec<f64>),
    /// Integers.
    Whole(Vec<i64>),
    /// Booleans.
    Flag(Vec<bool>),
}

/// One value, written as a plain number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub(super) enum Cell {
    /// A floating-point number.
    Float(f64),
    /// An integer.
    Whole(i64),
    /// 0 or 1.
    Flag(u8),
}
