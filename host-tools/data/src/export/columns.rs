//! The columns that a file for other tools can have, and batches of them.

use inerter_core::{Machine, RawSample};
use inerter_wire::catalogue::{self, Group};
use serde::Serialize;

use super::Source;
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
        match self {
            Self::Time => source.time_s(point.elapsed),
            Self::EncoderCount => point.count as f64,
            Self::Position => point.position_m,
            Self::Force => point.force_n,
            Self::Terminal => point.terminal_m.unwrap_or(f64::NAN),
            Self::Index => f64::from(sample.index),
            Self::Saturated => f64::from(u8::from(point.saturated)),
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
pub enum Cell {
    /// A floating-point number.
    Float(f64),
    /// An integer.
    Whole(i64),
    /// 0 or 1.
    Flag(u8),
}

impl Values {
    /// The value of one row.
    pub fn cell(&self, row: usize) -> Option<Cell> {
        match self {
            Self::Float(values) => values.get(row).copied().map(Cell::Float),
            Self::Whole(values) => values.get(row).copied().map(Cell::Whole),
            Self::Flag(values) => values.get(row).map(|flag| Cell::Flag(u8::from(*flag))),
        }
    }
}

/// Some rows, column by column.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Columns with their values, all of one length.
    pub columns: Vec<(Column, Values)>,
    /// Time of each row since the first sample of the source \[s\].
    pub since_s: Vec<f64>,
    /// Rows in it.
    pub rows: usize,
}

impl Batch {
    /// An empty batch with room for `room` rows.
    pub fn new(columns: &[Column], room: usize) -> Self {
        let values = |column: Column| match column.kind() {
            Kind::Float => Values::Float(Vec::with_capacity(room)),
            Kind::Whole => Values::Whole(Vec::with_capacity(room)),
            Kind::Flag => Values::Flag(Vec::with_capacity(room)),
        };
        let columns = columns.iter().map(|column| (*column, values(*column))).collect();
        Self { columns, since_s: Vec::with_capacity(room), rows: 0 }
    }

    /// Appends a row.
    pub fn push(&mut self, source: &Source, sample: &RawSample, point: &Point) {
        for (column, values) in &mut self.columns {
            match values {
                Values::Float(values) => values.push(column.value(source, sample, point)),
                Values::Whole(values) => values.push(match column {
                    Column::Index => sample.index.into(),
                    _ => point.count,
                }),
                Values::Flag(values) => values.push(point.saturated),
            }
        }
        self.since_s.push(point.elapsed as f64 / source.settings.sample_rate_hz);
        self.rows += 1;
    }

    /// Removes the rows and keeps the allocation.
    pub fn clear(&mut self) {
        for (_, values) in &mut self.columns {
            match values {
                Values::Float(values) => values.clear(),
                Values::Whole(values) => values.clear(),
                Values::Flag(values) => values.clear(),
            }
        }
        self.since_s.clear();
        self.rows = 0;
    }
}
